"""Image sequences that become videos, and videos that become image sequences."""

from __future__ import annotations

import warnings
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvips

from supple import SuppleError
from supple.media.image import Picture, read, write
from supple.media.sequence import open_clip as open_sequence
from supple.media.sequence import writer as sequence_writer
from supple.media.video import ClipWarning, info
from supple.media.video import open_clip as open_video
from supple.media.video import writer as writer_of
from tests import clips
from tests.media.video.copies import arrays_of
from tests.media.video.sequences import SRGB, Array, frames_of, names, numbers, picture, save

# what every film of RGB pictures says that is as players want it; `test_what_a_sequence_loses_is_said` hears it
pytestmark = pytest.mark.filterwarnings("ignore:.* loses detail of colours:supple.media.base.ClipWarning")


def film(source: Path, target: Path, rate: float = 24, **options: Any) -> None:
    with open_sequence(source, rate=rate) as clip, writer_of(clip, target, **options) as sink:
        for k, pixels in enumerate(frames_of(clip)):
            sink.write([pixels], k)


def shot(path: Path) -> tuple[dict[str, Any], list[list[Array]]]:
    """What a video file holds, and its frames."""
    with open_video(path) as clip:
        found = []
        for frame in clip.frames():
            arrays = arrays_of(clip, frame)
            found.append(arrays)
        return clip.info(), found


def gradients(folder: Path, count: int, dtype: str = "u1", shape: tuple[int, int] = (48, 64)) -> list[Array]:
    """Smooth and colourful pictures."""
    folder.mkdir()
    made = []
    y, x = np.mgrid[: shape[0], : shape[1]] / np.array(shape).reshape(2, 1, 1)
    for k in range(count):
        values = np.stack([0.1 + 0.8 * x, 0.9 - 0.7 * y, 0.3 + 0.3 * (x - y) + 0.05 * k], axis=-1)
        pixels = np.rint(values * np.iinfo(dtype).max).astype(dtype)
        write(folder / f"{k:03d}.png", pixels)
        made.append(pixels)
    return made


def bt709(pixels: Array, bits: int) -> Array:
    """Y, U, V in the limited range, by the book."""
    red, green, blue = np.moveaxis(pixels / np.iinfo(pixels.dtype).max, -1, 0)
    y = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    u, v = (blue - y) / 1.8556, (red - y) / 1.5748
    scale = 2 ** (bits - 8)
    return np.stack([16 + 219 * y, 128 + 224 * u, 128 + 224 * v], axis=-1) * scale


@pytest.mark.parametrize(
    ("rate", "want"), [(24, Fraction(24)), (23.976, Fraction(24000, 1001)), (12.5, Fraction(25, 2))]
)
@pytest.mark.parametrize("suffix", ["mp4", "mov", "avi"])
def test_frame_k_of_a_sequence_is_shown_at_k_over_rate(
    tmp_path: Path, rate: float, want: Fraction, suffix: str
) -> None:
    gradients(tmp_path / "in", 7)
    film(tmp_path / "in", tmp_path / f"a.{suffix}", rate)
    found = info(tmp_path / f"a.{suffix}")
    assert (found["frames"], found["rate"]) == (7, want)
    assert found["duration"] == pytest.approx(float(7 / want), abs=1e-3)
    if suffix != "avi":
        assert clips.when(tmp_path / f"a.{suffix}") == [k / want for k in range(7)]


def test_times_of_matroska_and_gif_are_rounded_one_by_one(tmp_path: Path) -> None:
    gradients(tmp_path / "in", 30)
    for name, unit in (("a.mkv", 1000), ("a.gif", 100)):
        film(tmp_path / "in", tmp_path / name, 23.976)
        for k, time in enumerate(clips.when(tmp_path / name)):
            assert abs(time * unit - Fraction(k * 1001 * unit, 24000)) <= Fraction(1, 2)


