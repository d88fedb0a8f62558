"""Image sequences as clips: what they are made of, in order, and what is written in their place."""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import clips
import numpy as np
import numpy.typing as npt
import pytest
import pyvips

from supple import SuppleError
from supple.media import files as folders
from supple.media.image import DepthWarning, ImageWarning, PageWarning, Picture, read, write
from supple.media.numbering import is_sequence
from supple.media.sequence import Pictures
from supple.media.sequence import open_clip as open_sequence
from supple.media.sequence import writer as sequence_writer
from supple.media.video import ClipWarning, info
from supple.media.video import open_clip as open_video
from supple.media.video import writer as writer_of
from supple.streaming import Group, Layout

Array = npt.NDArray[Any]
SRGB = bytes(pyvips.Operation.call("profile_load", "srgb"))
# what every film of RGB pictures says that is as players want it; `test_what_a_sequence_loses_is_said` hears it
pytestmark = pytest.mark.filterwarnings("ignore:.* loses detail of colours:supple.media.base.ClipWarning")


def picture(k: int, shape: tuple[int, ...] = (6, 8, 3), dtype: str = "u1") -> Array:
    made = np.random.default_rng(k).integers(0, 256, shape)
    return (made / 255).astype(dtype) if dtype == "f4" else (made * (257 if dtype == "u2" else 1)).astype(dtype)


def save(folder: Path, names: Sequence[str], **options: Any) -> list[Array]:
    folder.mkdir(parents=True, exist_ok=True)
    made = [picture(k, **options) for k in range(len(names))]
    for name, pixels in zip(names, made, strict=True):
        write(folder / name, pixels)
    return made


def numbers(first: int, last: int) -> list[str]:
    return [f"{k:05d}.png" for k in range(first, last + 1)]


def empty(clip: Pictures) -> list[Array]:
    return [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]


def frames_of(clip: Pictures) -> list[Array]:
    read_all = []
    for frame in clip.frames():
        arrays = empty(clip)
        frame.copy_to(arrays)
        read_all.append(arrays[0])
    return read_all


def copy(source: Path, target: Path, change: Callable[[Array], Array] = lambda x: x, **options: Any) -> None:
    with open_sequence(source) as clip, sequence_writer(clip, target, **options) as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = empty(clip)
            frame.copy_to(arrays)
            sink.write([change(arrays[0])], k)


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


@pytest.mark.parametrize(
    ("shape", "dtype", "group", "white"),
    [
        ((6, 8), "u1", Group((6, 8), 1), 255.0),
        ((6, 8, 2), "u1", Group((6, 8), 2, alpha=True), 255.0),
        ((6, 8, 3), "u2", Group((6, 8), 3), 65535.0),
        ((1, 7, 4), "u2", Group((1, 7), 4, alpha=True), 65535.0),
    ],
)
def test_a_pattern_is_a_clip(tmp_path: Path, shape: tuple[int, ...], dtype: str, group: Group, white: float) -> None:
    made = save(tmp_path, numbers(98, 101), shape=shape, dtype=dtype)
    (tmp_path / "notes.txt").write_text("no picture")
    (tmp_path / "100.png").write_text("not of this pattern")
    with open_sequence(tmp_path / "%05d.png") as clip:
        assert clip.layout == Layout((group,), np.dtype(dtype), white)
        assert (clip.count, clip.rate, clip.first) == (4, Fraction(24), 98)
        for found, wanted in zip(frames_of(clip), made, strict=True):
            np.testing.assert_array_equal(found.reshape(shape), wanted)
        assert clip.info()["frames"] == 4


def test_floats_are_frames(tmp_path: Path) -> None:
    made = save(tmp_path, ["a1.tif", "a2.tif"], dtype="f4")
    with open_sequence(tmp_path / "a%d.tif") as clip:
        assert clip.layout == Layout((Group((6, 8), 3),), np.dtype("f4"), 1.0)
        np.testing.assert_array_equal(frames_of(clip), made)
        np.testing.assert_allclose(clip.to_rgb([made[0]]), made[0] * 255, atol=0.5001)


