"""The wgpu engine: frames on a GPU, by Vulkan, Metal or Direct3D 12."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.domain import refuse
from supple.engines.base import (
    SLACK,
    Array,
    Certificate,
    EngineError,
    Planes,
    Space,
    Steps,
    Work,
    frames_needed,
    times_seen,
)
from supple.engines.native import NATIVE
from supple.engines.wgpu.clip import Clip, clip_on
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.field import fits
from supple.engines.wgpu.kernel import failures, trouble, unsolved
from supple.engines.wgpu.samples import FARTHEST, GpuGroup, Wanted, format_of, known_grid
from supple.engines.wgpu.warp import warp


def groups_of(work: Work) -> tuple[GpuGroup, ...]:
    """Return the groups of samples of a frame, as shaders take them."""
    space = work.space
    timed = space.ndim == 3
    early, late = times_seen(work.sampling.outside, space.count, work.sampling.time_filter)
    return tuple(
        GpuGroup(
            group.shape,
            group.channels,
            work.layout.dtype,
            Wanted(
                sampling.filter,
                sampling.between if timed else "nothing",
                sampling.outside,
                sampling.time_filter and timed and sampling.between != "nearest",
                tuple(fill.tolist()),
                group.alpha,
                sampling.light,
                work.layout.white,
                sampling.tolerance,
                (int(max(early, -FARTHEST)), int(min(late, FARTHEST))),
            ),
            group.step,
            group.offset,
        )
        for group, sampling, fill in zip(work.layout.groups, work.samplings, work.fills, strict=True)
    )


@dataclass(frozen=True, slots=True)
class Wgpu:
    """The engine of a GPU (`supple.engines.base.Engine`). The CPU maps points, which need float64."""

    gpu: Gpu
    lead: int = 1

    @property
    def name(self) -> str:
        """The name of the GPU."""
        return self.gpu.name

    def slack(self, tolerance: float) -> float:
        """Return the sum of the errors of this lattice and of the CPU's."""
        return SLACK + 2 * tolerance

    def check(self, work: Work) -> None:
        """Raise SuppleError for strokes and samples that do not fit float32 or the words of a shader."""
        reason = "" if all(fits(space.table) for space in work.spaces) else "strokes of such sizes"
        dtype = work.layout.dtype
        for group in work.layout.groups:
            if format_of(dtype, group.channels) is None:
                several = "s" if group.channels > 1 else ""
                reason = reason or f"samples of {dtype} in {group.channels} channel{several}"
            elif not known_grid(group.step, group.offset, dtype, group.channels):
                reason = reason or "samples that lie as these do"
        if reason:
            refuse("device", f'"cpu" or "auto" for {reason}', "gpu")

    def taken(self, value: object, name: str) -> Array:
        """See `Engine.taken`."""
        return NATIVE.taken(value, name)

    def result(self, out: Array | None, held: Array, shape: tuple[int, ...] | None = None) -> Array:
        """See `Engine.result`."""
        return NATIVE.result(out, held, shape)

    def working_dtype(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """See `Engine.working_dtype`: conversion is part of the upload."""
        return dtype

    def view(self, array: Array) -> Array:
        """See `Engine.view`: it takes any array."""
        return array

    def warp(self, work: Work, frames: Sequence[Array], outs: Sequence[Array]) -> Steps:
        """See `Engine.warp`."""
        space, lost = work.space, 0
        # An image is a stack of one frame; several images with one map are several stacks.
        parts = [slice(k, k + 1) for k in range(len(outs[0]))] if space.ndim == 2 else [slice(None)]
        with self.gpu.lock, _failing(self.gpu):
            for group, source, target in zip(groups_of(work), frames, outs, strict=True):
                for k, part in enumerate(parts):
                    so_far, step, out = lost, work.layout.step, target[part]
                    run = warp(self.gpu, space, group, source[part], out, (0, len(out)), step=step)
                    with contextlib.closing(run) as made:
                        for done, worst, missed in made:
                            yield k + done, Certificate(worst, 0.0)
                            lost = so_far + missed
        if lost:
            raise EngineError(unsolved(lost), lost=False)

    @contextlib.contextmanager
    def stream(self, work: Work, window: Sequence[Array]) -> Iterator[Planes]:
        """See `Engine.stream`."""
        groups = groups_of(work)
        with contextlib.ExitStack() as stack:
            with self.gpu.lock, _failing(self.gpu):
                clip = stack.enter_context(
                    clip_on(self.gpu, work.space, work.layout.step, groups, window, self.lead + 1)
                )
            yield _Stream(self.gpu, work, window, groups, clip)

    def forward(self, space: Space, points: Any, *, matrices: bool = False) -> Any:
        """See `Engine.forward`; the native engine does it."""
        return NATIVE.forward(space, points, matrices=matrices)

    def inverse(self, space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
        """See `Engine.inverse`; the native engine does it."""
        return NATIVE.inverse(space, points)

    def inverse_map(self, space: Space, tolerance: float, like: Any = None) -> tuple[Any, Certificate]:
        """See `Engine.inverse_map`; the native engine does it."""
        return NATIVE.inverse_map(space, tolerance)


@contextlib.contextmanager
def _failing(gpu: Gpu) -> Iterator[None]:
    """Convert errors of the device to `EngineError`."""
    try:
        yield
    except failures() as error:
        raise EngineError(trouble(gpu, error)) from error


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """A maker of planes from a window (`supple.engines.base.Planes`).

    If the window is larger than a binding, ``clip`` is None and planes are made in parts.
    """

    gpu: Gpu
    work: Work
    window: Sequence[Array]
    groups: tuple[GpuGroup, ...]
    clip: Clip | None

    def begin(self, z: int, first: int, last: int) -> object:
        if self.clip is None:
            return None
        with _failing(self.gpu):
            return self.clip.begin(z, *self._frames(z, first, last))

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        with _failing(self.gpu):
            if self.clip is not None:
                error, failed = self.clip.finish(begun, outs)
            else:
                error, failed = self._in_parts(z, first, last, outs)
        if failed:
            raise EngineError(failed, lost=False)
        return Certificate(error, 0.0)

    def _frames(self, z: int, first: int, last: int) -> tuple[int, int]:
        if self.work.space.ndim == 2:
            return z, z
        return frames_needed(first, last, self.work.space.count, self.work.sampling.outside)

    def _in_parts(self, z: int, first: int, last: int, outs: Sequence[Array]) -> tuple[float, str]:
        """Make a plane in parts that fit a binding."""
        low, high = self._frames(z, first, last)
        worst, lost, space, step = 0.0, 0, self.work.space, self.work.layout.step
        for group, held, out in zip(self.groups, self.window, outs, strict=True):
            with self.gpu.lock:
                if space.ndim == 3:
                    made = warp(self.gpu, space, group, held, out[None], (z, z + 1), there=(low, high + 1), step=step)
                else:
                    slot = z % len(held)
                    made = warp(self.gpu, space, group, held[slot : slot + 1], out[None], (0, 1), step=step)
                for _, error, more in made:
                    worst, missed = max(worst, error), more
            lost += missed
        return worst, unsolved(lost)
