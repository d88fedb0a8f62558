"""NRRD and MetaImage files, by SimpleITK."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import need, shown
from supple.media.files import PathLike, check_output, head_of, replacing, unreadable, unwritable
from supple.media.volume.data import DTYPES, Array, Volume, check_spacing, located, native, reading, too_large
from supple.media.volume.raw import count_bytes
from supple.space.geometry import Geometry

_LOADERS = {"NRRD": "NrrdImageIO", "MetaImage": "MetaImageIO", "DICOM": "GDCMImageIO", "NIfTI": "NiftiImageIO"}
_MILLIMETRES = {"", "???", "mm", "millimeter", "millimeters", "millimetre", "millimetres"}
# entries that ITK adds on reading or always writes
_OWN = re.compile(r"ITK_|NRRD_space$|NRRD_kinds|NRRD_sizes|NRRD_thicknesses")
# Entries about the source's voxels: smallest and largest value, also as DICOM tags, and extents of segments.
_RANGE = re.compile(r"ElementM(in|ax)$|(DICOM_)?0028[|_,]01(0[6-9]|1[01])$")
_EXTENT = re.compile(r"Segment(\d+)_Extent")
_SILENCE = threading.Lock()


def imported() -> Any:
    """Return SimpleITK, imported at the first use."""
    need("volume", "NRRD, MetaImage and DICOM files and transforms", "SimpleITK")
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)  # type: ignore[no-untyped-call]
    return SimpleITK


@contextlib.contextmanager
def silence(own: str = "") -> Iterator[None]:
    """Suppress standard error, to which ITK and OpenEXR print the messages of their exceptions.

    With ``own``, a regular expression, only matching lines are suppressed: the output of other threads is passed on.
    """
    with _SILENCE, tempfile.TemporaryFile() as caught:
        try:
            kept = os.dup(2)
        except OSError:  # standard error is closed
            yield
            return
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            caught.seek(0)
            lines = caught.readlines() if own else []
            os.write(2, b"".join(line for line in lines if not re.match(own.encode(), line)))


def read(path: PathLike, *, header_only: bool = False) -> Volume:
    """Read a NRRD or MetaImage file, with attached or detached data.

    With ``header_only``, samples take no memory, and are 0. SuppleError if it is missing, of another kind, damaged or
    cut short; if its voxels are not real numbers; or if it has more axes than x, y, z and time.
    """
    sitk, form = imported(), "NRRD" if Path(path).suffix.lower() in (".nrrd", ".nhdr") else "MetaImage"
    head = head_of(path, 4)
    if form == "NRRD" and head != b"NRRD":
        raise unreadable(path, "it is no NRRD file", "check its name")
    fields, end = _fields(path, form)
    data = _data_file(path, fields)
    reader = informed(path, form)
    check_voxels(path, reader)
    sizes, ndim = tuple(reader.GetSize()), reader.GetDimension()
    series, components = ndim == 4, reader.GetNumberOfComponents()
    if ndim > 4 or (series and components > 1):
        held = " x ".join(map(str, (*sizes, components)))
        raise unreadable(path, f"it holds {held} values", "give x, y, z and either time or components")
    _check_place(path, fields, ndim)
    placed = form == "MetaImage" or "space" in fields or "spacedimension" in fields
    geometry = geometry_of(path, reader, "LPS" if placed else "array")
    told = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys() if not _OWN.match(key)}
    # SimpleITK has no type for matrices, such as NRRD's measurement frame
    header = {key: text for key, text in told.items() if not text.startswith("[UNKNOWN")}
    kind = _kind(reader)
    letter = "f" if "float" in kind else "u" if "unsigned" in kind else "i"
    dtype = np.dtype(f"{letter}{int(re.findall(r'([0-9]+)-bit', kind)[0]) // 8}")
    shape = (*([1] if ndim < 3 else []), *sizes[::-1], *([components] if components > 1 else []))
    interval = abs(reader.GetSpacing()[3]) if series else 1.0
    outline = np.broadcast_to(np.zeros((), dtype), shape)
    found = Volume(outline, geometry, shown(path), form, series, header, _scaling(path, fields), interval)
    if header_only:
        return found
    # a NRRD counts components as an axis
    _check_data(path, data, fields, end, dtype.itemsize * (components if form == "MetaImage" else 1))
    with failing(path, form, sizes):
        samples = sitk.GetArrayFromImage(reader.Execute())
    return replace(found, samples=samples.reshape(shape))


def informed(path: PathLike, form: str, file: PathLike | None = None) -> Any:
    """Return ITK's reader of a file, with the header read; ``file`` is the header's file, if not ``path``."""
    reader = imported().ImageFileReader()
    reader.SetImageIO(_LOADERS[form])
    reader.SetFileName(os.fspath(path if file is None else file))
    with failing(path, form):
        reader.ReadImageInformation()
    return reader


def _scaling(path: PathLike, fields: dict[str, str]) -> tuple[float, float]:
    """Return the slope and the intercept in a MetaImage's header, which ITK ignores."""
    told = [fields.get(f"elementtointensityfunction{name}", usual) for name, usual in (("slope", "1"), ("offset", "0"))]
    slope, intercept = (float((_numbers(text) or [math.nan])[0]) for text in told)
    if not (math.isfinite(slope) and slope and math.isfinite(intercept)):
        raise unreadable(path, f"its values are scaled by {told[0]}, plus {told[1]}", "correct its header")
    return slope, intercept


