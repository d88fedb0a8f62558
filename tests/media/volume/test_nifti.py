"""NIfTI: places, scales and headers."""

import gzip
import struct
import warnings

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.errors import VolumeWarning
from supple.media.volume import read, write
from supple.strokes import Recipe, Stroke
from tests.media.volume import volumes


class TestNIfTI:
    def test_what_is_not_compressed_is_mapped(self, tmp_path):
        samples = read(volumes.nifti(tmp_path / "in.nii")).samples
        assert isinstance(samples.base if not isinstance(samples, np.memmap) else samples, np.memmap)
        assert samples.flags.c_contiguous
        assert not samples.flags.writeable

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_the_header_stays(self, tmp_path, suffix):
        made = nibabel.Nifti1Image(volumes.noise("i2", *volumes.SHAPE).T, None)
        header = made.header
        header.set_sform(np.diag([-2, 3, 4, 1.0]), 4)
        header.set_qform(np.diag([-2, 3, 4, 1.0]), 1)
        header.set_xyzt_units("mm", "msec")
        header.set_intent("t test", (7,), "mine")
        header["descrip"], header["cal_max"], header["aux_file"] = b"kept", 4, b"too"
        header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", b"an extension"))
        header.set_slope_inter(0.5, -3)
        made.to_filename(tmp_path / f"in{suffix}")
        known = read(tmp_path / f"in{suffix}")
        write(tmp_path / f"out{suffix}", known.samples, known)
        before, after = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("in", "out"))
        if suffix == ".nii.gz":
            before, after = gzip.decompress(before), gzip.decompress(after)
        assert after == before

    @pytest.mark.parametrize(
        ("dtype", "wanted"), [("u1", "f4"), ("i2", "f4"), ("i4", "f8"), ("f4", "f4"), ("f8", "f8")]
    )
    def test_scaling_is_kept_or_applied(self, tmp_path, dtype, wanted):
        samples, path = volumes.noise(dtype, *volumes.SHAPE), tmp_path / "in.nii"
        volumes.nifti(path, samples, change=[(112, "<ff", 0.25, -1000)])
        known = read(path)
        assert known.scaling == (0.25, -1000)
        np.testing.assert_array_equal(known.samples, samples)
        assert known.rescaled().dtype == wanted
        meant = (samples.astype("f8") * 0.25 - 1000).astype(wanted)
        np.testing.assert_array_equal(known.rescaled(), meant)
        np.testing.assert_allclose(nibabel.load(path).get_fdata().T, meant, rtol=1e-6)
        write(tmp_path / "out.nii", samples[::-1], known)
        again = nibabel.load(tmp_path / "out.nii")
        assert again.get_data_dtype() == dtype
        assert (again.dataobj.slope, again.dataobj.inter) == (0.25, -1000)
        np.testing.assert_array_equal(again.dataobj.get_unscaled().T, samples[::-1])
        write(tmp_path / "out.nrrd", samples, known)
        np.testing.assert_array_equal(sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "out.nrrd"))), meant)

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_big_endian(self, tmp_path, suffix):
        samples = volumes.noise("i2", *volumes.SHAPE)
        header = nibabel.Nifti1Header(endianness=">")
        header.set_data_dtype(">i2")
        nibabel.Nifti1Image(samples.T, np.diag([1, 2, 3, 1.0]), header).to_filename(tmp_path / f"in{suffix}")
        known = read(tmp_path / f"in{suffix}")
        assert known.samples.dtype == np.dtype("=i2")
        np.testing.assert_array_equal(known.samples, samples)
        write(tmp_path / f"out{suffix}", known.samples, known)
        assert nibabel.load(tmp_path / f"out{suffix}").header.endianness == ">"
        volumes.agree(
            volumes.by_nibabel(tmp_path / f"in{suffix}"),
            volumes.by_nibabel(tmp_path / f"out{suffix}"),
            volumes.by_us(tmp_path / f"out{suffix}"),
        )

    @pytest.mark.filterwarnings("ignore:.* use pixdim:supple.errors.VolumeWarning")
    @pytest.mark.parametrize(("sform", "qform", "scale"), [(0, 1, 2), (2, 0, 3)])
    def test_the_sform_counts_or_else_the_qform(self, tmp_path, sform, qform, scale):
        made = nibabel.Nifti1Image(volumes.noise("i2", *volumes.SHAPE).T, None)
        made.header.set_sform(np.diag([3, 3, 3, 1.0]), sform)
        made.header.set_qform(np.diag([2, 2, 2, 1.0]), qform)
        made.to_filename(tmp_path / "in.nii")
        assert read(tmp_path / "in.nii").geometry.spacing == (scale,) * 3
        volumes.agree(volumes.by_us(tmp_path / "in.nii"), volumes.by_nibabel(tmp_path / "in.nii"))

    def test_without_either_the_spacing_counts(self, tmp_path):
        made = nibabel.Nifti1Image(volumes.noise("i2", *volumes.SHAPE).T, None)
        made.header.set_zooms((2, 3, 4))
        made.to_filename(tmp_path / "in.nii")
        data = bytearray((tmp_path / "in.nii").read_bytes())
        struct.pack_into("<hh", data, 252, 0, 0)
        (tmp_path / "in.nii").write_bytes(data)
        geometry = read(tmp_path / "in.nii").geometry
        assert (geometry.spacing, geometry.convention) == ((2, 3, 4), "array")
        volumes.agree(volumes.by_us(tmp_path / "in.nii"), volumes.by_itk(tmp_path / "in.nii"))

    @pytest.mark.parametrize("form", ["in.nii", "in.nii.gz", "in.img"])
    @pytest.mark.parametrize(("sform", "qform", "used"), [(1, 1, "sform"), (2, 1, "qform"), (4, 2, "qform")])
    def test_forms_that_disagree_are_taken_as_itk_takes_them(self, tmp_path, form, sform, qform, used):
        kind = nibabel.Nifti1Pair if form.endswith("img") else nibabel.Nifti1Image
        made = kind(volumes.noise("i2", *volumes.SHAPE).T, None)
        affine = np.diag([-1, -1, 1, 1.0]) @ np.array(
            volumes.volume(volumes.noise("i2", *volumes.SHAPE)).geometry.matrix
        )
        made.header.set_qform(affine, qform)
        affine[0, 3] += 5
        made.header.set_sform(affine, sform)
        made.to_filename(tmp_path / form)
        told = f"^the qform and the sform of .*{form} disagree, by up to 5 mm: the {used} is used, as by SimpleITK"
        with pytest.warns(VolumeWarning, match=told):
            read(tmp_path / form)
        with warnings.catch_warnings(action="ignore"):
            volumes.agree(volumes.by_us(tmp_path / form), volumes.by_itk(tmp_path / form))
        affine[0, 3] -= 4.999
        made.header.set_sform(affine, sform)
        made.to_filename(tmp_path / form)
        read(tmp_path / form)

    def test_an_sform_alone_whose_voxels_are_not_those_of_pixdim_is_told(self, tmp_path):
        made = nibabel.Nifti1Image(volumes.noise("i2", *volumes.SHAPE).T, None)
        made.header.set_sform(np.diag([2.0, 2.0, 3.0, 1.0]), 1)
        for sizes, differ in (((2, 2, 3), False), ((2, 2, 3.01), False), ((1, 1, 1), True), ((2, 2, 4), True)):
            made.header["pixdim"][1:4] = sizes
            made.to_filename(tmp_path / "in.nii")
            with warnings.catch_warnings(record=True, action="always") as told:
                assert read(tmp_path / "in.nii").geometry.spacing == pytest.approx((2, 2, 3))
            assert [str(w.message).endswith("and 3D Slicer use pixdim") for w in told] == [True] * differ

    @pytest.mark.parametrize(("unit", "factor"), [(0, 1), (1, 1000), (2, 1), (3, 0.001)])
    def test_units_become_millimetres_and_come_back(self, tmp_path, unit, factor):
        path = volumes.nifti(tmp_path / "in.nii", change=[(123, "<b", unit | 16)])
        known = read(path)
        np.testing.assert_allclose(known.geometry.spacing, np.array(volumes.SPACING) * factor, rtol=1e-5)
        np.testing.assert_allclose(known.geometry.origin, np.array(volumes.ORIGIN) * factor, rtol=1e-5)
        write(tmp_path / "out.nii", known.samples, known)
        assert (tmp_path / "out.nii").read_bytes() == path.read_bytes()

    def test_long_axes_take_the_second_version(self, tmp_path):
        like = volumes.volume(volumes.noise("u1", 1, 2, 40_000))
        write(tmp_path / "out.nii", like.samples, like)
        assert isinstance(nibabel.load(tmp_path / "out.nii"), nibabel.Nifti2Image)
        np.testing.assert_array_equal(read(tmp_path / "out.nii").samples, like.samples)

    @pytest.mark.parametrize(
        ("change", "told"),
        [
            ((40, "<8h", 3, 6, -5, 4, 1, 1, 1, 1), "sizes"),
            ((40, "<8h", 3, 6, 0, 4, 1, 1, 1, 1), "sizes"),
            ((40, "<8h", 3, 600, 500, 400, 1, 1, 1, 1), "240000352 bytes"),
            ((40, "<8h", 5, 3, 2, 1, 5, 4, 1, 1), "either time or components"),
            ((40, "<8h", 6, 3, 2, 1, 1, 5, 4, 1), "either time or components"),
            ((70, "<hh", 32, 64), "complex64"),
            ((70, "<hh", 1536, 128), "float128"),
            ((70, "<hh", 1, 1), "binary"),
            ((70, "<hh", 999, 16), "type 999"),
            ((280, "<12f", *[0] * 12), "spacing is 0 x 0 x 0"),
            ((280, "<f", np.nan), "spacing"),
            ((280, "<12f", 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 0.01, 0), "in a plane"),
            ((292, "<f", np.inf), "finite"),
            ((108, "<f", np.nan), "begin at byte nan"),
            ((112, "<ff", 2, np.nan), "scaled by 2"),
            ((344, "<4s", b"n+9\0"), "no NIfTI file"),
            ((0, "<i", 0), "no NIfTI file"),
            ((344, "<4s", b"\0\0\0\0"), "Analyze"),
        ],
    )
    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_bad_headers(self, tmp_path, suffix, change, told):
        message = volumes.refused(read, volumes.nifti(tmp_path / f"in{suffix}", change=[change]))
        assert told in message
        assert "in.nii" in message

    @pytest.mark.parametrize("step", [0, -1, np.nan, np.inf])
    def test_a_bad_spacing_counts_where_there_is_no_sform(self, tmp_path, step):
        for code in (0, 1):
            change = [(252, "<hh", code, 0), (84, "<f", step)]
            message = volumes.refused(read, volumes.nifti(tmp_path / "in.nii", change=change))
            assert f"in.nii: its spacing is 0.7 x {step:g} x 2.3, and" in message
            assert message.count("cannot read") == 1

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_sizes_smaller_than_the_data(self, tmp_path, suffix):
        path = volumes.nifti(tmp_path / f"in{suffix}", change=[(42, "<h", 5)])
        message = volumes.refused(read, path)
        assert "promises 552 bytes, and it has 592" in message
        assert "sizes" in message

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_a_few_bytes_at_the_end_are_padding(self, tmp_path, suffix):
        path = volumes.nifti(tmp_path / f"in{suffix}")
        opened = gzip.open if suffix == ".nii.gz" else open
        with opened(path, "ab") as file:
            file.write(bytes(11))
        np.testing.assert_array_equal(read(path).samples, volumes.noise("i2", *volumes.SHAPE))

    def test_a_damaged_qform(self, tmp_path):
        change = [(252, "<hh", 1, 0), (256, "<3f", 5, 5, 5)]
        path = volumes.nifti(tmp_path / "in.nii", change=change)
        assert "qform" in volumes.refused(read, path)

    def test_a_pair_becomes_one_file(self, tmp_path):
        volumes.nifti(tmp_path / "in.img", kind=nibabel.Nifti1Pair)
        known = read(tmp_path / "in.hdr")
        write(tmp_path / "out.nii", known.samples, known)
        volumes.agree(
            volumes.by_us(tmp_path / "in.hdr"),
            volumes.by_nibabel(tmp_path / "out.nii"),
            volumes.by_itk(tmp_path / "out.nii"),
        )
        assert (tmp_path / "out.nii").read_bytes()[344:348] == b"n+1\0"

    @pytest.mark.parametrize("offset", [0, 100])
    def test_an_offset_within_the_header_is_mended(self, tmp_path, offset):
        path = volumes.nifti(tmp_path / "in.nii")
        whole = volumes.by_us(path)
        known = read(volumes.nifti(path, change=[(108, "<f", offset)]))
        write(tmp_path / "out.nii", known.samples, known)
        volumes.agree(whole, volumes.by_us(path), volumes.by_nibabel(tmp_path / "out.nii"))

    def test_a_pair_without_its_other_half(self, tmp_path):
        volumes.nifti(tmp_path / "in.img", kind=nibabel.Nifti1Pair)
        (tmp_path / "in.img").unlink()
        assert "in.img" in volumes.refused(read, tmp_path / "in.hdr")

    def test_damage_that_only_the_checksum_tells(self, tmp_path):
        path = volumes.nifti(tmp_path / "in.nii.gz", volumes.noise("u1", *volumes.SHAPE))
        data = gzip.decompress(path.read_bytes())
        stored = bytearray(gzip.compress(data, 0))  # not packed: any byte can change
        stored[-20] ^= 1
        path.write_bytes(stored)
        assert "damaged" in volumes.refused(read, path)


