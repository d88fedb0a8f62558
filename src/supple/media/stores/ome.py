"""The metadata of OME-Zarr images, versions 0.4 to 0.6: read, checked, and written for another grid."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from supple.errors import SuppleError
from supple.media.transforms.omezarr import Json, ome_of

Version = Literal["", "0.4", "0.5", "0.6"]
Refusal = Callable[[str, str], SuppleError]
"""It returns an error from what was found and what would do."""
Numbers = tuple[float, ...]

_VERSIONS: tuple[Version, ...] = ("0.4", "0.5", "0.6")
_KINDS = ("time", "channel", "space")
_GUESSED = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
_MEND = "mend its metadata"


class Dataset(NamedTuple):
    """A level, as the metadata describe it."""

    path: str
    scale: Numbers
    translation: Numbers


class Described(NamedTuple):
    """An image, as the metadata describe it."""

    version: Version
    name: str
    axes: list[Json]
    datasets: list[Dataset]


def described(attributes: Json, error: Refusal) -> Described:
    """Return what a group's attributes say of its image, checked; its error for what no version allows."""
    ome = ome_of(attributes)
    listed = ome.get("multiscales")
    if not isinstance(listed, list) or not listed or not isinstance(listed[0], Mapping):
        raise error("its multiscales are no list of images", _MEND)
    image: Json = listed[0]
    told = ome.get("version") or image.get("version")
    found = re.match(r"0\.[456](?!\d)", str(told)) if told else None
    if told and not found:
        raise error(f"it is of OME-Zarr {told}", f"use {', '.join(_VERSIONS[:-1])} or {_VERSIONS[-1]}")
    version = next((one for one in _VERSIONS if found and one == found[0]), "0.5" if "ome" in attributes else "0.4")
    datasets = image.get("datasets")
    if not isinstance(datasets, list) or not datasets or not all(isinstance(one, Mapping) for one in datasets):
        raise error("its image has no datasets", _MEND)
    axes = _axes(image, datasets[0], error)
    n = len(axes)
    shared = [] if version == "0.6" else image.get("coordinateTransformations") or []
    levels = []
    for one in datasets:
        path = one.get("path")
        if not isinstance(path, str) or not path.strip("/") or {"..", "."} & set(path.split("/")):
            raise error(f"its datasets have the path {path!r}", _MEND)
        steps = one.get("coordinateTransformations")
        if not steps:
            raise error(f"its level {path} has no coordinateTransformations", "add a scale")
        scale, translation = _moved(steps, ((1.0,) * n, (0.0,) * n), f"level {path}", error)
        levels.append(Dataset(path.strip("/"), *_moved(shared, (scale, translation), "image", error)))
    return Described(version, str(image.get("name") or ""), axes, levels)


def rewritten(attributes: Json, version: Version, datasets: Sequence[Dataset] | None, count: int) -> dict[str, Any]:
    """Return a group's attributes for an output like its image.

    Parameters
    ----------
    attributes : mapping
        Those of the input, which are kept otherwise.
    version : str
        That of its metadata.
    datasets : sequence of Dataset or None
        Where the levels of the output lie; None if all lie where those of the input do.
    count : int
        The number of the output's levels.
    """
    ome = dict(ome_of(attributes))
    image = dict(ome["multiscales"][0])
    if count > 1:
        # they say how the levels of the input were made, and those of the output are made otherwise
        image.pop("type", None)
        image.pop("metadata", None)
    image["datasets"] = [dict(one) for one in image["datasets"][:count]]
    if datasets is not None:
        if version != "0.6":
            image.pop("coordinateTransformations", None)  # they are part of each level's own
        for old, new in zip(image["datasets"], datasets, strict=True):
            old["coordinateTransformations"] = _steps(new, version, old["coordinateTransformations"])
    ome["multiscales"] = [image]
    return {**attributes, "ome": ome} if "ome" in attributes else ome


