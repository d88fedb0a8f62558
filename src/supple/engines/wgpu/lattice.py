"""The lattice of T⁻¹ on planes, solved at nodes and checked between them on the GPU."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.field import FIELD, constants, local, uploaded
from supple.engines.wgpu.kernel import LAYERS, READ, TURNS, UNIFORM, WRITE, download, owned, pipeline, room, run
from supple.engines.wgpu.samples import STEP
from supple.engines.wgpu.texels import copy_in, plane_layers, view_of
from supple.strain import Mask

Floats = npt.NDArray[np.float64]
Range = tuple[int, int]

NODE = 64  # bytes
PARTS = (*FIELD, "warp", "lattice", "smooth", "sample", "light", "levels", "footprint", "turns")
_NAMES = (*PARTS, "texels_whole")
_SOLVE = (UNIFORM, UNIFORM, READ, WRITE, WRITE, WRITE, WRITE)
CHECK = (*_SOLVE, LAYERS)
_ALONE = (None, None, None)  # in place of the resources of planes, which planes.py has

SETTINGS = np.dtype(
    [
        ("size", "u4", 2),
        ("nodes", "u4", 2),
        ("fill", "f4", 4),
        ("pitch", "f4", 2),
        ("offset", "f4", 2),
        ("strokes", "u4"),
        ("first", "u4"),
        ("frames", "u4"),
        ("channels", "u4"),
        ("origin", "u4"),
        ("top", "u4"),
        ("tall", "u4"),
        ("groups", "u4"),
        ("held", "u4", 4),
        ("slots", "u4"),
        ("shift", "u4"),
        ("blocks", "u4", 2),
        ("part", "u4", 2),
        ("bounds", "f4", 2),
        ("white", "f4"),
        ("tolerance", "f4"),
        ("times", "i4", 2),
        ("turns", "u4"),
        ("limited", "u4"),
        ("levels", "u4"),
        ("stride", "u4"),
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Strokes, their domain and their freeze mask on the device.

    ``cells`` is the number of cells of a plane, across and down; ``limited`` is true if all strokes have a limited
    reach; ``constants`` are those with which shaders are compiled for them.
    """

    gpu: Gpu
    table: Any
    axes: Any
    mask: Any
    count: int
    cells: tuple[int, int]
    limited: bool
    constants: dict[str, int]


