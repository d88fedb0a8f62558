"""Maps of pictures as absolute source positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from supple.media.files import PathLike, unreadable, unwritable
from supple.media.transforms.base import Array, Content, Displacements, Matrix
from supple.space.geometry import Grid


def of_positions(path: PathLike, x: Array, y: Array, first: tuple[int, int] = (0, 0)) -> Displacements:
    """Return a picture's map from the source positions of its pixels, given as two planes.

    Parameters
    ----------
    path : str or os.PathLike
        The file, for messages.
    x, y : array, shape (H, W)
        In pixels of the source, with pixel centres at integers from 0, y down.
    first : (int, int)
        The pixel, x first, that the planes begin with.
    """
    height, width = x.shape
    values = np.empty((height, width, 2), np.float64 if max(x.itemsize, y.itemsize) == 8 else np.float32)
    np.subtract(x, np.arange(first[0], first[0] + width, dtype=np.float64), out=values[..., 0], casting="same_kind")
    rows = np.arange(first[1], first[1] + height, dtype=np.float64)[:, None]
    np.subtract(y, rows, out=values[..., 1], casting="same_kind")
    if bad := np.count_nonzero(~np.isfinite(values).all(axis=-1)):
        raise unreadable(path, f"{bad} of its {height * width} positions are NaN or infinite", "fill them first")
    return Displacements(values, Grid((height, width), origin=first), beyond="edge")


def to_positions(path: PathLike, contents: Sequence[Content], what: str) -> Matrix:
    """Return the source positions (H, W, 2) of a picture's pixels; SuppleError for anything but one map of a picture.

    ``what`` names the format, for the message.
    """
    kinds = ["an affine map" if isinstance(c, np.ndarray) else "a field" for c in contents]
    advice = "sample the map on the pixels of the picture first"
    if kinds != ["a field"]:
        found = " and ".join(kinds) or "nothing"
        raise unwritable(path, f"{what} holds one displacement field, and not {found}", advice)
    (field,) = contents
    assert not isinstance(field, np.ndarray)
    grid = field.grid
    if grid.ndim != 2:
        raise unwritable(path, f"{what} is of a picture, and the field is of a volume", "choose another convention")
    if not np.array_equal(grid.matrix, np.eye(3)):
        where = f"a spacing of {grid.spacing}, an origin of {grid.origin} and a direction of {grid.direction}"
        raise unwritable(path, f"{what} has a sample at each pixel, and the field has {where}", advice)
    if field.interpolation == "bspline":
        raise unwritable(path, f"{what} holds displacements, and the field has coefficients of a spline", advice)
    if not all(np.isfinite(row).all() for row in field.values):
        raise unwritable(path, "the field holds NaN or infinity", "fill them first")
    return np.asarray(field.values + np.moveaxis(np.indices(grid.shape, np.float64), 0, -1)[..., ::-1])
