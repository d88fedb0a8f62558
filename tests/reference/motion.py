"""T, its Jacobian and its inverse, from the printed equations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import NdBSpline
from scipy.spatial.transform import Rotation

from supple.deformation import Deformation
from supple.folding.limits import resolve
from supple.space.domain import Domain
from supple.space.freezing import Freeze
from supple.strokes import Stroke, matrix_of, poisson_of

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Array = npt.NDArray[Any]

GRADES = (1.0, 1.1, 1.21)


@dataclass(frozen=True, eq=False)
class Turned:
    """An affine brush as it is carried out: with the matrix that it has at its pivot, in physical units.

    Of a twist that keeps distances, the stroke has the part of the angle that it turns by, and the matrix multiplies
    its displacement.
    """

    stroke: Stroke
    matrix: Floats


Alone = Stroke | Turned
Step = Alone | tuple[Alone, ...]
"""What is applied at once: one stroke, or several whose displacements of the same point are added."""

# ---------------------------------------------------------------- the map


def kelvinlet(f: Floats, radius: float, poisson: float, r: Floats) -> tuple[Floats, Floats]:
    """Return the regularized Kelvinlet at r and its Jacobian, neither normalised nor times the shear modulus.

    K = A f + B (r·f) r and J = 2A' f rᵀ + 2B' (r·f) r rᵀ + B (r fᵀ + (r·f) I), with ' = d/d|r|².
    """
    a = 1 / (4 * math.pi)
    b = a / (4 * (1 - poisson))
    rho = np.sqrt((r**2).sum(axis=-1) + radius**2)[..., None]
    along = (r * f).sum(axis=-1)[..., None]
    k = ((a - b) / rho + a * radius**2 / (2 * rho**3)) * f + b / rho**3 * along * r
    rho, along = rho[..., None], along[..., None]
    column, row = r[..., :, None], r[..., None, :]
    j = -((a - b) / rho**3 + 3 * a * radius**2 / (2 * rho**5)) * f[:, None] * row
    j = j - 3 * b / rho**5 * along * column * row + b / rho**3 * (column * f + along * np.eye(len(f)))
    return k, j


def grab(f: Floats, radius: float, poisson: float, scales: int, r: Floats) -> tuple[Floats, Floats]:
    """Return K of a grab of unlimited reach at distances r, f where r is 0; and its Jacobian."""
    e1, e2, e3 = (radius * grade for grade in GRADES)
    parts = {
        1: [(1.0, e1)],
        2: [(1.0, e1), (-1.0, e2)],
        3: [
            (1.0, e1),
            (-(e3**2 - e1**2) / (e3**2 - e2**2), e2),
            ((e2**2 - e1**2) / (e3**2 - e2**2), e3),
        ],
    }[scales]

    def total(at: Floats) -> tuple[Floats, Floats]:
        values = [(w, *kelvinlet(f, e, poisson, at)) for w, e in parts]
        return np.asarray(sum(w * k for w, k, _ in values)), np.asarray(sum(w * j for w, _, j in values))

    held = np.linalg.norm(total(np.zeros(len(f)))[0])
    scale = np.linalg.norm(f) / held if held > 0 else 0.0
    k, j = total(r)
    return k * scale, j * scale


def apart(f: Floats, radius: float, poisson: float, scales: int, r: Floats) -> tuple[Floats, Floats]:
    """Return K of a grab in a clip that does not couple time to the plane, and its Jacobian.

    The plane's part is that of the drag in it, and time's is A f. A depends on |r| alone, and K across the drag is A f:
    so that is K of as far away, but across.
    """
    k, j = grab(f * (1.0, 1.0, 0.0), radius, poisson, scales, r)
    length = np.linalg.norm(r, axis=-1)[..., None]
    own, slopes = grab(f * (0.0, 0.0, 1.0), radius, poisson, scales, length * (1.0, 0.0, 0.0))
    k[..., 2] = own[..., 2]
    j[..., 2, :] = slopes[..., 2, :1] * np.divide(r, length, out=np.zeros_like(r), where=length > 0)
    return k, j


def eased(flat: float, r: Floats) -> tuple[Floats, Floats]:
    """Return g r / |r| of a plateau of the radius ``flat``, g = x² / (x + flat/2), x = |r| - flat; and its Jacobian."""
    rho = np.maximum(np.linalg.norm(r, axis=-1), 1e-300)[..., None]
    x, way = np.maximum(rho - flat, 0.0), r / rho
    g, slope = x**2 / (x + flat / 2), x * (x + flat) / (x + flat / 2) ** 2
    along = way[..., :, None] * way[..., None, :]
    return g * way, (slope - g / rho)[..., None] * along + (g / rho)[..., None] * np.eye(r.shape[-1])


def stretch(stroke: Stroke, domain: Domain) -> float:
    """Return how much longer time is in a stroke's own metric: there, its radius in time is that in space."""
    if not domain.time or stroke.isotropic:
        return 1.0
    frames = stroke.time_radius
    if frames is None:
        ends = [by[2] for _, by in stroke.handles] + [p[2] - stroke.at[2] for p in stroke.path]
        frames = min(max(*np.abs(ends), domain.shape[0] / 8), stroke.radius / domain.spacing[2])
    return stroke.radius / (domain.spacing[2] * frames)


