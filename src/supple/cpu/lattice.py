"""T⁻¹ on a plane: solved at the nodes of a lattice, filled in between, and certified.

At a node, Newton's method gives the displacement u = T⁻¹(q) - q and, exactly, its slopes ∂u/∂q = (I+J)⁻¹ - I.
A cell between four nodes is filled by bicubic Hermite interpolation of values, slopes and twists; its error falls
with the fourth power of the cell's size. It is checked: T of points within the cell and on its edges is compared
with where they should be, and the residual, times ∂p/∂q, is the distance to the true T⁻¹(q). Where it is too large,
the cell is split (`supple.cpu.band`), down to single pixels, which are nodes themselves.

A node is a row of numbers, in pixels: u (3), ∂p/∂q (9, row by row), the twist ∂²u/∂x∂y (3), the length over which
the map can be smooth there, and its own error.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.field import (
    J00,
    J01,
    J02,
    J10,
    J11,
    J12,
    J20,
    J21,
    J22,
    X,
    Y,
    Z,
    apply,
    identity,
    step,
)
from supple.cpu.kernel import BATCH, inlined, kernel, lean
from supple.cpu.newton import (
    DONE,
    NORM,
    PX,
    PY,
    PZ,
    QX,
    QY,
    QZ,
    ROWS,
    STEPS,
    settle,
    undo,
)
from supple.cpu.point import inverted

U, M, TWIST, SMOOTH, ERROR, NODE = 0, 3, 12, 15, 16, 17

SIZE = 32  # pixels from node to node
# A node is done when Newton's next step is shorter than this, in pixels; that step is then taken, and what it
# leaves is of the order of its square over the length on which the map varies. Within a cell that resolves the
# map, that length is large, and one step from the cell's own guess will mostly do.
TOLERANCE, LEFT = 1e-3, 1e-5
ROUGH_TOLERANCE, ROUGH_LEFT = 0.02, 2e-4
# What is seen at a few points of a cell is nearly the worst of it; the rest is reserve.
RESERVE = 2.0
# A cell may be as large as this part of the length on which the map varies at its corners: beyond, what is seen at
# points says little about what lies between them.
RESOLVED = 0.5


@kernel
def solve_batch(w, one, n, table, axes, cols, rows, guessed, smooth, nodes):
    """Solve T(p) = q for the pixels in the rows QX..; the nodes' numbers go to ``nodes[rows[i], cols[i]]``.

    The rows X.. hold guesses if ``guessed``. How smooth the map is there is found if ``smooth``. Returns the
    evaluations that were needed.
    """
    sx, sy, sz = axes[0, 2], axes[1, 2], axes[2, 2]
    finest = (TOLERANCE if smooth else ROUGH_TOLERANCE) * min(sx, min(sy, sz))
    if guessed:
        settle(w, one, n, table, axes, finest, 10)
    else:
        undo(w, one, n, table, axes, finest)
    evaluations = 0.0
    for i in range(n):
        node = nodes[rows[i], cols[i]]
        evaluations += w[STEPS + i]
        m00, m01, m02, m10, m11, m12, m20, m21, m22 = inverted(
            w[J00 + i], w[J01 + i], w[J02 + i],
            w[J10 + i], w[J11 + i], w[J12 + i],
            w[J20 + i], w[J21 + i], w[J22 + i],
        )  # fmt: skip
        node[M], node[M + 1], node[M + 2] = m00, m01 * sy / sx, m02 * sz / sx
        node[M + 3], node[M + 4], node[M + 5] = m10 * sx / sy, m11, m12 * sz / sy
        node[M + 6], node[M + 7], node[M + 8] = m20 * sx / sz, m21 * sy / sz, m22
        # What rounding of T leaves, where the inverse enlarges it; and all of the residual where it did not converge.
        size, reach = 0.0, abs(w[QX + i]) + abs(w[QY + i]) + abs(w[QZ + i])
        for m in range(9):
            size += node[M + m] * node[M + m]
        residual = 1e-15 * reach if w[DONE + i] > 0.0 else np.sqrt(w[NORM + i])
        node[ERROR] = (LEFT if smooth else ROUGH_LEFT) + np.sqrt(size) * residual / min(sx, min(sy, sz))
        node[U] = (w[PX + i] - w[QX + i]) / sx
        node[U + 1] = (w[PY + i] - w[QY + i]) / sy
        node[U + 2] = (w[PZ + i] - w[QZ + i]) / sz
        node[SMOOTH] = 1e300
    if smooth:
        _smoothness(w, n, table, axes, cols, rows, nodes)
    return evaluations


@inlined
def _smoothness(w, n, table, axes, cols, rows, nodes):
    """How far, in output pixels, the map stays as smooth as it is at a node.

    A stroke varies over ρ, and its border, along each axis by itself, over σ or the distance to it: both are seen
    through the derivative of the stroke's input by q.
    """
    for i in range(n):
        w[X + i], w[Y + i], w[Z + i] = w[PX + i], w[PY + i], w[PZ + i]
    identity(w, n)
    for s in range(table.shape[0]):
        stroke = table[s]
        for i in range(n):
            node = nodes[rows[i], cols[i]]
            size, along = 0.0, (0.0, 0.0, 0.0)
            for c in range(2):
                # Physical units of the stroke's input per output pixel.
                u = node[M + c] * axes[0, 2]
                v = node[M + 3 + c] * axes[1, 2]
                t = node[M + 6 + c] * axes[2, 2]
                gx = w[J00 + i] * u + w[J01 + i] * v + w[J02 + i] * t
                gy = w[J10 + i] * u + w[J11 + i] * v + w[J12 + i] * t
                gz = w[J20 + i] * u + w[J21 + i] * v + w[J22 + i] * t
                size = max(size, gx * gx + gy * gy + gz * gz)
                along = (max(along[0], abs(gx)), max(along[1], abs(gy)), max(along[2], abs(gz)))
            rx, ry, rz = (
                w[X + i] - stroke["pivot"][0],
                w[Y + i] - stroke["pivot"][1],
                w[Z + i] - stroke["pivot"][2],
            )
            reach = np.sqrt((rx * rx + ry * ry + rz * rz + stroke["radius2"][0]) / size)
            for axis in range(3):
                if axes[axis, 1] > 0.0:
                    x = w[X + axis * BATCH + i]
                    # A quarter of a sine is smoother than a Kelvinlet; its kinks, no length resolves.
                    distance = 2.0 * max(axes[axis, 1], min(x, axes[axis, 0] - x))
                    reach = min(reach, distance / max(along[axis], 1e-12))
            node[SMOOTH] = min(node[SMOOTH], reach)
        step(w, n, stroke, axes, True)


@kernel
def solve_rows(table, axes, z, xs, ys, first, last, nodes):
    """Solve the lattice's rows ``first`` to ``last - 1``, each from the one before. Returns the evaluations."""
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    cols, rows = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    evaluations = 0.0
    for j in range(first, last):
        for start in range(0, xs.size, BATCH):
            n = min(BATCH, xs.size - start)
            for i in range(n):
                cols[i], rows[i] = start + i, j
                w[QX + i] = xs[start + i] * axes[0, 2]
                w[QY + i] = ys[j] * axes[1, 2]
                w[QZ + i] = z * axes[2, 2]
                if j > first:
                    # Along the slopes, and as these have changed since the row before.
                    node = nodes[j - 1, start + i]
                    older = nodes[max(first, j - 2), start + i]
                    h = ys[j] - ys[j - 1]
                    for c in range(3):
                        m, kept = node[M + 3 * c + 1], older[M + 3 * c + 1]
                        slope = m - (1.0 if c == 1 else 0.0) + 0.5 * (m - kept)
                        q = w[QX + c * BATCH + i]
                        w[X + c * BATCH + i] = q + (node[U + c] + h * slope) * axes[c, 2]
            evaluations += solve_batch(w, one, n, table, axes, cols, rows, j > first, True, nodes)
    return evaluations


