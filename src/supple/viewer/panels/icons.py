"""Icons of tools, of actions and of lists: letters of Font Awesome, whose font imgui-bundle brings."""

from __future__ import annotations

from imgui_bundle import imgui

SEEN, HIDDEN, PLAY, PAUSE, CROSS = "\uf06e", "\uf070", "\uf04b", "\uf04c", "\uf00d"
ICONS = {
    "grab": "\uf256",
    "twist": "\uf751",
    "bloat": "\uf31e",
    "pucker": "\uf78c",
    "pinch": "\uf422",
    "path": "\uf4d7",
    "restore": "\uf12d",
    "smooth": "\uf773",
    "pin": "\uf08d",
    "freeze": "\uf2dc",
    "thaw": "\uf043",
    "symmetry": "\uf07e",
    "undo": "\uf2ea",
    "redo": "\uf2f9",
    "original": "\uf042",
    "split": "\uf0db",
    "fit": "\uf065",
    "open": "\uf07c",
    "save": "\uf0c7",
    "export": "\uf14d",
    "keys": "\uf128",
}
"""Icons of tools and of actions, by their names."""


def draw(lines: imgui.ImDrawList, icon: str, middle: tuple[float, float], size: float, colour: int) -> None:
    """Draw an icon about a point, in letters of a size in logical pixels."""
    font, (x, y) = imgui.get_font(), middle
    box = font.get_font_baked(size).find_glyph(ord(icon))
    at = (round(x - 0.5 * (box.x0 + box.x1)), round(y - 0.5 * (box.y0 + box.y1)))
    lines.add_text(font, size, at, colour, icon)
