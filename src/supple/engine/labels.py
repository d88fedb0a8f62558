"""Sampling of labels: each sample gets the label with the largest share of its footprint.

The share of a label is the sample of a picture that is 1 where the label is, and 0 elsewhere. Shares are computed in
tiles, only for the labels that a tile reads, four at a time: the map is solved once for all of them. Of equal shares,
the least label wins, so that no result depends on the tiles.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
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
    """Sample labels, as `supple.engine.core.sample` does other values; frames may be of any type and strides."""
    own, (planes, *size, channels) = work.sampling, outs[0].shape
    sampling = replace(own, filter="auto", between=own.between_frames, time_filter=own.averages_frames, fill=0.0)
    certificate, flat = Certificate(), work.space.ndim == 2
    whole, n = work.space.grid or Grid(work.space.whole), work.space.ndim
    fills = np.broadcast_to(own.fill, len(outs) * channels).reshape(len(outs), channels)
    shape = (1 if flat else planes, *size)
    for first in itertools.product(*(range(0, size, step) for size, step in zip(shape, _TILE, strict=True))):
        sizes = np.minimum(np.subtract(shape, first), _TILE).tolist()
        tile = replace(work.space, grid=whole.crop(first[::-1][:n], sizes[::-1][:n]))
        read, _, known = needed(tile, sampling)
        certificate |= known
        here = x, y, z = corner or (0, 0, 0)
        if read[1] <= read[0] or read[3] <= read[2] or read[5] <= read[4]:  # the fill value alone
            read = x, x + 1, y, y + 1, z, z + 1
        depth, rows, columns = (slice(read[k] - here[k // 2], read[k + 1] - here[k // 2]) for k in (4, 2, 0))
        to = [slice(a, a + size) for a, size in zip(first, sizes, strict=True)]
        for k in range(planes if flat else 1):  # each frame is an image of its own
            if flat:
                to[0] = depth = slice(k, k + 1)
            for held, out, some in zip(frames, outs, fills.tolist(), strict=True):
                for c, value in enumerate(some):
                    fill = value if own.outside == "constant" else None
                    part = held[depth, rows, columns, c]
                    out[..., c][tuple(to)] = _shared(tile, sampling, part, (read[0], read[2], read[4]), fill)
        tell("warp", first[0] + sizes[0], planes)
    return certificate


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
