"""Files of fields and affine maps with their conventions, and the grids and images that belong to them."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from supple.engine.work import Array, Tell
from supple.errors import SuppleError, argument, current_spelling, shown, spelling
from supple.fields import Field, Map, Placed, check_axes, own_grid, read_maps, told, write_maps
from supple.files.grids import reference_grid
from supple.files.jobs import Job
from supple.files.transforms import displacement_of
from supple.files.volumes import deformation_of, moved
from supple.media import transforms, volume
from supple.media.files import PathLike, check_output, unwritable
from supple.media.medium import picture_grid
from supple.media.objects import held
from supple.media.volume import is_volume, suffix_of
from supple.space.affine import Affine, Projective
from supple.space.geometry import Grid, check_upright


@dataclass(frozen=True, slots=True)
class MapFile:
    """A file of maps that was read or will be written."""

    path: Path
    convention: str  # one of `supple.media.transforms.CONVENTIONS`
    known: str  # how the convention was determined: "as given", "from its intent code", ...
    maps: tuple[Map, ...]  # in the order in which a point of the output goes through them
    inverse: bool = False  # whether the inverse is used in a composition
    written: bool = False

    @property
    def kind(self) -> transforms.Convention:
        """The meaning of the convention's numbers."""
        kind = transforms.CONVENTIONS[self.convention]
        if not self.written or kind.written is None:
            return kind
        holds, space, units = kind.written
        if not any(each.ndim == 3 for each in self.maps):
            space, units = "the picture", "pixels"
        return kind._replace(holds=holds, space=space, units=units)

    @property
    def grid(self) -> Grid | None:
        """The grid of the first field; None for affine maps alone."""
        return next((own_grid(each) for each in self.maps if isinstance(each, Field)), None)

    @property
    def direction(self) -> str:
        """The direction of the maps in the file; in memory, they are always pull maps."""
        return self.kind.affine if all(isinstance(each, Affine) for each in self.maps) else transforms.PULL

    def facts(self) -> dict[str, Any]:
        """Return the facts on the file, ready for JSON."""
        kind = self.kind
        facts = {"convention": self.convention, "known": self.known, "direction": self.direction}
        return {**facts, "holds": kind.holds, "space": kind.space, "units": kind.units, "maps": _facts_of(self.maps)}


def read_file(
    path: PathLike, convention: str | None = None, *, source: Grid | None = None, reference: Grid | None = None
) -> MapFile:
    """Read a file of maps, and determine its convention unless it is given."""
    known = transforms.convention_in(path) if convention is None else convention
    maps = read_maps(path, known, source=source, reference=reference)
    suffix = suffix_of(path)
    sources = {".nii": "intent code", ".nii.gz": "intent code", ".txt": "content", ".mat": "content"}
    how = f"from its {sources.get(suffix, f'suffix {suffix}')}" if convention is None else "as given"
    return MapFile(Path(path), known, how, maps)


def lifted(maps: Sequence[Placed], convention: str | None, grid: Grid | None) -> list[Placed]:
    """Return maps for an image on a grid: if it is a volume of one slice, ITK's maps of pictures get a third axis."""
    if convention != "itk" or grid is None or grid.ndim != 3 or grid.shape[0] != 1:
        return list(maps)
    if not np.allclose(np.abs(grid.direction[2]), (0, 0, 1), atol=1e-6):
        return list(maps)
    return [
        each if isinstance(m := each.map, Projective) or m.ndim == 3 else replace(each, map=_lifted(m, grid))
        for each in maps
    ]


def _lifted(flat: Map, grid: Grid) -> Map:
    """Return a map of pictures as one of a slice in a volume, which keeps z."""
    made = np.eye(4)
    if isinstance(flat, Affine):
        made[:2, [0, 1, 3]] = flat.matrix[:2]
        return Affine(made)
    made[:2, :2] = flat.grid.direction
    count = 4 if flat.interpolation == "bspline" else 1  # planes of coefficients around the slice
    step, first = grid.spacing[2], grid.origin[2] - (count - 1) / 2 * grid.spacing[2]
    place = Grid((count, *flat.grid.shape), (*flat.grid.spacing, step), (*flat.grid.origin, first), made[:3, :3])
    values = np.pad(flat.values, [(0, 0), (0, 0), (0, 1)])
    return Field(np.repeat(values[None], count, axis=0), place, flat.interpolation, flat.beyond)


def grid_of(path: PathLike | Any) -> Grid:
    """Return the grid of a volume, a field or a picture.

    ``path`` is a file, or an image of SimpleITK or nibabel in memory.
    """
    if (image := held(path)) is not None:
        return image.grid
    if not is_volume(path):
        return picture_grid(path)
    outline = volume.outline_of(path)
    if outline.geometry.convention == "array":
        raise SuppleError(f"{shown(path)} does not say where its voxels lie in space: give an image that does")
    check_upright(outline.geometry, shown(path), "what computes with fields")
    return outline.grid


def optional_grid(path: PathLike | None) -> Grid | None:
    """Return the grid of an image, as `grid_of` does; None for None."""
    return None if path is None else grid_of(path)


def check_reference(read: MapFile, grid: Grid | None, path: PathLike | None) -> None:
    """Raise SuppleError if the grid of a reference has another number of axes than the maps."""
    if grid is not None and path is not None:
        check_axes([Placed(each, name=shown(read.path)) for each in read.maps], grid.ndim, shown(path))


