"""Transforms and displacement fields of ITK, ANTs and 3D Slicer: vector images, and ITK's files of transforms."""

from __future__ import annotations

import contextlib
import mmap
import os
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, check_suffix, head_of, replacing, unreadable, unwritable
from supple.media.transforms import base
from supple.media.transforms.fields import NIFTI, VECTOR, VECTORS, check_header, write_nifti
from supple.media.volume import itk, nifti
from supple.media.volume.data import Volume, reading
from supple.space.checks import library_of, refuse
from supple.space.geometry import Geometry, Grid

SUFFIXES_OUT = (".nii", ".nii.gz", ".nrrd", ".mha", ".h5")
IMAGES = (*NIFTI, ".nrrd", ".nhdr", ".mha", ".mhd")
TRANSFORMS = (".h5", ".hdf5", ".tfm", ".txt", ".mat")
_MANY = (".h5", ".tfm")
_OUT = tuple(dict.fromkeys((*SUFFIXES_OUT, *TRANSFORMS)))
_NONE = "is of no transform of ITK"
_OVERHEAD = 1 << 16  # bytes: more than a transform's HDF5 file without the field
_CHUNK = 1 << 20
DISPLACEMENT = 1006
_KIND = re.compile(rb"Transform(?:Base)?_(?:double|float)_\d_\d")
_FLOWS = (b"VelocityFieldTransform_", b"ExponentialDiffeomorphicTransform_")


def read(path: PathLike, grids: base.Grids) -> tuple[base.Content, ...]:
    """Read a vector image or a file of transforms."""
    suffix = base.suffix_of(path, (*IMAGES, *TRANSFORMS))
    if suffix in IMAGES:
        return (_field(path, suffix in NIFTI),)
    check_suffix(path, suffix, TRANSFORMS, _NONE, f"use {', '.join((*IMAGES, *TRANSFORMS))}", "read")
    return _transforms(path, suffix)


def _field(path: PathLike, in_nifti: bool) -> base.Displacements:
    volume = (nifti if in_nifti else itk).read(path)
    if in_nifti:
        check_header(path, volume, "itk")
        code = int(volume.header["intent_code"])
        if code == DISPLACEMENT:
            what = "its intent code is 1006, whose vectors ITK takes as LPS before version 5.4, and as RAS from it on"
            raise unreadable(path, what, "write it anew with LPS vectors and the intent code 1007")
        if code != VECTOR or volume.series:
            base.check_count(path, len(volume.samples) if volume.series else volume.components)
            axes = 4 if volume.series else 5
            what = f"it has {axes} axes and the intent code {code}, and a field of ITK has 5 and the code 1007"
            raise unreadable(path, what, "give the convention that it has")
    # Vectors are taken as LPS for any space of a NRRD: ITK converts its geometry to LPS, but not its vectors.
    flat = not volume.series and volume.components == 2 and volume.sizes[2] == 1
    values, grid = base.vectors_of(path, volume, 2 if flat else 3)
    if flat:
        turned = np.array(grid.direction)
        if not np.allclose(np.abs(turned[2]), (0, 0, 1)):
            what = "its two axes do not lie in the plane of x and y"
            raise unreadable(path, what, "give a field of three components")
        values, grid = values[0], Grid(grid.shape[1:], grid.spacing[:2], grid.origin[:2], turned[:2, :2])
    base.check_finite(path, values)
    return base.Displacements(values, grid)


def _transforms(path: PathLike, suffix: str) -> tuple[base.Content, ...]:
    sitk = itk.imported()
    base.check_text(path, head_of(path, base.TEXT))
    with reading(path), open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        kinds = len(_KIND.findall(data))
        composed = data.find(b"CompositeTransform_") >= 0
        flows = any(data.find(name) >= 0 for name in _FLOWS)
    if suffix == ".mat":
        _check_matlab(path)
    if flows:
        what = "it holds a velocity field, which has to be integrated"
        raise unreadable(path, what, "give the displacement field that it leads to")
    if kinds > 1 and not composed:
        what = f"it holds a list of {kinds} transforms, of which ITK reads the first"
        raise unreadable(path, what, "give a file of one, or of a composite of them")
    with itk.failing(path, "ITK transform"):
        try:
            whole = sitk.ReadTransform(os.fspath(path))
        except KeyError as error:  # a kind that SimpleITK does not support
            raise unreadable(path, "SimpleITK does not know its kind of transform", "write it as affine") from error
    return tuple(_contents(path, whole))


