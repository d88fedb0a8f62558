"""Image formats that libvips lacks, by FFmpeg's codecs: DPX, SGI, Radiance, JPEG 2000, BMP, TGA and PNM."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from fractions import Fraction
from typing import Any

from supple.errors import need

need("video", "DPX, SGI, Radiance, JPEG 2000, BMP, TGA and PNM pictures", "av")

import av
import numpy as np

from supple.media.files import PathLike, refusing, unwritable
from supple.media.image.formats import Array, damaged
from supple.media.video.colour import FULL, Colour, to_rgb
from supple.media.video.demux import said
from supple.media.video.planes import form, pack, palette, unpack, wider


def decoded(path: PathLike, codec: str) -> tuple[Array, int]:
    """Decode an image: shape (H, W) or (H, W, C), in grey or RGB; return its bits a channel, too."""
    with open(path, "rb") as file:
        data = file.read()
    context: Any = av.CodecContext.create(codec, "r")
    frames = [*context.decode(av.Packet(data)), *context.decode(None)]
    if not frames:
        raise av.error.InvalidDataError(0, "no picture in it")
    frame: av.VideoFrame = frames[0]
    if frame.format.has_palette:
        seen = palette(frame)
        count = 4 if (seen[..., 3] < 255).any() else 3 if (seen[..., :1] != seen[..., 1:3]).any() else 1
        return np.ascontiguousarray(seen[..., :count] if count > 1 else seen[..., 0]), 8
    own = form(frame.format.name)
    if own is None:
        frame = frame.reformat(format=wider(frame.format.name))
        own = form(frame.format.name)
        assert own is not None
    kind = own.kind
    shape = (frame.height, frame.width)
    layout = kind.layout(frame.width, frame.height, (0.0, 0.0))
    arrays = [np.empty((*group.shape, group.channels), kind.dtype) for group in layout.groups]
    unpack(frame, own, arrays)
    if kind.family in ("yuv", "xyz"):
        # as in JPEG and TIFF: BT.601 in the full range, chroma in the middle of its pixels
        colour = Colour(FULL, matrix=5, site="center") if kind.family == "yuv" else Colour(FULL)
        return to_rgb(arrays, own, colour, shape, kind.bits > 8), 8 if kind.bits <= 8 else 16
    pixels = arrays[0][..., 0] if layout.groups[0].channels == 1 else arrays[0]
    if not kind.real and 8 < kind.bits < 16:
        pixels = pixels << (16 - kind.bits) | pixels >> (2 * kind.bits - 16)
    return pixels, kind.bits


def encoded(pixels: Array, codec: str, pixel_format: str, options: Mapping[str, str] | None = None) -> bytes:
    """Encode an image without loss, within the format's depth."""
    height, width = pixels.shape[:2]
    known = form(pixel_format)
    assert known is not None
    context: Any = av.CodecContext.create(codec, "w")
    context.width, context.height, context.pix_fmt = width, height, pixel_format
    context.time_base = Fraction(1)
    context.options = dict(options or {})
    frame = pack([pixels.reshape(height, width, -1)], known, av.VideoFrame(width, height, pixel_format))
    return b"".join(bytes(packet) for packet in (*context.encode(frame), *context.encode(None)))


def reading(path: PathLike) -> AbstractContextManager[None]:
    """Convert a codec's errors to one sentence."""
    return refusing(lambda error: damaged(path, said(error)), av.FFmpegError)


def writing(path: PathLike) -> AbstractContextManager[None]:
    """Convert a codec's errors to one sentence; errors of the system stay an `OSError`."""
    return refusing(
        lambda error: unwritable(path, f"FFmpeg fails ({said(error)})", "try another format"), av.FFmpegError
    )
