"""Which engine does the work: the CPU, or a GPU where there is one and the work is of a kind that it does."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu.warp import Certificate
from supple.domain import choice, refuse
from supple.errors import DeviceWarning, SuppleError
from supple.gpu.device import Gpu, open_gpu
from supple.gpu.field import fits
from supple.gpu.kernel import failures, trouble
from supple.gpu.warp import Wanted, format_of, may_hold, warp
from supple.streaming import Group, Layout, Sampling, Space, make_plan
from supple.warping import checked_fill, checked_source, result_like

Array = npt.NDArray[Any]

DEVICES = ("auto", "cpu", "gpu")


def gpu_of(device: str) -> Gpu | None:
    """The GPU that is to work, or None for the CPU.

    ``"auto"`` takes a graphics card where there is one, and never a program that plays one; ``"gpu"`` takes either.

    Raises
    ------
    SuppleError
        If there is no such device, or none for ``"gpu"``.
    """
    choice("device", device, DEVICES)
    if device == "cpu":
        return None
    if device == "gpu":
        return open_gpu()
    with contextlib.suppress(SuppleError):
        return open_gpu(software=False)
    return None


def warp_on_gpu(
    gpu: Gpu, source: object, space: Space, sampling: Sampling, *, alpha: bool | None, out: Array | None, must: bool
) -> tuple[Array, Certificate] | None:
    """Sample an image or frames at the source points of every pixel, on a GPU.

    Parameters
    ----------
    gpu : Gpu
    source, space, sampling, alpha, out
        As `supple.warping` takes them; of an image, ``space`` has two coordinates.
    must : bool
        Whether to refuse what the GPU does not do.

    Returns
    -------
    array and Certificate, or None
        None where the CPU should do it.

    Raises
    ------
    SuppleError
        If an argument does not fit, or the GPU must do what it does not.
    """
    shape = space.shape if space.ndim == 2 else (space.count, *space.shape)
    array, straight = checked_source(source, shape, alpha, sampling.light)
    channels = array.shape[-1] if array.ndim > space.ndim else 1
    colours = checked_fill(sampling.fill, channels, array.dtype)
    reason = "" if fits(space.table) else "strokes of such sizes"
    reason = reason or _unknown(array.dtype, channels, sampling)
    if reason:
        if must:
            refuse("device", f'"cpu" for {reason}', "gpu")
        return None
    result = result_like(out, array)
    if space.table.size == 0:
        result[...] = array
        return result, Certificate(0.0, 0.0)
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    deep = (space.count, *space.shape, channels)
    target = result if result.flags.c_contiguous and result.dtype.isnative else np.empty(array.shape, array.dtype)
    white = float(np.iinfo(array.dtype).max) if array.dtype.kind in "iu" else 1.0
    wanted = Wanted(
        sampling.filter,
        sampling.between if space.ndim == 3 else "nothing",
        sampling.outside,
        tuple(colours),
        straight,
        sampling.light,
        white,
        sampling.tolerance,
    )
    try:
        reach = _reach(gpu, space, array.dtype, channels, replace(sampling, fill=tuple(colours)))
        with gpu.lock:
            worst, lost = warp(gpu, space.table, space.axes, array.reshape(deep), target.reshape(deep), wanted, reach)
        failed = f"{lost} points could not be solved to the tolerance in its numbers" if lost else ""
    except failures() as error:
        failed = trouble(gpu, error)
    if failed:
        warnings.warn(f"the CPU did what {gpu.name} could not: {failed}", DeviceWarning, stacklevel=4)
        return None
    if target is not result:
        result[...] = target
    return result, Certificate(worst, 0.0)


def _unknown(dtype: Any, channels: int, sampling: Sampling) -> str:
    """What the GPU does not do of this, if anything."""
    if format_of(dtype.newbyteorder("="), channels) is None:
        return f"samples of {dtype} in {channels} channel{'s' if channels > 1 else ''}"
    if sampling.filter == "ewa":
        return 'filter="ewa"'
    if sampling.time_filter:
        return "time_filter"
    return ""


def _reach(
    gpu: Gpu, space: Space, dtype: Any, channels: int, sampling: Sampling
) -> Callable[[int, int], tuple[int, int]]:
    """Which frames some planes are made of: all, if they fit, and else as the lattices of the planes tell."""
    whole = (0, space.count)
    if may_hold(gpu, space.shape, dtype, channels, space.count):
        return lambda first, last: whole
    kind = np.dtype(np.float32)
    plan = make_plan(space, Layout((Group(space.shape, channels),), kind, 1.0), sampling, range(space.count))
    return lambda first, last: (int(plan.keep[first:last].min()), int(plan.read[first:last].max()) + 1)
