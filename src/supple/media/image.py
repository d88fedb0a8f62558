"""Images as files: PNG, JPEG, TIFF, WebP and AVIF, with 8 or 16 bits, alpha and what their headers say."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pyvips

from supple.errors import SuppleError
from supple.media.files import replacing, shown

T = TypeVar("T")
Array = npt.NDArray[Any]
PathLike = str | os.PathLike[str]


class ImageWarning(UserWarning):
    """Something of an image does not come through."""


class PageWarning(ImageWarning):
    """A file holds several pages or frames, and one is read."""


class DepthWarning(ImageWarning):
    """A format holds fewer bits than the pixels have, and they are rounded."""


class MetadataWarning(ImageWarning):
    """A format cannot take over a part of the header."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image as it is looked at: upright, in the colours that the file holds.

    Parameters
    ----------
    pixels : ndarray
        Shape (H, W) or (H, W, C), contiguous, in the file's own dtype.
    alpha : bool
        Whether the last channel is opacity; the colours are not multiplied by it.
    icc : bytes or None
        The colour profile.
    bits : int
        Bits a channel in the file; `pixels` may have room for more.
    format : str
        ``"PNG"``, ``"JPEG"``, ``"TIFF"``, ``"WebP"``, ``"AVIF"``, ``"GIF"``, ...
    interpretation : str
        What the channels mean, in libvips' words: ``"b-w"``, ``"srgb"``, ``"rgb16"``, ``"cmyk"``, ...
    """

    pixels: Array
    alpha: bool = False
    icc: bytes | None = None
    bits: int = 8
    format: str = ""
    interpretation: str = ""
    _header: Mapping[str, Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True)
class _Format:
    name: str
    save: str
    limit: int
    bits: int
    grey: bool = True
    alpha: bool = True
    cmyk: bool = False


_PNG = _Format("PNG", "pngsave", 10_000_000, 16)
_JPEG = _Format("JPEG", "jpegsave", 65_500, 8, alpha=False, cmyk=True)
_TIFF = _Format("TIFF", "tiffsave", 10_000_000, 32, cmyk=True)
_WEBP = _Format("WebP", "webpsave", 16_383, 8, grey=False)
_AVIF = _Format("AVIF", "heifsave", 16_384, 12, grey=False)
_OUT = {
    ".png": _PNG,
    ".jpg": _JPEG,
    ".jpeg": _JPEG,
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".webp": _WEBP,
    ".avif": _AVIF,
}
SUFFIXES_OUT = tuple(_OUT)

# libvips also reads tables of numbers and raw memory: those are no images
_LOADERS = {
    "png": "PNG",
    "jpeg": "JPEG",
    "uhdr": "JPEG",
    "tiff": "TIFF",
    "webp": "WebP",
    "heif": "HEIF",
    "gif": "GIF",
    "svg": "SVG",
    "jxl": "JPEG XL",
    "jp2k": "JPEG 2000",
    "ppm": "PNM",
    "openexr": "OpenEXR",
}
_MAGIC = (b"\x89PNG", b"\xff\xd8", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"RIFF", b"GIF8")
_DTYPES = {
    "uchar": "u1",
    "char": "i1",
    "ushort": "u2",
    "short": "i2",
    "uint": "u4",
    "int": "i4",
    "float": "f4",
}
_VIPS = {np.dtype(dtype): name for name, dtype in _DTYPES.items()}
_COLOURS = {"b-w": 1, "grey16": 1, "cmyk": 4, "multiband": 0}  # all others have three
_ICC_COLOURS = {b"GRAY": 1, b"RGB ": 3, b"Lab ": 3, b"CMYK": 4}
_KEPT = ("icc-profile-data", "exif-data", "xmp-data", "iptc-data", "image-description", "png-comment-")
_THUMBNAIL = ("exif-ifd1-", "jpeg-thumbnail-data")
# what libvips adds to any EXIF block: losing only that loses nothing
_BARE = re.compile(
    "exif-(data|ifd.-([XY]?Resolution.*|YCbCrPos.*|.*Version|Comp.*|ColorSpace|Pixel.*|Orientation))"
)


def check_target(path: PathLike) -> None:
    """Refuse a name whose suffix no image can be written under.

    Raises
    ------
    SuppleError
        The suffix is not in `SUFFIXES_OUT`.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in _OUT:
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise SuppleError(f"cannot write {shown(path)}: {found} is no image format: use {', '.join(_OUT)}")


