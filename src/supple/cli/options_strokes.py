"""Options of strokes, in the order in which they are given, and the recipe that they make."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from supple.cli.console import current
from supple.cli.options import COORDINATES, Frames, number, parse_integer, parse_number
from supple.errors import SuppleError, shown

if TYPE_CHECKING:
    from supple.files.places import Places
    from supple.media.medium import Medium
    from supple.space.domain import Border
    from supple.space.freezing import Freeze
    from supple.space.straighten import Straighten
    from supple.strokes import CoordinateSpace, Fit, Recipe, Stroke

Place = Callable[[], str | None]

STROKES = Group("Strokes", sort_key=1)
STRAIGHTEN = Group("Straighten pictures", sort_key=1.2)

BRUSHES = ("--grab", "--twist", "--scale", "--pinch", "--pull", "--push")
"""The options that are strokes."""

FRAMES = ("crop", "pad", "keep")
_ONE_OF = "give --grab, --twist, --scale, --pinch, --pull or --push"
# Of one stroke, and of all of them.
_OF_EACH = ("radius", "poisson", "scales", "reach", "time_radius", "flat", "strength", "matte", "mirror")
_OF_ALL = ("border", "border_profile", "freeze", "freeze_width", "on_fold")
_FLAT = "a part of the radius from 0 to 0.9"
_TWIST = "X,Y[,T|Z]:ANGLE[:AXIS]"
_SCALE = "X,Y[,T|Z]:FACTOR"
_PINCH = "X,Y[,T|Z]:FACTOR[:AXIS]"
_PUSH = "X,Y:X,Y:BY"
_KEYSTONE = "X,Y:X,Y:X,Y:X,Y"
_WANTED = {
    "--grab": "X,Y:X,Y, or X,Y,T:X,Y,T, two points or more in pixels, frames or voxels (256,256:256,346, say)",
    "--twist": f"{_TWIST}, a point, degrees, and of 3 numbers an axis (256,256:30 or 40,50,60:30:0,0,1, say)",
    "--scale": f"{_SCALE}, a point and a factor (256,256:1.4, say)",
    "--push": f"{_PUSH}, two points or more and how far to the left of the way (90,40:90,160:12, say)",
    "--pinch": f"{_PINCH}, a point, a factor, and an axis of as many numbers (256,256:0.7:1,0, say)",
}


def in_order(arguments: Sequence[str], given: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Return the options of a command line that have an order, with their values.

    ``given`` has the values of each of these options, as the parser found them: SuppleError if they differ from what is
    found in the arguments.
    """
    found, rest = [], iter(arguments)
    for argument in rest:
        if argument == "--":
            break
        name, joined, value = argument.partition("=")
        if name in given or name in ("--recipe", "--inverse"):
            found.append((name, value if joined or name == "--inverse" else next(rest, "")))
    for name, values in given.items():
        if [value for option, value in found if option == name] != list(values):
            raise SuppleError(f"the place of {name} among the options is in doubt: write {name} VALUE by itself")
    return found


