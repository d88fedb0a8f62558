"""Types for the contents of transform files, and functions shared by their readers and writers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array
from supple.errors import SuppleError, argument, shown
from supple.media.files import PathLike, unreadable, unwritable
from supple.media.volume.data import TO_RAS, Volume, placed
from supple.space.geometry import Grid

Matrix = npt.NDArray[np.float64]
Interpolation = Literal["linear", "cubic", "bspline"]

LPS = TO_RAS
"""The matrix from RAS to LPS, and back, for positions and displacements."""
FINITE = "give a field that is finite everywhere"
TEXT = 1 << 14
"""Bytes at the beginning of a text file that identify its format; comments may come first."""
_FOREIGN = {
    b"(Transform ": ("parameters of elastix", "run transformix -def all -tp, and read its deformationField"),
    b"MGH_GPUIT_BSP": ("a B-spline of plastimatch", "run plastimatch xf-convert --output-type vf, and read that"),
    b"MNI Transform File": ("a transform of MINC", "convert it to a field of ITK"),
}
Space = Literal["LPS", "RAS", "FSL", "voxels"]
"""Coordinate systems of programs in an image."""


class Displacements(NamedTuple):
    """A sampled displacement field as read from a file; see `supple.Field`."""

    values: Array
    grid: Grid
    interpolation: Interpolation = "linear"
    beyond: Literal["zero", "edge"] = "zero"


Content = Matrix | Displacements
"""The homogeneous matrix of an affine map, or a displacement field. A file's contents apply in order."""


class MissingGridError(SuppleError):
    """The convention of a file depends on an image's grid, which is not given."""


class Grids(NamedTuple):
    """The grids that some conventions need: of the input image (source) and of the output image (reference)."""

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


def suffix_of(path: PathLike, suffixes: Sequence[str]) -> str:
    """Return the longest of ``suffixes`` that a name ends in, else the suffix of the name."""
    name = Path(path).name.lower()
    fits = [suffix for suffix in suffixes if name.endswith(suffix)]
    return max(fits, key=len, default=Path(path).suffix.lower())


def inverse(matrix: Matrix) -> Matrix:
    """Return the inverse of a matrix, without negative zeros."""
    return np.asarray(np.linalg.inv(matrix) + 0.0, np.float64)


def coordinates(space: Space, grid: Grid) -> Matrix:
    """Return the matrix from LPS to the coordinates of an image.

    FSL's coordinates are indices times spacing, with x from the opposite side if the image is right-handed in RAS.
    """
    if space == "LPS":
        return np.eye(4)
    if space == "RAS":
        return LPS
    made = np.eye(4)
    if space == "FSL":
        made = np.diag([*grid.spacing, 1.0])
        if np.linalg.det(grid.matrix[:3, :3]) > 0:
            made[0, 0] *= -1
            made[0, 3] = grid.spacing[0] * (grid.sizes[0] - 1)
    return np.asarray(made @ inverse(grid.matrix))


def grid_of(path: PathLike, matrix: Matrix, sizes: Sequence[int]) -> Grid:
    """Return a grid from the matrix of its indices to RAS, and its sizes, x first."""
    made = placed(path, matrix, "RAS").grid(tuple(sizes)[::-1])
    if made.shear:
        raise unreadable(path, "the axes of an image that it belongs to are not at right angles", "resample it first")
    return made


def centred(sizes: Sequence[int] | Array, steps: Array, axes: Array, middle: Array) -> Matrix:
    """Return the matrix from indices to RAS of an image, described as in FreeSurfer: by its axes and its middle."""
    made = np.eye(4)
    made[:3, :3] = axes * steps
    made[:3, 3] = middle - made[:3, :3] @ (np.asarray(sizes) / 2)
    return made


def described(grid: Grid) -> tuple[Matrix, Array]:
    """Return the axes of an image in RAS, as columns, and the position of its middle."""
    matrix = LPS @ grid.matrix
    return matrix[:3, :3] / grid.spacing, matrix[:3, :3] @ (np.array(grid.sizes) / 2) + matrix[:3, 3]


def check_plumb(path: PathLike, grids: Grids, verb: str = "read", own: Grid | None = None) -> None:
    """Raise SuppleError for an oblique grid of AFNI's.

    AFNI's coordinates ignore the rotation of a grid (they are "cardinal"), so that a warp on an oblique grid depends on
    AFNI's own rules for both images.
    """
    given = {"the input (moving) image": grids.source, "the output (fixed) image": grids.reference, "its grid": own}
    for whose, grid in given.items():
        degrees = grid.geometry("LPS").oblique if grid is not None else 0
        if degrees:
            raise SuppleError(
                f"cannot {verb} {shown(path)}: {whose} is oblique by {degrees:.3g} degrees, which AFNI leaves out of "
                "its coordinates: make it and the images plumb by 3dWarp -deoblique, and find the warp anew"
            )


def check_text(path: PathLike, head: bytes) -> None:
    """Raise SuppleError for text of programs whose transforms are not read."""
    for begin, (what, how) in _FOREIGN.items():
        if begin in head:
            raise unreadable(path, f"it holds {what}", how)


