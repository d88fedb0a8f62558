"""The commands invert, check, compose and convert: what they say, write and refuse."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from supple import Affine, Field, Placed, compose
from supple.cli.fields import parse_maps
from supple.errors import SuppleError
from supple.media import transforms, volume
from tests.cli.commands import Run, done, one_line
from tests.sampled_fields import GRID, sine, smooth

MATRIX = np.array([[1.03, 0.05, 0, 0.4], [-0.04, 0.98, 0.03, -0.3], [0, 0.02, 1.01, 0.2], [0, 0, 0, 1]])


def put(name: str, *maps: Field | Affine) -> None:
    held = [
        transforms.Displacements(each.values, each.grid) if isinstance(each, Field) else each.matrix for each in maps
    ]
    transforms.write(name, held, "itk")


@pytest.fixture(autouse=True)
def _files(here: Path) -> None:
    """A field that does not fold, and is still at its edges; one that folds; and an affine map."""
    still = np.ones(GRID.shape)
    for axis, size in enumerate(GRID.shape):
        window = np.sin(np.pi * np.arange(size) / (size - 1)).reshape([-1 if k == axis else 1 for k in range(3)])
        still = still * window
    put("u.nii.gz", Field((smooth(size=0.6).values * still[..., None]).astype("f4"), GRID))
    put("folded.mha", sine(1.5, (4, 5, 126)))
    put("a.tfm", Affine(MATRIX))
    os.remove("in.png")


def test_invert_says_what_it_read_and_how_well_it_went(run: Run) -> None:
    status, out, err = run("invert", "u.nii.gz", "v.nii.gz", "--error", "e.nii.gz", "--report", "r.json")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    field = (
        "a field of displacements, 15 x 17 x 12 voxels of 1.1 x 0.9 x 1.6 mm, the first at (-20, 13.5, 40.25) in LPS"
    )
    assert lines[:3] == [
        "u.nii.gz: read as ITK (LPS, mm), from its intent code",
        "  direction   pull: output point -> input point",
        f"  holds       {field}",
    ]
    assert lines[3:6] == [
        "v.nii.gz: written as ITK (LPS, mm), as it was read",
        "  direction   pull: output point -> input point",
        f"  holds       {field}",
    ]
    assert lines[6] == "  voxels      3,060 ok (100 %), 0 folded (0 %), 0 outside (0 %), 0 unconverged (0 %)"
    assert lines[7].startswith("  error       up to ")
    assert lines[7].endswith(" mm among the ok; the tolerance is 0.01 voxels")
    assert lines[8].startswith("  time        ")
    assert len(lines) == 9
    assert {"v.nii.gz", "e.nii.gz", "r.json"} <= set(os.listdir())


def test_the_inverse_of_a_picture_is_told_in_pixels(run: Run) -> None:
    x, y = np.meshgrid(np.arange(30.0), np.arange(20.0))
    np.save("map.npy", np.stack([x + 0.25, y], axis=-1))
    _, out, _ = run("invert", "map.npy", "back.npy", "--convention", "opencv")
    told = [line for line in out.splitlines() if line.startswith(("  pixels ", "  error "))]
    assert told[0].startswith("  pixels      600 ok (100 %), 0 folded")
    assert told[1].endswith(" px among the ok; the tolerance is 0.01 pixels")


def test_a_fold_is_a_warning_of_one_line(run: Run) -> None:
    status, out, err = run("invert", "folded.mha", "v.mha", "--json", "--status", "s.mha")
    assert status == 0
    line = one_line(err)
    assert line.startswith("supple: warning: folded.mha: of 2,520 voxels of the inverse, ")
    assert "nothing was smoothed or set to zero" in line
    facts = json.loads(out)
    assert facts["warnings"] == [line.removeprefix("supple: warning: ").rstrip("\n")]
    assert facts["counts"]["folded"] == int((volume.read("s.mha").samples == 1).sum()) > 0
    assert sum(facts["counts"].values()) == 2520
    os.remove("v.mha")
    status, out, err = run("invert", "folded.mha", "v.mha", "--strict", "--status", "t.mha")
    assert (status, out) == (2, "")
    assert one_line(err).endswith("(--strict: warnings are errors)\n")
    assert not {"v.mha", "t.mha"} & set(os.listdir())
    status, out, err = run("invert", "folded.mha", "v.mha", "--quiet")
    assert (status, out, err) == (0, "", "")


def test_check_tells_of_folds_and_is_no_error(run: Run) -> None:
    status, out, err = run("check", "folded.mha", "--map", "j.nii.gz", "--picture", "p.png")
    assert (status, err) == (0, "")
    report = sine(1.5, (4, 5, 126)).check()
    lines = out.splitlines()
    assert lines[0] == "folded.mha: read as ITK (LPS, mm), from its suffix .mha"
    assert lines[3:] == [
        "folded.mha:",
        f"  moves       up to 1.5 mm, {report.mean:.4g} mm on average",
        f"  folds       {report.folded:,} of 1,500 cells ({100 * report.folded / 1500:.3g} %)",
        "              is it of the convention itk, from its suffix .mha? --convention says another",
        f"  determinant the least is {report.determinant:.4g}, at ({report.at[0]:.5g}, 0, 0) mm in LPS",
        f"              not above 0 at {report.negative:,} of 2,520 samples ({100 * report.negative / 2520:.3g} %), "
        "by central differences",
    ]
    assert {"j.nii.gz", "p.png"} <= set(os.listdir())
    status, out, err = run("check", "folded.mha", "--json")
    facts = json.loads(out)
    assert (facts["folds"], facts["folded"], facts["determinant"]) == (True, report.folded, report.determinant)


def test_check_with_an_inverse(run: Run) -> None:
    assert run("invert", "u.nii.gz", "v.nii.gz", "--quiet") == (0, "", "")
    status, out, err = run("check", "u.nii.gz", "v.nii.gz")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[3] == "v.nii.gz: read as ITK (LPS, mm), from its intent code"
    assert lines[8] == "  folds       nowhere: the determinant is above 0 in all of 2,464 cells"
    assert lines[-1].startswith("  consistency ")
    assert lines[-1].endswith(" mm on average, of 3,060 samples")
    _, out, _ = run("check", "u.nii.gz", "v.nii.gz", "--json")
    found = json.loads(out)["consistency"]
    assert (found["count"], found["outside"]) == (3060, 0)
    assert f"{found['largest']:.3g} mm at most, 99 % within {found['percentile']:.3g} mm" in lines[-1]


def test_compose_takes_what_stands_after_a_file_for_that_file(run: Run) -> None:
    line = ("compose", "a.tfm", "--inverse", "u.nii.gz", "--convention", "itk", "--out", "d.mha")
    out = done(run(*line))
    assert out.splitlines()[0] == "a.tfm: read as ITK (LPS, mm), from its suffix .tfm; inverted"
    assert "u.nii.gz: read as ITK (LPS, mm), as given" in out
    assert "d.mha: written as ITK (LPS, mm), as all were read" in out
    made = Field.read("d.mha", "itk")
    known = compose([Placed(Affine(MATRIX), inverse=True), Field.read("u.nii.gz", "itk")], GRID)
    np.testing.assert_allclose(made.values, known.values, atol=1e-5)
    _, out, _ = run(*line, "--force", "--json")
    facts = json.loads(out)
    assert [each["inverse"] for each in facts["read"]] == [True, False]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--inverse", "a"], "--inverse is about the file before it, and there is none: give a file first"),
        (["a", "--inverse", "--inverse"], "--inverse is given twice for a"),
        (["a", "--convention"], "--convention needs a name after it"),
        (["a", "--source", "--inverse"], "--source needs a file after it"),
        (["a", "--source", "b", "--source=c"], "--source is given twice for a"),
        (["a", "--invert"], "Unknown option: --invert"),
        (["a", "--inverse=b"], "Unknown option: --inverse=b"),
    ],
)
def test_options_that_are_of_no_file(words: list[str], message: str) -> None:
    with pytest.raises(SuppleError, match=message):
        parse_maps(words)


def test_convert_tells_both_ends(run: Run) -> None:
    status, out, err = run("convert", "u.nii.gz", "w.nii.gz", "--to", "fsl-relative", "--source", "u.nii.gz")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "u.nii.gz: read as ITK (LPS, mm), from its intent code"
    assert lines[3] == "w.nii.gz: written as FSL, relative (FSL coordinates of the input image, mm), as asked"
    status, out, err = run("convert", "w.nii.gz", "x.nrrd", "--from", "fsl-relative", "--source", "u.nii.gz", "--json")
    facts = json.loads(out)
    assert (facts["read"][0]["known"], facts["written"]["known"]) == ("as given", "from its suffix .nrrd")
    found, known = Field.read("x.nrrd", "itk"), Field.read("u.nii.gz", "itk")
    np.testing.assert_allclose(found.values, known.values, atol=1e-5)
