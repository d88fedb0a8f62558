"""Where sampled displacement fields fold, and the samples of their inverses that what folds may be mapped to.

The rules are those of the core (`tears.hpp`), for all cells at once: a cell is a polynomial in Bézier form, and its
determinant is bounded by the ranges of the differences of its control points; where that does not suffice, of a linear
cell by the control points of the determinant itself, and at last the cell is cut in halves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from supple.engines.torch.sampled import Samples, mirrored

_CUTS = 3  # times that a cell is cut, at most
_FINE = 0.5  # of a sample: the extent of a part below which it is not cut
_ROOM = 1 << 24  # numbers of control points in memory at once

# From a B-spline's coefficients to control points.
_BEZIER = ((1 / 6, 4 / 6, 1 / 6, 0), (0, 2 / 3, 1 / 3, 0), (0, 1 / 3, 2 / 3, 0), (0, 1 / 6, 4 / 6, 1 / 6))


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """Control points of P patches.

    Parameters
    ----------
    points : float64 tensor, shape (D, K, …, K, P)
        Indices; the control points lie along x first.
    field : int64 tensor, shape (P,)
        The field of each.
    low, high : bool tensor, shape (D, P)
        Whether they continue a field beyond the first or the last sample of an axis.
    """

    points: torch.Tensor
    field: torch.Tensor
    low: torch.Tensor
    high: torch.Tensor

    def part(self, mask: torch.Tensor) -> _Patches:
        return _Patches(self.points[..., mask], self.field[mask], self.low[:, mask], self.high[:, mask])

    def halved(self) -> _Patches:
        """Return their 2^D parts."""
        points, times = self.points, 2 ** len(self.points)
        for axis in range(1, len(points) + 1):
            k = points.shape[axis]
            lower = [[math.comb(i, j) / 2**i for j in range(k)] for i in range(k)]
            halves = [lower, [row[::-1] for row in lower[::-1]]]
            points = torch.cat([_along(points, half, axis) for half in halves], -1)
        return _Patches(points, self.field.repeat(times), self.low.repeat(1, times), self.high.repeat(1, times))


def _along(points: torch.Tensor, rows: Sequence[Sequence[float]], axis: int) -> torch.Tensor:
    """Return the product of a matrix with control points along an axis."""
    held = torch.tensor(rows, dtype=points.dtype, device=points.device)
    return torch.tensordot(held, points, ([1], [axis])).movedim(0, axis)


def folded(samples: Samples) -> torch.Tensor:
    """Return the mask (N, *shape) of the samples of the inverses that what folds may be mapped to."""
    ends = samples.ends
    sizes = [last - first + 1 for first, last in ends]
    counts = torch.zeros(samples.fields, *(size + 1 for size in sizes[::-1]), dtype=torch.int32)
    counts = counts.to(samples.values.device)
    cells = [last - first + 2 + (size == 1) for size, (first, last) in zip(samples.sizes, ends, strict=True)]
    total = samples.fields * math.prod(cells)
    together = max(1, _ROOM // (len(sizes) * (4 if samples.cubic else 2) ** len(sizes)))
    for start in range(0, total, together):
        numbers = torch.arange(start, min(start + together, total), device=counts.device)
        at = []
        for cell, (first, _) in zip(cells, ends, strict=True):
            at.append(numbers % cell + (first - 1))
            numbers = numbers // cell
        patches = _patches(samples, at, numbers)
        patches = patches.part(~_upright(patches.points))
        for cut in range(_CUTS + 1):
            if not len(patches.field):
                break
            flat = patches.points.flatten(1, -2)
            low, high = flat.amin(1), flat.amax(1)
            whole = (high - low).amax(0) <= _FINE if cut < _CUTS else torch.ones_like(patches.field, dtype=torch.bool)
            _mark(counts, patches.part(whole), low[:, whole], high[:, whole], samples)
            patches = patches.part(~whole).halved()
            patches = patches.part(~_upright(patches.points))
    for axis in range(1, counts.ndim):
        counts = counts.cumsum(axis)
    return counts[(slice(None), *(slice(size) for size in sizes[::-1]))] > 0


def _mark(counts: torch.Tensor, spots: _Patches, low: torch.Tensor, high: torch.Tensor, samples: Samples) -> None:
    """Add the corners of the boxes of samples that patches reach: their sums along all axes count the boxes."""
    # The continuation beyond an end has no end.
    low = torch.where(spots.low, -torch.inf, low) - samples.edge
    high = torch.where(spots.high, torch.inf, high) - samples.edge
    boxes, real = [], torch.ones_like(spots.field, dtype=torch.bool)
    for a, b, size in zip(low, high, counts.shape[:0:-1], strict=True):
        from_, to = (x.clamp(0, size - 1).long() for x in (torch.ceil(a - 1e-6), torch.floor(b + 1e-6) + 1))
        boxes.append((from_, to))
        real = real & (from_ < to)
    for which in itertools.product((0, 1), repeat=len(boxes)):
        index = tuple(box[k][real] for box, k in zip(boxes, which, strict=True))
        sign = torch.full_like(spots.field[real], (-1) ** sum(which), dtype=counts.dtype)
        counts.index_put_((spots.field[real], *index[::-1]), sign, accumulate=True)


def _patches(samples: Samples, at: Sequence[torch.Tensor], field: torch.Tensor) -> _Patches:
    """Return the patches of cells; along an axis, those before the first and after the last continue the field."""
    n, taps = len(at), 4 if samples.cubic else 2
    index, stride = field * samples.count, 1
    befores, afters = [], []
    for cell, size, (first, last) in zip(at, samples.sizes, samples.ends, strict=True):
        near = cell.clamp(first, max(last - 1, first)) - (taps // 2 - 1)
        tap = torch.stack([mirrored(near + k, size) for k in range(taps)]) * stride
        # x is the first axis of control points.
        index = index[..., None, :] + tap
        befores.append(cell < first)
        afters.append(cell >= last if size > 1 else torch.zeros_like(cell, dtype=torch.bool))
        stride *= size
    points = samples.values[:, index]
    for axis, (cell, before, after) in enumerate(zip(at, befores, afters, strict=True), 1):
        if samples.cubic:
            points = _along(points, _BEZIER, axis)
        points = torch.where(before, points.narrow(axis, 0, 1), points)
        points = torch.where(after, points.narrow(axis, taps - 1, 1), points)
        place = torch.linspace(0, 1, taps, dtype=points.dtype, device=points.device)
        shape = [1] * n + [len(cell)]
        shape[axis - 1] = taps
        points[axis - 1] += (place[:, None] + cell).reshape(shape)
    return _Patches(points, field, torch.stack(befores), torch.stack(afters))


def _upright(points: torch.Tensor) -> torch.Tensor:
    """Return the mask of patches whose determinant is known to be above 0."""
    n, count = len(points), points.shape[-1]
    mid: list[list[torch.Tensor]] = []
    off: list[list[torch.Tensor]] = []
    for axis in range(1, n + 1):  # [b][a]: ∂a/∂b, by its range
        differences = points.diff(dim=axis).flatten(1, -2)
        low, high = differences.amin(1), differences.amax(1)
        mid.append(list(0.5 * (low + high)))
        off.append(list(0.5 * (high - low)))
    sure = torch.ones(count, dtype=torch.bool, device=points.device)
    for a in range(n):  # by rows
        rest = [mid[b][a].abs() + off[b][a] for b in range(n) if b != a]
        sure &= mid[a][a] - off[a][a] - sum(rest[1:], rest[0]) > 1e-9
    size = [[x.abs() for x in row] for row in mid]
    scale = _expanded(size, 1)
    bound = _expanded(mid, -1)
    for which in itertools.product((False, True), repeat=n):
        if sum(which) > 1:
            bound = bound - _expanded([off[b] if which[b] else size[b] for b in range(n)], 1)
        elif sum(which):
            b = which.index(True)
            others = [mid[k] for k in range(n) if k != b]
            for a in range(n):
                minor = [[row[k] for k in range(n) if k != a] for row in others]
                bound = bound - off[b][a] * _expanded(minor, -1).abs()
    sure |= bound > 1e-12 * (1 + scale)
    if points.shape[1] == 2 and not sure.all():
        sure[~sure] = _by_control_points(points[..., ~sure])
    return sure


def _by_control_points(points: torch.Tensor) -> torch.Tensor:
    """Return the mask of linear patches whose determinant, of degree D - 1 along each axis, has those above 0 alone."""
    n = len(points)
    slopes = [points.diff(dim=axis).squeeze(axis) for axis in range(1, n + 1)]
    sums: dict[tuple[int, ...], torch.Tensor] = {}
    scale = torch.zeros_like(points[(0,) * (n + 1)])
    for corners in itertools.product(itertools.product((0, 1), repeat=n - 1), repeat=n):  # along the other axes
        columns = [list(slope[(slice(None), *corner)]) for slope, corner in zip(slopes, corners, strict=True)]
        place = tuple(sum(corners[b][d - (d > b)] for b in range(n) if b != d) for d in range(n))
        sums[place] = sums.get(place, 0) + _expanded(columns, -1)
        scale = torch.maximum(scale, _expanded([[x.abs() for x in column] for column in columns], 1))
    return torch.stack(list(sums.values())).amin(0) > 1e-11 * (1 + scale)


def _expanded(m: list[list[torch.Tensor]], sign: int) -> torch.Tensor:
    """Return the determinant of matrices, for a sign of -1; for 1, the permanent."""
    if len(m) == 1:
        return m[0][0]
    if len(m) == 2:
        return m[0][0] * m[1][1] + sign * m[0][1] * m[1][0]
    total = torch.zeros_like(m[0][0])
    for k, x in enumerate(m[0]):
        total = total + sign**k * x * _expanded([row[:k] + row[k + 1 :] for row in m[1:]], sign)
    return total
