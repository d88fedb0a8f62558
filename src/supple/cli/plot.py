"""The commands that draw: plot, and the gallery of demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from supple.cli.console import current, told, warn_of_software
from supple.cli.options import RUNNING, RunOptions, VideoOptions, VolumeArguments, parse_integer
from supple.cli.options_maps import MapOptions, Reference
from supple.cli.options_strokes import StrokeOptions
from supple.errors import SuppleError, counting

What = Literal["grid", "stretch", "axes", "residual", "iterations", "slice", "sheet"]
Device = Literal["auto", "cpu", "gpu"]

WRITING = Group("Writing", sort_key=3)

_RUN = RunOptions()
_STROKES = StrokeOptions()
_MAPS = MapOptions()
_VIDEO = VideoOptions()
_VOLUME = VolumeArguments()


def plot(
    source: Annotated[str, Parameter(name="IN")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    what: Annotated[What, Parameter(group=WRITING)] = "grid",
    frame: Annotated[str | None, Parameter(group=WRITING, metavar="K", allow_leading_hyphen=True)] = None,
    x: Annotated[str | None, Parameter(group=WRITING, metavar="X", allow_leading_hyphen=True)] = None,
    y: Annotated[str | None, Parameter(group=WRITING, metavar="Y", allow_leading_hyphen=True)] = None,
    plane: Annotated[str | None, Parameter(group=WRITING, metavar="PLANE[:MM]")] = None,
    strokes: StrokeOptions = _STROKES,
    maps: MapOptions = _MAPS,
    reference: Reference = None,
    volume: VolumeArguments = _VOLUME,
    video: VideoOptions = _VIDEO,
    options: RunOptions = _RUN,
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
    console = current()
    console.started(**options.asked(), file=source)
    if (convention := maps.coordinates) is not None and not strokes.pull:
        raise SuppleError("--convention of points is of tables of --pull, and there are none: leave it out")
    from supple.cli.warp import picture_facts
    from supple.files.jobs import Job
    from supple.files.options import GridOptions
    from supple.files.plots import plot_file

    typed, reading = video.frames(source), volume.to_reading()
    recipe = strokes.to_recipe(
        medium=lambda recipe: Job(source, "", recipe, volume=reading).medium, world=volume.world,
        empty=maps.any or reference is not None, others="--field FILE, --affine FILE or ",
        place=lambda: volume.place_of(source), convention=convention, frames=typed,
    )  # fmt: skip
    elements = maps.to_maps(console.arguments, recipe, strokes, reference=reference)
    grid = None if reference is None else GridOptions(reference)
    with counting(typed.first):
        deformation = plot_file(
            source,
            target,
            recipe,
            what,
            frame=None if frame is None else typed.read("--frame", frame),
            x=None if x is None else parse_integer("--x", x, "a whole number of pixels"),
            y=None if y is None else parse_integer("--y", y, "a whole number of pixels"),
            clip=video.to_clip(),
            force=options.force,
            progress=console.terminal,
            fit=strokes.to_fit(),
            maps=elements.placed(console, Job(source, "", recipe, volume=reading, grid=grid)).maps,
            volume=reading,
            plane=plane,
            reference=reference,
        )
    if options.json:
        job = (Path(source), Path(target))
        facts = picture_facts(job, deformation, deformation.report()) if deformation.ndim == 2 else told(deformation)
        console.tell({**facts, "input": source, "output": target, "what": what})


def demo(
    folder: Annotated[str, Parameter(name="DIR")] = "supple-demo",
    /,
    *,
    device: Annotated[Device, Parameter(group=RUNNING)] = "cpu",
    options: RunOptions = _RUN,
) -> None:
    """Write a gallery of examples, with a page to open in a browser.

    Parameters
    ----------
    folder
        Folder to write the gallery to.
    device
        Where to render volumes: cpu, gpu, or auto (the GPU if there is one).
    """
    console = current()
    from supple.examples.gallery import write_gallery

    console.started(**options.asked())
    warn_of_software(console, device)
    written = None if options.quiet or options.json else lambda path: console.say(f"wrote {path}")
    page = write_gallery(folder, force=options.force, device=device, written=written)
    if options.json:
        console.tell({"output": str(page)})
    elif not options.quiet:
        print(f"{page}: open it in a browser")
