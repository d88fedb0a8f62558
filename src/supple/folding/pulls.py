"""Grabs of several handles at once, each of which arrives: pulls."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.errors import FoldError, SuppleError, argument
from supple.folding.resolved import (
    FLOW_GAP,
    FLOW_MARGIN,
    FREE_ENOUGH,
    MOST_SUBSTROKES,
    SQUEEZED,
    Floats,
    Resolved,
    Table,
    all_the_way,
    beta_at,
    cut,
    described,
    freedom_at,
    is_held,
    narrowest,
    padded,
    spelled,
    too_narrow,
)
from supple.folding.strain import CLEARLY_SAFE, GAP, MARGIN, largest, mask_of, sampled, weakest
from supple.space.domain import Domain
from supple.strokes import FoldPolicy, Stroke, numbers, pack

_HIT = 1e-6  # samples: the accuracy of handles


def pulled(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve a grab of several handles: forces f_j at the handles, with Σ_j K_ij f_j the displacement of each."""
    axes = domain.packed()
    one = pack([replace(stroke, also=())], domain.spacing, time=domain.time)
    handles = np.array(stroke.handles) * domain.spacing  # of each, the point and the drag
    table = np.repeat(one, len(handles))
    table["pivot"][:, : domain.ndim], table["force"][:, : domain.ndim] = handles[:, 0], handles[:, 1]
    table["joined"][1:] = 1
    start, goal = table["pivot"].copy(), table["pivot"] + table["force"]
    frozen = np.minimum(freedom_at(start, domain), freedom_at(goal, domain)) <= FREE_ENOUGH
    frozen &= (start != goal).any(axis=1)
    if frozen.any():
        return _without(stroke, frozen, domain, on_fold)
    _check_handles(stroke, start, goal, domain)
    if on_fold == "flow":
        return _flow(stroke, domain, table, goal)
    table["force"] = _forces(table, goal - start, domain)
    _check_arrival(stroke, domain, _moved(table, domain, start), start, goal)
    # Where μ is known to be that low anywhere, no closer bound is needed elsewhere.
    known = sampled(table, axes, mask_of(domain)) * (1 + GAP)
    lower, _ = weakest(table, axes, min(CLEARLY_SAFE, known), mask=mask_of(domain))
    alpha = 1.0 if lower >= MARGIN - 1 else (1 - MARGIN) / -lower * (1 - 1e-14)
    warning = None
    if alpha < 1:
        if on_fold == "error":
            raise FoldError(
                f"{described(stroke)} folds: at most {cut(0.999 * alpha, 3):g} of it does not {all_the_way()}; "
                f"{_conflict(stroke, start, goal, domain)}"
            )
        warning = f"{described(stroke)} folds: damped to {cut(alpha, 2):g} of it {all_the_way()}"
    table["force"] *= alpha
    table["most"] = largest(table, axes, mask_of(domain))
    arrived = tuple(a + alpha * b for a, b in zip(stroke.at, stroke.by, strict=True))
    return Resolved(table, arrived, alpha, 1 + alpha * lower, "fold" if alpha < 1 else None, warning)


