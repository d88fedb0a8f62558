"""T⁻¹ in a volume: solved at the nodes of a cubic lattice, interpolated in between, and certified.

For rendering, which needs source points anywhere and not only on planes. The step of the lattice is halved until the
largest observed error between its nodes is within the tolerance; the arithmetic is in ``_core/solid.hpp``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.deformation import Deformation
from supple.engines.base import Space
from supple.errors import SuppleError, ToleranceWarning
from supple.space.domain import refuse
from supple.strokes import numbers

Floats = npt.NDArray[np.float64]

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
    evaluations : float
        The number of evaluations of T with its Jacobian.
    """

    nodes: npt.NDArray[np.float32]
    step: int
    error: float
    evaluations: float

    @property
    def lattice(self) -> _core.Lattice:
        """Return the nodes in the layout of the core."""
        return _core.Lattice(np.require(self.nodes, np.float32, ["C", "W"]), self.step)

    def at(self, points: npt.ArrayLike) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return the displacement at points (N, 3), and ∂p/∂q, of shape (N, 3, 3), a row for each component of p."""
        given = np.ascontiguousarray(points, np.float32)
        out = np.empty((len(given), 4, 3), np.float32)
        self.lattice.between(given, out)
        return out[:, 0], out[:, 1:].transpose(0, 2, 1)


def checked(given: Deformation | None, shape: tuple[int, ...], spacing: tuple[float, ...]) -> Deformation | None:
    """Return the deformation of a scene's volume; None for one that moves nothing.

    SuppleError if it is of another shape or spacing, or not of strokes alone.
    """
    deformation: object = given
    if deformation is None:
        return None
    if not isinstance(deformation, Deformation):
        refuse("deformation", "a Deformation", deformation)
    if deformation.shape != shape:
        refuse("the deformation", f"one of shape {shape}, as the volume", told=f"shape {deformation.shape}")
    if deformation.maps:
        raise SuppleError("a scene is bent by strokes alone, found fields or affine maps: warp the volume first")
    if not np.allclose(deformation.domain.spacing, spacing):
        refuse("the deformation", f"one of spacing {spacing}", deformation.domain.spacing)
    return None if deformation.is_identity else deformation


def warn_of_coarse(error: float, tolerance: float, stacklevel: int) -> None:
    """Warn that a lattice is off by more than the tolerance."""
    off = f"by {error:.2g} voxels" if math.isfinite(error) else "by more than a voxel"
    warnings.warn(
        f"the lattice may be off {off} somewhere, beyond the tolerance {tolerance:g}: "
        "mode='exact' stays within it, and so does mode='buffered'",
        ToleranceWarning,
        stacklevel=stacklevel + 1,
    )


def strokes_of(space: Space) -> _core.Strokes:
    """Return a map of strokes in the layout of the core."""
    return _core.Strokes(numbers(space.table), np.ascontiguousarray(space.axes), space.freeze)


def solve_solid(
    space: Space,
    shape: tuple[int, ...],
    tolerance: float,
    attempt: Callable[[int], tuple[Solid, float]] | None = None,
) -> Solid:
    """Solve for T⁻¹ on a lattice in a volume of ``shape`` (Z, H, W), as fine as the tolerance needs, in voxels.

    The error tells if the finest lattice is accurate enough. ``attempt`` solves with a step in voxels, and also returns
    the length scale of the map; by default, it is the core's.
    """
    strokes = strokes_of(space)
    step, evaluations = COARSEST, 0.0
    while True:
        solid, smooth = attempt(step) if attempt else _solve(strokes, shape, step)
        evaluations += solid.evaluations
        # Checked points do not represent the map if it varies between them.
        resolved = step <= RESOLVED * smooth
        if (solid.error <= tolerance and resolved) or step == FINEST:
            return Solid(solid.nodes, step, solid.error if resolved else math.inf, evaluations)
        # The error falls with the cube of the step.
        finer = min(step * (tolerance / max(solid.error, tolerance)) ** (1 / 3), max(RESOLVED * smooth, FINEST))
        step = max(FINEST, min(step // 2, 2 ** math.floor(math.log2(max(finer, 1.0)))))


def _solve(strokes: _core.Strokes, shape: tuple[int, ...], step: int) -> tuple[Solid, float]:
    """Return a lattice, and the length scale of the map, in voxels: the least at its nodes."""
    counts = tuple(-(-max(n - 1, 1) // step) + 1 for n in shape)
    nodes = np.empty((*counts, _core.NODE), np.float32)
    lattice = _core.Lattice(nodes, step)
    evaluations, smooth = lattice.solve(strokes)
    return Solid(nodes, step, lattice.error(strokes), evaluations), smooth


def cells_along_rays(solid: Solid, tolerance: float) -> int:
    """Return the number of cells of a lattice that a cubic along a ray may span."""
    return 2 if _TWICE * solid.error <= tolerance else 1


def along_rays(solid: Solid, cells: int, tolerance: float) -> float:
    """Return the error of source points, in voxels, on cubics over cells of a lattice along rays."""
    if cells == 2:
        return _TWICE * solid.error
    # If the lattice is accurate enough, its reserve covers the additional error.
    return min(_ONCE * solid.error, tolerance if solid.error <= tolerance else math.inf)
