"""The panel beside the image: strokes by number, the brush, the display, and the file commands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, get_args

from imgui_bundle import imgui

from supple.deformation import Arrival
from supple.engines.wgpu.plate import OVERLAYS
from supple.folding import NEAR
from supple.render.transfer import PRESETS
from supple.strokes import POISSON, REACH, FoldPolicy, Stroke
from supple.viewer.document.state import Item
from supple.viewer.panels import curve
from supple.viewer.panels.stages import VolumeStage
from supple.viewer.panels.view import WIDE, View

CAUSES = {"fold": "all of it would fold", "border": "the fixed border holds it back", "outside": "it starts outside"}
CAUSES["fold and border"] = f"{CAUSES['fold']}, and {CAUSES['border']}"
_FILES = {"save": "save recipe", "save as": "as", "open": "open recipe", "export": "export", "copy": "save view"}
FALLOFFS = ("far, as 1/r", "nearer, as 1/r3", "near, as 1/r5")
_POLICIES = get_args(FoldPolicy)
_MODES = ("hybrid", "lattice", "exact", "buffered")
_SAYS = {"damp": "damp what would fold", "flow": "arrive, in smaller steps", "error": "refuse"}


def panel(view: View) -> None:
    """Draw the panel."""
    width, height = view.logical
    imgui.set_next_window_pos((width - WIDE, 0))
    imgui.set_next_window_size((WIDE, height))
    flags = imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_collapse
    imgui.begin("panel", None, flags | imgui.WindowFlags_.no_title_bar | imgui.WindowFlags_.no_bring_to_front_on_focus)
    imgui.push_item_width(-110)
    _brush(view)
    _strokes(view)
    _selected(view)
    if isinstance(view.stage, VolumeStage):
        _volume(view)
    _seeing(view)
    _files(view)
    _help(view)
    imgui.pop_item_width()
    imgui.end()


def _head(text: str) -> None:
    imgui.spacing()
    imgui.separator_text(text)


def _wrapped(text: str, wide: float, draw: Callable[[str], None] = imgui.text) -> None:
    imgui.push_text_wrap_pos(wide)
    draw(text)
    imgui.pop_text_wrap_pos()


def _brush(view: View) -> None:
    tools = view.tools
    imgui.separator_text("Brush")
    form = "%.1f mm" if view.stage.kind == "volume" else "%.1f px"
    scale = imgui.SliderFlags_.logarithmic
    changed, value = imgui.slider_float("radius", tools.radius, *tools.radius_limits, form, scale)
    if changed:
        tools.radius = value
    hint("How far a drag is felt (wheel, or [ and ])")
    material = POISSON if tools.poisson is None else max(tools.poisson, -1.0)
    changed, value = imgui.slider_float("Poisson", material, -1.0, 0.5, "%.2f")
    if changed:
        tools.poisson = value
    hint("at higher values, 3-D volumes change less; areas in a picture change at any value")
    changed, index = imgui.combo("falloff", tools.scales - 1, list(FALLOFFS))
    if changed:
        tools.scales = index + 1
    changed, tools.reach = _reach(tools.reach, "")


def _reach(reach: float | None, of: str) -> tuple[bool, float | None]:
    """Draw the controls of a reach; return whether it was changed, and its value."""
    changed, limited = imgui.checkbox(f"limited{of}", reach is not None)
    hint("Beyond its reach, nothing moves at all")
    if changed:
        return True, REACH if limited else None
    if reach is None:
        return False, None
    imgui.same_line()
    imgui.set_next_item_width(WIDE - 110 - 110)
    changed, value = imgui.slider_float(f"reach{of}", reach, 1.0, 10.0, "%.1f radii")
    return changed, max(float(value), 1.0) if changed else reach


def _strokes(view: View) -> None:
    document = view.document
    _head(f"Strokes ({len(document.items)})")
    imgui.begin_disabled(not document.can_undo)
    if imgui.small_button("undo"):
        view.attempt(document.undo)
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(not document.can_redo)
    if imgui.small_button("redo"):
        view.attempt(document.redo)
    imgui.end_disabled()
    state = document.state  # after the buttons
    imgui.begin_child("strokes", (0, min(180, 26 + 24 * max(len(state.items), 1))), imgui.ChildFlags_.borders)
    if not state.items:
        imgui.text_disabled("Drag on the picture.")
    if view.listed != state.selected:  # follow selections made elsewhere
        view.listed = state.selected
        if state.selected is not None:
            row = imgui.get_frame_height_with_spacing()
            imgui.set_scroll_y(row * (state.selected + 0.5) - 0.5 * imgui.get_window_height())
    clipper = imgui.ListClipper()
    clipper.begin(len(state.items))
    while clipper.step():
        for i in range(clipper.display_start, clipper.display_end):
            _row(view, i, state.items[i], state.selected == i)
    imgui.end_child()


def _row(view: View, i: int, item: Item, selected: bool) -> None:
    document = view.document
    imgui.push_id(i)
    changed, seen = imgui.checkbox("##seen", not item.hidden)
    hint("Seen, or hidden")
    if changed:
        view.attempt(lambda: document.hide(i, not seen))
    imgui.same_line()
    arrival = document.arrivals[i]
    at, radius = ", ".join(f"{v:.0f}" for v in item.stroke.at), item.stroke.radius
    text = f"({at})  r {radius:.3g}" if radius < 1000 else f"({at})  r {radius:.0f}"
    text += f"  {arrival.miss:.3g} short" if arrival and arrival.miss > NEAR else ""
    if imgui.selectable(text, selected)[0]:
        view.attempt(lambda: document.select(None if selected else i))
    hint(lambda: described(item.stroke, arrival))
    imgui.pop_id()


def described(stroke: Stroke, arrival: Arrival | None) -> str:
    """Return a description of a stroke, and of its point's position, in a few lines."""

    def place(values: Iterable[float]) -> str:
        return f"({', '.join(f'{v:.1f}' for v in values)})"

    said = f"{stroke.brush} at {place(stroke.at)}\nby {place(stroke.by)}\nradius {stroke.radius:.4g}"
    if stroke.poisson is not None:
        said += f", Poisson ratio {stroke.poisson:.3g}"
    said += f"\nfalloff: {FALLOFFS[stroke.scales - 1]}"
    said += "\nreach: no limit" if stroke.reach is None else f"\nreach: {stroke.reach:.3g} radii"
    if arrival is None:
        return said
    said += f"\narrives at {place(arrival.arrived)}"
    if arrival.miss > NEAR:
        said += f", {arrival.miss:.3g} short: {CAUSES[arrival.cause or 'border']}"
    if arrival.moved > NEAR:
        said += f"\nlater strokes move it by {arrival.moved:.3g}, to {place(arrival.final)}"
    return said


