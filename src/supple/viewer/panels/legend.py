"""What the colours of an overlay mean."""

from __future__ import annotations

import math

from imgui_bundle import imgui

from supple.viewer.document.words import frozen
from supple.viewer.panels import theme
from supple.viewer.panels.stages import VolumeStage
from supple.viewer.panels.view import FROZEN, View
from supple.viewer.panels.widgets import hint, wrapped

NAMES = {
    "": "None",
    "grid": "Grid",
    "stretch": "Stretch",
    "residual": "Residual",
    "inversions": "Work",
    FROZEN: "Frozen",
}
"""Overlays, as they are called in the panel."""
COLD, HOT = (0.10, 0.25, 0.75, 1.0), (0.95, 0.35, 0.10, 1.0)
"""The ends of the colours, as in warm.wgsl."""
_HIGH = 10.0  # of the scale, in logical pixels
_STEPS = 40  # of one that has two ends
_SCALES: dict[str, tuple[str, tuple[str, ...]]] = {
    "stretch": ("How much larger or smaller an area is than in the original.", ("half", "same", "twice")),
    "residual": ("How far each source point misses its pixel when it is bent.", ("1/65536 px", "1/256 px", "1 px")),
    "inversions": ("Steps of Newton's method for each pixel.", ("0", "4", "8")),
    "rays": ("Inversions along each ray or, without strokes, samples.", ("0", "64", "4096")),
}


def mask(view: View) -> None:
    """Say how much is frozen, if anything is, beside the colour that it has."""
    known, held = view.document.state.rest.freeze, view.tools.held
    painted = held is not None and held.masks
    if known is None and not painted:
        return
    at, size = imgui.get_cursor_screen_pos(), imgui.get_text_line_height()
    imgui.get_window_draw_list().add_rect_filled((at.x, at.y), (at.x + size, at.y + size), theme.VEIL, 3.0)
    imgui.dummy((size, size))
    imgui.same_line()
    if painted or known is None:  # how much it is would be counted anew for each frame
        wrapped("Takes effect when you let go.")
        return
    wrapped(f"{frozen(known)}: no stroke moves it.")
    hint("Freeze (C) and Thaw (V) paint it; the overlay Frozen tints it")


def draw(view: View) -> None:
    """Draw the legend of the overlays that are shown."""
    if view.overlay == FROZEN:
        if view.tools.mask is None:
            wrapped("Nothing is frozen.")
        mask(view)
    name = "rays" if view.overlay == "inversions" and view.stage.kind == "volume" else view.overlay
    if name == "grid":
        wrapped("Lines of the original, every 32 pixels, as they are bent.")
    if name not in _SCALES:
        return
    if isinstance(view.stage, VolumeStage) and view.stage.scene.gpu is None:
        wrapped("Not shown: the CPU renders what the device cannot.")
        return
    text, marks = _SCALES[name]
    wrapped(text)
    wide, at = imgui.get_content_region_avail().x, imgui.get_cursor_screen_pos()
    lines, cold, hot = imgui.get_window_draw_list(), theme.packed(COLD), theme.packed(HOT)
    if name == "stretch":  # as plate.wgsl has it: what keeps its size keeps its colour
        for k in range(-_STEPS, _STEPS):
            opacity = math.sqrt(abs(k + 0.5) / _STEPS)
            begin, end = (round(at.x + wide * (0.5 + 0.5 * (k + more) / _STEPS)) for more in (0, 1))
            shade = theme.packed(COLD if k < 0 else HOT, opacity)
            lines.add_rect_filled((begin, at.y), (end, at.y + _HIGH), shade)
    else:
        lines.add_rect_filled_multi_color((at.x, at.y), (at.x + wide, at.y + _HIGH), cold, hot, hot, cold)
    imgui.dummy((wide, _HIGH))
    left = imgui.get_cursor_pos_x()
    for k, mark in enumerate(marks):
        part = k / (len(marks) - 1)
        imgui.set_cursor_pos_x(left + part * (wide - imgui.calc_text_size(mark).x))
        imgui.text_disabled(mark)
        if part < 1.0:
            imgui.same_line()
