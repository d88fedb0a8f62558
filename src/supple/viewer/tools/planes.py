"""The planes of a volume on a canvas: their axes, their orientation, and their places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Self

import numpy as np

from supple.space.geometry import PLANES, SIDES, Floats, Geometry, Grid, plane_axes
from supple.viewer.tools.drawing import Pair, Place

Point = tuple[float, float, float]

RENDERED = 3
"""The number of the rendering among the views; 0, 1 and 2 are the axial, the coronal and the sagittal plane."""
FIXED = 4
"""The numbers of the same planes of a fixed volume begin here."""
GAP = 2.0  # logical pixels between two views
_MARGIN = 0.9  # of a view: a plane that fits leaves room for letters
_NEAREST, _FARTHEST = 40.0, 0.5  # zoom, relative to planes that fit


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane along two axes of a volume's voxels, oriented as radiologists see it."""

    # The nearest of ``"axial"``, ``"coronal"`` and ``"sagittal"``; or the names of its axes, for voxels without a
    # position in space
    name: str
    # The axes of the voxels, x is 0: the plane's normal, the axis seen from left to right, and from top to bottom
    axis: int
    across: int
    down: int
    signs: tuple[int, int]  # 1 if indices rise to the right, and down; otherwise -1
    forward: int  # 1 if the wheel, turned forward, leads to higher indices, or -1
    # The names of the left, the right, the top and the bottom: letters of a patient, or an axis with its sign
    sides: tuple[str, str, str, str]

    @property
    def normal(self) -> Point:
        """The axis about which a right-handed turn is clockwise as it is seen."""
        turns = self.signs[0] * self.signs[1] * (1 if (self.down - self.across) % 3 == 1 else -1)
        x, y, z = (float(turns * (k == self.axis)) for k in range(3))
        return x, y, z


def planes_of(geometry: Geometry) -> tuple[Plane, ...]:
    """Return the planes along a volume's voxels that are nearest to the axial, the coronal and the sagittal one."""
    made, placed = [], geometry.convention != "array"
    for name, (_, right, below) in PLANES.items():
        (axis, across, down), (forward, one, other) = plane_axes(geometry.direction, name)
        if placed:
            sides = (*SIDES[right[0]][:: -right[1]], *SIDES[below[0]][:: -below[1]])
        else:
            ends = (across, one), (down, other)
            sides = tuple(f"{sign}{'xyz'[axis]}" for axis, way in ends for sign in "-+"[::way])
            name = "".join("xyz"[k] for k in sorted((across, down)))
        left, beyond, top, bottom = sides
        made.append(Plane(name, axis, across, down, (one, other), forward, (left, beyond, top, bottom)))
    return tuple(made)


def ends_of(planes: tuple[Plane, ...]) -> dict[int, tuple[str, str]]:
    """Return, for each axis of a volume, the names of the sides at its first and at its last voxel."""
    made = {}
    for plane in planes:
        (left, right, top, bottom), (one, other) = plane.sides, plane.signs
        made[plane.across] = (left, right) if one > 0 else (right, left)
        made[plane.down] = (top, bottom) if other > 0 else (bottom, top)
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """A grid around an oblique volume, along the axes of the patient that are nearest to those of the voxels."""

    grid: Grid
    matrix: Floats  # from voxels, homogeneous, to its samples
    inverse: Floats

    @classmethod
    def of(cls, geometry: Geometry, sizes: tuple[int, ...]) -> Upright:
        """Return the smallest such grid around a volume, with the spacing of its voxels."""
        turned = np.zeros((3, 3))
        for name, ((k, _), *_) in PLANES.items():
            axis = plane_axes(geometry.direction, name)[0][0]
            turned[k, axis] = np.copysign(1.0, geometry.direction[k, axis])
        corners = geometry.to_lps(list(product(*[(-0.5, n - 0.5) for n in sizes]))) @ turned / geometry.spacing
        low, counts = corners.min(axis=0), np.maximum(np.ceil(np.ptp(corners, axis=0) - 1e-6), 1).astype(int)
        origin = turned @ ((low + 0.5) * geometry.spacing)
        grid = Grid(counts[::-1].tolist(), geometry.spacing, origin.tolist(), turned)
        matrix, inverse = (np.linalg.solve(a, b) for a, b in pairwise((grid.matrix, geometry.matrix, grid.matrix)))
        return cls(grid, np.asarray(matrix, np.float64), np.asarray(inverse, np.float64))

    def seen(self, point: tuple[float, ...]) -> Point:
        """Return the sample at a voxel."""
        x, y, z, _ = (self.matrix @ (*point, 1.0)).tolist()
        return x, y, z

    def voxel(self, sample: tuple[float, ...]) -> Point:
        """Return the voxel at a sample."""
        x, y, z, _ = (self.inverse @ (*sample, 1.0)).tolist()
        return x, y, z


