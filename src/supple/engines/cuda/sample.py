"""Samples of frames: which one stands for which place, and what is made of those around a point.

Kernels are made for a `Way` of sampling, so that what it does not need costs no registers, and nothing is asked at
every sample. Where an array lies in memory is a tuple of integers (``source``), as SOURCE names them: it may have any
strides. Integers are of 32 bits where all of an array can be counted so, and each sum is cut to that: Numba's own grow
to 64.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import cuda

from supple.engines.base import OUTSIDE
from supple.engines.cuda.kernel import device, lean
from supple.engines.cuda.lattice import MISSING

# How many frames the clip has, and its size; strides, and the first sample, in samples; which frames are here, from and
# to, in which slot the first of them is, and how many slots there are, one after the other and round again.
SOURCE = ("frames", "height", "width", "channels", "frame", "row", "column", "channel", "start",
          "first", "last", "shift", "slots")  # fmt: skip
FRAMES, HEIGHT, WIDTH, CHANNELS, FRAME, ROW, COLUMN, CHANNEL, START, FIRST, LAST, SHIFT, SLOTS = range(len(SOURCE))
# How they are worked with: which channel is opacity, if any; beyond which times nothing changes any more. The bounds of
# the type, and what opaque and white are.
ALPHA, EARLY, LATE = range(3)
LOW, HIGH, WHITE = range(3)
EDGE, CONSTANT = OUTSIDE["edge"], OUTSIDE["constant"]  # the third is "reflect"
SHARPNESS = -0.75  # Keys's a: the slope of his cubic at a distance of 1

_f4 = np.float32
ZERO, ONE, TWO = _f4(0.0), _f4(1.0), _f4(2.0)
_A, _A2, _A3 = _f4(SHARPNESS), _f4(SHARPNESS + 2.0), _f4(SHARPNESS + 3.0)


@dataclass(frozen=True, slots=True)
class Way:
    """How samples are made: what kernels are compiled for.

    Parameters
    ----------
    filter, between : int
        One of `supple.engines.cuda.colour.FILTERS`, and of BETWEEN.
    rule : int
        What lies outside: one of `supple.engines.base.OUTSIDE`.
    average : bool
        Whether pixels are averaged over the time that they cover.
    number : type
        What colours are worked out in: numpy.float32 or numpy.float64.
    index : type
        What samples are counted in: numpy.int32 or numpy.int64.
    whole : bool
        Whether they are whole numbers.
    alpha, light : bool
        Whether a channel is opacity, and whether light is averaged.
    ring : bool
        Whether only some frames are here.
    limited : bool
        Whether there may be pixels that no stroke reaches, which are copied.
    """

    filter: int
    between: int
    rule: int = EDGE
    average: bool = False
    number: Any = np.float32
    index: Any = np.int32
    whole: bool = False
    alpha: bool = False
    light: bool = False
    ring: bool = False
    limited: bool = False

    @property
    def unsigned(self) -> Any:
        """The type of indices: signed ones are checked for counting from the end."""
        return np.uint32 if self.index is np.int32 else np.uint64


def mapper(way: Way) -> Callable[..., Any]:
    """Which of ``n`` samples in a row stands for the one at ``i``; -1 for one that is constant."""
    return _mapper(way.rule, way.index)


@functools.cache
def _mapper(rule: int, index: Any) -> Callable[..., Any]:
    zero, one = index(0), index(1)

    def at_edge(i, n):
        return min(max(i, zero), index(n - one))

    def or_constant(i, n):
        return i if zero <= i < n else index(-1)

    def reflected(i, n):
        k = index(i % index(n + n))
        return k if k < n else index(index(n + n) - one - k)

    return lean(at_edge if rule == EDGE else or_constant if rule == CONSTANT else reflected)


@functools.cache
def placer(index: Any) -> Callable[..., Any]:
    """A whole coordinate and an offset, as a whole part and the rest from 0 to 1."""
    far, one = _f4(1e6), index(1)

    @lean
    def place(q, u):
        kept = min(max(u, -far), far)  # sources far outside are all the same
        whole = index(kept)
        if _f4(whole) > kept:
            whole = index(whole - one)
        return index(q + whole), kept - _f4(whole)

    return place


@lean
def keys(t):
    """Keys's cubic at a distance from a sample."""
    x = abs(t)
    near = (_A2 * x - _A3) * x * x + ONE
    far = _A * (x - ONE) * (TWO - x) * (TWO - x)
    return near if x <= ONE else (far if x < TWO else ZERO)


@lean
def to_light(v, white):
    """A value on sRGB's curve as an amount of light."""
    u = v / white
    return white * (u / 12.92 if u <= 0.04045 else ((u + 0.055) / 1.055) ** 2.4)


@lean
def from_light(v, white):
    """And back."""
    u = v / white
    return white * (12.92 * u if u <= 0.0031308 else 1.055 * u ** (1.0 / 2.4) - 0.055)


