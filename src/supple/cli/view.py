"""The command that opens a window."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from supple.cli.options import VIDEO, VOLUME, Labels, RunOptions, TimeOptions, VolumeArguments, text, whole
from supple.cli.options_maps import MapOptions
from supple.cli.options_strokes import StrokeOptions
from supple.errors import SuppleError

Beside = Annotated[str | None, Parameter(group=VOLUME, metavar="FILE")]


def view(
    source: Annotated[str, Parameter(name="FILE")],
    /,
    *,
    serve: bool = False,
    port: Annotated[int, whole()] = 0,
    frame: Annotated[str | None, text("K", group=VIDEO)] = None,
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    time: TimeOptions = TimeOptions(),
    labels: Labels = False,
    points: Beside = None,
    fixed: Beside = None,
    fixed_points: Beside = None,
    segmentation: Beside = None,
    label_colours: Beside = None,
    volume: VolumeArguments = VolumeArguments(),
) -> None:
    """Open a window to bend a picture, video or volume by hand.

    Fields and affine maps come before the strokes: what is seen is warped by them, and exports are by all in one.

    Parameters
    ----------
    source
        A picture, video, image sequence or volume, as for supple warp.
    serve
        Show the window in a web browser, on this machine or through a tunnel: the address is printed.
    port
        Port for --serve (default: any free port).
    frame
        Frame of a video to show first, counted from 0, or its timecode.
    points
        Landmarks to show: CSV, or 3D Slicer's .fcsv and .mrk.json.
    fixed
        The fixed volume of a registration: the other one is seen, and bent, on its grid, and compared with it.
    fixed_points
        Landmarks of the fixed volume, as pairs with those of --points.
    segmentation
        Labels to show over the volume, which move with it.
    label_colours
        Names and colours of labels: a colour table of 3D Slicer (.ctbl), FreeSurfer or ITK-SNAP (.txt).
    """
    from supple.files.jobs import Job
    from supple.files.options import GridOptions
    from supple.strokes import Recipe
    from supple.viewer.window.launch import serve as serve_it
    from supple.viewer.window.launch import show
    from supple.viewer.window.options import ViewOptions

    console = RunOptions().start()
    typed, reading = time.frames(source), volume.to_reading(strokes=strokes.bends, labels=labels)
    reading.check(source)
    edits = strokes.read(
        maps, reading, console.arguments, source, reference=fixed, frames=typed, empty=True, window=True, points=True
    )
    recipe = edits.recipe if strokes.any else None
    onto = None if fixed is None else GridOptions(fixed, strokes=True)
    placed = edits.maps.placed(console, Job(source, "", Recipe(), volume=reading, grid=onto)).maps
    scale = time.time_scale or (recipe and recipe.time_scale) or 1.0
    options = ViewOptions(
        time_scale=scale,
        volume=reading,
        maps=tuple(placed),
        fit=strokes.to_fit(),
        points=points,
        convention=maps.coordinates,
        fixed=fixed,
        fixed_points=fixed_points,
        segmentation=segmentation,
        label_colours=label_colours,
        frame=None if frame is None else typed.read("--frame", frame),
    )
    if port and not serve:
        raise SuppleError("--port is for --serve: leave it out, or serve")
    if not 0 <= port <= 65535:
        raise SuppleError(f"--port goes from 0 to 65535, found {port}")

    def tell(address: str) -> None:
        print(f"open {address}", flush=True)

    if serve:
        serve_it(source, recipe, port=port, tell=tell, options=options)
    else:
        show(source, recipe, options=options)
