"""Files of displacement fields and affine maps: inverted, checked, composed, and converted between conventions.

``convention`` is that of files to read, by default inferred from the file; ``to`` is that of files to write. ``image``
is the input (moving) image, whose grid some conventions need, and ``reference`` an image or a field whose grid the
result gets. All outputs of a call appear together or not at all; existing ones are replaced with ``force``.
SuppleError if a file cannot be read, or an output cannot be written.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from supple.errors import FoldWarning, OutsideWarning, SuppleError, argument, shown, warn
from supple.fields import OK, Field, Map, Placed, check_axes, check_path, compose, own_grid, told, write_maps
from supple.fields.checks import FieldReport
from supple.files.maps import (
    MapFile,
    check_images,
    check_reference,
    check_written,
    convention_out,
    only_field,
    optional_grid,
    read_file,
    write_image,
)
from supple.media import transforms
from supple.media.files import PathLike, check_output, replacing_together, same_file
from supple.media.volume import suffix_of
from supple.space.affine import Affine
from supple.space.geometry import Grid

_MATRICES = (".txt", ".mat", ".lta", ".1d")
_IMAGES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".mif", ".mif.gz", ".mgz")
# In NIfTI, these replace inf and NaN, which ITK would read as 0: as no error, or no change of volume. The largest
# float32 exceeds any threshold for errors. The exponential of the most negative one is 0, a volume of 0.
_UNKNOWN_ERROR, _NO_LOGARITHM = float(np.finfo(np.float32).max), float(np.finfo(np.float32).min)


class Input(NamedTuple):
    """A file to be composed with others."""

    path: PathLike
    inverse: bool = False  # whether its inverse is applied
    convention: str | None = None
    source: PathLike | None = None  # its input (moving) image, whose grid some conventions need


@dataclass(frozen=True, slots=True)
class Written:
    """A written file of maps, and its sources."""

    sources: tuple[MapFile, ...]
    target: MapFile
    seconds: float

    def facts(self) -> dict[str, Any]:
        """Return the facts on the output and its sources, ready for JSON."""
        read = [{"input": str(each.path), "inverse": each.inverse, **each.facts()} for each in self.sources]
        return {"output": str(self.target.path), "read": read, "written": self.target.facts(), "seconds": self.seconds}


@dataclass(frozen=True, slots=True)
class InvertedFile(Written):
    """A written inverse."""

    counts: Mapping[str, int] | None  # the number of samples of each status, if one field was inverted
    error: float | None  # the largest among samples with the status ok, in millimetres; None without any
    tolerance: float  # in samples of the field

    def facts(self) -> dict[str, Any]:
        """Return the facts on the inverse, ready for JSON."""
        found = {"counts": dict(self.counts) if self.counts else None, "error": self.error, "tolerance": self.tolerance}
        return {**Written.facts(self), **found}


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """A checked field, and the field that is meant to invert it."""

    source: MapFile
    inverse: MapFile | None
    report: FieldReport
    seconds: float

    def facts(self) -> dict[str, Any]:
        """Return the facts on the check, ready for JSON."""
        report, known = self.report, asdict(self.report)
        del known["grid"]
        # JSON has no NaN
        if report.consistency is not None and not report.consistency.count:
            known["consistency"] |= dict.fromkeys(("largest", "percentile", "mean"))
        other = {"inverse": str(self.inverse.path), "inverse_read": self.inverse.facts()} if self.inverse else {}
        space = "LPS" if report.grid.ndim == 3 else "the picture"
        return {
            "input": str(self.source.path), "read": self.source.facts(), **other, "size": list(report.grid.sizes),
            "spacing": list(report.grid.spacing), "space": space, "samples": report.samples, **known,
            "folds": report.folds, "seconds": self.seconds,
        }  # fmt: skip


def invert_file(
    source: PathLike,
    target: PathLike,
    *,
    convention: str | None = None,
    to: str | None = None,
    reference: PathLike | None = None,
    image: PathLike | None = None,
    tolerance: float = 0.01,
    error: PathLike | None = None,
    status: PathLike | None = None,
    report: PathLike | None = None,
    force: bool = False,
) -> InvertedFile:
    """Invert a file of a field, of affine maps, or of several of these.

    One field is inverted as in `Field.invert`, on its own grid or on that of the reference, which a B-spline requires.
    Several maps are inverted by composing their inverses in reverse order, sampled as one field; affine maps alone are
    inverted exactly. By default, the inverse has the convention of the source.

    Parameters
    ----------
    source, target, convention, to, reference, image, force
        As in the module's docstring; for an affine map of FSL, the reference is the output image.
    tolerance : float
        As in `Field.invert`.
    error, status : str or os.PathLike, optional
        Images of `Inverted.error` (float32) and `Inverted.status` (uint8) on the grid of the inverse, for one field. In
        NIfTI, inf is written as the largest float32 (3.4028235e38), since ITK reads inf as 0.
    report : str or os.PathLike, optional
        A JSON file for `InvertedFile.facts`.

    Warns
    -----
    FoldWarning, OutsideWarning
        If the inverse is not exact everywhere.
    """
    began = time.perf_counter()
    outputs = [path for path in (target, error, status, report) if path is not None]
    for path in outputs[1:]:
        check_beside(path, source, force=force)
    check_images(error=error, status=status)
    if to is not None:
        transforms.check_convention(to, "to")
    wanted = optional_grid(reference)
    moving = optional_grid(image)
    read = read_file(source, convention, source=moving, reference=wanted)
    check_reference(read, wanted, reference)
    known = to or read.convention
    _warn_of_size(read.path, read.convention, moving, read.grid)
    fields = [each for each in read.maps if isinstance(each, Field)]
    if (len(read.maps) != 1 or not fields) and (error is not None or status is not None):
        text = f"{shown(source)} holds {told(read.maps)}: {argument('error')} and {argument('status')} are of the"
        raise SuppleError(f"{text} inverse of one field alone: leave them out")
    grid = wanted or read.grid if fields else None
    if wanted is None and fields and fields[0].interpolation == "bspline":
        points = " x ".join(map(str, fields[0].grid.sizes))
        text = f"the field of {shown(source)} is a B-spline, and its grid of {points} control points is too coarse for"
        raise SuppleError(f"{text} an inverse: give the image whose grid the inverse shall have (--reference)")
    # The inverse leads to the output image of the field, whose grid is the field's.
    here = read.grid if fields else wanted
    ndim = read.maps[0].ndim if read.maps else 3
    check_images(ndim, error=error, status=status)
    check_written(target, ndim, known, grid, source=here, reference=moving)
    counts, worst, extra = None, None, {}
    with replacing_together(outputs, force=force) as hidden:
        places = dict(zip(outputs, hidden, strict=True))
        if not fields:
            maps: tuple[Map, ...] = tuple(each.inverse() for each in reversed(read.maps) if isinstance(each, Affine))
        elif len(read.maps) == 1:
            if wanted is not None:
                check_path([Placed(fields[0], inverse=True, name=shown(source))], wanted, shown(reference or ""))
            inverted = fields[0].invert(wanted, tolerance=tolerance)
            maps, counts = (inverted.field,), inverted.counts
            fine = inverted.error[inverted.status == OK]
            worst = float(fine.max()) if fine.size else None
            _warn_of(counts, read)
            extra = {path: image for path, image in ((error, inverted.error), (status, inverted.status)) if path}
        else:
            assert grid is not None
            parts = [Placed(each, inverse=True, name=shown(source)) for each in reversed(read.maps)]
            maps = (compose(parts, grid),)
        write_maps(places[target], maps, known, source=here, reference=moving)
        for path, values in extra.items():
            grid = own_grid(maps[0]) if isinstance(maps[0], Field) else None
            write_image(places[path], values, grid, in_nifti=_UNKNOWN_ERROR if path is error else None)
        how = "as asked" if to else "as it was read"
        written = MapFile(Path(target), known, how, maps, written=True)
        made = InvertedFile((read,), written, time.perf_counter() - began, counts, worst, tolerance)
        if report is not None:
            places[report].write_text(json.dumps(made.facts(), indent=2) + "\n", "utf-8")
    return made


def check_beside(path: PathLike, *sources: PathLike | None, force: bool) -> None:
    """Raise SuppleError if a secondary output cannot be written, or is one of the files that are read."""
    for source in sources:
        if source is not None and same_file(path, source):
            text = f"{shown(path)} is read: {argument('force', True)} does not replace it, so choose another name"
            raise SuppleError(text)
    check_output(path, force=force)


def check_file(
    source: PathLike,
    inverse: PathLike | None = None,
    *,
    convention: str | None = None,
    image: PathLike | None = None,
    map: PathLike | None = None,
    picture: PathLike | None = None,
    plane: str | None = None,
    force: bool = False,
) -> CheckedFile:
    """Check the field of a file, as `Field.check` does.

    Parameters
    ----------
    source, convention, image, force
        As in the module's docstring; the convention applies to both files.
    inverse : str or os.PathLike, optional
        A file with the field that is meant to invert it.
    map : str or os.PathLike, optional
        An image for the logarithm of the Jacobian determinant, float32, as from `Field.log_jacobian`. In NIfTI, NaN is
        written as the most negative float32 (-3.4028235e38), since ITK reads NaN as 0.
    picture : str or os.PathLike, optional
        A PNG, SVG or PDF file for `supple.plot.fields.draw_check`; for a volume, it shows ``plane``.
    """
    began = time.perf_counter()
    outputs = [path for path in (map, picture) if path is not None]
    for path in outputs:
        check_beside(path, source, inverse, force=force)
    check_images(map=map)
    if plane is not None and picture is None:
        raise SuppleError(f"{argument('plane')} is that of the picture, and there is none: give {argument('picture')}")
    if picture is not None:
        from supple.plot.frame import check_plot

        check_plot(picture, force=force)
    read = read_file(source, convention, source=optional_grid(image))
    field = only_field(read)
    _warn_of_size(read.path, read.convention, image, read.grid)
    check_images(field.ndim, map=map)
    other = None if inverse is None else read_file(inverse, convention, source=own_grid(field))
    if other is not None:
        check_axes([Placed(only_field(other), name=shown(other.path))], field.ndim, shown(source), f"of {field.ndim}")
    folded, logarithms = field.folded_cells(), field.log_jacobian()
    distances = None if other is None else field.distances(only_field(other))
    report = field.reported(folded, logarithms, distances)
    if outputs:
        with replacing_together(outputs, force=force) as hidden:
            places = dict(zip(outputs, hidden, strict=True))
            if map is not None:
                write_image(places[map], logarithms, report.grid, in_nifti=_NO_LOGARITHM)
            if picture is not None:
                from supple.plot.fields import draw_check

                draw_check(field, report, folded, logarithms, distances, places[picture],
                           name=Path(source).name, plane=plane)  # fmt: skip
    return CheckedFile(read, other, report, time.perf_counter() - began)


def compose_files(
    inputs: Sequence[Input],
    target: PathLike,
    *,
    to: str | None = None,
    reference: PathLike | None = None,
    force: bool = False,
) -> Written:
    """Compose several maps into one field, as `compose` does; the first map applies first to a point of the output.

    By default, the convention is the common one of all inputs, else the only one of the suffix; the grid is that of the
    first field. Warnings are those of `compose`.
    """
    began = time.perf_counter()
    if not inputs:
        raise SuppleError("there is nothing to compose: give files of fields or affine maps, the first first")
    wanted = optional_grid(reference)
    with replacing_together([target], force=force) as (place,):
        read: list[MapFile] = []
        moving: list[Grid | None] = []
        here = wanted  # the grid on the output side of the current map, None if unknown
        for each in inputs:
            there = optional_grid(each.source)
            source = there or (here if each.inverse else None)
            try:
                file = read_file(each.path, each.convention, source=source, reference=None if each.inverse else here)
            except transforms.MissingGridError as error:
                if source is None or (not read and not each.inverse):
                    raise
                advice = "convert it by itself first (supple convert)"
                raise SuppleError(f"{str(error).rpartition(': ')[0]}: {advice}") from None
            check_reference(file, wanted, reference)
            _warn_of_size(file.path, file.convention, source, file.grid)
            read.append(replace(file, inverse=each.inverse))
            moving.append(there)
            here = file.grid if each.inverse else there
        shared = {each.convention for each in read}
        alike = len(shared) == 1 and shared != {"fsl-affine"}  # FLIRT's convention has no fields
        known, how = convention_out(target, to, shared.pop() if alike else None)
        grid = wanted or next((each.grid for each in read if each.grid is not None), None)
        if grid is None:
            raise SuppleError(
                "the maps are affine, and have no grid: give an image whose grid the field shall have (--reference)"
            )
        parts: list[Placed] = []
        for file in read:
            ordered = file.maps[::-1] if file.inverse else file.maps
            parts += [Placed(one, inverse=file.inverse, name=shown(file.path)) for one in ordered]
        made = compose(parts, grid)
        there = read[-1].grid if inputs[-1].inverse else moving[-1]
        _warn_of_size(target, known, there, grid)
        write_maps(place, (made,), known, source=there, reference=wanted)
    written = MapFile(Path(target), known, how, (made,), written=True)
    return Written(tuple(read), written, time.perf_counter() - began)


def convert_file(
    source: PathLike,
    target: PathLike,
    *,
    convention: str | None = None,
    to: str | None = None,
    image: PathLike | None = None,
    reference: PathLike | None = None,
    force: bool = False,
) -> Written:
    """Write the maps of a file in another convention or format, by default that of the target's suffix.

    Fields and compositions are sampled on the grid of the reference, if it is given, and so is any map that is written
    as an image. STMaps are relative to the size of ``image``, by default the map's, with an OutsideWarning.
    """
    began = time.perf_counter()
    if to is not None:
        transforms.check_convention(to, "to")
    moving = optional_grid(image)
    wanted = optional_grid(reference)
    with replacing_together([target], force=force) as (place,):
        read = read_file(source, convention, source=moving, reference=wanted)
        check_reference(read, wanted, reference)
        affine = len(read.maps) == 1 and isinstance(read.maps[0], Affine)
        as_field = not affine or suffix_of(target) in _IMAGES
        if (affine or len(read.maps) > 1) and suffix_of(target) in _IMAGES and wanted is None:
            text = f"{shown(source)} holds {told(read.maps)}, and {shown(target)} one field: give the image whose grid"
            raise SuppleError(f"{text} the field shall have (--reference)")
        if not affine and suffix_of(target) in _MATRICES:
            what = f"a {suffix_of(target)} file holds one affine map, and {shown(source)} {told(read.maps)}"
            raise SuppleError(f"cannot write {shown(target)}: {what}: use .nii.gz, .nrrd, .mha or .h5")
        known, how = convention_out(target, to, None)
        parts = [Placed(each, name=shown(source)) for each in read.maps]
        maps = (compose(parts, wanted),) if as_field and wanted is not None else read.maps
        if read.convention != known:  # from STMap to STMap, the size cancels
            _warn_of_size(source, read.convention, moving, read.grid)
            _warn_of_size(target, known, moving, wanted or read.grid)
        write_maps(place, maps, known, source=moving, reference=wanted)
    return Written((read,), MapFile(Path(target), known, how, maps, written=True), time.perf_counter() - began)


def _warn_of_size(path: PathLike, convention: str, source: object, grid: Grid | None) -> None:
    """Warn that the size of an STMap's source picture is assumed to be the map's, if it is not given."""
    if convention != "stmap" or source is not None or grid is None:
        return
    width, height = grid.sizes[:2]
    text = f"{shown(path)} counts in the size of the picture that it leads to, which is not given: it is taken to have "
    text += f"{width} x {height} pixels, as the map has: {argument('source')} names that picture"
    warn(text, OutsideWarning)


def doubt_of(read: MapFile, folded: int, cells: int) -> str:
    """Return a remark that a file may have another convention, if more than a quarter of its cells fold; else ""."""
    if 4 * folded <= cells:
        return ""
    return f"is it of the convention {read.convention}, {read.known}? {argument('convention')} says another"


def _warn_of(counts: Mapping[str, int], read: MapFile) -> None:
    found = [f"{count:,} {status}" for status, count in counts.items() if status != "ok" and count]
    if found:
        whole, field, doubt = sum(counts.values()), only_field(read), ""
        if counts["folded"] or counts["unconverged"]:
            cells = field.folded_cells()
            folded = int(np.count_nonzero(cells))
            if hint := doubt_of(read, folded, cells.size):
                doubt = f"; the field folds in {folded:,} of its {cells.size:,} cells: {hint}"
        text = f"{shown(read.path)}: of {whole:,} {'pixel' if field.ndim == 2 else 'voxel'}s of the inverse, "
        text += f"{', '.join(found)}: they hold the nearest that was found; nothing was smoothed or set to zero "
        text += f"({argument('status')} shows where){doubt}"
        warn(text, FoldWarning)
