"""Picture formats beyond the usual ones: what is in them comes out, and goes back in."""

from __future__ import annotations

import shutil
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import pyvips
from PIL import Image

import supple
from supple.errors import SuppleError
from supple.files import warp_file
from supple.media.image import DepthWarning, MetadataWarning, PageWarning, Picture, info, read, write
from supple.media.video import open_clip as open_video
from tests.media.image.pictures import noise, smooth

Array = npt.NDArray[Any]


def test_a_tiff_in_ycbcr_that_pillow_wrote(tmp_path: Path) -> None:
    pixels = smooth(60, 80)
    image = Image.fromarray(pixels)
    image.convert("YCbCr").save(tmp_path / "plain.tif")
    image.save(tmp_path / "jpeg.tif", compression="jpeg", quality=98)
    for name in ("plain.tif", "jpeg.tif"):
        assert np.abs(read(tmp_path / name).pixels.astype(int) - pixels).mean() < 3


def test_radiance(tmp_path: Path) -> None:
    pixels = 20 * np.random.default_rng(1).random((19, 23, 3), np.float32)
    write(tmp_path / "out.hdr", pixels)
    picture = read(tmp_path / "out.hdr")
    assert picture.format == "Radiance"
    assert np.abs(picture.pixels - pixels).max() <= 20 / 128  # eight bits, and one exponent for three of them


@pytest.mark.parametrize("half", [False, True])
def test_openexr_keeps_half_and_float(tmp_path: Path, half: bool) -> None:
    pixels = noise("f4", 40, 60, 3)
    path = tmp_path / "in.exr"
    write(path, pixels, like=Picture(pixels, bits=16 if half else 32))
    picture = read(path)
    assert (picture.format, picture.bits, picture.pixels.dtype) == ("OpenEXR", 16 if half else 32, np.float32)
    np.testing.assert_array_equal(picture.pixels, pixels.astype("f2").astype("f4") if half else pixels)
    recipe = supple.Recipe(strokes=[supple.Stroke.grab((20, 20), to=(24, 20), radius=6)])
    warp_file(path, tmp_path / "out.exr", recipe)
    bent = read(tmp_path / "out.exr")
    assert bent.bits == picture.bits
    true = supple.Deformation.from_recipe(recipe, (40, 60)).warp(picture.pixels, clamp=True)
    np.testing.assert_array_equal(bent.pixels, true.astype("f2").astype("f4") if half else true)


def test_opacity_is_multiplied_in_openexr(tmp_path: Path) -> None:
    pixels = np.dstack([noise("f4", 9, 9, 3), np.full((9, 9), 0.5, "f4")])
    write(tmp_path / "out.exr", pixels, alpha=True)
    np.testing.assert_array_equal(read(tmp_path / "out.exr").pixels[..., :3], pixels[..., :3] / 2)


@pytest.mark.parametrize(
    "name", ["grey.pgm", "plain.pgm", "bits.pbm", "palette.bmp", "rle.tga", "lossy.jp2", "rgba.jp2"]
)
def test_what_pillow_writes(tmp_path: Path, name: str) -> None:
    pixels = smooth(20, 30)
    image = Image.fromarray(pixels)
    path = tmp_path / name
    if name == "plain.pgm":
        image = image.convert("L")
        path.write_text("P2\n30 20\n255\n" + " ".join(map(str, np.asarray(image).ravel())))
    elif name == "grey.pgm":
        image = image.convert("L")
        image.save(path)
    elif name == "bits.pbm":
        image = image.convert("1")
        image.save(path)
        image = image.convert("L")
    elif name == "palette.bmp":
        image.quantize(20).save(path)
        image = image.quantize(20).convert("RGB")
    elif name == "rle.tga":
        image.save(path, compression="tga_rle")
    elif name == "rgba.jp2":
        image = image.convert("RGBA")
        image.putalpha(77)
        image.save(path, irreversible=False)
    else:
        image.save(path, irreversible=True, quality_mode="dB", quality_layers=[60])
    picture = read(path)
    assert np.abs(picture.pixels.astype(int) - np.asarray(image)).max() <= 2 * (name == "lossy.jp2")
    assert picture.alpha == (name == "rgba.jp2")


