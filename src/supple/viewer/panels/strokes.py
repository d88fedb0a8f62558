"""Sections of the panel: the brush, the list of strokes, the selected stroke, folds; and the legend of overlays."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from imgui_bundle import imgui, imgui_ctx

from supple.deformation import Deformation
from supple.folding.limits import NEAR
from supple.strokes import LEAST, MOST, PAINTINGS, POISSON, REACH, Stroke, last_freeze, time_radius_of
from supple.strokes.stroke import MOST_FLAT
from supple.viewer.document.keyframes import edited
from supple.viewer.document.words import CAUSES, FALLOFFS, FOLDS, described, frozen, listed, others
from supple.viewer.panels import keyframes, theme
from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.overlay import grid_step
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import (
    REST,
    button,
    choice,
    entry,
    eye,
    hint,
    label,
    rows,
    section,
    slider,
    typed,
    wrapped,
)
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drawing import IMMATERIAL, LIGHTEST, MASKS

NAMES = {
    "": "None",
    "grid": "Grid",
    "stretch": "Stretch",
    "residual": "Residual",
    "inversions": "Work",
}
"""Overlays, as they are called in the panel."""
COLD, HOT = (0.10, 0.25, 0.75, 1.0), (0.95, 0.35, 0.10, 1.0)
"""The ends of the colours, as in plate.wgsl."""
_HIGH = 10.0  # of the scale, in logical pixels
_STEPS = 40  # of each half of a scale with two ends
_SCALES: dict[str, tuple[str, tuple[str, ...]]] = {
    "stretch": ("How much larger or smaller an area is than in the original.", ("half", "same", "twice")),
    "residual": ("How far each source point misses its pixel when it is bent.", ("1/65536 px", "1/256 px", "1 px")),
    "inversions": ("Steps of Newton's method for each pixel.", ("0", "4", "8")),
}


def legend(view: View) -> None:
    """Draw the legend of the overlays that are shown."""
    name = view.overlay
    if name == "grid":
        step = grid_step(view.tools.view.zoom) if isinstance(view.tools, ImageTools) else 32
        wrapped(f"Lines of the original, every {32 if view.document.timed else step} pixels, as they are bent.")
    if name not in _SCALES:
        return
    text, marks = _SCALES[name]
    wrapped(text)
    wide, at = imgui.get_content_region_avail().x, imgui.get_cursor_screen_pos()
    lines, cold, hot = imgui.get_window_draw_list(), theme.packed(COLD), theme.packed(HOT)
    if name == "stretch":  # as plate.wgsl has it: what keeps its size keeps its colour
        for k in range(-_STEPS, _STEPS):
            opacity = math.sqrt(abs(k + 0.5) / _STEPS)
            begin, end = (round(at.x + wide * (0.5 + 0.5 * (k + more) / _STEPS)) for more in (0, 1))
            shade = theme.packed(COLD if k < 0 else HOT, opacity)
            lines.add_rect_filled((begin, at.y), (end, at.y + _HIGH), shade)
    else:
        lines.add_rect_filled_multi_color((at.x, at.y), (at.x + wide, at.y + _HIGH), cold, hot, hot, cold)
    for k, mark in enumerate(marks):
        x = at.x + k / (len(marks) - 1) * (wide - imgui.calc_text_size(mark).x)
        lines.add_text((x, at.y + _HIGH + 4), theme.packed(theme.FAINT), mark)
    imgui.dummy((wide, _HIGH + imgui.get_text_line_height_with_spacing()))


_FALLOFF = "How fast the pull fades with the distance: far as 1/r, medium as 1/r\u00b3, near as 1/r\u2075"
_BULGE = (
    "How much the surroundings make room, as rubber does: what lies ahead and behind is pushed to the sides. It is "
    "Poisson's ratio of the material, from -1 to 0.5"
)
_REACH = (
    "Farther than this from the drag, nothing moves at all: the faint ring. Without a limit, the pull fades, but never "
    "ends"
)

_IN_TIME = (
    "How long before and after a stroke is felt; by default as long as its drag in time or an eighth of the clip, "
    "and at most as the radius is in frames"
)
_FLAT = "The part of the radius within which all moves as the point does, before it fades"
_KIND = (
    "In time: a drag may go through time, and fades with it. In every frame: a stroke bends each frame like a picture, "
    "and may move and come and go, by keys. All strokes of a recipe are of one kind"
)
_SMALL = 120.0  # logical pixels of the picture of a bulge


def brush(view: View) -> None:
    """Draw the section of the brush, or of the selected stroke: both have the same numbers."""
    document, tools = view.document, view.tools
    i = document.selected
    if tools.brush != view.brush:  # a brush was chosen: show its numbers
        view.brush, view.own = tools.brush, False
    if not section(view, "Brush"):
        return
    own = view.own and i is not None
    if i is not None:
        wide = 0.5 * (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x)
        if button("Next stroke", wide, on=not own):
            view.own = False
        imgui.same_line()
        if button(f"Stroke {i + 1}###own", wide, on=own):
            view.own = True
    with imgui_ctx.push_id("own" if own else "next"):
        if own and i is not None:
            _selected(view, i)
        else:
            _next(view)


def _next(view: View) -> None:
    tools = view.tools
    if tools.pen and tools.brush not in ("pin", *MASKS):
        label("Pen", "How much of a stroke is made: by the greatest pressure of its drag; of a painting, the present")
        _, tools.pressing = imgui.checkbox("pressure sets strength", tools.pressing)
    simple = tools.brush in MASKS | PAINTINGS
    if view.stage.kind == "video" and not simple:
        _kind(view)
    for name, value in _numbers(view, tools.next_stroke, simple).items():
        setattr(tools, name, value)
    for name in ("thaw all", "invert frozen") if tools.brush in MASKS else ():
        if button(ACTIONS[name].text, enabled=ACTIONS[name].able(view)):
            ACTIONS[name].do(view)
    if tools.brush in PAINTINGS:
        tip = "The part of the way that a click brings it"
        tools.strength = slider("Strength", tools.strength, LIGHTEST, 1.0, tip=tip)


def _numbers(view: View, stroke: Stroke, simple: bool = False) -> dict[str, Any]:
    """Draw the numbers that strokes and brushes share, or the radius alone; return the changed ones by their names."""
    tip = "The size of the brush: also the wheel, [ and ], or a right drag"
    form, (low, high) = "%.1f mm" if view.stage.kind == "volume" else "%.1f px", view.tools.radius_limits
    made: dict[str, Any] = {}
    made["radius"] = slider("Radius", stroke.radius, low, max(high, stroke.radius), form, tip, logarithmic=True)
    grabs = stroke.brush == "grab" and not simple
    if grabs:  # other brushes have a single fall-off
        made["scales"] = choice("Fall-off", stroke.scales, dict(enumerate(FALLOFFS, 1)), _FALLOFF)
    if stroke.brush not in IMMATERIAL and not simple:
        material = POISSON if stroke.poisson is None else max(stroke.poisson, -1.0)
        value = slider("Bulge sideways", material, -1.0, 0.5, "%.2f", _BULGE, _bulging)
        made["poisson"] = stroke.poisson if value == material else value
    if not simple:
        made["reach"] = _optional("Reach", stroke.reach, REACH, "no limit", (1.0, 10.0, "%.1f radii"), _REACH)
    if grabs and not stroke.also and stroke.reach is not None:
        made["flat"] = slider("Plateau", stroke.flat, 0.0, MOST_FLAT, tip=_FLAT)
    if view.document.timed and not stroke.isotropic and not simple:
        count = view.document.shape[0]
        usual = time_radius_of(stroke, count, view.stage.spacing[2])
        limits, none = (0.5, max(0.5 * count, 1.0), "%.1f frames"), f"{usual:.1f} frames"
        made["time_radius"] = _optional("Radius in time", stroke.time_radius, usual, none, limits, _IN_TIME)
    return {name: value for name, value in made.items() if value != getattr(stroke, name)}


def _bulging() -> None:
    """Draw a grid that is pulled to the right, with the least and the largest Poisson ratio."""
    at, lines = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list()
    for k, poisson in enumerate((-1.0, 0.5)):
        left = at.x + k * (_SMALL + 20)
        lines.add_text((left, at.y), theme.GREY, f"{poisson:g}")
        for way in _pulled(poisson):
            points: list[Any] = [imgui.ImVec2(left + x, at.y + 18 + y) for x, y in way]
            lines.add_polyline(points, col=theme.SOFT, thickness=1.0, flags=imgui.ImDrawFlags_.none)
    imgui.dummy((2 * _SMALL + 20, _SMALL + 20))


@cache
def _pulled(poisson: float) -> list[list[list[float]]]:
    bent = Deformation((int(_SMALL),) * 2, border=None).grab(
        (0.4 * _SMALL, 0.5 * _SMALL), by=(0.25 * _SMALL, 0), radius=0.2 * _SMALL, poisson=poisson
    )
    along, places = np.linspace(0, _SMALL - 1, 40), np.linspace(0, _SMALL - 1, 13)
    level = [np.stack([along, np.full(40, y)], 1) for y in places]
    return [bent.forward(points).tolist() for points in (*level, *(points[:, ::-1] for points in level))]


def _kind(view: View) -> None:
    """Draw the choice of the kind of a clip's strokes, which all strokes of a recipe share."""
    document = view.document
    imgui.begin_disabled(bool(document.strokes))
    timed = choice("Strokes", document.timed, {True: "in time", False: "in every frame"}, _KIND)
    imgui.end_disabled()
    if timed != document.timed:
        view.attempt(partial(setattr, document, "timed", timed))