def test_numbers_without_zeros(tmp_path: Path) -> None:
    made = save(tmp_path, [f"shot {k}b.png" for k in range(8, 12)])
    save(tmp_path, ["shot 007b.png", "shot 70.png"])
    with open_sequence(tmp_path / "shot %db.png") as clip:
        assert clip.first == 8
        np.testing.assert_array_equal(frames_of(clip), made)


def test_a_folder_is_a_clip_in_natural_order(tmp_path: Path) -> None:
    made = save(tmp_path, ["f9.png", "F10.png", "f11.tif", "f100.png"])
    (tmp_path / ".f1.png").write_text("hidden")
    (tmp_path / "Thumbs.db").write_text("no picture")
    (tmp_path / "f1.png").mkdir()
    with open_sequence(tmp_path) as clip:
        assert [path.name for path in clip.paths] == ["f9.png", "F10.png", "f11.tif", "f100.png"]
        assert clip.first is None
        np.testing.assert_array_equal(frames_of(clip), made)


def test_what_names_a_sequence(tmp_path: Path) -> None:
    assert is_sequence("frames/%05d.png")
    assert is_sequence("%d.tif")
    assert is_sequence(tmp_path)
    assert is_sequence("not/there/")
    for name in ("clip.mp4", "100%.png", "%s.png", "%5d.png", ""):
        assert not is_sequence(name)


def test_the_folder_may_hold_percent_signs(tmp_path: Path) -> None:
    save(tmp_path / "50%d of it", numbers(1, 2))
    copy(tmp_path / "50%d of it" / "%05d.png", tmp_path / "50%d of it" / "b%02d.png")
    assert names(tmp_path / "50%d of it") == ["00001.png", "00002.png", "b01.png", "b02.png"]


@pytest.mark.parametrize(
    ("given", "rate"),
    [
        (24, Fraction(24)),
        (12.5, Fraction(25, 2)),
        (23.976, Fraction(24000, 1001)),
        (29.97, Fraction(30000, 1001)),
        (Fraction(30000, 1001), Fraction(30000, 1001)),
        (1000, Fraction(1000)),
        (0.0001, Fraction(1, 10000)),
        (0.4, Fraction(2, 5)),
    ],
)
def test_rates(tmp_path: Path, given: float, rate: Fraction) -> None:
    save(tmp_path, ["1.png"])
    with open_sequence(tmp_path, rate=given) as clip:
        assert clip.rate == rate


def refused(path: Path | str, match: str, **options: Any) -> None:
    with pytest.raises(SuppleError, match=match), open_sequence(path, **options):
        pass


def test_what_is_no_sequence_is_refused(tmp_path: Path) -> None:
    refused(tmp_path, "holds no pictures")
    refused(tmp_path / "missing", "cannot read the folder .*missing.*No such file")
    refused(tmp_path / "missing" / "%d.png", "cannot read the folder")
    refused(tmp_path / "%d.png", "no picture is named")
    refused(tmp_path / "%d-%d.png", "must hold one number")
    refused(tmp_path / "\0" / "%d.png", "no folder can have that name")
    for rate in (0, -1, float("nan"), float("inf"), 1e9, "fast"):
        refused(tmp_path, r"frames a second \(--fps\) must be", rate=rate)
    save(tmp_path, numbers(3, 5) + numbers(7, 9))
    refused(tmp_path / "%05d.png", r"00006\.png is missing between .*00003\.png and .*00009\.png")
    (tmp_path / "00010.png").write_text("no picture")
    refused(tmp_path, r"cannot read .*00010\.png")


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"shape": (6, 9, 3)}, r"b\.png is 9 x 6 of 3 channels in uint8, and .*a\.png 8 x 6 of 3 channels in uint8"),
        ({"shape": (6, 8, 4)}, r"b\.png is .* 4 channels with opacity .*a\.png"),
        ({"shape": (6, 8)}, r"b\.png is .* 1 channel in uint8, .*a\.png"),
        ({"dtype": "u2"}, r"b\.png is .*uint16, and .*a\.png .*uint8"),
    ],
)
def test_pictures_that_differ_are_refused(tmp_path: Path, options: dict[str, Any], match: str) -> None:
    save(tmp_path, ["a.png"])
    save(tmp_path, ["b.png"], **options)
    refused(tmp_path, match)


def test_types_that_no_frame_has_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", np.zeros((4, 4), np.int32))
    refused(tmp_path, r"a\.tif holds int32 values")