def test_what_does_not_come_along_is_told(tmp_path: Path) -> None:
    Image.fromarray(smooth(20, 30)).save(tmp_path / "in.jpg", exif=b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0")
    picture = replace(read(tmp_path / "in.jpg"), icc=b"profile")
    with pytest.warns(MetadataWarning, match=r"out\.bmp: BMP cannot take over EXIF and the colour profile$"):
        write(tmp_path / "out.bmp", picture.pixels, like=picture)
    with pytest.warns(DepthWarning, match=r"BMP holds 8 bits a channel, and the 16 of the pixels are rounded$"):
        write(tmp_path / "deep.bmp", noise("u2", 9, 9, 3))


@pytest.mark.parametrize("suffix", [".exr", ".bmp", ".tga", ".jp2", ".ppm"])
def test_what_is_cut_short(tmp_path: Path, suffix: str) -> None:
    write(tmp_path / f"in{suffix}", noise("f4" if suffix == ".exr" else "u1", 64, 64, 3))
    path = tmp_path / f"cut{suffix}"
    path.write_bytes((tmp_path / f"in{suffix}").read_bytes()[:40])
    with pytest.raises(SuppleError, match=r"cut short or of a kind that is not supported"):
        read(path)


def animation(path: Path) -> list[Array]:
    """Five frames of a square that walks, of 100, 100, 200, 100 and 50 milliseconds."""
    frames = []
    for k in range(5):
        frame = np.full((40, 60, 3), 30 * k, np.uint8)
        frame[10:20, 5 + 8 * k : 15 + 8 * k] = (255, 40, 10)
        frames.append(frame)
    first, *others = map(Image.fromarray, frames)
    options = {"lossless": True} if path.suffix == ".webp" else {}
    first.save(path, save_all=True, append_images=others, duration=[100, 100, 200, 100, 50], **options)
    return frames


@pytest.mark.parametrize("suffix", [".png", ".webp", ".gif"])
def test_an_animation_is_no_picture_without_a_word(tmp_path: Path, suffix: str) -> None:
    frames = animation(tmp_path / f"in{suffix}")
    what = r"holds 5 frames, and only the first is read: name an animation or a video, out\.webp or out\.mp4, to keep"
    with pytest.warns(PageWarning, match=what):
        picture = read(tmp_path / f"in{suffix}")
    np.testing.assert_array_equal(picture.pixels[..., :3], frames[0])
    assert info(tmp_path / f"in{suffix}")["pages"] == 5


@pytest.mark.parametrize("suffix", [".png", ".webp"])
@pytest.mark.parametrize("target", ["out.mkv", "out-%02d.png", "out/"])
@pytest.mark.filterwarnings("ignore:.* plays over and over")
def test_an_animation_is_a_clip(tmp_path: Path, suffix: str, target: str) -> None:
    frames = animation(tmp_path / f"in{suffix}")
    strokes = [supple.Stroke.grab((30, 30, 2), to=(33, 30, 2), radius=3)]
    made = warp_file(tmp_path / f"in{suffix}", f"{tmp_path}/{target}", supple.Recipe(strokes=strokes), lossless=True)
    assert made.frames == 5
    if "mkv" in target:
        with open_video(tmp_path / "out.mkv") as clip:
            arrays = [np.empty((40, 60, clip.layout.groups[0].channels), np.uint8)]
            for frame, true in zip(clip.frames(), frames, strict=True):
                frame.copy_to(arrays)
                np.testing.assert_array_equal(arrays[0][:20, ..., :3], true[:20])
            assert clip.survey.duration == pytest.approx(0.55, abs=0.06)
    else:
        names = sorted(path.name for path in tmp_path.glob("out*/*" if "/" in target else "out-*"))
        assert names == [f"{k:05d}.png" if "/" in target else f"out-{k:02d}.png" for k in range(1, 6)]


@pytest.mark.parametrize("told", ["system error: Unknown error -1", "write failed"])
def test_a_full_disk_is_called_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: str) -> None:
    def fail(*_given: object, **_options: object) -> None:
        raise pyvips.Error("no", f"target: {told}\n")

    monkeypatch.setattr(pyvips.Image, "pngsave", fail, raising=False)
    with pytest.raises(SuppleError) as caught:
        write(tmp_path / "out.png", smooth(20, 30))
    assert "space" not in str(caught.value)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=4096))
    with pytest.raises(SuppleError) as caught:
        write(tmp_path / "out.png", smooth(20, 30))
    reason = "No space left on device: make room or choose another place"
    assert str(caught.value) == f"cannot write {tmp_path / 'out.png'}: {reason}"


