"""Deformations of volumes as displacement fields, for the tools that resample with those."""

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
from supple.geometry import Geometry
from supple.media.files import check_output
from supple.media.transforms import check_target, write_field

Floats = npt.NDArray[np.float64]
PathLike = str | os.PathLike[str]

MOST = 1 << 27
"""Bytes of a field that are held in memory: it is larger than its volume."""


def displacement_of(
    deformation: Deformation,
    geometry: Geometry,
    *,
    tolerance: float = 0.01,
    out: npt.NDArray[np.float32] | None = None,
) -> npt.NDArray[np.float32]:
    """How far from each voxel of the output, and in which direction, the input is fetched.

    Parameters
    ----------
    deformation : Deformation
        Of a volume.
    geometry : Geometry
        Where its voxels lie.
    tolerance : float
        How far a source point may be from the true T⁻¹(q), in voxels.
    out : float32 array, optional
        Where to put the result; it may be mapped from a file.

    Returns
    -------
    float32 array, shape (Z, H, W, 3)
        The place of T⁻¹(q) less the place of q, in millimetres along the axes of LPS, x first.

    Raises
    ------
    SuppleError
        The deformation is of an image, or the tolerance is no number above 0.

    Warns
    -----
    ToleranceWarning
        If the checks of the map's cells do not promise the tolerance everywhere.
    """
    _check(deformation)
    tolerance = number("tolerance", tolerance, "a number of voxels above 0", 1e-9, 1e9)
    space = deformation.space
    made = np.empty((*deformation.shape, 3), np.float32) if out is None else out
    if deformation.is_identity:
        made[...] = 0
        return made
    matrix, certificate = geometry.matrix[:3, :3], Certificate(0.0, 0.0)
    # In float64: in float32 a difference of places would lose half its digits.
    points, here = np.empty((*space.shape, 3)), np.zeros((*space.shape, 3))
    here[..., 1], here[..., 0] = np.indices(space.shape)
    for z in range(space.count):
        plan = plan_of(space, z, tolerance)
        plan.points(points)
        here[..., 2] = z
        np.matmul(points - here, matrix.T, out=made[z], casting="same_kind")
        certificate |= certificate_of(plan)
    warn_of(certificate, tolerance, 3)
    return made


def write_transform(
    target: PathLike, deformation: Deformation, geometry: Geometry, *, tolerance: float = 0.01, force: bool = False
) -> None:
    """Write a deformation of a volume as a displacement field, by which ITK, ANTs and 3D Slicer resample the same.

    Parameters
    ----------
    target : str or os.PathLike
        ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha`` or ``.h5``; see `supple.media.transforms.write_field`.
    deformation, geometry, tolerance
        As `displacement_of` takes them.
    force : bool
        Whether to replace a file that exists.

    Raises
    ------
    SuppleError
        As `displacement_of` does, or if the file cannot be written (known before any work is done, where it can be).
    """
    check_target(target)
    check_output(target, force=force)
    _check(deformation)
    with beside(target, (*deformation.shape, 3), np.float32, MOST) as out:
        write_field(target, displacement_of(deformation, geometry, tolerance=tolerance, out=out), geometry, force=force)


def _check(deformation: Deformation) -> None:
    if deformation.ndim != 3:
        raise SuppleError(f"a displacement field is of a volume, and shape {deformation.shape} has two axes")
