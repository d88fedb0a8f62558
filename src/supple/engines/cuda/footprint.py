"""Averages over the residual footprint of a pixel: its footprint, less that of a source sample.

With M = ∂p/∂q, an output pixel covers an ellipse whose axes are the singular values of M. A sample of the source is an
average over one pixel already, so that boxes of the widths √(λ - 1) are left, where λ are the eigenvalues of S = M Mᵀ.
The cubic interpolant is averaged over them by spots along the major axis, each of four points with the right second
moments. Where even the minor axis is long, spots lie in a level of a pyramid, whose samples are averaged as they are
read: of squares of more than FINEST_SIDE samples a side, as many of them evenly apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from supple.engines.cuda.kernel import device, lean
from supple.engines.cuda.sample import CONSTANT, HEIGHT, WIDTH, Way, keys, mapper

SOFT, FULL = 0.05, 0.2  # λ₊ - 1 up to which a pixel is a point, and from which its footprint is exact
SPACING = 1.7  # the largest distance of spots
MOST_SPOTS = 16
THICKEST, WIDEST = 3.0, 2.99  # the largest squared widths of a spot, along the major axis and across it
FINEST_LEVEL = 4.0  # λ₋ from which a level of the pyramid is too fine
LONGEST = 400.0  # the largest λ₊ of a spot's level, for MOST_SPOTS
LEVELS = 12
FINEST_SIDE = 16

_f4 = np.float32
ZERO, HALF, ONE, TWO, THREE = _f4(0.0), _f4(0.5), _f4(1.0), _f4(2.0), _f4(3.0)
_SOFT, _RAMP, _SPACING = _f4(SOFT), _f4(FULL / (FULL - SOFT)), _f4(SPACING)
_THICKEST, _WIDEST = _f4(THICKEST), _f4(WIDEST)
_COARSE, _LONGEST, _TWELFTH, _MOST_SIGMA = _f4(FINEST_LEVEL), _f4(LONGEST), _f4(1.0 / 12.0), _f4(0.4999)
_QUARTER, _FOUR = _f4(0.25), _f4(4.0)
_FADE, _RISE = _f4(0.75), _f4(3.2)  # the range of blending with the next spot and the next level


@lean
def footprint(xx, xy, yx, yy):
    """Return λ₊ and λ₋, softened and at least 1, and the direction of the major axis, of ∂p/∂q in the plane."""
    a, b, c = xx * xx + xy * xy, xx * yx + xy * yy, yx * yx + yy * yy
    mean, e = HALF * (a + c), HALF * (a - c)
    d = math.sqrt(e * e + b * b)
    major, minor = mean + d, max(mean - d, ONE)
    extra = major - ONE
    if extra <= _SOFT:
        return ONE, ONE, ONE, ZERO
    soft = min(_RAMP * (extra - _SOFT) / extra, ONE)
    # The doubled angle of the axis has the cosine e / d and the sine b / d.
    cos2, sin2 = (e / d, b / d) if d > ZERO else (ONE, ZERO)
    if cos2 >= ZERO:
        ax = math.sqrt(HALF * (ONE + cos2))
        ay = HALF * sin2 / ax
    else:
        ay = math.sqrt(HALF * (ONE - cos2))
        ax = HALF * sin2 / ay
    return ONE + soft * extra, ONE + soft * (minor - ONE), ax, ay


@lean
def smoothstep(t):
    """Return a smooth step from 0 to 1, for t from 0 to 1; 0 and 1 beyond."""
    t = min(max(t, ZERO), ONE)
    return t * t * (THREE - TWO * t)


@lean
def finest_level(major, minor, side):
    """Return the pyramid level for a footprint, and the weight of the next one.

    The coarsest level of an image, ``side`` samples long, is one sample.
    """
    want, level = max(minor, major / _LONGEST), 0
    while want >= _COARSE and (1 << level) < side and level < LEVELS:
        want *= _QUARTER
        level += 1
    mixed = smoothstep((want - _RISE) / (_COARSE - _RISE)) if (1 << level) < side and level < LEVELS else ZERO
    return level, mixed


@lean
def spots_along(major):
    """Return the length of a footprint in its level, its number of spots, and the weight of one more."""
    long = math.sqrt(max(major - ONE, ZERO))
    v = min(long / _SPACING, _f4(MOST_SPOTS))
    count = min(int(v) + 1, MOST_SPOTS)
    mixed = smoothstep(_FOUR * (v - _f4(count - 1) - _FADE)) if count < MOST_SPOTS else ZERO
    return long, count, mixed


@lean
def spot_moments(long, count, minor, ax, ay):
    """Return σx, σy and their correlation for each of ``count`` spots along an axis."""
    along = min(long * long / _f4(count * count), _THICKEST)
    wide = min(max(minor - ONE, ZERO), _WIDEST)
    sx = min(math.sqrt(max(_TWELFTH * (along * ax * ax + wide * ay * ay), ZERO)), _MOST_SIGMA)
    sy = min(math.sqrt(max(_TWELFTH * (along * ay * ay + wide * ax * ax), ZERO)), _MOST_SIGMA)
    both = sx * sy
    return sx, sy, _TWELFTH * (along - wide) * ax * ay / both if both > ZERO else ZERO


@lean
def even(t, sigma):
    """Return half the sum of a sample's weights at the points ``sigma`` before and after one at a distance ``t``."""
    return HALF * (keys(t + sigma) + keys(t - sigma))


