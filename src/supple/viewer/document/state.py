"""States of a document and their deformations, and landmarks, which move with a volume."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation, after
from supple.folding.limits import NEAR
from supple.strokes import CoordinateSpace, FoldPolicy, Recipe, Stroke

Kind = Literal["image", "video", "volume"]
Point = tuple[float, ...]
Floats = npt.NDArray[np.float64]
Handle = tuple[Point, Point]
"""A point of a stroke, and where it ends."""
_EMPTY = Recipe()


@dataclass(frozen=True, slots=True)
class State:
    """The state that is undone and redone.

    Points are samples here; if those of the file are in millimetres, ``rest`` has their space.
    """

    strokes: tuple[Stroke, ...] = ()  # in the order of application, with the hidden ones
    rest: Recipe = _EMPTY  # the recipe's other options
    selected: int | None = None

    @classmethod
    def of(cls, recipe: Recipe, space: CoordinateSpace | None = None) -> Self:
        """Return the state of a recipe of samples, with nothing selected, and its space for saving."""
        rest = replace(recipe, strokes=(), size=None, space=space, time_scale=None)
        return cls(recipe.strokes, rest)

    @property
    def recipe(self) -> Recipe:
        """The recipe of this state, without its space: points are samples."""
        return replace(self.rest, space=None, strokes=self.strokes)

    @property
    def on_fold(self) -> FoldPolicy:
        """The policy for strokes that would fold the image."""
        return self.rest.on_fold

    def with_stroke(self, i: int, stroke: Stroke) -> Self:
        """Return a state with a stroke replaced."""
        return replace(self, strokes=(*self.strokes[:i], stroke, *self.strokes[i + 1 :]))

    @property
    def content(self) -> tuple[object, object]:
        """The state without the selection."""
        return self.strokes, self.rest


@dataclass(frozen=True, slots=True)
class Track:
    """A visible stroke on screen: at its full drag, if its recipe applies a fraction of it."""

    stroke: Stroke
    handles: tuple[Handle, ...]
    wanted: Point | None  # the target of its first point, if it misses that

    @classmethod
    def of(cls, stroke: Stroke, made: Deformation) -> Self:
        """Return the last stroke of a deformation, which applies a stroke of the recipe."""
        applied, arrival = made.strokes[-1], made.arrival(len(made.strokes) - 1)
        seen = stroke if applied is stroke else replace(applied, strength=stroke.strength)
        (at, _), *others = handles_of(seen)
        return cls(seen, ((at, arrival.arrived), *others), arrival.target if arrival.miss > NEAR else None)


def handles_of(stroke: Stroke) -> tuple[Handle, ...]:
    """Return the points of a stroke, and their targets."""
    return tuple((at, tuple(a + b for a, b in zip(at, by, strict=True))) for at, by in stroke.handles)


@dataclass(frozen=True, slots=True)
class Solved:
    """A state, and the deformation after none, one, two, … of its visible strokes.

    ``wholes`` are the deformations before each visible stroke at full strength; those of the chain itself where they
    are equal.
    """

    state: State
    chain: tuple[Deformation, ...]
    wholes: tuple[Deformation, ...] = ()
    tracks: tuple[Track, ...] = ()

    @property
    def visible(self) -> list[tuple[int, Stroke]]:
        """The visible strokes, with their indices."""
        return [(i, stroke) for i, stroke in enumerate(self.state.strokes) if not stroke.hidden]

    def before(self, k: int) -> tuple[Deformation, Deformation]:
        """Return the deformation before a visible stroke, or the next one: at full strength, and as applied."""
        if k < len(self.wholes):
            return self.wholes[k], self.chain[k]
        if k == 0:
            return self.chain[0], self.chain[0]
        stroke = self.visible[k - 1][1]
        whole = after(stroke, self.state.rest.amount, self.wholes[k - 1], self.chain[k - 1], self.chain[k])
        return whole, self.chain[k]

    def kept(self, stroke: Stroke, k: int) -> Stroke:
        """Return a stroke drawn on screen before visible stroke number ``k``, in coordinates of the recipe."""
        whole, now = self.before(k)
        part = self.state.rest.amount * stroke.strength
        if whole is not now:
            stroke = replace(stroke, at=tuple(whole.forward(now.inverse(stroke.at).points).tolist()))
        return replace(stroke.weakened(1 / part), strength=stroke.strength) if 0 < part < 1 else stroke


class Landmarks:
    """Named points of a volume, before and after strokes.

    Parameters
    ----------
    names : tuple of str
    points : float64 array, shape (N, 3)
        In voxels of the volume without strokes, x first.
    """

    def __init__(self, names: tuple[str, ...], points: Floats) -> None:
        self.names, self.points = names, points
        self._moved: tuple[Deformation, Floats] | None = None

    def moved(self, deformation: Deformation) -> Floats:
        """Return where the points are after strokes, (N, 3); the last answer is cached."""
        if deformation.is_identity:
            return self.points
        if self._moved is None or self._moved[0] is not deformation:
            self._moved = deformation, np.asarray(deformation.forward(self.points), np.float64)
        return self._moved[1]
