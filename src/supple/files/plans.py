"""The plan of a warp in blocks, computed from the input's header: its blocks, copies, bytes and memory."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from supple._core import threads
from supple.blocks import Block, Box, Warp, boxes_of, chunks_of
from supple.deformation import Deformation
from supple.engine.sampling import Certificate, warn_of
from supple.engine.work import Tell, work_of
from supple.errors import SuppleError, argument, shown
from supple.fields import folds_of, only_name
from supple.files.grids import grid_on
from supple.files.jobs import Job
from supple.files.tasks import Runner, Running, runner_of
from supple.files.volumes import deformation_of, filtered
from supple.media.files import is_store, unreadable
from supple.media.stores.image import StoredImage, open_image
from supple.media.stores.inputs import Samples, grow, like_file
from supple.media.volume import Volume
from supple.space.geometry import Geometry, Grid
from supple.strokes import fit_recipe

TASK = 1 << 25
"""The size in bytes of a task's block, where chunks are smaller."""
_TURNS = 4  # the fewest tasks for each thread, so that none idles long at the end
_PORTION = 1024  # blocks that are planned at a time, before they are written


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """An input that will be warped block by block; no samples have been read."""

    name: str  # for messages
    image: StoredImage  # the store's image, or the one that a file is converted to
    samples: Any  # an array or `Samples`, which is sliced
    geometry: Geometry | None  # of a volume; None for a picture
    scaling: tuple[float, float] = (1.0, 0.0)  # slope and intercept; a Zarr array's scale_factor and add_offset
    background: float = 0.0  # the scaled fill value outside a volume

    @property
    def is_file(self) -> bool:
        """True if it is a file, and not a Zarr store."""
        return isinstance(self.samples, Samples)

    @property
    def carried(self) -> int:
        """The number of axes before those of space."""
        return len(self.image.axes) - len(self.image.spatial)

    @property
    def space(self) -> tuple[int, ...]:
        """The shape along the axes of space."""
        return self.image.shape[self.carried :]

    @property
    def grid(self) -> Grid:
        """The grid of the samples: in pixels, or in millimetres."""
        return Grid(self.space) if self.geometry is None else self.geometry.grid(self.space)


@dataclass(frozen=True, slots=True)
class Planned:
    """The plan of a job, made without reading samples; bytes are those of decoded samples."""

    shape: tuple[int, ...]  # of the output, all axes
    dtype: str
    block: tuple[int, ...]  # the shape of a task's block
    blocks: int
    copied: int  # blocks that are copies, since no stroke reaches them
    read: int  # bytes to read, without copies; a chunk counts as often as it is read
    copied_bytes: int
    tasks: int  # tasks that run at a time
    memory: int  # bytes in memory for these tasks: chunks, samples read, and the block
    size: int  # bytes of the output, with all levels
    error: float  # the error estimate from the checks of the map, in samples


def plan_file(job: Job, running: Running | None = None, tell: Tell = lambda step, done, total: None) -> Planned:
    """Plan the warp of a store, a volume or a picture to a store; only the header is read, where possible."""
    opened = open_source(job)
    image, carried, item, chunks = opened.image, opened.carried, opened.image.dtype.itemsize, opened.samples.chunks
    warp = warp_on(opened, job)
    shape = (*image.shape[:carried], *warp.shape)
    workers = (running or Running()).workers
    slots = threads() if workers is None else max(1, round(threads() / workers))
    task = task_shape(image.levels[0].array.metadata.chunk_grid.chunk_shape, shape, item, carried, threads())
    sizes = chunks_of(task, shape)
    leads, positions = math.prod(map(len, sizes[:carried])), math.prod(shape[:carried])
    copied, read, copied_bytes, most = 0, 0, 0, 0
    with runner_of(Running()) as runner:
        for blocks, certificate, _ in planned(warp, sizes[carried:], runner, tell):  # noqa: B007, the last one counts
            for one in blocks:
                count = math.prod(one.shape) * item
                if one.identity and one.part == one.box:
                    copied += leads
                    copied_bytes += count * positions
                    continue
                part = whole_chunks(one.part, opened.space, chunks and chunks[carried:]) * item
                read += part * positions
                own = math.prod(b - a for a, b in one.part) * item
                most = max(most, (part + own + 2 * count) * math.prod(task[:carried]))
    warn_of(certificate, warp.sampling.tolerance, 3, folds_of(job.maps), only_name(job.maps))
    levels = sum(math.prod(level.array.shape) / math.prod(image.shape) for level in image.levels)
    return Planned(
        shape, str(image.dtype), task, math.prod(map(len, sizes)), copied, read, copied_bytes, slots, most * slots,
        round(levels * math.prod(shape) * item), certificate.error,
    )  # fmt: skip


