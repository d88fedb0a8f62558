"""Orientation, and what headers say of a picture."""

import struct
import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import pyvips
from PIL import Image

from supple.media.image import MetadataWarning, info, read, write
from tests.media.image.pictures import FORMATS, INT, SAVERS, SOURCES, SRGB, STRING, UPRIGHT, loaded, noise, save, smooth


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
XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r tiff:Orientation="6" dc:title="6"/></x:xmpmeta>'


class TestHeaders:
    @pytest.mark.parametrize("source", [*SOURCES, ".tif"])
    @pytest.mark.parametrize("target", FORMATS)
    def test_all_of_it_comes_through_upright(self, tmp_path, source, target):
        options = {"compression": "av1"} if source == ".avif" else {}
        fields = {"icc-profile-data": SRGB, "xmp-data": XMP, "orientation": 6} | (EXIF if source != ".tif" else {})
        save(tmp_path / f"in{source}", smooth(20, 30), fields, **options)
        data = (tmp_path / f"in{source}").read_bytes()
        if source == ".jpg":  # a maker who does not write ASCII
            (tmp_path / "in.jpg").write_bytes(data.replace(b"Jose!!", b"Jos\xe9!!"))
        before = loaded(tmp_path / f"in{source}")[1]
        picture = read(tmp_path / f"in{source}")
        assert picture.icc == SRGB
        write(tmp_path / f"out{target}", picture.pixels, like=picture)
        after = loaded(tmp_path / f"out{target}")[1]
        assert after["icc-profile-data"] == SRGB == read(tmp_path / f"out{target}").icc
        assert after["xmp-data"] == XMP.replace(b'Orientation="6"', b'Orientation="1"')
        if ".tif" not in (source, target):  # whose EXIF has tests of its own
            assert {name: after[name] for name in EXIF} == {name: before[name] for name in EXIF}
            assert after["exif-ifd2-PixelXDimension"].startswith("20 ")
            assert source != ".jpg" or b"Jos\xe9!!" in (tmp_path / f"out{target}").read_bytes()

    @pytest.mark.parametrize("source", FORMATS)
    def test_resolution_comes_through(self, tmp_path, source):
        image = pyvips.Image.new_from_array(smooth(20, 30), interpretation="srgb").copy(xres=12, yres=6)
        image.set_type(STRING, "resolution-unit", "cm")
        image.set_type(STRING, "exif-ifd0-Make", "Acme")
        across, up = 12, 6
        if source not in (".avif", ".webp"):
            image.set_type(INT, "orientation", 6)
            across, up = up, across
        options = {"compression": "av1"} if source == ".avif" else {}
        getattr(image, SAVERS[source])(str(tmp_path / f"in{source}"), **options)
        with warnings.catch_warnings(action="ignore", category=MetadataWarning):
            picture = read(tmp_path / f"in{source}")
            for target in FORMATS:
                write(tmp_path / f"out{target}", picture.pixels, like=picture)
        for target in (".png", ".jpg", ".tif"):
            header = loaded(tmp_path / f"out{target}")[1]
            assert (header["xres"], header["yres"]) == pytest.approx((across, up), rel=1e-3)
        if source != ".tif":
            header = loaded(tmp_path / "out.webp")[1]
            assert Fraction(header["exif-ifd0-XResolution"].split()[0]) == 10 * across

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
        assert "resolution" not in again._header
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
