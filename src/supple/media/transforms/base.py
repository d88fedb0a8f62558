"""What files of transforms hold, and what their readers and writers share."""

from __future__ import annotations

import gzip
import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, VolumeWarning, argument, shown
from supple.media.files import PathLike, head_of, replacing, unreadable, unwritable
from supple.media.volume import nifti
from supple.media.volume.data import Volume, placed
from supple.space.geometry import Grid

Array = npt.NDArray[Any]
Matrix = npt.NDArray[np.float64]

_COMPONENTS = 3
_COEFFICIENTS = (2007, 2008, 2009, 2016, 2017)  # of FNIRT and topup
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Of positions and displacements in RAS, those in LPS."""
VECTOR = 1007
"""The intent code of a vector for each voxel."""
NIFTYREG, SPM = "NREG_TRANS", "Mapping"
"""The names of the intent of fields of NiftyReg and SPM."""
POSITIONS, DISPLACEMENTS = 0, 1
"""What fields of NiftyReg hold, in intent_p1."""
_NO_FIELDS = {
    2: "control points of a cubic B-spline",
    5: "control points of a velocity",
    6: "control points of a spline",
}
_FOREIGN = re.compile("veloc|flow field|coefficient|b-?spline", re.IGNORECASE)
_OF_SPM = re.compile("((inverse|forward) )?deformation( field.*)?", re.IGNORECASE)  # Segment writes no intent
_TEXTS = {
    b"(Transform ": ("parameters of elastix", "run transformix -def all -tp, and read its deformationField"),
    b"MGH_GPUIT_BSP": ("a B-spline of plastimatch", "run plastimatch xf-convert --output-type vf, and read that"),
    b"MNI Transform File": ("a transform of MINC", "convert it to a field of ITK"),
}


class Displacements(NamedTuple):
    """A sampled displacement field as read from a file; see `supple.Field`."""

    values: Array
    grid: Grid
    interpolation: Literal["linear", "cubic", "bspline"] = "linear"
    beyond: Literal["zero", "edge"] = "zero"


Content = Matrix | Displacements
"""The homogeneous matrix of an affine map, or a displacement field. Those of a file apply in order, the first first."""


class MissingGridError(SuppleError):
    """A file is of a convention that counts in an image's voxels, and its grid is not given."""


class Grids(NamedTuple):
    """The grids that some conventions need beside the file: of the input (source) and of the output (reference)."""

    source: Grid | None = None
    reference: Grid | None = None

    def needed(self, path: PathLike, name: str, convention: str, verb: str = "read") -> Grid:
        """Return one of the grids, "source" or "reference"; SuppleError if it is not given."""
        grid: Grid | None = getattr(self, name)
        whose = {"source": "the input (moving) image", "reference": "the output (fixed) image"}[name]
        if grid is None:
            raise MissingGridError(
                f"cannot {verb} {shown(path)}: {convention} counts in the voxels of {whose}, which is not given: "
                f"give its grid as {argument(name)}"
            )
        if grid.ndim != 3:
            raise SuppleError(f"{argument(name)} must be the grid of a volume, found one of {grid.ndim} axes")
        return grid


def suffix_of(path: PathLike, known: Sequence[str]) -> str:
    """Return the longest of the known suffixes that a name ends in, or its own."""
    name = Path(path).name.lower()
    fits = [suffix for suffix in known if name.endswith(suffix.lower())]
    return max(fits, key=len, default=Path(path).suffix.lower()).lower()


def inverse(matrix: Matrix) -> Matrix:
    """Return the inverse of a matrix."""
    return np.asarray(np.linalg.inv(matrix), np.float64)


def turned(matrix: Matrix) -> Matrix:
    """Return an affine map of positions in RAS as one of positions in LPS, or back."""
    return np.asarray(LPS @ matrix @ LPS)


def to_ras(matrix: Matrix) -> Matrix:
    """Return a matrix from indices to LPS as one to RAS, or back."""
    return np.asarray(LPS @ matrix)


