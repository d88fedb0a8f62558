"""T⁻¹ for a band of a plane: every pixel's source point, from a lattice that is refined where it has to be.

Source points are float32, relative to an integer anchor for each run of cells, so that they keep their precision
however large the image is.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.field import X, Z
from supple.cpu.kernel import BATCH, inlined, kernel
from supple.cpu.lattice import (
    ERROR,
    NODE,
    RESOLVED,
    SIZE,
    SMOOTH,
    TOGETHER,
    TWIST,
    M,
    U,
    check,
    patch,
    set_twists,
    solve_batch,
    too_coarse,
)
from supple.cpu.newton import DONE, NORM, PX, QX, QY, QZ, ROWS, settle
from supple.cpu.vector import write_cubic

RUN = 8  # cells that share an anchor
FARTHEST = 2.0**22  # samples from the first one that an anchor lies at most: float32 counts so far, and twice
WIDTH = SIZE + 1
WORST, EVALUATIONS, REACH, FAR, RATE, STATS = 0, 1, 2, 3, 4, 5


@kernel
def _cubic(v0, d0, v1, d1, inverse):
    """The coefficients of the cubic with values and slopes given at 0 and at 1 / ``inverse``."""
    rise = (v1 - v0) * inverse
    return v0, d0, (3.0 * rise - 2.0 * d0 - d1) * inverse, (d0 + d1 - 2.0 * rise) * inverse * inverse


@inlined
def _bound(low, high, a, dx, dy, twist):
    """Extend bounds by a corner's four control points."""
    d = a + dx + dy + twist
    low = min(min(low, a), min(min(a + dx, a + dy), d))
    high = max(max(high, a), max(max(a + dx, a + dy), d))
    return low, high


@inlined
def _far(a, dx, dy, twist):
    return max(max(abs(a), abs(a + dx)), max(abs(a + dy), abs(a + dx + dy + twist)))


@inlined
def _write(flat, at, n, a, b, d, e):
    """``n`` values of a cubic polynomial, from 0 on."""
    c0, c1, c2, c3 = np.float32(a), np.float32(b), np.float32(d), np.float32(e)
    for i in range(0, n - 7, 8):
        write_cubic(flat, at + i, np.float32(i), c0, c1, c2, c3)
    for i in range(n - n % 8, n):
        s = np.float32(i)
        flat[at + i] = c0 + s * (c1 + s * (c2 + s * c3))


@kernel
def _fill_rates(nodes, j, i, h, k, width, height, left, top, x, y, points, grid, first, coarse):
    """Write a cell's ∂p_t/∂t, bilinear between its nodes, beside its source points."""
    m = M + 8
    p, q, r, o = nodes[j, i, m], nodes[j, i + 1, m], nodes[j + 1, i, m], nodes[j + 1, i + 1, m]
    for v in range(height):
        t = v / k
        a, b = p + t * (r - p), q + t * (o - q)
        for u in range(width):
            points[3, top + v, left + u] = a + u / h * (b - a)
    if coarse.shape[1] > 0:
        u0, v0 = int(np.ceil((x - grid[2]) / grid[0])), int(np.ceil((y - grid[3]) / grid[1]))
        u1, v1 = int(np.ceil((x + h - grid[2]) / grid[0])), int(np.ceil((y + k - grid[3]) / grid[1]))
        u1 = coarse.shape[2] if x + h >= grid[4] else min(u1, coarse.shape[2])
        v1 = first + coarse.shape[1] if y + k >= grid[5] else min(v1, first + coarse.shape[1])
        for v in range(v0, v1):
            t = min((grid[1] * v + grid[3] - y) / k, 1.0)
            a, b = p + t * (r - p), q + t * (o - q)
            for u in range(u0, u1):
                coarse[3, v - first, u] = a + min((grid[0] * u + grid[2] - x) / h, 1.0) * (b - a)


