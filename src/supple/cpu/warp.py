"""Planes in parallel: bands of a lattice, and what is done with the source points of each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from supple.cpu.band import EVALUATIONS, FAR, RATE, REACH, RUN, STATS, WORST, source_points
from supple.cpu.beyond import rows_beyond
from supple.cpu.certify import farthest
from supple.cpu.kernel import share, threads
from supple.cpu.lattice import NODE, SIZE, M, set_twists, solve_rows

CELL_ROWS = 3  # of a band, at most: few enough for all cores to have some, and enough to be worth starting

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Plane:
    """The lattice of one plane: the inverse map in a form that is quick to fill in."""

    table: npt.NDArray[np.void]
    axes: Floats
    z: float
    shape: tuple[int, int]
    ndim: int
    xs: npt.NDArray[np.int64]
    ys: npt.NDArray[np.int64]
    nodes: Floats
    evaluations: float


@dataclass(frozen=True, slots=True)
class Grid:
    """Samples that are not a plane's pixels, such as chroma.

    ``step`` is how many pixels there are from one to the next, and ``offset`` where the first one lies, x first; there
    are ``shape`` of them, rows first.
    """

    step: tuple[int, int]
    offset: tuple[float, float]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Band:
    """The source points of some rows of a plane.

    ``points[c, y, x] + anchors[run, c]``, for c up to 2, is coordinate ``c``, in pixels, of the source of the pixel
    (x, top + y), where ``run`` counts the stretches of pixels between ``edges``. ``boxes``
    bounds the points of every lattice cell. ``coarse`` is the same part of the plane in the samples of another grid,
    and in their numbers. ``find`` finds the rows beside it.
    """

    top: int
    points: npt.NDArray[np.float32]
    anchors: npt.NDArray[np.int64]
    boxes: Floats
    edges: npt.NDArray[np.int64]
    find: Callable[[Band], npt.NDArray[np.float32]]
    coarse: Band | None = None

    def beyond(self, needed: bool) -> npt.NDArray[np.float32]:
        """The points of the rows above and below, shape (2, ndim, columns); where they are not needed, of no column."""
        return self.find(self) if needed else np.empty((2, len(self.points), 0), np.float32)


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is known of the map that was used."""

    error: float
    evaluations: float
    unknown: int = 0

    def __or__(self, other: Certificate) -> Certificate:
        return Certificate(
            max(self.error, other.error),
            self.evaluations + other.evaluations,
            self.unknown + other.unknown,
        )


def positions(n: int, axis: Floats, size: int = SIZE) -> npt.NDArray[np.int64]:
    """Where the lattice has its nodes along an axis of ``n`` samples, no more than ``size`` apart."""
    if n == 1:  # one sample alone still gets a cell, which reaches beyond the plane
        return np.array([0, 1], np.int64)
    # The border's influence has a kink where it ends. Few cells lie across it if they end there too.
    extent, sigma, spacing = axis[:3]
    kinks = [round(k / spacing) for k in (sigma, extent - sigma)] if sigma > 0 else []
    ends = sorted({0, *(k for k in kinks if 0 < k < n - 1), n - 1})
    return np.concatenate([*(np.arange(a, b, size) for a, b in itertools.pairwise(ends)), [n - 1]]).astype(np.int64)


