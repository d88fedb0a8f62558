"""Options of the command that renders: where the camera stands, and what it sees."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from supple.cli.options import number, parse_number, read
from supple.cli.options_volume import parse_numbers, parse_three
from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.files.meshes import MeshFile
    from supple.files.renders import RenderOptions
    from supple.render.box import Clip, Plane
    from supple.render.camera import Camera

CAMERA = Group("Camera", sort_key=2)
LOOK = Group("Look", sort_key=3)
_DEGREES = "a number of degrees"


def _range(option: str, text: str) -> tuple[float, ...]:
    return parse_numbers(option, text, 2, "two values LO,HI")


def _box(option: str, text: str) -> "Clip":
    """A box; None where an end is left out."""
    wanted = "X0:X1,Y0:Y1,Z0:Z1 in voxels, with ends left out where nothing is cut away"
    ranges = [part.split(":") for part in text.split(",")]
    if len(ranges) != 3 or any(len(ends) != 2 for ends in ranges):
        raise SuppleError(f"{option} must be {wanted}, found {text!r}")
    ends = [[parse_number(option, end, wanted) if end.strip() else None for end in pair] for pair in ranges]
    return [(low, high) for low, high in ends]


def _plane(option: str, text: str) -> "Plane":
    voxel, colon, way = text.partition(":")
    if not colon:
        raise SuppleError(f"{option} must be a voxel and a direction, X,Y,Z:DX,DY,DZ, found {text!r}")
    return parse_three(option, voxel), parse_three(option, way)


def _size(option: str, text: str) -> tuple[int, int]:
    """Rows and columns."""
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise SuppleError(f"{option} must be a width and a height in pixels, such as 512x512, found {text!r}")
    return int(height), int(width)


def _colour(option: str, text: str, verb: str = "must be") -> tuple[float, float, float]:
    digits = text.removeprefix("#")
    try:
        if len(digits) != 6:
            raise ValueError
        red, green, blue = bytes.fromhex(digits)
    except ValueError:
        raise SuppleError(f"{option} {verb} a colour such as #1a1a1e, found {text!r}") from None
    return red / 255, green / 255, blue / 255


@Parameter(name="*", group=CAMERA)
@dataclass(kw_only=True, eq=False, repr=False)
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
    elevation: Annotated[float, number(_DEGREES, "DEG")] = 0
    distance: Annotated[float | None, number("a number of millimetres", "MM")] = None
    field_of_view: Annotated[float, number(_DEGREES, "DEG")] = 30
    roll: Annotated[float, number(_DEGREES, "DEG")] = 0
    target: Annotated[Any, read(parse_three, "X,Y,Z")] = None
    up: Annotated[Any, read(parse_three, "X,Y,Z", show_default="0,0,1")] = (0.0, 0.0, 1.0)


@Parameter(name="*", group=LOOK)
@dataclass(kw_only=True, eq=False, repr=False)
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
    largest
        Of what is visible, show only the largest part that is connected: without the head holder of a CT, or specks.
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
    flat
        Render without shading.
    annotate
        Draw a scale bar, for what is as far away as the target, and letters for the patient's sides.
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
    mesh: Annotated[list[str], Parameter(metavar="FILE[:#RRGGBB]", show_default=False)] = ()  # type: ignore[assignment]
    largest: bool = False
    projection: Literal["none", "maximum", "minimum", "average"] = "none"
    silhouettes: Annotated[float, number("a number from 0 to 1", "S")] = 0
    shadows: Annotated[float, number("a number from 0 to 1", "S")] = 0
    size: Annotated[Any, read(_size, "WxH", show_default="512x512")] = (512, 512)
    step: Annotated[float | None, number("a number of millimetres", "MM")] = None
    mode: Annotated[str, Parameter(metavar="buffered|exact|hybrid")] = "buffered"
    flat: bool = False
    annotate: bool = False
    background: Annotated[Any, read(_colour, "#RRGGBB")] = None
    smooth: Annotated[int, Parameter(metavar="N", allow_leading_hyphen=True)] = 1
    turntable: Annotated[int | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None
    rate: Annotated[float | None, number("a number of pictures a second", "N")] = None
    what: Literal["picture", "inversions"] = "picture"
    time: Annotated[int, Parameter(metavar="K", allow_leading_hyphen=True)] = 0
    device: Literal["auto", "cpu", "gpu"] = "cpu"

    def to_render(self, camera: "Camera", convention: str | None = None) -> "RenderOptions":
        """Return the options as the library takes them."""
        from supple.files.renders import RenderOptions

        given = dict(vars(self))
        meshes, flat, smooth = [_mesh(text) for text in given.pop("mesh")], given.pop("flat"), given.pop("smooth")
        return RenderOptions(
            **given, meshes=meshes, shaded=not flat, supersampling=smooth, camera=camera, convention=convention
        )


def _mesh(text: str) -> "MeshFile":
    from supple.files.meshes import MeshFile

    path, _, digits = text.rpartition(":#")
    return MeshFile(path, _colour("--mesh", digits, "must end in")) if path else MeshFile(text)
