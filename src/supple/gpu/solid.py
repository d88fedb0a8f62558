"""A volume on a device: its samples, the strokes that move it, and the buffer of the deformed volume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from supple._core import BRICK
from supple.engine.work import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import constants, stroke_buffers
from supple.gpu.memory import Array, download, owned, room, solid, uploaded
from supple.gpu.shader import BLOCK, MOST_GROUPS, Pace, shader, source


@dataclass(slots=True, eq=False)
class Volume:
    """Samples on a device."""

    gpu: Gpu
    samples: Any
    size: tuple[int, int, int]  # voxels, x first
    voxel: str  # the type of samples in shaders: f32, i32 or u32
    labelled: bool = False  # whether samples are numbers of labels, which are not mixed
    colours: Any = None  # the voxels' own colours, sRGB and opacity
    warped: Any = None  # the texture for a deformed volume, in float32: see `beside`
    full: bool = False  # whether its allocation failed
    owner: object = None  # the key of the filling that owns that texture, if any: see `supple.gpu.solid.Filling`
    # The number of rays in one part of a picture, for each mode and number of strokes.
    paces: dict[tuple[int, int], Pace] = field(default_factory=dict)


def hold(gpu: Gpu, samples: Array, labelled: bool = False, colours: Array | None = None) -> Volume:
    """Upload samples (Z, H, W) of 8 or 16 bits or float32, at least two along each axis, to the device.

    The voxels' own colours, (Z, H, W, 4), are uint8 or uint16, of which eleven bits are kept. MemoryError if the volume
    exceeds the largest texture, or there is no room for it.
    """
    depth, height, width = samples.shape
    view = uploaded(gpu, samples).create_view()
    paint = None
    if colours is not None:
        deep = colours.dtype == np.uint16
        paint = uploaded(gpu, (colours * np.float32(1 / 65535)).astype(np.float16) if deep else colours).create_view()
    voxel = {"u": "u32", "i": "i32", "f": "f32"}[samples.dtype.kind]
    return Volume(gpu, view, (width, height, depth), voxel, labelled, paint)


def beside(volume: Volume) -> bool:
    """Return whether there is room for a deformed volume; the first call allocates it."""
    if volume.warped is None and not volume.full:
        usage = "STORAGE_BINDING|COPY_SRC|COPY_DST"
        try:
            volume.warped = solid(volume.gpu, volume.size[::-1], np.float32, usage=usage)
        except MemoryError:
            volume.full = True
    return volume.warped is not None


Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """The strokes of a map on a device, and its domain."""

    constants: dict[str, int]  # the constants with which shaders are compiled for them
    count: int
    resources: dict[str, Any]  # buffers


def hold_strokes(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None = None) -> Strokes:
    """Upload strokes to the device."""
    return Strokes(constants(table, freeze), table.size, stroke_buffers(gpu, table, axes, freeze))


class Filling:
    """The buffer of a deformed volume, and its filled part.

    It is always computed from the original volume and all strokes. Another filling of the same volume replaces this
    one, which starts again when it is next used. Source points are within the tolerance, in voxels.
    """

    def __init__(self, volume: Volume, strokes: Strokes, tolerance: float) -> None:
        self._volume, self._strokes, self._tolerance = volume, strokes, tolerance
        self._blocks = math.prod(-(-n // BLOCK) for n in volume.size)
        self._made = 0
        self._pace = Pace(1)
        self._key = object()  # not ``self``: a reference cycle would hold the device's memory
        self._ranges: tuple[Array, Array] | None = None
        self._target = volume.warped.create_view()

    @property
    def part(self) -> float:
        """The filled part, from 0 to 1."""
        return self._made / self._blocks if self._volume.owner is self._key else 0.0

    def advance(self, seconds: float = math.inf) -> float:
        """Fill blocks for about this long; return the filled part. ArithmeticError if points could not be solved."""
        if self._volume.owner is not self._key:
            self._volume.owner, self._made = self._key, 0
        gpu, start = self._volume.gpu, self._made
        with owned(room(gpu, 4)) as (lost,):
            for first, count in self._pace.parts(self._blocks - start, min(seconds, 0.25), seconds):
                self._make(start + first, count, lost)
                if download(gpu, lost, np.uint32, 1)[0]:  # waits
                    raise ArithmeticError("voxels could not be solved in its numbers")
                self._made = start + first + count
        return self.part

    def _make(self, first: int, count: int, lost: Any) -> None:
        volume, strokes = self._volume, self._strokes
        work = shader(
            volume.gpu, source("fill", volume.voxel), "fill", strokes.constants | {"LABELLED": volume.labelled}
        )
        settings = {"size": volume.size, "first": first, "count": count, "tolerance": self._tolerance}
        rows = max(1, -(-count // MOST_GROUPS))
        given = {"voxels": volume.samples, "warped": None, "lost": lost, "made": self._target}
        groups = max(1, -(-count // rows)), rows, 1
        work.run(groups, {"strokes": strokes.count} | settings, strokes.resources | given)

    def ranges(self) -> tuple[Array, Array]:
        """Return the smallest and the largest sample of each brick of the buffer, which must be full."""
        if self._ranges is None:
            volume = self._volume
            gpu, (across, down, deep) = volume.gpu, (-(-(n - 1) // BRICK) for n in volume.size)
            made, most = np.empty((deep, down, across, 2), np.float32), max(1, gpu.binding // (8 * across * down))
            work = shader(gpu, source("ranges"), "ranges")
            with owned(room(gpu, 8 * across * down * min(most, deep))) as (found,):
                for first in range(0, deep, most):
                    last = min(first + most, deep)
                    settings = {"size": volume.size, "bricks": (across, down, deep), "first": first, "last": last}
                    groups = tuple(-(-n // 4) for n in (across, down, last - first))
                    work.run(groups, settings, {"warped": self._target, "found": found})
                    part = made[first:last]
                    part[...] = download(gpu, found, np.float32, part.size).reshape(part.shape)
            self._ranges = made[..., 0], made[..., 1]
        return self._ranges
