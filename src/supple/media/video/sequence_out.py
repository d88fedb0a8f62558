"""Frames of any clip, written as pictures: numbered, or into a folder."""

from __future__ import annotations

import contextlib
import inspect
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple.engines.base import Layout
from supple.errors import SuppleError, shown
from supple.media.folder import check_outputs, replacing_all
from supple.media.image import SUFFIXES_OUT, ImageWarning, MetadataWarning, PathLike, check_target, write
from supple.media.numbering import has_number, matching, pictures_in, spelling
from supple.media.video.sequence import Pictures

Array = npt.NDArray[Any]


class Clip(Protocol):
    """A clip of any kind, as a writer of pictures sees it."""

    @property
    def layout(self) -> Layout:
        """The layout of its frames."""

    @property
    def count(self) -> int:
        """How many frames it has."""

    @property
    def to_rgb(self) -> Callable[..., Array]:
        """A frame as RGB of 8 bits, (H, W, 3); of 16 bits, if it takes ``deep=True``."""


class Sink:
    """Where frames are written to: a picture for each, in a hidden folder until all are there."""

    def __init__(
        self, clip: Clip, folder: Path, temporary: Path, names: Callable[[int], str], options: dict[str, Any]
    ) -> None:
        self._clip, self._folder, self._temporary, self._names = clip, folder, temporary, names
        self._options = options
        self.aside = False
        self._said: set[str] = set()

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Write frame ``k``: arrays as the clip's layout says."""
        name = self._names(k)
        like = None
        if isinstance(self._clip, Pictures):
            like, lost = self._clip.picture(k)
            pixels = arrays[0]
            if lost:
                text = f"{shown(self._clip.paths[k])}: {' and '.join(lost)} cannot be carried over"
                self._say(MetadataWarning, text, text.partition(": ")[2])
        else:
            pixels = self._as_rgb(arrays)
        temporary, final = shown(self._temporary / name), shown(self._folder / name)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                # Formats without grey of three axes take that of two.
                flat = pixels[..., 0] if pixels.shape[2] == 1 else pixels
                write(self._temporary / name, flat, like=like, **self._options)
            except SuppleError as error:
                raise SuppleError(str(error).replace(temporary, final)) from error
        for warning in caught:
            text = str(warning.message).replace(temporary, final)
            self._say(warning.category, text, text.replace(final, ""))

    def _as_rgb(self, arrays: Sequence[Array]) -> Array:
        """A video's frame, upright, in RGB or RGBA."""
        layout = self._clip.layout
        deep = layout.dtype.itemsize > 1 and "deep" in inspect.signature(self._clip.to_rgb).parameters
        pixels = self._clip.to_rgb(arrays, deep=True) if deep else self._clip.to_rgb(arrays)
        if layout.groups[0].alpha:
            white = np.iinfo(pixels.dtype).max
            opacity = np.rint(arrays[0][..., -1:] * (white / layout.white)).astype(pixels.dtype)
            pixels = np.concatenate([pixels, opacity], axis=2)
        # What a player turns by, counterclockwise: pictures are stored as they are looked at.
        return np.rot90(pixels, round(getattr(self._clip, "rotation", 0) / 90))

    def _say(self, category: type[Warning], text: str, kind: str) -> None:
        """Warn of each kind of trouble once, not for every frame."""
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(text, category, stacklevel=3)


@contextlib.contextmanager
def sequence_writer(
    target: PathLike, clip: Clip, *, force: bool = False, quality: int | None = None, lossless: bool = False
) -> Iterator[Sink]:
    """Write a clip's frames as pictures, which appear all together or not at all.

    Parameters
    ----------
    target : str or os.PathLike
        A pattern such as ``out/%05d.png``, or a folder, which is made if it is missing. Numbers are those of the
        source's pictures; a video's count from 1. In a folder, the names are the source's; a video's are ``%05d.png``.
    clip : Pictures, or any `Clip`
        Where the frames are from: each picture gets the profile, the EXIF and the like of its source. A video's
        become RGB or RGBA of 8 bits, or of 16 where it has more than 8 and can give them; and are turned upright.
    force : bool
        Whether pictures that exist may be replaced.
    quality, lossless
        As `supple.media.image.write` takes them.

    Yields
    ------
    Sink

    Raises
    ------
    SuppleError
        A picture exists already, the format cannot hold these pixels, or nothing can be written there.
    """
    text = os.fspath(target)
    if has_number(text):
        check_target(text)
        folder, name = Path(text).parent, _numbers(clip, text)
    else:
        folder, name = Path(text), _mirrored(clip)
    listed = [name(k) for k in range(clip.count)]
    check_outputs((folder / each for each in listed), force=force)
    options = {"quality": quality, "lossless": lossless}
    _tell_of_streams(clip, folder)
    with replacing_all(folder, force=force) as temporary:
        yield Sink(clip, folder, temporary, name, options)
        left = len(set(_others(folder, text)) - set(listed))
        if left:
            text = f"{shown(folder)} also holds {left} other pictures, which are left as they were"
            warnings.warn(text, ImageWarning, stacklevel=3)


def _tell_of_streams(clip: Clip, folder: Path) -> None:
    """Warn that pictures hold no sound and no subtitles."""
    source = getattr(clip, "source", None)
    sorts = {"audio": "sound", "subtitle": "subtitles"}
    lost = [sorts[kind] for kind in sorts if source and any(stream.type == kind for stream in source.streams)]
    if lost:
        from supple.media.video.errors import ClipWarning  # which imports PyAV: a video has done so already

        name = getattr(clip, "name", "the video")
        text = f"{shown(folder)} gets pictures alone, without the {' and the '.join(lost)} of {name}"
        warnings.warn(text, ClipWarning, stacklevel=4)


def _numbers(clip: Clip, text: str) -> Callable[[int], str]:
    """The names of a pattern: with the numbers of the source."""
    spell = spelling(Path(text).name, text)
    first = clip.first if isinstance(clip, Pictures) and clip.first is not None else 1
    return lambda k: spell(first + k)


def _mirrored(clip: Clip) -> Callable[[int], str]:
    """The names in a folder: those of the source, in a format that can be written."""
    if not isinstance(clip, Pictures):
        return lambda k: f"{k + 1:05d}.png"
    other = ".tif" if clip.layout.dtype.kind == "f" else ".png"
    names = [p.name if p.suffix.lower() in SUFFIXES_OUT else p.with_suffix(other).name for p in clip.paths]
    taken: dict[str, Path] = {}
    for path, name in zip(clip.paths, names, strict=True):
        if taken.setdefault(name, path) != path:
            raise SuppleError(f"{shown(taken[name])} and {shown(path)} would both become {shown(name)}: rename one")
    return names.__getitem__


def _others(folder: Path, text: str) -> list[str]:
    """The pictures that stand where a sequence was written."""
    with contextlib.suppress(OSError, SuppleError):
        if has_number(text):
            return [path.name for path in matching(text)[0]]
        return [path.name for path in pictures_in(folder)]
    return []
