"""The properties of a clip that is to be written as a video: of a video, or of images."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av

from supple.engine.work import Layout
from supple.errors import SuppleError
from supple.media.codecs import STILLS
from supple.media.sequence import Pictures
from supple.media.video.colour import BT709, FULL, RGB, Colour, Grading
from supple.media.video.planes import Form, form
from supple.media.video.streams import Passage


class VideoSource:
    """The source of a video to be written; properties without a counterpart in images are empty here."""

    layout: Layout  # with the chroma siting of `supple.media.video.colour.siting`
    form: Form  # the pixel format of frames in that layout
    colour: Colour  # the interpretation of samples
    count: int  # of frames
    stills = False  # whether it consists of images: then any format that players support is used
    unheld: tuple[str, ...] = ()  # contents that no video file can hold, for messages
    codec, profile, lossless, index = "", "", False, -1
    field_order = 1  # the order in which fields are coded and shown: AVFieldOrder
    fields = ""  # the field of interlaced frames that is shown first, "top" or "bottom"
    timecode = ""  # of the first frame
    plays: int | None = None  # the number of times that an animation plays; 0 for ever
    header = b""  # the stream header (extradata), which a decoder needs
    pace = Fraction(0)  # ticks a second in which all times are integers, as far as can be inferred
    aspect: Fraction | None = None
    grading = Grading()
    source: av.container.InputContainer | None = None
    passage: Passage | None = None  # receives the packets of other streams during writing
    display: tuple[int, int, int, int] | None = None
    copies = False  # whether packets of frames are kept for copying

    def __init__(self, name: str, rate: Fraction, base: Fraction) -> None:
        self.name, self.rate, self.base = name, rate, base
        self.tags: dict[str, str] = {}
        self.disposition = av.stream.Disposition(0)
        self.matrix: list[int] = []

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
        return k, 1

    def packet(self, k: int) -> av.Packet[Any] | None:
        """Return the packet of frame `k` alone, or None; call it once for each frame, in order."""
        return None

    def chapters(self) -> list[Any]:
        """Return the chapters of the file."""
        return list(self.source.chapters()) if self.source else []

    def rest(self) -> Iterator[av.Packet[Any]]:
        """Read the packets of other streams that come after the last of the film."""
        return iter(())


class Stills(VideoSource):
    """Images as a video; SuppleError if they are neither grey nor RGB.

    Their colours are assumed to be sRGB, and tagged with the primaries of BT.709; most players use one curve for both.
    """

    stills = True

    def __init__(self, pictures: Pictures) -> None:
        super().__init__(pictures.name, pictures.rate, pictures.base)
        self.layout, self.count, group = pictures.layout, pictures.count, pictures.layout.groups[0]
        count, known = group.channels, STILLS[self.layout.dtype.name]
        if pictures.extra == (1,):
            what = "colours that are multiplied by their opacity (A), which films do not"
            raise SuppleError(f"{self.name} holds {what}: write pictures, or leave A out")
        if count > len(known) or group.alpha == bool(count % 2) or pictures.interpretation in ("cmyk", "lab"):
            raise SuppleError(f"{self.name} holds neither grey nor RGB pictures: convert them first")
        found = form(known[count - 1])
        assert found is not None
        self.form, self.colour = found, Colour(FULL, BT709, BT709, RGB)
        self._time, self.plays, self.aspect = pictures.time, pictures.plays, pictures.aspect
        profile = pictures.picture(0)[0].icc
        if profile and b"sRGB" not in profile and "sRGB".encode("utf-16-be") not in profile:
            self.unheld = ("the colour profile of the pictures",)

    def time(self, k: int) -> tuple[int, int]:
        """Return the start and the duration of frame `k` in ticks of `base`."""
        return self._time(k)
