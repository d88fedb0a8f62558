"""Options that several commands have, and how numbers are read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from supple.errors import SuppleError

if TYPE_CHECKING:
    from fractions import Fraction

    from supple.files.clips import ClipOptions

VIDEO = Group("Videos and image sequences", sort_key=4)
RUNNING = Group("Running", sort_key=5)


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
