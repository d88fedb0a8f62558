"""Options that several commands share, and the parsing of numbers."""

import glob
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, dataclass_transform

from cyclopts import Group, Parameter, Token

from supple.cli.console import STREAM, Console, current
from supple.errors import SuppleError, counting

if TYPE_CHECKING:
    from fractions import Fraction

    from supple.engine.sampling import Sampling
    from supple.files.options import ClipOptions, Running
    from supple.files.options import VolumeOptions as Reading
    from supple.media.timecode import Numbering
    from supple.strokes import Recipe

WRITING = Group("Writing", sort_key=3)
VIDEO = Group("Videos and image sequences", sort_key=4)
RUNNING = Group("Running", sort_key=5)
SEVERAL = Group("Several files", sort_key=6)
SAMPLING = Group("Sampling", sort_key=2)
STORES = Group("Zarr stores", sort_key=4.5)
VOLUME = Group("Volumes", sort_key=5)
COORDINATES = {"lps": "LPS", "ras": "RAS", "index": "index"}
"""The coordinates of points, by their names in lower case."""


Options = TypeVar("Options")
Ends = tuple[float, float]
Shape = tuple[int, ...]
Texts = tuple[str, ...]
"""The values of an option that may be given several times."""


@dataclass_transform(kw_only_default=True)
def options_of(group: Group | None = None) -> "Callable[[type[Options]], type[Options]]":
    """Return a decorator for a dataclass of options that several commands share, shown in a group of their help."""

    def options(kind: "type[Options]") -> "type[Options]":
        return Parameter(name="*", group=group)(dataclass(kw_only=True, eq=False, repr=False)(kind))

    return options


def parse_numbers(
    name: str, text: str, wanted: str, counts: Shape = (), ends: Ends | None = None, typed: str | None = None
) -> tuple[float, ...]:
    """Parse comma-separated numbers; their count must be one of ``counts``, and each between the ``ends``, if given.

    ``typed`` is the whole value of the option, for the message, where ``text`` is a part of it.
    """
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = ()
    low, high = ends or (-math.inf, math.inf)
    beyond = ends is not None and not all(low <= x <= high for x in numbers)  # as NaN is
    if not numbers or (counts and len(numbers) not in counts) or beyond:
        raise SuppleError(f"{name} must be {wanted}, found {text if typed is None else typed!r}")
    return numbers


def parse_number(name: str, text: str, wanted: str, ends: Ends | None = None, typed: str | None = None) -> float:
    """Parse a number, between two ends if they are given."""
    return parse_numbers(name, text, wanted, (1,), ends, typed)[0]


def parse_percent(name: str, text: str, wanted: str, low: float, high: float, unit: float = 1) -> float:
    """Parse a number between two ends, or a percentage, of which ``unit`` are 1."""
    bare = text.strip().removesuffix("%")
    unit = unit if bare != text.strip() else 1
    return parse_number(name, bare, wanted, (low * unit, high * unit), text) / unit


def parse_sizes(name: str, text: str, wanted: str, counts: Shape) -> Shape:
    """Parse whole numbers from 0, as many as one of ``counts``: 512,512 or 512x512."""
    parts = re.split(r"\s*[,x×]\s*", text.lower().strip())
    if len(parts) not in counts or not all(part.isdecimal() and len(part) < 20 for part in parts):
        raise SuppleError(f"{name} must be {wanted}, found {text!r}")
    return tuple(map(int, parts))


parse_three = partial(parse_numbers, wanted="three numbers X,Y,Z", counts=(3,))


def parse_integer(name: str, text: str, wanted: str) -> int:
    """Parse an integer."""
    try:
        return int(text)
    except ValueError:
        raise SuppleError(f"{name} must be {wanted}, found {text!r}") from None


def read(how: Callable[[str, str], object], metavar: str, **more: Any) -> Parameter:
    """Return an option that is parsed by ``how(name, text)``."""

    def convert(kind: object, tokens: Sequence[Token]) -> object:
        if len(tokens) > 1:  # with a tuple as its default, cyclopts takes several
            raise SuppleError(f"{tokens[0].keyword} is given {len(tokens)} times: give it once")
        return how(tokens[0].keyword or "", tokens[0].value)

    return Parameter(metavar=metavar, allow_leading_hyphen=True, converter=convert, n_tokens=1, **more)


def number(wanted: str, metavar: str, ends: Ends | None = None, **more: Any) -> Parameter:
    """Return an option that is a number; ``wanted`` describes it in the error for anything else."""
    return read(partial(parse_number, wanted=wanted, ends=ends), metavar, **more)