def _optional(
    name: str, value: float | None, usual: float, none: str, limits: tuple[float, float, str], tip: str
) -> float | None:
    """Draw a switch, and the slider of a value if there is one; return the value."""
    label(name, tip)
    _, on = imgui.checkbox(f"##limited {name.lower()}", value is not None)
    hint(tip)
    imgui.same_line()
    if value is None or not on:
        imgui.text_disabled(none)
        return usual if on else None
    imgui.set_next_item_width(REST)
    return slider(f"##{name.lower()}", value, *limits)


def strokes(view: View) -> None:
    """Draw the section of the list of strokes."""
    state = view.document.state
    count = len(state.strokes)
    if not section(view, "Strokes", f"Strokes ({count})" if count else "Strokes"):
        return
    if (first := state.rest.freeze) is not None:  # painted before the first stroke
        imgui.align_text_to_frame_padding()
        imgui.text(f"Freeze: {frozen(first)}")
        hint("Of the original, before all strokes: none moves anything there. Thaw it with the tool Thaw (V)")
    if count:
        _amount(view)
    else:
        wrapped(
            "Drag on the picture to make one."
            if view.stage.kind != "volume"
            else "Drag in a plane, or on the object, to make one."
        )
        return
    for i in rows(view, "strokes", count, 6, state.selected):
        _row(view, i, state.strokes[i], state.selected == i)


