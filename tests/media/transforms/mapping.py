"""Maps of files as SciPy applies them: what a reader's contents do to points and images, of pictures and volumes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from supple.media.transforms import Content, Displacements
from supple.space.geometry import Grid

DATA = Path(__file__).parent / "data"
Floats = npt.NDArray[np.float64]


def mapped(contents: Sequence[Content], points: npt.ArrayLike) -> Floats:
    """Return where points (..., D) of the output lie in the input."""
    found = np.asarray(points, np.float64)
    for content in contents:
        if isinstance(content, Displacements):
            found = found + displacement(content, found)
        else:
            found = found @ content[:-1, :-1].T + content[:-1, -1]
    return found


def displacement(field: Displacements, points: Floats) -> Floats:
    at = np.moveaxis(field.grid.indices(points), -1, 0)[::-1]
    order = {"linear": 1, "cubic": 3, "bspline": 3}[field.interpolation]
    parts = [
        ndimage.map_coordinates(
            np.asarray(part, np.float64), at, order=order, mode="nearest", prefilter=field.interpolation == "cubic"
        )
        for part in np.moveaxis(field.values, -1, 0)
    ]
    made = np.stack(parts, axis=-1)
    if field.beyond == "zero":
        sizes = np.array(field.grid.sizes)[::-1].reshape(-1, *[1] * (at.ndim - 1))
        inside = ((at >= -0.5) & (at <= sizes - 0.5)).all(axis=0)
        made *= inside[..., np.newaxis]
    return made


def centres(grid: Grid) -> Floats:
    """Return the positions of all samples of a grid, shape (Z, H, W, 3)."""
    indices = np.stack(np.meshgrid(*[np.arange(n) for n in grid.shape], indexing="ij")[::-1], axis=-1)
    return grid.positions(indices)


def warped(image: npt.NDArray[Any], grid: Grid, contents: Sequence[Content], output: Grid) -> tuple[Floats, Any]:
    """Return an image on a grid, as the maps show it on the grid of the output, and where they lead into the image."""
    at = np.moveaxis(grid.indices(mapped(contents, centres(output))), -1, 0)[::-1]
    most = np.array(grid.shape).reshape(3, 1, 1, 1) - 1
    found = ndimage.map_coordinates(np.asarray(image, np.float64), at, order=1, mode="nearest")
    return found, ((at > 1e-3) & (at < most - 1e-3)).all(axis=0)


def sampled(image: npt.NDArray[Any], contents: Sequence[Content], shape: tuple[int, int]) -> Floats:
    """Return an image (H, W, C) as seen from the pixels of a picture of ``shape``, linearly interpolated."""
    at = np.moveaxis(mapped(contents, np.moveaxis(np.indices(shape)[::-1], 0, -1)), -1, 0)[::-1]
    planes = np.moveaxis(np.float64(image), -1, 0)
    return np.stack([ndimage.map_coordinates(plane, at, order=1, mode="nearest") for plane in planes], axis=-1)


def rotation(*angles: float) -> Floats:
    made = np.eye(3)
    for i, angle in enumerate(angles):
        turn = np.eye(3)
        a, b = (i + 1) % 3, (i + 2) % 3
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
        made = made @ turn
    return made


GRIDS = {
    "plain": Grid((7, 8, 9), (2.0, 2.5, 3.0), (-8.0, 5.0, 11.0)),
    "oblique": Grid((7, 8, 9), (2.0, 2.5, 3.0), (-71.25, 33.5, 81.125), rotation(0.4, -0.3, 0.7)),
    "flipped": Grid((6, 9, 8), (2.2, 1.5, 3.5), (12.0, -40.0, 7.0), rotation(0.2, 0.1, -0.3) * (-1, 1, 1)),
    "turned": Grid((9, 6, 8), (1.2, 2.5, 1.5), (12.0, -40.0, 7.0), [[0, 0, 1], [-1, 0, 0], [0, 1, 0]]),
}


def grid_of(matrix: Floats, shape: Sequence[int]) -> Grid:
    """Return the grid of a matrix from indices to LPS."""
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    return Grid(shape, spacing.tolist(), matrix[:3, 3].tolist(), matrix[:3, :3] / spacing)


def field_on(grid: Grid, seed: int = 0, dtype: npt.DTypeLike = np.float32) -> Displacements:
    """Return a field of about 2 mm on a grid."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 1, (*grid.shape, 3))
    return Displacements(values.astype(dtype), grid)


def points_in(grid: Grid, seed: int = 1, count: int = 50) -> Floats:
    """Return random points within the centres of a grid's outermost samples."""
    rng = np.random.default_rng(seed)
    return grid.positions(rng.uniform(0, 1, (count, 3)) * (np.array(grid.sizes) - 1))
