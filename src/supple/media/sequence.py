"""Image sequences, read and written: numbered files, all images of a folder, or an animated WebP."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvips

from supple.engine.stream import Frame
from supple.engine.work import Array, Group, Layout
from supple.errors import SuppleError, shown, warn
from supple.media import image as pictures
from supple.media.base import ClipWarning, FrameSource, LazyFrame
from supple.media.files import PathLike, check_outputs, first_bytes, replacing_all
from supple.media.image import ImageWarning, MetadataWarning, PageWarning, Picture, exr
from supple.media.image.formats import DTYPES, divided, is_exr
from supple.media.image.headers import collected, extra_of, facts
from supple.media.image.vips import apart, decoded, opened, reading, sequential, widen
from supple.media.numbering import first_number, has_number, matching, numbered, percent, pictures_in, spelling
from supple.media.pictures import SUFFIXES_OUT
from supple.space.checks import number

_WHITE = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}


class Pictures(FrameSource):
    """Images of one size and type, as the frames of a clip, in one group: a grid of pixels."""

    stills = True
    paths: list[Path]  # in order
    first: int | None  # the number of the first image, if the names are numbered
    starts: Sequence[int] = ()  # start times of the frames, and the end, in milliseconds; empty for a constant rate
    unpictured: tuple[str, ...] = ()  # streams that are lost in images: sound, subtitles
    extra: tuple[int, ...] = ()  # the meanings of the channels above the colours, as in `Picture`

    def __init__(self, name: str, paths: list[Path], rate: Fraction, first: int | None) -> None:
        self.name, self.paths, self.rate, self.first = name, paths, rate, first
        image, self.format = opened(paths[0])
        self.layout = _layout(paths[0], image)
        self.interpretation, self.extra = str(image.interpretation), _extra(image)
        if facts(image)[0] > 1:
            text = f"{shown(paths[0])} holds several pages or frames, and only one of each picture is read"
            warn(text, PageWarning)
        for path in paths[1:]:
            _require(path, _layout(path, opened(path)[0]), self.layout, shown(paths[0]))

    @property
    def count(self) -> int:  # type: ignore[override]
        """The number of frames."""
        return len(self.paths)

    @property
    def base(self) -> Fraction:  # type: ignore[override]
        """The unit of `time`, in seconds."""
        return Fraction(1, 1000) if self.starts else 1 / self.rate

    def time(self, k: int) -> tuple[int, int]:
        """Return the start and the duration of frame ``k`` in ticks of `base`."""
        return (self.starts[k], self.starts[k + 1] - self.starts[k]) if self.starts else (k, 1)

    @property
    def aspect(self) -> Fraction | None:  # type: ignore[override]
        """The width of a pixel, relative to its height; None but for OpenEXR."""
        return exr.head_only(self.paths[0])[0].aspect if self.paths and is_exr(self.paths[0]) else None

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order; each is read when it is copied."""
        return (LazyFrame(partial(self._read, path)) for path in self.paths)

    def _read(self, path: Path, arrays: Sequence[Array]) -> None:
        image, form = opened(path)
        _require(path, _layout(path, image), self.layout, "the first picture")
        _, orientation, bits = facts(image)
        with reading(path):
            pixels = apart(lambda: decoded(image, orientation), image)
        if extra_of(image) == (1,) and self.layout.groups[0].alpha:
            pixels = divided(pixels)
        np.copyto(arrays[0], pixels.reshape(arrays[0].shape))
        if form in ("AVIF", "HEIF") and 8 < bits < 16:
            widen(arrays[0], bits)

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        """Return a frame as RGB of 8 bits, or of 16 if ``deep``: shape (H, W, 3), without opacity.

        Colours are not converted, whatever their profile; floats are clipped to 0 to 1.
        """
        pixels = arrays[0][..., : self.layout.groups[0].channels - len(self.extra)]
        if pixels.shape[2] not in (1, 3) or self.interpretation in ("cmyk", "lab"):
            raise SuppleError(f"{self.name} holds neither grey nor RGB pictures: convert them first")
        white, dtype = (65535, np.uint16) if deep else (255, np.uint8)
        if pixels.dtype != dtype:
            scaled = np.clip(pixels * np.float32(white / self.layout.white), 0, white)
            pixels = np.rint(np.nan_to_num(scaled, copy=False)).astype(dtype)
        return np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))

    def upright(self, pixels: Array) -> Array:
        """Return a frame's pixels as it is displayed: images are read upright."""
        return pixels

    def picture(self, k: int) -> tuple[Picture, list[str]]:
        """Return the image of frame ``k`` with its header but without pixels, and the names of lost metadata."""
        path, group = self._place(k), self.layout.groups[0]
        image, form = opened(path)
        _, orientation, bits = facts(image)
        with reading(path):
            header, lost = collected(path, image, form, orientation >= 5)
        icc = header.pop("icc-profile-data", None)
        channels = (group.channels,) if group.channels > 1 else ()
        empty = np.empty((0, group.shape[1], *channels), self.layout.dtype)
        return Picture(empty, group.alpha, icc, bits, form, image.interpretation, 1, header, self.extra), lost

    def _place(self, k: int) -> Path:
        """Return the file of frame ``k``."""
        return self.paths[k]

    def info(self) -> dict[str, object]:
        """Return the facts for `supple info`."""
        (height, width), group = self.layout.shape, self.layout.groups[0]
        return {
            "width": width,
            "height": height,
            "frames": self.count,
            "channels": group.channels,
            "dtype": str(self.layout.dtype),
            "alpha": group.alpha,
            "format": self.format,
            "first": str(self.paths[0]),
            "last": str(self.paths[-1]),
            **(exr.info(self.paths[0]) if is_exr(self.paths[0]) else {}),
        }


