"""Video files as packets: opened, counted, set to one clock, and sought in by the times of their frames."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import stat
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
from av.format import Flags as FormatFlags

from supple.media.codecs import codec_of
from supple.media.files import PathLike, unreadable

_ADVICE = "give a whole video file, such as MP4, MOV, MKV, WebM or AVI"
_TEXT = frozenset(("ansi", "bintext", "xbin", "idf"))  # text that FFmpeg would show as a film of a terminal
_LISTS = frozenset(("concat", "hls", "dash", "imf"))  # text that names other files, or addresses
_DISCONTINUOUS: int = getattr(FormatFlags.ts_discont, "value", 0)
_SLOPPY = 3  # frames that a healthy file may promise too many
_JUMP = 10  # seconds: what no gap in healthy sound or picture exceeds
_BACK = Fraction(1, 10)
_PICTURES = av.stream.Disposition.attached_pic | av.stream.Disposition.timed_thumbnails


def said(error: Exception) -> str:
    """Shorten what FFmpeg said to its reason."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return re.sub(r"\s+", " ", str(text)).strip().rstrip(".").replace("[Errno", "[error")


def opened(path: PathLike) -> av.container.InputContainer:
    """Open a video file; SuppleError if it is missing, empty, no plain file, damaged at its start, or no video."""
    try:
        found = os.stat(path)
    except OSError as error:
        raise unreadable(path, error.strerror or "no such file", "check the name and its rights") from error
    except ValueError as error:
        raise unreadable(path, "no file can have that name", "check it") from error
    if not stat.S_ISREG(found.st_mode):
        raise unreadable(path, "it is a folder" if stat.S_ISDIR(found.st_mode) else "it is no plain file", _ADVICE)
    if not found.st_size:
        raise unreadable(path, "it is empty", _ADVICE)
    try:
        # names with a colon are no addresses: an absolute path never is one
        name, limits = str(Path(path).absolute()), {"protocol_whitelist": "file"}
        container = av.open(name, "r", container_options=limits, metadata_errors="surrogateescape")
    except (PermissionError, av.error.PermissionError) as error:
        raise unreadable(path, "there is no right to read it", "check its rights") from error
    except (av.FFmpegError, ValueError, MemoryError) as error:
        what = f"it is no video, or damaged or cut short where it begins ({said(error)})"
        raise unreadable(path, what, _ADVICE) from error
    if _LISTS.intersection(container.format.name.split(",")):
        container.close()
        raise unreadable(path, "it is a list of other files", _ADVICE)
    return container


def chosen(container: av.container.InputContainer, path: PathLike) -> av.VideoStream:
    """Choose the first stream that is a film, not a picture of its cover; SuppleError if none can be decoded."""
    films = [stream for stream in container.streams.video if not stream.disposition & _PICTURES]
    if not films:
        kinds = {stream.type for stream in container.streams}
        only = (
            "a cover picture and no film"
            if "video" in kinds
            else "sound and no film"
            if "audio" in kinds
            else "no film"
        )
        raise unreadable(path, f"it holds {only}", _ADVICE)
    film = films[0]
    if film.codec_context is None:
        raise unreadable(path, "nothing here can decode its kind of video", "convert it, to H.264 for instance")
    if film.codec_context.codec.canonical_name in _TEXT:
        raise unreadable(path, "it is text", _ADVICE)
    return film


@dataclass(frozen=True, slots=True)
class Survey:
    """The count, duration and damage of a video stream, by its packets alone."""

    packets: int  # how many are decoded
    count: int  # how many of these are shown
    duration: Fraction  # seconds from the start of the first frame to the end of the last
    damaged: bool  # whether the file breaks off
    suspect: bool  # whether some packets may be damaged, or incomplete
    variable: bool = False  # whether frames are not evenly spaced in time
    starts: tuple[float, ...] = ()  # seconds from the first of them to each, if they are not
    missing: int = 0  # how many more frames the container promises, where it breaks off


# Kept: FFmpeg ends without a word where a GIF does (test_a_cut_gif_is_used_with_a_warning).
def _ends(path: str) -> bool:
    """Tell whether a GIF has its end."""
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 512))
        return file.read().rstrip(b"\0").endswith(b";")


