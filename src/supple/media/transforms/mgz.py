"""Warps of FreeSurfer in .mgz and .mgh files, as mri_warp_convert writes them.

On the voxels of the destination (output), they hold coordinates of the source (input), or the differences to them: in
voxels, or in RAS. The grids of both images lie in tags behind the voxels.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from supple.media.files import PathLike, head_of, unreadable
from supple.media.transforms.base import (
    LPS,
    Array,
    Displacements,
    Matrix,
    check_count,
    check_finite,
    inverse,
    matrix_grid,
    moved,
    opened,
    to_ras,
)
from supple.media.volume.data import native, reading, too_large
from supple.space.geometry import Grid

SUFFIXES = (".mgz", ".mgh")
_HEADER = 284
_FLOAT = 3
_SCAN = 20  # bytes of scan parameters behind the voxels
_GEOMETRY, _SHEARED, _FORMAT = 10, 15, 13
_UNSIZED = {1: "a table of colours", 2: "old coordinates", 11: "labels", 12: "labels", 20: "a surface", 30: "a matrix"}
_PLACE, _SHEAR, _NAME = 76, 12, 512  # bytes of the place of a volume, of its shear, of the name of its file
_ADVICE = "run mri_warp_convert with --outitk, and read that"
_LEAN = 1e-4  # the largest shear by rounding
_FORMATS = ("positions in voxels", "displacements in voxels", "positions in RAS", "displacements in RAS")


def read(path: PathLike) -> Displacements:
    """Read a warp."""
    values, tags = _parts(path)
    places = _tagged(path, tags)
    if places is None:
        raise unreadable(path, "it does not say between which images it leads, as a warp does", _ADVICE)
    source, grid, form = places
    if form not in range(len(_FORMATS)):
        raise unreadable(path, f"it is of format {form}, and {len(_FORMATS)} formats are known", _ADVICE)
    if grid.shape != values.shape[:3]:
        sizes = [" x ".join(map(str, sizes)) for sizes in (values.shape[2::-1], grid.sizes)]
        raise unreadable(path, f"it has {sizes[0]} voxels, and the image that it is of has {sizes[1]}", _ADVICE)
    check_finite(path, values, "give a field that is finite everywhere")
    if form == 2:
        made = moved(values, grid, None, LPS, np.eye(4))
    elif form == 3:
        made = moved(values, grid, None, LPS)
    else:
        made = moved(values, grid, inverse(grid.matrix) if form == 1 else None, source.matrix, np.eye(4))
    return Displacements(made, grid, beyond="edge")


def _parts(path: PathLike) -> tuple[Array, bytes]:
    """Return the vectors of a file, and its tags."""
    head = head_of(path, 2)
    with reading(path), opened(path, head) as file:
        start = file.read(_HEADER)
        if len(start) < _HEADER or struct.unpack_from(">i", start)[0] & 0xFF != 1:
            raise unreadable(path, "it is no .mgz or .mgh file", "check its name")
        width, height, depth, frames, kind = struct.unpack_from(">5i", start, 4)
        if min(width, height, depth, frames) < 1:
            raise unreadable(path, f"its header says {width} x {height} x {depth} voxels", "correct its header")
        check_count(path, frames)
        if kind != _FLOAT:
            raise unreadable(path, f"its voxels are of type {kind}, and those of a warp are floats (3)", _ADVICE)
        wanted = 4 * width * height * depth * frames
        try:
            data = file.read(wanted)
        except OverflowError as error:
            raise too_large(path, (width, height, depth)) from error
        rest = file.read()
    if len(data) < wanted:
        raise unreadable(path, f"its header promises {wanted} bytes of voxels, and it has {len(data)}")
    values = np.frombuffer(data, ">f4").reshape(frames, depth, height, width)
    return native(np.moveaxis(values, 0, -1)), rest[_SCAN:]


def _tagged(path: PathLike, tags: bytes) -> tuple[Grid, Grid, int] | None:
    """Return the grids of the source and of the destination, and the format; None if a tag is missing."""
    found: dict[int, Any] = {}
    at = 0
    try:
        while at + 4 <= len(tags):
            (tag,) = struct.unpack_from(">i", tags, at)
            at += 4
            if tag == 0:
                break
            if tag in _UNSIZED:
                raise unreadable(path, f"it holds {_UNSIZED[tag]} (tag {tag}), which no warp does", _ADVICE)
            each = _PLACE + (_SHEAR if tag == _SHEARED else 0) + _NAME
            size = 2 * each
            if tag != _GEOMETRY:
                (size,) = struct.unpack_from(">q", tags, at)
                at += 8
            if tag in (_GEOMETRY, _SHEARED):
                found[_GEOMETRY] = [_place(path, tags, start, sheared=tag == _SHEARED) for start in (at, at + each)]
            elif tag == _FORMAT:
                (found[tag],) = struct.unpack_from(">i", tags, at)
            if size < 0:
                raise struct.error
            at += size
    except struct.error as error:
        raise unreadable(path, "what follows its voxels is cut short or damaged") from error
    if _GEOMETRY not in found or _FORMAT not in found:
        return None
    source, grid = found[_GEOMETRY]
    return source, grid, found[_FORMAT]


def _place(path: PathLike, tags: bytes, at: int, *, sheared: bool) -> Grid:
    """Return the grid of an image that a tag describes."""
    valid, *sizes = struct.unpack_from(">4i", tags, at)
    numbers = np.array(struct.unpack_from(">15f", tags, at + 16))
    if not valid or min(sizes) < 1:
        raise unreadable(path, "the place of an image that it belongs to is not valid", _ADVICE)
    if sheared and np.abs(struct.unpack_from(">3f", tags, at + _PLACE)).max() > _LEAN:
        raise unreadable(path, "the axes of an image that it belongs to are not at right angles", "resample it first")
    return matrix_grid(path, centred(sizes, numbers[:3], numbers[3:12].reshape(3, 3).T, numbers[12:]), sizes)


def centred(sizes: Any, steps: Array, axes: Array, middle: Array) -> Matrix:
    """Return the matrix from indices to RAS of an image, as FreeSurfer describes it: by the position of its middle."""
    made = np.eye(4)
    made[:3, :3] = axes * steps
    made[:3, 3] = middle - made[:3, :3] @ (np.asarray(sizes) / 2)
    return made


def described(grid: Grid) -> tuple[Matrix, Array]:
    """Return the axes of an image in RAS, as columns, and the position of its middle."""
    matrix = to_ras(grid.matrix)
    return matrix[:3, :3] / grid.spacing, matrix[:3, :3] @ (np.array(grid.sizes) / 2) + matrix[:3, 3]
