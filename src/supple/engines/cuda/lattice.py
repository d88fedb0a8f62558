"""T⁻¹ on planes: solved at the nodes of a lattice, filled in between, and certified.

At a node, Newton's method gives the displacement u = T⁻¹(q) - q and, exactly, its derivatives ∂u/∂q = (I+J)⁻¹ - I.
A cell between four nodes is filled by bicubic Hermite interpolation of values, slopes and twists. It is checked at nine
points: T of each is compared with its target, and the residual, times ∂p/∂q, is the distance to T⁻¹(q).

A thread solves a node from scratch, in float64; GPUs have so many threads that cells can be small, and rough ones, in
which each pixel is solved by itself, are few. Cells are filled in float32: displacements are offsets from a whole
pixel.

A node is NODE numbers of float32, in pixels: u, the columns of ∂u/∂q, the twist ∂²u/∂x∂y, and its own error, which is
ROUGH where the map varies too fast for the cells. A cell's error is STILL if it is unchanged.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt
from numba import cuda

from supple.engines.cuda.field import (
    DOMAIN,
    FIRST_FACE,
    JOINED,
    LAST_FACE,
    NEARNESS,
    PROFILE,
    SIGMA,
    SPACING,
    STROKE,
    TERM,
    Y_AXIS,
    Z_AXIS,
    carried,
    inverted,
    moved,
    product,
    still,
)
from supple.engines.cuda.kernel import device, kernel, lean
from supple.engines.cuda.newton import undo

SIZE = 8  # pixels from node to node
# A node is done when Newton's next step is shorter than TOLERANCE, in pixels; that step is then taken, and leaves about
# its square over the length on which the map varies: less than LEFT.
TOLERANCE, LEFT = 1e-3, 1e-5
# The largest error of a cell is nearly that of the worst of its nine points; the rest is reserve.
RESERVE = 2.0
# The largest size of a cell, as a fraction of the length scale of the map at its corners: in larger cells, nine points
# do not represent the points between them.
RESOLVED = 0.5
# m(|r|/R) varies over this part of R, as by its largest fourth derivative, compared with that of 1/ρ.
REACH_LENGTH = 0.4
U, X, Y, Z, TWIST, ERROR, NODE = 0, 3, 6, 9, 12, 15, 16
ROUGH, STILL = 1e30, -1.0
WORST = 0  # the index of the largest error in the results of a warp
# Indices of its counts: rough cells, unsolved points, and missing samples; then the list of rough cells.
CELLS, LOST, MISSING, LIST = 0, 1, 2, 4

_f4, _u = np.float32, np.uintp
# The points at which cells are checked.
AT_X = np.array([0.5, 0.5, 0.0, 1.0, 0.5, 0.25, 0.75, 0.25, 0.75], _f4)
AT_Y = np.array([0.0, 1.0, 0.5, 0.5, 0.5, 0.25, 0.25, 0.75, 0.75], _f4)
SEEN = 9
ZERO, ONE, TWO, THREE = _f4(0.0), _f4(1.0), _f4(2.0), _f4(3.0)


def positions(n: int, axis: npt.NDArray[np.float64], size: int = SIZE) -> npt.NDArray[np.int32]:
    """Return the positions of nodes along an axis of ``n`` samples, at most ``size`` apart.

    Parameters
    ----------
    n, size : int
    axis : float64 array
        The row of the packed domain.
    """
    if n == 1:  # a single sample gets a cell, too, which extends beyond the plane
        return np.array([0, 1], np.int32)
    # The border's factor has a kink at its end. A node there keeps cells from crossing it.
    first, last, sigma, spacing = axis[[FIRST_FACE, LAST_FACE, SIGMA, SPACING]]
    kinks = [round(k / spacing) for k in (first + sigma, last - sigma)] if sigma > 0 else []
    ends = sorted({0, *(k for k in kinks if 0 < k < n - 1), n - 1})
    return np.concatenate([*(np.arange(a, b, size) for a, b in itertools.pairwise(ends)), [n - 1]]).astype(np.int32)


@lean
def slope_weights(x0, x1, x2, x):
    """Return the weights of three values in the derivative at x of their parabola, or of the line through two."""
    if x2 == x1:
        w = 1.0 / (x1 - x0)
        return -w, w, 0.0
    a, b, c = 1.0 / (x1 - x0), 1.0 / (x2 - x0), 1.0 / (x2 - x1)
    return (2.0 * x - x1 - x2) * a * b, -(2.0 * x - x0 - x2) * a * c, (2.0 * x - x0 - x1) * b * c


@lean
def norm_of(a, b, c, d, e, f, g, h, k):
    """Return Frobenius's norm."""
    return math.sqrt(a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + k * k)


@lean
def in_pixels(a, b, c, d, e, f, g, h, k, sx, sy, sz):
    """Convert a matrix from physical units to pixels."""
    return a, b * sy / sx, c * sz / sx, d * sx / sy, e, f * sz / sy, g * sx / sz, h * sy / sz, k


