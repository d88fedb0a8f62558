"""Colours at source points by filters: linear, cubic, averages over footprints, and elliptical ones."""

from __future__ import annotations

import numpy as np

from supple.cpu.footprint import (
    ANTIALIAS,
    AUTO,
    ENTRY,
    EWA,
    FINEST,
    LINEAR,
    MAJOR,
    MINOR,
    OBLIQUE,
    PADDED,
    PARTS,
    PLACES,
    REST,
    STEPS,
    TAPS,
    WIDEST,
    XX,
    XY,
    YY,
    extremes,
    footprints,
)
from supple.cpu.kernel import colour_kernel as kernel
from supple.cpu.kernel import inlined
from supple.cpu.pyramid import build, levels_for
from supple.cpu.region import bounds, load, spans, store
from supple.cpu.sample import CORNERS, MIXED, PART_X, PART_Y, WHERE, WIDE, limits, positions
from supple.cpu.vector import four_boxed, four_channels, one_boxed, one_channel

MOST_TAPS = 64

# Rows of a run's words, in place of those that bilinear sampling needs; and how a pixel is filtered: as a point,
# by one box, by one that is no wider than a pixel, or by what its footprint needs.
KIND, ALONG, DOWN = MIXED, CORNERS, CORNERS + WIDE
POINT, BOX, NARROW, LONG, NONE = 0, 1, 2, 3, 4

_two4, _four4 = four_channels(2), four_channels(4)
_two1, _four1 = one_channel(2), one_channel(4)
_five4, _six4 = four_boxed(5, PADDED, WIDE), four_boxed(TAPS, PADDED, WIDE)
_six1 = one_boxed(TAPS, PADDED, WIDE)


@kernel
def _boxes(tile, starts, widths, lanes, x, y, xx, xy, yy, major, minor, table, parts, pixel, out, to):
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
    box_x = min(max(xx - spread * ax * ax - had, 0.0) / (unit * unit), WIDEST * WIDEST)
    box_y = min(max(yy - spread * ay * ay - had, 0.0) / (unit * unit), WIDEST * WIDEST)
    step_x, step_y = int(box_x * STEPS + 0.5), int(box_y * STEPS + 0.5)
    rest = REST + pixel
    parts[rest + WIDE], parts[rest + 3 * WIDE] = box_x * STEPS - step_x, box_y * STEPS - step_y
    for c in range(lanes):
        out[to + c] = 0
    stride, base = widths[level], starts[level] // lanes
    share = 1.0 / count
    for k in range(count):
        t = (k + 0.5) / count - 0.5
        u, v = (x + t * ax + 0.5) / unit - 0.5, (y + t * ay + 0.5) / unit - 0.5
        i, j = int(np.floor(u)), int(np.floor(v))
        place_x, place_y = int((u - i) * PLACES + 0.5), int((v - j) * PLACES + 0.5)
        parts[rest], parts[rest + 2 * WIDE] = (u - i) * PLACES - place_x, (v - j) * PLACES - place_y
        along = (step_x * (PLACES + 1) + place_x) * ENTRY
        down = (step_y * (PLACES + 1) + place_y) * ENTRY
        at = base + (j - 2) * stride + i - 2
        if lanes == 4:
            _six4(tile, at, stride, table, along, down, parts, rest, out, WIDE * 4)
        else:
            _six1(tile, at, stride, table, along, down, parts, rest, out, WIDE)
        for c in range(lanes):
            out[to + c] += out[WIDE * lanes + c] * share


@kernel
def _ellipse(tile, stride, lanes, x, y, xx, xy, yy, out, to):
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


