"""The brushes of images, videos and volumes: their reaction to drags, the wheel and keys."""

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
from supple.viewer.tools import orbit
from supple.viewer.tools.cube import Face, face_at, faces_of
from supple.viewer.tools.drags import Held, Pair
from supple.viewer.tools.gestures import Event, Lead, Tools, commanded, shifted
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.viewport import UPRIGHT, Turn, Viewport

GRIP = 40.0  # logical pixels from the lower edge of a view to the knob of the line of symmetry
ZOOM = 1.2  # the zoom factor of a notch of the wheel, which is 100

_LEFT, _RIGHT, _MIDDLE = 1, 2, 3
_CUBE = "cube"


def pans(event: Event) -> bool:
    """Return whether a button moves the view."""
    button = event.get("button")
    return button == _MIDDLE or (button == _LEFT and "Alt" in event.get("modifiers", ()))


class ImageTools(Tools[Viewport]):
    """The tools of an image: a left drag pulls the point under the pointer.

    The canvas has a width and a height in logical pixels; the ratio is that of physical to logical pixels. The image is
    shown turned, as a `Viewport` does it; points, strokes and the brush's radius are those of the stored one.
    """

    def __init__(self, document: Document, canvas_size: Pair, pixel_ratio: float = 1.0, turn: Turn = UPRIGHT) -> None:
        height, width = document.shape[-2:]
        super().__init__(document, Viewport((width, height), canvas_size, pixel_ratio, turn))
        a, b, c, d = turn
        self.stretch, self.handed = self.view.stretch, math.copysign(1.0, a * d - b * c)
        if not a:  # the axis that is shown from left to right
            self.across, self.middle = 1, 0.5 * (height - 1)

    @property
    def viewport(self) -> Viewport:
        """The position of the image on the canvas."""
        return self.view

    @viewport.setter
    def viewport(self, viewport: Viewport) -> None:
        self.view = viewport

    @property
    def canvas_size(self) -> Pair:
        """The width and height of the canvas, in logical pixels."""
        return self.view.canvas_size

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The point under the pointer, in pixels; it may lie outside the image."""
        return None if self.pointer is None else self.view.to_image(*self.pointer)

    @property
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None outside of the canvas."""
        held, pointer = self.held, self.pointer
        if pointer is None or not all(p < n for p, n in zip(pointer, self.canvas_size, strict=True)):
            return None
        return (self.radius if held is None else held.stroke.radius) * self._scale(())

    @property
    def grip(self) -> Pair | None:
        """The position of the knob of the line of symmetry; None where that is not drawn."""
        at = self.view.to_canvas(self.middle, self.middle)[0], self.canvas_size[1] - GRIP
        return at if self.symmetric else None

    def _level(self, place: Pair) -> float:
        return self.view.to_image(*place)[self.across]

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        point = self.view.to_image(x, y)
        return point if self.view.holds(*point) else None

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        return self.view.to_canvas(*point[:2])

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        return tuple(a - b for a, b in zip(self.view.to_image(x, y), held.point, strict=False))

    def _scale(self, point: tuple[float, ...]) -> float:
        return self.view.zoom

    def _led(self, how: str, view: Viewport, dx: float, dy: float) -> Viewport:
        return view.pan(dx, dy) if how == "pan" else view

    def _leads(self, event: Event) -> str | None:
        return "pan" if pans(event) else None

    def _turn(self, event: Event, amount: float) -> None:
        if commanded(event):
            self._look(self.view.zoom_about(float(event["x"]), float(event["y"]), ZOOM ** (-amount / 100)))
        else:
            self.grow(-amount / 100)

    def _key(self, key: str) -> bool:
        if key not in ("0", "1"):
            return False
        self._look(self.view.fit() if key == "0" else self.view.actual())
        return True

    def _on_resize(self, event: Event) -> bool:
        self._look(self.view.resize((float(event["width"]), float(event["height"])), event.get("pixel_ratio")))
        return True