@lean
def odd(t, sigma):
    """Return half the difference of these weights."""
    return HALF * (keys(t - sigma) - keys(t + sigma))


def averaged_at(way: Way, read: Callable[..., Any]) -> Callable[..., Any]:
    """Return the device function that averages a frame over a footprint larger than a point."""
    mapped, number, index = mapper(way), way.number, way.index
    constant, one = way.rule == CONSTANT, index(1)

    @device
    def sides(n, level):
        """Return the number of samples in a row of a level, whose finest has ``n``."""
        return index((n + (1 << level) - 1) >> level)

    @device
    def member(i, k, level, n):
        """Return the k-th sample in a row averaged by a sample of a level; an odd row's last one counts twice."""
        for finer in range(level - 1, -1, -1):
            i = min(index(2 * i + ((k >> finer) & 1)), index(sides(n, finer) - one))
        return i

    @device
    def pixel(samples, fills, source, how, limits, start, j, i, level, c):
        """Return a sample of a level of the pyramid, at indices from `mapper`."""
        if level == 0 or (constant and (start < 0 or i < 0 or j < 0)):
            return read(samples, fills, source, how, limits, start, j, i, c)
        side = 1 << level
        apart = max(1, side // FINEST_SIDE)
        total, many = number(0.0), side // apart
        for m in range(many):
            y = member(j, m * apart + apart // 2, level, source[HEIGHT])
            for k in range(many):
                x = member(i, k * apart + apart // 2, level, source[WIDTH])
                total += read(samples, fills, source, how, limits, start, y, x, c)
        return total / number(many * many)

    @device
    def spot(samples, fills, source, how, limits, start, i, j, u, v, level, sx, sy, correlation, c):
        """Return the mean of the cubic interpolant at four points around (i + u, j + v) in a level.

        With even and odd parts of the weights along each axis, it is even(x) even(y) + ρ odd(x) odd(y).
        """
        n, rows = sides(source[WIDTH], level), sides(source[HEIGHT], level)
        x0, x1, x2 = mapped(index(i - 2), n), mapped(index(i - 1), n), mapped(index(i), n)
        x3, x4, x5 = mapped(index(i + 1), n), mapped(index(i + 2), n), mapped(index(i + 3), n)
        p0, p1, p2 = even(u + TWO, sx), even(u + ONE, sx), even(u, sx)
        p3, p4, p5 = even(u - ONE, sx), even(u - TWO, sx), even(u - THREE, sx)
        q0, q1, q2 = odd(u + TWO, sx), odd(u + ONE, sx), odd(u, sx)
        q3, q4, q5 = odd(u - ONE, sx), odd(u - TWO, sx), odd(u - THREE, sx)
        total = number(0.0)
        for k in range(6):
            y = mapped(index(j + k - 2), rows)
            t = v - _f4(k - 2)
            a = pixel(samples, fills, source, how, limits, start, y, x0, level, c)
            b = pixel(samples, fills, source, how, limits, start, y, x1, level, c)
            d = pixel(samples, fills, source, how, limits, start, y, x2, level, c)
            e = pixel(samples, fills, source, how, limits, start, y, x3, level, c)
            f = pixel(samples, fills, source, how, limits, start, y, x4, level, c)
            g = pixel(samples, fills, source, how, limits, start, y, x5, level, c)
            total += even(t, sy) * (p0 * a + p1 * b + p2 * d + p3 * e + p4 * f + p5 * g)
            total += correlation * odd(t, sy) * (q0 * a + q1 * b + q2 * d + q3 * e + q4 * f + q5 * g)
        return total

    @device
    def averaged(samples, fills, source, how, limits, start, i, j, u, v, c, major, minor, ax, ay):
        finest, coarser = finest_level(major, minor, max(source[WIDTH], source[HEIGHT]))
        total = number(0.0)
        for level in range(finest, finest + (2 if coarser > ZERO else 1)):
            of_level = ONE - coarser if level == finest else coarser
            unit = _f4(1 << level)
            long, least, more = spots_along(major / (unit * unit))
            # Whole and fractional parts are kept apart: float32 does not hold their sum for a large image.
            i0, j0 = i >> level, j >> level
            u0, v0 = (_f4(i - (i0 << level)) + u + HALF) / unit, (_f4(j - (j0 << level)) + v + HALF) / unit
            for count in range(least, least + (2 if more > ZERO else 1)):
                weight = of_level * (ONE - more if count == least else more) / _f4(count)
                sx, sy, correlation = spot_moments(long, count, minor / (unit * unit), ax, ay)
                for k in range(count):
                    t = long * ((_f4(k) + HALF) / _f4(count) - HALF)
                    x, y = u0 + t * ax - HALF, v0 + t * ay - HALF
                    m, n = int(math.floor(x)), int(math.floor(y))
                    total += weight * spot(
                        samples, fills, source, how, limits, start, index(i0 + m), index(j0 + n),
                        x - _f4(m), y - _f4(n), level, sx, sy, correlation, c,
                    )  # fmt: skip
        return total

    return averaged
