"""The tools of a volume in four views: its rendering, and three planes through the crosshair."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.render.camera import Camera
from supple.render.picture import Pick
from supple.space.geometry import Geometry
from supple.viewer.document.editing import Document
from supple.viewer.tools import orbit
from supple.viewer.tools.brushes import GRIP, ZOOM, pans
from supple.viewer.tools.comparing import MODES, Comparison
from supple.viewer.tools.drawing import Held, Pair, Place
from supple.viewer.tools.gestures import Event, Lead, Tools, commanded, shifted
from supple.viewer.tools.planes import FIXED, RENDERED, Pane, Sight, Upright, fitting, holding, places_of, planes_of

BUTTON = 22.0  # logical pixels of the button that enlarges a view, in its upper right corner
_MOST_PICKS = 500
_SLOW = 200.0  # logical pixels of a right drag that widen the window by a factor of e, or move it by its width
_LEFT, _RIGHT = 1, 2
_KEYS = {"1": 0, "2": 1, "3": 2, "4": RENDERED}


class VolumeTools(Tools[Camera]):
    """The tools of a volume: a left drag pulls what is under the pointer within a plane, or parallel to the screen.

    The canvas has a width and a height of all views together, in logical pixels. ``pick`` and ``drag`` return the point
    at a pixel of the rendering and the drag to another, as `supple.render.scene.Scene` does. ``window`` has the values
    that are black and white at first; ``points``, in voxels, are in view at first, by default the whole volume.
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
        comparison: Comparison | None = None,
    ) -> None:
        super().__init__(document, Camera())
        self.comparison = comparison  # with a fixed volume, on the same grid
        self.marking = False  # whether a click sets a landmark
        self._home, self.pick, self.drag = self.view, pick, drag
        self.stage = orbit.Stage(document.shape, geometry, (1, 1), points)
        self.corner: Pair = (0.0, 0.0)  # the upper left corner of the rendering, on the canvas
        self._picked: Pick | None = None
        self._picks: tuple[object, dict[Pair, Pick | None]] = None, {}
        self.upright: Upright | None = None  # where planes are along the axes of the patient
        self.geometry, self.planes = geometry, planes_of(geometry)
        self.sizes = tuple(reversed(document.shape))
        self.across = self.planes[2].axis  # to the left and right of the patient
        self.middle = 0.5 * (self.sizes[self.across] - 1)
        x, y, z = ((n - 1) / 2 for n in self.sizes)
        self.sight = self._first = Sight((x, y, z), window, comparison.window if comparison else window, (x, y, z))
        self.active = RENDERED
        """The view under the pointer; during a gesture, that in which it began."""
        self.places: dict[int, Place] = {}
        self._whole, self._top, self._base = canvas_size, 0.0, self.sight
        self._arrange()

    def _arrange(self) -> None:
        beside = self.comparison is not None and self.comparison.beside
        self.places = places_of(self._whole, self.sight.large, self._top, beside)
        if RENDERED in self.places:
            left, top, width, height = self.places[RENDERED]
            self.corner = left, top
            self.stage = replace(self.stage, size=(max(1, round(height)), max(1, round(width))))
        if self.active not in self.places:
            self.active = next(iter(self.places))

    def enlarge(self, which: int | None) -> None:
        """Give a view the whole canvas; None shows all."""
        self.sight = replace(self.sight, large=None if which is None else which % FIXED)
        self._arrange()

    def compare(self, mode: str) -> None:
        """Compare with the fixed volume in another way."""
        if self.comparison is not None:
            self.comparison.mode = mode
            self._arrange()

    @property
    def index(self) -> tuple[int, ...]:
        """The voxel under the crosshair, x first."""
        return tuple(math.floor(p + 0.5) for p in self.sight.cross)

    @property
    def place(self) -> Place:
        """The rectangle of the view under the pointer."""
        return self.places[self.active]

    def pane(self, k: int) -> Pane:
        """Return a visible plane in its place."""
        sight, spacing, upright = self.sight, self.geometry.spacing, self.upright
        sizes = self.sizes if upright is None else upright.grid.sizes
        scale = sight.zoom * fitting(self.places, self.planes, sizes, spacing)
        index = self.index
        if upright is not None:
            index = tuple(math.floor(v + 0.5) for v in upright.seen(sight.cross))
        plane, place = self.planes[k % FIXED], self.places[k]
        return Pane(plane, place, index, sight.middle, scale, spacing, self.sizes, upright)

    def reformat(self, on: bool) -> None:
        """Show planes along the axes of the patient, or along the voxels."""
        self.upright = Upright.of(self.geometry, self.sizes) if on else None
        sizes = self.sizes if self.upright is None else self.upright.grid.sizes
        x, y, z = ((n - 1) / 2 for n in sizes)
        self.sight = replace(self.sight, middle=(x, y, z), zoom=1.0)
        self._first = replace(self._first, middle=(x, y, z))

    @property
    def pane_under(self) -> Pane | None:
        """The plane under the pointer, or in which the gesture began; None in the rendering."""
        return None if self.active == RENDERED else self.pane(self.active)

    @property
    def under(self) -> Pick | None:
        """The point of the rendering under the pointer."""
        if self.active != RENDERED or self.pointer is None or self.side is not None:
            return None
        return self.surface(self.pointer)

    @property
    def busy(self) -> bool:
        """True if a button is down."""
        return self._gesture is not None

    def surface(self, place: Pair) -> Pick | None:
        """Return the rendered point at a position of the canvas; results are cached for a camera and strokes."""
        key = self.view, self.stage.size, self.document.revision
        if self._picks[0] != key or len(self._picks[1]) > _MOST_PICKS:
            self._picks = key, {}
        known = self._picks[1]
        if place not in known:
            known[place] = self.pick(*self._within(*place))
        return known[place]

    def forget(self) -> None:
        """Cast rays again, after a change of the image."""
        self._picks = None, {}

    @property
    def cube(self) -> tuple[orbit.Face, ...]:
        """The visible faces of the orientation cube; none where there is no room for it."""
        return orbit.faces_of(self.stage, self.view, self.corner)

    @property
    def side(self) -> orbit.Face | None:
        """The face of the cube that a click would choose: the one under the pointer."""
        lead = self._lead(self._turn_cube)
        led = self._gesture is None or (lead is not None and not lead.moved)
        if not led or self.pointer is None:
            return None
        return next((face for face in self.cube if face.holds(*self.pointer)), None)

    def _within(self, x: float, y: float) -> Pair:
        return x - self.corner[0], y - self.corner[1]

    def projected(self, point: tuple[float, ...]) -> Pair | None:
        """Return the position on the canvas of a voxel in the rendering; None behind the camera."""
        seen = self.stage.project(self.view, point)
        return None if seen is None else (seen[0] + self.corner[0], seen[1] + self.corner[1])

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The voxel under the pointer; in a plane, it may lie between voxels."""
        pane = self.pane_under
        if pane is None:
            return None if self.under is None else self.under.index
        point = None if self.pointer is None else pane.to_point(*self.pointer)
        return point if point is not None and pane.holds(point) else None

    @property
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None outside of the volume."""
        held = self.held
        point = self.hover if held is None else held.point
        if point is None or self.active >= FIXED or self.marking:
            return None
        return (self.radius if held is None else held.stroke.radius) * self._scale(point)

    @property
    def grip(self) -> Pair | None:
        """The position of the knob of the line of symmetry in the view under the pointer; None where it has none."""
        return self.grip_of(self.active)

    def grip_of(self, k: int) -> Pair | None:
        """Return the position of the knob of the line of symmetry in a view; None where it has none."""
        if not self.symmetric or self.upright is not None or k >= RENDERED or self.planes[k].across != self.across:
            return None
        pane, here = self.pane(k), [0.0, 0.0, 0.0]
        here[self.across] = self.middle
        _, top, _, height = pane.place
        return pane.to_canvas(tuple(here))[0], top + height - GRIP

    def _level(self, place: Pair) -> float:
        return self.pane(self.active).to_point(*place)[self.across]

    def handle(self, event: Event) -> bool:
        """Process an event for the view at its position; a gesture stays in the view in which it began."""
        if self._gesture is None and event.get("event_type") in ("pointer_down", "pointer_move", "wheel"):
            found = holding(self.places, float(event["x"]), float(event["y"]))
            self.active = self.active if found is None else found
        return super().handle(event)

    def abandon(self) -> bool:
        """Undo the current drag; return whether there was any."""
        if self._gesture is not None:
            self.sight = self._base
        elif self.marking:
            self._end_marking()
            return True
        return super().abandon()

    def button(self, k: int) -> Place:
        """Return the place of the button that enlarges a view, or shows all four."""
        left, top, width, _ = self.places[k]
        return left + width - BUTTON, top, BUTTON, BUTTON

    @property
    def _beside(self) -> Callable[[Lead[Camera]], None]:
        return self._orbit if self.active == RENDERED else self._slide

    def _on_pointer_down(self, event: Event) -> bool:
        place = float(event["x"]), float(event["y"])
        if self._gesture is None:
            if event.get("button") == _LEFT and holding({0: self.button(self.active)}, *place) == 0:
                self.pointer = place
                self.enlarge(self.active if self.sight.large is None else None)
                return True
            self._base = self.sight
            if self.marking and event.get("button") == _LEFT and not shifted(event):
                self.pointer = place
                return self._mark()
        made = super()._on_pointer_down(event)
        if (lead := self._lead(self._cross)) is not None:
            self._cross(lead)
        return made

    def _leads(self, event: Event) -> Callable[[Lead[Camera]], None] | None:
        button, rendering = event.get("button"), self.active == RENDERED
        if pans(event):
            return self._pan if rendering else self._slide
        if button == _RIGHT and not shifted(event):
            return self._orbit if rendering else self._level_values
        if button == _LEFT and rendering and self.side is not None:
            return self._turn_cube
        crosses = shifted(event) or self.active >= FIXED
        return self._cross if button == _LEFT and not rendering and crosses else None

    def _orbit(self, lead: Lead[Camera]) -> None:
        self.view = orbit.orbit(lead.base, *lead.gone, self.stage) if any(lead.gone) else lead.base

    def _turn_cube(self, lead: Lead[Camera]) -> None:
        self._orbit(lead)

    def _pan(self, lead: Lead[Camera]) -> None:
        self.view = orbit.pan(lead.base, *lead.gone, self.stage) if any(lead.gone) else lead.base

    def _level_values(self, lead: Lead[Camera]) -> None:
        x, y = lead.gone
        wider = math.exp(min(max(x / _SLOW, -9.0), 9.0))
        self.sight = self._base.levelled(wider, -y / _SLOW, fixed=self.active >= FIXED)

    def _slide(self, lead: Lead[Camera]) -> None:
        self.sight = self._base.slid(replace(self.pane(self.active), middle=self._base.middle), *lead.gone)

    def _cross(self, lead: Lead[Camera]) -> None:
        """Move the crosshair, in the plane under the pointer, to the pointer."""
        self.sight = self.sight.at(self.pane(self.active).to_point(*lead.now), self.sizes)

    @property
    def status(self) -> str | None:
        """The reason for a refused action, or what a click sets, in a line."""
        if not self.marking or self.document.state.marks is None:
            return super().status
        beside = self.comparison is not None and self.comparison.beside
        if self.document.state.marks.open is None:
            where = "in the bent volume or in the fixed one" if beside else "in the bent volume"
            return f"click a point {where}; Escape ends it"
        done = bool(np.isfinite(self.document.state.marks.points[self.document.state.marks.open]).all())
        return f"click the same point in the {'fixed' if done else 'bent'} volume; Escape ends it"

    def _mark(self) -> bool:
        """Set a landmark where the pointer is, in the volume that is there; return whether it had an effect."""
        point, marks = self.hover, self.document.state.marks
        if point is None or marks is None:
            return False
        apart = self.active == RENDERED or (self.comparison is not None and self.comparison.beside)
        fixed = self.active >= FIXED if apart else None
        self.sight = self.sight.at(point, self.sizes)
        made = marks.clicked(point, self.document.deformation, fixed)
        self.marking = made.open is not None
        self.document.mark(made, f"Set landmark {made.names[-1 if marks.open is None else marks.open]}")
        return True

    def _end_marking(self) -> None:
        self.marking, marks = False, self.document.state.marks
        if marks is not None and marks.open is not None:
            self.document.mark(marks.without(marks.open), f"Drop landmark {marks.names[marks.open]}")

    def _let_go(self, lead: Lead[Camera]) -> bool:
        cube = lead.follow == self._turn_cube
        if cube and not lead.moved and self.side is not None:
            self._look(self.side.camera(self.view))
        return super()._let_go(lead) or cube

    def _taken(self, x: float, y: float) -> Held | None:
        """Return what is grabbed; the crosshair moves to a new point, so that all planes show the effect there."""
        held = super()._taken(x, y)
        if held is not None and held.new:
            self.sight = self.sight.at(held.point, self.sizes)
        return held

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        pane = self.pane_under
        if pane is not None:
            point = pane.to_point(x, y)
            return point if pane.holds(point) else None
        found = self._picked = self.pick(*self._within(x, y))
        if found is None:
            return None
        # A picked point lies in the volume, up to rounding.
        return tuple(np.clip(found.index, -0.5, np.array(self.sizes) - 0.5).tolist())

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        pane = self.pane_under
        if pane is None:
            return self.projected(point)
        return pane.to_canvas(point) if pane.crosses(point) else None

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        pane = self.pane_under
        if pane is None:
            # A handle has no fixed depth; only its position on screen counts.
            picked = self._picked if held.new else None
            held_at: Pick = picked or Pick(held.point, held.point, 0.0)  # type: ignore[arg-type]
            return self.drag(held_at, self._within(x, y))
        gone = [a - b for a, b in zip(pane.under(x, y), pane.own(held.point), strict=True)]
        gone[pane.plane.axis] = 0.0
        if pane.upright is not None:
            gone = (pane.upright.inverse[:3, :3] @ gone).tolist()
        return tuple(gone)

    def _scale(self, point: tuple[float, ...]) -> float:
        pane = self.pane_under
        return self.stage.scale(self.view, point) if pane is None else pane.scale

    def _normal(self, point: tuple[float, ...]) -> tuple[float, ...] | None:
        pane = self.pane_under
        if pane is not None and pane.upright is not None:
            turn = self.geometry.direction.T @ np.array(pane.upright.grid.direction)
            return tuple((turn @ pane.plane.normal).tolist())
        if pane is not None:
            return pane.plane.normal
        seen = self.stage.view(self.view)
        normal = np.cross(*seen.packed[3:]) / seen.spacing  # the axes of the screen, in millimetres
        return tuple((normal / np.linalg.norm(normal)).tolist())

    def _turn(self, event: Event, amount: float) -> None:
        pane = self.pane_under
        if self.held is not None or shifted(event):
            self.grow(-amount / 100)  # a moving camera would change the position of the held point
        elif pane is None:
            self._look(orbit.dolly(self.view, amount, self.stage))
        elif self._gesture is not None:
            return  # the gesture continues from where it began
        elif commanded(event):
            self.sight = self.sight.zoomed(pane, float(event["x"]), float(event["y"]), ZOOM ** (-amount / 100))
        else:
            self.step(self.active, -amount / 100)

    def step(self, k: int, slices: float) -> None:
        """Move the crosshair through a plane's slices; above 0, to the head, to the front or to the left."""
        plane, upright, cross = self.planes[k % FIXED], self.upright, self.sight.cross
        moved = list(cross if upright is None else upright.seen(cross))
        moved[plane.axis] += plane.forward * slices
        self.sight = self.sight.at(tuple(moved) if upright is None else upright.voxel(tuple(moved)), self.sizes)

    def _key(self, key: str) -> bool:
        if key == "0" and self.held is None:
            if self._gesture is None:
                self.sight = replace(self._first, cross=self.sight.cross, large=self.sight.large)
            self._look(self._home)
        elif self._gesture is not None:
            return False
        elif key in _KEYS:
            self.enlarge(None if self.sight.large == _KEYS[key] else _KEYS[key])
        elif key in ("x", "X", "l", "L") and self.comparison is None:
            raise SuppleError("there is no fixed volume beside this one: open both by --fixed")
        elif key in ("x", "X") and self.comparison is not None:
            modes = [*MODES, *MODES]
            self.compare(modes[modes.index(self.comparison.mode) + 1])
        elif key in ("l", "L") and self.document.state.marks is not None:
            marking = not self.marking
            self._end_marking()
            self.marking = marking
        elif key in ("ArrowUp", "ArrowDown"):
            self.step(0 if self.active == RENDERED else self.active, 1 if key == "ArrowUp" else -1)
        else:
            return False
        return True

    def _on_resize(self, event: Event) -> bool:
        self._whole, self._top = (float(event["width"]), float(event["height"])), event.get("top", 0.0)
        self._arrange()
        self._look(self.view)
        return True
