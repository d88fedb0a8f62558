"""Warping volumes from file to file, in millimetres."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from supple.arrays import clamp_to, warp_array
from supple.deformation import Deformation
from supple.engine.memory import beside, machine_memory
from supple.engine.sampling import Certificate, Sampling
from supple.engine.work import Array, Space, Tell, work_of
from supple.errors import GapWarning, SuppleError, VolumeWarning, argument, shown, warn
from supple.fields import warn_of_maps
from supple.files.grids import grid_on, reference_grid, warn_of_place
from supple.files.jobs import Job, Warped
from supple.files.options import GridOptions, PathLike, VolumeOptions
from supple.folding.resolved import warn_of_still
from supple.media.files import check_output, replacing
from supple.media.volume import Volume, check_target, derived, is_dicom, read, suffix_of, write
from supple.media.volume.dicom import padding_of
from supple.space.geometry import Floats, Geometry, Grid
from supple.strokes import CoordinateSpace, Recipe, Stroke, fit_recipe

# The test for label maps: the number of slices that are examined; the smallest fraction of equal neighbours outside
# the background; the largest number of labels; and the number of values that are always few enough.
_LOOKED_AT, _AREAS, _MOST_LABELS, _FEW = 16, 0.7, 1024, 8
_BETWEEN = 0.2  # of the changes from voxel to voxel: so many values between two others are none of labels
_SLAB = 16  # slices that are computed and written together
_HUGE, _TINY = 2, 1  # radii, in the size of a volume and in the distance of its samples, that are in another unit


@dataclass(frozen=True, slots=True)
class Flowing:
    """Samples that are computed while they are written: memory that is touched for the first time takes time."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    slabs: Iterator[Array]
    ndim: int = 3

    def __iter__(self) -> Iterator[Any]:
        """Yield the slices."""
        return itertools.chain.from_iterable(self.slabs)


def open_volume(source: PathLike, options: VolumeOptions | None = None) -> Volume:
    """Return a volume with the samples as stored; `Volume.rescaled` returns the scaled values."""
    return read(source, **(options or VolumeOptions()).how)


def deformation_of(job: Job, volume: Volume) -> Deformation:
    """Return the deformation of a volume by a job: radius and border are in millimetres, points are indices.

    The deformation is on the volume's grid, or, if that is sheared, on the upright grid around it (`Grid.upright`),
    whose faces the border keeps in place. SuppleError if a stroke has no third coordinate; points are in space, but the
    volume has no position; or the recipe was made for another size, without ``fit``.
    """
    recipe, maps = job.recipe, job.maps
    for i, stroke in enumerate(recipe.strokes):
        if stroke.ndim != 3 and not stroke.hidden:
            which = f"stroke {i + 1} of {len(recipe.strokes)}: " if len(recipe.strokes) > 1 else ""
            raise SuppleError(f"{which}a volume's points have three numbers, x, y and z, and {stroke.at} has two")
    located = in_space(recipe, volume.geometry, volume.name, job.volume.world)
    if located.space in ("LPS", "RAS") and located.border == "auto" and located.size not in (None, volume.sizes):
        made_for = " x ".join(map(str, located.size or ()))
        text = f"the recipe is of a volume of {made_for} voxels, and its border, a tenth of each axis, is elsewhere in "
        text += f"{volume.name}: the map is another one; the field of the first volume is the same"
        warn(text, VolumeWarning)
    known = fit_recipe(located, volume.sizes, job.fit, volume.name)
    if maps:
        warn_of_place(volume.geometry, volume.name)
    own = volume.grid.upright()
    if own == volume.grid:
        made = indexed(known, volume.geometry, volume.name)
    else:  # the strokes are on the upright grid around a sheared volume
        there = known if known.is_world else placed(known, volume.geometry, "LPS")
        made = replace(indexed(there, own.geometry("LPS"), volume.name), size=own.sizes)
    unplaced = volume.geometry.convention == "array" and volume.geometry.spacing == (1.0, 1.0, 1.0)
    warn_of_lengths(made, own, volume.name, "voxels" if unplaced else "mm")
    return Deformation.from_recipe(made, own, maps=maps, warn=False)


