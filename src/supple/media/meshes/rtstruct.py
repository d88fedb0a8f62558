"""Contours of a DICOM structure set, by pydicom; moved contours are written to a structure set with new UIDs.

The attributes are those of DICOM PS3.3, C.8.8.5 (Structure Set) and C.8.8.6 (ROI Contour).
"""

from __future__ import annotations

import copy
import io
from typing import Any

import numpy as np

from supple.errors import SuppleError, VolumeWarning, said, shown, warn
from supple.media.files import PathLike, unreadable
from supple.media.meshes import Floats, Part, PointFile, checked, joined, part_of
from supple.media.volume import Volume
from supple.media.volume.derived import WARNING, new_uid, reference_to, renewed
from supple.media.volume.frames import dataset, frames_of, head_of, imported, without

_STRUCTURES = "1.2.840.10008.5.1.4.1.1.481.3"
_STUDY = "1.2.840.10008.3.1.2.3.1"  # the class of studies: retired, but still used for this reference
_FLAT = 0.01  # mm: the largest distance of a planar contour's points from its plane
_LONG = 65_534  # bytes: the longest text value with an explicit VR
# Attributes that hold only for the old contours, and only for the approved source.
_STALE = (
    "ContourImageSequence", "ContourSlabThickness", "ContourOffsetVector", "SourcePixelPlanesCharacteristicsSequence",
    "SourceSeriesSequence",
)  # fmt: skip
_STALE_SET = (
    "RTReferencedStudySequence", "ROIVolume", "ReviewDate", "ReviewTime", "ReviewerName", "DigitalSignaturesSequence",
    "MACParametersSequence", "OriginalAttributesSequence",
)  # fmt: skip


