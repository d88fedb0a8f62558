"""Times of frames come through, whatever rate, order or container; and frames are read again."""

import types
from fractions import Fraction

import av
import numpy as np
import pytest

from supple.media.video import ClipWarning, CountError, info
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import assert_same_frames, assert_same_sound, copy, read


def test_times_of_frames_are_kept_with_b_frames(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=12, options={"bf": "3"})
    copy(source, tmp_path / "b.mp4")
    copy(source, tmp_path / "c.mkv", codec="ffv1")
    assert clips.when(tmp_path / "b.mp4") == clips.when(source) == clips.when(tmp_path / "c.mkv")
    assert_same_frames(source, tmp_path / "c.mkv")


@pytest.mark.parametrize("codec", ["libx264", "libx265", "mpeg4", "libsvtav1", "libvpx-vp9", "ffv1"])
def test_variable_rate_is_kept(tmp_path, codec):
    times = [0, 7, 11, 100, 101, 140, 900, 901, 902, 3000]
    source = clips.make(tmp_path / "a.mp4", times=times, base=Fraction(1, 90000))
    copy(source, tmp_path / "b.mp4", codec=codec)
    assert [t * 90000 for t in clips.when(tmp_path / "b.mp4")] == times


def test_a_pause_is_kept_in_avi(tmp_path):
    times = [k + 50 * (k > 4) for k in range(10)]
    source = clips.make(tmp_path / "a.mp4", times=times)
    copy(source, tmp_path / "b.avi")
    with open_video(tmp_path / "b.avi") as clip:
        clip.passage = types.SimpleNamespace(streams=[], take=None)
        assert [clip.time(k)[0] * clip.base for k, _ in enumerate(clip.frames())] == [Fraction(t, 25) for t in times]


def test_times_that_avi_cannot_keep_are_told(tmp_path):
    times = [0, 40, 80, 130, 173, 215, 256, 300, 340, 390]
    source = clips.make(tmp_path / "a.mkv", times=times, base=Fraction(1, 1000))
    with pytest.warns(ClipWarning, match=r"has one frame rate, and frames are up to 0\.02 s from their times"):
        copy(source, tmp_path / "b.avi", codec="mpeg4")


@pytest.mark.parametrize(
    ("times", "base", "varies"),
    [
        (range(10), Fraction(1, 25), False),
        ([0, 33, 67, 100, 133, 167, 200, 233, 267, 300], Fraction(1, 1000), False),
        ([0, 1, 2, 3, 54, 55, 56, 57, 58, 59], Fraction(1, 25), True),
        ([0, 40, 80, 130, 173, 215, 256, 300, 340, 390], Fraction(1, 1000), True),
    ],
)
def test_a_variable_rate_is_told(tmp_path, times, base, varies):
    source = clips.make(tmp_path / "a.mkv", times=list(times), base=base)
    assert info(source)["variable"] is varies


def test_frames_before_an_edit_list_begins_are_not_shown(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=12, times=range(-4, 8), audio="aac", options={"bf": "2"})
    shown = len(clips.decoded(source))
    assert 0 < shown < 12
    assert copy(source, tmp_path / "b.mp4", again=False) == shown
    assert clips.when(tmp_path / "b.mp4") == clips.when(source)
    assert_same_sound(source, tmp_path / "b.mp4")


def test_gif_is_timed_without_drift(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=30, rate=24)
    copy(source, tmp_path / "b.gif")
    assert [round(t * 100) for t in clips.when(tmp_path / "b.gif")] == [round(k * 100 / 24) for k in range(30)]


def test_gif_has_the_colours_of_the_clip(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=3)
    copy(source, tmp_path / "b.gif")
    with open_video(source) as clip:
        for arrays, [shown] in zip(read(source), read(tmp_path / "b.gif"), strict=True):
            want = clip.to_rgb(arrays).astype(int)
            assert np.abs(want - shown[..., :3]).mean() < 3


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
@pytest.mark.parametrize("suffix", ["avi", "h264", "ts", "mkv"])
def test_frames_without_times_are_neither_lost_nor_doubled(tmp_path, suffix, codec):
    if suffix == "h264":
        if codec != "libx264":
            pytest.skip("raw streams are of H.264")
        source = clips.make(tmp_path / "a.h264", codec, container="h264", options={"bf": "2"})
    else:
        source = clips.make(tmp_path / f"a.{suffix}", codec, options={"bf": "2"})
    copy(source, tmp_path / "b.mkv", codec="ffv1")
    assert_same_frames(source, tmp_path / "b.mkv")
    times = clips.when(tmp_path / "b.mkv")
    steps = np.diff([float(t) for t in times])
    assert (steps > 0).all()
    assert steps == pytest.approx(0.04, abs=0.0011)


def test_hidden_frames_of_vp8_are_not_counted(tmp_path):
    options = {"auto-alt-ref": "1", "lag-in-frames": "16", "b": "200000", "arnr-maxframes": "5"}
    source = clips.make(tmp_path / "a.webm", "libvpx", count=60, options=options)
    assert copy(source, tmp_path / "b.mkv", again=False, codec="ffv1") == 60


def test_count_is_told_where_packets_lie(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=10)
    for wrong in (7, 12):
        with open_video(source, count=wrong) as clip, pytest.raises(CountError) as caught:
            assert sum(1 for _ in clip.frames()) == min(wrong, 10)
        assert caught.value.found == 10


def test_frames_can_be_read_again(tmp_path):
    with open_video(clips.make(tmp_path / "a.mp4", options={"bf": "2"})) as clip:
        assert sum(1 for _ in clip.frames()) == sum(1 for _ in clip.frames()) == 10
        for _ in clip.frames():
            break
        assert sum(1 for _ in clip.frames()) == 10


def test_facts(tmp_path):
    found = info(clips.make(tmp_path / "a.mkv", "ffv1", "yuv422p10le", audio="flac", subtitles=True))
    assert found["codec"] == "ffv1"
    assert (found["width"], found["height"], found["frames"], found["rate"]) == (64, 48, 10, 25)
    assert (found["bits"], found["alpha"], found["audio"], found["subtitles"]) == (
        10,
        False,
        ["flac (fin)"],
        ["subrip (deu)"],
    )
    assert found["duration"] == pytest.approx(0.4)


@pytest.mark.parametrize("codec", ["libx264", "libvpx-vp9", "mpeg4"])
def test_the_last_frame_keeps_its_duration_in_mp4(tmp_path, codec):
    times = [0, 40, 120, 160, 400, 410, 470, 500]
    with av.open(str(tmp_path / "a.mkv"), "w") as out:
        film = out.add_stream(codec, rate=25)
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p"
        film.time_base = film.codec_context.time_base = Fraction(1, 1000)
        made = []
        for k, start in enumerate(times):
            frame = clips.noise("yuv420p", clips.SIZE, k, True)
            frame.pts, frame.time_base = start, Fraction(1, 1000)
            made += film.encode(frame)
        for packet in made + film.encode(None):
            packet.duration = 700 if packet.pts == 500 else 40
            out.mux_one(packet)
    copy(tmp_path / "a.mkv", tmp_path / "b.mp4")
    copy(tmp_path / "b.mp4", tmp_path / "c.mkv")
    for name in ("b.mp4", "c.mkv"):
        with av.open(str(tmp_path / name)) as file:
            assert file.duration == pytest.approx(1.2e6, abs=1e3), name
