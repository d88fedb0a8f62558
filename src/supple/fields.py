"""Displacement fields and affine maps: values, files, inverses and compositions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from supple.domain import choice, refuse
from supple.errors import SuppleError
from supple.geometry import Grid

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
PathLike = str | os.PathLike[str]
Interpolation = Literal["linear", "cubic", "bspline"]
Beyond = Literal["zero", "edge"]


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
            given = np.array(matrix, np.float64)
        except (TypeError, ValueError):
            refuse("matrix", wanted, matrix)
        if (
            given.ndim != 2
            or given.shape[1] not in (3, 4)
            or given.shape[0] not in (given.shape[1] - 1, given.shape[1])
        ):
            refuse("matrix", wanted, f"shape {given.shape}")
        n = given.shape[1] - 1
        if len(given) == n:
            given = np.vstack([given, np.eye(n + 1)[-1]])
        if not np.isfinite(given).all() or not np.array_equal(given[-1], np.eye(n + 1)[-1]):
            raise SuppleError(f"an affine matrix is finite, and its last row is {n} zeros and a one, found {given}")
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
        """Return the positions (..., D) that positions (..., D) are mapped to."""
        given = np.asarray(positions, np.float64)
        return np.asarray(given @ self.matrix[:-1, :-1].T + self.matrix[:-1, -1])


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Field:
    """A displacement field: the map x → x + u(x), with u given on a grid and interpolated between.

    As resampling tools use one, it maps each point of the output to the point of the input that is seen there (pull).

    Parameters
    ----------
    values : float32 or float64 array, shape (H, W, 2) or (Z, H, W, 3)
        The displacement at each sample of the grid, x first, in the units of the grid, along the axes of space (LPS
        for volumes), not of the grid. With ``"bspline"``, the coefficients of a cubic B-spline.
    grid : Grid
        The grid of the samples.
    interpolation : str
        ``"linear"``; ``"cubic"``, a cubic B-spline through the values; ``"bspline"``, values are its coefficients.
    beyond : str
        Of a point outside the grid, farther than half a sample: no displacement (``"zero"``, as in ITK), or that of
        the nearest point of the ``"edge"``.

    Raises
    ------
    SuppleError
        If an argument is invalid, or the values hold NaN or infinity.
    """

    values: Array
    grid: Grid
    interpolation: Interpolation = field(default="linear")
    beyond: Beyond = field(default="zero")

    def __init__(
        self, values: npt.ArrayLike, grid: Grid, interpolation: Interpolation = "linear", beyond: Beyond = "zero"
    ) -> None:
        n = grid.ndim
        shape = "(H, W, 2)" if n == 2 else "(Z, H, W, 3)"
        given = np.asarray(values)
        if given.dtype.kind not in "iuf" or given.dtype.itemsize > 8:
            refuse("values", f"real numbers, as an array of shape {shape}", f"{given.dtype} of shape {given.shape}")
        if given.shape != (*grid.shape, n):
            refuse("values", f"an array of shape {(*grid.shape, n)}, as the grid is", f"shape {given.shape}")
        choice("interpolation", interpolation, get_args(Interpolation))
        choice("beyond", beyond, get_args(Beyond))
        held = np.ascontiguousarray(given, np.float64 if given.dtype.itemsize == 8 else np.float32)
        if not all(np.isfinite(part).all() for part in held):
            raise SuppleError("the field holds NaN or infinity")
        if interpolation == "bspline" and min(grid.shape) < 4:
            raise SuppleError(f"a cubic B-spline needs 4 coefficients along each axis, found {grid.shape}")
        for name, value in (
            ("values", held),
            ("grid", grid),
            ("interpolation", interpolation),
            ("beyond", beyond),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def from_array(
        cls,
        values: npt.ArrayLike,
        *,
        spacing: float | Sequence[float] = 1.0,
        origin: Sequence[float] | None = None,
        direction: npt.ArrayLike | None = None,
        interpolation: Interpolation = "linear",
        beyond: Beyond = "zero",
    ) -> Self:
        """Return a field of an array; see `Field` and `Grid` for the parameters."""
        given = np.asarray(values)
        if given.ndim not in (3, 4) or given.shape[-1] != given.ndim - 1 or 0 in given.shape:
            refuse("values", "an array of shape (H, W, 2) or (Z, H, W, 3)", f"shape {given.shape}")
        return cls(given, Grid(given.shape[:-1], spacing, origin, direction), interpolation, beyond)

    @property
    def ndim(self) -> int:
        """The number of coordinates: 2 or 3."""
        return self.grid.ndim


Map = Affine | Field
"""A map of positions that is no stroke."""
