"""Blocks of an output: the source part that each reads, and its samples, which equal those of the whole bit for bit."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

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
Reads = Callable[["Warp", Sequence[Box]], Sequence[Read]]
"""A function that returns what `Warp.all_reads` does, for example computed on other machines."""

_PACKING = threading.Lock()


@dataclass(frozen=True, slots=True)
class Block:
    """A block of an output.

    ``box`` is its place in the output, and ``part`` the part of the source that it reads, with the margin of the filter
    and the boundary mode. ``copied`` has one flag for each of its planes: True if no displacement in the whole plane
    exceeds the tolerance. ``identity`` says that no stroke reaches the block.
    """

    box: Box
    part: Box
    copied: tuple[bool, ...]
    identity: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the block."""
        return tuple(stop - start for start, stop in self.box)


@dataclass(frozen=True, slots=True)
class Warp:
    """A warp of `Deformation.warp` that is computed in blocks, on a grid of the output (None: that of the input)."""

    deformation: Deformation
    sampling: Sampling
    grid: Grid | None = None
    alpha: bool | None = None
    _packed: list[Space] = field(default_factory=list, init=False, repr=False, compare=False)

    def __reduce__(self) -> tuple[type[Warp], tuple[Any, ...]]:
        """Pickle without the packed map: the core's objects stay in their process."""
        return Warp, (self.deformation, self.sampling, self.grid, self.alpha)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the output, without carried axes."""
        return self._grid.shape

    @property
    def _grid(self) -> Grid:
        return self.grid or self.deformation.grid

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
        """Return `reads` of each block."""
        return [self.reads(box) for box in boxes]

    def space(self, box: Box) -> Space:
        """Return the map of a block."""
        first, end = np.array(box)[::-1].T
        return replace(self.packed(), grid=self._grid.crop(first.tolist(), (end - first).tolist()))

    def packed(self) -> Space:
        """Return the packed map, unchecked. All blocks share it, as preparing a large cubic field takes long."""
        with _PACKING:
            if not self._packed:
                self._packed.append(self.deformation.space_on(self._grid, check=False))
            return self._packed[0]

    def plan(self, boxes: Sequence[Box], reads: Reads = all_reads) -> tuple[list[Block], Certificate]:
        """Return the blocks at some boxes, and the certificate of the map.

        The boxes together are the whole output, or whole layers of it. By default, ``reads`` plans one block after the
        other: each uses all threads.
        """
        found = reads(self, boxes)
        certificate = Certificate(0.0, 0.0)
        deep = self.deformation.ndim == 3
        plain = self.packed().composite is None
        still = np.full(self.shape[0] if deep else 1, plain)
        layers = [slice(*box[0]) if deep else slice(1) for box in boxes]
        for planes, (_, moved, known) in zip(layers, found, strict=True):
            # As for whole planes in memory: a plane of a stack is copied if no displacement in it exceeds the
            # tolerance, an image if no stroke reaches it.
            far = np.array(moved)
            still[planes] &= far * math.sqrt(3) <= self.sampling.tolerance if deep else far < 0
            certificate |= known
        if deep and plain and self.grid is not None and self.grid.shape[1:] != self.grid.whole[1:]:
            # On a part of the grid, whole planes decide: where the part hardly moves, its whole plane is measured.
            reached = np.zeros(len(still), np.bool_)
            for planes, (_, moved, _) in zip(layers, found, strict=True):
                reached[planes] |= np.array(moved) >= 0
            doubtful = np.flatnonzero(still & reached)
            first, whole = self.grid.first[2], [(0, size) for size in self.grid.whole[1:]]
            seen = reads(replace(self, grid=None), [((first + z, first + z + 1), *whole) for z in doubtful.tolist()])
            still[doubtful] = [moved[0] * math.sqrt(3) <= self.sampling.tolerance for _, moved, _ in seen]
        blocks = []
        for box, planes, (part, moved, _) in zip(boxes, layers, found, strict=True):
            copied = tuple(still[planes].tolist())
            identity = plain and (max(moved) < 0 or all(copied))
            if identity:  # it reads the same place of the source
                corner = self._grid.first[::-1]
                part = tuple((start + at, stop + at) for (start, stop), at in zip(box, corner, strict=True))
            blocks.append(Block(box, part, copied, identity))
        return blocks, certificate

    def block(self, part: Array, block: Block, carried: int = 1) -> Array:
        """Return the samples of a block, computed from `Block.part` of the source, whose last axis may be channels.

        The items along the first ``carried`` axes share the map.
        """
        if block.identity:
            return part.copy()
        n = self.deformation.ndim
        lead, tail = part.shape[:carried], part.shape[carried + n :]
        part = part.reshape(-1, *part.shape[carried:])
        kind = working_dtype(part.dtype)
        result = np.empty((len(part), *block.shape, *tail), kind)
        space = self.space(block.box)
        work = work_of((*space.whole, *tail), part.dtype, space, self.sampling, self.alpha)
        # Items become groups of one frame, so that their map is solved once.
        fill = np.ravel(work.sampling.fill).tolist()
        work = replace(
            work,
            layout=replace(work.layout, groups=work.layout.groups * len(part)),
            sampling=replace(work.sampling, fill=fill * len(part) if len(fill) > 1 else fill[0]),
        )
        frames, outs = _planes(part.astype(kind, copy=False), n), _planes(result, n)
        corner = (block.part[-1][0], block.part[-2][0], block.part[0][0] if n == 3 else 0)
        if self.sampling.filter == "labels":
            labels.sample(work, frames, outs, corner=corner)
        else:
            sample(work, frames, outs, corner=corner, copied=block.copied)
        with np.errstate(over="ignore"):
            return result.astype(part.dtype, copy=False).reshape(*lead, *block.shape, *tail)


def chunks_of(task: Sequence[int], shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Return the sizes, along each axis of a shape, of tasks of a given size; the last of an axis may be smaller."""
    return [(n,) * (size // n) + ((size % n,) if size % n else ()) for n, size in zip(task, shape, strict=True)]


def boxes_of(chunks: Chunks) -> Iterator[Box]:
    """Yield the box of each block; the last axis varies fastest."""
    ends = [list(itertools.accumulate(sizes)) for sizes in chunks]
    places = [[(end - size, end) for end, size in zip(e, s, strict=True)] for e, s in zip(ends, chunks, strict=True)]
    yield from itertools.product(*places)


def _planes(items: Array, n: int) -> list[Array]:
    """Return each item as (planes, h, w, channels)."""
    deep = items if items.ndim > 1 + n else items[..., None]
    return [one if n == 3 else one[None] for one in deep]
