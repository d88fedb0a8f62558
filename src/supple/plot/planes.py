"""Planes of volumes in plots: chosen in millimetres, oriented as radiologists do, with letters and a scale bar."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.plot.frame import Box, set_axes
from supple.space.checks import refuse
from supple.space.geometry import PLANES, SIDES, Floats, Grid, plane_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Ints = npt.NDArray[np.intp]

_WANTED = "axial, coronal or sagittal, perhaps with a place in millimetres in LPS, as axial:12.5"
_BAR = 0.25  # the largest length of a scale bar, as a fraction of the width
_OUTLINE = "#101010"


class Plane(NamedTuple):
    """A slice of a grid, nearest in orientation to a plane of the patient, and its axes in a picture."""

    grid: Grid
    name: str
    through: int  # the grid's axis, x first, across the slice
    number: int
    across: int  # the grid's axis to the right in the picture
    down: int  # the grid's axis down in the picture
    flipped: tuple[bool, bool]  # whether indices decrease to the right, and down

    @property
    def steps(self) -> tuple[float, float]:
        """The distances of samples to the right and down, in millimetres."""
        return self.grid.spacing[self.across], self.grid.spacing[self.down]

    @property
    def ways(self) -> Floats:
        """The directions to the right and down in LPS, as rows."""
        signs = np.where(self.flipped, -1.0, 1.0)[:, None]
        return np.array(self.grid.direction).T[[self.across, self.down]] * signs

    @property
    def letters(self) -> tuple[str, str, str, str]:
        """The sides of the patient that lie to the left, to the right, above and below."""
        right, below = self.ways
        return _side(-right), _side(right), _side(-below), _side(below)

    @property
    def text(self) -> str:
        """The plane in words, with the place of its middle along the axis of the patient."""
        last = self.grid.sizes[self.through] - 1
        axis = PLANES[self.name][0][0]
        place = _places(self.grid, self.through, axis)[self.number]
        side = SIDES[axis][int(place < 0)]
        return f"{self.name} slice {self.number} (of 0 to {last}), at {side} {abs(place):.4g} mm"

    @property
    def part(self) -> Grid:
        """The grid of the slice alone."""
        first, sizes = [0, 0, 0], list(self.grid.sizes)
        first[self.through], sizes[self.through] = self.number, 1
        return self.grid.crop(first, sizes)

    def seen(self, values: npt.NDArray[Any], index: int | None = None) -> npt.NDArray[Any]:
        """Return the slice of an array of samples or cells (Z, Y, X, ...), oriented as in the picture (H, W, ...)."""
        made = np.take(values, self.number if index is None else index, axis=2 - self.through)
        made = made.swapaxes(0, 1) if self.down < self.across else made
        rows, columns = (slice(None, None, -1 if f else None) for f in self.flipped[::-1])
        return np.asarray(made[rows, columns])


def chosen(grid: Grid, text: str | None, weights: Callable[[int], Floats | Ints] | None = None) -> Plane:
    """Return a slice of a grid: axial, coronal or sagittal, perhaps at a place in millimetres: ``axial:12.5``.

    Without a place, it is the slice with the largest weight, or the middle one; ``weights`` returns those of all slices
    across an axis, x first. Without a text, it is axial. SuppleError for other texts, and for a place beyond the grid.
    """
    name, colon, at = (text or "axial").strip().lower().partition(":")
    if name not in PLANES:
        refuse("plane", _WANTED, text)
    (through, across, down), (_, right, below) = plane_axes(grid.direction, name)
    places = _places(grid, through, PLANES[name][0][0])
    if colon:
        try:
            wanted = float(at)
        except ValueError:
            refuse("plane", _WANTED, text)
        step = abs(places[-1] - places[0]) / max(len(places) - 1, 1) or grid.spacing[through]
        index = int(np.abs(places - wanted).argmin())
        if not abs(places[index] - wanted) <= 0.51 * step:
            low, high = sorted((float(places[0]), float(places[-1])))
            refuse("plane", f"within the volume, whose {name} slices lie from {low:.4g} to {high:.4g} mm in LPS", text)
    else:
        sums = np.zeros(1) if weights is None else weights(through)
        index = int(sums.argmax()) if sums.any() else (len(places) - 1) // 2
    return Plane(grid, name, through, index, across, down, (right < 0, below < 0))


def _places(grid: Grid, through: int, axis: int) -> Floats:
    """Return the positions of the slices' centres along an axis of LPS, in millimetres."""
    middle = np.tile((np.array(grid.sizes) - 1) / 2, (grid.sizes[through], 1))
    middle[:, through] = np.arange(grid.sizes[through])
    return np.asarray(grid.positions(middle)[:, axis])


def _side(way: Floats) -> str:
    """Return the letter of the patient's side that a direction points to."""
    axis = int(np.abs(way).argmax())
    return SIDES[axis][int(way[axis] < 0)]


def set_up(axes: Axes, plane: Plane, box: Box, name: str) -> None:
    """Set axes up for a picture in millimetres: the letters of the patient's sides at its edges, a scale bar below."""
    from matplotlib.patheffects import withStroke

    before, after, above, below = plane.letters
    set_axes(axes, box, 1.0, name, (f"{before} → {after} (mm)", f"{below} ← {above} (mm)"))
    left, right, bottom, top = box
    halo: dict[str, Any] = {"path_effects": [withStroke(linewidth=2.4, foreground=_OUTLINE)], "color": "white"}
    for text, x, y in zip(plane.letters, (0.02, 0.98, 0.5, 0.5), (0.5, 0.5, 0.98, 0.02), strict=True):
        across = "left" if x < 0.5 else "right" if x > 0.5 else "center"
        along = "bottom" if y < 0.5 else "top" if y > 0.5 else "center"
        axes.text(
            x, y, text, transform=axes.transAxes, ha=across, va=along, fontsize=12, weight="bold", zorder=6, **halo
        )
    power = 10.0 ** math.floor(math.log10(_BAR * (right - left)))
    length = power * max(k for k in (1, 2, 5) if k * power <= _BAR * (right - left))
    x, y = left + 0.04 * (right - left), bottom - 0.04 * (bottom - top)
    outline = [withStroke(linewidth=5, foreground=_OUTLINE)]
    axes.plot(
        [x, x + length], [y, y], color="white", linewidth=3, solid_capstyle="butt", path_effects=outline, zorder=6
    )
    axes.annotate(
        f"{length:g} mm", (x, y), (0, 5), textcoords="offset points", fontsize=9, va="bottom", zorder=6, **halo
    )
