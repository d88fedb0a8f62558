"""A recipe: strokes and their options, for any medium."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Self, get_args

from supple.errors import ScaleWarning, SuppleError, argument, warn
from supple.space.checks import Shape, assign, checked_sizes, choice, length, listed, number, refuse
from supple.space.domain import Border, BorderProfile, check_border_profile, checked_border
from supple.space.freezing import Freeze
from supple.space.straighten import Straighten
from supple.strokes.scaling import Fit, Scaling, scaling_of, spoken
from supple.strokes.stroke import LEAST, MOST, PART, Stroke
from supple.strokes.text import read, written

FoldPolicy = Literal["damp", "flow", "error"]
CoordinateSpace = Literal["pixels", "LPS", "RAS"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """A sequence of strokes and their options, to be applied to any medium.

    Parameters
    ----------
    border : "auto", float, sequence of float or None
        The width of the fixed border, as in `Domain`.
    border_profile : str
        The profile of the fixed border: ``"quartic"``, or the paper's ``"sine"``.
    on_fold : str
        The policy for a stroke that would fold the image, or that the border holds back: ``"flow"``, ``"damp"`` or
        ``"error"``.
    strokes : iterable of Stroke
        In order of application, all with the same number of coordinates. Hidden ones are not applied.
    size : sequence of int or None
        The samples along each axis, x first, of the recipe's original medium; as many numbers as coordinates.
    space : str or None
        The coordinates of points: ``"pixels"`` (indices, in volumes); or, in volumes, millimetres in ``"LPS"`` or
        ``"RAS"``. None: pixels, unless the reader of the volume determines otherwise.
    amount : float
        The applied fraction of every stroke's drag, from -1 (the opposite) to 2.
    time_scale : float or None
        For a recipe with times, the length of a frame in pixels. None: 1, unless the reader of the clip determines
        otherwise.
    freeze : Freeze or None
        The freeze mask of all strokes up to the first freeze among them (`Stroke.freeze`), in samples of the medium
        that the recipe was made for, whatever its ``space`` is.
    straighten : Straighten or None
        How a picture is straightened after all strokes, in the same resampling.
    """

    border: Border = "auto"
    border_profile: BorderProfile = "quartic"
    on_fold: FoldPolicy = "flow"
    strokes: tuple[Stroke, ...] = ()
    size: Shape | None = None
    space: CoordinateSpace | None = None
    amount: float = 1.0
    time_scale: float | None = None
    freeze: Freeze | None = None
    straighten: Straighten | None = None

    def __post_init__(self) -> None:
        check_border_profile(self.border_profile)
        choice("on_fold", self.on_fold, get_args(FoldPolicy))
        strokes = listed("strokes", self.strokes, "a sequence of Stroke")
        for i, stroke in enumerate(strokes):
            if not isinstance(stroke, Stroke):
                refuse(f"strokes[{i}]", "a Stroke", stroke)
            if (n := strokes[0].ndim) != stroke.ndim:
                refuse(f"strokes[{i}].at", f"a point of {n} numbers, as in strokes[0]", stroke.at)
        ndim = strokes[0].ndim if strokes else None
        if self.space is not None:
            choice("space", self.space, get_args(CoordinateSpace))
            if self.is_world and ndim == 2:
                refuse("space", '"pixels" where points have 2 numbers', self.space)
        if not isinstance(self.freeze, Freeze | None):
            refuse("freeze", "a Freeze (Freeze.of makes one from an array)", self.freeze)
        if not isinstance(self.straighten, Straighten | None):
            refuse("straighten", "a Straighten", self.straighten)
        assign(
            self,
            border=checked_border(self.border),
            strokes=strokes,
            size=None if self.size is None else _checked_size(self.size, ndim),
            amount=number("amount", self.amount, PART, LEAST, MOST),
            time_scale=None if self.time_scale is None else length("time_scale", self.time_scale),
        )

    @property
    def is_world(self) -> bool:
        """True if points are in space, in millimetres."""
        return self.space in ("LPS", "RAS")

    @property
    def moves(self) -> bool:
        """True if a visible stroke differs from frame to frame: it has keys, or a moving matte."""
        return any(stroke.changes and not stroke.hidden for stroke in self.strokes)

    def at_frame(self, frame: float) -> Self:
        """Return the recipe at a frame of a clip, with its strokes by their keys: a recipe without keys, for a picture.

        Parameters
        ----------
        frame : float
            The frame, counted from 0.
        """
        if not any(stroke.changes for stroke in self.strokes):
            return self
        return replace(self, strokes=tuple(stroke.at_frame(frame) for stroke in self.strokes))

    def fitted(self, size: Sequence[int], how: Fit | None = None, *, time: bool = False, name: str = "this") -> Self:
        """Return the recipe scaled to a medium of another size.

        The centre p of a pixel goes to (p + 0.5) s - 0.5, where s is the factor from the old size to the new one; radii
        and borders are scaled, too. For a clip, the length of a frame must be scaled by `Scaling.frame`.

        Parameters
        ----------
        size : sequence of int
            Samples along each axis, x first.
        how : str, optional
            Without it, only a size of the same proportions fits, within half a pixel. ``"pixels"``: same
            coordinates; ``"stretch"``: each axis has its own factor, and the radius is scaled by their geometric
            mean; ``"inside"``: x and y have the same factor, the largest that fits, and the result is centred.
        time : bool
            Whether a third axis is time. Only ``"stretch"`` scales it.
        name : str
            What has this size, for messages.

        Raises
        ------
        SuppleError
            If the size does not fit; or ``how`` is given, and the recipe has no size or is in millimetres.
        """
        size = _checked_size(size, None)
        if how is not None and self.is_world:
            raise SuppleError(
                f"{argument('fit')} is for recipes in pixels, and this one is in {self.space} millimetres: leave it out"
            )
        if how is not None and self.size is None:
            raise SuppleError(
                f"{argument('fit')} needs the size that the recipe was made for, and it has none: leave it out"
            )
        if self.strokes and self.strokes[0].ndim != len(size):
            return self  # invalid recipes are reported when they are applied
        if not self.strokes and self.size is not None and len(self.size) != len(size):
            return self  # without strokes, any mask: it may be that of a clip's frames
        if self.size is None or self.is_world or not (self.strokes or self.freeze or self.straighten):
            return replace(self, size=size)
        return self._scaled(scaling_of(self.size, size, how, time=time, name=name), size)

    def placed(self, offset: Sequence[float], size: Sequence[int]) -> Self:
        """Return the recipe, which has a size, for a larger medium, in which its own medium begins at ``offset``."""
        if not any(offset) or (self.strokes and self.strokes[0].ndim != len(offset)):  # the latter is refused later
            return replace(self, size=tuple(size)) if len(offset) == len(self.size or ()) else self
        return self._scaled(Scaling((1.0,) * len(offset), tuple(map(float, offset)), 1.0), tuple(size))

    def _scaled(self, scaling: Scaling | None, size: Shape) -> Self:
        def masked(freeze: Freeze | None) -> Freeze | None:
            if freeze is None or self.size is None or freeze.samples[: len(self.size)] != self.size[: freeze.ndim]:
                return freeze  # already of the medium's size, or refused later
            return freeze.fitted(size, None if scaling is None else scaling.point)

        if scaling is None:
            same = tuple(replace(stroke, matte=masked(stroke.matte)) for stroke in self.strokes)
            return replace(self, size=size, strokes=same, freeze=masked(self.freeze))
        strokes = [
            replace(
                stroke.mapped(scaling.point, scaling.drag),
                radius=stroke.radius * scaling.length,
                time_radius=None if stroke.time_radius is None else stroke.time_radius * scaling.factors[2],
                matte=masked(stroke.matte),
            )
            for stroke in self.strokes
        ]
        border = self.border
        if isinstance(border, float | tuple):
            given = border if isinstance(border, tuple) else (border,) * len(size)
            if len(given) == len(size):  # else reported when it is applied
                widths = tuple(width * s for width, s in zip(given, scaling.widths, strict=True))
                border = widths[0] if isinstance(border, float) and len(set(widths)) == 1 else widths
        made = replace(self, size=size, strokes=tuple(strokes), border=border, freeze=masked(self.freeze))
        return made if self.straighten is None else replace(made, straighten=self.straighten.mapped(scaling.point))

    def to_json(self) -> str:
        """Return the recipe as strict JSON, one stroke a line; `from_json` reads it."""
        order = ("border", "border_profile", "on_fold", "amount", "space", "size", "time_scale", "freeze", "straighten")
        return written({name: getattr(self, name) for name in order}, self.strokes)

    @classmethod
    def from_json(cls, text: str, *, resolve: Callable[[dict[str, Any]], None] | None = None) -> Self:
        """Read a recipe written by `to_json` or by hand.

        Parameters
        ----------
        text : str
            The JSON text. All keys but ``supple`` and ``strokes``, and of a stroke ``brush``, ``at``, ``radius`` and
            ``by`` (or ``to``), have defaults. A recipe of version 1 has no ``reach``, and the border is ``"sine"``.
            Twists of version 2 move points along chords (``chord``), and in clips its strokes are as long in time as in
            space, and move both (``isotropic``).
        resolve : function of dict, optional
            Replaces references in the JSON object by numbers, as `supple.files.places.Places.resolve` does.

        Raises
        ------
        SuppleError
            If it is not a recipe; the message names the fault.
        """
        return cls(**read(text, [field.name for field in fields(cls)], resolve))


def fit_recipe(recipe: Recipe, size: Sequence[int], how: Fit | None, name: str, *, time: bool = False) -> Recipe:
    """Return a recipe scaled to a file's size by `Recipe.fitted`, and warn if ``how`` is not given."""
    made = recipe.fitted(size, how, time=time, name=name)
    if how is None and recipe.size is not None and made.strokes != recipe.strokes:
        warn(
            f"the recipe was made for {spoken(recipe.size)}, and is scaled for {name}, which is {spoken(size)}",
            ScaleWarning,
        )
    return made


def _checked_size(size: object, ndim: int | None) -> Shape:
    lengths = (2, 3) if ndim is None else (ndim,)
    return checked_sizes("size", size, f"{' or '.join(map(str, lengths))} numbers of samples, x first", lengths)