@dataclass(frozen=True, slots=True)
class Pane:
    """A plane in its place on the canvas; its own indices are voxels or, with ``upright``, those of that grid."""

    plane: Plane
    place: Place  # the rectangle of its view
    index: tuple[int, ...]  # the voxel under the crosshair, x first: the plane goes through it
    middle: Point  # the voxel in the middle of the view
    scale: float  # logical pixels of a millimetre
    spacing: Point
    sizes: tuple[int, ...]  # the number of voxels along each axis
    upright: Upright | None = None

    def own(self, point: tuple[float, ...]) -> tuple[float, ...]:
        """Return a point, in voxels, in the indices of the plane."""
        return point if self.upright is None else self.upright.seen(point)

    def to_canvas(self, point: tuple[float, ...]) -> Pair:
        """Return the position of a point, in voxels, on the canvas; it may lie before the plane or behind it."""
        return self.placed(self.own(point))

    def placed(self, point: tuple[float, ...]) -> Pair:
        """Return the position of a point of the plane's own indices on the canvas."""
        (left, top, width, height), plane, (one, other) = self.place, self.plane, self.plane.signs
        a, b = ((point[k] - self.middle[k]) * self.spacing[k] * self.scale for k in (plane.across, plane.down))
        return left + width / 2 + one * a, top + height / 2 + other * b

    def to_point(self, x: float, y: float) -> Point:
        """Return the point of the plane, in voxels, under a position of the canvas; it may lie outside the volume."""
        made = self.under(x, y)
        return made if self.upright is None else self.upright.voxel(made)

    def under(self, x: float, y: float) -> Point:
        """Return the point of the plane under a position of the canvas, in the plane's own indices."""
        (left, top, width, height), plane = self.place, self.plane
        made = [float(k) for k in self.index]
        ways = (plane.across, plane.signs[0], x - left - width / 2), (plane.down, plane.signs[1], y - top - height / 2)
        for axis, sign, away in ways:
            made[axis] = self.middle[axis] + sign * away / (self.spacing[axis] * self.scale)
        return made[0], made[1], made[2]

    def holds(self, point: tuple[float, ...]) -> bool:
        """Return whether a point lies within the volume."""
        return all(-0.5 <= p <= n - 0.5 for p, n in zip(point, self.sizes, strict=True))

    def crosses(self, point: tuple[float, ...]) -> bool:
        """Return whether a point lies within half a voxel of the plane."""
        return abs(self.away(point)) <= 0.5

    def away(self, point: tuple[float, ...]) -> float:
        """Return the signed distance of a point from the plane, in slices."""
        return self.own(point)[self.plane.axis] - self.index[self.plane.axis]

    @property
    def box(self) -> Place:
        """The rectangle of the whole plane on the canvas; a part of it may lie beyond the view."""
        sizes = self.sizes if self.upright is None else self.upright.grid.sizes
        (a, b), (c, d) = self.placed((-0.5,) * 3), self.placed(tuple(n - 0.5 for n in sizes))
        return min(a, c), min(b, d), abs(c - a), abs(d - b)


