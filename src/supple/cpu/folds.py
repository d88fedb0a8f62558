"""How close a stroke comes to folding where the border is fixed: a minimum over all points, bounded.

Let S = sym(J_β), of a force of length 1, and μ the smallest eigenvalue of S over the domain. Branch and
bound finds it, the box with the lowest bound first. In a box of widths h where β has no kink, the
multilinear interpolant of S from the corners v is a mean of the S(v), and differs from S by Σ_k h_k²/8
|∂_kk S| at most. As λ_min is concave,

    λ_min(S(p)) ≥ min_v λ_min(S(v) - D),  D diagonal with  xᵀ D x ≥ Σ_k h_k²/8 |xᵀ ∂_kk S(p) x|.

Let N_n bound the n-th derivatives of K in the box, and β_i be the sine of an angle of slope κ_i, or 1 where
κ_i = 0. From the derivatives of β_i K_i, |S| ≤ N1 + max κ_i N0, and

    |xᵀ ∂_kk S x| ≤ N3 |x|² + Σ_i κ_i N2 x_i² + (2κ_k N2 + κ_k² N1) |x_k| |x| + (2κ_k² N1 + κ_k³ N0) x_k².

K of 1, 2 and 3 scales is a constant times the zeroth, first and second divided difference, in e = ε², of

    U = (1-ω) ρ^-1 f + e/2 ρ^-3 f + ω ρ^-3 (r·f) r,    ω = b/a, ρ² = |r|² + e,

hence a mean of U, ∂U/∂e or ∂²U/∂e² / 2. As e = ρ² - |r|², these are, but for a constant, with q = k/(3-2ω),

    ρ^-k f - q ρ^-(k+2) [ |r|² f - 2ω (r·f) r ]
    = (1-q) ρ^-k f + q e ρ^-(k+2) f + 2ωq ρ^-(k+2) (r·f) r,    k = 1, 3, 5,

where little cancels any more: in the first line near the pivot, in the second far from it. The n-th derivative
of ρ^-k is a Gegenbauer polynomial of a cosine times |r|/ρ, over ρ^(k+n). As 2ω ≤ 1, the bracket and its two
derivatives are at most |r|², 2|r| and 2. What rounding can do to a bound is taken off it.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from supple.cpu.kernel import kernel

Floats = npt.NDArray[np.float64]

# Columns of a box's axis, ...
DISTANCE, DEPTH, WIDTH, AWAY, INWARD, KAPPA = range(6)
# ... of one of its two ends, ...
_PLACE, _BETA, _SLOPE = range(3)
# ... and of the numbers in ``limits``.
POWER, AMOUNT, BRACKET, LARGEST_E, NOISE, FREE = range(6)
# The diagonals: what a cut along one of the three axes would leave of D, D, and zeros.
_D, _NONE = 3, 4
# At a double root, the cosine formula for a cubic's roots loses half of the digits.
_CUBIC = 1e-7
_TINY = 1e-150
# A bound as bad as none, of which the square is still a number.
_HUGE = 1e100


@kernel
def _smallest(s, v, d, row):
    """The smallest eigenvalue of S(v) less a diagonal, or a little less; of S(v) itself, or a little more."""
    a, b, c = s[v, 0] - d[row, 0], s[v, 1] - d[row, 1], s[v, 2] - d[row, 2]
    xy, xz, yz = s[v, 3], s[v, 4], s[v, 5]
    if xz == 0.0 and yz == 0.0:
        return min(c, 0.5 * (a + b) - np.sqrt(0.25 * (a - b) * (a - b) + xy * xy))
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0) + _TINY
    a, b, c, xy, xz, yz = a / p, b / p, c / p, xy / p, xz / p, yz / p
    half = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - xz * yz) + xz * (xy * yz - b * xz))
    angle = np.arccos(min(max(half, -1.0), 1.0)) / 3.0
    return mean + p * (2.0 * np.cos(angle + 2.0 * np.pi / 3.0) + (_CUBIC if row == _NONE else -_CUBIC))


@kernel
def _strain(s, v, terms, force, active, ends, i, j, k):
    """S at a corner, into s[v]: xx, yy, zz, xy, xz, yz."""
    x, y, z = ends[0, i, _PLACE], ends[1, j, _PLACE], ends[2, k, _PLACE]
    bx, by, bz = ends[0, i, _BETA], ends[1, j, _BETA], ends[2, k, _BETA]
    fx, fy, fz = force[0], force[1], force[2]
    a, b, da, db = 0.0, 0.0, 0.0, 0.0
    r2 = x * x + y * y + z * z
    for m in range(terms.shape[0]):
        v2 = 1.0 / (r2 + terms[m, 0])
        v1 = np.sqrt(v2)
        v3 = v1 * v2
        p, q, r = terms[m, 1], terms[m, 2], terms[m, 3]
        a += p * v1 + q * v3
        b += r * v3
        da -= v3 * (p + 3.0 * q * v2)
        db -= 3.0 * r * v3 * v2
    rf = x * fx + y * fy + z * fz
    g, h = b * rf, db * rf
    cx, cy, cz = da * fx + h * x, da * fy + h * y, da * fz + h * z
    ex, ey, ez = b * x, b * y, b * z
    s[v, 0] = bx * (cx * x + ex * fx + g) + ends[0, i, _SLOPE] * (a * fx + g * x)
    s[v, 1] = by * (cy * y + ey * fy + g) + ends[1, j, _SLOPE] * (a * fy + g * y)
    s[v, 2] = bz * (cz * z + ez * fz + g) + ends[2, k, _SLOPE] * (a * fz + g * z)
    # Across an axis without extent there are no points that could fold.
    xy, xz, yz = 0.5 * active[0] * active[1], 0.5 * active[0] * active[2], 0.5 * active[1] * active[2]
    s[v, 3] = xy * (bx * (cx * y + ex * fy) + by * (cy * x + ey * fx))
    s[v, 4] = xz * (bx * (cx * z + ex * fz) + bz * (cz * x + ez * fx))
    s[v, 5] = yz * (by * (cy * z + ey * fz) + bz * (cz * y + ez * fy))


@kernel
def _put_ends(ends, boxes, item, active):
    for k in range(3):
        for end in range(2):
            t = end * boxes[item, k, WIDTH]
            kappa, inward, away = boxes[item, k, KAPPA], boxes[item, k, INWARD], boxes[item, k, AWAY]
            angle = kappa * (boxes[item, k, DEPTH] + inward * t)
            ends[k, end, _PLACE] = away * (boxes[item, k, DISTANCE] + t)
            ends[k, end, _BETA] = active[k] * (np.sin(angle) if kappa > 0.0 else 1.0)
            ends[k, end, _SLOPE] = active[k] * away * inward * kappa * np.cos(angle)


@kernel
def _derivatives(k, x):
    """Bounds of ρ^-k and its derivatives, times ρ^k, ρ^(k+1) and so on, where |r|/ρ is at most x."""
    c = k * (k + 2.0)
    y = min(x, 1.0 / np.sqrt(k + 4.0))
    third = max(c * y * (3.0 - (k + 4.0) * y * y), c * x * ((k + 4.0) * x * x - 3.0))
    return 1.0, k * x, max(k, c * x * x - k), third


@kernel
def _put_errors(d, boxes, item, active, e, limits):
    """The diagonals of a box. Returns a simple bound of μ in it, and what rounding may do to S."""
    near2, far2, steepest = 0.0, 0.0, 0.0
    for k in range(3):
        near, far = boxes[item, k, DISTANCE], boxes[item, k, DISTANCE] + boxes[item, k, WIDTH]
        near2 += near * near
        far2 += far * far
        steepest = max(steepest, boxes[item, k, KAPPA])
        d[_D, k] = 0.0
    r2, x = near2 + e, np.sqrt(far2 / (far2 + e))
    rho = np.sqrt(r2)
    power = limits[POWER]
    c = limits[AMOUNT] * (e / r2) ** (0.5 * power)
    p0, p1, p2, p3 = _derivatives(power, x)
    q0, q1, q2, q3 = _derivatives(power + 2.0, x)
    q, f = limits[BRACKET], min(limits[LARGEST_E] / r2, 1.0)
    b0, b1, b2 = x * x * q0, x * (x * q1 + 2.0 * q0), x * x * q2 + 4.0 * x * q1 + 2.0 * q0
    b3 = x * x * q3 + 6.0 * x * q2 + 6.0 * q1
    t, u, w = abs(1.0 - q), q * f, 3.0 * q - power
    n0 = c * min(p0 + q * b0, t * p0 + u * q0 + w * b0)
    n1 = c * min(p1 + q * b1, t * p1 + u * q1 + w * b1) / rho
    n2 = c * min(p2 + q * b2, t * p2 + u * q2 + w * b2) / r2
    n3 = c * min(p3 + q * b3, t * p3 + u * q3 + w * b3) / r2 / rho
    for k in range(3):
        kappa = boxes[item, k, KAPPA]
        share = 0.125 * boxes[item, k, WIDTH] * boxes[item, k, WIDTH]
        mixed = kappa * (2.0 * n2 + kappa * n1)
        own = mixed + kappa * kappa * (2.0 * n1 + kappa * n0)
        for i in range(3):
            # 4 |x_k| |x| ≤ |x|² + 4 x_k²
            part = n3 + boxes[item, i, KAPPA] * n2 + 0.25 * mixed + (own if i == k else 0.0)
            d[k, i] = min(share * part, _HUGE) * active[i]
            d[_D, i] += d[k, i]
    for k in range(3):
        for i in range(3):
            d[k, i] = d[_D, i] - 0.75 * d[k, i]
    least = -(n1 + steepest * n0) if steepest > 0.0 else max(-n1, limits[FREE])
    return least, limits[NOISE] / rho * (5.0 / rho + steepest)


@kernel
def _push(heap, keys, n, item):
    i = n
    while i > 0 and keys[heap[(i - 1) // 2]] > keys[item]:
        heap[i] = heap[(i - 1) // 2]
        i = (i - 1) // 2
    heap[i] = item


@kernel
def _pop(heap, keys, n):
    """The item with the smallest key of ``n``, taken out."""
    top, item = heap[0], heap[n - 1]
    i, child = 0, 1
    while child < n - 1:
        if child + 1 < n - 1 and keys[heap[child + 1]] < keys[heap[child]]:
            child += 1
        if keys[heap[child]] >= keys[item]:
            break
        heap[i] = heap[child]
        i, child = child, 2 * child + 1
    heap[i] = item
    return top


@kernel
def smallest_strain(terms, force, active, boxes, keys, heap, n, limits, upper, target, gap):
    """Bounds of μ over the first ``n`` boxes, and how many boxes it took.

    Parameters
    ----------
    terms : ndarray, shape (M, 4)
        Rows of radius², p, q and r of the stroke.
    force : ndarray, shape (3,)
        The drag's direction, a unit vector.
    active : ndarray, shape (3,)
        1.0 for an axis that the domain extends along, 0.0 for another.
    boxes : ndarray, shape (N, 3, 6)
        For each axis: DISTANCE from the pivot and DEPTH from the face, both at the end nearer to the pivot;
        WIDTH; AWAY, 1 or -1, the way that leads away from the pivot; INWARD, 1 or -1, how DEPTH changes on
        that way; and KAPPA. After ``n``, room for more: when it is full, the bounds are what they are.
    keys, heap : ndarray, shape (N,)
        Lower bounds in the boxes, and a heap of the boxes by them.
    limits : ndarray, shape (6,)
        POWER k; AMOUNT, the constant over ε^k; BRACKET q; LARGEST_E; NOISE, what rounding does; FREE, a lower
        bound of μ with a free border.
    upper : float
        An upper bound of μ, at most 0.
    target : float
        At most 0. A lower bound above it need not be close to the upper one.
    gap : float
        How close the bounds must come, as a part of the upper one.
    """
    ends, d, s = np.empty((3, 2, 3)), np.zeros((5, 3)), np.empty((8, 6))
    all_of_d = d.shape[0] - 2  # _D, but no literal: Numba compiles a function again for each of those
    made = n
    lower = 0.0
    while n > 0:
        item = _pop(heap, keys, n)
        n -= 1
        bound = keys[item]
        if bound >= min(target, upper * (1.0 + gap)) or made == boxes.shape[0]:
            lower = min(lower, bound)
            break
        least, noise = _put_errors(d, boxes, item, active, terms[0, 0], limits)
        _put_ends(ends, boxes, item, active)
        worst, at = 1e300, item
        for v in range(8):
            i, j, k = v & 1, (v >> 1) & 1, v >> 2
            if i <= active[0] and j <= active[1] and k <= active[2]:
                _strain(s, v, terms, force, active, ends, i, j, k)
                value = _smallest(s, v, d, all_of_d)
                if value < worst:
                    worst, at = value, v
        bound = max(bound, worst - noise)
        axis, best = 0, -1e300
        for row in range(5):
            value = _smallest(s, at, d, row)
            if row == _NONE:
                upper = min(upper, value + noise)
            elif row != _D and boxes[item, row, WIDTH] > 0.0 and value > best:
                axis, best = row, value
        # Not as a key: where it is the same for many boxes, it would not tell which one leads on.
        least = max(least, bound)
        if least >= min(target, upper * (1.0 + gap)) or noise > d[_D, 0] + d[_D, 1] + d[_D, 2]:
            lower = min(lower, least)
            continue
        for k in range(3):
            for column in range(6):
                boxes[made, k, column] = boxes[item, k, column]
        half = 0.5 * boxes[item, axis, WIDTH]
        boxes[item, axis, WIDTH], boxes[made, axis, WIDTH] = half, half
        boxes[made, axis, DISTANCE] += half
        boxes[made, axis, DEPTH] += half * boxes[made, axis, INWARD]
        for child in range(2):
            new = made if child else item
            keys[new] = bound
            _push(heap, keys, n, new)
            n += 1
        made += 1
    return lower, upper, made


def cells(extent: float, sigma: float, pivot: float) -> list[tuple[float, ...]]:
    """An axis cut where β has kinks and at the pivot, see `smallest_strain`."""
    if not (extent > 0 and sigma > 0):
        return [(abs(pivot), 0.0, 0.0, -math.copysign(1.0, pivot), 0.0, 0.0)]
    kappa = math.pi / 2 / sigma
    found: list[tuple[float, ...]] = []
    # Each side is measured from its own face, so that a border that is thin for the extent is still there.
    for low, high, p, sense, k in (
        (0.0, sigma, pivot, 1.0, kappa),
        (sigma, extent - sigma, pivot, 1.0, 0.0),
        (0.0, sigma, extent - pivot, -1.0, kappa),
    ):
        cuts = [low, p, high] if low < p < high else [low, high]
        for a, b in itertools.pairwise(cuts):
            if a < b:
                away = 1.0 if p <= a else -1.0
                start = a if p <= a else b
                found.append((abs(start - p), start, b - a, sense * away, away if k else 0.0, k))
    return found


def limits(terms: Floats, free: float) -> Floats:
    """The numbers that bound N_n, and rounding, see `smallest_strain`."""
    e, p, q, r = terms.T
    ratio = r[0] / (p[0] + r[0])
    power, amount = {1: (1, 1.0), 2: (3, 11 * 0.21 / 2), 3: (5, 14641 / 331 * 0.21 * 0.4641 * 3 / 8)}[len(terms)]
    noise = 1e-14 * float(np.sum(np.abs(p) + np.abs(r) + np.abs(q) / e))
    return np.array([power, amount, power / (3 - 2 * ratio), e[-1], noise, free])
