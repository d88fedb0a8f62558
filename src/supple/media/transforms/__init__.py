"""Files of displacement fields and affine maps, in the conventions of the programs that use them.

In memory, all are pull maps: from a point of the output to its source point in the input. Positions and displacements
are in millimetres in LPS for volumes, and in pixels for pictures.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import NamedTuple

from supple.errors import SuppleError, argument, said, shown
from supple.media.files import PathLike, head_of, refusing, unreadable, unwritable
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS
from supple.media.transforms import affines, base, fields, itk, ngff, pictures
from supple.media.transforms.base import Content, Displacements, MissingGridError
from supple.media.transforms.itk import SUFFIXES_OUT, check_target, write_field
from supple.media.volume import nifti
from supple.space.geometry import Grid

__all__ = [
    "CONVENTIONS", "PULL", "PUSH", "SUFFIXES_OUT", "Content", "Convention", "Displacements", "MissingGridError",
    "check_convention", "check_target", "convention_in", "convention_of", "read", "write", "write_field",
]  # fmt: skip

PULL = "output point -> input point"
PUSH = "input point -> output point"


class Form(NamedTuple):
    """A file format of a convention: its suffixes, and the functions that read and write it."""

    suffixes: tuple[str, ...]
    read: Callable[[PathLike, base.Grids], tuple[Content, ...]]
    write: Callable[..., None]


class Convention(NamedTuple):
    """The meaning of the numbers in files of a program, and its file formats.

    ``affine`` is the direction of affine maps; fields are always pull maps. The first of ``forms`` is used for files
    with other suffixes. ``written`` are ``holds``, ``space`` and ``units`` on writing, if they differ.
    """

    label: str
    holds: str
    space: str
    units: str
    forms: tuple[Form, ...]
    affine: str = PULL
    written: tuple[str, str, str] | None = None


def _form(module: ModuleType, name: str, suffixes: tuple[str, ...]) -> Form:
    return Form(suffixes, partial(module.read, convention=name), partial(module.write, convention=name))


def _field(name: str, label: str, *more: str) -> Convention:
    """Return a convention of fields in millimetres, in NIfTI files and in files with the suffixes ``more``."""
    kind = fields.VECTORS[name]
    space = "FSL coordinates of the input image" if kind.space == "FSL" else kind.space
    forms = (_form(fields, name, (*fields.NIFTI, *more)),)
    return Convention(label, "positions" if kind.absolute else "displacements", space, "mm", forms)


_BOTH = "positions or displacements"
_LTA = _form(affines, "freesurfer", (".lta",))
_AFNI = _field("afni", "AFNI", *fields.DATASETS)
CONVENTIONS = {
    "itk": Convention(
        "ITK", "displacements", "LPS", "mm", (Form((*itk.TRANSFORMS, *itk.IMAGES), itk.read, itk.write),)
    ),
    "fsl-relative": _field("fsl-relative", "FSL, relative"),
    "fsl-absolute": _field("fsl-absolute", "FSL, absolute"),
    "fsl-affine": Convention(
        "FSL's FLIRT", "positions", "FSL coordinates of both images", "mm",
        (_form(affines, "fsl-affine", affines.SUFFIXES),), PUSH,
    ),
    "afni": _AFNI._replace(forms=(*_AFNI.forms, _form(affines, "afni", (".aff12.1d", ".1d")))),
    "mrtrix": _field("mrtrix", "MRtrix, deformation", *fields.MIF),
    "mrtrix-displacement": _field("mrtrix-displacement", "MRtrix, displacement", *fields.MIF),
    "freesurfer": Convention(
        "FreeSurfer", _BOTH, "RAS", "mm",
        # warps cannot be written: this ``write`` is that of .lta
        (_LTA, _form(fields, "freesurfer", (*fields.MGZ, *fields.MORPHS))._replace(write=_LTA.write)), PUSH,
        ("positions", "RAS", "mm"),
    ),
    "niftyreg": _field("niftyreg", "NiftyReg")._replace(holds=_BOTH, written=("positions", "RAS", "mm")),
    "spm-deformation": _field("spm-deformation", "SPM"),
    "ngff": Convention(
        "OME-Zarr", "displacements or positions", "LPS, or as its axes say", "mm, or as its axes say",
        (Form(ngff.SUFFIXES, ngff.read, ngff.write),), PULL, ("displacements", "LPS", "mm"),
    ),
    "opencv": Convention(
        "OpenCV's remap", "positions", "the picture", "pixels",
        (Form(pictures.REMAP, pictures.read_remap, pictures.write_remap),),
    ),
    "stmap": Convention(
        "STMap", "positions", "the picture, from its bottom left corner", "of its width and height",
        (Form(pictures.STMAP, pictures.read_stmap, pictures.write_stmap),),
    ),
}  # fmt: skip
"""The conventions by name."""
_SUFFIXES = tuple({suffix for row in CONVENTIONS.values() for form in row.forms for suffix in form.suffixes})
_DOUBTFUL = dict.fromkeys((".npy", ".npz"), "a map of positions, as of OpenCV's")
_DOUBTFUL |= dict.fromkeys((".tif", ".tiff", ".png"), "an STMap")
"""Suffixes of files that may hold a map or something else, so that the convention must be given."""
_WARPS = (2006, 2018)  # intent codes of FNIRT and topup
_COLOURS = (128, 2304)  # the datatypes RGB24 and RGBA32 of NIfTI


def form_of(path: PathLike, convention: str) -> Form:
    """Return the format of a file in a convention; SuppleError if there is no such convention."""
    check_convention(convention)
    forms = CONVENTIONS[convention].forms
    suffix = base.suffix_of(path, _SUFFIXES)
    return next((form for form in forms if suffix in form.suffixes), forms[0])


def check_convention(convention: str, name: str = "convention") -> None:
    """Raise SuppleError for an unknown convention; ``name`` is the argument's name in the message."""
    if convention not in CONVENTIONS:
        raise SuppleError(f"{argument(name)} must be one of {', '.join(CONVENTIONS)}, found {shown(str(convention))}")


