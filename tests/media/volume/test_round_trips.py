"""Volumes come back from files as they were; what is refused, and what is told of a file."""

from dataclasses import replace

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.errors import SuppleError
from supple.media.volume import SUFFIXES, SUFFIXES_OUT, RawLayout, check_target, info, is_volume, read, write
from tests.media.volume import volumes


class TestRoundTrips:
    @pytest.mark.parametrize(("dtype", "shape"), [*((d, volumes.SHAPE) for d in volumes.DTYPES), ("i2", (1, 5, 6))])
    @pytest.mark.parametrize("suffix", volumes.PLACED)
    def test_bit_for_bit_and_in_place(self, tmp_path, suffix, dtype, shape):
        like = volumes.volume(volumes.noise(dtype, *shape))
        write(tmp_path / f"out{suffix}", like.samples, like)
        back = read(tmp_path / f"out{suffix}")
        assert back.samples.dtype == like.samples.dtype
        assert back.samples.flags.c_contiguous
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.matrix, like.geometry.matrix, atol=1e-5)
        assert back.geometry.convention == ("RAS" if suffix.startswith(".nii") else "LPS")
        assert (back.series, back.scaling, back.sizes) == (False, (1, 0), shape[::-1])

    @pytest.mark.parametrize("suffix", [*volumes.PLACED, ".nhdr", ".hdr"])
    def test_what_others_wrote(self, tmp_path, suffix):
        path = tmp_path / f"in{suffix}"
        if suffix == ".hdr":  # nibabel's pair
            volumes.nifti(path.with_suffix(".img"), kind=nibabel.Nifti1Pair)
            volumes.agree(
                volumes.by_us(path),
                volumes.by_us(path.with_suffix(".img")),
                volumes.by_nibabel(path.with_suffix(".img")),
            )
            return
        sitk.WriteImage(volumes.image(volumes.noise("i2", *volumes.SHAPE)), str(path))
        volumes.agree(volumes.by_us(path), volumes.by_itk(path))
        assert read(path).format == {".nii": "NIfTI", ".gz": "NIfTI"}.get(path.suffix, read(path).format)

    @pytest.mark.parametrize("before", volumes.PLACED)
    @pytest.mark.parametrize("after", volumes.PLACED)
    def test_from_every_format_to_every_other(self, tmp_path, before, after):
        like = volumes.volume(volumes.noise("u2", *volumes.SHAPE))
        write(tmp_path / f"a{before}", like.samples, like)
        known = read(tmp_path / f"a{before}")
        write(tmp_path / f"b{after}", known.samples, known)
        volumes.agree(
            volumes.by_us(tmp_path / f"a{before}"),
            volumes.by_itk(tmp_path / f"b{after}"),
            volumes.by_us(tmp_path / f"b{after}"),
        )

    @pytest.mark.parametrize("suffix", [*volumes.PLACED, ".tif"])
    @pytest.mark.parametrize(("dtype", "components"), [("u1", 3), ("u1", 4), ("f4", 3), ("i2", 2)])
    def test_colours_and_vectors(self, tmp_path, suffix, dtype, components):
        like, path = volumes.volume(volumes.noise(dtype, *volumes.SHAPE, components)), tmp_path / f"out{suffix}"
        write(path, like.samples, like)
        back = read(path)
        np.testing.assert_array_equal(back.samples, like.samples)
        assert back.samples.dtype == like.samples.dtype
        assert (back.series, back.components) == (False, components)
        if suffix != ".tif":
            volumes.agree(
                (like.geometry.to_lps(volumes.VOXELS), [like.samples[v[::-1]] for v in volumes.VOXELS]),
                volumes.by_itk(path),
            )

    @pytest.mark.parametrize("suffix", volumes.PLACED)
    def test_series(self, tmp_path, suffix):
        like = volumes.volume(volumes.noise("f4", 3, *volumes.SHAPE), series=True, interval=0.25)
        write(tmp_path / f"out{suffix}", like.samples, like)
        back = read(tmp_path / f"out{suffix}")
        np.testing.assert_array_equal(back.samples, like.samples)
        np.testing.assert_allclose(back.geometry.matrix, like.geometry.matrix, atol=1e-5)
        assert (back.series, back.interval, back.components, back.sizes) == (True, 0.25, 1, volumes.SHAPE[::-1])
        known = sitk.ReadImage(str(tmp_path / f"out{suffix}"))
        assert known.GetSpacing()[3] == 0.25
        np.testing.assert_array_equal(sitk.GetArrayFromImage(known), like.samples)

    @pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
    def test_a_flat_image_is_one_slice(self, tmp_path, suffix):
        flat = sitk.GetImageFromArray(volumes.noise("i2", 5, 6))
        flat.SetSpacing((0.5, 2))
        sitk.WriteImage(flat, str(tmp_path / f"in{suffix}"))
        known = read(tmp_path / f"in{suffix}")
        assert known.samples.shape == (1, 5, 6)
        assert known.geometry.spacing == (0.5, 2, 1)
        write(tmp_path / f"out{suffix}", known.samples, known)
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples[0], volumes.noise("i2", 5, 6))

    @pytest.mark.parametrize("suffix", [*volumes.PLACED, ".tif"])
    def test_nan_and_infinity_pass(self, tmp_path, suffix):
        samples = volumes.noise("f4", *volumes.SHAPE)
        samples[1, 2, 3], samples[0, 0, 0], samples[3, 4, 5] = np.nan, np.inf, -np.inf
        write(tmp_path / f"out{suffix}", samples, volumes.volume(samples))
        np.testing.assert_array_equal(read(tmp_path / f"out{suffix}").samples, samples)

    @pytest.mark.parametrize("suffix", SUFFIXES_OUT)
    def test_capital_letters(self, tmp_path, suffix):
        like = volumes.volume(volumes.noise("i2", *volumes.SHAPE))
        write(tmp_path / f"OUT{suffix.upper()}", like.samples, like)
        assert is_volume(tmp_path / f"OUT{suffix.upper()}") == (suffix not in (".tif", ".tiff"))
        np.testing.assert_array_equal(read(tmp_path / f"OUT{suffix.upper()}").samples, like.samples)


