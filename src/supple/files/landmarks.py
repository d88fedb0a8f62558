"""Landmarks: points of a file, mapped with an image, a clip or a volume, or back."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.domain import choice
from supple.errors import OutsideWarning, SuppleError, ToleranceWarning, VolumeWarning, shown
from supple.geometry import Geometry
from supple.media.files import check_output
from supple.media.points import PointFile, check_target, read_points, write_points
from supple.strokes import REACH, CoordinateSpace, Stroke

Floats = npt.NDArray[np.float64]
PathLike = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """The result of mapping points from a file to another.

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
    residual : float64 array, shape (N,)
        |T(p) - q| of each point q in the output and the solution p of T(p) = q: for points mapped back, their accuracy;
        for points mapped forward, the accuracy of mapping them back.
    outside : int
        The number of points of the source beyond the outer faces of the voxels. They are mapped too, as T is defined
        there.
    first_outside : str
        The first of these in the file: its label, or its number from 1, and its coordinates.
    unconverged : int
        The number of points for which that equation was not solved to 1e-6 voxels.
    """

    source: Path
    target: Path
    count: int
    displaced: Floats
    residual: Floats
    outside: int
    first_outside: str
    unconverged: int


def move_points(
    source: PathLike,
    target: PathLike,
    deformation: Deformation,
    geometry: Geometry | None = None,
    *,
    inverse: bool = False,
    convention: str | None = None,
    force: bool = False,
) -> Moved:
    """Map the points of a file by a deformation.

    Parameters
    ----------
    source, target : str or os.PathLike
        Of one kind: .csv, .tsv, .txt; .fcsv; or .mrk.json. All but the coordinates is kept; a table also gets a column
        ``residual``, in the units of `Moved`.
    deformation : Deformation
        A deformation of an image, for which only x and y are mapped, of a clip, or of a volume.
    geometry : Geometry, optional
        The geometry of the volume; not for images and clips.
    inverse : bool
        If False, by T, from the input to the output. If True, by T⁻¹, from the output back.
    convention : str, optional
        The coordinates of a table without a convention of its own: ``"LPS"`` or ``"RAS"``, in millimetres, or
        ``"index"``, in pixels, frames or voxels from 0. It must agree with that of the file, if there is one. By
        default, indices; required for a table without a header if ``geometry`` has a position in space.
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
    if convention is not None:
        choice("convention", convention, ("LPS", "RAS", "index"))
    if geometry is not None and deformation.ndim != 3:
        raise SuppleError(f"a geometry is of a volume, and shape {deformation.shape} has two axes")
    check_output(target, force=force)
    read = read_points(source)
    known = _convention(read, convention, geometry)
    if read.points.shape[1] < deformation.ndim:
        raise SuppleError(
            f"cannot move {read.name}: it has x and y, and shape {deformation.shape} needs a third column"
        )
    given = read.points[:, : deformation.ndim]
    start = given if geometry is None or known == "index" else geometry.from_world(given, known)
    if inverse:
        solved = deformation.inverse(start)
        end, seen = solved.points, start
    else:
        end = seen = start if deformation.is_identity else deformation.forward(start)  # avoids rounding
        solved = deformation.inverse(seen)
    made = read.points.copy()
    if geometry is None or known == "index":
        made[:, : deformation.ndim] = end
    else:  # added to the original, so that unchanged points keep every bit
        made += geometry.to_world(end, known) - geometry.to_world(start, known)
    steps = np.array(deformation.domain.spacing if geometry is None else geometry.spacing)
    residual = np.linalg.norm((deformation.forward(solved.points) - seen) * steps, axis=1)
    last = np.array(deformation.shape[::-1]) - 0.5
    beyond = np.flatnonzero(((start < -0.5) | (start > last)).any(axis=1))
    first, lost = _spoken(read, int(beyond[0])) if len(beyond) else "", int(np.count_nonzero(~solved.converged))
    if len(beyond):
        text = f"{len(beyond)} of {len(made)} points {'lies' if len(beyond) == 1 else 'lie'} outside"
        which = f" ({first}{', for one' if len(beyond) > 1 else ''})"
        warnings.warn(f"{text}{which}: they are moved all the same", OutsideWarning, stacklevel=2)
    if lost:
        text = f"{lost} of {len(made)} points did not converge: see their residuals"
        warnings.warn(text, ToleranceWarning, stacklevel=2)
    write_points(target, made, read, residual=residual, force=force)
    moved_by = np.asarray(np.linalg.norm((end - start) * steps, axis=1))
    return Moved(Path(source), Path(target), len(made), moved_by, np.asarray(residual), len(beyond), first, lost)


