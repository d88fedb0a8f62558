"""DICOM files of many frames, read, and written as derived ones, made and read back by pydicom and ITK."""

from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813
from pydicom.uid import generate_uid

import supple
from supple.errors import SuppleError
from supple.files.options import GridOptions
from supple.media.volume import read, write
from supple.media.volume.frames import quiet
from supple.strokes import Recipe, Stroke
from tests.media.volume.test_derived import SAMPLES, STILL
from tests.media.volume.volumes import ORIGIN, SHAPE, SPACING, item, noise, refused, save, turned

pytestmark = pytest.mark.filterwarnings("ignore:.* moves nothing")

DIRECTION = turned(flipped=False)
PLACES = np.array(ORIGIN) + SPACING[2] * np.outer(np.arange(SHAPE[0]), DIRECTION[:, 2])
BENT = Recipe(strokes=(Stroke.grab((3, 2, 2), by=(0.5, 0.3, 0.2), radius=3, reach=9),), border=None)
VALUES = noise("i2", *SHAPE) % 3000


def enhanced(path, samples=VALUES, places=PLACES, edit=lambda head: None, kind="2.1"):
    """Write an enhanced CT, or MR with the kind 4.1."""
    head = item(
        SOPClassUID=f"1.2.840.10008.5.1.4.1.1.{kind}", SOPInstanceUID=generate_uid(), StudyInstanceUID="1.2.3",
        SeriesInstanceUID=generate_uid(), FrameOfReferenceUID="1.2.8", Modality="CT", PatientName="Doe^Jane",
        ImageType=["ORIGINAL", "PRIMARY", "VOLUME", "NONE"], Rows=samples.shape[1], Columns=samples.shape[2],
        NumberOfFrames=len(samples), SamplesPerPixel=1, PhotometricInterpretation="MONOCHROME2", BitsAllocated=16,
        BitsStored=16, HighBit=15, PixelRepresentation=1, PixelData=samples.tobytes(),
        DimensionIndexSequence=[
            item(DimensionIndexPointer=0x00209056, FunctionalGroupPointer=0x00209111),
            item(DimensionIndexPointer=0x00209057, FunctionalGroupPointer=0x00209111),
        ],
    )  # fmt: skip
    head["PixelData"].VR = "OW"
    pixels = item(PixelSpacing=[SPACING[1], SPACING[0]], SliceThickness=SPACING[2])
    turn = item(ImageOrientationPatient=[round(x, 12) for x in DIRECTION[:, :2].T.ravel()])
    values = item(RescaleSlope="2", RescaleIntercept="-1000", RescaleType="HU")
    head.SharedFunctionalGroupsSequence = [
        item(PlaneOrientationSequence=[turn], PixelMeasuresSequence=[pixels], PixelValueTransformationSequence=[values])
    ]
    head.PerFrameFunctionalGroupsSequence = [
        item(
            PlanePositionSequence=[item(ImagePositionPatient=[round(x, 9) for x in place])],
            FrameContentSequence=[item(StackID="1", InStackPositionNumber=k + 1, DimensionIndexValues=[1, k + 1])],
            CTImageFrameTypeSequence=[item(FrameType=["ORIGINAL", "PRIMARY", "VOLUME", "NONE"])],
        )
        for k, place in enumerate(np.asarray(places).tolist())
    ]
    edit(head)
    return save(path, head)


def places_in(head):
    return np.array([g.PlanePositionSequence[0].ImagePositionPatient for g in head.PerFrameFunctionalGroupsSequence])


def slopes(head):
    head.SharedFunctionalGroupsSequence[0].pop("PixelValueTransformationSequence")
    for k, group in enumerate(head.PerFrameFunctionalGroupsSequence):
        values = item(RescaleSlope=f"{0.3 + 0.1 * k:.3g}", RescaleIntercept=str(-k), RescaleType="US")
        group.PixelValueTransformationSequence = [values]


