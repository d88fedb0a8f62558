"""Sample arrays at a band's source points: which kernel, in which numbers, for any type, filter and colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu import filters, footprint, region, sample
from supple.cpu.warp import Band

FILTERS = {
    "linear": footprint.LINEAR,
    "cubic": footprint.CUBIC,
    "auto": footprint.AUTO,
    "antialias": footprint.ANTIALIAS,
    "ewa": footprint.EWA,
}
OUTSIDE = {"edge": region.EDGE, "constant": region.CONSTANT, "reflect": region.REFLECT}

Array = npt.NDArray[Any]


def linear_light(values: npt.NDArray[np.floating], white: float) -> npt.NDArray[np.floating]:
    """Values on sRGB's curve as amounts of light; ``white`` stays ``white``."""
    u = np.asarray(values) / white
    with np.errstate(invalid="ignore"):
        return np.asarray(white * np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))


def sampler(
    source: Array, out: Array, *, filter: str, outside: str, fill: Array, alpha: bool, light: bool
) -> Callable[[Band], None]:
    """What samples ``source`` at the source points of a band into the band's rows of ``out``.

    Parameters
    ----------
    source, out : arrays, shape (H, W, C), of one type
        Of bool, integers or floats; ``source`` in native byte order.
    filter, outside : str
        ``"nearest"`` or one of FILTERS; one of OUTSIDE.
    fill : array, shape (C,)
        What lies outside, under ``"constant"``, in the source's values.
    alpha : bool
        Whether the last channel is opacity: the others are multiplied by it while they are filtered.
    light : bool
        Whether colours are averaged as amounts of light rather than as values on sRGB's curve.
    """
    truth = source.dtype == np.bool_
    if truth:
        source, out = source.view(np.uint8), out.view(np.uint8)
    half = source.dtype == np.float16
    if half:
        source = source.astype(np.float32)
    source = source.view()
    source.flags.writeable = False  # one type for the kernels, whatever the caller's array allows
    rule = OUTSIDE[outside]
    channels = source.shape[2]
    integral = source.dtype.kind in "iu"
    limits = np.iinfo(source.dtype) if integral else None
    top = float(limits.max) if limits and not truth else 1.0

    if filter == "nearest":
        exact = fill.astype(source.dtype)

        def use_nearest(band: Band) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            target = np.empty(rows.shape, source.dtype) if half else rows
            sample.nearest(source, band.points, band.anchors, rule, exact, target)
            if half:
                rows[...] = target

        return use_nearest

    if filter == "linear" and source.dtype == np.uint8 and channels <= 4 and not alpha and not light:
        values = np.clip(np.floor(fill + 0.5), 0, 255).astype(np.uint32)
        word = np.uint32(sum(int(v) << (8 * c) for c, v in enumerate(values)))

        def use_words(band: Band) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            sample.linear_words(source, band.points, band.anchors, band.boxes, rule, word, rows)

        return use_words

    fine = source.dtype.itemsize > 2 and source.dtype != np.float32
    number = np.dtype(np.float64 if fine else np.float32)
    levels = np.empty(0, number)
    inside = fill.astype(number)
    if light:
        colours = slice(0, channels - 1 if alpha else channels)
        if integral and source.dtype.itemsize <= 2 and limits and limits.min == 0:
            levels = linear_light(np.arange(limits.max + 1.0), top).astype(number)
        else:
            source = source.astype(number)
            source[..., colours] = linear_light(source[..., colours], top)
            source.flags.writeable = False
        inside[colours] = linear_light(inside[colours], top)
    if alpha:
        inside[:-1] *= inside[-1] / top
    low, high = (float(limits.min), _below(limits.max, number)) if limits else (0.0, 0.0)
    table = footprint.weights(number)
    mode = FILTERS[filter]

    def use(band: Band) -> None:
        rows = out[band.top : band.top + band.points.shape[1]]
        target = np.empty(rows.shape, np.float32) if half else rows
        filters.filtered(
            source,
            band.points,
            band.anchors,
            band.boxes,
            mode,
            1 if channels == 1 else 4,
            rule,
            inside,
            channels - 1 if alpha else -1,
            top,
            levels,
            table,
            np.zeros(9, number),
            top if light else 0.0,
            low,
            high,
            integral,
            source.dtype == np.uint8,
            target,
        )
        if half:
            with np.errstate(over="ignore"):
                rows[...] = target

    return use


def _below(most: int, number: np.dtype[Any]) -> float:
    """The largest number of a type that is no more than ``most``, so that it converts back."""
    nearest = number.type(most)
    return float(np.nextafter(nearest, number.type(0)) if int(nearest) > most else nearest)
