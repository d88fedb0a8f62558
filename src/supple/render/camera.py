"""Cameras for rendering a volume, their rays, the scale bar, and the names of the patient's sides."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from supple.space.checks import integer, number, point, refuse
from supple.space.geometry import Floats, Geometry


@dataclass(frozen=True, slots=True)
class Camera:
    """A perspective camera on an orbit around the centre of a volume.

    Angles follow a patient: at 0, 0 the camera is in front of the face. In data without a patient, the face looks along
    -y, and the head is along +z.

    Parameters
    ----------
    azimuth : float
        Degrees around the vertical axis: 90 looks at the patient's left side, 180 from the back.
    elevation : float
        Degrees above the horizon, from -90 to 90.
    distance : float, optional
        From the eye to the target, in millimetres; by default, the whole volume fits.
    field_of_view : float
        Degrees across the shorter side of the image.
    roll : float
        The rotation of the camera about its axis, in degrees clockwise.
    target : (float, float, float), optional
        The target of the view, in indices, x first; by default, the centre of the volume.
    up : (float, float, float)
        The upward direction, in LPS; by default, the head.
    """

    azimuth: float = 0.0
    elevation: float = 0.0
    distance: float | None = None
    field_of_view: float = 30.0
    roll: float = 0.0
    target: tuple[float, ...] | None = None
    up: tuple[float, ...] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("azimuth", "roll"):
            number(name, getattr(self, name), "a number of degrees from -1e6 to 1e6", -1e6, 1e6)
        number("elevation", self.elevation, "a number of degrees from -90 to 90", -90, 90)
        number("field_of_view", self.field_of_view, "a number of degrees from 1 to 150", 1, 150)
        if self.distance is not None:
            number("distance", self.distance, "a number of millimetres from 1e-6 to 1e9", 1e-6, 1e9)
        if self.target is not None:
            object.__setattr__(self, "target", point("target", self.target, (3,)))
        object.__setattr__(self, "up", point("up", self.up, (3,)))
        if not any(self.up):
            refuse("up", "a direction, and not 0,0,0", self.up)


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """A camera before a volume, and the size of the image."""

    # (5, 3), x first: the eye, in indices; the spacing, in millimetres; the unit direction of view along the volume's
    # axes; and the steps to the next pixel to the right and below, in millimetres at a distance of a millimetre
    packed: Floats
    size: tuple[int, int]  # rows and columns of the image
    distance: float  # from the eye to the target, in millimetres

    @property
    def eye(self) -> Floats:
        """The position of the camera, in indices, x first."""
        return np.asarray(self.packed[0], np.float64)

    @property
    def spacing(self) -> Floats:
        """Millimetres from voxel to voxel, x first."""
        return np.asarray(self.packed[1], np.float64)

    @property
    def ahead(self) -> Floats:
        """The unit direction of view along the volume's axes."""
        return np.asarray(self.packed[2], np.float64)

    def direction(self, x: float, y: float) -> Floats:
        """Return the unit direction of a pixel's ray along the volume's axes."""
        height, width = self.size
        made = self.packed[2:].T @ np.array([1.0, x - (width - 1) / 2, y - (height - 1) / 2])
        return np.asarray(made / np.linalg.norm(made), np.float64)


def camera_of(given: object) -> Camera:
    """Return a camera, or the default one for None; SuppleError for other values."""
    if given is None:
        return Camera()
    if not isinstance(given, Camera):
        refuse("camera", "a Camera", given)
    return given


