"""Derived DICOM, slices or a multi-frame file, by pydicom: with the source's patient and study, and new UIDs.

The attributes are those of DICOM PS3.3, C.7.6.1 (General Image), C.7.6.2 (Image Plane), C.7.6.16 (functional groups),
C.8.8.3 (doses) and C.12.4.1 (derivation).
"""

from __future__ import annotations

import copy
import datetime
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import SuppleError, said
from supple.media.files import PathLike, check_output, replacing, replacing_all, unwritable
from supple.media.volume.data import Array, Volume
from supple.media.volume.frames import Frames, dataset, frames_of, head_of, imported, item_of, quiet, without

SUFFIXES = ("", ".dcm")
"""The suffixes of derived DICOM: a folder of slices, and a multi-frame file."""
WARNING = "NOT FOR DIAGNOSIS"
_GROUPS = "PerFrameFunctionalGroupsSequence"
_LONGEST = 64  # characters of a description (VR LO)
_AFTER = 1000  # added to the source's number of the series
_MAPPING = "RealWorldValueMappingSequence"  # of stored values
_PADDING = ("PixelPaddingValue", "PixelPaddingRangeLimit")
# Attributes that describe the source's pixels, and may not hold for the new ones.
_STALE = (
    "SmallestImagePixelValue", "LargestImagePixelValue", "SmallestPixelValueInSeries", "LargestPixelValueInSeries",
    "SmallestImagePixelValueInPlane", "LargestImagePixelValueInPlane", "PixelDataProviderURL",
    "ExtendedOffsetTable", "ExtendedOffsetTableLengths", "DVHSequence", "IconImageSequence", "MACParametersSequence",
    "DigitalSignaturesSequence", "ConcatenationUID", "InConcatenationNumber",
    "SOPInstanceUIDOfConcatenationSource", "InConcatenationTotalNumber", "ConcatenationFrameOffsetNumber",
    "OriginalAttributesSequence", "PaletteColorLookupTableUID",
    *(f"{c}PaletteColorLookupTable{part}" for c in ("Red", "Green", "Blue") for part in ("Data", "Descriptor")),
    *(f"Segmented{c}PaletteColorLookupTableData" for c in ("Red", "Green", "Blue")),
)  # fmt: skip
_ALONG = (0x00209057, 0x00200032)  # InStackPositionNumber, ImagePositionPatient
_OVERLAYS, _CURVES = range(0x6000, 0x6020, 2), range(0x5000, 0x5020, 2)


def check(path: PathLike, like: Volume | None = None, *, force: bool = False) -> None:
    """Raise SuppleError, before any work, if DICOM cannot be written to a path, or not from this kind of source.

    A folder must be new or empty: its files are never replaced. With ``force``, an existing file may be.
    """
    imported()
    many, single = like is not None and isinstance(like.header, str), Path(path).suffix != ""
    if like is not None and not many and single:
        raise unwritable(path, f"{like.name} is of slices", "give a folder for slices, which is a name without suffix")
    if like is not None and many:
        known = _source(path, like)
        what, bits, groups = "", known.head.get("BitsAllocated"), known.head.get(_GROUPS)
        if not single:
            what = "is one DICOM file of many frames, and so is what is derived from it: name it .dcm"
        elif bits not in (8, 16, 32):
            what = f"has {bits} bits to a pixel, which are not written"
        elif known.places is None and (like.regridded or groups):
            what = "does not tell where each frame lies, in millimetres"
        elif like.geometry.shear and not groups:
            what = "has frames along their normal, and not at an angle"
        if what:
            raise unwritable(path, f"{like.name} {what}", "use .nii.gz, .nrrd or .mha")
    if single or not os.path.isdir(path):
        check_output(path, force=force)
    elif os.listdir(path):
        raise unwritable(path, "that folder is not empty, and a series gets a folder of its own", "name a new folder")


def _source(path: PathLike, like: Volume) -> Frames:
    try:
        return frames_of(like.header)
    except SuppleError as error:
        raise unwritable(path, f"{like.name} is not readable any more", "bring it back") from error


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    r"""Write a series of slices into a new folder, or a multi-frame file; it appears whole or not at all.

    A slice has the attributes of the nearest slice of the source, except for pixels, position and UIDs. Its image type
    is ``DERIVED\SECONDARY``; its description says that it is derived, not for diagnosis, and whether slices at uneven
    places were interpolated first. Private attributes, overlays and signatures are dropped, as they may describe the
    source's pixels. The source's rescale slope and intercept are kept if all slices share them and the values fit;
    otherwise, each slice gets its own slope and 16 bits. The frames of a multi-frame file are written like slices, with
    one slope; with functional groups, the image type is ``DERIVED\PRIMARY``, as their classes allow no other.

    Samples (Z, H, W) or (Z, H, W, 3) are in the units of the files (Hounsfield units for CT); doses are as stored.
    ``like`` is the source: its ``header`` is the path of its file, or those of its slices; its geometry is written.
    """
    check(path, like, force=force)
    with quiet():
        (_write_frames if isinstance(like.header, str) else _write_slices)(path, samples, like, force)


