"""Images in Zarr stores, opened: their axes, levels and grid; no sample is read."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from supple.errors import SuppleError, VolumeWarning, said
from supple.media.files import PathLike, unreadable
from supple.media.stores import ome
from supple.media.stores.places import Place, quiet
from supple.media.transforms.omezarr import ome_of, space_matrix
from supple.space.geometry import Grid

LABELS = "labels"
"""The group of an image's label images."""
_PIXELS = ("", "pixel", "pixels", "voxel", "voxels")  # of programs, not of the specification
_MOST = 8  # names in a message


@dataclass(frozen=True)
class StoredAxis:
    """An axis of a stored image.

    Parameters
    ----------
    name : str
        Empty if it has none.
    kind : {"time", "channel", "space", ""}
        Empty if the store does not say.
    unit : str or None
        As it is stored.
    orientation : mapping or str, optional
        Its anatomical orientation, as it is stored.
    """

    name: str
    kind: Literal["time", "channel", "space", ""]
    unit: str | None
    orientation: Any = None


@dataclass(frozen=True)
class Level:
    """An array of a stored image.

    Parameters
    ----------
    path : str
        Where it lies in the store; empty for a plain array.
    array : zarr.Array
        Its samples.
    scale, translation : tuple of float
        From an index to its position along each axis, in the units of the axes.
    """

    path: str
    array: Any
    scale: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True)
class StoredImage:
    """An image in a Zarr store: a plain array, or levels of an OME-Zarr image.

    Parameters
    ----------
    address : str
        The folder or address.
    version : {"", "0.4", "0.5", "0.6"}
        That of the OME-Zarr metadata; empty for a plain array.
    axes : tuple of StoredAxis
        In array order.
    levels : tuple of Level
        The finest first.
    spatial : tuple of int
        The axes that are positions in space, in array order: the last two or three. Those before are carried along.
    name : str
        As the metadata have it.
    attributes : mapping
        Those of the group or the array, with all metadata of OME-Zarr.
    labels : tuple of str
        The names of the label images that lie in its group.
    """

    address: str
    version: ome.Version
    axes: tuple[StoredAxis, ...]
    levels: tuple[Level, ...]
    spatial: tuple[int, ...]
    name: str = ""
    attributes: Mapping[str, Any] = field(default_factory=dict)
    labels: tuple[str, ...] = ()

    @property
    def is_labels(self) -> bool:
        """Whether the metadata say that it is a label image."""
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
    def grid(self) -> Grid:
        """The grid of the finest level: in millimetres if the axes have lengths as units, else in pixels.

        As the fields of OME-Zarr, positions are by the names of the axes if these are x, y, z, and turned to LPS if all
        axes have an anatomical orientation.
        """
        one, axes = self.levels[0], [self.axes[axis] for axis in self.spatial]
        shape = [one.array.shape[axis] for axis in self.spatial]
        units = [None if (axis.unit or "").lower() in _PIXELS else axis.unit for axis in axes]
        if not any(units):
            return Grid(shape)
        if not all(units):
            told = ", ".join(f"{axis.name} ({axis.unit or 'none'})" for axis in axes)
            raise self._error(f"its axes have units only in part: {told}", "give all of them one")
        whole = len(axes) == sum(axis.kind == "space" for axis in self.axes)
        told_axes = [{"name": axis.name, "orientation": axis.orientation if whole else None} for axis in axes]
        matrix = space_matrix(told_axes, units, self._error)
        columns = (matrix * [one.scale[axis] for axis in self.spatial])[:, ::-1]
        spacing = np.linalg.norm(columns, axis=0)
        origin = matrix @ [one.translation[axis] for axis in self.spatial]
        return Grid(shape, spacing.tolist(), origin.tolist(), columns / spacing)

    @property
    def placed(self) -> bool:
        """Whether the axes of space have units, so that the grid is in millimetres."""
        return any((self.axes[axis].unit or "").lower() not in _PIXELS for axis in self.spatial)

    @property
    def spacing(self) -> tuple[float, ...]:
        """The distance between samples of the finest level, x first: millimetres, or 1.0 pixels without units."""
        return self.grid.spacing

    @property
    def origin(self) -> tuple[float, ...]:
        """The position of the first sample of the finest level, x first, in the same unit."""
        return self.grid.origin

    def _error(self, reason: str, advice: str) -> SuppleError:
        return unreadable(self.address, reason, advice)


