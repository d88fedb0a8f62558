"""OpenEXR files by the package OpenEXR: the channels of all parts, data and display windows, and attributes.

Channels of colour (R, G, B, A and Y, of any layer) are filtered. Averages of ids, cryptomattes, depths, normals,
positions and vectors would mean nothing: these channels are exact, and each pixel takes the values of the nearest one.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from supple.errors import listing, need
from supple.media.files import PathLike, head_of, unreadable, unwritable
from supple.media.image.formats import EXR_MAGIC, Array, damaged

Box = tuple[int, int, int, int]  # x and y of the first pixel, and of that after the last

_COLOURS = {"r": "r", "red": "r", "g": "g", "green": "g", "b": "b", "blue": "b", "a": "a", "alpha": "a", "y": "y"}
_MAIN = ("", "rgba", "rgb", "combined", "beauty")  # the layers that hold the picture itself, best first
_DATA = re.compile(
    "(?i)crypto|depth|normal|position|motion|velocity|vector|^(z|id|n|p|uv|st|pref|pworld|index\\w*|\\w+_?id)$"
)
_OWN = {"channels", "chunkCount", "compression", "dataWindow", "displayWindow", "dwaCompressionLevel", "lineOrder",
        "name", "pixelAspectRatio", "preview", "screenWindowCenter", "screenWindowWidth", "tiles", "type",
        "version"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a part, and its type in the file."""

    part: int
    name: str
    dtype: np.dtype[Any]

    @property
    def planes(self) -> int:
        """The number of planes of float32 that hold it: two for uint32, of 16 bits each."""
        return 2 if self.dtype.kind == "u" else 1


@dataclass(frozen=True, slots=True, eq=False)
class Exr:
    """An OpenEXR, with its channels as arrays over one box.

    Parameters
    ----------
    attributes : tuple of dict
        The header of each part.
    windows : tuple of Box
        The data window of each part.
    display, box : Box
        The display window; and what the arrays cover.
    groups : tuple of (bool, tuple of Channel)
        Whether the channels of an array are exact, and which they are: first the picture's own.
    arrays : tuple of float32 arrays, shape (H, W, planes)
        One for each group.
    left : tuple of str
        Channels that are not held.
    """

    attributes: tuple[Mapping[str, Any], ...]
    windows: tuple[Box, ...]
    display: Box
    box: Box
    groups: tuple[tuple[bool, tuple[Channel, ...]], ...]
    arrays: tuple[Array, ...] = ()
    left: tuple[str, ...] = ()

    @property
    def shown(self) -> tuple[int, int]:
        """Rows and columns of the display window."""
        return _shape(self.display)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the box."""
        return _shape(self.box)

    @property
    def aspect(self) -> Fraction | None:
        """The width of a pixel, relative to its height; None if the header has no number above 0."""
        said = float(self.attributes[0].get("pixelAspectRatio", 0.0))
        return Fraction(said).limit_denominator(1000) or None if 0 < said < math.inf else None

    @property
    def corner(self) -> tuple[int, int]:
        """The place of the box's first pixel in the display window, x first."""
        return self.box[0] - self.display[0], self.box[1] - self.display[1]

    @property
    def bits(self) -> int:
        """Bits of the picture's own channels."""
        return max(channel.dtype.itemsize * 8 for channel in self.groups[0][1])

    @property
    def planes(self) -> tuple[int, ...]:
        """The number of planes of each group."""
        return tuple(sum(channel.planes for channel in channels) for _, channels in self.groups)

    def lost(self, *, exr: bool) -> list[str]:
        """Return what a file does not take over of it, in words: an OpenEXR, or one of another format."""
        names = [channel.name for _, channels in self.groups[1:] for channel in channels]
        own = sorted({name for each in self.attributes for name in each} - _OWN)
        parts = [("channel", self.left)] if exr else [("channel", self.left or names), ("attribute", own)]
        told = [f"the {what}{'s' * (len(some) > 1)} {listing(some, 6)}" for what, some in parts if some]
        levels = any(each["tiles"].mode.value for each in self.attributes if "tiles" in each)
        told += ["the smaller levels"] * levels
        return told + ["the data window"] * (not exr and self.windows != (self.display,))

    @property
    def exact(self) -> str:
        """The names of the exact channels."""
        return listing([channel.name for exact, channels in self.groups if exact for channel in channels], 6)

    def alone(self) -> Exr:
        """Return the picture's own channels in the display window."""
        left = tuple(channel.name for _, channels in self.groups[1:] for channel in channels)
        pixels = _over(self.arrays[0], self.box, self.display)
        return replace(self, box=self.display, groups=self.groups[:1], arrays=(pixels,), left=left)

    def sized(self, shape: tuple[int, int]) -> Exr:
        """Return it with windows of another size, which all begin at (0, 0)."""
        box = (0, 0, shape[1], shape[0])
        return replace(self, box=box, display=box, windows=(box,) * len(self.windows))


