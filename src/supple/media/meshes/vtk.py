"""VTK's legacy PolyData, as text and binary: cells, arrays and field data are kept."""

from __future__ import annotations

import re

import numpy as np

from supple.errors import shown
from supple.media import meshes
from supple.media.files import PathLike, unreadable

_HEAD = re.compile(
    rb"# vtk DataFile Version [^\n]*\n([^\n]*)\n\s*(ASCII|BINARY)\s*\n\s*DATASET\s+(\w+)[ \t]*\r?\n", re.I
)
_POINTS = re.compile(rb"(?:^|\n)POINTS\s+(\d+)\s+(\w+)[ \t]*\r?\n")
_POINT_DATA, _CELL_DATA = re.compile(rb"\nPOINT_DATA\s+\d+\s*?\n"), re.compile(rb"\nCELL_DATA\s+\d+\s*?\n")
_NORMALS = re.compile(rb"(?:^|\n)NORMALS\s+\S+\s+(\w+)[ \t]*\r?\n")
_RANGE = re.compile(rb"\s*METADATA\b.{,400}?NAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 (\S+ \S+)", re.DOTALL)
_CELLS = re.compile(rb"(?:^|\n)(POLYGONS|LINES|TRIANGLE_STRIPS)\s+(\d+)\s+(\d+)[ \t]*\r?\n")
_OFFSETS = re.compile(rb"\s*(?:OFFSETS|CONNECTIVITY)\s+(\w+)[ \t]*\r?\n")  # from version 5 on
_KINDS = {b"float": ">f4", b"double": ">f8", b"vtktypeint64": ">i8", b"vtktypeint32": ">i4", b"int": ">i4"}


def parsed(path: PathLike, data: bytes) -> meshes.PointFile:
    """Return the points of PolyData, and their active normals."""
    head = _HEAD.match(data)
    if head is None:
        raise unreadable(path, "it does not begin with the header of VTK's legacy format", "give a whole .vtk file")
    if head[3].upper() != b"POLYDATA":
        found = f"it holds {shown(head[3].decode(errors='replace'))}"
        raise unreadable(path, found, "give PolyData, such as a surface")
    binary = head[2].upper() == b"BINARY"
    declared = _POINTS.search(data, head.end() - 1)
    if declared is None:
        raise unreadable(path, "it has no POINTS", "give a mesh")
    points = _vectors(path, data, declared.end(), int(declared[1]), declared[2], binary)
    meshes.checked(path, points.values)
    normals = meshes.Numbers(np.zeros((0, 3)), 0, lambda _: [])
    if section := _POINT_DATA.search(data, points.end):
        after = _CELL_DATA.search(data, section.end())
        if named := _NORMALS.search(data, section.end() - 1, after.start() + 1 if after else len(data)):
            normals = _vectors(path, data, named.end(), len(points.values), named[1], binary)

    def rewritten(moved: meshes.Floats, turned: meshes.Floats) -> bytes:
        edits = [*points.edits(moved), *normals.edits(turned)]
        noted = _RANGE.match(data, points.end)  # the range of values, which newer versions store after the points
        if noted and (moved != points.values).any():
            length = np.linalg.norm(moved, axis=1)
            edits.append((*noted.span(1), f"{length.min():.17g} {length.max():.17g}".encode()))
        return meshes.edited(data, edits)

    def parts() -> list[meshes.Part]:
        runs, place = dict.fromkeys((b"POLYGONS", b"LINES", b"TRIANGLE_STRIPS"), meshes.NO_RUNS), points.end - 1
        while found := _CELLS.search(data, place):
            runs[found[1]], place = _runs(data, found, binary)
        return [meshes.part_of(len(points.values), *runs.values())]

    at = np.arange(len(normals.values), dtype=np.intp)
    return meshes.PointFile(points.values, meshes.space_of(head[1]), rewritten, parts, normals.values, at)


def _runs(data: bytes, found: re.Match[bytes], binary: bool) -> tuple[meshes.Runs, int]:
    """Return cells and the offset of their end; corners follow their number, or, since version 5, are an own array."""
    first, second = int(found[2]), int(found[3])
    if named := _OFFSETS.match(data, found.end()):
        offsets, end = _whole(data, named.end(), first, named[1], binary)
        if (named := _OFFSETS.match(data, end)) is None:
            raise ValueError("its cells have offsets alone")
        corners, end = _whole(data, named.end(), second, named[1], binary)
        return (corners, np.diff(offsets)), end
    numbers, end = _whole(data, found.end(), second, b"int", binary)
    heads = [0]
    for _ in range(first):
        heads.append(heads[-1] + int(numbers[heads[-1]]) + 1)
    return (np.delete(numbers, heads[:-1]), np.diff(heads) - 1), end


def _whole(data: bytes, start: int, count: int, kind: bytes, binary: bool) -> tuple[meshes.Ints, int]:
    if binary:
        numbers = np.frombuffer(data, _KINDS[kind.lower()], count, start)
        return numbers.astype(np.intp), start + numbers.nbytes
    spans = meshes.tokens(data, start, count)
    return np.array([int(data[a:b]) for a, b in spans], np.intp), spans[-1][1] if spans else start


def _vectors(path: PathLike, data: bytes, start: int, count: int, kind: bytes, binary: bool) -> meshes.Numbers:
    if kind.lower() not in (b"float", b"double"):
        found = f"its vectors are of type {shown(kind.decode(errors='replace'))}"
        raise unreadable(path, found, "save it with float or double")
    if binary:
        return meshes.in_rows(data, start, count, [("vector", _KINDS[kind.lower()], 3)], ["vector"])
    return meshes.in_text(data, meshes.tokens(data, start, 3 * count), 3, start)
