"""The contract of all media: those that are at hand as arrays, and those that stream."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeVar, runtime_checkable

from supple.engines.base import Array, Layout
from supple.media.files import PathLike
from supple.pipeline import Frame, Sink

Held = TypeVar("Held")


@runtime_checkable
class Medium(Protocol):
    """A kind of file, as the module that reads and writes it: `image`, `volume`, `video` or `sequence`.

    Each is also an `ArrayMedium` or a `StreamMedium`, and may take more options than are named here. All refuse with
    a SuppleError of one sentence, and warn of what does not come through. What is written appears whole, or not at
    all.
    """

    SUFFIXES: frozenset[str]
    """Of the files that are taken for this kind by their names, in small letters."""
    SUFFIXES_OUT: tuple[str, ...]
    """Of the files that can be written."""

    def check_target(self, path: PathLike, /) -> None:
        """Refuse a name that nothing of this kind is written under, before any work is done for it."""

    def info(self, path: PathLike, /) -> dict[str, Any]:
        """Tell what a file holds, without decoding more of it than that takes."""


@runtime_checkable
class ArrayMedium(Medium, Protocol[Held]):
    """A medium that is at hand as an array: pictures (`image.Picture`) and volumes (`volume.Volume`)."""

    def read(self, path: PathLike, /) -> Held:
        """Read a file: its samples in its own dtype, its ``format``, and what else its header says."""

    def write(self, path: PathLike, samples: Array, like: Held, /, *, force: bool = False) -> None:
        """Write samples with the header of what was read, in the format that the suffix names."""


@runtime_checkable
class StreamMedium(Medium, Protocol):
    """A medium that passes frame by frame: videos, and sequences of pictures."""

    def open_clip(self, path: PathLike, /) -> AbstractContextManager[Clip]:
        """Open a clip for reading; it is closed when the block ends."""

    def writer(self, clip: Any, target: PathLike, /, *, force: bool = False) -> AbstractContextManager[Sink]:
        """Write a clip anew, with other frames, and with all else of it that the target can hold."""


class Clip(Protocol):
    """A medium that streams, opened."""

    @property
    def name(self) -> str:
        """As it can stand in a line of text."""

    @property
    def count(self) -> int:
        """How many frames there are."""

    @property
    def layout(self) -> Layout:
        """The layout of every frame: what its arrays are, one for each group of components."""

    @property
    def rotation(self) -> float:
        """By how many degrees frames are turned, counterclockwise, when they are shown."""

    @property
    def unpictured(self) -> tuple[str, ...]:
        """Streams that pictures of its frames leave out: sound, subtitles."""

    def frames(self) -> Iterator[Frame]:
        """Decode all frames, in the order in which they are shown."""

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        """Show a frame's samples as RGB of 8 bits, (H, W, 3), or of 16 if ``deep`` and it has more to give."""

    def info(self) -> dict[str, Any]:
        """Tell what a person may want to know."""


class ClipWarning(UserWarning):
    """Something of a clip is damaged, or does not come through."""


class CountError(Exception):
    """Decoding gave another number of frames than the packets promised: open the clip again with that number.

    Parameters
    ----------
    found : int
        How many frames there are.
    """

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
