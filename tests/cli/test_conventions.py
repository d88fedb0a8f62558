"""Files that count in voxels of images: the command gives them the grids, and names those that are missing.

The files are FSL's own; where they lead is known from its library (tests/media/transforms/data).
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import map_coordinates

from supple import Field, Grid
from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import Run, done, one_line
from tests.media.transforms.mapping import DATA, Floats, centres, grid_of

CLOSE = 1e-3
STILL = ("--filter", "linear", "--no-clamp", "--outside", "constant", "--fill", "-1000", "--quiet", "--force")


@pytest.mark.parametrize("name", ["lps", "Ras", "INDEX", "LPS"])
def test_coordinates_of_points_are_named_in_any_case(run: Run, name: str) -> None:
    put("in.nii", np.zeros((9, 9, 9), np.float32), Grid((9, 9, 9)))
    for table, text in (("a.csv", "4,4,4\n"), ("b.csv", "4,5,4\n")):
        Path(table).write_text(text)
    strokes = ("--pull", "a.csv:b.csv", "--radius", "2", "--quiet", "--force", "--border", "none")
    for given in (("points", "a.csv", "c.csv", "--on", "in.nii"), ("warp", "in.nii", "out.nii")):
        done(run(*given, *strokes, "--convention", name))
        status, _, err = run(*given, *strokes, "--convention", f"{name}x")
        assert (status, "LPS" in one_line(err)) == (2, True)


class Known:
    """Two images, their grids, and the affine map of FLIRT's matrix, solved for from points that fslpy moved."""

    def __init__(self, case: int) -> None:
        stored = np.load(DATA / "fsl.npz")
        self.moving = stored[f"moving_{case}"]
        self.source = grid_of(stored[f"source_{case}"], self.moving.shape)
        self.reference = grid_of(stored[f"reference_{case}"], stored[f"warped_{case}"].shape)
        self.points, self.mapped = stored[f"points_{case}"], stored[f"mapped_{case}"]
        self.affine = solved(self.points, stored[f"affine_{case}"])
        put("moving.nii.gz", self.moving, self.source)
        put("fixed.nii.gz", np.zeros(self.reference.shape, np.float32), self.reference)
        shutil.copyfile(DATA / f"fsl_{case}.mat", "a.mat")


def solved(points: Floats, there: Floats) -> Floats:
    """Return the homogeneous matrix that leads points to others."""
    made = np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), there, rcond=None)[0].T
    return np.vstack([made, [0, 0, 0, 1]])


def put(name: str, samples: npt.NDArray[np.float32], grid: Grid) -> None:
    x, y, z = grid.spacing
    a, b, c = grid.origin
    geometry = Geometry((x, y, z), (a, b, c), np.array(grid.direction), "RAS")
    volume.write(name, samples, volume.Volume(samples, geometry))