@Parameter(name="*", group=STROKES)
@dataclass(kw_only=True, eq=False, repr=False)
class StrokeOptions:
    """Options for strokes: points, drags and materials.

    Parameters
    ----------
    grab
        Drag the first point to the second, or through more of them to the last. Pixels are counted from the top
        left one, which is 0,0. In a video, a third number is the frame, counted from 0, or its timecode,
        00:00:12:08; in a volume, points are voxels x,y,z. Give it and the next four several times, mixed as you like,
        for several strokes, which are applied in order. In a picture, a landmark may stand for a point, with or without
        an offset: left_eye, nose_tip+0,10%.

    twist
        Turn what is around a point by an angle in degrees, clockwise; in a volume, right-handed about an axis: its
        direction DX,DY,DZ (default z).
    scale
        Magnify what is around a point by a factor: above 1 it bloats, below 1 it puckers.
    pinch
        Squeeze what is around a point, by a factor below 1, along an axis (a direction, default x), and stretch it
        across the axis by as much; above 1, the other way round.
    pull
        Drag many points at once: those of a file to those of another, CSV, .fcsv or .mrk.json. Points with labels are
        matched by these, others in order; a point that is the same in both is a pin. Files in millimetres (LPS or
        RAS) are taken as they say; give --world if other strokes are in millimetres too. For a volume, a table that
        does not say what its numbers are needs --convention LPS, RAS or index (voxels). For pictures, they may also be
        files of landmarks, or folders, of which each has a file with the picture's stem.
    push
        Push what lies along a way, of two points or more, sideways: to the left of it by pixels, or below 0 to the
        right. It is for pictures, and for every frame of a video.
    radius
        Radius of the brush: in pixels, in volumes in millimetres; or, 12%, in percent of the shortest side, or of what
        --percent-of says. Give --radius, --poisson, --reach and --time-radius
        once for all strokes, or once for each; --scales and --flat once for all grabs, or once for each.
    poisson
        Poisson's ratio of the material, at most 0.5 (default 0.4). The higher it is, the more the material gives
        way sideways, which keeps volume in 3-D, but not area in a picture. -inf moves nothing sideways. In a video,
        a drag in the picture moves nothing in time, and one in time nothing in the picture, unless this is given.
    scales
        How fast the movement of a grab fades with distance r: 1 as 1/r (default), 2 as 1/r³, 3 as 1/r⁵.
    reach
        Distance from the line between a stroke's start and its target, in radii, beyond which nothing moves and
        values stay as they are: at least 1 (default 4), or none for no limit.
    time_radius
        Radius of the brush in time, in frames, for strokes with a time (default: the larger of the drag in time and an
        eighth of the video, at most the radius).
    flat
        Part of a grab's radius, in space and time, within which all moves as its point does, from 0 (default) to 0.9.
    recipe
        Read strokes from a recipe (JSON). They are applied before those of the command line, which are in pixels of
        the size that the recipe names, if it names one.
    border
        Width of the band along the edges in which movement fades to 0, so that the edges stay in place. auto
        (default): a tenth of each side. N or N,N: in pixels; N,N,N: in a video with frames, in a volume in
        millimetres. none: the edges move too.
    border_profile
        How movement fades towards the border: quartic (default), or sine as in the paper.
    freeze
        Mask of what the strokes after it move nothing of, those of a later --recipe too: a picture of the same size, in
        which white is frozen, black moves and grey moves in part; or a volume, in which all but 0 is frozen. FILE:LABEL
        freezes one label, a number. Frozen pixels stay as the strokes before it leave them. In a video, the mask holds
        for all frames. Given again further on, it takes the place of the one before (none: nothing is frozen).
    freeze_width
        Width over which movement fades to 0 beside what is frozen, and inside of a matte, in pixels, in a volume in
        millimetres (default: a 32nd of the shortest side). It must be at least 4 pixels.
    matte
        Picture, video or image sequence that multiplies strokes: white where they apply in full, black where they
        move nothing; its opacity, if it has some. Give it once for all strokes, or once for each (none: without).
    on_fold
        What to do with a stroke that would fold the picture or that the border holds back. flow (default): carry
        all of it out, in smaller steps. damp: weaken it. error: stop.
    amount
        How much of each stroke is carried out, from -100% (the opposite) to 200%: 30%, or 0.3. Each holds the same part
        of the picture as at 100%. Beyond 100%, as much as is possible without a fold, and it is said if that is less.
    strength
        The same for single strokes: give it once for all, or once for each.
    landmarks
        Landmarks of the faces of a picture: CSV with columns name, x and y, .pts, XML of dlib, JSON of MediaPipe; or a
        folder that has a file for each picture, with its stem; or a pattern, in which * stands for that. By default,
        the file beside the picture, or those that are found, if supple[face] is installed.
    percent_of
        Two landmarks whose distance is 100%: left_eye:right_eye, say (default: the shortest side).
    mirror
        Make each stroke of the command line on the other side as well: of the line x = X, or of one through two points.
    fit
        How a recipe that was made for another size fits: pixels takes its numbers as they are; stretch scales width
        and height by factors of their own; inside keeps proportions, centred. One of the same proportions is scaled
        without asking. And how a straightened picture is framed: crop (default), the largest frame of its proportions
        without empty corners; pad, all of it; keep, its own frame. What is empty is transparent, or --fill.
    rotate
        Turn the picture by degrees, clockwise, after all strokes and maps, in the same resampling.
    shear
        Lean verticals by degrees, and, with a second number, horizontals.
    keystone
        Four points that shall be the corners of an upright rectangle: top left, top right, bottom right, bottom left.
    scale_to
        Width of the result in pixels, or its width and height, to whose proportions it is then cropped or padded.
    """

    grab: Annotated[
        list[str], Parameter(allow_leading_hyphen=True, metavar="X,Y[,T|Z]:X,Y[,T|Z]", show_default=False)
    ] = ()  # type: ignore[assignment]
    twist: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar=_TWIST, show_default=False)] = ()  # type: ignore[assignment]
    scale: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar=_SCALE, show_default=False)] = ()  # type: ignore[assignment]
    pinch: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar=_PINCH, show_default=False)] = ()  # type: ignore[assignment]
    pull: Annotated[list[str], Parameter(metavar="FROM:TO", show_default=False)] = ()  # type: ignore[assignment]
    push: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar=_PUSH, show_default=False)] = ()  # type: ignore[assignment]
    radius: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="R", show_default=False)] = ()  # type: ignore[assignment]
    poisson: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="N", show_default=False)] = ()  # type: ignore[assignment]
    scales: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="1|2|3", show_default=False)] = ()  # type: ignore[assignment]
    reach: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="R|none", show_default=False)] = ()  # type: ignore[assignment]
    time_radius: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="F", show_default=False)] = ()  # type: ignore[assignment]
    flat: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="P", show_default=False)] = ()  # type: ignore[assignment]
    recipe: Annotated[str | None, Parameter(metavar="FILE")] = None
    border: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="auto|none|N|N,N")] = None
    border_profile: Annotated[
        Literal["quartic", "sine"] | None, Parameter(metavar="quartic|sine", show_choices=False)
    ] = None
    freeze: Annotated[list[str], Parameter(metavar="FILE[:LABEL]|none", show_default=False)] = ()  # type: ignore[assignment]
    freeze_width: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="N")] = None
    matte: Annotated[list[str], Parameter(metavar="FILE|none", show_default=False)] = ()  # type: ignore[assignment]
    on_fold: Annotated[
        Literal["damp", "flow", "error"] | None, Parameter(metavar="flow|damp|error", show_choices=False)
    ] = None
    amount: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="PART")] = None
    strength: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="PART", show_default=False)] = ()  # type: ignore[assignment]
    landmarks: Annotated[str | None, Parameter(metavar="FILE|DIR")] = None
    percent_of: Annotated[str | None, Parameter(metavar="NAME:NAME")] = None
    mirror: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="X|X,Y:X,Y")] = None
    fit: Annotated[
        list[Literal["pixels", "stretch", "inside", "crop", "pad", "keep"]],
        Parameter(metavar="pixels|stretch|inside|crop|pad|keep", show_choices=False, show_default=False),
    ] = ()  # type: ignore[assignment]
    rotate: Annotated[float | None, number("a number of degrees", "DEG", group=STRAIGHTEN)] = None
    shear: Annotated[str | None, Parameter(group=STRAIGHTEN, allow_leading_hyphen=True, metavar="DEG[,DEG]")] = None
    keystone: Annotated[str | None, Parameter(group=STRAIGHTEN, allow_leading_hyphen=True, metavar=_KEYSTONE)] = None
    scale_to: Annotated[str | None, Parameter(group=STRAIGHTEN, allow_leading_hyphen=True, metavar="W[,H]")] = None

    @property
    def given(self) -> dict[str, list[str]]:
        """The values of the options that are strokes, or freezes among them."""
        return {option: list(getattr(self, option[2:])) for option in (*BRUSHES, "--freeze")}

    def parts(self, arguments: Sequence[str]) -> list[int]:
        """Of each stroke and freeze given, how many it makes: two of a mirrored one, none of the recipe's mask."""
        sizes, freezes = (iter(getattr(self, name, ())) for name in ("_sizes", "_freezes"))
        found, first = list[int](), True
        for option, _ in in_order(arguments, self.given):
            if option == "--freeze":
                found.append(next(freezes, int(not first)))
            elif option in BRUSHES:
                found.append(next(sizes, 1))
            first = first and option not in (*BRUSHES, "--recipe")
        return found

    @property
    def count(self) -> int:
        """The number of strokes given, and of freezes that are not before all; without those of the recipe."""
        return sum(size > 0 for size in self.parts(self._arguments))

    @cached_property
    def _arguments(self) -> tuple[str, ...]:
        return current().arguments  # which threads of several pictures do not know

    @property
    def relative(self) -> bool:
        """Whether the strokes of `to_recipe` are others in each picture: at landmarks, or of lengths in percent."""
        return getattr(self, "_relative", False)

    @property
    def any(self) -> bool:
        """Return whether there is anything to do."""
        return self.bends or self.straightens

    @property
    def bends(self) -> bool:
        """Return whether there are strokes, or a recipe."""
        return self.recipe is not None or any(getattr(self, option[2:]) for option in BRUSHES)

    @property
    def straightens(self) -> bool:
        """Return whether the picture is straightened."""
        return any(value is not None for value in (self.rotate, self.shear, self.keystone, self.scale_to))

    def refuse_alone(self) -> None:
        """Raise SuppleError for what is said of strokes where there are none, and none are needed."""
        loose = next((name for name in (*_OF_EACH, *_OF_ALL) if getattr(self, name)), None)
        if loose is not None and not self.bends:
            option = f"--{loose.replace('_', '-')}"
            raise SuppleError(f"{option} is for strokes, and there are none: {_ONE_OF}, a --recipe, or leave it out")

    def to_fit(self) -> "Fit | None":
        """How a recipe fits another size; refuse what is said of a recipe where there is none."""
        found: list[Fit] = [fit for fit in self.fit if fit not in FRAMES]  # type: ignore[misc]
        if len(found) > 1 or len(self.fit) - len(found) > 1:
            raise SuppleError(f"--fit is given as {' and '.join(self.fit)}: leave one out")
        if found and self.recipe is None:
            raise SuppleError("--fit is for a recipe that was made for another size: give a --recipe, or leave it out")
        if self.amount is not None and not (self.count or self.recipe):
            raise SuppleError(f"--amount is for strokes, and there are none: {_ONE_OF}, a --recipe, or leave it out")
        return found[0] if found else None

    def _straighten(self, known: "Straighten | None") -> "Straighten | None":
        """Return how the picture is straightened, by the recipe, and in its place by the options given."""
        from supple.space.straighten import Straighten

        framed = [fit for fit in self.fit if fit in FRAMES]
        if framed and known is None and not self.straightens:
            raise SuppleError(
                f"--fit {framed[0]} is for a picture that is straightened: give --rotate, --shear, --keystone or "
                "--scale-to, or leave it out"
            )
        given: dict[str, Any] = {"rotate": self.rotate, "fit": framed[0] if framed else None}
        if self.shear is not None:
            wanted = "one number of degrees or two"
            given["shear"] = [parse_number("--shear", part, wanted) for part in self.shear.split(",")]
        if self.scale_to is not None:
            wanted = "a width, or a width and a height, in whole pixels (1920 or 1920,1080, say)"
            given["scale_to"] = [parse_integer("--scale-to", part, wanted) for part in self.scale_to.split(",")]
        if self.keystone is not None:
            wanted = f"{_KEYSTONE}, the corners top left, top right, bottom right, bottom left"
            points = [point.split(",") for point in self.keystone.split(":")]
            if [len(point) for point in points] != [2] * 4:
                raise SuppleError(f"--keystone must be {wanted}, found {self.keystone!r}")
            given["keystone"] = [[parse_number("--keystone", x, wanted) for x in point] for point in points]
        given = {name: value for name, value in given.items() if value is not None}
        return replace(known or Straighten(), **given) if given else known

    def to_recipe(self, *, medium: "Callable[[Recipe], Medium] | None" = None, **how: Any) -> "Recipe":
        """Read the recipe file, if one is given, and add the strokes, as they are in a picture.

        ``medium`` returns that, from strokes with as many numbers; without it, landmarks are anywhere, and 100% is any
        length: if there are such (``relative``), the recipe says only how many strokes there are. More is passed on to
        `strokes_in`.
        """
        from supple.files.places import Places

        places = Places(None, self.landmarks, self.percent_of)
        recipe = self.strokes_in(places, **how)
        self._relative = places.used
        if self.landmarks is not None and not places.used:
            raise SuppleError("--landmarks is for landmarks of strokes, and there are none: leave it out")
        if self.percent_of is not None and not places.scaled:
            raise SuppleError("--percent-of is for percentages of strokes, and there are none: leave it out")
        if not places.used or medium is None:
            return recipe
        return self.strokes_in(Places(medium(recipe), self.landmarks, self.percent_of), **how)

    def strokes_in(
        self,
        places: "Places",
        *,
        world: bool = False,
        empty: bool = False,
        others: str = "",
        place: Place = lambda: None,
        convention: str | None = None,
        ordered: Mapping[str, Sequence[str]] | None = None,
        frames: Frames | None = None,
        window: bool = False,
    ) -> "Recipe":
        """Return the recipe, in which landmarks and percentages are those of ``places``.

        With ``world``, strokes are in millimetres. With ``empty``, there is something to do without strokes; ``others``
        are the options that would do, too. ``place`` returns the convention of the volume that the strokes are for, as
        `Geometry` has it; None without one. ``convention`` is that of tables of points that do not say it; instead,
        ``ordered`` has the values of --convention, each of which is about what stands before it, and of the other
        options that it may be about. ``frames`` is how the frames of a clip are typed. In a ``window``, strokes may
        follow, so that a freeze may be the last one.
        """
        from supple.strokes import Recipe

        found = self._mirrored(self._strokes(places, world, place, convention, ordered, frames), places)
        strokes = [one.stroke for one in found]
        space = next((one.space for one in found if one.space is not None), None)
        if not strokes and self.recipe is None and not (empty or self.straightens):
            raise SuppleError(f"nothing to do: give --grab X,Y:X,Y --radius R, {others or 'or '}--recipe FILE")
        if self.straightens and not empty:
            self.refuse_alone()
        if self.recipe is None:
            made = Recipe()
        else:
            from supple.files.recipes import read_recipe

            made = read_recipe(self.recipe, frames=None if frames is None else frames.read, resolve=places.resolve)
            if places.used and places.medium is not None and made.size is not None:
                grid = places.medium.grid
                if grid is None or made.size != grid.sizes:  # by which all would be scaled
                    raise SuppleError(
                        f"{self.recipe} was made for another size than {places.medium.name}, for which landmarks and "
                        "percentages beside it are: leave it out, or them"
                    )
            if strokes and made.is_world and not world and space is None:
                option = next(option for option, values in self.given.items() if values)
                raise SuppleError(
                    f"{self.recipe} is in {made.space} millimetres, and {option} in voxels: give --world if it is in "
                    "millimetres too"
                )
            if world and made.space == "pixels":
                raise SuppleError(f"--world is for points in millimetres, and {self.recipe} is in pixels: leave it out")
        if space is not None:
            if made.strokes and not made.is_world:
                raise SuppleError(f"--pull is in {space} millimetres, and {self.recipe} is in {made.space or 'pixels'}")
            known = place() if world else None
            space = made.space if made.strokes else known if known in ("LPS", "RAS") else space  # type: ignore[assignment]
            strokes = [one.in_space(space) for one in found]
        own = len(made.strokes)
        made = replace(made, strokes=(*made.strokes, *strokes), space=space or made.space)
        if self.border is not None:
            made = replace(made, border=_border(self.border))
        if self.amount is not None:
            made = replace(made, amount=_part("--amount", self.amount))
        if self.freeze:
            made = self._frozen(made, own, window)
        elif self.freeze_width is not None and not self.matte:
            raise SuppleError("--freeze-width is for a freeze mask, and there is none: give --freeze, or leave it out")
        if self.border_profile is not None:
            made = replace(made, border_profile=self.border_profile)
        made = replace(made, straighten=self._straighten(made.straighten))
        return made if self.on_fold is None else replace(made, on_fold=self.on_fold)

    def _frozen(self, recipe: "Recipe", own: int, last: bool) -> "Recipe":
        """Return the recipe with the freezes among its strokes, of which the first ``own`` are those of the file.

        ``last`` says whether one may stand after all strokes.
        """
        from supple.strokes import Stroke, last_freeze

        strokes, place, mask = [*recipe.strokes], 0, recipe.freeze
        sizes, self._freezes = iter(getattr(self, "_sizes", ())), list[int]()
        for option, text in in_order(self._arguments, self.given):
            if option in BRUSHES:
                place = max(place, own + len(strokes) - len(recipe.strokes)) + next(sizes)
            elif option == "--recipe":
                place = max(place, own + len(strokes) - len(recipe.strokes))
                mask = last_freeze(strokes[:own]) or mask
            elif option == "--freeze":
                if text == "none" and mask is None:
                    raise SuppleError("--freeze none thaws what was frozen before it, and nothing was: leave it out")
                mask = mask.freed if text == "none" and mask is not None else _freeze(text, self.freeze_width)
                if place == 0:
                    recipe = replace(recipe, freeze=None if text == "none" else mask)
                    self._freezes.append(0)
                    continue
                if place == len(strokes) and not last:
                    first = ", and before --recipe for its strokes" if own else ""
                    raise SuppleError(
                        f"--freeze {text} stands after all strokes, and holds none: give it before those that shall "
                        f"move nothing there{first}"
                    )
                strokes.insert(place, Stroke.freeze(mask, ndim=strokes[0].ndim))
                self._freezes.append(1)
                place += 1
        return replace(recipe, strokes=tuple(strokes))

    def _strokes(
        self,
        places: "Places",
        world: bool,
        place: Place,
        convention: str | None,
        others: Mapping[str, Sequence[str]] | None,
        frames: Frames | None,
    ) -> "list[_Given]":
        """Return the strokes, in order."""
        from supple.strokes import REACH

        if not any(getattr(self, option[2:]) for option in BRUSHES):
            loose = [name for name in _OF_EACH if getattr(self, name)]
            if loose:
                option = f"--{loose[0].replace('_', '-')}"
                raise SuppleError(f"{option} is for strokes given beside it: {_ONE_OF}, or leave it out")
            return []
        ordered = in_order(self._arguments, {**self.given, **(others or {})})
        found = [one for one in ordered if one[0] in BRUSHES]
        asked = iter([convention] * len(self.pull) if others is None else _conventions(ordered))
        if not self.radius:
            raise SuppleError(f"{found[0][0]} needs a --radius: how far it is felt, in pixels or millimetres")
        count = len(found)
        wanted = "a number of pixels or millimetres above 0, or a percentage"
        if negative := [text for text in self.radius if text.strip().startswith("-")]:
            raise SuppleError(f"--radius must be {wanted}, found {negative[0]!r}")
        lengths = [repr(places.length("--radius", text, wanted)) for text in self.radius]
        radii = _spread("--radius", lengths, count, wanted)
        ratios: list[float | None] = [None] * count
        if self.poisson:
            ratios = [*_spread("--poisson", self.poisson, count, "a number up to 0.5, or -inf")]
        scales = iter(_spread("--scales", self.scales, len(self.grab), "1, 2 or 3", "grab") or [1] * len(self.grab))
        reaches: list[float | None] = [REACH] * count
        if self.reach:
            texts = ["inf" if x.strip().lower() == "none" else x for x in self.reach]
            read = _spread("--reach", texts, count, "a number of radii from 1, or none")
            reaches = [None if x == math.inf else x for x in read]
        times: list[float | None] = [None] * count
        if self.time_radius:
            times = [*_spread("--time-radius", self.time_radius, count, "a number of frames above 0")]
        flats = iter(_spread("--flat", self.flat, len(self.grab), _FLAT, "grab") or [0.0] * len(self.grab))
        parts = [_part("--strength", text) for text in self.strength] or [1.0]
        if len(parts) not in (1, count):
            strokes = f"{count} strokes" if count != 1 else "one stroke"
            raise SuppleError(f"--strength is given {len(parts)} times for {strokes}: give it once, or for each")
        mattes = self._mattes(count)
        made: list[_Given] = []
        for i, (option, text) in enumerate(found):
            brush = {"radius": radii[i], "poisson": ratios[i], "reach": reaches[i], "time_radius": times[i]}
            if option == "--pull":
                stroke, space = _pull(text, next(asked), place, world, brush, places)
            else:
                scale, flat = (next(scales), next(flats)) if option == "--grab" else (1, 0.0)
                stroke = _stroke(option, text, frames, places, scales=scale, flat=flat, **brush)
                space = None
            if made and made[0].stroke.ndim != stroke.ndim:
                first = f"{made[0].told} of {made[0].stroke.ndim}"
                raise SuppleError(
                    f"{option} {text} has points of {stroke.ndim} numbers, and {first}: give all strokes as many"
                )
            stroke = replace(stroke, matte=mattes[i], strength=parts[i % len(parts)])
            made.append(_Given(f"{option} {text}", stroke, space))
        placed = next((one for one in made if one.space is not None), None)
        other = next((one for one in made if one.space is None), None)
        if placed is not None and other is not None and not world:
            raise SuppleError(
                f"{placed.told} is in millimetres, and {other.told} is in voxels: give all points in millimetres, and "
                "--world"
            )
        return made

    def _mirrored(self, found: "list[_Given]", places: "Places") -> "list[_Given]":
        """Return strokes with their mirror images."""
        self._sizes = [1] * len(found)
        if self.mirror is None:
            return found
        wanted = "X, a column of pixels, or X,Y:X,Y, two points of a line (256 or 250,0:262,511, say)"
        plain = places.plain("--mirror", self.mirror)
        ends = [[parse_number("--mirror", x, wanted) for x in end.split(",")] for end in plain.split(":")]
        x, y, a, b = (
            (*ends[0], 0.0, *ends[0], 1.0) if [*map(len, ends)] == [1] else (*chain(*ends), *[math.nan] * 4)[:4]
        )
        if [*map(len, ends)] not in ([1], [2, 2]) or (x, y) == (a, b) or not math.isfinite(x + y + a + b):
            raise SuppleError(f"--mirror must be {wanted}, found {self.mirror!r}")
        more = (0.0,) * (found[0].stroke.ndim - 2)
        made: list[list[_Given]] = []
        for one in found:
            if one.stroke.matte is not None and x != a and y != b:
                raise SuppleError(
                    f"--mirror must be upright or level for a stroke with a --matte, which is mirrored too, found "
                    f"{self.mirror!r}"
                )
            try:
                both = one.stroke.symmetric((x, y, *more), (b - y, x - a, *more))
            except SuppleError as error:
                raise SuppleError(f"{one.told}: {error}") from None
            if len(both) == 1 and both[0].is_still and not one.stroke.is_still:
                raise SuppleError(
                    f"{one.told} starts on the line of --mirror {self.mirror}, and its mirror image drags it back: "
                    "drag it along the line, or begin beside it"
                )
            made.append([replace(one, stroke=stroke) for stroke in both])
        self._sizes = list(map(len, made))
        return [*chain(*made)]

    def _mattes(self, count: int) -> "list[Freeze | None]":
        """Return the matte of each stroke; a file is read once."""
        if len(self.matte) not in (0, 1, count):
            raise SuppleError(
                f"--matte is given {len(self.matte)} times for {count} strokes: give it once, or for each"
            )
        from supple.files.freezing import read_matte

        width = _width(self.freeze_width)
        known = {path: None if path == "none" else read_matte(path, width=width) for path in self.matte}
        return [known[path] for path in self.matte] * (count if len(self.matte) == 1 else 1) or [None] * count