def read(path: PathLike) -> Picture:
    """Read an image, upright: an orientation in its header is applied, once.

    Colours are not converted. A palette becomes RGB or RGBA; fewer than 8 bits become 8; 10 or 12 bits become
    16, with white at 65535.

    Returns
    -------
    Picture
        `pixels` of shape (H, W) or (H, W, C) in uint8, uint16, float32 or what else a TIFF holds.

    Raises
    ------
    SuppleError
        The file is missing, empty, cut short, damaged, or no image.

    Warns
    -----
    PageWarning
        The file holds several pages or frames.
    MetadataWarning
        The file has EXIF or IPTC in a TIFF, or a gain map for HDR in a JPEG.
    """
    image, form = _open(path)
    name = shown(path)
    pages, orientation, bits = _facts(image)
    if pages > 1:
        text = f"{name} holds {pages} pages or frames, and only one of them is read"
        warnings.warn(text, PageWarning, stacklevel=2)
    with _reading(path):
        if lost := _unread(path, image, form):
            text = f"{name}: its {' and '.join(lost)} cannot be carried over"
            warnings.warn(text, MetadataWarning, stacklevel=2)
        pixels = _apart(lambda: _decoded(image, orientation), image)
        header = _header(image, form, orientation >= 5)
    if form in ("AVIF", "HEIF") and 8 < bits < 16:
        _widen(pixels, bits)
    icc = header.pop("icc-profile-data", None)
    return Picture(pixels, _has_alpha(image), icc, bits, form, image.interpretation, header)


def info(path: PathLike) -> dict[str, object]:
    """Tell what the header of an image says, without decoding the pixels.

    Returns
    -------
    dict
        ``width`` and ``height`` upright, ``channels``, ``dtype``, ``bits``, ``alpha``, ``format``,
        ``interpretation``, ``profile`` (the name of the colour profile, or None), ``orientation`` (1 to 8, as
        stored), ``pages`` and ``bytes``.

    Raises
    ------
    SuppleError
        As `read` does, but damage in the pixels goes unseen.
    """
    image, form = _open(path)
    pages, orientation, bits = _facts(image)
    size = (image.height, image.width) if orientation >= 5 else (image.width, image.height)
    icc = image.get("icc-profile-data") if image.get_typeof("icc-profile-data") else b""
    return {
        "width": size[0],
        "height": size[1],
        "channels": image.bands,
        "dtype": str(np.dtype(_DTYPES[image.format])),
        "bits": bits,
        "alpha": _has_alpha(image),
        "format": form,
        "interpretation": image.interpretation,
        "profile": _profile_name(icc),
        "orientation": orientation,
        "pages": pages,
        "bytes": os.stat(path).st_size,
    }


