"""Sample a stack of frames at a band's source points: which kernel, in which numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu import between, direct, footprint, frames
from supple.cpu.band import FARTHEST
from supple.cpu.between import LONGEST
from supple.cpu.sampling import FILTERS, OUTSIDE, numbers_of
from supple.cpu.warp import Band

BETWEEN = {"nearest": between.NEAREST, "linear": between.LINEAR, "cubic": between.CUBIC}
SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2}

Array = npt.NDArray[Any]
Sampler = Callable[[Band, Array, int, npt.NDArray[np.int64]], None]


def stack_sampler(
    source: Array,
    count: int,
    *,
    filter: str,
    between_frames: str,
    average: bool,
    outside: str,
    fill: Array,
    alpha: bool,
    light: bool,
    white: float,
) -> Sampler:
    """What samples frames at the source points of a band.

    Parameters
    ----------
    source : array, shape (slots, h, w, C)
        Some frames of a clip, contiguous and in native byte order; integers or floats of 32 and 64 bits.
    count : int
        How many frames the clip has.
    filter, outside : str
        ``"nearest"`` or one of FILTERS; one of OUTSIDE.
    between_frames : str
        How frames are interpolated: one of BETWEEN.
    average : bool
        Whether pixels are averaged over the time that they cover.
    fill, alpha, light, white
        As `supple.cpu.sampling.sampler` takes them; light of integers of up to 16 bits only.

    Returns
    -------
    function of (band, out, first, slots)
        It fills the band's rows of ``out`` (h, w, C). ``slots`` says where in ``source`` the frames from ``first`` on
        are, as `slots_of` makes it.
    """
    source = source.view()
    source.flags.writeable = False
    rule = OUTSIDE[outside]
    height, width, channels = source.shape[1:]
    samples = source.reshape(-1)

    if filter == "nearest":
        exact = fill.astype(source.dtype)

        def use_nearest(band: Band, out: Array, first: int, slots: npt.NDArray[np.int64]) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            frames.nearest_frames(source, slots, first, band.points, band.anchors, band.edges, rule, exact, rows)

        return use_nearest

    n = numbers_of(source.dtype, fill, alpha=alpha, light=light, white=white)
    plain = filter == "linear" and between_frames == "linear" and outside == "edge" and not (average or alpha or light)
    if plain and min(height, width) > 1:
        depth = source.dtype.itemsize if source.dtype.kind == "u" else 0
        packed = (depth, channels) in ((1, 1), (1, 2), (2, 1))
        zero = n.dtype.type(0)

        def use_linear(band: Band, out: Array, first: int, slots: npt.NDArray[np.int64]) -> None:
            rows = out[band.top : band.top + band.points.shape[1]]
            place = (samples, slots, count, first, height, width, band.points, band.anchors, band.edges)
            if packed:
                frames.linear_packed(*place, channels, rows)
            elif channels == 1 and samples.dtype == np.float32 == n.dtype:
                frames.linear_floats(*place, rows)
            elif channels == 1:
                frames.linear_single(*place, zero, n.whole, n.high, rows)
            else:
                frames.linear_plain(*place, zero, n.whole, n.high, rows)

        return use_linear

    table = footprint.weights(n.dtype)
    mode = FILTERS[filter]
    prepared = alpha or light or outside != "edge" or filter in ("linear", "ewa") or channels > 4
    readable = samples.dtype.kind != "f" or samples.dtype == n.dtype

    def use(band: Band, out: Array, first: int, slots: npt.NDArray[np.int64]) -> None:
        rows = out[band.top : band.top + band.points.shape[1]]
        if not rows.size:  # of chroma, a thin band may have no row
            return
        done = np.zeros(len(band.anchors), np.bool_)
        octets = source.dtype == np.uint8
        beyond = band.beyond(average or mode >= footprint.AUTO)
        timing = (BETWEEN[between_frames], average, mode)
        if not prepared and readable and min(height, width) > 1:
            place = (samples, slots, count, first, height, width, band.points, beyond, band.anchors, band.edges)
            direct.filtered_directly(
                *place, *times_seen(outside, count, average), *timing, table, n.low, n.high, n.whole, octets, done, rows
            )
            if done.all():
                return
        between.filtered_frames(
            source,
            slots,
            first,
            *times_seen(outside, count, average),
            band.points,
            beyond,
            band.anchors,
            band.edges,
            band.boxes,
            *timing,
            *n.arguments(rule, table),
            octets,
            done,
            rows,
        )

    return use


def times_seen(outside: str, count: int, average: bool) -> tuple[float, float]:
    """Beyond which times nothing changes any more, as an edge or a constant goes on."""
    beyond = 3.0 + (LONGEST / 2 if average else 0.0)
    if outside == "reflect":
        return -FARTHEST, FARTHEST
    return -beyond, count - 1.0 + beyond


def slots_of(first: int, last: int, count: int, outside: str, capacity: int) -> npt.NDArray[np.int64]:
    """Where the frames ``first`` to ``last`` are in a window that holds frame k in the slot k modulo its capacity.

    Frames outside the clip are those that stand for them; -1 for a constant.
    """
    k = np.arange(first, last + 1)
    if outside == "reflect":
        k = k % (2 * count)
        k = np.where(k < count, k, 2 * count - 1 - k)
    elif outside == "constant":
        return np.where((k >= 0) & (k < count), k % capacity, -1)
    return np.clip(k, 0, count - 1) % capacity
