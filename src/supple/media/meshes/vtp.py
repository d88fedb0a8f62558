"""VTK's XML PolyData: the arrays of points and normals are encoded anew as they were, all else is kept."""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, unreadable
from supple.media.meshes.base import Floats, Mesh, checked, numbers, spliced
from supple.media.meshes.cells import NO_RUNS, Ints, Part, part_of

_ROOT = re.compile(rb"<VTKFile\b([^>]*)>")
_PIECE = re.compile(rb"<Piece\b.*?</Piece\s*>", re.DOTALL)
_ARRAY = re.compile(rb"<(DataArray|Array)\b([^>]*?)(/>|>(.*?)</\1\s*>)", re.DOTALL)
_KEY = re.compile(rb"\s*<InformationKey\b.*?</InformationKey\s*>", re.DOTALL)
_RANGES = re.compile(
    rb'(name="L2_NORM(?:_FINITE)?_RANGE"[^>]*>\s*<Value index="0">\s*)\S+?'
    rb'(\s*</Value>\s*<Value index="1">\s*)\S+?(\s*<)'
)
_APPENDED = re.compile(rb'<AppendedData\s+encoding="(raw|base64)"\s*>\s*_')
_OFFSET = re.compile(rb'(<(?:DataArray|Array)\b[^>]*?\boffset=")(\d+)(")')
_TOKEN = re.compile(rb"\S+")
_TYPES = {"Float32": "f4", "Float64": "f8"}
_WHOLE = {"Int64": "i8", "Int32": "i4", "UInt64": "u8", "UInt32": "u4", "Int16": "i2", "UInt16": "u2", "UInt8": "u1"}
_Codec = tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]
_CODECS: dict[str, _Codec] = {
    "vtkZLibDataCompressor": (zlib.compress, zlib.decompress),
    "vtkLZMADataCompressor": (lzma.compress, lzma.decompress),
}


