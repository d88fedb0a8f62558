"""What is asked of pictures and has no place there is refused by name, or told."""

from __future__ import annotations

import io
import json
import os
import shlex
import subprocess
import sys
from contextlib import redirect_stderr
from pathlib import Path

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.media import volume
from supple.media.image import read, write
from supple.space.geometry import Geometry
from tests import clips
from tests.children import SOURCE

GRAB = ("--grab", "20,20:23,20", "--radius", "6")


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    y, x = np.mgrid[:40, :60]
    write(tmp_path / "in.png", np.stack([3 * x, 4 * y, 255 - 2 * x], axis=-1).astype(np.uint8))
    return tmp_path / "in.png"


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_a_quality_that_changes_nothing_is_told(picture: Path, capsys: pytest.CaptureFixture[str], suffix: str) -> None:
    target = picture.with_name(f"out{suffix}")
    assert command(["warp", str(picture), str(target), *GRAB, "--quality", "80"]) == 0
    assert "quality 80 changes nothing in" in capsys.readouterr().err
    assert command(["warp", str(picture), str(picture.with_name("out.jpg")), *GRAB, "--quality", "80"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("channels", [3, 4])
def test_a_shape_with_colours_is_told(channels: int) -> None:
    map_ = supple.Deformation((40, 60, channels))
    hint = rf"if the last axis of \(40, 60, {channels}\) is colours, make the deformation with shape\[:2\]"
    with pytest.raises(supple.SuppleError, match=hint):
        map_.grab((20, 20), to=(23, 20), radius=6)
    with pytest.raises(supple.SuppleError, match=hint):
        map_.warp(np.zeros((40, 60)))
    with pytest.raises(supple.SuppleError) as caught:
        supple.Deformation((40, 60, 30)).grab((20, 20), to=(23, 20), radius=6)
    assert "colours" not in str(caught.value)


def test_an_option_of_images_is_refused_before_what_does_not_go_with_it() -> None:
    d, image = supple.Deformation((40, 60)), np.zeros((40, 60))
    with pytest.raises(supple.SuppleError, match=r"^between must be left out for an image"):
        d.warp(image, filter="nearest", between="linear")
    with pytest.raises(TypeError, match="unexpected keyword argument 'fliter'"):
        d.warp(image, fliter="nearest")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword argument 'between_frames'"):
        d.warp(image, between_frames="linear")  # type: ignore[call-arg]


def run(*arguments: str, given: bytes = b"") -> tuple[int, bytes, str]:
    """Run a command line in this process, with standard streams of its own."""
    read, written = (io.TextIOWrapper(io.BytesIO(held), encoding="utf-8") for held in (given, b""))
    with pytest.MonkeyPatch.context() as patch, redirect_stderr(io.StringIO()) as told:
        patch.setattr(sys, "stdin", read)
        patch.setattr(sys, "stdout", written)
        status = command(arguments)
    written.seek(0)
    return status, written.buffer.read(), told.getvalue()


def test_standard_input_and_output(picture: Path) -> None:
    true = supple.Deformation((40, 60)).grab((20, 20), to=(23, 20), radius=6).warp(read(picture).pixels)
    out = picture.with_name("out.png")
    assert run("warp", "-", str(out), *GRAB, given=picture.read_bytes()) == (0, b"", "")
    np.testing.assert_array_equal(read(out).pixels, true)
    assert run("warp", "-", str(out), *GRAB, "--force", given=picture.read_bytes()) == (0, b"", "")
    assert run("warp", str(picture), "-", *GRAB) == (0, out.read_bytes(), "")
    assert run("warp", "-", "-", *GRAB, given=picture.read_bytes()) == (0, out.read_bytes(), "")
    process = [sys.executable, "-m", "supple", "warp", "-", "-", *GRAB]
    env = {**os.environ, "PYTHONPATH": SOURCE}
    done = subprocess.run(process, input=picture.read_bytes(), capture_output=True, env=env)
    assert (done.returncode, done.stdout, done.stderr) == (0, out.read_bytes(), b"")
    assert sorted(path.name for path in picture.parent.iterdir()) == ["in.png", "out.png"]


def test_maps_of_standard_input_are_reported(picture: Path) -> None:
    out = picture.with_name("out.png")
    options = ["--affine", "1,0,2,0,1,1", "--json"]
    status, facts, told = run("warp", "-", str(out), *options, given=picture.read_bytes())
    assert (status, told.count("\n")) == (0, 1)
    assert json.loads(facts)["input"] == "-"
    assert len(json.loads(facts)["maps"]) == 1


@pytest.mark.parametrize("name", ["in.mp4", "in.nii.gz"])
def test_clips_and_volumes_through_standard_input_and_output(tmp_path: Path, name: str) -> None:
    source, wanted = tmp_path / name, tmp_path / f"wanted-{name}"
    if name == "in.mp4":
        clips.make(source)
    else:
        samples = np.random.default_rng(0).integers(0, 200, (16, 20, 24)).astype(np.uint8)
        volume.write(source, samples, volume.Volume(samples, Geometry()))
    strokes = ["--grab", "20,20:24,20" if name == "in.mp4" else "10,10,8:12,10,8", "--radius", "6"]
    assert run("warp", str(source), str(wanted), *strokes)[0] == 0
    status, out, told = run("warp", "-", "-", *strokes, given=source.read_bytes())
    assert (status, told) == (0, "")
    (streamed := tmp_path / f"streamed-{name}").write_bytes(out)
    known = [run("info", str(path), "--json") for path in (wanted, streamed)]
    facts = [{**json.loads(found[1]), "file": "", "bytes": 0} for found in known]
    assert facts[0] == facts[1]


@pytest.mark.parametrize("table", ["x;y\n20;20\n", "\ufeffx,y\n20,20\n", "name\tx\ty\nÜber\t20\t20\n"])
def test_any_table_comes_by_standard_input(picture: Path, table: str) -> None:
    status, out, told = run("points", "-", "-", "--on", str(picture), *GRAB, given=table.encode())
    assert (status, told) == (0, "")
    assert b"23" in out


@pytest.mark.parametrize("option", ["--recipe", "--save-recipe", "--save-field"])
def test_options_name_files(picture: Path, option: str) -> None:
    status, _, told = run("warp", str(picture), str(picture.with_name("out.png")), *GRAB, option, "-")
    assert status == 2
    assert told == f"supple: {option} - is not possible: - is for the files IN and OUT; name a file\n"
    assert [path.name for path in picture.parent.iterdir()] == ["in.png"]


def test_closed_streams(picture: Path) -> None:
    for arguments, closed in ((("-", "out.png"), "<&-"), (("in.png", "-"), ">&-")):
        command = shlex.join([sys.executable, "-m", "supple", "warp", *arguments, *GRAB])
        source = str(Path(supple.__file__).parent.parent)
        env = {**os.environ, "PYTHONPATH": source}
        done = subprocess.run(["sh", "-c", f"{command} {closed}"], cwd=picture.parent, env=env, capture_output=True)
        assert (done.returncode, done.stderr.count(b"\n")) == (2, 1)
        assert b"is closed: name a file" in done.stderr


def test_points_and_info_of_standard_input(picture: Path) -> None:
    status, out, told = run("points", "-", "-", "--on", str(picture), *GRAB, given=b"x,y\n20,20\n")
    assert (status, told) == (0, "")
    assert [float(x) for x in out.splitlines()[1].split(b",")] == pytest.approx([23, 20, 0], abs=1e-6)
    status, out, told = run("info", "-", "--json", given=picture.read_bytes())
    assert (status, told) == (0, "")
    assert {"file": "-", "width": 60, "height": 40}.items() <= json.loads(out).items()
    status, out, told = run("plot", "-", "x.png", *GRAB)
    assert (status, out) == (2, b"")
    assert told == "supple: - for standard input or output is for warp, info and points: give the name of a file\n"


def test_what_standard_input_and_output_cannot_be(picture: Path) -> None:
    status, out, told = run("warp", str(picture), "-", *GRAB, "--json")
    assert (status, out) == (2, b"")
    assert told == (
        "supple: --json and the picture cannot both go to standard output: leave --json out, or name a file\n"
    )
    status, out, told = run("warp", "-", "-", *GRAB, given=b"hello")
    assert (status, out) == (2, b"")
    assert told.startswith("supple: cannot read standard input: it is no image of a known kind")
    status, out, told = run("warp", "-", str(picture), "-", *GRAB, given=b"hello")
    assert (status, out) == (2, b"")
    assert "- stands for one file" in told


@pytest.mark.parametrize("fill", ["300", "-1", "20,20,256"])
def test_a_fill_value_beyond_the_picture_is_refused(
    picture: Path, capsys: pytest.CaptureFixture[str], fill: str
) -> None:
    target = picture.with_name("out.png")
    assert command(["warp", str(picture), str(target), *GRAB, "--outside", "constant", f"--fill={fill}"]) == 2
    assert "--fill must be from 0 to 255 for the uint8 of" in capsys.readouterr().err
    assert not target.exists()
