"""The options with which the window reads its source."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

from supple.errors import SuppleError, argument
from supple.fields import Placed
from supple.files.options import GridOptions, VolumeOptions
from supple.space.checks import length
from supple.strokes import Fit

Spacing = tuple[float, float, float]
EVEN = (1.0, 1.0, 1.0)
PLAIN = VolumeOptions()


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """The options for reading a source."""

    spacing: Spacing = EVEN  # of the voxels of an array, in millimetres, x first
    time_scale: float = 1.0  # the length of a clip's frame in pixels, for the brush
    volume: VolumeOptions = PLAIN  # for a volume file; and whether the first strokes are in millimetres
    fit: Fit | None = None  # the scaling of the first strokes, if made for another size, as in `supple.warp_file`
    points: str | os.PathLike[str] | None = None  # a file of landmarks, shown in a volume
    convention: str | None = None  # the coordinates of a table of points that does not name them, as in `supple points`
    maps: tuple[Placed, ...] = ()  # fields and affine maps before all strokes, through which the source is shown
    frame: int | None = None  # the first frame to show, of a clip
    fixed: str | os.PathLike[str] | None = None  # the fixed volume of a registration: the source is shown on its grid
    fixed_points: str | os.PathLike[str] | None = None  # landmarks of the fixed volume
    segmentation: str | os.PathLike[str] | None = None  # labels over a volume, which move with it
    label_colours: str | os.PathLike[str] | None = None  # names and colours, for the segmentation or a label map

    def __post_init__(self) -> None:
        length("time_scale", self.time_scale)
        if any(placed.after for placed in self.maps):
            raise SuppleError("in the window, strokes come after fields and affine maps: give these first")
        if self.fixed_points is not None and self.fixed is None:
            raise SuppleError(f"{argument('fixed_points')} are those of a fixed volume, and there is none: name it")
        if self.convention is not None and self.points is None and self.fixed_points is None:
            raise SuppleError("the convention is that of points, and there are none: give a file of them")

    @property
    def export(self) -> dict[str, Any]:
        """The arguments of `supple.warp_file` for the same image as on screen."""
        # Points of strokes are voxels here, whatever the space of the first strokes.
        known: dict[str, Any] = {"volume": replace(self.volume, world=False)}
        known |= {"maps": self.maps} if self.maps else {}
        return known if self.fixed is None else {**known, "grid": GridOptions(self.fixed, strokes=True)}
