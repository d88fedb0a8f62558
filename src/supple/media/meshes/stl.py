"""STL, as text and binary. Equal corners of facets are one vertex; facets that move get new normals."""

from __future__ import annotations

import re

import numpy as np

from supple.media.files import PathLike, unreadable
from supple.media.meshes import Floats, PointFile, checked, edited, in_rows, in_text, part_of, space_of

_FACET = [("numbers", "<f4", 12), ("attribute", "<u2")]  # a normal and three vertices
_HEAD = 84
_NUMBER = rb"[-+.\w]+"
_TRIPLE = re.compile(rb"\b(normal|vertex)[ \t]+(%b)[ \t]+(%b)[ \t]+(%b)" % ((_NUMBER,) * 3), re.IGNORECASE)


def parsed(path: PathLike, data: bytes) -> PointFile:
    """Return the distinct vertices of an STL file."""
    count = int.from_bytes(data[80:_HEAD], "little")
    size = _HEAD + count * np.dtype(_FACET).itemsize
    text = data.lstrip()[:5].lower() == b"solid"
    binary = len(data) >= _HEAD and (len(data) == size or (len(data) > size and not text))
    if binary:
        facets, head = in_rows(data, _HEAD, count, _FACET, ["numbers"]), data[:80]
    elif text:
        found = list(_TRIPLE.finditer(data))
        words = "".join(chr(match[1][0] | 32) for match in found)  # in lower case
        if words != "nvvv" * (len(words) // 4):
            raise unreadable(path, "its facets are not a normal and three vertices each")
        if len(found) and not re.search(rb"endsolid\b[^\n]*\s*\Z", data, re.IGNORECASE):
            raise unreadable(path, "its end is missing")
        spans = [match.span(k) for match in found for k in (2, 3, 4)]
        facets, head = in_text(data, spans, 12), data.partition(b"\n")[0]
    else:
        raise unreadable(path, f"its {len(data)} bytes are not the {size} of {count} facets")
    before = facets.values
    points, which = _distinct(checked(path, before[:, 3:]))

    def rewritten(moved: Floats, _: Floats) -> bytes:
        made = before.copy()
        made[:, 3:] = (moved.astype(np.float32) if binary else moved)[which].reshape(-1, 9)
        turned = (made != before).any(axis=1)
        first, second, third = np.split(made[turned, 3:], 3, axis=1)
        across = np.cross(second - first, third - first)
        length = np.linalg.norm(across, axis=1, keepdims=True)
        made[turned, :3] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
        return edited(data, facets.edits(made))

    runs = which, np.full(len(which) // 3, 3)
    return PointFile(points, space_of(head), rewritten, lambda: [part_of(len(points), runs)])


def _distinct(corners: Floats) -> tuple[Floats, np.typing.NDArray[np.intp]]:
    """Return the distinct corners (N, 3), and for each corner its index among these."""
    rows = np.ascontiguousarray(corners).view(np.dtype((np.void, 24))).ravel()
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(first)  # in the order of the file
    return corners[first[order]], np.argsort(order)[which.ravel()]
