"""Independent oracles: the equations in plain NumPy and float64, written for being right and not for being fast."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.domain import Domain
from supple.folding import resolve
from supple.strokes import Stroke

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Array = npt.NDArray[Any]

GRADES = (1.0, 1.1, 1.21)

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


def displacement(stroke: Stroke, domain: Domain, points: Floats) -> tuple[Floats, Floats]:
    """Return diag(β) m K at points (..., D) in physical units, and its Jacobian.

    Beyond a fixed face, the displacement is that of the nearest point of the face.
    """
    steps, (first, last) = np.array(domain.spacing), faces(domain)
    near = points if domain.border is None else np.clip(points, first, last)
    pivot, force = np.array(stroke.at) * steps, np.array(stroke.by) * steps
    r = near - pivot
    k, j = grab(force, stroke.radius, stroke.material(), stroke.scales, r)
    m, slope = support(r, radius_of_support(stroke))
    k, j = m[..., None] * k, m[..., None, None] * j + k[..., :, None] * slope[..., None, :]
    for i in range(domain.ndim):
        beta, change = fade(near[..., i] - first[i], last[i] - first[i], width(domain, i), domain.border_profile)
        j[..., i, :] *= beta[..., None]
        j[..., i, i] += change * k[..., i]
        k[..., i] *= beta
        j[..., :, i] *= (near[..., i] == points[..., i])[..., None]
    return k, j


def moved(strokes: Iterable[Stroke], domain: Domain, points: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return T and I + J of points in samples, one stroke after the other."""
    steps = np.array(domain.spacing)
    p = np.asarray(points, np.float64) * steps
    whole = np.broadcast_to(np.eye(domain.ndim), (*p.shape, domain.ndim))
    for stroke in strokes:
        k, j = displacement(stroke, domain, p)
        p, whole = p + k, whole + j @ whole
    return np.asarray(p / steps), np.asarray(whole * steps / steps[:, None])


