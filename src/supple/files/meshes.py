"""Meshes and contours from files in voxels of a volume, to be rendered with it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from supple.errors import OutsideWarning, SuppleError
from supple.files.landmarks import convention_of, warn_of_frame
from supple.media.files import PathLike, check_suffix
from supple.media.meshes import KINDS
from supple.media.points import read_points
from supple.media.volume import Volume
from supple.render.meshes import Surface
from supple.space.checks import choice

Colour = tuple[float, float, float]

COLOURS = (
    (0.31, 0.66, 0.87), (0.95, 0.76, 0.31), (0.42, 0.75, 0.41), (0.82, 0.42, 0.65), (0.94, 0.54, 0.29),
    (0.56, 0.49, 0.76),
)  # fmt: skip
"""sRGB colours for meshes without a colour, used in turn."""
_FARTHEST = 1e7  # voxels


@dataclass(frozen=True, slots=True)
class MeshFile:
    """A mesh or contours in a file, and their colour."""

    path: PathLike  # .stl, .obj, .ply, .vtk (PolyData), .vtp; or a structure set of DICOM, .dcm
    colour: Colour | None = (
        None  # sRGB from 0 to 1; by default, that of each region of a structure set, or of `COLOURS`
    )


def read_surfaces(given: Sequence[MeshFile], volume: Volume, convention: str | None = None) -> tuple[Surface, ...]:
    """Return the surfaces and contours of files, in voxels of a volume.

    ``convention`` is that of files without their own: ``"LPS"`` or ``"RAS"`` in millimetres, or ``"index"``.
    SuppleError if a file cannot be read, has neither faces nor lines, or cannot be placed in the volume; OutsideWarning
    if none of a file's points lies in it.
    """
    if convention is not None:
        choice("convention", convention, ("LPS", "RAS", "index"))
    made: list[Surface] = []
    for each in given:
        advice = f"give a mesh or contours: {', '.join(KINDS)}"
        check_suffix(each.path, os.path.splitext(each.path)[1], KINDS, "is of no mesh", advice, "read")
        read = read_points(each.path, mesh=True)
        warn_of_frame(each.path, volume)
        known = convention_of(read, convention if read.told == "mesh" else None, volume.geometry.convention)
        points = read.points if known == "index" else volume.geometry.from_world(read.points, known)
        parts = read.parts()
        if len(points) and np.abs(points).max() > _FARTHEST:
            text = f"{read.name} has a vertex {np.abs(points).max():.2g} voxels away: give a whole copy of it"
            raise SuppleError(text)
        if ((points < -0.5) | (points > np.array(volume.sizes) - 0.5)).any(axis=1).all():
            text = f"no point of {read.name} lies in {volume.name}"
            warnings.warn(f"{text}: see whether its coordinates are of that volume", OutsideWarning, stacklevel=4)
        for part in parts:
            colour = each.colour or part.colour or COLOURS[len(made) % len(COLOURS)]
            used = np.zeros(len(points), np.bool_)  # points of no face or line are invisible
            for corners in (part.triangles, part.lines):
                used[corners] = True
            order = np.cumsum(used) - 1
            if used.any():
                made.append(Surface(points[used], order[part.triangles], order[part.lines], colour))
    return tuple(made)