def solve_plane(table: npt.NDArray[np.void], axes: Floats, shape: tuple[int, int], ndim: int, z: float = 0.0) -> Plane:
    """Solve for T⁻¹ on the lattice of a plane.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Strokes that are known to be one-to-one.
    axes : float64 array, shape (3, 4)
        The packed domain.
    shape : (int, int)
        Rows and columns of the plane.
    ndim : int
        2 for an image, 3 for a plane of a video or a volume.
    z : float
        Which plane, in samples.
    """
    xs, ys = positions(shape[1], axes[0]), positions(shape[0], axes[1])
    nodes = np.empty((ys.size, xs.size, NODE))
    # No part is so long that an interrupt would wait for it.
    several, count = threads(), xs.size * ys.size
    parts = max(1, min(several, count // 256)) * max(1, count // (several * 32768))
    edges = [ys.size * k // parts for k in range(parts + 1)]

    def solve(k: int) -> float:
        return float(solve_rows(table, axes, z, xs, ys, edges[k], edges[k + 1], nodes))

    evaluations = sum(share(solve, range(parts), brief=True))
    set_twists(xs, ys, xs.size, ys.size, 0, ys.size, ndim, nodes)
    return Plane(table, axes, z, shape, ndim, xs, ys, nodes, evaluations)


def folds(plane: Plane) -> int:
    """At how many nodes of a plane's lattice the map turns space over."""
    matrices = plane.nodes[..., M : M + 9].reshape(-1, 3, 3)
    return int(np.count_nonzero(np.linalg.det(matrices) <= 0))


def rounding(reach: float) -> float:
    """How far off float32, and the few operations that make them, may put points up to ``reach`` from their anchor."""
    return 2.0**-22 * reach


def finder(
    plane: Plane, tolerance: float, steps: Sequence[float], count: int
) -> Callable[[Band], npt.NDArray[np.float32]]:
    """What finds the rows beside a band of a grid of ``count`` rows, whose ``steps`` are those of `Grid`."""

    def find(band: Band) -> npt.NDArray[np.float32]:
        beyond = np.empty((2, plane.ndim, band.points.shape[2]), np.float32)
        rows_beyond(
            plane.table,
            plane.axes,
            plane.z,
            np.array(steps, np.float64),
            band.top,
            count,
            band.points,
            band.anchors,
            band.edges,
            min(0.1 * tolerance, 1e-3),
            beyond,
        )
        return beyond

    return find


def each_band(
    plane: Plane,
    tolerance: float,
    use: Callable[[Band], None],
    grid: Grid | None = None,
    rates: bool = False,
    whole: bool = False,
) -> Certificate:
    """Call ``use`` for every band of a plane, on all cores.

    Parameters
    ----------
    plane : Plane
    tolerance : float
        How far a source point may be from the true T⁻¹(q), in pixels.
    use : function of a Band
    grid : Grid, optional
        Whose source points to find as well.
    rates : bool
        Whether to find ∂p_t/∂t too, as a fourth coordinate.
    whole : bool
        Whether the plane is one band, as where planes are worked on side by side.

    Returns
    -------
    Certificate
        Its error is what the checks of all cells say, with their reserve; `measure` looks at every pixel instead. It
        exceeds the tolerance only where that is finer than what Newton's method and float32 can reach, or where a
        node did not converge.
    """
    xs, ys = plane.xs, plane.ys
    height, width = plane.shape
    runs = -(-(xs.size - 1) // RUN)
    slack = rounding(min(max(height, width), 2 * RUN * SIZE))
    steps = np.array([*(grid.step + grid.offset if grid else (1.0, 1.0, 0.0, 0.0)), xs[-1], ys[-1]], np.float64)
    columns = grid.shape[1] if grid else 0
    edges = np.append(xs[:-1:RUN], width)
    coarse_edges = np.append(np.ceil((edges[:-1] - steps[2]) / steps[0]).astype(np.int64), columns)

    # An even number of bands, so that two cores, or more, end together; and the same ones on any machine.
    rows = ys.size - 1
    bands = 1 if whole else min(-(-rows // (2 * CELL_ROWS)) * 2, rows)

    find = finder(plane, tolerance, (1, 1, 0, 0), height)
    find_coarse = finder(plane, tolerance, (*grid.step, *grid.offset), grid.shape[0]) if grid else find

    def work(k: int) -> Certificate:
        first, last = rows * k // bands, rows * (k + 1) // bands
        top, end = int(ys[first]), int(ys[last]) if last < ys.size - 1 else height
        points = np.empty((plane.ndim + rates, end - top, width), np.float32)
        anchors = np.empty((runs, 3), np.int64)
        boxes = np.empty((last - first, xs.size - 1, plane.ndim, 2))
        above = below = 0
        if grid:
            above, below = (math.ceil((y - grid.offset[1]) / grid.step[1]) for y in (top, end))
            below = grid.shape[0] if last == rows else below
        coarse = np.empty((plane.ndim + rates, below - above, columns), np.float32)
        coarse_anchors = np.empty((runs, 3), np.int64)
        coarse_boxes = np.empty((last - first, xs.size - 1 if grid else 0, plane.ndim, 2))
        stats = np.zeros(STATS)
        source_points(
            plane.table,
            plane.axes,
            plane.z,
            xs,
            ys,
            width,
            height,
            first,
            last,
            max(tolerance - slack, 0.0),
            plane.nodes,
            points,
            anchors,
            boxes,
            steps,
            coarse,
            coarse_anchors,
            coarse_boxes,
            stats,
        )
        second = None
        if grid:
            second = Band(above, coarse, coarse_anchors, coarse_boxes, coarse_edges, find_coarse)
        use(Band(top, points, anchors, boxes, edges, find, second))
        return Certificate(float(stats[WORST]) + rounding(float(stats[REACH])), float(stats[EVALUATIONS]))

    total = Certificate(0.0, plane.evaluations)
    for certificate in share(work, range(bands), brief=True):
        total |= certificate
    return total


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where the source points of a plane lie: the first and the last time, and how far any coordinate moves.

    ``rate`` is the largest component of ∂p_t/∂q at a node.
    """

    early: float
    late: float
    moved: float
    rate: float


def bounds_of(plane: Plane, tolerance: float) -> Bounds:
    """Bound the source points that `each_band` finds, without finding them."""
    xs, ys = plane.xs, plane.ys
    cells, rows = xs.size - 1, ys.size - 1
    boxes = np.empty((rows, cells, 3, 2))
    anchors = np.empty((-(-cells // RUN), 3), np.int64)
    stats = np.zeros(STATS)
    slack = rounding(min(max(plane.shape), 2 * RUN * SIZE))
    source_points(
        plane.table,
        plane.axes,
        plane.z,
        xs,
        ys,
        plane.shape[1],
        plane.shape[0],
        0,
        rows,
        max(tolerance - slack, 0.0),
        plane.nodes,
        np.empty((3, 0, 0), np.float32),
        anchors,
        boxes,
        np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
        np.empty((3, 0, 0), np.float32),
        anchors.copy(),
        np.empty((rows, 0, 3, 2)),
        stats,
    )
    return Bounds(float(boxes[..., 2, 0].min()), float(boxes[..., 2, 1].max()), float(stats[FAR]), float(stats[RATE]))


def measure(plane: Plane, tolerance: float) -> Certificate:
    """The error of a plane's source points at a tolerance: not estimated cell by cell, but measured at every pixel."""
    found: list[tuple[float, int]] = []

    def look(band: Band) -> None:
        finest = min(1e-5, 1e-3 * tolerance)
        found.append(
            farthest(plane.table, plane.axes, plane.z, band.top, band.points, band.anchors, band.edges, finest)
        )

    estimated = each_band(plane, tolerance, look)
    worst = max(error for error, _ in found)
    return replace(estimated, error=worst, unknown=sum(unknown for _, unknown in found))


def absolute(band: Band, out: npt.NDArray[np.floating]) -> None:
    """Write a band's source points, coordinates last and in pixels, into ``out`` (rows, columns, 2 or 3)."""
    for left, right, anchor in zip(band.edges, band.edges[1:], band.anchors, strict=False):
        for c in range(band.points.shape[0]):
            np.add(band.points[c, :, left:right], anchor[c], out=out[:, left:right, c], casting="same_kind")
