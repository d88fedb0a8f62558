"""Deformations of volumes as displacement-field files, for other resampling tools."""

from __future__ import annotations

import os

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.engine.core import certificate_of, plan_of
from supple.engine.memory import beside
from supple.engine.sampling import Certificate, warn_of
from supple.engine.work import Space
from supple.errors import SuppleError
from supple.media.files import check_output
from supple.media.transforms import check_target, write_field
from supple.space.domain import number
from supple.space.geometry import Geometry, Grid

Floats = npt.NDArray[np.float64]
PathLike = str | os.PathLike[str]

MOST = 1 << 27
"""The bytes of a field that are held in memory: it is larger than its volume."""
ROUNDING = 2.0**-22
"""Samples: to that, source points are known, as the core holds their fractions as float32."""


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
        Of the volume; of the output, if it has another grid.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in voxels.
    out : float32 array, optional
        The array for the result; it may be mapped from a file.
    grid : Grid, optional
        The grid of the output, if it is not that of the input; the deformation must then know its place in space.
    warn : bool
        Whether to give a ToleranceWarning if the checks of the map's cells do not promise the tolerance everywhere.

    Returns
    -------
    float32 array, shape (Z, H, W, 3)
        The position of T⁻¹(q) minus that of q, in millimetres along the axes of LPS, x first.
    """
    _check(deformation)
    tolerance = number("tolerance", tolerance, "a number of voxels above 0", 1e-9, 1e9)
    space = deformation.space_on(grid)
    made = np.empty((*(deformation if grid is None else grid).shape, 3), np.float32) if out is None else out
    if space.is_identity:
        made[...] = 0
        return made
    matrix: Floats = geometry.matrix[:3, :3] if grid is None else deformation.grid.matrix[:3, :3]
    certificate = pull_of(space, matrix, tolerance, made, None if grid is None else between(deformation.grid, grid))
    if warn:
        warn_of(certificate, tolerance, 3)
    return made


def between(own: Grid, grid: Grid) -> tuple[Floats, Floats]:
    """Return the matrix and the shift from the indices of a grid, of all of it, to those of another in its space."""
    whole = grid.uncropped()
    turned = np.linalg.solve(own.matrix[:-1, :-1], whole.matrix[:-1, :-1])
    return np.asarray(turned, np.float64), own.indices(whole.origin)


def pull_of(
    space: Space,
    matrix: Floats,
    tolerance: float,
    out: npt.NDArray[np.float32],
    turned: tuple[Floats, Floats] | None = None,
) -> Certificate:
    """Write T⁻¹(q) - q for all samples q of the output, or of the part of it that the map's grid is.

    ``matrix`` leads from a vector in samples of the input, x first, to what is written, and ``turned``, a matrix and a
    shift, from an index of the output's whole grid to one of the input, if they differ. The certificate is of T⁻¹, in
    samples, before it is rounded to float32.
    """
    planes = out if space.ndim == 3 else out[None]
    first = (0,) * space.ndim if space.grid is None else space.grid.first
    certificate = Certificate(0.0, 0.0)
    # float64, since differences of positions would lose half their digits in float32.
    points, here = np.empty(planes.shape[1:]), np.zeros(planes.shape[1:])
    rows, columns = np.indices(planes.shape[1:3])
    here[..., 0], here[..., 1] = columns + first[0], rows + first[1]
    for k, plane in enumerate(planes):
        plan = plan_of(space, k, tolerance)
        plan.points(points)
        if space.ndim == 3:
            here[..., 2] = first[2] + k
        np.subtract(points, here if turned is None else here @ turned[0].T + turned[1], out=points)
        if space.composite is not None:
            points[np.abs(points) < ROUNDING] = 0  # where nothing moves, but what is solved is rounded
        np.matmul(points, matrix.T, out=plane, casting="same_kind")
        certificate |= certificate_of(plan, space)
    return certificate


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

    The target is ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha`` or ``.h5``; an existing file is replaced with ``force``.
    Other arguments are those of `displacement_of`.
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
