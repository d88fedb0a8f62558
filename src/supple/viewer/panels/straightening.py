"""How a picture is straightened: its section of the panel, and the frame and the line over the picture."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from imgui_bundle import imgui

from supple.errors import SuppleError
from supple.space.straighten import FRAMES, Straighten
from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import hint, label, section, typed
from supple.viewer.tools.brushes import ImageTools

_BESIDE = 0xA0101010  # over what an export leaves out
_TURN = "Degrees clockwise. Or draw a line along the horizon with the tool Level (Y). An export is one resampling"
_FIT = "crop: the largest frame without empty corners; pad: all of the picture; keep: the frame of the picture"


def draw(view: View) -> None:
    """Draw the section."""
    if "level" in view.tools.lacks or not section(view, "Straighten"):
        return
    document = view.document
    known = document.state.rest.straighten or Straighten()
    label("Turn", _TURN)
    entered, degrees = typed(view, "##turn", known.rotate, "%.2f")
    hint(_TURN)
    if entered:
        view.attempt(lambda: document.set_straighten(replace(known, rotate=degrees)))
    label("Frame", _FIT)
    changed, index = imgui.combo("##frame of it", FRAMES.index(known.fit), list(FRAMES))
    hint(_FIT)
    if changed:
        view.attempt(lambda: document.set_straighten(replace(known, fit=FRAMES[index])))  # type: ignore[arg-type]
    imgui.begin_disabled(document.state.rest.straighten is None)
    if imgui.button("As it was"):
        view.attempt(partial(document.set_straighten, None))
    imgui.end_disabled()


def overlay(view: View, tools: ImageTools, lines: imgui.ImDrawList) -> None:
    """Draw the frame of the result, darker beside it, and the line that shall be level."""
    known, size = view.document.state.rest.straighten, view.document.shape[::-1]
    if known is not None and not tools.original:
        try:
            matrix, (width, height) = known.on(size)
        except SuppleError:
            return  # as an export says
        ends = np.array([(0, 0), (width, 0), (width, height), (0, height)]) - 0.5
        found = np.column_stack([ends, np.ones(4)]) @ matrix.matrix.T
        corners = [tools.view.to_canvas(*p) for p in (found[:, :2] / found[:, 2:]).tolist()]
        x, y = np.mean(corners, axis=0).tolist()
        far = [(x + 50 * (a - x), y + 50 * (b - y)) for a, b in corners]
        for k in range(4):
            lines.add_quad_filled(corners[k - 1], corners[k], far[k], far[k - 1], _BESIDE)
            lines.add_line(corners[k - 1], corners[k], theme.WHITE, 1.0)
    if tools.line is not None:
        for shade, thick in ((theme.DARK, 3.0), (theme.BLUE, 1.5)):
            lines.add_line(*tools.line, shade, thick)
