import gc
import os
import stat
import struct
import subprocess
import sys
import textwrap
import tracemalloc
import warnings
import zlib
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import pyvips
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from supple.errors import SuppleError
from supple.media.image import (
    SUFFIXES_OUT,
    DepthWarning,
    ImageWarning,
    MetadataWarning,
    PageWarning,
    Picture,
    check_target,
    info,
    read,
    write,
)
from supple.media.image.exif import from_tiff, into_tiff, is_whole
from supple.media.image.formats import TIFF
from supple.media.image.formats import settings as saver_settings
from tests.children import SOURCE

FORMATS = (".png", ".jpg", ".tif", ".webp", ".avif")
SAVERS = {".png": "pngsave", ".jpg": "jpegsave", ".tif": "tiffsave", ".webp": "webpsave", ".avif": "heifsave"}
SRGB = bytes(pyvips.Operation.call("profile_load", "srgb"))
CMYK = bytes(pyvips.Operation.call("profile_load", "cmyk"))
BLOB, STRING, INT = pyvips.GValue.blob_type, pyvips.GValue.refstr_type, pyvips.GValue.gint_type

# what a viewer does to the stored pixels, for each value of the orientation tag
UPRIGHT = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: np.rot90(a, 2),
    4: lambda a: a[::-1],
    5: lambda a: np.swapaxes(a, 0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(np.swapaxes(a, 0, 1), 2),
    8: lambda a: np.rot90(a, 1),
}


def noise(dtype, *shape):
    random = np.random.default_rng(sum(shape))
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return random.normal(size=shape).astype(dtype)
    bounds = np.iinfo(dtype)
    return random.integers(bounds.min, bounds.max, shape, dtype, endpoint=True)


def smooth(height, width, dtype=np.uint8):
    """Make a picture that lossy formats keep well, and that no two turns of are alike."""
    y, x = np.mgrid[:height, :width]
    colours = np.stack([x / width, y / height, (x + y) / (width + height)], axis=-1)
    return (colours * np.iinfo(dtype).max).astype(dtype)


def save(path, pixels, fields=(), **options):
    """Write an image with pyvips alone."""
    image = pyvips.Image.new_from_array(pixels, interpretation="b-w" if pixels.ndim == 2 else "srgb").copy()
    for name, value in dict(fields).items():
        image.set_type({bytes: BLOB, str: STRING, int: INT}[type(value)], name, value)
    getattr(image, SAVERS[path.suffix])(str(path), **options)


def loaded(path):
    """Read an image with pyvips alone: its pixels as they stand in the file, and its header."""
    image = pyvips.Image.new_from_buffer(path.read_bytes(), "")
    return image.numpy(), {name: image.get(name) for name in image.get_fields()}


def run(code, *arguments):
    """Run a program in a process of its own, and return its exit status and output."""
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": SOURCE}
    done = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment)
    return done.returncode, done.stdout + done.stderr


