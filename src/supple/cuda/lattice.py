"""T⁻¹ on planes: solved at the nodes of a lattice, filled in between, and certified; see `supple.cpu.lattice`.

A thread solves a node from nothing, in float64; cards have so many threads that the cells can be small, and those that
are not good enough, in which each pixel is solved by itself, are few. Cells are filled in float32: displacements are
offsets from a whole pixel.

A node is NODE numbers of float32, in pixels: u, the columns of ∂u/∂q, the twist ∂²u/∂x∂y, and its own error, which is
ROUGH where the map varies over less than cells can follow.
"""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from supple.cpu.kernel import lean
from supple.cpu.lattice import AT_X, AT_Y, LEFT, RESERVE, RESOLVED, SEEN, TOLERANCE, slope_weights
from supple.cpu.point import inverted
from supple.cuda.field import DOMAIN, STROKE, carried, moved, product
from supple.cuda.kernel import device, kernel
from supple.cuda.newton import undo

SIZE = 8  # pixels from node to node
U, X, Y, Z, TWIST, ERROR, NODE = 0, 3, 6, 9, 12, 15, 16
ROUGH = 1e30
WORST = 0  # of the numbers that are told of a warp
# Of its counts: rough cells, points that could not be solved, and samples that were not there; then, those cells.
CELLS, LOST, MISSING, LIST = 0, 1, 2, 4

_f4, _u = np.float32, np.uintp
_SEEN_X, _SEEN_Y = AT_X.astype(_f4), AT_Y.astype(_f4)  # where cells are looked at
ZERO, ONE, TWO, THREE = _f4(0.0), _f4(1.0), _f4(2.0), _f4(3.0)


@lean
def norm_of(a, b, c, d, e, f, g, h, k):
    """Frobenius's."""
    return math.sqrt(a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + k * k)


@lean
def in_pixels(a, b, c, d, e, f, g, h, k, sx, sy, sz):
    """A matrix of physical units as one of pixels."""
    return a, b * sy / sx, c * sz / sx, d * sx / sy, e, f * sz / sy, g * sx / sz, h * sy / sz, k


@device
def smoothness(known, at, first, last, x, y, z, a, b, d, e, g, h):
    """How far, in output pixels, the map stays as smooth as it is at a point, of which the columns of ∂p/∂q are known.

    A stroke varies over ρ, and its border, along each axis by itself, over σ or the distance to it: both are seen
    through the derivative of the stroke's input by q.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    u0, u1, u2 = a * known[at + 2], d * known[at + 5], g * known[at + 8]
    v0, v1, v2 = b * known[at + 2], e * known[at + 5], h * known[at + 8]
    least = 1e300
    for s in range(first, last, STROKE):
        ux, uy, uz = m00 * u0 + m01 * u1 + m02 * u2, m10 * u0 + m11 * u1 + m12 * u2, m20 * u0 + m21 * u1 + m22 * u2
        vx, vy, vz = m00 * v0 + m01 * v1 + m02 * v2, m10 * v0 + m11 * v1 + m12 * v2, m20 * v0 + m21 * v1 + m22 * v2
        size = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
        rx, ry, rz = x - known[s], y - known[s + 1], z - known[s + 2]
        least = min(least, math.sqrt((rx * rx + ry * ry + rz * rz + known[s + 7]) / size))
        if known[at + 1] > 0.0:
            # A quarter of a sine is smoother than a Kelvinlet; its kinks, no length resolves.
            far = 2.0 * max(known[at + 1], min(x, known[at] - x))
            least = min(least, far / max(max(abs(ux), abs(vx)), 1e-12))
        if known[at + 4] > 0.0:
            far = 2.0 * max(known[at + 4], min(y, known[at + 3] - y))
            least = min(least, far / max(max(abs(uy), abs(vy)), 1e-12))
        if known[at + 7] > 0.0:
            far = 2.0 * max(known[at + 7], min(z, known[at + 6] - z))
            least = min(least, far / max(max(abs(uz), abs(vz)), 1e-12))
        x, y, z, p, q, r, t, u, v, w, m, n = carried(known, at, s, x, y, z)
        m00, m01, m02, m10, m11, m12, m20, m21, m22 = product(
            p, q, r, t, u, v, w, m, n, m00, m01, m02, m10, m11, m12, m20, m21, m22
        )
    return least


@device
def deformation_of(spans, deformations, plane):
    """Where the numbers of a plane's deformation are: its domain, its first stroke, and the end of its strokes."""
    which = plane if deformations > 1 else 0
    start = DOMAIN * deformations
    return DOMAIN * which, start + STROKE * spans[which], start + STROKE * spans[which + 1]


