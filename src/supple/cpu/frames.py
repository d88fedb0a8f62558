"""Samples between frames, straight from the frames as they lie in memory: nearest, and linear along x, y and t.

As in `supple.cpu.sample`, a row of a run is done in passes. The samples that a pixel needs are two neighbours in two
rows of two frames. Neighbours lie together, and are read as one number.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.adjacent import TOGETHER, adjacent, alike, join_bytes, join_pairs
from supple.cpu.kernel import colour_kernel, inlined, kernel
from supple.cpu.region import place
from supple.cpu.sample import WIDE, nearest_to
from supple.cpu.vector import prefetch, reader

# Rows of a run's words: what is needed of both frames; and of its fractions.
WORDS = 4 * WIDE
PART_X, PART_Y, PART_T = 0, WIDE, 2 * WIDE
PARTS = 3 * WIDE
AHEAD = 3  # rows from where samples are read to where they are fetched into the cache

_read_two, _read_four, _read_eight = reader(2), reader(4), reader(8)


@kernel
def nearest_frames(source, slots, first, points, anchors, edges, rule, fill, out):
    """The sample nearest to each point, in all three coordinates; ties go to the larger index.

    ``slots`` says where in ``source`` the frames from ``first`` on are, -1 for one that is constant.
    """
    height, width, channels = source.shape[1:]
    for run in range(anchors.shape[0]):
        for y in range(out.shape[0]):
            for x in range(edges[run], min(edges[run + 1], out.shape[1])):
                i = place(nearest_to(anchors[run, 0], points[0, y, x]), width, rule)
                j = place(nearest_to(anchors[run, 1], points[1, y, x]), height, rule)
                k = nearest_to(anchors[run, 2], points[2, y, x])
                slot = slots[min(max(k - first, 0), slots.size - 1)]
                if i < 0 or j < 0 or slot < 0:
                    for c in range(channels):
                        out[y, x, c] = fill[c]
                else:
                    for c in range(channels):
                        out[y, x, c] = source[slot, j, i, c]


@kernel
def locate(points, row, left, n, anchor, width, height, first, last, most, where, frame, parts):
    """The sample before each point, along every axis, and how far beyond that it is; within the source.

    ``where`` holds indices in a frame from 0 to 2³²; as int32, for which there are vector instructions.
    """
    one = np.float32(1.0)
    xs, ys, ts = points[0, row, left : left + n], points[1, row, left : left + n], points[2, row, left : left + n]
    low_x, high_x = np.float32(-anchor[0]), np.float32(width - 1 - anchor[0])
    low_y, high_y = np.float32(-anchor[1]), np.float32(height - 1 - anchor[1])
    low_t, high_t = np.float32(-anchor[2]), np.float32(last - anchor[2])
    x0, y0, t0 = np.int32(anchor[0]), np.int32(anchor[1]), np.int32(anchor[2] - first)
    stride = np.int32(width)
    for i in range(n):
        x, y = min(max(xs[i], low_x), high_x), min(max(ys[i], low_y), high_y)
        a, b = min(np.floor(x), high_x - one), min(np.floor(y), high_y - one)
        parts[PART_X + i], parts[PART_Y + i] = x - a, y - b
        where[i] = (np.int32(b) + y0) * stride + (np.int32(a) + x0)
    for i in range(n):
        t = min(max(ts[i], low_t), high_t)
        c = np.floor(t)
        parts[PART_T + i] = t - c
        frame[i] = min(max(np.int32(c) + t0, np.int32(0)), np.int32(most))


@inlined
def _stretch(frame, i, n):
    """How far the pixels from ``i`` on are of the same two frames: as long, an address is one sum."""
    end = i + 1
    while end + TOGETHER <= n and frame[end] == frame[i] and alike(frame, end):
        end += TOGETHER
    while end < n and frame[end] == frame[i]:
        end += 1
    return end


@kernel
def _gather_pairs(samples, starts, stride, n, where, frame, words):
    """Of one channel of bytes, both neighbours in both rows make a word for each of the two frames."""
    i = 0
    while i < n:
        end = _stretch(frame, i, n)
        here, there = samples[starts[frame[i]] :], samples[starts[frame[i] + 1] :]
        below_here, below_there = here[stride:], there[stride:]
        # Slices, whose indices count from 0: the compiler knows that they are not negative.
        places, first, second = where[i:end], words[i:end], words[WIDE + i : WIDE + end]
        for k in range(0, end - i, 32):
            ahead = np.int64(places[k]) + AHEAD * stride
            prefetch(here, ahead)
            prefetch(there, ahead)
        k = 0
        while k < end - i:
            last = min(k + TOGETHER, end - i)
            if last == k + TOGETHER and adjacent(places, k):
                at = np.int64(np.uint32(places[k]))
                join_bytes(here, below_here, at, first, k)
                join_bytes(there, below_there, at, second, k)
            else:
                for j in range(k, last):
                    at = np.uint32(places[j])
                    first[j] = _read_two(here, at) | (_read_two(below_here, at) << np.uint32(16))
                    second[j] = _read_two(there, at) | (_read_two(below_there, at) << np.uint32(16))
            k = last
        i = end


@kernel
def _gather_words(samples, starts, stride, n, where, frame, scale, words):
    """Of two channels of bytes, or one of 16 bits, both neighbours in a row make a word: four for a pixel."""
    i = 0
    while i < n:
        end = _stretch(frame, i, n)
        here, there = samples[starts[frame[i]] :], samples[starts[frame[i] + 1] :]
        below_here, below_there = here[stride * scale :], there[stride * scale :]
        places, first, second = where[i:end], words[i:end], words[WIDE + i : WIDE + end]
        third, fourth = words[2 * WIDE + i : 2 * WIDE + end], words[3 * WIDE + i : 3 * WIDE + end]
        for k in range(0, end - i, 16):
            ahead = (np.int64(places[k]) + AHEAD * stride) * scale
            prefetch(here, ahead)
            prefetch(there, ahead)
        k = 0
        while k < end - i:
            last = min(k + TOGETHER, end - i)
            if last == k + TOGETHER and adjacent(places, k):
                at = np.int64(np.uint32(places[k])) * scale
                join_pairs(here, at, at + scale, first, k)
                join_pairs(below_here, at, at + scale, second, k)
                join_pairs(there, at, at + scale, third, k)
                join_pairs(below_there, at, at + scale, fourth, k)
            else:
                for j in range(k, last):
                    at = np.uint32(places[j]) * np.uint32(scale)
                    first[j], second[j] = _read_four(here, at), _read_four(below_here, at)
                    third[j], fourth[j] = _read_four(there, at), _read_four(below_there, at)
            k = last
        i = end


@inlined
def _part(word, shift, mask):
    return np.float32(np.int32((word >> np.uint32(shift)) & np.uint32(mask)))


@inlined
def _mix(p, q, r, t, x, y):
    u, v = p + x * (q - p), r + x * (t - r)
    return u + y * (v - u)


@kernel
def _blend_pairs(words, parts, n, out):
    half = np.float32(0.5)
    for i in range(n):
        a, b = words[i], words[WIDE + i]
        x, y = parts[PART_X + i], parts[PART_Y + i]
        u = _mix(_part(a, 0, 255), _part(a, 8, 255), _part(a, 16, 255), _part(a, 24, 255), x, y)
        v = _mix(_part(b, 0, 255), _part(b, 8, 255), _part(b, 16, 255), _part(b, 24, 255), x, y)
        words[i] = np.uint32(np.int32(u + parts[PART_T + i] * (v - u) + half))
    for i in range(n):
        out[i, 0] = words[i]


@inlined
def _mixed(words, parts, i, low, high, mask):
    """A channel of four words, whose neighbours are at the bits ``low`` and ``high``."""
    x, y = parts[PART_X + i], parts[PART_Y + i]
    a, b, c, d = words[i], words[WIDE + i], words[2 * WIDE + i], words[3 * WIDE + i]
    u = _mix(_part(a, low, mask), _part(a, high, mask), _part(b, low, mask), _part(b, high, mask), x, y)
    v = _mix(_part(c, low, mask), _part(c, high, mask), _part(d, low, mask), _part(d, high, mask), x, y)
    return np.uint32(np.int32(u + parts[PART_T + i] * (v - u) + np.float32(0.5)))


@kernel
def _blend_two(words, parts, n, out):
    for i in range(n):
        even, odd = _mixed(words, parts, i, 0, 16, 255), _mixed(words, parts, i, 8, 24, 255)
        words[i] = even | (odd << np.uint32(8))
    for i in range(n):
        out[i, 0], out[i, 1] = words[i] & np.uint32(255), words[i] >> np.uint32(8)


@kernel
def _blend_deep(words, parts, n, out):
    for i in range(n):
        words[i] = _mixed(words, parts, i, 0, 16, 65535)
    for i in range(n):
        out[i, 0] = words[i]


@kernel
def starts_of(slots, size):
    """Where frames of so many samples start; the last one twice, as the next one beyond the last counts for nothing."""
    starts = np.empty(slots.size + 1, np.int64)
    for k in range(slots.size + 1):
        starts[k] = slots[min(k, slots.size - 1)] * size
    return starts


@kernel
def linear_packed(samples, slots, frames, first, height, width, points, anchors, edges, scale, out):
    """Linear samples of one or two channels of bytes, or one of 16 bits.

    Parameters
    ----------
    samples : flat array
        All frames that there are.
    slots : int64 array
        Which of them the frames from ``first`` on are.
    frames : int
        How many frames the clip has.
    scale : int
        Items of ``samples`` for each pixel.
    """
    octets = samples.itemsize == 1
    starts = starts_of(slots, height * width * scale)
    words, parts = np.empty(WORDS, np.uint32), np.empty(PARTS, np.float32)
    where, frame = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    most = starts.size - 2
    for y in range(out.shape[0]):
        for run in range(anchors.shape[0]):
            left, right = edges[run], min(edges[run + 1], out.shape[1])
            n = right - left
            locate(points, y, left, n, anchors[run], width, height, first, frames - 1, most, where, frame, parts)
            if octets and scale == 1:
                _gather_pairs(samples, starts, width, n, where, frame, words)
                _blend_pairs(words, parts, n, out[y, left:right])
            else:
                _gather_words(samples, starts, width, n, where, frame, scale, words)
                if octets:
                    _blend_two(words, parts, n, out[y, left:right])
                else:
                    _blend_deep(words, parts, n, out[y, left:right])


@colour_kernel
def _gather_samples(samples, starts, stride, n, where, frame, taps):
    """Of one channel, all eight neighbours: each in a row of its own."""
    i = 0
    while i < n:
        end = _stretch(frame, i, n)
        here, there = samples[starts[frame[i]] :], samples[starts[frame[i] + 1] :]
        places = where[i:end]
        a, b, c, d = taps[0, i:end], taps[1, i:end], taps[2, i:end], taps[3, i:end]
        e, f, g, h = taps[4, i:end], taps[5, i:end], taps[6, i:end], taps[7, i:end]
        for k in range(end - i):
            at = np.uint32(places[k])
            below = at + np.uint32(stride)
            a[k], b[k], c[k], d[k] = here[at], here[at + np.uint32(1)], here[below], here[below + np.uint32(1)]
            e[k], f[k], g[k], h[k] = there[at], there[at + np.uint32(1)], there[below], there[below + np.uint32(1)]
        i = end


@kernel
def _gather_floats(samples, starts, stride, n, where, frame, pairs):
    """The same for float32: both neighbours in a row are read as one number."""
    i = 0
    while i < n:
        end = _stretch(frame, i, n)
        here, there = samples[starts[frame[i]] :], samples[starts[frame[i] + 1] :]
        below_here, below_there = here[stride:], there[stride:]
        places = where[i:end]
        a, b, c, d = pairs[0, i:end], pairs[1, i:end], pairs[2, i:end], pairs[3, i:end]
        for k in range(0, end - i, 8):
            ahead = np.int64(places[k]) + AHEAD * stride
            prefetch(here, ahead)
            prefetch(there, ahead)
        for k in range(end - i):
            at = np.uint32(places[k])
            a[k], b[k] = _read_eight(here, at), _read_eight(below_here, at)
            c[k], d[k] = _read_eight(there, at), _read_eight(below_there, at)
        i = end


@colour_kernel
def _blend_samples(taps, step, parts, n, zero, whole, high, out):
    """Blend eight neighbours; every ``step``-th number of a row is the next pixel's."""
    half = zero + np.float32(0.5)
    done = np.empty(WIDE, taps.dtype)
    if step == 1:
        a, b, c, d = taps[0], taps[1], taps[2], taps[3]
        e, f, g, h = taps[4], taps[5], taps[6], taps[7]
        for i in range(n):
            x, y, t = zero + parts[PART_X + i], zero + parts[PART_Y + i], zero + parts[PART_T + i]
            u, v = _mix(a[i], b[i], c[i], d[i], x, y), _mix(e[i], f[i], g[i], h[i], x, y)
            done[i] = u + t * (v - u)
    else:
        p, q, r, s = taps[0], taps[1], taps[2], taps[3]
        for i in range(n):
            x, y, t = zero + parts[PART_X + i], zero + parts[PART_Y + i], zero + parts[PART_T + i]
            k, m = 2 * i, 2 * i + 1
            u, v = _mix(p[k], p[m], q[k], q[m], x, y), _mix(r[k], r[m], s[k], s[m], x, y)
            done[i] = u + t * (v - u)
    if whole:
        for i in range(n):
            out[i, 0] = min(np.floor(done[i] + half), high)
    else:
        for i in range(n):
            out[i, 0] = done[i]


