"""Rotation, colours, grading and opacity come through, or their loss is told."""

import warnings
from fractions import Fraction

import av
import numpy as np
import pytest

from supple.media.video import ClipWarning, info
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import arrays_of, assert_same_frames, copy, read


def test_rotation_aspect_and_colours_come_through(tmp_path):
    def setup(stream):
        stream.set_display_rotation(90)
        context = stream.codec_context
        context.sample_aspect_ratio = Fraction(4, 3)
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 9, 9, 16

    source = clips.make(tmp_path / "a.mp4", setup=setup)
    for target, codec in (("b.mp4", None), ("c.mov", "prores"), ("d.mkv", "ffv1"), ("e.mp4", "hevc"), ("f.mp4", "av1")):
        with warnings.catch_warnings():
            if target == "d.mkv":
                warnings.filterwarnings("ignore", ".*cannot say that pixels are 4/3")
            copy(source, tmp_path / target, codec=codec)
        a, b = clips.decoded(source)[0], clips.decoded(tmp_path / target)[0]
        assert (a.rotation, b.rotation) == (90, 90), target
        for name in ("color_range", "colorspace", "color_primaries", "color_trc"):
            assert getattr(a, name) == getattr(b, name), (target, name)
        if target != "d.mkv":
            assert info(tmp_path / target)["aspect"] == Fraction(4, 3), target


def test_full_range_stays_full(tmp_path):
    def setup(stream):
        stream.codec_context.color_range = 2

    source = clips.make(tmp_path / "a.mp4", setup=setup)
    copy(source, tmp_path / "b.mkv", codec="ffv1")
    assert_same_frames(source, tmp_path / "b.mkv")
    assert info(tmp_path / "b.mkv")["range"] == "full"


def test_grading_comes_through(tmp_path):
    master = "G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)L(10000000,50)"
    params = f"log-level=none:hdr10=1:master-display={master}:max-cll=1000,400"
    source = clips.make(tmp_path / "a.mp4", "libx265", "yuv420p10le", options={"x265-params": params})
    for target, codec in (("b.mp4", None), ("c.mkv", "av1"), ("d.mp4", "h264")):
        copy(source, tmp_path / target, codec=codec)
        with open_video(source) as one, open_video(tmp_path / target) as two:
            assert one.grading.light == two.grading.light == (1000, 400)
            assert two.grading.screen == pytest.approx(one.grading.screen, rel=0.02), target


@pytest.mark.parametrize(("target", "codec"), [("b.mkv", "ffv1"), ("b.mov", "prores"), ("b.webm", "vp9")])
def test_grading_that_is_lost_is_said(tmp_path, target, codec):
    params = "log-level=none:hdr10=1:max-cll=1000,400"
    source = clips.make(tmp_path / "a.mp4", "libx265", "yuv420p10le", options={"x265-params": params})
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(source, tmp_path / target, codec=codec)
    told = f"loses the light levels of HDR, which {codec} cannot hold"
    assert sum(told in str(warning.message) for warning in caught) == 1


