"""The geometry of a volume in space: spacing, origin and direction, and the two conventions of scanners."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from supple.domain import choice, refuse
from supple.errors import SuppleError

Floats = npt.NDArray[np.float64]

CONVENTIONS = ("LPS", "RAS", "array")
_FLIP = np.array([-1.0, -1.0, 1.0])


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
        Its columns are the directions of the axes, in LPS: orthonormal.
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
        if not np.allclose(direction.T @ direction, np.eye(3), atol=1e-3):
            raise SuppleError(
                "the volume's axes are not at right angles to each other, or not of unit length: resample it first"
            )
        direction.flags.writeable = False
        for name, value in (("spacing", spacing), ("origin", origin), ("direction", direction)):
            object.__setattr__(self, name, value)

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix (4, 4) from the index of a voxel, x first, to its position in LPS."""
        made = np.eye(4)
        made[:3, :3] = self.direction * self.spacing
        made[:3, 3] = self.origin
        return made

    @property
    def oblique(self) -> float:
        """The angle in degrees of the most oblique axis to its nearest axis of the patient; 0 below 0.05."""
        nearest = np.abs(self.direction).max(axis=0).min()
        degrees = float(np.degrees(np.arccos(min(nearest, 1.0))))
        return degrees if degrees > 0.05 else 0.0

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
