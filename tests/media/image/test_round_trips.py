"""Pictures come back from files as they were: samples, depth, colours, pages."""

import itertools

import numpy as np
import pytest
import pyvips

import supple
from supple.media.image import DepthWarning, info, read, write
from supple.media.image.formats import settings as saver_settings
from supple.media.pictures import TIFF
from tests.media.image.pictures import BLOB, FORMATS, SAVERS, noise, save, smooth
from tests.refusals import refused

CMYK = bytes(pyvips.Operation.call("profile_load", "cmyk"))


class TestRoundTrips:
    @pytest.mark.parametrize(
        ("suffix", "dtype", "channels"),
        [
            (suffix, dtype, n)
            for suffixes, dtypes, channels in (
                ((".png", ".tif", ".tiff"), ("u1", "u2"), (1, 2, 3, 4)),
                ((".tif",), ("f4", "i1", "i2", "u4", "i4"), (1, 2, 3, 4)),
                ((".tif",), ("u2",), (7,)),
                ((".exr",), ("f4",), (1, 3, 4)),
                ((".dpx", ".sgi"), ("u1", "u2"), (1, 3, 4)),
                ((".pfm",), ("f4",), (1, 3)),
                ((".bmp", ".tga"), ("u1",), (1, 3, 4)),
                ((".pgm",), ("u1", "u2"), (1,)),
                ((".ppm",), ("u1", "u2"), (3,)),
                ((".jp2",), ("u1", "u2"), (1, 3)),
            )
            for suffix, dtype, n in itertools.product(suffixes, dtypes, channels)
        ],
    )
    def test_bit_for_bit(self, tmp_path, suffix, dtype, channels):
        pixels = noise(dtype, 19, 23, *((channels,) if channels > 1 else ()))
        alpha = channels in (2, 4) and suffix != ".exr"
        write(tmp_path / f"out{suffix}", pixels, alpha=alpha)
        picture = read(tmp_path / f"out{suffix}")
        assert picture.pixels.dtype == pixels.dtype
        assert picture.pixels.flags.c_contiguous
        np.testing.assert_array_equal(picture.pixels, pixels)
        assert picture.alpha == alpha
        assert picture.bits == pixels.dtype.itemsize * 8
        assert info(tmp_path / f"out{suffix}")["width"] == 23

    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    @pytest.mark.parametrize("suffix", [".webp", ".avif"])
    def test_bit_for_bit_when_asked_for_and_grey_is_repeated(self, tmp_path, suffix, channels):
        pixels = noise("u1", 19, 23, channels)  # with colours where alpha is 0
        write(tmp_path / f"out{suffix}", pixels, lossless=True)
        picture = read(tmp_path / f"out{suffix}")
        assert picture.alpha == (channels in (2, 4))
        colours = pixels[..., :-1] if picture.alpha else pixels
        np.testing.assert_array_equal(picture.pixels[..., :3], np.broadcast_to(colours, (19, 23, 3)))
        assert not picture.alpha or np.array_equal(picture.pixels[..., 3], pixels[..., -1])

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
        write(tmp_path / f"small{suffix}", pixels, quality=20)
        assert (tmp_path / f"small{suffix}").stat().st_size < 0.9 * (tmp_path / f"out{suffix}").stat().st_size

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

    def test_beyond_4_gigabytes_tiff_changes_its_kind(self):
        for width, big in ((60_000, True), (50_000, False)):
            pixels = np.broadcast_to(np.uint8(0), (70_000, width))  # takes no memory
            assert saver_settings(TIFF, pixels, 8, None, False)["bigtiff"] is big


class TestDepth:
    @pytest.mark.parametrize("suffix", [".jpg", ".webp"])
    def test_16_bits_are_rounded_to_8(self, tmp_path, suffix):
        ramp = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        with pytest.warns(DepthWarning, match=rf"out\{suffix}: .* holds 8 bits a channel, and the 16 .* rounded$"):
            write(tmp_path / f"out{suffix}", ramp, lossless=suffix == ".webp", quality=100)
        found = read(tmp_path / f"out{suffix}").pixels.reshape(256, 256, -1)[..., 0]
        worst = np.abs(found - np.rint(ramp / 257)).max()
        assert worst == 0 if suffix == ".webp" else worst <= 2

    @pytest.mark.parametrize("bits", [10, 12])
    def test_avif_keeps_its_bits_and_white(self, tmp_path, bits):
        ramp = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        if bits == 12:
            with pytest.warns(DepthWarning, match="AVIF holds 12 bits a channel, and the 16"):
                write(tmp_path / "out.avif", ramp, lossless=True)
        else:
            save(tmp_path / "out.avif", ramp, compression="av1", lossless=True, bitdepth=10)
        picture = read(tmp_path / "out.avif")
        assert (picture.pixels.dtype, picture.bits) == (np.uint16, bits)
        assert (picture.pixels.min(), picture.pixels.max()) == (0, 65535)
        assert np.abs(picture.pixels[..., 0].astype(int) - ramp).max() <= 65536 / 2**bits
        write(tmp_path / "again.avif", picture.pixels, like=picture, lossless=True)  # and warns no more
        again = read(tmp_path / "again.avif")
        assert again.bits == bits
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

    def test_premultiplied_colours_stay_so_in_tiff_alone(self, tmp_path):
        pixels = np.full((8, 8, 4), (200, 100, 50, 128), np.uint8)
        save(tmp_path / "in.tif", pixels, premultiply=True)
        picture = read(tmp_path / "in.tif")
        assert (picture.alpha, picture.extra) == (False, (1,))
        np.testing.assert_array_equal(picture.pixels, np.full((8, 8, 4), (100, 50, 25, 128)))
        for suffix in (".tif", ".png"):
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
        assert read(tmp_path / "out.tif").extra == (1,)
        np.testing.assert_array_equal(read(tmp_path / "out.tif").pixels, picture.pixels)
        assert np.abs(read(tmp_path / "out.png").pixels.astype(int) - pixels).max() <= 1


class TestPictures:
    def test_a_picture_is_warped_as_what_it_is(self, tmp_path):
        pixels = noise("u1", 32, 40, 4)
        image = pyvips.Image.new_from_array(pixels, interpretation="cmyk").copy()
        image.set_type(BLOB, "icc-profile-data", CMYK)
        image.tiffsave(str(tmp_path / "in.tif"))
        picture = read(tmp_path / "in.tif")
        d = supple.Deformation((32, 40)).grab((20, 16), by=(4, 1), radius=6)
        made = d.warp(picture)
        np.testing.assert_array_equal(made.pixels, d.warp(pixels, alpha=False))
        write(tmp_path / "out.tif", made)
        again = read(tmp_path / "out.tif")
        assert (again.interpretation, again.icc) == ("cmyk", CMYK)
        np.testing.assert_array_equal(again.pixels, made.pixels)
        assert "a picture says itself what its channels are" in refused(d.warp, picture, alpha=True)
