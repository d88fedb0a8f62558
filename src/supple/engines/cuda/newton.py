"""T⁻¹ at a point, by one thread: Newton's method with backtracking, and a continuation if it fails.

Newton's step is δ = -(I+J)⁻¹ ξ for the residual ξ = T(p) - q. It is halved until the residual decreases.
"""

from __future__ import annotations

import math

from numba import cuda

from supple.engines.cuda.field import (
    DOMAIN,
    FIRST_FACE,
    LAST_FACE,
    SIGMA,
    SPACING,
    STROKE,
    Y_AXIS,
    Z_AXIS,
    first_of,
    moved,
    moved_with_matrix,
)
from supple.engines.cuda.kernel import device, kernel, lean

SMALLEST_LENGTH = 2.0**-24  # of a step, after which halving ends
DOWNHILL = 1e-4  # the fraction of its predicted decrease by which a step must reduce the residual

EXACT = 1e-9  # pixels: the largest last Newton step of a point
CONVERGED = 1e-6  # pixels: the largest residual of a converged point (`supple.Inverse`)


@lean
def kept_inside(x, q, first, last, sigma):
    """Return a coordinate moved to its target's side of a fixed face, since a face maps to itself."""
    if sigma < 0.0:
        return x
    return q if q <= first or q >= last else min(max(x, first), last)


@lean
def next_step(a, b, c, d, e, f, g, h, k, ex, ey, ez):
    """Return Newton's step for the matrix I+J, row by row, and the residual ξ."""
    ca, cb, cc = e * k - f * h, f * g - d * k, d * h - e * g
    scale = -1.0 / (a * ca + b * cb + c * cc)
    return (
        scale * (ca * ex + (c * h - b * k) * ey + (b * f - c * e) * ez),
        scale * (cb * ex + (a * k - c * g) * ey + (c * d - a * f) * ez),
        scale * (cc * ex + (b * g - a * h) * ey + (a * e - b * d) * ez),
    )


@lean
def downhill(error, before, length):
    """Return whether a fraction of Newton's step decreased the squared residual enough."""
    return error <= before * (1.0 - DOWNHILL * length)


@device
def inside(known, at, x, y, z, qx, qy, qz):
    """Return a point moved to its target's side of fixed faces."""
    j, k = at + Y_AXIS, at + Z_AXIS
    x = kept_inside(x, qx, known[at + FIRST_FACE], known[at + LAST_FACE], known[at + SIGMA])
    y = kept_inside(y, qy, known[j + FIRST_FACE], known[j + LAST_FACE], known[j + SIGMA])
    z = kept_inside(z, qz, known[k + FIRST_FACE], known[k + LAST_FACE], known[k + SIGMA])
    return x, y, z


@device
def newton(known, at, first, last, qx, qy, qz, x, y, z, tolerance, limit):
    """Solve T(p) = q from a guess.

    Returns the point, the square of |T(p) - q| where the last step began, whether that step was shorter than the
    tolerance, how often T was evaluated, and its Jacobian, row by row.
    """
    px, py, pz = x, y, z
    dx, dy, dz = 0.0, 0.0, 0.0
    length, norm, done, steps = 1.0, 1e300, False, 0
    a, b, c, d, e, f, g, h, k = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    for _ in range(limit):
        x, y, z = inside(known, at, px + length * dx, py + length * dy, pz + length * dz, qx, qy, qz)
        tx, ty, tz, ma, mb, mc, md, me, mf, mg, mh, mk = moved_with_matrix(known, at, first, last, x, y, z)
        ex, ey, ez = tx - qx, ty - qy, tz - qz
        error = ex * ex + ey * ey + ez * ez
        steps += 1
        if downhill(error, norm, length):
            px, py, pz, norm, length = x, y, z, error, 1.0
            a, b, c, d, e, f, g, h, k = ma, mb, mc, md, me, mf, mg, mh, mk
            dx, dy, dz = next_step(a, b, c, d, e, f, g, h, k, ex, ey, ez)
            if dx * dx + dy * dy + dz * dz <= tolerance * tolerance:
                done = True
                break
        else:
            length *= 0.5
            if length <= SMALLEST_LENGTH:
                break
    if done:  # the last, short step is known, and applied
        px, py, pz = inside(known, at, px + dx, py + dy, pz + dz, qx, qy, qz)
    return px, py, pz, norm, done, steps, a, b, c, d, e, f, g, h, k


