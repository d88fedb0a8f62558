"""Inputs that are read block by block: Zarr stores, and files with the OME-Zarr images that they are converted to."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from supple.engine.work import Array
from supple.errors import SuppleError, VolumeWarning, argument, need, shown, warn
from supple.media import image, volume
from supple.media.files import PathLike, head_of, is_store, unreadable
from supple.media.stores.image import StoredImage, described, open_image
from supple.media.stores.places import Place, quiet
from supple.media.transforms.ngff import ORIENTATIONS
from supple.media.volume import pages
from supple.media.volume.data import rescaled, rescaled_dtype
from supple.space.geometry import Geometry, Grid, check_upright

_CHUNK = {2: 512, 3: 64}  # the side of a chunk, by the number of axes of space
_SHARD = 1 << 25  # bytes
_SHARDS = 16  # at least, so that all workers have work
_COARSEST = 256  # samples along each axis, at most, in the coarsest level
_MICROSCOPIC = 0.01  # millimetres: finer spacings are written in micrometres
_KINDS = {"t": "time", "c": "channel"}
_TIFF = (*pages.SUFFIXES, ".btf")
_OPACITY, _PALETTE, _WHITE_IS_ZERO, _YCBCR, _JPEGS = (1, 2), 3, 0, 6, (6, 7, 33003, 33005, 34712)


class _Opened(NamedTuple):
    array: Any  # supports slicing
    order: Sequence[int]  # for each axis of `Samples`, the axis of the array
    close: Callable[[], None] = lambda: None


class Samples:
    """The samples of a volume or a picture in a file, which are read when they are sliced.

    Uncompressed NIfTI, raw files and TIFFs are read in parts; other files are read as a whole at the first slice, and
    stay in memory. Pickling keeps only the file's name, and each process opens the file. SuppleError if the file
    cannot be read, or its contents cannot be stored.
    """

    axes: str  # the names of the axes, some of "tczyx" in this order
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...] | None = None  # the blocks that are decoded as a whole; None if mapped or in memory
    geometry: Geometry | None = None
    interval: float | None = None  # seconds from a time to the next, if they are known

    def __init__(self, path: PathLike, **how: Any) -> None:
        self._path, self._how = os.fspath(path), how  # as in `supple.media.volume.read`
        self._scaling = 1.0, 0.0
        self._lock = threading.Lock()
        self._opened: _Opened | None = None
        whole = how.get("raw") is not None or how.get("series") is not None or os.path.isdir(path)
        if not whole and os.path.splitext(path)[1].lower() in _TIFF:
            self._kind = "tiff"
            self._opened = self._open_tiff()
        elif whole or volume.is_volume(path):
            self._kind = "volume"
            found = volume.outline_of(path, **how)
            check_upright(found.geometry, found.name, "work in blocks")
            self.axes = "tzyx" if found.series else "zyx" if found.samples.ndim == 3 else "czyx"
            shape, self.geometry, self._scaling = found.samples.shape, found.geometry, found.scaling
            self.shape = (*shape[3:], *shape[:3]) if self.axes == "czyx" else shape
            self.dtype = rescaled_dtype(found.samples.dtype, found.scaling).newbyteorder("=")
            self.interval = found.interval if found.series else None
        else:
            self._kind = "picture"
            facts = image.info(path)
            if facts["alpha"]:
                raise _with_opacity(self._path)
            height, width, channels = (int(str(facts[name])) for name in ("height", "width", "channels"))
            self.axes, self.shape = ("cyx", (channels, height, width)) if channels > 1 else ("yx", (height, width))
            self.dtype = np.dtype(str(facts["dtype"]))

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the open file, which is opened again after unpickling."""
        state = {name: value for name, value in self.__dict__.items() if name not in ("_opened", "_lock")}
        return {**state, "_path": os.path.abspath(self._path)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state with the file closed; the first slice opens it."""
        self.__dict__.update(state, _opened=None, _lock=threading.Lock())

    def __getitem__(self, key: tuple[slice, ...]) -> Array:
        """Return a part, for slices without steps along all axes."""
        with self._lock:
            if self._opened is None:
                with warnings.catch_warnings():  # already issued when the header was read
                    warnings.simplefilter("ignore")
                    self._opened = self._open()
            array, order, _ = self._opened
        stored = [slice(0, 1)] * array.ndim
        for axis, part in zip(order, key, strict=True):
            stored[axis] = part
        found = np.asarray(array[tuple(stored)])
        rest = [axis for axis in range(found.ndim) if axis not in order]  # axes of length 1
        found = found.transpose(*order, *rest).reshape([found.shape[axis] for axis in order])
        return rescaled(found.astype(found.dtype.newbyteorder("="), copy=False), self._scaling)

    def __del__(self) -> None:
        """Close the file."""
        with contextlib.suppress(Exception):
            if self._opened is not None:
                self._opened.close()

    def _open(self) -> _Opened:
        if self._kind == "tiff":
            return self._open_tiff()
        if self._kind == "picture":
            return _Opened(image.read(self._path).pixels, (2, 0, 1) if self.axes == "cyx" else (0, 1))
        order = (3, 0, 1, 2) if self.axes == "czyx" else range(len(self.axes))
        return _Opened(volume.read(self._path, **self._how).samples, order)

    def _open_tiff(self) -> _Opened:
        """Open a TIFF by tifffile, which reads single tiles and strips, and knows the axes of OME-TIFF and ImageJ."""
        need("zarr", "TIFFs that are read in parts", "zarr")
        import zarr

        path = self._path
        if head_of(path, 2) not in (b"II", b"MM"):
            raise unreadable(path, "it is no TIFF", "check its name")
        with contextlib.ExitStack() as stack:
            file, first = stack.enter_context(pages.series_of(path))
            with pages.reading(path):
                page = first.keyframe
            _check_kind(path, first, page)
            names = pages.axes_of(path, first)
            order = sorted(names, key=lambda k: "tczyx".find(names[k]))
            self.axes = "".join(names[k] for k in order)
            with pages.reading(path), quiet():
                array: Any
                if first.dataoffset is not None:  # uncompressed, and in one piece
                    array = np.memmap(path, f"{file.byteorder}{first.dtype.char}", "r", first.dataoffset, first.shape)
                else:
                    if any(page is None or 0 in page.databytecounts for page in first.pages):
                        raise unreadable(path, "some of its tiles or strips are empty")
                    array = zarr.open(stack.enter_context(first.aszarr(level=0)), mode="r")
                    self.chunks = tuple(int(array.chunks[axis]) for axis in order)
            self.shape = tuple(int(array.shape[axis]) for axis in order)
            self.dtype = np.dtype(array.dtype).newbyteorder("=")
            count = math.prod(first.shape[k] for k, name in names.items() if name in "tcz" and first.axes[k] != "S")
            facts = file.imagej_metadata or {}
            if count < (promised := int(facts.get("images", 1))):
                raise unreadable(path, f"it is said to hold {promised} images, and has {count} pages")
            if "z" in self.axes:
                self.geometry = pages.place(path, file)
            interval = float(facts.get("finterval") or 0)
            self.interval = interval if 0 < interval < math.inf else None
            return _Opened(array, order, stack.pop_all().close)


def _with_opacity(path: str) -> SuppleError:
    advice = "write a picture, which keeps it, or remove it first"
    return unreadable(path, "it has opacity, and channels of a store are bent one by one", advice)


def _check_kind(path: str, first: Any, page: Any) -> None:
    """Raise SuppleError for samples that are not numbers of a channel, such as a palette's indices."""
    if "S" in first.axes and any(int(kind) in _OPACITY for kind in page.extrasamples):
        raise _with_opacity(path)
    coded = page.photometric in (_PALETTE, _WHITE_IS_ZERO) or (
        page.photometric == _YCBCR and int(page.compression) not in _JPEGS
    )
    odd = page.dtype is None or first.dtype.kind not in "biuf" or page.bitspersample % 8
    turned = "Orientation" in page.tags and page.tags["Orientation"].value not in (0, 1)
    if coded or odd or turned:
        what = "its samples are colours of a palette, negatives, YCbCr, of parts of bytes, or stored turned"
        raise unreadable(path, f"{what}, which is read for pictures alone", "convert it, as vips copy does")


def like_file(path: PathLike, samples: Samples, *, ndim: int | None = None) -> StoredImage:
    """Return the OME-Zarr 0.5 image that a file is converted to, with empty arrays; ``ndim`` is as in `open_image`.

    Axes of space are in millimetres, in micrometres for small spacings, or without a unit if the file has no spacing.
    Axes along a patient's get an anatomical orientation; oblique ones cause a VolumeWarning, as levels have only a
    scale and a translation. Each level is half as large as the one before, along the axes of finest spacing. Shards
    cover the blocks that the file decodes as a whole.
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


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """An input that will be warped block by block; no samples have been read."""

    name: str  # for messages
    image: StoredImage  # the store's image, or the one that a file is converted to
    samples: Any  # an array or `Samples`, which is sliced
    geometry: Geometry | None  # of a volume; None for a picture
    scaling: tuple[float, float] = (1.0, 0.0)  # slope and intercept; a Zarr array's scale_factor and add_offset
    background: float = 0.0  # the scaled fill value outside a volume

    @property
    def is_file(self) -> bool:
        """True if it is a file, and not a Zarr store."""
        return isinstance(self.samples, Samples)

    @property
    def carried(self) -> int:
        """The number of axes before those of space."""
        return len(self.image.axes) - len(self.image.spatial)

    @property
    def space(self) -> tuple[int, ...]:
        """The shape along the axes of space."""
        return self.image.shape[self.carried :]

    @property
    def grid(self) -> Grid:
        """The grid of the samples: in pixels, or in millimetres."""
        return Grid(self.space) if self.geometry is None else self.geometry.grid(self.space)

    @property
    def outline(self) -> volume.Volume:
        """One volume or picture, whose samples are 0, and take no memory."""
        whole = np.broadcast_to(np.zeros((), self.image.dtype), self.space)
        return volume.Volume(whole, self.geometry or Geometry(), self.name, scaling=self.scaling)


def open_source(path: PathLike, axes: int | None, how: Mapping[str, Any]) -> Source:
    """Open an input as a picture or a volume, by a number of axes of space, or else by its own axes.

    ``how`` has options of `supple.media.volume.read`. SuppleError if the input cannot be read; if an option does not
    apply to it; or if it has fewer axes of space.
    """
    if not is_store(path):
        samples = Samples(path, **how)
        n = _axes_of_space(path, axes, 3 if "z" in samples.axes else 2)
        geometry = samples.geometry if n == 3 else None
        return Source(shown(path), like_file(path, samples, ndim=n), samples, geometry)
    for name in how:
        raise SuppleError(f"Zarr stores take no {argument('layout' if name == 'raw' else name)}: leave that out")
    image = open_image(path)
    n = _axes_of_space(path, axes, len(image.spatial))
    image = image if n == len(image.spatial) else open_image(path, ndim=n)
    names, usual = [image.axes[axis].name.lower() for axis in image.spatial], list("zyx"[-n:])
    if sorted(names) == sorted(usual) and names != usual:  # the x of points is along the last axis
        what = f"its axes of space are {', '.join(names)}, in this order"
        raise unreadable(image.address, what, f"store them in the order {', '.join(usual)}, as OME-Zarr has them")
    geometry = None
    if n == 3:
        geometry = image.grid.geometry("LPS") if image.placed else Geometry()
    array = image.levels[0].array
    scaling = 1.0, 0.0
    with contextlib.suppress(TypeError, ValueError):  # for attributes that are not numbers
        scaling = float(array.attrs.get("scale_factor", 1)), float(array.attrs.get("add_offset", 0))
    scaling = scaling if scaling[0] else (1.0, 0.0)
    fill = array.metadata.fill_value
    number = isinstance(fill, int | float | np.number) and np.isfinite(fill)
    background = float(fill) * scaling[0] + scaling[1] if number else 0.0
    return Source(shown(image.address), image, array, geometry, scaling, background)


def _axes_of_space(path: PathLike, stated: int | None, found: int) -> int:
    if stated is not None and stated > found:
        text = f"{shown(path)} is a picture, with {found} axes of space, and strokes, maps or the crop have {stated}"
        raise SuppleError(f"{text}: give points of two numbers, x and y")
    return stated or found


def _placed(path: PathLike, samples: Samples) -> tuple[list[dict[str, Any]], list[float], list[float]]:
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
        warn(what, VolumeWarning)
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
    """Return the shape of each level, and the factor along each axis by which it is smaller than the finest."""
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

    A shard covers whole blocks of the file's coding (``decoded``), so that none is decoded for many shards; if that is
    a page, shards are thin.
    """
    n = len(shape) - carried
    whole = decoded or (1,) * len(shape)
    chunk = [min(size, whole[k] if k < carried else _CHUNK[n]) for k, size in enumerate(shape)]

    def covering(k: int, wanted: int) -> int:
        return min(-(-wanted // chunk[k]), -(-shape[k] // chunk[k])) * chunk[k]

    shard = [covering(k, max(chunk[k], whole[k])) for k in range(len(shape))]
    while n == 3 and chunk[carried] > whole[carried] and math.prod(shard) * itemsize > 2 * _SHARD:
        chunk[carried] = shard[carried] = -(-chunk[carried] // 2)
    most = min(_SHARD, math.prod(shape) * itemsize // _SHARDS) // itemsize
    grow(shard, shape, range(carried, len(shape)), most, lambda k: covering(k, 2 * shard[k]))
    return tuple(chunk), tuple(shard)


def grow(sizes: list[int], shape: Sequence[int], axes: Sequence[int], most: float, wider: Callable[[int], int]) -> None:
    """Enlarge a block of ``sizes`` in place along some axes, the shortest first, up to ``most`` samples.

    ``wider`` returns the next size along an axis.
    """
    while growing := [k for k in axes if sizes[k] < shape[k]]:
        k = min(growing, key=lambda axis: sizes[axis])
        if math.prod(sizes) // sizes[k] * wider(k) > most:
            break
        sizes[k] = wider(k)