def _selected(view: View) -> None:
    document = view.document
    i = document.state.selected
    if i is not None and i < len(document.state.items):
        stroke = document.state.items[i].stroke
        _head(f"Stroke {i + 1}")
        axes = "xyt" if view.stage.kind == "video" else "xyz"
        made: dict[str, Any] = {}
        for name, label in (("at", "from"), ("by", "by")):
            values = list(getattr(stroke, name))
            for axis in range(len(values)):
                imgui.set_next_item_width((WIDE - 130) / len(values))
                entered, value = _typed(view, f"##{name}{axis}", values[axis], "%.2f")
                hint(f"{label} {axes[axis]}")
                imgui.same_line()
                if entered and math.isfinite(value):
                    values[axis] = value
                    made[name] = tuple(values)
            imgui.text(label)
        material = POISSON if stroke.poisson is None else stroke.poisson
        for name, label, value, form in (
            ("radius", "radius##own", stroke.radius, "%.2f"),
            ("poisson", "Poisson##own", material, "%.3f"),
        ):
            entered, now = _typed(view, label, value, form)
            if entered:
                made[name] = now
        changed, index = imgui.combo("falloff##own", stroke.scales - 1, ["far", "nearer", "near"])
        if changed:
            made["scales"] = index + 1
        changed, reach = _reach(stroke.reach, "##own")
        if changed:
            made["reach"] = reach
        if made:
            view.attempt(lambda: document.replace(i, replace(stroke, **made)))
        arrival = document.arrivals[i]
        if arrival is not None and arrival.miss > NEAR:
            _wrapped(
                f"It ends {arrival.miss:.3g} short: {CAUSES[arrival.cause or 'border']}.", 0.0, imgui.text_disabled
            )
            if imgui.small_button("arrive, in smaller steps"):
                view.attempt(lambda: document.set_on_fold("flow"))
            hint("None of them folds: for all strokes")
        if arrival is not None and arrival.moved > NEAR:
            imgui.text_disabled(f"Later strokes move it by {arrival.moved:.3g}.")
        for label, step in (("earlier", -1), ("later", 1)):
            if imgui.small_button(label) and 0 <= i + step < len(document.state.items):
                view.attempt(partial(document.move, i, i + step))
            imgui.same_line()
        if imgui.small_button("delete"):
            view.attempt(lambda: document.remove(i))
    _head("Folds and border")
    policy = document.state.on_fold
    changed, index = imgui.combo("folds", _POLICIES.index(policy), [_SAYS[p] for p in _POLICIES])
    if changed:
        view.attempt(lambda: document.set_on_fold(_POLICIES[index]))
    border = document.state.rest.border
    changed, fixed = imgui.checkbox("fixed border", border is not None)
    if changed:
        view.attempt(lambda: document.set_border("auto" if fixed else None))
    if border is not None:
        changed, tenth = imgui.checkbox("a tenth of each side", border == "auto")
        if changed:
            widths = document.deformation.domain.border_widths or (1.0,)
            view.attempt(lambda: document.set_border("auto" if tenth else max(min(widths), 1.0)))
    if isinstance(border, float):
        entered, value = _typed(view, "its width", border, "%.1f")
        if entered:
            view.attempt(lambda: document.set_border(value))


