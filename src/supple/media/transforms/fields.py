"""Displacement fields sampled on a grid, with a table of the meaning of their vectors and their tags in NIfTI.

NIfTI files of all programs are read and written; .mif of MRtrix, .HEAD with .BRIK of AFNI, and .mgz of FreeSurfer are
only read. Files of FSL do not say whether their warp is relative or absolute. Fields of NiftyReg and SPM have names in
their headers; their vectors differ from ITK's, though they share its intent code 1007 (SPM's Segment writes none). AFNI
continues a warp beyond its grid with the mean slope at its faces; here, all fields keep the displacement of the edge.
"""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from supple.engine.work import Array
from supple.errors import VolumeWarning, shown
from supple.media.files import PathLike, head_of, unreadable, unwritable
from supple.media.transforms import base
from supple.media.transforms.affines import spelled
from supple.media.volume import mgh, nifti
from supple.media.volume.data import Volume, native, reading
from supple.space.geometry import Geometry, Grid

VECTOR = 1007
"""NIfTI's intent code of a vector in each voxel."""
NIFTI = (".nii", ".nii.gz")
DATASETS, MIF, MGZ, MORPHS = (".head", ".brik", ".brik.gz"), (".mif", ".mif.gz"), (".mgz", ".mgh"), (".m3z", ".m3d")


class Vectors(NamedTuple):
    """The meaning of the vectors of a convention's fields, and the tags of its NIfTI files.

    ``space`` is the coordinate system. ``absolute`` is true for positions in the input image, false for displacements.
    ``codes`` are the intent codes that are accepted; ``axes``, ``intent`` and its ``name`` are written. ``gaps`` is the
    advice for NaN.
    """

    space: base.Space
    absolute: bool = False
    codes: tuple[int, ...] = (0,)
    axes: Literal[4, 5] = 4
    intent: int = 0
    name: str = ""
    gaps: str = base.FINITE


_MARKED = "MRtrix marks so what lies outside the input: crop the warp, or fill these voxels"
_OUTSIDE = "such voxels lie outside the input: crop the field, or fill them"
VECTORS = {
    "itk": Vectors("LPS", False, (VECTOR,), 5, VECTOR),
    "fsl-relative": Vectors("FSL", False, (2006, 0), 4, 2006),
    "fsl-absolute": Vectors("FSL", True, (2006, 0), 4, 2006),
    "afni": Vectors("LPS", False, (0, VECTOR), 5),  # 1007: fields that another program has copied
    "mrtrix": Vectors("RAS", True, gaps=_MARKED),
    "mrtrix-displacement": Vectors("RAS", False, gaps=_MARKED),
    "niftyreg": Vectors("RAS", True, (VECTOR,), 5, VECTOR, "NREG_TRANS", _OUTSIDE),  # or displacements
    "spm-deformation": Vectors("RAS", True, (0, VECTOR), 5, VECTOR, "Mapping", _OUTSIDE),
}
_FREESURFER = {0: Vectors("voxels", True), 1: Vectors("voxels"), 2: Vectors("RAS", True), 3: Vectors("RAS")}
"""FreeSurfer's vectors, by the number of their format."""

_POSITIONS, _DISPLACEMENTS = 0, 1  # values of NiftyReg's intent_p1
_COEFFICIENTS = (2007, 2008, 2009, 2016, 2017)  # of FNIRT and topup
_FOREIGN = re.compile("veloc|flow field|coefficient|b-?spline", re.IGNORECASE)
_OF_SPM = re.compile("((inverse|forward) )?deformation( field.*)?", re.IGNORECASE)  # Segment writes no intent
_LABELS = ["x_delta", "y_delta", "z_delta"]  # some warps of AFNI hold other volumes after these
_HEADER = 1 << 16  # bytes that hold the header of any .mif
_PLACES, _SHEARED, _FORMAT = 10, 15, 13  # tags of .mgz
_UNSIZED = (1, 2, 11, 12, 20, 30)  # those without a size: tables, labels, surfaces, matrices
_PLACE = 76 + 512  # bytes of an image's geometry, and of its file name
_LEAN = 1e-4  # the largest shear by rounding
_CONVERT = "run mrconvert (of a full warp, warpconvert with warpfull2deformation), and give its .nii.gz"
_CONVERT_WARP = "run mri_warp_convert with --outitk, and read that"