@dataclass(frozen=True)
class _Given:
    """A stroke of the command line, and its space if it says by itself that it is in millimetres."""

    told: str
    stroke: "Stroke"
    space: "CoordinateSpace | None"

    def in_space(self, space: "CoordinateSpace | None") -> "Stroke":
        """Return the stroke in LPS or RAS."""
        if self.space in (None, space):
            return self.stroke

        def turned(v: tuple[float, ...]) -> tuple[float, ...]:
            return (-v[0], -v[1], v[2])

        return self.stroke.mapped(turned, turned)


def _conventions(found: Sequence[tuple[str, str]]) -> list[str | None]:
    """Return the --convention of each --pull: the one after it, unless it is about a --field or an --affine between."""
    made: list[str | None] = []
    about = False
    for option, value in found:
        if option == "--pull":
            made.append(None)
            about = True
        elif option in ("--field", "--affine"):
            about = False
        elif option == "--convention" and about:
            if made[-1] is not None:
                raise SuppleError("a --pull has two --convention: leave out one")
            if value.lower() not in COORDINATES:
                raise SuppleError(f"--convention of a --pull must be LPS, RAS or index, found {value!r}")
            made[-1] = COORDINATES[value.lower()]
    return made


def _pull(
    text: str, convention: str | None, place: Place, world: bool, brush: dict[str, float | None], places: "Places"
) -> "tuple[Stroke, CoordinateSpace | None]":
    """Read a pull from two files, named with a colon between them."""
    from supple.files.landmarks import read_pull

    ends = [i for i, c in enumerate(text) if c == ":"]
    names = [(text[:i], text[i + 1 :]) for i in ends]
    both = [pair for pair in names if all(map(os.path.exists, pair))] or names
    if not both or not all(both[-1]):
        raise SuppleError(f"--pull must be FROM:TO, two files of points (before.csv:after.csv, say), found {text!r}")
    try:
        if (stroke := places.pull(*both[-1], brush)) is not None:
            return stroke, None
        return read_pull(*both[-1], convention=convention, place=place(), world=world, **brush)  # type: ignore[arg-type]
    except SuppleError as error:
        raise SuppleError(f"--pull {text}: {error}") from None


