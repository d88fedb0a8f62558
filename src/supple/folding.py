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
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.domain import FREE, Domain, border_factor
from supple.errors import FoldError, SuppleError
from supple.strokes import FoldPolicy, Stroke, numbers, pack

Floats = npt.NDArray[np.float64]
Table = npt.NDArray[np.void]

MARGIN = 0.01
"""The least m of every stroke."""

CLEARLY_SAFE = -0.5 * (1 - MARGIN)
"""The value of μ above which no closer bound is needed."""

MOST_SUBSTROKES = 10_000

NEAR = 0.5
"""The distance from its target, in samples, within which a stroke's point has arrived."""

_SQUEEZED = 1e-5  # a sequence that leaves less of a length has lost too many digits to be undone
_ALONG = 1e-9  # of the radius: the rounding error of a drag along a face
_GAP = 0.002
_FARTHEST = 1000.0  # radii
_FREE_GAP = 1e-9  # computed once for all strokes of a kind
_FLOW_GAP = 0.05
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
    if on_fold == "flow":
        return _flow(stroke, domain, table[0])
    lower, _ = weakest(table[0], axes)
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
                f"{described(stroke)} cannot be carried out: its pivot is on the edge, and the border is fixed, so that "
                "what is on it only slides along it; use border=None, or a point further in"
            )
        weights = np.where(needed, weights, 1.0)

    def rows(part: float) -> Table:
        table = pack([stroke.weakened(part)], domain.spacing, time=domain.time)
        table["matrix"] /= weights[:, None]
        return table

    def lowest(part: float, target: float, gap: float) -> float:
        return weakest(rows(part)[0], axes, target, gap)[0]

    turns = abs(stroke.angle or 0.0) / 180  # half ones: beyond one, the matrix is that of a smaller angle
    if on_fold == "flow":
        pieces = max(1, math.ceil(turns))
        lower = lowest(1 / pieces, _FLOW_MARGIN - 1, _FLOW_GAP)
        while lower < (_FLOW_MARGIN - 1) * (1 + 1e-9):
            pieces = max(pieces + 1, math.ceil(pieces * min(-lower / (1 - _FLOW_MARGIN), 1e4) * (1 - _FLOW_GAP)))
            if pieces > MOST_SUBSTROKES:
                raise SuppleError(
                    f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; use "
                    "a point further from the border, or on_fold='damp'"
                )
            lower = lowest(1 / pieces, _FLOW_MARGIN - 1, _FLOW_GAP)
        return Resolved(np.repeat(rows(1 / pieces), pieces), stroke.at, margin=1 + lower, cause=None if held else "outside")
    alpha = min(1.0, 1 / turns) if turns else 1.0
    lower = lowest(alpha, CLEARLY_SAFE, _GAP)
    if lower < MARGIN - 1:
        safe, folds = 0.0, alpha
        while folds - safe > 0.5 * _GAP * folds:
            middle = (safe + folds) / 2
            bound = lowest(middle, MARGIN - 1, _GAP)
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


def _padded(stroke: Stroke, domain: Domain) -> Floats:
    """Return a stroke's pivot in physical units, with a third coordinate."""
    made = np.zeros(3)
    made[: domain.ndim] = np.multiply(stroke.at, domain.spacing)
    return made


def _arrived(stroke: Stroke, table: Table, domain: Domain) -> tuple[float, ...]:
    """Return the position of the stroke's point after these rows, in samples."""
    moved, _ = _core.forward(numbers(table), domain.packed(), _padded(stroke, domain)[None], False)
    return tuple((moved[0, : domain.ndim] / domain.spacing).tolist())


