"""What the pictures show, as numbers: at every pixel of the output, or at every so many-th of a large one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple.cpu import paper
from supple.cpu.warp import Band, absolute, each_band, solve_plane
from supple.deformation import Deformation
from supple.domain import number
from supple.errors import SuppleError

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MOST_PIXELS = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Iterations:
    """How much work the inverse of every pixel takes, by the published method and by ours.

    Parameters
    ----------
    every : int
        Arrays have one entry for so many rows and columns of the output.
    published : int64 array
        Iterations of the published method.
    unconverged : int
        Pixels for which that has not come within 0.1 px.
    published_error : float64 array
        The distance of its source points to ours, in pixels.
    ours : int64 array
        Evaluations of T and its Jacobian by `Deformation.inverse`.
    residual : float64 array
        What that leaves: |T(p) - q|, in pixels.
    """

    every: int
    published: Integers
    unconverged: int
    published_error: Floats
    ours: Integers
    residual: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """How exact the inverse map is that pictures are sampled with.

    Parameters
    ----------
    every : int
        Arrays have one entry for so many rows and columns of the output.
    residual : float64 array
        |T(p) - q|, in pixels of the output.
    distance : float64 array
        |p - T⁻¹(q)|, in pixels of the input; T⁻¹(q) by Newton's method at each pixel.
    bound, tolerance : float
        The certified distance of the worst of all pixels (`Report.error`), and what was asked for.
    unconverged : int
        Of how many pixels that is not known.
    """

    every: int
    residual: Floats
    distance: Floats
    bound: float
    tolerance: float
    unconverged: int


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """What the output's pixels cover of the input: ellipses, the images of unit circles under M = (I+J)⁻¹.

    Parameters
    ----------
    every : int
        Arrays have one entry for so many rows and columns of the output.
    major, minor : float64 array
        M's singular values: the ellipse's half axes, in pixels of the input. Above 1, the picture shrinks.
    direction : float64 array, shape (..., 2)
        The unit vector, x first, along which the *output* shrinks most.
    """

    every: int
    major: Floats
    minor: Floats
    direction: Floats


def require_image(deformation: Deformation) -> None:
    """Raise SuppleError unless the deformation is one of images."""
    if deformation.ndim != 2:
        raise SuppleError(
            "plots show deformations of images in this release, "
            f"and shape {deformation.shape} has three axes: plot one of its planes"
        )


def spacing_of(shape: tuple[int, ...], most: int = MOST_PIXELS) -> int:
    """The smallest step with which rows and columns have no more than so many crossings."""
    step = max(1, math.isqrt(max(0, math.prod(shape) // most - 1)))
    while math.prod(-(-n // step) for n in shape) > most:
        step += 1
    return step


def _pixels(deformation: Deformation) -> tuple[int, Floats]:
    require_image(deformation)
    every = spacing_of(deformation.shape)
    height, width = deformation.shape
    return every, np.stack(np.meshgrid(np.arange(0.0, width, every), np.arange(0.0, height, every)), axis=-1)


def iterations(deformation: Deformation) -> Iterations:
    """The work of the published method, and ours."""
    every, q = _pixels(deformation)
    height, width = deformation.shape
    points, counts, residuals = paper.inverse_map(deformation._table, deformation._axes, (height, width), every=every)
    exact = deformation.inverse(q)
    return Iterations(
        every=every,
        published=counts,
        unconverged=int(np.count_nonzero(residuals >= 0.1)),
        published_error=np.asarray(np.linalg.norm(points - exact.points, axis=-1)),
        ours=exact.steps,
        residual=exact.residual,
    )


def residual(deformation: Deformation, *, tolerance: float = 0.01) -> Errors:
    """The errors of the lattice map at a tolerance, in pixels, and what it certifies."""
    every, q = _pixels(deformation)
    tolerance = number("tolerance", tolerance, "a number of pixels above 0", 1e-9, 1e9)
    height, width = deformation.shape
    points = np.empty_like(q)

    def keep(band: Band) -> None:
        rows = np.empty((*band.points.shape[1:], 2))
        absolute(band, rows)
        first = -band.top % every
        taken = rows[first::every, ::every]
        start = (band.top + first) // every
        points[start : start + len(taken)] = taken

    plane = solve_plane(deformation._table, deformation._axes, (height, width), 2)
    each_band(plane, tolerance, keep)
    report = deformation.report(tolerance=tolerance)
    return Errors(
        every=every,
        residual=np.asarray(np.linalg.norm(deformation.forward(points) - q, axis=-1)),
        distance=np.asarray(np.linalg.norm(points - deformation.inverse(q).points, axis=-1)),
        bound=report.error,
        tolerance=tolerance,
        unconverged=report.unconverged,
    )


def stretch(deformation: Deformation) -> tuple[Floats, Floats]:
    """How much the picture is stretched at each pixel of the output, vertically and horizontally.

    Returns
    -------
    vertical, horizontal : float64 array
        ∂T_y/∂y and ∂T_x/∂x at the source point: above 1 it expands, below 1 it contracts.
    """
    _, q = _pixels(deformation)
    matrices = deformation.jacobian(deformation.inverse(q).points)
    return matrices[..., 1, 1], matrices[..., 0, 0]


def footprints(deformation: Deformation) -> Footprints:
    """What each pixel of the output covers of the input."""
    every, q = _pixels(deformation)
    matrices = deformation.jacobian(deformation.inverse(q).points)
    a, b, c, d = (matrices[..., i, j] for i in range(2) for j in range(2))
    # A 2×2 matrix is a rotation by one angle times some factor, plus a reflection times another: its singular
    # values are their sum and difference. M's are one over those, and swap their roles.
    rotated, reflected = np.hypot(a + d, c - b) / 2, np.hypot(a - d, c + b) / 2
    angle = (np.arctan2(c - b, a + d) + np.arctan2(c + b, a - d)) / 2 + np.pi / 2
    return Footprints(
        every=every,
        major=1 / (rotated - reflected),
        minor=1 / (rotated + reflected),
        direction=np.stack([np.cos(angle), np.sin(angle)], axis=-1),
    )


def grid(deformation: Deformation, *, lines: int = 24) -> list[Floats]:
    """Straight lines of the input as the output shows them.

    Parameters
    ----------
    deformation : Deformation
    lines : int
        How many cells there are between them along the longer side; they are square in physical units.

    Returns
    -------
    list of float64 arrays, shape (N, 2)
        Points along each line, in pixels, x first.
    """
    require_image(deformation)
    size = np.array([n - 1.0 for n in reversed(deformation.shape)])
    physical = size * deformation.domain.spacing
    cells = np.maximum(1, np.rint(lines * physical / max(physical.max(), 1e-300))).astype(int)
    found = []
    for axis in range(2):
        along = np.linspace(0, size[1 - axis], 1 + int(min(max(64, size[1 - axis]), 1024)))
        for place in np.linspace(0, size[axis], cells[axis] + 1):
            line = np.empty((along.size, 2))
            line[:, axis], line[:, 1 - axis] = place, along
            found.append(deformation.forward(line))
    return found
