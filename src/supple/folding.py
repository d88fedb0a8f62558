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
border is fixed, or the reach limited, branch and bound finds μ (`_core/folds.hpp`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.domain import FREE, Domain, border_factor
from supple.errors import FoldError, SuppleError
from supple.strain import CLEARLY_SAFE, GAP, MARGIN, largest, limit, weakest
from supple.strokes import FoldPolicy, Stroke, numbers, pack

Floats = npt.NDArray[np.float64]
Table = npt.NDArray[np.void]

MOST_SUBSTROKES = 10_000

NEAR = 0.5
"""The distance from its target, in samples, within which a stroke's point has arrived."""

_SQUEEZED = 1e-5  # a sequence that leaves less of a length has lost too many digits to be undone
_ALONG = 1e-9  # of the radius: the rounding error of a drag along a face
_TOO_NARROW = (
    f"squeezes what lies around it more than {1 / _SQUEEZED:g} times, which could not be undone; use a larger radius, "
    "a point farther from the fixed border if there is one, or on_fold='damp'"
)
_FLOW_GAP = 0.05
_HIT = 1e-6  # samples: the accuracy of handles
_FLOW_MARGIN = 0.3  # substrokes are well-conditioned: Newton takes few steps, and errors grow little


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """The rows of a stroke, chosen so that the map does not fold.

    Parameters
    ----------
    rows : ndarray of STROKE_DTYPE
        The packed strokes to apply, one after the other; none for the identity.
    alpha : float
        The applied fraction of the drag: 1, unless it was damped.
    margin : float
        A proven lower bound of λ_min(sym(I + J_β)), for every row and at every point.
    arrived : tuple of float
        The position of the stroke's point after it, in samples.
    cause : str or None
        The cause of a miss: ``"fold"``, ``"border"``, ``"fold and border"``, ``"outside"`` if the stroke starts outside
        a fixed border, where it moves nothing; or None.
    warning : str or None
        The text of the warning if it was damped, or if its point ends more than half a sample from its target.
    """

    rows: Table
    arrived: tuple[float, ...]
    alpha: float = 1.0
    margin: float = 1.0
    cause: str | None = None
    warning: str | None = None

    @property
    def substrokes(self) -> int:
        """The number of rows that make up the stroke."""
        return len(self.rows)


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
        If it folds, or the border holds it back by more than half a sample, and ``on_fold`` is ``"error"``. The
        paper's border, ``"sine"``, only warns of strokes that it holds back.
    SuppleError
        If the stroke does not fit the domain; or, with ``"flow"``, if the fixed border keeps the held point from its
        target, or it would take more than `MOST_SUBSTROKES` strokes.
    """
    return _resolved(stroke, domain, on_fold)


# A stroke does not depend on those before it: after an edit, the rows of the others are reused.
@lru_cache(maxsize=4096)
def _resolved(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    made = _resolve(stroke, domain, on_fold)
    made.rows.flags.writeable = False
    return made


def _resolve(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    table = pack([stroke], domain.spacing, time=domain.time)
    axes = domain.packed()
    target = tuple(a + b for a, b in zip(stroke.at, stroke.by, strict=True))
    if stroke.is_still:
        return Resolved(table[:0], target)
    if stroke.brush != "grab":
        return _turned(stroke, domain, on_fold)
    if stroke.also:
        return _pulled(stroke, domain, on_fold)
    if stroke.path:
        if on_fold != "flow":
            raise SuppleError(f"{described(stroke)} follows a path, which takes on_fold='flow'")
        legs = [_resolve(leg, domain, on_fold) for leg in stroke.legs()]
        rows = np.concatenate([leg.rows for leg in legs])
        return Resolved(rows, legs[-1].arrived, margin=min(leg.margin for leg in legs), cause=legs[0].cause)
    if on_fold == "flow":
        return _flow(stroke, domain, table)
    lower, _ = weakest(table, axes)
    alpha = 1.0 if lower >= MARGIN - 1 else (1 - MARGIN) / -lower * (1 - 1e-14)
    folds = alpha < 1
    if folds and on_fold == "error":
        most = _shown(_cut(0.999 * alpha * x, 5) for x in stroke.by)
        raise FoldError(f"{described(stroke)} folds: at most {most} does not (on_fold='flow' goes all the way)")
    table["force"] *= alpha
    arrived, held = _arrived(stroke, table, domain), _held(table[0]["pivot"], axes)
    short = math.dist(arrived, target)
    held_back = math.dist(arrived, [a + alpha * b for a, b in zip(stroke.at, stroke.by, strict=True)]) > 1e-9
    cause = " and ".join(["fold"] * folds + ["border"] * held_back) or None
    if not held:
        held_back, cause = False, "outside"
    warning = None
    if folds or (short > NEAR and held):
        distance = f"{short:.3g} {'pixels' if domain.ndim == 2 else 'samples'}"
        border = "the fixed border holds it back" if held_back else ""
        if folds:
            why = f"folds: damped to {_cut(alpha, 2):g} of it{', and ' * held_back}{border}, it ends {distance} short"
        else:
            why = f"ends {distance} short: {border}"
        helps = "on_fold='flow' goes all the way" + (", border=None frees the border" if held_back else "")
        warning = f"{described(stroke)} {why} ({helps})"
        # The paper's border held strokes back without a warning, as did recipes of version 1: results stay the same.
        if on_fold == "error" and domain.border_profile != "sine":
            raise FoldError(warning)
    return Resolved(table, arrived, alpha, 1 + alpha * lower, cause, warning)


def _turned(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve an affine brush: its pivot stays, and equal parts of it add up to the whole there."""
    axes, weights = domain.packed(), np.ones(3)
    held = _held(_padded(stroke, domain), axes)
    if held and on_fold == "flow":
        weights = _beta(_padded(stroke, domain), axes)
        needed = np.abs(stroke.matrix(domain.spacing, time=domain.time)).sum(axis=1) > 0
        if np.any(needed & (weights < 1e-100)):
            raise SuppleError(
                f"{described(stroke)} cannot be carried out: its pivot is on the edge, and the border is fixed, so "
                "that what is on it only slides along it; use border=None, or a point further in"
            )
        weights = np.where(needed, weights, 1.0)

    def rows(part: float) -> Table:
        table = pack([stroke.weakened(part)], domain.spacing, time=domain.time)
        table["matrix"] /= weights[:, None]
        return table

    def lowest(part: float, target: float, gap: float) -> float:
        return weakest(rows(part), axes, target, gap)[0]

    # At the pivot, λ_min is the angle's cosine: 0 at a quarter turn, and the same again after a whole one.
    quarters = abs(stroke.angle or 0.0) / 90
    if on_fold == "flow":
        pieces = max(math.ceil(quarters), 1)
        lower = lowest(1 / pieces, _FLOW_MARGIN - 1, _FLOW_GAP)
        while lower < (_FLOW_MARGIN - 1) * (1 + 1e-9):
            pieces = max(pieces + 1, math.ceil(pieces * min(-lower / (1 - _FLOW_MARGIN), 1e4) * (1 - _FLOW_GAP)))
            if pieces > MOST_SUBSTROKES:
                raise SuppleError(
                    f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; use "
                    "a point further from the border, or on_fold='damp'"
                )
            lower = lowest(1 / pieces, _FLOW_MARGIN - 1, _FLOW_GAP)
        table, start = np.repeat(rows(1 / pieces), pieces), _padded(stroke, domain)
        if _narrowest(table, axes, np.tile(start, (3, 1)), stroke.radius * np.eye(3)) < _SQUEEZED:
            raise SuppleError(f"{described(stroke)} {_TOO_NARROW}")
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
            raise FoldError(f"{described(stroke)} folds: at most {most} does not (on_fold='flow' goes all the way)")
        warning = f"{described(stroke)} folds: damped to {_cut(alpha, 2):g} of it (on_fold='flow' goes all the way)"
    cause = "outside" if not held else "fold" if alpha < 1 else None
    return Resolved(rows(alpha), stroke.at, alpha, 1 + lower, cause, warning)


def _pulled(stroke: Stroke, domain: Domain, on_fold: FoldPolicy) -> Resolved:
    """Resolve a grab of several handles: forces f_j at the handles, with Σ_j K_ij f_j the displacement of each."""
    axes, ndim = domain.packed(), domain.ndim
    single = [replace(stroke, at=at, by=by, also=()) for at, by in stroke.handles]
    table = pack(single, domain.spacing, time=domain.time)
    table["joined"][1:] = 1
    start, goal = table["pivot"].copy(), table["pivot"] + table["force"]
    _check_handles(stroke, start, goal, axes)
    groups: list[Table] = []
    position, margin, pieces = start.copy(), 1.0, 2
    while pieces > 1:
        table["pivot"] = position
        table["force"] = _forces(table, goal - position, axes, ndim)
        if on_fold != "flow":
            lower, _ = weakest(table, axes)
            whole, _ = _core.forward(numbers(table), axes, start, False)
            missed = float(np.linalg.norm(whole - goal, axis=1).max())
            break
        lower, _ = weakest(table, axes, _FLOW_MARGIN - 1, _FLOW_GAP)
        pieces = max(math.ceil(np.nan_to_num(-lower, nan=1e9, posinf=1e9) / (1 - _FLOW_MARGIN) * (1 - 1e-9)), 1)
        margin = min(margin, 1 + lower / pieces)
        table["force"] /= pieces
        table["most"] = largest(table, axes)
        groups.append(table.copy())
        position, _ = _core.forward(numbers(table), axes, position, False)
        if pieces > MOST_SUBSTROKES or len(groups) * len(table) > MOST_SUBSTROKES:
            raise SuppleError(f"{described(stroke)} cannot arrive without a fold: {_conflict(stroke, start, position)}")
    if on_fold == "flow":
        missed = float(np.linalg.norm(position - goal, axis=1).max())
    if not missed <= _HIT * min(domain.spacing):  # also for NaN
        raise SuppleError(f"{described(stroke)} cannot arrive: {_conflict(stroke, start, goal)}")
    if on_fold == "flow":
        if _narrowest(np.concatenate(groups), axes, start, goal - start) < _SQUEEZED:
            raise SuppleError(f"{described(stroke)} {_TOO_NARROW}")
        return Resolved(np.concatenate(groups), tuple((position[0, :ndim] / domain.spacing).tolist()), margin=margin)
    alpha = 1.0 if lower >= MARGIN - 1 else (1 - MARGIN) / -lower * (1 - 1e-14)
    warning = None
    if alpha < 1:
        if on_fold == "error":
            raise FoldError(
                f"{described(stroke)} folds: at most {_cut(0.999 * alpha, 3):g} of it does not (on_fold='flow' goes "
                f"all the way); {_conflict(stroke, start, goal)}"
            )
        warning = f"{described(stroke)} folds: damped to {_cut(alpha, 2):g} of it (on_fold='flow' goes all the way)"
    table["force"] *= alpha
    table["most"] = largest(table, axes)
    arrived = tuple(a + alpha * b for a, b in zip(stroke.at, stroke.by, strict=True))
    return Resolved(table, arrived, alpha, 1 + alpha * lower, "fold" if alpha < 1 else None, warning)


def _check_handles(stroke: Stroke, start: Floats, goal: Floats, axes: Floats) -> None:
    """Refuse handles that cannot arrive: at one place, or on a fixed edge."""
    places: dict[tuple[float, ...], int] = {}
    first, last = axes[:, 0], axes[:, 1]
    fixed = axes[:, 2] >= 0
    for i, (a, b) in enumerate(zip(start, goal, strict=True)):
        other = places.setdefault(tuple(a.tolist()), i)
        if other != i:
            raise SuppleError(f"{described(stroke)} has two handles at {_shown(stroke.handles[i][0])}: leave one out")
        across = fixed & (a != b)
        out = across & ((b <= first) | (b >= last) | (_beta(a, axes) < 1e-100))
        if out.any() or not _held(a, axes):
            raise SuppleError(
                f"{described(stroke)} cannot arrive: the handle at {_shown(stroke.handles[i][0])} starts or ends on "
                "the edge or outside, where the border is fixed; use border=None, or points further in"
            )


def _forces(table: Table, drags: Floats, axes: Floats, ndim: int) -> Floats:
    """Return forces (N, 3) whose displacements at the pivots add up to the drags (N, 3)."""
    pivots, n = table["pivot"], len(table)
    moving = np.array([_beta(p, axes) > 1e-100 for p in pivots])
    moving[:, ndim:] = False
    columns = []
    for j, d in zip(*np.nonzero(moving), strict=True):
        unit = table[j : j + 1].copy()
        unit["joined"], unit["force"] = 0, np.eye(3)[d]
        there, _ = _core.forward(numbers(unit), axes, pivots, False)
        columns.append((there - pivots)[moving])
    forces = np.zeros((n, 3))
    if columns:
        matrix = np.stack(columns, axis=1)
        try:
            forces[moving] = np.linalg.solve(matrix, drags[moving])
        except np.linalg.LinAlgError:
            forces[moving] = np.linalg.lstsq(matrix, drags[moving], rcond=1e-13)[0]
    return forces


def _conflict(stroke: Stroke, start: Floats, now: Floats) -> str:
    """Name the two handles that have come nearest to each other, or farthest apart, from where they were."""
    before = np.linalg.norm(start[:, None] - start, axis=2)
    after = np.linalg.norm(now[:, None] - now, axis=2)
    np.fill_diagonal(before, 1.0)
    np.fill_diagonal(after, 1.0)
    with np.errstate(divide="ignore"):
        i, j = np.unravel_index(np.argmax(np.abs(np.log(after / before))), before.shape)
    (a, u), (b, v) = stroke.handles[i], stroke.handles[j]
    return (
        f"the handles at {_shown(a)} and {_shown(b)}, dragged by {_shown(u)} and {_shown(v)}, "
        "pull against each other; use a larger radius, or other targets"
    )


def _padded(stroke: Stroke, domain: Domain) -> Floats:
    """Return a stroke's pivot in physical units, with a third coordinate."""
    made = np.zeros(3)
    made[: domain.ndim] = np.multiply(stroke.at, domain.spacing)
    return made


def _arrived(stroke: Stroke, table: Table, domain: Domain) -> tuple[float, ...]:
    """Return the position of the stroke's point after these rows, in samples."""
    moved, _ = _core.forward(numbers(table), domain.packed(), _padded(stroke, domain)[None], False)
    return tuple((moved[0, : domain.ndim] / domain.spacing).tolist())


def _flow(stroke: Stroke, domain: Domain, table: Table) -> Resolved:
    row, axes, poisson = table[0], domain.packed(), stroke.material(time=domain.time)
    position, target = row["pivot"].copy(), row["pivot"] + row["force"]
    held, fixed = _held(position, axes), axes[:, 2] >= 0
    if held and fixed.any():
        first, last = axes[:, 0], axes[:, 1]
        beta = _beta(position, axes)  # a point on a face only slides along it
        slides = fixed & (beta < 1e-100) & (np.abs(target - position) <= _ALONG * stroke.radius)
        target = np.where(slides, position, target)
        across = fixed & (target != position)  # the axes along which it has to leave its face
        beyond = across & ((target <= first) | (target >= last))
        if beyond.any() or np.any(across & (beta < 1e-100)):
            where = "its target is on the edge or outside, and" if beyond.any() else "it starts on the edge, and"
            raise SuppleError(
                f"{described(stroke)} cannot arrive: {where} the border is fixed, so that what is on it only slides "
                "along it, and nothing else gets there; use border=None, or points further in"
            )
    drag = target - position
    if not drag.any():
        return Resolved(table[:0], stroke.at)
    # A point outside a fixed border is not moved; a brush only passes there.
    weights = axes if held else np.array([FREE] * 3)
    longest = (1 - _FLOW_MARGIN) * limit(poisson, stroke.scales, stroke.reach) * stroke.radius
    refused = held and math.hypot(*drag.tolist()) > MOST_SUBSTROKES * longest
    rows: list[Floats] = []
    margin, pieces = 1.0, 2.0
    while pieces > 1 and not refused:
        beta, left = _beta(position, weights), target - position
        row["pivot"] = position
        row["force"] = np.divide(left, beta, out=np.zeros(3), where=beta > 0)
        lower, _ = weakest(table, axes, _FLOW_MARGIN - 1, _FLOW_GAP)
        pieces = max(float(np.ceil(-lower / (1 - _FLOW_MARGIN) * (1 - 1e-9))), 1.0)
        # Close to a border steps are short, but they grow with β.
        least = min((b for b, x in zip(beta.tolist(), left.tolist(), strict=True) if x != 0), default=1.0)
        slow = pieces * min(least, 1.0) > MOST_SUBSTROKES
        refused = slow or len(rows) == MOST_SUBSTROKES
        row["force"] /= pieces
        position = position + beta * row["force"]
        margin = min(margin, 1 + lower / pieces)
        rows.append(numbers(table).copy())
    if refused:
        raise SuppleError(
            f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; "
            "use a larger radius, or on_fold='damp'"
        )
    table = np.concatenate(rows).view(table.dtype)[:, 0]  # as numbers: NumPy is slow to join records
    if _narrowest(table, axes, table[:1]["pivot"], drag[None]) < _SQUEEZED:
        if not held:
            raise SuppleError(
                f"{described(stroke)} starts outside, where nothing is held, and squeezes what lies on its way against "
                "the fixed border; use a point inside, border=None, or on_fold='damp'"
            )
        raise SuppleError(
            f"{described(stroke)} squeezes what lies before it more than {1 / _SQUEEZED:g} times, which could not be "
            "undone; use a target farther from the fixed border, a wider border or border=None, or on_fold='damp'"
        )
    arrived = _arrived(stroke, table, domain)
    return Resolved(table, arrived, margin=margin, cause=None if held else "outside")


def _narrowest(table: Table, axes: Floats, starts: Floats, drags: Floats) -> float:
    """Return the smallest singular value of the sequence's Jacobian found along some ways (N, 3) and around them."""
    along = np.linspace(-1.0, 4.0, max(401 // len(starts), 16))
    ahead = (starts[:, None] + drags[:, None] * along[:, None]).reshape(-1, 3).T
    start = starts[0]
    first, last, sigma = axes[:, :3].T
    points, fixed = ahead, sigma >= 0
    if fixed.any():
        extent = np.where(fixed, last - first, 0.0)
        parts = np.stack(np.meshgrid(*[np.linspace(0, 1, 17 if e > 0 else 1) for e in extent]), axis=0).reshape(3, -1)
        around = np.where(extent[:, None] > 0, first[:, None] + parts * extent[:, None], start[:, None])
        points = np.concatenate([ahead, around], axis=1)
        points = np.where(fixed[:, None], np.clip(points, first[:, None], last[:, None]), points)
    _, jacobian = _core.forward(numbers(table), axes, np.ascontiguousarray(points.T), True)
    if not np.isfinite(jacobian).all():
        return 0.0
    if axes[2, 1] == axes[2, 0] and axes[2, 2] < 0:  # for an image, only the plane counts
        (a, b), (c, d) = jacobian[:, :2, :2].transpose(1, 2, 0)
        widest = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))
        return float((np.abs(a * d - b * c) / np.maximum(widest, 1e-300)).min())
    return float(np.linalg.svd(jacobian, compute_uv=False).min())


def _held(position: Floats, axes: Floats) -> bool:
    """Return whether a point is within the fixed faces, where strokes move points."""
    faces = zip(position.tolist(), axes.tolist(), strict=True)
    return all(sigma < 0 or first <= x <= last for x, (first, last, sigma, *_) in faces)


def _beta(position: Floats, axes: Floats) -> Floats:
    first, last, sigma, _, profile = axes.T
    if (sigma < 0).all():
        return np.ones(3)
    depth = np.minimum(position - first, last - position)
    beta = border_factor(np.divide(depth, sigma, out=np.zeros(3), where=sigma > 0), profile[0])
    return np.where(sigma < 0, 1.0, beta)


def described(stroke: Stroke) -> str:
    """Name a stroke in a message."""
    where = f"at {_shown(stroke.at)} with radius {stroke.radius:g}"
    if stroke.also:
        return f"a pull of {len(stroke.handles)} handles from {_shown(stroke.at)} on with radius {stroke.radius:g}"
    if stroke.brush == "grab":
        return f"a drag by {_shown(stroke.by)} {where}"
    amount = f"{stroke.angle:g}°" if stroke.angle is not None else f"{stroke.factor:g}"
    return f"a {stroke.brush} by {amount} {where}"


def _shown(values: Iterable[float]) -> str:
    return f"({', '.join(f'{x + 0.0:g}' for x in values)})"


def _cut(x: float, digits: int) -> float:
    """Return a value rounded towards zero, so that a stated limit is never above the true one."""
    import decimal

    return float(decimal.Context(prec=digits, rounding=decimal.ROUND_DOWN).create_decimal_from_float(x))
