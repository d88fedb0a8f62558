"""An oracle for inverses of sampled fields, which shares nothing with the core: evaluation, Newton, and exhaustion.

All of it is in indices of the field, x first. A field of two axes is one of three with a last axis of one sample.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

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


class Model(NamedTuple):
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


def model_of(field: Field) -> Model:
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
    cubic, zero = field.interpolation != "linear", field.beyond == "zero"
    return Model(made, cubic, n, first, last, 1e-6 if own else 0.5, zero, place, grain)


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
def cell_of(m: Model, p: Any, cell: Any) -> None:
    """The cell of an index; first - 1 and last are the cells beyond the ends."""
    for d in range(m.ndim):
        if p[d] < m.first[d]:
            cell[d] = int(m.first[d]) - 1
        elif p[d] > m.last[d] or m.last[d] == m.first[d]:
            cell[d] = int(m.last[d])
        else:
            cell[d] = min(int(p[d]), int(m.last[d]) - 1)


@numba.njit(cache=True)
def evaluate(m: Model, cell: Any, p: Any, out: Any, jac: Any) -> None:
    """out = p + w(p) by the polynomial of a cell, jac[a, b] = ∂out_a/∂p_b."""
    taps, left = (4, 1) if m.cubic else (2, 0)
    at, w = np.zeros(3, np.int64), np.zeros((3, 2, 4))  # of each axis: weights, and their derivatives
    w[2, 0, 0] = 1.0
    for d in range(m.ndim):
        pinned = cell[d] < m.first[d] or cell[d] >= m.last[d]
        at[d] = int(min(max(float(cell[d]), m.first[d]), m.last[d]))
        weights(0.0 if pinned else p[d] - cell[d], m.cubic, w[d])
        if pinned:
            w[d, 1] = 0.0
    out[:] = p
    jac[:] = 0.0
    jac[0, 0] = jac[1, 1] = jac[2, 2] = 1.0
    for k in range(taps if m.ndim == 3 else 1):
        z = mirror(at[2] + k - left, m.values.shape[0])
        for j in range(taps):
            y = mirror(at[1] + j - left, m.values.shape[1])
            plain, by_y, by_z = w[1, 0, j] * w[2, 0, k], w[1, 1, j] * w[2, 0, k], w[1, 0, j] * w[2, 1, k]
            for i in range(taps):
                x = mirror(at[0] + i - left, m.values.shape[2])
                weight, by_x = w[0, 0, i], w[0, 1, i] * plain
                for a in range(m.ndim):
                    v = m.values[z, y, x, a]
                    out[a] += weight * plain * v
                    jac[a, 0] += by_x * v
                    jac[a, 1] += weight * by_y * v
                    jac[a, 2] += weight * by_z * v


@numba.njit(cache=True)
def inverse3(m: Any, r: Any) -> float:
    """Write the inverse of a matrix, and return the determinant; a singular one has none."""
    for a in range(3):
        for b in range(3):
            c, d, e, f = (a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3
            r[b, a] = m[c, e] * m[d, f] - m[c, f] * m[d, e]
    det = m[0, 0] * r[0, 0] + m[0, 1] * r[1, 0] + m[0, 2] * r[2, 0]
    if det != 0.0:
        r /= det
    return float(det)


@numba.njit(cache=True)
def grade(m: Model, p: Any, q: Any, error: float, tolerance: float, slack: float) -> int:
    """Compare the way from a returned index p to the solution q with the claims."""
    way = q - p
    if np.sqrt(((m.to_place @ way) ** 2).sum()) > error * (1 + 1e-6) + slack * np.sqrt((m.to_place**2).sum()):
        return OFF
    return LOOSE if np.sqrt((way**2).sum()) > tolerance * (1 + 1e-6) + slack else FINE


@numba.njit(cache=True, nogil=True)
def check_solves(
    m: Model, targets: Any, moved: Any, error: Any, status: Any, tolerance: float, scale: float, verdict: Any
) -> None:
    """Continue Newton's method from every result that is called ok. NONE and OFF are suspects, not yet convicted."""
    p, q, out, jac, inv = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    cell = np.zeros(3, np.int64)
    for n in range(len(status)):
        verdict[n] = FINE
        if status[n] != 0:
            continue
        size, stays, inside = scale, True, True
        for d in range(m.ndim):
            p[d] = q[d] = targets[n, d] + moved[n, d]
            size += abs(targets[n, d]) + abs(moved[n, d])
            stays = stays and moved[n, d] == 0.0
            inside = inside and m.first[d] - m.margin <= targets[n, d] <= m.last[d] + m.margin
        if m.zero and not inside and stays:  # there is no displacement
            continue
        known, slack = False, 0.0
        for _ in range(30):
            cell_of(m, q, cell)
            evaluate(m, cell, q, out, jac)
            det = inverse3(jac, inv)
            if det == 0.0:
                break
            off = out - targets[n]
            step = -(inv @ off)
            s2 = (step**2).sum()
            slack = (1e-14 * size + m.grain) * (1.0 + 2.0 * np.sqrt((inv**2).sum()))
            if (off**2).sum() <= (4e-15 * size) ** 2 or s2 <= slack * slack:
                known = True
                break
            if s2 > 1e6 or s2 != s2:
                break
            q += step
        if not known:
            verdict[n] = NONE
            continue
        verdict[n] = grade(m, p, q, error[n], tolerance, slack)
        if verdict[n] == FINE and det <= 0.0:
            verdict[n] = TURNED
        if m.zero and verdict[n] == FINE:
            for d in range(m.ndim):
                if not m.first[d] - m.margin - 1e-9 - slack <= q[d] <= m.last[d] + m.margin + 1e-9 + slack:
                    verdict[n] = MARGIN