def whole(metavar: str = "N", **more: Any) -> Parameter:
    """Return an option that is an integer; fractions are errors, which cyclopts would round."""
    return read(partial(parse_integer, wanted="a whole number"), metavar, **more)


def text(metavar: str, **more: Any) -> Parameter:
    """Return an option whose values may begin with a dash, as numbers do."""
    return Parameter(metavar=metavar, allow_leading_hyphen=True, **more)


def words(metavar: str) -> Parameter:
    """Return an option that is one of a few words, which its help lists once."""
    return Parameter(metavar=metavar, show_choices=False)


def _rate(option: str, text: str) -> "float | Fraction":
    """Parse frames a second: a number, or a ratio of two."""
    from fractions import Fraction

    try:
        rate = Fraction(text) if "/" in text else float(text)
    except (ValueError, ZeroDivisionError):
        rate = 0.0
    if not 1e-4 <= rate <= 1e5:
        raise SuppleError(f"{option} must be frames a second, 0.0001 to 100000, or 24000/1001, found {text!r}")
    return rate


def parse_memory(option: str, text: str) -> float:
    """Parse gigabytes, and return bytes."""
    from supple.files.options import GB

    return min(parse_number(option, text, "a number of gigabytes from 0", (0, math.inf)), 1e12) * GB


@options_of(RUNNING)
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
    threads: Annotated[int | None, whole()] = None

    def start(self, file: str = "") -> Console:
        """Apply these options to the console of the command, which reads ``file``; return the console."""
        console = current()
        console.quiet, console.strict, console.all.source = self.quiet, self.strict, file
        named = os.environ.get("SUPPLE_THREADS", "") if self.threads is None else str(self.threads)
        if named and not (named.isascii() and named.isdecimal() and int(named) > 0):
            option = "the environment variable SUPPLE_THREADS" if self.threads is None else "--threads"
            raise SuppleError(f"{option} must be a number of threads from 1, found {named!r}")
        if self.threads is not None:
            os.environ["SUPPLE_THREADS"] = os.environ["VIPS_CONCURRENCY"] = named
        return console


def parse_first(option: str, text: str) -> "int | str":
    """Parse the number of the first frame, or "files"."""
    return text if text == "files" else parse_integer(option, text, "a whole number, or files")


class Frames:
    """A parser of frames of a clip: numbers that count from ``first``, 0 if it is None, or timecodes.

    The clip is opened only if that is needed. ``first`` is a number, None, or "files".
    """

    def __init__(self, source: str, first: Any = None, rate: Any = None) -> None:
        self._source, self._first, self._rate = source, first, rate

    @cached_property
    def _numbering(self) -> "Numbering":
        from supple.files.clips import numbering_of
        from supple.media.numbering import of_star

        source = self._source
        if "*" in os.path.basename(source) and not os.path.exists(source):
            source = of_star(source) or source
        first = None if self._first == "files" else self._first or 0
        return numbering_of(source, first=first, rate=self._rate)

    @property
    def first(self) -> Any:
        """The number of the first frame; None if it is not given."""
        return self._numbering.first if self._first == "files" else self._first

    def read(self, option: str, text: str) -> int:
        """Return a frame, counted from 0; SuppleError if the clip does not have it."""
        if self._first is None and text.lstrip("+-").isdecimal():
            return int(text)  # the range is checked later
        return self._numbering.read(option, text)

    def part(self, option: str, text: str) -> tuple[int, int]:
        """Return the first and the last frame of a range A-B, counted from 0."""
        ends = text.split("-")
        if len(ends) != 2 or "" in ends:
            raise SuppleError(f"{option} must be the first and the last frame, A-B (1010-1035, say), found {text!r}")
        first, last = (self.read(option, end.strip()) for end in ends)
        if first > last:
            raise SuppleError(f"{option} {text}: frame {ends[0]} comes after {ends[1]}: give the earlier one first")
        return first, last

    def plain(self, option: str, text: str) -> str:
        """Return the text of a stroke with its timecodes, the third numbers of points, replaced by numbers.

        A timecode is unambiguous: it has four numbers between colons, and no stroke has more than two.
        """
        from supple.media.timecode import PATTERN

        def counted(found: re.Match[str]) -> str:
            return str(self._numbering.read(option, found[0]) + self._numbering.first)

        return re.sub(rf"(?<=,){PATTERN}(?=:|$)", counted, text)


