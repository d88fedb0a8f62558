"""The writer of videos: it encodes frames, copies other streams, and keeps times."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
from av.filter import Graph

from supple.engine.work import Array
from supple.errors import SuppleError
from supple.media.base import FrameSource
from supple.media.codecs import STILLS, codec_of
from supple.media.files import PathLike, check_output, replacing, unwritable
from supple.media.sequence import Pictures
from supple.media.video.colour import BT709, FULL, RGB, Colour, filtered, recast, sited
from supple.media.video.demux import said, usual_step
from supple.media.video.plan import WritePlan, container_of, open_encoder
from supple.media.video.planes import form, pack
from supple.media.video.streams import Passage, kept_tags, titled

_FELT = Fraction(1, 4)  # of a frame: larger errors of time are reported


class Sink:
    """A sink of a video's frames; see `writer`."""

    aside = True

    def __init__(self, video: FrameSource, plan: WritePlan, temporary: Path) -> None:
        self._plan, self._video = plan, video
        self._colour = replace(video.colour, site=sited(video.colour, video.codec, video.form.kind))
        self._times: dict[int, tuple[int, int]] = {}

        self.copied = 0  # frames copied as packets of the source
        self._due: dict[int, av.Packet[Any] | None] = {}  # packets by stamp, in order; None while encoding
        self._blank = av.VideoFrame(video.width, video.height, plan.match.form.name)  # reused
        self._halved = False  # whether partial opacity has been warned of
        self._drift, self._origin = Fraction(0), Fraction(0)  # largest error of a time, and first time, in seconds
        self._tick: int | None = None
        self._newest = 0
        self._span = (0, 0)  # from the start of the first frame to the end of the last
        self._decoding: tuple[int, int] | None = None  # the first and the last decoding time of packets
        self._output = av.open(
            str(temporary),
            "w",
            format=plan.container.name,
            metadata_errors="surrogateescape",
            container_options=plan.muxing(),
        )
        try:
            self._stream = self._film()
            self.copies = self._may_copy()
            self._passage = Passage(video.source, video.index, self._output, plan.container, plan.target)
            video.passage, video.copies = self._passage, self.copies
            self._output.metadata.update(kept_tags(video.source.metadata if video.source else {}))
            if plan.timecode:  # MP4 stores it in the stream
                (self._stream if plan.container.mp4 else self._output).metadata["timecode"] = plan.timecode
            chapters = video.chapters()
            if chapters and plan.container.chapters:
                self._output.set_chapters(chapters)
            elif chapters:
                plan.warn("cannot hold the chapters of the source: they are left out")
            self._output.start_encoding()
        except BaseException:
            self.abort()
            raise

    def _film(self) -> av.VideoStream:
        plan, video = self._plan, self._video
        rate = video.rate.limit_denominator(1 << 20)
        stream = self._output.add_stream(plan.encoder.name, rate=rate)
        assert isinstance(stream, av.VideoStream)
        plan.settle(stream.codec_context, plan.match)
        stream.time_base = plan.base
        stream.metadata.update(titled(kept_tags(video.tags)))
        stream.disposition = video.disposition
        if video.matrix and plan.container.rotation:
            stream.set_display_matrix(video.matrix)
        if codec_of(plan.encoder.codec).opacity and plan.match.form.kind.alpha:
            stream.metadata["alpha_mode"] = "1"
        open_encoder(stream.codec_context)
        return stream

    def _may_copy(self) -> bool:
        """Return whether packets of the source and of the encoder may follow each other in one stream."""
        video, codec, context = self._video, self._plan.encoder.codec, self._stream.codec_context
        if not (codec_of(codec).alone and codec == video.codec and self._plan.match.same):
            return False
        # frames of DNxHD contain their header; its extradata differ, as MOV adds atoms
        alike = context.pix_fmt == video.form.name and (codec == "dnxhd" or (context.extradata or b"") == video.header)
        return alike and (codec not in ("prores", "dnxhd") or context.profile == video.profile)

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Encode frame `k` from arrays in the clip's layout, or copy its packet if `still`; frames come in order."""
        pts, duration = self._video.time(k)
        packet = self._video.packet(k)
        stamp = self._stamp(k, pts, duration)
        if self.copies:
            busy = None in self._due.values()
            self._due[stamp] = packet if still else None
            if still and packet is not None:
                self.copied += 1
                if not busy:
                    self._mux([])
                    return
                # While earlier frames are in the encoder, it is encoded too, which flushes them.
        frame = self._frame(arrays)
        frame.time_base = self._stream.codec_context.time_base  # filters set their own time base
        frame.pts = stamp
        self._mux(self._stream.encode(frame))

    def _frame(self, arrays: Sequence[Array]) -> av.VideoFrame:
        video, chosen = self._video, self._plan.match
        shape, colour = (video.height, video.width), self._colour
        if self._plan.depth:
            cut = (1 << video.form.kind.bits - chosen.form.kind.bits) - 1
            if any((each & cut).any() for each in arrays):
                self._plan.warn(self._plan.depth)
                self._plan.depth = ""
        if self._plan.encoder.name == "gif":
            opacity = arrays[0][..., -1]
            half = video.layout.groups[0].alpha and not self._halved
            if half and ((opacity > 0) & (opacity < video.layout.white)).any():
                self._halved = True
                self._plan.warn("has pixels that are seen or not: what is half transparent becomes one of these")
            return _paletted(recast(arrays, video.form, colour, form("bgra") or video.form, Colour(2, matrix=0), shape))
        if chosen.opacity and (arrays[0][..., -1] < video.layout.white).any():
            self._plan.warn("loses opacity")
            self._plan.match = chosen = replace(chosen, opacity=False)
        if chosen.same:
            frame = pack(arrays, chosen.form, self._blank)
            chosen.colour.mark(frame)
        else:
            frame = recast(arrays, video.form, colour, chosen.form, self._plan.colour, shape)
        tags = [("setfield", f"{self._plan.fields[0]}ff")] if self._plan.fields else []  # which one is shown first
        made = filtered(frame, *tags) if tags else frame
        assert made is not None
        return made

    def _stamp(self, k: int, pts: int, duration: int) -> int:
        """Return the time for the encoder, and record the time for the file."""
        plan = self._plan
        if plan.base != self._video.base:  # round each time to the container's ticks, independently of the others
            scale = self._video.base / plan.base
            start, end = round(pts * scale), round((pts + duration) * scale)
            start = start if self._tick is None else max(start, self._tick + 1)
            self._tick = start
            off = start * plan.base - pts * self._video.base
            self._origin = self._origin if k else off
            self._drift = max(self._drift, abs(off - self._origin))
            pts, duration = start, max(1, end - start)
        stamp = pts if plan.timed else k
        if self._newest in self._times:  # a frame lasts until the next one
            before = self._times[self._newest][0]
            unit, gap = self._stream.time_base, (pts - before) * plan.base
            if unit and gap > plan.container.longest * unit:  # the tick count would overflow
                what = f"frame {k} comes {float(gap):.0f} s after the one before, which is longer than it can say"
                raise unwritable(plan.target, what, "choose another container, such as .mkv")
            self._times[self._newest] = (before, pts - before)
        self._newest = stamp
        self._times[stamp] = (pts, duration)
        self._span = (self._span[0] if k else pts, pts + duration)
        return stamp

    def _mux(self, made: list[av.Packet[Any]], last: bool = False) -> None:
        """Write packets in the order of their frames: those of the encoder, and those of the source."""
        if not self.copies:
            self._write(made, last)
            return
        for packet in made:
            stamp = packet.pts
            if stamp is not None and self._due.get(stamp, packet) is None:
                self._due[stamp] = packet
        ready: list[av.Packet[Any]] = []
        for stamp, due in list(self._due.items()):
            if due is None:
                break
            del self._due[stamp]
            due.pts = due.dts = stamp
            ready.append(due)
        self._write(ready, last)

    def _write(self, packets: list[av.Packet[Any]], last: bool) -> None:
        plan = self._plan
        for packet in packets:
            stamp, decoded = packet.pts, packet.dts
            assert stamp is not None
            pts, duration = self._times[stamp]
            dts = decoded if plan.timed else self._decoded(decoded, pts)
            packet.pts, packet.dts, packet.duration, packet.time_base = pts, dts, duration, plan.base
            keep = stamp if decoded is None else min(decoded, stamp)
            for old in [key for key in self._times if key < keep]:
                del self._times[old]
            packet.stream = self._stream
            needed = pts if dts is None else dts
            self._decoding = (self._decoding[0] if self._decoding else needed, needed)
            if last and packet is packets[-1]:  # MP4's total duration is the sum over packets
                packet.duration = max(1, self._span[1] - self._span[0] - (needed - self._decoding[0]))
            self._passage.write(needed * plan.base)
            self._output.mux_one(packet)

    def _decoded(self, number: int | None, pts: int) -> int:
        """Return the decoding time of a packet whose encoder counts frames, from the frame `number` in its dts."""
        if number is None:
            return pts
        if number in self._times:
            return self._times[number][0]
        first = min(self._times)
        return self._times[first][0] + (number - first) * usual_step(self._video.rate, self._plan.base)

    def finish(self) -> None:
        """Write the remaining packets, and close the file."""
        self._mux(self._stream.encode(None), self._plan.container.mp4)
        for packet in self._video.rest():
            self._passage.take(packet)
            self._passage.write()
        self._passage.write()
        self._output.close()
        if self._plan.container.counted and self._drift * self._video.rate > _FELT:
            off = float(self._drift)
            self._plan.warn(f"has one frame rate, and frames are up to {off:.2g} s from their times: use .mkv or .mp4")

    def abort(self) -> None:
        """Close the file in any state."""
        with contextlib.suppress(av.FFmpegError, OSError, ValueError):
            self._output.close()


