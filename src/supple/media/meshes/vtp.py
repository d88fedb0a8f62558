"""VTK's XML PolyData: arrays of points and normals are replaced in the same encoding, all else is kept."""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.errors import shown
from supple.media import meshes
from supple.media.files import PathLike, unreadable

_ROOT = re.compile(rb"<VTKFile\b([^>]*)>")
_PIECE = re.compile(rb"<Piece\b.*?</Piece\s*>", re.DOTALL)
_ARRAY = re.compile(rb"<(DataArray|Array)\b([^>]*?)(/>|>(.*?)</\1\s*>)", re.DOTALL)
_KEY = re.compile(rb"\s*<InformationKey\b.*?</InformationKey\s*>", re.DOTALL)
_NOTED = rb'\s+Range(?:Min|Max)="[^"]*"|\s*<InformationKey name="L2_NORM(?:_FINITE)?_RANGE".*?</InformationKey\s*>'
_RANGE = re.compile(_NOTED, re.DOTALL)
_APPENDED = re.compile(rb'<AppendedData\s+encoding="(raw|base64)"\s*>\s*_')
_OFFSET = re.compile(rb'(<(?:DataArray|Array)\b[^>]*?\boffset=")(\d+)(")')
_TYPES = {
    "Float32": "f4", "Float64": "f8", "Int64": "i8", "Int32": "i4", "UInt64": "u8", "UInt32": "u4", "Int16": "i2",
    "UInt16": "u2", "Int8": "i1", "UInt8": "u1", "String": "u1",
}  # fmt: skip
_Codec = tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]
_CODECS: dict[str, _Codec] = {
    "vtkZLibDataCompressor": (zlib.compress, zlib.decompress),
    "vtkLZMADataCompressor": (lzma.compress, lzma.decompress),
}