def _write_frames(path: PathLike, samples: Array, like: Volume, force: bool) -> None:
    source = _source(path, like)
    made = _derived(source.head, new_uid(), like.resampled)
    scale = _set_pixels(made, samples, source.scale)
    if scale != source.scale:
        for group in (*(made.get("SharedFunctionalGroupsSequence") or ()), *(made.get(_GROUPS) or ())):
            group.pop(_MAPPING, None)
    made.NumberOfFrames = len(samples)
    if source.places is not None:
        places = [like.geometry.to_lps((0.0, 0.0, k)) for k in range(len(samples))]
        _set_frames(made, like, (places, source.places, scale))
    with replacing(path, force=force) as temporary:
        _save(made, temporary, path)


def _write_slices(path: PathLike, samples: Array, like: Volume, _: bool) -> None:
    try:
        heads = [head_of(name) for name in like.header]
    except Exception as error:  # pydicom raises many types
        raise unwritable(path, f"{like.name} is not readable any more", "bring it back") from error
    told, series = [_told(head) for head in heads], new_uid()
    places, common = np.array([place for place, _ in told]), {scale for _, scale in told}
    with replacing_all(Path(path)) as folder:
        for k, slab in enumerate(samples):
            place = like.geometry.to_lps((0.0, 0.0, k))
            near = _nearest(places, place)
            made = _derived(heads[near], series, like.resampled)
            made.InstanceNumber = k + 1
            scale = _set_pixels(made, slab[None], next(iter(common)) if len(common) == 1 else None)
            if made.get(_GROUPS):
                _set_frames(made, like, ([place], places[near : near + 1], scale))
            else:
                _set_place(made, like, place)
            _save(made, folder / f"slice{k + 1:04d}.dcm", path)


def _save(made: Any, file: Path, path: PathLike) -> None:
    try:
        made.save_as(file, enforce_file_format=True)
    except OSError:
        raise
    except Exception as error:  # invalid attributes of a source raise many types
        what = f"it cannot be written by pydicom ({said(error)[:120]})"
        raise unwritable(path, what, "use .nrrd or .mha") from error


def _nearest(places: Array, place: Array) -> int:
    return int(((places - place) ** 2).sum(axis=1).argmin())


def _told(head: Any) -> tuple[list[float], tuple[float, float]]:
    """Return the position of a slice, and its rescale slope and intercept."""
    names = "PlanePositionSequence", "PixelValueTransformationSequence"
    place, values = ((item_of(head, 0, name) if head.get(_GROUPS) else head) or {} for name in names)
    scale = float(values.get("RescaleSlope") or 1), float(values.get("RescaleIntercept") or 0)
    return [float(value) for value in place.get("ImagePositionPatient") or (0, 0, 0)], scale


def _derived(head: Any, series: Any, resampled: str) -> Any:
    """Return the dataset of a new slice or file, without pixels and position."""
    from supple import __version__

    made = dataset()
    made.update(head)
    without(made, _STALE)
    for tag in [tag for tag in made.keys() if tag.group in (*_OVERLAYS, *_CURVES)]:  # noqa: SIM118, not a dict
        del made[tag]
    source = renewed(made, series)
    source.PurposeOfReferenceCodeSequence = [_code("121322", "Source image for image processing operation")]
    made.ImageType = ["DERIVED", "SECONDARY", *list(head.get("ImageType") or ())[2:]]
    before = f"Of a source whose {resampled}. " if resampled else ""
    made.DerivationDescription = f"{before}Bent by Supple {__version__}, a non-rigid deformation. {WARNING}"
    made.DerivationCodeSequence = [_code("113085", "Spatial resampling")]
    made.SourceImageSequence = [source]
    made.ImageComments = f"Bent by Supple: {WARNING}"
    pydicom = imported()
    made.file_meta = pydicom.dataset.FileMetaDataset()
    made.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    made.file_meta.MediaStorageSOPClassUID = made.SOPClassUID
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    return made


