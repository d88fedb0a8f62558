"""The table of strokes that the core reads; and the straight grabs that make up a grab along a path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from supple._core.rows import STROKE_DTYPE
from supple.space.checks import refuse
from supple.space.geometry import Floats
from supple.strokes.stroke import Brush, Stroke

POISSON = 0.4

# The radii are ε, 1.1ε and 1.21ε. The weights that cancel the far field, divided by their sum at the pivot, are
# exactly these fractions; computed in floats they would lose digits.
_WEIGHTS = {1: np.array([1.0]), 2: np.array([11.0, -11.0]), 3: np.array([14641.0, -26741.0, 12100.0]) / 331}
_RADIUS2 = (1.0, 1.21, 1.4641)


def pack(
    strokes: Iterable[Stroke], spacing: Sequence[float], *, time: bool = False, frames: int = 0
) -> npt.NDArray[np.void]:
    """Return the strokes as the table that the core reads.

    With ``d = point - pivot`` and ``rho_i² = |d|² + radius2_i``, a row is the displacement
    ``sum_i (p_i / rho_iⁿ + q_i / rho_iⁿ⁺²) v + (r_i / rho_iⁿ⁺²) (d · v) d``. A grab has the ``power`` n = 1, and v is
    its ``force``, the displacement of the pivot; a scale and a pinch have n = 3, and v is ``matrix @ d``, where the
    matrix is the displacement's Jacobian at the pivot (de Goes and James, "Regularized Kelvinlets", 2017; section 5).
    A twist has the same profile, but as the angle, in radians, by which d is turned about an axis: the matrix is that
    of the cross product with the axis, and ``turn`` has a factor for each component of the displacement (other brushes:
    0). Where ``reach`` is finite, the displacement is multiplied by ``1 - 10t³ + 15t⁴ - 6t⁵``, ``t = |d| / reach``, and
    0 beyond. Rows that are ``joined`` act at once with the row before: all are evaluated at the same point, and added.
    ``most`` bounds their displacement, or is infinite if no bound is known. ``mask`` is the number of their mask
    (`supple.engine.work.Mattes`), or 0. With a ``flat``, d is multiplied by ``x² / (x + flat / 2) / |d|``, where
    ``x = max(|d| - flat, 0)``, and t is the new length over its value at the reach. A row that is not ``coupled`` has
    no third component in both d of the term with r. All these lengths, and the matrix, are in the row's own metric, in
    which the third axis is ``stretch`` times as long.

    Parameters
    ----------
    strokes : iterable of Stroke
    spacing : sequence of float
        Physical units per sample, x first; as many as the strokes have coordinates.
    time : bool
        Whether the third axis is time.
    frames : int
        The frames of the clip, from which rows get their stretch; 0: it is 1, as the spacing is stretched.

    Returns
    -------
    ndarray of STROKE_DTYPE
        One row a stroke, in physical units; a missing third coordinate is 0.
    """
    n, rows = len(spacing), []
    for i, stroke in enumerate(strokes):
        if stroke.ndim != n:
            refuse(f"strokes[{i}].at", f"a point of {n} numbers, as the medium has {n} axes", stroke.at)
        stretch = stretch_of(stroke, frames, spacing[2]) if frames else 1.0
        metric = (*spacing[:2], spacing[2] * stretch) if frames else spacing
        pivot, force = (
            (*(x * step for x, step in zip(v, spacing, strict=True)), 0.0)[:3] for v in (stroke.at, stroke.by)
        )
        matrix, power = matrix_of(stroke, metric, time=time), 1 if stroke.brush == "grab" else 3
        terms, turn = _terms(stroke.radius, poisson_of(stroke, time=time), stroke.scales, stroke.brush), 0.0
        if stroke.angle is not None and not stroke.chord:
            matrix, turn = _skew(_axis_of(stroke, metric)), 1.0
            terms = np.concatenate([terms[:1], math.radians(stroke.angle) * terms[1:]])
        reach = math.inf if stroke.reach is None else stroke.reach * stroke.radius
        coupled = not time or stroke.isotropic or stroke.poisson is not None
        own = reach, math.inf, (turn,) * 3, stretch, coupled, stroke.flat * stroke.radius, 0
        rows.append((pivot, force, matrix, *terms, stroke.scales, power, 0, *own))
    return np.array(rows, STROKE_DTYPE)


def matrix_of(stroke: Stroke, spacing: Sequence[float], *, time: bool = False) -> Floats:
    """Return ∂K/∂p at the pivot, in physical units, shape (3, 3): for a rotation R, it is R - I."""
    made, plane = np.zeros((3, 3)), time or stroke.ndim == 2
    axis = _axis_of(stroke, spacing)
    if stroke.angle is not None:
        angle, skew = math.radians(stroke.angle), _skew(axis)
        made = math.sin(angle) * skew + 2 * math.sin(angle / 2) ** 2 * (skew @ skew)
    elif stroke.factor is not None:
        within = np.diag([1.0, 1.0, 0.0 if plane else 1.0])
        if stroke.brush == "pinch" and plane and axis[2]:
            refuse("axis", "a direction within the frame, with a 0 for time", stroke.axis)
        along, power = np.outer(axis, axis), math.log(stroke.factor)
        if stroke.brush == "scale":
            made = math.expm1(power) * within
        else:
            made = math.expm1(power) * along + math.expm1(-power if plane else -power / 2) * (within - along)
    return made


def _axis_of(stroke: Stroke, spacing: Sequence[float]) -> Floats:
    """Return the unit vector along the axis of a twist or a pinch, in physical units."""
    axis = np.array((0.0, 0.0, 1.0))
    if (direction := stroke.direction) is not None:
        axis[: stroke.ndim] = np.multiply(direction, spacing)
        axis[stroke.ndim :] = 0.0
        axis /= np.abs(axis).max()  # so that no square overflows
        axis /= np.linalg.norm(axis)
    return axis


def _skew(axis: Floats) -> Floats:
    """Return the matrix of the cross product with an axis."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def poisson_of(stroke: Stroke, *, time: bool = False) -> float:
    """Return the Poisson ratio in effect; ``time`` says whether the third axis is time."""
    if stroke.poisson is not None:
        return stroke.poisson
    return -math.inf if time and not any(stroke.by[:2]) else POISSON


