"""Volumes whose axes are not at right angles: sheared NIfTI and NRRD, and the tilted gantry of a CT."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, cast

import nibabel
import numpy as np
import numpy.typing as npt
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple import Grid, Recipe, Stroke, SuppleError
from supple.errors import VolumeWarning
from supple.files import Warped
from supple.files.options import VolumeOptions
from supple.files.volumes import open_volume
from supple.media import volume as media
from supple.space.domain import Domain
from tests import reference
from tests.files.clip_files import Run
from tests.media.volume.test_dicom import slices
from tests.media.volume.test_frames import PLACES, VALUES, enhanced, places_in
from tests.media.volume.volumes import SPACING

pytestmark = pytest.mark.filterwarnings("ignore:.* moves nothing")

Floats = npt.NDArray[np.float64]

SIZES = (22, 24, 20)
FREE = Domain((9, 9, 9), 1.0, None)
"""Millimetres without faces."""
MIDDLE = np.array([12.0, -30.0, 45.0])


def matrix(*, turned: bool = True) -> Floats:
    """From indices to RAS: voxels of 1.1 x 1.3 x 2 mm, whose slices are offset along y and x, and turned in space."""
    made = np.diag([-1.1, 1.3, 2.0, 1.0])
    made[:2, 2] = 0.3, 0.75
    made[1, 0] = 0.2
    if turned:
        a, b = 0.4, -0.3
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        made[:3, :3] = turn @ [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]] @ made[:3, :3]
    made[:3, 3] = MIDDLE - made[:3, :3] @ (np.array(SIZES) / 2)
    return made


def positions(affine: Floats, sizes: tuple[int, ...] = SIZES) -> Floats:
    """The positions of all voxels, (X, Y, Z, 3)."""
    return np.moveaxis(np.indices(sizes), 0, -1) @ affine[:3, :3].T + affine[:3, 3]


def plane(places: Floats) -> Floats:
    """Values that each filter interpolates without an error."""
    return places @ [2.0, -3.0, 4.0] + 7.0


def smooth(places: Floats) -> Floats:
    x, y, z = np.moveaxis(places, -1, 0)
    return np.sin(x / 6) + np.cos(y / 7 + z / 9) + 0.5 * np.sin(z / 8 - x / 11)


def written(path: Path, values: npt.NDArray[Any], affine: Floats) -> Path:
    """Write values (X, Y, Z) by nibabel or SimpleITK alone, at positions in RAS."""
    if path.name.endswith(".nrrd"):
        lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine
        spacing = np.linalg.norm(lps[:3, :3], axis=0)
        image = sitk.GetImageFromArray(values.T)
        image.SetSpacing(spacing.tolist())
        image.SetOrigin(lps[:3, 3].tolist())
        image.SetDirection((lps[:3, :3] / spacing).ravel().tolist())
        sitk.WriteImage(image, str(path))
    else:
        image = nibabel.Nifti1Image(values, None)
        image.set_sform(affine, 1)
        image.set_qform(None, 0)
        image.header.set_zooms(np.linalg.norm(affine[:3, :3], axis=0))
        image.to_filename(path)
    return path


def stroke(by: tuple[float, float, float] = (2.5, -1.5, 2.0), radius: float = 6.0) -> Stroke:
    return Stroke.grab(tuple(MIDDLE.tolist()), by=by, radius=radius, poisson=0.3, reach=2.0)


def warped(source: Path, target: Path, made: Stroke, border: Any = None, **options: Any) -> Warped:
    recipe = Recipe(strokes=(made,), border=border, space="RAS" if source.suffix == ".nrrd" else None)
    reading = VolumeOptions(world=recipe.space is None, labels=options.pop("labels", False))
    return supple.warp_file(source, target, recipe, volume=reading, clamp=False, **options)


@pytest.mark.parametrize("suffix", [".nii", ".nrrd"])
@pytest.mark.parametrize("filter", ["linear", "auto"])
def test_strokes_are_balls_in_millimetres_of_the_patient(here: Path, suffix: str, filter: str) -> None:
    affine = matrix()
    places = positions(affine)
    source = written(here / f"in{suffix}", plane(places), affine)
    made = warped(source, here / f"out{suffix}", stroke(), filter=filter, tolerance=1e-3)
    # The oracle knows of no grid: it moves points in millimetres.
    sources = reference.inverse([stroke()], FREE, places)
    assert 2.5 < np.linalg.norm(sources - places, axis=-1).max() < 3.6
    indices = (sources - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T
    within = ((indices >= 2) & (indices <= np.array(SIZES) - 3)).all(axis=-1)
    assert within.mean() > 0.4
    found = open_volume(made.target).samples.T
    far = np.abs(found - plane(sources))
    # In voxels, of up to 2.1 mm, along a slope of up to 6 a millimetre; the default cubic bends a plane by itself.
    assert far[within].max() < (1e-3 * 2.1 * 6 if filter == "linear" else 0.5)
    assert np.abs(found - plane(places))[within].max() > 5
    assert made.error <= 1e-3
    report = made.report()
    assert report.within
    assert report.unconverged == 0
    assert made.arrivals[0].miss < 1e-6
    place = affine[:3, :3] @ made.arrivals[0].arrived + affine[:3, 3]
    np.testing.assert_allclose(place, MIDDLE + stroke().by, atol=1e-4)


def test_smooth_values_and_all_brushes(here: Path) -> None:
    affine = matrix()
    places = positions(affine)
    source = written(here / "in.nii", smooth(places), affine)
    twist = Stroke.twist(tuple(MIDDLE.tolist()), angle=25, axis=(0, 0, 1), radius=6)
    made = warped(source, here / "out.nii", twist)
    # About the pivot, what is seen has turned against x, y of the patient by exactly the angle.
    step, turn = 1e-3, np.radians(25)
    at = made.deformation.grid.indices(MIDDLE * [-1, -1, 1])
    to = made.deformation.grid.indices((MIDDLE + np.array([step, 0, 0])) * [-1, -1, 1])
    moved = made.deformation.grid.positions(made.deformation.forward([at, to])) * [-1, -1, 1]
    np.testing.assert_allclose((moved[1] - moved[0]) / step, [np.cos(turn), np.sin(turn), 0], atol=1e-3)
    found = open_volume(made.target).samples.T
    grid = made.deformation.grid
    sources = grid.positions(made.deformation.inverse(grid.indices(places * [-1, -1, 1])).points) * [-1, -1, 1]
    np.testing.assert_allclose(found[3:-3, 3:-3, 3:-3], smooth(sources)[3:-3, 3:-3, 3:-3], atol=0.02)


def test_header_and_what_no_stroke_reaches_are_kept(here: Path) -> None:
    affine = matrix()
    values = np.random.default_rng(3).normal(size=SIZES).astype(np.float32)
    source = written(here / "in.nii", values, affine)
    small = stroke(radius=3.0)
    made = warped(source, here / "out.nii", small, tolerance=1e-3)
    assert source.read_bytes()[:352] == made.target.read_bytes()[:352]
    found = nibabel.load(made.target)
    reached = np.linalg.norm(positions(affine) - MIDDLE, axis=-1) < 2 * 3.0 + np.linalg.norm(small.by)
    assert 0.02 < reached.mean() < 0.5
    np.testing.assert_allclose(np.asarray(found.dataobj)[~reached], values[~reached], atol=0.01)
    assert np.mean(np.asarray(found.dataobj)[~reached] == values[~reached]) > 0.99
    assert (np.asarray(found.dataobj) != values).any()
    still = Stroke.grab(small.at, by=(0, 0, 0), radius=3)
    assert warped(source, here / "same.nii", still).target.read_bytes() == source.read_bytes()
    # Integers as well, also as labels; and of a part.
    labels = np.arange(values.size, dtype=np.int16).reshape(SIZES)
    source = written(here / "labels.nii", labels, affine)
    whole = np.asarray(nibabel.load(warped(source, here / "out-labels.nii", small, labels=True).target).dataobj)
    np.testing.assert_array_equal(whole[~reached], labels[~reached])
    crop = supple.GridOptions(crop=(3, 4, 5, 12, 13, 11))
    part = nibabel.load(warped(source, here / "part.nii", small, labels=True, grid=crop).target)
    np.testing.assert_array_equal(np.asarray(part.dataobj), whole[3:15, 4:17, 5:16])
    np.testing.assert_allclose(
        part.affine, affine @ [[1, 0, 0, 3], [0, 1, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]], atol=1e-5
    )
    assert (int(part.header["qform_code"]), int(part.header["sform_code"])) == (0, 1)


def test_a_qform_beside_a_sheared_sform(here: Path) -> None:
    image = nibabel.Nifti1Image(smooth(positions(matrix())), matrix())
    image.set_qform(matrix(), 1)  # which leaves out the shear
    image.to_filename("in.nii")
    with pytest.warns(VolumeWarning, match=r"miss right angles by .*: the sform is used") as told:
        known = media.read("in.nii")
    assert len(told) == 1
    np.testing.assert_allclose(np.diag([-1, -1, 1, 1]) @ known.geometry.matrix, matrix(), atol=1e-5)
    media.write("made.nii.gz", known.samples, media.read(written(here / "a.nrrd", known.samples.T, matrix())))
    header = nibabel.load("made.nii.gz").header
    assert (int(header["qform_code"]), int(header["sform_code"])) == (0, 1)
    np.testing.assert_allclose(header.get_sform(), matrix(), atol=1e-5)


class TestTiltedGantry:
    TILT = 18.0

    @property
    def places(self) -> Floats:
        """Of 12 slices, 2.5 mm apart along their normal, from a gantry that is tilted: they are stacked along z."""
        up = np.outer(np.arange(12.0), [0, 0, 2.5 / np.cos(np.radians(self.TILT))])
        return up + np.array([-11.0, -9.0, 40.0])

    @property
    def turn(self) -> Floats:
        a = np.radians(self.TILT)
        return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])

    def series(self, folder: Path, values: npt.NDArray[Any]) -> Path:
        told = "\\".join(f"{x:.10g}" for x in self.turn[:, :2].T.ravel())
        tags = {"0020|0037": told, "0018|0050": "2.5", "0018|0088": "2.5", "0018|1120": "18"}
        places = [place.tolist() for place in self.places]
        return slices(folder, values, places=places, change=[(k, tags) for k in range(len(values))])

    def values(self) -> tuple[Floats, npt.NDArray[np.int16]]:
        """The positions of the voxels in LPS, (Z, H, W, 3), and their values."""
        rows, columns = np.mgrid[:18, :20]
        inplane = columns[..., None] * SPACING[0] * self.turn[:, 0] + rows[..., None] * SPACING[1] * self.turn[:, 1]
        where = self.places[:, None, None] + inplane
        return where, np.rint(plane(where) * 10).astype(np.int16)

    DRAG = Stroke.grab((-4.0, 1.0, 56.0), by=(2.0, 1.5, 1.0), radius=5, poisson=0.3, reach=2.0)

    def test_a_series(self, here: Path, run: Run) -> None:
        where, values = self.values()
        folder = self.series(here / "ct", values)
        known = open_volume(folder)
        np.testing.assert_array_equal(known.samples, values)
        assert known.geometry.shear == pytest.approx(self.TILT, abs=1e-3)
        for index in ((0, 0, 0), (19, 17, 11), (4, 9, 7)):
            np.testing.assert_allclose(known.geometry.to_lps(index), where[index[::-1]], atol=1e-6)
        assert f"sheared: {self.TILT:g}° from right angles" in run("info", "ct")[1]

        made = supple.warp_file(
            folder, here / "bent", Recipe(strokes=(self.DRAG,), border=None), volume=VolumeOptions(world=True)
        )
        sources = reference.inverse([self.DRAG], FREE, where)
        found = open_volume(made.target).samples
        inner = (slice(2, -2), slice(4, -4), slice(4, -4))
        assert np.abs(found - 10 * plane(sources))[inner].max() < 0.5 + 0.01 * 10 * 2.7 * 6
        assert np.abs(found - values)[inner].max() > 30
        heads = sorted((pydicom.dcmread(path) for path in made.target.iterdir()), key=lambda head: head.InstanceNumber)
        np.testing.assert_allclose([head.ImagePositionPatient for head in heads], self.places, atol=1e-6)
        for head in heads:
            np.testing.assert_allclose(head.ImageOrientationPatient, self.turn[:, :2].T.ravel(), atol=1e-9)
            assert head.PixelSpacing == [SPACING[1], SPACING[0]]
            assert head.SpacingBetweenSlices == pytest.approx(2.5, abs=1e-5)
            assert head.SliceThickness == 2.5
        # The same as NIfTI has the same place, and the same values.
        supple.warp_file(
            folder, "bent.nii.gz", Recipe(strokes=(self.DRAG,), border=None), volume=VolumeOptions(world=True)
        )
        nifti = media.read("bent.nii.gz")
        np.testing.assert_array_equal(nifti.samples, found)
        np.testing.assert_allclose(nifti.geometry.matrix, known.geometry.matrix, atol=1e-5)

    def test_one_file_of_many_frames(self, here: Path) -> None:
        aside = np.outer(np.arange(4), [0.0, 0.5, 0.25])
        source = enhanced(here / "in.dcm", places=PLACES + aside)
        known = media.read(source)
        np.testing.assert_array_equal(known.samples, 2 * VALUES - 1000)
        np.testing.assert_allclose(known.geometry.to_lps([[0, 0, k] for k in range(4)]), PLACES + aside, atol=1e-6)
        recipe = Recipe(strokes=(Stroke.grab((3, 2, 2), by=(0.5, 0.3, 0.2), radius=3),), border=None)
        supple.warp_file(source, "out.dcm", recipe)
        np.testing.assert_allclose(places_in(pydicom.dcmread("out.dcm")), PLACES + aside, atol=1e-6)
        assert (media.read("out.dcm").samples != known.samples).any()

    def test_slices_along_no_line_are_refused(self, here: Path) -> None:
        aside = self.places
        aside[6, 0] += 1.5
        told = "\\".join(f"{x:.10g}" for x in self.turn[:, :2].T.ravel())
        folder = slices(
            here / "ct", self.values()[1], places=[p.tolist() for p in aside],
            change=[(k, {"0020|0037": told}) for k in range(12)],
        )  # fmt: skip
        with pytest.raises(SuppleError, match=r"'?ct'?: its slices are offset sideways, and along no line: .*-6.dcm"):
            media.read(folder)


def test_points_fields_and_recipes_are_of_the_same_map(here: Path, run: Run) -> None:
    affine = matrix()
    source = written(here / "in.nii", plane(positions(affine)), affine)
    grab = ("--grab", "11,12,10:13,13,11", "--radius", "6", "--border", "none")
    assert run("warp", "in.nii", "out.nii", *grab, "--save-recipe", "r.json", "--save-field", "field.nii.gz")[0] == 0
    assert run("warp", "in.nii", "again.nii", "--recipe", "r.json")[0] == 0
    assert Path("again.nii").read_bytes() == Path("out.nii").read_bytes()
    start, end = (affine[:3, :3] @ index + affine[:3, 3] for index in ([11, 12, 10], [13, 13, 11]))
    drag = Stroke.grab(tuple(start.tolist()), by=tuple((end - start).tolist()), radius=6)

    # Points, in voxels and in millimetres.
    indices = np.array([[11.0, 12, 10], [9, 14, 8], [1, 1, 1], [12.5, 9, 12]])
    places = indices @ affine[:3, :3].T + affine[:3, 3]
    wanted = reference.forward([drag], FREE, places)
    voxels = (wanted - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T
    for head, given, moved in (("r,a,s", places, wanted), ("i,j,k", indices, voxels)):
        lines = [",".join(map(repr, point)) for point in given.tolist()]
        Path("in.csv").write_text("\n".join([head, *lines]))
        assert run("points", "in.csv", "out.csv", "--on", "in.nii", "--recipe", "r.json", "--force")[0] == 0
        found = np.loadtxt("out.csv", delimiter=",", skiprows=1)
        np.testing.assert_allclose(found[:, :3], moved, atol=1e-4)
        assert found[:, 3].max() < 1e-5
        back = ("--on", "in.nii", "--recipe", "r.json", "--inverse", "--force")
        assert run("points", "out.csv", "back.csv", *back)[0] == 0
        np.testing.assert_allclose(np.loadtxt("back.csv", delimiter=",", skiprows=1)[:, :3], given, atol=1e-5)

    # The field, on the upright grid around the volume, by SimpleITK alone.
    image = sitk.ReadImage("field.nii.gz", sitk.sitkVectorFloat64)
    transform = sitk.DisplacementFieldTransform(image)
    lps = np.diag([-1.0, -1.0, 1.0])
    seen = np.array([transform.TransformPoint((place @ lps).tolist()) for place in wanted]) @ lps
    np.testing.assert_allclose(seen, places, atol=0.06)
    # Applied to the sheared volume, it is the same map.
    assert run("warp", "in.nii", "theirs.nii", "--field", "field.nii.gz")[0] == 0
    ours, theirs = (np.asarray(nibabel.load(name).dataobj) for name in ("out.nii", "theirs.nii"))
    assert np.abs(ours - theirs)[3:-3, 3:-3, 3:-3].max() < 0.5
    assert np.abs(ours - nibabel.load(source).get_fdata()).max() > 5


def test_what_needs_right_angles_says_how_to_get_them(here: Path, run: Run) -> None:
    from supple.viewer.window.launch import stage_of

    affine = matrix(turned=False)
    written(here / "in.nii", plane(positions(affine)).astype(np.float32), affine)
    grab = ("--grab", "11,12,10:13,13,11", "--radius", "6")
    told = set()
    for arguments in (
        ("render", "in.nii", "out.png"),
        ("warp", "in.nii", "out.zarr", *grab),
        ("warp", "in.nii", "out.nii", "--freeze", "in.nii", *grab),
        ("invert", "field.nii", "out.nii", "--reference", "in.nii"),
    ):
        status, out, err = run(*arguments)
        assert (status, out, err.count("\n")) == (2, "", 1), arguments
        assert "axes at right angles" in err, err
        told.add(err[err.index("axes at right angles") :])
    with pytest.raises(SuppleError, match="the window takes axes at right angles") as caught:
        stage_of(cast("Any", None), "in.nii")
    told.add(f"{caught.value}\n"[len("the window takes ") :])
    assert list(here.iterdir()) == [here / "in.nii"]
    (only,) = told
    assert "those of in.nii miss them by 20." in only
    # The command does it; what is within the sheared volume has its values at its place.
    line = only[only.index("supple warp") : only.index(" makes a volume")]
    assert run(*shlex.split(line)[1:], "--filter", "linear")[0] == 0
    upright = nibabel.load("upright.nii.gz")
    assert media.read("upright.nii.gz").geometry.shear == 0
    assert media.outline_of("upright.nii.gz").grid.is_same_space(media.outline_of("in.nii").grid.upright())
    places = positions(upright.affine, upright.shape)
    indices = (places - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T
    within = ((indices >= 1) & (indices <= np.array(SIZES) - 2)).all(axis=-1)
    np.testing.assert_allclose(upright.get_fdata()[within], plane(places)[within], atol=1e-3)
    # On that grid, a freeze mask holds for the sheared volume.
    written(here / "mask.nii", (np.arange(22) < 11)[:, None, None] * np.ones(SIZES, np.uint8), affine)
    steps = only[only.index("--resample") :].split()[1]
    assert run("warp", "mask.nii", "up-mask.nii", "--resample", steps, "--labels")[0] == 0
    assert run("warp", "in.nii", "out.nii", "--freeze", "up-mask.nii", *grab)[0] == 0
    moved = np.abs(nibabel.load("out.nii").get_fdata() - nibabel.load("in.nii").get_fdata()).max(axis=(1, 2))
    assert moved[:9].max() == 0
    assert moved[14] > 1


def test_grids() -> None:
    lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ matrix()
    steps = np.linalg.norm(lps[:3, :3], axis=0)
    grid = Grid(SIZES[::-1], steps.tolist(), lps[:3, 3].tolist(), lps[:3, :3] / steps)
    upright = grid.upright()
    assert upright.upright() is upright
    np.testing.assert_allclose(
        upright.matrix[:3, :3].T @ upright.matrix[:3, :3], np.diag(np.square(upright.spacing)), atol=1e-12
    )
    # Around it, and no larger; of planes as far apart as its slices, along their normal.
    corners = upright.indices(grid.positions(np.moveaxis(np.indices((2, 2, 2)), 0, -1) * (np.array(SIZES) - 1)))
    np.testing.assert_allclose(corners.min(axis=(0, 1, 2)), 0, atol=1e-9)
    assert np.all(np.abs(corners.max(axis=(0, 1, 2)) - np.array(upright.sizes) + 1.5) <= 0.5 + 1e-9)
    np.testing.assert_allclose(corners[..., 2], np.broadcast_to([0, SIZES[2] - 1], (2, 2, 2)), atol=1e-9)
    for refused in (
        lambda: supple.Deformation(grid),
        lambda: supple.Field(np.zeros((*grid.shape, 3)), grid),
        lambda: Grid((3, 4, 5), 1.0, None, [[1, 1, 0], [0, 0.05, 0], [0, 0, 1]]),
        lambda: Grid((3, 4), 1.0, None, [[1, 1], [0, 1]]),
    ):
        with pytest.raises(SuppleError, match=r"right angles|in a plane|unit length"):
            refused()
    # Whatever the grid of the deformation, samples may be on a sheared one.
    deformation = supple.Deformation(upright, border=None).grab((12, 14, 10), by=(2, 1, 1), radius=6)
    values = plane(grid.positions(np.moveaxis(np.indices(SIZES), 0, -1)))
    seen = deformation.warp(plane(upright.positions(np.moveaxis(np.indices(upright.sizes), 0, -1))).T.copy(), grid=grid)
    sources = upright.positions(deformation.inverse(upright.indices(grid.positions(ROLL))).points)
    np.testing.assert_allclose(seen[10, 12, 8:14], plane(sources), atol=0.3)
    assert np.abs(seen.T - values).max() > 3


ROLL = np.array([[x, 12.0, 10.0] for x in range(8, 14)])
"""Some voxels, in a row."""
