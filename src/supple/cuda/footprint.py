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
from supple.cpu.footprint import OBLIQUE, PLACES, STEPS, TAPS, WIDEST
from supple.cpu.kernel import lean
from supple.cuda.kernel import device
from supple.cuda.sample import HEIGHT, WIDTH, Way, mapper

FINEST_SIDE = 16
POINT, BOX, LONG = 0, 1, 2

_f4 = np.float32
ZERO, HALF, ONE, FOUR, TINY = _f4(0.0), _f4(0.5), _f4(1.0), _f4(4.0), _f4(1e-6)
_STEPS, _PLACES = _f4(STEPS), _f4(PLACES)


@lean
def footprint(xx, xy, yx, yy, antialias):
    """How a pixel is filtered, and its footprint: box widths in steps of the table, covariance, and its eigenvalues.

    Of ∂p/∂q, in the plane. It fades to a point where the map does not shrink.
    """
    a, b, c = xx * xx + xy * xy, xx * yx + xy * yy, yx * yx + yy * yy
    spread = math.sqrt((a - c) * (a - c) + FOUR * b * b)
    major, minor = HALF * (a + c + spread), HALF * (a + c - spread)
    inverse = ONE / (spread + TINY)
    upright = HALF * (ONE + (a - c) * inverse)
    start = _f4(0.97) if antialias else ONE
    rise = ONE / _f4(0.03) if antialias else _f4(10.0)
    shrinking = min(max((math.sqrt(major) - start) * rise, ZERO), ONE)
    major, minor = major * shrinking, max(minor, ZERO) * shrinking
    along = major * upright + minor * (ONE - upright)
    mixed = (major - minor) * b * inverse
    down = minor * upright + major * (ONE - upright)
    wide = min(math.sqrt(max(along, ZERO)) * _STEPS + HALF, _f4(1e6))
    tall = min(math.sqrt(max(down, ZERO)) * _STEPS + HALF, _f4(1e6))
    box_x, box_y = int(wide), int(tall)
    kind = LONG
    if major <= _f4(WIDEST * WIDEST) and abs(mixed) <= _f4(OBLIQUE):
        kind = POINT if box_x == 0 and box_y == 0 else BOX
    return kind, box_x, box_y, along, mixed, down, major, minor


@lean
def long_boxes(xx, xy, yy, major, minor):
    """Of a long footprint: how many samples its squares have a side, its boxes, its axis, and their widths in steps."""
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
    box_x = min(math.sqrt(max(xx - spread * ax * ax - had, ZERO)) / _f4(unit), _f4(WIDEST))
    box_y = min(math.sqrt(max(yy - spread * ay * ay - had, ZERO)) / _f4(unit), _f4(WIDEST))
    return unit, count, ax, ay, int(box_x * _STEPS + HALF), int(box_y * _STEPS + HALF)


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
    def boxed(samples, fills, source, how, limits, table, start, i, j, u, v, box_x, box_y, unit, c):
        """The cubic interpolant, integrated over a box around a point: a sum of samples, by the CPU's table."""
        along = (box_x * (PLACES + 1) + min(max(int(u * _PLACES + HALF), 0), PLACES)) * TAPS
        down = (box_y * (PLACES + 1) + min(max(int(v * _PLACES + HALF), 0), PLACES)) * TAPS
        total = number(0.0)
        for k in range(TAPS):
            weight = table[down + k]
            if weight != ZERO:
                row = number(0.0)
                for m in range(TAPS):
                    share = table[along + m]
                    if share != ZERO:
                        if unit == 1:
                            y = mapped(index(j + k - 2), source[HEIGHT])
                            x = mapped(index(i + m - 2), source[WIDTH])
                            row += share * read(samples, fills, source, how, limits, start, y, x, c)
                        else:
                            row += share * square(
                                samples, fills, source, how, limits, start, i + m - 2, j + k - 2, unit, c
                            )
                total += weight * row
        return total

    @device
    def averaged(
        samples, fills, source, how, limits, table, start, i, j, u, v, c,
        kind, box_x, box_y, xx, xy, yy, major, minor,
    ):  # fmt: skip
        if kind == BOX:
            return boxed(samples, fills, source, how, limits, table, start, i, j, u, v, box_x, box_y, 1, c)
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
