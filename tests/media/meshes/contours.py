"""Structure sets of DICOM, made and read by pydicom."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pydicom

from tests.media.volume.volumes import item, save

Floats = npt.NDArray[np.float64]


def circle(z: float, count: int = 24) -> Floats:
    a = np.arange(count) * 2 * np.pi / count
    return np.round(np.stack([20 * np.cos(a), 30 * np.sin(a) - 7, np.full(count, z)], axis=-1), 3)


def contour(points: Floats, kind: str = "CLOSED_PLANAR") -> pydicom.Dataset:
    made = item(ContourGeometricType=kind, NumberOfContourPoints=len(points))
    made.ContourData = [f"{x:.3f}" for x in points.ravel().tolist()]
    made.ContourImageSequence = [item(ReferencedSOPClassUID="1.2", ReferencedSOPInstanceUID="1.2.3")]
    return made


def structures(path: Path, only: Floats | None = None, *, explicit: bool = True, count: int = 24) -> Path:
    """Write a structure set of two regions, of which the second has a point and a line; or with one contour only."""
    made = item(
        SOPClassUID="1.2.840.10008.5.1.4.1.1.481.3",
        SOPInstanceUID="1.2.826.1",
        StudyInstanceUID="1.2.826.2",
        SeriesInstanceUID="1.2.826.3",
        FrameOfReferenceUID="1.2.826.4",
        Modality="RTSTRUCT",
        PatientName="Doe^Jane",
        PatientID="7",
        SeriesNumber=3,
        SeriesDescription="plan",
        StructureSetLabel="ORGANS",
        ApprovalStatus="APPROVED",
        ReviewerName="Roe",
        StructureSetROISequence=[
            item(ROINumber=1, ROIName="liver", ROIGenerationAlgorithm="MANUAL", ROIVolume="12.5"),
            item(ROINumber=2, ROIName="marks", ROIGenerationAlgorithm=""),
        ],
        ReferencedFrameOfReferenceSequence=[
            item(FrameOfReferenceUID="1.2.826.4", RTReferencedStudySequence=[item(ReferencedSOPInstanceUID="1.9")])
        ],
    )
    points = np.array([[1.5, 2.25, 3.125]])
    made.ROIContourSequence = [
        item(
            ReferencedROINumber=1,
            ROIDisplayColor=[255, 0, 128],
            ContourSequence=[contour(circle(0, count)), contour(circle(2.5, count))],
        ),
        item(ReferencedROINumber=2, ContourSequence=[contour(points, "POINT"), contour(circle(5)[:5], "OPEN_PLANAR")]),
        item(ReferencedROINumber=3),
    ]
    if only is not None:
        made.ROIContourSequence = [item(ReferencedROINumber=1, ContourSequence=[contour(only)])]
    made.add_new((0x3007, 0x0010), "LO", "A VENDOR")
    made.add_new((0x3007, 0x1001), "LO", "what it knows of the surface")
    return save(path, made, explicit=explicit)


def contours(path: Path) -> list[pydicom.Dataset]:
    regions = pydicom.dcmread(path).ROIContourSequence
    return [c for region in regions for c in region.get("ContourSequence") or []]


def points_of(found: pydicom.Dataset) -> Floats:
    return np.array(found.ContourData, np.float64).reshape(-1, 3)
