"""What the pointer holds, and the stroke that a drag of it makes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from supple.space.freezing import Freeze
from supple.strokes import LARGEST_ANGLE, LARGEST_FACTOR, PAINTINGS, Stroke
from supple.viewer.tools.keys import Tool

Pair = tuple[float, float]
Point = tuple[float, ...]
Place = tuple[float, float, float, float]
"""A rectangle of the canvas: left, top, width and height, in logical pixels."""
Part = Literal["pivot", "end"]

CLICK = 3.0  # logical pixels that a click may move
HANDLE = 8.0  # the largest distance of the pointer from a handle, in logical pixels
TURN = 90.0  # degrees of a twist for a drag to the right by the brush's radius
NEXT = 4.0  # logical pixels between two points of a path
LIGHTEST = 0.01  # the part of a stroke that the lightest touch of a pen makes
STRONGEST = 2.0  # radii of a drag that scales by a factor of e
SHAPES: dict[Tool, dict[str, Any]] = {
    "twist": {"brush": "twist", "angle": 0.0},
    "bloat": {"brush": "scale", "factor": 1.0},
    "pucker": {"brush": "scale", "factor": 1.0},
    "pinch": {"brush": "pinch", "factor": 1.0},
}
"""The tools whose strokes keep their pivot, and what these are before the drag."""

MASKS = frozenset(("freeze", "thaw"))
"""The tools that paint the freeze mask."""
PAINTED = 2.0  # radii that a stroke of a painting reaches
IMMATERIAL = frozenset(("twist", "bloat", "pucker", "scale"))
"""Tools and brushes that do not depend on the Poisson ratio."""


@dataclass(frozen=True, slots=True)
class Handle:
    """A handle of a stroke: a point of it, or where that ends."""

    item: int  # the index of its stroke
    part: Part
    nth: int  # of the stroke's points
    point: Point
    seen: Pair  # the position on the canvas


def nearest(among: Iterable[Handle], place: Pair) -> Handle | None:
    """Return the handle under the pointer; of several, the last."""
    best, reach = None, HANDLE
    for handle in among:
        away = math.dist(handle.seen, place)
        if away <= reach:
            best, reach = handle, away
    return best


@dataclass(slots=True)
class Held:
    """A stroke held by the pointer, while the button is down; positions are in logical pixels of the canvas."""

    stroke: Stroke  # at the start of the drag; the wheel changes its radius
    point: Point  # the held point
    start: Pair  # the start of the drag
    now: Pair
    offset: Pair = (0.0, 0.0)  # from the point to the start
    item: int | None = None  # the index of the stroke; None for a new one
    part: Part = "end"
    nth: int = 0  # which of the stroke's points
    tool: Tool = "grab"  # what draws a new stroke
    shift: bool = False
    turned: float = 0.0  # frames of the drag through time, including fractions from the wheel
    time: float = 0.0  # the whole frames of it, within the clip
    grown: bool = False  # whether the radius of an existing stroke was changed
    button: int = 1
    way: list[tuple[Pair, Point]] = field(default_factory=list)  # of a path: the places of the pointer, and its points
    beneath: Point | None = None  # of a point that is added to a stroke: where its material was before the stroke
    dabbed: Pair | None = None  # of a painting: the place of the last dab
    mask: Freeze | None = None  # of the freeze mask: what it is so far
    made: list[Stroke] = field(default_factory=list)  # and its strokes
    pressure: float | None = None  # of a pen, from 0 to 1: the greatest so far; of a painting, the present one

    @property
    def new(self) -> bool:
        """True if its point is a new one."""
        return self.item is None or self.beneath is not None

    @property
    def paints(self) -> bool:
        """True if it makes a stroke for each part of its way."""
        return self.item is None and self.tool in PAINTINGS

    @property
    def masks(self) -> bool:
        """True if it paints the freeze mask."""
        return self.item is None and self.tool in MASKS

    @property
    def shapes(self) -> bool:
        """True if it makes a stroke whose point stays where it is."""
        return self.item is None and self.tool in SHAPES

    @property
    def clicks(self) -> bool:
        """True if a click is enough."""
        return self.paints or self.masks or (self.new and self.tool == "pin")

    @property
    def firmness(self) -> float:
        """The part of a new stroke that a pen's pressure asks for: all of it without a pen."""
        return 1.0 if self.pressure is None else max(1 - (1 - self.pressure) ** 2, LIGHTEST)

    @property
    def moved(self) -> bool:
        """True if it is a drag; otherwise it is a click."""
        return math.dist(self.start, self.now) >= CLICK or self.time != 0 or len(self.way) > 1

    def dabs(self, apart: float) -> Iterator[Pair]:
        """Return the places of the next dabs, as far apart as that, on the way to the pointer."""
        if self.dabbed is None:
            self.dabbed = self.start
            yield self.start
        while (away := math.dist(self.dabbed, self.now)) >= max(apart, 1.0):
            part = max(apart, 1.0) / away
            (a, b), (x, y) = self.dabbed, self.now
            self.dabbed = a + part * (x - a), b + part * (y - b)
            yield self.dabbed

    def dragged(self, gone: Point, radii: Pair, normal: Point | None) -> Stroke:
        """Return the stroke after a drag.

        Parameters
        ----------
        gone : tuple of float
            The displacement of the held point, in samples.
        radii : (float, float)
            The pointer's way to the right and down, in radii of the brush.
        normal : tuple of float, optional
            The axis about which a twist turns to the right on screen; None in a picture.
        """
        if not self.shapes:
            return self._led(gone) if self.item is None and self.tool == "path" else self._moved(gone)
        if self.tool == "twist":
            angle = TURN * radii[0]
            return replace(self.stroke, angle=min(max(angle, -LARGEST_ANGLE), LARGEST_ANGLE), axis=normal)
        power = min(math.hypot(*radii) / STRONGEST, math.log(LARGEST_FACTOR))
        factor = math.exp(power if self.tool == "bloat" or (self.tool == "pinch" and self.shift) else -power)
        made = replace(self.stroke, factor=min(max(factor, 1 / LARGEST_FACTOR), LARGEST_FACTOR))
        return replace(made, axis=gone) if self.tool == "pinch" and any(gone) else made

    def _led(self, gone: Point) -> Stroke:
        """Return a grab along the way so far."""
        end = _sum(self.point, gone)
        if math.dist(self.now, self.way[-1][0] if self.way else self.start) >= NEXT:
            self.way.append((self.now, end))
        path = [point for _, point in self.way if point != end] or [self.point]
        return replace(self.stroke, by=tuple(b - a for a, b in zip(self.stroke.at, end, strict=True)), path=tuple(path))

    def _moved(self, gone: Point) -> Stroke:
        """Return the stroke with one of its points, or the end of that, moved."""
        pairs, path = list(self.stroke.handles), self.stroke.path
        at, by = pairs[self.nth]
        if self.item is not None and self.part == "pivot":
            at, path = _sum(at, gone), tuple(_sum(p, gone) for p in path)
        else:
            at = self.beneath or at
            by = tuple((p - a) + d for p, a, d in zip(self.point, at, gone, strict=True))
        pairs[self.nth] = at, by
        return replace(self.stroke, at=pairs[0][0], by=pairs[0][1], also=tuple(pairs[1:]), path=path)


def _sum(a: Point, b: Point) -> Point:
    return tuple(x + y for x, y in zip(a, b, strict=True))
