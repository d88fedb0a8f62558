"""Blocks of an output: the part of the source that each reads, and their samples, equal bit for bit to the whole's."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.engine import labels
from supple.engine.core import needed, sample, working_dtype
from supple.engine.sampling import Certificate, Sampling
from supple.engine.work import Array, Space, work_of
from supple.space.geometry import Grid

Box = tuple[tuple[int, int], ...]
"""The first index along each axis and the one after the last, in the order of an array's axes."""
Chunks = Sequence[Sequence[int]]
"""The sizes of the blocks along each axis, in the order of an array's axes, as in Dask."""
Read = tuple[Box, tuple[float, ...], Certificate]
"""The part of the source that a block reads, how far each of its planes moves, and the certificate of the map."""
Each = Callable[["Warp", Sequence[Sequence[Box]]], Sequence[Sequence[Read]]]
"""It returns `Warp.all_reads` of a warp and each of some lists of boxes."""

_TOGETHER = 16  # blocks of which one task finds the parts
_PACKING = threading.Lock()


@dataclass(frozen=True, slots=True)
class Block:
    """A block of an output.

    ``box`` is its place there, and ``part`` that of the source which it reads, for the filter and the boundary mode
    too. ``copied`` says of each of its planes whether nothing in the whole plane moves by more than the tolerance,
    ``identity`` whether no stroke reaches the block.
    """

    box: Box
    part: Box
    copied: tuple[bool, ...]
    identity: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the block."""
        return tuple(stop - start for start, stop in self.box)


def _here(warp: Warp, parts: Sequence[Sequence[Box]]) -> list[list[Read]]:
    return [warp.all_reads(boxes) for boxes in parts]


@dataclass(frozen=True, slots=True)
class Warp:
    """A warp of `Deformation.warp` that is computed in blocks, on a grid of the output (None: that of the input)."""

    deformation: Deformation
    sampling: Sampling
    grid: Grid | None = None
    alpha: bool | None = None
    _packed: list[Space] = field(default_factory=list, init=False, repr=False, compare=False)

    def __reduce__(self) -> tuple[type[Warp], tuple[Any, ...]]:
        """Leave out what is packed: the core's maps stay in their process."""
        return Warp, (self.deformation, self.sampling, self.grid, self.alpha)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the output, without axes that are carried along."""
        return self.deformation.shape if self.grid is None else self.grid.shape

    def reads(self, box: Box) -> Read:
        """Return the part of the source that a block reads, how far its planes move, and the map's certificate.

        The lattice of every plane of the block is solved and checked, so that the part is exact: the hull of the Bézier
        points of its patches.
        """
        (x0, x1, y0, y1, first, end), moved, certificate = needed(self.space(box), self.sampling)
        if x1 <= x0 or y1 <= y0 or end <= first:  # the fill value alone: any sample will do
            x0, x1, y0, y1, first, end = 0, 1, 0, 1, 0, 1
        part = ((first, end), (y0, y1), (x0, x1))
        return part[3 - self.deformation.ndim :], tuple(moved), certificate

    def all_reads(self, boxes: Sequence[Box]) -> list[Read]:
        """Return `reads` of each of some blocks."""
        return [self.reads(box) for box in boxes]

    def space(self, box: Box) -> Space:
        """Return the map of a block."""
        whole = self.deformation.grid if self.grid is None else self.grid
        first, end = np.array(box)[::-1].T
        return replace(self.packed(), grid=whole.crop(first.tolist(), (end - first).tolist()))

    def packed(self) -> Space:
        """Return the packed map, which all blocks share: to prepare a large cubic field takes long."""
        with _PACKING:
            if not self._packed:
                self._packed.append(
                    self.deformation.space_on(self.deformation.grid if self.grid is None else self.grid)
                )
            return self._packed[0]

    def plan(self, boxes: Sequence[Box], each: Each = _here) -> tuple[list[Block], Certificate]:
        """Return the blocks at some boxes, and the certificate of the map.

        The boxes together are the whole output, or whole layers of it. ``each`` returns `all_reads` of a warp and each
        of some lists of boxes, perhaps on other machines; by default, one block after the other: each uses all threads.
        """
        found = self._all(boxes, each)
        certificate = Certificate(0.0, 0.0)
        deep = self.deformation.ndim == 3
        plain = self.packed().composite is None
        still = np.full(self.shape[0] if deep else 1, plain)
        for box, (_, moved, known) in zip(boxes, found, strict=True):
            planes = slice(*box[0]) if deep else slice(1)
            # As of whole planes in memory: a plane of a stack is copied if none of it moves by more than the tolerance.
            # An image is a copy if no stroke reaches it.
            far = np.array(moved)
            still[planes] &= far * math.sqrt(3) <= self.sampling.tolerance if deep else far < 0
            certificate |= known
        if deep and plain and self.grid is not None and self.grid.shape[1:] != self.grid.whole[1:]:
            self._widen(still, [(box, moved) for box, (_, moved, _) in zip(boxes, found, strict=True)], each)
        blocks = []
        corner = (0,) * self.deformation.ndim if self.grid is None else self.grid.first[::-1]
        for box, (part, moved, _) in zip(boxes, found, strict=True):
            copied = tuple(still[slice(*box[0]) if deep else slice(1)].tolist())
            identity = plain and (max(moved) < 0 or all(copied))
            if identity:  # of a part of the grid, the same part of the source
                part = tuple((start + at, stop + at) for (start, stop), at in zip(box, corner, strict=True))
            blocks.append(Block(box, part, copied, identity))
        return blocks, certificate

    def _widen(self, still: npt.NDArray[np.bool_], found: Sequence[tuple[Box, tuple[float, ...]]], each: Each) -> None:
        """Keep of the planes of which a part moves hardly those of which the whole does not."""
        assert self.grid is not None
        reached = np.zeros(len(still), np.bool_)
        for box, moved in found:
            reached[slice(*box[0])] |= np.array(moved) >= 0
        doubtful = np.flatnonzero(still & reached)
        first, whole = self.grid.first[2], [(0, size) for size in self.grid.whole[1:]]
        planes: list[Box] = [((first + int(z), first + int(z) + 1), *whole) for z in doubtful]
        for z, (_, moved, _) in zip(doubtful, replace(self, grid=None)._all(planes, each), strict=True):
            still[z] = moved[0] * math.sqrt(3) <= self.sampling.tolerance

    def _all(self, boxes: Sequence[Box], each: Each) -> list[Read]:
        parts = [boxes[k : k + _TOGETHER] for k in range(0, len(boxes), _TOGETHER)]
        return list(itertools.chain.from_iterable(each(self, parts)))

    def block(self, part: Array, block: Block, carried: int = 1) -> Array:
        """Return the samples of a block from `Block.part` of the source, perhaps with channels last.

        Along the first ``carried`` axes, items are warped alike.
        """
        if block.identity:
            return part.copy()
        n = self.deformation.ndim
        lead, tail = part.shape[:carried], part.shape[carried + n :]
        part = part.reshape(-1, *part.shape[carried:])
        result = np.empty((len(part), *block.shape, *tail), part.dtype)
        space = self.space(block.box)
        work = work_of((*space.whole, *tail), part.dtype, space, self.sampling, self.alpha)
        # Items are the groups of one frame: their map is solved once.
        layout, fill = work.layout, np.tile(work.sampling.fill, len(part))
        work = replace(
            work,
            layout=replace(layout, groups=layout.groups * len(part)),
            sampling=replace(work.sampling, fill=tuple(fill.tolist())),
        )
        kind = working_dtype(part.dtype)
        frames = [planes.astype(kind, copy=False) for planes in _planes(part, n)]
        outs = [planes.view(kind) if part.dtype == np.bool_ else planes for planes in _planes(result, n)]
        buffers = [out if out.dtype == kind and out.dtype.isnative else np.empty(out.shape, kind) for out in outs]
        corner = (block.part[-1][0], block.part[-2][0], block.part[0][0] if n == 3 else 0)
        if self.sampling.filter == "labels":
            labels.sample(work, frames, buffers, corner=corner)
        else:
            sample(work, frames, buffers, corner=corner, copied=block.copied)
        for out, one in zip(outs, buffers, strict=True):
            if out is not one:
                with np.errstate(over="ignore"):
                    out[...] = one
        return result.reshape(*lead, *block.shape, *tail)


def chunks_of(task: Sequence[int], shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Return the sizes along each axis of tasks of a shape, of which the last may be smaller."""
    return [(n,) * (size // n) + ((size % n,) if size % n else ()) for n, size in zip(task, shape, strict=True)]


def boxes_of(chunks: Chunks) -> Iterator[Box]:
    """Yield the places of blocks, the last axis first."""
    ends = [list(itertools.accumulate(sizes)) for sizes in chunks]
    places = [[(end - size, end) for end, size in zip(e, s, strict=True)] for e, s in zip(ends, chunks, strict=True)]
    yield from itertools.product(*places)


def _planes(items: Array, n: int) -> list[Array]:
    """Return each item as (planes, h, w, channels)."""
    deep = items if items.ndim > 1 + n else items[..., None]
    return [one if n == 3 else one[None] for one in deep]