def _typed(view: View, label: str, value: float, form: str) -> tuple[bool, float]:
    """Draw a field for a number; return whether it is entered, by Enter or by leaving it, and the number."""
    changed, now = imgui.input_float(label, value, 0.0, 0.0, form)
    if changed:
        view.typed[label] = now
    over = imgui.is_item_deactivated_after_edit() and label in view.typed
    return over, view.typed.pop(label) if over else value


def _volume(view: View) -> None:
    stage = view.stage
    assert isinstance(stage, VolumeStage)
    _head("Volume")
    names = list(PRESETS)
    now = names.index(stage.preset) if stage.preset in names else -1
    changed, index = imgui.combo("colours", now, names)
    if changed:
        _show(view, lambda: stage.look(names[index], stage.density))
    low, high = stage.scene.range
    window = stage.density or (low, high)
    imgui.plot_histogram("##histogram", stage.histogram, graph_size=(WIDE - 20, 50))
    hint("How many voxels have which value (logarithms), and the opacity of each")
    curve.draw(stage)
    for k, label in enumerate(("from", "to")):
        changed, value = imgui.slider_float(f"{label}##density", window[k], low, high, "%.4g")
        both = (value, max(window[1], value)) if k == 0 else (min(window[0], value), value)
        if changed and both[0] < both[1]:
            _show(view, partial(stage.look, stage.scene.transfer, None if both == (low, high) else both))
    _transfer(view, stage)
    changed, index = imgui.combo("mode", _MODES.index(stage.mode), list(_MODES))
    if changed:
        _show(view, lambda: stage.set_mode(_MODES[index]))
    if stage.mode == "hybrid":
        imgui.progress_bar(view.filled, (-1, 6), "")
        hint("How much of the bent volume is in a buffer of its own: pictures are faster with it")


def _show(view: View, work: Callable[[], object]) -> None:
    """Change the display of a volume, and show an error if it is refused."""
    view.attempt(work)
    view.refresh()


def _transfer(view: View, stage: VolumeStage) -> None:
    """Draw the points of the transfer function: values, colours and opacities."""
    if not imgui.tree_node("transfer function"):
        return
    transfer = stage.scene.transfer
    points = [list(p) for p in transfer.points]
    for k, (value, red, green, blue, opacity) in enumerate(points):
        imgui.push_id(k)
        imgui.set_next_item_width(70)
        entered, moved = _typed(view, f"##value{k}", value, "%.3g")
        imgui.same_line()
        painted, colour = imgui.color_edit3("##colour", [red, green, blue], imgui.ColorEditFlags_.no_inputs)
        imgui.same_line()
        imgui.set_next_item_width(90)
        thinned, seen = imgui.slider_float("##opacity", opacity, 0.0, 1.0, "%.2f")
        if entered or painted or thinned:
            points[k] = [moved, *colour, seen]
        imgui.same_line()
        if imgui.small_button("x") and len(points) > 2:
            del points[k]
            imgui.pop_id()
            break
        imgui.pop_id()
    if imgui.small_button("add a point") and len(points) >= 2:
        middle = [0.5 * (a + b) for a, b in zip(points[-2], points[-1], strict=True)]
        points.insert(len(points) - 1, middle)
    if points != [list(p) for p in transfer.points]:
        made: Any = tuple(sorted((tuple(p) for p in points), key=lambda p: p[0]))
        _show(view, lambda: stage.look(replace(transfer, points=made), stage.density))
    imgui.tree_pop()


