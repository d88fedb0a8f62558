"""Sound, words, covers and chapters come through, in step."""

import types
from fractions import Fraction

import av
import numpy as np
import pytest

from supple.media.video import ClipWarning
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import arrays_of, assert_same_sound, copy, relative


@pytest.mark.parametrize(
    ("one", "two", "audio", "tolerance"),
    [
        ("mp4", "mp4", "aac", 1e-9),
        ("mkv", "mkv", "aac", 1e-9),
        ("mp4", "mkv", "aac", 1.01e-3),
        ("mkv", "mp4", "aac", 1.01e-3),
        ("mp4", "mov", "aac", 1e-9),
        ("avi", "mp4", "libmp3lame", 1e-3),
        ("mov", "avi", "pcm_s16le", 1e-3),
        ("webm", "webm", "libopus", 1e-9),
        ("webm", "mkv", "libopus", 1e-9),
    ],
)
def test_sound_comes_through_unchanged_and_in_step(tmp_path, one, two, audio, tolerance):
    codec = "libvpx" if one == "webm" else "mpeg4" if two == "avi" else "libx264"
    source = clips.make(tmp_path / f"a.{one}", codec, count=25, audio=audio)
    copy(source, tmp_path / f"b.{two}")
    if audio == "pcm_s16le":  # cut into other packets
        data = [b"".join(p[0] for p in relative(path, "audio")) for path in (source, tmp_path / "b.avi")]
        assert data[0] == data[1]
    else:
        assert_same_sound(source, tmp_path / f"b.{two}", tolerance)
    if "avi" not in (one, two):
        with av.open(str(tmp_path / f"b.{two}")) as out:
            assert out.streams.audio[0].language == "fin"


def test_sound_of_a_broadcast_stays_in_step(tmp_path):
    source = clips.make(tmp_path / "a.ts", count=25, audio="aac", audio_start=0.5)
    copy(source, tmp_path / "b.mp4")
    before, after = relative(source, "audio"), relative(tmp_path / "b.mp4", "audio")
    assert len(before) == len(after)
    assert all(a[0].endswith(b[0]) for a, b in zip(before, after, strict=True))  # less the header of each packet
    assert [p[1] for p in after] == pytest.approx([p[1] for p in before], abs=3e-5)
    assert min(clips.when(tmp_path / "b.mp4")) < 0.2  # no second and a half of nothing


@pytest.mark.parametrize("start", [-0.2, 0.3])
def test_sound_that_starts_at_another_time_stays_there(tmp_path, start):
    source = clips.make(tmp_path / "a.mp4", count=25, audio="aac", audio_start=max(start, 0), times=range(10, 35))
    copy(source, tmp_path / "b.mp4")
    copy(source, tmp_path / "c.mkv")
    assert_same_sound(source, tmp_path / "b.mp4")
    assert_same_sound(source, tmp_path / "c.mkv", 1.01e-3)


def test_sound_longer_than_the_film_is_whole(tmp_path):
    with av.open(str(tmp_path / "a.mkv"), "w") as out:
        film = out.add_stream("libx264", rate=25)
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p"
        sound = clips.add_sound(out, "aac")
        for k in range(3):
            frame = clips.noise("yuv420p", clips.SIZE, k, True)
            frame.pts = k
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
        clips.add_tone(out, sound, 3.0, 0)
    copy(tmp_path / "a.mkv", tmp_path / "b.mkv")
    assert_same_sound(tmp_path / "a.mkv", tmp_path / "b.mkv")


def test_everything_that_matroska_holds_comes_through(tmp_path):
    base = Fraction(1, 1000)
    marks = [{"id": 1, "start": 0, "end": 200, "time_base": base, "metadata": {"title": "One"}}]
    marks += [{"id": 2, "start": 200, "end": 400, "time_base": base, "metadata": {"title": "Two"}}]
    source = clips.make(
        tmp_path / "a.mkv",
        audio="flac",
        subtitles=True,
        attachment=True,
        cover=True,
        chapters=marks,
        tags={"title": "T"},
    )
    copy(source, tmp_path / "b.mkv")
    for path in (source, tmp_path / "b.mkv"):
        with av.open(str(path)) as out:
            assert [s.type for s in out.streams] == ["video", "audio", "subtitle", "attachment", "video"]
            assert out.metadata["title"] == "T"
            assert [(c["start"], c["end"], c["metadata"]) for c in out.chapters()] == [
                (m["start"] * 10**6, m["end"] * 10**6, m["metadata"]) for m in marks
            ]
            assert out.streams[3].data == bytes(range(256)) * 4
            assert (out.streams[3].name, out.streams[3].mimetype) == ("font.ttf", "application/x-truetype-font")
            assert out.streams[2].language == "deu"
            assert out.streams[4].disposition & av.stream.Disposition.attached_pic
    assert_same_sound(source, tmp_path / "b.mkv")
    assert clips.parcels(source, "subtitle") == clips.parcels(tmp_path / "b.mkv", "subtitle")
    assert covers(source) == covers(tmp_path / "b.mkv") == [clips.png()]


