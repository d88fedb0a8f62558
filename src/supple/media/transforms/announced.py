"""Fields of NiftyReg and SPM: NIfTI files whose headers name what they hold, in millimetres in RAS.

Both have the intent code of ITK's fields (1007), those of SPM's Segment none, and neither holds what ITK takes it for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from supple.media.files import PathLike, unreadable
from supple.media.transforms.base import (
    DISPLACEMENTS,
    LPS,
    NIFTYREG,
    SPM,
    VECTOR,
    Content,
    Displacements,
    Grids,
    announced,
    check_finite,
    check_intent,
    moved,
    only_field,
    read_nifti,
    vectors_of,
    write_nifti,
)


def read(path: PathLike, grids: Grids, *, convention: str) -> tuple[Content, ...]:
    """Read a deformation or a displacement field of NiftyReg, or a deformation field of SPM."""
    volume = read_nifti(path, convention)
    check_intent(path, volume, convention, (VECTOR,) if convention == "niftyreg" else (0, VECTOR))
    if convention == "niftyreg" and announced(path, volume.header) != convention:  # which says what it holds
        raise unreadable(path, f"its header does not say that it is of {convention}", "give the convention that it has")
    moves = convention == "niftyreg" and int(volume.header["intent_p1"]) == DISPLACEMENTS
    values, grid = vectors_of(path, volume)
    check_finite(path, values, "such voxels lie outside the input: crop the field, or fill them")
    made = moved(values, grid, None, LPS, None if moves else np.eye(4))
    return (Displacements(made, grid, beyond="edge"),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, convention: str, force: bool = False) -> None:
    """Write a field of positions, as NiftyReg or SPM does."""
    field = only_field(path, contents, convention)
    made = moved(field.values, field.grid, np.eye(4), LPS)
    name = NIFTYREG if convention == "niftyreg" else SPM
    write_nifti(path, made, field.grid, axes=5, intent=VECTOR, name=name, force=force)
