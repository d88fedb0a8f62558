"""An oracle for inverses of sampled fields, which shares nothing with the core: evaluation, Newton, and exhaustion.

All of it is in indices of the field, x first. A field of two axes is one of three with a last axis of one sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from supple.fields import Field, Inverted

Floats = npt.NDArray[np.float64]
FINE, NONE, OFF, LOOSE, MARGIN, TURNED, FOLDED, SEVERAL = range(8)
VERDICTS = (
    "within the error",
    "without a solution nearby",
    "farther from the solution than the error",
    "farther from the solution than the tolerance",
    "with a solution beyond the grid",
    "with a solution that folds",
    "that what folds is mapped to",
    "with another solution",
)
MOST = 64  # solutions of one sample that are collected
MOST_SUSPECTS = 5000  # of a case, which are searched for their solutions


@dataclass(frozen=True)
class Model:
    """A field in indices: coefficients (z, y, x, 3) along the index axes, and the ranges in which they hold."""

    values: Floats
    cubic: bool
    ndim: int
    first: Floats
    last: Floats
    margin: float
    zero: bool
    to_place: Floats  # (3, 3)
    grain: float  # the rounding of the coefficients

    @classmethod
    def of(cls, field: Field) -> Model:
        n = field.ndim
        linear = np.linalg.inv(field.grid.matrix[:n, :n])
        given = field.values.astype(np.float64)
        grain = 0.0
        if field.interpolation == "cubic":
            for axis in range(n):
                if given.shape[axis] > 1:
                    given = ndimage.spline_filter1d(given, 3, axis, mode="mirror")
            if field.values.dtype == np.float32:
                grain = 2.4e-7 * float(np.abs(given).max()) * float(np.abs(linear).sum(axis=1).max())
        made = np.zeros((1,) * (3 - n) + (*given.shape[:-1], 3))
        made[..., :n] = given @ linear.T
        own = field.interpolation == "bspline"
        first, last, place = np.zeros(3), np.zeros(3), np.eye(3)
        first[:n] = 1.0 if own else 0.0
        last[:n] = np.array(field.grid.sizes) - (2.0 if own else 1.0)
        place[:n, :n] = field.grid.matrix[:n, :n]
        cubic = field.interpolation != "linear"
        return cls(made, cubic, n, first, last, 1e-6 if own else 0.5, field.beyond == "zero", place, grain)

    @property
    def packed(self) -> tuple[Any, ...]:
        return self.values, self.cubic, self.ndim, self.first, self.last


@numba.njit(cache=True)
def mirror(k: int, n: int) -> int:
    if n == 1:
        return 0
    period = 2 * (n - 1)
    k = k % period
    return period - k if k >= n else k


@numba.njit(cache=True)
def weights(f: float, cubic: bool, w: Any) -> None:
    """Fill w[derivative][tap]."""
    if not cubic:
        w[0, 0], w[0, 1], w[1, 0], w[1, 1] = 1 - f, f, -1.0, 1.0
        return
    w[0, 0] = (1 - f) ** 3 / 6
    w[0, 1] = (3 * f**3 - 6 * f**2 + 4) / 6
    w[0, 2] = (-3 * f**3 + 3 * f**2 + 3 * f + 1) / 6
    w[0, 3] = f**3 / 6
    w[1, 0] = -0.5 * (1 - f) ** 2
    w[1, 1] = (9 * f**2 - 12 * f) / 6
    w[1, 2] = (-9 * f**2 + 6 * f + 3) / 6
    w[1, 3] = 0.5 * f**2


@numba.njit(cache=True)
def cell_of(p: Any, ndim: int, first: Any, last: Any, cell: Any) -> None:
    """The cell of an index; first - 1 and last are the cells beyond the ends."""
    for d in range(ndim):
        if p[d] < first[d]:
            cell[d] = int(first[d]) - 1
        elif p[d] > last[d] or last[d] == first[d]:
            cell[d] = int(last[d])
        else:
            cell[d] = min(int(p[d]), int(last[d]) - 1)


@numba.njit(cache=True)
def evaluate(
    values: Any,
    cubic: bool,
    ndim: int,
    first: Any,
    last: Any,
    cell: Any,
    p: Any,
    out: Any,
    jac: Any,
    wx: Any,
    wy: Any,
    wz: Any,
) -> None:
    """out = p + w(p) by the polynomial of a cell, jac[a, b] = ∂out_a/∂p_b."""
    taps = 4 if cubic else 2
    left = 1 if cubic else 0
    at0, at1, at2 = 0, 0, 0
    pin0, pin1, pin2 = False, False, False
    for d in range(ndim):
        c = cell[d]
        pinned = False
        if c < first[d]:
            whole, f, pinned = int(first[d]), 0.0, True
        elif c >= last[d]:
            whole, f, pinned = int(last[d]), 0.0, True
        else:
            whole, f = c, p[d] - c
        if d == 0:
            weights(f, cubic, wx)
            at0, pin0 = whole, pinned
        elif d == 1:
            weights(f, cubic, wy)
            at1, pin1 = whole, pinned
        else:
            weights(f, cubic, wz)
            at2, pin2 = whole, pinned
    nz, ny, nx = values.shape[0], values.shape[1], values.shape[2]
    for a in range(3):
        out[a] = p[a]
        for b in range(3):
            jac[a, b] = 1.0 if a == b else 0.0
    for k in range(taps if ndim == 3 else 1):
        z = mirror(at2 + k - left, nz) if ndim == 3 else 0
        z0 = wz[0, k] if ndim == 3 else 1.0
        z1 = wz[1, k] if ndim == 3 else 0.0
        for j in range(taps):
            y = mirror(at1 + j - left, ny)
            zy, zy_y, zy_z = z0 * wy[0, j], z0 * wy[1, j], z1 * wy[0, j]
            for i in range(taps):
                x = mirror(at0 + i - left, nx)
                w0 = zy * wx[0, i]
                g0 = 0.0 if pin0 else zy * wx[1, i]
                g1 = 0.0 if pin1 else zy_y * wx[0, i]
                g2 = 0.0 if pin2 else zy_z * wx[0, i]
                for a in range(ndim):
                    v = values[z, y, x, a]
                    out[a] += w0 * v
                    jac[a, 0] += g0 * v
                    jac[a, 1] += g1 * v
                    jac[a, 2] += g2 * v


@numba.njit(cache=True)
def inverse3(m: Any, r: Any) -> float:
    """Write the inverse of a matrix, and return the determinant; a singular one has none."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if det == 0.0:
        return 0.0
    s = 1.0 / det
    r[0, 0], r[1, 0], r[2, 0] = c00 * s, c01 * s, c02 * s
    r[0, 1] = (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) * s
    r[1, 1] = (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) * s
    r[2, 1] = (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) * s
    r[0, 2] = (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) * s
    r[1, 2] = (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) * s
    r[2, 2] = (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) * s
    return float(det)


