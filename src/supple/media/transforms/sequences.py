"""Sequences of maps as short as they may be: matrices multiplied, and fields on the oriented grids that they stand for.

Where fields lie along the axes of space, one on a turned grid is written as three maps: M into the axes of the field,
the field u, and M⁻¹ back. That is x → M⁻¹ (M x + u(M x)) = x + L u(M x), with L the linear part of M⁻¹: one field of
the vectors L u, whose samples lie where M⁻¹ puts those of u.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np

from supple.errors import SuppleError
from supple.media.transforms.base import Content, Displacements, Matrix
from supple.space.geometry import Grid

_EXACT = 1e-6  # of a voxel


def shortened(parts: Iterable[Content]) -> list[Content]:
    """Return the same map of fewer parts, the first first.

    Fields between a matrix and its inverse become fields on oriented grids, before matrices that follow each other are
    multiplied, so that a field's own matrices are not lost among others; and after that, since a sequence may spell
    each of them as several.
    """
    return _oriented(_merged(_oriented(parts)))


def _merged(parts: Iterable[Content]) -> list[Content]:
    """Return the parts with matrices that follow each other multiplied."""
    made: list[Content] = []
    for part in parts:
        if made and isinstance(part, np.ndarray) and isinstance(made[-1], np.ndarray):
            made[-1] = np.asarray(part @ made[-1])
        else:
            made.append(part)
    return made


def _oriented(parts: Iterable[Content]) -> list[Content]:
    """Return the parts with a matrix, a field and the inverse of the matrix as one field."""
    made: list[Content] = []
    for part in parts:
        made.append(part)
        while len(made) > 2 and (whole := _one_field(*made[-3:])) is not None:
            made[-3:] = [whole]
    return made


def _one_field(before: Content, field: Content, after: Content) -> Displacements | None:
    """Return three maps as one field; None if they are no matrix, field and inverse, or their grid is sheared."""
    if isinstance(before, Displacements) or not isinstance(field, Displacements) or isinstance(after, Displacements):
        return None
    matrix = after @ field.grid.matrix
    if not _undone(before, after, matrix, field.grid.sizes):
        return None
    spacing = np.linalg.norm(matrix[:-1, :-1], axis=0)
    try:
        grid = Grid(field.grid.shape, spacing.tolist(), matrix[:-1, -1].tolist(), matrix[:-1, :-1] / spacing)
    except SuppleError:  # the axes lie in a plane
        return None
    if grid.shear:
        return None
    values = np.empty_like(field.values)
    for k, plane in enumerate(field.values):
        values[k] = plane @ after[:-1, :-1].T
    return field._replace(values=values, grid=grid)


def _undone(before: Matrix, after: Matrix, matrix: Matrix, sizes: tuple[int, ...]) -> bool:
    """Return whether ``after`` undoes ``before`` at all samples of a grid, with ``matrix`` from their indices."""
    if not abs(np.linalg.det(matrix)) > 0:
        return False
    # of an index: by how many voxels its position is off
    off = np.linalg.inv(matrix) @ (after @ before - np.eye(len(after))) @ matrix
    corners = np.array([(*corner, 1.0) for corner in product(*[(0, size - 1) for size in sizes])])
    # A single voxel may stay where all around it is turned, which counts too: so the linear part is looked at.
    return bool(np.abs(corners @ off.T).max() < _EXACT and np.abs(off[:-1, :-1]).max() < _EXACT)
