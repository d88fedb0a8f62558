"""The source points of the rows above and below a band: what its first and its last pixels cover is told by them.

They are those of the bands beside it, which are not at hand. Where the band's own rows say well enough how they go on,
that is taken; elsewhere, under brushes of a few pixels and where the border's influence ends, they are solved.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.field import X
from supple.cpu.footprint import bent
from supple.cpu.kernel import BATCH, kernel
from supple.cpu.newton import PX, QX, ROWS, settle

CLEAR = 1e-3  # pixels: how far cubics through a band's rows may be from parabolas
ENOUGH = 4  # rows: so many tell how a picture goes on beyond its edge


@kernel
def _row(points, c, k, last, x):
    """A coordinate in the k-th row from the first, or from the last one on."""
    return np.float64(points[c, points.shape[1] - 1 - k if last else k, x])


@kernel
def _clear(points, c, last, x, kinks):
    """What comes before a band's first row, or after its last one, and whether that is as good as solved.

    Between ``kinks``, which are in the numbers of the points, a map is smooth.
    """
    near = _row(points, c, 0, last, x)
    if points.shape[1] == 1:
        return near + (0.0 if c != 1 else (1.0 if last else -1.0)), False
    second = _row(points, c, 1, last, x)
    if points.shape[1] < 5:
        return 2.0 * near - second, False
    third, fourth, fifth = _row(points, c, 2, last, x), _row(points, c, 3, last, x), _row(points, c, 4, last, x)
    bend, before = near - 3.0 * second + 3.0 * third - fourth, second - 3.0 * third + 3.0 * fourth - fifth
    guess = 3.0 * near - 3.0 * second + third + bend
    clear = max(abs(bend), abs(before)) <= CLEAR
    if c == 1:
        low, high = min(near, guess) - 0.5, max(near, guess) + 0.5
        clear &= (kinks[0] < low or kinks[0] > high) and (kinks[1] < low or kinks[1] > high)
    return guess, clear


@kernel
def _ends(points, last, x, given):
    """What would come beyond the picture's edge, so that central differences are what slopes are at an edge."""
    for c in range(given.shape[0]):
        near = _row(points, c, 0, last, x)
        if points.shape[1] == 1:
            given[c, x] = np.float32(near + (0.0 if c != 1 else (1.0 if last else -1.0)))
            continue
        second = _row(points, c, 1, last, x)
        slope = second - near
        if points.shape[1] >= ENOUGH:
            third, fourth = _row(points, c, 2, last, x), _row(points, c, 3, last, x)
            slope = bent(slope, third - second, fourth - third)
        given[c, x] = np.float32(second - 2.0 * slope)


@kernel
def _solve(table, axes, z, steps, y, finest, anchors, edges, clear, row):
    """The points of a row from guesses, but for those that are clear."""
    if clear.all():
        return
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    places, runs = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    ndim, n, run = row.shape[0], 0, 0
    for x in range(row.shape[1] + 1):
        done = x == row.shape[1]
        if not done and not clear[x]:
            while run < anchors.shape[0] - 1 and x >= edges[run + 1]:
                run += 1
            w[QX + n] = (steps[0] * x + steps[2]) * axes[0, 2]
            w[QX + BATCH + n] = (steps[1] * y + steps[3]) * axes[1, 2]
            w[QX + 2 * BATCH + n] = w[X + 2 * BATCH + n] = z * axes[2, 2]
            for c in range(ndim):
                unit, sited = (steps[c], steps[2 + c]) if c < 2 else (1.0, 0.0)
                w[X + c * BATCH + n] = ((anchors[run, c] + np.float64(row[c, x])) * unit + sited) * axes[c, 2]
            places[n], runs[n] = x, run
            n += 1
        if n == BATCH or (done and n > 0):
            settle(w, one, n, table, axes, finest, 8)
            for i in range(n):
                for c in range(ndim):
                    unit, sited = (steps[c], steps[2 + c]) if c < 2 else (1.0, 0.0)
                    found = (w[PX + c * BATCH + i] / axes[c, 2] - sited) / unit
                    row[c, places[i]] = np.float32(found - anchors[runs[i], c])
            n = 0


@kernel
def _more(table, axes, z, steps, y, on, count, finest, points, anchors, edges, ndim):
    """The first rows from an edge on, y the one at it, where a band has too few of them."""
    columns = points.shape[2]
    more, clear = np.empty((ndim, count, columns), np.float32), np.zeros(columns, np.bool_)
    for k in range(count):
        if k < points.shape[1]:
            more[:, k] = points[:ndim, k if on > 0 else points.shape[1] - 1 - k]
            continue
        if k == 1:
            more[:, 1] = more[:, 0]
            more[1, 1] += np.float32(on)
        else:
            more[:, k] = np.float32(2.0) * more[:, k - 1] - more[:, k - 2]
        _solve(table, axes, z, steps, y + k * on, finest, anchors, edges, clear, more[:, k])
    return more


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
    ndim, columns, rows = beyond.shape[1], beyond.shape[2], points.shape[1]
    finest = tolerance * min(axes[0, 2], min(axes[1, 2], axes[2, 2]))
    clear, kinks = np.ones(columns, np.bool_), np.empty(2)
    for last in range(2):
        y = top + rows if last else top - 1
        if 0 <= y < count:
            for run in range(anchors.shape[0]):
                for k in range(2):
                    end = axes[1, 0] - axes[1, 1] if k else axes[1, 1]
                    kinks[k] = (end / axes[1, 2] - steps[3]) / steps[1] - anchors[run, 1] if axes[1, 1] > 0 else 1e300
                for x in range(edges[run], min(edges[run + 1], columns)):
                    clear[x] = True
                    for c in range(ndim):
                        guess, known = _clear(points, c, last == 1, x, kinks)
                        beyond[last, c, x] = np.float32(guess)
                        clear[x] &= known
            _solve(table, axes, z, steps, y, finest, anchors, edges, clear, beyond[last])
        elif rows < min(ENOUGH, count):
            first, on = (y - 1, -1) if last else (0, 1)
            more = _more(table, axes, z, steps, first, on, min(ENOUGH, count), finest, points, anchors, edges, ndim)
            for x in range(columns):
                _ends(more, False, x, beyond[last])
        else:
            for x in range(columns):
                _ends(points, last == 1, x, beyond[last])
