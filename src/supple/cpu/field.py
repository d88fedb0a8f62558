"""T and its Jacobian: every stroke of a table applied to a batch of points, one stroke after the other.

With r = p - pivot and s = |r|² + ε², in physical units:

    K(p) = A(s) f + B(s) (r·f) r
    J(p) = 2A' f rᵀ + 2B' (r·f) r rᵀ + B (r fᵀ + (r·f) I)                           (' = d/ds)

and, where the border is fixed, K_β = diag(β) K and J_β = diag(β) J + diag(β' ∘ K), with
β = sin(π/2 · min(D, σ)/σ) of the distance D to the nearer face. Beyond a fixed face, the map goes on as it is at
the nearest point of the face; with that, it is one-to-one on all of space wherever it is so on the domain.

A batch lives in one flat workspace of rows of BATCH numbers. With one array and constant rows, the compiler sees
that no row overlaps another, and works on several points at once.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.kernel import BATCH, kernel
from supple.cpu.point import displacement, faded, gradient, profile

# Where each row of a workspace starts: the points, and the Jacobian's entries row by row, ...
X, Y, Z = 0 * BATCH, 1 * BATCH, 2 * BATCH
J00, J01, J02 = 3 * BATCH, 4 * BATCH, 5 * BATCH
J10, J11, J12 = 6 * BATCH, 7 * BATCH, 8 * BATCH
J20, J21, J22 = 9 * BATCH, 10 * BATCH, 11 * BATCH
# ... for each axis: β, β', the nearest coordinate in the domain, and 1 where that is the point's own, ...
BETA, SLOPE, NEAR, INSIDE = 12 * BATCH, 15 * BATCH, 18 * BATCH, 21 * BATCH
# ... A, B, 2A' and 2B'; and from FREE_ROWS on, what a caller keeps beside them.
A, B, DA, DB = 24 * BATCH, 25 * BATCH, 26 * BATCH, 27 * BATCH
FREE_ROWS = 28


@kernel
def _edge(w, n, axis, extent, sigma):
    x, beta, slope = X + axis * BATCH, BETA + axis * BATCH, SLOPE + axis * BATCH
    near, inside = NEAR + axis * BATCH, INSIDE + axis * BATCH
    if sigma < 0.0:
        for i in range(n):
            w[beta + i] = 1.0
            w[slope + i] = 0.0
            w[near + i] = w[x + i]
            w[inside + i] = 1.0
    elif sigma == 0.0:
        for i in range(n):
            w[beta + i] = 0.0
            w[slope + i] = 0.0
            w[near + i] = 0.0
            w[inside + i] = 0.0
    else:
        for i in range(n):
            w[beta + i], w[slope + i], w[near + i], w[inside + i] = faded(w[x + i], extent, sigma)


@kernel
def _profiles(w, n, stroke):
    """A, B, 2A' and 2B' at the nearest points, summed over the stroke's terms."""
    px, py, pz = stroke["pivot"][0], stroke["pivot"][1], stroke["pivot"][2]
    for i in range(n):
        w[A + i] = 0.0
        w[B + i] = 0.0
        w[DA + i] = 0.0
        w[DB + i] = 0.0
    for m in range(stroke["terms"]):
        e, p, q, r = stroke["radius2"][m], stroke["p"][m], stroke["q"][m], stroke["r"][m]
        for i in range(n):
            dx, dy, dz = w[NEAR + i] - px, w[NEAR + BATCH + i] - py, w[NEAR + 2 * BATCH + i] - pz
            a, b, da, db = profile(dx * dx + dy * dy + dz * dz, e, p, q, r)
            w[A + i] += a
            w[B + i] += b
            w[DA + i] += da
            w[DB + i] += db


@kernel
def _move(w, n, stroke):
    px, py, pz = stroke["pivot"][0], stroke["pivot"][1], stroke["pivot"][2]
    fx, fy, fz = stroke["force"][0], stroke["force"][1], stroke["force"][2]
    for i in range(n):
        dx, dy, dz = w[NEAR + i] - px, w[NEAR + BATCH + i] - py, w[NEAR + 2 * BATCH + i] - pz
        kx, ky, kz = displacement(dx, dy, dz, fx, fy, fz, w[A + i], w[B + i])
        w[X + i] += w[BETA + i] * kx
        w[Y + i] += w[BETA + BATCH + i] * ky
        w[Z + i] += w[BETA + 2 * BATCH + i] * kz


