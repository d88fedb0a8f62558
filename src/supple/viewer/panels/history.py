"""The history, step by step, and the recipe in words."""

from __future__ import annotations

from functools import partial

from imgui_bundle import imgui

from supple.viewer.document.words import sentence, settings, step
from supple.viewer.panels import theme
from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import REST, hint, listing, section, wrapped

_MARK = "Click to compare what you see with this step (A), side by side"
_MARKED = "Before and after, and the original, show this step: click to compare with the original again"
_BACK = "Before and after, and the original, show step A, even once it has left the history"


def draw(view: View) -> None:
    """Draw both sections."""
    if section(view, "History"):
        _history(view)
    if section(view, "Recipe"):
        _recipe(view)


def _history(view: View) -> None:
    document = view.document
    steps, now = document.steps, document.step
    row = imgui.get_text_line_height_with_spacing()
    listing("history", len(steps), 7, row)
    if view.reached != now:
        view.reached = now
        imgui.set_scroll_y(row * (now + 0.5) - 0.5 * imgui.get_window_height())
    clipper = imgui.ListClipper()
    clipper.begin(len(steps))
    wide, compared = imgui.calc_text_size("A").x, document.compared_step
    while clipper.step():
        for k in range(clipper.display_start, clipper.display_end):
            marked = k == compared
            imgui.push_style_color(imgui.Col_.text, theme.TEXT if marked else theme.FAINT)
            if imgui.selectable(f"A###mark {k}", marked, size=(wide, 0))[0] and not document.dragging:
                view.attempt(partial(_compare, view, None if marked else k))
            imgui.pop_style_color()
            hint(_MARKED if marked else _MARK)
            imgui.same_line()
            name = "Start" if k == 0 else step(steps[k - 1], steps[k])
            imgui.push_style_color(imgui.Col_.text, theme.TEXT if k <= now else theme.FAINT)
            if imgui.selectable(f"{name}###step {k}", k == now)[0] and not document.dragging:
                view.attempt(partial(document.go, k))
            imgui.pop_style_color()
            hint("Click to go back to it" if k < now else "Click to go to it" if k > now else "What is seen now")
    imgui.end_child()
    if document.compared is not None:
        if imgui.button("Compare with the original", (REST, 0)):
            view.attempt(partial(_compare, view, None))
        hint(_BACK)


def _compare(view: View, step: int | None) -> None:
    """Compare with a step, side by side; or with the original again."""
    view.document.compare(step)
    if step is not None and view.tools.split is None:
        view.tools.split = 0.5
    view.refresh()


def _recipe(view: View) -> None:
    document = view.document
    wrapped(settings(document.state.rest))
    items = document.items
    if items:
        listing("recipe", len(items), 4, imgui.get_text_line_height() + imgui.get_text_line_height_with_spacing())
        clipper = imgui.ListClipper()
        clipper.begin(len(items))
        while clipper.step():
            for i in range(clipper.display_start, clipper.display_end):
                imgui.text(sentence(i, items[i]))
        imgui.end_child()
    action = ACTIONS["copy recipe"]
    imgui.begin_disabled(not action.able(view))
    if imgui.button("Copy JSON", (REST, 0)):
        action.do(view)
    imgui.end_disabled()
    hint("What supple warp --recipe takes" if action.able(view) else "A page has no clipboard: save the recipe instead")
