"""Image files: PNG, JPEG, TIFF, OpenEXR and others, with their depth, alpha and headers."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvips

from supple._core import threads
from supple.errors import GapWarning, LayerWarning, SuppleError, argument, shown, warn
from supple.media import pictures
from supple.media.files import PathLike, check_suffix, replacing, unwritable
from supple.media.image import dpx, exif, formats
from supple.media.image.headers import NO_EXIF, collected, dressed, extra_of, facts, finish, profile_name
from supple.media.image.tiff import MASK, Page, Tiff, parts, swapped, tagged
from supple.media.image.vips import (
    apart,
    decoded,
    of_exr,
    of_tiff,
    opened,
    reading,
    sequential,
    together,
    widen,
    writing,
)

if TYPE_CHECKING:
    from supple.media.image import exr


_BESIDE = {"exif-data": "EXIF", "xmp-data": "XMP", "iptc-data": "IPTC"}
_SEVERAL = {
    "TIFF": "pages, and only one is read: all are kept if they are of one size and type, and the output is a TIFF",
    **dict.fromkeys(("PNG", "GIF", "WebP"), "frames, and only the first is read: name an animation or a video, "
                    "out.webp or out.mp4, to keep them all"),
}  # fmt: skip
"""The warning about files of several pages or frames, by their format."""


class ImageWarning(UserWarning):
    """A part of an image cannot be kept."""


class PageWarning(ImageWarning):
    """A file holds several pages or frames, and one is read."""


class DepthWarning(ImageWarning):
    """A format holds fewer bits than the pixels have; they are rounded."""


class MetadataWarning(ImageWarning):
    """A format cannot hold a part of the header."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image, upright, in the colour space of its file.

    Parameters
    ----------
    pixels : ndarray
        Shape (H, W) or (H, W, C), contiguous, in the file's own dtype.
    alpha : bool
        Whether the last channel is opacity, by which the colours are not multiplied.
    icc : bytes or None
        The colour profile.
    bits : int
        Bits a channel in the file; `pixels` may have room for more.
    format : str
        ``"PNG"``, ``"JPEG"``, ``"TIFF"``, ``"WebP"``, ``"AVIF"``, ``"GIF"``, ...
    interpretation : str
        The meaning of the channels, in libvips' terms: ``"b-w"``, ``"srgb"``, ``"rgb16"``, ``"cmyk"``, ...
    pages : int
        The number of pages of one size in `pixels`, one below the other.
    extra : tuple of int
        The meaning of each channel above the colours, as in a TIFF: 0 data, 1 opacity by which the colours are
        multiplied already, 2 opacity.
    """

    pixels: formats.Array
    alpha: bool = False
    icc: bytes | None = None
    bits: int = 8
    format: str = ""
    interpretation: str = ""
    pages: int = 1
    _header: Mapping[str, Any] = field(default_factory=dict, repr=False)
    extra: tuple[int, ...] = ()

    def warped(
        self,
        warp: Callable[[formats.Array, bool, list[int]], formats.Array],
        *,
        regridded: bool = False,
        averaged: bool = True,
        name: str = "",
    ) -> Picture:
        """Return a picture with new pixels, which ``warp`` computes from those of this one.

        ``warp(samples, opacity, channels)`` returns new samples. Those given have shape (H, W[, C]), or (pages, H, W[,
        C]) for several pages; ``opacity`` is true if the last channel is opacity, and ``channels`` are the indices in
        the picture. ``regridded`` means that the grid changes: a georeference is dropped, with a MetadataWarning. With
        ``averaged``, new samples are averages of several, and have no value where one of these has none (NaN, infinite,
        or marked as no data); a GapWarning reports it.
        """
        name, tiff, pixels = name or "the picture", self._header.get("tiff"), self.pixels
        if self.pages > 1:
            pixels = pixels.reshape(self.pages, -1, *pixels.shape[1:])
        real, nodata = pixels.dtype.kind == "f", tiff.nodata if averaged and tiff is not None else None
        with np.errstate(over="ignore"):
            gaps = pixels == nodata if nodata is not None else None
        if gaps is not None and (count := np.count_nonzero(gaps)):
            what = "their neighbours too, as far as the filter reaches" if real else "they are mixed with others"
            advice = "" if real else f": {argument('filter', 'nearest')} keeps them apart"
            text = f"{name}: {count} samples are marked as no data ({nodata:g}), and {what}{advice}"
            warn(text, GapWarning)
            pixels = np.where(gaps, np.nan, pixels).astype(pixels.dtype) if real else pixels
        if real and averaged and (count := pixels.size - np.count_nonzero(np.isfinite(self.pixels))):
            some = "1 sample is NaN or infinite" if count == 1 else f"{count} samples are NaN or infinite"
            text = f"{name}: {some}, and so are those that are computed from them"
            warn(text, GapWarning)
        extra = self.meanings
        channels = list(range(self.pixels.shape[2] if self.pixels.ndim == 3 else 1))
        if len(extra) > 1 and 2 in extra:  # opacity weights colours, but not channels of data
            colours = len(channels) - len(extra)
            seen = [*range(colours), colours + extra.index(2)]
            rest = [k for k in channels if k not in seen]
            first, second = warp(pixels[..., seen], True, seen), warp(pixels[..., rest], False, rest)
            made = np.empty((*first.shape[:-1], len(channels)), pixels.dtype)
            made[..., seen], made[..., rest] = first, second
        else:
            made = warp(pixels, extra == (2,), channels)
        if real and nodata is not None and gaps is not None and gaps.any():
            with np.errstate(over="ignore"):
                np.copyto(made, nodata, where=np.isnan(made))
        header = dict(self._header)
        if regridded and tiff is not None and tiff.has_place:
            header["tiff"] = tiff.without_place()
            text = f"{name}: its georeference is left out, as the grid is another one"
            warn(text, MetadataWarning)
        if self.pages > 1:
            made = made.reshape(-1, *made.shape[2:])
        return replace(self, pixels=made, _header=header)

    @property
    def meanings(self) -> tuple[int, ...]:
        """The value of `extra`, or the equivalent of `alpha` if that is empty."""
        return self.extra or ((2,) if self.alpha else ())

    @property
    def layers(self) -> exr.Exr | None:
        """The channels and the windows of an OpenEXR; None for other formats."""
        return self._header.get("exr")


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a name whose suffix is not in `supple.media.pictures.SUFFIXES_OUT`."""
    suffix = Path(path).suffix
    check_suffix(path, suffix, pictures.OUT, "is no image format", f"use {', '.join(pictures.OUT)}")


