"""What an output like a stored image consists of: its levels on another grid, and all files of metadata."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from supple.errors import SuppleError, argument
from supple.media.stores import ome
from supple.media.stores.image import Level, StoredImage
from supple.media.stores.places import Place
from supple.media.stores.pyramid import Step, step_of


class Plan(NamedTuple):
    """An output."""

    files: dict[str, bytes]  # the metadata, by their keys in the store
    steps: tuple[tuple[Step, ...], ...]  # for each level but the finest, how each axis comes from the level before


def planned(
    place: Place,
    like: StoredImage,
    shape: Sequence[int] | None,
    scale: Sequence[float] | None,
    translation: Sequence[float] | None,
) -> Plan:
    """Return what is to be written; SuppleError for arguments that do not fit."""
    n, carried = len(like.axes), len(like.axes) - len(like.spatial)
    steps = _steps(place, like)
    finest = like.levels[0]
    whole: tuple[int, ...] = tuple(finest.array.shape)
    if shape is not None:
        sizes = _numbers("shape", shape, len(like.spatial), None, integer=True)
        whole = (*whole[:carried], *map(int, sizes))
    scales = finest.scale if scale is None else _numbers("scale", scale, n, finest.scale)
    offsets = finest.translation
    if translation is not None:
        offsets = _numbers("translation", translation, n, finest.translation, least=-math.inf)
    if not like.version and (scale is not None or translation is not None):
        raise SuppleError("a plain array has no scale or translation: leave them out")
    same = whole == tuple(finest.array.shape) and scales == finest.scale and offsets == finest.translation
    shapes = [whole]
    for step in steps:
        after = tuple(axis.size(size) for axis, size in zip(step, shapes[-1], strict=True))
        if after == shapes[-1]:
            break  # the grid is so small that this level would be the one before
        shapes.append(after)
    count = len(shapes)
    datasets = None if same else _datasets(like, scales, offsets, steps[: count - 1])
    files: dict[str, bytes] = {}
    if like.version:
        attributes = ome.rewritten(like.attributes, like.version, datasets, count)
        form = finest.array.metadata.zarr_format
        files.update(group_files("", form, attributes))
        for level in like.levels[:count]:
            parts = level.path.split("/")[:-1]
            for k in range(len(parts)):
                files.update(group_files("/".join(parts[: k + 1]), form, {}))
    for level, sizes in zip(like.levels, shapes, strict=False):
        files.update(_array(level, sizes))
    return Plan(files, tuple(steps[: count - 1]))


def _numbers(
    name: str,
    values: Sequence[float],
    n: int,
    carried: Sequence[float] | None,
    *,
    least: float = 0.0,
    integer: bool = False,
) -> tuple[float, ...]:
    """Return a number for each of ``n`` axes; those before the spatial ones may be left out."""
    try:
        found = [float(x) for x in values]
    except (TypeError, ValueError):
        found = []
    if carried is not None and 2 <= len(found) < n:
        found = [*(float(x) for x in carried[: n - len(found)]), *found]
    good = all(math.isfinite(x) and (x > least) and (not integer or x == int(x)) for x in found)
    if len(found) != n or not good:
        what = "integers above 0" if integer else "finite numbers" if least < 0 else "numbers above 0"
        raise SuppleError(f"{argument(name)} must be {n} {what}, in array order, not {values!r}")
    return tuple(found)


def _steps(place: Place, like: StoredImage) -> list[tuple[Step, ...]]:
    """Return how each axis of a level comes from the level before."""
    made = []
    for fine, coarse in pairwise(like.levels):
        steps = []
        for k, axis in enumerate(like.axes):
            before, after = fine.array.shape[k], coarse.array.shape[k]
            step = step_of(before, after, coarse.scale[k] / fine.scale[k])
            if axis.kind != "space" and like.version:
                step = Step(1, False)
            if step is None:
                what = f"levels like {like.address} are not made: {before} samples along {axis.name} become {after}"
                raise place.unwritable(what, "give an image whose levels are smaller by whole factors")
            steps.append(step)
        made.append(tuple(steps))
    return made


def _datasets(
    like: StoredImage, scale: Sequence[float], translation: Sequence[float], steps: Sequence[Sequence[Step]]
) -> list[ome.Dataset]:
    """Return where the levels of another grid lie, by the convention of the image.

    The mean of f samples lies (f - 1) / 2 of them from the first. Most programs write that in the translation of a
    level, some the same translation for all of them: what ``like`` does for an axis is done.
    """
    first = like.levels[0]
    factors = np.ones(len(like.axes))
    made = [ome.Dataset(first.path, tuple(map(float, scale)), tuple(map(float, translation)))]
    for level, step in zip(like.levels[1:], steps, strict=False):
        factors = factors * [axis.factor for axis in step]
        offset = (np.array(level.translation) - first.translation) / first.scale
        centred = (factors - 1) / 2
        offset = np.where(np.abs(offset - centred) < 0.01 * factors, centred, offset)
        offset = np.where(np.abs(offset) < 1e-6, 0, offset)
        scales = (np.array(scale) * factors).tolist()
        made.append(ome.Dataset(level.path, tuple(scales), tuple((np.array(translation) + offset * scale).tolist())))
    return made


def group_files(path: str, zarr_format: int, attributes: dict[str, Any]) -> dict[str, bytes]:
    """Return the metadata of a group, by their keys."""
    prefix = f"{path}/" if path else ""
    if zarr_format == 2:
        return {f"{prefix}.zgroup": _json({"zarr_format": 2}), f"{prefix}.zattrs": _json(attributes)}
    return {f"{prefix}zarr.json": _json({"zarr_format": 3, "node_type": "group", "attributes": attributes})}


def _json(told: Any) -> bytes:
    return json.dumps(told, indent=2).encode()


def _array(level: Level, shape: tuple[int, ...]) -> dict[str, bytes]:
    """Return the metadata of an array like that of a level, of another shape."""
    from zarr.core.buffer import default_buffer_prototype

    files = dataclasses.replace(level.array.metadata, shape=shape).to_buffer_dict(default_buffer_prototype())
    prefix = f"{level.path}/" if level.path else ""
    return {f"{prefix}{key}": bytes(data.to_bytes()) for key, data in files.items()}
