"""Image sequences from file to file, and into videos and back."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import supple
import supple.media.video
from supple.errors import GapWarning
from supple.files import warp_file
from supple.media import image
from supple.media.video import info
from tests import clips
from tests.files.clip_files import FLAT, GRAB, GRAB_2D, Array, Run, pictures, refused


def read(names: Sequence[str | Path]) -> Array:
    return np.stack([image.read(name).pixels for name in names])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pictures_into_pictures(here: Path, dtype: type, channels: int) -> None:
    frames = pictures("in", 7, "shot.{:04d}.png", dtype, channels, first=998)
    recipe = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 2), to=(33, 22, 5), radius=10),))
    made = warp_file("in/shot.%04d.png", "out/shot.%04d.png", recipe)
    assert made.target == Path("out/shot.%04d.png")
    names = [f"shot.{k:04d}.png" for k in range(998, 1005)]
    assert sorted(os.listdir("out")) == sorted(names)
    d = supple.Deformation.from_recipe(recipe, (7, 48, 64), time=True)
    expected = d.warp(frames, alpha=channels == 4)
    got = read([f"out/{name}" for name in names])
    np.testing.assert_array_equal(got.reshape(expected.shape), expected)
    assert got.dtype == dtype


def test_a_folder_is_a_clip_if_strokes_have_a_time_and_many_pictures_if_not(run: Run) -> None:
    frames = pictures("in", 6, "pic{}.png")
    grab = ["--grab", "30,20,2:33,22,4", "--radius", "10", "--border", "none"]
    assert run("warp", "in", "timed", *grab) == (0, "", "")
    assert run("warp", "in", "flat", *GRAB_2D, "--quiet") == (0, "", "")
    names = [f"pic{k}.png" for k in range(1, 7)]
    assert sorted(os.listdir("timed")) == sorted(os.listdir("flat")) == names
    recipe = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 2), to=(33, 22, 4), radius=10),))
    timed = supple.Deformation.from_recipe(recipe, (6, 48, 64), time=True).warp(frames)
    np.testing.assert_array_equal(read([f"timed/{name}" for name in names]), timed)
    d = supple.Deformation.from_recipe(FLAT, (48, 64))
    np.testing.assert_array_equal(read([f"flat/{name}" for name in names]), np.stack([d.warp(f) for f in frames]))
    refused(run("warp", "in", "timed", *grab), "exists already")
    assert run("warp", "in", "timed", *grab, "--force") == (0, "", "")


def test_pictures_into_a_video_and_back(run: Run) -> None:
    frames = pictures("in", 6)
    still = ["--grab", "3,3,0:3,3,0", "--radius", "5"]
    assert run("warp", "in/%03d.png", "a.mkv", *still, "--codec", "ffv1", "--fps", "30", "--quiet") == (0, "", "")
    facts = info("a.mkv")
    assert (facts["frames"], float(facts["rate"])) == (6, 30.0)
    assert run("warp", "a.mkv", "back/%03d.png", *still, "--quiet") == (0, "", "")
    np.testing.assert_array_equal(read(sorted(Path("back").iterdir())), frames)
    status, _, err = run("warp", "in", "b.mp4", *still)
    assert status == 0
    assert err.count("\n") == 2
    assert "moves nothing" in err
    assert "loses detail of colours (to 4:2:0): --pixel-format yuv444p keeps more" in err
    assert float(info("b.mp4")["rate"]) == 24.0
    assert info("b.mp4")["pixel_format"] == "yuv420p"


def test_sound_that_pictures_cannot_hold_is_said(run: Run) -> None:
    clips.make("in.mkv", audio="aac", subtitles=True)
    clips.make("mute.mkv")
    assert run("warp", "mute.mkv", "a/", *GRAB) == (0, "", "")
    status, _, err = run("warp", "in.mkv", "b/", *GRAB)
    assert (status, err) == (
        0,
        "supple: warning: b gets pictures alone, without the sound and the subtitles of in.mkv\n",
    )


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("f.####.png", "out/g.####.png"),
        ("f.@@@@.png", "out/g.%04d.png"),
        ("f.$F4.png", "out/g.$F4.png"),
        ("f.*.png", "out/g.*.png"),
        ("f.#.png", "out/g.####.png"),
    ],
)
def test_patterns_of_other_programs(run: Run, source: str, target: str) -> None:
    numbers = range(998, 1002) if source == "f.#.png" else range(1001, 1005)
    pictures(".", 4, "f.{}.png", first=numbers[0])
    assert run("warp", source, target, *GRAB) == (0, "", "")
    assert sorted(os.listdir("out")) == [f"g.{k:04d}.png" for k in numbers]
    status, _, err = run("warp", "f.###.png" if "*" not in source else "x.*.png", target, *GRAB)
    assert status == 2
    assert err.count("\n") == 1


def test_pictures_for_strokes_with_a_time_are_refused_once(run: Run) -> None:
    pictures(".", 3, "a{}.png")
    Path("a4x.png").write_bytes(Path("a1.png").read_bytes())
    for given in (["a1.png", "a2.png", "a3.png"], ["*.png"]):
        status, _, err = run("warp", *given, "out", *GRAB)
        assert (status, err.count("\n")) == (2, 1)
        assert f"{given[0]} stands for several pictures: give the pattern of a numbered sequence" in err


def test_gaps_of_frames_are_said_once(here: Path) -> None:
    for k in range(3):
        pixels = np.zeros((24, 32, 3), np.float32)
        if k:
            pixels[12, 16] = np.inf, np.nan, 0
        image.write(f"in{k}.tif", pixels)
    with pytest.warns(GapWarning, match="^frame 1 has NaN or infinite samples") as said:
        warp_file(
            "in%d.tif", "out%d.tif", supple.Recipe(strokes=[supple.Stroke.grab((14, 12, 1), by=(2, 0, 0), radius=4)])
        )
    assert len(said) == 1
