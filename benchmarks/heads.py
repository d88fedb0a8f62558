"""Two heads, registered: real displacement fields for `fields.py`, made once and kept in a folder.

    python benchmarks/heads.py FIXED MOVING FOLDER    files as ANTs names and writes them, for docs/make_moving.py

Fields are made by SimpleITK's Demons, smoothed little, so that they fold in places, and much, so that they do not, and
by a B-spline registration.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813

import supple

Floats = npt.NDArray[np.floating[Any]]
Image = Any  # of SimpleITK, which is not typed

SHIPPED = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
SIDE = 256.0  # millimetres of each side of the grid


@dataclass(frozen=True)
class Pair:
    """Two heads on a grid of as many voxels along each side, the moving one placed by an affine map."""

    fixed: Image
    moving: Image
    about: str


def said(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cube(image: Image, side: int) -> Image:
    """Return an empty image of 256 mm along each axis of space, around the middle of another."""
    middle = image.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in image.GetSize()])
    step = SIDE / side
    grid = sitk.Image([side] * 3, sitk.sitkFloat32)
    grid.SetSpacing([step] * 3)
    grid.SetOrigin([m - step * (side - 1) / 2 for m in middle])
    return grid


def mirrored(image: Image) -> Image:
    """Return a head's mirror image: left is right."""
    flipped = sitk.GetImageFromArray(np.ascontiguousarray(sitk.GetArrayViewFromImage(image)[:, :, ::-1]))
    flipped.CopyInformation(image)
    return flipped


def placed(fixed: Image, moving: Image) -> Image:
    """Return the affine map from the fixed head to the moving one: seven degrees of freedom first, then twelve."""
    start: Any = sitk.CenteredTransformInitializer(
        fixed, moving, sitk.Similarity3DTransform(), sitk.CenteredTransformInitializerFilter.GEOMETRY
    )
    for kind in ("similarity", "affine"):
        if kind == "affine":
            affine = sitk.AffineTransform(3)
            affine.SetMatrix(start.GetMatrix())
            affine.SetTranslation(start.GetTranslation())
            affine.SetCenter(start.GetCenter())
            start = affine
        method = sitk.ImageRegistrationMethod()
        method.SetMetricAsMattesMutualInformation(48)
        method.SetMetricSamplingStrategy(method.REGULAR)
        method.SetMetricSamplingPercentage(0.1, 1)
        method.SetInterpolator(sitk.sitkLinear)
        method.SetOptimizerAsRegularStepGradientDescent(2.0, 1e-3, 200, 0.5, 1e-6)
        method.SetOptimizerScalesFromPhysicalShift()
        method.SetShrinkFactorsPerLevel([4, 2])
        method.SetSmoothingSigmasPerLevel([3, 1])
        method.SetInitialTransform(start, inPlace=True)
        method.Execute(fixed, moving)
        said(f"  {kind}: metric {method.GetMetricValue():.4f}, {method.GetOptimizerStopConditionDescription()}")
    return start


def pair(fixed: Path, moving: Path | None, side: int) -> Pair:
    """Return two heads; the fixed one and its mirror image, without a second."""
    one = sitk.ReadImage(str(fixed), sitk.sitkFloat32)
    two = mirrored(one) if moving is None else sitk.ReadImage(str(moving), sitk.sitkFloat32)
    grid = cube(one, side)
    affine = placed(one, two)
    ones = sitk.GetImageFromArray(np.ones(one.GetSize()[::-1], np.float32))
    ones.CopyInformation(one)
    seen = sitk.Resample(ones, grid, sitk.Transform(), sitk.sitkNearestNeighbor, 0.0)  # the fixed head's field of view
    a = sitk.Resample(one, grid, sitk.Transform(), sitk.sitkLinear, 0.0)
    b = sitk.Resample(two, grid, affine, sitk.sitkLinear, 0.0) * seen
    b = sitk.HistogramMatching(b, a, 256, 15, True)
    what = f"{fixed.name} and its mirror image" if moving is None else f"{fixed.name} and {moving.name}"
    return Pair(a, b, what)


def smaller(image: Image, factor: int) -> Image:
    if factor == 1:
        return image
    return sitk.Shrink(sitk.SmoothingRecursiveGaussian(image, factor / 2 * image.GetSpacing()[0]), [factor] * 3)


def demons(heads: Pair, sigma: float, rounds: Sequence[tuple[int, int]] = ((4, 80), (2, 60), (1, 25))) -> Image:
    """Return Demons' field, from coarse to fine; ``sigma`` smooths it each time, in voxels of the level."""
    field = None
    for factor, times in rounds:
        a, b = smaller(heads.fixed, factor), smaller(heads.moving, factor)
        if field is not None:
            field = sitk.Resample(field, a, sitk.Transform(), sitk.sitkLinear, 0.0, field.GetPixelID(), True)
        method = sitk.FastSymmetricForcesDemonsRegistrationFilter()
        method.SetNumberOfIterations(times)
        method.SetStandardDeviations(sigma)  # in voxels
        method.SetSmoothDisplacementField(True)
        method.SetSmoothUpdateField(False)
        field = method.Execute(a, b) if field is None else method.Execute(a, b, field)
        said(f"  demons, sigma {sigma:g}, 1/{factor}: {method.GetElapsedIterations()}, metric {method.GetMetric():.2f}")
    return sitk.Cast(field, sitk.sitkVectorFloat32)


