"""Affine and projective maps of positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.space.checks import refuse
from supple.space.geometry import Floats


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Affine:
    """An affine map of positions, x → A x + b.

    Parameters
    ----------
    matrix : array_like, shape (D + 1, D + 1) or (D, D + 1)
        The homogeneous matrix; positions are in the units of the grids that it is used with (millimetres in LPS for
        volumes).

    Raises
    ------
    SuppleError
        If the matrix has another shape, is not finite, or is singular.
    """

    matrix: Floats

    def __init__(self, matrix: npt.ArrayLike) -> None:
        wanted = "an array of shape (3, 3) or (2, 3) for pictures, (4, 4) or (3, 4) for volumes"
        try:
            given = np.asarray(matrix)
            if given.dtype.kind == "c":
                refuse("matrix", wanted, told="complex numbers")
            given = np.array(given, np.float64)
        except (TypeError, ValueError):
            refuse("matrix", wanted, matrix)
        if given.shape not in ((2, 3), (3, 3), (3, 4), (4, 4)):
            refuse("matrix", wanted, told=f"shape {given.shape}")
        n = given.shape[1] - 1
        if len(given) == n:
            given = np.vstack([given, np.eye(n + 1)[-1]])
        if not np.isfinite(given).all() or not np.array_equal(given[-1], np.eye(n + 1)[-1]):
            raise SuppleError(
                f"an affine matrix is finite, and its last row is {n} zeros and a one, found {given.tolist()}"
            )
        scale = np.abs(given[:-1, :-1]).max(initial=0.0)
        if not abs(np.linalg.det(given[:-1, :-1] / (scale or 1.0))) > 1e-12:
            raise SuppleError("the affine map is singular: it has no inverse")
        given.flags.writeable = False
        object.__setattr__(self, "matrix", given)

    @property
    def ndim(self) -> int:
        """The number of coordinates: 2 or 3."""
        return len(self.matrix) - 1

    def inverse(self) -> Self:
        """Return the inverse map."""
        return type(self)(np.linalg.inv(self.matrix))

    def __call__(self, positions: npt.ArrayLike) -> Floats:
        """Return positions (..., D) mapped by the affine map."""
        given = np.asarray(positions, np.float64)
        return np.asarray(given @ self.matrix[:-1, :-1].T + self.matrix[:-1, -1])


@dataclass(frozen=True, slots=True, eq=False)
class Projective:
    """A projective map of positions in the plane, x → (A x + b) / (c·x + d), where the denominator is above 0.

    Parameters
    ----------
    matrix : float64 array, shape (3, 3)
        The homogeneous matrix, of rows (A, b) and (c, d).
    """

    matrix: Floats
    ndim = 2


def matrix_rows(matrix: Floats, more: int = 0) -> tuple[Floats, Floats]:
    """Return the rows of a homogeneous matrix, and of its inverse, as the core takes them.

    The last row, that of an affine map, is left out; with ``more`` = 1, for a projective map, it is included.
    """
    n = len(matrix) - 1 + more
    return np.ascontiguousarray(matrix[:n]), np.ascontiguousarray(np.linalg.inv(matrix)[:n])
