"""Raw samples, and stacks of TIFF pages."""

import contextlib
import struct

import numpy as np
import pytest
import pyvips

from supple.errors import SuppleError
from supple.media.volume import (
    RawLayout,
    has_pages,
    read,
    write,
)
from tests.media.volume.volumes import DTYPES, SHAPE, SPACING, noise, refused, volume


class TestRaw:
    def test_dat(self, tmp_path):
        samples = noise("u2", *SHAPE) & 4095
        (tmp_path / "in.dat").write_bytes(struct.pack("<3H", 6, 5, 4) + samples.astype("<u2").tobytes())
        known = read(tmp_path / "in.dat")
        np.testing.assert_array_equal(known.samples, samples)
        assert (known.format, known.geometry.convention, known.geometry.spacing) == ("raw", "array", (1, 1, 1))
        write(tmp_path / "out.nii.gz", known.samples, known)
        np.testing.assert_array_equal(read(tmp_path / "out.nii.gz").samples, samples)

    @pytest.mark.parametrize("extra", [-1, 1, 100])
    def test_dat_of_another_size(self, tmp_path, extra):
        data = struct.pack("<3H", 6, 5, 4) + bytes(240 + extra)
        (tmp_path / "in.dat").write_bytes(data)
        assert f"6 x 5 x 4 samples of 16 bits, 246 bytes in all, and it has {246 + extra}" in refused(
            read, tmp_path / "in.dat"
        )

    @pytest.mark.parametrize("data", [b"\0\0", struct.pack("<3H", 0, 5, 4)])
    def test_dat_without_voxels(self, tmp_path, data):
        (tmp_path / "in.dat").write_bytes(data)
        refused(read, tmp_path / "in.dat")

    @pytest.mark.parametrize("dtype", [*DTYPES, ">i2", ">f4", "float32"])
    @pytest.mark.parametrize("offset", [0, 7])
    @pytest.mark.parametrize("suffix", [".raw", ".dat", ".bin", ""])
    def test_headerless(self, tmp_path, suffix, dtype, offset):
        samples = noise(np.dtype(dtype).newbyteorder("="), *SHAPE)
        (tmp_path / f"in{suffix}").write_bytes(bytes(offset) + samples.astype(dtype).tobytes())
        known = read(tmp_path / f"in{suffix}", raw=RawLayout((6, 5, 4), dtype, (0.5, 1, 2), offset))
        np.testing.assert_array_equal(known.samples, samples)
        assert known.samples.dtype.isnative
        assert known.samples.flags.aligned
        assert known.geometry.spacing == (0.5, 1, 2)

    def test_what_is_not_said(self, tmp_path):
        (tmp_path / "in.raw").write_bytes(bytes(240))
        assert "--shape, --dtype and --spacing" in refused(read, tmp_path / "in.raw")
        (tmp_path / "in.mhd").write_text("NDims = 3")
        assert "in.mhd" in refused(read, tmp_path / "in.raw")
        layout = RawLayout((6, 5, 5), "<i2", offset=3)
        assert "take 303 bytes, and it has 240" in refused(read, tmp_path / "in.raw", raw=layout)

    @pytest.mark.parametrize(
        ("arguments", "told"),
        [
            (((6, 5), "u1"), "shape"),
            (((6, 5, 0), "u1"), "shape[2]"),
            (((6, 5, 4), "complex64"), "dtype"),
            (((6, 5, 4), "text"), "dtype"),
            (((6, 5, 4), "f2"), "dtype"),
            (((6, 5, 4), "u1", (1, 1, 0)), "spacing[2]"),
            (((6, 5, 4), "u1", (1, 1, float("nan"))), "spacing[2]"),
            (((6, 5, 4), "u1", (1, 1, 1), -1), "offset"),
        ],
    )
    def test_layouts_that_cannot_be(self, arguments, told):
        with pytest.raises(SuppleError) as caught:
            RawLayout(*arguments)
        assert str(caught.value).startswith(f"{told} must be")


