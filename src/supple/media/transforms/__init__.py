"""Files of displacement fields and affine maps, in the conventions of the programs that use them.

All hold pull maps: of a point of the output, the point of the input that is seen there. In memory, positions and
displacements of volumes are in millimetres in LPS, those of pictures in pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

from supple.media.files import PathLike, unreadable
from supple.media.transforms.base import Content, Displacements, Grids, MissingGridError
from supple.media.transforms.conventions import (
    CONVENTIONS,
    PULL,
    Convention,
    check_convention,
    convention_in,
    convention_of,
    form_of,
)
from supple.media.transforms.itk import SUFFIXES_OUT, check_target, write_field
from supple.space.geometry import Grid

__all__ = [
    "CONVENTIONS",
    "PULL",
    "SUFFIXES_OUT",
    "Content",
    "Convention",
    "Displacements",
    "MissingGridError",
    "check_convention",
    "check_target",
    "convention_in",
    "convention_of",
    "read",
    "write",
    "write_field",
]


def read(
    path: PathLike, convention: str | None = None, *, source: Grid | None = None, reference: Grid | None = None
) -> tuple[Content, ...]:
    """Read the maps of a file.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    convention : str, optional
        One of `CONVENTIONS`; by default, what the name and the content of the file leave no doubt about.
    source : Grid, optional
        The grid of the input (moving) image, which FSL counts in.
    reference : Grid, optional
        The grid of the output (fixed) image, which affine maps of FSL count in.

    Returns
    -------
    tuple of Content
        Matrices and fields, to apply in order to a point of the output.

    Raises
    ------
    SuppleError
        If the convention is unknown or in doubt, a grid that it needs is not given, or the file holds no such map.
    """
    name = convention_in(path) if convention is None else convention
    contents = form_of(path, name).read(path, Grids(source, reference))
    if any(isinstance(each, Displacements) and each.grid.shear for each in contents):
        raise unreadable(path, "the axes of its grid are not at right angles to each other", "resample it first")
    return contents


def write(
    path: PathLike,
    contents: Sequence[Content],
    convention: str | None = None,
    *,
    source: Grid | None = None,
    reference: Grid | None = None,
    force: bool = False,
) -> None:
    """Write maps to a file, which appears whole or not at all.

    What a field does beyond its grid is not written: the program that reads it decides.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    contents : sequence of Content
        Matrices and fields, to apply in order to a point of the output. Only ``.h5``, ``.tfm`` and ``.zarr`` hold more
        than one.
    convention : str, optional
        One of `CONVENTIONS`; by default, that of the suffix, if only one has it.
    source : Grid, optional
        The grid of the input (moving) image, which FSL and FreeSurfer need.
    reference : Grid, optional
        The grid of the output (fixed) image, which affine maps of FSL and FreeSurfer need.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    SuppleError
        If the convention is unknown or in doubt, or cannot hold these maps; or the file cannot be written.
    """
    name = convention_of(path) if convention is None else convention
    form_of(path, name).write(path, contents, Grids(source, reference), force=force)
