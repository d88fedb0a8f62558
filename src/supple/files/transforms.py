"""Deformations of volumes as displacement-field files, for other resampling tools."""

from __future__ import annotations

import os

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
    made = np.empty((*space.out, 3), np.float32) if out is None else out
    if space.is_identity:
        made[...] = 0
        return made
    # In voxels of the input, those of the output lie at index @ turned.T + shift.
    matrix: Floats = geometry.matrix[:3, :3]
    turned: Floats = np.eye(3)
    shift: Floats = np.zeros(3)
    if grid is not None:
        matrix = deformation.grid.matrix[:3, :3]
        turned = np.linalg.solve(matrix, grid.matrix[:3, :3])
        shift = deformation.grid.indices(grid.origin)
    certificate, shape = Certificate(0.0, 0.0), space.out[1:]
    # float64, since differences of positions would lose half their digits in float32.
    points, here = np.empty((*shape, 3)), np.zeros((*shape, 3))
    here[..., 1], here[..., 0] = np.indices(shape)
    for z in range(space.out[0]):
        plan = plan_of(space, z, tolerance)
        plan.points(points)
        here[..., 2] = z
        at = here if grid is None else here @ turned.T + shift
        np.matmul(points - at, matrix.T, out=made[z], casting="same_kind")
        certificate |= certificate_of(plan)
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
        made = displacement_of(deformation, geometry, tolerance=tolerance, out=out, grid=grid)
        write_field(target, made, geometry, force=force)


def _check(deformation: Deformation) -> None:
    if deformation.ndim != 3:
        raise SuppleError(f"a displacement field is of a volume, and shape {deformation.shape} has two axes")