def read(path: PathLike, grids: base.Grids, *, convention: str) -> tuple[base.Content, ...]:
    """Read a field; FSL's need the grid of the source."""
    suffix = base.suffix_of(path, (*NIFTI, *DATASETS, *MIF, *MGZ, *MORPHS))
    if suffix in MORPHS:
        what = f"it is a morph ({suffix}), of which FreeSurfer has the only reader"
        raise unreadable(path, what, "run mri_warp_convert --inm3z with --outitk, and read that")
    source = grids.source
    if convention == "freesurfer":
        values, grid, kind, source = _mgz(path)
    elif convention == "afni" and suffix in DATASETS:
        values, grid, kind = *_dataset(path), VECTORS[convention]
    elif convention.startswith("mrtrix") and suffix in MIF:
        values, grid, kind = *_mif(path), VECTORS[convention]
    else:
        values, grid, kind = _nifti(path, convention)
    if convention == "afni":
        base.check_plumb(path, base.Grids(source), own=grid)
    if kind.space == "FSL":
        source = grids.needed(path, "source", convention)
    base.check_finite(path, values, kind.gaps)
    return (base.Displacements(_converted(values, grid, kind, source or grid), grid, beyond="edge"),)


def write(
    path: PathLike, contents: Sequence[base.Content], grids: base.Grids, *, convention: str, force: bool = False
) -> None:
    """Write a field as NIfTI; FSL's need the grid of the source."""
    suffix = base.suffix_of(path, (*NIFTI, *DATASETS))
    if suffix in DATASETS:
        raise unwritable(path, "AFNI's own datasets are only read", "write .nii.gz, which AFNI reads")
    field, kind = base.only_field(path, contents, convention), VECTORS[convention]
    if convention == "afni":
        base.check_plumb(path, grids, "write", field.grid)
    source = grids.needed(path, "source", convention, "write") if kind.space == "FSL" else field.grid
    if suffix not in NIFTI:
        raise unwritable(path, f"fields of this convention are NIfTI files, found the suffix {suffix}", "use .nii.gz")
    values = _converted(field.values, field.grid, kind, source, back=True)
    write_nifti(path, values, field.grid.geometry("LPS"), kind, force=force)


def _converted(values: Array, grid: Grid, kind: Vectors, source: Grid, *, back: bool = False) -> Array:
    """Convert the vectors of a file to displacements in LPS, or, with ``back``, displacements to those of a file.

    Let p be the position of a sample in LPS and u its displacement, and let R and S map LPS to the coordinates of the
    field's image and of the source. Absolute vectors are v = S (p + u), relative ones v = S (p + u) - R p, so that u =
    S⁻¹ v - p, or u = S⁻¹ (v + R p) - p. Planes are converted one by one.
    """
    if kind.space == "LPS":
        return values
    own, other = (base.coordinates(kind.space, each) for each in (grid, source))
    before, after, less = (np.eye(4), other, own) if back else (own, base.inverse(other), np.eye(4))
    alike = kind.space == "RAS" and not kind.absolute  # R = S: positions cancel
    made = np.empty(values.shape, values.dtype)
    y, x = np.mgrid[: grid.shape[1], : grid.shape[2]]
    for z, plane in enumerate(values):
        places = grid.positions(np.stack([x, y, np.full_like(x, z)], axis=-1))
        whole = plane.astype(np.float64)
        if not alike and (back or not kind.absolute):
            whole += places @ before[:3, :3].T + before[:3, 3]
        whole = whole @ after[:3, :3].T + after[:3, 3]
        if not alike and not (back and kind.absolute):
            whole -= places @ less[:3, :3].T + less[:3, 3]
        made[z] = whole
    return made


def write_nifti(path: PathLike, values: Array, geometry: Geometry, kind: Vectors, *, force: bool = False) -> None:
    """Write vectors (Z, H, W, 3) as NIfTI."""
    if max(values.shape) > nifti.LONGEST:
        sizes = " x ".join(map(str, values.shape[2::-1]))
        what = f"NIfTI ends at {nifti.LONGEST} voxels on a side, and the field has {sizes}"
        raise unwritable(path, what, "write .nrrd or .mha" if kind is VECTORS["itk"] else "write a smaller field")
    samples = np.moveaxis(values, -1, 0) if kind.axes == 4 else values
    like = Volume(samples, geometry, series=kind.axes == 4)
    nifti.write(path, samples, like, intent=(kind.intent, kind.name), force=force)


