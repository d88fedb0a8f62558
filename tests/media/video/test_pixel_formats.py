"""Every pixel format comes through, chroma lies where it is sited, and black is black."""

import av
import numpy as np
import pytest

from supple.media.video import ClipWarning, colour
from supple.media.video import open_clip as open_video
from supple.media.video import planes as video_planes
from tests import clips
from tests.media.video.copies import assert_same_frames, copy, read

FORMATS = (  # of FFV1
    "yuv420p,yuva420p,yuva422p,yuv444p,yuva444p,yuv440p,yuv422p,yuv411p,yuv410p,bgr0,bgra,yuv420p16le,yuv422p16le,"
    "yuv444p9le,yuv420p10le,yuv422p10le,yuv444p10le,yuv420p12le,yuv444p12le,yuva444p10le,yuva420p10le,gray16le,gray,"
    "gbrp10le,gbrp12le,gbrap12le,ya8,gray10le,gray12le,gbrp16le,rgb48le,rgba64le,gbrpf32le"
)
PACKED = "argb,bgra,rgb0,0bgr,vuya,ayuv,uyvy422,yvyu422,p010le,nv21,xv36le,y210le"
OTHERS = (  # which it takes in another order
    "yuvj420p,nv12,nv21,nv16,nv24,yuyv422,uyvy422,p010le,yuv420p10be,rgb24,bgr24,argb,0rgb,rgba,gray10be,rgb48be,gbrp,vuya"
)


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
    for name in PACKED.split(","):
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
