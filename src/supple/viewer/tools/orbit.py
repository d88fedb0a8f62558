"""The camera before a volume, moved by the pointer; and the orientation cube in the rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from supple.render.appearance import lamp
from supple.render.camera import Camera, Projection, view_of
from supple.space.checks import SMALLEST
from supple.space.geometry import Geometry
from supple.viewer.tools.drawing import Pair

TURN = 180.0  # degrees for a drag across the shorter side of the canvas
FARTHEST = 10.0  # the largest distance of the camera, in multiples of that at which the volume fits
STEP = 1.1  # the factor of the distance for a notch of the wheel, which is 100
HALF = 21.0  # logical pixels of half an edge
ROOMY = 240.0  # logical pixels: a narrower or lower rendering has no room for a cube
_INSET = 46.0  # logical pixels from the cube's middle to the right and lower edges of the rendering
# For each axis of LPS, the angles of a camera at its positive and at its negative end.
# Seen from the crown or from the feet, the patient's front is up, as in 3D Slicer.
_SIDES = (
    ((90.0, 0.0), (-90.0, 0.0)),
    ((180.0, 0.0), (0.0, 0.0)),
    ((180.0, 90.0), (0.0, -90.0)),
)
_AROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The volume before a camera, and its canvas."""

    shape: tuple[int, ...]  # of the volume, (Z, H, W)
    geometry: Geometry
    size: tuple[int, int]  # rows and columns of the canvas, in logical pixels
    points: npt.NDArray[np.float64] | None = None  # in view at first, in voxels, (N, 3); None for the whole volume

    @lru_cache(maxsize=16)  # noqa: B019 - of the last views, as each mark in a frame asks for one
    def view(self, camera: Camera) -> Projection:
        """Return the projection of a camera."""
        return view_of(camera, self.shape, self.geometry, self.size, self.points)

    def target(self, camera: Camera) -> tuple[float, ...]:
        """Return the target of the camera, in indices, x first."""
        if camera.target is not None:
            return camera.target
        if self.points is None:
            return tuple((n - 1) / 2 for n in reversed(self.shape))
        return tuple(((self.points.min(axis=0) + self.points.max(axis=0)) / 2).tolist())

    def placed(self, camera: Camera) -> Camera:
        """Return the camera with its target and distance set, so that it is in the same place for every scene."""
        x, y, z = self.target(camera)
        return replace(camera, target=(x, y, z), distance=self.view(camera).distance)

    def project(self, camera: Camera, point: tuple[float, ...]) -> tuple[float, float, float] | None:
        """Return the position of a voxel on the canvas, and its distance from the eye; None behind the camera."""
        view = self.view(camera)
        away = (np.asarray(point) - view.eye) * view.spacing
        ahead = float(away @ view.ahead)
        if ahead <= 0:
            return None
        height, width = self.size
        # A canvas is measured from its corner, a pixel from its centre: the half pixels cancel.
        x, y = (float(away @ axis / (axis @ axis)) / ahead for axis in view.packed[3:])
        return x + width / 2, y + height / 2, float(np.linalg.norm(away))

    def scale(self, camera: Camera, point: tuple[float, ...]) -> float:
        """Return the logical pixels of a millimetre at a point; 0 behind the camera."""
        view = self.view(camera)
        ahead = float((np.asarray(point) - view.eye) * view.spacing @ view.ahead)
        return 1 / (float(np.linalg.norm(view.packed[3])) * ahead) if ahead > 0 else 0.0


def orbit(camera: Camera, dx: float, dy: float, stage: Stage) -> Camera:
    """Turn the volume with the pointer, moved by logical pixels; not beyond the poles."""
    roll, step = math.radians(camera.roll), TURN / max(1, min(stage.size))
    across = math.cos(roll) * dx - math.sin(roll) * dy
    along = math.sin(roll) * dx + math.cos(roll) * dy
    return replace(
        camera,
        azimuth=math.remainder(camera.azimuth - step * across, 360.0),
        elevation=min(max(camera.elevation + step * along, -90.0), 90.0),
    )


def pan(camera: Camera, dx: float, dy: float, stage: Stage) -> Camera:
    """Move the volume with the pointer; the camera always looks at it."""
    view = stage.view(camera)
    moved = np.array(stage.target(camera)) - (dx * view.packed[3] + dy * view.packed[4]) * view.distance / view.spacing
    last = np.array(stage.shape[::-1]) - 1.0
    x, y, z = np.clip(moved, 0.0, last).tolist()
    return replace(camera, target=(x, y, z), distance=view.distance)


def dolly(camera: Camera, amount: float, stage: Stage) -> Camera:
    """Move the camera nearer (below 0), or away, by a turn of the wheel."""
    nearest = max(min(stage.geometry.spacing), SMALLEST)
    farthest = FARTHEST * stage.view(replace(camera, distance=None)).distance
    distance = stage.view(camera).distance * STEP ** (amount / 100)
    return replace(camera, distance=min(max(distance, nearest), farthest))


@dataclass(frozen=True, slots=True)
class Face:
    """A visible face of the cube."""

    name: str  # the side of the patient, R, L, A, P, S or I; or the axis of the voxels with its sign, without a patient
    corners: tuple[Pair, ...]  # on the canvas, one after the other
    middle: Pair
    towards: float  # the cosine of the angle to the line of sight: 1 for a face that is seen from the front
    lit: float  # the cosine of the angle to the lamp of the rendering; 0 for a face that is turned away from it
    azimuth: float  # the angles of the camera that looks at this side
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
    """Return the visible faces of the cube in a rendering with its upper left at ``corner``; none without room."""
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