def forward(strokes: Iterable[Stroke], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return T of points in samples."""
    return moved(strokes, domain, points)[0]


def jacobian(strokes: Iterable[Stroke], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return ∂T/∂p = I + J at points in samples, shape (..., D, D)."""
    return moved(strokes, domain, points)[1]


def inverse(strokes: Sequence[Stroke], domain: Domain, points: npt.ArrayLike) -> Floats:
    """Return T⁻¹ in samples: each stroke is undone on its own, by damped Newton steps to rounding."""
    steps = np.array(domain.spacing)
    q = np.asarray(points, np.float64) * steps
    p = q.reshape(-1, domain.ndim)
    for stroke in reversed(strokes):
        p = _undone(stroke, domain, p)
    return np.asarray(p.reshape(q.shape) / steps)


def _undone(stroke: Stroke, domain: Domain, q: Floats) -> Floats:
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


def matrices(strokes: Sequence[Stroke], domain: Domain, sources: npt.ArrayLike) -> Floats:
    """Return M = ∂p/∂q at source points p = T⁻¹(q)."""
    return np.asarray(np.linalg.inv(jacobian(strokes, domain, sources)))


def reached(strokes: Iterable[Stroke], domain: Domain, points: Floats) -> npt.NDArray[np.bool_]:
    """Return which points lie in the ball of any stroke; all do where reach is unlimited."""
    steps = np.array(domain.spacing)
    near = points * steps
    if domain.border is not None:
        near = np.clip(near, *faces(domain))
    found = np.zeros(points.shape[:-1], np.bool_)
    for stroke in strokes:
        if any(stroke.by):
            found |= np.linalg.norm(near - np.array(stroke.at) * steps, axis=-1) < radius_of_support(stroke)
    return found


def carried_out(d: Deformation) -> list[Stroke]:
    """Return the strokes of a deformation as they are applied, if damped."""
    alphas = [resolve(stroke, d.domain, d.on_fold).alpha for stroke in d.strokes]
    return [
        replace(stroke, by=tuple(alpha * x for x in stroke.by)) for stroke, alpha in zip(d.strokes, alphas, strict=True)
    ]


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


# ---------------------------------------------------------------- samples of a picture


def _cubic(t: Floats, a: float) -> Floats:
    """Return Keys' cubic convolution kernel."""
    x = np.abs(t)
    inner = (a + 2) * x**3 - (a + 3) * x**2 + 1
    outer = a * (x**3 - 5 * x**2 + 8 * x - 4)
    return np.where(x < 1, inner, np.where(x < 2, outer, 0.0))


def _keys(t: Floats) -> Floats:
    return _cubic(t, -0.75)


def _catmull_rom(t: Floats) -> Floats:
    return _cubic(t, -0.5)


def _linear(t: Floats) -> Floats:
    return np.asarray(np.maximum(1 - np.abs(t), 0))


def _place(i: Integers, n: int, rule: str) -> Integers:
    """Return the index that stands for each, -1 for none."""
    if rule == "edge":
        return np.clip(i, 0, n - 1)
    if rule == "constant":
        return np.where((i >= 0) & (i < n), i, -1)
    return np.asarray(np.array([*range(n), *range(n - 1, -1, -1)])[i % (2 * n)])


def _at(source: Array, i: Integers, j: Integers, rule: str, fill: Array) -> Array:
    """Return the samples at columns i and rows j, outside as the boundary mode has it."""
    height, width = source.shape[:2]
    i, j = _place(i, width, rule), _place(j, height, rule)
    found = source[j, i]
    return np.asarray(np.where(((i < 0) | (j < 0))[..., None], fill, found) if rule == "constant" else found)


def _interpolated(source: Floats, x: Floats, y: Floats, name: str, rule: str, fill: Floats) -> Floats:
    """Return the interpolant's values: two by two samples, or four by four."""
    reach, kernel = {"linear": (1, _linear), "cubic": (2, _keys)}[name]
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total = np.zeros((*x.shape, source.shape[2]))
    for b in range(1 - reach, reach + 1):
        down = kernel(y - (top + b))
        for a in range(1 - reach, reach + 1):
            weight = kernel(x - (left + a)) * down
            total += weight[..., None] * _at(source, left + a, top + b, rule, fill)
    return total


def pyramid(source: Floats) -> list[Floats]:
    """Return all levels: 2×2 averages of the one before, whose last odd row or column counts twice; to one sample."""
    levels = [source]
    while max(levels[-1].shape[:2]) > 1:
        fine = levels[-1]
        fine = np.pad(fine, ((0, fine.shape[0] % 2), (0, fine.shape[1] % 2), (0, 0)), mode="edge")
        levels.append((fine[::2, ::2] + fine[1::2, ::2] + fine[::2, 1::2] + fine[1::2, 1::2]) / 4)
    return levels


LOW, RISE = 0.05, 0.2
NARROW = 1.62
LONGEST = 400.0
SPACE, MOST = 1.7, 16


def _smoothstep(f: Floats) -> Floats:
    f = np.clip(f, 0, 1)
    return np.asarray(f * f * (3 - 2 * f))


class Residual:
    """The cubic interpolant averaged by what the residual footprint of each pixel asks for.

    S = M Mᵀ has the eigenvalues λ± = h ± d along u and across it; a pixel of the source is an average over one pixel
    already, so that what is missing has the variances max(λ± - 1, 0)/12.

    Parameters
    ----------
    source : array, shape (H, W, C)
    points : array, shape (N, 2)
    matrices : array, shape (N, 2, 2)
        M = ∂p/∂q, in samples per output pixel.
    outside, fill
        As `sample` takes them.
    """

    def __init__(self, source: Floats, points: Floats, matrices: Floats, outside: str, fill: Floats) -> None:
        self.levels = pyramid(source)
        self.outside, self.fill = outside, fill
        self.x, self.y = points[:, 0], points[:, 1]
        s = matrices @ np.swapaxes(matrices, -1, -2)
        half, xy = (s[:, 0, 0] - s[:, 1, 1]) / 2, s[:, 0, 1]
        mean, d = (s[:, 0, 0] + s[:, 1, 1]) / 2, np.hypot(half, xy)
        self.large, self.small = mean + d, mean - d
        # (S - hI)/d turns by twice the angle of u.
        angle = np.arctan2(xy, half) / 2
        self.cos, self.sin = np.cos(angle), np.sin(angle)

    def values(self) -> Floats:
        """Return the averages, shape (N, C)."""
        alpha, beta = np.maximum(self.large - 1, 0), np.maximum(self.small - 1, 0)
        total = np.empty((len(self.x), self.levels[0].shape[2]))
        wide = (alpha >= NARROW) | (self.small >= 3.2)
        plain = (alpha <= LOW) & ~wide
        narrow = ~plain & ~wide
        total[plain] = _interpolated(self.levels[0], self.x[plain], self.y[plain], "cubic", self.outside, self.fill)
        rise = np.minimum(1, RISE / (RISE - LOW) * (alpha[narrow] - LOW) / alpha[narrow])
        none = np.zeros(int(narrow.sum()))
        total[narrow] = self._spot(np.flatnonzero(narrow), 0, rise * alpha[narrow], rise * beta[narrow], none)
        total[wide] = self._wide(np.flatnonzero(wide))
        return total

    def _spot(self, which: Integers, level: int, along: Floats, across: Floats, offset: Floats) -> Floats:
        """Return the mean of four cubic samples that has the variances along/12 and across/12, and no others.

        Its middle is ``offset`` samples of the level from the point, along u.
        """
        cos, sin, unit = self.cos[which], self.sin[which], 2.0**level
        xx, yy = (along * cos**2 + across * sin**2) / 12, (along * sin**2 + across * cos**2) / 12
        xy = (along - across) * cos * sin / 12
        a, b = np.minimum(np.sqrt(xx), 0.4999), np.minimum(np.sqrt(yy), 0.4999)
        rho = np.divide(xy, a * b, out=np.zeros_like(xy), where=a * b > 0)
        x = (self.x[which] + 0.5) / unit - 0.5 + offset * cos
        y = (self.y[which] + 0.5) / unit - 0.5 + offset * sin
        total = np.zeros((len(which), self.levels[0].shape[2]))
        for i in (-1, 1):
            for j in (-1, 1):
                seen = _interpolated(self.levels[level], x + i * a, y + j * b, "cubic", self.outside, self.fill)
                total += ((1 + i * j * rho) / 4)[:, None] * seen
        return total

    def _wide(self, which: Integers) -> Floats:
        want = np.maximum(self.small[which], self.large[which] / LONGEST)
        level = np.zeros(len(which), np.int64)
        for _ in self.levels[1:]:
            level += (want / 4.0**level >= 4) & (level < len(self.levels) - 1)
        total = np.empty((len(which), self.levels[0].shape[2]))
        for k in np.unique(level).tolist():
            here = level == k
            total[here] = self._in_level(which[here], k)
            next_one = _smoothstep((want / 4.0**k - 3.2) / 0.8)
            mixed = here & (next_one > 0)
            if k + 1 < len(self.levels) and mixed.any():
                coarser = self._in_level(which[mixed], k + 1)
                total[mixed] += next_one[mixed, None] * (coarser - total[mixed])
        return total

    def _in_level(self, which: Integers, level: int) -> Floats:
        along = np.maximum(self.large[which] / 4.0**level - 1, 0)
        across = np.clip(self.small[which] / 4.0**level - 1, 0, 2.99)
        length = np.sqrt(along)
        count = np.minimum(np.floor(length / SPACE) + 1, MOST).astype(np.int64)
        total = np.empty((len(which), self.levels[0].shape[2]))
        for n in np.unique(count).tolist():
            here = count == n
            total[here] = self._row(which[here], level, n, length[here], across[here])
            next_one = _smoothstep(4 * (length / SPACE - (n - 1) - 0.75))
            mixed = here & (next_one > 0)
            if n < MOST and mixed.any():
                more = self._row(which[mixed], level, n + 1, length[mixed], across[mixed])
                total[mixed] += next_one[mixed, None] * (more - total[mixed])
        return total

    def _row(self, which: Integers, level: int, n: int, length: Floats, across: Floats) -> Floats:
        """Return the mean of n spots side by side along u."""
        along = np.minimum((length / n) ** 2, 3)
        offsets = [length * ((i + 0.5) / n - 0.5) for i in range(n)]
        return np.asarray(sum(self._spot(which, level, along, across, offset) for offset in offsets)) / n


def sample(
    source: Array,
    points: Floats,
    matrices: Floats | None = None,
    filter: str = "auto",
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
) -> Array:
    """Return samples of (H, W, C) at points (..., 2), in float64; in the source's own type for "nearest".

    Parameters
    ----------
    source : array, shape (H, W, C)
    points : array, shape (..., 2)
        In samples, x first.
    matrices : array, shape (..., 2, 2), optional
        M = ∂p/∂q of each point; for "auto".
    filter : str
        "nearest", "linear", "cubic" (Keys', a = -0.75) or "auto".
    outside : str
        "edge", "constant" or "reflect".
    fill : float, or one for each channel
    """
    channels = source.shape[2]
    x, y = points[..., 0], points[..., 1]
    if filter == "nearest":
        constant = np.broadcast_to(np.asarray(fill), (channels,)).astype(source.dtype)
        i, j = np.floor(x + 0.5).astype(np.int64), np.floor(y + 0.5).astype(np.int64)
        return _at(source, i, j, outside, constant)
    values, inside = source.astype(np.float64), np.broadcast_to(np.asarray(fill, np.float64), (channels,))
    if filter != "auto":
        return _interpolated(values, x, y, filter, outside, inside)
    assert matrices is not None, "the residual footprint needs a matrix for each point"
    every = np.broadcast_to(matrices, (*x.shape, 2, 2)).reshape(-1, 2, 2)
    found = Residual(values, points.reshape(-1, 2), every, outside, inside).values()
    return found.reshape(*x.shape, channels)


# ---------------------------------------------------------------- samples between frames


KERNELS: dict[str, tuple[int, Callable[[Floats], Floats]]] = {"linear": (1, _linear), "cubic": (2, _catmull_rom)}


def averaged(name: str, t: Floats, width: Floats) -> Floats:
    """Return a kernel's mean over a box of some width around t; the kernel itself where the box has no width."""
    reach, kernel = KERNELS[name]
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact for what is cubic between the knots
    low, high = t - width / 2, t + width / 2
    total = np.zeros(np.broadcast(t, width).shape)
    for knot in range(-reach, reach):
        a, b = np.clip(low, knot, knot + 1), np.clip(high, knot, knot + 1)
        for node, weight in zip(nodes, weights, strict=True):
            total += weight * (b - a) / 2 * kernel((a + b) / 2 + node * (b - a) / 2)
    return np.where(width > 1e-3, total / np.maximum(width, 1e-3), kernel(t))


def sample_frames(
    source: Array,
    points: Floats,
    filter: str,
    between: str,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    widths: npt.ArrayLike = 0.0,
    matrices: Floats | None = None,
) -> Array:
    """Return samples of (T, H, W, C) at points (..., 3), x first, averaged in time over ``widths`` frames.

    What lies outside follows the same rule along all three axes. ``matrices`` are the in-plane parts of M.
    """
    count, channels = source.shape[0], source.shape[3]
    t, spread = points[..., 2], np.broadcast_to(np.asarray(widths, np.float64), points.shape[:-1])
    every = None if matrices is None else np.broadcast_to(matrices, (*t.shape, 2, 2))
    whole = filter == "nearest"
    constant = np.broadcast_to(np.asarray(fill, source.dtype if whole else np.float64), (channels,))
    reach = 2.5 + spread.max() / 2
    total = np.zeros((*t.shape, channels), source.dtype if whole else np.float64)
    for k in range(math.floor(t.min() - reach), math.ceil(t.max() + reach) + 1):
        at = int(_place(np.array(k), count, outside))
        # Only where this frame counts: clips are larger than the stretch of time that a pixel sees.
        if between == "nearest":
            weight = (np.floor(t + 0.5) == k).astype(np.float64)
        else:
            weight = averaged(between, k - t, spread)
        seen = weight != 0
        if not seen.any():
            continue
        if at < 0:
            values = np.broadcast_to(constant, (int(seen.sum()), channels))
        else:
            part = None if every is None else every[seen]
            values = sample(source[at], points[seen][:, :2], part, filter, outside, fill)
        if whole:
            total[seen] = values
        else:
            total[seen] += weight[seen][:, None] * values
    return total


def durations(d: Deformation, points: Floats) -> Floats:
    """Return how many frames an output pixel covers whose source point this is: the length of the row ∂p_t/∂q."""
    rows = np.linalg.inv(d.jacobian(points))[..., 2, :]
    return np.asarray(np.linalg.norm(rows, axis=-1))


def faded(length: Floats) -> Floats:
    """Return the box that is missing to an extent in time: a frame stands for one already; at most 64."""
    return np.minimum(np.sqrt(np.maximum(length**2 - 1, 0)), 64.0)


# ---------------------------------------------------------------- types, opacity and light


def rounded(values: Floats, dtype: npt.DTypeLike) -> Array:
    """Return values as a type holds them: integers are rounded half up and bounded."""
    kind = np.dtype(dtype)
    if kind == np.bool_:
        return values >= 0.5
    if kind.kind == "f":
        return values.astype(kind)
    limits = np.iinfo(kind)
    high = np.floor(values + 0.5)
    inside = np.clip(high, float(limits.min), np.nextafter(float(limits.max), 0) if limits.max > 2**53 else limits.max)
    return inside.astype(kind)


def opaque(dtype: npt.DTypeLike) -> float:
    """Return the value of white, and of full opacity."""
    kind = np.dtype(dtype)
    return float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0


def light_of(v: Floats) -> Floats:
    """Return the amount of light of values on sRGB's curve, from 0 to 1."""
    return np.where(v <= 0.04045, v / 12.92, (np.maximum(v + 0.055, 0) / 1.055) ** 2.4)


def curve_of(u: Floats) -> Floats:
    """Return the values on sRGB's curve that stand for amounts of light."""
    return np.where(u <= 0.0031308, 12.92 * u, 1.055 * np.maximum(u, 0) ** (1 / 2.4) - 0.055)


def loaded(values: npt.ArrayLike, top: float, alpha: bool, linear_light: bool) -> Floats:
    """Return numbers as filters take them: in linear light if asked, and multiplied by opacity, their last channel."""
    made = np.array(values, np.float64)
    colours = made[..., :-1] if alpha else made
    if linear_light:
        colours[...] = top * light_of(colours / top)
    if alpha:
        colours *= made[..., -1:] / top
    return made


def stored(values: Floats, dtype: npt.DTypeLike, alpha: bool, linear_light: bool) -> Array:
    """Return filtered numbers as the type holds them: the reverse of `loaded`."""
    top, made = opaque(dtype), values.copy()
    colours = made[..., :-1] if alpha else made
    if alpha:
        opacity = values[..., -1:]
        # A cubic overshoots: the colours are divided by opacity as it is, which is then kept from clear to opaque.
        colours[...] = np.divide(colours * top, opacity, out=np.zeros_like(colours), where=opacity > 0)
        made[..., -1] = np.clip(made[..., -1], 0, top)
    if linear_light:
        colours[...] = top * curve_of(colours / top)
    return rounded(made, dtype)


# ---------------------------------------------------------------- whole warps


def warp(
    source: Array,
    strokes: Sequence[Stroke],
    domain: Domain,
    filter: str = "auto",
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
) -> Array:
    """Return an image (H, W) or (H, W, C) after strokes, in its own type.

    The strokes are carried out as they are: none is damped. Pixels in no stroke's ball are copied.
    """
    layers = source[None, ..., None] if source.ndim == 2 else source[None]
    q = grid(domain.shape)
    p = inverse(strokes, domain, q)
    m = matrices(strokes, domain, p)
    touched = reached(strokes, domain, q)
    made = _filtered(layers, p[None], m[None], filter, "image", outside, fill, alpha, linear_light, 0.0, touched[None])
    return np.asarray(made[0].reshape(source.shape))


def warp_frames(
    source: Array,
    strokes: Sequence[Stroke],
    domain: Domain,
    filter: str = "auto",
    between: str | None = None,
    time_filter: bool = False,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
) -> Array:
    """Return frames or slices (T, H, W) or (T, H, W, C) after strokes of three coordinates, in their own type."""
    layers = source[..., None] if source.ndim == 3 else source
    between = between or ("nearest" if filter == "nearest" else "linear")
    q = grid(domain.shape)
    p = inverse(strokes, domain, q)
    m = matrices(strokes, domain, p)
    widths = faded(np.linalg.norm(m[..., 2, :], axis=-1)) if time_filter else np.array(0.0)
    touched = reached(strokes, domain, q)
    plane = m[..., :2, :2]
    made = _filtered(layers, p, plane, filter, between, outside, fill, alpha, linear_light, widths, touched)
    return made.reshape(source.shape)


def _filtered(
    layers: Array,
    p: Floats,
    m: Floats,
    filter: str,
    between: str,
    outside: str,
    fill: npt.ArrayLike,
    alpha: bool | None,
    linear_light: bool,
    widths: npt.ArrayLike,
    touched: npt.NDArray[np.bool_],
) -> Array:
    channels, kind = layers.shape[-1], layers.dtype
    straight = (channels == 4 and kind.str[1:] in ("u1", "u2")) if alpha is None else alpha
    values, absent, top = layers, np.broadcast_to(np.asarray(fill, np.float64), (channels,)), opaque(kind)
    if filter != "nearest":
        values = loaded(layers, top, straight, linear_light)
        absent = loaded(absent, top, straight, linear_light)
    if between == "image":
        found = np.stack([sample(values[0], p[0], m[0], filter, outside, absent)])
    else:
        found = sample_frames(values, p, filter, between, outside, absent, widths, m)
    made = found if filter == "nearest" else stored(found, kind, straight, linear_light)
    return np.where(touched[..., None], made, layers)


# ---------------------------------------------------------------- truth


def supersampled(source: Array, d: Deformation, n: int) -> Floats:
    """Return the mean of n × n samples of the cubic interpolant at the exact inverse, for each output pixel."""
    height, width = source.shape[:2]
    within = (np.arange(n) + 0.5) / n - 0.5
    total = np.zeros((height, width, source.shape[2]))
    for v in within:
        for u in within:
            points = d.inverse(grid((height, width)) + np.array([u, v])).points
            total += sample(source, points, filter="cubic")
    return total / n**2


def psnr(a: npt.ArrayLike, b: npt.ArrayLike, peak: float = 255.0) -> float:
    """Return the peak signal to noise ratio in dB."""
    return float(10 * np.log10(peak**2 / np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2)))
