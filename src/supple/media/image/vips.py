"""Image files opened and decoded by libvips, and its errors in one sentence."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pyvips

from supple.errors import SuppleError
from supple.media.files import PathLike, head_of, refusing, unreadable, unwritable
from supple.media.image import dpx, foreign
from supple.media.image.formats import DTYPES, LOADERS, Array, codec_of, damaged, of_pixels
from supple.media.image.headers import EXTRA, facts, png_frames
from supple.media.image.tiff import Page
from supple.media.pictures import EXR_MAGIC

if TYPE_CHECKING:
    from supple.media.image import exr

T = TypeVar("T")

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def opened(path: PathLike) -> tuple[Any, str]:
    """Open an image for one sequential read; return its format, too."""
    kinds = "give a PNG, JPEG, TIFF, WebP, AVIF or GIF file"
    head = head_of(path, 64, kinds, kinds)
    if head.startswith(EXR_MAGIC):
        from supple.media.image import exr

        return of_exr(exr.read(path).alone()), "OpenEXR"
    if kind := foreign.kind_of(path, head):
        return foreign.opened(path, kind), kind
    try:
        image = of_tiff(path) if head.startswith(_TIFF) else apart(lambda: sequential(path))
    except SuppleError:
        raise
    except (pyvips.Error, ArithmeticError, ValueError) as error:
        if (codec := codec_of(path, head)) is None:
            raise _damaged(path, error) from error
        return _by_ffmpeg(path, *codec)
    form = LOADERS.get(str(image.get("vips-loader")).partition("load")[0])
    if form is None or image.format not in DTYPES or image.coding != "none":
        raise damaged(path)
    if form == "PNG" and (frames := png_frames(path)) > 1:  # libvips reads only the first
        image = image.copy()
        image.set_type(pyvips.GValue.gint_type, "n-pages", frames)
    return image, form


def pages_of(path: PathLike) -> tuple[str, int]:
    """Return the format of an image, and the number of its pages or frames; ("", 0) if it cannot be read."""
    try:
        image, form = opened(path)
    except SuppleError:
        return "", 0
    return form, facts(image)[0]


def _by_ffmpeg(path: PathLike, codec: str, form: str) -> tuple[Any, str]:
    """Decode an image that libvips does not support."""
    from supple.media.image import ffmpeg

    header = dpx.header_of(path) if form == "DPX" else b""
    with ffmpeg.reading(path):
        pixels, bits = ffmpeg.decoded(path, codec)
    image = of_pixels(pixels, bits, pixels.ndim == 3 and pixels.shape[2] in (2, 4))
    if header:
        image.set_type(pyvips.GValue.blob_type, "dpx", header)
    return image, form


def of_exr(held: exr.Exr) -> Any:
    """Return the picture of an OpenEXR, with premultiplied colours, which are averaged as such."""
    pixels = held.arrays[0]
    image = of_pixels(pixels, held.bits)
    if pixels.shape[2] in (2, 4):
        image.set_type(pyvips.GValue.refstr_type, EXTRA, "1")
    return image


# Kept: libvips takes YCbCr for RGB (test_a_tiff_in_ycbcr_that_pillow_wrote), divides colours by their opacity
# (test_premultiplied_colours_stay_so_in_tiff_alone), and reads neither doubles nor planes of tiles (test_planes).
def of_tiff(path: PathLike, number: int = 0) -> Any:
    """Open a page of a TIFF; decode what libvips reads wrongly."""
    page = Page(path, number)
    options: dict[str, Any] = {"page": number, "fail_on": page.fails_on}
    if page.is_plain or page.is_ycbcr:
        image = apart(lambda: sequential(path, **options)).copy()
    if page.is_ycbcr:
        from supple.media.image import ffmpeg

        if number:
            raise unreadable(path, "a page after the first is in YCbCr, which is not supported", "convert it to RGB")
        with ffmpeg.reading(path):
            image = _with_header(of_pixels(*ffmpeg.decoded(path, "tiff")), image)
    elif not page.is_plain:
        source = pyvips.Source.new_from_memory(page.retagged())
        header = apart(lambda: sequential(source, **options))
        pixels = page.decoded(lambda: apart(lambda: decoded(header, 1), header))
        image = _with_header(of_pixels(pixels, page.bits, len(page.tiff.extra)), header)
    if page.tiff.meaning:
        image = image.copy(interpretation=page.tiff.meaning)
    if page.tiff.extra:
        image.set_type(pyvips.GValue.refstr_type, EXTRA, " ".join(map(str, page.tiff.extra)))
    return image


def _with_header(made: Any, image: Any) -> Any:
    made = made.copy(xres=image.xres, yres=image.yres)
    for name in image.get_fields():
        if made.get_typeof(name) == 0:
            made.set_type(image.get_typeof(name), name, image.get(name))
    return made


def sequential(path: PathLike | pyvips.Source, *, fail_on: str = "error", **options: Any) -> Any:
    """Open a file with libvips for one sequential read; decoding stops at errors, or also at warnings."""
    # a source, since libvips would parse "[...]" in a file's name as options, and cache the image
    source = path if isinstance(path, pyvips.Source) else pyvips.Source.new_from_file(os.fsencode(path))
    return pyvips.Image.new_from_source(source, "", access="sequential", fail_on=fail_on, **options)


def apart(work: Callable[[], T], image: Any = None) -> T:
    """Run work of libvips in another thread: on this one, libvips' callbacks would print and swallow an interrupt."""
    return together([work], [] if image is None else [image])[0]


