"""PLY, as text and binary: all properties of vertices, all elements and comments are kept."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from supple.media.files import PathLike, unreadable
from supple.media.meshes.base import Floats, Mesh, checked, numbers, space_of, spliced
from supple.media.meshes.cells import NO_RUNS, Part, Runs, joined, part_of

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER = re.compile(rb"ply\s*\n.*?\n\s*end_header[ \t]*\r?\n", re.DOTALL)
_TOKEN = re.compile(rb"\S+")
_INDICES = ("vertex_indices", "vertex_index", "vertex1", "vertex2")
_PLACE, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    """Names and dtypes, in order; "list" for a list."""
    lists: dict[str, tuple[str, str]] = field(default_factory=dict)
    """The dtypes of lists: of their length, and of what they hold."""


def parsed(path: PathLike, data: bytes) -> Mesh:
    """Return the vertices of a PLY file, and their normals if it has the properties nx, ny and nz."""
    header = _HEADER.match(data)
    if header is None:
        raise unreadable(path, "it does not begin with the header of a PLY", "give a whole PLY file")
    order, elements = _declared(path, header[0].decode("latin-1"))
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise unreadable(path, "it has no vertices", "give a mesh")
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    kinds = dict(vertex.properties)
    for name in kinds:
        if [known for known, _ in vertex.properties].count(name) > 1:
            raise unreadable(path, f"its vertices have {name} twice", "leave the name to one property")
    columns = [*_PLACE, *(_NORMAL if set(_NORMAL) <= set(kinds) else ())]
    for name in columns:
        if kinds.get(name) not in ("f4", "f8"):
            found = f"the property {name} of its vertices is not of floats" if name in kinds else f"no property {name}"
            raise unreadable(path, found, "save it with vertices of floats")
    if order:
        values, rewritten, end = _binary(path, data, header.end(), order, before, vertex, columns)
    else:
        values, rewritten, end = _text(path, data, header.end(), before, vertex, columns)
    points, normals = checked(path, values[:, :3]), values[:, 3:].reshape(-1, 3)
    at = np.arange(len(normals), dtype=np.intp)

    def written(moved: Floats, turned: Floats) -> bytes:
        return bytes(rewritten(np.hstack([moved, turned]) if len(turned) else moved))

    def parts() -> list[Part]:
        read = _Rows(path, data, end, order) if order else _Words(path, iter(data[end:].split()))
        known: dict[str, dict[str, Runs]] = {e.name: read.element(e) for e in elements[len(before) + 1 :]}
        faces, edges = known.get("face", {}), known.get("edge", {})
        polygons = faces.get("vertex_indices") or faces.get("vertex_index") or NO_RUNS
        ends = [np.asarray(edges[name][0], np.intp) for name in ("vertex1", "vertex2") if name in edges]
        lines = (np.stack(ends, axis=1), np.full(len(ends[0]), 2)) if len(ends) == 2 else NO_RUNS
        return [part_of(path, len(points), polygons, lines)]

    return Mesh(points, space_of(header[0]), written, parts, normals, at)


@dataclass(slots=True)
class _Rows:
    """Binary elements, one after the other."""

    path: PathLike
    data: bytes
    at: int
    order: str

    def element(self, known: _Element) -> dict[str, Runs]:
        """Return the values of each property, and for lists how many are in each."""
        start, lengths = self.at, self._row(known)
        fields: list[Any] = []
        for name, kind in known.properties:
            if kind == "list":
                length, inner = known.lists[name]
                fields += [(f"#{name}", self.order + length), (name, self.order + inner, len(lengths.get(name, ())))]
            else:
                fields.append((name, self.order + kind))
        rows = np.dtype(fields)
        if start + known.count * rows.itemsize <= len(self.data):  # most have faces of one size
            found = np.frombuffer(self.data, rows, known.count, start)
            if all((found[f"#{name}"] == len(lengths.get(name, ()))).all() for name in known.lists):
                self.at = start + found.nbytes
                return {
                    name: (found[name], np.full(known.count, len(lengths.get(name, ()))) if kind == "list" else ())
                    for name, kind in known.properties
                }
        self.at = start
        every = [self._row(known) for _ in range(known.count)]
        return {name: joined([row[name] for row in every]) for name, _ in known.properties}

    def _row(self, known: _Element) -> dict[str, list[int]]:
        made = {}
        for name, kind in known.properties if known.count else ():
            length, inner = known.lists.get(name, ("", kind))
            made[name] = self._take(self._take(1, length)[0] if length else 1, inner)
        return made

    def _take(self, many: int, kind: str) -> list[int]:
        dtype = np.dtype(self.order + kind)
        end = self.at + many * dtype.itemsize
        if many < 0 or end > len(self.data):
            raise unreadable(self.path, "it ends before its faces do")
        self.at, start = end, self.at
        values: list[int] = np.frombuffer(self.data, dtype, many, start).tolist()
        return values


@dataclass(slots=True)
class _Words:
    """Elements of text, one after the other."""

    path: PathLike
    words: Iterator[bytes]

    def element(self, known: _Element) -> dict[str, Runs]:
        """Return the values of each property, and for lists how many are in each."""
        every: dict[str, list[list[int]]] = {name: [] for name, _ in known.properties}
        try:
            for _ in range(known.count):
                for name, kind in known.properties:
                    many = int(next(self.words)) if kind == "list" else 1
                    row = [next(self.words) for _ in range(many)]
                    every[name].append([int(x) for x in row] if name in _INDICES else [])
        except StopIteration:
            raise unreadable(self.path, "it ends before its faces do") from None
        except (ValueError, OverflowError):
            raise unreadable(self.path, "a face has what is no whole number") from None
        return {name: joined(rows) for name, rows in every.items()}


def _declared(path: PathLike, header: str) -> tuple[str, list[_Element]]:
    order, elements = None, []
    for line in header.splitlines():
        match line.split():
            case ["format", known, *_] if known in _ORDERS:
                order = _ORDERS[known]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if (
                elements and {length, kind} <= set(_TYPES) and _TYPES[length][0] in "iu"
            ):
                elements[-1].properties.append((name, "list"))
                elements[-1].lists[name] = _TYPES[length], _TYPES[kind]
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind]))
            case ["ply" | "comment" | "obj_info" | "end_header", *_] | []:
                pass
            case _:
                raise unreadable(path, f"its header has the line {line.strip()!r}", "give a PLY of version 1.0")
    if order is None:
        raise unreadable(path, "its header names no format", "give a PLY of version 1.0")
    return order, elements


def _binary(
    path: PathLike, data: bytes, start: int, order: str, before: list[_Element], vertex: _Element, columns: list[str]
) -> tuple[Floats, Any, int]:
    for element in (*before, vertex):
        if "list" in dict(element.properties).values():
            raise unreadable(path, f"{element.name} has lists before the vertices end", "save it with vertices first")
    for element in before:
        start += element.count * np.dtype([(f"{k}", kind) for k, (_, kind) in enumerate(element.properties)]).itemsize
    kind = np.dtype([(name, order + dtype) for name, dtype in vertex.properties])
    end = start + vertex.count * kind.itemsize
    if end > len(data):
        raise unreadable(path, f"it ends before its {vertex.count} vertices do")
    rows = np.frombuffer(data, kind, vertex.count, start)

    def rewritten(values: Floats) -> bytes:
        made = rows.copy()
        for k, name in enumerate(columns):
            made[name] = values[:, k]
        return data[:start] + made.tobytes() + data[end:]

    return np.stack([rows[name] for name in columns], axis=-1).astype(np.float64), rewritten, end


def _text(
    path: PathLike, data: bytes, start: int, before: list[_Element], vertex: _Element, columns: list[str]
) -> tuple[Floats, Any, int]:
    order = [name for name, _ in vertex.properties]
    if "list" in dict(vertex.properties).values():
        raise unreadable(path, "its vertices have lists", "save it without these")
    skipped, spans, rows = sum(element.count for element in before), [], 0
    for line in data[start:].splitlines(keepends=True):
        if rows == skipped + vertex.count:
            break
        tokens = [match.span() for match in _TOKEN.finditer(line)]
        if tokens:
            rows += 1
            if rows > skipped:
                if len(tokens) != len(order):
                    found = f"vertex {rows - skipped} has {len(tokens)} numbers"
                    raise unreadable(path, found, f"its header says {len(order)}")
                spans += [(start + tokens[k][0], start + tokens[k][1]) for k in map(order.index, columns)]
        start += len(line)
    if rows < skipped + vertex.count:
        raise unreadable(path, f"it ends before its {vertex.count} vertices do")
    values = numbers(path, [data[a:b] for a, b in spans]).reshape(-1, len(columns))

    def rewritten(made: Floats) -> bytes:
        places = sorted(range(len(spans)), key=spans.__getitem__)
        return spliced(data, [spans[k] for k in places], values.ravel()[places], made.ravel()[places])

    return values, rewritten, start