@numba.njit(cache=True)
def grade(place: Any, ndim: int, p: Any, q: Any, error: float, tolerance: float, slack: float) -> int:
    """Compare the way from a returned index p to the solution q with the claims."""
    d2 = mm2 = reach = 0.0
    for a in range(ndim):
        d2 += (q[a] - p[a]) ** 2
        s = 0.0
        for b in range(ndim):
            s += place[a, b] * (q[b] - p[b])
            reach += place[a, b] ** 2
        mm2 += s * s
    if np.sqrt(mm2) > error * (1 + 1e-6) + slack * np.sqrt(reach):
        return OFF
    return LOOSE if np.sqrt(d2) > tolerance * (1 + 1e-6) + slack else FINE


@numba.njit(cache=True, nogil=True)
def check_solves(
    values: Any,
    cubic: bool,
    ndim: int,
    first: Any,
    last: Any,
    margin: float,
    zero: bool,
    place: Any,
    grain: float,
    targets: Any,
    moved: Any,
    error: Any,
    status: Any,
    tolerance: float,
    scale: float,
    verdict: Any,
) -> None:
    """Continue Newton's method from every result that is called ok. NONE and OFF are suspects, not yet convicted."""
    p, q, out, jac, inv = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    wx, wy, wz = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4))
    cell, step = np.zeros(3, np.int64), np.zeros(3)
    for n in range(len(status)):
        verdict[n] = FINE
        if status[n] != 0:
            continue
        size, stays, inside = scale, True, True
        for d in range(ndim):
            p[d] = q[d] = targets[n, d] + moved[n, d]
            size += abs(targets[n, d]) + abs(moved[n, d])
            stays = stays and moved[n, d] == 0.0
            inside = inside and first[d] - margin <= targets[n, d] <= last[d] + margin
        if zero and not inside and stays:  # there is no displacement
            continue
        known, slack = False, 0.0
        for _ in range(30):
            cell_of(q, ndim, first, last, cell)
            evaluate(values, cubic, ndim, first, last, cell, q, out, jac, wx, wy, wz)
            det = inverse3(jac, inv)
            if det == 0.0:
                break
            e2 = s2 = norm = 0.0
            for a in range(ndim):
                e2 += (out[a] - targets[n, a]) ** 2
                step[a] = 0.0
                for b in range(ndim):
                    step[a] -= inv[a, b] * (out[b] - targets[n, b])
                    norm += inv[a, b] ** 2
                s2 += step[a] ** 2
            slack = (1e-14 * size + grain) * (1.0 + 2.0 * np.sqrt(norm))
            if e2 <= (4e-15 * size) ** 2 or s2 <= slack * slack:
                known = True
                break
            if s2 > 1e6 or s2 != s2:
                break
            for a in range(ndim):
                q[a] += step[a]
        if not known:
            verdict[n] = NONE
            continue
        verdict[n] = grade(place, ndim, p, q, error[n], tolerance, slack)
        if verdict[n] == FINE and det <= 0.0:
            verdict[n] = TURNED
        if zero and verdict[n] == FINE:
            for d in range(ndim):
                if not first[d] - margin - 1e-9 - slack <= q[d] <= last[d] + margin + 1e-9 + slack:
                    verdict[n] = MARGIN


