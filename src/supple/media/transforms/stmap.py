"""STMaps of compositors: images whose red and green are each pixel's source position, normalised.

Red, s, goes from 0 at the left edge of the source to 1 at its right edge; green, t, from 0 at the bottom to 1 at the
top, as in Nuke: a map that changes nothing holds ((x + 0.5) / W, 1 - (y + 0.5) / H), y down. OpenImageIO's ``st_warp``
reads it with ``flip_t``.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import OutsideWarning, shown
from supple.media import image
from supple.media.files import PathLike, check_suffix, unreadable, unwritable
from supple.media.image import exr
from supple.media.transforms.base import Array, Content, Grids
from supple.media.transforms.positions import of_positions, to_positions

SUFFIXES = (".exr", ".tif", ".tiff", ".png")
SUFFIXES_OUT = (".exr", ".tif", ".tiff")
_PAIRS = (("R", "G"), ("S", "T"), ("U", "V"), ("X", "Y"))
_WHITE = 65_535
_WANTED = "an STMap needs red and green of 16 or 32 bits"


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read an STMap, in pixels; beyond its edges, it goes on as at the edge.

    It is an ``.exr`` of 16 or 32 bits, of which half floats are exact to about a 4000th of the source; a ``.tif``,
    ``.tiff`` or ``.png`` of 16 bits, exact to half a 65535th of the source; or a ``.tif`` of 32. Blue is not read.
    Neither is opacity if it is the same everywhere, as in maps that were made without it: where it is transparent, a
    map is not defined.

    1 stands for the width and the height of the source; by default, of the map. An EXR's are those of its display
    window; pixels beyond it (overscan) are kept.
    """
    source = grids.source
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, SUFFIXES, "is of no STMap", f"use {', '.join(SUFFIXES)}", "read")
    s, t, opacity, first, own = (_exr if suffix == ".exr" else _picture)(path)
    if opacity is not None and (thin := np.count_nonzero(opacity != opacity.flat[0])):
        what = f"its opacity changes, at {thin} pixels, and where it is transparent an STMap is not defined"
        raise unreadable(path, what, "fill these parts, or write it without alpha")
    (height, width), (x0, y0) = s.shape, first
    if x0 > 0 or y0 > 0 or x0 + width < own[0] or y0 + height < own[1]:
        text = f"{shown(path)} holds {width} x {height} pixels of its {own[0]} x {own[1]}: beyond, its edge goes on"
        warnings.warn(text, OutsideWarning, stacklevel=2)
    if source is not None and source.ndim != 2:
        raise unreadable(path, "an STMap is of a picture, and the source is a volume", "give the grid of a picture")
    width, height = own if source is None else source.sizes
    x, y = (s.astype(np.float64) * width - 0.5, (1 - t.astype(np.float64)) * height - 0.5)
    (found,) = (of_positions(path, x, y, first),)
    return (found._replace(values=found.values.astype(np.float32)),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write an STMap, with blue at 0; 1 stands for the width and the height of the source, by default the field's.

    An ``.exr`` is of 32-bit floats; ``.tif`` and ``.tiff`` of 16-bit integers, which round positions to half a 65535th
    of the source: to 0.03 pixels, if it is 4096 wide. They hold no positions outside of it.
    """
    source = grids.source
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, SUFFIXES_OUT, "is of no STMap", f"use {', '.join(SUFFIXES_OUT)}")
    places = to_positions(path, contents, "an STMap")
    if source is not None and source.ndim != 2:
        raise unwritable(path, "an STMap is of a picture, and the source is a volume", "give the grid of a picture")
    width, height = places.shape[1::-1] if source is None else source.sizes
    st = (places + 0.5) / (width, height)
    st[..., 1] = 1 - st[..., 1]
    if suffix == ".exr":
        red, green = (np.ascontiguousarray(st[..., i], np.float32) for i in range(2))
        image.write(path, np.stack([red, green, np.zeros_like(red)], axis=-1), force=force)
        return
    if outside := np.count_nonzero(((st < 0) | (st > 1)).any(axis=-1)):
        raise unwritable(path, f"{outside} positions are outside the source, and a TIFF ends there", "write an EXR")
    pixels = np.zeros((*st.shape[:2], 3), np.uint16)
    pixels[..., :2] = np.rint(st * _WHITE)
    image.write(path, pixels, force=force)


_Planes = tuple[Array, Array, Array | None, tuple[int, int], tuple[int, int]]


def _picture(path: PathLike) -> _Planes:
    """Return s, t, the opacity, the first pixel and the size of a picture."""
    found = image.read(path)
    pixels = found.pixels
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.dtype not in (np.uint16, np.float32, np.float64) or channels - found.alpha < 2:
        raise unreadable(path, f"it has {channels} channels of {pixels.dtype}", _WANTED)
    scaled = pixels if pixels.dtype.kind == "f" else pixels / np.float64(_WHITE)
    opacity = pixels[..., -1] if found.alpha else None
    return scaled[..., 0], scaled[..., 1], opacity, (0, 0), (pixels.shape[1], pixels.shape[0])


def _exr(path: PathLike) -> _Planes:
    """Return s, t, the opacity, the first pixel and the size of an EXR."""
    with exr.opened(path) as file:
        names, header = dict(file.channels()), file.header()
        windows = [np.array(header[key], np.int64) for key in ("dataWindow", "displayWindow")]
    pairs = _pairs(names)
    if len(pairs) != 1:
        which = "more than one pair" if pairs else "no pair"
        raise unreadable(path, f"its channels {', '.join(names)} hold {which} of s and t", _WANTED)
    ((red, green),) = pairs
    planes = [names[name].pixels for name in (red, green)]
    if any(plane.dtype.kind != "f" for plane in planes):
        raise unreadable(
            path, f"its channels {red} and {green} are of {planes[0].dtype}", "write floats of 16 or 32 bits"
        )
    alpha = names.get(red.rpartition(".")[0] + "." * ("." in red) + "A")
    (low, _), (least, most) = windows
    first = tuple((low - least).tolist())
    own = tuple((most - least + 1).tolist())
    return planes[0], planes[1], None if alpha is None else alpha.pixels, (first[0], first[1]), (own[0], own[1])


def _pairs(names: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the channels of s and t: those without a layer, or else those of all layers."""
    found = []
    for name in names:
        layer, dot, channel = name.rpartition(".")
        for one, other in _PAIRS:
            if channel.upper() == one:
                mates = [n for n in names if n.upper() == f"{layer}{dot}{other}".upper()]
                found += [(name, mate) for mate in mates]
    plain = [pair for pair in found if "." not in pair[0]]
    coloured = [pair for pair in plain if pair[0] == "R"]
    return coloured or plain or found
