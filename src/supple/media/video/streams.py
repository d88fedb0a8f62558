"""Sound, subtitles, attachments: streams copied from one file to another."""

from __future__ import annotations

import contextlib
import io
import re
from collections import deque
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import av

from supple.errors import shown, warn
from supple.media.base import ClipWarning
from supple.media.codecs import Container
from supple.media.files import PathLike
from supple.media.video.colour import described

_HELD = 64 << 20  # bytes of packets that may wait for the film; beyond it, they are written early
# tags that describe the file, not its contents
_OWN = frozenset(
    ("encoder", "duration", "timecode", "major_brand", "minor_version", "compatible_brands", "rotate", "alpha_mode")
)
# names of data streams, by their FourCC
_DATA = {
    "gpmd": "GoPro telemetry (GPMF)", "fdsc": "GoPro file description", "djmd": "DJI metadata",
    "dbgi": "DJI debug data", "mebx": "timed metadata of Apple", "rtmd": "Sony metadata (RTMD)",
    "camm": "camera motion metadata (CAMM)", "KLVA": "KLV metadata", "ID3 ": "timed ID3 metadata",
    "tmcd": "timecode", "text": "text of chapters",
}  # fmt: skip
_FELT = Fraction(1, 50)  # seconds: a larger error between image and sound is reported
_COUNTED = ("_STATISTICS", "BPS", "NUMBER_OF_", "DURATION")


def titled(tags: Mapping[str, str]) -> dict[str, str]:
    """Return tags with a stream's title under the key that muxers use; MP4's demuxer returns it under another one."""
    return {"title" if key == "name" and "title" not in tags else key: value for key, value in tags.items()}


