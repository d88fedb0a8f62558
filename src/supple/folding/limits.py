"""The limit of a stroke's strength, and the handling of strokes beyond it.

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
from supple.errors import FoldError, Spelling, SuppleError, argument, current_spelling
from supple.folding.pulls import pulled
from supple.folding.resolved import (
    FLOW_GAP,
    FLOW_MARGIN,
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
    narrowest,
    padded,
    spelled,
    too_narrow,
)
from supple.folding.strain import CLEARLY_SAFE, GAP, MARGIN, limit, mask_of, weakest
from supple.space.domain import Domain
from supple.strokes import FoldPolicy, Stroke, legs, matrix_of, numbers, pack, poisson_of

NEAR = 0.5
"""The distance from its target, in samples, within which a stroke's point has arrived."""

_ALONG = 1e-9  # of the radius: the rounding error of a drag along a face


def resolve(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Return a stroke's safe rows: λ_min(sym(I + J_β)) ≥ m at every point, proven.

    Parameters
    ----------
    stroke : Stroke
    domain : Domain
    on_fold : str
        ``"flow"`` applies any drag, as a sequence of strokes whose pivots move along with the held point, until that is
        at its target: a fixed border does not hold it back either. ``"damp"`` scales a drag that folds to the largest
        one that does not, within 0.2 %; ``"error"`` refuses it.

    Raises
    ------
    FoldError
        If it folds, or the border or a freeze mask holds it back by more than half a sample, and ``on_fold`` is
        ``"error"``. The paper's border, ``"sine"``, only warns of strokes that it holds back.
    SuppleError
        If the stroke does not fit the domain; or, with ``"flow"``, if the fixed border keeps the held point from its
        target, or it would take more than `MOST_SUBSTROKES` strokes.
    """
    return _resolved(stroke, domain, on_fold, current_spelling())  # which its warning follows


# A stroke does not depend on those before it: after an edit, the rows of the others are reused.
@lru_cache(maxsize=4096)
def _resolved(stroke: Stroke, domain: Domain, on_fold: FoldPolicy, spelling: Spelling) -> Resolved:
    made = _resolve(stroke, domain, on_fold)
    if mask_of(domain) is not None and not stroke.also and not stroke.is_still and made.warning is None:
        made = _held_back(stroke, domain, on_fold, made)
    made.rows.flags.writeable = False
    return made


def _held_back(stroke: Stroke, domain: Domain, on_fold: FoldPolicy, made: Resolved) -> Resolved:
    """Say if what is frozen holds a stroke back: it multiplies its displacement, and nothing makes up for that."""
    if stroke.brush != "grab":
        part = float(freedom_at(padded(stroke.at, domain)[None], domain)[0])
        if part > 0.99:
            return made
        why = "its pivot is frozen" if part == 0 else f"at its pivot, it is {part:.0%} of that: what is frozen is near"
        warning = f"{described(stroke)} is held back: {why}"
        if on_fold == "error":
            raise FoldError(warning)
        return replace(made, cause="freeze", warning=warning)
    arrived = _arrived(stroke, made.rows, domain)
    target = np.add(stroke.at, stroke.by).tolist()
    if math.dist(arrived, target) <= NEAR:
        return made
    warning = f"{described(stroke)} ends {apart(arrived, target, domain)} short: what is frozen holds it back"
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
    """Resolve an affine brush or a twist: its pivot stays, and equal parts of it add up to the whole there."""
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

    # At the pivot, λ_min is the angle's cosine: 0 at a quarter turn, and the same again after a whole one.
    quarters = abs(stroke.angle or 0.0) / 90
    if on_fold == "flow":
        pieces = max(math.ceil(quarters), 1)
        lower = lowest(1 / pieces, FLOW_MARGIN - 1, FLOW_GAP)
        while lower < (FLOW_MARGIN - 1) * (1 + 1e-9):
            pieces = max(pieces + 1, math.ceil(pieces * min(-lower / (1 - FLOW_MARGIN), 1e4) * (1 - FLOW_GAP)))
            if pieces > MOST_SUBSTROKES:
                raise SuppleError(
                    f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; use "
                    f"a point further from the border, or {argument('on_fold', 'damp')}"
                )
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
    half = 0.505 * float(np.abs(r * np.gradient(phi, r)).max())  # a hundredth more than is seen
    return math.hypot(1, half) - half


def _arrived(stroke: Stroke, table: Table, domain: Domain) -> tuple[float, ...]:
    """Return the position of the stroke's point after these rows, in samples."""
    moved, _ = _core.forward(numbers(table), domain.packed(), padded(stroke.at, domain)[None], False, mask_of(domain))
    return tuple((moved[0, : domain.ndim] / domain.spacing).tolist())


def _flow(stroke: Stroke, domain: Domain, table: Table) -> Resolved:
    row, axes, poisson = table[0], domain.packed(), poisson_of(stroke, time=domain.time)
    position, target = row["pivot"].copy(), row["pivot"] + row["force"]
    held, fixed = is_held(position, axes), axes[:, 2] >= 0
    if held and fixed.any():
        first, last = axes[:, 0], axes[:, 1]
        beta = beta_at(position, axes)  # a point on a face only slides along it
        slides = fixed & (beta < 1e-100) & (np.abs(target - position) <= _ALONG * stroke.radius)
        target = np.where(slides, position, target)
        across = fixed & (target != position)  # the axes along which it has to leave its face
        beyond = across & ((target <= first) | (target >= last))
        if beyond.any() or np.any(across & (beta < 1e-100)):
            where = "it starts on the edge, and"
            if beyond.any():
                ends = ((axes[:, :2] / axes[:, 3:4])[: domain.ndim]).T.round().astype(int).tolist()
                where = f"its target is on the edge or outside of {tuple(ends[0])} to {tuple(ends[1])}, and"
            raise SuppleError(
                f"{described(stroke)} cannot arrive: {where} the border is fixed, so that what is on it only slides "
                f"along it, and nothing else gets there; use {argument('border', None)}, or points further in"
            )
    drag = target - position
    if not drag.any():
        return Resolved(table[:0], stroke.at)
    # A point outside a fixed border is not moved; a brush only passes there.
    weights = axes if held and fixed.any() else None
    longest = (1 - FLOW_MARGIN) * limit(poisson, stroke.scales, stroke.reach) * stroke.radius
    refused = held and math.hypot(*drag.tolist()) > MOST_SUBSTROKES * longest
    rows: list[npt.NDArray[np.float64]] = []
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
        raise SuppleError(
            f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; "
            f"use a larger radius, or {argument('on_fold', 'damp')}"
        )
    table = np.concatenate(rows).view(table.dtype)[:, 0]  # as numbers: NumPy is slow to join records
    # No row's singular values are below its margin, nor those of all rows below the margins' product.
    if margin ** len(rows) < SQUEEZED and narrowest(table, domain, table[:1]["pivot"], drag[None]) < SQUEEZED:
        if not held:
            raise SuppleError(
                f"{described(stroke)} starts outside, where nothing is held, and squeezes what lies on its way against "
                f"the fixed border; use a point inside, {argument('border', None)}, or {argument('on_fold', 'damp')}"
            )
        raise SuppleError(
            f"{described(stroke)} squeezes what lies before it more than {1 / SQUEEZED:g} times, which could not be "
            f"undone; use a target farther from the fixed border, a wider border or {argument('border', None)}, or "
            f"{argument('on_fold', 'damp')}"
        )
    arrived = _arrived(stroke, table, domain)
    return Resolved(table, arrived, margin=margin, cause=None if held else "outside")
