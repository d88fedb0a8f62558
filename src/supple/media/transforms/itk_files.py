"""Transforms and displacement fields of ITK, ANTs and 3D Slicer: vector images, and ITK's files of transforms."""

from __future__ import annotations

import mmap
import os
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, check_suffix, head_of, replacing, unreadable, unwritable
from supple.media.transforms.base import (
    TEXT,
    VECTOR,
    Content,
    Displacements,
    Grids,
    Matrix,
    check_count,
    check_finite,
    check_text,
    check_volume,
    checked,
    checked_header,
    intent_of,
    suffix_of,
    vectors_of,
)
from supple.media.transforms.itk import SUFFIXES_OUT, write_field, write_transform
from supple.media.volume import itk, nifti
from supple.media.volume.data import reading
from supple.space.geometry import Grid

IMAGES = {".nii": "", ".nii.gz": "", ".nrrd": "NRRD", ".nhdr": "NRRD", ".mha": "MetaImage", ".mhd": "MetaImage"}
TRANSFORMS = (".h5", ".hdf5", ".tfm", ".txt", ".mat")
_DISPLACEMENT = 1006
_KIND = re.compile(rb"Transform(?:Base)?_(?:double|float)_\d_\d")
_FLOWS = (b"VelocityFieldTransform_", b"ExponentialDiffeomorphicTransform_")
_SIZES = {0: 8, 1: 4}  # bytes of a number in a file of MATLAB
_MANY = (".h5", ".tfm")
_OUT = tuple(dict.fromkeys((*SUFFIXES_OUT, *TRANSFORMS)))
_NONE = "is of no transform of ITK"


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read a vector image or a file of transforms."""
    suffix = suffix_of(path, (*IMAGES, *TRANSFORMS))
    if suffix in IMAGES:
        return (_field(path, IMAGES[suffix]),)
    check_suffix(path, suffix, TRANSFORMS, _NONE, f"use {', '.join((*IMAGES, *TRANSFORMS))}", "read")
    return _transforms(path)


def _field(path: PathLike, form: str) -> Displacements:
    volume = itk.read(path, form) if form else checked_header(path, nifti.read(path), "itk")
    if not form:
        code = intent_of(volume)
        if code == _DISPLACEMENT:
            what = "its intent code is 1006, whose vectors ITK takes as LPS before version 5.4, and as RAS from it on"
            raise unreadable(path, what, "write it anew with LPS vectors and the intent code 1007")
        if code != VECTOR or volume.series:
            check_count(path, len(volume.samples) if volume.series else volume.components)
            axes = 4 if volume.series else 5
            what = f"it has {axes} axes and the intent code {code}, and a field of ITK has 5 and the code 1007"
            raise unreadable(path, what, "give the convention that it has")
    # The vectors stay as they are for any space of a NRRD: ITK turns its place to LPS, and never its vectors.
    flat = not volume.series and volume.components == 2 and volume.sizes[2] == 1
    values, grid = vectors_of(path, volume, 2 if flat else 3)
    if flat:
        turned = np.array(grid.direction)
        if not np.allclose(np.abs(turned[2]), (0, 0, 1)):
            raise unreadable(
                path, "its two axes do not lie in the plane of x and y", "give a field of three components"
            )
        values, grid = values[0], Grid(grid.shape[1:], grid.spacing[:2], grid.origin[:2], turned[:2, :2])
    check_finite(path, values, "give a field that is finite everywhere")
    return Displacements(values, grid)


def _transforms(path: PathLike) -> tuple[Content, ...]:
    sitk = itk.imported()
    check_text(path, head_of(path, TEXT))
    with reading(path), open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        kinds = len(_KIND.findall(data))
        composed = data.find(b"CompositeTransform_") >= 0
        flows = any(data.find(name) >= 0 for name in _FLOWS)
    if suffix_of(path, TRANSFORMS) == ".mat":
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
        except KeyError as error:  # a kind that SimpleITK's table of kinds lacks
            raise unreadable(path, "SimpleITK does not know its kind of transform", "write it as affine") from error
    if whole.GetDimension() not in (2, 3):
        what = f"it is a transform of {whole.GetDimension()} dimensions"
        raise unreadable(path, what, "give one of pictures or volumes")
    return tuple(_contents(path, sitk, whole))


# Kept: ITK fills what is missing (test_a_file_that_is_cut_short).
def _check_matlab(path: PathLike) -> None:
    """Raise SuppleError for a file of MATLAB's fourth version that is cut short."""
    data = head_of(path, 1 << 16)
    at = 0
    while at < len(data):
        order = "<" if len(data) >= at + 4 and int.from_bytes(data[at : at + 4], "little") < 5000 else ">"
        try:
            kind, rows, columns, _, name = struct.unpack_from(f"{order}5i", data, at)
        except struct.error:
            at = len(data) + 1
            break
        at += 20 + name + rows * columns * _SIZES.get(kind // 10 % 10, 8)
    if at > len(data):
        raise unreadable(path, f"it has {len(data)} bytes, and its header promises more")


def _contents(path: PathLike, sitk: Any, transform: Any) -> list[Content]:
    # first: of a transform whose kind SimpleITK lacks, it makes a composite that holds itself
    if transform.IsLinear():
        return [checked(path, _matrix(transform))]
    if isinstance(transform, sitk.CompositeTransform):
        count = transform.GetNumberOfTransforms()
        # a composite applies first what was added last
        parts = [_known(transform.GetNthTransform(i)) for i in reversed(range(count))]
        return [content for part in parts for content in _contents(path, sitk, part)]
    if isinstance(transform, sitk.DisplacementFieldTransform):
        image = transform.GetDisplacementField()
        values = sitk.GetArrayFromImage(image)
        return [_sampled(path, values, image, "linear")]
    if isinstance(transform, sitk.BSplineTransform):
        if transform.GetOrder() != 3:
            raise unreadable(path, f"its B-spline is of order {transform.GetOrder()}", "give one of order 3")
        images = transform.GetCoefficientImages()
        values = np.stack([sitk.GetArrayFromImage(image) for image in images], axis=-1)
        return [_sampled(path, values, images[0], "bspline")]
    what = f"it is a {transform.GetName()}, which is neither affine nor a field"
    raise unreadable(path, what, "sample it as a field first")


def _known(transform: Any) -> Any:
    """Return a transform as what it is, or as it stands if SimpleITK's table of kinds lacks it."""
    try:
        return transform.Downcast()
    except KeyError:
        return transform


def _sampled(path: PathLike, values: Any, image: Any, interpolation: Any) -> Displacements:
    n = image.GetDimension()
    direction = np.array(image.GetDirection()).reshape(n, n)
    check_finite(path, values, "give a field that is finite everywhere")
    try:
        grid = Grid(values.shape[:-1], image.GetSpacing(), image.GetOrigin(), direction)
    except SuppleError as error:
        raise SuppleError(f"cannot read {shown(path)}: {error}") from error
    return Displacements(values, grid, interpolation)


def _matrix(transform: Any) -> Matrix:
    """Return the matrix of a linear transform of any parameters and centre."""
    n = transform.GetDimension()
    made, origin = np.eye(n + 1), (0.0,) * n
    made[:n, n] = transform.TransformPoint(origin)
    for axis, unit in enumerate(np.eye(n).tolist()):
        made[:n, axis] = np.array(transform.TransformVector(unit, origin))
    return made


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a field as a vector image, an affine map as a transform, or several of them as a composite."""
    suffix = suffix_of(path, (*SUFFIXES_OUT, *TRANSFORMS))
    for content in contents:
        check_volume(path, content)
    only = contents[0] if len(contents) == 1 else None
    linear = isinstance(only, Displacements) and only.interpolation == "linear"
    if isinstance(only, Displacements) and linear and suffix in SUFFIXES_OUT:
        write_field(path, only.values, only.grid.geometry("LPS"), force=force)
        return
    check_suffix(path, suffix, _OUT, _NONE, f"use {', '.join(_OUT)}")
    if suffix not in TRANSFORMS:
        known = ", ".join(_MANY)
        raise unwritable(path, f"a {suffix} file of ITK holds one field, interpolated linearly", f"use {known}")
    if suffix not in _MANY and not isinstance(only, np.ndarray):
        raise unwritable(path, f"a {suffix} file of ITK holds one affine map", f"use {', '.join(_MANY)}")
    if not contents:
        raise unwritable(path, "there is nothing to write", "give a map")
    sitk = itk.imported()
    made = [_made(path, sitk, content) for content in contents]
    whole = made[0] if len(made) == 1 else sitk.CompositeTransform(made[::-1])
    fields = [content.values.size for content in contents if isinstance(content, Displacements)]
    with replacing(path, force=force) as temporary:
        write_transform(path, temporary, whole, sum(fields) * (8 if suffix == ".h5" else 25))


def _made(path: PathLike, sitk: Any, content: Content) -> Any:
    if not isinstance(content, Displacements):
        return sitk.AffineTransform(content[:3, :3].ravel().tolist(), content[:3, 3].tolist())
    if content.interpolation == "cubic":
        what = "ITK has no transform of a cubic B-spline through values"
        raise unwritable(path, what, "give its coefficients, or sample it on the grid of the output")
    grid, values = content.grid, content.values.astype(np.float64)

    def placed(image: Any) -> Any:
        image.SetSpacing(grid.spacing)
        image.SetOrigin(grid.origin)
        image.SetDirection(np.ravel(grid.direction).tolist())
        return image

    if content.interpolation == "linear":
        return sitk.DisplacementFieldTransform(placed(sitk.GetImageFromArray(values, isVector=True)))
    images = [placed(sitk.GetImageFromArray(np.ascontiguousarray(values[..., axis]))) for axis in range(3)]
    return sitk.BSplineTransform(images, 3)