def read_nifti(path: PathLike, convention: str) -> Volume:
    """Read a NIfTI file of a convention, whose place is not in doubt."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", VolumeWarning)
        try:
            return checked_header(path, nifti.read(path), convention)
        except VolumeWarning as error:
            what = "its qform and its sform disagree, and programs choose between them differently"
            raise unreadable(path, what, "make them the same in its header") from error
        except SuppleError as error:
            if "it is no NIfTI file" not in str(error):
                raise
            what = f"it is no NIfTI file, and those of the convention {convention} are"
            raise unreadable(path, what, "check its name and its convention") from error


def announced(path: PathLike, header: Any) -> str:
    """Return the convention that a NIfTI header names: ``"niftyreg"``, ``"spm-deformation"``, or ``""`` for none.

    SuppleError for what says that it is no field, or none that is read.
    """
    name, note = (bytes(header[key]).split(b"\0")[0].decode("latin-1").strip() for key in ("intent_name", "descrip"))
    if name == NIFTYREG:
        kind = int(header["intent_p1"])
        if kind not in (POSITIONS, DISPLACEMENTS):
            what = f"it holds {_NO_FIELDS.get(kind, 'a velocity field')} of NiftyReg (kind {kind})"
            raise unreadable(path, what, "let its transform program write a deformation field (-def, with -ref)")
        return "niftyreg"
    if found := _FOREIGN.search(name) or _FOREIGN.search(note):
        what = f"its header says {shown(found.string)}, which is no field of displacements or positions"
        raise unreadable(path, what, "let the program that wrote it make one of these (a deformation field)")
    return "spm-deformation" if name == SPM or _OF_SPM.fullmatch(note) else ""


def checked_header(path: PathLike, volume: Volume, convention: str) -> Volume:
    """Return a volume of NIfTI as it is; SuppleError if its header names another convention."""
    known = announced(path, volume.header)
    if known not in ("", convention):
        name = {"niftyreg": "NiftyReg", "spm-deformation": "SPM"}[known]
        raise unreadable(
            path, f"its header says that it is a field of {name}, and not {convention}", f"give the convention {known}"
        )
    return volume


TEXT = 1 << 14
"""The bytes at the beginning of a text that tell what it is: comments may come first."""


def check_text(path: PathLike, head: bytes) -> None:
    """Raise SuppleError for text of programs whose transforms are not read."""
    for begin, (what, how) in _TEXTS.items():
        if begin in head:
            raise unreadable(path, f"it holds {what}", how)


def intent_of(volume: Volume) -> int:
    """Return the intent code of a NIfTI file."""
    return int(volume.header["intent_code"])


def check_intent(path: PathLike, volume: Volume, convention: str, known: Sequence[int]) -> None:
    """Raise SuppleError for an intent code that the fields of a convention do not have."""
    code = intent_of(volume)
    check_code(path, code)
    if code not in known:
        told = " or ".join(map(str, known))
        what = f"its intent code is {code}, and that of a field in the convention {convention} is {told}"
        raise unreadable(path, what, "give the convention that it has")


def check_code(path: PathLike, code: int) -> None:
    """Raise SuppleError for the intent codes of FSL's coefficients."""
    if code in _COEFFICIENTS:
        what = f"its intent code is {code}, of coefficients, to which FSL's programs add the affine part differently"
        raise unreadable(path, what, "run fnirtfileutils --withaff, with --ref= and --out=, and read what it makes")


def check_count(path: PathLike, found: int, wanted: int = _COMPONENTS) -> None:
    """Raise SuppleError for another number of values for each voxel than three, or as many as are wanted."""
    if found != wanted:
        told = {
            1: "one value for each voxel, as an image or a mask",
            2: "two values for each voxel, as a field of a picture",
        }.get(found)
        told = told or f"{found} values for each voxel"
        raise unreadable(path, f"it holds {told}", "give a field with three, one for each axis of space")


def vectors_of(path: PathLike, volume: Volume, count: int = _COMPONENTS) -> tuple[Array, Grid]:
    """Return the vectors of a volume, shape (Z, H, W, 3), and its grid: of a series in time, three volumes count too.

    SuppleError if there are not three numbers for each voxel, or they are no fractions; or it has no place in space.
    """
    samples = volume.rescaled()
    if volume.series:
        samples = np.moveaxis(samples, 0, -1)
    found = samples.shape[3] if samples.ndim == 4 else 1
    check_count(path, found, count)
    if samples.dtype.kind != "f":
        raise unreadable(
            path, f"its values are {samples.dtype}, as those of colours", "give a field of float32 or float64"
        )
    if volume.geometry.convention == "array":
        what = "it does not say where its voxels lie"
        how = {"NIfTI": " (its sform and qform have the code 0)", "NRRD": " (it names no space)"}.get(volume.format, "")
        raise unreadable(path, what + how, "copy the header of the image that it belongs to")
    return samples, volume.geometry.grid(samples.shape[:3])