def covers(path):
    with av.open(str(path)) as source:
        pictures = [s for s in source.streams.video if s.disposition & av.stream.Disposition.attached_pic]
        return [bytes(p) for p in source.demux(pictures) if p.size]


def test_covers_and_chapters_come_through_mp4(tmp_path):
    base = Fraction(1, 1000)
    marks = [{"id": 1, "start": 0, "end": 200, "time_base": base, "metadata": {"title": "One"}}]
    source = clips.make(tmp_path / "a.mp4", audio="aac", cover=True, chapters=marks, tags={"title": "T", "artist": "A"})
    assert covers(source) == [clips.png()]
    copy(source, tmp_path / "b.mp4")
    assert covers(tmp_path / "b.mp4") == [clips.png()]
    assert_same_sound(source, tmp_path / "b.mp4")
    with av.open(str(tmp_path / "b.mp4")) as out:
        assert out.metadata["title"] == "T"
        assert out.metadata["artist"] == "A"
        assert [c["metadata"]["title"] for c in out.chapters()] == ["One"]


def flash_and_click(path):
    """A white frame and a click, both after a second."""
    with av.open(str(path), "w") as out:
        film, sound = out.add_stream("libx264", rate=25, options={"bf": "2"}), out.add_stream("aac", rate=48000)
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p"
        sound.layout = "mono"
        for k in range(50):
            planes = np.full((72, 64), 128, np.uint8)
            planes[:48] = 235 if k == 25 else 16
            frame = av.VideoFrame.from_ndarray(planes, "yuv420p")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
        wave = np.zeros((1, 94 * 1024), np.float32)
        wave[0, 48000:48096] = 0.8
        for k in range(94):
            frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(wave[:, k * 1024 :][:, :1024]), "fltp", "mono")
            frame.sample_rate, frame.pts, frame.time_base = 48000, k * 1024, Fraction(1, 48000)
            out.mux(sound.encode(frame))
        out.mux(sound.encode(None))
    return path


def seen_and_heard(path):
    """The seconds at which the frame is white, as `Clip` tells times, and the click begins."""
    with open_video(path) as clip:
        clip.passage = types.SimpleNamespace(streams=[], take=None)
        light = []
        for k, frame in enumerate(clip.frames()):
            arrays = arrays_of(clip, frame)
            light.append((arrays[0].mean(), clip.time(k)[0] * clip.base))
    with av.open(str(path)) as source:
        for frame in source.decode(audio=0):
            loud = np.flatnonzero(np.abs(frame.to_ndarray()[0]) > 0.3)
            if loud.size:
                return float(max(light)[1]), float(frame.pts * frame.time_base) + loud[0] / frame.sample_rate
    raise AssertionError("no click")


@pytest.mark.parametrize(
    ("suffix", "codec"), [("avi", "h264"), ("avi", "mpeg4"), ("mp4", "h264"), ("mkv", "h264"), ("mov", "mpeg4")]
)
def test_a_flash_and_a_click_stay_together(tmp_path, suffix, codec):
    source = flash_and_click(tmp_path / "a.mp4")
    if (suffix, codec) == ("avi", "h264"):
        with pytest.warns(ClipWarning, match="out of step by a frame in players that rest on FFmpeg: use codec mpeg4"):
            copy(source, tmp_path / "b.avi", codec=codec)
    else:
        copy(source, tmp_path / f"b.{suffix}", codec=codec)
    flash, click = seen_and_heard(tmp_path / f"b.{suffix}")
    assert flash == pytest.approx(click, abs=0.002)


def test_sound_that_begins_too_early_in_avi_is_said(tmp_path):
    source = clips.make(tmp_path / "a.mkv", count=25, audio="aac", audio_start=0.5)
    with pytest.warns(ClipWarning, match="cannot say that sound begins later: it is 0.48 s too early"):
        copy(source, tmp_path / "b.avi", codec="mpeg4")


def test_what_a_container_cannot_hold_is_said(tmp_path):
    source = clips.make(tmp_path / "a.mkv", audio="flac", subtitles=True, attachment=True)
    with pytest.warns(ClipWarning, match="cannot hold") as caught:
        copy(source, tmp_path / "b.webm")
    assert len(caught) == 3
    assert clips.parcels(tmp_path / "b.webm", "audio") == []
