"""Warps of GPU arrays, synchronous and asynchronous."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from supple.domain import refuse
from supple.engines.base import Certificate, Space, Work, check_plain, warn_of
from supple.engines.cuda.arrays import DeviceArray, as_stream, stream_of
from supple.engines.cuda.device import simulated
from supple.engines.cuda.sample import FRAMES
from supple.engines.cuda.warp import (
    Frames,
    Lattice,
    Pieces,
    colours_of,
    lattice_of,
    make_planes,
    pieces_of,
    told_of,
)
from supple.engines.workers import note


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A warp that is checked, and not yet started.

    Parameters
    ----------
    work : Work
    source, out : DeviceArray
    """

    work: Work
    source: DeviceArray
    out: DeviceArray

    def __post_init__(self) -> None:
        for space in self.spaces:
            check_plain(space)

    @property
    def spaces(self) -> tuple[Space, ...]:
        """The deformations: one, or one for each item of a batch."""
        return self.work.items or (self.work.space,)

    @property
    def batch(self) -> bool:
        """True if the first axis counts items."""
        return self.work.items is not None


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """The work of one call of the kernels: a stack, or several images."""

    lattice: Lattice
    source: Frames
    out: Frames
    planes: int
    shared: int = 0


def hand_over(job: Job, stream: Any, slab: int | None = None, *, waited: bool = False) -> Pieces:
    """Launch all kernels on a stream, without waiting; the certificate is available when they are done.

    ``slab`` is the number of planes in one launch, so that kernels of other streams can run in between; ``waited`` is
    true if this thread waits next, on the stream of the source's library.
    """
    gpu, space, sampling = job.source.gpu, job.work.space, job.work.sampling
    with gpu.current():
        rounds = _rounds(job)
        count = rounds[0].source.places[FRAMES]
        colours = colours_of(gpu, job.source.dtype, job.work, count)
        planes = 1 if rounds[0].shared else rounds[0].planes
        pieces = (pieces_of if waited else Pieces)(job.out, [r.lattice for r in rounds], planes)
        for k, r in enumerate(rounds):
            make_planes(
                gpu, stream, r.lattice, pieces, colours, space.shape, (0, r.planes), r.source, r.out,
                tolerance=sampling.tolerance, shared=r.shared, fresh=k == 0, slab=slab,
            )  # fmt: skip
    return pieces


def _rounds(job: Job) -> list[_Round]:
    gpu, space = job.source.gpu, job.work.space
    source, out = job.source.flat(), job.out.flat()
    if space.ndim == 2:
        count = job.source.shape[0] if job.batch else 1
        shared = count if job.batch and len(job.spaces) == 1 else 0
        whole = _frames(job, job.source, source), _frames(job, job.out, out)
        return [_Round(lattice_of(gpu, job.spaces), *whole, count, shared)]
    items = job.source.shape[0] if job.batch else 1
    lattices = [lattice_of(gpu, (s,)) for s in job.spaces]
    return [
        _Round(
            lattices[k % len(lattices)],
            _frames(job, job.source, source, k),
            _frames(job, job.out, out, k),
            space.count,
        )
        for k in range(items)
    ]


def _frames(job: Job, array: DeviceArray, flat: Any, item: int | None = None) -> Frames:
    """Return an array as frames: an item of a batch, or all images of one."""
    space = job.work.space
    strides, start = list(array.strides), array.below
    count = space.count
    if job.batch and item is None:
        count = array.shape[0]
    elif job.batch:
        start += (item or 0) * strides.pop(0)
    if space.ndim == 2 and not job.batch:
        strides.insert(0, 0)
    if len(strides) == 3:
        strides.append(0)
    return Frames(flat, (count, *space.shape, job.work.layout.groups[0].channels, *strides, start, 0, count, 0, count))


_going: dict[int, tuple[Any, ...]] = {}
"""Work whose memory must not be reused before its event."""
_lock = threading.Lock()


class Warping:
    """An asynchronous warp on a GPU, returned by `start`.

    Attributes
    ----------
    array : array
        The result, of the source's library; complete when the warp is done.
    stream : numba.cuda stream
        The stream of the warp.
    """

    def __init__(self, job: Job, stream: Any, pieces: Pieces, event: Any) -> None:
        self.array = job.out.given
        self.stream = stream
        self._job, self._pieces, self._event = job, pieces, event
        self._certificate: Certificate | None = None

    def done(self) -> bool:
        """Return whether the warp is done, without waiting."""
        return bool(simulated() or self._event.query())

    def wait(self) -> Any:
        """Wait for the warp; return the result.

        Warns
        -----
        ToleranceWarning
            If the map may be less accurate than the tolerance.
        """
        if self._certificate is None:
            with self._job.source.gpu.current():
                self._event.synchronize()
                self._certificate = told_of(self._pieces, self.stream)
            with _lock:
                _going.pop(id(self._event), None)
            warn_of(self._certificate, self._job.work.sampling.tolerance, 3)
        return self.array

    def join(self, stream: Any = None) -> None:
        """Make a stream, by default the current one of the source's library, wait for the warp."""
        source = self._job.source
        with source.gpu.current():
            if stream is None:
                self._event.wait(stream_of(source.given, source.kind, source.gpu))
            else:
                self._event.wait(as_stream(stream, source.gpu))

    def __repr__(self) -> str:
        return f"<Warping of {self._job.source.shape}, {'done' if self.done() else 'going on'}>"

    @property
    def error(self) -> float:
        """Return a bound on the error of source points by the checks, in pixels; it waits."""
        self.wait()
        assert self._certificate is not None
        return self._certificate.error


def start(job: Job, *, slab: int | None, stream: Any = None) -> Warping:
    """Start a warp on a stream, by default one of its own; it begins after earlier work of the source's stream."""
    from numba import cuda

    if job.source.span == 0:
        refuse("source", "a batch of one item or more", f"shape {job.source.shape}")
    gpu = job.source.gpu
    with gpu.current():
        own = gpu.stream() if stream is None else as_stream(stream, gpu)
        ready, done = cuda.event(), cuda.event()
        ready.record(job.source.stream)
        ready.wait(own)
        _order(job, own)
        with _lock:
            for key in [key for key, (event, *_) in _going.items() if _over(event)]:
                del _going[key]
            _going[id(done)] = (done, job)
        pieces = hand_over(job, own, slab)
        done.record(own)
        with _lock:
            _going[id(done)] = (done, job, pieces)
    note(gpu.name)
    return Warping(job, own, pieces, done)


def _over(event: Any) -> bool:
    """Return whether work has ended: it is done, or its GPU has failed."""
    if simulated():
        return True
    try:
        return bool(event.query())
    except Exception:  # reported when the warp is waited for
        return True


def _order(job: Job, stream: Any) -> None:
    """Make a stream wait for the work on the stream of a result of another library."""
    from numba import cuda

    if job.out.kind != job.source.kind:
        before = cuda.event()
        before.record(job.out.stream)
        before.wait(stream)


def finish(job: Job) -> Certificate:
    """Warp on the current stream of the source's library, and wait for it."""
    if job.source.span == 0:  # an empty batch
        return Certificate(0.0, 0.0)
    gpu = job.source.gpu
    with gpu.current():
        _order(job, job.source.stream)
        pieces = hand_over(job, job.source.stream, waited=True)
        certificate = told_of(pieces, job.source.stream)
    note(gpu.name)
    return certificate
