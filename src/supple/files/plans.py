"""What a warp in blocks would read and write, found from the header of an input: blocks, copies, bytes, memory."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple._core import threads
from supple.blocks import Block, Box, Read, Warp, batches, boxes_of
from supple.deformation import Deformation
from supple.engine.sampling import Certificate, Sampling, warn_of
from supple.engine.work import Tell, work_of
from supple.errors import SuppleError, shown
from supple.fields import Placed, folds_of, only_name
from supple.files.clips import is_clip
from supple.files.grids import GridOptions, grid_on
from supple.files.tasks import Runner, Running, runner_of
from supple.files.volumes import VolumeOptions, deformation_of, is_volume_job, sampling_of
from supple.media.files import is_store, unreadable
from supple.media.stores import Samples, StoredImage, like_file, open_image
from supple.media.volume import Volume
from supple.space.geometry import Geometry, Grid
from supple.strokes import Fit, Recipe, fit_recipe

PathLike = str | os.PathLike[str]

TASK = 1 << 25
"""Bytes of a block that a task writes, where chunks are smaller."""
_TURNS = 4  # tasks of each thread, at least, so that none waits long for the last ones
_PORTION = 1024  # blocks that are planned before they are written: neither waits for all the others


@dataclass(frozen=True, slots=True)
class Medium:
    """What is known of an input before a sample is read.

    Parameters
    ----------
    name : str
        For messages.
    shape : tuple of int
        Of all axes; those of space are the last ones.
    dtype : dtype
        The type of the samples.
    geometry : Geometry, optional
        The place of a volume in space; None of a picture.
    scaling : (float, float)
        Slope and intercept of the samples: of a Zarr array, the attributes ``scale_factor`` and ``add_offset``.
    background : float
        The true value of what lies outside of a volume, by the scaling.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    geometry: Geometry | None
    scaling: tuple[float, float] = (1.0, 0.0)
    background: float = 0.0

    @property
    def space(self) -> tuple[int, ...]:
        """The shape along the axes of space."""
        return self.shape[-2:] if self.geometry is None else self.shape[-3:]

    @property
    def grid(self) -> Grid:
        """The grid of the samples: in pixels, or in millimetres."""
        return Grid(self.space) if self.geometry is None else self.geometry.grid(self.space)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """An input that is warped block by block.

    Parameters
    ----------
    image : StoredImage
        What a store is, or what a file becomes.
    medium : Medium
    samples : array or Samples
        It is sliced.
    """

    image: StoredImage
    medium: Medium
    samples: Any

    @property
    def is_file(self) -> bool:
        """Whether it is no store."""
        return isinstance(self.samples, Samples)


@dataclass(frozen=True, slots=True)
class Planned:
    """What a job would do, found without reading a sample.

    Parameters
    ----------
    shape : tuple of int
        The shape of the output, of all axes.
    dtype : str
        The type of its samples.
    block : tuple of int
        The shape of what a task writes.
    blocks, copied : int
        The number of blocks, and of those that are copies, since no stroke reaches them.
    read : int
        Bytes of the samples that are read, decoded, without copies: whole chunks, as often as they are read.
    copied_bytes : int
        Bytes of the samples of copies, decoded.
    tasks : int
        The number of tasks that a worker does at a time.
    memory : int
        Bytes that these take: chunks, the part that is read, and the block.
    size : int
        Bytes of the output, with all levels, decoded.
    error : float
        The error estimate from the checks of the map, in samples.
    """

    shape: tuple[int, ...]
    dtype: str
    block: tuple[int, ...]
    blocks: int
    copied: int
    read: int
    copied_bytes: int
    tasks: int
    memory: int
    size: int
    error: float


def plan_file(
    source: PathLike,
    recipe: Recipe,
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str | None = None,
    fill: float | Sequence[float] = 0.0,
    options: VolumeOptions | None = None,
    fit: Fit | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
    running: Running | None = None,
    tell: Tell = lambda step, done, total: None,
) -> Planned:
    """Plan the warp of a store, a volume or a picture to a store; if possible, its header alone is read.

    Parameters and errors are those of `warp_store`.
    """
    known = options or VolumeOptions()
    opened = open_source(source, recipe, known, maps=maps, grid=grid)
    image, medium, chunks = opened.image, opened.medium, opened.samples.chunks
    block = tuple(image.levels[0].array.metadata.chunk_grid.chunk_shape)
    smaller = [math.prod(level.array.shape) / math.prod(medium.shape) for level in image.levels]
    warp = warp_on(
        medium, recipe, filter=filter, tolerance=tolerance, outside=outside, fill=fill, options=known, fit=fit,
        maps=maps, grid=grid,
    )  # fmt: skip
    carried, item = len(medium.shape) - len(medium.space), medium.dtype.itemsize
    shape = (*medium.shape[:carried], *warp.shape)
    where = running or Running()
    slots = threads() if where.workers is None else max(1, round(threads() / where.workers))
    task = task_shape(block, shape, item, carried, threads())
    sizes = chunks_of(task, shape)
    leads = math.prod(map(len, sizes[:carried]))
    each, positions = math.prod(task[:carried]), math.prod(shape[:carried])
    blocks, copied, read, held, most, done = 0, 0, 0, 0, 0, 0
    certificate = Certificate(0.0, 0.0)
    total = math.prod(map(len, sizes[carried:]))
    with runner_of(Running()) as runner:
        for portion in portions(layers(sizes[carried:])):
            boxes = list(itertools.chain.from_iterable(portion))
            planned, found = plan_boxes(warp, boxes, runner)
            certificate |= found
            done += len(boxes)
            tell("plan", done, total)
            for one in planned:
                blocks += leads
                count = math.prod(one.shape) * item
                if one.identity and one.part == one.box:
                    copied += leads
                    held += count * positions
                    continue
                part = whole_chunks(one.part, medium.space, chunks and chunks[carried:]) * item
                read += part * positions
                most = max(most, (part + math.prod(b - a for a, b in one.part) * item + 2 * count) * each)
    warn_of(certificate, warp.sampling.tolerance, 3, folds_of(maps), only_name(maps))
    levels = sum(smaller) * math.prod(shape) * item
    return Planned(
        shape, str(medium.dtype), task, blocks, copied, read, held, slots, most * slots, round(levels),
        certificate.error,
    )  # fmt: skip


