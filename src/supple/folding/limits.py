"""The largest strength of strokes that does not fold, how stronger ones are handled, and pulls of several points.

A stroke's map T(p) = p + K_β(p) is one-to-one on its (convex) domain if the symmetric part of I + J_β is at
least m > 0 at every point: T is strongly monotone then, and |(I + J_β)⁻¹| ≤ 1/m. J_β is linear in the
force, so

    μ = min λ_min(sym J_β), over all points of the domain,

limits the force: its fraction α is safe if α |μ| ≤ 1 - m.

Where the border is free and the reach unlimited, the worst point is on the axis through the pivot along the
force. At the distance t from the pivot, with s_i = t² + ε_i², K = k f is there

    k = Σ w_i [ s_i^(-1/2) + g ε_i² s_i^(-3/2) ],    g = 1/2 - b/a,
    dk/dt = -t Σ w_i [ s_i^(-3/2) + 3g ε_i² s_i^(-5/2) ],

and μ = |f| dk/dt where d²k/dt² = 0; for a single scale, where 2s² + (12g - 3) ε² s - 15g ε⁴ = 0. Where the
border is fixed, or the reach limited, branch and bound finds μ (`_core/margin.hpp`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import numbers
from supple.engine.work import mask_of
from supple.errors import FoldError, Spelling, SuppleError, argument, current_spelling
from supple.folding.resolved import (
    FLOW_GAP,
    FLOW_MARGIN,
    FREE_ENOUGH,
    MOST_SUBSTROKES,
    SQUEEZED,
    Resolved,
    Table,
    all_the_way,
    apart,
    beta_at,
    cut,
    described,
    freedom_at,
    is_held,
    located,
    narrowest,
    padded,
    spelled,
    too_many,
    too_narrow,
)
from supple.folding.strain import CLEARLY_SAFE, GAP, MARGIN, largest, limit, sampled, weakest
from supple.space.checks import Vector
from supple.space.domain import Domain
from supple.space.geometry import Floats
from supple.strokes import FoldPolicy, Stroke, legs, matrix_of, pack, poisson_of, stretch_of

NEAR = 0.5
"""The distance from its target, in samples, within which a stroke's point has arrived."""

_HIT = 1e-6  # samples: the accuracy with which handles of a pull arrive
_MEETING = 0.01  # of the first distance of two handles, where they meet on their ways
_ALONG = 1e-9  # of the radius: the rounding error of a drag along a face


