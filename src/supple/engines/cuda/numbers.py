"""The numbers of the kernels for samples of a type: their limits, and the fill value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """The numbers for samples of a type.

    Parameters
    ----------
    alpha : int
        The opacity channel, or -1.
    white : float
        The largest value, which is also full opacity.
    low, high : float
        The limits of an integer type.
    whole : bool
        Whether the type is an integer type.
    fills : array, shape (channels,)
        The fill value, converted like filtered samples, of the type that colours are computed in.
    """

    alpha: int
    white: float
    low: float
    high: float
    whole: bool
    fills: Array

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type that colours are computed in."""
        return self.fills.dtype


def numbers_of(dtype: np.dtype[Any], fill: Array, *, alpha: bool, light: bool, white: float | None = None) -> Numbers:
    """Choose the numbers for samples of a type.

    Parameters
    ----------
    dtype : numpy.dtype
        Bool, as bytes, has ``white`` 1.
    fill : array, shape (channels,)
        The fill value, in the units of the samples.
    alpha, light : bool
        Whether the last channel is opacity, and whether colours are averaged in linear light.
    white : float, optional
        The largest value, and full opacity; by default, the largest of an integer type, and 1 of floats.
    """
    limits = np.iinfo(dtype) if dtype.kind in "iu" else None
    top = float(limits.max) if limits else 1.0
    top = top if white is None else white
    number = np.dtype(np.float64 if dtype.itemsize > 2 and dtype != np.float32 else np.float32)
    fills = fill.astype(number)
    if light:
        colours = slice(0, -1 if alpha else None)
        fills[colours] = _linear(fills[colours], top)
    if alpha:
        fills[:-1] *= fills[-1] / top
    low, high = (float(limits.min), _below(limits.max, number)) if limits else (0.0, 0.0)
    if limits and white is not None:
        high = min(high, white)
    return Numbers(len(fill) - 1 if alpha else -1, top, low, high, limits is not None, fills)


def _linear(values: Array, white: float) -> Array:
    """Return sRGB values in linear light; ``white`` is unchanged."""
    u = values / white
    with np.errstate(invalid="ignore"):
        return np.asarray(white * np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))


def _below(most: int, number: np.dtype[Any]) -> float:
    """Return the largest number of a type that is at most ``most``, so that it converts back."""
    nearest = number.type(most)
    return float(np.nextafter(nearest, number.type(0)) if int(nearest) > most else nearest)