def write(
    path: PathLike,
    pixels: Array,
    *,
    like: Picture | None = None,
    alpha: bool | None = None,
    quality: int | None = None,
    lossless: bool = False,
    force: bool = False,
) -> None:
    """Write an image in the format that the suffix names; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        One of `SUFFIXES_OUT`.
    pixels : ndarray
        Shape (H, W) or (H, W, C): uint8, uint16, and for TIFF also float32 and integers up to 32 bits. Used
        as it is when contiguous, without a copy.
    like : Picture, optional
        Whose profile, EXIF, XMP and resolution to write, and whose channels `pixels` has.
    alpha : bool, optional
        Whether the last channel is opacity. Without it: as in `like`; otherwise two or four channels have it.
    quality : int, optional
        From 1 to 100; JPEG takes 95 without it, WebP and AVIF 90. Means nothing to PNG and TIFF.
    lossless : bool
        Keep every value; PNG and TIFF always do, JPEG cannot.
    force : bool
        Whether to replace a file that exists.

    Raises
    ------
    SuppleError
        The format cannot hold these channels, this type or this size, or the file cannot be written.

    Warns
    -----
    DepthWarning
        16 bits are rounded to the 8 of JPEG and WebP or the 12 of AVIF.
    MetadataWarning
        EXIF in a TIFF, or a grey profile in a format without grey.
    """
    check_target(path)
    name, form = shown(path), _OUT[Path(path).suffix.lower()]
    array = np.ascontiguousarray(pixels, np.asarray(pixels).dtype.newbyteorder("="))
    channels = array.shape[2] if array.ndim == 3 else 1
    same = like is not None and like.pixels.shape[2:] == array.shape[2:]
    if alpha is None:
        alpha = like.alpha if like is not None and same else channels in (2, 4)
    known = like.interpretation if like is not None and same else ""
    meaning = _meaning(array.dtype, channels - alpha, known)
    _check(name, form, array, meaning, alpha)
    if lossless and form is _JPEG:
        raise SuppleError(f"cannot write {name} without loss: JPEG loses some: write PNG, TIFF, WebP or AVIF")
    if quality is not None and not 1 <= quality <= 100:
        raise SuppleError(f"cannot write {name} with quality {quality}: quality goes from 1 to 100")
    have = like.bits if like is not None and like.pixels.dtype == array.dtype else array.dtype.itemsize * 8
    bits = 10 if form is _AVIF and 8 < have <= 10 else min(form.bits, array.dtype.itemsize * 8)
    if bits < have:
        text = f"{name}: {form.name} holds {bits} bits a channel, and the {have} of the pixels are rounded"
        warnings.warn(text, DepthWarning, stacklevel=2)
    image = _wrapped(array, meaning, bits)
    image, lost = _dressed(image, like, form, channels - alpha)
    if lost:
        text = f"{name}: {form.name} cannot take over {' and '.join(lost)}"
        warnings.warn(text, MetadataWarning, stacklevel=2)
    options = _options(form, array, bits, quality, lossless)
    with replacing(path, force=force) as temporary, _writing(path):
        _apart(lambda: getattr(image, form.save)(os.fsencode(temporary), **options), image)


def _open(path: PathLike) -> tuple[Any, str]:
    """Open an image for one reading from top to bottom; tell its format."""
    name = shown(path)
    kinds = "give a PNG, JPEG, TIFF, WebP, AVIF or GIF file"
    head = b""
    try:
        plain = stat.S_ISREG(os.stat(path).st_mode)
        if plain:
            with open(path, "rb") as file:
                head = file.read(12)
    except OSError as error:
        raise SuppleError(f"cannot read {name}: {error.strerror}: check the name and its rights") from error
    except ValueError as error:
        raise SuppleError(f"cannot read {name}: no file can have that name: check it") from error
    if not head:
        what = "it is empty" if plain else "it is a folder or no plain file"
        raise SuppleError(f"cannot read {name}: {what}: {kinds}")
    known = head.startswith(_MAGIC) or head[4:8] == b"ftyp"
    try:
        image = _apart(lambda: _sequential(path))
        form = _LOADERS.get(str(image.get("vips-loader")).partition("load")[0])
        if form == "HEIF" and image.get("heif-compression") == "av1":
            form = "AVIF"
    except (pyvips.Error, UnicodeError) as error:
        if known:
            raise _damaged(path, error) from error
        form = None
    if form is None or image.format not in _DTYPES or image.coding != "none":
        raise SuppleError(f"cannot read {name}: it is no image of a known kind: {kinds}")
    return image, form