@kernel
def solve(known, spans, deformations, xs, ys, planes, z0, fresh, nodes, told, counts):
    """Solve the nodes of some planes: of a stack, from ``z0`` on; of several images, each by its own deformation.

    What is told begins anew, if ``fresh``.
    """
    i = cuda.grid(1)
    if i == 0:
        counts[CELLS] = 0
        if fresh > 0:
            told[WORST] = ZERO
            counts[LOST], counts[MISSING] = 0, 0
    nx, ny = xs.size, ys.size
    if i >= planes * ny * nx:
        return
    plane, j, k = i // (ny * nx), i // nx % ny, i % nx
    at, first, last = deformation_of(spans, deformations, z0 + plane)
    sx, sy, sz = known[at + 2], known[at + 5], known[at + 8]
    depth = 0.0 if deformations > 1 else float(z0 + plane)
    qx, qy, qz = xs[k] * sx, ys[j] * sy, depth * sz
    finest = min(sx, min(sy, sz))
    x, y, z, norm, done, _, a, b, c, d, e, f, g, h, m = undo(known, at, first, last, qx, qy, qz, TOLERANCE * finest)
    a, b, c, d, e, f, g, h, m = inverted(a, b, c, d, e, f, g, h, m)
    a, b, c, d, e, f, g, h, m = in_pixels(a, b, c, d, e, f, g, h, m, sx, sy, sz)
    smooth = smoothness(known, at, first, last, x, y, z, a, b, d, e, g, h)
    widest = max(xs[min(k + 1, nx - 1)] - xs[max(k - 1, 0)], ys[min(j + 1, ny - 1)] - ys[max(j - 1, 0)])
    error = LEFT
    if not done:
        error += norm_of(a, b, c, d, e, f, g, h, m) * math.sqrt(norm) / finest
    if min(float(widest), float(SIZE)) > RESOLVED * smooth or not error < ROUGH:
        error = ROUGH
    o = i * NODE
    nodes[o + U], nodes[o + U + 1], nodes[o + U + 2] = (x - qx) / sx, (y - qy) / sy, (z - qz) / sz
    nodes[o + X], nodes[o + X + 1], nodes[o + X + 2] = a - 1.0, d, g
    nodes[o + Y], nodes[o + Y + 1], nodes[o + Y + 2] = b, e - 1.0, h
    nodes[o + Z], nodes[o + Z + 1], nodes[o + Z + 2] = c, f, m - 1.0
    nodes[o + ERROR] = error


@kernel
def twist(xs, ys, planes, nodes):
    """∂²u/∂x∂y at the nodes, from the slopes of their neighbours."""
    i = cuda.grid(1)
    nx, ny = xs.size, ys.size
    if i >= planes * ny * nx:
        return
    j, k = i // nx % ny, i % nx
    # Three nodes in a line know better than two.
    weight = 0.5 if (nx > 2) == (ny > 2) else (1.0 if nx > 2 else 0.0)
    b = min(max(j - 1, 0), max(ny - 3, 0))
    b1, b2 = b + 1, min(b + 2, ny - 1)
    v0, v1, v2 = slope_weights(ys[b], ys[b1], ys[b2], ys[j])
    a = min(max(k - 1, 0), max(nx - 3, 0))
    a1, a2 = a + 1, min(a + 2, nx - 1)
    w0, w1, w2 = slope_weights(xs[a], xs[a1], xs[a2], xs[k])
    row, column = (i - k) * NODE, (i - j * nx) * NODE  # the first node of its row, and of its column
    for c in range(3):
        m = row + Y + c
        along = w0 * nodes[m + a * NODE] + w1 * nodes[m + a1 * NODE] + w2 * nodes[m + a2 * NODE]
        m = column + X + c
        down = v0 * nodes[m + b * nx * NODE] + v1 * nodes[m + b1 * nx * NODE] + v2 * nodes[m + b2 * nx * NODE]
        nodes[i * NODE + TWIST + c] = weight * along + (1.0 - weight) * down


@lean
def hermite(t):
    """The weights of two values and two slopes, at t from 0 to 1."""
    r = ONE - t
    return (ONE + TWO * t) * r * r, t * t * (THREE - TWO * t), t * r * r, -t * t * r


@lean
def hermite_changes(t, step):
    """The weights of half of what a cubic changes from ``t - step`` to ``t + step``: its central difference."""
    r, more = ONE - t, step * step * step
    rise = _f4(6.0) * t * r * step - (more + more)
    return -rise, rise, r * (ONE - THREE * t) * step + more, t * (THREE * t - TWO) * step + more


@lean
def across(p, p_slope, q, q_slope, h, v, w, g, k):
    """A cubic between two nodes, ``h`` pixels apart."""
    return v * p + w * q + h * (g * p_slope + k * q_slope)


