"""Warps of arrays that live on a GPU: at once, or handed over to be waited for."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from supple.certificate import Certificate
from supple.cuda.arrays import OnCard, as_stream, is_on_card, made_like, stream_of, taken
from supple.cuda.card import simulated
from supple.cuda.sample import FRAMES
from supple.cuda.warp import (
    Frames,
    Lattice,
    Pieces,
    check_known,
    colours_of,
    lattice_of,
    make_planes,
    pieces_of,
    told_of,
)
from supple.domain import refuse
from supple.errors import SuppleError
from supple.streaming import Sampling, Space
from supple.warping import checked_fill, checked_kind, warn_of
from supple.workers import note


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """A warp that is checked, and not yet handed over.

    Parameters
    ----------
    source, out : OnCard
    spaces : tuple of Space
        The deformations: one, or one for each item of a batch.
    sampling : Sampling
    alpha : bool
        Whether the last channel is opacity.
    batch : bool
        Whether the first axis counts items.
    """

    source: OnCard
    out: OnCard
    spaces: tuple[Space, ...]
    sampling: Sampling
    alpha: bool
    batch: bool

    @property
    def channels(self) -> int:
        """Of a sample."""
        axes = self.spaces[0].ndim + self.batch
        return self.source.shape[-1] if self.source.ndim > axes else 1


def checked(
    source: Any, spaces: Sequence[Space], sampling: Sampling, *, alpha: bool | None, out: Any, batch: bool
) -> Work:
    """Check what is to be warped.

    Raises
    ------
    SuppleError
        If an argument does not fit, or the GPU cannot be used.
    """
    space = spaces[0]
    given = taken(source, "source")
    if batch and len(spaces) not in (1, given.shape[0] if given.ndim else 0):
        refuse("deformations", f"one, or one for each of the {given.shape[0] if given.ndim else 0} items", len(spaces))
    shape = space.whole
    check_known(given.dtype)
    items = given.shape[1:] if batch else given.shape
    straight = checked_kind(items, given.dtype, shape, alpha, sampling.light)
    channels = items[-1] if len(items) > len(shape) else 1
    colours = checked_fill(sampling.fill, channels, given.dtype)
    target = _checked_out(out, given) if out is not None else _like(given)
    return Work(given, target, tuple(spaces), replace(sampling, fill=tuple(colours.tolist())), straight, batch)


def _like(given: OnCard) -> OnCard:
    return made_like(given, given.shape, given.dtype, as_it_lies=True)


def _checked_out(out: Any, source: OnCard) -> OnCard:
    wanted = f"an array on the source's GPU, of {source.dtype} and shape {source.shape}, as the source is"
    if not is_on_card(out):
        refuse("out", wanted, out)
    target = taken(out, "out")
    if target.shape != source.shape or target.dtype != source.dtype or target.card.number != source.card.number:
        refuse("out", wanted, f"{target.dtype} of shape {target.shape} on GPU {target.card.number}")
    if not target.writable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if 0 in (s for s, n in zip(target.strides, target.shape, strict=True) if n > 1):
        raise SuppleError("out must have a place for each sample, found an array that is broadcast")
    if target.overlaps(source):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return target


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """The work of one call of the kernels: a stack, or pictures."""

    lattice: Lattice
    source: Frames
    out: Frames
    planes: int
    shared: int = 0


def hand_over(work: Work, stream: Any, slab: int | None = None, *, waited: bool = False) -> Pieces:
    """Hand all of it over to a stream, without waiting; what is told of it is there when that is done.

    ``slab`` is how many planes are handed over at once, so that what else the GPU has to do comes in between;
    ``waited`` says that this thread waits for it next, on the stream of the source's library.
    """
    card, space, sampling = work.source.card, work.spaces[0], work.sampling
    with card.current():
        rounds = _rounds(work)
        fill = np.asarray(sampling.fill, np.float64)
        count, stack = rounds[0].source.places[FRAMES], space.ndim == 3
        colours = colours_of(card, work.source.dtype, fill, sampling, alpha=work.alpha, count=count, stack=stack)
        planes = 1 if rounds[0].shared else rounds[0].planes
        pieces = (pieces_of if waited else Pieces)(work.out, [r.lattice for r in rounds], planes)
        for k, r in enumerate(rounds):
            make_planes(
                card, stream, r.lattice, pieces, colours, space.shape, (0, r.planes), r.source, r.out,
                tolerance=sampling.tolerance, shared=r.shared, fresh=k == 0, slab=slab,
            )  # fmt: skip
    return pieces


def _rounds(work: Work) -> list[_Round]:
    card, space = work.source.card, work.spaces[0]
    source, out = work.source.flat(), work.out.flat()
    if space.ndim == 2:
        count = work.source.shape[0] if work.batch else 1
        shared = count if work.batch and len(work.spaces) == 1 else 0
        whole = _frames(work, work.source, source), _frames(work, work.out, out)
        return [_Round(lattice_of(card, work.spaces), *whole, count, shared)]
    items = work.source.shape[0] if work.batch else 1
    lattices = [lattice_of(card, (s,)) for s in work.spaces]
    return [
        _Round(
            lattices[k % len(lattices)],
            _frames(work, work.source, source, k),
            _frames(work, work.out, out, k),
            space.count,
        )
        for k in range(items)
    ]


def _frames(work: Work, array: OnCard, flat: Any, item: int | None = None) -> Frames:
    """An array as frames: an item of a batch, or all pictures of one."""
    space = work.spaces[0]
    strides, start = list(array.strides), array.below
    count = space.count
    if work.batch and item is None:
        count = array.shape[0]
    elif work.batch:
        start += (item or 0) * strides.pop(0)
    if space.ndim == 2 and not work.batch:
        strides.insert(0, 0)
    if len(strides) == 3:
        strides.append(0)
    return Frames(flat, (count, *space.shape, work.channels, *strides, start, 0, count, 0, count))


_going: dict[int, tuple[Any, ...]] = {}
"""Work whose memory must not be reused before its event."""
_lock = threading.Lock()


class Warping:
    """A warp that goes on on a GPU while others work: what `start` returns.

    Attributes
    ----------
    array : array
        The result, of the source's library; whole once the warp is done.
    stream : numba.cuda stream
        The one that it goes on on.
    """

    def __init__(self, work: Work, stream: Any, pieces: Pieces, event: Any) -> None:
        self.array = work.out.given
        self.stream = stream
        self._work, self._pieces, self._event = work, pieces, event
        self._certificate: Certificate | None = None

    def done(self) -> bool:
        """Return whether it is whole; it does not wait."""
        return bool(simulated() or self._event.query())

    def wait(self) -> Any:
        """Wait for it; return the result.

        Warns
        -----
        ToleranceWarning
            If the map may be less exact than was asked.
        """
        if self._certificate is None:
            with self._work.source.card.current():
                self._event.synchronize()
                self._certificate = told_of(self._pieces, self.stream)
            with _lock:
                _going.pop(id(self._event), None)
            warn_of(self._certificate, self._work.sampling.tolerance, 3)
        return self.array

    def join(self, stream: Any = None) -> None:
        """Have a stream wait for it, and not this thread: by default, that which the source's library works on now."""
        source = self._work.source
        with source.card.current():
            if stream is None:
                self._event.wait(stream_of(source.given, source.kind, source.card))
            else:
                self._event.wait(as_stream(stream, source.card))

    def __repr__(self) -> str:
        return f"<Warping of {self._work.source.shape}, {'done' if self.done() else 'going on'}>"

    @property
    def error(self) -> float:
        """How far a source point may be off, in pixels, as far as the checks see; it waits."""
        self.wait()
        assert self._certificate is not None
        return self._certificate.error


