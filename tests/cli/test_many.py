"""Several pictures in one command: folders, patterns and lists."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import GRAB, Run, noise, one_line, pictures


def test_a_folder_goes_into_a_folder(run: Run) -> None:
    pictures("in")
    status, out, err = run("warp", "in", "new/out", *GRAB, "--json", "--save-recipe", "r.json")
    assert status == 2
    damaged, last = err.splitlines()
    assert "in/bad.png" in damaged
    assert last == (
        "supple: 2 of 3 files written into new/out, 1 failed: in/bad.png; folders that were not entered: in/deep "
        "(--recursive enters them)"
    )
    assert sorted(os.listdir("new/out")) == ["a.png", "b.jpg"]
    facts = {line["output"]: line for line in map(json.loads, out.splitlines())}
    assert sorted(facts) == ["new/out/a.png", "new/out/b.jpg", "new/out/bad.png"]
    assert "error" in facts["new/out/bad.png"]
    assert facts["new/out/a.png"]["within"]
    assert run("warp", "in/a.png", "alone.png", "--recipe", "r.json")[0] == 0
    assert Path("alone.png").read_bytes() == Path("new/out/a.png").read_bytes()


def test_folders_within_a_folder_and_files_that_are_there(run: Run) -> None:
    pictures("in")
    os.makedirs("in/deep/deeper")
    for name in ("in/deep/c.png", "in/deep/deeper/a.png"):
        image.write(name, noise(30, 40, 3))
    Path("in/bad.png").unlink()
    assert run("warp", "in", "in/out", *GRAB, "--recursive")[0] == 0
    made = ["a.png", "b.jpg", "deep/a.png", "deep/c.png", "deep/deeper/a.png"]
    found = sorted(str(path.relative_to("in/out")) for path in Path("in/out").rglob("*.*"))
    assert [name for name in found if Path("in/out", name).is_file()] == made
    # Again: what is there stays, byte for byte, and what is in the way is not overwritten.
    Path("in/out/a.png").write_bytes(b"mine")
    Path("in/out/deep/c.png").unlink()
    status, _, err = run("warp", "in", "in/out", *GRAB, "--recursive", "--skip-existing", "--jobs", "1")
    assert (status, err) == (0, f"supple: 1 file written into in/out, {len(made) - 1} there already\n")
    assert Path("in/out/a.png").read_bytes() == b"mine"
    status, _, err = run("warp", "in", "in/out", *GRAB, "--skip-existing")
    assert (status, err.partition(";")[0]) == (0, "supple: 0 files written into in/out, 2 there already")


def test_a_recipe_replaces_nothing_that_is_bent_or_written(run: Run) -> None:
    os.makedirs("in")
    for name in ("in/one", "in/two"):  # by their content, names without a suffix are pictures too
        image.write("a.png", noise(30, 40, 3), force=True)
        os.rename("a.png", name)
    before = Path("in/one").read_bytes()
    for words in (("in/one", "x.png"), ("in/*", "out/")):
        status, _, err = run("warp", *words, *GRAB, "--save-recipe", "in/one", "--force")
        assert (status, Path("in/one").read_bytes()) == (2, before)
        assert "--save-recipe in/one is a file that is bent" in one_line(err)
    np.zeros((9, 8, 7), np.int16).tofile("v.raw")
    voxels = ("v.raw", "o.nii", "--shape", "7,8,9", "--dtype", "int16", "--grab", "4,4,4:5,4,4", "--radius", "3")
    status, _, err = run("warp", *voxels, "--save-field", "f.h5", "--save-recipe", "f.h5", "--force")
    assert (status, Path("f.h5").exists(), Path("o.nii").exists()) == (2, False, False)


def test_what_is_no_file_in_a_folder_is_passed_over(run: Run) -> None:
    os.makedirs("in")
    image.write("in/a.png", noise(30, 40, 3))
    os.symlink("nowhere", "in/z.png")
    os.mkfifo("in/f.png")
    assert run("warp", "in", "out", *GRAB)[0] == 0
    assert os.listdir("out") == ["a.png"]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("in/a.png", "x.png", "--jobs", "2"), "--jobs is for several files"),
        (("in/a.png", "x.png", "--recursive"), "--recursive is for several files"),
        (("in/a.png", "x.png", "--skip-existing"), "--skip-existing is for several files"),
        (("in", "out", "--jobs", "0"), "--jobs must be a number of pictures from 1 on, found 0"),
        (("in", "out", "--skip-existing", "--force"), "--force replaces what --skip-existing leaves as it is"),
    ],
)
def test_options_of_several_files(run: Run, more: tuple[str, ...], says: str) -> None:
    pictures("in")
    assert says in one_line(run("warp", *more, *GRAB)[2])
    assert not os.path.exists("x.png")
    assert not os.path.exists("out")


def test_one_volume_goes_into_a_folder(run: Run) -> None:
    Path("there").mkdir()
    samples = np.arange(1000, dtype=np.int16).reshape(10, 10, 10)
    volume.write("in.nii.gz", samples, volume.Volume(samples, Geometry()))
    grab = ("--grab", "5,5,5:6,5,5", "--radius", "4")
    for folder in ("there", "new/"):
        assert run("warp", "in.nii.gz", folder, *grab)[0] == 0
        assert volume.read(f"{folder}/in.nii.gz").samples.shape == (10, 10, 10)
    status, _, err = run("warp", "in.nii.gz", "there", *grab)
    assert (status, "there/in.nii.gz exists already" in err) == (2, True)
    status, _, err = run("warp", "in.nii.gz", "out.dcm", *grab)
    assert status == 2
    assert "the suffix .dcm is for what is derived from DICOM, and the source is of another format: use .nii" in err
    assert not Path("out.dcm").exists()


@pytest.mark.parametrize("part", [("--crop", "1,1,1,20,20,3"), ("--resample", "2,2,2")])
def test_a_folder_of_stacks_is_many_volumes_on_a_grid_of_three_axes(run: Run, part: tuple[str, str]) -> None:
    tifffile = pytest.importorskip("tifffile")
    Path("in").mkdir()
    for name in "ab":
        tifffile.imwrite(
            f"in/{name}.tif", noise(40, 50, 6).transpose(2, 0, 1), photometric="minisblack", metadata={"axes": "ZYX"}
        )
    status, _, err = run("warp", "in", "out/", *part)
    assert (status, err.splitlines()[-1]) == (0, "supple: 2 files written into out/")
    assert volume.read("out/a.tif").samples.ndim == 3


def test_a_pattern_goes_into_a_folder_with_the_names_below(run: Run) -> None:
    pictures("in")
    assert run("warp", "in/**/a.png", "out", *GRAB) == (0, "", "supple: 2 files written into out\n")
    assert sorted(str(p) for p in Path("out").rglob("*.png")) == ["out/a.png", "out/deep/a.png"]
    status, _, err = run("warp", "in/*.gif", "out", *GRAB)
    assert status == 2
    assert "in/*.gif" in one_line(err)


def test_several_names_go_into_a_folder(run: Run) -> None:
    pictures("in")
    assert run("warp", "in/a.png", "in/b.jpg", "out", *GRAB, "--quiet") == (0, "", "")
    assert sorted(os.listdir("out")) == ["a.png", "b.jpg"]
    status, _, err = run("warp", "in/a.png", "in/b.jpg", "out", *GRAB)
    assert status == 2
    assert err.count("--force") == err.count("\n") - 1 == 2
    assert err.endswith("supple: 0 of 2 files written into out, 2 failed: in/a.png, in/b.jpg\n")
    status, _, err = run("warp", "in/a.png", "in/deep/a.png", "out", *GRAB)
    assert status == 2
    assert "both" in one_line(err)
    status, _, err = run("warp", "in/a.png", "in/b.jpg", "in.png", *GRAB)
    assert status == 2
    one_line(err)


@pytest.mark.parametrize("given", [["in/a.png", "in/b.jpg"], ["in/*.png"], ["in"]])
def test_several_pictures_do_not_go_into_one(run: Run, given: list[str]) -> None:
    pictures("in")
    os.remove("in/bad.png")
    for target in ("x.png", "deep/X.TIFF", "x%03d.jpg", "x.nii.gz"):
        status, _, err = run("warp", *given, target, *GRAB, "--save-recipe", "r.json")
        assert status == 2
        assert f"{target} is the name of one file, and several" in one_line(err)
        assert err.endswith("name one, such as bent/\n")
        assert sorted(os.listdir()) == ["in", "in.png"]
    # A slash says that it is a folder; and so does a folder.
    assert run("warp", *given, "x.png/", *GRAB, "--quiet") == (0, "", "")
    assert run("warp", *given, "x.png", *GRAB, "--force", "--quiet") == (0, "", "")
    assert "a.png" in os.listdir("x.png")


@pytest.mark.parametrize(
    ("name", "out"), [("in[1].png", "out[2].png"), ("photo##.png", "out.png"), ("icon@2x.png", "icon@3x.png")]
)
def test_a_name_with_signs_of_a_file_that_is_there_is_a_name(run: Run, name: str, out: str) -> None:
    os.rename("in.png", name)
    assert run("warp", name, out, *GRAB) == (0, "", "")
    assert sorted(os.listdir()) == sorted([name, out])
