"""The strip of tools between the picture and the panel."""

from __future__ import annotations

from imgui_bundle import imgui

from supple.viewer.panels import theme
from supple.viewer.panels.actions import ACTIONS, show_original
from supple.viewer.panels.icons import ICONS
from supple.viewer.panels.view import STRIP, WIDE, View
from supple.viewer.panels.widgets import hint, icon_button
from supple.viewer.tools.keys import BRUSHES

GROUPS = (("symmetry",), ("undo", "redo"), ("original", "split", "fit"), ("open", "save", "export"), ("keys",))
"""The actions below the brushes."""
_GAP = 13.0  # between groups


def draw(view: View) -> None:
    """Draw the strip."""
    width, height = view.logical
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_move
    imgui.set_next_window_pos((width - WIDE, 0))
    imgui.set_next_window_size((STRIP, height))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (6, 8))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_var(imgui.StyleVar_.item_spacing, (0, 2))
    imgui.push_style_color(imgui.Col_.window_bg, theme.RAIL)
    imgui.begin("tools", None, flags | imgui.WindowFlags_.no_bring_to_front_on_focus)
    count = len(BRUSHES) + sum(map(len, GROUPS))
    size = max(min(STRIP - 12.0, (height - 16 - len(GROUPS) * _GAP) / count - 2), 8.0)  # all fit in a low window
    for brush, (key, what) in BRUSHES.items():
        if icon_button(f"brush {brush}", ICONS[brush], size, on=view.tools.brush == brush):
            view.tools.brush = brush
        hint(f"{brush.capitalize()} ({key}): {what}")
    for group in GROUPS:
        _line()
        for name in group:
            _action(view, name, size)
    imgui.end()
    imgui.pop_style_color()
    imgui.pop_style_var(3)


def _action(view: View, name: str, size: float) -> None:
    action = ACTIONS[name]
    pressed = icon_button(name, ICONS[name], size, action.on is not None and action.on(view), action.able(view))
    if name == "original":  # as its key: while it is held
        if imgui.is_item_activated() or imgui.is_item_deactivated():
            show_original(view, imgui.is_item_activated())
        hint(f"Hold to see the original ({action.keys})")
        return
    if pressed:
        action.do(view)
    hint(lambda: f"{action.says(view)} ({action.keys})")


def _line() -> None:
    at = imgui.get_cursor_screen_pos()
    y = round(at.y + 0.5 * _GAP - 1) + 0.5
    imgui.get_window_draw_list().add_line((at.x + 3, y), (at.x + STRIP - 15, y), theme.packed(theme.RAISED))
    imgui.dummy((1, _GAP - 2))
