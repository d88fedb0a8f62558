"""View transforms: what linear and HDR values look like on a screen."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.media.image import read, write
from supple.viewer.panels.stages import FrameCache
from supple.viewer.panels.transforms import TRANSFORMS, on_screen, seen
from tests.viewer.windows import opened


def grey(value: float, name: str) -> float:
    """How a grey of a code, or of light, is shown."""
    codes = (
        np.full((1, 1, 3), value, np.float32) if name == "linear" else np.full((1, 1, 3), round(value * 65535), "u2")
    )
    return float(seen(codes, name).mean())


# Light of sRGB's own curve; HDR's diffuse white is 203 cd/m², of which the dark half is shown in proportion.
@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("linear", 0.18, 117.6),
        ("linear", -1.0, 0.0),
        ("linear", 7.0, 255.0),
        ("linear", np.nan, 0.0),
        ("bt2020", 0.5, 127.5),
        ("pq", 0.0, 0.0),
        ("pq", 0.34269, 81.5),  # 16.9 cd/m²: 1/12 of white
        ("pq", 0.4417, 137.0),  # 50.75 cd/m²: a quarter
        ("pq", 0.7518, 255.0),  # 1000 cd/m²
        ("pq", 1.0, 255.0),
        ("hlg", 0.5, 136.9),  # 50.7 cd/m²
        ("hlg", 1.0, 255.0),
    ],
)
def test_greys(name: str, value: float, wanted: float) -> None:
    assert grey(value, name) == pytest.approx(wanted, abs=1.5)


@pytest.mark.parametrize("name", [name for name in TRANSFORMS if name])
def test_brighter_is_never_darker(name: str) -> None:
    ramp = np.repeat(np.arange(65536, dtype=np.uint16)[None, :, None], 3, axis=2)
    shown = seen(ramp, name)[0].astype(int)
    assert (np.maximum.accumulate(shown, axis=0) - shown).max() <= 1  # rounding


def test_primaries_of_bt2020_are_converted() -> None:
    light = np.array([0.6274, 0.0691, 0.0164])  # sRGB's red in BT.2020
    codes = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    shown = seen(np.rint(codes * 65535).astype(np.uint16)[None, None], "bt2020")[0, 0].astype(int)
    np.testing.assert_allclose(shown, (255, 0, 0), atol=8)


@pytest.mark.parametrize("suffix", [".exr", ".hdr", ".pfm"])
def test_linear_pictures_are_shown_as_such(gpu: Gpu, tmp_path: Path, suffix: str) -> None:
    write(tmp_path / f"in{suffix}", np.full((40, 60, 3), 0.18, np.float32))
    assert np.abs(on_screen(read(tmp_path / f"in{suffix}"), "linear")[..., :3].astype(int) - 118).max() <= 1
    view, _ = opened(tmp_path / f"in{suffix}")
    assert view.stage.transform == "linear"
    y, x = (n // 2 for n in view.pixels().shape[:2])
    assert abs(int(view.pixels()[y, x, 0]) - 118) <= 1
    view.stage.set_transform("")
    view.refresh()
    assert abs(int(view.pixels()[y, x, 0]) - 46) <= 1


@pytest.mark.parametrize(
    ("transfer", "primaries", "name"), [(16, 9, "pq"), (18, 9, "hlg"), (1, 9, "bt2020"), (1, 1, "")]
)
def test_clips_are_shown_by_their_transfer(tmp_path: Path, transfer: int, primaries: int, name: str) -> None:
    path = tmp_path / "in.mkv"
    with av.open(str(path), "w") as out:
        film = out.add_stream("libx265", rate=25, options={"x265-params": "lossless=1:log-level=none"})
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p10le"
        film.codec_context.color_trc, film.codec_context.color_primaries = transfer, primaries
        film.codec_context.colorspace, film.codec_context.color_range = 9 if primaries == 9 else 1, 1
        planes = av.VideoFrame(64, 48, "yuv420p10le")
        for plane, value in zip(planes.planes, (64 + round(876 * 0.4417), 512, 512), strict=True):
            plane.update(np.full(plane.buffer_size // 2, value, "<u2").tobytes())
        for k in range(3):
            planes.pts = k
            out.mux(film.encode(planes))
        out.mux(film.encode(None))
    cache = FrameCache(path)
    try:
        assert cache.transform == name
        assert cache.want(1, 1) or cache.arrived(60.0)
        frame = cache.get(1)
        assert frame is not None
        plain = round(255 * 0.4417)
        wanted = {"pq": 137, "hlg": grey(0.4417, "hlg")}.get(name, plain)
        np.testing.assert_allclose(frame[..., :3].astype(int), wanted, atol=2)
        cache.set_transform("")
        assert cache.want(1, 1) or cache.arrived(60.0)
        frame = cache.get(1)
        assert frame is not None
        np.testing.assert_allclose(frame[..., :3].astype(int), plain, atol=2)
    finally:
        cache.close()