@options_of(VIDEO)
class TimeOptions:
    """How strokes feel time.

    Parameters
    ----------
    time_scale
        How many pixels one frame counts as, for the border and for strokes of recipes before version 3 (default: what
        the recipe says, or 1). The radius in time of others is --time-radius.
    first_frame
        Number of the first frame, from which all frames of the command line count: 1001, say; or files: the number
        in the name of the first picture of a sequence (default 0). Frames may be timecodes, too: 00:00:12:08.
    """

    time_scale: Annotated[float | None, number("a number of pixels above 0", "PX", (5e-324, 1e308))] = None
    first_frame: Annotated[Any, read(parse_first, "N|files")] = None

    def frames(self, source: str) -> Frames:
        """Return the parser of frames of a clip."""
        return Frames(source, self.first_frame, getattr(self, "rate", None))


@options_of(VIDEO)
class FilterOptions(TimeOptions):
    """Options for videos and image sequences that are read.

    Parameters
    ----------
    rate
        Frames per second when an image sequence becomes a video: 25, 29.97 or 24000/1001 (default 24).
    between
        Interpolation between frames: flow, which follows what moves (default, if supple[flow] is installed), linear
        (the default without it), cubic or nearest.
    time_filter
        Average over several frames where the deformation speeds time up: motion blur instead of jagged edges.
    memory
        Memory for frames, in gigabytes (default 2). What does not fit is kept in a temporary file.
    """

    between: Annotated[Literal["flow", "linear", "cubic", "nearest"] | None, Parameter()] = None
    time_filter: bool = False
    rate: Annotated[Any, read(_rate, "N", name="--fps")] = None
    memory: Annotated[float | None, read(parse_memory, "GB")] = None

    def to_clip(self) -> "ClipOptions":
        """Return the options as a `ClipOptions`."""
        from supple.files.options import ClipOptions

        given = {name: value for name, value in vars(self).items() if value not in (None, "files")}
        return ClipOptions(**given)


@options_of(VIDEO)
class VideoOptions(FilterOptions):
    """Options for videos and image sequences that are written.

    Parameters
    ----------
    codec
        Video codec: h264, hevc, vp9, av1, ffv1, prores, … (default: that of the input).
    crf
        Constant rate factor of the encoder: lower values give better quality and larger files (18 for H.264).
    preset
        Speed preset of the encoder: slower presets give smaller files (medium, slow, …).
    pixel_format
        Pixel format: yuv420p, yuv444p10le, … (default: that of the input).
    """

    codec: Annotated[str | None, Parameter(metavar="NAME")] = None
    crf: Annotated[float | None, number("a number", "N")] = None
    preset: Annotated[str | None, Parameter(metavar="NAME")] = None
    pixel_format: Annotated[str | None, Parameter(metavar="NAME")] = None


@options_of(VIDEO)
class TrackOptions:
    """Options for strokes that follow tracked points.

    Parameters
    ----------
    track
        Move the strokes of the command line, of points X,Y, along with tracked points: a table frame,x,y (CSV, with a
        column name for several tracks), a script of Nuke, or keyframes copied from After Effects; or auto: with what
        is under each in --track-frame.
    track_name
        Name of the track to follow: once for all strokes, or once for each, in order.
    track_frame
        Frame in which the strokes are where --grab has them (default: the first of the track, or of
        the clip).
    track_turn
        Follow two tracks with each stroke: it moves with the first point, and turns and grows with the way to the
        second.
    outside_track
        What a stroke does before and after its track: fade, within 5 frames (default), or hold, as at its ends.
    track_from
        How a table without a header counts: pixels (from the centre of the top left one), nuke or ae.
    track_first
        Number that the track gives to the first frame of the clip (default: --first-frame; or 0, or in Nuke 1).
    """

    track: Annotated[str | None, Parameter(metavar="FILE|auto")] = None
    track_name: Annotated[Texts, text("NAME")] = ()
    track_frame: Annotated[str | None, text("K")] = None
    track_turn: bool = False
    outside_track: Annotated[Literal["fade", "hold"] | None, words("fade|hold")] = None
    track_from: Annotated[Literal["pixels", "nuke", "ae"] | None, words("pixels|nuke|ae")] = None
    track_first: Annotated[int | None, whole()] = None

    def followed(
        self, recipe: "Recipe", own: Sequence[int], paths: Sequence[str], memory: float, frames: Frames
    ) -> "Recipe":
        """Return a recipe in which the strokes ``own``, those of the command line, follow the tracks."""
        given = [name for name, value in vars(self).items() if value not in (None, (), False)]
        if self.track == "auto":
            given = [name for name in given if name not in ("track", "track_frame", "outside_track")]
        if given and self.track in (None, "auto"):
            what = "a --track, and there is none" if self.track is None else "the --track of a file, not for auto"
            raise SuppleError(f"--{given[0].replace('_', '-')} is for {what}: leave it out")
        if self.track is None:
            return recipe
        if not own:
            raise SuppleError("--track moves strokes of the command line, and there are none: give a --grab")
        auto = self.track == "auto"
        if auto and (len(paths) != 2 or paths[0] == STREAM):
            raise SuppleError("--track auto follows points through one clip: give the name of one, and of one to write")
        from supple.engine.progress import counted
        from supple.files.tracking import follow_tracks

        with counted(current().terminal) as tell, counting(frames.first):
            return follow_tracks(
                recipe,
                None if auto else self.track,
                paths[0],
                names=self.track_name,
                frame=None if self.track_frame is None else frames.read("--track-frame", self.track_frame),
                strokes=own,
                convention=self.track_from,
                first=frames.first if self.track_first is None else self.track_first,
                frames=frames.read,
                turn=self.track_turn,
                outside=self.outside_track or "fade",
                memory=memory,
                tell=tell,
            )