def check_options(
    path: PathLike, *, quality: int | None = None, lossless: bool = False, compression: str | None = None
) -> None:
    """Raise SuppleError for options of `write` that the format of a name does not have."""
    name, form = shown(path), pictures.OUT.get(Path(path).suffix.lower())
    if quality is not None and not 1 <= quality <= 100:
        raise SuppleError(f"cannot write {name} with quality {quality}: quality goes from 1 to 100")
    if lossless and form is pictures.JPEG:
        raise SuppleError(f"cannot write {name} without loss: JPEG always loses: write PNG, TIFF, WebP or AVIF")
    known = pictures.COMPRESSIONS.get(form.name, ()) if form is not None else ()
    if compression is not None and form is not None and compression not in known:
        names = f"choose from {', '.join(known)}" if known else "leave it out"
        raise unwritable(path, f"{argument('compression')} {compression} is none of {form.name}", names)


def read(path: PathLike, *, pages: bool = False, whole: bool = False) -> Picture:
    """Read an image, upright: an orientation in its header is applied.

    With ``pages``, all pages of a TIFF are read, if they are of one size and type. An OpenEXR is read as its display
    window shows it; with ``whole``, over the box around all its windows, with all its channels for `write`.

    Colours are not converted. A palette becomes RGB or RGBA; fewer than 8 bits become 8; 10 or 12 bits become
    16, with white at 65535. White is the largest value, even if a TIFF stores it as 0; in Lab of integers, a* and
    b* are 0 in the middle of the range.

    Returns
    -------
    Picture
        `pixels` of shape (H, W) or (H, W, C) in uint8, uint16, float32 or another type of TIFF.

    Raises
    ------
    SuppleError
        If the file is missing, empty, cut short, damaged, or not an image.

    Warns
    -----
    PageWarning
        The file holds several pages or frames.
    MetadataWarning
        The file has damaged EXIF or any IPTC in a TIFF, or a gain map for HDR in a JPEG.
    """
    if formats.is_exr(path):
        from supple.media.image import exr

        layers = exr.read(path)
        return of_layers(layers if whole else layers.alone())
    image, form = opened(path)
    name = shown(path)
    count, orientation, bits = facts(image)
    tall = _all_pages(path, count) if pages and count > 1 and form == "TIFF" else None
    if count > 1 and tall is None:
        what = _SEVERAL.get(form, "pages or frames, and only one of them is read")
        warn(f"{name} holds {count} {what}", PageWarning)
    with reading(path):
        pixels = tall if tall is not None else _decoded(path, image, form, orientation)
        header, lost = collected(path, image, form, orientation >= 5)
    if lost:
        warn(f"{name}: {' and '.join(lost)} cannot be carried over", MetadataWarning)
    if form in ("AVIF", "HEIF") and 8 < bits < 16:
        widen(pixels, bits)
    icc = header.pop("icc-profile-data", None)
    held = count if tall is not None else 1
    extra = extra_of(image)
    return Picture(pixels, extra[-1:] == (2,), icc, bits, form, image.interpretation, held, header, extra)


