"""Files described as the OME-Zarr images that are made of them: axes, units, levels, chunks and shards."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from supple.errors import VolumeWarning, shown
from supple.media.files import PathLike
from supple.media.stores.image import StoredImage, described
from supple.media.stores.places import Place, quiet
from supple.media.stores.samples import Samples
from supple.media.transforms.ngff import ORIENTATIONS
from supple.space.geometry import Geometry

_CHUNK = {2: 512, 3: 64}
"""The side of a chunk, of so many axes of space."""
_SHARD = 1 << 25  # bytes
_SHARDS = 16  # at least, so that there is work for all
_COARSEST = 256  # samples along each axis, at most
_MICROSCOPIC = 0.01  # millimetres
_KINDS = {"t": "time", "c": "channel"}


def like_file(path: PathLike, samples: Samples, *, ndim: int | None = None) -> StoredImage:
    """Return the image of OME-Zarr 0.5 that a file becomes; its arrays are empty. ``ndim`` is as in `open_image`.

    Axes of space are in millimetres, or in micrometres if these are small; without a unit if the file has no spacing.
    Axes along those of a patient say so; oblique ones are a VolumeWarning, as levels have a scale and a translation
    alone. Each level is half of the one before, along the axes whose samples are dense. Shards cover what the file
    decodes as a whole.
    """
    import zarr
    from zarr.storage import MemoryStore

    axes, scale, translation = _placed(path, samples)
    carried = len(axes) - sum(axis["type"] == "space" for axis in axes)
    levels = _levels(samples.shape, scale, carried)
    datasets = []
    for k, (_, factor) in enumerate(levels):
        steps = [{"type": "scale", "scale": [a * b for a, b in zip(scale, factor, strict=True)]}]
        offset = [a + b * (f - 1) / 2 for a, b, f in zip(translation, scale, factor, strict=True)]
        if any(offset):
            steps.append({"type": "translation", "translation": offset})
        datasets.append({"path": str(k), "coordinateTransformations": steps})
    attributes = {"ome": {"version": "0.5", "multiscales": [{"axes": axes, "datasets": datasets}]}}
    with quiet():
        group = zarr.create_group(MemoryStore(), attributes=attributes, zarr_format=3)
        for k, (shape, _) in enumerate(levels):
            chunks, shards = _blocks(shape, carried, samples.dtype.itemsize, samples.chunks)
            group.create_array(
                str(k), shape=shape, dtype=samples.dtype, chunks=chunks, shards=None if shards == chunks else shards,
                dimension_names=[axis["name"] for axis in axes],
            )  # fmt: skip
        return described(Place(path), group, ndim)


def _placed(path: PathLike, samples: Samples) -> tuple[list[dict[str, Any]], list[float], list[float]]:
    """Return the axes, the scale and the translation of the finest level."""
    geometry = samples.geometry or Geometry()
    placed = geometry.convention != "array"
    unit, size = None, 1.0
    if placed or geometry.spacing != (1.0, 1.0, 1.0):
        unit, size = ("micrometer", 1e-3) if max(geometry.spacing) < _MICROSCOPIC else ("millimeter", 1.0)
    straight = placed and not geometry.oblique
    if placed and not straight:
        what = (
            f"the axes of {shown(path)} are turned by {geometry.oblique:.3g} degrees against those of the patient, "
            "which an OME-Zarr image cannot say: it is written along its own axes, from 0"
        )
        warnings.warn(what, VolumeWarning, stacklevel=5)
    axes: list[dict[str, Any]] = []
    scale, translation = [], []
    for name in samples.axes:
        axis: dict[str, Any] = {"name": name, "type": _KINDS.get(name, "space")}
        step, start = 1.0, 0.0
        if name == "t" and samples.interval is not None:
            axis["unit"], step = "second", samples.interval
        elif name in "xyz" and samples.geometry is not None:
            k = "xyz".index(name)
            step = geometry.spacing[k] / size
            if unit is not None:
                axis["unit"] = unit
            if straight:
                column = geometry.direction[:, k]
                along = int(np.argmax(np.abs(column)))
                sign = -1.0 if column[along] < 0 else 1.0
                value = next(name for name, turn in ORIENTATIONS.items() if turn == (along, sign))
                axis["orientation"] = {"type": "anatomical", "value": value}
                start = geometry.origin[along] / size * sign
        axes.append(axis)
        scale.append(step)
        translation.append(start)
    return axes, scale, translation


def _levels(
    shape: tuple[int, ...], scale: Sequence[float], carried: int
) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the shape of each level, and by how much it is smaller than the finest along each axis."""
    factor = (1,) * len(shape)
    levels = [(shape, factor)]
    while max(shape[carried:]) > _COARSEST:
        steps = [a * b for a, b in zip(scale, factor, strict=True)]
        dense = 2 * min(step for step, size in zip(steps[carried:], shape[carried:], strict=True) if size > 1)
        halves = [2 if k >= carried and size > 1 and steps[k] < dense else 1 for k, size in enumerate(shape)]
        shape = tuple(-(-size // half) for size, half in zip(shape, halves, strict=True))
        factor = tuple(f * half for f, half in zip(factor, halves, strict=True))
        levels.append((shape, factor))
    return levels


def _blocks(
    shape: tuple[int, ...], carried: int, itemsize: int, decoded: Sequence[int] | None
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the shapes of a chunk and of a shard.

    A shard is as large as what the file decodes as a whole, so that nothing is decoded for many of them; thin where
    that is a page.
    """
    n = len(shape) - carried
    whole = decoded or (1,) * len(shape)
    chunk = [min(size, whole[k] if k < carried else _CHUNK[n]) for k, size in enumerate(shape)]

    def covering(k: int, wanted: int) -> int:
        return min(-(-wanted // chunk[k]), -(-shape[k] // chunk[k])) * chunk[k]

    most = max(min(_SHARD, math.prod(shape) * itemsize // _SHARDS), 1)
    shard = [covering(k, max(chunk[k], whole[k])) for k in range(len(shape))]
    while n == 3 and chunk[carried] > whole[carried] and math.prod(shard) * itemsize > 2 * _SHARD:
        chunk[carried] = shard[carried] = -(-chunk[carried] // 2)
    while growing := [k for k in range(carried, len(shape)) if shard[k] < shape[k]]:
        k = min(growing, key=lambda axis: shard[axis])
        wider = covering(k, 2 * shard[k])
        if math.prod(shard) // shard[k] * wider * itemsize > most:
            break
        shard[k] = wider
    return tuple(chunk), tuple(shard)
