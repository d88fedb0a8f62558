"""How much of the source an output pixel covers, and the weights of the samples there.

The footprint of a pixel is a parallelogram, the image of its square under M = ∂T⁻¹/∂q, which neighbouring source
points give. It is described by the covariance C = M Mᵀ, whose eigenvalues are the squares of M's singular values. A
footprint that is nearly upright is averaged exactly: the cubic interpolant, integrated over a box, is a sum of
samples whose weights separate, and are kept in a table of box widths and positions. A long or an oblique one is
made of several such boxes along its major axis, taken from a pyramid where even the minor one is long.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from supple.cpu.kernel import kernel, lean
from supple.cpu.sample import WIDE

LINEAR, CUBIC, AUTO, ANTIALIAS, EWA = 0, 1, 2, 3, 4

# Rows of a run's scratch of float32, after PART_X and PART_Y: σ₁'², σ₂'² and C' (xx, xy, yy), made from M, which is
# there before; then how far a pixel is from the table's entries, in their steps: place and squared width along x,
# and along y.
MAJOR, MINOR, XX, XY, YY, REST = (k * WIDE for k in range(2, 8))
YX = MINOR
PARTS = REST + 4 * WIDE

TAPS = 6  # samples along an axis under a box of up to two pixels, widened by the cubic
PLACES = 128  # positions between two samples
STEPS = 16  # squares of box widths to a square pixel
WIDEST = 2.0
FINEST = 1.0 / 64.0  # a box that is smaller is a point
OBLIQUE = 0.5  # an upright box stands for a footprint with less covariance than this
PADDED = 8  # weights, and as many derivatives by place and by squared width, are filled up to so many
ENTRY = 3 * PADDED
MOST_BEND = 0.25  # pixels
# Where σ₁² is from this on, and from this, footprints fade in, so that no seam shows: for ANTIALIAS before the map
# begins to shrink, for AUTO as it does, which leaves what is hardly shrunk as sharp as it was.
FADE_ANTIALIAS, FADE_AUTO = (0.97**2, 1.0), (1.0, 1.1**2)


def _cubic(t: np.ndarray) -> np.ndarray:
    """Catmull and Rom's kernel."""
    x = np.minimum(np.abs(t), 2.0)
    return np.asarray(np.where(x <= 1, 1 - 2.5 * x**2 + 1.5 * x**3, 2 - 4 * x + 2.5 * x**2 - 0.5 * x**3))


def _integral(t: np.ndarray) -> np.ndarray:
    """The integral of Catmull and Rom's kernel from 0 to t."""
    x = np.minimum(np.abs(t), 2.0)
    inner = x - 5 / 6 * x**3 + 3 / 8 * x**4
    outer = 2 * x - 2 * x**2 + 5 / 6 * x**3 - x**4 / 8 - 1 / 6
    return np.asarray(np.sign(t) * np.where(x <= 1, inner, outer))