def open_image(address: PathLike, *, ndim: int | None = None) -> StoredImage:
    """Open a Zarr array, or an OME-Zarr image of version 0.4, 0.5 or 0.6, for reading.

    Parameters
    ----------
    address : str or os.PathLike
        A folder, or an address that fsspec knows (``s3://``, ``gs://``, ``https://``, ``memory://``, ``file://``), of
        Zarr format 2 or 3: an array, also one in a group (``image.zarr/0``), or a group with an image.
    ndim : {2, 3}, optional
        The number of axes that are positions in space, the last ones. By default, those that an OME-Zarr image
        describes; of a plain array, all up to three.

    Returns
    -------
    StoredImage
        The first image, if the group describes several.

    Raises
    ------
    SuppleError
        If there is no such store; it holds no image, or one that cannot be read; or it is an unfinished output.
    """
    place = Place(address)
    place.check_finished()
    node = place.open()
    if hasattr(node, "shape") and (above := place.parent()) is not None:
        above.check_finished()
    return described(place, node, ndim)


def described(place: Place, node: Any, ndim: int | None) -> StoredImage:
    """Return the image of an array or a group that is open."""
    if ndim not in (None, 2, 3):
        raise SuppleError(f"ndim must be 2 or 3, not {ndim!r}")
    attributes = dict(node.attrs)
    if hasattr(node, "shape"):
        made = _plain(place, node, attributes, ndim)
    elif "multiscales" not in ome_of(attributes):
        raise place.unreadable(*_without_image(place, node))
    else:
        made = _multiscale(place, node, attributes, ndim)
    check_grid = made.grid  # it raises for units that are no lengths
    assert check_grid.ndim == len(made.spatial)
    return made


def _without_image(place: Place, node: Any) -> tuple[str, str]:
    """Return what a group holds instead of an image, and which of its parts could be given."""
    try:
        with quiet():
            parts = [(name, hasattr(part, "shape")) for name, part in itertools.islice(_members(node), _MOST + 1)]
    except Exception:  # not every server lists
        parts = []
    if not parts:
        return "it is a group without an image", "give an OME-Zarr image or an array"
    told = []
    for what, arrays in (("arrays", True), ("groups", False)):
        names = [name for name, one in parts[:_MOST] if one == arrays]
        told += [f"the {what} {', '.join(names)}"] if names else []
    more = " and more" if len(parts) > _MOST else ""
    first = next((name for name, array in parts if array), parts[0][0])
    found = f"it is a group without an image, and holds {' and '.join(told)}{more}"
    return found, f"give one of them, as {place.address.rstrip('/')}/{first}"


def _members(node: Any) -> Iterator[tuple[str, Any]]:
    """Return the parts of a group in order, each opened only when it is asked for."""
    for name in sorted(node.keys()):
        yield name, node[name]


def _plain(place: Place, array: Any, attributes: Mapping[str, Any], ndim: int | None) -> StoredImage:
    _check_samples(place, array, "")
    n = array.ndim
    if n < (ndim or 2):
        raise place.unreadable(f"the array has {n} axes", f"give one of {ndim or 2} axes or more")
    space = ndim or min(n, 3)
    told = getattr(array.metadata, "dimension_names", None) or attributes.get("_ARRAY_DIMENSIONS") or ()
    names = [str(name or "") for name in told] if len(told) == n else [""] * n
    axes = tuple(StoredAxis(name, "" if k < n - space else "space", None) for k, name in enumerate(names))
    level = Level("", array, (1.0,) * n, (0.0,) * n)
    return StoredImage(place.address, "", axes, (level,), tuple(range(n - space, n)), "", attributes)