def open_source(job: Job) -> Source:
    """Open an input as a picture or a volume, by the number of coordinates of the strokes, or else by its own axes.

    SuppleError if it cannot be read; if an option does not apply to it; or if it has fewer axes of space than the
    strokes, the maps or the grid.
    """
    known, source = job.volume, job.source
    if not is_store(source):
        if replace(job, target=source).medium.kind == "clip":
            kind = "folder without a volume" if os.path.isdir(source) else "clip"
            raise SuppleError(
                f"{shown(source)} is a {kind}, and blocks are of pictures, volumes and Zarr stores: give one of these"
            )
        samples = Samples(source, raw=known.layout, series=known.series, irregular=known.irregular)
        n = _axes_of_space(job, 3 if "z" in samples.axes else 2)
        geometry = samples.geometry if n == 3 else None
        return Source(shown(source), like_file(source, samples, ndim=n), samples, geometry)
    for name in ("series", "irregular", "layout"):
        if getattr(known, name) is not None:
            raise SuppleError(f"Zarr stores take no {argument(name)}: leave that out")
    image = open_image(source)
    n = _axes_of_space(job, len(image.spatial))
    image = image if n == len(image.spatial) else open_image(source, ndim=n)
    names, usual = [image.axes[axis].name.lower() for axis in image.spatial], list("zyx"[-n:])
    if sorted(names) == sorted(usual) and names != usual:  # the x of points is along the last axis
        what = f"its axes of space are {', '.join(names)}, in this order"
        raise unreadable(image.address, what, f"store them in the order {', '.join(usual)}, as OME-Zarr has them")
    geometry = None
    if n == 3:
        geometry = image.grid.geometry("LPS") if image.placed else Geometry()
    array = image.levels[0].array
    scaling = 1.0, 0.0
    with contextlib.suppress(TypeError, ValueError):  # for attributes that are not numbers
        scaling = float(array.attrs.get("scale_factor", 1)), float(array.attrs.get("add_offset", 0))
    scaling = scaling if scaling[0] else (1.0, 0.0)
    fill = array.metadata.fill_value
    number = isinstance(fill, int | float | np.number) and np.isfinite(fill)
    background = float(fill) * scaling[0] + scaling[1] if number else 0.0
    return Source(shown(image.address), image, array, geometry, scaling, background)


def _axes_of_space(job: Job, found: int) -> int:
    stated = [stroke.ndim for stroke in job.recipe.strokes[:1]] + [each.map.ndim for each in job.maps[:1]]
    n = stated[0] if stated else job.grid.ndim if job.grid is not None else None
    if n is not None and n > found:
        text = f"{shown(job.source)} is a picture, with {found} axes of space, and strokes, maps or the crop have {n}"
        raise SuppleError(f"{text}: give points of two numbers, x and y")
    return n or found


