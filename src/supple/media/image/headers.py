"""Metadata in the headers of images, and its transfer between files."""

from __future__ import annotations

import contextlib
import re
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import pyvips

from supple.media.files import PathLike
from supple.media.image import exif
from supple.media.image.formats import COLOURS, DTYPES
from supple.media.image.tiff import Page
from supple.media.pictures import JPEG, PNG, TIFF, Format

_ICC_COLOURS = {b"GRAY": 1, b"RGB ": 3, b"Lab ": 3, b"CMYK": 4}
_KEPT = ("dpx", "icc-profile-data", "exif-data", "xmp-data", "iptc-data", "image-description", "png-comment-")
EXTRA = "supple-extra"
"""The field of an image that has the meanings of the channels above its colours, as `tiff.Tiff.extra`."""
_THUMBNAIL = ("exif-ifd1-", "jpeg-thumbnail-data")
NO_EXIF = 62  # all other flags of libvips for the parts of a header
_UNKNOWN = 0.1  # a pixel a centimetre, which `finish` removes
_HEAD = 1 << 20  # bytes at the beginning of a file that are searched
_EXIF_MOST = 65_000  # libvips reads no more than fits into a JPEG, and adds a few tags
# Previews in metadata show the old pixels: they are removed, wherever they are.
_SIGNS = re.compile(rb"\xff\xd8\xff|\xff\xd9")  # where a JPEG begins, and where one ends
_PLACES = rb"(?:\w+:Thumbnails|(?:Container|GContainer|GDepth|GImage|hdrgm|HDRGainMap):\w+|xmpNote:HasExtendedXMP)"
# elements, attributes, and any picture in base64: JPEG, PNG, GIF, WebP, TIFF, AVIF and HEIF
_IN_XMP = (
    rb"(?s)<(" + _PLACES + rb")\b(?:[^<>]*/>|.*?</\1\s*>)",
    rb"(?s)\s" + _PLACES + rb"\s*=\s*(?:\"[^\"]*\"|'[^']*')",
    rb"\sdcterms:provenance\s*=\s*\"[^\"]*(?:c2pa|jumbf)[^\"]*\"",
    rb"(?:/9j/|iVBORw0KGgo|R0lGOD|UklGR|SUkq|TU0AK|AAAA\w\wZ0eX)[A-Za-z0-9+/=\s&#;]{64,}",
)


def saved_as(path: PathLike, image: Any, form: str) -> dict[str, Any]:
    """Return the settings of libvips' saver that a file was written with: quality, subsampling, interlacing, loss."""
    chosen: dict[str, Any] = {}
    if form in ("JPEG", "PNG") and image.get_typeof("interlaced"):
        chosen["interlace"] = True
    if form == "JPEG":
        with open(path, "rb") as file:
            head = file.read(_HEAD)
        # Only true 4:2:0 is kept: libvips reports 4:2:2 as 4:2:0, and cannot write it.
        if re.search(rb"\xff[\xc0-\xc2].{7}[\x03\x04]\x01\x22", head, re.DOTALL):
            chosen["subsample_mode"] = "on"
        steps = _quantization(head)
        if steps is not None:
            chosen["Q"] = 1 + int(np.abs(_all_steps() - steps).sum(axis=1).argmin())
    if form == "WebP":
        with open(path, "rb") as file:
            if re.search(rb"^RIFF....WEBP(VP8X.{14}(ICCP.{4})?.*?)?VP8L", file.read(_HEAD), re.DOTALL):
                chosen |= {"lossless": True, "exact": True}
    return chosen


def _quantization(data: bytes) -> Any:
    """Return the steps of a JPEG's luma, its first table; None if there is none."""
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] != b"\xda":
        if data[at + 1] == 0xDB and data[at + 4] & 15 == 0:
            kind = ">u2" if data[at + 4] >> 4 else "u1"
            found = np.frombuffer(data[at + 5 :][: 64 * np.dtype(kind).itemsize], kind).astype(int)
            return found if len(found) == 64 else None
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    return None


