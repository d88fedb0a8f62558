"""The brushes of images, videos and volumes: their reaction to drags, the wheel and keys."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from supple.errors import SuppleError
from supple.space.straighten import Straighten
from supple.viewer.document.editing import Document
from supple.viewer.tools.drawing import CLICK, Held, Pair, Place
from supple.viewer.tools.gestures import Event, Lead, Tools, commanded, shifted
from supple.viewer.tools.keys import Tool
from supple.viewer.tools.planes import holding
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.viewport import UPRIGHT, Turn, Viewport

GRIP = 40.0  # logical pixels from the lower edge of a view to the knob of the line of symmetry, and from the upper one
STEEPEST = 2.0  # the largest slope of the line of symmetry, `lean`
ZOOM = 1.2  # the zoom factor of a notch of the wheel, which is 100

_LEFT, _RIGHT, _MIDDLE = 1, 2, 3
LEAST = 20.0  # logical pixels of a line that shall be level


def pans(event: Event) -> bool:
    """Return whether a button moves the view."""
    button = event.get("button")
    return button == _MIDDLE or (button == _LEFT and "Alt" in event.get("modifiers", ()))


class ImageTools(Tools[Viewport]):
    """The tools of an image: a left drag pulls the point under the pointer.

    The canvas has a width and a height in logical pixels. The image is shown turned, as by a `Viewport`; points,
    strokes and the brush's radius are in pixels of the stored image.
    """

    lacks = frozenset[Tool]()

    def __init__(self, document: Document, canvas_size: Pair, turn: Turn = UPRIGHT) -> None:
        height, width = document.shape[-2:]
        super().__init__(document, Viewport((width, height), canvas_size, turn=turn))
        a, b, c, d = turn
        self.stretch, self.handed = self.view.stretch, math.copysign(1.0, a * d - b * c)
        if not a:  # the axis that is shown from left to right
            self.across, self.middle = 1, 0.5 * (height - 1)
        self._upright = turn
        self._corner = 0, (0.0, 0.0)  # of the keystone's frame, the corner that is dragged, and where it was
        document.on_change.append(self._straightened)
        self._straightened()

    def _straightened(self) -> None:
        """Show the picture as the result is; without perspective while the frame of a keystone is drawn."""
        known, turn, vanishing = self.document.state.rest.straighten, self._upright, np.zeros(2)
        if known is not None:
            flat = replace(known, keystone=()) if self.brush == "keystone" else known
            linear, vanishing = flat.seen(self.view.image_size)
            a, b, c, d = (linear @ np.reshape(turn, (2, 2))).ravel().tolist()
            turn = a, b, c, d
        g, h = vanishing.tolist()
        if (self.view.turn, self.view.vanishing) != (turn, (g, h)):
            self._look(replace(self.view, turn=turn, vanishing=(g, h)))
            self.stretch = self.view.stretch

    @property
    def brush(self) -> Tool:
        """The selected tool."""
        return self._brush

    @brush.setter
    def brush(self, brush: Tool) -> None:
        before, self._brush = getattr(self, "_brush", brush), brush
        if "keystone" in (before, brush) and before != brush:
            self._straightened()

    @property
    def corners(self) -> tuple[tuple[float, ...], ...]:
        """The corners of the keystone's frame, while it is drawn: those set, or default ones within the picture."""
        known, (width, height) = self.document.state.rest.straighten, self.view.image_size
        if self.brush != "keystone" or (known is not None and known.keystone):
            return known.keystone if known is not None and self.brush == "keystone" else ()
        x, y = 0.25 * (width - 1), 0.25 * (height - 1)
        return (x, y), (3 * x, y), (3 * x, 3 * y), (x, 3 * y)

    def _drag_corner(self, lead: Lead[Viewport]) -> None:
        document, corners = self.document, list(self.corners)
        if lead.moved and not document.dragging:
            seen = [self.view.to_canvas(*p) for p in corners]
            k = min(range(4), key=lambda k: math.dist(seen[k], lead.start))
            self._corner = k, seen[k]
            document.begin_drag()
        if document.dragging:  # the corner keeps its distance from the pointer
            (k, (u, v)), (x, y) = self._corner, lead.gone
            corners[k] = self.view.to_image(u + x, v + y)
            try:
                made = replace(document.state.rest.straighten or Straighten(), keystone=tuple(corners))
                made.on(self.view.image_size)
                document.preview_rest(straighten=made)
            except SuppleError as error:  # the drag goes on
                document.trouble = str(error)

    @property
    def line(self) -> tuple[Pair, Pair] | None:
        """The ends, on the canvas, of the line that is drawn to be level."""
        lead = self._lead(self._draw_line)
        return None if lead is None else (lead.start, lead.now)

    def _draw_line(self, lead: Lead[Viewport]) -> None:
        """Draw a line that shall be level, whose ends are those of the drag."""

    def _let_go(self, lead: Lead[Viewport]) -> bool:
        document = self.document
        if lead.follow == self._drag_corner:
            self._refused = document.trouble
            if document.dragging:
                document.commit()
            return True
        if lead.follow == self._draw_line and math.hypot(*lead.gone) >= LEAST:
            known = document.state.rest.straighten or Straighten()
            document.set_rest(straighten=known.levelled(*(self.view.to_image(*end) for end in (lead.start, lead.now))))
        return super()._let_go(lead)

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The point under the pointer, in pixels; it may lie outside the image."""
        return None if self.pointer is None else self.view.to_image(*self.pointer)

    @property
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None outside of the canvas."""
        held, pointer = self.held, None if self.brush in ("level", "keystone") else self.pointer
        if pointer is None or holding({0: self.place}, *pointer) is None:
            return None
        return (self.radius if held is None else held.stroke.radius) * self._scale(())

    @property
    def grip(self) -> Pair | None:
        """The position of the knob of the line of symmetry; None where that is not drawn."""
        return self._on_axis(sum(self.place[1::2]) - GRIP) if self.symmetric else None

    @property
    def tilt(self) -> Pair | None:
        """The position of the knob that tilts that line."""
        return self._on_axis(self.place[1] + GRIP) if self.symmetric else None

    def _on_axis(self, y: float) -> Pair:
        """Return where the line of symmetry is at a height on the canvas."""
        here, (a, b) = (v[:2] for v in self.mirror(2))
        (x0, y0), (x1, y1) = (self.view.to_canvas(here[0] - k * b, here[1] + k * a) for k in (-50, 50))
        return x0 + (y - y0) * (x1 - x0) / (y1 - y0), y

    @property
    def place(self) -> Place:
        """The whole canvas."""
        return (0.0, self.view.top, *self.view.canvas_size)

    def _level(self, place: Pair) -> float:
        point, other = self.view.to_image(*place), 1 - self.across
        return point[self.across] - self.lean * (point[other] - self.mirror(2)[0][other])

    @property
    def _knobs(self) -> dict[Callable[[Lead[Viewport]], None], Pair | None]:
        return {**super()._knobs, self._tilt: self.tilt}

    def _tilt(self, lead: Lead[Viewport]) -> None:
        """Tilt the line of symmetry about its lower knob, or set it upright if it nearly is."""
        place, about = (lead.now[0], lead.start[1]), self._on_axis(sum(self.place[1::2]) - GRIP)
        across, other, p, q = self.across, 1 - self.across, self.view.to_image(*place), self.view.to_image(*about)
        self.lean, self.middle = 0.0, q[across]
        if abs(self._on_axis(place[1])[0] - place[0]) >= CLICK:
            self.lean = min(max((p[across] - q[across]) / (p[other] - q[other]), -STEEPEST), STEEPEST)
            self.middle -= self.lean * (q[other] - self.mirror(2)[0][other])

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        point = self.view.to_image(x, y)
        return point if self.view.holds(*point) else None

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        return self.view.to_canvas(*point[:2])

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        return tuple(a - b for a, b in zip(self.view.to_image(x, y), held.point, strict=False))

    def _scale(self, point: tuple[float, ...]) -> float:
        return self.view.zoom

    def _pan(self, lead: Lead[Viewport]) -> None:
        self.view = lead.base.pan(*lead.gone)

    def _leads(self, event: Event) -> Callable[[Lead[Viewport]], None] | None:
        lines = {"level": self._draw_line, "keystone": self._drag_corner}
        return self._pan if pans(event) else lines.get(self.brush) if event.get("button") == _LEFT else None

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
        size = float(event["width"]), float(event["height"])
        self._look(self.view.resize(size, event.get("pixel_ratio"), event.get("top", 0.0)))
        return True