def matrix_grid(path: PathLike, matrix: Matrix, sizes: Sequence[int]) -> Grid:
    """Return a grid from the matrix of its indices to RAS, and its sizes, x first."""
    made = placed(path, matrix, "RAS").grid(tuple(sizes)[::-1])
    if made.shear:
        raise unreadable(path, "the axes of an image that it belongs to are not at right angles", "resample it first")
    return made


def check_finite(path: PathLike, values: Array, what: str = "a field is finite everywhere") -> None:
    """Raise SuppleError for NaN or infinity, with their number."""
    gaps = sum(int((~np.isfinite(plane).all(axis=-1)).sum()) for plane in values)
    if gaps:
        count = f"{gaps} voxel{'s' if gaps > 1 else ''}"
        raise unreadable(path, f"{count} of {values[..., 0].size} hold NaN or infinity", what)


def positions_of(grid: Grid, z: int) -> Array:
    """Return the positions of a plane of a grid, shape (H, W, 3)."""
    _, height, width = grid.shape
    y, x = np.mgrid[:height, :width]
    return grid.positions(np.stack([x, y, np.full_like(x, z)], axis=-1))


def moved(values: Array, grid: Grid, before: Matrix | None, after: Matrix, positions: Matrix | None = None) -> Array:
    """Return a field in other terms, plane by plane.

    With p the position of a sample in LPS and v its value: ``after (v + before p) - positions p``; a matrix that is
    None counts as 0.
    """
    made = np.empty(values.shape, values.dtype)
    for z, plane in enumerate(values):
        known = positions_of(grid, z)
        whole = plane.astype(np.float64)
        if before is not None:
            whole += known @ before[:3, :3].T + before[:3, 3]
        whole = whole @ after[:3, :3].T + after[:3, 3]
        if positions is not None:
            whole -= known @ positions[:3, :3].T + positions[:3, 3]
        made[z] = whole
    return made


def only_field(path: PathLike, contents: Sequence[Content], convention: str) -> Displacements:
    """Return the only content, a field of volumes that is interpolated linearly; SuppleError for others."""
    found = contents[0] if len(contents) == 1 else None
    if not isinstance(found, Displacements):
        told = _told(contents)
        raise unwritable(path, f"{convention} holds one field for each file, found {told}", "sample them as one field")
    if found.interpolation != "linear":
        what = f"{convention} interpolates linearly, and the field is of interpolation {found.interpolation}"
        raise unwritable(path, what, "sample it on the grid of the output first")
    check_volume(path, found)
    return found


def only_matrix(path: PathLike, contents: Sequence[Content], convention: str) -> Matrix:
    """Return the only content, the matrix of an affine map of volumes; SuppleError for others."""
    found = contents[0] if len(contents) == 1 else None
    if found is None or isinstance(found, Displacements):
        advice = "choose another convention, or another suffix"
        raise unwritable(path, f"{convention} holds one affine map, found {_told(contents)}", advice)
    check_volume(path, found)
    return found


def check_volume(path: PathLike, content: Content) -> None:
    """Raise SuppleError for a map of pictures, or a field that is not finite or has another shape than its grid."""
    field = isinstance(content, Displacements)
    ndim = content.grid.ndim if isinstance(content, Displacements) else len(content) - 1
    if ndim != 3:
        raise unwritable(path, f"it takes maps of volumes, found one of {ndim} coordinates", "use another convention")
    shape = (*content.grid.shape, 3) if isinstance(content, Displacements) else (4, 4)
    values = content.values if isinstance(content, Displacements) else content
    if values.shape != shape or values.dtype.kind != "f":
        wanted = f"the {'values of the field' if field else 'matrix'} must be floats of shape {shape}"
        raise SuppleError(f"{wanted}, found {values.dtype} of shape {values.shape}")
    if not all(np.isfinite(part).all() for part in values):
        raise unwritable(path, "the map holds NaN or infinity", "give a finite one")


