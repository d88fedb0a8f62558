"""Options that several commands have, and how numbers are read."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter, Token

from supple.errors import SuppleError

if TYPE_CHECKING:
    from fractions import Fraction

    from supple.files.options import ClipOptions

VIDEO = Group("Videos and image sequences", sort_key=4)
RUNNING = Group("Running", sort_key=5)


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


def read(how: Callable[[str, str], object], metavar: str, **more: Any) -> Parameter:
    """Return an option that a function reads, from its name and its value."""

    def convert(kind: object, tokens: Sequence[Token]) -> object:
        return how(tokens[0].keyword or "", tokens[0].value)

    return Parameter(metavar=metavar, allow_leading_hyphen=True, converter=convert, n_tokens=1, **more)


def number(wanted: str, metavar: str, **more: Any) -> Parameter:
    """Return an option that is a number; anything else must be what is ``wanted``."""
    return read(partial(parse_number, wanted=wanted), metavar, **more)


def _scale(option: str, text: str) -> float:
    wanted = "a number of pixels above 0"
    scale = parse_number(option, text, wanted)
    if not 0 < scale < math.inf:
        raise SuppleError(f"{option} must be {wanted}, found {text!r}")
    return scale


def _rate(option: str, text: str) -> "float | Fraction":
    """Read frames a second: a number, or a ratio of two."""
    from fractions import Fraction

    if "/" not in text:
        rate: float | Fraction = parse_number(option, text, "a number of frames a second")
    else:
        try:
            rate = Fraction(text)
        except (ValueError, ZeroDivisionError):
            raise SuppleError(f"{option} must be a number of frames a second, or 24000/1001, found {text!r}") from None
    if not 0 < rate <= 100_000:
        raise SuppleError(f"{option} must be a number of frames a second above 0, found {text!r}")
    return rate


def _memory(option: str, text: str) -> float:
    """Read gigabytes, as bytes."""
    from supple.files.options import GB

    memory = parse_number(option, text, "a number of gigabytes")
    if not memory >= 0:
        raise SuppleError(f"{option} must be a number of gigabytes from 0, found {text!r}")
    return min(memory, 1e12) * GB


@Parameter(name="*", group=RUNNING)
@dataclass(kw_only=True, eq=False, repr=False)
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
@dataclass(kw_only=True, eq=False, repr=False)
class TimeOptions:
    """How strokes feel time.

    Parameters
    ----------
    time_scale
        How many pixels one frame counts as, for radius and border (default: what the recipe says, or 1).
    """

    time_scale: Annotated[float | None, read(_scale, "PX")] = None


@Parameter(name="*", group=VIDEO)
@dataclass(kw_only=True, eq=False, repr=False)
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
    rate
        Frames per second when an image sequence becomes a video: 25, 29.97 or 24000/1001 (default 24).
    memory
        Memory for frames, in gigabytes (default 2). What does not fit is kept in a temporary file.
    """

    between: Annotated[Literal["linear", "cubic", "nearest"] | None, Parameter()] = None
    time_filter: bool = False
    codec: Annotated[str | None, Parameter(metavar="NAME")] = None
    crf: Annotated[float | None, number("a number", "N")] = None
    preset: Annotated[str | None, Parameter(metavar="NAME")] = None
    pixel_format: Annotated[str | None, Parameter(metavar="NAME")] = None
    rate: Annotated[Any, read(_rate, "N", name="--fps")] = None
    memory: Annotated[float | None, read(_memory, "GB")] = None

    def to_clip(self) -> "ClipOptions":
        """Return the options as the library takes them."""
        from supple.files.options import ClipOptions

        return ClipOptions(**{name: value for name, value in vars(self).items() if value is not None})


def parse_fill(text: str) -> list[float]:
    """Read a colour from the command line."""
    return [parse_number("--fill", part, "a number, or one for each channel: 255,0,0") for part in text.split(",")]
