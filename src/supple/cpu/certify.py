"""How far source points are from the true T⁻¹(q): measured at every pixel."""

from __future__ import annotations

import numpy as np

from supple.cpu.field import X, Y, Z
from supple.cpu.kernel import BATCH, kernel
from supple.cpu.newton import DONE, PX, PY, PZ, QX, QY, QZ, ROWS, settle


@kernel
def farthest(table, axes, z, top, points, anchors, edges, tolerance):
    """The largest distance, in pixels, of a band's points to T⁻¹; and of how many pixels this cannot be said.

    Newton's method goes on from every point to the true one, up to ``tolerance`` pixels; from scratch where that
    fails.
    """
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    start = np.empty((3, BATCH))
    sx, sy, sz = axes[0, 2], axes[1, 2], axes[2, 2]
    finest = tolerance * min(sx, min(sy, sz))
    worst, unknown = 0.0, 0
    for y in range(points.shape[1]):
        for first in range(0, points.shape[2], BATCH):
            n = min(BATCH, points.shape[2] - first)
            run = 0
            for i in range(n):
                while run < anchors.shape[0] - 1 and first + i >= edges[run + 1]:
                    run += 1
                start[2, i] = z
                for c in range(points.shape[0]):
                    start[c, i] = anchors[run, c] + np.float64(points[c, y, first + i])
                w[QX + i], w[QY + i], w[QZ + i] = (first + i) * sx, (top + y) * sy, z * sz
                w[X + i], w[Y + i], w[Z + i] = start[0, i] * sx, start[1, i] * sy, start[2, i] * sz
            settle(w, one, n, table, axes, finest, 8)
            for i in range(n):
                if w[DONE + i] == 0.0:
                    unknown += 1
                dx, dy, dz = w[PX + i] / sx - start[0, i], w[PY + i] / sy - start[1, i], w[PZ + i] / sz - start[2, i]
                worst = max(worst, dx * dx + dy * dy + dz * dz)
    return np.sqrt(worst) + tolerance, unknown