class TestRead:
    @pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (0, 2, 1, 3)])
    def test_frames_in_any_order(self, tmp_path: Path, order: tuple[int, ...]) -> None:
        turn = list(order)
        known = read(enhanced(tmp_path / "in.dcm", VALUES[turn], PLACES[turn]))
        np.testing.assert_array_equal(known.samples, 2 * VALUES - 1000)
        np.testing.assert_allclose(known.geometry.to_lps([[0, 0, k] for k in range(4)]), PLACES, atol=1e-6)
        np.testing.assert_allclose(known.geometry.spacing, SPACING, atol=1e-9)
        np.testing.assert_allclose(known.geometry.direction, DIRECTION, atol=1e-9)

    def test_what_is_no_stack_is_refused(self, tmp_path: Path) -> None:
        def flat(head):
            slopes(head)
            head.PerFrameFunctionalGroupsSequence[2].PixelValueTransformationSequence[0].RescaleSlope = "0"

        def thin(head):
            head.PerFrameFunctionalGroupsSequence[2].PixelMeasuresSequence = [item(PixelSpacing=[1, 1])]

        def lost(head):
            head.NumberOfFrames = 4
            head.PerFrameFunctionalGroupsSequence = list(head.PerFrameFunctionalGroupsSequence)[:3]

        def broken(head):
            head.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0].pop("ImagePositionPatient")

        gap = PLACES + np.outer([0, 0, 3, 3], DIRECTION[:, 2])
        aside = PLACES + np.outer([0, 1, 0, 1], DIRECTION[:, 1])
        for told, options in {
            "frame 2 and frame 3": {"places": gap},
            "offset sideways, and along no line: frame ": {"places": aside},
            "frame 1 and frame 3 lie at the same place": {"places": PLACES[[0, 1, 0, 1]]},
            "several spacings (frames 1 and 3)": {"edit": thin},
            "a rescale slope of its frames is 0": {"edit": flat},
            "4 frames, and tells where 3 of them lie": {"edit": lost},
            "what it says of its frames is damaged": {"edit": broken},
        }.items():
            message = refused(read, enhanced(tmp_path / "in.dcm", **options))
            assert told in message
            assert "in.dcm" in message

    def test_several_files_of_many_frames(self, tmp_path: Path) -> None:
        def alike(head):
            head.SeriesInstanceUID = "1.2.3.4"

        (tmp_path / "in").mkdir()
        enhanced(tmp_path / "in" / "a.dcm", edit=alike)
        np.testing.assert_array_equal(read(tmp_path / "in").samples, 2 * VALUES - 1000)
        enhanced(tmp_path / "in" / "b.dcm", edit=alike)
        assert "a.dcm is one of several files of many frames" in refused(read, tmp_path / "in")

    def test_offsets_of_a_dose_may_go_down(self, tmp_path: Path) -> None:
        head = pydicom.dcmread(SAMPLES / "rtdose.dcm")
        head.GridFrameOffsetVector = [-x for x in head.GridFrameOffsetVector]
        head.save_as(tmp_path / "down.dcm")
        known, up = read(tmp_path / "down.dcm"), read(SAMPLES / "rtdose.dcm")
        np.testing.assert_array_equal(known.samples, up.samples[::-1])
        np.testing.assert_allclose(known.geometry.to_lps((0, 0, 14)), up.geometry.to_lps((0, 0, 0)))


