"""Warps of arrays that live on a card: at once, or handed over to be waited for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from supple.cpu.warp import Certificate
from supple.cuda.arrays import OnCard, made_like, taken
from supple.cuda.card import simulated
from supple.cuda.sample import FRAMES
from supple.cuda.warp import Frames, Lattice, Pieces, colours_of, lattice_of, make_planes, pieces_of, told_of
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
        If an argument does not fit, or the card cannot be used.
    """
    space = spaces[0]
    given = taken(source, "source")
    if batch and len(spaces) not in (1, given.shape[0] if given.ndim else 0):
        refuse("deformations", f"one, or one for each of the {given.shape[0] if given.ndim else 0} items", len(spaces))
    shape = space.shape if space.ndim == 2 else (space.count, *space.shape)
    if sampling.filter == "ewa":
        refuse("filter", '"antialias" or "auto" for arrays on a card ("ewa" is the CPU\'s reference)', "ewa")
    items = given.shape[1:] if batch else given.shape
    straight = checked_kind(items, given.dtype, shape, alpha, sampling.light)
    channels = items[-1] if len(items) > len(shape) else 1
    colours = checked_fill(sampling.fill, channels, given.dtype)
    if given.dtype.kind == "f" and given.dtype.itemsize not in (2, 4, 8):
        refuse("source", "an array of bool, integers or floats of 16, 32 or 64 bits", f"dtype {given.dtype}")
    target = _checked_out(out, given) if out is not None else _like(given)
    return Work(given, target, tuple(spaces), replace(sampling, fill=tuple(colours.tolist())), straight, batch)


def _like(given: OnCard) -> OnCard:
    return made_like(given, given.shape, given.dtype, as_it_lies=True)


def _checked_out(out: Any, source: OnCard) -> OnCard:
    from supple.cuda.arrays import is_on_card

    wanted = f"an array on the source's card, of {source.dtype} and shape {source.shape}, as the source is"
    if not is_on_card(out):
        refuse("out", wanted, out)
    target = taken(out, "out")
    if target.shape != source.shape or target.dtype != source.dtype or target.card.number != source.card.number:
        refuse("out", wanted, f"{target.dtype} of shape {target.shape} on card {target.card.number}")
    if not target.writable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if 0 in (s for s, n in zip(target.strides, target.shape, strict=True) if n > 1):
        raise SuppleError("out must have a place for each sample, found an array that is broadcast")
    if target.overlaps(source):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return target


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """What one call of the kernels is for: a stack, or pictures."""

    lattice: Lattice
    source: Frames
    out: Frames
    planes: int
    shared: int = 0


def hand_over(work: Work, stream: Any, slab: int | None = None, *, waited: bool = False) -> Pieces:
    """Hand all of it over to a stream, without waiting; what is told of it is there when that is done.

    ``slab`` is how many planes are handed over at once, so that what else the card has to do comes in between;
    ``waited`` says that this thread waits for it next, on the stream of the source's library.
    """
    card, space, sampling = work.source.card, work.spaces[0], work.sampling
    if all(s.table.size == 0 for s in work.spaces):  # what nothing moves is copied bit for bit
        sampling = replace(sampling, filter="nearest", between="nearest")
    with card.current():
        rounds = _rounds(work)
        fill = np.asarray(sampling.fill, np.float64)
        count, stack = rounds[0].source.places[FRAMES], space.ndim == 3
        colours = colours_of(card, work.source.dtype, fill, sampling, alpha=work.alpha, count=count, stack=stack)
        planes = 1 if rounds[0].shared else rounds[0].planes
        pieces = (pieces_of if waited else Pieces)(work.out, [r.lattice for r in rounds], planes)
        for k, r in enumerate(rounds):
            for _ in make_planes(
                card, stream, r.lattice, pieces, colours, space.shape, (0, r.planes), r.source, r.out,
                tolerance=sampling.tolerance, shared=r.shared, fresh=k == 0, slab=slab,
            ):  # fmt: skip
                pass
    return pieces


def _rounds(work: Work) -> list[_Round]:
    card, space = work.source.card, work.spaces[0]
    source, out = work.source.flat(), work.out.flat()
    if space.ndim == 2:
        count = work.source.shape[0] if work.batch else 1
        lattice = lattice_of(card, work.spaces)
        shared = count if work.batch and len(work.spaces) == 1 else 0
        return [_Round(lattice, _frames(work, work.source, source), _frames(work, work.out, out), count, shared)]
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


def _frames(work: Work, array: OnCard, flat: Any, item: int = 0) -> Frames:
    """An array as frames: an item of a batch of stacks, or all pictures of one."""
    space = work.spaces[0]
    strides, start = list(array.strides), array.below
    count = space.count
    if space.ndim == 3 and work.batch:
        start += item * strides.pop(0)
    elif work.batch:
        count = array.shape[0]
    elif space.ndim == 2:
        strides.insert(0, 0)
    if len(strides) == 3:
        strides.append(0)
    return Frames(flat, (count, *space.shape, work.channels, *strides, start, 0, count, 0, count))


_going: list[Warping] = []
"""What nobody may hold any more, and whose memory must not be given to others before it is done."""


class Warping:
    """A warp that goes on on a card while others work: what `start` returns.

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
        """Whether it is whole; it does not wait."""
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
                self._certificate, _ = told_of(self._pieces, self.stream)
            warn_of(self._certificate, self._work.sampling.tolerance, 3)
        return self.array

    def join(self, stream: Any = None) -> None:
        """Have a stream wait for it, and not this thread: by default, the one that the source's library works on."""
        with self._work.source.card.current():
            self._event.wait(self._work.source.stream if stream is None else stream)

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
    if stream is not None and not hasattr(stream, "synchronize"):
        refuse("stream", "a stream of numba.cuda's, or left out", stream)
    card = work.source.card
    with card.current():
        own = card.stream() if stream is None else stream
        ready, done = cuda.event(), cuda.event()
        ready.record(work.source.stream)
        ready.wait(own)
        pieces = hand_over(work, own, slab)
        done.record(own)
    note(card.name)
    warping = Warping(work, own, pieces, done)
    _going[:] = [*(other for other in _going if not other.done()), warping]
    return warping


def finish(work: Work) -> Certificate:
    """Warp on the stream that the source's library works on, and wait for it."""
    if work.source.span == 0:  # a batch of nothing
        return Certificate(0.0, 0.0)
    card = work.source.card
    with card.current():
        pieces = hand_over(work, work.source.stream, waited=True)
        certificate, _ = told_of(pieces, work.source.stream)
    note(card.name)
    return certificate
