"""Writers of animated WebP and PNG; each frame is a still of the part that differs from the frame before."""

from __future__ import annotations

import contextlib
import errno
import itertools
import struct
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

from supple.engine.work import Array
from supple.errors import shown, warn
from supple.media.base import ClipWarning
from supple.media.files import PathLike, replacing
from supple.media.image.formats import bounds
from supple.media.sequence import PictureSink

Box = tuple[int, int, int, int]
_Frame = tuple[bytes, Box, Fraction]
"""A still, the box that it covers, x, y, width and height, and the time until which it is shown, from the first."""
_SHORT, _LONGEST = 65535, (1 << 24) - 1  # limits: terms of a PNG's fractions (s), a WebP's duration (ms)


def _png(file: IO[bytes], clip: Any, frames: Iterator[_Frame]) -> None:
    """Write an APNG: the chunks of the first still, then the data of each frame, numbered."""

    def put(kind: bytes, data: bytes) -> None:
        file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))

    numbers, shown = itertools.count(), Fraction(0)
    for k, (still, (left, top, width, height), until) in enumerate(frames):
        chunks = [*_chunks(still, 8, 0)]
        if k == 0:
            file.write(still[:8])
            for kind, data in chunks:
                if kind not in (b"IDAT", b"IEND"):
                    put(kind, data)
            put(b"acTL", struct.pack(">II", clip.count, clip.plays or 0))
        lasts = max(until - shown, Fraction(0))  # negative if earlier durations were rounded up
        if max(lasts.as_integer_ratio()) > _SHORT:
            scale = max(1, int(_SHORT / max(float(lasts), 1.0)))
            lasts = Fraction(min(max(1, round(lasts * scale)), _SHORT), scale)
        shown += lasts
        head = next(numbers), width, height, left, top, *lasts.as_integer_ratio(), 0, 0
        put(b"fcTL", struct.pack(">IIIIIHHBB", *head))
        data = b"".join(data for kind, data in chunks if kind == b"IDAT")
        put(*((b"fdAT", struct.pack(">I", next(numbers)) + data) if k else (b"IDAT", data)))
    put(b"IEND", b"")


def _webp(file: IO[bytes], clip: Any, frames: Iterator[_Frame]) -> None:
    """Write an animated WebP: the profile of the first still, the frames, and its other headers."""
    known, shown = dict[bytes, bytes](), Fraction(0)
    for k, (still, (left, top, width, height), until) in enumerate(frames):
        chunks = dict(_chunks(still, 12, 4))
        if k == 0:
            known = {kind: data for kind, data in chunks.items() if kind in (b"ICCP", b"EXIF", b"XMP ")}
            flags = 2 | 32 * (b"ICCP" in known) | 8 * (b"EXIF" in known) | 4 * (b"XMP " in known)
            flags |= 16 * clip.layout.groups[0].alpha
            size = struct.pack("<I", flags) + _threes(width - 1, height - 1)
            file.write(b"RIFF\0\0\0\0WEBP" + _riff(b"VP8X", size))
            if profile := known.pop(b"ICCP", None):
                file.write(_riff(b"ICCP", profile))
            file.write(_riff(b"ANIM", struct.pack("<IH", 0, min(clip.plays or 0, _SHORT))))
        ticks = min(max(1, round((until - shown) * 1000)), _LONGEST)
        shown += Fraction(ticks, 1000)
        head = _threes(left // 2, top // 2, width - 1, height - 1, ticks) + b"\2"  # flags: overwrite, do not blend
        data = b"".join(_riff(kind, chunks[kind]) for kind in (b"ALPH", b"VP8 ", b"VP8L") if kind in chunks)
        file.write(_riff(b"ANMF", head + data))
    file.write(b"".join(_riff(kind, data) for kind, data in known.items()))
    if (length := file.tell() - 8) >> 32:
        raise OSError(errno.EFBIG, "a WebP ends at 4 GB")
    file.seek(4)
    file.write(struct.pack("<I", length))


def _chunks(still: bytes, at: int, size_at: int) -> Iterator[tuple[bytes, bytes]]:
    """Yield the kind and the data of each chunk: of a PNG, the size comes first, and a checksum last; of a WebP not."""
    while at + 8 <= len(still):
        size = int.from_bytes(still[at + size_at : at + size_at + 4], "little" if size_at else "big")
        yield still[at + 4 - size_at : at + 8 - size_at], still[at + 8 : at + 8 + size]
        at += 8 + size + (size % 2 if size_at else 4)


def _riff(kind: bytes, data: bytes) -> bytes:
    return kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)


def _threes(*numbers: int) -> bytes:
    return b"".join(number.to_bytes(3, "little") for number in numbers)


class AnimationSink(PictureSink):
    """A sink of frames: a still for each, of which one file is made when all are complete."""

    def __init__(self, clip: Any, target: Path, folder: Path, options: dict[str, Any]) -> None:
        super().__init__(clip, target.parent, folder, lambda k: target.name, options)
        # offsets of frames must be even in a WebP
        self._put, self._step = (_webp, 2) if target.suffix.lower() == ".webp" else (_png, 1)
        self._before: Array | None = None
        self._parts: list[tuple[Box, Fraction, Fraction]] = []  # what changes, and the start and the end, in seconds

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Encode frame ``k``."""
        ticks, lasts = self._clip.time(k)
        pixels, like = self._rendered(arrays, k)
        left, top, right, bottom = 0, 0, pixels.shape[1], pixels.shape[0]
        if self._before is not None:  # the box around the pixels that differ; one pixel if none do
            left, top, right, bottom = bounds((pixels != self._before).any(axis=2)) or (0, 0, 1, 1)
            left, top = left // self._step * self._step, top // self._step * self._step
        self._before = pixels.copy()
        self._save(k, pixels[top:bottom, left:right], like)
        (self._temporary / self._names(k)).rename(self._temporary / str(len(self._parts)))
        box = left, top, right - left, bottom - top
        self._parts.append((box, ticks * self._clip.base, (ticks + lasts) * self._clip.base))

    def finish(self, file: IO[bytes]) -> None:
        """Write the file; a frame lasts until the next one starts, and rounding errors are carried to the next."""
        boxes, starts, ends = zip(*self._parts, strict=True)
        times = (until - starts[0] for until in (*starts[1:], ends[-1]))
        stills = ((self._temporary / str(k)).read_bytes() for k in range(len(boxes)))
        self._put(file, self._clip, zip(stills, boxes, times, strict=True))


@contextlib.contextmanager
def writer(clip: Any, target: PathLike, *, force: bool = False, **options: Any) -> Iterator[AnimationSink]:
    """Write a clip's frames as one animated picture, WebP or PNG by the suffix, which appears whole or not at all.

    Frames are stills as `supple.media.sequence.writer` writes them, of RGB or RGBA, upright, of 16 bits in a PNG if the
    clip has more than 8; the first one's profile and headers are the file's. Times are those of the clip: fractions in
    a PNG, whole milliseconds in a WebP, which do not add up errors; it plays as often as the source, and for ever if
    that is a film. Options and SuppleError are those of `sequence.writer`.
    """
    if clip.unpictured:
        text = f"{shown(target)} gets pictures alone, without the {' and the '.join(clip.unpictured)} of {clip.name}"
        warn(text, ClipWarning)
    with (
        replacing(target, force=force) as temporary,
        tempfile.TemporaryDirectory(prefix=".", dir=temporary.parent) as folder,
        open(temporary, "wb") as file,
    ):
        sink = AnimationSink(clip, Path(target), Path(folder), options)
        yield sink
        sink.finish(file)
