"""Options for jobs on clips and volumes, and for the grid of the output."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from supple.errors import SuppleError, argument, shown
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
        The length of a frame in pixels, for the border and for ``isotropic`` strokes; by default that of the recipe,
        or 1.
    rate : float or Fraction, optional
        Frames a second of an image sequence, which has no rate of its own; 24 by default.
    codec, preset, pixel_format : str, optional
        As in `supple.media.video.encode.writer`.
    crf : float, optional
        As in `supple.media.video.encode.writer`.
    memory : float
        Bytes of memory for frames; frames beyond that go to a temporary file.
    frames : tuple of int, optional
        The first and the last frame to bend, counted from 0; all others are passed on unchanged.
    frame : int, optional
        The only frame to write, as a picture.
    hold : int
        The number of frames at each end that keep every bit. Strokes fade towards these over a tenth of the clip;
        strokes with a time, over the width of the border along time.
    first_frame : int, optional
        The number of the first frame in warnings, by default 0; and in the name of the first picture, if a video is
        written as pictures, by default 1.
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
        Whether the points of strokes are positions in millimetres, in the file's own convention, and not indices.
    labels : bool or str
        Whether values are labels, which are not interpolated: every voxel takes the label of the nearest voxel (True or
        ``"nearest"``), or the one with the largest share of its footprint (``"smooth"``). Labels are integers, which
        may be stored as floats.
    layout : RawLayout, optional
        The layout of a file without a header.
    series : str, optional
        The DICOM series in a folder: its number in the list, or its UID.
    irregular : str, optional
        ``"resample"`` accepts DICOM slices that are missing or unevenly spaced, as in `supple.media.volume.read`.
    """

    world: bool = False
    labels: bool | str = False
    layout: RawLayout | None = None
    series: str | None = None
    irregular: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.labels, bool) and self.labels not in ("nearest", "smooth"):
            refuse("labels", '"nearest" or "smooth", or a flag', self.labels)

    def check(self, path: PathLike) -> None:
        """Raise SuppleError if options for DICOM are given, and a file or folder is not DICOM."""
        from supple.media.numbering import has_number
        from supple.media.volume import is_dicom

        for name in ("series", "irregular"):
            if getattr(self, name) is not None and (os.path.exists(path) or has_number(path)) and not is_dicom(path):
                raise SuppleError(f"{argument(name)} is for DICOM folders, and {shown(path)} is none: leave it out")

    @property
    def how(self) -> dict[str, Any]:
        """The options that are given for `supple.media.volume.read`."""
        given = {"raw": self.layout, "series": self.series, "irregular": self.irregular}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True, slots=True)
class Running:
    """Where the tasks of a job run, in one of two ways; by default, on threads of this process."""

    workers: int | None = None  # the number of processes on this machine
    scheduler: str | None = None  # the address of that of a cluster of Dask, such as ``tcp://node1:8786``

    def __post_init__(self) -> None:
        given: object = self.workers  # user input of any type
        if given is not None and (not isinstance(given, int) or isinstance(given, bool) or given < 1):
            refuse("workers", "a number of processes from 1", given)
        if self.workers is not None and self.scheduler is not None:
            raise SuppleError(
                "workers starts processes on this machine, and scheduler uses a cluster: give one of them"
            )

    @property
    def elsewhere(self) -> bool:
        """True if tasks run in other processes."""
        return self.workers is not None or self.scheduler is not None


@dataclass(frozen=True, slots=True)
class GridOptions:
    """The output grid of a picture or a volume; by default, that of the input.

    Parameters
    ----------
    reference : str or os.PathLike, optional
        Another image, whose grid is used: a volume's position in space, a picture's size.
    crop : sequence of int, optional
        A part of the grid: the indices of its first sample, and its sizes, x first: ``(X, Y, W, H)``, or
        ``(X, Y, Z, W, H, D)`` for volumes. The result equals that part of the whole result, bit for bit.
    resample : float or sequence of float, optional
        Another spacing over the same extent: in millimetres for volumes, in pixels of the input for pictures; one for
        all axes, or one for each, x first. It is applied after ``reference`` and before ``crop``. The grid of a sheared
        volume becomes upright.
    strokes : bool
        Whether strokes, the border and freeze masks are on the grid of ``reference``, too, and not on that of the
        input. For volumes in a registration, whose fixed volume is ``reference``.

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
        """The number of axes, 2 or 3, that the options imply; None if they imply none."""
        if self.crop is not None:
            return len(self.crop) // 2
        return len(self.resample) if isinstance(self.resample, tuple) else None