def _stroke(
    option: str,
    text: str,
    frames: Frames | None,
    places: "Places",
    *,
    scales: float,
    flat: float,
    **brush: float | None,
) -> "Stroke":
    """Read a stroke from the command line."""
    from supple.strokes import Stroke

    wrong = SuppleError(f"{option} must be {_WANTED[option]}, found {text!r}")
    try:
        plain = places.plain(option, text)
        plain = plain if frames is None else frames.plain(option, plain)
        at, *rest = [[float(x) for x in part.split(",")] for part in plain.split(":")]
        if frames is not None and frames.first is not None and len(at) == 3:
            for point in (at, *rest) if option == "--grab" else (at,):
                point[2:] = [t - frames.first for t in point[2:]]
    except SuppleError:
        raise
    except ValueError:
        raise wrong from None
    parts = [len(part) for part in (at, *rest)]
    n = len(at)
    shapes = {
        "--grab": [[n] * max(2, len(parts))],
        "--twist": [[n, 1], [3, 1, 3]],
        "--scale": [[n, 1]],
        "--pinch": [[n, 1], [n, 1, n]],
        "--push": [[2] * max(2, len(parts) - 1) + [1]],
    }
    if option == "--twist" and n == 2 and len(parts) == 3:
        raise SuppleError(f"--twist {text}: a twist in a picture has no axis: leave it out (X,Y:ANGLE)")
    points = (at, *rest) if option in ("--grab", "--push") else (at,)
    if n not in (2, 3) or parts not in shapes[option] or not all(math.isfinite(x) for point in points for x in point):
        raise wrong
    known = {**brush, "scales": int(scales) if float(scales).is_integer() else scales}
    try:
        if option == "--grab":
            return Stroke.grab(at, path=rest, flat=flat, **known)  # type: ignore[arg-type]
        if option == "--push":
            if brush.pop("time_radius") is not None:
                raise SuppleError("--time-radius is for strokes with a time, and a push has none: leave it out")
            return Stroke.push([at, *rest[:-1]], by=rest[-1][0], **brush)  # type: ignore[arg-type]
        amount = {"angle" if option == "--twist" else "factor": rest[0][0]}
        axis = tuple(rest[1]) if len(rest) > 1 else None
        return Stroke(brush=option[2:], at=tuple(at), axis=axis, **amount, **known)  # type: ignore[arg-type]
    except SuppleError as error:
        raise SuppleError(f"{option} {text}: {error}") from None