class TestRefusals:
    @pytest.mark.parametrize("suffix", sorted(SUFFIXES | {".tif"}))
    @pytest.mark.parametrize("data", [b"", b"hello, this is text\n" * 40, b"\x1f\x8b\x08\0", bytes(1000)])
    def test_no_volumes(self, tmp_path, suffix, data):
        path = tmp_path / f"in{suffix}"
        path.write_bytes(data)
        assert f"in{suffix}" in volumes.refused(read, path) or suffix == ".img"
        if not data and suffix != ".img":
            assert "it is empty" in volumes.refused(read, path)

    @pytest.mark.parametrize("suffix", sorted(SUFFIXES | {".tif", ""}))
    def test_missing(self, tmp_path, suffix):
        message = volumes.refused(read, tmp_path / f"in{suffix}")
        assert "No such file" in message
        assert "check the name" in message

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha", ".dcm", ".dat"])
    def test_folders_in_place_of_files(self, tmp_path, suffix):
        (tmp_path / f"in{suffix}").mkdir()
        assert "no DICOM images" in volumes.refused(read, tmp_path / f"in{suffix}")

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".tif"])
    @pytest.mark.parametrize("part", [0.3, 0.6, 0.97])
    def test_cut_short(self, tmp_path, suffix, part):
        like, path = volumes.volume(volumes.noise("u2", 8, 20, 20)), tmp_path / f"out{suffix}"
        write(path, like.samples, like)
        short = tmp_path / "out.raw" if suffix == ".mhd" else path
        data = short.read_bytes()
        short.write_bytes(data[: int(len(data) * part)])
        volumes.refused(read, path)

    def test_an_unknown_suffix(self, tmp_path):
        (tmp_path / "in.xyz").write_text("hello" * 99)
        assert "no volume of a known kind" in volumes.refused(read, tmp_path / "in.xyz")

    @pytest.mark.parametrize("name", ["out.dcm", "out.xyz", "out", "out.gz", "out.nhdr", "out.dat"])
    def test_formats_that_are_not_written(self, tmp_path, name):
        like = volumes.volume(volumes.noise("i2", *volumes.SHAPE))
        with pytest.raises(SuppleError, match=r"use \.nii, \.nii\.gz, \.nrrd"):
            check_target(tmp_path / name, like)

    def test_types_that_no_volume_has(self, tmp_path):
        like = volumes.volume(volumes.noise("i2", *volumes.SHAPE))
        for suffix in SUFFIXES_OUT:
            with pytest.raises(SuppleError, match="float16"):
                check_target(tmp_path / f"out{suffix}", like, "float16")
        check_target(tmp_path / "out.tif", like, "float32")
        scaled = replace(
            volumes.volume(volumes.noise("i4", *volumes.SHAPE)), scaling=(2.0, 0.0)
        )  # which makes float64 of it
        with pytest.raises(SuppleError, match="float64"):
            check_target(tmp_path / "out.tif", scaled)
        check_target(tmp_path / "out.nii", scaled)

    def test_samples_of_another_shape(self, tmp_path):
        like = volumes.volume(volumes.noise("i2", *volumes.SHAPE))
        assert "make them alike" in volumes.refused(write, tmp_path / "out.nii", like.samples[:2], like)


