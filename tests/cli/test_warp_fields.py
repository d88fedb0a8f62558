"""supple warp with fields, affine maps and output grids, in the order of the arguments."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest

from supple import Affine, Deformation, Field, Grid, SuppleError
from supple.fields import Map
from supple.files.maps import MapFile
from supple.media import image
from supple.media import volume as media
from supple.space.geometry import Geometry
from tests.cli.commands import GRAB, Run, done, noise, one_line, pictures, told

SHAPE = (12, 16, 14)
PLACE = Geometry((1.0, 1.5, 2.0), (5.0, -6.0, 7.0), np.eye(3)[[1, 0, 2]], "LPS")
SHIFT = "1,0,2,0,1,-3"
STROKE = ("--grab", "7,8,6:9,8,6", "--radius", "5")


def smooth(grid: Grid) -> Field:
    """A field that is 0 at its edges, so that it has an inverse."""
    at = np.indices(grid.shape)
    waves = np.sin(at.sum(axis=0) / 4.0)
    for k, n in enumerate(grid.shape):
        waves *= np.sin(np.pi * at[k] / (n - 1))
    return Field(np.stack([waves * k for k in range(1, grid.ndim + 1)], axis=-1).astype(np.float32), grid)


FLAT = smooth(Grid((40, 48)))
SOLID = smooth(PLACE.grid(SHAPE))
TURN = Affine([[1, 0.1, 0, 1], [-0.1, 1, 0, 0], [0, 0, 1, 2]])
FILES: dict[str, tuple[Map, ...]] = {
    "flat.npy": (FLAT,),
    "solid.nii": (SOLID,),
    "turn.mat": (TURN,),
    "both.h5": (SOLID, TURN),
    "far.nii": (smooth(Grid(SHAPE, 1.0, (900.0, 0.0, 0.0))),),
}
Asked = list[tuple[str, str | None, Grid | None, Grid | None]]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """A reader of a few names, and what it was asked."""
    seen: Asked = []

    def read(
        path: str, convention: str | None = None, *, source: Grid | None = None, reference: Grid | None = None
    ) -> MapFile:
        seen.append((path, convention, source, reference))
        if path not in FILES:
            raise SuppleError(f"cannot read {path}: it is no field of a known kind: give another")
        return MapFile(Path(path), convention or "itk", "as given", FILES[path])

    monkeypatch.setattr("supple.files.maps.read_file", read)
    return seen


@pytest.fixture
def head(here: Path) -> npt.NDArray[Any]:
    samples = np.random.default_rng(3).integers(0, 900, SHAPE).astype(np.int16)
    media.write("head.nii.gz", samples, media.Volume(samples, PLACE))
    return samples


def pixels(name: str) -> npt.NDArray[Any]:
    return image.read(name).pixels


def test_maps_and_grabs_in_their_order(run: Run, asked: Asked) -> None:
    base = Deformation((40, 48))
    matrix = [[1, 0, 2], [0, 1, -3]]

    def grab(d: Deformation, k: int = 0) -> Deformation:
        at, to = (((20, 16), (23, 18)), ((30, 20), (28, 24)))[k]
        return d.grab(at, to=to, radius=12)

    second = ("--grab", "30,20:28,24")
    cases: list[tuple[tuple[str, ...], Deformation]] = [
        (("--field", "flat.npy"), base.field(FLAT)),
        (("--field=flat.npy", "--inverse"), base.field(FLAT, inverse=True)),
        (("--field", "flat.npy", *GRAB), grab(base.field(FLAT))),
        ((*GRAB, "--field", "flat.npy"), grab(base).field(FLAT)),
        ((*GRAB, "--field", "flat.npy", *second), grab(grab(base).field(FLAT), 1)),
        (
            ("--affine", SHIFT, *GRAB, "--affine=" + SHIFT, "--inverse", *second, "--field", "flat.npy", "--inverse"),
            grab(grab(base.affine(matrix)).affine(matrix, inverse=True), 1).field(FLAT, inverse=True),
        ),
        (("--affine", SHIFT, "--field", "flat.npy"), base.affine(matrix).field(FLAT)),
        (("--field", "flat.npy", "--affine", SHIFT), base.field(FLAT).affine(matrix)),
    ]
    for k, (options, wanted) in enumerate(cases):
        run_told = told(run("warp", "in.png", f"out{k}.png", *options, "--json"))
        np.testing.assert_array_equal(pixels(f"out{k}.png"), wanted.warp(pixels("in.png")), str(options))
        assert run_told["strokes"] == len(wanted.strokes)
    assert {(name, convention) for name, convention, _, _ in asked} == {("flat.npy", None)}
    # of the input image alone, and of no image between two maps, is the grid known
    own = Grid((40, 48))
    assert [(source, reference) for _, _, source, reference in asked] == [
        (own, None), (None, own), (own, None), (own, None), (own, None), (None, None), (None, None), (own, None)
    ]  # fmt: skip


def test_a_recipe_comes_before_grabs(run: Run, asked: Asked) -> None:
    assert (
        run("warp", "in.png", "bent.png", "--grab", "30,20:28,24", "--radius", "12", "--save-recipe", "r.json")[0] == 0
    )
    recipe = ("--recipe", "r.json")
    field, first = ("--field", "flat.npy"), Deformation((40, 48)).grab((30, 20), to=(28, 24), radius=12)
    for k, (options, wanted) in enumerate(
        (
            ((*field, *recipe, *GRAB), 0),
            ((*recipe, *field, *GRAB), 1),
            ((*recipe, *GRAB, *field), 2),
            ((*GRAB, *field, *recipe), 2),
        )
    ):
        made = told(run("warp", "in.png", f"out{k}.png", *options, "--json"))
        assert made["maps"][0]["after"] == wanted, options
    d = first.field(FLAT).grab((20, 16), to=(23, 18), radius=12)
    np.testing.assert_array_equal(pixels("out1.png"), d.warp(pixels("in.png")))


def test_volumes(run: Run, asked: Asked, head: npt.NDArray[Any]) -> None:
    grid = media.outline_of("head.nii.gz").grid
    still = {"between": "linear", "filter": "linear"}
    d = Deformation(grid).field(SOLID, inverse=True).grab((7, 8, 6), to=(9, 8, 6), radius=5).affine(TURN)
    options = ("--field", "solid.nii", "--inverse", "--convention", "itk", *STROKE, "--affine", "turn.mat")
    made = told(run("warp", "head.nii.gz", "out.nii.gz", *options, "--filter", "linear", "--json", "--no-clamp"))
    np.testing.assert_array_equal(media.read("out.nii.gz").samples, d.warp(head, **still))
    field, turn = made["maps"]
    assert (field["file"], field["convention"], field["direction"], field["units"]) == (
        "solid.nii",
        "itk",
        "inverse",
        "mm",
    )
    assert field["grid"] == {
        "size": [14, 16, 12],
        "spacing": [1.0, 1.5, 2.0],
        "origin": [5.0, -6.0, 7.0],
        "direction": np.eye(3)[[1, 0, 2]].tolist(),
    }
    assert (turn["kind"], turn["direction"], turn["after"]) == ("affine", "pull", 1)
    np.testing.assert_array_equal(turn["matrix"], TURN.matrix)
    assert (made["folded"], made["unsolved"]) == (0, 0)
    assert asked == [("solid.nii", "itk", None, grid), ("turn.mat", None, None, None)]
    assert turn["convention"] == "itk"
    numbers = ",".join(f"{x:g}" for x in TURN.matrix[:3].ravel())
    for options, wanted in (
        (("--affine", numbers), Deformation(grid).affine(TURN)),
        (("--field", "both.h5"), Deformation(grid).affine(TURN).field(SOLID)),
        (("--field", "both.h5", "--inverse"), Deformation(grid).field(SOLID, inverse=True).affine(TURN, inverse=True)),
    ):
        run("warp", "head.nii.gz", "out.nii.gz", *options, "--filter", "linear", "--no-clamp", "--force")
        np.testing.assert_array_equal(media.read("out.nii.gz").samples, wanted.warp(head, **still), str(options))


def test_output_grids(run: Run, asked: Asked, head: npt.NDArray[Any]) -> None:
    made = told(run("warp", "in.png", "part.png", *GRAB, "--crop", "4,6,30,20", "--json"))
    assert (made["width"], made["height"]) == (30, 20)
    assert made["grid"]["origin"] == [4.0, 6.0]
    assert run("warp", "in.png", "whole.png", *GRAB)[0] == 0
    np.testing.assert_array_equal(pixels("part.png"), pixels("whole.png")[6:26, 4:34])
    made = told(run("warp", "in.png", "small.png", "--resample", "2,4", "--json"))
    assert pixels("small.png").shape[:2] == (10, 24)
    assert "maps" not in made
    small = np.zeros((5, 6, 7), np.uint8)
    media.write("ref.mha", small, media.Volume(small, Geometry((2.0, 2.0, 2.0), (6.0, -5.0, 8.0), np.eye(3), "LPS")))
    made = told(
        run("warp", "head.nii.gz", "out.nii.gz", "--reference", "ref.mha", "--crop", "1,0,1,5,6,4", "--json",
            "--field", "solid.nii")
    )  # fmt: skip
    assert (made["width"], made["height"], made["depth"]) == (5, 6, 4)
    assert made["spacing"] == [2.0, 2.0, 2.0]
    assert nibabel.load("out.nii.gz").shape == (5, 6, 4)
    np.testing.assert_allclose(nibabel.load("out.nii.gz").affine[:3, 3], (-8.0, 5.0, 10.0))
    status, out, err = run("warp", "head.nii.gz", "again.nii.gz", "--resample", "1.5", *STROKE, "--field", "solid.nii")
    assert (status, out) == (0, "")
    assert (
        "supple: solid.nii: a field on 14 x 16 x 12 samples, spacing 1 x 1.5 x 2 mm, from (5, -6, 7), in mm in LPS, "
        "convention itk, from the output to the input, after stroke 1\n" in err
    )
    assert "supple: again.nii.gz is written on 10 x 16 x 16 samples, spacing 1.5 x 1.5 x 1.5 mm, from (" in err
    assert run("warp", "head.nii.gz", "mute.nii.gz", "--resample", "1.5", "--quiet") == (0, "", "")


def test_several_pictures(run: Run, asked: Asked) -> None:
    pictures("many")
    Path("many/bad.png").unlink()
    out = done(run("warp", "many", "bent", "--affine", SHIFT, "--json", "--crop", "2,3,10,9"))
    made = [json.loads(line) for line in out.splitlines()]
    assert len(made) == 2
    for each in made:
        assert pixels(each["output"]).shape == (9, 10, 3)
    status, out, err = run("warp", "many", "none", "--field", "gone.npy")
    assert (status, one_line(err)) == (
        2,
        "supple: cannot read gone.npy: it is no field of a known kind: give another\n",
    )
    assert not Path("none").exists()


def test_what_folds_is_told(run: Run, asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.zeros((40, 48, 2), np.float32)
    values[:, 24:, 0] = -6.0
    monkeypatch.setitem(FILES, "folds.npy", (Field(values, Grid((40, 48))),))
    status, out, err = run("warp", "in.png", "out.png", "--field", "folds.npy", "--inverse", "--json")
    made = json.loads(out)
    assert made["folded"] + made["outside"] + made["unsolved"] > 0
    assert any("field" in warning for warning in made["warnings"])
    assert "warning: " in err
    assert status == 0
    status, _, err = run("warp", "in.png", "strict.png", "--field", "folds.npy", "--inverse", "--strict", "--quiet")
    assert (status, Path("strict.png").exists()) == (2, False)


def test_a_stack_of_pages(run: Run, asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    stack = noise(6 * 20, 24, 1)
    held = media.Volume(stack.reshape(6, 20, 24), Geometry())
    media.write("stack.tif", stack.reshape(6, 20, 24), held)
    monkeypatch.setitem(FILES, "pages.nii", (Field(np.zeros((6, 20, 24, 3), np.float32), Grid((6, 20, 24))),))
    made = told(run("warp", "stack.tif", "out.tif", "--field", "pages.nii", "--json"))
    assert made["depth"] == 6
    np.testing.assert_array_equal(media.read("out.tif").samples, held.samples)
