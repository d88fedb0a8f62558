"""Straightening of pictures: rotation, shear, perspective and frame, as one map of the plane and an output size."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, Self, get_args

import numpy as np

from supple.errors import SuppleError
from supple.space.affine import Affine, Projective
from supple.space.checks import Shape, Vector, assign, choice, integer, items, number, point, refuse
from supple.space.geometry import Floats

Frame = Literal["crop", "pad", "keep"]
FRAMES: tuple[str, ...] = get_args(Frame)

MOST_SHEAR = 60.0  # degrees
_LONGEST = 1 << 20  # pixels of a side: a larger size is a mistake
_STEEPEST = 20.0  # the largest scale at a place, over that in the middle
_ROUNDING = 1e-6  # pixels
_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


@dataclass(frozen=True, slots=True)
class Straighten:
    """How to straighten a picture after all strokes: keystone, then rotation, then shear.

    Parameters
    ----------
    rotate : float
        Degrees, clockwise on a screen, about the middle of the picture.
    shear : float or (float, float)
        Degrees by which verticals and, with a second number, horizontals lean: x becomes x + y tan(first), y
        becomes y + x tan(second), measured from the middle of the picture.
    keystone : sequence of four points
        The corners of what should become an upright rectangle, in pixels: top left, top right, bottom right, bottom
        left. Each of its sides has the mean length of two opposite sides, and its middle stays.
    scale_to : int or sequence of int
        The width of the result in pixels, or its width and height: the picture is not distorted, but its frame gets
        these proportions. Empty: pixels keep their size.
    fit : str
        The frame of the result. ``"crop"``: the largest without empty corners, with the proportions of the picture
        (or of its nearest quarter turn). ``"pad"``: all of the picture, with empty corners. ``"keep"``: that of the
        picture.
    """

    rotate: float = 0.0
    shear: tuple[float, float] = (0.0, 0.0)
    keystone: tuple[Vector, ...] = ()
    scale_to: Shape = ()
    fit: Frame = "crop"

    def __post_init__(self) -> None:
        given: object = self.shear
        shears = [given, 0.0] if isinstance(given, int | float) else items("shear", given, "one number or two", (1, 2))
        wanted = f"one number of degrees or two, from {-MOST_SHEAR:g} to {MOST_SHEAR:g}"
        x, y = (number("shear", s, wanted, -MOST_SHEAR, MOST_SHEAR) for s in [*shears, 0.0][:2])
        if math.tan(math.radians(x)) * math.tan(math.radians(y)) > 0.9:
            refuse("shear", "two angles that leave the picture upright", self.shear)
        what = "four points: top left, top right, bottom right, bottom left"
        corners = items("keystone", self.keystone, what, (0, 4))
        quad = tuple(point(f"keystone[{i}]", p, (2,)) for i, p in enumerate(corners))
        if quad and not _is_convex(np.array(quad)):
            refuse("keystone", f"{what} of a frame without notches", self.keystone)
        given_sizes = np.atleast_1d(np.asarray(self.scale_to, object)).tolist()  # a single number, too
        sizes = items("scale_to", given_sizes, "a width, or a width and a height", (0, 1, 2))
        most = f"a number of pixels from 1 to {_LONGEST}"
        choice("fit", self.fit, FRAMES)
        assign(
            self,
            rotate=number("rotate", self.rotate, "a number of degrees from -360 to 360", -360.0, 360.0),
            shear=(x, y),
            keystone=quad,
            scale_to=tuple(integer("scale_to", n, most, 1, _LONGEST) for n in sizes),
        )

    @property
    def has_gaps(self) -> bool:
        """True if the result may have empty parts."""
        return self.fit != "crop"

    def mapped(self, place: Callable[[Vector], Vector]) -> Self:
        """Return the straightening for a picture whose points are mapped by a function."""
        return replace(self, keystone=tuple(map(place, self.keystone)))

    def on(self, sizes: Shape) -> tuple[Affine | Projective, tuple[int, int]]:
        """Return the map from pixels of the result to those of the picture (pull), and the result's width and height.

        ``sizes`` are the width and height of the picture. SuppleError if the keystone is too steep for it.
        """
        whole = np.array(sizes, np.float64)
        push = self._push((whole - 1) / 2)
        corners = _CORNERS * whole - 0.5
        self._check_depth(push, whole)
        seen = _through(push, corners)
        turned = self.fit != "keep" and abs(math.sin(math.radians(self.rotate))) > math.sqrt(0.5) + 1e-12
        natural = whole[::-1] if turned else whole
        wanted = np.array(self.scale_to, np.float64)
        shape = wanted if len(wanted) == 2 else natural
        if self.fit == "crop":
            middle, scale = _largest(seen, shape)
            extent = scale * shape
        else:
            low, high = (-0.5, whole - 0.5) if self.fit == "keep" else (seen.min(axis=0), seen.max(axis=0))
            middle, extent = (low + high) / 2, high - low
            if len(wanted) == 2:
                extent = shape * (extent / shape).max()
        crops, step = self.fit == "crop", 1.0
        if len(wanted):
            sides = np.floor(wanted[0] * extent / extent[0] + (0.5 + _ROUNDING))  # halves upwards
            size = wanted if len(wanted) == 2 else np.maximum(sides, 1.0)
            step = float((extent / size).min() if crops else (extent / size).max())
        else:
            size = np.maximum(np.floor(extent + _ROUNDING) if crops else np.ceil(extent - _ROUNDING), 1.0)
        if size.max() > min(_LONGEST, math.inf if len(wanted) else _STEEPEST * whole.max()):
            self._refuse_steep()
        first = middle - step * (size - 1) / 2
        near = np.rint(first * 2) / 2
        first = np.where(np.abs(first - near) < _ROUNDING, near, first)
        pull = np.linalg.inv(push) @ np.array([[step, 0.0, first[0]], [0.0, step, first[1]], [0.0, 0.0, 1.0]])
        if not self.keystone:
            exact = np.rint(pull * 2) / 2  # for quarter turns
            pull = np.where(np.abs(pull - exact) < 1e-11, exact, pull)
            pull[2] = (0.0, 0.0, 1.0)
        self._check_depth(pull, size)
        made = Projective(pull) if self.keystone else Affine(pull)
        return made, (int(size[0]), int(size[1]))

    @property
    def linear(self) -> Floats:
        """The matrix (2, 2) of the rotation and the shear, for displacements."""
        quarters, angle = self.rotate / 90, math.radians(self.rotate)
        k = int(quarters) % 4
        exact = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[k]
        c, s = exact if quarters.is_integer() else (math.cos(angle), math.sin(angle))
        x, y = (math.tan(math.radians(a)) for a in self.shear)
        return np.asarray(np.array([[1.0, x], [y, 1.0]]) @ np.array([[c, -s], [s, c]]))

    def seen(self, sizes: Shape) -> tuple[Floats, Floats]:
        """Return the linear part (2, 2) and the perspective part (2,) of the map about the middle of a picture.

        A displacement d from the middle is mapped to linear · d / (1 + perspective · d).
        """
        middle = (np.array(sizes) - 1) / 2
        matrix = self._push(middle)
        x, y, w = matrix @ (*middle, 1.0)
        return (matrix[:2, :2] - np.outer((x / w, y / w), matrix[2, :2])) / w, matrix[2, :2] / w

    def levelled(self, one: Sequence[float], other: Sequence[float]) -> Self:
        """Return the straightening with the rotation that makes a line between two points horizontal or vertical."""
        flat = replace(self, rotate=0.0, shear=(0.0, 0.0))
        dx, dy = np.diff(_through(flat._push(np.zeros(2)), np.array([one, other])), axis=0)[0].tolist()
        return replace(self, rotate=round(-math.remainder(math.degrees(math.atan2(dy, dx)), 90.0), 3) + 0.0)

    def _push(self, centre: Floats) -> Floats:
        """Return the homogeneous matrix from pixels of a picture to the straightened plane."""
        made = np.eye(3)
        made[:2, :2] = self.linear
        made[:2, 2] = centre - made[:2, :2] @ centre
        return made @ _rectified(np.array(self.keystone)) if self.keystone else made

    def _check_depth(self, matrix: Floats, size: Floats) -> None:
        depth = np.column_stack([_CORNERS * size - 0.5, np.ones(4)]) @ matrix[2]
        if not depth.min() * _STEEPEST > np.append((size - 1) / 2, 1.0) @ matrix[2]:
            self._refuse_steep()

    def _refuse_steep(self) -> None:
        frame = ", ".join(f"({x:.5g}, {y:.5g})" for x, y in self.keystone)
        refuse("keystone", "a frame of less perspective: its horizon is in the picture or near it", told=frame)


def _is_convex(quad: Floats) -> bool:
    """Return whether four points, in this order, are a convex quadrilateral, clockwise on a screen."""
    sides = np.roll(quad, -1, axis=0) - quad
    after = np.roll(sides, -1, axis=0)
    cross = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    lengths = np.hypot(*sides.T)
    return bool((lengths > 1.0).all() and (cross > 1e-3 * lengths * np.roll(lengths, -1)).all())


def _rectified(quad: Floats) -> Floats:
    """Return the homography from four corners to those of an upright rectangle about their middle (Heckbert 1989)."""
    lengths = np.hypot(*(np.roll(quad, -1, axis=0) - quad).T)
    size = np.array([lengths[0] + lengths[2], lengths[1] + lengths[3]]) / 2
    goal = quad.mean(axis=0) + (_CORNERS - 0.5) * size
    rows = []
    for (x, y), (u, v) in zip(quad.tolist(), goal.tolist(), strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    made = np.append(np.linalg.solve(np.array(rows, np.float64), goal.ravel()), 1.0).reshape(3, 3)
    return np.asarray(made * np.sign(np.append(quad.mean(axis=0), 1.0) @ made[2]))


def _through(matrix: Floats, points: Floats) -> Floats:
    """Return points (N, 2) mapped by a homography."""
    found = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(found[:, :2] / found[:, 2:])


def _largest(corners: Floats, shape: Floats) -> tuple[Floats, float]:
    """Return the middle and the scale of the largest upright rectangle of given proportions in a convex quadrilateral.

    For each side n·x + d ≥ 0, the middle m and the scale s satisfy n·m + d ≥ s (|n_x| w + |n_y| h) / 2: a linear
    program in three unknowns, solved at its vertices, each given by three sides. Of several solutions, their mean.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([-sides[:, 1], sides[:, 0]])
    normals /= np.hypot(*normals.T)[:, None]
    normals *= np.sign(((corners.mean(axis=0) - corners) * normals).sum(axis=1))[:, None]
    rows = np.column_stack([normals, -np.abs(normals) @ shape / 2])
    shift = -(normals * corners).sum(axis=1)
    found = []
    for chosen in combinations(range(len(rows)), 3):
        some = rows[list(chosen)]
        if abs(np.linalg.det(some)) > 1e-12 * np.abs(some).max():
            x = np.linalg.solve(some, -shift[list(chosen)])
            if (rows @ x + shift >= -1e-9 * np.abs(corners).max()).all():
                found.append(x)
    if not found:
        raise SuppleError("the straightened picture has no part that a frame fits in")
    best = max(x[2] for x in found)
    mean = np.mean([x for x in found if x[2] > best * (1 - 1e-9)], axis=0)
    return mean[:2], float(best)
