"""Clips from file to file: videos and image sequences through the library and the command line."""

from __future__ import annotations

import json
import os
import pty
import resource
import select
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import clips
import numpy as np
import numpy.typing as npt
import pytest
from children import HEARING

import supple
import supple.media.video
from supple.cli import command
from supple.clips import ClipOptions, WarpedClip, deformation_of
from supple.errors import ScaleWarning
from supple.files import warp_file
from supple.media import image
from supple.media.base import ClipWarning, CountError
from supple.media.video import info
from supple.media.video import open_clip as open_video
from supple.plot.files import plot_file

SOURCE = str(Path(__file__).resolve().parent.parent / "src")
TIMED = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 3), to=(33, 22, 8), radius=10),))
FLAT = supple.Recipe(border=10, strokes=(supple.Stroke.grab((30, 20), to=(34, 23), radius=12),))
GRAB = ("--grab", "30,20,3:33,22,8", "--radius", "10", "--border", "none")
GRAB_2D = ("--grab", "30,20:34,23", "--radius", "12", "--border", "10")
LOSSLESS = ClipOptions(codec="ffv1")
Array = npt.NDArray[Any]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        status = command(arguments)
        out, err = capsys.readouterr()
        return status, out, err

    return run


def noisy(name: str, pixel_format: str = "yuv444p", count: int = 12, **options: Any) -> str:
    clips.make(name, "ffv1", pixel_format, count=count, smooth=False, **options)
    return name


def pictures(
    folder: str, count: int = 6, names: str = "{:03d}.png", dtype: type = np.uint8, channels: int = 3, first: int = 1
) -> Array:
    """Write numbered pictures of noise; return their pixels."""
    os.makedirs(folder, exist_ok=True)
    top = np.iinfo(dtype).max + 1
    frames = np.random.default_rng(count).integers(0, top, (count, 48, 64, channels), dtype=dtype)
    for k, frame in enumerate(frames):
        image.write(f"{folder}/{names.format(k + first)}", frame)
    return frames


def stack(path: str) -> Array:
    """All frames of a clip whose planes are alike, as (T, H, W) or (T, H, W, planes)."""
    frames = []
    for frame in clips.decoded(path):
        wide = frame.format.components[0].bits > 8
        planes = [np.frombuffer(row, "<u2" if wide else np.uint8) for row in clips.rows(frame)]
        frames.append(np.stack([plane.reshape(frame.height, frame.width) for plane in planes], axis=-1))
    found = np.stack(frames)
    return found[..., 0].copy() if found.shape[-1] == 1 else found


def read(names: Sequence[str | Path]) -> Array:
    return np.stack([image.read(name).pixels for name in names])


def refused(said: tuple[int, str, str], wanted: str) -> None:
    status, out, err = said
    assert (status, out) == (2, ""), err
    assert err.startswith("supple: ")
    assert err.count("\n") == 1
    assert "fault" not in err
    assert wanted in err


def same_frames(one: str, two: str) -> None:
    a, b = clips.decoded(one), clips.decoded(two)
    assert len(a) == len(b)
    for left, right in zip(a, b, strict=True):
        assert left.format.name == right.format.name
        assert clips.rows(left) == clips.rows(right)


# What is written.


@pytest.mark.parametrize("pixel_format", ["gray", "yuv444p", "yuv444p10le", "gbrp10le"])
@pytest.mark.parametrize("recipe", [TIMED, FLAT])
def test_a_file_is_what_warp_makes(here: Path, pixel_format: str, recipe: supple.Recipe) -> None:
    if pixel_format == "gray":
        frames = pictures("in", channels=1, count=12)
        frames = frames[..., 0]
        made = warp_file("in/%03d.png", "out.mkv", recipe, clip=LOSSLESS)
    else:
        frames = stack(noisy("in.mkv", pixel_format))
        made = warp_file("in.mkv", "out.mkv", recipe)
    assert isinstance(made, WarpedClip)
    assert made.frames == len(frames) == 12
    assert 0 < made.error <= made.tolerance == 0.01
    timed = recipe is TIMED
    d = supple.Deformation.from_recipe(recipe, frames.shape[:3] if timed else frames.shape[1:3])
    wide = pixel_format.endswith("10le")
    expected = d.warp(frames) if timed else np.stack([d.warp(frame) for frame in frames])
    got = stack("out.mkv")
    assert (expected != frames).any()
    if wide:  # where cubics overshoot, they are cut off at 1023, not at 65535
        assert got.max() <= 1023
        expected = np.minimum(expected, 1023)
    np.testing.assert_array_equal(got, expected)


def test_luma_is_bent_as_a_plane_of_its_own(here: Path) -> None:
    luma = np.stack([f.to_ndarray()[:48] for f in clips.decoded(noisy("in.mkv", "yuv420p"))])
    warp_file("in.mkv", "out.mkv", TIMED)
    after = np.stack([f.to_ndarray()[:48] for f in clips.decoded("out.mkv")])
    d = supple.Deformation.from_recipe(TIMED, luma.shape)
    np.testing.assert_array_equal(after, d.warp(luma))


@pytest.mark.parametrize(
    "pixel_format",
    ["yuv420p", "yuv422p10le", "yuv444p12le", "gray", "gray16le", "gbrp12le", "bgr0", "yuva420p"],
)
@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
def test_without_force_no_bit_changes(here: Path, pixel_format: str, size: tuple[int, int]) -> None:
    noisy("in.mkv", pixel_format, 5, size=size)
    still = supple.Recipe(strokes=(supple.Stroke.grab((3, 3, 2), by=(0, 0, 0), radius=10),))
    warp_file("in.mkv", "out.mkv", still, lossless=True)  # encoded anew
    assert Path("out.mkv").read_bytes() != b""
    same_frames("in.mkv", "out.mkv")
    assert clips.when("in.mkv") == clips.when("out.mkv")


def test_where_nothing_moves_frames_are_passed_on(here: Path) -> None:
    noisy("in.mkv", "yuv420p", 40)
    fixed = supple.Recipe(border=5, strokes=(supple.Stroke.grab((30, 20, 3), by=(0.5, 0.5, 0.5), radius=2, scales=3),))
    made = warp_file("in.mkv", "out.mkv", fixed, tolerance=0.05)
    assert isinstance(made, WarpedClip)
    assert 0 < made.still < 40
    before, after = clips.decoded("in.mkv"), clips.decoded("out.mkv")
    same = [clips.rows(a) == clips.rows(b) for a, b in zip(before, after, strict=True)]
    assert sum(same) >= made.still
    assert not all(same)


def test_a_stroke_in_the_middle_leaves_the_frames_out_of_its_reach_alone(here: Path) -> None:
    noisy("in.mkv", "yuv420p", 120)
    stroke = supple.Stroke.grab((30, 20, 60), to=(33, 22, 64), radius=5)
    made = warp_file("in.mkv", "out.mkv", supple.Recipe(strokes=(stroke,)))
    assert isinstance(made, WarpedClip)
    before, after = clips.decoded("in.mkv"), clips.decoded("out.mkv")
    same = [clips.rows(a) == clips.rows(b) for a, b in zip(before, after, strict=True)]
    reach = 4 * 5  # radii, of as many frames
    assert all(same[: 60 - reach])
    assert all(same[64 + reach + 1 :])
    assert not any(same[55:70])
    assert made.still >= 120 - (2 * reach + 4 + 1)


