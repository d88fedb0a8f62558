"""Volumes as stacks of TIFF pages, by libvips; the spacing is stored as by ImageJ."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from supple.errors import VolumeWarning, needed, said, shown, warn
from supple.media.files import PathLike, refusing, replacing, unreadable, unwritable
from supple.media.volume.data import MILLIMETRES, Array, Volume, native
from supple.space.geometry import Geometry

SUFFIXES = (".tif", ".tiff")
_LETTERS = {"T": "t", "C": "c", "S": "c", "Z": "z", "Q": "z", "I": "z", "Y": "y", "X": "x"}  # tifffile's axes
_CHANNELS = "channels"  # `Volume.header` where components are stored as pages
_SECONDS = {"s": 1.0, "ms": 1e-3, "\u00b5s": 1e-6, "min": 60.0, "h": 3600.0}


def has_pages(path: PathLike) -> bool:
    """Return whether a file is a TIFF of several pages; False for unreadable files."""
    from supple.media.image.vips import pages_of

    form, count = pages_of(path) if Path(path).suffix.lower() in SUFFIXES else ("", 0)
    return form == "TIFF" and count > 1


def place(path: PathLike, file: Any) -> Geometry:
    """Return the geometry of a stack, its spacing alone, from the description of ImageJ or OME; errors as in `read`."""
    from supple.media.image.vips import opened

    return Geometry(_spacing(opened(path)[0], _description(file)))


def read(path: PathLike) -> Volume:
    """Read a TIFF of slices, with the axes and the spacing that OME-TIFF, ImageJ or tifffile have stored in it.

    Channels become components, and times a series. SuppleError if it is not a TIFF, or damaged; if its pages differ; or
    if it has other axes, or both times and channels.
    """
    from supple.media.image.headers import facts
    from supple.media.image.tiff import Page
    from supple.media.image.vips import apart, decoded, opened, sequential
    from supple.media.image.vips import reading as decoding

    image, form = opened(path)
    if form != "TIFF":
        raise unreadable(path, f"it is no TIFF, but {form}", "check its name")
    count = facts(image)[0]
    with series_of(path, alike=True) as (file, series), reading(path):
        axes = axes_of(path, series)
        sizes = {name: int(series.shape[k]) for k, name in axes.items() if series.axes[k] not in "SYX"}
        kind: str = series.kind
        own = [int(getattr(page, "index", -1)) for page in series.pages if page is None or page.parent is file]
        description, letters = _description(file), "".join(sizes)
    promised = math.prod(sizes.values())
    if kind == "imagej" and promised == count:
        promised = int(description.get("images", count))
    if (kind == "imagej" and promised != count) or len(own) != promised or -1 in own:
        what = f"its description tells of {promised} pages, and it has {count}"
        raise unreadable(path, what, "give all of them, or correct the description")
    if {"t", "c"} <= set(axes.values()):
        raise unreadable(path, "it holds channels or colours of several times", "bend it to a Zarr store")
    first, last = min(own), max(own)
    with decoding(path):
        tall = apart(lambda: sequential(path, fail_on=Page(path).fails_on, page=first, n=last - first + 1))
        samples = apart(lambda: decoded(tall, 1), tall)
    samples = samples.reshape(last - first + 1, -1, *samples.shape[1:])
    if own != list(range(first, last + 1)):
        samples = samples[np.array(own) - first]
    samples = samples.reshape(*sizes.values(), *samples.shape[1:])
    letters += "yxc"[: samples.ndim - len(letters)]
    samples = samples.transpose(sorted(range(len(letters)), key=lambda k: "tzyxc".find(letters[k])))
    if "z" not in letters:
        samples = np.expand_dims(samples, "t" in letters)
    if "x" in description and "z" not in description and sizes.get("z", 1) > 1:
        what = f"{shown(path)} does not tell how far its slices are apart (PhysicalSizeZ): as far as its columns"
        warn(what, VolumeWarning)
    interval = description.get("finterval", 0.0)
    return Volume(
        native(samples),
        Geometry(_spacing(image, description)),
        shown(path),
        "TIFF",
        "t" in letters,
        _CHANNELS if "c" in sizes else None,
        interval=interval if 0 < interval < np.inf else 1.0,
    )


@contextlib.contextmanager
def series_of(path: PathLike, *, alike: bool = False) -> Iterator[tuple[Any, Any]]:
    """Open a TIFF by tifffile, which reads the axes of OME-TIFF, ImageJ and others; yield the file and its first image.

    Further images, and messages that tifffile logs, become warnings. SuppleError if it is damaged or incomplete; or,
    with ``alike``, if pages differ in a file without metadata that declares several images.
    """
    tifffile = needed("volume", "TIFFs of several pages", "tifffile")
    with contextlib.ExitStack() as stack:
        with reading(path), _heard(path):
            file = stack.enter_context(tifffile.TiffFile(path))
            len(file.pages)  # follow the links of all pages
            listed = list(file.series)
        if alike and len(listed) > 1 and listed[0].kind == "generic":
            raise unreadable(path, "its pages are of different sizes or kinds", "give pages of one")
        if len(listed) > 1:
            what = f"{shown(path)} holds {len(listed)} images of different sizes or kinds, and the first is read"
            warn(what, VolumeWarning)
        yield file, listed[0]


def axes_of(path: PathLike, series: Any) -> dict[int, str]:
    """Return the axes of an image of tifffile by their index: some of "tczyx", without axes of length 1.

    SuppleError for other or repeated axes.
    """
    letters = enumerate(zip(series.axes, series.shape, strict=True))
    names = {k: _LETTERS.get(letter, letter) for k, (letter, size) in letters if size > 1 or letter in "YX"}
    if any(name not in "tczyx" for name in names.values()) or len(set(names.values())) < len(names):
        listed = " x ".join(f"{size} {letter}" for size, letter in zip(series.shape, series.axes, strict=True))
        raise unreadable(path, f"its axes are {listed}", "give times, channels, planes, rows and columns, once each")
    return names


def reading(path: PathLike) -> contextlib.AbstractContextManager[None]:
    """Convert all errors of tifffile to one sentence; it raises errors of any type for damaged files."""
    what = "it is damaged, cut short, or no TIFF"
    return refusing(lambda error: unreadable(path, f"{what} ({said(error)})"), Exception)


@contextlib.contextmanager
def _heard(path: PathLike) -> Iterator[None]:
    """Turn tifffile's log messages into warnings, or a SuppleError if pages are lost or would be replaced by zeros."""
    import tifffile

    texts: list[str] = []
    handler, logger = logging.Handler(logging.WARNING), tifffile.logger()
    handler.emit = lambda record: texts.append(f"{record.levelname} {record.getMessage()}")  # type: ignore[method-assign]
    before = logger.propagate, logger.handlers
    logger.propagate, logger.handlers = False, [handler]
    try:
        yield
    finally:
        logger.propagate, logger.handlers = before
    # libvips does not notice a file that ends between two pages
    if any("ERROR <tifffile.TiffPages" in text for text in texts):
        raise unreadable(path, "its list of pages is damaged or cut short")
    if any("zeroed" in text for text in texts):
        raise unreadable(path, "some of its pages are missing, or in files that are", "give all of them")
    if texts:
        text = " ".join(re.sub(r"^\w+ (<.*?> ?)?", "", texts[0]).split())
        warn(f"{shown(path)} is read, but tifffile says: {text}", VolumeWarning)