def kelvinlet_matrix(
    f: Floats, radius: float, poisson: float, r: Floats, trace: float | None = None
) -> tuple[Floats, Floats]:
    """Return the locally affine regularized Kelvinlet at r and its Jacobian, as `kelvinlet` does.

    K_F = -a (ρ⁻³ + 3ε²/2 ρ⁻⁵) F r + b [ρ⁻³ (F + Fᵀ + tr F I) - 3ρ⁻⁵ (rᵀFr) I] r; ``trace`` is put for tr F.
    """
    a = 1 / (4 * math.pi)
    b = a / (4 * (1 - poisson))
    near = f + f.T + (np.trace(f) if trace is None else trace) * np.eye(len(f))
    rho = np.sqrt((r**2).sum(axis=-1) + radius**2)[..., None]
    fr, nr, frf = r @ f.T, r @ near.T, np.einsum("...i,ij,...j->...", r, f, r)[..., None]
    shared = 1 / rho**3 + 3 * radius**2 / (2 * rho**5)
    k = -a * shared * fr + b * (nr / rho**3 - 3 / rho**5 * frf * r)
    # The gradient of ρ⁻ⁿ is -n ρ⁻ⁿ⁻² r, that of rᵀFr is (F + Fᵀ) r.
    slope = -3 / rho**5 - 15 * radius**2 / (2 * rho**7)
    rho, frf, row = rho[..., None], frf[..., None], r[..., None, :]
    j = -a * (shared[..., None] * f + (slope * fr)[..., None] * row)
    j = j + b * (near / rho**3 - 3 / rho**5 * nr[..., None] * row)
    bent = -3 / rho**5 * (row * frf * -5 / rho**2 + (r @ (f + f.T))[..., None, :])
    return k, j + b * (bent * r[..., None] - 3 / rho**5 * frf * np.eye(len(f)))


def turn(m: Floats, brush: str, radius: float, poisson: float, r: Floats) -> tuple[Floats, Floats]:
    """Return K of an affine brush of unlimited reach whose Jacobian at the pivot is m; and its Jacobian.

    The printed field of a skew F, a rotation too small to see, is without b; that of s I is the same but for a factor;
    and that of a pinch is of an F whose trace is 0. A finite rotation and a pinch that keeps areas are not quite that:
    they get the same profile for all of m, which is b = 0 and tr F = 0.
    """
    if not m.any():
        return np.zeros_like(r), np.zeros((*r.shape, len(m)))
    material = poisson if brush == "pinch" else -math.inf
    held = kelvinlet_matrix(m, radius, material, np.zeros(len(m)), trace=0.0)[1]
    scale = (m * held).sum() / (held * held).sum()  # held is m but for this factor
    k, j = kelvinlet_matrix(m, radius, material, r, trace=0.0)
    return k * scale, j * scale


