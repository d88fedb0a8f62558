"""Host arrays, warped on a GPU in slabs: they need not fit its memory.

A slab is a range of planes of the result, and needs a range of frames, which the core bounds. Two slabs are under way:
while the kernels of one run, the frames of the other are sent, and the result of the one before is copied back.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.base import Certificate, EngineError, Steps, Work
from supple.engines.cuda.arrays import dense
from supple.engines.cuda.device import CudaDevice, Memory, Stream, failures
from supple.engines.cuda.warp import Painter, Planes, Told, paint, painter
from supple.engines.native import needed_by

Array = npt.NDArray[Any]
Range = tuple[int, int]

SLAB = 64 << 20  # bytes of a slab's planes, about
ROOM = 0.4  # the fraction of free memory that each of two slabs may take

_working = threading.RLock()  # one thread at a time measures and takes free memory


def warp_host(gpu: CudaDevice, source: Array, target: Array, work: Work, *, room: int | None = None) -> Steps:
    """Warp an image, or a stack of frames, in host memory or mapped to it.

    Parameters
    ----------
    gpu : CudaDevice
    source, target : array, shape (frames, H, W, C) and (planes, h, w, C)
        Of bool, integers or floats of 16 to 64 bits, in any byte order, with any strides; not overlapping.
    work : Work
        The deformation and the sampling options.
    room : int, optional
        The bytes of GPU memory for each of two slabs; by default, most of the free memory.

    Yields
    ------
    int, Certificate
        The number of finished planes, and the accuracy of the map of those finished since the last step.

    Raises
    ------
    EngineError
        If a plane, and the frames that it needs, exceed the memory.
    """
    with _working, gpu.current():
        most = int(ROOM * gpu.free) if room is None else room
        turns = [_Turn(gpu, work, source, target) for _ in range(2)]
        under_way: list[_Turn] = []
        done = 0
        try:
            for k, planes in enumerate(_slabs(work, source, target, most)):
                if len(under_way) == len(turns):
                    done, known = under_way.pop(0).finish()
                    yield done, known
                turns[k % 2].begin(planes)
                under_way.append(turns[k % 2])
            for turn in under_way:
                done, known = turn.finish()
                yield done, known
        finally:
            for turn in turns:  # until then, kernels write to memory that is about to be freed
                with contextlib.suppress(*failures()):
                    turn.stream.synchronize()


@dataclass(frozen=True, slots=True)
class _Slab:
    """Planes, from and to, and the frames that they need."""

    planes: Range
    frames: Range


def _slabs(work: Work, source: Array, target: Array, room: int) -> Iterator[_Slab]:
    """Yield the slabs: each takes, with its frames, no more than ``room`` bytes."""
    plane, frame, count = target[0].nbytes, source[0].nbytes, len(target)
    together, first = max(1, min(SLAB // plane, -(-count // 8))), 0
    while first < count:
        planes = first, min(first + together, count)
        frames = _needed(work, planes)
        if (frames[1] - frames[0]) * frame + (planes[1] - planes[0]) * plane > room:
            if planes[1] - first == 1:
                size = ((frames[1] - frames[0]) * frame + plane) / 1e9
                raise EngineError(f"{size:.2g} GB for a plane do not fit into its memory", lost=False)
            together = (planes[1] - first + 1) // 2
            continue
        yield _Slab(planes, frames)
        first = planes[1]


def _needed(work: Work, planes: Range) -> Range:
    """Return the range of frames that a range of planes may read."""
    space, sampling = work.space, work.sampling
    if space.ndim == 2:
        return planes
    (x, y, z), (_, height, width) = (0, 0, 0) if space.grid is None else space.grid.first, space.planes
    part, *_ = needed_by(space, sampling, range(z + planes[0], z + planes[1]), (x, x + width, y, y + height))
    low, high = part[4], part[5]
    if low >= high:  # nothing but the fill value, or copies
        low, high = planes
    if space.grid is None:  # planes that no stroke reaches are copied
        low, high = min(low, planes[0]), max(high, planes[1])
    return max(low, 0), min(high, space.count)


class _Turn:
    """The stream of every second slab, and what it holds."""

    def __init__(self, gpu: CudaDevice, work: Work, source: Array, target: Array) -> None:
        self.stream: Stream = gpu.stream()
        self._gpu, self._work, self._source, self._target = gpu, work, source, target
        self._held: tuple[_Slab, Painter, Memory, Memory, Told] | None = None

    def begin(self, slab: _Slab) -> None:
        """Send the frames of a slab, and launch its kernels."""
        frames = self._source[slice(*slab.frames)]
        dtype = self._source.dtype.newbyteorder("=")
        sent = Memory(frames.nbytes, self.stream)
        for k, frame in enumerate(frames):  # one by one, so that a copy in the right order stays small
            sent.upload(np.ascontiguousarray(frame, dtype), k * frame.nbytes)
        made = painter(self._gpu, self._work, dtype, self.stream)
        shape = self._target[slice(*slab.planes)].shape
        back, told = Memory(int(np.prod(shape, dtype=np.int64)) * dtype.itemsize, self.stream), Told.on(self.stream)
        source = Planes(sent.pointer, _strides(frames.shape), slab.frames[0])
        out = Planes(back.pointer, _strides(shape), slab.planes[0])
        shared = shape[0] if self._work.space.ndim == 2 else 0
        paint(made, self.stream, source, out, slab.planes, told, shared=shared)
        told.send()
        self._held = slab, made, sent, back, told

    def finish(self) -> tuple[int, Certificate]:
        """Copy the result of the slab to its place, and return how many planes are done, and how accurate it is."""
        assert self._held is not None
        slab, made, sent, back, told = self._held
        target = self._target[slice(*slab.planes)]
        dtype, size = target.dtype.newbyteorder("="), target[0].nbytes
        for k, plane in enumerate(target):
            straight = plane.flags.c_contiguous and plane.dtype.isnative
            copy = plane if straight else np.empty(plane.shape, dtype)
            back.download(copy, k * size)
            self.stream.synchronize()
            if not straight:
                plane[...] = copy
        self.stream.synchronize()
        for memory in (sent, back, told.there, *([made.fill] if made.fill else [])):
            memory.close()
        self._held = None
        return slab.planes[1], told.certificate(self._work.space)


def _strides(shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    plane, row, column, channel = dense(shape)
    return plane, row, column, channel