def announced(path: PathLike, header: Any) -> str:
    """Return the convention that a NIfTI header names: ``"niftyreg"``, ``"spm-deformation"``, or ``""`` for none.

    SuppleError if the header says that it is not a field, or not a supported one.
    """
    code = int(header["intent_code"])
    if code in _COEFFICIENTS:
        what = f"its intent code is {code}, of coefficients, to which FSL's programs add the affine part differently"
        raise unreadable(path, what, "run fnirtfileutils --withaff, with --ref= and --out=, and read what it makes")
    name, note = (bytes(header[key]).split(b"\0")[0].decode("latin-1").strip() for key in ("intent_name", "descrip"))
    if name == VECTORS["niftyreg"].name:
        form = int(header["intent_p1"])
        if form not in (_POSITIONS, _DISPLACEMENTS):
            what = f"it holds control points or velocities of NiftyReg (kind {form})"
            raise unreadable(path, what, "let its transform program write a deformation field (-def, with -ref)")
        return "niftyreg"
    if found := _FOREIGN.search(name) or _FOREIGN.search(note):
        what = f"its header says {shown(found.string)}, which is no field of displacements or positions"
        raise unreadable(path, what, "let the program that wrote it make one of these (a deformation field)")
    return "spm-deformation" if name == VECTORS["spm-deformation"].name or _OF_SPM.fullmatch(note) else ""


def check_header(path: PathLike, volume: Volume, convention: str) -> str:
    """Return the convention that the header of a NIfTI file names, or ""; SuppleError if it is a different one."""
    known = announced(path, volume.header)
    if known not in ("", convention):
        name = {"niftyreg": "NiftyReg", "spm-deformation": "SPM"}[known]
        what = f"its header says that it is a field of {name}, and not {convention}"
        raise unreadable(path, what, f"give the convention {known}")
    return known


def _nifti(path: PathLike, convention: str) -> tuple[Array, Grid, Vectors]:
    """Return the vectors of a NIfTI file, whose qform and sform must agree, their grid, and their meaning."""
    kind = VECTORS[convention]
    with warnings.catch_warnings():
        warnings.simplefilter("error", VolumeWarning)
        try:
            volume = nifti.read(path)
        except VolumeWarning as error:
            what = "its qform and its sform disagree, and programs choose between them differently"
            raise unreadable(path, what, "make them the same in its header") from error
    known, code = check_header(path, volume, convention), int(volume.header["intent_code"])
    if code not in kind.codes:
        wanted = " or ".join(map(str, kind.codes))
        what = f"its intent code is {code}, and that of a field in the convention {convention} is {wanted}"
        raise unreadable(path, what, "give the convention that it has")
    if convention == "niftyreg":  # its header says what the vectors are
        if known != convention:
            raise unreadable(path, f"its header does not say that it is of {convention}", "give another convention")
        kind = kind._replace(absolute=int(volume.header["intent_p1"]) == _POSITIONS)
    values, grid = base.vectors_of(path, volume)
    if kind.space == "FSL":
        steps = [abs(float(x)) for x in volume.header["pixdim"][1:4]]
        if not np.allclose(steps, grid.spacing, rtol=1e-3):
            what = f"its pixdim, {spelled(steps)}, differ from the spacing of its matrix, {spelled(grid.spacing)}"
            raise unreadable(path, what, "correct its header: FSL counts in the former")
    return values, grid, kind


def _dataset(path: PathLike) -> tuple[Array, Grid]:
    nibabel = nifti.imported()
    head_of(path, 4)
    with reading(path):
        try:
            image: Any = nibabel.load(path)
            affine, data = image.affine, np.asarray(image.dataobj)
        except (nibabel.filebasedimages.ImageFileError, KeyError, ValueError, IndexError, OSError) as error:
            raise unreadable(path, "it is no dataset of AFNI, or damaged or without its .HEAD or .BRIK") from error
    labels = str(image.header.info.get("BRICK_LABS", "")).split("~")[:3]
    count = data.shape[3] if data.ndim == 4 else 1
    if count < 3 or (count > 3 and labels != _LABELS) or data.dtype.kind != "f":
        what = f"it holds {data.dtype} of {' x '.join(map(str, data.shape))}"
        raise unreadable(path, what, f"give a warp, whose sub-bricks are {', '.join(_LABELS)}")
    return native(data[..., :3].transpose(2, 1, 0, 3)), base.grid_of(path, affine, data.shape[:3])


