"""T and its Jacobian at a point, computed by one thread: the strokes of a table, one after the other.

A stroke moves the point p by β(p) K(p'), where p' is p, clamped to the domain along axes with a fixed border. With
r = p' - pivot, K = A v + B (r·v) r, where v is the force f of a grab, or M r. A and B are functions of s = |r|²,
multiplied by m(√s / R) if the stroke has a reach R. Strokes that are joined to the one before them act at the same
point as that.

Deformations are one flat array of float64: for each, the DOMAIN numbers of its domain; then all strokes, STROKE numbers
each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import cuda

from supple.engines.cuda.kernel import device, kernel, lean

# For each axis of a domain: its faces, sigma, spacing and profile (0 for the quartic, 1 for the sine).
FIRST_FACE, LAST_FACE, SIGMA, SPACING, PROFILE, AXIS = 0, 1, 2, 3, 4, 5
DOMAIN = 3 * AXIS
Y_AXIS, Z_AXIS = AXIS, 2 * AXIS
# For a stroke: pivot, force, number of terms, radius², p, q and r of each term, reach: R² and 1 / R², power, 1 if it is
# joined, and the matrix, row by row.
PIVOT, FORCE, TERMS, TERM, REACH2, NEARNESS, POWER, JOINED, MATRIX, STROKE = 0, 3, 6, 7, 19, 20, 21, 22, 23, 32
UNLIMITED = 1e300  # R² of a stroke without a reach: larger than any square of a distance

HALF_PI = math.pi / 2

Floats = npt.NDArray[np.float64]


def packed(tables: Sequence[npt.NDArray[np.void]], domains: Sequence[Floats]) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Return deformations in the layout of the kernels: their numbers, and the range of strokes of each.

    Parameters
    ----------
    tables : sequence of arrays of STROKE_DTYPE
    domains : sequence of float64 arrays, shape (3, 5)
    """
    rows = []
    for table in tables:
        out = np.zeros((table.size, STROKE))
        out[:, PIVOT : PIVOT + 3], out[:, FORCE : FORCE + 3], out[:, TERMS] = (
            table["pivot"],
            table["force"],
            table["terms"],
        )
        for k, name in enumerate(("radius2", "p", "q", "r")):
            out[:, TERM + k : REACH2 : 4] = table[name]
        reach2 = np.minimum(table["reach"] ** 2, UNLIMITED)
        out[:, REACH2], out[:, NEARNESS] = reach2, np.where(reach2 < UNLIMITED, 1.0 / reach2, 0.0)
        out[:, POWER], out[:, JOINED], out[:, MATRIX:] = table["power"], table["joined"], table["matrix"].reshape(-1, 9)
        rows.append(out.ravel())
    known = np.concatenate([*(np.asarray(d, np.float64).ravel() for d in domains), *rows])
    return known, np.cumsum([0, *(t.size for t in tables)]).astype(np.int32)


@lean
def sine(x):
    # Taylor's series: to the last bit on [0, π/2].
    t = x * x
    y = -1.9572941063391263e-20
    y = y * t + 8.2206352466243295e-18
    y = y * t - 2.8114572543455206e-15
    y = y * t + 7.6471637318198164e-13
    y = y * t - 1.6059043836821613e-10
    y = y * t + 2.5052108385441720e-08
    y = y * t - 2.7557319223985893e-06
    y = y * t + 1.9841269841269841e-04
    y = y * t - 8.3333333333333332e-03
    y = y * t + 1.6666666666666666e-01
    return x - x * t * y


@lean
def edge(x, first, last, sigma, profile):
    """Return β and β' of a coordinate, its nearest coordinate in the domain, and 1 if the two are equal."""
    if sigma < 0.0:
        return 1.0, 0.0, x, 1.0
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    v = min(max(x, first), last)
    t = min(min(v - first, last - v) / sigma, 1.0)
    if profile == 0.0:
        beta, slope = t * (2.0 + t * t * (t - 2.0)), (2.0 + t * t * (4.0 * t - 6.0)) / sigma
    else:
        beta, slope = sine(HALF_PI * t), sine(HALF_PI * (1.0 - t)) * HALF_PI / sigma
    return beta, slope if v + v < first + last else -slope, v, 1.0 if v == x else 0.0


