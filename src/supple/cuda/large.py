"""Host arrays, warped on a GPU in slabs: they need not fit its memory.

A slab is a range of planes of the result; the core bounds the range of frames that it needs. Two slabs are processed
at a time: while the kernels of one run, the frames of the other are sent, and the result of the one before is copied.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator, Iterator

import numpy as np

from supple.cuda.arrays import dense
from supple.cuda.device import FAILURES, CudaDevice, Memory, Stream, open_device
from supple.cuda.warp import RUN, Checks, warp
from supple.engine.core import needed
from supple.engine.devices import note
from supple.engine.sampling import Certificate
from supple.engine.work import Array, Tell, Work, silent
from supple.errors import SuppleError, argument

Range = tuple[int, int]

SLAB = 64 << 20  # bytes of the planes of a slab, approximately
ROOM = 0.4  # the fraction of free memory that each of two slabs may take

_working = threading.RLock()  # one thread at a time measures and takes free memory


def sample(
    work: Work,
    source: Array,
    target: Array,
    tell: Tell = silent,
    *,
    room: int | None = None,
) -> Certificate:
    """Warp an image, or a stack of frames, in host memory or memory-mapped, on the first GPU; return the certificate.

    ``source`` (frames, H, W, C) and ``target`` (planes, h, w, C) are of bool, integers or floats of 16 to 64 bits, with
    any byte order and strides, and do not overlap. ``tell`` is called with ``"warp"``, the number of finished planes,
    and their total. ``room`` is the number of bytes of GPU memory for each of two slabs; by default, most of the free
    memory. SuppleError if the GPU cannot be used, fails, or has too little memory for a plane and its frames.
    """
    gpu, certificate = open_device(), Certificate(0.0, 0.0)
    with contextlib.closing(_in_slabs(gpu, work, source, target, room)) as slabs:
        while True:
            try:
                done, known = next(slabs)
            except StopIteration:
                break
            except FAILURES as error:
                reason = " ".join(str(error).split())[:120] or type(error).__name__
                without = f"{argument('device', 'cpu')} does without it"
                raise SuppleError(f"{gpu.name} failed ({reason}): {without}") from error
            certificate |= known
            tell("warp", done, len(target))  # outside of the handler: its errors are the caller's
    note(gpu.name)
    return certificate


def _in_slabs(
    gpu: CudaDevice, work: Work, source: Array, target: Array, room: int | None
) -> Generator[tuple[int, Certificate], None, None]:
    """Yield the number of finished planes, and the certificate of those since the last one, slab by slab."""
    under_way: list[tuple[int, Iterator[Certificate]]] = []

    def finish() -> tuple[int, Certificate]:
        done, slab = under_way.pop(0)
        return done, next(slab)

    with _working, gpu.current():
        most = int(ROOM * gpu.free) if room is None else room
        streams = [gpu.stream() for _ in range(2)]
        try:
            for k, (planes, frames) in enumerate(_slabs(gpu, work, source, target, most)):
                if len(under_way) == len(streams):
                    yield finish()
                slab = _slab(gpu, streams[k % 2], work, source, target, planes, frames)
                next(slab)
                under_way.append((planes[1], slab))
            while under_way:
                yield finish()
        finally:
            for stream in streams:  # kernels still write to memory that is about to be freed
                with contextlib.suppress(*FAILURES):
                    stream.synchronize()


def _slabs(gpu: CudaDevice, work: Work, source: Array, target: Array, room: int) -> Iterator[tuple[Range, Range]]:
    """Yield the planes of each slab and the frames that it needs, together at most ``room`` bytes."""
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
            raise SuppleError(
                f"{size / 1e9:.2g} GB for a plane do not fit into the memory of {gpu.name}: "
                f"{argument('device', 'cpu')} does without it"
            )


def _needed(work: Work, planes: Range) -> Range:
    """Return the range of frames that a range of planes may read."""
    space, sampling = work.space, work.sampling
    if space.ndim == 2:
        return planes
    part, *_ = needed(space, sampling, range(*planes))
    low, high = part[4], part[5]
    if low >= high:  # nothing but the fill value, or copies
        low, high = planes
    if space.grid is None:  # planes beyond all strokes are copies of their own frames
        low, high = min(low, planes[0]), max(high, planes[1])
    return max(low, 0), min(high, space.count)


def _slab(
    gpu: CudaDevice, stream: Stream, work: Work, source: Array, target: Array, planes: Range, frames: Range
) -> Iterator[Certificate]:
    """Send the frames of a slab, and launch its kernels; in the second step, copy the planes to the target."""
    given, made, dtype = source[slice(*frames)], target[slice(*planes)], source.dtype.newbyteorder("=")
    sent, back, checks = Memory(given.nbytes, stream), Memory(made.nbytes, stream), Checks(stream)
    for k, frame in enumerate(given):  # one by one: converted copies stay small
        straight = np.ascontiguousarray(frame, dtype)
        sent.upload(straight, k * frame.nbytes)
        if straight is not frame:
            stream.synchronize()  # the copy is being read
    to = (back.pointer, *dense(made.shape))
    _held = warp(gpu, work, dtype, checks, (sent.pointer, *dense(given.shape)), to, planes, held_from=frames[0])
    checks.send()
    yield Certificate(0.0, 0.0)
    for k, plane in enumerate(made):
        straight = plane.flags.c_contiguous and plane.dtype.isnative
        copy = plane if straight else np.empty(plane.shape, dtype)
        back.download(copy, k * plane.nbytes)
        stream.synchronize()
        if not straight:
            plane[...] = copy
    yield checks.certificate(work.space)