@inlined
def _choose(n, stride, parts, words):
    """How each pixel of a row is filtered, and where in the table its weights are.

    Of six samples, a box no wider than a pixel needs five, the first or the last ones: where it is told the stride of
    a tile, it moves to them.
    """
    most, oblique, finest = np.float32(WIDEST * WIDEST), np.float32(OBLIQUE), np.float32(FINEST * FINEST)
    places, steps, half = np.float32(PLACES), np.float32(STEPS), np.float32(0.5)
    row, entry, none = np.uint32(PLACES + 1), np.uint32(ENTRY), np.uint32(0)
    one, down = np.uint32(1 if stride else 0), np.uint32(stride)
    narrow = np.uint32(NARROW if stride else BOX)
    for i in range(n):
        x, y = parts[PART_X + i] * places, parts[PART_Y + i] * places
        across, upward = parts[XX + i] * steps, parts[YY + i] * steps
        at_x, at_y = np.int32(x + half), np.int32(y + half)
        box_x, box_y = np.int32(across + half), np.int32(upward + half)
        parts[REST + i], parts[REST + WIDE + i] = x - np.float32(at_x), across - np.float32(box_x)
        parts[REST + 2 * WIDE + i], parts[REST + 3 * WIDE + i] = y - np.float32(at_y), upward - np.float32(box_y)
        small = (box_x <= STEPS) & (box_y <= STEPS)
        right = one if small & (parts[PART_X + i] > half) else none
        below = one if small & (parts[PART_Y + i] > half) else none
        along = np.uint32(np.uint32(np.uint32(np.uint32(box_x) * row) + np.uint32(at_x)) * entry)
        beside = np.uint32(np.uint32(np.uint32(np.uint32(box_y) * row) + np.uint32(at_y)) * entry)
        words[ALONG + i], words[DOWN + i] = np.uint32(along + right), np.uint32(beside + below)
        upright = (parts[MAJOR + i] <= most) & (abs(parts[XY + i]) <= oblique)
        point = (parts[XX + i] < finest) & (parts[YY + i] < finest)
        boxed = np.uint32(POINT) if point else (narrow if small else np.uint32(BOX))
        words[KIND + i] = boxed if upright else np.uint32(LONG)
        moved = np.uint32(right + np.uint32(below * down))
        words[WHERE + i] += moved if words[KIND + i] == np.uint32(NARROW) else none


@inlined
def choose(n, mode, stride, parts, words):
    """How each pixel of a row is filtered, of a tile with that stride; 0 if samples are not taken from a tile."""
    if mode in (AUTO, ANTIALIAS):
        _choose(n, stride, parts, words)
    else:
        kind = np.uint32(LONG if mode == EWA else POINT)
        for i in range(n):
            words[KIND + i] = kind


