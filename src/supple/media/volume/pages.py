"""Stacks of TIFF pages, by libvips, with the spacing in ImageJ's form."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from supple.errors import SuppleError, shown
from supple.geometry import Geometry
from supple.media.files import PathLike, replacing, unreadable, unwritable
from supple.media.volume.data import Array, Volume, native

SUFFIXES = (".tif", ".tiff")
MILLIMETRES = {
    **dict.fromkeys(("m", "meter", "metre"), 1000.0),
    **dict.fromkeys(("cm", "centimeter"), 10.0),
    **dict.fromkeys(("mm", "millimeter"), 1.0),
    **dict.fromkeys(("um", "micron", r"\u00b5m", "\u00b5m", "\u03bcm", "micrometer"), 1e-3),
    **dict.fromkeys(("nm", "nanometer"), 1e-6),
    **dict.fromkeys(("inch", "in"), 25.4),
}
"""By the names of units, in lower case."""


def has_pages(path: PathLike) -> bool:
    """Return whether a file is a TIFF of several pages; False for unreadable files."""
    from supple.media.image.headers import facts
    from supple.media.image.vips import opened

    if Path(path).suffix.lower() not in SUFFIXES:
        return False
    try:
        image, form = opened(path)
    except SuppleError:
        return False
    return form == "TIFF" and facts(image)[0] > 1


def place(path: PathLike) -> Geometry:
    """Return the spacing of a stack, from the description of ImageJ or OME-TIFF; errors as in `read`."""
    from supple.media.image.vips import opened

    image, _ = opened(path)
    return Geometry(_spacing(image, _description(image)))


def read(path: PathLike) -> Volume:
    """Read all pages of a TIFF: a slice each, or as in ImageJ's description, which also has the spacing.

    SuppleError if it is not a TIFF, damaged, or its pages differ.
    """
    import pyvips

    from supple.media.image.headers import facts
    from supple.media.image.tiff import Page
    from supple.media.image.vips import apart, decoded, opened, reading

    image, form = opened(path)
    if form != "TIFF":
        raise unreadable(path, f"it is no TIFF, but {form}", "check its name")
    pages = facts(image)[0]
    with reading(path):
        if linked(path) != pages:
            raise unreadable(path, f"it is cut short: {pages} of its pages are whole")
        source = pyvips.Source.new_from_file(os.fsencode(path))
        # of damaged tiles, libvips only warns
        options = {"access": "sequential", "fail_on": "warning" if Page(path).tiled else "error"}
        tall = apart(lambda: pyvips.Image.new_from_source(source, "", n=-1, **options))
        samples = apart(lambda: decoded(tall, 1), tall)
    told = _description(image)
    samples = samples.reshape(pages, -1, *samples.shape[1:])
    times, channels = (max(1, int(told.get(key, 1))) for key in ("frames", "channels"))
    if (promised := told.get("images", pages)) != pages:
        raise unreadable(path, f"it is said to hold {promised:g} images, and has {pages} pages")
    if pages % (times * channels) or (times > 1) + (channels > 1) + (samples.ndim - 3) > 1:
        what = f"it holds {pages} pages of {times} times and {channels} channels"
        raise unreadable(path, what, "give either times or channels")
    if times > 1:
        samples = samples.reshape(times, pages // times, *samples.shape[1:])
    elif channels > 1:  # components are ImageJ's fastest axis
        samples = np.moveaxis(samples.reshape(pages // channels, channels, *samples.shape[1:]), 1, -1)
    interval = told.get("finterval", 0.0)
    return Volume(
        native(samples),
        Geometry(_spacing(image, told)),
        shown(path),
        "TIFF",
        times > 1,
        interval=interval if 0 < interval < np.inf else 1.0,
    )


# Kept: libvips takes a file that ends between two pages for whole (test_a_stack_that_ends_between_two_pages).
def linked(path: PathLike) -> int | None:
    """Return the number of linked pages, or None if the last link leads out of the file."""
    with open(path, "rb") as file:
        head = file.read(16)
        order: Literal["little", "big"] = "big" if head.startswith(b"MM") else "little"
        large = 43 in head[2:4]
        word, count, entry = (8, 8, 20) if large else (4, 2, 12)
        at, known = int.from_bytes(head[word : 2 * word], order), set[int]()
        while at and at not in known:
            known.add(at)
            file.seek(at)
            file.seek(at + count + entry * int.from_bytes(file.read(count), order))
            following = file.read(word)
            if len(following) < word:
                return None
            at = int.from_bytes(following, order)
        return len(known)


def _description(image: Any) -> dict[str, float]:
    """Return the numbers of ImageJ's description, and the millimetres of its unit."""
    text = image.get("image-description") if image.get_typeof("image-description") else ""
    if not text.startswith("ImageJ="):
        return {}
    pairs = dict(line.strip().partition("=")[::2] for line in text.splitlines())
    told = {"unit": MILLIMETRES.get(pairs.pop("unit", "").lower(), 1.0)}
    for key, value in pairs.items():
        with contextlib.suppress(ValueError):
            if np.isfinite(number := float(value)):
                told[key] = number
    return told


