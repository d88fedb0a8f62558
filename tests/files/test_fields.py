"""Files of fields: inverted, checked, composed and converted; against points that SciPy moves, and ITK."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import Affine, Field, FoldWarning, Grid, OutsideWarning, SuppleError
from supple.files import fields as verbs
from supple.files.fields import Input, check_file, compose_files, convert_file, invert_file
from supple.files.maps import read_file
from supple.media import transforms, volume
from supple.media.transforms import CONVENTIONS, PULL, PUSH
from supple.space.geometry import Geometry
from tests.sampled_fields import GRID, moved, positions, sine, smooth

Array = npt.NDArray[Any]

OTHER = Grid((9, 12, 10), (1.4, 1.2, 1.9), (-19.0, 12.0, 41.0), GRID.direction)
MATRIX = np.array([[1.03, 0.05, 0, 0.4], [-0.04, 0.98, 0.03, -0.3], [0, 0.02, 1.01, 0.2], [0, 0, 0, 1]])


def content(field: Field) -> transforms.Displacements:
    return transforms.Displacements(field.values, field.grid, field.interpolation, field.beyond)


def put(path: Path, *maps: Field | Affine, convention: str = "itk", **grids: Grid) -> Path:
    held = [content(each) if isinstance(each, Field) else each.matrix for each in maps]
    transforms.write(path, held, convention, **grids)
    return path


def image(path: Path, grid: Grid) -> Path:
    """An image on a grid."""
    x, y, z = grid.spacing
    a, b, c = grid.origin
    values = np.zeros(grid.shape, np.float32)
    volume.write(path, values, volume.Volume(values, Geometry((x, y, z), (a, b, c), np.array(grid.direction), "LPS")))
    return path


def read(path: Path, convention: str = "itk", **grids: Grid) -> Field:
    (found,) = read_file(path, convention, **grids).maps
    assert isinstance(found, Field)
    return found


def inside(grid: Grid, points: Array, margin: float = 0.0) -> Array:
    """Return whether points are between the outermost samples, and so far from them."""
    index = grid.indices(points)
    return np.asarray(((index >= margin) & (index <= np.array(grid.sizes) - 1 - margin)).all(axis=-1))


@pytest.fixture(autouse=True)
def _quiet() -> Any:
    """The edges of these small fields move: of what is outside there is a warning, which tests of it expect."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        warnings.simplefilter("ignore", OutsideWarning)
        yield


# ---- invert


@pytest.mark.parametrize("name", ["v.nii.gz", "v.mha", "v.nrrd"])
@pytest.mark.parametrize("where", [None, OTHER], ids=["its own grid", "another"])
def test_an_inverse_leads_back(tmp_path: Path, name: str, where: Grid | None) -> None:
    field = smooth(size=0.7, dtype=np.float32)
    put(tmp_path / "u.nii.gz", field)
    reference = None if where is None else image(tmp_path / "r.nii.gz", where)
    made = invert_file(
        tmp_path / "u.nii.gz",
        tmp_path / name,
        reference=reference,
        tolerance=1e-4,
        error=tmp_path / "e.nii.gz",
        status=tmp_path / "s.mha",
        report=tmp_path / "r.json",
    )
    inverse = read(tmp_path / name)
    assert inverse.grid.is_same_space(where or GRID)
    assert inverse.values.dtype == np.float32
    error, status = (volume.read(tmp_path / each) for each in ("e.nii.gz", "s.mha"))
    assert (error.samples.dtype, status.samples.dtype) == (np.float32, np.uint8)
    for each in (error, status):
        assert each.geometry.grid(each.samples.shape).is_same_space(inverse.grid)
    ok = status.samples == 0
    assert 0.5 < ok.mean() < 1
    points = positions(inverse.grid)
    there = points + inverse.values
    off = np.linalg.norm(moved(field, there) - points, axis=-1)
    assert off[ok].max() < 2e-4 * max(field.grid.spacing) + 1e-5
    assert (off[ok] <= 2 * error.samples[ok] + 1e-4).all()
    assert made.counts is not None
    assert dict(made.counts) == {
        key: int((status.samples == k).sum()) for k, key in enumerate(("ok", "folded", "outside", "unconverged"))
    }
    assert made.error == pytest.approx(float(error.samples[ok].max()))
    facts = json.loads((tmp_path / "r.json").read_text())
    assert facts["counts"] == made.counts
    assert facts["error"] == made.error
    assert facts["read"][0]["known"] == "from its intent code"
    assert facts["written"]["convention"] == "itk"
    assert facts["written"]["maps"][0]["size"] == list(inverse.grid.sizes)
    assert (made.sources[0].direction, made.target.direction) == (PULL, PULL)