def resolve(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Return a stroke's safe rows: λ_min(sym(I + J_β)) ≥ m at every point, proven.

    ``"flow"`` applies any drag, as a sequence of strokes whose pivots move with the grabbed point until it reaches its
    target, within a fixed border too. ``"damp"`` scales a drag that folds to the largest one that does not, within
    0.2 %. ``"error"`` raises FoldError for such a drag, and for one that the border or a freeze mask holds back by more
    than half a sample; the paper's border, ``"sine"``, only warns of that. SuppleError if the stroke does not fit
    the domain; or if it cannot flow to its target, at all or in `MOST_SUBSTROKES` strokes. In a clip, sym(J) is that
    in the stroke's own metric, along the axes along which it moves points.
    """
    return _resolved(stroke, domain, on_fold, current_spelling())  # the warning is in the current spelling


def farthest(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> tuple[Stroke, Resolved]:
    """Return a stroke at its strength, and its safe rows; for strengths beyond 1 or below 0, as much as is possible.

    The warning has the applied part, within a hundredth of the stroke, and the reason. Errors are those of `resolve`,
    for strengths from 0 to 1, and under ``"error"``.
    """
    whole, part, low, high = stroke, stroke.strength, 0.0, stroke.strength
    try:
        if part != 1:
            whole = stroke.weakened(part)
        return whole, resolve(whole, domain, on_fold)
    except SuppleError as error:
        if on_fold == "error" or 0 <= part <= 1:
            raise
        failure = error
    made = stroke.weakened(low)
    while abs(high - low) > 0.01:
        middle = (low + high) / 2
        try:
            resolve(tried := stroke.weakened(middle), domain, on_fold)
            made, low = tried, middle
        except SuppleError:
            high = middle
    if low == 0.0:  # any part of it fails: the strength is not the reason
        raise failure
    resolved = resolve(made, domain, on_fold)
    warning = f"{part:.0%} of {described(stroke)} is carried out at {low:.0%}, as far as is possible: {failure}"
    if whole is stroke:  # the strength exceeds the range of strokes
        return made, replace(resolved, warning=warning)
    return whole, replace(resolved, alpha=resolved.alpha * low / part, cause="fold", warning=warning)


# Rows do not depend on earlier strokes: after an edit, those of the other strokes are reused.
@lru_cache(maxsize=4096)
def _resolved(stroke: Stroke, domain: Domain, on_fold: FoldPolicy, spelling: Spelling) -> Resolved:
    # In a clip, in the stroke's own metric, where a radius in time is as long as one in space.
    stretch = stretch_of(stroke, domain.shape[0], domain.spacing[2]) if domain.time else 1.0
    domain = domain if stretch == 1 else domain.stretched(stretch)
    made = _resolve(stroke, domain, on_fold)
    if mask_of(domain) is not None and not stroke.also and not stroke.is_still and made.warning is None:
        made = _held_back(stroke, domain, on_fold, made)
    if stretch != 1:
        made = replace(made, rows=made.rows.copy())
        made.rows["stretch"] = stretch
        for name in ("pivot", "force"):
            made.rows[name][:, 2] /= stretch
    made.rows.flags.writeable = False
    return made


def _held_back(stroke: Stroke, domain: Domain, on_fold: FoldPolicy, made: Resolved) -> Resolved:
    """Add a warning if a freeze mask holds a stroke back: no flow makes up for its factor."""
    what = "what is frozen" if stroke.matte is None else "its matte"
    if domain.time and domain.freeze is not None and domain.freeze.size[:2] == (1, 1):
        what = "what is held at the ends of the clip"
    if stroke.brush != "grab":
        part = float(freedom_at(padded(stroke.at, domain)[None], domain)[0])
        if part > 0.99:
            return made
        near = f"at its pivot, it is {part:.0%} of that: {what} is near"
        why = ("its pivot is frozen" if stroke.matte is None else "its matte is black there") if part == 0 else near
        warning = f"{described(stroke)} is held back: {why}"
        if on_fold == "error":
            raise FoldError(warning)
        return replace(made, cause="freeze", warning=warning)
    arrived = _arrived(stroke, made.rows, domain)
    target = np.add(stroke.at, stroke.by).tolist()
    if math.dist(arrived, target) <= NEAR:
        return made
    warning = f"{described(stroke)} ends {apart(arrived, target, domain)} short: {what} holds it back"
    if on_fold == "error":
        raise FoldError(warning)
    return replace(made, arrived=arrived, cause="freeze", warning=warning)


def _resolve(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    table = pack([stroke], domain.spacing, time=domain.time)
    axes = domain.packed()
    target = tuple(a + b for a, b in zip(stroke.at, stroke.by, strict=True))
    if stroke.is_still:
        return Resolved(table[:0], target)
    if stroke.brush != "grab":
        return _turned(stroke, domain, on_fold)
    if stroke.also:
        return pulled(stroke, domain, on_fold)
    if stroke.path:
        if on_fold != "flow":
            raise SuppleError(f"{described(stroke)} follows a path, which takes {argument('on_fold', 'flow')}")
        made = [_resolve(leg, domain, on_fold) for leg in legs(stroke, domain.spacing)]
        rows = np.concatenate([leg.rows for leg in made])
        return Resolved(rows, made[-1].arrived, margin=min(leg.margin for leg in made), cause=made[0].cause)
    if on_fold == "flow":
        return _flow(stroke, domain, table)
    lower, _ = weakest(table, axes, mask=mask_of(domain))
    alpha = 1.0 if lower >= MARGIN - 1 else (1 - MARGIN) / -lower * (1 - 1e-14)
    folds = alpha < 1
    if folds and on_fold == "error":
        most = spelled(cut(0.999 * alpha * x, 5) for x in stroke.by)
        raise FoldError(f"{described(stroke)} folds: at most {most} does not {all_the_way()}")
    table["force"] *= alpha
    arrived, held = _arrived(stroke, table, domain), is_held(table[0]["pivot"], axes)
    short = math.dist(arrived, target)
    held_back = math.dist(arrived, [a + alpha * b for a, b in zip(stroke.at, stroke.by, strict=True)]) > 1e-9
    frozen = held and float(freedom_at(table["pivot"], domain)[0]) < 1
    cause = " and ".join(["fold"] * folds + ["freeze" if frozen else "border"] * held_back) or None
    if not held:
        held_back, cause = False, "outside"
    warning = None
    if folds or (short > NEAR and held):
        distance = apart(arrived, target, domain)
        border = f"{'what is frozen' if frozen else 'the fixed border'} holds it back" if held_back else ""
        if folds:
            why = f"folds: damped to {cut(alpha, 2):g} of it{', and ' * held_back}{border}, it ends {distance} short"
        else:
            why = f"ends {distance} short: {border}"
        freed = f", {argument('border', None)} frees the border" if held_back else ""
        helps = "" if frozen else f" {all_the_way(freed)}"
        warning = f"{described(stroke)} {why}{helps}"
        # The paper's border held strokes back without a warning, as did recipes of version 1: results stay the same.
        if on_fold == "error" and domain.border_profile != "sine":
            raise FoldError(warning)
    return Resolved(table, arrived, alpha, 1 + alpha * lower, cause, warning)


def _turned(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve an affine brush or a twist: its pivot stays, and equal parts of it add up to all of it at the pivot."""
    axes, weights = domain.packed(), np.ones(3)
    table = pack([stroke], domain.spacing, time=domain.time)
    if _core.is_whole(numbers(table), axes, mask_of(domain)):
        return Resolved(table, stroke.at, margin=_narrowness(table[0]))
    held = is_held(padded(stroke.at, domain), axes)
    if held and on_fold == "flow":
        weights = beta_at(padded(stroke.at, domain), axes)
        needed = np.abs(matrix_of(stroke, domain.spacing, time=domain.time)).sum(axis=1) > 0
        if np.any(needed & (weights < 1e-100)):
            raise SuppleError(
                f"{described(stroke)} cannot be carried out: its pivot is on the edge, and the border is fixed, so "
                f"that what is on it only slides along it; use {argument('border', None)}, or a point further in"
            )
        weights = np.where(needed, weights, 1.0)

    def rows(part: float) -> Table:
        table = pack([stroke.weakened(part)], domain.spacing, time=domain.time)
        if table["turn"].any():
            table["turn"] /= weights
        else:
            table["matrix"] /= weights[:, None]
        return table

    def lowest(part: float, target: float, gap: float) -> float:
        return weakest(rows(part), axes, target, gap, mask_of(domain))[0]

    # At the pivot, 1 + μ is the cosine of the angle: 0 at a quarter turn, and 1 again after a whole one.
    quarters = abs(stroke.angle or 0.0) / 90
    if on_fold == "flow":
        pieces = max(math.ceil(quarters), 1)
        lower = lowest(1 / pieces, FLOW_MARGIN - 1, FLOW_GAP)
        while lower < (FLOW_MARGIN - 1) * (1 + 1e-9):
            pieces = max(pieces + 1, math.ceil(pieces * min(-lower / (1 - FLOW_MARGIN), 1e4) * (1 - FLOW_GAP)))
            if pieces > MOST_SUBSTROKES:
                raise SuppleError(f"{described(stroke)} {too_many()}")
            lower = lowest(1 / pieces, FLOW_MARGIN - 1, FLOW_GAP)
        table, start = np.repeat(rows(1 / pieces), pieces), padded(stroke.at, domain)
        ways = np.tile(start, (3, 1)), stroke.radius * np.eye(3)
        if (1 + lower) ** pieces < SQUEEZED and narrowest(table, domain, *ways) < SQUEEZED:
            raise SuppleError(f"{described(stroke)} {too_narrow()}")
        return Resolved(table, stroke.at, margin=1 + lower, cause=None if held else "outside")
    alpha, lower = 1.0, lowest(1.0, CLEARLY_SAFE, GAP) if quarters < 1 else -1.0
    if lower < MARGIN - 1:
        safe, folds = 0.0, 1 / max(quarters, 1.0)
        while folds - safe > 0.5 * GAP * folds:
            middle = (safe + folds) / 2
            bound = lowest(middle, MARGIN - 1, GAP)
            if bound >= MARGIN - 1:
                safe, lower = middle, bound
            else:
                folds = middle
        alpha = safe
    warning = None
    if alpha < 1:
        most = described(stroke.weakened(0.999 * alpha)).split(" at ")[0]
        if on_fold == "error":
            raise FoldError(f"{described(stroke)} folds: at most {most} does not {all_the_way()}")
        warning = f"{described(stroke)} folds: damped to {cut(alpha, 2):g} of it {all_the_way()}"
    cause = "outside" if not held else "fold" if alpha < 1 else None
    return Resolved(rows(alpha), stroke.at, alpha, 1 + lower, cause, warning)


def _narrowness(row: np.void) -> float:
    """Return the smallest singular value of a twist's Jacobian, a rotation times a shear: where |r φ'| is largest."""
    r = np.linspace(0, min(row["reach"], 8 * math.sqrt(row["radius2"][0])), 2001)
    rho2, m = r**2 + row["radius2"][0], 1.0
    if row["reach"] < math.inf:
        t = r / row["reach"]
        m = (1 - t) ** 3 * (1 + t * (3 + 6 * t))
    phi = m * (row["p"][0] * rho2**-1.5 + row["q"][0] * rho2**-2.5)
    half = 0.505 * float(np.abs(r * np.gradient(phi, r)).max())  # a hundredth more than sampled
    return math.hypot(1, half) - half


def _arrived(stroke: Stroke, table: Table, domain: Domain) -> Vector:
    """Return the position of the stroke's point after these rows, in samples."""
    return tuple((_moved(table, domain, padded(stroke.at, domain)[None])[0, : domain.ndim] / domain.spacing).tolist())


def _flow(stroke: Stroke, domain: Domain, table: Table) -> Resolved:
    row, axes, poisson = table[0], domain.packed(), poisson_of(stroke, time=domain.time)
    position, target = row["pivot"].copy(), row["pivot"] + row["force"]
    held, fixed = is_held(position, axes), axes[:, 2] >= 0
    if held and fixed.any():
        first, last = axes[:, 0], axes[:, 1]
        beta = beta_at(position, axes)  # 0 on a face, along which a point can only slide
        slides = fixed & (beta < 1e-100) & (np.abs(target - position) <= _ALONG * stroke.radius)
        target = np.where(slides, position, target)
        across = fixed & (target != position)  # the axes along which it has to leave its face
        beyond = across & ((target <= first) | (target >= last))
        if beyond.any() or np.any(across & (beta < 1e-100)):
            where = "it starts on the edge, and"
            if beyond.any():
                ends = ((axes[:, :2] / axes[:, 3:4])[: domain.ndim]).T.round().astype(int).tolist()
                where = f"its target is on the edge or outside of {located(ends[0])} to {located(ends[1])}, and"
            raise SuppleError(
                f"{described(stroke)} cannot arrive: {where} the border is fixed, so that what is on it only slides "
                f"along it, and nothing else gets there; use {argument('border', None)}, or points further in"
            )
    drag = target - position
    if not drag.any():
        return Resolved(table[:0], stroke.at)
    # A point outside a fixed border does not move; the brush passes there undamped.
    weights = axes if held and fixed.any() else None
    longest = (1 - FLOW_MARGIN) * limit(poisson, stroke.scales, stroke.reach, stroke.flat) * stroke.radius
    refused = held and math.hypot(*drag.tolist()) > MOST_SUBSTROKES * longest
    rows: list[Floats] = []
    margin, pieces = 1.0, 2.0
    while pieces > 1 and not refused:
        part = [1.0] * 3 if weights is None else beta_at(position, weights).tolist()
        left = (target - position).tolist()
        row["pivot"] = position
        row["force"] = [x / b if b > 0 else 0.0 for x, b in zip(left, part, strict=True)]
        lower, _ = weakest(table, axes, FLOW_MARGIN - 1, FLOW_GAP, mask_of(domain))
        pieces = max(float(np.ceil(-lower / (1 - FLOW_MARGIN) * (1 - 1e-9))), 1.0)
        # Close to a border steps are short, but they grow with β.
        least = min((b for b, x in zip(part, left, strict=True) if x != 0), default=1.0)
        slow = pieces * min(least, 1.0) > MOST_SUBSTROKES
        refused = slow or len(rows) == MOST_SUBSTROKES
        row["force"] /= pieces
        position = position + part * row["force"]
        margin = min(margin, 1 + lower / pieces)
        rows.append(numbers(table).copy())
    if refused:
        raise SuppleError(f"{described(stroke)} {too_many()}")
    table = np.concatenate(rows).view(table.dtype)[:, 0]  # as numbers: NumPy is slow to join records
    # The singular values of a row are at least its margin, those of all rows at least the product of the margins.
    if margin ** len(rows) < SQUEEZED and narrowest(table, domain, table[:1]["pivot"], drag[None]) < SQUEEZED:
        raise SuppleError(f"{described(stroke)} {too_narrow()}")
    arrived = _arrived(stroke, table, domain)
    return Resolved(table, arrived, margin=margin, cause=None if held else "outside")


def pulled(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve a grab of several handles: forces f_j at the handles, where Σ_j K_ij f_j is the drag of handle i."""
    axes = domain.packed()
    one = pack([replace(stroke, also=())], domain.spacing, time=domain.time)
    table = np.repeat(one, len(stroke.handles))
    table["pivot"], table["force"] = (padded(some, domain) for some in zip(*stroke.handles, strict=True))
    table["joined"][1:] = 1
    start, goal = table["pivot"].copy(), table["pivot"] + table["force"]
    free = freedom_at(start, domain)
    frozen = np.minimum(free, freedom_at(goal, domain)) <= FREE_ENOUGH
    frozen &= (start != goal).any(axis=1)
    if frozen.any():
        return _without(stroke, frozen, domain, on_fold)
    held = free if stroke.name == "push" else np.ones(len(start))
    goal = start + held[:, None] * (goal - start)  # to arrive at the edge, it would leave a notch beside it
    _check_handles(stroke, start, goal, domain, arrives=on_fold == "flow")
    if on_fold == "flow":
        made = _flow_together(stroke, domain, table, goal)
        return replace(made, cause="freeze") if held.min() < 1 else made
    table["force"] = _forces(table, goal - start, domain)
    _check_arrival(stroke, domain, _moved(table, domain, start), start, goal)
    # `sampled` bounds μ from above: where the lower bound is higher than that, it need not be closer.
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
    """Resolve a pull without the handles that start or end where it is frozen, so that the others arrive."""
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
    arrived = _arrived(stroke, made.rows, domain)
    cause = "fold and freeze" if made.cause == "fold" else "freeze"
    return replace(made, arrived=arrived, cause=cause, warning="; ".join(filter(None, (warning, made.warning))))


def _flow_together(stroke: Stroke, domain: Domain, table: Table, goal: Floats) -> Resolved:
    """Resolve a pull as groups, one after the other: all handles go straight to their targets, and arrive at once."""
    axes, start = domain.packed(), table["pivot"].copy()

    steps: dict[bytes, tuple[Table, float]] = {}

    def step(position: Floats) -> tuple[Table, float]:
        """Return the pull from a position to the goal, and an estimate of its μ; cached for the second pass."""
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

    # Proofs take most of the time: the first pass checks that the handles arrive, the second one proves.
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


def _check_handles(stroke: Stroke, start: Floats, goal: Floats, domain: Domain, *, arrives: bool) -> None:
    """Refuse handles that cannot arrive: equal places, a fixed edge, or equal targets where all must arrive."""
    axes = domain.packed()
    places: dict[Vector, int] = {}
    targets: dict[Vector, int] = {}
    first, last = axes[:, 0], axes[:, 1]
    fixed, beta = axes[:, 2] >= 0, beta_at(start, axes)
    for i, (a, b) in enumerate(zip(start, goal, strict=True)):
        other = places.setdefault(tuple(a.tolist()), i)
        if other != i:
            place = _place(stroke, i, domain)
            raise SuppleError(f"{described(stroke)} has two handles {place}, {other + 1} and {i + 1}: leave one out")
        other = targets.setdefault(tuple((b * 1e6).round().tolist()), i)
        if other != i and arrives:
            two = f"{_handle(stroke, other, domain)}, and {_handle(stroke, i, domain)}"
            raise SuppleError(f"{described(stroke)} has one target for two: {two}; give each its own, or leave one out")
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
    return f"at {'voxel ' * (domain.ndim == 3 and not domain.time)}{located(stroke.handles[i][0])}"


def _handle(stroke: Stroke, i: int, domain: Domain) -> str:
    """Name a handle in a message, by its number from 1 and its place."""
    return f"handle {i + 1}, {_place(stroke, i, domain)}"


def _conflict(stroke: Stroke, start: Floats, goal: Floats, domain: Domain) -> str:
    """Name the two handles whose distance changes most on their straight ways, at its worst, in a message."""
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
    if ways[0][i, j] < _MEETING * math.dist(start[i], start[j]):  # no radius helps
        return f"{one}, and {other}, meet on their straight ways; use other targets, or one stroke after the other"
    return f"{one}, and {other}, pull against each other; use a larger radius, or other targets"