def check_voxels(path: PathLike, reader: Any) -> None:
    """Raise SuppleError for voxels that are not real numbers."""
    kind = _kind(reader)
    if "integer" not in kind and (kind.startswith("complex") or "float" not in kind):
        raise unreadable(path, f"its voxels are {kind}", f"convert them to one of {', '.join(DTYPES)}")


def _kind(reader: Any) -> str:
    return str(imported().GetPixelIDValueAsString(reader.GetPixelID()))


def _fields(path: PathLike, form: str) -> tuple[dict[str, str], int]:
    """Return the fields of a header, by their names in lower case without spaces, and the offset of the data."""
    head = head_of(path, 1 << 20)
    stop = rb"\r?\n\r?\n" if form == "NRRD" else rb"(?m)^\s*ElementDataFile\s*[=:][^\n]*\n?"
    found = re.search(stop, head)
    end = found.end() if found else len(head)
    line = r"(?m)^([\w ]+): +([^\r\n]*)" if form == "NRRD" else r"(?m)^[ \t]*(\w+)[ \t]*[=:][ \t]*([^\r\n]*)"
    pairs = re.findall(line, head[:end].decode("latin-1"))
    return {name.lower().replace(" ", ""): text.strip() for name, text in pairs}, end


def _data_file(path: PathLike, fields: dict[str, str]) -> Path | None:
    name = fields.get("datafile", fields.get("elementdatafile", "local"))
    if name.lower() == "local":
        return Path(path)
    if name.startswith("LIST") or "%" in name:
        return None
    data = Path(path).parent / os.fsdecode(name.encode("latin-1"))
    if not data.is_file():
        raise unreadable(path, f"its data file {shown(data)} is missing", "put it there")
    return data


# ITK fills in missing voxels, and ignores surplus ones (test_sizes_other_than_those_of_the_data).
def _check_data(path: PathLike, data: Path | None, fields: dict[str, str], end: int, each: int) -> None:
    """Raise SuppleError if the data are damaged, or their size differs from the header's; ITK does not check."""
    sizes = [int(n) for n in re.findall(r"[-\d]+", fields.get("dimsize", fields.get("sizes", "")))]
    if "dimsize" in fields:
        known = "raw" if fields.get("binarydata", "true")[:1] in "Tt1" else "text"
        known = "gzip" if fields.get("compresseddata", "")[:1] in ("T", "t", "1") else known
        skipped = fields.get("headersize", "0")
    else:
        known = fields.get("encoding", "").lower()
        skipped = "0" if {fields.get("byteskip", "0"), fields.get("lineskip", "0")} == {"0"} else "-1"
    told = " x ".join(map(str, sizes))
    if data is None or known not in ("raw", "gzip", "gz") or not skipped.isdigit():
        return  # only ITK can read these
    wanted, packed = each * math.prod(sizes), None
    if known != "raw":
        packed = int("".join(re.findall(r"^\d+$", fields.get("compresseddatasize", ""))) or 0)
    whose = "" if data == Path(path) else f" of its data file {shown(data)}"
    with reading(data):
        found = count_bytes(data, int(skipped) or (end if data == Path(path) else 0), wanted, packed)
    if found != wanted:
        short = found < wanted
        count = found if short or packed is None else f"more than {wanted}"
        found_out = f"the data{whose} {'is cut short to' if short else 'has'} {count}"
        what = f"its header says {told}, {wanted} bytes, and {found_out}"
        raise unreadable(path, what, "give a whole copy of it" if short else "correct the sizes in its header")