@dataclass(frozen=True, slots=True)
class _File:
    """A file, how its arrays are encoded, and where its appended data begins."""

    path: PathLike
    data: bytes
    order: str
    count: np.dtype[np.unsignedinteger]
    codec: _Codec | None
    appended: int
    raw: bool

    def decode(self, start: int, raw: bool) -> tuple[bytes, int, int]:
        """Return the bytes of an array that begins at ``start``, its end, and the size of its blocks."""
        size = self.count.itemsize

        def taken(at: int, many: int) -> tuple[bytes, int]:
            wide = many if raw else -(-many // 3) * 4
            part = self.data[at : at + wide]
            if len(part) < wide:
                raise unreadable(self.path, "it ends before its arrays do")
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
        """Return an array as `decode` reads it."""
        plain: Callable[[bytes], bytes] = bytes if raw else base64.b64encode
        if self.codec is None:
            return plain(np.array([len(values)], self.count).tobytes() + values)
        step = max(block, 1)
        packed = [self.codec[0](values[k : k + step]) for k in range(0, len(values), step)]
        head = [len(packed), block, len(values) % step, *map(len, packed)]
        return plain(np.array(head, self.count).tobytes()) + plain(b"".join(packed))


@dataclass(frozen=True, slots=True)
class _Array:
    """An array of vectors: its values (N, 3), its tag, and the place of its numbers."""

    values: Floats
    tag: tuple[int, int]
    start: int
    end: int
    dtype: str
    form: str
    block: int

    def written(self, file: _File, new: Floats) -> bytes:
        """Return what stands for the numbers."""
        if self.form == "ascii":
            inner = file.data[self.start : self.end]
            return spliced(inner, [match.span() for match in _TOKEN.finditer(inner)], self.values, new)
        raw = self.form == "appended" and file.raw
        return file.encode(new.astype(self.dtype).tobytes(), self.block, raw)


def parsed(path: PathLike, data: bytes) -> Mesh:
    """Return the points of PolyData in all pieces, and the active normals of points."""
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
    try:
        return _read(file, data[: appended.start() if appended else None])
    except (binascii.Error, zlib.error, lzma.LZMAError, ValueError) as error:
        raise unreadable(path, f"an array is damaged ({error})") from error


def _read(file: _File, xml: bytes) -> Mesh:
    if file.appended == len(file.data) and b"</VTKFile" not in xml:
        raise unreadable(file.path, "its end is missing")
    points, normals, at, base = [], [], [], 0
    for piece in _PIECE.finditer(xml):
        (placed,) = _arrays(file, piece, "Points", None) or (None,)
        if placed is None:
            raise unreadable(file.path, "a piece has no points", "give a mesh")
        opened = re.search(rb"<PointData\b([^>]*)>", piece[0])
        active = _attributes(opened[1]).get("Normals") if opened else None
        for array in _arrays(file, piece, "PointData", active) if active else ():
            if len(array.values) != len(placed.values):
                found = f"it has {len(array.values)} normals for {len(placed.values)} points"
                raise unreadable(file.path, found)
            normals.append(array)
            at.append(base + np.arange(len(array.values), dtype=np.intp))
        points.append(placed)
        base += len(placed.values)

    def rewritten(moved: Floats, turned: Floats) -> bytes:
        edits: list[tuple[int, int, bytes]] = []
        for arrays, new in ((points, moved), (normals, turned)):
            last = 0
            for array in arrays:
                part = new[last : last + len(array.values)]
                last += len(part)
                if (part != array.values).any():
                    edits += _edits(file, array, part)
        return _replaced(file, edits)

    vertices = checked(file.path, np.concatenate([array.values for array in points]) if points else [])
    many = [array.values for array in normals]
    return Mesh(
        vertices,
        _space(file, xml),
        rewritten,
        lambda: _parts(file, xml, [len(array.values) for array in points]),
        np.concatenate(many) if many else np.zeros((0, 3)),
        np.concatenate(at) if at else np.zeros(0, np.intp),
    )


def _parts(file: _File, xml: bytes, counts: list[int]) -> list[Part]:
    """Return the cells of all pieces, of so many points each."""
    total, base, kinds = sum(counts), 0, ("Polys", "Lines", "Strips")
    corners: dict[str, list[Ints]] = {kind: [] for kind in kinds}
    many: dict[str, list[Ints]] = {kind: [] for kind in kinds}
    try:
        for piece, count in zip(_PIECE.finditer(xml), counts, strict=True):
            for kind in kinds:
                arrays = dict(_whole(file, piece, kind))
                if {"connectivity", "offsets"} <= set(arrays):
                    corners[kind].append(base + arrays["connectivity"])
                    many[kind].append(np.diff(arrays["offsets"], prepend=0))
            base += count
    except SuppleError:
        raise
    except (binascii.Error, zlib.error, lzma.LZMAError, ValueError, OverflowError) as error:
        raise unreadable(file.path, f"an array is damaged ({error})") from error
    polygons, lines, strips = (
        (np.concatenate(corners[k]), np.concatenate(many[k])) if corners[k] else NO_RUNS for k in kinds
    )
    return [part_of(file.path, total, polygons, lines, strips)]


def _whole(file: _File, piece: re.Match[bytes], section: str) -> Iterator[tuple[str, Ints]]:
    """Yield the names and the whole numbers of the arrays in a section of a piece."""
    for found in _found(file, piece, section):
        known = _attributes(found[2])
        if known.get("type") not in _WHOLE:
            raise unreadable(file.path, f"{section} are not whole numbers")
        dtype, form = file.order + _WHOLE[known["type"]], known.get("format", "ascii")
        inner = (found[4] or b"").lstrip()
        if form == "appended":
            values = file.decode(file.appended + int(known.get("offset", "0")), file.raw)[0]
        elif form == "ascii" or not inner:
            values = np.array([int(token) for token in _KEY.sub(b"", inner).split()], dtype).tobytes()
        else:
            values = file.decode(found.end(4) - len(inner), False)[0]
        yield known.get("Name", ""), np.frombuffer(values, dtype).astype(np.intp)


def _attributes(text: bytes) -> dict[str, str]:
    found = re.findall(r"([\w:]+)\s*=\s*[\"']([^\"']*)[\"']", text.decode("utf-8", "replace"))
    return dict(found)


def _arrays(file: _File, piece: re.Match[bytes], section: str, name: str | None) -> list[_Array]:
    """Return the arrays of vectors in a section of a piece: all, or those of a name."""
    made = []
    for found in _found(file, piece, section):
        known = _attributes(found[2])
        if name is not None and known.get("Name") != name:
            continue
        if known.get("type") not in _TYPES or known.get("NumberOfComponents") != "3":
            raise unreadable(file.path, f"{section} are not three floats each", "save it with Float32 or Float64")
        made.append(_array(file, found, known, file.order + _TYPES[known["type"]]))
    return made


def _found(file: _File, piece: re.Match[bytes], section: str) -> Iterator[re.Match[bytes]]:
    """Return the arrays in a section of a piece."""
    tag = section.encode()
    where = re.search(rb"<%b\b[^>]*>(.*?)</%b\s*>" % (tag, tag), piece[0], re.DOTALL)
    if where is None:
        return iter(())
    return _ARRAY.finditer(file.data, piece.start() + where.start(1), piece.start() + where.end(1))


def _array(file: _File, found: re.Match[bytes], known: dict[str, str], dtype: str) -> _Array:
    form, tag = known.get("format", "ascii"), found.span()
    if form == "appended":
        start = file.appended + int(known.get("offset", "0"))
        values, end, block = file.decode(start, file.raw)
    else:
        inner = _KEY.sub(lambda key: b" " * len(key[0]), found[4] or b"")
        tokens = [match.span() for match in _TOKEN.finditer(inner)]
        if not tokens:
            return _Array(np.zeros((0, 3)), tag, found.start(4), found.start(4), dtype, "ascii", 0)
        start, end = found.start(4) + tokens[0][0], found.start(4) + tokens[-1][1]
        if form == "ascii":
            plain = numbers(file.path, [inner[a:b] for a, b in tokens])
            return _Array(plain.reshape(-1, 3), tag, start, end, dtype, form, 0)
        values, end, block = file.decode(start, False)
    numbers_of = np.frombuffer(values, dtype).reshape(-1, 3).astype(np.float64)
    return _Array(numbers_of, tag, start, end, dtype, form, block)


def _space(file: _File, xml: bytes) -> str:
    """Return what the field SPACE says, which 3D Slicer writes: the codes of its letters."""
    for found in _ARRAY.finditer(xml):
        known = _attributes(found[2])
        if known.get("Name") != "SPACE":
            continue
        if known.get("format") == "appended":
            text = file.decode(file.appended + int(known.get("offset", "0")), file.raw)[0]
        elif known.get("format") == "binary":
            inner = (found[4] or b"").lstrip()
            text = file.decode(found.end(4) - len(inner), False)[0] if inner else b""
        else:
            text = bytes(int(code) for code in (found[4] or b"").split())
        said = text.rstrip(b"\0").decode("latin-1")
        return said if said in ("LPS", "RAS") else ""
    return ""


def _edits(file: _File, array: _Array, new: Floats) -> list[tuple[int, int, bytes]]:
    """Return what replaces the numbers of an array, and the ranges that are noted with it."""
    edits = [(array.start, array.end, array.written(file, new))]
    length = np.linalg.norm(new, axis=1)
    low, high = (f"{value:.17g}".encode() for value in (length.min(), length.max()))
    start, end = array.tag
    inside = start <= array.start < end
    for first, last in ((start, array.start), (array.end, end)) if inside else ((start, end),):
        part = file.data[first:last]
        for name, value in ((b"RangeMin", low), (b"RangeMax", high)):
            edits += [(first + m.start(1), first + m.end(1), value) for m in re.finditer(rb'%b="([^"]*)"' % name, part)]
        for m in _RANGES.finditer(part):
            edits.append((first + m.start(), first + m.end(), m[1] + low + m[2] + high + m[3]))
    return edits


def _replaced(file: _File, edits: list[tuple[int, int, bytes]]) -> bytes:
    """Return the file with edits; where appended arrays change in size, the offsets of those behind follow."""
    shifts = [(start - file.appended, len(new) - (end - start)) for start, end, new in edits if start >= file.appended]
    if any(size for _, size in shifts):
        for found in _OFFSET.finditer(file.data, 0, file.appended):
            old = int(found[2])
            new = old + sum(size for start, size in shifts if start < old)
            if new != old:
                edits.append((*found.span(2), str(new).encode()))
    parts, last = [], 0
    for start, end, made in sorted(edits):
        parts += [file.data[last:start], made]
        last = end
    return b"".join([*parts, file.data[last:]])
