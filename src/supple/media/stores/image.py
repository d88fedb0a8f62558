"""Images in Zarr stores: their axes, levels and grid; no samples are read.

OME-Zarr metadata are parsed here and not by a library: `ome-zarr-models` 1.7 does not support Python 3.14, has no
public models of version 0.6, refuses axes without a type, which many files have, and accepts scales of -1 and infinity.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from supple.errors import VolumeWarning, listing, said, warn
from supple.media.files import PathLike
from supple.media.stores.places import Place, quiet
from supple.media.transforms.ngff import Json, Refusal, ome_of, parsing, space_matrix
from supple.space.geometry import Grid

LABELS = "labels"
"""The group of an image's label images."""
_PIXELS = ("", "pixel", "pixels", "voxel", "voxels")  # used by programs, but not in the specification

_GUESSED = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
_CARRIED = re.compile("(time )?(channel |other )?(space ){2,3}")  # supported kinds of axes, in order
_MEND = "mend its metadata"
_MOST = 8  # names in a message


class StoredAxis(NamedTuple):
    """An axis of a stored image: its name, its kind (time, channel, space or empty), and its metadata."""

    name: str
    kind: str
    unit: str | None = None
    orientation: Any = None


class Level(NamedTuple):
    """An array of a stored image; ``scale`` and ``translation`` map indices to positions, in units of the axes."""

    path: str  # in the store; empty for a plain array
    array: Any
    scale: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True)
class StoredImage:
    """An image in a Zarr store: a plain array, or levels of an OME-Zarr image."""

    address: str  # the folder or address
    version: str  # of the OME-Zarr metadata: "0.4", "0.5" or "0.6"; empty for a plain array
    axes: tuple[StoredAxis, ...]  # in array order
    levels: tuple[Level, ...]  # the finest first
    spatial: tuple[int, ...]  # indices of the axes of space, the last two or three; all others are carried along
    name: str = ""
    attributes: Mapping[str, Any] = field(default_factory=dict)  # of the group or the array, including OME-Zarr's
    labels: tuple[str, ...] = ()  # the names of the label images that lie in its group

    @property
    def is_labels(self) -> bool:
        """True if the metadata say that it is a label image."""
        return "image-label" in ome_of(self.attributes)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the finest level, of all axes."""
        return tuple(self.levels[0].array.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the samples."""
        dtype: np.dtype[Any] = np.dtype(self.levels[0].array.dtype)
        return dtype

    @property
    def placed(self) -> bool:
        """True if the axes of space have units, so that the grid is in millimetres."""
        return any((self.axes[axis].unit or "").lower() not in _PIXELS for axis in self.spatial)

    @property
    def grid(self) -> Grid:
        """The grid of the finest level: in millimetres if the axes have lengths as units, else in pixels.

        As for fields in OME-Zarr, axes named x, y, z give positions along x, y, z; if all axes have an anatomical
        orientation, positions are in LPS.
        """
        one, axes = self.levels[0], [self.axes[axis] for axis in self.spatial]
        shape = [one.array.shape[axis] for axis in self.spatial]
        if not self.placed:
            return Grid(shape)
        error = Place(self.address).unreadable
        units = [None if (axis.unit or "").lower() in _PIXELS else axis.unit for axis in axes]
        if not all(units):
            listed = ", ".join(f"{axis.name} ({axis.unit or 'none'})" for axis in axes)
            raise error(f"its axes have units only in part: {listed}", "give all of them one")
        whole = len(axes) == sum(axis.kind == "space" for axis in self.axes)
        described = [{"name": axis.name, "orientation": axis.orientation if whole else None} for axis in axes]
        matrix = space_matrix(described, units, error)
        columns = (matrix * [one.scale[axis] for axis in self.spatial])[:, ::-1]
        spacing = np.linalg.norm(columns, axis=0)
        origin = matrix @ [one.translation[axis] for axis in self.spatial]
        return Grid(shape, spacing.tolist(), origin.tolist(), columns / spacing)


