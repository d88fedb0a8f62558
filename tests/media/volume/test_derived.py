"""Derived series of DICOM slices, read back by pydicom, ITK and Supple."""

import itertools
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.cli import command
from supple.cli.describe import describe
from supple.errors import SuppleError, VolumeWarning
from supple.fields import Placed
from supple.files.options import GridOptions
from supple.media.volume import read, write
from supple.space.affine import Affine
from supple.strokes import Recipe, Stroke
from tests.media.volume.test_dicom import slices
from tests.media.volume.volumes import SHAPE, SPACING, noise, refused, turned

pytestmark = pytest.mark.filterwarnings("ignore:.* moves nothing")

STILL = Recipe(strokes=(Stroke.grab((2, 2, 2), by=(0, 0, 0), radius=3),))
BENT = Recipe(strokes=(Stroke.grab((3, 2, 2), by=(0.5, 0.3, 0.2), radius=3, reach=9),), border=None)


def source(folder, samples, edit=lambda head, k: None, **options):
    """Write a series, whose slices pydicom edits."""
    slices(folder, samples, **options)
    for k, path in enumerate(sorted(folder.iterdir())):
        head = pydicom.dcmread(path)
        edit(head, k)
        head.save_as(path)
    return folder


def heads_of(folder):
    """The slices of a folder, as 3D Slicer sorts them: along the normal of the first."""
    heads = [pydicom.dcmread(path) for path in folder.iterdir()]
    a, b = np.reshape(heads[0].ImageOrientationPatient, (2, 3)).astype(float)
    return sorted(heads, key=lambda head: float(np.cross(a, b) @ np.array(head.ImagePositionPatient, float)))


def by_itk(folder):
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    return reader.Execute()


def test_what_tells_of_the_stored_pixels_follows_them(tmp_path: Path) -> None:
    mapping = pydicom.Dataset()
    mapping.RealWorldValueSlope, mapping.RealWorldValueIntercept = 3.0, 0.0

    def edit(slopes):
        def change(head, k):
            head.RescaleSlope, head.RescaleIntercept = slopes[k], "0"
            head.RealWorldValueMappingSequence = [mapping]
            head.add_new("LargestImagePixelValueInPlane", "SS", 7)

        return change

    for name, slopes, kept in (("alike", ["2"] * 4, True), ("each", ["1", "2", "3", "4"], False)):
        folder = source(tmp_path / name, noise("i2", *SHAPE) % 300, edit(slopes))
        supple.warp_file(folder, tmp_path / f"{name}-out", BENT)
        for head in heads_of(tmp_path / f"{name}-out"):
            assert ("RealWorldValueMappingSequence" in head) == kept
            assert "LargestImagePixelValueInPlane" not in head


@pytest.mark.parametrize("fill", [-1024, -3000, 501])
def test_a_fill_is_a_true_value(tmp_path: Path, fill: int) -> None:
    def edit(head, k):
        head.RescaleSlope, head.RescaleIntercept = "1", "-1024"

    folder = source(tmp_path / "in", noise("u2", *SHAPE) % 3000, edit)
    away = Placed(Affine(np.c_[np.eye(3), read(folder).geometry.direction[:, 0] * 3 * SPACING[0]]))
    for name in ("out", "out.nii.gz", "out.nrrd"):
        supple.warp_file(
            folder, tmp_path / name, Recipe(strokes=()), maps=[away], outside="constant", fill=fill, filter="nearest"
        )
        np.testing.assert_array_equal(read(tmp_path / name).rescaled()[..., 3:], fill)


