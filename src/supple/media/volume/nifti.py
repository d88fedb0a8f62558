"""NIfTI files: nibabel reads the header; voxels are memory-mapped, or read into memory."""

from __future__ import annotations

import contextlib
import gzip
import math
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from supple.errors import VolumeWarning, needed, shown, warn
from supple.media.files import PathLike, head_of, replacing, unreadable
from supple.media.volume.data import (
    DTYPES,
    TO_RAS,
    Array,
    Volume,
    check_spacing,
    located,
    native,
    placed,
    reading,
    too_large,
)
from supple.space.geometry import Geometry

_GZIP = b"\x1f\x8b"
_MILLIMETRES = {1: 1000.0, 3: 0.001}  # by unit code: metre, micrometre
_SECONDS = {16: 1e-3, 24: 1e-6}
_COLOURS = {128: 3, 2304: 4}  # RGB24, RGBA32
_VECTOR = 1007  # the intent of a vector for each voxel
LONGEST = 32_767  # an axis in the first version of the format
_CHUNK = 1 << 22
_SAME = 0.01  # of a voxel: the largest difference of qform and sform by rounding


def imported() -> Any:
    """Return nibabel, imported at the first use.

    pydicom is hidden during the import: nibabel would import it for a rare extension of NIfTI, which takes seven times
    as long as nibabel itself. Without it, these extensions are bytes, which are copied.
    """
    hidden = not sys.modules.keys() & {"nibabel", "pydicom"}
    if hidden:
        sys.modules["pydicom"] = None  # type: ignore[assignment]
    try:
        return needed("volume", "NIfTI files", "nibabel")
    finally:
        if hidden:
            del sys.modules["pydicom"]


def read(path: PathLike, *, header_only: bool = False) -> Volume:
    """Read a NIfTI file, or a pair of .hdr and .img; uncompressed data are mapped.

    The geometry is that of the sform if it has a code, else of the qform. If both have one and they differ, ITK's
    choice is used, or the sform if it is sheared, as a qform cannot be; a warning names it. A warning also says if the
    voxel sizes of a single sform differ from pixdim. Without a code, the spacing is known, but no position in space.
    With ``header_only``, samples are 0, and take no memory.
    """
    first, data = _pair(path)
    header, single = _header(first)
    sizes, components, series = _axes(path, header)
    dtype, colours = _dtype(path, header), _COLOURS.get(int(header["datatype"]), 0)
    if colours and (series or components > 1):
        raise unreadable(path, "it is a series or a field of colours", "give one volume of colours")
    after = (components,) if components > 1 else (colours,) if colours else ()
    units = int(header["xyzt_units"])
    step = float(header["pixdim"][4]) * _SECONDS.get(units & 0x38, 1.0)
    outline = Volume(
        np.broadcast_to(np.zeros((), dtype.newbyteorder("=")), sizes[::-1] if series else (*sizes[2::-1], *after)),
        _geometry(path, first, header, sizes[:3], _MILLIMETRES.get(units & 7, 1.0)),
        shown(path),
        "NIfTI",
        series,
        header,
        (1.0, 0.0) if colours else _scaling(path, header),
        step if series and 0 < step < np.inf else 1.0,
    )
    if header_only:
        return outline
    try:
        offset = int(header["vox_offset"])
    except (ValueError, OverflowError) as error:
        raise unreadable(path, f"its voxels begin at byte {header['vox_offset']}", "correct its header") from error
    offset = max(offset, header.single_vox_offset) if single else max(offset, 0)
    shape = (*sizes[::-1], colours) if colours else sizes[::-1]
    with reading(data):
        samples = native(_samples(data, shape, dtype, offset, colours=bool(colours)))
    if components > 1:
        samples = np.ascontiguousarray(np.moveaxis(samples.reshape(components, *shape[-3:]), 0, -1))
    return replace(outline, samples=samples.reshape(outline.samples.shape))


def outline(path: PathLike) -> tuple[Any, tuple[int, ...], int, bool]:
    """Return, without reading voxels: the header, sizes, number of components, and whether there is a time axis."""
    header, _ = _header(_pair(path)[0])
    return header, *_axes(path, header)


def _pair(path: PathLike) -> tuple[Path, Path]:
    """Return the files of the header and of the voxels, which may be the same."""
    file = Path(path)
    if file.suffix.lower() not in (".hdr", ".img"):
        return file, file
    upper = file.suffix.isupper()
    first, data = (file.with_suffix(s.upper() if upper else s) for s in (".hdr", ".img"))
    return first, data


