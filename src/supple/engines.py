"""The choice of an engine: the CPU, or a GPU or CUDA device where there is one and it does work of that kind."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.certificate import Certificate
from supple.cuda_arrays import check_sent, open_card, warp_sent
from supple.domain import choice, refuse
from supple.errors import SuppleError
from supple.gpu.device import Gpu, open_gpu
from supple.streaming import CPU, Engine, Group, Layout, Sampling, Space, Tell
from supple.warping import checked_fill, checked_source, result_like, warp_array
from supple.workers import note

if TYPE_CHECKING:
    from supple.gpu.lattice import Range

# The modules of the GPU are imported once there is one to work: `import supple` is to be quick.

Array = npt.NDArray[Any]

DEVICES = ("auto", "cpu", "gpu", "cuda")


def check_device(device: str) -> None:
    """Refuse what is no device, and ``"cuda"`` where it cannot be used, before any work; SuppleError says why."""
    choice("device", device, DEVICES)
    if device == "cuda":
        open_card()


def check_no_cuda(device: str, what: str) -> None:
    """Refuse what is no device, and ``"cuda"``, which does not do some kind of work; SuppleError says what does."""
    choice("device", device, DEVICES)
    if device == "cuda":
        refuse("device", f'"cpu", "gpu" or "auto" for {what}', device)


def gpu_of(device: str, what: str = "this") -> Gpu | None:
    """The GPU that is to do some kind of work, or None for the CPU.

    ``"auto"`` takes a hardware GPU where there is one, never a software one; ``"gpu"`` takes either.

    Raises
    ------
    SuppleError
        If there is no such device, or none for ``"gpu"``, or it is ``"cuda"``, which does work of other kinds.
    """
    check_no_cuda(device, what)
    if device == "cpu":
        return None
    if device == "gpu":
        return open_gpu()
    with contextlib.suppress(SuppleError):
        return open_gpu(software=False)
    return None


def warp_on_gpu(
    gpu: Gpu,
    source: object,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: Array | None,
    must: bool,
    tell: Tell = lambda done: None,
) -> tuple[Array, Certificate] | None:
    """Sample an image or frames at the source points of every pixel, on a GPU.

    Parameters
    ----------
    gpu : Gpu
    source, space, sampling, alpha, out, tell
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
    from supple.gpu.kernel import failures, let_through, passing, trouble, unsolved
    from supple.gpu.warp import warp
    from supple.gpu_clips import pictures_of, warn

    array, straight = checked_source(source, space.whole, alpha, sampling.light)
    channels = array.shape[-1] if array.ndim > space.ndim else 1
    colours = checked_fill(sampling.fill, channels, array.dtype)
    white = float(np.iinfo(array.dtype).max) if array.dtype.kind in "iu" else 1.0
    layout = Layout((Group(space.shape, channels, alpha=straight),), array.dtype, white)
    sampling = replace(sampling, fill=tuple(colours))
    if not _does(space, layout, sampling, must):
        return None
    result = result_like(out, array)
    if space.table.size == 0:
        result[...] = array
        return result, Certificate(0.0, 0.0)
    (picture,) = pictures_of(space, layout, sampling)
    deep, target = (a if a.ndim > space.ndim else a[..., None] for a in (array, result))
    deep, target = (a[None] if space.ndim == 2 else a for a in (deep, target))

    def read(frames: Range, rows: Range) -> Array:
        return np.asarray(deep[slice(*frames), slice(*rows)])

    def write(planes: Range, rows: Range, pixels: Array) -> None:
        picture.store(pixels, target[slice(*planes), slice(*rows)])

    with let_through():
        try:
            with gpu.lock:
                every = (0, len(deep))
                worst, lost = warp(
                    gpu,
                    space.table,
                    space.axes,
                    picture,
                    space.shape,
                    len(deep),
                    every,
                    passing(read),
                    passing(write),
                    tell=passing(tell),
                )
            failed = unsolved(lost)
        except failures() as error:
            failed = trouble(gpu, error)
    if failed:
        warn(gpu.name, failed, 5)
        return None
    note(gpu.name)
    return result, Certificate(worst, 0.0)


def warp_elsewhere(
    device: str,
    source: object,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: Array | None,
    tell: Tell = lambda done: None,
) -> tuple[Array, Certificate] | None:
    """Sample an image or frames by any of DEVICES that is not the CPU; None where the CPU should do it."""
    if device == "cuda":
        return warp_sent(source, space, sampling, alpha=alpha, out=out, tell=tell)
    gpu = gpu_of(device)
    if gpu is None:
        return None
    return warp_on_gpu(gpu, source, space, sampling, alpha=alpha, out=out, must=device == "gpu", tell=tell)


def check_frames(device: str, source: Array, space: Space, sampling: Sampling) -> None:
    """Refuse frames that a device must sample and does not know, before any work; SuppleError says why."""
    if device == "cuda":
        check_sent(sampling, source.dtype)
        return
    channels = source.shape[3] if source.ndim == 4 else 1
    engine_of(device, space, Layout((Group(space.shape, channels),), source.dtype, 1.0), sampling)


def warp_frames_by(
    device: str,
    source: Array,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: Array | None,
    tell: Tell = lambda done: None,
) -> tuple[Array, Certificate]:
    """Sample an array of frames as `supple.warping.warp_array` does, by any of DEVICES."""
    done = warp_elsewhere(device, source, space, sampling, alpha=alpha, out=out, tell=tell)
    if done is not None:
        return done
    return warp_array(source, space, sampling, alpha=alpha, out=out, tell=tell)


def engine_of(device: str, space: Space, layout: Layout, sampling: Sampling) -> Engine:
    """Who makes the planes of a clip.

    Raises
    ------
    SuppleError
        If it must be the GPU, and there is none, or it does not do this.
    """
    gpu = gpu_of(device, "clips")
    if gpu is None or not _does(space, layout, sampling, device == "gpu") or space.table.size == 0:
        return CPU
    from supple.gpu_clips import OnGpu

    return OnGpu(gpu, sampling.tolerance)


def _does(space: Space, layout: Layout, sampling: Sampling, must: bool) -> bool:
    """Return whether the GPU does this; SuppleError if not, and it must."""
    from supple.gpu.field import fits
    from supple.gpu.samples import format_of, known_grid

    reason = "" if fits(space.table) else "strokes of such sizes"
    for group in layout.groups:
        if format_of(layout.dtype, group.channels) is None:
            several = "s" if group.channels > 1 else ""
            reason = reason or f"samples of {layout.dtype} in {group.channels} channel{several}"
        elif not known_grid(group.step, group.offset, layout.dtype, group.channels):
            reason = reason or "samples that lie as these do"
    if reason and must:
        refuse("device", f'"cpu" or "auto" for {reason}', "gpu")
    return not reason