def test_damage_that_shows_late_is_told(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 3), shape=(60, 80, 3))
    cut = tmp_path / "in" / "00002.png"
    cut.write_bytes(cut.read_bytes()[:9000])
    with pytest.raises(SuppleError, match=r"cannot read .*00002\.png"):
        copy(tmp_path / "in", tmp_path / "out")
    assert names(tmp_path) == ["in"]
    with open_sequence(tmp_path / "in") as clip:
        write(cut, picture(0), force=True)
        frames = list(clip.frames())
        with pytest.raises(SuppleError, match=r"00002\.png is 8 x 6 .* first picture 80 x 60"):
            frames[1].copy_to(empty(clip))


def test_many_pages_are_told_once(tmp_path: Path) -> None:
    pages = pyvips.Image.new_from_array(picture(0)).copy(interpretation="srgb")
    pages.set_type(pyvips.GValue.gint_type, "page-height", 3)
    for k in range(3):
        pages.tiffsave(str(tmp_path / f"{k}.tif"))
    with pytest.warns(PageWarning, match=r"0\.tif holds several pages") as caught, open_sequence(tmp_path) as clip:
        assert len(frames_of(clip)) == 3
    assert len(caught) == 1


def test_pictures_become_rgb(tmp_path: Path) -> None:
    save(tmp_path / "grey", ["1.png"], shape=(6, 8, 2))
    with open_sequence(tmp_path / "grey") as clip:
        array = frames_of(clip)[0]
        np.testing.assert_array_equal(clip.to_rgb([array]), np.repeat(array[..., :1], 3, axis=2))
        np.testing.assert_array_equal(clip.to_rgb([array], deep=True)[..., 2], array[..., 0].astype(int) * 257)
    save(tmp_path / "deep", ["1.png"], dtype="u2")
    with open_sequence(tmp_path / "deep") as clip:
        np.testing.assert_array_equal(clip.to_rgb([np.full((2, 2, 3), 128 * 257, np.uint16)]), 128)
        assert clip.to_rgb(frames_of(clip), deep=True).dtype == np.uint16


# Written.


