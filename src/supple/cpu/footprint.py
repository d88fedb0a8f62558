"""How much of the source an output pixel covers, and the weights of the samples there.

The footprint of a pixel is a parallelogram, the image of its square under M = ∂T⁻¹/∂q, which neighbouring source
points give. It is described by the covariance C = M Mᵀ, whose eigenvalues are the squares of M's singular values. A
footprint that is nearly upright is averaged exactly: the cubic interpolant, integrated over a box, is a sum of
samples whose weights separate, and are kept in a table of box widths and positions. A long or an oblique one is
made of several such boxes along its major axis, taken from a pyramid where even the minor one is long.
"""

from __future__ import annotations

import functools

import numpy as np

from supple.cpu.kernel import kernel
from supple.cpu.sample import WIDE

LINEAR, CUBIC, AUTO, ANTIALIAS, EWA = 0, 1, 2, 3, 4

# Rows of a run's scratch of float32, after PART_X and PART_Y: the points of the row and of those around it, with
# one more on either side; then σ₁'², σ₂'², C' (xx, xy, yy), and the box widths in steps of the table.
_ROW = WIDE + 2
HERE_X, HERE_Y = 2 * WIDE + 1, 2 * WIDE + 1 + _ROW
ABOVE_X, ABOVE_Y = 2 * WIDE + 2 * _ROW, 2 * WIDE + 3 * _ROW
BELOW_X, BELOW_Y = 2 * WIDE + 4 * _ROW, 2 * WIDE + 5 * _ROW
MAJOR, MINOR = 2 * WIDE + 6 * _ROW, 3 * WIDE + 6 * _ROW
XX, XY, YY = 4 * WIDE + 6 * _ROW, 5 * WIDE + 6 * _ROW, 6 * WIDE + 6 * _ROW
BOX_X, BOX_Y = 7 * WIDE + 6 * _ROW, 8 * WIDE + 6 * _ROW
PARTS = 9 * WIDE + 6 * _ROW

TAPS = 6  # samples along an axis under a box of up to two pixels, widened by the cubic
PLACES = 256  # positions between two samples
STEPS = 32  # box widths to a pixel
WIDEST = 2.0
OBLIQUE = 0.5  # an upright box stands for a footprint with less covariance than this


def _integral(t: np.ndarray) -> np.ndarray:
    """The integral of Catmull and Rom's kernel from 0 to t."""
    x = np.minimum(np.abs(t), 2.0)
    inner = x - 5 / 6 * x**3 + 3 / 8 * x**4
    outer = 2 * x - 2 * x**2 + 5 / 6 * x**3 - x**4 / 8 - 1 / 6
    return np.asarray(np.sign(t) * np.where(x <= 1, inner, outer))


@functools.cache
def weights(dtype: np.dtype[np.floating]) -> np.ndarray:
    """The table: for each box width and position, the weights of the samples -2 to 3, flat."""
    width = np.arange(int(WIDEST * STEPS) + 1)[:, None, None] / STEPS
    width = np.maximum(width, 1e-3)
    t = np.arange(TAPS)[None, None, :] - 2 - np.arange(PLACES + 1)[None, :, None] / PLACES
    table = (_integral(t + width / 2) - _integral(t - width / 2)) / width
    table /= table.sum(axis=-1, keepdims=True)
    return np.ascontiguousarray(table.astype(dtype).ravel())


@kernel
def _copy_row(points, c, row, left, n, parts, at):
    taken = points[c, row, left : left + n]
    for i in range(n):
        parts[at + i] = taken[i]


