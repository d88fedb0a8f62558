"""Checks of displacement fields: Jacobian determinants, folds, and how well one field undoes another.

Arrays are read along their first axis, a plane or two at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.sampling import Certificate, certificate_of_status
from supple.engine.work import Array
from supple.space.domain import FREE
from supple.space.geometry import Floats, Grid

_WITHIN = 1e-9  # samples, of rounding
_INWARDS = 1e-6  # samples: the slope is 0 beyond the outermost samples, where rounding may lead


@dataclass(frozen=True, slots=True)
class Consistency:
    """How well a second field undoes a first one: |second(first(x)) − x| at the samples x of the first.

    Parameters
    ----------
    count : int
        The number of samples that the first field maps into the second one's grid: only these are measured.
    outside : int
        The number of the other samples.
    largest, percentile, mean : float
        The maximum, the 99th percentile and the mean of the distances, in the grid's units (millimetres); NaN where
        `count` is 0.
    """

    count: int
    outside: int
    largest: float
    percentile: float
    mean: float


@dataclass(frozen=True, slots=True)
class FieldReport:
    """The effect of a displacement field: how far it moves, and whether it folds.

    Parameters
    ----------
    grid : Grid
        The grid of the samples.
    largest, mean : float
        The largest and the mean displacement of a sample, in the grid's units (millimetres).
    cells : int
        The number of cells of the interpolant: the boxes between neighbouring samples.
    folded : int
        The number of cells in which det(I + ∂u/∂x) is not proved to be above 0, by bounds that hold in the whole
        cell, not only at samples.
    determinant : float
        The least det(I + ∂u/∂x) that was computed. For a linear interpolant, over the corners of all cells, from
        inside each cell: in the plane, this is the minimum; in space, values within a cell may be lower. For a
        spline, over the samples.
    at : tuple of float
        The position of ``determinant``, x first.
    negative : int
        The number of samples at which the determinant by central differences (`Field.log_jacobian`) is not above 0.
    consistency : Consistency, optional
        How well a second field undoes this one.
    """

    grid: Grid
    largest: float
    mean: float
    cells: int
    folded: int
    determinant: float
    at: tuple[float, ...]
    negative: int
    consistency: Consistency | None = None

    @property
    def folds(self) -> bool:
        """True if the field may fold anywhere."""
        return self.folded > 0

    @property
    def samples(self) -> int:
        """The number of samples."""
        return math.prod(self.grid.shape)


def log_jacobian(values: Array, grid: Grid) -> npt.NDArray[np.float32]:
    """Return ln det(I + ∂u/∂x) at each sample, by central differences; NaN where the determinant is not above 0.

    At the first and the last sample along an axis, differences are one-sided.
    """
    made = np.empty(grid.shape, np.float32)
    for k in range(len(values)):
        found = _determinant([(ahead + behind) / 2 for ahead, behind in _steps(values, k)], grid)
        with np.errstate(divide="ignore", invalid="ignore"):
            made[k] = np.where(found > 0, np.log(found), np.nan)
    return made


def least_at_corners(values: Array, grid: Grid) -> tuple[float, Floats]:
    """Return the least determinant at the corners of all cells, from inside each, and the index of that sample."""
    least, index = math.inf, np.zeros(grid.ndim)
    for k in range(len(values)):
        for steps in product(*_steps(values, k)):  # towards each of the cells at a sample
            found = _determinant(steps, grid)
            if found.min() < least:
                place = np.unravel_index(found.argmin(), found.shape)
                least, index = float(found.min()), np.array([k, *place], np.float64)[::-1]
    return least, index


def least_at_samples(packed: _core.Sampled, grid: Grid) -> tuple[float, Floats]:
    """Return the least determinant of an interpolant at the samples of a grid, and the index of that sample."""
    least, index = math.inf, np.zeros(grid.ndim)
    for indices, points in planes(grid, _INWARDS):
        _, matrices, _ = through([("field", packed, False)], points, jacobian=True)
        found = np.linalg.det(matrices)
        flat = int(found.argmin())
        if found[flat] < least:
            least, index = float(found[flat]), np.rint(indices[flat])
    return least, index


def values_at(parts: Sequence[_core.Part], grid: Grid) -> tuple[npt.NDArray[np.float32], Certificate]:
    """Return the displacements of maps, one after the other, at the samples of a grid, and the certificate."""
    made, certificate = np.empty((*grid.shape, grid.ndim), np.float32), Certificate()
    for plane, (_, points) in zip(made.reshape(-1, *grid.shape[-2:], grid.ndim), planes(grid), strict=True):
        found, _, own = through(parts, points)
        plane[...] = (found - points).reshape(plane.shape)
        certificate |= own
    return made, certificate


def displacements(values: Array) -> tuple[float, float]:
    """Return the largest and the mean length of displacements."""
    most, total = 0.0, 0.0
    for plane in values:
        lengths = np.sqrt(np.square(plane, dtype=np.float64).sum(axis=-1))
        most, total = max(most, float(lengths.max())), total + float(lengths.sum())
    return most, total / math.prod(values.shape[:-1])


def distances(
    first: _core.Sampled, second: _core.Sampled, grid: Grid, within: Grid, margin: float
) -> npt.NDArray[np.float32]:
    """Return |second(first(x)) − x| at each sample x of ``grid``; NaN where first(x) is not within the second's grid.

    The fields are packed for positions. ``within`` is the grid of the second one, and ``margin`` how many samples the
    field extends beyond it.
    """
    made = np.empty(grid.shape, np.float32)
    last = np.array(within.sizes) - 1 + margin + _WITHIN
    for plane, (_, points) in zip(made.reshape(-1, *grid.shape[-2:]), planes(grid), strict=True):
        there = through([("field", first, False)], points)[0]
        places = within.indices(there)
        inside = ((places >= -margin - _WITHIN) & (places <= last)).all(axis=-1)
        back = through([("field", second, False)], there)[0]
        off = np.linalg.norm(back - points, axis=-1)
        plane[...] = np.where(inside, off, np.nan).reshape(plane.shape)
    return made


def consistency_of(found: npt.NDArray[np.float32]) -> Consistency:
    """Return the statistics of `distances`."""
    known = found[~np.isnan(found)]
    outside = found.size - known.size
    if not known.size:
        return Consistency(0, outside, math.nan, math.nan, math.nan)
    percentile = float(np.percentile(known, 99))
    return Consistency(known.size, outside, float(known.max()), percentile, float(known.mean(dtype=np.float64)))


def planes(grid: Grid, inwards: float = 0.0) -> Iterator[tuple[Floats, Floats]]:
    """Yield the indices and positions (N, D) of the samples of each plane; the outermost are moved ``inwards``."""
    height, width = grid.shape[-2:]
    index = np.zeros((height * width, grid.ndim))
    index[:, 1], index[:, 0] = np.indices((height, width)).reshape(2, -1)
    for z in range(grid.shape[0] if grid.ndim == 3 else 1):
        if grid.ndim == 3:
            index[:, 2] = z
        least = np.where(np.array(grid.sizes) > 1, inwards, 0.0)
        within = np.clip(index, least, np.array(grid.sizes) - 1 - least)
        yield within, grid.positions(within)


def _steps(values: Array, k: int) -> list[tuple[Floats, Floats]]:
    """Return the differences ahead of and behind plane k's samples along each axis, x first; one-sided at ends."""
    near = values[max(k - 1, 0) : k + 2].astype(np.float64)
    here, made = near[min(k, 1)], []
    for axis in reversed(range(here.ndim - 1)):
        steps, index = np.diff(here, axis=axis), np.arange(here.shape[axis])
        none = np.zeros_like(here)  # for an axis of one sample
        behind, ahead = np.maximum(index - 1, 0), np.minimum(index, len(index) - 2)
        made.append((steps.take(ahead, axis), steps.take(behind, axis)) if len(index) > 1 else (none, none))
    steps = np.diff(near, axis=0) if len(near) > 1 else np.zeros_like(near)
    return [*made, (steps[-1], steps[0])]


def _determinant(steps: Sequence[Floats], grid: Grid) -> Floats:
    """Return det(I + ∂u/∂x) from the differences of u from sample to sample along each axis, x first."""
    matrix = grid.matrix[:-1, :-1]
    a, b, *c = (step + matrix[:, axis] for axis, step in enumerate(steps))
    whole = (a * np.cross(b, c[0])).sum(axis=-1) if c else a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.asarray(whole / float(np.linalg.det(matrix)))


def through(
    parts: Sequence[_core.Part], points: Floats, *, jacobian: bool = False
) -> tuple[Floats, Floats, Certificate]:
    """Return points (N, D) after all maps, in order; the Jacobians, or an empty array; and the certificate."""
    n, status = points.shape[1], np.zeros(len(points), np.uint8)
    composite = _core.Composite(n, np.array([FREE] * 3), list(parts))
    whole = np.zeros((len(points), 3))
    whole[:, :n] = points
    moved, matrices, _ = composite.through(whole, False, jacobian, status)
    slopes = np.empty(0) if matrices is None else matrices[:, :n, :n]
    return moved[:, :n], slopes, certificate_of_status(status)
