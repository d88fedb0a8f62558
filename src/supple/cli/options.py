"""Options that several commands have, and the recipe that they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from supple.errors import SuppleError

if TYPE_CHECKING:
    from fractions import Fraction

    from supple.domain import Border
    from supple.files.clips import ClipOptions
    from supple.strokes import Fit, Recipe, Stroke

STROKES = Group("Strokes", sort_key=1)
VIDEO = Group("Videos and image sequences", sort_key=4)
RUNNING = Group("Running", sort_key=5)


@Parameter(name="*", group=STROKES)
@dataclass(frozen=True, kw_only=True)
class StrokeOptions:
    """Options for strokes: points, drags and materials.

    Parameters
    ----------
    grab
        Drag the first point to the second. Pixels are counted from the top left one, which is 0,0. In a video,
        a third number is the frame, counted from 0; in a volume, points are voxels x,y,z. Give it several times
        for several strokes, which are applied in order.
    radius
        Radius of the brush: in pixels, in volumes in millimetres. Give --radius, --poisson, --scales and
        --reach once for all grabs, or once for each.
    poisson
        Poisson's ratio of the material, at most 0.5 (default 0.4). The higher it is, the more the material gives
        way sideways, which keeps volume in 3-D, but not area in a picture. -inf moves nothing sideways, and is
        the default for a drag in time only.
    scales
        How fast the movement fades with distance r: 1 as 1/r (default), 2 as 1/r³, 3 as 1/r⁵.
    reach
        Distance from the grab, in radii, beyond which nothing moves and values stay as they are: at least 1
        (default 4), or none for no limit.
    recipe
        Read strokes from a recipe (JSON). They are applied before those of --grab, which are in pixels of the size
        that the recipe names, if it names one.
    border
        Width of the band along the edges in which movement fades to 0, so that the edges stay in place. auto
        (default): a tenth of each side. N or N,N: in pixels; N,N,N: in a video with frames, in a volume in
        millimetres. none: the edges move too.
    border_profile
        How movement fades towards the border: quartic (default), or sine as in the paper.
    on_fold
        What to do with a grab that would fold the picture or that the border holds back. flow (default): reach
        the target in smaller steps. damp: shorten the grab. error: stop.
    amount
        How much of each drag is carried out: 30%, or 0.3. Each grab holds the same part of the picture as at 100%.
    fit
        How a recipe that was made for another size fits: pixels takes its numbers as they are; stretch scales width
        and height by factors of their own; inside keeps proportions, centred. One of the same proportions is scaled
        without asking.
    """

    grab: Annotated[
        list[str], Parameter(allow_leading_hyphen=True, metavar="X,Y[,T|Z]:X,Y[,T|Z]", show_default=False)
    ] = ()  # type: ignore[assignment]
    radius: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="R", show_default=False)] = ()  # type: ignore[assignment]
    poisson: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="N", show_default=False)] = ()  # type: ignore[assignment]
    scales: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="1|2|3", show_default=False)] = ()  # type: ignore[assignment]
    reach: Annotated[list[str], Parameter(allow_leading_hyphen=True, metavar="R|none", show_default=False)] = ()  # type: ignore[assignment]
    recipe: Annotated[str | None, Parameter(metavar="FILE")] = None
    border: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="auto|none|N|N,N")] = None
    border_profile: Annotated[
        Literal["quartic", "sine"] | None, Parameter(metavar="quartic|sine", show_choices=False)
    ] = None
    on_fold: Annotated[
        Literal["damp", "flow", "error"] | None, Parameter(metavar="flow|damp|error", show_choices=False)
    ] = None
    amount: Annotated[str | None, Parameter(allow_leading_hyphen=True, metavar="PART")] = None
    fit: Annotated[
        Literal["pixels", "stretch", "inside"] | None, Parameter(metavar="pixels|stretch|inside", show_choices=False)
    ] = None

    @property
    def any(self) -> bool:
        """Return whether there is anything to do."""
        return bool(self.grab) or self.recipe is not None

    def to_fit(self) -> Fit | None:
        """How a recipe fits another size; refuse what is said of a recipe where there is none."""
        if self.fit is not None and self.recipe is None:
            raise SuppleError("--fit is for a recipe that was made for another size: give a --recipe, or leave it out")
        if self.amount is not None and not self.any:
            raise SuppleError("--amount is for strokes, and there are none: give --recipe or --grab, or leave it out")
        return self.fit

    def to_recipe(self, *, world: bool = False, empty: bool = False, others: str = "") -> Recipe:
        """Read the recipe file, if one is given, and add the grabs.

        ``world`` says that these are in millimetres; ``empty``, that there is something to do without strokes;
        ``others`` are the options that would do, too.
        """
        from supple.strokes import Recipe

        if not self.grab and self.recipe is None and not empty:
            raise SuppleError(f"nothing to do: give --grab X,Y:X,Y --radius R, {others or 'or '}--recipe FILE")
        if self.recipe is None:
            made = Recipe()
        else:
            from supple.files import read_recipe

            made = read_recipe(self.recipe)
            if self.grab and made.is_world and not world:
                raise SuppleError(
                    f"{self.recipe} is in {made.space} millimetres, and --grab in voxels: give --world if it is in "
                    "millimetres too"
                )
            if world and made.space == "pixels":
                raise SuppleError(f"--world is for points in millimetres, and {self.recipe} is in pixels: leave it out")
        made = replace(made, strokes=(*made.strokes, *self._strokes()))
        if self.border is not None:
            made = replace(made, border=_border(self.border))
        if self.amount is not None:
            made = replace(made, amount=_amount(self.amount))
        if self.border_profile is not None:
            made = replace(made, border_profile=self.border_profile)
        return made if self.on_fold is None else replace(made, on_fold=self.on_fold)

    def _strokes(self) -> list[Stroke]:
        from supple.strokes import REACH, Stroke

        count = len(self.grab)
        if count and not self.radius:
            raise SuppleError("--grab needs a --radius: how far it is felt, in pixels or millimetres")
        radii = _spread("--radius", self.radius, count, "a number of pixels or millimetres above 0")
        ratios: list[float | None] = [None] * count
        if self.poisson:
            ratios = [*_spread("--poisson", self.poisson, count, "a number up to 0.5, or -inf")]
        scales = _spread("--scales", self.scales, count, "1, 2 or 3") or [1] * count
        wanted = "a number of radii from 1, or none"
        reaches: list[float | None] = [REACH] * count
        if self.reach:
            texts = ["inf" if x.strip().lower() == "none" else x for x in self.reach]
            read = _spread("--reach", texts, count, wanted)
            reaches = [None if x == math.inf else x for x in read]
        strokes = []
        for text, radius, ratio, scale, reach in zip(self.grab, radii, ratios, scales, reaches, strict=True):
            start, end = _grab(text)
            whole = int(scale) if float(scale).is_integer() else scale
            try:
                strokes.append(Stroke.grab(start, to=end, radius=radius, poisson=ratio, scales=whole, reach=reach))  # type: ignore[arg-type]
            except SuppleError as error:
                raise SuppleError(f"--grab {text}: {error}") from None
        return strokes


@Parameter(name="*", group=RUNNING)
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How the command goes about it.

    Parameters
    ----------
    force
        Overwrite files that exist, even the input.
    quiet
        Print no warnings and no progress bar.
    json
        Print one JSON object for each file to standard output, with results and warnings.
    strict
        Treat each warning as an error: a file with a warning is not written, and the exit status is 2.
    threads
        Number of threads (default: all cores).
    """

    force: bool = False
    quiet: bool = False
    strict: bool = False
    json: bool = False
    threads: Annotated[int | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None

    def asked(self) -> dict[str, Any]:
        """Return what the console is to know of them."""
        return {"quiet": self.quiet, "strict": self.strict, "threads": self.threads}


@Parameter(name="*", group=VIDEO)
@dataclass(frozen=True, kw_only=True)
class TimeOptions:
    """How strokes feel time.

    Parameters
    ----------
    time_scale
        How many pixels one frame counts as, for radius and border (default: what the recipe says, or 1).
    """

    time_scale: Annotated[str | None, Parameter(metavar="PX", allow_leading_hyphen=True)] = None

    def to_scale(self) -> float | None:
        """Return the options as the library takes them."""
        if self.time_scale is None:
            return None
        wanted = "a number of pixels above 0"
        scale = parse_number("--time-scale", self.time_scale, wanted)
        if not 0 < scale < math.inf:
            raise SuppleError(f"--time-scale must be {wanted}, found {self.time_scale!r}")
        return scale


@Parameter(name="*", group=VIDEO)
@dataclass(frozen=True, kw_only=True)
class VideoOptions(TimeOptions):
    """Options for videos and image sequences.

    Parameters
    ----------
    between
        Interpolation between frames: linear (default), cubic or nearest.
    time_filter
        Average over several frames where the deformation speeds time up: motion blur instead of jagged edges.
    codec
        Video codec: h264, hevc, vp9, av1, ffv1, prores, … (default: that of the input).
    crf
        Constant rate factor of the encoder: lower values give better quality and larger files (18 for H.264).
    preset
        Speed preset of the encoder: slower presets give smaller files (medium, slow, …).
    pixel_format
        Pixel format: yuv420p, yuv444p10le, … (default: that of the input).
    fps
        Frames per second when an image sequence becomes a video: 25, 29.97 or 24000/1001 (default 24).
    memory
        Memory for frames, in gigabytes (default 2). What does not fit is kept in a temporary file.
    """

    between: Annotated[Literal["linear", "cubic", "nearest"] | None, Parameter()] = None
    time_filter: bool = False
    codec: Annotated[str | None, Parameter(metavar="NAME")] = None
    crf: Annotated[str | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None
    preset: Annotated[str | None, Parameter(metavar="NAME")] = None
    pixel_format: Annotated[str | None, Parameter(metavar="NAME")] = None
    fps: Annotated[str | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None
    memory: Annotated[str | None, Parameter(metavar="GB", allow_leading_hyphen=True)] = None

    def to_clip(self) -> ClipOptions:
        """Return the options as the library takes them."""
        from supple.files.clips import GB, ClipOptions

        def read(name: str, text: str | None, wanted: str) -> float | None:
            return None if text is None else parse_number(name, text, wanted)

        rate = None if self.fps is None else _rate(self.fps)
        if rate is not None and not 0 < rate <= 100_000:
            raise SuppleError(f"--fps must be a number of frames a second above 0, found {self.fps!r}")
        memory = read("--memory", self.memory, "a number of gigabytes")
        if memory is not None and not memory >= 0:
            raise SuppleError(f"--memory must be a number of gigabytes from 0, found {self.memory!r}")
        return ClipOptions(
            between=self.between,
            time_filter=self.time_filter,
            time_scale=self.to_scale(),
            rate=rate,
            codec=self.codec,
            crf=read("--crf", self.crf, "a number"),
            preset=self.preset,
            pixel_format=self.pixel_format,
            memory=2 * GB if memory is None else min(memory, 1e12) * GB,
        )


def parse_number(name: str, text: str, wanted: str) -> float:
    """Read a number from the command line."""
    try:
        return float(text)
    except ValueError:
        raise SuppleError(f"{name} must be {wanted}, found {text!r}") from None


def parse_integer(name: str, text: str, wanted: str) -> int:
    """Read a whole number from the command line."""
    try:
        return int(text)
    except ValueError:
        raise SuppleError(f"{name} must be {wanted}, found {text!r}") from None


def _border(text: str) -> Border:
    """Read the border's width from the command line."""
    word = text.strip().lower()
    if word in ("auto", "none"):
        return "auto" if word == "auto" else None
    widths = tuple(
        parse_number("--border", part, "auto, none, a width, or one for each axis") for part in text.split(",")
    )
    return widths[0] if len(widths) == 1 else widths


def _amount(text: str) -> float:
    """Read a part from the command line, in percent or as a number."""
    wanted = "a part of the strokes, from 0% to 100%, or from 0 to 1"
    percent = text.strip().endswith("%")
    part = parse_number("--amount", text.strip().removesuffix("%"), wanted) / (100 if percent else 1)
    if not 0 <= part <= 1:
        raise SuppleError(f"--amount must be {wanted}, found {text!r}")
    return part


def _rate(text: str) -> float | Fraction:
    """Read frames a second from the command line: a number, or a ratio of two."""
    if "/" not in text:
        return parse_number("--fps", text, "a number of frames a second")
    from fractions import Fraction

    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise SuppleError(f"--fps must be a number of frames a second, or 24000/1001, found {text!r}") from None


def parse_fill(text: str) -> list[float]:
    """Read a colour from the command line."""
    return [
        parse_number(
            "--fill",
            part,
            "a number, or one for each channel: 255,0,0",
        )
        for part in text.split(",")
    ]


def _spread(name: str, given: Sequence[str], count: int, wanted: str) -> list[float]:
    if len(given) not in (0, 1, count) or (given and not count):
        many = f"{count} grabs" if count > 1 else "one grab" if count else "no --grab"
        raise SuppleError(f"{name} is given {len(given)} times for {many}: give it once, or once for each --grab")
    values = [parse_number(name, text, wanted) for text in given]
    return values * count if len(values) == 1 else values


def _grab(text: str) -> tuple[list[float], list[float]]:
    wanted = "X,Y:X,Y, or X,Y,T:X,Y,T, two points in pixels, frames or voxels (256,256:256,346, say)"
    parts = text.split(":")
    if len(parts) != 2:
        raise SuppleError(f"--grab must be {wanted}, found {text!r}")
    points = []
    for part in parts:
        try:
            points.append([float(x) for x in part.split(",")])
        except ValueError:
            raise SuppleError(f"--grab must be {wanted}, found {text!r}") from None
    if len(points[0]) != len(points[1]) or len(points[0]) not in (2, 3):
        raise SuppleError(f"--grab must be {wanted}, found {text!r}")
    return points[0], points[1]
