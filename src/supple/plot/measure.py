"""The data of the plots: at every pixel of the output, or on a coarser grid if it is large.

For a video, it is for one frame of the output.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.deformation import Deformation
from supple.engine import paper
from supple.engine.core import certificate_of, measured, plan_of
from supple.engine.sampling import Certificate
from supple.errors import SuppleError, argument
from supple.space.checks import integer, number
from supple.space.geometry import Floats

Integers = npt.NDArray[np.int64]

MOST_PIXELS = 1 << 20


class Iterations(NamedTuple):
    """The work to invert the map at every pixel, by the published method and by ours; errors are in pixels."""

    every: int  # rows and columns of the output between entries of the arrays
    published: Integers  # iterations of the published method
    unconverged: int  # pixels whose residual, by the published method, is 0.1 px or more
    published_error: Floats  # the distance of its source points to ours
    ours: Integers  # evaluations of T and its Jacobian by `Deformation.inverse`
    residual: Floats  # |T(p) - q| of these points
    lattice: float  # evaluations for each pixel if the map is interpolated on a lattice


class Errors(NamedTuple):
    """The accuracy of the inverse map that images are sampled with, in pixels; of a video, in pixels and frames."""

    every: int  # rows and columns of the output between entries of the arrays
    residual: Floats  # |T(p) - q|
    distance: Floats  # |p - T⁻¹(q)|; T⁻¹(q) by Newton's method at each pixel
    bound: float  # the certified largest distance of all pixels (of an image, `Report.error`)
    tolerance: float
    unconverged: int  # pixels whose distance is not known


class Footprints(NamedTuple):
    """The footprints of the output's pixels in the input: ellipses, the images of unit circles under M = (I+J)⁻¹.

    For a video, the footprint within the frame: M without its row and column of time.
    """

    every: int  # rows and columns of the output between entries of the arrays
    major: Floats  # M's singular values: the ellipse's half axes, in pixels of the input
    minor: Floats  # above 1, the image contracts
    direction: Floats  # (..., 2): the unit vector, x first, of the largest contraction in the *output*


def require_plane(deformation: Deformation, frame: int | None) -> int:
    """Return the index of the plane to measure; SuppleError if it does not exist."""
    if deformation.ndim == 2:
        if frame is not None:
            text = f"{argument('frame')} is for videos, and shape {deformation.shape} is that of an image: leave it out"
            raise SuppleError(text)
        return 0
    if frame is None:
        raise SuppleError(
            f"a plot shows one plane, and shape {deformation.shape} has three axes: say which by {argument('frame', 0)}"
        )
    last = deformation.shape[0] - 1
    return integer("frame", frame, f"a frame from 0 to {last}", 0, last)


def spacing_of(shape: tuple[int, ...], most: int = MOST_PIXELS) -> int:
    """Return the smallest step of a grid with at most ``most`` points."""
    step = max(1, math.isqrt(max(0, math.prod(shape) // most - 1)))
    while math.prod(-(-n // step) for n in shape) > most:
        step += 1
    return step


def _pixels(deformation: Deformation, frame: int | None) -> tuple[int, Floats]:
    z = require_plane(deformation, frame)
    height, width = deformation.shape[-2:]
    every = spacing_of((height, width))
    axes = [np.arange(0.0, width, every), np.arange(0.0, height, every), np.array([float(z)])][: deformation.ndim]
    q = np.stack(np.meshgrid(*axes), axis=-1)
    return every, q.reshape(*q.shape[:2], deformation.ndim)


def _plan(deformation: Deformation, frame: int | None, tolerance: float) -> _core.Plan:
    if deformation.straightened is not None:
        raise SuppleError("this plot is of strokes and maps, on the picture as it is: leave straightening out")
    return plan_of(deformation.space, require_plane(deformation, frame), tolerance)


def iterations(deformation: Deformation, frame: int | None = None) -> Iterations:
    """Return the work of the published method, and of ours; SuppleError for maps other than strokes."""
    if deformation.maps:
        raise SuppleError(
            "the published method inverts strokes alone, found fields or affine maps: plot the residual instead"
        )
    every, q = _pixels(deformation, frame)
    height, width = deformation.shape[-2:]
    z = None if frame is None else float(frame)
    space = deformation.space
    points, counts, residuals = paper.inverse_map(space.table, space.axes, (height, width), z=z, every=every)
    exact = deformation.inverse(q)
    used = 0.0
    if not deformation.is_identity:
        used = certificate_of(_plan(deformation, frame, 0.01), space).evaluations
    apart = np.asarray(np.linalg.norm(points - exact.points, axis=-1))
    missed = int(np.count_nonzero(residuals >= 0.1))
    return Iterations(every, counts, missed, apart, exact.steps, exact.residual, used / (height * width))


def residual(deformation: Deformation, frame: int | None = None, *, tolerance: float = 0.01) -> Errors:
    """Return the errors of the lattice map at a tolerance, in pixels, and its certified bound."""
    every, q = _pixels(deformation, frame)
    tolerance = number("tolerance", tolerance, "a number of pixels from 1e-9 to 1e9", 1e-9, 1e9)
    plan = _plan(deformation, frame, tolerance)
    whole = np.empty((*deformation.shape[-2:], deformation.ndim))
    plan.points(whole)
    points = whole[::every, ::every]
    certificate = Certificate(0.0, 0.0) if deformation.is_identity else measured(plan, tolerance)
    residuals = np.asarray(np.linalg.norm(deformation.forward(points) - q, axis=-1))
    distances = np.asarray(np.linalg.norm(points - deformation.inverse(q).points, axis=-1))
    return Errors(every, residuals, distances, certificate.error, tolerance, certificate.unknown)


def sources(deformation: Deformation, frame: int | None = None) -> tuple[int, Floats]:
    """Return the step of the grid, and the source point of each of its pixels, in pixels and frames, x first."""
    every, q = _pixels(deformation, frame)
    return every, deformation.inverse(q).points


def stretch(deformation: Deformation, frame: int | None = None) -> tuple[Floats, ...]:
    """Return the stretch at each pixel of the output: vertically, horizontally, and for a video in time.

    Returns
    -------
    vertical, horizontal[, in time] : float64 array
        ∂T_y/∂y, ∂T_x/∂x and ∂T_t/∂t at the source point: above 1 it expands, below 1 it contracts.
    """
    _, points = sources(deformation, frame)
    matrices = deformation.jacobian(points)
    return tuple(matrices[..., i, i] for i in (1, 0, 2)[: deformation.ndim])


def footprints(deformation: Deformation, frame: int | None = None) -> Footprints:
    """Return the footprint of each pixel of the output in the input."""
    every, points = sources(deformation, frame)
    inverted = np.linalg.inv(deformation.jacobian(points))
    a, b, c, d = (inverted[..., i, j] for i in range(2) for j in range(2))
    # A 2×2 matrix is a rotation by one angle times some factor, plus a reflection times another: its singular
    # values are their sum and difference.
    rotated, reflected = np.hypot(a + d, c - b) / 2, np.hypot(a - d, c + b) / 2
    angle = (np.arctan2(c + b, a - d) - np.arctan2(c - b, a + d)) / 2
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return Footprints(every, rotated + reflected, np.abs(rotated - reflected), direction)


def ticks(deformation: Deformation, lines: int) -> list[Floats]:
    """Return the positions of grid lines on the axes x and y, in pixels, from edge to edge of the image.

    Its cells are square in physical units.
    """
    size = np.array(deformation.shape[-2:][::-1], float)
    physical = size * deformation.domain.spacing[:2]
    cells = np.maximum(1, np.rint(lines * physical / max(physical.max(), 1e-300))).astype(int)
    return [np.linspace(-0.5, size[axis] - 0.5, cells[axis] + 1) for axis in range(2)]


def grid(deformation: Deformation, *, lines: int = 24) -> list[Floats]:
    """Return straight lines of an image as warped in the output.

    Parameters
    ----------
    deformation : Deformation
        A deformation of images.
    lines : int
        The number of cells along the longer side.

    Returns
    -------
    list of float64 arrays, shape (N, 2)
        Points along each line, in pixels, x first.
    """
    require_plane(deformation, None)
    size = deformation.shape[::-1]
    found = []
    for axis, places in enumerate(ticks(deformation, lines)):
        along = np.linspace(-0.5, size[1 - axis] - 0.5, 1 + int(min(max(64, size[1 - axis]), 1024)))
        for place in places:
            line = np.empty((along.size, 2))
            line[:, axis], line[:, 1 - axis] = place, along
            found.append(deformation.forward(line))
    return found
