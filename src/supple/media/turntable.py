"""Turntables: pictures of 8-bit RGB, written one after the other as a video."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, need, shown
from supple.media.files import check_output, replacing

_CODECS = {".mp4": "libx264", ".mov": "libx264", ".mkv": "libx264", ".webm": "libvpx-vp9", ".gif": "gif"}
_OPTIONS = {
    "libx264": {"crf": "16", "preset": "medium"},
    "libvpx-vp9": {"crf": "20", "b": "0", "row-mt": "1", "cpu-used": "2"},
    "gif": {},
}
SUFFIXES = tuple(_CODECS)
_FASTEST = 50  # pictures a second of a GIF: it counts hundredths, and players slow down what is shorter than two


def check_turntable(path: str | os.PathLike[str], size: tuple[int, int], rate: float) -> None:
    """Refuse a size or a rate that the format of ``path`` does not have; SuppleError says what would do."""
    suffix, (height, width) = Path(path).suffix.lower(), size
    if _CODECS[suffix] == "libx264" and (height % 2 or width % 2):
        even = f"{width + width % 2}x{height + height % 2}"
        raise SuppleError(
            f"size must be even along both sides for H.264 ({suffix}), found {width}x{height}: give {even}, or write "
            ".webm or .gif"
        )
    if suffix == ".gif" and rate > _FASTEST:
        raise SuppleError(f"rate must be at most {_FASTEST} pictures a second for a GIF, found {rate:g}")


def write_turntable(
    path: str | os.PathLike[str],
    pictures: Iterable[npt.NDArray[np.uint8]],
    size: tuple[int, int],
    *,
    rate: float = 24.0,
    force: bool = False,
) -> None:
    """Encode pictures as H.264, VP9 or GIF; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        ``.mp4``, ``.mov``, ``.mkv``, ``.webm`` or ``.gif``.
    pictures : iterable of uint8 arrays, shape (H, W, 3)
        sRGB.
    size : (int, int)
        Their rows and columns; even for H.264.
    rate : float
        Pictures a second.
    force : bool
        Whether to replace a file that exists.

    Raises
    ------
    SuppleError
        If the file cannot be written, or not with that size or rate.
    """
    need("video", "videos", "av")
    import av

    check_output(path, force=force)
    check_turntable(path, size, rate)
    height, width = size
    codec = _CODECS[Path(path).suffix.lower()]
    exact = Fraction(rate).limit_denominator(1001)
    with replacing(path, force=force) as place:
        try:
            with av.open(str(place), "w") as made:
                stream: Any = made.add_stream(codec, rate=100 if codec == "gif" else exact)
                stream.width, stream.height = width, height
                stream.pix_fmt = "pal8" if codec == "gif" else "yuv420p"
                stream.options = _OPTIONS[codec]
                if codec == "gif":
                    _palettes(made, stream, pictures, exact)
                    return
                # BT.709, limited range, said in the file: players guess otherwise.
                stream.codec_context.color_range, stream.codec_context.colorspace = 1, 1
                stream.codec_context.color_primaries, stream.codec_context.color_trc = 1, 1
                for picture in pictures:
                    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24")
                    made.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
                made.mux(stream.encode(None))
        except av.FFmpegError as error:
            reason = error.strerror or "the encoder failed"
            raise SuppleError(f"cannot write {shown(path)}: {reason}: choose another place or format") from error


def _palettes(made: Any, stream: Any, pictures: Iterable[npt.NDArray[np.uint8]], rate: Fraction) -> None:
    """Encode pictures as a GIF that goes round, each with a palette of its own, at times in hundredths."""
    import av

    from supple.media.video.gif import Palettes

    palettes, stream.time_base = Palettes(stream.width, stream.height), Fraction(1, 100)
    for k, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24").reformat(format="bgra")
        frame.pts, frame.time_base = round(100 * k / rate), Fraction(1, 100)
        for done in palettes.add(frame):
            made.mux(stream.encode(done))
    for done in palettes.finish():
        made.mux(stream.encode(done))
    made.mux(stream.encode(None))