@pytest.mark.parametrize("suffix", [".png", ".apng"])
def test_an_animated_png_is_a_clip_if_strokes_have_a_time(here: Path, run: Run, suffix: str) -> None:
    clips.make("in.apng", "apng", "rgb24", count=8)
    os.rename("in.apng", f"moving{suffix}")
    assert run("warp", f"moving{suffix}", "bent/%03d.png", "--grab", "30,20,3:33,22,5", "--radius", "3")[0] == 0
    assert len(os.listdir("bent")) == 8
    image.write("still.png", np.zeros((48, 64, 3), np.uint8))
    refused(run("warp", "still.png", "other.png", "--grab", "30,20,3:33,22,5", "--radius", "3"), "")


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
    assert isinstance(made, WarpedClip)
    frames = stack("out.mkv")
    assert frames[:, 40, 48].argmax() == 25
    assert frames[25, 40, 48] > 190
    lattice = np.stack(np.meshgrid(np.arange(20, 80, 9), np.arange(20, 60, 9), np.arange(2, 48, 5)), -1).reshape(-1, 3)
    sideways = np.abs(made.deformation.forward(lattice.astype(float)) - lattice)[:, :2].max()
    assert (sideways == 0) if ratio is None else (sideways > 0.3)
    options = [] if ratio is None else ["--poisson", f"{ratio}"]
    assert run("warp", "in.mkv", "same.mkv", "--grab", "48,40,10:48,40,25", "--radius", "20", *options) == (0, "", "")
    same_frames("out.mkv", "same.mkv")


@pytest.mark.parametrize(
    ("codec", "pixel_format", "suffix", "options"),
    [
        ("ffv1", "yuv420p", "mkv", {"g": "1"}),
        ("ffv1", "yuv444p10le", "avi", {"g": "1", "level": "3"}),
        ("prores_ks", "yuv422p10le", "mov", {}),
        ("prores_ks", "yuv422p10le", "mkv", {"profile": "lt"}),
        ("mjpeg", "yuvj420p", "avi", {}),
        ("mjpeg", "yuvj422p", "mov", {}),
    ],
)
def test_packets_of_still_frames_are_copied(
    here: Path, codec: str, pixel_format: str, suffix: str, options: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = None if suffix == "avi" else [k + (k > 3) * 2 for k in range(60)]
    source = clips.make(
        f"in.{suffix}", codec, pixel_format, count=60, smooth=False, options=options, times=times, audio="pcm_s16le"
    )
    local = supple.Recipe(strokes=(supple.Stroke.grab((30, 20, 30), to=(33, 22, 32), radius=3),))
    made = warp_file(source, f"out.{suffix}", local)
    assert isinstance(made, WarpedClip)
    assert made.copied == made.still >= 30
    before, after = (clips.parcels(f"{name}.{suffix}", "video") for name in ("in", "out"))
    assert [when for _, *when in before] == [when for _, *when in after]
    copies = [a == b for (a, *_), (b, *_) in zip(before, after, strict=True)]
    assert copies[:17] == [True] * 17
    assert copies[46:] == [True] * 14
    assert not any(copies[28:34])
    # What is encoded is what it is without copies, and of the still frames of FFV1 all are.
    monkeypatch.setattr("supple.media.video.encode.Sink._may_copy", lambda self: False)
    anew = warp_file(source, f"anew.{suffix}", local)
    assert isinstance(anew, WarpedClip)
    assert (anew.copied, anew.still) == (0, made.still)
    frames, others = clips.decoded(f"out.{suffix}"), clips.decoded(f"anew.{suffix}")
    assert len(frames) == len(others) == 60
    for k, (one, other) in enumerate(zip(frames, others, strict=True)):
        if codec == "ffv1" or not copies[k]:
            assert clips.rows(one) == clips.rows(other)


@pytest.mark.parametrize(
    ("codec", "target", "options"),
    [
        ("ffv1", "out.mkv", ClipOptions()),  # its key frames are 12 apart, as the header says
        ("mjpeg", "out.mkv", ClipOptions(codec="ffv1")),
        ("mjpeg", "out.avi", ClipOptions(pixel_format="yuvj444p")),
        ("libx264", "out.mkv", ClipOptions()),
    ],
)
def test_packets_that_do_not_fit_are_not_copied(here: Path, codec: str, target: str, options: ClipOptions) -> None:
    form = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    source = clips.make("in.mkv", codec, form, count=60, options={"g": "12"})
    local = supple.Recipe(strokes=(supple.Stroke.grab((30, 20, 30), to=(33, 22, 32), radius=3),))
    made = warp_file(source, target, local, clip=options)
    assert isinstance(made, WarpedClip)
    assert made.still > 0 == made.copied
    assert len(clips.decoded(target)) == 60


def test_sound_times_and_frames_come_through(here: Path) -> None:
    times = [0, 40, 90, 120, 200, 210, 260, 300, 333, 360, 400, 450]
    clips.make("in.mp4", count=12, audio="aac", times=times, base=Fraction(1, 1000))
    made = warp_file("in.mp4", "out.mp4", TIMED)
    assert isinstance(made, WarpedClip)
    assert made.frames == len(clips.decoded("out.mp4")) == 12
    assert clips.when("in.mp4") == clips.when("out.mp4")
    assert clips.parcels("in.mp4", "audio") == clips.parcels("out.mp4", "audio")
    assert info("out.mp4")["codec"] == "h264"


@pytest.mark.parametrize("name", ["out.mp4", "out.mov", "out.mkv", "out.webm", "out.avi", "out.gif", "OUT.MP4"])
def test_every_container(here: Path, name: str) -> None:
    clips.make("in.mp4", count=5)
    strokes = (supple.Stroke.grab((30, 20, 1), to=(33, 22, 3), radius=10),)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClipWarning)
        warp_file("in.mp4", name, supple.Recipe(border=None, strokes=strokes))
    facts = info(name)
    assert (facts["frames"], facts["width"], facts["height"]) == (5, 64, 48)


def test_a_gif_stays_a_gif(here: Path, run: Run) -> None:
    clips.make("in.gif", "gif", "rgb8", count=6, rate=25)
    for k, grab in enumerate((("--grab", "30,20,1:33,22,4"), ("--grab", "30,20:33,22"))):
        assert run("warp", "in.gif", f"out{k}.gif", *grab, "--radius", "10", "--border", "none") == (0, "", "")
        assert info(f"out{k}.gif")["frames"] == 6
        assert clips.when("in.gif") == clips.when(f"out{k}.gif")
    assert Path("out0.gif").read_bytes() != Path("in.gif").read_bytes()
    assert run("warp", "in.gif", "f%02d.png", *GRAB_2D) == (0, "", "")
    assert len(list(Path().glob("f*.png"))) == 6


