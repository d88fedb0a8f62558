"""Videos as files: nothing of a frame, a time or another stream is lost, and all that can go wrong is said."""

import os
import queue
import subprocess
import sys
import threading
import types
import warnings
from fractions import Fraction

import av
import clips
import numpy as np
import pytest

from supple.errors import SuppleError
from supple.media.video import ClipWarning, CountError, colour, demux, info, plan
from supple.media.video import open_clip as open_video
from supple.media.video import planes as video_planes
from supple.media.video import source as movie

FORMATS = (  # of FFV1
    "yuv420p,yuva420p,yuva422p,yuv444p,yuva444p,yuv440p,yuv422p,yuv411p,yuv410p,bgr0,bgra,yuv420p16le,yuv422p16le,"
    "yuv444p9le,yuv420p10le,yuv422p10le,yuv444p10le,yuv420p12le,yuv444p12le,yuva444p10le,yuva420p10le,gray16le,gray,"
    "gbrp10le,gbrp12le,gbrap12le,ya8,gray10le,gray12le,gbrp16le,rgb48le,rgba64le,gbrpf32le"
)
OTHERS = (  # which it takes in another order
    "yuvj420p,nv12,nv21,nv16,nv24,yuyv422,uyvy422,p010le,yuv420p10be,rgb24,bgr24,argb,0rgb,rgba,gray10be,rgb48be,gbrp,vuya"
)


def copy(source, target, *, again=True, **settings):
    """Write a clip anew, unchanged; start again where it turns out to have another number of frames."""
    count = None
    while True:
        try:
            with open_video(source, threads=2, count=count) as clip:
                with clip.writer(target, force=True, threads=2, **settings) as sink:
                    for k, frame in enumerate(clip.frames()):
                        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
                        frame.copy_to(arrays)
                        sink.write(arrays, k)
                return clip.count
        except CountError as error:
            assert again
            count = error.found


def read(path):
    """Every frame's arrays."""
    with open_video(path) as clip:
        found = []
        for frame in clip.frames():
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
            found.append(arrays)
        assert len(found) == clip.count
        return found


def assert_same_frames(source, target):
    before, after = clips.decoded(source), clips.decoded(target)
    assert len(before) == len(after)
    for a, b in zip(before, after, strict=True):
        if a.format.name != b.format.name:
            a = a.reformat(format=b.format.name, src_color_range=2, dst_color_range=2)
        if b.format.name == "bgr0":
            pick = slice(None), slice(0, 3)
            x, y = (np.frombuffer(clips.rows(frame)[0], np.uint8).reshape(-1, 4)[pick] for frame in (a, b))
            assert (x == y).all()
        else:
            assert clips.rows(a) == clips.rows(b)


def assert_nothing_left(folder, *names):
    assert sorted(os.listdir(folder)) == sorted(names)


# --- planes as they are ---


@pytest.mark.parametrize("size", [(64, 48), (33, 17)], ids=["even", "odd"])
@pytest.mark.parametrize("name", [*FORMATS.split(","), *OTHERS.split(",")])
def test_every_pixel_format_comes_through_ffv1_bit_for_bit(tmp_path, name, size):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 3, size, smooth=False)
    copy(source, tmp_path / "b.mkv", codec="ffv1")
    assert_same_frames(source, tmp_path / "b.mkv")


@pytest.mark.parametrize(
    ("name", "mask"), [("rgb565le", 0xFFFF), ("rgb555le", 0x7FFF), ("rgb8", 0xFF), ("bgr4_byte", 0xF)]
)
def test_formats_of_parts_of_bytes_are_widened_without_loss(tmp_path, name, mask):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 3, smooth=False)
    copy(source, tmp_path / "b.mkv", codec="ffv1")
    pairs = set()
    for before, after in zip(clips.decoded(source), clips.decoded(tmp_path / "b.mkv"), strict=True):
        values = np.frombuffer(clips.rows(before)[0], "<u2" if mask > 255 else "u1") & mask
        pixels_after = after.to_ndarray(format="rgb24").reshape(-1, 3)
        pairs |= set(zip(values.tolist(), map(tuple, pixels_after.tolist()), strict=True))
    assert len(pairs) == len({value for value, _ in pairs}) == len({colour for _, colour in pairs})


