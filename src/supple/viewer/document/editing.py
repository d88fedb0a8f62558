"""The document: a list of strokes on a medium, each edit a step that can be undone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from supple.deformation import Arrival, Deformation, last_outside, reduced
from supple.domain import Border, Domain, integer, refuse
from supple.errors import SuppleError
from supple.files.volumes import indexed, placed
from supple.geometry import Geometry
from supple.strokes import FoldPolicy, Recipe, Stroke, spoken
from supple.viewer.document.state import History, Item, Kind, Solved, State


class Document:
    """Strokes on a medium, as they are edited.

    An edit is done as a whole, and is a step; or it is refused with a `SuppleError`, and nothing has changed. A drag
    is one step, however long it takes.

    The shape of the medium and its spacing are those that `Deformation` takes; recipes in millimetres need the geometry
    of a volume. Of videos and volumes, strokes that `supple.warp_file` would refuse, since they start before or after
    it, are refused here too.
    """

    def __init__(
        self,
        shape: Sequence[int],
        spacing: float | Sequence[float] = 1.0,
        recipe: Recipe | None = None,
        *,
        kind: Kind | None = None,
        geometry: Geometry | None = None,
    ) -> None:
        self.shape = tuple(shape)
        self.spacing = spacing
        self.kind = kind
        self.geometry = geometry
        self.revision = 0  # how many changes there were, of any kind
        self.on_change: list[Callable[[], None]] = []  # functions that are called after each change
        self.trouble: str | None = None  # why the drag that is under way does not go on: for the status line
        self._drag: tuple[Solved, int | None] | None = None
        self._timed = kind == "video" and len(self.shape) == 3
        self._now = self._solved(self._state(recipe or Recipe()), None)
        self._history = History(self._now.state)
        self._saved = self._now.state.content
        self._arrivals: tuple[Solved | None, tuple[Arrival | None, ...]] = (None, ())

    @property
    def state(self) -> State:
        """All there is, as it is seen: during a drag, with what it does so far."""
        return self._now.state

    @property
    def items(self) -> tuple[Item, ...]:
        """The strokes."""
        return self._now.state.items

    @property
    def selected(self) -> int | None:
        """Which of the strokes is selected."""
        return self._now.state.selected

    @property
    def deformation(self) -> Deformation:
        """The deformation of the visible strokes. As long as they are the same, it is the same object."""
        return self._now.chain[-1]

    @property
    def recipe(self) -> Recipe:
        """The recipe that `supple.warp_file` takes and that is saved, with the hidden strokes."""
        scale = self.deformation.domain.spacing[2] if self._timed else None
        made = replace(self.state.recipe, size=self.shape[::-1], space="pixels", time_scale=scale)
        space = self.state.rest.space
        return made if space is None or self.geometry is None else placed(made, self.geometry, space)

    @property
    def arrivals(self) -> tuple[Arrival | None, ...]:
        """Where each stroke's point was to go, and where it is; None for hidden ones."""
        if self._arrivals[0] is not self._now:
            known = iter(self.deformation.arrivals)
            self._arrivals = self._now, tuple(None if item.hidden else next(known) for item in self.items)
        return self._arrivals[1]

    def arrival(self, i: int) -> Arrival | None:
        """Where a stroke's point was to go, and where it is; None if the stroke is hidden."""
        return self.arrivals[self._checked(i)]

    def warning(self, i: int) -> str | None:
        """Return a sentence on a stroke that misses its target."""
        known = self._nth(i)
        return None if known is None else self.deformation.warnings[known]

    def handles(self, i: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Where a stroke takes hold, and where its point arrives; of a hidden one, where it was to go."""
        found, stroke = self.arrival(i), self.seen(i)
        return stroke.at, found.arrived if found else tuple(a + b for a, b in zip(stroke.at, stroke.by, strict=True))

    def seen(self, i: int) -> Stroke:
        """A stroke as it is applied on what is seen, where its recipe has it at a part of its drag."""
        known, stroke = self._nth(i), self.items[i].stroke
        if known is None:
            return stroke
        applied = self.deformation.strokes[known]
        return replace(stroke, at=applied.at, by=applied.by)

    def add(self, stroke: Stroke) -> int:
        """Apply one more stroke on what is seen, and select it; return its number."""
        count = len(self.items)
        self._edit(replace(self.state, items=(*self.items, Item.of(stroke)), selected=count))
        return count

    def replace(self, i: int, stroke: Stroke) -> None:
        """Put another stroke in the place of one; it is as hidden as that one was."""
        self._edit(self._replaced(self.state, self._checked(i), stroke))

    def remove(self, i: int) -> None:
        """Take a stroke out of the list."""
        i, selected = self._checked(i), self.selected
        if selected is not None and selected >= i:
            selected = None if selected == i else selected - 1
        self._edit(replace(self.state, items=(*self.items[:i], *self.items[i + 1 :]), selected=selected))

    def move(self, i: int, to: int) -> None:
        """Put a stroke at another place in the list, so that it is applied earlier or later."""
        order = list(range(len(self.items)))
        order.insert(self._checked(to), order.pop(self._checked(i)))
        selected = None if self.selected is None else order.index(self.selected)
        self._edit(replace(self.state, items=tuple(self.items[k] for k in order), selected=selected))

    def hide(self, i: int, hidden: bool = True) -> None:
        """Put a stroke aside, or apply it again."""
        i = self._checked(i)
        item = replace(self.items[i], hidden=bool(hidden))
        self._edit(self.state.with_item(i, item))

    def set_border(self, border: Border) -> None:
        """Give the fixed border another width, as `Domain` takes it."""
        self._edit(replace(self.state, rest=replace(self.state.rest, border=border)))

    def set_on_fold(self, on_fold: FoldPolicy) -> None:
        """Choose what is done with strokes that would fold the picture."""
        self._edit(replace(self.state, rest=replace(self.state.rest, on_fold=on_fold)))

    def load(self, recipe: Recipe) -> None:
        """Put a recipe in the place of all there is, as one step."""
        self._edit(self._state(recipe))

    def _state(self, recipe: Recipe) -> State:
        """A recipe as it is edited here."""
        return State.of(self.fitted(recipe), recipe.space if recipe.is_world else None)

    def fitted(self, recipe: Recipe) -> Recipe:
        """A recipe in samples of this medium, if its strokes are of one like it; it is scaled if its size differs.

        Raises
        ------
        SuppleError
            If it does not fit.
        """
        if not isinstance(recipe, Recipe):
            refuse("a recipe", "a Recipe, as Recipe.from_json reads one", recipe)
        count = len(self.shape)
        for k, stroke in enumerate(recipe.strokes, 1):
            if len(stroke.at) != count:
                what = {"image": "a picture, with points x, y", "video": "a clip, with points x, y, t"}.get(
                    self.kind or ("image" if count == 2 else ""), "a volume, with points x, y, z"
                )
                raise SuppleError(
                    f"stroke {k} of the recipe has points of {len(stroke.at)} numbers, and this is {what}: "
                    "open one of its kind"
                )
        size = self.shape[::-1]
        fitted = recipe.fitted(size, time=self.kind == "video")
        if self._timed and fitted.strokes != recipe.strokes:
            raise SuppleError(
                f"the recipe was made for {spoken(recipe.size or size)}, and this clip is {spoken(size)}: "
                "supple warp scales it, and the window does not"
            )
        worth = Domain(self.shape, self.spacing).spacing[-1]
        if self._timed and recipe.time_scale not in (None, worth):
            raise SuppleError(
                f"in the recipe, a frame is worth {recipe.time_scale:g} pixels, and here {worth:g}: open the clip with "
                f"--time-scale {recipe.time_scale:g}"
            )
        if recipe.is_world and self.geometry is None:
            raise SuppleError(f"the recipe is in {recipe.space} millimetres, and this is no volume: open one in pixels")
        return fitted if self.geometry is None else indexed(fitted, self.geometry, "the volume")

    def select(self, i: int | None) -> None:
        """Select a stroke, or none; this is no step."""
        self._rest()
        state = replace(self.state, selected=None if i is None else self._checked(i))
        if state != self.state:
            self._history.amend(state)
            self._show(replace(self._now, state=state))

    @property
    def can_undo(self) -> bool:
        """Return whether there is anything to undo."""
        return self.dragging or self._history.can_undo

    @property
    def can_redo(self) -> bool:
        """Return whether there is anything to redo."""
        return not self.dragging and self._history.can_redo

    def undo(self) -> None:
        """Take the last step back; or the drag that is under way."""
        if self.dragging:
            self.abandon()
        elif self._history.can_undo:
            self._show(self._solved(self._history.undo(), self._now))

    def redo(self) -> None:
        """Do once more what was undone last."""
        if self.can_redo:
            self._show(self._solved(self._history.redo(), self._now))

    @property
    def dragging(self) -> bool:
        """Return whether a drag is under way."""
        return self._drag is not None

    def begin_drag(self, i: int | None = None) -> None:
        """Begin a drag, of a new stroke or of one of the list. Until it ends, other edits are refused."""
        self._rest()
        self._drag = (self._now, None if i is None else self._checked(i))
        self.trouble = None

    def preview(self, stroke: Stroke) -> bool:
        """Show what the drag does so far; the stroke is as it is seen.

        Returns
        -------
        bool
            Whether it can be done. If it can't, what was shown last stays, and `trouble` tells why.
        """
        before, i = self._dragged()
        state, had, self.trouble = before.state, self.trouble, None
        stroke = before.kept(stroke, sum(not item.hidden for item in state.items[:i]))
        if i is None:
            state = replace(state, items=(*state.items, Item.of(stroke)), selected=len(state.items))
        else:
            state = replace(self._replaced(state, i, stroke), selected=i)
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
        """End the drag, and keep what is shown, as one step; return whether anything has changed."""
        before, _ = self._dragged()
        self._drag = self.trouble = None
        if self.state.content == before.state.content:
            self._now = before
        else:
            self._history.push(self.state)
        self._tell()
        return self._now is not before

    def abandon(self) -> None:
        """End the drag, and put all back as it was."""
        before, _ = self._dragged()
        self._drag = self.trouble = None
        self._show(before)

    @property
    def dirty(self) -> bool:
        """Return whether there is something that was not saved."""
        return self.state.content != self._saved

    def mark_saved(self) -> None:
        """Say that the recipe was saved as it is."""
        self._saved = self.state.content
        self._tell()

    def _edit(self, state: State) -> None:
        self._rest()
        if state.content == self.state.content:
            return
        made = self._solved(state, self._now)
        self._history.push(state)
        self._show(made)

    def _solved(self, state: State, known: Solved | None) -> Solved:
        """The deformation of a state; what it has in common with one that is known is not worked out again."""
        rest = state.rest
        plain = replace(rest, space=None)
        empty = Deformation.from_recipe(plain, self.shape, spacing=self.spacing, time=self._timed)
        made = Solved(state, (empty,))
        visible, same = made.visible, 0
        if known is not None and known.chain[0] == empty and known.state.rest.amount == rest.amount:
            for (_, stroke), (_, before) in zip(visible, known.visible, strict=False):
                if stroke is not before and stroke != before:
                    break
                same += 1
            made = Solved(state, known.chain[: same + 1], known.wholes[:same])
        for k, (i, stroke) in enumerate(visible[same:], same):
            try:
                whole, now = made.before(k)
                applied = now.add(reduced(stroke, rest.amount, whole, now), warn=False)
                last_outside(applied)
                made = Solved(state, (*made.chain, applied), (*made.wholes, whole))
            except SuppleError as error:
                many = len(state.items) > 1
                raise type(error)(f"stroke {i + 1}: {error}" if many else str(error)) from None
        return made

    def _show(self, made: Solved) -> None:
        self._now = made
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

    def _checked(self, i: int) -> int:
        count = len(self.items)
        wanted = f"one of {count}, from 0 to {count - 1}" if count else "none, as there are no strokes"
        return integer("a stroke's number", i, wanted, 0, count - 1)

    def _nth(self, i: int) -> int | None:
        """Which of the visible strokes an item is."""
        i = self._checked(i)
        return None if self.items[i].hidden else sum(not item.hidden for item in self.items[:i])

    @staticmethod
    def _replaced(state: State, i: int, stroke: Stroke) -> State:
        return state.with_item(i, Item(Item.of(stroke).stroke, state.items[i].hidden))
