import contextlib
import gzip
import os
import struct
import subprocess
import sys
import textwrap
import warnings
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import pytest
import pyvips
import SimpleITK as sitk  # noqa: N813

from supple.errors import SuppleError, VolumeWarning
from supple.geometry import Geometry
from supple.media.volume import (
    SUFFIXES,
    SUFFIXES_OUT,
    RawLayout,
    Volume,
    check_target,
    has_pages,
    info,
    is_volume,
    read,
    write,
)

SPACING, ORIGIN = (0.7, 1.1, 2.3), (-12.5, 33.25, 7.125)
DTYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
PLACED = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd")
VOXELS = ((0, 0, 0), (5, 2, 1), (2, 4, 3))  # x, y, z: within every volume of these tests
SHAPE = (4, 5, 6)


def turned(*, flipped=True):
    """Directions along no axis of the patient; flipped, they are left-handed."""
    axis = np.array([0.3, -0.5, 0.8]) / np.sqrt(0.98)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) + np.sin(0.6) * cross + (1 - np.cos(0.6)) * cross @ cross
    return turn * ([1, -1, 1] if flipped else [1, 1, 1])


def noise(dtype, *shape):
    random = np.random.default_rng(sum(shape))
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return random.normal(size=shape).astype(dtype)
    bounds = np.iinfo(dtype)
    return random.integers(bounds.min, bounds.max, shape, dtype, endpoint=True)


def volume(samples, **options):
    geometry = Geometry(SPACING, ORIGIN, turned(), "LPS")
    return Volume(samples, geometry, "made here", "", **options)


def image(samples, *, flipped=True, vector=False):
    """Make an image with SimpleITK alone."""
    made = sitk.GetImageFromArray(samples, isVector=vector)
    made.SetSpacing(SPACING)
    made.SetOrigin(ORIGIN)
    made.SetDirection(turned(flipped=flipped).ravel().tolist())
    return made


def by_itk(path):
    """The places in LPS of some voxels, and their values, by SimpleITK alone."""
    known = sitk.ReadImage(str(path))
    array = sitk.GetArrayFromImage(known)
    return [known.TransformIndexToPhysicalPoint(v) for v in VOXELS], [array[v[::-1]] for v in VOXELS]


def by_nibabel(path):
    """The places in LPS of some voxels, and their values, by nibabel alone."""
    known = nibabel.load(path)
    places = nibabel.affines.apply_affine(known.affine, VOXELS) * [-1, -1, 1]
    return places, [np.asarray(known.dataobj)[v] for v in VOXELS]


def by_us(path):
    known = read(path)
    return known.geometry.to_lps(VOXELS), [known.rescaled()[v[::-1]] for v in VOXELS]


def agree(*found, atol=1e-4):
    for places, values in found[1:]:
        np.testing.assert_allclose(places, found[0][0], atol=atol)
        np.testing.assert_array_equal(values, found[0][1])


def nifti(path, samples=None, affine=None, change=(), kind=nibabel.Nifti1Image):
    """Write a NIfTI file with nibabel alone, and then overwrite fields of its header."""
    samples = noise("i2", *SHAPE) if samples is None else samples
    affine = np.diag([-1, -1, 1, 1.0]) @ np.array(volume(samples).geometry.matrix) if affine is None else affine
    made = kind(samples.T, affine)
    made.to_filename(path)
    packed = path.suffix == ".gz"
    data = bytearray(gzip.decompress(path.read_bytes()) if packed else path.read_bytes())
    for offset, form, *values in change:
        struct.pack_into(form, data, offset, *values)
    path.write_bytes(gzip.compress(data) if packed else data)
    return path


def refused(action, path, *arguments, **options):
    """Return the one line that an action is refused with, which must name the file."""
    with pytest.raises(SuppleError) as caught:
        action(path, *arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"cannot {action.__name__} ")
    assert "0x" not in message
    assert len(message) < 400
    return message


@pytest.fixture(autouse=True)
def _silent(capfd):
    """Nothing may be printed by any of these."""
    yield
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


