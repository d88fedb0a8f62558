"""Actions by their names, the menu, and the strip of tools beside the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from imgui_bundle import imgui, imgui_ctx

from supple.viewer.panels import theme
from supple.viewer.panels.theme import ICONS
from supple.viewer.panels.view import STRIP, TOP, WIDE, View
from supple.viewer.panels.widgets import elided, icon_button, pinned
from supple.viewer.tools.keys import BRUSHES


@dataclass(frozen=True, slots=True)
class Action:
    """The action of a button or a menu item."""

    text: str
    keys: str  # the keys that do the same, as `supple.viewer.tools.keys.KEYS` writes them
    work: Callable[[View], object] | None = None  # by default, what its keys do
    able: Callable[[View], bool] = lambda view: True
    on: Callable[[View], bool] | None = None  # for a switch, whether it is on
    more: Callable[[View], str] | None = None  # what it would be applied to, in words
    icon: str = ""  # of those that the strip has

    def says(self, view: View) -> str:
        """Return the text, and what it would be applied to."""
        more = "" if self.more is None else self.more(view)
        return f"{self.text}: {more}" if more else self.text

    def do(self, view: View) -> None:
        """Do it, and draw what has changed."""
        if self.work is not None:
            self.work(view)
        else:
            *modifiers, key = self.keys.lower().replace("ctrl", "Control").split("+")
            view.tools.press(_NAMES.get(key, key), *modifiers)
        view.canvas.request_draw()


def _undone(view: View) -> str:
    document = view.document
    return "" if document.dragging or not document.can_undo else document.state.made_by


def _redone(view: View) -> str:
    document = view.document
    return document.steps[document.step + 1].made_by if document.can_redo else ""


def show_original(view: View, on: bool) -> None:
    """Show the original, or the result again."""
    view.tools.original = on
    view.refresh()


def _edits(edit: Callable[[View], object]) -> Callable[[View], None]:
    """Return an action that makes an edit, and shows its error."""
    return lambda view: view.attempt(partial(edit, view))


def _asks(name: str) -> Callable[[View], None]:
    return lambda view: view.commands.ask(name)


def copy_recipe(view: View) -> None:
    """Copy the recipe's JSON."""
    if view.copy_text is not None:
        view.copy_text(view.document.recipe.to_json())
        view.commands.message = "the recipe is copied, as JSON"


def _freezes(view: View) -> bool:
    return view.document.frozen is not None


_NAMES = {"delete": "Delete", "f1": "F1"}  # of keys, in events
ACTIONS: dict[str, Action] = {
    "open": Action("Open \u2026", "Ctrl+O", _asks("open"), icon="\uf07c"),
    "load mask": Action("Load the freeze mask \u2026", "", _asks("load mask")),
    "save mask": Action("Save the freeze mask \u2026", "", _asks("save mask"), _freezes),
    "save": Action("Save the recipe", "Ctrl+S", _asks("save"), icon="\uf0c7"),
    "save as": Action("Save the recipe as \u2026", "Ctrl+Shift+S", _asks("save as")),
    "export": Action("Export \u2026", "Ctrl+E", _asks("export"), lambda view: view.source is not None, icon="\uf14d"),
    "copy": Action("Save this view \u2026", "", _asks("copy")),
    "undo": Action("Undo", "Ctrl+Z", able=lambda view: view.document.can_undo, more=_undone, icon="\uf2ea"),
    "redo": Action("Redo", "Ctrl+Y", able=lambda view: view.document.can_redo, more=_redone, icon="\uf2f9"),
    "restore": Action(
        "Restore all", "", _edits(lambda view: view.document.restore()), lambda view: bool(view.document.strokes)
    ),
    "handles": Action("Handles", "Ctrl+H", on=lambda view: not view.tools.bare),
    "delete": Action("Delete the stroke", "Delete", able=lambda view: view.document.selected is not None),
    "hide": Action("Hide or show the stroke", "H", able=lambda view: view.document.selected is not None),
    "thaw all": Action("Thaw everything", "", _edits(lambda view: view.document.set_freeze(None)), _freezes),
    "invert frozen": Action(
        "Invert what is frozen", "", _edits(lambda view: view.document.set_freeze(view.document.freeze.inverted))
    ),
    "copy recipe": Action("Copy the recipe as JSON", "", copy_recipe, lambda view: view.copy_text is not None),
    "original": Action(
        "Show the original",
        "\\",
        lambda view: show_original(view, not view.tools.original),
        on=lambda view: view.tools.original,
        icon="\uf042",
    ),
    "split": Action("Before and after", "B", on=lambda view: view.tools.split is not None, icon="\uf0db"),
    "symmetry": Action("Symmetric strokes", "M", on=lambda view: view.tools.symmetric, icon="\uf07e"),
    "fit": Action("Fit the view", "0", icon="\uf065"),
    "actual": Action("100 %", "1", able=lambda view: view.stage.kind != "volume"),
    "keys": Action("Keys and gestures", "F1", on=lambda view: view.tools.listing, icon="\uf128"),
}


