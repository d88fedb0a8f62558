"""Files for windows, and what was made of them, compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from supple.cli import command
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.view import TOP
from supple.viewer.tools.viewport import Viewport
from tests.viewer.windows import Pixels


def recipe_in(path: Path) -> Recipe:
    return Recipe.from_json(path.read_text(encoding="utf-8"))


def near(one: Pixels, other: Pixels, where: Any = ...) -> float:
    """How far pictures are apart: the root of the mean square, in levels."""
    return float(np.sqrt(np.mean((one.astype(float) - other.astype(float))[where] ** 2)))


def beside(shape: tuple[int, ...], handles: list[tuple[tuple[float, float], tuple[float, float]]]) -> Any:
    """Where the lines and handles of strokes are not drawn."""
    y, x = np.indices(shape[:2])
    free = np.ones(shape[:2], bool)
    for start, end in handles:
        for part in np.linspace(0, 1, 50):
            at = [a + part * (b - a) for a, b in zip(start, end, strict=True)]
            free &= (x - at[0]) ** 2 + (y - at[1]) ** 2 > 12**2
    return free


def warped(source: Path, name: str, recipe: Path, *options: str) -> Path:
    """What the command line makes of a recipe."""
    target = source.with_name(name)
    assert command(["warp", str(source), str(target), "--recipe", str(recipe), *options]) == 0
    return target


def on_canvas(picture: Pixels, seen: Pixels, area: tuple[int, int], strokes: tuple[Stroke, ...]) -> float:
    """How far a picture is from what a window shows of it at 100 %, beside its handles."""
    height, width = picture.shape[:2]
    viewport = Viewport((width, height), area, top=TOP).actual()
    left, top = (round(v) for v in viewport.to_canvas(0, 0))
    assert left >= 0
    assert top >= 0
    seen = seen[top : top + height, left : left + width]
    ends = [(s.at[:2], tuple(a + b for a, b in zip(s.at[:2], s.by[:2], strict=True))) for s in strokes]
    return near(seen, picture, beside(picture.shape, ends))