def _attend(container: av.container.InputContainer, streams: Sequence[av.stream.Stream]) -> None:
    """Pass over all other streams."""
    for stream in container.streams:
        if stream not in streams:
            stream.discard = av.stream.Discard.all


def is_counted(container: av.container.InputContainer) -> bool:
    """Tell whether frames have places, not times; pauses are counted as frames."""
    return container.format.name == "avi"


def survey(container: av.container.InputContainer, film: av.VideoStream) -> Survey:
    """Count the frames of a film by its packets."""
    _attend(container, [film])
    hidden = film.codec_context.codec.canonical_name == "vp8"
    packets = count = 0
    first = last = None
    step = total = 0
    damaged = suspect = False
    starts: list[int] = []
    try:
        for packet in container.demux(film):
            if not packet.size:
                continue
            packets += 1
            suspect |= packet.is_corrupt
            if packet.is_discard or (hidden and not memoryview(packet)[0] & 16):
                continue
            count += 1
            step = packet.duration or step
            total += packet.duration or 0
            start = packet.pts if packet.pts is not None else packet.dts
            if packet.pts is not None:
                starts.append(packet.pts)
            if start is not None:
                first = start if first is None else min(first, start)
                last = start + step if last is None else max(last, start + step)
    except av.FFmpegError:
        damaged = True
    damaged |= container.format.name == "gif" and not _ends(container.name)
    base = film.time_base or Fraction(1)
    span = Fraction(last - first) * base if first is not None and last is not None else Fraction(0)
    if total and sums_up(container):
        span = total * base
    told = _told(film)
    end = span if last is None else max(span, last * base)  # what it says may count from zero
    reached = last if is_counted(container) and last is not None else packets
    missing = film.frames - max(reached, packets) if film.frames else 0
    if told is not None and packets > 0 and span > 0:
        missing = round((told - end) * packets / span)
    # Samples that an edit list leaves out of an MP4 are not missing: there, a packet that breaks off must show it.
    cut = missing > _SLOPPY and (suspect or damaged or not sums_up(container))
    starts.sort()
    varies = _varies(starts)
    seconds = tuple(float((start - starts[0]) * base) for start in starts) if varies else ()
    broken = damaged or cut
    return Survey(packets, count, span, broken, suspect or broken, varies, seconds, max(0, missing) if broken else 0)


