"""Options for strokes, and their conversion, with the maps among them, to a recipe, in the order given."""

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from cyclopts import Group, Parameter

from supple.cli.options import (
    Frames,
    Texts,
    convention_of,
    number,
    options_of,
    parse_integer,
    parse_number,
    parse_numbers,
    parse_percent,
    parse_sizes,
    read,
    text,
    words,
)
from supple.cli.options_maps import MapOptions, Maps
from supple.errors import SuppleError, shown

if TYPE_CHECKING:
    from supple.files.options import VolumeOptions
    from supple.files.places import Places
    from supple.space.domain import Border
    from supple.space.freezing import Freeze
    from supple.space.straighten import Straighten
    from supple.strokes import CoordinateSpace, Fit, Recipe, Stroke

Value = TypeVar("Value")

STROKES = Group("Strokes", sort_key=1)
STRAIGHTEN = Group("Straighten pictures", sort_key=1.2)

BRUSHES = ("--grab", "--twist", "--scale", "--pinch", "--pull", "--push")
"""The options that add a stroke."""

FRAMES = ("crop", "pad", "keep")
_ONE_OF = "give --grab, --twist, --scale, --pinch, --pull or --push"
# Options of each stroke, and of all strokes together.
_OF_EACH = ("radius", "poisson", "scales", "reach", "time_radius", "flat", "strength", "matte", "mirror")
_OF_ALL = ("border", "border_profile", "freeze", "freeze_width", "on_fold", "amount")
_WIDTH = "a number of pixels or millimetres above 0"
_LENGTH = f"{_WIDTH}, or a percentage"
_TURN = "a number of degrees from -360 to 360"
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
    """Return the options of a command line whose order matters, as (option, value), in order.

    ``given`` has the parsed values of each of these options: SuppleError if they differ from those in ``arguments``.
    """
    found, rest = [], iter(arguments)
    for argument in rest:
        if argument == "--":
            break
        name, joined, value = argument.partition("=")
        if name in given or name == "--inverse":
            found.append((name, value if joined or name == "--inverse" else next(rest, "")))
    for name, values in given.items():
        if [value for option, value in found if option == name] != list(values):
            raise SuppleError(f"the place of {name} among the options is in doubt: write {name} VALUE by itself")
    return found


def _part(option: str, text: str) -> float:
    """Parse the strength of strokes, a number or a percentage."""
    from supple.strokes import LEAST, MOST

    return parse_percent(option, text, "a part of the strokes, from -100% to 200%, or from -1 to 2", LEAST, MOST, 100)


@dataclass(frozen=True)
class Edits:
    """The edits of a command line."""

    recipe: "Recipe"  # the strokes of the recipe file, and after them those of the command line
    maps: Maps  # the fields and affine maps among them
    own: tuple[int, ...] = ()  # the places in the recipe of the command line's strokes, without freezes
    relative: bool = False  # whether strokes are others in each picture: at landmarks, or of lengths in percent


_LANDMARKS = """Landmarks of the faces of a picture: CSV with columns name, x and y, .pts, XML of dlib, JSON of
MediaPipe; or a folder that has a file for each picture, with its stem; or a pattern, in which * stands for that. By
default, the file beside the picture, or those that are found, if supple[face] is installed."""
Landmarks = Annotated[str | None, Parameter(metavar="FILE|DIR", help=_LANDMARKS)]


