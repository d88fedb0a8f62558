"""HEIC, Photoshop's files and camera raw, read by libraries of the extra `formats`; none of these is written."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np
import pyvips

from supple.errors import need, said
from supple.media.files import PathLike, refusing, unreadable
from supple.media.image import exif
from supple.media.image.formats import Array, of_pixels
from supple.media.pictures import RAW

_GIVE = "give a whole copy of it, or convert it, to TIFF for instance"
_PSD = {"GRAYSCALE": "", "RGB": "", "CMYK": "cmyk", "DUOTONE": ""}
_ICC, _EXIF, _XMP = 1039, 1058, 1060  # Photoshop's image resources


def kind_of(path: PathLike, head: bytes) -> str:
    """Return the format of a file by its first bytes; of camera raw, by its name, as most look like TIFF."""
    if head.startswith(b"8BPS"):
        return "PSD"
    if re.match(rb"(?s)....ftyp(....)*?(hei[cxms]|hev[cxms])", head[: int.from_bytes(head[:4])]):
        return "HEIF"  # of HEVC, which libvips opens, but does not decode
    return "camera raw" if os.path.splitext(os.fspath(path))[1].lower() in RAW.suffixes else ""


def opened(path: PathLike, kind: str) -> Any:
    """Return an image of libvips, upright, with its profile, EXIF and XMP; SuppleError without the library for it."""
    module, decode = {
        "PSD": ("psd_tools", _psd), "camera raw": ("rawpy", _raw), "HEIF": ("pillow_heif", _heif)
    }[kind]  # fmt: skip
    need("formats", f"{kind} pictures", module)
    # Exception, as these libraries raise many types
    with refusing(
        lambda error: unreadable(path, f"{module} fails on it ({said(error).rstrip('.')})", _GIVE), Exception
    ):
        pixels, bits, meaning, alpha, known = decode(path)
    image = of_pixels(pixels, bits, alpha, meaning)
    for name, value in known.items():
        if value:
            image.set_type(pyvips.GValue.blob_type, name, value)
    return image


def _heif(path: PathLike) -> tuple[Array, int, str, bool, dict[str, Any]]:
    import pillow_heif

    held = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)  # applies the orientation in the file
    pixels, bits = np.asarray(held), int(held.info.get("bit_depth", 8))
    names = {"icc-profile-data": "icc_profile", "exif-data": "exif", "xmp-data": "xmp"}
    return pixels, bits, "", held.has_alpha, {name: held.info.get(key) for name, key in names.items()}


def _psd(path: PathLike) -> tuple[Array, int, str, bool, dict[str, Any]]:
    from psd_tools import PSDImage

    file: Any = PSDImage.open(path)
    mode = file.color_mode.name
    if mode not in _PSD or file.depth not in (8, 16, 32):
        raise unreadable(path, f"it is a Photoshop file of {mode} in {file.depth} bits, which is not supported", _GIVE)
    if not file.has_preview():
        what = "it holds its layers alone, without the picture of them"
        raise unreadable(path, what, "save it with Maximize Compatibility, or as TIFF")
    colours, seen = file.numpy("color"), file.numpy("shape")
    if _PSD[mode] == "cmyk":
        colours = 1 - colours  # Photoshop stores CMYK inverted
    alpha = seen is not None and bool((seen < 1).any())
    pixels = np.concatenate([colours, seen], axis=2) if alpha else colours
    if file.depth < 32:
        dtype = np.uint8 if file.depth == 8 else np.uint16
        pixels = np.rint(np.float64(pixels) * np.iinfo(dtype).max).astype(dtype)
    held = file.image_resources
    names = {"icc-profile-data": _ICC, "exif-data": _EXIF, "xmp-data": _XMP}
    known = {name: held[key].data if key in held else None for name, key in names.items()}
    known["exif-data"] = b"Exif\0\0" + known["exif-data"] if known["exif-data"] else None
    return pixels[..., 0] if pixels.shape[2] == 1 else pixels, file.depth, _PSD[mode], alpha, known


def _raw(path: PathLike) -> tuple[Array, int, str, bool, dict[str, Any]]:
    import rawpy

    with rawpy.imread(os.fspath(path)) as raw:  # applies the camera's orientation
        pixels = raw.postprocess(output_bps=16, use_camera_wb=True, no_auto_bright=True, gamma=(2.4, 12.92))
    profile = pyvips.Image.profile_load("srgb")
    return pixels, 16, "", False, {"icc-profile-data": bytes(profile), "exif-data": exif.from_tiff(path)[0]}
