"""Landmarks and meshes: points of a file, mapped with an image, a clip or a volume, or back."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from supple.deformation import Deformation
from supple.errors import (
    FoldWarning,
    OutsideWarning,
    SuppleError,
    ToleranceWarning,
    VolumeWarning,
    argument,
    shown,
    warn,
)
from supple.fields import folds_of
from supple.media.files import PathLike, check_output
from supple.media.meshes import PointFile
from supple.media.points import FLIP, check_target, read_points, write_points
from supple.media.volume import Volume
from supple.media.volume import read as read_volume
from supple.media.volume.dicom import frame_of_reference
from supple.space.checks import choice
from supple.space.geometry import Floats, Geometry, Grid
from supple.strokes import CoordinateSpace, Stroke

_Way = Callable[[Floats], Floats]
_ROUNDED = 2.0**-50  # the relative rounding error of a coordinate from millimetres to voxels and back


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """The result of mapping the points of a file.

    Lengths are in millimetres if there is a geometry; otherwise in the units of the deformation's spacing, which are
    pixels and frames if it is 1.

    Parameters
    ----------
    source, target : pathlib.Path
        The input and the output file.
    count : int
        The number of points.
    displaced : float64 array, shape (N,)
        The displacement of each point.
    error : float64 array, shape (N,)
        A bound on the distance of each point from its true position, as in `Certified`; inf without a solution.
    outside : int
        The number of points of the source beyond the outer faces of the voxels. They are mapped too, as T is also
        defined there.
    first_outside : str
        The first of these in the file: its label, or its number from 1, and its coordinates.
    unconverged : int
        The number of points for which no solution was found.
    """

    source: Path
    target: Path
    count: int
    displaced: Floats
    error: Floats
    outside: int
    first_outside: str
    unconverged: int


def move_points(
    source: PathLike,
    target: PathLike,
    deformation: Deformation,
    geometry: Geometry | None = None,
    *,
    reference: Grid | None = None,
    inverse: bool = False,
    convention: str | None = None,
    refer_to: PathLike | None = None,
    force: bool = False,
) -> Moved:
    """Map the points of a file by a deformation.

    Parameters
    ----------
    source, target : str or os.PathLike
        Both of one kind: .csv, .tsv, .txt; .fcsv; .mrk.json; or a mesh: .stl, .obj, .ply, .vtk (PolyData), .vtp; or
        contours, a structure set .dcm. Everything but the coordinates is kept; a table gets a column ``error_mm``, or
        ``error_px`` without a geometry; normals of a mesh are transformed with its surface.
    deformation : Deformation
        A deformation of an image, for which only x and y are mapped, of a clip, or of a volume.
    geometry : Geometry, optional
        The geometry of the volume; not for images and clips. If it is sheared, the deformation is on the upright grid
        around it, as from `supple.files.volumes.deformation_of`.
    reference : Grid, optional
        The grid of the output, whose indices are used for points of the output; by default, that of the input.
    inverse : bool
        False maps by T, from the input to the output; True maps by T⁻¹, from the output to the input.
    convention : str, optional
        The coordinates of a table without a convention of its own: ``"LPS"`` or ``"RAS"``, in millimetres, or
        ``"index"``, in pixels, frames or voxels from 0. It must agree with that of the file, if there is one. By
        default, indices. It is required if ``geometry`` has a position in space, for a table without a header, and for
        a mesh without a convention (3D Slicer's have one).
    refer_to : str or os.PathLike, optional
        For a structure set: the DICOM series that the result refers to, such as the bent one; by default, none.
    force : bool
        Whether to replace an existing file.

    Returns
    -------
    Moved

    Raises
    ------
    SuppleError
        If a file cannot be read or written, its coordinates do not fit the deformation, or they are in millimetres
        without a geometry.
    """
    check_target(target, source)
    if geometry is not None and deformation.ndim != 3:
        raise SuppleError(f"a geometry is of a volume, and shape {deformation.shape} has two axes")
    check_output(target, force=force)
    series = None if refer_to is None else _series(refer_to, source)
    read = read_points(source, mesh=True, series=series)
    known = convention_of(read, convention, None if geometry is None else geometry.convention)
    if read.points.shape[1] < deformation.ndim:
        text = f"cannot move {read.name}: it has x and y, and shape {deformation.shape} needs a third column"
        raise SuppleError(text)
    given = read.points[:, : deformation.ndim]
    within, told = _ways(deformation, geometry, known)
    counted = reference is not None and known == "index"  # indices refer to the output's own grid on one side
    own, seen = deformation.grid, reference or deformation.output
    start = own.indices(seen.positions(given)) if counted and inverse else within(given)
    mapped = deformation.certified(start, inverse=inverse)
    end = mapped.points
    made = read.points.copy()
    # displacements are added to the original points, so that unchanged ones keep every bit
    if counted:
        made[:, : deformation.ndim] = told(end) if inverse else seen.indices(own.positions(end))
    else:
        made[:, : deformation.ndim] = end if start is given else given + (told(end) - told(start))
    steps = np.array(deformation.domain.spacing if geometry is None or geometry.shear else geometry.spacing)
    where = seen.indices(own.positions(start)) if inverse and reference is not None else start
    last = np.array(seen.sizes if inverse else own.sizes) - 0.5
    beyond = np.flatnonzero(((where < -0.5) | (where > last)).any(axis=1))
    first, lost = "", int(np.count_nonzero(~mapped.converged))
    if len(beyond):
        k = int(beyond[0])
        first = f"{shown(read.labels[k]) if read.labels[k] else f'point {k + 1}'} at {_listed(read.points[k])}"
        text = f"{len(beyond)} of {len(made)} points {'lies' if len(beyond) == 1 else 'lie'} outside"
        which = f" ({first}{', for one' if len(beyond) > 1 else ''})"
        warn(f"{text}{which}: they are moved all the same", OutsideWarning)
    solved = (replace(each, inverse=True) for each in deformation.maps if each.inverse == inverse)
    if folds := folds_of(solved):
        text = f"{folds}: where they lead to, a point is one of several, and its error is the distance to that one"
        warn(text, FoldWarning)
    if lost:
        text = f"{lost} of {len(made)} points did not converge: their error is inf"
        warn(text, ToleranceWarning)
    axes = told(np.eye(3)) - told(np.zeros(3))
    normals = _turned(read, deformation, end if inverse else start, axes.T, inverse)
    moves = (made != read.points).any(axis=1)
    errors = mapped.error + np.where(moves, _ROUNDED * np.abs(made).max(axis=1, initial=0.0), 0.0)
    unit = "px" if geometry is None else "mm"
    write_points(target, made, read, notes=(f"error_{unit}", errors), normals=normals, force=force)
    moved_by = np.asarray(np.linalg.norm((end - start) * steps, axis=1))
    return Moved(Path(source), Path(target), len(made), moved_by, errors, len(beyond), first, lost)


def _ways(deformation: Deformation, geometry: Geometry | None, known: str) -> tuple[_Way, _Way]:
    """Return the functions from the points of a file to indices on a deformation's grid, and back."""
    if geometry is None or (known == "index" and not geometry.shear):
        return (lambda p: p), (lambda p: p)
    place = deformation.grid.geometry(geometry.convention) if geometry.shear else geometry
    if known != "index":
        return (lambda p: place.from_world(p, known)), (lambda p: place.to_world(p, known))
    return (lambda p: place.from_lps(geometry.to_lps(p))), (lambda p: geometry.from_lps(place.to_lps(p)))


def _series(path: PathLike, source: PathLike) -> Volume:
    """Return the DICOM series to which contours will refer."""
    if Path(source).suffix.lower() != ".dcm":
        raise SuppleError(f"{argument('refer_to')} is for structure sets of DICOM, and {shown(source)} is none")
    found = read_volume(path)
    if found.format != "DICOM":
        text = f"{argument('refer_to')} must be a series of DICOM, and {found.name} is {found.format}: give its folder"
        raise SuppleError(text)
    warn_of_frame(source, found)
    return found


def warn_of_frame(source: PathLike, volume: Volume) -> None:
    """Warn if DICOM contours have another frame of reference than a series, and so another origin of coordinates."""
    if Path(source).suffix.lower() != ".dcm" or volume.format != "DICOM" or not volume.header:
        return
    slices = volume.header if isinstance(volume.header, tuple) else (volume.header,)
    one, other = frame_of_reference(os.fspath(source)), frame_of_reference(os.fspath(slices[0]))
    if one and other and one != other:
        told = f"{shown(source)} is of another frame of reference ({one}) than {volume.name} ({other})"
        warn(f"{told}: its points may not lie where they seem to", VolumeWarning)


def _turned(read: PointFile, deformation: Deformation, points: Floats, axes: Floats, inverse: bool) -> Floats:
    """Return the normals of a mesh mapped by T, or T⁻¹: by the inverse transpose of the Jacobian; lengths are kept.

    ``points`` are those of the mesh on the input side of T, in indices; the columns of ``axes`` are the steps of one
    index in the coordinates of the mesh.
    """
    normals = read.normals
    if not len(normals) or deformation.is_identity:
        return normals
    matrices = deformation.jacobian(points[read.normals_at])
    n = deformation.ndim
    moved = np.flatnonzero((matrices != np.eye(n)).any(axis=(1, 2)))  # the others keep every bit
    full = np.tile(np.eye(3), (len(moved), 1, 1))
    full[:, :n, :n] = matrices[moved]
    turn: Floats = axes @ full @ np.linalg.inv(axes) if inverse else axes @ np.linalg.inv(full) @ np.linalg.inv(axes)
    made = np.einsum("kji,kj->ki", turn, normals[moved])
    length, before = (np.linalg.norm(v, axis=1, keepdims=True) for v in (made, normals[moved]))
    turned = normals.copy()
    turned[moved] = made * before / np.where(length > 0, length, 1)
    return turned


def read_landmarks(
    path: PathLike, geometry: Geometry, *, convention: str | None = None
) -> tuple[tuple[str, ...], Floats]:
    """Return the names of a file's points, or their numbers from 1, and their indices in a volume, (N, 3).

    ``convention`` is as in `move_points`. SuppleError if the file cannot be read, or its coordinates do not fit the
    volume.
    """
    read = read_points(path)
    known = convention_of(read, convention, geometry.convention)
    if read.points.shape[1] != 3:
        raise SuppleError(f"the points of {read.name} are of two numbers, and those of a volume have three")
    names = tuple(label or str(k) for k, label in enumerate(read.labels, 1))
    return names, read.points if known == "index" else geometry.from_world(read.points, known)


def read_pull(
    source: PathLike,
    target: PathLike,
    *,
    convention: str | None = None,
    place: str | None = None,
    world: bool = False,
    **brush: Any,
) -> tuple[Stroke, CoordinateSpace | None]:
    """Return a stroke that pulls the points of a file to those of another, and its space if it is in millimetres.

    If all points of both files have different labels, they are matched by these; otherwise in order. A point that is
    equal in both is a pin. If one file is in LPS and the other in RAS, the stroke is in the space of the first.
    ``convention`` applies to files without their own; ``place`` is the convention of the volume's `Geometry`, None for
    images and clips. With ``world``, all strokes are in millimetres: a table without a convention is an error.
    ``brush`` are options of `supple.Stroke.pull`.
    """
    start, end = read_points(source), read_points(target)
    if start.points.shape[1] != end.points.shape[1]:
        found = " and ".join(str(x.points.shape[1]) for x in (start, end))
        raise SuppleError(f"points of {start.name} and {end.name} must have as many numbers, found {found}")
    said = "index" not in (start.convention, end.convention)  # both are in millimetres: `convention` must agree
    space, other = (
        _space(read, convention if said or read.convention == "index" else None, place, world) for read in (start, end)
    )
    places = end.points
    if space != other:
        if "index" in (space, other):
            millimetres, voxels = (start, end) if other == "index" else (end, start)
            raise SuppleError(f"{millimetres.name} is in millimetres, and {voxels.name} in voxels: give both in one")
        places = places * FLIP
    order = list(range(len(end.points)))
    if all(all(x.labels) and len(set(x.labels)) == len(x.labels) for x in (start, end)) and start.labels:
        missing = [label for label in start.labels if label not in end.labels]
        missing += [label for label in end.labels if label not in start.labels]
        if missing:
            raise SuppleError(f"{start.name} and {end.name} do not both have the point {shown(missing[0])}")
        order = [end.labels.index(label) for label in start.labels]
    unit = "" if space == "index" else f" mm in {space}"
    known: dict[tuple[float, ...], int] = {}
    for k, at in enumerate(map(tuple, start.points.tolist())):
        if (first := known.setdefault(at, k)) != k:
            one, two = (shown(start.labels[i]) if start.labels[i] else f"point {i + 1}" for i in (first, k))
            raise SuppleError(f"{start.name} has two points at {_listed(at)}{unit}, {one} and {two}: leave one out")
    if len(start.points) != len(end.points):
        raise SuppleError(
            f"{start.name} has {len(start.points)} points, and {end.name} has {len(end.points)}: give as many in both"
        )
    stroke = Stroke.pull(start.points, to=places[order], **brush)
    stroke = replace(stroke, name=f"{start.name}:{end.name}")
    return stroke, None if space == "index" else space  # type: ignore[return-value]


def _space(read: PointFile, asked: str | None, place: str | None, world: bool) -> str:
    """Return the convention of a file of points for a pull."""
    if read.points.shape[1] == 2:  # points of a picture, or for all planes alike
        return convention_of(read, asked, None)
    if world and asked is None and read.told in ("", "names"):
        read = replace(read, told="world")
    space = convention_of(read, asked, place)
    if world and space == "index":
        text = f"{read.name} is in voxels, and {argument('world')} is for points in millimetres: leave it out"
        raise SuppleError(text)
    return space


def _listed(point: Iterable[float]) -> str:
    return f"({', '.join(f'{x:g}' for x in point)})"


def convention_of(read: PointFile, asked: str | None, place: str | None) -> str:
    """Return the convention of a file's points; ``place`` is that of the volume's geometry, None without a volume."""
    if asked is not None:
        choice("convention", asked, ("LPS", "RAS", "index"))
    known, refused = asked or read.convention, f"cannot place {read.name}: it"
    if asked not in (None, read.convention) and read.convention != "index":
        raise SuppleError(f"{refused} says that it is in {read.convention}, and {asked} was asked for: leave that out")
    if asked is None and place not in (None, "array"):
        if read.told == "names":
            text = f"x, y and z of {read.name} are taken for voxels, counted from 0"
            warn(f"{text}: {argument('convention')} LPS or RAS takes them for millimetres", VolumeWarning)
        elif read.told != "said":
            advice = "LPS or RAS (millimetres), or index (voxels from 0), or name columns l,p,s, r,a,s or i,j,k"
            raise SuppleError(f"{refused} does not say what its numbers are: give {argument('convention')} {advice}")
    if known != "index" and place in (None, "array"):
        what = "only volumes have a place in space: give pixels in a table with x and y"
        if place is not None:
            what = "the volume does not know where it lies in space: give indices in a table with x, y and z"
        raise SuppleError(f"{refused} is in {known}, and {what}")
    return known