def bounds_of_cells(m: Model) -> tuple[Floats, Floats, Floats]:
    """Return for each cell (z, y, x), those beyond the ends included: the least and the largest w (..., a), and bounds
    of its second derivatives (..., a, b, c).
    """
    taps, left = (4, 1) if m.cubic else (2, 0)
    index, pinned = [], []
    for d in (2, 1, 0):
        cells = np.arange(int(m.first[d]) - 1, int(m.last[d]) + 1) if d < m.ndim else np.zeros(1, int)
        base = np.clip(cells, int(m.first[d]), int(m.last[d]))
        around = base[:, None] + np.arange(taps if d < m.ndim else 1) - left
        period = max(2 * (m.values.shape[2 - d] - 1), 1)
        index.append(np.minimum(around % period, period - around % period))
        pinned.append((cells < m.first[d]) | (cells >= m.last[d]))
    z, y, x = index
    near = m.values[z[:, None, None, :, None, None], y[:, None, None, :, None], x[:, None, None]]
    bend = np.zeros((*near.shape[:3], 3, 3, 3))
    for b, c in itertools.product(range(m.ndim), repeat=2):
        if b != c or m.cubic:
            most = np.abs(np.diff(np.diff(near, axis=5 - b), axis=5 - c)).max(axis=(3, 4, 5))
            for axis in (b, c):
                np.moveaxis(most, 2 - axis, 0)[pinned[2 - axis]] = 0.0
            bend[..., b, c] = most
    return near.min(axis=(3, 4, 5)), near.max(axis=(3, 4, 5)), bend