def with_opacity(picture: Picture, target: PathLike) -> Picture:
    """Return a picture with full opacity, if it has none and the format of the target can hold it; else as it is."""
    form, pixels = pictures.OUT[Path(target).suffix.lower()], np.atleast_3d(picture.pixels)
    held, count = form.pixel_formats.get(pixels.dtype.str[1:], (2, 4)), pixels.shape[2]
    is_opaque = count == formats.COLOURS.get(picture.interpretation, 3) and not picture.layers
    if not (form.alpha and is_opaque and count + 1 in held):
        return picture
    opacity = np.full((*pixels.shape[:2], 1), formats.white_of(pixels.dtype), pixels.dtype)
    return replace(picture, pixels=np.concatenate([pixels, opacity], axis=2), alpha=True, extra=(2,))


def warn_of_exact(held: exr.Exr) -> None:
    """Warn of the channels of an OpenEXR that are not filtered."""
    if held.exact:
        text = f"channels take the nearest pixel's values where averages would mean nothing: {held.exact}"
        warn(text, LayerWarning)


def of_layers(held: exr.Exr) -> Picture:
    """Return an OpenEXR as a picture; its header holds the layers, which `write` keeps."""
    pixels, image = held.arrays[0], of_exr(held)
    flat = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    return Picture(
        flat, False, None, held.bits, pictures.EXR.name, image.interpretation, 1, {"exr": held}, extra_of(image)
    )


def _decoded(path: PathLike, image: Any, form: str, orientation: int) -> formats.Array:
    """Decode an image, a large TIFF by all threads; warn of a damaged JPEG, most of which may be usable."""
    if form == "TIFF" and orientation == 1 and (page := Page(path)).is_plain and (shares := page.shares(threads())):
        sources = map(pyvips.Source.new_from_memory, shares)
        images = together([partial(sequential, source, fail_on=page.fails_on) for source in sources], [])
        return np.concatenate(together([partial(decoded, each, 1) for each in images], images))
    if form != "JPEG":
        return apart(lambda: decoded(image, orientation), image)
    try:
        careful = apart(lambda: sequential(path, fail_on="warning"))
        return apart(lambda: decoded(careful, orientation), careful)
    except pyvips.Error as error:
        pixels = apart(lambda: decoded(image, orientation), image)
        said = next((line.strip() for line in error.detail.splitlines() if "JPEG" in line), "")
        why = f" ({said.partition('VipsJpeg: ')[2] or said})" if said else ""
        warn(f"{shown(path)} is damaged{why}: parts of it may be wrong", ImageWarning)
        return pixels


def _all_pages(path: PathLike, count: int) -> formats.Array | None:
    """Decode all pages of a TIFF into one array, one below the other; None if sizes, types or meanings differ."""
    tall: formats.Array | None = None
    kinds = set()
    with reading(path):
        for k in range(count):
            page = of_tiff(path, k)
            kinds.add((page.interpretation, extra_of(page), Page(path, k).photometric == MASK))
            pixels = apart(partial(decoded, page, facts(page)[1]), page)
            height = len(pixels)
            if tall is None:
                tall = np.empty((count * height, *pixels.shape[1:]), pixels.dtype)
            rows = tall[k * height : (k + 1) * height]
            alike = count * height == len(tall) and (rows.shape, rows.dtype) == (pixels.shape, pixels.dtype)
            if len(kinds) > 1 or not alike:
                return None
            rows[:] = pixels
    return tall


