"""Colours, spaces and letters of the panel; icons are letters of Font Awesome, whose font imgui-bundle brings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from importlib import resources
from typing import Any

from imgui_bundle import imgui

Colour = tuple[float, float, float, float]
Pair = tuple[float, float]

ACCENT: Colour = (0.25, 0.63, 1.0, 1.0)  # of handles, too
PRIMARY: Colour = (0.12, 0.43, 0.80, 1.0)
FULL: Colour = (0.17, 0.35, 0.58, 1.0)  # the part of a field up to its value
TEXT: Colour = (0.90, 0.91, 0.93, 1.0)
FAINT: Colour = (0.62, 0.65, 0.69, 1.0)  # its contrast to the ground is 6 : 1
WARNING: Colour = (1.0, 0.72, 0.38, 1.0)
GROUND: Colour = (0.125, 0.13, 0.14, 1.0)
RAIL: Colour = (0.095, 0.10, 0.11, 1.0)  # behind the tools, and the line of status
FIELD: Colour = (0.19, 0.20, 0.215, 1.0)
RAISED: Colour = (0.245, 0.255, 0.275, 1.0)
PRESSED: Colour = (0.30, 0.315, 0.34, 1.0)
LINE: Colour = (0.21, 0.22, 0.235, 1.0)
LETTERS = 15.0  # logical pixels
# Colours of overlays on the picture, for draw lists: ABGR.
WHITE, DARK, BLUE, RED, GREY = 0xFFFFFFFF, 0xA0000000, 0xFFFFA040, 0xFF5060FF, 0xFFC0C0C0
SOFT, PALE, DIM, SHADE, BALL = 0xC6FFFFFF, 0xA8FFFFFF, 0x98FFFFFF, 0x28000000, 0xBBFFA040


def lighter(colour: Colour, by: float = 0.07) -> Colour:
    """Return a lighter colour, as for items under the pointer."""
    r, g, b, a = colour
    return min(r + by, 1.0), min(g + by, 1.0), min(b + by, 1.0), a


@cache
def packed(colour: Colour, opacity: float = 1.0) -> int:
    """Return a colour for a draw list."""
    r, g, b, a = colour
    return imgui.color_convert_float4_to_u32((r, g, b, a * opacity))


def apply(io: imgui.IO) -> None:
    """Set the letters, and the style of the current context."""
    fonts, icons = resources.files("imgui_bundle") / "assets" / "fonts", imgui.ImFontConfig()
    icons.merge_mode = True
    for font, config in (("Roboto/Roboto-Regular.ttf", None), ("Font_Awesome_6_Free-Solid-900.otf", icons)):
        with resources.as_file(fonts / font) as path:
            if path.is_file():
                io.fonts.add_font_from_file_ttf(str(path), LETTERS, config)
    style()


def style() -> None:
    """Set the style of the current context."""
    style, names = imgui.get_style(), imgui.Col_
    clear: Colour = (0.0, 0.0, 0.0, 0.0)
    colours: dict[Colour, tuple[imgui.Col_, ...]] = {
        TEXT: (names.text,),
        FAINT: (names.text_disabled,),
        GROUND: (names.window_bg,),
        clear: (names.child_bg, names.scrollbar_bg, names.table_row_bg),
        (0.16, 0.168, 0.18, 1.0): (names.popup_bg, names.title_bg, names.title_bg_active),
        LINE: (names.border, names.separator, names.table_row_bg_alt),
        (*PRIMARY[:3], 0.55): (names.header,),
        RAIL: (names.menu_bar_bg,),
        FIELD: (names.frame_bg,),
        RAISED: (names.button, names.frame_bg_hovered, names.header_hovered, names.scrollbar_grab),
        PRESSED: (names.button_hovered, names.frame_bg_active, names.header_active, names.scrollbar_grab_hovered),
        lighter(PRESSED): (names.button_active, names.scrollbar_grab_active),
        ACCENT: (names.slider_grab, names.check_mark, names.plot_histogram),
        lighter(ACCENT): (names.slider_grab_active,),
        (0.0, 0.0, 0.0, 0.5): (names.modal_window_dim_bg,),
        (*PRIMARY[:3], 0.7): (names.text_selected_bg,),
    }
    for colour, uses in colours.items():
        for name in uses:
            style.set_color_(name, colour)
    style.window_padding = imgui.ImVec2(12, 8)
    style.frame_padding = imgui.ImVec2(8, 4)
    style.item_spacing = imgui.ImVec2(8, 6)
    style.item_inner_spacing = imgui.ImVec2(6, 4)
    style.window_border_size = style.child_border_size = 0.0
    style.popup_border_size = 1.0
    style.window_rounding = style.popup_rounding = 6.0
    style.frame_rounding = style.child_rounding = style.grab_rounding = 4.0
    style.scrollbar_size, style.scrollbar_rounding, style.grab_min_size = 10.0, 5.0, 10.0


def outlined(lines: imgui.ImDrawList, ends: Iterable[Sequence[Pair]], colour: int, thick: float = 1.0) -> None:
    """Draw lines with dark edges, so that they are visible on any picture."""
    pairs = list(ends)
    for shade, wide in ((DARK, thick + 2.0), (colour, thick)):
        for start, end in pairs:
            lines.add_line(start, end, shade, wide)


def outlined_way(lines: imgui.ImDrawList, points: list[Any], colour: int, thick: float = 1.0) -> None:
    """Draw a line through points with dark edges."""
    for shade, wide in ((DARK, thick + 2.0), (colour, thick)):
        lines.add_polyline(points, col=shade, thickness=wide, flags=imgui.ImDrawFlags_.none)


def diamond(lines: imgui.ImDrawList, at: Pair, size: float, colour: int, edge: float = 1.0, full: bool = True) -> None:
    """Draw a diamond with a dark edge; or, if it is not full, the edge alone, in its colour."""
    (x, y), ways = at, ((0, -size), (size, 0), (0, size), (-size, 0), (0, -size))
    corners: list[Any] = [(x + a, y + b) for a, b in ways]
    if full:
        lines.add_convex_poly_filled(corners[:-1], colour)
    lines.add_polyline(corners, DARK if full else colour, edge, 0)


BEFORE, AFTER, KEY = "\uf053", "\uf054", "\uf219"
SEEN, HIDDEN, PLAY, PAUSE, CROSS = "\uf06e", "\uf070", "\uf04b", "\uf04c", "\uf00d"
ICONS = {
    "grab": "\uf256",
    "twist": "\uf751",
    "bloat": "\uf31e",
    "pucker": "\uf78c",
    "pinch": "\uf422",
    "path": "\uf4d7",
    "restore": "\uf12d",
    "push": "\uf0a5",
    "smooth": "\uf773",
    "pin": "\uf08d",
    "freeze": "\uf2dc",
    "thaw": "\uf043",
    "level": "\uf545",
    "keystone": "\uf5ee",
}
"""Icons of tools, by their names."""


def draw_icon(lines: imgui.ImDrawList, icon: str, middle: tuple[float, float], size: float, colour: int) -> None:
    """Draw an icon about a point, in letters of a size in logical pixels."""
    font, (x, y) = imgui.get_font(), middle
    box = font.get_font_baked(size).find_glyph(ord(icon))
    at = (round(x - 0.5 * (box.x0 + box.x1)), round(y - 0.5 * (box.y0 + box.y1)))
    lines.add_text(font, size, at, colour, icon)
