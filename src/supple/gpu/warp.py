"""Images and stacks of frames, warped by the GPU: plane by plane, in as many at once as fit."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu
from supple.gpu.field import domain, packed
from supple.gpu.kernel import READ, UNIFORM, WRITE, Array, download, owned, pipeline, room, run, upload

Floats = npt.NDArray[np.float64]

STEP = 16  # pixels from node to node, as warp.wgsl has it
FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "antialias": 3, "auto": 4}
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2, "nothing": 3}
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}
_NAMES = ("warp", "field", "newton", "lattice", "smooth", "blend", "sample")
_KINDS = (UNIFORM, UNIFORM, READ, WRITE, WRITE, READ, WRITE, WRITE, WRITE)

SETTINGS = np.dtype(
    [
        ("size", "u4", 2),
        ("nodes", "u4", 2),
        ("fill", "f4", 4),
        ("strokes", "u4"),
        ("first", "u4"),
        ("frames", "u4"),
        ("earliest", "u4"),
        ("held", "u4"),
        ("channels", "u4"),
        ("white", "f4"),
        ("tolerance", "f4"),
        ("bounds", "f4", 2),
        ("groups", "u4"),
        ("unused", "u4"),
    ]
)


@dataclass(frozen=True, slots=True)
class Format:
    """How pixels lie in words of 32 bits.

    ``number`` is what FORMAT says of it, ``dtype`` what a channel is, ``channels`` how many there are in memory, of
    which the last ones may be unused, and ``pixels`` how many a thread writes.
    """

    number: int
    dtype: Any
    channels: int
    pixels: int

    def words(self, width: int) -> int:
        """Words that a row of ``width`` pixels takes."""
        return self.threads(width) * self.pixels * self.channels * int(np.dtype(self.dtype).itemsize) // 4

    def threads(self, width: int) -> int:
        """Threads that write a row."""
        return -(-width // self.pixels)


_BYTE, _BYTES = Format(0, np.uint8, 1, 4), Format(1, np.uint8, 4, 1)
_SHORT, _SHORTS = Format(2, np.uint16, 1, 2), Format(3, np.uint16, 4, 1)
_FLOAT, _FLOATS = Format(4, np.float32, 1, 1), Format(5, np.float32, 4, 1)


def format_of(dtype: Any, channels: int) -> Format | None:
    """How samples of a type are handed over; None if they cannot be, as float32 does not hold all of their values."""
    kind = np.dtype(dtype)
    if channels > 4:
        return None
    if kind == np.uint8:
        return _BYTE if channels == 1 else _BYTES
    if kind == np.uint16:
        return _SHORT if channels == 1 else _SHORTS
    if kind in (np.float32, np.float16, np.int8, np.int16, np.bool_):
        return _FLOAT if channels == 1 else _FLOATS
    return None


def may_hold(gpu: Gpu, shape: tuple[int, int], dtype: Any, channels: int, frames: int) -> bool:
    """Whether some frames are no more than a shader takes."""
    form = format_of(dtype, channels)
    assert form is not None
    size = frames * shape[0] * shape[1] * form.channels * np.dtype(form.dtype).itemsize
    return bool(size <= gpu.binding)


@dataclass(frozen=True, slots=True)
class Wanted:
    """How colours are made."""

    filter: str
    between: str  # "nothing", of a picture
    outside: str
    fill: tuple[float, ...]
    alpha: bool
    light: bool
    white: float
    tolerance: float


def warp(
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    source: Array,
    out: Array,
    wanted: Wanted,
    reach: Callable[[int, int], tuple[int, int]],
    tell: Callable[[int], None] = lambda done: None,
) -> tuple[float, int]:
    """Warp frames (T, H, W, C), of which an image is one.

    Parameters
    ----------
    gpu : Gpu
    table, axes
        The strokes and the domain, as the CPU's kernels take them.
    source, out : arrays of one shape and type
        Of a type and channels that `format_of` knows.
    wanted : Wanted
    reach : function
        Of a range of planes: the range of source frames, both with their ends excluded, that they may be made of.
    tell : function
        Called with the number of planes done.

    Returns
    -------
    float, int
        The worst error of a source point, in pixels, and how many are not known to be good enough.

    Raises
    ------
    MemoryError
        If what a single plane is made of is more than a shader takes.
    """
    form = format_of(source.dtype, source.shape[3])
    assert form is not None
    constants = {
        "FORMAT": form.number,
        "FILTER": FILTERS[wanted.filter],
        "BETWEEN": BETWEEN[wanted.between],
        "OUTSIDE": OUTSIDE[wanted.outside],
        "ALPHA": int(wanted.alpha and wanted.filter != "nearest"),
        "LIGHT": int(wanted.light and wanted.filter != "nearest"),
        "ACROSS": STEP // form.pixels,
        "DOWN": 2 * form.pixels,
    }
    solve, check, count_rough, colour, finish = (
        pipeline(gpu, _NAMES, entry, _KINDS, constants)
        for entry in ("solve", "check", "count", "warp", "solve_and_warp")
    )
    frames, height, width, channels = source.shape
    cells = np.array([max(1, -(-(width - 1) // STEP)), max(1, -(-(height - 1) // STEP))])
    plane = height * form.words(width) * 4
    made_of = max(plane, int(np.prod(cells + 1)) * 64)
    if made_of > gpu.binding:
        raise MemoryError("a picture of this size is more than a shader takes")

    def some(first: int, count: int, window: tuple[int, int], samples: Any) -> tuple[float, int]:
        """Make some planes."""
        settings = np.zeros(1, SETTINGS)
        for name, value in {
            "size": (width, height),
            "nodes": cells + 1,
            "strokes": table.size,
            "first": first,
            "frames": frames,
            "earliest": window[0],
            "held": window[1] - window[0],
            "channels": channels,
            "white": wanted.white,
            "tolerance": wanted.tolerance,
            "bounds": _bounds(form.dtype),
            "groups": form.threads(width),
        }.items():
            settings[name] = value
        settings["fill"][0, :channels] = wanted.fill

        def groups(whole: Any, size: int) -> tuple[int, ...]:
            return (*(-(-int(n) // size) for n in whole), count)

        sizes = (64 * int(np.prod(cells + 1)), 4 * int(np.prod(cells)), plane)
        with contextlib.ExitStack() as stack:
            nodes, errors, target = owned(stack, *(room(gpu, count * size) for size in sizes))
            stats, rough = owned(stack, room(gpu, 16), room(gpu, 16 + 4 * count * int(np.prod(cells))))
            (told,) = owned(stack, upload(gpu, settings, UNIFORM))
            buffers = [told, *fixed, nodes, errors, samples, target, stats, rough]
            run(
                gpu,
                [
                    (solve, buffers, groups(cells + 1, 8)),
                    (check, buffers, groups(cells, 8)),
                    (count_rough, buffers, (1, 1, 1)),
                    (colour, buffers, groups((width, height), STEP)),
                    (finish, buffers, rough),
                ],
            )
            found = download(gpu, target, form.dtype, count * plane // np.dtype(form.dtype).itemsize)
            said = download(gpu, stats, np.uint32, 2)
        pixels = found.reshape(count, height, -1, form.channels)[:, :, :width, :channels]
        _store(pixels, out[first : first + count])
        return float(said[:1].view(np.float32)[0]), int(said[1])

    worst, lost, first, held = 0.0, 0, 0, (0, 0)
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as window:
        fixed = owned(stack, upload(gpu, domain(axes), UNIFORM), upload(gpu, packed(table)))
        samples: Any = None
        while first < frames:
            count = max(1, min(frames - first, gpu.binding // made_of, 16))
            low, high = reach(first, first + count)
            while not may_hold(gpu, (height, width), source.dtype, channels, high - low):
                if count == 1:
                    raise MemoryError("the frames that one is made of are more than a shader takes")
                count //= 2
                low, high = reach(first, first + count)
            if held != (low, high):
                window.close()
                held, (samples,) = (low, high), owned(window, upload(gpu, _packed(source[low:high], form)))
            error, more = some(first, count, held, samples)
            worst, lost = max(worst, error), lost + more
            first += count
            tell(first)
    return worst, lost


def _packed(source: Array, form: Format) -> Array:
    """Frames as their words: channels filled up, and samples that the shader does not know as floats."""
    if source.shape[3] == form.channels and source.dtype == form.dtype:
        return np.ascontiguousarray(source)
    out = np.zeros((*source.shape[:3], form.channels), form.dtype)
    out[..., : source.shape[3]] = source
    return out


def _store(pixels: Array, out: Array) -> None:
    if out.dtype.kind in "iub" and pixels.dtype.kind == "f":
        if out.dtype == np.bool_:
            out[...] = pixels >= 0.5
            return
        low, high = _bounds(out.dtype)
        out[...] = np.clip(np.rint(pixels), low, high)
        return
    with np.errstate(over="ignore"):
        out[...] = pixels


def _bounds(dtype: Any) -> tuple[float, float]:
    kind = np.dtype(dtype)
    return (float(np.iinfo(kind).min), float(np.iinfo(kind).max)) if kind.kind in "iu" else (0.0, 0.0)
