"""Strokes held by the pointer, and the brush that draws them in a document."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.space.domain import Domain
from supple.space.freezing import Freeze
from supple.strokes import LARGEST_ANGLE, LARGEST_FACTOR, PAINTINGS, REACH, Stroke
from supple.strokes.stroke import Brush
from supple.viewer.document.editing import Document
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
"""The tools whose strokes keep their pivot, and the arguments of these strokes before the drag."""

MASKS = frozenset(("freeze", "thaw"))
"""The tools that paint the freeze mask."""
PAINTED = 2.0  # radii that a stroke of a painting reaches
PUSHED = 0.5  # radii by which a push at full strength moves the material on its way
IMMATERIAL = frozenset(("twist", "bloat", "pucker", "scale"))
"""Tools and brushes that do not depend on the Poisson ratio."""


@dataclass(frozen=True, slots=True)
class Handle:
    """A handle of a stroke: one of its points, or the end of one."""

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
    tool: Tool = "grab"  # the tool of a new stroke
    shift: bool = False
    turned: float = 0.0  # frames of the drag through time, including fractions from the wheel
    time: float = 0.0  # the whole frames of it, within the clip
    grown: bool = False  # whether the radius of an existing stroke was changed
    button: int = 1
    way: list[tuple[Pair, Point]] = field(default_factory=list)  # of a path: the places of the pointer, and its points
    beneath: Point | None = None  # of a point that is added to a stroke: where its material was before the stroke
    dabbed: Pair | None = None  # of a painting: the place of the last dab
    mask: Freeze | None = None  # the freeze mask as painted so far
    painted: list[tuple[Point, float]] = field(default_factory=list)  # of a painting: its points, and their strengths
    base: Deformation | None = None  # of a painting: the deformation on which it begins
    pressure: float | None = None  # of a pen, from 0 to 1: the greatest so far; of a painting, the present one

    @property
    def new(self) -> bool:
        """True if its point is a new one."""
        return self.item is None or self.beneath is not None

    @property
    def paints(self) -> bool:
        """True if it is a painting, which acts all along the pointer's way."""
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
        """Yield the places of the next dabs on the way to the pointer, ``apart`` logical pixels from each other."""
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

        ``gone`` is the displacement of the held point, in samples; ``radii`` that of the pointer to the right and down,
        in radii of the brush; ``normal`` the axis about which a twist turns to the right on screen, None in a picture.
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
        end = _sum(self.point, gone)
        if math.dist(self.now, self.way[-1][0] if self.way else self.start) >= NEXT:
            self.way.append((self.now, end))
        path = [point for _, point in self.way if point != end] or [self.point]
        return replace(self.stroke, by=tuple(b - a for a, b in zip(self.stroke.at, end, strict=True)), path=tuple(path))

    def _moved(self, gone: Point) -> Stroke:
        """Return the stroke with one of its points, or a point's end, moved."""
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


FELT = 0.05  # the part of a drag's displacement that is hardly visible
_FAR = np.linspace(0.05, 20.0, 400)


@lru_cache(maxsize=64)
def extent(brush: Brush, poisson: float | None, scales: int, reach: float | None, flat: float) -> float:
    """Return the distance from the point, in radii, at which `FELT` is left of the largest displacement."""
    pull: dict[str, Any] = {"by": (1.0, 0.0), "scales": scales, "flat": flat}
    given = {"grab": pull, "twist": {"angle": 1.0}}.get(brush, {"factor": 1.01})
    radius = 100.0  # of which a drag by 1 is a small part
    stroke = Stroke(at=(0.0, 0.0), brush=brush, radius=radius, poisson=poisson, reach=reach, **given)
    points = np.stack([radius * _FAR, np.zeros_like(_FAR)], 1)
    moved = np.hypot(*(Deformation((9, 9), border=None).add(stroke).forward(points) - points).T)
    return float(_FAR[np.flatnonzero(moved >= FELT * moved.max())[-1]])


STILL = 0.01  # samples: a painting whose points all move less is left out
_APART = 0.25  # radii between two dabs of the freeze mask, for an even edge
GROWTH = 1.1  # the factor of the brush for a notch of the wheel, which is 100