def test_a_series_is_derived(tmp_path: Path) -> None:
    def edit(head, k):
        head.RescaleIntercept, head.FrameOfReferenceUID, head.StudyInstanceUID = "-1024", "1.2.8", "1.2.3.9"
        head.add_new(0x00091010, "LO", "private")
        head.add_new(0x60000010, "US", 5)
        head.SliceLocation = "0"
        head.add_new("SmallestImagePixelValue", "SS", 7)

    folder = source(tmp_path / "in", noise("i2", *SHAPE) % 3000, edit)
    before = read(folder)
    for name in ("out", "out.nrrd"):
        supple.warp_file(folder, tmp_path / name, BENT)
    after = read(tmp_path / "out")
    assert after.samples.dtype == before.samples.dtype == np.int16
    np.testing.assert_array_equal(after.samples, read(tmp_path / "out.nrrd").samples)
    assert (after.samples != before.samples).any()
    np.testing.assert_allclose(after.geometry.matrix, before.geometry.matrix, atol=1e-9)
    # ITK, and 3D Slicer's rules.
    image, old = by_itk(tmp_path / "out"), by_itk(folder)
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), after.samples)
    for name in ("GetOrigin", "GetSpacing", "GetDirection"):
        np.testing.assert_allclose(getattr(image, name)(), getattr(old, name)(), atol=1e-6)
    heads, sources = heads_of(tmp_path / "out"), heads_of(folder)
    places = np.array([head.ImagePositionPatient for head in heads], float)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), SPACING[2], atol=1e-6)
    assert len({str(head.ImageOrientationPatient) for head in heads}) == 1
    # Who it is of, and what it is.
    for name in ("PatientName", "StudyInstanceUID", "FrameOfReferenceUID", "Modality", "RescaleIntercept"):
        assert {getattr(head, name) for head in heads} == {getattr(sources[0], name)}, name
    own = [head.SOPInstanceUID for head in heads]
    assert len({*own, *(head.SOPInstanceUID for head in sources)}) == 2 * len(own)
    assert all(head.file_meta.MediaStorageSOPInstanceUID == head.SOPInstanceUID for head in heads)
    (series,) = {head.SeriesInstanceUID for head in heads}
    assert series != sources[0].SeriesInstanceUID
    for k, (head, known) in enumerate(zip(heads, sources, strict=True)):
        assert head.InstanceNumber == k + 1
        assert head.ImageType == ["DERIVED", "SECONDARY", "AXIAL"]
        assert head.SourceImageSequence[0].ReferencedSOPInstanceUID == known.SOPInstanceUID
        for name in ("DerivationDescription", "SeriesDescription", "ImageComments"):
            assert "NOT FOR DIAGNOSIS" in str(head[name].value)
        assert not [e for e in head if e.tag.is_private or e.tag.group == 0x6000]
        assert "SmallestImagePixelValue" not in head
        normal = np.cross(*np.reshape(head.ImageOrientationPatient, (2, 3)).astype(float))
        assert float(head.SliceLocation) == pytest.approx(float(normal @ np.array(head.ImagePositionPatient, float)))


def test_slopes_of_their_own(tmp_path: Path) -> None:
    def edit(head, k):
        head.RescaleSlope, head.Modality = f"{0.3 + 0.1 * k:.3g}", "PT"

    folder = source(tmp_path / "in", noise("i2", *SHAPE), edit)
    before = read(folder)
    assert before.samples.dtype.kind == "f"
    write(tmp_path / "out", before.samples, before)
    after = read(tmp_path / "out").samples
    for k, head in enumerate(heads_of(tmp_path / "out")):
        assert head.RescaleIntercept == 0
        assert np.abs(after[k] - before.samples[k]).max() <= 0.51 * float(head.RescaleSlope)


@pytest.mark.parametrize(("dtype", "low"), [("u1", 0), ("u2", 0), ("i2", -900)])
def test_values_that_do_not_fit_get_more_bits(tmp_path: Path, dtype: str, low: int) -> None:
    folder = source(tmp_path / "in", noise(dtype, *SHAPE))
    before = read(folder)
    samples = before.samples.astype("i4")
    write(tmp_path / "same", samples, before)
    np.testing.assert_array_equal(read(tmp_path / "same").samples, samples)
    assert heads_of(tmp_path / "same")[0].BitsAllocated == (8 if dtype == "u1" else 16)
    samples[1, 2, 3], samples[1, 2, 4] = -1000, 40000
    write(tmp_path / "out", samples, before)
    np.testing.assert_array_equal(read(tmp_path / "out").samples, samples)