class Layered(Pictures):
    """OpenEXR files as the frames of a clip, with all channels, over the box around the windows of all frames."""

    def __init__(self, name: str, paths: list[Path], rate: Fraction, first: int | None) -> None:
        self.name, self.paths, self.rate, self.first = name, paths, rate, first
        heads = [exr.head_only(path) for path in paths]
        (like, channels), self._heads = heads[0], [head for head, _ in heads]
        for path, (head, names) in zip(paths, heads, strict=True):
            if names != channels or head.display != like.display:
                what = "channels" if names != channels else "a display window"
                raise SuppleError(f"{shown(path)} has {what} other than {shown(paths[0])}: make them alike")
        held = exr.read(paths[0], exr.around([head.box for head in self._heads]))
        picture = pictures.of_layers(held)
        self.format, self.interpretation = picture.format, picture.interpretation
        groups = [Group(held.shape, n, exact=exact) for (exact, _), n in zip(held.groups, held.planes, strict=True)]
        self.layout = Layout(tuple(groups), np.dtype(np.float32), 1.0)
        self._like = replace(held, arrays=())
        if held.box != held.display:
            (x, y), (height, width) = held.corner, held.shown
            self.display = -x, -y, width, height
        pictures.warn_of_exact(held)

    def _read(self, path: Path, arrays: Sequence[Array]) -> None:
        held = exr.read(path, self._like.box)
        if held.groups != self._like.groups:
            raise SuppleError(f"{shown(path)} has channels of other types than the first picture: make them alike")
        for array, samples in zip(arrays, held.arrays, strict=True):
            np.copyto(array, samples)

    def layered(self, arrays: Sequence[Array], k: int) -> Picture:
        """Return frame ``k`` with other samples, and the header of its file."""
        head, like = self._heads[k], self._like
        return pictures.of_layers(replace(head, box=like.box, groups=like.groups, arrays=tuple(arrays)))


