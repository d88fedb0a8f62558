"""Warping Zarr stores from the command line, and the command that plans it."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from supple.cli.console import STREAM, Console, File, Terminated, about, one_line
from supple.cli.console import told as told_of
from supple.cli.options import Labels, RunOptions, SamplingOptions, VolumeArguments, WorkerOptions
from supple.cli.options_maps import (
    MapOptions,
    Maps,
    OutputOptions,
    output_facts,
    say_output,
)
from supple.cli.options_strokes import StrokeOptions
from supple.errors import SuppleError, shown

if TYPE_CHECKING:
    from supple.files.jobs import Job
    from supple.files.plans import Planned
    from supple.files.stores import WarpedStore
    from supple.files.tasks import Running


def warp_stored(
    console: Console, paths: Sequence[str], job: Job, maps: Maps, running: Running, *, json: bool
) -> WarpedStore:
    """Warp a store to another one, for `supple warp`."""
    from supple.engine.progress import counted
    from supple.files.plans import open_source
    from supple.files.stores import warp

    source, target = _pair(paths)
    _check(job, paths)
    blocks: dict[str, tuple[int, int]] = {}

    def tell(step: str, done: int, total: int) -> None:
        blocks[step] = done, total
        counts(step, done, total)

    try:
        with about(File(source, target)), counted(console.terminal, "blocks") as counts:
            job = refer(console, job, maps)
            stored = warp(replace(job, source=source, target=target), running, tell)
    except (KeyboardInterrupt, Terminated):
        parts, name = ("blocks", target) if "warp" in blocks else ("parts", job.volume.save_field or "")
        if blocks:
            done, total = blocks.get("warp") or blocks["field"]
            console.goes_on = f"{done} of {total} {parts} of {shown(name)} are written, the same command goes on"
        raise
    except SuppleError as error:
        if json:
            console.tell({"input": source, "output": target, "error": one_line(error)})
        raise
    if json:
        used = {"maps": maps.facts(open_source(job).grid)} if maps else {}
        console.tell({**_facts(stored), **used})
    if stored.done:
        what = f"{stored.done} of {stored.blocks} blocks were there already"
        console.note(f"{shown(target)}: {what}, of a job that was interrupted")
    if stored.labels:
        console.note(f"{shown(target)}: the label images {', '.join(stored.labels)} are bent with it")
    say_output(console, stored, stored.grid, target, source, job.volume.world)
    return stored


def refer(console: Console, job: Job, maps: Maps) -> Job:
    """Return a job on a store with the maps of the command, read for its grid; print each."""
    from supple.files.plans import open_source

    return maps.placed(console, job, lambda job: open_source(job).grid)


def _pair(paths: Sequence[str]) -> tuple[str, str]:
    """Return the input and the output; SuppleError for more than one input, or an output that is not a store."""
    from supple.files.recipes import is_media_name
    from supple.media.files import is_store

    *sources, target = paths
    if len(sources) > 1 or (glob.has_magic(sources[0]) and not os.path.exists(sources[0]) and "://" not in sources[0]):
        stored = next(path for path in paths if is_store(path))
        raise SuppleError(f"{shown(stored)} is a Zarr store, and stores are written one at a time: give one, and OUT")
    if sources[0] == STREAM:
        raise SuppleError(f"standard input is read as a picture, and {shown(target)} is a Zarr store: name a file")
    if target == STREAM or is_media_name(target):
        name = "standard output" if target == STREAM else shown(target)
        raise SuppleError(
            f"{shown(sources[0])} is a Zarr store, and becomes one, which {name} is not: name one, such as out.zarr"
        )
    return sources[0], target


def _check(job: Job, paths: Sequence[str]) -> None:
    """Raise SuppleError for an option that does not apply to stores; the message names it."""
    from supple.errors import argument
    from supple.files.jobs import OPTIONS, asked
    from supple.media.files import is_store

    given = {name: (getattr(job, name), usual) for name, (usual, _) in OPTIONS.items() if name != "volume"}
    names = [asked(name, value) for name, (value, usual) in given.items() if value != usual]
    if job.device not in ("cpu", "auto"):
        names.append(argument("device", job.device))
    if names:
        stored = next(path for path in paths if is_store(path))
        raise SuppleError(f"{names[0]} is not for Zarr stores, and {shown(stored)} is one: leave it out")


def _facts(stored: WarpedStore) -> dict[str, Any]:
    grid = stored.grid or stored.deformation.grid
    names = ("shape", "levels", "labels", "blocks", "done", "copied", "read", "copied_bytes")
    facts: dict[str, Any] = {
        "input": stored.source,
        "output": stored.target,
        **dict(zip(("width", "height", "depth"), grid.sizes, strict=False)),
        **{name: getattr(stored, name) for name in names},
        "spacing": grid.spacing,
        "tolerance": stored.tolerance,
        "error": stored.error,
        **told_of(stored.deformation),
    }
    if stored.field is not None:
        facts["field"] = asdict(stored.field)
    return facts | output_facts(stored)


def plan(
    source: Annotated[str, Parameter(name="IN")],
    /,
    *,
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    output: OutputOptions = OutputOptions(),
    sampling: SamplingOptions = SamplingOptions(),
    labels: Labels = False,
    volume: VolumeArguments = VolumeArguments(),
    workers: WorkerOptions = WorkerOptions(),
    options: RunOptions = RunOptions(),
) -> None:
    """Tell what a warp in blocks would read and write, without reading a sample.

    Parameters
    ----------
    source
        A Zarr array or an OME-Zarr image, a volume, or a picture.
    labels
        The input is a label map, as of warp.
    """
    from supple.engine.progress import counted
    from supple.files.jobs import Job
    from supple.files.plans import plan_file

    console = options.start(source)
    grid = output.to_grid()
    reading = volume.to_reading(labels=labels)
    edits = strokes.read(
        maps, reading, console.arguments, source, target=source, reference=output.onto, empty=grid is not None
    )
    known, outside = sampling.to_sampling(bool(edits.maps) or output.onto is not None)
    job = Job(source, source, edits.recipe, known, outside, volume=reading, fit=strokes.to_fit(), grid=grid)
    job = refer(console, job, edits.maps)
    with counted(console.terminal, "blocks") as tell:
        found = plan_file(job, workers.to_running(), tell)
    if options.json:
        console.tell({"file": source, **asdict(found)})
    else:
        print(_described(source, found))


def _described(name: str, found: Planned) -> str:
    from rich.filesize import decimal

    from supple.cli.describe import listed

    each = " x ".join(map(str, found.block))
    copies = f"{found.copied} of them copies of what no stroke reaches ({decimal(found.copied_bytes)} uncompressed)"
    lines = {
        "output": f"{' x '.join(map(str, found.shape))} {found.dtype}, {decimal(found.size)} with coarser levels, "
        "uncompressed",
        "blocks": f"{found.blocks} of {each}, {copies if found.copied else 'none of them a copy'}",
        "to read": f"{decimal(found.read)} of whole chunks, uncompressed{', beside the copies' * bool(found.copied)}",
        "memory": f"{decimal(found.memory)} for each process, which works on {found.tasks} blocks at a time",
        "error": f"{found.error:.2g} px at most, of the inverse map",
    }
    return listed(name, lines)
