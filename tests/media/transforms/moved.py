"""Points moved by what is read, in SciPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from supple.media.transforms import Content

Array = npt.NDArray[Any]


def moved(contents: Sequence[Content], points: npt.ArrayLike) -> Array:
    """Return points (N, D), x first, moved by maps in turn: fields linearly interpolated."""
    made = np.asarray(points, np.float64)
    for one in contents:
        if isinstance(one, np.ndarray):
            made = made @ one[:-1, :-1].T + one[:-1, -1]
        else:
            at = one.grid.indices(made).T[::-1]
            made = made + np.stack([map_coordinates(u, at, order=1) for u in np.moveaxis(one.values, -1, 0)], -1)
    return made


def sampled(image: Array, contents: Sequence[Content], shape: tuple[int, int]) -> Array:
    """Return an image (H, W, C) as seen from the pixels of a picture of ``shape``, linearly interpolated."""
    rows, columns = np.indices(shape)
    x, y = moved(contents, np.stack([columns.ravel(), rows.ravel()], -1)).T
    made = [map_coordinates(np.float64(image[..., c]), [y, x], order=1, mode="nearest") for c in range(image.shape[2])]
    return np.stack(made, -1).reshape(*shape, -1)
