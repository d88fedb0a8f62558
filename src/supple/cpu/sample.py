"""Colours at source points: nearest and linear.

A row of a run is done in passes: positions and weights; the samples that they need; the arithmetic. The first and
the last work on several pixels at once, which one loop over all three would not.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.band import FARTHEST, RUN
from supple.cpu.kernel import kernel
from supple.cpu.lattice import SIZE
from supple.cpu.region import REFLECT, bounds, load_words, place, spans

WIDE = RUN * SIZE + 1  # pixels of the longest run

# Rows of a run's scratch, in two flat arrays: of words, and of fractions.
WHERE, MIXED, CORNERS = 0, WIDE, 2 * WIDE
PART_X, PART_Y = 0, WIDE


@kernel
def nearest_to(anchor, offset):
    """The sample nearest to a point; ties go to the larger index. Farther out than can be counted, all are as far."""
    most, half = np.float32(2.0**60), np.float32(0.5)
    return anchor + np.int64(np.floor(min(max(offset, -most), most) + half))


@kernel
def nearest(source, points, anchors, edges, rule, fill, out):
    """The sample nearest to each point; ties go to the larger index, as in rounding half up."""
    height, width, channels = source.shape
    for run in range(anchors.shape[0]):
        for y in range(out.shape[0]):
            for x in range(edges[run], min(edges[run + 1], out.shape[1])):
                i = place(nearest_to(anchors[run, 0], points[0, y, x]), width, rule)
                j = place(nearest_to(anchors[run, 1], points[1, y, x]), height, rule)
                for c in range(channels):
                    out[y, x, c] = fill[c] if i < 0 or j < 0 else source[j, i, c]


@kernel
def positions(points, row, first, n, x0, y0, low_x, high_x, low_y, high_y, stride, words, parts):
    """Where in a tile each of ``n`` points lies: the sample above and left of it, and how far beyond that it is."""
    xs, ys = points[0, row, first : first + n], points[1, row, first : first + n]
    for i in range(n):
        x, y = min(max(xs[i], low_x), high_x) + x0, min(max(ys[i], low_y), high_y) + y0
        # Within a tile, all is above 0, where cutting off is rounding down.
        a, b = np.int32(x), np.int32(y)
        parts[PART_X + i], parts[PART_Y + i] = x - np.float32(a), y - np.float32(b)
        words[WHERE + i] = np.uint32(np.int32(b) * np.int32(stride) + np.int32(a))


@kernel
def limits(anchor, axis, size, rule, margin):
    """Within which points have to be drawn, relative to their anchor, for a tile with that margin to hold them."""
    if rule == REFLECT:
        return np.float32(-FARTHEST - anchor[axis]), np.float32(FARTHEST - anchor[axis])
    return np.float32(-margin - anchor[axis]), np.float32(size - 1 + margin - anchor[axis])


@kernel
def _gather(tile, n, stride, words):
    below = np.uint32(stride)
    for i in range(n):
        k = words[WHERE + i]
        words[CORNERS + i], words[CORNERS + WIDE + i] = tile[k], tile[k + np.uint32(1)]
        words[CORNERS + 2 * WIDE + i], words[CORNERS + 3 * WIDE + i] = (
            tile[k + below],
            tile[k + below + np.uint32(1)],
        )


@kernel
def _blend(words, parts, n, shift):
    """One byte of the four corners' words, interpolated, into the same byte of the mixed word."""
    byte, s = np.uint32(255), np.uint32(shift)
    for i in range(n):
        p = np.float32(np.int32((words[CORNERS + i] >> s) & byte))
        q = np.float32(np.int32((words[CORNERS + WIDE + i] >> s) & byte))
        r = np.float32(np.int32((words[CORNERS + 2 * WIDE + i] >> s) & byte))
        t = np.float32(np.int32((words[CORNERS + 3 * WIDE + i] >> s) & byte))
        u, v = p + parts[PART_X + i] * (q - p), r + parts[PART_X + i] * (t - r)
        mixed = np.uint32(np.int32(u + parts[PART_Y + i] * (v - u) + np.float32(0.5)))
        words[MIXED + i] |= mixed << s


@kernel
def _corner(word, shift):
    return np.float32(np.int32((word >> np.uint32(shift)) & np.uint32(255)))


@kernel
def _between(p, q, r, t, wx, wy, shift):
    a, b, c, d = _corner(p, shift), _corner(q, shift), _corner(r, shift), _corner(t, shift)
    u, v = a + wx * (b - a), c + wx * (d - c)
    return np.uint32(np.int32(u + wy * (v - u) + np.float32(0.5))) << np.uint32(shift)


@kernel
def _blend3(words, parts, n):
    for i in range(n):
        p, q = words[CORNERS + i], words[CORNERS + WIDE + i]
        r, t = words[CORNERS + 2 * WIDE + i], words[CORNERS + 3 * WIDE + i]
        wx, wy = parts[PART_X + i], parts[PART_Y + i]
        mixed = _between(p, q, r, t, wx, wy, 0) | _between(p, q, r, t, wx, wy, 8) | _between(p, q, r, t, wx, wy, 16)
        words[MIXED + i] = mixed


@kernel
def linear_words(source, points, anchors, edges, boxes, rule, fill, out):
    """Bilinear samples of up to four channels of 8 bits."""
    height, width, channels = source.shape
    words, parts = np.empty(6 * WIDE, np.uint32), np.empty(2 * WIDE, np.float32)
    tile, rows = np.empty(1, np.uint32), np.empty((2, 1), np.int64)
    for run in range(anchors.shape[0]):
        left, right = edges[run], min(edges[run + 1], out.shape[1])
        n = right - left
        x0, x1 = bounds(boxes, run, 0, width, rule, 2)
        y0, y1 = bounds(boxes, run, 1, height, rule, 2)
        if tile.size < (x1 - x0) * (y1 - y0):
            tile = np.empty((x1 - x0) * (y1 - y0) * 5 // 4, np.uint32)
        if rows.shape[1] < y1 - y0:
            rows = np.empty((2, 2 * (y1 - y0)), np.int64)
        spans(boxes, run, width, height, x0, x1, y0, y1, rule, 2, 0.0, 0.0, rows)
        load_words(source, x0, x1, y0, y1, rows, rule, fill, tile)
        low_x, high_x = limits(anchors[run], 0, width, rule, 2)
        low_y, high_y = limits(anchors[run], 1, height, rule, 2)
        move_x, move_y = np.float32(anchors[run, 0] - x0), np.float32(anchors[run, 1] - y0)
        stride = x1 - x0
        for y in range(out.shape[0]):
            positions(points, y, left, n, move_x, move_y, low_x, high_x, low_y, high_y, stride, words, parts)
            _gather(tile, n, stride, words)
            if channels == 3:
                _blend3(words, parts, n)
                pixels = out[y, left:right]
                for i in range(n):
                    word = words[MIXED + i]
                    pixels[i, 0] = word & np.uint32(255)
                    pixels[i, 1] = (word >> np.uint32(8)) & np.uint32(255)
                    pixels[i, 2] = (word >> np.uint32(16)) & np.uint32(255)
            else:
                for i in range(n):
                    words[MIXED + i] = 0
                for k in range(channels):
                    _blend(words, parts, n, 8 * k)
                for i in range(n):
                    for k in range(channels):
                        out[y, left + i, k] = (words[MIXED + i] >> np.uint32(8 * k)) & np.uint32(255)