class VideoTools(ImageTools):
    """The tools of a clip. In strokes in time, the wheel or the arrow keys move the held point through time.

    In strokes in every frame, editing an animated property sets a key in the frame shown; with Shift, all keys move.
    """

    lacks = frozenset[Tool](("level", "keystone"))

    def __init__(
        self,
        document: Document,
        playback: Playback,
        canvas_size: Pair,
        turn: Turn = UPRIGHT,
    ) -> None:
        super().__init__(document, canvas_size, turn)
        self.playback = playback
        self._frame = 0  # displayed at the start of the drag

    @property
    def hover(self) -> tuple[float, ...] | None:
        """The point under the pointer, in pixels and frames."""
        point = super().hover
        return None if point is None else (*point, float(self.playback.frame))

    @property
    def stroke_frames(self) -> dict[float, bool]:
        """The frames of the clip where visible strokes begin, end or have keys, and whether one there is selected."""
        found: dict[float, bool] = {}
        for i, stroke in enumerate(self.document.strokes):
            frames = {float(key.frame) for key in stroke.keys}
            if self.document.timed:
                frames = {t for at, by in stroke.handles for t in (at[2], at[2] + by[2])}
            for t in () if stroke.hidden else frames:
                if 0 <= t <= self.playback.count - 1:
                    found[t] = found.get(t, False) or i == self.document.selected
        return found

    def go_to_key(self, way: int) -> None:
        """Show the frame of the next key of the selected stroke, or, with -1, of the one before."""
        chosen, here = self.document.selected, self.playback.frame
        frames = [] if chosen is None else [key.frame for key in self.document.strokes[chosen].keys]
        found = [k for k in frames if (k - here) * way > 0]
        if found:
            self.playback.pause()
            self.playback.seek(min(found, key=lambda k: abs(k - here)))

    def _taken(self, x: float, y: float) -> Held | None:
        self.playback.pause()
        self._frame = self.playback.frame
        self.document.seek(self._frame)
        return super()._taken(x, y)

    def _grab(self, x: float, y: float) -> tuple[float, ...] | None:
        under = super()._grab(x, y)
        return under if under is None or not self.document.timed else (*under, float(self._frame))

    def _seen(self, point: tuple[float, ...]) -> Pair | None:
        there = len(point) == 2 or abs(point[2] - self.playback.frame) <= 0.5
        return super()._seen(point) if there else None

    def _carried(self, held: Held, x: float, y: float) -> tuple[float, ...]:
        return (*super()._carried(held, x, y), held.time)[: len(held.point)]

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
        if held is None or not self._flows(held) or commanded(event) or shifted(event):
            super()._turn(event, amount)
        else:
            self._carry(held, -amount / 100)

    def _flows(self, held: Held) -> bool:
        """Return whether a held stroke can be dragged through time; others stay in their frame."""
        return self.document.timed and not (held.shapes or held.masks)

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
            "l": lambda: setattr(playback, "loop", not playback.loop),
            "j": lambda: self.go_to_key(-1),
            "k": lambda: self.go_to_key(1),
        }
        if held is not None and step is not None:
            if self._flows(held):
                self._carry(held, step)
        elif step is not None:
            playback.step(step)
        elif key.lower() not in acts:
            return super()._key(key)
        elif held is None:  # otherwise, the displayed frame is that of the held point
            acts[key.lower()]()
        return True