@kernel
def footprints(points, row, left, n, mode, parts):
    """Describe the footprints of a row's pixels in ``parts``."""
    rows = points.shape[1]
    above, below = max(row - 1, 0), min(row + 1, rows - 1)
    _copy_row(points, 0, row, left, n, parts, HERE_X)
    _copy_row(points, 1, row, left, n, parts, HERE_Y)
    _copy_row(points, 0, above, left, n, parts, ABOVE_X)
    _copy_row(points, 1, above, left, n, parts, ABOVE_Y)
    _copy_row(points, 0, below, left, n, parts, BELOW_X)
    _copy_row(points, 1, below, left, n, parts, BELOW_Y)
    one = np.float32(1.0)
    if n > 1:  # beyond its ends, the row goes on as it is there
        for at in (HERE_X, HERE_Y):
            parts[at - 1] = parts[at] + parts[at] - parts[at + 1]
            parts[at + n] = parts[at + n - 1] + parts[at + n - 1] - parts[at + n - 2]
    else:
        parts[HERE_X - 1], parts[HERE_X + 1] = parts[HERE_X] - one, parts[HERE_X] + one
        parts[HERE_Y - 1], parts[HERE_Y + 1] = parts[HERE_Y], parts[HERE_Y]
    single = one if rows == 1 else np.float32(0.0)
    scale = np.float32(1.0 / max(below - above, 1))
    half, zero = np.float32(0.5), np.float32(0.0)
    for i in range(n):
        xx = half * (parts[HERE_X + 1 + i] - parts[HERE_X - 1 + i])
        yx = half * (parts[HERE_Y + 1 + i] - parts[HERE_Y - 1 + i])
        xy = scale * (parts[BELOW_X + i] - parts[ABOVE_X + i])
        yy = scale * (parts[BELOW_Y + i] - parts[ABOVE_Y + i]) + single
        parts[XX + i], parts[XY + i], parts[YY + i] = xx * xx + xy * xy, xx * yx + xy * yy, yx * yx + yy * yy
    for i in range(n):
        a, b, c = parts[XX + i], parts[XY + i], parts[YY + i]
        spread = np.sqrt((a - c) * (a - c) + np.float32(4.0) * b * b)
        parts[MAJOR + i], parts[MINOR + i] = half * (a + c + spread), half * (a + c - spread)
        # How much of the major axis lies along x, and the cosine times the sine: C' has the axes of C.
        inverse = one / (spread + np.float32(1e-6))
        parts[BOX_X + i] = half * (one + (a - c) * inverse)
        parts[BOX_Y + i] = b * inverse
    if mode == EWA:
        for i in range(n):
            parts[MAJOR + i] = max(parts[MAJOR + i], one)
            parts[MINOR + i] = max(parts[MINOR + i], one)
    else:
        # The whole footprint, faded in so that no seam shows: for ANTIALIAS before the map begins to shrink, for AUTO
        # as it does, which leaves what is hardly shrunk as sharp as it was.
        start = np.float32(0.97 if mode == ANTIALIAS else 1.0)
        rise = one / np.float32(0.03 if mode == ANTIALIAS else 0.1)
        for i in range(n):
            shrinking = min(max((np.sqrt(parts[MAJOR + i]) - start) * rise, zero), one)
            parts[MAJOR + i] *= shrinking
            parts[MINOR + i] = max(parts[MINOR + i], zero) * shrinking
    for i in range(n):
        major, minor, upright = parts[MAJOR + i], parts[MINOR + i], parts[BOX_X + i]
        across = major * upright + minor * (one - upright)
        down = minor * upright + major * (one - upright)
        parts[XX + i], parts[XY + i], parts[YY + i] = across, (major - minor) * parts[BOX_Y + i], down
    for i in range(n):  # apart: together with the loop above, it would not vectorize
        parts[BOX_X + i] = np.sqrt(max(parts[XX + i], zero)) * np.float32(STEPS) + half
        parts[BOX_Y + i] = np.sqrt(max(parts[YY + i], zero)) * np.float32(STEPS) + half


@kernel
def extremes(points, left, n, mode, parts):
    """About the largest σ₁'² and σ₂'² of a run, from some of its rows, with a reserve for the others."""
    largest, second = 0.0, 0.0
    for k in range(0, points.shape[1] + 7, 8):
        footprints(points, min(k, points.shape[1] - 1), left, n, mode, parts)
        for i in range(n):
            largest = max(largest, np.float64(parts[MAJOR + i]))
            second = max(second, np.float64(parts[MINOR + i]))
    return 1.5 * largest, 1.5 * second
