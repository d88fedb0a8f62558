"""Timecodes, loops, the order of fields and what is shown upright come through, or their loss is told."""

import re
import struct
import warnings
from fractions import Fraction

import av
import numpy as np
import pytest
import pyvips
from av.filter import Graph

from supple.media.sequence import open_clip as open_sequence
from supple.media.sequence import writer as sequence_writer
from supple.media.video import ClipWarning, info, writer
from supple.media.video import open_clip as open_video
from tests import clips
from tests.media.video.copies import arrays_of, copy

CONTAINER_OF = {"mkv": "ffv1", "avi": "mpeg4", "webm": "libvpx"}
NTSC = Fraction(30000, 1001)


def timecodes(path):
    with av.open(str(path)) as file:
        tags = [file.metadata, *(stream.metadata for stream in file.streams)]
    return {value for each in tags for key, value in each.items() if key.lower() == "timecode"}


@pytest.mark.parametrize("target", ["mov", "mp4", "mkv", "webm", "avi"])
@pytest.mark.parametrize(
    ("source", "rate", "code"),
    [
        ("mov", Fraction(24000, 1001), "00:00:41:16"),
        ("mp4", NTSC, "01:59:59;28"),
        ("mov", 2 * NTSC, "10:00:00;58"),
        ("mkv", 50, "09:58:03:49"),
        ("avi", 25, "10:00:00:00"),
        ("mxf", 25, "10:00:00:24"),
    ],
)
@pytest.mark.filterwarnings("ignore:.* loses detail of colours")
def test_timecodes_come_through(tmp_path, source, rate, code, target):
    codec = "mpeg2video" if source == "mxf" else CONTAINER_OF.get(source, "libx264")
    form = "yuv422p" if source == "mxf" else "yuv420p"
    made = clips.make(
        tmp_path / f"a.{source}", codec, form, count=12, rate=rate, base=1 / Fraction(rate), tags={"timecode": code}
    )
    assert timecodes(made) == {code}
    assert info(made)["timecode"] == code
    copy(made, tmp_path / f"b.{target}", codec={"webm": "vp9", "avi": "mpeg4"}.get(target, "h264"))
    assert timecodes(tmp_path / f"b.{target}") == {code}
    with av.open(str(tmp_path / f"b.{target}")) as file:
        kept = [stream.type for stream in file.streams]
    assert kept == ["video", "data"] if target in ("mov", "mp4") else ["video"]


@pytest.mark.parametrize(
    ("target", "rate", "code"), [("gif", 25, "01:00:00:00"), ("mov", 25, "01:00:00;10"), ("mp4", 25, "01:00:00:29")]
)
def test_a_timecode_that_cannot_be_kept_is_said(tmp_path, target, rate, code):
    source = clips.make(tmp_path / "a.mkv", "ffv1", rate=rate, tags={"timecode": code})
    with pytest.warns(ClipWarning, match=rf"b\.{target} cannot hold the timecode {code}: it is left out"):
        copy(source, tmp_path / f"b.{target}", codec="gif" if target == "gif" else "h264")
    assert not timecodes(tmp_path / f"b.{target}")


def renamed(source, target, kind):
    """Write a clip whose timecode track claims to be data of another kind."""
    data = source.read_bytes()
    at = data.index(b"tmcd", data.index(b"stsd", data.index(b"TimeCodeHandler")))
    refers = data.index(b"tref") + 8
    target.write_bytes(data[:refers] + kind + data[refers + 4 : at] + kind + data[at + 4 :])
    return target


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (b"gpmd", r"GoPro telemetry \(GPMF\)"),
        (b"mebx", "timed metadata of Apple"),
        (b"djmd", "DJI metadata"),
        (b"camm", r"camera motion metadata \(CAMM\)"),
        (b"abcd", "data 'abcd'"),
    ],
)
@pytest.mark.parametrize(
    "chapters", [None, [{"id": 1, "start": 0, "end": 200, "time_base": Fraction(1, 1000), "metadata": {}}]]
)
def test_data_is_named(tmp_path, kind, told, chapters):
    made = clips.make(tmp_path / "t.mp4", tags={"timecode": "01:00:00:00"}, chapters=chapters)
    source = renamed(made, tmp_path / "a.mp4", kind)
    assert any(re.fullmatch(told, name.partition(" (eng")[0]) for name in info(source)["other"])
    with pytest.warns(ClipWarning, match=rf"cannot hold the {told} \(stream \d\): it is left out"):
        copy(source, tmp_path / "b.mkv")


@pytest.mark.parametrize(("kind", "kept"), [(b"gpmd", True), (b"camm", False), (b"mebx", False)])
def test_data_comes_through_if_its_kind_does(tmp_path, kind, kept):
    source = renamed(clips.make(tmp_path / "t.mov", tags={"timecode": "01:00:00:00"}), tmp_path / "a.mov", kind)
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(source, tmp_path / "b.mov")
    assert len(caught) == (not kept)
    assert clips.parcels(tmp_path / "b.mov", "data") == (clips.parcels(source, "data") if kept else [])
    assert (kind in (tmp_path / "b.mov").read_bytes()) == kept