def convention_out(target: PathLike, to: str | None, otherwise: str | None) -> tuple[str, str]:
    """Return the convention of a file to write, and how it was determined."""
    if to is not None:
        transforms.check_convention(to, "to")
        return to, "as asked"
    if otherwise is not None:
        return otherwise, "as all were read"
    how = current_spelling()
    named = replace(how, argument=lambda name, value: how.argument("to" if name == "convention" else name, value))
    with spelling(named):
        return transforms.convention_of(target), f"from its suffix {suffix_of(target)}"


def only_field(read: MapFile) -> Field:
    """Return the only field of a file; SuppleError if it holds anything else."""
    only = read.maps[0] if len(read.maps) == 1 else None
    if not isinstance(only, Field):
        if any(isinstance(each, Field) for each in read.maps):
            advice = "supple compose makes one field of them"
        else:
            advice = "supple compose makes one, on the grid of an image (--reference)"
        raise SuppleError(f"{shown(read.path)} holds {told(read.maps)}, and not one field: {advice}")
    return only


def check_images(ndim: int | None = None, **paths: PathLike | None) -> None:
    """Raise SuppleError for names of outputs that are not volumes (3 axes), pictures (2), or either (None).

    ``.mhd`` is refused too, as its data are in a second file. The message has the argument's name.
    """
    from supple.media import image
    from supple.media.pictures import SUFFIXES_OUT

    for name, path in paths.items():
        try:
            if path is None:
                continue
            if suffix_of(path) == ".mhd":  # each of several outputs must be one file
                raise unwritable(path, "its data would be in a second file", "use .mha")
            if ndim == 2 or (ndim is None and suffix_of(path) in SUFFIXES_OUT):
                image.check_target(path)
            else:
                volume.check_target(path)
        except SuppleError as error:
            raise SuppleError(f"{argument(name)} must be the name of an image: {error}") from None


def check_written(
    path: PathLike, ndim: int, convention: str, grid: Grid | None, *, source: Grid | None, reference: Grid | None
) -> None:
    """Raise SuppleError, before any work, for a name or a convention that cannot hold such a map.

    Only the writer of each convention has these checks. So it writes an identity to a temporary folder: a field of a
    few samples of the grid, or, without a grid, an affine map.
    """
    one: transforms.Content = np.eye(ndim + 1)
    if grid is not None:
        few = grid.crop([0] * ndim, [min(size, 2) for size in grid.sizes])
        one = transforms.Displacements(np.zeros((*few.shape, ndim), np.float32), few)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / Path(path).name
        try:
            transforms.write(trial, [one], convention, source=source, reference=reference)
        except SuppleError as error:
            text = str(error).replace(shown(trial), shown(path))
            raise type(error)(text) from None


def write_image(path: PathLike, values: Array, grid: Grid | None, *, in_nifti: float | None = None) -> None:
    """Write values on a grid as a volume or a picture.

    In NIfTI files, ``in_nifti`` replaces inf and NaN, which ITK, and so SimpleITK, ANTs and 3D Slicer, reads as 0 from
    NIfTI, but not from other formats.
    """
    assert grid is not None
    if in_nifti is not None and suffix_of(path).startswith(".nii"):
        values = np.where(np.isfinite(values), values, values.dtype.type(in_nifti))
    if grid.ndim == 2:
        from supple.media import image

        image.write(path, values)
        return
    volume.write(path, values, volume.Volume(values, grid.geometry("LPS")))


def _facts_of(maps: Sequence[Map]) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = []
    for each in maps:
        if isinstance(each, Affine):
            made.append({"kind": "affine", "matrix": each.matrix.tolist()})
            continue
        grid, units = each.grid, ("mm", "LPS") if each.ndim == 3 else ("pixels", "the picture")
        place = {name: np.array(getattr(grid, name)).tolist() for name in ("spacing", "origin", "direction")}
        head = {"kind": "field", "interpolation": each.interpolation, "size": list(grid.sizes)}
        made.append({**head, **place, "units": units[0], "space": units[1]})
    return made


def write_map(job: Job, to: str | None = None, *, tell: Tell = lambda step, done, total: None) -> MapFile:
    """Write one field from each point of the output to its source point in a volume, through strokes and maps.

    Parameters
    ----------
    job : Job
        Of these: ``source``, a volume, in a registration the moving one, of which the header alone is read; ``target``,
        the field; ``recipe``, whose strokes come after the maps, and are on the grid of the field; ``maps``; ``grid``,
        whose reference has the grid of the field, by default that of the volume; ``volume`` and ``force``.
    to : str, optional
        The convention, as in `Field.write`; by default, that of the suffix of the target.

    Raises
    ------
    SuppleError
        If a file cannot be read or written, or the convention does not hold such a field.
    """
    convention, how = convention_out(job.target, to, None)
    check_output(job.target, force=job.force)
    tell("read", 0, 1)
    on = outline = volume.outline_of(job.source, **job.volume.how)
    if job.grid is not None and job.grid.reference is not None:
        on = moved(outline, reference_grid(job.grid.reference, 3), job.grid)
    deformation = deformation_of(job, on)
    own = deformation.grid
    check_written(job.target, 3, convention, own, source=outline.grid, reference=own)
    tell("plan", 0, 1)
    made = Field(displacement_of(deformation, own.geometry("LPS")), own)
    tell("write", 0, 1)
    write_maps(job.target, (made,), convention, source=outline.grid, reference=own, force=job.force)
    return MapFile(Path(job.target), convention, how, (made,), written=True)
