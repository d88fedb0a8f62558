"""Settings that outlive a window: a file in the user's folder for settings."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from supple.errors import SuppleError
from supple.media.files import replacing

RECENT = 12
"""The most files that are remembered."""
Colour = tuple[float, float, float, float]
RED: Colour = (0.91, 0.19, 0.19, 0.45)


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings with which a window begins."""

    sections: dict[str, bool] = field(default_factory=dict)  # whether a section is open, if it was folded or opened
    recent: tuple[str, ...] = ()  # the files that were opened last, the newest first
    veil: Colour = RED  # the colour over frozen parts: red, green, blue and opacity
    hinted: bool = False  # whether a stroke was ever made: then the first hints are not shown any more


def settings() -> Settings:
    """Return the saved settings, or the defaults if their file is missing or broken."""
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError, RecursionError, ImportError):
        known = json.loads(_place().read_text(encoding="utf-8"))
        sections = {name: bool(on) for name, on in known.get("sections", {}).items()}
        r, g, b, a = (min(max(float(v), 0.0), 1.0) for v in known.get("veil", RED))
        recent = tuple(map(str, known.get("recent", [])))
        return Settings(sections, recent[:RECENT], (r, g, b, a), bool(known.get("hinted")))
    return Settings()


def keep(**changes: Any) -> Settings:
    """Save some settings, and return all. Other settings stay as saved. Failure to write the file is ignored."""
    made = replace(settings(), **changes)
    with contextlib.suppress(OSError, SuppleError, ImportError):
        place = _place()
        place.parent.mkdir(parents=True, exist_ok=True)
        with replacing(place, force=True) as target:
            target.write_text(json.dumps(asdict(made), indent=1), encoding="utf-8")
    return made


def keep_recent(path: Path) -> Settings:
    """Remember a file as the one that was opened last, and return all settings."""
    name = os.path.abspath(path)
    return keep(recent=(name, *(other for other in settings().recent if other != name))[:RECENT])


def _place() -> Path:
    from platformdirs import user_config_path

    return user_config_path("supple", appauthor=False) / "window.json"