def repeats(path):
    """Return the count in a GIF; None if it has none."""
    found = re.search(rb"NETSCAPE2\.0\x03\x01(..)", path.read_bytes(), re.DOTALL)
    return int.from_bytes(found[1], "little") if found else None


@pytest.mark.parametrize(("count", "plays"), [(None, 1), (0, 0), (1, 2), (3, 4)])
def test_how_often_it_plays_comes_through(tmp_path, count, plays):
    clips.make(tmp_path / "a.gif", "gif", "rgb8", count=3)
    data = (tmp_path / "a.gif").read_bytes()
    at = data.index(b"\x21\xff\x0bNETSCAPE2.0")
    own = b"" if count is None else data[at : at + 16] + struct.pack("<H", count) + b"\0"
    (tmp_path / "a.gif").write_bytes(data[:at] + own + data[at + 19 :])
    assert info(tmp_path / "a.gif")["plays"] == plays
    copy(tmp_path / "a.gif", tmp_path / "b.gif")
    assert repeats(tmp_path / "b.gif") == count
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(tmp_path / "a.gif", tmp_path / "b.mkv", codec="ffv1")
    assert [" plays " in str(each.message) for each in caught] == [True] * (plays != 1)


@pytest.mark.parametrize(("plays", "count"), [(0, 0), (1, None), (2, 1), (5, 4)])
def test_an_animated_picture_plays_as_often_as_a_gif(tmp_path, plays, count):
    with av.open(str(tmp_path / "a.apng"), "w", container_options={"plays": str(plays)}) as out:
        film = out.add_stream("apng", rate=10)
        film.width, film.height, film.pix_fmt = 64, 48, "rgb24"
        for k in range(3):
            frame = clips.noise("rgb24", clips.SIZE, k, True)
            frame.pts = k
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
    copy(tmp_path / "a.apng", tmp_path / "b.gif")
    assert repeats(tmp_path / "b.gif") == count
    shades = [pyvips.Image.black(64, 48).linear(1, 20 + 60 * k).cast("uchar").bandjoin([40, 90]) for k in range(3)]
    tall = pyvips.Image.arrayjoin(shades, across=1).copy()
    tall.set_type(pyvips.GValue.gint_type, "page-height", 48)
    tall.set_type(pyvips.GValue.gint_type, "loop", plays)
    tall.write_to_file(str(tmp_path / "a.webp"))
    with open_sequence(tmp_path / "a.webp") as clip, writer(clip, tmp_path / "c.gif") as sink:
        for k, frame in enumerate(clip.frames()):
            pixels = np.empty((48, 64, 3), np.uint8)
            frame.copy_to([pixels])
            sink.write([pixels], k)
    assert repeats(tmp_path / "c.gif") == count


F, G = 1 << 16, 1 << 30
DISPLAYS = {
    "quarter": ((0, F, 0, -F, 0, 0, 48 * F, 0, G), lambda a: np.rot90(a, -1)),
    "half": ((-F, 0, 0, 0, -F, 0, 64 * F, 48 * F, G), lambda a: a[::-1, ::-1]),
    "mirrored": ((-F, 0, 0, 0, F, 0, 64 * F, 0, G), lambda a: a[:, ::-1]),
    "flipped": ((F, 0, 0, 0, -F, 0, 0, 48 * F, G), lambda a: a[::-1]),
    "transposed": ((0, F, 0, F, 0, 0, 0, 0, G), lambda a: a.transpose(1, 0, 2)),
    "transverse": ((0, -F, 0, -F, 0, 0, 48 * F, 64 * F, G), lambda a: a[::-1, ::-1].transpose(1, 0, 2)),
}


def matrix_of(path):
    """Return the first four numbers of the display matrix of the film of an MP4 that turn it."""
    data = path.read_bytes()
    at = data.index(b"tkhd") + 4
    found = struct.unpack_from(">9i", data, at + (40 if data[at] == 0 else 52))
    return found[0], found[1], found[3], found[4]


@pytest.mark.parametrize("kind", DISPLAYS)
def test_pictures_of_a_clip_are_upright(tmp_path, kind):
    matrix, upright = DISPLAYS[kind]
    source = clips.make(tmp_path / "a.mp4", count=3)
    data = bytearray(source.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    data[at : at + 36] = struct.pack(">9i", *matrix)
    source.write_bytes(data)
    with open_video(source) as clip, sequence_writer(clip, tmp_path / "out") as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = arrays_of(clip, frame)
            stored = clip.to_rgb(arrays)
            sink.write(arrays, k)
    seen = pyvips.Image.new_from_file(str(tmp_path / "out" / "00003.png")).numpy()
    np.testing.assert_array_equal(seen, upright(stored))
    for target in ("b.mp4", "b.mov"):
        copy(source, tmp_path / target)
        assert matrix_of(tmp_path / target) == (matrix[0], matrix[1], matrix[3], matrix[4])
    copy(source, tmp_path / "b.mkv")
    for name in ("rotation", "mirrored"):
        assert info(tmp_path / "b.mkv")[name] == info(source)[name]


def through(frame, name, arguments=None):
    graph = Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1, 25))
    step, sink = graph.add(name, arguments), graph.add("buffersink")
    source.link_to(step)
    step.link_to(sink)
    graph.configure()
    frame.time_base = Fraction(1, 25)
    graph.vpush(frame)
    return graph.vpull()


