"""Fields in millimetres in RAS, of MRtrix, NiftyReg and SPM: positions or displacements in NIfTI, or in MRtrix' .mif.

Fields of NiftyReg and SPM name themselves in their headers: they have the intent code of ITK's (1007), those of SPM's
Segment none, and hold something else.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from supple.media.files import PathLike, head_of, unreadable
from supple.media.transforms.base import (
    DISPLACEMENTS,
    LPS,
    NIFTYREG,
    SPM,
    VECTOR,
    Array,
    Content,
    Displacements,
    Grids,
    announced,
    check_finite,
    check_intent,
    matrix_grid,
    moved,
    only_field,
    opened,
    read_nifti,
    suffix_of,
    vectors_of,
    write_nifti,
)
from supple.media.volume.data import native, reading

_MIF = (".mif", ".mif.gz")
_CONVERT = "run mrconvert, and give its .nii.gz"
_CHUNK = 1 << 16
_MARKED = "MRtrix marks so what lies outside the input: crop the warp, or fill these voxels"
_OUTSIDE = "such voxels lie outside the input: crop the field, or fill them"


class _Kind(NamedTuple):
    """What a convention holds, the intent codes that are read, what to do about NaN, and what is written."""

    absolute: bool
    codes: tuple[int, ...]
    gaps: str
    written: dict[str, Any]


_KINDS = {
    "mrtrix": _Kind(True, (0,), _MARKED, {"axes": 4}),
    "mrtrix-displacement": _Kind(False, (0,), _MARKED, {"axes": 4}),
    "niftyreg": _Kind(True, (VECTOR,), _OUTSIDE, {"axes": 5, "intent": VECTOR, "name": NIFTYREG}),
    "spm-deformation": _Kind(True, (0, VECTOR), _OUTSIDE, {"axes": 5, "intent": VECTOR, "name": SPM}),
}


def read(path: PathLike, grids: Grids, *, convention: str) -> tuple[Content, ...]:
    """Read a field of positions or displacements."""
    absolute, codes, gaps, _ = _KINDS[convention]
    if convention.startswith("mrtrix") and suffix_of(path, _MIF) in _MIF:
        values, matrix = _mif(path)
        grid = matrix_grid(path, matrix, values.shape[2::-1])
    else:
        volume = read_nifti(path, convention)
        check_intent(path, volume, convention, codes)
        if convention == "niftyreg":  # which says what it holds
            if announced(path, volume.header) != convention:
                what = f"its header does not say that it is of {convention}"
                raise unreadable(path, what, "give the convention that it has")
            absolute = int(volume.header["intent_p1"]) != DISPLACEMENTS
        values, grid = vectors_of(path, volume)
    check_finite(path, values, gaps)
    made = moved(values, grid, None, LPS, np.eye(4) if absolute else None)
    return (Displacements(made, grid, beyond="edge"),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, convention: str, force: bool = False) -> None:
    """Write a field as NIfTI: of positions, unless the convention is one of displacements."""
    known, field = _KINDS[convention], only_field(path, contents, convention)
    made = moved(field.values, field.grid, np.eye(4) if known.absolute else None, LPS)
    write_nifti(path, made, field.grid, **known.written, force=force)


def _mif(path: PathLike) -> tuple[Array, Array]:
    """Return the vectors of a .mif file, and the matrix from its indices to RAS."""
    head = head_of(path, 2)
    with reading(path), opened(path, head) as file:
        start = file.read(_CHUNK)
        if not start.startswith(b"mrtrix image"):
            raise unreadable(path, "it is no .mif file of MRtrix", "check its name")
        header, end, _ = start.partition(b"\nEND")
        pairs = re.findall(r"(?m)^([\w ]+?):[ \t]*(.*?)[ \t]*$", header.decode("utf-8", "replace"))
        told: dict[str, list[str]] = {}
        for key, text in pairs:
            told.setdefault(key.lower(), []).append(text)
        try:
            sizes = [int(x) for x in told["dim"][0].split(",")]
            steps = np.array([float(x) for x in told["vox"][0].split(",")[:3]])
            layout = told["layout"][0].split(",")
            order = [int(x[1:]) for x in layout]
            matrix = np.array([[float(x) for x in line.split(",")] for line in told["transform"]])
            name, _, offset = told["file"][0].partition(" ")
            begin = int(offset or 0)
            if not end or matrix.shape != (3, 4) or sorted(order) != list(range(len(sizes))):
                raise ValueError
        except (KeyError, ValueError, IndexError) as error:
            raise unreadable(path, "its header is damaged, or of another version", _CONVERT) from error
        dtype = _dtype(path, told.get("datatype", [""])[0])
        if "scaling" in told or name != ".":
            what = "its values are scaled" if "scaling" in told else "its voxels are in another file"
            raise unreadable(path, what, _CONVERT)
        if len(sizes) != 4 or sizes[3] != 3:
            what = f"it holds {' x '.join(map(str, sizes))} values, and a warp has x, y, z and three volumes"
            how = "run warpconvert with warpfull2deformation" if len(sizes) == 5 else "give a warp"
            raise unreadable(path, what, how)
        file.seek(begin)
        wanted = dtype.itemsize * int(np.prod(sizes))
        data = file.read(wanted)
    if len(data) < wanted:
        raise unreadable(path, f"its header promises {wanted} bytes of voxels, and it has {len(data)}")
    # axes in the order of the file, the fastest last; then x, y, z and component, each forwards
    kept = sorted(range(4), key=lambda axis: -order[axis])
    whole = np.frombuffer(data, dtype).reshape([sizes[axis] for axis in kept])
    whole = whole.transpose([kept.index(axis) for axis in (2, 1, 0, 3)])
    backwards = [layout[axis].startswith("-") for axis in (2, 1, 0, 3)]
    whole = whole[tuple(slice(None, None, -1 if back else 1) for back in backwards)]
    full = np.eye(4)
    full[:3, :3] = matrix[:, :3] * steps
    full[:3, 3] = matrix[:, 3]
    return native(whole), full


def _dtype(path: PathLike, told: str) -> np.dtype[np.floating]:
    known = re.fullmatch(r"float(32|64)(le|be)?", told.lower())
    if known is None:
        raise unreadable(path, f"its voxels are {told or 'of no type'}, and those of a warp are Float32", _CONVERT)
    order = {"le": "<", "be": ">", None: "="}[known[2]]
    return np.dtype(f"{order}f{int(known[1]) // 8}")