def _row(view: View, i: int, stroke: Stroke, selected: bool) -> None:
    document = view.document
    if eye(stroke.hidden):
        view.attempt(lambda: document.hide(i, not stroke.hidden))
    short = document.misses(i)
    unit = "" if document.space is None else f" mm {document.space}"
    before = last_freeze(document.strokes[:i]) or document.state.rest.freeze
    text = listed(document.as_saved(stroke), "" if document.space is None else " mm", before)
    coloured = short or (stroke.hidden and not selected)  # faint text is hard to read in a selected row
    if coloured:
        imgui.push_style_color(imgui.Col_.text, theme.FAINT if stroke.hidden else theme.WARNING)
    if entry(f"{text}##row", selected):
        view.own = True
        view.attempt(lambda: document.select(None if selected else i))
    if coloured:
        imgui.pop_style_color()
    hint(lambda: described(document.as_saved(stroke), document.arrival(i), unit, document.place))


def _selected(view: View, i: int) -> None:
    document = view.document
    own = document.state.strokes[i]
    if own.brush == "freeze":
        wrapped(described(own, None))
        _order(view, i)
        return
    stroke = own.at_frame(document.frame)
    axes = "xyt" if view.stage.kind == "video" else "xyz"
    saved = document.as_saved(stroke)
    entries: dict[str, Any] = {}
    gap = imgui.get_style().item_inner_spacing.x
    for name, said in (("at", "From"), ("by", "By")) if stroke.brush == "grab" else (("at", "At"),):
        values = list(getattr(saved, name))
        label(f"{said} {', '.join(axes[: len(values)])}" + ("" if document.space is None else " mm"))
        wide = (imgui.get_content_region_avail().x - gap * (len(values) - 1)) / len(values)
        for axis in range(len(values)):
            if axis:
                imgui.same_line(0, gap)
            imgui.set_next_item_width(wide)
            value = typed(view, f"##{name}{axis}", values[axis], "%.1f", f"{said} {axes[axis]}")
            if value is not None and math.isfinite(value):
                values[axis] = value
                changed: dict[str, Any] = {name: tuple(values)}
                moved = document.as_edited(replace(saved, **changed))
                entries[name] = getattr(moved, name)
    for name, form in ("angle", "%.1f\u00b0"), ("factor", "%.3f"):
        number = getattr(stroke, name)  # None for other brushes
        if number is not None and (now := typed(view, name.capitalize(), number, form)) is not None:
            entries[name] = now
    if entries:
        view.attempt(lambda: document.change(i, view.tools.paired(stroke, replace(stroke, **entries))))
    changes: dict[str, Any] = _numbers(view, stroke)
    tip = "How much of the stroke is applied; of an animated one, in this frame. Below 0, the opposite"
    strength = slider("Strength", stroke.strength, LEAST, MOST, tip=tip)
    if strength != stroke.strength:
        changes["strength"] = strength
    if changes:
        drag(view, i, lambda: document.preview_as(edited(own, stroke, replace(stroke, **changes), document.frame)))
    if stroke.also:
        wrapped(f"Also to drag in the picture: {others(stroke)}.")
    if view.stage.kind == "video" and not document.timed:
        keyframes.fields(view, i, own)
    _arrival(view, i)
    _order(view, i)