def opened(path: PathLike) -> IO[bytes]:
    """Open a file for reading, unpacked if it is compressed by gzip."""
    packed = head_of(path, 2) == _GZIP  # whatever the name is
    return cast("IO[bytes]", gzip.open(path)) if packed else open(path, "rb")


def _header(path: Path) -> tuple[Any, bool]:
    """Return the header of a file, and whether the voxels are in the same file."""
    nibabel = imported()
    from nibabel.spatialimages import HeaderDataError
    from nibabel.wrapstruct import WrapStructError

    with reading(path), opened(path) as file:
        head = file.read(348)
        sizes = {int.from_bytes(head[:4], order) for order in ("little", "big")}
        magic = head[4:8] if 540 in sizes else head[344:348]
        if not sizes & {348, 540} or magic not in (b"n+1\0", b"ni1\0", b"n+2\0", b"ni2\0"):
            old = magic == bytes(4) and 348 in sizes
            what = "it is an Analyze file, which does not tell left from right" if old else "it is no NIfTI file"
            raise unreadable(path, what, "convert it to NIfTI" if old else "check its name")
        kind: Any = nibabel.Nifti2Header if 540 in sizes else nibabel.Nifti1Header
        file.seek(0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # on odd extensions, which are copied unchanged
                header = kind.from_fileobj(file, check=False)
        except (HeaderDataError, WrapStructError, ValueError) as error:
            raise unreadable(path, f"its header is damaged ({error})") from error
        return header, header["magic"] == kind.single_magic


def _axes(path: PathLike, header: Any) -> tuple[tuple[int, ...], int, bool]:
    """Return the sizes along x, y, z and time or component, the number of components, and whether there is time."""
    dim = [int(n) for n in header["dim"]]
    sizes = dim[1 : dim[0] + 1] if 1 <= dim[0] <= 7 else []
    if not sizes or min(sizes) < 1:
        raise unreadable(path, f"its header gives the sizes {dim[1:]} to {dim[0]} axes", "correct its header")
    while len(sizes) > 3 and sizes[-1] == 1:
        sizes.pop()
    sizes += [1] * (3 - len(sizes))
    if len(sizes) > 5 or (len(sizes) == 5 and sizes[3] > 1):
        told = " x ".join(map(str, sizes))
        if len(sizes) == 5 and int(header["intent_code"]) == _VECTOR:
            what = f"it holds vectors at {sizes[3]} times ({told}), as a velocity field of ANTs does"
            raise unreadable(path, what, "give the displacement field that it leads to")
        raise unreadable(path, f"it holds {told} values", "give x, y, z and either time or components")
    if len(sizes) == 5:
        return (*sizes[:3], sizes[4]), sizes[4], False
    return tuple(sizes), 1, len(sizes) == 4


def _dtype(path: PathLike, header: Any) -> np.dtype[Any]:
    from nibabel.nifti1 import data_type_codes

    code = int(header["datatype"])
    if code in _COLOURS:
        return np.dtype(np.uint8)
    known = data_type_codes.label.get(code, f"type {code}")
    if known not in DTYPES:
        raise unreadable(path, f"its voxels are of {known}", f"convert them to one of {', '.join(DTYPES)}")
    dtype: np.dtype[Any] = header.get_data_dtype()
    return dtype


def _samples(path: PathLike, shape: tuple[int, ...], dtype: np.dtype[Any], offset: int, *, colours: bool) -> Array:
    wanted = offset + dtype.itemsize * math.prod(shape)
    row = dtype.itemsize * (math.prod(shape[-2:]) if colours else shape[-1])
    with opened(path) as file:
        if isinstance(file, gzip.GzipFile):
            file.seek(offset)
            samples: Array = filled(path, file, dtype, shape, offset)
            # read to the end, where gzip verifies the checksum
            rest = sum(map(len, iter(lambda: file.read(_CHUNK), b"")))
        else:
            if (rest := os.stat(path).st_size - wanted) < 0:
                raise unreadable(path, f"its header promises {wanted} bytes, and it has {wanted + rest}")
            samples = np.memmap(path, dtype, "r", offset, shape)
    # nibabel ignores data after the voxels (test_sizes_smaller_than_the_data): a row or more, and the sizes are wrong
    if rest >= row:
        told = f"its header promises {wanted} bytes, and it has {wanted + rest}"
        raise unreadable(path, told, "correct the sizes in its header")
    return samples


def filled(path: PathLike, file: IO[bytes], dtype: np.dtype[Any], shape: Sequence[int], offset: int) -> Array:
    """Return the voxels that follow in a file after ``offset`` bytes; SuppleError if it ends early."""
    try:
        samples = np.empty(shape, dtype)
    except (MemoryError, ValueError) as error:
        raise too_large(path, tuple(shape[::-1])) from error
    flat, done = memoryview(cast("Any", samples.reshape(-1).view(np.uint8))), 0
    while done < len(flat):
        count = file.readinto(flat[done : done + _CHUNK])  # type: ignore[attr-defined]
        if not count:
            raise unreadable(path, f"its header promises {offset + len(flat)} bytes, and it has {offset + done}")
        done += count
    return samples


def _geometry(path: PathLike, first: Path, header: Any, sizes: tuple[int, ...], unit: float) -> Geometry:
    """Return the geometry of the voxels: by the sform or the qform, or by the spacing alone."""
    sform = np.array(header.get_sform(), np.float64) if header["sform_code"] > 0 else None
    qform = _qform(path, header, needed=sform is None) if header["qform_code"] > 0 else None
    steps = [unit * float(x) for x in header["pixdim"][1:4]]
    if sform is None and qform is None:
        return located(path, steps, [0.0] * 3, np.eye(3), "array")
    known, text = sform if sform is not None else qform, ""
    assert known is not None
    for form in (sform, qform):
        if form is not None:
            form[:3] *= unit
    geometry, name = placed(path, known, "RAS"), shown(path)
    others = "SimpleITK, ANTs and 3D Slicer"
    if sform is None or qform is None:
        alike = geometry.shear or np.allclose(geometry.spacing, steps, rtol=_SAME, atol=0.0)  # ITK opens no sheared one
        if sform is not None and not alike:
            own, told = ("×".join(f"{x:.4g}" for x in sizes) for sizes in (geometry.spacing, steps))
            text = f"the sform of {name} has voxels of {own} mm and its pixdim {told} mm: the sform is used; "
            text += f"{others} use pixdim"
    else:
        corners = np.array([(*corner, 1.0) for corner in np.ndindex(2, 2, 2)]) * [*(np.array(sizes) - 1), 1]

        def apart(a: Array, b: Array) -> float:
            return float(np.linalg.norm(corners @ (a - b).T, axis=1).max())

        far = apart(sform, qform)
        if far > _SAME * min(steps) and geometry.shear:
            text = (
                f"the axes of {name} miss right angles by {geometry.shear:.3g}°, which its sform holds, and no qform "
            )
            text += f"can: the sform is used; {others} use the qform, up to {far:.3g} mm off"
        elif far > _SAME * min(steps):
            # As ITK does, with which other programs read fields and landmarks; its choice depends on the codes.
            from supple.media.volume import itk

            geometry = itk.geometry_of(path, itk.informed(path, "NIfTI", first), "RAS")
            by_itk = TO_RAS @ geometry.matrix
            used = "sform" if apart(by_itk, sform) <= apart(by_itk, qform) else "qform"
            text = (
                f"the qform and the sform of {name} disagree, by up to {far:.3g} mm: the {used} is used, as by {others}"
            )
    if text:
        warn(text, VolumeWarning)
    return geometry


def _qform(path: PathLike, header: Any, *, needed: bool) -> Array | None:
    from nibabel.spatialimages import HeaderDataError

    if needed:
        check_spacing(path, [float(x) for x in header["pixdim"][1:4]])
    try:
        return np.array(header.get_qform(), np.float64)
    except (HeaderDataError, ValueError) as error:
        if needed:
            raise unreadable(path, f"its qform is damaged ({error})", "correct its header") from error
        return None


def _scaling(path: PathLike, header: Any) -> tuple[float, float]:
    slope, intercept = float(header["scl_slope"]), float(header["scl_inter"])
    if not np.isfinite(slope) or slope == 0:  # NIfTI's code for no scaling
        return 1.0, 0.0
    if not np.isfinite(intercept):
        raise unreadable(path, f"its values are scaled by {slope:g}, plus {intercept}", "correct its header")
    return slope, intercept


def write(
    path: PathLike, samples: Array, like: Volume, *, intent: tuple[int, str] | None = None, force: bool = False
) -> None:
    """Write a NIfTI file, slice by slice, compressed if its name ends in ``.gz``.

    A volume from NIfTI keeps its header and its byte order; others get their geometry as sform and qform. ``intent`` is
    the code and the name of the intent, if they are not those of a volume.
    """
    header = _copied(samples, like) or _made(samples, like)
    if intent is not None:
        header["intent_code"], header["intent_name"] = intent[0], intent[1].encode()
    colours = int(header["datatype"]) in _COLOURS
    stored = samples if colours or samples.ndim == 3 or like.series else np.moveaxis(samples, -1, 0)
    dtype = samples.dtype.newbyteorder(header.endianness)
    with replacing(path, force=force) as temporary, writing(temporary, os.fspath(path)) as file:
        header.write_to(file)
        file.write(bytes(int(header["vox_offset"]) - file.tell()))
        for slab in stored if stored.ndim == 3 or colours else (part for whole in stored for part in whole):
            file.write(np.ascontiguousarray(slab, dtype).data)


@contextlib.contextmanager
def writing(temporary: Path, name: str) -> Iterator[IO[bytes]]:
    """Open a file for writing; if its name ends in ``.gz``, it is compressed, at a low level, as low bits are noise."""
    with open(temporary, "wb") as plain:
        if not name.lower().endswith(".gz"):
            yield plain
            return
        # without name and time, so that equal volumes give equal files
        with gzip.GzipFile("", "wb", 1, plain, 0) as packed:
            yield packed  # type: ignore[misc]


def _copied(samples: Array, like: Volume) -> Any:
    """Return a copy of the header with the dtype and the grid of new samples; None if there is none for these."""
    known, sizes = like.header if like.format == "NIfTI" else None, like.sizes
    coloured = known is not None and int(known["datatype"]) in _COLOURS
    if known is None or (coloured and samples.dtype != np.uint8) or max(sizes) > np.iinfo(known["dim"].dtype).max:
        return None
    header = known.copy()
    if not coloured:
        header.set_data_dtype(samples.dtype)
    if "glmax" in header:  # the range of the source's values
        header["glmax"] = header["glmin"] = 0
    header["magic"] = header.single_magic
    header["vox_offset"] = header.single_vox_offset + header.extensions.get_sizeondisk()
    if not like.regridded:
        return header
    unit = _MILLIMETRES.get(int(header["xyzt_units"]) & 7, 1.0)
    if int(header["dim"][3]) != sizes[2] or int(header["dim"][0]) < 3:  # describe the scan of its slices
        header["slice_start"] = header["slice_end"] = header["slice_code"] = header["slice_duration"] = 0
    header["dim"][0] = max(int(header["dim"][0]), 3)
    header["dim"][1:4] = sizes
    header["pixdim"][1:4] = np.array(like.geometry.spacing) / unit
    codes = [int(header[name]) for name in ("qform_code", "sform_code")]
    if like.geometry.convention == "array":
        return header
    affine = TO_RAS @ like.geometry.matrix
    affine[:3] /= unit
    for set_form, code in zip((header.set_qform, header.set_sform), codes if any(codes) else (1, 1), strict=True):
        if code:
            set_form(affine, code)
    _check_forms(header, like)
    return header


def _check_forms(header: Any, like: Volume) -> None:
    """Remove the qform for a sheared volume, which a qform cannot describe."""
    if like.geometry.shear:
        header["qform_code"], header["sform_code"] = 0, int(header["sform_code"]) or int(header["qform_code"])


def _made(samples: Array, like: Volume) -> Any:
    nibabel = imported()

    long = max(samples.shape) > LONGEST
    kind: Any = nibabel.Nifti2Header if long else nibabel.Nifti1Header
    header = kind()
    components = samples.shape[3] if samples.ndim == 4 and not like.series else 1
    colours = samples.dtype == np.uint8 and components in _COLOURS.values()
    spacing = like.geometry.spacing
    header.set_data_dtype({3: "RGB", 4: "RGBA"}[components] if colours else samples.dtype)
    if components > 1 and not colours:
        header.set_data_shape((*like.sizes, 1, components))
        header.set_intent("vector")
    else:
        header.set_data_shape((*like.sizes, len(samples)) if like.series else like.sizes)
    header.set_zooms((*spacing, like.interval) if like.series else (*spacing, 1.0, 1.0)[: len(header.get_data_shape())])
    affine = TO_RAS @ like.geometry.matrix
    header.set_qform(affine, 1)
    header.set_sform(affine, 1)
    _check_forms(header, like)
    header.set_xyzt_units("mm", "sec")
    header["scl_slope"], header["scl_inter"] = like.scaling
    header["vox_offset"] = header.single_vox_offset
    return header
