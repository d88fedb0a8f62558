"""Gestures and keys for all media: strokes are drawn and edited, and the view is moved."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from supple.errors import SuppleError
from supple.space.freezing import Freeze
from supple.viewer.document.editing import Document
from supple.viewer.tools.drawing import CLICK, Drawing, Held, Pair, Place, nearest
from supple.viewer.tools.keys import BRUSHES

V = TypeVar("V")

Event = Mapping[str, Any]

KNOB = 10.0  # logical pixels: the largest distance of the pointer from a knob, of the split or the line of symmetry
_KEPT = "this frame is kept, as those at the ends are: choose another, or fewer in Export options, Keep ends"
_BENT = "the frames at the ends are bent, too, as you begin in one: Keep ends, in Export, keeps them as they are"
_STAYS = "this place is frozen, and no stroke moves it: thaw it first (V)"
_LEFT, _RIGHT = 1, 2
_MOST = 1e4  # the largest turn of the wheel at once: larger powers overflow
_REQUESTS = {"s": "save", "o": "open", "e": "export"}
COMMANDS = frozenset((*_REQUESTS, "z", "y", "h"))  # letters that do something together with Control
_BRUSHES = {key.lower(): name for name, (key, _) in BRUSHES.items()}


@dataclass(slots=True)
class Lead(Generic[V]):
    """A drag of something else than a stroke, such as the view, while the button is down."""

    follow: Callable[[Lead[V]], None]  # called after each move
    button: int
    before: V  # the view at the start of the drag
    base: V  # with the pointer at `start`
    start: Pair
    now: Pair
    travelled: bool = False

    @property
    def gone(self) -> Pair:
        """The way of the pointer from `start`."""
        return self.now[0] - self.start[0], self.now[1] - self.start[1]

    @property
    def moved(self) -> bool:
        """True if it is a drag; otherwise it is a click."""
        return self.travelled or math.dist(self.start, self.now) >= CLICK


class Tools(Drawing, Generic[V]):
    """Edits of a document and moves of the view, from events.

    Events are those of rendercanvas; those of a pen have a ``pressure``, from 0 to 1, and may have the ``peak`` of its
    drag. Events may be merged, so that their amounts count, and not their number. Errors are shown in `status`.
    ``view`` is a viewport or a camera.
    """

    def __init__(self, document: Document, view: V) -> None:
        super().__init__(document)
        self.view = view
        self.original = False  # whether to display the original, without strokes
        self.split: float | None = None
        """The split between original and result, as a fraction of the width; None without a split."""
        self.listing = False  # whether to list keys and gestures
        self.requests: list[str] = []
        """Requests to the window: ``"save"``, ``"save as"``, ``"open"``, ``"export"``."""
        self.pointer: Pair | None = None  # the pointer on the canvas
        self._gesture: Held | Lead[V] | None = None
        self._sized = 0.0, 1.0  # at the start of a drag of the brush's size: the radius, and the ring on the canvas
        self._refused: str | None = None

    @property
    def held(self) -> Held | None:
        """The stroke held by the pointer."""
        return self._gesture if isinstance(self._gesture, Held) else None

    @property
    def sizing(self) -> Pair | None:
        """Where a drag of the brush's size began."""
        lead = self._lead(self._size)
        return None if lead is None else lead.start

    def _lead(self, follow: Callable[[Lead[V]], None]) -> Lead[V] | None:
        """Return the present gesture if it is of a kind."""
        gesture = self._gesture
        return gesture if isinstance(gesture, Lead) and gesture.follow == follow else None

    @property
    def dragging(self) -> bool:
        """True if a stroke, or a corner of the keystone's frame, is being dragged."""
        return self._gesture is not None and self.document.dragging

    @property
    def mask(self) -> Freeze | None:
        """The freeze mask, as it is painted; None if nothing is frozen."""
        held = self.held
        return self.document.frozen if held is None or held.mask is None else held.mask

    @property
    def status(self) -> str | None:
        """The reason for a refused action, in a line."""
        return self.document.trouble or self._refused

    def handle(self, event: Event) -> bool:
        """Process an event; return whether it had an effect."""
        act = getattr(self, f"_on_{event.get('event_type')}", None)
        if act is None:
            return False
        try:
            return bool(act(event))
        except SuppleError as error:
            self._refused = str(error)
            return True

    def press(self, key: str, *modifiers: str) -> None:
        """Process a key."""
        self.handle({"event_type": "key_down", "key": key, "modifiers": modifiers})

    def abandon(self) -> bool:
        """Undo the current drag; return whether there was any."""
        if self.sizing is not None:
            self.radius = self._sized[0]
        gesture, self._gesture = self._gesture, None
        if isinstance(gesture, Lead):
            self.view = gesture.before
        if isinstance(gesture, Held):
            self._put_back(gesture)
        if self.document.dragging:
            self.document.abandon()
        return gesture is not None

    def knob_in(self, place: Place) -> Pair | None:
        """Return the position of the knob of the split in a view; None without a split."""
        left, top, width, height = place
        return None if self.split is None else (left + self.split * width, top + 0.5 * height)

    @property
    @abstractmethod
    def grip(self) -> Pair | None:
        """The position of the knob of the line of symmetry in the view under the pointer; None where it has none."""

    @property
    def _knobs(self) -> dict[Callable[[Lead[V]], None], Pair | None]:
        """The positions of the knobs in the view under the pointer, and what a drag of each does."""
        return {self._cut: self.knob_in(self.place), self._lay: self.grip}

    @property
    def _beside(self) -> Callable[[Lead[V]], None]:
        """The effect of a drag with the left button where there is nothing to grab."""
        return lambda lead: None

    # Each kind of media has methods of its own for these.

    @property
    @abstractmethod
    def ring(self) -> float | None:
        """The brush's radius under the pointer, in logical pixels; None where it is not seen."""

    @property
    @abstractmethod
    def place(self) -> Place:
        """The rectangle of the view under the pointer."""

    @abstractmethod
    def _level(self, place: Pair) -> float:
        """Return the coordinate, along the axis across the line of symmetry, of a position of the canvas."""

    @abstractmethod
    def _leads(self, event: Event) -> Callable[[Lead[V]], None] | None:
        """Return what a drag with a button does, if it is for something else than a stroke."""

    @abstractmethod
    def _turn(self, event: Event, amount: float) -> None:
        """Process the wheel."""

    @abstractmethod
    def _key(self, key: str) -> bool:
        """Process a key of this kind of media."""

    def _put_back(self, held: Held) -> None:
        """Undo changes of a drag outside the document."""

    def _on_pointer_down(self, event: Event) -> bool:
        x, y = self.pointer = _place(event)
        self._refused = None
        if self._gesture is not None:
            return True
        button = int(event.get("button", 0))
        follow = self._leads(event)
        if follow is None and button == _LEFT:
            near = (what for what, at in self._knobs.items() if at and math.dist(at, (x, y)) <= KNOB)
            follow = next(near, None)
        if follow is None and button == _LEFT:
            self._gesture = self._taken(x, y)
            self._press(self._gesture, event)
            if self._gesture is not None and self._gesture.new and not self._gesture.masks:
                self._refused = self._stays(self._gesture)
            if self._gesture is not None and self._gesture.clicks:
                self._gesture.shift = shifted(event)
                self._draw(self._gesture)
            follow = self._beside
        elif follow is None and button == _RIGHT and self.ring:
            follow, self._sized = self._size, (self.radius, self.ring * self.extent[0])
        if self._gesture is None and follow is not None:
            self._gesture = Lead(follow, button, self.view, self.view, (x, y), (x, y))
        return self._gesture is not None

    def _stays(self, held: Held) -> str | None:
        """Return why nothing moves at the held point, or what was done about it; None if it moves."""
        mask, document = self.mask, self.document
        if document.kind == "video" and not document.hold <= document.frame < document.shape[0] - document.hold:
            if document.strokes:
                return _KEPT
            document.set_hold(0)  # a first stroke in a kept frame is meant to bend it
            return _BENT
        return _STAYS if mask and mask.at([[p] for p in held.point[: mask.ndim]]).item() == 0 else None

    def _on_pointer_move(self, event: Event) -> bool:
        self.pointer = _place(event)
        gesture = self._gesture
        if gesture is None:
            return False
        if isinstance(gesture, Held):
            gesture.shift = shifted(event)
            self._press(gesture, event)
        if gesture.button not in event.get("buttons", (gesture.button,)):
            return self._released()  # the button was released outside of the window
        self._follow(gesture, self.pointer)
        return True

    def _on_pointer_up(self, event: Event) -> bool:
        self.pointer = _place(event)
        gesture = self._gesture
        if gesture is None or event.get("button") != gesture.button:
            return False
        if isinstance(gesture, Held):
            self._press(gesture, event)
        self._follow(gesture, self.pointer)
        return self._released()

    def _press(self, held: Held | None, event: Event) -> None:
        """Note a pen's pressure, if the event has one; a drag that began without one ignores it."""
        pressure, peak = _pressure(event.get("pressure")), _pressure(event.get("peak"))
        if pressure is None:
            return
        self.pen = True
        if held is None or not self.pressing or (held.pressure is None and event["event_type"] != "pointer_down"):
            return
        held.pressure = pressure if held.paints else max(held.pressure or 0.0, pressure, peak or 0.0)

    def _on_pointer_leave(self, event: Event) -> bool:
        self.pointer = None
        return False

    def _follow(self, gesture: Held | Lead[V], place: Pair) -> None:
        gesture.now = place
        if isinstance(gesture, Held):
            self._draw(gesture)
        else:
            gesture.follow(gesture)

    def _cut(self, lead: Lead[V]) -> None:
        left, _, width, _ = self.place
        self.split = min(max((lead.now[0] - left) / width, 0.0), 1.0)

    def _size(self, lead: Lead[V]) -> None:
        radius, ring = self._sized  # the ring follows the pointer
        self.radius = radius * max(1 + lead.gone[0] / ring, 0.0)

    def _lay(self, lead: Lead[V]) -> None:
        """Move the line of symmetry to the pointer, and into the very middle if it is near."""
        middle, (x, _), (_, y) = 0.5 * (self.document.shape[-1 - self.across] - 1), lead.now, lead.start
        found = self._level((x, y))
        near = abs(found - middle) < abs(self._level((x + CLICK, y)) - found)
        self.middle = middle if near else min(max(found, -0.5), 2 * middle + 0.5)

    def _look(self, view: V) -> None:
        """Set the view; a drag of the view continues from there."""
        self.view = view
        lead = self._gesture
        if isinstance(lead, Lead):
            lead.travelled = lead.moved
            lead.base, lead.start = view, lead.now

    def _released(self) -> bool:
        gesture, self._gesture = self._gesture, None
        if gesture is None:
            return False
        if isinstance(gesture, Held):
            if gesture.masks:
                if gesture.mask is not None:
                    self.document.set_freeze(gesture.mask)
                return True
            if (gesture.moved or gesture.grown or gesture.clicks) and self.document.dragging:
                trouble = self.document.trouble
                if not self.document.commit():
                    self._refused = trouble or self._refused
                elif gesture.paints:  # the newest of its strokes
                    self.document.select(len(self.document.strokes) - 1)
                return True
            if self.document.dragging:
                self.document.abandon()
            self._put_back(gesture)
            if gesture.tool == "pin" and gesture.item is not None and self._takes(gesture.item):
                self._unpin(gesture)
                return True
        elif gesture.button != _LEFT or self._let_go(gesture):
            return True
        found = nearest(self.handles(), gesture.start)
        self.document.select(None if found is None else found.item)
        return True

    def _let_go(self, lead: Lead[V]) -> bool:
        """End a drag of the left button; return whether it was more than a click."""
        return lead.moved or lead.follow in self._knobs

    def _on_wheel(self, event: Event) -> bool:
        amount = float(event.get("dy", 0.0))
        if shifted(event):
            amount += float(event.get("dx", 0.0))  # some systems turn the wheel sideways then
        self._turn(event, min(max(amount, -_MOST), _MOST))
        return True

    def _on_key_down(self, event: Event) -> bool:
        self._refused = None
        key = str(event.get("key", ""))
        if commanded(event):
            return self._command(key.lower(), shifted(event))
        if self._edit(key) or self._key(key):
            return True
        lacking = _BRUSHES.get(key.lower())
        if lacking is not None:
            self._refused = f"{lacking} is for pictures{' and clips' * (lacking == 'push')}"
        return lacking is not None

    def _on_key_up(self, event: Event) -> bool:
        self.original &= event.get("key") not in ("\\", "|")  # with Shift, it is another
        return False

    def _command(self, letter: str, shift: bool) -> bool:
        if letter in _REQUESTS:
            self.requests.append("save as" if letter == "s" and shift else _REQUESTS[letter])
        elif letter == "z" and not shift:
            if not self.abandon():
                self.document.undo()
        elif letter in ("z", "y"):
            self.document.redo()
        elif letter == "h":
            self.bare = not self.bare
        else:
            return False
        return True

    def _edit(self, key: str) -> bool:
        document, chosen = self.document, self.document.selected
        if key == "Escape":
            if self.listing:
                self.listing = False
            elif not self.abandon():
                document.select(None)
        elif key in ("?", "F1"):
            self.listing = not self.listing
        elif key in ("[", "]"):
            self.grow(1 if key == "]" else -1)
        elif key == "\\":
            self.original = True
        elif key.lower() in _BRUSHES and _BRUSHES[key.lower()] not in self.lacks:
            self.brush = _BRUSHES[key.lower()]
        elif key in ("b", "B"):
            self.split = 0.5 if self.split is None else None
        elif key in ("m", "M"):
            self.symmetric = not self.symmetric
        elif key in ("Delete", "Backspace", "h", "H"):
            if chosen is not None and self._gesture is None:
                if key.lower() == "h":
                    document.hide(chosen, not document.strokes[chosen].hidden)
                else:
                    document.remove(chosen)
        else:
            return False
        return True


def commanded(event: Event) -> bool:
    """Return whether Control, or its equivalent, is held."""
    return any(key in event.get("modifiers", ()) for key in ("Control", "Meta"))


def shifted(event: Event) -> bool:
    """Return whether Shift is held."""
    return "Shift" in event.get("modifiers", ())


def _pressure(value: object) -> float | None:
    """Return a pressure clamped to 0 to 1; None unless it is a finite number, as a page may send anything."""
    if not isinstance(value, int | float) or not -math.inf < value < math.inf:
        return None
    return float(min(max(value, 0.0), 1.0))


def _place(event: Event) -> Pair:
    return float(event["x"]), float(event["y"])