def time_radius_of(stroke: Stroke, frames: int, time_scale: float) -> float:
    """Return a stroke's radius in time, in frames, in a clip of some ``frames``, each ``time_scale`` pixels long."""
    whole = stroke.radius / time_scale
    if stroke.isotropic or stroke.time_radius is not None:
        return stroke.time_radius or whole
    drags = [by[2] for _, by in stroke.handles] + [p[2] - stroke.at[2] for p in stroke.path]
    return min(max(*map(abs, drags), frames / 8), whole)


def stretch_of(stroke: Stroke, frames: int, time_scale: float) -> float:
    """Return the stretch of time in a stroke's own metric, in which its radius in time equals that in space."""
    return 1.0 if stroke.isotropic else stroke.radius / (time_scale * time_radius_of(stroke, frames, time_scale))


@lru_cache(maxsize=256)
def _terms(radius: float, poisson: float, scales: int, brush: Brush) -> Floats:
    """Return the columns radius2, p, q and r of a row, as four rows."""
    # b/a of the kelvinlet (a itself cancels): from 0, at -inf, to 1/2, so that no sum here loses digits.
    ratio = 1 / (4 * (1 - poisson))
    made = np.zeros((4, 3))
    radius2, p, q, r = made
    radius2[:] = radius**2
    if brush != "grab":
        # For a rotation and a scale, the term with b vanishes, or is proportional to that with a.
        share = ratio if brush == "pinch" else 0.0
        scale = radius**3 / (2.5 - 2 * share)
        p[0], q[0], r[0] = scale * (1 - 2 * share), scale * 1.5 * radius**2, scale * 3 * share
        made.flags.writeable = False
        return made
    scale = radius * 2 / (3 - 2 * ratio)
    weights, m = _WEIGHTS[scales], scales
    radius2[:m] *= _RADIUS2[:m]
    p[:m] = weights * (scale * (1 - ratio))
    r[:m] = weights * (scale * ratio)
    q[:m] = weights * scale * radius2[:m] / 2
    if m > 1:
        # These must sum to exactly zero, or a remainder of 1/r would outlast 1/r⁵. The sums are exact.
        p[m - 1] = -p[: m - 1].sum()
        r[m - 1] = -r[: m - 1].sum()
    made.flags.writeable = False
    return made


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
    tolerance, last = 0.05 * stroke.radius, len(points) - 1
    while len(kept := [0, *_corners(places, 0, last, tolerance), last]) - 1 > 4 * max(1.0, length / stroke.radius):
        tolerance *= 2
    return tuple(
        replace(stroke, at=tuple(points[i].tolist()), by=tuple((points[j] - points[i]).tolist()), path=())
        for i, j in pairwise(kept)
    )


def _corners(points: Floats, first: int, last: int, tolerance: float) -> list[int]:
    """Return the indices of inner points that keep a part of a line within a tolerance (Douglas-Peucker)."""
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
