"""What an output like a stored image consists of: its levels on another grid, and all files of metadata."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from supple.media.stores.image import Level, StoredImage
from supple.media.stores.places import Place
from supple.media.stores.pyramid import Step, step_of
from supple.media.transforms.ngff import ome_of


class Plan(NamedTuple):
    """An output."""

    files: dict[str, bytes]  # the metadata, by their keys in the store
    paths: tuple[str, ...]  # of the arrays, the finest first
    steps: tuple[tuple[Step, ...], ...]  # for each level but the finest, how each axis comes from the level before


def planned(
    place: Place,
    like: StoredImage,
    shape: Sequence[int] | None,
    scale: Sequence[float] | None,
    translation: Sequence[float] | None,
) -> Plan:
    """Return what is to be written for an image, on its grid or on another one."""
    finest = like.levels[0]
    before = tuple(finest.array.shape)
    whole = before if shape is None else (*before[: len(before) - len(shape)], *shape)
    scales = tuple(finest.scale if scale is None else scale)
    offsets = tuple(finest.translation if translation is None else translation)
    steps, shapes = _steps(place, like), [whole]
    for step in steps:
        after = tuple(axis.size(size) for axis, size in zip(step, shapes[-1], strict=True))
        if after == shapes[-1]:
            break  # the grid is so small that this level would be the one before
        shapes.append(after)
    levels, steps = like.levels[: len(shapes)], steps[: len(shapes) - 1]
    files: dict[str, bytes] = {}
    if like.version:
        form = finest.array.metadata.zarr_format
        same = whole == before and scales == finest.scale and offsets == finest.translation
        placed = None if same else _placed(like, scales, offsets, steps)
        files |= group_files("", form, _attributes(like, placed, len(shapes)))
        for level in levels:
            parts = level.path.split("/")[:-1]
            for k in range(len(parts)):
                files |= group_files("/".join(parts[: k + 1]), form, {})
    for level, sizes in zip(levels, shapes, strict=True):
        files |= _array(level, sizes)
    return Plan(files, tuple(level.path for level in levels), tuple(steps))


def _steps(place: Place, like: StoredImage) -> list[tuple[Step, ...]]:
    """Return how each axis of a level comes from the level before."""
    steps = []
    for fine, coarse in pairwise(like.levels):
        found = []
        for k, axis in enumerate(like.axes):
            before, after = fine.array.shape[k], coarse.array.shape[k]
            step = Step(1, False) if axis.kind != "space" else step_of(before, after, coarse.scale[k] / fine.scale[k])
            if step is None:
                what = f"levels like {like.address} are not made: {before} samples along {axis.name} become {after}"
                raise place.unwritable(what, "give an image whose levels are smaller by whole factors")
            found.append(step)
        steps.append(tuple(found))
    return steps


def _placed(
    like: StoredImage, scale: Sequence[float], translation: Sequence[float], steps: Sequence[Sequence[Step]]
) -> list[tuple[list[float], list[float]]]:
    """Return the scales and translations of the levels of another grid, by the convention of the image.

    The mean of f samples lies (f - 1) / 2 of them from the first. Most programs write that in the translation of a
    level, some the same translation for all of them: what ``like`` does for an axis is done.
    """
    first = like.levels[0]
    factors = np.ones(len(like.axes))
    placed = [(list(map(float, scale)), list(map(float, translation)))]
    for level, step in zip(like.levels[1:], steps, strict=False):
        factors = factors * [axis.factor for axis in step]
        offset = (np.array(level.translation) - first.translation) / first.scale
        centred = (factors - 1) / 2
        offset = np.where(np.abs(offset - centred) < 0.01 * factors, centred, offset)
        offset = np.where(np.abs(offset) < 1e-6, 0, offset)
        scales = np.array(scale)
        placed.append(((scales * factors).tolist(), (np.array(translation) + offset * scales).tolist()))
    return placed


def _attributes(
    like: StoredImage, placed: Sequence[tuple[list[float], list[float]]] | None, count: int
) -> dict[str, Any]:
    """Return the attributes of the group, as those of the input, with the levels where ``placed`` has them."""
    ome = dict(ome_of(like.attributes))
    image = dict(ome["multiscales"][0])
    if count > 1:
        # they say how the levels of the input were made, and those of the output are made otherwise
        image.pop("type", None)
        image.pop("metadata", None)
    image["datasets"] = [dict(one) for one in image["datasets"][:count]]
    if placed is not None:
        if like.version != "0.6":
            image.pop("coordinateTransformations", None)  # they are part of each level's own
        for dataset, (scale, translation) in zip(image["datasets"], placed, strict=True):
            steps: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
            if any(translation):
                steps.append({"type": "translation", "translation": translation})
            if like.version == "0.6":  # one, which names its ends as the input's does
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


def _array(level: Level, shape: tuple[int, ...]) -> dict[str, bytes]:
    """Return the metadata of an array like that of a level, of another shape."""
    from zarr.core.buffer import default_buffer_prototype

    files = dataclasses.replace(level.array.metadata, shape=shape).to_buffer_dict(default_buffer_prototype())
    prefix = f"{level.path}/" if level.path else ""
    return {f"{prefix}{key}": bytes(data.to_bytes()) for key, data in files.items()}
