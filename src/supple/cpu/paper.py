"""T⁻¹ by the published iteration, kept as it is: a baseline to measure against, not what users run.

Haetinger and Gastal ("Fast Iterative Inversion for Non-linear Vector Fields Applied to Images, Videos and
Volumes", equations 4.3 to 4.6) invert each pixel by itself. From p = q on, p grows by μ A⁻¹ b, where

    ξ = T(p) - q,    b = -(Jᵀ + I) ξ,    A = JᵀJ + 2Jᵀ + I,

until |ξ| falls below a tenth of a pixel. The Gauss–Newton matrix is (I+J)ᵀ(I+J) = JᵀJ + Jᵀ + J + I instead,
as J is not symmetric; ``corrected`` takes that.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from supple.cpu import field
from supple.cpu.kernel import kernel, share, threads

Floats = npt.NDArray[np.float64]

_SINGULAR = 1e-200


@kernel
def _border(x, extent, sigma):
    """β and β' of a coordinate."""
    if sigma < 0.0:
        return 1.0, 0.0
    if sigma == 0.0:
        return 0.0, 0.0
    depth = min(x, extent - x)
    if depth >= sigma:
        return 1.0, 0.0
    scale = 0.5 * np.pi / sigma
    slope = scale * np.cos(scale * depth)
    return np.sin(scale * depth), slope if x + x < extent else -slope


@kernel
def _evaluate(stroke, axes, x, y):
    """K_β and the entries of J_β, row by row."""
    dx, dy = x - stroke["pivot"][0], y - stroke["pivot"][1]
    fx, fy = stroke["force"][0], stroke["force"][1]
    a, b, da, db = 0.0, 0.0, 0.0, 0.0
    for m in range(stroke["terms"]):
        p, q, r = stroke["p"][m], stroke["q"][m], stroke["r"][m]
        v2 = 1.0 / (dx * dx + dy * dy + stroke["radius2"][m])
        v1 = np.sqrt(v2)
        v3 = v1 * v2
        a += p * v1 + q * v3
        b += r * v3
        da -= v3 * (p + 3.0 * q * v2)
        db -= 3.0 * r * v3 * v2
    rf = dx * fx + dy * fy
    g, h = b * rf, db * rf
    kx, ky = a * fx + g * dx, a * fy + g * dy
    cx, cy = da * fx + h * dx, da * fy + h * dy
    beta_x, slope_x = _border(x, axes[0, 0], axes[0, 1])
    beta_y, slope_y = _border(y, axes[1, 0], axes[1, 1])
    xx = beta_x * (cx * dx + b * dx * fx + g) + slope_x * kx
    xy = beta_x * (cx * dy + b * dx * fy)
    yx = beta_y * (cy * dx + b * dy * fx)
    yy = beta_y * (cy * dy + b * dy * fy + g) + slope_y * ky
    return beta_x * kx, beta_y * ky, xx, xy, yx, yy


@kernel
def invert_rows(table, axes, xs, ys, first, last, mu, tolerance, limit, own, other, points, iterations, residual):
    """Invert T at the pixels (xs[i], ys[j]) of the rows ``first`` to ``last - 1``, each stroke by itself.

    ``own`` and ``other`` weigh Jᵀ and J in A: 2 and 0 as published, 1 and 1 as they should be. ``residual``
    is that of the stroke inverted last, in pixels.
    """
    sx, sy = axes[0, 2], axes[1, 2]
    for j in range(first, last):
        for i in range(xs.size):
            x, y = xs[i] * sx, ys[j] * sy
            count, error = 0, 0.0
            for k in range(table.shape[0] - 1, -1, -1):
                qx, qy = x, y
                for step in range(limit + 1):
                    kx, ky, a, b, c, d = _evaluate(table[k], axes, x, y)
                    ex, ey = x + kx - qx, y + ky - qy
                    error = np.sqrt((ex / sx) ** 2 + (ey / sy) ** 2)
                    if error < tolerance or step == limit:
                        break
                    m00 = a * a + c * c + (own + other) * a + 1.0
                    m01 = a * b + c * d + own * c + other * b
                    m10 = a * b + c * d + own * b + other * c
                    m11 = b * b + d * d + (own + other) * d + 1.0
                    vx, vy = -((a + 1.0) * ex + c * ey), -(b * ex + (d + 1.0) * ey)
                    determinant = m00 * m11 - m01 * m10
                    if abs(determinant) < _SINGULAR:
                        break
                    scale = mu / determinant
                    x += scale * (m11 * vx - m01 * vy)
                    y += scale * (m00 * vy - m10 * vx)
                    count += 1
            points[j, i, 0], points[j, i, 1] = x / sx, y / sy
            iterations[j, i] = count
            residual[j, i] = error


@kernel
def _evaluate_3d(stroke, axes, x, y, z, moved, slopes):
    """K_β into ``moved`` and J_β into ``slopes``."""
    at, force = (x, y, z), (stroke["force"][0], stroke["force"][1], stroke["force"][2])
    d = (x - stroke["pivot"][0], y - stroke["pivot"][1], z - stroke["pivot"][2])
    a, b, da, db = 0.0, 0.0, 0.0, 0.0
    for m in range(stroke["terms"]):
        p, q, r = stroke["p"][m], stroke["q"][m], stroke["r"][m]
        v2 = 1.0 / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + stroke["radius2"][m])
        v1 = np.sqrt(v2)
        v3 = v1 * v2
        a += p * v1 + q * v3
        b += r * v3
        da -= v3 * (p + 3.0 * q * v2)
        db -= 3.0 * r * v3 * v2
    rf = d[0] * force[0] + d[1] * force[1] + d[2] * force[2]
    for i in range(3):
        k = a * force[i] + b * rf * d[i]
        beta, slope = _border(at[i], axes[i, 0], axes[i, 1])
        moved[i] = beta * k
        for j in range(3):
            slopes[i, j] = beta * ((da * force[i] + db * rf * d[i]) * d[j] + b * d[i] * force[j])
        slopes[i, i] += beta * b * rf + slope * k


