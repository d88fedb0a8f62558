"""What no clip can be, and damage, in one line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from supple.media import image
from supple.media.video import info
from tests import clips
from tests.files.clip_files import GRAB, GRAB_2D, Run, pictures, refused


def test_a_folder_of_videos_is_no_clip(run: Run) -> None:
    os.mkdir("in")
    clips.make("in/a.mp4", count=12)
    clips.make("in/b.mp4", count=12)
    for grab in (GRAB, GRAB_2D):
        assert run("warp", "in", "out", *grab, "--force", "--quiet") == (0, "", "")
        assert sorted(os.listdir("out")) == ["a.mp4", "b.mp4"]
        assert info("out/b.mp4")["frames"] == 12


def test_pictures_that_do_not_fit_are_one_line(run: Run) -> None:
    pictures("in", 5)
    os.unlink("in/003.png")
    refused(run("warp", "in/%03d.png", "out/%03d.png", *GRAB), "in/003.png is missing")
    image.write("in/003.png", np.zeros((10, 20, 3), np.uint8))
    refused(run("warp", "in/%03d.png", "out/%03d.png", *GRAB), "20 x 10")
    refused(run("warp", "in/%04d.png", "out/%03d.png", *GRAB), "no picture is named")
    refused(run("warp", "in/%03d.png", "out.mkv", *GRAB), "20 x 10")
    Path("in/003.png").write_bytes(Path("in/002.png").read_bytes()[:2000])
    refused(run("warp", "in/%03d.png", "out", *GRAB), "003.png")
    assert os.listdir() == ["in"]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".tif", ".avif"])
def test_a_picture_is_no_video(run: Run, suffix: str) -> None:
    name = f"in{suffix}"
    image.write(name, np.zeros((48, 64, 3), np.uint8))
    for target in ("out.mp4", "out.png", "out.webm"):
        status, out, err = run("warp", name, target, "--grab", "30,20,0:33,20,0", "--radius", "9")
        if suffix != ".avif" or target == "out.png":  # FFmpeg has AVIF for a video of one frame
            refused((status, out, err), "2 numbers")
    if suffix != ".avif":
        refused(run("warp", name, "out.mp4", *GRAB_2D), "frames/%05d.png")
        assert os.listdir() == [name]
    for options in (["--what", "sheet"], ["--frame", "0"], ["--what", "slice", "--x", "3"], ["--fps", "3"]):
        refused(run("plot", name, "plot.png", *GRAB_2D, *options), "no time")
    refused(run("warp", name, "bent.png", *GRAB_2D, "--time-scale", "2"), "is for clips")
    assert not Path("bent.png").exists()
