"""Which codec and which pixel format a clip is written in, and what an encoder keeps."""

import os
import subprocess
import sys
import warnings
from fractions import Fraction

import av
import numpy as np
import pytest

from supple.errors import SuppleError
from supple.media import codecs
from supple.media.suffixes import CLIPS_OUT
from supple.media.video import ClipWarning, info, plan
from tests import clips
from tests.children import ROOT
from tests.media.video.copies import assert_nothing_left, copy, read


@pytest.mark.parametrize(
    ("codec", "suffix", "target", "want", "said"),
    [
        ("libx264", "mp4", "mp4", "h264", ""),
        ("libx265", "mp4", "mkv", "hevc", ""),
        ("libvpx-vp9", "webm", "webm", "vp9", ""),
        ("libx264", "mp4", "webm", "vp9", ""),
        ("mpeg4", "avi", "avi", "mpeg4", ""),
        ("ffv1", "mkv", "mkv", "ffv1", ""),
        ("ffv1", "mkv", "mov", "h264", "is written as h264: .mov cannot hold ffv1"),
        ("utvideo", "avi", "mkv", "ffv1", ""),
        ("libsvtav1", "mkv", "mp4", "av1", ""),
        ("libsvtav1", "mkv", "mov", "h264", "is written as h264: .mov cannot hold av1"),
        ("libvpx-vp9", "webm", "mov", "h264", "is written as h264: .mov cannot hold vp9"),
        ("libvpx", "webm", "mov", "h264", "is written as h264: .mov cannot hold vp8"),
        ("libvpx", "webm", "mp4", "h264", "is written as h264: .mp4 cannot hold vp8"),
        ("qtrle", "mov", "mkv", "ffv1", ""),
        ("rv10", "rm", "mkv", "h264", "is written as h264: .mkv cannot hold rv10"),
        ("mpeg2video", "ts", "mp4", "mpeg2video", ""),
        ("libx264", "mp4", "gif", "gif", ""),
        ("ffv1", "mkv", "webm", "vp9", "is written as vp9: .webm cannot hold ffv1"),
    ],
)
def test_the_codec_is_the_sources_or_the_containers(tmp_path, codec, suffix, target, want, said):
    form, size = ("rgb24", (64, 48)) if codec == "qtrle" else ("yuv420p", (176, 144) if codec == "rv10" else (64, 48))
    source = clips.make(tmp_path / f"a.{suffix}", codec, form, count=10, size=size)
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(source, tmp_path / f"b.{target}")
    assert [str(each.message).partition(f"b.{target} ")[2] for each in caught] == ([said] if said else [])
    assert info(tmp_path / f"b.{target}")["codec"] == want
    assert info(tmp_path / f"b.{target}")["frames"] == 10


@pytest.mark.parametrize(
    ("name", "codec", "want", "lost"),
    [
        ("yuv422p12le", "h264", "yuv422p10le", "depth"),
        ("yuv411p", "h264", "yuv422p", ""),
        ("yuv440p", "h264", "yuv444p", ""),
        ("gbrp", "h264", "yuv420p", "YUV"),
        ("gbrp", "hevc", "gbrp", ""),
        ("gray", "vp8", "yuv420p", ""),
        ("yuv420p", "prores", "yuv422p10le", ""),
        ("yuva444p12le", "prores", "yuva444p12le", "depth"),
        ("rgb48le", "png", "rgb48be", ""),
        ("yuv420p", "png", "rgb24", "RGB"),
        ("yuv420p", "mjpeg", "yuvj420p", "full range"),
        ("nv12", "h264", "yuv420p", ""),
        ("yuv444p", "mpeg4", "yuv420p", "detail"),
    ],
)
def test_the_pixel_format_is_the_nearest(tmp_path, name, codec, want, lost):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 3)
    target = tmp_path / ("b.mov" if codec != "vp8" else "b.mkv")
    if lost:
        with pytest.warns(ClipWarning, match=lost):
            copy(source, target, codec=codec)
    else:
        copy(source, target, codec=codec)
    found = info(target)["pixel_format"]
    assert found in (want, "nv12") or found.replace("j", "") == want


