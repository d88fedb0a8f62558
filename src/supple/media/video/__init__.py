"""Video files: frames are decoded in order, as planes of the stored pixel format, and encoded again."""

from __future__ import annotations

import contextlib
import itertools
import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

from supple.errors import need, shown, warn

need("video", "videos and image sequences", "av")

import av
import numpy as np

from supple._core import threads as all_threads
from supple.engine.work import Array
from supple.media.base import ClipWarning, CountError, FrameSource, LazyFrame
from supple.media.codecs import codec_of
from supple.media.files import PathLike, unreadable
from supple.media.video import demux
from supple.media.video.colour import (
    Colour,
    black,
    described,
    first_field,
    graded,
    named_site,
    painted,
    side_data,
    sited,
    siting,
    to_rgb,
)
from supple.media.video.encode import writer
from supple.media.video.plan import container_of
from supple.media.video.planes import form, palette, unpack, wider
from supple.media.video.streams import named

_COPY = "give a whole copy of it"
_LEAST, _UTMOST = Fraction(1, 10_000), Fraction(100_000)
_FINEST = 1 << 31  # ticks a second
_MOST = 1000  # frames a second; higher rates are tick counts


class Clip(FrameSource):
    """An open video file: its main video stream, called the film, and its other streams; see `open_clip`."""

    codec: str  # such as "h264"
    pixel_format: str  # as it is decoded, such as "yuv420p"
    source: av.container.InputContainer

    def __init__(self, path: PathLike, threads: int | None, count: int | None) -> None:
        self._threads = threads or all_threads()
        self._pump: Iterator[av.Packet[Any]] | None = None
        self._times: list[tuple[int, int]] = []  # start and duration of the frames that were decoded, in ticks
        self._packets: deque[av.Packet[Any] | None] = deque()
        self._fresh = True
        self._sturdy = count is not None
        with demux.opened(path) as container:
            film = demux.chosen(container, path)
            self.codec = film.codec_context.codec.canonical_name
            counted, first = demux.survey(container, film, self._decoder(film, 1))
        if first is None:
            raise unreadable(path, "no frame of it can be decoded", _COPY)
        self._sturdy |= counted.suspect
        self.path, self.survey, self.source = path, counted, demux.opened(path)
        self.count = counted.count if count is None else count
        self._keys = counted.keys if len(counted.times) == self.count else ()
        try:
            film = demux.chosen(self.source, path)
            self.name, self.rate, self.base = shown(path), _rate(film, counted), film.time_base or Fraction(1, 1000)
            self._read_facts(film)
            self._look(first)
            self._told = counted.count
            if counted.damaged and count is None:
                try:
                    deque(self.frames_from(self.count - 1), 0)
                except CountError as cut:  # a packet that is not whole may be no frame
                    self.count = self._told = cut.found
        except BaseException:
            self.source.close()
            raise
        if counted.damaged and count is None:
            how_much = f"{self._lost(self._told)}: " if counted.missing else ""
            what = f"is damaged or cut short: {how_much}what can be decoded of it is used"
            warn(f"{self.name} {what}", ClipWarning)

    def _read_facts(self, film: av.VideoStream) -> None:
        self.index = film.index
        context = film.codec_context
        self.lossless = context.codec.lossless and not context.codec.lossy
        self.tags, self.disposition = dict(film.metadata), film.disposition
        self.field_order, self.profile = context.field_order, context.profile or ""
        tagged = [film, *(stream for stream in self.source.streams if stream.type == "data"), self.source]
        self.timecode = next((found for each in tagged if (found := said_of(each, "timecode"))), "")
        self.plays, delays = demux.animation_of(self.source)
        unit = math.lcm(*(each.denominator for each in delays))
        self._starts: list[int] = []  # and the end, if durations are exact
        if delays and len(delays) == self.count and unit < _FINEST:
            self.base, self.rate = Fraction(1, unit), self.count / sum(delays, Fraction(0))
            self._starts = [int(start * unit) for start in itertools.accumulate(delays, initial=Fraction(0))]
        header = context.extradata or b""
        self.header = b"" if header == context.codec_tag.encode("latin-1", "replace") else header  # ProRes in Matroska
        self.pace = Fraction(film.base_rate or 0)
        aspect = film.sample_aspect_ratio
        self.aspect = aspect if aspect and aspect > 0 else None
        self._site = named_site(described(self.source, film.index))

    def _look(self, frame: av.VideoFrame) -> None:
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
        # frames store which field is shown first; streams or containers store the order in which fields are coded
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

    def _decoder(self, film: av.VideoStream, count: int) -> av.VideoCodecContext:
        context = film.codec_context
        if (other := codec_of(self.codec).opacity) and said_of(film, "alpha_mode") == "1":
            with contextlib.suppress(ValueError):
                made = av.CodecContext.create(other, "r")
                assert isinstance(made, av.VideoCodecContext)
                context = made
        context.thread_count = count
        # with threads by frame, a damaged frame damages others
        context.thread_type = "SLICE" if self._sturdy else "AUTO"
        return context

    def _lost(self, found: int) -> str:
        """Return a description of the lost frames, for messages."""
        promised = self.survey.count + self.survey.missing
        lost, whole = (float(number / self.rate) for number in (promised - found, promised))
        be = "is" if promised - found == 1 else "are"
        return f"{promised - found} of its {promised} frames ({lost:.2f} of {whole:.2f} s) {be} lost"

    def time(self, k: int) -> tuple[int, int]:
        """Return the start and the duration of frame `k` in ticks of `base`, after it was decoded."""
        return (self._starts[k], self._starts[k + 1] - self._starts[k]) if self._starts else self._times[k]

    def packet(self, k: int) -> av.Packet[Any] | None:
        """Return the packet of frame `k` alone, or None; call it once for each frame, in order."""
        return self._packets.popleft() if self._packets else None

    def frames(self) -> Iterator[LazyFrame]:
        """Decode all frames in display order, once; while a writer is open, packets of other streams go to it.

        SuppleError if a frame has another size or pixel format than the first; CountError if there are more or fewer
        than `count`, beyond which none is yielded.
        """
        if not self._fresh:
            self.source.close()
            self.source = demux.opened(self.path)
        self._fresh = False
        film = demux.chosen(self.source, self.path)
        others = [self.source.streams[index] for index in self.passage.streams] if self.passage else []
        times = self._times = []
        usual = demux.usual_step(self.rate, self.base)
        counted = demux.is_counted(self.source)
        shown_at: deque[int] = deque()
        copies = self.copies
        sent: dict[int | None, av.Packet[Any] | None] = {}  # packets in the decoder, by pts; None if ambiguous
        self._packets.clear()
        found = bad = 0
        self._pump = demux.packets(self.source, [film, *others])
        decoder = self._decoder(film, self._threads)
        for packet in self._film_packets(film.index):
            if packet is not None and counted and packet.dts is not None:
                shown_at.append(packet.dts)
            if copies and packet and packet.pts is not None and packet.is_keyframe and not packet.is_corrupt:
                sent[packet.pts] = None if packet.pts in sent else packet  # two packets of one pts are ambiguous
            decoded = demux.decoded_by(decoder, packet)
            if decoded is None:
                bad += 1
                continue
            for frame in decoded:
                bad += frame.is_corrupt
                self._check(frame, found)
                found += 1
                if found <= self.count:
                    lasts = frame.duration if frame.duration and frame.duration > 0 else usual
                    if found == self.count and demux.sums_up(self.source) and frame.pts is not None and times:
                        left = round(self.survey.duration / self.base) - (frame.pts - times[0][0])
                        lasts = left if left > 0 else lasts
                    pts = shown_at.popleft() if shown_at else frame.pts
                    start = sum(times[-1] if times else ()) if pts is None else pts
                    times.append((max(start, times[-1][0] + 1) if times else start, lasts))  # starts ascend
                    if copies:
                        made_of = sent.pop(frame.pts, None)
                        self._packets.append(None if frame.is_corrupt else made_of)
                    yield self._lazy(frame)
        if found == 0:
            raise unreadable(self.path, "no frame of it can be decoded", _COPY)
        if found != self.count:
            raise CountError(found)
        lost = found < self._told
        if bad and (lost or not self.survey.damaged):
            how_much = f"{self._lost(found)}: " if lost else ""
            what = f"has {bad} damaged frame{'s' * (bad > 1)}: {how_much}what can be decoded is used"
            warn(f"{self.name} {what}", ClipWarning)

    def key_before(self, k: int) -> int:
        """Return the key frame from which decoding must begin for frame `k`; 0 if times do not identify frames."""
        found = bisect_right(self._keys, k)
        return self._keys[found - 1] if found else 0

    def frames_from(self, k: int) -> Iterator[tuple[int, LazyFrame]]:
        """Decode from frame `k` on, beginning at the key frame before it; yield frames with their numbers.

        If the frames do not match the times of packets, it decodes from the start.
        """
        due, times = self.key_before(k), self.survey.times
        if due:
            start = times[due]
            for pts, picture in self._sought(start):  # closed when the generator is dropped
                if pts is not None and pts < start:
                    continue  # shown before the key frame, and lacks its references
                if due == self.count or pts != times[due]:
                    break
                if due >= k:
                    yield due, picture
                due += 1
            if due == self.count:
                return
            self._keys = ()  # the times are wrong
        for number, picture in enumerate(self.frames()):
            if number >= max(due, k):
                yield number, picture

    def _sought(self, start: int) -> Iterator[tuple[int | None, LazyFrame]]:
        """Yield frames with their pts from a key frame on, read by a second container; nothing if seeking fails."""
        with demux.opened(self.path) as container, contextlib.suppress(av.FFmpegError):
            film = demux.chosen(container, self.path)
            container.seek(start, stream=film)
            decoder, fresh = self._decoder(film, self._threads), True
            for packet in itertools.chain(demux.packets(container, [film]), [None]):
                if fresh and (packet is None or not packet.is_keyframe or packet.pts != start):
                    return
                fresh = False
                decoded = demux.decoded_by(decoder, packet)
                if decoded is None:
                    return
                for frame in decoded:
                    self._check(frame)
                    yield frame.pts, self._lazy(frame)

    def _film_packets(self, index: int) -> Iterator[av.Packet[Any] | None]:
        """Yield the packets of the film, then None; pass those of other streams to the writer."""
        left = self.survey.packets
        assert self._pump is not None
        for packet in self._pump:
            if packet.stream_index != index:
                if self.passage:
                    self.passage.take(packet)
                continue
            if packet.size:
                yield packet
                left -= 1
            if left <= 0:  # the rest is read by the writer when the film is finished
                break
        yield None

    def rest(self) -> Iterator[av.Packet[Any]]:
        """Read the packets of other streams that come after the last of the film."""
        for packet in self._pump or ():
            if packet.stream_index != self.index:
                yield packet

    def _check(self, frame: av.VideoFrame, k: int | str = "") -> None:
        now = f"{frame.width}x{frame.height} {frame.format.name}"
        first = f"{self.width}x{self.height} {self.pixel_format}"
        if now != first:  # decoders drop delayed frames at a change, so the number is inexact
            what = f"its frames change at about frame {k}, from {first} to {now}"
            raise unreadable(self.path, what, "cut it where they do, and warp the parts")

    def _lazy(self, frame: av.VideoFrame) -> LazyFrame:
        if frame.format.has_palette:
            return LazyFrame(lambda arrays: np.copyto(arrays[0], palette(frame)[..., : arrays[0].shape[-1]]))
        if frame.format.name != self.form.name:
            frame = frame.reformat(format=self.form.name, src_color_range=2, dst_color_range=2)
        return LazyFrame(lambda arrays: unpack(frame, self.form, arrays))

    @property
    def unpictured(self) -> tuple[str, ...]:
        """The streams that are lost when frames are written as images."""
        held = {stream.type for stream in self.source.streams}
        found = [name for kind, name in (("audio", "sound"), ("subtitle", "subtitles")) if kind in held]
        return (*found, *(["timecode"] if self.timecode else []))

    def upright(self, pixels: Array) -> Array:
        """Return a view of a frame's pixels, (H, W, …), as it is displayed: mirrored, and turned by quarters."""
        return np.rot90(pixels[:, ::-1] if self.mirrored else pixels, round(self.rotation / 90))

    def painted(self, values: Sequence[float]) -> tuple[float, ...]:
        """Convert a grey or RGB colour in the clip's depth, with or without opacity, to components of the layout."""
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
            **{name: getattr(self, name) for name in ("codec", "width", "height")},
            "frames": self.count,
            "rate": self.rate,
            "variable": bool(self.survey.starts),
            "duration": float(seen),
            "pixel_format": self.pixel_format,
            "bits": kind.bits,
            "alpha": kind.alpha,
            "range": {1: "limited", 2: "full"}.get(self.colour.range, "unknown"),
            **{name: getattr(self.colour, name) for name in ("primaries", "transfer", "matrix")},
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

    writer = writer

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        """Return a frame as RGB of 8 bits, or of 16 if `deep`: (H, W, 3), as stored, without rotation."""
        colour = replace(self.colour, site=sited(self.colour, self.codec, self.form.kind))
        return to_rgb(arrays, self.form, colour, self.layout.shape, deep)