def check_matrix(path: PathLike, matrix: Matrix) -> Matrix:
    """Return a homogeneous matrix; SuppleError if it is none, or has no inverse."""
    last = np.eye(len(matrix))[-1]
    if not np.isfinite(matrix).all() or not np.allclose(matrix[-1], last, atol=1e-12):
        raise unreadable(path, f"its matrix is {matrix.tolist()}, and no finite affine map", "correct it")
    if not abs(np.linalg.det(matrix[:-1, :-1])) > 1e-12:
        raise unreadable(path, "its matrix is singular: it has no inverse", "correct it")
    matrix[-1] = last
    return matrix


def check_count(path: PathLike, found: int, wanted: int = 3) -> None:
    """Raise SuppleError if the number of values of a voxel is not ``wanted``."""
    if found != wanted:
        known = {
            1: "one value for each voxel, as an image or a mask",
            2: "two values for each voxel, as a field of a picture",
        }
        what = known.get(found, f"{found} values for each voxel")
        raise unreadable(path, f"it holds {what}", "give a field with three, one for each axis of space")


def check_finite(path: PathLike, values: Array, advice: str = FINITE) -> None:
    """Raise SuppleError, with their count, for NaN and infinite values."""
    gaps = sum(int((~np.isfinite(plane).all(axis=-1)).sum()) for plane in values)
    if gaps:
        count = f"{gaps} voxel{'s' if gaps > 1 else ''}"
        raise unreadable(path, f"{count} of {values[..., 0].size} hold NaN or infinity", advice)


def vectors_of(path: PathLike, volume: Volume, count: int = 3) -> tuple[Array, Grid]:
    """Return the vectors of a volume, shape (Z, H, W, count), and its grid; components may be stored as a time series.

    SuppleError for another number of components, samples that are not floats, or a volume without a position in space.
    """
    samples = volume.rescaled()
    if volume.series:
        samples = np.moveaxis(samples, 0, -1)
    check_count(path, samples.shape[3] if samples.ndim == 4 else 1, count)
    if samples.dtype.kind != "f":
        what = f"its values are {samples.dtype}, as those of colours"
        raise unreadable(path, what, "give a field of float32 or float64")
    if volume.geometry.convention == "array":
        what = "it does not say where its voxels lie"
        how = {"NIfTI": " (its sform and qform have the code 0)", "NRRD": " (it names no space)"}.get(volume.format, "")
        raise unreadable(path, what + how, "copy the header of the image that it belongs to")
    return samples, volume.geometry.grid(samples.shape[:3])


def only_field(path: PathLike, contents: Sequence[Content], form: str, ndim: int = 3) -> Displacements:
    """Return the only content, a field without spline coefficients; SuppleError for others.

    ``form`` names the format in messages. For volumes, cubic fields are refused too, as other programs are linear.
    """
    found = contents[0] if len(contents) == 1 else None
    if not isinstance(found, Displacements):
        what = f"{form} holds one field for each file, found {_listed(contents)}"
        raise unwritable(path, what, "sample them as one field (supple compose)")
    if found.interpolation == "bspline" or (found.interpolation == "cubic" and ndim == 3):
        what = f"{form} holds displacements between which programs interpolate linearly"
        what = f"{what}, and the field is of interpolation {found.interpolation}"
        raise unwritable(path, what, "sample it on the grid of the output first")
    check_content(path, found, ndim)
    return found


def only_matrix(path: PathLike, contents: Sequence[Content], form: str) -> Matrix:
    """Return the only content, the matrix of an affine map of volumes; SuppleError for others."""
    found = contents[0] if len(contents) == 1 else None
    if found is None or isinstance(found, Displacements):
        what = f"{form} holds one affine map, found {_listed(contents)}"
        raise unwritable(path, what, "choose another convention, or another suffix")
    check_content(path, found)
    return found


def check_content(path: PathLike, content: Content, ndim: int = 3) -> None:
    """Raise SuppleError for a map of other dimensions, or one that is not finite or has another shape than its grid."""
    if isinstance(content, Displacements):
        what, found, values, shape = "values of the field", content.grid.ndim, content.values, content.grid.shape
        shape = (*shape, ndim)
    else:
        what, found, values, shape = "matrix", len(content) - 1, content, (ndim + 1, ndim + 1)
    if found != ndim:
        kind = "volumes" if ndim == 3 else "pictures"
        raise unwritable(path, f"it takes maps of {kind}, found one of {found} coordinates", "use another convention")
    if values.shape != shape or values.dtype.kind != "f":
        wanted = f"the {what} must be floats of shape {shape}"
        raise SuppleError(f"{wanted}, found {values.dtype} of shape {values.shape}")
    if not all(np.isfinite(part).all() for part in values):
        raise unwritable(path, "the map holds NaN or infinity", "give a finite one")


def _listed(contents: Sequence[Content]) -> str:
    fields = sum(isinstance(content, Displacements) for content in contents)
    counts = ((len(contents) - fields, "affine map"), (fields, "field"))
    return " and ".join(f"{n} {what}{'s' if n > 1 else ''}" for n, what in counts if n) or "nothing"