@lean
def term(r2, n, e, p, q, r):
    """Return A, B, 2A' and 2B' of a term of a stroke of power n, for the squared distance to the pivot."""
    v2 = 1.0 / (r2 + e)
    v = math.sqrt(v2)
    if n == 3.0:
        v *= v2
    next_ = v * v2
    m = n + 2.0
    return p * v + q * next_, r * next_, -next_ * (n * p + m * q * v2), -m * r * next_ * v2


@lean
def limited(r2, nearness, a, b, da, db):
    """Return A, B, 2A' and 2B' times m(t), t = |r| / R: m = (1-t)³ (1 + 3t + 6t²), dm/ds = -15 t (1-t)² / R²."""
    t = math.sqrt(r2 * nearness)
    u = 1.0 - t
    m = u * u * u * (1.0 + t * (3.0 + 6.0 * t))
    dm = -30.0 * t * u * u * nearness
    return m * a, m * b, m * da + dm * a, m * db + dm * b


@lean
def displacement(dx, dy, dz, fx, fy, fz, a, b):
    """Return K = A v + B (r·v) r."""
    g = b * (dx * fx + dy * fy + dz * fz)
    return a * fx + g * dx, a * fy + g * dy, a * fz + g * dz


@lean
def gradient(dx, dy, dz, fx, fy, fz, wx, wy, wz, b, da, db):
    """Return J - A M, row by row: of row i, (2A' v_i + 2B' (r·v) r_i) rᵀ + B r_i wᵀ + B (r·v) e_iᵀ, w = v + Mᵀr."""
    rf = dx * fx + dy * fy + dz * fz
    g, h = b * rf, db * rf
    cx, cy, cz = da * fx + h * dx, da * fy + h * dy, da * fz + h * dz
    ex, ey, ez = b * dx, b * dy, b * dz
    return (
        cx * dx + ex * wx + g,
        cx * dy + ex * wy,
        cx * dz + ex * wz,
        cy * dx + ey * wx,
        cy * dy + ey * wy + g,
        cy * dz + ey * wz,
        cz * dx + ez * wx,
        cz * dy + ez * wy,
        cz * dz + ez * wz + g,
    )


@lean
def product(a, b, c, d, e, f, g, h, k, p, q, r, s, t, u, v, w, x):
    """Return the product of two matrices, row by row."""
    return (
        a * p + b * s + c * v,
        a * q + b * t + c * w,
        a * r + b * u + c * x,
        d * p + e * s + f * v,
        d * q + e * t + f * w,
        d * r + e * u + f * x,
        g * p + h * s + k * v,
        g * q + h * t + k * w,
        g * r + h * u + k * x,
    )


@lean
def inverted(a, b, c, d, e, f, g, h, k):
    """Return the inverse of a matrix, row by row."""
    ca, cb, cc = e * k - f * h, f * g - d * k, d * h - e * g
    t = 1.0 / (a * ca + b * cb + c * cc)
    return (
        t * ca,
        t * (c * h - b * k),
        t * (b * f - c * e),
        t * cb,
        t * (a * k - c * g),
        t * (c * d - a * f),
        t * cc,
        t * (b * g - a * h),
        t * (a * e - b * d),
    )


@device
def profiles(known, s, r2):
    """Return A, B, 2A' and 2B' of a stroke, summed over its terms, within its reach."""
    a, b, da, db = 0.0, 0.0, 0.0, 0.0
    for m in range(int(known[s + TERMS])):
        t = s + TERM + 4 * m
        more_a, more_b, more_da, more_db = term(
            r2, known[s + POWER], known[t], known[t + 1], known[t + 2], known[t + 3]
        )
        a += more_a
        b += more_b
        da += more_da
        db += more_db
    if known[s + NEARNESS] > 0.0:
        a, b, da, db = limited(r2, known[s + NEARNESS], a, b, da, db)
    return a, b, da, db