@kernel
def _solve_3d(m, v, step):
    """``step`` = m⁻¹ v by Cramer's rule; whether there is one."""
    determinant = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        determinant += m[0, i] * (m[1, j] * m[2, k] - m[1, k] * m[2, j])
    if abs(determinant) < _SINGULAR:
        return False
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        total = v[0] * (m[1, j] * m[2, k] - m[1, k] * m[2, j])
        total += v[1] * (m[2, j] * m[0, k] - m[2, k] * m[0, j])
        total += v[2] * (m[0, j] * m[1, k] - m[0, k] * m[1, j])
        step[i] = total / determinant
    return True


@kernel
def invert_rows_3d(table, axes, z, xs, ys, first, last, mu, tolerance, limit, own, other, points, iterations, residual):
    """The same as `invert_rows` in a plane of a video, ``z``, where points have three coordinates."""
    J, A = np.empty((3, 3)), np.empty((3, 3))
    p, q, moved, off, v, step = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for j in range(first, last):
        for i in range(xs.size):
            p[0], p[1], p[2] = xs[i] * axes[0, 2], ys[j] * axes[1, 2], z * axes[2, 2]
            count, error = 0, 0.0
            for k in range(table.shape[0] - 1, -1, -1):
                q[:] = p
                for turn in range(limit + 1):
                    _evaluate_3d(table[k], axes, p[0], p[1], p[2], moved, J)
                    error = 0.0
                    for c in range(3):
                        off[c] = p[c] + moved[c] - q[c]
                        error += (off[c] / axes[c, 2]) ** 2
                    error = np.sqrt(error)
                    if error < tolerance or turn == limit:
                        break
                    for a in range(3):
                        v[a] = -off[a]
                        for b in range(3):
                            v[a] -= J[b, a] * off[b]
                            A[a, b] = own * J[b, a] + other * J[a, b] + (1.0 if a == b else 0.0)
                            for c in range(3):
                                A[a, b] += J[c, a] * J[c, b]
                    if not _solve_3d(A, v, step):
                        break
                    for c in range(3):
                        p[c] += mu * step[c]
                    count += 1
            for c in range(3):
                points[j, i, c] = p[c] / axes[c, 2]
            iterations[j, i] = count
            residual[j, i] = error


def inverse_map(
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, int],
    *,
    z: float | None = None,
    mu: float = 0.5,
    tolerance: float = 0.1,
    limit: int = 200,
    corrected: bool = False,
    every: int = 1,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64], Floats]:
    """The source points of an image's pixels by the published method.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Each stroke is inverted by itself, the last one first.
    axes : float64 array, shape (3, 3)
        The packed domain.
    shape : (int, int)
        Rows and columns of the image, or of a plane.
    z : float, optional
        Which plane of a video or a volume, in samples.
    mu : float
        The part of each step that is taken.
    tolerance : float
        Iterations end where |T(p) - q| is below this, in pixels.
    limit : int
        The most iterations for one stroke.
    corrected : bool
        Whether A is the Gauss–Newton matrix.
    every : int
        Only every so many-th row and column, from the first on.

    Returns
    -------
    points : float32 array, shape (H, W, 2), or (H, W, 3) of a plane
        In pixels, x first.
    iterations : int64 array, shape (H, W)
        Of all strokes together.
    residual : float64 array, shape (H, W)
        |T(p) - q| of all strokes together, in pixels. Where it is not below the tolerance, the method has not
        converged, or the strokes' errors have added up.
    """
    xs, ys = np.arange(0.0, shape[1], every), np.arange(0.0, shape[0], every)
    points = np.empty((ys.size, xs.size, 2 if z is None else 3), np.float32)
    iterations, residual = np.empty(points.shape[:2], np.int64), np.empty(points.shape[:2])
    own, other = (1.0, 1.0) if corrected else (2.0, 0.0)
    parts = max(1, min(ys.size, 4 * threads()))
    edges = [ys.size * k // parts for k in range(parts + 1)]

    def work(k: int) -> None:
        rows = edges[k], edges[k + 1]
        options = mu, tolerance, limit, own, other
        if z is None:
            invert_rows(table, axes, xs, ys, *rows, *options, points, iterations, residual)
        else:
            invert_rows_3d(table, axes, z, xs, ys, *rows, *options, points, iterations, residual)

    share(work, range(parts))
    if table.size > 1:
        residual = _residual(table, axes, xs, ys, z, points)
    return points, iterations, residual


def _residual(
    table: npt.NDArray[np.void], axes: Floats, xs: Floats, ys: Floats, z: float | None, points: npt.NDArray[np.float32]
) -> Floats:
    n = points.shape[2]
    moved = np.zeros((3, xs.size * ys.size))
    moved[:n] = (points.reshape(-1, n) * axes[:n, 2]).T
    field.forward(table, axes, moved, np.empty((9, 0)))
    x, y, t = (moved[c].reshape(points.shape[:2]) / axes[c, 2] for c in range(3))
    return np.asarray(np.sqrt((x - xs) ** 2 + (y - ys[:, None]) ** 2 + (t - (z or 0.0)) ** 2))
