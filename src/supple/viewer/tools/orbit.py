"""The camera before a volume: orbit, pan and zoom by the pointer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from supple.render.camera import Camera, Projection, view_of
from supple.space.domain import SMALLEST
from supple.space.geometry import Geometry

TURN = 180.0  # degrees for a drag across the shorter side of the canvas
FARTHEST = 10.0  # the largest distance of the camera, in multiples of that at which the volume fits
STEP = 1.1  # the factor of the distance for a notch of the wheel, which is 100


@dataclass(frozen=True, slots=True)
class Stage:
    """The volume before a camera, and its canvas."""

    shape: tuple[int, ...]  # of the volume, (Z, H, W)
    geometry: Geometry
    size: tuple[int, int]  # rows and columns of the canvas, in logical pixels
    points: npt.NDArray[np.float64] | None = None  # that are in view at first, in voxels (N, 3); None: the whole volume

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
        """Return the camera with its target and distance, by which it is in the same place before any scene."""
        x, y, z = self.target(camera)
        return replace(camera, target=(x, y, z), distance=self.distance(camera))

    def distance(self, camera: Camera) -> float:
        """Return the distance from the camera to its target, in millimetres."""
        return self.view(camera).distance

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
    view, distance = stage.view(camera), stage.distance(camera)
    moved = np.array(stage.target(camera)) - (dx * view.packed[3] + dy * view.packed[4]) * distance / view.spacing
    last = np.array(stage.shape[::-1]) - 1.0
    x, y, z = np.clip(moved, 0.0, last).tolist()
    return replace(camera, target=(x, y, z), distance=distance)


def dolly(camera: Camera, amount: float, stage: Stage) -> Camera:
    """Move the camera nearer (below 0), or away, by a turn of the wheel."""
    nearest = max(min(stage.geometry.spacing), SMALLEST)
    farthest = FARTHEST * stage.distance(replace(camera, distance=None))
    distance = stage.distance(camera) * STEP ** (amount / 100)
    return replace(camera, distance=min(max(distance, nearest), farthest))
