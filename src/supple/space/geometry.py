"""Grids of samples in space: shape, spacing, origin and direction; and the conventions LPS and RAS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations, product
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.space.checks import (
    Shape,
    Vector,
    assign,
    checked_shape,
    checked_spacing,
    choice,
    integer,
    items,
    point,
    refuse,
    varied,
)

Floats = npt.NDArray[np.float64]

Box = tuple[Floats, Floats]
"""The least and the largest coordinates of a box, along the axes of space."""

CONVENTIONS = ("LPS", "RAS", "array")
SIDES = (("L", "R"), ("P", "A"), ("S", "I"))
"""The sides of a patient at the positive and at the negative end of each axis of LPS."""
PLANES = {
    "axial": ((2, 1), (0, 1), (1, 1)),
    "coronal": ((1, -1), (0, 1), (2, -1)),
    "sagittal": ((0, 1), (1, 1), (2, -1)),
}
"""The planes of a patient, as radiologists view them: the LPS axes, with signs, to the next slice, right and down."""
_FLIP = np.array([-1.0, -1.0, 1.0])
_ROUNDED = 1e-3  # in cosines and squares of lengths: the rounding of headers
_FLAT = 0.1  # the volume of the axes' directions: below it, they nearly lie in a plane
_SPARE = 1e-4  # samples: rounding of thousands of samples in float32 headers


def plane_axes(direction: npt.ArrayLike, name: str) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the axes of a grid nearest to those of one of `PLANES`, and 1 for each of the same direction, or -1."""
    turned = np.array(direction)
    order = max(permutations(range(3)), key=lambda axes: math.prod(abs(turned[k, axes[k]]) for k in range(3)))
    ways = PLANES[name]
    return tuple(order[k] for k, _ in ways), tuple(way if turned[k, order[k]] >= 0 else -way for k, way in ways)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """A grid of voxels in space.

    The voxel with the index (i, j, k), x first, lies at ``origin + direction @ (spacing * index)``, in millimetres,
    where x points to the patient's left, y to the back and z to the head (LPS, as in DICOM and ITK).

    Parameters
    ----------
    spacing : (float, float, float)
        Millimetres from a voxel to the next, x first.
    origin : (float, float, float)
        The position of the first voxel, in LPS.
    direction : float64 array, shape (3, 3)
        Its columns are the directions of the axes, in LPS: of unit length. They may be sheared, as for slices of a
        tilted gantry.
    convention : str
        The coordinates of points in the file: ``"LPS"``, or ``"RAS"`` (x to the right, y to the front), as in NIfTI; or
        ``"array"`` without a position in space.
    """

    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: Floats = field(default_factory=lambda: np.eye(3))
    convention: str = "array"

    def __post_init__(self) -> None:
        direction = np.array(self.direction, np.float64).reshape(3, 3)
        spacing, origin = (tuple(float(x) for x in v) for v in (self.spacing, self.origin))
        choice("convention", self.convention, CONVENTIONS)
        if not all(0 < s < np.inf for s in spacing):
            refuse("spacing", "three numbers above 0", self.spacing)
        if not np.isfinite(origin).all() or not np.isfinite(direction).all():
            raise SuppleError("a volume's origin and direction must be finite")
        _check_direction(direction, "the volume's axes")
        direction.flags.writeable = False
        assign(self, spacing=spacing, origin=origin, direction=direction)

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix (4, 4) from the index of a voxel, x first, to its position in LPS."""
        made = np.eye(4)
        made[:3, :3] = self.direction * self.spacing
        made[:3, 3] = self.origin
        return made

    @property
    def sides(self) -> tuple[tuple[str, str], ...]:
        """Names of the positive and the negative end of each LPS axis; without a patient, signed axis names."""
        return (("+x", "-x"), ("+y", "-y"), ("+z", "-z")) if self.convention == "array" else SIDES

    @property
    def oblique(self) -> float:
        """The angle in degrees of the most oblique axis to its nearest axis of the patient; 0 below 0.05."""
        nearest = np.abs(self.direction).max(axis=0).min()
        degrees = float(np.degrees(np.arccos(min(nearest, 1.0))))
        return degrees if degrees > 0.05 else 0.0

    @property
    def shear(self) -> float:
        """The largest deviation of two axes from a right angle, in degrees; 0 within the rounding of headers."""
        return _shear(self.direction)

    def to_lps(self, indices: npt.ArrayLike) -> Floats:
        """Return the positions in LPS, in millimetres, of indices (..., 3), x first."""
        scaled = np.asarray(indices, np.float64) * self.spacing
        return np.asarray(scaled @ self.direction.T + self.origin, np.float64)

    def from_lps(self, places: npt.ArrayLike) -> Floats:
        """Return the indices, x first, of positions (..., 3) in LPS, in millimetres."""
        moved = np.asarray(places, np.float64) - self.origin
        return np.asarray(moved @ np.linalg.inv(self.direction).T / self.spacing, np.float64)

    def to_world(self, indices: npt.ArrayLike, convention: str | None = None) -> Floats:
        """Return the positions of indices in a convention; by default, the file's own."""
        return self._turned(self.to_lps(indices), convention)

    def from_world(self, places: npt.ArrayLike, convention: str | None = None) -> Floats:
        """Return the indices of positions in a convention; by default, the file's own."""
        return self.from_lps(self._turned(np.asarray(places, np.float64), convention))

    def _turned(self, places: Floats, convention: str | None) -> Floats:
        known = convention or self.convention
        choice("convention", known, CONVENTIONS)
        return places * _FLIP if known == "RAS" else places

    def grid(self, shape: Sequence[int]) -> Grid:
        """Return the grid of a volume of this shape."""
        return Grid(shape, self.spacing, self.origin, self.direction)


