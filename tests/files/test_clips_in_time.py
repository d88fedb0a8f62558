"""Strokes that have a time, in videos from file to file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

import supple
import supple.media.video
from supple.errors import ScaleWarning
from supple.files import warp_file
from supple.files.clips import deformation_of
from supple.files.jobs import Job
from supple.files.options import ClipOptions
from supple.files.plots import plot_file
from supple.media import image
from supple.media.base import ClipWarning
from supple.media.video import info
from tests import clips
from tests.files.clip_files import GRAB, TIMED, Run, noisy, refused, same_frames, stack


@pytest.mark.parametrize("ratio", [None, 0.4])
def test_an_event_in_a_short_clip_arrives_and_moves_sideways_only_on_request(
    here: Path, run: Run, ratio: float | None
) -> None:
    with av.open("in.mkv", "w") as out:
        stream: Any = out.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 80, "gray"
        for k in range(50):
            picture = np.full((80, 96), 40, np.uint8)
            picture[36:45, 44:53] = 200 if k == 10 else 40
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "gray")))
        out.mux(stream.encode(None))
    drag = supple.Stroke.grab((48, 40, 10), to=(48, 40, 25), radius=20, poisson=ratio)
    made = warp_file("in.mkv", "out.mkv", supple.Recipe(strokes=(drag,)))
    frames = stack("out.mkv")
    assert frames[:, 40, 48].argmax() == 25
    assert frames[25, 40, 48] > 190
    lattice = np.stack(np.meshgrid(np.arange(20, 80, 9), np.arange(20, 60, 9), np.arange(2, 48, 5)), -1).reshape(-1, 3)
    sideways = np.abs(made.deformation.forward(lattice.astype(float)) - lattice)[:, :2].max()
    assert (sideways == 0) if ratio is None else (sideways > 0.3)
    options = [] if ratio is None else ["--poisson", f"{ratio}"]
    assert run("warp", "in.mkv", "same.mkv", "--grab", "48,40,10:48,40,25", "--radius", "20", *options) == (0, "", "")
    same_frames("out.mkv", "same.mkv")


def test_time_scale_is_the_spacing_of_the_domain(here: Path) -> None:
    frames = stack(noisy("in.mkv", "yuv444p"))
    warp_file("in.mkv", "a.mkv", TIMED)
    made = warp_file("in.mkv", "b.mkv", TIMED, clip=ClipOptions(time_scale=3.0))
    d = supple.Deformation.from_recipe(TIMED, frames.shape[:3], spacing=(1.0, 1.0, 3.0), time=True)
    assert made.deformation.shape == frames.shape[:3]
    np.testing.assert_array_equal(stack("b.mkv"), d.warp(frames))
    assert (stack("a.mkv") != stack("b.mkv")).any()


def test_a_saved_recipe_holds_what_a_frame_is_worth(run: Run) -> None:
    noisy("in.mkv", "yuv444p")
    drag = ["--grab", "30,20,5:33,20,5", "--radius", "9"]
    assert run("warp", "in.mkv", "a.mkv", *drag, "--time-scale", "3", "--save-recipe", "r.json")[0] == 0
    assert supple.Recipe.from_json(Path("r.json").read_text()).time_scale == 3
    assert run("warp", "in.mkv", "b.mkv", "--recipe", "r.json")[0] == 0
    same_frames("a.mkv", "b.mkv")
    assert run("warp", "in.mkv", "c.mkv", "--recipe", "r.json", "--time-scale", "1")[0] == 0
    assert (stack("a.mkv") != stack("c.mkv")).any()
    assert run("warp", "in.mkv", "d.mkv", "--grab", "30,20:33,20", "--radius", "9", "--save-recipe", "s.json")[0] == 0
    assert supple.Recipe.from_json(Path("s.json").read_text()).time_scale is None


def test_a_recipe_scales_on_a_larger_clip_and_so_does_what_a_frame_is_worth() -> None:
    recipe = replace(TIMED, size=(64, 48, 12))
    job = Job("", "", recipe, clip=ClipOptions(time_scale=3.0))
    small = deformation_of(job, clips.closed("small.mkv", 12, (48, 64)))
    with pytest.warns(ScaleWarning, match="made for 64 x 48 x 12, and is scaled for big.mkv, which is 128 x 96 x 12"):
        big = deformation_of(job, clips.closed("big.mkv", 12, (96, 128)))
    points = np.random.default_rng(0).uniform((0, 0, 0), (64, 48, 12), (500, 3))
    scale = np.array([2.0, 2.0, 1.0])
    there = (points + 0.5) * scale - 0.5
    for moved, wanted in (
        (big.forward(there), small.forward(points)),
        (big.inverse(there).points, small.inverse(points).points),
    ):
        assert np.abs((moved + 0.5) / scale - 0.5 - wanted).max() < 0.01
        assert np.abs(wanted - points).max() > 2
    with pytest.raises(supple.SuppleError, match=r"and long\.mkv is 64 x 48 x 24: fit='stretch' scales time too"):
        deformation_of(job, clips.closed("long.mkv", 24, (48, 64)))
    slow = deformation_of(replace(job, fit="stretch"), clips.closed("long.mkv", 24, (48, 64)))
    scale = np.array([1.0, 1.0, 2.0])
    found = (slow.forward((points + 0.5) * scale - 0.5) + 0.5) / scale - 0.5
    assert np.abs(found - small.forward(points)).max() < 0.01


@pytest.mark.parametrize(("source", "target"), [("in.mkv", "out.mkv"), ("in.png", "out.png")])
def test_a_stroke_that_starts_outside_is_told(run: Run, source: str, target: str) -> None:
    noisy("in.mkv")
    image.write("in.png", np.zeros((48, 64, 3), np.uint8))
    to = ("--radius", "5", "--force")
    for at, told in (("63.4,20", False), ("64,20", True), ("20,-19", True), ("20,-0.4", False)):
        status, _, err = run("warp", source, target, "--grab", f"{at}:{at}", *to)
        assert status == 0
        assert told == ("starts outside the picture, which has 64 x 48 pixels" in err), at
        assert run("warp", source, target, "--grab", f"{at}:{at}", *to, "--quiet") == (0, "", "")
    far = ("--grab", "20,-21:20,-20", *to)
    refused(run("warp", source, target, *far), "a drag by (0, 1) at (20, -21) with radius 5 starts outside the picture")
    assert run("warp", source, target, *far, "--reach", "6", "--quiet") == (0, "", "")
    both = ("--grab", "20,20:21,20", *far)
    refused(run("warp", source, target, *both), "supple: stroke 2 of 2: a drag by (0, 1) at (20, -21)")


def turned(name: str, degrees: int) -> str:
    clips.make(name, count=12, setup=lambda stream: stream.set_display_rotation(degrees))
    return name


def test_of_a_turned_video_points_are_those_of_frames_as_stored(run: Run) -> None:
    turned("in.mp4", 90)
    said = (
        "supple: warning: in.mp4 is turned by 90° counterclockwise when it is played: points are in the frame as it "
        "is stored, 64 x 48\n"
    )
    assert run("warp", "in.mp4", "out.mp4", *GRAB) == (0, "", said)
    assert run("warp", "in.mp4", "out", *GRAB) == (0, "", said)
    assert image.read("out/00001.png").pixels.shape == (64, 48, 3)
    assert run("plot", "in.mp4", "out.png", *GRAB, "--what", "sheet") == (0, "", said)
    assert run("plot", "in.mp4", "out.png", *GRAB, "--what", "sheet", "--force", "--quiet") == (0, "", "")
    assert info("out.mp4")["rotation"] == 90
    none = ["--grab", "3,3,0:3,3,0", "--radius", "9", "--quiet"]
    assert run("warp", "in.mp4", "same.mp4", *none) == (0, "", "")
    with pytest.warns(ClipWarning, match="180°"):
        warp_file(turned("b.mp4", 180), "c.mp4", TIMED)
    with pytest.warns(ClipWarning, match="90° clockwise"):
        plot_file(Job(turned("d.mp4", -90), "d.png", TIMED), "sheet")


def walking(name: str, count: int = 8) -> list[np.ndarray]:
    """A clip of a textured square that moves by 9 pixels a frame over a still wall; and its frames."""
    rng, frames = np.random.default_rng(0), []
    wall, square = (cv2.resize(rng.integers(0, 255, (20, 30), np.uint8), (180, 120)) for _ in range(2))
    with av.open(name, "w") as out:
        stream: Any = out.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 180, 120, "gray"
        for k in range(count):
            picture = wall.copy()
            picture[30:80, 20 + 9 * k : 70 + 9 * k] = square[:50, :50]
            frames.append(picture)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "gray")))
        out.mux(stream.encode(None))
    return frames


LATER = (
    "--grab",
    "90,60,4:90,60,4.5",
    "--radius",
    "100000",
    "--time-radius",
    "100000",
    "--reach",
    "none",
    "--border",
    "none",
)


def test_what_moves_is_seen_once_and_the_report_says_how(here: Path, run: Run) -> None:
    frames = walking("in.mkv")
    for between in ("flow", "linear"):
        status, told, _ = run("warp", "in.mkv", f"{between}.mkv", *LATER, "--between", between, "--json")
        assert status == 0
        assert json.loads(told)["between"] == between
    assert run("warp", "in.mkv", "out.mkv", *LATER)[0] == 0
    same_frames("out.mkv", "flow.mkv")  # the default, where OpenCV is installed
    wanted = frames[3].astype(float)
    wanted[30:80, 47:106] = np.nan  # between the frames 3 and 4, the square covers 51.5 to 101.5
    mixed, followed = (stack(f"{between}.mkv")[4] for between in ("linear", "flow"))
    edge = np.s_[40:70, 20:44]  # where it was in frames before
    np.testing.assert_allclose(followed[edge], wanted[edge], atol=3)
    inside = frames[3][40:70, 57:87].astype(float), frames[4][40:70, 66:96].astype(float)
    assert (inside[0] == inside[1]).all()
    half = (np.roll(inside[0], 4, 1)[:, 6:] + np.roll(inside[0], 5, 1)[:, 6:]) / 2
    errors = [np.abs(each[40:70, 63:87] - half).mean() for each in (followed, mixed)]
    assert errors[0] < 0.4 * errors[1]
    flat = supple.Recipe(strokes=(supple.Stroke.grab((90, 60), by=(9, 0), radius=20),))
    assert warp_file("in.mkv", "flat.mkv", flat).between == ""