def _axes(image: Json, dataset: Json, error: Refusal) -> list[Json]:
    """Return the descriptions of the axes, each with a name and a type."""
    listed = image.get("axes")
    systems = image.get("coordinateSystems")
    if isinstance(systems, list) and systems:
        steps = dataset.get("coordinateTransformations") or [{}]
        out = steps[0].get("output") if isinstance(steps, list) and isinstance(steps[0], Mapping) else None
        name = out.get("name") if isinstance(out, Mapping) else out
        known = [one for one in systems if isinstance(one, Mapping)]
        fitting = [one for one in known if one.get("name") == name] or (known[:1] if name is None else [])
        if not fitting:
            raise error(f"it does not describe the coordinate system {name!r} of its levels", _MEND)
        listed = fitting[0].get("axes")
    if not isinstance(listed, list) or not listed or not all(isinstance(one, Mapping) for one in listed):
        raise error("its image does not describe its axes", "add them")
    axes: list[Json] = []
    for one in listed:
        name, kind = one.get("name"), one.get("type")
        if not isinstance(name, str) or not name:
            raise error("an axis of its image has no name", _MEND)
        kind = _GUESSED.get(name.lower(), "") if kind is None else kind
        if kind not in ("", *_KINDS):
            raise error(f"its axis {name} is of the type {kind!r}", f"use {', '.join(_KINDS[:-1])} or {_KINDS[-1]}")
        if not isinstance(one.get("unit") or "", str):
            raise error(f"its axis {name} has the unit {one['unit']!r}", "give its name, as micrometer")
        axes.append({**one, "type": kind})
    names, kinds = [one["name"] for one in axes], [one["type"] for one in axes]
    if len(set(names)) < len(names):
        raise error(f"its axes are named {', '.join(names)}", "give each a name of its own")
    space = kinds.count("space")
    before = kinds[: len(kinds) - space]
    if space not in (2, 3) or "space" in before or before not in ([], ["time"], ["channel"], [""], *_BOTH):
        told = ", ".join(f"{name} ({kind or 'no type'})" for name, kind in zip(names, kinds, strict=True))
        raise error(f"its axes are {told}", "store them in the order time, channels, and two or three axes of space")
    return axes


_BOTH = (["time", "channel"], ["time", ""])


def _moved(steps: Any, start: tuple[Numbers, Numbers], where: str, error: Refusal) -> tuple[Numbers, Numbers]:
    """Return the scale and the translation of all axes after more steps."""
    scale, translation = start
    if not isinstance(steps, list) or not all(isinstance(one, Mapping) for one in steps):
        raise error(f"the coordinateTransformations of its {where} are no list", _MEND)
    for one in steps:
        kind = one.get("type")
        if kind == "sequence":
            scale, translation = _moved(one.get("transformations"), (scale, translation), where, error)
        elif kind in ("scale", "translation"):
            values = one.get(kind)
            told = isinstance(values, list) and all(isinstance(x, int | float) and math.isfinite(x) for x in values)
            if not told or len(values) != len(scale) or (kind == "scale" and min(values) <= 0):
                what = "numbers above 0" if kind == "scale" else "finite numbers"
                raise error(
                    f"the {kind} of its {where} is {values!r:.80}", f"give {len(scale)} {what}, one for each axis"
                )
            if kind == "scale":
                scale = tuple(a * b for a, b in zip(scale, values, strict=True))
                translation = tuple(a * b for a, b in zip(translation, values, strict=True))
            else:
                translation = tuple(a + b for a, b in zip(translation, values, strict=True))
        elif kind != "identity":
            raise error(f"its {where} has a transformation of the type {kind!r}", "use scale and translation")
    return scale, translation


def _steps(dataset: Dataset, version: Version, old: list[Json]) -> list[Json]:
    """Return the transformations of a level; 0.6 has one, which names its ends as the input's does."""
    steps: list[Json] = [{"type": "scale", "scale": list(dataset.scale)}]
    if any(dataset.translation):
        steps.append({"type": "translation", "translation": list(dataset.translation)})
    if version != "0.6":
        return steps
    ends = {end: old[0][end] for end in ("input", "output", "name") if end in old[0]}
    whole = steps[0] if len(steps) == 1 else {"type": "sequence", "transformations": steps}
    return [{**whole, **ends}]
