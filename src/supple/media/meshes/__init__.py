"""Meshes and contours in files: their points and normals, and a copy with others in which every other byte is kept.

Libraries read these formats, but what they do not know is lost when they write (test_what_libraries_lose): objects
and groups of OBJ, properties of PLY, colours of STL. So only the numbers that move are found here, and replaced.
Structure sets of DICOM are written by pydicom.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from supple.media.files import PathLike, head_of
from supple.media.meshes.base import Mesh
from supple.media.volume import Volume

KINDS = {".stl": "STL", ".obj": "OBJ", ".ply": "PLY", ".vtk": "VTK", ".vtp": "VTP", ".dcm": "RTSTRUCT"}
"""Kinds of files by their suffix."""


def read_mesh(path: PathLike, kind: str, series: Volume | None = None) -> Mesh:
    """Read a file of one of the `KINDS`; SuppleError if it cannot be read, is damaged, or is none of them.

    With a ``series`` of DICOM, a structure set that is written refers to it.
    """
    parsed: Callable[..., Mesh] = import_module(f"supple.media.meshes.{kind.lower()}").parsed
    return parsed(path, head_of(path, -1, "give a file of a mesh"), **({} if series is None else {"series": series}))
