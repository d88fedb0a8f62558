"""Videos from file to file: what is written is what warp makes, and what is copied."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
import supple.media.video
from supple.files import warp_file
from supple.files.options import ClipOptions
from supple.media.base import CountError
from supple.media.video import info
from supple.media.video import open_clip as open_video
from tests import clips
from tests.files.clip_files import FLAT, GRAB, GRAB_2D, TIMED, Run, noisy, pictures, refused, same_frames, stack

KEYS = (supple.Key(3, at=(20, 20)), supple.Key(9, at=(44, 20)))
MOVING = supple.Recipe(border=10, strokes=(supple.Stroke(at=(20, 20), by=(4, 3), radius=6, keys=KEYS),))
LOSSLESS = ClipOptions(codec="ffv1")


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
    assert made.frames == len(frames) == 12
    assert 0 < made.error <= made.tolerance == 0.01
    timed = recipe is TIMED
    d = supple.Deformation.from_recipe(recipe, frames.shape[:3] if timed else frames.shape[1:3], time=timed)
    wide = pixel_format.endswith("10le")
    expected = d.warp(frames) if timed else np.stack([d.warp(frame) for frame in frames])
    got = stack("out.mkv")
    assert (expected != frames).any()
    if wide:  # where cubics overshoot, they are cut off at 1023, not at 65535
        assert got.max() <= 1023
        expected = np.minimum(expected, 1023)
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(
    "pixel_format",
    ["yuv420p", "yuv422p10le", "yuv444p12le", "gray", "gray16le", "gbrp12le", "bgr0", "yuva420p"],
)
@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
def test_without_force_no_bit_changes(here: Path, pixel_format: str, size: tuple[int, int]) -> None:
    noisy("in.mkv", pixel_format, 5, size=size)
    still = supple.Recipe(strokes=(supple.Stroke.grab((3, 3, 2), by=(0, 0, 0), radius=10),))
    with pytest.warns(supple.OutsideWarning, match=r"a drag by \(0, 0, 0\) at \(3, 3, 2\) .* moves nothing"):
        warp_file("in.mkv", "out.mkv", still, lossless=True)  # encoded anew
    assert Path("out.mkv").read_bytes() != b""
    same_frames("in.mkv", "out.mkv")
    assert clips.when("in.mkv") == clips.when("out.mkv")


def test_a_stroke_in_the_middle_leaves_the_frames_out_of_its_reach_alone(here: Path) -> None:
    noisy("in.mkv", "yuv420p", 120)
    stroke = supple.Stroke.grab((30, 20, 60), to=(33, 22, 64), radius=5)
    made = warp_file("in.mkv", "out.mkv", supple.Recipe(strokes=(stroke,)))
    before, after = clips.decoded("in.mkv"), clips.decoded("out.mkv")
    same = [clips.rows(a) == clips.rows(b) for a, b in zip(before, after, strict=True)]
    reach = 4 * 5  # radii, of as many frames
    assert all(same[: 60 - reach])
    assert all(same[64 + reach + 1 :])
    assert not any(same[55:70])
    assert made.still >= 120 - (2 * reach + 4 + 1)


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
    times = None if suffix == "avi" else [k + (k > 3) * 2 for k in range(48)]
    source = clips.make(
        f"in.{suffix}", codec, pixel_format, count=48, smooth=False, options=options, times=times, audio="pcm_s16le"
    )
    local = supple.Recipe(strokes=(supple.Stroke.grab((30, 20, 24), to=(33, 22, 26), radius=3),))
    made = warp_file(source, f"out.{suffix}", local)
    assert made.copied == made.still >= 20
    before, after = (clips.parcels(f"{name}.{suffix}", "video") for name in ("in", "out"))
    assert [when for _, *when in before] == [when for _, *when in after]
    copies = [a == b for (a, *_), (b, *_) in zip(before, after, strict=True)]
    assert copies[:11] == [True] * 11
    assert copies[40:] == [True] * 8
    assert not any(copies[22:28])
    # What is encoded is what it is without copies, and of the still frames of FFV1 all are.
    monkeypatch.setattr("supple.media.video.encode.Sink._may_copy", lambda self: False)
    anew = warp_file(source, f"anew.{suffix}", local)
    assert (anew.copied, anew.still) == (0, made.still)
    frames, others = clips.decoded(f"out.{suffix}"), clips.decoded(f"anew.{suffix}")
    assert len(frames) == len(others) == 48
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
    source = clips.make("in.mkv", codec, form, count=48, options={"g": "12"})
    local = supple.Recipe(strokes=(supple.Stroke.grab((30, 20, 24), to=(33, 22, 26), radius=3),))
    made = warp_file(source, target, local, clip=options)
    assert made.still > 0 == made.copied
    assert len(clips.decoded(target)) == 48


def test_options_reach_the_sampler_and_the_encoder(run: Run) -> None:
    frames = stack(noisy("in.mkv", "yuv444p", 9))
    luma = 0.299 * 200 + 0.587 * 30 + 0.114 * 60  # of BT.601
    chroma = [128 + 224 / 255 * (60 - luma) / 1.772, 128 + 224 / 255 * (200 - luma) / 1.402]
    fill = [16 + 219 / 255 * luma, *chroma]
    options = ["--filter", "linear", "--outside", "constant", "--fill", "200,30,60", "--tolerance", "0.1", "--between"]
    more = ["--time-scale", "2", "--time-filter"]
    strokes = ["--grab", "5,20,3:30,22,6", "--radius", "15", "--border", "none", "--quiet"]
    assert run("warp", "in.mkv", "out.mkv", *strokes, *options, "cubic", *more) == (0, "", "")
    d = supple.Deformation(frames.shape[:3], border=None, spacing=(1, 1, 2), time=True)
    with warnings.catch_warnings(action="ignore", category=supple.FoldWarning):
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


def test_a_window_on_disk_gives_the_same(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy("in.mkv", "yuv420p")
    Path("tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(here / "tmp"))
    used: list[int] = []
    from supple.engine import memory

    reserve = memory.reserve
    monkeypatch.setattr(memory, "reserve", lambda file, size: (used.append(size), reserve(file, size)))
    warp_file("in.mkv", "a.mkv", TIMED)
    assert used == []
    made = warp_file("in.mkv", "b.mkv", TIMED, clip=ClipOptions(memory=0))
    assert used == [made.held * 64 * 48 * 3 // 2, made.held * 16 * 12 * 16]  # frames, and the motion between them
    same_frames("a.mkv", "b.mkv")
    assert os.listdir("tmp") == []


def test_where_nothing_is_asked_the_file_is_copied(run: Run) -> None:
    clips.make("in.mp4", count=4, audio="aac")
    none = ["--grab", "30,20,1:30,20,1", "--radius", "10", "--quiet"]
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


@pytest.mark.parametrize("recipe", [TIMED, MOVING])
def test_the_library_tells_how_far_it_is_and_may_be_stopped(here: Path, recipe: supple.Recipe) -> None:
    noisy("in.mkv", "yuv420p")
    steps: list[str] = []
    warp_file("in.mkv", "out.mkv", recipe, progress=steps.append)
    assert (steps.count("write"), steps.count("warp")) == (1, 12)
    assert set(steps) == {"write", "plan", "warp"}
    assert recipe is TIMED or steps == ["plan"] * 12 + ["write"] + ["warp"] * 12

    def stop(step: str) -> None:
        if step == when:
            raise KeyboardInterrupt

    for when, target in (("plan", "b.mkv"), ("warp", "b.mkv"), ("warp", "b%d.png"), ("warp", "b")):  # noqa: B007
        with pytest.raises(KeyboardInterrupt):
            warp_file("in.mkv", target, recipe, progress=stop)
    assert sorted(os.listdir()) == ["in.mkv", "out.mkv"]


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


def test_a_miscounted_clip_is_read_once_more(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clips whose packets promise other numbers of frames than decoding gives."""
    frames = stack(noisy("in.mkv", "yuv444p"))
    true = supple.media.video.demux.survey

    def survey(*given: Any) -> Any:
        found, first = true(*given)
        return replace(found, count=found.count + off), first

    off = 0
    monkeypatch.setattr(supple.media.video.demux, "survey", survey)
    d = supple.Deformation.from_recipe(TIMED, frames.shape[:3], time=True)
    sheet, cut, grid = ["sheet"], ["slice", "--x", "3"], ["grid", "--frame", "9"]
    for off, whats in ((-2, [sheet, grid]), (3, [cut])):  # noqa: B007
        assert run("warp", "in.mkv", "out.mkv", *GRAB, "--force") == (0, "", "")
        np.testing.assert_array_equal(stack("out.mkv"), d.warp(frames))
        assert run("warp", "in.mkv", "out/%d.png", *GRAB, "--force") == (0, "", "")
        assert len(os.listdir("out")) == 12
        for what in whats:
            assert run("plot", "in.mkv", "out.png", *GRAB, "--force", "--what", *what) == (0, "", "")

    def other(self: Any) -> Any:
        raise CountError(self.count + 1)
        yield

    monkeypatch.setattr(supple.media.video.Clip, "frames", other)
    refused(run("warp", "in.mkv", "none.mkv", *GRAB), "another number of frames")
    refused(run("plot", "in.mkv", "none.png", *GRAB, "--what", "sheet"), "another number of frames")
    assert sorted(os.listdir()) == ["in.mkv", "out", "out.mkv", "out.png"]