@inlined
def filter_row(tile, starts, widths, lanes, n, mode, largest, stride, words, parts, table, values):
    """The filtered values of a row's pixels, whose positions and footprints are in ``words`` and ``parts``."""
    for i in range(n):
        at, kind = np.int64(words[WHERE + i]), words[KIND + i]
        if kind == np.uint32(NARROW):
            along, down = np.int64(words[ALONG + i]), np.int64(words[DOWN + i])
            _five4(tile, at - 2 * stride - 2, stride, table, along, down, parts, REST + i, values, 4 * i)
        elif kind == np.uint32(BOX):
            along, down = np.int64(words[ALONG + i]), np.int64(words[DOWN + i])
            if lanes == 4:
                _six4(tile, at - 2 * stride - 2, stride, table, along, down, parts, REST + i, values, 4 * i)
            else:
                _six1(tile, at - 2 * stride - 2, stride, table, along, down, parts, REST + i, values, i)
        elif kind == np.uint32(LONG):
            x = np.float64(at % stride) + parts[PART_X + i]
            y = np.float64(at // stride) + parts[PART_Y + i]
            major, minor = np.float64(parts[MAJOR + i]), np.float64(parts[MINOR + i])
            # The tile has room for footprints up to the largest that is expected.
            fit = min(1.0, largest / major)
            xx, xy, yy = fit * parts[XX + i], fit * parts[XY + i], fit * parts[YY + i]
            if mode == EWA:
                _ellipse(tile, stride, lanes, x, y, xx, xy, yy, values, i * lanes)
            else:
                _boxes(
                    tile,
                    starts,
                    widths,
                    lanes,
                    x,
                    y,
                    xx,
                    xy,
                    yy,
                    fit * major,
                    fit * minor,
                    table,
                    parts,
                    i,
                    values,
                    i * lanes,
                )
        elif kind == np.uint32(NONE):
            pass
        elif mode == LINEAR:
            x, y = parts[PART_X + i], parts[PART_Y + i]
            if lanes == 4:
                _two4(tile, at, stride, x, y, values, 4 * i)
            else:
                _two1(tile, at, stride, x, y, values, i)
        else:
            x, y = parts[PART_X + i], parts[PART_Y + i]
            if lanes == 4:
                _four4(tile, at - stride - 1, stride, x, y, values, 4 * i)
            else:
                _four1(tile, at - stride - 1, stride, x, y, values, i)


@inlined
def tile_of(points, beyond, anchors, boxes, run, left, n, width, height, rule, mode, parts):
    """The part of a source that a run of pixels needs, whole at every level of its pyramid.

    Returns its bounds x0, x1, y0 and y1, the margin in them, the coarsest level, and the largest σ₁'².
    """
    margin, coarsest, largest = 3, 0, 0.0
    if mode >= AUTO:
        largest, second = extremes(points, beyond, anchors, run, left, n, mode, parts)
        coarsest = 0 if mode == EWA else levels_for(second, WIDEST)
        margin = int(np.ceil((1.0 if mode == EWA else 0.5) * np.sqrt(largest))) + 3 * 2**coarsest + 1
    x0, x1 = bounds(boxes, run, 0, width, rule, margin)
    y0, y1 = bounds(boxes, run, 1, height, rule, margin)
    unit = 2**coarsest
    x0, y0 = x0 - x0 % unit, y0 - y0 % unit
    x1, y1 = x1 + (x0 - x1) % unit, y1 + (y0 - y1) % unit
    return x0, x1, y0, y1, margin, coarsest, largest


@kernel
def filtered(
    source,
    points,
    beyond,
    anchors,
    edges,
    boxes,
    mode,
    lanes,
    rule,
    fill,
    alpha,
    top,
    levels,
    table,
    linear,
    low,
    high,
    whole,
    octets,
    out,
):
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
    alpha, top, levels, linear, low, high, whole, octets
        See `supple.cpu.region.load` and `store`.
    table : float array
        `supple.cpu.footprint.weights`, of the type that all is worked out in.
    """
    height, width, channels = source.shape
    words, parts = np.empty(6 * WIDE, np.uint32), np.empty(PARTS, np.float32)
    values = np.empty((WIDE + 1) * lanes, table.dtype)  # and room for one box
    tile, rows = np.empty(1, table.dtype), np.empty((2, 1), np.int64)
    for run in range(anchors.shape[0]):
        left, right = edges[run], min(edges[run + 1], out.shape[1])
        n = right - left
        x0, x1, y0, y1, margin, coarsest, largest = tile_of(
            points, beyond, anchors, boxes, run, left, n, width, height, rule, mode, parts
        )
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
            spans(boxes, run, width, height, x0, x1, y0, y1, rule, margin, 0.0, 0.0, rows)
        low_x, high_x = limits(anchors[run], 0, width, rule, margin)
        low_y, high_y = limits(anchors[run], 1, height, rule, margin)
        move_x, move_y = np.float32(anchors[run, 0] - x0), np.float32(anchors[run, 1] - y0)
        step = lanes if alpha < 0 else lanes - 1
        for first in range(0, channels if alpha < 0 else channels - 1, step):
            load(source, first, lanes, x0, x1, y0, y1, rows, rule, fill, alpha, top, levels, octets, tile)
            starts, widths = build(tile, wide, tall, lanes, coarsest)
            for y in range(out.shape[0]):
                if mode >= AUTO:
                    footprints(points, beyond, anchors, run, y, left, n, mode, parts)
                positions(points, y, left, n, move_x, move_y, low_x, high_x, low_y, high_y, wide, words, parts)
                choose(n, mode, wide if lanes == 4 else 0, parts, words)
                filter_row(tile, starts, widths, lanes, n, mode, largest, wide, words, parts, table, values)
                store(values, first, lanes, n, alpha, top, low, high, whole, linear, octets, out, y, left)
