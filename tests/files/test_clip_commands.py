"""What the command line tells of clips: JSON, progress, plots, interrupts, full disks."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import time
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

import supple
import supple.media.video
from supple.files.jobs import Job
from supple.files.plots import plot_file
from supple.media import image
from tests import clips
from tests.children import full_disk, start, watched
from tests.files.clip_files import GRAB, GRAB_2D, TIMED, Run, noisy, pictures, refused, same_frames


def test_a_sheet_shows_where_strokes_act(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy("in.mkv", count=80)
    seen: list[list[int]] = []
    monkeypatch.setattr(
        "supple.files.plots.draw_sheet", lambda before, *rest, **named: seen.append([k for k, _ in before])
    )
    local = supple.Recipe(strokes=[supple.Stroke.grab((30, 20, 40), by=(4, 0, 0), radius=6, scales=3)], border=None)
    everywhere = supple.Recipe(strokes=[supple.Stroke.grab((30, 20), by=(4, 0), radius=6)])
    still = supple.Recipe(strokes=[supple.Stroke.grab((30, 20, 40), by=(0, 0, 0), radius=6)])
    for recipe in (local, everywhere, still):
        plot_file(Job("in.mkv", "out.png", recipe), "sheet")
    assert len(seen[0]) == 6
    assert 25 < seen[0][0] < 40 < seen[0][-1] < 55
    assert 40 - seen[0][0] == seen[0][-1] - 40
    assert seen[1] == seen[2] == [0, 16, 32, 47, 63, 79]


def test_several_videos_go_into_a_folder(run: Run) -> None:
    clips.make("a.mp4", count=12)
    noisy("b.mkv", "yuv420p")
    Path("bad.mp4").write_text("hello")
    status, out, err = run("warp", "a.mp4", "b.mkv", "bad.mp4", "out", *GRAB, "--json")
    assert status == 2
    assert err.endswith("supple: 2 of 3 files written into out, 1 failed: bad.mp4\n")
    assert err.count("\n") == 2
    assert "bad.mp4" in err
    facts = {line["output"]: line for line in map(json.loads, out.splitlines())}
    assert facts["out/a.mp4"]["frames"] == facts["out/b.mkv"]["frames"] == 12
    assert "error" in facts["out/bad.mp4"]
    assert sorted(os.listdir("out")) == ["a.mp4", "b.mkv"]
    assert run("warp", "b.mkv", "alone.mkv", *GRAB) == (0, "", "")
    same_frames("alone.mkv", "out/b.mkv")
    os.unlink("bad.mp4")
    assert run("warp", "*.m*", "again", *GRAB, "--quiet") == (0, "", "")
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
    assert (facts["strokes"], facts["applied"], facts["damping"]) == (1, 2, [1.0])
    status, out, err = run("warp", "in.mkv", "none/out.mkv", *GRAB, "--json")
    assert status == 2
    assert json.loads(out)["error"] in err
    status, out, err = run("plot", "in.mkv", "p.png", *GRAB, "--what", "sheet", "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["what"] == "sheet"


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


def test_plots_show_what_warp_makes(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = pictures("in", 12)
    bent = supple.Deformation.from_recipe(TIMED, frames.shape[:3], time=True).warp(frames)
    shown: list[Any] = []
    for name in ("draw_slice", "draw_sheet"):
        monkeypatch.setattr(f"supple.files.plots.{name}", lambda *given, **options: shown.append((given, options)))
    plot_file(Job("in", "out.png", TIMED), "slice", x=20)
    plot_file(Job("in", "out.png", TIMED), "slice", y=47)
    plot_file(Job("in", "out.png", TIMED), "sheet")
    (column, _), (row, _), (sheet, _) = shown
    np.testing.assert_array_equal(column[0], frames[:, :, 20])
    np.testing.assert_array_equal(column[1], bent[:, :, 20])
    np.testing.assert_array_equal(row[0], frames[:, 47])
    np.testing.assert_array_equal(row[1], bent[:, 47])
    for drawn, expected in zip(sheet[:2], (frames, bent), strict=True):
        assert [k for k, _ in drawn] == [0, 2, 4, 7, 9, 11]
        np.testing.assert_array_equal(np.stack([frame for _, frame in drawn]), expected[[0, 2, 4, 7, 9, 11]])


@pytest.mark.parametrize(("what", "grab"), [("grid", GRAB_2D), ("stretch", GRAB), ("iterations", GRAB_2D)])
def test_maps_of_one_frame(run: Run, what: str, grab: Sequence[str]) -> None:
    noisy("in.mkv", "yuv420p")
    refused(run("plot", "in.mkv", "out.png", *grab, "--what", what), "give --frame, from 0 to 11")
    assert run("plot", "in.mkv", "out.png", *grab, "--what", what, "--frame", "5") == (0, "", "")
    assert image.info("out.png")["format"] == "PNG"


def hidden() -> list[str]:
    """What is being written."""
    found = []
    for folder, folders, files in os.walk("."):
        found += [os.path.join(folder, name) for name in folders + files if name.startswith(".")]
    return found


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip that takes far longer to bend than it takes to notice that this has begun."""
    return clips.make(
        tmp_path_factory.mktemp("long") / "long.mp4", count=500, size=(320, 240), options={"preset": "ultrafast"}
    )


