"""The commands on volumes: render, and points."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from supple.cli.console import STREAM, current, naming, say_convention, told, warn_of_software
from supple.cli.options import RunOptions, VideoOptions
from supple.cli.options_maps import MapOptions, Maps
from supple.cli.options_render import CameraOptions, LookOptions
from supple.cli.options_strokes import StrokeOptions
from supple.cli.options_volume import VolumeArguments
from supple.engine.devices import workers
from supple.errors import SuppleError, spelling

if TYPE_CHECKING:
    from supple.deformation import Deformation
    from supple.files.options import VolumeOptions as Reading
    from supple.space.geometry import Geometry
    from supple.strokes import Fit, Recipe

_STROKES, _RUN, _VOLUME, _VIDEO = StrokeOptions(), RunOptions(), VolumeArguments(), VideoOptions()
_CAMERA, _LOOK, _MAPS = CameraOptions(), LookOptions(), MapOptions()


def render(
    source: Annotated[str, Parameter(name="VOLUME")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    strokes: StrokeOptions = _STROKES,
    camera: CameraOptions = _CAMERA,
    look: LookOptions = _LOOK,
    maps: MapOptions = _MAPS,
    volume: VolumeArguments = _VOLUME,
    options: RunOptions = _RUN,
) -> None:
    """Render a picture of a volume, original or deformed.

    Parameters
    ----------
    source
        A volume: NIfTI, NRRD, MetaImage, a DICOM folder, a TIFF stack, .dat, or a file without a header.
    target
        A picture (PNG and TIFF keep opacity); with --turntable, a video or a name with a number.
    """
    console = current()
    from supple.engine.progress import counted
    from supple.files.renders import render_file
    from supple.media.medium import Medium
    from supple.render.camera import Camera

    console.started(**options.asked(), file=source)
    warn_of_software(console, look.device)
    convention = maps.coordinates
    given: dict[str, Any] = {"world": volume.world, "place": lambda: volume.place_of(source), "convention": convention}
    strokes.refuse_alone()
    recipe, fit = strokes.to_recipe(**given) if strokes.any else None, strokes.to_fit()
    before = 0 if recipe is None else len(recipe.strokes) - strokes.count
    elements = maps.to_maps(console.arguments, before, strokes.given)
    with spelling(naming(rate="--rate")):
        render, reading = look.to_render(Camera(**vars(camera)), convention), volume.to_reading()
    if convention is not None and not (strokes.pull or look.mesh):
        raise SuppleError("--convention is of tables of --pull and of meshes, and there are none: leave it out")
    if reading.world and recipe is None:
        raise SuppleError("--world is about the points of strokes, and there are none: leave it out")
    medium = Medium(source, "volume", reading.layout, reading.series)
    placed = elements.on(console, medium.outline.grid, medium.name) if elements else ()
    with spelling(naming(rate="--rate")), counted(console.terminal) as tell, workers() as who:
        scene = render_file(
            source, target, recipe, options=render, volume=reading, force=options.force, tell=tell, fit=fit, maps=placed
        )
    say_convention(console, reading.world, scene.geometry, source)
    if render.transfer is None and scene.labels is not None and not console.quiet:
        console.say(f"{source} is drawn as a label map, of {len(scene.labels)} labels: --transfer grey draws values")
    if options.json:
        facts = told(scene.deformation) if scene.deformation else {}
        low, high = scene.range
        console.tell(
            {
                "input": source,
                "output": target,
                "width": render.size[1],
                "height": render.size[0],
                "pictures": render.turntable or 1,
                "mode": scene.mode,
                "device": str(who),
                "step": scene.step,
                "minimum": low,
                "maximum": high,
                "error": scene.error if math.isfinite(scene.error) else None,
                **facts,
            }
        )


def points(
    source: Annotated[str, Parameter(name="IN")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    on: Annotated[str, Parameter(metavar="FILE")],
    refer_to: Annotated[str | None, Parameter(metavar="SERIES")] = None,
    strokes: StrokeOptions = _STROKES,
    maps: MapOptions = _MAPS,
    volume: VolumeArguments = _VOLUME,
    video: VideoOptions = _VIDEO,
    options: RunOptions = _RUN,
) -> None:
    """Move landmarks, a mesh or contours by a deformation: as what they mark moves, from the input to the output.

    With fields and affine maps, these are those of supple warp, in the same order: what a resampling program applies to
    points of the output is --inverse here, from the output back to the input.

    Parameters
    ----------
    source
        Points to read: CSV, or 3D Slicer's .fcsv and .mrk.json; or a mesh: STL, OBJ, PLY, VTK PolyData (.vtk, .vtp);
        or contours: a structure set of DICOM (.dcm).
    target
        File to write, of the same kind.
    on
        The volume, picture or video that is deformed; voxels and pixels of points are its own.
    refer_to
        The DICOM series that a moved structure set refers to, such as the bent one: a folder, or one of its slices.
    """
    console = current()
    from supple.cli.jobs import piped
    from supple.files.landmarks import move_points

    console.started(**options.asked(), file=source)
    if options.json and target == STREAM:
        raise SuppleError("--json writes to standard output, and so does -: leave one out")
    convention = maps.coordinates
    recipe = strokes.to_recipe(
        world=volume.world, empty=maps.any, others="--field FILE, --affine FILE or ",
        place=lambda: volume.place_of(on), convention=convention,
    )  # fmt: skip
    elements = maps.to_maps(console.arguments, len(recipe.strokes) - strokes.count, strokes.given, points=True)
    deformation, geometry = _deformation(on, recipe, elements, volume.to_reading(), video, strokes.to_fit(), source)
    with piped((source, target), console, ".csv") as (read, written):
        moved = move_points(
            read, written, deformation, geometry,
            inverse=elements.back, convention=convention, refer_to=refer_to, force=options.force,
        )  # fmt: skip
    say_convention(console, volume.world, geometry, on)
    worst = float(moved.residual.max(initial=0.0))
    if options.json:
        known = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(moved).items()}
        facts: dict[str, Any] = {**known, "source": "-" if source == STREAM else source, "target": target}
        console.tell(facts)
        return
    unit = "px" if geometry is None else "mm"
    furthest = float(moved.displaced.max(initial=0.0))
    if not options.quiet and target != STREAM:
        many = "1 point" if moved.count == 1 else f"{moved.count} points"
        print(f"{many}, moved by up to {furthest:.3g} {unit}; residual up to {worst:.1g} {unit}")


def _deformation(
    on: str, recipe: Recipe, elements: Maps, reading: Reading, video: VideoOptions, fit: Fit | None, points: str
) -> tuple[Deformation, Geometry | None]:
    """Strokes and maps on a volume, a picture or a clip; and where a volume's voxels lie."""
    from supple.deformation import Deformation
    from supple.errors import argument
    from supple.files.clips import deformation_of as on_clip
    from supple.files.clips import open_clip
    from supple.files.jobs import Job, refuse_places
    from supple.files.landmarks import warn_of_frame
    from supple.files.volumes import deformation_of as on_volume
    from supple.files.volumes import open_volume
    from supple.media.files import is_store
    from supple.strokes import fit_recipe

    moving = Path(on).with_suffix(".mp4") if recipe.strokes and recipe.strokes[0].ndim == 3 else on
    job = Job(on, moving, recipe, volume=reading)
    if is_store(on):
        from supple.cli.stores import refer
        from supple.files.plans import open_source, warp_on

        maps = elements.read(refer(current(), on, job, elements))
        source = open_source(on, recipe, reading, maps=maps)
        return warp_on(source, recipe, options=reading, fit=fit, maps=maps).deformation, source.geometry
    job = elements.placed(current(), job)
    if job.medium.kind == "volume":
        volume = open_volume(on, reading)
        warn_of_frame(points, volume)
        return on_volume(recipe, volume, world=reading.world, fit=fit, maps=job.maps), volume.geometry
    if reading.world:
        raise SuppleError(f"{argument('world')} is for volumes, and {on} is none: leave it out")
    refuse_places(recipe, on)
    if (own := job.medium.grid) is None:
        known = video.to_clip()
        with open_clip(on, rate=known.rate) as clip:
            return on_clip(recipe, clip.count, clip.layout.shape, known.time_scale, clip.name, fit), None
    return Deformation.from_recipe(fit_recipe(recipe, own.sizes, fit, on), own, maps=job.maps), None
