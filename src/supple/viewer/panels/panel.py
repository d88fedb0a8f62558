"""The panel beside the image: sections that fold, the file commands below them, the question and the list of keys."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

from imgui_bundle import imgui, imgui_ctx

from supple.engine.sampling import BETWEEN
from supple.errors import shown
from supple.files.options import ClipOptions
from supple.media.transforms import CONVENTIONS
from supple.media.volume import suffix_of
from supple.viewer.document.background import Task
from supple.viewer.document.files import Question, saved
from supple.viewer.document.settings import keep
from supple.viewer.panels import faces, registering, straightening, strokes, theme, volume
from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.overlay import certified
from supple.viewer.panels.stages import ImageStage
from supple.viewer.panels.transforms import TRANSFORMS
from supple.viewer.panels.view import STRIP, TOP, WIDE, View
from supple.viewer.panels.widgets import (
    button,
    choice,
    elided,
    hint,
    icon_button,
    label,
    pinned,
    primary,
    progress,
    rows,
    section,
    slider,
    typed,
    wrapped,
)
from supple.viewer.tools.keys import KEYS

_FOOT = 56.0  # logical pixels of the file commands
_EXPORTING, _DONE = 60.0, 30.0  # and of an export's progress, and of its end


def panel(view: View) -> None:
    """Draw the panel."""
    width, height = view.logical
    with pinned("panel", (width - WIDE + STRIP, TOP), (WIDE - STRIP, height - TOP), ground=theme.GROUND):
        _parts(view)


def _parts(view: View) -> None:
    job = view.commands.export
    foot = _FOOT + (0.0 if job is None else _DONE if job.done else _EXPORTING)
    wide = imgui.get_content_region_avail().x
    # The scroll bar lies beside what it scrolls, in the panel's margin.
    imgui.set_next_window_content_size((wide, 0))
    imgui.begin_child("sections", (wide + imgui.get_style().scrollbar_size + 1, -foot))
    strokes.brush(view)
    registering.draw(view)
    strokes.strokes(view)
    volume.draw(view)
    _seeing(view)
    faces.draw(view)
    straightening.draw(view)
    strokes.folds(view)
    _accuracy(view)
    _history(view)
    strokes.end_drag(view)
    imgui.end_child()
    _files(view)
    _question(view)


def _seeing(view: View) -> None:
    if not section(view, "View"):
        return
    if view.stage.kind != "volume":
        tip = "What the map does, and what it costs, in colours over the picture"
        overlay = choice("Overlay", view.overlay, strokes.NAMES, tip)
        if overlay != view.overlay:
            view.overlay = overlay
            view.refresh()
        strokes.legend(view)
    label("Frozen", "The colour over what is frozen, and its opacity: 0 for none")
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.alpha_bar | imgui.ColorEditFlags_.no_tooltip
    changed, colour = imgui.color_edit4("##veil", list(view.veil_colour), flags)
    if changed:
        view.veil_colour = (colour[0], colour[1], colour[2], colour[3])
    if imgui.is_item_deactivated_after_edit():
        keep(veil=view.veil_colour)
    stage = view.stage
    if isinstance(stage, ImageStage):
        tip = "The view transform: how linear and HDR values are shown. An export keeps the values"
        transform = choice("Colours", stage.transform, TRANSFORMS, tip)
        if transform != stage.transform:
            stage.set_transform(transform)
            view.refresh()


def _accuracy(view: View) -> None:
    if not section(view, "Accuracy"):
        return
    said = certified(view)
    none = "Nothing is bent" if view.document.deformation.is_identity else "Checked once nothing moves"
    wrapped(f"{said[:1].upper()}{said[1:]}" if said else none, colour=theme.TEXT)
    if view.stage.kind == "volume":
        wrapped("How far from where the strokes say the rendering may read the volume. Mode exact reads just there.")
    else:
        wrapped(
            "Proven for every pixel of an export: how far from where the strokes say it may be read. How far a stroke "
            "ends from its target is said with the stroke."
        )


_FORMATS = {
    "image": (".jpg", ".png", ".tif", ".webp", ".avif", ".exr"),
    "video": (".mp4", ".mov", ".mkv", ".webm", ".gif", ".webp", ".apng"),
    "volume": (".nii.gz", ".nrrd", ".mha", ".tif"),
}
_WRITTEN: dict[str | None, str] = {None: "the bent volume"} | {
    name: f"its field: {row.label} ({name})" for name, row in CONVENTIONS.items() if ".nii.gz" in row.forms[0].suffixes
}
_OF_FIELDS = {"itk": (".nii.gz", ".nrrd", ".mha", ".h5")}
_FIELD = (
    "The bent volume; or one field of all that bends it, fields and affine maps and strokes, in the convention of a "
    "program: ITK's is that of ANTs and of 3D Slicer"
)
_HOLD = (
    "How many frames at each end keep every bit, so that a shot is cut back in: strokes fade towards them, here as well"
)
_BETWEEN = (
    "How an export samples between two frames: flow, the usual way where OpenCV is installed, follows their motion. "
    "Here, they are mixed, as by linear"
)
_WAYS = "All of these are lossless. From 0, none, to 9, the smallest and slowest; fast takes least time"
_FILTER = "Average over several frames where strokes speed time up: motion blur instead of jagged edges"


def _exports(view: View, asked: Question) -> None:
    """Draw the options of an export: its format, which is the suffix of its name, and the options of the format."""
    kind, commands, path = view.stage.kind, view.commands, asked.path or ""
    if kind == "volume":
        path = _of_what(view, asked)
    suffix = suffix_of(path)
    formats = _FORMATS[kind] if commands.field is None else _OF_FIELDS.get(commands.field, (".nii.gz",))
    other = choice("Format", suffix, {name: name for name in formats}, "The suffix of the name says the format, too")
    if other != suffix:
        asked.path = path[: len(path) - len(suffix)] + other
    if kind == "volume":
        return
    if kind == "image":
        lossy, hows = saved(path)
        chosen: dict[str, Any] = {}
        if lossy:
            known = int(commands.options.get("quality") or 0)
            form, tip = "%.0f" if known else "as usual", "From 1 to 100; 0 for what the format usually has"
            chosen["quality"] = round(slider("Quality", known, 0, 100, form, tip)) or None
        elif hows:
            named: dict[Any, str] = {None: "as usual"} | {name: name for name in hows}
            chosen["compression"] = choice("Compression", commands.options.get("compression"), named, _WAYS)
        commands.options = {**commands.options, **chosen}
        return
    clip = commands.options.get("clip") or ClipOptions()
    made: dict[str, Any] = {}
    label("Codec", "h264, hevc, av1, prores, ffv1 \u2026; empty for that of the clip")
    changed, text = imgui.input_text("##codec", clip.codec or "")
    if changed:
        made["codec"] = text.strip() or None
    crf, form = (-1.0, "as usual") if clip.crf is None else (clip.crf, "%.1f")
    tip = "Lower is better, and larger: 18 for H.264; below 0 for what the codec usually has"
    if (number := typed(view, "CRF", crf, form, tip)) is not None:
        made["crf"] = number if 0 <= number < math.inf else None
    number = typed(view, "Keep ends", float(view.document.hold), "%.0f", _HOLD)
    if number is not None and math.isfinite(number):
        view.attempt(partial(view.document.set_hold, round(number)))
    if view.document.timed:
        ways: dict[Any, str] = {None: "usual"} | {name: name for name in BETWEEN}
        made["between"] = choice("Between", clip.between, ways, _BETWEEN)
        length = view.stage.spacing[2] if clip.time_scale is None else clip.time_scale
        tip = "How many pixels a frame is long, for the brush: here, only in the export"
        if (number := typed(view, "Time scale", length, "%.2f", tip)) is not None:
            made["time_scale"] = number if 0 < number < math.inf else None
        label("Time filter", _FILTER)
        _, made["time_filter"] = imgui.checkbox("##time filter", clip.time_filter)
    if replace(clip, **made) != clip:
        commands.options = {**commands.options, "clip": replace(clip, **made)}


def _of_what(view: View, asked: Question) -> str:
    """Draw the choice between the bent volume and its field; return the name of the file."""
    commands, path = view.commands, asked.path or ""
    field = choice("Write", commands.field, _WRITTEN, _FIELD)
    if field != commands.field:
        commands.field = field
        stem = path.removesuffix(suffix_of(path)).removesuffix("-bent").removesuffix("-field")
        path = asked.path = f"{stem}-{'bent' if commands.field is None else 'field'}.nii.gz"
    return path


def _files(view: View) -> None:
    imgui.separator()
    if view.commands.export is not None:
        _exporting(view, view.commands.export)
    action = ACTIONS["export"]
    imgui.begin_disabled(not action.able(view))
    if primary("Export \u2026"):
        action.do(view)
    imgui.end_disabled()
    hint(f"Bend the file itself, at full quality ({action.keys})" if action.able(view) else "An array is no file")


def _exporting(view: View, job: Task) -> None:
    text, colour, size = f"Exporting: {job.text}", theme.TEXT, imgui.get_frame_height()
    if job.done and (job.error is not None or job.cancelled):
        text, colour = job.error or job.text, theme.WARNING
    elif job.done:
        text = f"Saved to {shown(job.target)}"
    imgui.align_text_to_frame_padding()
    imgui.text_colored(colour, elided(text, imgui.get_content_region_avail().x - (size + 8 if job.done else 0)))
    done = "\n".join([text, *job.warnings])
    hint(done if job.done else "At full quality, in the background: the file appears when it is complete")
    if job.done:
        imgui.same_line(imgui.get_window_width() - imgui.get_style().window_padding.x - size)
    if icon_button("dismiss", theme.CROSS, "Close") if job.done else progress(job):
        view.commands.end_export()


def _question(view: View) -> None:
    asked = view.commands.asked
    if asked is None:
        return
    if not imgui.is_popup_open(asked.title):
        imgui.open_popup(asked.title)
    width, height = view.logical
    imgui.set_next_window_pos((width / 2, height / 2), imgui.Cond_.always, (0.5, 0.5))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (16, 14))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (16, 9))  # of the title
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 6.0)
    shown = imgui.begin_popup_modal(asked.title, None, imgui.WindowFlags_.always_auto_resize)[0]
    imgui.pop_style_var(3)
    if not shown:
        return
    wide = max(min(460.0, width - 60), 80.0)
    wrapped(asked.text, wide, theme.TEXT)
    answer, typing = "", imgui.is_any_item_active()  # while typing, Enter is for the field
    if asked.path is not None:
        imgui.set_next_item_width(wide)
        if asked.fresh:
            imgui.set_keyboard_focus_here()
            imgui.get_io().clear_events_queue()  # drop input from before the question
            imgui.get_io().clear_input_keys()
        entered, asked.path = imgui.input_text("##path", asked.path, imgui.InputTextFlags_.enter_returns_true)
        if entered:
            answer = asked.choices[0]
        if asked.name == "export":
            imgui.begin_child("options", (wide, 0), imgui.ChildFlags_.auto_resize_y)
            _exports(view, asked)
            imgui.end_child()
    if not (asked.fresh or typing) and imgui.is_key_pressed(imgui.Key.enter):
        answer = answer or asked.choices[0]
    asked.fresh = False
    if asked.problem:
        wrapped(asked.problem, wide, theme.WARNING)
    imgui.spacing()
    for k, text in enumerate(asked.offered):
        if k:
            imgui.same_line()
            if imgui.get_cursor_pos_x() + imgui.calc_text_size(text).x > width - 40:
                imgui.new_line()
        if primary(text, 0.0) if k == 0 else imgui.button(text, (0, 32)):
            answer = text
    if asked.name == "export" and view.commands.choose is not None:
        imgui.same_line()
        if imgui.button("Browse \u2026", (0, 32)):
            view.commands.browse()
    if imgui.is_key_pressed(imgui.Key.escape) and "Cancel" in asked.choices:
        answer = "Cancel"
    if answer and view.commands.answer(answer):
        imgui.close_current_popup()
    imgui.end_popup()


_WIDTH = 720.0
_FIXED = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse


def list_keys(view: View) -> None:
    """Draw the list of keys and gestures, if it is shown."""
    if not view.tools.listing:
        return
    width, height = view.area[0], view.logical[1]
    wide = max(min(_WIDTH, width - 40), 80.0)
    imgui.set_next_window_pos((0.5 * width, 0.5 * height), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((wide, 0), (wide, height - 40))
    shown, stays = imgui.begin(
        "Keys and gestures", True, _FIXED | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_saved_settings
    )
    if shown and imgui.begin_table("keys", 2, imgui.TableFlags_.row_bg):
        imgui.table_setup_column("keys", imgui.TableColumnFlags_.width_fixed, 0.28 * wide)
        imgui.table_setup_column("what", imgui.TableColumnFlags_.width_stretch)
        for keys, what in KEYS[view.stage.kind].items():
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text(keys)
            imgui.table_next_column()
            imgui.text_wrapped(what)
        imgui.end_table()
    imgui.end()
    view.tools.listing = bool(stays)


_MARK = "Click to compare what you see with this step (A), side by side"
_MARKED = "Before and after, and the original, show this step: click to compare with the original again"
_BACK = "Before and after, and the original, show step A, even once it has left the history"


def _history(view: View) -> None:
    if not section(view, "History"):
        return
    document = view.document
    steps, now, compared, wide = document.steps, document.step, document.compared_step, imgui.calc_text_size("A").x
    for k in rows(view, "history", len(steps), 7, now, text=True):
        marked = k == compared
        with imgui_ctx.push_style_color(imgui.Col_.text, imgui.ImVec4(*(theme.TEXT if marked else theme.FAINT))):
            if imgui.selectable(f"A###mark {k}", marked, size=(wide, 0))[0] and not document.dragging:
                view.attempt(partial(_compare, view, None if marked else k))
        hint(_MARKED if marked else _MARK)
        imgui.same_line()
        name = steps[k].made_by if k else "Start"
        with imgui_ctx.push_style_color(imgui.Col_.text, imgui.ImVec4(*(theme.TEXT if k <= now else theme.FAINT))):
            if imgui.selectable(f"{name}###step {k}", k == now)[0] and not document.dragging:
                view.attempt(partial(document.go, k))
        hint("Click to go back to it" if k < now else "Click to go to it" if k > now else "What is seen now")
    if document.compared is not None and button("Compare with the original", tip=_BACK):
        view.attempt(partial(_compare, view, None))


def _compare(view: View, step: int | None) -> None:
    """Compare with a step, side by side; or with the original again."""
    view.document.compare(step)
    if step is not None and view.tools.split is None:
        view.tools.split = 0.5
    view.refresh()
