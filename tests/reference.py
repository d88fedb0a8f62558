"""Independent oracles: the printed equations in NumPy, written for being right and not for being fast."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.domain import Domain
from supple.folding import resolve
from supple.strokes import Stroke

Floats = npt.NDArray[np.float64]

GRADES = (1.0, 1.1, 1.21)


def kelvinlet(f: Floats, radius: float, poisson: float, r: Floats) -> Floats:
    """The regularized Kelvinlet, neither normalised nor multiplied by the shear modulus."""
    a = 1 / (4 * math.pi)
    b = a / (4 * (1 - poisson))
    rho = np.sqrt((r**2).sum(axis=-1, keepdims=True) + radius**2)
    along = (r * f).sum(axis=-1, keepdims=True)
    return np.asarray(((a - b) / rho + a * radius**2 / (2 * rho**3)) * f + b / rho**3 * along * r)


def grab(f: Floats, radius: float, poisson: float, scales: int, r: Floats) -> Floats:
    """K of a grab at distances r: f where r is 0."""
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

    def total(at: Floats) -> Floats:
        return np.asarray(sum(w * kelvinlet(f, e, poisson, at) for w, e in parts))

    held = total(np.zeros(len(f)))
    size = np.linalg.norm(held)
    return total(r) * (np.linalg.norm(f) / size if size > 0 else 0.0)


def fade(x: Floats, extent: float, border: float | None) -> Floats:
    """β: how much of the movement across the border is left at a coordinate within the domain."""
    if border is None:
        return np.ones_like(x)
    sigma = min(border, extent / 2)
    if sigma == 0:
        return np.zeros_like(x)
    depth = np.minimum(np.minimum(x, extent - x), sigma)
    return np.asarray(np.sin(np.pi / 2 * depth / sigma))


def displacement(stroke: Stroke, domain: Domain, points: Floats) -> Floats:
    """K_β at points (..., D), in physical units; beyond a fixed face, as at the nearest point of the face."""
    steps, extent = np.array(domain.spacing), np.array(domain.extent)
    near = points if domain.border is None else np.clip(points, 0, extent)
    pivot, force = np.array(stroke.at) * steps, np.array(stroke.by) * steps
    k = grab(force, stroke.radius, stroke.poisson, stroke.scales, near - pivot)
    beta = [fade(near[..., i], extent[i], domain.border) for i in range(domain.ndim)]
    return np.asarray(k * np.stack(beta, axis=-1))


def forward(strokes: Iterable[Stroke], domain: Domain, points: npt.ArrayLike) -> Floats:
    """T of points in samples, one stroke after the other."""
    steps = np.array(domain.spacing)
    p = np.asarray(points, np.float64) * steps
    for stroke in strokes:
        p = p + displacement(stroke, domain, p)
    return np.asarray(p / steps)


def carried_out(d: Deformation) -> list[Stroke]:
    """The strokes of a deformation as they are applied, if damped."""
    alphas = [resolve(stroke, d.domain, d.on_fold).alpha for stroke in d.strokes]
    return [
        replace(stroke, by=tuple(alpha * x for x in stroke.by)) for stroke, alpha in zip(d.strokes, alphas, strict=True)
    ]


def differences(function: Callable[[Floats], Floats], points: Floats, step: float) -> Floats:
    """The Jacobian of a function of points by central differences of the fourth order."""
    columns = []
    for axis in np.eye(points.shape[-1]):
        near = function(points + step * axis) - function(points - step * axis)
        far = function(points + 2 * step * axis) - function(points - 2 * step * axis)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def inverse(strokes: Sequence[Stroke], domain: Domain, points: npt.ArrayLike) -> Floats:
    """T⁻¹ in samples: each stroke is undone on its own, by damped steps with differences for a Jacobian."""
    steps = np.array(domain.spacing)
    q = np.asarray(points, np.float64) * steps
    for stroke in reversed(strokes):

        def moved(p: Floats, stroke: Stroke = stroke) -> Floats:
            return np.asarray(p + displacement(stroke, domain, p))

        p = q.copy()
        error = np.linalg.norm(moved(p) - q, axis=-1)
        for _ in range(200):
            jacobian = differences(moved, p, 1e-4 * stroke.radius)
            delta = np.linalg.solve(jacobian, (q - moved(p))[..., None])[..., 0]
            part = np.ones(error.shape)
            for _ in range(40):
                tried = np.linalg.norm(moved(p + part[..., None] * delta) - q, axis=-1)
                worse = tried > error * (1 - 1e-4 * part)
                if not worse.any():
                    break
                part = np.where(worse, part / 2, part)
            better = tried < error
            p = np.where(better[..., None], p + part[..., None] * delta, p)
            error = np.where(better, tried, error)
            if not better.any() or error.max() < 1e-13 * (1 + np.abs(q).max()):
                break
        q = p
    return np.asarray(q / steps)


def grid(shape: Sequence[int]) -> Floats:
    """The points of all pixels, x first."""
    axes = np.meshgrid(*[np.arange(n, dtype=np.float64) for n in shape], indexing="ij")
    return np.stack(axes[::-1], axis=-1)


def _cubic(t: Floats) -> Floats:
    x = np.abs(t)
    inner, outer = 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    return np.where(x < 1, inner, np.where(x < 2, outer, 0.0))


def _linear(t: Floats) -> Floats:
    return np.maximum(1 - np.abs(t), 0)


def _place(i: npt.NDArray[np.int64], n: int, rule: str) -> npt.NDArray[np.int64]:
    """The index that stands for each, -1 for none."""
    if rule == "edge":
        return np.clip(i, 0, n - 1)
    if rule == "constant":
        return np.where((i >= 0) & (i < n), i, -1)
    return np.array([*range(n), *range(n - 1, -1, -1)])[i % (2 * n)]


def sample(
    source: npt.NDArray[np.generic],
    points: Floats,
    filter: str,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
) -> npt.NDArray[np.generic]:
    """Samples of (H, W, C) at points (..., 2), in float64; in the source's own numbers for "nearest"."""
    height, width, channels = source.shape
    fill = np.broadcast_to(np.asarray(fill), (channels,))
    reach, kernel = {"nearest": (0, None), "linear": (1, _linear), "cubic": (2, _cubic)}[filter]

    def at(i: npt.NDArray[np.int64], j: npt.NDArray[np.int64]) -> npt.NDArray[np.generic]:
        i, j = _place(i, width, outside), _place(j, height, outside)
        return np.where(((i < 0) | (j < 0))[..., None], fill.astype(source.dtype), source[j, i])

    x, y = points[..., 0], points[..., 1]
    if kernel is None:
        return at(np.floor(x + 0.5).astype(np.int64), np.floor(y + 0.5).astype(np.int64))
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total = np.zeros((*x.shape, channels))
    for b in range(1 - reach, reach + 1):
        for a in range(1 - reach, reach + 1):
            weight = kernel(x - (left + a)) * kernel(y - (top + b))
            total += weight[..., None] * at(left + a, top + b).astype(np.float64)
    return total