def _description(file: Any) -> dict[str, float]:
    """Return the numbers in ImageJ's description, and its unit in millimetres as ``unit``; or those of an OME-TIFF.

    For OME-TIFF, the spacing is ``x``, ``y`` and ``z`` in millimetres, and ``finterval`` is in seconds.
    """
    if file.is_ome:
        return _of_ome(file.ome_metadata)
    if (known := file.imagej_metadata) is None:
        return {}
    numbers = {key: value for key, value in known.items() if isinstance(value, int | float) and np.isfinite(value)}
    return {**numbers, "unit": MILLIMETRES.get(str(known.get("unit", "")).lower(), 1.0)}


def _of_ome(text: str) -> dict[str, float]:
    numbers: dict[str, float] = {}
    with contextlib.suppress(ElementTree.ParseError, StopIteration):
        found = next(one.attrib for one in ElementTree.fromstring(text).iter() if one.tag.endswith("Pixels"))
        lengths = [(axis.lower(), f"PhysicalSize{axis}", "um", MILLIMETRES) for axis in "XYZ"]
        for key, name, usual, units in (*lengths, ("finterval", "TimeIncrement", "s", _SECONDS)):
            with contextlib.suppress(KeyError, ValueError):
                known = float(found[name]) * units[found.get(f"{name}Unit", usual).lower()]
                if 0 < known < np.inf:
                    numbers[key] = known
    return numbers