@kernel
def _fill(
    nodes, j, i, h, k, width, height, left, top, x, y, anchor, points, box, grid, grid_anchor, first, coarse, own, stats
):
    """Write a cell's source points: ``width`` by ``height`` pixels from column ``left`` and row ``top`` on.

    ``box`` grows by what bounds them: a Bézier patch lies within its control points. The cell starts at the pixel
    (``x``, ``y``). Where the samples of a coarser grid lie in it, their source points go to ``coarse``, which starts
    at the grid's row ``first``. Beyond the plane, the map goes on as it does beyond a fixed face.
    """
    p, q, r, o = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]
    flat, coarse_flat = points.reshape(-1), coarse.reshape(-1)
    for c in range(min(points.shape[0], 3)):
        one_x, one_y = (1.0 if c == 0 else 0.0), (1.0 if c == 1 else 0.0)
        offset = (x if c == 0 else (y if c == 1 else anchor[3])) - anchor[c]
        mx, my, f = M + 3 * c, M + 3 * c + 1, TWIST + c
        pu, qu, ru, ou = p[c], q[c], r[c], o[c]
        px, qx, rx, kx = p[mx] - one_x, q[mx] - one_x, r[mx] - one_x, o[mx] - one_x
        py, qy, ry, ky = p[my] - one_y, q[my] - one_y, r[my] - one_y, o[my] - one_y
        pf, qf, rf, of = p[f], q[f], r[f], o[f]
        across, down, both = h / 3.0, k / 3.0, h * k / 9.0
        low, high = _bound(box[c, 0], box[c, 1], offset + pu, across * (px + one_x), down * (py + one_y), both * pf)
        low, high = _bound(low, high, offset + qu + one_x * h, -across * (qx + one_x), down * (qy + one_y), -both * qf)
        low, high = _bound(low, high, offset + ru + one_y * k, across * (rx + one_x), -down * (ry + one_y), -both * rf)
        box[c, 0], box[c, 1] = _bound(
            low, high, offset + ou + one_x * h + one_y * k, -across * (kx + one_x), -down * (ky + one_y), both * of
        )
        if points.shape[1] == 0:  # only bounds are wanted
            for m in (M + 6, M + 7, M + 8):
                slope = max(max(abs(p[m]), abs(q[m])), max(abs(r[m]), abs(o[m])))
                stats[RATE] = max(stats[RATE], slope)
            far = max(
                _far(pu, across * px, down * py, both * pf),
                _far(qu, -across * qx, down * qy, -both * qf),
            )
            far = max(far, _far(ru, across * rx, -down * ry, -both * rf))
            stats[FAR] = max(stats[FAR], max(far, _far(ou, -across * kx, -down * ky, both * of)))
            continue
        # As a polynomial in pixels: first along the left and the right edge, then across.
        a0, a1, a2, a3 = _cubic(pu, py, ru, ry, 1.0 / k)
        b0, b1, b2, b3 = _cubic(qu, qy, ou, ky, 1.0 / k)
        d0, d1, d2, d3 = _cubic(px, pf, rx, rf, 1.0 / k)
        e0, e1, e2, e3 = _cubic(qx, qf, kx, of, 1.0 / k)
        p00, p01, p02, p03 = _cubic(a0, d0, b0, e0, 1.0 / h)
        p10, p11, p12, p13 = _cubic(a1, d1, b1, e1, 1.0 / h)
        p20, p21, p22, p23 = _cubic(a2, d2, b2, e2, 1.0 / h)
        p30, p31, p32, p33 = _cubic(a3, d3, b3, e3, 1.0 / h)
        p00, p01, p10 = p00 + offset, p01 + one_x, p10 + one_y
        # The polynomials of all rows first, several at a time.
        for v in range(height):
            t = np.float64(np.int32(v))
            own[v] = p00 + t * (p10 + t * (p20 + t * p30))
            own[WIDTH + v] = p01 + t * (p11 + t * (p21 + t * p31))
            own[2 * WIDTH + v] = p02 + t * (p12 + t * (p22 + t * p32))
            own[3 * WIDTH + v] = p03 + t * (p13 + t * (p23 + t * p33))
        for v in range(height):
            a, b, d, e = own[v], own[WIDTH + v], own[2 * WIDTH + v], own[3 * WIDTH + v]
            at = ((c * points.shape[1] + top + v) * points.shape[2]) + left
            _write(flat, at, width, a, b, d, e)
            if width > h:  # the plane's last column, where steep slopes may cancel
                flat[at + width - 1] = np.float32(a + h * (b + h * (d + h * e)))
        if coarse.shape[1] > 0:
            # The same polynomial where the samples of a coarser grid lie, in their numbers.
            fx, fy, ox, oy = grid[0], grid[1], grid[2], grid[3]
            u0, v0 = int(np.ceil((x - ox) / fx)), int(np.ceil((y - oy) / fy))
            u1, v1 = int(np.ceil((x + h - ox) / fx)), int(np.ceil((y + k - oy) / fy))
            u2 = u1
            if x + h >= grid[4]:  # the plane's last column, and samples that lie beyond it
                u1, u2 = int(np.floor((x + h - ox) / fx)) + 1, coarse.shape[2]
            if y + k >= grid[5]:
                v1 = first + coarse.shape[1]
            u1, v1 = min(u1, coarse.shape[2]), min(v1, first + coarse.shape[1])
            unit, sited = (fx, ox) if c == 0 else ((fy, oy) if c == 1 else (1.0, 0.0))
            moved, scale = (anchor[c] - sited) / unit - grid_anchor[c], 1.0 / unit
            s = fx * u0 + ox - x
            fx2, fx3 = scale * fx * fx, scale * fx * fx * fx
            for v in range(v1 - v0):
                t = fy * np.float64(np.int32(v)) + (fy * v0 + oy - y)
                beyond = max(t - k, 0.0)
                t -= beyond
                a, b = p00 + t * (p10 + t * (p20 + t * p30)), p01 + t * (p11 + t * (p21 + t * p31))
                d, e = p02 + t * (p12 + t * (p22 + t * p32)), p03 + t * (p13 + t * (p23 + t * p33))
                a += one_y * beyond
                own[4 * WIDTH + v] = a + h * (b + h * (d + h * e))  # in the plane's last column
                own[v] = moved + scale * (a + s * (b + s * (d + s * e)))
                own[WIDTH + v] = scale * fx * (b + s * (2.0 * d + 3.0 * s * e))
                own[2 * WIDTH + v] = fx2 * (d + 3.0 * s * e)
                own[3 * WIDTH + v] = fx3 * e
            for v in range(v1 - v0):
                at = (c * coarse.shape[1] + v0 + v - first) * coarse.shape[2] + u0
                _write(coarse_flat, at, u1 - u0, own[v], own[WIDTH + v], own[2 * WIDTH + v], own[3 * WIDTH + v])
                for u in range(u1, u2):
                    beyond = one_x * (fx * u + ox - x - h)
                    coarse_flat[at + u - u0] = np.float32(moved + scale * (own[4 * WIDTH + v] + beyond))
    if points.shape[0] == 4:
        _fill_rates(nodes, j, i, h, k, width, height, left, top, x, y, points, grid, first, coarse)


