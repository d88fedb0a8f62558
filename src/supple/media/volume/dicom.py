"""Series of DICOM slices, by SimpleITK's GDCM, sorted and checked for gaps."""

from __future__ import annotations

import contextlib
import mimetypes
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import SuppleError, VolumeWarning, argument, shown, warn
from supple.media.files import PathLike, first_bytes, head_of, unreadable
from supple.media.volume.data import Array, Volume, check_spacing, located
from supple.media.volume.frames import dataset, frames_of
from supple.media.volume.frames import head_of as pixelless
from supple.media.volume.itk import check_voxels, failing, geometry_of, imported, informed
from supple.space.checks import choice
from supple.space.geometry import Geometry

_UID, _NUMBER, _TEXT, _PIXEL_SPACING = "0020|000e", "0020|0011", "0008|103e", "0028|0030"
_THICKNESS, _BETWEEN, _BITS = "0018|0050", "0018|0088", "0028|0100"
_DOSE, _DOSE_UNITS = "3004|000e", "3004|0002"
_SUFFIXES = {".dcm", ".dicom", ".ima"}
_ASIDE = 0.25  # of a pixel: the largest sideways offset of slices
_ALONG = 0.1  # of a step: the largest deviation from even steps
# Kinds of DICOM objects that are not images, by the end of the SOP class UID after `_STORAGE`.
_STORAGE = "1.2.840.10008.5.1.4.1.1."
_BESIDE = {
    "481.3": "RTSTRUCT", "481.5": "RTPLAN", "481.2": "RTDOSE", "481": "RT", "88": "SR", "11": "PR", "9": "waveform",
    "66.1": "REG", "66.3": "REG", "66.4": "SEG", "66": "raw data", "104": "document", "79": "measurements",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Series:
    """The slices of a series in a folder."""

    uid: str
    number: int
    description: str
    paths: tuple[str, ...]


def is_slice(path: PathLike) -> bool:
    """Return whether a file is DICOM, by its first bytes."""
    return first_bytes(path, 132)[128:] == b"DICM"


def in_folder(path: PathLike) -> bool:
    """Return whether a folder holds a DICOM file: by suffix, or by its first bytes if that is missing or a number.

    Subfolders count too, unless the folder holds images or videos.
    """
    for folder in _folders(path):
        for name in _names(folder):
            suffix, file = os.path.splitext(name)[1].lower(), os.path.join(folder, name)
            unnamed = not suffix or suffix[1:].isdigit()
            if (suffix in _SUFFIXES or (unnamed and is_slice(file))) and os.path.isfile(file):
                return True
    return False


def _names(folder: str) -> list[str]:
    try:
        return sorted(os.listdir(folder))
    except (OSError, ValueError):
        return []


def _folders(path: PathLike) -> Iterator[str]:
    """Yield a folder and all subfolders; those of a folder that holds images or videos are skipped."""
    for folder, inner, files in os.walk(path):
        yield folder
        if any((mimetypes.guess_type(name)[0] or "").startswith(("image/", "video/")) for name in files):
            inner.clear()
        inner[:] = sorted(name for name in inner if not name.startswith("."))


def listed(path: PathLike, *, nested: bool = True) -> list[Series]:
    """Return the series of images in a folder and its subfolders, by number; SuppleError if there are none.

    Objects that are not images, or are derived from images in the folder (a dose, a segmentation), are skipped with a
    warning. Files that cannot be read are an error with ``nested``; without, where a slice was named, they are skipped.
    """
    imported()  # or raise that SimpleITK is missing
    beside: list[tuple[str, str]] = []
    images: list[tuple[str, Any]] = []
    derived: list[tuple[str, Any]] = []
    folders = _folders(path) if nested else [os.fspath(path)]
    for file in (os.path.join(folder, name) for folder in folders for name in _names(folder)):
        named = os.path.splitext(file)[1].lower() in _SUFFIXES
        if os.path.basename(file).upper() == "DICOMDIR" or not os.path.isfile(file) or not (named or is_slice(file)):
            continue
        reader, kind = _reader(file), _kind_beside(file)
        if reader is None and not kind:
            if nested:  # a missing slice at the end would go unnoticed
                what = "it is damaged, or no slice of any series"
                raise unreadable(file, what, "give a whole copy of it, or take it out")
            kind = "not readable"
        if kind:
            beside.append((file, kind))
        if reader is not None:
            (derived if kind else images).append((file, reader))
    if not images:
        images, beside = derived, [(file, kind) for file, kind in beside if file not in dict(derived)]
    if not images:
        raise unreadable(path, "there are no DICOM images in that folder", "give the folder that holds the slices")
    if beside:
        told = ", ".join(f"{shown(Path(name).name)} ({kind})" for name, kind in beside[:3])
        more = f" and {len(beside) - 3} more" if len(beside) > 3 else ""
        text = f"{told}{more} in {shown(path)}: no images of a series, and left out"
        warn(text, VolumeWarning)
    series: dict[str, list[tuple[str, Any]]] = {}
    for file, reader in images:
        series.setdefault(_tag(reader, _UID), []).append((file, reader))
    found = []
    for uid, slices in series.items():
        reader = slices[0][1]
        number = _tag(reader, _NUMBER)
        known = int(number) if number.lstrip("+-").isdigit() else 0
        found.append(Series(uid, known, _tag(reader, _TEXT), tuple(file for file, _ in slices)))
    return sorted(found, key=lambda one: (one.number, one.uid))


# GDCM reads no header of objects that are not images (test_what_is_no_image_is_left_out_and_named).
def _kind_beside(path: str) -> str:
    """Return the kind of an object that is not an image, or is derived from one, by its SOP class; else empty."""
    named = re.search(rb"\x02\x00\x02\x00UI..([0-9.]+)", first_bytes(path, 1024), re.DOTALL)
    uid = named[1].decode() if named else ""
    if not uid.startswith(_STORAGE):
        return ""
    parts = uid.removeprefix(_STORAGE).split(".")
    return _BESIDE.get(".".join(parts[:2])) or _BESIDE.get(parts[0], "")


def _head(path: str) -> Any:
    """Return a file's pydicom.Dataset without pixels; an empty one if it cannot be read, which others report."""
    try:
        return pixelless(path)
    except Exception:  # pydicom raises many types
        return dataset()


def frame_of_reference(path: str) -> str:
    """Return the UID of the frame of reference of a DICOM file, an image or contours; "" if it has none."""
    head = _head(path)
    parts = [head, *(head.get("ReferencedFrameOfReferenceSequence") or ())]
    return next((str(part.FrameOfReferenceUID) for part in parts if part.get("FrameOfReferenceUID")), "")


def padding_of(volume: Volume) -> float | None:
    """Return the scaled value of padding voxels (PixelPaddingValue); None if the file has none."""
    head = _head(volume.header[0] if isinstance(volume.header, tuple) else volume.header)
    stored = head.get("PixelPaddingValue")
    if not isinstance(stored, int) or head.get("PhotometricInterpretation") == "MONOCHROME1":  # GDCM inverts it
        return None
    value = stored * float(head.get("RescaleSlope") or 1) + float(head.get("RescaleIntercept") or 0)
    limits = np.iinfo(volume.samples.dtype) if volume.samples.dtype.kind in "iu" else None
    return value if limits is None or limits.min <= value <= limits.max else None


def read(path: PathLike, series: str | None = None, irregular: str | None = None) -> Volume:
    """Read a series of slices, or a multi-frame file, as in `supple.media.volume.read`.

    Values are in the units of the files, for CT in Hounsfield units. No data on the patient are kept. SuppleError if
    there is no such series, or there are several and none is named; a slice is missing, or differs from the others in
    size or direction; the slices are not stacked along a line; or a file cannot be read. If that line is not their
    normal, as with a tilted gantry, the geometry is sheared.
    """
    if irregular is not None:
        choice("irregular", irregular, ("resample",))
    file = Path(path)
    if not file.is_dir():
        head_of(path, 1)
        reader = _reader(os.fspath(path))
        if reader is None:
            if kind := _kind_beside(os.fspath(path)):
                other = "give slices, or a file of frames"
                advice = "supple points moves its contours" if kind == "RTSTRUCT" else other
                raise unreadable(path, f"it is DICOM without a picture ({kind})", advice)
            reader = informed(path, "DICOM")  # raises an error with the reason
        if reader.GetSize()[2:3] > (1,):
            return _frames(path, reader, path, irregular)
        found = listed(file.parent, nested=False)
        return _stacked(path, _chosen(found, path, series or _tag(reader, _UID)), irregular)
    return _stacked(path, _chosen(listed(file), path, series), irregular)


def _chosen(found: list[Series], path: PathLike, series: str | None) -> Series:
    if series is None and len(found) == 1:
        return found[0]
    for k, one in enumerate(found, 1):
        if series is not None and series.strip() in (one.uid, str(k)):
            return one
    what = f"it holds {len(found)} series" if series is None else f"it holds no series {shown(series)}"
    advice = f"say which one by {argument('series', '1')}, or name one of its slices"
    listed = (f"{k} is {one.uid} {shown(one.description)} of {len(one.paths)} slices" for k, one in enumerate(found, 1))
    raise unreadable(path, f"{what} ({', '.join(listed)})", advice)


def _reader(name: str) -> Any | None:
    try:
        return informed(name, "DICOM")
    except SuppleError:
        return None


def _tag(reader: Any, key: str) -> str:
    return str(reader.GetMetaData(key)).strip(" \0") if reader.HasMetaDataKey(key) else ""


def _check_pixels(path: PathLike, reader: Any) -> None:
    """Raise SuppleError for a pixel spacing that GDCM would set to 1."""
    if text := _tag(reader, _PIXEL_SPACING):
        try:
            steps = [float(step) for step in text.split("\\")]
        except ValueError:
            steps = [float("nan")]
        check_spacing(path, steps)


def _frames(path: PathLike, reader: Any, file: PathLike, irregular: str | None) -> Volume:
    """Read a multi-frame file; ``path`` is for messages."""
    check_voxels(path, reader)
    _check_pixels(path, reader)
    known, order, uneven = frames_of(file), None, None
    if known.places is None:
        geometry = geometry_of(path, reader)
    else:
        names = [f"frame {k + 1}" for k in range(len(known.places))]
        stack = known.places, known.direction, known.spacing
        order, geometry, uneven = _ordered(path, names, *stack, irregular)
    with failing(path, "DICOM", tuple(reader.GetSize())):
        samples = known.rescaled(imported().GetArrayFromImage(reader.Execute()))
    if order is not None and (np.diff(order) != 1).any():
        samples = samples[order]
    scaling, name = _dose(path, reader), os.path.abspath(file)
    made = Volume(_narrowed(samples, [reader]), geometry, shown(path), "DICOM", header=name, scaling=scaling)
    return made if uneven is None else _resampled(made, uneven)


def _dose(path: PathLike, reader: Any) -> tuple[float, float]:
    """Return the scaling of a dose to Gy, which GDCM does not apply; (1, 0) for other files."""
    text, scale = _tag(reader, _DOSE), 0.0
    with contextlib.suppress(ValueError):
        scale = float(text or 1)
    if not 0 < scale < np.inf:
        what = f"its dose grid scaling is {shown(text)}, and not a number above 0"
        raise unreadable(path, what, "correct its header")
    return scale, 0.0


def dose_unit(path: PathLike) -> str:
    """Return the unit of a scaled dose: Gy, or empty for a relative dose."""
    reader = _reader(os.fspath(path))
    return "Gy" if reader is not None and _tag(reader, _DOSE_UNITS).upper() == "GY" else ""


def _narrowed(samples: Array, readers: list[Any]) -> Array:
    """Undo GDCM's widening: 16-bit values, which it stores in 32 bits if there is an intercept, get 16 bits again."""
    if all(_tag(reader, _BITS) == "1" for reader in readers):
        return samples // 255  # GDCM reads single bits, as in segmentations, as 0 or 255
    if samples.dtype != np.int32 or not all(_tag(reader, _BITS) in ("8", "12", "16") for reader in readers):
        return samples
    known = np.iinfo(np.int16)
    return samples.astype(np.int16) if known.min <= samples.min() and samples.max() <= known.max else samples


def _stacked(path: PathLike, series: Series, irregular: str | None) -> Volume:
    sitk, readers, uneven = imported(), [], None
    for name in series.paths:
        readers.append(informed(name, "DICOM"))
        check_voxels(name, readers[-1])
        _check_pixels(name, readers[-1])
    first = readers[0]
    if len(readers) == 1 and first.GetSize()[2:3] > (1,):
        return _frames(path, first, series.paths[0], irregular)
    for name, reader in zip(series.paths, readers, strict=True):
        if reader.GetSize()[2:3] > (1,):
            raise unreadable(path, f"{shown(Path(name).name)} is one of several files of many frames", "name that file")
        _require_alike(path, (series.paths[0], first), (name, reader))
    direction = np.array(first.GetDirection()).reshape(3, 3)
    places = np.array([reader.GetOrigin() for reader in readers])
    if len(readers) > 1:
        told = [shown(Path(name).name) for name in series.paths]
        order, geometry, uneven = _ordered(path, told, places, direction, first.GetSpacing()[:2], irregular)
    else:
        order, step = np.zeros(1, np.intp), float(first.GetSpacing()[2])
        with contextlib.suppress(ValueError):  # GDCM only knows the distance between slices
            if not _tag(first, _BETWEEN) and (thickness := float(_tag(first, _THICKNESS))) > 0:
                step = thickness
        geometry = located(path, [*first.GetSpacing()[:2], step], places[0].tolist(), direction, "LPS")
    names = [series.paths[k] for k in order]
    reader = sitk.ImageSeriesReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileNames(names)
    if len(kinds := {one.GetPixelID() for one in readers}) > 1:  # else the first type would be used for all
        floats = any(kind >= sitk.sitkFloat32 for kind in kinds)
        reader.SetOutputPixelType(sitk.sitkFloat64 if floats else sitk.sitkInt32)
    with failing(path, "DICOM", (*first.GetSize()[:2], len(names))):
        samples = sitk.GetArrayFromImage(reader.Execute())
    if len(scalings := {_dose(name, one) for name, one in zip(series.paths, readers, strict=True)}) > 1:
        raise unreadable(path, "its slices have several dose grid scalings", "give one file of many frames")
    own = tuple(os.path.abspath(name) for name in names)
    made = Volume(_narrowed(samples, readers), geometry, shown(path), "DICOM", header=own, scaling=scalings.pop())
    return made if uneven is None else _resampled(made, uneven)


def _resampled(volume: Volume, places: Array) -> Volume:
    """Return a volume with slices at even steps, interpolated linearly from those at ``places`` (mm)."""
    step = volume.geometry.spacing[2]
    count = round(float(places[-1]) / step) + 1
    at = np.clip(np.searchsorted(places, np.arange(count) * step, "right") - 1, 0, len(places) - 2)
    part = np.clip((np.arange(count) * step - places[at]) / np.diff(places)[at], 0.0, 1.0)
    samples = np.empty((count, *volume.samples.shape[1:]), volume.samples.dtype)
    for k, (i, t) in enumerate(zip(at.tolist(), part.tolist(), strict=True)):
        mixed = (1 - t) * volume.samples[i] + t * volume.samples[i + 1]
        samples[k] = mixed if samples.dtype.kind == "f" else np.rint(mixed)
    gaps = np.diff(places)
    text = f"{len(places)} slices, {gaps.min():.4g} to {gaps.max():.4g} mm apart, are interpolated linearly"
    text = f"{text} at {count} places, {step:.4g} mm apart"
    warn(f"{volume.name}: its {text}", VolumeWarning)
    return replace(volume, samples=samples, regridded=True, resampled=text)


def _ordered(
    path: PathLike, names: list[str], places: Array, direction: Array, pixel: Sequence[float], irregular: str | None
) -> tuple[Array, Geometry, Array | None]:
    """Return the order of slices along their normal, their geometry, and, if they are uneven, the places.

    The third axis is the normal, or, if slices are offset sideways (as with a tilted gantry), the line through their
    first pixels. SuppleError if they are unevenly stacked, unless ``irregular`` accepts it.
    """
    along = (places - places[0]) @ direction[:, 2]
    order = np.argsort(along, kind="stable")
    step, even = _check_steps(path, [names[k] for k in order], along[order], irregular)
    stack = places[order] - places[order][0]
    upwards, line, most = along[order] - along[order][0], stack[-1] / np.linalg.norm(stack[-1]), _ASIDE * min(pixel)
    if np.abs(stack - np.outer(upwards, direction[:, 2])).max() > most:
        lean = float(line @ direction[:, 2])
        step, upwards, direction = step / lean, upwards / lean, np.column_stack([direction[:, :2], line])
        aside = np.abs(stack - np.outer(upwards, line)).max(axis=1)
        if (worst := float(aside.max())) > most:
            told = (
                f"its slices are offset sideways, and along no line: {names[order[aside.argmax()]]} by {worst:.3g} mm"
            )
            raise unreadable(path, told, "resample it first")
    geometry = located(path, [*pixel, step], places[order[0]].tolist(), direction, "LPS")
    return order, geometry, None if even else upwards


def _require_alike(path: PathLike, first: tuple[str, Any], other: tuple[str, Any]) -> None:
    (a, one), (b, two) = first, other
    for what, get in (
        ("sizes", lambda r: (*r.GetSize()[:3], r.GetNumberOfComponents())),
        ("spacings", lambda r: r.GetSpacing()[:2]),
        ("directions", lambda r: r.GetDirection()),
    ):
        if not np.allclose(get(one), get(two), rtol=1e-4, atol=1e-4):
            names = f"{shown(Path(a).name)} and {shown(Path(b).name)}"
            raise unreadable(path, f"its slices have several {what} ({names})", "take the odd ones out")


def _check_steps(path: PathLike, names: list[str], along: Array, irregular: str | None) -> tuple[float, bool]:
    """Return the step between slices (mm), and whether it is even; if not, a step for resampling, near the median."""
    steps = np.diff(along)
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])  # the median, or the smaller of the two in the middle
    even = float((along[-1] - along[0]) / len(steps))

    def between(k: int) -> str:
        return f"{names[k]} and {names[k + 1]}"

    if ((closest := int(steps.argmin())) >= 0 and steps[closest] < _ALONG * usual) or usual <= 0:
        told = f"{between(closest)} lie at the same place"
        raise unreadable(path, told, "take one of them out, or give a series of one time and kind")
    uneven = np.abs(along - along[0] - even * np.arange(len(along))).max() > _ALONG * even
    widest = int(steps.argmax())
    accept = f"or accept it: {argument('irregular', 'resample')} interpolates between them"
    if irregular is not None and (uneven or steps[widest] > 1.5 * usual):
        length = float(along[-1] - along[0])
        return length / max(round(length / usual), 1), False
    if steps[widest] > 1.5 * usual:
        told = f"slices are missing between {between(widest)} ({steps[widest]:g} mm, elsewhere {usual:g} mm)"
        raise unreadable(path, told, f"give all of them, {accept}")
    if uneven:
        told = f"its slices lie from {steps.min():g} to {steps.max():g} mm apart"
        raise unreadable(path, told, f"resample it to even steps first, {accept}")
    return even, True
