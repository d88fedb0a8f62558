"""Which engine does the work: the CPU, or a GPU where there is one and the work is of a kind that it does."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu.stack import times_seen
from supple.cpu.warp import Certificate
from supple.domain import choice, refuse
from supple.errors import DeviceWarning, SuppleError
from supple.gpu.clip import Clip, clip_on
from supple.gpu.device import Gpu, open_gpu
from supple.gpu.field import fits
from supple.gpu.kernel import failures, trouble
from supple.gpu.planes import Range
from supple.gpu.samples import Picture, Wanted, format_of, known_grid
from supple.gpu.warp import warp
from supple.streaming import CPU, SLACK, Engine, Group, Layout, Maker, Sampling, Space, Tell, fills_of, frames_needed
from supple.streaming import grid_of
from supple.warping import checked_fill, checked_source, result_like, warp_frames

Array = npt.NDArray[Any]

DEVICES = ("auto", "cpu", "gpu")
LEAD = 1  # planes that are begun before the first of them is read back


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
    shape = space.shape if space.ndim == 2 else (space.count, *space.shape)
    array, straight = checked_source(source, shape, alpha, sampling.light)
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
    (picture,) = _pictures(space, layout, sampling)
    deep, target = (a if a.ndim > space.ndim else a[..., None] for a in (array, result))
    deep, target = (a[None] if space.ndim == 2 else a for a in (deep, target))

    def read(frames: Range, rows: Range) -> Array:
        return np.asarray(deep[slice(*frames), slice(*rows)])

    def write(planes: Range, rows: Range, pixels: Array) -> None:
        picture.store(pixels, target[slice(*planes), slice(*rows)])

    try:
        with gpu.lock:
            every = (0, len(deep))
            worst, lost = warp(gpu, space.table, space.axes, picture, space.shape, len(deep), every, read, write, tell=tell)
        failed = _unsolved(lost)
    except failures() as error:
        failed = trouble(gpu, error)
    if failed:
        _warn(gpu, failed, 5)
        return None
    return result, Certificate(worst, 0.0)


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
    """Sample an array of frames as `supple.warping.warp_frames` does, by any of DEVICES."""
    gpu = gpu_of(device)
    if gpu is not None:
        done = warp_on_gpu(gpu, source, space, sampling, alpha=alpha, out=out, must=device == "gpu", tell=tell)
        if done is not None:
            return done
    return warp_frames(source, space, sampling, alpha=alpha, out=out, tell=tell)


def engine_of(device: str, space: Space, layout: Layout, sampling: Sampling) -> Engine:
    """Who makes the planes of a clip.

    Raises
    ------
    SuppleError
        If it must be the GPU, and there is none, or it does not do this.
    """
    gpu = gpu_of(device)
    if gpu is None or not _does(space, layout, sampling, device == "gpu") or space.table.size == 0:
        return CPU
    return _OnGpu(gpu, LEAD, SLACK + 2 * sampling.tolerance)


def _does(space: Space, layout: Layout, sampling: Sampling, must: bool) -> bool:
    """Whether the GPU does this; SuppleError if not, and it must."""
    reason = "" if fits(space.table) else "strokes of such sizes"
    for group in layout.groups:
        if format_of(layout.dtype, group.channels) is None:
            several = "s" if group.channels > 1 else ""
            reason = reason or f"samples of {layout.dtype} in {group.channels} channel{several}"
        elif not known_grid(group.step, group.offset, layout.dtype, group.channels):
            reason = reason or "samples that lie as these do"
    if sampling.filter == "ewa":
        reason = reason or 'filter="ewa"'
    if reason and must:
        refuse("device", f'"cpu" for {reason}', "gpu")
    return not reason


def _pictures(space: Space, layout: Layout, sampling: Sampling) -> tuple[Picture, ...]:
    """What a frame is made of, as the GPU takes it."""
    earliest, latest = times_seen(sampling.outside, space.count, sampling.time_filter)
    return tuple(
        Picture(
            group.shape,
            group.channels,
            layout.dtype,
            Wanted(
                sampling.filter,
                sampling.between if space.ndim == 3 else "nothing",
                sampling.outside,
                sampling.time_filter and space.ndim == 3 and sampling.between != "nearest",
                tuple(fill.tolist()),
                group.alpha,
                sampling.light,
                layout.white,
                sampling.tolerance,
                (int(earliest), int(latest)),
            ),
            group.step,
            group.offset,
        )
        for group, fill in zip(layout.groups, fills_of(layout, sampling), strict=True)
    )


def _unsolved(lost: int) -> str:
    return f"{lost} points could not be solved to the tolerance in its numbers" if lost else ""


def _warn(gpu: Gpu, failed: str, level: int) -> None:
    warnings.warn(f"the CPU did what {gpu.name} could not: {failed}", DeviceWarning, stacklevel=level)


@dataclass(frozen=True, slots=True)
class _OnGpu:
    """The engine of clips on a GPU; what it cannot do, the CPU does."""

    gpu: Gpu
    lead: int
    slack: float

    @contextlib.contextmanager
    def opened(self, space: Space, layout: Layout, sampling: Sampling, window: Sequence[Array]) -> Iterator[Maker]:
        """See `supple.streaming.Engine`."""
        grid = grid_of(layout)
        step = grid.step if grid else (1, 1)
        pictures = _pictures(space, layout, sampling)
        with contextlib.ExitStack() as stack:
            sure = _Sure(self.gpu, space, layout, sampling, window, step, pictures, stack)
            try:
                with self.gpu.lock:
                    sure.clip = stack.enter_context(
                        clip_on(
                            self.gpu,
                            space.table,
                            space.axes,
                            space.shape,
                            step,
                            pictures,
                            window,
                            space.count,
                            space.ndim == 3,
                            self.lead + 1,
                        )
                    )
            except failures() as error:
                sure.fail(trouble(self.gpu, error), for_good=True)
            yield sure


@dataclass(slots=True, eq=False)
class _Sure:
    """Planes by the GPU or, where that fails, by the CPU; `supple.streaming.Maker`.

    Where a window is larger than a shader takes, ``clip`` is None, and planes are made in parts.
    """

    gpu: Gpu
    space: Space
    layout: Layout
    sampling: Sampling
    window: Sequence[Array]
    step: tuple[int, int]
    pictures: tuple[Picture, ...]
    stack: contextlib.ExitStack
    clip: Clip | None = None
    lost: bool = False
    warned: bool = False
    by_cpu: Maker | None = field(default=None)

    def begin(self, z: int, first: int, last: int) -> object:
        if self.lost or self.clip is None:
            return None
        low, high = self._frames(z, first, last)
        try:
            return self.clip.begin(z, low, high)
        except failures() as error:
            self.fail(trouble(self.gpu, error), for_good=True)
            return None

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        if not self.lost and (begun is not None or self.clip is None):
            try:
                if begun is not None:
                    assert self.clip is not None
                    error, failed = self.clip.finish(begun, outs)
                else:
                    error, failed = self._in_parts(z, first, last, outs)
                if not failed:
                    return Certificate(error, 0.0)
                self.fail(failed, for_good=False)
            except failures() as trouble_:
                self.fail(trouble(self.gpu, trouble_), for_good=True)
        if self.by_cpu is None:
            self.by_cpu = self.stack.enter_context(CPU.opened(self.space, self.layout, self.sampling, self.window))
        return self.by_cpu.finish(None, z, first, last, outs)

    def fail(self, failed: str, *, for_good: bool) -> None:
        """Say so, once."""
        self.lost = self.lost or for_good
        if not self.warned:
            _warn(self.gpu, failed, 3)
        self.warned = True

    def _frames(self, z: int, first: int, last: int) -> Range:
        if self.space.ndim == 2:
            return z, z
        return frames_needed(first, last, self.space.count, self.sampling.outside)

    def _in_parts(self, z: int, first: int, last: int, outs: Sequence[Array]) -> tuple[float, str]:
        """Make a plane from as much at once as a shader takes."""
        low, high = self._frames(z, first, last)
        worst, lost = 0.0, 0
        timed = self.space.ndim == 3
        for picture, held, out in zip(self.pictures, self.window, outs, strict=True):

            def read(frames: Range, rows: Range, held: Array = held) -> Array:
                if not timed:
                    return held[z % len(held), slice(*rows)][None]
                if frames[0] < low or frames[1] > high + 1:
                    raise ArithmeticError("a point lies far outside what was foreseen")
                return np.stack([held[k % len(held), slice(*rows)] for k in range(*frames)])

            def write(planes: Range, rows: Range, pixels: Array, picture: Picture = picture, out: Array = out) -> None:
                picture.store(pixels[0], out[slice(*rows)])

            count, planes = (self.space.count, (z, z + 1)) if timed else (1, (0, 1))
            with self.gpu.lock:
                error, more = warp(
                    self.gpu, self.space.table, self.space.axes, picture, self.space.shape, count, planes, read, write,
                    step=self.step,
                )  # fmt: skip
            worst, lost = max(worst, error), lost + more
        return worst, _unsolved(lost)
