"""Damaged videos, and what is no video, are said."""

import os
import warnings
from fractions import Fraction

import av
import numpy as np
import pytest

from supple.errors import SuppleError
from supple.media.video import ClipWarning, info
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import assert_nothing_left, copy


def gone_wrong(source, folder, target="b.mkv"):
    """Copy; whatever is wrong with the source, one error of Supple's or a warning comes of it, and no partial file."""
    before = sorted(os.listdir(folder))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ClipWarning)
        try:
            count = copy(source, folder / target)
        except SuppleError as error:
            said = str(error)
            count = None
    if count is None:
        assert "\n" not in said
        assert sorted(os.listdir(folder)) == before
        return said
    assert len(clips.decoded(folder / target)) == count
    (folder / target).unlink()
    return count


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi", "webm", "gif", "h264"])
def test_truncated_files(tmp_path, suffix):
    codec = {"gif": "gif", "webm": "libvpx-vp9"}.get(suffix, "libx264")
    whole = tmp_path / f"a.{suffix}"
    name = "rgb8" if suffix == "gif" else "yuv420p"
    sound = {"mp4": "aac", "mkv": "aac", "ts": "aac", "avi": "libmp3lame", "webm": "libopus"}.get(suffix)
    clips.make(whole, codec, name, audio=sound, container="h264" if suffix == "h264" else None)
    data = whole.read_bytes()
    random = np.random.default_rng(0)
    cuts = [1, 8, 40, 200, 1000, *random.integers(0, len(data), 12).tolist(), len(data) - 1]
    results = []
    for cut in cuts:
        part = tmp_path / f"part.{suffix}"
        part.write_bytes(data[:cut])
        results.append(gone_wrong(part, tmp_path))
    assert any(isinstance(result, str) for result in results)
    assert all(isinstance(result, str) or 0 < result <= 10 for result in results)


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi"])
def test_corrupt_files(tmp_path, suffix):
    whole = clips.make(tmp_path / f"a.{suffix}", count=20, options={"bf": "2"}, smooth=False, audio="libmp3lame")
    data = bytearray(whole.read_bytes())
    random = np.random.default_rng(1)
    for _ in range(6):
        harm = data.copy()
        for place in random.integers(0, len(data), 12):
            harm[place] = random.integers(0, 256)
        part = tmp_path / f"part.{suffix}"
        part.write_bytes(harm)
        gone_wrong(part, tmp_path)


def test_a_cut_clip_is_used_with_a_warning(tmp_path):
    whole = clips.make(tmp_path / "a.mkv", "ffv1", count=10, smooth=False)
    data = whole.read_bytes()
    (tmp_path / "part.mkv").write_bytes(data[: len(data) * 6 // 10])
    with pytest.warns(ClipWarning, match="damaged"):
        count = copy(tmp_path / "part.mkv", tmp_path / "b.mkv")
    assert 4 <= count <= 6


@pytest.mark.filterwarnings("ignore:.* plays over and over")
def test_a_cut_gif_is_used_with_a_warning(tmp_path):
    whole = clips.make(tmp_path / "a.mkv", "ffv1", count=10, smooth=False)
    copy(whole, tmp_path / "a.gif")
    data = (tmp_path / "a.gif").read_bytes()
    (tmp_path / "part.gif").write_bytes(data[: len(data) * 6 // 10])
    with pytest.warns(ClipWarning, match="part.gif is damaged or cut short"):
        assert 4 <= copy(tmp_path / "part.gif", tmp_path / "b.mkv") <= 6
    (tmp_path / "padded.gif").write_bytes(data + bytes(100))
    assert copy(tmp_path / "padded.gif", tmp_path / "c.mkv") == 10


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        ("mkv", "libx264", {}),
        ("mp4", "libx264", {"movflags": "faststart"}),
        ("mov", "prores_ks", {"movflags": "faststart"}),
        ("avi", "mpeg4", {}),
    ],
)
def test_a_warning_says_how_much_of_a_cut_clip_is_lost(tmp_path, suffix, codec, options):
    name = "yuv422p10le" if suffix == "mov" else "yuv420p"
    with av.open(str(tmp_path / f"a.{suffix}"), "w", container_options=options) as out:
        stream = out.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, name
        for k in range(45):
            out.mux(stream.encode(clips.noise(name, (64, 48), k)))
        out.mux(stream.encode(None))
    data = (tmp_path / f"a.{suffix}").read_bytes()
    (tmp_path / f"part.{suffix}").write_bytes(data[: len(data) // 3])
    with warnings.catch_warnings(record=True, action="always") as caught:
        count = copy(tmp_path / f"part.{suffix}", tmp_path / "b.mkv")
    assert 10 <= count <= 18
    lost = f"{45 - count} of its 45 frames ({(45 - count) / 25:.2f} of 1.80 s) are lost"
    (told,) = (str(each.message) for each in caught)
    assert lost in told
    assert "damaged" in told
    with warnings.catch_warnings(action="error"):
        assert copy(tmp_path / f"a.{suffix}", tmp_path / "c.mkv") == 45


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mp4", b"", "it is empty"),
        ("a.mp4", b"this is a text, and no film at all\n" * 50, "it is no video"),
        ("a.txt", b"this is a text, and no film at all\n" * 50, "it is"),
        ("a.mkv", bytes(5000), "it is no video"),
        ("a.srt", b"1\n00:00:01,000 --> 00:00:02,000\nWord\n\n", "no film"),
    ],
)
def test_no_video(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SuppleError, match=message), open_video(tmp_path / name):
        pass
    with pytest.raises(SuppleError, match="cannot read"):
        info(tmp_path / name)


def test_lists_of_files_are_not_followed(tmp_path):
    clips.make(tmp_path / "a.ts")
    (tmp_path / "a.txt").write_text("ffconcat version 1.0\nfile a.ts\n")
    (tmp_path / "a.m3u8").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\na.ts\n#EXT-X-ENDLIST\n")
    for name in ("a.txt", "a.m3u8"):
        with pytest.raises(SuppleError, match="cannot read"), open_video(tmp_path / name):
            pass


def test_a_clip_that_begins_late_is_not_damaged(tmp_path):
    times = [10**8 + 40 * k for k in range(5)]
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=5, times=times, base=Fraction(1, 1000))
    with warnings.catch_warnings(action="error"):
        copy(source, tmp_path / "b.mkv")
    assert [t * 1000 for t in clips.when(tmp_path / "b.mkv")] == times


@pytest.mark.parametrize(("target", "gap"), [("b.mp4", 10**9), ("b.mov", 10**9), ("b.gif", 10**6)])
def test_gaps_that_a_file_cannot_tell_are_refused(tmp_path, target, gap):
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=3, times=[0, 1, gap], base=Fraction(1, 1000))
    with pytest.raises(SuppleError, match=f"frame 2 comes {gap // 1000} s after the one before"):
        copy(source, tmp_path / target, codec=None if target == "b.gif" else "h264")
    assert_nothing_left(tmp_path, "a.mkv")


