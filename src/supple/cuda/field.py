"""T and its Jacobian at a point, by one thread: the strokes of a table, one after the other.

The arithmetic is the CPU's (`supple.cpu.point`). What is known of deformations is one flat array of float64: for each,
the nine numbers of its domain; then all strokes, STROKE numbers each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import cuda

from supple.cpu.kernel import lean
from supple.cpu.point import displacement, faded, gradient, profile
from supple.cuda.kernel import device, kernel

DOMAIN = 9  # numbers: extent, sigma and spacing of x, y and z
# Of a stroke: its pivot, its force, how many terms it has, and radius², p, q and r of each.
PIVOT, FORCE, TERMS, TERM, STROKE = 0, 3, 6, 7, 19

Floats = npt.NDArray[np.float64]


def packed(tables: Sequence[npt.NDArray[np.void]], domains: Sequence[Floats]) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Deformations as kernels take them: what is known of them, and which strokes are whose (one more than there are).

    Parameters
    ----------
    tables : sequence of arrays of STROKE_DTYPE
    domains : sequence of float64 arrays, shape (3, 3)
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
            out[:, TERM + k :: 4] = table[name]
        rows.append(out.ravel())
    known = np.concatenate([*(np.asarray(d, np.float64)[:, :3].ravel() for d in domains), *rows])
    return known, np.cumsum([0, *(t.size for t in tables)]).astype(np.int32)


@lean
def edge(x, extent, sigma):
    """β, β', the nearest coordinate in the domain, and 1 where that is the point's own."""
    if sigma > 0.0:
        return faded(x, extent, sigma)
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return 1.0, 0.0, x, 1.0


@device
def profiles(known, s, r2):
    """A, B, 2A' and 2B' of a stroke, summed over its terms, at the square of the distance to its pivot."""
    a, b, da, db = 0.0, 0.0, 0.0, 0.0
    for m in range(int(known[s + TERMS])):
        t = s + TERM + 4 * m
        more_a, more_b, more_da, more_db = profile(r2, known[t], known[t + 1], known[t + 2], known[t + 3])
        a += more_a
        b += more_b
        da += more_da
        db += more_db
    return a, b, da, db


@device
def moved(known, at, first, last, x, y, z):
    """T of a point, by the strokes whose numbers are from ``first`` to ``last``, in the domain at ``at``."""
    for s in range(first, last, STROKE):
        bx, _, nx, _ = edge(x, known[at], known[at + 1])
        by, _, ny, _ = edge(y, known[at + 3], known[at + 4])
        bz, _, nz, _ = edge(z, known[at + 6], known[at + 7])
        dx, dy, dz = nx - known[s], ny - known[s + 1], nz - known[s + 2]
        a, b, _, _ = profiles(known, s, dx * dx + dy * dy + dz * dz)
        kx, ky, kz = displacement(dx, dy, dz, known[s + 3], known[s + 4], known[s + 5], a, b)
        x += bx * kx
        y += by * ky
        z += bz * kz
    return x, y, z


@device
def carried(known, at, s, x, y, z):
    """T of one stroke at a point, and its Jacobian, row by row."""
    bx, slope_x, nx, ox = edge(x, known[at], known[at + 1])
    by, slope_y, ny, oy = edge(y, known[at + 3], known[at + 4])
    bz, slope_z, nz, oz = edge(z, known[at + 6], known[at + 7])
    dx, dy, dz = nx - known[s], ny - known[s + 1], nz - known[s + 2]
    fx, fy, fz = known[s + 3], known[s + 4], known[s + 5]
    a, b, da, db = profiles(known, s, dx * dx + dy * dy + dz * dz)
    kx, ky, kz = displacement(dx, dy, dz, fx, fy, fz, a, b)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = gradient(dx, dy, dz, fx, fy, fz, b, da, db)
    return (
        x + bx * kx,
        y + by * ky,
        z + bz * kz,
        1.0 + ox * (bx * m00 + slope_x * kx),
        oy * bx * m01,
        oz * bx * m02,
        ox * by * m10,
        1.0 + oy * (by * m11 + slope_y * ky),
        oz * by * m12,
        ox * bz * m20,
        oy * bz * m21,
        1.0 + oz * (bz * m22 + slope_z * kz),
    )


@lean
def product(a, b, c, d, e, f, g, h, k, p, q, r, s, t, u, v, w, x):
    """Two matrices, row by row, multiplied."""
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


@device
def moved_with_matrix(known, at, first, last, x, y, z):
    """T of a point, and its Jacobian, row by row: twelve numbers."""
    a, b, c, d, e, f, g, h, k = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    for s in range(first, last, STROKE):
        x, y, z, p, q, r, t, u, v, w, m, n = carried(known, at, s, x, y, z)
        a, b, c, d, e, f, g, h, k = product(p, q, r, t, u, v, w, m, n, a, b, c, d, e, f, g, h, k)
    return x, y, z, a, b, c, d, e, f, g, h, k


@kernel
def forward(known, spans, ndim, points, moved_points, matrices):
    """T of points (N * ndim numbers, in pixels), and ∂T/∂p (N * ndim² numbers), unless there is no room for it."""
    i = cuda.grid(1)
    o = i * ndim
    if o >= points.size:
        return
    sx, sy, sz = known[2], known[5], known[8]
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
