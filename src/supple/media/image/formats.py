"""The formats that images are written in: what they hold, and how libvips is told to write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips

from supple.errors import SuppleError

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Format:
    """A format's libvips saver, its pixels on a side, its bits a channel, and the channels that it knows.

    What FFmpeg writes names a codec instead, and its pixel format for each type and number of channels.
    """

    name: str
    save: str
    limit: int
    bits: int
    grey: bool = True
    alpha: bool = True
    cmyk: bool = False
    pixel_formats: Mapping[str, Mapping[int, str]] = field(default_factory=dict)


PNG = Format("PNG", "pngsave", 10_000_000, 16)
JPEG = Format("JPEG", "jpegsave", 65_500, 8, alpha=False, cmyk=True)
TIFF = Format("TIFF", "tiffsave", 10_000_000, 64, cmyk=True)
WEBP = Format("WebP", "webpsave", 16_383, 8, grey=False)
AVIF = Format("AVIF", "heifsave", 16_384, 12, grey=False)
_REAL = {1: "grayf32le", 3: "gbrpf32le"}
_BGR = {"u1": {1: "gray", 3: "bgr24", 4: "bgra"}}
EXR = Format("OpenEXR", "exr", 30_000, 32, pixel_formats={"f4": {**_REAL, 4: "gbrapf32le"}})
HDR = Format("Radiance", "hdr", 30_000, 32, grey=False, alpha=False, pixel_formats={"f4": {3: "gbrpf32le"}})
PFM = Format("PFM", "pfm", 30_000, 32, alpha=False, pixel_formats={"f4": _REAL})
PGM = Format("PGM", "pgm", 30_000, 16, alpha=False, pixel_formats={"u1": {1: "gray"}, "u2": {1: "gray16be"}})
PPM = Format("PPM", "ppm", 30_000, 16, alpha=False, pixel_formats={"u1": {3: "rgb24"}, "u2": {3: "rgb48be"}})
BMP = Format("BMP", "bmp", 30_000, 8, pixel_formats=_BGR)
TGA = Format("TGA", "targa", 30_000, 8, pixel_formats=_BGR)
JP2 = Format("JPEG 2000", "jpeg2000", 30_000, 16, alpha=False, pixel_formats={
    "u1": {1: "gray", 3: "rgb24"}, "u2": {1: "gray16le", 3: "rgb48le"},
})  # fmt: skip
OUT = {
    ".png": PNG,
    ".jpg": JPEG,
    ".jpeg": JPEG,
    ".tif": TIFF,
    ".tiff": TIFF,
    ".webp": WEBP,
    ".avif": AVIF,
    ".exr": EXR,
    ".hdr": HDR,
    ".pfm": PFM,
    ".pgm": PGM,
    ".ppm": PPM,
    ".bmp": BMP,
    ".tga": TGA,
    ".jp2": JP2,
}
SUFFIXES_OUT = tuple(OUT)
# Of a folder, everything that somebody may take for a picture: what cannot be read is then named.
SUFFIXES = frozenset({*OUT, ".gif", ".heic", ".heif", ".jxl", ".pam", ".pbm", ".pnm", ".svg"})
DTYPES = {
    "uchar": "u1",
    "char": "i1",
    "ushort": "u2",
    "short": "i2",
    "uint": "u4",
    "int": "i4",
    "float": "f4",
    "double": "f8",
}
_VIPS = {np.dtype(dtype): name for name, dtype in DTYPES.items()}
COLOURS = {"b-w": 1, "grey16": 1, "cmyk": 4, "multiband": 0}  # all others have three


def meant(dtype: np.dtype[Any], colours: int, like: str) -> str:
    """Say in libvips' words what the channels are."""
    if like in ("cmyk", "lab", "labs") and COLOURS.get(like, 3) == colours:
        return like
    if colours not in (1, 3):
        return "multiband"
    names = ("grey16", "rgb16") if dtype == np.uint16 else ("b-w", "scrgb" if dtype.kind == "f" else "srgb")
    return names[colours == 3]