@colour_kernel
def linear_single(samples, slots, frames, first, height, width, points, anchors, edges, zero, whole, high, out):
    """The same for one channel of any type; see `linear_plain`."""
    starts = starts_of(slots, height * width)
    parts, taps = np.empty(PARTS, np.float32), np.full((8, WIDE), zero)
    where, frame = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    most = starts.size - 2
    for y in range(out.shape[0]):
        for run in range(anchors.shape[0]):
            left, right = edges[run], min(edges[run + 1], out.shape[1])
            n = right - left
            locate(points, y, left, n, anchors[run], width, height, first, frames - 1, most, where, frame, parts)
            _gather_samples(samples, starts, width, n, where, frame, taps)
            _blend_samples(taps, 1, parts, n, zero, whole, high, out[y, left:right])


@colour_kernel
def linear_floats(samples, slots, frames, first, height, width, points, anchors, edges, out):
    """The same for one channel of float32."""
    starts = starts_of(slots, height * width)
    parts, pairs = np.empty(PARTS, np.float32), np.empty((4, WIDE), np.uint64)
    where, frame = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    most, zero = starts.size - 2, np.float32(0.0)
    for y in range(out.shape[0]):
        for run in range(anchors.shape[0]):
            left, right = edges[run], min(edges[run + 1], out.shape[1])
            n = right - left
            locate(points, y, left, n, anchors[run], width, height, first, frames - 1, most, where, frame, parts)
            _gather_floats(samples, starts, width, n, where, frame, pairs)
            _blend_samples(pairs.view(np.float32), 2, parts, n, zero, False, zero, out[y, left:right])


