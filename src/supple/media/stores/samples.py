"""Samples of files that are no stores, sliced when they are read: of volumes, TIFFs and pictures."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, need
from supple.media import image, volume
from supple.media.files import PathLike, head_of, unreadable
from supple.media.stores.places import quiet
from supple.media.volume import RawLayout, pages
from supple.media.volume.data import rescaled, rescaled_dtype
from supple.space.geometry import Geometry, check_upright

Array = npt.NDArray[Any]

_TIFF = (*pages.SUFFIXES, ".btf")
_OPACITY, _PALETTE, _WHITE_IS_ZERO, _YCBCR, _JPEGS = (1, 2), 3, 0, 6, (6, 7, 33003, 33005, 34712)


class Opened(NamedTuple):
    """A file that is open."""

    array: Any  # it is sliced
    order: Sequence[int]  # for each of the axes, that of the array
    close: Callable[[], None] = lambda: None


class Samples:
    """The samples of a file: a part of them is read when it is asked for.

    They are sent to other processes as the name of the file, which each opens.

    Parameters
    ----------
    path : str or os.PathLike
        A volume as `supple.media.volume.read` takes it, or a picture. Of uncompressed NIfTI and raw files, and of
        TIFFs, parts are read; others are held in memory, from the first part on.
    raw, series
        As in `supple.media.volume.read`.

    Attributes
    ----------
    axes : str
        The names of the axes, some of "tczyx" in this order.
    shape : tuple of int
    dtype : dtype
    chunks : tuple of int or None
        The shape of what is decoded as a whole: a tile, a strip, a page. None of what is mapped or in memory.
    geometry : Geometry or None
        The place of a volume in space.
    interval : float or None
        Seconds from a time to the next, if they are known.

    Raises
    ------
    SuppleError
        If the file cannot be read, or holds what a store does not.
    """

    axes: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...] | None = None
    geometry: Geometry | None = None
    interval: float | None = None

    def __init__(self, path: PathLike, *, raw: RawLayout | None = None, series: str | None = None) -> None:
        self._path, self._raw, self._series = os.fspath(path), raw, series
        self._scaling = 1.0, 0.0
        self._lock = threading.Lock()
        self._opened: Opened | None = None
        whole = raw is not None or series is not None or os.path.isdir(path)
        if not whole and os.path.splitext(path)[1].lower() in _TIFF:
            self._kind: Literal["tiff", "volume", "picture"] = "tiff"
            self._opened = self._open_tiff()
        elif whole or volume.is_volume(path):
            self._kind = "volume"
            found = volume.outline_of(path, raw=raw, series=series)
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
        """Leave out the file, which is opened again."""
        state = {name: value for name, value in self.__dict__.items() if name not in ("_opened", "_lock")}
        return {**state, "_path": os.path.abspath(self._path)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Be closed; the file is opened when a part is asked for."""
        self.__dict__.update(state, _opened=None, _lock=threading.Lock())

    def __getitem__(self, key: tuple[slice, ...]) -> Array:
        """Return a part, for slices without steps along all axes."""
        with self._lock:
            if self._opened is None:
                with warnings.catch_warnings():  # they were given when its header was read
                    warnings.simplefilter("ignore")
                    self._opened = self._open()
            array, order, _ = self._opened
        stored = [slice(0, 1)] * array.ndim
        for axis, part in zip(order, key, strict=True):
            stored[axis] = part
        found = np.asarray(array[tuple(stored)])
        rest = [axis for axis in range(found.ndim) if axis not in order]  # of one sample
        found = found.transpose(*order, *rest).reshape([found.shape[axis] for axis in order])
        return rescaled(found.astype(found.dtype.newbyteorder("="), copy=False), self._scaling)

    def __del__(self) -> None:
        """Close the file."""
        with contextlib.suppress(Exception):
            if self._opened is not None:
                self._opened.close()

    def _open(self) -> Opened:
        if self._kind == "tiff":
            return self._open_tiff()
        if self._kind == "picture":
            return Opened(image.read(self._path).pixels, (2, 0, 1) if self.axes == "cyx" else (0, 1))
        order = (3, 0, 1, 2) if self.axes == "czyx" else range(len(self.axes))
        return Opened(volume.read(self._path, raw=self._raw, series=self._series).samples, order)

    def _open_tiff(self) -> Opened:
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
                self.geometry = pages.place(path)
            interval = float(facts.get("finterval") or 0)
            self.interval = interval if 0 < interval < math.inf else None
            return Opened(array, order, stack.pop_all().close)


def _with_opacity(path: str) -> SuppleError:
    advice = "write a picture, which keeps it, or remove it first"
    return unreadable(path, "it has opacity, and channels of a store are bent one by one", advice)


def _check_kind(path: str, first: Any, page: Any) -> None:
    """Raise SuppleError for samples that are no numbers of a channel."""
    what = ""
    if "S" in first.axes and any(int(kind) in _OPACITY for kind in page.extrasamples):
        raise _with_opacity(path)
    if page.photometric == _PALETTE:
        what = "its colours are a palette"
    elif page.photometric == _WHITE_IS_ZERO:
        what = "its samples are stored as negatives"
    elif page.photometric == _YCBCR and int(page.compression) not in _JPEGS:
        what = "its colours are YCbCr"
    elif page.dtype is None or first.dtype.kind not in "biuf" or page.bitspersample % 8:
        what = f"its samples have {page.bitspersample} bits"
    elif "Orientation" in page.tags and page.tags["Orientation"].value not in (0, 1):
        what = "its rows and columns are stored turned"
    if what:
        raise unreadable(path, f"{what}, which is read for pictures alone", "convert it, as vips copy does")
