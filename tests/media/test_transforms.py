"""Displacement fields: what ITK makes of them is what Supple shows."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import Deformation, Recipe, Stroke
from supple.files import warp_file
from supple.files.transforms import displacement_of, write_transform
from supple.media.transforms import SUFFIXES_OUT, check_target, write_field
from supple.space.geometry import Geometry
from tests.media.transforms.mapping import rotation
from tests.refusals import refused

Array = npt.NDArray[Any]

SHAPE = (20, 30, 26)
SPACING = (0.9, 1.1, 1.7)


GEOMETRIES = {
    "plain": Geometry(SPACING),
    "oblique": Geometry(SPACING, (-71.25, 33.5, 812.125), rotation(0.4, -0.3, 1.1), "LPS"),
    "flipped": Geometry(SPACING, (12.0, -40.0, 7.0), rotation(0.2, 0.1, -0.3) * (1, -1, 1), "RAS"),
}


def bent(border: float | None = 5.0) -> Deformation:
    made = Deformation(SHAPE, spacing=SPACING, border=border)
    return made.grab((12, 14, 9), to=(16, 17, 11), radius=8).grab((9, 20, 12), by=(-2, 1, -2), radius=6)


def smooth(seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(SHAPE)
    waves = [np.sin(rng.uniform(0.1, 0.5) * x + rng.uniform(0.1, 0.5) * y + rng.uniform(0.1, 0.5) * z) for _ in "abc"]
    return np.asarray(np.sum(waves, axis=0) * 100, np.float32)


def image_of(array: Array, geometry: Geometry) -> sitk.Image:
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(geometry.spacing)
    image.SetOrigin(geometry.origin)
    image.SetDirection(geometry.direction.ravel().tolist())
    return image


def transform_from(path: Path) -> Any:
    if path.suffix == ".h5":
        return sitk.ReadTransform(str(path))
    return sitk.DisplacementFieldTransform(sitk.ReadImage(str(path), sitk.sitkVectorFloat64))


@pytest.mark.parametrize("suffix", SUFFIXES_OUT)
@pytest.mark.parametrize("where", GEOMETRIES)
def test_itk_resamples_to_what_supple_shows(tmp_path: Path, where: str, suffix: str) -> None:
    geometry, deformation, volume = GEOMETRIES[where], bent(), smooth()
    path = tmp_path / f"field{suffix}"
    write_transform(path, deformation, geometry, tolerance=1e-4)
    moving = image_of(volume, geometry)
    theirs = sitk.GetArrayFromImage(sitk.Resample(moving, moving, transform_from(path), sitk.sitkLinear, -1e6))
    ours = deformation.warp(volume, filter="linear", tolerance=1e-4)
    sources = deformation.inverse_map(tolerance=1e-4)
    last = np.array(SHAPE[::-1]) - 1
    inside = ((sources > 1e-3) & (sources < last - 1e-3)).all(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(theirs[inside], ours[inside], atol=1e-3 * np.ptp(volume))
    assert np.abs(ours - volume)[inside].max() > 0.1 * np.ptp(volume)  # or a field of zeros would pass


@pytest.mark.parametrize(("sform", "qform"), [(1, 1), (2, 1), (0, 1), (2, 0), (0, 0)])
def test_itk_applies_the_field_of_a_nifti_to_the_volume_as_it_reads_it(tmp_path: Path, sform: int, qform: int) -> None:
    """Though its qform and its sform are turned against each other, or neither has a code."""
    made = nibabel.Nifti1Image(smooth().T, None)
    for code, angle, form in ((qform, 0.3, made.header.set_qform), (sform, -0.4, made.header.set_sform)):
        affine = np.diag([0.0, 0, 0, 1])
        affine[:3, :3] = rotation(0.1, angle, 0.2) * SPACING
        affine[:3, 3] = 30 * angle, -20, 10
        form(affine, code)
    made.to_filename(tmp_path / "in.nii")
    grab = [Stroke.grab((12, 14, 9), to=(16, 17, 11), radius=8)]
    with warnings.catch_warnings(record=True, action="always") as told:
        warp_file(
            tmp_path / "in.nii", tmp_path / "out.nii", Recipe(strokes=grab), filter="linear",
            save_field=tmp_path / "field.nii", tolerance=1e-4,
        )  # fmt: skip
    assert [one.category.__name__ for one in told] == ["VolumeWarning"] * (sform > 0 < qform)
    moving = sitk.ReadImage(str(tmp_path / "in.nii"))
    transform = transform_from(tmp_path / "field.nii")
    theirs = sitk.GetArrayFromImage(sitk.Resample(moving, moving, transform, sitk.sitkLinear, -1e6))
    ours = np.asarray(nibabel.load(tmp_path / "out.nii").dataobj).T
    inside = (slice(2, -2),) * 3
    np.testing.assert_allclose(theirs[inside], ours[inside], atol=0.5)
    assert np.abs(ours - smooth())[inside].max() > 50


@pytest.mark.parametrize("suffix", SUFFIXES_OUT)
@pytest.mark.parametrize("shape", [(1, 4, 3), (3, 1, 2), (2, 3, 1), (1, 1, 1)])
def test_thin_fields(tmp_path: Path, suffix: str, shape: tuple[int, ...]) -> None:
    field = np.random.default_rng(3).normal(size=(*shape, 3))
    path = tmp_path / f"field{suffix}"
    write_field(path, field, Geometry())
    if shape[0] == 1 and suffix.startswith(".nii"):  # of which SimpleITK makes a picture
        loaded: Any = nibabel.load(path)
        found = loaded.get_fdata()[:, :, :, 0].transpose(2, 1, 0, 3)
    else:
        found = sitk.GetArrayFromImage(transform_from(path).GetDisplacementField())
    np.testing.assert_array_equal(found, field)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".NII.GZ"])
def test_nifti_says_that_it_holds_vectors(tmp_path: Path, suffix: str) -> None:
    path, geometry = tmp_path / f"field{suffix}", GEOMETRIES["flipped"]
    write_field(path, np.zeros((4, 5, 6, 3), np.float32), geometry)
    found: Any = nibabel.load(path)
    assert found.shape == (6, 5, 4, 1, 3)
    assert int(found.header["intent_code"]) == 1007
    assert found.header.get_xyzt_units()[0] == "mm"
    for affine, code in (found.get_sform(coded=True), found.get_qform(coded=True)):
        assert code == 1
        np.testing.assert_allclose(affine[:3] @ (5, 0, 3, 1), geometry.to_world((5, 0, 3), "RAS"), atol=1e-4)


def test_the_field_is_the_inverse_in_millimetres() -> None:
    deformation, geometry = bent(border=None), GEOMETRIES["oblique"]
    field = displacement_of(deformation, geometry, tolerance=1e-6)
    assert (field.shape, field.dtype) == ((*SHAPE, 3), np.float32)
    q = np.random.default_rng(2).integers(0, np.array(SHAPE[::-1]), (200, 3))
    expected = geometry.to_lps(deformation.inverse(q).points) - geometry.to_lps(q)
    np.testing.assert_allclose(field[q[:, 2], q[:, 1], q[:, 0]], expected, atol=1e-5)


def test_small_displacements_keep_their_digits_far_from_the_first_voxel() -> None:
    deformation = Deformation((1, 2, 4000), border=None).grab((3900, 0, 0), by=(1e-3, 0, 0), radius=50)
    field = displacement_of(deformation, Geometry(), tolerance=1e-9)
    expected = deformation.inverse((3990, 1, 0)).points - (3990, 1, 0)
    np.testing.assert_allclose(field[0, 1, 3990], expected, atol=2e-6)  # in float32, 3990 is off by up to 1e-4


FIELD = np.zeros((2, 3, 4, 3), np.float32)
ARRAY = "a field is an array of shape (Z, H, W, 3) in float32 or float64, and not"


@pytest.mark.parametrize(
    ("name", "field", "message"),
    [
        ("a.tfm", FIELD, "the suffix .tfm is of no transform: use .nii, .nii.gz, .nrrd, .mha, .h5"),
        ("a", FIELD, "a name without suffix is of no transform: use .nii, .nii.gz, .nrrd, .mha, .h5"),
        ("a.mha", FIELD[..., :2], f"{ARRAY} float32 of shape (2, 3, 4, 2)"),
        ("a.mha", FIELD.astype(int), f"{ARRAY} int64 of shape (2, 3, 4, 3)"),
        ("a.h5", FIELD[:0], f"{ARRAY} float32 of shape (0, 3, 4, 3)"),
        ("a.nrrd", FIELD * np.nan, "a field must be finite, found NaN or infinity"),
        (
            "a.nii",
            np.zeros((1, 1, 32_768, 3), np.float32),
            "NIfTI ends at 32767 voxels on a side, and the field has 32768 x 1 x 1: write .nrrd or .mha",
        ),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, name: str, field: Array, message: str) -> None:
    path = tmp_path / name
    assert refused(write_field, path, field, Geometry()) == f"cannot write {path}: {message}"
    assert os.listdir(tmp_path) == []


def test_names_are_checked_before_the_work(tmp_path: Path) -> None:
    check_target("a.b.NII.gz")
    refused(write_transform, tmp_path / "a.txt", bent(), Geometry())
    flat = Deformation((8, 8))
    message = refused(write_transform, tmp_path / "a.mha", flat, Geometry())
    assert message == "a displacement field is of a volume, and shape (8, 8) has two axes"
    refused(displacement_of, bent(), Geometry(), tolerance=0)
    assert os.listdir(tmp_path) == []
    (tmp_path / "a.mha").write_bytes(b"old")
    message = refused(write_transform, tmp_path / "a.mha", bent(), Geometry())
    assert message.endswith("a.mha exists already: choose another name, or force=True")
    assert (tmp_path / "a.mha").read_bytes() == b"old"
    write_transform(tmp_path / "a.mha", bent(), Geometry(SPACING), force=True)
    assert transform_from(tmp_path / "a.mha").GetDisplacementField().GetSize() == SHAPE[::-1]
