"""What a document is at one time, and the deformation of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

from supple.deformation import Deformation, last_outside
from supple.domain import Border, BorderProfile, refuse
from supple.errors import SuppleError
from supple.strokes import FoldPolicy, Recipe, Stroke

Kind = Literal["image", "video", "volume"]


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
    """

    items: tuple[Item, ...] = ()
    border: Border = "auto"
    border_profile: BorderProfile = "quartic"
    on_fold: FoldPolicy = "flow"
    selected: int | None = None

    @classmethod
    def of(cls, recipe: Recipe) -> Self:
        """A recipe, with nothing selected."""
        return cls(tuple(map(Item.of, recipe.strokes)), recipe.border, recipe.border_profile, recipe.on_fold)

    @property
    def recipe(self) -> Recipe:
        """What is kept of it in a file."""
        return Recipe(
            border=self.border,
            border_profile=self.border_profile,
            on_fold=self.on_fold,
            strokes=tuple(item.kept for item in self.items),
        )

    def with_item(self, i: int, item: Item) -> Self:
        """Another stroke in the place of one; or after the last."""
        return replace(self, items=(*self.items[:i], item, *self.items[i + 1 :]))

    @property
    def content(self) -> tuple[object, ...]:
        """All of it but what is selected."""
        return self.items, self.border, self.border_profile, self.on_fold


@dataclass(frozen=True, slots=True)
class Solved:
    """A state, and the deformation after none, one, two, … of its visible strokes."""

    state: State
    chain: tuple[Deformation, ...]


@dataclass(frozen=True, slots=True)
class Medium:
    """What is deformed.

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

    def solve(self, state: State, chain: tuple[Deformation, ...] = ()) -> Solved:
        """The deformation of a state; what it has in common with a chain that is known is not worked out again."""
        empty = Deformation(
            self.shape,
            border=state.border,
            border_profile=state.border_profile,
            spacing=self.spacing,
            time=self.kind == "video" and len(self.shape) == 3,
            on_fold=state.on_fold,
        )
        if not chain or (chain[0].domain, chain[0].on_fold) != (empty.domain, empty.on_fold):
            chain = (empty,)
        visible = [(i, item.stroke) for i, item in enumerate(state.items) if not item.hidden]
        same = 0
        for (_, stroke), before in zip(visible, chain[-1].strokes, strict=False):
            if stroke is not before and stroke != before:
                break
            same += 1
        made = list(chain[: same + 1])
        for i, stroke in visible[same:]:
            try:
                made.append(made[-1].add(stroke, warn=False))
                last_outside(made[-1])
            except SuppleError as error:
                many = len(state.items) > 1
                raise type(error)(f"stroke {i + 1}: {error}" if many else str(error)) from None
        return Solved(state, tuple(made))