@lean
def fade_length(x, first, last, sigma, profile, u, v):
    """Return the length scale of a fixed border at a coordinate, whose derivatives with respect to q are u and v."""
    # The quartic's fourth derivative is four times the sine's; no length scale resolves the kinks of either.
    far = (2.0 if profile > 0.0 else 1.4) * max(sigma, min(x - first, last - x))
    return far / max(max(abs(u), abs(v)), 1e-12) if sigma > 0.0 else 1e300


@device
def smoothness(known, at, first, last, x, y, z, a, b, d, e, g, h):
    """Return the length scale of the map at a point, in output pixels, from the columns of ∂p/∂q.

    A stroke varies over ρ, its reach over a part of R within its ball, and its border, along each axis by itself, over
    σ or the distance to it: all are scaled by the derivative of the stroke's input with respect to q.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    j, k = at + Y_AXIS, at + Z_AXIS
    u0, u1, u2 = a * known[at + SPACING], d * known[j + SPACING], g * known[k + SPACING]
    v0, v1, v2 = b * known[at + SPACING], e * known[j + SPACING], h * known[k + SPACING]
    least = 1e300
    px, py, pz = x, y, z
    n00, n01, n02, n10, n11, n12, n20, n21, n22 = m00, m01, m02, m10, m11, m12, m20, m21, m22
    for s in range(first, last, STROKE):
        if known[s + JOINED] == 0.0:
            px, py, pz = x, y, z
            n00, n01, n02, n10, n11, n12, n20, n21, n22 = m00, m01, m02, m10, m11, m12, m20, m21, m22
        ux, uy, uz = n00 * u0 + n01 * u1 + n02 * u2, n10 * u0 + n11 * u1 + n12 * u2, n20 * u0 + n21 * u1 + n22 * u2
        vx, vy, vz = n00 * v0 + n01 * v1 + n02 * v2, n10 * v0 + n11 * v1 + n12 * v2, n20 * v0 + n21 * v1 + n22 * v2
        size = math.sqrt(max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz))
        rx, ry, rz = px - known[s], py - known[s + 1], pz - known[s + 2]
        r2 = rx * rx + ry * ry + rz * rz
        length = math.sqrt(r2 + known[s + TERM])
        if known[s + NEARNESS] > 0.0:
            reach = 1.0 / math.sqrt(known[s + NEARNESS])
            length = max(min(length, REACH_LENGTH * reach), math.sqrt(r2) - reach)
        least = min(least, length / size)
        least = min(
            least,
            fade_length(
                px, known[at + FIRST_FACE], known[at + LAST_FACE], known[at + SIGMA], known[at + PROFILE], ux, vx
            ),
        )
        least = min(
            least,
            fade_length(py, known[j + FIRST_FACE], known[j + LAST_FACE], known[j + SIGMA], known[j + PROFILE], uy, vy),
        )
        least = min(
            least,
            fade_length(pz, known[k + FIRST_FACE], known[k + LAST_FACE], known[k + SIGMA], known[k + PROFILE], uz, vz),
        )
        dx, dy, dz, p, q, r, t, u, v, w, m, n = carried(known, at, s, px, py, pz)
        p, q, r, t, u, v, w, m, n = product(p, q, r, t, u, v, w, m, n, n00, n01, n02, n10, n11, n12, n20, n21, n22)
        x, y, z = x + dx, y + dy, z + dz
        m00, m01, m02 = m00 + p, m01 + q, m02 + r
        m10, m11, m12 = m10 + t, m11 + u, m12 + v
        m20, m21, m22 = m20 + w, m21 + m, m22 + n
    return least


@device
def deformation_of(spans, deformations, plane):
    """Return the offsets of a plane's deformation: its domain, its first stroke, and the end of its strokes."""
    which = plane if deformations > 1 else 0
    start = DOMAIN * deformations
    return DOMAIN * which, start + STROKE * spans[which], start + STROKE * spans[which + 1]


@device
def depth_of(known, at, plane):
    """Return the coordinate z of a plane, in samples: 0 for an image, which has no displacement along z."""
    return 0.0 if known[at + Z_AXIS + SIGMA] == 0.0 else float(plane)