class VideoTools(ImageTools):
    """The tools of a clip: the held point can be moved through time, too, by the wheel or the arrow keys."""

    def __init__(
        self,
        document: Document,
        playback: Playback,
        canvas_size: Pair,
        pixel_ratio: float = 1.0,
        turn: Turn = UPRIGHT,
    ) -> None:
        super().__init__(document, canvas_size, pixel_ratio, turn)
        self.playback = playback
        self._frame = 0  # displayed at the start of the drag

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The point under the pointer, in pixels and frames."""
        point = super().hover
        return None if point is None else (*point, float(self.playback.frame))

    @property
    def stroke_frames(self) -> dict[float, bool]:
        """The frames of the clip at which visible strokes begin or end, and whether a stroke there is selected."""
        found: dict[float, bool] = {}
        for i, item in enumerate(self.document.items):
            for at, by in () if item.hidden else item.stroke.handles:
                for t in {at[2], at[2] + by[2]}:
                    if 0 <= t <= self.playback.count - 1:
                        found[t] = found.get(t, False) or i == self.document.selected
        return found

    def _taken(self, x: float, y: float) -> Held | None:
        self.playback.pause()
        self._frame = self.playback.frame
        return super()._taken(x, y)

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        under = super()._grab(x, y)
        return None if under is None else (*under, float(self._frame))

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        return super()._seen(point) if abs(point[2] - self.playback.frame) <= 0.5 else None

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        return (*super()._carried(held, x, y), held.time)

    def _put_back(self, held: Held) -> None:
        self.playback.seek(self._frame)

    def _carry(self, held: Held, frames: float) -> None:
        """Move the held point through time, by whole frames; the displayed frame follows."""
        start = held.point[2]
        first, last = -start, self.playback.count - 1 - start
        held.turned = min(max(held.turned + frames, first), last)
        held.time = min(max(math.floor(held.turned + 0.5), first), last)
        self.playback.seek(start + held.time)
        self._draw(held)

    def _turn(self, event: Event, amount: float) -> None:
        held = self.held
        if held is None or held.shapes or held.masks or commanded(event) or shifted(event):
            super()._turn(event, amount)
        else:
            self._carry(held, -amount / 100)

    def _key(self, key: str) -> bool:
        playback, held = self.playback, self.held
        step = {"ArrowLeft": -1, "ArrowRight": 1}.get(key)
        acts: dict[str, Callable[[], None]] = {
            " ": playback.toggle,
            "home": playback.home,
            "end": playback.end,
            "i": playback.mark_in,
            "o": playback.mark_out,
            "u": playback.unmark,
            "l": lambda: playback.set_loop(not playback.loop),
        }
        if held is not None and step is not None:
            if not (held.shapes or held.masks):  # those stay in their frame
                self._carry(held, step)
        elif step is not None:
            playback.step(step)
        elif key.lower() not in acts:
            return super()._key(key)
        elif held is None:  # otherwise, the displayed frame is that of the held point
            acts[key.lower()]()
        return True


class VolumeTools(Tools[Camera]):
    """The tools of a volume: a left drag pulls the picked point in the camera's plane; beside the volume, it orbits.

    ``pick`` and ``drag`` return the point at a pixel and the drag to another, as in `supple.render.scene.Scene.pick`
    and `supple.render.scene.Scene.drag`. At first, ``points`` (N, 3), in voxels, are in view; None: the whole volume.
    """

    _beside = "orbit"

    def __init__(
        self,
        document: Document,
        geometry: Geometry,
        canvas_size: Pair,
        pick: Callable[[float, float], Pick | None],
        drag: Callable[[Pick, Pair], tuple[float, ...]],
        points: npt.NDArray[np.float64] | None = None,
    ) -> None:
        super().__init__(document, Camera())
        self.home = self.view
        self.pick, self.drag = pick, drag
        self._picked: Pick | None = None
        self.corner: Pair = (0.0, 0.0)  # the upper left corner of the rendering, on the canvas
        self.stage = orbit.Stage(document.shape, geometry, _rows(canvas_size), points)
        self._under: tuple[tuple[object, ...], Pick | None] | None = None

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self.view

    @property
    def canvas_size(self) -> Pair:
        """The width and height of the rendering, in logical pixels."""
        height, width = self.stage.size
        return float(width), float(height)

    @property
    def under(self) -> Pick | None:
        """Return the point under the pointer; a ray is cast after a change of pointer, camera or strokes."""
        key = (self.pointer, self.view, self.stage.size, self.document.revision)
        if self._under is None or self._under[0] != key:
            at = None if self.side is not None else self.pointer
            self._under = key, None if at is None else self.pick(*self._within(*at))
        return self._under[1]

    @property
    def cube(self) -> tuple[Face, ...]:
        """The visible faces of the orientation cube; none where there is no room for it."""
        return faces_of(self.stage, self.view, self.corner)

    @property
    def side(self) -> Face | None:
        """The face of the cube that a click would choose: the one under the pointer."""
        gesture = self._gesture
        led = gesture is None or (isinstance(gesture, Lead) and gesture.how == _CUBE and not gesture.moved)
        return face_at(self.cube, self.pointer) if led and self.pointer is not None else None

    def _within(self, x: float, y: float) -> Pair:
        """Return a position of the canvas in the rendering."""
        return x - self.corner[0], y - self.corner[1]

    def projected(self, point: tuple[float, ...]) -> Pair | None:
        """Return the position on the canvas of a voxel in the rendering; None behind the camera."""
        seen = self.stage.project(self.view, point)
        return None if seen is None else (seen[0] + self.corner[0], seen[1] + self.corner[1])

    def forget(self) -> None:
        """Cast the ray again, after a change of the image."""
        self._under = None

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The voxel under the pointer."""
        found = self.under
        return None if found is None else found.index

    @property
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None outside of the volume."""
        held = self.held
        point = self.hover if held is None else held.point
        if point is None:
            return None
        return (self.radius if held is None else held.stroke.radius) * self._scale(point)

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        found = self._picked = self.pick(*self._within(x, y))
        if found is None:
            return None
        # A picked point lies in the volume, but for rounding.
        last = np.array(self.document.shape[::-1]) - 0.5
        return tuple(np.clip(found.index, -0.5, last).tolist())

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        return self.projected(point)

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        # A handle has no fixed depth; only its position on screen counts.
        picked = self._picked if held.new else None
        held_at: Pick = picked or Pick(held.point, held.point, 0.0)  # type: ignore[arg-type]
        return self.drag(held_at, self._within(x, y))

    def _scale(self, point: tuple[float, ...]) -> float:
        return self.stage.scale(self.view, point)

    def _normal(self, point: tuple[float, ...]) -> tuple[float, ...] | None:
        seen = self.stage.view(self.view)
        normal = np.cross(*seen.packed[3:]) / seen.spacing  # the axes of the screen, in millimetres
        return tuple((normal / np.linalg.norm(normal)).tolist())

    def _led(self, how: str, view: Camera, dx: float, dy: float) -> Camera:
        if not (dx or dy):
            return view
        return {"orbit": orbit.orbit, _CUBE: orbit.orbit, "pan": orbit.pan}[how](view, dx, dy, self.stage)

    def _leads(self, event: Event) -> str | None:
        if pans(event):
            return "pan"
        if event.get("button") == _LEFT and self.side is not None:
            return _CUBE
        return "orbit" if event.get("button") == _RIGHT else None

    def _released(self) -> bool:
        chosen = self.side if isinstance(self._gesture, Lead) else None
        if chosen is None:
            return super()._released()
        self._gesture = None
        self._look(chosen.camera(self.view))
        return True

    def _turn(self, event: Event, amount: float) -> None:
        if self.held is not None or shifted(event):
            self.grow(-amount / 100)  # a moving camera would change the position of the held point
        else:
            self._look(orbit.dolly(self.view, amount, self.stage))

    def _key(self, key: str) -> bool:
        if key != "0" or self.held is not None:
            return False
        self._look(self.home)
        return True

    def _on_resize(self, event: Event) -> bool:
        self.stage = replace(self.stage, size=_rows((event["width"], event["height"])))
        self._look(self.view)
        return True


def _rows(canvas_size: Pair) -> tuple[int, int]:
    width, height = canvas_size
    return max(1, round(height)), max(1, round(width))
