"""Volumes as files: NIfTI, NRRD, MetaImage, DICOM series, stacks of TIFF pages, and voxels without a header."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.media.files import PathLike, check_output, check_suffix, head_of, unreadable, unwritable
from supple.media.volume import pages as stack
from supple.media.volume import raw
from supple.media.volume.data import (
    DTYPES,
    Array,
    RawLayout,
    Volume,
    rescaled,
    rescaled_dtype,
)
from supple.media.volume.pages import has_pages

__all__ = [
    "SUFFIXES",
    "SUFFIXES_OUT",
    "RawLayout",
    "Volume",
    "check_target",
    "has_pages",
    "info",
    "is_volume",
    "read",
    "suffix_of",
    "write",
]

_FORMATS = {
    **dict.fromkeys((".nii", ".nii.gz", ".hdr", ".img"), "NIfTI"),
    **dict.fromkeys((".nrrd", ".nhdr"), "NRRD"),
    **dict.fromkeys((".mha", ".mhd"), "MetaImage"),
    **dict.fromkeys((".dcm", ".dicom", ".ima"), "DICOM"),
    **dict.fromkeys((".dat", ".raw"), "raw"),
}
SUFFIXES = frozenset(_FORMATS)
SUFFIXES_OUT: tuple[str, ...] = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".tif", ".tiff")
_QUICK = 1 << 31  # bytes whose range is told unasked
_KINDS = (
    "give NIfTI, NRRD, MetaImage, DICOM, a TIFF or a .dat file, or tell what is in it (--shape, --dtype, --spacing)"
)


def suffix_of(path: PathLike) -> str:
    """The end of a name that tells its format, in small letters: ``.nii.gz``, ``.mha``, ... or nothing."""
    name = Path(path).name.lower()
    return ".nii.gz" if name.endswith(".nii.gz") else Path(name).suffix


def is_volume(path: PathLike) -> bool:
    """Tell whether a file or folder is a volume: by its suffix, or, without one, by its first bytes.

    A folder is one if it holds DICOM files. Of TIFFs, `has_pages` tells. A picture by Radiance, whose suffix is
    ``.hdr`` too, is none.
    """
    suffix = suffix_of(path)
    if os.path.isdir(path):
        from supple.media.volume import dicom

        return dicom.in_folder(path)
    if suffix == ".hdr":
        try:
            return not head_of(path, 2).startswith(b"#?")
        except SuppleError:
            return True
    if suffix in SUFFIXES or (suffix and not suffix[1:].isdigit()):
        return suffix in SUFFIXES
    from supple.media.volume import dicom

    return dicom.is_slice(path)


def read(path: PathLike, *, raw: RawLayout | None = None, series: str | None = None) -> Volume:
    """Read a volume; what is not compressed is mapped from the file where that can be (NIfTI, .dat, headerless).

    Parameters
    ----------
    path : str or os.PathLike
        A file; or a folder of DICOM slices, or one of them.
    raw : RawLayout, optional
        What is in a file without a header; whatever its suffix, it is then read as one.
    series : str, optional
        Of a folder with several series, which: its SeriesInstanceUID, or its place in the list, from 1.

    Returns
    -------
    Volume
        `samples` of shape (Z, H, W), (Z, H, W, C) or (T, Z, H, W).

    Raises
    ------
    SuppleError
        The file is missing, empty, cut short, damaged, or of no known kind; its voxels are no real numbers, or not on
        a grid with right angles and a spacing above 0.
    """
    if raw is not None:
        return _raw(path, raw)
    form = _format(path)
    if form == "NIfTI":
        from supple.media.volume import nifti

        return nifti.read(path)
    if form == "DICOM":
        from supple.media.volume import dicom

        return dicom.read(path, series)
    if form == "TIFF":
        return stack.read(path)
    if form == "raw":
        return _raw(path, None)
    from supple.media.volume import itk

    return itk.read(path, form)


def _raw(path: PathLike, layout: RawLayout | None) -> Volume:
    return raw.read_dat(path) if layout is None and suffix_of(path) == ".dat" else raw.read(path, layout)


def _format(path: PathLike) -> str:
    suffix = suffix_of(path)
    if os.path.isdir(path):
        return "DICOM"
    if suffix in stack.SUFFIXES:
        return "TIFF"
    if suffix in _FORMATS:
        return _FORMATS[suffix]
    head = head_of(path, 132)
    if head[128:] == b"DICM":
        return "DICOM"
    raise unreadable(path, "it is no volume of a known kind", _KINDS)


def check_target(
    path: PathLike, like: Volume | None = None, dtype: npt.DTypeLike | None = None, *, force: bool = False
) -> None:
    """Refuse a name that no volume can be written under, or not this one, before any work is done for it.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write; of it, and of its folder, `check_output` tells.
    like : Volume, optional
        What is to be written is of its shape; without it, the name alone is looked at.
    dtype : dtype, optional
        The type of what is to be written, if it is another.
    force : bool
        Whether the ``.raw`` beside a ``.mhd`` may be replaced.

    Raises
    ------
    SuppleError
        The suffix is not in `SUFFIXES_OUT`; beside a ``.mhd`` is a ``.raw``; the format cannot hold such a volume.
    """
    suffix = suffix_of(path)
    advice = f"use {', '.join(SUFFIXES_OUT)}"
    check_suffix(path, suffix, SUFFIXES_OUT, "is no format that volumes are written in", advice)
    if suffix == ".mhd":
        check_output(Path(os.path.realpath(path)).with_suffix(".raw"), force=force)
    if like is None:
        return
    known = np.dtype(like.samples.dtype if dtype is None else dtype)
    if not suffix.startswith(".nii"):
        known = rescaled_dtype(known, like.scaling)
    if suffix in stack.SUFFIXES:
        stack.check(path, like, known)
    elif known.name not in DTYPES:
        raise unwritable(path, f"volumes hold no {known} values", f"use one of {', '.join(DTYPES)}")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a volume in the format that the suffix names; the file appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        One of `SUFFIXES_OUT`. Beside a ``.mhd``, its data goes into a ``.raw`` of the same name.
    samples : ndarray
        Of the shape of ``like.samples``, and meant as they are: scaled by ``like.scaling``. It may be mapped from a
        file. Formats other than NIfTI know no scaling, and get what is meant in float32 or float64.
    like : Volume
        Where it lies; and what else the header says, if the format is the same.
    force : bool
        Whether to replace a file that exists.

    Raises
    ------
    SuppleError
        The format cannot hold it, or the file cannot be written.
    """
    check_target(path, like, samples.dtype, force=force)
    check_output(path, force=force)
    if samples.shape != like.samples.shape:
        what = f"the samples are of {samples.shape}, and {like.name} is of {like.samples.shape}"
        raise unwritable(path, what, "make them alike")
    suffix = suffix_of(path)
    if suffix.startswith(".nii"):
        from supple.media.volume import nifti

        nifti.write(path, samples, like, force=force)
        return
    meant = rescaled(samples, like.scaling)
    if suffix in stack.SUFFIXES:
        stack.write(path, meant, like, force=force)
        return
    from supple.media.volume import itk

    itk.write(path, meant, like, force=force)


