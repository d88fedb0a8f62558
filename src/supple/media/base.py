"""The interface that open videos and image sequences share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

from supple.engine.stream import Frame
from supple.engine.work import Array, Layout


@dataclass(frozen=True, slots=True)
class LazyFrame:
    """A frame that is read or unpacked only when it is copied into arrays."""

    copy_to: Callable[[Sequence[Array]], None]


class Clip(Protocol):
    """An open video or image sequence, whose frames are read in order."""

    @property
    def name(self) -> str:
        """The name for messages."""

    @property
    def count(self) -> int:
        """The number of frames."""

    @property
    def rate(self) -> Fraction:
        """Frames a second, on average."""

    @property
    def base(self) -> Fraction:
        """The unit of `time`, in seconds."""

    @property
    def plays(self) -> int | None:
        """The number of times that an animation plays, 0 for ever; None for other clips."""

    @property
    def layout(self) -> Layout:
        """The layout of every frame: its arrays, one for each group of components."""

    @property
    def rotation(self) -> float:
        """The rotation of frames for display, in degrees counterclockwise, after they are mirrored."""

    @property
    def mirrored(self) -> bool:
        """True if frames are mirrored for display, left to right, before they are rotated."""

    @property
    def aspect(self) -> Fraction | None:
        """The width of a pixel, relative to its height, before frames are rotated; None if the file does not say."""

    @property
    def fields(self) -> str:
        """The field of interlaced frames that is shown first, ``"top"`` or ``"bottom"``; else empty."""

    @property
    def display(self) -> tuple[int, int, int, int] | None:
        """The display window, to which points are relative: x and y of its first pixel, width and height; or None."""

    @property
    def unpictured(self) -> tuple[str, ...]:
        """The streams that are lost when frames are written as images: sound, subtitles."""

    def frames(self) -> Iterator[Frame]:
        """Decode all frames, in display order."""

    def time(self, k: int) -> tuple[int, int]:
        """Return start and duration of frame ``k`` in ticks of `base`; call it once, in order, after reading it."""

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        """Return a frame as RGB of 8 bits, (H, W, 3), or of 16 if ``deep`` and the frame has more than 8."""

    def upright(self, pixels: Array) -> Array:
        """Return a view of a frame's pixels, (H, W, …), as it is displayed: mirrored, and turned by quarters."""

    def info(self) -> dict[str, Any]:
        """Return the facts for users."""


class ClipWarning(UserWarning):
    """A part of a clip is damaged, or cannot be kept."""


class CountError(Exception):
    """The number of decoded frames differs from that of the packets: open the clip again with ``found``."""

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
