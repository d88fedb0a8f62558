"""How the window reads what it shows."""

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
    volume: VolumeOptions = PLAIN  # of its file; and whether the first strokes are in millimetres
    fit: Fit | None = None  # the scaling of the first strokes, if made for another size, as in `supple.warp_file`
    points: str | os.PathLike[str] | None = None  # a file of landmarks, shown in a volume
    convention: str | None = None  # of a table of them that does not name its own, as in `supple points`
    maps: tuple[Placed, ...] = ()  # fields and affine maps before all strokes, through which the source is seen
    frame: int | None = None  # of a clip, the one that is shown first
    fixed: str | os.PathLike[str] | None = None  # a volume that another one is registered to, on whose grid it is seen
    fixed_points: str | os.PathLike[str] | None = None  # landmarks of that
    segmentation: str | os.PathLike[str] | None = None  # labels over a volume, which move with it
    label_colours: str | os.PathLike[str] | None = None  # a table of their names and colours, or of a label map's own

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
        # Strokes are indices here, whatever the space of the first ones.
        known: dict[str, Any] = {"volume": replace(self.volume, world=False)}
        known |= {"maps": self.maps} if self.maps else {}
        return known if self.fixed is None else {**known, "grid": GridOptions(self.fixed, strokes=True)}
