"""The lattice of T⁻¹ in a volume, solved and looked at by shaders."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu
from supple.gpu.field import domain, packed
from supple.gpu.kernel import READ, TURNS, UNIFORM, WRITE, Pace, download, owned, pipeline, room, run, upload

Floats = npt.NDArray[np.float64]

_NAMES = ("nodes", "smooth", "solid", "blend", "field", "newton", "turns")
_KINDS = (UNIFORM, UNIFORM, READ, WRITE, WRITE)
_NODE = 64  # bytes
_FIRST = 4096  # nodes at once, before it is known what they take

_SETTINGS = np.dtype(
    [("nodes", "u4", 3), ("spread", "f4"), ("strokes", "u4"), ("first", "u4"), ("last", "u4"), ("turns", "u4")]
)


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Strokes on a device and, of a volume, the lattice of what they do.

    Parameters
    ----------
    gpu : Gpu
    nodes, strokes, domain
        Buffers.
    shape : (int, int, int)
        Nodes, x first.
    spread : float
        Voxels from node to node; 0 where nothing moves, or no lattice was solved.
    count : int
        How many strokes.
    cells : int
        Over how many cells a ray may go on along one cubic.
    """

    gpu: Gpu
    nodes: Any
    strokes: Any
    domain: Any
    shape: tuple[int, int, int]
    spread: float
    count: int
    cells: int = 1


def hold_strokes(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats) -> Lattice:
    """Strokes without a lattice: there is a node or two that nothing is made of."""
    return Lattice(
        gpu,
        room(gpu, 8 * _NODE),
        upload(gpu, packed(table)),
        upload(gpu, domain(axes), UNIFORM),
        (2, 2, 2),
        0.0,
        table.size,
    )


def solve(
    gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, shape: tuple[int, ...], step: int
) -> tuple[Lattice, npt.NDArray[np.float32], float, float]:
    """Solve for T⁻¹ at nodes ``step`` voxels apart, in a volume of ``shape`` (Z, H, W).

    Returns
    -------
    Lattice
    float32 array (nz, ny, nx, 16)
        Its nodes, as `supple.cpu.solid` has them.
    float
        The worst error that is seen, in voxels, with its reserve.
    float
        The least length over which the map varies, in voxels.

    Raises
    ------
    MemoryError
        If such a lattice is more than a shader takes.
    """
    counts = tuple(-(-max(n - 1, 1) // step) + 1 for n in reversed(shape))
    size = int(np.prod(counts)) * _NODE
    if size > gpu.binding:
        raise MemoryError(f"a lattice of {size >> 20} MB is more than a shader takes, {gpu.binding >> 20} MB")
    made = Lattice(
        gpu,
        room(gpu, size),
        upload(gpu, packed(table)),
        upload(gpu, domain(axes), UNIFORM),
        (counts[0], counts[1], counts[2]),
        float(step),
        table.size,
    )
    settings = np.zeros(1, _SETTINGS)
    settings["nodes"], settings["spread"], settings["strokes"] = counts, step, table.size
    settings["turns"] = TURNS
    pace = Pace(max(1, _FIRST // (counts[0] * counts[1])))
    with contextlib.ExitStack() as stack:
        (stats,) = owned(stack, upload(gpu, np.array([0.0, 1e30], np.float32)))
        for entry, layers in (("solve", counts[2]), ("check", counts[2] - 1)):
            work = pipeline(gpu, _NAMES, entry, _KINDS)
            for first, count in pace.parts(layers):
                settings["first"], settings["last"] = first, first + count
                with contextlib.ExitStack() as own:
                    (told,) = owned(own, upload(gpu, settings, UNIFORM))
                    groups = tuple(-(-n // 4) for n in (counts[0], counts[1], count))
                    run(gpu, [(work, [told, made.domain, made.strokes, made.nodes, stats], groups)])
                    seen = download(gpu, stats, np.float32, 2)  # waits
        error, smooth = float(seen[0]), float(seen[1])
    nodes = download(gpu, made.nodes, np.float32, size // 4).reshape(*reversed(counts), 16)
    return made, nodes, error, smooth
