"""Transforms and fields of ITK: SimpleITK maps the same points, whichever of both wrote the file."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.media.transforms import Displacements, read, write
from supple.space.geometry import Grid
from tests.media.transforms.mapping import GRIDS, Floats, field_on, mapped, points_in

GRID = GRIDS["oblique"]
POINTS = points_in(GRID)


def itk_image(values: Any, grid: Grid, *, vector: bool = True) -> Any:
    image = sitk.GetImageFromArray(np.ascontiguousarray(values), isVector=vector)
    image.SetSpacing(grid.spacing)
    image.SetOrigin(grid.origin)
    image.SetDirection(np.ravel(grid.direction).tolist())
    return image


def by_itk(transform: Any, points: Floats) -> Floats:
    return np.array([transform.TransformPoint(point) for point in points.tolist()])


def skewed() -> Any:
    made = sitk.ScaleSkewVersor3DTransform()
    made.SetSkew([0.1, 0.02, 0.03, 0.04, 0.05, 0.06])
    made.SetCenter((4, 5, 6))
    return made


LINEAR = {
    "affine": sitk.AffineTransform([1.1, 0.1, 0.05, -0.1, 0.9, 0.2, 0.03, 0.1, 1.2], [3, 4, 5], [10, -20, 30]),
    "Euler": sitk.Euler3DTransform((10, 20, 30), 0.1, -0.2, 0.3, (4, 5, 6)),
    "similarity": sitk.Similarity3DTransform(1.2, (0.1, 0.9, 0.2), 0.4, (3, 2, 1), (5, 6, 7)),
    "scale and turn": sitk.ScaleVersor3DTransform((1.1, 0.9, 1.2), (1, 0, 0), 0.3, (3, 2, 1), (5, 6, 7)),
    "skew": skewed(),
    "rigid": sitk.VersorRigid3DTransform((0, 1, 0), 0.2, (1, 2, 3), (7, 8, 9)),
    "versor": sitk.VersorTransform((0, 0, 1), 0.2, (1, 2, 3)),
    "scale": sitk.ScaleTransform(3, (1.1, 1.2, 0.9)),
    "translation": sitk.TranslationTransform(3, (1, 2, 3)),
}


def spline() -> Any:
    made = sitk.BSplineTransform(3, 3)
    made.SetTransformDomainOrigin(GRID.origin)
    made.SetTransformDomainPhysicalDimensions([a * (n - 1) for a, n in zip(GRID.spacing, GRID.sizes, strict=True)])
    made.SetTransformDomainDirection(np.ravel(GRID.direction).tolist())
    made.SetTransformDomainMeshSize((4, 5, 6))
    made.SetParameters(np.random.default_rng(1).normal(0, 2, len(made.GetParameters())).tolist())
    return made


def field() -> Any:
    return sitk.DisplacementFieldTransform(itk_image(field_on(GRID).values.astype(np.float64), GRID))


@pytest.mark.parametrize("suffix", [".tfm", ".txt", ".h5", ".mat"])
@pytest.mark.parametrize("name", LINEAR)
def test_linear_transforms_with_their_centre(name: str, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"a{suffix}"
    sitk.WriteTransform(LINEAR[name], str(file))
    (found,) = read(file)
    np.testing.assert_allclose(mapped([found], POINTS), by_itk(LINEAR[name], POINTS), atol=1e-9)
    write(tmp_path / f"b{suffix}", [found], "itk")
    again = sitk.ReadTransform(str(tmp_path / f"b{suffix}"))
    np.testing.assert_allclose(by_itk(again, POINTS), by_itk(LINEAR[name], POINTS), atol=1e-9)


@pytest.mark.parametrize("kind", ["MatrixOffsetTransformBase_double_3_3", "AffineTransform_float_3_3"])
def test_kinds_that_ants_writes(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    lines = ["#Insight Transform File V1.0", "#Transform 0", f"Transform: {kind}"]
    lines += ["Parameters: 0 1 0 -1 0 0 0 0 1 4 5 6", "FixedParameters: 1 2 3"]
    file.write_text("\n".join(lines) + "\n")
    (found,) = read(file)
    assert isinstance(found, np.ndarray)
    # A (x - c) + c + t
    np.testing.assert_allclose(found[:3], [[0, 1, 0, 3], [-1, 0, 0, 8], [0, 0, 1, 6]], atol=1e-12)


@pytest.mark.parametrize("suffix", [".tfm", ".h5"])
def test_a_composite_applies_first_what_was_added_last(suffix: str, tmp_path: Path) -> None:
    whole = sitk.CompositeTransform([LINEAR["affine"], field(), LINEAR["Euler"]])
    file = tmp_path / f"a{suffix}"
    sitk.WriteTransform(whole, str(file))
    found = read(file)
    assert [isinstance(content, Displacements) for content in found] == [False, True, False]
    np.testing.assert_allclose(mapped(found, POINTS), by_itk(whole, POINTS), atol=1e-9)
    write(tmp_path / f"b{suffix}", found)
    again = sitk.ReadTransform(str(tmp_path / f"b{suffix}"))
    np.testing.assert_allclose(by_itk(again, POINTS), by_itk(whole, POINTS), atol=1e-9)


@pytest.mark.parametrize("suffix", [".tfm", ".h5"])
def test_splines_are_their_coefficients(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"a{suffix}"
    sitk.WriteTransform(spline(), str(file))
    (found,) = read(file)
    assert isinstance(found, Displacements)
    assert found.interpolation == "bspline"
    assert found.grid.shape == (9, 8, 7)
    np.testing.assert_allclose(mapped([found], POINTS), by_itk(spline(), POINTS), atol=1e-9)
    write(tmp_path / f"b{suffix}", [found])
    again = sitk.ReadTransform(str(tmp_path / f"b{suffix}"))
    np.testing.assert_allclose(by_itk(again, POINTS), by_itk(spline(), POINTS), atol=1e-9)


def test_fields_end_half_a_voxel_beyond_their_last_samples(tmp_path: Path) -> None:
    sitk.WriteTransform(field(), str(tmp_path / "a.h5"))
    near = np.random.default_rng(0).uniform(-0.9, 1.9, (300, 3)) * (np.array(GRID.sizes) - 1)
    places = GRID.positions(near)
    np.testing.assert_allclose(mapped(read(tmp_path / "a.h5"), places), by_itk(field(), places), atol=1e-9)


FIELDS = list(itertools.product([".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr"], GRIDS))


@pytest.mark.parametrize(("suffix", "name"), FIELDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_vector_images(suffix: str, name: str, dtype: Any, tmp_path: Path) -> None:
    grid = GRIDS[name]
    values = field_on(grid, dtype=dtype).values
    file = tmp_path / f"a{suffix}"
    sitk.WriteImage(itk_image(values, grid), str(file))
    (found,) = read(file)
    assert isinstance(found, Displacements)
    np.testing.assert_array_equal(found.values, values)
    assert found.values.dtype == dtype
    points = points_in(grid)
    known = sitk.DisplacementFieldTransform(sitk.ReadImage(str(file), sitk.sitkVectorFloat64))
    np.testing.assert_allclose(mapped([found], points), by_itk(known, points), atol=1e-5)


@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior", "left-anterior-superior"])
def test_a_nrrd_of_any_space_has_its_vectors_as_itk_reads_them(space: str, tmp_path: Path) -> None:
    signs = np.array([1.0 if word in ("left", "posterior", "superior") else -1.0 for word in space.split("-")])
    values = field_on(GRID).values
    axes = (signs[:, np.newaxis] * GRID.matrix[:3, :3]).T.tolist()
    lines = ["NRRD0005", "type: float", "dimension: 4", f"space: {space}", "sizes: 3 9 8 7"]
    lines += [
        f"space directions: none {' '.join(spelled(axis) for axis in axes)}",
        "kinds: vector domain domain domain",
    ]
    lines += ["endian: little", "encoding: raw", f"space origin: {spelled((signs * GRID.origin).tolist())}", "", ""]
    file = tmp_path / "a.nrrd"
    file.write_bytes("\n".join(lines).encode() + values.astype("<f4").tobytes())
    known = sitk.DisplacementFieldTransform(sitk.ReadImage(str(file), sitk.sitkVectorFloat64))
    np.testing.assert_allclose(mapped(read(file), POINTS), by_itk(known, POINTS), atol=1e-9)
    np.testing.assert_allclose(mapped(read(file), POINTS), mapped([Displacements(values, GRID)], POINTS), atol=1e-9)


def spelled(numbers: list[float]) -> str:
    return f"({','.join(map(repr, numbers))})"