@options_of(STROKES)
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

    grab: Annotated[Texts, text("X,Y[,T|Z]:X,Y[,T|Z]")] = ()
    twist: Annotated[Texts, text(_TWIST)] = ()
    scale: Annotated[Texts, text(_SCALE)] = ()
    pinch: Annotated[Texts, text(_PINCH)] = ()
    pull: Annotated[Texts, Parameter(metavar="FROM:TO")] = ()
    push: Annotated[Texts, text(_PUSH)] = ()
    radius: Annotated[Texts, text("R")] = ()
    poisson: Annotated[Texts, text("N")] = ()
    scales: Annotated[Texts, text("1|2|3")] = ()
    reach: Annotated[Texts, text("R|none")] = ()
    time_radius: Annotated[Texts, text("F")] = ()
    flat: Annotated[Texts, text("P")] = ()
    recipe: Annotated[str | None, Parameter(metavar="FILE")] = None
    border: Annotated[str | None, text("auto|none|N|N,N")] = None
    border_profile: Annotated[Literal["quartic", "sine"] | None, words("quartic|sine")] = None
    freeze: Annotated[Texts, Parameter(metavar="FILE[:LABEL]|none")] = ()
    freeze_width: Annotated[float | None, number(_WIDTH, "N", (5e-324, 1e308))] = None
    matte: Annotated[Texts, Parameter(metavar="FILE|none")] = ()
    on_fold: Annotated[Literal["damp", "flow", "error"] | None, words("flow|damp|error")] = None
    amount: Annotated[float | None, read(_part, "PART")] = None
    strength: Annotated[Texts, text("PART")] = ()
    landmarks: Landmarks = None
    percent_of: Annotated[str | None, Parameter(metavar="NAME:NAME")] = None
    mirror: Annotated[str | None, text("X|X,Y:X,Y")] = None
    fit: Annotated[
        tuple[Literal["pixels", "stretch", "inside", "crop", "pad", "keep"], ...],
        words("pixels|stretch|inside|crop|pad|keep"),
    ] = ()
    rotate: Annotated[float | None, number(_TURN, "DEG", (-360, 360), group=STRAIGHTEN)] = None
    shear: Annotated[str | None, text("DEG[,DEG]", group=STRAIGHTEN)] = None
    keystone: Annotated[str | None, text(_KEYSTONE, group=STRAIGHTEN)] = None
    scale_to: Annotated[str | None, text("W[,H]", group=STRAIGHTEN)] = None

    @property
    def given(self) -> dict[str, Sequence[str]]:
        """The values of the options that are strokes, or whose order among strokes matters."""
        options = {option: getattr(self, option[2:]) for option in (*BRUSHES, "--freeze")}
        return {**options, "--recipe": () if self.recipe is None else (self.recipe,)}

    @property
    def any(self) -> bool:
        """Return whether these options have any effect."""
        return self.bends or self.straightens

    @property
    def bends(self) -> bool:
        """Return whether there are strokes, or a recipe."""
        return self.recipe is not None or any(getattr(self, option[2:]) for option in BRUSHES)

    @property
    def straightens(self) -> bool:
        """Return whether the picture is straightened."""
        return any(value is not None for value in (self.rotate, self.shear, self.keystone, self.scale_to))

    def to_fit(self) -> "Fit | None":
        """Return how a recipe is fitted to another size; SuppleError if --fit is given twice, or without a recipe."""
        found: list[Fit] = [fit for fit in self.fit if fit not in FRAMES]  # type: ignore[misc]
        if len(found) > 1 or len(self.fit) - len(found) > 1:
            raise SuppleError(f"--fit is given as {' and '.join(self.fit)}: leave one out")
        if found and self.recipe is None:
            raise SuppleError("--fit is for a recipe that was made for another size: give a --recipe, or leave it out")
        return found[0] if found else None

    def _straighten(self, known: "Straighten | None") -> "Straighten | None":
        """Return the straightening of the picture: the recipe's, with the given options in place of its values."""
        from supple.space.straighten import Straighten

        framed = [fit for fit in self.fit if fit in FRAMES]
        if framed and known is None and not self.straightens:
            raise SuppleError(
                f"--fit {framed[0]} is for a picture that is straightened: give --rotate, --shear, --keystone or "
                "--scale-to, or leave it out"
            )
        given: dict[str, Any] = {"rotate": self.rotate, "fit": framed[0] if framed else None}
        if self.shear is not None:
            given["shear"] = parse_numbers("--shear", self.shear, "one number of degrees or two", (1, 2))
        if self.scale_to is not None:
            wanted = "a width, or a width and a height, in whole pixels (1920, 1920,1080 or 1920x1080, say)"
            given["scale_to"] = parse_sizes("--scale-to", self.scale_to, wanted, (1, 2))
        if self.keystone is not None:
            wanted = f"{_KEYSTONE}, the corners top left, top right, bottom right, bottom left"
            corners = self.keystone.split(":")
            given["keystone"] = [parse_numbers("--keystone", x, wanted, (2,), typed=self.keystone) for x in corners]
            if len(given["keystone"]) != 4:
                raise SuppleError(f"--keystone must be {wanted}, found {self.keystone!r}")
        given = {name: value for name, value in given.items() if value is not None}
        return replace(known or Straighten(), **given) if given else known

    def read(
        self,
        maps: MapOptions,
        reading: "VolumeOptions",
        arguments: Sequence[str],
        source: str | os.PathLike[str],
        *,
        target: str | os.PathLike[str] | None = "",
        **how: Any,
    ) -> Edits:
        """Return the edits of a source by a command line, with landmarks and percentages of the source resolved.

        A ``target`` of None means several sources: landmarks and percentages are then placeholders, so that only the
        number of strokes is meaningful in ``relative`` edits. ``how`` is passed on to `edits_in`.
        """
        from supple.files.jobs import Job
        from supple.files.places import Places

        places = Places(None, self.landmarks, self.percent_of)
        edits = self.edits_in(places, maps, reading, arguments, source, **how)
        if self.landmarks is not None and not places.used:
            raise SuppleError("--landmarks is for landmarks of strokes, and there are none: leave it out")
        if self.percent_of is not None and not places.scaled:
            raise SuppleError("--percent-of is for percentages of strokes, and there are none: leave it out")
        if not places.used or target is None:
            return edits
        medium = Job(source, target, edits.recipe, volume=reading).medium  # depends on the points' axes
        places = Places(medium, self.landmarks, self.percent_of)
        return self.edits_in(places, maps, reading, arguments, source, **how)

    def edits_in(
        self,
        places: "Places",
        maps: MapOptions,
        reading: "VolumeOptions",
        arguments: Sequence[str],
        source: str | os.PathLike[str],
        *,
        reference: str | None = None,
        frames: Frames | None = None,
        empty: bool = False,
        window: bool = False,
        points: bool = False,
        back: bool = False,
    ) -> Edits:
        """Return the edits, with landmarks and percentages resolved by ``places``.

        ``reference`` is the image whose grid the output has; ``frames`` parses frames of a clip. ``empty`` allows that
        there are no strokes and maps. ``window`` allows a freeze at the end, as the window may add strokes. ``points``
        allows --convention for points of the command that are not strokes; ``back`` allows an --inverse before all
        maps, for points that are mapped back.
        """
        from supple.strokes import Recipe, Stroke, last_freeze

        found = in_order(arguments, {**self.given, **maps.given})
        place = convention_of(str(source), reading) if self.pull else None
        how = {"convention": maps.coordinates, "place": place, "world": reading.world}
        given = self._strokes(found, places, frames, how)
        made = Recipe() if self.recipe is None else self._read_recipe(places, frames, world=reading.world)
        self._check(given, made, reading, maps.coordinates is not None and not points)
        spaces, space = [one.space for one in given if one.space is not None], made.space
        if spaces and not made.strokes:
            space = place if reading.world and place in ("LPS", "RAS") else spaces[0]  # type: ignore[assignment]
        strokes, own, last = list[Stroke](), list[int](), ""
        before, each, mask, placed = made.strokes, iter(given), made.freeze, Maps(reference)
        for option, value in found:
            if before and (option == "--recipe" or option in BRUSHES):
                strokes, mask, before = [*strokes, *before], last_freeze(before) or mask, ()
            if option in BRUSHES:
                both = next(each).in_space(space)
                own += range(len(strokes), len(strokes) + len(both))
                strokes += both
                last = ""
            elif option == "--freeze":
                if value == "none" and mask is None:
                    raise SuppleError("--freeze none thaws what was frozen before it, and nothing was: leave it out")
                mask = mask.freed if value == "none" and mask is not None else _freeze(value, self.freeze_width)
                if strokes:
                    strokes.append(Stroke.freeze(mask, ndim=strokes[0].ndim))
                    last = value
                else:  # before all strokes
                    made = replace(made, freeze=None if value == "none" else mask)
            elif option != "--recipe":
                placed.add(option, value, len(strokes), back=back)
        if last and not window:
            raise SuppleError(
                f"--freeze {last} stands after all strokes, and holds none: give it before those that shall move "
                "nothing there, and before --recipe for its strokes"
            )
        if not (self.any or placed or empty or reference is not None):
            raise SuppleError(
                "nothing to do: give --grab X,Y:X,Y --radius R, --field FILE, --affine FILE or --recipe FILE"
            )
        made = replace(
            made,
            strokes=tuple(strokes),
            space=space,
            border=made.border if self.border is None else _border(self.border),
            border_profile=self.border_profile or made.border_profile,
            amount=made.amount if self.amount is None else self.amount,
            on_fold=self.on_fold or made.on_fold,
            straighten=self._straighten(made.straighten),
        )
        return Edits(made, placed, tuple(own), places.used)

    def _read_recipe(self, places: "Places", frames: Frames | None, *, world: bool) -> "Recipe":
        from supple.files.recipes import read_recipe

        assert self.recipe is not None
        made = read_recipe(self.recipe, frames=None if frames is None else frames.read, resolve=places.resolve)
        if places.used and places.medium is not None and made.size is not None:
            grid = places.medium.grid
            if grid is None or made.size != grid.sizes:  # all strokes would be scaled
                raise SuppleError(
                    f"{self.recipe} was made for another size than {places.medium.name}, for which landmarks and "
                    "percentages beside it are: leave it out, or them"
                )
        if world and made.space == "pixels":
            raise SuppleError(f"--world is for points in millimetres, and {self.recipe} is in pixels: leave it out")
        return made

    def _check(self, found: "Sequence[_Given]", made: "Recipe", reading: "VolumeOptions", convention: bool) -> None:
        """Raise SuppleError for strokes in voxels beside others in millimetres, and for options without effect."""
        if self.freeze_width is not None and not (self.freeze or self.matte):
            raise SuppleError("--freeze-width is for a freeze mask, and there is none: give --freeze, or leave it out")
        if convention and not self.pull:
            raise SuppleError("--convention of points is of tables of --pull, and there are none: leave it out")
        every = [*found]
        if made.strokes or made.is_world:
            every.append(_Given(self.recipe or "", made.strokes, made.space if made.is_world else None))
        placed = next((one for one in every if one.space is not None), None)
        other = next((one for one in every if one.space is None), None)
        if placed and other and (not reading.world or other.told == self.recipe):
            raise SuppleError(
                f"{placed.told} is in millimetres, and {other.told} is in voxels: give all points in millimetres, and "
                "--world"
            )

    def _strokes(
        self,
        found: Sequence[tuple[str, str]],
        places: "Places",
        frames: Frames | None,
        how: dict[str, Any],
    ) -> "list[_Given]":
        """Return the strokes of the command line, in order, with their mirror images; ``how`` is for `read_pull`."""
        from supple.strokes import REACH

        found = [one for one in found if one[0] in BRUSHES]
        names = () if found else _OF_EACH if self.bends else (*_OF_EACH, *_OF_ALL)
        if loose := next((name for name in names if getattr(self, name) not in (None, ())), None):
            given = "" if loose in _OF_EACH else ", a --recipe"
            option = f"--{loose.replace('_', '-')}"
            raise SuppleError(f"{option} is for strokes, and there are none: {_ONE_OF}{given}, or leave it out")

        @cache
        def matte(option: str, path: str) -> "Freeze | None":
            from supple.files.freezing import read_matte

            return None if path == "none" else read_matte(path, width=self.freeze_width)

        def radius(option: str, text: str) -> float:
            width = places.length(option, text, _LENGTH)
            if width <= 0:  # checked here, as the message for a percentage would be in pixels
                raise SuppleError(f"{option} must be {_LENGTH}, found {text!r}")
            return width

        count = len(found)
        reaches: list[float | None] = _spread("--reach", self.reach, count, _reach, REACH)
        brushes = zip(
            _spread("--radius", self.radius, count, radius, 1.0),  # missed below, when strokes have been read
            _spread("--poisson", self.poisson, count, _numbers("a number up to 0.5, or -inf"), None),
            reaches,
            _spread("--time-radius", self.time_radius, count, _numbers("a number of frames above 0"), None),
            _spread("--strength", self.strength, count, _part, 1.0),
            _spread("--matte", self.matte, count, matte, None),
            strict=True,
        )
        grabs = zip(
            _spread("--scales", self.scales, len(self.grab), partial(parse_integer, wanted="1, 2 or 3"), 1, "grab"),
            _spread("--flat", self.flat, len(self.grab), _numbers("a part of the radius from 0 to 0.9"), 0.0, "grab"),
            strict=True,
        )
        line = None if self.mirror is None else _line(self.mirror, places)
        made: list[_Given] = []
        for (option, value), (size, poisson, reach, time_radius, strength, weights) in zip(found, brushes, strict=True):
            told = f"{option} {value}"
            brush = {"radius": size, "poisson": poisson, "reach": reach, "time_radius": time_radius}
            space = None
            if option == "--pull":
                stroke, space = _pull(value, places, how, brush)
            else:
                if option == "--grab":
                    brush["scales"], brush["flat"] = next(grabs)
                stroke = _stroke(option, value, frames, places, brush)
            if made and made[0].ndim != stroke.ndim:
                first = f"{made[0].told} of {made[0].ndim}"
                raise SuppleError(f"{told} has points of {stroke.ndim} numbers, and {first}: give all strokes as many")
            stroke = replace(stroke, matte=weights, strength=strength)
            made.append(_Given(told, (stroke,) if line is None else self._mirrored(told, stroke, *line), space))
        if found and not self.radius:
            raise SuppleError(f"{found[0][0]} needs a --radius: how far it is felt, in pixels or millimetres")
        return made

    def _mirrored(self, told: str, stroke: "Stroke", x: float, y: float, a: float, b: float) -> "tuple[Stroke, ...]":
        """Return a stroke and its mirror image across the line from (x, y) to (a, b)."""
        more = (0.0,) * (stroke.ndim - 2)
        with _prefixed(told):
            both = stroke.symmetric((x, y, *more), (b - y, x - a, *more))
        if len(both) == 1 and both[0].is_still and not stroke.is_still:
            raise SuppleError(
                f"{told} starts on the line of --mirror {self.mirror}, and its mirror image drags it back: drag it "
                "along the line, or begin beside it"
            )
        return both


