"""Displacement fields of tests, and what SciPy makes of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from supple import Field, Grid

Floats = npt.NDArray[np.float64]

SHAPE = (12, 17, 15)
SPACING = (1.1, 0.9, 1.6)
ORIGIN = (-20.0, 13.5, 40.25)


def turn(angle: float = 0.4) -> Floats:
    """Directions along no axis of space, left-handed."""
    c, s = np.cos(angle), np.sin(angle)
    return (
        np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        @ np.diag([1, -1, 1])
    )


GRID = Grid(SHAPE, SPACING, ORIGIN, turn())


def positions(grid: Grid) -> Floats:
    """Return the positions (*shape, D) of all samples."""
    return grid.positions(np.moveaxis(np.indices(grid.shape)[::-1], 0, -1))


def smooth(grid: Grid = GRID, size: float = 1.0, seed: int = 0, dtype: Any = np.float64) -> Field:
    """A field of a few waves, each of some samples."""
    rng = np.random.default_rng(seed)
    index = np.indices(grid.shape)[::-1].astype(float)
    values = np.zeros((*grid.shape, grid.ndim))
    for c in range(grid.ndim):
        for _ in range(3):
            waves = rng.uniform(0.1, 0.5, grid.ndim)
            values[..., c] += np.sin(np.tensordot(waves, index, 1) + rng.uniform(0, 6)) / 3
    return Field((size * values).astype(dtype), grid)


def sine(strength: float, shape: tuple[int, ...] = (3, 4, 126), step: float = 0.1) -> Field:
    """The field u = −a sin x along the first axis, which folds where a cos x > 1, and there alone."""
    n = len(shape)
    values = np.zeros((*shape, n))
    values[..., 0] = -strength * np.sin(np.arange(shape[-1]) * step)
    return Field.from_array(values, spacing=(step, 1.0, 1.0)[:n])


def moved(field: Field, points: Floats) -> Floats:
    """Return x + u(x) at points (..., D), interpolated by SciPy; u goes on as at the edge."""
    index = np.moveaxis(field.grid.indices(points), -1, 0)[::-1]
    steps = [map_coordinates(field.values[..., c], index, order=1, mode="nearest") for c in range(field.ndim)]
    return points + np.stack(steps, axis=-1)