@device
def column(nodes, upper, lower, c, h, v, w, g, k):
    """Component ``c`` of u and ∂u/∂y, where weights say, on the upper and the lower edge of a cell."""
    # Unsigned indices: others are checked for counting from the end.
    p, q, r, o = upper + c, upper + NODE + c, lower + c, lower + NODE + c
    return (
        across(nodes[_u(p)], nodes[_u(p + X)], nodes[_u(q)], nodes[_u(q + X)], h, v, w, g, k),
        across(nodes[_u(r)], nodes[_u(r + X)], nodes[_u(o)], nodes[_u(o + X)], h, v, w, g, k),
        across(nodes[_u(p + Y)], nodes[_u(p + TWIST)], nodes[_u(q + Y)], nodes[_u(q + TWIST)], h, v, w, g, k),
        across(nodes[_u(r + Y)], nodes[_u(r + TWIST)], nodes[_u(o + Y)], nodes[_u(o + TWIST)], h, v, w, g, k),
    )


@lean
def bilinear(p, q, r, o, s, t):
    """Between four corners."""
    a, b = p + s * (q - p), r + s * (o - r)
    return a + t * (b - a)


@device
def slope_between(nodes, upper, lower, c, s, t):
    """A number of a node, interpolated in a cell."""
    return bilinear(
        nodes[_u(upper + c)], nodes[_u(upper + NODE + c)], nodes[_u(lower + c)], nodes[_u(lower + NODE + c)], s, t
    )


@device
def cell_error(known, at, first, last, nodes, upper, lower, x0, y0, z, h, k, s, t):
    """How far from T⁻¹(q) the point is that a cell has at (s, t), in pixels, to first order."""
    v, w, g, r = hermite(s)
    hx, ky = _f4(h), _f4(k)
    b, d, m, n = hermite(t)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 0, hx, v, w, g, r)
    dx = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 1, hx, v, w, g, r)
    dy = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 2, hx, v, w, g, r)
    dz = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    sx, sy, sz = known[at + 2], known[at + 5], known[at + 8]
    qx, qy, qz = (x0 + s * h) * sx, (y0 + t * k) * sy, z * sz
    x, y, z = moved(known, at, first, last, qx + dx * sx, qy + dy * sy, qz + dz * sz)
    ex, ey, ez = (x - qx) / sx, (y - qy) / sy, (z - qz) / sz
    error = 0.0
    for c in range(3):
        value = slope_between(nodes, upper, lower, X + c, s, t) * ex
        value += slope_between(nodes, upper, lower, Y + c, s, t) * ey
        value += slope_between(nodes, upper, lower, Z + c, s, t) * ez
        value += ex if c == 0 else (ey if c == 1 else ez)
        error += value * value
    return math.sqrt(error)


@kernel
def check(known, spans, deformations, xs, ys, planes, z0, tolerance, nodes, errors, told, counts):
    """Bound the errors of cells, in pixels: at nine points of each, T is compared. What is too far off is listed."""
    i = cuda.grid(1)
    nx, ny = xs.size, ys.size
    wide, tall = nx - 1, ny - 1
    if i >= planes * tall * wide:
        return
    plane, j, k = i // (tall * wide), i // wide % tall, i % wide
    at, first, last = deformation_of(spans, deformations, z0 + plane)
    depth = 0.0 if deformations > 1 else float(z0 + plane)
    upper = ((plane * ny + j) * nx + k) * NODE
    lower = upper + nx * NODE
    x0, y0 = float(xs[k]), float(ys[j])
    h, v = float(xs[k + 1] - xs[k]), float(ys[j + 1] - ys[j])
    own = max(
        max(nodes[upper + ERROR], nodes[upper + NODE + ERROR]),
        max(nodes[lower + ERROR], nodes[lower + NODE + ERROR]),
    )
    worst = 0.0
    if own < ROUGH:
        seen_x, seen_y = cuda.const.array_like(_SEEN_X), cuda.const.array_like(_SEEN_Y)
        for m in range(SEEN):
            error = cell_error(known, at, first, last, nodes, upper, lower, x0, y0, depth, h, v, seen_x[m], seen_y[m])
            worst = max(worst, error)
            if not error < ROUGH:
                worst = ROUGH
    found = own + RESERVE * worst
    if found <= tolerance:
        errors[i] = found
        # Few of them are the worst so far: most need not wait for the others.
        if found > told[WORST]:
            cuda.atomic.max(told, WORST, _f4(found))
    else:
        errors[i] = ROUGH
        counts[LIST + cuda.atomic.add(counts, CELLS, 1)] = i