def _spacing(image: Any, numbers: dict[str, float]) -> tuple[float, float, float]:
    """Return the spacing in millimetres; 1 if the file has none: dots per inch are not a spacing."""
    if "x" in numbers and "y" in numbers:
        return numbers["x"], numbers["y"], numbers.get("z", numbers["x"])
    if "unit" not in numbers:
        return 1.0, 1.0, 1.0
    unit = numbers["unit"]
    # libvips' resolution is in pixels per millimetre if the file has a unit
    across = 1.0 if image.get_typeof("resolution-unit") else unit
    x, y = (across / res if res > 0 else 1.0 for res in (image.xres, image.yres))
    return x, y, abs(numbers.get("spacing", 0.0) or 1.0) * unit


def check(path: PathLike, like: Volume, dtype: np.dtype[Any]) -> None:
    """Raise SuppleError for a volume that the format cannot hold."""
    from supple.media.image.formats import DTYPES
    from supple.media.pictures import TIFF

    if like.geometry.shear:
        what = f"a TIFF holds a spacing alone, and the axes of {like.name} are not at right angles to each other"
        raise unwritable(path, what, "write NIfTI or NRRD")
    if dtype.name not in {np.dtype(known).name for known in DTYPES.values()} - {"float64"}:
        advice = "write NIfTI or NRRD, or convert to float32 first"
        raise unwritable(path, f"a TIFF of slices holds no {dtype} values, as ImageJ reads none", advice)
    width, height, _ = like.sizes
    colours = like.components if like.components > 1 and _are_colours(like, dtype) else 1
    pages = math.prod(like.samples.shape) // (width * height * colours)
    if max(width, height * pages) > TIFF.limit:
        what = f"TIFF ends at {TIFF.limit} rows, and the volume has {height} in each of {pages} pages"
        raise unwritable(path, what, "write NIfTI or NRRD")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a page for each slice, of each channel and time; origin and direction are lost.

    Axes and spacing are stored as by ImageJ, or, in an ``.ome.tif``, as OME-TIFF.
    """
    import pyvips

    from supple.media.image.formats import meant, settings, wrapped
    from supple.media.image.vips import apart, writing
    from supple.media.pictures import TIFF

    array = native(samples if like.series else samples[None])
    if array.ndim == 5 and not _are_colours(like, array.dtype):
        array = np.ascontiguousarray(np.moveaxis(array, -1, 2))
    else:
        array = array[:, :, None]
    times, depth, channels, height, width = array.shape[:5]
    tall = array.reshape(-1, width, *array.shape[5:])
    x, y, z = (step / 10 for step in like.geometry.spacing)  # TIFF's unit is the centimetre
    image = wrapped(tall, meant(array.dtype, tall.shape[2] if tall.ndim == 3 else 1, ""), 32)
    if Path(Path(path).stem).suffix.lower() == ".ome":
        tifffile = needed("volume", "OME-TIFF", "tifffile")
        sizes = {f"PhysicalSize{axis}": step for axis, step in zip("XYZ", like.geometry.spacing, strict=True)}
        units = {f"{name}Unit": "mm" for name in sizes}
        pace = {"TimeIncrement": like.interval} if like.series else {}
        made = tifffile.OmeXml()
        pixels = (len(tall) // height, 1, 1, height, width, tall.shape[2] if tall.ndim == 3 else 1)
        made.addimage(array.dtype, array.shape, pixels, axes="TZCYXS"[: array.ndim], **sizes, **units, **pace)
        text = made.tostring()
    else:
        counts = {"images": len(tall) // height, "channels": channels, "slices": depth, "frames": times}
        lines = [f"{name}={number}" for name, number in counts.items() if number > 1 or name in ("images", "slices")]
        lines += ["hyperstack=true"] if channels > 1 or times > 1 else []
        lines += ["mode=grayscale"] if channels > 1 else []
        lines += [f"finterval={like.interval!r}"] if like.series else []
        text = "\n".join(("ImageJ=1.54f", *lines, "unit=cm", f"spacing={z!r}", "loop=false", ""))
    image.set_type(pyvips.GValue.gstr_type, "image-description", text)
    options = settings(TIFF, array, 32, None, True)
    options |= {"page_height": height, "resunit": "cm", "xres": 0.1 / x, "yres": 0.1 / y}
    with replacing(path, force=force) as temporary, writing(path):
        apart(lambda: image.tiffsave(os.fsencode(temporary), **options), image)


def _are_colours(like: Volume, dtype: np.dtype[Any]) -> bool:
    """Return whether components are the colours of each page; otherwise, each component has pages of its own."""
    return like.components in (3, 4) and dtype.str[1:] in ("u1", "u2") and like.header != _CHANNELS