def strokes_on(
    stack: contextlib.ExitStack,
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    freeze: Mask | None,
    shape: tuple[int, int],
    step: tuple[int, int] = (1, 1),
) -> Strokes:
    """Upload strokes until the stack is left; the lattice covers samples up to ``step`` pixels apart."""
    places, held, mask = owned(stack, *uploaded(gpu, table, axes, freeze))
    height, width = (-(-n // k) * k for n, k in zip(shape, reversed(step), strict=True))
    cells = _cells(width), _cells(height)
    return Strokes(gpu, held, places, mask, int(table.size), cells, local(table), constants(table, freeze))


def _cells(size: int) -> int:
    return max(1, -(-(size - 1) // STEP))


@dataclass(frozen=True, slots=True)
class Part:
    """A range of planes, and a range of rows of cells."""

    planes: Range
    cells: Range

    @property
    def count(self) -> int:
        """The number of planes."""
        return self.planes[1] - self.planes[0]

    @property
    def tall(self) -> int:
        """The number of rows of cells."""
        return self.cells[1] - self.cells[0]


@dataclass(slots=True, eq=False)
class Lattice:
    """T⁻¹ on a part, or buffers for it.

    ``read`` is the view that nodes are read from, and ``view`` the view of all of its planes.
    """

    strokes: Strokes
    buffers: tuple[Any, ...]
    part: Part
    stats: Any
    read: Any
    view: Any
    solved: Part | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Planes, rows and columns of nodes."""
        return self.part.count, self.part.tall + 1, self.strokes.cells[0] + 1

    def solve(self, part: Part, tolerance: float) -> None:
        """Solve the lattice of a part of the allocated size."""
        gpu, mask = self.strokes.gpu, self.strokes.mask
        assert (part.count, part.tall) == (self.part.count, self.part.tall)
        self.part, self.solved = part, None
        count, down, across = self.shape
        told = settings_of(self, tolerance)
        gpu.device.queue.write_buffer(self.buffers[0], 0, told)
        gpu.device.queue.write_buffer(self.stats, 0, np.zeros(4, np.uint32))
        chosen = self.strokes.constants
        solving = pipeline(gpu, _NAMES, "solve", (*_SOLVE, None, *_ALONE, READ), chosen)
        run(gpu, [(solving, (*self.buffers, None, *_ALONE, mask), (-(-across // 8), -(-down // 8), count))])
        copy_in(gpu, self.buffers[3], pitch_of(across), self.read, 0, 4 * count)
        buffers, kinds = (*self.buffers, self.view, *_ALONE, mask), (*CHECK, *_ALONE, READ)
        checking, counting = (pipeline(gpu, _NAMES, entry, kinds, chosen) for entry in ("check", "count"))
        run(
            gpu,
            [
                (checking, buffers, (-(-(across - 1) // 8), -(-(down - 1) // 8), count)),
                (counting, buffers, (1, 1, 1)),
            ],
        )
        self.solved = part

    def nodes(self) -> npt.NDArray[np.float32]:
        """Return the nodes: planes, rows, columns, u and the columns of ∂p/∂q, each of 4 numbers (lattice.wgsl)."""
        count, down, across = self.shape
        pitch = pitch_of(across)
        found = download(self.strokes.gpu, self.buffers[3], np.float32, count * down * pitch * 16)
        return found.reshape(count, 4, down, pitch, 4)[:, :, :, :across].transpose(0, 2, 3, 1, 4)

    def rough(self) -> npt.NDArray[np.bool_]:
        """Return the mask of cells that are not interpolated: planes, rows, columns."""
        count, down, across = self.part.count, self.part.tall, self.strokes.cells[0]
        known = download(self.strokes.gpu, self.buffers[4], np.float32, count * down * across)
        return known.reshape(count, down, across) > 1e29


def pitch_of(across: int) -> int:
    """Return the number of nodes from row to row, padded to the 256 bytes that textures need."""
    return -(-across // 16) * 16


def lattice_on(stack: contextlib.ExitStack, strokes: Strokes, part: Part) -> Lattice:
    """Return buffers for the lattice of a part, until the stack is left."""
    gpu, (across, _) = strokes.gpu, strokes.cells
    cells = part.count * part.tall * across
    read = plane_layers(gpu, (across + 1, part.tall + 1, 4 * part.count))
    stack.callback(read.destroy)
    told, nodes, errors, stats, rough = owned(
        stack,
        gpu.device.create_buffer(size=SETTINGS.itemsize, usage="UNIFORM|COPY_DST"),
        room(gpu, part.count * (part.tall + 1) * pitch_of(across + 1) * NODE),
        room(gpu, 4 * cells),
        room(gpu, 16),
        room(gpu, 16 + 4 * cells),
    )
    buffers = (told, strokes.axes, strokes.table, nodes, errors, stats, rough)
    return Lattice(strokes, buffers, part, stats, read, view_of(read))


def settings_of(lattice: Lattice, tolerance: float) -> npt.NDArray[np.void]:
    """Return the settings of a lattice for a shader."""
    told = np.zeros(1, SETTINGS)
    told["turns"] = TURNS
    _, down, across = lattice.shape
    told["nodes"], told["strokes"], told["tolerance"] = (across, down), lattice.strokes.count, tolerance
    told["first"], told["origin"] = lattice.part.planes[0], lattice.part.cells[0]
    told["limited"] = lattice.strokes.limited
    told["part"] = 0, 0xFFFFFFFF
    return told