def said_of(film: Any, key: str) -> str | None:
    """Return metadata of a stream or a file by its key, ignoring case; None if missing."""
    return next((value for name, value in film.metadata.items() if name.lower() == key), None)


def _rate(film: av.VideoStream, counted: demux.Survey) -> Fraction:
    for rate in (film.average_rate, film.guessed_rate, film.base_rate):
        if rate and _LEAST <= rate <= _MOST:
            return Fraction(rate)
    if counted.duration > 0 and counted.count:
        return min(max(_LEAST, (counted.count / counted.duration).limit_denominator(1001)), _UTMOST)
    return Fraction(25)


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a name whose suffix is not in `supple.media.suffixes.CLIPS_OUT`, nor ``.m4v``."""
    container_of(path)


@contextlib.contextmanager
def open_clip(path: PathLike, *, threads: int | None = None, count: int | None = None) -> Iterator[Clip]:
    """Open a video file that FFmpeg reads: its first film, not a cover image; it is closed when the block ends.

    ``threads`` are those of the decoder, and ``count`` is the number of frames, from a `CountError`. SuppleError if the
    file is missing, empty, damaged or holds no film; a `ClipWarning` if it is damaged, but partly usable.
    """
    clip = Clip(path, threads, count)
    try:
        yield clip
    finally:
        clip.source.close()


def info(path: PathLike) -> dict[str, Any]:
    """Return the facts on a video file, decoding at most one frame."""
    with open_clip(path) as clip:
        return clip.info()