def new_uid() -> Any:
    """Return a new, globally unique UID."""
    return imported().uid.generate_uid(prefix=None)


def reference_to(head: Any) -> Any:
    """Return a reference to a DICOM object, as an item of a sequence."""
    return dataset(ReferencedSOPClassUID=head.SOPClassUID, ReferencedSOPInstanceUID=head.SOPInstanceUID)


def _code(value: str, meaning: str) -> Any:
    return dataset(CodeValue=value, CodingSchemeDesignator="DCM", CodeMeaning=meaning)


def renewed(made: Any, series: Any) -> Any:
    """Make an object a new one of a series with this UID, without private tags; return a reference to what it was."""
    source, known, now = reference_to(made), int(made.get("SeriesNumber") or 0), datetime.datetime.now()
    made.remove_private_tags()
    made.SOPInstanceUID, made.SeriesInstanceUID = new_uid(), series
    made.SeriesNumber = known + (_AFTER if known + _AFTER < 1 << 31 else -_AFTER)  # within 32 bits (VR IS)
    made.SeriesDescription = _marked(made.get("SeriesDescription"))
    made.InstanceCreationDate, made.InstanceCreationTime = now.strftime("%Y%m%d"), now.strftime("%H%M%S")
    return source


def _marked(text: Any) -> str:
    """Return a description that ends with the warning; it is truncated to fit."""
    end = f"bent, {WARNING}"
    return f"{str(text)[: _LONGEST - len(end) - 2]}, {end}" if text else end


def _decimal(values: Sequence[float]) -> list[Any]:
    pydicom = imported()
    return [pydicom.valuerep.DSfloat(float(x) + 0.0, auto_format=True) for x in values]


def _set_frames(made: Any, like: Volume, where: tuple[list[Array], Array, tuple[float, float]]) -> None:
    """Set the positions of frames: offsets, or functional groups, which are copied from the nearest source frame.

    ``where`` holds the positions of the frames, those of the source's, and the rescale slope and intercept.
    """
    places, sources, (slope, intercept) = where
    groups, count = made.get(_GROUPS), len(places)
    if not groups:
        _set_place(made, like, places[0])
        made.GridFrameOffsetVector = _decimal([k * like.geometry.spacing[2] for k in range(count)])
        made.DoseComment = _marked(made.get("DoseComment"))
        return
    made.ImageType = ["DERIVED", "PRIMARY", *list(made.ImageType)[2:]]
    shared = made.SharedFunctionalGroupsSequence[0] if made.get("SharedFunctionalGroupsSequence") else dataset()
    once = {name: item_of(made, 0, name) for name in ("PlaneOrientationSequence", "PixelMeasuresSequence")}
    values = item_of(made, 0, "PixelValueTransformationSequence")
    if values is None and (slope, intercept) != (1, 0):
        values = dataset(RescaleType="US")
    if values is not None:
        values.RescaleSlope, values.RescaleIntercept = f"{slope:.10g}", f"{intercept:.10g}"
        once["PixelValueTransformationSequence"] = values
    derivation = ("DerivationDescription", "DerivationCodeSequence", "SourceImageSequence")
    once["DerivationImageSequence"] = dataset(**{name: made[name].value for name in derivation})
    _set_plane(once["PlaneOrientationSequence"], once["PixelMeasuresSequence"], like)
    own = [copy.deepcopy(groups[_nearest(sources, place)]) for place in places]
    for k, (group, place) in enumerate(zip(own, places, strict=True)):
        without(group, once)
        group.PlanePositionSequence = [dataset(ImagePositionPatient=_decimal(place.tolist()))]
        if like.regridded:
            _renumber(made, group, k + 1)
    for name, item in once.items():
        setattr(shared, name, [item])
    for element in (e for group in (shared, *own) for e in group if e.keyword.endswith("FrameTypeSequence")):
        element.value[0].FrameType = made.ImageType
    made.SharedFunctionalGroupsSequence, made.PerFrameFunctionalGroupsSequence = [shared], own


def _renumber(made: Any, group: Any, number: int) -> None:
    """Set the number of a frame in its stack, which may have more or fewer frames than the source's."""
    for content in group.get("FrameContentSequence") or ():
        if "InStackPositionNumber" in content:
            content.InStackPositionNumber = number
        axes = [item.get("DimensionIndexPointer") for item in made.get("DimensionIndexSequence") or ()]
        known = content.get("DimensionIndexValues")
        if known is not None and not axes:
            del content.DimensionIndexValues  # their meaning is not declared
        numbers = [] if known is None else [known] if isinstance(known, int) else list(known)
        if len(numbers) == len(axes) > 0:
            content.DimensionIndexValues = [
                number if axis in _ALONG else old for axis, old in zip(axes, numbers, strict=True)
            ]


