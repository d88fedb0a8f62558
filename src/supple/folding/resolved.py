"""The result of resolving a stroke: its rows; and functions shared by the modules that resolve."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import numbers
from supple.engine.work import mask_of
from supple.errors import OutsideWarning, argument, current_spelling, numbered, shown, warn
from supple.space.domain import Domain, border_factor
from supple.space.geometry import Floats
from supple.strokes import Stroke

Table = npt.NDArray[np.void]

MOST_SUBSTROKES = 10_000
FLOW_GAP = 0.05
FLOW_MARGIN = 0.3  # substrokes are well-conditioned: Newton takes few steps, and errors grow little
FREE_ENOUGH = 0.1  # where the mask's factor is less, handles of pulls, restores and smooths are dropped
SQUEEZED = 1e-5  # a sequence that shrinks a length more than this cannot be inverted accurately


def too_narrow() -> str:
    """Return the end of a message: a stroke squeezes too much."""
    return (
        f"squeezes what lies around it more than {1 / SQUEEZED:g} times, which could not be undone; use a larger "
        f"radius, a point farther from the fixed border or what is frozen, or {argument('on_fold', 'damp')}"
    )


def too_many() -> str:
    """Return the end of a message: a stroke would take too many steps."""
    return (
        f"would take more than {MOST_SUBSTROKES} strokes to arrive without a fold; use a larger radius, a point "
        f"further from the border, or {argument('on_fold', 'damp')}"
    )


def all_the_way(also: str = "") -> str:
    """Return the advice for a drag that folds."""
    return f"({argument('on_fold', 'flow')} goes all the way{also})"


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """The rows of a stroke, chosen so that the map does not fold.

    ``rows`` are applied one after the other; the identity has none. ``arrived`` is the position of the stroke's point
    after them, in samples, and ``alpha`` the applied fraction of the drag. ``margin`` is a proven lower bound of
    λ_min(sym(I + J_β)), for every row and at every point; for a twist that neither a border nor a mask changes, of the
    smallest singular value of I + J. ``cause`` is that of `Arrival`. ``warning`` is the text if it was damped, or
    misses its target.
    """

    rows: Table
    arrived: tuple[float, ...]
    alpha: float = 1.0
    margin: float = 1.0
    cause: str | None = None
    warning: str | None = None


def described(stroke: Stroke) -> str:
    """Name a stroke in a message."""
    if (own := current_spelling().stroke) is not None:
        return own(stroke)
    where = f"at {located(stroke.at)} with radius {stroke.radius:g}"
    if stroke.also:
        name = f" ({shown(stroke.name)})" if stroke.name else ""
        return f"a pull{name} of {len(stroke.handles)} handles with radius {stroke.radius:g}"
    if stroke.brush == "freeze":
        return f"a freeze {where.partition(' with ')[0]}"
    if stroke.brush == "grab":
        return f"a drag by {spelled(stroke.by)} {where}"
    amount = f"{stroke.angle:g}°" if stroke.angle is not None else f"{stroke.factor:g}"
    return f"a {stroke.brush} by {amount} {where}"


def warn_of_still(strokes: Sequence[Stroke]) -> None:
    """Warn of strokes that move nothing in any medium."""
    for i, stroke in enumerate(strokes):
        if stroke.is_still and not stroke.hidden and stroke.brush != "freeze":
            which = f"stroke {i + 1} of {len(strokes)}: " if len(strokes) > 1 else ""
            text = f"{which}{described(stroke)} moves nothing: give it another amount, or leave it out"
            warn(text, OutsideWarning)


def located(place: Sequence[float]) -> str:
    """Spell a place in a message; in a clip, with the number of its frame."""
    return spelled((*place[:2], *map(numbered, place[2:])))


def spelled(values: Iterable[float]) -> str:
    """Spell a point in a message."""
    return f"({', '.join(f'{x + 0.0:g}' for x in values)})"


def cut(x: float, digits: int) -> float:
    """Return a value rounded towards zero, so that a stated limit is never above the true one."""
    import decimal

    return float(decimal.Context(prec=digits, rounding=decimal.ROUND_DOWN).create_decimal_from_float(x))


def padded(points: npt.ArrayLike, domain: Domain) -> Floats:
    """Return a point (D,) or points (N, D), given in samples, with three coordinates in physical units."""
    given = np.asarray(points, np.float64)
    made = np.zeros((*given.shape[:-1], 3))
    made[..., : domain.ndim] = given * domain.spacing
    return made


def apart(one: Sequence[float], other: Sequence[float], domain: Domain) -> str:
    """Spell the distance of two points, given in samples, in a message: in pixels, frames, voxels or millimetres."""
    off = np.abs(np.subtract(one, other))
    if domain.time:
        across, along = math.hypot(*off[:2]), float(off[2])
        parts = [f"{x:.3g} {unit}" for x, unit in ((across, "pixels"), (along, "frames")) if x > 0.01 * max(off)]
        return " and ".join(parts)
    if domain.ndim == 3 and domain.spacing != (1.0, 1.0, 1.0):
        return f"{math.hypot(*(off * domain.spacing)):.3g} mm"
    return f"{math.hypot(*off):.3g} {'pixels' if domain.ndim == 2 else 'voxels'}"


def is_held(position: Floats, axes: Floats) -> bool:
    """Return whether a point is within the fixed faces, so that strokes move it."""
    faces = zip(position.tolist(), axes.tolist(), strict=True)
    return all(sigma < 0 or first <= x <= last for x, (first, last, sigma, *_) in faces)


def beta_at(position: Floats, axes: Floats) -> Floats:
    """Return the factor of the border for each axis at a point (3,), or at points (N, 3)."""
    first, last, sigma, _, profile = axes.T
    if (sigma < 0).all():
        return np.ones(position.shape)
    depth = np.minimum(position - first, last - position)
    beta = border_factor(np.divide(depth, sigma, out=np.zeros(position.shape), where=sigma > 0), profile[0])
    return np.where(sigma < 0, 1.0, beta)


def freedom_at(points: Floats, domain: Domain) -> Floats:
    """Return the freeze mask's factor at points (N, 3), in physical units."""
    mask = mask_of(domain)
    return np.ones(len(points)) if mask is None else mask.freedom(np.ascontiguousarray(points))[0]


def narrowest(table: Table, domain: Domain, starts: Floats, drags: Floats) -> float:
    """Return the smallest singular value of the sequence's Jacobian, sampled along paths (N, 3) and around them."""
    axes = domain.packed()
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
    _, jacobian = _core.forward(numbers(table), axes, np.ascontiguousarray(points.T), True, mask_of(domain))
    if not np.isfinite(jacobian).all():
        return 0.0
    n = 2 if axes[2, 1] == axes[2, 0] and axes[2, 2] < 0 else 3  # for an image, only the plane counts
    return float(np.linalg.svd(jacobian[:, :n, :n], compute_uv=False).min())