@lean
def slope_weights(x0, x1, x2, x):
    """How the derivative at x of the parabola through three points, or the line through two, weighs their values."""
    if x2 == x1:
        w = 1.0 / (x1 - x0)
        return -w, w, 0.0
    a, b, c = 1.0 / (x1 - x0), 1.0 / (x2 - x0), 1.0 / (x2 - x1)
    return (2.0 * x - x1 - x2) * a * b, -(2.0 * x - x0 - x2) * a * c, (2.0 * x - x0 - x1) * b * c


@kernel
def set_twists(xs, ys, nx, ny, first, last, ndim, nodes):
    """∂²u/∂x∂y at the nodes of the rows ``first`` to ``last - 1``, from the slopes of their neighbours."""
    # Three nodes in a line know better than two.
    weight = 0.5 if (nx > 2) == (ny > 2) else (1.0 if nx > 2 else 0.0)
    for j in range(first, last):
        b = min(max(j - 1, 0), max(ny - 3, 0))
        b1, b2 = b + 1, min(b + 2, ny - 1)
        v0, v1, v2 = slope_weights(ys[b], ys[b1], ys[b2], ys[j])
        for i in range(nx):
            a = min(max(i - 1, 0), max(nx - 3, 0))
            a1, a2 = a + 1, min(a + 2, nx - 1)
            w0, w1, w2 = slope_weights(xs[a], xs[a1], xs[a2], xs[i])
            for c in range(ndim):
                m = M + 3 * c
                along_x = w0 * nodes[j, a, m + 1] + w1 * nodes[j, a1, m + 1] + w2 * nodes[j, a2, m + 1]
                along_y = v0 * nodes[b, i, m] + v1 * nodes[b1, i, m] + v2 * nodes[b2, i, m]
                nodes[j, i, TWIST + c] = weight * along_x + (1.0 - weight) * along_y


