"""Planes on the GPU: the lattice of T⁻¹ on them, solved and checked, and the colours there."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu
from supple.gpu.field import domain, packed
from supple.gpu.kernel import (
    LAYERS,
    READ,
    TURNS,
    UNIFORM,
    WHOLE_LAYERS,
    WRITE,
    Array,
    download,
    owned,
    pipeline,
    room,
    run,
    upload,
)
from supple.gpu.samples import STEP, Picture
from supple.gpu.texels import Layers, view_of

Floats = npt.NDArray[np.float64]
Range = tuple[int, int]

NODE = 64  # bytes
_PARTS = ("warp", "field", "newton", "lattice", "smooth", "blend", "sample", "footprint", "turns")
_NAMES = (*_PARTS, "texels_whole")
_SOLVE = (UNIFORM, UNIFORM, READ, WRITE, WRITE, WRITE, WRITE)
_CHECK = (*_SOLVE, LAYERS)

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
        ("unused", "u4", 3),
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Strokes on their domain, on the device.

    ``cells`` is how many the lattice of a plane has, across and down.
    """

    gpu: Gpu
    table: Any
    axes: Any
    count: int
    cells: tuple[int, int]


def strokes_on(
    stack: contextlib.ExitStack,
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, int],
    step: tuple[int, int] = (1, 1),
) -> Strokes:
    """Hand strokes over, until a stack is left; the lattice of a plane reaches as far as samples ``step`` apart may."""
    held, places = owned(stack, upload(gpu, packed(table)), upload(gpu, domain(axes), UNIFORM))
    height, width = (-(-n // k) * k for n, k in zip(shape, reversed(step), strict=True))
    return Strokes(gpu, held, places, int(table.size), (_cells(width), _cells(height)))


def _cells(size: int) -> int:
    return max(1, -(-(size - 1) // STEP))


@dataclass(frozen=True, slots=True)
class Part:
    """Which planes, and which rows of cells of each."""

    planes: Range
    cells: Range

    @property
    def count(self) -> int:
        """How many planes."""
        return self.planes[1] - self.planes[0]

    @property
    def tall(self) -> int:
        """How many rows of cells."""
        return self.cells[1] - self.cells[0]


@dataclass(slots=True, eq=False)
class Lattice:
    """T⁻¹ on a part, or room for it.

    ``read`` is the texture that its nodes are read from, and ``view`` that of all of its planes.
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
        """Solve it for a part that is as large as the one that there is room for."""
        gpu = self.strokes.gpu
        assert (part.count, part.tall) == (self.part.count, self.part.tall)
        self.part, self.solved = part, None
        count, down, across = self.shape
        told = settings_of(self, tolerance)
        gpu.device.queue.write_buffer(self.buffers[0], 0, told)
        gpu.device.queue.write_buffer(self.stats, 0, np.zeros(4, np.uint32))
        solving = pipeline(gpu, _NAMES, "solve", _SOLVE)
        run(gpu, [(solving, self.buffers, (-(-across // 8), -(-down // 8), count))])
        encoder = gpu.device.create_command_encoder()
        encoder.copy_buffer_to_texture(
            {"buffer": self.buffers[3], "bytes_per_row": pitch_of(across) * NODE, "rows_per_image": down},
            {"texture": self.read},
            (4 * across, down, count),
        )
        gpu.device.queue.submit([encoder.finish()])
        buffers = (*self.buffers, self.view)
        checking, counting = (pipeline(gpu, _NAMES, entry, _CHECK) for entry in ("check", "count"))
        run(
            gpu,
            [
                (checking, buffers, (-(-(across - 1) // 8), -(-(down - 1) // 8), count)),
                (counting, buffers, (1, 1, 1)),
            ],
        )
        self.solved = part

    def nodes(self) -> npt.NDArray[np.float32]:
        """What the nodes know: planes, rows, columns, u and the columns of ∂p/∂q, each of 4 numbers."""
        count, down, across = self.shape
        pitch = pitch_of(across)
        found = download(self.strokes.gpu, self.buffers[3], np.float32, count * down * pitch * 16)
        return found.reshape(count, down, pitch, 4, 4)[:, :, :across]

    def rough(self) -> npt.NDArray[np.bool_]:
        """Which cells are not interpolated: planes, rows, columns."""
        count, down, across = self.part.count, self.part.tall, self.strokes.cells[0]
        known = download(self.strokes.gpu, self.buffers[4], np.float32, count * down * across)
        return known.reshape(count, down, across) > 1e29


def pitch_of(across: int) -> int:
    """Nodes from one row to the next: rows that become those of a texture are of a multiple of 256 bytes."""
    return -(-across // 4) * 4


def lattice_on(stack: contextlib.ExitStack, strokes: Strokes, part: Part) -> Lattice:
    """Room for the lattice of a part, until a stack is left."""
    gpu, (across, _) = strokes.gpu, strokes.cells
    cells = part.count * part.tall * across
    read = gpu.device.create_texture(
        size=(4 * (across + 1), part.tall + 1, part.count), format="rgba32float", usage="TEXTURE_BINDING|COPY_DST"
    )
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
    """What a shader is told of a lattice."""
    told = np.zeros(1, SETTINGS)
    told["turns"] = TURNS
    _, down, across = lattice.shape
    told["nodes"], told["strokes"], told["tolerance"] = (across, down), lattice.strokes.count, tolerance
    told["first"], told["origin"] = lattice.part.planes[0], lattice.part.cells[0]
    told["part"] = 0, 0xFFFFFFFF
    return told


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Some rows of some of the source's frames, on the device.

    Parameters
    ----------
    samples : Layers
    frames, rows : (int, int)
        Which they are: from, to.
    slots : int
        How many frames there is room for, in a ring.
    shift : int
        In which of the slots the first of the frames is.
    """

    samples: Layers
    frames: Range
    rows: Range
    slots: int
    shift: int


def rows_of(picture: Picture, lattice: Lattice) -> Range:
    """Which rows of samples lie in a lattice's cells."""
    top, end = (picture.rows * k for k in lattice.part.cells)
    return top, picture.shape[0] if lattice.part.cells[1] == lattice.strokes.cells[1] else min(end, picture.shape[0])


def target_size(picture: Picture, rows: int) -> int:
    """Bytes of some rows of samples, as the shader writes them."""
    return rows * picture.format.words(picture.shape[1]) * 4


def colour(
    lattice: Lattice, picture: Picture, frames: int, held: Held, told: Any, target: Any, parts: int = 1
) -> tuple[int, int]:
    """Begin to make the samples of a lattice's part.

    Parameters
    ----------
    lattice : Lattice
        Solved.
    picture : Picture
    frames : int
        How many the whole source has.
    held : Held
        What is here of it.
    told, target : buffers
        For settings, and for the samples.
    parts : int
        In how many pieces: systems end work that takes seconds.

    Returns
    -------
    (int, int)
        The rows of samples that are made: from, to.
    """
    gpu, form, wanted = lattice.strokes.gpu, picture.format, picture.wanted
    top, end = rows_of(picture, lattice)
    settings = settings_of(lattice, wanted.tolerance)
    for name, value in {
        "size": picture.shape[::-1],
        "pitch": picture.step,
        "offset": picture.offset,
        "frames": frames,
        "channels": picture.channels,
        "top": top,
        "tall": end - top,
        "groups": form.threads(picture.shape[1]),
        "held": (*held.frames, *held.rows),
        "slots": held.slots,
        "shift": held.shift,
        "blocks": held.samples.blocks,
        "bounds": picture.bounds,
        "white": wanted.white,
        "times": wanted.times,
    }.items():
        settings[name] = value
    settings["fill"][0, : picture.channels] = wanted.fill
    buffers = (told, *lattice.buffers[1:], lattice.view, held.samples.view, target)
    constants = picture.constants() | {"FOLDED": int(held.samples.blocks != (1, 1))}
    whole = np.dtype(form.dtype).kind == "u"
    names = (*_PARTS, "texels_whole" if whole else "texels_float")
    kinds = (*_CHECK, WHOLE_LAYERS if whole else LAYERS, WRITE)
    known, rough = (pipeline(gpu, names, entry, kinds, constants) for entry in ("warp", "solve_and_warp"))
    across = -(-picture.shape[1] * picture.step[0] // STEP)
    down = -(-(end - top) // picture.rows)
    parts = min(parts, down)
    for k in range(parts):
        first, last = down * k // parts, down * (k + 1) // parts
        settings["part"] = first, last if k < parts - 1 else 0xFFFFFFFF
        gpu.device.queue.write_buffer(told, 0, settings)
        run(
            gpu,
            [
                (known, buffers, (across, last - first, lattice.part.count)),
                (rough, buffers, lattice.buffers[6]),
            ],
        )
    return top, end


def unpacked(picture: Picture, words: Array, planes: int, rows: int) -> Array:
    """What the shader wrote, as samples (planes, rows, samples, channels)."""
    form = picture.format
    found = np.frombuffer(words, form.dtype, planes * target_size(picture, rows) // np.dtype(form.dtype).itemsize)
    return found.reshape(planes, rows, -1, form.channels)[:, :, : picture.shape[1]]
