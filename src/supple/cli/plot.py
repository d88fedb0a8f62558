"""The commands that draw: plot, and the gallery of demo."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from supple.cli.console import told, warn_of_software
from supple.cli.options import RUNNING, WRITING, FilterOptions, RunOptions, VolumeArguments, parse_integer, read, text
from supple.cli.options_maps import MapOptions, Reference
from supple.cli.options_strokes import StrokeOptions
from supple.errors import counting

What = Literal["grid", "stretch", "axes", "residual", "iterations", "slice", "sheet"]
Device = Literal["auto", "cpu", "gpu"]

_pixel = partial(parse_integer, wanted="a whole number of pixels")


def plot(
    source: Annotated[str, Parameter(name="IN")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    what: Annotated[What, Parameter(group=WRITING)] = "grid",
    frame: Annotated[str | None, text("K", group=WRITING)] = None,
    x: Annotated[Any, read(_pixel, "X", group=WRITING)] = None,
    y: Annotated[Any, read(_pixel, "Y", group=WRITING)] = None,
    plane: Annotated[str | None, Parameter(group=WRITING, metavar="PLANE[:MM]")] = None,
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    reference: Reference = None,
    volume: VolumeArguments = VolumeArguments(),
    video: FilterOptions = FilterOptions(),
    options: RunOptions = RunOptions(),
) -> None:
    """Plot the deformation of a picture, a video or a volume.

    Parameters
    ----------
    source
        The picture, video or volume.
    target
        A PNG, SVG or PDF file.
    what
        Deformed grid lines, stretch, its principal axes, residual of the inverse map, or its iterations. For a
        video also a slice along time, or a sheet of frames before and after; for a volume, grid or stretch.
    frame
        Frame of a video, counted from 0, or its timecode.
    x
        Column that a slice shows over time.
    y
        Row that a slice shows over time.
    plane
        Plane of a volume: axial, coronal or sagittal, perhaps at a place in millimetres in LPS, as in axial:12.5
        (default: the axial one that moves most).
    reference
        Another image, on whose grid the result is, such as the fixed image of a registration.
    """
    console = options.start(source)
    from supple.cli.warp import picture_facts
    from supple.files.jobs import Job
    from supple.files.options import GridOptions
    from supple.files.plots import plot_file

    typed, reading = video.frames(source), volume.to_reading(strokes=strokes.bends)
    edits = strokes.read(maps, reading, console.arguments, source, reference=reference, frames=typed)
    job = Job(
        source, "", edits.recipe, clip=video.to_clip(), force=options.force, fit=strokes.to_fit(), volume=reading,
        grid=None if reference is None else GridOptions(reference),
    )  # fmt: skip
    with counting(typed.first):
        deformation = plot_file(
            replace(edits.maps.placed(console, job), target=target), what,
            frame=None if frame is None else typed.read("--frame", frame), x=x, y=y, progress=console.terminal,
            plane=plane,
        )  # fmt: skip
    if options.json:
        pair = (Path(source), Path(target))
        facts = picture_facts(pair, deformation, deformation.report()) if deformation.ndim == 2 else told(deformation)
        console.tell({**facts, "input": source, "output": target, "what": what})


def demo(
    folder: Annotated[str, Parameter(name="DIR")] = "supple-demo",
    /,
    *,
    device: Annotated[Device, Parameter(group=RUNNING)] = "cpu",
    options: RunOptions = RunOptions(),
) -> None:
    """Write a gallery of examples, with a page to open in a browser.

    Parameters
    ----------
    folder
        Folder to write the gallery to.
    device
        Where to render volumes: cpu, gpu, or auto (the GPU if there is one).
    """
    console = options.start()
    from supple.examples.gallery import write_gallery

    warn_of_software(console, device)
    written = None if options.quiet or options.json else lambda path: console.say(f"wrote {path}")
    page = write_gallery(folder, force=options.force, device=device, written=written)
    if options.json:
        console.tell({"output": str(page)})
    elif not options.quiet:
        print(f"{page}: open it in a browser")
