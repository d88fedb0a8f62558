"""Registrations of pictures by ITK: fields and transforms of two axes, on pictures and on slices with a place."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import Field
from tests.cli.commands import Run, done

SHAPE = (60, 80)
TURN = (0.8, -0.6, 0.6, 0.8)
EXACT = ("--filter", "linear", "--no-clamp", "--quiet")
WITHIN = (slice(6, -6), slice(6, -6))


def slice_of(values: npt.NDArray[Any], *, plain: bool, vector: bool = False) -> sitk.Image:
    made = sitk.GetImageFromArray(values, isVector=vector)
    if not plain:
        made.SetSpacing((0.7, 0.9))
        made.SetOrigin((5, -4))
        made.SetDirection(TURN)
    return made


def field_image(*, plain: bool) -> sitk.Image:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    u = np.stack([2 * np.sin(y / 9), -1.5 * np.cos(x / 11)], axis=-1)
    return slice_of(u * np.sin(np.pi * x / 79)[..., None] * np.sin(np.pi * y / 59)[..., None], plain=plain, vector=True)


def picture(*, plain: bool) -> sitk.Image:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    return slice_of((100 + 80 * np.sin(x / 5) * np.cos(y / 7)).astype(np.float32), plain=plain)


def transforms(*, plain: bool) -> dict[str, sitk.Transform]:
    middle = picture(plain=plain).TransformContinuousIndexToPhysicalPoint((40.0, 30.0))
    turn = sitk.Euler2DTransform(middle, 0.05, (0.8, -0.6))
    affine = sitk.AffineTransform(2)
    affine.SetMatrix((1.03, 0.04, -0.02, 0.98))
    affine.SetCenter(middle)
    field = sitk.DisplacementFieldTransform(field_image(plain=plain))
    spline = sitk.BSplineTransformInitializer(picture(plain=plain), (5, 4), 3)
    rng = np.random.default_rng(2)
    spline.SetParameters(rng.normal(scale=1.5, size=len(spline.GetParameters())).tolist())
    return {
        "turn.tfm": turn,
        "affine.mat": affine,
        "affine.txt": affine,
        "field.h5": field,
        "spline.h5": spline,
        "both.h5": sitk.CompositeTransform([affine, field]),
    }


@pytest.mark.parametrize("name", list(transforms(plain=True)))
@pytest.mark.parametrize("suffix", ["nii.gz", "nrrd", "mha", "tif"])
def test_transforms(run: Run, name: str, suffix: str) -> None:
    """A slice in space is moved as ITK moves it, and a picture without one in pixels, from the centre of its first."""
    plain = suffix == "tif"
    moving, transform = picture(plain=plain), transforms(plain=plain)[name]
    sitk.WriteTransform(transform, name)
    sitk.WriteImage(moving, f"moving.{suffix}")
    wanted = sitk.GetArrayFromImage(sitk.Resample(moving, moving, transform, sitk.sitkLinear, 0.0))
    option = "--affine" if name.startswith(("turn", "affine")) else "--field"
    done(run("warp", f"moving.{suffix}", f"out.{suffix}", option, name, *EXACT))
    seen = sitk.GetArrayFromImage(sitk.ReadImage(f"out.{suffix}")).squeeze()
    moved = np.abs(sitk.GetArrayFromImage(moving) - wanted)[WITHIN].max()
    assert np.abs(seen - wanted)[WITHIN].max() < 0.05 < moved


@pytest.mark.parametrize("suffix", ["nii.gz", "nrrd", "mha"])
def test_fields_as_images(run: Run, suffix: str) -> None:
    held = field_image(plain=False)
    sitk.WriteImage(sitk.Cast(held, sitk.sitkVectorFloat32), f"field.{suffix}")
    found = Field.read(f"field.{suffix}", "itk")
    np.testing.assert_allclose(found.values, sitk.GetArrayFromImage(held), atol=1e-6)
    np.testing.assert_allclose(found.grid.matrix[:2, :2], np.reshape(TURN, (2, 2)) * (0.7, 0.9), atol=1e-6)
    moving = picture(plain=False)
    sitk.WriteImage(moving, f"moving.{suffix}")
    through = sitk.DisplacementFieldTransform(field_image(plain=False))
    wanted = sitk.GetArrayFromImage(sitk.Resample(moving, moving, through, sitk.sitkLinear, 0.0))
    assert run("warp", f"moving.{suffix}", f"out.{suffix}", "--field", f"field.{suffix}", *EXACT)[0] == 0
    seen = sitk.GetArrayFromImage(sitk.ReadImage(f"out.{suffix}")).squeeze()
    assert np.abs(seen - wanted)[WITHIN].max() < 0.05
    again = ("--field", f"field.{suffix}", "--inverse", "--reference", f"moving.{suffix}")
    assert run("warp", f"out.{suffix}", f"back.{suffix}", *again, *EXACT)[0] == 0
    back = sitk.GetArrayFromImage(sitk.ReadImage(f"back.{suffix}")).squeeze()
    assert np.abs(back - sitk.GetArrayFromImage(moving))[WITHIN].max() < 4  # two linear interpolations
