"""Video files as packets: opening, counting, correcting their times, and finding frames by time."""

from __future__ import annotations

import contextlib
import itertools
import mmap
import os
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
from av.format import Flags as FormatFlags

from supple import errors
from supple.media.codecs import codec_of
from supple.media.files import PathLike, head_of, unreadable

_ADVICE = "give a whole video file, such as MP4, MOV, MKV, WebM or AVI"
_TEXT = frozenset(("ansi", "bintext", "xbin", "idf"))  # text that FFmpeg would render as a terminal
_LISTS = frozenset(("concat", "hls", "dash", "imf"))  # lists that refer to other files or URLs
_DISCONTINUOUS: int = getattr(FormatFlags.ts_discont, "value", 0)
_SLOPPY = 3  # frames that may be missing from an intact file
_JUMP = 10  # seconds: longer than any gap in intact streams
_BACK = Fraction(1, 10)
_PICTURES = av.stream.Disposition.attached_pic | av.stream.Disposition.timed_thumbnails


def said(error: Exception) -> str:
    """Return the reason in an error of FFmpeg."""
    return str(getattr(error, "strerror", None) or errors.said(error)).replace("[Errno", "[error")


def opened(path: PathLike) -> av.container.InputContainer:
    """Open a video file; SuppleError if it is missing, empty, no plain file, damaged at its start, or no video."""
    head_of(path, 1, _ADVICE, _ADVICE)
    try:
        # an absolute path, so that a name with a colon is not read as a URL
        name, limits = str(Path(path).absolute()), {"protocol_whitelist": "file"}
        container = av.open(name, "r", container_options=limits, metadata_errors="surrogateescape")
    except (av.FFmpegError, ValueError, MemoryError) as error:
        what = f"it is no video, or damaged or cut short where it begins ({said(error)})"
        raise unreadable(path, what, _ADVICE) from error
    if _LISTS.intersection(container.format.name.split(",")):
        container.close()
        raise unreadable(path, "it is a list of other files", _ADVICE)
    return container


def chosen(container: av.container.InputContainer, path: PathLike) -> av.VideoStream:
    """Return the first video stream that is not a cover image; SuppleError if there is none, or no decoder for it."""
    films = [stream for stream in container.streams.video if not stream.disposition & _PICTURES]
    if not films:
        kinds = {stream.type for stream in container.streams}
        other = "a cover picture and " if "video" in kinds else "sound and " if "audio" in kinds else ""
        raise unreadable(path, f"it holds {other}no film", _ADVICE)
    film = films[0]
    if film.codec_context is None:
        raise unreadable(path, "nothing here can decode its kind of video", "convert it, to H.264 for instance")
    if film.codec_context.codec.canonical_name in _TEXT:
        raise unreadable(path, "it is text", _ADVICE)
    return film


@dataclass(frozen=True, slots=True)
class Survey:
    """The count, duration and damage of a video stream, from its packets."""

    packets: int  # the number of packets to decode
    count: int  # the number of shown frames
    duration: Fraction  # seconds from the start of the first frame to the end of the last
    damaged: bool  # whether the file is truncated
    suspect: bool  # whether some packets may be damaged, or incomplete
    starts: tuple[float, ...] = ()  # start times in seconds from the first, if their spacing varies
    missing: int = 0  # the number of lost frames, if the file is truncated
    # display times of the frames in order, in ticks of the stream; empty if they do not identify frames
    times: tuple[int, ...] = ()
    # key frames, at which decoding may begin; frames shown before one but stored after it may need earlier ones
    keys: tuple[int, ...] = ()


