"""Strokes, recipes and undo steps in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Any

from supple.deformation import Arrival
from supple.errors import Spelling
from supple.folding.limits import NEAR
from supple.space.freezing import Freeze
from supple.strokes import PAINTINGS, FoldPolicy, Stroke

CAUSES = {"fold": "all of it would fold", "border": "the fixed border holds it back", "outside": "it starts outside"}
CAUSES["freeze"] = "what is frozen holds it back"
CAUSES |= {f"fold and {other}": f"{CAUSES['fold']}, and {CAUSES[other]}" for other in ("border", "freeze")}
FALLOFFS = ("far", "medium", "near")
"""For 1, 2 and 3 scales, which fade as 1/r, 1/r³ and 1/r⁵."""
FOLDS: dict[FoldPolicy, str] = {
    "damp": "weaken the stroke",
    "flow": "go in small steps",
    "error": "refuse the stroke",
}
"""For each policy, what happens with a stroke that would fold the medium."""
_FIELDS = {"at": "Position", "by": "Drag", "poisson": "Bulge sideways", "scales": "Fall-off", "also": "Points"}


def place(values: Iterable[float], digits: int = 0) -> str:
    """Return a point in words."""
    return f"({', '.join(f'{v:.{digits}f}' for v in values)})"


def named(stroke: Stroke) -> str:
    """Return the name of the tool that made a stroke."""
    if stroke.factor is not None and stroke.brush == "scale":
        return "Pucker" if stroke.factor < 1 else "Bloat"
    if stroke.brush == "freeze" and stroke.matte is not None and stroke.matte.is_free:
        return "Thaw everything"
    if stroke.is_whole and stroke.name is not None:
        return stroke.name.capitalize()
    return "Path" if stroke.path else stroke.brush.capitalize()


def listed(stroke: Stroke, unit: str = "", before: Freeze | None = None) -> str:
    """Return a stroke as a line of a list, with the unit of its points; a freeze as a change of the mask ``before``."""
    if stroke.brush == "freeze":
        return _held(stroke, before)
    if stroke.is_whole and stroke.name not in PAINTINGS:
        return named(stroke)
    said = f"{named(stroke)} {place(stroke.at)}{unit}"
    if stroke.angle is not None:
        said += f" {stroke.angle:.3g}\u00b0"
    elif stroke.factor is not None:
        said += f" \u00d7{stroke.factor:.3g}"
    return f"{said}, radius {brush_radius(stroke):.3g}"


def brush_radius(stroke: Stroke) -> float:
    """Return the radius of the brush that made a stroke: twice the stroke's own for a restoring or smoothing one."""
    return stroke.radius * (2 if stroke.name in ("restore", "smooth") else 1)


def done(stroke: Stroke, digits: int = 0) -> str:
    """Return what a stroke does at its pivot."""
    if stroke.angle is not None:
        said = f"by {stroke.angle:.4g}\u00b0"
    elif stroke.factor is not None:
        said = f"by a factor of {stroke.factor:.4g}"
    else:
        said = f"by {place(stroke.by, digits)}"
        return said + (f" with {others(stroke)}" if stroke.also else "")
    return said if stroke.axis is None else f"{said}, axis ({', '.join(f'{v:.3g}' for v in stroke.axis)})"


def _held(stroke: Stroke, before: Freeze | None = None) -> str:
    """Return a description of a freeze, as a change of the mask ``before``."""
    if stroke.matte is None or stroke.matte.is_free:
        return named(stroke)
    return f"{freezing(before, stroke.matte)}: {frozen(stroke.matte)}"


def others(stroke: Stroke) -> str:
    """Return the number of other points and of pins of a stroke, in words."""
    pins = sum(not any(by) for _, by in stroke.also)
    more = len(stroke.also) - pins
    counts = ((more, "other point"), (pins, "pin"))
    return " and ".join(f"{n} {what}{'s' * (n != 1)}" for n, what in counts if n)