def _paletted(frame: av.VideoFrame) -> av.VideoFrame:
    """Return a frame of BGRA in 256 colours of its own."""
    graph = Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1, 100))
    split, palette, use = graph.add("split"), graph.add("palettegen", "stats_mode=single"), graph.add("paletteuse")
    split.link_to(palette, 1, 0)
    palette.link_to(use, 0, 1)
    graph.link_nodes(source, split, use, graph.add("buffersink")).configure()
    graph.vpush(frame)
    graph.vpush(None)
    return graph.vpull()


def _as_film(pictures: Pictures) -> None:
    """Set the pixel format and the colours of images; SuppleError if they are neither grey nor RGB.

    Their colours are assumed to be sRGB, and tagged with the primaries of BT.709; most players use one curve for both.
    """
    group = pictures.layout.groups[0]
    count, known = group.channels, STILLS[pictures.layout.dtype.name]
    if pictures.extra == (1,):
        what = "colours that are multiplied by their opacity (A), which films do not"
        raise SuppleError(f"{pictures.name} holds {what}: write pictures, or leave A out")
    if count > len(known) or group.alpha == bool(count % 2) or pictures.interpretation in ("cmyk", "lab"):
        raise SuppleError(f"{pictures.name} holds neither grey nor RGB pictures: convert them first")
    found = form(known[count - 1])
    assert found is not None
    pictures.form, pictures.colour = found, Colour(FULL, BT709, BT709, RGB)
    profile = pictures.picture(0)[0].icc
    if profile and b"sRGB" not in profile and "sRGB".encode("utf-16-be") not in profile:
        pictures.unheld = ("the colour profile of the pictures",)


