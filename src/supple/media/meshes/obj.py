"""Wavefront OBJ: materials, groups, colours and texture coordinates stay in the text."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, unreadable
from supple.media.meshes.base import Floats, Mesh, checked, numbers, space_of, spliced
from supple.media.meshes.cells import Part, joined, part_of

# A line, and those that continue it, without a comment at its end.
_STATEMENT = re.compile(rb"((?:[^\r\n#\\]+|\\(?:\r\n?|\n)?)*)(?:#[^\r\n]*)?(?:\r\n?|\n|\Z)")
_CONTINUED = re.compile(rb"\\(?:\r\n?|\n)")
_WORD = re.compile(rb"[ \t]*(v|vn|f|l|p|curv|curv2|surf|cstype)[ \t]")
_TOKEN = re.compile(rb"\S+")
_ZERO = re.compile(rb"[\s/]0+(?![^\s/])")


def parsed(path: PathLike, data: bytes) -> Mesh:
    """Return the vertices of an OBJ file, and for each normal those at which faces have it."""
    spans: dict[bytes, list[tuple[int, int]]] = {b"v": [], b"vn": []}
    pairs: dict[tuple[int, int], None] = {}

    def refused(start: int, what: str) -> SuppleError:
        return _refused(path, data, start, what)

    for start, line in _statements(data):
        word = known[1] if (known := _WORD.match(line)) else b""
        if word in spans:
            tokens = [match.span() for match in _TOKEN.finditer(line)][1:4]
            if len(tokens) < 3:
                raise refused(start, "a vertex or normal has fewer than three numbers")
            spans[word] += [(start + a, start + b) for a, b in tokens]
        elif word in (b"f", b"l", b"p") and _ZERO.search(line):
            raise refused(start, "an index is 0, and the first one is 1")
        elif word == b"f" and b"/" in line:
            counts = len(spans[b"v"]) // 3, len(spans[b"vn"]) // 3
            for corner in line.split()[1:]:
                parts = corner.split(b"/")
                if len(parts) == 3 and parts[2]:
                    try:
                        v, n = int(parts[0]), int(parts[2])
                    except ValueError:
                        raise refused(start, f"{shown(corner.decode(errors='replace'))} is no corner") from None
                    # counted from 1, or backwards from the last so far
                    pairs[n - 1 if n > 0 else n + counts[1], v - 1 if v > 0 else v + counts[0]] = None
        elif word not in (b"", b"f", b"l", b"p"):
            raise refused(start, "it has free-form curves or surfaces: save it as polygons")
    points, normals = (numbers(path, [data[a:b] for a, b in spans[word]]).reshape(-1, 3) for word in (b"v", b"vn"))
    points = checked(path, points)
    which, at = np.array(sorted(pairs), np.intp).reshape(-1, 2).T
    for ids, many, what in ((which, len(normals), "normal"), (at, len(points), "vertex")):
        wrong = ids[(ids < 0) | (ids >= many)]
        if len(wrong):
            raise unreadable(path, f"a face has {what} {wrong[0] + 1} of {many}")

    def rewritten(moved: Floats, turned: Floats) -> bytes:
        changed = (turned != normals[which]).any(axis=1)
        # of a normal that several vertices share, the mean of theirs
        sums, after = np.zeros_like(normals), normals.copy()
        np.add.at(sums, which, turned)
        length = np.linalg.norm(sums, axis=1)
        new = np.unique(which[changed])
        new = new[length[new] > 0]
        after[new] = sums[new] * (np.linalg.norm(normals[new], axis=1) / length[new])[:, None]
        every = sorted(
            zip(
                [*spans[b"v"], *spans[b"vn"]],
                np.concatenate([points, normals]).ravel().tolist(),
                np.concatenate([moved, after]).ravel().tolist(),
                strict=True,
            )
        )
        places, old, values = zip(*every, strict=True)
        return spliced(data, places, np.array(old), np.array(values))

    comments = re.match(rb"(?:\s*#[^\n]*\n)*", data)
    said = space_of(comments[0] if comments else b"")
    return Mesh(points, said, rewritten, lambda: _parts(path, data, len(points)), normals[which], at)


def _statements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield where statements start, and each in one line, as long as it is over several."""
    for found in _STATEMENT.finditer(data):
        yield found.start(), _CONTINUED.sub(lambda end: b" " * len(end[0]), found[1])


def _refused(path: PathLike, data: bytes, start: int, what: str) -> SuppleError:
    return unreadable(path, f"line {len(data[:start].splitlines()) + 1}: {what}")


def _parts(path: PathLike, data: bytes, count: int) -> list[Part]:
    runs: dict[bytes, list[list[int]]] = {b"f": [], b"l": []}
    for word, corners in _runs(path, data):
        runs[word].append(corners)
    return [part_of(path, count, joined(runs[b"f"]), joined(runs[b"l"]))]


def _runs(path: PathLike, data: bytes) -> Iterator[tuple[bytes, list[int]]]:
    """Yield the corners of faces and lines."""
    vertices = 0
    for start, line in _statements(data):
        match line.split():
            case [b"v", *_]:
                vertices += 1
            case [b"f" | b"l" as word, *corners]:
                try:
                    known = [int(corner.partition(b"/")[0]) for corner in corners]
                except ValueError:
                    raise _refused(path, data, start, "a corner is no number") from None
                yield word, [v - 1 if v > 0 else v + vertices for v in known]