@pytest.mark.parametrize(
    ("name", "codec", "pixel_format", "matrix"),
    [
        ("a.mp4", "h264", "yuv420p", 1),
        ("a.mov", "h264", "yuv420p", 1),
        ("a.webm", "vp9", "yuv420p", 1),
        ("a.avi", "mpeg4", "yuv420p", 2),
        ("b.mkv", "hevc", "yuv420p", 1),
        ("b.mp4", "av1", "yuv420p", 1),
        ("b.mov", "prores", "yuv422p10le", 1),
        ("b.avi", "mjpeg", "yuvj420p", 5),
        ("b.webm", "vp8", "yuv420p", 5),
        ("c.mov", "mpeg4", "yuv420p", 1),
    ],
)
def test_colours_of_a_sequence_look_the_same(
    tmp_path: Path, name: str, codec: str, pixel_format: str, matrix: int
) -> None:
    pictures = gradients(tmp_path / "in", 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".* loses detail of colours", ClipWarning)
        film(tmp_path / "in", tmp_path / name, codec=None if name[0] == "a" else codec)
    facts, frames = shot(tmp_path / name)
    assert (facts["codec"], facts["pixel_format"], facts["matrix"]) == (codec, pixel_format, matrix)
    if matrix == 1 and name != "c.mov":
        assert (facts["range"], facts["primaries"], facts["transfer"]) == ("limited", 1, 1)
    with open_video(tmp_path / name) as clip:
        for want, arrays in zip(pictures, frames, strict=True):
            off = clip.to_rgb(arrays).astype(int) - want
            assert np.abs(off.mean(axis=(0, 1))).max() < 2
            assert np.abs(off).mean() < 2.5


@pytest.mark.parametrize(("dtype", "bits", "pixel_format"), [("u1", 8, "yuv420p"), ("u2", 10, "yuv420p10le")])
def test_the_samples_are_those_of_bt709(tmp_path: Path, dtype: str, bits: int, pixel_format: str) -> None:
    [pixels] = gradients(tmp_path / "in", 1, dtype)
    film(tmp_path / "in", tmp_path / "a.mp4", crf=1)
    facts, [[luma, chroma]] = shot(tmp_path / "a.mp4")
    assert (facts["pixel_format"], facts["bits"]) == (pixel_format, bits)
    want = bt709(pixels, bits)
    unit = 2 ** (bits - 8)
    assert np.abs(luma[..., 0] - want[..., 0]).mean() < unit
    # chroma lies at the left of its two columns, between its two lines
    sited = (want[::2, ::2, 1:] + want[1::2, ::2, 1:]) / 2
    assert np.abs((chroma - sited)[:, 1:-1]).mean() < 0.75 * unit
    assert np.abs((chroma - sited)[:, 1:-1].mean(axis=(0, 1))).max() < 0.25 * unit


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 2), (48, 64, 3), (48, 64, 4), (7, 5, 3)])
@pytest.mark.parametrize("dtype", ["u1", "u2"])
@pytest.mark.parametrize(("name", "codec"), [("a.mkv", "ffv1"), ("a.mov", "png")])
def test_lossless_codecs_keep_every_bit(
    tmp_path: Path, shape: tuple[int, ...], dtype: str, name: str, codec: str
) -> None:
    kept = save(tmp_path / "in", numbers(1, 3), shape=shape, dtype=dtype)
    with warnings.catch_warnings(action="error"):
        film(tmp_path / "in", tmp_path / name, codec=codec)
    _, frames = shot(tmp_path / name)
    assert len(frames) == 3
    for want, [found] in zip(kept, frames, strict=True):
        deep = want.reshape(*shape[:2], -1)
        if deep.shape[2] < found.shape[2]:  # where the codec has no such grey
            deep = np.concatenate([deep[..., :1]] * 3 + [deep[..., 1:]], axis=2)
        np.testing.assert_array_equal(found, deep)


