"""The source points of the rows above and below a band: what its first and its last pixels cover is told by them.

They are those of the bands beside it, which are not at hand. Where the band's own rows say well enough how they go on,
that is taken; elsewhere, under brushes of a few pixels, they are solved.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.field import X
from supple.cpu.footprint import MOST_BEND
from supple.cpu.kernel import BATCH, kernel
from supple.cpu.newton import DONE, PX, QX, ROWS, settle

CLEAR = 1e-3  # pixels: how far a parabola and a cubic through a band's rows may be apart


@kernel
def _row(points, c, k, last, x):
    """A coordinate in the k-th row from the first, or from the last one on."""
    return np.float64(points[c, points.shape[1] - 1 - k if last else k, x])


@kernel
def _goes_on(points, c, last, x):
    """What comes before a band's first row, or after its last one; and how far it is from another guess."""
    rows = points.shape[1]
    near = _row(points, c, 0, last, x)
    if rows == 1:
        return near + (0.0 if c != 1 else (1.0 if last else -1.0)), 1.0
    second = _row(points, c, 1, last, x)
    if rows == 2:
        return 2.0 * near - second, 1.0
    third = _row(points, c, 2, last, x)
    parabola = 3.0 * near - 3.0 * second + third
    if rows == 3:
        return parabola, 1.0
    bend = near - 3.0 * second + 3.0 * third - _row(points, c, 3, last, x)
    return parabola + bend, abs(bend)


@kernel
def _ends(points, c, last, x):
    """What would come beyond the picture's edge: as the rows go on, but where these vary at once."""
    near = _row(points, c, 0, last, x)
    if points.shape[1] < 4:
        return _goes_on(points, c, last, x)[0] if points.shape[1] == 1 else 2.0 * near - _row(points, c, 1, last, x)
    plain = 2.0 * near - _row(points, c, 1, last, x)
    curved = _goes_on(points, c, last, x)[0]
    return plain + min(max(curved - plain, -2.0 * MOST_BEND), 2.0 * MOST_BEND)


@kernel
def _solve(w, one, n, places, table, axes, steps, finest, c_end, last, anchors, runs, beyond):
    settle(w, one, n, table, axes, finest, 8)
    for i in range(n):
        if w[DONE + i] != 0.0:
            for c in range(c_end):
                unit, sited = (steps[c], steps[2 + c]) if c < 2 else (1.0, 0.0)
                found = (w[PX + c * BATCH + i] / axes[c, 2] - sited) / unit
                beyond[last, c, places[i]] = np.float32(found - anchors[runs[i], c])


@kernel
def rows_beyond(table, axes, z, steps, top, count, points, anchors, edges, tolerance, beyond):
    """Find them.

    Parameters
    ----------
    table, axes, z
        As `supple.cpu.warp.Plane` has them.
    steps : float64 array, shape (4,)
        How many pixels there are from one sample to the next, along x and y, and where the first one lies.
    top, count : int
        Which of the grid's rows the band's first one is, and how many it has in all: those beyond are of the edge.
    points, anchors, edges
        The band's, which has a row at least.
    tolerance : float
        In pixels.
    beyond : float32 array, shape (2, ndim, columns)
        Receives the points above and below, relative to the anchors of their runs.
    """
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    places, runs = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    ndim = beyond.shape[1]
    finest = tolerance * min(axes[0, 2], min(axes[1, 2], axes[2, 2]))
    for last in range(2):
        y = top + points.shape[1] if last else top - 1
        inside, n = 0 <= y < count, 0
        for run in range(anchors.shape[0]):
            for x in range(edges[run], min(edges[run + 1], points.shape[2])):
                unclear = 0.0
                for c in range(ndim):
                    if inside:
                        guess, off = _goes_on(points, c, last == 1, x)
                        unclear = max(unclear, off)
                    else:
                        guess = _ends(points, c, last == 1, x)
                    beyond[last, c, x] = np.float32(guess)
                if unclear <= CLEAR:
                    continue
                w[QX + n], w[QX + BATCH + n] = (
                    (steps[0] * x + steps[2]) * axes[0, 2],
                    (steps[1] * y + steps[3]) * axes[1, 2],
                )
                w[QX + 2 * BATCH + n] = w[X + 2 * BATCH + n] = z * axes[2, 2]
                for c in range(ndim):
                    unit, sited = (steps[c], steps[2 + c]) if c < 2 else (1.0, 0.0)
                    guess = anchors[run, c] + np.float64(beyond[last, c, x])
                    w[X + c * BATCH + n] = (guess * unit + sited) * axes[c, 2]
                places[n], runs[n] = x, run
                n += 1
                if n == BATCH:
                    _solve(w, one, n, places, table, axes, steps, finest, ndim, last, anchors, runs, beyond)
                    n = 0
        if n > 0:
            _solve(w, one, n, places, table, axes, steps, finest, ndim, last, anchors, runs, beyond)