@contextlib.contextmanager
def writer(
    video: FrameSource,
    target: PathLike,
    *,
    force: bool = False,
    **settings: Any,
) -> Iterator[Sink]:
    """Write a clip with new frames and its other streams; or write images as a video.

    Call the sink's ``write(arrays, k)`` for k = 0, 1, 2, …; for a video, after ``frames`` has yielded frame k.
    SuppleError if an option is not supported, or the file cannot be written; a `ClipWarning` if a part of the source
    cannot be kept. Images get a constant rate; their opacity is kept if the codec supports it.

    The suffix of ``target`` chooses MP4, MOV, MKV, WebM, AVI or GIF; ``settings`` are those of `WritePlan`.
    """
    container_of(target)
    check_output(target, force=force)
    if isinstance(video, Pictures):
        _as_film(video)
    plan = WritePlan(video, target, **settings)
    with replacing(target, force=force) as temporary:
        sink = None
        try:
            sink = Sink(video, plan, temporary)
            yield sink
            sink.finish()
        except av.FFmpegError as error:
            if isinstance(error, OSError) and error.errno:
                raise OSError(error.errno, os.strerror(error.errno)) from error
            what = f"the container refuses what it is given ({said(error)})"
            raise unwritable(plan.target, what, "choose another one, such as .mkv") from error
        finally:
            video.passage, video.copies = None, False
            if sink is not None:
                sink.abort()