def _told(contents: Sequence[Content]) -> str:
    fields = sum(isinstance(content, Displacements) for content in contents)
    matrices = len(contents) - fields
    told = [f"{n} {what}{'s' if n > 1 else ''}" for n, what in ((matrices, "affine map"), (fields, "field")) if n]
    return " and ".join(told) or "nothing"


def write_nifti(
    path: PathLike,
    values: Array,
    grid: Grid,
    *,
    axes: Literal[4, 5],
    intent: int = 0,
    name: str = "",
    force: bool = False,
) -> None:
    """Write vectors (Z, H, W, 3) as a NIfTI file of four axes or of five, with the code and the name of an intent."""
    suffix = suffix_of(path, (".nii", ".nii.gz"))
    if suffix not in (".nii", ".nii.gz"):
        raise unwritable(path, f"fields of this convention are NIfTI files, found the suffix {suffix}", "use .nii.gz")
    if max(values.shape) > nifti.LONGEST:
        raise unwritable(path, f"NIfTI ends at {nifti.LONGEST} voxels on a side", "write a smaller field")
    nibabel = nifti.imported()
    affine = to_ras(grid.matrix)
    shaped = values.transpose(2, 1, 0, 3)
    image = nibabel.Nifti1Image(shaped if axes == 4 else shaped[:, :, :, None], affine)
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1)
    image.header["intent_code"], image.header["intent_name"] = intent, name.encode()
    image.header.set_xyzt_units("mm")
    with replacing(path, force=force) as temporary, nifti.writing(temporary, suffix) as file:
        image.to_file_map({"image": nibabel.FileHolder(fileobj=file)})


def lines_of(path: PathLike, what: str, most: int = 1 << 20) -> list[str]:
    """Return the lines of a text file without comments (#) and empty ones; SuppleError if it is no text."""
    head = head_of(path, most)
    check_text(path, head[:TEXT])
    try:
        text = head.decode("utf-8")
    except UnicodeDecodeError as error:
        raise unreadable(path, f"it is no text, and {what} is", "check its name and its convention") from error
    lines = (re.sub("#.*", "", line).strip() for line in text.splitlines())
    return [line for line in lines if line]


def numbers_of(path: PathLike, lines: Sequence[str], shape: tuple[int, int], what: str) -> Matrix:
    """Return the numbers of some lines as a homogeneous matrix; SuppleError for another number of them."""
    words = " ".join(lines).split()
    try:
        found = np.array([float(word) for word in words], np.float64)
    except ValueError as error:
        raise unreadable(path, f"it is no {what}: it holds words", "check its name and its convention") from error
    if found.size != shape[0] * shape[1]:
        told = f"{found.size} numbers, and a {what} has {shape[0]} x {shape[1]}"
        raise unreadable(path, f"it holds {told}", "give a file of one affine map of volumes")
    made = np.eye(4)
    made[: shape[0]] = found.reshape(shape)
    return checked(path, made)


def checked(path: PathLike, matrix: Matrix) -> Matrix:
    """Return a homogeneous matrix as it is; SuppleError if it is none, or has no inverse."""
    if not np.isfinite(matrix).all() or not np.allclose(matrix[-1], np.eye(len(matrix))[-1], atol=1e-12):
        raise unreadable(path, f"its matrix is {matrix.tolist()}, and no finite affine map", "correct it")
    if not abs(np.linalg.det(matrix[:-1, :-1])) > 1e-12:
        raise unreadable(path, "its matrix is singular: it has no inverse", "correct it")
    matrix[-1] = np.eye(len(matrix))[-1]
    return matrix


def write_text(path: PathLike, text: str, *, force: bool = False) -> None:
    """Write a text file."""
    with replacing(path, force=force) as temporary:
        temporary.write_text(text, "utf-8")


def spelled(numbers: npt.ArrayLike, between: str = " ") -> str:
    """Return numbers that read back as they are."""
    return between.join(repr(x) for x in np.asarray(numbers, np.float64).ravel().tolist())


def opened(path: PathLike, head: bytes) -> Any:
    """Open a file for reading, which may be compressed."""
    return gzip.open(path) if head[:2] == b"\x1f\x8b" else open(os.fspath(path), "rb")