def check(name: str, form: Format, array: Array, meaning: str, alpha: bool) -> None:
    """Refuse what the format cannot hold."""
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise SuppleError(f"cannot write {name}: an image has shape (H, W) or (H, W, C), and not {array.shape}")
    if form.pixel_formats and array.dtype in _VIPS:
        _check_codec(name, form, array, alpha)
        return
    if array.dtype not in _VIPS or (form is not TIFF and array.dtype not in (np.uint8, np.uint16)):
        advice = "write a TIFF" if array.dtype in _VIPS else "convert to uint8, uint16 or, for TIFF, float32"
        raise SuppleError(f"cannot write {name}: {form.name} takes no {array.dtype} values: {advice}")
    if alpha and not form.alpha:
        advice = "write PNG, TIFF, WebP or AVIF"
        raise SuppleError(f"cannot write {name}: {form.name} holds no transparency: {advice}")
    if meaning == "cmyk" and not form.cmyk:
        raise SuppleError(f"cannot write {name}: {form.name} holds no CMYK colours: write TIFF or JPEG")
    if meaning == "multiband" and form is not TIFF:
        raise SuppleError(f"cannot write {name}: {form.name} does not hold {array.shape[2]} channels: write a TIFF")
    if max(array.shape[:2]) > form.limit:
        size = f"{array.shape[1]} x {array.shape[0]}"
        advice = "write PNG or TIFF" if form.limit < PNG.limit else "cut it into parts"
        limit = f"{form.name} ends at {form.limit} pixels on a side"
        raise SuppleError(f"cannot write {name}: {limit}, and the image has {size}: {advice}")


def _check_codec(name: str, form: Format, array: Array, alpha: bool) -> None:
    """Refuse what a format that FFmpeg writes cannot hold."""
    channels = array.shape[2] if array.ndim == 3 else 1
    types = set(form.pixel_formats)
    if array.dtype.str[1:] not in types | ({"u2"} if "u1" in types else set()):
        advice = "write a TIFF" if "f4" in types or array.dtype.kind != "f" else "write TIFF or OpenEXR"
        raise SuppleError(f"cannot write {name}: {form.name} takes no {array.dtype} values: {advice}")
    if alpha and not form.alpha:
        raise SuppleError(f"cannot write {name}: {form.name} holds no transparency: write PNG or TIFF")
    known = next(iter(form.pixel_formats.values()))
    if channels not in known or (alpha and channels == 2):
        held = " or ".join(map(str, known))
        raise SuppleError(f"cannot write {name}: {form.name} holds {held} channels, and not {channels}: write a TIFF")
    if max(array.shape[:2]) > form.limit:
        size = f"{array.shape[1]} x {array.shape[0]}"
        what = f"{form.name} ends at {form.limit} pixels on a side, and the image has {size}"
        raise SuppleError(f"cannot write {name}: {what}: write a TIFF")


def wrapped(array: Array, meaning: str, bits: int) -> Any:
    """Show libvips an array, without copying it, as an image."""
    channels = array.shape[2] if array.ndim == 3 else 1
    height, width = array.shape[:2]
    image = pyvips.Image.new_from_memory(array, width, height, channels, _VIPS[array.dtype])
    if array.dtype == np.uint16 and bits < 16:  # rounded here, since libvips drops the low bits
        image = (image.cast("double") * ((2**bits - 1) / 65535)).rint()
        image = image.cast("uchar") if bits == 8 else image.cast("ushort") << (16 - bits)
    if bits == 8:
        meaning = {"grey16": "b-w", "rgb16": "srgb"}.get(meaning, meaning)
    return image.copy(interpretation=meaning)


def settings(form: Format, array: Array, bits: int, quality: int | None, lossless: bool) -> dict[str, Any]:
    """Choose the settings of a libvips saver."""
    if form is PNG:
        return {"compression": 6, "filter": "paeth"}
    if form is JPEG:
        return {"Q": quality or 95, "subsample_mode": "off"}
    if form is TIFF:
        predictor = "none" if array.dtype.itemsize == 8 else "float" if array.dtype.kind == "f" else "horizontal"
        return {"compression": "deflate", "predictor": predictor, "bigtiff": array.nbytes >= 4_000_000_000}
    if form is WEBP:
        return {"Q": quality or 90, "lossless": lossless, "exact": lossless, "smart_subsample": True}
    depth = {"bitdepth": bits, "compression": "av1", "subsample_mode": "off", "effort": 3}
    return {"Q": quality or 90, "lossless": lossless, **depth}  # effort 4 takes six times as long for 7 %