def refused(action, *arguments, **options):
    """Return the one line that an action is refused with."""
    with pytest.raises(SuppleError) as caught:
        action(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


class TestRoundTrips:
    @pytest.mark.parametrize("channels", [(), (2,), (3,), (4,)])
    @pytest.mark.parametrize(
        ("suffix", "dtype"),
        [
            *[(suffix, dtype) for suffix in (".png", ".tif", ".tiff") for dtype in ("u1", "u2")],
            *[(".tif", dtype) for dtype in ("f4", "i1", "i2", "u4", "i4")],
        ],
    )
    def test_bit_for_bit(self, tmp_path, suffix, dtype, channels):
        pixels = noise(dtype, 19, 23, *channels)
        write(tmp_path / f"out{suffix}", pixels)
        picture = read(tmp_path / f"out{suffix}")
        assert picture.pixels.dtype == pixels.dtype
        assert picture.pixels.flags.c_contiguous
        np.testing.assert_array_equal(picture.pixels, pixels)
        assert picture.alpha == (channels in ((2,), (4,)))
        assert picture.bits == pixels.dtype.itemsize * 8

    @pytest.mark.parametrize("channels", [3, 4])
    @pytest.mark.parametrize("suffix", [".webp", ".avif"])
    def test_bit_for_bit_when_asked_for(self, tmp_path, suffix, channels):
        pixels = noise("u1", 19, 23, channels)  # with colours where alpha is 0
        write(tmp_path / f"out{suffix}", pixels, lossless=True)
        picture = read(tmp_path / f"out{suffix}")
        np.testing.assert_array_equal(picture.pixels, pixels)
        assert picture.alpha == (channels == 4)

    @pytest.mark.parametrize("alpha", [False, True])
    @pytest.mark.parametrize("suffix", [".webp", ".avif"])
    def test_formats_without_grey_repeat_it(self, tmp_path, suffix, alpha):
        pixels = noise("u1", 19, 23, 2) if alpha else noise("u1", 19, 23)
        write(tmp_path / f"out{suffix}", pixels, lossless=True)
        picture = read(tmp_path / f"out{suffix}")
        grey = pixels[..., 0] if alpha else pixels
        np.testing.assert_array_equal(picture.pixels[..., :3], np.repeat(grey[..., None], 3, axis=2))
        assert picture.alpha == alpha
        assert not alpha or np.array_equal(picture.pixels[..., 3], pixels[..., 1])

    @settings(max_examples=30, deadline=None)
    @given(
        hnp.arrays(
            st.sampled_from([np.uint8, np.uint16]),
            st.tuples(st.integers(1, 20), st.integers(1, 20), st.sampled_from([2, 3, 4])),
        ),
        st.sampled_from([".png", ".tif"]),
    )
    def test_any_pixels(self, tmp_path_factory, pixels, suffix):
        path = tmp_path_factory.getbasetemp() / f"any{suffix}"
        write(path, pixels, force=True)
        np.testing.assert_array_equal(read(path).pixels, pixels)

    @pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
    @pytest.mark.parametrize("suffix", FORMATS)
    def test_the_smallest_images(self, tmp_path, suffix, shape):
        pixels = np.full((*shape, 3), 200, np.uint8)
        write(tmp_path / f"out{suffix}", pixels)
        assert np.abs(read(tmp_path / f"out{suffix}").pixels.astype(int) - 200).max() <= 3
        write(tmp_path / f"grey{suffix}", pixels[..., 0])
        assert read(tmp_path / f"grey{suffix}").pixels.shape[:2] == shape

    @pytest.mark.parametrize(("suffix", "worst"), [(".jpg", 6), (".webp", 12), (".avif", 6)])
    def test_lossy_formats_stay_close(self, tmp_path, suffix, worst):
        pixels = smooth(64, 96)
        write(tmp_path / f"out{suffix}", pixels)
        assert np.abs(read(tmp_path / f"out{suffix}").pixels.astype(int) - pixels).max() <= worst

    def test_jpeg_keeps_its_colours_sharp(self, tmp_path):
        write(tmp_path / "out.jpg", smooth(32, 32))
        assert loaded(tmp_path / "out.jpg")[1]["jpeg-chroma-subsample"] == "4:4:4"

    @pytest.mark.parametrize("suffix", [".jpg", ".webp", ".avif"])
    def test_quality_costs_bytes(self, tmp_path, suffix):
        pixels = smooth(64, 64) // 2 + noise("u1", 64, 64, 3) // 8
        for quality in (30, 99):
            write(tmp_path / f"{quality}{suffix}", pixels, quality=quality)
        low, high = ((tmp_path / f"{quality}{suffix}").stat().st_size for quality in (30, 99))
        assert low < high / 2

    @pytest.mark.parametrize("suffix", [".png", ".tif"])
    @pytest.mark.parametrize("shape", [(8, 40_000, 3), (40_000, 8, 3)])
    def test_sides_beyond_32767(self, tmp_path, suffix, shape):
        pixels = noise("u1", *shape)
        write(tmp_path / f"out{suffix}", pixels)
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").pixels, pixels)

    def test_arrays_of_any_layout(self, tmp_path):
        pixels = noise("u2", 30, 40, 3)
        for name, view in {
            "a": pixels[::2, ::-3],
            "b": pixels.swapaxes(0, 1),
            "c": pixels.astype(">u2"),
        }.items():
            write(tmp_path / f"{name}.png", view)
            np.testing.assert_array_equal(read(tmp_path / f"{name}.png").pixels, view)
        pixels.flags.writeable = False
        write(tmp_path / "d.png", pixels)
        np.testing.assert_array_equal(read(tmp_path / "d.png").pixels, pixels)

    @pytest.mark.parametrize("suffix", [".png", ".tif"])
    def test_smooth_images_become_small_files(self, tmp_path, suffix):
        for dtype in ("u1", "u2"):
            pixels = smooth(300, 400, dtype)
            write(tmp_path / f"{dtype}{suffix}", pixels)
            assert (tmp_path / f"{dtype}{suffix}").stat().st_size < pixels.nbytes / 10

    def test_beyond_4_gigabytes_tiff_changes_its_kind(self):
        for width, big in ((60_000, True), (50_000, False)):
            pixels = np.broadcast_to(np.uint8(0), (70_000, width))  # takes no memory
            assert saver_settings(TIFF, pixels, 8, None, False)["bigtiff"] is big

    def test_many_channels_go_into_tiff(self, tmp_path):
        pixels = noise("u2", 19, 23, 7)
        write(tmp_path / "out.tif", pixels)
        picture = read(tmp_path / "out.tif")
        np.testing.assert_array_equal(picture.pixels, pixels)
        assert not picture.alpha

    def test_other_readers_see_the_colours_named(self, tmp_path):
        for dtype, names in {"u1": ("b-w", "srgb"), "u2": ("grey16", "rgb16")}.items():
            for channels, name in zip(((), (3,)), names, strict=True):
                for suffix in (".png", ".tif"):
                    write(tmp_path / f"out{suffix}", noise(dtype, 9, 9, *channels), force=True)
                    assert info(tmp_path / f"out{suffix}")["interpretation"] == name


class TestDepth:
    @pytest.mark.parametrize("suffix", [".jpg", ".webp"])
    def test_16_bits_are_rounded_to_8(self, tmp_path, suffix):
        ramp = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        with pytest.warns(DepthWarning, match=rf"out\{suffix}: .* holds 8 bits a channel, and the 16 .* rounded$"):
            write(tmp_path / f"out{suffix}", ramp, lossless=suffix == ".webp", quality=100)
        found = read(tmp_path / f"out{suffix}").pixels.reshape(256, 256, -1)[..., 0]
        worst = np.abs(found - np.rint(ramp / 257)).max()
        assert worst == 0 if suffix == ".webp" else worst <= 2

    def test_avif_keeps_12_bits_and_white(self, tmp_path):
        ramp = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        with pytest.warns(DepthWarning, match="AVIF holds 12 bits a channel, and the 16"):
            write(tmp_path / "out.avif", ramp, lossless=True)
        picture = read(tmp_path / "out.avif")
        assert (picture.pixels.dtype, picture.bits) == (np.uint16, 12)
        assert picture.pixels.min() == 0
        assert picture.pixels.max() == 65535
        assert np.abs(picture.pixels[..., 0].astype(int) - ramp).max() <= 65535 / 4095 / 2 + 1
        write(tmp_path / "again.avif", picture.pixels, like=picture, lossless=True)  # and warns no more
        np.testing.assert_array_equal(read(tmp_path / "again.avif").pixels, picture.pixels)

    def test_ten_bits_stay_ten(self, tmp_path):
        save(tmp_path / "ten.avif", smooth(32, 32, np.uint16), compression="av1", lossless=True, bitdepth=10)
        picture = read(tmp_path / "ten.avif")
        assert picture.bits == 10
        assert picture.pixels.max() > 65472 - 64 * 32
        write(tmp_path / "again.avif", picture.pixels, like=picture, lossless=True)
        again = read(tmp_path / "again.avif")
        assert again.bits == 10
        np.testing.assert_array_equal(again.pixels, picture.pixels)

    def test_one_bit_and_palettes_are_spread(self, tmp_path):
        bits = noise("u1", 16, 24) // 128 * 255
        save(tmp_path / "bits.png", bits, bitdepth=1)
        assert info(tmp_path / "bits.png")["bits"] == 1
        np.testing.assert_array_equal(read(tmp_path / "bits.png").pixels, bits)
        colours = np.zeros((16, 24, 3), np.uint8)
        colours[4:9, 3:8] = (255, 0, 0)
        save(tmp_path / "palette.png", colours, palette=True)
        assert info(tmp_path / "palette.png")["channels"] == 3
        np.testing.assert_array_equal(read(tmp_path / "palette.png").pixels, colours)
        clear = np.concatenate([colours, colours[..., :1]], axis=2)
        save(tmp_path / "clear.png", clear, palette=True)
        picture = read(tmp_path / "clear.png")
        assert picture.alpha
        write(tmp_path / "out.png", picture.pixels, like=picture)
        np.testing.assert_array_equal(read(tmp_path / "out.png").pixels, picture.pixels)


class TestOrientation:
    @pytest.mark.parametrize("suffix", [".jpg", ".tif", ".png", ".webp"])
    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_is_applied_once(self, tmp_path, orientation, suffix):
        path = tmp_path / f"turned{suffix}"
        save(path, smooth(40, 70), {"orientation": orientation})
        stored = loaded(path)[0]
        upright = UPRIGHT[orientation](stored)
        picture = read(path)
        np.testing.assert_array_equal(picture.pixels, upright)
        assert picture.pixels.flags.c_contiguous
        facts = info(path)
        assert (facts["height"], facts["width"], facts["orientation"]) == (*upright.shape[:2], orientation)
        for target in (".png", ".tif", suffix):
            out = tmp_path / f"out{target}"
            write(out, picture.pixels, like=picture, force=True)
            pixels, header = loaded(out)
            assert header.get("orientation", 1) == 1
            assert header.get("exif-ifd0-Orientation", "1").startswith("1")
            assert pixels.shape == upright.shape
            if target in (".png", ".tif"):
                np.testing.assert_array_equal(pixels, upright)
            np.testing.assert_array_equal(read(out).pixels, pixels)

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_of_avif_is_its_own(self, tmp_path, orientation):
        save(
            tmp_path / "turned.avif",
            smooth(40, 70),
            {"orientation": orientation},
            compression="av1",
            lossless=True,
        )
        picture = read(tmp_path / "turned.avif")
        np.testing.assert_array_equal(picture.pixels, UPRIGHT[orientation](smooth(40, 70)))
        write(tmp_path / "out.avif", picture.pixels, like=picture, lossless=True)
        np.testing.assert_array_equal(read(tmp_path / "out.avif").pixels, picture.pixels)

    def test_of_grey_and_of_16_bits(self, tmp_path):
        for number, pixels in enumerate((noise("u1", 33, 70), noise("u2", 33, 70), noise("u2", 33, 70, 4))):
            save(tmp_path / f"{number}.tif", pixels, {"orientation": 7})
            np.testing.assert_array_equal(read(tmp_path / f"{number}.tif").pixels, UPRIGHT[7](pixels))

    def test_in_xmp_follows(self, tmp_path):
        xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r tiff:Orientation="6" dc:title="6"/></x:xmpmeta>'
        save(tmp_path / "turned.jpg", smooth(20, 30), {"orientation": 6, "xmp-data": xmp})
        picture = read(tmp_path / "turned.jpg")
        write(tmp_path / "out.jpg", picture.pixels, like=picture)
        expected = xmp.replace(b'Orientation="6"', b'Orientation="1"')
        assert loaded(tmp_path / "out.jpg")[1]["xmp-data"] == expected

    def test_unheard_of_is_none(self, tmp_path):
        save(tmp_path / "odd.jpg", smooth(20, 30), {"orientation": 6})
        data = (tmp_path / "odd.jpg").read_bytes()
        entry = struct.pack("<HHI", 0x112, 3, 1)
        assert data.count(entry + b"\x06\0") == 1
        (tmp_path / "odd.jpg").write_bytes(data.replace(entry + b"\x06\0", entry + b"\x0c\0"))
        assert read(tmp_path / "odd.jpg").pixels.shape == (20, 30, 3)


EXIF = {
    "exif-ifd0-Make": "Jose!!",
    "exif-ifd0-Copyright": "me (and you)",
    "exif-ifd2-DateTimeOriginal": "2020:01:02 03:04:05",
    "exif-ifd2-ExposureTime": "1/125",
    "exif-ifd2-UserComment": "hello",
    "exif-ifd3-GPSLatitudeRef": "N",
    "exif-ifd3-GPSLatitude": "47/1 10/1 1234/100",
    "exif-ifd3-GPSLongitude": "8/1 30/1 0/1",
}
XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r title="bent"/></x:xmpmeta>'
SOURCES = (".jpg", ".png", ".webp", ".avif")


class TestHeaders:
    @pytest.mark.parametrize("source", [*SOURCES, ".tif"])
    @pytest.mark.parametrize("target", FORMATS)
    def test_profile_and_xmp_come_through(self, tmp_path, source, target):
        options = {"compression": "av1"} if source == ".avif" else {}
        save(tmp_path / f"in{source}", smooth(20, 30), {"icc-profile-data": SRGB, "xmp-data": XMP}, **options)
        picture = read(tmp_path / f"in{source}")
        assert picture.icc == SRGB
        write(tmp_path / f"out{target}", picture.pixels, like=picture)
        header = loaded(tmp_path / f"out{target}")[1]
        assert header["icc-profile-data"] == SRGB
        assert header["xmp-data"] == XMP
        assert read(tmp_path / f"out{target}").icc == SRGB

    @pytest.mark.parametrize("source", SOURCES)
    @pytest.mark.parametrize("target", SOURCES)
    def test_exif_comes_through(self, tmp_path, source, target):
        options = {"compression": "av1"} if source == ".avif" else {}
        save(tmp_path / f"in{source}", smooth(20, 30), {**EXIF, "orientation": 6}, **options)
        data = (tmp_path / f"in{source}").read_bytes()
        if source == ".jpg":  # a maker who does not write ASCII
            (tmp_path / "in.jpg").write_bytes(data.replace(b"Jose!!", b"Jos\xe9!!"))
        before = loaded(tmp_path / f"in{source}")[1]
        picture = read(tmp_path / f"in{source}")
        write(tmp_path / f"out{target}", picture.pixels, like=picture)
        after = loaded(tmp_path / f"out{target}")[1]
        assert {name: after[name] for name in EXIF} == {name: before[name] for name in EXIF}
        assert after["exif-ifd2-PixelXDimension"].startswith("20 ")
        assert source != ".jpg" or b"Jos\xe9!!" in (tmp_path / f"out{target}").read_bytes()

    def test_a_thumbnail_of_what_was_is_dropped(self, tmp_path):
        thumbnail = pyvips.Image.new_from_array(smooth(8, 8)).jpegsave_buffer()
        fields = {**EXIF, "exif-ifd1-Compression": "6", "jpeg-thumbnail-data": thumbnail}
        save(tmp_path / "in.jpg", smooth(20, 30), fields)
        assert thumbnail in (tmp_path / "in.jpg").read_bytes()
        picture = read(tmp_path / "in.jpg")
        write(tmp_path / "out.jpg", picture.pixels, like=picture)
        assert thumbnail not in (tmp_path / "out.jpg").read_bytes()
        assert not any(name.startswith("exif-ifd1") for name in loaded(tmp_path / "out.jpg")[1])

    @pytest.mark.parametrize("source", FORMATS)
    def test_resolution_comes_through(self, tmp_path, source):
        image = pyvips.Image.new_from_array(smooth(20, 30), interpretation="srgb").copy(xres=12, yres=6)
        image.set_type(STRING, "resolution-unit", "cm")
        image.set_type(STRING, "exif-ifd0-Make", "Acme")
        options = {"compression": "av1"} if source == ".avif" else {}
        getattr(image, SAVERS[source])(str(tmp_path / f"in{source}"), **options)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MetadataWarning)
            picture = read(tmp_path / f"in{source}")
            for target in FORMATS:
                write(tmp_path / f"out{target}", picture.pixels, like=picture)
        for target in (".png", ".jpg", ".tif"):
            header = loaded(tmp_path / f"out{target}")[1]
            assert (header["xres"], header["yres"]) == pytest.approx((12, 6), rel=1e-3)
        if source != ".tif":
            header = loaded(tmp_path / "out.webp")[1]
            assert Fraction(header["exif-ifd0-XResolution"].split()[0]) == 120

    def test_resolution_turns_with_the_image(self, tmp_path):
        image = pyvips.Image.new_from_array(smooth(20, 30), interpretation="srgb").copy(xres=12, yres=6)
        image.set_type(INT, "orientation", 6)
        image.tiffsave(str(tmp_path / "in.tif"))
        picture = read(tmp_path / "in.tif")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        header = loaded(tmp_path / "out.tif")[1]
        assert (header["xres"], header["yres"]) == pytest.approx((6, 12), rel=1e-3)

    @pytest.mark.parametrize("source", [".png", ".jpg", ".tif", ".webp", None])
    @pytest.mark.parametrize("suffix", FORMATS)
    def test_nothing_is_invented(self, tmp_path, source, suffix):
        picture = None
        if source is not None:  # by Pillow, which writes no more than it is told
            Image.fromarray(smooth(20, 30)).save(tmp_path / f"in{source}")
            picture = read(tmp_path / f"in{source}")
        write(tmp_path / f"out{suffix}", smooth(20, 30), like=picture)
        with Image.open(tmp_path / f"out{suffix}") as image:
            assert not {"dpi", "exif", "jfif_density"} & set(image.info)
            assert suffix == ".tif" or not image.getexif()
            assert image.tag_v2.get(296, 1) == 1 if suffix == ".tif" else True
            image.load()
        again = read(tmp_path / f"out{suffix}")
        assert "xres" not in again._header
        assert "exif-data" not in again._header

    @pytest.mark.parametrize("dots", [(300, 300), (118.11, 118.11), (72, 96)])
    def test_a_resolution_without_exif_comes_through(self, tmp_path, dots):
        Image.fromarray(smooth(20, 30)).save(tmp_path / "in.png", dpi=dots)
        picture = read(tmp_path / "in.png")
        for suffix in (".png", ".jpg", ".tif"):
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
            with Image.open(tmp_path / f"out{suffix}") as image:
                assert image.info["dpi"] == pytest.approx(dots, rel=0.005)
                assert "exif" not in image.info
        for suffix in (".webp", ".avif"):  # which have no other place for it
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
            with Image.open(tmp_path / f"out{suffix}") as image:
                assert float(image.getexif()[282]) == pytest.approx(dots[0], rel=0.005)

    def test_broken_exif_does_no_harm(self, tmp_path):
        save(tmp_path / "in.jpg", smooth(20, 30), EXIF)
        data = (tmp_path / "in.jpg").read_bytes()
        start = data.index(b"Exif\0\0") + 6
        (tmp_path / "in.jpg").write_bytes(data[:start] + bytes(200) + data[start + 200 :])
        picture = read(tmp_path / "in.jpg")
        for target in (".jpg", ".png", ".webp"):
            write(tmp_path / f"out{target}", picture.pixels, like=picture)
            assert info(tmp_path / f"out{target}")["width"] == 30

    @pytest.mark.skipif(not pyvips.type_find("VipsOperation", "uhdrsave"), reason="needs libvips 8.18")
    def test_a_gain_map_is_not_lost_in_silence(self, tmp_path):
        light = pyvips.Image.new_from_array(smooth(64, 64) / np.float32(64), interpretation="scrgb")
        light.uhdrsave(str(tmp_path / "in.jpg"))
        with pytest.warns(MetadataWarning, match=r"in\.jpg: its HDR gain map cannot be carried over$"):
            picture = read(tmp_path / "in.jpg")
        assert (picture.format, picture.pixels.dtype, picture.pixels.shape) == ("JPEG", np.uint8, (64, 64, 3))

    def test_iptc_is_not_lost_in_silence(self, tmp_path):
        iptc = b"Photoshop 3.0\0008BIM\x04\x04\0\0\0\0\0\x08\x1c\x02\x05\0\x03abc"
        save(tmp_path / "in.jpg", smooth(20, 30), {"iptc-data": iptc})
        picture = read(tmp_path / "in.jpg")
        write(tmp_path / "out.jpg", picture.pixels, like=picture)
        assert loaded(tmp_path / "out.jpg")[1]["iptc-data"] == iptc
        with pytest.warns(MetadataWarning, match="PNG cannot take over IPTC"):
            write(tmp_path / "out.png", picture.pixels, like=picture)
        save(tmp_path / "in.tif", smooth(20, 30), {"iptc-data": iptc})
        with pytest.warns(MetadataWarning, match="its IPTC cannot be carried over"):
            read(tmp_path / "in.tif")

    def test_a_profile_of_other_colours_is_not_written(self, tmp_path):
        save(tmp_path / "in.png", smooth(20, 30), {"icc-profile-data": SRGB})
        picture = read(tmp_path / "in.png")
        with pytest.warns(MetadataWarning, match="PNG cannot take over the RGB profile"):
            write(tmp_path / "grey.png", picture.pixels[..., 0], like=picture)
        assert read(tmp_path / "grey.png").icc is None
        grey = replace(picture, pixels=picture.pixels[..., 0], icc=SRGB[:16] + b"GRAY" + SRGB[20:])
        with pytest.warns(MetadataWarning, match="WebP cannot take over the GRAY profile"):
            write(tmp_path / "grey.webp", grey.pixels, like=grey)

    def test_info_tells_the_header(self, tmp_path):
        path = tmp_path / "in.tif"
        save(path, noise("u2", 20, 30, 4), {"icc-profile-data": SRGB, "orientation": 8})
        assert info(path) == {
            "width": 20,
            "height": 30,
            "channels": 4,
            "dtype": "uint16",
            "bits": 16,
            "alpha": True,
            "format": "TIFF",
            "interpretation": "rgb16",
            "profile": "sRGB",
            "orientation": 8,
            "pages": 1,
            "bytes": path.stat().st_size,
        }
        for suffix, name in ((".png", "PNG"), (".jpg", "JPEG"), (".webp", "WebP"), (".avif", "AVIF")):
            write(tmp_path / f"out{suffix}", smooth(8, 8))
            assert info(tmp_path / f"out{suffix}")["format"] == name

    def test_info_reads_no_pixels(self, tmp_path):
        write(tmp_path / "in.jpg", noise("u1", 200, 300, 3))
        data = (tmp_path / "in.jpg").read_bytes()
        (tmp_path / "in.jpg").write_bytes(data[: len(data) // 2])
        assert info(tmp_path / "in.jpg")["width"] == 300

    @pytest.mark.parametrize(
        ("tag", "name"),
        [
            (b"desc\0\0\0\0" + struct.pack(">I", 9) + b"Adobe 98\0", "Adobe 98"),
            (b"mluc\0\0\0\0" + struct.pack(">IIIII", 1, 12, 0, 6, 28) + "Zoë".encode("utf-16-be"), "Zoë"),
            (b"mluc\0\0", None),
            (b"", None),
        ],
    )
    def test_profiles_old_new_and_broken_are_named(self, tmp_path, tag, name):
        icc = SRGB[:128] + struct.pack(">I4sII", 1, b"desc", 144, len(tag)) + tag
        save(tmp_path / "in.tif", smooth(8, 8), {"icc-profile-data": icc})
        assert info(tmp_path / "in.tif")["profile"] == name


CODES = {1: "B", 2: "B", 3: "H", 4: "I", 5: "I", 7: "B", 10: "i", 16: "Q"}
DETAILS = {
    33434: (5, (1, 125)),
    34855: (3, (200,)),
    36864: (7, b"0230"),
    36867: (2, b"2019:01:01 00:00:00\0"),
    37380: (10, (-1, 2)),
    37500: (7, b"maker's own " * 20),
    37510: (7, b"ASCII\0\0\0hello"),
    40962: (4, (30,)),
    40963: (4, (20,)),
    40965: {1: (2, b"R98\0"), 2: (7, b"0100")},
}
PLACE = {
    0: (1, b"\2\3\0\0"),
    1: (2, b"N\0"),
    2: (5, (47, 1, 10, 1, 1234, 100)),
    5: (1, b"\0"),
    29: (2, b"2019:01:01\0"),
}
TAGS = {
    270: (2, b"a bent thing\0"),
    271: (2, b"Acme\0"),
    274: (3, (6,)),
    306: (2, b"2020:01:02 03:04:05\0"),
    315: (2, "Zoë\0".encode()),
    33432: (2, b"me\0"),
    34665: DETAILS,
    34853: PLACE,
    40093: (1, "Zoë\0".encode("utf-16-le")),
}


def save_tiff(path, pixels, tags, order="<", big=False):
    """Write a TIFF, of either kind and byte order, with pyvips and what is tested left out of it."""
    width, pointer = (8, "Q") if big else (4, "I")
    data = bytearray(16)

    def put(raw):
        data.extend(bytes(-len(data) % 8) + raw)
        return len(data) - len(raw)

    def folder(tags):
        table = struct.pack(order + ("Q" if big else "H"), len(tags))
        for tag, item in sorted(tags.items()):
            kind, values = (16 if big else 4, [folder(item)]) if isinstance(item, dict) else item
            raw = struct.pack(f"{order}{len(values)}{CODES[kind]}", *values)
            count = len(values) // (2 if kind in (5, 10) else 1)
            inline = raw.ljust(width, b"\0") if len(raw) <= width else struct.pack(order + pointer, put(raw))
            table += struct.pack(f"{order}HH{pointer}", tag, kind, count) + inline
        return put(table + bytes(width))

    (height, across, channels), depth = pixels.shape, pixels.dtype.itemsize * 8
    start = put(pixels.astype(pixels.dtype.newbyteorder(order)).tobytes())
    numbers = {256: across, 257: height, 259: 1, 262: 2, 277: channels, 278: height}
    structure = {tag: (3, [number]) for tag, number in numbers.items()}
    structure |= {258: (3, [depth] * channels), 273: (4, [start]), 279: (4, [pixels.nbytes])}
    first = folder(structure | tags)
    sign = {"<": b"II", ">": b"MM"}[order]
    data[:16] = sign + (
        struct.pack(order + "HHHQ", 43, 8, 0, first) if big else struct.pack(order + "HIQ", 42, first, 0)
    )
    path.write_bytes(data)


def told(path):
    """Read with Pillow what an image's EXIF says, but for how the pixels are stored and where things stand."""
    with Image.open(path) as image:
        exif = image.getexif()
        folders = {name: dict(exif.get_ifd(name)) for name in (34665, 34853, 40965)}
    folders[34665].pop(40965, None)
    texts = {tag: exif[tag] for tag in (*TAGS, 272, 305) if tag in exif and tag not in folders}
    return {"texts": texts, **folders}


def includes(found, wanted):
    """Tell whether all that is wanted is there: libvips adds what it thinks every JPEG should say."""
    return all(found[folder] | tags == found[folder] for folder, tags in wanted.items())


class TestExifInTiff:
    @pytest.fixture
    def wanted(self, tmp_path_factory):
        """What `TAGS` say once the picture is upright."""
        path = tmp_path_factory.mktemp("wanted") / "in.tif"
        save_tiff(path, smooth(20, 30), TAGS)
        found = told(path)
        assert [len(tags) for tags in found.values()] == [7, len(DETAILS) - 1, len(PLACE), 2]
        found["texts"][274] = 1
        found[34665] |= {40962: 20, 40963: 30}
        return found

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    @pytest.mark.parametrize("big", [False, True])
    @pytest.mark.parametrize("order", "<>")
    def test_is_read(self, tmp_path, wanted, order, big, dtype):
        save_tiff(tmp_path / "in.tif", smooth(20, 30, dtype), TAGS, order, big)
        picture = read(tmp_path / "in.tif")
        np.testing.assert_array_equal(picture.pixels, UPRIGHT[6](smooth(20, 30, dtype)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DepthWarning)
            for suffix in FORMATS:
                write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
                assert includes(told(tmp_path / f"out{suffix}"), wanted)
        assert told(tmp_path / "out.tif") == wanted
        again = read(tmp_path / "out.tif")
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        write(tmp_path / "again.tif", again.pixels, like=again)
        assert told(tmp_path / "again.tif") == wanted

    @pytest.mark.parametrize("order", "<>")
    @pytest.mark.parametrize("source", SOURCES)
    def test_of_other_formats_is_written(self, tmp_path, wanted, source, order):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), TAGS, order)
        picture = read(tmp_path / "in.tif")
        write(tmp_path / f"in{source}", picture.pixels, like=picture)
        picture = read(tmp_path / f"in{source}")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        assert told(tmp_path / "out.tif") == told(tmp_path / f"in{source}")
        assert includes(told(tmp_path / "out.tif"), wanted)
        np.testing.assert_array_equal(loaded(tmp_path / "out.tif")[0], picture.pixels)

    def test_of_pillow_is_written(self, tmp_path):
        exif = Image.Exif()
        exif[271], exif[272], exif[305] = "Acme", "X1", "its own"
        exif.get_ifd(34665).update({33434: 1 / 125, 36867: "2019:01:01 00:00:00", 40962: 30, 40963: 20})
        exif.get_ifd(34853).update({1: "S", 2: (47.0, 10.0, 12.34)})
        Image.fromarray(smooth(20, 30)).save(tmp_path / "in.jpg", exif=exif)
        picture = read(tmp_path / "in.jpg")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        assert includes(told(tmp_path / "out.tif"), told(tmp_path / "in.jpg"))
        with Image.open(tmp_path / "out.tif") as image:
            np.testing.assert_array_equal(image, picture.pixels)

    def test_goes_into_bigtiff(self, tmp_path):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 274: (3, (1,))}, ">")
        block, whole = from_tiff(tmp_path / "in.tif")
        assert whole
        for name, bigtiff in (("big", True), ("small", False)):
            save(tmp_path / f"{name}.tif", smooth(20, 30), bigtiff=bigtiff)
            into_tiff(tmp_path / f"{name}.tif", block, 30, 20)
            np.testing.assert_array_equal(loaded(tmp_path / f"{name}.tif")[0], smooth(20, 30))
        assert (tmp_path / "big.tif").read_bytes()[2] == 43
        assert told(tmp_path / "big.tif") == told(tmp_path / "small.tif")
        assert from_tiff(tmp_path / "big.tif")[1]

    def test_without_exif_stays_without(self, tmp_path):
        save(tmp_path / "in.tif", smooth(20, 30))
        assert from_tiff(tmp_path / "in.tif") == (None, True)
        picture = read(tmp_path / "in.tif")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        write(tmp_path / "bare.tif", picture.pixels)
        assert (tmp_path / "out.tif").read_bytes() == (tmp_path / "bare.tif").read_bytes()

    @pytest.mark.parametrize(
        "exif",
        [
            (4, (2**31,)),  # beyond the end
            (4, (1001,)),  # amid the pixels
            (4, (0,)),
            (2, b"no number\0"),
            {**DETAILS, 34853: (4, (8,))},  # a folder where none belongs
            {**DETAILS, 37510: (4, (1,)), 40965: (4, (2**31,))},
        ],
    )
    def test_damage_is_told_and_the_rest_stays(self, tmp_path, exif, wanted):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 274: (3, (1,)), 34665: exif})
        with pytest.warns(MetadataWarning, match=r"in\.tif: a part of its EXIF cannot be carried over$") as caught:
            picture = read(tmp_path / "in.tif")
        assert len(caught) == 1
        np.testing.assert_array_equal(picture.pixels, smooth(20, 30))
        for suffix in FORMATS:
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
            assert includes(told(tmp_path / f"out{suffix}"), {name: wanted[name] for name in ("texts", 34853)})

    def test_folders_in_circles(self, tmp_path):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 34665: (4, (2**31,)), 34853: (4, (2**31,))})
        data = (tmp_path / "in.tif").read_bytes()
        first = data[4:8]
        for tag in (34665, 34853):
            entry = struct.pack("<HHII", tag, 4, 1, 2**31)
            assert data.count(entry) == 1
            data = data.replace(entry, entry[:8] + first)
        (tmp_path / "in.tif").write_bytes(data)
        with pytest.warns(MetadataWarning, match="a part of its EXIF"):
            read(tmp_path / "in.tif")

    @pytest.mark.skipif(os.name != "posix", reason="elsewhere empty room on the disk may take its time")
    def test_huge_values_are_left_unread(self, tmp_path):
        path = tmp_path / "in.tif"
        save_tiff(path, smooth(20, 30), TAGS)
        data = path.read_bytes()
        entry = struct.pack("<HHI", 37500, 7, 240)
        assert data.count(entry) == 1
        path.write_bytes(data.replace(entry, struct.pack("<HHI", 37500, 7, 2**31)))
        os.truncate(path, 3 * 2**30)
        tracemalloc.start()
        try:
            block, whole = from_tiff(path)
            assert tracemalloc.get_traced_memory()[1] < 200_000
        finally:
            tracemalloc.stop()
        assert not whole
        assert len(block) < 1000

    @settings(max_examples=150, deadline=None)
    @given(st.data(), st.sampled_from("<>"), st.booleans())
    def test_any_damage_comes_to_no_harm(self, tmp_path_factory, data, order, big):
        path = tmp_path_factory.getbasetemp() / "hurt.tif"
        save_tiff(path, smooth(2, 3), TAGS, order, big)
        hurt = bytearray(path.read_bytes())
        at = st.integers(0, len(hurt) - 1)
        for place, byte in data.draw(st.lists(st.tuples(at, st.integers(0, 255)), max_size=12)):
            hurt[place] = byte
        path.write_bytes(hurt[: data.draw(st.one_of(st.just(len(hurt)), at))])
        block, _ = from_tiff(path)
        if block is not None:
            assert is_whole(block)
            save(path, smooth(4, 5), bigtiff=big)
            into_tiff(path, block, 5, 4)
            assert from_tiff(path)[1]
            np.testing.assert_array_equal(loaded(path)[0], smooth(4, 5))

    @settings(max_examples=100, deadline=None)
    @given(st.data())
    def test_any_block_comes_to_no_harm(self, tmp_path_factory, data):
        path = tmp_path_factory.getbasetemp() / "block.tif"
        save_tiff(path, smooth(2, 3), TAGS)
        block = bytearray(from_tiff(path)[0])
        at = st.integers(0, len(block) - 1)
        for place, byte in data.draw(st.lists(st.tuples(at, st.integers(0, 255)), max_size=6)):
            block[place] = byte
        save(path, smooth(4, 5))
        into_tiff(path, bytes(block[: data.draw(at)]), 5, 4)
        assert from_tiff(path)[1]
        np.testing.assert_array_equal(loaded(path)[0], smooth(4, 5))

    @pytest.mark.parametrize("cut", [40, 200, -40])
    def test_a_block_cut_short_is_told(self, tmp_path, cut):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), TAGS)
        picture = read(tmp_path / "in.tif")
        picture._header["exif-data"] = picture._header["exif-data"][:cut]
        with pytest.warns(MetadataWarning, match=r"out\.tif: TIFF cannot take over a part of EXIF$"):
            write(tmp_path / "out.tif", picture.pixels, like=picture)
        again = read(tmp_path / "out.tif")  # without a warning
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        told(tmp_path / "out.tif")

    @pytest.mark.parametrize("suffix", SOURCES)
    def test_what_only_tiff_has_room_for_is_told(self, tmp_path, suffix, wanted):
        large = {**DETAILS, 37500: (7, bytes(70_000))}
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 34665: large})
        picture = read(tmp_path / "in.tif")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        assert told(tmp_path / "out.tif")[34665][37500] == bytes(70_000)
        with pytest.warns(MetadataWarning, match="cannot take over the largest parts of EXIF$"):
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
        found = told(tmp_path / f"out{suffix}")
        assert 37500 not in found[34665]
        rest = {tag: value for tag, value in wanted[34665].items() if tag != 37500}
        assert includes(found, {**wanted, 34665: rest})


