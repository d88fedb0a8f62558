"""The plan of a warp in blocks, computed from the input's header: its blocks, copies, bytes and memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from supple._core import threads
from supple.blocks import Block, Box, Warp, boxes_of, chunks_of
from supple.deformation import Deformation
from supple.engine.sampling import Certificate, warn_of
from supple.engine.work import Tell, work_of
from supple.errors import SuppleError, argument
from supple.fields import folds_of, only_name
from supple.files.grids import grid_on
from supple.files.jobs import Job
from supple.files.options import Running
from supple.files.tasks import Runner, runner_of
from supple.files.volumes import deformation_of, filtered
from supple.media.stores.inputs import Source, grow
from supple.strokes import fit_recipe

TASK = 1 << 25
"""The size in bytes of a task's block, where chunks are smaller."""
_TURNS = 4  # the fewest tasks for each thread, so that none idles long at the end
_PORTION = 1024  # blocks that are planned at a time, before they are written
PLANNED = "planned.zarr"
"""The output of a plan, which is not written."""


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


def plan_file(job: Job, tell: Tell = lambda step, done, total: None) -> Planned:
    """Plan the warp of a store, a volume or a picture to a store; only the header is read, where possible."""
    job = replace(job, target=PLANNED)
    job.check_options()
    opened = job.medium.stored
    image, carried, item, chunks = opened.image, opened.carried, opened.image.dtype.itemsize, opened.samples.chunks
    warp = warp_on(opened, job)
    shape = (*image.shape[:carried], *warp.shape)
    slots = max(1, round(threads() / (job.running.workers or 1)))
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


def warp_on(source: Source, job: Job) -> Warp:
    """Return the warp of an input by a job's recipe, for planning; SuppleError if an option does not fit the input."""
    known, dtype, maps, sampling, volume = job.volume, source.image.dtype, job.maps, job.sampling, source.outline
    if job.outside is None:
        elsewhere = job.grid is not None and job.grid.reference is not None
        outside = "constant" if source.geometry is not None and elsewhere else "edge"
        sampling = replace(sampling, outside=outside, fill=0.0 if known.labels else source.background)
    sampling = replace(sampling, filter=filtered(job).filter)
    if known.labels and dtype.kind == "f":
        raise SuppleError(f"{argument('labels')} is for whole numbers, and {source.name} holds {dtype}: leave it out")
    if sampling.outside == "constant":
        sampling = replace(sampling, fill=volume.stored(sampling.fill))
    regrid = grid_on(job.grid, source.grid, source.name, maps)
    if source.geometry is None:
        if known.world:
            raise SuppleError(f"{argument('world')} is for volumes, and {source.name} is a picture: leave it out")
        fitted = fit_recipe(job.recipe, source.grid.sizes, job.fit, source.name)
        deformation = Deformation.from_recipe(fitted, source.grid, maps=maps, warn=False)
    else:
        sampling = sampling.along_all_axes()
        deformation = deformation_of(job, volume)
    work_of(source.space, dtype, deformation.space_on(regrid), sampling, alpha=False)  # raise its errors now
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