@kernel
def patch(nodes, j, i, c, h, k, s, t):
    """Component ``c`` of u at (s, t) in [0, 1]² of the cell, ``h`` by ``k`` pixels, right and below a node."""
    s1, t1 = 1.0 - s, 1.0 - t
    vs, ws = (1.0 + 2.0 * s) * s1 * s1, s * s * (3.0 - 2.0 * s)
    gs, hs = h * s * s1 * s1, -h * s * s * s1
    vt, wt = (1.0 + 2.0 * t) * t1 * t1, t * t * (3.0 - 2.0 * t)
    gt, ht = k * t * t1 * t1, -k * t * t * t1
    mx, my = M + 3 * c, M + 3 * c + 1
    one_x, one_y = (1.0 if c == 0 else 0.0), (1.0 if c == 1 else 0.0)
    p, q, r, o = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]
    value = vt * (vs * p[c] + ws * q[c] + gs * (p[mx] - one_x) + hs * (q[mx] - one_x))
    value += wt * (vs * r[c] + ws * o[c] + gs * (r[mx] - one_x) + hs * (o[mx] - one_x))
    f = TWIST + c
    value += gt * (vs * (p[my] - one_y) + ws * (q[my] - one_y) + gs * p[f] + hs * q[f])
    value += ht * (vs * (r[my] - one_y) + ws * (o[my] - one_y) + gs * r[f] + hs * o[f])
    return value


@kernel
def too_coarse(nodes, j, i, h, k):
    """Whether a cell is larger than the map is smooth."""
    smooth = min(
        min(nodes[j, i, SMOOTH], nodes[j, i + 1, SMOOTH]),
        min(nodes[j + 1, i, SMOOTH], nodes[j + 1, i + 1, SMOOTH]),
    )
    return max(h, k) > RESOLVED * smooth


