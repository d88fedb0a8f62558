"""Icons, drawn by lines about a middle; a unit is half their size."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

from imgui_bundle import imgui

WIDTH = 1.6  # of lines, in logical pixels
Pair = tuple[float, float]


Part = Callable[[imgui.ImDrawList, int], None]
"""A line or a shape that is drawn in a colour."""


class Pen:
    """A pen about the middle of an icon, which is given in logical pixels, as its unit is."""

    def __init__(self, x: float, y: float, size: float) -> None:
        self.x, self.y, self.size = x, y, size
        self.parts: list[Part] = []  # that are drawn so far

    def _at(self, places: Iterable[Pair]) -> Any:
        return [imgui.ImVec2(self.x + x * self.size, self.y + y * self.size) for x, y in places]

    def line(self, *places: Pair, closed: bool = False) -> None:
        """Draw a line through points."""
        points, flags = self._at(places), imgui.ImDrawFlags_.closed if closed else imgui.ImDrawFlags_.none
        # The order of the arguments changes by release.
        self.parts.append(lambda lines, c: lines.add_polyline(points, col=c, thickness=WIDTH, flags=flags))

    def shape(self, *places: Pair) -> None:
        """Fill a convex shape."""
        points = self._at(places)
        self.parts.append(lambda lines, colour: lines.add_convex_poly_filled(points, colour))

    def ring(self, middle: Pair, radius: float) -> None:
        """Draw a circle."""
        (at,), radius = self._at([middle]), radius * self.size
        self.parts.append(lambda lines, colour: lines.add_circle(at, radius, colour, 0, WIDTH))

    def dot(self, middle: Pair, radius: float = 0.22) -> None:
        """Fill a circle."""
        (at,), radius = self._at([middle]), radius * self.size
        self.parts.append(lambda lines, colour: lines.add_circle_filled(at, radius, colour))

    def arc(self, middle: Pair, radius: float, begin: float, end: float) -> None:
        """Draw an arc between angles in degrees, clockwise from the right."""
        self.line(*_arc(middle, radius, begin, end))

    def head(self, tip: Pair, angle: float, size: float = 0.5) -> None:
        """Fill an arrowhead which points along an angle in degrees."""
        self.shape(tip, _round(tip, -size, angle - 32), _round(tip, -size, angle + 32))


Icon = Callable[[Pen], None]


@lru_cache(maxsize=256)
def placed(icon: Icon, x: float, y: float, size: float) -> tuple[Part, ...]:
    """Return an icon about a point, in units of a size: most stay where they are from frame to frame."""
    pen = Pen(x, y, size)
    icon(pen)
    return tuple(pen.parts)


def _round(middle: Pair, radius: float, degrees: float) -> Pair:
    angle = math.radians(degrees)
    return middle[0] + radius * math.cos(angle), middle[1] + radius * math.sin(angle)


def _arc(middle: Pair, radius: float, begin: float, end: float) -> list[Pair]:
    return [_round(middle, radius, begin + k * (end - begin) / 20) for k in range(21)]


def grab(pen: Pen) -> None:
    """A point that is pulled."""
    pen.dot((-0.72, 0.72), 0.26)
    pen.line((-0.72, 0.72), (0.6, -0.6))
    pen.head((0.95, -0.95), -45, 0.75)


def twist(pen: Pen) -> None:
    """A turn about a point."""
    pen.dot((0, 0))
    pen.arc((0, 0), 0.85, -30, 240)
    pen.head(_round((0, 0), 0.85, -58), -135, 0.65)


def bloat(pen: Pen) -> None:
    """Arrows away from a circle."""
    pen.ring((0, 0), 0.32)
    for angle in (45, 135, 225, 315):
        pen.line(_round((0, 0), 0.5, angle), _round((0, 0), 0.9, angle))
        pen.head(_round((0, 0), 1.25, angle), angle)


def pucker(pen: Pen) -> None:
    """Arrows towards a point."""
    pen.dot((0, 0))
    for angle in (45, 135, 225, 315):
        pen.line(_round((0, 0), 0.8, angle), _round((0, 0), 1.25, angle))
        pen.head(_round((0, 0), 0.38, angle), angle + 180, 0.55)


def pinch(pen: Pen) -> None:
    """A line that is squeezed from both sides."""
    pen.line((0, -1), (0, 1))
    for way in (-1, 1):
        pen.line((1.1 * way, 0), (0.7 * way, 0))
        pen.head((0.28 * way, 0), 180 if way > 0 else 0, 0.6)


def path(pen: Pen) -> None:
    """A point that is led along a curve."""
    pen.dot((-0.9, 0.8), 0.26)
    pen.arc((-0.45, 0.35), 0.62, -5, 135)
    pen.arc((0.6, 0.25), 0.45, 175, 275)
    pen.head((1.1, -0.35), -25, 0.7)


def restore(pen: Pen) -> None:
    """An eraser."""
    pen.line((-0.95, 0.3), (0.25, -0.9), (0.95, -0.2), (-0.1, 0.85), (-0.4, 0.85), closed=True)
    pen.line((-0.4, -0.25), (0.3, 0.45))
    pen.line((-0.4, 0.85), (0.95, 0.85))


def smooth(pen: Pen) -> None:
    """A rough line above an even one."""
    pen.line((-1, -0.45), (-0.65, -0.9), (-0.3, -0.1), (0.1, -0.85), (0.45, -0.2), (0.75, -0.65), (1, -0.4))
    pen.arc((-0.5, 1.0), 0.6, 210, 330)
    pen.arc((0.5, 0.4), 0.6, 30, 150)


def pin(pen: Pen) -> None:
    """A pin in a place."""
    pen.arc((0, -0.3), 0.65, 150, 390)
    pen.line(_round((0, -0.3), 0.65, 150), (0, 1.05), _round((0, -0.3), 0.65, 30))
    pen.dot((0, -0.3), 0.24)


def freeze(pen: Pen) -> None:
    """A crystal of snow."""
    for angle in range(30, 390, 60):
        pen.line((0, 0), _round((0, 0), 1.05, angle))
        for side in (-40, 40):
            start = _round((0, 0), 0.6, angle)
            pen.line(start, _round(start, 0.36, angle + side))


def thaw(pen: Pen) -> None:
    """A drop."""
    pen.arc((0, 0.35), 0.68, -25, 205)
    pen.line(_round((0, 0.35), 0.68, 205), (0, -1.1), _round((0, 0.35), 0.68, -25))
    pen.arc((0, 0.35), 0.32, 90, 170)


def symmetry(pen: Pen) -> None:
    """A shape and its mirror image, about a dashed line."""
    for y in (-1.0, -0.3, 0.4):
        pen.line((0, y), (0, y + 0.4))
    pen.line((-0.35, -0.7), (-0.35, 0.7), (-1.05, 0.7), closed=True)
    pen.shape((0.35, -0.7), (1.05, 0.7), (0.35, 0.7))


def undo(pen: Pen) -> None:
    """An arrow back."""
    pen.line((-0.7, -0.35), (0.25, -0.35))
    pen.arc((0.25, 0.2), 0.55, -90, 90)
    pen.line((0.25, 0.75), (-0.4, 0.75))
    pen.head((-1.05, -0.35), 180, 0.65)


def redo(pen: Pen) -> None:
    """An arrow on."""
    pen.line((0.7, -0.35), (-0.25, -0.35))
    pen.arc((-0.25, 0.2), 0.55, 90, 270)
    pen.line((-0.25, 0.75), (0.4, 0.75))
    pen.head((1.05, -0.35), 0, 0.65)


def original(pen: Pen) -> None:
    """A circle, half of it full."""
    pen.ring((0, 0), 0.9)
    pen.shape(*_arc((0, 0), 0.9, 90, 270))


def split(pen: Pen) -> None:
    """A picture that is cut."""
    pen.line((-1, -0.75), (1, -0.75), (1, 0.75), (-1, 0.75), closed=True)
    pen.line((0, -1.05), (0, 1.05))
    pen.shape((-0.72, 0), (-0.35, -0.32), (-0.35, 0.32))
    pen.shape((0.72, 0), (0.35, 0.32), (0.35, -0.32))


def fit(pen: Pen) -> None:
    """The corners of a frame."""
    for x in (-1, 1):
        for y in (-1, 1):
            pen.line((0.4 * x, 0.85 * y), (0.95 * x, 0.85 * y), (0.95 * x, 0.3 * y))


def open_(pen: Pen) -> None:
    """A folder."""
    pen.line((-1, 0.75), (-1, -0.7), (-0.3, -0.7), (-0.05, -0.4), (0.85, -0.4), (0.85, -0.05))
    pen.line((-1, 0.75), (-0.6, -0.05), (1.2, -0.05), (0.8, 0.75), closed=True)


def save(pen: Pen) -> None:
    """A disk."""
    pen.line((-0.9, -0.9), (0.5, -0.9), (0.9, -0.5), (0.9, 0.9), (-0.9, 0.9), closed=True)
    pen.line((-0.45, -0.9), (-0.45, -0.4), (0.35, -0.4), (0.35, -0.9))
    pen.line((-0.5, 0.9), (-0.5, 0.2), (0.5, 0.2), (0.5, 0.9))


def export(pen: Pen) -> None:
    """An arrow out of a box."""
    pen.line((-0.5, -0.25), (-0.9, -0.25), (-0.9, 0.95), (0.9, 0.95), (0.9, -0.25), (0.5, -0.25))
    pen.line((0, 0.45), (0, -0.7))
    pen.head((0, -1.15), -90, 0.7)


def keys(pen: Pen) -> None:
    """A question mark."""
    pen.arc((0, -0.45), 0.5, 180, 400)
    pen.line(_round((0, -0.45), 0.5, 40), (0, 0.2), (0, 0.45))
    pen.dot((0, 0.9), 0.16)


def seen(pen: Pen) -> None:
    """An eye."""
    pen.arc((0, 0.75), 1.3, 218, 322)
    pen.arc((0, -0.75), 1.3, 38, 142)
    pen.dot((0, 0), 0.34)


def hidden(pen: Pen) -> None:
    """A closed eye."""
    pen.arc((0, -0.75), 1.3, 38, 142)
    for angle in (55, 90, 125):
        pen.line(_round((0, -0.75), 1.3, angle), _round((0, -0.75), 1.7, angle))


def play(pen: Pen) -> None:
    """A triangle to the right."""
    pen.shape((-0.6, -0.9), (0.9, 0), (-0.6, 0.9))


def pause(pen: Pen) -> None:
    """Two bars."""
    for x in (-0.7, 0.2):
        pen.shape((x, -0.8), (x + 0.5, -0.8), (x + 0.5, 0.8), (x, 0.8))


def cross(pen: Pen) -> None:
    """A cross."""
    pen.line((-0.6, -0.6), (0.6, 0.6))
    pen.line((-0.6, 0.6), (0.6, -0.6))


ICONS: dict[str, Icon] = {
    "grab": grab,
    "twist": twist,
    "bloat": bloat,
    "scale": bloat,
    "pucker": pucker,
    "pinch": pinch,
    "path": path,
    "restore": restore,
    "smooth": smooth,
    "pin": pin,
    "freeze": freeze,
    "thaw": thaw,
    "symmetry": symmetry,
    "undo": undo,
    "redo": redo,
    "original": original,
    "split": split,
    "fit": fit,
    "open": open_,
    "save": save,
    "export": export,
    "keys": keys,
}
"""Icons of tools and of actions, by their names."""
