"""Parts that the panel is made of: sections that fold, fields with a label before them, buttons, hints."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from imgui_bundle import imgui, imgui_ctx

from supple.viewer.document.background import Task
from supple.viewer.document.settings import keep
from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.tools.drawing import Pair

LABEL = 104.0  # logical pixels of the labels before fields
_RESTING = int(imgui.HoveredFlags_.delay_short | imgui.HoveredFlags_.allow_when_disabled)
REST = -1e-3  # the width of a widget that takes the rest of its line
PERCENT = "%.0f %%"
"""The format of a slider whose values are fractions."""
T = TypeVar("T")
FOLDED = ("Face", "Straighten", "Folds and border", "Accuracy", "History")
"""The sections that are folded in the first window."""


def section(view: View, name: str, text: str = "", *, shown: bool = False) -> bool:
    """Draw the header of a section, with its name or, if given, a text; return whether it is open.

    Until the user folds or opens it, it is open if it is ``shown`` or not in `FOLDED`.
    """
    opened = view.sections.get(name, shown or name not in FOLDED)
    imgui.spacing()
    imgui.set_next_item_open(opened)
    with imgui_ctx.push_style_color(imgui.Col_.header, imgui.ImVec4(*theme.LINE)):
        now = imgui.collapsing_header(f"{text or name}###{name}")
    if now != opened:
        view.sections[name] = now
        keep(sections=view.sections)
    return now


@contextlib.contextmanager
def pinned(
    name: str, place: Pair, size: Pair, padding: Pair = (12, 8), ground: theme.Colour = theme.RAIL
) -> Iterator[None]:
    """Draw the controls of the block in a part of the window that stays where it is."""
    imgui.set_next_window_pos(place)
    imgui.set_next_window_size(size)
    imgui.push_style_var(imgui.StyleVar_.window_padding, padding)
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_color(imgui.Col_.window_bg, ground)
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_move
    imgui.begin(name, None, flags | imgui.WindowFlags_.no_bring_to_front_on_focus)
    imgui.pop_style_color()
    imgui.pop_style_var(2)  # not for hints over it
    yield
    imgui.end()


def label(text: str, tip: str = "", picture: Callable[[], None] | None = None) -> None:
    """Draw a label before a field, which takes the rest of the line."""
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    hint(tip, picture)
    imgui.same_line(LABEL)
    imgui.set_next_item_width(REST)


def wrapped(text: str, wide: float = 0.0, colour: theme.Colour = theme.FAINT) -> None:
    """Draw a text in lines of a width, or of that of the panel."""
    with imgui_ctx.push_text_wrap_pos(wide):
        imgui.text_colored(colour, text)


def elided(text: str, wide: float) -> str:
    """Return a text shortened in its middle to fit a width, since the ends of paths matter most."""
    kept = text
    for left in range(len(text) - 1, 0, -1):
        if imgui.calc_text_size(kept).x <= wide:
            break
        head = min(12, left // 2)
        kept = f"{text[:head]}\u2026{text[len(text) - left + head :]}"
    return kept


def primary(text: str, wide: float = REST) -> bool:
    """Draw the button of the main action; return whether it was pressed."""
    shades = (theme.PRIMARY, theme.lighter(theme.PRIMARY), theme.lighter(theme.PRIMARY, 0.14))
    names = (imgui.Col_.button, imgui.Col_.button_hovered, imgui.Col_.button_active)
    for name, shade in zip(names, shades, strict=True):
        imgui.push_style_color(name, shade)
    imgui.push_style_color(imgui.Col_.text, (1.0, 1.0, 1.0, 1.0))
    pressed = imgui.button(text, (wide, 32.0))
    imgui.pop_style_color(4)
    return pressed


def button(
    text: str, wide: float = REST, tip: str | Callable[[], str] = "", *, on: bool = False, enabled: bool = True
) -> bool:
    """Draw a button, which may show that it is on; return whether it was pressed."""
    imgui.begin_disabled(not enabled)
    if on:
        imgui.push_style_color(imgui.Col_.button, theme.PRIMARY)
    pressed = imgui.button(text, (wide, 0))
    imgui.pop_style_color(int(on))
    imgui.end_disabled()
    hint(tip)
    return pressed


def icon_button(
    name: str, icon: str, tip: str | Callable[[], str], size: float = 0.0, *, on: bool = False, enabled: bool = True
) -> bool:
    """Draw a button with an icon, by default as high as a field; return whether it was pressed."""
    size = size or imgui.get_frame_height()
    imgui.begin_disabled(not enabled)
    pressed = imgui.invisible_button(name, (size, size))
    imgui.end_disabled()
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    lines = imgui.get_window_draw_list()
    over, held = enabled and imgui.is_item_hovered(), imgui.is_item_active()
    if on or over or held:
        ground = theme.PRIMARY if on else theme.PRESSED if held else theme.RAISED
        lines.add_rect_filled((low.x, low.y), (high.x, high.y), theme.packed(ground), 6.0)
    colour = theme.packed((1.0, 1.0, 1.0, 1.0) if on else theme.TEXT, 1.0 if enabled else 0.3)
    theme.draw_icon(lines, icon, (0.5 * (low.x + high.x), 0.5 * (low.y + high.y)), round(0.5 * size), colour)
    hint(tip)
    return bool(pressed)


def eye(hidden: bool) -> bool:
    """Draw the button that hides the item of a row, or shows it; return whether it was pressed."""
    tip = "Hidden: click to show it" if hidden else "Seen: click to hide it"
    pressed = icon_button("seen", theme.HIDDEN if hidden else theme.SEEN, tip)
    imgui.same_line()
    return pressed


def progress(task: Task) -> bool:
    """Draw the progress of a task, and the button that cancels it; return whether the button was pressed."""
    with imgui_ctx.push_style_color(imgui.Col_.plot_histogram, imgui.ImVec4(*theme.FULL)):
        imgui.progress_bar(task.progress, (-80, imgui.get_frame_height()), f"{100 * task.progress:.0f} %")
    imgui.same_line()
    return bool(imgui.button("Cancel", (REST, 0)))


def _labelled(name: str, tip: str, picture: Callable[[], None] | None = None) -> str:
    """Draw the label of a field, unless its name is an identifier such as ##value; return the identifier."""
    if name.startswith("##"):
        return name
    label(name, tip, picture)
    return f"##{name.lower()}"


