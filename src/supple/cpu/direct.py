"""Cubic and box filters between frames, straight from the frames as they lie in memory.

Where nothing has to be prepared (no opacity, no linear light, edges that go on), a pixel's stencil is read from its
frames directly. Long and oblique footprints are left to `supple.cpu.between`.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.between import LINEAR, time_weight, time_widths
from supple.cpu.filters import ALONG, DOWN, KIND, NONE, POINT, choose
from supple.cpu.footprint import AUTO, PADDED, PARTS, REST, one_box_each
from supple.cpu.frames import PART_T, locate, starts_of
from supple.cpu.frames import PARTS as FRACTIONS
from supple.cpu.kernel import colour_kernel as kernel
from supple.cpu.kernel import inlined
from supple.cpu.region import store
from supple.cpu.sample import PART_X, PART_Y, WIDE
from supple.cpu.vector import cubic_stencil, table_stencil

FAR = 5.0  # beyond the frame by more, all samples of a stencil are the same
LEFT, RIGHT, ABOVE, BELOW = 2, 6, 2, 4  # how far a stencil may reach from the sample before a point

_cubic1, _cubic2, _cubic3, _cubic4 = cubic_stencil(1), cubic_stencil(2), cubic_stencil(3), cubic_stencil(4)
_box1, _box2, _box3, _box4 = (table_stencil(channels, PADDED, WIDE) for channels in (1, 2, 3, 4))


@inlined
def _at_point(samples, here, there, stride, channels, x, y, share, values, to):
    if channels == 1:
        _cubic1(samples, here, there, stride, x, y, share, values, to)
    elif channels == 2:
        _cubic2(samples, here, there, stride, x, y, share, values, to)
    elif channels == 3:
        _cubic3(samples, here, there, stride, x, y, share, values, to)
    else:
        _cubic4(samples, here, there, stride, x, y, share, values, to)


@inlined
def _in_box(samples, here, there, stride, channels, table, along, down, parts, rest, share, values, to):
    if channels == 1:
        _box1(samples, here, there, stride, table, along, down, parts, rest, share, values, to)
    elif channels == 2:
        _box2(samples, here, there, stride, table, along, down, parts, rest, share, values, to)
    elif channels == 3:
        _box3(samples, here, there, stride, table, along, down, parts, rest, share, values, to)
    else:
        _box4(samples, here, there, stride, table, along, down, parts, rest, share, values, to)


@kernel
def _copy_patch(samples, start, i, j, across, down, width, height, channels, patch, to):
    """Some samples around one close to an edge, which goes on: from (i, j) on."""
    for v in range(down):
        row = start + min(max(j + v, 0), height - 1) * width * channels
        for u in range(across):
            column = min(max(i + u, 0), width - 1) * channels
            for c in range(channels):
                patch[to + (v * across + u) * channels + c] = samples[row + column + c]


@kernel
def _pixel(
    samples,
    here,
    there,
    i,
    j,
    width,
    height,
    channels,
    kind,
    x,
    y,
    share,
    table,
    along,
    down,
    parts,
    rest,
    patch,
    values,
    to,
):
    """The filtered value of a pixel, whose point lies beyond the sample (i, j), in a mixture of two frames."""
    near = kind == np.uint32(POINT)
    left, right, above, below = (1, 3, 1, 3) if near else (LEFT, RIGHT, ABOVE, BELOW)
    if left <= i < width - right and above <= j < height - below:
        stride = width * channels
        at = (j - above) * stride + (i - left) * channels
        first, second = here + at, there + at
        if near:
            _at_point(samples, first, second, stride, channels, x, y, share, values, to)
        else:
            _in_box(samples, first, second, stride, channels, table, along, down, parts, rest, share, values, to)
    else:
        size = 64 * channels
        wide, tall = (4, 4) if near else (8, 6)
        _copy_patch(samples, here, i - left, j - above, wide, tall, width, height, channels, patch, 0)
        second = 0
        if here != there:
            second = size
            _copy_patch(samples, there, i - left, j - above, wide, tall, width, height, channels, patch, size)
        stride = wide * channels
        if near:
            _at_point(patch, 0, second, stride, channels, x, y, share, values, to)
        else:
            _in_box(patch, 0, second, stride, channels, table, along, down, parts, rest, share, values, to)


@kernel
def _inside(points, row, left, n, anchor, width, height):
    """Whether all stencils of a row lie within the frame."""
    xs, ys = points[0, row, left : left + n], points[1, row, left : left + n]
    low_x, high_x, low_y, high_y = xs[0], xs[0], ys[0], ys[0]
    for i in range(n):
        low_x, high_x = min(low_x, xs[i]), max(high_x, xs[i])
        low_y, high_y = min(low_y, ys[i]), max(high_y, ys[i])
    across = low_x + anchor[0] >= LEFT and high_x + anchor[0] < width - RIGHT
    return across and low_y + anchor[1] >= ABOVE and high_y + anchor[1] < height - BELOW


def _row_of(channels, cubic, box):
    """The loop over a row, for one number of channels: known to the compiler, they cost half."""
    lanes = 1 if channels == 1 else 4

    @inlined
    def row(samples, starts, width, n, where, frame, words, parts, fractions, table, values):
        zero = table.dtype.type(0)
        stride = width * channels
        near, far = stride + channels, 2 * stride + 2 * channels
        for i in range(n):
            at, f = np.int64(where[i]) * channels, frame[i]
            here, there = starts[f] + at, starts[f + 1] + at
            t = zero + fractions[PART_T + i]
            if words[KIND + i] == np.uint32(POINT):
                x, y = zero + parts[PART_X + i], zero + parts[PART_Y + i]
                cubic(samples, here - near, there - near, stride, x, y, t, values, lanes * i)
            elif words[KIND + i] != np.uint32(NONE):
                along, down = np.int64(words[ALONG + i]), np.int64(words[DOWN + i])
                rest = REST + i
                box(samples, here - far, there - far, stride, table, along, down, parts, rest, t, values, lanes * i)

    return row


_row1, _row2 = _row_of(1, _cubic1, _box1), _row_of(2, _cubic2, _box2)
_row3, _row4 = _row_of(3, _cubic3, _box3), _row_of(4, _cubic4, _box4)


@kernel
def _row(samples, starts, width, channels, n, where, frame, words, parts, fractions, table, values):
    """The filtered values of a row that lies within the frame, between two frames each."""
    if channels == 1:
        _row1(samples, starts, width, n, where, frame, words, parts, fractions, table, values)
    elif channels == 2:
        _row2(samples, starts, width, n, where, frame, words, parts, fractions, table, values)
    elif channels == 3:
        _row3(samples, starts, width, n, where, frame, words, parts, fractions, table, values)
    else:
        _row4(samples, starts, width, n, where, frame, words, parts, fractions, table, values)


@kernel
def filtered_directly(
    samples,
    slots,
    frames,
    first,
    height,
    width,
    points,
    beyond,
    anchors,
    edges,
    earliest,
    latest,
    kind,
    average,
    mode,
    table,
    low,
    high,
    whole,
    octets,
    done,
    out,
):
    """Sample a band of frames of up to four channels by cubics and boxes.

    Parameters
    ----------
    samples, slots, frames, first, height, width
        As `supple.cpu.frames.linear_packed` takes them.
    earliest, latest, kind, average, mode, table, low, high, whole, octets
        As `supple.cpu.between.filtered_frames` takes them.
    done : bool array, shape (runs,)
        Receives which runs are done; the others have footprints that no box stands for.
    """
    channels = out.shape[2]
    starts = starts_of(slots, height * width * channels)
    lanes = 1 if channels == 1 else 4
    words, parts, fractions = (
        np.empty(6 * WIDE, np.uint32),
        np.empty(PARTS, np.float32),
        np.empty(FRACTIONS, np.float32),
    )
    where, frame = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    values, one = np.empty(WIDE * lanes, table.dtype), np.empty(4, table.dtype)
    patch = np.empty(130 * channels, samples.dtype)
    widths, forms = np.zeros(WIDE), np.empty(WIDE, np.uint32)
    change_x, change_y = np.empty(WIDE, np.float32), np.empty(WIDE, np.float32)
    singly, columns, rows = np.empty(WIDE, np.bool_), np.empty(WIDE, np.int64), np.empty(WIDE, np.int64)
    most = starts.size - 2
    zero = table.dtype.type(0)
    for run in range(anchors.shape[0]):
        left, right = edges[run], min(edges[run + 1], out.shape[1])
        n = right - left
        done[run] = True
        if mode >= AUTO:
            for y in range(0, out.shape[0], 4):  # most are seen here, before work that would be for nothing
                if not one_box_each(points, beyond, anchors, run, y, left, n, mode, parts):
                    done[run] = False
                    break
            if not done[run]:
                continue
        for y in range(out.shape[0]):
            if mode >= AUTO and not one_box_each(points, beyond, anchors, run, y, left, n, mode, parts):
                done[run] = False
                break
            locate(points, y, left, n, anchors[run], width, height, first, frames - 1, most, where, frame, fractions)
            for i in range(n):
                parts[PART_X + i], parts[PART_Y + i] = fractions[PART_X + i], fractions[PART_Y + i]
            between_two = kind == LINEAR and not average
            if between_two and _inside(points, y, left, n, anchors[run], width, height):
                choose(n, mode, 0, parts, words)
                _row(samples, starts, width, channels, n, where, frame, words, parts, fractions, table, values)
                store(values, 0, lanes, n, -1, 1.0, low, high, whole, 0.0, octets, out, y, left)
                continue
            # Stencils that reach beyond the frame, or over other frames, are taken one by one.
            choose(n, mode, 0, parts, words)
            some = False
            for i in range(n):
                px, py = points[0, y, left + i] + anchors[run, 0], points[1, y, left + i] + anchors[run, 1]
                if words[KIND + i] == np.uint32(POINT):
                    within = 1.0 <= px < width - 3 and 1.0 <= py < height - 3
                else:
                    within = LEFT <= px < width - RIGHT and ABOVE <= py < height - BELOW
                singly[i] = not (between_two and within)
                if singly[i]:
                    some = True
                    px, py = min(max(px, -FAR), width - 1 + FAR), min(max(py, -FAR), height - 1 + FAR)
                    columns[i], rows[i] = int(np.floor(px)), int(np.floor(py))
                    parts[PART_X + i], parts[PART_Y + i] = px - columns[i], py - rows[i]
            if some:
                choose(n, mode, 0, parts, words)
            if between_two:
                for i in range(n):
                    forms[i] = words[KIND + i]
                    if singly[i]:
                        words[KIND + i] = np.uint32(NONE)
                _row(samples, starts, width, channels, n, where, frame, words, parts, fractions, table, values)
            elif average:
                time_widths(points, beyond, anchors, run, y, left, n, change_x, change_y, widths)
            for i in range(n):
                if not singly[i]:
                    continue
                x, j, dx, dy = columns[i], rows[i], parts[PART_X + i], parts[PART_Y + i]
                along, down = np.int64(words[ALONG + i]), np.int64(words[DOWN + i])
                form = forms[i] if between_two else words[KIND + i]
                if between_two:
                    here, there = starts[frame[i]], starts[frame[i] + 1]
                    _pixel(
                        samples,
                        here,
                        there,
                        x,
                        j,
                        width,
                        height,
                        channels,
                        form,
                        zero + dx,
                        zero + dy,
                        zero + fractions[PART_T + i],
                        table,
                        along,
                        down,
                        parts,
                        REST + i,
                        patch,
                        values,
                        i * lanes,
                    )
                    continue
                time = min(max(anchors[run, 2] + np.float64(points[2, y, left + i]), earliest), latest)
                reach = 2.0 + 0.5 * widths[i]
                total = 0.0
                for c in range(channels):
                    values[i * lanes + c] = 0
                for k in range(int(np.ceil(time - reach)), int(np.floor(time + reach)) + 1):
                    weight = time_weight(kind, k - time, widths[i])
                    if weight == 0.0:
                        continue
                    here = starts[min(max(k - first, 0), most)]
                    _pixel(
                        samples,
                        here,
                        here,
                        x,
                        j,
                        width,
                        height,
                        channels,
                        form,
                        zero + dx,
                        zero + dy,
                        zero,
                        table,
                        along,
                        down,
                        parts,
                        REST + i,
                        patch,
                        one,
                        0,
                    )
                    total += weight
                    for c in range(channels):
                        values[i * lanes + c] += weight * one[c]
                for c in range(channels):
                    values[i * lanes + c] /= total
            store(values, 0, lanes, n, -1, 1.0, low, high, whole, 0.0, octets, out, y, left)
