"""Bounds on the part of a source that cells of the lattice may read, from their nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engines.base import LONGEST
from supple.engines.wgpu.lattice import Range
from supple.engines.wgpu.samples import STEP, GpuGroup

Floats = npt.NDArray[np.float64]

LONG, SQUARE, PER_SPOT, MOST_SPOTS = (_core.constants[name] for name in ("LONG", "SQUARE", "PER_SPOT", "MOST_SPOTS"))

SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2, "nothing": 1}


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Bounds for each row of cells, arrays (planes, rows): source points and displacements.

    Parameters
    ----------
    early, late : array
        The first and the last time.
    above, below : array
        The first and the last row, in pixels.
    moved : array
        The largest displacement along any axis, in pixels.
    tall, long : array
        The largest height and length in time of a footprint, in pixels.
    coarse : array
        The largest side, in samples, of the averages in the coarsest level that a footprint reads.
    work : array
        The approximate number of points averaged for a pixel.
    """

    early: Floats
    late: Floats
    above: Floats
    below: Floats
    moved: Floats
    tall: Floats
    long: Floats
    coarse: Floats
    work: Floats


def reach_of(nodes: npt.NDArray[np.float32], first: int, origin: int, step: tuple[int, int]) -> Reach:
    """Compute bounds from the nodes of planes from ``first`` on, whose first row of cells is ``origin``.

    Raises
    ------
    ArithmeticError
        If a node is not a number.
    """
    if not np.isfinite(nodes).all():
        raise ArithmeticError("a point could not be solved")
    known = nodes.astype(np.float64)
    planes, rows = known.shape[:2]
    u, across, down, along = (known[..., k, :3] for k in range(4))
    # Between two nodes, the map differs from the line by about distance times difference of slopes, over 8.
    bend = np.zeros((planes, rows - 1, 3))
    for slopes, axis in ((across, 2), (down, 1)):
        apart = np.abs(np.diff(slopes, axis=axis)).max(axis=2) * (STEP / 8)
        bend += apart if axis == 1 else np.maximum(apart[:, 1:], apart[:, :-1])

    def both(values: Floats, end: int) -> Floats:
        """Return the least or the largest values of a row of cells, from its two rows of nodes."""
        found: Floats = (values.min if end < 0 else values.max)(axis=2)
        pick = np.minimum if end < 0 else np.maximum
        return np.asarray(pick(found[:, 1:], found[:, :-1]))

    z = np.arange(first, first + planes)[:, None, None]
    y = (STEP * np.arange(origin, origin + rows))[None, :, None]
    # The size of a footprint: along y by its whole parallelogram, along t by the length of its row.
    tall = np.abs(across[..., 1]) * step[0] + np.abs(down[..., 1]) * step[1]
    long = np.sqrt((across[..., 2] * step[0]) ** 2 + (down[..., 2] * step[1]) ** 2 + along[..., 2] ** 2)
    # The eigenvalues of M Mᵀ, in samples; see footprint.wgsl.
    mx, my = ((across[..., k] * step[0] / step[k], down[..., k] * step[1] / step[k]) for k in range(2))
    xx, xy, yy = (np.sum(np.stack(a) * np.stack(b), axis=0) for a, b in ((mx, mx), (mx, my), (my, my)))
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = half + apart, half - apart
    want = np.maximum(minor, major / LONG)
    coarse = np.where(want > 0.8 * SQUARE, 2 * np.sqrt(want), 1.0)
    spots = np.clip(np.sqrt(major / np.maximum(want / 4, 1)) / PER_SPOT, 1, MOST_SPOTS)
    return Reach(
        both(z + u[..., 2], -1) - bend[..., 2],
        both(z + u[..., 2], 1) + bend[..., 2],
        both(y + u[..., 1], -1) - bend[..., 1],
        both(y + u[..., 1], 1) + bend[..., 1],
        both(np.abs(u).max(axis=-1), 1) + bend.max(axis=-1),
        both(tall, 1),
        both(long, 1),
        both(coarse, 1),
        spots.mean(axis=2)[:, :-1],
    )


def held_of(low: float, high: float, support: int, n: int, outside: str) -> Range:
    """Return the range of samples of an axis that a filter reads around points from ``low`` to ``high``: from, to.

    ``support`` is the number of samples that a filter reads on either side.
    """
    first, last = math.floor(max(low, -1e9)) - support + 1, math.floor(min(high, 1e9)) + support
    if outside == "reflect" and (first < 0 or last >= n):
        # Reflected coordinates lie as far within the frame as they lay outside it.
        if first < -n or last >= 2 * n or (first < 0 and last >= n):
            return 0, n
        return (0, max(last + 1, -first)) if first < 0 else (min(first, 2 * n - 1 - last), n)
    return min(max(first, 0), n - 1), min(max(last, 0), n - 1) + 1


def box_of(
    reach: Reach, planes: slice, cells: slice, picture: GpuGroup, frames: int, more: float
) -> tuple[Range, Range]:
    """Return the ranges of frames and rows that a part of a group may read, widened by ``more``."""
    wanted, (_, step) = picture.wanted, picture.step
    part = planes, cells
    slack = more + 2 * wanted.tolerance + 1e-3
    averaging = wanted.filter == "auto"
    tall = slack
    if averaging:
        # Spots along the footprint; in coarser levels whole samples, as many around a point as in the frame itself.
        unit = float(reach.coarse[part].max())
        tall += 0.75 * float(reach.tall[part].max()) / step + (5 * unit if unit > 1 else 0.0)
    rows = held_of(
        (float(reach.above[part].min()) - picture.offset[1]) / step - tall,
        (float(reach.below[part].max()) - picture.offset[1]) / step + tall,
        3 if averaging else 2 if wanted.filter == "cubic" else 1,
        picture.shape[0],
        wanted.outside,
    )
    if wanted.between == "nothing":
        return (0, frames), rows
    times = float(reach.early[part].min()) - slack, float(reach.late[part].max()) + slack
    early, late = (min(max(t, wanted.times[0]), wanted.times[1]) for t in times)
    wide = min(1.5 * float(reach.long[part].max()), LONGEST) / 2 if wanted.average else 0.0
    return held_of(early - wide, late + wide, SUPPORT[wanted.between], frames, wanted.outside), rows
