"""The colour of a pixel whose source point is known: a device function for each way of filtering.

All of them take the same, so that kernels need not know which one they call: samples, the constant outside, where
samples lie and how they are worked with (`supple.cuda.sample`), the table of box weights, which frame is the picture,
where none is interpolated, the pixel (x, y, z) and its displacement, ∂p/∂q as far as it is needed, and where the result
goes. A kernel made for one of them has no registers that the others would need.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from supple.cpu.between import LONGEST
from supple.cpu.kernel import lean
from supple.cuda.footprint import POINT, averaged_at, footprint
from supple.cuda.kernel import device
from supple.cuda.sample import (
    ALPHA,
    CHANNEL,
    CHANNELS,
    COLUMN,
    EARLY,
    HEIGHT,
    HIGH,
    LATE,
    LIGHT,
    LOW,
    ROW,
    RULE,
    WHITE,
    WHOLE,
    WIDTH,
    cubic_at,
    frame_at,
    from_light,
    linear_at,
    mapped,
    reader,
)

# MAP is no filter: source points themselves are written, as float32, x first.
FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "auto": 3, "antialias": 4, "map": 5}
NEAREST, LINEAR, CUBIC, AUTO, ANTIALIAS, MAP = range(6)
# Between frames that are pictures by themselves, nothing is interpolated.
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2, "nothing": 3}
NOTHING = 3

_f4 = np.float32
ZERO, HALF, ONE, TWO, TEN, FAR = _f4(0.0), _f4(0.5), _f4(1.0), _f4(2.0), _f4(10.0), _f4(1e6)


@lean
def place(q, u):
    """A whole coordinate and an offset, as a whole part and the rest from 0 to 1."""
    kept = min(max(u, -FAR), FAR)  # sources far outside are all the same
    whole = int(math.floor(kept))
    return q + whole, kept - _f4(whole)


@lean
def integral(t, cubic):
    """The integral of a kernel between frames, the tent or Catmull and Rom's, from 0 to t."""
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
    """How many frames a pixel covers, by the row ∂p_t/∂q; the average fades in."""
    along = math.sqrt(a * a + b * b + c * c)
    return min(along * min(max((along - ONE) * TEN, ZERO), ONE), _f4(LONGEST))


@lean
def time_weight(t, width, cubic):
    """What a frame at a distance ``t`` counts, for a pixel that covers ``width`` frames."""
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


