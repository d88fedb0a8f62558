"""Which convention a file has, where its name and content leave no doubt."""

from __future__ import annotations

import os
from pathlib import Path

from supple.errors import SuppleError, argument, shown
from supple.media import image
from supple.media.files import PathLike, head_of, unreadable, unwritable
from supple.media.suffixes import CLIPS
from supple.media.transforms.base import TEXT, VECTOR, announced, check_code, check_count, check_text, suffix_of
from supple.media.volume import nifti

_FSL = ("fsl-relative", "fsl-absolute")
_MRTRIX = ("mrtrix", "mrtrix-displacement")
_WARPS = (2006, 2018)  # of FNIRT and topup
_NIFTI = (".nii", ".nii.gz")
_COLOURS = (128, 2304)  # the datatypes RGB24 and RGBA32 of NIfTI
# the conventions of a suffix
_SUFFIXES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys((".h5", ".hdf5", ".tfm", ".mha", ".mhd", ".nrrd", ".nhdr"), ("itk",)),
    **dict.fromkeys(_NIFTI, ("itk", *_FSL, *_MRTRIX, "afni", "niftyreg", "spm-deformation")),
    **dict.fromkeys((".mif", ".mif.gz"), _MRTRIX),
    **dict.fromkeys((".mat", ".txt"), ("itk", "fsl-affine")),
    **dict.fromkeys((".aff12.1d", ".1d", ".head", ".brik", ".brik.gz"), ("afni",)),
    ".exr": ("stmap",),
    ".zarr": ("ngff",),
    **dict.fromkeys((".npy", ".npz", ".xml", ".yml", ".yaml"), ("opencv",)),
    **dict.fromkeys((".lta", ".m3z", ".m3d", ".mgz", ".mgh"), ("freesurfer",)),
}
# what holds maps of one convention, and as often something else: the convention is given
_NAMED = {
    **dict.fromkeys(
        (".npy", ".npz"),
        ("opencv", "its numbers may be positions, as of OpenCV's maps, or displacements", "if they are positions"),
    ),
    **dict.fromkeys((".tif", ".tiff", ".png"), ("stmap", "it may be an STMap, or any other picture", "if it is one")),
}
_WRITTEN = (".npy", ".npz")  # of these, what is written is of one convention


def convention_of(path: PathLike) -> str:
    """Return the convention of a file to write; SuppleError if its suffix is of more than one, or of none."""
    return _only(path, _candidates(path, "write"), "its suffix does not say in which convention to write", "write")


def convention_in(path: PathLike) -> str:
    """Return the convention of a file; SuppleError if it may have more than one."""
    known = _candidates(path, "read")
    if len(known) > 1:
        suffix = suffix_of(path, tuple(_SUFFIXES))
        what, known = _in_nifti(path) if suffix in _NIFTI else _in_text(path, known)
    else:
        what = ""
    return _only(path, known, what, "read")


def _candidates(path: PathLike, verb: str) -> tuple[str, ...]:
    suffix = suffix_of(path, tuple(_SUFFIXES))
    refused = unreadable if verb == "read" else unwritable
    if (suffix in _NAMED or suffix not in _SUFFIXES) and verb == "read" and not os.path.exists(path):
        raise unreadable(path, "No such file or directory", "check the name and its rights")
    if suffix in _NAMED and not (verb == "write" and suffix in _WRITTEN):
        name, what, fits = _NAMED[suffix]
        if verb == "read":
            raise refused(path, what, f"give {argument('convention', name)} {fits}")
        raise refused(path, "a picture is not always an STMap", f"give the convention: {name}")
    known = _SUFFIXES.get(suffix)
    if known is None:
        if suffix in CLIPS or suffix in image.SUFFIXES:
            what = f"the suffix {suffix} is of a {'clip' if suffix in CLIPS else 'picture'}, and of no field"
            raise refused(path, what, "name a file of a field or of an affine map")
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise refused(path, f"{found} tells no convention", "give the convention, or another name")
    return known


def _only(path: PathLike, known: tuple[str, ...], what: str, verb: str) -> str:
    if len(known) > 1:
        raise SuppleError(f"cannot {verb} {shown(path)}: {what}: give the convention: {', '.join(known)}")
    return known[0]


def _in_nifti(path: PathLike) -> tuple[str, tuple[str, ...]]:
    header, sizes, components, series = nifti.outline(path)
    code, five = int(header["intent_code"]), components > 1
    known = announced(path, header)
    if five and (code == VECTOR or (known and not code)):
        return "", (known or "itk",)
    check_code(path, code)
    if int(header["datatype"]) in _COLOURS:
        raise unreadable(path, "its voxels are colours (RGB), as of a picture", "give a field of float32 or float64")
    count = sizes[3] if series else components
    check_count(path, count)
    if code == 1006:
        return "", ("itk",)
    what = f"it holds {count} values for each voxel, of the intent code {code}"
    if code in _WARPS:
        return what, _FSL
    return f"{what}, which several programs write", (("afni", "spm-deformation") if five else (*_FSL, *_MRTRIX, "afni"))


def _in_text(path: PathLike, known: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    head = head_of(path, TEXT)
    check_text(path, head)
    if "itk" in known:
        if b"#Insight Transform File" in head or b"Transform_" in head:
            return "", ("itk",)
        what = "its text does not tell what it is"
        return what, ("fsl-affine",) if Path(path).suffix.lower() == ".mat" and b"\0" not in head else known
    return "it may hold positions or displacements", known