@kernel
def _copy(source, j, i, target, v, u):
    for m in range(NODE):
        target[v, u, m] = source[j, i, m]


@kernel
def _halves(a, b, split):
    return (a, (a + b) // 2, b) if split and b - a > 1 else (a, b, b)


@kernel
def _sides(cell):
    """Where a cell is split: three or two positions along each axis."""
    h, k, side = cell[1] - cell[0], cell[3] - cell[2], cell[4]
    xs = _halves(cell[0], cell[1], side != 2 or k == 1)
    ys = _halves(cell[2], cell[3], side != 1 or h == 1)
    return xs, ys


@inlined
def _solve_middles(w, one, table, axes, z, x0, y0, cells, count, smooth, ndim, local, solved):
    """Solve the nodes in the middles of cells and of their edges; once each. Returns the evaluations."""
    cols, rows = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    n, evaluations = 0, 0.0
    corners = np.empty((2, 2, NODE))  # a cell's, side by side, as the patch wants them
    for m in range(count):
        a0, a1, b0, b1 = cells[m, 0], cells[m, 1], cells[m, 2], cells[m, 3]
        _copy(local, b0, a0, corners, 0, 0)
        _copy(local, b0, a1, corners, 0, 1)
        _copy(local, b1, a0, corners, 1, 0)
        _copy(local, b1, a1, corners, 1, 1)
        xs, ys = _sides(cells[m])
        for v in range(3):
            for u in range(3):
                col, row = xs[u], ys[v]
                if solved[row, col]:
                    continue
                solved[row, col] = True
                cols[n], rows[n] = col, row
                w[QX + n] = (x0 + col) * axes[0, 2]
                w[QY + n] = (y0 + row) * axes[1, 2]
                w[QZ + n] = z * axes[2, 2]
                w[Z + n] = w[QZ + n]
                for c in range(ndim):
                    value = patch(corners, 0, 0, c, a1 - a0, b1 - b0, (col - a0) / (a1 - a0), (row - b0) / (b1 - b0))
                    w[X + c * BATCH + n] = w[QX + c * BATCH + n] + value * axes[c, 2]
                n += 1
                if n == BATCH:
                    evaluations += solve_batch(w, one, n, table, axes, cols, rows, True, smooth, local)
                    n = 0
    if n > 0:
        evaluations += solve_batch(w, one, n, table, axes, cols, rows, True, smooth, local)
    return evaluations


@kernel
def _settle_coarse(w, one, table, axes, z, x, y, grid, anchor, first, coarse):
    """Solve for the samples of the coarser grid in a cell of one pixel, where no patch is good enough.

    Returns the residual, in physical units, of those that did not converge.
    """
    fx, fy, ox, oy = grid[0], grid[1], grid[2], grid[3]
    u0, v0 = int(np.ceil((x - ox) / fx)), int(np.ceil((y - oy) / fy))
    # The last cell has its right and lower edge, too, and samples beyond: there, the map goes on as at the edge.
    u1 = coarse.shape[2] if x + 1 >= grid[4] else int(np.ceil((x + 1 - ox) / fx))
    v1 = first + coarse.shape[1] if y + 1 >= grid[5] else int(np.ceil((y + 1 - oy) / fy))
    finest, worst = 1e-4 * min(axes[0, 2], min(axes[1, 2], axes[2, 2])), 0.0
    for v in range(max(v0, first), min(v1, first + coarse.shape[1])):
        for u in range(u0, min(u1, coarse.shape[2])):
            left, down = fx * u + ox - x, fy * v + oy - y
            right, below = max(left - 1.0, 0.0), max(down - 1.0, 0.0)
            w[QX], w[QY], w[QZ] = (x + left - right) * axes[0, 2], (y + down - below) * axes[1, 2], z * axes[2, 2]
            w[Z] = w[QZ]
            for c in range(min(coarse.shape[0], 3)):
                unit, sited = (fx, ox) if c == 0 else ((fy, oy) if c == 1 else (1.0, 0.0))
                beyond = right if c == 0 else (below if c == 1 else 0.0)
                guess = (anchor[c] + np.float64(coarse[c, v - first, u])) * unit + sited - beyond
                w[X + c * BATCH] = guess * axes[c, 2]
            settle(w, one, 1, table, axes, finest, 10)
            for c in range(min(coarse.shape[0], 3)):
                unit, sited = (fx, ox) if c == 0 else ((fy, oy) if c == 1 else (1.0, 0.0))
                beyond = right if c == 0 else (below if c == 1 else 0.0)
                found = (w[PX + c * BATCH] / axes[c, 2] + beyond - sited) / unit
                coarse[c, v - first, u] = np.float32(found - anchor[c])
            if w[DONE] == 0.0:
                worst = max(worst, np.sqrt(w[NORM]))
    return worst


@inlined
def _refine(
    w,
    one,
    table,
    axes,
    z,
    x0,
    y0,
    h,
    k,
    side,
    width,
    height,
    left,
    top,
    anchor,
    tolerance,
    local,
    solved,
    points,
    box,
    grid,
    grid_anchor,
    row0,
    coarse,
    own,
    stats,
):
    """Split a cell until every part of it is as exact as it should be, and fill the parts."""
    cells, following = np.empty((SIZE * SIZE, 5), np.int64), np.empty((SIZE * SIZE, 5), np.int64)
    cx, cy, ch, ck = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    ci, cj = np.empty(4, np.int64), np.empty(4, np.int64)
    errors, sides = np.empty(4), np.empty(4, np.int64)
    mini, mx, my = np.empty((3, 3, NODE)), np.empty(3), np.empty(3)
    for v in range(k + 1):
        for u in range(h + 1):
            solved[v, u] = (u == 0 or u == h) and (v == 0 or v == k)
    cells[0, 0], cells[0, 1], cells[0, 2], cells[0, 3] = 0, h, 0, k
    cells[0, 4] = side
    count = 1
    between, ndim = coarse.shape[1] > 0, min(points.shape[0], 3)
    # Where the whole cell is resolved, so are its parts.
    smooth = max(h, k) > RESOLVED * min(
        min(local[0, 0, SMOOTH], local[0, h, SMOOTH]), min(local[k, 0, SMOOTH], local[k, h, SMOOTH])
    )
    while count > 0:
        stats[EVALUATIONS] += _solve_middles(w, one, table, axes, z, x0, y0, cells, count, smooth, ndim, local, solved)
        more = 0
        for m in range(count):
            xs, ys = _sides(cells[m])
            nx, ny = (3 if xs[2] > xs[1] else 2), (3 if ys[2] > ys[1] else 2)
            for v in range(ny):
                my[v] = ys[v]
                for u in range(nx):
                    mx[u] = xs[u]
                    _copy(local, ys[v], xs[u], mini, v, u)
            set_twists(mx, my, nx, ny, 0, ny, ndim, mini)
            n = 0
            for v in range(ny - 1):
                for u in range(nx - 1):
                    ci[n], cj[n] = u, v
                    cx[n], cy[n] = x0 + xs[u], y0 + ys[v]
                    ch[n], ck[n] = xs[u + 1] - xs[u], ys[v + 1] - ys[v]
                    n += 1
            check(w, n, table, axes, ndim, z, cx, cy, ch, ck, cj, ci, mini, errors, sides)
            for e in range(n):
                u, v = ci[e], cj[e]
                a0, a1, b0, b1 = xs[u], xs[u + 1], ys[v], ys[v + 1]
                single = a1 - a0 == 1 and b1 - b0 == 1
                error = errors[e]
                if single:  # nothing lies between its nodes; what is between them is made exact
                    inner = errors[e]
                    error = max(
                        max(mini[v, u, ERROR], mini[v, u + 1, ERROR]),
                        max(mini[v + 1, u, ERROR], mini[v + 1, u + 1, ERROR]),
                    )
                if single or (error <= tolerance and not too_coarse(mini, v, u, ch[e], ck[e])):
                    stats[WORST] = max(stats[WORST], error)
                    across = a1 - a0 + (1 if a1 == h and width > h else 0)
                    down = b1 - b0 + (1 if b1 == k and height > k else 0)
                    _fill(
                        mini,
                        v,
                        u,
                        ch[e],
                        ck[e],
                        across,
                        down,
                        left + a0,
                        top + b0,
                        x0 + a0,
                        y0 + b0,
                        anchor,
                        points,
                        box,
                        grid,
                        grid_anchor,
                        row0,
                        coarse,
                        own,
                        stats,
                    )
                    if single and between and inner > 0.25 * tolerance:
                        missed = _settle_coarse(
                            w, one, table, axes, z, x0 + a0, y0 + b0, grid, grid_anchor, row0, coarse
                        )
                        stats[WORST] = max(stats[WORST], missed)
                else:
                    following[more, 0], following[more, 1] = a0, a1
                    following[more, 2], following[more, 3] = b0, b1
                    following[more, 4] = sides[e]
                    more += 1
                    for d in range(2):
                        for f in range(2):
                            for c in range(3):
                                local[ys[v + d], xs[u + f], TWIST + c] = mini[v + d, u + f, TWIST + c]
        cells, following = following, cells
        count = more


@kernel
def source_points(
    table,
    axes,
    z,
    xs,
    ys,
    wide,
    tall,
    first,
    last,
    tolerance,
    nodes,
    points,
    anchors,
    boxes,
    grid,
    coarse,
    coarse_anchors,
    coarse_boxes,
    stats,
):
    """The source points of all pixels in the lattice's cell rows ``first`` to ``last - 1``.

    Parameters
    ----------
    wide, tall : int
        The plane's size in pixels; a lattice of one column or row reaches beyond it.
    points : float32 array, shape (2, 3 or 4, rows of pixels, wide)
        Receives the points, in pixels, less the anchor of their run; without rows, only bounds are found. The fourth
        is ∂p_t/∂t.
    anchors : int64 array, shape (runs, 3)
    boxes : float64 array, shape (last - first, cells, 2 or 3, 2)
        Receives the smallest and the largest coordinate of each cell's points, in pixels.
    grid : float64 array (step x, step y, offset x, offset y, last x, last y)
        Where the samples of a coarser grid lie, in pixels; and the last node of the lattice.
    coarse : float32 array, shape (2, 3 or 4, rows of samples, samples)
        Receives the points of those, in steps of their grid, less their anchors; has no rows if there is none.
    coarse_anchors : int64 array, shape (runs, 3)
    coarse_boxes : float64 array
        The same for this grid, in its numbers; without cells if there is none.
    stats : float64 array, shape (STATS,)
        Worst error that the checks let expect, in pixels; evaluations of T; the farthest that a point is from its
        anchor; and, if only bounds are found, a bound of every component of the displacement, and the largest
        component of ∂p_t/∂q at a node.
    """
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    local, solved = np.empty((SIZE + 1, SIZE + 1, NODE)), np.empty((SIZE + 1, SIZE + 1), np.bool_)
    cols, rows = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    cx, cy, ch, ck = np.empty(TOGETHER), np.empty(TOGETHER), np.empty(TOGETHER), np.empty(TOGETHER)
    errors, box, sides = np.empty(TOGETHER), np.empty((3, 2)), np.empty(TOGETHER, np.int64)
    anchor, own = np.empty(4), np.empty(5 * WIDTH)
    anchor[3] = z
    ndim = min(points.shape[0], 3)
    row0 = int(np.ceil((ys[first] - grid[3]) / grid[1]))
    for run in range(anchors.shape[0]):
        node = nodes[first, run * RUN]
        anchors[run, 0] = np.int64(min(max(xs[run * RUN] + np.rint(node[U]), -FARTHEST), FARTHEST))
        anchors[run, 1] = np.int64(min(max(ys[first] + np.rint(node[U + 1]), -FARTHEST), FARTHEST))
        anchors[run, 2] = np.int64(min(max(z + np.rint(node[U + 2]), -FARTHEST), FARTHEST))
        coarse_anchors[run, 0] = np.int64(np.rint((anchors[run, 0] - grid[2]) / grid[0]))
        coarse_anchors[run, 1] = np.int64(np.rint((anchors[run, 1] - grid[3]) / grid[1]))
        coarse_anchors[run, 2] = anchors[run, 2]
    for j in range(first, last):
        for start in range(0, xs.size - 1, TOGETHER):
            n = min(TOGETHER, xs.size - 1 - start)
            for m in range(n):
                i = start + m
                cols[m], rows[m] = i, j
                cx[m], cy[m] = xs[i], ys[j]
                ch[m], ck[m] = xs[i + 1] - xs[i], ys[j + 1] - ys[j]
            check(w, n, table, axes, ndim, z, cx, cy, ch, ck, rows, cols, nodes, errors, sides)
            for m in range(n):
                i = start + m
                h, k = xs[i + 1] - xs[i], ys[j + 1] - ys[j]
                left, top = xs[i], ys[j] - ys[first]
                width = h + 1 if i == xs.size - 2 and wide > 1 else h
                height = k + 1 if j == ys.size - 2 and tall > 1 else k
                run = i // RUN
                for c in range(3):
                    anchor[c] = anchors[run, c]
                    box[c, 0], box[c, 1] = 1e300, -1e300
                if errors[m] <= tolerance and not too_coarse(nodes, j, i, h, k):
                    stats[WORST] = max(stats[WORST], errors[m])
                    _fill(
                        nodes,
                        j,
                        i,
                        h,
                        k,
                        width,
                        height,
                        left,
                        top,
                        xs[i],
                        ys[j],
                        anchor,
                        points,
                        box,
                        grid,
                        coarse_anchors[run],
                        row0,
                        coarse,
                        own,
                        stats,
                    )
                else:
                    _copy(nodes, j, i, local, 0, 0)
                    _copy(nodes, j, i + 1, local, 0, h)
                    _copy(nodes, j + 1, i, local, k, 0)
                    _copy(nodes, j + 1, i + 1, local, k, h)
                    _refine(
                        w,
                        one,
                        table,
                        axes,
                        z,
                        xs[i],
                        ys[j],
                        h,
                        k,
                        sides[m],
                        width,
                        height,
                        left,
                        top,
                        anchor,
                        tolerance,
                        local,
                        solved,
                        points,
                        box,
                        grid,
                        coarse_anchors[run],
                        row0,
                        coarse,
                        own,
                        stats,
                    )
                for c in range(ndim):
                    stats[REACH] = max(stats[REACH], max(abs(box[c, 0]), abs(box[c, 1])))
                    boxes[j - first, i, c, 0] = anchor[c] + box[c, 0]
                    boxes[j - first, i, c, 1] = anchor[c] + box[c, 1]
                if coarse_boxes.shape[1] > 0:
                    for c in range(ndim):
                        unit, sited = (grid[c], grid[2 + c]) if c < 2 else (1.0, 0.0)
                        for side in range(2):
                            coarse_boxes[j - first, i, c, side] = (anchor[c] + box[c, side] - sited) / unit
