"""The path of a grab, as straight grabs one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from supple.strokes.stroke import Stroke


def legs(stroke: Stroke, spacing: Sequence[float]) -> tuple[Stroke, ...]:
    """Return the straight grabs, one after the other, that make up a grab along a path.

    Points within a twentieth of the radius of the straight line between others are left out; of crooked paths,
    more, so that a path has at most four legs for each radius of its length. ``spacing`` is in physical units per
    sample, as the radius is.
    """
    end = tuple(a + b for a, b in zip(stroke.at, stroke.by, strict=True))
    points = np.array([stroke.at, *stroke.path, end])
    places = points * spacing
    length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    tolerance, kept = 0.05 * stroke.radius, [0, len(points) - 1]
    while True:
        kept = [0, *_corners(places, 0, len(points) - 1, tolerance), len(points) - 1]
        if len(kept) - 1 <= 4 * max(1.0, length / stroke.radius):
            break
        tolerance *= 2
    ways = pairwise(kept)
    return tuple(
        replace(stroke, at=tuple(points[i].tolist()), by=tuple((points[j] - points[i]).tolist()), path=())
        for i, j in ways
    )


def _corners(points: npt.NDArray[np.float64], first: int, last: int, tolerance: float) -> list[int]:
    """Return the points of a line between two of it that are needed to stay within a tolerance (Douglas-Peucker)."""
    if last - first < 2:
        return []
    way, offs = points[last] - points[first], points[first + 1 : last] - points[first]
    length2 = float(way @ way)
    along = np.clip(offs @ way / length2, 0, 1) if length2 > 0 else np.zeros(len(offs))
    away = np.linalg.norm(offs - along[:, None] * way, axis=1)
    worst = int(np.argmax(away))
    if away[worst] <= tolerance:
        return []
    middle = first + 1 + worst
    before, behind = _corners(points, first, middle, tolerance), _corners(points, middle, last, tolerance)
    return [*before, middle, *behind]