# Kept: neither nibabel nor SimpleITK reads .mif.
def _mif(path: PathLike) -> tuple[Array, Grid]:
    with reading(path), nifti.opened(path) as file:
        start = file.read(_HEADER)
        header, end, _ = start.partition(b"\nEND")
        told: dict[str, list[str]] = {}
        for key, text in re.findall(r"(?m)^([\w ]+?):[ \t]*(.*?)[ \t]*$", header.decode("utf-8", "replace")):
            told.setdefault(key.lower(), []).append(text)
        x, y, z, count = (int(size) for size in told["dim"][0].split(","))
        steps = np.array(told["vox"][0].split(",")[:3], np.float64)
        layout = told["layout"][0].split(",")
        order = [int(axis[1:]) for axis in layout]
        full = np.vstack([np.array([line.split(",") for line in told["transform"]], np.float64), np.eye(4)[3]])
        name, _, offset = told["file"][0].partition(" ")
        kind = re.fullmatch(r"float(32|64)(le|be)?", told["datatype"][0].lower())
        good = (
            end and start.startswith(b"mrtrix image") and sorted(order) == [0, 1, 2, 3] and count == 3 and name == "."
        )
        if kind is None or not good or "scaling" in told:
            raise unreadable(path, "it is no .mif file of x, y, z and three volumes of floats, as a warp is", _CONVERT)
        file.seek(int(offset or 0))
        dtype = np.dtype(f"{ {'le': '<', 'be': '>', None: '='}[kind[2]] }f{int(kind[1]) // 8}")
        # first with axes in the file's order, the fastest last; then as x, y, z and component, each in ascending order
        kept = sorted(range(4), key=lambda axis: -order[axis])
        whole = nifti.filled(path, file, dtype, [(x, y, z, count)[axis] for axis in kept], file.tell())
    whole = whole.transpose([kept.index(axis) for axis in (2, 1, 0, 3)])
    whole = whole[tuple(slice(None, None, -1 if layout[axis].startswith("-") else 1) for axis in (2, 1, 0, 3))]
    full[:3, :3] *= steps
    return native(whole), base.grid_of(path, full, (x, y, z))


def _mgz(path: PathLike) -> tuple[Array, Grid, Vectors, Grid]:
    """Return the vectors of a warp written by mri_warp_convert, their grid, their meaning, and the source's grid."""
    volume = mgh.read(path)
    tags = dict(_tags(volume.header[1])) if volume.series and len(volume.samples) == 3 else {}
    if not {_FORMAT, _PLACES} <= set(tags) or volume.samples.dtype != np.float32:
        raise unreadable(
            path, "it is no warp: three floats for each voxel, and the places of two images", _CONVERT_WARP
        )
    places, (form,) = tags[_PLACES], struct.unpack_from(">i", tags[_FORMAT])
    half = len(places) // 2
    source, grid = _place(path, places[:half]), _place(path, places[half:])
    if grid.shape != volume.samples.shape[1:]:
        raise ValueError("its places are not those of its voxels")
    return np.ascontiguousarray(np.moveaxis(volume.samples, 0, -1)), grid, _FREESURFER[form], source


def _tags(tags: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the tags after the voxels of a .mgz, with their contents; struct.error for tags that no warp has."""
    at = 0
    while at + 4 <= len(tags):
        (tag,) = struct.unpack_from(">i", tags, at)
        if tag == 0:
            return
        size, at = (2 * _PLACE, at + 4) if tag == _PLACES else (*struct.unpack_from(">q", tags, at + 4), at + 12)
        if tag in _UNSIZED or not 0 <= size <= len(tags) - at:
            raise struct.error
        yield (_PLACES if tag == _SHEARED else tag), tags[at : at + size]
        at += size


def _place(path: PathLike, held: bytes) -> Grid:
    """Return the grid of an image from a tag, which holds sizes, geometry, perhaps a shear, and a file name."""
    valid, *sizes = struct.unpack_from(">4i", held)
    numbers = np.array(struct.unpack_from(">15f", held, 16))
    if not valid or min(sizes) < 1:
        raise unreadable(path, "the place of an image that it belongs to is not valid", _CONVERT_WARP)
    if len(held) > _PLACE and np.abs(struct.unpack_from(">3f", held, 76)).max() > _LEAN:
        raise unreadable(path, "the axes of an image that it belongs to are not at right angles", "resample it first")
    return base.grid_of(path, base.centred(sizes, numbers[:3], numbers[3:12].reshape(3, 3).T, numbers[12:]), sizes)