class TestDerived:
    @pytest.mark.parametrize(("order", "kind"), [((0, 1, 2, 3), "2.1"), ((3, 1, 2, 0), "4.1")])
    def test_an_enhanced_file(self, tmp_path: Path, order: tuple[int, ...], kind: str) -> None:
        turn = list(order)
        path = enhanced(tmp_path / "in.dcm", VALUES[turn], PLACES[turn], kind=kind)
        for name in ("out.dcm", "out.nrrd"):
            supple.warp_file(path, tmp_path / name, BENT)
        before, after = read(path), read(tmp_path / "out.dcm")
        # the stored values are steps of 2
        assert np.abs(after.samples.astype(int) - read(tmp_path / "out.nrrd").samples).max() <= 1
        assert (after.samples != before.samples).any()
        np.testing.assert_allclose(after.geometry.matrix, before.geometry.matrix, atol=1e-9)
        image = sitk.ReadImage(str(tmp_path / "out.dcm"))
        np.testing.assert_array_equal(sitk.GetArrayFromImage(image), after.samples)
        np.testing.assert_allclose(image.GetOrigin(), ORIGIN, atol=1e-6)
        np.testing.assert_allclose(image.GetSpacing(), SPACING, atol=1e-6)
        source, made = pydicom.dcmread(path), pydicom.dcmread(tmp_path / "out.dcm")
        np.testing.assert_array_equal(2 * made.pixel_array.astype(int) - 1000, after.samples)
        for name in ("PatientName", "StudyInstanceUID", "FrameOfReferenceUID", "Modality", "SOPClassUID"):
            assert made[name].value == source[name].value, name
        for name in ("SOPInstanceUID", "SeriesInstanceUID"):
            assert made[name].value != source[name].value, name
        assert made.file_meta.MediaStorageSOPInstanceUID == made.SOPInstanceUID
        for name in ("SeriesDescription", "DerivationDescription", "ImageComments"):
            assert "NOT FOR DIAGNOSIS" in made[name].value
        (derivation,) = made.SharedFunctionalGroupsSequence[0].DerivationImageSequence
        assert derivation.SourceImageSequence[0].ReferencedSOPInstanceUID == source.SOPInstanceUID
        np.testing.assert_allclose(places_in(made), PLACES, atol=1e-6)
        assert made.ImageType == ["DERIVED", "PRIMARY", "VOLUME", "NONE"]
        for k, group in enumerate(made.PerFrameFunctionalGroupsSequence):
            assert group.CTImageFrameTypeSequence[0].FrameType == made.ImageType
            assert group.FrameContentSequence[0].InStackPositionNumber == turn.index(k) + 1  # as in the source

    def test_another_grid(self, tmp_path: Path) -> None:
        path = enhanced(tmp_path / "in.dcm")
        for name in ("out.dcm", "out.nii"):
            supple.warp_file(path, tmp_path / name, STILL, grid=GridOptions(resample=(0.7, 1.1, 1.15)))
        made, known = read(tmp_path / "out.dcm"), read(tmp_path / "out.nii")
        assert len(made.samples) > SHAPE[0]
        assert np.abs(made.samples.astype(int) - known.samples).max() <= 1
        np.testing.assert_allclose(made.geometry.matrix, known.geometry.matrix, atol=1e-4)
        head = pydicom.dcmread(tmp_path / "out.dcm")
        contents = [group.FrameContentSequence[0] for group in head.PerFrameFunctionalGroupsSequence]
        assert [list(one.DimensionIndexValues) for one in contents] == [[1, k + 1] for k in range(len(made.samples))]
        assert head.NumberOfFrames == len(contents) == contents[-1].InStackPositionNumber
        (pixels,) = head.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence
        assert pixels.SliceThickness == pytest.approx(1.15)

    @pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 1, 2, 0)])
    def test_slopes_of_their_own(self, tmp_path: Path, order: tuple[int, ...]) -> None:
        turn = list(order)
        before = read(enhanced(tmp_path / "in.dcm", VALUES[turn], PLACES[turn], slopes))
        wanted = np.empty(SHAPE)
        for k, place in enumerate(order):
            wanted[place] = VALUES[place] * (0.3 + 0.1 * k) - k
        np.testing.assert_allclose(before.samples, wanted, atol=1e-3)
        write(tmp_path / "out.dcm", before.samples, before)
        head = pydicom.dcmread(tmp_path / "out.dcm")
        (values,) = head.SharedFunctionalGroupsSequence[0].PixelValueTransformationSequence
        assert not any("PixelValueTransformationSequence" in group for group in head.PerFrameFunctionalGroupsSequence)
        assert np.abs(read(tmp_path / "out.dcm").samples - wanted).max() <= 0.51 * float(values.RescaleSlope)

    def test_enhanced_slices_of_one_frame_each(self, tmp_path: Path) -> None:
        def alike(head):
            head.SeriesInstanceUID = "1.2.3.4"

        (tmp_path / "in").mkdir()
        for k in range(4):
            enhanced(tmp_path / "in" / f"{k}.dcm", VALUES[k : k + 1], PLACES[k : k + 1], alike)
        before = read(tmp_path / "in")
        np.testing.assert_array_equal(before.samples, 2 * VALUES - 1000)
        supple.warp_file(tmp_path / "in", tmp_path / "out", STILL)
        after = read(tmp_path / "out")
        np.testing.assert_array_equal(after.samples, before.samples)
        np.testing.assert_allclose(after.geometry.matrix, before.geometry.matrix, atol=1e-9)
        heads = [pydicom.dcmread(path) for path in sorted((tmp_path / "out").iterdir())]
        np.testing.assert_allclose(np.concatenate([places_in(head) for head in heads]), PLACES, atol=1e-6)

    @pytest.mark.parametrize("grid", [None, GridOptions(resample=(9.0, 9.0, 4.0))])
    def test_a_dose(self, tmp_path: Path, grid: GridOptions | None) -> None:
        recipe = Recipe(strokes=(Stroke.grab((5, 5, 7), by=(1, 1, 0.5), radius=20),))
        for name in ("out.dcm", "out.nrrd"):
            supple.warp_file(SAMPLES / "rtdose.dcm", tmp_path / name, recipe, grid=grid)
        made, known, source = read(tmp_path / "out.dcm"), read(tmp_path / "out.nrrd"), read(SAMPLES / "rtdose.dcm")
        with quiet():  # its UIDs are odd
            head, old = pydicom.dcmread(tmp_path / "out.dcm"), pydicom.dcmread(SAMPLES / "rtdose.dcm")
        np.testing.assert_allclose(made.rescaled(), known.rescaled(), rtol=1e-6)
        np.testing.assert_allclose(head.pixel_array * float(head.DoseGridScaling), known.rescaled(), rtol=1e-6)
        np.testing.assert_allclose(made.geometry.matrix, known.geometry.matrix, atol=1e-4)
        assert head.GridFrameOffsetVector[:2] == [0, made.geometry.spacing[2]]
        assert len(head.GridFrameOffsetVector) == head.NumberOfFrames == len(made.samples)
        assert head.DoseUnits == old.DoseUnits
        assert "NOT FOR DIAGNOSIS" in head.DoseComment
        assert (made.samples.shape == source.samples.shape) == (grid is None)

    def test_frames_without_a_place(self, tmp_path: Path) -> None:
        path = SAMPLES / "SC_rgb_rle_2frame.dcm"
        still = Recipe(strokes=(Stroke.grab((2, 2, 1), by=(0, 0, 0), radius=3),))
        supple.warp_file(path, tmp_path / "out.dcm", still)
        np.testing.assert_array_equal(read(tmp_path / "out.dcm").samples, read(path).samples)
        assert pydicom.dcmread(tmp_path / "out.dcm").ImageType[:2] == ["DERIVED", "SECONDARY"]
        with pytest.raises(SuppleError, match="does not tell where each frame lies"):
            supple.warp_file(path, tmp_path / "other.dcm", still, grid=GridOptions(resample=2.0))

    def test_nothing_is_lost(self, tmp_path: Path) -> None:
        path = enhanced(tmp_path / "in.dcm")
        before = path.read_bytes()
        with pytest.raises(SuppleError, match=r"in\.dcm"):
            supple.warp_file(path, path, STILL)
        assert path.read_bytes() == before
        with pytest.raises(SuppleError, match="is one DICOM file of many frames, and so is what is derived"):
            supple.warp_file(path, tmp_path / "out", STILL)
        (tmp_path / "out.dcm").write_bytes(b"mine")
        with pytest.raises(SuppleError, match="exists"):
            supple.warp_file(path, tmp_path / "out.dcm", STILL)
        assert (tmp_path / "out.dcm").read_bytes() == b"mine"
        supple.warp_file(path, tmp_path / "out.dcm", Recipe(), force=True)  # no copy, though nothing moves
        assert pydicom.dcmread(tmp_path / "out.dcm").SOPInstanceUID != pydicom.dcmread(path).SOPInstanceUID
        assert len(read(tmp_path / "out.dcm").samples) == SHAPE[0]
        known = read(path)
        path.unlink()
        assert "not readable any more" in refused(write, tmp_path / "new.dcm", known.samples, known)
        assert sorted(each.name for each in tmp_path.iterdir()) == ["out.dcm"]
