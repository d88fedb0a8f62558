"""Affine maps in text, of FSL's FLIRT (.mat), AFNI (.1D) and FreeSurfer (.lta)."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from supple.media.files import PathLike, head_of, replacing, unreadable, unwritable
from supple.media.transforms import base

SUFFIXES = (".mat", ".txt")
"""The suffixes of FLIRT's files; ITK's transforms use them too."""
_MOST = 1 << 20  # bytes
_VOXELS, _RAS = "0", "1"  # values of "type" in .lta


def read(path: PathLike, grids: base.Grids, *, convention: str) -> tuple[base.Content, ...]:
    """Read an affine map as a pull map; FLIRT's needs the grids of the source and of the reference.

    Files of FLIRT and FreeSurfer hold push maps, from the source to the reference.
    """
    if convention == "afni":
        base.check_plumb(path, grids)
    head = head_of(path, _MOST)
    base.check_text(path, head[: base.TEXT])
    lines = [line for line in (re.sub("#.*", "", line).strip() for line in head.decode().splitlines()) if line]
    if convention == "afni":
        return (_numbers(path, lines, 3),)
    if convention == "freesurfer":
        return (base.check_matrix(path, base.LPS @ base.inverse(_lta(path, lines)) @ base.LPS),)
    matrix = base.inverse(_numbers(path, lines, 4))
    here, there = (base.coordinates("FSL", grids.needed(path, name, convention)) for name in ("source", "reference"))
    return (base.inverse(here) @ matrix @ there,)


def write(
    path: PathLike, contents: Sequence[base.Content], grids: base.Grids, *, convention: str, force: bool = False
) -> None:
    """Write an affine map; FLIRT's and FreeSurfer's need the grids of the source and of the reference."""
    if convention == "afni":
        base.check_plumb(path, grids, "write")
    if convention == "freesurfer" and not os.fspath(path).lower().endswith(".lta"):
        raise unwritable(path, "of FreeSurfer's transforms, only .lta is written", "use .lta, or another convention")
    matrix = base.only_matrix(path, contents, convention)
    if convention == "afni":
        lines = [spelled(matrix[:3])]
    else:
        source, reference = (grids.needed(path, name, convention, "write") for name in ("source", "reference"))
        if convention == "fsl-affine":
            here, there = (base.coordinates("FSL", grid) for grid in (source, reference))
            lines = [spelled(row) for row in there @ base.inverse(matrix) @ base.inverse(here)]
        else:
            lines = [f"type = {_RAS}", "nxforms = 1", "mean = 0 0 0", "sigma = 1", "1 4 4"]
            lines += [spelled(row) for row in base.LPS @ base.inverse(matrix) @ base.LPS]
            for name, grid in (("src", source), ("dst", reference)):
                axes, middle = base.described(grid)
                lines += [f"{name} volume info", "valid = 1", "filename = unknown"]
                lines += [f"volume = {' '.join(map(str, grid.sizes))}", f"voxelsize = {spelled(grid.spacing)}"]
                columns = zip("xyzc", (*axes.T, middle), strict=True)
                lines += [f"{axis}ras = {spelled(column)}" for axis, column in columns]
    with replacing(path, force=force) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")


def spelled(numbers: npt.ArrayLike) -> str:
    """Return numbers as text that reads back exactly."""
    return " ".join(repr(x) for x in np.asarray(numbers, np.float64).ravel().tolist())


def _numbers(path: PathLike, lines: Sequence[str], rows: int) -> base.Matrix:
    made = np.eye(4)
    made[:rows] = np.array(" ".join(lines).split(), np.float64).reshape(rows, 4)
    return base.check_matrix(path, made)


def _lta(path: PathLike, lines: Sequence[str]) -> base.Matrix:
    told = {key: text.strip() for key, _, text in (line.replace(" ", "").partition("=") for line in lines)}
    starts = [i for i, line in enumerate(lines) if re.fullmatch(r"1\s+4\s+4", line)]
    if told.get("nxforms") != "1" or len(starts) != 1:
        what = f"it holds {told.get('nxforms', 'no')} maps"
        raise unreadable(path, what, "give a .lta file of one affine map")
    kind = told.get("type", "")
    if kind not in (_VOXELS, _RAS):
        what = f"it is of type {kind}, and 0 (voxels) and 1 (RAS) are read"
        raise unreadable(path, what, "run lta_convert --inlta and --outlta, which makes type 1")
    matrix = _numbers(path, lines[starts[0] + 1 : starts[0] + 5], 4)
    if kind == _RAS:
        return matrix
    return _volume(lines, "dst") @ matrix @ base.inverse(_volume(lines, "src"))


def _volume(lines: Sequence[str], which: str) -> base.Matrix:
    """Return the matrix from indices to RAS of a volume described in the file; KeyError if it is not."""
    first = next((i for i, line in enumerate(lines) if line.startswith(f"{which} volume info")), len(lines))
    pairs = [line.partition("=") for line in lines[first + 1 : first + 9]]
    told = {key.strip(): text.split() for key, _, text in pairs}
    if told["valid"][:1] != ["1"]:
        raise ValueError(f"its {which} volume is not valid: run lta_convert with --src and --trg")
    sizes, steps, *axes, middle = (
        np.array(told[key], np.float64).reshape(3) for key in ("volume", "voxelsize", "xras", "yras", "zras", "cras")
    )
    return base.centred(sizes, steps, np.stack(axes, axis=1), middle)