@dataclass(frozen=True, slots=True, init=False)
class Grid:
    """A regular grid of samples in the plane or in space.

    The sample with the index i, x first, lies at ``origin + direction @ (spacing * i)``. Positions of a volume are in
    millimetres in LPS (x to the patient's left, y to the back, z to the head, as in DICOM and ITK); those of a picture
    are in pixels unless it has a spacing.

    Parameters
    ----------
    shape : sequence of int
        The array's shape: ``(H, W)`` or ``(Z, H, W)``.
    spacing : float or sequence of float
        The distance from a sample to the next, x first.
    origin : sequence of float, optional
        The position of the first sample; by default 0.
    direction : array_like, shape (D, D), optional
        Its columns are the directions of the axes: of unit length. By default, those of space.
    """

    shape: Shape
    spacing: Vector
    origin: Vector
    direction: tuple[Vector, ...]
    # For a part of a grid: the index of its first sample in the whole grid, and the shape and origin of the whole.
    first: Shape = field(repr=False)
    whole: Shape = field(repr=False)
    start: Vector = field(repr=False)

    def __init__(
        self,
        shape: Sequence[int],
        spacing: float | Sequence[float] = 1.0,
        origin: Sequence[float] | None = None,
        direction: npt.ArrayLike | None = None,
    ) -> None:
        sizes = checked_shape(shape)
        n = len(sizes)
        start = (0.0,) * n if origin is None else point("origin", origin, (n,))
        try:
            turned = np.eye(n) if direction is None else np.asarray(direction, np.float64).reshape(n, n)
        except (TypeError, ValueError):
            refuse("direction", f"an array of shape ({n}, {n}), its columns the directions of the axes", direction)
        _check_direction(turned, "the grid's axes")
        assign(self, shape=sizes, spacing=checked_spacing(spacing, n), origin=start, first=(0,) * n, whole=sizes)
        assign(self, direction=tuple(map(tuple, turned.tolist())), start=start)

    @property
    def ndim(self) -> int:
        """The number of axes: 2 or 3."""
        return len(self.shape)

    @property
    def sizes(self) -> Shape:
        """The number of samples along each axis, x first."""
        return self.shape[::-1]

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix (D + 1, D + 1) from the index of a sample, x first, to its position."""
        made = np.eye(self.ndim + 1)
        made[:-1, :-1] = np.multiply(self.direction, self.spacing)
        made[:-1, -1] = self.origin
        return made

    def geometry(self, convention: str) -> Geometry:
        """Return the geometry of a volume's samples, in a convention of `Geometry`; the inverse of `Geometry.grid`."""
        (x, y, z), (a, b, c) = self.spacing, self.origin
        return Geometry((x, y, z), (a, b, c), np.array(self.direction), convention)

    @property
    def box(self) -> Box:
        """The box around the grid, up to half a sample beyond its outermost samples."""
        places = self.positions(self.corners(0.5))
        return places.min(axis=0), places.max(axis=0)

    @property
    def shear(self) -> float:
        """The largest deviation of two axes from a right angle, in degrees; 0 within the rounding of headers."""
        return _shear(np.array(self.direction))

    def upright(self) -> Grid:
        """Return the grid, or, if it is sheared, the smallest grid around it with axes at right angles.

        That has the same first axis, the same plane of the first two axes, and the same distances between rows and
        between slices.
        """
        if not self.shear:
            return self
        turned, steps = _squared(np.array(self.direction), self.spacing)
        places = self.positions(self.corners()) @ turned
        low, high = places.min(axis=0), places.max(axis=0)
        sizes = [math.ceil(n - _SPARE) + 1 for n in ((high - low) / steps).tolist()]
        return Grid(sizes[::-1], steps.tolist(), (turned @ low).tolist(), turned)

    def corners(self, beyond: float = 0.0) -> Floats:
        """Return the indices of the corners, shape (2^D, D), or of points ``beyond`` samples outside of them."""
        return np.array([*product(*[(0.0 - beyond, size - 1 + beyond) for size in self.sizes])])

    def positions(self, indices: npt.ArrayLike) -> Floats:
        """Return the positions of indices (..., D), x first."""
        matrix = self.matrix
        return np.asarray(np.asarray(indices, np.float64) @ matrix[:-1, :-1].T + matrix[:-1, -1])

    def indices(self, positions: npt.ArrayLike) -> Floats:
        """Return the indices, x first, of positions (..., D)."""
        moved = np.asarray(positions, np.float64) - self.origin
        return np.asarray(moved @ np.linalg.inv(self.matrix[:-1, :-1]).T)

    def crop(self, first: Sequence[int], sizes: Sequence[int]) -> Self:
        """Return a part of the grid; samples on it equal those on the whole grid, bit for bit.

        Parameters
        ----------
        first : sequence of int
            The index of its first sample, x first.
        sizes : sequence of int
            The number of its samples along each axis, x first.

        Raises
        ------
        SuppleError
            If it is not within the grid.
        """
        n = self.ndim
        starts = items("first", first, f"{n} indices, x first", (n,))
        counts = items("sizes", sizes, f"{n} numbers of samples, x first", (n,))
        for i, size in enumerate(self.sizes):
            starts[i] = integer(f"first[{i}]", starts[i], f"an index from 0 to {size - 1}", 0, size - 1)
            most = size - starts[i]
            counts[i] = integer(f"sizes[{i}]", counts[i], f"a number of samples from 1 to {most}", 1, most)
        first = tuple(map(sum, zip(self.first, starts, strict=True)))
        return varied(self, shape=tuple(counts[::-1]), origin=tuple(self.positions(starts).tolist()), first=first)

    def uncropped(self) -> Self:
        """Return the whole grid of which this is a part, or this grid if it is whole."""
        return self if self.whole == self.shape else type(self)(self.whole, self.spacing, self.start, self.direction)

    def resampled(self, spacing: float | Sequence[float]) -> Self:
        """Return a grid of another spacing that covers the same extent, from outer edge to outer edge."""
        steps = np.array(checked_spacing(spacing, self.ndim))
        extent = np.multiply(self.sizes, self.spacing)
        sizes = [max(1, math.ceil(x - _SPARE)) for x in (extent / steps).tolist()]
        corner = self.positions((extent - steps * sizes) / (2 * np.array(self.spacing)) - 0.5)
        origin = corner + np.array(self.direction) @ (steps / 2)
        return type(self)(sizes[::-1], steps.tolist(), origin.tolist(), self.direction)

    def is_same_space(self, other: Any) -> bool:
        """Return whether another grid has the same samples, within a thousandth of the spacing."""
        if not isinstance(other, Grid) or self.shape != other.shape:
            return False
        off = self.indices(other.positions(self.corners())) - self.corners()
        return bool(np.abs(off).max() < 1e-3)


