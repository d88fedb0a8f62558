"""The commands on volumes: render, with its options, and points."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter

from supple.cli.console import STREAM, current, naming, say_convention, told, warn_of_software
from supple.cli.options import (
    FilterOptions,
    RunOptions,
    Texts,
    VolumeArguments,
    number,
    options_of,
    parse_number,
    parse_numbers,
    parse_sizes,
    parse_three,
    read,
    whole,
)
from supple.cli.options_maps import GridArguments, MapOptions, Reference
from supple.cli.options_strokes import Edits, StrokeOptions
from supple.engine.devices import workers
from supple.errors import SuppleError, spelling

if TYPE_CHECKING:
    from supple.deformation import Deformation
    from supple.files.options import GridOptions
    from supple.files.options import VolumeOptions as Reading
    from supple.files.renders import MeshFile, RenderOptions
    from supple.render.box import Clip, Plane
    from supple.render.camera import Camera
    from supple.space.geometry import Geometry, Grid
    from supple.strokes import Fit

CAMERA = Group("Camera", sort_key=2)
LOOK = Group("Look", sort_key=3)
_DEGREES = "a number of degrees"
_range = partial(parse_numbers, wanted="two values LO,HI", counts=(2,))
_NAMING = naming(rate="--rate", table="--table", legend="--legend")


def _box(option: str, text: str) -> Clip:
    """Parse a box; omitted ends are None."""
    wanted = "X0:X1,Y0:Y1,Z0:Z1 in voxels, with ends left out where nothing is cut away"
    ranges = [part.split(":") for part in text.split(",")]
    if len(ranges) != 3 or any(len(ends) != 2 for ends in ranges):
        raise SuppleError(f"{option} must be {wanted}, found {text!r}")
    ends = [[parse_number(option, x, wanted, typed=text) if x.strip() else None for x in pair] for pair in ranges]
    return [(low, high) for low, high in ends]


def _plane(option: str, text: str) -> Plane:
    wanted, (voxel, _, way) = "a voxel and a direction, X,Y,Z:DX,DY,DZ", text.partition(":")
    at, direction = (parse_numbers(option, part, wanted, (3,), typed=text) for part in (voxel, way))
    return at, direction


def _size(option: str, text: str) -> tuple[int, ...]:
    """Parse width and height; return rows and columns."""
    return parse_sizes(option, text, "a width and a height in pixels, such as 512x512 or 512,512", (2,))[::-1]


def _colour(option: str, text: str, verb: str = "must be") -> tuple[float, float, float]:
    digits = text.removeprefix("#")
    try:
        if len(digits) != 6:
            raise ValueError
        red, green, blue = bytes.fromhex(digits)
    except ValueError:
        raise SuppleError(f"{option} {verb} a colour such as #1a1a1e, found {text!r}") from None
    return red / 255, green / 255, blue / 255


@options_of(CAMERA)
class CameraOptions:
    """Where the camera stands.

    Parameters
    ----------
    azimuth
        Angle around the head, in degrees: 0 faces the patient, 90 sees the patient's left, 180 the back.
    elevation
        Angle above the horizon in degrees, from -90 to 90.
    distance
        Distance from the target in millimetres (default: all that is shown is in view).
    field_of_view
        Angle of view across the shorter side of the picture, in degrees.
    roll
        Turn the camera clockwise, in degrees.
    target
        Voxel at which the camera looks (default: the centre of what is shown).
    up
        Direction that is up in the picture, in LPS coordinates; 0,0,1 points to the head.
    """

    azimuth: Annotated[float, number(_DEGREES, "DEG")] = 0
    elevation: Annotated[float, number(f"{_DEGREES} from -90 to 90", "DEG", (-90, 90))] = 0
    distance: Annotated[float | None, number("a number of millimetres", "MM")] = None
    field_of_view: Annotated[float, number(f"{_DEGREES} from 1 to 150", "DEG", (1, 150))] = 30
    roll: Annotated[float, number(_DEGREES, "DEG")] = 0
    target: Annotated[Any, read(parse_three, "X,Y,Z")] = None
    up: Annotated[Any, read(parse_three, "X,Y,Z", show_default="0,0,1")] = (0.0, 0.0, 1.0)


@options_of(LOOK)
class LookOptions:
    """Options for the look of the volume.

    Parameters
    ----------
    transfer
        Transfer function (colours and opacity): ct-bone, ct-skin, ct-muscle, ct-lung, ct-vessels, mr-head, mr-brain,
        grey, or a file: JSON, or a volume property of 3D Slicer (.vp); for a label map, labels, or a colour table of 3D
        Slicer, FreeSurfer or ITK-SNAP (.ctbl, .txt) (default: chosen by the values).
    save_transfer
        Write the transfer function that is used to this file: JSON, or .vp for 3D Slicer; of labels, .ctbl.
    density
        Show only values, or labels, from LO to HI.
    clip
        Show only a box of the deformed volume, from voxel X0 to voxel X1 and so on, and cut the rest away. Ends may be
        left out: --clip :,60:,: leaves what is from y = 60 on.
    crop
        The same of the volume before it is deformed: the box moves with the strokes.
    plane
        Cut away what lies beyond a plane of the deformed volume: a voxel on it, and the direction in which all is cut
        away, in LPS. --plane 45,60,45:0,-1,0 cuts away what is in front of y = 60.
    mesh
        Draw a mesh or contours with the volume, moved by its deformation: STL, OBJ, PLY, VTK PolyData (.vtk, .vtp), or
        a structure set of DICOM (.dcm); in a colour, if one follows: --mesh skull.stl:#ffcc00. Repeatable.
    table
        With a preset of CT, show what lies apart from the body, too: a table, a head holder, cables.
    largest
        Of what is visible, show only the largest part that is connected: without specks.
    projection
        Instead of surfaces, the maximum, minimum or average value along each ray, in grey: black at the lower end of
        --density and white at the upper one (default: the smallest and the largest value).
    silhouettes
        By how much surfaces darken towards where they are seen from the side, from 0 to 1.
    shadows
        By how much surfaces darken where something keeps the light away: soft shadows, and dark folds, from 0 to 1.
    size
        Width and height of the picture in pixels.
    step
        Distance between samples along a ray, in millimetres (default: 0.75 of the smallest spacing; half of
        that spacing in projections, and of labels).
    mode
        How the deformed volume is sampled. buffered: the volume is warped first. exact: inverse solved at each sample.
        hybrid: as buffered; only windows do not wait for it.
    unshaded
        Render without shading.
    annotate
        Draw a scale bar, for what is as far away as the target, and letters for the patient's sides.
    legend
        List the names of labels with their colours: those of a segmentation of 3D Slicer, or of a colour table.
    background
        Background colour (default: transparent; black in formats and videos without opacity).
    smooth
        Antialiasing: rays along each side of a pixel.
    turntable
        Number of pictures on a circle around the volume. OUT is then a video (MP4, MOV, MKV, WebM, GIF), or a name
        with a number such as turn-%03d.png.
    rate
        Frames per second of a turntable video (default: 24).
    what
        Render the picture, or plot how many inversions each ray needed.
    time
        Which volume of a time series to show, counted from 0.
    device
        Where to render: cpu, gpu, or auto (the GPU if there is one).
    """

    transfer: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    save_transfer: Annotated[str | None, Parameter(metavar="FILE")] = None
    density: Annotated[Any, read(_range, "LO,HI")] = None
    clip: Annotated[Any, read(_box, "X0:X1,Y0:Y1,Z0:Z1")] = None
    crop: Annotated[Any, read(_box, "X0:X1,Y0:Y1,Z0:Z1")] = None
    plane: Annotated[Any, read(_plane, "X,Y,Z:DX,DY,DZ")] = None
    mesh: Annotated[Texts, Parameter(metavar="FILE[:#RRGGBB]")] = ()
    table: bool = False
    largest: bool = False
    projection: Literal["none", "maximum", "minimum", "average"] = "none"
    silhouettes: Annotated[float, number("a number from 0 to 1", "S", (0, 1))] = 0
    shadows: Annotated[float, number("a number from 0 to 1", "S", (0, 1))] = 0
    size: Annotated[Any, read(_size, "WxH", show_default="512x512")] = (512, 512)
    step: Annotated[float | None, number("a number of millimetres", "MM")] = None
    mode: Annotated[str, Parameter(metavar="buffered|exact|hybrid")] = "buffered"
    unshaded: bool = False
    annotate: bool = False
    legend: bool = False
    background: Annotated[Any, read(_colour, "#RRGGBB")] = None
    smooth: Annotated[int, whole()] = 1
    turntable: Annotated[int | None, whole()] = None
    rate: Annotated[float | None, number("a number of pictures a second", "N")] = None
    what: Literal["picture", "inversions"] = "picture"
    time: Annotated[int, whole("K")] = 0
    device: Literal["auto", "cpu", "gpu"] = "cpu"

    def to_render(self, camera: Camera, convention: str | None = None) -> RenderOptions:
        """Return the options as a `RenderOptions`."""
        from supple.files.renders import RenderOptions

        given = dict(vars(self))
        meshes, unshaded = [_mesh(text) for text in given.pop("mesh")], given.pop("unshaded")
        smooth = given.pop("smooth")
        return RenderOptions(
            **given, meshes=meshes, shaded=not unshaded, supersampling=smooth, camera=camera, convention=convention
        )


def _mesh(text: str) -> MeshFile:
    from supple.files.renders import MeshFile

    path, _, digits = text.rpartition(":#")
    return MeshFile(path, _colour("--mesh", digits, "must end in")) if path else MeshFile(text)


def render(
    source: Annotated[str, Parameter(name="VOLUME")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    strokes: StrokeOptions = StrokeOptions(),
    camera: CameraOptions = CameraOptions(),
    look: LookOptions = LookOptions(),
    maps: MapOptions = MapOptions(),
    reference: Reference = None,
    volume: VolumeArguments = VolumeArguments(),
    options: RunOptions = RunOptions(),
) -> None:
    """Render a picture of a volume, original or deformed.

    Parameters
    ----------
    source
        A volume: NIfTI, NRRD, MetaImage, .mgz, a DICOM folder, a TIFF stack, .dat, or a file without a header.
    target
        A picture (PNG and TIFF keep opacity); with --turntable, a video or a name with a number.
    reference
        Render the volume as warped to the grid of another one, such as the fixed image of a registration.
    """
    console = options.start(source)
    from supple.engine.progress import counted
    from supple.files.jobs import Job
    from supple.files.options import GridOptions
    from supple.files.renders import render_file
    from supple.media.medium import Medium
    from supple.render.camera import Camera

    warn_of_software(console, look.device)
    reading = volume.to_reading(strokes=strokes.bends)
    reading.check(source)
    medium = Medium(source, "volume", reading.how)
    edits = strokes.read(
        maps, reading, console.arguments, source, reference=reference, empty=True, points=bool(look.mesh)
    )
    with spelling(_NAMING):
        render = look.to_render(Camera(**vars(camera)), maps.coordinates)
    grid = None if reference is None else GridOptions(reference)
    placed = edits.maps.on(console, medium.outline.grid, medium.name, grid) if edits.maps else ()
    job = Job(
        source, target, edits.recipe, volume=reading, force=options.force, fit=strokes.to_fit(), maps=placed, grid=grid
    )
    with spelling(_NAMING), counted(console.terminal) as tell, workers() as who:
        scene = render_file(job, render, tell=tell)
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
                "device": who(),
                "step": scene.step,
                "minimum": low,
                "maximum": high,
                "error": scene.error,
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
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    output: GridArguments = GridArguments(),
    volume: VolumeArguments = VolumeArguments(),
    video: FilterOptions = FilterOptions(),
    options: RunOptions = RunOptions(),
) -> None:
    """Move landmarks, a mesh or contours by a deformation: as what they mark moves, from the input to the output.

    With fields and affine maps, these are those of supple warp, in the same order: what a resampling program applies to
    points of the output is --inverse here, before all of them, from the output back to the input. After one of them,
    --inverse is of that map alone, and points go from the input to the output.

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
    console = options.start(source)
    from supple.cli.jobs import piped
    from supple.files.landmarks import move_points

    if options.json and target == STREAM:
        raise SuppleError("--json writes to standard output, and so does -: leave one out")
    grid = output.to_grid()
    reading = volume.to_reading(strokes=strokes.bends)
    edits = strokes.read(
        maps, reading, console.arguments, on,
        reference=output.reference, frames=video.frames(on), empty=grid is not None, points=True, back=True,
    )  # fmt: skip
    deformation, geometry, seen = _deformation(on, edits, reading, video, strokes.to_fit(), source, grid)
    with piped((source, target), console, ".csv") as (read, written):
        moved = move_points(
            read, written, deformation, geometry, reference=seen,
            inverse=edits.maps.back, convention=maps.coordinates, refer_to=refer_to, force=options.force,
        )  # fmt: skip
    say_convention(console, volume.world, geometry, on)
    worst = float(moved.error.max(initial=0.0))
    if options.json:
        known = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(moved).items()}
        name = "-" if source == STREAM else source
        console.tell({**known, "largest_error": worst, "source": name, "target": target})
        return
    unit = "px" if geometry is None else "mm"
    furthest = float(moved.displaced.max(initial=0.0))
    if not options.quiet and target != STREAM:
        many = "1 point" if moved.count == 1 else f"{moved.count} points"
        print(f"{many}, moved by up to {furthest:.3g} {unit}; error up to {worst:.1g} {unit}")


