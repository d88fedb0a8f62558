"""Files of points: tables (CSV), 3D Slicer's ``.fcsv`` and ``.mrk.json``, and meshes."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, said, shown
from supple.media import meshes
from supple.media.files import PathLike, check_suffix, head_of, refusing, replacing, unreadable
from supple.media.meshes import PointFile
from supple.media.tables import parsed
from supple.media.volume import Volume
from supple.space.checks import LARGEST, value_shown
from supple.space.geometry import Floats

KINDS = {".csv": "CSV", ".tsv": "CSV", ".txt": "CSV", ".fcsv": "fcsv", ".json": "JSON"}
_FORMATS = {**KINDS, **meshes.KINDS}
_GIVE = "give a .csv, .tsv, .txt, .fcsv or .mrk.json file"
_MESHES = f"{_GIVE}, or a mesh: {', '.join(meshes.KINDS)}"
FLIP = np.array([-1.0, -1.0, 1.0])
"""Signs that convert positions between LPS and RAS."""


# Entries of a plane that Slicer derives from its control points; and its size, derived if it is automatic.
_OF_PLANES = ("center", "origin", "normal", "orientation", "baseToNode", "baseToNodeMatrix")
_SIZES = ("size", "planeBounds")


def check_target(path: PathLike, source: PathLike) -> None:
    """Raise SuppleError if ``path`` is of another kind of file than ``source``."""
    kind = _kind("read", source)
    if _kind("write", path) != kind:
        suffixes = " or ".join(suffix for suffix, known in _FORMATS.items() if known == kind)
        raise SuppleError(f"cannot write {shown(path)}: {shown(source)} is of another kind: give a name in {suffixes}")


def read_points(path: PathLike, *, mesh: bool = False, series: Volume | None = None) -> PointFile:
    """Read a file of points: a table, ``.fcsv`` or ``.mrk.json``; with ``mesh``, also a mesh or contours.

    A table (.csv, .tsv, .txt) is separated by commas, semicolons or tabs. A header, which may be a comment, names its
    columns: x, y, and z, t or frame if there is one; or r, a, s or l, p, s for positions in millimetres, or i, j, k.
    Without a header, the first three columns of numbers are the coordinates, or the only two. Comments begin with #.

    The points of a .mrk.json are the placed control points of all markups, in the convention of the first.
    ``series`` is the volume to which a DICOM structure set refers when its points are written. SuppleError, with the
    line, for a file that is damaged or holds no points.
    """
    name, kind = shown(path), _kind("read", path, mesh=mesh)
    if kind in meshes.KINDS.values():
        return meshes.read_mesh(path, kind, series)
    text = text_of(path)
    if kind == "JSON":
        return _from_json(name, text)
    table, points, convention, labels, told = parsed(name, text, fcsv=kind == "fcsv")

    def rewritten(new: Floats, _: Floats, notes: tuple[str, Floats] | None = None) -> bytes:
        column = None if notes is None else (notes[0], [f"{x:.3g}" for x in notes[1].tolist()])
        return table.written(new, points, column).encode("utf-8", "surrogateescape")

    return PointFile(points, convention, rewritten, labels=labels, name=name, kind=kind, told=told)


def write_points(
    path: PathLike,
    points: npt.ArrayLike,
    like: PointFile,
    *,
    notes: tuple[str, Floats] | None = None,
    normals: Floats | None = None,
    force: bool = False,
) -> None:
    """Write points into a copy of the file that they came from; it appears whole or not at all.

    All other contents are kept, and so is the text of unchanged coordinates. For a markup that moves, Slicer's
    measurements (lengths, angles) and entries that it derives from the points of a plane are removed. A region (ROI),
    and a plane of a point and a normal, must not move: SuppleError.

    The suffix, and the shape and convention of the points, are those of ``like``. ``notes``, a name and a number for
    each point, become the last column of a CSV, or the one of that name; ``normals`` are those of a mesh, by default
    those of ``like``.
    """
    check_target(path, f"x{next(suffix for suffix, kind in _FORMATS.items() if kind == like.kind)}")
    made = np.asarray(points, np.float64)
    if made.shape != like.points.shape or not np.isfinite(made).all():
        wanted = f"an array of finite numbers of shape {like.points.shape}"
        raise SuppleError(f"cannot write {shown(path)}: points must be {wanted}, as in {like.name}")
    more = () if notes is None or like.kind != "CSV" else (notes,)
    data = like.rewritten(made, like.normals if normals is None else normals, *more)
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(data)


def _kind(verb: str, path: PathLike, *, mesh: bool = True) -> str:
    suffix, known = Path(path).suffix, _FORMATS if mesh else KINDS
    check_suffix(path, suffix, known, "is of no file of points", _MESHES if mesh else _GIVE, verb)
    return known[suffix.lower()]


def text_of(path: PathLike) -> str:
    """Return the text of a file; SuppleError if it is empty or none."""
    data = head_of(path, -1, _GIVE, _GIVE)
    if not data.strip():
        raise unreadable(path, "it is empty", _GIVE)
    if b"\0" in data:
        raise unreadable(path, "it is no text in UTF-8", "save it as that")
    return data.decode("utf-8", "surrogateescape")  # keeps labels in other encodings


def _from_json(name: str, text: str) -> PointFile:
    where = ""

    def refused(error: Exception) -> SuppleError:
        what = f"{where}it is damaged, or no list of markups ({said(error)})"
        return unreadable(name, what, "save it from Slicer as .mrk.json")

    places: list[tuple[int, int, bool]] = []  # (markup, control point, whether x and y are flipped)
    points: list[Floats] = []
    labels, first = [], ""
    with refusing(refused, ArithmeticError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        data = json.loads(text.removeprefix("\ufeff"))
        for m, markup in enumerate(data["markups"]):
            where = f"markup {m + 1}: "
            convention, unit = markup.get("coordinateSystem", "LPS"), markup.get("coordinateUnits", "mm")
            if convention not in ("LPS", "RAS") or "mm" not in (unit, *unit[:1]):
                raise ValueError(f"coordinates in {value_shown(convention)}, {value_shown(unit)}, not LPS or RAS in mm")
            for k, control in enumerate(markup["controlPoints"]):
                if control.get("positionStatus", "defined") == "defined":
                    point, first = _numbers(control["position"]), first or convention
                    flipped = convention != first
                    places.append((m, k, flipped))
                    points.append(point * FLIP if flipped else point)
                    labels.append(str(control.get("label") or ""))
    if not points:
        raise unreadable(name, "it holds no points that are placed", "place some")
    before = np.array(points)

    def rewritten(new: Floats, _: Floats) -> bytes:
        return _to_json(data, text, places, new, before, name).encode("utf-8", "surrogateescape")

    return PointFile(before, first, rewritten, labels=tuple(labels), name=name, kind="JSON")


def _numbers(value: object) -> Floats:
    given = np.array(value)  # text and booleans are not coordinates
    made = given.astype(np.float64) if given.dtype.kind in "iuf" else np.empty(0)
    if made.shape != (3,) or not (np.abs(made) <= LARGEST).all():
        raise ValueError(f"{value_shown(value)} is not three numbers from {-LARGEST:g} to {LARGEST:g}")
    return made


def _drop_measured(markup: dict[str, Any], m: int, name: str) -> None:
    """Remove entries that Slicer computes from moved control points; SuppleError if the markup has other geometry."""
    for measured in markup.get("measurements") or ():
        for key in ("value", "controlPointValues") if isinstance(measured, dict) else ():
            measured.pop(key, None)
    told = "a region (ROI): mark its corners by points" if markup.get("type") == "ROI" and "size" in markup else ""
    if markup.get("type") == "Plane":
        if len(markup["controlPoints"]) < 3 or markup.get("planeType") == "pointNormal":
            told = "a Plane of a point and a normal: make it one of three points"
        for key in (*_OF_PLANES, *(_SIZES if markup.get("sizeMode", "auto") == "auto" else ())):
            markup.pop(key, None)
    if told:
        raise SuppleError(f"cannot move {name}: markup {m + 1} is {told} in 3D Slicer, or leave it out")


def _to_json(
    data: Any, text: str, places: Sequence[tuple[int, int, bool]], points: Floats, before: Floats, name: str
) -> str:
    data = copy.deepcopy(data)
    for (m, k, flipped), new, old in zip(places, points, before, strict=True):
        signs, markup = FLIP if flipped else np.ones(3), data["markups"][m]
        for i in np.flatnonzero(new != old):
            markup["controlPoints"][k]["position"][i] = float(new[i] * signs[i])
        if (new != old).any():
            _drop_measured(markup, m, name)
    step = re.match(r"\ufeff?\s*\{\r?\n([ \t]+)", text)
    made = json.dumps(data, indent=step[1] if step else 4, ensure_ascii=text.isascii())
    if not re.search(r"\[\s*\n\s*[-\d]", text):  # Slicer writes a list of numbers on one line
        made = re.sub(r'\[\n\s*([^\[\]{}"]*?)\n\s*\]', lambda found: f"[{' '.join(found[1].split())}]", made)
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    return mark + made + text[len(text.rstrip()) :]
