"""The straightening of a picture: its section of the panel, and the frame and the line over the picture."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from imgui_bundle import imgui

from supple.errors import SuppleError
from supple.space.straighten import FRAMES, Straighten
from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import button, choice, label, section, typed
from supple.viewer.tools.brushes import ImageTools

_BESIDE = 0xA0101010  # the shade over parts that an export leaves out
_TURN = "Degrees clockwise. Or draw a line along the horizon with the tool Level (Y). An export is one resampling"
_KEYSTONE = (
    "Drag four corners onto what shall be an upright rectangle (K), as a door or a page: the perspective goes away. "
    "While they are drawn, the picture is shown as it is, and what the result leaves out is dark"
)
_FIT = "crop: the largest frame without empty corners; pad: all of the picture; keep: the frame of the picture"


def draw(view: View) -> None:
    """Draw the section."""
    document = view.document
    given, tools = document.state.rest.straighten, view.tools
    used = given is not None or tools.brush in ("level", "keystone")
    if "level" in tools.lacks or not section(view, "Straighten", shown=used):
        return
    known = given or Straighten()
    degrees = typed(view, "Turn", known.rotate, "%.2f", _TURN)
    if degrees is not None:
        view.attempt(lambda: document.set_rest(straighten=replace(known, rotate=degrees)))
    label("Keystone", _KEYSTONE)
    wide = imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x
    drawn = tools.brush == "keystone"
    if button("Draw its frame", wide * (0.6 if known.keystone else 1.0), _KEYSTONE, on=drawn):
        tools.brush = "grab" if drawn else "keystone"
        view.refresh()
    if known.keystone:
        imgui.same_line()
        if button("Remove"):
            view.attempt(lambda: document.set_rest(straighten=replace(known, keystone=())))
    fit = choice("Frame", known.fit, {name: name for name in FRAMES}, _FIT)
    if fit != known.fit:
        view.attempt(lambda: document.set_rest(straighten=replace(known, fit=fit)))  # type: ignore[arg-type]
    if button("As it was", 0.0, enabled=document.state.rest.straighten is not None):
        view.attempt(partial(document.set_rest, straighten=None))


def overlay(view: View, tools: ImageTools, lines: imgui.ImDrawList) -> None:
    """Draw the frame of the result, darker beside it, and the line that shall be level."""
    known, size = view.document.state.rest.straighten, view.document.shape[::-1]
    if known is not None and not tools.original:
        try:
            matrix, (width, height) = known.on(size)
        except SuppleError:
            return  # an export reports the error
        ends = np.array([(0, 0), (width, 0), (width, height), (0, height)]) - 0.5
        found = np.column_stack([ends, np.ones(4)]) @ matrix.matrix.T
        corners = [tools.view.to_canvas(*p) for p in (found[:, :2] / found[:, 2:]).tolist()]
        x, y = np.mean(corners, axis=0).tolist()
        far = [(x + 50 * (a - x), y + 50 * (b - y)) for a, b in corners]
        white = imgui.get_font_tex_uv_white_pixel()
        lines.prim_reserve(24, 16)  # not as polygons, whose smooth edges would overlap in visible seams
        for k in range(4):
            lines.prim_quad_uv(corners[k - 1], corners[k], far[k], far[k - 1], white, white, white, white, _BESIDE)
        for k in range(4):
            lines.add_line(corners[k - 1], corners[k], theme.WHITE, 1.0)
    corners = [tools.view.to_canvas(*p) for p in tools.corners]
    theme.outlined(lines, ((corners[k - 1], corner) for k, corner in enumerate(corners)), theme.BLUE, 1.5)
    for corner in corners:
        lines.add_circle_filled(corner, 6.0, theme.WHITE)
        lines.add_circle(corner, 6.0, theme.BLUE, 0, 2.0)
    if tools.line is not None:
        theme.outlined(lines, (tools.line,), theme.BLUE, 1.5)