EXACT = [
    ("h264", "mp4", "yuv420p"),
    ("h264", "mkv", "yuv444p10le"),
    ("h264", "avi", "yuvj420p"),
    ("libx264rgb", "mkv", "rgb24"),
    ("hevc", "mp4", "yuv422p12le"),
    ("hevc", "mkv", "gbrp"),
    ("vp9", "webm", "yuv444p"),
    ("vp9", "webm", "yuva420p"),
    (None, "webm", "yuv420p"),
    ("av1", "mkv", "yuv420p"),
    ("av1", "mp4", "yuv420p10le"),
    ("ffv1", "mkv", "gray16le"),
    ("utvideo", "avi", "yuv422p"),
    ("huffyuv", "avi", "yuv422p"),
    ("png", "mov", "rgb24"),
    (None, "mkv", "yuva444p10le"),
]


@pytest.mark.parametrize(("codec", "suffix", "name"), EXACT)
def test_lossless_is_bit_for_bit(tmp_path, codec, suffix, name):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 4, (128, 96), smooth=False)
    target = tmp_path / f"b.{suffix}"
    copy(source, target, codec=codec, lossless=True)
    if codec not in (None, "libx264rgb"):
        assert info(target)["codec"] == codec
    before, after = read(source), read(target)
    assert len(before) == len(after) == 4
    for one, two in zip(before, after, strict=True):
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("preset", "crf"), [("10", 1), ("11", 8), ("13", 8)])
def test_what_av1_is_let_write_decodes(tmp_path, preset, crf):
    source = clips.make(tmp_path / "a.nut", "rawvideo", count=6, size=(320, 192), smooth=False)
    copy(source, tmp_path / "b.mkv", codec="av1", preset=preset, crf=crf)
    assert len(clips.decoded(tmp_path / "b.mkv")) == 6


def test_a_source_whose_profile_no_codec_takes_is_written_in_another(tmp_path, monkeypatch):
    source = clips.make(tmp_path / "a.mov", "prores_ks", "yuv422p10le", 2)
    opens = plan.WritePlan.opens
    monkeypatch.setattr(plan.WritePlan, "opens", lambda self, m: self.encoder.codec != "prores" and opens(self, m))
    with pytest.warns(ClipWarning, match="is written as h264: prores cannot be written as the source has it"):
        copy(source, tmp_path / "b.mov")
    assert info(tmp_path / "b.mov")["codec"] == "h264"
    with pytest.raises(SuppleError, match="does not take frames of"):
        copy(source, tmp_path / "c.mov", codec="prores")
    assert_nothing_left(tmp_path, "a.mov", "b.mov")


@pytest.mark.parametrize(
    ("name", "profile", "want"),
    [
        ("yuv422p", "dnxhr_lb", "DNXHR LB"),
        ("yuv422p", "dnxhr_hq", "DNXHR HQ"),
        ("yuv422p10le", "dnxhr_hqx", "DNXHR HQX"),
        ("yuv444p10le", "dnxhr_444", "DNXHR 444"),
    ],
)
def test_profiles_of_dnxhr_are_passed_on(tmp_path, name, profile, want):
    source = clips.make(tmp_path / "a.mov", "dnxhd", name, 2, (320, 192), options={"profile": profile})
    copy(source, tmp_path / "b.mov")
    with av.open(str(tmp_path / "b.mov")) as made:
        assert made.streams.video[0].codec_context.profile == want
        assert made.streams.video[0].codec_context.pix_fmt == name


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_frames_of_hevc(tmp_path, count):
    """Of which x265 gives no times of decoding, but what lies in memory."""
    source = clips.make(tmp_path / "a.mp4", count=count)
    for target in ("b.mp4", "b.mov", "b.mkv"):
        for _ in range(4):
            copy(source, tmp_path / target, codec="hevc")
            assert clips.when(tmp_path / target) == [Fraction(k, 25) for k in range(count)]


def test_values_stay_where_depth_and_chroma_grow(tmp_path):
    source = clips.make(tmp_path / "a.nut", "rawvideo", "yuv420p", 1, smooth=False)
    copy(source, tmp_path / "b.mkv", codec="ffv1", pixel_format="yuv420p10")
    [before], [after] = read(source), read(tmp_path / "b.mkv")
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a.astype(int) * 4, b)
    copy(source, tmp_path / "b.mkv", codec="ffv1", pixel_format="yuv444p")
    [[after]] = read(tmp_path / "b.mkv")
    np.testing.assert_array_equal(before[0][..., 0], after[..., 0])