@kernel
def _move_with_jacobian(w, n, stroke):
    px, py, pz = stroke["pivot"][0], stroke["pivot"][1], stroke["pivot"][2]
    fx, fy, fz = stroke["force"][0], stroke["force"][1], stroke["force"][2]
    for i in range(n):
        dx, dy, dz = w[NEAR + i] - px, w[NEAR + BATCH + i] - py, w[NEAR + 2 * BATCH + i] - pz
        ox, oy, oz = w[INSIDE + i], w[INSIDE + BATCH + i], w[INSIDE + 2 * BATCH + i]
        bx, by, bz = w[BETA + i], w[BETA + BATCH + i], w[BETA + 2 * BATCH + i]
        kx, ky, kz = displacement(dx, dy, dz, fx, fy, fz, w[A + i], w[B + i])
        m00, m01, m02, m10, m11, m12, m20, m21, m22 = gradient(dx, dy, dz, fx, fy, fz, w[B + i], w[DA + i], w[DB + i])
        m00, m01, m02 = 1.0 + ox * (bx * m00 + w[SLOPE + i] * kx), oy * bx * m01, oz * bx * m02
        m10, m11, m12 = ox * by * m10, 1.0 + oy * (by * m11 + w[SLOPE + BATCH + i] * ky), oz * by * m12
        m20, m21, m22 = ox * bz * m20, oy * bz * m21, 1.0 + oz * (bz * m22 + w[SLOPE + 2 * BATCH + i] * kz)
        w[X + i] += bx * kx
        w[Y + i] += by * ky
        w[Z + i] += bz * kz
        u, v, t = w[J00 + i], w[J10 + i], w[J20 + i]
        w[J00 + i] = m00 * u + m01 * v + m02 * t
        w[J10 + i] = m10 * u + m11 * v + m12 * t
        w[J20 + i] = m20 * u + m21 * v + m22 * t
        u, v, t = w[J01 + i], w[J11 + i], w[J21 + i]
        w[J01 + i] = m00 * u + m01 * v + m02 * t
        w[J11 + i] = m10 * u + m11 * v + m12 * t
        w[J21 + i] = m20 * u + m21 * v + m22 * t
        u, v, t = w[J02 + i], w[J12 + i], w[J22 + i]
        w[J02 + i] = m00 * u + m01 * v + m02 * t
        w[J12 + i] = m10 * u + m11 * v + m12 * t
        w[J22 + i] = m20 * u + m21 * v + m22 * t


@kernel
def step(w, n, stroke, axes, with_jacobian):
    """Send the ``n`` ≤ BATCH points of a workspace through one stroke, and multiply their Jacobians by its."""
    _edge(w, n, 0, axes[0, 0], axes[0, 1])
    _edge(w, n, 1, axes[1, 0], axes[1, 1])
    _edge(w, n, 2, axes[2, 0], axes[2, 1])
    _profiles(w, n, stroke)
    if with_jacobian:
        _move_with_jacobian(w, n, stroke)
    else:
        _move(w, n, stroke)


@kernel
def identity(w, n):
    """Set the Jacobians of a batch to the identity."""
    for i in range(n):
        w[J00 + i], w[J01 + i], w[J02 + i] = 1.0, 0.0, 0.0
        w[J10 + i], w[J11 + i], w[J12 + i] = 0.0, 1.0, 0.0
        w[J20 + i], w[J21 + i], w[J22 + i] = 0.0, 0.0, 1.0


@kernel
def apply(w, n, table, axes, first, last, with_jacobian):
    """Send a batch through the strokes ``first`` to ``last - 1``; the rows J00.. become their Jacobian, if wanted."""
    if with_jacobian:
        identity(w, n)
    for k in range(first, last):
        step(w, n, table[k], axes, with_jacobian)


@kernel
def load(w, row, n, source, start):
    """Copy ``source[:, start : start + n]`` into the rows from ``row`` on."""
    for k in range(source.shape[0]):
        for i in range(n):
            w[row + k * BATCH + i] = source[k, start + i]


@kernel
def save(w, row, n, target, start):
    """The reverse of `load`."""
    for k in range(target.shape[0]):
        for i in range(n):
            target[k, start + i] = w[row + k * BATCH + i]


@kernel
def forward(table, axes, points, jacobian):
    """T of ``points`` (3, N), in place; and its Jacobian into ``jacobian`` (9, N), unless that has no columns."""
    w = np.empty(FREE_ROWS * BATCH)
    total = points.shape[1]
    wanted = jacobian.shape[1] > 0
    for start in range(0, total, BATCH):
        n = min(BATCH, total - start)
        load(w, X, n, points, start)
        apply(w, n, table, axes, 0, table.shape[0], wanted)
        save(w, X, n, points, start)
        if wanted:
            save(w, J00, n, jacobian, start)