def interlaced(path, codec, pixel_format, order, size=(64, 48), encoding=None, coded=True):
    """Write frames of two fields, one brighter than the other, as a codec or the container says."""
    with av.open(str(path), "w") as out:
        film = out.add_stream(
            codec, rate=25, options={**({"flags": "+ildct+ilme"} if coded else {}), **(encoding or {})}
        )
        film.width, film.height, film.pix_fmt = *size, pixel_format
        if not coded:
            film.codec_context.field_order = {"top": 2, "bottom": 3}[order]
        for k in range(3):
            pixels = np.full((size[1], size[0], 3), 60 + 8 * k, np.uint8)
            pixels[1::2] += 100
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(format=pixel_format)
            frame.pts = k
            if coded:
                frame = through(frame, "setfield", f"{order[0]}ff")
            out.mux(film.encode(frame))
        out.mux(film.encode(None))
    return path


def fields_of(path):
    """Return the order that the stream says, and the field that a frame shows first: the darker one is at the top."""
    with av.open(str(path)) as file:
        film = file.streams.video[0]
        said, frame = film.codec_context.field_order, list(file.decode(film))[1]
    if not frame.interlaced_frame:
        return said, ""
    first = through(frame, "separatefields").to_ndarray(format="gray")
    return said, "top" if first.mean() < frame.to_ndarray(format="gray").mean() else "bottom"


@pytest.mark.parametrize("order", ["top", "bottom"])
@pytest.mark.parametrize(
    ("source", "codec", "pixel_format", "target"),
    [
        ("mov", "libx264", "yuv420p", "mov"),
        ("mp4", "libx264", "yuv420p", "mkv"),
        ("mov", "prores_ks", "yuv422p10le", "mov"),
        ("ts", "mpeg2video", "yuv420p", "mp4"),
        ("mxf", "mpeg2video", "yuv422p", "mov"),
        ("avi", "mpeg4", "yuv420p", "mp4"),
        ("mkv", "ffv1", "yuv420p", "mkv"),
        ("mov", "v210", "yuv422p10le", "mov"),
        ("mov", "dnxhd", "yuv422p", "mov"),
        ("avi", "dvvideo", "yuv420p", "mov"),
    ],
)
def test_field_order_comes_through(tmp_path, source, codec, pixel_format, target, order):
    size = {"dnxhd": (1920, 1080), "dvvideo": (720, 576), "mpeg2video": (352, 288)}.get(codec, (64, 48))
    encoding = {"b": "120M"} if codec == "dnxhd" else {}
    if codec == "dvvideo":
        order = "bottom"  # always
    made = interlaced(tmp_path / f"a.{source}", codec, pixel_format, order, size, encoding, coded=codec != "v210")
    said, first = fields_of(made)
    assert first == order
    assert (info(made)["interlaced"], info(made)["fields"]) == (True, order)
    copy(made, tmp_path / f"b.{target}")
    after = fields_of(tmp_path / f"b.{target}")
    assert after[1] == order
    assert after[0] in (said, {"top": 2, "bottom": 3}[order])


@pytest.mark.parametrize(
    ("codec", "target", "kept"), [("libx265", "mov", True), ("libvpx-vp9", "mkv", True), ("libvpx-vp9", "webm", False)]
)
def test_field_order_that_only_the_container_says_is_kept_or_its_loss_said(tmp_path, codec, target, kept):
    source = interlaced(tmp_path / "a.mkv", codec, "yuv420p", "bottom", coded=False)
    assert (fields_of(source), info(source)["fields"]) == ((3, ""), "bottom")
    with warnings.catch_warnings(record=True, action="always") as caught:
        copy(source, tmp_path / f"b.{target}")
    told = [str(each.message).partition(f"b.{target} ")[2] for each in caught]
    assert told == ([] if kept else ["cannot say that frames are interlaced, bottom field first"])
    assert not kept or fields_of(tmp_path / f"b.{target}")[0] == 3


def test_a_size_that_cannot_be_coded_as_fields_is_said(tmp_path):
    source = interlaced(tmp_path / "a.mkv", "ffv1", "yuv420p", "top", (64, 50))
    with pytest.warns(ClipWarning, match="cannot say that frames are interlaced, top field first"):
        copy(source, tmp_path / "b.mp4", codec="h264")
    assert len(clips.decoded(tmp_path / "b.mp4")) == 3
