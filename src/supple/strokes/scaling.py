"""Coordinates scaled from the size of one medium to that of another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from supple.errors import SuppleError, argument
from supple.space.checks import Vector, choice

Fit = Literal["pixels", "stretch", "inside"]
FITS: tuple[str, ...] = get_args(Fit)


@dataclass(frozen=True, slots=True)
class Scaling:
    """A map of coordinates: ``p`` to ``(p + 0.5) * factor - 0.5 + offset`` along each axis, x first.

    Parameters
    ----------
    factors, offsets : tuple of float
    length : float
        The factor of lengths, such as a brush's radius.
    """

    factors: Vector
    offsets: Vector
    length: float

    @property
    def widths(self) -> Vector:
        """The factor of a border's width along each axis, in physical units."""
        return (*self.factors[:2], self.length)[: len(self.factors)]

    @property
    def frame(self) -> float:
        """The factor of the time scale, in physical units; 1 without time."""
        return self.length / self.factors[2] if len(self.factors) == 3 else 1.0

    def point(self, p: Sequence[float]) -> Vector:
        """Return the image of a point."""
        moved = zip(p, self.factors, self.offsets, strict=True)
        return tuple(x if (s, o) == (1.0, 0.0) else (x + 0.5) * s - 0.5 + o for x, s, o in moved)

    def drag(self, v: Sequence[float]) -> Vector:
        """Return the image of a difference of two points."""
        return tuple(x * s for x, s in zip(v, self.factors, strict=True))


def scaling_of(
    made: Sequence[int], size: Sequence[int], how: Fit | None = None, *, time: bool = False, name: str = "this"
) -> Scaling | None:
    """Return the map of coordinates from the size ``made`` to another, as in `Recipe.fitted`; None for the identity.

    SuppleError if the sizes do not fit; ``name`` is what has the second one, for messages.
    """
    if how is not None:
        choice("fit", how, FITS)
    made, size = tuple(made), tuple(size)
    if made == size or how == "pixels":
        return None
    found = f"the recipe was made for {spoken(made)}, and {name} is {spoken(size)}"
    if len(size) == 3 and not time:
        raise SuppleError(
            f"{found}: voxels are not scaled, as lengths are millimetres: {argument('fit', 'pixels')} takes the "
            "indices as they are"
        )
    if len(size) == 3 and made[2] != size[2] and how != "stretch":
        raise SuppleError(
            f"{found}: {argument('fit', 'stretch')} scales time too, and {argument('fit', 'pixels')} takes frames and "
            "pixels as they are"
        )
    factors = tuple(b / a for a, b in zip(made, size, strict=True))
    x, y = factors[:2]
    if how == "inside":
        scale = min(x, y)
        offsets = tuple((b - a * scale) / 2 for a, b in zip(made[:2], size[:2], strict=True))
        return Scaling((scale, scale, *factors[2:]), (*offsets, 0.0)[: len(size)], scale)
    if how is None:
        low = max((b - 0.5) / a for a, b in zip(made[:2], size[:2], strict=True))
        high = min((b + 0.5) / a for a, b in zip(made[:2], size[:2], strict=True))
        if low > high:
            raise SuppleError(
                f"{found}, of other proportions: say how it fits, with {argument('fit', 'stretch')} (each axis by a "
                f"factor of its own), {argument('fit', 'inside')} (at one scale, centred) or "
                f"{argument('fit', 'pixels')} (coordinates as they are)"
            )
    return Scaling(factors, (0.0,) * len(size), x if x == y else math.sqrt(x * y))


def spoken(size: Sequence[int]) -> str:
    """Return a size in words."""
    return " x ".join(map(str, size))