class TestColours:
    @pytest.mark.parametrize("suffix", [".tif", ".jpg"])
    def test_cmyk_stays_cmyk(self, tmp_path, suffix):
        pixels = np.concatenate([smooth(32, 32), smooth(32, 32)[..., :1]], axis=2)
        image = pyvips.Image.new_from_array(pixels, interpretation="cmyk").copy()
        image.set_type(BLOB, "icc-profile-data", CMYK)
        getattr(image, SAVERS[suffix])(str(tmp_path / f"in{suffix}"))
        picture = read(tmp_path / f"in{suffix}")
        assert (picture.interpretation, picture.alpha, picture.icc) == ("cmyk", False, CMYK)
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        again = read(tmp_path / "out.tif")
        assert (again.interpretation, again.alpha, again.icc) == ("cmyk", False, CMYK)
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        write(tmp_path / "out.jpg", picture.pixels, like=picture, quality=100)
        assert np.abs(read(tmp_path / "out.jpg").pixels.astype(int) - picture.pixels).max() <= 4
        for target in (".png", ".webp", ".avif"):
            message = refused(write, tmp_path / f"out{target}", picture.pixels, like=picture)
            assert message.endswith("holds no CMYK colours: write TIFF or JPEG")

    def test_alpha_can_be_told(self, tmp_path):
        pixels = noise("u1", 19, 23, 4)
        message = refused(write, tmp_path / "out.png", pixels, alpha=False)
        assert message.endswith("out.png: PNG does not hold 4 channels: write a TIFF")
        write(tmp_path / "out.png", pixels, alpha=True)
        np.testing.assert_array_equal(read(tmp_path / "out.png").pixels, pixels)

    def test_premultiplied_alpha_becomes_straight(self, tmp_path):
        pixels = np.full((8, 8, 4), (200, 100, 50, 128), np.uint8)
        save(tmp_path / "in.tif", pixels, premultiply=True)
        assert np.abs(read(tmp_path / "in.tif").pixels.astype(int) - pixels).max() <= 1


