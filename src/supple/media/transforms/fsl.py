"""Warps and affine maps of FSL.

FSL's coordinates of an image are its indices times its spacing, with x counted from the other side if the image is
right-handed in RAS. A warp is given on the grid of the reference (output), and leads to coordinates of the source
(input): as displacements (relative) or positions (absolute); nothing in the file says which.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from supple.media.files import PathLike, unreadable
from supple.media.transforms.base import (
    Content,
    Displacements,
    Grids,
    Matrix,
    check_finite,
    check_intent,
    inverse,
    lines_of,
    moved,
    numbers_of,
    only_field,
    only_matrix,
    read_nifti,
    spelled,
    vectors_of,
    write_nifti,
    write_text,
)
from supple.space.geometry import Grid

_FIELD = 2006
_INTENTS = (_FIELD, 0)


def to_fsl(grid: Grid) -> Matrix:
    """Return the matrix from LPS to FSL's coordinates of an image."""
    known = grid.matrix
    scaled = np.diag([*grid.spacing, 1.0])
    if np.linalg.det(known[:3, :3]) > 0:
        scaled[0, 0] *= -1
        scaled[0, 3] = grid.spacing[0] * (grid.sizes[0] - 1)
    return np.asarray(scaled @ inverse(known))


def read(path: PathLike, grids: Grids, *, absolute: bool) -> tuple[Content, ...]:
    """Read a warp of FSL; needs the grid of the source."""
    convention = "fsl-absolute" if absolute else "fsl-relative"
    volume = read_nifti(path, convention)
    check_intent(path, volume, convention, _INTENTS)
    values, grid = vectors_of(path, volume)
    steps = [abs(float(x)) for x in volume.header["pixdim"][1:4]]
    if not np.allclose(steps, grid.spacing, rtol=1e-3):
        what = f"its pixdim, {spelled(steps)}, differ from the spacing of its matrix, {spelled(grid.spacing)}"
        raise unreadable(path, what, "correct its header: FSL counts in the former")
    source = grids.needed(path, "source", convention)
    check_finite(path, values, "give a field that is finite everywhere")
    back = inverse(to_fsl(source))
    made = moved(values, grid, None if absolute else to_fsl(grid), back, np.eye(4))
    return (Displacements(made, grid, beyond="edge"),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, absolute: bool, force: bool = False) -> None:
    """Write a warp of FSL; needs the grid of the source."""
    convention = "fsl-absolute" if absolute else "fsl-relative"
    field = only_field(path, contents, convention)
    source = grids.needed(path, "source", convention, "write")
    taken = None if absolute else to_fsl(field.grid)
    made = moved(field.values, field.grid, np.eye(4), to_fsl(source), taken)
    write_nifti(path, made, field.grid, axes=4, intent=_FIELD, force=force)


def read_affine(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read a matrix of FLIRT, which leads from the source to the reference; needs the grids of both."""
    matrix = numbers_of(path, lines_of(path, "a matrix of FLIRT"), (4, 4), "matrix of FLIRT")
    source = grids.needed(path, "source", "fsl-affine")
    reference = grids.needed(path, "reference", "fsl-affine")
    return (inverse(to_fsl(source)) @ inverse(matrix) @ to_fsl(reference),)


def write_affine(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a matrix of FLIRT; needs the grids of the source and of the reference."""
    matrix = only_matrix(path, contents, "fsl-affine")
    source = grids.needed(path, "source", "fsl-affine", "write")
    reference = grids.needed(path, "reference", "fsl-affine", "write")
    made = to_fsl(reference) @ inverse(matrix) @ inverse(to_fsl(source))
    write_text(path, "".join(f"{spelled(row)}\n" for row in made), force=force)
