"""The lattice of T⁻¹ in a volume, solved and checked by shaders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.folding.strain import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import constants, uploaded
from supple.gpu.memory import download, owned, room, solid, upload
from supple.gpu.shader import CUT, LOST, Pace, shader, source

Floats = npt.NDArray[np.float64]

_NODE = 64  # bytes
_FIRST = 4096  # initial number of nodes, before their time is known
_UNSOLVED = "nodes of the lattice could not be solved in its numbers"


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Strokes on a device and, for a volume, the lattice of their inverse map.

    Parameters
    ----------
    constants : dict of str to int
        Those with which shaders are compiled for the strokes.
    settings, resources : dict
        What shaders read: numbers, buffers and the texture of nodes.
    step : int
        Voxels from node to node; the first is the first voxel. 0 without a lattice.
    nodes : float32 array, shape (nz, ny, nx, 16), or None
        The displacement T⁻¹(q) - q in voxels, x first, and the columns of ∂p/∂q; each padded with a 0.
    error : float
        A bound on the distance of a source point from T⁻¹(q), in voxels, from the checks, with their reserve; infinity
        if even the finest lattice is too coarse for the checks.
    smooth : float
        The least length scale of the map, in voxels.
    """

    constants: dict[str, int]
    settings: dict[str, Any]
    resources: dict[str, Any]
    step: int = 0
    nodes: npt.NDArray[np.float32] | None = None
    error: float = 0.0
    smooth: float = 0.0


def hold_strokes(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None = None) -> Lattice:
    """Return strokes on the device without a lattice."""
    settings = {"nodes": (2, 2, 2), "spread": 0.0, "strokes": table.size}
    return Lattice(constants(table, freeze), settings, {**uploaded(gpu, table, axes, freeze), "lattice": None})


def solve(
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, ...],
    step: int,
    freeze: Mask | None = None,
) -> Lattice:
    """Solve for T⁻¹ at nodes ``step`` voxels apart, in a volume of ``shape`` (Z, H, W).

    Raises
    ------
    MemoryError
        If the lattice exceeds the largest texture.
    ArithmeticError
        If nodes could not be solved in float32, or by this driver.
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
    given = {**uploaded(gpu, table, axes, freeze), "lattice": texture.create_view()}
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
                    # The memory layout: layers, two by two, rows, two by two, nodes.
                    laid = found.reshape(count, 2, down, 2, pitch, 4)[..., :across, :].transpose(0, 2, 4, 1, 3, 5)
                    nodes[first : first + count] = laid.reshape(count, down, across, 16)
                error, smooth = download(gpu, stats, np.float32, 2)  # waits
                if not error < np.float32(LOST):
                    raise ArithmeticError("its driver ends loops of many turns" if error >= CUT else _UNSOLVED)
    if not np.isfinite(nodes).all():  # shaders may assume finite numbers
        raise ArithmeticError(_UNSOLVED)
    return Lattice(known, settings, given, step, nodes, float(error), float(smooth))