def together(works: Sequence[Callable[[], T]], images: Sequence[Any]) -> list[T]:
    """Run works of libvips on images in threads of their own, as `apart`."""
    with ThreadPoolExecutor(len(works)) as threads:
        futures = [threads.submit(work) for work in works]
        try:
            return [future.result() for future in futures]
        except BaseException:
            for image in images:
                image.set_kill(True)  # otherwise, it would run to the end
            raise


def reading(path: PathLike) -> contextlib.AbstractContextManager[None]:
    """Convert all errors to one sentence."""
    kinds = pyvips.Error, OSError, ArithmeticError, ValueError, MemoryError
    return refusing(lambda error: _damaged(path, error), *kinds)


def writing(path: PathLike) -> contextlib.AbstractContextManager[None]:
    """Convert libvips' errors to an `OSError` if the system refused, else to one sentence."""

    def refused(error: Exception) -> Exception:
        text = getattr(error, "detail", "")
        if found := re.search("system error: (.+)", text):
            return OSError(next((code for code in errno.errorcode if os.strerror(code) == found[1]), -1), found[1])
        return unwritable(path, f"libvips fails ({_reason(text) or error})", "try another format")

    return refusing(refused, pyvips.Error, UnicodeError)


def _damaged(path: PathLike, error: Exception) -> SuppleError:
    """Return an error that explains in one sentence why a file was not read, with libvips' relevant line, if any."""
    text = getattr(error, "detail", "")
    if isinstance(error, MemoryError) or "out of memory" in text:
        tiff = os.fspath(path).lower().endswith((".tif", ".tiff"))
        advice = "bend it to a Zarr store, block by block: out.zarr" if tiff else "cut it into parts"
        return unreadable(path, "it is too large for the memory", advice)
    return damaged(path, _reason(text))


def _reason(text: str) -> str:
    for line in map(str.strip, text.splitlines()):
        if line and not re.search("bad seek|not in a known format", line):
            return re.sub(r"^\w+: ", "", line)  # without the name of libvips' module
    return ""


def decoded(image: Any, orientation: int) -> Array:
    """Decode all pixels into one array, upright."""
    shape = (image.height, image.width, image.bands) if image.bands > 1 else (image.height, image.width)
    pixels = np.frombuffer(image.write_to_memory(), DTYPES[image.format]).reshape(shape)
    upright = pixels[:: -1 if orientation in (3, 4, 6, 7) else 1, :: -1 if orientation in (2, 3, 7, 8) else 1]
    return np.ascontiguousarray(upright.swapaxes(0, 1) if orientation >= 5 else upright)


def widen(pixels: Array, bits: int) -> None:
    """Fill the low bits, which libvips leaves empty, so that white is 65535."""
    pixels |= pixels >> bits
