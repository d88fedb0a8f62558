"""Bounds on the frames that planes may read, from the nodes of their lattices."""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from supple.engines.cuda.kernel import kernel, lean
from supple.engines.cuda.lattice import NODE, U, X, Y, Z

# For a plane: the least and the largest displacement in time, and the largest number of frames of a pixel.
LEAST, MOST, COVERED, FOUND = 0, 1, 2, 4

_f4 = np.float32
ONE, FAR = _f4(1.0), _f4(1e30)
# The largest value of t (1 − t)², the weight of a slope in a cubic.
PART = _f4(4.0 / 27.0)


@lean
def bulge(p, p_slope, q, q_slope, h):
    """Return the largest distance of a cubic from the line between two nodes, ``h`` pixels apart."""
    line = (q - p) / h
    return PART * h * (abs(p_slope - line) + abs(q_slope - line))


@lean
def covered(x, y, z):
    """Return the number of frames that a pixel covers at a node."""
    return math.sqrt(x * x + y * y + (ONE + z) * (ONE + z))


@kernel
def bound(xs, ys, planes, z0, nodes, found):
    """Bound the cells of planes from ``z0`` on, a thread for each row; rough cells have no bounds."""
    i = cuda.grid(1)
    nx, ny = xs.size, ys.size
    if i >= planes * (ny - 1):
        return
    plane, j = i // (ny - 1), i % (ny - 1)
    v = _f4(ys[j + 1] - ys[j])
    least, most, long = FAR, -FAR, ONE
    for k in range(nx - 1):
        h = _f4(xs[k + 1] - xs[k])
        p = ((plane * ny + j) * nx + k) * NODE + U + 2  # along z
        q, r = p + NODE, p + nx * NODE
        o = r + NODE
        a, b, c, d = nodes[p], nodes[q], nodes[r], nodes[o]
        beyond = max(bulge(a, nodes[p + X], b, nodes[q + X], h), bulge(c, nodes[r + X], d, nodes[o + X], h))
        beyond += max(bulge(a, nodes[p + Y], c, nodes[r + Y], v), bulge(b, nodes[q + Y], d, nodes[o + Y], v))
        least = min(least, min(min(a, b), min(c, d)) - beyond)
        most = max(most, max(max(a, b), max(c, d)) + beyond)
        long = max(long, covered(nodes[p + X], nodes[p + Y], nodes[p + Z]))
        long = max(long, covered(nodes[q + X], nodes[q + Y], nodes[q + Z]))
        long = max(long, covered(nodes[r + X], nodes[r + Y], nodes[r + Z]))
        long = max(long, covered(nodes[o + X], nodes[o + Y], nodes[o + Z]))
    at = (z0 + plane) * FOUND
    cuda.atomic.min(found, at + LEAST, _f4(least))
    cuda.atomic.max(found, at + MOST, _f4(most))
    cuda.atomic.max(found, at + COVERED, _f4(long))