def warn_of_lengths(recipe: Recipe, grid: Grid, name: str, unit: str) -> None:
    """Warn of a radius that is probably in another unit: larger than the whole image, or smaller than a sample."""
    size = np.multiply(grid.sizes, grid.spacing)
    for stroke in (each for each in recipe.strokes if each.brush != "freeze"):
        if stroke.radius > _HUGE * max(size):
            told = f"{stroke.radius / max(size):.3g} times {name}, of {' x '.join(f'{x:.3g}' for x in size)} {unit}"
        elif stroke.radius < _TINY * min(grid.spacing):
            told = f"{stroke.radius / min(grid.spacing):.2g} times the distance between samples of {name}"
        else:
            continue
        text = f"the radius {stroke.radius:g} {unit} is {told}: lengths are in {unit}"
        warn(text, VolumeWarning)
        return


def in_space(recipe: Recipe, geometry: Geometry, name: str, world: bool) -> Recipe:
    """Return a recipe with the coordinate space of a geometry, if its points are positions in space (``world``).

    SuppleError if the recipe has another space, or the volume has no position in space.
    """
    if not world:
        return recipe
    convention = geometry.convention
    if recipe.space == "pixels":
        text = f"{argument('world')} is for points in millimetres, and the recipe is in pixels: leave it out"
        raise SuppleError(text)
    if convention == "array":
        text = f"{name} does not know where it lies in space: leave {argument('world')} out, and give indices"
        raise SuppleError(text)
    if recipe.is_world and recipe.space != convention:
        text = f"the recipe is in {recipe.space} millimetres, and {argument('world')} means {convention}, as {name} has"
        raise SuppleError(f"{text} them: leave it out")
    return replace(recipe, space=convention)  # type: ignore[arg-type]


def indexed(recipe: Recipe, geometry: Geometry, name: str) -> Recipe:
    """Return a recipe in millimetres converted to indices; a recipe in indices is returned unchanged."""
    if not recipe.is_world:
        return recipe
    if geometry.convention == "array":
        text = f"the recipe is in {recipe.space} millimetres, and {name} does not know where it lies in space"
        raise SuppleError(f"{text}: give a recipe in pixels")
    there = partial(geometry.from_world, convention=recipe.space)
    return replace(recipe, strokes=tuple(_mapped(each, there, geometry) for each in recipe.strokes), space="pixels")


def placed(recipe: Recipe, geometry: Geometry, space: CoordinateSpace) -> Recipe:
    """Return a recipe in indices converted to millimetres, the inverse of `indexed`."""
    there = partial(geometry.to_world, convention=space)
    return replace(recipe, strokes=tuple(_mapped(each, there, geometry) for each in recipe.strokes), space=space)