def frame_finder(way: Way) -> Callable[..., Any]:
    """Where a frame starts: -1 for one that is constant; it counts those that are not here."""
    mapped, index, ring, constant = mapper(way), way.index, way.ring, way.rule == CONSTANT

    @device
    def frame_at(source, f, counts):
        k = mapped(f, source[FRAMES])
        if constant and k < 0:
            return index(-1)
        if ring:
            if k < source[FIRST] or k >= source[LAST]:
                cuda.atomic.add(counts, MISSING, 1)
                k = source[FIRST]
            k = index(k - source[FIRST] + source[SHIFT])
            if k >= source[SLOTS]:
                k = index(k - source[SLOTS])
        return index(source[START] + index(k * source[FRAME]))

    return frame_at


def reader(way: Way) -> Callable[..., Any]:
    """Return a kernel that reads a sample as a number, as it is filtered: light, if wanted, and weighted by opacity.

    Of places that `mapper` made; ``fills`` is the constant, as it is filtered.
    """
    number, index, unsigned, constant = way.number, way.index, way.unsigned, way.rule == CONSTANT
    if not (way.alpha or way.light):

        @device
        def plain(samples, fills, source, how, limits, start, y, x, c):
            if constant and (start < 0 or y < 0 or x < 0):
                return number(fills[c])
            at = index(index(start + index(y * source[ROW])) + index(x * source[COLUMN]))
            return number(samples[unsigned(at + index(c * source[CHANNEL]))])

        return plain
    alpha, light = way.alpha, way.light

    @device
    def prepared(samples, fills, source, how, limits, start, y, x, c):
        if constant and (start < 0 or y < 0 or x < 0):
            return number(fills[c])
        at = index(index(start + index(y * source[ROW])) + index(x * source[COLUMN]))
        v = number(samples[unsigned(at + index(c * source[CHANNEL]))])
        if c != how[ALPHA]:
            if light:
                v = number(to_light(v, limits[WHITE]))
            if alpha:
                opacity = number(samples[unsigned(at + index(how[ALPHA] * source[CHANNEL]))])
                v = number(v * (opacity / limits[WHITE]))
        return v

    return prepared


def linear_at(way: Way, read: Callable[..., Any]) -> Callable[..., Any]:
    """Bilinear, in a frame."""
    mapped, index = mapper(way), way.index
    one = index(1)

    @device
    def linear(samples, fills, source, how, limits, start, i, j, u, v, c):
        x0, x1 = mapped(i, source[WIDTH]), mapped(index(i + one), source[WIDTH])
        y0, y1 = mapped(j, source[HEIGHT]), mapped(index(j + one), source[HEIGHT])
        a = read(samples, fills, source, how, limits, start, y0, x0, c)
        b = read(samples, fills, source, how, limits, start, y0, x1, c)
        d = read(samples, fills, source, how, limits, start, y1, x0, c)
        e = read(samples, fills, source, how, limits, start, y1, x1, c)
        above = (ONE - u) * a + u * b
        below = (ONE - u) * d + u * e
        return (ONE - v) * above + v * below

    return linear


def cubic_at(way: Way, read: Callable[..., Any]) -> Callable[..., Any]:
    """Bicubic, in a frame."""
    mapped, index = mapper(way), way.index
    one, two = index(1), index(2)

    @device
    def row(samples, fills, source, how, limits, start, y, x0, x1, x2, x3, c, p, q, r, s):
        return (
            p * read(samples, fills, source, how, limits, start, y, x0, c)
            + q * read(samples, fills, source, how, limits, start, y, x1, c)
            + r * read(samples, fills, source, how, limits, start, y, x2, c)
            + s * read(samples, fills, source, how, limits, start, y, x3, c)
        )

    @device
    def cubic(samples, fills, source, how, limits, start, i, j, u, v, c):
        n, m = source[WIDTH], source[HEIGHT]
        x0, x1 = mapped(index(i - one), n), mapped(i, n)
        x2, x3 = mapped(index(i + one), n), mapped(index(i + two), n)
        y0, y1 = mapped(index(j - one), m), mapped(j, m)
        y2, y3 = mapped(index(j + one), m), mapped(index(j + two), m)
        p, q, r, s = keys(u + ONE), keys(u), keys(ONE - u), keys(TWO - u)
        a, b, d, e = keys(v + ONE), keys(v), keys(ONE - v), keys(TWO - v)
        return (
            a * row(samples, fills, source, how, limits, start, y0, x0, x1, x2, x3, c, p, q, r, s)
            + b * row(samples, fills, source, how, limits, start, y1, x0, x1, x2, x3, c, p, q, r, s)
            + d * row(samples, fills, source, how, limits, start, y2, x0, x1, x2, x3, c, p, q, r, s)
            + e * row(samples, fills, source, how, limits, start, y3, x0, x1, x2, x3, c, p, q, r, s)
        )

    return cubic