def rounded(values: Floats, dtype: npt.DTypeLike) -> npt.NDArray[np.generic]:
    """As a type holds them: integers are rounded half up and bounded."""
    kind = np.dtype(dtype)
    if kind == np.bool_:
        return values >= 0.5
    if kind.kind == "f":
        return values.astype(kind)
    limits = np.iinfo(kind)
    high = np.floor(values + 0.5)
    inside = np.clip(high, float(limits.min), np.nextafter(float(limits.max), 0) if limits.max > 2**53 else limits.max)
    return inside.astype(kind)


def supersampled(source: npt.NDArray[np.generic], d: Deformation, n: int) -> Floats:
    """The mean of n × n samples of the cubic interpolant at the exact inverse, for each output pixel."""
    height, width = source.shape[:2]
    within = (np.arange(n) + 0.5) / n - 0.5
    total = np.zeros((height, width, source.shape[2]))
    for v in within:
        for u in within:
            total += sample(source, d.inverse(grid((height, width)) + np.array([u, v])).points, "cubic")
    return total / n**2


def psnr(a: npt.ArrayLike, b: npt.ArrayLike, peak: float = 255.0) -> float:
    """Peak signal to noise ratio in dB."""
    return float(10 * np.log10(peak**2 / np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2)))


KERNELS: dict[str, tuple[int, Callable[[Floats], Floats]]] = {"linear": (1, _linear), "cubic": (2, _cubic)}


def averaged(name: str, t: Floats, width: Floats) -> Floats:
    """A kernel's mean over a box of some width around t; the kernel itself where the box is no wider than nothing."""
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
    source: npt.NDArray[np.generic],
    points: Floats,
    filter: str,
    between: str,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    widths: npt.ArrayLike = 0.0,
) -> npt.NDArray[np.generic]:
    """Samples of (T, H, W, C) at points (..., 3), x first, averaged in time over ``widths`` frames.

    What lies outside follows the same rule along all three axes.
    """
    count, channels = source.shape[0], source.shape[3]
    t, spread = points[..., 2], np.broadcast_to(np.asarray(widths, np.float64), points.shape[:-1])
    absent = np.broadcast_to(np.asarray(fill).astype(source.dtype), (*source.shape[1:3], channels))
    reach = 2.5 + spread.max() / 2
    whole = filter == "nearest"
    total = np.zeros((*t.shape, channels), source.dtype if whole else np.float64)
    for k in range(math.floor(t.min() - reach), math.ceil(t.max() + reach) + 1):
        at = _place(np.array(k), count, outside)
        # Only where this frame counts: clips are larger than the stretch of time that a pixel sees.
        if between == "nearest":
            weight = (np.floor(t + 0.5) == k).astype(np.float64)
        else:
            weight = averaged(between, k - t, spread)
        seen = weight != 0
        if not seen.any():
            continue
        rule = "edge" if at < 0 else outside
        values = sample(absent if at < 0 else source[at], points[seen][:, :2], filter, rule, fill)
        if whole:
            total[seen] = values
        else:
            total[seen] += weight[seen][:, None] * values
    return total


def durations(d: Deformation, points: Floats) -> Floats:
    """How many frames an output pixel covers whose source point this is: the length of the row ∂p_t/∂q."""
    rows = np.linalg.inv(d.jacobian(points))[..., 2, :]
    return np.asarray(np.linalg.norm(rows, axis=-1))


def faded(length: Floats) -> Floats:
    """The box that stands for an extent in time: none up to one frame, all of it from 1.1."""
    return length * np.clip((length - 1) * 10, 0, 1)