def test_numbers_profile_and_pixels_come_through(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for k in (1001, 1002):
        image = pyvips.Image.new_from_array(picture(k, dtype="u2"), interpretation="rgb16").copy()
        if k == 1001:
            image.set_type(pyvips.GValue.blob_type, "icc-profile-data", SRGB)
        image.set_type(pyvips.GValue.gint_type, "orientation", 6)
        image.set_type(pyvips.GValue.refstr_type, "exif-ifd0-Artist", f"Frame {k} (Frame {k}, ASCII, 11 components)")
        image.pngsave(str(tmp_path / "in" / f"{k}.png"))
    for target in (tmp_path / "out" / "%04d.png", tmp_path / "folder"):
        copy(tmp_path / "in", target)
    for folder in ("out", "folder"):
        assert names(tmp_path / folder) == ["1001.png", "1002.png"]
        for k in (1001, 1002):
            found = read(tmp_path / folder / f"{k}.png")
            np.testing.assert_array_equal(found.pixels, np.rot90(picture(k, dtype="u2"), -1))
            assert found.icc == (SRGB if k == 1001 else None)
            assert f"Frame {k}".encode() in found._header["exif-data"]
    assert names(tmp_path) == ["folder", "in", "out"]
    assert stat.S_IMODE(os.stat(tmp_path / "out").st_mode) == 0o777 & ~_umask()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("shape", [(6, 8), (6, 8, 2), (6, 8, 3), (6, 8, 4), (1, 1, 3)])
def test_every_kind_is_written_as_it_was(tmp_path: Path, shape: tuple[int, ...]) -> None:
    made = save(tmp_path / "in", numbers(0, 2), shape=shape, dtype="u2")
    copy(tmp_path / "in" / "%05d.png", tmp_path / "out" / "x%03d.tif")
    assert names(tmp_path / "out") == ["x000.tif", "x001.tif", "x002.tif"]
    for k, pixels in enumerate(made):
        found = read(tmp_path / "out" / f"x{k:03d}.tif")
        np.testing.assert_array_equal(found.pixels, pixels)
        assert found.alpha == (shape[2:] in ((2,), (4,)))


def test_formats_that_are_only_read_become_png(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for k in range(2):
        pyvips.Image.new_from_array(picture(k), interpretation="srgb").gifsave(str(tmp_path / "in" / f"{k}.gif"))
    copy(tmp_path / "in", tmp_path / "out")
    assert names(tmp_path / "out") == ["0.png", "1.png"]
    channels = read(tmp_path / "in" / "1.gif").pixels.shape[2]
    write(tmp_path / "in" / "1.png", picture(5, (6, 8, channels)))
    with pytest.raises(SuppleError, match=r"1\.gif and .*1\.png would both become 1\.png"):
        copy(tmp_path / "in", tmp_path / "more")


def test_existing_pictures_are_kept_unless_forced(tmp_path: Path) -> None:
    made = save(tmp_path / "in", numbers(1, 3))
    (tmp_path / "out").mkdir()
    kept = tmp_path / "out" / "00002.png"
    kept.write_text("kept")
    kept.chmod(0o640)
    with pytest.raises(SuppleError, match=r"00002\.png exists already"), open_sequence(tmp_path / "in") as clip:
        sequence_writer(clip, tmp_path / "out").__enter__()
    assert names(tmp_path / "out") == ["00002.png"]
    copy(tmp_path / "in", tmp_path / "out", force=True)
    assert names(tmp_path / "out") == numbers(1, 3)
    assert stat.S_IMODE(kept.stat().st_mode) == 0o640
    copy(tmp_path / "in", tmp_path / "in", lambda x: 255 - x, force=True)
    for k, pixels in enumerate(made):
        np.testing.assert_array_equal(read(tmp_path / "out" / f"{k + 1:05d}.png").pixels, pixels)
        np.testing.assert_array_equal(read(tmp_path / "in" / f"{k + 1:05d}.png").pixels, 255 - pixels)
    save(tmp_path / "short", numbers(2, 2))
    with pytest.warns(ImageWarning, match="also holds 2 other pictures"):
        copy(tmp_path / "short", tmp_path / "out" / "%05d.png", force=True)
    assert names(tmp_path / "out") == numbers(1, 3)


def test_a_name_that_is_taken_meanwhile_is_kept(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 3))
    for before in (False, True):
        out = tmp_path / f"out{before}"
        if before:
            out.mkdir()

        def meanwhile(pixels: Array, out: Path = out) -> Array:
            out.mkdir(exist_ok=True)
            (out / "00003.png").write_text("theirs")
            return pixels

        with pytest.raises(SuppleError, match=r"00003\.png exists already"):
            copy(tmp_path / "in", out, meanwhile)
        assert names(out) == ["00003.png"]
        assert (out / "00003.png").read_text() == "theirs"


@pytest.mark.parametrize("error", [KeyboardInterrupt, SuppleError])
@pytest.mark.parametrize("there", [False, True])
def test_what_ends_early_leaves_nothing(tmp_path: Path, error: type[BaseException], there: bool) -> None:
    save(tmp_path / "in", numbers(1, 3))
    if there:
        (tmp_path / "out").mkdir()
    seen = []

    def fail(pixels: Array) -> Array:
        seen.append(1)
        if len(seen) == 3:
            raise error("no more")
        return pixels

    with pytest.raises(error, match="no more"):
        copy(tmp_path / "in", tmp_path / "out", fail)
    assert names(tmp_path) == ["in", "out"] if there else ["in"]
    assert not there or names(tmp_path / "out") == []


def test_an_interrupt_while_files_are_moved_moves_them_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(tmp_path / "in", numbers(1, 4))
    save(tmp_path / "out", numbers(2, 3), shape=(2, 2))
    before = {name: (tmp_path / "out" / name).read_bytes() for name in numbers(2, 3)}
    rename = os.rename
    for stop in range(1, 7):
        calls = []

        def failing(a: Any, b: Any, stop: int = stop, calls: list[int] = calls) -> None:
            calls.append(1)
            if len(calls) == stop:
                if stop % 2:
                    raise OSError(28, "No space left on device")
                rename(a, b)
                raise KeyboardInterrupt
            rename(a, b)

        with monkeypatch.context() as patch:
            patch.setattr(folders.os, "rename", failing)
            with pytest.raises((KeyboardInterrupt, SuppleError)):
                copy(tmp_path / "in", tmp_path / "out", force=True)
        assert {name: (tmp_path / "out" / name).read_bytes() for name in names(tmp_path / "out")} == before


def test_places_that_cannot_be_written_are_refused_first(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 2))
    (tmp_path / "file").write_text("")
    (tmp_path / "out" / "00002.png").mkdir(parents=True)
    for target, match in (
        ("a/b/%d.png", "there is no folder .*a: make it first"),
        ("a/b", "there is no folder .*a: make it first"),
        ("file", "file.*Not a directory"),
        ("out", "00002.png: it is a folder"),
        ("%d.mp4", "the suffix .mp4 is no image format"),
        ("%d", "a name without suffix is no image format"),
        ("%d%d.png", "must hold one number"),
    ):
        with pytest.raises(SuppleError, match=match), open_sequence(tmp_path / "in") as clip:
            sequence_writer(clip, tmp_path / target, force=True).__enter__()
    assert names(tmp_path) == ["file", "in", "out"]


