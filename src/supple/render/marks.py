"""Marks on a picture of a volume: a scale bar, and the sides of the patient that lie beyond its edges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from supple.render.camera import Projection
from supple.space.geometry import Geometry

_PART = 0.25  # of the picture's width: no bar is longer
_SLANT = math.sin(math.radians(15))  # a direction that is turned by less towards a side does not name it
_UNITS = ((1000.0, "m"), (1.0, "mm"), (1e-3, "µm"), (1e-6, "nm"))


@dataclass(frozen=True, slots=True)
class Bar:
    """A scale bar.

    Parameters
    ----------
    length : float
        In millimetres: 1, 2 or 5 times a power of ten.
    pixels : float
        Its length in the picture, at the distance of the camera's target.
    """

    length: float
    pixels: float

    @property
    def label(self) -> str:
        """The length with its unit."""
        unit, name = next((each for each in _UNITS if self.length >= each[0] * (1 - 1e-9)), _UNITS[-1])
        return f"{self.length / unit:g} {name}"


def bar_of(view: Projection) -> Bar:
    """Return the longest scale bar that takes at most a quarter of a picture's width."""
    pixel = view.distance * float(np.linalg.norm(view.packed[3]))  # in millimetres
    most = _PART * view.size[1] * pixel
    length = rounded(most)
    return Bar(length, length / pixel)


def rounded(most: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not more."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(k * power for k in (1.0, 2.0, 5.0) if k == 1.0 or k * power <= most * (1 + 1e-9))


def sides_of(view: Projection, geometry: Geometry) -> tuple[str, str, str, str]:
    """Return what lies to the left, to the right, above and below in a picture.

    Each is one or more of the patient's sides, R, L, A, P, S and I, the nearest first; or axes of the voxels with a
    sign, for a volume without a patient.
    """
    right, down = (geometry.direction @ (axis / np.linalg.norm(axis)) for axis in view.packed[3:])

    def named(direction: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
        nearest = sorted(range(3), key=lambda k: -abs(round(float(direction[k]), 6)))
        return "".join(geometry.sides[k][int(direction[k] < 0)] for k in nearest if abs(direction[k]) > _SLANT)

    return named(-right), named(right), named(-down), named(down)
