"""Meshes and contours in files: reading points and normals, and replacing them in a copy that keeps all other bytes.

Libraries lose what they do not support when they write these formats (test_what_libraries_lose): objects and groups
of OBJ, properties of PLY, colours of STL. So only the numbers that change are located here, and replaced.
Structure sets of DICOM are written by pydicom.
"""

from __future__ import annotations

import lzma
import re
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from importlib import import_module
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.errors import said, shown
from supple.media.files import PathLike, head_of, refusing, unreadable
from supple.media.volume import Volume
from supple.space.checks import LARGEST

KINDS = {".stl": "STL", ".obj": "OBJ", ".ply": "PLY", ".vtk": "VTK", ".vtp": "VTP", ".dcm": "RTSTRUCT"}
"""Kinds of files by their suffix."""
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Spans = Sequence[tuple[int, int]]
Edit = tuple[int, int, bytes]
"""An edit of bytes: start offset, end offset, and the replacement."""
Runs = tuple[npt.ArrayLike, npt.ArrayLike]
"""Polygons or polylines: the indices of their vertices, concatenated, and the number of vertices of each."""
NO_RUNS: Runs = ((), ())
TOKEN = re.compile(rb"\S+")
_SPACE = re.compile(rb"SPACE\s*=\s*(LPS|RAS)\b")


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of a mesh, by indices of vertices."""

    triangles: Ints  # shape (T, 3)
    lines: Ints  # shape (L, 2)
    colour: tuple[float, float, float] | None = None  # sRGB from 0 to 1, if the file says it


@dataclass(frozen=True, slots=True, eq=False)
class PointFile:
    """Points, and a function that writes others into a copy of their file.

    Parameters
    ----------
    points : float64 array, shape (N, 2) or (N, 3)
        x first, in the order of the file; of a mesh, its vertices.
    convention : str
        ``"LPS"`` or ``"RAS"``, in millimetres; or ``"index"``, in pixels, frames or voxels from 0: the default for a
        table; or, from a reader of meshes, empty if the file does not say it.
    rewritten : callable
        Returns the file with other points and normals, and, of a table, with notes, (column name, its numbers).
    faces : callable
        Returns the parts of a mesh, which are read on this call.
    normals : float64 array, shape (M, 3)
        Normals at vertices of a mesh, not of facets, in the convention of its points.
    normals_at : int array, shape (M,)
        The point of each normal.
    labels : tuple of str
        One for each point; may be empty.
    name : str
        The name for messages.
    kind : str
        ``"CSV"``, ``"fcsv"`` or ``"JSON"``; or, of a mesh, one of the `KINDS`.
    told : str
        The source of the convention: ``"said"`` (the file), ``"mm"`` or ``"names"`` (columns x, y and z, with that unit
        or without one), or ``""``.
    """

    points: Floats
    convention: str
    rewritten: Callable[..., bytes] = field(repr=False)
    faces: Callable[[], list[Part]] = field(default=list, repr=False)
    normals: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    normals_at: Ints = field(default_factory=lambda: np.zeros(0, np.intp))
    labels: tuple[str, ...] = ()
    name: str = ""
    kind: str = ""
    told: str = "said"

    def parts(self) -> list[Part]:
        """Return the triangles and lines of a mesh; SuppleError if it has none, or they are damaged."""
        with parsing(self.name), np.errstate(invalid="raise"):  # numbers that no integer holds
            made = self.faces()
        if not any(len(part.triangles) + len(part.lines) for part in made):
            raise unreadable(self.name, "it has no faces, lines or contours", "give a mesh")
        return made


class Numbers(NamedTuple):
    """Numbers in a file, as rows (N, K) of float64, the offset after them, and what replaces them by others."""

    values: Floats
    end: int
    edits: Callable[[Floats], list[Edit]]


def in_text(data: bytes, spans: Spans, width: int, start: int = 0) -> Numbers:
    """Return the numbers at spans of text, in rows of ``width``; ValueError for text that is not a number.

    Only those that have changed are replaced.
    """
    values = np.array([float(data[a:b]) for a, b in spans]).reshape(-1, width)

    def edits(new: Floats) -> list[Edit]:
        old, after = values.ravel(), new.ravel()
        return [(*spans[k], repr(float(after[k])).encode()) for k in np.flatnonzero(old != after).tolist()]

    return Numbers(values, spans[-1][1] if len(spans) else start, edits)


def in_rows(data: bytes, start: int, count: int, fields: Sequence[Any], columns: Sequence[str]) -> Numbers:
    """Return columns, all of one width, of ``count`` binary rows with these fields; ValueError if they end early."""
    rows = np.frombuffer(data, np.dtype(list(fields)), count, start)
    values, end = np.hstack([np.atleast_2d(rows[name].T).T for name in columns]), start + rows.nbytes

    def edits(new: Floats) -> list[Edit]:
        made = rows.copy()
        for name, part in zip(columns, np.split(new, len(columns), axis=1), strict=True):
            made[name] = part.reshape(made[name].shape)
        return [(start, end, made.tobytes())]

    return Numbers(values.astype(np.float64), end, edits)


def tokens(data: bytes, start: int, count: int) -> Spans:
    """Return the spans of the next ``count`` words in text; ValueError if there are fewer."""
    spans = [match.span() for match in islice(TOKEN.finditer(data, start), count)]
    if len(spans) < count:
        raise ValueError(f"{count} numbers are promised, and {len(spans)} are left")
    return spans


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Return data with some of its bytes replaced."""
    parts, last = [], 0
    for start, end, new in sorted(edits):
        parts += [data[last:start], new]
        last = end
    return b"".join([*parts, data[last:]])


