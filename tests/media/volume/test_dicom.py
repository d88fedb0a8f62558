"""Series of DICOM slices."""

import contextlib
import gzip
import os

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.errors import SuppleError, VolumeWarning
from supple.media.volume import info, is_volume, read, write
from supple.space.geometry import Geometry
from tests.media.volume import volumes


def slices(folder, samples, *, places=None, uid="1.2.3.4", number=1, text="head", change=(), names=None):
    """Write a series of DICOM slices with SimpleITK alone; `change` are tags of single slices."""
    folder.mkdir(exist_ok=True)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    direction = volumes.turned(flipped=False)
    for k, slab in enumerate(samples):
        one = sitk.GetImageFromArray(slab)
        place = direction[:, 2] * volumes.SPACING[2] * k + volumes.ORIGIN if places is None else places[k]
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
            "0028|0030": f"{volumes.SPACING[1]}\\{volumes.SPACING[0]}",
            "0018|0050": str(volumes.SPACING[2]),
            **dict(change).get(k, {}),
        }
        one.SetSpacing((*volumes.SPACING[:2],))
        for key, value in tags.items():
            one.SetMetaData(key, value)
        name = names[k] if names else f"{uid}-{k}.dcm"
        writer.SetFileName(str(folder / name) + ("" if name.endswith(".dcm") else ".dcm"))
        writer.Execute(one)
        if not name.endswith(".dcm"):
            (folder / f"{name}.dcm").rename(folder / name)
    return folder


def no_image(path, end, modality):
    """Write a DICOM file without voxels, of a class of storage that ends so."""
    uid, known = "1.2.840.10008.5.1.4.1.1." + end, "1.2.9." + end
    volumes.save(
        path,
        volumes.item(
            SOPClassUID=uid, SOPInstanceUID=known, Modality=modality, StudyInstanceUID="1.2.3", SeriesInstanceUID=known
        ),
    )