def _check_direction(direction: Floats, what: str) -> None:
    """Raise SuppleError for directions that are not of unit length, or nearly lie in a plane."""
    if not np.allclose((direction**2).sum(axis=0), 1.0, atol=_ROUNDED):
        raise SuppleError(f"{what} are not of unit length: correct its header")
    if not abs(np.linalg.det(direction)) > _FLAT:
        raise SuppleError(f"{what} nearly lie in a plane: correct its header")


def _shear(direction: Floats) -> float:
    found = float(np.abs(direction.T @ direction - np.eye(len(direction))).max())
    return float(np.degrees(np.arcsin(min(found, 1.0)))) if found > _ROUNDED else 0.0


def _squared(direction: Floats, spacing: Sequence[float]) -> tuple[Floats, Floats]:
    """Return orthonormal directions with the same spans (Gram-Schmidt), and the spacing along them."""
    turned, upper = np.linalg.qr(direction)
    ways = np.sign(np.diag(upper))
    return turned * ways, np.diag(upper) * ways * spacing


def check_upright(place: Geometry | Grid, name: str, what: str) -> None:
    """Raise SuppleError for axes that are not at right angles to each other.

    ``name`` is the name of the file in messages, and ``what`` the work that needs right angles.
    """
    if place.shear:
        steps = _squared(np.array(place.direction), place.spacing)[1]
        asked = ",".join(f"{step:.7g}" for step in steps.tolist())
        raise SuppleError(
            f"{what} takes axes at right angles to each other, and those of {name} miss them by {place.shear:.3g}°: "
            f"supple warp {name} upright.nii.gz --resample {asked} makes a volume that has them"
        )


def overlap(one: Box, other: Box) -> bool:
    """Return whether two boxes overlap."""
    (low, high), (least, most) = one, other
    return bool(np.all(low <= most) and np.all(least <= high))


def check_boxes(one: Box, what: str, other: Box, where: str) -> None:
    """Raise SuppleError for boxes that lie apart; ``what`` and ``where`` name them."""
    if not overlap(one, other):
        found = ", and ".join(map(_told, (one, other)))
        raise SuppleError(f"{what} and {where} do not overlap: {found}: check their positions in space")


def _told(box: Box) -> str:
    low, high = (", ".join(f"{x + 0.0:.4g}" for x in corner) for corner in box)
    return f"from ({low}) to ({high})"