@lru_cache(maxsize=1)
def _all_steps() -> Any:
    """Return the steps of JPEGs of each quality from 1 to 100, as libvips writes them, by libjpeg's formula."""
    quality, middle = np.arange(1, 101)[:, None], _quantization(pyvips.Image.black(8, 8).jpegsave_buffer(Q=50))
    percent = np.where(quality < 50, 5000 // quality, 200 - 2 * quality)
    return np.clip((middle * percent + 50) // 100, 1, 255)


def facts(image: Any) -> tuple[int, int, int]:
    """Return the number of pages of a file, its orientation (1 to 8), and its bits a channel."""
    names = ("n-pages", "orientation", "bits-per-sample")
    pages, orientation, bits = (image.get(name) if image.get_typeof(name) else 0 for name in names)
    depth = np.dtype(DTYPES[image.format]).itemsize * 8
    return max(1, pages), orientation if 1 <= orientation <= 8 else 1, bits or depth


def extra_of(image: Any) -> tuple[int, ...]:
    """Return the meanings of the channels above the colours, as `tiff.Tiff.extra`."""
    if image.get_typeof(EXTRA):
        return tuple(map(int, image.get(EXTRA).split()))
    colours = COLOURS.get(image.interpretation, 3)
    return (2,) if colours and image.bands == colours + 1 else ()


def collected(path: PathLike, image: Any, form: str, turned: bool) -> tuple[dict[str, Any], list[str]]:
    """Return the metadata for `dressed`, and the names of metadata that cannot be kept."""
    header: dict[str, Any] = {}
    for name in image.get_fields():
        if name.startswith(_KEPT) and (name != "iptc-data" or form == "JPEG"):
            with contextlib.suppress(UnicodeError):
                header[name] = image.get(name)
    if header.get("image-description", "").startswith(exif.SHAPED.decode()):
        del header["image-description"]
    if "xmp-data" in header:  # it may repeat the orientation
        pattern = rb"(tiff:Orientation(?:=[\"']|>)\s*)[2-8]"
        header["xmp-data"] = re.sub(pattern, rb"\g<1>1", header["xmp-data"])
        for picture in _IN_XMP:
            header["xmp-data"] = re.sub(picture, b"", header["xmp-data"])
    for name in [name for name in header if "-Raw profile type " in name]:  # in hexadecimal digits
        if "ffd8ff" in "".join(header[name].lower().split()):
            del header[name]
    sizes = (image.yres, image.xres) if turned else (image.xres, image.yres)
    # libvips invents a resolution for JPEG and PNG, and a unit for TIFF; (1, 1) is its code for unknown
    stored = image.get_typeof("resolution-unit") or form not in ("JPEG", "PNG", "TIFF")
    if min(sizes) > 0 and sizes != (1, 1) and (stored or (form == "PNG" and _chunk(path, b"pHYs")[1])):
        header["resolution"] = sizes
    lost = []
    if form == "TIFF":
        tiff = Page(path).tiff
        if tiff.has_place and facts(image)[1] != 1:
            tiff = tiff.without_place()
            lost.append("the georeference of a turned picture")
        header["tiff"] = tiff
        block, whole = exif.from_tiff(path)
        if block is not None:
            header["exif-data"] = block
        if not whole:
            lost.append("a part of its EXIF")
        if image.get_typeof("iptc-data"):  # libvips garbles it
            lost.append("its IPTC")
    for name in {"exif-data", "iptc-data"} & header.keys():
        header[name] = _blanked(header[name])
    header["saved"] = form, saved_as(path, image, form)
    if image.get_typeof("gainmap-data"):
        lost.append("its HDR gain map")
    return header, lost


def _blanked(data: bytes) -> bytes:
    """Return bytes with zeros for every JPEG in them, a thumbnail or a maker's preview: offsets stay valid."""
    made, begin, depth = bytearray(data), 0, 0
    for found in _SIGNS.finditer(data):  # a JPEG may contain another
        opens = found[0] != b"\xff\xd9"
        if opens and depth == 0:
            begin = found.start()
        if opens or depth:
            depth += 1 if opens else -1
            made[begin : found.end()] = bytes(found.end() - begin)
    return bytes(made)


# Kept: libvips reports neither the frames of a PNG nor whether its resolution is stored (test_nothing_is_invented).
def _chunk(path: PathLike, name: bytes) -> tuple[int, bytes]:
    """Return the place and the data of a chunk before the pixels of a PNG; no data if it is missing."""
    at, head = 8, b""
    with open(path, "rb") as file:
        while head[4:] not in (name, b"IDAT"):
            at += 12 + int.from_bytes(head[:4]) if head else 0
            file.seek(at)
            head = file.read(8)
            if len(head) < 8:
                return at, b""
        return at, file.read(int.from_bytes(head[:4])) if head[4:] == name else b""


def png_frames(path: PathLike) -> int:
    """Return the number of frames of a PNG; 1 if it is not animated."""
    return int.from_bytes(_chunk(path, b"acTL")[1][:4]) or 1


def dressed(
    image: Any, header: Mapping[str, Any], icc: bytes | None, form: Format, colours: int
) -> tuple[Any, list[str], bool]:
    """Return an image with a header and a profile, what the format cannot hold, and whether the resolution is known."""
    lost = []
    header = dict(header)
    sizes = header.pop("resolution", None)
    if icc is not None:
        sign = icc[16:20]
        stored = colours if form.grey else max(3, colours)
        if _ICC_COLOURS.get(sign, stored) == stored:
            header["icc-profile-data"] = icc
        else:
            lost.append(f"the {sign.decode('latin-1').strip()} profile")
    if form is not JPEG and header.pop("iptc-data", None):
        lost.append("IPTC")
    block = header.get("exif-data", b"")
    if form is TIFF and block and not exif.is_whole(block):
        lost.append("a part of EXIF")
    if form is not TIFF and len(block) > _EXIF_MOST:
        header["exif-data"] = exif.fitted(block, _EXIF_MOST)
        lost.append("the largest parts of EXIF")
    image = image.copy()
    for name, value in header.items():
        kind = pyvips.GValue.blob_type if isinstance(value, bytes) else pyvips.GValue.refstr_type
        image.set_type(kind, name, value)  # for EXIF, this creates a field for every tag
    for name in image.get_fields():
        if name.startswith(_THUMBNAIL):  # the old thumbnail is out of date
            image.remove(name)
    image.set_type(pyvips.GValue.gint_type, "orientation", 1)
    if sizes is None and (image.xres, image.yres) != (1, 1):  # as EXIF says
        sizes = image.xres, image.yres
    usual = 72 / 25.4 if image.get_typeof("exif-data") and form is not TIFF else _UNKNOWN  # EXIF's default
    xres, yres = sizes or (usual, usual)
    return image.copy(xres=xres, yres=yres), lost, sizes is not None


# Kept: libvips invents or omits a resolution (test_nothing_is_invented, test_resolution_comes_through).
def finish(path: PathLike, image: Any, form: Format, sized: bool) -> None:
    """Correct the resolution in a written file, or remove it if it is unknown."""
    if form is JPEG and sized and not image.get_typeof("exif-data"):
        with open(path, "rb+") as file:
            data = file.read()
            file.seek(2)
            file.write(_jfif(image.xres, image.yres) + data[2:])
    elif form is PNG and not sized:
        start, data = _chunk(path, b"pHYs")
        if data:
            with open(path, "rb+") as file:
                file.seek(start + 12 + len(data))  # behind its checksum
                rest = file.read()
                file.seek(start)
                file.write(rest)
                file.truncate()


def _jfif(xres: float, yres: float) -> bytes:
    """Return JFIF's marker, with dots per inch or per centimetre, whichever are nearer to integers."""
    unit, step = min(((1, 25.4), (2, 10.0)), key=lambda each: abs(xres * each[1] - round(xres * each[1])))
    dots = (min(max(round(x * step), 1), 65535) for x in (xres, yres))
    return struct.pack(">HH5sHBHHBB", 0xFFE0, 16, b"JFIF\0", 0x0102, unit, *dots, 0, 0)


def profile_name(icc: bytes) -> str | None:
    """Return the description in a colour profile, of either version."""
    at = icc.find(b"desc", 132)  # in the table of tags, which comes first
    try:
        start, size = struct.unpack_from(">II", icc, at + 4)
        tag = icc[start : start + size] if at > 0 else b""
        if tag.startswith(b"mluc"):
            length, start = struct.unpack_from(">II", tag, 20)
            return tag[start : start + length].decode("utf-16-be")
        (length,) = struct.unpack_from(">I", tag, 8)
        return tag[12 : 12 + length].rstrip(b"\0").decode("ascii", "replace")
    except (struct.error, UnicodeError):
        return None  # a broken profile has no name
