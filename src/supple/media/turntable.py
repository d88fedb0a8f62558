"""Turntables: rendered images of 8-bit RGB, written as a video or an animated picture."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Group, Layout
from supple.errors import SuppleError, argument, need, shown
from supple.media import animation
from supple.media.codecs import CODECS, CONTAINERS, ENCODERS, Encoder
from supple.media.files import PathLike, check_output
from supple.media.image import Picture
from supple.media.numbering import has_number
from supple.media.sequence import Pictures
from supple.media.suffixes import ANIMATED, suffix_of

_USED = {suffix: CODECS[each.usual].encoder for each in CONTAINERS for suffix in each.suffixes[:1] if not each.counted}
SUFFIXES = (*_USED, *ANIMATED)
_FASTEST = 50  # images a second in a GIF: durations are in 1/100 s, and players slow down those below 2/100 s


def is_one(path: PathLike) -> bool:
    """Return whether a name is that of a video or an animation, and not a pattern of numbered images."""
    return suffix_of(path) in _USED or (suffix_of(path) in ANIMATED and not has_number(path))


class _Drawn(Pictures):
    """Rendered images, which have no files, as the frames of a clip."""

    def __init__(self, name: str, size: tuple[int, int], rate: Fraction) -> None:
        self.name, self.paths, self.first, self.rate, self.interpretation = name, [], None, rate, "srgb"
        self.layout = Layout((Group(size, 3),), np.dtype(np.uint8), 255.0)

    def picture(self, k: int) -> tuple[Picture, list[str]]:
        """Return an image without pixels or profile."""
        return Picture(np.empty((0, self.layout.shape[1], 3), np.uint8)), []


def check_turntable(path: PathLike, size: tuple[int, int], rate: float) -> None:
    """Raise SuppleError for a size or a rate that the format of ``path`` does not support."""
    suffix, (height, width) = Path(path).suffix.lower(), size
    if _USED.get(suffix) == "libx264" and (height % 2 or width % 2):
        even = f"{width + width % 2}x{height + height % 2}"
        text = f"{argument('size')} must be even along both sides for H.264 ({suffix}), found {width}x{height}: give"
        raise SuppleError(f"{text} {even}, or write .webm or .gif")
    if suffix == ".gif" and rate > _FASTEST:
        raise SuppleError(f"{argument('rate')} must be at most {_FASTEST} pictures a second for a GIF, found {rate:g}")


def write_turntable(
    path: PathLike,
    pictures: Iterable[npt.NDArray[np.uint8]],
    size: tuple[int, int],
    *,
    rate: float = 24.0,
    force: bool = False,
) -> None:
    """Encode sRGB images (H, W, 3) of one ``size``, (rows, columns), as a video or an animation, by the suffix.

    The file appears whole or not at all. SuppleError if it cannot be written with that size or rate.
    """
    check_output(path, force=force)
    check_turntable(path, size, rate)
    drawn = _Drawn(shown(path), size, Fraction(rate).limit_denominator(1001))
    how: dict[str, Any] = {}
    writer: Any = animation.writer
    if suffix_of(path) not in ANIMATED:
        need("video", "videos", "av")
        from supple.media.video.encode import writer

        encoder = ENCODERS.get(_USED[suffix_of(path)], Encoder("gif", "gif"))
        how = {"crf": encoder.drawn, "pixel_format": "yuv420p"} if encoder.drawn else {}
    with writer(drawn, path, force=force, **how) as sink:
        for k, picture in enumerate(pictures):
            sink.write([picture], k)
