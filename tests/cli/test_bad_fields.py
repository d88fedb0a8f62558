"""Bad files, grids and options of fields: one line that names them, exit status 2, and nothing left behind."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import Field, SuppleError
from supple.media import image, transforms
from tests.cli.commands import Run, noise, one_line
from tests.media.transforms.mapping import DATA

PLACE = np.diag([2.0, 2.0, 2.0, 1.0])
FAR = PLACE + np.outer([1, 1, 1, 0], [0, 0, 0, 900.0])
WAVES = np.zeros((9, 8, 7, 1, 3), np.float32)
WAVES[..., 0] = np.sin(np.arange(9) / 3)[:, None, None, None]
GREY = np.arange(504, dtype=np.float32).reshape(9, 8, 7)


def nifti(name: str, values: Any, code: int = 0, matrix: Any = PLACE, dtype: Any = np.float32) -> None:
    made = nibabel.Nifti1Image(np.asarray(values, dtype), matrix)
    made.header["intent_code"] = code
    if matrix is None:
        made.header["sform_code"] = made.header["qform_code"] = 0
    nibabel.save(made, name)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_files()
    return folder


@pytest.fixture(autouse=True)
def _files(here: Path, files: Path) -> None:
    shutil.copytree(files, here, dirs_exist_ok=True)


def write_files() -> None:
    for name, matrix in (("", PLACE), ("far-", FAR), ("nowhere-", None)):
        nifti(f"{name}head.nii", GREY, matrix=matrix)
        nifti(f"{name}u.nii", WAVES, 1007, matrix)
    nifti("code.nii", WAVES, 1002)
    nifti("complex.nii", WAVES, 1007, dtype=np.complex64)
    gapped = WAVES.copy()
    gapped[2, 3, 4] = np.nan
    nifti("nan.nii", gapped, 1007)
    nifti("mask.nii", GREY > 200, dtype=np.uint8)
    nifti("two.nii", WAVES[..., :2], 1007)
    nifti("four.nii", WAVES[..., [0, 1, 2, 0]], 1007)
    whole = Path("u.nii").read_bytes()
    Path("cut.nii").write_bytes(whole[:-9])
    nibabel.save(nibabel.load("u.nii"), "whole.nii.gz")
    Path("cut.nii.gz").write_bytes(Path("whole.nii.gz").read_bytes()[:-20])
    for name in ("empty.nii", "empty.nii.gz", "empty.npy", "empty.tfm", "photo.jpg", "clip.mp4"):
        Path(name).write_bytes(b"")
    for name in ("folder.nii", "folder"):
        Path(name).mkdir()
    places = np.moveaxis(np.indices((40, 48))[::-1], 0, -1).astype(np.float32)
    np.save("flow.npy", places + np.sin(places / 5))
    Field.from_array(np.sin(places / 5)).write("flow.yml")
    Field.from_array(np.sin(places[:20, :30] / 5)).write("tiny.yml")
    np.save("one.npy", places[..., 0])
    np.save("complex.npy", places.astype(np.complex64))
    places[3, 4] = np.nan
    np.save("nan.npy", places)
    Path("cut.npy").write_bytes(Path("flow.npy").read_bytes()[:-9])
    sitk.WriteTransform(sitk.AffineTransform(3), "a.tfm")
    spline = sitk.BSplineTransformInitializer(sitk.Image([9, 9, 9], sitk.sitkUInt8), [1, 2, 3])
    sitk.WriteTransform(spline, "b.h5")
    field = Field.read("u.nii")
    field.write("u.mha")
    transforms.write("both.h5", [np.eye(4), transforms.Displacements(field.values, field.grid)])
    colours = np.zeros((9, 8, 7), [("R", "u1"), ("G", "u1"), ("B", "u1")])
    nibabel.save(nibabel.Nifti1Image(colours, PLACE), "rgb.nii")
    image.write("small.png", noise(20, 30))
    Path("cut.exr").write_bytes((DATA / "stmap-float.exr").read_bytes()[:1500])
    image.write("old.png", noise(4, 4))


FILES: list[tuple[str, str | None, str]] = [
    ("code.nii", None, "of the intent code 1002, which several programs write: give the convention: afni"),
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
    ("nan.npy", "opencv", "1 of its 1920 positions are NaN or infinite: fill them first"),
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
    ("folder", None, "a name without suffix tells no convention: give the convention"),
    ("flow.npy", None, "its numbers may be positions, as of OpenCV's maps, or displacements: give "),
    ("gone.jpg", None, "No such file or directory"),
    ("in.png", None, "it may be an STMap, or any other picture: give "),
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
    with pytest.raises(SuppleError) as caught:
        Field.read(name, convention, source=Field.read("u.nii").grid if source else None)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


APART = "do not overlap: from ("
LINES: list[tuple[str, str]] = [
    # grids that lie apart
    ("warp head.nii o.nii --field far-u.nii", f"far-u.nii and head.nii {APART}-917, "),
    ("warp head.nii o.nii --field far-u.nii --inverse", f"far-u.nii and head.nii {APART}"),
    ("warp head.nii o.nii --field u.nii --reference far-head.nii", f"u.nii and far-head.nii {APART}"),
    ("warp head.nii o.nii --field far-u.nii --reference far-head.nii", f"what far-u.nii leads to and head.nii {APART}"),
    ("invert u.nii v.mha --reference far-head.nii", f"u.nii and far-head.nii {APART}"),
    ("compose u.nii far-u.nii --out v.mha", f"far-u.nii and what u.nii leads to {APART}"),
    ("compose u.nii --out v.mha --reference far-head.nii", f"u.nii and the grid of the result {APART}"),
    ("convert u.nii v.mha --reference far-head.nii", f"u.nii and the grid of the result {APART}"),
    # of another number of axes
    ("warp head.nii o.nii --field flow.yml", "flow.yml is for pictures, with 2 axes, and head.nii is a volume"),
    ("warp in.png o.png --field u.nii", "u.nii is for volumes, with 3 axes, and in.png is a picture"),
    ("invert u.nii v.mha --reference in.png", "in.png is a picture, and u.nii is for volumes: give the grid of a vol"),
    ("invert flow.yml v.npy --reference head.nii", "head.nii is a volume, and flow.yml is for pictures"),
    ("convert u.nii v.mha --reference in.png", "in.png is a picture, and u.nii is for volumes"),
    ("compose u.nii --reference in.png --out v.mha", "in.png is a picture, and u.nii is for volumes"),
    ("compose flow.yml u.nii --out v.mha", "u.nii has 3 axes, and the grid has 2"),
    ("compose a.tfm flow.yml --out v.mha", "a.tfm has 3 axes, and the grid has 2"),
    ("check u.nii flow.yml", "u.nii is a field of 3 axes, and flow.yml of 2: give two of as many"),
    ("convert flow.yml v.mha", "it takes maps of volumes, found one of 2 coordinates"),
    ("convert u.nii v.npy", "it takes maps of pictures, found one of 3 coordinates"),
    # outputs that are inputs
    ("check u.nii --map u.nii --force", "u.nii is read: --force does not replace it, so choose another name"),
    ("invert u.nii v.mha --error u.nii --force", "u.nii is read: --force does not replace it"),
    # references
    ("warp head.nii o.nii --field u.nii --reference a.tfm", "a.tfm is no volume, and the grid of a volume is needed"),
    ("warp head.nii o.nii --field u.nii --reference folder", "folder is no volume, and the grid of a volume is need"),
    ("warp head.nii o.nii --field u.nii --reference empty.nii", "cannot read empty.nii: it is empty"),
    ("warp head.nii o.nii --field u.nii --reference gone.nii", "cannot read gone.nii: No such file"),
    ("warp in.png o.png --field flow.yml --reference flow.yml", "cannot read flow.yml: it is no image"),
    ("invert u.nii v.mha --reference a.tfm", "cannot read a.tfm: it is no image"),
    ("invert u.nii v.mha --reference nowhere-head.nii", "nowhere-head.nii does not say where its voxels lie in spa"),
    ("invert u.nii v.mha --source empty.nii", "cannot read empty.nii: it is empty"),
    # options
    ("warp in.png o.png --inverse --field flow.yml", "--inverse is for the --field or --affine before it"),
    ("compose --inverse u.nii --out v.mha", "--inverse is about the file before it, and there is none"),
    ("warp in.png o.png --field flow.yml --crop 40,0,9,9", "--crop must be within the grid of 48 x 40 samples"),
    (
        "warp head.nii o.nii --field u.nii --resample 1e-4",
        "resample to 0.0001 makes a volume of 180,000 x 160,000 x 140,000 voxels, too many: ",
    ),
    ("warp head.nii o.nii --field u.nii --crop 0,0,5,5", "--crop must be 6 numbers, as the input is a volume"),
    ("warp in.png o.png --field flow.yml --resample 0", "--resample must be a spacing above 0"),
    ("warp in.png o.png --field flow.yml --resample 1,2,3", "--resample must be one number or 2 of them"),
    ("warp in.png o.png --field flow.yml --resample 1e-9", "resample to 1e-09 makes no picture"),
    ("warp in.png o.png --field flow.yml --affine 1,0,x,0,1,0", "--affine must be 6 numbers (pictures) or 12"),
    ("warp in.png o.png", "nothing to do: give --grab X,Y:X,Y --radius R, --field FILE, --affine FILE, --crop BOX, "),
    ("warp in.png o.png --inverse", "--inverse is for the --field or --affine before it, and there is none"),
    ("check u.nii --convention mrtrix", "its intent code is 1007"),
    ("check u.mha --convention fsl-relative --source head.nii", "no NIfTI file, and those of the convention fsl-rel"),
    ("check rgb.nii", "its voxels are colours (RGB)"),
    ("check a.tfm", "and not one field: supple compose makes one, on the grid of an image (--reference)"),
    ("check cut.exr", "cannot read cut.exr: it is damaged, cut short or of a kind that is not supported"),
    ("compose u.nii", "give --out FILE"),
    # maps of another size than the picture that they are for
    ("warp small.png o.png --field flow.yml", "flow.yml is a map of 48 x 40 pixels, and small.png, on whose pixels"),
    (
        "warp small.png o.png --field flow.yml --crop 0,0,5,5",
        "and small.png, on whose pixels the result is written, has",
    ),
    (
        "warp in.png o.png --field flow.yml --reference small.png",
        "and small.png, on whose pixels the result is written",
    ),
    ("warp small.png o.png --field flow.yml --inverse", "and small.png, which it is applied to, has 30 x 20"),
    (
        "warp in.png o.png --field flow.yml --field tiny.yml --inverse",
        "and tiny.yml, which takes what it makes, of 30 x",
    ),
    # places
    ("invert u.nii far-u.nii", "far-u.nii exists already: choose another name, or --force"),
    ("invert u.nii v.mha --status head.nii", "head.nii exists already: choose another name, or --force"),
    ("invert u.nii v.mha --report folder --force", "cannot write folder: it is a folder"),
    ("invert u.nii none/v.mha", "cannot write none/v.mha: there is no folder"),
    ("invert u.nii v.mha --error v.mha", "v.mha is to be written twice"),
    (
        "invert b.h5 v.mha",
        "its grid of 4 x 5 x 6 control points is too coarse for an inverse: give the image whose grid",
    ),
    ("invert u.nii v.mha --to spm", "--to must be one of itk, "),
    ("convert u.nii v.mha --to spm", "--to must be one of itk, "),
    ("compose u.nii --to spm --out v.mha", "--to must be one of itk, "),
    ("invert u.nii v.mha --status s.txt", "--status must be the name of an image: cannot write s.txt: the suffix .txt"),
    ("invert u.nii v.mha --error s.png", "--error must be the name of an image: cannot write s.png: the suffix .png"),
    ("check u.nii --map s.png", "--map must be the name of an image: cannot write s.png: the suffix .png"),
    ("convert u.nii v.txt", "a .txt file holds one affine map, and u.nii a field: use .nii.gz, .nrrd, .mha or .h5"),
    (
        "convert both.h5 v.nii.gz",
        "both.h5 holds an affine map and a field, and v.nii.gz one field: give the image whose",
    ),
    ("invert u.nii v.xyz", "cannot write v.xyz: the suffix .xyz is of no transform of ITK: use .nii, "),
    ("invert u.nii v", "cannot write v: a name without suffix is of no transform of ITK: use .nii, "),
    ("check u.nii --map head.nii", "head.nii exists already: choose another name, or --force"),
    ("check u.nii --picture old.png", "old.png exists already: choose another name, or --force"),
    ("compose u.nii --out none/v.mha", "cannot write none/v.mha: there is no folder"),
    ("compose u.nii --out head.nii", "head.nii exists already: choose another name, or --force"),
    ("convert u.nii head.nii --to itk", "head.nii exists already: choose another name, or --force"),
    ("warp head.nii far-head.nii --field u.nii", "far-head.nii exists already: choose another name, or --force"),
    # affine maps
    ("invert a.tfm v.mha", "cannot write v.mha: a .mha file of ITK holds one field, interpolated linearly: use .h5"),
    ("check u.nii a.tfm", "a.tfm holds an affine map, and not one field"),
    ("check u.nii mask.nii", "cannot read mask.nii: it holds one value for each voxel"),
]


@pytest.mark.parametrize(("line", "said"), LINES)
def test_what_does_not_fit_together(run: Run, line: str, said: str) -> None:
    before = {name: os.path.getmtime(name) for name in sorted(os.listdir())}
    status, out, err = run(*line.split())
    assert (status, out) == (2, ""), err
    assert said in one_line(err)
    assert {name: os.path.getmtime(name) for name in sorted(os.listdir())} == before


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


def test_a_field_that_folds_is_named(run: Run) -> None:
    values = np.zeros((40, 48, 2), np.float32)
    values[..., 0] = 6 * np.sin(np.arange(48) / 2)
    Field.from_array(values).write("folds.yml")
    line = ("warp", "in.png", "o.png", "--field", "folds.yml", "--grab", "20,16:23,18", "--radius", "12")
    status, _, err = run(*line)
    assert status == 0
    assert "warning: folds.yml folds: " in err


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