# ITK replaces an invalid geometry by a default one (test_places_that_would_be_replaced).
def _check_place(path: PathLike, fields: dict[str, str], ndim: int) -> None:
    """Raise SuppleError for a geometry that ITK would replace: not a number, missing, or not in millimetres."""
    if "elementspacing" in fields:
        check_spacing(path, _numbers(fields["elementspacing"])[:3])
    steps = fields.get("spacings", "").split()
    if sum("nan" in step.lower() for step in steps) > max(len(steps) - ndim, 0):  # NaN for an axis not in space
        told = f"its spacing is {' x '.join(steps)}, and not three numbers above 0"
        raise unreadable(path, told, "correct its header")
    axes = re.findall(r"none|\([^)]*\)", fields.get("spacedirections", ""))
    if len(axes) > ndim and "none" in axes:
        axes.remove("none")  # the axis of components
    if "none" in axes[:3]:
        raise unreadable(path, f"its space directions are {fields['spacedirections']}", "give each axis a direction")
    # squared as in ITK, which overflows early
    check_spacing(path, [math.sqrt(sum(x * x for x in _numbers(axis))) for axis in axes[:3]])
    if not all(map(math.isfinite, _numbers(fields.get("spaceorigin", "")))):
        raise unreadable(path, f"its origin is {fields['spaceorigin']}", "correct its header")
    for unit in re.findall('"([^"]*)"', fields.get("spaceunits", ""))[:3]:
        if unit.strip().lower() not in _MILLIMETRES:
            raise unreadable(path, f"its unit of length is {unit!a}", "give its header millimetres")


def _numbers(text: str) -> list[float]:
    """Return the numbers in a text; NaN for other words."""
    known = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.I)
    return [float(word) if known.match(word) else math.nan for word in re.findall(r"[^\s,()]+", text)]


def geometry_of(path: PathLike, reader: Any, convention: str = "LPS") -> Geometry:
    """Return ITK's geometry of the voxels; flat data get a third axis of spacing 1."""
    ndim = reader.GetDimension()
    flat, direction = min(ndim, 3), np.eye(3)
    known = np.array(reader.GetDirection()).reshape(ndim, ndim)
    if ndim == 4 and (known[:3, 3].any() or known[3, :3].any()):
        raise unreadable(path, "its axis of time leans into space", "correct its header")
    direction[:flat, :flat] = known[:flat, :flat]
    spacing = [*reader.GetSpacing()[:flat], 1.0][:3]
    origin = [*reader.GetOrigin()[:flat], 0.0][:3]
    return located(path, spacing, origin, direction, convention)


@contextlib.contextmanager
def failing(path: PathLike, form: str, sizes: tuple[int, ...] = ()) -> Iterator[None]:
    """Convert ITK's errors to one sentence, and suppress its output on standard error."""
    try:
        with silence():
            yield
    except MemoryError as error:
        raise too_large(path, sizes) from error
    except (RuntimeError, UnicodeError, ValueError) as error:
        text = str(error)
        if "allocate memory" in text:
            raise too_large(path, sizes) from error
        told = _reason(text)
        what = "it is cut short or damaged" if sizes else f"it is no {form} file, or damaged"
        raise unreadable(path, f"{what}{f' ({told})' if told else ''}") from error


