"""STL, as text and binary. Vertices that several facets share are one; facets that move get new normals."""

from __future__ import annotations

import re

import numpy as np

from supple.media.files import PathLike, unreadable
from supple.media.meshes.base import NUMBER, Floats, Mesh, checked, numbers, space_of, spliced
from supple.media.meshes.cells import Part, part_of

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84
_TRIPLE = re.compile(rb"\b(normal|vertex)[ \t]+(%b)[ \t]+(%b)[ \t]+(%b)" % (NUMBER, NUMBER, NUMBER), re.IGNORECASE)


def parsed(path: PathLike, data: bytes) -> Mesh:
    """Return the vertices of an STL file, each once."""
    count = int.from_bytes(data[80:_HEAD], "little")
    size = _HEAD + count * _FACET.itemsize
    if len(data) >= _HEAD and (len(data) == size or (len(data) > size and not data.lstrip().startswith(b"solid"))):
        return _binary(path, data, count)
    if not data.lstrip()[:5].lower() == b"solid":
        raise unreadable(path, f"its {len(data)} bytes are not the {size} of {count} facets")
    return _text(path, data)


def _binary(path: PathLike, data: bytes, count: int) -> Mesh:
    facets = np.frombuffer(data, _FACET, count, _HEAD)
    corners = facets["corners"].reshape(-1, 3)
    points, which = _distinct(checked(path, corners))

    def rewritten(moved: Floats, _: Floats) -> bytes:
        made = facets.copy()
        triangles = moved.astype(np.float32)[which].reshape(-1, 3, 3)
        turned = (triangles != facets["corners"]).any(axis=(1, 2))
        made["corners"], made["normal"][turned] = triangles, _normals(triangles[turned].astype(np.float64))
        return data[:_HEAD] + made.tobytes() + data[_HEAD + made.nbytes :]

    return Mesh(points, space_of(data[:80]), rewritten, lambda: _parts(path, points, which))


def _text(path: PathLike, data: bytes) -> Mesh:
    found = list(_TRIPLE.finditer(data))
    words = "".join(chr(match[1][0] | 32) for match in found)  # in small letters
    if words != "nvvv" * (len(words) // 4):
        raise unreadable(path, "its facets are not a normal and three vertices each")
    if len(found) and not re.search(rb"endsolid\b[^\n]*\s*\Z", data, re.IGNORECASE):
        raise unreadable(path, "its end is missing")
    spans = [match.span(k) for match in found for k in (2, 3, 4)]
    before = numbers(path, [data[start:end] for start, end in spans]).reshape(-1, 4, 3)
    points, which = _distinct(checked(path, before[:, 1:]))

    def rewritten(moved: Floats, _: Floats) -> bytes:
        made = before.copy()
        made[:, 1:] = moved[which].reshape(-1, 3, 3)
        turned = (made != before).any(axis=(1, 2))
        made[turned, 0] = _normals(made[turned, 1:])
        return spliced(data, spans, before, made)

    return Mesh(points, space_of(data.partition(b"\n")[0]), rewritten, lambda: _parts(path, points, which))


def _parts(path: PathLike, points: Floats, which: np.typing.NDArray[np.intp]) -> list[Part]:
    return [part_of(path, len(points), (which, np.full(len(which) // 3, 3)))]


def _distinct(corners: Floats) -> tuple[Floats, np.typing.NDArray[np.intp]]:
    """Return the different corners (N, 3), and for each corner which of these it is."""
    rows = np.ascontiguousarray(corners).view(np.dtype((np.void, 24))).ravel()
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they come in the file
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return corners[first[order]], place[which.ravel()]


def _normals(triangles: Floats) -> Floats:
    """Return the unit normals of triangles (N, 3, 3), by the right hand; 0 for those without area."""
    made = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(made, axis=1, keepdims=True)
    return np.asarray(np.divide(made, length, out=np.zeros_like(made), where=length > 0))