def test_a_fold_is_told_and_not_smoothed(tmp_path: Path) -> None:
    field = sine(2.0, (4, 5, 126))
    put(tmp_path / "u.mha", field)
    with pytest.warns(
        FoldWarning, match=r"u.mha: of 2,520 voxels of the inverse, .*: they hold the nearest that was fou"
    ) as told:
        made = invert_file(tmp_path / "u.mha", tmp_path / "v.mha", status=tmp_path / "s.nii")
    assert len(told) == 1
    assert "nothing was smoothed or set to zero" in str(told[0].message)
    assert made.counts is not None
    status = volume.read(tmp_path / "s.nii").samples
    # Several x of x - 2 sin x = y: between the values at the turning points, arccos(1/2) to either side of 2 pi k
    turning = np.arccos(1 / 2)
    fold = 2 * np.sin(turning) - turning
    y = np.arange(126) * 0.1
    several = np.abs(y - 2 * np.pi) < fold - 0.1  # of the other folds, a part is beyond the field
    single = (np.abs(y[:, None] - 2 * np.pi * np.arange(3)) > fold + 0.1).all(axis=-1) & (y < 12.4)
    assert several.sum() > 10
    assert np.isin(status[..., several], (1, 3)).all()  # folded, or not found
    assert (status[..., several] == 1).mean() > 0.3
    assert (status[..., single] == 0).all()
    assert made.counts["folded"] == (status == 1).sum()
    inverse = read(tmp_path / "v.mha")
    there = positions(inverse.grid) + inverse.values
    assert np.abs(moved(field, there) - positions(inverse.grid))[status == 1].max() < 1e-3  # one of the several


def test_composites_are_inverted_in_reverse(tmp_path: Path) -> None:
    field, affine = smooth(size=0.6), Affine(MATRIX)
    put(tmp_path / "both.h5", affine, field)
    made = invert_file(tmp_path / "both.h5", tmp_path / "v.mha", tolerance=1e-6)
    assert made.counts is None
    inverse = read(tmp_path / "v.mha")
    points = positions(inverse.grid)
    there = points + inverse.values
    fine = inside(GRID, affine(there), 1) & inside(GRID, points, 2)
    assert fine.mean() > 0.2
    np.testing.assert_allclose(moved(field, affine(there))[fine], points[fine], atol=2e-3)
    with pytest.raises(SuppleError, match=r"holds an affine map and a field: error and status are of the"):
        invert_file(tmp_path / "both.h5", tmp_path / "w.mha", error=tmp_path / "e.mha")
    assert sorted(os.listdir(tmp_path)) == ["both.h5", "v.mha"]


def test_affine_maps_are_inverted_exactly(tmp_path: Path) -> None:
    put(tmp_path / "a.tfm", Affine(MATRIX))
    made = invert_file(tmp_path / "a.tfm", tmp_path / "b.tfm")
    (found,) = read_file(tmp_path / "b.tfm").maps
    assert isinstance(found, Affine)
    np.testing.assert_allclose(found.matrix @ MATRIX, np.eye(4), atol=1e-12)
    assert (made.counts, made.error) == (None, None)