def test_lossless_is_ffv1(run: Run) -> None:
    clips.make("in.mp4", count=4)
    assert run("warp", "in.mp4", "out.mkv", *GRAB_2D, "--lossless") == (0, "", "")
    assert info("out.mkv")["codec"] == "ffv1"
    frames = np.stack([f.to_ndarray()[:48] for f in clips.decoded("in.mp4")])
    d = supple.Deformation.from_recipe(FLAT, (48, 64))
    got = np.stack([f.to_ndarray()[:48] for f in clips.decoded("out.mkv")])
    np.testing.assert_array_equal(got, np.stack([d.warp(frame) for frame in frames]))


def test_options_reach_the_sampler_and_the_encoder(run: Run) -> None:
    frames = stack(noisy("in.mkv", "yuv444p", 9))
    luma = 0.299 * 200 + 0.587 * 30 + 0.114 * 60  # of BT.601
    chroma = [128 + 224 / 255 * (60 - luma) / 1.772, 128 + 224 / 255 * (200 - luma) / 1.402]
    fill = [16 + 219 / 255 * luma, *chroma]
    options = ["--filter", "linear", "--outside", "constant", "--fill", "200,30,60", "--tolerance", "0.1", "--between"]
    more = ["--time-scale", "2", "--time-filter"]
    strokes = ["--grab", "5,20,3:30,22,6", "--radius", "15", "--border", "none", "--quiet"]
    assert run("warp", "in.mkv", "out.mkv", *strokes, *options, "cubic", *more) == (0, "", "")
    d = supple.Deformation(frames.shape[:3], border=None, spacing=(1, 1, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", supple.FoldWarning)
        d = d.grab((5, 20, 3), to=(30, 22, 6), radius=15)
    settings: dict[str, Any] = {"filter": "linear", "outside": "constant", "fill": fill, "tolerance": 0.1}
    expected = d.warp(frames, **settings, between="cubic", time_filter=True)
    np.testing.assert_array_equal(stack("out.mkv"), expected)
    plain = supple.Deformation(frames.shape[:3], border=None)
    assert (d.forward((5.0, 20.0, 4.0)) != plain.forward((5.0, 20.0, 4.0))).any()
    encoder = ["--codec", "libx265", "--crf", "30", "--preset", "ultrafast", "--pixel-format", "yuv420p10le"]
    status, _, err = run("warp", "in.mkv", "out.mp4", *GRAB, *encoder)
    assert status == 0
    assert "loses detail of colours" in err
    facts = info("out.mp4")
    assert (facts["codec"], facts["pixel_format"]) == ("hevc", "yuv420p10le")


def test_time_scale_is_the_spacing_of_the_domain(here: Path) -> None:
    frames = stack(noisy("in.mkv", "yuv444p"))
    warp_file("in.mkv", "a.mkv", TIMED)
    made = warp_file("in.mkv", "b.mkv", TIMED, clip=ClipOptions(time_scale=3.0))
    d = supple.Deformation.from_recipe(TIMED, frames.shape[:3], spacing=(1.0, 1.0, 3.0))
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
    small = deformation_of(recipe, 12, (48, 64), 3.0, "small.mkv")
    with pytest.warns(ScaleWarning, match="made for 64 x 48 x 12, and is scaled for big.mkv, which is 128 x 96 x 12"):
        big = deformation_of(recipe, 12, (96, 128), 3.0, "big.mkv")
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
        deformation_of(recipe, 24, (48, 64), 3.0, "long.mkv")
    slow = deformation_of(recipe, 24, (48, 64), 3.0, "long.mkv", "stretch")
    scale = np.array([1.0, 1.0, 2.0])
    found = (slow.forward((points + 0.5) * scale - 0.5) + 0.5) / scale - 0.5
    assert np.abs(found - small.forward(points)).max() < 0.01


def test_a_window_on_disk_gives_the_same(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy("in.mkv", "yuv420p")
    Path("tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(here / "tmp"))
    used: list[int] = []
    from supple import spill

    reserve = spill.reserve
    monkeypatch.setattr(spill, "reserve", lambda file, size: (used.append(size), reserve(file, size)))
    warp_file("in.mkv", "a.mkv", TIMED)
    assert used == []
    made = warp_file("in.mkv", "b.mkv", TIMED, clip=ClipOptions(memory=0))
    assert isinstance(made, WarpedClip)
    assert used == [made.held * 64 * 48 * 3 // 2]
    same_frames("a.mkv", "b.mkv")
    assert os.listdir("tmp") == []


def test_where_nothing_is_asked_the_file_is_copied(run: Run) -> None:
    clips.make("in.mp4", count=4, audio="aac")
    none = ["--grab", "30,20,1:30,20,1", "--radius", "10"]
    assert run("warp", "in.mp4", "out.mp4", *none) == (0, "", "")
    assert Path("out.mp4").read_bytes() == Path("in.mp4").read_bytes()
    assert run("warp", "in.mp4", "crf.mp4", *none, "--crf", "40") == (0, "", "")
    assert Path("crf.mp4").read_bytes() != Path("in.mp4").read_bytes()
    refused(run("warp", "in.mp4", "out.mp4", *none), "--force")
    refused(run("warp", "in.mp4", "q.mp4", *none, "--quality", "50"), "crf")


def test_a_clip_may_replace_itself_with_force_alone(run: Run) -> None:
    clips.make("in.mp4", count=12, audio="aac")
    kept = Path("in.mp4").read_bytes()
    os.symlink("in.mp4", "link.mp4")
    for name in ("in.mp4", "./in.mp4", "link.mp4"):
        refused(run("warp", "in.mp4", name, *GRAB), "--force")
    assert Path("in.mp4").read_bytes() == kept
    assert run("warp", "in.mp4", "link.mp4", *GRAB, "--force") == (0, "", "")
    assert Path("link.mp4").is_symlink()
    assert Path("in.mp4").read_bytes() != kept
    assert info("in.mp4")["frames"] == 12
    assert sorted(os.listdir()) == ["in.mp4", "link.mp4"]


def test_one_frame(here: Path) -> None:
    frames = stack(noisy("in.mkv", "yuv444p", 1))
    recipe = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 0), to=(34, 23, 0), radius=12),))
    warp_file("in.mkv", "out.mkv", recipe)
    np.testing.assert_array_equal(
        stack("out.mkv"), supple.Deformation.from_recipe(recipe, frames.shape[:3]).warp(frames)
    )
    warp_file("in.mkv", "f%d.png", recipe)
    assert image.read("f1.png").pixels.shape == (48, 64, 3)


def test_the_library_tells_how_far_it_is_and_may_be_stopped(here: Path) -> None:
    noisy("in.mkv", "yuv420p")
    steps: list[str] = []
    warp_file("in.mkv", "out.mkv", TIMED, progress=steps.append)
    assert steps[0] == "write"
    assert steps.count("warp") == 12
    assert set(steps) == {"write", "plan", "warp"}

    def stop(step: str) -> None:
        if step == "warp":
            raise KeyboardInterrupt

    for target in ("b.mkv", "b%d.png", "b"):
        with pytest.raises(KeyboardInterrupt):
            warp_file("in.mkv", target, TIMED, progress=stop)
    assert sorted(os.listdir()) == ["in.mkv", "out.mkv"]


# Image sequences.


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pictures_into_pictures(here: Path, dtype: type, channels: int) -> None:
    frames = pictures("in", 7, "shot.{:04d}.png", dtype, channels, first=998)
    recipe = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 2), to=(33, 22, 5), radius=10),))
    made = warp_file("in/shot.%04d.png", "out/shot.%04d.png", recipe)
    assert made.target == Path("out/shot.%04d.png")
    names = [f"shot.{k:04d}.png" for k in range(998, 1005)]
    assert sorted(os.listdir("out")) == sorted(names)
    d = supple.Deformation.from_recipe(recipe, (7, 48, 64))
    expected = d.warp(frames, alpha=channels == 4)
    got = read([f"out/{name}" for name in names])
    np.testing.assert_array_equal(got.reshape(expected.shape), expected)
    assert got.dtype == dtype