@numba.njit(cache=True)
def bounds_of_cells(values: Any, cubic: bool, ndim: int, first: Any, last: Any, low: Any, high: Any, bend: Any) -> None:
    """For each cell, those beyond the ends included: the range of w, and bounds of its second derivatives."""
    taps = 4 if cubic else 2
    left = 1 if cubic else 0
    t = np.zeros((4, 4, 4))
    pinned = np.zeros(3, np.bool_)
    for z in range(low.shape[0]):
        for y in range(low.shape[1]):
            for x in range(low.shape[2]):
                at = (x, y, z)
                base = np.zeros(3, np.int64)
                for d in range(ndim):
                    c = at[d] + int(first[d]) - 1
                    pinned[d] = c < first[d] or c >= last[d]
                    base[d] = min(max(c, int(first[d])), int(last[d]))
                for a in range(ndim):
                    lo, hi = np.inf, -np.inf
                    for k in range(taps if ndim == 3 else 1):
                        for j in range(taps):
                            for i in range(taps):
                                v = values[
                                    mirror(base[2] + k - left, values.shape[0]) if ndim == 3 else 0,
                                    mirror(base[1] + j - left, values.shape[1]),
                                    mirror(base[0] + i - left, values.shape[2]),
                                    a,
                                ]
                                t[k, j, i] = v
                                lo, hi = min(lo, v), max(hi, v)
                    low[z, y, x, a], high[z, y, x, a] = lo, hi
                    for b in range(ndim):
                        for c in range(ndim):
                            most = 0.0
                            if not pinned[b] and not pinned[c] and (b != c or cubic):
                                reach = [0, 0, 0]
                                reach[b] += 1
                                reach[c] += 1
                                for k in range((taps if ndim == 3 else 1) - reach[2]):
                                    for j in range(taps - reach[1]):
                                        for i in range(taps - reach[0]):
                                            bi, bj, bk = int(b == 0), int(b == 1), int(b == 2)
                                            ci, cj, ck = int(c == 0), int(c == 1), int(c == 2)
                                            s = (
                                                t[k + bk + ck, j + bj + cj, i + bi + ci]
                                                - t[k + bk, j + bj, i + bi]
                                                - t[k + ck, j + cj, i + ci]
                                                + t[k, j, i]
                                            )
                                            most = max(most, abs(s))
                            bend[z, y, x, a, b, c] = most


