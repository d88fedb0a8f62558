"""Landmarks of a volume, which move with it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation

Floats = npt.NDArray[np.float64]


class Landmarks:
    """Named points of a volume, before and after strokes.

    Parameters
    ----------
    names : tuple of str
    points : float64 array, shape (N, 3)
        In voxels of the volume without strokes, x first.
    """

    def __init__(self, names: tuple[str, ...], points: Floats) -> None:
        self.names, self.points = names, points
        self._moved: tuple[Deformation, Floats] | None = None

    def moved(self, deformation: Deformation) -> Floats:
        """Return where the points are after strokes, (N, 3); the last answer is cached."""
        if deformation.is_identity:
            return self.points
        if self._moved is None or self._moved[0] is not deformation:
            self._moved = deformation, np.asarray(deformation.forward(self.points), np.float64)
        return self._moved[1]