@dataclass(frozen=True)
class _Given:
    """The strokes of an option or a recipe, and their space if their file states that they are in millimetres."""

    told: str
    strokes: "tuple[Stroke, ...]"
    space: "CoordinateSpace | None" = None

    @property
    def ndim(self) -> int:
        return self.strokes[0].ndim

    def in_space(self, space: "CoordinateSpace | None") -> "tuple[Stroke, ...]":
        """Return the strokes, converted to LPS or RAS as ``space`` if they are in the other one."""
        if self.space in (None, space):
            return self.strokes

        def turned(v: tuple[float, ...]) -> tuple[float, ...]:
            return (-v[0], -v[1], v[2])

        return tuple(stroke.mapped(turned, turned) for stroke in self.strokes)


def _pull(
    text: str, places: "Places", how: dict[str, Any], brush: dict[str, Any]
) -> "tuple[Stroke, CoordinateSpace | None]":
    """Return the pull for two files, whose names are separated by a colon, and its space if it is in millimetres."""
    from supple.files.landmarks import read_pull

    ends = [i for i, c in enumerate(text) if c == ":"]
    names = [(text[:i], text[i + 1 :]) for i in ends]
    both = [pair for pair in names if all(map(os.path.exists, pair))] or names
    if not both or not all(both[-1]):
        raise SuppleError(f"--pull must be FROM:TO, two files of points (before.csv:after.csv, say), found {text!r}")
    with _prefixed(f"--pull {text}"):
        if (stroke := places.pull(*both[-1], brush)) is not None:
            return stroke, None
        before, after = both[-1]
        return read_pull(before, after, **how, **brush)


