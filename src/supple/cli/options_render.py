"""Options of the command that renders: where the camera stands, and what it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from supple.cli.options import parse_number
from supple.cli.options_volume import parse_numbers, parse_three
from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.files.renders import RenderOptions
    from supple.render.camera import Camera

CAMERA = Group("Camera", sort_key=2)
LOOK = Group("Look", sort_key=3)


@Parameter(name="*", group=CAMERA)
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Where the camera stands.

    Parameters
    ----------
    azimuth
        Angle around the head, in degrees: 0 faces the patient, 90 sees the patient's left, 180 the back.
    elevation
        Angle above the horizon in degrees, from -90 to 90.
    distance
        Distance from the target in millimetres (default: the whole volume is in view).
    field_of_view
        Angle of view across the shorter side of the picture, in degrees.
    roll
        Turn the camera clockwise, in degrees.
    target
        Voxel at which the camera looks (default: the centre of the volume).
    up
        Direction that is up in the picture, in LPS coordinates; 0,0,1 points to the head.
    """

    azimuth: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    elevation: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    distance: Annotated[str | None, Parameter(metavar="MM", allow_leading_hyphen=True)] = None
    field_of_view: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "30"
    roll: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    target: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None
    up: Annotated[str, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = "0,0,1"

    def to_camera(self) -> Camera:
        """Return the options as the library takes them."""
        from supple.render.camera import Camera

        degrees = "a number of degrees"
        return Camera(
            azimuth=parse_number("--azimuth", self.azimuth, degrees),
            elevation=parse_number("--elevation", self.elevation, degrees),
            distance=None
            if self.distance is None
            else parse_number("--distance", self.distance, "a number of millimetres"),
            field_of_view=parse_number("--field-of-view", self.field_of_view, degrees),
            roll=parse_number("--roll", self.roll, degrees),
            target=None if self.target is None else parse_three("--target", self.target),
            up=parse_three("--up", self.up),
        )


@Parameter(name="*", group=LOOK)
@dataclass(frozen=True, kw_only=True)
class LookOptions:
    """Options for the look of the volume.

    Parameters
    ----------
    transfer
        Transfer function (colours and opacity): ct-bone, ct-skin, mr-head, grey, or a JSON file (default:
        chosen by the values).
    density
        Show only values from LO to HI.
    size
        Width and height of the picture in pixels.
    step
        Distance between samples along a ray, in millimetres (default: the smallest spacing).
    mode
        How the deformed volume is sampled. lattice (default): inverse map interpolated from a lattice, with an
        error bound. exact: inverse solved at each sample. buffered: the volume is warped first. hybrid: lattice
        until the GPU has warped the volume.
    flat
        Render without shading.
    background
        Background colour (default: transparent; black in formats and videos without opacity).
    smooth
        Antialiasing: rays along each side of a pixel.
    turntable
        Number of pictures on a circle around the volume. OUT is then a video (MP4, MOV, MKV, WebM, GIF), or a name
        with a number such as turn-%03d.png.
    rate
        Frames per second of a turntable video.
    what
        Render the picture, or plot how many inversions each ray needed.
    time
        Which volume of a time series to show, counted from 0.
    device
        Where to render: cpu, gpu, or auto (the GPU if there is one).
    """

    transfer: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    density: Annotated[str | None, Parameter(metavar="LO,HI", allow_leading_hyphen=True)] = None
    size: Annotated[str, Parameter(metavar="WxH", allow_leading_hyphen=True)] = "512x512"
    step: Annotated[str | None, Parameter(metavar="MM", allow_leading_hyphen=True)] = None
    mode: Literal["lattice", "exact", "buffered", "hybrid"] = "lattice"
    flat: bool = False
    background: Annotated[str | None, Parameter(metavar="#RRGGBB")] = None
    smooth: Annotated[int, Parameter(metavar="N", allow_leading_hyphen=True)] = 1
    turntable: Annotated[int | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None
    rate: Annotated[str, Parameter(metavar="N", allow_leading_hyphen=True)] = "24"
    what: Literal["picture", "inversions"] = "picture"
    time: Annotated[int, Parameter(metavar="K", allow_leading_hyphen=True)] = 0
    device: Literal["auto", "cpu", "gpu"] = "cpu"

    def to_render(self, camera: Camera) -> RenderOptions:
        """Return the options as the library takes them."""
        from supple.files.renders import RenderOptions

        return RenderOptions(
            transfer=self.transfer,
            density=None if self.density is None else parse_numbers("--density", self.density, 2, "two values LO,HI"),  # type: ignore[arg-type]
            camera=camera,
            size=_size(self.size),
            step=None if self.step is None else parse_number("--step", self.step, "a number of millimetres"),
            mode=self.mode,
            shaded=not self.flat,
            background=None if self.background is None else _colour(self.background),
            supersampling=self.smooth,
            turntable=self.turntable,
            rate=parse_number("--rate", self.rate, "a number of pictures a second"),
            what=self.what,
            time=self.time,
            device=self.device,
        )


def _size(text: str) -> tuple[int, int]:
    """Rows and columns."""
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise SuppleError(f"--size must be a width and a height in pixels, such as 512x512, found {text!r}")
    return int(height), int(width)


def _colour(text: str) -> tuple[float, float, float]:
    digits = text.removeprefix("#")
    try:
        if len(digits) != 6:
            raise ValueError
        red, green, blue = bytes.fromhex(digits)
    except ValueError:
        raise SuppleError(f"--background must be a colour such as #1a1a1e, found {text!r}") from None
    return red / 255, green / 255, blue / 255