def read_landmarks(
    path: PathLike, geometry: Geometry, *, convention: str | None = None
) -> tuple[tuple[str, ...], Floats]:
    """Return the names of the points of a file, or their numbers from 1, and their voxels in a volume, (N, 3).

    Parameters
    ----------
    path : str or os.PathLike
        As `move_points` reads it.
    geometry : Geometry
        The geometry of the volume.
    convention : str, optional
        As in `move_points`.

    Raises
    ------
    SuppleError
        If the file cannot be read, or its coordinates do not fit the volume.
    """
    if convention is not None:
        choice("convention", convention, ("LPS", "RAS", "index"))
    read = read_points(path)
    known = _convention(read, convention, geometry)
    if read.points.shape[1] != 3:
        raise SuppleError(f"the points of {read.name} are of two numbers, and those of a volume have three")
    names = tuple(label or str(k) for k, label in enumerate(read.labels, 1))
    return names, read.points if known == "index" else geometry.from_world(read.points, known)


def read_pull(
    source: PathLike, target: PathLike, *, radius: float, poisson: float | None = None, reach: float | None = REACH
) -> tuple[Stroke, CoordinateSpace | None]:
    """Return the stroke that pulls the points of a file to those of another, and their space if it is of millimetres.

    Parameters
    ----------
    source, target : str or os.PathLike
        As `move_points` reads them. If all points of both have different labels, they are matched by these; otherwise
        in order.
    radius, poisson, reach
        As in `supple.Deformation.pull`. A point that is the same in both files is a pin.

    Raises
    ------
    SuppleError
        If a file cannot be read, or the two do not fit each other.
    """
    start, end = read_points(source), read_points(target)
    if start.convention != end.convention:
        raise SuppleError(f"{start.name} is in {start.convention}, and {end.name} in {end.convention}")
    if start.points.shape[1] != end.points.shape[1]:
        found = " and ".join(str(x.points.shape[1]) for x in (start, end))
        raise SuppleError(f"points of {start.name} and {end.name} must have as many numbers, found {found}")
    order = list(range(len(end.points)))
    if all(all(x.labels) and len(set(x.labels)) == len(x.labels) for x in (start, end)) and start.labels:
        missing = [label for label in start.labels if label not in end.labels]
        missing += [label for label in end.labels if label not in start.labels]
        if missing:
            raise SuppleError(f"{start.name} and {end.name} do not both have the point {shown(missing[0])}")
        order = [end.labels.index(label) for label in start.labels]
    if len(start.points) != len(end.points):
        raise SuppleError(
            f"{start.name} has {len(start.points)} points, and {end.name} has {len(end.points)}: give as many in both"
        )
    stroke = Stroke.pull(start.points, to=end.points[order], radius=radius, poisson=poisson, reach=reach)
    return stroke, None if start.convention == "index" else start.convention  # type: ignore[return-value]


def _spoken(read: PointFile, k: int) -> str:
    name = shown(read.labels[k]) if read.labels[k] else f"point {k + 1}"
    return f"{name} at ({', '.join(f'{x:g}' for x in read.points[k])})"


def _check_told(read: PointFile) -> None:
    """Raise an error, or warn, if numbers may be voxels or positions in space."""
    if read.told == "names":
        warnings.warn(
            f"x, y and z of {read.name} are taken for voxels, counted from 0: --convention LPS or RAS takes them for "
            "millimetres",
            VolumeWarning,
            stacklevel=5,
        )
    elif read.told != "said":
        found = (
            "its columns are in mm, but not said to be LPS or RAS"
            if read.told
            else "no header says what its numbers are"
        )
        choices = "LPS or RAS" if read.told else "index (voxels from 0), LPS or RAS (millimetres)"
        names = "l,p,s or r,a,s" if read.told else "i,j,k, l,p,s or r,a,s"
        raise SuppleError(
            f"cannot place {read.name}: {found}: give --convention {choices}, or name its columns {names}"
        )


def _convention(read: PointFile, asked: str | None, geometry: Geometry | None) -> str:
    if asked not in (None, read.convention) and read.convention != "index":
        raise SuppleError(
            f"cannot place {read.name}: it says that it is in {read.convention}, and {asked} was asked for: "
            "leave that out"
        )
    known = asked or read.convention
    if asked is None and geometry is not None and geometry.convention != "array":
        _check_told(read)
    if known != "index" and geometry is None:
        raise SuppleError(
            f"cannot place {read.name}: it is in {known}, and only volumes have a place in space: "
            "give pixels in a table with x and y"
        )
    if known != "index" and geometry is not None and geometry.convention == "array":
        raise SuppleError(
            f"cannot place {read.name}: it is in {known}, and the volume does not know where it lies in space: "
            "give indices in a table with x, y and z"
        )
    return known