def _without(stroke: Stroke, frozen: npt.NDArray[np.bool_], domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve a pull without the handles that start or end where it is frozen: they cannot arrive, the others do."""
    count, first = int(frozen.sum()), _handle(stroke, int(frozen.argmax()), domain)
    which = f"{first}, is" if count == 1 else f"{count} handles, {first}, for one, are"
    warning = f"{described(stroke)} is held back: {which} let go, since nothing moves where it is frozen"
    if on_fold == "error":
        raise FoldError(warning)
    kept = [pair for pair, gone in zip(stroke.handles, frozen, strict=True) if not gone]
    if kept:
        (at, by), *also = kept
        try:
            made = pulled(replace(stroke, at=at, by=by, also=tuple(also)), domain, on_fold)
        except SuppleError as error:
            raise type(error)(f"without the handles that are frozen, {error}") from None
    else:
        made = Resolved(pack([stroke], domain.spacing, time=domain.time)[:0], stroke.at)
    position = _moved(made.rows, domain, padded(stroke.at, domain)[None])[0]
    arrived = tuple((position[: domain.ndim] / domain.spacing).tolist())
    cause = "fold and freeze" if made.cause == "fold" else "freeze"
    return replace(made, arrived=arrived, cause=cause, warning="; ".join(filter(None, (warning, made.warning))))


def _flow(stroke: Stroke, domain: Domain, table: Table, goal: Floats) -> Resolved:
    """Resolve a pull as groups, one after the other: all handles go straight to their targets, and arrive at once."""
    axes, start = domain.packed(), table["pivot"].copy()

    steps: dict[bytes, tuple[Table, float]] = {}

    def step(position: Floats) -> tuple[Table, float]:
        """Return the pull from a position to the goal, and an estimate of its μ; both passes ask for most of them."""
        key = position.tobytes()
        if key not in steps:
            group = table.copy()
            group["pivot"] = position
            group["force"] = _forces(group, goal - position, domain)
            steps[key] = group, sampled(group, axes, mask_of(domain))
        return steps[key]

    def proven(rows: Table, estimate: float) -> float:
        pieces = math.ceil(estimate * (1 + FLOW_GAP) / (FLOW_MARGIN - 1))
        return weakest(rows, axes, (FLOW_MARGIN - 1) * max(pieces, 1), FLOW_GAP, mask_of(domain))[0]

    # Proofs take most of the time: they begin when it is known that the handles arrive.
    for proving in (False, True):
        groups, margin, position, pieces = list[Table](), 1.0, start, 2
        while pieces > 1:
            whole, estimate = step(position)
            lower = proven(whole, estimate) if proving else estimate
            pieces = max(math.ceil(np.nan_to_num(-lower, nan=1e9, posinf=1e9) / (1 - FLOW_MARGIN) * (1 - 1e-9)), 1)
            margin = min(margin, 1 + lower / pieces)
            group = whole.copy()
            group["force"] /= pieces
            groups.append(group)
            position = _moved(group, domain, position)
            if pieces > MOST_SUBSTROKES or len(groups) * len(table) > MOST_SUBSTROKES:
                conflict = _conflict(stroke, start, goal, domain)
                raise SuppleError(f"{described(stroke)} cannot arrive without a fold: {conflict}")
        _check_arrival(stroke, domain, position, start, goal)
    for group in groups:
        group["most"] = largest(group, axes, mask_of(domain))
    rows = np.concatenate(groups)
    if narrowest(rows, domain, start, goal - start) < SQUEEZED:
        raise SuppleError(f"{described(stroke)} {too_narrow()}")
    return Resolved(rows, tuple((position[0, : domain.ndim] / domain.spacing).tolist()), margin=margin)


def _moved(group: Table, domain: Domain, points: Floats) -> Floats:
    moved, _ = _core.forward(numbers(group), domain.packed(), points, False, mask_of(domain))
    return moved


def _check_arrival(stroke: Stroke, domain: Domain, found: Floats, start: Floats, goal: Floats) -> None:
    missed = float(np.linalg.norm(found - goal, axis=1).max())
    if not missed <= _HIT * min(domain.spacing):  # also for NaN
        raise SuppleError(f"{described(stroke)} cannot arrive: {_conflict(stroke, start, goal, domain)}")


def _check_handles(stroke: Stroke, start: Floats, goal: Floats, domain: Domain) -> None:
    """Refuse handles that cannot arrive: at one place, or on a fixed edge."""
    axes = domain.packed()
    places: dict[tuple[float, ...], int] = {}
    first, last = axes[:, 0], axes[:, 1]
    fixed, beta = axes[:, 2] >= 0, beta_at(start, axes)
    for i, (a, b) in enumerate(zip(start, goal, strict=True)):
        other = places.setdefault(tuple(a.tolist()), i)
        if other != i:
            place = _place(stroke, i, domain)
            raise SuppleError(f"{described(stroke)} has two handles {place}, {other + 1} and {i + 1}: leave one out")
        across = fixed & (a != b)
        out = across & ((b <= first) | (b >= last) | (beta[i] < 1e-100))
        if out.any() or not is_held(a, axes):
            raise SuppleError(
                f"{described(stroke)} cannot arrive: {_handle(stroke, i, domain)}, starts or ends on the edge or "
                f"outside, where the border is fixed; use {argument('border', None)}, or points further in"
            )


def _forces(table: Table, drags: Floats, domain: Domain) -> Floats:
    """Return forces (N, 3) whose displacements at the pivots add up to the drags (N, 3)."""
    axes, pivots, n = domain.packed(), table["pivot"], len(table)
    moving = (beta_at(pivots, axes) > 1e-100) & (freedom_at(pivots, domain)[:, None] > 0)
    moving[:, domain.ndim :] = False
    columns = []
    for j, d in zip(*np.nonzero(moving), strict=True):
        unit = table[j : j + 1].copy()
        unit["joined"], unit["force"] = 0, np.eye(3)[d]
        there, _ = _core.forward(numbers(unit), axes, pivots, False, mask_of(domain))
        columns.append((there - pivots)[moving])
    forces = np.zeros((n, 3))
    if columns:
        matrix = np.stack(columns, axis=1)
        try:
            forces[moving] = np.linalg.solve(matrix, drags[moving])
        except np.linalg.LinAlgError:
            forces[moving] = np.linalg.lstsq(matrix, drags[moving], rcond=1e-13)[0]
    return forces


def _place(stroke: Stroke, i: int, domain: Domain) -> str:
    return f"at {'voxel ' * (domain.ndim == 3 and not domain.time)}{spelled(stroke.handles[i][0])}"


def _handle(stroke: Stroke, i: int, domain: Domain) -> str:
    """Name a handle in a message, by its number from 1 and its place."""
    return f"handle {i + 1}, {_place(stroke, i, domain)}"


def _conflict(stroke: Stroke, start: Floats, goal: Floats, domain: Domain) -> str:
    """Name the two handles whose distance changes most on their straight ways, at the worst of these."""
    drag = goal - start
    apart, parting = start[:, None] - start, drag[:, None] - drag
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.clip(-(apart * parting).sum(axis=2) / (parting**2).sum(axis=2), 0, 1)[:, :, None]
        ways = [np.linalg.norm(apart + t * parting, axis=2) for t in (np.nan_to_num(nearest), 1.0)]
        change = np.max(np.abs(np.log(ways / np.linalg.norm(apart, axis=2))), axis=0)
    np.fill_diagonal(change, 0.0)
    i, j = np.unravel_index(np.argmax(change), change.shape)
    if not change[i, j] > 0:  # one handle, or all by the same drag
        frozen = mask_of(domain) is not None
        why = "what is frozen is in the way" if frozen else "the radius is too small for so long a drag"
        return f"{why}; use a larger radius, or other targets"
    one, other = (f"{_handle(stroke, k, domain)}, dragged by {spelled(stroke.handles[k][1])}" for k in (int(i), int(j)))
    return f"{one}, and {other}, pull against each other; use a larger radius, or other targets"
