"""Meshes and contours that are drawn with a volume: moved by its deformation, and rasterized for its rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.deformation import Deformation
from supple.gpu import raymarch as shading
from supple.render.camera import Projection
from supple.render.picture import colour_of, linear_light
from supple.space.checks import refuse, rows
from supple.space.geometry import Floats, Geometry

Ints = npt.NDArray[np.int32]

WIDTH = 2.0
"""The width of lines, in pixels."""


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Surface:
    """A mesh or contours in a volume: opaque, and of one colour.

    Triangles are lit as surfaces of the volume are, on both sides, with normals that are interpolated between their
    corners, except at sharp edges, where a corner's normal is more than 40° off the triangle's. Lines are two pixels
    wide, and not lit.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        Voxels of the volume before its deformation, x first, from 0.
    triangles : array_like of int, shape (T, 3)
        The points of each triangle.
    lines : array_like of int, shape (L, 2)
    colour : (float, float, float)
        sRGB from 0 to 1.

    Raises
    ------
    SuppleError
        If an argument does not fit.
    """

    points: Floats
    triangles: Ints
    lines: Ints
    colour: tuple[float, float, float]

    def __init__(
        self,
        points: npt.ArrayLike,
        triangles: npt.ArrayLike = (),
        lines: npt.ArrayLike = (),
        colour: tuple[float, ...] = (0.8, 0.8, 0.8),
    ) -> None:
        points = np.ascontiguousarray(rows("points", points, 3))
        object.__setattr__(self, "points", points)
        for name, joined, corners in (("triangles", triangles, 3), ("lines", lines, 2)):
            given = np.asarray(joined)
            if given.shape == (0,):
                given = np.zeros((0, corners), np.int32)
            if given.ndim != 2 or given.shape[1] != corners or given.dtype.kind not in "iu":
                wanted = f"indices of points, of shape (N, {corners})"
                refuse(name, wanted, told=f"{given.dtype} of shape {given.shape}")
            if given.size and not 0 <= given.min() <= given.max() < len(points):
                found = f"{given.min()} to {given.max()}"
                refuse(name, f"indices of points from 0 to {len(points) - 1}", told=found)
            object.__setattr__(self, name, np.ascontiguousarray(given, np.int32))
        object.__setattr__(self, "colour", colour_of("colour", colour))


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A surface in the deformed volume."""

    surface: Surface
    points: Floats  # (N, 3): in millimetres along the axes of the volume
    # (N, 3): unit normals, or 0: the mean of the triangles' around a point, weighted by their angles there, so that
    # it does not depend on how a plane is triangulated
    normals: npt.NDArray[np.float32]


def place(surface: Surface, deformation: Deformation | None, geometry: Geometry) -> Placed:
    """Return a surface, moved by T."""
    moved = surface.points if deformation is None else deformation.forward(surface.points)
    points = np.ascontiguousarray(moved * geometry.spacing)
    corners = points[surface.triangles]
    sides = [_unit(corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)]
    own = _unit(np.cross(sides[0], sides[1]))
    normals = np.zeros_like(points)
    for k in range(3):
        angles = np.arccos(np.clip(-np.einsum("ij,ij->i", sides[k], sides[k - 1]), -1, 1))
        for axis in range(3):
            normals[:, axis] += np.bincount(surface.triangles[:, k], own[:, axis] * angles, minlength=len(points))
    return Placed(surface, points, np.asarray(_unit(normals), np.float32))


def _unit(vectors: Floats) -> Floats:
    """Return vectors (N, 3) of unit length; 0 for those without a length."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))


def nearest(meshes: tuple[Placed, ...], look: shading.Look, view: Projection, fine: int) -> npt.NDArray[np.float32]:
    """Return the nearest mesh along each ray, ``fine`` rays along a pixel's side: (H * fine, W * fine, 4).

    It is linear red, green and blue, and the distance from the eye in millimetres: infinity where there is no mesh.
    """
    rows, columns = ((np.arange(n * fine) + 0.5) / fine - 0.5 * n for n in view.size)
    seen = look.core
    ends = np.zeros((len(rows), len(columns), 4), np.float32)
    ends[..., 3] = np.inf
    for mesh in meshes:
        red, green, blue = linear_light(mesh.surface.colour)
        colour = float(red), float(green), float(blue)
        joined = mesh.surface.triangles, mesh.surface.lines
        _core.raster(seen, mesh.points, mesh.normals, *joined, colour, WIDTH / 2, columns, rows, ends)
    return ends
