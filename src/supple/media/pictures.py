"""The table of picture formats: their names, suffixes, readers, writers and limits; it needs no library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Format:
    """An image format: a row of the table."""

    name: str  # for users
    suffixes: tuple[str, ...] = ()  # the first is the default
    loaders: tuple[str, ...] = ()  # the names of libvips' loaders
    magic: Mapping[bytes, str] = field(default_factory=dict)  # signatures of files that a codec of FFmpeg reads
    saver: str = ""  # of libvips, or a codec of FFmpeg if there are pixel_formats; empty if it cannot be written
    limit: int = 30_000  # pixels on a side
    bits: int = 8  # a channel
    grey: bool = True
    alpha: bool = True
    cmyk: bool = False
    quality: int = 0  # the default, from 1 to 100; 0 without one
    lossless: tuple[str, ...] = ()  # the options for lossless output
    options: Mapping[str, Any] = field(default_factory=dict)  # for all output
    # of the codec, for each type and number of channels
    pixel_formats: Mapping[str, Mapping[int, str]] = field(default_factory=dict)


# fmt: off
_BGR = {"u1": {1: "gray", 3: "bgr24", 4: "bgra"}}
_REAL = {1: "grayf32le", 3: "gbrpf32le"}
_WHOLE = {"u1": {1: "gray", 3: "rgb24"}, "u2": {1: "gray16le", 3: "rgb48le"}}
_FULL = {"u1": {1: "gray", 3: "rgb24", 4: "rgba"}, "u2": {1: "gray16be", 3: "rgb48be", 4: "rgba64be"}}
_PGM, _PPM = {"u1": {1: "gray"}, "u2": {1: "gray16be"}}, {"u1": {3: "rgb24"}, "u2": {3: "rgb48be"}}
_PNM = {
    rb"P[14]\s": "pbm", rb"P[25]\s": "pgm", rb"P[36]\s": "ppm", rb"P7\s": "pam", rb"P[Ff]\s": "pfm", rb"P[Hh]\s": "phm"
}
PNG = Format("PNG", (".png", ".apng"), ("png",), saver="pngsave", limit=10**7, bits=16,
             options={"compression": 6, "filter": "paeth"})
JPEG = Format("JPEG", (".jpg", ".jpeg"), ("jpeg", "uhdr"), saver="jpegsave", limit=65_500, alpha=False, cmyk=True,
              quality=95, options={"subsample_mode": "off"})
TIFF = Format("TIFF", (".tif", ".tiff"), ("tiff",), saver="tiffsave", limit=10**7, bits=64, cmyk=True,
              options={"compression": "deflate"})
WEBP = Format("WebP", (".webp",), ("webp",), saver="webpsave", limit=16_383, grey=False,
              quality=90, lossless=("lossless", "exact"), options={"smart_subsample": True})
AVIF = Format("AVIF", (".avif",), ("heif",), saver="heifsave", limit=16_384, bits=12, grey=False,
              quality=90, lossless=("lossless",),  # effort 4 takes six times as long for 7 %
              options={"compression": "av1", "subsample_mode": "off", "effort": 3})
EXR_MAGIC = b"v/1\x01"
EXR = Format("OpenEXR", (".exr",), saver="exr", bits=32, pixel_formats={"f4": {**_REAL, 4: "gbrapf32le"}})
DPX = Format("DPX", (".dpx",), (), {rb"SDPX|XPDS": "dpx"}, "dpx", bits=16, pixel_formats=_FULL)
RAW = Format("camera raw", (".3fr", ".arw", ".cr2", ".cr3", ".dng", ".erf", ".mef", ".mos", ".mrw", ".nef", ".nrw",
                            ".orf", ".pef", ".raf", ".rw2", ".srw", ".x3f"))
FORMATS = (
    PNG, JPEG, TIFF, WEBP, AVIF, EXR, DPX,
    Format("SGI", (".sgi",), (), {rb"\x01\xda": "sgi"}, "sgi", bits=16, pixel_formats=_FULL),
    Format("Radiance", (".hdr",), (), {rb"#\?(RADIANCE|RGBE)": "hdr"}, "hdr", bits=32, grey=False, alpha=False,
           pixel_formats={"f4": {3: "gbrpf32le"}}),
    Format("PFM", (".pfm",), saver="pfm", bits=32, alpha=False, pixel_formats={"f4": _REAL}),
    Format("PGM", (".pgm",), saver="pgm", bits=16, alpha=False, pixel_formats=_PGM),
    Format("PPM", (".ppm",), saver="ppm", bits=16, alpha=False, pixel_formats=_PPM),
    Format("BMP", (".bmp",), (), {b"BM": "bmp"}, "bmp", pixel_formats=_BGR),
    Format("TGA", (".tga",), saver="targa", pixel_formats=_BGR),
    Format("JPEG 2000", (".jp2",), ("jp2k",), {rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51": "jpeg2000"}, "jpeg2000", bits=16,
           alpha=False, options={"format": "jp2", "pred": "dwt53"}, pixel_formats=_WHOLE),  # lossless
    Format("PNM", (".pam", ".pbm", ".pnm"), ("ppm",), _PNM),
    Format("GIF", (".gif",), ("gif",)),
    Format("HEIF", (".heic", ".heif")),
    Format("JPEG XL", (".jxl",), ("jxl",)),
    Format("PSD", (".psd", ".psb")),
    RAW,
    Format("SVG", (".svg",), ("svg",)),
)
# fmt: on
OUT = {suffix: form for form in FORMATS if form.saver for suffix in form.suffixes}
SUFFIXES_OUT = tuple(OUT)
# In a folder, all suffixes that users may take for images: unreadable files are then named.
SUFFIXES = frozenset(suffix for form in FORMATS for suffix in form.suffixes)
COMPRESSIONS = {
    "PNG": ("none", "deflate", *map(str, range(10)), "fast"),
    "TIFF": ("none", "deflate", "lzw", "packbits", *map(str, range(10)), "fast"),
    **dict.fromkeys(("WebP", "AVIF"), ("fast",)),
}
"""For each format, how it may be compressed without loss."""
