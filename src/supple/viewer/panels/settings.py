"""What a window remembers for the next one: which sections are folded."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from supple.errors import SuppleError
from supple.media.files import replacing


def _place() -> Path:
    from platformdirs import user_config_path

    return user_config_path("supple", appauthor=False) / "window.json"


def read() -> dict[str, bool]:
    """Return which sections are open, by their names; a file that is missing or broken says nothing."""
    with contextlib.suppress(OSError, ValueError, RecursionError, ImportError):
        data: Any = json.loads(_place().read_text(encoding="utf-8"))
        known = data.get("sections") if isinstance(data, dict) else None
        if isinstance(known, dict):
            return {name: opened for name, opened in known.items() if isinstance(opened, bool)}
    return {}


def write(sections: dict[str, bool]) -> None:
    """Keep which sections are open; a folder that cannot be written is ignored."""
    with contextlib.suppress(OSError, SuppleError, ImportError):
        place = _place()
        place.parent.mkdir(parents=True, exist_ok=True)
        with replacing(place, force=True) as target:
            target.write_text(json.dumps({"sections": sections}, indent=1), encoding="utf-8")
