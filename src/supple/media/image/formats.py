"""The contents of image formats, and arrays as libvips takes them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, first_bytes, unreadable, unwritable
from supple.media.pictures import AVIF, EXR, EXR_MAGIC, FORMATS, PNG, TIFF, WEBP, Format

Array = npt.NDArray[Any]
Box = tuple[int, int, int, int]  # x and y of the first pixel, and of that after the last


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
LOADERS = {loader: form.name for form in FORMATS for loader in form.loaders}  # others: tables, raw memory
_VIPS = {np.dtype(dtype): name for name, dtype in DTYPES.items()}
COLOURS = {"b-w": 1, "grey16": 1, "cmyk": 4, "multiband": 0}  # all others have three


def meant(dtype: np.dtype[Any], colours: int, like: str) -> str:
    """Return libvips' interpretation of the channels."""
    if like in ("cmyk", "lab") and COLOURS.get(like, 3) == colours:
        return like
    if colours not in (1, 3):
        return "multiband"
    names = ("grey16", "rgb16") if dtype == np.uint16 else ("b-w", "scrgb" if dtype.kind == "f" else "srgb")
    return names[colours == 3]


def check(path: PathLike, form: Format, array: Array, meaning: str, extra: tuple[int, ...]) -> None:
    """Raise SuppleError for an array that the format cannot hold, with the meanings of channels above its colours."""
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise SuppleError(f"cannot write {shown(path)}: an image has shape (H, W) or (H, W, C), and not {array.shape}")
    known, channels = array.dtype in _VIPS, array.shape[2] if array.ndim == 3 else 1
    held: Mapping[int, str] = next(iter(form.pixel_formats.values()), {})
    types = {*form.pixel_formats} or {"u1"}
    types |= {"u2"} if "u1" in types else set()
    many = channels not in held or (channels == 4 and not extra and form is not EXR) if held else meaning == "multiband"
    other = "write a TIFF" if form.limit < PNG.limit else "cut it into parts"
    size = f"{array.shape[1]} x {array.shape[0]}"
    refusals = (
        (not known, f"takes no {array.dtype} values", "convert to uint8, uint16 or, for TIFF, float32"),
        (form is not TIFF and array.dtype.str[1:] not in types, f"takes no {array.dtype} values", "write a TIFF"),
        (meaning == "cmyk" and not form.cmyk, "holds no CMYK colours", "write TIFF or JPEG"),
        (meaning == "lab" and form is not TIFF, "holds no Lab colours", "write a TIFF"),
        (0 in extra and form is not TIFF, "holds no channels of data beside the colours", "write a TIFF"),
        (2 in extra and not form.alpha, "holds no transparency", "write PNG, TIFF, WebP or AVIF"),
        (many and form is not TIFF, f"does not hold {channels} channel{'s' * (channels > 1)}", "write a TIFF"),
        (max(array.shape[:2]) > form.limit, f"ends at {form.limit} pixels on a side, and the image has {size}", other),
    )
    for wrong, what, advice in refusals:
        if wrong:
            raise unwritable(path, f"{form.name} {what}", advice)


def wrapped(array: Array, meaning: str, bits: int) -> Any:
    """Return an array as an image of libvips, without a copy."""
    channels = array.shape[2] if array.ndim == 3 else 1
    height, width = array.shape[:2]
    image = pyvips.Image.new_from_memory(array, width, height, channels, _VIPS[array.dtype])
    if array.dtype == np.uint16 and bits < 16:  # rounded here, since libvips drops the low bits
        image = (image.cast("double") * ((2**bits - 1) / 65535)).rint()
        image = image.cast("uchar") if bits == 8 else image.cast("ushort") << (16 - bits)
    if bits == 8:
        meaning = {"grey16": "b-w", "rgb16": "srgb"}.get(meaning, meaning)
    return image.copy(interpretation=meaning)


def of_pixels(pixels: Array, bits: int, extra: int = 0, meaning: str = "") -> Any:
    """Return decoded pixels as an image of libvips that records their bits; the last ``extra`` are not colours."""
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    image = wrapped(np.ascontiguousarray(pixels), meant(pixels.dtype, channels - extra, meaning), 32)
    image.set_type(pyvips.GValue.gint_type, "bits-per-sample", bits)
    return image


def settings(form: Format, array: Array, bits: int, quality: int | None, lossless: bool) -> dict[str, Any]:
    """Return the settings of a libvips saver."""
    chosen = {**form.options, **dict.fromkeys(form.lossless, lossless)}
    if form.quality:
        chosen["Q"] = quality or form.quality
    if form is TIFF:
        predictor = "none" if array.dtype.itemsize == 8 else "float" if array.dtype.kind == "f" else "horizontal"
        chosen |= {"predictor": predictor, "bigtiff": array.nbytes >= 4_000_000_000}
    if form is AVIF:
        chosen["bitdepth"] = bits
    return chosen


def compressed(form: Format, array: Array, how: str | None, lossless: bool) -> dict[str, Any]:
    """Return the settings of a saver for a compression that `COMPRESSIONS` names; none for None."""
    if how is None:
        return {}
    if form in (WEBP, AVIF):
        return {"effort": 0} if lossless else {}
    if how == "fast":  # deflate's fastest level makes the noise of 16 bits larger than it was
        how = "1" if array.dtype.itemsize == 1 else "none"
    level = int(how) if how.isdigit() else 0 if how == "none" else 6
    if form is PNG:
        return {"compression": level, "filter": ("none", "sub")[level] if level < 2 else "paeth"}
    if how.isdigit() and level:
        return {"compression": "deflate", "level": level}
    return {"compression": "none" if level == 0 else how}


def white_of(dtype: np.dtype[Any]) -> float:
    """Return the value of white, and of full opacity."""
    return float(np.iinfo(dtype).max) if dtype.kind in "iu" else 1.0


def divided(pixels: Array) -> Array:
    """Return premultiplied pixels with their colours divided by opacity, the last channel."""
    white = white_of(pixels.dtype)
    opacity = pixels[..., -1:].astype(np.float64)
    colours = pixels[..., :-1] * white
    np.divide(colours, opacity, out=colours, where=opacity > 0)
    colours = np.rint(np.minimum(colours, white)) if pixels.dtype.kind in "iu" else colours
    return np.concatenate([colours.astype(pixels.dtype), pixels[..., -1:]], axis=-1)


def codec_of(path: PathLike, head: bytes) -> tuple[str, str] | None:
    """Return FFmpeg's codec for an image, by its first bytes, and its format; TGA, without a signature, by its name."""
    for known in FORMATS:
        for pattern, codec in known.magic.items():
            if re.match(pattern, head):
                return codec, known.name
    return ("targa", "TGA") if os.fspath(path).lower().endswith(".tga") else None


def damaged(path: PathLike, why: str = "") -> SuppleError:
    """Return an error for a file that cannot be decoded, for a library's reason; if empty, its format is unknown."""
    what = f"it is damaged, cut short or of a kind that is not supported ({why})"
    what = what if why else "it is no image of a known kind, or cut short"
    return unreadable(path, what, "give a whole copy of it, or convert it, to PNG or TIFF for instance")


def bounds(mask: Array) -> Box | None:
    """Return the bounding box of the true elements; None if there are none."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1) if rows.size else None


def is_exr(path: PathLike) -> bool:
    """Return whether a file begins as an OpenEXR does; False if it cannot be read."""
    return first_bytes(path, 4) == EXR_MAGIC