_shape = partial(parse_sizes, wanted="numbers of voxels along X,Y,Z (512,512,200 or 512x512x200, say)", counts=(3,))
_LABELS = """The volume is a label map, and labels are not mixed: each voxel takes that of the nearest one (nearest, as
without a word), or that of the largest share of its footprint, whose edges are smooth (smooth)."""
_kinds = Parameter(group=VOLUME, metavar="[nearest|smooth]", help=_LABELS)
Labels = Annotated[bool | Literal["nearest", "smooth"], _kinds]


@options_of(VOLUME)
class VolumeArguments:
    """Options for volumes.

    Parameters
    ----------
    world
        Points of strokes are in millimetres in the file's coordinate system (NIfTI: RAS; DICOM, NRRD and
        MetaImage: LPS; .mgz: RAS) instead of voxels.
    series
        Which series to read from a DICOM folder with several: its number in the list, or its UID.
    irregular
        Accept DICOM slices that are missing, or unevenly spaced: resample interpolates them linearly, at even steps.
    shape
        Number of voxels along x, y and z, for a file without a header; needs --dtype.
    dtype
        Data type of a file without a header: uint8, int16, <i2 (little-endian), >f4 (big-endian), …
    spacing
        Distance between voxels along x, y and z in millimetres, for a file without a header (default 1,1,1).
    """

    world: bool = False
    series: Annotated[str | None, Parameter(metavar="N|UID")] = None
    irregular: Literal["resample"] | None = None
    shape: Annotated[Any, read(_shape, "X,Y,Z")] = None
    dtype: Annotated[str | None, Parameter(metavar="TYPE")] = None
    spacing: Annotated[Any, read(parse_three, "X,Y,Z")] = None

    def to_reading(self, *, strokes: bool, labels: bool | str = False) -> "Reading":
        """Return the options as a `VolumeOptions`; ``strokes`` says whether there are any."""
        from supple.files.options import VolumeOptions as Reading

        if self.world and not strokes:
            raise SuppleError("--world is about the points of strokes, and there are none: leave it out")
        layout = None
        if self.shape is not None or self.dtype is not None or self.spacing is not None:
            from supple.media.volume import RawLayout

            if self.shape is None or self.dtype is None:
                raise SuppleError(
                    "a file without a header needs both --shape X,Y,Z and --dtype: give the other one too"
                )
            layout = RawLayout(self.shape, self.dtype, self.spacing or (1.0, 1.0, 1.0))
        return Reading(self.world, labels == "nearest" or labels, layout, self.series, self.irregular)


def is_pattern(path: str) -> bool:
    """Return whether a name stands for several files, each with an output of its own."""
    from supple.media.numbering import has_number

    return glob.has_magic(path) and "://" not in path and not has_number(path) and not os.path.exists(path)


def convention_of(path: str, reading: "Reading") -> str | None:
    """Return the convention of a volume, as in `Geometry`; None for other files.

    For several files, it is that of the first; for standard input, which cannot be read twice, that of DICOM.
    """
    from supple.media.files import is_store
    from supple.media.medium import ONE_FILE, holds_volumes, opened
    from supple.media.suffixes import suffix_of

    if path == STREAM:
        return "LPS"
    if is_pattern(path):
        path = min(glob.glob(path, recursive=True), default=path)
    elif holds_volumes(path):
        path = os.path.join(path, min(name for name in os.listdir(path) if suffix_of(name) in ONE_FILE))
    medium = opened(path, axes=None if is_store(path) else 3, how=reading.how)
    solid = medium.kind in ("volume", "store") and medium.grid is not None and medium.grid.ndim == 3
    return medium.outline.geometry.convention if solid else None