class TestDICOM:
    def test_what_is_no_image_is_left_out_and_named(self, tmp_path):
        samples = volumes.noise("i2", *volumes.SHAPE)
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
            slices(folder, volumes.noise("u2", 1, 5, 6), uid=f"1.2.{k}", names=[name], change=[(0, tags)])
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
        assert "no DICOM images" in volumes.refused(read, folder)

    @pytest.mark.parametrize("split", [False, True])
    def test_slices_in_subfolders(self, tmp_path, split):
        samples = volumes.noise("i2", *volumes.SHAPE)
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
        assert "it holds 2 series" in volumes.refused(read, tmp_path / "study")
        (tmp_path / "study" / "DICOMDIR").unlink()
        (tmp_path / "study" / "photo.jpg").write_bytes(b"no matter")
        assert not is_volume(tmp_path / "study")

    @pytest.mark.parametrize(("most", "dtype"), [(3071, "i2"), (32768, "i4")])
    @pytest.mark.parametrize("stored", ["i2", "u2"])
    def test_values_stay_in_16_bits_if_they_fit(self, tmp_path, most, dtype, stored):
        samples = (volumes.noise("u2", *volumes.SHAPE) % 4000).astype(stored)
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
        samples = volumes.noise("i2", *volumes.SHAPE)
        known = read(slices(tmp_path / "in", samples))
        np.testing.assert_array_equal(known.samples, samples)
        wanted = Geometry(volumes.SPACING, volumes.ORIGIN, volumes.turned(flipped=False), "LPS")
        np.testing.assert_allclose(known.geometry.matrix, wanted.matrix, atol=1e-5)
        assert (known.format, known.geometry.convention) == ("DICOM", "LPS")
        assert known.header == tuple(map(str, sorted((tmp_path / "in").iterdir())))

    def test_nothing_of_the_patient_gets_out(self, tmp_path):
        known = read(slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE)))
        for suffix in volumes.PLACED:
            write(tmp_path / f"out{suffix}", known.samples, known)
        data = b"".join(path.read_bytes() for path in tmp_path.glob("out.*"))
        data += gzip.decompress((tmp_path / "out.nii.gz").read_bytes())
        assert b"Doe" not in data
        assert b"Doe" in next((tmp_path / "in").iterdir()).read_bytes()

    def test_the_order_of_files_and_numbers_means_nothing(self, tmp_path):
        samples, direction = volumes.noise("i2", *volumes.SHAPE), volumes.turned(flipped=False)
        places = [direction[:, 2] * volumes.SPACING[2] * k + volumes.ORIGIN for k in range(4)]
        order = [2, 0, 3, 1]
        folder = slices(tmp_path / "in", samples[order], places=[places[k] for k in order])
        np.testing.assert_array_equal(read(folder).samples, samples)

    @pytest.mark.parametrize("name", ["1.2.3.4-2.dcm", "IM0", "IM.0001"])
    def test_one_slice_stands_for_its_series(self, tmp_path, name):
        samples = volumes.noise("i2", *volumes.SHAPE)
        folder = slices(tmp_path / "in", samples, names=["IM0", "IM.0001", "1.2.3.4-2.dcm", "x.dcm"])
        slices(tmp_path / "in", samples[:2], uid="1.2.3.5")
        assert is_volume(folder)
        assert is_volume(folder / name)
        np.testing.assert_array_equal(read(folder / name).samples, samples)

    def test_several_series(self, tmp_path):
        samples = volumes.noise("i2", *volumes.SHAPE)
        slices(tmp_path / "in", samples, uid="1.2.9", number=2, text="second")
        folder = slices(tmp_path / "in", samples[:3] + 1, uid="1.2.10", number=7, text="first")
        message = volumes.refused(read, folder)
        assert "1 is 1.2.9 second of 4 slices, 2 is 1.2.10 first of 3 slices" in message
        assert "series='1'" in message
        for name in ("1", "1.2.9"):
            np.testing.assert_array_equal(read(folder, series=name).samples, samples)
        for name in ("2", "1.2.10"):
            np.testing.assert_array_equal(read(folder, series=name).samples, samples[:3] + 1)
        assert "no series 3 (1 is" in volumes.refused(read, folder, series="3")
        kinds = [("1.2.9", "second", 4), ("1.2.10", "first", 3)]
        listed = [{"number": k, "uid": u, "description": d, "slices": n} for k, (u, d, n) in enumerate(kinds, 1)]
        assert info(folder) == {"format": "DICOM", "series": listed}
        assert info(folder, series="2")["shape"] == [6, 5, 3]

    def test_a_missing_slice(self, tmp_path):
        folder = slices(tmp_path / "in", volumes.noise("i2", 6, 5, 6))
        (folder / "1.2.3.4-3.dcm").unlink()
        message = volumes.refused(read, folder)
        assert "missing between 1.2.3.4-2.dcm and 1.2.3.4-4.dcm (4.6 mm, elsewhere 2.3 mm)" in message

    def test_one_slice_alone(self, tmp_path):
        folder = slices(tmp_path / "in", volumes.noise("i2", 1, 5, 6))
        path = next(folder.iterdir())
        # ITK may add a spacing between slices: make a field strength of it
        path.write_bytes(path.read_bytes().replace(b"\x18\0\x88\0\2", b"\x18\0\x87\0\2"))
        known = read(folder)
        assert known.samples.shape == (1, 5, 6)
        np.testing.assert_allclose(known.geometry.spacing, volumes.SPACING)

    def _places(self, steps, aside=(0, 0, 0)):
        normal = volumes.turned(flipped=False)[:, 2]
        return [normal * step + np.array(aside) * k + volumes.ORIGIN for k, step in enumerate(steps)]

    @pytest.mark.parametrize(
        ("steps", "told"),
        [((0, 2, 2, 4), "at the same place"), ((0, 2, 3.4, 5.4), "1.4 to 2 mm apart"), ((0, 0, 0, 0), "same place")],
    )
    def test_uneven_slices(self, tmp_path, steps, told):
        folder = slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE), places=self._places(steps))
        assert told in volumes.refused(read, folder)

    @pytest.mark.parametrize(
        ("steps", "count", "step"),
        [((0, 2, 6, 8), 5, 2.0), ((0, 2, 3.4, 5.4), 4, 1.8), ((0, 2, 2.9, 5, 7, 13.1), 8, 13.1 / 7), ((0, 2, 4), 3, 2)],
    )
    @pytest.mark.parametrize("aside", [(0, 0, 0), (0, 0.2, 0)])
    def test_uneven_slices_are_interpolated_where_that_is_accepted(self, tmp_path, steps, count, step, aside):
        samples = volumes.noise("i2", len(steps), 5, 6)
        normal = volumes.turned(flipped=False)[:, 2]
        places = [normal * s + np.array(aside) * s + volumes.ORIGIN for s in steps]
        folder = slices(tmp_path / "in", samples, places=places)
        even = len(steps) == 3
        with contextlib.nullcontext() if even else pytest.warns(VolumeWarning, match=f"linearly at {count} places"):
            known = read(folder, irregular="resample")
        assert known.samples.dtype == np.int16
        ends = np.linspace(0, steps[-1], count)
        wanted = [[np.interp(ends, steps, samples[:, y, x]) for x in range(6)] for y in range(5)]
        wanted = np.moveaxis(np.array(wanted), 2, 0)
        np.testing.assert_allclose(known.samples, wanted, atol=0.501)
        assert np.dot(known.geometry.matrix[:3, 2], normal) == pytest.approx(
            step * (1 + np.dot(aside, normal)), abs=1e-4
        )
        np.testing.assert_allclose(known.geometry.to_lps((0.0, 0.0, count - 1.0)), places[-1], atol=1e-3)
        assert known.regridded is not even
        assert even or "irregular='resample' interpolates between them" in volumes.refused(read, folder)

    def test_what_no_interpolation_mends_is_refused_as_before(self, tmp_path):
        folder = slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE), places=self._places((0, 2, 2, 4)))
        assert "same place" in volumes.refused(read, folder, irregular="resample")
        with pytest.raises(SuppleError, match="irregular must be"):
            read(folder, irregular="drop")

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
        folder = slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE), change=tags)
        if not tags:
            path = folder / "1.2.3.4-2.dcm"
            data = path.read_bytes()
            assert data.count(b"1.1\\.7") == 1
            path.write_bytes(data.replace(b"1.1\\.7", change))
        assert told in volumes.refused(read, folder)

    def test_slices_of_two_sizes(self, tmp_path):
        slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE))
        folder = slices(tmp_path / "in", volumes.noise("i2", 1, 7, 6), names=["z.dcm"], places=self._places([9.2]))
        assert "several sizes" in volumes.refused(read, folder)

    @pytest.mark.parametrize("k", [0, 2, 3])
    @pytest.mark.parametrize("count", [0, 300, -30])
    def test_a_damaged_slice(self, tmp_path, k, count):
        folder = slices(tmp_path / "in", volumes.noise("i2", *volumes.SHAPE))
        path = folder / f"1.2.3.4-{k}.dcm"
        path.write_bytes(path.read_bytes()[:count])
        assert path.name in volumes.refused(read, folder)

    def test_slices_of_two_types(self, tmp_path):
        samples = volumes.noise("i2", *volumes.SHAPE)
        folder = slices(tmp_path / "in", samples[:2])
        places = self._places([4.6, 6.9])
        slices(folder, samples[2:].astype("i4") * 2**14, names=["y.dcm", "z.dcm"], places=places)
        known = read(folder)
        np.testing.assert_array_equal(known.samples[2:], samples[2:].astype("i4") * 2**14)
        np.testing.assert_array_equal(known.samples[:2], samples[:2])

    def test_what_lies_beside_a_named_slice(self, tmp_path):
        samples = volumes.noise("i2", *volumes.SHAPE)
        folder = slices(tmp_path / "in", samples)
        (folder / "odd.dcm").write_bytes(b"not DICOM at all")
        assert "odd.dcm" in volumes.refused(read, folder)
        with pytest.warns(VolumeWarning, match=r"odd\.dcm \(not readable\) in"):
            np.testing.assert_array_equal(read(folder / "1.2.3.4-0.dcm").samples, samples)

    def test_files_without_a_picture_are_named(self, tmp_path):
        no_image(tmp_path / "rs.dcm", "481.3", "RTSTRUCT")
        assert "DICOM without a picture (RTSTRUCT): supple points moves its contours" in volumes.refused(
            read, tmp_path / "rs.dcm"
        )
        no_image(tmp_path / "sr.dcm", "88.11", "SR")
        assert "DICOM without a picture (SR)" in volumes.refused(read, tmp_path / "sr.dcm")

    def test_standard_error_is_given_back(self, tmp_path, capfd):
        (tmp_path / "in.mha").write_text("hello")
        volumes.refused(read, tmp_path / "in.mha")
        os.write(2, b"still here")
        assert capfd.readouterr().err == "still here"