def open_image(address: PathLike, *, ndim: int | None = None) -> StoredImage:
    """Open a Zarr array, or the first OME-Zarr image of version 0.4, 0.5 or 0.6 in a group, for reading.

    The address is a folder or a URL of fsspec (``s3://``, ``gs://``, ``https://``, ``memory://``, ``file://``), in Zarr
    format 2 or 3. ``ndim`` is the number of axes of space, the last ones: by default, as in the metadata of OME-Zarr,
    or up to three of a plain array. SuppleError if there is no such store; if it holds no image, or an unreadable one;
    or if it is an unfinished output.
    """
    place = Place(address)
    place.check_finished()
    node = place.open()
    if hasattr(node, "shape"):
        Place(os.path.dirname(place.address.rstrip("/")) or ".").check_finished()
    return described(place, node, ndim)


def described(place: Place, node: Any, ndim: int | None) -> StoredImage:
    """Return the image in an open array or group."""
    attributes = dict(node.attrs)
    with parsing(place.unreadable):
        if hasattr(node, "shape"):
            image = _plain(place, node, attributes, ndim)
        elif "multiscales" in ome_of(attributes):
            image = _multiscale(place, node, attributes, ndim)
        else:
            names: list[str] = []
            with quiet(), contextlib.suppress(Exception):  # not every server can list keys
                names = sorted(node.keys())
            if not names:
                raise place.unreadable("it is a group without an image", "give an OME-Zarr image or an array")
            what = f"it is a group without an image, and holds {listing(names, _MOST)}"
            raise place.unreadable(what, f"give one of them, as {place.address.rstrip('/')}/{names[0]}")
        _ = image.grid  # raises for units that are not lengths
    return image


def _plain(place: Place, array: Any, attributes: Json, ndim: int | None) -> StoredImage:
    _check_samples(place, array, "")
    n = array.ndim
    if n < (ndim or 2):
        raise place.unreadable(f"the array has {n} axes", f"give one of {ndim or 2} axes or more")
    space = ndim or min(n, 3)
    listed = getattr(array.metadata, "dimension_names", None) or attributes.get("_ARRAY_DIMENSIONS") or ()
    names = [str(name or "") for name in listed] if len(listed) == n else [""] * n
    axes = tuple(StoredAxis(name, "" if k < n - space else "space") for k, name in enumerate(names))
    level = Level("", array, (1.0,) * n, (0.0,) * n)
    return StoredImage(place.address, "", axes, (level,), tuple(range(n - space, n)), "", attributes)


def _multiscale(place: Place, group: Any, attributes: Json, ndim: int | None) -> StoredImage:
    ome = ome_of(attributes)
    image = ome["multiscales"][0]
    stated = str(ome.get("version") or image.get("version") or ("0.5" if "ome" in attributes else "0.4"))
    match = re.match(r"0\.[456](?!\d)", stated)
    if match is None:
        raise place.unreadable(f"it is of OME-Zarr {stated}", "use 0.4, 0.5 or 0.6")
    version = match[0]
    axes = _axes(image, place.unreadable)
    n, space = len(axes), sum(axis.kind == "space" for axis in axes)
    if ndim is not None and ndim > space:
        raise place.unreadable(f"its image has {space} axes of space", f"give at most {space} for ndim")
    shared = [] if version == "0.6" else image.get("coordinateTransformations") or []
    levels: list[Level] = []
    for dataset in image["datasets"]:
        path = dataset["path"].strip("/")
        if not path or {"..", "."} & set(path.split("/")):
            raise place.unreadable(f"its datasets have the path {dataset['path']!r}", _MEND)
        if not dataset["coordinateTransformations"]:
            raise place.unreadable(f"its level {path} has no coordinateTransformations", "add a scale")
        with place.reading(f"its array {path} is missing or damaged"), quiet():
            array = group[path]
        _check_samples(place, array, f" {path}")
        if array.ndim != n:
            names = ", ".join(axis.name for axis in axes)
            what = f"its image has the axes {names}, and its array {path} has {array.ndim} of them"
            raise place.unreadable(what, _MEND)
        steps = [*dataset["coordinateTransformations"], *shared]
        levels.append(Level(path, array, *_moved(steps, n, f"level {path}", place.unreadable)))
    for one, other in itertools.pairwise(levels):
        before, after = tuple(one.array.shape), tuple(other.array.shape)
        fall = all(b <= a for a, b in zip(before, after, strict=True)) and before != after
        if not fall or before[: n - space] != after[: n - space]:
            what = f"its levels {one.path} and {other.path} have the shapes {before} and {after}"
            raise place.unreadable(what, "list the levels from the finest to the coarsest, once each")
    if len({level.array.dtype for level in levels}) > 1:
        types = ", ".join(str(level.array.dtype) for level in levels)
        raise place.unreadable(f"its levels are of {types}", "give levels of one type")
    spatial = tuple(range(n - (ndim or space), n))
    name, labels = str(image.get("name") or ""), _labels(place, group)
    return StoredImage(place.address, version, axes, tuple(levels), spatial, name, attributes, labels)