def info(path: PathLike) -> dict[str, object]:
    """Return the facts in the header of an image, without decoding the pixels.

    Returns
    -------
    dict
        ``width`` and ``height`` upright, ``channels``, ``dtype``, ``bits``, ``alpha``, ``format``,
        ``interpretation``, ``profile`` (the name of the colour profile, or None), ``orientation`` (1 to 8, as
        stored), ``pages`` and ``bytes``; of an OpenEXR, also ``layers`` (all channels), ``compression``,
        ``data_window`` and ``display_window`` (x, y, width, height).

    Raises
    ------
    SuppleError
        As in `read`, but damage in the pixels is not detected.
    """
    from supple.media.image import exr

    image, form = opened(path)
    pages, orientation, bits = facts(image)
    size = (image.height, image.width) if orientation >= 5 else (image.width, image.height)
    icc = image.get("icc-profile-data") if image.get_typeof("icc-profile-data") else b""
    return {
        "width": size[0],
        "height": size[1],
        "channels": image.bands,
        "dtype": str(np.dtype(formats.DTYPES[image.format])),
        "bits": bits,
        "alpha": 2 in extra_of(image),
        "format": form,
        "interpretation": image.interpretation,
        "profile": profile_name(icc),
        "orientation": orientation,
        "pages": pages,
        "bytes": os.stat(path).st_size,
        **(exr.info(path) if formats.is_exr(path) else {}),
    }