def _sequential(path: PathLike) -> Any:
    # a source, since libvips would take "[...]" in a file's name for options, and cache what it read
    source = pyvips.Source.new_from_file(os.fsencode(path))
    return pyvips.Image.new_from_source(source, "", access="sequential", fail_on="truncated")


def _apart(work: Callable[[], T], image: Any = None) -> T:
    """Let libvips work in another thread: here, its callbacks would swallow an interrupt, and print it."""
    with ThreadPoolExecutor(1) as thread:
        future = thread.submit(work)
        try:
            return future.result()
        except BaseException:
            if image is not None:
                image.set_kill(True)  # or it would work to the end
            raise


@contextlib.contextmanager
def _reading(path: PathLike) -> Iterator[None]:
    try:
        yield
    except (pyvips.Error, OSError, UnicodeError, struct.error, MemoryError) as error:
        raise _damaged(path, error) from error


@contextlib.contextmanager
def _writing(path: PathLike) -> Iterator[None]:
    """Make libvips' account of a failure an `OSError` where the system refused, else one sentence."""
    try:
        yield
    except (pyvips.Error, UnicodeError) as error:
        text = getattr(error, "detail", "")
        if found := re.search("system error: (.+)", text):
            code = next((code for code in errno.errorcode if os.strerror(code) == found[1]), errno.EIO)
            raise OSError(code, found[1]) from error
        raise SuppleError(
            f"cannot write {shown(path)}: libvips fails{_reason(text)}: try another format"
        ) from error


def _damaged(path: PathLike, error: Exception) -> SuppleError:
    """Say in one sentence why a file was not read, with the telling line of libvips, if there is one."""
    text = getattr(error, "detail", "")
    if isinstance(error, MemoryError) or "out of memory" in text:
        return SuppleError(f"cannot read {shown(path)}: it is too large for the memory: cut it into parts")
    what = f"it is damaged, cut short or of an unknown kind{_reason(text)}"
    return SuppleError(f"cannot read {shown(path)}: {what}: give a whole copy of it")


def _reason(text: str) -> str:
    for line in map(str.strip, text.splitlines()):
        if line and not re.search("bad seek|not in a known format", line):
            told = re.sub(r"^\w+: ", "", line)  # without the name of libvips' part
            return f" ({told})"
    return ""


def _facts(image: Any) -> tuple[int, int, int]:
    """Tell how many pages the file has, its orientation (1 to 8), and its bits a channel."""
    names = ("n-pages", "orientation", "bits-per-sample")
    pages, orientation, bits = (image.get(name) if image.get_typeof(name) else 0 for name in names)
    depth = np.dtype(_DTYPES[image.format]).itemsize * 8
    return max(1, pages), orientation if 1 <= orientation <= 8 else 1, bits or depth


def _has_alpha(image: Any) -> bool:
    """Tell whether the last channel is opacity: one above the colours is, several are something else."""
    colours = _COLOURS.get(image.interpretation, 3)
    return bool(colours and image.bands == colours + 1)


def _decoded(image: Any, orientation: int) -> Array:
    """Decode all pixels into one array, upright."""
    shape = (image.height, image.width, image.bands) if image.bands > 1 else (image.height, image.width)
    dtype = np.dtype(_DTYPES[image.format])
    if orientation == 1:
        return np.frombuffer(image.write_to_memory(), dtype).reshape(shape)
    turned = orientation >= 5
    upright = np.empty((shape[1], shape[0], *shape[2:]) if turned else shape, dtype)
    stored = upright.swapaxes(0, 1) if turned else upright
    stored = stored[:: -1 if orientation in (3, 4, 6, 7) else 1, :: -1 if orientation in (2, 3, 7, 8) else 1]
    region = pyvips.Region.new(image)
    for top in range(0, shape[0], 16):  # turned a strip at a time, or memory would hold the image twice
        strip = stored[top : top + 16]
        data = region.fetch(0, top, shape[1], len(strip))
        strip[:] = np.frombuffer(data, dtype).reshape(strip.shape)
    return upright