@pytest.mark.parametrize("name", ["monob", "monow"])
def test_formats_of_parts_of_bytes_come_back(tmp_path, name):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 3, smooth=False)
    copy(source, tmp_path / "b.mkv", codec="ffv1")
    for before, after in zip(clips.decoded(source), clips.decoded(tmp_path / "b.mkv"), strict=True):
        back = after.reformat(format=name, src_color_range=2, dst_color_range=2, interpolation="POINT")
        assert clips.rows(back) == clips.rows(before)


def test_forms_agree_with_swscale():
    """Where a component lies is found from names; libswscale knows it by heart."""
    for name in (
        "argb",
        "bgra",
        "rgb0",
        "0bgr",
        "vuya",
        "ayuv",
        "uyvy422",
        "yvyu422",
        "p010le",
        "nv21",
        "xv36le",
        "y210le",
    ):
        found = video_planes.form(name)
        planar = {"rgb": "gbr", "yuv": "yuv"}[found.kind.family] + ("ap" if found.kind.alpha else "p")
        if found.kind.family == "yuv":
            chroma = {(1, 1): "444", (2, 1): "422", (2, 2): "420"}[found.kind.step]
            planar = f"yuv{'a' * found.kind.alpha}{chroma}p{found.kind.bits}le".replace("p8le", "p")
        layout = found.kind.layout(32, 16, (0, 0))
        frame = clips.noise(name, (32, 16), 1)
        one = [np.empty((*g.shape, g.channels), layout.dtype) for g in layout.groups]
        two = [a.copy() for a in one]
        video_planes.unpack(frame, found, one)
        other = frame.reformat(format=planar, src_color_range=2, dst_color_range=2)
        video_planes.unpack(other, video_planes.form(other.format.name), two)
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)


def test_palettes_are_looked_up(tmp_path):
    copy(clips.make(tmp_path / "a.mkv", "ffv1", count=3), tmp_path / "b.gif")
    with open_video(tmp_path / "b.gif") as clip:
        assert clip.count == 3
        assert clip.layout.groups[0].channels == 4


@pytest.mark.parametrize(
    ("name", "codec", "suffix", "offset"),
    [
        ("yuv420p", "libx264", "mp4", (0.0, 0.5)),
        ("yuv422p", "libx264", "mp4", (0.0, 0.0)),
        ("yuvj420p", "mjpeg", "avi", (0.5, 0.5)),
        ("yuv420p", "mpeg1video", "mpg", (0.5, 0.5)),
        ("yuv420p", "mpeg2video", "mpg", (0.0, 0.5)),
        ("yuv411p", "ffv1", "mkv", (0.0, 0.0)),
        ("yuv440p", "ffv1", "mkv", (0.0, 0.5)),
    ],
)
def test_siting_is_what_the_codec_is_used_to(tmp_path, name, codec, suffix, offset):
    options = {"strict": "experimental"} if codec == "mjpeg" else {}
    with open_video(clips.make(tmp_path / f"a.{suffix}", codec, name, options=options)) as clip:
        assert clip.layout.groups[1].offset == offset


@pytest.mark.parametrize(
    ("site", "offset"), [("topleft", (0, 0)), ("center", (0.5, 0.5)), ("bottomleft", (0, 1)), ("top", (0.5, 0))]
)
def test_siting_is_read_and_written(tmp_path, site, offset):
    source = clips.make(tmp_path / "a.mp4", options={"chroma_sample_location": site})
    copy(source, tmp_path / "b.mp4")
    for path in (source, tmp_path / "b.mp4"):
        with open_video(path) as clip:
            assert clip.layout.groups[1].offset == offset


