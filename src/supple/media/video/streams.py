"""Sound, subtitles, attachments: streams that go from one file into another as they are."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections import deque
from fractions import Fraction
from typing import Any

import av

from supple.errors import shown
from supple.media.base import ClipWarning
from supple.media.codecs import Container
from supple.media.files import PathLike

_HELD = 64 << 20  # bytes of packets that wait for the film before they go first
# what describes the file that it came from, and not what is in it
_OWN = frozenset(("encoder", "duration", "major_brand", "minor_version", "compatible_brands", "rotate", "alpha_mode"))
_FELT = Fraction(1, 50)  # seconds between picture and sound: more is told
_COUNTED = ("_STATISTICS", "BPS", "NUMBER_OF_", "DURATION")


def titled(tags: dict[str, str]) -> dict[str, str]:
    """Call the title of a stream what muxers call it: MP4 gives it back as its name."""
    return {"title" if key == "name" and "title" not in tags else key: value for key, value in tags.items()}


def kept_tags(tags: dict[str, str]) -> dict[str, str]:
    """Return the metadata that is still true of another file with the same contents."""
    return {key: value for key, value in tags.items() if key.lower() not in _OWN and not key.startswith(_COUNTED)}


def copied(output: av.container.OutputContainer, template: av.stream.Stream) -> av.stream.Stream:
    """Add a stream like one of another file, for packets as they are."""
    made = output.add_stream_from_template(template, opaque=True)
    made.metadata.update(titled(kept_tags(template.metadata)))
    made.disposition = template.disposition
    return made


def name_of(stream: av.stream.Stream) -> str:
    """Return the name of what a stream is coded with."""
    context: Any = stream.codec_context  # none where nothing decodes it
    name = context.codec.canonical_name if context is not None else getattr(stream, "name", None)
    return str(name or "unknown")


def picture(path: str, index: int) -> bytes:
    """Return the first packet of a stream."""
    with av.open(path, metadata_errors="surrogateescape") as source:
        return next((bytes(packet) for packet in source.demux(source.streams[index]) if packet.size), b"")


def holds(container: Container, template: av.stream.Stream) -> bool:
    """Try whether a container can hold a stream, by writing its header into memory."""
    if container.streams is not None and name_of(template) not in container.streams:
        return False
    if template.type == "attachment" and not container.attachments:
        return False  # some would leave it out without a word
    if template.disposition & av.stream.Disposition.attached_pic and not container.mp4:
        return False
    trial = None
    with io.BytesIO() as memory:
        try:
            trial = av.open(memory, "w", format=container.name, metadata_errors="surrogateescape")
            copied(trial, template)
            trial.start_encoding()
        except (av.FFmpegError, ValueError):
            return False
        finally:
            if trial is not None:
                with contextlib.suppress(av.FFmpegError, ValueError):
                    trial.close()
    return True


class Passage:
    """The other streams of a clip on their way into a file; it warns of those that the container cannot hold.

    `film` is the index of the stream that is written anew; the header of `output` is not written yet.
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
        self._avi = container.counted  # which cannot say that sound begins before the film, as that of AAC does
        self._streams: dict[int, av.stream.Stream] = {}
        self._last: dict[int, int] = {}
        self._waiting: deque[tuple[Fraction | None, av.Packet[Any]]] = deque()
        self._bytes = 0
        if source is None:
            return
        marked = bool(source.chapters())
        for stream in source.streams:
            if stream.index == film or (marked and name_of(stream) == "bin_data"):  # chapters, once more
                continue
            cover = bool(stream.disposition & av.stream.Disposition.attached_pic)
            if cover and container.attachments:
                self._attach(source, stream)
            elif holds(container, stream):
                self._streams[stream.index] = copied(output, stream)
            else:
                kind = "cover" if cover else stream.type
                self._warn(f"cannot hold the {name_of(stream)} {kind} (stream {stream.index}): it is left out")

    def _attach(self, source: av.container.InputContainer, cover: av.stream.Stream) -> None:
        """Write a cover into the header of Matroska, as an attachment."""
        kind = name_of(cover)
        data = picture(source.name, cover.index)
        name = cover.metadata.get("filename") or f"cover.{'jpg' if kind == 'mjpeg' else kind}"
        mime = cover.metadata.get("mimetype") or f"image/{'jpeg' if kind == 'mjpeg' else kind}"
        made = self._output.add_attachment(name, mime, data)
        made.metadata.update({"filename": name, "mimetype": mime} | kept_tags(cover.metadata))

    @property
    def indices(self) -> list[int]:
        """Of the streams that go along, in the source."""
        return list(self._streams)

    def take(self, packet: av.Packet[Any]) -> None:
        """Keep a packet until the film has come to its time. Called by the thread that reads."""
        when = packet.dts if packet.dts is not None else packet.pts
        self._bytes += packet.size
        self._waiting.append((None if when is None else when * packet.time_base, packet))

    def write(self, until: Fraction | None = None) -> None:
        """Write what comes before a time, or all. Called by the thread that writes."""
        while self._waiting:
            when, packet = self._waiting[0]
            if until is not None and when is not None and when > until and self._bytes < _HELD:
                return
            self._waiting.popleft()
            self._bytes -= packet.size
            self._mux(packet)

    def _mux(self, packet: av.Packet[Any]) -> None:
        index = packet.stream_index
        stream = self._streams.get(index)
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
            when = last + 1  # no muxer takes time that runs backwards
        packet.dts = when
        if packet.pts is None or packet.pts < when:
            packet.pts = when
        self._last[index] = when
        packet.stream = stream
        try:
            self._output.mux_one(packet)
        except (av.error.InvalidDataError, av.error.ArgumentError, av.error.PatchWelcomeError, ValueError):
            del self._streams[index]
            self._warn(f"cannot hold all of the {stream.type} (stream {index}) of the source: the rest is left out")

    def _warn(self, what: str) -> None:
        warnings.warn(f"{shown(self._target)} {what}", ClipWarning, stacklevel=2)
