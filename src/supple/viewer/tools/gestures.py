"""Gestures of the pointer with a button down: it holds a stroke, or moves the view."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeVar

from supple.strokes import Stroke
from supple.viewer.document.editing import Document

Pair = tuple[float, float]
V = TypeVar("V")

CLICK = 3.0
"""A pointer that is this near to where it was pressed, in logical pixels, has not moved."""
HANDLE = 8.0
"""How near the pointer must be to a handle, in logical pixels."""

Part = Literal["pivot", "end"]


@dataclass(frozen=True, slots=True)
class Handle:
    """Where a stroke can be taken: its pivot, or its end."""

    item: int  # which stroke of the document it is
    part: Part
    point: tuple[float, ...]
    seen: Pair  # where it is on the canvas


def nearest(among: Iterable[Handle], place: Pair) -> Handle | None:
    """The handle under the pointer; where several are, the last."""
    best, reach = None, HANDLE
    for handle in among:
        away = math.dist(handle.seen, place)
        if away <= reach:
            best, reach = handle, away
    return best


@dataclass(slots=True)
class Held:
    """A stroke that the pointer holds, while the button is down; places are in logical pixels of the canvas."""

    stroke: Stroke  # as it was when the button went down; the wheel changes its radius
    point: tuple[float, ...]  # what the pointer has hold of
    start: Pair  # where the pointer went down
    now: Pair
    offset: Pair = (0.0, 0.0)  # how far that was from the point
    item: int | None = None  # which stroke of the document it is; None for a new one
    part: Part = "end"
    turned: float = 0.0  # frames that it was carried through time; the wheel has parts of them
    time: float = 0.0  # how many whole frames that are, up to the ends of the clip
    grown: bool = False  # the radius of a stroke of the document was changed
    button: int = 1

    @property
    def moved(self) -> bool:
        """Return whether it is a drag; otherwise it is a click."""
        return math.dist(self.start, self.now) >= CLICK or self.time != 0

    def drawn(self, carried: Callable[[Held, float, float], tuple[float, ...]]) -> Stroke:
        """The stroke as it is now; ``carried`` tells how far the point goes to be seen at a place of the canvas."""
        if not self.moved:
            return self.stroke
        (x, y), (a, b) = self.now, self.offset
        gone = carried(self, x - a, y - b)
        if self.item is not None and self.part == "pivot":
            return replace(self.stroke, at=tuple(p + d for p, d in zip(self.stroke.at, gone, strict=True)))
        by = tuple((p - at) + d for p, at, d in zip(self.point, self.stroke.at, gone, strict=True))
        return replace(self.stroke, by=by)

    def draw(self, document: Document, carried: Callable[[Held, float, float], tuple[float, ...]]) -> None:
        """Show it in a document; before it has moved, there is nothing to show."""
        if not document.dragging:
            if not (self.moved or self.grown):
                return
            document.begin_drag(self.item)
        document.preview(self.drawn(carried))


@dataclass(slots=True)
class Lead(Generic[V]):
    """A view that the pointer leads, while the button is down."""

    how: str
    button: int
    before: V  # when the button went down
    base: V  # when the pointer was at `start`
    start: Pair
    now: Pair
    travelled: bool = False

    @property
    def moved(self) -> bool:
        """Return whether it is a drag; otherwise it is a click."""
        return self.travelled or math.dist(self.start, self.now) >= CLICK
