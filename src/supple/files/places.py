"""Positions and lengths relative to a picture: names of landmarks, and percentages of a length in it."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any
from zlib import crc32

from supple.errors import SuppleError, argument, listing, shown
from supple.media.files import PathLike
from supple.strokes import Stroke

if TYPE_CHECKING:
    from supple.media.faces import Face
    from supple.media.medium import Medium

_POINT = re.compile(r"\s*([^\W\d]\w*)(?:@(\d+))?\s*([+-].*)?")
_RESOLVED = ("at", "to", "by", "path", "also", "radius")  # keys of a stroke
_NUMBERS = ("inf", "infinity", "nan")
_OFFSET = "+DX,DY in pixels or percent (nose_tip+0,10%, say)"


@dataclass(eq=False)
class Places:
    """A resolver of named positions and of lengths in percent, for the strokes of a picture.

    A position is the name of a landmark of the largest face, or ``NAME@2`` of the second largest, with an optional
    offset ``+DX,DY``. A percentage refers to the shortest side of the picture, or to the distance of two positions.
    """

    medium: Medium | None = None  # the picture; without one, positions and lengths are any, all of which differ
    landmarks: PathLike | None = None  # as in `supple.files.faces.faces_of`
    percent_of: str | None = None  # the two positions, ``A:B``; those of a recipe otherwise
    used: bool = field(default=False, init=False)  # anything was asked for: what was made is for this picture alone
    scaled: bool = field(default=False, init=False)  # any of that was a percentage

    @cached_property
    def faces(self) -> tuple[Face, ...]:
        """The faces of the picture."""
        from supple.files.faces import faces_of

        assert self.medium is not None
        if self.medium.kind != "picture":
            raise SuppleError(
                f"landmarks are of pictures, and {self.medium.name} is a {self.medium.kind}: give points in numbers"
            )
        return faces_of(self.medium.path, self.landmarks)

    def chosen(self, place: int | None) -> list[tuple[int, Face]]:
        """Return one face, 1 for the largest, or all of them, as (number, face)."""
        if place is not None and not 1 <= place <= len(self.faces):
            assert self.medium is not None
            many = f"{len(self.faces)} faces" if len(self.faces) > 1 else "one face"
            raise SuppleError(f"{self.medium.name} has {many}, and no face {place}: give another number")
        return [(k, face) for k, face in enumerate(self.faces, 1) if place in (None, k)]

    @cached_property
    def unit(self) -> float:
        """The length of 100 %."""
        if self.percent_of is not None:
            ends = str(self.percent_of).split(":")
            if len(ends) != 2:
                raise SuppleError(
                    f"{argument('percent_of')} must be two landmarks, A:B (left_eye:right_eye, say), found "
                    f"{self.percent_of!r}"
                )
            length = math.dist(*(self.point(argument("percent_of"), end) for end in ends))
            if not length > 0:
                raise SuppleError(f"{argument('percent_of')} {self.percent_of} are two landmarks at one place")
            return length
        if self.medium is None:
            return 1e6
        if self.medium.kind == "clip":
            from supple.files.clips import open_clip

            with open_clip(self.medium.path) as clip:
                return float(min(clip.layout.shape))
        grid = self.medium.grid
        assert grid is not None
        return min(n * step for n, step in zip(grid.sizes, grid.spacing, strict=True))

    def length(self, name: str, text: str, wanted: str) -> float:
        """Return a length from text: a number, or a percentage, ``12%``; ``name`` is the option's name for messages."""
        bare, percent = text.strip().removesuffix("%"), text.strip().endswith("%")
        self.used |= percent
        self.scaled |= percent
        try:
            number = float(bare)
        except ValueError:
            number = math.nan
        if math.isnan(number) or (percent and math.isinf(number)):
            raise SuppleError(f"{name} must be {wanted}, found {text!r}")
        return number * self.unit / 100 if percent else number

    def point(self, name: str, text: str) -> tuple[float, float]:
        """Return a position from text: a landmark's, with an optional offset."""
        found = _POINT.fullmatch(text)
        offset = (found[3] or "0,0").split(",") if found else []
        if found is None or len(offset) != 2:
            raise SuppleError(f"{name} must be a landmark, with or without {_OFFSET}, found {text!r}")
        from supple.media.faces import plain

        self.used = True
        mark = plain(found[1])
        if self.medium is None:
            x = crc32(f"{mark}@{found[2]}".encode()) / 2**32
            at = (x, x * x)  # placeholders on a parabola: no three of them on a line
        else:
            ((_, face),) = self.chosen(int(found[2] or 1))
            if mark not in face:
                known = [each for each in face if not each.startswith("point_")] or list(face)
                raise SuppleError(
                    f"{self.medium.name} has no landmark {shown(mark)}, which {name} asks for; it has "
                    f"{listing(known, 8)}"
                )
            at = face[mark]
        dx, dy = (self.length(name, part, f"a landmark and {_OFFSET}") for part in offset)
        return at[0] + dx, at[1] + dy

    def plain(self, name: str, text: str) -> str:
        """Return the text of an option with landmarks, and a percentage at its end (--push), replaced by numbers."""
        ends = text.split(":")
        count = len(ends) if name in ("--grab", "--mirror") else len(ends) - 1 if name == "--push" else 1
        for k, part in enumerate(ends):
            if k >= count and name == "--push" and part.strip().endswith("%"):
                ends[k] = repr(self.length(name, part, "a length in percent"))
            elif k < count and _POINT.fullmatch(part) and part.strip().lower() not in _NUMBERS:
                ends[k] = ",".join(map(repr, self.point(name, part)))
        return ":".join(ends)

    def resolve(self, recipe: dict[str, Any]) -> None:
        """Replace landmarks and percentages in the JSON of a recipe by numbers, in place."""
        own = recipe.pop("percent_of", None)
        places = Places(self.medium, self.landmarks, self.percent_of or own)  # the recipe's own unit of percentages
        strokes = recipe.get("strokes")
        for k, stroke in enumerate(strokes if isinstance(strokes, list) else ()):
            for key in [key for key in _RESOLVED if key in stroke] if isinstance(stroke, dict) else ():
                stroke[key] = places._resolved(f"strokes[{k}]: {key}", key, stroke[key])
        if places.used and recipe.get("size") is not None:
            raise SuppleError('a recipe of landmarks or percentages is for pictures of any size: leave "size" out')
        self.used, self.scaled = self.used or places.used, self.scaled or places.scaled

    def _resolved(self, name: str, key: str, value: Any) -> Any:
        """Return the value of a key with texts replaced by numbers; other values are kept, and checked later."""
        inner = {"path": ("at",), "by": ("radius",), "also": ("pair",), "pair": ("at", "by")}.get(key)
        if inner and isinstance(value, list) and (len(inner) == 1 or len(value) == len(inner)):
            return [self._resolved(name, inner[k % len(inner)], each) for k, each in enumerate(value)]
        if inner or not isinstance(value, str) or (key == "radius" and not value.endswith("%")):
            return value
        return self.length(name, value, "a number, or a percentage") if key == "radius" else [*self.point(name, value)]

    def pull(self, source: str, target: str, brush: dict[str, Any]) -> Stroke | None:
        """Return the pull of landmarks to those of another file, matched by names; None if both are files of points."""
        names = [source, target]
        if not any(os.path.isdir(name) or "*" in name or _is_of_landmarks(name) for name in names):
            return None
        self.used = True
        if self.medium is None:
            return Stroke.pull([(0, 0)], by=[(1, 1)], **brush)
        from supple.files.faces import faces_of

        start, end = (faces_of(self.medium.path, name)[0] for name in names)
        shared = [name for name in start if name in end]
        shared = [name for name in shared if name.startswith("point_")] or shared  # rather than means
        pairs = {start[name]: end[name] for name in shared}  # a point with several names is used once
        if not pairs:
            raise SuppleError(
                f"they have no landmark in common: {listing(list(start), 3)}, and {listing(list(end), 3)}"
            )
        return Stroke.pull(list(pairs), to=list(pairs.values()), **brush)


def _is_of_landmarks(name: str) -> bool:
    lower = name.lower()
    return lower.endswith((".pts", ".xml")) or (lower.endswith(".json") and not lower.endswith(".mrk.json"))
