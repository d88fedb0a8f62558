"""The commands that tell and show: info, plot, view, help."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from supple.media import image
from tests.cli.commands import GRAB, Run, done, noise, one_line


def test_info(run: Run) -> None:
    status, out, err = run("info", "in.png")
    assert (status, err) == (0, "")
    assert "48 x 40" in out
    run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json")
    status, out, err = run("info", "in.png", "r.json", "--json")
    assert (status, err) == (0, "")
    picture, recipe = map(json.loads, out.splitlines())
    assert (picture["kind"], picture["width"], picture["height"]) == ("image", 48, 40)
    assert (recipe["kind"], recipe["strokes"][0]["radius"]) == ("recipe", 12)
    status, out, err = run("info", "r.json")
    assert "a drag by (3, 2) at (20, 16) with radius 12" in out
    status, out, err = run("info", "none.png")
    assert (status, out) == (2, "")
    one_line(err)


def test_info_of_what_is_nothing_known(run: Run) -> None:
    Path("README.md").write_text("# Words")
    status, out, err = run("info", "README.md")
    assert (status, out) == (2, "")
    assert one_line(err) == (
        "supple: cannot read README.md: it is no picture, video, volume or recipe of a known kind: give one of these\n"
    )
    Path("cut.png").write_bytes(Path("in.png").read_bytes()[:60])
    assert "no picture, video" not in run("info", "cut.png")[2]


def test_a_folder(run: Run) -> None:
    Path("empty").mkdir()
    assert "the folder empty holds no pictures or DICOM slices" in one_line(run("info", "empty")[2])
    for name in ("out.nii", "out.nrrd"):
        status, _, err = run("warp", "empty", name, *GRAB)
        assert (status, "there are no DICOM images in that folder" in one_line(err)) == (2, True)
    for name in ("a.png", "b.nii", "notes.txt"):
        Path("empty", name).write_bytes(Path("in.png").read_bytes())
    assert "channels    3" in done(run("info", "empty"))
    image.write("empty/c.png", noise(9, 9))
    said = done(run("info", "empty"))
    assert "  pictures    2: a.png, c.png\n  volumes     1: b.nii\n  as a clip   no: empty/c.png is 9 x 9" in said


@pytest.fixture
def viewed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What windows are asked to show; none is opened."""
    shown: list[tuple[Any, ...]] = []

    def show(source: str, recipe: Any = None, *, options: Any) -> None:
        shown.append((source, recipe, options))

    monkeypatch.setattr("supple.viewer.window.launch.show", show)
    return shown


def test_a_clip_is_viewed_by_a_time_scale(run: Run, viewed: list[tuple[Any, ...]]) -> None:
    assert run("view", "in.mkv", "--time-scale", "2.5") == (0, "", "")
    ((source, recipe, options),) = viewed
    assert (source, recipe, options.time_scale) == ("in.mkv", None, 2.5)
    for bad in ("0", "nan", "x"):
        status, _, err = run("view", "in.mkv", "--time-scale", bad)
        assert status == 2
        assert f"--time-scale must be a number of pixels above 0, found '{bad}'" in one_line(err)
    assert len(viewed) == 1


def test_a_volume_is_viewed_as_it_is_warped(run: Run, viewed: list[tuple[Any, ...]]) -> None:
    layout = ["--shape", "6,5,4", "--dtype", "<i2", "--spacing", "1,2,3"]
    assert run("view", "in.raw", *layout) == (0, "", "")
    assert run("view", "in", "--series", "2", "--labels") == (0, "", "")
    assert run("view", "in.nii", "--grab", "1,2,3:1,2,4", "--radius", "3", "--world") == (0, "", "")
    raw, series, placed = (options for _, _, options in viewed)
    known = raw.export["volume"].layout
    assert (known.shape, known.dtype, known.spacing) == ((6, 5, 4), "<i2", (1.0, 2.0, 3.0))
    assert (series.export["volume"].series, series.export["volume"].labels) == ("2", True)
    assert placed.volume.world
    assert not placed.export["volume"].world
    for bad, text in ((["--shape", "6,5,4"], "both --shape X,Y,Z and --dtype"), (["--world"], "--world is about")):
        status, _, err = run("view", "in.raw", *bad)
        assert status == 2
        assert text in one_line(err)


def test_a_fault_of_ours_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*given: object, **options: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.delenv("SUPPLE_DEBUG", raising=False)
    monkeypatch.setattr("supple.files.jobs.Job.warp", fail)
    status, out, err = run("warp", "in.png", "out.png", *GRAB)
    assert (status, out) == (1, "")
    assert "report it" in one_line(err)
    Path("out").mkdir()
    status, out, err = run("warp", "in.png", "out", *GRAB)
    assert status == 1
    one_line(err)
    monkeypatch.setenv("SUPPLE_DEBUG", "1")
    with pytest.raises(RuntimeError):
        run("warp", "in.png", "out.png", *GRAB)


VERBS = ("warp", "plot", "render", "points", "plan", "info", "view", "invert", "check", "compose", "convert", "demo")


@pytest.mark.parametrize("width", [60, 120])
@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_fits_the_terminal(run: Run, monkeypatch: pytest.MonkeyPatch, verb: str, width: int) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    out = done(run(*verb.split(), "--help"))
    assert max(map(len, out.splitlines())) <= width


def test_help_breaks_lines_where_the_terminal_ends(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert "Pixels are counted from the top left one, which is 0,0. In a video, a third" in run("warp", "--help")[1]
    monkeypatch.setenv("COLUMNS", "80")
    assert " --twist 195,160:20 --radius 40\n" in run("warp", "--help")[1].replace(" \\\n     ", "")
