"""The properties of a video before decoding, and of images to be encoded as one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import av
import numpy as np

from supple.engine.work import Array, Layout
from supple.errors import SuppleError, shown
from supple.media.codecs import STILLS
from supple.media.files import PathLike
from supple.media.sequence import Pictures
from supple.media.video.colour import (
    BT709,
    FULL,
    RGB,
    Colour,
    Grading,
    black,
    described,
    first_field,
    graded,
    named_site,
    painted,
    side_data,
    sited,
    siting,
)
from supple.media.video.demux import Survey, chosen, plays_of
from supple.media.video.planes import Form, form, palette, wider
from supple.media.video.streams import Passage, named

_LEAST, _UTMOST = Fraction(1, 10_000), Fraction(100_000)
_MOST = 1000  # frames a second; higher rates are tick counts


class VideoSource:
    """The source of a video to be written; properties without a counterpart in images are empty here."""

    layout: Layout  # its chroma siting is from `supple.media.video.colour.siting`
    form: Form  # the pixel format of frames in that layout
    colour: Colour  # the interpretation of samples
    count: int  # of frames
    stills = False  # whether it consists of images, so that any format of players will do
    unheld: tuple[str, ...] = ()  # contents that no video file holds
    codec, profile, lossless, index = "", "", False, -1
    field_order = 1  # of interlaced frames, as the stream codes and shows them: AVFieldOrder
    fields = ""  # the field of interlaced frames that is shown first, "top" or "bottom"
    timecode = ""  # of the first frame
    plays: int | None = None  # how often an animation plays; 0 for ever
    header = b""  # the stream header (extradata), which a decoder needs
    pace = Fraction(0)  # ticks a second in which all times are integers, as far as can be inferred
    aspect: Fraction | None = None
    grading = Grading()
    source: av.container.InputContainer | None = None
    passage: Passage | None = None  # receives the packets of other streams during writing
    display: tuple[int, int, int, int] | None = None
    copies = False  # whether packets of frames are kept, to be copied

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
        """Return the start and the duration of frame `k` in ticks of `base`, once, in order."""
        return k, 1

    def packet(self, k: int) -> av.Packet[Any] | None:
        """Return the packet that frame `k` alone was decoded from, once, in order; None if there is none."""
        return None

    def chapters(self) -> list[Any]:
        """Return the chapters of the file."""
        return list(self.source.chapters()) if self.source else []

    def rest(self) -> Iterator[av.Packet[Any]]:
        """Read the packets of other streams that come after the last of the film."""
        return iter(())


class Stills(VideoSource):
    """Images, as a film; SuppleError if they are neither grey nor RGB.

    Their colours are taken as sRGB, with the primaries of BT.709. Most players use one curve for both.
    """

    stills = True

    def __init__(self, pictures: Pictures) -> None:
        super().__init__(pictures.name, pictures.rate, 1 / pictures.rate)
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
        self._starts, self.plays, self.aspect = pictures.starts, pictures.plays, pictures.aspect
        if self._starts:
            self.base = Fraction(1, 1000)
        profile = pictures.picture(0)[0].icc
        if profile and b"sRGB" not in profile and "sRGB".encode("utf-16-be") not in profile:
            self.unheld = ("the colour profile of the pictures",)

    def time(self, k: int) -> tuple[int, int]:
        """Return the start and the duration of frame `k` in ticks of `base`."""
        return (self._starts[k], self._starts[k + 1] - self._starts[k]) if self._starts else (k, 1)


class VideoFile(VideoSource):
    """The film in a video file, and its other contents."""

    codec: str  # such as "h264"
    pixel_format: str  # as it is decoded, such as "yuv420p"
    source: av.container.InputContainer

    def __init__(self, path: PathLike, source: av.container.InputContainer, survey: Survey, count: int | None) -> None:
        film = chosen(source, path)
        super().__init__(shown(path), _rate(film, survey), film.time_base or Fraction(1, 1000))
        self.path, self.source, self.survey = path, source, survey
        self.count = survey.count if count is None else count
        self._read_facts(film)

    def _read_facts(self, film: av.VideoStream) -> None:
        self.index = film.index
        context = film.codec_context
        self.codec, self.lossless = context.codec.canonical_name, context.codec.lossless and not context.codec.lossy
        self.tags, self.disposition = dict(film.metadata), film.disposition
        self.field_order, self.profile = context.field_order, context.profile or ""
        tagged = [film, *(stream for stream in self.source.streams if stream.type == "data"), self.source]
        self.timecode = next((found for each in tagged if (found := said_of(each, "timecode"))), "")
        self.plays = plays_of(self.source)
        header = context.extradata or b""
        self.header = b"" if header == context.codec_tag.encode("latin-1", "replace") else header  # ProRes in Matroska
        self.pace = Fraction(film.base_rate or 0)
        aspect = film.sample_aspect_ratio
        self.aspect = aspect if aspect and aspect > 0 else None
        self._site = named_site(described(self.source, film.index))

    def look(self, frame: av.VideoFrame) -> None:
        """Set the properties of all frames from the first."""
        self.pixel_format = frame.format.name
        self.colour = Colour(
            int(frame.color_range),
            int(frame.color_primaries),
            int(frame.color_trc),
            int(frame.colorspace),
            self._site,
        )
        self.grading = graded(frame)
        matrix = side_data(frame, "DISPLAYMATRIX")
        turned = [int(value) for value in np.frombuffer(matrix, "=i4")] if matrix else []
        self.matrix = turned if turned != [65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30] else []
        a, b, _, c, d, *_ = turned or [1, 0, 0, 0, 1, 0]
        self.mirrored = a * d < b * c
        sign = -1 if self.mirrored else 1
        self.rotation = -round(math.degrees(math.atan2(sign * b, sign * a)))
        # the frame knows what is shown first, and the stream, or the container, in which order fields are coded
        self.fields = first_field(frame) or {2: "top", 3: "bottom", 4: "bottom", 5: "top"}.get(self.field_order, "")
        if self.fields and self.field_order < 2:
            self.field_order = 2 if self.fields == "top" else 3
        found = form(self.pixel_format)
        if found is None and frame.format.has_palette:
            opaque = (palette(frame)[..., 3] == 255).all()
            found = form("rgb24" if opaque else "rgba")
        elif found is None:
            found = form(wider(self.pixel_format))
        assert found is not None
        self.form = found
        offset = siting(sited(self.colour, self.codec, found.kind), found.kind)
        layout = found.kind.layout(frame.width, frame.height, offset)
        self.layout = replace(layout, black=black(found, self.colour))

    @property
    def unpictured(self) -> tuple[str, ...]:
        """Streams that have no place in images of its frames."""
        held = {stream.type for stream in self.source.streams}
        found = [name for kind, name in (("audio", "sound"), ("subtitle", "subtitles")) if kind in held]
        return (*found, *(["timecode"] if self.timecode else []))

    def upright(self, pixels: Array) -> Array:
        """Return a view of a frame's pixels, (H, W, …), as it is displayed: mirrored, and turned by quarters."""
        return np.rot90(pixels[:, ::-1] if self.mirrored else pixels, round(self.rotation / 90))

    def painted(self, values: Sequence[float]) -> tuple[float, ...]:
        """Convert grey or RGB, in the depth of the clip, and opacity, to components of the layout."""
        return painted(self.form, self.colour, self.height, values)

    def info(self) -> dict[str, Any]:
        """Return the facts for users."""
        seen = self.survey.duration or Fraction(self.count) / self.rate
        names: dict[str, list[str]] = {"audio": [], "subtitle": [], "other": []}
        for stream in self.source.streams:
            if stream.index != self.index:
                codec, tongue = named(self.source, stream), stream.metadata.get("language", "und")
                sort = stream.type if stream.type in names else "other"
                names[sort].append(codec if tongue == "und" else f"{codec} ({tongue})")
        kind = self.form.kind
        return {
            "container": self.source.format.name,
            "codec": self.codec,
            "width": self.width,
            "height": self.height,
            "frames": self.count,
            "rate": self.rate,
            "variable": self.survey.variable,
            "duration": float(seen),
            "pixel_format": self.pixel_format,
            "bits": kind.bits,
            "alpha": kind.alpha,
            "range": {1: "limited", 2: "full"}.get(self.colour.range, "unknown"),
            "primaries": self.colour.primaries,
            "transfer": self.colour.transfer,
            "matrix": self.colour.matrix,
            "siting": self.colour.site or "unknown",
            "rotation": self.rotation,
            "mirrored": self.mirrored,
            "aspect": self.aspect or Fraction(1),
            "interlaced": bool(self.fields),
            "fields": self.fields or None,
            "timecode": self.timecode or None,
            "plays": self.plays,
            "damaged": self.survey.damaged,
            "audio": names["audio"],
            "subtitles": names["subtitle"],
            "other": names["other"],
            "chapters": len(self.chapters()),
        }


def said_of(film: Any, key: str) -> str | None:
    """Return metadata of a stream or a file, for any case of its key."""
    return next((value for name, value in film.metadata.items() if name.lower() == key), None)


def _rate(film: av.VideoStream, counted: Survey) -> Fraction:
    for rate in (film.average_rate, film.guessed_rate, film.base_rate):
        if rate and _LEAST <= rate <= _MOST:
            return Fraction(rate)
    if counted.duration > 0 and counted.count:
        return min(max(_LEAST, (counted.count / counted.duration).limit_denominator(1001)), _UTMOST)
    return Fraction(25)