def parsed(path: PathLike, data: bytes, series: Volume | None = None) -> PointFile:
    """Return the points of all contours of a structure set, in LPS.

    With a DICOM ``series``, the written structure set refers to it, and each contour to its nearest slice.
    """
    pydicom = imported()
    try:
        read = pydicom.dcmread(io.BytesIO(data))
        whole = all(_is_whole(read.get_item(tag)) for tag in read.keys())  # noqa: SIM118, not a dict
        kind = str(read.get("SOPClassUID", ""))
        blocks = [np.array(contour.ContourData, np.float64) for contour in _contours(read)]
    except Exception as error:  # pydicom raises many types
        raise unreadable(path, f"it is no whole DICOM file ({said(error)[:120]})") from error
    if not whole:
        raise unreadable(path, "its end is missing")
    if kind != _STRUCTURES:
        raise unreadable(path, "it is no structure set of contours", "give an RTSTRUCT")
    for k, block in enumerate(blocks):
        if block.ndim != 1 or block.size % 3:
            raise unreadable(path, f"contour {k + 1} has {block.size} numbers", "a point has three")
    points = checked(path, np.concatenate(blocks) if blocks else [])
    name, ends = shown(path), np.cumsum([len(block) // 3 for block in blocks])

    def rewritten(moved: Floats, _: Floats) -> bytes:
        if series is None and not (moved != points).any():
            return data
        made = pydicom.dcmread(io.BytesIO(data))
        off: list[float] = []
        for contour, new, old in zip(_contours(made), np.split(moved, ends), np.split(points, ends), strict=False):
            if (new != old).any():
                off.append(_move(contour, new, old))
        if bent := [far for far in off if far]:
            text = f"{len(bent)} of {len(ends)} contours of {name} leave their planes, by up to {max(bent):.2g} mm"
            told = "closed ones stay CLOSED_PLANAR, and a program may take each for flat"
            warn(f"{text}: {told}", VolumeWarning)
        held = io.BytesIO()
        try:
            _renew(made)
            if series is not None:
                _refer(made, series)
            pydicom.dcmwrite(held, made, enforce_file_format=True)
        except Exception as error:
            told = f"cannot write the contours of {name}: pydicom refuses ({said(error)[:120]})"
            raise SuppleError(f"{told}: mend that file") from error
        return held.getvalue()

    return PointFile(points, "LPS", rewritten, lambda: _parts(read, len(points)))


def _is_whole(raw: Any) -> bool:
    """Return whether an element has its declared length; pydicom reads truncated ones without an error."""
    length = getattr(raw, "length", None)
    return length in (None, 0xFFFFFFFF) or len(raw.value or b"") >= length


def _contours(read: Any) -> list[Any]:
    regions = read.get("ROIContourSequence") or []
    every = (contour for region in regions for contour in region.get("ContourSequence") or [])
    return [contour for contour in every if contour.get("ContourData")]


def _parts(read: Any, count: int) -> list[Part]:
    """Return the contours of each region as lines, closed or open as in the file, in the region's colour."""
    made, begin = [], 0
    for region in read.get("ROIContourSequence") or []:
        runs: list[list[int]] = []
        for contour in region.get("ContourSequence") or []:
            if not contour.get("ContourData"):
                continue
            end = begin + len(contour.ContourData) // 3
            kind = str(contour.get("ContourGeometricType", ""))
            closed = [] if kind in ("POINT", "OPEN_PLANAR", "OPEN_NONPLANAR") else [begin]
            runs.append([*range(begin, end), *closed])
            begin = end
        shades = [int(shade) / 255 for shade in region.get("ROIDisplayColor") or ()]
        good = len(shades) == 3 and 0 <= min(shades) <= max(shades) <= 1
        colour = (shades[0], shades[1], shades[2]) if good else None
        made.append(part_of(count, lines=joined(runs), colour=colour))
    return made


def _move(contour: Any, new: Floats, old: Floats) -> float:
    """Move a contour; return the largest distance of its points from a plane (mm), 0 if it is still planar.

    In DICOM, a contour that is not planar must be open; but programs fill closed contours only, and ignore others.
    """
    without(contour, _STALE)
    decimal, known = imported().valuerep.DSfloat, list(contour.ContourData)
    values = [
        before if kept else decimal(float(value) + 0.0, auto_format=True)
        for before, value, kept in zip(known, new.ravel().tolist(), (new == old).ravel().tolist(), strict=True)
    ]
    kind = str(contour.get("ContourGeometricType", ""))
    off = 0.0
    if kind in ("CLOSED_PLANAR", "OPEN_PLANAR", "CLOSEDPLANAR_XOR") and len(new) > 3:
        centred = new - new.mean(axis=0)
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        off = float(np.abs(centred @ normal).max())
    if off > _FLAT and kind == "OPEN_PLANAR":
        contour.ContourGeometricType = "OPEN_NONPLANAR"
    contour.ContourData = values
    return off if off > _FLAT else 0.0


def _renew(made: Any) -> None:
    """Give a structure set new UIDs, with the source as its predecessor."""
    made.PredecessorStructureSetSequence = [renewed(made, new_uid())]
    regions = made.get("StructureSetROISequence") or []
    for part in (made, *regions, *(made.get("ReferencedFrameOfReferenceSequence") or [])):
        without(part, _STALE_SET)
    made.StructureSetDescription = f"Bent by Supple, a non-rigid deformation. {WARNING}"
    made.StructureSetDate, made.StructureSetTime = made.InstanceCreationDate, made.InstanceCreationTime
    if "ApprovalStatus" in made:
        made.ApprovalStatus = "UNAPPROVED"
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    explicit = not made.file_meta.TransferSyntaxUID.is_implicit_VR
    if explicit and any(
        sum(len(str(value)) + 1 for value in contour.ContourData) > _LONG for contour in _contours(made)
    ):
        made.file_meta.TransferSyntaxUID = imported().uid.ImplicitVRLittleEndian


def _refer(made: Any, series: Volume) -> None:
    """Add references to the slices or frames of a series, and from each contour to its nearest slice."""
    many, count = isinstance(series.header, str), series.sizes[2]
    heads = [head_of(name) for name in ([series.header] if many else series.header)]
    places = frames_of(series.header).places if many else None
    frame = heads[0].get("FrameOfReferenceUID") or next(
        (one.get("FrameOfReferenceUID") for one in made.get("ReferencedFrameOfReferenceSequence") or ()), None
    )
    slices = [reference_to(head) for head in heads[: 1 if many else count]]
    referred = dataset(SeriesInstanceUID=heads[0].SeriesInstanceUID, ContourImageSequence=slices)
    study = dataset(ReferencedSOPClassUID=_STUDY, ReferencedSOPInstanceUID=heads[0].StudyInstanceUID)
    study.RTReferencedSeriesSequence = [referred]
    where = dataset(FrameOfReferenceUID=frame, RTReferencedStudySequence=[study])
    made.StudyInstanceUID, made.ReferencedFrameOfReferenceSequence = heads[0].StudyInstanceUID, [where]
    if "FrameOfReferenceUID" in made:
        made.FrameOfReferenceUID = frame
    for region in made.get("StructureSetROISequence") or ():
        region.ReferencedFrameOfReferenceUID = frame
    for contour in _contours(made):
        contour.pop("ContourImageSequence", None)
        middle = np.reshape(np.array(contour.ContourData, np.float64), (-1, 3)).mean(axis=0)
        k = round(float(series.geometry.from_lps(middle)[2]))
        if not 0 <= k < count:
            continue
        one = copy.deepcopy(slices[0 if many else k])
        if many:
            at = series.geometry.to_lps((0.0, 0.0, k))
            one.ReferencedFrameNumber = 1 + (k if places is None else int(((places - at) ** 2).sum(axis=1).argmin()))
        contour.ContourImageSequence = [one]
