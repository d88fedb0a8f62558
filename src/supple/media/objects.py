"""Images of SimpleITK and nibabel in memory: their samples and grids, and copies of them with other samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from supple.errors import SuppleError
from supple.media.volume import itk, nifti
from supple.media.volume.data import MILLIMETRES, TO_RAS, Array, Volume, native, placed, rescaled_dtype
from supple.space.checks import library_of
from supple.space.geometry import Geometry, Grid

_NAME = "the image"


class Held(NamedTuple):
    """The samples of an image, (H, W[, C]) or (Z, H, W[, C]), with times as channels; and their grid.

    ``like(samples, grid)`` returns an image of the same library, class and header with other samples of that layout
    and any dtype, on another grid unless it is None.
    """

    samples: Array
    grid: Grid
    like: Callable[[Array, Grid | None], Any]


def held(image: Any) -> Held | None:
    """Return the samples and the grid of an image of SimpleITK or nibabel; None for other objects.

    SuppleError if its voxels are not real numbers, or it has no geometry.
    """
    if library_of(image) == "nibabel":
        return _of_nibabel(image)
    return _of_itk(image) if library_of(image) and hasattr(image, "GetSpacing") else None


def _of_itk(image: Any) -> Held:
    sitk = itk.imported()
    if "label" in image.GetPixelIDTypeAsString():  # accessing its voxels would crash the process
        raise SuppleError("an image of SimpleITK must have voxels, found a label map: SimpleITK.LabelMapToLabel(image)")
    itk.check_voxels(_NAME, image)
    ndim, several = image.GetDimension(), image.GetNumberOfComponentsPerPixel() > 1
    if ndim not in (2, 3, 4) or (ndim == 4 and several):
        kind = " of vectors" if several else ""
        raise SuppleError(f"an image of SimpleITK must have 2 or 3 axes, or time as a fourth, found {ndim}{kind}")
    samples, n = sitk.GetArrayViewFromImage(image), min(ndim, 3)
    if ndim == 4:
        samples = np.moveaxis(samples, 0, -1)
    axes = np.array(image.GetDirection()).reshape(ndim, ndim)
    grid = Grid(samples.shape[:n], image.GetSpacing()[:n], image.GetOrigin()[:n], axes[:n, :n])

    def like(made: Array, where: Grid | None) -> Any:
        ordered = native(np.moveaxis(made, -1, 0) if ndim == 4 else made)
        result, turned, place = sitk.GetImageFromArray(ordered, isVector=several), axes.copy(), where or grid
        turned[:n, :n] = place.direction
        result.SetSpacing((*place.spacing, *image.GetSpacing()[n:]))
        result.SetOrigin((*place.origin, *image.GetOrigin()[n:]))
        result.SetDirection(turned.ravel().tolist())
        header = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
        outline = Volume(made, Geometry(), header=header, regridded=where is not None)
        for key, text in itk.header_of(made, outline).items():
            result.SetMetaData(key, text)
        return result

    return Held(samples, grid, like)


def _of_nibabel(image: Any) -> Held:
    if getattr(image, "affine", None) is None:
        raise SuppleError("an image of nibabel must have an affine, which says where its voxels lie, found none")
    nifti.imported()
    data, kept = np.asanyarray(image.dataobj), np.dtype(image.get_data_dtype())
    scaled = hasattr(image.dataobj, "slope") and data.dtype != kept
    if scaled:  # by slope and intercept, in float64
        data = data.astype(rescaled_dtype(kept, (2.0, 0.0)))
    colours = data.dtype.names  # RGB
    if colours:
        data = data.view(np.uint8).reshape(*data.shape, len(colours))
    sizes, more = (*data.shape, 1, 1)[:3], data.shape[3:]
    samples = data.reshape(*sizes, -1).transpose(2, 1, 0, 3)
    samples = native(samples if more else samples[..., 0])
    unit = MILLIMETRES.get(image.header.get_xyzt_units()[0], 1.0) if hasattr(image.header, "get_xyzt_units") else 1.0
    to_mm = np.diag([unit, unit, unit, 1.0])
    grid = placed(_NAME, to_mm @ image.affine, "RAS").grid(samples.shape[:3])

    def like(made: Array, where: Grid | None) -> Any:
        turned = (made if more else made[..., None]).transpose(2, 1, 0, 3)
        whole = turned.reshape(data.shape if where is None else (*turned.shape[:3], *more))
        if colours:
            whole = np.ascontiguousarray(whole).view(image.get_data_dtype())[..., 0]
        header = image.header.copy()
        if scaled:
            header.set_data_dtype(whole.dtype)
        affine = image.affine if where is None else np.linalg.inv(to_mm) @ TO_RAS @ where.matrix
        return type(image)(whole, affine, header, extra=image.extra)

    return Held(samples, grid, like)