def contents_of(transform: Any) -> tuple[base.Content, ...]:
    """Return the matrices and fields of a transform of SimpleITK; SuppleError if it holds anything else."""
    if library_of(transform) != "SimpleITK" or not hasattr(transform, "TransformPoint"):
        refuse("path", "the name of a file, or a transform of SimpleITK", transform)
    return tuple(_contents("the transform", _kind_of(transform)))


def transform_of(contents: Sequence[base.Content]) -> Any:
    """Return the transform of SimpleITK that applies matrices and fields in order."""
    made = [_made("the transform", content) for content in contents]
    return made[0] if len(made) == 1 else itk.imported().CompositeTransform(made[::-1])


def _kind_of(transform: Any) -> Any:
    with contextlib.suppress(KeyError):  # a kind that SimpleITK does not support
        transform = transform.Downcast()
    return transform


def _check_matlab(path: PathLike) -> None:
    """Raise SuppleError for truncated MATLAB 4 matrices, which ITK would fill up."""
    data, at = head_of(path, 1 << 16), 0
    while at + 20 <= len(data):
        kind, rows, columns, _, name = struct.unpack_from("<5i", data, at)
        if min(rows, columns, name) < 0:
            break
        at += 20 + name + rows * columns * (4 if kind // 10 % 10 == 1 else 8)
    if at != len(data):
        raise unreadable(path, "it is cut short, or no file of ITK's on little-endian machines")


def _contents(path: PathLike, transform: Any) -> list[base.Content]:
    sitk = itk.imported()
    # must come first: SimpleITK turns an unsupported transform into a composite that contains itself
    if transform.IsLinear():
        return [base.check_matrix(path, _matrix(transform))]
    if isinstance(transform, sitk.CompositeTransform):
        made: list[base.Content] = []
        for i in reversed(range(transform.GetNumberOfTransforms())):  # the last added is applied first
            made += _contents(path, _kind_of(transform.GetNthTransform(i)))
        return made
    interpolation: base.Interpolation
    if isinstance(transform, sitk.DisplacementFieldTransform):
        image, interpolation = transform.GetDisplacementField(), "linear"
        values = sitk.GetArrayFromImage(image)
    elif isinstance(transform, sitk.BSplineTransform):
        if transform.GetOrder() != 3:
            raise unreadable(path, f"its B-spline is of order {transform.GetOrder()}", "give one of order 3")
        images = transform.GetCoefficientImages()
        image, interpolation = images[0], "bspline"
        values = np.stack([sitk.GetArrayFromImage(each) for each in images], axis=-1)
    else:
        what = f"it is a {transform.GetName()}, which is neither affine nor a field"
        raise unreadable(path, what, "sample it as a field first")
    n = image.GetDimension()
    base.check_finite(path, values)
    try:
        direction = np.array(image.GetDirection()).reshape(n, n)
        grid = Grid(values.shape[:-1], image.GetSpacing(), image.GetOrigin(), direction)
    except SuppleError as error:
        raise SuppleError(f"cannot read {shown(path)}: {error}") from error
    return [base.Displacements(values, grid, interpolation)]


def _matrix(transform: Any) -> base.Matrix:
    n = transform.GetDimension()
    made, origin = np.eye(n + 1), (0.0,) * n
    made[:n, n] = transform.TransformPoint(origin)
    for axis, unit in enumerate(np.eye(n).tolist()):
        made[:n, axis] = np.array(transform.TransformVector(unit, origin))
    return made


def write(path: PathLike, contents: Sequence[base.Content], grids: base.Grids, *, force: bool = False) -> None:
    """Write a field as a vector image, an affine map as a transform, or several of them as a composite."""
    suffix = base.suffix_of(path, _OUT)
    for content in contents:
        base.check_content(path, content)
    only = contents[0] if len(contents) == 1 else None
    if isinstance(only, base.Displacements) and only.interpolation == "linear" and suffix in SUFFIXES_OUT:
        write_field(path, only.values, only.grid.geometry("LPS"), force=force)
        return
    check_suffix(path, suffix, _OUT, _NONE, f"use {', '.join(_OUT)}")
    many = f"use {', '.join(_MANY)}"
    if suffix not in TRANSFORMS:
        raise unwritable(path, f"a {suffix} file of ITK holds one field, interpolated linearly", many)
    if suffix not in _MANY and not isinstance(only, np.ndarray):
        raise unwritable(path, f"a {suffix} file of ITK holds one affine map", many)
    if not contents:
        raise unwritable(path, "there is nothing to write", "give a map")
    whole = transform_of(contents)
    fields = [content.values.size for content in contents if isinstance(content, base.Displacements)]
    with replacing(path, force=force) as temporary:
        _write_transform(path, temporary, whole, sum(fields) * (8 if suffix == ".h5" else 25))


def _made(path: PathLike, content: base.Content) -> Any:
    sitk = itk.imported()
    if not isinstance(content, base.Displacements):
        return sitk.AffineTransform(content[:-1, :-1].ravel().tolist(), content[:-1, -1].tolist())
    if content.interpolation == "cubic":
        what = "ITK has no transform of a cubic B-spline through values"
        raise unwritable(path, what, "give its coefficients, or sample it on the grid of the output")
    if content.interpolation == "linear":
        return _field_transform(content.values, content.grid)
    images = []
    for axis in range(content.grid.ndim):
        plane = np.ascontiguousarray(content.values[..., axis], np.float64)
        images.append(_placed(sitk.GetImageFromArray(plane), content.grid))
    return sitk.BSplineTransform(images, 3)


def _field_transform(values: npt.NDArray[Any], geometry: Geometry | Grid) -> Any:
    sitk = itk.imported()
    if values.ndim == 3:
        image = sitk.GetImageFromArray(values.astype(np.float64), isVector=True)
        return sitk.DisplacementFieldTransform(_placed(image, geometry))
    image = sitk.Image([int(n) for n in values.shape[2::-1]], sitk.sitkVectorFloat64, 3)
    for z, plane in enumerate(values):
        image[:, :, z] = sitk.GetImageFromArray(plane.astype(np.float64), isVector=True)
    return sitk.DisplacementFieldTransform(_placed(image, geometry))


def _placed(image: Any, geometry: Geometry | Grid) -> Any:
    image.SetSpacing(geometry.spacing)
    image.SetOrigin(geometry.origin)
    image.SetDirection(np.ravel(geometry.direction).tolist())
    return image


def _write_transform(path: PathLike, temporary: Path, transform: Any, size: int) -> None:
    """Write an ITK transform, whose parameters take about `size` bytes, to the temporary file for `path`."""
    with open(temporary, "wb") as file:  # reserve space first, as HDF5 crashes on a full disk
        for _ in range(0, size + _OVERHEAD, _CHUNK):
            file.write(bytes(_CHUNK))
    try:
        itk.imported().WriteTransform(transform, str(temporary))
    except RuntimeError as error:
        raise unwritable(path, "ITK could not write the transform", "choose another place") from error


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a name whose suffix is not in `SUFFIXES_OUT`."""
    if base.suffix_of(path, SUFFIXES_OUT) not in SUFFIXES_OUT:
        check_suffix(path, Path(path).suffix, (), "is of no transform", f"use {', '.join(SUFFIXES_OUT)}")


def write_field(
    path: PathLike, displacement: npt.NDArray[np.floating[Any]], geometry: Geometry, *, force: bool = False
) -> None:
    """Write a displacement field (Z, H, W, 3) for resampling a volume onto the field's grid by ITK, ANTs and 3D Slicer.

    Each voxel of the output holds the displacement to its source point in the input, in float32 or float64, in
    millimetres along the axes of LPS, x first, for any convention of ``geometry``. For NIfTI (intent 1007, as from
    ANTs), the array is read component by component. ``.nrrd`` and ``.mha`` are vector images, ``.h5``
    an ITK transform, in float64. SuppleError if the array has another shape or dtype, holds NaN or infinity, or is too
    large for the format; or if the file cannot be written.
    """
    check_target(path)
    name, suffix = shown(path), base.suffix_of(path, SUFFIXES_OUT)
    field = np.asarray(displacement)
    if field.ndim != 4 or field.shape[3] != 3 or 0 in field.shape or field.dtype not in (np.float32, np.float64):
        wanted = "an array of shape (Z, H, W, 3) in float32 or float64"
        raise SuppleError(f"cannot write {name}: a field is {wanted}, and not {field.dtype} of shape {field.shape}")
    if not all(np.isfinite(plane).all() for plane in field):
        raise SuppleError(f"cannot write {name}: a field must be finite, found NaN or infinity")
    if suffix == ".h5":
        with replacing(path, force=force) as temporary:
            _write_transform(path, temporary, _field_transform(field, geometry), 8 * field.size)
    elif suffix in NIFTI:
        write_nifti(path, field, geometry, VECTORS["itk"], force=force)
    else:
        itk.write(path, field, Volume(field, geometry), packed=False, force=force)