@pytest.mark.parametrize(
    ("arguments", "number"),
    [
        (["long.mp4", "out.mp4"], signal.SIGINT),
        (["long.mp4", "out.mp4", "--memory", "0"], signal.SIGTERM),
        (["long.mp4", "frames/%05d.png"], signal.SIGTERM),
        (["long.mp4", "frames"], signal.SIGINT),
        (["long.mp4", "other.mp4", "batch"], signal.SIGINT),
    ],
    ids=["single", "spilled", "pattern", "folder", "batch"],
)
def test_an_interrupt_leaves_nothing(here: Path, long: Path, arguments: list[str], number: int) -> None:
    for name in ("long.mp4", "other.mp4"):
        os.link(long, name)
    os.mkdir("tmp")
    os.mkdir("batch")
    strokes = ["--grab", "100,100,200:150,120,220", "--radius", "200", "--border", "none", "--quiet"]
    process = start("warp", *arguments, *strokes, env={"TMPDIR": os.path.abspath("tmp")})
    end = time.monotonic() + 200
    while not hidden():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)
    time.sleep(0.2)
    process.send_signal(number)
    out, err = process.communicate(timeout=200)
    status, word = (130, "interrupted") if number == signal.SIGINT else (143, "terminated")
    assert (process.returncode, out, err) == (status, "", f"supple: {word}\n")
    assert hidden() == []
    assert os.listdir("tmp") == os.listdir("batch") == []
    assert sorted(os.listdir()) == ["batch", "long.mp4", "other.mp4", "tmp"]


def test_a_full_disk_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkdir("tmp")
    monkeypatch.setattr(tempfile, "tempdir", os.path.abspath("tmp"))
    noisy("in.mkv", "yuv420p")
    for target, options, wanted in (("frames/%03d.png", (), "001.png"), ("out.mkv", ("--memory", "0"), "no room")):
        with full_disk(3000):
            refused(run("warp", "in.mkv", target, *GRAB, *options), wanted)
        assert os.listdir("tmp") == []
        assert sorted(os.listdir()) == ["in.mkv", "tmp"]


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
    assert "turned by 90° counterclockwise when it is played" in out
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


@pytest.mark.parametrize("order", ["t", "b"])
def test_interlaced_clips_that_are_bent_are_warned_of(run: Run, order: str) -> None:
    def setup(stream: Any) -> None:
        stream.codec_context.field_order = {"t": 2, "b": 3}[order]

    clips.make("in.mkv", "libvpx-vp9", count=3, setup=setup)
    status, _, err = run("warp", "in.mkv", "out.mkv", *GRAB_2D)
    assert status == 0
    first = {"t": "top", "b": "bottom"}[order]
    assert f"in.mkv is interlaced, {first} field first, and the two fields" in err
    assert "deinterlace it first, with FFmpeg's filter bwdif" in err
    assert err.count("\n") == 1
    status, _, err = run("info", "in.mkv")
    assert status == 0
    assert run("warp", "in.mkv", "strict.mkv", *GRAB_2D, "--strict")[0] == 2
    assert run("info", "in.mkv")[1].count(f"interlaced, {first} field first") == 1


def test_metadata_of_quicktime_comes_through(run: Run) -> None:
    tags = {"com.apple.quicktime.make": "A", "com.apple.quicktime.location.ISO6709": "+48.1+011.5/", "title": "B"}
    clips.make("plain.mov", count=3)
    with (
        av.open("plain.mov") as source,
        av.open("in.mov", "w", container_options={"movflags": "use_metadata_tags"}) as made,
    ):
        made.metadata.update(tags)
        stream = made.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                made.mux(packet)
    for name in ("out.mov", "out.mp4"):
        assert run("warp", "in.mov", name, *GRAB_2D) == (0, "", "")
        with av.open(name) as made:
            assert tags.items() <= made.metadata.items()