def test_the_inverse_in_the_convention_of_fsl_leads_to_the_grid_of_the_field(tmp_path: Path) -> None:
    field = smooth(size=0.6, dtype=np.float32)
    put(tmp_path / "u.nii.gz", field, convention="fsl-relative", source=OTHER)
    moving = image(tmp_path / "moving.nii.gz", OTHER)
    invert_file(tmp_path / "u.nii.gz", tmp_path / "v.nii.gz", convention="fsl-relative", image=moving, reference=moving)
    found = read(tmp_path / "v.nii.gz", "fsl-relative", source=GRID)
    assert found.grid.is_same_space(OTHER)
    np.testing.assert_allclose(found.values, field.invert(found.grid).field.values, atol=1e-3)
    put(tmp_path / "a.mat", Affine(MATRIX), convention="fsl-affine", source=OTHER, reference=GRID)
    fixed = image(tmp_path / "fixed.nii.gz", GRID)
    made = invert_file(tmp_path / "a.mat", tmp_path / "b.mat", convention="fsl-affine", image=moving, reference=fixed)
    assert made.sources[0].direction == PUSH
    (affine,) = read_file(tmp_path / "b.mat", "fsl-affine", source=GRID, reference=OTHER).maps
    assert isinstance(affine, Affine)
    np.testing.assert_allclose(affine.matrix @ MATRIX, np.eye(4), atol=1e-10)


def test_all_outputs_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "deep").mkdir()
    source = put(tmp_path / "u.mha", smooth())
    names = {"error": tmp_path / "e.nii", "status": tmp_path / "deep" / "s.nii", "report": tmp_path / "r.json"}
    names["status"].write_text("before")
    with pytest.raises(SuppleError, match=r"s.nii exists already: choose another name"):
        invert_file(source, tmp_path / "v.mha", **names)
    assert sorted(os.listdir(tmp_path)) == ["deep", "u.mha"]
    whole = verbs.write_image

    def breaking(path: Path, values: Array, *rest: Any, **named: Any) -> None:
        whole(path, values, *rest, **named)
        if values.dtype == np.uint8:
            raise SuppleError(f"cannot write {path}: the disk is full: make room")

    with monkeypatch.context() as patch:
        patch.setattr(verbs, "write_image", breaking)
        with pytest.raises(SuppleError) as caught:
            invert_file(source, tmp_path / "v.mha", **names, force=True)
    assert str(caught.value) == f"cannot write {names['status']}: the disk is full: make room"
    assert (sorted(os.listdir(tmp_path)), os.listdir(tmp_path / "deep")) == (["deep", "u.mha"], ["s.nii"])
    assert names["status"].read_text() == "before"
    with warnings.catch_warnings(action="error", category=FoldWarning), pytest.raises(FoldWarning):  # as --strict does
        invert_file(source, tmp_path / "v.mha", **names, force=True)
    assert sorted(os.listdir(tmp_path)) == ["deep", "u.mha"]
    invert_file(source, tmp_path / "v.mha", **names, force=True)
    assert sorted(os.listdir(tmp_path)) == ["deep", "e.nii", "r.json", "u.mha", "v.mha"]
    assert os.listdir(tmp_path / "deep") == ["s.nii"]
    with pytest.raises(SuppleError, match=r"w.nii is to be written twice: give each output a name of its own"):
        invert_file(source, tmp_path / "w.nii", error=tmp_path / "w.nii")


# ---- check