@numba.njit(cache=True, nogil=True)
def solve_all(
    m: Model, low: Any, high: Any, bend: Any, target: Any, region: Any, found: Any, dets: Any, stack: Any
) -> tuple[int, int]:
    """Collect all solutions in a region (low, high) by bisection, and count the boxes that remain undecided.

    A box is dropped if the mean value form excludes the target, or settled if it also proves that the map is one to
    one there: Newton's method then finds the one solution, or that there is none.
    """
    out, jac, inv = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    cell, from_, to = np.zeros(3, np.int64), np.zeros(3, np.int64), np.ones(3, np.int64)
    count = unknown = 0
    span = np.zeros((3, 2))
    for d in range(m.ndim):
        span[d, 0], span[d, 1] = region[0, d], region[1, d]
        if m.zero:
            span[d, 0] = max(span[d, 0], m.first[d] - m.margin)
            span[d, 1] = min(span[d, 1], m.last[d] + m.margin)
        if span[d, 0] > span[d, 1]:
            return 0, 0
        from_[d] = max(0, min(int(np.floor(span[d, 0] - m.first[d])) + 1, low.shape[2 - d] - 1))
        to[d] = max(0, min(int(np.floor(span[d, 1] - m.first[d])) + 1, low.shape[2 - d] - 1)) + 1
    for cz in range(from_[2], to[2]):
        for cy in range(from_[1], to[1]):
            for cx in range(from_[0], to[0]):
                at = (cx, cy, cz)
                possible = True
                for d in range(m.ndim):
                    cell[d] = at[d] + int(m.first[d]) - 1
                    a, b = float(cell[d]), float(cell[d] + 1)
                    if cell[d] < m.first[d]:
                        a, b = -np.inf, m.first[d]
                    elif cell[d] >= m.last[d]:
                        a, b = m.last[d], np.inf
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
                    mid, half = 0.5 * (stack[depth, 0] + stack[depth, 1]), 0.5 * (stack[depth, 1] - stack[depth, 0])
                    evaluate(m, cell, mid, out, jac)
                    rest = (bend[cz, cy, cx] * half).sum(axis=2)
                    if (np.abs(out - target) > 1e-12 * (1 + np.abs(out)) + (np.abs(jac) + rest) @ half).any():
                        continue
                    det = inverse3(jac, inv)
                    if abs(det) > 1e-13:
                        spread = np.abs(inv) @ rest
                        if (np.abs(inv @ (out - target)) > half + 1e-9 + spread @ half).any():
                            continue
                        if spread.sum(axis=1).max() < 0.7:
                            q, s2 = mid.copy(), 0.0
                            for _ in range(60):
                                step = inv @ (out - target)
                                q -= step
                                s2 = (step**2).sum()
                                if s2 > 1e4 or s2 < 1e-28:
                                    break
                                evaluate(m, cell, q, out, jac)
                                det = inverse3(jac, inv)
                                if det == 0.0:
                                    break
                            if s2 < 1e-20 and (np.abs(q - mid) <= half + 1e-9).all() and count < len(found):
                                found[count], dets[count] = q, det
                                for d in range(m.ndim):  # at a face of its cell, the sign of the fold is not decided
                                    face = min(abs(q[d] - cell[d]), abs(q[d] - cell[d] - 1))
                                    if m.zero:
                                        face = min(face, abs(min(q[d] - m.first[d], m.last[d] - q[d]) + m.margin))
                                    if face < 1e-7:
                                        dets[count] = 0.0
                                count += 1
                            continue
                    axis = half.argmax()
                    if half[axis] < 1e-9 or depth + 2 > len(stack):
                        unknown += 1
                        continue
                    stack[depth + 1] = stack[depth]
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
    model, n, grid = model_of(field), field.ndim, found.field.grid
    to_index = np.linalg.inv(field.grid.matrix) @ grid.matrix
    index = np.indices(grid.shape).reshape(n, -1)[::-1].T.astype(np.float64)
    targets, moved = np.zeros((len(index), 3)), np.zeros((len(index), 3))
    targets[:, :n] = index @ to_index[:n, :n].T + to_index[:n, n]
    linear = np.linalg.inv(field.grid.matrix[:n, :n])
    moved[:, :n] = found.field.values.reshape(-1, n).astype(np.float64) @ linear.T
    status, error = found.status.ravel(), found.error.ravel().astype(np.float64)
    verdict = np.zeros(status.size, np.int64)
    scale = 1.0 + float(np.abs(linear @ np.array(field.grid.origin)).max())
    scale += float(np.abs(linear @ np.array(grid.origin)).max())
    check_solves(model, targets, moved, error, status, tolerance, scale, verdict)
    suspects = np.flatnonzero((verdict == NONE) | (verdict == OFF) | (verdict == TURNED))
    wrong = [(int(k), int(verdict[k]), "") for k in np.flatnonzero((verdict == LOOSE) | (verdict == MARGIN))]
    search = search[status[search] == 0]
    if not len(suspects) and not len(search):
        return Verdicts(int((status == 0).sum()), 0, 0, wrong)
    low, high, bend = bounds_of_cells(model)
    most = np.maximum(np.abs(low), np.abs(high)).reshape(-1, 3).max(axis=0)
    solutions, dets, stack = np.zeros((MOST, 3)), np.zeros(MOST), np.zeros((400, 2, 3))
    undecided = 0

    def searched(k: int, region: Floats) -> tuple[int, int]:
        return solve_all(model, low, high, bend, targets[k], region, solutions, dets, stack)  # type: ignore[no-any-return]

    for k in suspects[:MOST_SUSPECTS]:
        p = targets[k] + moved[k]
        reach = max(tolerance, error[k] / np.linalg.svd(model.to_place[:n, :n], compute_uv=False)[-1]) * 1.001 + 1e-9
        count, unknown = searched(int(k), np.array([p - reach, p + reach]))
        near = [float(np.linalg.norm(model.to_place @ (solutions[i] - p))) for i in range(count) if dets[i] > -1e-9]
        if unknown:
            undecided += 1
        elif not near or min(near) > error[k] * (1 + 1e-6) + 1e-8 + 10 * model.grain:
            text = f"target {targets[k, :n].tolist()}, found {p[:n].tolist()}, error {error[k]:.3g}"
            wrong.append((int(k), int(verdict[k]), f"{text}, nearest {min(near, default=np.inf):.6g}"))
    for k in search:
        count, unknown = searched(int(k), np.array([targets[k] - most - 1e-6, targets[k] + most + 1e-6]))
        undecided += unknown > 0
        bad = [i for i in range(count) if dets[i] < -1e-9]
        apart = [i for i in range(count) if np.abs(solutions[i, :n] - solutions[0, :n]).max() > 1e-4]
        if apart and not bad:
            both = solutions[[0, apart[0]], :n].tolist()
            wrong.append((int(k), SEVERAL, f"target {targets[k, :n].tolist()}, {both}"))
        if bad:
            text = f"target {targets[k, :n].tolist()}, found {(targets[k] + moved[k])[:n].tolist()}, folds at "
            text += f"{solutions[bad[0], :n].tolist()} with {dets[bad[0]]:.3g}"
            wrong.append((int(k), FOLDED, text))
    return Verdicts(int((status == 0).sum()), len(search), undecided, wrong)