def _mapped(stroke: Stroke, there: Callable[[Floats], Floats], geometry: Geometry) -> Stroke:
    """Convert a stroke from indices to positions of a volume, or back; ``there`` converts points."""
    origin = there(np.zeros(3))

    def point(p: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(there(np.array(p)).tolist())

    def along(v: tuple[float, ...]) -> tuple[float, ...]:
        return tuple((there(np.array(v)) - origin + 0.0).tolist())

    made, axis = replace(stroke, axis=None).mapped(point, along), stroke.direction
    if axis is None:
        return made
    # A rotation changes its sense between two spaces of opposite handedness.
    way = -1.0 if stroke.brush == "twist" and np.linalg.det(geometry.direction) < 0 else 1.0
    return replace(made, axis=along(tuple(np.multiply(axis, way / np.abs(axis).max()).tolist())))


def filtered(job: Job) -> Sampling:
    """Return the sampling of a volume, with the filter for labels if it has these; SuppleError if it would mix them."""
    name, wanted = job.sampling.filter, "labels" if job.volume.labels == "smooth" else "nearest"
    if job.volume.labels and name not in ("auto", wanted):
        fit = "auto" if wanted == "labels" else wanted
        text = f'{argument("labels")} needs filter "{fit}", which keeps values as they are, found "{name}"'
        raise SuppleError(text)
    return replace(job.sampling, filter=wanted) if job.volume.labels else job.sampling


def warp(job: Job, tell: Tell) -> Warped:
    """Warp a volume, slab by slab, as in `supple.warp_file`; the job's names and options are already checked.

    ``tell`` is called with ``"read"``, then with ``"warp"``, the number of finished slices, and their total, and with
    ``"write"``.
    """
    source, target, known, grid, maps = job.source, job.target, job.volume, job.grid, job.maps
    sampling = filtered(job).along_all_axes()
    tell("read", 0, 1)
    volume = open_volume(source, known)
    if grid is None:
        check_target(target, volume, force=job.force)
    if known.labels and (broken := _first_fraction(volume.samples)) is not None:
        text = f"{argument('labels')} is for whole numbers, and {volume.name} holds {broken:g}: leave it out"
        raise SuppleError(text)
    as_read = volume
    if not (suffix_of(target).startswith(".nii") or suffix_of(target) in derived.SUFFIXES):  # others hold no scaling
        volume = replace(volume, samples=volume.rescaled(), scaling=(1.0, 0.0))
    regrid = grid_on(grid, volume.grid, volume.name, maps)
    seen = volume  # the volume that strokes refer to
    if grid is not None and grid.strokes and grid.reference is not None:
        seen = moved(volume, reference_grid(grid.reference, 3), grid)
    deformation = deformation_of(job, seen)
    warn_of_still(job.recipe.strokes)
    background = None
    if job.outside is None and grid is not None and grid.reference is not None:  # much may lie outside of the input
        background = background_of(as_read, labels=known.labels)
        sampling = replace(sampling, outside="constant", fill=volume.stored(background))
    elif sampling.outside == "constant":
        sampling = replace(sampling, fill=volume.stored(job.sampling.fill))
    like = volume if grid is None or regrid is None else moved(volume, regrid, grid)
    if grid is not None:
        check_target(target, like, force=job.force)
    space = deformation.space_on(regrid, volume.grid)
    frames = volume.samples[0] if volume.series else volume.samples
    work_of(frames.shape, frames.dtype, space, sampling, alpha=False, finite=False)  # raise its errors now
    _warn_of_gaps(volume, sampling.filter)
    mixed = not deformation.is_identity or not (regrid is None or regrid.uncropped().is_same_space(volume.grid))
    if not sampling.keeps_values and mixed:
        warn_of_labels(_looked_at(volume), volume.name, known=volume.is_segmentation)
    with contextlib.ExitStack() as stack:
        if job.save_field is not None:
            from supple.files.transforms import write_transform

            # It is renamed together with the volume: if either cannot be written, neither is.
            place = stack.enter_context(replacing(job.save_field, force=job.force))
            on = (regrid or volume.grid).upright()
            where = on.geometry(like.geometry.convention)
            onto = None if on == deformation.grid else on
            write_transform(place, deformation, where, tolerance=sampling.tolerance, force=True, grid=onto, warn=False)
        found = _written(volume, like, job, space, sampling, tell)
    _copy_sidecar(source, target)
    return Warped(
        Path(source), Path(target), "volume", (deformation,), sampling.tolerance, found.error,
        len(volume.samples) if volume.series else 1, geometry=volume.geometry, grid=regrid,
        own=None if seen.grid == deformation.grid else seen.grid, folded=found.folded, outside=found.outside,
        unsolved=found.unknown, background=background,
    )  # fmt: skip


def background_of(volume: Volume, *, labels: bool | str = False) -> float:
    """Return the scaled fill value outside a volume: 0 for labels, the padding of DICOM, or else the smallest value.

    NaN and infinities are ignored.
    """
    slope, intercept = volume.scaling
    if labels or volume.is_segmentation or volume.components > 1:
        return intercept
    if volume.format == "DICOM" and (padding := padding_of(volume)) is not None:
        return padding
    return slope * (least_of(volume.samples) if slope > 0 else -least_of(volume.samples, -1)) + intercept


def least_of(samples: Any, sign: int = 1) -> float:
    """Return the smallest finite value of ``sign * samples``; 0 if there is none."""
    least, rest = np.inf, (slice(None),) * (len(samples.shape) - 1)
    for k in range(samples.shape[0]):
        slab = np.asarray(samples[(slice(k, k + 1), *rest)], np.float64) * sign
        least = min(least, float(slab.min(initial=np.inf, where=np.isfinite(slab))))
    return least if np.isfinite(least) else 0.0


def moved(volume: Volume, grid: Grid, options: GridOptions) -> Volume:
    """Return the volume to write on another grid, with placeholder samples that take no memory."""
    shape = volume.samples.shape
    shape = (shape[0], *grid.shape) if volume.series else (*grid.shape, *shape[3:])
    known = volume.geometry.convention
    convention = "LPS" if known == "array" and options.reference is not None else known
    return volume.moved(np.broadcast_to(np.zeros((), volume.samples.dtype), shape), grid, convention)


def check(job: Job) -> None:
    """Raise SuppleError, before reading, for invalid names of a volume and its field."""
    source, target, force = job.source, job.target, job.force
    if os.path.isdir(source) and Path(os.path.realpath(source)) in Path(os.path.realpath(target)).parents:
        raise SuppleError(f"{shown(target)} is within {shown(source)}, and would be read with it: write elsewhere")
    if suffix_of(target) in derived.SUFFIXES and is_dicom(job.source):
        derived.check(target, force=force)
    else:
        check_output(target, force=force)
        check_target(target, force=force)
    if job.save_field is not None:
        from supple.media.transforms import check_target as check_field

        check_field(job.save_field)
        if Path(os.path.realpath(target)) in Path(os.path.realpath(job.save_field)).parents:
            told = f"{shown(job.save_field)} is within {shown(target)}, a folder that is for slices alone"
            raise SuppleError(f"{told}: write the field elsewhere")


def _warn_of_gaps(volume: Volume, filter: str) -> None:
    if volume.samples.dtype.kind != "f" or filter in ("nearest", "labels"):
        return
    gaps = sum(int(np.count_nonzero(~np.isfinite(slab))) for slab in volume.samples)
    if gaps:
        some, be = ("1 voxel", "is") if gaps == 1 else (f"{gaps} voxels", "are")
        text = f"{some} of {volume.name} {be} NaN or infinite, and so is each voxel that is interpolated from "
        text += 'them: filter "nearest" keeps them as they are, and "linear" spreads them least'
        warn(text, GapWarning)


def _first_fraction(samples: Array) -> float | None:
    """Return the first value that is finite and not an integer; None if there is none."""
    if samples.dtype.kind == "f":
        for slab in samples:
            broken = slab[np.isfinite(slab) & (slab != np.rint(slab))]
            if broken.size:
                return float(broken[0])
    return None


def is_of_labels(volume: Volume) -> bool:
    """Return whether a volume looks like a label map: few integers in large areas."""
    return _is_of_labels(_looked_at(volume))


def _looked_at(volume: Volume) -> Array | None:
    if volume.components != 1:
        return None
    samples = volume.samples[0] if volume.series else volume.samples
    return np.asarray(samples[:: -(-len(samples) // _LOOKED_AT)])


def warn_of_labels(some: Array | None, name: str, *, known: bool = False) -> None:
    """Warn of interpolated labels, if samples (Z, H, W) look like those of a label map: few integers in large areas.

    With ``known``, they are a label map.
    """
    if not (known or _is_of_labels(some)):
        return
    told = "is a label map" if known or some is None else f"looks like a label map, of {len(np.unique(some))} values"
    text = f"{name} {told}, and its labels are mixed where they meet: {argument('labels', True)} keeps them"
    warn(text, VolumeWarning)


def _is_of_labels(some: Array | None) -> bool:
    if some is None:
        return False
    left, right = some[..., :-1], some[..., 1:]
    seen = (left != some.flat[0]) | (right != some.flat[0])  # the first voxel is assumed to be background
    same = left == right
    areas = np.count_nonzero(same & seen) >= _AREAS * max(int(np.count_nonzero(seen)), 1)
    if not areas or _first_fraction(some) is not None:
        return False
    # Labels meet without intermediate values, which soft edges of masks have.
    first, middle, last = (some[..., k : some.shape[-1] - 2 + k] for k in range(3))
    between = ((first < middle) & (middle < last)) | ((first > middle) & (middle > last))
    if np.count_nonzero(between) > _BETWEEN * np.count_nonzero(~same):
        return False
    count = len(np.unique(some))
    # In a smooth image of few values, neighbours differ by 1.
    steps = np.abs(np.subtract(left, right, dtype=float)[~same])
    return count <= _MOST_LABELS and (count <= _FEW or float(np.median(steps)) > 1)


def _written(volume: Volume, like: Volume, job: Job, space: Space, sampling: Sampling, tell: Tell) -> Certificate:
    """Warp and write a volume with the sizes and the header of ``like``; return the certificate of the map."""
    source, target, force = job.source, job.target, job.force
    series = volume.samples if volume.series else volume.samples[None]
    count, certificate = len(series), Certificate(0.0, 0.0)
    suffix = suffix_of(source)  # single files alone are copied; DICOM is always derived, with new UIDs
    alone = suffix and suffix == suffix_of(target) and suffix not in (".mhd", ".nhdr", ".hdr", ".img", ".dcm")
    if space.is_identity and os.path.isfile(source) and alone:
        tell("write", 0, 1)
        with replacing(target, force=force) as place:
            shutil.copyfile(source, place)
        return certificate
    dtype = series.dtype.newbyteorder("=")

    def settle() -> None:  # before the target is renamed
        warn_of_maps(certificate, sampling.tolerance, job.maps, "voxels")
        tell("write", 0, 1)

    def slabs() -> Iterator[Array]:
        nonlocal certificate
        buffer = np.empty((_SLAB, *like.samples.shape[1:]), dtype)
        whole, depth = space.grid or volume.grid, space.out[0]
        for z in range(0, depth, _SLAB):
            out = buffer[: depth - z]
            part = replace(space, grid=whole.crop((0, 0, z), (*whole.sizes[:2], len(out))))
            _, known = warp_array(series[0], part, sampling, alpha=False, out=out)
            certificate |= known
            tell("warp", z + len(out), depth)
            yield out
        settle()

    plain = like.samples.ndim == 3 and dtype.kind in "iu" and sampling.filter in ("linear", "nearest")
    if plain and suffix_of(target).startswith(".nii") and job.device == "cpu" and not space.is_identity:
        flow: Any = Flowing(like.samples.shape, dtype, slabs())
        write(target, flow, like, force=force)
    else:
        shape = like.samples.shape if volume.series else (1, *like.samples.shape)
        with beside(target, shape, dtype, machine_memory() / 4) as out:
            for t in range(count):

                def further(step: str, done: int, total: int, begun: int = t * space.out[0]) -> None:
                    tell(step, begun + done, count * total)

                _, known = warp_array(
                    series[t], space, sampling, alpha=False, device=job.device, out=out[t], tell=further
                )
                certificate |= known
            if job.clamp is not False and not space.is_identity:
                clamp_to(series, out, sampling)
            settle()
            write(target, out if volume.series else out[0], like, force=force)
    return certificate


def _copy_sidecar(source: PathLike, target: PathLike) -> None:
    """Copy the BIDS sidecar (JSON) of a NIfTI to the output; an existing one is kept."""
    if not (suffix_of(source).startswith(".nii") and suffix_of(target).startswith(".nii")):
        return
    theirs, ours = (Path(f"{os.fspath(path)[: -len(suffix_of(path))]}.json") for path in (source, target))
    try:
        text = theirs.read_text(encoding="utf-8")
        known = json.loads(text)
        if not isinstance(known, dict) or "strokes" in known or (ours.exists() and ours.read_text("utf-8") == text):
            return
    except (OSError, ValueError, RecursionError):  # missing, or not a sidecar
        return
    if os.path.lexists(ours):
        told = f"{shown(ours)} is there already, and stays as it is: {shown(theirs)} is not copied to it"
        warn(told, VolumeWarning)
        return
    try:
        with replacing(ours) as place:
            place.write_text(text, encoding="utf-8")
    except SuppleError as error:  # only a warning: the volume is written
        warn(str(error), VolumeWarning)