def kept_tags(tags: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata that also hold for another file with the same contents."""
    return {key: value for key, value in tags.items() if key.lower() not in _OWN and not key.startswith(_COUNTED)}


def copied(output: av.container.OutputContainer, template: av.stream.Stream) -> av.stream.Stream:
    """Add a stream with the parameters of another file's stream, to copy its packets."""
    made = output.add_stream_from_template(template, opaque=True)
    made.metadata.update(titled(kept_tags(template.metadata)))
    made.disposition = template.disposition
    return made


def name_of(stream: av.stream.Stream) -> str:
    """Return the name of a stream's codec."""
    context: Any = stream.codec_context  # None without a decoder
    name = context.codec.canonical_name if context is not None else getattr(stream, "name", None)
    return str(name or "unknown")


def kind_of(container: av.container.Container, stream: av.stream.Stream) -> str:
    """Return the FourCC of a stream; empty if it has none."""
    found = re.search(r"\(([\w ]{4}) / 0x", described(container, stream.index))
    return found[1] if found else ""


def named(container: av.container.InputContainer, stream: av.stream.Stream) -> str:
    """Return the name of a stream's contents, for messages: its codec, or the kind of its data."""
    name = name_of(stream)
    if stream.type != "data":
        return name
    kind = kind_of(container, stream)
    return _DATA.get(kind) or (f"data {kind!r}" if kind and name in ("unknown", "bin_data") else f"{name} data")


def holds(container: Container, template: av.stream.Stream) -> bool:
    """Return whether a container can hold a stream, by writing its header, and a packet of data, into memory."""
    if container.streams is not None and name_of(template) not in container.streams:
        return False
    if template.type == "attachment" and not container.attachments:
        return False  # some would drop it silently
    if template.disposition & av.stream.Disposition.attached_pic and not container.mp4:
        return False
    with io.BytesIO() as memory, contextlib.suppress(av.FFmpegError, ValueError):
        with av.open(memory, "w", format=container.name, metadata_errors="surrogateescape") as trial:
            made = copied(trial, template)
            trial.start_encoding()
            if template.type != "data":
                return True
            packet = av.Packet(bytes(16))
            packet.stream, packet.time_base, packet.pts, packet.dts = made, Fraction(1, 1000), 0, 0
            trial.mux_one(packet)
        memory.seek(0)  # MP4's muxer writes unknown data without their FourCC
        with av.open(memory) as again:
            return kind_of(template.container, template) in [kind_of(again, found) for found in again.streams]
    return False


class Passage:
    """The transfer of a clip's other streams into a file; it warns of those that the container cannot hold.

    `film` is the index of the stream that is encoded anew; the header of `output` is not written yet.
    """

    def __init__(
        self,
        source: av.container.InputContainer | None,
        film: int,
        output: av.container.OutputContainer,
        container: Container,
        target: PathLike,
    ) -> None:
        self._target = target
        self._output = output
        self._avi = container.counted  # AVI cannot store that sound begins before the film, as with AAC
        self.streams: dict[int, av.stream.Stream] = {}  # those that are written, by their indices in the source
        self._last: dict[int, int] = {}
        self._waiting: deque[tuple[Fraction | None, av.Packet[Any]]] = deque()
        self._bytes = 0
        if source is None:
            return
        marked = bool(source.chapters())
        for stream in source.streams:
            kind = kind_of(source, stream) if stream.type == "data" else ""
            # text of chapters would be written twice; the muxer writes the timecode from the metadata
            if stream.index == film or (marked and kind == "text") or kind == "tmcd":
                continue
            cover = bool(stream.disposition & av.stream.Disposition.attached_pic)
            if cover and container.attachments:
                # Matroska stores it as an attachment
                kind, tags = name_of(stream), stream.metadata
                name = tags.get("filename") or f"cover.{'jpg' if kind == 'mjpeg' else kind}"
                mime = tags.get("mimetype") or f"image/{'jpeg' if kind == 'mjpeg' else kind}"
                with av.open(source.name, metadata_errors="surrogateescape") as again:
                    data = (bytes(packet) for packet in again.demux(again.streams[stream.index]) if packet.size)
                    made = output.add_attachment(name, mime, next(data, b""))
                made.metadata.update({"filename": name, "mimetype": mime} | kept_tags(tags))
            elif holds(container, stream):
                self.streams[stream.index] = copied(output, stream)
            else:
                what = named(source, stream)
                if stream.type != "data":
                    what += f" {'cover' if cover else stream.type}"
                self._warn(f"cannot hold the {what} (stream {stream.index}): it is left out")

    def take(self, packet: av.Packet[Any]) -> None:
        """Hold a packet until the film has reached its time. Called by the reading thread."""
        when = packet.dts if packet.dts is not None else packet.pts
        self._bytes += packet.size
        self._waiting.append((None if when is None else when * packet.time_base, packet))

    def write(self, until: Fraction | None = None) -> None:
        """Write packets before a time, or all. Called by the writing thread."""
        while self._waiting:
            when, packet = self._waiting[0]
            if until is not None and when is not None and when > until and self._bytes < _HELD:
                return
            self._waiting.popleft()
            self._bytes -= packet.size
            self._mux(packet)

    def _mux(self, packet: av.Packet[Any]) -> None:
        index = packet.stream_index
        stream = self.streams.get(index)
        if stream is None:
            return
        last, start = self._last.get(index), packet.pts
        if self._avi and last is None and start is not None and stream.type == "audio":
            if start < 0 and start + (packet.duration or 0) <= 0:
                return
            if start * packet.time_base > _FELT:
                self._warn(
                    f"cannot say that sound begins later: it is {float(start * packet.time_base):.2g} s too early"
                )
        when = packet.dts if packet.dts is not None else packet.pts
        if when is None:
            when = 0 if last is None else last + 1
        if last is not None and when <= last and stream.type != "subtitle":
            when = last + 1  # muxers reject decreasing times
        packet.dts = when
        if packet.pts is None or packet.pts < when:
            packet.pts = when
        self._last[index] = when
        packet.stream = stream
        try:
            self._output.mux_one(packet)
        except (av.error.InvalidDataError, av.error.ArgumentError, av.error.PatchWelcomeError, ValueError):
            del self.streams[index]
            self._warn(f"cannot hold all of the {stream.type} (stream {index}) of the source: the rest is left out")

    def _warn(self, what: str) -> None:
        warn(f"{shown(self._target)} {what}", ClipWarning)
