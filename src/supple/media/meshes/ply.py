"""PLY, as text and binary: all properties of vertices, all elements and comments are kept."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.media import meshes
from supple.media.files import PathLike, unreadable

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER = re.compile(rb"ply\s*\n.*?\n\s*end_header[ \t]*\r?\n", re.DOTALL)
_LINE = re.compile(rb"[^\r\n]*\S[^\r\n]*")
_PLACE, _NORMAL = ["x", "y", "z"], ["nx", "ny", "nz"]
_INDICES = ("vertex_indices", "vertex_index", "vertex1", "vertex2")


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str]]  # (name, dtype, dtype of the length of a list or empty), in order

    @property
    def kinds(self) -> dict[str, str]:
        """The dtypes of properties by their names; "list" for lists."""
        return {name: "list" if length else kind for name, kind, length in self.properties}


def parsed(path: PathLike, data: bytes) -> meshes.PointFile:
    """Return the vertices of a PLY file, and their normals if it has the properties nx, ny and nz."""
    header = _HEADER.match(data)
    if header is None:
        raise unreadable(path, "it does not begin with the header of a PLY", "give a whole PLY file")
    order, elements = _declared(path, header[0].decode("latin-1"))
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise unreadable(path, "it has no vertices", "give a mesh")
    k = names.index("vertex")
    before, vertex, after = elements[:k], elements[k], elements[k + 1 :]
    kinds = vertex.kinds
    columns = _PLACE + (_NORMAL if set(_NORMAL) <= set(kinds) else [])
    wrong = [name for name in columns if kinds.get(name) not in ("f4", "f8")]
    if wrong or len(kinds) < len(vertex.properties):
        what = f"the property {wrong[0]} of its vertices is not of floats" if wrong else "a property is there twice"
        raise unreadable(path, what, "save it with vertices of floats")
    if any("list" in each.kinds.values() for each in ((*before, vertex) if order else (vertex,))):
        raise unreadable(path, "it has lists before the vertices end", "save it with vertices first, without lists")
    if order:
        skipped = sum(each.count * np.dtype(kind).itemsize for each in before for _, kind, _ in each.properties)
        fields = [(name, order + kind) for name, kind, _ in vertex.properties]
        numbers = meshes.in_rows(data, header.end() + skipped, vertex.count, fields, columns)
        end = numbers.end
    else:
        numbers, end = _text(path, data, header.end(), sum(each.count for each in before), vertex, columns)
    points, normals = meshes.checked(path, numbers.values[:, :3]), numbers.values[:, 3:].reshape(-1, 3)

    def rewritten(moved: meshes.Floats, turned: meshes.Floats) -> bytes:
        return meshes.edited(data, numbers.edits(np.hstack([moved, turned]) if len(turned) else moved))

    def parts() -> list[meshes.Part]:
        rest = _Rest(data[end:], order)
        found = {element.name: rest.element(element) for element in after}
        faces, edges = found.get("face", {}), found.get("edge", {})
        polygons = faces.get("vertex_indices") or faces.get("vertex_index") or meshes.NO_RUNS
        ends = [np.asarray(edges[name][0], np.intp) for name in ("vertex1", "vertex2") if name in edges]
        lines = (np.stack(ends, axis=1), np.full(len(ends[0]), 2)) if len(ends) == 2 else meshes.NO_RUNS
        return [meshes.part_of(len(points), polygons, lines)]

    return meshes.PointFile(
        points, meshes.space_of(header[0]), rewritten, parts, normals, np.arange(len(normals), dtype=np.intp)
    )


def _declared(path: PathLike, header: str) -> tuple[str, list[_Element]]:
    order, elements = None, []
    for line in header.splitlines():
        match line.split():
            case ["format", known, *_] if known in _ORDERS:
                order = _ORDERS[known]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, kind, name] if (
                elements and {length, kind} <= set(_TYPES) and _TYPES[length][0] in "iu"
            ):
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case ["ply" | "comment" | "obj_info" | "end_header", *_] | []:
                pass
            case _:
                raise unreadable(path, f"its header has the line {line.strip()!r}", "give a PLY of version 1.0")
    if order is None:
        raise unreadable(path, "its header names no format", "give a PLY of version 1.0")
    return order, elements


def _text(
    path: PathLike, data: bytes, start: int, skipped: int, vertex: _Element, columns: list[str]
) -> tuple[meshes.Numbers, int]:
    """Return columns of the vertices, which follow ``skipped`` rows of other elements, and the offset of their end."""
    places, count = [list(vertex.kinds).index(name) for name in columns], skipped + vertex.count
    spans, rows = list[tuple[int, int]](), list(itertools.islice(_LINE.finditer(data, start), count))
    if len(rows) < count:
        raise unreadable(path, f"it ends before its {vertex.count} vertices do")
    for k, row in enumerate(rows[skipped:], 1):
        words = [match.span() for match in meshes.TOKEN.finditer(data, *row.span())]
        if len(words) != len(vertex.properties):
            raise unreadable(path, f"vertex {k} has {len(words)} numbers", f"its header says {len(vertex.properties)}")
        spans += [words[place] for place in places]
    return meshes.in_text(data, spans, len(columns)), rows[-1].end() if rows else start


class _Rest:
    """A reader of the elements after the vertices, in order."""

    def __init__(self, data: bytes, order: str) -> None:
        self.order, self.at = order, 0
        self.held: Any = data if order else data.split()

    def element(self, known: _Element) -> dict[str, meshes.Runs]:
        """Read an element; return, for each property, its values and their number in each row."""
        if self.order and known.count and (found := self._alike(known)) is not None:
            return found
        rows: dict[str, list[list[int]]] = {name: [] for name, *_ in known.properties}
        for _ in range(known.count):
            for name, kind, length in known.properties:
                rows[name].append(self._taken(name, self._taken("", 1, length)[0] if length else 1, kind))
        return {name: meshes.joined(each) for name, each in rows.items()}

    def _alike(self, known: _Element) -> dict[str, meshes.Runs] | None:
        """Read binary rows at once, if all their lists have the length of the first row's, as is usual; else None."""
        start, fields, sizes = self.at, [], {}
        for name, kind, length in known.properties:
            sizes[name] = int(self._taken("", 1, length)[0]) if length else 1
            self._taken(name, sizes[name], kind)
            fields += [(f"#{name}", self.order + length)] if length else []
            fields.append((name, self.order + kind, *([sizes[name]] if length else [])))  # type: ignore[arg-type]
        self.at = start
        rows = np.dtype(fields)
        if start + known.count * rows.itemsize > len(self.held):
            return None
        found = np.frombuffer(self.held, rows, known.count, start)
        if not all((found[f"#{name}"] == sizes[name]).all() for name, _, length in known.properties if length):
            return None
        self.at += found.nbytes
        return {name: (found[name], np.full(known.count, sizes[name])) for name, *_ in known.properties}

    def _taken(self, name: str, many: int, kind: str) -> list[Any]:
        """Read values of a property, or a list's length (no ``name``); in text, values that are not indices are []."""
        start, self.at = self.at, self.at + many * (np.dtype(kind).itemsize if self.order else 1)
        if many < 0 or self.at > len(self.held):
            raise ValueError("it ends before its faces do")
        if self.order:
            return list(np.frombuffer(self.held, self.order + kind, many, start).tolist())
        return [int(word) for word in self.held[start : self.at]] if not name or name in _INDICES else []