def _flow(stroke: Stroke, domain: Domain, row: np.void) -> Resolved:
    axes, poisson = domain.packed(), stroke.material(time=domain.time)
    position, target = row["pivot"].copy(), row["pivot"] + row["force"]
    first, last, sigma, _, _ = axes.T
    fixed, held = sigma >= 0, _held(position, axes)
    if held:  # a point on a face only slides along it
        slides = fixed & (_beta(position, axes) < 1e-100) & (np.abs(target - position) <= _ALONG * stroke.radius)
        target = np.where(slides, position, target)
    drag = target - position
    across = held & fixed & (drag != 0)  # the axes along which it has to leave its face
    beyond = across & ((target <= first) | (target >= last))
    if beyond.any() or np.any(across & (_beta(position, axes) < 1e-100)):
        where = "its target is on the edge or outside, and" if beyond.any() else "it starts on the edge, and"
        raise SuppleError(
            f"{described(stroke)} cannot arrive: {where} the border is fixed, so that what is on it only slides along "
            "it, and nothing else gets there; use border=None, or points further in"
        )
    if not drag.any():
        return Resolved(np.zeros(0, row.dtype), stroke.at)
    # A point outside a fixed border is not moved; a brush only passes there.
    weights = axes if held else np.array([FREE] * 3)
    longest = (1 - _FLOW_MARGIN) * limit(poisson, stroke.scales, stroke.reach) * stroke.radius
    refused = held and math.hypot(*drag.tolist()) > MOST_SUBSTROKES * longest
    rows: list[np.void] = []
    margin, pieces = 1.0, 2.0
    while pieces > 1 and not refused:
        beta, left = _beta(position, weights), target - position
        row["pivot"] = position
        row["force"] = np.divide(left, beta, out=np.zeros(3), where=beta > 0)
        lower, _ = weakest(row, axes, _FLOW_MARGIN - 1, _FLOW_GAP)
        pieces = max(float(np.ceil(-lower / (1 - _FLOW_MARGIN) * (1 - 1e-9))), 1.0)
        # Close to a border steps are short, but they grow with β.
        slow = pieces * float(np.min(beta, where=left != 0, initial=1.0)) > MOST_SUBSTROKES
        refused = slow or len(rows) == MOST_SUBSTROKES
        row["force"] /= pieces
        position = position + beta * row["force"]
        margin = min(margin, 1 + lower / pieces)
        rows.append(row.copy())
    if refused:
        raise SuppleError(
            f"{described(stroke)} would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; "
            "use a larger radius, or on_fold='damp'"
        )
    table = np.array(rows)
    if _narrowest(table, axes, table[0]["pivot"], drag) < _SQUEEZED:
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


def _narrowest(table: Table, axes: Floats, start: Floats, drag: Floats) -> float:
    """Return the smallest singular value of the sequence's Jacobian found along its path and around it."""
    ahead = start[:, None] + drag[:, None] * np.linspace(-1.0, 4.0, 401)
    first, last, sigma = axes[:, :3].T
    extent = np.where(sigma >= 0, last - first, 0.0)
    parts = np.stack(np.meshgrid(*[np.linspace(0, 1, 17 if e > 0 else 1) for e in extent]), axis=0).reshape(3, -1)
    around = np.where(extent[:, None] > 0, first[:, None] + parts * extent[:, None], start[:, None])
    points = np.concatenate([ahead, around], axis=1)
    points = np.where((sigma >= 0)[:, None], np.clip(points, first[:, None], last[:, None]), points)
    _, jacobian = _core.forward(numbers(table), axes, np.ascontiguousarray(points.T), True)
    if not np.isfinite(jacobian).all():
        return 0.0
    n = 2 if axes[2, 1] == axes[2, 0] and axes[2, 2] < 0 else 3  # for an image, only the plane counts
    return float(np.linalg.svd(jacobian[:, :n, :n], compute_uv=False).min())


def _held(position: Floats, axes: Floats) -> bool:
    """Return whether a point is within the fixed faces, where strokes move points."""
    first, last, sigma = axes[:, :3].T
    return bool(np.all((sigma < 0) | ((position >= first) & (position <= last))))


def _beta(position: Floats, axes: Floats) -> Floats:
    first, last, sigma, _, profile = axes.T
    depth = np.minimum(position - first, last - position)
    beta = border_factor(np.divide(depth, sigma, out=np.zeros(3), where=sigma > 0), profile[0])
    return np.where(sigma < 0, 1.0, beta)


def described(stroke: Stroke) -> str:
    """Name a stroke in a message."""
    where = f"at {_shown(stroke.at)} with radius {stroke.radius:g}"
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


def limit(poisson: float, scales: int, reach: float | None = None) -> float:
    """Return the largest |f|/ε of a stroke with a free border: there, λ_min(sym(I + J)) reaches 0.

    Parameters
    ----------
    poisson : float
    scales : int
    reach : float or None
        The reach in radii. With one, the value returned is smaller by a factor of 1 - 10⁻⁹ at most.
    """
    return -1 / _free(poisson, scales, math.inf if reach is None else reach)[0]


