"""Pictures of 8-bit RGB, written one after the other as a video."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.media.files import check_output, replacing, shown

SUFFIXES = (".mp4", ".mov", ".mkv")
_CRF = "16"


def write_reel(
    path: str | os.PathLike[str],
    pictures: Iterable[npt.NDArray[np.uint8]],
    size: tuple[int, int],
    *,
    rate: float = 24.0,
    force: bool = False,
) -> None:
    """Encode pictures as H.264; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        ``.mp4``, ``.mov`` or ``.mkv``.
    pictures : iterable of uint8 arrays, shape (H, W, 3)
        sRGB; an odd row or column is repeated, as H.264 needs even numbers.
    size : (int, int)
        Their rows and columns.
    rate : float
        Pictures a second.
    force : bool
        Whether to replace a file that exists.

    Raises
    ------
    SuppleError
        If the file cannot be written.
    """
    import av

    check_output(path, force=force)
    height, width = size
    odd = [(0, height % 2), (0, width % 2), (0, 0)]
    with replacing(path, force=force) as place:
        try:
            with av.open(str(place), "w") as made:
                stream: Any = made.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
                stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                stream.options = {"crf": _CRF, "preset": "medium"}
                # BT.709, limited range, said in the file: players guess otherwise.
                stream.codec_context.color_range, stream.codec_context.colorspace = 1, 1
                stream.codec_context.color_primaries, stream.codec_context.color_trc = 1, 1
                for picture in pictures:
                    even = np.ascontiguousarray(np.pad(picture, odd, mode="edge"))
                    frame = av.VideoFrame.from_ndarray(even, "rgb24")
                    made.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
                made.mux(stream.encode(None))
        except av.FFmpegError as error:
            reason = error.strerror or "the encoder failed"
            raise SuppleError(f"cannot write {shown(path)}: {reason}: choose another place or format") from error