def _weights() -> np.ndarray:
    """How the 16 numbers of a cell make up u, and its slopes, at the points that are looked at.

    The middles of the four edges, of the cell and of its quarters. The numbers are, for each corner, the value, the
    slope along x times the width, that along y times the height, and the twist times both; the slopes that come out
    are times width and height as well.
    """
    out = np.empty((3, 16, SEEN))
    for k, (s, t) in enumerate(zip(AT_X, AT_Y, strict=True)):
        values = [
            [((1 + 2 * v) * (1 - v) ** 2, v * (1 - v) ** 2), (v * v * (3 - 2 * v), v * v * (v - 1))] for v in (s, t)
        ]
        slopes = [[(6 * v * (v - 1), (1 - v) * (1 - 3 * v)), (6 * v * (1 - v), v * (3 * v - 2))] for v in (s, t)]
        for kind, (along, down) in enumerate([(values[0], values[1]), (slopes[0], values[1]), (values[0], slopes[1])]):
            for corner in range(4):
                (a, b), (c, d) = along[corner % 2], down[corner // 2]
                out[kind, 4 * corner : 4 * corner + 4, k] = a * c, b * c, a * d, b * d
    return out


AT_X = np.array([0.5, 0.5, 0.0, 1.0, 0.5, 0.25, 0.75, 0.25, 0.75])
AT_Y = np.array([0.0, 1.0, 0.5, 0.5, 0.5, 0.25, 0.25, 0.75, 0.75])
SEEN = 9
TOGETHER = BATCH // SEEN  # cells that are looked at together
WEIGHTS = _weights()


@kernel
def check(w, n, table, axes, ndim, z, x0, y0, hs, ks, js, cells, nodes, errors, sides):
    """Bound the errors of ``n`` ≤ TOGETHER cells, in pixels: at nine points of each, T is compared.

    Cell ``m`` lies right and below ``nodes[js[m], cells[m]]``, at the pixel (x0[m], y0[m]), ``hs[m]`` by ``ks[m]``.
    ``sides[m]`` says along which axes the error calls for smaller cells: 1 x, 2 y, 3 both.
    """
    known, slopes = np.empty(16), np.empty(6 * BATCH)
    for m in range(n):
        h, k, at = hs[m], ks[m], SEEN * m
        for i in range(SEEN):
            w[QX + at + i] = (x0[m] + AT_X[i] * h) * axes[0, 2]
            w[QY + at + i] = (y0[m] + AT_Y[i] * k) * axes[1, 2]
            w[QZ + at + i] = z * axes[2, 2]
            w[Z + at + i] = z * axes[2, 2]
        for c in range(ndim):
            one_x, one_y = (1.0 if c == 0 else 0.0), (1.0 if c == 1 else 0.0)
            for corner in range(4):
                node = nodes[js[m] + corner // 2, cells[m] + corner % 2]
                known[4 * corner] = node[U + c]
                known[4 * corner + 1] = h * (node[M + 3 * c] - one_x)
                known[4 * corner + 2] = k * (node[M + 3 * c + 1] - one_y)
                known[4 * corner + 3] = h * k * node[TWIST + c]
            to, q = X + c * BATCH + at, QX + c * BATCH + at
            along, down = 2 * c * BATCH + at, (2 * c + 1) * BATCH + at
            for i in range(SEEN):
                w[to + i] = w[q + i]
                slopes[along + i], slopes[down + i] = one_x, one_y
            for a in range(16):
                v, vx, vy = known[a] * axes[c, 2], known[a] / h, known[a] / k
                for i in range(SEEN):
                    w[to + i] += v * WEIGHTS[0, a, i]
                    slopes[along + i] += vx * WEIGHTS[1, a, i]
                    slopes[down + i] += vy * WEIGHTS[2, a, i]
    apply(w, SEEN * n, table, axes, 0, table.shape[0], False)
    for m in range(n):
        j, i = js[m], cells[m]
        inner, level, upright = 0.0, 0.0, 0.0
        for k in range(SEEN):
            x = SEEN * m + k
            ex = (w[X + x] - w[QX + x]) / axes[0, 2]
            ey = (w[Y + x] - w[QY + x]) / axes[1, 2]
            ez = (w[Z + x] - w[QZ + x]) / axes[2, 2]
            error = 0.0
            for c in range(ndim):
                # ∂p/∂q of the patch itself; along z, only the nodes know it.
                v = slopes[2 * c * BATCH + x] * ex + slopes[(2 * c + 1) * BATCH + x] * ey
                a = M + 3 * c + 2
                if ndim == 3:
                    v += 0.25 * ez * (nodes[j, i, a] + nodes[j, i + 1, a] + nodes[j + 1, i, a] + nodes[j + 1, i + 1, a])
                error += v * v
            if k < 2:
                level = max(level, error)
            elif k < 4:
                upright = max(upright, error)
            else:
                inner = max(inner, error)
        own = max(
            max(nodes[j, i, ERROR], nodes[j, i + 1, ERROR]), max(nodes[j + 1, i, ERROR], nodes[j + 1, i + 1, ERROR])
        )
        errors[m] = own + RESERVE * np.sqrt(max(inner, max(level, upright)))
        sides[m] = 3
        if level > 16.0 * upright:
            sides[m] = 1
        elif upright > 16.0 * level:
            sides[m] = 2