def described(
    stroke: Stroke,
    arrival: Arrival | None,
    unit: str = "",
    where: Callable[[tuple[float, ...]], tuple[float, ...]] = lambda point: point,
) -> str:
    """Return a description of a stroke, and of its point's position, in a few lines.

    ``unit`` is that of the stroke's points, and ``where`` converts a point of an arrival to it.
    """
    if stroke.brush == "freeze":
        return f"{_held(stroke)}\nlater strokes move nothing there, earlier ones keep their effect"
    said = f"{named(stroke)} at {place(stroke.at, 1)}{unit}\n{done(stroke, 1)}\nradius {brush_radius(stroke):.4g}"
    if stroke.poisson is not None:
        said += f", bulge sideways {stroke.poisson:.3g}"
    if stroke.brush == "grab":  # other brushes have a single fall-off
        said += f"\nfall-off: {FALLOFFS[stroke.scales - 1]}"
    said += "\nreach: no limit" if stroke.reach is None else f"\nreach: {stroke.reach:.3g} radii"
    if arrival is None:
        return said
    said += f"\narrives at {place(where(arrival.arrived), 1)}"
    if arrival.miss > NEAR:
        said += f", {arrival.miss:.3g} short: {CAUSES[arrival.cause or 'border']}"
    if arrival.moved > NEAR:
        said += f"\nlater strokes move it by {arrival.moved:.3g}, to {place(where(arrival.final), 1)}"
    return said


def _control(name: str, value: object) -> str:
    """Return the window's name for an argument: that of the control that sets it."""
    if name == "on_fold" and value in FOLDS:
        return f"\u201c{FOLDS[value].capitalize()}\u201d, below Folds and border,"
    if name == "force":
        return "Replace"
    said = _FIELDS.get(name, name.replace("_", " ").capitalize())
    return said if value is Spelling.ANY else f"{said} {value}"


WINDOW = Spelling(_control, "none", stroke=lambda stroke: f"{named(stroke)} at {place(stroke.at)} {done(stroke)}")
"""How messages of the window name its controls, and strokes."""


def frozen(freeze: Freeze) -> str:
    """Return how much of a medium a mask freezes, in words."""
    percent = 100 * freeze.share
    return f"{'Less than 1' if percent < 1 else f'{percent:.0f}'} % is frozen"


def drawn(strokes: Sequence[Stroke]) -> str:
    """Return the name of the step that draws strokes."""
    return f"{named(strokes[0])} at {place(strokes[0].at)}" + (f", {len(strokes)} strokes" if len(strokes) > 1 else "")


def chosen(option: str, value: Any) -> str:
    """Return the name of the step that sets an option of the recipe."""
    if option == "straighten":
        return "Straighten" if value else "Straighten no longer"
    if option == "border":
        return "Free the border" if value is None else "Fix the border"
    return f"Amount {value:.0%}" if option == "amount" else "Folds"


@lru_cache(maxsize=256)
def freezing(old: Freeze | None, new: Freeze | None) -> str:
    """Return the name of the step from a mask to another."""
    if new is None or new.is_free:
        return "Thaw everything"
    if old is None:
        return "Freeze" if any(new.values) else "Invert what is frozen"
    if old.size != new.size:
        return "Freeze mask"
    if new == old.inverted:
        return "Invert what is frozen"
    one, other = old.coefficients, new.coefficients
    return "Freeze" if (other <= one).all() else "Thaw" if (other >= one).all() else "Freeze and thaw"


def edit(i: int, old: Stroke, new: Stroke) -> str:
    """Return the name of the step that changes a stroke."""
    if old.hidden != new.hidden:
        return f"{'Hide' if new.hidden else 'Show'} stroke {i + 1}"
    changed = [f.name for f in fields(Stroke) if getattr(old, f.name) != getattr(new, f.name)]
    if "keys" in changed:
        return f"{_keyed(old, new)} of stroke {i + 1}"
    if len(changed) != 1:
        return f"Edit stroke {i + 1}"
    return f"{_FIELDS.get(changed[0], changed[0].capitalize())} of stroke {i + 1}"


def _keyed(old: Stroke, new: Stroke) -> str:
    gone, come = (sorted({k.frame for k in a.keys} - {k.frame for k in b.keys}) for a, b in ((old, new), (new, old)))
    changed = come or gone or [a.frame for a, b in zip(old.keys, new.keys, strict=True) if a != b]
    said = f"Key {changed[0]}" if len(changed) == 1 else "Keys"
    return f"Remove {said.lower()}" if gone and not come else said