def convention_of(path: PathLike) -> str:
    """Return the convention of a file to write; SuppleError if its suffix has several conventions, or none."""
    return _only(path, _candidates(path, "write"), "its suffix does not say in which convention to write", "write")


def convention_in(path: PathLike) -> str:
    """Return the convention of an existing file; SuppleError if several are possible."""
    names, what = _candidates(path, "read"), ""
    suffix = base.suffix_of(path, _SUFFIXES)
    if suffix in fields.NIFTI:
        names, what = _in_nifti(path)
    elif suffix in affines.SUFFIXES:
        names, what = _in_text(path, suffix, names)
    elif len(names) > 1:
        what = "it may hold positions or displacements"
    return _only(path, names, what, "read")


def _candidates(path: PathLike, verb: str) -> tuple[str, ...]:
    suffix = base.suffix_of(path, _SUFFIXES)
    refused = unreadable if verb == "read" else unwritable
    names = tuple(name for name, row in CONVENTIONS.items() if any(suffix in form.suffixes for form in row.forms))
    if verb == "write" and suffix in PICTURES and suffix not in pictures.STMAP_OUT:
        names = ()
    doubtful = suffix in _DOUBTFUL and (verb == "read" or suffix in pictures.STMAP_OUT)
    if (doubtful or not names) and verb == "read" and not os.path.exists(path):
        raise unreadable(path, "No such file or directory", "check the name and its rights")
    if doubtful:
        raise refused(
            path, f"it is not always {_DOUBTFUL[suffix]}", f"give {argument('convention', names[0])} if it is"
        )
    if not names and (suffix in CLIPS or suffix in PICTURES):
        what = f"the suffix {suffix} is of a {'clip' if suffix in CLIPS else 'picture'}, and of no field"
        raise refused(path, what, "name a file of a field or of an affine map")
    if not names:
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise refused(path, f"{found} tells no convention", f"give {argument('convention', 'NAME')}, or another name")
    return names


def _only(path: PathLike, names: tuple[str, ...], what: str, verb: str) -> str:
    if len(names) > 1:
        raise SuppleError(
            f"cannot {verb} {shown(path)}: {what}: give {argument('convention', 'NAME')}: {', '.join(names)}"
        )
    return names[0]


def _in_nifti(path: PathLike) -> tuple[tuple[str, ...], str]:
    header, sizes, components, series = nifti.outline(path)
    code, five = int(header["intent_code"]), components > 1
    name = fields.announced(path, header)
    if five and (code == fields.VECTOR or (name and not code)):
        return (name or "itk",), ""
    if int(header["datatype"]) in _COLOURS:
        raise unreadable(path, "its voxels are colours (RGB), as of a picture", "give a field of float32 or float64")
    count = sizes[3] if series else components
    base.check_count(path, count)
    if code == itk.DISPLACEMENT:
        return ("itk",), ""
    what = f"it holds {count} values for each voxel, of the intent code {code}"
    if code in _WARPS:
        return ("fsl-relative", "fsl-absolute"), what
    what = f"{what}, which several programs write"
    if five:
        return ("afni", "spm-deformation"), what
    return ("fsl-relative", "fsl-absolute", "mrtrix", "mrtrix-displacement", "afni"), what


def _in_text(path: PathLike, suffix: str, names: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    head = head_of(path, base.TEXT)
    base.check_text(path, head)
    if b"#Insight Transform File" in head or b"Transform_" in head:
        return ("itk",), ""
    return ("fsl-affine",) if suffix == ".mat" and b"\0" not in head else names, "its text does not tell what it is"


def read(
    path: PathLike, convention: str | None = None, *, source: Grid | None = None, reference: Grid | None = None
) -> tuple[Content, ...]:
    """Return the matrices and fields of a file, to apply in order to a point of the output.

    The convention is one of `CONVENTIONS`; by default, it is inferred from the name and the content of the file. FSL's
    fields need the grid of the input (moving) image, ``source``; its affine maps also that of the output (fixed) image,
    ``reference``. SuppleError if the convention is unknown or ambiguous, a grid is missing that it needs, or the file
    holds no such map.
    """
    name = convention_in(path) if convention is None else convention
    form, what = form_of(path, name), f"it is damaged, or no file of the convention {name}"
    kinds = ValueError, LookupError, OverflowError, struct.error
    with refusing(lambda error: unreadable(path, f"{what} ({said(error)})", "check its name and convention"), *kinds):
        contents = form.read(path, base.Grids(source, reference))
    if any(isinstance(each, Displacements) and each.grid.shear for each in contents):
        raise unreadable(path, "the axes of its grid are not at right angles to each other", "resample it first")
    return contents


def write(
    path: PathLike,
    contents: Sequence[Content],
    convention: str | None = None,
    *,
    source: Grid | None = None,
    reference: Grid | None = None,
    force: bool = False,
) -> None:
    """Write maps to a file, which appears whole or not at all.

    Arguments are as in `read`; by default, the convention is the only one of the suffix. Only ``.h5``, ``.tfm`` and
    ``.zarr`` hold more than one map. The continuation of a field beyond its grid is not stored: the reading program
    decides. SuppleError if the convention cannot hold these maps, or the file cannot be written.
    """
    name = convention_of(path) if convention is None else convention
    form_of(path, name).write(path, contents, base.Grids(source, reference), force=force)