@device
def driving(known, s, dx, dy, dz):
    """Return v of a stroke: its force, or M r."""
    if known[s + POWER] == 1.0:
        return known[s + FORCE], known[s + FORCE + 1], known[s + FORCE + 2]
    m = s + MATRIX
    return (
        known[m] * dx + known[m + 1] * dy + known[m + 2] * dz,
        known[m + 3] * dx + known[m + 4] * dy + known[m + 5] * dz,
        known[m + 6] * dx + known[m + 7] * dy + known[m + 8] * dz,
    )


@device
def edges(known, at, x, y, z):
    """Return `edge` of each coordinate, in the domain at ``at``."""
    i, j, k = at, at + Y_AXIS, at + Z_AXIS
    bx, slope_x, nx, ox = edge(x, known[i + FIRST_FACE], known[i + LAST_FACE], known[i + SIGMA], known[i + PROFILE])
    by, slope_y, ny, oy = edge(y, known[j + FIRST_FACE], known[j + LAST_FACE], known[j + SIGMA], known[j + PROFILE])
    bz, slope_z, nz, oz = edge(z, known[k + FIRST_FACE], known[k + LAST_FACE], known[k + SIGMA], known[k + PROFILE])
    return bx, by, bz, slope_x, slope_y, slope_z, nx, ny, nz, ox, oy, oz


@device
def first_of(known, first, s):
    """Return the first stroke of those that act at once with the one at ``s``, from ``first`` on."""
    while s > first and known[s + JOINED] != 0.0:
        s -= STROKE
    return s


@device
def moved(known, at, first, last, x, y, z):
    """Return T of a point, by strokes ``first`` to ``last``, in the domain at ``at``."""
    px, py, pz = x, y, z
    for s in range(first, last, STROKE):
        if known[s + JOINED] == 0.0:
            px, py, pz = x, y, z
        bx, by, bz, _, _, _, nx, ny, nz, _, _, _ = edges(known, at, px, py, pz)
        dx, dy, dz = nx - known[s], ny - known[s + 1], nz - known[s + 2]
        r2 = dx * dx + dy * dy + dz * dz
        if r2 < known[s + REACH2]:
            a, b, _, _ = profiles(known, s, r2)
            fx, fy, fz = driving(known, s, dx, dy, dz)
            kx, ky, kz = displacement(dx, dy, dz, fx, fy, fz, a, b)
            x += bx * kx
            y += by * ky
            z += bz * kz
    return x, y, z


@device
def carried(known, at, s, x, y, z):
    """Return a stroke's displacement of a point, and its Jacobian, row by row."""
    bx, by, bz, slope_x, slope_y, slope_z, nx, ny, nz, ox, oy, oz = edges(known, at, x, y, z)
    dx, dy, dz = nx - known[s], ny - known[s + 1], nz - known[s + 2]
    r2 = dx * dx + dy * dy + dz * dz
    if not r2 < known[s + REACH2]:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fx, fy, fz = driving(known, s, dx, dy, dz)
    wx, wy, wz = fx, fy, fz
    a, b, da, db = profiles(known, s, r2)
    kx, ky, kz = displacement(dx, dy, dz, fx, fy, fz, a, b)
    m = s + MATRIX
    if known[s + POWER] != 1.0:
        wx += known[m] * dx + known[m + 3] * dy + known[m + 6] * dz
        wy += known[m + 1] * dx + known[m + 4] * dy + known[m + 7] * dz
        wz += known[m + 2] * dx + known[m + 5] * dy + known[m + 8] * dz
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = gradient(dx, dy, dz, fx, fy, fz, wx, wy, wz, b, da, db)
    return (
        bx * kx,
        by * ky,
        bz * kz,
        ox * (bx * (m00 + a * known[m]) + slope_x * kx),
        oy * bx * (m01 + a * known[m + 1]),
        oz * bx * (m02 + a * known[m + 2]),
        ox * by * (m10 + a * known[m + 3]),
        oy * (by * (m11 + a * known[m + 4]) + slope_y * ky),
        oz * by * (m12 + a * known[m + 5]),
        ox * bz * (m20 + a * known[m + 6]),
        oy * bz * (m21 + a * known[m + 7]),
        oz * (bz * (m22 + a * known[m + 8]) + slope_z * kz),
    )