@dataclass(frozen=True, slots=True)
class Sight:
    """The crosshair, and the windows of values, of a volume's planes."""

    cross: Point  # the crosshair, in voxels, x first: planes go through the voxel that is nearest
    window: Pair  # the values that are black and white
    fixed: Pair  # and of a fixed volume
    middle: Point  # the voxel in the middle of the views
    zoom: float = 1.0  # relative to the size at which all planes fit
    large: int | None = None  # the number of the view that has the whole canvas

    def at(self, point: tuple[float, ...], sizes: tuple[int, ...]) -> Self:
        """Return the sight with the crosshair at a point, or at the voxel of the volume that is nearest."""
        return replace(self, cross=_within(point, sizes))

    def slid(self, pane: Pane, dx: float, dy: float) -> Self:
        """Return the sight moved by logical pixels of a pane."""
        (left, top, width, height), middle = pane.place, pane.under
        moved = middle(left + width / 2 - dx, top + height / 2 - dy)
        return self._about(pane, moved)

    def zoomed(self, pane: Pane, x: float, y: float, factor: float) -> Self:
        """Return the sight zoomed about a position of a pane."""
        zoom = min(max(self.zoom * factor, _FARTHEST), _NEAREST)
        point, kept = pane.under(x, y), self.zoom / zoom
        moved = tuple(p + (m - p) * kept for p, m in zip(point, self.middle, strict=True))
        return replace(self._about(pane, moved), zoom=zoom)

    def _about(self, pane: Pane, middle: tuple[float, ...]) -> Self:
        """Return the sight with another middle, along the axes of a pane."""
        axis = pane.plane.axis
        kept = tuple(self.middle[k] if k == axis else middle[k] for k in range(3))
        return replace(self, middle=_within(kept, pane.sizes if pane.upright is None else pane.upright.grid.sizes))

    def levelled(self, wider: float, brighter: float, *, fixed: bool = False) -> Self:
        """Return the sight with a window, or the ``fixed`` one, ``wider`` by a factor, ``brighter`` by a part of it."""
        low, high = self.fixed if fixed else self.window
        level, width = 0.5 * (low + high) - brighter * (high - low), (high - low) * wider
        made = level - 0.5 * width, level + 0.5 * width
        return replace(self, fixed=made) if fixed else replace(self, window=made)


def _within(point: tuple[float, ...], sizes: tuple[int, ...]) -> Point:
    x, y, z = (min(max(float(p), 0.0), n - 1.0) for p, n in zip(point, sizes, strict=True))
    return x, y, z


def places_of(canvas: Pair, large: int | None, top: float = 0.0, beside: bool = False) -> dict[int, Place]:
    """Return the places of the visible views on a canvas that begins at ``top``: the rendering is at the upper right.

    With ``beside``, the planes of a fixed volume are below those of the other one, and beside a plane that is large.
    """
    width, height = canvas
    if beside and large != RENDERED:
        planes = range(RENDERED) if large is None else (large,)
        across = max((width - GAP * (2 if large is None else 1)) / (3 if large is None else 2), 1.0)
        high = max((height - GAP) / 2, 1.0) if large is None else height
        above = {k: (i * (across + GAP), top) for i, k in enumerate(planes)}
        steps = (0.0, high + GAP) if large is None else (across + GAP, 0.0)
        other = {k + FIXED: (x + steps[0], y + steps[1]) for k, (x, y) in above.items()}
        return {k: (x, y, across, high) for k, (x, y) in (above | other).items()}
    if large is not None:
        return {large: (0.0, top, width, height)}
    across, down = max((width - GAP) / 2, 1.0), max((height - GAP) / 2, 1.0)
    right, below = across + GAP, top + down + GAP
    corners = ((0.0, top), (0.0, below), (right, below), (right, top))
    return {k: (x, y, across, down) for k, (x, y) in enumerate(corners)}


def fitting(places: dict[int, Place], planes: tuple[Plane, ...], sizes: tuple[int, ...], spacing: Point) -> float:
    """Return the logical pixels of a millimetre at which all visible planes fit."""
    extent = [n * s for n, s in zip(sizes, spacing, strict=True)]
    fits = [
        _MARGIN * min(place[2] / extent[planes[k % FIXED].across], place[3] / extent[planes[k % FIXED].down])
        for k, place in places.items()
        if k != RENDERED
    ]
    return min(fits, default=1.0)


def holding(places: dict[int, Place], x: float, y: float) -> int | None:
    """Return the number of the view at a position of the canvas; None beside all views."""
    for k, (left, top, width, height) in places.items():
        if left <= x < left + width and top <= y < top + height:
            return k
    return None