def bspline(heads: Pair, cells: int = 5) -> Image:
    """Return the field of a B-spline of so many cells along each side."""
    start = sitk.BSplineTransformInitializer(smaller(heads.fixed, 2), [cells] * 3, 3)
    method = sitk.ImageRegistrationMethod()
    method.SetMetricAsMeanSquares()
    method.SetMetricSamplingStrategy(method.REGULAR)
    method.SetMetricSamplingPercentagePerLevel([0.08, 0.015], 1)
    method.SetInterpolator(sitk.sitkLinear)
    method.SetOptimizerAsLBFGS2(numberOfIterations=15)
    method.SetShrinkFactorsPerLevel([2, 1])
    method.SetSmoothingSigmasPerLevel([2, 1])
    method.SetInitialTransform(start, inPlace=True)
    method.Execute(smaller(heads.fixed, 2), smaller(heads.moving, 2))
    said(f"  B-spline: metric {method.GetMetricValue():.2f}, {method.GetOptimizerStopConditionDescription()}")
    grid = heads.fixed
    return sitk.TransformToDisplacementField(
        start, sitk.sitkVectorFloat32, grid.GetSize(), grid.GetOrigin(), grid.GetSpacing(), grid.GetDirection()
    )


KINDS: dict[str, Callable[[Pair], Image]] = {
    "demons": lambda heads: demons(heads, 1.0),
    "smooth": lambda heads: demons(heads, 3.0),
    "bspline": bspline,
}


def named(fixed: Path, moving: Path | None) -> str:
    """Return a folder's name for the fields of two heads."""
    names = [path.name.split(".")[0] for path in (fixed, moving) if path is not None]
    return "-".join([*names, *(["mirrored"] if moving is None else [])])


def made(folder: Path, fixed: Path, moving: Path | None, side: int, kinds: Sequence[str]) -> dict[str, Path]:
    """Return the files of the fields of some kinds, and make those that the folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {kind: folder / f"{kind}_{side}.nii" for kind in kinds}
    wanted = [kind for kind, path in names.items() if not path.exists()]
    if not wanted:
        return names
    start = time.perf_counter()
    heads = pair(fixed, moving, side)
    said(f"{heads.about}: placed in {time.perf_counter() - start:.0f} s")
    sitk.WriteImage(heads.fixed, str(folder / f"fixed_{side}.nii"))
    sitk.WriteImage(heads.moving, str(folder / f"moving_{side}.nii"))
    for kind in wanted:
        start = time.perf_counter()
        sitk.WriteImage(KINDS[kind](heads), str(names[kind]))
        said(f"{kind}: made in {time.perf_counter() - start:.0f} s")
    return names


def coarser(image: Image, step: float, top: float) -> Image:
    """Return an image on a grid of a step in millimetres, whose brightest values are ``top``."""
    sizes = [round(n * s / step) for n, s in zip(image.GetSize(), image.GetSpacing(), strict=True)]
    grid = sitk.Image(sizes, sitk.sitkFloat32)
    grid.SetSpacing([step] * 3)
    grid.SetOrigin(image.GetOrigin())
    grid.SetDirection(image.GetDirection())
    smooth = sitk.SmoothingRecursiveGaussian(image, 0.6)
    bright = float(np.percentile(sitk.GetArrayViewFromImage(smooth), 99.8))
    made = sitk.Resample(smooth * (top / bright), grid, sitk.Transform(), sitk.sitkLinear, 0.0)
    return sitk.Clamp(made, sitk.sitkFloat32, 0.0, 2 * top)


def as_ants(fixed: Path, moving: Path, folder: Path) -> None:
    """Register two heads by an affine map and a coarse B-spline, and write what ANTs would."""
    one, two = (sitk.ReadImage(str(path), sitk.sitkFloat32) for path in (fixed, moving))
    affine = placed(one, two)
    one, two = coarser(one, 1.5, 120.0), coarser(two, 1.4, 500.0)
    near = sitk.HistogramMatching(sitk.Resample(two, one, affine, sitk.sitkLinear, 0.0), one, 256, 15, True)
    field = bspline(Pair(one, near, f"{fixed.name} and {moving.name}"))
    folder.mkdir(parents=True, exist_ok=True)
    sitk.WriteImage(sitk.Cast(one, sitk.sitkInt16), str(folder / "fixed.nii.gz"))
    sitk.WriteImage(sitk.Cast(two, sitk.sitkInt16), str(folder / "moving.nii.gz"))
    sitk.WriteTransform(affine, str(folder / "0GenericAffine.mat"))
    sitk.WriteImage(field, str(folder / "1Warp.nii.gz"))


if __name__ == "__main__":
    as_ants(*map(Path, sys.argv[1:4]))
