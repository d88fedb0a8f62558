"""Clipping boxes: the part of a bent volume that is rendered."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument
from supple.space.checks import items, number, point, refuse
from supple.space.geometry import Floats, Geometry

COARSE = 32  # the largest number of boxes along an axis, when visible parts are framed
Box = tuple[tuple[float, float], ...]
"""The rendered range of voxels, (from, to), along each axis, x first."""
Clip = Sequence[Sequence[float | None]] | npt.NDArray[Any]
"""A box with None where nothing is cut away; as nested sequences, or an array of shape (3, 2)."""


Plane = tuple[Sequence[float], Sequence[float]]
"""A voxel, x first, and a direction in LPS: all beyond the plane through the voxel in that direction is cut away."""


def plane_of(plane: object, geometry: Geometry) -> tuple[float, float, float, float]:
    """Return the unit normal of a `Plane` along a volume's axes, and its distance from the first voxel, in mm.

    For None, return a plane that cuts nothing away.
    """
    if plane is None:
        return 0.0, 0.0, 0.0, 1.0
    given = items("plane", plane, "a voxel and a direction", (2,))
    voxel, way = (np.array(point("plane", p, (3,))) for p in given)
    length = float(np.linalg.norm(way))
    if length == 0:
        refuse("plane", "a voxel and a direction that is not 0,0,0", plane)
    normal = geometry.direction.T @ way / length
    x, y, z = (float(n) for n in normal)
    return x, y, z, float(normal @ (voxel * geometry.spacing))


def seen_points(bricks: npt.NDArray[np.bool_], wide: int, shape: tuple[int, ...]) -> Floats:
    """Return the corners of visible bricks (c, b, a), ``wide`` voxels along a side, in a volume of ``shape``.

    They are in voxels, x first, (N, 3). Bricks are joined to boxes where there are more than 32 along an axis.
    """
    coarse = max(1, *(-(-n // COARSE) for n in bricks.shape))
    counts = tuple(-(-n // coarse) for n in bricks.shape)
    whole = np.pad(bricks, [(0, m * coarse - n) for n, m in zip(bricks.shape, counts, strict=True)])
    c, b, a = counts
    seen = whole.reshape(c, coarse, b, coarse, a, coarse).any(axis=(1, 3, 5))
    corners = np.zeros((c + 1, b + 1, a + 1), np.bool_)
    for k, j, i in itertools.product((0, 1), repeat=3):
        corners[k : c + k, j : b + j, i : a + i] |= seen
    last = np.array(whole_box(shape))[:, 1]
    return np.asarray(np.minimum(np.argwhere(corners)[:, ::-1] * float(wide * coarse), last), np.float64)


def around(points: Floats) -> Floats:
    """Return the corners of the boxes that contain points (N, 3), in a grid of 32 x 32 x 32 around all points."""
    low = points.min(axis=0)
    size = np.maximum((points.max(axis=0) - low) / COARSE, 1e-9)
    x, y, z = np.minimum((points - low) / size, COARSE - 1).astype(np.intp).T
    boxes = np.zeros((COARSE, COARSE, COARSE), np.bool_)
    boxes[z, y, x] = True
    return np.asarray(low + size * seen_points(boxes, 1, (COARSE + 1,) * 3), np.float64)


def within(points: Floats, box: Box, plane: Sequence[float], spacing: Sequence[float], slack: float) -> Floats:
    """Return the points (N, 3) in a box and before a plane, with a tolerance of ``slack`` voxels, clipped to the box.

    If there are none, return the corners of the box.
    """
    first, last = np.array(box).T
    away = (points * spacing) @ np.array(plane[:3]) - plane[3]
    kept = points[((points > first - slack) & (points < last + slack)).all(axis=1) & (away < slack * max(spacing))]
    return np.clip(kept, first, last) if len(kept) else np.array(list(itertools.product(*box)))


def whole_box(shape: tuple[int, ...]) -> Box:
    """Return the box of a whole volume of ``shape`` (Z, H, W), between its outermost voxels."""
    return tuple((0.0, max(n, 2) - 1.0) for n in reversed(shape))  # a single slice is rendered as two equal ones


def box_of(clip: object, shape: tuple[int, ...], name: str = "clip", *, single: bool = False) -> Box:
    """Return the box of a `Clip` in a volume of ``shape`` (Z, H, W); the whole volume for None.

    With ``single``, a range may be from a voxel to itself. SuppleError, with ``name`` in its message, if a range is
    empty, or not within the volume.
    """
    whole = whole_box(shape)
    if clip is None:
        return whole
    wanted = "a range of voxels for each axis, (from, to), x first"
    given = items(name, clip.tolist() if isinstance(clip, np.ndarray) else clip, wanted, (3,))
    ranges = [items(name, ends, wanted, (2,)) for ends in given]

    def placed(value: object, end: float) -> float:
        return end if value is None else number(name, value, "numbers of voxels", -1e9, 1e9)

    made = tuple(
        (placed(low, first), placed(high, last)) for (low, high), (first, last) in zip(ranges, whole, strict=True)
    )

    def refused(wanted: str, k: int) -> NoReturn:
        low, high = made[k]
        raise SuppleError(f"{argument(name)} must be {wanted}, found {low:g}:{high:g} along {'xyz'[k]}")

    for k, ((low, high), (first, last)) in enumerate(zip(made, whole, strict=True)):
        if not first <= low <= last or not first <= high <= last:
            refused(f"within the voxels of the volume, {', '.join(f'{a:g}:{b:g}' for a, b in whole)}", k)
        if low > high or (low == high and not single):
            refused("from a lower to a higher voxel along each axis", k)
    return made