def test_all_pages_of_a_tiff_are_bent_alike(tmp_path: Path) -> None:
    pages = [smooth(40, 60) + np.uint8(20 * k) for k in range(3)]
    first, *others = map(Image.fromarray, pages)
    first.save(tmp_path / "in.tif", save_all=True, append_images=others)
    recipe = supple.Recipe(strokes=[supple.Stroke.grab((20, 20), to=(24, 20), radius=6)])
    warp_file(tmp_path / "in.tif", tmp_path / "out.tif", recipe)
    map_ = supple.Deformation.from_recipe(recipe, (40, 60))
    with Image.open(tmp_path / "out.tif") as image:
        assert image.n_frames == 3
        for k, page in enumerate(pages):
            image.seek(k)
            np.testing.assert_array_equal(np.asarray(image), map_.warp(page))
            assert image.tag_v2.get(296, 1) == 1
    what = r"holds 3 pages, and only one is read: all are kept if they are of one size"
    with pytest.warns(PageWarning, match=what):
        warp_file(tmp_path / "in.tif", tmp_path / "out.png", recipe)
    Image.fromarray(pages[0]).save(tmp_path / "odd.tif", save_all=True, append_images=[Image.fromarray(pages[0][:9])])
    with pytest.warns(PageWarning, match="holds 2 pages, and only one"):
        warp_file(tmp_path / "odd.tif", tmp_path / "one.tif", recipe)


def dpx(path: Path, pixels: Array, bits: int, order: str, curve: int = 1, elements: int = 1, kind: int = 50) -> bytes:
    """Write a DPX as scanners do, with what is told of film and television; return its header."""
    head = bytearray(8192)  # with an orientation, from bottom to top
    head[:4] = b"SDPX" if order == ">" else b"XPDS"
    head[8:12], head[36:43], head[1664:1668] = b"V1.0", b"old.dpx", b"12AB"
    struct.pack_into(f"{order}HHII", head, 768, 2, elements, pixels.shape[1], pixels.shape[0])
    struct.pack_into(f"{order}IIfIf", head, 780, 0, 95, 0.0, 685, 2.046)
    head[800:804] = bytes((kind, curve, curve, bits))
    struct.pack_into(f"{order}HHI", head, 804, int(bits in (10, 12)), 0, len(head))
    struct.pack_into(f"{order}I", head, 1920, 0x01020304)  # the timecode
    wide = pixels.astype(np.uint32)
    if bits == 10:
        data = (wide[..., 0] << 22 | wide[..., 1] << 12 | wide[..., 2] << 2).astype(f"{order}u4")
    else:
        data = (wide << (4 if bits == 12 else 0)).astype("u1" if bits == 8 else f"{order}u2")
    struct.pack_into(f"{order}I", head, 4, len(head))
    struct.pack_into(f"{order}III", head, 16, len(head) + data.nbytes, 1, 1664)
    path.write_bytes(bytes(head) + data.tobytes())
    return bytes(head)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_dpx_keeps_its_bits_and_its_header(tmp_path: Path, bits: int, order: str) -> None:
    pixels = np.random.default_rng(bits).integers(0, 2**bits, (19, 24, 3))
    head = dpx(tmp_path / "in.dpx", pixels, bits, order)
    picture = read(tmp_path / "in.dpx")
    assert (picture.format, picture.bits, picture.alpha) == ("DPX", bits, False)
    np.testing.assert_array_equal(picture.pixels >> (8 if bits == 8 else 16) - bits, pixels)
    write(tmp_path / "out.dpx", picture.pixels, picture)
    made = (tmp_path / "out.dpx").read_bytes()
    assert made[2048:] == (tmp_path / "in.dpx").read_bytes()[8192:]
    assert made[36:44] == b"out.dpx\0"
    assert struct.unpack_from(f"{order}I", made, 4) == struct.unpack_from(f"{order}I", made, 808) == (2048,)
    for part in (slice(0, 4), slice(136, 808), slice(812, 2048)):  # all but names and places
        assert made[part] == head[part]
    with pytest.warns(MetadataWarning, match="cannot take over the header of a DPX"):
        write(tmp_path / "out.tif", picture.pixels, picture)


def test_what_a_dpx_is_not_read_for(tmp_path: Path) -> None:
    pixels = np.zeros((8, 8, 3), int)
    dpx(tmp_path / "two.dpx", pixels, 10, ">", elements=2)
    dpx(tmp_path / "yuv.dpx", pixels, 8, ">", kind=102)
    for name, text in (("two.dpx", "2 image elements"), ("yuv.dpx", "samples of kind 102")):
        with pytest.raises(SuppleError, match=f"{name}: .*{text}.*not supported: "):
            read(tmp_path / name)