def _multiscale(place: Place, group: Any, attributes: Mapping[str, Any], ndim: int | None) -> StoredImage:
    told = ome.described(attributes, place.unreadable)
    axes = tuple(StoredAxis(a["name"], a["type"], a.get("unit") or None, a.get("orientation")) for a in told.axes)
    space = sum(axis.kind == "space" for axis in axes)
    if ndim is not None and ndim > space:
        raise place.unreadable(f"its image has {space} axes of space", f"give at most {space} for ndim")
    levels: list[Level] = []
    for dataset in told.datasets:
        array = _array(place, group, dataset.path)
        _check_samples(place, array, f" {dataset.path}")
        if array.ndim != len(axes):
            names = ", ".join(axis.name for axis in axes)
            what = f"its image has the axes {names}, and its array {dataset.path} has {array.ndim} of them"
            raise place.unreadable(what, "mend its metadata")
        levels.append(Level(dataset.path, array, dataset.scale, dataset.translation))
    for one, other in itertools.pairwise(levels):
        _check_fall(place, one, other, len(axes) - space)
    spatial = tuple(range(len(axes) - (ndim or space), len(axes)))
    labels = _labels(place, group)
    return StoredImage(place.address, told.version, axes, tuple(levels), spatial, told.name, attributes, labels)


def _labels(place: Place, group: Any) -> tuple[str, ...]:
    """Return the names of label images, as the group of labels lists them."""
    try:
        with quiet():
            attributes = dict(group[LABELS].attrs)
        listed = attributes.get("ome", attributes).get(LABELS)
    except KeyError:
        return ()
    except Exception as error:  # damaged, or not to be reached: what is in the image itself is
        told = f"the label images of {place.address} cannot be listed ({said(error)})"
        warnings.warn(told, VolumeWarning, stacklevel=6)
        return ()
    return tuple(map(str, listed)) if isinstance(listed, list) else ()


def _array(place: Place, group: Any, path: str) -> Any:
    try:
        with place.reading(f"its array {path} is damaged"), quiet():
            array = group[path]
    except SuppleError as error:
        if isinstance(error.__cause__, KeyError):
            raise place.unreadable(f"it lacks its array {path}") from error.__cause__
        raise
    if not hasattr(array, "shape"):
        raise place.unreadable(f"its level {path} is a group, not an array", "mend its metadata")
    return array


def _check_samples(place: Place, array: Any, name: str) -> None:
    """Raise SuppleError for an array whose samples are no real numbers, which has none, or which cannot be decoded."""
    if np.dtype(array.dtype).kind not in "biuf":
        raise place.unreadable(f"its array{name} is of {array.dtype}", "give one of integers or real numbers")
    if 0 in array.shape:
        raise place.unreadable(f"its array{name} has the shape {tuple(array.shape)}", "give one with samples")
    for codec in _codecs(array.metadata):
        settings = getattr(codec, "codec_config", None)  # those of numcodecs are looked for at the first chunk only
        if settings is not None:
            import numcodecs

            with place.reading(f"its array{name} cannot be decoded"):
                numcodecs.get_codec(dict(settings))


def _codecs(metadata: Any) -> Iterator[Any]:
    for codec in getattr(metadata, "codecs", ()):
        yield codec
        yield from _codecs(codec)


def _check_fall(place: Place, one: Level, other: Level, carried: int) -> None:
    """Raise SuppleError for two levels of which the second is not the first, coarser."""
    before, after = tuple(one.array.shape), tuple(other.array.shape)
    fall = all(b <= a for a, b in zip(before, after, strict=True))
    if not fall or before == after or before[:carried] != after[:carried]:
        what = f"its levels {one.path} and {other.path} have the shapes {before} and {after}"
        raise place.unreadable(what, "list the levels from the finest to the coarsest, once each")
    if one.array.dtype != other.array.dtype:
        what = f"its levels {one.path} and {other.path} are of {one.array.dtype} and {other.array.dtype}"
        raise place.unreadable(what, "give levels of one type")
    if one.array.metadata.zarr_format != other.array.metadata.zarr_format:
        raise place.unreadable("its levels are of two Zarr formats", "write them in one")