def _border(text: str) -> "Border":
    """Read the border's width from the command line."""
    word = text.strip().lower()
    if word in ("auto", "none"):
        return "auto" if word == "auto" else None
    wanted = "auto, none, a width, or one for each axis"
    if not {"auto", "none"}.isdisjoint(part.strip().lower() for part in text.split(",")):
        raise SuppleError(f"--border must be {wanted}, found {text!r}")
    widths = tuple(parse_number("--border", part, wanted) for part in text.split(","))
    return widths[0] if len(widths) == 1 else widths


def _width(text: str | None) -> float | None:
    return None if text is None else parse_number("--freeze-width", text, "a number of pixels or millimetres above 0")


def _freeze(text: str, width: str | None) -> "Freeze":
    """Read the freeze mask that the command line names."""
    from supple.files.freezing import read_freeze

    name, colon, last = text.rpartition(":")
    labelled = (
        bool(colon and name) and not os.path.exists(text) and (last.lstrip("-").isdigit() or os.path.exists(name))
    )
    if labelled and not last.lstrip("-").isdigit():
        raise SuppleError(f"--freeze FILE:LABEL needs the number of a label ({shown(name)}:3, say), found {last!r}")
    path, label = (name, int(last)) if labelled else (text, None)
    try:
        return read_freeze(path, label=label, width=_width(width))
    except SuppleError as error:
        raise SuppleError(str(error).replace("the freeze mask's width", "--freeze-width")) from None


def _part(option: str, text: str) -> float:
    """Read a part from the command line, in percent or as a number."""
    from supple.strokes import LEAST, MOST

    wanted = "a part of the strokes, from -100% to 200%, or from -1 to 2"
    percent = text.strip().endswith("%")
    part = parse_number(option, text.strip().removesuffix("%"), wanted) / (100 if percent else 1)
    if not LEAST <= part <= MOST:
        raise SuppleError(f"{option} must be {wanted}, found {text!r}")
    return part


def _spread(name: str, given: Sequence[str], count: int, wanted: str, what: str = "stroke") -> list[float]:
    if given and not count:
        raise SuppleError(f"{name} is for a --{what}, and there is none: leave it out")
    if len(given) not in (0, 1, count):
        many = f"{count} {what}s" if count > 1 else f"one {what}"
        raise SuppleError(f"{name} is given {len(given)} times for {many}: give it once, or once for each")
    values = [parse_number(name, text, wanted) for text in given]
    return values * count if len(values) == 1 else values