def _order(view: View, i: int) -> None:
    """Draw the buttons that move a stroke in the list, or delete it."""
    document = view.document
    count = len(document.state.strokes)
    wide = (imgui.get_content_region_avail().x - 2 * imgui.get_style().item_spacing.x) / 3
    for text, step, tip in (("Earlier", -1, "Apply it before"), ("Later", 1, "Apply it after")):
        if button(text, wide, f"{tip} the stroke that is next to it", enabled=0 <= i + step < count):
            view.attempt(partial(document.move, i, i + step))
        imgui.same_line()
    if button("Delete", wide, "Delete the stroke (Delete)"):
        view.attempt(lambda: document.remove(i))


def _amount(view: View) -> None:
    document = view.document
    tip = "How much of all strokes is applied: less takes back, below 0 they do the opposite"
    amount = slider("Amount", document.state.rest.amount, LEAST, MOST, tip=tip)
    if amount != document.state.rest.amount:
        drag(view, None, lambda: document.preview_rest(amount=amount))


def drag(view: View, i: int | None, preview: Callable[[], object]) -> None:
    """Show the changes of a slider at once, by a drag of the document: they are one step while it is held."""
    if not view.document.dragging:
        if isinstance(view.tools, VideoTools):
            view.tools.playback.pause()
        view.attempt(lambda: view.document.begin_drag(i))
    if view.document.dragging:
        view.attempt(preview)


def end_drag(view: View) -> None:
    """End the drag of a slider that is not held any more, as one step."""
    document = view.document
    if document.dragging and not (view.tools.dragging or imgui.is_any_item_active()):
        trouble = document.trouble
        document.commit()
        view.commands.message = trouble or view.commands.message


def _arrival(view: View, i: int) -> None:
    document = view.document
    arrival = document.arrival(i) if i < len(document.strokes) else None
    unit = "voxels" if view.stage.kind == "volume" else "px"
    if arrival is not None and arrival.miss > NEAR:
        cause = CAUSES[arrival.cause or "border"]
        wrapped(f"Its point ends {arrival.miss:.3g} {unit} from its target: {cause}.", colour=theme.WARNING)
        way, tip = "Go all the way, in small steps", "No step folds; for all strokes"
        if document.state.rest.on_fold != "flow" and button(way, tip=tip):
            view.attempt(lambda: document.set_rest(on_fold="flow"))
    if (said := document.warning(i)) is not None and "as far as is possible" in said:
        wrapped(f"{said.partition(':')[0]}.", colour=theme.WARNING)
    if arrival is not None and (carrier := document.carrier(i)) is not None:
        far = max(each.moved for each in (arrival, *arrival.also) if each.carried_by is not None)
        wrapped(f"Stroke {carrier + 1} carries it away: it ends {far:.3g} {unit} from there.", colour=theme.WARNING)
    elif arrival is not None and arrival.moved > NEAR:
        wrapped(f"Later strokes move it by {arrival.moved:.3g} {unit}.")


def folds(view: View) -> None:
    """Draw the section of folds and of the border."""
    if not section(view, "Folds and border"):
        return
    document = view.document
    tip = "What happens where a stroke is so strong that the picture would fold over itself"
    policy = choice("If it folds", document.state.rest.on_fold, FOLDS, tip)
    if policy != document.state.rest.on_fold:
        view.attempt(lambda: document.set_rest(on_fold=policy))
    border = document.state.rest.border
    label("Border", "A fixed border stays where it is; what is on a free one moves, and leaves a gap")
    changed, fixed = imgui.checkbox("fixed##border", border is not None)
    if changed:
        view.attempt(lambda: document.set_rest(border="auto" if fixed else None))
    if border is None:
        return
    imgui.same_line()
    changed, tenth = imgui.checkbox("over a tenth", border == "auto")
    hint("Strokes fade over a tenth of each side; or over a width of your own")
    if changed:
        widths = document.deformation.domain.border_widths or (1.0,)
        view.attempt(lambda: document.set_rest(border="auto" if tenth else max(min(widths), 1.0)))
    if isinstance(border, float):
        value = typed(view, "Its width", border, "%.1f")
        if value is not None:
            view.attempt(lambda: document.set_rest(border=value))
