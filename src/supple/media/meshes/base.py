"""What is read from a mesh, and how numbers are replaced in text."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.media.files import PathLike, unreadable
from supple.media.meshes.cells import Ints, Part
from supple.space.domain import LARGEST

Floats = npt.NDArray[np.float64]
Spans = Sequence[tuple[int, int]]

_SPACE = re.compile(rb"SPACE\s*=\s*(LPS|RAS)\b")
NUMBER = rb"[-+.\w]+"


def _none() -> Floats:
    return np.zeros((0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """The vertices of a mesh, and its normals.

    Parameters
    ----------
    points : float64 array, shape (N, 3)
        The vertices, in the order of the file.
    convention : str
        ``"LPS"`` or ``"RAS"`` if the file says it, as those of 3D Slicer do; otherwise empty.
    rewritten : callable
        Return the bytes of the file with other points, shape (N, 3), and normals, shape (M, 3).
    parts : callable
        Return what joins the points, which is read only then. SuppleError if it is damaged.
    normals : float64 array, shape (M, 3)
        Normals at vertices. Those of facets, which follow from the vertices, are not among them.
    at : int array, shape (M,)
        The vertex of each normal.
    """

    points: Floats
    convention: str
    rewritten: Callable[[Floats, Floats], bytes]
    parts: Callable[[], list[Part]]
    normals: Floats = field(default_factory=_none)
    at: Ints = field(default_factory=lambda: np.zeros(0, np.intp))


def space_of(head: bytes) -> str:
    """Return the convention that a header says as 3D Slicer does, ``SPACE=LPS``, or nothing."""
    found = _SPACE.search(head)
    return found[1].decode() if found else ""


def checked(path: PathLike, points: npt.ArrayLike) -> Floats:
    """Return vertices (N, 3) as float64; SuppleError if there are none, or one is not finite."""
    made = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(made):
        raise unreadable(path, "it holds no vertices", "give a mesh")
    wrong = np.flatnonzero(~(np.abs(made) <= LARGEST).all(axis=1))
    if len(wrong):
        found = f"vertex {wrong[0] + 1} is ({', '.join(f'{x:g}' for x in made[wrong[0]])})"
        raise unreadable(path, found, f"a coordinate is a number from {-LARGEST:g} to {LARGEST:g}")
    return made


def numbers(path: PathLike, tokens: Sequence[Any]) -> Floats:
    """Return the numbers of tokens of text; SuppleError for one that is none."""
    try:
        return np.array([float(token) for token in tokens])
    except ValueError as error:
        raise unreadable(path, f"{str(error).rpartition(': ')[2].removeprefix('b')} is no number") from error


def spliced(data: bytes, spans: Spans, before: Floats, after: Floats) -> bytes:
    """Return text in which the numbers at spans, in order, are replaced where they have changed."""
    old, new = before.ravel(), after.ravel()
    parts, last = [], 0
    for k in np.flatnonzero(old != new).tolist():
        start, end = spans[k]
        parts += [data[last:start], repr(float(new[k])).encode()]
        last = end
    return b"".join([*parts, data[last:]])
