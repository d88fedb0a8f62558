"""Colours at source points by filters: linear, cubic, averages over footprints, and elliptical ones."""

from __future__ import annotations

import numpy as np

from supple.cpu.band import RUN
from supple.cpu.footprint import (
    ANTIALIAS, AUTO, BOX_X, BOX_Y, CUBIC, EWA, LINEAR, MAJOR, MINOR, OBLIQUE, PARTS, PLACES, STEPS, TAPS, WIDEST, XX,
    XY, YY, footprints,
)  # fmt: skip
from supple.cpu.kernel import colour_kernel as kernel
from supple.cpu.lattice import SIZE
from supple.cpu.pyramid import build, levels_for
from supple.cpu.region import bounds, load, spans, store
from supple.cpu.sample import PART_X, PART_Y, WHERE, WIDE, limits, positions

MOST_TAPS = 64


@kernel
def _sum4(tile, at, stride, table, along, down, count, out, to):  # type: ignore[no-untyped-def]
    """Four channels of ``count`` by ``count`` samples from ``at`` on, weighted by the table's two rows."""
    s0, s1, s2, s3 = tile[0] * 0, tile[0] * 0, tile[0] * 0, tile[0] * 0
    for j in range(count):
        k = 4 * (at + j * stride)
        r0, r1, r2, r3 = tile[0] * 0, tile[0] * 0, tile[0] * 0, tile[0] * 0
        for i in range(count):
            v = table[along + i]
            r0 += v * tile[k + 4 * i]
            r1 += v * tile[k + 4 * i + 1]
            r2 += v * tile[k + 4 * i + 2]
            r3 += v * tile[k + 4 * i + 3]
        v = table[down + j]
        s0, s1, s2, s3 = s0 + v * r0, s1 + v * r1, s2 + v * r2, s3 + v * r3
    out[to], out[to + 1], out[to + 2], out[to + 3] = s0, s1, s2, s3


@kernel
def _sum1(tile, at, stride, table, along, down, count, out, to):  # type: ignore[no-untyped-def]
    total = tile[0] * 0
    for j in range(count):
        k = at + j * stride
        line = tile[0] * 0
        for i in range(count):
            line += table[along + i] * tile[k + i]
        total += table[down + j] * line
    out[to] = total


@kernel
def _cubic_weights(part, own, at):  # type: ignore[no-untyped-def]
    own[at] = part
    t = own[at]  # now of the type that all is worked out in
    half, one = t * 0 + np.float32(0.5), t * 0 + np.float32(1.0)
    own[at] = half * t * ((one + one - t) * t - one)
    own[at + 1] = half * (t * t * (3 * t - 5) + one + one)
    own[at + 2] = half * t * ((4 - 3 * t) * t + one)
    own[at + 3] = half * t * t * (t - one)


@kernel
def _boxes(tile, starts, widths, lanes, x, y, xx, xy, yy, major, minor, table, out, to):  # type: ignore[no-untyped-def]
    """The average over a footprint of any form around (x, y), by boxes along its major axis."""
    level, unit = 0, 1.0
    while level < starts.size - 1 and minor > WIDEST * WIDEST * unit * unit:
        level, unit = level + 1, 2.0 * unit
    # The major axis, an eigenvector of C'.
    ax, ay = (xy, major - xx) if xx < yy else (major - yy, xy)
    size = np.sqrt(ax * ax + ay * ay)
    if size > 1e-12:
        ax, ay = ax / size * np.sqrt(major), ay / size * np.sqrt(major)
    else:
        ax, ay = np.sqrt(major), 0.0
    count = min(max(2, int(np.ceil(np.sqrt(major) / (1.5 * unit)))), MOST_TAPS)
    # What the boxes' spread does not average, and the level has not, is left to each box.
    spread, had = 1.0 - 1.0 / (count * count), unit * unit - 1.0
    box_x = min(np.sqrt(max(xx - spread * ax * ax - had, 0.0)) / unit, WIDEST)
    box_y = min(np.sqrt(max(yy - spread * ay * ay - had, 0.0)) / unit, WIDEST)
    row_x, row_y = int(box_x * STEPS + 0.5) * (PLACES + 1), int(box_y * STEPS + 0.5) * (PLACES + 1)
    for c in range(lanes):
        out[to + c] = 0
    stride = widths[level]
    for k in range(count):
        t = (k + 0.5) / count - 0.5
        u, v = (x + t * ax + 0.5) / unit - 0.5, (y + t * ay + 0.5) / unit - 0.5
        i, j = int(np.floor(u)), int(np.floor(v))
        along = (row_x + int((u - i) * PLACES + 0.5)) * TAPS
        down = (row_y + int((v - j) * PLACES + 0.5)) * TAPS
        for b in range(TAPS):
            at = starts[level] + ((j - 2 + b) * stride + i - 2) * lanes
            for c in range(lanes):
                line = out[to] * 0
                for a in range(TAPS):
                    line += table[along + a] * tile[at + a * lanes + c]
                out[to + c] += table[down + b] * line / count


