"""Samples of pictures and of frames: the printed interpolants, and averages of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Array = npt.NDArray[Any]


# ---------------------------------------------------------------- samples of a picture


def _cubic(t: Floats, a: float) -> Floats:
    """Return Keys' cubic convolution kernel."""
    x = np.abs(t)
    inner = ((a + 2) * x - (a + 3)) * x * x + 1  # powers are slow
    outer = a * (((x - 5) * x + 8) * x - 4)
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


def _at(source: Array, i: Integers, j: Integers, fill: Array) -> Array:
    """Return the samples at columns i and rows j, of which -1 is none."""
    none = (i < 0) | (j < 0)
    return np.asarray(np.where(none[..., None], fill, source[j, i]) if none.any() else source[j, i])


def _interpolated(source: Floats, x: Floats, y: Floats, name: str, rule: str, fill: Floats) -> Floats:
    """Return the interpolant's values: two by two samples, or four by four."""
    reach, kernel = {"linear": (1, _linear), "cubic": (2, _keys)}[name]

    def taps(at: Floats, n: int) -> list[tuple[Floats, Integers]]:
        near = [np.floor(at).astype(np.int64) + k for k in range(1 - reach, reach + 1)]
        return [(kernel(at - i), _place(i, n, rule)) for i in near]

    total, columns = np.zeros((*x.shape, source.shape[2])), taps(x, source.shape[1])
    for down, j in taps(y, source.shape[0]):
        for along, i in columns:
            total += (along * down)[..., None] * _at(source, i, j, fill)
    return total


def pyramid(source: Floats) -> list[Floats]:
    """Return all levels: 2×2 averages of the one before, whose last odd row or column counts twice; to one sample."""
    levels = [source]
    while max(levels[-1].shape[:2]) > 1:
        fine = levels[-1]
        fine = np.pad(fine, ((0, fine.shape[0] % 2), (0, fine.shape[1] % 2), (0, 0)), mode="edge")
        levels.append((fine[::2, ::2] + fine[1::2, ::2] + fine[::2, 1::2] + fine[1::2, 1::2]) / 4)
    return levels


LOW, RISE = 0.1, 0.2
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
        nearest = [np.floor(at + 0.5).astype(np.int64) for at in (x, y)]
        i, j = (_place(at, n, outside) for at, n in zip(nearest, source.shape[1::-1], strict=True))
        return _at(source, i, j, constant)
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
    if not (width > 1e-3).any():
        return kernel(t)
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
            weight, near = np.zeros(t.shape), np.abs(k - t) < 2 + spread / 2
            weight[near] = averaged(between, (k - t)[near], spread[near])
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