class TestWarped:
    """Files of nibabel's, warped as a whole and one by one."""

    RECIPE = Recipe(strokes=(Stroke.grab((3, 3, 3), by=(1, 0.5, -0.5), radius=4),))
    AFFINE = np.array([[-2, 0, 0, 30], [0, 2.25, 0, -20], [0, 0, 2.5, 5], [0, 0, 0, 1.0]])

    def alone(self, values):
        nibabel.Nifti1Image(values, self.AFFINE).to_filename("one.nii")
        supple.warp_file("one.nii", "one-out.nii", self.RECIPE, force=True, clamp=False)
        return np.asanyarray(nibabel.load("one-out.nii").dataobj)

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
    def test_a_series_in_time(self, tmp_path, monkeypatch, suffix):
        monkeypatch.chdir(tmp_path)
        times = volumes.noise("i2", 8, 7, 6, 3)
        known = nibabel.Nifti1Image(times, self.AFFINE)
        known.header.set_zooms((2, 2.25, 2.5, 1.75))
        known.header.set_xyzt_units("mm", "sec")
        known.header["toffset"], known.header["slice_duration"] = 3.5, 0.125
        known.to_filename("in.nii.gz")
        supple.warp_file("in.nii.gz", f"out{suffix}", self.RECIPE, clamp=False)
        made = read(f"out{suffix}")
        assert (made.series, made.interval, made.geometry.spacing) == (True, 1.75, (2, 2.25, 2.5))
        for t in range(3):
            np.testing.assert_array_equal(made.samples[t].T, self.alone(times[..., t]))
        if suffix.startswith(".nii"):
            header = nibabel.load(f"out{suffix}").header
            assert header.get_zooms() == (2, 2.25, 2.5, 1.75)
            assert (header["toffset"], header["slice_duration"]) == (3.5, 0.125)