def twist(stroke: Stroke, spacing: Floats, r: Floats) -> tuple[Floats, Floats]:
    """Return K of a twist that turns r about its axis by an angle that fades, θ w(|r|); and its Jacobian.

    K = R r - r and J = R - I + (dR/dφ) r ∇φᵀ, where R is a rotation by φ = θ w, in space, and w is the profile of a
    skew matrix, 1 at the pivot, times that of the reach.
    """
    n, axis = r.shape[-1], np.array([0.0, 0.0, 1.0])
    if n == 3 and stroke.axis is not None:
        axis = np.array(stroke.axis) * spacing
    axis = axis / np.linalg.norm(axis)
    lifted = np.zeros((*r.shape[:-1], 3))
    lifted[..., :n] = r
    e2, rho2 = stroke.radius**2, (r**2).sum(axis=-1) + stroke.radius**2
    m, slope = support(r, radius_of_support(stroke))
    w = (rho2**-1.5 + 1.5 * e2 * rho2**-2.5) * stroke.radius**3 / 2.5
    change = (-3 * rho2**-2.5 - 7.5 * e2 * rho2**-3.5) * stroke.radius**3 / 2.5
    assert stroke.angle is not None
    theta = math.radians(stroke.angle)
    phi, gradient = theta * m * w, theta * (m * change)[..., None] * r + theta * w[..., None] * slope
    rotation = Rotation.from_rotvec(phi.reshape(-1, 1) * axis).as_matrix().reshape(*phi.shape, 3, 3)
    seen = (rotation @ lifted[..., None])[..., 0]
    k, j = seen - lifted, rotation - np.eye(3)
    j[..., :n] += np.cross(axis, seen)[..., :, None] * gradient[..., None, :]
    return k[..., :n], j[..., :n, :n]


def support(r: Floats, reach: float) -> tuple[Floats, Floats]:
    """Return m(|r|/R) = 1 - 10t³ + 15t⁴ - 6t⁵, and its gradient in r; 1 without a limit."""
    if reach == math.inf:
        return np.ones(r.shape[:-1]), np.zeros(r.shape)
    t = np.minimum(np.linalg.norm(r, axis=-1) / reach, 1)
    inside = t < 1
    m = np.where(inside, 1 - 10 * t**3 + 15 * t**4 - 6 * t**5, 0.0)
    # dm/dt = -30 t² (1 - t)², and the gradient of t is r / (R² t).
    return m, (np.where(inside, -30 * t * (1 - t) ** 2, 0.0) / reach**2)[..., None] * r


def faces(domain: Domain) -> tuple[Floats, Floats]:
    """Return the faces in physical units, x first: the outer edges of the samples, or the centres, the paper's."""
    n = np.array(domain.shape[::-1])
    edge = np.where(n > 1, 0.0 if domain.border_profile == "sine" else 0.5, 0.0)
    return -edge * domain.spacing, (n - 1 + edge) * domain.spacing


def width(domain: Domain, i: int) -> float | None:
    """Return the width of the border along an axis."""
    if domain.border == "auto":
        first, last = faces(domain)
        return 0.1 * float(last[i] - first[i])
    return domain.border[i] if isinstance(domain.border, tuple) else domain.border


def fade(x: Floats, extent: float, border: float | None, profile: str) -> tuple[Floats, Floats]:
    """Return β, how much of the movement across the border is left at a coordinate in the domain, and its slope."""
    if border is None:
        return np.ones_like(x), np.zeros_like(x)
    sigma = min(border, extent / 2)
    if sigma == 0:
        return np.zeros_like(x), np.zeros_like(x)
    low, high = x, extent - x
    t = np.minimum(np.minimum(low, high) / sigma, 1)
    slope = np.where(t < 1, np.where(low < high, 1.0, -1.0), 0.0) / sigma
    if profile == "sine":
        return np.sin(np.pi / 2 * t), slope * np.pi / 2 * np.cos(np.pi / 2 * t)
    return 2 * t - 2 * t**3 + t**4, slope * (2 - 6 * t**2 + 4 * t**3)


def radius_of_support(stroke: Stroke) -> float:
    """Return R in physical units, infinite without a limit."""
    return math.inf if stroke.reach is None else stroke.reach * stroke.radius


def freedom(freeze: Freeze, points: Floats, axis: int | None = None) -> Floats:
    """Return m of a freeze mask at points (..., D) in samples, or its derivative along an axis, by another library."""
    kept = [k for k, n in enumerate(freeze.size) if n > 1]
    if axis is not None and axis not in kept:  # a clip's mask is the same in all frames
        return np.zeros(points.shape[:-1])
    values, knots, at = np.ascontiguousarray(freeze.coefficients.T / 255).squeeze(), [], []
    if not kept:
        return np.full(points.shape[:-1], values)
    for k in kept:
        n, h, first = freeze.size[k], freeze.step[k], freeze.first[k]
        knots.append(first + h * np.arange(-2, n + 2))
        at.append(np.clip(points[..., k], first + h, first + (n - 2) * h))
    return np.asarray(NdBSpline(tuple(knots), values, 3)(np.stack(at, -1), nu=[int(k == axis) for k in kept]))


