"""The command that opens a window."""

from __future__ import annotations

from typing import Annotated, Any

from cyclopts import Parameter

from supple.cli.console import current
from supple.cli.options import VIDEO, VOLUME, TimeOptions, VolumeArguments, whole
from supple.cli.options_maps import MapOptions
from supple.cli.options_strokes import StrokeOptions
from supple.errors import SuppleError

_STROKES, _MAPS, _TIME, _VOLUME = StrokeOptions(), MapOptions(), TimeOptions(), VolumeArguments()


def view(
    source: Annotated[str, Parameter(name="FILE")],
    /,
    *,
    serve: bool = False,
    port: Annotated[int, whole()] = 0,
    frame: Annotated[str | None, Parameter(group=VIDEO, metavar="K", allow_leading_hyphen=True)] = None,
    strokes: StrokeOptions = _STROKES,
    maps: MapOptions = _MAPS,
    time: TimeOptions = _TIME,
    labels: Annotated[bool, Parameter(group=VOLUME)] = False,
    points: Annotated[str | None, Parameter(group=VOLUME, metavar="FILE")] = None,
    volume: VolumeArguments = _VOLUME,
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
    labels
        The volume is a label map: exports take the label of the nearest voxel, and labels are not mixed.
    points
        Landmarks to show: CSV, or 3D Slicer's .fcsv and .mrk.json.
    """
    from supple.viewer.window.launch import ViewOptions, show
    from supple.viewer.window.launch import serve as serve_it

    current().started(quiet=False, threads=None)
    strokes.refuse_alone()
    convention = maps.coordinates
    typed = time.frames(source)
    given: dict[str, Any] = {"world": volume.world, "place": lambda: volume.place_of(source), "convention": convention}
    given |= {"frames": typed, "window": True}
    recipe = strokes.to_recipe(**given) if strokes.any else None
    if volume.world and recipe is None:
        raise SuppleError("--world is about the points of strokes, and there are none: leave it out")
    elements = maps.to_maps(current().arguments, recipe, strokes)
    reading = volume.to_reading(labels=labels)
    from supple.files.jobs import Job
    from supple.strokes import Recipe

    placed = elements.placed(current(), Job(source, "", Recipe(), volume=reading)).maps
    scale = time.time_scale or (recipe and recipe.time_scale) or 1.0
    options = ViewOptions(
        time_scale=scale,
        volume=reading,
        maps=tuple(placed),
        fit=strokes.to_fit(),
        points=points,
        convention=convention,
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