def _stroke(option: str, text: str, frames: Frames | None, places: "Places", brush: dict[str, Any]) -> "Stroke":
    """Return the stroke for an option and its text."""
    from supple.strokes import Stroke

    wrong = SuppleError(f"{option} must be {_WANTED[option]}, found {text!r}")
    plain = places.plain(option, text)
    plain = plain if frames is None else frames.plain(option, plain)
    try:
        at, *rest = [[float(x) for x in part.split(",")] for part in plain.split(":")]
    except ValueError:
        raise wrong from None
    n, parts = len(at), list(map(len, rest))
    shapes = {
        "--grab": [[n] * max(1, len(parts))],
        "--twist": [[1]] if n == 2 else [[1], [1, 3]],
        "--scale": [[1]],
        "--pinch": [[1], [1, n]],
        "--push": [[2] * max(1, len(parts) - 1) + [1]] if n == 2 else [],
    }
    points = {"--grab": (at, *rest), "--push": (at, *rest[:-1])}.get(option, (at,))
    if n not in (2, 3) or parts not in shapes[option] or not all(math.isfinite(x) for point in points for x in point):
        raise wrong
    if frames is not None and frames.first is not None and n == 3:
        for point in points:
            point[2] -= frames.first
    with _prefixed(f"{option} {text}"):
        if option == "--grab":
            return Stroke.grab(at, path=rest, **brush)
        if option == "--push":
            if brush.pop("time_radius") is not None:
                raise SuppleError("--time-radius is for strokes with a time, and a push has none: leave it out")
            return Stroke.push(points, by=rest[-1][0], **brush)
        amount = {"angle" if option == "--twist" else "factor": rest[0][0]}
        axis = tuple(rest[1]) if len(rest) > 1 else None
        return Stroke(brush=option[2:], at=tuple(at), axis=axis, **amount, **brush)  # type: ignore[arg-type]


