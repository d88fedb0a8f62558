"""The interface of all media: arrays, and streams of frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from typing import Any, Protocol, TypeVar, runtime_checkable

from supple.engine.stream import Frame, Sink
from supple.engine.work import Array, Layout
from supple.media.files import PathLike

Held = TypeVar("Held")


@runtime_checkable
class Medium(Protocol):
    """A kind of file, as the module for it: `image`, `volume`, `video` or `sequence`.

    Each is also an `ArrayMedium` or a `StreamMedium`, and may take further options. Errors are SuppleErrors of one
    sentence, and losses are warned of. Output appears whole, or not at all.
    """

    SUFFIXES: frozenset[str]
    """The suffixes of this kind, in lower case."""
    SUFFIXES_OUT: tuple[str, ...]
    """The suffixes of files that can be written."""

    def check_target(self, path: PathLike, /) -> None:
        """Raise SuppleError, before any work, for a name that cannot be written as this kind."""

    def info(self, path: PathLike, /) -> dict[str, Any]:
        """Return the facts on a file, decoding as little as possible."""


@runtime_checkable
class ArrayMedium(Medium, Protocol[Held]):
    """A medium read as an array: images (`image.Picture`) and volumes (`volume.Volume`)."""

    def read(self, path: PathLike, /) -> Held:
        """Read a file: its samples in its own dtype, its ``format``, and its header."""

    def write(self, path: PathLike, samples: Array, like: Held, /, *, force: bool = False) -> None:
        """Write samples with the header of ``like``, in the format of the suffix."""


@runtime_checkable
class StreamMedium(Medium, Protocol):
    """A medium that streams frame by frame: videos, and image sequences."""

    def open_clip(self, path: PathLike, /) -> AbstractContextManager[Clip]:
        """Open a clip for reading; it is closed when the block ends."""

    def writer(self, clip: Any, target: PathLike, /, *, force: bool = False) -> AbstractContextManager[Sink]:
        """Write a clip with new frames, and all else of it that the target can hold."""


class Clip(Protocol):
    """An open medium that streams."""

    @property
    def name(self) -> str:
        """The name for one line of text."""

    @property
    def count(self) -> int:
        """The number of frames."""

    @property
    def rate(self) -> Fraction:
        """Frames a second, on average."""

    @property
    def layout(self) -> Layout:
        """The layout of every frame: its arrays, one for each group of components."""

    @property
    def rotation(self) -> float:
        """The rotation of frames for display, in degrees counterclockwise, after they are mirrored."""

    @property
    def mirrored(self) -> bool:
        """Whether frames are mirrored for display, left to right, before they are rotated."""

    @property
    def aspect(self) -> Fraction | None:
        """The width of a pixel, relative to its height, before frames are rotated; None if the file does not say."""

    @property
    def fields(self) -> str:
        """The field of interlaced frames that is shown first, ``"top"`` or ``"bottom"``; else empty."""

    @property
    def display(self) -> tuple[int, int, int, int] | None:
        """The part of frames in which points count: x and y of its first pixel, width and height; None for all."""

    @property
    def unpictured(self) -> tuple[str, ...]:
        """Streams that have no place in images of its frames: sound, subtitles."""

    def frames(self) -> Iterator[Frame]:
        """Decode all frames, in display order."""

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        """Return a frame as RGB of 8 bits, (H, W, 3), or of 16 if ``deep`` and the frame has more than 8."""

    def upright(self, pixels: Array) -> Array:
        """Return a view of a frame's pixels, (H, W, …), as it is displayed: mirrored, and turned by quarters."""

    def info(self) -> dict[str, Any]:
        """Return the facts for users."""


class ClipWarning(UserWarning):
    """A part of a clip is damaged, or cannot be kept."""


class CountError(Exception):
    """The number of decoded frames differs from that of the packets: open the clip again with ``found``.

    Parameters
    ----------
    found : int
        The number of frames.
    """

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
