"""The colour at a source point: one device function for each filter.

All have the same arguments, so that kernels need not know which one they call: samples, the fill value, the memory
layout and the sampling constants (`supple.engines.cuda.sample`), the frame index for single images, the pixel (x, y, z)
and its displacement, ∂p/∂q as far as it is needed, and the position of the result. A kernel made for one filter needs
no registers for the others.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from supple.engines import base
from supple.engines.base import LONGEST
from supple.engines.cuda.footprint import averaged_at, footprint
from supple.engines.cuda.kernel import device, lean
from supple.engines.cuda.sample import (
    ALPHA,
    CHANNEL,
    CHANNELS,
    COLUMN,
    CONSTANT,
    EARLY,
    HEIGHT,
    HIGH,
    LATE,
    LOW,
    ROW,
    WHITE,
    WIDTH,
    Way,
    cubic_at,
    frame_finder,
    from_light,
    linear_at,
    mapper,
    placer,
    reader,
)

# The last two are no filters: they write source points as float32, x first, or their displacements.
FILTERS = base.FILTERS | {"map": 4, "offsets": 5}
NEAREST, LINEAR, CUBIC, AUTO, MAP, OFFSETS = range(6)
# Frames that are separate images are not interpolated.
BETWEEN = base.BETWEEN | {"nothing": 3}
NOTHING = 3

_f4 = np.float32
ZERO, HALF, ONE, TWO = _f4(0.0), _f4(0.5), _f4(1.0), _f4(2.0)


@lean
def integral(t, cubic):
    """Return the integral of a kernel between frames, the tent or Catmull and Rom's, from 0 to t."""
    x = min(abs(t), TWO)
    if cubic:
        inner = x * (ONE + x * x * (_f4(-5 / 6) + _f4(0.375) * x))
        outer = x * (TWO + x * (x * (_f4(5 / 6) - _f4(0.125) * x) - TWO)) - _f4(1 / 6)
        value = inner if x <= ONE else outer
    else:
        x = min(x, ONE)
        value = x - HALF * x * x
    return value if t > ZERO else -value


@lean
def width_in_time(a, b, c):
    """Return how many frames a pixel covers beyond its own, by the row ∂p_t/∂q: the residual footprint along time."""
    return min(math.sqrt(max(a * a + b * b + c * c - ONE, ZERO)), _f4(LONGEST))


@lean
def time_weight(t, width, cubic):
    """Return the weight of a frame at a distance ``t``, for a pixel that covers ``width`` frames."""
    x = abs(t)
    if width > _f4(1e-3):
        weight = (integral(t + HALF * width, cubic) - integral(t - HALF * width, cubic)) / width
    elif not cubic:
        weight = max(ONE - x, ZERO)
    elif x <= ONE:
        weight = (_f4(1.5) * x - _f4(2.5)) * x * x + ONE
    else:
        weight = ((_f4(2.5) - HALF * x) * x - _f4(4.0)) * x + TWO if x < TWO else ZERO
    return weight