def start(work: Work, *, slab: int | None, stream: Any = None) -> Warping:
    """Hand a warp over to a stream, by default one of its own; it begins when what was handed over before is done."""
    from numba import cuda

    if work.source.span == 0:
        refuse("source", "a batch of one item or more", f"shape {work.source.shape}")
    card = work.source.card
    with card.current():
        own = card.stream() if stream is None else as_stream(stream, card)
        ready, done = cuda.event(), cuda.event()
        ready.record(work.source.stream)
        ready.wait(own)
        _order(work, own)
        with _lock:
            for key in [key for key, (event, *_) in _going.items() if _over(event)]:
                del _going[key]
            _going[id(done)] = (done, work)
        pieces = hand_over(work, own, slab)
        done.record(own)
        with _lock:
            _going[id(done)] = (done, work, pieces)
    note(card.name)
    return Warping(work, own, pieces, done)


def _over(event: Any) -> bool:
    """Return whether nothing is going on any more: it is done, or its GPU has failed."""
    if simulated():
        return True
    try:
        return bool(event.query())
    except Exception:  # that is told to whoever waits for it
        return True


def _order(work: Work, stream: Any) -> None:
    """Have what comes on a stream wait for what is going on on that of a result of another library."""
    from numba import cuda

    if work.out.kind != work.source.kind:
        before = cuda.event()
        before.record(work.out.stream)
        before.wait(stream)


def finish(work: Work) -> Certificate:
    """Warp on the stream that the source's library works on, and wait for it."""
    if work.source.span == 0:  # a batch of nothing
        return Certificate(0.0, 0.0)
    card = work.source.card
    with card.current():
        _order(work, work.source.stream)
        pieces = hand_over(work, work.source.stream, waited=True)
        certificate = told_of(pieces, work.source.stream)
    note(card.name)
    return certificate
