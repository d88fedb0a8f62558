"""Wavefront OBJ: materials, groups, colours and texture coordinates are kept."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from supple.errors import SuppleError
from supple.media.files import PathLike, unreadable
from supple.media.meshes import TOKEN, Floats, Part, PointFile, checked, edited, in_text, joined, part_of, space_of

# A line with its continuation lines, without a comment at its end.
_STATEMENT = re.compile(rb"((?:[^\r\n#\\]+|\\(?:\r\n?|\n)?)*)(?:#[^\r\n]*)?(?:\r\n?|\n|\Z)")
_CONTINUED = re.compile(rb"\\(?:\r\n?|\n)")
_WORD = re.compile(rb"[ \t]*(v|vn|f|l|p|curv|curv2|surf|cstype)[ \t]")
_ZERO = re.compile(rb"[\s/]0+(?![^\s/])")


def parsed(path: PathLike, data: bytes) -> PointFile:
    """Return the vertices of an OBJ file, and its normals, once for each vertex at which a face uses them."""
    spans: dict[bytes, list[tuple[int, int]]] = {b"v": [], b"vn": []}
    pairs: dict[tuple[int, int], None] = {}
    for start, line in _statements(data):
        word = found[1] if (found := _WORD.match(line)) else b""
        if word in spans:
            tokens = [match.span() for match in TOKEN.finditer(line)][1:4]
            if len(tokens) < 3:
                raise _refused(path, data, start, "a vertex or normal has fewer than three numbers")
            spans[word] += [(start + a, start + b) for a, b in tokens]
        elif word in (b"f", b"l", b"p") and _ZERO.search(line):
            raise _refused(path, data, start, "an index is 0, and the first one is 1")
        elif word == b"f" and b"/" in line:
            counts = len(spans[b"v"]) // 3, len(spans[b"vn"]) // 3
            for corner in line.split()[1:]:
                parts = corner.split(b"/")
                if len(parts) == 3 and parts[2]:
                    pairs[_index(parts[2], counts[1]), _index(parts[0], counts[0])] = None
        elif word not in (b"", b"f", b"l", b"p"):
            raise _refused(path, data, start, "it has free-form curves or surfaces: save it as polygons")
    vertices, vectors = (in_text(data, spans[word], 3) for word in (b"v", b"vn"))
    points, normals = checked(path, vertices.values), vectors.values
    which, at = np.array(sorted(pairs), np.intp).reshape(-1, 2).T
    if (np.minimum(which, at) < 0).any() or (which >= len(normals)).any() or (at >= len(points)).any():
        raise unreadable(path, f"a face has another normal or vertex than its {len(normals)} and {len(points)}")

    def rewritten(moved: Floats, turned: Floats) -> bytes:
        # a normal that several vertices share becomes the mean of its new values
        sums, after = np.zeros_like(normals), normals.copy()
        np.add.at(sums, which, turned)
        length = np.linalg.norm(sums, axis=1)
        new = np.unique(which[(turned != normals[which]).any(axis=1)])
        new = new[length[new] > 0]
        after[new] = sums[new] * (np.linalg.norm(normals[new], axis=1) / length[new])[:, None]
        return edited(data, [*vertices.edits(moved), *vectors.edits(after)])

    comments = re.match(rb"(?:\s*#[^\n]*\n)*", data)
    said = space_of(comments[0] if comments else b"")
    return PointFile(points, said, rewritten, lambda: _parts(data, len(points)), normals[which], at)


def _statements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the offset of each statement and its text, with continued lines joined, padded to the original length."""
    for found in _STATEMENT.finditer(data):
        yield found.start(), _CONTINUED.sub(lambda end: b" " * len(end[0]), found[1])


def _index(text: bytes, count: int) -> int:
    """Convert an index that counts from 1, or backwards from the latest vertex, to one from 0."""
    number = int(text)
    return number - 1 if number > 0 else number + count


def _refused(path: PathLike, data: bytes, start: int, what: str) -> SuppleError:
    return unreadable(path, f"line {len(data[:start].splitlines()) + 1}: {what}")


def _parts(data: bytes, count: int) -> list[Part]:
    runs: dict[bytes, list[list[int]]] = {b"f": [], b"l": []}
    vertices = 0
    for _, line in _statements(data):
        match line.split():
            case [b"v", *_]:
                vertices += 1
            case [b"f" | b"l" as word, *corners]:
                runs[word].append([_index(corner.partition(b"/")[0], vertices) for corner in corners])
    return [part_of(count, joined(runs[b"f"]), joined(runs[b"l"]))]
