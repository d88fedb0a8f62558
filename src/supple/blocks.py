"""Blocks of an output: the part of the source that each reads, and their samples, equal bit for bit to the whole's."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from supple.deformation import Deformation
from supple.engines.base import Array, Certificate, Layout, Sampling, Space, Work
from supple.engines.native import NATIVE, needed
from supple.geometry import Grid

Box = tuple[tuple[int, int], ...]
"""The first index along each axis, and the one after the last, in the order of an array's axes."""
Chunks = Sequence[Sequence[int]]
"""The sizes of the blocks along each axis, in the order of an array's axes, as in Dask."""


@dataclass(frozen=True, slots=True)
class Block:
    """A block of the output.

    Parameters
    ----------
    box : tuple of (int, int)
        Its place in the output.
    part : tuple of (int, int)
        The part of the source that it reads, filter and boundary mode included.
    copied : tuple of bool
        For each plane of the block, whether it is a copy: nothing in all of the output's plane moves by more than the
        tolerance.
    identity : bool
        Whether the block is a copy of the source, since no stroke reaches it.
    """

    box: Box
    part: Box
    copied: tuple[bool, ...]
    identity: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the block."""
        return tuple(stop - start for start, stop in self.box)


def boxes_of(chunks: Chunks) -> Iterator[Box]:
    """Yield the places of blocks, the last axis first."""
    ends = [list(itertools.accumulate(sizes)) for sizes in chunks]
    places = [[(end - size, end) for end, size in zip(e, s, strict=True)] for e, s in zip(ends, chunks, strict=True)]
    yield from itertools.product(*places)


def plan_blocks(
    deformation: Deformation,
    boxes: Sequence[Box],
    sampling: Sampling,
    grid: Grid | None = None,
    each: Callable[[Callable[[Box], Any], Sequence[Box]], Sequence[Any]] | None = None,
) -> list[Block]:
    """Find the part of the source that each block of an output reads, and the blocks that are copies.

    Parameters
    ----------
    deformation : Deformation
    boxes : sequence of Box
        The places of all blocks, which together are the whole output.
    sampling : Sampling
    grid : Grid, optional
        The grid of the output; by default, that of the input.
    each : function, optional
        Computes a function of all boxes, perhaps on other machines. By default, one after the other: each uses all
        threads.

    Returns
    -------
    list of Block
        In the order of ``boxes``.
    """
    read = _Reading(deformation, sampling, grid)
    found = [read(box) for box in boxes] if each is None else each(read, boxes)
    plain = deformation.space_on(grid).composite is None
    still = np.full(grid.shape[0] if grid else deformation.shape[0], plain and deformation.ndim == 3)
    for box, (_, moved) in zip(boxes, found, strict=True):
        if deformation.ndim == 3:
            # As of whole planes (`Plan.extent`): a plane is copied if none of it moves by more than the tolerance.
            still[slice(*box[0])] &= np.array(moved) * math.sqrt(3) <= sampling.tolerance
    made = []
    for box, (part, moved) in zip(boxes, found, strict=True):
        copied = tuple(still[slice(*box[0])].tolist()) if deformation.ndim == 3 else (False,)
        identity = plain and max(moved) < 0 or all(copied)
        made.append(Block(box, box if identity else part, copied, identity))
    return made


@dataclass(frozen=True, slots=True)
class _Reading:
    """The function from a block's place to the part of the source that it reads, and how far its planes move."""

    deformation: Deformation
    sampling: Sampling
    grid: Grid | None

    def __call__(self, box: Box) -> tuple[Box, tuple[float, ...]]:
        space = _space_of(self.deformation, self.grid, box)
        (x0, x1, y0, y1, first, end), moved = needed(space, self.sampling)
        if x1 <= x0 or y1 <= y0 or end <= first:  # the fill value alone: any sample will do
            x0, x1, y0, y1, first, end = 0, 1, 0, 1, 0, 1
        part = ((first, end), (y0, y1), (x0, x1))
        return part[3 - self.deformation.ndim :], tuple(moved)


def _space_of(deformation: Deformation, grid: Grid | None, box: Box) -> Space:
    """Return the map of a block."""
    whole = deformation.grid if grid is None else grid
    first, end = np.array(box)[::-1].T
    part = whole.crop(first.tolist(), (end - first).tolist())
    return replace(deformation.space_on(part), grid=part)


def warp_block(
    part: Array,
    block: Block,
    deformation: Deformation,
    sampling: Sampling,
    grid: Grid | None = None,
    *,
    alpha: bool | None = None,
) -> tuple[Array, Certificate]:
    """Sample a block of the output from the part of the source that it reads.

    Parameters
    ----------
    part : array, shape (N, ...) or (N, ..., C)
        Items that are warped alike; of each, `Block.part`.
    block : Block
    deformation, sampling, grid
        As in `plan_blocks`.
    alpha : bool, optional
        As in `Deformation.warp`.

    Returns
    -------
    array
        Of the shape of the block, and of the type of the source.
    Certificate
    """
    n, tail = deformation.ndim, part.shape[1 + deformation.ndim :]
    result = np.empty((len(part), *block.shape, *tail), part.dtype)
    if block.identity:
        result[...] = part
        return result, Certificate(0.0, 0.0)
    space = _space_of(deformation, grid, block.box)
    layout = Layout.of_array((*space.whole, *tail), part.dtype, space.whole, alpha=alpha, light=sampling.light)
    work = Work(space, layout, sampling.filled(layout.groups[0].channels, part.dtype))
    frames, outs = _planes(part, n), _planes(result, n)
    held = [one.astype(NATIVE.working_dtype(one.dtype), copy=False) for one in frames]
    made = [NATIVE.view(out) for out in outs]
    if any(one is None for one in made):  # a type of another size than the core's
        made = [np.empty(out.shape, NATIVE.working_dtype(out.dtype)) for out in outs]
    corner = (block.part[-1][0], block.part[-2][0], block.part[0][0] if n == 3 else 0)
    certificate = NATIVE.warp_part(work, held, made, corner, block.copied)  # type: ignore[arg-type]
    for out, one in zip(outs, made, strict=True):
        if not np.may_share_memory(out, one):  # type: ignore[arg-type]
            with np.errstate(over="ignore"):
                out[...] = one
    return result, certificate


def _planes(items: Array, n: int) -> list[Array]:
    """Return each item as (planes, h, w, channels)."""
    deep = items if items.ndim > 1 + n else items[..., None]
    return [one if n == 3 else one[None] for one in deep]