def info(path: PathLike, *, raw: RawLayout | None = None, series: str | None = None) -> dict[str, object]:
    """Tell what a volume is.

    Returns
    -------
    dict
        ``format``, ``shape`` (x, y, z), ``dtype``, ``components``, ``times``, ``interval`` (s), ``spacing`` (mm),
        ``origin`` and ``direction`` (rows; in the file's own ``convention``), ``orientation`` (where each axis goes:
        Right or Left, Anterior or Posterior, Superior or Inferior), ``oblique`` (degrees off that), ``scaling`` (slope
        and intercept), ``minimum``, ``maximum`` and ``nan`` (of the samples as stored; None if there are more than
        2 GiB), and ``bytes`` (of the samples). Of a folder with several series, if none is named: ``format`` and
        ``series``, each with ``number``, ``uid``, ``description`` and ``slices``.

    Raises
    ------
    SuppleError
        As `read` does.
    """
    if raw is None and series is None and os.path.isdir(path):
        from supple.media.volume import dicom

        found = dicom.listed(path)
        if len(found) > 1:
            kinds = [
                {"number": k, "uid": one.uid, "description": one.description, "slices": len(one.paths)}
                for k, one in enumerate(found, 1)
            ]
            return {"format": "DICOM", "series": kinds}
    volume = read(path, raw=raw, series=series)
    samples, geometry = volume.samples, volume.geometry
    low, high, nans = _range(samples) if samples.nbytes <= _QUICK else (None, None, None)
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
        "orientation": _orientation(geometry.direction) if geometry.convention != "array" else None,
        "oblique": geometry.oblique,
        "scaling": list(volume.scaling),
        "minimum": low,
        "maximum": high,
        "nan": nans,
        "bytes": samples.nbytes,
    }


def _orientation(direction: Array) -> str:
    """Where the axes go, of directions in LPS."""
    letters = []
    for column in direction.T:
        axis = int(np.abs(column).argmax())
        letters.append(("RAI", "LPS")[int(column[axis] > 0)][axis])
    return "".join(letters)


def _range(samples: Array) -> tuple[float | None, float | None, int]:
    """The least and the greatest number, slab by slab, and how many are none."""
    low, high, nans = np.inf, -np.inf, 0
    for slab in samples:
        known = slab
        if samples.dtype.kind == "f" and (bad := np.isnan(slab)).any():
            nans += int(bad.sum())
            known = slab[~bad]
        if known.size:
            low, high = min(low, known.min()), max(high, known.max())
    if nans == samples.size:
        return None, None, nans
    return samples.dtype.type(low).item(), samples.dtype.type(high).item(), nans