def test_a_field_is_checked_with_its_inverse(tmp_path: Path) -> None:
    field = smooth(size=0.6, dtype=np.float32)
    put(tmp_path / "u.nii.gz", field)
    invert_file(tmp_path / "u.nii.gz", tmp_path / "v.nii.gz")
    made = check_file(
        tmp_path / "u.nii.gz", tmp_path / "v.nii.gz", map=tmp_path / "j.nii.gz", picture=tmp_path / "p.png"
    )
    known = read(tmp_path / "u.nii.gz")
    assert made.report == known.check(read(tmp_path / "v.nii.gz"))
    written = volume.read(tmp_path / "j.nii.gz")
    np.testing.assert_array_equal(written.samples, known.log_jacobian())
    assert written.geometry.grid(written.samples.shape).is_same_space(GRID)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    facts = json.loads(json.dumps(made.facts(), allow_nan=False))
    assert facts["size"] == list(GRID.sizes)
    assert facts["determinant"] == made.report.determinant
    assert facts["consistency"]["outside"] == made.report.consistency.outside  # type: ignore[union-attr]
    assert facts["folds"] is False


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".tif"])
def test_what_is_not_known_is_no_zero_in_itk(tmp_path: Path, suffix: str) -> None:
    """ITK reads inf and NaN in NIfTI as 0, which is no error, and no change of volume."""
    field = Field(np.random.default_rng(0).normal(0, 2, (*GRID.shape, 3)), GRID)
    inverse, logarithms = field.invert(), field.log_jacobian()
    assert np.isinf(inverse.error).any()
    assert np.isnan(logarithms).any()
    put(tmp_path / "u.mha", field)
    made = invert_file(
        tmp_path / "u.mha", tmp_path / "v.mha", error=tmp_path / f"e{suffix}", status=tmp_path / f"s{suffix}"
    )
    assert made.counts == inverse.counts
    check_file(tmp_path / "u.mha", map=tmp_path / f"j{suffix}")
    error, status, found = (
        sitk.GetArrayFromImage(sitk.ReadImage(os.fspath(tmp_path / f"{name}{suffix}"))) for name in "esj"
    )
    np.testing.assert_array_equal(status, inverse.status)
    for seen, meant, nifti in ((error, inverse.error, np.finfo("f4").max), (found, logarithms, np.finfo("f4").min)):
        assert seen.dtype == np.float32
        known = np.isfinite(meant)
        np.testing.assert_array_equal(seen[known], meant[known])
        if suffix.startswith(".nii"):
            assert (seen[~known] == nifti).all()
        else:
            np.testing.assert_array_equal(seen, meant)
    assert (np.exp(found[np.isnan(logarithms)].astype(float)) == 0).all() or not suffix.startswith(".nii")


def test_json_has_no_nan(tmp_path: Path) -> None:
    put(tmp_path / "u.mha", Field(np.full((*GRID.shape, 3), 500.0), GRID))
    facts = check_file(tmp_path / "u.mha", tmp_path / "u.mha").facts()
    assert json.loads(json.dumps(facts, allow_nan=False))["consistency"]["largest"] is None


# ---- compose


@pytest.mark.parametrize("where", [None, OTHER], ids=["the first grid", "another"])
def test_maps_are_composed_as_points_go_through_them(tmp_path: Path, where: Grid | None) -> None:
    first, affine, second = smooth(size=0.5, seed=1), Affine(MATRIX), smooth(size=0.5, seed=2)
    put(tmp_path / "a.mha", first)
    put(tmp_path / "b.tfm", affine)
    put(tmp_path / "c.h5", second, Affine(MATRIX @ MATRIX))
    inputs = [Input(tmp_path / "b.tfm", inverse=True), Input(tmp_path / "a.mha"), Input(tmp_path / "c.h5")]
    reference = None if where is None else image(tmp_path / "r.nii.gz", where)
    made = compose_files(inputs, tmp_path / "d.nii.gz", reference=reference)
    assert (made.target.convention, made.target.known) == ("itk", "as all were read")
    found = read(tmp_path / "d.nii.gz")
    assert found.grid.is_same_space(where or GRID)
    points = positions(found.grid)
    one = affine.inverse()(points)
    two = moved(first, one)
    fine = inside(GRID, one) & inside(GRID, two)
    assert fine.mean() > 0.3
    expected = Affine(MATRIX @ MATRIX)(moved(second, two)) - points
    np.testing.assert_allclose(found.values[fine], expected[fine], atol=1e-5)
    with pytest.raises(SuppleError, match="there is nothing to compose"):
        compose_files([], tmp_path / "d.mha")


