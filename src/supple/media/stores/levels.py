"""Levels of an output like a stored image: their shapes, transformations and metadata, and downsampling."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from supple.engine.work import Array
from supple.media.stores.image import Level, StoredImage
from supple.media.transforms.ngff import ome_of

Mode = Literal["mean", "nearest"]


def planned(
    like: StoredImage,
    shape: Sequence[int] | None,
    scale: Sequence[float] | None,
    translation: Sequence[float] | None,
) -> tuple[dict[str, bytes], tuple[str, ...], list[tuple[int, ...]]]:
    """Plan an output like a stored image, on its grid or on another one.

    Return all metadata, by their keys in the store; the paths of the arrays, the finest first; and for each level but
    the finest, the factor along each axis by which it is smaller than the level before.
    """
    finest = like.levels[0]
    before = tuple(finest.array.shape)
    whole = before if shape is None else (*before[: len(before) - len(shape)], *shape)
    scales = finest.scale if scale is None else scale
    offsets = finest.translation if translation is None else translation
    steps: list[tuple[int, ...]] = []
    shapes = [whole]
    for fine, coarse in pairwise(like.levels):
        factors = tuple(_factor(fine, coarse, k) for k in range(len(like.axes)))
        # the input decides whether an incomplete group of samples at the end is dropped
        axes = zip(shapes[-1], factors, coarse.array.shape, strict=True)
        after = tuple(own if whole == before and own == n // f else -(-n // f) for n, f, own in axes)
        if after == shapes[-1]:
            break  # the grid is too small for another level
        shapes.append(after)
        steps.append(factors)
    levels = like.levels[: len(shapes)]
    files: dict[str, bytes] = {}
    if like.version:
        form = finest.array.metadata.zarr_format
        same = shapes == [level.array.shape for level in levels]
        same = same and tuple(scales) == finest.scale and tuple(offsets) == finest.translation
        files |= group_files(
            "", form, _attributes(like, None if same else _placed(like, scales, offsets, steps), len(levels))
        )
        for level in levels:
            parts = level.path.split("/")[:-1]
            for k in range(len(parts)):
                files |= group_files("/".join(parts[: k + 1]), form, {})
    for level, sizes in zip(levels, shapes, strict=True):
        files |= _array(level.array.metadata, level.path, sizes)
    return files, tuple(level.path for level in levels), steps


def _factor(fine: Level, coarse: Level, k: int) -> int:
    # The scales come first, as the sizes of short axes allow several factors. Some programs write the ratio of sizes
    # as the scale (2.002), and some the same scale for all levels: then the sizes decide.
    before, after = fine.array.shape[k], coarse.array.shape[k]
    factor = max(1, round(coarse.scale[k] / fine.scale[k]))
    return factor if after in (before // factor, -(-before // factor)) else max(1, round(before / after))


def _placed(
    like: StoredImage, scale: Sequence[float], translation: Sequence[float], steps: Sequence[Sequence[int]]
) -> list[tuple[list[float], list[float]]]:
    """Return the scales and translations of the levels on another grid, in the convention of ``like``.

    The mean of f samples lies (f - 1) / 2 samples after the first. Most programs include this in the translation of a
    level, others write the same translation for all levels: for each axis, ``like`` decides.
    """
    first, scales = like.levels[0], np.array(scale, float)
    factors = np.ones(len(like.axes))
    placed = [(scales.tolist(), list(map(float, translation)))]
    for level, step in zip(like.levels[1:], steps, strict=False):
        factors = factors * step
        offset = np.round((np.array(level.translation) - first.translation) / first.scale, 3)  # rounding errors removed
        placed.append(((scales * factors).tolist(), (np.array(translation) + offset * scales).tolist()))
    return placed


def _attributes(
    like: StoredImage, placed: Sequence[tuple[list[float], list[float]]] | None, count: int
) -> dict[str, Any]:
    """Return the input's attributes for the group, with the scales and translations of levels from ``placed``."""
    ome = dict(ome_of(like.attributes))
    image = dict(ome["multiscales"][0])
    if count > 1:
        # they describe how the input's levels were computed, not the output's
        image.pop("type", None)
        image.pop("metadata", None)
    image["datasets"] = [dict(one) for one in image["datasets"][:count]]
    if placed is not None:
        if like.version != "0.6":
            image.pop("coordinateTransformations", None)  # included in each level's
        for dataset, (scale, translation) in zip(image["datasets"], placed, strict=True):
            steps: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
            if any(translation):
                steps.append({"type": "translation", "translation": translation})
            if like.version == "0.6":  # a single one, with the input's names of coordinate systems
                old = dataset["coordinateTransformations"][0]
                one = steps[0] if len(steps) == 1 else {"type": "sequence", "transformations": steps}
                steps = [{**one, **{end: old[end] for end in ("input", "output", "name") if end in old}}]
            dataset["coordinateTransformations"] = steps
    ome["multiscales"] = [image]
    return {**like.attributes, "ome": ome} if "ome" in like.attributes else ome


