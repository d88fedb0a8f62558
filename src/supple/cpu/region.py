"""The part of a source that a run of pixels reads: where it lies, and its samples, made ready for filters.

Everything that depends on the source's type, its colours or what lies outside it happens here, once for each
sample; the filters behind see a plain rectangle of numbers.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.band import FARTHEST, RUN
from supple.cpu.kernel import colour_kernel as kernel
from supple.cpu.vector import gather_bytes, spread_bytes

EDGE, CONSTANT, REFLECT = 0, 1, 2


@kernel
def _reach(boxes, j, i, axis, size, rule, margin):
    low, high = boxes[j, i, axis, 0], boxes[j, i, axis, 1]
    # Farther out, nothing changes any more, or nobody knows it: points are drawn near before they are sampled.
    first, last = (-FARTHEST, FARTHEST) if rule == REFLECT else (-1.0 * margin, size - 1.0 + margin)
    low, high = min(max(low, first), last), min(max(high, first), last)
    return np.int64(np.floor(low)) - margin, np.int64(np.floor(high)) + 2 + margin


@kernel
def bounds(boxes, run, axis, size, rule, margin):
    """The first sample along an axis that a run may read, ``margin`` around its points; and one past the last."""
    first, last = _reach(boxes, 0, run * RUN, axis, size, rule, margin)
    for j in range(boxes.shape[0]):
        for i in range(run * RUN, min((run + 1) * RUN, boxes.shape[1])):
            low, high = _reach(boxes, j, i, axis, size, rule, margin)
            first, last = min(first, low), max(last, high)
    return first, last


@kernel
def spans(boxes, run, width, height, x0, x1, y0, y1, rule, margin, early, late, out):
    """Which samples the run may read of each row y0..y1-1: from ``out[0]`` to ``out[1] - 1``.

    Of frames, only cells count that are seen between the times ``early`` and ``late``.
    """
    for y in range(y1 - y0):
        out[0, y], out[1, y] = x1, x0
    for j in range(boxes.shape[0]):
        for i in range(run * RUN, min((run + 1) * RUN, boxes.shape[1])):
            if boxes.shape[2] == 3 and (boxes[j, i, 2, 1] < early or boxes[j, i, 2, 0] > late):
                continue
            left, right = _reach(boxes, j, i, 0, width, rule, margin)
            above, below = _reach(boxes, j, i, 1, height, rule, margin)
            for y in range(above - y0, below - y0):
                out[0, y], out[1, y] = min(out[0, y], left), max(out[1, y], right)


@kernel
def place(i, n, rule):
    """The sample that stands for sample ``i`` of an axis of ``n``, or -1 where a constant does."""
    if 0 <= i < n:
        return i
    if rule == EDGE:
        return min(max(i, 0), n - 1)
    if rule == CONSTANT:
        return -1
    k = i % (2 * n)  # mirrored at the outer edges of the border's samples
    return k if k < n else 2 * n - 1 - k


@kernel
def load(source, first, lanes, x0, x1, y0, y1, spans, rule, fill, alpha, top, table, octets, tile):
    """Fill ``tile``, flat, with ``lanes`` channels from ``first`` on of the source's samples x0..x1-1, y0..y1-1.

    Of each row, only what is in its span is needed, and written. ``alpha`` is the index of the channel by which the
    others are multiplied, or -1; ``top`` its value for opaque.
    ``table``, unless empty, gives the numbers that stand for the source's integers, as for linear light.
    ``octets`` says that the source is of uint8.
    """
    height, width, channels = source.shape
    # Opacity goes along in the last lane, with every group of colours.
    count = min(lanes, channels - first) if alpha < 0 else min(lanes - 1, alpha - first)
    scale = 1.0 / top
    plain = alpha < 0 and table.size == 0 and first == 0 and ((channels == 3 and lanes == 4) or channels == 1)
    for y in range(y0, y1):
        j = place(y, height, rule)
        start, end = spans[0, y - y0], spans[1, y - y0]
        if plain and j >= 0 and start >= 0 and end <= width:
            taken = source[j, start:end]
            row = tile[((y - y0) * (x1 - x0) + start - x0) * lanes : ((y - y0) * (x1 - x0) + end - x0) * lanes]
            if count == 3 and octets and (j < height - 1 or end < width):
                # The fourth is the next pixel's first, and counts for nothing.
                flat, first_byte = source.reshape(-1), 3 * (j * width + start)
                for x in range(end - start):
                    spread_bytes(flat, first_byte + 3 * x, row, 4 * x)
            elif count == 3:
                for x in range(end - start):
                    row[4 * x] = taken[x, 0]
                    row[4 * x + 1] = taken[x, 1]
                    row[4 * x + 2] = taken[x, 2]
                    row[4 * x + 3] = 0
            else:
                for x in range(end - start):
                    row[x] = taken[x, 0]
            continue
        for x in range(start, end):
            i = place(x, width, rule)
            at = ((y - y0) * (x1 - x0) + x - x0) * lanes
            for c in range(count):
                k = first + c
                if i < 0 or j < 0:
                    tile[at + c] = fill[k]
                elif table.size > 0:
                    tile[at + c] = table[np.int64(source[j, i, k])]
                else:
                    tile[at + c] = source[j, i, k]
            for c in range(count, lanes):
                tile[at + c] = 0
            if alpha >= 0:
                if i < 0 or j < 0:
                    tile[at + lanes - 1] = fill[alpha]
                else:
                    opacity = source[j, i, alpha] * scale
                    tile[at + lanes - 1] = source[j, i, alpha]
                    for c in range(count):
                        tile[at + c] *= opacity


@kernel
def load_words(source, x0, x1, y0, y1, spans, rule, fill, tile):
    """The same for up to four channels of 8 bits, one word for each pixel."""
    height, width, channels = source.shape
    wide = x1 - x0
    for y in range(y0, y1):
        j = place(y, height, rule)
        at = (y - y0) * wide
        start, end = spans[0, y - y0], spans[1, y - y0]
        if j < 0:
            for x in range(start - x0, end - x0):
                tile[at + x] = fill
            continue
        inner0, inner1 = min(max(start, 0), end), max(min(end, width), start)
        if channels == 3:
            # Slices, whose indices count from 0: the compiler knows that they are not negative.
            taken, words = source[j, inner0:inner1], tile[at + inner0 - x0 : at + inner1 - x0]
            for x in range(inner1 - inner0):
                words[x] = (
                    np.uint32(taken[x, 0])
                    | (np.uint32(taken[x, 1]) << np.uint32(8))
                    | (np.uint32(taken[x, 2]) << np.uint32(16))
                )
        else:
            for x in range(inner0, inner1):
                word = np.uint32(0)
                for c in range(channels):
                    word |= np.uint32(source[j, x, c]) << np.uint32(8 * c)
                tile[at + x - x0] = word
        for x in range(start, end):
            if inner0 <= x < inner1:
                continue
            i = place(x, width, rule)
            word = np.uint32(0)
            if i < 0:
                word = fill
            else:
                for c in range(channels):
                    word |= np.uint32(source[j, i, c]) << np.uint32(8 * c)
            tile[at + x - x0] = word


@kernel
def store(values, first, lanes, n, alpha, top, low, high, whole, linear, octets, out, row, column):
    """Write ``n`` pixels of ``lanes`` numbers to a row of ``out`` from ``column`` on: the reverse of `load`.

    ``low`` and ``high`` bound what the type holds, and it is rounded if ``whole``. ``linear``, unless 0, is the
    value of white, by which colours come back from linear light to sRGB's curve.
    """
    count = min(lanes, out.shape[2] - first) if alpha < 0 else min(lanes - 1, alpha - first)
    if whole and alpha < 0 and linear == 0:
        pixels = out[row, column : column + n]
        # In the values' own type, and rounded by cutting off above 0: of such loops, the compiler makes short work.
        for x in range(n * lanes):
            values[x] = min(max(np.floor(values[x] + np.float32(0.5)), low), high)
        if lanes == 1 and out.shape[2] == 1:
            start = row * out.shape[1] + column
            line = out.reshape(-1)[start : start + n]
            for x in range(n):
                line[x] = values[x]
            return
        if count == 2 and out.shape[2] == 2:
            start = 2 * (row * out.shape[1] + column)
            line = out.reshape(-1)[start : start + 2 * n]
            for x in range(n):
                line[2 * x], line[2 * x + 1] = values[4 * x], values[4 * x + 1]
            return
        simple = 0
        if octets and count == 3 and lanes == 4 and out.shape[2] == 3:
            # Each pixel's fourth byte is overwritten by the next one's first.
            simple = n - 1
            flat, first_byte = out.reshape(-1), 3 * (row * out.shape[1] + column)
            for x in range(simple):
                gather_bytes(values, 4 * x, flat, first_byte + 3 * x)
        for x in range(simple, n):
            for c in range(count):
                pixels[x, first + c] = values[x * lanes + c]
        return
    for x in range(n):
        opacity = values[x * lanes + lanes - 1]
        if alpha >= 0:
            # A cubic overshoots; more than opaque, or less than clear, there is nothing to show. The colours overshoot
            # with it, and are divided by it as it is.
            v = min(max(opacity, opacity * 0), opacity * 0 + top)
            if whole:
                v = min(np.floor(v + 0.5), high)
            out[row, column + x, alpha] = v
        for c in range(count):
            v = values[x * lanes + c]
            if alpha >= 0:
                v = v * top / opacity if opacity > 0 else v * 0
            if linear > 0:
                u = v / linear
                u = 12.92 * u if u <= 0.0031308 else 1.055 * u ** (1.0 / 2.4) - 0.055
                v = u * linear
            if whole:
                v = min(max(np.floor(v + 0.5), low), high)
            out[row, column + x, first + c] = v
