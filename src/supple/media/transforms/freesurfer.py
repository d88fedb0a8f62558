"""Affine maps (.lta) and warps (.mgz) of FreeSurfer; a .m3z is refused, with the command that converts it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from supple.media.files import PathLike, unreadable, unwritable
from supple.media.transforms import mgz
from supple.media.transforms.base import (
    Content,
    Grids,
    Matrix,
    checked,
    inverse,
    lines_of,
    numbers_of,
    only_matrix,
    spelled,
    suffix_of,
    turned,
    write_text,
)
from supple.media.transforms.mgz import centred, described
from supple.space.geometry import Grid

_VOXELS, _RAS = 0, 1
_KINDS = {_VOXELS: "of voxels", _RAS: "of RAS"}
MORPHS = (".m3z", ".m3d")


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read an affine map of FreeSurfer, which leads from the source to the destination, or a warp, which leads back."""
    suffix = suffix_of(path, (*MORPHS, *mgz.SUFFIXES))
    if suffix in mgz.SUFFIXES:
        return (mgz.read(path),)
    if suffix in MORPHS:
        what = f"it is a morph ({suffix}), of which FreeSurfer has the only reader"
        raise unreadable(path, what, "run mri_warp_convert --inm3z with --outitk, and read that")
    lines = lines_of(path, "a .lta file")
    told = {key: text.strip() for key, _, text in (line.replace(" ", "").partition("=") for line in lines)}
    starts = [i for i, line in enumerate(lines) if re.fullmatch(r"1\s+4\s+4", line)]
    if told.get("nxforms") != "1" or len(starts) != 1:
        what = f"it holds {told.get('nxforms', 'no')} maps"
        raise unreadable(path, what, "give a .lta file of one affine map")
    kind = told.get("type", "")
    if kind not in {str(known) for known in _KINDS}:
        what = f"it is of type {kind}, and 0 (voxels) and 1 (RAS) are read"
        raise unreadable(path, what, "run lta_convert --inlta and --outlta, which makes type 1")
    matrix = numbers_of(path, lines[starts[0] + 1 : starts[0] + 5], (4, 4), "map of a .lta file")
    if kind == str(_VOXELS):
        matrix = _volume(path, lines, "dst") @ matrix @ inverse(_volume(path, lines, "src"))
    return (checked(path, turned(inverse(matrix))),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write an affine map of FreeSurfer, of RAS; needs the grids of the source and of the reference."""
    if suffix_of(path, (".lta",)) != ".lta":
        raise unwritable(path, "of FreeSurfer's transforms, only .lta is written", "use .lta, or another convention")
    matrix = only_matrix(path, contents, "a .lta file")
    source = grids.needed(path, "source", "freesurfer", "write")
    reference = grids.needed(path, "reference", "freesurfer", "write")
    lines = [f"type = {_RAS}", "nxforms = 1", "mean = 0 0 0", "sigma = 1", "1 4 4"]
    lines += [spelled(row) for row in turned(inverse(matrix))]
    lines += ["src volume info", *_described(source), "dst volume info", *_described(reference)]
    write_text(path, "\n".join(lines) + "\n", force=force)


def _volume(path: PathLike, lines: Sequence[str], which: str) -> Matrix:
    """Return the matrix from the indices of a volume to RAS, as the file describes it."""
    first = next((i for i, line in enumerate(lines) if line.startswith(f"{which} volume info")), len(lines))
    pairs = [line.partition("=") for line in lines[first + 1 : first + 9]]
    told = {key.strip(): text.split() for key, _, text in pairs}
    try:
        sizes, steps, *axes, middle = (
            np.array([float(x) for x in told[key]]).reshape(3)
            for key in ("volume", "voxelsize", "xras", "yras", "zras", "cras")
        )
        if told["valid"][:1] != ["1"]:
            raise ValueError
    except (KeyError, ValueError) as error:
        what = f"it counts in voxels, and does not say how those of its {which} volume lie"
        raise unreadable(path, what, "run lta_convert with --src and --trg") from error
    return centred(sizes, steps, np.stack(axes, axis=1), middle)


def _described(grid: Grid) -> list[str]:
    axes, middle = described(grid)
    named = [("xras", axes[:, 0]), ("yras", axes[:, 1]), ("zras", axes[:, 2]), ("cras", middle)]
    return [
        "valid = 1",
        "filename = unknown",
        f"volume = {' '.join(map(str, grid.sizes))}",
        f"voxelsize = {spelled(grid.spacing)}",
        *(f"{name} = {spelled(numbers)}" for name, numbers in named),
    ]