@kernel
def _ellipse(tile, stride, lanes, x, y, xx, xy, yy, out, to):  # type: ignore[no-untyped-def]
    """Heckbert's elliptical weighted average: exp(-2 r²) within the ellipse r² = dᵀ C⁻¹ d ≤ 1."""
    scale = 1.0 / (xx * yy - xy * xy)
    reach_x, reach_y = np.sqrt(xx), np.sqrt(yy)
    total = 0.0
    for c in range(lanes):
        out[to + c] = 0
    for j in range(int(np.ceil(y - reach_y)), int(np.floor(y + reach_y)) + 1):
        for i in range(int(np.ceil(x - reach_x)), int(np.floor(x + reach_x)) + 1):
            dx, dy = i - x, j - y
            r2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) * scale
            if r2 <= 1.0:
                v = np.exp(-2.0 * r2)
                total += v
                for c in range(lanes):
                    out[to + c] += v * tile[(j * stride + i) * lanes + c]
    for c in range(lanes):
        out[to + c] /= total


@kernel
def _row(tile, starts, widths, lanes, n, mode, x0, y0, stride, words, parts, table, own, values):  # type: ignore[no-untyped-def]
    """The filtered values of a row's pixels, whose positions and footprints are in ``words`` and ``parts``."""
    for i in range(n):
        at = np.int64(words[WHERE + i])
        upright = True
        if mode == AUTO or mode == ANTIALIAS:
            upright = (
                parts[MAJOR + i] <= np.float32(WIDEST * WIDEST) and abs(parts[XY + i]) <= np.float32(OBLIQUE)
            )
        if mode == EWA or not upright:
            x = np.float64(at % stride) + parts[PART_X + i]
            y = np.float64(at // stride) + parts[PART_Y + i]
            xx, xy, yy = np.float64(parts[XX + i]), np.float64(parts[XY + i]), np.float64(parts[YY + i])
            if mode == EWA:
                _ellipse(tile, stride, lanes, x, y, xx, xy, yy, values, i * lanes)
            else:
                major, minor = np.float64(parts[MAJOR + i]), np.float64(parts[MINOR + i])
                _boxes(
                    tile, starts, widths, lanes, x, y, xx, xy, yy, major, minor, table, values, i * lanes
                )
            continue
        if mode == LINEAR:
            own[1], own[5] = parts[PART_X + i], parts[PART_Y + i]
            own[0], own[4] = 1 - own[1], 1 - own[5]
            if lanes == 4:
                _sum4(tile, at, stride, own, 0, 4, 2, values, 4 * i)
            else:
                _sum1(tile, at, stride, own, 0, 4, 2, values, i)
            continue
        box_x, box_y = 0, 0
        if mode != CUBIC:
            box_x, box_y = np.int64(parts[BOX_X + i]), np.int64(parts[BOX_Y + i])
        if box_x == 0 and box_y == 0:
            _cubic_weights(parts[PART_X + i], own, 0)
            _cubic_weights(parts[PART_Y + i], own, 4)
            if lanes == 4:
                _sum4(tile, at - stride - 1, stride, own, 0, 4, 4, values, 4 * i)
            else:
                _sum1(tile, at - stride - 1, stride, own, 0, 4, 4, values, i)
        else:
            along = (box_x * (PLACES + 1) + np.int64(parts[PART_X + i] * np.float32(PLACES) + np.float32(0.5))) * TAPS
            down = (box_y * (PLACES + 1) + np.int64(parts[PART_Y + i] * np.float32(PLACES) + np.float32(0.5))) * TAPS
            if lanes == 4:
                _sum4(tile, at - 2 * stride - 2, stride, table, along, down, TAPS, values, 4 * i)
            else:
                _sum1(tile, at - 2 * stride - 2, stride, table, along, down, TAPS, values, i)


@kernel
def filtered(source, points, anchors, boxes, mode, lanes, rule, fill, alpha, top, levels, table, own, linear, low, high, whole, out):  # type: ignore[no-untyped-def]
    """Sample a band by any filter but nearest.

    Parameters
    ----------
    source : array, shape (height, width, channels)
    mode : int
        LINEAR, CUBIC, AUTO, ANTIALIAS or EWA.
    lanes : int
        4, or 1 for one channel: how many are worked on together.
    fill : array, shape (channels,)
        What lies outside, in the tile's numbers, under the rule CONSTANT.
    alpha, top, levels, linear, low, high, whole
        See `supple.cpu.region.load` and `store`.
    table : float array
        `supple.cpu.footprint.weights`, of the type that all is worked out in.
    own : array of 8, of that type
    """
    height, width, channels = source.shape
    words, parts = np.empty(6 * WIDE, np.uint32), np.empty(PARTS, np.float32)
    values = np.empty(WIDE * lanes, table.dtype)
    tile, rows = np.empty(1, table.dtype), np.empty((2, 1), np.int64)
    for run in range(anchors.shape[0]):
        left = run * RUN * SIZE
        right = out.shape[1] if run == anchors.shape[0] - 1 else left + RUN * SIZE
        n = right - left
        margin, coarsest = 3, 0
        if mode >= AUTO:
            largest, second = 0.0, 0.0
            for y in range(out.shape[0]):
                a, b = footprints(points, y, left, n, mode, parts)
                largest, second = max(largest, a), max(second, b)
            coarsest = 0 if mode == EWA else levels_for(second, WIDEST)
            margin = int(np.ceil((1.0 if mode == EWA else 0.5) * np.sqrt(largest))) + 3 * 2**coarsest + 1
        x0, x1 = bounds(boxes, run, 0, width, rule, margin)
        y0, y1 = bounds(boxes, run, 1, height, rule, margin)
        unit = 2**coarsest
        x0, y0 = x0 - x0 % unit, y0 - y0 % unit
        x1, y1 = x1 + (x0 - x1) % unit, y1 + (y0 - y1) % unit
        wide, tall = x1 - x0, y1 - y0
        # Every level is a quarter of the one before.
        if tile.size < wide * tall * lanes * (2 if coarsest else 1):
            tile = np.empty(wide * tall * lanes * (2 if coarsest else 1), table.dtype)
        if rows.shape[1] < tall:
            rows = np.empty((2, 2 * tall), np.int64)
        if coarsest:
            for y in range(tall):
                rows[0, y], rows[1, y] = x0, x1
        else:
            spans(boxes, run, width, height, x0, x1, y0, y1, rule, margin, rows)
        low_x, high_x = limits(anchors[run], 0, width, rule, margin)
        low_y, high_y = limits(anchors[run], 1, height, rule, margin)
        move_x, move_y = np.float32(anchors[run, 0] - x0), np.float32(anchors[run, 1] - y0)
        for first in range(0, channels, lanes):
            load(source, first, lanes, x0, x1, y0, y1, rows, rule, fill, alpha, top, levels, tile)
            starts, widths = build(tile, wide, tall, lanes, coarsest)
            for y in range(out.shape[0]):
                if mode >= AUTO:
                    footprints(points, y, left, n, mode, parts)
                positions(points, y, left, n, move_x, move_y, low_x, high_x, low_y, high_y, wide, words, parts)
                _row(tile, starts, widths, lanes, n, mode, x0, y0, wide, words, parts, table, own, values)
                store(values, first, lanes, n, alpha, top, low, high, whole, linear, out, y, left)
