"""The list of keys and gestures, over everything else."""

from __future__ import annotations

from imgui_bundle import imgui

from supple.viewer.panels.view import View
from supple.viewer.tools.keys import KEYS

_WIDTH = 720.0
_FLAGS = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse


def draw(view: View) -> None:
    """Draw the list, if it is asked for."""
    if not view.tools.listing:
        return
    width, height = view.area[0], view.logical[1]
    wide = max(min(_WIDTH, width - 40), 80.0)
    imgui.set_next_window_pos((0.5 * width, 0.5 * height), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((wide, 0), (wide, height - 40))
    shown, stays = imgui.begin(
        "Keys and gestures", True, _FLAGS | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_saved_settings
    )
    if shown and imgui.begin_table("keys", 2, imgui.TableFlags_.row_bg):
        imgui.table_setup_column("keys", imgui.TableColumnFlags_.width_fixed, 0.28 * wide)
        imgui.table_setup_column("what", imgui.TableColumnFlags_.width_stretch)
        for keys, what in KEYS[view.stage.kind].items():
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text(keys)
            imgui.table_next_column()
            imgui.push_text_wrap_pos(0.0)
            imgui.text(what)
            imgui.pop_text_wrap_pos()
        imgui.end_table()
    imgui.end()
    view.tools.listing = bool(stays)
