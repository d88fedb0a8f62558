"""Images and transforms of SimpleITK and nibabel: in and out with their geometry, against these libraries."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

import supple
from supple import Affine, Deformation, Field, Grid, SuppleError
from tests.fields import drawn

SHAPE, SPACING, ORIGIN = (20, 24, 28), (0.9, 1.1, 2.5), (-30.0, 4.0, 7.0)
TURN = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
RNG = np.random.default_rng(0)
pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning")

Array = npt.NDArray[Any]


def itk(samples: Array, *, vectors: bool = False) -> Any:
    image = SimpleITK.GetImageFromArray(samples, isVector=vectors)
    n = image.GetDimension()
    axes = np.eye(n)
    axes[:3, :3] = TURN[: min(n, 3), : min(n, 3)] if n > 2 else np.eye(2)
    image.SetSpacing((*SPACING, 7.0)[:n])
    image.SetOrigin((*ORIGIN, 1.0)[:n])
    image.SetDirection(axes.ravel().tolist())
    image.SetMetaData("0010|0010", "A^Patient")
    return image


def affine() -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = TURN * SPACING, ORIGIN
    return np.diag([-1.0, -1.0, 1.0, 1.0]) @ made


def smooth(shape: tuple[int, ...] = SHAPE) -> Array:
    z, y, x = np.indices(shape)
    return np.asarray(500 * np.sin(x / 4) * np.cos(y / 5) + 30 * z)


def bent(image: Any) -> Deformation:
    grid = supple.grid_of(image)
    d = Deformation(grid)
    if grid.ndim == 2:
        return d.grab((14, 12), by=(3, 2), radius=6)
    return d.grab((14, 12, 10), by=(3, 2, 1), radius=9).twist((8, 8, 8), angle=30, radius=6)


def place(image: Any) -> tuple[Any, ...]:
    return image.GetSize(), image.GetSpacing(), image.GetOrigin(), image.GetDirection(), image.GetPixelIDValue()


@pytest.mark.parametrize("dtype", ["i2", "u1", "u4", "f4", "f8"])
def test_an_image_of_simpleitk_keeps_its_geometry_and_its_header(dtype: str, tmp_path: Path) -> None:
    image = itk((smooth() % 200).astype(dtype))
    d = bent(image)
    made = d.warp(image, clamp=True)
    assert place(made) == place(image)
    assert made.GetMetaData("0010|0010") == "A^Patient"
    SimpleITK.WriteImage(image, tmp_path / "in.nrrd")
    supple.warp_file(tmp_path / "in.nrrd", tmp_path / "out.nrrd", d.recipe)
    written = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(tmp_path / "out.nrrd"))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(made), written)  # as the command warps the file
    back = SimpleITK.GetArrayFromImage(d.warp(made, inverse=True, filter="linear"))
    assert np.abs(written.astype(float) - SimpleITK.GetArrayFromImage(image)).max() > 10
    expected = Deformation.warp(d, written, inverse=True, filter="linear")
    np.testing.assert_array_equal(back, expected)


def test_itk_samples_the_same_through_the_saved_field(tmp_path: Path) -> None:
    image = itk(smooth().astype(np.float32))
    d = bent(image)
    found = d.grid.positions(d.inverse_map(tolerance=1e-4)) - d.grid.positions(
        np.moveaxis(np.indices(SHAPE)[::-1], 0, -1)
    )
    transform = supple.to_sitk(Field(found, d.grid))
    theirs = SimpleITK.GetArrayFromImage(SimpleITK.Resample(image, image, transform, SimpleITK.sitkLinear))
    ours = SimpleITK.GetArrayFromImage(d.warp(image, filter="linear", tolerance=1e-4))
    np.testing.assert_allclose(ours[2:-2, 2:-2, 2:-2], theirs[2:-2, 2:-2, 2:-2], atol=0.05)


def test_pictures_vectors_and_series_of_simpleitk() -> None:
    colours = itk(RNG.integers(0, 255, (30, 40, 4), dtype=np.uint8), vectors=True)
    made = bent(colours).warp(colours)
    assert place(made) == place(colours)
    expected = bent(colours).warp(SimpleITK.GetArrayFromImage(colours), alpha=False)
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(made), expected)
    colours.SetSpacing((0.5, 0.5))
    straight = bent(colours).straighten(rotate=10)
    assert straight.warp(colours).GetSize() == straight.output.sizes
    vectors = itk(RNG.random((*SHAPE, 3), np.float32), vectors=True)
    assert place(bent(vectors).warp(vectors)) == place(vectors)
    times = itk(RNG.random((2, *SHAPE), np.float32))
    made = bent(times).warp(times)
    assert place(made) == place(times)
    one = bent(times).warp(times[:, :, :, 1])
    np.testing.assert_allclose(SimpleITK.GetArrayFromImage(made)[1], SimpleITK.GetArrayFromImage(one), atol=1e-6)


def test_another_grid_is_the_place_of_the_result() -> None:
    image = itk(smooth().astype(np.float32))
    d, reference = bent(image), itk(np.zeros((9, 11, 13), np.float32))
    grid = supple.grid_of(reference)
    made = d.warp(image, grid=grid, filter="linear")
    assert place(made) == place(reference)
    np.testing.assert_array_equal(
        SimpleITK.GetArrayFromImage(made),
        d.warp(SimpleITK.GetArrayFromImage(image), grid=grid, filter="linear"),
    )
    nifti = d.warp(nibabel.Nifti1Image(SimpleITK.GetArrayFromImage(image).T, affine()), grid=grid, filter="linear")
    np.testing.assert_array_equal(np.asarray(nifti.dataobj).T, SimpleITK.GetArrayFromImage(made))
    np.testing.assert_allclose(nifti.affine[:3, :3], (np.diag([-1, -1, 1]) @ TURN) * SPACING, atol=1e-9)


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image, nibabel.MGHImage])
def test_an_image_of_nibabel_keeps_its_affine_its_header_and_its_class(kind: Any) -> None:
    image = kind(smooth().astype(np.int16).T, affine())
    if kind is not nibabel.MGHImage:
        image.header["descrip"] = b"a head"
        image.header.set_sform(affine(), 3)
    same = itk(smooth().astype(np.int16))
    assert supple.grid_of(image).is_same_space(supple.grid_of(same))
    made = bent(image).warp(image)
    assert type(made) is kind
    np.testing.assert_array_equal(made.affine, image.affine)
    np.testing.assert_array_equal(np.asarray(made.dataobj).T, SimpleITK.GetArrayFromImage(bent(same).warp(same)))
    assert made.get_data_dtype() == image.get_data_dtype()
    if kind is not nibabel.MGHImage:
        assert made.header["descrip"].item() == b"a head"
        assert made.header["sform_code"] == 3


def test_values_of_nibabel_are_true_values(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(smooth().astype(np.int16).T, affine())
    image.header.set_slope_inter(0.5, -10)
    nibabel.save(image, tmp_path / "scaled.nii")
    held = nibabel.load(tmp_path / "scaled.nii")
    made = bent(held).warp(held, filter="linear")
    assert made.get_data_dtype() == np.float32
    true = held.get_fdata().T.astype(np.float32)
    np.testing.assert_array_equal(np.asarray(made.dataobj).T, bent(held).warp(true, filter="linear"))
    nibabel.save(made, tmp_path / "bent.nii")
    np.testing.assert_array_equal(nibabel.load(tmp_path / "bent.nii").get_fdata(), made.get_fdata())
    metres = nibabel.Nifti1Image(smooth().T, np.diag([1e-3, 1e-3, 1e-3, 1]) @ affine())
    metres.header.set_xyzt_units("meter")
    assert supple.grid_of(metres).is_same_space(supple.grid_of(image))
    np.testing.assert_allclose(bent(image).warp(metres, grid=supple.grid_of(image)).affine, metres.affine, atol=1e-9)


def test_series_vectors_and_colours_of_nibabel() -> None:
    series = nibabel.Nifti1Image(RNG.random((*SHAPE[::-1], 3), np.float32), affine())
    vectors = nibabel.Nifti1Image(np.asarray(series.dataobj)[:, :, :, None], affine())
    vectors.header.set_intent("vector")
    d = bent(series)
    one = d.warp(nibabel.Nifti1Image(np.asarray(series.dataobj)[..., 1], affine()))
    for image in (series, vectors):
        made = d.warp(image)
        assert made.shape == image.shape
        assert made.header.get_intent() == image.header.get_intent()
        np.testing.assert_allclose(np.asarray(made.dataobj)[..., 1].squeeze(), np.asarray(one.dataobj), atol=1e-6)
    rgb = np.dtype([("R", "u1"), ("G", "u1"), ("B", "u1")])
    colours = RNG.integers(0, 255, (*SHAPE[::-1], 3), dtype=np.uint8)
    made = d.warp(nibabel.Nifti1Image(colours.view(rgb)[..., 0], affine()))
    assert made.get_data_dtype() == rgb
    green = d.warp(nibabel.Nifti1Image(colours[..., 1], affine()))
    np.testing.assert_array_equal(np.asarray(made.dataobj)["G"], np.asarray(green.dataobj))


def test_a_sheared_image_is_warped_on_the_upright_grid_around_it(tmp_path: Path) -> None:
    leaning = affine()
    leaning[:3, 2] += 0.4 * leaning[:3, 1]
    image = nibabel.Nifti1Image(smooth().astype(np.float32).T, leaning)
    image.set_qform(None)
    grid = supple.grid_of(image)
    with pytest.raises(SuppleError, match=r"at right angles \(Grid.upright makes one\)"):
        Deformation(grid)
    d = Deformation(grid.upright()).grab((14, 14, 10), by=(3, 2, 1), radius=9)
    made = d.warp(image)
    np.testing.assert_array_equal(made.affine, image.affine)
    nibabel.save(image, tmp_path / "in.nii")
    at = [float(x) for x in grid.indices(d.grid.positions((14.0, 14.0, 10.0)))]
    by = [float(x) for x in np.subtract(grid.indices(d.grid.positions((17.0, 16.0, 11.0))), at)]
    recipe = supple.Recipe(strokes=(supple.Stroke.grab(at, by=by, radius=9),))
    supple.warp_file(tmp_path / "in.nii", tmp_path / "out.nii", recipe, clamp=False)
    np.testing.assert_allclose(nibabel.load(tmp_path / "out.nii").get_fdata(), made.get_fdata(), atol=0.05)


IMAGE = itk(smooth().astype(np.int16))
REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "spacing": (
        lambda: Deformation(SHAPE).grab((3, 3, 3), by=(1, 0, 0), radius=4).warp(IMAGE),
        r"the image is of shape .* at \(0.9, 1.1, 2.5\), and the deformation is for .* at \(1, 1, 1\): "
        r"make it on the image's grid, Deformation\(supple.grid_of\(image\)\)$",
    ),
    "shape": (lambda: bent(IMAGE).warp(IMAGE[:, :, :10]), "the image is of shape 10 x 24 x 28"),
    "place": (
        lambda: Deformation(SHAPE, spacing=SPACING).affine(np.eye(4)).warp(IMAGE),
        "the image lies elsewhere in space",
    ),
    "out": (lambda: bent(IMAGE).warp(IMAGE, out=np.zeros(SHAPE, np.int16)), "out must be left out for an image"),
    "complex": (lambda: bent(IMAGE).warp(SimpleITK.Cast(IMAGE, SimpleITK.sitkComplexFloat32)), "its voxels are compl"),
    "labels": (
        lambda: bent(IMAGE).warp(SimpleITK.Cast(IMAGE > 500, SimpleITK.sitkLabelUInt8)),
        r"found a label map: SimpleITK.LabelMapToLabel\(image\)",
    ),
    "no affine": (lambda: supple.grid_of(nibabel.Nifti1Image(smooth().T, None)), "must have an affine"),
    "a list": (lambda: bent(IMAGE).warp([IMAGE]), "source must be an array, found one of SimpleITK"),
    "a clip": (lambda: Deformation(SHAPE, time=True).warp(IMAGE), "the image is of shape"),
    "no transform": (lambda: supple.read_maps(IMAGE), "path must be the name of a file, or a transform of SimpleITK"),
    "velocities": (
        lambda: supple.read_maps(SimpleITK.BSplineTransform(3, 2)),
        "cannot read the transform: its B-spline is of order 2: give one of order 3$",
    ),
    "a cubic field": (
        lambda: supple.to_sitk(Field(np.zeros((4, 5, 6, 3)), Grid((4, 5, 6)), "cubic")),
        "ITK has no transform of a cubic B-spline through values",
    ),
    "no map": (lambda: supple.to_sitk(), "maps must be one or more of Field and Affine"),
    "two maps": (
        lambda: Field.read(SimpleITK.CompositeTransform([SimpleITK.AffineTransform(3)])),
        "the transform holds an affine map, and not one field",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_such_image_is_refused(name: str) -> None:
    call, text = REFUSED[name]
    with pytest.raises(SuppleError, match=text):
        call()


def transforms() -> dict[str, Any]:
    """Return transforms of all kinds, of which points of the grid stay about it."""
    made: dict[str, Any] = {}
    for n in (2, 3):
        sizes, axes = (14, 12, 10)[:n], TURN if n == 3 else np.array([[0.96, -0.28], [0.28, 0.96]])
        grid = Grid(sizes[::-1], (1.5, 2.0, 2.5)[:n], (3.0, -4.0, 5.0)[:n], axes)
        linear = drawn(RNG, grid, 0.2)
        spline = Field(linear.values, grid, "bspline")
        made[f"field {n}"] = supple.to_sitk(linear)
        made[f"spline {n}"] = supple.to_sitk(spline)
        affine = SimpleITK.AffineTransform((np.eye(n) + 0.1 * RNG.normal(size=(n, n))).ravel().tolist(), [1.0] * n)
        affine.SetCenter((2.0,) * n)
        turn = (
            SimpleITK.Euler3DTransform((1, 2, 3), 0.1, 0.2, 0.3) if n == 3 else SimpleITK.Euler2DTransform((1, 2), 0.3)
        )
        made[f"affine {n}"], made[f"euler {n}"] = affine, turn
        made[f"shift {n}"] = SimpleITK.TranslationTransform(n, (1.0, 2.0, 3.0)[:n])
        some = [made[f"{name} {n}"] for name in ("field", "affine", "spline", "euler")]
        made[f"composite {n}"] = SimpleITK.CompositeTransform(some)
        made[f"nested {n}"] = SimpleITK.CompositeTransform([made[f"composite {n}"], made[f"shift {n}"]])
    return made


TRANSFORMS = transforms()


@pytest.mark.parametrize("name", TRANSFORMS)
def test_points_go_through_the_maps_of_a_transform_as_through_it(name: str) -> None:
    transform = TRANSFORMS[name]
    n = transform.GetDimension()
    maps = supple.read_maps(transform)
    middle = Grid((12, 14) if n == 2 else (10, 12, 14), (1.5, 2.0, 2.5)[:n], (3.0, -4.0, 5.0)[:n])
    points = middle.positions(RNG.uniform(2, 7, (50, n)))
    seen, again = points, supple.to_sitk(*maps)
    for each in maps:
        seen = each(seen)
    expected = np.array([transform.TransformPoint(point) for point in points.tolist()])
    np.testing.assert_allclose(seen, expected, atol=1e-5)
    back = np.array([again.TransformPoint(point) for point in points.tolist()])
    np.testing.assert_allclose(back, expected, atol=1e-5)
    d = Deformation(middle)
    for each in reversed(maps):  # a point of the output goes through the first one first
        d = d.field(each) if isinstance(each, Field) else d.affine(each)
    np.testing.assert_allclose(middle.positions(d.inverse(middle.indices(points)).points), expected, atol=1e-5)


def test_a_registration_of_simpleitk_warps_as_simpleitk_does() -> None:
    image = itk(smooth().astype(np.float32))
    grid = supple.grid_of(image)
    moving = SimpleITK.Euler3DTransform(grid.positions([14, 12, 10]).tolist(), 0.05, -0.04, 0.06, (0.5, 0.3, -0.2))
    maps = supple.read_maps(moving)
    assert isinstance(maps[0], Affine)
    ours = Deformation(grid).affine(maps[0]).warp(image, filter="linear")
    theirs = SimpleITK.Resample(image, image, moving, SimpleITK.sitkLinear)
    ours, theirs = (SimpleITK.GetArrayFromImage(each)[3:-3, 4:-4, 4:-4] for each in (ours, theirs))
    np.testing.assert_allclose(ours, theirs, atol=0.5)


def test_what_a_call_says_is_at_the_line_of_the_caller() -> None:
    with warnings.catch_warnings(record=True, action="always") as caught:
        Deformation(supple.grid_of(IMAGE), border=None).grab((14, 12, 10), by=(9, 0, 0), radius=2).warp(
            IMAGE, tolerance=1e-6
        )
    assert {Path(each.filename).name for each in caught} <= {Path(__file__).name}
