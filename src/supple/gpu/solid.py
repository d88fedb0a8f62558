"""A volume on a device: its samples, the lattice of T⁻¹, and the buffer of the deformed volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import constants, stroke_buffers
from supple.gpu.memory import Array, download, owned, room, solid, upload, uploaded
from supple.gpu.shader import BLOCK, CUT, LOST, MOST_GROUPS, Pace, shader, source


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

_NODE = 64  # bytes
_FIRST = 4096  # initial number of nodes, before their time is known
_UNSOLVED = "nodes of the lattice could not be solved in its numbers"


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Strokes on a device and, for a volume, the lattice of their inverse map."""

    constants: dict[str, int]  # the constants with which shaders are compiled for the strokes
    settings: dict[str, Any]  # the shaders' settings
    resources: dict[str, Any]  # buffers, and the texture of nodes
    step: int = 0  # voxels from node to node, the first of which is the first voxel; 0 without a lattice
    # (nz, ny, nx, 16): the displacement T⁻¹(q) - q in voxels, x first, and the columns of ∂p/∂q; each padded with a 0
    nodes: npt.NDArray[np.float32] | None = None
    # A bound on the distance of a source point from T⁻¹(q), in voxels, from the checks, with their reserve; infinity
    # if even the finest lattice is too coarse for the checks
    error: float = 0.0
    smooth: float = 0.0  # the least length scale of the map, in voxels


def hold_strokes(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None = None) -> Lattice:
    """Return strokes on the device without a lattice."""
    settings = {"nodes": (2, 2, 2), "spread": 0.0, "strokes": table.size}
    return Lattice(constants(table, freeze), settings, {**stroke_buffers(gpu, table, axes, freeze), "lattice": None})


def solve(
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, ...],
    step: int,
    freeze: Mask | None = None,
) -> Lattice:
    """Solve for T⁻¹ at nodes ``step`` voxels apart, in a volume of ``shape`` (Z, H, W).

    MemoryError if the lattice exceeds the largest texture; ArithmeticError if nodes could not be solved in float32, or
    by this driver.
    """
    across, down, deep = (-(-max(n - 1, 1) // step) + 1 for n in reversed(shape))
    pitch = -(-across // 16) * 16
    layer = pitch * down * _NODE
    if layer > gpu.binding:
        raise MemoryError("a layer of such a lattice is more than a shader takes")
    if deep * layer > gpu.texture:
        raise MemoryError(f"a lattice of {deep * layer >> 20} MB is more than is put into a texture")
    texture = solid(gpu, (2 * deep, 2 * down, across), np.float32, 4)
    settings = {"nodes": (across, down, deep), "spread": float(step), "strokes": table.size}
    given = {**stroke_buffers(gpu, table, axes, freeze), "lattice": texture.create_view()}
    known = constants(table, freeze)
    nodes = np.empty((deep, down, across, 16), np.float32)
    most = min(max(1, gpu.binding // layer), deep)
    pace = Pace(max(1, _FIRST // (across * down)), most)
    with owned(upload(gpu, np.array([0.0, LOST], np.float32)), room(gpu, most * layer)) as (stats, some):
        for entry, layers in (("solve", deep), ("check", deep - 1)):
            work = shader(gpu, source("nodes"), entry, known)
            for first, count in pace.parts(layers):
                groups = (-(-across // 4), -(-down // 4), -(-count // 4))
                part = {"first": first, "last": first + count}
                work.run(groups, settings | part, {**given, "nodes": some, "stats": stats})
                if entry == "solve":
                    encoder = gpu.device.create_command_encoder()
                    encoder.copy_buffer_to_texture(
                        {"buffer": some, "bytes_per_row": 16 * pitch, "rows_per_image": 2 * down},
                        {"texture": texture, "origin": (0, 0, 2 * first)},
                        (across, 2 * down, 2 * count),
                    )
                    gpu.device.queue.submit([encoder.finish()])
                    found = download(gpu, some, np.float32, count * layer // 4)
                    # In memory: layer, 2, row, 2, node, 4. The four vectors of a node lie two by two.
                    laid = found.reshape(count, 2, down, 2, pitch, 4)[..., :across, :].transpose(0, 2, 4, 1, 3, 5)
                    nodes[first : first + count] = laid.reshape(count, down, across, 16)
                error, smooth = download(gpu, stats, np.float32, 2)  # waits
                if not error < np.float32(LOST):
                    raise ArithmeticError("its driver ends loops of many turns" if error >= CUT else _UNSOLVED)
    if not np.isfinite(nodes).all():  # shaders may assume finite numbers
        raise ArithmeticError(_UNSOLVED)
    return Lattice(known, settings, given, step, nodes, float(error), float(smooth))


class Filling:
    """The buffer of a deformed volume, and its filled part.

    It is always computed from the original volume and all strokes. Another filling of the same volume replaces this
    one, which starts again when it is next used. Voxels are ``polished`` by Newton's method where the lattice alone is
    not within the tolerance, in voxels.
    """

    def __init__(self, volume: Volume, lattice: Lattice, *, polished: bool, tolerance: float) -> None:
        self._volume, self._lattice = volume, lattice
        self._tolerance = tolerance
        self._bricks = math.prod(-(-n // BLOCK) for n in volume.size)
        self._made = 0
        self._pace = Pace(1)
        self._key = object()  # not ``self``: a reference cycle would hold the device's memory
        chosen = lattice.constants | {"LABELLED": volume.labelled, "POLISHED": polished}
        self._shader = shader(volume.gpu, source("fill", volume.voxel), "fill", chosen)
        self._target = volume.warped.create_view()

    @property
    def part(self) -> float:
        """The filled part, from 0 to 1."""
        return self._made / self._bricks if self._volume.owner is self._key else 0.0

    def advance(self, seconds: float = math.inf) -> float:
        """Fill bricks for about this long; return the filled part. ArithmeticError if points could not be solved."""
        if self._volume.owner is not self._key:
            self._volume.owner, self._made = self._key, 0
        gpu, start = self._volume.gpu, self._made
        with owned(room(gpu, 4)) as (lost,):
            for first, count in self._pace.parts(self._bricks - start, min(seconds, 0.25), seconds):
                self._make(start + first, count, lost)
                if download(gpu, lost, np.uint32, 1)[0]:  # waits
                    raise ArithmeticError("voxels could not be solved in its numbers")
                self._made = start + first + count
        return self.part

    def prepare(self) -> None:
        """Run the shader for no brick, since some drivers compile only at the first run."""
        with owned(room(self._volume.gpu, 4)) as (lost,):
            self._make(0, 0, lost)

    def _make(self, first: int, count: int, lost: Any) -> None:
        volume, lattice = self._volume, self._lattice
        settings = {"size": volume.size, "first": first, "count": count, "tolerance": self._tolerance}
        rows = max(1, -(-count // MOST_GROUPS))
        given = {"voxels": volume.samples, "warped": None, "lost": lost, "made": self._target}
        groups = max(1, -(-count // rows)), rows, 1
        self._shader.run(groups, lattice.settings | settings, lattice.resources | given)
