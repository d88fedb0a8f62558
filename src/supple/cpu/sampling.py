"""Sample arrays at a band's source points: which kernel, in which numbers, for any type, filter and colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.colour import linear_light
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


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """How samples of a type are worked with, as `supple.cpu.region.load` and `store` take it."""

    alpha: int
    top: float
    light: bool
    levels: Array
    inside: Array
    low: float
    high: float
    whole: bool

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type that all is worked out in."""
        return self.inside.dtype

    def arguments(self, rule: int, table: Array) -> tuple[Any, ...]:
        """What filters take, from ``lanes`` to ``whole``."""
        return (
            1 if len(self.inside) == 1 else 4,
            rule,
            self.inside,
            self.alpha,
            self.top,
            self.levels,
            table,
            self.top if self.light else 0.0,
            self.low,
            self.high,
            self.whole,
        )


def numbers_of(dtype: np.dtype[Any], fill: Array, *, alpha: bool, light: bool, white: float | None = None) -> Numbers:
    """Choose them, for samples of a type.

    Parameters
    ----------
    dtype : numpy.dtype
        Bool, as bytes, has ``white`` 1.
    fill : array, shape (channels,)
        What lies outside, in the samples' values.
    alpha, light : bool
        As `sampler` takes them.
    white : float, optional
        The largest value, and that of opaque; by default, what an integer type holds, and 1 of floats.
    """
    limits = np.iinfo(dtype) if dtype.kind in "iu" else None
    top = float(limits.max) if limits else 1.0
    top = top if white is None else white
    number = np.dtype(np.float64 if dtype.itemsize > 2 and dtype != np.float32 else np.float32)
    levels = np.empty(0, number)
    inside = fill.astype(number)
    if light:
        colours = slice(0, -1 if alpha else None)
        if limits and dtype.itemsize <= 2 and limits.min == 0:
            levels = linear_light(np.arange(limits.max + 1.0), top).astype(number)
        inside[colours] = linear_light(inside[colours], top)
    if alpha:
        inside[:-1] *= inside[-1] / top
    low, high = (float(limits.min), _below(limits.max, number)) if limits else (0.0, 0.0)
    if limits and white is not None:
        high = min(high, white)
    return Numbers(len(fill) - 1 if alpha else -1, top, light, levels, inside, low, high, limits is not None)


def sampler(
    source: Array, out: Array, *, filter: str, outside: str, fill: Array, alpha: bool, light: bool, white: float | None
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
    white : float, optional
        The largest value, if that is not what the type holds.
    """
    if source.dtype == np.bool_:
        source, out, white = source.view(np.uint8), out.view(np.uint8), 1.0
    half = source.dtype == np.float16
    if half:
        source = source.astype(np.float32)
    source = source.view()
    source.flags.writeable = False  # one type for the kernels, whatever the caller's array allows
    rule = OUTSIDE[outside]
    channels = source.shape[2]

    if filter == "nearest":
        exact = fill.astype(source.dtype)

        def use_nearest(band: Band) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            target = np.empty(rows.shape, source.dtype) if half else rows
            sample.nearest(source, band.points, band.anchors, band.edges, rule, exact, target)
            if half:
                rows[...] = target

        return use_nearest

    if filter == "linear" and source.dtype == np.uint8 and channels <= 4 and not alpha and not light:
        values = np.clip(np.floor(fill + 0.5), 0, 255).astype(np.uint32)
        word = np.uint32(sum(int(v) << (8 * c) for c, v in enumerate(values)))

        def use_words(band: Band) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            sample.linear_words(source, band.points, band.anchors, band.edges, band.boxes, rule, word, rows)

        return use_words

    n = numbers_of(source.dtype, fill, alpha=alpha, light=light, white=white)
    if light and n.levels.size == 0:
        source = source.astype(n.dtype)
        colours = slice(0, channels - 1 if alpha else channels)
        source[..., colours] = linear_light(source[..., colours], n.top)
        source.flags.writeable = False
    table = footprint.weights(n.dtype)
    mode = FILTERS[filter]

    def use(band: Band) -> None:
        rows = out[band.top : band.top + band.points.shape[1]]
        if not rows.size:  # of chroma, a thin band may have no row
            return
        target = np.empty(rows.shape, np.float32) if half else rows
        filters.filtered(
            source,
            band.points,
            band.beyond(mode >= footprint.AUTO),
            band.anchors,
            band.edges,
            band.boxes,
            mode,
            *n.arguments(rule, table),
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
