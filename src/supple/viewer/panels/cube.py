"""The orientation cube, drawn in a corner of the rendering."""

from __future__ import annotations

from typing import Any

from imgui_bundle import imgui

from supple.viewer.panels import theme
from supple.viewer.tools.brushes import VolumeTools

_DARKEST, _BRIGHTEST = 0.46, 0.88  # grey of faces that get no light, and all of it
_EDGE, _LETTER = 0xFF202020, 0xFF101010  # ABGR
_LARGE = 1.2  # letters of the cube, relative to others
_SLANT = (0.12, 0.3)  # of faces between which a letter appears: on narrower ones, it would lie beside them


def draw(tools: VolumeTools, lines: imgui.ImDrawList) -> None:
    """Draw the faces of the cube with their letters; the one that a click would choose is blue."""
    font, high = imgui.get_font(), _LARGE * imgui.get_font_size()
    for face in tools.cube:
        grey = _DARKEST + (_BRIGHTEST - _DARKEST) * face.lit
        colour: theme.Colour = (grey, grey, grey, 1.0)
        if face == tools.side:
            r, g, b, _ = theme.ACCENT
            colour = (r * grey / _BRIGHTEST, g * grey / _BRIGHTEST, b * grey / _BRIGHTEST, 1.0)
        corners: list[Any] = [imgui.ImVec2(*corner) for corner in face.corners]
        lines.add_convex_poly_filled(corners, imgui.color_convert_float4_to_u32(colour))
        lines.add_polyline([*corners, corners[0]], _EDGE, 1.5, 0)
        size, (x, y) = imgui.calc_text_size(face.name), face.middle
        least, most = _SLANT
        opaque = min(max((face.towards - least) / (most - least), 0.0), 1.0)
        shade = _LETTER & 0xFFFFFF | round(255 * opaque) << 24
        at = (round(x - 0.5 * _LARGE * size.x), round(y - 0.5 * _LARGE * size.y))
        lines.add_text(font, high, at, shade, face.name)