def seen(samples: npt.NDArray[np.float32], grid: Grid, places: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return an image at positions, by SciPy, and whether they are well within it."""
    at = np.moveaxis(grid.indices(places), -1, 0)[::-1]
    most = np.array(grid.shape).reshape(3, 1, 1, 1) - 1
    found = map_coordinates(samples.astype(np.float64), at, order=1)
    return found, ((at > 1e-2) & (at < most - 1e-2)).all(axis=0)


def through(matrix: Floats, points: Floats) -> Floats:
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


@pytest.mark.parametrize("case", range(4))
def test_a_matrix_of_flirt_goes_from_the_reference_to_the_input(run: Run, case: int) -> None:
    known = Known(case)
    line = ("warp", "moving.nii.gz", "out.nii.gz", "--affine", "a.mat", "--reference", "fixed.nii.gz", *STILL)
    status, out, err = run(*line, "--json")
    assert (status, err) == (0, "")
    made = volume.read("out.nii.gz")
    assert made.grid.is_same_space(known.reference)
    wanted, fine = seen(known.moving, known.source, through(known.affine, centres(known.reference)))
    assert fine.mean() > 0.3
    np.testing.assert_allclose(made.samples[fine], wanted[fine], atol=0.05)
    (facts,) = json.loads(out)["maps"]
    assert facts["convention"] == "fsl-affine"
    np.testing.assert_allclose(facts["matrix"], known.affine, atol=CLOSE)
    # Of a part, and of another spacing, the reference is the same image.
    assert run(*line, "--crop", "1,2,1,5,4,5")[0] == 0
    np.testing.assert_array_equal(volume.read("out.nii.gz").samples, made.samples[1:6, 2:6, 1:6])
    # Its inverse shows the fixed image on the grid of the moving one.
    put("seen.nii.gz", made.samples, known.reference)
    line = ("warp", "seen.nii.gz", "back.nii.gz", "--affine", "a.mat", "--inverse", "--reference", "moving.nii.gz")
    assert run(*line, *STILL) == (0, "", "")
    back = through(np.linalg.inv(known.affine), centres(known.source))
    wanted, fine = seen(made.samples, known.reference, back)
    fine &= wanted > -1
    assert fine.any()
    np.testing.assert_allclose(volume.read("back.nii.gz").samples[fine], wanted[fine], atol=0.05)


def test_a_composition_gives_each_file_the_image_that_it_comes_from(run: Run) -> None:
    """A matrix of FLIRT after an affine map of ITK: its reference is where that one leads, not the output."""
    known = Known(2)
    shift = np.eye(4)
    shift[:3, 3] = (3, -2, 1)
    Path("shift.tfm").write_text(
        "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\n"
        "Parameters: 1 0 0 0 1 0 0 0 1 3 -2 1\nFixedParameters: 0 0 0\n"
    )
    other = Grid((5, 6, 7), (4.0, 4.5, 5.0), known.reference.origin)
    put("other.nii.gz", np.zeros(other.shape, np.float32), other)
    line = (
        "compose", "shift.tfm", "--source", "fixed.nii.gz", "a.mat", "--source", "moving.nii.gz",
        "--reference", "other.nii.gz", "--out", "both.mha",
    )  # fmt: skip
    status, _, err = run(*line)
    assert (status, err) == (0, "")
    places = centres(other)
    made = Field.read("both.mha", "itk")
    np.testing.assert_allclose(made.values, through(known.affine @ shift, places) - places, atol=CLOSE)
    first = ("compose", "a.mat", "--source", "moving.nii.gz", "--reference", "fixed.nii.gz", "--out", "one.mha")
    assert run(*first)[0] == 0
    places = centres(known.reference)
    made = Field.read("one.mha", "itk")
    np.testing.assert_allclose(made.values, through(known.affine, places) - places, atol=CLOSE)


COUNTS = "fsl-affine counts in the voxels of the "
OUTPUT, INPUT = "output (fixed) image, which is not given: ", "input (moving) image, which is not given: "
MISSING: list[tuple[str, str]] = [
    ("warp moving.nii.gz out.nii --affine a.mat", OUTPUT + "give it by --reference"),
    ("warp moving.nii.gz out.nii --affine a.mat --inverse", INPUT + "give it by --reference"),
    (
        "warp moving.nii.gz out.nii --affine a.mat --affine 1,0,0,1,0,1,0,0,0,0,1,0 --reference fixed.nii.gz",
        OUTPUT + "convert it by itself first (supple convert)",
    ),
    (
        "warp moving.nii.gz out.nii --affine 1,0,0,1,0,1,0,0,0,0,1,0 --affine a.mat --reference fixed.nii.gz",
        INPUT + "convert it by itself first (supple convert)",
    ),
    ("compose a.mat --out b.mha --reference fixed.nii.gz", INPUT + "give its grid as --source"),
    ("compose a.mat --source moving.nii.gz --out b.mha", OUTPUT + "give its grid as --reference"),
    (
        "compose u.mha a.mat --source moving.nii.gz --out b.mha --reference fixed.nii.gz",
        OUTPUT + "convert it by itself first (supple convert)",
    ),
    (
        "compose a.mat --inverse --source moving.nii.gz --out b.mha --reference fixed.nii.gz",
        OUTPUT + "convert it by itself first (supple convert)",
    ),
    ("convert a.mat b.tfm --source moving.nii.gz", OUTPUT + "give its grid as --reference"),
    ("invert a.mat b.mat --reference fixed.nii.gz", INPUT + "give its grid as --source"),
]


@pytest.mark.parametrize(("line", "said"), MISSING)
def test_a_grid_that_is_missing_is_named(run: Run, line: str, said: str) -> None:
    known = Known(0)
    Field(np.zeros((*known.reference.shape, 3), np.float32), known.reference).write("u.mha")
    before = sorted(os.listdir())
    status, out, err = run(*line.split())
    assert (status, out) == (2, "")
    assert one_line(err) == f"supple: cannot read a.mat: {COUNTS}{said}\n"
    assert sorted(os.listdir()) == before


def test_an_stmap_of_a_picture_of_another_size(run: Run) -> None:
    """Its numbers are parts of the size of the picture that it leads to, which a map of positions does not tell."""
    rows, columns = np.indices((50, 60), np.float32)
    places = np.stack([columns * 0.7 + 1, rows * 0.7 + 2], axis=-1)
    np.save("map.npy", places)
    image.write("size.png", np.zeros((50, 60), np.uint8))
    of_map = ("--field", "map.npy", "--convention", "opencv")
    assert run("warp", "in.png", "direct.png", *of_map, "--reference", "size.png")[0] == 0
    status, _, err = run("convert", "map.npy", "blind.exr", "--from", "opencv")
    assert status == 0
    assert "blind.exr counts in the size of the picture that it leads to" in err
    assert "60 x 50 pixels, as the map has: --source names that picture" in err
    assert run("convert", "map.npy", "strict.exr", "--from", "opencv", "--strict")[0] == 2
    assert not Path("strict.exr").exists()
    assert run("convert", "map.npy", "known.exr", "--from", "opencv", "--source", "in.png")[2] == ""
    assert run("warp", "in.png", "through.png", "--field", "known.exr", "--reference", "size.png")[0] == 0
    direct, through = (image.read(name).pixels.astype(int) for name in ("direct.png", "through.png"))
    assert np.abs(direct - through).max() <= 1
    for line in ("convert known.exr back.npy", "invert known.exr back.exr", "check known.exr"):
        assert "known.exr counts in the size of the picture" in run(*line.split())[2], line
        options = ("--source", "in.png", *(("--force",) if "back" in line else ()))
        assert "counts in the size" not in run(*line.split(), *options)[2], line
    status, _, err = run("convert", "known.exr", "again.exr")
    assert (status, err) == (0, "")
