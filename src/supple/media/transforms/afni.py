"""Warps and affine maps of AFNI: from the base (output) to the source (input), in millimetres in LPS.

AFNI counts in coordinates that leave out how a grid is turned (its "cardinal" ones), so that a warp on an oblique grid
means nothing without AFNI's own rules for both images: such grids are refused. Beyond its grid, AFNI continues a warp
with the mean slope at its faces; here, it keeps the displacement of the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, head_of, unreadable, unwritable
from supple.media.transforms.base import (
    VECTOR,
    Array,
    Content,
    Displacements,
    Grids,
    check_finite,
    check_intent,
    lines_of,
    matrix_grid,
    numbers_of,
    only_field,
    only_matrix,
    read_nifti,
    spelled,
    suffix_of,
    vectors_of,
    write_nifti,
    write_text,
)
from supple.media.volume import nifti
from supple.media.volume.data import native, reading
from supple.space.geometry import Geometry, Grid

MATRICES = (".aff12.1d", ".1d")
DATASETS = (".head", ".brik", ".brik.gz")
_LABELS = ["x_delta", "y_delta", "z_delta"]  # some warps hold other volumes after these
_CARDINAL = "make it and the images plumb by 3dWarp -deoblique, and find the warp anew"


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read a matrix (.1D) or a warp of AFNI (NIfTI, or .HEAD and .BRIK)."""
    if grids.source is not None:
        _check_cardinal(path, grids.source, "the input (moving) image")
    suffix = suffix_of(path, MATRICES + DATASETS)
    if suffix in MATRICES:
        if grids.reference is not None:
            _check_cardinal(path, grids.reference, "the output (fixed) image")
        lines = lines_of(path, "a matrix of AFNI")
        return (numbers_of(path, lines, (3, 4), "matrix of AFNI"),)
    if suffix in DATASETS:
        values, grid = _dataset(path)
    else:
        volume = read_nifti(path, "afni")
        check_intent(path, volume, "afni", (0, VECTOR))  # the latter of a field that another program has copied
        values, grid = vectors_of(path, volume)
    _check_cardinal(path, grid, "its grid")
    check_finite(path, values, "give a field that is finite everywhere")
    return (Displacements(values, grid, beyond="edge"),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a matrix (.aff12.1D) or a warp (NIfTI) of AFNI."""
    known = {"the input (moving) image": grids.source, "the output (fixed) image": grids.reference}
    for whose, grid in known.items():
        if grid is not None:
            _check_cardinal(path, grid, whose, "write")
    suffix = suffix_of(path, MATRICES + DATASETS)
    if suffix in DATASETS:
        raise unwritable(path, "AFNI's own datasets are only read", "write .nii.gz, which AFNI reads")
    if suffix in MATRICES:
        matrix = only_matrix(path, contents, "a .1D file of AFNI")
        write_text(path, f"{spelled(matrix[:3])}\n", force=force)
        return
    field = only_field(path, contents, "afni")
    _check_cardinal(path, field.grid, "the field's grid", "write")
    write_nifti(path, field.values, field.grid, axes=5, force=force)


def _check_cardinal(path: PathLike, grid: Grid, whose: str, verb: str = "read") -> None:
    """Raise SuppleError for an oblique grid."""
    x, y, z = grid.spacing
    degrees = Geometry((x, y, z), (0, 0, 0), np.array(grid.direction), "LPS").oblique
    if degrees:
        raise SuppleError(
            f"cannot {verb} {shown(path)}: {whose} is oblique by {degrees:.3g} degrees, which AFNI leaves out of its "
            f"coordinates: {_CARDINAL}"
        )


def _dataset(path: PathLike) -> tuple[Array, Grid]:
    """Return the vectors of a .HEAD and .BRIK dataset, and their grid."""
    nibabel = nifti.imported()
    head_of(path, 4)
    with reading(path):
        try:
            image: Any = nibabel.load(path)
            affine, data = image.affine, np.asarray(image.dataobj)
        except (nibabel.filebasedimages.ImageFileError, KeyError, ValueError, IndexError, OSError) as error:
            raise unreadable(path, "it is no dataset of AFNI, or damaged or without its .HEAD or .BRIK") from error
    labels = str(image.header.info.get("BRICK_LABS", "")).split("~")[:3]
    count = data.shape[3] if data.ndim == 4 else 1
    if count < 3 or (count > 3 and labels != _LABELS) or data.dtype.kind != "f":
        told = f"{data.dtype} of {' x '.join(map(str, data.shape))}"
        raise unreadable(path, f"it holds {told}", f"give a warp, whose sub-bricks are {', '.join(_LABELS)}")
    values = native(data[..., :3].transpose(2, 1, 0, 3))
    return values, matrix_grid(path, affine, data.shape[:3])