@pytest.mark.parametrize(
    ("dtype", "padding", "slopes", "wanted"),
    [
        ("u2", 7, (1, 1), ("SS", 7)),  # values below 0 are written, so that pixels get a sign
        ("u2", 65535, (1, 1), None),
        ("u2", 7, (1, 2), None),  # each slice gets a slope of its own
        ("i2", -2000, (1, 1), ("SS", -2000)),
    ],
)
def test_padding_has_the_type_of_pixels(tmp_path: Path, dtype, padding, slopes, wanted) -> None:
    def edit(head, k):
        head.add_new("PixelPaddingValue", "SS" if dtype == "i2" else "US", padding)
        head.RescaleSlope, head.RescaleIntercept = str(slopes[k % 2]), "0"

    before = read(source(tmp_path / "in", noise(dtype, *SHAPE) % 3000, edit))
    samples = before.samples.astype("f4" if before.samples.dtype.kind == "f" else "i4")
    samples[:, 2, 3] = -100
    write(tmp_path / "out", samples, before)
    for head in heads_of(tmp_path / "out"):
        assert head.PixelRepresentation == 1
        found = head.get_item("PixelPaddingValue") and head["PixelPaddingValue"]
        assert (found and (found.VR, found.value)) == wanted


@pytest.mark.parametrize(("known", "wanted"), [(7, 1007), (2**31 - 2, 2**31 - 1002), (-(2**31), -(2**31) + 1000)])
def test_numbers_of_series_stay_in_their_range(tmp_path: Path, known: int, wanted: int) -> None:
    before = read(source(tmp_path / "in", noise("i2", *SHAPE), lambda head, k: setattr(head, "SeriesNumber", known)))
    write(tmp_path / "out", before.samples, before)
    assert {head.SeriesNumber for head in heads_of(tmp_path / "out")} == {wanted}


def test_colours(tmp_path: Path) -> None:
    def edit(head, k):
        head.SamplesPerPixel, head.PhotometricInterpretation, head.PlanarConfiguration = 3, "RGB", 0
        head.BitsAllocated = head.BitsStored = 8
        head.HighBit, head.PixelRepresentation = 7, 0
        del head.RescaleSlope, head.RescaleIntercept
        head.PixelData = colours[k].tobytes()
        head["PixelData"].VR = "OB"

    colours = noise("u1", *SHAPE, 3)
    folder = source(tmp_path / "in", noise("i2", *SHAPE), edit)
    np.testing.assert_array_equal(read(folder).samples, colours)
    supple.warp_file(folder, tmp_path / "out", STILL)
    np.testing.assert_array_equal(read(tmp_path / "out").samples, colours)


def test_values_that_are_inverted_when_read(tmp_path: Path) -> None:
    def edit(head, k):
        head.PhotometricInterpretation, head.WindowCenter, head.WindowWidth = "MONOCHROME1", "40", "400"

    folder = source(tmp_path / "in", noise("u2", *SHAPE), edit)
    before = read(folder)
    write(tmp_path / "out", before.samples, before)
    np.testing.assert_array_equal(read(tmp_path / "out").samples, before.samples)
    assert "WindowCenter" not in heads_of(tmp_path / "out")[0]


SAMPLES = Path(pydicom.__file__).parent / "data" / "test_files"


