"""Warping Zarr stores block by block: arrays larger than memory, on threads, processes or a cluster.

The plan of a warp is computed from the input's header: its blocks, copies, bytes and memory.
"""

from __future__ import annotations

import glob
import hashlib
import itertools
import math
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from supple._core import threads
from supple.blocks import Block, Box, Warp, boxes_of, chunks_of
from supple.deformation import Deformation
from supple.engine.sampling import Certificate, Sampling
from supple.engine.work import Tell, work_of
from supple.errors import SuppleError, VolumeWarning, argument, shown, warn
from supple.fields import Field, Placed, warn_of_maps
from supple.files.grids import grid_on
from supple.files.jobs import Job, Warped
from supple.files.options import Running, VolumeOptions
from supple.files.tasks import Runner, advancing, check_seen, check_shared, runner_of
from supple.files.transforms import SavedField, begin_field, check_field, write_field, write_transform
from supple.files.volumes import deformation_of, filtered, least_of, warn_of_labels
from supple.media.files import ROOTS, PathLike, check_store, is_store, replacing, unwritable
from supple.media.stores.image import LABELS, StoredImage
from supple.media.stores.inputs import Source, grow
from supple.media.stores.levels import Mode
from supple.media.stores.places import Place
from supple.media.stores.target import Target, create, holding
from supple.media.transforms.ngff import Placement
from supple.space.geometry import Grid
from supple.strokes import fit_recipe

Numbers = tuple[float, ...]

_SIDE = 64  # voxels on a side of the part in which labels are detected
_AT_ONCE = 4096  # tasks in the queue; each takes a few kilobytes
TASK = 1 << 25
"""The size in bytes of a task's block, where chunks are smaller."""
_TURNS = 4  # the fewest tasks for each thread, so that none idles long at the end
_PORTION = 1024  # blocks that are planned at a time, before they are written
PLANNED = "planned.zarr"
"""The output of a plan, which is not written."""


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """The data that all tasks of a job share: a few kilobytes, plus displacement fields."""

    place: Place  # of the input, as an absolute path, since workers may run in another folder
    samples: Any  # supports slicing
    stored: bool  # whether the input is a store, whose chunks can be copied
    carried: int  # the number of axes before those of space
    target: Target
    warp: Warp


def check(job: Job) -> None:
    """Raise SuppleError for an output that is no store, or cannot be written, before workers are started."""
    source, target = job.source, job.target
    if not is_store(target):
        what = f"{shown(source)} is a Zarr store, and becomes one, which {shown(target)} is not"
        raise SuppleError(f"{what}: name one, such as out.zarr")
    if job.running.elsewhere:
        check_shared((source, target, *([] if job.save_field is None else [job.save_field])))
    folder = Place(target).folder
    if folder is not None:
        check_store(folder if "://" in os.fspath(target) else target, force=job.force)


@holding()
def warp(job: Job, tell: Tell) -> Warped:
    """Warp a Zarr array, an OME-Zarr image, a volume or a picture to a store, block by block, as in `supple.warp_file`.

    Each task reads the part of the input that its block needs; blocks of a store that no stroke reaches are copied
    without decoding. ``tell`` is called with ``"field"``, ``"plan"``, ``"warp"`` and ``"reduce"``, and the finished and
    the total number of blocks. After an error, such as a full disk or lost workers, finished blocks are kept.
    """
    source, target, known, grid, maps, force = job.source, job.target, job.volume, job.grid, job.maps, job.force
    opened = job.medium.stored
    image = opened.image
    if job.outside is None and opened.is_file and opened.geometry is not None and grid is not None and grid.reference:
        least = 0.0 if "c" in opened.samples.axes else least_of(opened.samples)  # as for volumes from file to file
        opened = replace(opened, background=least)
    made = warp_on(opened, job)
    _warn_of_labels(opened, made)
    labels = _labels(opened, job)
    own = _name(opened, made, job)
    field = None
    if job.save_field is not None:
        check_field(job.save_field, (source, target), flat=opened.geometry is None, force=force)
        if is_store(job.save_field):
            scale, translation = _located(opened, made.grid, job.save_field)
            axes = list(image.spatial)
            samples = Placement(made.shape, [scale[axis] for axis in axes], [translation[axis] for axis in axes])
            field = begin_field(job.save_field, image, made, samples, own, force=force)
    other: dict[str, Any] = {} if made.grid is None else {"shape": made.grid.shape}
    if made.grid is not None and image.version:
        other["scale"], other["translation"] = _located(opened, made.grid, target)
    with runner_of(job.running) as runner:
        output = create(target, image, force=force, job=own, **other)
        mapping = None if field is None else field()
        work = Work(Place(image.address), opened.samples, not opened.is_file, opened.carried, output, made)
        saved = None if mapping is None else write_field(mapping, runner, tell, maps)
        counts, certificate = _write_blocks(work, runner, tell, maps, warn=saved is None)
        _write_levels(work, runner, tell, "nearest" if known.labels else "mean")
    if labels:
        output.put_labels(labels, image.version)
    for name in labels:
        here, there = (f"{address.rstrip('/')}/{LABELS}/{name}" for address in (image.address, output.site.address))
        with warnings.catch_warnings():  # warnings about the map were given for the image
            warnings.simplefilter("ignore")
            options = replace(known, labels=known.labels or "nearest")
            plain = Sampling(tolerance=job.sampling.tolerance, outside=job.sampling.outside)
            one = replace(job, source=here, target=there, force=True, volume=options, sampling=plain, save_field=None)
            warp(one, tell)
    if mapping is not None:
        output.finish(mapping.target)
    elif job.save_field is not None:
        geometry, tolerance = opened.geometry, made.sampling.tolerance
        assert geometry is not None
        lies = geometry if made.grid is None else made.grid.geometry(geometry.convention)
        with replacing(job.save_field, force=force) as place:  # published together with the output
            write_transform(place, made.deformation, lies, tolerance=tolerance, force=True, grid=made.grid, warn=False)
            output.finish()
        saved = SavedField(os.fspath(job.save_field), tolerance, certificate.error)
    else:
        output.finish()
    chosen = job.outside is None and made.sampling.outside == "constant"
    return Warped(
        os.fspath(source), os.fspath(target), "store", (made.deformation,), made.sampling.tolerance, certificate.error,
        geometry=opened.geometry, grid=made.grid, folded=certificate.folded, outside=certificate.outside,
        unsolved=certificate.unknown, shape=tuple(output.arrays[0].shape), levels=len(output.arrays), labels=labels,
        field=saved, background=None if not chosen else 0.0 if known.labels else opened.background,
        **counts,  # type: ignore[arg-type]
    )  # fmt: skip