def test_the_inverse_of_a_file_of_several_is_that_of_each_in_reverse(tmp_path: Path) -> None:
    put(tmp_path / "c.h5", Affine(MATRIX), smooth(size=0.5))
    compose_files([Input(tmp_path / "c.h5"), Input(tmp_path / "c.h5", inverse=True)], tmp_path / "d.mha")
    found = read(tmp_path / "d.mha")
    points = positions(found.grid)
    assert np.abs(found.values[inside(GRID, Affine(MATRIX)(points), 1)]).max() < 1e-4


# ---- convert


@pytest.mark.parametrize("to", ["fsl-relative", "fsl-absolute", "mrtrix", "mrtrix-displacement"])
def test_there_and_back(tmp_path: Path, to: str) -> None:
    field = smooth(size=0.6, dtype=np.float32)
    put(tmp_path / "u.mha", field)
    moving = image(tmp_path / "moving.nii.gz", OTHER)
    there = convert_file(tmp_path / "u.mha", tmp_path / "w.nii.gz", to=to, image=moving)
    back = convert_file(tmp_path / "w.nii.gz", tmp_path / "v.nrrd", convention=to, image=moving)
    assert (there.target.kind, back.sources[0].known) == (CONVENTIONS[to], "as given")
    np.testing.assert_allclose(read(tmp_path / "v.nrrd").values, field.values, atol=2e-5)
    facts = there.facts()
    assert (facts["written"]["holds"], facts["written"]["units"]) == (CONVENTIONS[to].holds, "mm")


def test_an_oblique_field_stays_one_in_ome_zarr(tmp_path: Path) -> None:
    field = smooth(size=0.6, dtype=np.float32)
    put(tmp_path / "u.nii.gz", field)
    convert_file(tmp_path / "u.nii.gz", tmp_path / "u.zarr")
    again = Field.read(tmp_path / "u.zarr")
    assert again.grid.is_same_space(GRID)
    np.testing.assert_allclose(again.values, field.values, rtol=0, atol=1e-6)
    one, other = (check_file(tmp_path / name).report for name in ("u.nii.gz", "u.zarr"))
    assert (one.folded, one.samples) == (other.folded, other.samples)
    assert one.determinant == pytest.approx(other.determinant, abs=1e-5)
    invert_file(tmp_path / "u.zarr", tmp_path / "v.nii.gz", to="itk", error=tmp_path / "e.nii.gz")
    assert read(tmp_path / "v.nii.gz").grid.is_same_space(GRID)
    compose_files([Input(tmp_path / "u.zarr")], tmp_path / "w.nii.gz", to="itk")
    composed = read(tmp_path / "w.nii.gz")
    assert composed.grid.is_same_space(GRID)
    np.testing.assert_allclose(composed.values, field.values, rtol=0, atol=1e-6)


def test_with_a_reference_maps_are_sampled(tmp_path: Path) -> None:
    field, affine = smooth(size=0.6), Affine(MATRIX)
    put(tmp_path / "c.h5", field, affine)
    reference = image(tmp_path / "r.nii", OTHER)
    convert_file(tmp_path / "c.h5", tmp_path / "w.mha", reference=reference)
    points = positions(OTHER)
    fine = inside(GRID, points)
    expected = affine(moved(field, points)) - points
    np.testing.assert_allclose(read(tmp_path / "w.mha").values[fine], expected[fine], atol=1e-5)
    put(tmp_path / "b.tfm", affine)
    convert_file(tmp_path / "b.tfm", tmp_path / "f.mha", reference=reference)
    np.testing.assert_allclose(read(tmp_path / "f.mha").values, affine(points) - points, atol=1e-5)
    convert_file(tmp_path / "b.tfm", tmp_path / "b.h5", reference=reference)
    (kept,) = read_file(tmp_path / "b.h5").maps
    assert isinstance(kept, Affine)
    np.testing.assert_allclose(kept.matrix, MATRIX)
