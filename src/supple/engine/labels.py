"""Labels, which do not mix: each sample has that of the largest share of its footprint.

The share of a label is the sample of a picture that is 1 where it is, and 0 elsewhere. Shares are computed in tiles, of
the labels alone that a tile reads, four at a time: the map is solved once for all of them. Of equal shares, the least
label wins, so that no result depends on tiles.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from supple.engine.core import needed
from supple.engine.core import sample as sample_all
from supple.engine.sampling import Certificate, Sampling
from supple.engine.work import Array, Group, Layout, Space, Tell, Work, silent
from supple.space.geometry import Grid

_TILE = (32, 64, 64)
_CHANNELS, _TOGETHER = 4, 8  # labels in one image, and images that are sampled at once


def sample(
    work: Work,
    frames: Sequence[Array],
    outs: Sequence[Array],
    tell: Tell = silent,
    *,
    corner: tuple[int, int, int] | None = None,
) -> Certificate:
    """Sample labels, as `supple.engine.core.sample` samples all else; frames may be of any type and order."""
    own = work.sampling
    sampling = replace(own, filter="auto", between=own.between_frames, time_filter=own.averages_frames, fill=0.0)
    certificate, planes, flat = Certificate(0.0, 0.0), len(outs[0]), work.space.ndim == 2
    whole = work.space.grid or Grid(work.space.whole)
    fills = np.broadcast_to(own.fill, sum(out.shape[3] for out in outs)).tolist()
    for box in _boxes((1 if flat else planes, *outs[0].shape[1:3])):
        first, sizes = [a for a, _ in box[::-1]], [b - a for a, b in box[::-1]]
        tile = replace(work.space, grid=whole.crop(first[: work.space.ndim], sizes[: work.space.ndim]))
        read, _, known = needed(tile, sampling)
        certificate |= known
        x, y, z = corner or (0, 0, 0)
        if read[1] <= read[0] or read[3] <= read[2] or read[5] <= read[4]:  # the fill value alone
            read = x, x + 1, y, y + 1, z, z + 1
        place = slice(*box[1]), slice(*box[2])
        rows, columns = slice(read[2] - y, read[3] - y), slice(read[0] - x, read[1] - x)
        for k in range(planes if flat else 1):  # each frame is an image of its own
            depth = slice(k, k + 1) if flat else slice(read[4] - z, read[5] - z)
            to, channel, start = slice(k, k + 1) if flat else slice(*box[0]), 0, (read[0], read[2], read[4])
            for held, out in zip(frames, outs, strict=True):
                for c in range(out.shape[3]):
                    part = held[depth, rows, columns, c]
                    fill = fills[channel] if own.outside == "constant" else None
                    out[(to, *place, c)] = _shared(tile, sampling, part, start, fill)
                    channel += 1
        tell("warp", box[0][1], planes)
    return certificate


def _boxes(shape: Sequence[int]) -> Iterator[tuple[tuple[int, int], ...]]:
    """Yield the tiles of an output."""
    ranges = [[(k, min(k + step, n)) for k in range(0, n, step)] for n, step in zip(shape, _TILE, strict=True)]
    yield from itertools.product(*ranges)


def _shared(space: Space, sampling: Sampling, part: Array, corner: tuple[int, int, int], fill: float | None) -> Array:
    """Return the labels of a tile (planes, h, w), from the part (frames, h, w) of the source that it reads."""
    shape = space.planes
    labels = np.unique(part)
    if fill is not None:
        labels = np.union1d(labels, np.array([fill], part.dtype))
    if len(labels) == 1:
        return np.broadcast_to(labels, shape)
    best, made = np.full(shape, -np.inf, np.float32), np.zeros(shape, np.intp)
    step = _CHANNELS * _TOGETHER
    for start in range(0, len(labels), step):
        some = [labels[k : k + _CHANNELS] for k in range(start, min(start + step, len(labels)), _CHANNELS)]
        masks = [np.zeros((*part.shape, _CHANNELS), np.float32) for _ in some]
        shares = [np.empty((*shape, _CHANNELS), np.float32) for _ in some]
        for mask, each in zip(masks, some, strict=True):
            mask[..., : len(each)] = part[..., None] == each
        layout = Layout((Group(space.shape, _CHANNELS),) * len(some), np.dtype(np.float32), 1.0)
        beyond = np.zeros((len(some), _CHANNELS))
        beyond.reshape(-1)[: min(step, len(labels) - start)] = labels[start : start + step] == fill
        how = replace(sampling, fill=tuple(beyond.ravel().tolist()))
        sample_all(Work(space, layout, how), masks, shares, corner=corner, copied=[False] * shape[0])
        for k, share in enumerate(shares):
            largest = share.max(axis=-1)
            np.copyto(made, start + _CHANNELS * k + share.argmax(axis=-1), where=largest > best)
            np.maximum(best, largest, out=best)
    return np.asarray(labels[made])