def _seeing(view: View) -> None:
    _head("Seeing")
    changed, on = imgui.checkbox("before and after", view.tools.split is not None)
    if changed:
        view.tools.split = 0.5 if on else None
        view.refresh()
    imgui.same_line()
    imgui.text_disabled("(b; \\ for before)")
    if view.tools.split is not None:
        changed, value = imgui.slider_float("cut", view.tools.split, 0.0, 1.0, "%.2f")
        if changed:
            view.tools.split = value
            view.refresh()
    volume, tools = view.stage.kind == "volume", view.tools
    names = ["", "inversions"] if volume else list(OVERLAYS)
    changed, index = imgui.combo("overlay", names.index(view.overlay), ["none", *names[1:]])
    if changed:
        view.overlay = names[index]
        view.refresh()
    hint("How many inversions, or without them samples, each ray took" if volume else "What the map does, and its cost")
    if not volume:
        if imgui.small_button("fit"):
            tools.press("0")
        imgui.same_line()
        if imgui.small_button("100 %"):
            tools.press("1")


def _files(view: View) -> None:
    _head("Files")
    for name, says in _FILES.items():
        if imgui.small_button(says):
            view.commands.ask(name)
        if name not in ("open", "copy"):
            imgui.same_line()
    job = view.commands.export
    if job is not None:
        imgui.progress_bar(job.progress, (-70, 0), job.text)
        hint(job.error or job.text)
        imgui.same_line()
        if imgui.small_button("close" if job.done else "cancel"):
            view.commands.end_export()
    question(view)


def _help(view: View) -> None:
    imgui.spacing()
    if imgui.small_button("keys and gestures"):
        view.tools.listing = not view.tools.listing
    imgui.same_line()
    imgui.text_disabled("(? or F1)")


def question(view: View) -> None:
    """Draw the open question above everything else."""
    asked = view.commands.asked
    if asked is None:
        return
    if not imgui.is_popup_open(asked.title):
        imgui.open_popup(asked.title)
    width, height = view.logical
    imgui.set_next_window_pos((width / 2, height / 2), imgui.Cond_.always, (0.5, 0.5))
    if not imgui.begin_popup_modal(asked.title, None, imgui.WindowFlags_.always_auto_resize)[0]:
        return
    wide = max(min(460.0, width - 60), 80.0)
    _wrapped(asked.text, wide)
    answer = ""
    if asked.path is not None:
        imgui.set_next_item_width(wide)
        if asked.fresh:
            imgui.set_keyboard_focus_here()
            imgui.get_io().clear_events_queue()  # drop input from before the question
            imgui.get_io().clear_input_keys()
        entered, asked.path = imgui.input_text("##path", asked.path, imgui.InputTextFlags_.enter_returns_true)
        if entered:
            answer = asked.choices[0]
    if not asked.fresh and imgui.is_key_pressed(imgui.Key.enter):
        answer = answer or asked.choices[0]  # for any focus of the keyboard
    asked.fresh = False
    if asked.problem:
        _wrapped(asked.problem, wide)
    for k, label in enumerate(asked.choices):
        if k:
            imgui.same_line()
            if imgui.get_cursor_pos_x() + imgui.calc_text_size(label).x > width - 40:
                imgui.new_line()
        if imgui.button(label):
            answer = label
    if imgui.is_key_pressed(imgui.Key.escape) and "Cancel" in asked.choices:
        answer = "Cancel"
    if answer and view.commands.answer(answer):
        imgui.close_current_popup()
    imgui.end_popup()


def hint(text: str | Callable[[], str]) -> None:
    """Show a hint on the last item, if the pointer rests on it; a function is called only then."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.delay_short):
        imgui.set_tooltip(text if isinstance(text, str) else text())
