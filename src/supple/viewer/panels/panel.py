"""The panel beside the image: the menu, sections that fold, and the file commands below them."""

from __future__ import annotations

from imgui_bundle import imgui

from supple.engines.wgpu.plate import OVERLAYS
from supple.errors import shown
from supple.viewer.panels import history, legend, menu, question, strokes, theme, volume
from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.overlay import certified
from supple.viewer.panels.view import STRIP, WIDE, View
from supple.viewer.panels.widgets import hint, label, primary, section, slider, wrapped

_FOOT = 94.0  # logical pixels of the file commands
_EXPORTING = 62.0  # and of an export's progress
_FLAGS = (
    imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)


def panel(view: View) -> None:
    """Draw the panel."""
    width, height = view.logical
    imgui.set_next_window_pos((width - WIDE + STRIP, 0))
    imgui.set_next_window_size((WIDE - STRIP, height))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.begin("panel", None, _FLAGS | imgui.WindowFlags_.menu_bar | imgui.WindowFlags_.no_scrollbar)
    imgui.pop_style_var()
    menu.draw(view)
    foot = _FOOT + (_EXPORTING if view.commands.export is not None else 0.0)
    wide = imgui.get_content_region_avail().x
    # The scroll bar lies beside what it scrolls, in the panel's margin.
    imgui.set_next_window_content_size((wide, 0))
    imgui.begin_child("sections", (wide + imgui.get_style().scrollbar_size + 1, -foot))
    strokes.brush(view)
    strokes.listed(view)
    strokes.selected(view)
    volume.draw(view)
    _seeing(view)
    strokes.folds(view)
    _accuracy(view)
    history.draw(view)
    imgui.end_child()
    _files(view)
    question.draw(view)
    imgui.end()


def _seeing(view: View) -> None:
    if not section(view, "View"):
        return
    names = ["", "inversions"] if view.stage.kind == "volume" else list(OVERLAYS)
    label("Overlay", "What the map does, and what it costs, in colours over the picture")
    changed, index = imgui.combo("##overlay", names.index(view.overlay), [legend.NAMES[name] for name in names])
    if changed:
        view.overlay = names[index]
        view.refresh()
    legend.draw(view)
    label("Compare", "The original to the left of a line, the result to the right of it")
    changed, on = imgui.checkbox("before and after", view.tools.split is not None)
    if changed:
        view.tools.split = 0.5 if on else None
        view.refresh()
    if view.tools.split is not None:
        label("Divided at")
        changed, value = slider("##cut", 100 * view.tools.split, 0.0, 100.0, "%.0f %%")
        if changed:
            view.tools.split = value / 100
            view.refresh()


def _accuracy(view: View) -> None:
    if not section(view, "Accuracy"):
        return
    said = certified(view)
    imgui.text(f"{said[:1].upper()}{said[1:]}" if said else "No error: nothing is bent")
    if view.stage.kind == "volume":
        wrapped("How far the place that a sample of a ray is read from may be off. Mode exact has no such error.")
    else:
        wrapped("Proven for every pixel of an export: how far the place that it is read from may be off.")


def _files(view: View) -> None:
    """Draw the file commands, and the progress of an export."""
    imgui.separator()
    job = view.commands.export
    if job is not None:
        if job.done:
            wrong = job.error is not None or job.cancelled
            text = job.text if wrong else f"Saved to {shown(job.target)}"
            imgui.text_colored(theme.WARNING if wrong else theme.TEXT, text)
            hint(text)
        else:
            imgui.text(f"Exporting: {job.text}")
            hint("At full quality, in the background: the file appears when it is complete")
        imgui.progress_bar(job.progress, (-72, 22), f"{100 * job.progress:.0f} %")
        imgui.same_line()
        if imgui.button("Close" if job.done else "Cancel", (-1, 22)):
            view.commands.end_export()
    action = ACTIONS["export"]
    imgui.begin_disabled(not action.able(view))
    if primary("Export \u2026"):
        action.do(view)
    imgui.end_disabled()
    hint(f"Bend the file itself, at full quality ({action.keys})" if action.able(view) else "An array is no file")
    wide = 0.5 * (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x)
    for name, text in (("save", "Save recipe"), ("open", "Open recipe")):
        if imgui.button(text, (wide, 30)):
            ACTIONS[name].do(view)
        hint(f"{ACTIONS[name].text} ({ACTIONS[name].keys})")
        imgui.same_line()
    imgui.new_line()
