"""Landmarks drawn over the views of a volume, with their depths, and lines to those of a fixed volume."""

from __future__ import annotations

import math
from collections.abc import Callable

from imgui_bundle import imgui

from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.tools.drawing import Pair, Place
from supple.viewer.tools.planes import FIXED, RENDERED, Pane
from supple.viewer.tools.volumes import VolumeTools

Write = Callable[..., None]
Box = tuple[float, float, float, float]
BENT, OTHER = 0xFFF0D060, 0xFF70E070
"""The colours of landmarks of the bent volume, and of the fixed one."""
_NEARBY = 5.0  # millimetres from a plane within which a landmark is drawn, faint
_BURIED = 2.0  # millimetres behind the surface of a rendering from which on the depth is written
_BESIDE = 8.0  # logical pixels from a landmark to its name
_ROWS = 12  # the most rows by which a name is moved up or down, to find a free place


def draw(
    view: View,
    lines: imgui.ImDrawList,
    seen: Callable[[tuple[float, ...]], Pair | None],
    write: Write,
    pane: Pane | None = None,
    k: int = 0,
) -> None:
    """Draw the landmarks of view ``k``: in a plane, those in it and, faint, those nearby.

    Lines lead to them from their positions before strokes and, if the picture shows a fixed volume, from its points.
    """
    marks, tools, document = view.document.state.marks, view.tools, view.document
    if marks is None or not isinstance(tools, VolumeTools):
        return
    taken: list[Box] = []
    entries: list[tuple[str, Pair, int, float, float]] = []
    both = tools.comparison is not None and not tools.comparison.beside and pane is not None
    after = marks.moved(document.base if tools.original else document.deformation)
    for name, old, new, other in zip(
        marks.names, marks.points.tolist(), after.tolist(), marks.fixed.tolist(), strict=True
    ):
        ours = k < FIXED and math.isfinite(new[0])
        theirs = (k >= FIXED or both) and math.isfinite(other[0])
        if ours and (away := _away(new, pane)) is not None and (at := seen(tuple(new))) is not None:
            start = seen(tuple(old))
            if start is not None and math.dist(start, at) > 1.0:
                _way(lines, start, at, BENT)
            if theirs and (end := seen(tuple(other))) is not None and math.dist(at, end) > 1.0:
                _way(lines, end, at, OTHER)
            deep = 0.0 if pane is not None else _depth(tools, at, tuple(new))
            entries.append((name, at, BENT, away, deep))
        if theirs and (away := _away(other, pane)) is not None and (at := seen(tuple(other))) is not None:
            entries.append(("" if ours else name, at, OTHER, away, 0.0))
    taken += [(x - 5, y - 5, x + 5, y + 5) for _, (x, y), _, away, _ in entries if away <= 0.5]
    for name, at, colour, away, deep in entries:
        faint, full = colour & 0x90FFFFFF, away <= 0.5 and deep <= _BURIED
        theme.diamond(lines, at, 5.0, colour if full else faint, 1.5, full=full)
        if away <= 0.5 and name:
            said = f"{name}  {deep:.0f} mm deep" if deep > _BURIED else name
            size = imgui.calc_text_size(said)
            x, y, far = _room(taken, at, size.x, size.y, tools.places[k if pane is not None else RENDERED])
            taken.append((x, y, x + size.x, y + size.y))
            if far:
                lines.add_line(at, (x if x > at[0] else x + size.x, y + 0.5 * size.y), faint, 1.0)
            write(lines, (x, y), said, colour)


def _away(point: list[float], pane: Pane | None) -> float | None:
    """Return the distance of a point from a plane, in slices; None if it is too far to be drawn."""
    if pane is None:
        return 0.0
    away = abs(pane.away(tuple(point)))
    return None if away > 0.5 and away * pane.spacing[pane.plane.axis] > _NEARBY else away


def _depth(tools: VolumeTools, at: Pair, point: tuple[float, ...]) -> float:
    """Return the depth of a point behind the rendered surface, in millimetres; 0 in front of it.

    It is NaN while a button is down, when casting rays would take too long.
    """
    if tools.busy:
        return math.nan
    surface = tools.surface(at)
    if surface is None:
        return 0.0
    near, far = (tools.stage.project(tools.view, each) for each in (surface.index, point))
    return 0.0 if near is None or far is None else max(far[2] - near[2], 0.0)


def _way(lines: imgui.ImDrawList, start: Pair, end: Pair, colour: int) -> None:
    theme.outlined(lines, ((start, end),), colour & 0x90FFFFFF)
    lines.add_circle(start, 2.5, colour & 0x90FFFFFF, 0, 1.0)


def _room(taken: list[Box], at: Pair, wide: float, high: float, place: Place) -> tuple[float, float, bool]:
    """Return a free place for a name, its upper left corner, and whether it is in another row than its landmark.

    It is beside the landmark, or in the nearest free row above or below.
    """
    left, top, width, height = place
    for row in sorted(range(-_ROWS, _ROWS + 1), key=abs):
        y, away = at[1] + (row - 0.5) * high, _BESIDE * (1 + (row != 0))
        for x in (at[0] + away, at[0] - away - wide):
            x = min(max(x, left), left + width - wide) if row else x
            free = all(x >= c or x + wide <= a or y >= d or y + high <= b for a, b, c, d in taken)
            if free and left <= x <= left + width - wide and top <= y <= top + height - high:
                return x, y, row != 0
    return at[0] + _BESIDE, at[1] - 0.5 * high, False
