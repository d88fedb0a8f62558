"""Displacement fields as files for resampling by ITK, ANTs and 3D Slicer."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, check_suffix, replacing, unwritable
from supple.media.volume import itk, nifti
from supple.media.volume.nifti import LONGEST
from supple.space.geometry import Geometry

Field = npt.NDArray[np.floating[Any]]

SUFFIXES_OUT = (".nii", ".nii.gz", ".nrrd", ".mha", ".h5")
_OVERHEAD = 1 << 16  # more than the size of a transform's HDF5 file without the field
_CHUNK = 1 << 20
_TYPES = {np.dtype(np.float32): ("float", "MET_FLOAT"), np.dtype(np.float64): ("double", "MET_DOUBLE")}


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a name whose suffix is not in `SUFFIXES_OUT`."""
    if _suffix(path) is None:
        check_suffix(path, Path(path).suffix, (), "is of no transform", f"use {', '.join(SUFFIXES_OUT)}")


def write_field(path: PathLike, displacement: Field, geometry: Geometry, *, force: bool = False) -> None:
    """Write a displacement field for resampling a volume onto the field's grid by ITK, ANTs and 3D Slicer.

    Each voxel of the output holds the displacement to its source point in the input. The file appears whole or not at
    all.

    Parameters
    ----------
    path : str or os.PathLike
        ``.nii`` and ``.nii.gz`` (a vector for each voxel, intent 1007, as ANTs writes it), ``.nrrd`` and ``.mha`` (a
        vector image), or ``.h5`` (a transform of ITK's, in float64).
    displacement : float32 or float64 array, shape (Z, H, W, 3)
        In millimetres along the axes of LPS, x first, for any convention of ``geometry``. It is read plane by plane,
        except for NIfTI, which takes one component of the whole at a time.
    geometry : Geometry
        The geometry of the voxels.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    SuppleError
        If the array has another shape or type, holds NaN or infinity, or is too large for the format; or the file
        cannot be written.
    """
    check_target(path)
    name, suffix = shown(path), _suffix(path)
    field = np.asarray(displacement)
    if field.ndim != 4 or field.shape[3] != 3 or 0 in field.shape or field.dtype not in _TYPES:
        wanted = "an array of shape (Z, H, W, 3) in float32 or float64"
        raise SuppleError(f"cannot write {name}: a field is {wanted}, and not {field.dtype} of shape {field.shape}")
    if not all(np.isfinite(plane).all() for plane in field):
        raise SuppleError(f"cannot write {name}: a field must be finite, found NaN or infinity")
    if suffix in (".nii", ".nii.gz") and max(field.shape) > LONGEST:
        sizes = " x ".join(map(str, field.shape[2::-1]))
        what = f"NIfTI ends at {LONGEST} voxels on a side, and the field has {sizes}"
        raise unwritable(path, what, "write .nrrd or .mha")
    with replacing(path, force=force) as temporary:
        if suffix == ".h5":
            write_transform(path, temporary, _transform_of(field, geometry), 8 * field.size)
            return
        with nifti.writing(temporary, suffix or "") as file:
            if suffix in (".nii", ".nii.gz"):
                _write_nifti(file, field, geometry)
            else:
                file.write((_nrrd if suffix == ".nrrd" else _mha)(field, geometry).encode())
                for plane in field:
                    file.write(np.ascontiguousarray(plane, plane.dtype.newbyteorder("<")).data)


def _suffix(path: PathLike) -> str | None:
    name = Path(path).name.lower()
    return next((suffix for suffix in sorted(SUFFIXES_OUT, key=len, reverse=True) if name.endswith(suffix)), None)


def _write_nifti(file: IO[bytes], field: Field, geometry: Geometry) -> None:
    nibabel = nifti.imported()
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ geometry.matrix  # the grid in RAS; the vectors stay in LPS, as ITK's do
    image = nibabel.Nifti1Image(field.transpose(2, 1, 0, 3)[:, :, :, None], affine)
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1)
    image.header.set_intent("vector")
    image.header.set_xyzt_units("mm")
    image.to_file_map({"image": nibabel.FileHolder(fileobj=file)})


# Kept: SimpleITK copies a field before it writes it, and of a NRRD does not notice that the disk is full
# (test_a_full_disk_leaves_what_was_there_and_no_word_of_itks).


def _nrrd(field: Field, geometry: Geometry) -> str:
    def vector(numbers: npt.ArrayLike) -> str:
        return f"({','.join(_spelled(numbers))})"

    lines = {
        "type": _TYPES[field.dtype][0],
        "dimension": "4",
        "space": "left-posterior-superior",
        "sizes": f"3 {' '.join(map(str, field.shape[2::-1]))}",
        "space directions": " ".join(["none", *(vector(axis) for axis in geometry.matrix[:3, :3].T)]),
        "kinds": "vector domain domain domain",
        "endian": "little",
        "encoding": "raw",
        "space origin": vector(geometry.origin),
    }
    return "".join(["NRRD0004\n", *(f"{key}: {value}\n" for key, value in lines.items()), "\n"])


def _mha(field: Field, geometry: Geometry) -> str:
    lines = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        "TransformMatrix": " ".join(_spelled(geometry.direction.T.ravel())),
        "Offset": " ".join(_spelled(geometry.origin)),
        "CenterOfRotation": "0 0 0",
        "ElementSpacing": " ".join(_spelled(geometry.spacing)),
        "DimSize": " ".join(map(str, field.shape[2::-1])),
        "ElementNumberOfChannels": "3",
        "ElementType": _TYPES[field.dtype][1],
        "ElementDataFile": "LOCAL",
    }
    return "".join(f"{key} = {value}\n" for key, value in lines.items())


def _spelled(numbers: npt.ArrayLike) -> list[str]:
    return [repr(x) for x in np.asarray(numbers, np.float64).tolist()]


def _transform_of(field: Field, geometry: Geometry) -> Any:
    sitk = itk.imported()
    image = sitk.Image([int(n) for n in field.shape[2::-1]], sitk.sitkVectorFloat64, 3)
    for z, plane in enumerate(field):
        image[:, :, z] = sitk.GetImageFromArray(plane.astype(np.float64), isVector=True)
    image.SetSpacing(geometry.spacing)
    image.SetOrigin(geometry.origin)
    image.SetDirection(geometry.direction.ravel().tolist())
    return sitk.DisplacementFieldTransform(image)


def write_transform(path: PathLike, temporary: Path, transform: Any, size: int) -> None:
    """Write a transform of ITK's, whose parameters take about `size` bytes, into the temporary file of `path`."""
    sitk = itk.imported()
    with open(temporary, "wb") as file:  # HDF5 crashes on a full disk
        for _ in range(0, size + _OVERHEAD, _CHUNK):
            file.write(bytes(_CHUNK))
    try:
        sitk.WriteTransform(transform, str(temporary))
    except RuntimeError as error:
        raise unwritable(path, "ITK could not write the transform", "choose another place") from error
