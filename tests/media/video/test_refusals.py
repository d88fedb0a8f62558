"""What cannot be written is refused before any frame, and nothing is left behind."""

import pytest

from supple.errors import SuppleError
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import assert_nothing_left

REFUSED = [
    ("b.mp4", {"codec": "nonsense"}, "no video encoder is called nonsense: use h264"),
    ("b.mp4", {"codec": "aac"}, "no video encoder is called aac"),
    ("b.webm", {"codec": "h264"}, "webm cannot hold h264: use vp9"),
    ("b.gif", {"codec": "h264"}, "gif cannot hold h264"),
    ("b.mp4", {"crf": 99}, "crf 99 is none of libx264's: choose from 0"),
    ("b.mp4", {"crf": -1}, "crf -1"),
    ("b.mp4", {"crf": float("nan")}, "crf nan"),
    ("b.mkv", {"codec": "ffv1", "crf": 3}, "ffv1 has no crf"),
    ("b.mkv", {"codec": "ffv1", "preset": "fast"}, "ffv1 has no presets"),
    ("b.mp4", {"preset": "quick"}, "libx264 has no preset quick: use ultrafast"),
    ("b.mp4", {"pixel_format": "rgb24"}, "libx264 does not take the pixel format 'rgb24': use yuv420p"),
    ("b.mp4", {"pixel_format": "mad"}, "does not take the pixel format 'mad'"),
    ("b.gif", {"pixel_format": "rgb24"}, "use pal8"),
    ("b.gif", {"lossless": True}, "gif always loses something: use ffv1"),
    ("b.mov", {"codec": "prores", "lossless": True}, "prores always loses something"),
    ("b.avi", {"codec": "mpeg4", "lossless": True}, "mpeg4 always loses something"),
    ("b.mov", {"codec": "png", "lossless": True}, "png loses exact values"),
    ("b.mp4", {"codec": "h264", "lossless": True, "crf": 0}, "crf 0 is for what may lose something"),
    (
        "b.mkv",
        {"codec": "av1", "preset": "11", "crf": 7},
        "preset 11 fails if lossless, or below crf 8: use preset 10 or less",
    ),
    ("b.mkv", {"codec": "av1", "preset": "13", "crf": 1}, "preset 13 fails if"),
    ("b.mkv", {"codec": "av1", "preset": "12", "lossless": True}, "preset 12 fails if lossless"),
    ("b.mp5", {}, "the suffix .mp5 is no video format: use .mp4"),
    ("b", {}, "a name without suffix"),
    ("no/b.mp4", {}, "there is no folder"),
]


@pytest.mark.parametrize(("target", "settings", "message"), REFUSED)
def test_what_cannot_be_is_refused_before_any_frame(tmp_path, target, settings, message):
    source = clips.make(tmp_path / "a.mp4", count=2)
    with (
        open_video(source) as clip,
        pytest.raises(SuppleError, match=message) as caught,
        clip.writer(tmp_path / target, **settings),
    ):
        pytest.fail("the block must not run")
    assert "\n" not in str(caught.value)
    assert_nothing_left(tmp_path, "a.mp4")
