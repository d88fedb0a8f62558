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

from supple.errors import listing, needed
from supple.media.files import PathLike, head_of, unreadable, unwritable
from supple.media.image.formats import Array, Box, bounds, damaged
from supple.media.pictures import EXR_MAGIC

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
    """An OpenEXR, with its channels as arrays over one box."""

    attributes: tuple[Mapping[str, Any], ...]  # the header of each part
    windows: tuple[Box, ...]  # the data window of each part
    display: Box  # the display window
    box: Box  # what the arrays cover
    # whether the channels of an array are exact, and which they are: first the picture's own
    groups: tuple[tuple[bool, tuple[Channel, ...]], ...]
    arrays: tuple[Array, ...] = ()  # of float32, (H, W, planes), one for each group
    left: tuple[str, ...] = ()  # channels that are not held

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
        """Return, in words, the parts that are lost when it is written as an OpenEXR, or else in another format."""
        parts: dict[str, Sequence[str]] = {"channel": self.left}
        if not exr:
            parts["channel"] = self.left or self._others
            parts["attribute"] = sorted({name for each in self.attributes for name in each} - _OWN)
        told = [f"the {what}{'s' * (len(some) > 1)} {listing(some, 6)}" for what, some in parts.items() if some]
        if any(each["tiles"].mode.value for each in self.attributes if "tiles" in each):
            told.append("the smaller levels")
        return told + ["the data window"] * (not exr and self.windows != (self.display,))

    @property
    def _others(self) -> tuple[str, ...]:
        """The names of channels that are not the picture's own."""
        return tuple(channel.name for _, channels in self.groups[1:] for channel in channels)

    @property
    def exact(self) -> str:
        """The names of the exact channels."""
        return listing([channel.name for exact, channels in self.groups if exact for channel in channels], 6)

    def alone(self) -> Exr:
        """Return the picture's own channels in the display window."""
        pixels = _over(self.arrays[0], self.box, self.display)
        return replace(self, box=self.display, groups=self.groups[:1], arrays=(pixels,), left=self._others)

    def sized(self, shape: tuple[int, int]) -> Exr:
        """Return a copy whose windows all have one size (H, W), and begin at (0, 0)."""
        box = (0, 0, shape[1], shape[0])
        return replace(self, box=box, display=box, windows=(box,) * len(self.windows))


def _shape(box: Box) -> tuple[int, int]:
    return box[3] - box[1], box[2] - box[0]


