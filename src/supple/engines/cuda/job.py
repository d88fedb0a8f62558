"""Warps of GPU arrays, synchronous and asynchronous."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

from supple.domain import refuse
from supple.engines.base import Certificate, Work, warn_of
from supple.engines.cuda.arrays import DeviceArray, as_stream, stream_of
from supple.engines.cuda.device import Event, Stream
from supple.engines.cuda.warp import Painter, Planes, Told, paint, painter
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

    @property
    def batch(self) -> bool:
        """True if the first axis counts items."""
        return self.work.items is not None

    def launch(self, stream: Stream, slab: int | None = None) -> tuple[Told, list[Painter]]:
        """Launch all kernels on a stream, without waiting; what is returned must live until they are done."""
        work, space, gpu = self.work, self.work.space, self.source.gpu
        with gpu.current():
            told = Told.on(stream)
            held: list[Painter] = []
            if space.ndim == 2:
                made = painter(gpu, work, self.source.dtype, stream)
                count = self.source.shape[0] if self.batch else space.count
                shared = count if len(work.spaces) == 1 else 0
                planes = (self._planes(self.source, 0, work), self._planes(self.out, 0, work))
                paint(made, stream, *planes, (0, count), told, shared=shared, slab=slab)
                held.append(made)
            else:
                for k in range(self.source.shape[0] if self.batch else 1):
                    own = work.spaces[k % len(work.spaces)]
                    made = painter(gpu, Work(own, work.layout, work.sampling), self.source.dtype, stream)
                    planes = (self._planes(self.source, k, work), self._planes(self.out, k, work))
                    paint(made, stream, *planes, (0, own.planes[0]), told, slab=slab)
                    held.append(made)
            told.send()
        return told, held

    def _planes(self, array: DeviceArray, item: int, work: Work) -> Planes:
        """Return an item of a batch as planes; or all images of a batch, or of one image."""
        strides, start = list(array.strides), 0
        deep, colours = work.space.ndim == 3, array.ndim - len(work.space.whole) - self.batch
        if self.batch and deep:
            start = item * strides.pop(0)
        if not deep and not self.batch and work.space.count == 1:
            strides.insert(0, 0)
        if not colours:
            strides.append(0)
        plane, row, column, channel = strides
        return Planes(array.pointer + start * array.dtype.itemsize, (plane, row, column, channel))


_going: dict[int, tuple[Any, ...]] = {}
"""Work whose memory must not be reused before its event."""
_lock = threading.Lock()


class Warping:
    """An asynchronous warp on a GPU, returned by `start`.

    Attributes
    ----------
    array : array
        The result, of the source's library; complete when the warp is done.
    stream : Stream
        The stream of the warp; ``stream.handle`` is CUDA's.
    """

    def __init__(self, job: Job, stream: Stream, told: Told, event: Event) -> None:
        self.array = job.out.given
        self.stream = stream
        self._job, self._told, self._event = job, told, event
        self._certificate: Certificate | None = None

    def done(self) -> bool:
        """Return whether the warp is done, without waiting."""
        with self._job.source.gpu.current():
            return self._event.done()

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
            self._certificate = self._told.certificate(self._job.work.space)
            with _lock:
                _going.pop(id(self._event), None)
            warn_of(self._certificate, self._job.work.sampling.tolerance, 3)
        return self.array

    def join(self, stream: Any = None) -> None:
        """Make a stream, by default the current one of the source's library, wait for the warp."""
        source = self._job.source
        with source.gpu.current():
            where = stream_of(source.given, source.kind) if stream is None else as_stream(stream)
            where.wait(self._event)

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
    if job.source.size == 0:
        refuse("source", "a batch of one item or more", f"shape {job.source.shape}")
    gpu = job.source.gpu
    with gpu.current():
        own = gpu.stream() if stream is None else as_stream(stream)
        own.wait(job.source.stream.record())
        own.wait(job.out.stream.record())
        with _lock:
            for key in [key for key, (event, *_) in _going.items() if _over(event)]:
                del _going[key]
        held = job.launch(own, slab)
        done = own.record()
        with _lock:
            _going[id(done)] = (done, job, own, *held)
    note(gpu.name)
    return Warping(job, own, held[0], done)


def _over(event: Event) -> bool:
    """Return whether work has ended: it is done, or its GPU has failed."""
    try:
        return event.done()
    except RuntimeError:  # reported when the warp is waited for
        return True


def finish(job: Job) -> Certificate:
    """Warp on the current stream of the source's library, and wait for it."""
    if job.source.size == 0:  # an empty batch
        return Certificate(0.0, 0.0)
    gpu, stream = job.source.gpu, job.source.stream
    with gpu.current():
        if job.out.stream != stream:
            stream.wait(job.out.stream.record())
        told, _held = job.launch(stream)
        stream.synchronize()
    note(gpu.name)
    return told.certificate(job.work.space)