def test_opacity_that_is_lost_is_said_once_and_only_if_there_is_any(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", "yuva420p")
    with pytest.warns(ClipWarning, match="loses opacity") as caught:
        copy(source, tmp_path / "b.mp4", codec="h264")
    assert len(caught) == 1
    with open_video(source) as clip, clip.writer(tmp_path / "c.mp4", codec="h264") as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = arrays_of(clip, frame)
            arrays[0][..., 1] = 255
            sink.write(arrays, k)


def test_opacity_that_the_container_drops_is_said(tmp_path):
    def setup(stream):
        stream.metadata["alpha_mode"] = "1"

    source = clips.make(tmp_path / "a.webm", "libvpx-vp9", "yuva420p", setup=setup)
    with pytest.warns(ClipWarning, match="b.mp4 loses opacity"):
        copy(source, tmp_path / "b.mp4")
    assert info(tmp_path / "b.mp4")["codec"] == "vp9"
    copy(source, tmp_path / "c.mkv")
    assert info(tmp_path / "c.mkv")["alpha"]


@pytest.mark.parametrize(("opacity", "told"), [((0, 255), False), ((0, 128), True)])
def test_half_opacity_that_gif_drops_is_said(tmp_path, opacity, told):
    source = clips.make(tmp_path / "a.mkv", "ffv1", "bgra", count=3)
    heard = warnings.catch_warnings(record=True, action="always")
    with heard as caught, open_video(source) as clip, clip.writer(tmp_path / "b.gif") as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = arrays_of(clip, frame)
            arrays[0][..., 3] = opacity[k % 2]
            sink.write(arrays, k)
    assert len(caught) == told
    assert not told or "half transparent" in str(caught[0].message)


@pytest.mark.parametrize("name", ["yuv444p", "yuv444p10le", "gbrp12le", "rgb48le", "gray12le", "gbrpf32le", "yuv420p"])
@pytest.mark.parametrize("full", [False, True])
def test_deep_rgb(tmp_path, name, full):
    def setup(stream):
        stream.codec_context.color_range, stream.codec_context.colorspace = 2 if full else 1, 1

    setup = setup if "yuv" in name or "gray" in name else None
    path = clips.make(
        tmp_path / "a.mkv", "ffv1", name, 1, smooth=False, setup=setup, options={"strict": "experimental"}
    )
    [arrays] = read(path)
    with open_video(path) as clip:
        deep, plain = clip.to_rgb(arrays, deep=True), clip.to_rgb(arrays)
        layout = clip.layout
    assert deep.dtype == np.uint16
    assert deep.shape == plain.shape == (48, 64, 3)
    assert np.abs(deep / 257 - plain).max() < 0.51
    values = arrays[0].astype(float)
    if name == "yuv420p":
        return
    if "yuv" in name or "gray" in name:
        top = layout.white if full else 235 / 16 * 2 ** round(np.log2(layout.white + 1)) / 16
        low = 0 if full else top * 16 / 235
        values = (values - [low, *[(layout.white + 1) / 2] * 2][: values.shape[2]]) / (top - low)
    else:
        values /= layout.white
    if "yuv" in name:
        y, u, v = np.moveaxis(values, -1, 0)
        u, v = (c if full else c * 219 / 224 for c in (u, v))
        values = np.stack([y + 1.5748 * v, y - 0.187324 * u - 0.468124 * v, y + 1.8556 * u], axis=-1)
    off = np.abs(np.clip(values, 0, 1) * 65535 - deep)
    assert off.max() < (257 if "yuv" in name else 40)


@pytest.mark.parametrize(
    ("codec", "name", "lossless"),
    [("mjpeg", "b.mov", False), ("mpeg4", "b.avi", False), ("vp8", "b.webm", False), ("ffv1", "b.avi", True)],
)
def test_colours_that_a_file_cannot_tell_look_the_same(tmp_path, codec, name, lossless):
    def setup(stream):
        context = stream.codec_context
        context.color_range, context.colorspace = 2, 1

    source = clips.make(tmp_path / "a.mkv", "ffv1", "yuv420p", 2, setup=setup)
    with pytest.warns(ClipWarning, match="cannot say" if lossless else "exact values"):
        copy(source, tmp_path / name, codec=codec)
    if lossless:
        assert_same_frames(source, tmp_path / name)
        return
    shown = []
    for path in (source, tmp_path / name):
        with open_video(path) as clip:
            shown.append([clip.to_rgb(arrays).astype(int) for arrays in read(path)])
    for a, b in zip(*shown, strict=True):
        assert np.abs((a - b).mean(axis=(0, 1))).max() < 2


def discs(path, codec, pixel_format, encoding=None):
    """Write a clip whose opacity is a disc."""
    y, x = np.mgrid[:48, :64]
    with av.open(str(path), "w") as out:
        film = out.add_stream(codec, rate=25, options=encoding or {})
        film.width, film.height, film.pix_fmt = 64, 48, pixel_format
        for k in range(4):
            pixels = np.full((48, 64, 4), 200, np.uint8)
            pixels[..., 3] = 255 * ((x - 30) ** 2 + (y - 24) ** 2 < 144)
            frame = av.VideoFrame.from_ndarray(pixels, format="rgba").reformat(format=pixel_format)
            frame.pts = k
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
    return path


def opacity(path):
    """Return the opacity of the third frame, by a decoder that knows it."""
    with av.open(str(path)) as file:
        name = file.streams.video[0].codec_context.codec.canonical_name
        decoder = av.CodecContext.create({"vp8": "libvpx", "vp9": "libvpx-vp9"}[name], "r") if "vp" in name else None
        packets = file.demux(video=0)
        frames = [frame for packet in packets for frame in (decoder or packet.stream).decode(packet)]
    assert "a" in frames[2].format.name or frames[2].format.has_palette
    return frames[2].to_ndarray(format="rgba")[..., 3]


@pytest.mark.parametrize(
    ("source", "codec", "pixel_format", "target"),
    [
        ("a.webm", "libvpx", "yuva420p", "b.webm"),
        ("a.webm", "libvpx", "yuva420p", "b.mkv"),
        ("a.mkv", "libvpx-vp9", "yuva420p", "b.webm"),
        ("a.mov", "prores_ks", "yuva444p10le", "b.mov"),
        ("a.mov", "prores_ks", "yuva444p10le", "b.webm"),
        ("a.mov", "qtrle", "argb", "b.mov"),
        ("a.mov", "png", "rgba", "b.mov"),
        ("a.mkv", "ffv1", "yuva420p", "b.mkv"),
        ("a.mkv", "ffv1", "bgra", "b.avi"),
        ("a.gif", "gif", "rgb8", "b.gif"),
    ],
)
def test_opacity_comes_through(tmp_path, source, codec, pixel_format, target):
    if codec == "gif":
        discs(tmp_path / "a.mkv", "ffv1", "bgra")
        copy(tmp_path / "a.mkv", tmp_path / source)
    else:
        still = {"auto-alt-ref": "0", "crf": "4", "b": "2M"} if "vpx" in codec else {}
        discs(tmp_path / source, codec, pixel_format, still)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* loses (exact|detail|depth)")
        copy(tmp_path / source, tmp_path / target)
    y, x = np.mgrid[:48, :64]
    seen, far = opacity(tmp_path / target), (x - 30) ** 2 + (y - 24) ** 2
    assert seen[far < 100].min() > 240
    assert seen[far > 200].max() < 15