def around(boxes: Sequence[Box]) -> Box:
    """Return the bounding box of several boxes."""
    x0, y0, x1, y1 = zip(*boxes, strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def _common(one: Box, other: Box) -> Box | None:
    """Return the part that two boxes share; None if there is none."""
    x0, y0, x1, y1 = (f(a, b) for f, a, b in zip((max, max, min, min), one, other, strict=True))
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _over(array: Array, box: Box, target: Box) -> Array:
    """Return an array that covers ``box`` cropped, or padded by zeros, to the box ``target``."""
    if box == target:
        return array
    made = np.zeros((*_shape(target), *array.shape[2:]), array.dtype)
    if common := _common(box, target):
        to, source = (
            np.s_[common[1] - y : common[3] - y, common[0] - x : common[2] - x] for x, y, _, _ in (target, box)
        )
        made[to] = array[source]
    return made


def imported() -> Any:
    """Return the module OpenEXR, imported at the first use."""
    return needed("exr", "OpenEXR pictures and maps", "OpenEXR")


@contextlib.contextmanager
def opened(path: PathLike, *, header_only: bool = False) -> Iterator[Any]:
    """Open an OpenEXR, with separate channels; SuppleError for deep data and subsampled channels.

    Messages that the package prints about damaged files are suppressed.
    """
    from supple.media.volume.itk import silence

    if not head_of(path, 4).startswith(EXR_MAGIC):
        raise unreadable(path, "it does not begin as an EXR does", "give the name of an EXR")
    module, said = imported(), io.StringIO()
    try:
        # printed to both streams; the output of other threads is passed on
        with silence(r".*\(EXR_ERR"), contextlib.redirect_stdout(said):
            file = module.File(os.fspath(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise damaged(path, str(error).splitlines()[0]) from error
    finally:
        if rest := re.sub(r"(?m)^Warning: .*\n", "", said.getvalue()):
            sys.stdout.write(rest)
    if not file.parts:
        raise damaged(path, said.getvalue().strip().rpartition(" - ")[2] or "it has no parts")
    with file:
        for part in file.parts:
            if part.header["type"] in (module.deepscanline, module.deeptile):
                raise unreadable(path, "it is a deep EXR, several samples for a pixel", "flatten it first")
            for each in part.header["channels"]:
                if (each.xSampling, each.ySampling) != (1, 1):
                    what = f"its channel {each.name} has a sample for every {each.xSampling} x {each.ySampling} pixels"
                    raise unreadable(path, what, "write it with all channels at full resolution, as RGB")
        yield file


def _box(window: Any) -> Box:
    (x0, y0), (x1, y1) = (np.asarray(corner, np.int64).tolist() for corner in window)
    return x0, y0, x1 + 1, y1 + 1


def head_only(path: PathLike) -> tuple[Exr, tuple[tuple[int, str], ...]]:
    """Return an OpenEXR without its channels, and the part and the name of each channel."""
    with opened(path, header_only=True) as file:
        headers = tuple(dict(part.header) for part in file.parts)
    names = tuple((k, each.name) for k, header in enumerate(headers) for each in header["channels"])
    return _of_headers(headers), names


def info(path: PathLike) -> dict[str, Any]:
    """Return the facts on the channels of all parts, their compression, and the windows: x, y, width and height."""
    head, names = head_only(path)
    boxes = {"data_window": around(head.windows), "display_window": head.display}
    packed = sorted({each["compression"].name.removesuffix("_COMPRESSION") for each in head.attributes})
    told = {name: [x0, y0, x1 - x0, y1 - y0] for name, (x0, y0, x1, y1) in boxes.items()}
    return {"layers": [name for _, name in names], "compression": packed, **told}


def _of_headers(headers: tuple[dict[str, Any], ...]) -> Exr:
    windows, display = tuple(_box(header["dataWindow"]) for header in headers), _box(headers[0]["displayWindow"])
    for header in headers:
        header.pop("preview", None)  # it shows the old pixels
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
        each: list[Array] = []
        for c in channels:  # float32 represents 16-bit integers exactly
            parts = [planes[c] >> 16, planes[c] & 0xFFFF] if c.planes == 2 else [planes[c]]
            each += [_over(part.astype(np.float32), made.windows[c.part], box) for part in parts]
        arrays.append(np.stack(each, axis=-1))
    return replace(made, box=box, groups=groups, arrays=tuple(arrays))


def _layer(channel: Channel) -> tuple[str, str]:
    """Return the layer of a channel, and its name within it."""
    layer, _, name = channel.name.rpartition(".")
    return layer, name


def _grouped(
    path: PathLike, channels: list[Channel], headers: Sequence[Mapping[str, Any]]
) -> tuple[tuple[bool, tuple[Channel, ...]], ...]:
    """Return three groups: the picture's own channels, others that are filtered, and exact ones."""
    named = (pair for header in headers for pair in header.items() if re.fullmatch("cryptomatte/(.*/)?name", pair[0]))
    mattes = tuple(value for _, value in named if isinstance(value, str))
    vectors = {(c.part, _layer(c)[0]) for c in channels if _layer(c)[1].lower() in ("x", "z")}

    def is_exact(channel: Channel) -> bool:
        layer, name = _layer(channel)
        if channel.dtype.kind == "u" or (mattes and layer.startswith(mattes)) or name.lower() not in _COLOURS:
            return True
        if layer and name.lower() == "y" and (channel.part, layer) in vectors:  # no luminance
            return True
        return _DATA.search(layer.rpartition(".")[2] or name) is not None

    def rank(key: tuple[int, str]) -> int:
        name = key[1].rpartition(".")[2].lower()
        return _MAIN.index(name) if name in _MAIN else len(_MAIN)

    exact = [channel for channel in channels if is_exact(channel)]
    layers: dict[tuple[int, str], dict[str, Channel]] = {}  # the channels of each by their colour
    for channel in channels:
        if channel not in exact:
            layer, name = _layer(channel)
            layers.setdefault((channel.part, layer), {})[_COLOURS[name.lower()]] = channel
    best = layers[min(layers, key=rank)] if layers else {}
    if {"r", "g", "b"} <= set(best):
        main = [best[c] for c in "rgba" if c in best]
    else:
        main = [best["y"]] if "y" in best else [*best.values()][:1]
    main = main or [channel for channel in exact if channel.dtype.kind == "f"][:1]
    if not main:
        raise unreadable(path, "none of its channels holds floats", "give a picture")
    rest = [channel for channel in channels if channel not in main]
    parts = (
        (main[0] in exact, main),
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
    """Write an OpenEXR to ``path``, with its attributes, and data windows enlarged to hold pixels that moved out.

    ``name`` is the name for messages.
    """
    module = imported()
    planes: list[dict[str, Array]] = [{} for _ in exr.windows]
    for (_, channels), array in zip(exr.groups, exr.arrays, strict=True):
        each = iter(np.moveaxis(array, -1, 0))
        for channel in channels:
            plane = next(each)
            with np.errstate(over="ignore"):
                plane = plane.astype(channel.dtype)
            if channel.planes == 2:
                plane = plane << 16 | next(each).astype(channel.dtype)
            planes[channel.part][channel.name] = plane
    parts = []
    for attributes, window, own in zip(exr.attributes, exr.windows, planes, strict=True):
        if not own:
            continue
        box = _common(window, exr.box) or exr.box
        if filled := bounds(np.any([plane != 0 for plane in own.values()], axis=0)):
            x, y = exr.box[:2]
            box = around([box, (filled[0] + x, filled[1] + y, filled[2] + x, filled[3] + y)])
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


def _window(box: Box) -> tuple[Array, Array]:
    return np.array(box[:2], np.int32), np.array([box[2] - 1, box[3] - 1], np.int32)
