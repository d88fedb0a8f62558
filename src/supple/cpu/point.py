"""The field and Newton's method at one point, in plain numbers: what batches on the CPU and threads on a card share.

See `supple.cpu.field` for the equations, and `supple.cpu.newton` for the method.
"""

from __future__ import annotations

import math

from supple.cpu.kernel import lean

HALF_PI = math.pi / 2

SMALLEST_LENGTH = 2.0**-24  # of a step: halved as often, it leads nowhere
DOWNHILL = 1e-4  # of what a step promises to take off a residual, it must


@lean
def sine(x):
    # Taylor's series: to the last bit on [0, π/2], and it vectorizes, which the library's sine does not.
    t = x * x
    y = -1.9572941063391263e-20
    y = y * t + 8.2206352466243295e-18
    y = y * t - 2.8114572543455206e-15
    y = y * t + 7.6471637318198164e-13
    y = y * t - 1.6059043836821613e-10
    y = y * t + 2.5052108385441720e-08
    y = y * t - 2.7557319223985893e-06
    y = y * t + 1.9841269841269841e-04
    y = y * t - 8.3333333333333332e-03
    y = y * t + 1.6666666666666666e-01
    return x - x * t * y


@lean
def faded(x, extent, sigma):
    """What a fixed border, ``sigma`` > 0 wide, makes of a coordinate: β, β', the nearest one inside, and 1 if own."""
    scale = HALF_PI / sigma
    v = min(max(x, 0.0), extent)
    angle = min(min(v, extent - v), sigma) * scale
    slope = (scale if v + v < extent else -scale) * sine(HALF_PI - angle)
    return sine(angle), slope, v, 1.0 if v == x else 0.0


@lean
def profile(r2, e, p, q, r):
    """A, B, 2A' and 2B' of a term of a stroke, at the square of the distance to the pivot."""
    v2 = 1.0 / (r2 + e)
    v = math.sqrt(v2)
    v3 = v * v2
    return p * v + q * v3, r * v3, -v3 * (p + 3.0 * q * v2), -3.0 * r * v3 * v2


@lean
def displacement(dx, dy, dz, fx, fy, fz, a, b):
    """K = A f + B (r·f) r."""
    g = b * (dx * fx + dy * fy + dz * fz)
    return a * fx + g * dx, a * fy + g * dy, a * fz + g * dz


@lean
def gradient(dx, dy, dz, fx, fy, fz, b, da, db):
    """J, row by row: of row i, (2A' f_i + 2B' (r·f) r_i) rᵀ + B r_i fᵀ + B (r·f) e_iᵀ."""
    rf = dx * fx + dy * fy + dz * fz
    g, h = b * rf, db * rf
    cx, cy, cz = da * fx + h * dx, da * fy + h * dy, da * fz + h * dz
    ex, ey, ez = b * dx, b * dy, b * dz
    return (
        cx * dx + ex * fx + g,
        cx * dy + ex * fy,
        cx * dz + ex * fz,
        cy * dx + ey * fx,
        cy * dy + ey * fy + g,
        cy * dz + ey * fz,
        cz * dx + ez * fx,
        cz * dy + ez * fy,
        cz * dz + ez * fz + g,
    )


@lean
def kept_inside(x, q, extent):
    """A coordinate where a face is fixed: it maps to itself, and beyond it nothing moves across."""
    return q if q <= 0.0 or q >= extent else min(max(x, 0.0), extent)


@lean
def inverted(a, b, c, d, e, f, g, h, k):
    """The inverse of a matrix, row by row."""
    ca, cb, cc = e * k - f * h, f * g - d * k, d * h - e * g
    t = 1.0 / (a * ca + b * cb + c * cc)
    return (
        t * ca,
        t * (c * h - b * k),
        t * (b * f - c * e),
        t * cb,
        t * (a * k - c * g),
        t * (c * d - a * f),
        t * cc,
        t * (b * g - a * h),
        t * (a * e - b * d),
    )


@lean
def next_step(a, b, c, d, e, f, g, h, k, ex, ey, ez):
    """Newton's δ = -(I+J)⁻¹ ξ, of the matrix I+J, row by row, and the residual ξ."""
    ca, cb, cc = e * k - f * h, f * g - d * k, d * h - e * g
    scale = -1.0 / (a * ca + b * cb + c * cc)
    return (
        scale * (ca * ex + (c * h - b * k) * ey + (b * f - c * e) * ez),
        scale * (cb * ex + (a * k - c * g) * ey + (c * d - a * f) * ez),
        scale * (cc * ex + (b * g - a * h) * ey + (a * e - b * d) * ez),
    )


@lean
def downhill(error, before, length):
    """Whether a part of Newton's step led far enough down, by the squares of the residuals."""
    return error <= before * (1.0 - DOWNHILL * length)
