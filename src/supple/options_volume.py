"""Options of commands on volumes: what is in a file, and how it is seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from supple.errors import SuppleError
from supple.options import parse_number

if TYPE_CHECKING:
    from supple.camera import Camera
    from supple.views import RenderOptions
    from supple.volumes import VolumeOptions as Reading

VOLUME = Group("Volumes", sort_key=5)
CAMERA = Group("Camera", sort_key=2)
LOOK = Group("Look", sort_key=3)


@Parameter(name="*", group=VOLUME)
@dataclass(frozen=True, kw_only=True)
class VolumeOptions:
    """What is particular to volumes.

    Parameters
    ----------
    world
        Points are places in space, in millimetres, as the file has them: RAS for NIfTI, LPS for DICOM, NRRD, MetaImage.
    series
        Which DICOM series of a folder with several: its number in the list, or its UID.
    shape
        Voxels along x, y and z of a file without a header; with --dtype, and perhaps --spacing.
    dtype
        Its type: uint8, int16, <i2 (little-endian), >f4, …
    spacing
        Millimetres from voxel to voxel along x, y and z (1).
    """

    world: bool = False
    series: Annotated[str | None, Parameter(metavar="N|UID")] = None
    shape: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None
    dtype: Annotated[str | None, Parameter(metavar="TYPE")] = None
    spacing: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None

    def to_reading(self, *, labels: bool = False, save_field: str | None = None) -> Reading:
        """The same for the library."""
        from supple.media.volume import RawLayout
        from supple.volumes import VolumeOptions as Reading

        layout = None
        if self.shape is not None or self.dtype is not None or self.spacing is not None:
            if self.shape is None or self.dtype is None:
                raise SuppleError(
                    "a file without a header needs both --shape X,Y,Z and --dtype: give the other one too"
                )
            sizes = tuple(int(n) if n.is_integer() else n for n in _three("--shape", self.shape))
            spacing = (1.0, 1.0, 1.0) if self.spacing is None else _three("--spacing", self.spacing)
            layout = RawLayout(sizes, self.dtype, spacing)  # type: ignore[arg-type]
        return Reading(world=self.world, labels=labels, save_field=save_field, layout=layout, series=self.series)


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
            target=None if self.target is None else _three("--target", self.target),
            up=_three("--up", self.up),
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
        So many pictures around the volume: OUT is a video, or has a number in it (turn-%03d.png).
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
            density=None if self.density is None else _numbers("--density", self.density, 2, "two values LO,HI"),  # type: ignore[arg-type]
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


def _numbers(name: str, text: str, count: int, wanted: str) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) != count:
        raise SuppleError(f"{name} must be {wanted}, found {text!r}")
    return tuple(parse_number(name, part, wanted) for part in parts)


def _three(name: str, text: str) -> tuple[float, float, float]:
    x, y, z = _numbers(name, text, 3, "three numbers X,Y,Z")
    return x, y, z


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