def test_no_file(tmp_path):
    for path, message in (
        (tmp_path / "no.mp4", "No such file"),
        (tmp_path, "folder"),
        ("a\0b.mp4", "no file can have"),
    ):
        with pytest.raises(SuppleError, match=message), open_video(path):
            pass


def test_sound_alone(tmp_path):
    for name, codec in (("a.m4a", "aac"), ("a.wav", "pcm_s16le"), ("a.mp3", "libmp3lame")):
        with av.open(str(tmp_path / name), "w") as out:
            clips.add_tone(out, clips.add_sound(out, codec), 0.5, 0)
        with pytest.raises(SuppleError, match="sound and no film"), open_video(tmp_path / name):
            pass


def test_a_cover_is_no_film(tmp_path):
    with av.open(str(tmp_path / "a.m4a"), "w", format="mp4") as out:
        sound = clips.add_sound(out, "aac")
        picture = clips.add_cover(out)
        out.start_encoding()
        out.mux(picture)
        clips.add_tone(out, sound, 0.5, 0)
    with pytest.raises(SuppleError, match="cover picture"), open_video(tmp_path / "a.m4a"):
        pass


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])  # of which the second drops a frame there
def test_a_size_that_changes_is_said(tmp_path, codec):
    one = clips.make(tmp_path / "a.ts", codec, count=5)
    two = clips.make(tmp_path / "b.ts", codec, count=5, size=(32, 32))
    (tmp_path / "c.ts").write_bytes(one.read_bytes() + two.read_bytes())
    message = r"its frames change at about frame \d, from 64x48 yuv420p to 32x32 yuv420p"
    with pytest.raises(SuppleError, match=message):
        copy(tmp_path / "c.ts", tmp_path / "d.mp4")
    assert_nothing_left(tmp_path, "a.ts", "b.ts", "c.ts")


def test_joined_broadcasts_go_on(tmp_path):
    one = clips.make(tmp_path / "a.ts", count=10, audio="aac")
    (tmp_path / "c.ts").write_bytes(one.read_bytes() * 2)
    copy(tmp_path / "c.ts", tmp_path / "d.mp4")
    times = np.array([float(t) for t in clips.when(tmp_path / "d.mp4")])
    assert len(times) == 20
    assert np.diff(times) == pytest.approx(0.04, abs=0.05)
    sound = [float(t) for _, t, _ in clips.parcels(tmp_path / "d.mp4", "audio")]
    assert len(sound) == 2 * len(clips.parcels(one, "audio"))
    assert (np.diff(sound) > 0).all()
