"""T⁻¹ in a volume: solved at the nodes of a cubic lattice, interpolated in between, and certified.

For pictures of a volume, which need source points anywhere and not only on its planes. The lattice is halved until
the largest error that is seen between its nodes is within the tolerance; the arithmetic is in ``_core/solid.hpp``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.strokes import numbers

Floats = npt.NDArray[np.float64]

COARSEST, FINEST = 8, 2  # voxels from node to node: a finer lattice would be larger than the volume
# A cell may be as large as this part of the length over which the map varies: beyond, what is seen at points says
# little about what lies between them.
RESOLVED = 0.5
_TWICE, _ONCE = 3.0, 1.25  # times the lattice's error, cubics over two of its cells and over one were not farther off


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """The inverse displacements of a volume.

    Parameters
    ----------
    nodes : float32 array, shape (nz, ny, nx, 16)
        The displacement T⁻¹(q) - q in voxels, x first, and the columns of ∂p/∂q; each followed by a 0.
    step : int
        Voxels from node to node; the first is the first voxel.
    error : float
        How far a source point is from the true T⁻¹(q), in voxels, as far as the checks see, with their reserve;
        infinity where even the finest lattice is too coarse for them to see anything.
    evaluations : float
        Of T with its Jacobian.
    """

    nodes: npt.NDArray[np.float32]
    step: int
    error: float
    evaluations: float

    @property
    def lattice(self) -> _core.Lattice:
        """The nodes as the core takes them."""
        return _core.Lattice(np.require(self.nodes, np.float32, ["C", "W"]), self.step)

    def at(self, points: npt.ArrayLike) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return the displacement at points (N, 3), and ∂p/∂q, of shape (N, 3, 3), a row for each component of p."""
        given = np.ascontiguousarray(points, np.float32)
        out = np.empty((len(given), 4, 3), np.float32)
        self.lattice.between(given, out)
        return out[:, 0], out[:, 1:].transpose(0, 2, 1)


def strokes_of(table: npt.NDArray[np.void], axes: Floats) -> _core.Strokes:
    """Return a table of strokes and the axes of their domain as the core takes them."""
    return _core.Strokes(numbers(table), np.ascontiguousarray(axes))


def solve_solid(
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, ...],
    tolerance: float,
    attempt: Callable[[int], tuple[Solid, float]] | None = None,
) -> Solid:
    """Solve for T⁻¹ on a lattice in a volume of ``shape`` (Z, H, W), as fine as the tolerance needs, in voxels.

    The error says whether the finest was enough. ``attempt`` solves with so many voxels from node to node, and returns
    the least length over which the map varies, too; by default, it is the core's.
    """
    strokes = strokes_of(table, axes)
    step, evaluations = COARSEST, 0.0
    while True:
        solid, smooth = attempt(step) if attempt else _solve(strokes, shape, step)
        evaluations += solid.evaluations
        # What is seen at points says little where the map varies between them.
        resolved = step <= RESOLVED * smooth
        if (solid.error <= tolerance and resolved) or step == FINEST:
            return Solid(solid.nodes, step, solid.error if resolved else math.inf, evaluations)
        # The error falls with the cube of the step.
        finer = min(step * (tolerance / max(solid.error, tolerance)) ** (1 / 3), max(RESOLVED * smooth, FINEST))
        step = max(FINEST, min(step // 2, 2 ** math.floor(math.log2(max(finer, 1.0)))))


def _solve(strokes: _core.Strokes, shape: tuple[int, ...], step: int) -> tuple[Solid, float]:
    """Return a lattice, and the least length, in voxels, over which the map varies at a node."""
    counts = tuple(-(-max(n - 1, 1) // step) + 1 for n in shape)
    nodes = np.empty((*counts, _core.NODE), np.float32)
    lattice = _core.Lattice(nodes, step)
    evaluations, smooth = lattice.solve(strokes)
    return Solid(nodes, step, lattice.error(strokes), evaluations), smooth


def cells_along_rays(solid: Solid, tolerance: float) -> int:
    """Return over how many cells of a lattice a cubic along a ray may go."""
    return 2 if _TWICE * solid.error <= tolerance else 1


def along_rays(solid: Solid, cells: int, tolerance: float) -> float:
    """Return how far off source points are, in voxels, where rays go along cubics over cells of a lattice."""
    if cells == 2:
        return _TWICE * solid.error
    # Where the lattice is good enough, the reserve that it was looked at with has room for the rest, too.
    return min(_ONCE * solid.error, tolerance if solid.error <= tolerance else math.inf)
