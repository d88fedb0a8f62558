"""The menu above the panel."""

from __future__ import annotations

from imgui_bundle import imgui

from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.view import View

MENUS = {
    "File": ("open", "save", "save as", "", "export", "copy"),
    "Edit": ("undo", "redo", "", "hide", "delete", "", "symmetry", "", "invert frozen", "thaw all", "", "copy recipe"),
    "View": ("fit", "actual", "", "original", "split"),
    "Help": ("keys",),
}
"""The actions of each menu; a line where there is none."""


def draw(view: View) -> None:
    """Draw the menu in the current window."""
    if not imgui.begin_menu_bar():
        return
    for name, items in MENUS.items():
        if imgui.begin_menu(name):
            for item in items:
                if item:
                    _item(view, item)
                else:
                    imgui.separator()
            imgui.end_menu()
    imgui.end_menu_bar()


def _item(view: View, name: str) -> None:
    action = ACTIONS[name]
    on = action.on is not None and action.on(view)
    if imgui.menu_item(f"{action.says(view)}###{name}", action.keys, on, action.able(view))[0]:
        action.do(view)
