"""Warps and points of arrays on an NVIDIA GPU, by kernels made from the core's headers; and asynchronous warps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

from supple.cuda.arrays import DeviceArray, as_stream, checked_out, made_like, stream_of, taken
from supple.cuda.device import Event, Stream, keep, release_passed
from supple.cuda.warp import Checks
from supple.cuda.warp import warp as warp_planes
from supple.engine.devices import note
from supple.engine.sampling import DEFAULT, Certificate, Sampling, SamplingFields, warn_of
from supple.engine.work import Deforming, Space, Work, check_count, spaces_of, work_of
from supple.space.checks import integer, refuse

__all__ = ["Warping", "sample", "start"]


class Warping:
    """An asynchronous warp on a GPU, returned by `start`.

    Attributes
    ----------
    array : array
        The result, of the source's library; complete when the warp is done.
    stream : Stream
        The stream of the warp; ``stream.handle`` is CUDA's.
    """

    def __init__(
        self, work: Work, source: DeviceArray, result: Any, stream: Stream, checks: Checks, event: Event
    ) -> None:
        self.array, self.stream = result, stream
        self._work, self._source, self._checks, self._event = work, source, checks, event
        self._certificate: Certificate | None = None

    def done(self) -> bool:
        """Return whether the warp is done, without waiting."""
        with self._source.gpu.current():
            return self._event.done()

    def wait(self) -> Any:
        """Wait for the warp; return the result.

        Warns
        -----
        ToleranceWarning
            If the map may be less accurate than the tolerance.
        """
        if self._certificate is None:
            warn_of(self._known(), self._work.sampling.tolerance)
        return self.array

    def _known(self) -> Certificate:
        """Wait for the warp; return its certificate."""
        with self._source.gpu.current():
            self._event.synchronize()
            release_passed()
        self._certificate = self._checks.certificate(self._work.space)
        return self._certificate

    def join(self, stream: Any = None) -> None:
        """Make a stream, by default the current one of the source's library, wait for the warp."""
        source = self._source
        with source.gpu.current():
            where = stream_of(source.given, source.kind) if stream is None else as_stream(stream)
            where.wait(self._event)

    def __repr__(self) -> str:
        return f"<Warping of {self._source.shape}, {'done' if self.done() else 'going on'}>"

    @property
    def error(self) -> float:
        """A bound on the error of source points from the checks, in pixels; reading it waits for the warp."""
        self.wait()
        assert self._certificate is not None
        return self._certificate.error


def start(
    source: Any,
    deformations: Deforming | Sequence[Deforming],
    *,
    sampling: Sampling = DEFAULT,
    alpha: bool | None = None,
    slab: int | None = None,
    stream: Any = None,
    out: Any = None,
    **options: Unpack[SamplingFields],
) -> Warping:
    """Start a warp on a GPU, and return at once.

    It begins after earlier work on the streams of ``source`` and ``out``, and runs in parallel with later work.

    Parameters
    ----------
    source : array on a GPU
        As in `supple.Deformation.warp`; or a batch (N, …).
    deformations : Deformation or sequence of Deformation
        One deformation; or, for a batch, a sequence of one for all items or of one for each.
    sampling : Sampling, optional
        How the arrays are sampled; further keywords replace its fields: ``filter="linear"``.
    alpha
        As in `supple.Deformation.warp`.
    slab : int, optional
        The number of planes of a stack in one launch: between slabs, kernels of other streams can run.
        By default, as many as need 96 MB beside the arrays.
    stream : stream of PyTorch, CuPy, Numba or cuda-core, optional
        The stream of the warp; by default, one of its own.
    out : array on the same GPU, optional
        The array for the result.

    Returns
    -------
    Warping
        The warp, to wait for or to poll. Until it is done, use neither the source nor the result, unless the stream
        that does waits for it (`Warping.join`).
    """
    spaces = spaces_of(deformations)
    sampling = Sampling.of(sampling, options, spaces[0].ndim)
    if slab is not None:
        slab = integer("slab", slab, "a number of planes from 1 on", 1, 1 << 30)
    work, held, result = _prepared(source, spaces, sampling, alpha, out, batch=isinstance(deformations, Sequence))
    return _started(work, held, result, slab=slab, stream=stream)


def _prepared(
    source: Any, spaces: tuple[Space, ...], sampling: Sampling, alpha: bool | None, out: Any, *, batch: bool
) -> tuple[Work, DeviceArray, DeviceArray]:
    """Return the job for an array on a GPU, or for a batch (N, ...), the array, and the array of the result."""
    held = taken(source, "source")
    if batch:
        check_count(spaces, held.shape[0] if held.ndim else 0)
    items = spaces if batch else None
    work = work_of(held.shape[batch:], held.dtype, spaces[0], sampling, alpha, items=items)
    shape, space = held.shape, work.space
    if space.grid is not None:
        shape = (*shape[:batch], *space.out, *shape[batch + len(space.whole) :])
    if out is not None:
        return work, held, checked_out(out, held, shape)
    return work, held, made_like(held, shape, held.dtype, as_it_lies=shape == held.shape)


def _started(
    work: Work, source: DeviceArray, out: DeviceArray, *, slab: int | None = None, stream: Any = None
) -> Warping:
    """Start a warp on a stream, by default a new one; it begins after earlier work on the arrays' streams."""
    if source.size == 0:
        refuse("source", "a batch of one item or more", told=f"shape {source.shape}")
    space, layout, sampling, batch = work.space, work.layout, work.sampling, work.items is not None
    coloured = source.ndim > len(space.whole) + batch
    # Images are planes of one launch; stacks of a batch are painted one by one.
    if space.ndim == 2:
        parts = [(work, source.shape[0] if batch else space.count)]
    else:
        stacks = [work.spaces[k % len(work.spaces)] for k in range(source.shape[0] if batch else 1)]
        parts = [(Work(own, layout, sampling), own.planes[0]) for own in stacks]
    with source.gpu.current():
        where = source.gpu.stream() if stream is None else as_stream(stream)
        for array in (source, out):
            if array.stream != where:
                where.wait(array.stream.record())
        checks, lattices = Checks(where), []
        for k, (part, count) in enumerate(parts):
            given, made = (array.samples(k, coloured) for array in (source, out))
            lattices.append(warp_planes(source.gpu, part, source.dtype, checks, given, made, (0, count), slab=slab))
        checks.send()
        event = keep(where, source, out, checks, lattices)
    note(source.gpu.name)
    return Warping(work, source, out.given, where, checks, event)


def sample(
    source: Any, spaces: tuple[Space, ...], sampling: Sampling, alpha: bool | None, out: Any, *, batch: bool = False
) -> tuple[Any, Certificate]:
    """Return the warped array or batch, computed on the current stream of its library, and the certificate."""
    work, held, result = _prepared(source, spaces, sampling, alpha, out, batch=batch)
    if held.size == 0:  # an empty batch
        return result.given, Certificate(0.0, 0.0)
    return result.given, _started(work, held, result, stream=held.stream)._known()
