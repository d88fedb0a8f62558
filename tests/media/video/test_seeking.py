"""Frames in the middle of a clip, decoded from the key frame before, are those that decoding from the start gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.media.video import Clip
from supple.media.video import open_clip as open_video
from supple.media.video.demux import index_of
from supple.viewer.panels.stages import FrameCache
from tests.clips import make

COUNT = 40
GOPS: dict[str, dict[str, Any]] = {
    "b-frames": {"options": {"g": "10", "bf": "3", "x264-params": "scenecut=0"}},
    "open": {"options": {"g": "10", "bf": "3", "x264-params": "open-gop=1:scenecut=0:b-pyramid=normal"}},
    "hevc open": {"codec": "libx265", "options": {"x265-params": "keyint=10:open-gop=1:bframes=3:log-level=none"}},
    "mpeg2 open": {"codec": "mpeg2video", "options": {"g": "10", "bf": "2", "b": "2M"}},
    "variable": {"options": {"g": "8", "bf": "2"}, "times": [k * 2 + (k % 3 == 1) for k in range(COUNT)]},
    "refresh": {"options": {"g": "10", "x264-params": "intra-refresh=1:bframes=0"}},
}


def samples(picture: Any, clip: Any) -> bytes:
    arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
    picture.copy_to(arrays)
    return b"".join(a.tobytes() for a in arrays)


@pytest.mark.parametrize("kind", list(GOPS))
@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi"])
def test_what_is_sought_is_what_decoding_from_the_start_gives(kind: str, suffix: str, tmp_path: Path) -> None:
    options = GOPS[kind]
    if suffix == "avi" and kind != "mpeg2 open":
        pytest.skip("it holds no times")
    path = make(tmp_path / f"clip.{suffix}", count=COUNT, smooth=False, **options)
    with open_video(path) as clip:
        whole = [samples(picture, clip) for picture in clip.frames()]
        assert len(whole) == COUNT
        assert len(set(whole)) == COUNT
        for k in (0, 9, 10, 19, 23, 31, 39):
            for number, (k_found, picture) in zip(range(k, k + 4), clip.frames_from(k), strict=False):
                assert k_found == number
                assert samples(picture, clip) == whole[number], (k, number)
        numbers = [k for k, _ in clip.frames_from(COUNT - 3)]
        assert numbers == [COUNT - 3, COUNT - 2, COUNT - 1]
        if kind == "b-frames" and suffix in ("mp4", "mkv"):
            assert clip.key_before(25) == 20
            assert clip.key_before(9) == 0
        if suffix in ("ts", "avi"):
            assert index_of(path, COUNT) is None
            assert clip.key_before(25) == 0


def test_times_that_do_not_say_which_frame_is_which_are_not_trusted(tmp_path: Path) -> None:
    path = make(tmp_path / "clip.mp4", count=20, options={"g": "5"})
    assert index_of(path, 20) is not None
    assert index_of(path, 19) is None


def test_a_film_goes_back_without_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(
        tmp_path / "clip.mp4", count=120, smooth=False, options={"g": "10", "bf": "3", "x264-params": "scenecut=0"}
    )
    with open_video(path) as clip:
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        wanted = []
        for picture in clip.frames():
            picture.copy_to(arrays)
            wanted.append(clip.to_rgb(arrays))
    film = FrameCache(path, room=8 * 4 * 64 * 48)  # eight frames
    begun: list[int] = []
    sought = Clip._sought

    def seen(self: Any, start: int) -> Any:
        begun.append(start)
        return sought(self, start)

    monkeypatch.setattr(Clip, "_sought", seen)
    try:
        for k in (0, 100, 55, 117, 3, 56):
            assert film.want(k, k + 1) or film.arrived(30.0)
            for frame in (k, k + 1):
                found = film.get(frame)
                assert found is not None
                np.testing.assert_array_equal(found[..., :3], wanted[frame])
        assert {start // 512 for start in begun} >= {50, 100, 110}
        assert not film.error
    finally:
        film.close()
