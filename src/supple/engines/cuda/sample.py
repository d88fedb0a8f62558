"""Samples of frames: boundary modes, and interpolation around a point.

Kernels are compiled for a `Way` of sampling, so that unused options cost no registers and no branches. The memory
layout of an array is a tuple of integers (``source``), named in SOURCE, with any strides. Integers have 32 bits if all
of an array can be counted so, and each sum is cast to that type, since Numba widens them to 64.
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

# The number of frames, and their size; strides, and the index of the first sample, in samples; the range of frames on
# the GPU, the slot of the first, and the number of slots in the ring.
SOURCE = ("frames", "height", "width", "channels", "frame", "row", "column", "channel", "start",
          "first", "last", "shift", "slots")  # fmt: skip
FRAMES, HEIGHT, WIDTH, CHANNELS, FRAME, ROW, COLUMN, CHANNEL, START, FIRST, LAST, SHIFT, SLOTS = range(len(SOURCE))
# The opacity channel, if any; the times beyond which samples are constant; the bounds of the type, and the value of
# white and full opacity.
ALPHA, EARLY, LATE = range(3)
LOW, HIGH, WHITE = range(3)
EDGE, CONSTANT = OUTSIDE["edge"], OUTSIDE["constant"]  # the third is "reflect"
SHARPNESS = -0.75  # Keys's a: the slope of his cubic at a distance of 1

_f4 = np.float32
ZERO, ONE, TWO = _f4(0.0), _f4(1.0), _f4(2.0)
_A, _A2, _A3 = _f4(SHARPNESS), _f4(SHARPNESS + 2.0), _f4(SHARPNESS + 3.0)


@dataclass(frozen=True, slots=True)
class Way:
    """The sampling options that kernels are compiled for.

    Parameters
    ----------
    filter, between : int
        One of `supple.engines.cuda.colour.FILTERS`, and of BETWEEN.
    rule : int
        Boundary mode: one of `supple.engines.base.OUTSIDE`.
    average : bool
        Whether pixels are averaged over time.
    number : type
        The type of colour arithmetic: numpy.float32 or numpy.float64.
    index : type
        The type of indices: numpy.int32 or numpy.int64.
    whole : bool
        Whether samples are integers.
    alpha, light : bool
        Whether a channel is opacity, and whether averages are in linear light.
    ring : bool
        Whether only some frames are on the GPU.
    limited : bool
        Whether some pixels may be unchanged, which are copied.
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
        """The unsigned index type, since signed indices are checked for counting from the end."""
        return np.uint32 if self.index is np.int32 else np.uint64


def mapper(way: Way) -> Callable[..., Any]:
    """Return the function for the boundary mode: the index used for ``i`` in ``n`` samples; -1 for the fill value."""
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
    """Return the function that splits a whole coordinate and an offset into a whole part and a fraction."""
    far, one = _f4(1e6), index(1)

    @lean
    def place(q, u):
        kept = min(max(u, -far), far)  # far outside, all source points are alike
        whole = index(kept)
        if _f4(whole) > kept:
            whole = index(whole - one)
        return index(q + whole), kept - _f4(whole)

    return place


@lean
def keys(t):
    """Return Keys's cubic at a distance from a sample."""
    x = abs(t)
    near = (_A2 * x - _A3) * x * x + ONE
    far = _A * (x - ONE) * (TWO - x) * (TWO - x)
    return near if x <= ONE else (far if x < TWO else ZERO)


@lean
def to_light(v, white):
    """Convert an sRGB value to linear light."""
    u = v / white
    return white * (u / 12.92 if u <= 0.04045 else ((u + 0.055) / 1.055) ** 2.4)


@lean
def from_light(v, white):
    """Convert linear light to an sRGB value."""
    u = v / white
    return white * (12.92 * u if u <= 0.0031308 else 1.055 * u ** (1.0 / 2.4) - 0.055)


def frame_finder(way: Way) -> Callable[..., Any]:
    """Return the function for the start of a frame: -1 for the fill value; it counts missing frames."""
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
    """Return a kernel that reads a sample for filtering: in linear light, if wanted, and weighted by opacity.

    Its indices are from `mapper`; ``fills`` is the fill value in the same form.
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
    """Return the bilinear filter in a frame."""
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
    """Return the bicubic filter in a frame."""
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