def _spacing(image: Any, told: dict[str, float]) -> tuple[float, float, float]:
    """Return the spacing in millimetres; 1 if the file has none: dots per inch are not a spacing."""
    if (known := _of_ome(image)) is not None:
        return known
    if not told:
        return 1.0, 1.0, 1.0
    unit = told["unit"]
    # pixels per millimetre in libvips, if the file has a unit
    across = 1.0 if image.get_typeof("resolution-unit") else unit
    x, y = (across / res if res > 0 else 1.0 for res in (image.xres, image.yres))
    z = abs(told.get("spacing", 0.0)) * unit
    return x, y, z or 1.0


def _of_ome(image: Any) -> tuple[float, float, float] | None:
    """Return the spacing in the description of an OME-TIFF, if it has all of it."""
    text = image.get("image-description") if image.get_typeof("image-description") else ""
    if "<OME" not in text[:1000]:
        return None
    with contextlib.suppress(ElementTree.ParseError, KeyError, ValueError, StopIteration):
        found = next(one.attrib for one in ElementTree.fromstring(text).iter() if one.tag.endswith("Pixels"))
        x, y, z = (
            float(found[f"PhysicalSize{axis}"]) * MILLIMETRES[found.get(f"PhysicalSize{axis}Unit", "um").lower()]
            for axis in "XYZ"
        )
        if all(0 < step < np.inf for step in (x, y, z)):
            return x, y, z
    return None


def check(path: PathLike, like: Volume, dtype: np.dtype[Any]) -> None:
    """Raise SuppleError for a volume that the format cannot hold."""
    from supple.media.image.formats import DTYPES, TIFF

    if like.geometry.shear:
        what = f"a TIFF holds a spacing alone, and the axes of {like.name} are not at right angles to each other"
        raise unwritable(path, what, "write NIfTI or NRRD")
    if like.series:
        raise unwritable(path, "a TIFF holds one volume, and this is a series", "write NIfTI or NRRD")
    if dtype.name not in {np.dtype(known).name for known in DTYPES.values()} - {"float64"}:
        advice = "write NIfTI or NRRD, or convert to float32 first"
        raise unwritable(path, f"a TIFF of slices holds no {dtype} values, as ImageJ reads none", advice)
    width, height, depth = like.sizes
    if max(width, height * depth) > TIFF.limit:
        what = f"TIFF ends at {TIFF.limit} rows, and the volume has {height} in each of {depth} slices"
        raise unwritable(path, what, "write NIfTI or NRRD")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a page for each slice; the spacing is stored in ImageJ's form, origin and direction are lost."""
    import pyvips

    from supple.media.image.formats import TIFF, meant, settings, wrapped
    from supple.media.image.vips import apart, writing

    array = native(samples)
    depth, height, width = array.shape[:3]
    tall = array.reshape(depth * height, width, *array.shape[3:])
    channels = tall.shape[2] if tall.ndim == 3 else 1
    x, y, z = (step / 10 for step in like.geometry.spacing)  # TIFF's unit is the centimetre
    lines = ("ImageJ=1.54f", f"images={depth}", f"slices={depth}", "unit=cm", f"spacing={z!r}", "loop=false", "")
    image = wrapped(tall, meant(array.dtype, channels, ""), 32)
    image.set_type(pyvips.GValue.gstr_type, "image-description", "\n".join(lines))
    options = settings(TIFF, array, 32, None, True)
    options |= {"page_height": height, "resunit": "cm", "xres": 0.1 / x, "yres": 0.1 / y}
    with replacing(path, force=force) as temporary, writing(path):
        apart(lambda: image.tiffsave(os.fsencode(temporary), **options), image)