def test_formats_that_cannot_hold_it_name_the_file_that_was_meant(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 2), shape=(6, 8, 4))
    with pytest.raises(SuppleError, match=rf"cannot write {tmp_path}/out/1\.jpg: JPEG holds no transparency"):
        copy(tmp_path / "in", tmp_path / "out" / "%d.jpg")
    save(tmp_path / "deep", numbers(1, 3), dtype="u2")
    with pytest.warns(DepthWarning) as caught:
        copy(tmp_path / "deep", tmp_path / "out" / "%d.jpg")
    assert [str(w.message) for w in caught] == [
        f"{tmp_path}/out/1.jpg: JPEG holds 8 bits a channel, and the 16 of the pixels are rounded"
    ]


class Video:
    """What a writer sees of a video: planes, and how they become RGB."""

    name, count, rotation, unpictured = "video", 2, 0.0, ()

    def __init__(self, white: float, alpha: bool) -> None:
        luma, chroma = Group((6, 8), 1 + alpha, alpha=alpha), Group((3, 4), 2, (2, 2))
        self.layout = Layout((luma, chroma), np.dtype("u1" if white == 255 else "u2"), white)

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        return np.repeat(arrays[0][..., :1], 3, axis=2) * np.array(64 if deep else 1, "u2" if deep else "u1")


@pytest.mark.parametrize(("white", "alpha"), [(255.0, False), (255.0, True), (1023.0, False), (1023.0, True)])
def test_videos_become_pictures(tmp_path: Path, white: float, alpha: bool) -> None:
    clip = Video(white, alpha)
    luma = np.zeros((6, 8, 1 + alpha), clip.layout.dtype)
    luma[..., 0], luma[..., alpha:] = 100, white if alpha else 100
    for target, wanted in ((tmp_path / "folder", numbers(1, 2)), (tmp_path / "p" / "%d.png", ["1.png", "2.png"])):
        with sequence_writer(clip, target) as sink:
            for k in range(2):
                sink.write([luma, np.zeros((3, 4, 2))], k)
        found = [read((tmp_path / "folder" if target.suffix == "" else tmp_path / "p") / name) for name in wanted]
        for each in found:
            assert each.alpha == alpha
            assert each.pixels.shape == (6, 8, 3 + alpha)
            assert each.pixels.dtype == (np.uint8 if white == 255 else np.uint16)
            assert (each.pixels[..., :3] == (100 if white == 255 else 6400)).all()
            assert not alpha or (each.pixels[..., 3] == np.iinfo(each.pixels.dtype).max).all()


class Plain(Video):
    """A video that has no more than 8 bits to give, and is to be turned."""

    rotation = 90

    def to_rgb(self, arrays: Sequence[Array], *, deep: bool = False) -> Array:
        return np.repeat(arrays[0][..., :1], 3, axis=2).astype(np.uint8)


def test_a_turned_video_becomes_upright_pictures(tmp_path: Path) -> None:
    luma = np.arange(48, dtype=np.uint16).reshape(6, 8, 1)
    with sequence_writer(Plain(1023.0, False), tmp_path / "out") as sink:
        sink.write([luma, np.zeros((3, 4, 2))], 0)
    np.testing.assert_array_equal(read(tmp_path / "out" / "00001.png").pixels[..., 0], np.rot90(luma[..., 0]))


