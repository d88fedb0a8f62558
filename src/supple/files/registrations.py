"""Registrations corrected by strokes: fields and affine maps, followed by strokes, are written as one field."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from supple.engine.work import Tell
from supple.fields import Field, Placed, write_maps
from supple.files.grids import reference_grid
from supple.files.maps import MapFile, check_written, convention_out
from supple.files.options import GridOptions, PathLike, VolumeOptions
from supple.files.transforms import displacement_of
from supple.files.volumes import deformation_of, moved
from supple.media import volume as volumes
from supple.media.files import check_output
from supple.strokes import Recipe


def write_map(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    to: str | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
    volume: VolumeOptions | None = None,
    force: bool = False,
    tell: Tell = lambda step, done, total: None,
) -> MapFile:
    """Write one field from each point of the output to its source point in a volume, through strokes and maps.

    Parameters
    ----------
    source, target : str or os.PathLike
        The volume, in a registration the moving one, of which the header alone is read; and the field.
    recipe : Recipe
        Its strokes come after the maps, and are on the grid of the field.
    to : str, optional
        The convention, as in `Field.write`; by default, that of the suffix of ``target``.
    maps, grid, volume : sequence of Placed, GridOptions, VolumeOptions
        As in `supple.warp_file`. The grid of the field is that of the reference; by default, that of the volume.

    Raises
    ------
    SuppleError
        If a file cannot be read or written, or the convention does not hold such a field.
    """
    known = volume or VolumeOptions()
    convention, how = convention_out(target, to, None)
    check_output(target, force=force)
    tell("read", 0, 1)
    outline = volumes.outline_of(source, **known.how)
    on = outline
    if grid is not None and grid.reference is not None:
        on = moved(outline, reference_grid(grid.reference, 3), grid)
    deformation = deformation_of(recipe, on, world=known.world, maps=maps)
    own, between = deformation.grid, (outline.grid, deformation.grid)
    check_written(target, 3, convention, own, source=between[0], reference=between[1])
    tell("plan", 0, 1)
    made = Field(displacement_of(deformation, own.geometry("LPS")), own)
    tell("write", 0, 1)
    write_maps(target, (made,), convention, source=between[0], reference=between[1], force=force)
    return MapFile(Path(target), convention, how, (made,), written=True)
