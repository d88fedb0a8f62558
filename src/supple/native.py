"""The native engine: the inverse map of a plane, and frames that are sampled at its source points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.certificate import Certificate
from supple.domain import choice
from supple.errors import SuppleError
from supple.strokes import numbers

Array = npt.NDArray[Any]

FILTERS = {"auto": 3, "cubic": 2, "linear": 1, "nearest": 0}
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2}
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}
SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2}
LONGEST = 64.0  # frames that a pixel is averaged over, at most

_GONE = ("antialias", "ewa")


def check_filter(filter: object) -> None:
    """Refuse what is no filter; SuppleError says which there are."""
    if filter in _GONE:
        raise SuppleError(
            f'filter="{filter}" is gone: "auto", the default, averages just what the map shrinks (docs/sampling.md)'
        )
    choice("filter", filter, tuple(FILTERS))


def plan_of(
    table: npt.NDArray[np.void],
    axes: npt.NDArray[np.float64],
    ndim: int,
    shape: tuple[int, int],
    z: float,
    tolerance: float,
) -> _core.Plan:
    """Solve for T⁻¹ on a plane.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Strokes that are known to be one-to-one.
    axes : float64 array, shape (3, 5)
        The packed domain.
    ndim : int
        2 for an image, 3 for a plane of a video or a volume.
    shape : (int, int)
        Rows and columns of the plane.
    z : float
        Which plane, in samples.
    tolerance : float
        How far a source point may be from the true T⁻¹(q), in pixels.
    """
    return _core.Plan(numbers(table), axes, ndim, *shape, z, tolerance)


def certificate_of(plan: _core.Plan) -> Certificate:
    """Return what the checks of a plan's cells say, with their reserve."""
    return Certificate(plan.error, plan.evaluations)


def measured(plan: _core.Plan, tolerance: float) -> Certificate:
    """Return the error of a plan's source points, measured at every pixel by going on with Newton's method."""
    error, unknown = plan.measure(min(1e-5, 1e-3 * tolerance))
    return Certificate(error, plan.evaluations, unknown)


def sampling_of(
    frames: Array,
    out: Array,
    count: int,
    *,
    filter: str,
    between: str,
    outside: str,
    average: bool,
    fill: Sequence[float] | npt.NDArray[np.float64],
    alpha: bool,
    light: bool,
    white: float | None,
    step: tuple[int, int] = (1, 1),
    offset: tuple[float, float] = (0.0, 0.0),
) -> _core.Sampling:
    """Return what `_core.Plan.sample` and `_core.warp_stack` do to some frames.

    Parameters
    ----------
    frames : array, shape (slots, h, w, C)
        Frames of a clip, of which frame k is in the slot k modulo their number: contiguous, in native byte order.
    out : array, shape (h, w, C) or (planes, h, w, C)
        Where the result goes: contiguous, of the frames' type.
    count : int
        How many frames the clip has.
    filter, between, outside, average, fill, light
        As `supple.streaming.Sampling` has them.
    alpha : bool
        Whether the last channel is opacity.
    white : float, optional
        The largest value, if that is not what the type holds; of floats, it is 1.
    step, offset
        As `supple.streaming.Group` has them.
    """
    if frames.dtype == np.bool_:
        frames, out, white = frames.view(np.uint8), out.view(np.uint8), 1.0
    if white is None:
        white = float(np.iinfo(frames.dtype).max) if frames.dtype.kind in "iu" else 1.0
    return _core.Sampling(
        frames,
        out,
        count,
        step,
        offset,
        FILTERS[filter],
        BETWEEN[between],
        OUTSIDE[outside],
        average,
        list(map(float, fill)),
        frames.shape[3] - 1 if alpha else -1,
        light,
        white,
    )


def times_seen(outside: str, count: int, average: bool) -> tuple[float, float]:
    """Return the times beyond which nothing changes any more, as an edge or a constant goes on."""
    beyond = 3.0 + (LONGEST / 2 if average else 0.0)
    if outside == "reflect":
        return -1e9, 1e9
    return -beyond, count - 1.0 + beyond


def slots_of(first: int, last: int, count: int, outside: str, capacity: int) -> npt.NDArray[np.int64]:
    """Return where the frames ``first`` to ``last`` are in a window whose slot k modulo its capacity holds frame k.

    Frames outside the clip are those that stand for them; -1 for a constant.
    """
    k = np.arange(first, last + 1)
    if outside == "reflect":
        k = k % (2 * count)
        k = np.where(k < count, k, 2 * count - 1 - k)
    elif outside == "constant":
        return np.where((k >= 0) & (k < count), k % capacity, -1)
    return np.clip(k, 0, count - 1) % capacity
