"""Bad files, grids and options of fields: one line that names them, exit status 2, and nothing left behind."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import nibabel
import numpy as np
import pytest

from supple import Field, SuppleError
from tests.cli.commands import Run, one_line
from tests.cli.inputs import PLACE, WAVES, nifti
from tests.refusals import refused

WAVES[..., 0] = np.sin(np.arange(9) / 3)[:, None, None, None]


@pytest.fixture(autouse=True)
def _files(here: Path, inputs: Path) -> None:
    shutil.copytree(inputs, here, dirs_exist_ok=True)


FILES: list[tuple[str, str | None, str]] = [
    ("code.nii", None, "of the intent code 1002, which several programs write: give "),
    ("code.nii", "itk", "5 axes and the intent code 1002, and a field of ITK has 5 and the code 1007"),
    ("u.nii", "mrtrix", "its intent code is 1007, and that of a field in the convention mrtrix is 0"),
    ("u.nii", "opencv", "the suffix .nii is of no map of OpenCV's"),
    ("flow.npy", "itk", "the suffix .npy is of no transform of ITK: use .nii, "),
    ("a.tfm", "freesurfer", "it holds no maps: give a .lta file of one affine map"),
    ("u.nii", "spm", " must be one of itk, fsl-relative, "),
    ("nowhere-u.nii", None, "it does not say where its voxels lie (its sform and qform have the code 0)"),
    ("complex.nii", None, "its voxels are of complex64"),
    ("complex.npy", "opencv", "it holds complex64 of shape (40, 48, 2): give real numbers"),
    ("nan.nii", None, "1 voxel of 504 hold NaN or infinity: give a field that is finite everywhere"),
    ("nan.npy", "opencv", "1 of its 1920 positions is NaN or infinite: fill them first"),
    ("mask.nii", None, "it holds one value for each voxel, as an image or a mask: give a field with three"),
    ("mask.nii", "fsl-relative", "it holds one value for each voxel, as an image or a mask"),
    ("two.nii", None, "it holds two values for each voxel, as a field of a picture: give a field with three"),
    ("four.nii", None, "it holds 4 values for each voxel: give a field with three"),
    ("one.npy", "opencv", "it holds float32 of shape (40, 48): give an array (H, W, 2) of source positions"),
    ("empty.nii", None, "it is empty"),
    ("empty.nii.gz", "itk", "it is empty"),
    ("empty.npy", "opencv", "it is empty"),
    ("empty.tfm", None, "it is empty"),
    ("cut.nii", None, "its header promises"),
    ("cut.nii.gz", None, "it is cut short"),
    ("cut.npy", "opencv", "it is no array of NumPy's, or cut short"),
    ("folder.nii", None, "it is a folder or no plain file"),
    ("folder", None, "a name without suffix tells no convention: give "),
    ("flow.npy", None, "it is not always a map of positions, as of OpenCV's: give "),
    ("gone.jpg", None, "No such file or directory"),
    ("in.png", None, "it is not always an STMap: give "),
    ("photo.jpg", None, "the suffix .jpg is of a picture, and of no field"),
    ("clip.mp4", None, "the suffix .mp4 is of a clip, and of no field"),
    ("folder", "itk", "a name without suffix is of no transform of ITK"),
    ("gone.nii", None, "No such file or directory"),
]


@pytest.mark.parametrize(("name", "convention", "said"), FILES)
def test_a_file_that_holds_no_field_is_named_by_every_command_and_in_python(
    run: Run, name: str, convention: str | None, said: str
) -> None:
    options = () if convention is None else ("--convention", convention)
    source = ("--source", "head.nii") if convention == "fsl-relative" else ()
    shown = "in.png" if name.endswith((".npy", ".png")) else "head.nii"
    before = sorted(os.listdir())
    for line in (
        ("invert", name, "v.mha", *options, *source),
        ("check", name, *options, *source),
        ("compose", name, *options, *source, "--out", "v.mha"),
        ("convert", name, "v.mha", *(("--from", *options[1:]) if options else ()), *source),
        ("warp", shown, f"out-{shown}", "--field", name, *options),
    ):
        status, out, err = run(*line)
        assert (status, out) == (2, ""), line
        assert said in one_line(err), line
        assert name in err or " must be one of" in err
        assert sorted(os.listdir()) == before, line
    assert said in refused(Field.read, name, convention, source=Field.read("u.nii").grid if source else None)


def test_a_field_that_leads_to_a_far_image_is_taken(run: Run) -> None:
    """It holds the affine part: its grid is that of the output, and the input lies elsewhere."""
    leading = WAVES + np.array([-900.0, -900.0, 900.0], np.float32)  # LPS
    nifti("there.nii", leading, 1007)
    line = ("warp", "far-head.nii", "o.nii", "--field", "there.nii", "--reference", "head.nii", "--filter", "linear")
    assert run(*line, "--quiet") == (0, "", "")
    assert run("warp", "head.nii", "same.nii", "--field", "u.nii", "--filter", "linear", "--quiet") == (0, "", "")
    made, same = (nibabel.load(name) for name in ("o.nii", "same.nii"))
    np.testing.assert_allclose(made.affine, PLACE)
    np.testing.assert_allclose(made.get_fdata()[1:-1], same.get_fdata()[1:-1], atol=0.02)
    assert run("invert", "there.nii", "back.mha", "--reference", "far-head.nii", "--quiet") == (0, "", "")
    known = json.loads(run("check", "there.nii", "back.mha", "--json")[1])["consistency"]
    assert known["count"] > 400
    assert known["largest"] < 0.1
    with pytest.raises(SuppleError, match="do not overlap"):
        Field.read("u.nii").invert(Field.read("far-u.nii").grid)


def test_a_volume_that_does_not_say_where_it_lies_is_told(run: Run) -> None:
    said = "does not say where its voxels lie in space: its first one is taken to lie at (0, 0, 0), and its axes along"
    status, _, err = run("warp", "nowhere-head.nii", "o.nii", "--affine", "1,0,0,1,0,1,0,0,0,0,1,0")
    assert status == 0
    assert f"supple: warning: nowhere-head.nii {said}" in err
    status, _, err = run("warp", "head.nii", "p.nii", "--reference", "nowhere-head.nii")
    assert f"supple: warning: nowhere-head.nii {said}" in err


def test_a_map_of_another_convention_is_doubted(run: Run) -> None:
    """Displacements that are taken for positions lead all to one corner."""
    waves = np.sin(np.indices((40, 48)) / 5.0)
    np.save("u.npy", np.moveaxis(waves, 0, -1).astype(np.float32))
    said = "is it of the convention opencv, as given? --convention says another"
    status, out, err = run("check", "u.npy", "--convention", "opencv")
    assert (status, err) == (0, "")
    assert f"              {said}" in out.splitlines()
    status, _, err = run("invert", "u.npy", "v.npy", "--convention", "opencv")
    assert status == 0
    assert "u.npy: of 1,920 pixels of the inverse, " in one_line(err)
    assert f" of its 1,833 cells: {said}" in err
    _, _, err = run("warp", "in.png", "o.png", "--field", "u.npy", "--convention", "opencv", "--inverse")
    assert "of its 1,833 cells (is its convention another?)" in err
    assert "convention" not in run("check", "flow.yml")[1]


def test_maps_between_pictures_of_another_size(run: Run) -> None:
    """A plate is straightened on a larger canvas, and bent back."""
    line = ("warp", "small.png", "o.png", "--field", "flow.yml", "--field", "flow.yml", "--inverse", "--quiet")
    assert run(*line) == (0, "", "")
    line = ("warp", "small.png", "p.png", "--field", "flow.yml", "--affine", "1,0,1,0,1,0")
    status, _, err = run(*line)
    assert status == 0
    assert "warning: flow.yml is a map of 48 x 40 pixels, and small.png has 30 x 20: beyond its edges" in err
    assert run("warp", "in.png", "q.png", "--field", "flow.yml", "--resample", "2", "--quiet") == (0, "", "")


def test_what_is_written_is_told(run: Run) -> None:
    pytest.importorskip("zarr")
    _, out, _ = run("convert", "u.nii", "v.zarr")
    assert "v.zarr: written as OME-Zarr (LPS, mm), from its suffix .zarr" in out
    assert "holds       a field of displacements, 9 x 8 x 7 voxels" in out


def test_info_tells_that_a_volume_is_a_field(run: Run) -> None:
    told = "  field       displacements in LPS, convention itk: supple check tells what it does"
    assert told in run("info", "u.nii")[1]
    assert json.loads(run("info", "u.nii", "--json")[1])["field"] == "itk"
    assert "  field " not in run("info", "head.nii")[1]