class TestTIFF:
    @pytest.mark.parametrize("dtype", ["u1", "i1", "u2", "i2", "u4", "i4", "f4"])
    def test_bit_for_bit(self, tmp_path, dtype):
        like = volume(noise(dtype, *SHAPE))
        write(tmp_path / "out.tif", like.samples, like)
        assert has_pages(tmp_path / "out.tif")
        back = read(tmp_path / "out.tif")
        assert back.samples.dtype == like.samples.dtype
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.spacing, SPACING, rtol=1e-6)
        assert back.geometry.convention == "array"
        for k in range(4):
            page = pyvips.Image.new_from_buffer((tmp_path / "out.tif").read_bytes(), "", page=k)
            np.testing.assert_array_equal(page.numpy(), like.samples[k])

    def test_what_imagej_says(self, tmp_path):
        samples = noise("u2", 12, 5, 6)
        image = pyvips.Image.new_from_array(samples.reshape(60, 6))

        def saved(text, **options):
            named = image.copy()
            named.set_type(pyvips.GValue.gstr_type, "image-description", text)
            named.tiffsave(str(tmp_path / "in.tif"), page_height=5, **options)
            return read(tmp_path / "in.tif")

        times = saved("ImageJ=1.54f\nimages=12\nslices=4\nframes=3\nfinterval=0.5\nspacing=2\nunit=mm\n")
        assert (times.series, times.interval, times.geometry.spacing[2]) == (True, 0.5, 2)
        np.testing.assert_array_equal(times.samples, samples.reshape(3, 4, 5, 6))
        colours = saved("ImageJ=1.54f\nimages=12\nchannels=3\nslices=4\nspacing=3.0\nunit=micron\n")
        assert (colours.series, colours.geometry.spacing[2]) == (False, 0.003)
        np.testing.assert_array_equal(colours.samples[2, ..., 1], samples[7])
        with pytest.raises(SuppleError, match="12 pages of 5 times"):
            saved("ImageJ=1.54f\nframes=5\n")
        plain = saved("a holiday", xres=11.8, yres=11.8)
        assert plain.geometry.spacing == (1, 1, 1)

    def test_pages_that_are_not_alike(self, tmp_path):
        from PIL import Image

        first, other = Image.new("L", (6, 5)), Image.new("L", (7, 5))
        first.save(tmp_path / "in.tif", save_all=True, append_images=[other])
        assert has_pages(tmp_path / "in.tif")
        refused(read, tmp_path / "in.tif")

    def test_missing_pages_without_a_description(self, tmp_path):
        image = pyvips.Image.new_from_array(noise("u1", 60, 6))
        image.tiffsave(str(tmp_path / "in.tif"), page_height=5)
        assert read(tmp_path / "in.tif").sizes == (6, 5, 12)
        data = (tmp_path / "in.tif").read_bytes()
        (tmp_path / "in.tif").write_bytes(data[: len(data) // 2])
        assert "cut short" in refused(read, tmp_path / "in.tif")

    def test_what_has_no_pages(self, tmp_path):
        write(tmp_path / "one.tif", noise("u1", 1, 5, 6), volume(noise("u1", 1, 5, 6)))
        assert not has_pages(tmp_path / "one.tif")
        assert read(tmp_path / "one.tif").samples.shape == (1, 5, 6)
        (tmp_path / "text.tif").write_text("hello")
        assert not has_pages(tmp_path / "text.tif")
        assert not has_pages(tmp_path / "missing.tif")
        refused(read, tmp_path / "text.tif")

    @pytest.mark.parametrize("dtype", ["f8", "i8"])
    def test_what_it_cannot_hold(self, tmp_path, dtype):
        like = volume(noise(dtype, *SHAPE))
        assert "float32" in refused(write, tmp_path / "out.tif", like.samples, like)
        series = volume(noise("u1", 2, *SHAPE), series=True)
        assert "series" in refused(write, tmp_path / "out.tif", series.samples, series)
        assert not list(tmp_path.iterdir())


def test_a_stack_that_ends_between_two_pages(tmp_path):
    image = pyvips.Image.new_from_array(noise("u1", 60, 6)).cast("uchar")
    image.tiffsave(str(tmp_path / "in.tif"), page_height=10)
    data = (tmp_path / "in.tif").read_bytes()
    cut = []
    for n in range(len(data) // 6, len(data)):
        with contextlib.suppress(pyvips.Error):
            seen = pyvips.Image.new_from_buffer(data[:n], "", n=-1, fail_on="error")
            if seen.avg() >= 0 and seen.height < 60:  # libvips notices nothing
                cut.append(n)
    assert cut
    for n in cut:
        (tmp_path / "cut.tif").write_bytes(data[:n])
        assert "cut short" in refused(read, tmp_path / "cut.tif")
