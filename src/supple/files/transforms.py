"""Deformations of volumes as displacement-field files, for other resampling tools."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.buffers import beside
from supple.deformation import Deformation
from supple.domain import number
from supple.engines.base import Certificate, warn_of
from supple.engines.native import certificate_of, plan_of
from supple.errors import SuppleError
from supple.geometry import Geometry, Grid
from supple.media.files import check_output
from supple.media.transforms import check_target, write_field

Floats = npt.NDArray[np.float64]
PathLike = str | os.PathLike[str]

MOST = 1 << 27
"""The bytes of a field that are held in memory: it is larger than its volume."""


def displacement_of(
    deformation: Deformation,
    geometry: Geometry,
    *,
    tolerance: float = 0.01,
    out: npt.NDArray[np.float32] | None = None,
    grid: Grid | None = None,
    warn: bool = True,
) -> npt.NDArray[np.float32]:
    """Return the displacement from each voxel of the output to its source point in the input.

    Parameters
    ----------
    deformation : Deformation
        A deformation of a volume.
    geometry : Geometry
        The geometry of the volume; of the output, if it has another grid.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in voxels.
    out : float32 array, optional
        The array for the result; it may be mapped from a file.
    grid : Grid, optional
        The grid of the output, if it is not that of the input; the deformation must then know its place in space.
    warn : bool
        Whether to warn.

    Returns
    -------
    float32 array, shape (Z, H, W, 3)
        The position of T⁻¹(q) minus that of q, in millimetres along the axes of LPS, x first.

    Raises
    ------
    SuppleError
        If the deformation is of an image, or the tolerance is not a number above 0.

    Warns
    -----
    ToleranceWarning
        If the checks of the map's cells do not promise the tolerance everywhere.
    """
    _check(deformation)
    tolerance = number("tolerance", tolerance, "a number of voxels above 0", 1e-9, 1e9)
    space = deformation.space_on(grid)
    made = np.empty((*(deformation if grid is None else grid).shape, 3), np.float32) if out is None else out
    if space.is_identity:
        made[...] = 0
        return made
    held = deformation.grid if grid is None else grid.uncropped()
    first = (0, 0, 0) if grid is None else grid.first
    # In voxels of the input, those of the output lie at index @ turned.T + shift.
    matrix: Floats = geometry.matrix[:3, :3] if grid is None else deformation.grid.matrix[:3, :3]
    turned: Any = np.eye(3) if grid is None else np.linalg.solve(matrix, held.matrix[:3, :3])
    shift = np.zeros(3) if grid is None else deformation.grid.indices(held.origin)
    certificate = Certificate(0.0, 0.0)
    # float64, since differences of positions would lose half their digits in float32.
    points, here = np.empty(made.shape[1:]), np.zeros(made.shape[1:])
    rows, columns = np.indices(made.shape[1:3])
    here[..., 0], here[..., 1] = columns + first[0], rows + first[1]
    for k in range(len(made)):
        plan = plan_of(space, k, tolerance)
        plan.points(points)
        here[..., 2] = first[2] + k
        at = here if grid is None else here @ turned.T + shift
        np.matmul(points - at, matrix.T, out=made[k], casting="same_kind")
        certificate |= certificate_of(plan, space)
    if warn:
        warn_of(certificate, tolerance, 3)
    return made


def write_transform(
    target: PathLike,
    deformation: Deformation,
    geometry: Geometry,
    *,
    tolerance: float = 0.01,
    force: bool = False,
    grid: Grid | None = None,
    warn: bool = True,
) -> None:
    """Write a deformation of a volume as a displacement field for ITK, ANTs and 3D Slicer.

    Parameters
    ----------
    target : str or os.PathLike
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha`` or ``.h5``; see `supple.media.transforms.write_field`.
    deformation, geometry, tolerance, grid
        As in `displacement_of`.
    force : bool
        Whether to replace an existing file.
    warn : bool
        Whether to warn as `displacement_of` does.

    Raises
    ------
    SuppleError
        As in `displacement_of`, or if the file cannot be written (checked before any work, if possible).
    """
    check_target(target)
    check_output(target, force=force)
    _check(deformation)
    shape = deformation.shape if grid is None else grid.shape
    with beside(target, (*shape, 3), np.float32, MOST) as out:
        made = displacement_of(deformation, geometry, tolerance=tolerance, out=out, grid=grid, warn=warn)
        write_field(target, made, geometry, force=force)


def _check(deformation: Deformation) -> None:
    if deformation.ndim != 3:
        raise SuppleError(f"a displacement field is of a volume, and shape {deformation.shape} has two axes")
