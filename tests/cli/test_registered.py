"""Points, meshes, contours and renderings follow a registration of two oblique volumes, as ITK's transforms have it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813
from scipy.ndimage import gaussian_filter

from supple import Deformation, Field, Grid
from supple.media import image
from supple.media import volume as media
from supple.media.points import read_points
from supple.space.geometry import Geometry
from tests import fields
from tests.cli.commands import Run, done, told
from tests.media.landmarks import fcsv, markup, markups
from tests.media.meshes import made

Floats = npt.NDArray[np.float64]
FLIP = np.array([-1.0, -1.0, 1.0])
CHAIN = ("--affine", "turn.tfm", "--field", "warp.nii.gz")
ON = ("--on", "moving.nii.gz", "--reference", "fixed.nii.gz")


def tilted(angle: float, spacing: tuple[float, float, float], origin: tuple[float, float, float]) -> Geometry:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return Geometry(spacing, origin, turn * (1, -1, 1), "RAS")


MOVING = tilted(0.3, (1.9, 2.2, 3.1), (-40.0, 45.0, -30.0))
FIXED = tilted(-0.2, (2.5, 2.0, 2.8), (-35.0, 40.0, -38.0))


@pytest.fixture
def registered(here: Path) -> sitk.Transform:
    """Two volumes, and the maps that a registration of them writes: a field, and an affine map after it."""
    rng = np.random.default_rng(0)
    for name, geometry, shape in (("moving", MOVING, (22, 36, 40)), ("fixed", FIXED, (26, 38, 30))):
        samples = gaussian_filter(rng.normal(size=shape), 2).astype(np.float32)
        media.write(f"{name}.nii.gz", samples, media.Volume(samples, geometry))
    grid = media.outline_of("fixed.nii.gz").grid
    waves = np.stack([gaussian_filter(rng.normal(size=grid.shape), 4) * 60 for _ in range(3)], axis=-1)
    Field(waves.astype(np.float32), grid).write("warp.nii.gz", "itk")
    turn = sitk.AffineTransform(3)
    turn.SetMatrix([1.05, 0.08, -0.03, -0.06, 0.97, 0.1, 0.02, -0.09, 1.02])
    turn.SetTranslation([3, -4, 2])
    turn.SetCenter([4, -10, 12])
    sitk.WriteTransform(turn, "turn.tfm")
    field = sitk.DisplacementFieldTransform(sitk.ReadImage("warp.nii.gz", sitk.sitkVectorFloat64))
    return sitk.CompositeTransform([turn, field])


def through(transform: sitk.Transform, points: Floats) -> Floats:
    return np.array([transform.TransformPoint(p) for p in points.tolist()])


def placed(count: int = 40) -> Floats:
    """Points in the middle of the fixed volume, in LPS."""
    return FIXED.to_lps(np.random.default_rng(1).uniform((6, 8, 6), (22, 28, 18), (count, 3)))


def write(kind: str, points: Floats) -> Path:
    """Write points in LPS to a file of a kind, in the convention that is usual there."""
    lines = [" ".join(map(repr, p)) for p in points.tolist()]
    if kind == "fcsv":
        Path("in.fcsv").write_text(fcsv(points))
    elif kind == "mrk.json":
        Path("in.mrk.json").write_text(markups(markup(points)))
    elif kind.endswith(".csv"):
        columns = {"lps.csv": points, "ras.csv": points * FLIP, "ijk.csv": FIXED.from_lps(points)}[kind]
        rows = "".join(",".join(map(repr, row)) + "\n" for row in columns.tolist())
        Path(f"in.{kind}").write_text(",".join(kind[:3]) + "\n" + rows)
    elif kind == "obj":
        Path("in.obj").write_text("# SPACE=LPS\n" + "".join(f"v {line}\n" for line in lines) + "f 1 2 3\n")
    return Path(f"in.{kind}")


@pytest.mark.parametrize("kind", ["lps.csv", "ras.csv", "ijk.csv", "fcsv", "mrk.json", "obj"])
def test_points_of_every_kind_go_where_itk_takes_them(run: Run, registered: sitk.Transform, kind: str) -> None:
    """From the fixed volume to the moving one, and back; what is in voxels is in those of each volume."""
    points = placed()
    source, theirs = write(kind, points), through(registered, points)
    mesh = kind == "obj"
    facts = told(run("points", str(source), f"out.{kind}", "--inverse", *ON, *CHAIN, "--json"))
    found = read_points(f"out.{kind}", mesh=mesh).points
    wanted = {"ras.csv": theirs * FLIP, "ijk.csv": MOVING.from_lps(theirs)}.get(kind, theirs)
    # ITK has the field's positions in float32 geometry of NIfTI, as we do.
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-6)
    assert facts["largest_error"] == max(facts["error"]) < 1e-9
    assert len(facts["error"]) == len(points)
    assert facts["displaced"] == pytest.approx(np.linalg.norm(theirs - points, axis=1), abs=1e-5)
    if kind.endswith(".csv"):
        head, first, *_ = Path(f"out.{kind}").read_text().splitlines()
        assert head.endswith(",error_mm")
        assert float(first.split(",")[3]) == pytest.approx(facts["error"][0], rel=0.01)
    done(run("points", f"out.{kind}", f"back.{kind}", *ON, *CHAIN))
    start = read_points(source, mesh=mesh).points
    np.testing.assert_allclose(read_points(f"back.{kind}", mesh=mesh).points, start, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["binary.stl", "text.ply", "binary.vtk", "text.vtk", "Ascii-ZLib.vtp", "raw.vtp"])
def test_meshes_follow(run: Run, registered: sitk.Transform, name: str) -> None:
    centre = placed().mean(axis=0) * FLIP
    source = made.write(Path(name), made.surface(tuple(centre.tolist()), 8))
    for target in (f"there{source.suffix}", f"again{source.suffix}"):
        facts = told(run("points", str(source), target, "--inverse", *ON, *CHAIN, "--json"))
        source = Path(name)
    before, after = made.read(source), made.read(Path(target))
    theirs = through(registered, made.points(before) * FLIP) * FLIP
    np.testing.assert_allclose(made.points(after), theirs, rtol=0, atol=1e-5)
    assert made.faces(after) == made.faces(before)
    assert made.arrays(after) == made.arrays(before)
    assert max(facts["error"]) < 1e-5


@pytest.mark.parametrize("convention", ["spm-deformation", "niftyreg"])
def test_fields_of_spm_and_niftyreg_are_written_and_lead_to_the_same_places(
    run: Run, registered: sitk.Transform, convention: str
) -> None:
    """Positions in RAS, in NIfTI with five axes: as SPM's y_ files and NiftyReg's deformation fields are."""
    assert run("convert", "warp.nii.gz", "y_warp.nii", "--to", convention)[0] == 0
    written = nibabel.load("y_warp.nii")
    assert written.shape == (*nibabel.load("fixed.nii.gz").shape, 1, 3)
    index = (5, 20, 11)
    place = nibabel.affines.apply_affine(written.affine, index) * FLIP
    field = sitk.DisplacementFieldTransform(sitk.ReadImage("warp.nii.gz", sitk.sitkVectorFloat64))
    np.testing.assert_allclose(np.asarray(written.dataobj)[(*index, 0)] * FLIP, field.TransformPoint(place), atol=1e-4)
    points = placed()
    source = write("lps.csv", points)
    for said in ((), ("--convention", convention)):
        maps = (*CHAIN[:2], "--field", "y_warp.nii", *said)
        done(run("points", str(source), "out.csv", "--inverse", *ON, *maps, "--force"))
        np.testing.assert_allclose(read_points("out.csv").points, through(registered, points), rtol=0, atol=2e-5)
    assert run("warp", "moving.nii.gz", "a.nii.gz", "--field", "y_warp.nii", "--reference", "fixed.nii.gz")[0] == 0
    assert run("warp", "moving.nii.gz", "b.nii.gz", "--field", "warp.nii.gz", "--reference", "fixed.nii.gz")[0] == 0
    np.testing.assert_allclose(media.read("a.nii.gz").samples, media.read("b.nii.gz").samples, atol=1e-4)


def test_a_rendering_on_the_grid_of_the_fixed_volume(run: Run, registered: sitk.Transform) -> None:
    """It is that of the file that supple warp writes there; a mesh of the moving volume goes along."""
    done(run("warp", "moving.nii.gz", "seen.nii.gz", *CHAIN, "--reference", "fixed.nii.gz", "--filter", "linear"))
    look = ("--size", "64x64", "--density", "0,9")
    done(run("render", "moving.nii.gz", "out.png", *CHAIN, "--reference", "fixed.nii.gz", *look))
    assert run("render", "seen.nii.gz", "theirs.png", *look)[0] == 0
    ours, theirs = (image.read(name).pixels.astype(int) for name in ("out.png", "theirs.png"))
    assert np.abs(ours - theirs).mean() < 0.5
    assert run("render", "moving.nii.gz", "plain.png", *look)[0] == 0
    assert np.abs(ours - image.read("plain.png").pixels).mean() > 3
    centre = through(registered, placed()).mean(axis=0) * FLIP
    made.write(Path("ball.stl"), made.surface(tuple(centre.tolist()), 8))
    on = (*CHAIN, "--reference", "fixed.nii.gz", "--mesh", "ball.stl:#00ff00", "--density", "0.2,9", *look[:2])
    done(run("render", "moving.nii.gz", "mesh.png", *on))
    assert run("points", "ball.stl", "there.stl", *ON, *CHAIN)[0] == 0
    assert run("render", "seen.nii.gz", "wanted.png", "--mesh", "there.stl:#00ff00", *on[-4:])[0] == 0
    ours, theirs = (image.read(name).pixels.astype(int) for name in ("mesh.png", "wanted.png"))
    assert (theirs[..., 1] > 100).sum() > 50
    assert np.abs(ours - theirs).mean() < 1


@pytest.mark.parametrize("stretch", [1.0, 1000.0])
@pytest.mark.parametrize("inverse", [False, True])
def test_errors_bound_the_distance_to_exact_solutions(stretch: float, inverse: bool) -> None:
    """Of a field that is linear between its samples along x, whose inverse is known; and of a scale after it."""
    rng = np.random.default_rng(5)
    places = np.cumsum(rng.uniform(0.02, 1.9, 60))
    field = fields.along_x(places)
    scale = [[1 / stretch, 0, 0], [0, 1 / stretch, 0]]
    d = Deformation(Grid((4, 60)), border=None).field(field, inverse=inverse).affine(scale)
    ends = rng.uniform(places[0], places[-1], 500)
    given = np.stack([ends, np.full(500, 1.5)], axis=1)
    if inverse:  # T(x) = stretch f(x), which T⁻¹ solves
        found = d.certified(given * stretch, inverse=True)
        wanted = np.array([fields.solutions(places, x)[0][0] for x in ends.tolist()])
    else:  # T solves f(x) = q, and stretches the solution
        found = d.certified(given)
        wanted = stretch * np.array([fields.solutions(places, x)[0][0] for x in ends.tolist()])
    off = np.abs(found.points[:, 0] - wanted)
    assert found.converged.all()
    assert (off <= found.error).all()
    assert found.error.max() < 1e-7 * stretch


def test_what_is_not_solved_has_no_error_and_is_null_in_json(
    run: Run, registered: sitk.Transform, monkeypatch: pytest.MonkeyPatch
) -> None:
    certified = Deformation.certified

    def poor(self: Deformation, points: Floats, *, inverse: bool) -> Any:
        found = certified(self, points, inverse=inverse)
        found.error[0], found.converged[0] = np.inf, False
        return found

    monkeypatch.setattr(Deformation, "certified", poor)
    write("lps.csv", placed(3))
    status, out, err = run("points", "in.lps.csv", "out.csv", *ON, *CHAIN, "--json")
    assert status == 0, err
    facts = json.loads(out)
    assert (facts["unconverged"], facts["error"][0], facts["largest_error"]) == (1, None, None)
    assert Path("out.csv").read_text().splitlines()[1].endswith(",inf")
    assert "1 of 3 points did not converge: their error is inf" in err


def test_beyond_the_reach_of_strokes_there_is_no_error() -> None:
    d = Deformation((40, 40, 40)).grab((10, 10, 10), to=(12, 10, 10), radius=3)
    found = d.certified([(10, 10, 10), (35, 35, 35)])
    assert 0 < found.error[0] < 1e-10
    assert found.error[1] == 0
    assert tuple(found.points[1]) == (35, 35, 35)


def test_points_of_a_field_that_folds_are_said(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    z, y, x = np.mgrid[:16, :16, :16]
    moved = np.stack([6 * np.sin(x / 1.5), 0 * y, 0 * z], axis=-1)
    Field(moved, Grid((16, 16, 16))).write("fold.nii.gz", "itk")
    samples = np.zeros((16, 16, 16), np.int16)
    media.write("in.nii.gz", samples, media.Volume(samples, Geometry()))
    Path("p.csv").write_text("l,p,s\n8,8,8\n")
    status, _, err = run("points", "p.csv", "q.csv", "--on", "in.nii.gz", "--field", "fold.nii.gz")
    assert status == 0
    assert "where they lead to, a point is one of several" in " ".join(err.split())