@options_of(WRITING)
class WritingOptions:
    """Options of what is written.

    Parameters
    ----------
    quality
        Quality of JPEG (default that of the input, or 95), WebP and AVIF (90), from 1 to 100.
    lossless
        Write WebP and AVIF without loss, and videos, by FFV1 or the codec that is named. PNG and TIFF always are.
    save_recipe
        Write the strokes to a recipe (JSON), for --recipe of supple warp.
    """

    quality: Annotated[int | None, whole("1..100")] = None
    lossless: bool = False
    save_recipe: Annotated[str | None, Parameter(metavar="FILE")] = None


@options_of(SEVERAL)
class SeveralOptions:
    """Options of several files.

    Parameters
    ----------
    recursive
        Also enter the folders within a folder; what is written has the same folders.
    skip_existing
        Leave files that are there already as they are, and go on with the others.
    jobs
        How many pictures are worked on at the same time (as many as there are processors, and memory for).
    """

    recursive: bool = False
    skip_existing: bool = False
    jobs: Annotated[int | None, whole()] = None

    def check(self, many: bool, force: bool) -> None:
        """Raise SuppleError if these options are given for a single file, or contradict each other."""
        loose = next((name for name, value in vars(self).items() if value not in (False, None)), None)
        if loose is not None and not many:
            option = f"--{loose.replace('_', '-')}"
            raise SuppleError(
                f"{option} is for several files, a folder or a pattern, which become a folder: leave it out"
            )
        if self.skip_existing and force:
            raise SuppleError("--force replaces what --skip-existing leaves as it is: give one of them")
        if self.jobs is not None and self.jobs < 1:
            raise SuppleError(f"--jobs must be a number of pictures from 1 on, found {self.jobs}")


@options_of(STORES)
class WorkerOptions:
    """Options of outputs that are written block by block.

    Parameters
    ----------
    workers
        Work in so many processes on this machine, which share its cores (default: threads of one process).
    scheduler
        Work on a cluster of Dask, which has started already: the address of its scheduler.
    """

    workers: Annotated[int | None, whole()] = None
    scheduler: Annotated[str | None, Parameter(metavar="tcp://HOST:PORT")] = None

    def to_running(self) -> "Running":
        """Return the options as a `Running`."""
        from supple.files.options import Running

        return Running(**vars(self))


@options_of(SAMPLING)
class SamplingOptions:
    """How the input is sampled.

    Parameters
    ----------
    filter
        Interpolation: auto (cubic, averaged where the picture shrinks), cubic, linear or nearest.
    outside
        What to show beyond the edges of the input: its edge pixels, a constant (--fill), or its mirror image (default:
        edge; of volumes with --reference, constant: the least value, the padding of DICOM, or 0 of labels).
    fill
        Fill value of --outside constant, in the picture's own values (0): one for all channels, or one for each.
    tolerance
        Largest allowed error of the inverse map, in pixels.
    """

    filter: Annotated[str, Parameter(metavar="auto|cubic|linear|nearest")] = "auto"
    outside: Literal["edge", "constant", "reflect"] | None = None
    fill: Annotated[str | None, text("V|V,V,V")] = None
    tolerance: Annotated[float, number("a number of pixels from 1e-9 to 1e9", "PX", (1e-9, 1e9))] = 0.01

    def to_sampling(self, elsewhere: bool, linear_light: bool = False) -> "tuple[Sampling, str | None]":
        """Return the `Sampling`, and the boundary mode that was asked for, or None.

        If maps or a reference may lead outside the input (``elsewhere``), a fill value implies the constant mode.
        """
        from supple.engine.sampling import Sampling

        values = [*parse_numbers("--fill", self.fill or "0", "a number, or one for each channel: 255,0,0")]
        outside: str | None = self.outside
        if self.fill is not None and outside is None and elsewhere:
            outside = "constant"
        if self.fill is not None and outside != "constant":
            told = outside or "edge"
            raise SuppleError(f"--fill is the constant of --outside constant, and --outside is {told}: give both")
        return Sampling(self.filter, self.tolerance, outside or "edge", values, linear_light), outside