@kernel
def solve(known, spans, deformations, xs, ys, planes, z0, fresh, nodes, told, counts):
    """Solve the nodes of planes: of a stack, from ``z0`` on; of several images, each by its own deformation.

    Results are reset if ``fresh``.
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
    sx, sy, sz = known[at + SPACING], known[at + Y_AXIS + SPACING], known[at + Z_AXIS + SPACING]
    depth = depth_of(known, at, z0 + plane)
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
    """Compute ∂²u/∂x∂y at the nodes, from the slopes of their neighbours."""
    i = cuda.grid(1)
    nx, ny = xs.size, ys.size
    if i >= planes * ny * nx:
        return
    j, k = i // nx % ny, i % nx
    # Three nodes in a line are more accurate than two.
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
    """Return the weights of two values and two slopes, for t from 0 to 1."""
    r = ONE - t
    return (ONE + TWO * t) * r * r, t * t * (THREE - TWO * t), t * r * r, -t * t * r


@lean
def hermite_slopes(t):
    """Return the derivatives of these weights with respect to t."""
    rise = _f4(6.0) * t * (ONE - t)
    return -rise, rise, (ONE - t) * (ONE - THREE * t), t * (THREE * t - TWO)


@lean
def across(p, p_slope, q, q_slope, h, v, w, g, k):
    """Return a cubic between two nodes, ``h`` pixels apart."""
    return v * p + w * q + h * (g * p_slope + k * q_slope)


@device
def column(nodes, upper, lower, c, h, v, w, g, k):
    """Return component ``c`` of u and ∂u/∂y for some weights, on the upper and the lower edge of a cell."""
    # Unsigned indices, since signed ones are checked for counting from the end.
    p, q, r, o = upper + c, upper + NODE + c, lower + c, lower + NODE + c
    return (
        across(nodes[_u(p)], nodes[_u(p + X)], nodes[_u(q)], nodes[_u(q + X)], h, v, w, g, k),
        across(nodes[_u(r)], nodes[_u(r + X)], nodes[_u(o)], nodes[_u(o + X)], h, v, w, g, k),
        across(nodes[_u(p + Y)], nodes[_u(p + TWIST)], nodes[_u(q + Y)], nodes[_u(q + TWIST)], h, v, w, g, k),
        across(nodes[_u(r + Y)], nodes[_u(r + TWIST)], nodes[_u(o + Y)], nodes[_u(o + TWIST)], h, v, w, g, k),
    )


@lean
def bilinear(p, q, r, o, s, t):
    """Interpolate bilinearly between four corners."""
    a, b = p + s * (q - p), r + s * (o - r)
    return a + t * (b - a)


@device
def slope_between(nodes, upper, lower, c, s, t):
    """Interpolate a number of the nodes in a cell."""
    return bilinear(
        nodes[_u(upper + c)], nodes[_u(upper + NODE + c)], nodes[_u(lower + c)], nodes[_u(lower + NODE + c)], s, t
    )


@device
def cell_error(known, at, first, last, nodes, upper, lower, x0, y0, z, h, k, s, t):
    """Return the distance from T⁻¹(q) of the cell's point at (s, t), in pixels, to first order."""
    v, w, g, r = hermite(s)
    hx, ky = _f4(h), _f4(k)
    b, d, m, n = hermite(t)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 0, hx, v, w, g, r)
    dx = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 1, hx, v, w, g, r)
    dy = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    ux0, ux1, uy0, uy1 = column(nodes, upper, lower, 2, hx, v, w, g, r)
    dz = across(ux0, uy0, ux1, uy1, ky, b, d, m, n)
    sx, sy, sz = known[at + SPACING], known[at + Y_AXIS + SPACING], known[at + Z_AXIS + SPACING]
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
    """Bound the errors of cells, in pixels, by T at nine points of each; list the rough cells."""
    i = cuda.grid(1)
    nx, ny = xs.size, ys.size
    wide, tall = nx - 1, ny - 1
    if i >= planes * tall * wide:
        return
    plane, j, k = i // (tall * wide), i // wide % tall, i % wide
    at, first, last = deformation_of(spans, deformations, z0 + plane)
    depth = depth_of(known, at, z0 + plane)
    upper = ((plane * ny + j) * nx + k) * NODE
    lower = upper + nx * NODE
    x0, y0 = float(xs[k]), float(ys[j])
    h, v = float(xs[k + 1] - xs[k]), float(ys[j + 1] - ys[j])
    sx, sy, sz = known[at + SPACING], known[at + Y_AXIS + SPACING], known[at + Z_AXIS + SPACING]
    if still(known, first, last, x0 * sx, y0 * sy, (x0 + h) * sx, (y0 + v) * sy, depth * sz):
        errors[i] = STILL
        return
    own = max(
        max(nodes[upper + ERROR], nodes[upper + NODE + ERROR]),
        max(nodes[lower + ERROR], nodes[lower + NODE + ERROR]),
    )
    worst = 0.0
    if own < ROUGH:
        seen_x, seen_y = cuda.const.array_like(AT_X), cuda.const.array_like(AT_Y)
        for m in range(SEEN):
            error = cell_error(known, at, first, last, nodes, upper, lower, x0, y0, depth, h, v, seen_x[m], seen_y[m])
            worst = max(worst, error)
            if not error < ROUGH:
                worst = ROUGH
    found = own + RESERVE * worst
    if found <= tolerance:
        errors[i] = found
        # Most cells are not the worst so far, and need no atomic maximum.
        if found > told[WORST]:
            cuda.atomic.max(told, WORST, _f4(found))
    else:
        errors[i] = ROUGH
        counts[LIST + cuda.atomic.add(counts, CELLS, 1)] = i