@device
def moved_with_matrix(known, at, first, last, x, y, z):
    """Return T of a point, and its Jacobian, row by row: twelve numbers."""
    a, b, c, d, e, f, g, h, k = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    px, py, pz = x, y, z
    pa, pb, pc, pd, pe, pf, pg, ph, pk = a, b, c, d, e, f, g, h, k
    for s in range(first, last, STROKE):
        if known[s + JOINED] == 0.0:
            px, py, pz = x, y, z
            pa, pb, pc, pd, pe, pf, pg, ph, pk = a, b, c, d, e, f, g, h, k
        ux, uy, uz, p, q, r, t, u, v, w, m, n = carried(known, at, s, px, py, pz)
        p, q, r, t, u, v, w, m, n = product(p, q, r, t, u, v, w, m, n, pa, pb, pc, pd, pe, pf, pg, ph, pk)
        x, y, z = x + ux, y + uy, z + uz
        a, b, c, d, e, f, g, h, k = a + p, b + q, c + r, d + t, e + u, f + v, g + w, h + m, k + n
    return x, y, z, a, b, c, d, e, f, g, h, k


@device
def still(known, first, last, x0, y0, x1, y1, z):
    """Return 1 if a rectangle of a plane lies outside the balls of all strokes: there, T is exactly the identity."""
    for s in range(first, last, STROKE):
        dx = min(max(known[s], x0), x1) - known[s]
        dy = min(max(known[s + 1], y0), y1) - known[s + 1]
        dz = z - known[s + 2]
        if dx * dx + dy * dy + dz * dz < known[s + REACH2]:
            return 0
    return 1


@kernel
def forward(known, spans, ndim, points, moved_points, matrices):
    """Compute T of points (N * ndim numbers, in pixels), and ∂T/∂p (N * ndim² numbers), unless its array is empty."""
    i = cuda.grid(1)
    o = i * ndim
    if o >= points.size:
        return
    sx, sy, sz = known[SPACING], known[Y_AXIS + SPACING], known[Z_AXIS + SPACING]
    first, last = DOMAIN + STROKE * spans[0], DOMAIN + STROKE * spans[1]
    x, y, z = float(points[o]) * sx, float(points[o + 1]) * sy, 0.0
    if ndim == 3:
        z = float(points[o + 2]) * sz
    if matrices.size > 0:
        x, y, z, a, b, c, d, e, f, g, h, k = moved_with_matrix(known, 0, first, last, x, y, z)
        j = i * ndim * ndim
        if ndim == 3:
            matrices[j], matrices[j + 1], matrices[j + 2] = a, b * sy / sx, c * sz / sx
            matrices[j + 3], matrices[j + 4], matrices[j + 5] = d * sx / sy, e, f * sz / sy
            matrices[j + 6], matrices[j + 7], matrices[j + 8] = g * sx / sz, h * sy / sz, k
        else:
            matrices[j], matrices[j + 1], matrices[j + 2], matrices[j + 3] = a, b * sy / sx, d * sx / sy, e
    else:
        x, y, z = moved(known, 0, first, last, x, y, z)
    moved_points[o], moved_points[o + 1] = x / sx, y / sy
    if ndim == 3:
        moved_points[o + 2] = z / sz
