"""Files of displacement fields and affine maps, in the conventions of the programs that use them.

All hold pull maps: of a point of the output, the point of the input that is seen there. In memory, positions and
displacements of volumes are in millimetres in LPS, those of pictures in pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from supple.errors import SuppleError, shown
from supple.geometry import Grid
from supple.media.files import PathLike
from supple.media.transforms import ngff, opencv, stmap
from supple.media.transforms.base import Content, Displacements
from supple.media.transforms.itk import SUFFIXES_OUT, check_target, write_field

__all__ = ["CONVENTIONS", "SUFFIXES_OUT", "Content", "Displacements", "check_target", "read", "write", "write_field"]

CONVENTIONS: dict[str, ModuleType] = {
    "ngff": ngff,
    "opencv": opencv,
    "stmap": stmap,
}
"""The modules that read and write each, with their `SUFFIXES`, and those that leave no doubt (`UNAMBIGUOUS`)."""


def read(path: PathLike, convention: str | None = None, *, source: Grid | None = None) -> tuple[Content, ...]:
    """Read a map from a file.

    Parameters
    ----------
    path : str or os.PathLike
        The file, or the folder of a Zarr store.
    convention : str, optional
        One of `CONVENTIONS`; by default, the only one that has the suffix.
    source : Grid, optional
        The grid of the input image, for conventions whose positions are relative to it.

    Returns
    -------
    tuple of Content
        Matrices and displacement fields, of which the first applies first.

    Raises
    ------
    SuppleError
        If the suffix leaves the convention open, or the file cannot be read.
    """
    made: tuple[Content, ...] = _chosen(path, convention).read(path, source=source)
    return made


def write(
    path: PathLike,
    contents: Sequence[Content],
    convention: str | None = None,
    *,
    source: Grid | None = None,
    force: bool = False,
) -> None:
    """Write a map to a file, which appears whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        The file, or the folder of a Zarr store.
    contents : sequence of Content
        Matrices and displacement fields, of which the first applies first.
    convention : str, optional
        One of `CONVENTIONS`; by default, the only one that has the suffix.
    source : Grid, optional
        The grid of the input image, for conventions whose positions are relative to it.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    SuppleError
        If the suffix leaves the convention open, the convention cannot hold the contents, or the file cannot be
        written.
    """
    _chosen(path, convention).write(path, contents, source=source, force=force)


def _chosen(path: PathLike, convention: str | None) -> ModuleType:
    if convention is not None:
        if convention not in CONVENTIONS:
            known = ", ".join(CONVENTIONS)
            raise SuppleError(f"convention must be one of {known}, found {convention!r}")
        return CONVENTIONS[convention]
    name = Path(path).name.lower()
    sure = [key for key, module in CONVENTIONS.items() if name.endswith(module.UNAMBIGUOUS)]
    if len(sure) == 1:
        return CONVENTIONS[sure[0]]
    open_ones = [key for key, module in CONVENTIONS.items() if name.endswith(module.SUFFIXES)] or list(CONVENTIONS)
    raise SuppleError(f"the name of {shown(path)} leaves its convention open: give one of {', '.join(open_ones)}")