MENUS = {
    "File": ("open", "recent", "", "save", "save as", "copy recipe", "", "export", "copy"),
    "Edit": ("undo", "redo", "restore", "", "hide", "delete", "", "symmetry"),
    "Freeze": ("thaw all", "invert frozen", "", "load mask", "save mask"),
    "View": ("fit", "actual", "", "original", "split", "handles"),
    "Help": ("keys",),
}
"""The actions of each menu; an empty name is a separator."""


def menu(view: View) -> None:
    """Draw the menu, over the whole width."""
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (10, 0.5 * (TOP - theme.LETTERS)))
    shown = imgui.begin_main_menu_bar()
    imgui.pop_style_var()
    if not shown:
        return
    for name, items in MENUS.items():
        if imgui.begin_menu(name):
            for item in items:
                if item == "recent":
                    _recent(view)
                elif item:
                    _item(view, item)
                else:
                    imgui.separator()
            imgui.end_menu()
    imgui.end_main_menu_bar()


def _recent(view: View) -> None:
    if imgui.begin_menu("Open recent", bool(view.recent)):
        for name in view.recent:
            if imgui.menu_item(f"{elided(name, 420.0)}###{name}", "", False)[0]:
                view.attempt(partial(view.commands.take, name))
        imgui.end_menu()


def _item(view: View, name: str) -> None:
    action = ACTIONS[name]
    on = action.on is not None and action.on(view)
    if imgui.menu_item(f"{action.says(view)}###{name}", action.keys, on, action.able(view))[0]:
        action.do(view)


GROUPS = (("symmetry",), ("undo", "redo"), ("original", "split", "fit"), ("open", "save", "export"), ("keys",))
"""The actions below the brushes."""
_GAP = 13.0  # logical pixels between groups


def strip(view: View) -> None:
    """Draw the strip of tools."""
    width, height = view.logical
    with (
        imgui_ctx.push_style_var(imgui.StyleVar_.item_spacing, (0, 2)),
        pinned("tools", (width - WIDE, TOP), (STRIP, height - TOP), (6, 8)),
    ):
        _tools(view, height)


def _tools(view: View, height: float) -> None:
    count = len(BRUSHES) + sum(map(len, GROUPS))
    size = max(min(STRIP - 12.0, (height - TOP - 18 - len(GROUPS) * _GAP) / count - 2), 7.0)  # all fit in a low window
    for brush, (key, what) in BRUSHES.items():
        if brush in view.tools.lacks:
            continue
        tip, on = f"{brush.capitalize()} ({key}): {what}", view.tools.brush == brush
        if icon_button(f"brush {brush}", ICONS[brush], tip, size, on=on):
            view.tools.brush = brush
    for group in GROUPS:
        _line()
        for name in group:
            _tool(view, name, size)


def _tool(view: View, name: str, size: float) -> None:
    action, held = ACTIONS[name], name == "original"  # which acts while it is held, as its key does

    def tip() -> str:
        return f"{'Hold to see the original' if held else action.says(view)} ({action.keys})"

    on, able = action.on is not None and action.on(view), action.able(view)
    pressed = icon_button(name, action.icon, tip, size, on=on, enabled=able)
    if not held:
        if pressed:
            action.do(view)
    elif imgui.is_item_activated() or imgui.is_item_deactivated():
        show_original(view, imgui.is_item_activated())


def _line() -> None:
    at = imgui.get_cursor_screen_pos()
    y = round(at.y + 0.5 * _GAP - 1) + 0.5
    imgui.get_window_draw_list().add_line((at.x + 3, y), (at.x + STRIP - 15, y), theme.packed(theme.RAISED))
    imgui.dummy((1, _GAP - 2))