def test_a_picture_without_pixels_has_all_else(tmp_path: Path) -> None:
    write(tmp_path / "1.png", picture(0), like=Picture(picture(0), icc=SRGB))
    with open_sequence(tmp_path) as clip, warnings.catch_warnings():
        like, lost = clip.picture(0)
    assert (like.icc, like.pixels.size, like.bits, lost) == (SRGB, 0, 8, [])


# --- pictures become a film ---


def film(source: Path, target: Path, rate: float = 24, **options: Any) -> None:
    with open_sequence(source, rate=rate) as clip, writer_of(clip, target, **options) as sink:
        for k, pixels in enumerate(frames_of(clip)):
            sink.write([pixels], k)


def shot(path: Path) -> tuple[dict[str, Any], list[list[Array]]]:
    """What a video file holds, and its frames."""
    with open_video(path) as clip:
        found = []
        for frame in clip.frames():
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
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
    with warnings.catch_warnings():
        warnings.simplefilter("error")
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


def test_opacity_of_pictures_is_kept_or_missed(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 2), shape=(48, 64, 4))
    film(tmp_path / "in", tmp_path / "a.webm")
    assert info(tmp_path / "a.webm")["alpha"]
    with pytest.warns(ClipWarning, match="loses opacity") as caught:
        film(tmp_path / "in", tmp_path / "a.mp4", pixel_format="yuv420p")
    assert len(caught) == 1


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
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        film(tmp_path / "in", tmp_path / "a.mkv", codec=codec)
    told = f"{tmp_path / 'a.mkv'} loses {lost}" + (f": --pixel-format {keeps} keeps more" if keeps else "")
    assert [str(warning.message) for warning in caught] == [told]
    if keeps:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            film(tmp_path / "in", tmp_path / "b.mkv", codec=codec, pixel_format=keeps)
        assert info(tmp_path / "b.mkv")["pixel_format"] == keeps


def test_grey_pictures_lose_nothing_in_a_film(tmp_path: Path) -> None:
    save(tmp_path / "in", numbers(1, 2), shape=(48, 64))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        film(tmp_path / "in", tmp_path / "a.mp4")


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


def test_pixel_formats_that_are_asked_for_are_taken(tmp_path: Path) -> None:
    gradients(tmp_path / "in", 2)
    film(tmp_path / "in", tmp_path / "a.mp4", codec="hevc", pixel_format="gbrp")
    assert info(tmp_path / "a.mp4")["pixel_format"] == "gbrp"
    film(tmp_path / "in", tmp_path / "b.mp4", pixel_format="yuv444p")
    assert info(tmp_path / "b.mp4")["pixel_format"] == "yuv444p"


def test_a_film_of_pictures_is_whole_or_not_there(tmp_path: Path) -> None:
    gradients(tmp_path / "in", 3)

    def interrupted() -> None:
        with open_sequence(tmp_path / "in") as clip, writer_of(clip, tmp_path / "a.mp4") as sink:
            sink.write([frames_of(clip)[0]], 0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(tmp_path) == ["in"]


def test_pictures_without_colours_are_refused(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    pyvips.Image.black(8, 8, bands=4).copy(interpretation="cmyk").tiffsave(str(tmp_path / "in" / "1.tif"))
    with pytest.raises(SuppleError, match="neither grey nor RGB pictures: convert them"):
        film(tmp_path / "in", tmp_path / "a.mp4")
    assert names(tmp_path) == ["in"]


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_a_film_becomes_the_pictures_that_it_was_made_of(tmp_path: Path, dtype: str) -> None:
    kept = save(tmp_path / "in", numbers(1, 3), shape=(6, 8, 4), dtype=dtype)
    film(tmp_path / "in", tmp_path / "a.mkv", codec="ffv1")
    with open_video(tmp_path / "a.mkv") as clip, sequence_writer(clip, tmp_path / "out") as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
            frame.copy_to(arrays)
            sink.write(arrays, k)
    for want, name in zip(kept, numbers(1, 3), strict=True):
        np.testing.assert_array_equal(read(tmp_path / "out" / name).pixels, want)
