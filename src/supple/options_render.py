"""Options of the command that renders: where the camera stands, and what it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from supple.errors import SuppleError
from supple.options import parse_number
from supple.options_volume import parse_numbers, parse_three

if TYPE_CHECKING:
    from supple.camera import Camera
    from supple.views import RenderOptions

CAMERA = Group("Camera", sort_key=2)
LOOK = Group("Look", sort_key=3)


@Parameter(name="*", group=CAMERA)
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Where the camera stands.

    Parameters
    ----------
    azimuth
        Degrees around the head: 0 sees the face, 90 the patient's left, 180 the back.
    elevation
        Degrees above the horizon, from -90 to 90.
    distance
        Millimetres from the middle; by default, all of the volume fits.
    field_of_view
        Degrees across the shorter side of the picture (30).
    roll
        Degrees that the camera is turned clockwise.
    target
        The voxel that it looks at, instead of the middle.
    up
        Where above is, in LPS; 0,0,1 is the head, and the default.
    """

    azimuth: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    elevation: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    distance: Annotated[str | None, Parameter(metavar="MM", allow_leading_hyphen=True)] = None
    field_of_view: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "30"
    roll: Annotated[str, Parameter(metavar="DEG", allow_leading_hyphen=True)] = "0"
    target: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None
    up: Annotated[str, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = "0,0,1"

    def to_camera(self) -> Camera:
        """The same for the library."""
        from supple.camera import Camera

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
    """What is seen, and how.

    Parameters
    ----------
    transfer
        Colours and opacity: ct-bone, ct-skin, mr-head, grey, or a JSON file; by default what fits the values.
    density
        Only values from LO to HI are seen: hard structures inside, say.
    size
        Of the picture, in pixels (512x512).
    step
        Millimetres from sample to sample along a ray; the smallest spacing by default.
    mode
        How strokes are seen: by a certified lattice (default), exact at every sample, warped first (buffered), or the
        lattice while the GPU warps (hybrid).
    flat
        No shading.
    background
        A colour, #RRGGBB; without it, pictures are transparent where there is nothing.
    smooth
        Rays along each side of a pixel, for smoother outlines (1).
    turntable
        So many pictures around the volume: OUT is a video (MP4, MOV, MKV, WebM, GIF), or has a number in it
        (turn-%03d.png).
    rate
        Pictures a second of that video (24).
    what
        The picture, or how many inversions each ray needed.
    time
        Which volume of a series in time, from 0.
    device
        Who takes the pictures: the CPU, the GPU, or auto: a graphics card, where there is one.
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
        """The same for the library."""
        from supple.views import RenderOptions

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