class Drawing(ABC):
    """A brush on a document, for each kind of media."""

    lacks: frozenset[Tool] = frozenset(("level", "keystone", "push"))  # the tools that are for other kinds of media

    def __init__(self, document: Document) -> None:
        self.document = document
        domain = Domain(document.shape, document.spacing)
        n = 3 if document.kind == "volume" else 2  # without time
        sides = [max(e, s) for e, s in zip(domain.extent[:n], domain.spacing[:n], strict=True)]
        smallest = min(domain.spacing[:n])
        self.radius_limits = (smallest, 4 * max(sides))
        self._radius = max(min(sides) / 12, smallest)
        self.brush: Tool = "grab"
        self.poisson: float | None = None
        self.scales = 1
        self.reach: float | None = REACH
        self.time_radius: float | None = None  # of strokes in time, in frames
        self.flat = 0.0  # the part of the radius of a pull that is a plateau
        self.strength = 1.0  # of a dab of a painting: the part of its full effect
        self.pen = False  # whether a pen was used
        self.pressing = True  # whether its pressure sets how much of a new stroke is made
        self.bare = False  # whether strokes have no handles
        self.symmetric = False  # whether new strokes have a mirror image
        self.across, self.middle = 0, 0.5 * (document.shape[-1] - 1)
        """The axis across the line or plane of symmetry, x is 0; and the position of this on it, in samples."""
        self.lean = 0.0
        """In a picture, the slope of the line of symmetry: samples along ``across`` for one along the other axis."""
        self.stretch: Pair = (1.0, 1.0)  # of a circle of the image on the canvas, to the right and down
        self.handed = 1.0  # the sense of a turn to the right in the image: -1.0 if it is shown mirrored

    @property
    def radius(self) -> float:
        """The brush's radius, in physical units, within `radius_limits`."""
        return self._radius

    @radius.setter
    def radius(self, radius: float) -> None:
        self._radius = self._limited(radius)

    def _limited(self, radius: float) -> float:
        low, high = self.radius_limits
        return min(max(float(radius), low), high)

    @property
    @abstractmethod
    def held(self) -> Held | None:
        """The stroke held by the pointer."""

    @abstractmethod
    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        """Return the point under a position of the canvas, for a new stroke; None if there is none."""

    @abstractmethod
    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        """Return the position of a point on the canvas, if it is visible."""

    @abstractmethod
    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        """Return the displacement of the held point to a position of the canvas."""

    @abstractmethod
    def _scale(self, point: tuple[float, ...]) -> float:
        """Return the logical pixels of a physical unit at a point; above 0 where it is seen."""

    def _normal(self, point: tuple[float, ...]) -> tuple[float, ...] | None:
        """Return the axis about which a right-handed turn is to the right on screen; None in a picture."""
        return None

    def _taken(self, x: float, y: float) -> Held | None:
        """Return a handle of the selected stroke; or a new stroke at the point under the pointer."""
        chosen = None if self.brush in PAINTINGS | MASKS else self.document.selected
        found = None if chosen is None else nearest(self.handles([chosen]), (x, y))
        if found is not None:
            (hx, hy), stroke = found.seen, self.document.seen(found.item)
            offset = x - hx, y - hy
            return Held(stroke, found.point, (x, y), (x, y), offset, found.item, found.part, found.nth, self.brush)
        point = self._grab(x, y)
        if point is None:
            return None
        if self.brush == "pin" and chosen is not None and self._takes(chosen):
            stroke, beneath = self.document.seen(chosen), self.document.beneath(chosen, point)
            more = replace(stroke, also=(*stroke.also, (point, (0.0,) * len(point))))
            nth = len(stroke.handles)
            return Held(more, point, (x, y), (x, y), item=chosen, nth=nth, tool=self.brush, beneath=beneath)
        return Held(self._begun(point), point, (x, y), (x, y), tool=self.brush)

    def _takes(self, i: int) -> bool:
        """Return whether a stroke may have one more point."""
        stroke = self.document.strokes[i]
        return stroke.brush == "grab" and not (stroke.path or stroke.hidden or stroke.is_whole)

    def _unpin(self, held: Held) -> None:
        assert held.item is not None
        stroke = self.document.strokes[held.item]
        gone = {held.nth, *self._images(stroke, stroke.handles[held.nth][0])}
        pairs = [pair for nth, pair in enumerate(stroke.handles) if nth not in gone]
        if pairs:
            (at, by), *also = pairs
            self.document.replace(held.item, replace(stroke, at=at, by=by, also=tuple(also)))
        else:
            self.document.remove(held.item)

    def _begun(self, point: tuple[float, ...]) -> Stroke:
        shape = SHAPES.get(self.brush, {"by": (0.0,) * len(point), "scales": self.scales})
        if shape.get("brush", "grab") == "grab" and self.reach is not None:
            shape = {**shape, "flat": self.flat}
        if self.document.timed:
            shape = {**shape, "time_radius": self.time_radius}
        poisson = None if self.brush in IMMATERIAL else self.poisson
        return Stroke(at=point, radius=self.radius, poisson=poisson, reach=self.reach, **shape)

    def mirror(self, ndim: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return a point of the line or plane of symmetry, and the direction across it, of length 1."""
        here, normal, other = [0.0] * ndim, [0.0] * ndim, 1 - min(self.across, 1)
        here[self.across], here[other] = self.middle, 0.5 * (self.document.shape[-1 - other] - 1)
        size = math.hypot(1.0, self.lean)
        normal[self.across], normal[other] = 1.0 / size, -self.lean / size
        return tuple(here), tuple(normal)

    @property
    def next_stroke(self) -> Stroke:
        """The stroke that the brush would make at the first sample, before any drag."""
        return self._begun((0.0,) * self.document.deformation.ndim)

    @property
    def extent(self) -> tuple[float, float | None]:
        """The extent of a stroke, in radii: the distance at which a twentieth of it is left, and its reach."""
        if self.brush in MASKS:
            return 1.0, None
        stroke = self.next_stroke if self.held is None else self.held.stroke
        reach = PAINTED if self.brush in PAINTINGS else stroke.reach
        return extent(stroke.brush, stroke.poisson, stroke.scales, reach, stroke.flat), reach

    def mirrored(self, point: tuple[float, ...]) -> tuple[float, ...]:
        """Return the mirror image of a point."""
        here, normal = self.mirror(len(point))
        return self._flipped(point, 2 * sum(a * n for a, n in zip(here, normal, strict=True)))

    def _flipped(self, v: tuple[float, ...], shift: float = 0.0) -> tuple[float, ...]:
        _, normal = self.mirror(len(v))
        away = shift - 2 * sum(a * n for a, n in zip(v, normal, strict=True))
        return tuple(a + away * n if n else a for a, n in zip(v, normal, strict=True))

    def _has_image(self, point: tuple[float, ...]) -> bool:
        """Return whether strokes are symmetric, and the mirror image of a point lies within the medium."""
        sides = zip(self.mirrored(point), self.document.shape[::-1], strict=False)
        return self.symmetric and all(-0.5 <= x <= size - 0.5 for x, size in sides)

    def _images(self, stroke: Stroke, point: tuple[float, ...]) -> list[int]:
        """Return the indices of a stroke's points that mirror a point; none unless strokes are symmetric."""
        seen, near = self.mirrored(point), 0.02 * stroke.radius
        return [k for k, (at, _) in enumerate(stroke.handles) if self.symmetric and math.dist(at, seen) <= near]

    def paired(self, before: Stroke, after: Stroke) -> Stroke:
        """Return an edited stroke in which the mirror images of edited points follow them."""
        pairs = list(after.handles)
        for nth, ((at, by), (p, v)) in enumerate(zip(before.handles, after.handles, strict=True)):
            if (at, by) == (p, v):
                continue
            flipped = self._flipped(v)
            images = self._images(before, at)
            if nth in images and p == at:  # on the line, where it stays
                pairs[nth] = p, tuple((a + b) / 2 for a, b in zip(v, flipped, strict=True))
            elif images and nth not in images:
                pairs[images[0]] = self.mirrored(p), flipped
        return replace(after, at=pairs[0][0], by=pairs[0][1], also=tuple(pairs[1:]))

    def _draw(self, held: Held) -> None:
        """Show a drag in the document, if the pointer has moved."""
        try:
            if held.masks:
                self._mask(held)
            elif held.paints:
                self._paint(held)
            elif self.document.dragging or held.moved or held.grown or held.clicks:
                if not self.document.dragging:
                    self.document.begin_drag(held.item)
                self.document.preview(*self._drawn(held), whole=held.shift)
        except SuppleError as error:  # the drag goes on
            self.document.trouble = str(error)

    def _paint(self, held: Held) -> None:
        """Restore, smooth or push the material on the pointer's way, by one stroke, unless it moves nothing."""
        document, count = self.document, len(held.painted)
        if held.tool == "push" and document.timed:
            raise SuppleError("a push is the same in every frame, and the strokes of this clip are in time")
        if held.base is None:
            held.base = document.deformation
            document.begin_drag()
        for place in held.dabs(0.5 * held.stroke.radius * self._scale(held.point)):
            if (point := self._grab(*place)) is not None:
                held.painted.append((point, max(self.strength * held.firmness, LIGHTEST)))
        points, parts = zip(*held.painted, strict=True) if held.painted else ((), ())
        radius = held.stroke.radius
        if held.tool == "push" and len(points) > 1:
            away = PUSHED * radius * sum(parts) / len(parts) * (-1 if held.shift else 1) * self.handed
            made = Stroke.push(points, by=away, radius=radius)
            line = self.mirror(2) if self._has_image(held.point) else None
            if line is None:
                document.preview(made, select=False)
            # Across the line, points and their images would pull against each other: there, one push follows the other.
            elif not document.preview(*made.symmetric(*line), select=False):
                document.preview(made, made.mirrored(*line), select=False)
        elif held.tool != "push" and len(points) > count:
            seen = [(q, x) for p, x in held.painted for q in (p, self.mirrored(p))[: 1 + self._has_image(p)]]
            points, parts = zip(*seen, strict=True)
            led = held.base.restore if held.tool == "restore" else held.base.smooth
            made = led(points, radius=radius, strength=parts, warn=False).strokes[-1]
            if max(math.hypot(*by) for _, by in made.handles) > STILL:
                document.preview(made, select=False)

    def _mask(self, held: Held) -> None:
        """Freeze or thaw the material under the pointer for later strokes; the document changes only at the end."""
        domain = self.document.deformation.domain
        mask = held.mask or self.document.freeze
        steps = (*domain.spacing[: mask.ndim],)
        if self.document.kind == "video" and mask.ndim == 3:
            steps = (*steps[:2], 0.0)  # in all frames alike
        frozen = (held.tool == "freeze") is not held.shift
        for place in held.dabs(_APART * held.stroke.radius * self._scale(held.point)):
            point = self._grab(*place)
            if point is None:
                continue
            for at in (point, self.mirrored(point))[: 1 + self.symmetric]:
                mask = mask.painted(at, held.stroke.radius, steps, frozen=frozen)
        held.mask = mask

    def _drawn(self, held: Held) -> tuple[Stroke, ...]:
        """Return the stroke of a drag, or those that make it symmetric."""
        stroke = held.stroke
        if held.moved:
            (x, y), (a, b), (u, v) = held.now, held.offset, held.start
            gone = self._carried(held, x - a, y - b)
            ring = stroke.radius * self._scale(held.point)
            stroke = held.dragged(gone, (self.handed * (x - u) / ring, (y - v) / ring), self._normal(held.point))
            if held.item is None and held.firmness < 1:
                stroke = stroke.weakened(held.firmness)
        if not held.new:
            return (self.paired(held.stroke, stroke),)
        if not self._has_image(held.point):
            return (stroke,)
        line = self.mirror(stroke.ndim)
        if held.item is None:
            return stroke.symmetric(*line)
        *pairs, (at, by) = stroke.handles  # of which the last is new
        (more,) = replace(stroke, at=at, by=by, also=()).symmetric(*line)
        return (replace(stroke, also=(*pairs[1:], *more.handles)),)

    def grow(self, notches: float) -> None:
        """Enlarge the brush, or shrink it (below 0), with the held stroke."""
        held, factor = self.held, GROWTH**notches
        if held is None or held.item is None:
            self.radius *= factor
        if held is not None:
            radius = self.radius if held.item is None else self._limited(held.stroke.radius * factor)
            held.grown |= held.item is not None and radius != held.stroke.radius
            held.stroke = replace(held.stroke, radius=radius)
            self._draw(held)

    def handles(self, among: Collection[int] | None = None) -> list[Handle]:
        """Return the visible handles of some strokes, or of all."""
        found = []
        for i, track in () if self.bare else self.document.tracks():
            if among is not None and i not in among:
                continue
            for nth, (pivot, end) in enumerate(track.handles):
                parts: dict[Part, tuple[float, ...]] = {"pivot": pivot, "end": end}
                if track.stroke.brush != "grab" or not track.stroke.strength:  # its point stays where it is
                    del parts["end"]
                for part, point in parts.items():
                    place = self._seen(point)
                    if place is not None:
                        found.append(Handle(i, part, nth, point, place))
        return found
