"""Raw samples, and stacks of TIFF pages."""

import contextlib
import struct

import numpy as np
import pytest
import pyvips
import tifffile

from supple.errors import SuppleError, VolumeWarning
from supple.media.volume import RawLayout, has_pages, read, write
from tests import refusals
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
        assert f"6 x 5 x 4 voxels of uint16 after 6 bytes take 246 bytes, and it has {246 + extra}" in refused(
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
        assert "give layout" in refused(read, tmp_path / "in.raw")
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
        assert refusals.refused(RawLayout, *arguments).startswith(f"{told} must be")


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
        with pytest.raises(SuppleError, match="tells of 5 pages, and it has 12"):
            saved("ImageJ=1.54f\nframes=5\n")
        assert saved("ImageJ=1.54f\nimages=12\nslices=12\nunit=um\n").geometry.spacing[2] == 0.001
        plain = saved("a holiday", xres=11.8, yres=11.8)
        assert plain.geometry.spacing == (1, 1, 1)

    def test_pages_that_are_not_alike(self, tmp_path):
        from PIL import Image

        first, other = Image.new("L", (6, 5)), Image.new("L", (7, 5))
        first.save(tmp_path / "in.tif", save_all=True, append_images=[other])
        assert has_pages(tmp_path / "in.tif")
        refused(read, tmp_path / "in.tif")

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
        assert not list(tmp_path.iterdir())


class TestAxes:
    """What tifffile writes, with axes of its own choice, is read as these, and written so that it reads them again."""

    @pytest.mark.parametrize("form", ["ome", "imagej", "shaped"])
    @pytest.mark.parametrize("axes", ["ZYX", "ZCYX", "CZYX", "TZYX", "CYX", "TYX", "ZYXS"])
    def test_channels_and_times_are_no_slices(self, tmp_path, form, axes):
        if form == "imagej" and axes == "CZYX":
            axes = "ZCYX"  # its only order
        sizes = {"T": 3, "Z": 4, "C": 2, "Y": 5, "X": 6, "S": 3}
        samples, name = noise("u1", *(sizes[axis] for axis in axes)), f"in.{'ome.' if form == 'ome' else ''}tif"
        physical = {"PhysicalSizeX": 0.2, "PhysicalSizeY": 0.3, "PhysicalSizeZ": 1.5, "TimeIncrement": 2500.0}
        metadata = {
            "ome": physical | {"TimeIncrementUnit": "ms"},
            "imagej": {"spacing": 1.5, "unit": "um", "finterval": 2.5},
            "shaped": {},
        }[form]
        options = {"photometric": "rgb" if "S" in axes else "minisblack", "resolution": (5, 1 / 0.3)}
        options |= {} if form == "shaped" else {form: True}
        tifffile.imwrite(tmp_path / name, samples, metadata={"axes": axes} | metadata, **options)
        known = read(tmp_path / name)
        wanted = samples.transpose([axes.index(axis) for axis in "TZYXCS" if axis in axes])
        wanted = wanted if "Z" in axes else np.expand_dims(wanted, axes.count("T"))
        np.testing.assert_array_equal(known.samples, wanted)
        assert known.series == ("T" in axes)
        spacing = (1, 1, 1) if form == "shaped" else (2e-4, 3e-4, 1.5e-3)
        np.testing.assert_allclose(known.geometry.spacing, spacing, rtol=1e-6)
        assert known.interval == 2.5 or "T" not in axes or form == "shaped"
        for target in ("out.tif", "out.ome.tif"):
            write(tmp_path / target, known.samples, known)
            with tifffile.TiffFile(tmp_path / target) as file:
                found = file.series[0]
                assert (file.is_ome, file.is_imagej) == (".ome" in target, ".ome" not in target)
                assert found.axes == axes.replace("CZ", "ZC")
                np.testing.assert_array_equal(found.asarray(), samples.swapaxes(0, 1) if axes == "CZYX" else samples)
            again = read(tmp_path / target)
            np.testing.assert_array_equal(again.samples, known.samples)
            np.testing.assert_allclose(again.geometry.spacing, spacing, rtol=1e-6)
            assert again.series == known.series
            assert again.interval == known.interval or not known.series

    def test_pages_in_the_order_of_ome(self, tmp_path):
        samples, order = noise("u2", 2, 4, 5, 6), np.random.default_rng(0).permutation(8)
        places = [divmod(int(k), 4) for k in order]
        where = "".join(f'<TiffData FirstC="{c}" FirstZ="{z}" IFD="{k}"/>' for k, (c, z) in enumerate(places))
        text = (
            '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
        )
        text += '<Pixels ID="Pixels:0" DimensionOrder="XYTZC" Type="uint16" SizeX="6" SizeY="5" SizeC="2" SizeZ="4" '
        text += (
            f'SizeT="1" PhysicalSizeX="500" PhysicalSizeXUnit="nm" PhysicalSizeY="0.5">{where}</Pixels></Image></OME>'
        )
        with tifffile.TiffWriter(tmp_path / "in.tif") as file:
            for k, place in enumerate(places):
                file.write(samples[place], description=None if k else text, metadata=None, contiguous=False)
        with pytest.warns(VolumeWarning, match=r"how far its slices are apart \(PhysicalSizeZ\)"):
            known = read(tmp_path / "in.tif")
        np.testing.assert_array_equal(known.samples, np.moveaxis(samples, 0, -1))
        assert known.geometry.spacing == (5e-4, 5e-4, 5e-4)

    @pytest.mark.parametrize(
        ("axes", "told"),
        [
            ("TCZYX", "it holds channels or colours of several times: bend it to a Zarr store"),
            ("CZYXS", "its axes are 2 C x 4 Z x 5 Y x 6 X x 3 S"),
            ("TZYXS", "it holds channels or colours of several times"),
            ("QQYX", "its axes are 2 Q x 2 Q x 5 Y x 6 X"),
        ],
    )
    def test_what_is_more_than_a_volume(self, tmp_path, axes, told):
        sizes = {"T": 3, "Z": 4, "C": 2, "Y": 5, "X": 6, "S": 3, "Q": 2}
        metadata = {} if "Q" in axes else {"axes": axes}
        photometric = "rgb" if "S" in axes else "minisblack"
        samples = noise("u1", *(sizes[axis] for axis in axes))
        tifffile.imwrite(tmp_path / "in.tif", samples, metadata=metadata, photometric=photometric)
        assert told in refused(read, tmp_path / "in.tif")


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
