"""The orientation cube beside a rendering: it turns with the camera, and a face of it is a side to look from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from supple.render.appearance import lamp
from supple.render.camera import Camera
from supple.viewer.tools.drags import Pair
from supple.viewer.tools.orbit import Stage

HALF = 21.0  # logical pixels of half an edge
ROOMY = 240.0  # logical pixels: a narrower or lower rendering has no room for a cube
_INSET = 46.0  # logical pixels from its middle to the lower right edges of the rendering
# For each axis of LPS, the angles of a camera at its positive and at its negative end.
# What is in front of the patient is up as the crown or the feet are seen, as in 3D Slicer.
_SIDES = (
    ((90.0, 0.0), (-90.0, 0.0)),
    ((180.0, 0.0), (0.0, 0.0)),
    ((180.0, 90.0), (0.0, -90.0)),
)
_AROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1))


@dataclass(frozen=True, slots=True)
class Face:
    """A visible face of the cube.

    Parameters
    ----------
    name : str
        The side of the patient, R, L, A, P, S or I; or the axis of the voxels with its sign, without a patient.
    corners : tuple of (float, float)
        On the canvas, one after the other.
    middle : (float, float)
    towards : float
        The cosine of the angle to the line of sight: 1 for a face that is seen from the front.
    lit : float
        The cosine of the angle to the lamp of the rendering; 0 for a face that is turned away from it.
    azimuth, elevation : float
        The angles of the camera that looks at this side.
    """

    name: str
    corners: tuple[Pair, ...]
    middle: Pair
    towards: float
    lit: float
    azimuth: float
    elevation: float

    def holds(self, x: float, y: float) -> bool:
        """Return whether a position of the canvas is on the face."""
        turns = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in pairwise((*self.corners, self.corners[0]))
        ]
        return min(turns) >= 0 or max(turns) <= 0

    def camera(self, camera: Camera) -> Camera:
        """Return a camera that looks at this side, upright, at the distance and the target of another."""
        up = (0.0, 0.0, 1.0)
        return replace(camera, azimuth=self.azimuth, elevation=self.elevation, roll=0.0, up=up)


def faces_of(stage: Stage, camera: Camera, corner: Pair) -> tuple[Face, ...]:
    """Return the visible faces of the cube in a rendering with its upper left corner there; none without room."""
    height, width = stage.size
    if min(width, height) < ROOMY:
        return ()
    seen, geometry = stage.view(camera), stage.geometry
    right, down = (axis / np.linalg.norm(axis) for axis in seen.packed[3:])
    light, axes = lamp(seen), geometry.direction.T  # a column for each axis of LPS, along the axes of the volume
    x, y = corner[0] + width - _INSET, corner[1] + height - _INSET

    def placed(point: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Pair:
        return x + HALF * float(point @ right), y + HALF * float(point @ down)

    found = []
    for k, sides in enumerate(_SIDES):
        for sign, name, (azimuth, elevation) in zip((1.0, -1.0), geometry.sides[k], sides, strict=True):
            normal, (a, b) = sign * axes[:, k], (axes[:, k - 2], axes[:, k - 1])
            towards = -float(normal @ seen.ahead)
            if towards <= 1e-6:
                continue
            corners = tuple(placed(normal + i * a + j * b) for i, j in _AROUND)
            lit = max(float(normal @ light), 0.0)
            found.append(Face(name, corners, placed(normal), towards, lit, azimuth, elevation))
    return tuple(found)


def face_at(faces: Sequence[Face], place: Pair) -> Face | None:
    """Return the face at a position of the canvas."""
    return next((face for face in faces if face.holds(*place)), None)