@functools.cache
def weights(dtype: np.dtype[np.floating]) -> np.ndarray:
    """The table, flat: for each squared box width and position, what the samples -2 to 3 weigh, and how that changes.

    An entry is ENTRY numbers: the weights, and their derivatives by the position and by the squared width, to a step
    of each. By its square, as a width of nothing is no special case then.
    """
    t = np.arange(TAPS)[None, None, :] - 2 - np.arange(PLACES + 1)[None, :, None] / PLACES
    squared = np.arange(int(WIDEST**2 * STEPS) + 1)[:, None, None]

    def averages(squared: np.ndarray) -> np.ndarray:
        width = np.sqrt(np.maximum(squared / STEPS, 1e-6))
        return np.asarray((_integral(t + width / 2) - _integral(t - width / 2)) / width)

    width = np.sqrt(np.maximum(squared / STEPS, 1e-6))
    lower = np.maximum(squared - 0.5, 0.0)
    table = np.zeros((squared.size, PLACES + 1, 3, PADDED))
    table[:, :, 0, :TAPS] = averages(squared)
    table[:, :, 1, :TAPS] = (_cubic(t - width / 2) - _cubic(t + width / 2)) / width / PLACES
    # Between half steps, so that neighbouring entries agree where they meet.
    table[:, :, 2, :TAPS] = (averages(squared + 0.5) - averages(lower)) / (squared + 0.5 - lower)
    # A box of a pixel covers five samples, and does so half a step later: less than 1e-8 is left out.
    change = table[STEPS, :, 2]
    for places, none, beside in (slice(PLACES // 2 + 1), 5, 4), (slice(PLACES // 2, None), 0, 1):
        change[places, beside] += change[places, none]
        change[places, none] = 0
    # Entries are read from their second number on, too, and as long.
    return np.concatenate([table.ravel(), np.zeros(PADDED)]).astype(dtype)


@lean
def _differ(before, after, scale, given):
    for i in range(given.size):
        given[i] = scale * (after[i] - before[i])


@lean
def bent(one, two, three):
    """The slope at an end, from the differences of the first four there: that of the cubic through them.

    Of a map that varies within a pixel or two, the others say little: they change the first by so much at most.
    """
    bend, most = one - np.float32(1.5) * two + np.float32(0.5) * three, np.float32(MOST_BEND)
    return one + min(max(bend, -most), most)


@lean
def _at(points, anchors, run, c, row, x, left, right):
    """A coordinate of a point of a run, or of one beside it, which has another anchor."""
    # Of a part of the last run, a column to the right may be its own.
    other = run - 1 if x < left else (min(run + 1, anchors.shape[0] - 1) if x >= right else run)
    return points[c, row, x] + np.float32(anchors[other, c] - anchors[run, c])


@lean
def _across(points, anchors, run, c, row, x, left, right):
    """What a coordinate changes by to the right, at the first or the last of a run's points."""
    width = points.shape[2]
    if width == 1:
        return np.float32(1.0 if c == 0 else 0.0)
    if 0 < x < width - 1:
        before = _at(points, anchors, run, c, row, x - 1, left, right)
        return np.float32(0.5) * (_at(points, anchors, run, c, row, x + 1, left, right) - before)
    on = 1 if x == 0 else -1
    here = _at(points, anchors, run, c, row, x, left, right)
    first = _at(points, anchors, run, c, row, x + on, left, right)
    if width < 4:
        return np.float32(on) * (first - here)
    second = _at(points, anchors, run, c, row, x + 2 * on, left, right)
    third = _at(points, anchors, run, c, row, x + 3 * on, left, right)
    return np.float32(on) * bent(first - here, second - first, third - second)


@lean
def slopes(points, beyond, anchors, run, c, row, left, n, across, down):
    """What a coordinate of a row's points changes by to the right, and downwards.

    These are central differences, at the picture's edges of what goes on as the cubic through four points does.
    """
    rows, right, half = points.shape[1], left + n, np.float32(0.5)
    above = points[c, row - 1, left:right] if row > 0 else beyond[0, c, left:right]
    below = points[c, row + 1, left:right] if row < rows - 1 else beyond[1, c, left:right]
    _differ(above, below, half, down[:n])
    if n <= 0:
        return
    here = points[c, row, left:right]
    _differ(here[:-2], here[2:], half, across[1 : n - 1])
    across[0] = _across(points, anchors, run, c, row, left, left, right)
    across[n - 1] = _across(points, anchors, run, c, row, right - 1, left, right)


@lean
def covariance(xx, xy, yx, yy):
    """C = M Mᵀ, and its eigenvalues."""
    a, b, c = xx * xx + xy * xy, xx * yx + xy * yy, yx * yx + yy * yy
    spread = math.sqrt((a - c) * (a - c) + np.float32(4.0) * b * b)
    return a, b, c, np.float32(0.5) * (a + c + spread), np.float32(0.5) * (a + c - spread)


@lean
def shrinking(most, fade):
    """How much of the average is taken, from 0 to 1, where the larger eigenvalue of C is this."""
    rise = np.float32(1.0 / (fade[1] - fade[0]))
    return min(max((most - np.float32(fade[0])) * rise, np.float32(0.0)), np.float32(1.0))


@lean
def _no_smaller_than_a_pixel(n, parts):
    """C' has the axes of C, and eigenvalues of 1 at least."""
    one, half = np.float32(1.0), np.float32(0.5)
    for i in range(n):
        a, b, c, most, least = covariance(parts[XX + i], parts[XY + i], parts[YX + i], parts[YY + i])
        inverse = one / (most - least + np.float32(1e-6))
        # How much of the major axis lies along x, and the cosine times the sine.
        upright, mixed = half * (one + (a - c) * inverse), b * inverse
        major, minor = max(most, one), max(least, one)
        parts[MAJOR + i], parts[MINOR + i] = major, minor
        parts[XX + i], parts[XY + i] = major * upright + minor * (one - upright), (major - minor) * mixed
        parts[YY + i] = minor * upright + major * (one - upright)


@lean
def _faded(n, fade, parts):
    """C' is C where the map shrinks, and fades to nothing where it does not."""
    for i in range(n):
        a, b, c, most, least = covariance(parts[XX + i], parts[XY + i], parts[YX + i], parts[YY + i])
        share = shrinking(most, fade)
        parts[XX + i], parts[XY + i], parts[YY + i] = a * share, b * share, c * share
        parts[MAJOR + i], parts[MINOR + i] = most * share, max(least, np.float32(0.0)) * share


@kernel
def footprints(points, beyond, anchors, run, row, left, n, mode, parts):
    """Describe the footprints of a row's pixels in ``parts``."""
    # M: ∂x/∂x into XX, ∂x/∂y into XY, ∂y/∂x into YX, and ∂y/∂y into YY.
    slopes(points, beyond, anchors, run, 0, row, left, n, parts[XX:], parts[XY:])
    slopes(points, beyond, anchors, run, 1, row, left, n, parts[YX:], parts[YY:])
    if mode == EWA:
        _no_smaller_than_a_pixel(n, parts)
    else:
        _faded(n, FADE_ANTIALIAS if mode == ANTIALIAS else FADE_AUTO, parts)


@kernel
def one_box_each(points, beyond, anchors, run, row, left, n, mode, parts):
    """Whether one box stands for the footprint of every pixel of a row; they are described as by `footprints`."""
    footprints(points, beyond, anchors, run, row, left, n, mode, parts)
    most, oblique, several = np.float32(WIDEST * WIDEST), np.float32(OBLIQUE), 0
    for i in range(n):
        upright = (parts[MAJOR + i] <= most) & (abs(parts[XY + i]) <= oblique)
        several += 0 if upright else 1
    return several == 0


@kernel
def _largest(points, beyond, anchors, run, row, left, n, mode, parts):
    footprints(points, beyond, anchors, run, row, left, n, mode, parts)
    largest, second = np.float32(0.0), np.float32(0.0)
    for i in range(n):
        largest, second = max(largest, parts[MAJOR + i]), max(second, parts[MINOR + i])
    return np.float64(largest), np.float64(second)


@kernel
def extremes(points, beyond, anchors, run, left, n, mode, parts):
    """About the largest σ₁'² and σ₂'² of a run, and half more: of every fourth row, and those between that differ.

    Under brushes of a few pixels there may be larger ones, which are cut to this.
    """
    rows = points.shape[1]
    largest, second, before = 0.0, 0.0, 0.0
    for k in range(0, rows + 3, 4):
        here, across = _largest(points, beyond, anchors, run, min(k, rows - 1), left, n, mode, parts)
        largest, second, here = max(largest, here), max(second, across), max(here, 1.0)
        if k > 0 and max(here, before) > 1.4 * min(here, before):
            for row in range(k - 3, min(k, rows)):
                above, beside = _largest(points, beyond, anchors, run, row, left, n, mode, parts)
                largest, second = max(largest, above), max(second, beside)
        before = here
    return 1.5 * largest, 1.5 * second
