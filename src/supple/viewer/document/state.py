"""States of a document, their deformations, and the undo history of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, Literal, Self, TypeVar

from supple.deformation import Deformation, after
from supple.domain import refuse
from supple.strokes import CoordinateSpace, FoldPolicy, Recipe, Stroke

Kind = Literal["image", "video", "volume"]
S = TypeVar("S")
_EMPTY = Recipe()


@dataclass(frozen=True, slots=True)
class Item:
    """A stroke in the list, which may be put aside."""

    stroke: Stroke  # never hidden itself
    hidden: bool = False

    @classmethod
    def of(cls, stroke: Stroke) -> Self:
        """A stroke of a recipe, which knows whether it is hidden."""
        if not isinstance(stroke, Stroke):
            refuse("a stroke", "a Stroke", stroke)
        return cls(replace(stroke, hidden=False) if stroke.hidden else stroke, stroke.hidden)

    @property
    def kept(self) -> Stroke:
        """The stroke as a recipe keeps it."""
        return replace(self.stroke, hidden=True) if self.hidden else self.stroke


@dataclass(frozen=True, slots=True)
class State:
    """All that is undone and redone.

    Points are samples here; where those of the file are in millimetres, the rest knows in which space.
    """

    items: tuple[Item, ...] = ()  # in the order in which they are applied
    rest: Recipe = _EMPTY  # all else that the recipe says
    selected: int | None = None

    @classmethod
    def of(cls, recipe: Recipe, space: CoordinateSpace | None = None) -> Self:
        """A recipe of samples, with nothing selected, that is saved in a space."""
        rest = replace(recipe, strokes=(), size=None, space=space, time_scale=None)
        return cls(tuple(map(Item.of, recipe.strokes)), rest)

    @property
    def recipe(self) -> Recipe:
        """The recipe of this state, without its space: points are samples."""
        return replace(self.rest, space=None, strokes=tuple(item.kept for item in self.items))

    @property
    def on_fold(self) -> FoldPolicy:
        """The policy for strokes that would fold the picture."""
        return self.rest.on_fold

    def with_item(self, i: int, item: Item) -> Self:
        """Another stroke in the place of one; or after the last."""
        return replace(self, items=(*self.items[:i], item, *self.items[i + 1 :]))

    @property
    def content(self) -> tuple[object, object]:
        """All of it but what is selected."""
        return self.items, self.rest


@dataclass(frozen=True, slots=True)
class Solved:
    """A state, and the deformation after none, one, two, … of its visible strokes.

    The wholes are, before each visible stroke, what those before it do in full; that of the chain itself where it is
    the same.
    """

    state: State
    chain: tuple[Deformation, ...]
    wholes: tuple[Deformation, ...] = ()

    @property
    def visible(self) -> list[tuple[int, Stroke]]:
        """The strokes that are applied, with their numbers."""
        return [(i, item.stroke) for i, item in enumerate(self.state.items) if not item.hidden]

    def before(self, k: int) -> tuple[Deformation, Deformation]:
        """Return the deformation of the visible strokes before one, or the next one: in full, and as it is applied."""
        if k < len(self.wholes):
            return self.wholes[k], self.chain[k]
        if k == 0:
            return self.chain[0], self.chain[0]
        stroke = self.visible[k - 1][1]
        whole = after(stroke, self.state.rest.amount, self.wholes[k - 1], self.chain[k - 1], self.chain[k])
        return whole, self.chain[k]

    def kept(self, stroke: Stroke, k: int) -> Stroke:
        """A stroke that is drawn on what is seen, before visible stroke number ``k``, as a recipe has it."""
        whole, now = self.before(k)
        part = self.state.rest.amount * stroke.strength
        if whole is not now:
            stroke = replace(stroke, at=tuple(whole.forward(now.inverse(stroke.at).points).tolist()))
        return replace(stroke, by=tuple(x / part for x in stroke.by)) if 0 < part < 1 else stroke


class History(Generic[S]):
    """A present state, those before it, and those that were undone.

    It has no end, and merges nothing: what is pushed is a step. States are kept as they are, so they must never change.
    """

    def __init__(self, present: S) -> None:
        self.present = present
        self._past: list[S] = []
        self._future: list[S] = []

    @property
    def can_undo(self) -> bool:
        """Return whether there is a state before this one."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Return whether a state was undone, and nothing was pushed since."""
        return bool(self._future)

    def push(self, state: S) -> None:
        """Go on to another state; what was undone is gone."""
        self._past.append(self.present)
        self.present = state
        self._future.clear()

    def amend(self, state: S) -> None:
        """Put another state in the place of the present one, without a step."""
        self.present = state

    def undo(self) -> S:
        """Go back to the state before; without one, stay."""
        if self._past:
            self._future.append(self.present)
            self.present = self._past.pop()
        return self.present

    def redo(self) -> S:
        """Go to the state that was undone last; without one, stay."""
        if self._future:
            self._past.append(self.present)
            self.present = self._future.pop()
        return self.present
