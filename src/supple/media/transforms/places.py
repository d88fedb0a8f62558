"""Coordinates in which programs count in an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, unreadable
from supple.media.transforms.base import LPS, Array, Grids, Matrix, inverse
from supple.media.volume.data import placed
from supple.space.geometry import Grid

Space = Literal["LPS", "RAS", "FSL", "voxels"]


def coordinates(space: Space, grid: Grid) -> Matrix:
    """Return the matrix from LPS to the coordinates of an image.

    FSL's are indices times spacing, with x counted from the other side if the image is right-handed in RAS.
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
    """Return the matrix from indices to RAS of an image, as FreeSurfer describes it: by the position of its middle."""
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

    AFNI's coordinates leave out how a grid is turned (they are "cardinal"), so that a warp on an oblique grid means
    nothing without AFNI's own rules for both images.
    """
    given = {"the input (moving) image": grids.source, "the output (fixed) image": grids.reference, "its grid": own}
    for whose, grid in given.items():
        degrees = grid.geometry("LPS").oblique if grid is not None else 0
        if degrees:
            raise SuppleError(
                f"cannot {verb} {shown(path)}: {whose} is oblique by {degrees:.3g} degrees, which AFNI leaves out of "
                "its coordinates: make it and the images plumb by 3dWarp -deoblique, and find the warp anew"
            )