class TestPages:
    def test_of_an_animation_the_first_is_read(self, tmp_path):
        frames = np.zeros((30, 12, 3), np.uint8)
        frames[:10], frames[10:20], frames[20:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
        for suffix in (".gif", ".webp"):
            image = pyvips.Image.new_from_array(frames, interpretation="srgb").copy()
            image.set_type(INT, "page-height", 10)
            image.write_to_file(str(tmp_path / f"in{suffix}"), **({"lossless": True} if suffix == ".webp" else {}))
            with pytest.warns(PageWarning, match=r"holds 3 (pages|frames), and only (one of them|the first) is read"):
                picture = read(tmp_path / f"in{suffix}")
            np.testing.assert_array_equal(picture.pixels[..., :3], frames[:10])
            assert info(tmp_path / f"in{suffix}")["pages"] == 3
            write(tmp_path / f"out{suffix}.png", picture.pixels, like=picture)
            assert info(tmp_path / f"out{suffix}.png")["height"] == 10

    def test_of_a_tiff_the_first_is_read(self, tmp_path):
        image = pyvips.Image.new_from_array(noise("u2", 30, 12), interpretation="grey16").copy()
        image.set_type(INT, "page-height", 10)
        image.tiffsave(str(tmp_path / "in.tif"))
        with pytest.warns(PageWarning):
            picture = read(tmp_path / "in.tif")
        np.testing.assert_array_equal(picture.pixels, noise("u2", 30, 12)[:10])
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        assert info(tmp_path / "out.tif")["pages"] == 1


class TestWhatCannotBeRead:
    @pytest.mark.parametrize("suffix", [*FORMATS, ".gif"])
    def test_damaged_files(self, tmp_path, suffix, capfd):
        pixels = noise("u1", 90, 120, 3)
        image = pyvips.Image.new_from_array(pixels, interpretation="srgb")
        options = {"compression": "av1"} if suffix == ".avif" else {}
        image.write_to_file(str(tmp_path / f"whole{suffix}"), **options)
        data = (tmp_path / f"whole{suffix}").read_bytes()
        path = tmp_path / f"cut{suffix}"
        for length in (1, 4, 11, 50, len(data) // 3, len(data) - 40):
            path.write_bytes(data[:length])
            message = refused(read, path)
            assert message.startswith(f"cannot read {path}: it is ")
            assert len(message) < 400
        path.write_bytes(data[:20] + bytes(len(data) - 20))
        refused(read, path)
        assert capfd.readouterr() == ("", "")

    def test_holes_in_the_data(self, tmp_path):
        image = pyvips.Image.new_from_array(noise("u1", 400, 300, 3), interpretation="srgb")
        image.tiffsave(str(tmp_path / "in.tif"), compression="lzw")
        data = (tmp_path / "in.tif").read_bytes()
        (tmp_path / "in.tif").write_bytes(data[: len(data) // 2] + bytes(200) + data[len(data) // 2 + 200 :])
        assert "it is damaged" in refused(read, tmp_path / "in.tif")
        image.jpegsave(str(tmp_path / "in.jpg"))
        data = (tmp_path / "in.jpg").read_bytes()
        middle = len(data) // 2
        for hole in (b"\xff\xd3", b"\xff\xc4\x00", bytes([255, 1, 255, 9] * 50)):
            (tmp_path / "hole.jpg").write_bytes(data[:middle] + hole + data[middle + len(hole) :])
            with pytest.warns(ImageWarning, match=r"hole.jpg is damaged \(Corrupt JPEG data.*parts of it may be wrong"):
                read(tmp_path / "hole.jpg")
        assert read(tmp_path / "in.jpg").pixels.shape == (400, 300, 3)

    def test_a_tiff_whose_last_pages_are_cut(self, tmp_path):
        page = pyvips.Image.new_from_array(noise("u1", 40, 60), interpretation="b-w")
        tall = pyvips.Image.arrayjoin([page] * 4, across=1)
        tall.set_type(pyvips.GValue.gint_type, "page-height", 40)
        tall.tiffsave(str(tmp_path / "in.tif"))
        data = (tmp_path / "in.tif").read_bytes()
        (tmp_path / "in.tif").write_bytes(data[: len(data) * 7 // 10])
        assert "it is damaged" in refused(lambda path: read(path, pages=True), tmp_path / "in.tif")

    @pytest.mark.parametrize(
        "data",
        [
            b"Dear diary,\n",
            bytes(1000),
            b"3 2\n1 2 3\n4 5 6\n",
            b"1,2\n3,4\n",
            b"\xff\xd8",
            b"RIFF....WAVEfmt ",
        ],
    )
    @pytest.mark.parametrize("suffix", [".png", ".csv", ".mat", ".v", ""])
    def test_other_files(self, tmp_path, data, suffix, capfd):
        path = tmp_path / f"in{suffix}"
        path.write_bytes(data)
        for action in (read, info):
            assert refused(action, path).startswith(f"cannot read {path}: it is ")
        assert capfd.readouterr() == ("", "")

    def test_no_files(self, tmp_path):
        (tmp_path / "empty.png").touch()
        given = "give a PNG, JPEG, TIFF, WebP, AVIF or GIF file"
        for name, message in {
            "empty.png": f"it is empty: {given}",
            "": f"it is a folder or no plain file: {given}",
            "none.png": "No such file or directory: check the name and its rights",
            "empty.png/in.png": "Not a directory: check the name and its rights",
            "a\0b.png": "no file can have that name: check it",
        }.items():
            for action in (read, info):
                assert refused(action, tmp_path / name).endswith(f": {message}")

    @pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permission bits are POSIX's")
    def test_without_the_right(self, tmp_path, monkeypatch):
        write(tmp_path / "in.png", smooth(8, 8))
        (tmp_path / "in.png").chmod(0)
        monkeypatch.chdir(tmp_path)  # root's own folders are closed to others
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)
        try:
            assert refused(read, "in.png") == "cannot read in.png: Permission denied: check the name and its rights"
        finally:
            if root:
                os.seteuid(0)

    def test_more_pixels_than_memory(self, tmp_path):
        write(tmp_path / "in.png", smooth(8, 8))
        data = (tmp_path / "in.png").read_bytes()
        header = b"IHDR" + struct.pack(">II", 5_000_000, 5_000_000) + data[24:29]
        check = struct.pack(">I", zlib.crc32(header))
        (tmp_path / "in.png").write_bytes(data[:12] + header + check + data[33:])
        assert refused(read, tmp_path / "in.png").endswith("it is too large for the memory: cut it into parts")

    def test_files_are_closed_and_read_afresh(self, tmp_path):
        path = tmp_path / "in.png"
        for value in (10, 20):
            write(path, np.full((50, 60, 3), value, np.uint8), force=True)
            assert np.all(read(path).pixels == value)
            info(path)
        path.write_bytes(path.read_bytes()[:-60])
        refused(read, path)
        gc.collect()
        if os.path.isdir("/proc/self/fd"):
            links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")]
            assert str(path) not in [os.readlink(link) for link in links if os.path.lexists(link)]


class TestWhatCannotBeWritten:
    def test_unknown_suffixes(self, tmp_path):
        known = "use .png, .jpg, .jpeg, .tif, .tiff, .webp, .avif, .exr, .hdr, .pfm, .pgm, .ppm, .bmp, .tga, .jp2"
        assert ", ".join(SUFFIXES_OUT) in known
        assert refused(check_target, "out.gif") == (
            f"cannot write out.gif: the suffix .gif is no image format: {known}"
        )
        assert refused(check_target, "out") == f"cannot write out: a name without suffix is no image format: {known}"
        refused(write, tmp_path / "out.pcx", smooth(8, 8))
        for suffix in SUFFIXES_OUT:
            check_target(f"out{suffix.upper()}")

    @pytest.mark.parametrize(
        ("suffix", "pixels", "message"),
        [
            (".jpg", noise("u1", 9, 9, 4), "JPEG holds no transparency: write PNG, TIFF, WebP or AVIF"),
            (".jpg", noise("u1", 9, 9, 2), "JPEG holds no transparency: write PNG, TIFF, WebP or AVIF"),
            (".png", noise("f4", 9, 9), "PNG takes no float32 values: write a TIFF"),
            (".jpg", noise("f4", 9, 9, 3), "JPEG takes no float32 values: write a TIFF"),
            (".webp", noise("f4", 9, 9, 3), "WebP takes no float32 values: write a TIFF"),
            (".avif", noise("i2", 9, 9, 3), "AVIF takes no int16 values: write a TIFF"),
            (
                ".tif",
                noise("u8", 9, 9),
                "TIFF takes no uint64 values: convert to uint8, uint16 or, for TIFF, float32",
            ),
            (
                ".png",
                np.ones((9, 9), bool),
                "PNG takes no bool values: convert to uint8, uint16 or, for TIFF, float32",
            ),
            (".png", noise("u1", 9, 9, 5), "PNG does not hold 5 channels: write a TIFF"),
            (".jpg", noise("u1", 9, 9, 7), "JPEG does not hold 7 channels: write a TIFF"),
            (
                ".jpg",
                np.zeros((2, 65_501), "u1"),
                "JPEG ends at 65500 pixels on a side, and the image has 65501 x 2: write PNG or TIFF",
            ),
            (
                ".webp",
                np.zeros((16_384, 2), "u1"),
                "WebP ends at 16383 pixels on a side, and the image has 2 x 16384: write PNG or TIFF",
            ),
            (
                ".avif",
                np.zeros((16_385, 2), "u1"),
                "AVIF ends at 16384 pixels on a side, and the image has 2 x 16385: write PNG or TIFF",
            ),
            (".png", np.zeros((0, 9), "u1"), "an image has shape (H, W) or (H, W, C), and not (0, 9)"),
            (".png", np.zeros(9, "u1"), "an image has shape (H, W) or (H, W, C), and not (9,)"),
            (
                ".png",
                np.zeros((1, 2, 3, 4), "u1"),
                "an image has shape (H, W) or (H, W, C), and not (1, 2, 3, 4)",
            ),
        ],
    )
    def test_more_than_a_format_holds(self, tmp_path, suffix, pixels, message):
        path = tmp_path / f"out{suffix}"
        assert refused(write, path, pixels) == f"cannot write {path}: {message}"
        assert os.listdir(tmp_path) == []

    def test_the_largest_that_formats_hold(self, tmp_path):
        for suffix, side in ((".jpg", 65_500), (".webp", 16_383)):
            write(tmp_path / f"out{suffix}", np.zeros((2, side), "u1"))
            assert read(tmp_path / f"out{suffix}").pixels.shape[1] == side

    @pytest.mark.parametrize(
        "options",
        [{"quality": 0}, {"quality": 101}, {"quality": -5}, {"quality": float("nan")}, {"lossless": True}],
    )
    def test_impossible_settings(self, tmp_path, options):
        refused(write, tmp_path / "out.jpg", smooth(8, 8), **options)
        assert os.listdir(tmp_path) == []

    def test_an_existing_file_unless_forced(self, tmp_path):
        (tmp_path / "out.png").write_bytes(b"old")
        message = refused(write, tmp_path / "out.png", smooth(8, 8))
        assert message.endswith("out.png exists already: pass --force (force=True) to replace it")
        assert (tmp_path / "out.png").read_bytes() == b"old"
        write(tmp_path / "out.png", smooth(8, 8), force=True)
        np.testing.assert_array_equal(read(tmp_path / "out.png").pixels, smooth(8, 8))

    @pytest.mark.parametrize("suffix", FORMATS)
    @pytest.mark.parametrize("error", [KeyboardInterrupt, pyvips.Error])
    def test_a_failure_in_mid_write_leaves_what_was_there(self, tmp_path, monkeypatch, suffix, error):
        def fail(_image, filename, **_options):
            Path(os.fsdecode(filename)).write_bytes(b"half")
            raise error("no", "vips2png: it broke\nand more\n") if error is pyvips.Error else error

        monkeypatch.setattr(pyvips.Image, SAVERS[suffix], fail, raising=False)
        for existing in (False, True):
            if existing:
                (tmp_path / f"out{suffix}").write_bytes(b"old")
            with pytest.raises((KeyboardInterrupt, SuppleError)) as caught:
                write(tmp_path / f"out{suffix}", smooth(8, 8), force=True)
            assert error is KeyboardInterrupt or str(caught.value).endswith("(it broke): try another format")
            assert os.listdir(tmp_path) == ([f"out{suffix}"] if existing else [])
        assert (tmp_path / f"out{suffix}").read_bytes() == b"old"

    @pytest.mark.skipif(os.name != "posix", reason="timers are POSIX's")
    def test_a_real_interrupt_leaves_what_was_there(self, tmp_path):
        code = """
            import signal, sys
            import numpy as np
            from supple.media.image import write
            pixels = np.random.default_rng(0).integers(0, 256, (1500, 1500, 3), np.uint8)
            write(sys.argv[1], pixels[:8])  # so that the clock starts with everything loaded
            with open(sys.argv[2], "wb") as file:
                file.write(b"old")
            signal.signal(signal.SIGALRM, signal.default_int_handler)
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            try:
                write(sys.argv[2], pixels, force=True)
            except KeyboardInterrupt:
                print("interrupted")
        """
        assert run(code, tmp_path / "warm.png", tmp_path / "out.png") == (0, "interrupted\n")
        assert sorted(os.listdir(tmp_path)) == ["out.png", "warm.png"]
        assert (tmp_path / "out.png").read_bytes() == b"old"

    @pytest.mark.skipif(os.name != "posix", reason="limits of file sizes are POSIX's")
    def test_a_full_disk_leaves_what_was_there(self, tmp_path):
        code = """
            import os, resource, sys
            import numpy as np
            from supple.errors import SuppleError
            from supple.media.image import write
            folder, *suffixes = sys.argv[1:]
            pixels = np.random.default_rng(0).integers(0, 256, (300, 300, 3), np.uint8)
            for suffix in suffixes:
                path = f"{folder}/out{suffix}"
                write(path, pixels)
                size, soft = os.path.getsize(path), resource.getrlimit(resource.RLIMIT_FSIZE)
                with open(path, "wb") as file:
                    file.write(b"old")
                for limit in (0, size // 2, size - 1):
                    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, soft[1]))
                    try:
                        write(path, pixels, force=True)
                    except SuppleError as error:
                        print(error)
                    resource.setrlimit(resource.RLIMIT_FSIZE, soft)
        """
        status, output = run(code, tmp_path, *FORMATS)
        reason = "File too large: make room or choose another place"
        expected = [f"cannot write {tmp_path}/out{suffix}: {reason}" for suffix in FORMATS for _ in range(3)]
        assert (status, output.splitlines()) == (0, expected)
        assert sorted(os.listdir(tmp_path)) == sorted(f"out{suffix}" for suffix in FORMATS)
        assert all((tmp_path / f"out{suffix}").read_bytes() == b"old" for suffix in FORMATS)


class TestHouseKeeping:
    @pytest.mark.parametrize("name", ["a[page=1].png", "é ü.png", "-o.png", "new\nline.png", "n\udcff.png"])
    def test_any_name_will_do(self, tmp_path, name):
        try:
            (tmp_path / name).touch()
            (tmp_path / name).unlink()
        except OSError:
            pytest.skip("this file system does not take the name")
        write(tmp_path / name, smooth(8, 8))
        np.testing.assert_array_equal(read(tmp_path / name).pixels, smooth(8, 8))
        assert refused(write, tmp_path / name, smooth(8, 8)).isprintable()

    @pytest.mark.skipif(os.name != "posix", reason="permission bits are POSIX's")
    @pytest.mark.parametrize("suffix", FORMATS)
    def test_permission_bits_survive_the_writers(self, tmp_path, suffix):
        path = tmp_path / f"out{suffix}"
        before = os.umask(0o026)
        try:
            write(path, smooth(8, 8))
        finally:
            os.umask(before)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640

    def test_pictures_can_be_made_by_hand(self, tmp_path):
        picture = Picture(smooth(8, 8), icc=SRGB)
        write(tmp_path / "out.png", picture.pixels, like=picture)
        assert read(tmp_path / "out.png").icc == SRGB

    @pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads Linux's account of memory")
    @pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
    def test_memory_holds_the_image_once(self, tmp_path, suffix):
        code = """
            import re, sys
            from supple.media.image import read, write

            def peak():
                with open("/proc/self/status") as file:
                    return int(re.search(r"VmHWM:\\s+(\\d+)", file.read())[1]) / 1024

            small, large, out = sys.argv[1:]
            write(out, read(small).pixels)
            before = peak()
            picture = read(large)
            write(out, picture.pixels, like=picture, force=True)
            print(peak() - before - picture.pixels.nbytes / 2**20)
        """
        ramp = pyvips.Image.xyz(4096, 4096)
        image = (ramp.bandjoin(ramp[0] + ramp[1]) / 32).cast("uchar").copy(interpretation="srgb")
        getattr(image, SAVERS[suffix])(str(tmp_path / f"large{suffix}"))
        write(tmp_path / f"small{suffix}", smooth(8, 8))
        status, output = run(code, tmp_path / f"small{suffix}", tmp_path / f"large{suffix}", tmp_path / f"out{suffix}")
        assert status == 0, output
        assert float(output) < 30  # a second copy would take 48

    def test_importing_supple_alone_is_light(self):
        assert run("import sys, supple; print('pyvips' in sys.modules)") == (0, "False\n")
