"""Gestures of the pointer with a button down: it holds a stroke, or moves the view."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeVar

from supple.domain import Domain
from supple.render.picture import Pick
from supple.strokes import Stroke
from supple.viewer.document.editing import Document

Pair = tuple[float, float]
V = TypeVar("V")

CLICK = 3.0
"""A pointer that is this near to where it was pressed, in logical pixels, has not moved."""
HANDLE = 8.0
"""How near the pointer must be to a handle, in logical pixels."""

Part = Literal["pivot", "end"]


def radii(document: Document) -> tuple[float, float, float]:
    """The smallest brush for a document, the one to begin with, and the largest."""
    domain = Domain(document.shape, document.spacing)
    n = 3 if document.kind == "volume" else 2  # time is not as long as it is wide
    sides = [max(e, s) for e, s in zip(domain.extent[:n], domain.spacing[:n], strict=True)]
    smallest = min(domain.spacing[:n])
    return smallest, max(min(sides) / 8, smallest), 4 * max(sides)


@dataclass(frozen=True, slots=True)
class Handle:
    """Where a stroke can be taken: its pivot, or its end.

    Parameters
    ----------
    item : int
        Which stroke of the document it is.
    part : str
        ``"pivot"`` or ``"end"``.
    point : tuple of float
    seen : (float, float)
        Where it is on the canvas.
    """

    item: int
    part: Part
    point: tuple[float, ...]
    seen: Pair


def handles(document: Document, among: Iterable[int], seen: Callable[[tuple[float, ...]], Pair | None]) -> list[Handle]:
    """The handles of some strokes that are applied and seen; ``seen`` tells where a point is on the canvas."""
    found = []
    for i in among:
        pivot, end = document.handles(i)
        parts: tuple[tuple[Part, tuple[float, ...]], ...] = (("pivot", pivot), ("end", end))
        for part, point in parts if not document.items[i].hidden else ():
            place = seen(point)
            if place is not None:
                found.append(Handle(i, part, point, place))
    return found


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
    """A stroke that the pointer holds, while the button is down.

    Parameters
    ----------
    stroke : Stroke
        As it was when the button went down; the wheel changes its radius.
    point : tuple of float
        What the pointer has hold of.
    start, now : (float, float)
        Where the pointer went down, and where it is: in logical pixels of the canvas.
    offset : (float, float)
        How far the pointer went down from the point.
    item : int or None
        Which stroke of the document it is; None for a new one.
    part : str
        What of it is held: its ``"pivot"``, or its ``"end"``.
    turned : float
        How far it was carried through time, in frames; the wheel has parts of them.
    time : float
        How many whole frames that are, up to the ends of the clip.
    grown : bool
        Whether the radius of a stroke of the document was changed.
    pick : Pick, optional
        What was picked in a volume.
    """

    stroke: Stroke
    point: tuple[float, ...]
    start: Pair
    now: Pair
    offset: Pair = (0.0, 0.0)
    item: int | None = None
    part: Part = "end"
    turned: float = 0.0
    time: float = 0.0
    grown: bool = False
    pick: Pick | None = None
    button: int = 1

    @property
    def moved(self) -> bool:
        """Return whether it is a drag; otherwise it is a click."""
        return math.dist(self.start, self.now) >= CLICK or self.time != 0

    @property
    def changed(self) -> bool:
        """Return whether there is anything to keep of it."""
        return self.moved or self.grown

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
            if not self.changed:
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

    def rebase(self, view: V) -> None:
        """Go on from where the pointer is, as the view was changed by something else."""
        self.travelled = self.moved
        self.base, self.start = view, self.now
