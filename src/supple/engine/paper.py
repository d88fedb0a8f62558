"""T⁻¹ by the published iteration: a baseline for measurements, not used otherwise (see ``_core/paper.hpp``)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import numbers
from supple.errors import SuppleError
from supple.space.geometry import Floats


def inverse_map(
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, int],
    *,
    z: float | None = None,
    mu: float = 0.5,
    tolerance: float = 0.1,
    limit: int = 200,
    corrected: bool = False,
    every: int = 1,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64], Floats]:
    """Return the source points of an image's pixels by the published method.

    Each stroke is inverted by itself, the last one first. ``axes`` is the packed domain, ``z`` the plane of a video or
    a volume, in samples, and ``every`` the stride of the rows and columns that are computed. ``mu`` is the relaxation
    factor of each step; iterations end where |T(p) - q| is below the tolerance, in pixels, or at their ``limit`` for
    one stroke. If ``corrected``, steps use the Gauss–Newton matrix in place of the published one.

    Returns
    -------
    points : float32 array, shape (H, W, 2), or (H, W, 3) with a ``z``
        In pixels, x first.
    iterations : int64 array, shape (H, W)
        The sum over all strokes.
    residual : float64 array, shape (H, W)
        |T(p) - q| of all strokes together, in pixels. A value above the tolerance means that the method has not
        converged, or that the errors of the strokes have added up.
    """
    if (table["power"] != 1).any() or table["joined"].any():
        raise SuppleError("the published method is for grabs alone, one after the other, found another brush")
    ndim = 2 if z is None else 3
    height, width = -(-shape[0] // every), -(-shape[1] // every)
    points = np.empty((height, width, ndim), np.float32)
    counts, residual = np.empty((height, width), np.int64), np.empty((height, width))
    rows = numbers(table)
    _core.invert_as_published(rows, axes, z or 0.0, every, mu, tolerance, limit, corrected, points, counts, residual)
    if table.size > 1:
        given = np.zeros((points[..., 0].size, 3))
        given[:, :ndim] = points.reshape(-1, ndim) * axes[:ndim, 3]
        moved, _ = _core.forward(rows, axes, given, False)
        x, y = np.meshgrid(np.arange(0, shape[1], every), np.arange(0, shape[0], every))
        target = np.stack([x, y, np.full(x.shape, z or 0.0)], axis=-1).reshape(-1, 3)
        residual = np.linalg.norm((moved / axes[:, 3] - target)[:, :ndim], axis=1).reshape(residual.shape)
    return points, counts, residual
