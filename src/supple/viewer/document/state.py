"""States of a document, their deformations, and the undo history of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, Literal, Self, TypeVar

from supple.deformation import Deformation, after, last_outside, reduced
from supple.domain import Border, BorderProfile, refuse
from supple.errors import SuppleError
from supple.strokes import FoldPolicy, Recipe, Space, Stroke

Kind = Literal["image", "video", "volume"]
S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class Item:
    """A stroke in the list.

    Parameters
    ----------
    stroke : Stroke
        Never hidden itself.
    hidden : bool
        Whether it is put aside.
    """

    stroke: Stroke
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

    Parameters
    ----------
    items : tuple of Item
        In the order in which they are applied.
    border : "auto", float, sequence of float or None
    border_profile : str
    on_fold : str
    selected : int or None
        Which item is selected.
    amount : float
        The part of the drags that is carried out.
    space : str or None
        What points are in the file, if not samples, as which they are edited.
    """

    items: tuple[Item, ...] = ()
    border: Border = "auto"
    border_profile: BorderProfile = "quartic"
    on_fold: FoldPolicy = "flow"
    selected: int | None = None
    amount: float = 1.0
    space: Space | None = None

    @classmethod
    def of(cls, recipe: Recipe) -> Self:
        """A recipe of samples, with nothing selected."""
        return cls(
            tuple(map(Item.of, recipe.strokes)),
            recipe.border,
            recipe.border_profile,
            recipe.on_fold,
            amount=recipe.amount,
            space=recipe.space,
        )

    @property
    def recipe(self) -> Recipe:
        """The recipe of this state, without its space: points are samples."""
        return Recipe(
            border=self.border,
            border_profile=self.border_profile,
            on_fold=self.on_fold,
            strokes=tuple(item.kept for item in self.items),
            amount=self.amount,
        )

    def with_item(self, i: int, item: Item) -> Self:
        """Another stroke in the place of one; or after the last."""
        return replace(self, items=(*self.items[:i], item, *self.items[i + 1 :]))

    @property
    def content(self) -> tuple[object, ...]:
        """All of it but what is selected."""
        return self.items, self.border, self.border_profile, self.on_fold, self.amount, self.space


@dataclass(frozen=True, slots=True)
class Solved:
    """A state, and the deformation after none, one, two, … of its visible strokes.

    Parameters
    ----------
    state : State
    chain : tuple of Deformation
    wholes : tuple of Deformation
        Before each visible stroke, what those before it do in full; that of the chain itself where it is the same.
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
        whole = after(stroke, self.state.amount, self.wholes[k - 1], self.chain[k - 1], self.chain[k])
        return whole, self.chain[k]

    def kept(self, stroke: Stroke, k: int) -> Stroke:
        """A stroke that is drawn on what is seen, before visible stroke number ``k``, as a recipe has it."""
        whole, now = self.before(k)
        part = self.state.amount * stroke.strength
        if whole is not now:
            stroke = replace(stroke, at=tuple(whole.forward(now.inverse(stroke.at).points).tolist()))
        return replace(stroke, by=tuple(x / part for x in stroke.by)) if 0 < part < 1 else stroke


@dataclass(frozen=True, slots=True)
class Medium:
    """The medium that is deformed.

    Parameters
    ----------
    shape : tuple of int
    spacing : float or sequence of float
        Physical units per sample, x first.
    kind : str, optional
    """

    shape: tuple[int, ...]
    spacing: float | Sequence[float]
    kind: Kind | None = None

    def solve(self, state: State, known: Solved | None = None) -> Solved:
        """The deformation of a state; what it has in common with one that is known is not worked out again."""
        empty = Deformation(
            self.shape,
            border=state.border,
            border_profile=state.border_profile,
            spacing=self.spacing,
            time=self.kind == "video" and len(self.shape) == 3,
            on_fold=state.on_fold,
        )
        made = Solved(state, (empty,))
        visible, same = made.visible, 0
        if known is not None and known.chain[0] == empty and known.state.amount == state.amount:
            for (_, stroke), (_, before) in zip(visible, known.visible, strict=False):
                if stroke is not before and stroke != before:
                    break
                same += 1
            made = Solved(state, known.chain[: same + 1], known.wholes[:same])
        for k, (i, stroke) in enumerate(visible[same:], same):
            try:
                whole, now = made.before(k)
                applied = now.add(reduced(stroke, state.amount, whole, now), warn=False)
                last_outside(applied)
                made = Solved(state, (*made.chain, applied), (*made.wholes, whole))
            except SuppleError as error:
                many = len(state.items) > 1
                raise type(error)(f"stroke {i + 1}: {error}" if many else str(error)) from None
        return made


class History(Generic[S]):
    """A present state, those before it, and those that were undone.

    It has no end, and merges nothing: what is pushed is a step.

    Parameters
    ----------
    present : object
        The first state. States are kept as they are, so they must never change.
    """

    def __init__(self, present: S) -> None:
        self._present = present
        self._past: list[S] = []
        self._future: list[S] = []

    @property
    def present(self) -> S:
        """The state as it is now."""
        return self._present

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
        self._past.append(self._present)
        self._present = state
        self._future.clear()

    def amend(self, state: S) -> None:
        """Put another state in the place of the present one, without a step."""
        self._present = state

    def undo(self) -> S:
        """Go back to the state before; without one, stay."""
        if self._past:
            self._future.append(self._present)
            self._present = self._past.pop()
        return self._present

    def redo(self) -> S:
        """Go to the state that was undone last; without one, stay."""
        if self._future:
            self._past.append(self._present)
            self._present = self._future.pop()
        return self._present