# Kept: FFmpeg neither reports the number of repetitions (test_how_often_it_plays_comes_through), nor keeps the exact
# durations of an animated PNG (test_times_of_a_film_are_kept).
def animation_of(container: av.container.InputContainer) -> tuple[int | None, list[Fraction]]:
    """Return how often an animation plays, 0 for ever, None for other videos; and the durations of frames of a PNG.

    Durations are in seconds; there are none if one is missing.
    """
    kind, plays, delays, at = container.format.name, None, list[Fraction](), 8
    if kind not in ("gif", "apng"):
        return None, []
    with open(container.name, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if kind == "gif":
            found = re.search(rb"\x21\xff\x0b(?:NETSCAPE2\.0|ANIMEXTS1\.0)\x03\x01(..)", data, re.DOTALL)
            again = int.from_bytes(found[1], "little") if found else None
            return 1 if again is None else again and again + 1, []
        while len(head := data[at : at + 34]) > 8:
            if head[4:8] == b"acTL":
                plays = int.from_bytes(head[12:16])
            elif head[4:8] == b"fcTL":
                delays.append(Fraction(int.from_bytes(head[28:30]), int.from_bytes(head[30:32]) or 100))
            at += 12 + int.from_bytes(head[:4])
    return plays, delays if all(delays) else []


def _attend(container: av.container.InputContainer, streams: Sequence[av.stream.Stream]) -> None:
    """Discard the packets of all other streams."""
    for stream in container.streams:
        if stream not in streams:
            stream.discard = av.stream.Discard.all


def is_counted(container: av.container.InputContainer) -> bool:
    """Return whether packets store frame numbers instead of times, so that pauses count as frames."""
    return container.format.name == "avi"


def survey(
    container: av.container.InputContainer, film: av.VideoStream, decoder: av.VideoCodecContext
) -> tuple[Survey, av.VideoFrame | None]:
    """Count the frames of a film by its packets; also return the first decoded frame."""
    _attend(container, [film])
    name = film.codec_context.codec.canonical_name
    hidden = name == "vp8"
    told = not (container.format.flags & _DISCONTINUOUS or is_counted(container) or codec_of(name).hides)
    packets = count = 0
    first = last = None
    step = total = 0
    damaged = suspect = False
    starts: list[int] = []
    keys: list[int] = []
    decoded: list[av.VideoFrame] = []
    try:
        for packet in container.demux(film):
            if not packet.size:
                continue
            decoded = decoded or decoded_by(decoder, packet) or []
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
                keys += [packet.pts] * packet.is_keyframe
            if start is not None:
                first = start if first is None else min(first, start)
                last = start + step if last is None else max(last, start + step)
    except av.FFmpegError:
        damaged = True
    if container.format.name == "gif":  # FFmpeg does not report a missing end (test_a_cut_gif_is_used_with_a_warning)
        with open(container.name, "rb") as file:
            file.seek(max(0, os.path.getsize(container.name) - 512))
            damaged |= not file.read().rstrip(b"\0").endswith(b";")
    base = film.time_base or Fraction(1)
    span = Fraction(last - first) * base if first is not None and last is not None else Fraction(0)
    if sums_up(container):  # VP9's packets have no durations
        span = (total or film.duration or 0) * base or span
    # the duration in Matroska's tags survives truncation of the file
    lasts = re.fullmatch(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", film.metadata.get("DURATION", ""))
    end = span if last is None else max(span, last * base)  # Matroska's duration may count from zero
    reached = last if is_counted(container) and last is not None else packets
    missing = film.frames - max(reached, packets) if film.frames else 0
    if lasts and packets > 0 and span > 0:
        promised = int(lasts[1]) * 3600 + int(lasts[2]) * 60 + Fraction(lasts[3])
        missing = round((promised - end) * packets / span)
    # In an MP4, an edit list may exclude samples: only an incomplete packet shows truncation.
    cut = missing > _SLOPPY and (suspect or damaged or not sums_up(container))
    starts.sort()
    steps = [b - a for a, b in itertools.pairwise(starts)]
    # whether spacings differ by more than rounding and a tenth of a frame
    varies = len(steps) > 1 and max(steps) - min(steps) > max(2, sorted(steps)[len(steps) // 2] / 10)
    seconds = tuple(float((start - starts[0]) * base) for start in starts) if varies else ()
    broken = damaged or cut
    found = Survey(packets, count, span, broken, suspect or broken, seconds, max(0, missing) if broken else 0)
    if told and not found.suspect and len(starts) == packets and min(steps, default=1) > 0:
        found = replace(found, times=tuple(starts), keys=tuple(bisect_left(starts, key) for key in sorted(keys)))
    return found, next(iter(decoded or decoded_by(decoder, None) or ()), None)


def sums_up(container: av.container.InputContainer) -> bool:
    """Return whether a packet's duration is the time to the next decoding time, not to the next display time."""
    return "mp4" in container.format.name


def packets(container: av.container.InputContainer, streams: list[av.stream.Stream]) -> Iterator[av.Packet[Any]]:
    """Read the packets of some streams, on one clock, until the file ends or is cut off.

    Broadcasts start at any time, and jump at joins. Times in MPEG-TS, MPEG-PS and similar formats are shifted to begin
    at zero, and jumps of sound and video are closed; other formats keep their times.
    """
    broadcast = bool(container.format.flags & _DISCONTINUOUS)
    shift, due = -Fraction(container.start_time or 0, av.time_base), dict[int, Fraction]()
    _attend(container, streams)
    with contextlib.suppress(av.FFmpegError):  # already found by the survey
        for packet in container.demux(streams):
            if not packet.size and packet.pts is None:
                continue
            when = packet.dts if packet.dts is not None else packet.pts
            if broadcast and when is not None:
                base, k = packet.time_base, packet.stream_index
                time = when * base + shift
                continuous = k in due and packet.stream.type in ("audio", "video")
                if continuous and not due[k] - _BACK <= time <= due[k] + _JUMP:
                    shift += due[k] - time
                    time = due[k]
                due[k] = time + (packet.duration or 0) * base
                ticks = round(shift / base)
                packet.pts = None if packet.pts is None else packet.pts + ticks
                packet.dts = None if packet.dts is None else packet.dts + ticks
            yield packet


def decoded_by(decoder: av.VideoCodecContext, packet: av.Packet[Any] | None) -> list[av.VideoFrame] | None:
    """Decode a packet, or flush the decoder; None on failure."""
    try:
        return decoder.decode(packet)
    except av.FFmpegError:
        return None


def usual_step(rate: Fraction, base: Fraction) -> int:
    """Return the ticks of one frame at a rate."""
    return max(1, round(1 / (rate * base)))
