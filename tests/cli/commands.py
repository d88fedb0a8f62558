"""Pictures and commands of tests, and what commands said."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.media import image

GRAB = ("--grab", "20,16:23,18", "--radius", "12")
Said = tuple[int, str, str]
Run = Callable[..., Said]


def noise(height: int, width: int, channels: int = 3, dtype: type = np.uint8) -> npt.NDArray[np.uint8]:
    rng = np.random.default_rng(height * 1000 + width)
    top = np.iinfo(dtype).max + 1
    shape = (height, width, channels) if channels > 1 else (height, width)
    return rng.integers(0, top, shape, dtype=dtype)


def done(said: Said) -> str:
    """Return what a command that came to its end wrote."""
    status, out, err = said
    assert status == 0, err
    return out


def told(said: Said) -> dict[str, Any]:
    """Return what it told as JSON."""
    made: dict[str, Any] = json.loads(done(said))
    return made


def one_line(text: str) -> str:
    assert text.startswith("supple: "), text
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    assert "Traceback" not in text
    return text


def pictures(folder: str) -> None:
    Path(folder, "deep").mkdir(parents=True)
    for i, name in enumerate(["a.png", "b.jpg", "deep/a.png"]):
        image.write(f"{folder}/{name}", noise(30 + i, 30))
    Path(folder, "bad.png").write_text("no picture")
    Path(folder, "notes.txt").write_text("no picture either")