def _reason(text: str) -> str:
    """Return the relevant line of an error of ITK, its last without the name of the source; empty if there is none."""
    line = next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")
    line = re.sub(r"^.*ERROR: (\w+\(0x\w+\): )?", "", line)
    if line.startswith(("Reason: ", "Cannot read requested", "Unable to determine", "Exception thrown")):
        return ""  # a consequence, not the cause
    return re.sub(r"^(\[\w+\] )?(\w+: )?", "", line).rstrip(".")


def write(path: PathLike, samples: Array, like: Volume, *, packed: bool = True, force: bool = False) -> None:
    """Write a NRRD file, compressed if ``packed``, or a MetaImage file; the data of a .mhd go to a .raw beside it."""
    sitk = imported()
    target = check_output(path, force=force)
    suffix = target.suffix.lower()
    packed &= suffix == ".nrrd"
    with contextlib.ExitStack() as stack:
        made = [(stack.enter_context(replacing(path, force=force)), suffix)]
        if suffix == ".mhd":
            made.append((stack.enter_context(replacing(target.with_suffix(".raw"), force=force)), ".raw"))
        # in a temporary folder, as ITK stores the name of the data file in the header
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=".", dir=target.parent)))
        file = folder / f"{target.stem}{suffix}"
        image = _image(sitk, samples, like, "NRRD" if suffix == ".nrrd" else "MetaImage")
        try:
            with silence():
                sitk.WriteImage(image, os.fspath(file), useCompression=packed)
        except (RuntimeError, UnicodeError) as error:
            found = re.search("Reason: (.+)", str(error))
            what = (found[1] if found else _reason(str(error))) or "ITK cannot write it"
            what = "a part of it was not written" if what.startswith("fwrite") else what
            raise unwritable(path, what, "make room or choose another place") from error
        if not _whole(file.with_suffix(made[-1][1]), samples.nbytes, packed=packed):
            raise OSError(errno.EIO, "a part of it was not written")  # ITK misses errors at the end of a file
        for temporary, ending in made:
            os.replace(file.with_suffix(ending), temporary)


def _image(sitk: Any, samples: Array, like: Volume, form: str) -> Any:
    vector = samples.ndim == 4 and not like.series
    image = sitk.GetImageFromArray(native(samples), isVector=vector)
    geometry, direction = like.geometry, np.eye(image.GetDimension())
    direction[:3, :3] = geometry.direction
    image.SetSpacing((*geometry.spacing, like.interval) if like.series else geometry.spacing)
    image.SetOrigin((*geometry.origin, 0.0) if like.series else geometry.origin)
    image.SetDirection(direction.ravel().tolist())
    if like.format == form:
        for key, text in header_of(samples, like).items():
            image.SetMetaData(key, text)
    return image


def header_of(samples: Array, like: Volume) -> dict[str, str]:
    """Return the header for new samples: ranges of values are removed, and extents of segments are computed anew."""
    made = {key: text for key, text in (like.header or {}).items() if not _RANGE.match(key)}
    if like.regridded:  # this offset refers to the old grid
        made.pop("Segmentation_ReferenceImageExtentOffset", None)
    for key, k in [(found[0], found[1]) for found in map(_EXTENT.fullmatch, made) if found]:
        label, layer = (str(made.get(f"Segment{k}_{name}", usual)) for name, usual in (("LabelValue", 1), ("Layer", k)))
        del made[key]
        with contextlib.suppress(ValueError, IndexError):  # for an invalid label or layer
            mask = np.asarray((samples if samples.ndim == 3 else samples[..., int(layer)]) == int(label))
            ends = [np.flatnonzero(mask.any(axis)) for axis in ((0, 1), (0, 2), (1, 2))]
            made[key] = " ".join(f"{at[0]} {at[-1]}" if at.size else "0 -1" for at in ends)
    return made


def _whole(file: Path, nbytes: int, *, packed: bool) -> bool:
    """Return whether all voxels are in a file: gzip stores their count, modulo 2^32, at the end."""
    if not packed:
        start = _fields(file, "NRRD")[1] if file.suffix == ".nrrd" else 0
        return file.stat().st_size >= start + nbytes
    with open(file, "rb") as data:
        data.seek(-4, os.SEEK_END)
        return int.from_bytes(data.read(4), "little") == nbytes % (1 << 32)
