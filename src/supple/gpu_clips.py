"""Planes of clips by a GPU, and by the CPU where that fails."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.certificate import Certificate
from supple.errors import DeviceWarning
from supple.gpu.clip import Clip, clip_on
from supple.gpu.device import Gpu
from supple.gpu.kernel import failures, trouble, unsolved
from supple.gpu.lattice import Range
from supple.gpu.samples import GpuGroup, Wanted, times_seen
from supple.gpu.warp import warp
from supple.streaming import CPU, SLACK, Layout, Maker, Sampling, Space, fills_of, frames_needed, step_of
from supple.workers import CPU as CPU_NAME
from supple.workers import note

Array = npt.NDArray[Any]

LEAD = 1  # planes that are begun before the first of them is read back


def pictures_of(space: Space, layout: Layout, sampling: Sampling) -> tuple[GpuGroup, ...]:
    """Return the parts of a frame, as the GPU takes them."""
    times = times_seen(sampling.outside, space.count, sampling.time_filter)
    return tuple(
        GpuGroup(
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
                times,
            ),
            group.step,
            group.offset,
        )
        for group, fill in zip(layout.groups, fills_of(layout, sampling), strict=True)
    )


def warn(name: str, failed: str, level: int) -> None:
    """Say that the CPU did what a device could not."""
    note(CPU_NAME)
    warnings.warn(f"the CPU did what {name} could not: {failed}", DeviceWarning, stacklevel=level + 1)


@dataclass(frozen=True, slots=True)
class OnGpu:
    """The engine of clips on a GPU (`supple.streaming.Engine`); what it cannot do, the CPU does."""

    gpu: Gpu
    tolerance: float
    lead: int = LEAD

    @property
    def slack(self) -> float:
        """Its lattice, and that of the CPU, are both off by as much as they may."""
        return SLACK + 2 * self.tolerance

    @contextlib.contextmanager
    def opened(self, space: Space, layout: Layout, sampling: Sampling, window: Sequence[Array]) -> Iterator[Maker]:
        """See `supple.streaming.Engine`."""
        step = step_of(layout)
        pictures = pictures_of(space, layout, sampling)
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
    pictures: tuple[GpuGroup, ...]
    stack: contextlib.ExitStack
    clip: Clip | None = None
    lost: bool = False
    warned: bool = False
    by_cpu: Maker | None = None

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
                    note(self.gpu.name)
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
            warn(self.gpu.name, failed, 3)
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
                return np.stack([held[k % len(held), slice(*rows)] for k in range(*frames)])

            def write(planes: Range, rows: Range, pixels: Array, picture: GpuGroup = picture, out: Array = out) -> None:
                picture.store(pixels[0], out[slice(*rows)])

            count, planes = (self.space.count, (z, z + 1)) if timed else (1, (0, 1))
            with self.gpu.lock:
                error, more = warp(
                    self.gpu, self.space.table, self.space.axes, picture, self.space.shape, count, planes, read, write,
                    there=(low, high + 1) if timed else (0, 1), step=self.step,
                )  # fmt: skip
            worst, lost = max(worst, error), lost + more
        return worst, unsolved(lost)
