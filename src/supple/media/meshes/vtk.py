"""VTK's legacy PolyData, as text and binary: cells, arrays and field data are kept."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from supple.errors import shown
from supple.media.files import PathLike, unreadable
from supple.media.meshes.base import Floats, Mesh, Spans, checked, numbers, space_of, spliced
from supple.media.meshes.cells import NO_RUNS, Ints, Part, Runs, part_of

_HEAD = re.compile(
    rb"# vtk DataFile Version [^\n]*\n([^\n]*)\n\s*(ASCII|BINARY)\s*\n\s*DATASET\s+(\w+)[ \t]*\r?\n", re.I
)
_POINTS = re.compile(rb"(?:^|\n)POINTS\s+(\d+)\s+(\w+)[ \t]*\r?\n")
_POINT_DATA, _CELL_DATA = re.compile(rb"\nPOINT_DATA\s+\d+\s*?\n"), re.compile(rb"\nCELL_DATA\s+\d+\s*?\n")
_NORMALS = re.compile(rb"(?:^|\n)NORMALS\s+\S+\s+(\w+)[ \t]*\r?\n")
_RANGE = re.compile(rb"(?<=NAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 )\S+ \S+")
_KINDS = {b"float": ">f4", b"double": ">f8"}
_TOKEN = re.compile(rb"\S+")
_CELLS = re.compile(rb"(?:^|\n)(POLYGONS|LINES|TRIANGLE_STRIPS)\s+(\d+)\s+(\d+)[ \t]*\r?\n")
_OFFSETS = re.compile(rb"\s*(OFFSETS|CONNECTIVITY)\s+(\w+)[ \t]*\r?\n")  # from version 5 on
_WHOLE = {b"vtktypeint64": ">i8", b"vtktypeint32": ">i4", b"int": ">i4"}


@dataclass(frozen=True, slots=True)
class _Block:
    """Vectors in a file: their values (N, 3), the place of the numbers, and their dtype or, in text, spans."""

    values: Floats
    start: int
    end: int
    stored: str | Spans

    def written(self, data: bytes, new: Floats) -> bytes:
        """Return the bytes of the block with new values."""
        if isinstance(self.stored, str):
            return np.where(new != self.values, new, self.values).astype(self.stored).tobytes()
        return spliced(data[self.start : self.end], self.stored, self.values, new)


def parsed(path: PathLike, data: bytes) -> Mesh:
    """Return the points of PolyData, and the active normals of points."""
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
    points = _block(path, data, declared.end(), int(declared[1]), declared[2], binary)
    checked(path, points.values)
    blocks, normals = [points], np.zeros((0, 3))
    if section := _POINT_DATA.search(data, points.end):
        after = _CELL_DATA.search(data, section.end())
        if named := _NORMALS.search(data, section.end() - 1, after.start() + 1 if after else len(data)):
            blocks.append(_block(path, data, named.end(), len(points.values), named[1], binary))
            normals = blocks[1].values

    def rewritten(moved: Floats, turned: Floats) -> bytes:
        parts, last = [], 0
        for block, new in zip(blocks, (moved, turned), strict=False):
            parts += [data[last : block.start], block.written(data, new)]
            last = block.end
            if block is points and (new != block.values).any():
                length = np.linalg.norm(new, axis=1)
                text = f"{length.min():.17g} {length.max():.17g}".encode()
                tail = data[last : last + 400]  # the range that newer versions note behind the points
                noted = _RANGE.search(tail) if tail.lstrip().startswith(b"METADATA") else None
                if noted:
                    parts += [tail[: noted.start()], text]
                    last += noted.end()
        return b"".join([*parts, data[last:]])

    at = np.arange(len(normals), dtype=np.intp)
    return Mesh(points.values, space_of(head[1]), rewritten, lambda: _parts(path, data, points, binary), normals, at)


def _parts(path: PathLike, data: bytes, points: _Block, binary: bool) -> list[Part]:
    runs = dict.fromkeys((b"POLYGONS", b"LINES", b"TRIANGLE_STRIPS"), NO_RUNS)
    place = points.end - 1
    while found := _CELLS.search(data, place):
        runs[found[1]], place = _runs(path, data, found, binary)
    polygons, lines, strips = runs.values()
    return [part_of(path, len(points.values), polygons, lines, strips)]


def _runs(path: PathLike, data: bytes, found: re.Match[bytes], binary: bool) -> tuple[Runs, int]:
    """Return cells, and where they end: corners behind their number, or apart from offsets."""
    first, second = int(found[2]), int(found[3])
    named = _OFFSETS.match(data, found.end())
    if named is None:
        numbers, end = _whole(path, data, found.end(), second, b"int", binary)
        counts, k = [], 0
        for _ in range(first):
            if k >= second:
                raise unreadable(path, f"it ends before its {first} cells do")
            counts.append(int(numbers[k]))
            if counts[-1] < 0:
                raise unreadable(path, f"a cell has {counts[-1]} corners")
            k += counts[-1] + 1
        heads = np.cumsum([0, *(count + 1 for count in counts)])[:-1]
        return (np.delete(numbers, heads), counts), end
    offsets, end = _whole(path, data, named.end(), first, named[2], binary)
    named = _OFFSETS.match(data, end)
    if named is None:
        raise unreadable(path, f"it ends before its {first} cells do")
    corners, end = _whole(path, data, named.end(), second, named[2], binary)
    return (corners, np.diff(offsets)), end


def _whole(path: PathLike, data: bytes, start: int, count: int, kind: bytes, binary: bool) -> tuple[Ints, int]:
    """Return whole numbers, and where they end."""
    if kind.lower() not in _WHOLE:
        raise unreadable(path, f"its cells are of type {shown(kind.decode(errors='replace'))}")
    if binary:
        dtype = np.dtype(_WHOLE[kind.lower()])
        end = start + count * dtype.itemsize
        if end > len(data):
            raise unreadable(path, f"it ends before its {count} cells do")
        return np.frombuffer(data, dtype, count, start).astype(np.intp), end
    tokens = [match for match, _ in zip(_TOKEN.finditer(data, start), range(count), strict=False)]
    try:
        made = np.array([int(token[0]) for token in tokens], np.intp)
    except (ValueError, OverflowError):
        raise unreadable(path, "a cell has what is no whole number of 64 bits") from None
    if len(made) < count:
        raise unreadable(path, f"it ends before its {count} cells do")
    return made, tokens[-1].end() if tokens else start


def _block(path: PathLike, data: bytes, start: int, count: int, kind: bytes, binary: bool) -> _Block:
    if kind.lower() not in _KINDS:
        raise unreadable(
            path, f"its vectors are of type {shown(kind.decode(errors='replace'))}", "save it with float or double"
        )
    if binary:
        dtype = np.dtype(_KINDS[kind.lower()])
        end = start + 3 * count * dtype.itemsize
        if end > len(data):
            raise unreadable(path, f"it ends before its {count} vectors do")
        return _Block(
            np.frombuffer(data, dtype, 3 * count, start).reshape(-1, 3).astype(np.float64), start, end, dtype.str
        )
    spans = []
    for match, _ in zip(_TOKEN.finditer(data, start), range(3 * count), strict=False):
        spans.append((match.start() - start, match.end() - start))
    if len(spans) < 3 * count:
        raise unreadable(path, f"it ends before its {count} vectors do")
    values = numbers(path, [data[start + a : start + b] for a, b in spans]).reshape(-1, 3)
    return _Block(values, start, start + spans[-1][1] if spans else start, spans)