def _deformation(
    on: str, edits: Edits, reading: Reading, video: FilterOptions, fit: Fit | None, of: str, grid: GridOptions | None
) -> tuple[Deformation, Geometry | None, Grid | None]:
    """Return the deformation of a file by strokes and maps; a volume's geometry; and the output's grid, if given."""
    from supple.deformation import Deformation
    from supple.errors import argument
    from supple.files.clips import deformation_of as on_clip
    from supple.files.clips import open_clip, refuse_maps
    from supple.files.grids import check_straightened, output_grid
    from supple.files.jobs import Job, refuse_places
    from supple.files.landmarks import warn_of_frame
    from supple.files.volumes import deformation_of as on_volume
    from supple.strokes import fit_recipe

    recipe, elements = edits.recipe, edits.maps
    moving = Path(on).with_suffix(".mp4") if recipe.strokes and recipe.strokes[0].ndim == 3 else on
    job = Job(on, moving, recipe, volume=reading, fit=fit, clip=video.to_clip(), grid=grid)
    job = elements.placed(current(), job)
    medium = job.medium
    if medium.grid is not None and medium.grid.ndim == 3:
        volume = medium.outline
        warn_of_frame(of, volume)
        seen = None if grid is None else output_grid(grid, volume.grid)
        return on_volume(job, volume), volume.geometry, seen
    if reading.world:
        raise SuppleError(f"{argument('world')} is for volumes, and {on} is none: leave it out")
    refuse_places(recipe, on)
    if (own := medium.grid) is None:
        if grid is not None:
            refuse_maps(on)
        with open_clip(on, rate=job.clip.rate) as clip:
            return on_clip(job, clip), None, None
    fitted = fit_recipe(recipe, own.sizes, fit, on)
    if fitted.straighten is not None:
        check_straightened(grid)
    made = Deformation.from_recipe(fitted, own, maps=job.maps)
    return made, None, None if grid is None else output_grid(grid, made.output)