class TestRoundTrips:
    @pytest.mark.parametrize("dtype", DTYPES)
    @pytest.mark.parametrize("suffix", PLACED)
    def test_bit_for_bit_and_in_place(self, tmp_path, suffix, dtype):
        like = volume(noise(dtype, *SHAPE))
        write(tmp_path / f"out{suffix}", like.samples, like)
        back = read(tmp_path / f"out{suffix}")
        assert back.samples.dtype == like.samples.dtype
        assert back.samples.flags.c_contiguous
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.matrix, like.geometry.matrix, atol=1e-5)
        assert back.geometry.convention == ("RAS" if suffix.startswith(".nii") else "LPS")
        assert (back.series, back.scaling, back.sizes) == (False, (1, 0), SHAPE[::-1])

    @pytest.mark.parametrize("suffix", PLACED)
    def test_others_see_the_same_values_at_the_same_places(self, tmp_path, suffix):
        like, path = volume(noise("i2", *SHAPE)), tmp_path / f"out{suffix}"
        write(path, like.samples, like)
        here = like.geometry.to_lps(VOXELS), [like.samples[v[::-1]] for v in VOXELS]
        agree(here, by_itk(path), *([by_nibabel(path)] if suffix.startswith(".nii") else []))

    @pytest.mark.parametrize("suffix", [*PLACED, ".nhdr", ".hdr"])
    def test_what_others_wrote(self, tmp_path, suffix):
        path = tmp_path / f"in{suffix}"
        if suffix == ".hdr":  # nibabel's pair
            nifti(path.with_suffix(".img"), kind=nibabel.Nifti1Pair)
            agree(by_us(path), by_us(path.with_suffix(".img")), by_nibabel(path.with_suffix(".img")))
            return
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(path))
        agree(by_us(path), by_itk(path))
        assert read(path).format == {".nii": "NIfTI", ".gz": "NIfTI"}.get(path.suffix, read(path).format)

    @pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_what_nibabel_wrote(self, tmp_path, suffix, kind):
        path = nifti(tmp_path / f"in{suffix}", kind=kind)
        agree(by_us(path), by_nibabel(path))
        write(tmp_path / "out.nii", read(path).samples, read(path))
        agree(by_us(path), by_nibabel(tmp_path / "out.nii"))

    @pytest.mark.parametrize("before", PLACED)
    @pytest.mark.parametrize("after", PLACED)
    def test_from_every_format_to_every_other(self, tmp_path, before, after):
        like = volume(noise("u2", *SHAPE))
        write(tmp_path / f"a{before}", like.samples, like)
        known = read(tmp_path / f"a{before}")
        write(tmp_path / f"b{after}", known.samples, known)
        agree(by_us(tmp_path / f"a{before}"), by_itk(tmp_path / f"b{after}"), by_us(tmp_path / f"b{after}"))

    @pytest.mark.parametrize("suffix", [*PLACED, ".tif"])
    @pytest.mark.parametrize(("dtype", "components"), [("u1", 3), ("u1", 4), ("f4", 3), ("i2", 2)])
    def test_colours_and_vectors(self, tmp_path, suffix, dtype, components):
        like, path = volume(noise(dtype, *SHAPE, components)), tmp_path / f"out{suffix}"
        write(path, like.samples, like)
        back = read(path)
        np.testing.assert_array_equal(back.samples, like.samples)
        assert back.samples.dtype == like.samples.dtype
        assert (back.series, back.components) == (False, components)
        if suffix != ".tif":
            agree((like.geometry.to_lps(VOXELS), [like.samples[v[::-1]] for v in VOXELS]), by_itk(path))

    @pytest.mark.parametrize("suffix", PLACED)
    def test_series(self, tmp_path, suffix):
        like = volume(noise("f4", 3, *SHAPE), series=True, interval=0.25)
        write(tmp_path / f"out{suffix}", like.samples, like)
        back = read(tmp_path / f"out{suffix}")
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.matrix, like.geometry.matrix, atol=1e-5)
        assert (back.series, back.interval, back.components, back.sizes) == (True, 0.25, 1, SHAPE[::-1])
        known = sitk.ReadImage(str(tmp_path / f"out{suffix}"))
        assert known.GetSpacing()[3] == 0.25
        np.testing.assert_array_equal(sitk.GetArrayFromImage(known), like.samples)

    @pytest.mark.parametrize("suffix", PLACED)
    def test_one_slice(self, tmp_path, suffix):
        like = volume(noise("i2", 1, 5, 6))
        write(tmp_path / f"out{suffix}", like.samples, like)
        back = read(tmp_path / f"out{suffix}")
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.matrix, like.geometry.matrix, atol=1e-5)

    @pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
    def test_a_flat_image_is_one_slice(self, tmp_path, suffix):
        flat = sitk.GetImageFromArray(noise("i2", 5, 6))
        flat.SetSpacing((0.5, 2))
        sitk.WriteImage(flat, str(tmp_path / f"in{suffix}"))
        known = read(tmp_path / f"in{suffix}")
        assert known.samples.shape == (1, 5, 6)
        assert known.geometry.spacing == (0.5, 2, 1)
        write(tmp_path / f"out{suffix}", known.samples, known)
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples[0], noise("i2", 5, 6))

    @pytest.mark.parametrize("suffix", [*PLACED, ".tif"])
    def test_nan_and_infinity_pass(self, tmp_path, suffix):
        samples = noise("f4", *SHAPE)
        samples[1, 2, 3], samples[0, 0, 0], samples[3, 4, 5] = np.nan, np.inf, -np.inf
        write(tmp_path / f"out{suffix}", samples, volume(samples))
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples, samples)

    @pytest.mark.parametrize("suffix", SUFFIXES_OUT)
    def test_another_type_any_strides_and_mapped_samples(self, tmp_path, suffix):
        like = volume(noise("i2", *SHAPE))
        (tmp_path / "mapped").write_bytes(noise("f4", 6, 5, 4).tobytes())
        mapped = np.memmap(tmp_path / "mapped", "f4", "r", 0, (6, 5, 4)).T
        write(tmp_path / f"out{suffix}", mapped, like)
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples, mapped)

    @pytest.mark.parametrize("suffix", SUFFIXES_OUT)
    def test_capital_letters(self, tmp_path, suffix):
        like = volume(noise("i2", *SHAPE))
        write(tmp_path / f"OUT{suffix.upper()}", like.samples, like)
        assert is_volume(tmp_path / f"OUT{suffix.upper()}") == (suffix not in (".tif", ".tiff"))
        np.testing.assert_array_equal(read(tmp_path / f"OUT{suffix.upper()}").samples, like.samples)

    @pytest.mark.parametrize("suffix", SUFFIXES_OUT)
    def test_nothing_else_is_left(self, tmp_path, suffix):
        like = volume(noise("i2", *SHAPE))
        write(tmp_path / f"out{suffix}", like.samples, like)
        names = {f"out{suffix}"} | ({"out.raw"} if suffix == ".mhd" else set())
        assert set(os.listdir(tmp_path)) == names
        with pytest.raises(SuppleError, match="exists already"):
            write(tmp_path / f"out{suffix}", like.samples, like)
        write(tmp_path / f"out{suffix}", like.samples + 1, like, force=True)
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples, like.samples + 1)
        assert set(os.listdir(tmp_path)) == names


