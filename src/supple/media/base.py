"""Frames of open videos and image sequences, and their warning and error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from supple.engine.work import Array, Layout

if TYPE_CHECKING:
    import av


@dataclass(frozen=True, slots=True)
class LazyFrame:
    """A frame that is read or unpacked only when it is copied into arrays."""

    copy_to: Callable[[Sequence[Array]], None]


class FrameSource:
    """The properties of a clip, and what a video that is written takes over; empty without a counterpart in images."""

    name: str
    rate: Fraction  # frames a second
    base: Fraction  # the unit of `time`, in seconds
    layout: Layout  # with the chroma siting of `supple.media.video.colour.siting`
    count: int  # of frames
    form: Any  # the pixel format of frames in that layout, as in `supple.media.video.planes`
    colour: Any  # the interpretation of samples; this and `grading` are as in `supple.media.video.colour`
    stills = False  # whether it consists of images: then any format that players support is used
    unheld: tuple[str, ...] = ()  # contents that no video file can hold, for messages
    codec, profile, lossless, index = "", "", False, -1
    rotation, mirrored = 0.0, False  # for display: degrees counterclockwise, after frames are mirrored left to right
    field_order = 1  # the order in which fields are coded and shown: AVFieldOrder
    fields = ""  # the field of interlaced frames that is shown first, "top" or "bottom"
    timecode = ""  # of the first frame
    plays: int | None = None  # the number of times that an animation plays, 0 for ever; None for others
    header = b""  # the stream header (extradata), which a decoder needs
    pace = Fraction(0)  # ticks a second in which all times are integers, as far as can be inferred
    aspect: Fraction | None = None  # the width of a pixel, relative to its height
    grading: Any = None
    source: av.container.InputContainer | None = None
    passage: Any = None  # receives the packets of other streams during writing
    # the display window, to which points are relative: x and y of its first pixel, width and height; or None
    display: tuple[int, int, int, int] | None = None
    copies = False  # whether packets of frames are kept for copying
    tags: Mapping[str, str] = MappingProxyType({})  # the metadata of the film
    disposition: Any = 0
    matrix: Sequence[int] = ()

    @property
    def width(self) -> int:
        """The width of a stored frame, before any rotation for display."""
        return self.layout.shape[1]

    @property
    def height(self) -> int:
        """The height of a stored frame."""
        return self.layout.shape[0]

    def time(self, k: int) -> tuple[int, int]:
        """Return the start and the duration of frame `k` in ticks of `base`."""
        raise NotImplementedError

    def packet(self, k: int) -> av.Packet[Any] | None:
        """Return the packet of frame `k` alone, or None; call it once for each frame, in order."""
        return None

    def chapters(self) -> list[Any]:
        """Return the chapters of the file."""
        return list(self.source.chapters()) if self.source else []

    def rest(self) -> Iterator[av.Packet[Any]]:
        """Read the packets of other streams that come after the last of the film."""
        return iter(())


class ClipWarning(UserWarning):
    """A part of a clip is damaged, or cannot be kept."""


class CountError(Exception):
    """The number of decoded frames differs from that of the packets: open the clip again with ``found``."""

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
