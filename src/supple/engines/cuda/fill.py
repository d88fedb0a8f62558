"""The kernels that fill planes: source points, from the lattice or solved, and colours.

A thread of `fill` computes a column of pixels of a cell: the terms of the corners are evaluated once for it, and ∂p/∂q
is the cell's own derivative. In rough cells, threads of `rough` solve each pixel. Unchanged pixels are copied, bit for
bit.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numba import cuda

from supple.engines.cuda.colour import AUTO, MAP, NOTHING, OFFSETS, colour, keeper
from supple.engines.cuda.field import SPACING, Y_AXIS, Z_AXIS, inverted, still
from supple.engines.cuda.kernel import made_kernel
from supple.engines.cuda.lattice import (
    CELLS,
    LEFT,
    LIST,
    LOST,
    NODE,
    ROUGH,
    WORST,
    Z,
    column,
    deformation_of,
    depth_of,
    hermite,
    hermite_slopes,
    in_pixels,
    norm_of,
    slope_between,
)
from supple.engines.cuda.newton import settle
from supple.engines.cuda.sample import Way

# The planes: their size, number and first index, the number of deformations, and a flag for images that share one
# lattice.
PLANES = ("height", "width", "count", "first", "deformations", "shared")
HEIGHT, WIDTH, COUNT, FIRST, DEFORMATIONS, SHARED = range(len(PLANES))
# The destination: strides, and the index of the first sample, in samples.
TARGET = ("plane", "row", "column", "channel", "start")
PLANE, ROW, COLUMN, CHANNEL, START = range(len(TARGET))

PIXELS = 64  # threads of a rough cell
_f4 = np.float32
ZERO, ONE = _f4(0.0), _f4(1.0)


@functools.cache
def kernels(way: Way) -> tuple[Any, Any]:
    """Return the kernels for good cells and for rough ones."""
    paint, keep, index, limited = colour(way), keeper(way), way.index, way.limited
    deep = way.between != NOTHING or way.filter in (MAP, OFFSETS)  # whether planes are of a stack
    wide, average = way.filter == AUTO, way.average
    one = index(1)

    @made_kernel
    def fill(known, spans, xs, ys, cells, nodes, errors, planes, samples, fills, source, how, limits, out, target,
             counts):  # fmt: skip
        x, j, p = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x, cuda.blockIdx.y, cuda.blockIdx.z
        if x >= planes[WIDTH]:
            return
        nx, ny = xs.size, ys.size
        i = int(cells[x])
        own = 0 if planes[SHARED] > 0 else p
        error = errors[(own * (ny - 1) + j) * (nx - 1) + i]
        if error >= ROUGH:
            return
        upper = ((own * ny + j) * nx + i) * NODE
        lower = upper + nx * NODE
        left, top = index(xs[i]), index(ys[j])
        h, k = _f4(xs[i + 1] - xs[i]), _f4(ys[j + 1] - ys[j])
        s, part = _f4(x - left) / h, ONE / k
        v, w, g, r = hermite(s)
        x0, x1, x2, x3 = column(nodes, upper, lower, 0, h, v, w, g, r)
        y0, y1, y2, y3 = column(nodes, upper, lower, 1, h, v, w, g, r)
        z0, z1, z2, z3 = ZERO, ZERO, ZERO, ZERO
        if deep:
            z0, z1, z2, z3 = column(nodes, upper, lower, 2, h, v, w, g, r)
        p0, p1, p2, p3, q0, q1, q2, q3 = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
        r0, r1, r2, r3 = ZERO, ZERO, ZERO, ZERO
        if wide or average:  # the derivatives with respect to x
            v, w, g, r = hermite_slopes(s)
            v, w = v / h, w / h
            if wide:
                p0, p1, p2, p3 = column(nodes, upper, lower, 0, ONE, v, w, g, r)
                q0, q1, q2, q3 = column(nodes, upper, lower, 1, ONE, v, w, g, r)
            if average:
                r0, r1, r2, r3 = column(nodes, upper, lower, 2, ONE, v, w, g, r)
        sx, sy, depth, here, first, last = 1.0, 1.0, 0.0, 0, 0, 0
        if limited:
            here, first, last = deformation_of(spans, planes[DEFORMATIONS], planes[FIRST] + own)
            sx, sy = known[here + SPACING], known[here + Y_AXIS + SPACING]
            depth = depth_of(known, here, planes[FIRST] + own) * known[here + Z_AXIS + SPACING]
        end = index(ys[j + 1])
        if j == ny - 2 and end < planes[HEIGHT]:
            end = index(end + one)  # the last pixel is the last node
        end = min(end, index(planes[HEIGHT]))
        z = index(planes[FIRST] + p)
        ux, uy, uz = ZERO, ZERO, ZERO
        xx, xy, yx, yy, tx, ty, tt = ONE, ZERO, ZERO, ONE, ZERO, ZERO, ONE
        at = index(target[START] + p * target[PLANE] + top * target[ROW] + x * target[COLUMN])
        y = top
        while y < end:
            kept = False
            if limited:
                qx, qy = x * sx, y * sy
                kept = error < ZERO or still(known, first, last, qx, qy, qx, qy, depth) > 0
            if kept:
                keep(samples, fills, source, how, limits, z, index(x), y, z, ZERO, ZERO, ZERO,
                     xx, xy, yx, yy, tx, ty, tt, out, at, target[CHANNEL], counts)  # fmt: skip
            else:
                t = part * _f4(index(y - top))
                b, d, m, n = hermite(t)
                m, n = k * m, k * n
                ux, uy = b * x0 + d * x1 + m * x2 + n * x3, b * y0 + d * y1 + m * y2 + n * y3
                if deep:
                    uz = b * z0 + d * z1 + m * z2 + n * z3
                if wide or average:
                    v, w, g, r = hermite_slopes(t)
                    v, w = part * v, part * w
                    if wide:
                        xx = ONE + (b * p0 + d * p1 + m * p2 + n * p3)
                        yx = b * q0 + d * q1 + m * q2 + n * q3
                        xy = v * x0 + w * x1 + g * x2 + r * x3
                        yy = ONE + (v * y0 + w * y1 + g * y2 + r * y3)
                    if average:
                        tx = b * r0 + d * r1 + m * r2 + n * r3
                        ty = v * z0 + w * z1 + g * z2 + r * z3
                        tt = ONE + slope_between(nodes, upper, lower, Z + 2, s, t)
                paint(samples, fills, source, how, limits, z, index(x), y, z, ux, uy, uz,
                      xx, xy, yx, yy, tx, ty, tt, out, at, target[CHANNEL], counts)  # fmt: skip
            at = index(at + target[ROW])
            y = index(y + one)

    @made_kernel
    def rough(known, spans, xs, ys, nodes, planes, tolerance, samples, fills, source, how, limits, out, target,
              told, counts):  # fmt: skip
        nx, ny = xs.size, ys.size
        for listed in range(cuda.blockIdx.x, counts[CELLS], cuda.gridDim.x):
            cell = int(counts[LIST + listed])
            own, j, i = cell // ((nx - 1) * (ny - 1)), cell // (nx - 1) % (ny - 1), cell % (nx - 1)
            left, top = int(xs[i]), int(ys[j])
            right, bottom = int(xs[i + 1]), int(ys[j + 1])
            if i == nx - 2:
                right = planes[WIDTH]
            if j == ny - 2:
                bottom = planes[HEIGHT]
            at, first, last = deformation_of(spans, planes[DEFORMATIONS], planes[FIRST] + own)
            sx, sy, sz = known[at + SPACING], known[at + Y_AXIS + SPACING], known[at + Z_AXIS + SPACING]
            finest = min(sx, min(sy, sz))
            upper = ((own * ny + j) * nx + i) * NODE
            lower = upper + nx * NODE
            h, k = _f4(right - left), _f4(bottom - top)
            depth = depth_of(known, at, planes[FIRST] + own)
            for pixel in range(cuda.threadIdx.x, (right - left) * (bottom - top), cuda.blockDim.x):
                x, y = left + pixel % (right - left), top + pixel // (right - left)
                s, t = _f4(x - left) / h, _f4(y - top) / k
                qx, qy, qz = x * sx, y * sy, depth * sz
                ux, uy = slope_between(nodes, upper, lower, 0, s, t), slope_between(nodes, upper, lower, 1, s, t)
                uz = slope_between(nodes, upper, lower, 2, s, t)
                close = 0.01 * min(tolerance, 1.0) * finest
                px, py, pz, norm, done, _, a, b, c, d, e, f, g, m, n = settle(
                    known, at, first, last, qx, qy, qz, qx + ux * sx, qy + uy * sy, qz + uz * sz, close, 10
                )
                a, b, c, d, e, f, g, m, n = inverted(a, b, c, d, e, f, g, m, n)
                a, b, c, d, e, f, g, m, n = in_pixels(a, b, c, d, e, f, g, m, n, sx, sy, sz)
                error = LEFT
                if not done:
                    error += norm_of(a, b, c, d, e, f, g, m, n) * math.sqrt(norm) / finest
                    if not error <= tolerance:
                        cuda.atomic.add(counts, LOST, 1)
                        error = ROUGH
                if error > told[WORST]:
                    cuda.atomic.max(told, WORST, _f4(error))
                ux, uy, uz = _f4((px - qx) / sx), _f4((py - qy) / sy), _f4((pz - qz) / sz)
                kept = limited and still(known, first, last, qx, qy, qx, qy, qz) > 0
                begin, end = own, own + 1
                if planes[SHARED] > 0:
                    begin, end = 0, planes[COUNT]
                for p in range(begin, end):
                    to = index(target[START] + p * target[PLANE] + y * target[ROW] + x * target[COLUMN])
                    z = index(planes[FIRST] + p)
                    if kept:
                        keep(samples, fills, source, how, limits, z, index(x), index(y), z, ZERO, ZERO, ZERO,
                             ONE, ZERO, ZERO, ONE, ZERO, ZERO, ONE, out, to, target[CHANNEL], counts)  # fmt: skip
                    else:
                        paint(samples, fills, source, how, limits, z, index(x), index(y), z, ux, uy, uz,
                              _f4(a), _f4(b), _f4(d), _f4(e), _f4(g), _f4(m), _f4(n), out, to, target[CHANNEL],
                              counts)  # fmt: skip

    return fill, rough