def _set_place(made: Any, like: Volume, place: Array) -> None:
    made.ImagePositionPatient = _decimal(place.tolist())
    _set_plane(made, made, like)
    if "SliceLocation" in made:
        normal = np.cross(like.geometry.direction[:, 0], like.geometry.direction[:, 1])
        (made.SliceLocation,) = _decimal([float(place @ normal)])


def _set_plane(turned: Any, pixels: Any, like: Volume) -> None:
    across, down, step = like.geometry.spacing
    if like.geometry.shear:  # DICOM measures the step along the normal
        step *= abs(float(np.linalg.det(like.geometry.direction)))
    turned.ImageOrientationPatient = _decimal(like.geometry.direction[:, :2].T.ravel().tolist())
    pixels.PixelSpacing = _decimal([down, across])
    if like.regridded:
        (pixels.SliceThickness,) = _decimal([step])
    if "SpacingBetweenSlices" in pixels:
        (pixels.SpacingBetweenSlices,) = _decimal([step])


def _set_pixels(made: Any, slab: Array, scale: tuple[float, float] | None) -> tuple[float, float]:
    """Set the pixels, of frames (Z, H, W) or (Z, H, W, 3), and return their slope and intercept."""
    made.Rows, made.Columns = slab.shape[1:3]
    made.SamplesPerPixel = colours = slab.shape[3] if slab.ndim == 4 else 1
    if colours > 1:
        made.PhotometricInterpretation, made.PlanarConfiguration = "RGB", 0
    else:
        if made.get("PhotometricInterpretation") == "MONOCHROME1":  # GDCM has inverted its values
            without(made, ("WindowCenter", "WindowWidth", "VOILUTSequence", "PresentationLUTShape", *_PADDING))
        made.PhotometricInterpretation = "MONOCHROME2"
    stored, (slope, intercept) = _stored(made, slab, scale)
    if colours == 1 and not made.get(_GROUPS) and ("RescaleSlope" in made or (slope, intercept) != (1, 0)):
        made.RescaleSlope, made.RescaleIntercept = f"{slope:.10g}", f"{intercept:.10g}"
    _set_padding(made, stored.dtype.kind, scale == (slope, intercept))
    made.PixelRepresentation = int(stored.dtype.kind == "i")
    bits = 8 * stored.dtype.itemsize
    if made.get("BitsAllocated") != bits or not _fits(stored, int(made.BitsStored), stored.dtype.kind):
        made.BitsStored = bits
    made.BitsAllocated, made.HighBit = bits, made.BitsStored - 1
    data = np.ascontiguousarray(stored, stored.dtype.newbyteorder("<")).tobytes()
    made.add_new("PixelData", "OB" if bits == 8 else "OW", data + b"\0" * (len(data) % 2))
    return slope, intercept


def _set_padding(made: Any, kind: str, alike: bool) -> None:
    """Keep the padding values if pixels keep their scaling, and convert them to the pixels' type; else remove them."""
    if alike and made.get("PixelRepresentation", 0) == int(kind == "i"):
        return
    if not alike:
        made.pop(_MAPPING, None)
    for name in _PADDING:
        value = made.get(name)
        without(made, [name])
        if alike and value is not None and _fits(np.array(value), 16, kind):
            made.add_new(name, "SS" if kind == "i" else "US", value)


def _fits(values: Array, bits: int, kind: str) -> bool:
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if kind == "i" else (0, (1 << bits) - 1)
    return bool(values.size == 0 or (values.min() >= low and values.max() <= high))


def _stored(made: Any, slab: Array, scale: tuple[float, float] | None) -> tuple[Array, tuple[float, float]]:
    if scale is not None:
        values = np.rint((slab.astype(np.float64) - scale[1]) / scale[0])
        kind = "i" if made.get("PixelRepresentation") else "u"
        for bits, letter in ((int(made.get("BitsAllocated", 16)), kind), (16, kind), (16, "i"), (32, kind), (32, "i")):
            if bits in (8, 16, 32) and _fits(values, bits, letter):
                return values.astype(f"{letter}{bits // 8}"), scale
    # A slope for each slice, as in PET, where the intercept must be 0.
    slope = float(f"{float(np.abs(slab).max(initial=0)) / 32767 or 1:.10g}")
    return np.rint(slab / slope).clip(-32767, 32767).astype(np.int16), (slope, 0.0)
