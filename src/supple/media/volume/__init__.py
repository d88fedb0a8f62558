"""Volume files: NIfTI, NRRD, MetaImage, .mgz, DICOM series, stacks of TIFF pages, and voxels without a header."""

from __future__ import annotations

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument, shown
from supple.media.files import PathLike, check_output, check_suffix, head_of, is_zarr, unreadable, unwritable
from supple.media.suffixes import FORMATS, is_volume, suffix_of
from supple.media.suffixes import VOLUMES as SUFFIXES
from supple.media.suffixes import VOLUMES_OUT as SUFFIXES_OUT
from supple.media.volume import derived
from supple.media.volume import pages as stack
from supple.media.volume import raw as voxels
from supple.media.volume.data import DTYPES, Array, RawLayout, Volume, rescaled, rescaled_dtype
from supple.media.volume.pages import has_pages
from supple.space.geometry import SIDES

__all__ = [
    "SUFFIXES", "SUFFIXES_OUT", "RawLayout", "Volume", "check_target", "has_pages", "info", "is_dicom", "is_volume",
    "outline_of", "read", "suffix_of", "write",
]  # fmt: skip

_QUICK = 1 << 31  # bytes up to which `info` computes the range
_KINDS = (
    "give NIfTI, NRRD, MetaImage, .mgz, DICOM, a TIFF or a .dat file, or tell what is in it (--shape, --dtype, "
    "--spacing)"
)


def is_dicom(path: PathLike) -> bool:
    """Return whether a file or folder is a volume in DICOM."""
    return is_volume(path) and not is_zarr(path) and _format(path) == "DICOM"


def read(
    path: PathLike,
    *,
    raw: RawLayout | None = None,
    series: str | None = None,
    irregular: str | None = None,
    header_only: bool = False,
) -> Volume:
    """Read a volume; where possible, uncompressed data are memory-mapped (NIfTI, .dat, files without a header).

    Parameters
    ----------
    path : str or os.PathLike
        A file; or a folder of DICOM slices, or one of them.
    raw : RawLayout, optional
        The layout of a file without a header; if given, it applies to files of any suffix.
    series : str, optional
        The series of a folder with several: its SeriesInstanceUID, or its number in the list, from 1.
    irregular : str, optional
        Missing or unevenly spaced DICOM slices are an error by default; ``"resample"`` interpolates the slices linearly
        along the stack, at even steps, with a warning.
    header_only : bool
        Whether to leave out the samples, which are 0 then, and take no memory, where the header alone is read: not of
        DICOM and TIFF, as each slice has a header of its own.

    Raises
    ------
    SuppleError
        If the file is missing, empty, cut short, damaged, or of an unknown kind; its voxels are not real numbers, or
        not on a regular grid with a spacing above 0.
    """
    form = "raw" if raw is not None else _format(path)
    given = {"series": series, "irregular": irregular}
    for name, value in given.items():
        if value is not None and form != "DICOM":
            raise SuppleError(f"{shown(path)} is {form}, and {argument(name)} is for DICOM folders: leave it out")
    if form == "raw":
        return voxels.read_dat(path) if raw is None and suffix_of(path) == ".dat" else voxels.read(path, raw)
    options = given if form == "DICOM" else {"header_only": header_only}
    return _module(form).read(path, **({} if form == "TIFF" else options))  # type: ignore[no-any-return]


def outline_of(path: PathLike, **how: Any) -> Volume:
    """Return a volume as `read` does, whose samples have the right shape and dtype, but are 0, and take no memory."""
    known = read(path, header_only=True, **how)
    return replace(known, samples=np.broadcast_to(np.zeros((), known.samples.dtype), known.samples.shape))


def _module(form: str) -> Any:
    names = {"TIFF": "pages", "DICOM": "dicom", "NIfTI": "nifti", "MGH": "mgh"}
    return import_module(f"supple.media.volume.{names.get(form, 'itk')}")


def _format(path: PathLike) -> str:
    suffix = suffix_of(path)
    if os.path.isdir(path):
        if is_zarr(path):
            raise unreadable(path, "it is a Zarr store", "use info, plan, points, or warp to another store")
        return "DICOM"
    if suffix in stack.SUFFIXES:
        return "TIFF"
    if suffix in FORMATS:
        return FORMATS[suffix]
    head = head_of(path, 132)
    if head[128:] == b"DICM":
        return "DICOM"
    raise unreadable(path, "it is no volume of a known kind", _KINDS)


