"""T⁻¹ at points: Newton's method with backtracking, and a continuation where that struggles.

Every stroke of a table is one-to-one with a Jacobian that is nowhere singular (`supple.folding` sees to it), so
the square system T(p) = q has one solution, and the Newton step δ = -(I+J)⁻¹ ξ, ξ = T(p) - q, always leads
downhill in |ξ|². From a good guess, a batch solves for the whole sequence of strokes at once; without one, it
undoes stroke after stroke, the last one first, which cannot fail where each is one-to-one.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.field import (
    FREE_ROWS,
    J00,
    J01,
    J02,
    J10,
    J11,
    J12,
    J20,
    J21,
    J22,
    X,
    Y,
    Z,
    apply,
    load,
    save,
)
from supple.cpu.kernel import BATCH, inlined, kernel
from supple.cpu.point import SMALLEST_LENGTH, downhill, kept_inside, next_step

# Rows of a workspace, after those of the field: what should be reached, the best point so far and its next
# step, how much of it is tried, the best residual's square, whether the point is done, and its evaluations.
QX, QY, QZ = FREE_ROWS * BATCH, (FREE_ROWS + 1) * BATCH, (FREE_ROWS + 2) * BATCH
PX, PY, PZ = (FREE_ROWS + 3) * BATCH, (FREE_ROWS + 4) * BATCH, (FREE_ROWS + 5) * BATCH
DX, DY, DZ = (FREE_ROWS + 6) * BATCH, (FREE_ROWS + 7) * BATCH, (FREE_ROWS + 8) * BATCH
LENGTH, NORM, DONE = (FREE_ROWS + 9) * BATCH, (FREE_ROWS + 10) * BATCH, (FREE_ROWS + 11) * BATCH
STEPS = (FREE_ROWS + 12) * BATCH
GOAL = (FREE_ROWS + 13) * BATCH  # three rows, for callers that solve for something else in between
ROWS = FREE_ROWS + 16


@kernel
def _keep_inside(w, n, axis, extent):
    x, q = X + axis * BATCH, QX + axis * BATCH
    for i in range(n):
        w[x + i] = kept_inside(w[x + i], w[q + i], extent)


@kernel
def _try(w, n):
    for i in range(n):
        w[X + i] = w[PX + i] + w[LENGTH + i] * w[DX + i]
        w[Y + i] = w[PY + i] + w[LENGTH + i] * w[DY + i]
        w[Z + i] = w[PZ + i] + w[LENGTH + i] * w[DZ + i]


@kernel
def _judge(w, n, tolerance2):
    """Take the trials that led downhill and find their next steps; halve the others. How many go on."""
    left = 0.0
    for i in range(n):
        ex, ey, ez = w[X + i] - w[QX + i], w[Y + i] - w[QY + i], w[Z + i] - w[QZ + i]
        dx, dy, dz = next_step(
            w[J00 + i], w[J01 + i], w[J02 + i],
            w[J10 + i], w[J11 + i], w[J12 + i],
            w[J20 + i], w[J21 + i], w[J22 + i],
            ex, ey, ez,
        )  # fmt: skip
        error = ex * ex + ey * ey + ez * ez
        going = w[DONE + i] == 0.0
        take = going and downhill(error, w[NORM + i], w[LENGTH + i])
        w[STEPS + i] += 1.0 if going else 0.0
        length = w[LENGTH + i]
        # The point tried is the base plus a part of the step; keep_inside may have moved it.
        w[PX + i] = w[GOAL + i] if take else w[PX + i]
        w[PY + i] = w[GOAL + BATCH + i] if take else w[PY + i]
        w[PZ + i] = w[GOAL + 2 * BATCH + i] if take else w[PZ + i]
        w[DX + i] = dx if take else w[DX + i]
        w[DY + i] = dy if take else w[DY + i]
        w[DZ + i] = dz if take else w[DZ + i]
        w[NORM + i] = error if take else w[NORM + i]
        small = dx * dx + dy * dy + dz * dz <= tolerance2
        done = 1.0 if take and small else w[DONE + i]
        w[DONE + i] = done
        # A point that is done steps no more: later trials only repeat what it has.
        length = 1.0 if take else 0.5 * length
        length = 0.0 if done > 0.0 else length
        w[LENGTH + i] = length
        left += 1.0 if length > SMALLEST_LENGTH else 0.0
    return left


@kernel
def newton(w, n, table, axes, first, last, tolerance, limit):
    """Solve T(p) = q for the strokes ``first`` to ``last - 1``, for a batch.

    The rows QX.. hold the targets q, X.. the guesses. Afterwards PX.. hold the solutions, J00.. T's Jacobian and
    NORM the squares of |T(p) - q| where the last step began; STEPS grows by the evaluations. A point is DONE where
    that step was shorter than ``tolerance``.
    """
    for i in range(n):
        w[PX + i], w[PY + i], w[PZ + i] = w[X + i], w[Y + i], w[Z + i]
        w[DX + i], w[DY + i], w[DZ + i] = 0.0, 0.0, 0.0
        w[LENGTH + i], w[NORM + i], w[DONE + i] = 1.0, 1e300, 0.0
    for _ in range(limit):
        _try(w, n)
        for axis in range(3):
            if axes[axis, 1] >= 0.0:
                _keep_inside(w, n, axis, axes[axis, 0])
        for i in range(3 * BATCH):
            w[GOAL + i] = w[X + i]
        apply(w, n, table, axes, first, last, True)
        if _judge(w, n, tolerance * tolerance) == 0.0:
            break
    # The step that was short enough to end with is known, and taken.
    for i in range(n):
        last_step = 1.0 if w[DONE + i] > 0.0 else 0.0
        w[X + i] = w[PX + i] + last_step * w[DX + i]
        w[Y + i] = w[PY + i] + last_step * w[DY + i]
        w[Z + i] = w[PZ + i] + last_step * w[DZ + i]
    for axis in range(3):
        if axes[axis, 1] >= 0.0:
            _keep_inside(w, n, axis, axes[axis, 0])
    for i in range(n):
        w[PX + i], w[PY + i], w[PZ + i] = w[X + i], w[Y + i], w[Z + i]


@inlined
def _continue(w, one, i, table, axes, k, tolerance):
    """Follow T⁻¹ along the straight line from where point ``i`` is sent to where it should be sent."""
    for axis in range(3):
        one[X + axis * BATCH] = w[QX + axis * BATCH + i]
    apply(one, 1, table, axes, k, k + 1, False)
    sx, sy, sz = one[X], one[Y], one[Z]
    qx, qy, qz = w[QX + i], w[QY + i], w[QZ + i]
    px, py, pz = qx, qy, qz
    way, stride = 0.0, 0.5
    one[STEPS] = 0.0
    while way < 1.0 and stride > 1e-9:
        t = min(1.0, way + stride)
        one[QX], one[QY], one[QZ] = sx + t * (qx - sx), sy + t * (qy - sy), sz + t * (qz - sz)
        one[X], one[Y], one[Z] = px, py, pz
        newton(one, 1, table, axes, k, k + 1, tolerance, 12)
        if one[DONE] > 0.0:
            px, py, pz = one[PX], one[PY], one[PZ]
            way = t
            stride *= 2.0
        else:
            stride *= 0.5
    w[STEPS + i] += one[STEPS]
    if way >= 1.0:
        w[PX + i], w[PY + i], w[PZ + i] = px, py, pz


@kernel
def undo(w, one, n, table, axes, tolerance):
    """T⁻¹ of a batch without a guess. The rows QX.. hold the targets; afterwards all is as `newton` leaves it."""
    goal = np.empty(3 * BATCH)
    for i in range(3 * BATCH):
        goal[i] = w[X + i] = w[QX + i]
    for i in range(n):
        w[STEPS + i] = 0.0
    strokes = table.shape[0]
    for step in range(strokes + 1):
        # In the last round, the whole sequence polishes what the single strokes have found.
        whole = step == strokes
        first = 0 if whole else strokes - 1 - step
        last = strokes if whole else first + 1
        for i in range(3 * BATCH):
            w[QX + i] = goal[i] if whole else w[X + i]
        if whole and strokes == 1:
            break
        newton(w, n, table, axes, first, last, tolerance, 8 if whole else 40)
        if not whole:
            for i in range(n):
                if w[DONE + i] == 0.0:
                    _continue(w, one, i, table, axes, first, tolerance)
        for i in range(3 * BATCH):
            w[X + i] = w[PX + i]


@inlined
def settle(w, one, n, table, axes, tolerance, limit):
    """T⁻¹ of a batch from the guesses in the rows X..; without them, if they were not good enough for all of it."""
    for i in range(n):
        w[STEPS + i] = 0.0
    newton(w, n, table, axes, 0, table.shape[0], tolerance, limit)
    missed = 0.0
    for i in range(n):
        missed += 1.0 - w[DONE + i]
    if missed > 0.0:
        undo(w, one, n, table, axes, tolerance)


@kernel
def inverse(table, axes, targets, points, residual, steps, tolerance):
    """T⁻¹ of ``targets`` (3, N) into ``points``, with |T(p) - q| in physical units and the evaluations."""
    w, one = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    total = targets.shape[1]
    for start in range(0, total, BATCH):
        n = min(BATCH, total - start)
        load(w, QX, n, targets, start)
        undo(w, one, n, table, axes, tolerance)
        save(w, PX, n, points, start)
        # What is said of a point is measured once more, at what is handed out.
        load(w, QX, n, targets, start)
        load(w, X, n, points, start)
        apply(w, n, table, axes, 0, table.shape[0], False)
        for i in range(n):
            ex, ey, ez = w[X + i] - w[QX + i], w[Y + i] - w[QY + i], w[Z + i] - w[QZ + i]
            residual[start + i] = np.sqrt(ex * ex + ey * ey + ez * ez)
            steps[start + i] = np.int64(w[STEPS + i])
