"""Averages over what a pixel covers of a frame; see `supple.cpu.footprint` and `supple.cpu.filters`.

What the CPU takes from a pyramid, a thread here averages as it goes: of squares of more than FINEST_SIDE samples a
side, as many of them evenly apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from supple.cpu.filters import MOST_TAPS
from supple.cpu.footprint import (
    ENTRY,
    FADE_ANTIALIAS,
    FADE_AUTO,
    FINEST,
    OBLIQUE,
    PADDED,
    PLACES,
    STEPS,
    TAPS,
    WIDEST,
    covariance,
    shrinking,
)
from supple.cpu.kernel import lean
from supple.cuda.kernel import device
from supple.cuda.sample import HEIGHT, WIDTH, Way, mapper

FINEST_SIDE = 16
POINT, BOX, LONG = 0, 1, 2

_f4 = np.float32
ZERO, HALF, ONE = _f4(0.0), _f4(0.5), _f4(1.0)
_STEPS, _PLACES, _POINT, _MOST = _f4(STEPS), _f4(PLACES), _f4(FINEST * FINEST), _f4(WIDEST * WIDEST)


@lean
def footprint(xx, xy, yx, yy, antialias):
    """How a pixel is filtered, and its footprint: covariance and its eigenvalues.

    Of ∂p/∂q, in the plane. It fades to a point where the map does not shrink.
    """
    a, b, c, major, minor = covariance(xx, xy, yx, yy)
    share = shrinking(major, FADE_ANTIALIAS if antialias else FADE_AUTO)
    major, minor = major * share, max(minor, ZERO) * share
    a, b, c = a * share, b * share, c * share
    kind = LONG
    if major <= _MOST and abs(b) <= _f4(OBLIQUE):
        kind = POINT if a < _POINT and c < _POINT else BOX
    return kind, a, b, c, major, minor


@lean
def long_boxes(xx, xy, yy, major, minor):
    """Of a long footprint: how many samples its squares have a side, its boxes, its axis, and their squared widths."""
    unit = 1
    while unit < 4096 and minor > _f4(WIDEST * WIDEST) * _f4(unit) * _f4(unit):
        unit *= 2
    ax, ay = major - yy, xy
    if xx < yy:
        ax, ay = xy, major - xx
    size = math.sqrt(ax * ax + ay * ay)
    root = math.sqrt(major)
    if size > _f4(1e-12):
        ax, ay = ax / size * root, ay / size * root
    else:
        ax, ay = root, ZERO
    count = min(max(2, int(math.ceil(min(root, _f4(1e6)) / (_f4(1.5) * _f4(unit))))), MOST_TAPS)
    # What the boxes' spread does not average, and the squares have not, is left to each box.
    spread = ONE - ONE / _f4(count * count)
    had = _f4(unit) * _f4(unit) - ONE
    box_x = min(max(xx - spread * ax * ax - had, ZERO) / (_f4(unit) * _f4(unit)), _MOST)
    box_y = min(max(yy - spread * ay * ay - had, ZERO) / (_f4(unit) * _f4(unit)), _MOST)
    return unit, count, ax, ay, box_x, box_y


@lean
def entry(place, squared):
    """Where the entry of the table that is nearest is, and how many steps away, by place and by squared width."""
    p, v = place * _PLACES, squared * _STEPS
    i, j = min(max(int(p + HALF), 0), PLACES), int(v + HALF)
    return (j * (PLACES + 1) + i) * ENTRY, p - _f4(i), v - _f4(j)


@device
def weight(table, at, by_place, by_width):
    """What a sample weighs."""
    return table[at] + by_place * table[at + PADDED] + by_width * table[at + 2 * PADDED]


def averaged_at(way: Way, read: Callable[..., Any]) -> Callable[..., Any]:
    """The average over a footprint that is no point, in a frame."""
    mapped, number, index = mapper(way), way.number, way.index

    @device
    def square(samples, fills, source, how, limits, start, i, j, unit, c):
        """The average of ``unit`` by ``unit`` samples."""
        side = min(unit, FINEST_SIDE)
        apart = unit // side
        total = number(0.0)
        for k in range(side):
            y = mapped(index(j * unit + k * apart + apart // 2), source[HEIGHT])
            for m in range(side):
                x = mapped(index(i * unit + m * apart + apart // 2), source[WIDTH])
                total += read(samples, fills, source, how, limits, start, y, x, c)
        return total / number(side * side)

    @device
    def row(samples, fills, source, how, limits, start, i, j, unit, c, p, q, r, s, t, w):
        if unit > 1:
            return (
                p * square(samples, fills, source, how, limits, start, i - 2, j, unit, c)
                + q * square(samples, fills, source, how, limits, start, i - 1, j, unit, c)
                + r * square(samples, fills, source, how, limits, start, i, j, unit, c)
                + s * square(samples, fills, source, how, limits, start, i + 1, j, unit, c)
                + t * square(samples, fills, source, how, limits, start, i + 2, j, unit, c)
                + w * square(samples, fills, source, how, limits, start, i + 3, j, unit, c)
            )
        y, n = mapped(index(j), source[HEIGHT]), source[WIDTH]
        total = p * read(samples, fills, source, how, limits, start, y, mapped(index(i - 2), n), c)
        total += q * read(samples, fills, source, how, limits, start, y, mapped(index(i - 1), n), c)
        total += r * read(samples, fills, source, how, limits, start, y, mapped(index(i), n), c)
        total += s * read(samples, fills, source, how, limits, start, y, mapped(index(i + 1), n), c)
        total += t * read(samples, fills, source, how, limits, start, y, mapped(index(i + 2), n), c)
        return total + w * read(samples, fills, source, how, limits, start, y, mapped(index(i + 3), n), c)

    @device
    def boxed(samples, fills, source, how, limits, table, start, i, j, u, v, box_x, box_y, unit, c):
        """The cubic interpolant, integrated over a box around a point: a sum of samples, by the CPU's table."""
        at, by_place, by_width = entry(u, box_x)
        p, q = weight(table, at, by_place, by_width), weight(table, at + 1, by_place, by_width)
        r, s = weight(table, at + 2, by_place, by_width), weight(table, at + 3, by_place, by_width)
        t, w = weight(table, at + 4, by_place, by_width), weight(table, at + 5, by_place, by_width)
        at, by_place, by_width = entry(v, box_y)
        total = number(0.0)
        for k in range(TAPS):
            share = weight(table, at + k, by_place, by_width)
            total += share * row(samples, fills, source, how, limits, start, i, j + k - 2, unit, c, p, q, r, s, t, w)
        return total

    @device
    def averaged(
        samples, fills, source, how, limits, table, start, i, j, u, v, c,
        kind, xx, xy, yy, major, minor,
    ):  # fmt: skip
        if kind == BOX:
            return boxed(samples, fills, source, how, limits, table, start, i, j, u, v, xx, yy, 1, c)
        unit, count, ax, ay, box_x, box_y = long_boxes(xx, xy, yy, major, minor)
        # Squares lie at whole multiples of their size.
        i0, j0 = i // unit, j // unit
        u0, v0 = _f4(i - i0 * unit) + u, _f4(j - j0 * unit) + v
        total = number(0.0)
        for k in range(count):
            t = (_f4(k) + HALF) / _f4(count) - HALF
            x, y = (u0 + t * ax + HALF) / _f4(unit) - HALF, (v0 + t * ay + HALF) / _f4(unit) - HALF
            m, n = int(math.floor(x)), int(math.floor(y))
            total += boxed(
                samples, fills, source, how, limits, table, start,
                i0 + m, j0 + n, x - _f4(m), y - _f4(n), box_x, box_y, unit, c,
            )  # fmt: skip
        return total / number(count)

    return averaged