def choice(name: str, now: T, options: Mapping[T, str], tip: str = "") -> T:
    """Draw a list of options, values with their texts; return the chosen value."""
    name, values = _labelled(name, tip), list(options)
    changed, index = imgui.combo(name, values.index(now) if now in options else -1, list(options.values()))
    hint(tip)
    return values[index] if changed else now


def slider(
    name: str,
    value: float,
    low: float,
    high: float,
    form: str = PERCENT,
    tip: str = "",
    picture: Callable[[], None] | None = None,
    *,
    logarithmic: bool = False,
) -> float:
    """Draw a slider, filled up to its value; return the value, which is within the limits once it is changed."""
    name, unit = _labelled(name, tip, picture), 100.0 if form == PERCENT else 1.0
    at, wide = imgui.get_cursor_screen_pos(), imgui.calc_item_width()
    place = math.log if logarithmic else float
    part = (place(min(max(value, low), high)) - place(low)) / max(place(high) - place(low), 1e-30)
    lines, bottom = imgui.get_window_draw_list(), at.y + imgui.get_frame_height()
    lines.add_rect_filled((at.x, at.y), (at.x + wide, bottom), theme.packed(theme.FIELD), 4.0)
    lines.add_rect_filled((at.x, at.y), (at.x + part * wide, bottom), theme.packed(theme.FULL), 4.0)
    shades = (imgui.Col_.frame_bg, imgui.Col_.slider_grab, imgui.Col_.slider_grab_active)
    for shade in shades:
        imgui.push_style_color(shade, (0.0, 0.0, 0.0, 0.0))
    for shade in (imgui.Col_.frame_bg_hovered, imgui.Col_.frame_bg_active):
        imgui.push_style_color(shade, (1.0, 1.0, 1.0, 0.06))
    flags = imgui.SliderFlags_.logarithmic if logarithmic else imgui.SliderFlags_.none
    changed, now = imgui.slider_float(name, unit * value, unit * low, unit * high, form, flags)
    imgui.pop_style_color(5)
    hint(tip, picture)
    return min(max(now / unit, low), high) if changed else value


def rows(view: View, name: str, count: int, most: int, now: int | None = None, *, text: bool = False) -> Iterator[int]:
    """Draw a list of ``count`` rows of fields, or of text; yield the index of each that is to be drawn.

    At most ``most`` of them are visible at once. The list scrolls to row ``now`` when that has become another one.
    """
    row, style = (
        (imgui.get_frame_height_with_spacing, imgui.get_text_line_height_with_spacing)[text](),
        imgui.get_style(),
    )
    height = row * max(min(count, most), 1) - style.item_spacing.y + 2 * style.frame_padding.y
    imgui.begin_child(name, (0, height), imgui.ChildFlags_.frame_style)
    if view.listed.get(name) != now:
        view.listed[name] = now
        if now is not None:
            imgui.set_scroll_y(row * (now + 0.5) - 0.5 * imgui.get_window_height())
    clipper = imgui.ListClipper()
    clipper.begin(count, row)
    while clipper.step():
        for i in range(clipper.display_start, clipper.display_end):
            imgui.push_id(i)
            yield i
            imgui.pop_id()
    imgui.end_child()


def entry(text: str, on: bool, wide: float = 0.0) -> bool:
    """Draw a text that can be clicked, as high as a field; return whether it was."""
    with imgui_ctx.push_style_var(imgui.StyleVar_.selectable_text_align, (0.0, 0.5)):
        return imgui.selectable(text, on, size=(wide, imgui.get_frame_height()))[0]


def typed(view: View, name: str, value: float, form: str, tip: str = "") -> float | None:
    """Draw a field for a number; return the number once it is entered, by Enter or by leaving the field."""
    name = _labelled(name, tip)
    changed, now = imgui.input_float(name, value, 0.0, 0.0, form)
    if changed:
        view.typed[name] = now
    over = imgui.is_item_deactivated_after_edit()
    hint(tip)
    return view.typed.pop(name, None) if over else None


def hint(text: str | Callable[[], str], picture: Callable[[], None] | None = None) -> None:
    """Show a hint if the pointer rests on the last item; only then are functions called, for a text or a picture."""
    if text and imgui.is_item_hovered(_RESTING):
        with imgui_ctx.begin_tooltip():
            with imgui_ctx.push_text_wrap_pos(320.0):
                imgui.text(text if isinstance(text, str) else text())
            if picture is not None:
                picture()
