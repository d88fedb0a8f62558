"""Host arrays, warped on a GPU in slabs: they need not fit its memory.

A slab is a range of planes of the result, and needs a range of frames, which the core bounds. Two slabs are under way:
while the kernels of one run, the frames of the other are sent, and the result of the one before is copied back.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.base import Certificate, EngineError, Steps, Work
from supple.engines.cuda.arrays import dense
from supple.engines.cuda.device import FAILURES, CudaDevice, Memory, Stream
from supple.engines.cuda.warp import RUN, Told, warp
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
        streams = [gpu.stream() for _ in range(2)]
        under_way: list[Steps] = []
        try:
            for k, (planes, frames) in enumerate(_slabs(work, source, target, most)):
                if len(under_way) == len(streams):
                    yield next(under_way.pop(0))
                under_way.append(_slab(gpu, streams[k % 2], work, source, target, planes, frames))
                next(under_way[-1])
            for slab in under_way:
                yield next(slab)
        finally:
            for stream in streams:  # until then, kernels write to memory that is about to be freed
                with contextlib.suppress(*FAILURES):
                    stream.synchronize()


def _slabs(work: Work, source: Array, target: Array, room: int) -> Iterator[tuple[Range, Range]]:
    """Yield the planes of each slab and the frames that it needs: together, no more than ``room`` bytes."""
    plane, frame, count = target[0].nbytes, source[0].nbytes, len(target)
    together, first, run = max(1, min(SLAB // plane, -(-count // 8))), 0, RUN[work.space.ndim]
    if together > run:
        together -= together % run
    while first < count:
        planes = first, min(first + together, count)
        frames = _needed(work, planes)
        here = planes[1] - first
        size = (frames[1] - frames[0]) * frame + here * plane
        if size <= room:
            yield planes, frames
            first = planes[1]
        elif here > 1:
            together = (here + 1) // 2
        else:
            raise EngineError(f"{size / 1e9:.2g} GB for a plane do not fit into its memory")


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


def _slab(
    gpu: CudaDevice, stream: Stream, work: Work, source: Array, target: Array, planes: Range, frames: Range
) -> Steps:
    """Send the frames of a slab, and launch its kernels; at the second step, copy its planes to their place."""
    given, made, dtype = source[slice(*frames)], target[slice(*planes)], source.dtype.newbyteorder("=")
    sent, back, told = Memory(given.nbytes, stream), Memory(made.nbytes, stream), Told(stream)
    for k, frame in enumerate(given):  # one by one, so that a copy in the right order stays small
        sent.upload(np.ascontiguousarray(frame, dtype), k * frame.nbytes)
    to = (back.pointer, *dense(made.shape))
    _held = warp(gpu, work, dtype, told, (sent.pointer, *dense(given.shape)), to, planes, held_from=frames[0])
    told.send()
    yield planes[0], Certificate(0.0, 0.0)
    for k, plane in enumerate(made):
        straight = plane.flags.c_contiguous and plane.dtype.isnative
        copy = plane if straight else np.empty(plane.shape, dtype)
        back.download(copy, k * plane.nbytes)
        stream.synchronize()
        if not straight:
            plane[...] = copy
    yield planes[1], told.certificate(work.space)