class TestNIfTI:
    def test_what_is_not_compressed_is_mapped(self, tmp_path):
        samples = read(nifti(tmp_path / "in.nii")).samples
        assert isinstance(samples.base if not isinstance(samples, np.memmap) else samples, np.memmap)
        assert samples.flags.c_contiguous
        assert not samples.flags.writeable

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_the_header_stays(self, tmp_path, suffix):
        made = nibabel.Nifti1Image(noise("i2", *SHAPE).T, None)
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
        samples, path = noise(dtype, *SHAPE), tmp_path / "in.nii"
        nifti(path, samples, change=[(112, "<ff", 0.25, -1000)])
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
        samples = noise("i2", *SHAPE)
        header = nibabel.Nifti1Header(endianness=">")
        header.set_data_dtype(">i2")
        nibabel.Nifti1Image(samples.T, np.diag([1, 2, 3, 1.0]), header).to_filename(tmp_path / f"in{suffix}")
        known = read(tmp_path / f"in{suffix}")
        assert known.samples.dtype == np.dtype("=i2")
        np.testing.assert_array_equal(known.samples, samples)
        write(tmp_path / f"out{suffix}", known.samples, known)
        assert nibabel.load(tmp_path / f"out{suffix}").header.endianness == ">"
        agree(
            by_nibabel(tmp_path / f"in{suffix}"),
            by_nibabel(tmp_path / f"out{suffix}"),
            by_us(tmp_path / f"out{suffix}"),
        )

    @pytest.mark.parametrize(("sform", "qform", "scale"), [(0, 1, 2), (2, 0, 3)])
    def test_the_sform_counts_or_else_the_qform(self, tmp_path, sform, qform, scale):
        made = nibabel.Nifti1Image(noise("i2", *SHAPE).T, None)
        made.header.set_sform(np.diag([3, 3, 3, 1.0]), sform)
        made.header.set_qform(np.diag([2, 2, 2, 1.0]), qform)
        made.to_filename(tmp_path / "in.nii")
        assert read(tmp_path / "in.nii").geometry.spacing == (scale,) * 3
        agree(by_us(tmp_path / "in.nii"), by_nibabel(tmp_path / "in.nii"))

    def test_without_either_the_spacing_counts(self, tmp_path):
        made = nibabel.Nifti1Image(noise("i2", *SHAPE).T, None)
        made.header.set_zooms((2, 3, 4))
        made.to_filename(tmp_path / "in.nii")
        data = bytearray((tmp_path / "in.nii").read_bytes())
        struct.pack_into("<hh", data, 252, 0, 0)
        (tmp_path / "in.nii").write_bytes(data)
        geometry = read(tmp_path / "in.nii").geometry
        assert (geometry.spacing, geometry.convention) == ((2, 3, 4), "array")
        agree(by_us(tmp_path / "in.nii"), by_itk(tmp_path / "in.nii"))

    @pytest.mark.parametrize("form", ["in.nii", "in.nii.gz", "in.img"])
    @pytest.mark.parametrize(("sform", "qform", "used"), [(1, 1, "sform"), (2, 1, "qform"), (4, 2, "qform")])
    def test_forms_that_disagree_are_taken_as_itk_takes_them(self, tmp_path, form, sform, qform, used):
        kind = nibabel.Nifti1Pair if form.endswith("img") else nibabel.Nifti1Image
        made = kind(noise("i2", *SHAPE).T, None)
        affine = np.diag([-1, -1, 1, 1.0]) @ np.array(volume(noise("i2", *SHAPE)).geometry.matrix)
        made.header.set_qform(affine, qform)
        affine[0, 3] += 5
        made.header.set_sform(affine, sform)
        made.to_filename(tmp_path / form)
        told = f"^the qform and the sform of .*{form} disagree, by up to 5 mm: the {used} is used, as by SimpleITK"
        with pytest.warns(VolumeWarning, match=told):
            read(tmp_path / form)
        with warnings.catch_warnings(action="ignore"):
            agree(by_us(tmp_path / form), by_itk(tmp_path / form))
        affine[0, 3] -= 4.999
        made.header.set_sform(affine, sform)
        made.to_filename(tmp_path / form)
        read(tmp_path / form)

    @pytest.mark.parametrize(("unit", "factor"), [(0, 1), (1, 1000), (2, 1), (3, 0.001)])
    def test_units_become_millimetres_and_come_back(self, tmp_path, unit, factor):
        path = nifti(tmp_path / "in.nii", change=[(123, "<b", unit | 16)])
        known = read(path)
        np.testing.assert_allclose(known.geometry.spacing, np.array(SPACING) * factor, rtol=1e-5)
        np.testing.assert_allclose(known.geometry.origin, np.array(ORIGIN) * factor, rtol=1e-5)
        write(tmp_path / "out.nii", known.samples, known)
        assert (tmp_path / "out.nii").read_bytes() == path.read_bytes()

    def test_a_field_of_vectors_by_itk(self, tmp_path):
        samples, path = noise("f4", *SHAPE, 3), tmp_path / "in.nii.gz"
        sitk.WriteImage(image(samples, vector=True), str(path))
        np.testing.assert_array_equal(read(path).samples, samples)
        agree(by_us(path), by_itk(path))

    def test_long_axes_take_the_second_version(self, tmp_path):
        like = volume(noise("u1", 1, 2, 40_000))
        write(tmp_path / "out.nii", like.samples, like)
        assert isinstance(nibabel.load(tmp_path / "out.nii"), nibabel.Nifti2Image)
        np.testing.assert_array_equal(read(tmp_path / "out.nii").samples, like.samples)

    def test_the_same_volume_makes_the_same_file(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        write(tmp_path / "a.nii.gz", like.samples, like)
        write(tmp_path / "b.nii.gz", like.samples, like)
        assert (tmp_path / "a.nii.gz").read_bytes() == (tmp_path / "b.nii.gz").read_bytes()

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
            ((280, "<3f", 0.7, 0.5, 0.5), "right angles"),
            ((292, "<f", np.inf), "finite"),
            ((108, "<f", np.nan), "begin at byte nan"),
            ((112, "<ff", 2, np.nan), "scaled by 2"),
            ((344, "<4s", b"n+9\0"), "no NIfTI file"),
            ((344, "<4s", b"\0\0\0\0"), "Analyze"),
        ],
    )
    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_bad_headers(self, tmp_path, suffix, change, told):
        message = refused(read, nifti(tmp_path / f"in{suffix}", change=[change]))
        assert told in message
        assert "in.nii" in message

    @pytest.mark.parametrize("step", [0, -1, np.nan, np.inf])
    def test_a_bad_spacing_counts_where_there_is_no_sform(self, tmp_path, step):
        for code in (0, 1):
            change = [(252, "<hh", code, 0), (84, "<f", step)]
            message = refused(read, nifti(tmp_path / "in.nii", change=change))
            assert f"in.nii: its spacing is 0.7 x {step:g} x 2.3, and" in message
            assert message.count("cannot read") == 1

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_sizes_smaller_than_the_data(self, tmp_path, suffix):
        path = nifti(tmp_path / f"in{suffix}", change=[(42, "<h", 5)])
        message = refused(read, path)
        assert "promises 552 bytes, and it has 592" in message
        assert "sizes" in message

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
    def test_a_few_bytes_at_the_end_are_padding(self, tmp_path, suffix):
        path = nifti(tmp_path / f"in{suffix}")
        opened = gzip.open if suffix == ".nii.gz" else open
        with opened(path, "ab") as file:
            file.write(bytes(11))
        np.testing.assert_array_equal(read(path).samples, noise("i2", *SHAPE))

    def test_a_damaged_qform(self, tmp_path):
        change = [(252, "<hh", 1, 0), (256, "<3f", 5, 5, 5)]
        path = nifti(tmp_path / "in.nii", change=change)
        assert "qform" in refused(read, path)

    def test_a_pair_becomes_one_file(self, tmp_path):
        nifti(tmp_path / "in.img", kind=nibabel.Nifti1Pair)
        known = read(tmp_path / "in.hdr")
        write(tmp_path / "out.nii", known.samples, known)
        agree(by_us(tmp_path / "in.hdr"), by_nibabel(tmp_path / "out.nii"), by_itk(tmp_path / "out.nii"))
        assert (tmp_path / "out.nii").read_bytes()[344:348] == b"n+1\0"

    @pytest.mark.parametrize("offset", [0, 100])
    def test_an_offset_within_the_header_is_mended(self, tmp_path, offset):
        path = nifti(tmp_path / "in.nii")
        whole = by_us(path)
        known = read(nifti(path, change=[(108, "<f", offset)]))
        write(tmp_path / "out.nii", known.samples, known)
        agree(whole, by_us(path), by_nibabel(tmp_path / "out.nii"))

    def test_a_pair_without_its_other_half(self, tmp_path):
        nifti(tmp_path / "in.img", kind=nibabel.Nifti1Pair)
        (tmp_path / "in.img").unlink()
        assert "in.img" in refused(read, tmp_path / "in.hdr")

    def test_damage_that_only_the_checksum_tells(self, tmp_path):
        path = nifti(tmp_path / "in.nii.gz", noise("u1", *SHAPE))
        data = gzip.decompress(path.read_bytes())
        stored = bytearray(gzip.compress(data, 0))  # not packed: any byte can change
        stored[-20] ^= 1
        path.write_bytes(stored)
        assert "damaged" in refused(read, path)


