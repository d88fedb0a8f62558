"""What joins the vertices of a mesh: triangles and lines, from polygons, strips and polylines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple.media.files import PathLike, unreadable

Ints = npt.NDArray[np.intp]
Runs = tuple[npt.ArrayLike, npt.ArrayLike]
"""The vertices of polygons or polylines, one after the other, and how many each has."""
NO_RUNS: Runs = ((), ())


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of a mesh: its triangles and lines, and its colour.

    Parameters
    ----------
    triangles : int array, shape (T, 3)
        Indices of vertices.
    lines : int array, shape (L, 2)
    colour : (float, float, float), optional
        sRGB from 0 to 1, if the file says it.
    """

    triangles: Ints
    lines: Ints
    colour: tuple[float, float, float] | None = None


def part_of(
    path: PathLike,
    count: int,
    polygons: Runs = NO_RUNS,
    lines: Runs = NO_RUNS,
    strips: Runs = NO_RUNS,
    colour: tuple[float, float, float] | None = None,
) -> Part:
    """Return a part of a mesh of ``count`` vertices; SuppleError if one has another index.

    Polygons are divided into triangles that share their first corner, which is exact for convex ones.
    """
    known = [_checked(path, count, *runs) for runs in (polygons, lines, strips)]
    first, k, corners = _steps(*known[0], 2)
    triangles = np.stack([corners[first], corners[first + k + 1], corners[first + k + 2]], axis=-1)
    first, k, corners = _steps(*known[2], 2)
    odd = k % 2  # every second triangle of a strip is turned
    stripped = np.stack([corners[first + k], corners[first + k + 1 + odd], corners[first + k + 2 - odd]], axis=-1)
    first, k, corners = _steps(*known[1], 1)
    joined = np.stack([corners[first + k], corners[first + k + 1]], axis=-1)
    return Part(np.concatenate([triangles, stripped]), joined, colour)


def joined(runs: Sequence[Sequence[int]]) -> Runs:
    """Return polygons or polylines of a list for each."""
    return [corner for run in runs for corner in run], [len(run) for run in runs]


def _checked(path: PathLike, count: int, corners: npt.ArrayLike, counts: npt.ArrayLike) -> tuple[Ints, Ints]:
    try:
        known, many = np.asarray(corners, np.intp).ravel(), np.asarray(counts, np.intp).ravel()
    except OverflowError:
        raise unreadable(path, f"a face or line has a vertex beyond the last of {count}") from None
    if (many < 0).any() or many.sum() != len(known):
        raise unreadable(path, "its faces or lines do not have as many corners as it says")
    wrong = known[(known < 0) | (known >= count)]
    if len(wrong):
        raise unreadable(path, f"a face or line has vertex {wrong[0] + 1} of {count}")
    return known, many


def _steps(corners: Ints, counts: Ints, less: int) -> tuple[Ints, Ints, Ints]:
    """Return where each run begins, and the steps from there, for each of its corners but the last ``less``."""
    each = np.maximum(counts - less, 0)
    first = np.repeat(np.cumsum(counts) - counts, each)
    return first, np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each), corners
