"""The margin of strokes to folding: bounds of the smallest eigenvalue of the displacement's symmetric gradient.

μ is the minimum over all points of λ_min(sym(J_β)), J_β the Jacobian of the displacement of strokes that act at once,
with the border. If 1 + μ > 0, T is strongly monotone, hence one-to-one; μ is proportional to forces and matrices.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import numbers
from supple.space.checks import LARGEST
from supple.space.geometry import Floats
from supple.strokes import Stroke, pack

Table = npt.NDArray[np.void]

MARGIN = 0.01
"""The least 1 + μ of every stroke."""

CLEARLY_SAFE = -0.5 * (1 - MARGIN)
"""The value of μ above which no closer bound is needed."""

GAP = 0.002
"""The relative gap of the bounds."""

_LOOKED_AT = 128  # strokes of a group, the strongest, around which points are sampled
_CLOSER = 16  # points around which the search continues
_FREE_GAP = 1e-9  # computed once for all strokes with the same parameters
_FLAT_GAP = 1e-3  # bounds of a plateau are wider
_FARTHEST = 1000.0  # radii: without a limit, the strain is below 5e-6 of that at the pivot from there on
_BEYOND = 5e-6


def limit(poisson: float, scales: int, reach: float | None = None, flat: float = 0.0) -> float:
    """Return the largest |f|/ε of a stroke with a free border: there, λ_min(sym(I + J)) reaches 0.

    With a reach, in radii, the result is at least 1 - 10⁻⁹ times the largest, and with a plateau (``flat``, a fraction
    of the radius), 1 - 10⁻³ times.
    """
    return -1 / _free(poisson, scales, math.inf if reach is None else reach, flat)[0]


@lru_cache(maxsize=1024)
def _free(poisson: float, scales: int, reach: float, flat: float = 0.0) -> tuple[float, float, float]:
    """Return bounds of μ for |f| = ε = 1 and a free border, and the distance from the pivot at which it is reached."""
    stroke = Stroke(at=(0.0, 0.0), by=(1.0, 0.0), radius=1.0, poisson=poisson, scales=scales)
    row = pack([stroke], (1.0, 1.0))[0]
    if reach < math.inf:
        row["reach"], row["flat"] = reach, flat
        return _core.smallest_free_strain(_numbers(row), _FLAT_GAP if flat else _FREE_GAP)
    e, a, g = row["radius2"], row["p"] + row["r"], row["q"] - row["r"] * row["radius2"]

    def slope(u: float) -> float:
        return -math.sqrt(u) * float(np.sum((a + 3 * g / (u + e)) * (u + e) ** -1.5))

    def bend(u: float) -> float:
        v = u / (u + e)
        return float(np.sum((a * (3 * v - 1) + 3 * g / (u + e) * (5 * v - 1)) * (u + e) ** -1.5))

    if scales == 1:
        half = 3 * g[0] / a[0] - 0.75
        worst = math.sqrt(half**2 + 7.5 * g[0] / a[0]) - half - 1
    else:
        worst, high = 0.05, 0.5
        for _ in range(60):
            middle = (worst + high) / 2
            worst, high = (middle, high) if bend(middle) < 0 else (worst, middle)
    return slope(worst) * (1 + 1e-12), slope(worst) * (1 - 1e-12), math.sqrt(worst)


def weakest(
    rows: Table,
    axes: Floats,
    target: float = CLEARLY_SAFE,
    gap: float = GAP,
    mask: _core.Freeze | None = None,
) -> tuple[float, float]:
    """Return lower and upper bounds of μ for rows that act at once; for all of space, where the domain is free.

    The lower bound need not be close to the upper one above the ``target`` (0: it always is). Otherwise, they are
    within the relative ``gap``, or three times that with a mask; rounding and the limited number of boxes can leave
    more, if |μ| is very small or the volume very anisotropic.
    """
    if len(rows) > 1 or rows["power"][0] != 1 or mask is not None or _slants(rows[0]):
        around, beyond = _around(rows, axes)
        if mask is not None:
            gap *= 3  # close bounds take long where it is frozen
        if mask is not None and beyond:  # the mask is constant outside the domain
            around[:, 0], around[:, 1] = np.minimum(around[:, 0], axes[:, 0]), np.maximum(around[:, 1], axes[:, 1])
        lower, upper = _core.smallest_strain(numbers(rows), around, -math.inf, 0.0, target, gap, mask)
        return min(lower, beyond), upper
    row, fixed = rows[0], axes[:, 2] >= 0
    force, bounded = row["force"], bool(fixed.any())
    if bounded:
        active = (axes[:, 1] > axes[:, 0]) & (axes[:, 2] > 0)
        # In a plane through the pivot, the force across the plane has no displacement within it.
        force = np.where(fixed & ~active & (row["pivot"] == axes[:, 0]), 0.0, force)
        if not active.any():
            return 0.0, 0.0
    size = math.hypot(*force.tolist())
    if size == 0:
        return 0.0, 0.0
    radius = math.sqrt(row["radius2"][0])
    lower, upper, distance = _free(_poisson(row), int(row["terms"]), row["reach"] / radius, row["flat"] / radius)
    lower, upper, distance = lower / radius, upper / radius, distance * radius
    if bounded:
        unit = row.copy()
        unit["force"] = force / size
        above = target / size * (1 - 1e-12)  # rounding must not put the result below the target
        lower, upper = _core.smallest_strain(_numbers(unit), axes, lower, distance, above, gap)
    return lower * size, upper * size


def sampled(rows: Table, axes: Floats, mask: _core.Freeze | None = None) -> float:
    """Return the lowest λ_min(sym(J_β)) at sampled points near strokes that act at once: a fast upper bound of μ.

    Points are around the pivots of the strongest strokes, between these and their neighbours, and on a lattice; then,
    in smaller and smaller steps, around the points with the lowest values.
    """
    around, _ = _around(rows, axes)
    low, high = around[:, 0], around[:, 1]
    extended, radius = np.flatnonzero(high > low), np.sqrt(rows["radius2"][:, 0])
    if not len(extended):
        return 0.0
    steps = np.zeros((2 * len(extended), 3))
    steps[range(len(steps)), np.repeat(extended, 2)] = np.tile([1.0, -1.0], len(extended))

    def lowest(points: Floats) -> Floats:
        _, jacobian = _core.forward(numbers(rows), axes, np.ascontiguousarray(np.clip(points, low, high)), True, mask)
        strain = jacobian[:, extended[:, None], extended] - np.eye(len(extended))
        strain = np.where(np.isfinite(strain).all(axis=(1, 2), keepdims=True), strain, -LARGEST)
        return np.asarray(np.linalg.eigvalsh(0.5 * (strain + np.swapaxes(strain, 1, 2)))[:, 0])

    strength = np.linalg.norm(rows["force"], axis=1) + np.linalg.norm(rows["matrix"], axis=(1, 2)) * radius
    strongest = np.argsort(-strength, kind="stable")[:_LOOKED_AT]
    pivots, near = rows["pivot"], rows["pivot"][strongest]
    distances = np.linalg.norm(near[:, None] - pivots, axis=2)
    neighbours = pivots[np.argsort(distances, axis=1, kind="stable")[:, 1:5]]
    beside = near[:, None] + radius[strongest, None, None] * np.concatenate([steps * r for r in (0.3, 0.6, 1.0)])
    between = [near[:, None] + (neighbours - near[:, None]) * t for t in (0.2, 0.5, 0.8)]
    ends = np.linspace(low[extended], high[extended], 33 if len(extended) == 2 else 17)
    lattice = np.repeat(low[None], len(ends) ** len(extended), axis=0)
    lattice[:, extended] = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(len(lattice), -1)
    points = np.concatenate([np.concatenate([beside, *between], axis=1).reshape(-1, 3), lattice])
    found = lowest(points)
    for width in radius.max() * 0.25 * 0.5 ** np.arange(8):
        best = np.argsort(found, kind="stable")[:_CLOSER]
        closer = (points[best][:, None] + width * steps).reshape(-1, 3)
        points, found = np.concatenate([points[best], closer]), np.concatenate([found[best], lowest(closer)])
    return min(float(found.min()), 0.0)


def largest(rows: Table, axes: Floats, mask: _core.Freeze | None = None) -> float:
    """Return an upper bound of the displacement of rows that act at once, in physical units."""
    return _core.largest_displacement(numbers(rows), _around(rows, axes)[0], mask)


def _around(rows: Table, axes: Floats) -> tuple[Floats, float]:
    """Return the domain, and 0; or, if no axis is fixed, a box around the reach, and a lower bound of μ outside."""
    if not np.all(axes[:, 2] < 0):
        return axes, 0.0
    radius = np.sqrt(rows["radius2"][:, :1])
    reach = np.minimum(rows["reach"][:, None], _FARTHEST * radius)
    # The map of an image of one row also moves points beside it, but an image has no points beside its plane.
    across = bool(rows["matrix"][:, 2].any() or rows["matrix"][:, :, 2].any() or rows["force"][:, 2].any())
    around, extended = axes.copy(), np.array([True, True, axes[2, 1] > axes[2, 0] or across])
    around[:, 0] = np.where(extended, (rows["pivot"] - reach).min(axis=0), axes[:, 0])
    around[:, 1] = np.where(extended, (rows["pivot"] + reach).max(axis=0), axes[:, 1])
    strain = np.linalg.norm(rows["force"], axis=1) / radius[:, 0] + np.linalg.norm(rows["matrix"], axis=(1, 2))
    return around, -_BEYOND * float(strain[np.isinf(rows["reach"])].sum())


def _numbers(row: np.void) -> Floats:
    return numbers(np.array([row]))


def _slants(row: np.void) -> bool:
    """Return whether a drag goes both in the plane and along time, which it does not couple."""
    return bool(not row["coupled"] and row["force"][2] and row["force"][:2].any())


def _poisson(row: np.void) -> float:
    ratio = row["r"][0] / (row["p"][0] + row["r"][0])
    return min(1 - 1 / (4 * float(ratio)), 0.5) if ratio > 0 else -math.inf
