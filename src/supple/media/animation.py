"""Writers of animated WebP and PNG; each frame is a still of the part that differs from the frame before."""

from __future__ import annotations

import contextlib
import errno
import struct
import tempfile
import warnings
import zlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

from supple.engine.work import Array
from supple.errors import shown
from supple.media.base import ClipWarning
from supple.media.files import PathLike, replacing
from supple.media.image.formats import bounds
from supple.media.sequence import PictureSink

Box = tuple[int, int, int, int]
_SHORT, _LONGEST = 65535, (1 << 24) - 1  # limits: terms of a PNG's fractions (s), a WebP's duration (ms)


class _Png:
    """An APNG: the chunks of the first still, then the data of each frame, numbered."""

    def __init__(self, file: IO[bytes], count: int, plays: int) -> None:
        self._file, self._begin, self._number = file, struct.pack(">II", count, plays), 0

    def _put(self, kind: bytes, data: bytes) -> None:
        self._file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))

    def _numbered(self, kind: bytes, data: bytes) -> None:
        self._put(kind, struct.pack(">I", self._number) + data)
        self._number += 1

    def add(self, still: bytes, box: Box, lasts: Fraction) -> Fraction:
        """Append a frame; return the seconds that it lasts, as the file has them."""
        first, chunks = self._number == 0, [*_chunks(still, 8, 0)]
        if first:
            self._file.write(still[:8])
            for kind, data in chunks:
                if kind not in (b"IDAT", b"IEND"):
                    self._put(kind, data)
            self._put(b"acTL", self._begin)
        lasts = max(lasts, Fraction(0))  # negative if earlier durations were rounded up
        if max(lasts.as_integer_ratio()) > _SHORT:
            scale = max(1, int(_SHORT / max(float(lasts), 1.0)))
            lasts = Fraction(min(max(1, round(lasts * scale)), _SHORT), scale)
        left, top, width, height = box
        head = struct.pack(">IIIIHHBB", width, height, left, top, *lasts.as_integer_ratio(), 0, 0)
        self._numbered(b"fcTL", head)
        data = b"".join(data for kind, data in chunks if kind == b"IDAT")
        self._put(b"IDAT", data) if first else self._numbered(b"fdAT", data)
        return lasts

    def finish(self) -> None:
        """Write the end."""
        self._put(b"IEND", b"")


class _WebP:
    """An animated WebP: the profile of the first still, the frames, and its other headers."""

    def __init__(self, file: IO[bytes], size: tuple[int, int], alpha: bool, plays: int) -> None:
        self._file, self._size, self._alpha, self._plays = file, size, alpha, min(plays, _SHORT)
        self._last: dict[bytes, bytes] | None = None

    def _put(self, kind: bytes, data: bytes) -> None:
        self._file.write(_riff(kind, data))

    def add(self, still: bytes, box: Box, lasts: Fraction) -> Fraction:
        """Append a frame; return the seconds that it lasts, as the file has them."""
        chunks = dict(_chunks(still, 12, 4))
        if self._last is None:
            known = {kind: data for kind, data in chunks.items() if kind in (b"ICCP", b"EXIF", b"XMP ")}
            flags = 2 | 32 * (b"ICCP" in known) | 16 * self._alpha | 8 * (b"EXIF" in known) | 4 * (b"XMP " in known)
            self._file.write(b"RIFF\0\0\0\0WEBP")
            self._put(b"VP8X", struct.pack("<I", flags) + _threes(*(n - 1 for n in self._size)))
            if profile := known.pop(b"ICCP", None):
                self._put(b"ICCP", profile)
            self._put(b"ANIM", struct.pack("<IH", 0, self._plays))
            self._last = known
        left, top, width, height = box
        ticks = min(max(1, round(lasts * 1000)), _LONGEST)
        head = _threes(left // 2, top // 2, width - 1, height - 1, ticks) + b"\2"  # flags: overwrite, do not blend
        data = b"".join(_riff(kind, chunks[kind]) for kind in (b"ALPH", b"VP8 ", b"VP8L") if kind in chunks)
        self._put(b"ANMF", head + data)
        return Fraction(ticks, 1000)

    def finish(self) -> None:
        """Write the end, and the size at the beginning."""
        for kind, data in (self._last or {}).items():
            self._put(kind, data)
        size = self._file.tell() - 8
        if size >> 32:
            raise OSError(errno.EFBIG, "a WebP ends at 4 GB")
        self._file.seek(4)
        self._file.write(struct.pack("<I", size))


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
    """A sink of frames; each is written when the next arrives, which determines its duration."""

    def __init__(self, clip: Any, target: Path, folder: Path, file: IO[bytes], options: dict[str, Any]) -> None:
        super().__init__(clip, target.parent, folder, lambda k: target.name, options)
        self._made: _WebP | _Png = _Png(file, clip.count, clip.plays or 0)
        self._step = 1
        if target.suffix.lower() == ".webp":
            height, width = clip.layout.shape
            size = (height, width) if round(clip.rotation / 90) % 2 else (width, height)
            self._made = _WebP(file, size, clip.layout.groups[0].alpha, clip.plays or 0)
            self._step = 2  # offsets of frames must be even
        self._before: Array | None = None
        self._due: tuple[bytes, Box] | None = None
        self._end = self._start = self._shown = Fraction(0)

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Encode frame ``k``."""
        ticks, lasts = self._clip.time(k)
        pixels, like = self._rendered(arrays, k)
        if self._due is None:
            self._start = ticks * self._clip.base
        self._flush(ticks * self._clip.base)
        self._end = (ticks + lasts) * self._clip.base
        left, top, width, height = box = _changed(pixels, self._before, self._step)
        self._before = pixels.copy()
        self._save(k, pixels[top : top + height, left : left + width], like)
        self._due = (self._temporary / self._names(k)).read_bytes(), box
        (self._temporary / self._names(k)).unlink()

    def _flush(self, until: Fraction) -> None:
        """Write the pending frame, shown until the time ``until``; its rounding error is carried to the next."""
        if self._due is not None:
            self._shown += self._made.add(*self._due, until - self._start - self._shown)

    def finish(self) -> None:
        """Write the last frame."""
        self._flush(self._end)
        self._made.finish()


def _changed(pixels: Array, before: Array | None, step: int) -> Box:
    """Return the box around the pixels that differ: x, y, width and height; one pixel if none do."""
    if before is None:
        return 0, 0, pixels.shape[1], pixels.shape[0]
    left, top, right, bottom = bounds((pixels != before).any(axis=2)) or (0, 0, 1, 1)
    left, top = left // step * step, top // step * step
    return left, top, right - left, bottom - top


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
        warnings.warn(text, ClipWarning, stacklevel=3)
    with (
        replacing(target, force=force) as temporary,
        tempfile.TemporaryDirectory(prefix=".", dir=temporary.parent) as folder,
        open(temporary, "wb") as file,
    ):
        sink = AnimationSink(clip, Path(target), Path(folder), file, options)
        yield sink
        sink.finish()
