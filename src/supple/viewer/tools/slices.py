"""The tools of a volume in four views: its rendering, and three planes through the crosshair."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from supple.render.camera import Camera
from supple.render.picture import Pick
from supple.space.geometry import Geometry
from supple.viewer.document.editing import Document
from supple.viewer.tools.brushes import GRIP, ZOOM, VolumeTools, pans
from supple.viewer.tools.drags import Held, Pair
from supple.viewer.tools.gestures import Event, Lead, commanded, shifted
from supple.viewer.tools.planes import (
    RENDERED,
    Pane,
    Place,
    Sight,
    fitting,
    holding,
    places_of,
    planes_of,
)

BUTTON = 22.0  # logical pixels of the button that enlarges a view, in its upper right corner
_CROSS, _SLIDE, _LEVEL, _CUT = "cross", "slide", "level", "cut"
_SLOW = 200.0  # logical pixels of a right drag that widen the window by a factor of e, or move it by its width
_LEFT, _RIGHT = 1, 2
_KEYS = {"1": 0, "2": 1, "3": 2, "4": RENDERED}


class SliceTools(VolumeTools):
    """The tools of a volume in four views: in a plane, a left drag pulls what is under the pointer within the plane.

    ``window`` are the values that are black and white in the planes at first; the other parameters are those of
    `VolumeTools`.
    """

    def __init__(
        self,
        document: Document,
        geometry: Geometry,
        canvas_size: Pair,
        pick: Callable[[float, float], Pick | None],
        drag: Callable[[Pick, Pair], tuple[float, ...]],
        window: Pair,
        points: npt.NDArray[np.float64] | None = None,
    ) -> None:
        super().__init__(document, geometry, canvas_size, pick, drag, points)
        self.geometry, self.planes = geometry, planes_of(geometry)
        self.sizes = tuple(reversed(document.shape))
        self.across = self.planes[2].axis  # to the left and right of the patient
        self.middle = 0.5 * (self.sizes[self.across] - 1)
        x, y, z = ((n - 1) / 2 for n in self.sizes)
        self.sight = self._first = Sight((x, y, z), window, (x, y, z))
        self.active = RENDERED
        """The view under the pointer; during a gesture, that in which it began."""
        self.places: dict[int, Place] = {}
        self._whole, self._base = canvas_size, self.sight
        self._arrange()

    def _arrange(self) -> None:
        """Place the views on the canvas."""
        self.places = places_of(self._whole, self.sight.large)
        if RENDERED in self.places:
            left, top, width, height = self.places[RENDERED]
            self.corner = left, top
            self.stage = replace(self.stage, size=(max(1, round(height)), max(1, round(width))))
        if self.active not in self.places:
            self.active = next(iter(self.places))

    def enlarge(self, which: int | None) -> None:
        """Give a view the whole canvas; None shows all four."""
        self.sight = replace(self.sight, large=which)
        self._arrange()

    @property
    def index(self) -> tuple[int, ...]:
        """The voxel under the crosshair, x first."""
        return tuple(math.floor(p + 0.5) for p in self.sight.cross)

    def pane(self, k: int) -> Pane:
        """Return a visible plane in its place."""
        sight, spacing = self.sight, self.geometry.spacing
        scale = sight.zoom * fitting(self.places, self.planes, self.sizes, spacing)
        return Pane(self.planes[k], self.places[k], self.index, sight.middle, scale, spacing, self.sizes)

    @property
    def pane_under(self) -> Pane | None:
        """The plane under the pointer, or in which the gesture began; None in the rendering."""
        return None if self.active == RENDERED else self.pane(self.active)

    @property
    def under(self) -> Pick | None:
        """The point of the rendering under the pointer."""
        return super().under if self.active == RENDERED else None

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The voxel under the pointer; it may lie between voxels."""
        pane = self.pane_under
        if pane is None or self.pointer is None:
            return super().hover
        point = pane.to_point(*self.pointer)
        return point if pane.holds(point) else None

    @property
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None outside of the volume."""
        pane, held = self.pane_under, self.held
        if pane is None:
            return super().ring
        if held is None and self.hover is None:
            return None
        return (self.radius if held is None else held.stroke.radius) * self._scale(())

    @property
    def knob(self) -> Pair | None:
        """The position of the knob of the split in the view under the pointer; None without a split."""
        return self.knob_of(self.active)

    def knob_of(self, k: int) -> Pair | None:
        """Return the position of the knob of the split in a view; None without a split."""
        left, top, width, height = self.places[k]
        return None if self.split is None else (left + self.split * width, top + 0.5 * height)

    @property
    def grip(self) -> Pair | None:
        """The position of the knob of the line of symmetry in the view under the pointer; None where it has none."""
        return self.grip_of(self.active)

    def grip_of(self, k: int) -> Pair | None:
        """Return the position of the knob of the line of symmetry in a view; None where it has none."""
        if not self.symmetric or k == RENDERED or self.planes[k].across != self.across:
            return None
        pane, here = self.pane(k), [0.0, 0.0, 0.0]
        here[self.across] = self.middle
        _, top, _, height = pane.place
        return pane.to_canvas(tuple(here))[0], top + height - GRIP

    def _level(self, place: Pair) -> float:
        return self.pane(self.active).to_point(*place)[self.across]

    def handle(self, event: Event) -> bool:
        """Process an event, for the view at its place; a gesture stays in its view."""
        if self._gesture is None and event.get("event_type") in ("pointer_down", "pointer_move", "wheel"):
            found = holding(self.places, float(event["x"]), float(event["y"]))
            self.active = self.active if found is None else found
        return super().handle(event)

    def abandon(self) -> bool:
        """Undo the current drag; return whether there was any."""
        if self._gesture is not None:
            self.sight = self._base
        return super().abandon()

    def button(self, k: int) -> Place:
        """Return the place of the button that enlarges a view, or shows all four."""
        left, top, width, _ = self.places[k]
        return left + width - BUTTON, top, BUTTON, BUTTON

    def _on_pointer_down(self, event: Event) -> bool:
        place = float(event["x"]), float(event["y"])
        if self._gesture is None:
            if event.get("button") == _LEFT and holding({0: self.button(self.active)}, *place) == 0:
                self.pointer = place
                self.enlarge(self.active if self.sight.large is None else None)
                return True
            self._beside = "orbit" if self.active == RENDERED else _SLIDE
            self._base = self.sight
        made = super()._on_pointer_down(event)
        if isinstance(self._gesture, Lead) and self._gesture.how == _CROSS:
            self._cross(place)
        return made

    def _leads(self, event: Event) -> str | None:
        if self.active == RENDERED:
            return super()._leads(event)
        if pans(event):
            return _SLIDE
        if event.get("button") == _RIGHT:
            return _LEVEL
        return _CROSS if event.get("button") == _LEFT and shifted(event) else None

    def _follow(self, gesture: Held | Lead[Camera], place: Pair) -> None:
        if isinstance(gesture, Held) or gesture.how not in (_CROSS, _SLIDE, _LEVEL, _CUT):
            super()._follow(gesture, place)
            return
        gesture.now = place
        dx, dy = (b - a for a, b in zip(gesture.start, place, strict=True))
        if gesture.how == _CUT:
            left, _, width, _ = self.places[self.active]
            self.split = min(max((place[0] - left) / width, 0.0), 1.0)
        elif gesture.how == _LEVEL:
            self.sight = self._base.levelled(math.exp(min(max(dx / _SLOW, -9.0), 9.0)), -dy / _SLOW)
        elif gesture.how == _SLIDE:
            self.sight = self._base.slid(replace(self.pane(self.active), middle=self._base.middle), dx, dy)
        else:
            self._cross(place)

    def _cross(self, place: Pair) -> None:
        """Move the crosshair, in the plane under the pointer, to a position of the canvas."""
        pane = self.pane(self.active)
        self.sight = self.sight.at(pane.to_point(*place), self.sizes)

    def _taken(self, x: float, y: float) -> Held | None:
        """Return what is grabbed; the crosshair goes to a new point, so that all planes show what becomes of it."""
        held = super()._taken(x, y)
        if held is not None and held.new:
            self.sight = self.sight.at(held.point, self.sizes)
        return held

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        pane = self.pane_under
        if pane is None:
            return super()._grab(x, y)
        point = pane.to_point(x, y)
        return point if pane.holds(point) else None

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        pane = self.pane_under
        if pane is None:
            return super()._seen(point)
        return pane.to_canvas(point) if pane.crosses(point) else None

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        pane = self.pane_under
        if pane is None:
            return super()._carried(held, x, y)
        gone = [a - b for a, b in zip(pane.to_point(x, y), held.point, strict=True)]
        gone[pane.plane.axis] = 0.0
        return tuple(gone)

    def _scale(self, point: tuple[float, ...]) -> float:
        pane = self.pane_under
        return super()._scale(point) if pane is None else pane.scale

    def _normal(self, point: tuple[float, ...]) -> tuple[float, ...] | None:
        pane = self.pane_under
        return super()._normal(point) if pane is None else pane.plane.normal

    def _turn(self, event: Event, amount: float) -> None:
        pane = self.pane_under
        if pane is None or self.held is not None or shifted(event):
            super()._turn(event, amount)
        elif self._gesture is not None:
            return  # the gesture continues from where it began
        elif commanded(event):
            self.sight = self.sight.zoomed(pane, float(event["x"]), float(event["y"]), ZOOM ** (-amount / 100))
        else:
            self.step(self.active, -amount / 100)

    def step(self, k: int, slices: float) -> None:
        """Move the crosshair through a plane's slices; above 0, to the head, to the front or to the left."""
        plane, cross = self.planes[k], list(self.sight.cross)
        cross[plane.axis] += plane.forward * slices
        self.sight = self.sight.at(tuple(cross), self.sizes)

    def _key(self, key: str) -> bool:
        if self._gesture is not None:
            return super()._key(key)
        if key in _KEYS:
            self.enlarge(None if self.sight.large == _KEYS[key] else _KEYS[key])
        elif key in ("ArrowUp", "ArrowDown"):
            self.step(0 if self.active == RENDERED else self.active, 1 if key == "ArrowUp" else -1)
        else:
            if key == "0":
                self.sight = replace(self._first, cross=self.sight.cross, large=self.sight.large)
            return super()._key(key)
        return True

    def _on_resize(self, event: Event) -> bool:
        self._whole = float(event["width"]), float(event["height"])
        self._arrange()
        self._look(self.view)
        return True