def test_a_folder_is_a_clip_if_strokes_have_a_time_and_many_pictures_if_not(run: Run) -> None:
    frames = pictures("in", 6, "pic{}.png")
    grab = ["--grab", "30,20,2:33,22,4", "--radius", "10", "--border", "none"]
    assert run("warp", "in", "timed", *grab) == (0, "", "")
    assert run("warp", "in", "flat", *GRAB_2D) == (0, "", "")
    names = [f"pic{k}.png" for k in range(1, 7)]
    assert sorted(os.listdir("timed")) == sorted(os.listdir("flat")) == names
    recipe = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 2), to=(33, 22, 4), radius=10),))
    timed = supple.Deformation.from_recipe(recipe, (6, 48, 64)).warp(frames)
    np.testing.assert_array_equal(read([f"timed/{name}" for name in names]), timed)
    d = supple.Deformation.from_recipe(FLAT, (48, 64))
    np.testing.assert_array_equal(read([f"flat/{name}" for name in names]), np.stack([d.warp(f) for f in frames]))
    refused(run("warp", "in", "timed", *grab), "exists already")
    assert run("warp", "in", "timed", *grab, "--force") == (0, "", "")


def test_pictures_into_a_video_and_back(run: Run) -> None:
    frames = pictures("in", 6)
    still = ["--grab", "3,3,0:3,3,0", "--radius", "5"]
    assert run("warp", "in/%03d.png", "a.mkv", *still, "--codec", "ffv1", "--fps", "30") == (0, "", "")
    facts = info("a.mkv")
    assert (facts["frames"], float(facts["rate"])) == (6, 30.0)
    assert run("warp", "a.mkv", "back/%03d.png", *still) == (0, "", "")
    np.testing.assert_array_equal(read(sorted(Path("back").iterdir())), frames)
    status, _, err = run("warp", "in", "b.mp4", *still)
    assert status == 0
    assert err.count("\n") == 1
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


def test_a_rate_may_be_a_ratio(run: Run) -> None:
    pictures("in")
    assert run("warp", "in", "a.mkv", *GRAB, "--codec", "ffv1", "--fps", "24000/1001") == (0, "", "")
    assert info("a.mkv")["rate"] == Fraction(24000, 1001)


