"""Pixel formats of video: the planes and the memory layout of their components."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import av
import numpy as np

from supple.engine.work import Array, Group, Layout

# packed formats whose order differs from their name
_ORDER = {"xv36": "uyvx", "xv48": "uyvx", "yuyv422": "yuyv", "uyvy422": "uyvy", "yvyu422": "yvyu"}
_ORDER |= {"y210": "yuyv", "y212": "yuyv", "y216": "yuyv", "xyz12": "rgb"}
_PACKED = re.compile(r"([rgbayuvx0]{2,4})(?:\d+|f16|f32)?")
# Formats that cannot be read directly, and the formats that they are converted to; all others become 8-bit RGB.
_WIDER = {
    "mono[bw]": "gray", "x2(rgb|bgr)10": "gbrp10le", "(v30x|xv30)": "yuv444p10le", "uyyvyy411": "yuv411p",
    "rgb96": "rgb48le", "rgba128": "rgba64le", "gbrap32": "gbrap16le", "gray32": "gray16le", "bayer_....16": "rgb48le",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Kind:
    """The kind of values of a pixel format, independent of its memory layout."""

    family: str  # "gray", "yuv", "rgb" or "xyz"
    step: tuple[int, int]  # pixels for one chroma sample, x first
    bits: int  # of a sample; 32 or 16 if real
    alpha: bool  # whether it has opacity
    real: bool  # whether samples are floating point

    @property
    def white(self) -> float:
        """The largest value of a sample."""
        return 1.0 if self.real else float(2**self.bits - 1)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of the arrays of frames."""
        return np.dtype(np.float32 if self.real else np.uint8 if self.bits <= 8 else np.uint16)

    def layout(self, width: int, height: int, offset: tuple[float, float]) -> Layout:
        """Return the groups of components of a frame of that size, with chroma sited at `offset`."""
        colours = 1 if self.family == "gray" else 3
        alpha = int(self.alpha)
        if self.step == (1, 1):
            groups: tuple[Group, ...] = (Group((height, width), colours + alpha, alpha=self.alpha),)
        else:
            small = (-(-height // self.step[1]), -(-width // self.step[0]))
            luma = Group((height, width), 1 + alpha, alpha=self.alpha)
            groups = (luma, Group(small, 2 + alpha, self.step, offset, self.alpha))
        return Layout(groups, self.dtype, self.white)


@dataclass(frozen=True, slots=True)
class Place:
    """The position of one component's samples: plane, first item, and step in items."""

    plane: int
    start: int
    step: int


@dataclass(frozen=True, slots=True)
class Form:
    """A pixel format whose components can be read and written directly."""

    name: str  # in FFmpeg
    kind: Kind  # the kind of its values
    places: tuple[Place, ...]  # of Y, U, V or R, G, B, and then of opacity
    item: np.dtype[np.generic]  # of the samples in memory
    shift: int = 0  # the left shift of samples, in bits


# Kept: PyAV's to_ndarray supports only some formats (test_every_pixel_format_comes_through_ffv1_bit_for_bit).
@lru_cache(maxsize=1024)
def form(name: str) -> Form | None:
    """Return the memory layout of a pixel format; None if samples share bytes, or are not in memory."""
    try:
        video = av.VideoFormat(name, 64, 64)
    except ValueError:
        return None
    parts = video.components
    bits = {part.bits for part in parts}
    if not parts or len(bits) > 1 or video.has_palette or video.is_bit_stream or video.is_bayer:
        return None
    base = re.sub(r"(le|be)$", "", video.name)
    real = bool(re.search(r"f(16|32)$", base))
    depth = bits.pop()
    if depth < 8 or (depth > 16 and not real) or re.search("x2|v30|uyyvyy", base):
        return None
    size = max(8, 1 << (depth - 1).bit_length())
    item = np.dtype(f"{'>' if video.is_big_endian else '<'}{'f' if real else 'u'}{size // 8}")
    places = _places(video, base)
    family = "xyz" if base.startswith("xyz") else "rgb" if video.is_rgb else "yuv" if len(parts) > 2 else "gray"
    step = (1, 1)
    if family == "yuv":
        step = (64 // parts[1].width, 64 // parts[1].height)
    moved = "msb" in base or re.fullmatch(r"p[0-4]1[0-6]|y21[0-6]|xv36|xyz12", base)
    kind = Kind(family, step, depth, len(parts) in (2, 4), real)
    return Form(video.name, kind, places, item, size - depth if moved else 0)


def _places(video: av.VideoFormat, base: str) -> tuple[Place, ...]:
    parts = video.components
    if len({part.plane for part in parts}) == len(parts):
        return tuple(Place(part.plane, 0, 1) for part in parts)
    if video.is_planar:  # the two chroma components share a plane
        swapped = int(base in ("nv21", "nv42"))
        return (Place(0, 0, 1), Place(1, swapped, 2), Place(1, 1 - swapped, 2))
    found = _PACKED.fullmatch(base)
    order = _ORDER.get(base) or (found.group(1) if found else "")
    names = "ya" if len(parts) == 2 else ("rgba" if video.is_rgb or base.startswith("xyz") else "yuva")[: len(parts)]
    return tuple(Place(0, order.index(a), len(order) // order.count(a)) for a in names)


def wider(name: str) -> str:
    """Return the directly readable format that another format is converted to."""
    base = re.sub(r"(le|be)$", "", name)
    return next((to for pattern, to in _WIDER.items() if re.fullmatch(pattern, base)), "rgb24")


def _samples(plane: Any, rows: int, item: np.dtype[np.generic]) -> Array:
    line = plane.line_size
    table = np.frombuffer(plane, np.uint8)[: rows * abs(line)].reshape(rows, abs(line))
    table = table[:, : abs(line) // item.itemsize * item.itemsize].view(item)
    return table[::-1] if line < 0 else table  # some decoders store frames bottom up


def _pairs(frame: av.VideoFrame, form: Form, arrays: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Return pairs of views: a component of a frame, and the same component in the arrays.

    Packed components in order are one pair; chroma's own opacity has none.
    """
    planes, count = frame.planes, len(form.places)
    if count > 1 and not form.shift and all(place == Place(0, k, count) for k, place in enumerate(form.places)):
        rows = _samples(planes[0], frame.height, form.item)
        return [(rows[:, : frame.width * count].reshape(frame.height, frame.width, count), arrays[0])]
    slots = list(np.moveaxis(arrays[0], -1, 0))
    if len(arrays) > 1:
        slots[1:1] = [arrays[1][..., 0], arrays[1][..., 1]]
    pairs = []
    for k, (place, slot) in enumerate(zip(form.places, slots, strict=True)):
        x, y = form.kind.step if k in (1, 2) and form.kind.family == "yuv" else (1, 1)
        rows = _samples(planes[place.plane], -(-frame.height // y), form.item)
        pairs.append((rows[:, place.start :: place.step][:, : -(-frame.width // x)], slot))
    return pairs


def unpack(frame: av.VideoFrame, form: Form, arrays: Sequence[Array]) -> None:
    """Copy the samples of a frame into arrays, one for each group."""
    for view, slot in _pairs(frame, form, arrays):
        if form.shift:
            np.right_shift(view, form.shift, out=slot)
        else:
            slot[:] = view
    if form.kind.alpha and len(arrays) > 1:
        arrays[1][..., 2] = _averaged(arrays[0][..., 1], form.kind)


def _averaged(alpha: Array, kind: Kind) -> Array:
    """Average opacity over the pixels of each sample of chroma."""
    (x, y), (height, width) = kind.step, alpha.shape
    padded = np.pad(alpha, ((0, -height % y), (0, -width % x)), mode="edge")
    sums = padded.reshape(padded.shape[0] // y, y, -1, x).sum(axis=(1, 3), dtype=np.float32 if kind.real else np.uint32)
    mean: Array = sums / (x * y) if kind.real else (sums + x * y // 2) // (x * y)
    return mean


def pack(arrays: Sequence[Array], form: Form, frame: av.VideoFrame) -> av.VideoFrame:
    """Copy the samples of arrays, one for each group, into a frame, and return it; a buffer in use is replaced."""
    frame.make_writable()
    if len(form.places) < abs(form.places[0].step) and form.kind.step == (1, 1):
        _samples(frame.planes[0], frame.height, form.item)[:] = 0  # the padding beside the components
    for view, slot in _pairs(frame, form, arrays):
        if form.shift:
            np.left_shift(slot, form.shift, out=view)
        else:
            view[:] = slot
    return frame


def palette(frame: av.VideoFrame) -> Array:
    """Return the colours of a frame's pixels from its palette: shape (H, W, 4), RGBA."""
    return frame.reformat(format="rgba").to_ndarray()