@numba.njit(cache=True, nogil=True)
def solve_all(
    values: Any,
    cubic: bool,
    ndim: int,
    first: Any,
    last: Any,
    margin: float,
    zero: bool,
    low: Any,
    high: Any,
    bend: Any,
    target: Any,
    region: Any,
    found: Any,
    dets: Any,
    stack: Any,
) -> tuple[int, int]:
    """Collect all solutions in a region (low, high) by bisection, and count the boxes that remain undecided.

    A box is dropped if the mean value form excludes the target, or settled if it also proves that the map is one to
    one there: Newton's method then finds the one solution, or that there is none.
    """
    out, jac, inv = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    wx, wy, wz = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4))
    mid, half, rest, q = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    cell, from_, to = np.zeros(3, np.int64), np.zeros(3, np.int64), np.ones(3, np.int64)
    count = unknown = 0
    span = np.zeros((3, 2))
    for d in range(ndim):
        span[d, 0], span[d, 1] = region[0, d], region[1, d]
        if zero:
            span[d, 0] = max(span[d, 0], first[d] - margin)
            span[d, 1] = min(span[d, 1], last[d] + margin)
        if span[d, 0] > span[d, 1]:
            return 0, 0
        from_[d] = max(0, min(int(np.floor(span[d, 0] - first[d])) + 1, low.shape[2 - d] - 1))
        to[d] = max(0, min(int(np.floor(span[d, 1] - first[d])) + 1, low.shape[2 - d] - 1)) + 1
    for cz in range(from_[2], to[2]):
        for cy in range(from_[1], to[1]):
            for cx in range(from_[0], to[0]):
                at = (cx, cy, cz)
                possible = True
                for d in range(ndim):
                    cell[d] = at[d] + int(first[d]) - 1
                    a, b = float(cell[d]), float(cell[d] + 1)
                    if cell[d] < first[d]:
                        a, b = -np.inf, first[d]
                    elif cell[d] >= last[d]:
                        a, b = last[d], np.inf
                    a, b = max(a, span[d, 0]), min(b, span[d, 1])
                    if a > b or target[d] < a + low[cz, cy, cx, d] - 1e-9 or target[d] > b + high[cz, cy, cx, d] + 1e-9:
                        possible = False
                        break
                    stack[0, 0, d], stack[0, 1, d] = a, b
                if not possible:
                    continue
                depth = 1
                boxes = 0
                while depth > 0:
                    depth -= 1
                    boxes += 1
                    if boxes > 20000:
                        unknown += 1
                        break
                    for d in range(ndim):
                        mid[d] = 0.5 * (stack[depth, 0, d] + stack[depth, 1, d])
                        half[d] = 0.5 * (stack[depth, 1, d] - stack[depth, 0, d])
                    evaluate(values, cubic, ndim, first, last, cell, mid, out, jac, wx, wy, wz)
                    drop = False
                    for a in range(ndim):
                        reach = 1e-12 * (1 + abs(out[a]))
                        for b in range(ndim):
                            rest[a, b] = 0.0
                            for c in range(ndim):
                                rest[a, b] += bend[cz, cy, cx, a, b, c] * half[c]
                            reach += (abs(jac[a, b]) + rest[a, b]) * half[b]
                        drop = drop or abs(out[a] - target[a]) > reach
                    if drop:
                        continue
                    det = inverse3(jac, inv)
                    if abs(det) > 1e-13:
                        worst = 0.0
                        for a in range(ndim):
                            row = off = 0.0
                            reach = half[a] + 1e-9
                            for b in range(ndim):
                                off += inv[a, b] * (out[b] - target[b])
                                for c in range(ndim):
                                    row += abs(inv[a, c]) * rest[c, b]
                                    reach += abs(inv[a, c]) * rest[c, b] * half[b]
                            worst = max(worst, row)
                            drop = drop or abs(off) > reach
                        if drop:
                            continue
                        if worst < 0.7:
                            for d in range(ndim):
                                q[d] = mid[d]
                            for _ in range(60):
                                s2 = 0.0
                                for a in range(ndim):
                                    step = 0.0
                                    for b in range(ndim):
                                        step -= inv[a, b] * (out[b] - target[b])
                                    q[a] += step
                                    s2 += step * step
                                if s2 > 1e4 or s2 < 1e-28:
                                    break
                                evaluate(values, cubic, ndim, first, last, cell, q, out, jac, wx, wy, wz)
                                det = inverse3(jac, inv)
                                if det == 0.0:
                                    break
                            good = s2 < 1e-20
                            for d in range(ndim):
                                good = good and abs(q[d] - mid[d]) <= half[d] + 1e-9
                            if good and count < found.shape[0]:
                                for d in range(ndim):
                                    found[count, d] = q[d]
                                dets[count] = det
                                for d in range(ndim):  # at a face of its cell, the sign of the fold is not decided
                                    face = min(abs(q[d] - cell[d]), abs(q[d] - cell[d] - 1))
                                    if zero:
                                        face = min(face, abs(min(q[d] - first[d], last[d] - q[d]) + margin))
                                    if face < 1e-7:
                                        dets[count] = 0.0
                                count += 1
                            continue
                    axis, widest = 0, 0.0
                    for d in range(ndim):
                        if half[d] > widest:
                            axis, widest = d, half[d]
                    if widest < 1e-9 or depth + 2 > stack.shape[0]:
                        unknown += 1
                        continue
                    for d in range(ndim):
                        for e in range(2):
                            stack[depth + 1, e, d] = stack[depth, e, d]
                    stack[depth, 1, axis] = stack[depth + 1, 0, axis] = mid[axis]
                    depth += 2
    return count, unknown


