"""Contours of structure sets, made and read by pydicom."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pydicom
import pytest

from supple import Deformation, SuppleError
from supple.errors import VolumeWarning
from supple.files.landmarks import move_points, warn_of_frame
from supple.media.meshes import PointFile
from supple.media.points import read_points, write_points
from supple.media.volume import read, write
from tests import refusals
from tests.media.meshes.contours import circle, contour, contours, points_of, structures
from tests.media.volume.test_dicom import slices
from tests.media.volume.test_frames import DIRECTION, PLACES, enhanced
from tests.media.volume.volumes import SHAPE, item, noise, volume


def opened(path: Path) -> PointFile:
    return read_points(path, mesh=True)


@pytest.mark.parametrize("explicit", [True, False])
def test_points_are_in_lps_and_in_order(tmp_path: Path, explicit: bool) -> None:
    read = opened(structures(tmp_path / "rs.dcm", explicit=explicit))
    assert (read.convention, read.told, read.kind) == ("LPS", "said", "RTSTRUCT")
    wanted = [circle(0), circle(2.5), [[1.5, 2.25, 3.125]], circle(5)[:5]]
    np.testing.assert_array_equal(read.points, np.concatenate(wanted))


def test_within_their_planes_contours_stay_planar(tmp_path: Path) -> None:
    source = structures(tmp_path / "rs.dcm")
    read = opened(source)
    x, y, z = read.points.T
    moved = np.stack([x + np.where(z < 1, 0, y / 7), y, z], axis=-1)  # the first contour stays
    with warnings.catch_warnings(action="error"):
        write_points(tmp_path / "out.dcm", moved, read)
    before, after = contours(source), contours(tmp_path / "out.dcm")
    np.testing.assert_allclose(np.concatenate([points_of(c) for c in after]), moved, rtol=0, atol=1e-9)
    assert [c.ContourGeometricType for c in after] == ["CLOSED_PLANAR", "CLOSED_PLANAR", "POINT", "OPEN_PLANAR"]
    assert before[0] == after[0]
    assert ["ContourImageSequence" in c for c in after] == [True, False, False, False]


def test_out_of_their_planes_closed_contours_stay_closed(tmp_path: Path) -> None:
    read = opened(structures(tmp_path / "rs.dcm"))
    x, y, z = read.points.T
    moved = np.stack([x, y, z + x * y / 100], axis=-1)
    with pytest.warns(
        VolumeWarning, match=r"^3 of 4 contours of .*rs.dcm leave their planes, by up to 3 mm: closed ones stay"
    ):
        write_points(tmp_path / "out.dcm", moved, read)
    after = contours(tmp_path / "out.dcm")
    assert [c.ContourGeometricType for c in after] == ["CLOSED_PLANAR", "CLOSED_PLANAR", "POINT", "OPEN_NONPLANAR"]
    assert [c.NumberOfContourPoints for c in after] == [24, 24, 1, 5]
    np.testing.assert_allclose(np.concatenate([points_of(c) for c in after]), moved, rtol=0, atol=1e-9)


def test_it_is_a_structure_set_of_its_own(tmp_path: Path) -> None:
    source = structures(tmp_path / "rs.dcm")
    read = opened(source)
    write_points(tmp_path / "out.dcm", read.points + 1, read)
    before, after = pydicom.dcmread(source), pydicom.dcmread(tmp_path / "out.dcm")
    same = ["PatientName", "PatientID", "StudyInstanceUID", "FrameOfReferenceUID", "Modality", "StructureSetLabel"]
    assert [after[name].value for name in same] == [before[name].value for name in same]
    for name in ("SOPInstanceUID", "SeriesInstanceUID"):
        assert after[name].value != before[name].value
    assert after.file_meta.MediaStorageSOPInstanceUID == after.SOPInstanceUID
    assert after.PredecessorStructureSetSequence[0].ReferencedSOPInstanceUID == before.SOPInstanceUID
    assert (after.SeriesNumber, after.SeriesDescription) == (1003, "plan, bent, NOT FOR DIAGNOSIS")
    assert after.StructureSetDescription.endswith("NOT FOR DIAGNOSIS")
    assert after.ApprovalStatus == "UNAPPROVED"
    assert "ReviewerName" not in after
    assert [region.ROIName for region in after.StructureSetROISequence] == ["liver", "marks"]
    assert "ROIVolume" not in after.StructureSetROISequence[0]
    assert list(after.ROIContourSequence[0].ROIDisplayColor) == [255, 0, 128]
    assert "RTReferencedStudySequence" not in after.ReferencedFrameOfReferenceSequence[0]
    assert (0x3007, 0x1001) not in after


def test_what_does_not_move_keeps_every_byte(tmp_path: Path) -> None:
    source = structures(tmp_path / "rs.dcm")
    read = opened(source)
    write_points(tmp_path / "out.dcm", read.points, read)
    assert (tmp_path / "out.dcm").read_bytes() == source.read_bytes()


def test_contours_of_many_points(tmp_path: Path) -> None:
    """Numbers of 16 letters are too long for an explicit VR, whose values have at most 65,534 bytes."""
    read = opened(structures(tmp_path / "rs.dcm", count=1500))
    write_points(tmp_path / "out.dcm", read.points / 3, read)
    after = pydicom.dcmread(tmp_path / "out.dcm")
    assert after.file_meta.TransferSyntaxUID.is_implicit_VR
    np.testing.assert_allclose(opened(tmp_path / "out.dcm").points, read.points / 3, rtol=0, atol=1e-9)


def test_a_transfer_syntax_that_is_none(tmp_path: Path) -> None:
    data = structures(tmp_path / "rs.dcm").read_bytes()
    (tmp_path / "odd.dcm").write_bytes(data.replace(b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.1\0\0\0", 1))
    read = opened(tmp_path / "odd.dcm")
    with pytest.raises(SuppleError, match=r"cannot write the contours of .*odd.dcm: pydicom refuses \("):
        write_points(tmp_path / "out.dcm", read.points + 1, read)
    assert not (tmp_path / "out.dcm").exists()


def test_what_is_none(tmp_path: Path) -> None:
    source = structures(tmp_path / "rs.dcm")
    whole = source.read_bytes()

    def refused(name: str, data: bytes) -> str:
        (tmp_path / name).write_bytes(data)
        return refusals.refused(opened, tmp_path / name).removeprefix(f"cannot read {tmp_path / name}: ")

    assert refused("text.dcm", b"no DICOM").startswith("it is no whole DICOM file (")
    assert refused("ct.dcm", whole.replace(b"1.1.481.3", b"1.1.481.2")).startswith("it is no structure set of contours")
    odd = pydicom.dcmread(source)
    odd.ROIContourSequence[0].ContourSequence[1].ContourData = ["1", "2", "3", "4"]
    odd.save_as(tmp_path / "odd.dcm")
    assert refused("odd.dcm", (tmp_path / "odd.dcm").read_bytes()) == "contour 2 has 4 numbers: a point has three"
    del odd.ROIContourSequence
    odd.save_as(tmp_path / "none.dcm")
    assert refused("none.dcm", (tmp_path / "none.dcm").read_bytes()) == "it holds no vertices: give a mesh"
    for part in (0.3, 0.6, 0.9):
        refused("cut.dcm", whole[: int(part * len(whole))])


@pytest.mark.parametrize("many", [False, True])
def test_it_refers_to_another_series(tmp_path: Path, many: bool) -> None:
    if many:
        series = enhanced(tmp_path / "ct.dcm", places=PLACES[[2, 0, 3, 1]])
        heads = [pydicom.dcmread(series)]
        places = PLACES[[2, 0, 3, 1]]
    else:
        series = slices(tmp_path / "ct", noise("i2", *SHAPE))
        for path in series.iterdir():
            head = pydicom.dcmread(path)
            head.FrameOfReferenceUID = "1.2.826.4"
            head.save_as(path)
        heads = [pydicom.dcmread(path) for path in sorted(series.iterdir())]
        places = np.array([head.ImagePositionPatient for head in heads], np.float64)
    centre, normal = PLACES.mean(axis=0), np.cross(*DIRECTION.T[:2])
    source = structures(tmp_path / "rs.dcm", only=circle(0, 9) * 0.1 + PLACES[2] + 0.4 * normal)
    known = pydicom.dcmread(source)
    known.ROIContourSequence.append(item(ReferencedROINumber=2, ContourSequence=[contour(circle(0) + 999)]))
    known.save_as(source)
    assert np.abs((places - centre) @ normal).max() < 5  # the slices are stacked along it
    with warnings.catch_warnings(action="ignore"):
        # points are outside, and the enhanced file has another frame of reference
        move_points(source, tmp_path / "out.dcm", Deformation((4, 5, 6)), read(series).geometry, refer_to=series)
    made = pydicom.dcmread(tmp_path / "out.dcm")
    assert made.SOPInstanceUID != known.SOPInstanceUID  # also if nothing has moved
    assert made.StudyInstanceUID == heads[0].StudyInstanceUID
    (where,) = made.ReferencedFrameOfReferenceSequence
    frames = {made.FrameOfReferenceUID, where.FrameOfReferenceUID, heads[0].FrameOfReferenceUID}
    assert len(frames | {one.ReferencedFrameOfReferenceUID for one in made.StructureSetROISequence}) == 1
    (study,) = where.RTReferencedStudySequence
    (referred,) = study.RTReferencedSeriesSequence
    assert study.ReferencedSOPInstanceUID == heads[0].StudyInstanceUID
    assert referred.SeriesInstanceUID == heads[0].SeriesInstanceUID
    assert {one.ReferencedSOPInstanceUID for one in referred.ContourImageSequence} == {h.SOPInstanceUID for h in heads}
    assert all(one.ReferencedSOPClassUID == heads[0].SOPClassUID for one in referred.ContourImageSequence)
    near, far = contours(tmp_path / "out.dcm")
    k = int(np.abs((points_of(near).mean(axis=0) - places) @ normal).argmin())
    (one,) = near.ContourImageSequence
    assert one.ReferencedSOPInstanceUID == heads[0 if many else k].SOPInstanceUID
    assert one.get("ReferencedFrameNumber") == (k + 1 if many else None)
    assert "ContourImageSequence" not in far


def test_what_contours_do_not_refer_to(tmp_path: Path) -> None:
    source, image = structures(tmp_path / "rs.dcm"), tmp_path / "in.nrrd"
    write(image, noise("u1", *SHAPE), volume(noise("u1", *SHAPE)))
    flat, place = Deformation((4, 5, 6)), read(image).geometry
    with pytest.raises(SuppleError, match=r"must be a series of DICOM, and .*in.nrrd is NRRD"):
        move_points(source, tmp_path / "out.dcm", flat, place, refer_to=image)
    with pytest.raises(SuppleError, match=r"for structure sets of DICOM, and .*a.csv is none"):
        move_points(tmp_path / "a.csv", tmp_path / "b.csv", flat, place, refer_to=image)
    assert not (tmp_path / "out.dcm").exists()


def test_another_frame_of_reference_is_told(tmp_path: Path) -> None:
    folder = slices(tmp_path / "ct", noise("i2", *SHAPE))
    for path in folder.iterdir():
        head = pydicom.dcmread(path)
        head.FrameOfReferenceUID = "1.2.826.4"
        head.save_as(path)
    known = structures(tmp_path / "rs.dcm")
    warn_of_frame(known, read(folder))  # which is the same: nothing is told
    head = pydicom.dcmread(known)
    head.FrameOfReferenceUID = head.ReferencedFrameOfReferenceSequence[0].FrameOfReferenceUID = "1.2.826.9"
    head.save_as(known)
    with pytest.warns(VolumeWarning, match=r"another frame of reference \(1\.2\.826\.9\) than .* \(1\.2\.826\.4\)"):
        warn_of_frame(known, read(folder))