class Animation(Pictures):
    """The frames of an animated WebP, which FFmpeg does not decode, as a clip."""

    def __init__(self, path: PathLike) -> None:
        image, self.format = opened(path)
        self._path = Path(path)
        pages = facts(image)[0]
        if not first_bytes(path, 21)[-1] & 16:  # libvips adds opacity to all (test_an_opaque_animation_stays_opaque)
            image = image.extract_band(0, n=3)
        self.plays = image.get("loop") if image.get_typeof("loop") else None
        delays = image.get("delay") if image.get_typeof("delay") else []
        self.starts = list(itertools.accumulate((max(1, delay) for delay in delays), initial=0))
        if len(self.starts) != pages + 1:
            self.starts = [100 * k for k in range(pages + 1)]
        self.name, self.first, self.interpretation = shown(path), None, str(image.interpretation)
        self.extra = _extra(image)
        self.paths = [self._path.with_name(f"{k + 1:05d}.png") for k in range(pages)]  # the names of an output sequence
        self.rate = Fraction(1000 * pages, self.starts[-1])
        self.layout = _layout(self._path, image)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order, decoded one after the other."""
        height, width = self.layout.shape
        shape = (height, width, self.layout.groups[0].channels)
        with reading(self._path):
            tall = apart(lambda: sequential(self._path, n=-1)).extract_band(0, n=shape[2])
            region = pyvips.Region.new(tall)
            for k in range(self.count):
                data = apart(partial(region.fetch, 0, k * height, width, height), tall)
                samples = np.frombuffer(data, np.uint8).reshape(shape)
                yield LazyFrame(lambda arrays, samples=samples: np.copyto(arrays[0], samples))  # type: ignore[misc]

    def _place(self, k: int) -> Path:
        return self._path


@contextlib.contextmanager
def open_clip(path: PathLike, *, rate: float | Fraction = 24, target: PathLike | None = None) -> Iterator[Pictures]:
    """Open an image sequence as a clip.

    ``path`` is a pattern such as ``frames/%05d.png`` or ``frames/#####.png`` for consecutively numbered images, from
    any first number; a folder, for all its images, the 9th before the 10th; or an animated WebP, which has its own
    times. Frame rates such as 23.976 and 29.97 are rounded to 24000/1001 and 30000/1001. ``target`` is the output: all
    channels and windows of OpenEXR files are read only if it is a sequence of OpenEXR files, too.

    SuppleError if there are no such images, or one is missing, unreadable, or of another size or type than the first.
    """
    text, known = os.fspath(path), _rate(rate)
    if text.lower().endswith(".webp") and os.path.isfile(text):
        yield Animation(text)
        return
    first: int | None
    if has_number(text):
        paths, first = numbered(text)
    else:
        paths = pictures_in(Path(text))
        first = first_number(paths)
    if target is not None and is_exr(paths[0]):
        if (Path(target).suffix.lower() or paths[0].suffix.lower()) == ".exr":
            yield Layered(shown(text), paths, known, first)
            return
        if lost := exr.read(paths[0]).lost(exr=False):
            text = f"{shown(target)} cannot take over {' and '.join(lost)} of {shown(path)}"
            warn(text, MetadataWarning)
    yield Pictures(shown(os.fspath(path)), paths, known, first)


def _rate(rate: float | Fraction) -> Fraction:
    number("rate", rate, "a number of frames a second from 0.0001 to 100000", 1e-4, 1e5)
    known = Fraction(rate if isinstance(rate, Fraction | int) else float(rate))
    ntsc = Fraction(round(known * 1001 / 1000) * 1000, 1001)
    if known > 1 and known.denominator > 2 and abs(known - ntsc) < Fraction(1, 200):
        return ntsc
    return known.limit_denominator(100_000)


def _extra(image: Any) -> tuple[int, ...]:
    """Return the meanings of the channels above the colours; integers multiplied by opacity are divided by it."""
    extra = extra_of(image)
    return (2,) if extra == (1,) and np.dtype(DTYPES[image.format]).kind == "u" else extra


def _layout(path: Path, image: Any) -> Layout:
    _, orientation, _ = facts(image)
    shape = (image.width, image.height) if orientation >= 5 else (image.height, image.width)
    dtype = np.dtype(DTYPES[image.format])
    if dtype.name not in _WHITE:
        raise SuppleError(f"{shown(path)} holds {dtype} values: a frame must be of uint8, uint16 or float32")
    if len(extra := _extra(image)) > 1 and 2 in extra:
        raise SuppleError(f"{shown(path)} has opacity and other channels beside it: a frame may have one of them")
    return Layout((Group(shape, image.bands, alpha=extra == (2,)),), dtype, _WHITE[dtype.name])


def _require(path: Path, found: Layout, wanted: Layout, like: str) -> None:
    if found != wanted:
        raise SuppleError(f"{shown(path)} is {_described(found)}, and {like} {_described(wanted)}: make them alike")


def _described(layout: Layout) -> str:
    (height, width), group = layout.shape, layout.groups[0]
    opacity = " with opacity" if group.alpha else ""
    channels = f"{group.channels} channel{'s' if group.channels > 1 else ''}"
    return f"{width} x {height} of {channels}{opacity} in {layout.dtype}"


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a pattern whose suffix cannot be written; a folder may have any name."""
    if has_number(path):
        pictures.check_target(path)


