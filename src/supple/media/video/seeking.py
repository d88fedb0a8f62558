"""Where in a video file decoding may begin, so that a frame in the middle need not wait for all before it."""

from __future__ import annotations

import os
from bisect import bisect_right
from dataclasses import dataclass, field

import av
from av.format import Flags as FormatFlags

from supple.media.codecs import codec_of
from supple.media.video.demux import chosen, opened

PathLike = str | os.PathLike[str]
_BROADCAST: int = getattr(FormatFlags.ts_discont, "value", 0)
_UNTIMED = frozenset(("avi",))  # their packets have places, not times


@dataclass(frozen=True, slots=True)
class Index:
    """The frames of a film by their times.

    Parameters
    ----------
    starts : tuple of int
        When each frame is shown, in ticks of the stream, in order.
    keys : tuple of int
        The numbers of those at which decoding may begin. What is shown before one, but comes after it in the file, may
        need what came before it.
    """

    starts: tuple[int, ...]
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
        if container.format.flags & _BROADCAST or container.format.name in _UNTIMED or codec_of(name).hides:
            return None
        for other in container.streams:
            if other.index != film.index:
                other.discard = av.stream.Discard.all
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