@lru_cache(maxsize=1024)
def _free(poisson: float, scales: int, reach: float) -> tuple[float, float, float]:
    """Return bounds of μ for |f| = ε = 1 and a free border, and the place of the upper bound ahead of the pivot."""
    stroke = Stroke(at=(0.0, 0.0), by=(1.0, 0.0), radius=1.0, poisson=poisson, scales=scales)
    row = pack([stroke], (1.0, 1.0))[0]
    if reach < math.inf:
        row["reach"] = reach
        return _core.smallest_free_strain(_numbers(row), _FREE_GAP)
    e, a, g = row["radius2"], row["p"] + row["r"], row["q"] - row["r"] * row["radius2"]

    def slope(u: float) -> float:
        return -math.sqrt(u) * float(np.sum((a + 3 * g / (u + e)) * (u + e) ** -1.5))

    def bend(u: float) -> float:
        v = u / (u + e)
        return float(np.sum((a * (3 * v - 1) + 3 * g / (u + e) * (5 * v - 1)) * (u + e) ** -1.5))

    if scales == 1:
        half = 3 * g[0] / a[0] - 0.75
        worst = math.sqrt(half**2 + 7.5 * g[0] / a[0]) - half - 1
    else:
        worst, high = 0.05, 0.5
        for _ in range(60):
            middle = (worst + high) / 2
            worst, high = (middle, high) if bend(middle) < 0 else (worst, middle)
    return slope(worst) * (1 + 1e-12), slope(worst) * (1 - 1e-12), math.sqrt(worst)


def weakest(row: np.void, axes: Floats, target: float = CLEARLY_SAFE, gap: float = _GAP) -> tuple[float, float]:
    """Return lower and upper bounds of μ for one row.

    Parameters
    ----------
    row : void of STROKE_DTYPE
    axes : ndarray, shape (3, 5)
        The packed domain. Where it is free, the bounds hold for all of space.
    target : float
        The value above which the lower bound need not be close to the upper one; 0 for a close one always.
    gap : float
        The relative gap of the bounds. Rounding and the limited number of boxes can leave a larger one, if |μ| is very
        small or the volume very anisotropic.
    """
    free, active = axes[:, 2] < 0, (axes[:, 1] > axes[:, 0]) & (axes[:, 2] > 0)
    if row["power"] != 1:
        return _core.smallest_strain(_numbers(row), _around(row, axes), -math.inf, 0.0, target, gap)
    # In a plane through the pivot, the force across it has no displacement within it.
    force = np.where(~free & ~active & (row["pivot"] == axes[:, 0]), 0.0, row["force"])
    size = math.hypot(*force.tolist())
    if size == 0 or not (active.any() or free.all()):
        return 0.0, 0.0
    unit, radius = row.copy(), math.sqrt(row["radius2"][0])
    unit["force"] = force / size
    lower, upper, distance = _free(_poisson(row), int(row["terms"]), row["reach"] / radius)
    lower, upper, distance = lower / radius, upper / radius, distance * radius
    if active.any():
        above = target / size * (1 - 1e-12)  # so that rounding does not put the result below it
        lower, upper = _core.smallest_strain(_numbers(unit), axes, lower, distance, above, gap)
    return lower * size, upper * size


def _around(row: np.void, axes: Floats) -> Floats:
    """Return the domain; all of space, as far as a row reaches, if no axis is fixed."""
    if not np.all(axes[:, 2] < 0):
        return axes
    # Without a limit, the strain is below 1e-8 of the matrix from there on.
    reach = min(float(row["reach"]), _FARTHEST * math.sqrt(row["radius2"][0]))
    # Beside an image of one row, points move, too; not beside its plane.
    around = axes.copy()
    bends = np.array([True, True, axes[2, 1] > axes[2, 0] or row["matrix"][2].any() or row["matrix"][:, 2].any()])
    around[:, 0] = np.where(bends, row["pivot"] - reach, axes[:, 0])
    around[:, 1] = np.where(bends, row["pivot"] + reach, axes[:, 1])
    return around


def _numbers(row: np.void) -> Floats:
    return numbers(np.array([row]))


def _poisson(row: np.void) -> float:
    ratio = row["r"][0] / (row["p"][0] + row["r"][0])
    return min(1 - 1 / (4 * float(ratio)), 0.5) if ratio > 0 else -math.inf