def _map() -> Callable[..., Any]:
    @device
    def point(samples, fills, source, how, limits, table, picture, x, y, z, ux, uy, uz,
              xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        out[np.uintp(at)] = _f4(x + ux)
        out[np.uintp(at + channel)] = _f4(y + uy)
        if source[CHANNELS] == 3:
            out[np.uintp(at + 2 * channel)] = _f4(z + uz)

    return point


def _nearest(between: int) -> Callable[..., Any]:
    """The sample nearest to a point, as it is; ties go to the larger index."""

    @device
    def nearest(samples, fills, source, how, limits, table, picture, x, y, z, ux, uy, uz,
                xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        i, u = place(x, ux)
        j, v = place(y, uy)
        i = mapped(i + int(u >= HALF), source[WIDTH], how[RULE])
        j = mapped(j + int(v >= HALF), source[HEIGHT], how[RULE])
        f = picture
        if between != NOTHING:
            k, w = place(z, uz)
            f = k + int(w >= HALF)
        start = frame_at(source, how, f, counts)
        inside = start >= 0 and i >= 0 and j >= 0
        first = start + j * source[ROW] + i * source[COLUMN]
        for c in range(source[CHANNELS]):
            if inside:
                out[np.uintp(at + c * channel)] = samples[np.uintp(first + c * source[CHANNEL])]
            else:
                out[np.uintp(at + c * channel)] = fills[c]

    return nearest


def _in_frame(filter: int, number: Any, mixed: bool) -> Callable[..., Any]:
    read = reader(number, mixed)
    linear, cubic, averaged = linear_at(read), cubic_at(read), averaged_at(read, number)
    if filter in (LINEAR, CUBIC):
        pointed = linear if filter == LINEAR else cubic

        @device
        def at_point(samples, fills, source, how, limits, table, start, i, j, u, v, c,
                     kind, box_x, box_y, xx, xy, yy, major, minor):  # fmt: skip
            return pointed(samples, fills, source, how, limits, start, i, j, u, v, c)

        return at_point

    @device
    def over_footprint(samples, fills, source, how, limits, table, start, i, j, u, v, c,
                       kind, box_x, box_y, xx, xy, yy, major, minor):  # fmt: skip
        if kind == POINT:
            return cubic(samples, fills, source, how, limits, start, i, j, u, v, c)
        return averaged(
            samples, fills, source, how, limits, table, start, i, j, u, v, c,
            kind, box_x, box_y, xx, xy, yy, major, minor,
        )  # fmt: skip

    return over_footprint


def _finisher(number: Any, mixed: bool) -> Callable[..., Any]:
    """The reverse of `supple.cuda.sample.reader`, and whole numbers where they are wanted."""
    exact = number(2.0 ** (23 if number is np.float32 else 52))  # from here on, all numbers are whole

    @device
    def finished(v, opacity, c, how, limits):
        if mixed:
            if c == how[ALPHA]:
                # A cubic overshoots; more than opaque, or less than clear, there is nothing to show.
                v = min(max(v, number(0.0)), number(limits[WHITE]))
            else:
                if how[ALPHA] >= 0:
                    v = number(v * limits[WHITE] / opacity) if opacity > number(0.0) else number(0.0)
                if how[LIGHT] > 0:
                    v = number(from_light(v, limits[WHITE]))
        if how[WHOLE] > 0:
            v = min(max(v, number(limits[LOW])), number(limits[HIGH]))
            if abs(v) < exact:
                v = min(number(math.floor(v + number(0.5))), number(limits[HIGH]))
        return v

    return finished


def _filtered(filter: int, between: int, average: bool, number: Any, mixed: bool) -> Callable[..., Any]:
    in_frame, finished = _in_frame(filter, number, mixed), _finisher(number, mixed)
    over, antialias, smooth = filter in (AUTO, ANTIALIAS), filter == ANTIALIAS, between == BETWEEN["cubic"]
    radius = _f4(2.0 if smooth else 1.0)
    before, after = (1, 2) if smooth else (0, 1)

    @device
    def between_frames(samples, fills, source, how, limits, table, picture, i, j, k, u, v, w, width, c,
                       kind, box_x, box_y, xx, xy, yy, major, minor, counts):  # fmt: skip
        if between in (NOTHING, 0):
            f = picture if between == NOTHING else k + int(w >= HALF)
            start = frame_at(source, how, f, counts)
            return in_frame(samples, fills, source, how, limits, table, start, i, j, u, v, c,
                            kind, box_x, box_y, xx, xy, yy, major, minor)  # fmt: skip
        first, last = k - before, k + after
        if average:
            reach = radius + HALF * width
            first, last = k + int(math.floor(w - reach)) + 1, k + int(math.ceil(w + reach)) - 1
        total, weights = number(0.0), ZERO
        for f in range(first, last + 1):
            weight = time_weight(_f4(f - k) - w, width, smooth)
            if weight != ZERO:
                start = frame_at(source, how, f, counts)
                total += weight * in_frame(samples, fills, source, how, limits, table, start, i, j, u, v, c,
                                           kind, box_x, box_y, xx, xy, yy, major, minor)  # fmt: skip
                weights += weight
        return total / weights

    @device
    def filtered(samples, fills, source, how, limits, table, picture, x, y, z, ux, uy, uz,
                 xx, xy, yx, yy, tx, ty, tt, out, at, channel, counts):  # fmt: skip
        i, u = place(x, ux)
        j, v = place(y, uy)
        k, w, width = 0, ZERO, ZERO
        if between != NOTHING:
            k, w = place(z, uz)
            # Far outside the clip, all times are the same.
            if k < how[EARLY] or k >= how[LATE]:
                k, w = min(max(k, how[EARLY]), how[LATE]), ZERO
            if average:
                width = width_in_time(tx, ty, tt)
        kind, box_x, box_y, major, minor = POINT, 0, 0, ONE, ONE
        cxx, cxy, cyy = ONE, ZERO, ONE
        if over:
            kind, box_x, box_y, cxx, cxy, cyy, major, minor = footprint(xx, xy, yx, yy, antialias)
        opacity = number(1.0)
        if mixed and how[ALPHA] >= 0:
            opacity = between_frames(samples, fills, source, how, limits, table, picture, i, j, k, u, v, w, width,
                                     how[ALPHA], kind, box_x, box_y, cxx, cxy, cyy, major, minor, counts)  # fmt: skip
        for c in range(source[CHANNELS]):
            value = opacity
            if not mixed or c != how[ALPHA]:
                value = between_frames(samples, fills, source, how, limits, table, picture, i, j, k, u, v, w, width,
                                       c, kind, box_x, box_y, cxx, cxy, cyy, major, minor, counts)  # fmt: skip
            out[np.uintp(at + c * channel)] = finished(value, opacity, c, how, limits)

    return filtered


@functools.cache
def colour(filter: int, between: int, average: bool, number: Any, mixed: bool) -> Callable[..., Any]:
    """The device function that makes a pixel.

    Parameters
    ----------
    filter, between : int
        One of FILTERS, and of BETWEEN.
    average : bool
        Whether pixels are averaged over the time that they cover.
    number : type
        What colours are worked out in: numpy.float32 or numpy.float64.
    mixed : bool
        Whether light, or colours weighted by opacity, are filtered.
    """
    if filter == MAP:
        return _map()
    if filter == NEAREST:
        return _nearest(between)
    return _filtered(filter, between, average, number, mixed)