def _shape(box: Box) -> tuple[int, int]:
    return box[3] - box[1], box[2] - box[0]


def around(boxes: Sequence[Box]) -> Box:
    """Return the smallest box around some."""
    x0, y0, x1, y1 = zip(*boxes, strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def _over(array: Array, box: Box, target: Box) -> Array:
    """Return an array that covers ``box`` over another box, with zeros where there was nothing."""
    if box == target:
        return array
    made = np.zeros((*_shape(target), *array.shape[2:]), array.dtype)
    x0, y0, x1, y1 = (f(a, b) for f, a, b in zip((max, max, min, min), box, target, strict=True))
    if x0 < x1 and y0 < y1:
        part = array[y0 - box[1] : y1 - box[1], x0 - box[0] : x1 - box[0]]
        made[y0 - target[1] : y1 - target[1], x0 - target[0] : x1 - target[0]] = part
    return made


def imported() -> Any:
    """Return the module OpenEXR, imported at the first use."""
    need("exr", "OpenEXR pictures and maps", "OpenEXR")
    import OpenEXR

    return OpenEXR


@contextlib.contextmanager
def opened(path: PathLike, *, header_only: bool = False) -> Iterator[Any]:
    """Open an OpenEXR that is not deep: its parts, with separate channels; errors are one sentence."""
    module = imported()
    if not head_of(path, 4).startswith(EXR_MAGIC):
        raise unreadable(path, "it does not begin as an EXR does", "give the name of an EXR")
    with _file(module, path, True) as file:
        for part in file.parts:
            if part.header["type"] in (module.deepscanline, module.deeptile):
                raise unreadable(path, "it is a deep EXR, several samples for a pixel", "flatten it first")
            for each in part.header["channels"]:
                if (each.xSampling, each.ySampling) != (1, 1):
                    what = f"its channel {each.name} has a sample for every {each.xSampling} x {each.ySampling} pixels"
                    raise unreadable(path, what, "write it with all channels at full resolution, as RGB")
        if header_only:
            yield file
    if not header_only:
        with _file(module, path, False) as file:
            yield file


def _file(module: Any, path: PathLike, header_only: bool) -> Any:
    """Open an OpenEXR, without what the package writes of a damaged one."""
    from supple.media.volume.itk import silence

    said = io.StringIO()
    try:
        # to both streams; what other threads write is passed on
        with silence(r".*\(EXR_ERR"), contextlib.redirect_stdout(said):
            file = module.File(os.fspath(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise damaged(path, str(error).splitlines()[0]) from error
    finally:
        if rest := re.sub(r"(?m)^Warning: .*\n", "", said.getvalue()):
            sys.stdout.write(rest)
    if not file.parts:
        raise damaged(path, said.getvalue().strip().rpartition(" - ")[2] or "it has no parts")
    return file


def _box(window: Any) -> Box:
    (x0, y0), (x1, y1) = (np.asarray(corner, np.int64).tolist() for corner in window)
    return x0, y0, x1 + 1, y1 + 1


def head_only(path: PathLike) -> tuple[Exr, tuple[tuple[int, str], ...]]:
    """Return an OpenEXR without channels, and the part and the name of each that it has."""
    with opened(path, header_only=True) as file:
        headers = tuple(dict(part.header) for part in file.parts)
    names = tuple((k, each.name) for k, header in enumerate(headers) for each in header["channels"])
    return _of_headers(headers), names


def _of_headers(headers: tuple[dict[str, Any], ...]) -> Exr:
    windows, display = tuple(_box(header["dataWindow"]) for header in headers), _box(headers[0]["displayWindow"])
    for header in headers:
        header.pop("preview", None)  # of the old pixels
    return Exr(headers, windows, display, around([display, *windows]), ())


def read(path: PathLike, box: Box | None = None) -> Exr:
    """Read an OpenEXR; the arrays cover a box, by default that around all windows."""
    with opened(path) as file:
        headers = tuple(dict(part.header) for part in file.parts)
        planes = {
            Channel(k, name, each.pixels.dtype): each.pixels
            for k, part in enumerate(file.parts)
            for name, each in part.channels.items()
        }
    made = _of_headers(headers)
    box = box or made.box
    groups = _grouped(path, list(planes), headers)
    arrays = []
    for _, channels in groups:
        each = [_over(part, made.windows[c.part], box) for c in channels for part in _split(planes[c])]
        arrays.append(np.ascontiguousarray(np.stack(each, axis=-1)))
    return replace(made, box=box, groups=groups, arrays=tuple(arrays))


def _split(plane: Array) -> list[Array]:
    """Return a channel as planes of float32, which hold any 16 bits of an integer."""
    whole = plane.dtype.kind == "u"
    return [(part).astype(np.float32) for part in ([plane >> 16, plane & 0xFFFF] if whole else [plane])]


def _layer(channel: Channel) -> tuple[str, str]:
    """Return the layer of a channel, and its name within it."""
    layer, _, name = channel.name.rpartition(".")
    return layer, name


def _grouped(
    path: PathLike, channels: list[Channel], headers: Sequence[Mapping[str, Any]]
) -> tuple[tuple[bool, tuple[Channel, ...]], ...]:
    """Return the channels of the picture itself, those that are filtered like it, and those that are exact."""
    mattes = tuple(
        value
        for header in headers
        for key, value in header.items()
        if key.startswith("cryptomatte/") and key.endswith("/name") and isinstance(value, str)
    )
    layers: dict[tuple[int, str], dict[str, Channel]] = {}  # of floats, the channels by their colour or their name
    exact = []
    for channel in channels:
        layer, name = _layer(channel)
        own = name if not layer else layer.rpartition(".")[2]
        data = channel.dtype.kind == "u" or bool(_DATA.search(own)) or bool(mattes and layer.startswith(mattes))
        if data or name.lower() not in _COLOURS:
            exact.append(channel)
        else:
            layers.setdefault((channel.part, layer), {})[_COLOURS[name.lower()]] = channel
    for key, held in layers.items():  # the y of a vector is no luminance
        if "y" in held and any(
            (c.part, _layer(c)[0]) == key and _layer(c)[1].lower() in ("x", "z") and key[1] for c in exact
        ):
            exact.append(held.pop("y"))

    def rank(key: tuple[int, str]) -> tuple[bool, int]:
        name = key[1].rpartition(".")[2].lower()
        return not layers[key], _MAIN.index(name) if name in _MAIN else len(_MAIN)

    best = layers[min(layers, key=rank)] if layers else {}
    main = [best[c] for c in "rgba" if c in best] if {"r", "g", "b"} <= set(best) else [*best.values()][:1]
    if "y" in best and len(main) == 1:
        main = [best["y"]]
    blurred = bool(main)
    if not main:
        main = [channel for channel in exact if channel.dtype.kind == "f"][:1]
    if not main:
        raise unreadable(path, "none of its channels holds floats", "give a picture")
    rest = [channel for channel in channels if channel not in main]
    parts = (
        (not blurred, main),
        (False, [channel for channel in rest if channel not in exact]),
        (True, [channel for channel in rest if channel in exact]),
    )
    return tuple((each, tuple(some)) for each, some in parts if some)


def with_pixels(like: Exr | None, pixels: Array, *, half: bool) -> Exr:
    """Return an OpenEXR with other pixels (H, W, C) of grey, RGB or RGBA; without ``like``, it has no attributes."""
    shape = pixels.shape[:2]
    if like is not None:
        like = like if shape == like.shape else like.sized(shape)
        return replace(like, arrays=(pixels, *like.arrays[1:]))
    module = imported()
    names = "Y" if pixels.shape[2] == 1 else "RGBA"[: pixels.shape[2]]
    channels = tuple(Channel(0, name, np.dtype(np.float16 if half else np.float32)) for name in names)
    box = (0, 0, shape[1], shape[0])
    header = {"compression": module.ZIP_COMPRESSION, "type": module.scanlineimage}
    return Exr((header,), (box,), box, box, ((False, channels),), (pixels,))


def write(path: PathLike, name: PathLike, exr: Exr) -> None:
    """Write an OpenEXR to ``path``, as it was, and with data windows that hold what has moved out of them.

    ``name`` is the name for messages.
    """
    module = imported()
    planes: dict[Channel, Array] = {}
    for (_, channels), array in zip(exr.groups, exr.arrays, strict=True):
        k = 0
        for channel in channels:
            high, low = array[..., k], array[..., k + channel.planes - 1]
            whole = channel.dtype.kind == "u"
            with np.errstate(over="ignore"):
                planes[channel] = high.astype("u4") << 16 | low.astype("u4") if whole else high.astype(channel.dtype)
            k += channel.planes
    parts = []
    for k, (attributes, window) in enumerate(zip(exr.attributes, exr.windows, strict=True)):
        own = {channel.name: plane for channel, plane in planes.items() if channel.part == k}
        if not own:
            continue
        box = around([_common(window, exr.box), *_filled(own.values(), exr.box)])
        header = {key: value for key, value in attributes.items() if key not in ("channels", "chunkCount")}
        header |= {"dataWindow": _window(box), "displayWindow": _window(exr.display)}
        if "tiles" in header:
            header["tiles"].mode = module.ONE_LEVEL
        cut = {key: np.ascontiguousarray(_over(plane, exr.box, box)) for key, plane in own.items()}
        parts.append(module.Part(header, cut, **({"name": header["name"]} if "name" in header else {})))
    try:
        with module.File(parts) as file:
            file.write(os.fspath(path))
    except (RuntimeError, ValueError, TypeError) as error:
        why = str(error).splitlines()[0].replace(os.fspath(path), os.fspath(name))
        raise unwritable(name, f"OpenEXR fails ({why})", "choose another place") from error


def _common(window: Box, box: Box) -> Box:
    """Return the part of a window within a box; all of the box if there is none."""
    x0, y0, x1, y1 = (f(a, b) for f, a, b in zip((max, max, min, min), window, box, strict=True))
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else box


def _filled(planes: Any, box: Box) -> list[Box]:
    """Return the box of all that is not 0; none if there is nothing."""
    any_: Array = np.any([plane != 0 for plane in planes], axis=0)
    rows, columns = (np.flatnonzero(any_.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return []
    x, y = box[:2]
    return [(x + int(columns[0]), y + int(rows[0]), x + int(columns[-1]) + 1, y + int(rows[-1]) + 1)]


def _window(box: Box) -> tuple[Array, Array]:
    return np.array(box[:2], np.int32), np.array([box[2] - 1, box[3] - 1], np.int32)