def _axes(image: Json, error: Refusal) -> tuple[StoredAxis, ...]:
    """Return the axes: time and channel, if any, before two or three axes of space."""
    if systems := image.get("coordinateSystems"):
        end = image["datasets"][0]["coordinateTransformations"][0].get("output")
        name = end.get("name") if isinstance(end, Mapping) else end
        fitting = [system["axes"] for system in systems if name in (None, system["name"])]
        listed = fitting[0]
    else:
        listed = image["axes"]
    axes = []
    for one in listed:
        name, kind, unit = str(one["name"]), one.get("type"), one.get("unit")
        kind = _GUESSED.get(name.lower(), "") if kind is None else kind
        axes.append(StoredAxis(name, kind, str(unit) if unit else None, one.get("orientation")))
    if len({axis.name for axis in axes}) < len(axes):
        raise error(f"its axes are named {', '.join(axis.name for axis in axes)}", "give each a name of its own")
    if not _CARRIED.fullmatch("".join(f"{axis.kind or 'other'} " for axis in axes)):
        named = ", ".join(f"{axis.name} ({axis.kind or 'no type'})" for axis in axes)
        what = f"its axes are {named}"
        raise error(what, "store them in the order time, channels, and two or three axes of space")
    return tuple(axes)


def _moved(steps: Sequence[Json], n: int, where: str, error: Refusal) -> tuple[tuple[float, ...], tuple[float, ...]]:
    scale, translation = np.ones(n), np.zeros(n)
    for step in steps:
        kind = step["type"]
        if kind == "sequence":
            inner = _moved(step["transformations"], n, where, error)
            scale, translation = scale * inner[0], translation * inner[0] + inner[1]
        elif kind in ("scale", "translation"):
            values: Any = step.get(kind)
            good = isinstance(values, list) and all(isinstance(x, int | float) and math.isfinite(x) for x in values)
            if not good or len(values) != n or (kind == "scale" and min(values) <= 0):
                what = "numbers above 0" if kind == "scale" else "finite numbers"
                raise error(f"the {kind} of its {where} is {values!r:.80}", f"give {n} {what}, one for each axis")
            if kind == "scale":
                scale, translation = scale * values, translation * values
            else:
                translation = translation + values
        elif kind != "identity":
            raise error(f"its {where} has a transformation of the type {kind!r}", "use scale and translation")
    return tuple(scale.tolist()), tuple(translation.tolist())


def _check_samples(place: Place, array: Any, name: str) -> None:
    if np.dtype(array.dtype).kind not in "biuf":
        raise place.unreadable(f"its array{name} is of {array.dtype}", "give one of integers or real numbers")
    if 0 in array.shape:
        raise place.unreadable(f"its array{name} has the shape {tuple(array.shape)}", "give one with samples")


def _labels(place: Place, group: Any) -> tuple[str, ...]:
    try:
        with quiet():
            listed = ome_of(dict(group[LABELS].attrs)).get(LABELS)
    except KeyError:
        return ()
    except Exception as error:  # damaged or unreachable: only a warning, as the image itself can be read
        what = f"the label images of {place.address} cannot be listed ({said(error)})"
        warn(what, VolumeWarning)
        return ()
    return tuple(map(str, listed)) if isinstance(listed, list) else ()
