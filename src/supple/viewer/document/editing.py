"""The document: a list of strokes on a medium, its states, and undo steps."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Literal, Self

import numpy as np

from supple.deformation import Arrival, Deformation, after, last_outside, part_of, reduced
from supple.errors import SuppleError
from supple.files.clips import parts_of, with_ends
from supple.files.volumes import indexed, placed
from supple.folding.limits import NEAR
from supple.space.checks import integer
from supple.space.domain import Domain
from supple.space.freezing import Freeze
from supple.space.geometry import Geometry
from supple.space.straighten import Straighten
from supple.strokes import CoordinateSpace, Recipe, Stroke, last_freeze, spoken
from supple.viewer.document import words
from supple.viewer.document.keyframes import animated, edited
from supple.viewer.document.landmarks import Landmarks

Kind = Literal["image", "video", "volume"]
Point = tuple[float, ...]
Handle = tuple[Point, Point]
"""A point of a stroke, and its position after the stroke."""
_EMPTY = Recipe()


@dataclass(frozen=True, slots=True)
class State:
    """A state of the document, for undo and redo.

    Points are in samples here; if those of the recipe's file are in millimetres, ``rest`` has their space.
    """

    strokes: tuple[Stroke, ...] = ()  # in the order of application, with the hidden ones
    rest: Recipe = _EMPTY  # the recipe's other options
    selected: int | None = None
    made_by: str = field(default="", compare=False)  # the step that led here, in words
    marks: Landmarks | None = None  # the landmarks of a volume, perhaps none yet; None if there cannot be any

    @property
    def recipe(self) -> Recipe:
        """The recipe of this state, without its space: points are samples."""
        return replace(self.rest, space=None, strokes=self.strokes)

    @property
    def mask(self) -> Freeze | None:
        """The freeze mask that the next stroke is subject to."""
        return last_freeze(self.strokes) or self.rest.freeze

    def with_stroke(self, i: int, stroke: Stroke) -> Self:
        """Return a state with a stroke replaced."""
        done = words.edit(i, self.strokes[i], stroke)
        return replace(self, strokes=(*self.strokes[:i], stroke, *self.strokes[i + 1 :]), made_by=done)

    @property
    def content(self) -> tuple[object, object]:
        """The state without the selection."""
        return self.strokes, self.rest


@dataclass(frozen=True, slots=True)
class Track:
    """A visible stroke on screen: shown at its full drag, even if the recipe applies a fraction of it."""

    stroke: Stroke
    handles: tuple[Handle, ...]  # its points, and the first one's position after it; targets for others
    wanted: Point | None  # the target of its first point, if it misses that

    @classmethod
    def of(cls, stroke: Stroke, made: Deformation) -> Self:
        """Return the last stroke of a deformation, which applies a stroke of the recipe."""
        applied, arrival = made.strokes[-1], made.arrival(len(made.strokes) - 1)
        seen = stroke if applied is stroke else replace(applied, strength=stroke.strength)
        others = ((at, tuple(a + b for a, b in zip(at, by, strict=True))) for at, by in seen.handles[1:])
        return cls(seen, ((seen.at, arrival.arrived), *others), arrival.target if arrival.miss > NEAR else None)


@dataclass(frozen=True, slots=True)
class Solved:
    """A state, and ``chain``, the deformations after none, one, two, … of its visible strokes.

    ``visible`` has these strokes, as they are in the frame shown, with their indices; ``wholes`` the deformations
    before each of them at full strength, which are those of the chain itself where they are equal.
    """

    state: State
    amount: float  # of the recipe, in the frame shown
    visible: tuple[tuple[int, Stroke], ...]
    chain: tuple[Deformation, ...]
    wholes: tuple[Deformation, ...] = ()
    tracks: tuple[Track, ...] = ()

    def before(self, k: int) -> tuple[Deformation, Deformation]:
        """Return the deformation before visible stroke ``k`` or the next one: at full strength, and as applied."""
        if k < len(self.wholes):
            return self.wholes[k], self.chain[k]
        if k == 0:
            return self.chain[0], self.chain[0]
        stroke = self.visible[k - 1][1]
        whole = after(stroke, self.amount, self.wholes[k - 1], self.chain[k - 1], self.chain[k])
        return whole, self.chain[k]

    def kept(self, stroke: Stroke, k: int) -> Stroke:
        """Return a stroke drawn on screen before visible stroke number ``k``, in coordinates of the recipe."""
        whole, now = self.before(k)
        part = part_of(stroke, self.amount)
        if whole is not now:
            stroke = replace(stroke, at=tuple(whole.forward(now.inverse(stroke.at).points).tolist()))
        return replace(stroke.weakened(1 / part), strength=stroke.strength) if part not in (0, 1) else stroke


_HIDDEN = attrgetter("hidden")
_DRAWN = ("at", "by", "angle", "factor", "also", "path")


class Document:
    """The strokes on a medium, and their editing.

    An edit is applied as a whole, as one step; or refused with a `SuppleError`, without any change. A drag is one step
    of any duration.

    The shape and the spacing of the medium are those of `Deformation`; recipes in millimetres need the geometry of a
    volume. Strokes that `supple.warp_file` would refuse, since they start before or after a video or a volume, are
    refused here too.
    """

    def __init__(
        self,
        shape: Sequence[int],
        spacing: float | Sequence[float] = 1.0,
        recipe: Recipe | None = None,
        *,
        kind: Kind | None = None,
        geometry: Geometry | None = None,
        hold: int = 0,
        marks: Landmarks | None = None,
    ) -> None:
        self.shape = tuple(shape)
        self.spacing = spacing
        self.kind = kind
        self.geometry = geometry
        self.revision = 0  # the number of changes of any kind
        self.on_change: list[Callable[[], None]] = []  # called after each change
        self.trouble: str | None = None  # the reason why the current drag is refused, for the status line
        self._drag: tuple[Solved, int | None] | None = None
        self.frame, self.hold = 0, hold  # of a clip: the frame shown, and how many frames at each end stay unchanged
        self._timed = True  # of a clip without strokes: whether the next one is in time
        self._now = self._solved(replace(self._state(recipe or Recipe()), marks=marks), None)
        self.steps: tuple[State, ...] = (self._now.state,)
        """The states that undo and redo go through, from the first to the last; their number is unlimited."""
        self.step = 0  # the index of the present one
        self._saved = self._now.state.content
        self._plain = self.deformation.without_strokes()
        self._base: tuple[State, Deformation] | None = None

    @property
    def state(self) -> State:
        """The visible state, including the current drag."""
        return self._now.state

    @property
    def size(self) -> tuple[int, ...]:
        """The number of samples along each axis of strokes' points, x first."""
        return self.deformation.shape[::-1]

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        """The strokes, with the hidden ones."""
        return self._now.state.strokes

    @property
    def selected(self) -> int | None:
        """The index of the selected stroke."""
        return self._now.state.selected

    @property
    def deformation(self) -> Deformation:
        """The deformation of the visible strokes, in the frame shown; the same object until they change."""
        return self._now.chain[-1]

    @property
    def timed(self) -> bool:
        """True if strokes are in time, with points (x, y, t); otherwise, strokes of a clip apply to every frame."""
        return self._is_timed(self.state)

    @timed.setter
    def timed(self, timed: bool) -> None:
        self._rest()
        if self.strokes:
            raise SuppleError("the strokes of a recipe are all in time, or all in every frame: remove them first")
        self._timed = timed
        self._show(self._solved(self.state, None))

    def _is_timed(self, given: State | Recipe) -> bool:
        return self.kind == "video" and (len(given.strokes[0].at) == 3 if given.strokes else self._timed)

    def _shape(self, timed: bool) -> tuple[int, ...]:
        return self.shape[-2:] if self.kind == "video" and not timed else self.shape

    def seek(self, frame: int) -> None:
        """Show the strokes as they are in another frame of a clip."""
        if frame == self.frame:
            return
        self.frame, faded = frame, self.hold > 0 and not self.timed
        if faded or self.state.recipe.moves:
            self.trouble = None
            try:
                self._now = self._solved(self.state, self._now)
            except SuppleError as error:  # an export would fail in this frame, too
                self.trouble = f"frame {frame}: {error}"
        if self._base is not None and (faded or self._base[0].recipe.moves):
            with contextlib.suppress(SuppleError):
                self._base = self._base[0], self._solved(self._base[0], self._now).chain[-1]

    def set_hold(self, hold: int) -> None:
        """Keep some frames at each end of a clip, as `ClipOptions` has it; SuppleError if no others are left."""
        self._rest()
        most = (self.shape[0] - 1) // 2
        before, self.hold = self.hold, integer("hold", hold, f"a number of frames from 0 to {most}", 0, most)
        try:
            self._show(self._solved(self.state, None))
        except SuppleError:
            self.hold = before
            raise
        if self._base is not None:
            self._base = self._base[0], self._solved(self._base[0], None).chain[-1]

    @property
    def recipe(self) -> Recipe:
        """The recipe for `supple.warp_file` and for saving, with the hidden strokes."""
        scale = self.deformation.domain.spacing[2] if self.timed else None
        made = replace(self.state.recipe, size=self.size, space="pixels", time_scale=scale)
        space = self.state.rest.space
        return made if space is None or self.geometry is None else placed(made, self.geometry, space)

    @property
    def space(self) -> CoordinateSpace | None:
        """The coordinates of the points of the recipe, if these are millimetres of a volume."""
        return self.state.rest.space if self.geometry is not None else None

    def as_saved(self, stroke: Stroke) -> Stroke:
        """Return a stroke with its points in the coordinates of the recipe."""
        if self.space is None or self.geometry is None:
            return stroke
        return placed(Recipe(strokes=(stroke,)), self.geometry, self.space).strokes[0]

    def as_edited(self, stroke: Stroke) -> Stroke:
        """Return a stroke of the recipe with its points in samples: the inverse of `as_saved`."""
        if self.space is None or self.geometry is None:
            return stroke
        return indexed(Recipe(strokes=(stroke,), space=self.space), self.geometry, "the volume").strokes[0]

    def place(self, point: Point) -> Point:
        """Return a point in the coordinates of the recipe."""
        if self.space is None or self.geometry is None:
            return point
        return tuple(self.geometry.to_world(point, self.space).tolist())

    def arrival(self, i: int) -> Arrival | None:
        """Return the target of a stroke's point, and its position; None if the stroke is hidden."""
        known = self._nth(i)
        return None if known is None else self.deformation.arrival(known)

    def warning(self, i: int) -> str | None:
        """Return the warning of a stroke that is not applied as a whole; None without one."""
        known = self._nth(i)
        return None if known is None else self.deformation.warnings[known]

    def misses(self, i: int) -> bool:
        """Return whether a stroke's point ends elsewhere than at its target; False if the stroke is hidden."""
        known = self._nth(i)
        return known is not None and (self._now.tracks[known].wanted is not None or self.carrier(i) is not None)

    def carrier(self, i: int) -> int | None:
        """Return the index of the later stroke that carries the point of a stroke away; None if none does."""
        arrival = self.arrival(i)
        found = [] if arrival is None else [each.carried_by for each in (arrival, *arrival.also)]
        return next((self._now.visible[k][0] for k in found if k is not None), None)

    def tracks(self) -> list[tuple[int, Track]]:
        """Return the strokes that have handles on screen, and their indices; hidden strokes have none.

        Strokes of a painting have none, as they have many points; during a drag, only the dragged stroke has handles.
        """
        visible = (i for i, stroke in enumerate(self.strokes) if not stroke.hidden)
        pairs, chosen, lone = zip(visible, self._now.tracks, strict=True), self.selected, self.dragging
        return [
            (i, track)
            for i, track in pairs
            if track.stroke.brush != "freeze" and not track.stroke.is_whole and (i == chosen or not lone)
        ]

    def below(self, i: int) -> Deformation:
        """Return the deformation before a stroke, which is not hidden."""
        return self._now.chain[self._nth(i) or 0]

    def beneath(self, i: int, point: tuple[float, ...]) -> tuple[float, ...]:
        """Return the position, before a stroke that is not hidden, of the material that is now at a point."""
        before = self.below(i)
        return tuple(before.forward(self.deformation.inverse(point).points).tolist())

    def seen(self, i: int) -> Stroke:
        """Return a stroke as on screen: at its full drag, even if the recipe applies a fraction of it."""
        known = self._nth(i)
        return self.strokes[i] if known is None else self._now.tracks[known].stroke

    def add(self, stroke: Stroke) -> int:
        """Append a stroke, and select it; return its index."""
        count = len(self.strokes)
        strokes = (*self.strokes, stroke)
        self._edit(replace(self.state, strokes=strokes, selected=count, made_by=words.drawn((stroke,))))
        return count

    def replace(self, i: int, stroke: Stroke) -> None:
        """Replace a stroke; its hidden state is kept."""
        self._edit(self._replaced(self.state, i, stroke))

    def change(self, i: int, then: Stroke) -> None:
        """Edit a stroke, which becomes ``then`` in the frame shown; see `edited`."""
        stroke = self.strokes[i]
        self.replace(i, edited(stroke, stroke.at_frame(self.frame), then, self.frame))

    def remove(self, i: int) -> None:
        """Remove a stroke."""
        selected = self.selected
        if selected is not None and selected >= i:
            selected = None if selected == i else selected - 1
        strokes, done = (*self.strokes[:i], *self.strokes[i + 1 :]), f"Remove stroke {i + 1}"
        self._edit(replace(self.state, strokes=strokes, selected=selected, made_by=done))

    def move(self, i: int, to: int) -> None:
        """Move a stroke to another index, so that it is applied earlier or later."""
        order = list(range(len(self.strokes)))
        order.insert(to, order.pop(i))
        selected = None if self.selected is None else order.index(self.selected)
        done = f"Move stroke {i + 1} {'later' if to > i else 'earlier'}"
        self._edit(replace(self.state, strokes=tuple(self.strokes[k] for k in order), selected=selected, made_by=done))

    def hide(self, i: int, hidden: bool = True) -> None:
        """Hide a stroke, or show it."""
        self._edit(self.state.with_stroke(i, replace(self.strokes[i], hidden=bool(hidden))))

    def set_rest(self, **options: Any) -> None:
        """Set options of the recipe: ``border``, ``on_fold``, ``straighten``, as None if it has no effect."""
        if options.get("straighten") == Straighten():
            options["straighten"] = None
        self._edit(self._with_rest(self.state, options))

    @property
    def frozen(self) -> Freeze | None:
        """The freeze mask that the next stroke is subject to; None if nothing is frozen."""
        known = self.state.mask
        return None if known is None or known.is_free else known

    @property
    def freeze(self) -> Freeze:
        """The freeze mask of the state; if there is none, one that freezes nothing: in a clip, for all frames."""
        known = self.state.mask
        if known is not None:
            return known
        domain = self.deformation.domain
        n = 2 if self.kind == "video" else len(self.shape)
        return Freeze.free(self.shape[-n:], domain.spacing[:n])

    def set_freeze(self, freeze: Freeze | None) -> None:
        """Set the freeze mask of later strokes, by an item of the list, which the next call before a stroke replaces.

        Before the first stroke, it is the freeze mask of the recipe. A mask that freezes nothing counts as None.
        """
        state = replace(self.state, made_by=words.freezing(self.state.mask, freeze))
        if state.strokes and state.strokes[-1].brush == "freeze" and not state.strokes[-1].hidden:
            selected = None if state.selected == len(state.strokes) - 1 else state.selected
            state = replace(state, strokes=state.strokes[:-1], selected=selected)
        mask = None if freeze is None or freeze.is_free else freeze
        if not state.strokes:
            self._edit(replace(state, rest=replace(state.rest, freeze=mask)))
            return
        if mask is None and state.mask is not None and not state.mask.is_free:
            mask = state.mask.freed
        if mask is not None:
            item = Stroke.freeze(mask, ndim=state.strokes[0].ndim)
            state = replace(state, strokes=(*state.strokes, item))
        self._edit(state)

    def preview_rest(self, **options: Any) -> bool:
        """Show other options of the recipe, such as the amount, as the current drag; return as `preview` does."""
        before, _ = self._dragged()
        return self._tried(self._with_rest(before.state, options))

    @staticmethod
    def _with_rest(state: State, options: dict[str, Any]) -> State:
        return replace(state, rest=replace(state.rest, **options), made_by=words.chosen(*next(iter(options.items()))))

    def restore(self) -> None:
        """Remove all strokes, as one step."""
        self._edit(replace(self.state, strokes=(), selected=None, made_by="Restore all"))

    def load(self, recipe: Recipe) -> None:
        """Replace the document by a recipe, as one step."""
        self._edit(replace(self._state(recipe), marks=self.state.marks))

    def mark(self, marks: Landmarks, made_by: str) -> None:
        """Set the landmarks, as one step, which does not change the deformation."""
        self._rest()
        self._push(replace(self.state, marks=marks, made_by=made_by))
        self._show(replace(self._now, state=self.steps[self.step]))

    def _state(self, recipe: Recipe) -> State:
        fitted, space = self.fitted(recipe), recipe.space if recipe.is_world else None
        rest = replace(fitted, strokes=(), size=None, space=space, time_scale=None)
        return State(fitted.strokes, rest, made_by="Open a recipe")

    def fitted(self, recipe: Recipe) -> Recipe:
        """Return a recipe in samples of this medium, scaled if its size differs; SuppleError if it does not fit."""
        timed = self._is_timed(recipe)
        shape = self._shape(timed)
        count = len(shape)
        for k, stroke in enumerate(recipe.strokes, 1):
            if stroke.keys and self.kind != "video":
                raise SuppleError(f"stroke {k} of the recipe moves from frame to frame, and this is no clip: open one")
            if len(stroke.at) != count:
                what = {"image": "a picture, with points x, y", "video": "a clip, with points x, y, t"}.get(
                    self.kind or ("image" if count == 2 else ""), "a volume, with points x, y, z"
                )
                raise SuppleError(
                    f"stroke {k} has points of {len(stroke.at)} numbers, and this is {what}: "
                    "give as many, or open a file of that kind"
                )
        size = shape[::-1]
        if recipe.straighten is not None and (self.kind == "video" or count == 3):
            raise SuppleError("the recipe straightens a picture, and this is none: open one")
        fitted = recipe.fitted(size, time=timed)
        if timed and fitted.strokes != recipe.strokes:
            raise SuppleError(
                f"the recipe was made for {spoken(recipe.size or size)}, and this clip is {spoken(size)}: "
                "supple warp scales it, and the window does not"
            )
        worth = Domain(self.shape, self.spacing).spacing[-1]
        if timed and recipe.time_scale not in (None, worth):
            raise SuppleError(
                f"in the recipe, a frame is worth {recipe.time_scale:g} pixels, and here {worth:g}: open the clip with "
                f"--time-scale {recipe.time_scale:g}"
            )
        if recipe.is_world and self.geometry is None:
            raise SuppleError(f"the recipe is in {recipe.space} millimetres, and this is no volume: open one in pixels")
        return fitted if self.geometry is None else indexed(fitted, self.geometry, "the volume")

    def select(self, i: int | None) -> None:
        """Select a stroke, or none, without an undo step."""
        self._rest()
        state = replace(self.state, selected=i)
        if state != self.state:
            self.steps = (*self.steps[: self.step], state, *self.steps[self.step + 1 :])
            self._show(replace(self._now, state=state))

    @property
    def can_undo(self) -> bool:
        """Return whether there is a step to undo."""
        return self.dragging or self.step > 0

    @property
    def can_redo(self) -> bool:
        """Return whether there is a step to redo."""
        return not self.dragging and self.step < len(self.steps) - 1

    def go(self, step: int) -> None:
        """Undo or redo as many steps as lead to one of `steps`."""
        self._rest()
        if step != self.step:
            made, self.step = self._solved(self.steps[step], self._now), step
            self._show(made)

    @property
    def compared(self) -> State | None:
        """The state that the present one is compared with; None if that is the original."""
        return None if self._base is None else self._base[0]

    @property
    def compared_step(self) -> int | None:
        """The index of `compared` among `steps`; None for the original, and for a step that has left the history."""
        known = self.compared
        if known is None:
            return None
        # Two steps may be equal, and a selection makes another state of the same step.
        same = (k for k, state in enumerate(self.steps) if state.strokes is known.strokes and state.rest is known.rest)
        return next(same, None)

    @property
    def base(self) -> Deformation:
        """The deformation of the state that the present one is compared with; the identity for the original."""
        return self._plain if self._base is None else self._base[1]

    def compare(self, step: int | None) -> None:
        """Compare with one of `steps`, which later undo and redo do not change; None for the original again."""
        if step is None:
            self._base = None
        else:
            state = self.steps[step]
            self._base = state, self._solved(state, self._now).chain[-1]
        self._tell()

    def undo(self) -> None:
        """Undo the last step, or the current drag."""
        if self.dragging:
            self.abandon()
        elif self.can_undo:
            self.go(self.step - 1)

    def redo(self) -> None:
        """Redo the last undone step."""
        if self.can_redo:
            self.go(self.step + 1)

    @property
    def dragging(self) -> bool:
        """True if a drag is active."""
        return self._drag is not None

    def begin_drag(self, i: int | None = None) -> None:
        """Begin a drag, of a new stroke or of one of the list. Until it ends, other edits are refused."""
        self._rest()
        self._drag = self._now, i
        self.trouble = None

    def preview(self, *strokes: Stroke, select: bool = True, whole: bool = False) -> bool:
        """Show the current drag of one or several strokes, in coordinates of the screen; return whether it is valid.

        With ``select``, the first is selected. If the drag is not valid, the last preview stays, and `trouble` has the
        reason. An animated stroke gets a key in the frame shown; with ``whole``, the positions of all its keys move.
        """
        before, i = self._dragged()
        state = before.state
        k = sum(not each.hidden for each in state.strokes[:i])
        kept = [before.kept(stroke, k) for stroke in strokes]
        if i is None:
            chosen = len(state.strokes) if select else state.selected
            drawn = replace(state, strokes=(*state.strokes, *kept), selected=chosen, made_by=words.drawn(kept))
            return self._tried(drawn)
        stroke = state.strokes[i]
        now = stroke.at_frame(self.frame)
        seen = now if stroke.hidden else before.tracks[k].stroke
        alike = {name: getattr(now, name) for name in _DRAWN if getattr(strokes[0], name) == getattr(seen, name)}
        then = replace(kept[0], **alike)  # what was not dragged keeps every bit
        return self.preview_as(edited(stroke, now, then, self.frame, whole=whole))

    def preview_as(self, stroke: Stroke) -> bool:
        """Show the stroke of the current drag as another one, in coordinates of the recipe, as `preview` does."""
        before, i = self._dragged()
        assert i is not None
        return self._tried(replace(self._replaced(before.state, i, stroke), selected=i))

    def _tried(self, state: State) -> bool:
        had, self.trouble = self.trouble, None
        try:
            made = self._solved(state, self._now)
        except SuppleError as error:
            self.trouble = str(error)
        if self.trouble is None and made.state != self.state:
            self._show(made)
        elif self.trouble != had:
            self._tell()
        return self.trouble is None

    def commit(self) -> bool:
        """End the drag, and keep its preview, as one step; return whether anything has changed."""
        before, _ = self._dragged()
        self._drag = self.trouble = None
        if self.state.content == before.state.content:
            self._now = before
        else:
            self._push(self.state)
        self._tell()
        return self._now is not before

    def abandon(self) -> None:
        """End the drag, and restore the state before it."""
        before, _ = self._dragged()
        self._drag = self.trouble = None
        self._show(before)

    @property
    def dirty(self) -> bool:
        """True if there are unsaved changes."""
        return self.state.content != self._saved

    def mark_saved(self) -> None:
        """Mark the current recipe as saved."""
        self._saved = self.state.content
        self._tell()

    def _edit(self, state: State) -> None:
        self._rest()
        if state.content == self.state.content:
            return
        made = self._solved(state, self._now)
        self._push(state)
        self._show(made)

    def _push(self, state: State) -> None:
        self.steps, self.step = (*self.steps[: self.step + 1], state), self.step + 1

    def _solved(self, state: State, known: Solved | None) -> Solved:
        """Return the deformation of a state; strokes shared with a known state are not resolved again."""
        rest, timed = state.rest, self._is_timed(state)
        shape, amount = self._shape(timed), rest.amount
        if self.hold and not timed:
            amount *= parts_of(self.shape[0], self.hold)[self.frame]
        if known is not None and known.state.rest == rest and known.chain[0].ndim == len(shape):
            empty = known.chain[0]
        else:
            spacing = self.spacing if shape == self.shape else np.broadcast_to(self.spacing, 3)[:2].tolist()
            plain = replace(rest, space=None, straighten=None)  # the viewport straightens a picture
            if self.hold and timed:
                plain = with_ends(plain, self.hold, self.shape, Domain(shape, spacing, rest.border).spacing[2])
            empty = Deformation.from_recipe(plain, shape, spacing=spacing, time=timed)
        seen = ((i, stroke.at_frame(self.frame)) for i, stroke in enumerate(state.strokes) if not stroke.hidden)
        made = Solved(state, amount, tuple(seen), (empty,))
        visible, same = made.visible, 0
        if known is not None and known.chain[0] == empty and known.amount == amount:
            for (_, stroke), (_, before) in zip(visible, known.visible, strict=False):
                if stroke is not before and stroke != before:
                    break
                same += 1
            made = Solved(state, amount, visible, known.chain[: same + 1], known.wholes[:same], known.tracks[:same])
        for k, (i, stroke) in enumerate(visible[same:], same):
            try:
                whole, now = made.before(k)
                applied = now.add(reduced(stroke, amount, whole, now), warn=False)
                if not animated(state.strokes[i], "place"):  # animated ones may leave the picture
                    last_outside(applied)
                tracks = (*made.tracks, Track.of(stroke, applied))
                made = Solved(state, amount, visible, (*made.chain, applied), (*made.wholes, whole), tracks)
            except SuppleError as error:
                many = len(state.strokes) > 1
                raise type(error)(f"stroke {i + 1}: {error}" if many else str(error)) from None
        return made

    def _show(self, made: Solved) -> None:
        self._now, self._timed = made, self._is_timed(made.state)
        self._tell()

    def _tell(self) -> None:
        self.revision += 1
        for call in tuple(self.on_change):
            call()

    def _rest(self) -> None:
        if self.dragging:
            raise SuppleError("a drag is under way: end it first")

    def _dragged(self) -> tuple[Solved, int | None]:
        if self._drag is None:
            raise SuppleError("no drag is under way: begin one first")
        return self._drag

    def _nth(self, i: int) -> int | None:
        """Return the index of an item among the visible strokes."""
        return None if self.strokes[i].hidden else i - sum(map(_HIDDEN, self.strokes[:i]))

    @staticmethod
    def _replaced(state: State, i: int, stroke: Stroke) -> State:
        return state.with_stroke(i, replace(stroke, hidden=state.strokes[i].hidden))
