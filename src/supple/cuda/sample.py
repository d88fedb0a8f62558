"""Samples of frames: which one stands for which place, and what is made of those around a point.

Where an array lies in memory is a tuple of integers (``source``), as SOURCE names them: it may have any strides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda

from supple.cpu.kernel import lean
from supple.cpu.region import CONSTANT, EDGE
from supple.cuda.kernel import device
from supple.cuda.lattice import MISSING

# How many frames the clip has, and its size; strides, and the first sample, in samples; which frames are here, from and
# to, in which slot the first of them is, and how many slots there are, one after the other and round again.
SOURCE = ("frames", "height", "width", "channels", "frame", "row", "column", "channel", "start",
          "first", "last", "shift", "slots")  # fmt: skip
FRAMES, HEIGHT, WIDTH, CHANNELS, FRAME, ROW, COLUMN, CHANNEL, START, FIRST, LAST, SHIFT, SLOTS = range(len(SOURCE))
# How they are worked with: which channel is opacity, if any, whether light is averaged, and whether whole numbers are
# wanted; the rule for what lies outside; and beyond which times nothing changes any more. The bounds of the type, and
# what opaque and white are: see `supple.cpu.region.store`.
ALPHA, LIGHT, WHOLE, RULE, EARLY, LATE = range(6)
LOW, HIGH, WHITE = range(3)

_f4 = np.float32
HALF, ONE, TWO, THREE, FOUR, FIVE = _f4(0.5), _f4(1.0), _f4(2.0), _f4(3.0), _f4(4.0), _f4(5.0)

OUTSIDE = -1  # the place of what lies outside, under the rule CONSTANT


@lean
def mapped(i, n, rule):
    """Which of ``n`` samples in a row stands for the one at ``i``."""
    if rule == EDGE:
        return min(max(i, 0), n - 1)
    if rule == CONSTANT:
        return i if 0 <= i < n else OUTSIDE
    k = i % (2 * n)
    return k if k < n else 2 * n - 1 - k


@lean
def cubic_weights(t):
    """Catmull and Rom's, of the four samples around a point."""
    return (
        HALF * t * ((TWO - t) * t - ONE),
        HALF * t * t * (THREE * t - FIVE) + ONE,
        HALF * t * ((FOUR - THREE * t) * t + ONE),
        HALF * t * t * (t - ONE),
    )


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


@device
def frame_at(source, how, f, counts):
    """Where a frame starts: OUTSIDE for one that is constant; it counts those that are not here."""
    k = mapped(f, source[FRAMES], how[RULE])
    if k < 0:
        return OUTSIDE
    if k < source[FIRST] or k >= source[LAST]:
        cuda.atomic.add(counts, MISSING, 1)
        k = source[FIRST]
    slot = k - source[FIRST] + source[SHIFT]
    if slot >= source[SLOTS]:
        slot -= source[SLOTS]
    return source[START] + slot * source[FRAME]


def reader(number: Any, mixed: bool) -> Callable[..., Any]:
    """What reads a sample as a number, as it is filtered: light, if wanted, and weighted by opacity.

    Of places that `mapped` made; ``fills`` is the constant, as it is filtered.
    """
    if not mixed:

        @device
        def plain(samples, fills, source, how, limits, start, y, x, c):
            if start < 0 or y < 0 or x < 0:
                return number(fills[c])
            return number(
                samples[np.uintp(start + y * source[ROW] + x * source[COLUMN] + c * source[CHANNEL])]
            )

        return plain

    @device
    def prepared(samples, fills, source, how, limits, start, y, x, c):
        if start < 0 or y < 0 or x < 0:
            return number(fills[c])
        at = start + y * source[ROW] + x * source[COLUMN]
        v = number(samples[np.uintp(at + c * source[CHANNEL])])
        if c != how[ALPHA]:
            if how[LIGHT] > 0:
                v = number(to_light(v, limits[WHITE]))
            if how[ALPHA] >= 0:
                v = number(v * (number(samples[np.uintp(at + how[ALPHA] * source[CHANNEL])]) / limits[WHITE]))
        return v

    return prepared


def linear_at(read: Callable[..., Any]) -> Callable[..., Any]:
    """Bilinear, in a frame."""

    @device
    def linear(samples, fills, source, how, limits, start, i, j, u, v, c):
        x0, x1 = mapped(i, source[WIDTH], how[RULE]), mapped(i + 1, source[WIDTH], how[RULE])
        y0, y1 = mapped(j, source[HEIGHT], how[RULE]), mapped(j + 1, source[HEIGHT], how[RULE])
        a = read(samples, fills, source, how, limits, start, y0, x0, c)
        b = read(samples, fills, source, how, limits, start, y0, x1, c)
        d = read(samples, fills, source, how, limits, start, y1, x0, c)
        e = read(samples, fills, source, how, limits, start, y1, x1, c)
        above = (ONE - u) * a + u * b
        below = (ONE - u) * d + u * e
        return (ONE - v) * above + v * below

    return linear


def cubic_at(read: Callable[..., Any]) -> Callable[..., Any]:
    """Bicubic, in a frame."""

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
        x0, x1 = mapped(i - 1, n, how[RULE]), mapped(i, n, how[RULE])
        x2, x3 = mapped(i + 1, n, how[RULE]), mapped(i + 2, n, how[RULE])
        y0, y1 = mapped(j - 1, m, how[RULE]), mapped(j, m, how[RULE])
        y2, y3 = mapped(j + 1, m, how[RULE]), mapped(j + 2, m, how[RULE])
        p, q, r, s = cubic_weights(u)
        a, b, d, e = cubic_weights(v)
        return (
            a * row(samples, fills, source, how, limits, start, y0, x0, x1, x2, x3, c, p, q, r, s)
            + b * row(samples, fills, source, how, limits, start, y1, x0, x1, x2, x3, c, p, q, r, s)
            + d * row(samples, fills, source, how, limits, start, y2, x0, x1, x2, x3, c, p, q, r, s)
            + e * row(samples, fills, source, how, limits, start, y3, x0, x1, x2, x3, c, p, q, r, s)
        )

    return cubic