@device
def followed(known, at, first, last, qx, qy, qz, tolerance):
    """Return T⁻¹ of strokes that act at once, by continuation along the line from T(p) to q."""
    sx, sy, sz = moved(known, at, first, last, qx, qy, qz)
    px, py, pz = qx, qy, qz
    way, stride, spent = 0.0, 0.5, 0
    while way < 1.0 and stride > 1e-9:
        t = min(1.0, way + stride)
        x, y, z, _, done, steps, _, _, _, _, _, _, _, _, _ = newton(
            known, at, first, last,
            sx + t * (qx - sx), sy + t * (qy - sy), sz + t * (qz - sz),
            px, py, pz, tolerance, 12,
        )  # fmt: skip
        spent += steps
        if done:
            px, py, pz, way = x, y, z, t
            stride *= 2.0
        else:
            stride *= 0.5
    return px, py, pz, way >= 1.0, spent


@device
def undo(known, at, first, last, qx, qy, qz, tolerance):
    """Return T⁻¹ without a guess, as from `newton`: what acts at once undone from last to first, then polished."""
    x, y, z, norm, done = qx, qy, qz, 0.0, True
    a, b, c, d, e, f, g, h, k = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    spent = 0
    end = last
    while end > first:
        s = first_of(known, first, end - STROKE)
        gx, gy, gz = x, y, z
        x, y, z, norm, done, steps, a, b, c, d, e, f, g, h, k = newton(
            known, at, s, end, gx, gy, gz, gx, gy, gz, tolerance, 40
        )
        spent += steps
        if not done:
            fx, fy, fz, arrived, steps = followed(known, at, s, end, gx, gy, gz, tolerance)
            spent += steps
            if arrived:
                x, y, z = fx, fy, fz
                if s == first and end == last:  # its Jacobian and residual are known
                    x, y, z, norm, done, steps, a, b, c, d, e, f, g, h, k = newton(
                        known, at, s, end, gx, gy, gz, x, y, z, tolerance, 8
                    )
                    spent += steps
        end = s
    if first_of(known, first, last - STROKE) > first:
        x, y, z, norm, done, steps, a, b, c, d, e, f, g, h, k = newton(
            known, at, first, last, qx, qy, qz, x, y, z, tolerance, 8
        )
        spent += steps
    return x, y, z, norm, done, spent, a, b, c, d, e, f, g, h, k


@device
def settle(known, at, first, last, qx, qy, qz, x, y, z, tolerance, limit):
    """Return T⁻¹ from a guess, as from `newton`; without it, if it was not good enough."""
    found = newton(known, at, first, last, qx, qy, qz, x, y, z, tolerance, limit)
    if found[4]:
        return found
    return undo(known, at, first, last, qx, qy, qz, tolerance)


@kernel
def inverse(known, spans, ndim, targets, finest, points, residual, steps, converged):
    """Compute T⁻¹ of points (N * ndim numbers, in pixels), residuals in pixels, evaluations, and convergence.

    ``finest`` is the least spacing.
    """
    i = cuda.grid(1)
    o = i * ndim
    if o >= targets.size:
        return
    sx, sy, sz = known[SPACING], known[Y_AXIS + SPACING], known[Z_AXIS + SPACING]
    first, last = DOMAIN + STROKE * spans[0], DOMAIN + STROKE * spans[1]
    qx, qy, qz = float(targets[o]) * sx, float(targets[o + 1]) * sy, 0.0
    if ndim == 3:
        qz = float(targets[o + 2]) * sz
    x, y, z, _, _, spent, _, _, _, _, _, _, _, _, _ = undo(known, 0, first, last, qx, qy, qz, EXACT * finest)
    points[o], points[o + 1] = x / sx, y / sy
    if ndim == 3:
        points[o + 2] = z / sz
    # The residual is measured again, at the returned point.
    x, y, z = moved(known, 0, first, last, x, y, z)
    ex, ey, ez = x - qx, y - qy, z - qz
    off = math.sqrt(ex * ex + ey * ey + ez * ez) / finest
    residual[i] = off
    steps[i] = spent
    scale = max(abs(qx), max(abs(qy), abs(qz))) / finest
    converged[i] = 1 if off <= max(CONVERGED, 1e-14 * scale) else 0