class PictureSink:
    """A sink of frames: an image for each, in a hidden folder until all are complete."""

    aside = False

    def __init__(
        self, clip: Any, folder: Path, temporary: Path, names: Callable[[int], str], options: dict[str, Any]
    ) -> None:
        self._clip, self._folder, self._temporary, self._names = clip, folder, temporary, names
        self._options = options
        self._said: set[str] = set()
        if clip.aspect not in (None, 1):
            wide = f"pixels are {clip.aspect} as wide as high: they are left as they are stored"
            warn(f"{shown(folder / names(0))} cannot say that {wide}", ClipWarning)
        self.copied = 0  # the number of files copied from the source

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Write frame ``k``: arrays in the clip's layout."""
        name = self._names(k)
        clip, suffix = self._clip, Path(name).suffix.lower()
        kept = still and not isinstance(clip, Animation) and not any(self._options.values())
        if kept and isinstance(clip, Pictures) and suffix == clip.paths[k].suffix.lower():
            shutil.copyfile(clip.paths[k], self._temporary / name)
            self.copied += 1
            return
        self._save(k, *self._rendered(arrays, k))

    def _rendered(self, arrays: Sequence[Array], k: int) -> tuple[Array, Picture | None]:
        """Return the pixels of frame ``k``, (H, W, C), and a picture with its header, or None."""
        clip, layout = self._clip, self._clip.layout
        if isinstance(clip, Layered):
            return arrays[0], clip.layered(arrays, k)
        if isinstance(clip, Pictures):
            like, lost = clip.picture(k)
            if lost:
                text = f"{shown(clip.paths[k])}: {' and '.join(lost)} cannot be carried over"
                self._say(MetadataWarning, text, text.partition(": ")[2])
            return arrays[0], like
        pixels = clip.to_rgb(arrays, deep=layout.dtype.itemsize > 1)
        if layout.groups[0].alpha:
            white = np.iinfo(pixels.dtype).max
            opacity = np.rint(arrays[0][..., -1:] * (white / layout.white)).astype(pixels.dtype)
            pixels = np.concatenate([pixels, opacity], axis=2)
        return clip.upright(pixels), None

    def _save(self, k: int, pixels: Array, like: Picture | None) -> None:
        """Write the image of frame ``k``."""
        name = self._names(k)
        temporary, final = shown(self._temporary / name), shown(self._folder / name)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                # Some formats take grey only as an array of two axes.
                flat = pixels[..., 0] if pixels.shape[2] == 1 else pixels
                pictures.write(self._temporary / name, flat, like=like, **self._options)
            except SuppleError as error:
                raise SuppleError(str(error).replace(temporary, final)) from error
        for warning in caught:
            text = str(warning.message).replace(temporary, final)
            self._say(warning.category, text, text.replace(final, ""))

    def _say(self, category: type[Warning], text: str, kind: str) -> None:
        """Warn of each kind of loss once, not for every frame."""
        if kind not in self._said:
            self._said.add(kind)
            warn(text, category)


@contextlib.contextmanager
def writer(
    clip: Any,
    target: PathLike,
    *,
    force: bool = False,
    only: int | None = None,
    first: int = 1,
    **options: Any,
) -> Iterator[PictureSink]:
    """Write a clip's frames as images, which appear all together or not at all; or ``only`` one, as an image file.

    Each image gets the profile and the metadata of its source. A video's frames become RGB or RGBA of 8 bits, or of 16
    if it has more than 8 and they can be converted; and are turned upright. ``target`` is a pattern such as
    ``out/%05d.png``, or a folder, which is created if it is missing. Numbers, and names in a folder, are those of the
    source's images; a video's start at ``first``, 1 by default, and are ``%05d.png``. Unchanged frames of a sequence
    are copies of its files, if these are of the same format. ``options`` are ``quality``, ``lossless`` and
    ``compression``, as in `supple.media.image.write`.

    SuppleError if an image exists already, the format cannot hold these pixels, or nothing can be written there.
    """
    text = os.fspath(target)
    check_target(text)
    name: Callable[[int], str]
    if only is not None:
        folder, name = Path(text).parent, lambda _: Path(text).name
    elif has_number(text):
        spell = spelling(Path(percent(text)).name, text)
        start = clip.first if isinstance(clip, Pictures) and clip.first is not None else first
        folder, name = Path(text).parent, lambda k: spell(start + k)
    else:
        folder, name = Path(text), _mirrored(clip, first)
    listed = [name(k) for k in (range(clip.count) if only is None else (only,))]
    check_outputs((folder / each for each in listed), force=force)
    if clip.unpictured and only is None:
        text = f"{shown(folder)} gets pictures alone, without the {' and the '.join(clip.unpictured)} of {clip.name}"
        warn(text, ClipWarning)
    with replacing_all(folder, force=force) as temporary:
        yield PictureSink(clip, folder, temporary, name, options)
        there: list[Path] = []
        with contextlib.suppress(OSError, SuppleError):
            there = matching(text)[0] if has_number(text) else pictures_in(folder)
        left = len({path.name for path in there} - set(listed))
        if left and only is None:
            text = f"{shown(folder)} also holds {left} other pictures, which are left as they were"
            warn(text, ImageWarning)


def _mirrored(clip: Any, first: int) -> Callable[[int], str]:
    """Return the names in a folder: those of the source, in a writable format."""
    if not isinstance(clip, Pictures):
        return lambda k: f"{first + k:05d}.png"
    other = ".tif" if clip.layout.dtype.kind == "f" else ".png"
    names = [p.name if p.suffix.lower() in SUFFIXES_OUT else p.with_suffix(other).name for p in clip.paths]
    taken: dict[str, Path] = {}
    for path, name in zip(clip.paths, names, strict=True):
        if taken.setdefault(name, path) != path:
            raise SuppleError(f"{shown(taken[name])} and {shown(path)} would both become {shown(name)}: rename one")
    return names.__getitem__
