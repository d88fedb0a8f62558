"""Tags of a TIFF that describe its samples and that libvips misreads or ignores, and tags that it does not write."""

from __future__ import annotations

import itertools
import mmap
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np

from supple.errors import needed, said
from supple.media.files import PathLike, refusing, unreadable
from supple.media.image.exif import Folder, Reader, Value, into_tiff
from supple.media.image.formats import Array, damaged

_BITS, _COMPRESSION, _PHOTOMETRIC, _SAMPLES, _PLANAR = 258, 259, 262, 277, 284
_ROWS, _PREDICTOR, _TILE_WIDTH, _TILE_HEIGHT, _INKS, _EXTRA, _FORMAT = 278, 317, 322, 323, 332, 338, 339
_UNIT, _WIDTH, _LENGTH, _OFFSETS, _COUNTS = 296, 256, 257, (273, 324), (279, 325)
_LEAST, _MOST, _AT_ONCE = 1 << 24, 2_000_000_000, 8  # bytes of a picture that is compressed in parts, and these
MINISWHITE, RGB, YCBCR, CIELAB, ICCLAB, ITULAB = 0, 2, 6, 8, 9, 10
MASK, _MOSAIC = 4, 32803
# the number of colours by photometric interpretation; others have three, inks any number
_COLOURS = dict.fromkeys((0, 1, 3, MASK, _MOSAIC), 1)
_UNSAVED = (MINISWHITE, CIELAB, ICCLAB, ITULAB)
_MEANINGS = {5: "cmyk", CIELAB: "lab", ICCLAB: "lab", ITULAB: "lab"}
_JPEGS = (6, 7)
_SAVED = {1: "none", 5: "lzw", 7: "jpeg", 8: "deflate", 32773: "packbits", 32946: "deflate", 50000: "zstd"}
_UNKEPT = {2: "CCITT", 3: "CCITT", 4: "CCITT", 6: "JPEG", 7: "JPEG", 34712: "JPEG 2000", 50001: "WebP"}
_PREDICTED = {"lzw", "deflate", "zstd"}
PLACE = (33550, 33920, 33922, 34264, 34735, 34736, 34737, 50844)
"""The tags of a georeference: of GeoTIFF, and of a camera's rational polynomials."""
_NODATA = 42113
_TAGS = (*PLACE, 42112, _NODATA, _INKS, 333, 334)  # and GDAL's metadata, and inks


@dataclass(frozen=True, slots=True)
class Tiff:
    """The tags of a page of a TIFF about its samples."""

    photometric: int = 1  # the meaning of the colours, by TIFF's code
    # of each channel above the colours: 0 data, 1 opacity by which the colours are multiplied, 2 opacity
    extra: tuple[int, ...] = ()
    meaning: str = ""  # the colours in libvips' terms; empty for grey and RGB
    options: dict[str, Any] = field(default_factory=dict)  # of libvips' saver, for compression and tiles
    tags: Folder = field(default_factory=dict)  # that libvips does not keep: georeference, NoData, inks
    unkept: str = ""  # the name of a compression in place of which deflate is used; empty if it is kept

    @property
    def has_place(self) -> bool:
        """True if there is a georeference, which holds for the grid of the file alone."""
        return any(tag in self.tags for tag in PLACE)

    @property
    def nodata(self) -> float | None:
        """The value of pixels without data; None without one."""
        value = self.tags.get(_NODATA)
        try:
            return float(value.data.rstrip(b"\0 ")) if isinstance(value, Value) else None
        except ValueError:
            return None

    @property
    def is_inks(self) -> bool:
        """True if the colours are inks other than CMYK."""
        return self.photometric == 5 and self.meaning != "cmyk"

    @property
    def is_saved(self) -> bool:
        """True if libvips saves such colours as they are."""
        return self.photometric not in _UNSAVED and not self.is_inks

    def settings(self, lossless: bool, size: int) -> dict[str, Any]:
        """Return the settings of libvips' saver for samples of a size in bytes."""
        chosen = dict(self.options)
        if chosen.get("compression") == "jpeg":
            chosen |= {"compression": "deflate"} if lossless or size > 1 else {"Q": 95}
        if size == 8:
            chosen.pop("predictor", None)
        return chosen

    def without_place(self) -> Tiff:
        """Return a copy without georeference."""
        return replace(self, tags={tag: value for tag, value in self.tags.items() if tag not in PLACE})