@pytest.mark.parametrize("name", ["yuv420p", "yuv420p10le", "yuvj444p", "yuva420p", "gray", "gbrp"])
@pytest.mark.parametrize("fill", ["255,0,0", "255"])
def test_a_fill_is_a_colour_in_any_planes(run: Run, name: str, fill: str) -> None:
    clips.make("in.nut", "rawvideo", name, count=2)
    white = 1023 if "10" in name else 255
    colour = [int(value) * white // 255 for value in fill.split(",")]
    text = ",".join(map(str, colour))
    strokes = ["--grab", "5,24:60,24", "--radius", "60", "--border", "none", "--quiet"]
    status, _, err = run(
        "warp", "in.nut", "out.mkv", *strokes, "--codec", "ffv1", "--outside", "constant", "--fill", text
    )
    if name == "gray" and len(colour) > 1:
        assert status == 2
        assert "fill must be a number, or 1 of them (grey)" in err
        return
    assert status == 0
    with open_video("out.mkv") as clip:
        frame = next(iter(clip.frames()))
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        frame.copy_to(arrays)
        seen = clip.to_rgb(arrays)[24, 1]
        assert not clip.layout.groups[0].alpha or arrays[0][24, 1, -1] == white  # a colour is opaque
    np.testing.assert_allclose(seen, [255, 0, 0] if len(colour) > 1 else [255] * 3, atol=3)


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


@pytest.mark.parametrize("frame", ["12", "-1", "11.6"])
def test_a_stroke_that_starts_in_a_frame_that_is_none_is_told(run: Run, frame: str) -> None:
    noisy("in.mkv", "yuv420p")
    status, _, err = run("warp", "in.mkv", "out.mkv", "--grab", f"30,20,{frame}:30,20,8", "--radius", "5")
    assert status == 0
    assert "starts outside the clip, which has 64 x 48 pixels and 12 frames (from 0)" in err


def test_a_sheet_shows_where_strokes_act(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy("in.mkv", count=80)
    seen: list[list[int]] = []
    monkeypatch.setattr(
        "supple.plot.files.draw_sheet", lambda before, *rest, **named: seen.append([k for k, _ in before])
    )
    local = supple.Recipe(strokes=[supple.Stroke.grab((30, 20, 40), by=(4, 0, 0), radius=6, scales=3)], border=None)
    everywhere = supple.Recipe(strokes=[supple.Stroke.grab((30, 20), by=(4, 0), radius=6)])
    still = supple.Recipe(strokes=[supple.Stroke.grab((30, 20, 40), by=(0, 0, 0), radius=6)])
    for recipe in (local, everywhere, still):
        plot_file("in.mkv", "out.png", recipe, "sheet")
    assert len(seen[0]) == 6
    assert 25 < seen[0][0] < 40 < seen[0][-1] < 55
    assert 40 - seen[0][0] == seen[0][-1] - 40
    assert seen[1] == seen[2] == [0, 16, 32, 47, 63, 79]


def test_a_folder_of_videos_is_no_clip(run: Run) -> None:
    os.mkdir("in")
    clips.make("in/a.mp4", count=12)
    clips.make("in/b.mp4", count=12)
    for grab in (GRAB, GRAB_2D):
        assert run("warp", "in", "out", *grab, "--force") == (0, "", "")
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


# Recipes.


def test_recipes_with_times_are_saved_and_carried_out(run: Run) -> None:
    noisy("in.mkv", "yuv420p")
    assert run("warp", "in.mkv", "a.mkv", *GRAB, "--save-recipe", "r.json") == (0, "", "")
    recipe = supple.Recipe.from_json(Path("r.json").read_text())
    assert recipe == replace(TIMED, size=(64, 48, 12), space="pixels", time_scale=1.0)
    assert run("warp", "in.mkv", "b.mkv", "--recipe", "r.json") == (0, "", "")
    same_frames("a.mkv", "b.mkv")
    status, out, err = run("info", "r.json")
    assert (status, err) == (0, "")
    assert "(30, 20, 3) to (33, 22, 8)" in out
    refused(run("warp", "in.mkv", "c.mkv", "--recipe", "r.json", *GRAB_2D), "3 numbers")
    assert sorted(os.listdir()) == ["a.mkv", "b.mkv", "in.mkv", "r.json"]


@pytest.mark.parametrize(
    ("grab", "wanted"),
    [
        ("30,20,32:30,20,36", "starts outside the clip, which has 64 x 48 pixels and 12 frames (from 0), and reaches"),
        ("30,20,-21:30,20,-25", "reaches nothing of it: use a point inside, a larger radius or a longer reach"),
        ("30,20,nan:30,20,8", "nan"),
        ("30,20,inf:30,20,8", "inf"),
        ("30,20,3:30,20", "X,Y,T:X,Y,T"),
        ("30,20,3,4:30,20,3,4", "X,Y,T:X,Y,T"),
    ],
)
def test_a_stroke_outside_the_clip_is_one_line(run: Run, grab: str, wanted: str) -> None:
    noisy("in.mkv", "yuv420p")
    refused(run("warp", "in.mkv", "out.mkv", "--grab", grab, "--radius", "5"), wanted)
    refused(run("plot", "in.mkv", "out.png", "--grab", grab, "--radius", "5", "--what", "sheet"), wanted)
    assert os.listdir() == ["in.mkv"]


# What cannot be.

VIDEO_REFUSED = [
    ("out.mp4", ["--codec", "nonsense"], "no video encoder is called nonsense"),
    ("out.mp4", ["--codec", ""], "no video encoder"),
    ("out.webm", ["--codec", "h264"], "cannot hold h264"),
    ("out.mp4", ["--crf", "99"], "crf 99"),
    ("out.mp4", ["--crf", "nan"], "crf nan"),
    ("out.mp4", ["--crf", "abc"], "--crf"),
    ("out.mkv", ["--codec", "ffv1", "--crf", "3"], "no crf"),
    ("out.mp4", ["--preset", "quick"], "no preset quick"),
    ("out.mp4", ["--pixel-format", "rgb24"], "rgb24"),
    ("out.mp4", ["--quality", "90"], "--quality is for pictures"),
    ("out.mp4", ["--fps", "25"], "--fps"),
    ("out.mp4", ["--fps", "0"], "--fps"),
    ("out.mp4", ["--fps", "nan"], "--fps"),
    ("out.mp4", ["--fps", "1e308"], "--fps"),
    ("out.mp4", ["--time-scale", "0"], "--time-scale"),
    ("out.mp4", ["--time-scale", "nan"], "--time-scale"),
    ("out.mp4", ["--time-scale", "inf"], "--time-scale"),
    ("out.mp4", ["--time-scale", "1e300"], "--time-scale"),
    ("out.mp4", ["--memory", "nan"], "--memory"),
    ("out.mp4", ["--memory", "-1"], "--memory"),
    ("out.mp4", ["--memory", "lots"], "--memory"),
    ("out.mp4", ["--between", "quadratic"], "--between"),
    ("out.mp4", ["--filter", "nearest", "--between", "cubic"], "between"),
    ("out.mp4", ["--tolerance", "nan"], "tolerance"),
    ("out.mp4", ["--fill", "1,2"], "fill"),
    ("out.mp4", ["--fill", "nan"], "fill"),
    ("out.mp4", ["--linear-light"], "--linear-light"),
    ("out%d.png", ["--codec", "h264"], "--codec is for videos"),
    ("out%d.png", ["--crf", "3"], "--crf is for videos"),
    ("out", ["--preset", "slow"], "--preset is for videos"),
    ("out/", ["--pixel-format", "yuv420p"], "--pixel-format is for videos"),
    ("out%d.jpg", ["--quality", "101"], "101"),
    ("out.png", [], "out.png is one picture, and a clip is many: name a pattern, such as out-%05d.png, or a folder"),
    ("out.txt", [], "the suffix .txt is no video format"),
    ("out.ts", [], "the suffix .ts is no video format"),
    ("out%d.txt", [], ".txt"),
    ("out%d", [], "suffix"),
    ("out%d-%d.png", [], "one number"),
    ("no/out.mp4", [], "no folder"),
    ("no/such/folder", [], "no folder"),
    ("taken.mp4", [], "--force"),
    ("", [], "name a file"),
    ("a\0b.mp4", [], "name"),
    ("x" * 300 + ".mp4", [], "too long"),
    ("x" * 300, [], "too long"),
    ("/proc/out.mp4", [], "/proc"),
    ("/proc/out", [], "/proc"),
    ("in.mp4/out", [], "in.mp4"),
]


@pytest.mark.parametrize(("target", "options", "wanted"), VIDEO_REFUSED)
def test_a_request_that_cannot_be_is_one_line(run: Run, target: str, options: list[str], wanted: str) -> None:
    clips.make("in.mp4", count=12)
    Path("taken.mp4").write_text("precious")
    refused(run("warp", "in.mp4", target, *GRAB, *options), wanted)
    assert Path("taken.mp4").read_text() == "precious"
    assert sorted(os.listdir()) == ["in.mp4", "taken.mp4"]


def broken(name: str) -> str:
    """Something that is no whole video."""
    if name == "text.mp4":
        Path(name).write_text("hello " * 500)
    elif name == "empty.mkv":
        Path(name).touch()
    elif name == "folder.mp4":
        os.mkdir(name)
    elif name == "sound.mp4":
        with av.open(name, "w") as out:
            sound = out.add_stream("aac", rate=48000)
            sound.layout = "mono"  # type: ignore[union-attr]
            clips._tone(out, sound, 1, 0)
    elif name == "cut.mp4":
        Path(name).write_bytes(clips.make("whole.mp4").read_bytes()[:1000])
    elif name == "cut.mkv":
        Path(name).write_bytes(Path(noisy("whole.mkv")).read_bytes()[:1500])
    elif name == "changes.ts":
        one = clips.make("one.ts", "mpeg2video", count=6)
        two = clips.make("two.ts", "mpeg2video", count=6, size=(80, 64))
        Path(name).write_bytes(one.read_bytes() + two.read_bytes())
    elif name == "formats.h264":
        one = clips.make("1.h264", count=6, container="h264")
        two = clips.make("2.h264", pixel_format="yuv444p", count=6, container="h264")
        Path(name).write_bytes(one.read_bytes() + two.read_bytes())
    return name


BROKEN = ("missing.mp4", "text.mp4", "empty.mkv", "folder.mp4", "sound.mp4", "cut.mp4", "cut.mkv", "changes.ts")


@pytest.mark.parametrize("name", [*BROKEN, "formats.h264"])
def test_what_is_no_video_is_one_line(run: Run, name: str) -> None:
    broken(name)
    before = sorted(os.listdir())
    for target in ("out.mp4", "out%d.png", "out"):
        refused(run("warp", name, target, *GRAB), name)
        assert sorted(os.listdir()) == before
    refused(run("plot", name, "out.png", *GRAB, "--what", "sheet"), name)
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize("suffix", [".mkv", ".mp4"])
def test_damage_anywhere_is_one_line_or_a_warning(run: Run, suffix: str) -> None:
    whole = Path(noisy("whole.mkv") if suffix == ".mkv" else clips.make("whole.mp4", count=12, audio="aac"))
    data = whole.read_bytes()
    rng = np.random.default_rng(7)
    done = 0
    for k in range(12):
        bad = bytearray(data)
        for place in rng.integers(400, len(bad), 25):
            bad[place] = rng.integers(256)
        Path(f"bad{suffix}").write_bytes(bad if k % 2 else bad[: rng.integers(len(bad) // 2, len(bad))])
        status, out, err = run("warp", f"bad{suffix}", "out.mkv", *GRAB_2D)
        assert status in (0, 2)
        assert out == ""
        lines = err.splitlines()
        assert all(line.startswith("supple: ") for line in lines)
        assert "fault" not in err
        assert [line for line in lines if "warning" not in line] == (lines[-1:] if status else [])
        assert Path("out.mkv").exists() == (status == 0)
        done += status == 0
        Path("out.mkv").unlink(missing_ok=True)
        assert sorted(os.listdir()) == [f"bad{suffix}", whole.name]
    assert done or suffix == ".mp4"


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


@pytest.mark.parametrize(
    "name", ["100%done.mp4", "50% off.mp4", "a b.mp4", "ä 漢字.mp4", "[1].mp4", "a\nb.mp4", "y" * 240 + ".mp4"]
)
def test_odd_names(run: Run, name: str) -> None:
    clips.make("in.mp4", count=4)
    assert run("warp", "in.mp4", name, *GRAB_2D) == (0, "", "")
    assert run("warp", name, "out.mp4", *GRAB_2D) == (0, "", "")
    assert run("warp", name, "frames", *GRAB_2D) == (0, "", "")
    status, out, err = run("info", name)
    assert (status, err) == (0, "")
    assert "64 x 48" in out
    assert sorted(os.listdir()) == sorted(["in.mp4", name, "out.mp4", "frames"])
    assert len(os.listdir("frames")) == 4


def test_names_that_begin_with_a_dash(run: Run) -> None:
    clips.make("-x.mp4", count=4)
    assert run("warp", *GRAB_2D, "--", "-x.mp4", "-y.mp4") == (0, "", "")
    assert run("warp", "./-x.mp4", "./-z.mp4", *GRAB_2D) == (0, "", "")
    assert sorted(os.listdir()) == ["-x.mp4", "-y.mp4", "-z.mp4"]
    status, _, err = run("warp", "-x.mp4", "out.mp4", *GRAB_2D)
    assert status == 2
    assert err.count("\n") == 1


@pytest.mark.parametrize("size", [(63, 47), (1, 1), (2, 2), (1, 40), (65, 1)])
@pytest.mark.parametrize("border", ["none", "50"])
def test_odd_sizes(run: Run, size: tuple[int, int], border: str) -> None:
    for k, pixel_format in enumerate(("yuv420p", "yuv444p")):
        source = f"in{k}.mkv"
        clips.make(source, "ffv1", pixel_format, count=5, size=size, options={"level": "1", "slices": "1"})
        for grab in ("0,0,2:0,0,3", "0,0,2:3,3,3", "0,0:3,3"):
            drag = ["--grab", grab, "--radius", "5", "--border", border, "--on-fold", "damp", "--quiet", "--force"]
            assert run("warp", source, "out.mkv", *drag) == (0, "", "")
            frame = clips.decoded("out.mkv")[-1]
            assert ((frame.width, frame.height), frame.format.name) == (size, pixel_format)
            assert run("warp", source, "out", *drag) == (0, "", "")
            assert image.read("out/00005.png").pixels.shape == (*size[::-1], 3)


def test_a_miscounted_clip_is_read_once_more(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clips whose packets promise other numbers of frames than decoding gives."""
    frames = stack(noisy("in.mkv", "yuv444p"))
    true = supple.media.video.survey

    def survey(container: Any, film: Any) -> Any:
        found = true(container, film)
        return replace(found, count=found.count + off)

    off = 0
    monkeypatch.setattr(supple.media.video, "survey", survey)
    d = supple.Deformation.from_recipe(TIMED, frames.shape[:3])
    for off in (-2, 3):  # noqa: B007
        assert run("warp", "in.mkv", "out.mkv", *GRAB, "--force") == (0, "", "")
        np.testing.assert_array_equal(stack("out.mkv"), d.warp(frames))
        assert run("warp", "in.mkv", "out/%d.png", *GRAB, "--force") == (0, "", "")
        assert len(os.listdir("out")) == 12
        for what in (["sheet"], ["slice", "--x", "3"], ["grid", "--frame", "9"]):
            assert run("plot", "in.mkv", "out.png", *GRAB, "--force", "--what", *what) == (0, "", "")

    def other(self: Any) -> Any:
        raise CountError(self.count + 1)
        yield

    monkeypatch.setattr(supple.media.video.Clip, "frames", other)
    refused(run("warp", "in.mkv", "none.mkv", *GRAB), "another number of frames")
    refused(run("plot", "in.mkv", "none.png", *GRAB, "--what", "sheet"), "another number of frames")
    assert sorted(os.listdir()) == ["in.mkv", "out", "out.mkv", "out.png"]


# Videos that are turned.


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
    none = ["--grab", "3,3,0:3,3,0", "--radius", "9"]
    assert run("warp", "in.mp4", "same.mp4", *none) == (0, "", "")
    with pytest.warns(ClipWarning, match="180°"):
        warp_file(turned("b.mp4", 180), "c.mp4", TIMED)
    with pytest.warns(ClipWarning, match="90° clockwise"):
        plot_file(turned("d.mp4", -90), "d.png", TIMED, "sheet")


# Several, progress, facts.


def test_several_videos_go_into_a_folder(run: Run) -> None:
    clips.make("a.mp4", count=12)
    noisy("b.mkv", "yuv420p")
    Path("bad.mp4").write_text("hello")
    status, out, err = run("warp", "a.mp4", "b.mkv", "bad.mp4", "out", *GRAB, "--json")
    assert status == 2
    assert err.count("\n") == 1
    assert "bad.mp4" in err
    facts = {line["output"]: line for line in map(json.loads, out.splitlines())}
    assert facts["out/a.mp4"]["frames"] == facts["out/b.mkv"]["frames"] == 12
    assert "error" in facts["out/bad.mp4"]
    assert sorted(os.listdir("out")) == ["a.mp4", "b.mkv"]
    assert run("warp", "b.mkv", "alone.mkv", *GRAB) == (0, "", "")
    same_frames("alone.mkv", "out/b.mkv")
    os.unlink("bad.mp4")
    assert run("warp", "*.m*", "again", *GRAB) == (0, "", "")
    assert sorted(os.listdir("again")) == ["a.mp4", "alone.mkv", "b.mkv"]
    assert run("warp", "*.mp4", "third", *GRAB) == (0, "", "")
    assert os.listdir("third") == ["a.mp4"]
    os.mkdir("there")
    assert run("warp", "a.mp4", "there", *GRAB) == (0, "", "")
    assert sorted(os.listdir("there")) == [f"{k:05d}.png" for k in range(1, 13)]  # of one clip, a folder takes pictures


def test_json_tells_what_was_done(run: Run) -> None:
    noisy("in.mkv", "yuv420p")
    status, out, err = run("warp", "in.mkv", "out.mkv", *GRAB, "--json")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    expected = {"input": "in.mkv", "output": "out.mkv", "width": 64, "height": 48, "frames": 12, "still": 0}
    expected["copied"] = 0
    assert expected.items() <= facts.items()
    assert 0 < facts["error"] <= facts["tolerance"] == 0.01
    assert (facts["strokes"], facts["applied"], facts["damping"]) == (1, 1, [1.0])
    status, out, err = run("warp", "in.mkv", "none/out.mkv", *GRAB, "--json")
    assert status == 2
    assert json.loads(out)["error"] in err
    status, out, err = run("plot", "in.mkv", "p.png", *GRAB, "--what", "sheet", "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["what"] == "sheet"


def test_damping_is_one_line_unless_quiet(run: Run) -> None:
    noisy("in.mkv", "yuv420p")
    strong = ["--grab", "30,20,3:30,20,11", "--radius", "3", "--force", "--on-fold", "damp"]
    status, out, err = run("warp", "in.mkv", "out.mkv", *strong)
    assert (status, out) == (0, "")
    assert err.count("\n") == 1
    assert "--on-fold flow" in err
    assert run("warp", "in.mkv", "out.mkv", *strong, "--quiet") == (0, "", "")
    refused(run("warp", "in.mkv", "out.mkv", *strong[:-1], "error"), "folds")


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": SOURCE, **more}


def watched(*arguments: str) -> tuple[int, str]:
    """Run a command whose messages go to a terminal."""
    terminal, inside = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "supple", *arguments],
        env=environment(TERM="xterm", COLUMNS="100"),
        stdout=subprocess.DEVNULL,
        stderr=inside,
    )
    os.close(inside)
    shown = b""
    while select.select([terminal], [], [], 200)[0]:
        try:
            got = os.read(terminal, 4096)
        except OSError:  # all is read
            break
        if not got:
            break
        shown += got
    os.close(terminal)
    return process.wait(), shown.decode()


def test_progress_is_for_terminals(here: Path) -> None:
    noisy("in.mkv", "yuv420p")
    status, shown = watched("warp", "in.mkv", "out.mkv", *GRAB)
    assert status == 0
    for word in ("planning", "frames", "12/12", "frames/s"):
        assert word in shown, word
    status, shown = watched("warp", "in.mkv", "flat.mkv", *GRAB_2D)
    assert status == 0
    assert "12/12" in shown
    assert "planning" not in shown
    assert watched("warp", "in.mkv", "quiet.mkv", *GRAB, "--quiet") == (0, "")


# Plots.


@pytest.mark.parametrize("options", [["--x", "20"], ["--y", "47"]])
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_slices(run: Run, options: list[str], suffix: str) -> None:
    noisy("in.mkv", "yuv420p")
    assert run("plot", "in.mkv", f"out{suffix}", *GRAB, "--what", "slice", *options) == (0, "", "")
    assert sorted(os.listdir()) == ["in.mkv", f"out{suffix}"]
    starts = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    assert Path(f"out{suffix}").read_bytes().startswith(starts[suffix])


def test_plots_show_what_warp_makes(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = pictures("in", 12)
    bent = supple.Deformation.from_recipe(TIMED, frames.shape[:3]).warp(frames)
    shown: list[Any] = []
    for name in ("draw_slice", "draw_sheet"):
        monkeypatch.setattr(f"supple.plot.files.{name}", lambda *given, **options: shown.append((given, options)))
    plot_file("in", "out.png", TIMED, "slice", x=20)
    plot_file("in", "out.png", TIMED, "slice", y=47)
    plot_file("in", "out.png", TIMED, "sheet")
    (column, _), (row, _), (sheet, _) = shown
    np.testing.assert_array_equal(column[0], frames[:, :, 20])
    np.testing.assert_array_equal(column[1], bent[:, :, 20])
    np.testing.assert_array_equal(row[0], frames[:, 47])
    np.testing.assert_array_equal(row[1], bent[:, 47])
    for drawn, expected in zip(sheet[:2], (frames, bent), strict=True):
        assert [k for k, _ in drawn] == [0, 2, 4, 7, 9, 11]
        np.testing.assert_array_equal(np.stack([frame for _, frame in drawn]), expected[[0, 2, 4, 7, 9, 11]])


@pytest.mark.parametrize("what", ["grid", "stretch", "axes", "residual", "iterations"])
@pytest.mark.parametrize("grab", [GRAB, GRAB_2D])
def test_maps_of_one_frame(run: Run, what: str, grab: Sequence[str]) -> None:
    noisy("in.mkv", "yuv420p")
    refused(run("plot", "in.mkv", "out.png", *grab, "--what", what), "from 0 to 11 (--frame)")
    assert run("plot", "in.mkv", "out.png", *grab, "--what", what, "--frame", "5") == (0, "", "")
    assert image.info("out.png")["format"] == "PNG"


def test_plots_of_sequences_and_of_one_frame(run: Run) -> None:
    pictures("in", 6)
    noisy("one.mkv", "yuv420p", 1)
    grab = ["--grab", "30,20,0:33,22,0", "--radius", "9", "--force"]
    for source in ("in/%03d.png", "in", "one.mkv"):
        for what in (["sheet"], ["slice", "--x", "3"], ["grid", "--frame", "0"]):
            assert run("plot", source, "out.png", *grab, "--what", *what) == (0, "", "")


PLOTS_REFUSED = [
    (["--what", "slice"], "--x or --y"),
    (["--what", "slice", "--x", "3", "--y", "4"], "--x or --y"),
    (["--what", "slice", "--x", "64"], "--x must be from 0 to 63"),
    (["--what", "slice", "--x", "2.5"], "--x must be a whole number of pixels, found '2.5'"),
    (["--what", "grid", "--frame", "2.5"], "--frame must be a whole number, counted from 0, found '2.5'"),
    (["--what", "grid", "--frame", "99"], "--frame must be from 0 to 11, found 99"),
    (["--what", "grid", "--x", "3"], "--x and --y are for slices"),
    (["--what", "slice", "--y", "48"], "--y must be from 0 to 47"),
    (["--what", "slice", "--x", "-1"], "--x must be from 0 to 63"),
    (["--what", "slice", "--x", "9" * 30], "--x must be from 0 to 63"),
    (["--what", "slice", "--x", "nan"], "--x"),
    (["--what", "slice", "--x", "3", "--frame", "2"], "--frame"),
    (["--what", "sheet", "--frame", "2"], "--frame"),
    (["--what", "sheet", "--x", "2"], "slices"),
    (["--what", "grid", "--frame", "2", "--y", "2"], "slices"),
    (["--frame", "12"], "from 0 to 11"),
    (["--frame", "-1"], "from 0 to 11"),
    (["--what", "movie"], "movie"),
    (["--what", "sheet", "--codec", "h264"], "--codec is for videos"),
    (["--what", "sheet", "--crf", "20"], "--crf is for videos"),
    (["--what", "sheet", "--fps", "20"], "--fps"),
]


@pytest.mark.parametrize(("options", "wanted"), PLOTS_REFUSED)
def test_a_plot_that_cannot_be_is_one_line(run: Run, options: list[str], wanted: str) -> None:
    noisy("in.mkv", "yuv420p")
    refused(run("plot", "in.mkv", "out.png", *GRAB, *options), wanted)
    assert os.listdir() == ["in.mkv"]


@pytest.mark.parametrize("target", ["out.jpg", "out.mp4", "out", "no/out.png", "taken.png", "in.mkv"])
def test_a_plot_that_cannot_be_written_is_one_line(run: Run, target: str) -> None:
    noisy("in.mkv", "yuv420p")
    kept = Path("in.mkv").read_bytes()
    Path("taken.png").write_text("precious")
    refused(run("plot", "in.mkv", target, *GRAB, "--what", "sheet"), target)
    assert Path("taken.png").read_text() == "precious"
    assert Path("in.mkv").read_bytes() == kept
    assert sorted(os.listdir()) == ["in.mkv", "taken.png"]


# Interrupts, and full disks.


def start(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "supple", *arguments],
        env=environment(TMPDIR=os.path.abspath("tmp")),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        preexec_fn=options.pop("preexec_fn", HEARING),
        **options,
    )


def hidden() -> list[str]:
    """What is being written."""
    found = []
    for folder, folders, files in os.walk("."):
        found += [os.path.join(folder, name) for name in folders + files if name.startswith(".")]
    return found


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip that takes far longer to bend than it takes to notice that this has begun."""
    return clips.make(tmp_path_factory.mktemp("long") / "long.mp4", count=1500, size=(320, 240))


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize(
    "arguments",
    [
        ["long.mp4", "out.mp4"],
        ["long.mp4", "out.mp4", "--memory", "0"],
        ["long.mp4", "frames/%05d.png"],
        ["long.mp4", "frames"],
        ["long.mp4", "other.mp4", "batch"],
    ],
    ids=["single", "spilled", "pattern", "folder", "batch"],
)
def test_an_interrupt_leaves_nothing(here: Path, long: Path, arguments: list[str], number: int, status: int) -> None:
    for name in ("long.mp4", "other.mp4"):
        os.link(long, name)
    os.mkdir("tmp")
    os.mkdir("batch")
    strokes = ["--grab", "100,100,500:150,120,520", "--radius", "200", "--border", "none", "--quiet"]
    process = start("warp", *arguments, *strokes)
    end = time.monotonic() + 200
    while not hidden():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)
    time.sleep(0.2)
    process.send_signal(number)
    out, err = process.communicate(timeout=200)
    word = "interrupted" if status == 130 else "terminated"
    assert (process.returncode, out, err) == (status, "", f"supple: {word}\n")
    assert hidden() == []
    assert os.listdir("tmp") == os.listdir("batch") == []
    assert sorted(os.listdir()) == ["batch", "long.mp4", "other.mp4", "tmp"]


@pytest.mark.parametrize(
    ("target", "options", "wanted"),
    [
        ("out.mp4", [], "cannot write out.mp4"),
        ("out.mkv", [], "cannot write out.mkv"),
        ("frames/%03d.png", [], "001.png"),
        ("frames", [], "00001.png"),
        ("out.mkv", ["--memory", "0"], "no room"),
    ],
)
def test_a_full_disk_is_one_line(here: Path, target: str, options: list[str], wanted: str) -> None:
    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    os.mkdir("tmp")
    noisy("in.mkv", "yuv420p")
    process = start("warp", "in.mkv", target, *GRAB, *options, preexec_fn=little)
    out, err = process.communicate(timeout=200)
    assert (process.returncode, out) == (2, ""), err
    assert err.startswith("supple: ")
    assert err.count("\n") == 1
    assert wanted in err
    assert os.listdir("tmp") == []
    assert sorted(os.listdir()) == ["in.mkv", "tmp"]


# What a file holds.


def test_info_of_videos_and_sequences(run: Run) -> None:
    def setup(stream: Any) -> None:
        stream.set_display_rotation(90)
        context = stream.codec_context
        context.sample_aspect_ratio = Fraction(4, 3)
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 9, 9, 16

    clips.make("a.mp4", count=12, audio="aac", setup=setup)
    pictures("in", 6)
    clips.make("b.gif", "gif", "rgb8", count=3)
    status, out, err = run("info", "a.mp4", "in", "in/%03d.png", "b.gif")
    assert (status, err) == (0, "")
    for words in ("h264", "64 x 48", "12, 25 a second, 0.480 s", "yuv420p, 8 bit", "aac (fin)", "range limited"):
        assert words in out, words
    assert "primaries BT.2020, transfer PQ, matrix BT.2020" in out
    assert "90° counterclockwise, applied when it is played" in out
    assert "pixels are 4/3 as wide as high" in out
    assert out.count("6, from in/001.png to in/006.png") == 2
    status, out, err = run("info", "a.mp4", "in", "b.gif", "--json")
    assert (status, err) == (0, "")
    video, sequence, gif = map(json.loads, out.splitlines())
    expected = {"kind": "video", "codec": "h264", "frames": 12, "rate": "25", "duration": 0.48, "aspect": "4/3"}
    assert expected.items() <= video.items()
    assert {"width": 64, "height": 48, "rotation": 90, "primaries": "BT.2020", "audio": ["aac (fin)"]}.items() <= (
        video.items()
    )
    assert {"kind": "sequence", "frames": 6, "width": 64, "height": 48, "dtype": "uint8"}.items() <= sequence.items()
    assert (gif["kind"], gif["frames"]) == ("video", 3)


def test_info_goes_on_after_a_bad_file(run: Run) -> None:
    clips.make("a.mp4", count=2)
    Path("text.mp4").write_text("hello")
    status, out, err = run("info", "text.mp4", "a.mp4", "missing.png")
    assert status == 2
    assert "a.mp4:\n" in out
    assert [line.split(":")[1].strip() for line in err.splitlines()] == [
        "cannot read text.mp4",
        "cannot read missing.png",
    ]
    status, out, err = run("info", "text.mp4", "a.mp4", "--json")
    assert status == 2
    bad, good = map(json.loads, out.splitlines())
    assert bad["error"] in err
    assert good["frames"] == 2


def test_info_of_a_video_without_suffix(run: Run) -> None:
    os.rename(clips.make("a.mp4", count=2), "a")
    status, out, err = run("info", "a")
    assert (status, err) == (0, "")
    assert "h264" in out