class TestInfo:
    def test_of_a_nifti(self, tmp_path):
        samples = volumes.noise("f4", *volumes.SHAPE)
        samples[0, 0, :2] = np.nan
        told = info(volumes.nifti(tmp_path / "in.nii.gz", samples))
        direction = volumes.turned() * [[-1], [-1], [1]]
        np.testing.assert_allclose(told.pop("direction"), direction, atol=1e-6)
        np.testing.assert_allclose(told.pop("origin"), np.array(volumes.ORIGIN) * [-1, -1, 1], rtol=1e-6)
        np.testing.assert_allclose(told.pop("spacing"), volumes.SPACING, rtol=1e-6)
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
            "shear": 0.0,
            "scaling": [1, 0],
            "minimum": float(np.nanmin(samples)),
            "maximum": float(np.nanmax(samples)),
            "nan": 2,
            "bytes": 480,
        }

    @pytest.mark.parametrize("letters", ["RAS", "LPS", "LAI", "PIR", "SLP"])
    def test_orientation(self, tmp_path, letters):
        affine = nibabel.orientations.inv_ornt_aff(nibabel.orientations.axcodes2ornt(tuple(letters)), volumes.SHAPE)
        affine = np.linalg.inv(affine)
        affine[:3, 3] = 0
        path = volumes.nifti(tmp_path / "in.nii", affine=np.round(np.linalg.inv(affine)))
        assert "".join(nibabel.aff2axcodes(nibabel.load(path).affine)) == info(path)["orientation"]

    def test_of_nothing_but_nan(self, tmp_path):
        samples = np.full(volumes.SHAPE, np.nan, "f4")
        told = info(volumes.nifti(tmp_path / "in.nii", samples))
        assert (told["minimum"], told["maximum"], told["nan"]) == (None, None, 120)

    def test_of_large_integers(self, tmp_path):
        samples = np.array([[[2**63, 2**64 - 1]]], "u8")
        write(tmp_path / "in.nii", samples, volumes.volume(samples))
        told = info(tmp_path / "in.nii")
        assert (told["minimum"], told["maximum"]) == (2**63, 2**64 - 1)

    def test_of_a_series_and_of_raw(self, tmp_path):
        like = volumes.volume(volumes.noise("u1", 3, *volumes.SHAPE), series=True, interval=2.5)
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