def group_files(path: str, zarr_format: int, attributes: dict[str, Any]) -> dict[str, bytes]:
    """Return the metadata of a group, by their keys."""
    prefix = f"{path}/" if path else ""
    files: dict[str, dict[str, Any]]
    if zarr_format == 2:
        files = {".zgroup": {"zarr_format": 2}, ".zattrs": attributes}
    else:
        files = {"zarr.json": {"zarr_format": 3, "node_type": "group", "attributes": attributes}}
    return {prefix + name: json.dumps(content, indent=2).encode() for name, content in files.items()}


def _array(metadata: Any, path: str, shape: tuple[int, ...]) -> dict[str, bytes]:
    from zarr.core.buffer import default_buffer_prototype

    files = dataclasses.replace(metadata, shape=shape).to_buffer_dict(default_buffer_prototype())
    prefix = f"{path}/" if path else ""
    return {f"{prefix}{key}": bytes(data.to_bytes()) for key, data in files.items()}


def reduced(values: Array, factors: Sequence[int], mode: Mode) -> Array:
    """Downsample an array by integer factors, one for each axis; the dtype is kept.

    The result is the mean of each group, rounded half to even for integers; or, with "nearest" (for labels), the first
    sample of the group. Where a factor does not divide the size, the last group has fewer samples.
    """
    if mode == "nearest":
        return np.ascontiguousarray(values[tuple(slice(None, None, factor) for factor in factors)])
    sizes = [np.diff([*range(0, size, f), size]) for size, f in zip(values.shape, factors, strict=True)]
    counts: Array = np.asarray(math.prod(np.ix_(*sizes)))  # the number of samples of each group
    dtype = values.dtype
    # Strided views need no memory, and sums and counts that of a level, which is smaller.
    views = [values[tuple(map(slice, first, [None] * len(first), factors))] for first in np.ndindex(*factors)]
    parts = [tuple(map(slice, one.shape)) for one in views]  # incomplete groups at the end are not in all views
    if dtype.kind == "f" or dtype.itemsize < 8:
        total = np.zeros(counts.shape, np.float64)  # sums 32-bit integers exactly
        for part, one in zip(parts, views, strict=True):
            total[part] += one
        total /= counts
        return np.asarray((total if dtype.kind == "f" else np.rint(total)).astype(dtype))
    # sums of 64-bit integers would overflow; sums of quotients and remainders do not
    counts = counts.astype(dtype)
    whole, rest = np.zeros(counts.shape, dtype), np.zeros(counts.shape, dtype)
    for part, one in zip(parts, views, strict=True):
        quotient, remainder = np.divmod(one, counts[part])
        whole[part] += quotient
        rest[part] += remainder
    more, rest = np.divmod(rest, counts)
    whole += more
    return np.asarray(whole + ((2 * rest > counts) | ((2 * rest == counts) & (whole % 2 == 1))).astype(dtype))