def _varies(starts: list[int]) -> bool:
    """Tell whether times in order are farther from even spacing than rounding and a tenth of a frame explain."""
    if len(starts) < 3:
        return False
    steps = [b - a for a, b in itertools.pairwise(starts)]
    return max(steps) - min(steps) > max(2, sorted(steps)[len(steps) // 2] / 10)


def sums_up(container: av.container.InputContainer) -> bool:
    """Tell whether packets last until the next is decoded, not until the next is shown."""
    return "mp4" in container.format.name


def _told(film: av.VideoStream) -> Fraction | None:
    """Return the seconds that Matroska says a film lasts, which outlive it being cut short."""
    found = re.fullmatch(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", film.metadata.get("DURATION", ""))
    return int(found[1]) * 3600 + int(found[2]) * 60 + Fraction(found[3]) if found else None


class Clock:
    """One clock for all streams of a file: broadcasts start anywhere, and jump where they were joined.

    Times of MPEG-TS, MPEG-PS and the like are moved to begin at zero. All others are kept.
    """

    def __init__(self, container: av.container.InputContainer) -> None:
        self._broadcast = bool(container.format.flags & _DISCONTINUOUS)
        start = container.start_time if self._broadcast else None
        self._shift = -Fraction(start, av.time_base) if start is not None else Fraction(0)
        self._due: dict[int, Fraction] = {}

    def set(self, packet: av.Packet[Any], continuous: bool) -> None:
        """Move the times of a packet onto the clock, which jumps at gaps of `continuous` streams (sound, pictures)."""
        when = packet.dts if packet.dts is not None else packet.pts
        if not self._broadcast or when is None:
            return
        base = packet.time_base
        time = when * base + self._shift
        due = self._due.get(packet.stream_index)
        if continuous and due is not None and not due - _BACK <= time <= due + _JUMP:
            self._shift += due - time
            time = due
        self._due[packet.stream_index] = time + (packet.duration or 0) * base
        ticks = round(self._shift / base)
        if packet.pts is not None:
            packet.pts += ticks
        if packet.dts is not None:
            packet.dts += ticks


def packets(container: av.container.InputContainer, streams: list[av.stream.Stream]) -> Iterator[av.Packet[Any]]:
    """Read the packets of some streams, on one clock, until the file ends or breaks off."""
    clock = Clock(container)
    _attend(container, streams)
    with contextlib.suppress(av.FFmpegError):  # the survey has noticed it
        for packet in container.demux(streams):
            if packet.size or packet.pts is not None:
                clock.set(packet, packet.stream.type in ("audio", "video"))
                yield packet


def fed(stream: Iterator[av.Packet[Any]]) -> Iterator[av.Packet[Any] | None]:
    """Hand out packets, then None, at which a decoder gives what it still has."""
    yield from stream
    yield None


def decoded_by(decoder: av.VideoCodecContext, packet: av.Packet[Any] | None) -> list[av.VideoFrame] | None:
    """Decode a packet, or what is left; None where it cannot be."""
    try:
        return decoder.decode(packet)
    except av.FFmpegError:
        return None


@dataclass(slots=True)
class Times:
    """The times at which frames are shown, in ticks of the stream, strictly increasing."""

    base: Fraction  # seconds a tick
    step: int  # ticks from frame to frame where the file does not say
    kept: deque[tuple[int, int]] | None = None
    _first: int | None = field(default=None, repr=False)
    _last: int | None = field(default=None, repr=False)
    _due: int = field(default=0, repr=False)

    def add(self, pts: int | None, duration: int | None) -> None:
        """Take the time of the next frame, mended where it is missing or not later than the one before."""
        start = self._due if pts is None else pts
        if self._last is not None and start <= self._last:
            start = self._last + 1
        if self._first is None:
            self._first = start
        length = duration if duration and duration > 0 else self.step
        self._last, self._due = start, max(start + 1, start + length)
        if self.kept is not None:
            self.kept.append((start, length))

    def left(self, pts: int | None, span: int) -> int | None:
        """Return how long the last frame is shown, where all last `span` ticks; None where that makes no sense."""
        if pts is None or self._first is None or span <= pts - self._first:
            return None
        return span - (pts - self._first)


def usual_step(rate: Fraction, base: Fraction) -> int:
    """Return the ticks of one frame at a rate."""
    return max(1, round(1 / (rate * base)))


@dataclass(frozen=True, slots=True)
class Index:
    """The frames of a film by their times."""

    starts: tuple[int, ...]  # when each is shown, in ticks of the stream, in order
    # those at which decoding may begin; what is shown before one, but follows it in the file, may need what precedes it
    keys: tuple[int, ...]
    numbers: dict[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numbers", {start: k for k, start in enumerate(self.starts)})

    def before(self, k: int) -> int:
        """The last frame, not after `k`, at which decoding may begin; 0 where that is the start."""
        found = bisect_right(self.keys, k)
        return self.keys[found - 1] if found else 0


def index_of(path: PathLike, count: int) -> Index | None:
    """Read the times of a film's packets; None where they do not tell which of `count` frames is which."""
    starts: list[int] = []
    keys: list[int] = []
    with opened(path) as container:
        film = chosen(container, path)
        name = film.codec_context.codec.canonical_name
        if container.format.flags & _DISCONTINUOUS or is_counted(container) or codec_of(name).hides:
            return None
        _attend(container, [film])
        try:
            for packet in container.demux(film):
                if not packet.size:
                    continue
                if packet.pts is None or packet.is_discard or packet.is_corrupt:
                    return None
                starts.append(packet.pts)
                if packet.is_keyframe:
                    keys.append(packet.pts)
        except av.FFmpegError:
            return None
    made = Index(tuple(sorted(starts)), ())
    if len(starts) != count or len(made.numbers) != count:
        return None
    return Index(made.starts, tuple(sorted(made.numbers[key] for key in keys)))
