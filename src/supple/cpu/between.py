"""Any filter, between frames: each frame is filtered as a picture, and weighs by how near in time it is.

Where the map compresses time, a pixel covers more than a frame. Its extent along time is that of its footprint: the
length of the row ∂p_t/∂q. What lies between frames, interpolated, is averaged over a box of that length, so that
jagged edges become motion blur.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.filters import KIND, NONE, choose, filter_row, tile_of
from supple.cpu.footprint import AUTO, PARTS, footprints, slopes
from supple.cpu.kernel import colour_kernel as kernel
from supple.cpu.kernel import inlined
from supple.cpu.pyramid import build
from supple.cpu.region import load, spans, store
from supple.cpu.sample import WIDE, limits, positions

NEAREST, LINEAR, CUBIC = 0, 1, 2
LONGEST = 64.0  # frames that a pixel is averaged over, at most


@inlined
def _integral(kind, t):
    """The integral of a kernel, the tent or Catmull and Rom's, from 0 to t."""
    x = min(abs(t), 2.0)
    if kind == CUBIC:
        if x <= 1.0:
            value = x - 5.0 / 6.0 * x**3 + 3.0 / 8.0 * x**4
        else:
            value = 2.0 * x - 2.0 * x**2 + 5.0 / 6.0 * x**3 - x**4 / 8.0 - 1.0 / 6.0
    else:
        x = min(x, 1.0)
        value = x - 0.5 * x * x
    return value if t > 0.0 else -value


@inlined
def time_weight(kind, t, width):
    """What a frame at a distance ``t`` counts, for a pixel that covers ``width`` frames."""
    x = abs(t)
    if kind == NEAREST:
        return 1.0 if -0.5 < t <= 0.5 else 0.0
    if width > 1e-3:
        return (_integral(kind, t + 0.5 * width) - _integral(kind, t - 0.5 * width)) / width
    if kind == LINEAR:
        return max(1.0 - x, 0.0)
    if x <= 1.0:
        return (1.5 * x - 2.5) * x * x + 1.0
    return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0 if x < 2.0 else 0.0


@kernel
def _times(points, row, left, n, anchor, low, high, times):
    """The time of each point, no farther from the clip than what lies there can change."""
    for i in range(n):
        times[i] = min(max(anchor + np.float64(points[2, row, left + i]), low), high)


@kernel
def time_widths(points, beyond, anchors, run, row, left, n, across, down, widths):
    """How many frames each pixel of a row covers; the filter fades in as a picture's does.

    ``across`` and ``down`` are scratch, float32, shape (n,) or longer.
    """
    slopes(points, beyond, anchors, run, 2, row, left, n, across, down)
    for i in range(n):
        along = points[3, row, left + i]
        length = np.sqrt(np.float64(across[i] * across[i] + down[i] * down[i] + along * along))
        widths[i] = min(length * min(max((length - 1.0) * 10.0, 0.0), 1.0), LONGEST)


@kernel
def _load_constant(first, lanes, channels, count, fill, alpha, tile):
    """A tile of a frame that lies outside the clip."""
    colours = min(lanes, channels - first) if alpha < 0 else min(lanes - 1, alpha - first)
    for k in range(count):
        for c in range(lanes):
            tile[k * lanes + c] = fill[first + c] if c < colours else 0
        if alpha >= 0:
            tile[k * lanes + lanes - 1] = fill[alpha]