def check_target(
    path: PathLike, like: Volume | None = None, dtype: npt.DTypeLike | None = None, *, force: bool = False
) -> None:
    """Raise SuppleError, before any work, if a volume like this, with another dtype, cannot be written under a name.

    Without ``like``, only the name is checked. The ``.raw`` beside a ``.mhd``, and a ``.dcm``, may exist only with
    ``force``. Also see `check_output`.
    """
    suffix = suffix_of(path)
    if suffix in derived.SUFFIXES and like is not None and like.format == "DICOM":
        derived.check(path, like, force=force)
        return
    what = "is no format that volumes are written in"
    advice = f"use {', '.join(SUFFIXES_OUT)}; supple render and supple plot draw pictures"
    if suffix == ".dcm":  # a source in DICOM was checked above
        what = "is for what is derived from DICOM, and the source is of another format"
    elif FORMATS.get(suffix) == "DICOM":
        advice = f"from DICOM, give a folder for slices, which is a name without suffix, or .dcm; else {advice}"
    check_suffix(path, suffix, SUFFIXES_OUT, what, advice)
    if suffix == ".mhd":
        check_output(Path(os.path.realpath(path)).with_suffix(".raw"), force=force)
    if like is None:
        return
    known = np.dtype(like.samples.dtype if dtype is None else dtype)
    if not suffix.startswith(".nii"):
        known = rescaled_dtype(known, like.scaling)
    module = _module("TIFF" if suffix in stack.SUFFIXES else FORMATS[suffix])
    if hasattr(module, "check"):
        module.check(path, like, known)
    elif known.name not in DTYPES:
        raise unwritable(path, f"volumes hold no {known} values", f"use one of {', '.join(DTYPES)}")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a volume in the format of the suffix; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        A file with one of `SUFFIXES_OUT`. Derived DICOM is written to a folder if the source is a series of slices, and
        to a ``.dcm`` if it is a multi-frame file. The data of a ``.mhd`` are written to a ``.raw`` of the same name.
    samples : ndarray
        The shape is that of ``like.samples``; ``like.scaling`` applies. Formats other than NIfTI store scaled values,
        in float32 or float64.
    like : Volume
        The source of the geometry; and of the header, if the format is the same.
    force : bool
        Whether to replace an existing file.
    """
    check_target(path, like, samples.dtype, force=force)
    if samples.shape != like.samples.shape:
        what = f"the samples are of {samples.shape}, and {like.name} is of {like.samples.shape}"
        raise unwritable(path, what, "make them alike")
    suffix = suffix_of(path)
    module = derived if suffix in derived.SUFFIXES else _module(FORMATS.get(suffix, "TIFF"))
    scaled = module is derived or suffix.startswith(".nii")
    module.write(path, samples if scaled else rescaled(samples, like.scaling), like, force=force)


def info(path: PathLike, **how: Any) -> dict[str, object]:
    """Return the facts on a volume, with the options of `read`.

    Returns
    -------
    dict
        ``unit`` (of scaled values, for a dose), ``format``, ``shape`` (x, y, z), ``dtype``, ``components``,
        ``times``, ``interval`` (s), ``spacing`` (mm), ``origin`` and ``direction`` (rows; in the file's own
        ``convention``), ``orientation`` (axis directions: Right or Left, Anterior or Posterior, Superior or Inferior),
        ``oblique`` (degrees off that), ``shear`` (degrees by which the axes miss right angles to each other),
        ``scaling`` (slope and intercept), ``minimum``, ``maximum`` and ``nan`` (of the samples as stored; None if there
        are more than 2 GiB), and ``bytes`` (of the samples). For a folder with several series, if none is named:
        ``format`` and ``series``, each with ``number``, ``uid``, ``description`` and ``slices``.
    """
    if how.get("raw") is None and how.get("series") is None and os.path.isdir(path):
        from supple.media.volume import dicom

        found = dicom.listed(path)
        if len(found) > 1:
            kinds = [
                {"number": k, "uid": one.uid, "description": one.description, "slices": len(one.paths)}
                for k, one in enumerate(found, 1)
            ]
            return {"format": "DICOM", "series": kinds}
    volume = read(path, **how)
    samples, geometry = volume.samples, volume.geometry
    low, high, nans = _range(samples) if samples.nbytes <= _QUICK else (None, None, None)
    unit = {}
    if volume.format == "DICOM" and volume.scaling != (1.0, 0.0):
        from supple.media.volume import dicom

        unit = {"unit": dicom.dose_unit(volume.header if isinstance(volume.header, str) else volume.header[0])}
    axes = ((int(np.abs(column).argmax()), column) for column in geometry.direction.T)
    letters = "".join(SIDES[axis][int(column[axis] <= 0)] for axis, column in axes)
    flip = np.array([-1, -1, 1] if geometry.convention == "RAS" else [1, 1, 1])
    return {
        "format": volume.format,
        "shape": list(volume.sizes),
        "dtype": str(samples.dtype),
        "components": volume.components,
        "times": len(samples) if volume.series else 1,
        "interval": volume.interval if volume.series else None,
        "spacing": list(geometry.spacing),
        "origin": (flip * geometry.origin + 0.0).tolist(),
        "direction": (flip[:, None] * geometry.direction + 0.0).tolist(),
        "convention": geometry.convention,
        "orientation": letters if geometry.convention != "array" else None,
        "oblique": geometry.oblique,
        "shear": geometry.shear,
        "scaling": list(volume.scaling),
        **unit,
        "minimum": low,
        "maximum": high,
        "nan": nans,
        "bytes": samples.nbytes,
    }


def _range(samples: Array) -> tuple[float | None, float | None, int]:
    """Return the least and the greatest number, and the count of NaNs."""
    nans = sum(int(np.isnan(slab).sum()) for slab in samples) if samples.dtype.kind == "f" else 0
    if nans == samples.size:
        return None, None, nans
    return np.fmin.reduce(samples, axis=None).item(), np.fmax.reduce(samples, axis=None).item(), nans