@dataclass(frozen=True, slots=True)
class _File:
    """A file, the encoding of its arrays, and the offset of its appended data."""

    path: PathLike
    data: bytes
    order: str
    count: np.dtype[np.unsignedinteger]
    codec: _Codec | None
    appended: int
    raw: bool

    def decode(self, start: int, raw: bool) -> tuple[bytes, int, int]:
        """Return the bytes of an array at an offset, the offset of its end, and the size of its blocks."""
        size = self.count.itemsize

        def taken(at: int, many: int) -> tuple[bytes, int]:
            wide = many if raw else -(-many // 3) * 4
            part = self.data[at : at + wide]
            if len(part) < wide:
                raise ValueError("it ends before its arrays do")
            return part if raw else base64.b64decode(part, validate=True), at + wide

        if self.codec is None:
            (many,) = np.frombuffer(taken(start, size)[0][:size], self.count).tolist()
            whole, end = taken(start, size + many)
            return whole[size:], end, 0
        head = np.frombuffer(taken(start, 3 * size)[0][: 3 * size], self.count).tolist()
        sizes, at = taken(start, (3 + head[0]) * size)
        each = np.frombuffer(sizes, self.count)[3:].tolist()
        packed, end = taken(at, sum(each))
        parts, last = [], 0
        for many in each:
            parts.append(self.codec[1](packed[last : last + many]))
            last += many
        return b"".join(parts), end, head[1]

    def encode(self, values: bytes, block: int, raw: bool) -> bytes:
        """Encode an array for `decode`."""
        plain: Callable[[bytes], bytes] = bytes if raw else base64.b64encode
        if self.codec is None:
            return plain(np.array([len(values)], self.count).tobytes() + values)
        step = max(block, 1)
        packed = [self.codec[0](values[k : k + step]) for k in range(0, len(values), step)]
        head = [len(packed), block, len(values) % step, *map(len, packed)]
        return plain(np.array(head, self.count).tobytes()) + plain(b"".join(packed))


class _Array(NamedTuple):
    """An array: its attributes, its numbers, its tag, and what replaces the numbers by others."""

    known: dict[str, str]
    values: npt.NDArray[Any]
    tag: tuple[int, int]
    edits: Callable[[meshes.Floats], list[meshes.Edit]] = lambda _: []


def parsed(path: PathLike, data: bytes) -> meshes.PointFile:
    """Return the points of all pieces of PolyData, and their active normals."""
    root = _ROOT.search(data, 0, 4096)
    known = _attributes(root[1]) if root else {}
    if known.get("type") != "PolyData":
        found = f"it holds {shown(known['type'])}" if "type" in known else "it does not begin as XML of VTK does"
        raise unreadable(path, found, "give PolyData, such as a surface")
    named = known.get("compressor", "")
    if named and named not in _CODECS:
        raise unreadable(path, f"it is compressed by {shown(named)}", "save it with ZLib, or uncompressed")
    order = "<" if known.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    count = np.dtype(order + {"UInt64": "u8"}.get(known.get("header_type", ""), "u4"))
    appended = _APPENDED.search(data)
    begin = appended.end() if appended else len(data)
    raw = appended is not None and appended[1] == b"raw"
    file = _File(path, data, order, count, _CODECS.get(named), begin, raw)
    xml = data[: appended.start() if appended else None]
    if not appended and b"</VTKFile" not in xml:
        raise unreadable(path, "its end is missing")
    pieces = list(_PIECE.finditer(xml))
    points, normals, at, base = [], [], [], 0
    for piece in pieces:
        placed = next(_arrays(file, piece, "Points"), None)
        if placed is None:
            raise unreadable(file.path, "a piece has no points", "give a mesh")
        points.append(_vectors(file, placed, "Points"))
        opened = re.search(rb"<PointData\b([^>]*)>", piece[0])
        active = _attributes(opened[1]).get("Normals") if opened else None
        for array in _arrays(file, piece, "PointData", active) if active else ():
            normals.append(_vectors(file, array, "PointData"))
            if len(array.values) != len(placed.values):
                many = [len(each.values) // 3 for each in (array, placed)]
                raise unreadable(file.path, f"it has {many[0]} normals for {many[1]} points")
            at.append(base + np.arange(len(array.values) // 3, dtype=np.intp))
        base += len(placed.values) // 3

    def rewritten(moved: meshes.Floats, turned: meshes.Floats) -> bytes:
        edits: list[meshes.Edit] = []
        for arrays, new in ((points, moved), (normals, turned)):
            ends = np.cumsum([len(values) for _, values in arrays])
            for (array, values), part in zip(arrays, np.split(new, ends), strict=False):
                if (part != values).any():
                    edits += array.edits(part)  # and its range, where the tag has it, is removed
                    edits += [(*found.span(), b"") for found in _RANGE.finditer(data, *array.tag)]
        return meshes.edited(file.data, [*edits, *_offsets(file, edits)])

    vertices = meshes.checked(file.path, np.concatenate([values for _, values in points]) if points else [])
    vectors = np.concatenate([np.zeros((0, 3)), *(values for _, values in normals)])
    counts = [len(values) for _, values in points]
    return meshes.PointFile(
        vertices, _space(file, xml), rewritten, lambda: [_part(file, pieces, counts)], vectors,
        np.concatenate([np.zeros(0, np.intp), *at]),
    )  # fmt: skip


def _part(file: _File, pieces: list[re.Match[bytes]], counts: list[int]) -> meshes.Part:
    runs = []
    for kind in ("Polys", "Lines", "Strips"):
        corners: list[meshes.Ints] = []
        many: list[meshes.Ints] = []
        for piece, base in zip(pieces, np.cumsum([0, *counts]).tolist(), strict=False):
            arrays = {}
            for array in _arrays(file, piece, kind):
                if array.values.dtype.kind not in "iu" or array.known["type"] == "String":
                    raise unreadable(file.path, f"{kind} are not whole numbers")
                arrays[array.known.get("Name", "")] = array.values.astype(np.intp)
            if {"connectivity", "offsets"} <= set(arrays):
                corners.append(base + arrays["connectivity"])
                many.append(np.diff(arrays["offsets"], prepend=0))
        runs.append((np.concatenate(corners), np.concatenate(many)) if corners else meshes.NO_RUNS)
    return meshes.part_of(sum(counts), *runs)


def _attributes(text: bytes) -> dict[str, str]:
    found = re.findall(r"([\w:]+)\s*=\s*[\"']([^\"']*)[\"']", text.decode("utf-8", "replace"))
    return dict(found)


def _vectors(file: _File, array: _Array, section: str) -> tuple[_Array, meshes.Floats]:
    if array.values.dtype.kind != "f" or array.known.get("NumberOfComponents") != "3":
        raise unreadable(file.path, f"{section} are not three floats each", "save it with Float32 or Float64")
    return array, array.values.reshape(-1, 3).astype(np.float64)


def _arrays(file: _File, piece: re.Match[bytes], section: str, name: str | None = None) -> Iterator[_Array]:
    """Yield the arrays in a section of a piece: all, or those of a name."""
    where = re.search(rb"<%b\b[^>]*>(.*?)</%b\s*>" % ((section.encode(),) * 2), piece[0], re.DOTALL)
    if where is not None:
        for found in _ARRAY.finditer(file.data, piece.start() + where.start(1), piece.start() + where.end(1)):
            if name is None or _attributes(found[2]).get("Name") == name:
                yield _array(file, found)


def _array(file: _File, found: re.Match[bytes]) -> _Array:
    known, tag = {"format": "ascii", **_attributes(found[2])}, found.span()
    if known.get("type") not in _TYPES:
        raise unreadable(file.path, f"an array is of type {shown(known.get('type', ''))}")
    dtype = np.dtype(file.order + _TYPES[known["type"]])
    if known["format"] == "appended":
        start, raw = file.appended + int(known.get("offset", "0")), file.raw
    else:
        inner = _KEY.sub(lambda key: b" " * len(key[0]), found[4] or b"")
        spans = [
            (found.start(4) + match.start(), found.start(4) + match.end()) for match in meshes.TOKEN.finditer(inner)
        ]
        if not spans:
            return _Array(known, np.zeros(0, dtype), tag)
        if known["format"] == "ascii" and dtype.kind == "f":
            text = meshes.in_text(file.data, spans, 1)
            return _Array(known, text.values.ravel(), tag, text.edits)
        if known["format"] == "ascii":
            return _Array(known, np.array([int(file.data[a:b]) for a, b in spans], dtype), tag)
        start, raw = spans[0][0], False
    values, end, block = file.decode(start, raw)

    def edits(new: meshes.Floats) -> list[meshes.Edit]:
        return [(start, end, file.encode(new.astype(dtype).tobytes(), block, raw))]

    return _Array(known, np.frombuffer(values, dtype), tag, edits)


def _space(file: _File, xml: bytes) -> str:
    """Return the convention in the field SPACE, which 3D Slicer writes as character codes."""
    for found in _ARRAY.finditer(xml):
        if _attributes(found[2]).get("Name") == "SPACE":
            said = _array(file, found).values.tobytes().rstrip(b"\0").decode("latin-1")
            return said if said in ("LPS", "RAS") else ""
    return ""


def _offsets(file: _File, edits: list[meshes.Edit]) -> Iterator[meshes.Edit]:
    """Yield the edits of offsets, which shift where appended arrays before them change in size."""
    shifts = [(start - file.appended, len(new) - (end - start)) for start, end, new in edits if start >= file.appended]
    if any(size for _, size in shifts):
        for found in _OFFSET.finditer(file.data, 0, file.appended):
            shift = sum(size for start, size in shifts if start < int(found[2]))
            if shift:
                yield (*found.span(2), str(int(found[2]) + shift).encode())
