"""Grids from files: for outputs, and for fields and affine maps whose conventions need them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

from supple.errors import SuppleError, VolumeWarning, argument, shown, warn
from supple.fields import Placed, check_axes, check_path
from supple.files.options import GridOptions, PathLike
from supple.media.files import is_store
from supple.media.medium import opened
from supple.media.pictures import SUFFIXES
from supple.media.suffixes import suffix_of
from supple.space.checks import refuse
from supple.space.geometry import Geometry, Grid

_MOST = 1 << 40
"""The most samples of a result; beyond, the given spacing is surely a mistake."""


def output_grid(options: GridOptions, grid: Grid) -> Grid:
    """Return the grid of the output for an input on ``grid``.

    SuppleError if the reference cannot be read, or is of another kind; or if the crop is not within the grid.
    """
    n = grid.ndim
    kind = "picture" if n == 2 else "volume"
    made = grid if options.reference is None else reference_grid(options.reference, n)
    if options.resample is not None:
        steps = options.resample
        if isinstance(steps, Sequence) and len(steps) != n:
            refuse("resample", f"one number or {n} of them, as the input is a {kind}", steps)
        try:
            made = made.upright().resampled(steps)
        except SuppleError as error:
            raise SuppleError(f"resample to {listed(steps)} makes no {kind}: {error}") from None
    if options.crop is not None:
        if len(options.crop) != 2 * n:
            refuse("crop", f"{2 * n} numbers, as the input is a {kind}", listed(options.crop))
        first, sizes = options.crop[:n], options.crop[n:]
        if any(a + b > size for a, b, size in zip(first, sizes, made.sizes, strict=True)):
            refuse("crop", f"within the grid of {' x '.join(map(str, made.sizes))} samples", listed(options.crop))
        made = made.crop(first, sizes)
    if options.resample is not None and math.prod(made.shape) > _MOST:
        what = f"a {kind} of {' x '.join(f'{size:,}' for size in made.sizes)} {'pixels' if n == 2 else 'voxels'}"
        raise SuppleError(f"resample to {listed(options.resample)} makes {what}, too many: give a larger spacing")
    return made


def reference_grid(path: PathLike, ndim: int) -> Grid:
    """Return the grid of a picture or of a volume; SuppleError if it has another number of axes than ``ndim``."""
    medium, wanted = opened(path, axes=None if is_store(path) else ndim), "volume" if ndim == 3 else "picture"
    found: str = medium.kind
    if found == "store" and medium.grid is not None:
        found = "volume" if medium.grid.ndim == 3 else "picture"
    if found != wanted and (found == "clip" or medium.kind == "store" or os.path.exists(path)):
        unknown = found == "picture" and medium.kind != "store" and suffix_of(path) not in SUFFIXES
        told = "no volume" if unknown else f"a {found}"
        raise SuppleError(f"{shown(path)} is {told}, and the grid of a {wanted} is needed: name a {wanted}")
    if ndim == 3:
        warn_of_place(medium.outline.geometry, shown(path))
    grid = medium.grid
    assert grid is not None
    return grid


def warn_of_place(geometry: Geometry, name: str) -> None:
    """Warn of a volume without a position in space, where positions are needed."""
    if geometry.convention == "array":
        text = (
            f"{name} does not say where its voxels lie in space: its first one is taken to lie at (0, 0, 0), and its "
        )
        warn(f"{text}axes along those of LPS", VolumeWarning)


def check_straightened(options: GridOptions | None) -> None:
    """Raise SuppleError if a straightened picture shall have the grid of another image."""
    if options is not None and options.reference is not None:
        raise SuppleError(f"{argument('reference')} and a straightened picture have each a grid: leave one out")


def grid_on(options: GridOptions | None, grid: Grid, name: str, maps: Sequence[Placed]) -> Grid | None:
    """Return the grid of the output for a file on ``grid`` and maps; None if it is that of the input.

    SuppleError as in `output_grid`; or if a map has another number of axes; or if the grid, the fields and the input do
    not overlap, even through the maps.
    """
    check_axes(maps, grid.ndim, name)
    made = grid if options is None else output_grid(options, grid)
    if options is not None and options.reference is not None:
        check_path(reversed(maps), made, shown(options.reference), source=grid, name=name)
    else:  # on the input's own grid, maps may lead out of the input
        check_path(reversed(maps), made, name)
    return None if made == grid else made


def listed(numbers: object) -> str:
    """Return numbers as text in the form of the command line."""
    return ",".join(f"{x:g}" for x in numbers) if isinstance(numbers, Sequence) else f"{numbers:g}"
