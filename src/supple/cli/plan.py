"""The command that plans a warp in blocks."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from supple.cli.options import Labels, RunOptions, SamplingOptions, VolumeArguments, WorkerOptions
from supple.cli.options_maps import MapOptions, OutputOptions
from supple.cli.options_strokes import StrokeOptions

if TYPE_CHECKING:
    from supple.files.plans import Planned


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
    from supple.files.plans import PLANNED, plan_file

    console = options.start(source)
    grid = output.to_grid()
    reading = volume.to_reading(labels=labels)
    edits = strokes.read(
        maps, reading, console.arguments, source, target=source, reference=output.onto, empty=grid is not None
    )
    known, outside = sampling.to_sampling(bool(edits.maps) or output.onto is not None)
    job = Job(
        source, PLANNED, edits.recipe, known, outside, volume=reading, fit=strokes.to_fit(), grid=grid,
        running=workers.to_running(),
    )  # fmt: skip
    job = edits.maps.placed(console, job)
    with counted(console.terminal, "blocks") as tell:
        found = plan_file(job, tell)
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
