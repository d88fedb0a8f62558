"""Many planes at a time, without a word of Python in between: map and linear samples of one channel.

What `supple.cpu.warp` and `supple.cpu.stack` do for a plane takes some tenths of a millisecond of Python, which cores
cannot share; a volume of small planes would be mostly that.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.band import EVALUATIONS, REACH, RUN, STATS, WORST, source_points
from supple.cpu.frames import linear_floats, linear_single
from supple.cpu.kernel import colour_kernel, kernel
from supple.cpu.lattice import NODE, U, set_twists, solve_rows


@kernel
def _solve(table, axes, z, xs, ys, nodes):
    """The lattice of a plane; returns its evaluations, and the largest component of the displacement at a node."""
    spent = solve_rows(table, axes, z, xs, ys, 0, ys.size, nodes)
    set_twists(xs, ys, xs.size, ys.size, 0, ys.size, 3, nodes)
    most = 0.0
    for j in range(ys.size):
        for i in range(xs.size):
            for c in range(3):
                most = max(most, abs(nodes[j, i, U + c]))
    return spent, most


@kernel
def _fill(table, axes, z, xs, ys, tolerance, nodes, points, anchors, boxes, none, stats):
    """The source points of a whole plane; see `supple.cpu.warp.each_band`."""
    height, width = points.shape[1], points.shape[2]
    steps = np.array([1.0, 1.0, 0.0, 0.0, np.float64(xs[-1]), np.float64(ys[-1])])
    stats[:] = 0.0
    source_points(
        table,
        axes,
        z,
        xs,
        ys,
        width,
        height,
        0,
        ys.size - 1,
        tolerance,
        nodes,
        points,
        anchors,
        boxes,
        steps,
        none,
        anchors.copy(),
        boxes[:, :0],
        stats,
    )


@colour_kernel
def linear_slab(table, axes, planes, xs, ys, tolerance, slack, samples, shape, zero, whole, high, floats, out, found):
    """Warp planes of a volume of one channel, with linear samples, and edges that go on.

    Parameters
    ----------
    planes : int64 array
        Which ones.
    tolerance, slack : float
        How exact the map is to be, in pixels, and what of that float32 may need.
    samples : flat array
    shape : int64 array (frames, rows, columns)
    zero, whole, high
        As `supple.cpu.frames.linear_plain` takes them.
    floats : bool
        Whether samples are float32, and worked with as such.
    out : array, shape (planes, rows, columns, 1)
    found : float64 array, shape (planes, 3)
        Receives the error, the evaluations, and 1 where next to nothing moves: such planes are left to the caller.
    """
    count, height, width = shape[0], shape[1], shape[2]
    nodes = np.empty((ys.size, xs.size, NODE))
    runs = -(-(xs.size - 1) // RUN)
    points, none = np.empty((3, height, width), np.float32), np.empty((3, 0, 0), np.float32)
    anchors, boxes = np.empty((runs, 3), np.int64), np.empty((ys.size - 1, xs.size - 1, 3, 2))
    stats, edges, slots = np.zeros(STATS), np.empty(runs + 1, np.int64), np.arange(count)
    for run in range(runs):
        edges[run] = xs[run * RUN]
    edges[runs] = width
    for k in range(planes.size):
        z = np.float64(planes[k])
        spent, most = _solve(table, axes, z, xs, ys, nodes)
        found[k, 0], found[k, 1], found[k, 2] = 0.0, spent, 1.0
        if most * np.sqrt(3.0) <= tolerance:
            continue
        _fill(table, axes, z, xs, ys, max(tolerance - slack, 0.0), nodes, points, anchors, boxes, none, stats)
        if floats:
            linear_floats(samples, slots, count, 0, height, width, points, anchors, edges, out[k])
        else:
            linear_single(samples, slots, count, 0, height, width, points, anchors, edges, zero, whole, high, out[k])
        found[k, 0] = stats[WORST] + 2.0**-22 * stats[REACH]
        found[k, 1], found[k, 2] = spent + stats[EVALUATIONS], 0.0