def test_siting_that_another_codec_is_not_used_to_is_told(tmp_path):
    """Chroma of MPEG-1 and VP8 lies in the centre, that of H.264 and VP9 at the left, unless they say else."""
    for codec, name, container, target in (
        ("mpeg1video", "a.mpg", None, "h264"),
        ("mpeg1video", "a.mpg", None, "hevc"),
        ("libvpx", "a.webm", None, "vp9"),
        ("mjpeg", "a.avi", None, "h264"),
    ):
        options = {"strict": "experimental"} if codec == "mjpeg" else {}
        kind = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        source = clips.make(tmp_path / name, codec, kind, options=options, container=container)
        copy(source, tmp_path / "b.mkv", codec=target)
        with open_video(tmp_path / "b.mkv") as clip:
            assert clip.layout.groups[1].offset == (0.5, 0.5)


def test_chroma_stays_where_it_is_in_another_grid(tmp_path):
    """A ramp of chroma from 4:4:4 to 4:2:0, whose first sample lies where the file says."""
    frame = av.VideoFrame(64, 48, "yuv444p")
    frame.planes[0].update(bytes([100]) * frame.planes[0].buffer_size)
    ramp = np.tile(np.arange(frame.planes[1].line_size, dtype=np.uint8) * 2 + 60, 48)
    for plane in frame.planes[1:]:
        plane.update(ramp.tobytes())
    with av.open(str(tmp_path / "a.nut"), "w") as out:
        stream = out.add_stream("rawvideo", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p"
        frame.pts = 0
        out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    with pytest.warns(ClipWarning, match="detail of colours"):
        copy(tmp_path / "a.nut", tmp_path / "b.mkv", codec="ffv1", pixel_format="yuv420p")
    [[_, chroma]] = read(tmp_path / "b.mkv")
    want = 60 + 2 * 2 * np.arange(32)  # at the columns 0, 2, 4, …
    assert np.abs(chroma[:, 2:-2, 0] - want[None, 2:-2].astype(int)).max() <= 1


def test_opacity_has_its_mean_on_the_grid_of_chroma(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", "yuva420p", 1, (33, 17), smooth=False)
    [(first, second)] = read(source)
    alpha = first[..., 1].astype(float)
    padded = np.pad(alpha, ((0, 1), (0, 1)), mode="edge").reshape(9, 2, 17, 2).mean(axis=(1, 3))
    assert np.abs(padded - second[..., 2]).max() <= 0.5


LIMITED = {
    "yuv420p": (16, 128, 128),
    "nv12": (16, 128, 128),
    "yuv444p10le": (64, 512, 512),
    "p010le": (64, 512, 512),
    "yuv420p12le": (256, 2048, 2048),
    "yuv422p16le": (4096, 32768, 32768),
    "yuva420p": (16, 0, 128, 128, 0),
    "yuva444p10le": (64, 512, 512, 0),
    "gray": (16,),
    "gray10le": (64,),
    "ya8": (16, 0),
    "rgb24": (0, 0, 0),
    "gbrap12le": (0, 0, 0, 0),
    "gbrpf32le": (0, 0, 0),
}


@pytest.mark.parametrize("name", LIMITED)
@pytest.mark.parametrize("full", [False, True])
def test_black_is_what_it_is_in_range_and_depth(name, full):
    found = video_planes.form(name)
    values = colour.black(found, colour.Colour(colour.FULL if full else colour.LIMITED))
    want = LIMITED[name]
    if full:
        want = (0, *want[1:])
    assert values == want
    layout = found.kind.layout(32, 16, (0, 0))
    assert len(values) == sum(group.channels for group in layout.groups)
    if not found.kind.alpha and found.kind.family != "gray":
        arrays, start = [], 0
        for group in layout.groups:
            part = values[start : start + group.channels]
            arrays.append(np.broadcast_to(np.array(part, layout.dtype), (*group.shape, group.channels)))
            start += group.channels
        meant = colour.Colour(colour.FULL if full else colour.LIMITED, matrix=colour.BT709, site="left")
        assert colour.to_rgb(arrays, found, meant, (16, 32)).max() == 0
        assert colour.to_rgb(arrays, found, meant, (16, 32), True).max() == 0


@pytest.mark.parametrize("name", ["yuv420p", "yuv444p10le", "yuvj420p", "yuva444p12le", "gray", "gray10le", "gbrp"])
@pytest.mark.parametrize("matrix", [2, 1, 6, 9, 7])
@pytest.mark.parametrize("full", [0, 1, 2])
def test_colours_that_are_painted_are_seen(name, matrix, full):
    """Against libswscale."""
    found = video_planes.form(name)
    meant, white = colour.Colour(full, matrix=matrix), found.kind.white
    grey = found.kind.family == "gray"
    wanted = np.array([0.4, 0.4, 0.4] if grey else [0.9, 0.3, 0.15])
    alpha = [white] * found.kind.alpha
    values = iter(colour.painted(found, meant, 48, [*wanted[: 1 if grey else 3] * white, *alpha]))
    layout = found.kind.layout(32, 16, (0, 0))
    arrays = [
        np.stack([np.full(g.shape, round(next(values)), layout.dtype) for _ in range(g.channels)], -1)
        for g in layout.groups
    ]
    seen = colour.to_rgb(arrays, found, meant, (16, 32), True)[8, 16] / 65535
    np.testing.assert_allclose(seen, wanted, atol=0.008)
    nothing = [0.0] * ((1 if grey else 3) + found.kind.alpha)
    assert colour.painted(found, meant, 48, nothing) == pytest.approx(colour.black(found, meant))


def test_black_of_a_file(tmp_path):
    def full(stream):
        stream.codec_context.color_range = 2

    for name, setup, want in (
        ("yuv420p", None, (16, 128, 128)),
        ("yuv420p", full, (0, 128, 128)),
        ("yuvj420p", None, (0, 128, 128)),
        ("gray", None, (0,)),
        ("yuv422p10le", None, (64, 512, 512)),
        ("bgr0", None, (0, 0, 0)),
    ):
        codec = "mjpeg" if name == "yuvj420p" else "ffv1"
        options = {"strict": "experimental"}
        with open_video(clips.make(tmp_path / "a.mkv", codec, name, 1, setup=setup, options=options)) as clip:
            assert clip.layout.black == want


# --- times ---


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


def test_variable_rate_into_matroska_is_kept_to_the_millisecond(tmp_path):
    times = [0, 7, 11, 100, 101, 140, 900, 901, 902, 3000]
    source = clips.make(tmp_path / "a.mp4", times=times, base=Fraction(1, 1000))
    copy(source, tmp_path / "b.mkv")
    assert [t * 1000 for t in clips.when(tmp_path / "b.mkv")] == times
    copy(tmp_path / "b.mkv", tmp_path / "c.mp4")
    assert [t * 1000 for t in clips.when(tmp_path / "c.mp4")] == times


def test_a_pause_is_kept_in_avi(tmp_path):
    times = [k + 50 * (k > 4) for k in range(10)]
    source = clips.make(tmp_path / "a.mp4", times=times)
    copy(source, tmp_path / "b.avi")
    with open_video(tmp_path / "b.avi") as clip:
        clip.passage = types.SimpleNamespace(indices=[], take=None)
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


def test_durations_are_kept(tmp_path):
    times = [0, 100, 300, 400, 900]
    source = clips.make(tmp_path / "a.mp4", count=5, times=times, base=Fraction(1, 1000), options={"bf": "0"})
    copy(source, tmp_path / "b.mp4")
    assert info(tmp_path / "b.mp4")["duration"] == pytest.approx(info(source)["duration"], abs=1e-3)


def test_frames_before_an_edit_list_begins_are_not_shown(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=12, times=range(-4, 8), audio="aac", options={"bf": "2"})
    shown = len(clips.decoded(source))
    assert 0 < shown < 12
    assert copy(source, tmp_path / "b.mp4", again=False) == shown
    assert clips.when(tmp_path / "b.mp4") == clips.when(source)
    assert_same_sound(source, tmp_path / "b.mp4")


def test_frames_are_read_and_written_by_two_threads(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=50, audio="aac")
    frames = queue.Queue(8)
    with open_video(source) as clip, clip.writer(tmp_path / "b.mp4") as sink:

        def reader():
            for frame in clip.frames():
                arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
                frame.copy_to(arrays)
                frames.put(arrays)

        thread = threading.Thread(target=reader)
        thread.start()
        for k in range(clip.count):
            sink.write(frames.get(timeout=60), k)
        thread.join()
    assert clips.when(tmp_path / "b.mp4") == clips.when(source)
    assert_same_sound(source, tmp_path / "b.mp4")


@pytest.mark.parametrize("codec", ["h264", "prores"])
def test_the_order_of_fields_comes_through(tmp_path, codec):
    def setup(stream):
        stream.codec_context.field_order = 2

    source = clips.make(tmp_path / "a.mov", options={"x264-params": "tff=1"}, setup=setup)
    copy(source, tmp_path / "b.mov", codec=codec)
    for path in (source, tmp_path / "b.mov"):
        with open_video(path) as clip:
            assert clip.field_order in (2, 4)


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


# --- the rest of the file ---


def relative(path, kind):
    start = 0 if path.suffix == ".avi" else clips.when(path)[0]  # PyAV alone does not know the times of AVI
    return [(data, float(t - start), float(d)) for data, t, d in clips.parcels(path, kind)]


def assert_same_sound(source, target, tolerance=1e-9):
    before, after = relative(source, "audio"), relative(target, "audio")
    assert [p[0] for p in before] == [p[0] for p in after]
    assert [p[1] for p in after] == pytest.approx([p[1] for p in before], abs=tolerance)


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
        sound = clips._sound(out, "aac")
        for k in range(3):
            frame = clips.noise("yuv420p", clips.SIZE, k, True)
            frame.pts = k
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
        clips._tone(out, sound, 3.0, 0)
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


@pytest.mark.parametrize("between", ["mp4", "mov", "mkv"])
def test_titles_of_streams_come_through(tmp_path, between):
    """MP4 gives a title back as a name, which muxers do not know."""

    def setup(stream):
        stream.metadata["title"] = "Film"

    source = clips.make(tmp_path / "a.mkv", audio="aac", setup=setup)
    with av.open(str(source)) as one, av.open(str(tmp_path / "b.mkv"), "w") as two:
        streams = {}
        for stream in one.streams:
            streams[stream.index] = two.add_stream_from_template(stream, opaque=True)
            streams[stream.index].metadata["title"] = f"Track {stream.index}"
        for packet in one.demux():
            if packet.size:
                packet.stream = streams[packet.stream_index]
                two.mux(packet)
    copy(tmp_path / "b.mkv", tmp_path / f"c.{between}")
    copy(tmp_path / f"c.{between}", tmp_path / "d.mp4")
    copy(tmp_path / "d.mp4", tmp_path / "e.mkv")
    with av.open(str(tmp_path / "e.mkv")) as made:
        assert [stream.metadata.get("title") for stream in made.streams] == ["Track 0", "Track 1"]
    with av.open(str(tmp_path / "d.mp4")) as made:
        assert [stream.metadata.get("name") for stream in made.streams] == ["Track 0", "Track 1"]


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
        clip.passage = types.SimpleNamespace(indices=[], take=None)
        light = []
        for k, frame in enumerate(clip.frames()):
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
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
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        copy(source, tmp_path / target, codec=codec)
    told = f"loses the light levels of HDR, which {codec} cannot hold"
    assert sum(told in str(warning.message) for warning in caught) == 1


def test_opacity_of_webm_comes_through(tmp_path):
    def setup(stream):
        stream.metadata["alpha_mode"] = "1"

    source = clips.make(tmp_path / "a.webm", "libvpx-vp9", "yuva420p", setup=setup, options={"lossless": "1"})
    with open_video(source) as clip:
        assert clip.layout.groups[0].alpha
    copy(source, tmp_path / "b.webm")
    before, after = read(source), read(tmp_path / "b.webm")
    assert len(before) == len(after) == 10
    assert np.abs(before[3][0][..., 1].astype(int) - after[3][0][..., 1]).max() < 20


def test_opacity_that_is_lost_is_said_once_and_only_if_there_is_any(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", "yuva420p")
    with pytest.warns(ClipWarning, match="loses opacity") as caught:
        copy(source, tmp_path / "b.mp4", codec="h264")
    assert len(caught) == 1
    with open_video(source) as clip, clip.writer(tmp_path / "c.mp4", codec="h264") as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
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
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with open_video(source) as clip, clip.writer(tmp_path / "b.gif") as sink:
            for k, frame in enumerate(clip.frames()):
                arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
                frame.copy_to(arrays)
                arrays[0][..., 3] = opacity[k % 2]
                sink.write(arrays, k)
    assert len(caught) == told
    assert not told or "half transparent" in str(caught[0].message)


# --- codecs ---


@pytest.mark.parametrize(
    ("codec", "suffix", "target", "want"),
    [
        ("libx264", "mp4", "mp4", "h264"),
        ("libx265", "mp4", "mkv", "hevc"),
        ("libvpx-vp9", "webm", "webm", "vp9"),
        ("libx264", "mp4", "webm", "vp9"),
        ("mpeg4", "avi", "avi", "mpeg4"),
        ("ffv1", "mkv", "mkv", "ffv1"),
        ("ffv1", "mkv", "mov", "h264"),
        ("utvideo", "avi", "mkv", "ffv1"),
        ("libsvtav1", "mkv", "mp4", "av1"),
        ("mpeg2video", "ts", "mp4", "mpeg2video"),
        ("libx264", "mp4", "gif", "gif"),
    ],
)
def test_the_codec_is_the_sources_or_the_containers(tmp_path, codec, suffix, target, want):
    source = clips.make(tmp_path / f"a.{suffix}", codec, count=10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        copy(source, tmp_path / f"b.{target}")
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


@pytest.mark.parametrize("preset", ["0", "6", "10"])
def test_lossless_is_bit_for_bit_with_any_preset_of_av1(tmp_path, preset):
    source = clips.make(tmp_path / "a.nut", "rawvideo", count=2, size=(64, 64), smooth=False)
    copy(source, tmp_path / "b.mkv", codec="av1", preset=preset, lossless=True)
    for one, two in zip(read(source), read(tmp_path / "b.mkv"), strict=True):
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("preset", "crf"), [("10", 1), ("11", 8), ("13", 8)])
def test_what_av1_is_let_write_decodes(tmp_path, preset, crf):
    source = clips.make(tmp_path / "a.nut", "rawvideo", count=6, size=(320, 192), smooth=False)
    copy(source, tmp_path / "b.mkv", codec="av1", preset=preset, crf=crf)
    assert len(clips.decoded(tmp_path / "b.mkv")) == 6


def test_a_source_whose_profile_no_codec_takes_is_written_in_another(tmp_path, monkeypatch):
    source = clips.make(tmp_path / "a.mov", "prores_ks", "yuv422p10le", 2)
    opens = plan.WritePlan._opens
    monkeypatch.setattr(plan.WritePlan, "_opens", lambda self, m: self.encoder.codec != "prores" and opens(self, m))
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


def test_an_encoder_without_its_device_is_said(tmp_path):
    context = av.CodecContext.create("h264_nvenc", "w")
    context.width, context.height, context.pix_fmt, context.time_base = 640, 480, "yuv420p", Fraction(1, 25)
    try:
        context.open()
    except (av.FFmpegError, ValueError):
        source = clips.make(tmp_path / "a.mp4", count=2)
        with pytest.raises(SuppleError, match="h264_nvenc cannot be started here"):
            copy(source, tmp_path / "b.mp4", codec="h264_nvenc")
    else:
        pytest.skip("there is one")


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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClipWarning)
        if size[0] < 16 and codec == "hevc":
            with pytest.raises(SuppleError, match="does not take frames of"):
                copy(source, tmp_path / "b.mkv", codec=codec)
            assert_nothing_left(tmp_path, "a.nut")
        else:
            copy(source, tmp_path / "b.mkv", codec=codec)
            assert [a.width for a in clips.decoded(tmp_path / "b.mkv")] == [size[0]] * 3


def test_a_format_changed_for_an_odd_size_is_said(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1", "yuv420p", 3, (65, 49))
    with pytest.warns(ClipWarning, match="yuv420p, which libx264 does not take at 65x49"):
        copy(source, tmp_path / "b.mp4", codec="h264")


def test_one_frame(tmp_path):
    for suffix in ("mp4", "mkv", "avi", "gif", "webm", "mov"):
        source = clips.make(tmp_path / "a.mkv", "ffv1", count=1)
        copy(source, tmp_path / f"b.{suffix}", codec=None if suffix in ("gif", "webm") else "h264")
        assert info(tmp_path / f"b.{suffix}")["frames"] == 1
        assert copy(tmp_path / f"b.{suffix}", tmp_path / "c.mkv", codec="ffv1") == 1


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
        "preset 11 fails below crf 8: use preset 10 or less, or crf 8",
    ),
    ("b.mkv", {"codec": "av1", "preset": "13", "crf": 1}, "preset 13 fails below crf 8"),
    ("b.mkv", {"codec": "av1", "preset": "12", "lossless": True}, "preset 12 fails if lossless: use preset 10 or less"),
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


def test_an_existing_file_is_kept_unless_forced(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=2)
    (tmp_path / "b.mp4").write_text("mine")
    with (
        open_video(source) as clip,
        pytest.raises(SuppleError, match="exists already"),
        clip.writer(tmp_path / "b.mp4"),
    ):
        pytest.fail("the block must not run")
    assert (tmp_path / "b.mp4").read_text() == "mine"


def test_a_clip_may_replace_itself(tmp_path):
    source = clips.make(tmp_path / "a.mp4", count=4)
    assert copy(source, source) == 4
    assert info(source)["frames"] == 4


# --- what must never happen ---


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
    for _ in range(10):
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
    [("mkv", "libx264", {}), ("mov", "prores_ks", {"movflags": "faststart"}), ("avi", "mpeg4", {})],
)
def test_a_warning_says_how_much_of_a_cut_clip_is_lost(tmp_path, suffix, codec, options):
    name = "yuv422p10le" if suffix == "mov" else "yuv420p"
    with av.open(str(tmp_path / f"a.{suffix}"), "w", container_options=options) as out:
        stream = out.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, name
        for k in range(90):
            out.mux(stream.encode(clips.noise(name, (64, 48), k)))
        out.mux(stream.encode(None))
    data = (tmp_path / f"a.{suffix}").read_bytes()
    (tmp_path / f"part.{suffix}").write_bytes(data[: len(data) // 3])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        count = copy(tmp_path / f"part.{suffix}", tmp_path / "b.mkv")
    assert 20 <= count <= 35
    lost = f"{90 - count} of its 90 frames ({(90 - count) / 25:.2f} of 3.60 s) are lost"
    assert lost in str(caught[-1].message)
    assert all("damaged" in str(each.message) for each in caught)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert copy(tmp_path / f"a.{suffix}", tmp_path / "c.mkv") == 90


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
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        copy(source, tmp_path / "b.mkv")
    assert [t * 1000 for t in clips.when(tmp_path / "b.mkv")] == times


@pytest.mark.parametrize(("target", "gap"), [("b.mp4", 10**9), ("b.mov", 10**9), ("b.gif", 10**6)])
def test_gaps_that_a_file_cannot_tell_are_refused(tmp_path, target, gap):
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=3, times=[0, 1, gap], base=Fraction(1, 1000))
    with pytest.raises(SuppleError, match=f"frame 2 comes {gap // 1000} s after the one before"):
        copy(source, tmp_path / target, codec=None if target == "b.gif" else "h264")
    assert_nothing_left(tmp_path, "a.mkv")


@pytest.mark.parametrize("claim", [Fraction(1, 10**9), Fraction(0), Fraction(10**9), Fraction(2**31 - 1, 7)])
def test_rates_that_no_file_means_are_not_believed(tmp_path, claim, monkeypatch):
    source = clips.make(tmp_path / "a.mkv", "ffv1", count=3)
    for span in (Fraction(1, 10**12), Fraction(10**12), Fraction(0)):
        counted = demux.Survey(3, 3, span, False, False)
        film = types.SimpleNamespace(average_rate=claim, guessed_rate=None, base_rate=claim)
        rate = movie._rate(film, counted)
        assert Fraction(1, 10_000) <= rate <= 100_000
        monkeypatch.setattr(movie, "_rate", lambda film, counted, rate=rate: rate)
        copy(source, tmp_path / "b.mp4")
        monkeypatch.undo()


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
            clips._tone(out, clips._sound(out, codec), 0.5, 0)
        with pytest.raises(SuppleError, match="sound and no film"), open_video(tmp_path / name):
            pass


def test_a_cover_is_no_film(tmp_path):
    with av.open(str(tmp_path / "a.m4a"), "w", format="mp4") as out:
        sound = clips._sound(out, "aac")
        picture = clips._cover(out)
        out.start_encoding()
        out.mux(picture)
        clips._tone(out, sound, 0.5, 0)
    with pytest.raises(SuppleError, match="cover picture"), open_video(tmp_path / "a.m4a"):
        pass


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])  # of which the second drops a frame there
def test_a_size_that_changes_is_said(tmp_path, codec):
    one = clips.make(tmp_path / "a.ts", codec, count=5)
    two = clips.make(tmp_path / "b.ts", codec, count=5, size=(32, 32))
    (tmp_path / "c.ts").write_bytes(one.read_bytes() + two.read_bytes())
    message = r"frame 5 is 32x32 yuv420p, and frame 0 is 64x48 yuv420p"
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