@colour_kernel
def linear_plain(samples, slots, frames, first, height, width, points, anchors, edges, zero, whole, high, out):
    """The same for any type and number of channels.

    ``zero`` is of the type that all is worked out in, and ``high`` the largest value of whole numbers.
    """
    channels = out.shape[2]
    starts = starts_of(slots, height * width * channels)
    parts = np.empty(PARTS, np.float32)
    where, frame = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    most = starts.size - 2
    half = zero + np.float32(0.5)
    for run in range(anchors.shape[0]):
        left, right = edges[run], min(edges[run + 1], out.shape[1])
        n = right - left
        for row in range(out.shape[0]):
            locate(points, row, left, n, anchors[run], width, height, first, frames - 1, most, where, frame, parts)
            pixels = out[row, left:right]
            for i in range(n):
                at = np.int64(np.uint32(where[i])) * channels
                here, there = starts[frame[i]] + at, starts[frame[i] + 1] + at
                x, y, t = zero + parts[PART_X + i], zero + parts[PART_Y + i], zero + parts[PART_T + i]
                below = width * channels
                for c in range(channels):
                    a, b = here + c, there + c
                    u = _mix(
                        zero + samples[a],
                        zero + samples[a + channels],
                        zero + samples[a + below],
                        zero + samples[a + below + channels],
                        x,
                        y,
                    )
                    v = _mix(
                        zero + samples[b],
                        zero + samples[b + channels],
                        zero + samples[b + below],
                        zero + samples[b + below + channels],
                        x,
                        y,
                    )
                    value = u + t * (v - u)
                    pixels[i, c] = min(np.floor(value + half), high) if whole else value