def _map(way: Way) -> Callable[..., Any]:
    index, unsigned, absolute = way.index, way.unsigned, way.filter == MAP

    @device
    def point(samples, fills, source, how, limits, picture, x, y, z, ux, uy, uz,
              xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        if absolute:
            ux, uy, uz = _f4(x + ux), _f4(y + uy), _f4(z + uz)
        out[unsigned(at)] = ux
        out[unsigned(index(at + channel))] = uy
        if source[CHANNELS] == 3:
            out[unsigned(index(at + channel + channel))] = uz

    return point


def _nearest(way: Way) -> Callable[..., Any]:
    """Return the filter for the nearest sample, unchanged; ties go to the larger index."""
    mapped, place, frame_at = mapper(way), placer(way.index), frame_finder(way)
    index, unsigned, stack, constant = way.index, way.unsigned, way.between != NOTHING, way.rule == CONSTANT

    @device
    def nearest(samples, fills, source, how, limits, picture, x, y, z, ux, uy, uz,
                xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        i, u = place(x, ux)
        j, v = place(y, uy)
        i, j = mapped(index(i + int(u >= HALF)), source[WIDTH]), mapped(index(j + int(v >= HALF)), source[HEIGHT])
        f = picture
        if stack:
            k, w = place(z, uz)
            f = index(k + int(w >= HALF))
        start = frame_at(source, f, counts)
        first = index(index(start + index(j * source[ROW])) + index(i * source[COLUMN]))
        for c in range(source[CHANNELS]):
            to = unsigned(index(at + index(c * channel)))
            if constant and (start < 0 or i < 0 or j < 0):
                out[to] = fills[c]
            else:
                out[to] = samples[unsigned(index(first + index(c * source[CHANNEL])))]

    return nearest


def _in_frame(way: Way) -> Callable[..., Any]:
    read = reader(way)
    linear, cubic, averaged = linear_at(way, read), cubic_at(way, read), averaged_at(way, read)
    if way.filter in (LINEAR, CUBIC):
        pointed = linear if way.filter == LINEAR else cubic

        @device
        def at_point(samples, fills, source, how, limits, start, i, j, u, v, c, major, minor, ax, ay):
            return pointed(samples, fills, source, how, limits, start, i, j, u, v, c)

        return at_point

    @device
    def over_footprint(samples, fills, source, how, limits, start, i, j, u, v, c, major, minor, ax, ay):
        if major > ONE:
            return averaged(samples, fills, source, how, limits, start, i, j, u, v, c, major, minor, ax, ay)
        return cubic(samples, fills, source, how, limits, start, i, j, u, v, c)

    return over_footprint


def _finisher(way: Way) -> Callable[..., Any]:
    """Return the inverse of `supple.engines.cuda.sample.reader`, with rounding to integer types."""
    number, alpha, light, whole = way.number, way.alpha, way.light, way.whole
    zero, half = number(0.0), number(0.5)
    small = number is np.float32
    exact = number(2.0 ** (23 if small else 52))  # from here on, all numbers are integers

    @device
    def finished(v, opacity, c, how, limits):
        if alpha and c == how[ALPHA]:
            # Clamp the overshoot of cubic filters, above opaque or below transparent.
            v = min(max(v, zero), number(limits[WHITE]))
        else:
            if alpha:
                v = number(v * limits[WHITE] / opacity) if opacity > zero else zero
            if light:
                v = number(from_light(v, limits[WHITE]))
        if whole:
            v = min(max(v, number(limits[LOW])), number(limits[HIGH]))
            if abs(v) < exact:
                # Rounded half up, by truncation.
                w = number(np.int32(v + half)) if small else number(np.int64(v + half))
                v = w - number(1.0) if w > v + half else w
                v = min(v, number(limits[HIGH]))
        return v

    return finished


def _between(way: Way) -> Callable[..., Any]:
    """Return the filter between frames, or within one."""
    in_frame, frame_at = _in_frame(way), frame_finder(way)
    number, index, average = way.number, way.index, way.average
    smooth, one, two = way.between == BETWEEN["cubic"], index(1), index(2)
    radius = _f4(2.0 if smooth else 1.0)

    @device
    def single(samples, fills, source, how, limits, picture, i, j, k, u, v, w, width, c,
               major, minor, ax, ay, counts):  # fmt: skip
        f = picture
        if way_nearest:
            f = index(k + int(w >= HALF))
        return in_frame(samples, fills, source, how, limits, frame_at(source, f, counts), i, j, u, v, c,
                        major, minor, ax, ay)  # fmt: skip

    @device
    def linear(samples, fills, source, how, limits, picture, i, j, k, u, v, w, width, c,
               major, minor, ax, ay, counts):  # fmt: skip
        a = in_frame(samples, fills, source, how, limits, frame_at(source, k, counts), i, j, u, v, c,
                     major, minor, ax, ay)  # fmt: skip
        if counted and w == ZERO:  # the next frame may be missing
            return a
        b = in_frame(samples, fills, source, how, limits, frame_at(source, index(k + one), counts), i, j, u, v,
                     c, major, minor, ax, ay)  # fmt: skip
        return (ONE - w) * a + w * b

    @device
    def several(samples, fills, source, how, limits, picture, i, j, k, u, v, w, width, c,
                major, minor, ax, ay, counts):  # fmt: skip
        first, last = index(k - one), index(k + two)
        if average:
            reach = radius + HALF * width
            first, last = index(k + math.floor(w - reach) + 1), index(k + math.ceil(w + reach) - 1)
        total, weights = number(0.0), ZERO
        for f in range(first, last + 1):
            weight = time_weight(_f4(f - k) - w, width, smooth)
            if weight != ZERO:
                start = frame_at(source, index(f), counts)
                total += weight * in_frame(samples, fills, source, how, limits, start, i, j, u, v, c,
                                           major, minor, ax, ay)  # fmt: skip
                weights += weight
        return total / weights

    way_nearest, counted = way.between == BETWEEN["nearest"], way.ring
    if way.between in (NOTHING, BETWEEN["nearest"]):
        return single
    return several if average or smooth else linear


def _filtered(way: Way) -> Callable[..., Any]:
    between_frames, finished, place = _between(way), _finisher(way), placer(way.index)
    number, index, unsigned, stack = way.number, way.index, way.unsigned, way.between != NOTHING
    over, average, alpha = way.filter == AUTO, way.average, way.alpha

    @device
    def filtered(samples, fills, source, how, limits, picture, x, y, z, ux, uy, uz,
                 xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        i, u = place(x, ux)
        j, v = place(y, uy)
        k, w, width = index(0), ZERO, ZERO
        if stack:
            k, w = place(z, uz)
            # Far outside the clip, time has no effect.
            if k < how[EARLY] or k >= how[LATE]:
                k, w = index(min(max(k, how[EARLY]), how[LATE])), ZERO
            if average:
                width = width_in_time(tx, ty, tt)
        major, minor, ax, ay = ONE, ONE, ONE, ZERO
        if over:
            major, minor, ax, ay = footprint(xx, xy, yx, yy)
        opacity = number(1.0)
        if alpha:
            opacity = between_frames(samples, fills, source, how, limits, picture, i, j, k, u, v, w, width,
                                     how[ALPHA], major, minor, ax, ay, counts)  # fmt: skip
        for c in range(source[CHANNELS]):
            value = opacity
            if not alpha or c != how[ALPHA]:
                value = between_frames(samples, fills, source, how, limits, picture, i, j, k, u, v, w, width,
                                       index(c), major, minor, ax, ay, counts)  # fmt: skip
            out[unsigned(index(at + index(c * channel)))] = finished(value, opacity, c, how, limits)

    return filtered


@functools.cache
def keeper(way: Way) -> Callable[..., Any]:
    """Return the device function that copies an unchanged pixel, bit for bit, with the arguments of `colour`."""
    if way.filter in (MAP, OFFSETS):
        return _map(way)
    frame_at, index, unsigned = frame_finder(way), way.index, way.unsigned

    @device
    def keep(samples, fills, source, how, limits, picture, x, y, z, ux, uy, uz,
             xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        first = index(index(frame_at(source, picture, counts) + index(y * source[ROW])) + index(x * source[COLUMN]))
        for c in range(source[CHANNELS]):
            sample = samples[unsigned(index(first + index(c * source[CHANNEL])))]
            out[unsigned(index(at + index(c * channel)))] = sample

    return keep


@functools.cache
def colour(way: Way) -> Callable[..., Any]:
    """Return the device function that computes a pixel."""
    if way.filter in (MAP, OFFSETS):
        return _map(way)
    return _nearest(way) if way.filter == NEAREST else _filtered(way)