def _widen(pixels: Array, bits: int) -> None:
    """Fill the low bits, which libvips leaves empty, so that white is 65535."""
    for top in range(0, len(pixels), 64):
        strip = pixels[top : top + 64]
        strip |= strip >> bits


def _header(image: Any, form: str, turned: bool) -> dict[str, Any]:
    """Collect what `write` puts back."""
    header: dict[str, Any] = {}
    for name in image.get_fields():
        if name.startswith(_KEPT) and (name != "iptc-data" or form == "JPEG"):
            with contextlib.suppress(UnicodeError):
                header[name] = image.get(name)
    if "xmp-data" in header:  # it may say the orientation once more
        pattern = rb"(tiff:Orientation(?:=[\"']|>)\s*)[2-8]"
        header["xmp-data"] = re.sub(pattern, rb"\g<1>1", header["xmp-data"])
    sizes = (image.yres, image.xres) if turned else (image.xres, image.yres)
    if min(sizes) > 0 and sizes != (1, 1):  # libvips' way to say unknown
        header["xres"], header["yres"] = sizes
    return header


def _unread(path: PathLike, image: Any, form: str) -> list[str]:
    """Name what is not in the header: what libvips misses or garbles, or what belongs to the old pixels."""
    found = {
        "EXIF": form == "TIFF" and _tiff_exif(path),
        "IPTC": form == "TIFF" and image.get_typeof("iptc-data"),
        "HDR gain map": image.get_typeof("gainmap-data"),
    }
    return [name for name, there in found.items() if there]


def _tiff_exif(path: PathLike) -> bool:
    """Tell whether a TIFF that libvips has opened points at EXIF or GPS, which libvips passes over."""
    with open(path, "rb") as file:
        head = file.read(16)
        order = "<" if head.startswith(b"II") else ">"
        big = head[2:4] in (b"+\0", b"\0+")
        file.seek(struct.unpack_from(order + "IQ"[big], head, 8 if big else 4)[0])
        (count,) = struct.unpack(order + "HQ"[big], file.read(8 if big else 2))
        step = 20 if big else 12
        entries = file.read(step * min(count, 4096))
    tags = (struct.unpack_from(order + "H", entries, at)[0] for at in range(0, len(entries), step))
    return any(tag in (34665, 34853) for tag in tags)


def _dressed(image: Any, like: Picture | None, form: _Format, colours: int) -> tuple[Any, list[str]]:
    """Give an image the header of another; name what of it the format cannot hold."""
    lost = []
    header = {} if like is None else dict(like._header)
    sizes = header.pop("xres", None), header.pop("yres", None)
    if like is not None and like.icc is not None:
        sign = like.icc[16:20]
        stored = colours if form.grey else max(3, colours)
        if _ICC_COLOURS.get(sign, stored) == stored:
            header["icc-profile-data"] = like.icc
        else:
            lost.append(f"the {sign.decode('latin-1').strip()} profile")
    if form is not _JPEG and header.pop("iptc-data", None):
        lost.append("IPTC")
    image = image.copy()
    for name, value in header.items():
        kind = pyvips.GValue.blob_type if isinstance(value, bytes) else pyvips.GValue.refstr_type
        image.set_type(kind, name, value)  # of EXIF this makes a field for every tag
    fields = image.get_fields()
    if form is _TIFF and any(name.startswith("exif-") and not _BARE.fullmatch(name) for name in fields):
        lost.append("EXIF")
    for name in fields:
        if name.startswith(_THUMBNAIL):  # it shows what was
            image.remove(name)
    image.set_type(pyvips.GValue.gint_type, "orientation", 1)
    if sizes[0] is None:
        sizes = (72 / 25.4, 72 / 25.4) if (image.xres, image.yres) == (1, 1) else (image.xres, image.yres)
    return image.copy(xres=sizes[0], yres=sizes[1]), lost