def view_of(
    camera: Camera, shape: tuple[int, ...], geometry: Geometry, size: tuple[int, int], points: Floats | None = None
) -> Projection:
    """Return the projection of a camera before a volume of ``shape`` (Z, H, W), for ``size`` (rows, columns).

    The default distance brings all ``points`` (N, 3), in voxels, into view; by default, they are the volume's corners.
    """
    given: object = size  # user input of any type
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        refuse("size", "two numbers of pixels, rows and columns", given)
    height, width = (
        integer(f"size[{k}]", n, "a number of pixels from 1 to 32768", 1, 32768) for k, n in enumerate(size)
    )
    spacing = np.array(geometry.spacing)
    if points is None:
        points = np.array(list(itertools.product(*((0.0, n - 1.0) for n in reversed(shape)))))
    target = (points.min(axis=0) + points.max(axis=0)) / 2 if camera.target is None else np.array(camera.target)
    half = math.radians(camera.field_of_view) / 2
    up = np.array(camera.up) / np.linalg.norm(camera.up)
    # The front is -y; if that is up, use another direction.
    front = np.array([0.0, -1.0, 0.0])
    if abs(front @ up) > 0.999:
        front = np.array([0.0, 0.0, -1.0])
    front -= (front @ up) * up
    front /= np.linalg.norm(front)
    left = np.cross(front, -up)  # of a patient facing the front
    into = geometry.direction.T  # from LPS to the volume's axes

    def axes_at(azimuth: float) -> tuple[Floats, Floats, Floats]:
        """Return the directions to the right, up and to the eye, along the volume's axes."""
        elevation, roll = math.radians(camera.elevation), math.radians(camera.roll)
        around = math.cos(azimuth) * front + math.sin(azimuth) * left
        outward = math.cos(elevation) * around + math.sin(elevation) * up
        above = math.cos(elevation) * up - math.sin(elevation) * around
        right = np.cross(above, outward)
        turned = math.cos(roll) * right - math.sin(roll) * above
        return into @ turned, into @ (math.cos(roll) * above + math.sin(roll) * right), into @ outward

    right, above, outward = axes_at(math.radians(camera.azimuth))
    distance = camera.distance
    if distance is None:
        # It fits for every azimuth, so that the size of a turning volume does not change.
        corners = (points - target) * spacing
        reach = np.array([width, height]) / min(width, height) * math.tan(half)
        distance = float(spacing.max())
        for azimuth in np.linspace(0, 2 * math.pi, 24, endpoint=False):
            across, along, towards = (corners @ axis for axis in axes_at(azimuth))
            sides = np.maximum(abs(across) / reach[0], abs(along) / reach[1])
            distance = max(distance, float((sides + towards).max()))
    eye = target + outward * distance / spacing
    pixel = 2 * math.tan(half) / min(height, width)
    return Projection(np.stack([eye, spacing, -outward, pixel * right, -pixel * above]), (height, width), distance)


_PART = 0.25  # the largest length of a bar, as a fraction of the picture's width
_SLANT = math.sin(math.radians(15))  # sides along which a unit direction has a smaller component are not named
_UNITS = ((1000.0, "m"), (1.0, "mm"), (1e-3, "µm"), (1e-6, "nm"))


@dataclass(frozen=True, slots=True)
class Bar:
    """A scale bar."""

    length: float  # in millimetres: 1, 2 or 5 times a power of ten
    pixels: float  # its length in the picture, at the distance of the camera's target

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
    """Return the largest number up to ``most`` that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(k * power for k in (1.0, 2.0, 5.0) if k == 1.0 or k * power <= most * (1 + 1e-9))


def sides_of(view: Projection, geometry: Geometry) -> tuple[str, str, str, str]:
    """Return the names of the directions to the left, to the right, up and down in a picture.

    Each is one or more of the patient's sides, R, L, A, P, S and I, the nearest first; or axes of the voxels with a
    sign, for a volume without a patient.
    """
    right, down = (geometry.direction @ (axis / np.linalg.norm(axis)) for axis in view.packed[3:])

    def named(direction: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
        nearest = sorted(range(3), key=lambda k: -abs(round(float(direction[k]), 6)))
        return "".join(geometry.sides[k][int(direction[k] < 0)] for k in nearest if abs(direction[k]) > _SLANT)

    return named(-right), named(right), named(-down), named(down)
