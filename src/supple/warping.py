"""Arrays and functions through a map: checked, prepared and sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu.sampling import FILTERS, OUTSIDE, sampler
from supple.cpu.warp import Band
from supple.domain import integer, refuse
from supple.errors import SuppleError

__all__ = ["FILTERS", "OUTSIDE", "Source", "warp_array", "warp_function"]

Array = npt.NDArray[Any]
Source = Array | Callable[[npt.NDArray[np.float64]], npt.ArrayLike]

_MOST_POINTS = 1 << 18  # of a function, asked for at once


def warp_array(
    source: Array,
    shape: tuple[int, ...],
    untouched: bool,
    each: Callable[[Callable[[Band], None]], object],
    *,
    filter: str,
    outside: str,
    fill: float | Sequence[float],
    alpha: bool | None,
    light: bool,
    out: Array | None,
) -> Array:
    """Sample an array at the source points of every band that ``each`` calls its argument with."""
    try:
        array = np.asarray(source)
    except (TypeError, ValueError):
        refuse("source", "an array of numbers", source)
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        refuse("source", "an array of bool, integers or floats of up to 64 bits", f"dtype {array.dtype}")
    if array.shape[:2] != shape or array.ndim not in (2, 3) or 0 in array.shape:
        height, width = shape
        wanted = f"of shape ({height}, {width}) or ({height}, {width}, channels), as the deformation is"
        refuse("source", wanted, f"shape {array.shape}")
    channels = array.shape[2] if array.ndim == 3 else 1
    straight = bool(alpha) if alpha is not None else channels == 4 and array.dtype.str[1:] in ("u1", "u2")
    if straight and channels < 2:
        raise SuppleError(f"alpha=True needs a last channel beside the colours, found shape {array.shape}")
    if light and (array.dtype.kind == "b" or (array.dtype.kind in "iu" and array.dtype.str[1:] not in ("u1", "u2"))):
        raise SuppleError(f"linear_light needs 8 or 16 bit colours or floats, found {array.dtype}")
    colours = _fill(fill, channels)
    result = _result(out, array)
    if untouched:
        result[...] = array
        return result
    native = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    deep = native if native.ndim == 3 else native[..., None]
    target = result
    if not result.flags.c_contiguous or result.dtype != native.dtype or not result.dtype.isnative:
        target = np.empty(native.shape, native.dtype)
    each(
        sampler(
            deep,
            target if target.ndim == 3 else target[..., None],
            filter=filter,
            outside=outside,
            fill=colours,
            alpha=straight,
            light=light,
        )
    )
    if target is not result:
        result[...] = target
    return result


def _fill(fill: float | Sequence[float], channels: int) -> npt.NDArray[np.float64]:
    try:
        values = np.asarray(fill, np.float64)
    except (TypeError, ValueError):
        refuse("fill", "a number, or one for each channel", fill)
    if values.shape not in ((), (1,), (channels,)) or not np.isfinite(values).all():
        refuse("fill", f"a number, or {channels} of them, one for each channel", fill)
    return np.ascontiguousarray(np.broadcast_to(values, (channels,)))


def _result(out: Array | None, like: Array) -> Array:
    if out is None:
        return np.empty_like(like, order="C")
    wanted = f"an array of {like.dtype} of shape {like.shape}, as the source is"
    given: object = out  # it may be anything
    if not isinstance(given, np.ndarray):
        refuse("out", wanted, given)
    if out.shape != like.shape or out.dtype != like.dtype:
        refuse("out", wanted, f"{out.dtype} of shape {out.shape}")
    if not out.flags.writeable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if np.may_share_memory(out, like):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return out


def warp_function(
    function: Callable[[npt.NDArray[np.float64]], npt.ArrayLike],
    shape: tuple[int, int],
    inverse: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
    samples: int,
    out: Array | None,
) -> Array:
    """Evaluate a function of points at T⁻¹ of every output pixel, at the mean of ``samples``² points of each.

    There is nothing to interpolate: the function is as sharp, however far the map enlarges it.
    """
    samples = integer("samples", samples, "a number of samples along a pixel's side, from 1 to 64", 1, 64)
    height, width = shape
    within = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + within).ravel()
    rows = max(1, _MOST_POINTS // (width * samples * samples))
    result: Array | None = None
    for top in range(0, height, rows):
        y = (np.arange(top, min(top + rows, height))[:, None] + within).ravel()
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        points = inverse(grid)
        values = np.asarray(function(points))
        if values.ndim not in (1, 2) or values.shape[0] != len(points) or values.dtype.kind not in "biuf":
            wanted = f"numbers of shape ({len(points)},) or ({len(points)}, channels) for points {points.shape}"
            refuse("the function's values", wanted, f"{values.dtype} of shape {values.shape}")
        if values.dtype.kind != "f":
            values = values.astype(np.float64)
        square = values.reshape(len(y) // samples, samples, width, samples, *values.shape[1:]).mean(axis=(1, 3))
        if result is None:
            result = _result(out, np.empty((height, width, *values.shape[1:]), values.dtype))
        result[top : top + len(square)] = square
    assert result is not None
    return result
