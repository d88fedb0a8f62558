"""The options of jobs on clips and volumes, and of the grid that a result is written on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from supple.errors import SuppleError
from supple.media.files import PathLike as PathLike
from supple.space.checks import checked_spacing, integer, items, refuse

if TYPE_CHECKING:
    from fractions import Fraction

    from supple.media.volume import RawLayout

GB = 1e9


@dataclass(frozen=True, slots=True)
class ClipOptions:
    """Options for clips.

    Parameters
    ----------
    between : str, optional
        The interpolation between frames, as in `Deformation.warp`. By default ``"flow"``, if the extra ``flow`` is
        installed, or ``"linear"``.
    time_filter : bool
        Whether pixels are averaged over time.
    time_scale : float, optional
        The length of a frame in pixels, for the border and for strokes that are ``isotropic``: by default that of the
        recipe, or 1.
    rate : float or Fraction, optional
        Frames a second of an image sequence, which has no rate of its own; 24 by default.
    codec, preset, pixel_format : str, optional
        As in `supple.media.video.encode.writer`.
    crf : float, optional
        As in `supple.media.video.encode.writer`.
    memory : float
        The bytes of memory for frames; frames beyond that go to a temporary file.
    frames : tuple of int, optional
        The first and the last frame that are bent, counted from 0; the others are passed on as they are.
    frame : int, optional
        The one frame that is written, as a picture.
    hold : int
        The number of frames at each end that keep every bit. Strokes fade towards them, over a tenth of the clip or, of
        strokes with a time, over the width of the border along time.
    first_frame : int, optional
        The number of the first frame in warnings, 0 by default, and, where a video becomes pictures, in the name of the
        first one, 1 by default.
    """

    between: str | None = None
    time_filter: bool = False
    time_scale: float | None = None
    rate: float | Fraction | None = None
    codec: str | None = None
    crf: float | None = None
    preset: str | None = None
    pixel_format: str | None = None
    memory: float = 2 * GB
    frames: tuple[int, int] | None = None
    frame: int | None = None
    hold: int = 0
    first_frame: int | None = None


@dataclass(frozen=True, slots=True)
class VolumeOptions:
    """Options for volumes.

    Parameters
    ----------
    world : bool
        Whether the strokes' points are positions in space, in millimetres, in the file's own convention, rather than
        indices.
    labels : bool or str
        Whether values are labels, which are not interpolated: every voxel takes that of the nearest (True or
        ``"nearest"``), or that of the largest share of its footprint (``"smooth"``). Integers only, which may be stored
        as floats.
    save_field : str or os.PathLike, optional
        The file for the inverse displacement field, for SimpleITK, ANTs and 3D Slicer; beside a Zarr store, also
        one of OME-Zarr (``.zarr``), for both directions.
    layout : RawLayout, optional
        The layout of a file without a header.
    series : str, optional
        The DICOM series of a folder: its number in the list, or its UID.
    irregular : str, optional
        ``"resample"`` accepts DICOM slices that are missing or unevenly spaced, as in `supple.media.volume.read`.
    """

    world: bool = False
    labels: bool | str = False
    save_field: PathLike | None = None
    layout: RawLayout | None = None
    series: str | None = None
    irregular: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.labels, bool) and self.labels not in ("nearest", "smooth"):
            refuse("labels", '"nearest" or "smooth", or a flag', self.labels)

    @property
    def label_filter(self) -> str:
        """The filter of labels."""
        return "labels" if self.labels == "smooth" else "nearest"


@dataclass(frozen=True, slots=True)
class GridOptions:
    """The grid that a picture or a volume is written on; by default, its own.

    Parameters
    ----------
    reference : str or os.PathLike, optional
        Another image, whose grid it is: of a volume, its place in space; of a picture, its size.
    crop : sequence of int, optional
        A part of the grid: the indices of its first sample, and its sizes, x first: ``(X, Y, W, H)``, or
        ``(X, Y, Z, W, H, D)`` for volumes. The result equals that part of the whole, bit for bit.
    resample : float or sequence of float, optional
        Another spacing over the same extent: in millimetres for volumes, in pixels of the input for pictures; one for
        all axes, or one for each, x first. It comes after ``reference``, and before ``crop``. The grid of a sheared
        volume becomes upright.
    strokes : bool
        Whether the strokes are on the grid of ``reference``, too, and not on that of the input: their voxels, the
        border, and freeze masks. For volumes, in whose registration ``reference`` is the fixed one.

    Raises
    ------
    SuppleError
        If an argument is invalid.
    """

    reference: PathLike | None = None
    crop: Sequence[int] | None = None
    resample: float | Sequence[float] | None = None
    strokes: bool = False

    def __post_init__(self) -> None:
        if self.strokes and self.reference is None:
            raise SuppleError("strokes are on the grid of a reference, and there is none: name one")
        if self.crop is not None:
            wanted = "X,Y,W,H for a picture, or X,Y,Z,W,H,D for a volume: first indices, then sizes"
            given = items("crop", self.crop, wanted, (4, 6))
            n = len(given) // 2
            box = [
                integer("crop", x, f"{wanted}, indices from 0 and sizes from 1", k >= n, 2**31)
                for k, x in enumerate(given)
            ]
            object.__setattr__(self, "crop", tuple(box))
        if self.resample is not None:
            steps = self.resample if isinstance(self.resample, Sequence) else (self.resample,)
            try:
                made = checked_spacing(steps, len(steps))
            except SuppleError:
                made = ()
            if not 1 <= len(made) <= 3:
                refuse("resample", "a spacing above 0, or one for each axis, x first", self.resample)
            object.__setattr__(self, "resample", made if len(made) > 1 else made[0])

    @property
    def ndim(self) -> int | None:
        """The number of axes that the options tell; None if they tell none."""
        if self.crop is not None:
            return len(self.crop) // 2
        return len(self.resample) if isinstance(self.resample, tuple) else None