def space_of(head: bytes) -> str:
    """Return the convention in a header, which 3D Slicer writes as ``SPACE=LPS``; empty if there is none."""
    found = _SPACE.search(head)
    return found[1].decode() if found else ""


def checked(path: PathLike, points: npt.ArrayLike) -> Floats:
    """Return vertices (N, 3) as float64; SuppleError if there are none, or one is not finite."""
    made = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(made):
        raise unreadable(path, "it holds no vertices", "give a mesh")
    wrong = np.flatnonzero(~(np.abs(made) <= LARGEST).all(axis=1))
    if len(wrong):
        found = f"vertex {wrong[0] + 1} is ({', '.join(f'{x:g}' for x in made[wrong[0]])})"
        raise unreadable(path, found, f"a coordinate is a number from {-LARGEST:g} to {LARGEST:g}")
    return made


def part_of(
    count: int,
    polygons: Runs = NO_RUNS,
    lines: Runs = NO_RUNS,
    strips: Runs = NO_RUNS,
    *,
    colour: tuple[float, float, float] | None = None,
) -> Part:
    """Return a part of a mesh of ``count`` vertices; ValueError if an index is out of range.

    Polygons are divided into triangles that share their first corner, which is exact for convex ones.
    """
    first, k, corners = _steps(count, polygons, 2)
    triangles = np.stack([corners[first], corners[first + k + 1], corners[first + k + 2]], axis=-1)
    first, k, corners = _steps(count, strips, 2)
    odd = k % 2  # every second triangle of a strip has the opposite orientation
    stripped = np.stack([corners[first + k], corners[first + k + 1 + odd], corners[first + k + 2 - odd]], axis=-1)
    first, k, corners = _steps(count, lines, 1)
    pairs = np.stack([corners[first + k], corners[first + k + 1]], axis=-1)
    return Part(np.concatenate([triangles, stripped]), pairs, colour)


def joined(runs: Sequence[Sequence[int]]) -> Runs:
    """Return `Runs` from a list of vertices for each polygon or polyline."""
    return [corner for run in runs for corner in run], [len(run) for run in runs]


def _steps(count: int, runs: Runs, less: int) -> tuple[Ints, Ints, Ints]:
    """Return, for each corner of a run but its last ``less``: the run's start, the step from it; and all corners."""
    corners, many = (np.asarray(each, np.intp).ravel() for each in runs)
    if (many < 0).any() or many.sum() != len(corners):
        raise ValueError("its faces or lines do not have as many corners as it says")
    if len(wrong := corners[(corners < 0) | (corners >= count)]):
        raise ValueError(f"a face or line has vertex {wrong[0] + 1} of {count}")
    each = np.maximum(many - less, 0)
    first = np.repeat(np.cumsum(many) - many, each)
    return first, np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each), corners


def parsing(path: PathLike) -> AbstractContextManager[None]:
    """Convert errors about damaged files to one sentence."""
    kinds = ValueError, ArithmeticError, LookupError, zlib.error, lzma.LZMAError
    return refusing(lambda error: unreadable(path, f"it is damaged or cut short ({said(error)})"), *kinds)


def read_mesh(path: PathLike, kind: str, series: Volume | None = None) -> PointFile:
    """Read a file of one of the `KINDS`; SuppleError if it cannot be read, is damaged, or is of another kind.

    With a DICOM ``series``, a structure set that is written refers to it.
    """
    parsed: Callable[..., PointFile] = import_module(f"supple.media.meshes.{kind.lower()}").parsed
    data = head_of(path, -1, "give a file of a mesh")
    with parsing(path):
        made = parsed(path, data, **({} if series is None else {"series": series}))
    said = made.convention
    return replace(
        made, convention=said or "index", labels=("",) * len(made.points), name=shown(path), kind=kind,
        told="said" if said else "mesh",
    )  # fmt: skip