def write(
    path: PathLike,
    pixels: formats.Array | Picture,
    like: Picture | None = None,
    *,
    alpha: bool | None = None,
    quality: int | None = None,
    lossless: bool = False,
    compression: str | None = None,
    force: bool = False,
) -> None:
    """Write an image in the format of the suffix; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        One of `supple.media.pictures.SUFFIXES_OUT`.
    pixels : ndarray or Picture
        Shape (H, W) or (H, W, C): uint8, uint16, and for TIFF also floats and integers up to 32 bits. Contiguous arrays
        are not copied. A picture is its own ``like``, unless another is given.
    like : Picture, optional
        The source of profile, EXIF, XMP and resolution, and of the meaning of the channels and pages of `pixels`.
    alpha : bool, optional
        Whether the last channel is opacity. By default as in `like`; otherwise, two or four channels have it.
    quality : int, optional
        From 1 to 100; by default that of `like`, if it is a JPEG too, or 95; 90 for WebP and AVIF. Others have none.
        From a JPEG to a JPEG, 4:2:0 and progressive coding are kept as well.
    lossless : bool
        Whether to write without loss; PNG and TIFF always do, JPEG cannot. WebP does if `like` is one without loss.
    compression : str, optional
        One of `supple.media.pictures.COMPRESSIONS`: of TIFF and PNG a method or a level of deflate from 0 to 9;
        ``"fast"`` is the fastest. By default as in `like` for TIFF, or deflate.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    SuppleError
        If the format cannot hold these channels, this type or this size, or the file cannot be written.

    Warns
    -----
    ImageWarning
        The quality or the compression has no effect.
    DepthWarning
        16 bits are rounded to the 8 of JPEG and WebP or the 12 of AVIF.
    MetadataWarning
        IPTC outside a JPEG, EXIF that is damaged or too large, or a grey profile in a format without grey.
    """
    check_target(path)
    check_options(path, quality=quality, lossless=lossless, compression=compression)
    if isinstance(pixels, Picture):
        like, pixels = like or pixels, pixels.pixels
    name, form = shown(path), pictures.OUT[Path(path).suffix.lower()]
    array = np.ascontiguousarray(pixels, np.asarray(pixels).dtype.newbyteorder("="))
    channels, depth = array.shape[2] if array.ndim == 3 else 1, array.dtype.itemsize * 8
    like = like or Picture(array[:0], channels in (2, 4), bits=depth)
    same = like.pixels.shape[2:] == array.shape[2:]
    extra: tuple[int, ...] = (2,) if (channels in (2, 4) if alpha is None else alpha) else ()
    if alpha is None and same:
        extra = like.meanings
        if extra == (1,) and form not in (pictures.TIFF, pictures.EXR):
            array, extra = formats.divided(array), (2,)
    header, icc, alpha = dict(like._header), like.icc, 2 in extra
    layers: exr.Exr | None = header.pop("exr", None)
    head: bytes = header.pop("dpx", b"")
    known_as, saved = header.pop("saved", ("", {}))
    tiff: Tiff = header.pop("tiff", Tiff())
    moved = tiff.has_place and len(like.pixels) > 0 and like.pixels.shape[:2] != array.shape[:2]
    tiff = tiff.without_place() if moved else tiff
    known = like.interpretation if same else ""
    meaning = formats.meant(array.dtype, channels - (len(extra) if form is pictures.TIFF else alpha), known)
    lost = ["the georeference of another grid"] * moved
    if form is pictures.TIFF:
        if not extra and meaning == "multiband" and not tiff.is_inks:
            extra = (0,) * (channels - (3 if channels > 3 else 1))
        alike = same and like.pixels.dtype == array.dtype
        tiff = replace(tiff if alike else Tiff(tags=tiff.tags), extra=extra)
        meaning = formats.meant(array.dtype, channels - len(extra), known if tiff.is_saved else "")
        array = swapped(tiff, array)
        lost += [f"the compression by {tiff.unkept}, which becomes deflate"] * bool(tiff.unkept)
    else:
        lost += ["the georeference"] * tiff.has_place + ["the mark of samples without data"] * (tiff.nodata is not None)
    formats.check(path, form, array, meaning, extra)
    have = like.bits if like.pixels.dtype == array.dtype else depth
    bits = 10 if form is pictures.AVIF and 8 < have <= 10 else min(form.bits, depth)
    film = form is pictures.DPX and have in (10, 12) and channels == 3
    bits = have if film else bits
    if bits < have:
        text = f"{name}: {form.name} holds {bits} bits a channel, and the {have} of the pixels are rounded"
        warn(text, DepthWarning)
    if quality is not None and not form.quality:
        text = f"{name}: quality {quality} changes nothing in {form.name}: it is for JPEG, WebP and AVIF"
        warn(text, ImageWarning)
    image, sized = formats.wrapped(array, meaning, bits), False
    if layers is not None and (unkept := layers.lost(exr=form is pictures.EXR)):
        lost.append(f"{' and '.join(unkept)} of an OpenEXR")
    if head and form is not pictures.DPX:
        lost.append("the header of a DPX, with its transfer curve and timecode")
    if form.pixel_formats:
        lost += [what for key, what in _BESIDE.items() if key in header] + ["the colour profile"] * bool(icc)
    else:
        image, lacking, sized = dressed(image, header, icc, form, channels - alpha)
        lost += lacking
    if lost:
        text = f"{name}: {form.name} cannot take over {' and '.join(lost)}"
        warn(text, MetadataWarning)
    if form is pictures.EXR:
        if alpha:  # EXR is premultiplied
            array = np.concatenate([array[..., :3] * array[..., 3:], array[..., 3:]], axis=2)
        from supple.media.image import exr

        made = exr.with_pixels(layers if same else None, array.reshape(*array.shape[:2], -1), half=have == 16)
        with replacing(path, force=force) as temporary:
            exr.write(temporary, path, made)
        return
    if form.pixel_formats:
        from supple.media.image import ffmpeg

        if bits < depth:
            array = decoded(image, 1)
        kind = form.pixel_formats[array.dtype.str[1:]][channels]
        if film:
            array, kind = array >> (16 - bits), f"gbrp{bits}be"
        if dpx.order_of(head) == "<":
            kind = re.sub("be$", "le", kind)
        with replacing(path, force=force) as temporary, ffmpeg.writing(path):
            data = ffmpeg.encoded(array, form.saver, kind, form.options)
            temporary.write_bytes(dpx.dressed(data, head, path) if form is pictures.DPX else data)
        return
    options = formats.settings(form, array, bits, quality, lossless)
    if not image.get_typeof("exif-data") and not (sized and form in (pictures.WEBP, pictures.AVIF)):
        options["keep"] = NO_EXIF  # libvips would add EXIF; WebP and AVIF store a resolution only there
    if known_as == form.name:
        saved = saved if quality is None else {key: value for key, value in saved.items() if key == "interlace"}
        options |= saved
    if form is pictures.TIFF:
        options |= tiff.settings(lossless, array.dtype.itemsize)
        if like.pages > 1:
            options["page_height"] = len(array) // like.pages
    if compression is not None and form.lossless and not options.get("lossless"):
        text = f"{name}: compression {compression} changes nothing in {form.name} with loss: it is for lossless files"
        warn(text, ImageWarning)
    options |= formats.compressed(form, array, compression, bool(options.get("lossless")))
    with replacing(path, force=force) as temporary, writing(path):
        if form is not pictures.TIFF:
            apart(lambda: getattr(image, form.saver)(os.fsencode(temporary), **options), image)
            finish(temporary, image, form, sized)
            return
        ends = parts(len(array), array.nbytes, threads(), options)
        images = [image.crop(0, a, image.width, b - a) for a, b in ends] if len(ends) > 1 else [image]
        added = exif.for_tiff(header.get("exif-data", b""), *array.shape[1::-1])
        with tempfile.TemporaryDirectory(prefix=".", dir=temporary.parent) as folder:
            names = [temporary, *(Path(folder, str(k)) for k in range(1, len(images)))]
            saves = zip(names, images, strict=True)
            together([partial(each.tiffsave, os.fsencode(name), **options) for name, each in saves], images)
            tagged(temporary, tiff, added, sized, names[1:])
