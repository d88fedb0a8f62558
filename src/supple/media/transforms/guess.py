"""Which convention a file has, where its name and content leave no doubt."""

from __future__ import annotations

from pathlib import Path

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, head_of
from supple.media.transforms.base import check_code, check_count, suffix_of
from supple.media.volume import nifti

_FSL = ("fsl-relative", "fsl-absolute")
_MRTRIX = ("mrtrix", "mrtrix-displacement")
_WARPS = (2006, 2018)  # of FNIRT and topup
_NIFTI = (".nii", ".nii.gz")
# the conventions of a suffix
_SUFFIXES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys((".h5", ".hdf5", ".tfm", ".mha", ".mhd", ".nrrd", ".nhdr"), ("itk",)),
    **dict.fromkeys(_NIFTI, ("itk", *_FSL, *_MRTRIX, "afni")),
    **dict.fromkeys((".mif", ".mif.gz"), _MRTRIX),
    **dict.fromkeys((".mat", ".txt"), ("itk", "fsl-affine")),
    **dict.fromkeys((".aff12.1d", ".1d", ".head", ".brik", ".brik.gz"), ("afni",)),
    ".exr": ("stmap",),
    ".zarr": ("ngff",),
    **dict.fromkeys((".npy", ".npz", ".xml", ".yml", ".yaml"), ("opencv",)),
    **dict.fromkeys((".lta", ".m3z", ".m3d", ".mgz", ".mgh"), ("freesurfer",)),
}


def convention_of(path: PathLike) -> str:
    """Return the convention of a file to write; SuppleError if its suffix is of more than one, or of none."""
    return _only(path, _candidates(path), "its suffix does not say in which convention to write", "write")


def convention_in(path: PathLike) -> str:
    """Return the convention of a file; SuppleError if it may have more than one."""
    known = _candidates(path)
    if len(known) > 1:
        suffix = suffix_of(path, tuple(_SUFFIXES))
        what, known = _in_nifti(path) if suffix in _NIFTI else _in_text(path, known)
    else:
        what = ""
    return _only(path, known, what, "read")


def _candidates(path: PathLike) -> tuple[str, ...]:
    suffix = suffix_of(path, tuple(_SUFFIXES))
    known = _SUFFIXES.get(suffix)
    if known is None:
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise SuppleError(f"cannot tell the convention of {shown(path)}: {found}: give the convention")
    return known


def _only(path: PathLike, known: tuple[str, ...], what: str, verb: str) -> str:
    if len(known) > 1:
        raise SuppleError(f"cannot {verb} {shown(path)}: {what}: give the convention: {', '.join(known)}")
    return known[0]


def _in_nifti(path: PathLike) -> tuple[str, tuple[str, ...]]:
    header, sizes, components, series = nifti.outline(path)
    code, five = int(header["intent_code"]), components > 1
    if five and code == 1007:
        return "", ("itk",)
    check_code(path, code)
    count = sizes[3] if series else components
    check_count(path, count)
    if code == 1006:
        return "", ("itk",)
    what = f"it holds {count} values for each voxel, of the intent code {code}"
    if code in _WARPS:
        return what, _FSL
    return f"{what}, which several programs write", (("afni", "itk") if five else (*_FSL, *_MRTRIX, "afni"))


def _in_text(path: PathLike, known: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    head = head_of(path, 512)
    if "itk" in known:
        if b"#Insight Transform File" in head or b"Transform_" in head:
            return "", ("itk",)
        what = "its text does not tell what it is"
        return what, ("fsl-affine",) if Path(path).suffix.lower() == ".mat" and b"\0" not in head else known
    return "it may hold positions or displacements", known
