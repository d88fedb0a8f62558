"""Freeze masks from files: pictures, and labels of volumes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from supple.errors import FreezeWarning, SuppleError, shown, warn
from supple.files.clips import open_clip
from supple.media import image, volume
from supple.media.base import CountError
from supple.media.files import PathLike
from supple.media.medium import Clip, opened
from supple.space.freezing import Freeze
from supple.space.geometry import Geometry, check_upright

_COLOURED = 12  # the largest difference between channels, of 255, in grey of lossy codecs


def read_freeze(path: PathLike, *, label: int | None = None, width: float | None = None) -> Freeze:
    """Read a freeze mask.

    The file is a grey picture, in which white is frozen, and grey in part; or a volume, in which all but 0 is frozen;
    or a label map, in which one ``label`` is frozen. ``width`` is that of the fade beside the frozen region, in pixels,
    or millimetres for a volume; by default as in `Freeze.of`. SuppleError if the file cannot be read, has colours, or
    does not contain the label; a FreezeWarning if nothing is frozen.
    """
    if volume.is_volume(path):
        held = volume.read(path)
        check_upright(held.geometry, held.name, "a freeze mask")
        if held.samples.ndim != 3:
            raise SuppleError(f"{held.name} cannot be a freeze mask: it has several values for a voxel, or times")
        grid = held.grid
        samples, whole = np.asarray(held.samples), True
        if held.scaling != (1, 0):  # rounded, so that scaled integers stay integers
            samples = np.round(held.rescaled(), 5)
        place = () if held.geometry.convention == "array" else tuple(grid.matrix[:3].ravel().tolist())
        spacing = grid.spacing
    else:
        samples, whole, place, spacing = _grey(path), False, (), (1.0, 1.0)
    mask = _frozen(samples, label, path, whole=whole)
    made = Freeze.of(mask, width=width, spacing=spacing, place=place, name=os.fspath(path))
    if made.is_free:
        seen, frozen = ("0", "all but 0") if whole else ("black", "white")
        text = f"nothing is frozen in {shown(path)}: all of it is {seen}, and {frozen} is frozen"
        warn(text, FreezeWarning)
    return made


def write_freeze(
    path: PathLike, freeze: Freeze, shape: Sequence[int], geometry: Geometry | None = None, *, force: bool = False
) -> None:
    """Write the fully frozen region of a mask; `read_freeze` returns such a mask, but for single samples at its edge.

    For a shape (H, W) or (T, H, W), the file is a grey picture (H, W), white where it is frozen; otherwise a volume, 1
    where it is frozen. SuppleError if the mask changes from frame to frame, or the file cannot be written.
    """
    if freeze.ndim == 3 and geometry is None:
        raise SuppleError("the freeze mask changes from frame to frame, and a picture holds one: save the recipe")
    frozen = freeze.shown(shape[-freeze.ndim :]) == 0
    for axis, n in enumerate(frozen.shape):  # shrunk by a sample on each side, which reading adds
        row = np.arange(n)
        frozen = frozen & frozen.take(np.maximum(row - 1, 0), axis) & frozen.take(np.minimum(row + 1, n - 1), axis)
    if freeze.ndim == 2:
        image.write(path, frozen * np.uint8(255), force=force)
    else:
        labels = frozen.astype(np.uint8)
        volume.write(path, labels, volume.Volume(labels, geometry or Geometry()), force=force)


def read_matte(path: PathLike, *, width: float | None = None) -> Freeze:
    """Read a matte of strokes (`Stroke.matte`): a picture, or a clip or an image sequence, which moves.

    Strokes apply in full where it is white; the matte is opacity, if it varies, and otherwise grey. ``width`` is that
    of the fade inside the white region, in pixels, as in `Freeze`. SuppleError if it cannot be read, or has colours.
    """
    name = os.fspath(path)
    if opened(path, "x.mp4" if os.path.isdir(path) else "").kind == "clip":
        with open_clip(path) as clip:
            return Freeze.matte_of(_greys(clip), clip.count, width=width, name=name)
    picture = image.read(path)
    opacity = picture.pixels[..., -1] if picture.alpha else None
    if opacity is None or (opacity == opacity.flat[0]).all():
        opacity = _grey(path, "a matte")
    return Freeze.of(opacity, width=width, name=name, matte=True)


def _greys(clip: Clip) -> Iterator[npt.NDArray[np.float32]]:
    """Yield the grey values of a clip's frames, or their opacity if they have it, from 0 to 1."""
    layout = clip.layout
    arrays = [np.empty((*group.shape, group.channels), layout.dtype) for group in layout.groups]
    with contextlib.suppress(CountError):  # a wrong length is refused later
        for frame in clip.frames():
            frame.copy_to(arrays)
            if layout.groups[0].alpha:
                yield np.clip(arrays[0][..., -1] / np.float32(layout.white), 0, 1, dtype=np.float32)
                continue
            colours = clip.to_rgb(arrays)
            if np.ptp(colours, axis=2).max() > _COLOURED:
                what = "it has colours; give a grey one, or one with opacity"
                raise SuppleError(f"{clip.name} cannot be a matte: {what}")
            yield np.divide(colours[..., 1], 255, dtype=np.float32)


def _grey(path: PathLike, what: str = "a freeze mask") -> npt.NDArray[np.generic]:
    """Return the only channel of a picture, in its own dtype; SuppleError if it has colours."""
    pixels = image.read(path).pixels
    if pixels.ndim == 2:
        return pixels
    colours, opacity = (pixels[..., :-1], pixels[..., -1]) if pixels.shape[2] in (2, 4) else (pixels, None)
    if opacity is not None and np.any(opacity != opacity.flat[0]):
        raise SuppleError(f"{shown(path)} cannot be {what}: parts of it are transparent; give a grey picture")
    if np.any(colours != colours[..., :1]):
        raise SuppleError(f"{shown(path)} cannot be {what}: it has colours; give a grey picture")
    return np.ascontiguousarray(colours[..., 0])


def _frozen(
    samples: npt.NDArray[np.generic], label: int | None, path: PathLike, *, whole: bool
) -> npt.NDArray[np.generic]:
    """Return the mask of samples: of a label, of all but 0 in a volume, or of grey values."""
    if label is not None:
        made = samples == label
        if not made.any():
            known = np.unique(samples)
            some = ", ".join(f"{x:g}" for x in known[:8]) + (", …" if len(known) > 8 else "")
            raise SuppleError(f"{shown(path)} holds no label {label}: found {some}")
        return np.asarray(made)
    if whole:
        return np.asarray(samples != 0)
    if samples.dtype.kind in "iu":
        known = np.unique(samples)
        white = float(np.iinfo(str(samples.dtype)).max)
        if len(known) > 2 and 4 * float(known[-1]) < white:
            raise SuppleError(
                f"{shown(path)} seems to hold labels, as its values go from {known[0]} to {known[-1]} of {white:g}: "
                "say which one is frozen"
            )
    return samples