@pytest.mark.parametrize("size", [(65, 49), (64, 49), (1, 1), (2, 2), (7, 3)])
@pytest.mark.parametrize("codec", ["h264", "hevc", "vp9", "ffv1", "mpeg4"])
def test_odd_sizes(tmp_path, size, codec):
    source = clips.make(tmp_path / "a.nut", "rawvideo", "yuv420p", 3, size)
    with warnings.catch_warnings(action="ignore", category=ClipWarning):
        if size[0] < 16 and codec == "hevc":
            with pytest.raises(SuppleError, match="does not take frames of"):
                copy(source, tmp_path / "b.mkv", codec=codec)
            assert_nothing_left(tmp_path, "a.nut")
        else:
            copy(source, tmp_path / "b.mkv", codec=codec)
            assert [a.width for a in clips.decoded(tmp_path / "b.mkv")] == [size[0]] * 3


def test_each_container_is_written_under_its_first_suffix() -> None:
    assert tuple(container.suffixes[0] for container in codecs.CONTAINERS) == CLIPS_OUT


@pytest.mark.parametrize("container", codecs.CONTAINERS, ids=lambda each: each.name)
def test_every_codec_that_is_listed_can_be_written(tmp_path, container):
    target = tmp_path / f"b{container.suffixes[0]}"
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=4)
    with pytest.raises(SuppleError, match="use ") as told:
        copy(source, target, codec="nothing")
    listed = str(told.value).rpartition("use ")[2].split(", ")
    assert container.usual in listed
    for codec in listed:
        with warnings.catch_warnings(action="ignore", category=ClipWarning):  # of pixel formats
            copy(source, target, codec=codec)
        with av.open(str(target)) as made:
            assert made.streams.video[0].codec_context.codec.canonical_name == codec
            assert len(list(made.decode(video=0))) == 4


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this system has no such priorities")
@pytest.mark.parametrize("codec", ["av1", "vp9", "hevc"])
def test_an_encoder_leaves_the_priority_of_its_caller(tmp_path, codec):
    """As root, SVT-AV1 makes it a real-time one, and encoders that wait for threads starve them."""
    before = os.sched_getscheduler(0)
    copy(clips.make(tmp_path / "a.mkv", "ffv1", count=2), tmp_path / "b.mkv", codec=codec)
    assert os.sched_getscheduler(0) == before


@pytest.mark.filterwarnings("ignore:.* plays over and over")
def test_one_frame(tmp_path):
    for suffix in ("mp4", "mkv", "avi", "gif", "webm", "mov"):
        source = clips.make(tmp_path / "a.mkv", "libx264", count=1)
        copy(source, tmp_path / f"b.{suffix}", codec=None if suffix in ("gif", "webm") else "h264")
        assert info(tmp_path / f"b.{suffix}")["frames"] == 1
        assert copy(tmp_path / f"b.{suffix}", tmp_path / "c.mkv", codec="ffv1") == 1


SILENT = """
import sys
sys.path.insert(0, sys.argv[3])
from tests.media.video.copies import copy
for codec in ("h264", "hevc", "av1", "vp9"):
    copy(sys.argv[1], sys.argv[2], codec=codec)
"""


def test_encoders_are_silent(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1")
    command = [sys.executable, "-c", SILENT, str(source), str(tmp_path / "b.mkv"), str(ROOT)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=100, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize(("target", "bits", "options"), [("b.mkv", 10, {"codec": "h264"}), ("b.gif", 8, {})])
def test_depth_is_said_to_be_lost_if_a_frame_has_it(tmp_path, lost, target, bits, options):
    with av.open(str(tmp_path / "a.mkv"), "w") as out:
        film = out.add_stream("ffv1", rate=25)
        film.width, film.height, film.pix_fmt = 64, 48, "yuv422p12le"
        for k in range(3):
            frame = av.VideoFrame(64, 48, "yuv422p12le")
            for plane in frame.planes:
                values = 16 * np.arange(plane.buffer_size // 2) % 4000 + (lost and k == 1)
                plane.update(values.astype("<u2").tobytes())
            frame.pts = k
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(tmp_path / "a.mkv", tmp_path / target, **options)
    assert [f"loses depth (12 to {bits} bits)" in str(each.message) for each in caught] == [True] * lost
