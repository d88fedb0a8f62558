"""T⁻¹ in a volume: solved at the nodes of a cubic lattice by a GPU, interpolated in between, and certified.

A GPU fills its buffer from it, and sees it while the buffer is not full. The step is halved until the largest observed
error between nodes is within the tolerance; the arithmetic is in ``solid.wgsl`` and ``nodes.wgsl``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple.errors import ToleranceWarning, argument

COARSEST, FINEST = 8, 2  # voxels from node to node: a finer lattice would be larger than the volume
# The largest size of a cell, as a fraction of the length scale of the map: in larger cells, the checked points do not
# represent the points between them.
RESOLVED = 0.5
_TWICE, _ONCE = 3.0, 1.25  # measured errors of cubics over two cells and over one, relative to the lattice's


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """The inverse displacements of a volume.

    Parameters
    ----------
    nodes : float32 array, shape (nz, ny, nx, 16)
        The displacement T⁻¹(q) - q in voxels, x first, and the columns of ∂p/∂q; each padded with a 0.
    step : int
        Voxels from node to node; the first is the first voxel.
    error : float
        A bound on the distance of a source point from T⁻¹(q), in voxels, from the checks, with their reserve; infinity
        if even the finest lattice is too coarse for the checks.
    """

    nodes: npt.NDArray[np.float32]
    step: int
    error: float


def warn_of_coarse(error: float, tolerance: float, stacklevel: int) -> None:
    """Warn that a lattice is off by more than the tolerance."""
    off = f"by {error:.2g} voxels" if math.isfinite(error) else "by more than a voxel"
    warnings.warn(
        f"the lattice may be off {off} somewhere, beyond the tolerance {tolerance:g}: "
        f"{argument('mode', 'exact')} stays within it, and so does {argument('mode', 'buffered')}",
        ToleranceWarning,
        stacklevel=stacklevel + 1,
    )


def solve_solid(attempt: Callable[[int], tuple[Solid, float]], tolerance: float) -> Solid:
    """Solve for T⁻¹ on a lattice as fine as the tolerance needs, in voxels.

    The error tells if the finest lattice is accurate enough. ``attempt`` solves with a step in voxels, and also returns
    the length scale of the map.
    """
    step = COARSEST
    while True:
        solid, smooth = attempt(step)
        # Checked points do not represent the map if it varies between them.
        resolved = step <= RESOLVED * smooth
        if (solid.error <= tolerance and resolved) or step == FINEST:
            return Solid(solid.nodes, step, solid.error if resolved else math.inf)
        # The error falls with the cube of the step.
        finer = min(step * (tolerance / max(solid.error, tolerance)) ** (1 / 3), max(RESOLVED * smooth, FINEST))
        step = max(FINEST, min(step // 2, 2 ** math.floor(math.log2(max(finer, 1.0)))))


def cells_along_rays(solid: Solid, tolerance: float) -> int:
    """Return the number of cells of a lattice that a cubic along a ray may span."""
    return 2 if _TWICE * solid.error <= tolerance else 1


def along_rays(solid: Solid, cells: int, tolerance: float) -> float:
    """Return the error of source points, in voxels, on cubics over cells of a lattice along rays."""
    if cells == 2:
        return _TWICE * solid.error
    # If the lattice is accurate enough, its reserve covers the additional error.
    return min(_ONCE * solid.error, tolerance if solid.error <= tolerance else math.inf)