@pytest.mark.parametrize(
    "name", ["CT_small", "MR_small_RLE", "ExplVR_BigEnd", "JPEG2000", "SC_rgb_jpeg_gdcm", "examples_palette"]
)
def test_files_of_scanners(tmp_path: Path, name: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.dcm").write_bytes((SAMPLES / f"{name}.dcm").read_bytes())
    before = read(tmp_path / "in")
    write(tmp_path / "out", before.samples, before)
    after = read(tmp_path / "out")
    np.testing.assert_array_equal(after.samples, before.samples)
    np.testing.assert_allclose(after.geometry.matrix, before.geometry.matrix)


def test_a_dose_is_in_gray(tmp_path: Path) -> None:
    path = SAMPLES / "rtdose.dcm"
    known, head = read(path), pydicom.dcmread(path)
    np.testing.assert_allclose(known.rescaled(), head.pixel_array * float(head.DoseGridScaling), rtol=1e-12)
    still = Recipe(strokes=(Stroke.grab((2, 2, 2), by=(0, 0, 0), radius=6),))
    for name in ("out.nrrd", "out.nii.gz"):
        supple.warp_file(path, tmp_path / name, still)
        np.testing.assert_allclose(read(tmp_path / name).rescaled(), known.rescaled(), rtol=1e-6)
    for unit, told in (("GY", "Gy"), ("RELATIVE", "")):
        head.DoseUnits = unit
        head.save_as(tmp_path / "dose.dcm")
        facts, text = describe(str(tmp_path / "dose.dcm"), {})
        assert facts["unit"] == told
        span = f"{known.rescaled().min():.6g} to {known.rescaled().max():.6g} {told}".rstrip()
        assert f"  range       {span}\n" in text


def test_a_radius_below_a_voxel_is_told(tmp_path: Path) -> None:
    before = source(tmp_path / "in", noise("i2", *SHAPE))
    thin = Recipe(strokes=(Stroke.grab((2, 2, 2), by=(0, 0, 0), radius=0.9 * min(SPACING)),))
    with pytest.warns(VolumeWarning, match=r"is 0\.9 times the distance between samples of .*: lengths are in mm"):
        supple.warp_file(before, tmp_path / "out", thin)


def test_another_grid(tmp_path: Path) -> None:
    folder = source(tmp_path / "in", noise("i2", *SHAPE))
    supple.warp_file(folder, tmp_path / "out", STILL, grid=GridOptions(resample=(0.7, 1.1, 1.15)))
    supple.warp_file(folder, tmp_path / "out.nii", STILL, grid=GridOptions(resample=(0.7, 1.1, 1.15)))
    made, known = read(tmp_path / "out"), read(tmp_path / "out.nii")
    assert len(made.samples) > SHAPE[0]
    np.testing.assert_array_equal(made.samples, known.samples)
    np.testing.assert_allclose(made.geometry.matrix, known.geometry.matrix, atol=1e-4)
    assert float(heads_of(tmp_path / "out")[0].SliceThickness) == pytest.approx(1.15)


def test_bits_of_a_segmentation(tmp_path: Path) -> None:
    (tmp_path / "seg.dcm").write_bytes((SAMPLES / "liver_1frame.dcm").read_bytes())
    assert set(np.unique(read(tmp_path / "seg.dcm").samples)) == {0, 1}


class TestRefused:
    def test_a_folder_within_the_source(self, tmp_path: Path) -> None:
        folder = source(tmp_path / "in", noise("i2", *SHAPE))
        for name in ("out", "out.nrrd"):
            with pytest.raises(SuppleError, match=r"is within .*, and would be read with it: write elsewhere"):
                supple.warp_file(folder, folder / name, STILL)
        assert len(list(folder.iterdir())) == SHAPE[0]

    def test_folders_that_hold_something(self, tmp_path: Path) -> None:
        folder = source(tmp_path / "in", noise("i2", *SHAPE))
        before = {path: path.read_bytes() for path in folder.iterdir()}
        for force, named in itertools.product((False, True), (folder, next(iter(before)))):
            with pytest.raises(SuppleError, match="is not empty, and a series gets a folder of its own"):
                supple.warp_file(named, folder, STILL, force=force)
        assert before == {path: path.read_bytes() for path in folder.iterdir()}
        (tmp_path / "empty").mkdir()
        supple.warp_file(folder, tmp_path / "empty", STILL)
        assert len(list((tmp_path / "empty").iterdir())) == SHAPE[0]

    def test_a_field_among_the_slices(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        folder, made = source(tmp_path / "in", noise("i2", *SHAPE)), tmp_path / "out"
        made.mkdir()
        monkeypatch.setattr("supple.files.volumes.open_volume", lambda *_: pytest.fail("it was read"))
        with pytest.raises(SuppleError, match=r"is within .*, a folder that is for slices alone: write the field else"):
            supple.warp_file(folder, made, BENT, save_field=made / "field.h5")

    def test_other_sources(self, tmp_path: Path) -> None:
        folder = source(tmp_path / "in", noise("i2", *SHAPE))
        known = read(folder)
        write(tmp_path / "in.nii", known.samples, known)
        with pytest.raises(SuppleError, match="a name without suffix is no format that volumes are written in"):
            supple.warp_file(tmp_path / "in.nii", tmp_path / "out", STILL)
        sitk.WriteImage(sitk.GetImageFromArray(known.samples.astype("u2")), str(tmp_path / "many.dcm"))
        with pytest.raises(SuppleError, match="is one DICOM file of many frames, and so is"):
            supple.warp_file(tmp_path / "many.dcm", tmp_path / "out", STILL)
        with pytest.raises(SuppleError, match="give a folder for slices, which is a name without suffix"):
            supple.warp_file(folder, tmp_path / "out.dcm", STILL)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "in.nii", "many.dcm"]

    def test_nothing_is_left_of_a_series_that_fails(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        folder = source(tmp_path / "in", noise("i2", *SHAPE))
        known, kept, save = read(folder), [], pydicom.Dataset.save_as

        def full(self, path, **options):
            if len(kept) == 2:
                raise OSError(28, "No space left on device")
            kept.append(path)
            save(self, path, **options)

        monkeypatch.setattr(pydicom.Dataset, "save_as", full)
        assert "No space left" in refused(write, tmp_path / "out", known.samples, known)
        assert len(kept) == 2
        assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]

    def test_what_pydicom_cannot_write(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        folder = source(tmp_path / "in", noise("i2", *SHAPE))
        known = read(folder)

        def broken(self, path, **options):
            raise TypeError("With tag (0028,0106) got exception: a bytes-like object is required\nTraceback …")

        monkeypatch.setattr(pydicom.Dataset, "save_as", broken)
        message = refused(write, tmp_path / "out", known.samples, known)
        assert "it cannot be written by pydicom (With tag (0028,0106) got exception" in message
        assert not (tmp_path / "out").exists()


def test_a_derived_series_says_that_slices_were_interpolated(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    normal = turned(flipped=False)[:, 2]
    places = [normal * step for step in (0.0, 2.0, 6.0, 8.0)]
    folder = slices(tmp_path / "in", noise("i2", *SHAPE), places=places)
    line = ["warp", str(folder), str(tmp_path / "out"), "--grab", "3,2,2:3.5,2,2", "--radius", "4"]
    assert command(line) == 2
    assert "--irregular resample interpolates between them" in capfd.readouterr().err
    assert command([*line, "--irregular", "resample"]) == 0
    assert "4 slices, 2 to 4 mm apart, are interpolated linearly at 5 places, 2 mm apart" in capfd.readouterr().err
    heads = heads_of(tmp_path / "out")
    assert len(heads) == 5
    for k, head in enumerate(heads):
        assert head.DerivationDescription.startswith(
            "Of a source whose 4 slices, 2 to 4 mm apart, are interpolated linearly at 5 places, 2 mm apart. Bent by"
        )
        assert len(head.DerivationDescription) <= 1024
        np.testing.assert_allclose(np.array(head.ImagePositionPatient, float), normal * 2 * k, atol=1e-4)
        assert float(head.SliceThickness) == pytest.approx(2)
    assert command(["info", str(tmp_path / "out")]) == 0
    assert command(["info", str(folder), "--irregular", "resample"]) == 0
    assert "bent" not in capfd.readouterr().err
    assert read(tmp_path / "out").samples.shape == (5, *SHAPE[1:])
