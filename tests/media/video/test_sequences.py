"""Image sequences as clips: what they are made of, in order, and what is written in their place."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvips

from supple import SuppleError
from supple.engine.work import Group, Layout
from supple.media.image import DepthWarning, ImageWarning, PageWarning, read, write
from supple.media.numbering import is_sequence
from supple.media.sequence import open_clip as open_sequence
from supple.media.sequence import writer as sequence_writer
from tests.media.video.sequences import SRGB, Array, empty, frames_of, names, numbers, picture, save

# what every film of RGB pictures says that is as players want it; `test_what_a_sequence_loses_is_said` hears it
pytestmark = pytest.mark.filterwarnings("ignore:.* loses detail of colours:supple.media.base.ClipWarning")


def copy(source: Path, target: Path, change: Callable[[Array], Array] = lambda x: x, **options: Any) -> None:
    with open_sequence(source) as clip, sequence_writer(clip, target, **options) as sink:
        for k, frame in enumerate(clip.frames()):
            arrays = empty(clip)
            frame.copy_to(arrays)
            sink.write([change(arrays[0])], k)


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
        refused(tmp_path, "rate must be a number of frames a second", rate=rate)
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