def _labels(source: Source, job: Job) -> tuple[str, ...]:
    """Return the names of the label images to warp with an image, and warn of others, before any work."""
    names, address = [], source.image.address.rstrip("/")
    for name in source.image.labels:
        why = ""
        if not name or {*name} & {*"/\\:"} or name.startswith("."):
            why = "it has no plain name"
        else:
            try:
                own = replace(job, source=f"{address}/{LABELS}/{name}", volume=VolumeOptions()).medium.stored
                if own.space != source.space or not own.grid.is_same_space(source.grid):
                    why = "it is on another grid"
                elif own.image.dtype.kind not in "iub":
                    why = f"it holds {own.image.dtype}"
            except SuppleError as error:
                why = str(error)
        if why:
            text = f"the label image {shown(name)} of {source.name} is not carried over ({why})"
            warn(f"{text}: bend it by itself, as labels", VolumeWarning)
        else:
            names.append(name)
    return tuple(names)


def _warn_of_labels(source: Source, warp: Warp) -> None:
    image, n = source.image, len(source.space)
    if warp.sampling.keeps_values or warp.deformation.is_identity or (n == 2 and not image.is_labels):
        return
    middle = [(max(0, (size - _SIDE) // 2), min(size, (size + _SIDE) // 2)) for size in source.space]
    part = [(0, 1)] * source.carried + middle
    with Place(image.address).reading("its samples cannot be decoded"):
        some = np.asarray(source.samples[tuple(slice(*span) for span in part)])
    warn_of_labels(some.reshape(some.shape[-n:]), source.name, known=image.is_labels)


def _located(source: Source, grid: Grid | None, target: PathLike) -> tuple[Numbers, Numbers]:
    """Return the scale and the translation of the output along all axes; SuppleError if its grid is rotated."""
    level, axes, own = source.image.levels[0], list(source.image.spatial), source.grid
    if grid is None:
        return level.scale, level.translation
    if not np.allclose(grid.direction, own.direction, atol=1e-6):
        what = "the axes of its grid are turned against those of the input, which scales and translations cannot say"
        raise unwritable(target, what, "give a reference whose axes are parallel to them, or resample it first")
    if grid.uncropped().is_same_space(own):
        first, steps = np.array(grid.first, float), np.ones(grid.ndim)
    else:
        first, steps = own.indices(grid.origin), np.divide(grid.spacing, own.spacing)
    scale, translation = np.array(level.scale), np.array(level.translation)
    translation[axes] += scale[axes] * first[::-1]
    scale[axes] *= steps[::-1]
    translation[np.abs(translation) < 1e-9 * scale] = 0.0
    rounded = [tuple(float(f"{number:.12g}") for number in numbers) for numbers in (scale, translation)]
    return rounded[0], rounded[1]  # rounding errors removed


def _name(source: Source, warp: Warp, job: Job) -> str:
    """Return an identifier of the job, from the input, the recipe and all options that affect samples."""
    image = source.image
    place, deformation = Place(image.address), warp.deformation
    grid = deformation.grid if warp.grid is None else warp.grid
    facts = (
        image.shape, str(image.dtype), len(image.spatial), job.recipe.to_json(), deformation.shape, warp.sampling,
        job.volume, grid.shape, grid.matrix.tolist(), grid.first,
        place.parts, place.address.rpartition("::")[0] if place.folder is None else "", _changed(image, place.folder),
    )  # fmt: skip
    digest = hashlib.sha256(repr(facts).encode())
    for each in deformation.maps:
        element = each.map
        digest.update(repr((each.inverse, each.after)).encode())
        if isinstance(element, Field):
            digest.update(repr((element.grid, element.interpolation, element.beyond)).encode())
            digest.update(element.values.data)
        else:
            digest.update(np.ascontiguousarray(element.matrix).data)
    return f"warp {'/'.join(place.parts)}, {digest.hexdigest()}"


def _changed(image: StoredImage, folder: Path | None) -> list[int]:
    """Return modification times in ns: of the metadata of a store in a folder, or of a file and its companions.

    Changes of a store's samples are not detected.
    """
    if folder is None:
        return []
    if is_store(image.address):
        places = [folder / level.path / name for level in image.levels for name in ROOTS]
    else:  # the slices in a folder, or a header and its data file
        places = list(folder.iterdir() if folder.is_dir() else folder.parent.glob(f"{glob.escape(folder.stem)}.*"))
    return [os.stat(place).st_mtime_ns for place in sorted(places) if place.is_file()]


def _write_blocks(
    work: Work, runner: Runner, tell: Tell, maps: Sequence[Placed], *, warn: bool
) -> tuple[dict[str, int], Certificate]:
    """Write the finest level; return counts of blocks and bytes, and the certificate of the map.

    Existing blocks are planned again, so that the certificate covers all blocks, but they are not written.
    """
    carried, target = work.carried, work.target
    shape = tuple(target.arrays[0].shape)
    task = task_shape(target.blocks[0], shape, work.samples.dtype.itemsize, carried, runner.slots)
    chunks = chunks_of(task, shape)
    leads = list(boxes_of(chunks[:carried]))
    counts = {"blocks": math.prod(map(len, chunks)), "done": 0, "copied": 0, "read": 0, "copied_bytes": 0}
    advance = advancing(tell, "warp", counts["blocks"])
    for blocks, certificate, last in planned(work.warp, chunks[carried:], runner, tell):
        if warn and last:  # before the last blocks are written, in case warnings are errors
            warn_of_maps(certificate, work.warp.sampling.tolerance, maps)
        items = itertools.product(leads, blocks)
        while some := list(itertools.islice(items, _AT_ONCE)):
            for way, count in runner.each(_write_block, work, some, advance):
                counts[way] += count if way == "read" else 1
                counts["copied_bytes"] += count if way == "copied" else 0
    return counts, certificate


def _write_block(work: Work, item: tuple[Box, Block]) -> tuple[Literal["done", "copied", "read"], int]:
    """Write a block; return whether it existed, was copied or was computed ("read"), and the bytes read for it."""
    lead, block = item
    target = work.target
    check_seen(work.place, target.site)
    box, part = (*lead, *block.box), (*lead, *block.part)
    if target.begun and target.is_done(0, box):
        return "done", 0
    if block.identity and block.part == block.box and work.stored:
        return "copied", target.copy(0, box, work.samples, work.place.address)
    with work.place.reading(f"samples of it cannot be decoded, at {', '.join(f'{a}:{b}' for a, b in part)}"):
        samples = np.asarray(work.samples[tuple(slice(*each) for each in part)])
    target.write(0, box, work.warp.block(samples, block, work.carried))
    return "read", whole_chunks(part, work.samples.shape, work.samples.chunks) * samples.itemsize


def _write_levels(work: Work, runner: Runner, tell: Tell, mode: Mode) -> None:
    target = work.target
    levels = []
    for level in range(1, len(target.arrays)):
        shape = tuple(target.arrays[level].shape)
        limit = max(1, TASK // math.prod(target.factors[level]))
        task = task_shape(target.blocks[level], shape, work.samples.dtype.itemsize, work.carried, runner.slots, limit)
        levels.append([(level, box, mode) for box in boxes_of(chunks_of(task, shape))])
    if levels:
        advance = advancing(tell, "reduce", sum(map(len, levels)))
        for items in levels:
            runner.each(_reduce_block, work, items, advance)


def _reduce_block(work: Work, item: tuple[int, Box, Mode]) -> None:
    level, box, mode = item
    check_seen(work.place, work.target.site)
    if not (work.target.begun and work.target.is_done(level, box)):
        work.target.reduce(level, box, mode)


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
    warn_of_maps(certificate, warp.sampling.tolerance, job.maps)
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