@dataclass
class Verdicts:
    """What became of the samples that were called ok."""

    ok: int
    searched: int
    undecided: int
    wrong: list[tuple[int, int, str]]  # (the sample's flat index, verdict, explanation)


def check(field: Field, found: Inverted, tolerance: float, search: npt.NDArray[np.intp]) -> Verdicts:
    """Check every sample called ok by Newton's method, and search exhaustively for some, and for the suspects."""
    model, n, grid = Model.of(field), field.ndim, found.field.grid
    to_index = np.linalg.inv(field.grid.matrix) @ grid.matrix
    index = np.indices(grid.shape).reshape(n, -1)[::-1].T.astype(np.float64)
    targets = np.ascontiguousarray(index @ to_index[:n, :n].T + to_index[:n, n])
    linear = np.linalg.inv(field.grid.matrix[:n, :n])
    moved = np.ascontiguousarray(found.field.values.reshape(-1, n).astype(np.float64) @ linear.T)
    status, error = found.status.ravel(), found.error.ravel().astype(np.float64)
    verdict = np.zeros(status.size, np.int64)
    scale = 1.0 + float(np.abs(linear @ np.array(field.grid.origin)).max())
    scale += float(np.abs(linear @ np.array(grid.origin)).max())
    check_solves(
        *model.packed, model.margin, model.zero, model.to_place, model.grain, targets, moved, error, status, tolerance,
        scale, verdict,
    )  # fmt: skip
    suspects = np.flatnonzero((verdict == NONE) | (verdict == OFF) | (verdict == TURNED))
    wrong = [(int(k), int(verdict[k]), "") for k in np.flatnonzero((verdict == LOOSE) | (verdict == MARGIN))]
    search = search[status[search] == 0]
    if not len(suspects) and not len(search):
        return Verdicts(int((status == 0).sum()), 0, 0, wrong)
    sizes = [int(model.last[d] - model.first[d]) + 2 if d < n else 1 for d in range(3)][::-1]
    low, high, bend = np.zeros((*sizes, 3)), np.zeros((*sizes, 3)), np.zeros((*sizes, 3, 3, 3))
    bounds_of_cells(*model.packed, low, high, bend)
    most = np.maximum(np.abs(low), np.abs(high)).reshape(-1, 3).max(axis=0)
    solutions, dets, stack = np.zeros((MOST, 3)), np.zeros(MOST), np.zeros((400, 2, 3))
    undecided = 0

    def searched(k: int, region: Floats) -> tuple[int, int]:
        goal = np.zeros(3)
        goal[:n] = targets[k]
        return solve_all(  # type: ignore[no-any-return]
            *model.packed, model.margin, model.zero, low, high, bend, goal, region, solutions, dets, stack
        )

    for k in suspects[:MOST_SUSPECTS]:
        p = np.zeros(3)
        p[:n] = targets[k] + moved[k]
        reach = max(tolerance, error[k] / np.linalg.svd(model.to_place[:n, :n], compute_uv=False)[-1]) * 1.001 + 1e-9
        count, unknown = searched(int(k), np.array([p - reach, p + reach]))
        near = [float(np.linalg.norm(model.to_place @ (solutions[i] - p))) for i in range(count) if dets[i] > -1e-9]
        if unknown:
            undecided += 1
        elif not near or min(near) > error[k] * (1 + 1e-6) + 1e-8 + 10 * model.grain:
            text = f"target {targets[k].tolist()}, found {p[:n].tolist()}, error {error[k]:.3g}"
            wrong.append((int(k), int(verdict[k]), f"{text}, nearest {min(near, default=np.inf):.6g}"))
    for k in search:
        goal = np.zeros(3)
        goal[:n] = targets[k]
        count, unknown = searched(int(k), np.array([goal - most - 1e-6, goal + most + 1e-6]))
        undecided += unknown > 0
        bad = [i for i in range(count) if dets[i] < -1e-9]
        apart = [i for i in range(count) if np.abs(solutions[i, :n] - solutions[0, :n]).max() > 1e-4]
        if apart and not bad:
            wrong.append((int(k), SEVERAL, f"target {targets[k].tolist()}, {solutions[[0, apart[0]], :n].tolist()}"))
        if bad:
            text = f"target {targets[k].tolist()}, found {(targets[k] + moved[k]).tolist()}, folds at "
            text += f"{solutions[bad[0], :n].tolist()} with {dets[bad[0]]:.3g}"
            wrong.append((int(k), FOLDED, text))
    return Verdicts(int((status == 0).sum()), len(search), undecided, wrong)
