"""What no clip can be, and damage, in one line."""

from __future__ import annotations

import os
from pathlib import Path

import av
import numpy as np
import pytest

from supple.media import image
from supple.media.video import info
from tests import clips
from tests.files.clip_files import GRAB, GRAB_2D, Run, noisy, pictures, refused


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
    ("out.mp4", ["--outside", "constant", "--fill", "nan"], "fill must be finite for the frames of"),
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
            clips.add_tone(out, sound, 1, 0)
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