@pytest.mark.parametrize("when", [0, 3, 9])
@pytest.mark.parametrize("stop", [KeyboardInterrupt, RuntimeError])
def test_an_interrupt_leaves_nothing(tmp_path, stop, when):
    source = clips.make(tmp_path / "a.mp4", audio="aac")

    def interrupted():
        with open_video(source) as clip, clip.writer(tmp_path / "b.mp4") as sink:
            for k, frame in enumerate(clip.frames()):
                arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
                frame.copy_to(arrays)
                if k == when:
                    raise stop
                sink.write(arrays, k)

    with pytest.raises(stop):
        interrupted()
    assert_nothing_left(tmp_path, "a.mp4")


FULL_DISK = """
import resource, signal, sys
import numpy as np
from supple.errors import SuppleError
from supple.media.video import open_clip as open_video
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    with open_video(sys.argv[1]) as clip, clip.writer(sys.argv[2]) as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
            sink.write(arrays, k)
except SuppleError as error:
    print(error)
    sys.exit(3)
"""


@pytest.mark.parametrize("target", ["b.mkv", "b.mp4", "b.avi", "b.gif"])
def test_a_full_disk_is_said(tmp_path, target):
    source = clips.make(tmp_path / "a.mkv", "ffv1", smooth=False, count=20)
    for room in (0, 20000):
        command = [sys.executable, "-c", FULL_DISK, str(source), str(tmp_path / target), str(room)]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=100, check=False)
        assert done.returncode == 3, done
        assert "File too large: make room" in done.stdout
        assert done.stderr == ""
        assert_nothing_left(tmp_path, "a.mkv")


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


@pytest.mark.parametrize("name", ["yuv420p", "yuv444p10le", "gray", "gbrp", "rgba", "yuv422p"])
def test_rgb_for_a_plot(tmp_path, name):
    source = clips.make(tmp_path / "a.nut", "rawvideo", name, 1)
    [frame] = clips.decoded(source)
    want = np.rint(frame.reformat(format="rgb48le", interpolation="BICUBIC").to_ndarray() / 257)
    with open_video(source) as clip:
        [arrays] = read(source)
        shown = clip.to_rgb(arrays)
    assert shown.dtype == np.uint8
    assert shown.shape == (48, 64, 3)
    assert np.abs(shown.astype(int) - want).max() <= 2


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


SILENT = """
import sys
sys.path.insert(0, sys.argv[3])
from test_video_files import copy
for codec in ("h264", "hevc", "av1", "vp9"):
    copy(sys.argv[1], sys.argv[2], codec=codec)
"""


def test_encoders_are_silent(tmp_path):
    source = clips.make(tmp_path / "a.mkv", "ffv1")
    command = [sys.executable, "-c", SILENT, str(source), str(tmp_path / "b.mkv"), os.path.dirname(__file__)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=100, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