def warp_on(source: Source, job: Job) -> Warp:
    """Return the warp of an input by a job's recipe, for planning; SuppleError if an option does not fit the input."""
    known, dtype, maps, sampling = job.volume, source.image.dtype, job.maps, job.sampling
    if job.grid is not None and job.grid.strokes:
        raise SuppleError(f"{argument('fixed')} is for files of volumes, and {source.name} is a store: leave it out")
    if job.outside is None:
        elsewhere = job.grid is not None and job.grid.reference is not None
        outside = "constant" if source.geometry is not None and elsewhere else "edge"
        sampling = replace(sampling, outside=outside, fill=0.0 if known.labels else source.background)
    sampling = replace(sampling, filter=filtered(job).filter)
    if known.labels and dtype.kind == "f":
        raise SuppleError(f"{argument('labels')} is for whole numbers, and {source.name} holds {dtype}: leave it out")
    whole = np.broadcast_to(np.zeros((), dtype), source.space)  # which takes no memory
    if sampling.outside == "constant":
        volume = Volume(whole, Geometry(), source.name, scaling=source.scaling)
        sampling = replace(sampling, fill=volume.stored(sampling.fill))
    if job.recipe.straighten is not None:
        raise SuppleError("straightening is for files of pictures, and not to or from Zarr stores: leave it out")
    if source.geometry is None:
        if known.world:
            raise SuppleError(f"{argument('world')} is for volumes, and {source.name} is a picture: leave it out")
        height, width = source.space
        regrid = grid_on(job.grid, source.grid, source.name, maps)
        fitted = fit_recipe(job.recipe, (width, height), job.fit, source.name)
        deformation = Deformation.from_recipe(fitted, source.grid, maps=maps, warn=False)
    else:
        sampling = sampling.along_all_axes()
        regrid = grid_on(job.grid, source.grid, source.name, maps)
        volume = Volume(whole, source.geometry, source.name)
        deformation = deformation_of(job.recipe, volume, world=known.world, fit=job.fit, maps=maps)
    work_of(whole.shape, whole.dtype, deformation.space_on(regrid), sampling, alpha=False)  # raise its errors now
    return Warp(deformation, sampling, regrid)


def task_shape(
    block: Sequence[int], shape: Sequence[int], itemsize: int, carried: int, slots: int, limit: int | None = None
) -> tuple[int, ...]:
    """Return the shape of a task's block: one block of the output, or several if they are small.

    It grows along the axes of space first, the shortest of them first: growing along the other axes would not reduce
    the samples that are read for each block.
    """
    most = min((limit or TASK) / itemsize, math.prod(shape) / (_TURNS * slots))
    sizes = [min(a, b) for a, b in zip(block, shape, strict=True)]
    for axes in (range(carried, len(shape)), range(carried)):
        grow(sizes, shape, axes, most, lambda k: min(-(-sizes[k] // block[k]) * 2 * block[k], shape[k]))
    return tuple(sizes)


def planned(
    warp: Warp, chunks: Sequence[Sequence[int]], runner: Runner, tell: Tell
) -> Iterator[tuple[list[Block], Certificate, bool]]:
    """Yield lists of blocks, with the certificate of all blocks so far, and whether the list is the last.

    A list holds whole layers, that is, all blocks with the same planes: whether a plane is a copy depends on all blocks
    of its layer, and on no others.
    """
    boxes: list[Box] = []
    certificate, done, total = Certificate(0.0, 0.0), 0, math.prod(map(len, chunks))
    for first in boxes_of(chunks[:1]):
        boxes += [(*first, *rest) for rest in boxes_of(chunks[1:])]
        if len(boxes) >= _PORTION or done + len(boxes) == total:
            blocks, found = warp.plan(boxes, lambda warp, boxes: runner.each(Warp.reads, warp, boxes, lambda: None))
            certificate |= found
            done += len(boxes)
            tell("plan", done, total)
            yield blocks, certificate, done == total
            boxes = []


def whole_chunks(part: Box, shape: Sequence[int], chunks: Sequence[int] | None) -> int:
    """Return the number of samples in the chunks that overlap a part."""
    if chunks is None:
        return math.prod(b - a for a, b in part)
    ends = [(a // n * n, min(-(-b // n) * n, size)) for (a, b), n, size in zip(part, chunks, shape, strict=True)]
    return math.prod(b - a for a, b in ends)