@kernel
def filtered_frames(
    source,
    slots,
    first,
    earliest,
    latest,
    points,
    beyond,
    anchors,
    edges,
    boxes,
    kind,
    average,
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
    done,
    out,
):
    """Sample a band of frames by any filter but nearest.

    Parameters
    ----------
    source : array, shape (slots, height, width, channels)
    slots : int64 array
        Where in ``source`` the frames from ``first`` on are; -1 for one that is constant.
    earliest, latest : float
        Beyond these times, nothing changes any more.
    kind : int
        LINEAR or CUBIC: how frames are interpolated; NEAREST if they are not.
    average : bool
        Whether pixels are averaged over the time that they cover; ``points`` then has ∂p_t/∂t, too.
    done : bool array, shape (runs,)
        Which runs to leave out.
    mode, lanes, rule, fill, alpha, top, levels, table, linear, low, high, whole, octets
        As in `supple.cpu.filters.filtered`.
    """
    height, width, channels = source.shape[1:]
    words, parts = np.empty(6 * WIDE, np.uint32), np.empty(PARTS, np.float32)
    values = np.empty((WIDE + 1) * lanes, table.dtype)
    tile, rows = np.empty(1, table.dtype), np.empty((2, 1), np.int64)
    tall_out = out.shape[0]
    times, widths = np.empty(WIDE), np.zeros(WIDE)
    change_x, change_y = np.empty(WIDE, np.float32), np.empty(WIDE, np.float32)
    weights = np.empty(WIDE, table.dtype)
    sums = np.empty(tall_out * WIDE * lanes, table.dtype)
    totals = np.empty(tall_out * WIDE, table.dtype)
    reach = 2.0 if kind == CUBIC else 1.0
    step = lanes if alpha < 0 else lanes - 1
    for run in range(anchors.shape[0]):
        if done[run]:
            continue
        left, right = edges[run], min(edges[run + 1], out.shape[1])
        n = right - left
        x0, x1, y0, y1, margin, coarsest, largest = tile_of(
            points, beyond, anchors, boxes, run, left, n, width, height, rule, mode, parts
        )
        wide, deep = x1 - x0, y1 - y0
        if tile.size < wide * deep * lanes * (2 if coarsest else 1):
            tile = np.empty(wide * deep * lanes * (2 if coarsest else 1), table.dtype)
        if rows.shape[1] < deep:
            rows = np.empty((2, 2 * deep), np.int64)
        low_x, high_x = limits(anchors[run], 0, width, rule, margin)
        low_y, high_y = limits(anchors[run], 1, height, rule, margin)
        move_x, move_y = np.float32(anchors[run, 0] - x0), np.float32(anchors[run, 1] - y0)
        # The frames of this run.
        early, late, longest = 1e300, -1e300, 0.0
        for y in range(tall_out):
            _times(points, y, left, n, np.float64(anchors[run, 2]), earliest, latest, times)
            for i in range(n):
                early, late = min(early, times[i]), max(late, times[i])
            if average:
                time_widths(points, beyond, anchors, run, y, left, n, change_x, change_y, widths)
                for i in range(n):
                    longest = max(longest, widths[i])
        radius = reach + 0.5 * longest
        from_frame = max(int(np.floor(early - radius)) + 1, first)
        to_frame = min(int(np.ceil(late + radius)) - 1, first + slots.size - 1)
        for group in range(0, channels if alpha < 0 else channels - 1, step):
            sums[:] = 0
            totals[:] = 0
            for f in range(from_frame, to_frame + 1):
                slot = slots[f - first]
                if coarsest:
                    for y in range(deep):
                        rows[0, y], rows[1, y] = x0, x1
                else:
                    # A frame that is seen from the farthest time that counts is seen from all beyond.
                    since = -1e300 if f - radius <= earliest else f - radius
                    until = 1e300 if f + radius >= latest else f + radius
                    spans(boxes, run, width, height, x0, x1, y0, y1, rule, margin, since, until, rows)
                if slot >= 0:
                    picture = source[slot]
                    load(picture, group, lanes, x0, x1, y0, y1, rows, rule, fill, alpha, top, levels, octets, tile)
                else:
                    _load_constant(group, lanes, channels, wide * deep, fill, alpha, tile)
                starts, sizes = build(tile, wide, deep, lanes, coarsest)
                for y in range(tall_out):
                    _times(points, y, left, n, np.float64(anchors[run, 2]), earliest, latest, times)
                    if average:
                        time_widths(points, beyond, anchors, run, y, left, n, change_x, change_y, widths)
                    some = False
                    for i in range(n):
                        weights[i] = time_weight(kind, f - times[i], widths[i])
                        some = some or weights[i] != 0
                    if not some:
                        continue
                    if mode >= AUTO:
                        footprints(points, beyond, anchors, run, y, left, n, mode, parts)
                    positions(points, y, left, n, move_x, move_y, low_x, high_x, low_y, high_y, wide, words, parts)
                    choose(n, mode, wide if lanes == 4 else 0, parts, words)
                    for i in range(n):
                        if weights[i] == 0:
                            words[KIND + i] = np.uint32(NONE)
                    filter_row(tile, starts, sizes, lanes, n, mode, largest, wide, words, parts, table, values)
                    at = y * WIDE * lanes
                    for i in range(n):
                        if weights[i] != 0:
                            totals[y * WIDE + i] += weights[i]
                            for c in range(lanes):
                                sums[at + i * lanes + c] += weights[i] * values[i * lanes + c]
            for y in range(tall_out):
                row = sums[y * WIDE * lanes : (y + 1) * WIDE * lanes]
                for i in range(n):
                    share = 1 / totals[y * WIDE + i]
                    for c in range(lanes):
                        row[i * lanes + c] *= share
                store(row, group, lanes, n, alpha, top, low, high, whole, linear, octets, out, y, left)