def _meaning(dtype: np.dtype[Any], colours: int, like: str) -> str:
    """Say in libvips' words what the channels are."""
    if like in ("cmyk", "lab", "labs") and _COLOURS.get(like, 3) == colours:
        return like
    if colours not in (1, 3):
        return "multiband"
    names = ("grey16", "rgb16") if dtype == np.uint16 else ("b-w", "scrgb" if dtype == np.float32 else "srgb")
    return names[colours == 3]


def _check(name: str, form: _Format, array: Array, meaning: str, alpha: bool) -> None:
    """Refuse what the format cannot hold."""
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise SuppleError(
            f"cannot write {name}: an image has shape (H, W) or (H, W, C), and not {array.shape}"
        )
    if array.dtype not in _VIPS or (form is not _TIFF and array.dtype not in (np.uint8, np.uint16)):
        advice = "write a TIFF" if array.dtype in _VIPS else "convert to uint8, uint16 or, for TIFF, float32"
        raise SuppleError(f"cannot write {name}: {form.name} takes no {array.dtype} values: {advice}")
    if alpha and not form.alpha:
        advice = "write PNG, TIFF, WebP or AVIF"
        raise SuppleError(f"cannot write {name}: {form.name} holds no transparency: {advice}")
    if meaning == "cmyk" and not form.cmyk:
        raise SuppleError(f"cannot write {name}: {form.name} holds no CMYK colours: write TIFF or JPEG")
    if meaning == "multiband" and form is not _TIFF:
        raise SuppleError(
            f"cannot write {name}: {form.name} does not hold {array.shape[2]} channels: write a TIFF"
        )
    if max(array.shape[:2]) > form.limit:
        size = f"{array.shape[1]} x {array.shape[0]}"
        advice = "write PNG or TIFF" if form.limit < _PNG.limit else "cut it into parts"
        limit = f"{form.name} ends at {form.limit} pixels on a side"
        raise SuppleError(f"cannot write {name}: {limit}, and the image has {size}: {advice}")


def _wrapped(array: Array, meaning: str, bits: int) -> Any:
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


def _options(form: _Format, array: Array, bits: int, quality: int | None, lossless: bool) -> dict[str, Any]:
    """Choose the settings of a libvips saver."""
    if form is _PNG:
        return {"compression": 6, "filter": "paeth"}
    if form is _JPEG:
        return {"Q": quality or 95, "subsample_mode": "off"}
    if form is _TIFF:
        predictor = "float" if array.dtype.kind == "f" else "horizontal"
        return {"compression": "deflate", "predictor": predictor, "bigtiff": array.nbytes >= 4_000_000_000}
    if form is _WEBP:
        return {"Q": quality or 90, "lossless": lossless, "exact": lossless, "smart_subsample": True}
    depth = {"bitdepth": bits, "compression": "av1", "subsample_mode": "off", "effort": 3}
    return {"Q": quality or 90, "lossless": lossless, **depth}  # effort 4 takes six times as long for 7 %


def _profile_name(icc: bytes) -> str | None:
    """Find the description in a colour profile, of either version."""
    try:
        (count,) = struct.unpack_from(">I", icc, 128)
        for entry in range(count):
            sign, start, size = struct.unpack_from(">4sII", icc, 132 + 12 * entry)
            if sign == b"desc":
                tag = icc[start : start + size]
                if tag.startswith(b"mluc"):
                    length, start = struct.unpack_from(">II", tag, 20)
                    return tag[start : start + length].decode("utf-16-be")
                (length,) = struct.unpack_from(">I", tag, 8)
                return tag[12 : 12 + length].rstrip(b"\0").decode("ascii", "replace")
    except (struct.error, UnicodeError):
        pass  # a broken profile has no name
    return None