class TestITKFormats:
    @pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
    def test_what_else_the_header_says_stays(self, tmp_path, suffix):
        made = image(noise("i2", *SHAPE))
        made.SetMetaData("study", "a b c")
        sitk.WriteImage(made, str(tmp_path / f"in{suffix}"))
        known = read(tmp_path / f"in{suffix}")
        write(tmp_path / f"out{suffix}", known.samples, known)
        again = sitk.ReadImage(str(tmp_path / f"out{suffix}"))
        assert again.GetMetaData("study") == "a b c"
        before, after = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("in", "out"))
        head = [
            line
            for line in before[:700].split(b"\n")[:12]
            if not any(known in line for known in (b"encoding", b"NRRD000", b"space directions"))
        ]
        assert all(line in after for line in head)

    def test_a_nrrd_in_ras(self, tmp_path):
        samples = noise("i2", *SHAPE)
        head = "NRRD0004\ntype: short\ndimension: 3\nspace: right-anterior-superior\nsizes: 6 5 4\n"
        head += "space directions: (1,0,0) (0,2,0) (0,0,3)\nendian: little\nencoding: raw\nspace origin: (5,6,7)\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + samples.tobytes())
        np.testing.assert_array_equal(read(tmp_path / "in.nrrd").samples, samples)
        places = read(tmp_path / "in.nrrd").geometry.to_world([[0, 0, 0], [1, 1, 1]], "RAS")
        np.testing.assert_allclose(places, [[5, 6, 7], [6, 8, 10]])

    def test_the_data_file_has_the_name_that_the_header_tells(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        (tmp_path / "sub").mkdir()
        write(tmp_path / "sub" / "an out.mhd", like.samples, like)
        (tmp_path / "sub").rename(tmp_path / "moved")
        agree(by_us(tmp_path / "moved" / "an out.mhd"), by_itk(tmp_path / "moved" / "an out.mhd"))
        assert (tmp_path / "moved" / "an out.raw").stat().st_size == like.samples.nbytes

    def test_a_data_file_is_not_clobbered(self, tmp_path):
        (tmp_path / "out.raw").write_text("precious")
        like = volume(noise("i2", *SHAPE))
        with pytest.raises(SuppleError, match=r"out\.raw exists already"):
            write(tmp_path / "out.mhd", like.samples, like)
        assert os.listdir(tmp_path) == ["out.raw"]
        assert (tmp_path / "out.raw").read_text() == "precious"

    @pytest.mark.parametrize(
        ("suffix", "old", "new", "told"),
        [
            (".mha", "ElementSpacing = 1", "ElementSpacing = 0", "spacing is 0 x"),
            (".mha", "ElementSpacing = 1", "ElementSpacing = -1", "spacing is -1 x"),
            (".mha", "ElementSpacing = 1", "ElementSpacing = nan", "spacing"),
            (".mha", "DimSize = 6 5 4", "DimSize = 6 -5 4", "6 x -5 x 4 voxels, which is none"),
            (".mha", "DimSize = 6 5 4", "DimSize = 60000 50000 40000", "60000 x 50000 x 40000"),
            (".mha", "DimSize = 6 5 4", "DimSize = 6 5 8", "cut short"),
            (".nrrd", "sizes: 6 5 4", "sizes: 6 0 4", "size is zero"),
            (".nrrd", "sizes: 6 5 4", "sizes: 60000 50000 40000", "60000 x 50000 x 40000"),
            (".nrrd", "sizes: 6 5 4", "sizes: 6 5 8", "cut short"),
            (".nrrd", "space directions: (1", "space directions: (0", "spacing is 0 x"),
            (".nrrd", "space directions: (1", "space directions: (nan", "space vector"),
            (".nrrd", "space directions: (1,0,0)", "space directions: (1,0.5,0)", "right angles"),
            (".nrrd", "type: short", "type: long double", ""),
            (".nrrd", "NRRD0004", "NRXD0004", "no NRRD file"),
        ],
    )
    def test_bad_headers(self, tmp_path, suffix, old, new, told):
        made = sitk.GetImageFromArray(noise("i2", *SHAPE))
        made.SetSpacing((1, 2, 3))
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(made, str(path))
        data = path.read_bytes()
        assert old.encode() in data
        path.write_bytes(data.replace(old.encode(), new.encode()))
        assert told in refused(read, path)

    @pytest.mark.parametrize(
        ("spacings", "told"), [("1 nan 3", "spacing is 1 x nan x 3"), ("1 -2 3", "spacing is 1 x -2 x 3")]
    )
    def test_bad_spacings_of_a_nrrd(self, tmp_path, spacings, told):
        head = f"NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: {spacings}\n"
        head += "endian: little\nencoding: raw\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + noise("i2", *SHAPE).tobytes())
        assert told in refused(read, tmp_path / "in.nrrd")

    @pytest.mark.parametrize("suffix", [".mhd", ".nhdr"])
    @pytest.mark.parametrize("short", [True, False])
    def test_data_beside_that_is_short_or_missing(self, tmp_path, suffix, short):
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(tmp_path / f"in{suffix}"))
        data = (tmp_path / "in.raw").read_bytes()
        (tmp_path / "in.raw").unlink()
        if short:
            (tmp_path / "in.raw").write_bytes(data[:-9])
        assert f"in{suffix}" in refused(read, tmp_path / f"in{suffix}")

    def test_what_is_wrong_with_the_data_file(self, tmp_path):
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(tmp_path / "in.mhd"))
        data = (tmp_path / "in.raw").read_bytes()
        (tmp_path / "in.raw").write_bytes(data[:-9])
        message = refused(read, tmp_path / "in.mhd")
        assert "in.raw is cut short to 231" in message
        assert "240 bytes" in message
        (tmp_path / "in.raw").unlink()
        assert "in.raw is missing" in refused(read, tmp_path / "in.mhd")

    @pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd"])
    def test_damaged_compressed_data(self, tmp_path, suffix):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(image(noise("i2", 20, 30, 40)), str(path), useCompression=True)
        agree(by_us(path), by_itk(path))
        packed = {".nhdr": tmp_path / "in.raw.gz", ".mhd": tmp_path / "in.zraw"}.get(suffix, path)
        whole = packed.read_bytes()
        for place in (len(whole) // 2, len(whole) - 6):
            damaged = bytearray(whole)
            damaged[place] ^= 0xFF
            packed.write_bytes(damaged)
            message = refused(read, path)
            assert "compressed data is damaged" in message or "cut short" in message
        packed.write_bytes(whole[:-2])
        assert "cut short" in refused(read, path)

    @pytest.mark.parametrize(
        ("suffix", "old", "new"),
        [(".mha", b"CompressedData = False", b"CompressedData = True"), (".nrrd", b"encoding: raw", b"encoding: gzip")],
    )
    def test_raw_data_that_is_said_to_be_compressed(self, tmp_path, suffix, old, new):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(path))
        assert old in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(old, new))
        assert "compressed data is damaged" in refused(read, path)

    def test_gzip_in_parts(self, tmp_path):
        samples = noise("i2", *SHAPE)
        head = b"NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nendian: little\nencoding: gzip\n\n"
        data = samples.tobytes()
        (tmp_path / "in.nrrd").write_bytes(head + gzip.compress(data[:100]) + gzip.compress(data[100:]))
        np.testing.assert_array_equal(read(tmp_path / "in.nrrd").samples, samples)

    @pytest.mark.parametrize("packed", [False, True])
    @pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd"])
    @pytest.mark.parametrize(("size", "told"), [(b"5", "200 bytes"), (b"7", "280 bytes"), (b"0", "")])
    def test_sizes_other_than_those_of_the_data(self, tmp_path, suffix, packed, size, told):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(sitk.GetImageFromArray(noise("i2", *SHAPE)), str(path), useCompression=packed)
        name = b"DimSize = " if suffix.startswith(".m") else b"sizes: "
        assert name + b"6 5 4" in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(name + b"6", name + size))
        message = refused(read, path)
        if told:
            assert told in message
        elif suffix.startswith(".m"):
            assert "0 x 5 x 4 voxels, which is none" in message

    @pytest.mark.parametrize(
        ("old", "new", "told"),
        [
            ("(1,0,0)", "(-1e300,0,0)", "spacing is inf x 2 x 3"),
            ("(1,0,0)", "none", "directions are none (0,2,0)"),
            ("origin: (0,0,0)", "origin: (nan,nan,nan)", "origin is (nan,nan,nan)"),
            ("space origin", 'space units: "um" "um" "um"\nspace origin', "unit of length is 'um'"),
        ],
    )
    def test_places_that_would_be_replaced(self, tmp_path, old, new, told):
        made = sitk.GetImageFromArray(noise("i2", *SHAPE))
        made.SetSpacing((1, 2, 3))
        sitk.WriteImage(made, str(tmp_path / "in.nrrd"))
        data = (tmp_path / "in.nrrd").read_bytes()
        assert old.encode() in data
        (tmp_path / "in.nrrd").write_bytes(data.replace(old.encode(), new.encode(), 1))
        assert told in refused(read, tmp_path / "in.nrrd")

    def test_millimetres_are_millimetres(self, tmp_path):
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(tmp_path / "in.nrrd"))
        data = (tmp_path / "in.nrrd").read_bytes()
        units = b'space units: "mm" "mm" "mm"\nspace origin'
        (tmp_path / "in.nrrd").write_bytes(data.replace(b"space origin", units, 1))
        agree(by_us(tmp_path / "in.nrrd"), by_itk(tmp_path / "in.nrrd"))

    def test_a_nrrd_that_tells_no_space(self, tmp_path):
        head = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: 1 2 3\nendian: little\nencoding: raw\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + noise("i2", *SHAPE).tobytes())
        geometry = read(tmp_path / "in.nrrd").geometry
        assert (geometry.convention, geometry.spacing) == ("array", (1, 2, 3))

    def test_a_spacing_is_told_as_it_is(self, tmp_path):
        sitk.WriteImage(sitk.GetImageFromArray(noise("i2", *SHAPE)), str(tmp_path / "in.mha"))
        data = (tmp_path / "in.mha").read_bytes()
        (tmp_path / "in.mha").write_bytes(data.replace(b"Spacing = 1 1 1", b"Spacing = 1 nan 1"))
        assert "spacing is 1 x nan x 1" in refused(read, tmp_path / "in.mha")

    def test_a_target_whose_data_file_exists(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        check_target(tmp_path / "out.mhd", like)
        (tmp_path / "out.raw").write_text("precious")
        with pytest.raises(SuppleError, match=r"out\.raw exists already"):
            check_target(tmp_path / "out.mhd", like)
        check_target(tmp_path / "out.mhd", like, force=True)
        check_target(tmp_path / "out.mha", like)

    def test_complex_numbers(self, tmp_path):
        sitk.WriteImage(sitk.GetImageFromArray(np.zeros(SHAPE, "c8")), str(tmp_path / "in.nrrd"))
        assert "complex" in refused(read, tmp_path / "in.nrrd")


def slices(folder, samples, *, places=None, uid="1.2.3.4", number=1, text="head", change=(), names=None):
    """Write a series of DICOM slices with SimpleITK alone; `change` are tags of single slices."""
    folder.mkdir(exist_ok=True)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    direction = turned(flipped=False)
    for k, slab in enumerate(samples):
        one = sitk.GetImageFromArray(slab)
        place = direction[:, 2] * SPACING[2] * k + ORIGIN if places is None else places[k]
        tags = {
            "0008|0008": "ORIGINAL\\PRIMARY\\AXIAL",
            "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
            "0008|0018": f"{uid}.{k + 1}",
            "0008|0060": "CT",
            "0008|103e": text,
            "0010|0010": "Doe^Jane",
            "0020|000d": "1.2.3",
            "0020|000e": uid,
            "0020|0011": str(number),
            "0020|0013": str(len(samples) - k),
            "0020|0032": "\\".join(f"{x:.8g}" for x in place),
            "0020|0037": "\\".join(f"{x:.10g}" for x in direction[:, :2].T.ravel()),
            "0028|0030": f"{SPACING[1]}\\{SPACING[0]}",
            "0018|0050": str(SPACING[2]),
            **dict(change).get(k, {}),
        }
        one.SetSpacing((*SPACING[:2],))
        for key, value in tags.items():
            one.SetMetaData(key, value)
        name = names[k] if names else f"{uid}-{k}.dcm"
        writer.SetFileName(str(folder / name) + ("" if name.endswith(".dcm") else ".dcm"))
        writer.Execute(one)
        if not name.endswith(".dcm"):
            (folder / f"{name}.dcm").rename(folder / name)
    return folder


def element(group, number, kind, data):
    """One element of a DICOM file."""
    data = data.encode() if isinstance(data, str) else data
    data += (b"\0" if kind in ("UI", "OB") else b" ") * (len(data) % 2)
    long = struct.pack("<HI", 0, len(data)) if kind == "OB" else struct.pack("<H", len(data))
    return struct.pack("<HH2s", group, number, kind.encode()) + long + data


def no_image(path, end, modality):
    """Write a DICOM file without voxels, of a class of storage that ends so."""
    uid, known = "1.2.840.10008.5.1.4.1.1." + end, "1.2.9." + end
    meta = element(2, 1, "OB", b"\0\1") + element(2, 2, "UI", uid) + element(2, 3, "UI", known)
    meta += element(2, 0x10, "UI", "1.2.840.10008.1.2.1")
    body = element(8, 0x16, "UI", uid) + element(8, 0x18, "UI", known) + element(8, 0x60, "CS", modality)
    body += element(0x20, 0xD, "UI", "1.2.3") + element(0x20, 0xE, "UI", known)
    path.write_bytes(bytes(128) + b"DICM" + element(2, 0, "UL", struct.pack("<I", len(meta))) + meta + body)


class TestDICOM:
    def test_what_is_no_image_is_left_out_and_named(self, tmp_path):
        samples = noise("i2", *SHAPE)
        folder = slices(tmp_path / "in", samples)
        no_image(folder / "rs.dcm", "481.3", "RTSTRUCT")
        no_image(folder / "report", "88.11", "SR")
        with pytest.warns(VolumeWarning) as told:
            np.testing.assert_array_equal(read(folder).samples, samples)
        assert [str(one.message) for one in told] == [
            f"report (SR), rs.dcm (RTSTRUCT) in {folder}: no images of a series, and left out"
        ]
        derived = {"dose.dcm": ("481.2", "RTDOSE"), "seg.dcm": ("66.4", "SEG")}
        for k, (name, (end, modality)) in enumerate(derived.items()):
            tags = {"0008|0016": f"1.2.840.10008.5.1.4.1.1.{end}", "0008|0060": modality}
            slices(folder, noise("u2", 1, 5, 6), uid=f"1.2.{k}", names=[name], change=[(0, tags)])
        with pytest.warns(
            VolumeWarning, match=r"dose.dcm \(RTDOSE\), report \(SR\), rs.dcm \(RTSTRUCT\) and 1 more in"
        ):
            np.testing.assert_array_equal(read(folder).samples, samples)
        for path in (folder / "report", folder / "rs.dcm"):
            path.unlink()
        with pytest.warns(VolumeWarning, match=r"dose.dcm \(RTDOSE\), seg.dcm \(SEG\) in"):
            assert info(folder)["shape"] == [6, 5, 4]
        for path in folder.glob("1.2.3.4-*"):
            path.unlink()
        with pytest.warns(VolumeWarning, match="^dose.dcm"):  # without its grid, nothing can be read of it
            assert read(folder).samples.shape == (1, 5, 6)
        (folder / "seg.dcm").unlink()
        assert "no DICOM images" in refused(read, folder)

    @pytest.mark.parametrize("split", [False, True])
    def test_slices_in_subfolders(self, tmp_path, split):
        samples = noise("i2", *SHAPE)
        slices(tmp_path / "in", samples)
        for k, path in enumerate(sorted((tmp_path / "in").iterdir())):
            inner = tmp_path / "study" / "a" / (f"part{k // 2}" if split else "series")
            inner.mkdir(parents=True, exist_ok=True)
            path.rename(inner / path.name)
        no_image(tmp_path / "study" / "DICOMDIR", "1", "")
        (tmp_path / "study" / "README.TXT").write_text("hello")
        assert is_volume(tmp_path / "study")
        np.testing.assert_array_equal(read(tmp_path / "study").samples, samples)
        slices(tmp_path / "study" / "b", samples[:2], uid="1.2.5")
        assert "it holds 2 series" in refused(read, tmp_path / "study")
        (tmp_path / "study" / "DICOMDIR").unlink()
        (tmp_path / "study" / "photo.jpg").write_bytes(b"no matter")
        assert not is_volume(tmp_path / "study")

    @pytest.mark.parametrize(("most", "dtype"), [(3071, "i2"), (32768, "i4")])
    @pytest.mark.parametrize("stored", ["i2", "u2"])
    def test_values_stay_in_16_bits_if_they_fit(self, tmp_path, most, dtype, stored):
        samples = (noise("u2", *SHAPE) % 4000).astype(stored)
        samples[1, 2, 3] = min(most + 1024, np.iinfo(stored).max)
        folder = slices(tmp_path / "in", samples)
        for path in folder.iterdir():
            data, intercept = path.read_bytes(), b"\x28\x00\x52\x10\x02\x00\x00\x000 "
            assert data.count(intercept) == 1
            path.write_bytes(data.replace(intercept, b"\x28\x00\x52\x10\x06\x00\x00\x00-1024 "))
        known = read(folder).samples
        assert known.dtype == (dtype if stored == "u2" else "i2")
        np.testing.assert_array_equal(known, samples.astype(int) - 1024)
        np.testing.assert_array_equal(read(next(folder.iterdir())).samples, known)

    def test_a_series(self, tmp_path):
        samples = noise("i2", *SHAPE)
        known = read(slices(tmp_path / "in", samples))
        np.testing.assert_array_equal(known.samples, samples)
        wanted = Geometry(SPACING, ORIGIN, turned(flipped=False), "LPS")
        np.testing.assert_allclose(known.geometry.matrix, wanted.matrix, atol=1e-5)
        assert (known.format, known.geometry.convention, known.header) == ("DICOM", "LPS", None)

    def test_others_see_the_same_places(self, tmp_path):
        folder = slices(tmp_path / "in", noise("i2", *SHAPE))
        reader = sitk.ImageSeriesReader()
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
        sitk.WriteImage(reader.Execute(), str(tmp_path / "out.nrrd"))
        agree(by_us(folder), by_itk(tmp_path / "out.nrrd"))
        write(tmp_path / "out.nii", read(folder).samples, read(folder))
        agree(by_us(folder), by_nibabel(tmp_path / "out.nii"))

    def test_nothing_of_the_patient_gets_out(self, tmp_path):
        known = read(slices(tmp_path / "in", noise("i2", *SHAPE)))
        for suffix in PLACED:
            write(tmp_path / f"out{suffix}", known.samples, known)
        data = b"".join(path.read_bytes() for path in tmp_path.glob("out.*"))
        data += gzip.decompress((tmp_path / "out.nii.gz").read_bytes())
        assert b"Doe" not in data
        assert b"Doe" in next((tmp_path / "in").iterdir()).read_bytes()

    def test_the_order_of_files_and_numbers_means_nothing(self, tmp_path):
        samples, direction = noise("i2", *SHAPE), turned(flipped=False)
        places = [direction[:, 2] * SPACING[2] * k + ORIGIN for k in range(4)]
        order = [2, 0, 3, 1]
        folder = slices(tmp_path / "in", samples[order], places=[places[k] for k in order])
        np.testing.assert_array_equal(read(folder).samples, samples)

    @pytest.mark.parametrize("name", ["1.2.3.4-2.dcm", "IM0", "IM.0001"])
    def test_one_slice_stands_for_its_series(self, tmp_path, name):
        samples = noise("i2", *SHAPE)
        folder = slices(tmp_path / "in", samples, names=["IM0", "IM.0001", "1.2.3.4-2.dcm", "x.dcm"])
        slices(tmp_path / "in", samples[:2], uid="1.2.3.5")
        assert is_volume(folder)
        assert is_volume(folder / name)
        np.testing.assert_array_equal(read(folder / name).samples, samples)

    def test_several_series(self, tmp_path):
        samples = noise("i2", *SHAPE)
        slices(tmp_path / "in", samples, uid="1.2.9", number=2, text="second")
        folder = slices(tmp_path / "in", samples[:3] + 1, uid="1.2.10", number=7, text="first")
        message = refused(read, folder)
        assert "1 is 1.2.9 second of 4 slices, 2 is 1.2.10 first of 3 slices" in message
        assert "--series" in message
        for name in ("1", "1.2.9"):
            np.testing.assert_array_equal(read(folder, series=name).samples, samples)
        for name in ("2", "1.2.10"):
            np.testing.assert_array_equal(read(folder, series=name).samples, samples[:3] + 1)
        assert "no series 3 (1 is" in refused(read, folder, series="3")
        kinds = [("1.2.9", "second", 4), ("1.2.10", "first", 3)]
        listed = [{"number": k, "uid": u, "description": d, "slices": n} for k, (u, d, n) in enumerate(kinds, 1)]
        assert info(folder) == {"format": "DICOM", "series": listed}
        assert info(folder, series="2")["shape"] == [6, 5, 3]

    def test_hounsfield_units(self, tmp_path):
        samples = noise("u1", *SHAPE).astype("i2")
        folder = slices(tmp_path / "in", samples)
        for path in folder.iterdir():
            data = path.read_bytes()
            for old, new in (
                (b"\x28\x00\x52\x10\x02\x00\x00\x000 ", b"-9"),
                (b"\x28\x00\x53\x10\x02\x00\x00\x001 ", b"2 "),
            ):
                assert data.count(old) == 1
                data = data.replace(old, old[:-2] + new)
            path.write_bytes(data)
        np.testing.assert_array_equal(read(folder).samples, samples * 2 - 9)

    def test_a_missing_slice(self, tmp_path):
        folder = slices(tmp_path / "in", noise("i2", 6, 5, 6))
        (folder / "1.2.3.4-3.dcm").unlink()
        message = refused(read, folder)
        assert "missing between 1.2.3.4-2.dcm and 1.2.3.4-4.dcm (4.6 mm, elsewhere 2.3 mm)" in message

    def test_one_slice_alone(self, tmp_path):
        folder = slices(tmp_path / "in", noise("i2", 1, 5, 6))
        path = next(folder.iterdir())
        # ITK may add a spacing between slices: make a field strength of it
        path.write_bytes(path.read_bytes().replace(b"\x18\0\x88\0\2", b"\x18\0\x87\0\2"))
        known = read(folder)
        assert known.samples.shape == (1, 5, 6)
        np.testing.assert_allclose(known.geometry.spacing, SPACING)

    def _places(self, steps, aside=(0, 0, 0)):
        normal = turned(flipped=False)[:, 2]
        return [normal * step + np.array(aside) * k + ORIGIN for k, step in enumerate(steps)]

    @pytest.mark.parametrize(
        ("steps", "told"),
        [((0, 2, 2, 4), "at the same place"), ((0, 2, 3.4, 5.4), "1.4 to 2 mm apart"), ((0, 0, 0, 0), "same place")],
    )
    def test_uneven_slices(self, tmp_path, steps, told):
        folder = slices(tmp_path / "in", noise("i2", *SHAPE), places=self._places(steps))
        assert told in refused(read, folder)

    def test_a_tilted_gantry(self, tmp_path):
        aside = turned(flipped=False)[:, 1] * 0.6
        folder = slices(tmp_path / "in", noise("i2", *SHAPE), places=self._places((0, 2, 4, 6), aside))
        assert "right angles" in refused(read, folder)

    @pytest.mark.parametrize(
        ("change", "told"),
        [
            ({"0020|0037": "1\\0\\0\\0\\1\\0"}, "several directions"),
            (b"3.3\\.7", "several spacings"),
            (b"0.0\\.0", "spacing is 0 x 0,"),
            (b"-1.\\.7", "spacing is -1 x 0.7,"),
            (b"1.1\\ab", "spacing is nan,"),
        ],
    )
    def test_slices_that_are_not_alike(self, tmp_path, change, told):
        tags = [(2, change)] if isinstance(change, dict) else []
        folder = slices(tmp_path / "in", noise("i2", *SHAPE), change=tags)
        if not tags:
            path = folder / "1.2.3.4-2.dcm"
            data = path.read_bytes()
            assert data.count(b"1.1\\.7") == 1
            path.write_bytes(data.replace(b"1.1\\.7", change))
        assert told in refused(read, folder)

    def test_slices_of_two_sizes(self, tmp_path):
        slices(tmp_path / "in", noise("i2", *SHAPE))
        folder = slices(tmp_path / "in", noise("i2", 1, 7, 6), names=["z.dcm"], places=self._places([9.2]))
        assert "several sizes" in refused(read, folder)

    @pytest.mark.parametrize("k", [0, 2, 3])
    @pytest.mark.parametrize("count", [0, 300, -30])
    def test_a_damaged_slice(self, tmp_path, k, count):
        folder = slices(tmp_path / "in", noise("i2", *SHAPE))
        path = folder / f"1.2.3.4-{k}.dcm"
        path.write_bytes(path.read_bytes()[:count])
        assert path.name in refused(read, folder)

    def test_what_else_lies_in_the_folder(self, tmp_path):
        samples = noise("i2", *SHAPE)
        folder = slices(tmp_path / "in", samples)
        (folder / "DICOMDIR").write_bytes(bytes(128) + b"DICM" + bytes(10))
        (folder / "notes.txt").write_text("hello")
        (folder / "sub").mkdir()
        np.testing.assert_array_equal(read(folder).samples, samples)

    def test_slices_of_two_types(self, tmp_path):
        samples = noise("i2", *SHAPE)
        folder = slices(tmp_path / "in", samples[:2])
        places = self._places([4.6, 6.9])
        slices(folder, samples[2:].astype("i4") * 2**14, names=["y.dcm", "z.dcm"], places=places)
        known = read(folder)
        np.testing.assert_array_equal(known.samples[2:], samples[2:].astype("i4") * 2**14)
        np.testing.assert_array_equal(known.samples[:2], samples[:2])

    def test_a_file_of_many_frames(self, tmp_path):
        samples = noise("u1", *SHAPE)
        made = sitk.GetImageFromArray(samples)
        made.SetSpacing((0.5, 0.5, 2))
        sitk.WriteImage(made, str(tmp_path / "in.dcm"))
        np.testing.assert_array_equal(read(tmp_path / "in.dcm").samples, samples)
        assert read(tmp_path / "in.dcm").sizes == (6, 5, 4)

    def test_folders_without(self, tmp_path):
        assert not is_volume(tmp_path)
        (tmp_path / "notes.txt").write_text("hello")
        (tmp_path / "README").write_text("hello" * 99)
        assert not is_volume(tmp_path)
        assert "no DICOM images" in refused(read, tmp_path)

    def test_standard_error_is_given_back(self, tmp_path, capfd):
        (tmp_path / "in.mha").write_text("hello")
        refused(read, tmp_path / "in.mha")
        os.write(2, b"still here")
        assert capfd.readouterr().err == "still here"


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


class TestRefusals:
    @pytest.mark.parametrize("suffix", sorted(SUFFIXES | {".tif"}))
    @pytest.mark.parametrize("data", [b"", b"hello, this is text\n" * 40, b"\x1f\x8b\x08\0", bytes(1000)])
    def test_no_volumes(self, tmp_path, suffix, data):
        path = tmp_path / f"in{suffix}"
        path.write_bytes(data)
        assert f"in{suffix}" in refused(read, path) or suffix == ".img"
        if not data and suffix != ".img":
            assert "it is empty" in refused(read, path)

    @pytest.mark.parametrize("suffix", sorted(SUFFIXES | {".tif", ""}))
    def test_missing(self, tmp_path, suffix):
        message = refused(read, tmp_path / f"in{suffix}")
        assert "No such file" in message
        assert "check the name" in message

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha", ".dcm", ".dat"])
    def test_folders_in_place_of_files(self, tmp_path, suffix):
        (tmp_path / f"in{suffix}").mkdir()
        assert "no DICOM images" in refused(read, tmp_path / f"in{suffix}")

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".tif"])
    @pytest.mark.parametrize("part", [0.3, 0.6, 0.97])
    def test_cut_short(self, tmp_path, suffix, part):
        like, path = volume(noise("u2", 8, 20, 20)), tmp_path / f"out{suffix}"
        write(path, like.samples, like)
        short = tmp_path / "out.raw" if suffix == ".mhd" else path
        data = short.read_bytes()
        short.write_bytes(data[: int(len(data) * part)])
        refused(read, path)

    def test_an_unknown_suffix(self, tmp_path):
        (tmp_path / "in.xyz").write_text("hello" * 99)
        assert "no volume of a known kind" in refused(read, tmp_path / "in.xyz")

    def test_odd_names(self, tmp_path):
        path = tmp_path / "a\nb.nii"
        path.write_text("text")
        assert "a\\nb.nii" in refused(read, path)

    @pytest.mark.parametrize("name", ["out.dcm", "out.xyz", "out", "out.gz", "out.nhdr", "out.dat"])
    def test_formats_that_are_not_written(self, tmp_path, name):
        like = volume(noise("i2", *SHAPE))
        with pytest.raises(SuppleError, match=r"use \.nii, \.nii\.gz, \.nrrd"):
            check_target(tmp_path / name, like)

    def test_types_that_no_volume_has(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        for suffix in SUFFIXES_OUT:
            with pytest.raises(SuppleError, match="float16"):
                check_target(tmp_path / f"out{suffix}", like, "float16")
        check_target(tmp_path / "out.tif", like, "float32")
        scaled = replace(volume(noise("i4", *SHAPE)), scaling=(2.0, 0.0))  # which makes float64 of it
        with pytest.raises(SuppleError, match="float64"):
            check_target(tmp_path / "out.tif", scaled)
        check_target(tmp_path / "out.nii", scaled)

    def test_samples_of_another_shape(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        assert "make them alike" in refused(write, tmp_path / "out.nii", like.samples[:2], like)

    @pytest.mark.parametrize("suffix", SUFFIXES_OUT)
    def test_a_full_disk(self, tmp_path, suffix):
        code = """
            import resource, signal, sys
            import numpy as np
            from supple.geometry import Geometry
            from supple.media.volume import Volume, write
            from supple.errors import SuppleError
            samples = np.random.default_rng(0).integers(0, 60000, (20, 40, 50)).astype("u2")
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
            try:
                write(sys.argv[1], samples, Volume(samples, Geometry()))
            except SuppleError as error:
                print(error)
        """
        for limit in (300, 40_000, 79_990):
            command = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / f"out{suffix}"), str(limit)]
            environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "src")}
            done = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment)
            assert (done.returncode, done.stderr) == (0, "")
            assert done.stdout.count("\n") == 1
            assert f"out{suffix}" in done.stdout or "out.raw" in done.stdout
            assert not list(tmp_path.iterdir())