def open_source(
    source: PathLike,
    recipe: Recipe,
    options: VolumeOptions | None = None,
    *,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Source:
    """Open an input as a picture or as a volume: as the points of the strokes say, or else as it says itself.

    Raises
    ------
    SuppleError
        If it cannot be read, an option does not apply to it, or it has fewer axes of space than the strokes, the maps
        or the grid.
    """
    known = options or VolumeOptions()
    if is_store(source):
        check_options(known)
        image = open_image(source)
        n = _axes_of_space(source, len(image.spatial), recipe, maps, grid)
        image = image if n == len(image.spatial) else open_image(source, ndim=n)
        _check_order(image)
        return Source(image, medium_of(image), image.levels[0].array)
    _refuse_clip(source, recipe, known, maps, grid)
    samples = Samples(source, raw=known.layout, series=known.series)
    n = _axes_of_space(source, 3 if "z" in samples.axes else 2, recipe, maps, grid)
    geometry = samples.geometry if n == 3 else None
    medium = Medium(shown(source), samples.shape, samples.dtype, geometry)
    return Source(like_file(source, samples, ndim=n), medium, samples)


def _check_order(image: StoredImage) -> None:
    """Raise SuppleError for axes that are named otherwise than points are meant: x along the last one."""
    names = [image.axes[axis].name.lower() for axis in image.spatial]
    usual = list("zyx"[-len(names) :])
    if sorted(names) == sorted(usual) and names != usual:
        raise unreadable(
            image.address,
            f"its axes of space are {', '.join(names)}, in this order",
            f"store them in the order {', '.join(usual)}, as OME-Zarr has them",
        )


def _axes_of_space(
    source: PathLike, found: int, recipe: Recipe, maps: Sequence[Placed], grid: GridOptions | None
) -> int:
    """Return the number of axes that are bent."""
    told = [stroke.ndim for stroke in recipe.strokes[:1]] + [each.map.ndim for each in maps[:1]]
    n = told[0] if told else grid.ndim if grid is not None else None
    if n is not None and n > found:
        raise SuppleError(
            f"{shown(source)} is a picture, with {found} axes of space, and strokes, maps or the crop have {n}: give "
            "points of two numbers, x and y"
        )
    return n or found


def _refuse_clip(
    source: PathLike, recipe: Recipe, options: VolumeOptions, maps: Sequence[Placed], grid: GridOptions | None
) -> None:
    if is_volume_job(source, source, recipe, options, maps=maps, grid=grid):
        return
    if is_clip(source, source, recipe):
        kind = "folder without a volume" if os.path.isdir(source) else "clip"
        raise SuppleError(
            f"{shown(source)} is a {kind}, and blocks are of pictures, volumes and Zarr stores: give one of these"
        )


def medium_of(image: StoredImage) -> Medium:
    """Return what is known of a stored image: a picture in pixels, or a volume in millimetres."""
    name, geometry = shown(image.address), None
    if len(image.spatial) == 3:
        geometry = image.grid.geometry("LPS") if image.placed else Geometry()
    told, scaling = image.levels[0].array.attrs, (1.0, 0.0)
    with contextlib.suppress(TypeError, ValueError):  # of what is no number
        scaling = float(told.get("scale_factor", 1)), float(told.get("add_offset", 0))
    scaling = scaling if scaling[0] else (1.0, 0.0)
    filled = image.levels[0].array.metadata.fill_value
    known = isinstance(filled, int | float | np.number) and np.isfinite(filled)
    background = float(filled) * scaling[0] + scaling[1] if known else 0.0
    return Medium(name, image.shape, image.dtype, geometry, scaling, background)


def check_options(options: VolumeOptions) -> None:
    """Raise SuppleError for options of volumes that stores do not have."""
    for name, given in (("series", options.series), ("shape", options.layout)):
        if given is not None:
            raise SuppleError(f"{name} is not for Zarr stores: leave it out")


def warp_on(
    medium: Medium,
    recipe: Recipe,
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str | None = None,
    fill: float | Sequence[float] = 0.0,
    options: VolumeOptions | None = None,
    fit: Fit | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Warp:
    """Return a recipe on an input, ready to be planned.

    Raises
    ------
    SuppleError
        If an option does not fit the input.
    """
    known = options or VolumeOptions()
    if outside is None:
        elsewhere = grid is not None and grid.reference is not None
        outside = "constant" if medium.geometry is not None and elsewhere else "edge"
        fill = 0.0 if known.labels else medium.background
    if known.labels and filter not in ("auto", "nearest"):
        raise SuppleError(f'labels needs filter "nearest", which keeps values as they are, found "{filter}"')
    if known.labels and medium.dtype.kind == "f":
        raise SuppleError(f"labels is for whole numbers, and {medium.name} holds {medium.dtype}: leave it out")
    name = "nearest" if known.labels else filter
    whole = np.broadcast_to(np.zeros((), medium.dtype), medium.space)  # which takes no memory
    if outside == "constant":
        fill = Volume(whole, Geometry(), medium.name, scaling=medium.scaling).stored(fill)
    if medium.geometry is None:
        if known.world:
            raise SuppleError(f"world is for volumes, and {medium.name} is a picture: leave it out")
        sampling = Sampling.checked(2, filter=name, tolerance=tolerance, outside=outside, fill=fill)
        height, width = medium.space
        regrid = grid_on(grid, medium.grid, medium.name, maps)
        fitted = fit_recipe(recipe, (width, height), fit, medium.name)
        deformation = Deformation.from_recipe(fitted, medium.grid, maps=maps, warn=False)
    else:
        sampling = sampling_of(name, outside=outside, fill=fill, tolerance=tolerance)
        regrid = grid_on(grid, medium.grid, medium.name, maps)
        volume = Volume(whole, medium.geometry, medium.name)
        deformation = deformation_of(recipe, volume, world=known.world, fit=fit, maps=maps)
    work_of(whole.shape, whole.dtype, deformation.space_on(regrid), sampling, alpha=False)  # raise its errors now
    return Warp(deformation, sampling, regrid)


def task_shape(
    block: Sequence[int], shape: Sequence[int], itemsize: int, carried: int, slots: int, limit: int | None = None
) -> tuple[int, ...]:
    """Return the shape of what a task writes: whole blocks, several of them where they are small.

    They grow along the axes of space first, the shortest before the others, since a task that has several of the
    positions that are carried along reads no less for each.
    """
    whole = math.prod(shape) * itemsize
    most = min(limit or TASK, whole / (_TURNS * slots))
    made = [min(a, b) for a, b in zip(block, shape, strict=True)]
    for axes in (range(carried, len(shape)), range(carried)):
        while growing := [k for k in axes if made[k] < shape[k]]:
            k = min(growing, key=lambda axis: made[axis])
            wider = min(-(-made[k] // block[k]) * 2 * block[k], shape[k])
            if math.prod(made) // made[k] * wider * itemsize > most:
                break
            made[k] = wider
    return tuple(made)


def chunks_of(task: Sequence[int], shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Return the sizes along each axis of tasks of a shape, of which the last may be smaller."""
    return [(n,) * (size // n) + ((size % n,) if size % n else ()) for n, size in zip(task, shape, strict=True)]


def layers(chunks: Sequence[Sequence[int]]) -> Iterator[list[Box]]:
    """Yield the places of blocks that have the same planes."""
    for first in boxes_of(chunks[:1]):
        yield [(*first, *rest) for rest in boxes_of(chunks[1:])]


def portions(stacked: Iterator[list[Box]]) -> Iterator[list[list[Box]]]:
    """Yield layers together. Whether a plane is a copy is known from all blocks of its layer, and from no others."""
    made: list[list[Box]] = []
    for layer in stacked:
        made.append(layer)
        if sum(map(len, made)) >= _PORTION:
            yield made
            made = []
    if made:
        yield made


def plan_boxes(warp: Warp, boxes: Sequence[Box], runner: Runner) -> tuple[list[Block], Certificate]:
    """Find what blocks read, which together are whole layers."""

    def each(warp: Warp, boxes: Sequence[Box]) -> list[Read]:
        found = runner.each(Warp.all_reads, warp, batches(boxes), lambda: None)
        return [one for part in found for one in part]

    return warp.plan(boxes, each)


def whole_chunks(part: Box, shape: Sequence[int], chunks: Sequence[int] | None) -> int:
    """Return the number of samples of the chunks that a part meets."""
    if chunks is None:
        return math.prod(b - a for a, b in part)
    ends = [(a // n * n, min(-(-b // n) * n, size)) for (a, b), n, size in zip(part, chunks, shape, strict=True)]
    return math.prod(b - a for a, b in ends)