def frozen(domain: Domain, points: Floats) -> npt.NDArray[np.bool_]:
    """Return where nothing moves, nor just beside it: at points (..., D) in samples."""
    if domain.freeze is None:
        return np.zeros(points.shape[:-1], np.bool_)
    corners = itertools.product((-0.3, 0.3), repeat=domain.ndim)
    return np.all([freedom(domain.freeze, points + np.array(c)) == 0 for c in corners], axis=0)


def displacement(step: Step, domain: Domain, points: Floats) -> tuple[Floats, Floats]:
    """Return diag(β) m K at points (..., D) in physical units, and its Jacobian; of several strokes, the sums.

    With a freeze mask, that is times its m.

    Beyond a fixed face, the displacement is that of the nearest point of the face.
    """
    if isinstance(step, tuple):
        parts = [displacement(one, domain, points) for one in step]
        return np.asarray(sum(k for k, _ in parts)), np.asarray(sum(j for _, j in parts))
    stroke = step.stroke if isinstance(step, Turned) else step
    steps, (first, last) = np.array(domain.spacing), faces(domain)
    near = points if domain.border is None else np.clip(points, first, last)
    r, material = near - np.array(stroke.at) * steps, poisson_of(stroke, time=domain.time)
    metric, coupled = np.ones(domain.ndim), not domain.time or stroke.isotropic or stroke.poisson is not None
    metric[2:] = stretch(stroke, domain)
    r, change_of_r, reach = metric * r, np.eye(domain.ndim), radius_of_support(stroke)
    if stroke.flat:
        flat = stroke.flat * stroke.radius
        reach = float(eased(flat, np.array([reach]))[0][0])
        r, change_of_r = eased(flat, r)
    turns = stroke.brush == "twist" and not stroke.chord
    if turns:
        k, j = twist(stroke, steps * metric, r)
        if isinstance(step, Turned):
            k, j = k @ step.matrix.T, step.matrix @ j
    elif stroke.brush == "grab":
        field = grab if coupled else apart
        k, j = field(np.array(stroke.by) * steps * metric, stroke.radius, material, stroke.scales, r)
    else:
        whole = step.matrix if isinstance(step, Turned) else matrix_of(stroke, steps * metric, time=domain.time)
        k, j = turn(whole[: domain.ndim, : domain.ndim], stroke.brush, stroke.radius, material, r)
        if not coupled:
            k[..., 2], j[..., 2, :] = 0.0, 0.0
    m, slope = support(r, math.inf if turns else reach)
    k, j = m[..., None] * k, m[..., None, None] * j + k[..., :, None] * slope[..., None, :]
    k, j = k / metric, j @ change_of_r * metric / metric[:, None]
    if domain.freeze is not None:
        m = freedom(domain.freeze, near / steps)
        slope = np.stack([freedom(domain.freeze, near / steps, i) for i in range(domain.ndim)], -1) / steps
        k, j = m[..., None] * k, m[..., None, None] * j + k[..., :, None] * slope[..., None, :]
    for i in range(domain.ndim):
        beta, change = fade(near[..., i] - first[i], last[i] - first[i], width(domain, i), domain.border_profile)
        j[..., i, :] *= beta[..., None]
        j[..., i, i] += change * k[..., i]
        k[..., i] *= beta
        j[..., :, i] *= (near[..., i] == points[..., i])[..., None]
    return k, j


