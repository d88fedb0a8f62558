"""The lattice of T⁻¹ in a volume, solved and checked by shaders."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.folding.strain import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import FIELD, constants, uploaded
from supple.gpu.kernel import (
    CUT,
    READ,
    SOLID,
    TURNS,
    UNIFORM,
    WRITE,
    Pace,
    download,
    owned,
    pipeline,
    room,
    run,
    unsolved,
    upload,
)
from supple.gpu.texels import copy_in, solid

Floats = npt.NDArray[np.float64]

_NAMES = ("nodes", "smooth", "solid", "blend", *FIELD, "turns")
_KINDS = (UNIFORM, UNIFORM, READ, SOLID, WRITE, WRITE, READ)
_NODE = 64  # bytes
_FIRST = 4096  # initial number of nodes, before their time is known
_LOST, _CUT = np.float32(1e30), np.float32(2e30)  # codes in place of errors, as in nodes.wgsl
_UNSOLVED = "nodes of the lattice could not be solved in its numbers"

_SETTINGS = np.dtype(
    [("nodes", "u4", 3), ("spread", "f4"), ("strokes", "u4"), ("first", "u4"), ("last", "u4"), ("turns", "u4")]
)


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Strokes on a device and, for a volume, the lattice of their map.

    Parameters
    ----------
    gpu : Gpu
    nodes : wgpu.GPUTextureView
        The nodes of the lattice, in the layout of solid.wgsl.
    domain, strokes, mask
        Buffers.
    shape : (int, int, int)
        Nodes, x first.
    spread : float
        Voxels from node to node; 0 for the identity, or without a lattice.
    count : int
        The number of strokes.
    constants : dict of str to int
        Those with which shaders are compiled for the strokes.
    cells : int
        The number of cells that a ray may cross with one cubic.
    """

    gpu: Gpu
    nodes: Any
    domain: Any
    strokes: Any
    mask: Any
    shape: tuple[int, int, int]
    spread: float
    count: int
    constants: dict[str, int]
    cells: int = 1


def hold_strokes(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None = None) -> Lattice:
    """Return strokes on the device without a lattice; its nodes are placeholders."""
    return Lattice(
        gpu,
        solid(gpu, (4, 4, 2), np.float32, 4).create_view(),
        *uploaded(gpu, table, axes, freeze),
        (2, 2, 2),
        0.0,
        table.size,
        constants(table, freeze),
    )


def solve(
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, ...],
    step: int,
    freeze: Mask | None = None,
) -> tuple[Lattice, npt.NDArray[np.float32], float, float]:
    """Solve for T⁻¹ at nodes ``step`` voxels apart, in a volume of ``shape`` (Z, H, W).

    Returns
    -------
    Lattice
    float32 array (nz, ny, nx, 16)
        Its nodes, in the layout of `supple.render.solid`.
    float
        The largest observed error, in voxels, with its reserve.
    float
        The least length scale of the map, in voxels.

    Raises
    ------
    MemoryError
        If the lattice exceeds the largest texture.
    ArithmeticError
        If nodes could not be solved in float32, or by this driver.
    """
    counts = tuple(-(-max(n - 1, 1) // step) + 1 for n in reversed(shape))
    across, down, deep = counts
    pitch = -(-across // 16) * 16
    layer = pitch * down * _NODE
    if layer > gpu.binding:
        raise MemoryError("a layer of such a lattice is more than a shader takes")
    if deep * layer > gpu.texture:
        raise MemoryError(f"a lattice of {deep * layer >> 20} MB is more than is put into a texture")
    texture = solid(gpu, (2 * deep, 2 * down, across), np.float32, 4)
    made = Lattice(
        gpu,
        texture.create_view(),
        *uploaded(gpu, table, axes, freeze),
        (across, down, deep),
        float(step),
        table.size,
        constants(table, freeze),
    )
    nodes = np.empty((deep, down, across, 16), np.float32)
    settings = np.zeros(1, _SETTINGS)
    settings["nodes"], settings["spread"], settings["strokes"] = counts, step, table.size
    settings["turns"] = TURNS
    most = min(max(1, gpu.binding // layer), deep)
    pace = Pace(max(1, _FIRST // (across * down)), most)
    with contextlib.ExitStack() as stack:
        stats, some = owned(stack, upload(gpu, np.array([0.0, 1e30], np.float32)), room(gpu, most * layer))
        for entry, layers in (("solve", deep), ("check", deep - 1)):
            work = pipeline(gpu, _NAMES, entry, _KINDS, made.constants)
            for first, count in pace.parts(layers):
                settings["first"], settings["last"] = first, first + count
                with contextlib.ExitStack() as own:
                    (told,) = owned(own, upload(gpu, settings, UNIFORM))
                    groups = tuple(-(-n // 4) for n in (across, down, count))
                    buffers = [told, made.domain, made.strokes, made.nodes, some, stats, made.mask]
                    run(gpu, [(work, buffers, groups)])
                    if entry == "solve":
                        copy_in(gpu, some, pitch, texture, 2 * first, 2 * count)
                        found = download(gpu, some, np.float32, count * layer // 4)
                        # The memory layout: layers, two by two, rows, two by two, nodes.
                        laid = found.reshape(count, 2, down, 2, pitch, 4)[..., :across, :].transpose(0, 2, 4, 1, 3, 5)
                        nodes[first : first + count] = laid.reshape(count, down, across, 16)
                    seen = download(gpu, stats, np.float32, 2)  # waits
                    if not seen[0] < _LOST:
                        raise ArithmeticError(unsolved(CUT) if seen[0] >= _CUT else _UNSOLVED)
        error, smooth = float(seen[0]), float(seen[1])
    if not np.isfinite(nodes).all():  # shaders may assume finite numbers
        raise ArithmeticError(_UNSOLVED)
    return made, nodes, error, smooth