class Page:
    """A page of a TIFF, counted from 0, whose tags can be changed before libvips reads it; the file stays as it is."""

    def __init__(self, path: PathLike, number: int = 0) -> None:
        self._path, self._number = path, number
        with open(path, "rb") as file:
            reader = Reader(file)
            self._form, at = reader.form, reader.first
            for _ in range(number):
                at = self._form.number(reader.entries(at)[1])
            form, entries = self._form, reader.entries(at)[0]
            self._entries: dict[int, int] = {}  # offsets in the file
            self._values: dict[int, Value] = {}
            self._integers: dict[int, int] = {}
            for k, entry in enumerate(entries):
                tag = form.number(entry[:2])
                if self._entries.setdefault(tag, place := at + form.count + form.step * k) != place:
                    continue  # of duplicate tags, the first counts
                self._integers[tag] = reader.integer(entry)
                if tag in (_BITS, _EXTRA, _FORMAT, *_TAGS) and (value := reader.value(entry)) is not None:
                    self._values[tag] = value
        bits, kinds = self._numbers(_BITS) or (1,), self._numbers(_FORMAT) or (1,)
        self.bits, self._kind = (bits[0], kinds[0]) if len({*bits}) == len({*kinds}) == 1 else (0, 0)
        self._kind = 1 if self._kind == 4 else self._kind  # unknown ones are taken for integers
        self.samples = self._one(_SAMPLES) or 1
        self.planes = self.samples if self._one(_PLANAR) == 2 else 1
        self._compression, self.photometric = self._one(_COMPRESSION) or 1, self._one(_PHOTOMETRIC)
        self.tiled = _TILE_WIDTH in self._entries
        self.fails_on = "warning" if self.tiled else "error"  # libvips only warns of damaged tiles
        self.tiff = self._facts()

    def _numbers(self, tag: int) -> tuple[int, ...]:
        return tuple(self._values[tag].integers) if tag in self._values else ()

    def _one(self, tag: int) -> int:
        """Return an integer in a tag; 0 if it is missing."""
        return self._integers.get(tag, 0)

    def _facts(self) -> Tiff:
        inks = self.photometric == 5
        multi = inks and (self._one(_INKS) == 2 or self.samples < 4)
        extra = self._numbers(_EXTRA)[: self.samples - 1]
        colours = _COLOURS.get(self.photometric, 3)
        if inks:
            colours = self.samples - len(extra) if multi else 4
        colours = min(colours, self.samples)
        extra = (extra + (0,) * self.samples)[: self.samples - colours]  # channels without a description are data
        meaning = "multiband" if multi else _MEANINGS.get(self.photometric, "")
        saved = _SAVED.get(self._compression, "deflate")
        if saved == "jpeg" and (extra or multi or self.bits != 8 or self.photometric not in (1, RGB, YCBCR)):
            saved = "deflate"  # libvips would write fewer channels
        is_kept = saved == _SAVED.get(self._compression)
        options: dict[str, Any] = {"compression": saved}
        if is_kept and saved in _PREDICTED:
            options["predictor"] = {2: "horizontal", 3: "float"}.get(self._one(_PREDICTOR), "none")
        if self.tiled:
            options |= {"tile": True, "tile_width": self._one(_TILE_WIDTH), "tile_height": self._one(_TILE_HEIGHT)}
        if self._form.big:
            options["bigtiff"] = True
        tags: Folder = {tag: self._values[tag] for tag in _TAGS if tag in self._values}
        unkept = "" if is_kept else _UNKEPT.get(self._compression, f"method {self._compression}")
        return Tiff(self.photometric, extra, meaning, options, tags, unkept)

    @property
    def is_ycbcr(self) -> bool:
        """True if it is in YCbCr, which libvips takes for RGB unless it is compressed as JPEG."""
        return self.photometric == YCBCR and self._compression not in _JPEGS and self.planes == 1

    @property
    def is_plain(self) -> bool:
        """True if libvips reads the samples as they are, and knows what they are."""
        inverted = self.photometric == MINISWHITE and self.samples > 1
        lab = self.photometric in (CIELAB, ICCLAB, ITULAB) and self._kind != 3
        odd = inverted or lab or self.photometric in (MASK, _MOSAIC)
        return self.is_usual and 1 not in self.tiff.extra and not odd

    @property
    def is_usual(self) -> bool:
        """True if libvips reads the samples correctly once the page is tagged as grey or RGB."""
        usual = self.bits in (8, 16, 32) or (self.bits in (1, 2, 4) and self.samples == 1)
        return usual and self.planes == 1

    def retagged(self) -> mmap.mmap:
        """Return the file in memory, with the page tagged as grey or RGB without opacity, or as one sample of 8 bits.

        SuppleError for samples that are not supported.
        """
        depths = {1: range(1, 33), 2: (8, 16, 32), 3: (8, 16, 32, 64)}
        if self.bits not in depths.get(self._kind, ()):
            self._refuse("its samples are of different types or odd depths, complex, or integers of 64 bits")
        if self.photometric == _MOSAIC:
            self._refuse("it is a mosaic of colours, from a camera's sensor")
        if self.planes > 1 and self.photometric == YCBCR:
            self._refuse("it holds YCbCr in separate planes")
        data, form = self._mapped(), self._form
        values = {_PHOTOMETRIC: RGB if self.samples > 2 else 1}
        if not self.is_usual:
            values = {_PHOTOMETRIC: 1, _PLANAR: 1, _SAMPLES: 1, _BITS: 8, _FORMAT: 1, _PREDICTOR: 1}
        for tag in values.keys() & self._entries.keys():
            self._set(data, tag, values[tag])
        if _EXTRA in self._entries:  # renamed to the tag before it: libtiff ignores duplicates
            at = self._entries[_EXTRA]
            data[at : at + 2] = form.stored(max(tag for tag in self._entries if tag < _EXTRA), 2)
        return data

    def shares(self, count: int) -> list[mmap.mmap]:
        """Return the file in memory for each share of the page's rows, tagged as those alone, to be decoded at once.

        There is none if the page is small or not compressed, or its strips or tiles are not stored one after the other.
        """
        form, height, step = self._form, self._one(_LENGTH), self._one(_TILE_HEIGHT) or self._one(_ROWS)
        across = -(-self._one(_WIDTH) // max(self._one(_TILE_WIDTH), 1)) if self.tiled else 1
        rows = -(-height // max(step, 1))  # of strips or tiles
        small = height * self._one(_WIDTH) * self.samples * self.bits < 8 * _LEAST or rows < 8 * count
        if small or self._compression == 1 or self.planes > 1:
            return []
        made = [self._mapped() for _ in range(count)]
        places = [self._entries[tag] for tag in (*_OFFSETS, *_COUNTS) if tag in self._entries]
        entries = [made[0][at + 2 : at + form.step] for at in places]
        if [form.number(entry[2 : -form.word]) for entry in entries] != [rows * across] * 2:
            return []
        for k, data in enumerate(made):
            first, end = k * rows // count, (k + 1) * rows // count
            for at, entry in zip(places, entries, strict=True):
                size = {3: 2, 4: 4}.get(form.number(entry[:2]), 8)
                numbers = (end - first) * across, form.number(entry[-form.word :]) + first * across * size
                data[at + 4 : at + form.step] = b"".join(form.stored(n, form.word) for n in numbers)
            self._set(data, _LENGTH, min(end * step, height) - first * step)
        return made

    def _mapped(self) -> mmap.mmap:
        """Return the file in memory, which can be changed without changing the file."""
        with open(self._path, "rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)

    def _set(self, data: mmap.mmap, tag: int, number: int) -> None:
        form, at = self._form, self._entries[tag]
        entry = form.stored(tag, 2) + form.stored(4, 2) + form.stored(1, form.word) + form.stored(number, 4)
        data[at : at + form.step] = entry.ljust(form.step, b"\0")

    def decoded(self, read: Callable[[], Array]) -> Array:
        """Return all samples, of shape (H, W) or (H, W, C), in grey, RGB, CMYK or Lab.

        In Lab of integers, a* and b* are 0 in the middle of the range, as in ICC's encoding. ``read`` decodes what
        `retagged` returns by libvips, if the samples are usual; others are decoded by tifffile.
        """
        return swapped(self.tiff, read() if self.is_usual else self._by_tifffile())

    def _refuse(self, what: str) -> NoReturn:
        what = f"it is of a kind that is not supported ({what})"
        raise unreadable(self._path, what, "convert it, to PNG for instance")

    def _by_tifffile(self) -> Array:
        tifffile = needed("volume", "TIFFs of planes, of odd depths or of 64 bits", "tifffile")
        with refusing(lambda error: damaged(self._path, said(error)), Exception), tifffile.TiffFile(self._path) as file:
            page = file.pages[self._number]
            pixels = np.asarray(page.asarray())
        pixels = pixels.view(np.uint8) if pixels.dtype == bool else pixels
        pixels = np.moveaxis(pixels, 0, -1) if self.planes > 1 else pixels
        pixels = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("="))
        depth = pixels.dtype.itemsize * 8
        if pixels.dtype.kind == "u" and self.bits < depth:  # so that white is the largest value
            pixels = pixels << (depth - self.bits)
            for step in (self.bits, 2 * self.bits, 4 * self.bits):
                pixels |= pixels >> step if step < depth else 0
        return pixels


def swapped(tiff: Tiff, pixels: Array) -> Array:
    """Convert stored samples to those of a `Picture`, or back: white is the largest value, a* and b* are offset."""
    if pixels.dtype.kind == "u" and tiff.photometric in (MINISWHITE, CIELAB):
        pixels = pixels.copy()
        if tiff.photometric == CIELAB:
            pixels[..., 1:3] ^= pixels.dtype.type(1 << pixels.dtype.itemsize * 8 - 1)
        else:
            grey = pixels[..., 0] if pixels.ndim == 3 else pixels
            grey ^= np.iinfo(pixels.dtype).max
    return pixels


def parts(height: int, size: int, threads: int, options: dict[str, Any]) -> list[tuple[int, int]]:
    """Return the first and the last row, exclusive, of parts that are compressed at once; one part if that is all."""
    step = options.get("tile_height", 128)  # libvips compresses so many rows together
    count = -(-height // step)
    able = _LEAST < size < _MOST and "page_height" not in options and not options.get("bigtiff")
    some = min(threads, count, _AT_ONCE) if able else 1
    ends = [min(k * count // some * step, height) for k in range(some + 1)]
    return list(itertools.pairwise(ends))


def _appended(path: PathLike, parts: Sequence[PathLike]) -> Folder:
    """Append TIFFs of further rows to a file; return the tags that make all one page."""
    numbers, base = dict[int, list[int]](), 0
    for part in (path, *parts):
        with open(part, "rb") as held:
            reader = Reader(held)
            reader.room = reader.size  # of a file of ours, which may have millions of tiles
            for entry in reader.entries(reader.first)[0]:
                tag = reader.form.number(entry[:2])
                if tag in (_LENGTH, *_OFFSETS, *_COUNTS):
                    value = reader.value(entry)
                    assert value is not None
                    numbers.setdefault(tag, []).extend(n + base * (tag in _OFFSETS) for n in value.integers)
            base += reader.size
    with open(path, "ab") as file:
        for part in parts:
            with open(part, "rb") as held:
                shutil.copyfileobj(held, file)
            os.unlink(part)  # the disk may have no room for both
    numbers[_LENGTH] = [sum(numbers[_LENGTH])]
    return {tag: Value(4, np.array(some, "<u4").tobytes()) for tag, some in numbers.items()}


def tagged(path: PathLike, tiff: Tiff, added: Folder, sized: bool, parts: Sequence[PathLike] = ()) -> None:
    """Write the tags that libvips does not, in all pages of a TIFF, and correct those that it makes up.

    ``parts`` are TIFFs of further rows, which become part of the page.
    """
    changed = tiff.tags | (_appended(path, parts) if parts else {})
    if not tiff.is_saved:
        changed[_PHOTOMETRIC] = _shorts(tiff.photometric)
    if tiff.extra:
        changed[_EXTRA] = _shorts(*tiff.extra)
    if not sized:
        changed[_UNIT] = _shorts(1)  # no unit: without the tag, readers assume inches
    into_tiff(path, added, changed, () if tiff.extra else (_EXTRA,))


def _shorts(*numbers: int) -> Value:
    return Value(3, np.array(numbers, "<u2").tobytes())