def moved(strokes: Iterable[Step], domain: Domain, points: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return T and I + J of points in samples, one stroke after the other."""
    steps = np.array(domain.spacing)
    p = np.asarray(points, np.float64) * steps
    whole = np.broadcast_to(np.eye(domain.ndim), (*p.shape, domain.ndim))
    for stroke in strokes:
        k, j = displacement(stroke, domain, p)
        p, whole = p + k, whole + j @ whole
    return np.asarray(p / steps), np.asarray(whole * steps / steps[:, None])


def forward(strokes: Iterable[Step], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return T of points in samples."""
    return moved(strokes, domain, points)[0]


def jacobian(strokes: Iterable[Step], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return ∂T/∂p = I + J at points in samples, shape (..., D, D)."""
    return moved(strokes, domain, points)[1]


def inverse(strokes: Sequence[Step], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return T⁻¹ in samples: each stroke is undone on its own, by damped Newton steps to rounding."""
    steps = np.array(domain.spacing)
    q = np.asarray(points, np.float64) * steps
    p = q.reshape(-1, domain.ndim)
    for stroke in reversed(strokes):
        p = _undone(stroke, domain, p)
    return np.asarray(p.reshape(q.shape) / steps)


def _undone(stroke: Step, domain: Domain, q: Floats) -> Floats:
    def missed(p: Floats, q: Floats) -> tuple[Floats, Floats, Floats]:
        k, j = displacement(stroke, domain, p)
        gap = q - p - k
        return gap, j + np.eye(domain.ndim), np.linalg.norm(gap, axis=-1)

    size = 1 + np.abs(q).max(initial=0)
    p, left = q.copy(), np.arange(len(q))
    gap, whole, error = missed(p, q)
    away = error.copy()
    for _ in range(200):
        unsolved = error >= 1e-14 * size
        left, gap, whole, error = (a[unsolved] for a in (left, gap, whole, error))
        if not len(left):
            break
        step, part = np.linalg.solve(whole, gap[..., None])[..., 0], np.ones(error.shape)
        tried = p[left] + step
        found = missed(tried, q[left])
        for _ in range(40):
            worse = np.flatnonzero(found[2] > error * (1 - 1e-4 * part))
            if not len(worse):
                break
            part[worse] /= 2
            tried[worse] = p[left[worse]] + part[worse, None] * step[worse]
            for values, new in zip(found, missed(tried[worse], q[left[worse]]), strict=True):
                values[worse] = new
        better = found[2] < error  # the others are as near as rounding lets them be
        left, (gap, whole, error) = left[better], (a[better] for a in found)
        p[left], away[left] = tried[better], error
    assert away.max(initial=0) < 1e-9 * size, "the oracle found no inverse"
    return p


def matrices(strokes: Sequence[Step], domain: Domain, sources: npt.ArrayLike) -> Floats:
    """Return M = ∂p/∂q at source points p = T⁻¹(q)."""
    return np.asarray(np.linalg.inv(jacobian(strokes, domain, sources)))


def reached(strokes: Iterable[Step], domain: Domain, points: Floats) -> npt.NDArray[np.bool_]:
    """Return which points lie in the ball of any stroke; all do where reach is unlimited."""
    steps = np.array(domain.spacing)
    near = points * steps
    if domain.border is not None:
        near = np.clip(near, *faces(domain))
    found = np.zeros(points.shape[:-1], np.bool_)
    for step in strokes:
        for one in step if isinstance(step, tuple) else (step,):
            stroke = one.stroke if isinstance(one, Turned) else one
            if not stroke.is_still:
                r = near - np.array(stroke.at) * steps
                r[..., 2:] *= stretch(stroke, domain)
                found |= np.linalg.norm(r, axis=-1) < radius_of_support(stroke)
    return found


def carried_out(d: Deformation) -> list[Step]:
    """Return the strokes of a deformation as they are applied: damped, or as many as one that flows is made of."""
    made: list[Step] = []
    n, steps = d.ndim, np.array(d.domain.spacing)
    for stroke in d.strokes:
        resolved = resolve(stroke, d.domain, d.on_fold)
        if d.domain.time and not stroke.isotropic:  # by that of the whole drag
            own = stroke.radius / (steps[2] * stretch(stroke, d.domain))
            stroke = replace(stroke, time_radius=own)
        if stroke.brush == "twist" and not stroke.chord:
            part = stroke.weakened(resolved.alpha / max(len(resolved.rows), 1))
            made += [Turned(part, np.diag(row["turn"][:n])) for row in resolved.rows]
        elif stroke.brush != "grab":
            made += [Turned(stroke, row["matrix"]) for row in resolved.rows]
        elif d.on_fold == "flow":
            ways = [(row["pivot"][:n] / steps, row["force"][:n] / steps) for row in resolved.rows]
            made += [replace(stroke, at=tuple(at.tolist()), by=tuple(by.tolist())) for at, by in ways]
        else:
            made.append(replace(stroke, by=tuple(resolved.alpha * x for x in stroke.by)))
    return made


def differences(function: Callable[[Floats], Floats], points: Floats, step: float) -> Floats:
    """Return the Jacobian of a function of points by central differences of the fourth order."""
    columns = []
    for axis in np.eye(points.shape[-1]):
        near = function(points + step * axis) - function(points - step * axis)
        far = function(points + 2 * step * axis) - function(points - 2 * step * axis)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def grid(shape: Sequence[int]) -> Floats:
    """Return the points of all pixels, x first."""
    axes = np.meshgrid(*[np.arange(n, dtype=np.float64) for n in shape], indexing="ij")
    return np.stack(axes[::-1], axis=-1)