class TestInfo:
    def test_of_a_nifti(self, tmp_path):
        samples = noise("f4", *SHAPE)
        samples[0, 0, :2] = np.nan
        told = info(nifti(tmp_path / "in.nii.gz", samples))
        direction = turned() * [[-1], [-1], [1]]
        np.testing.assert_allclose(told.pop("direction"), direction, atol=1e-6)
        np.testing.assert_allclose(told.pop("origin"), np.array(ORIGIN) * [-1, -1, 1], rtol=1e-6)
        np.testing.assert_allclose(told.pop("spacing"), SPACING, rtol=1e-6)
        letters = "".join(nibabel.aff2axcodes(nibabel.load(tmp_path / "in.nii.gz").affine))
        assert told == {
            "format": "NIfTI",
            "shape": [6, 5, 4],
            "dtype": "float32",
            "components": 1,
            "times": 1,
            "interval": None,
            "convention": "RAS",
            "orientation": letters,
            "oblique": pytest.approx(read(tmp_path / "in.nii.gz").geometry.oblique),
            "scaling": [1, 0],
            "minimum": float(np.nanmin(samples)),
            "maximum": float(np.nanmax(samples)),
            "nan": 2,
            "bytes": 480,
        }

    @pytest.mark.parametrize("letters", ["RAS", "LPS", "LAI", "PIR", "SLP"])
    def test_orientation(self, tmp_path, letters):
        affine = nibabel.orientations.inv_ornt_aff(nibabel.orientations.axcodes2ornt(tuple(letters)), SHAPE)
        affine = np.linalg.inv(affine)
        affine[:3, 3] = 0
        path = nifti(tmp_path / "in.nii", affine=np.round(np.linalg.inv(affine)))
        assert "".join(nibabel.aff2axcodes(nibabel.load(path).affine)) == info(path)["orientation"]

    def test_of_nothing_but_nan(self, tmp_path):
        samples = np.full(SHAPE, np.nan, "f4")
        told = info(nifti(tmp_path / "in.nii", samples))
        assert (told["minimum"], told["maximum"], told["nan"]) == (None, None, 120)

    def test_of_large_integers(self, tmp_path):
        samples = np.array([[[2**63, 2**64 - 1]]], "u8")
        write(tmp_path / "in.nii", samples, volume(samples))
        told = info(tmp_path / "in.nii")
        assert (told["minimum"], told["maximum"]) == (2**63, 2**64 - 1)

    def test_of_a_series_and_of_raw(self, tmp_path):
        like = volume(noise("u1", 3, *SHAPE), series=True, interval=2.5)
        write(tmp_path / "out.nii", like.samples, like)
        told = info(tmp_path / "out.nii")
        assert (told["times"], told["interval"], told["shape"]) == (3, 2.5, [6, 5, 4])
        (tmp_path / "in.raw").write_bytes(bytes(24))
        assert info(tmp_path / "in.raw", raw=RawLayout((4, 3, 2), "u1"))["orientation"] is None


class TestKinds:
    @pytest.mark.parametrize("suffix", sorted(SUFFIXES))
    def test_by_suffix(self, tmp_path, suffix):
        assert is_volume(tmp_path / f"a.b{suffix}")

    @pytest.mark.parametrize("name", ["a.png", "a.tif", "a.gz", "a.mp4", "nii", "a.json", "a"])
    def test_others(self, tmp_path, name):
        assert not is_volume(tmp_path / name)

    def test_a_picture_by_radiance_is_none(self, tmp_path):
        (tmp_path / "sky.hdr").write_bytes(b"#?RADIANCE\n")
        assert not is_volume(tmp_path / "sky.hdr")

    def test_it_takes_no_library_to_tell(self):
        code = "import sys, supple.media.volume; print(sorted({'nibabel', 'SimpleITK', 'pyvips'} & set(sys.modules)))"
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "src")}
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", env=environment)
        assert done.stdout == "[]\n"


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