@contextlib.contextmanager
def _prefixed(told: str) -> Iterator[None]:
    """Prefix the messages of SuppleErrors with the option that they are about."""
    try:
        yield
    except SuppleError as error:
        raise SuppleError(f"{told}: {error}") from None


def _line(text: str, places: "Places") -> tuple[float, float, float, float]:
    """Parse two points of a line, or the x of a vertical line."""
    wanted = "X, a column of pixels, or X,Y:X,Y, two points of a line (256 or 250,0:262,511, say)"
    plain = places.plain("--mirror", text)
    plain = plain if "," in plain else f"{plain},0:{plain},1"
    try:
        (x, y), (a, b) = (map(float, end.split(",")) for end in plain.split(":"))
    except ValueError:
        x = y = a = b = 0.0
    if (x, y) == (a, b) or not math.isfinite(x + y + a + b):
        raise SuppleError(f"--mirror must be {wanted}, found {text!r}")
    return x, y, a, b


def _border(text: str) -> "Border":
    """Parse the width of the border."""
    word = text.strip().lower()
    if word in ("auto", "none"):
        return "auto" if word == "auto" else None
    widths = parse_numbers("--border", text, "auto, none, a width, or one for each axis")
    return widths[0] if len(widths) == 1 else widths


def _freeze(text: str, width: float | None) -> "Freeze":
    """Read the freeze mask named on the command line, ``FILE`` or ``FILE:LABEL``."""
    from supple.files.freezing import read_freeze

    name, _, last = text.rpartition(":")
    is_label = last.lstrip("-").isdigit()
    if not name or os.path.exists(text) or not (is_label or os.path.exists(name)):
        return read_freeze(text, width=width)
    if not is_label:
        raise SuppleError(f"--freeze FILE:LABEL needs the number of a label ({shown(name)}:3, say), found {last!r}")
    return read_freeze(name, label=int(last), width=width)


def _reach(option: str, text: str) -> float | None:
    plain = "inf" if text.strip().lower() == "none" else text
    radii = parse_number(option, plain, "a number of radii from 1, or none")
    return None if radii == math.inf else radii


def _numbers(wanted: str) -> Callable[[str, str], float]:
    return partial(parse_number, wanted=wanted)


def _spread(
    name: str,
    given: Sequence[str],
    count: int,
    read: Callable[[str, str], Value],
    usual: Value,
    what: str = "stroke",
) -> list[Value]:
    """Return the value of an option for each stroke; it may be given never (``usual``), once, or once for each."""
    if given and not count:
        raise SuppleError(f"{name} is for a --{what}, and there is none: leave it out")
    if len(given) not in (0, 1, count):
        many = f"{count} {what}s" if count > 1 else f"one {what}"
        raise SuppleError(f"{name} is given {len(given)} times for {many}: give it once, or once for each")
    values = [read(name, text) for text in given] or [usual]
    return values * count if len(values) == 1 else values
