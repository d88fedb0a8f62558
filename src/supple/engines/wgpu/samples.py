"""The layout of samples in the words of a shader, and their sampling options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.base import BETWEEN, FILTERS, OUTSIDE

Array = npt.NDArray[Any]

STEP = 16  # pixels from node to node, as in warp.wgsl
_NOTHING = {"nothing": 3}  # for frames that are separate images
FARTHEST = 1 << 22  # frames from the first one


@dataclass(frozen=True, slots=True)
class Format:
    """The layout of pixels in words of 32 bits.

    ``number`` is the code for FORMAT, ``dtype`` the type of a channel, ``channels`` their number in memory, of which
    the last ones may be padding, and ``pixels`` how many a thread writes.
    """

    number: int
    dtype: Any
    channels: int
    pixels: int

    @property
    def size(self) -> int:
        """Bytes of a pixel."""
        return self.channels * int(np.dtype(self.dtype).itemsize)

    def words(self, width: int) -> int:
        """Return the number of words in a row of ``width`` pixels."""
        return self.threads(width) * self.pixels * self.size // 4

    def threads(self, width: int) -> int:
        """Return the number of threads that write a row."""
        return -(-width // self.pixels)

    def packed(self, source: Array) -> Array:
        """Return pixels (…, channels) as words: padded channels, and types unknown to the shader as floats."""
        if source.shape[-1] == self.channels and source.dtype == self.dtype:
            return np.ascontiguousarray(source)
        out = np.zeros((*source.shape[:-1], self.channels), self.dtype)
        out[..., : source.shape[-1]] = source
        return out


_BYTE, _BYTES, _BYTE_PAIR = Format(0, np.uint8, 1, 4), Format(1, np.uint8, 4, 1), Format(4, np.uint8, 2, 2)
_SHORT, _SHORTS, _SHORT_PAIR = Format(2, np.uint16, 1, 2), Format(3, np.uint16, 4, 1), Format(5, np.uint16, 2, 1)
_FLOAT, _FLOATS = Format(6, np.float32, 1, 1), Format(7, np.float32, 4, 1)


def format_of(dtype: Any, channels: int) -> Format | None:
    """Return the format for samples of a type; None if float32 does not hold all of their values."""
    kind = np.dtype(dtype).newbyteorder("=")
    if channels > 4:
        return None
    if kind == np.uint8:
        return {1: _BYTE, 2: _BYTE_PAIR}.get(channels, _BYTES)
    if kind == np.uint16:
        return {1: _SHORT, 2: _SHORT_PAIR}.get(channels, _SHORTS)
    if kind in (np.float32, np.float16, np.int8, np.int16, np.bool_):
        return _FLOAT if channels == 1 else _FLOATS
    return None


@dataclass(frozen=True, slots=True)
class Wanted:
    """The sampling options of a shader.

    Parameters
    ----------
    filter, between, outside : str
        As in `supple.Deformation.warp`; ``between`` is ``"nothing"`` if each frame is a separate image.
    average : bool
        Whether pixels are averaged over the time that they cover.
    fill : tuple of float
        The fill value, one for each channel.
    alpha, light : bool
        Whether the last channel is opacity, and whether averages are in linear light.
    white : float
        The value of white and of full opacity.
    tolerance : float
        The tolerance of a source point, in pixels.
    times : (int, int)
        The times beyond which samples are constant.
    """

    filter: str
    between: str
    outside: str
    average: bool
    fill: tuple[float, ...]
    alpha: bool
    light: bool
    white: float
    tolerance: float
    times: tuple[int, int]


@dataclass(frozen=True, slots=True)
class GpuGroup:
    """A grid of samples, alike for all frames, and its sampling options.

    Parameters
    ----------
    shape : (int, int)
        Rows, and samples in a row.
    channels : int
    dtype : numpy.dtype
    wanted : Wanted
    step : (int, int)
        Pixels of the frame from one sample to the next, x first.
    offset : (float, float)
        The position of the first sample, in pixels.
    """

    shape: tuple[int, int]
    channels: int
    dtype: Any
    wanted: Wanted
    step: tuple[int, int] = (1, 1)
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def format(self) -> Format:
        """The format in which samples are transferred."""
        form = format_of(self.dtype, self.channels)
        assert form is not None
        return form

    @property
    def rows(self) -> int:
        """The number of rows of samples in a cell of the lattice."""
        return STEP // self.step[1]

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the largest value of an integer type."""
        kind = np.dtype(self.dtype)
        if kind.kind not in "iu":
            return 0.0, 0.0
        return float(np.iinfo(kind).min), min(float(np.iinfo(kind).max), self.wanted.white)

    def constants(self) -> dict[str, float]:
        """Return the constants that shaders are compiled for."""
        wanted, form = self.wanted, self.format
        filtered = wanted.filter != "nearest"
        # If a sample takes many loop iterations, each thread computes one sample.
        averaging = wanted.average or wanted.filter == "auto"
        across = max(1, STEP // self.step[0] // form.pixels)
        return {
            "FORMAT": form.number,
            "FILTER": FILTERS[wanted.filter],
            "BETWEEN": (BETWEEN | _NOTHING)[wanted.between],
            "OUTSIDE": OUTSIDE[wanted.outside],
            "ALPHA": int(wanted.alpha and filtered),
            "LIGHT": int(wanted.light and filtered),
            "AVERAGE": int(wanted.average),
            "CHANNELS": self.channels,
            "ACROSS": across,
            "DOWN": min(self.rows, max(1, (256 if averaging else 32) // across)),
            "PIXELS": form.pixels,
            "WORDS": form.pixels * form.size // 4,
            "ROWS": self.rows,
        }

    def store(self, pixels: Array, out: Array) -> None:
        """Write pixels from the shader (…, channels) to their destination."""
        made = pixels[..., : self.channels]
        if out.dtype.kind in "iub" and made.dtype.kind == "f":
            if out.dtype == np.bool_:
                out[...] = made >= 0.5
                return
            out[...] = np.clip(np.rint(made), *self.bounds)
            return
        with np.errstate(over="ignore"):
            out[...] = made


def known_grid(step: tuple[int, int], offset: tuple[float, float], dtype: Any, channels: int) -> bool:
    """Return whether each cell of the lattice has whole words of its own."""
    form = format_of(dtype, channels)
    if form is None:
        return False
    divided = all(STEP % k == 0 for k in step) and (STEP // step[0]) % form.pixels == 0
    return divided and all(0 <= x < k for x, k in zip(offset, step, strict=True))