def test_floats_go_into_what_holds_them(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    pixels = np.random.default_rng(0).normal(0.5, 2, (12, 16, 3)).astype(np.float32)
    write(folder / "0.tif", pixels)
    film(folder, tmp_path / "a.mkv", codec="ffv1")
    _, [[found]] = shot(tmp_path / "a.mkv")
    np.testing.assert_array_equal(found, pixels)
    for name in ("b.mp4", "b.gif", "b.webm"):
        with pytest.raises(
            SuppleError, match=r"cannot hold the floating point of .*: use codec ffv1 in \.mkv, or convert"
        ):
            film(folder, tmp_path / name)
    assert names(tmp_path) == ["a.mkv", "in"]


@pytest.mark.parametrize(
    ("kind", "codec", "lost", "keeps"),
    [
        ("u1", "h264", "detail of colours (to 4:2:0)", "yuv444p"),
        ("u2", "h264", "detail of colours (to 4:2:0) and depth (16 to 10 bits)", "yuv444p10le"),
        ("u1", "hevc", "detail of colours (to 4:2:0)", "gbrp"),
        ("u1", "mpeg4", "detail of colours (to 4:2:0)", ""),
    ],
)
def test_what_a_film_of_pictures_loses_is_said_and_what_keeps_it(
    tmp_path: Path, kind: str, codec: str, lost: str, keeps: str
) -> None:
    gradients(tmp_path / "in", 1, kind)
    with warnings.catch_warnings(record=True, action="always") as caught:
        film(tmp_path / "in", tmp_path / "a.mkv", codec=codec)
    told = f"{tmp_path / 'a.mkv'} loses {lost}" + (f": pixel_format={keeps!r} keeps more" if keeps else "")
    assert [str(warning.message) for warning in caught] == [told]
    if keeps:
        with warnings.catch_warnings(action="error"):
            film(tmp_path / "in", tmp_path / "b.mkv", codec=codec, pixel_format=keeps)
        assert info(tmp_path / "b.mkv")["pixel_format"] == keeps


def test_what_a_sequence_loses_is_said(tmp_path: Path) -> None:
    gradients(tmp_path / "in", 1, "u2")
    with pytest.warns(ClipWarning, match="depth .16 to 8 bits"):
        film(tmp_path / "in", tmp_path / "a.avi")
    gradients(tmp_path / "odd", 1, shape=(47, 63))
    with pytest.warns(ClipWarning, match="is not in yuv420p, which libx264 does not take at 63x47"):
        film(tmp_path / "odd", tmp_path / "a.mp4")
    (tmp_path / "profiled").mkdir()
    profile = bytes(pyvips.Operation.call("profile_load", "p3"))
    write(tmp_path / "profiled" / "1.png", picture(0), like=Picture(picture(0), icc=profile))
    with pytest.warns(ClipWarning, match="cannot hold the colour profile of the pictures"):
        film(tmp_path / "profiled", tmp_path / "b.mkv")
    write(tmp_path / "profiled" / "1.png", picture(0), like=Picture(picture(0), icc=SRGB), force=True)
    film(tmp_path / "profiled", tmp_path / "c.mkv")


@pytest.mark.parametrize(("kind", "bands"), [("cmyk", 4), ("lab", 3)])
def test_pictures_without_colours_are_refused(tmp_path: Path, kind: str, bands: int) -> None:
    (tmp_path / "in").mkdir()
    pyvips.Image.black(8, 8, bands=bands).copy(interpretation=kind).tiffsave(str(tmp_path / "in" / "1.tif"))
    with pytest.raises(SuppleError, match="neither grey nor RGB pictures: convert them"):
        film(tmp_path / "in", tmp_path / "a.mp4")
    assert names(tmp_path) == ["in"]


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_a_film_becomes_the_pictures_that_it_was_made_of(tmp_path: Path, dtype: str) -> None:
    kept = save(tmp_path / "in", numbers(1, 3), shape=(6, 8, 4), dtype=dtype)
    film(tmp_path / "in", tmp_path / "a.mkv", codec="ffv1")
    for target, found in (("out", numbers(1, 3)), ("out/%d.png", ["1.png", "2.png", "3.png"])):
        with open_video(tmp_path / "a.mkv") as clip, sequence_writer(clip, tmp_path / target) as sink:
            for k, frame in enumerate(clip.frames()):
                arrays = arrays_of(clip, frame)
                sink.write(arrays, k)
        for want, name in zip(kept, found, strict=True):
            picture = read(tmp_path / "out" / name)
            assert picture.alpha
            np.testing.assert_array_equal(picture.pixels, want)


@pytest.mark.parametrize(("name", "dtype"), [("yuv420p", np.uint8), ("yuv420p10le", np.uint16)])
def test_pictures_of_a_clip_have_its_depth(tmp_path: Path, name: str, dtype: Any) -> None:
    path = clips.make(tmp_path / "a.mkv", "ffv1", name, 1)
    with open_video(path) as clip, sequence_writer(clip, tmp_path / "out") as sink:
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        next(clip.frames()).copy_to(arrays)
        sink.write(arrays, 0)
        wanted = clip.to_rgb(arrays, deep=dtype is np.uint16)
    picture = read(tmp_path / "out" / "00001.png")
    assert (picture.pixels.dtype, picture.alpha) == (dtype, False)
    np.testing.assert_array_equal(picture.pixels, wanted)
