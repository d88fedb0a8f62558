"""What a pixel covers, and what samples weigh in its average: against integrals and polynomials."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest
import reference

from supple import Deformation
from supple.cpu.beyond import rows_beyond
from supple.cpu.footprint import (
    ANTIALIAS,
    AUTO,
    ENTRY,
    EWA,
    MAJOR,
    MINOR,
    PADDED,
    PARTS,
    PLACES,
    STEPS,
    TAPS,
    WIDEST,
    XX,
    XY,
    YY,
    extremes,
    footprints,
    slopes,
    weights,
)
from supple.cpu.sampling import sampler
from supple.cpu.warp import Band, Plane, each_band, solve_plane

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]


def interpolated(place: float, squared: float) -> Floats:
    """What the samples -2 to 3 weigh, as kernels read it from the table."""
    table = weights(np.dtype(np.float64))
    i, j = round(place * PLACES), round(squared * STEPS)
    at = (j * (PLACES + 1) + i) * ENTRY
    entry = table[at : at + ENTRY].reshape(3, PADDED)
    return np.asarray(entry[0] + (place * PLACES - i) * entry[1] + (squared * STEPS - j) * entry[2])


def test_weights_are_integrals_of_the_kernel() -> None:
    rng = np.random.default_rng(0)
    places, squares = rng.uniform(0, 1, 2000), rng.uniform(0, WIDEST**2, 2000)
    squares[:200] = rng.uniform(0, 0.05, 200)
    for place, squared in zip(places, squares, strict=True):
        made = interpolated(place, squared)
        t = np.arange(TAPS) - 2 - place
        wanted = reference.averaged("cubic", t, np.full(TAPS, np.sqrt(squared)))
        np.testing.assert_allclose(made[:TAPS], wanted, rtol=0, atol=2.5e-4)
        assert made.sum() == pytest.approx(1, abs=1e-11)
        assert not made[TAPS:].any()
        if squared <= 1:  # five samples; so many are read
            assert made[5 if place * PLACES < PLACES // 2 + 0.5 else 0] == 0


ALONE = np.zeros((1, 3), np.int64)  # anchors of one run


@pytest.mark.parametrize("edges", [(0, 6, 15, 16, 20), (0, 6, 18, 20), (0, 6, 19, 20), (0, 3, 17, 20)])
def test_slopes_are_central_differences_across_runs_and_bands(edges: tuple[int, ...]) -> None:
    # Of a cubic, whose own values beyond the picture's edges are known. It is bent little enough to count as a whole.
    def cubic(y: Floats, x: Floats) -> Floats:
        return 0.004 * x**3 - 0.08 * x**2 + x - 0.015 * y**3 + 0.1 * y * y + 0.02 * x * y + 0.003 * x * x * y

    y, x = np.mgrid[-1:8, :20].astype(float)
    anchors = np.array([[0, 5, 0], [7, -3, 1], [8, 9, 2], [-20, 0, 3]])
    points = np.stack([cubic(y, x), -cubic(y, x)])
    runs = range(len(edges) - 1)
    for run in runs:
        for c in range(2):
            points[c, :, edges[run] : edges[run + 1]] -= anchors[run, c]
    inner = np.ascontiguousarray(points[:, 1:-1], np.float32)
    beyond = np.ascontiguousarray(points[:, [0, -1]].transpose(1, 0, 2), np.float32)
    across, down = (cubic(y, x + 1) - cubic(y, x - 1)) / 2, (cubic(y + 1, x) - cubic(y - 1, x)) / 2
    for run in runs:
        left, right = edges[run], edges[run + 1]
        found = np.empty((2, right - left), np.float32)
        for k in range(7):
            for c, sign in ((0, 1), (1, -1)):
                slopes(inner, beyond, anchors, run, c, k, left, right - left, found[0], found[1])
                np.testing.assert_allclose(found[0], sign * across[k + 1, left:right], atol=4e-5)
                np.testing.assert_allclose(found[1], sign * down[k + 1, left:right], atol=4e-5)


def plane_of(d: Deformation) -> Plane:
    height, width = d.shape
    return solve_plane(d.space.table, d.space.axes, (height, width), 2)


@pytest.mark.parametrize("border", [None, 50])  # whose influence ends between two bands
@pytest.mark.parametrize("radius", [2.0, 5.0, 8.0, 40.0])
def test_rows_beside_a_band_are_those_of_the_band_there(radius: float, border: float | None) -> None:
    d = Deformation((230, 70), border=border, on_fold="damp")
    rng = np.random.default_rng(0)
    for y in (40, 50, 64, 96, 128, 160, 179):  # cells are 32 rows high, and bands end with some of them
        for _ in range(3):
            by = rng.normal(0, 0.6 * radius, 2)
            d = d.grab((rng.uniform(0, 70), y + rng.uniform(-6, 6)), by=(by[0], by[1]), radius=radius)
    bands: dict[int, Band] = {}

    def keep(band: Band) -> None:
        bands[band.top] = band

    each_band(plane_of(d), 1e-4, keep)
    tops = sorted(bands)
    assert len(tops) > 1
    for one, two in itertools.pairwise(tops):
        upper, lower = bands[one], bands[two]
        assert one + upper.points.shape[1] == two
        np.testing.assert_array_equal(upper.edges, lower.edges)
        for band, side, other, row in ((upper, 1, lower, 0), (lower, 0, upper, -1)):
            for run in range(len(band.anchors)):
                part = slice(band.edges[run], band.edges[run + 1])
                found = band.beyond(True)[side, :, part] + band.anchors[run, :2, None]
                wanted = other.points[:, row, part] + other.anchors[run, :2, None]
                np.testing.assert_allclose(found, wanted, rtol=0, atol=5e-3)


def whole_and_in_bands(d: Deformation, filter: str) -> tuple[npt.NDArray[np.float32], ...]:
    """Noise, itself; warped as one band; and in bands."""
    source = np.random.default_rng(3).random((*d.shape, 1)).astype(np.float32)
    out = np.empty((2, *source.shape), np.float32)
    for k in range(2):
        options = {"filter": filter, "outside": "edge", "fill": np.zeros(1)}
        use = sampler(source, out[k], alpha=False, light=False, white=None, **options)
        each_band(plane_of(d), 1e-4, use, whole=k == 0)
    return source, out[0], out[1]


@pytest.mark.parametrize("filter", ["auto", "antialias"])
@pytest.mark.parametrize("radius", [2.0, 5.0, 15.0])
def test_bands_leave_no_trace(radius: float, filter: str) -> None:
    d = Deformation((230, 560), border=None, on_fold="flow")
    for y in (64, 96, 128):
        for x in (90, 256, 400):
            d = d.grab((x, y - 0.4), by=(1.2 * radius, 0.7 * radius), radius=radius)
    source, whole, made = whole_and_in_bands(d, filter)
    assert np.abs(made - source).max() > 0.3
    apart = np.abs(made - whole)
    assert (apart > 1e-3).mean() < 1e-5  # where a footprint passes from one box to several
    assert apart.max() < 0.05


@pytest.mark.parametrize("filter", ["auto", "antialias"])
def test_a_single_row_at_an_edge_is_told_by_those_beside_its_band(filter: str) -> None:
    d = Deformation((34, 40), border=1).grab((20, 24), by=(2, -9), radius=20)
    sizes: list[tuple[int, int]] = []
    each_band(plane_of(d), 1e-4, lambda band: sizes.append((band.top, band.points.shape[1])))
    assert (0, 1) in sizes
    source, whole, made = whole_and_in_bands(d, filter)
    assert np.abs(made - source).max() > 0.3
    np.testing.assert_allclose(made, whole, rtol=0, atol=1e-3)


def test_a_band_without_a_row_asks_for_nothing() -> None:
    # As chroma of every fourth row has between the ends of the border's influence.
    def find(band: Band) -> npt.NDArray[np.float32]:
        raise AssertionError

    out = np.zeros((2, 5, 1), np.float32)
    band = Band(1, np.empty((2, 0, 5), np.float32), ALONE, np.zeros((0, 1, 2, 2)), np.array([0, 5]), find)
    for kind in ("auto", "antialias", "ewa"):
        options = {"filter": kind, "outside": "edge", "fill": np.zeros(1)}
        sampler(out + 1, out, alpha=False, light=False, white=None, **options)(band)
    assert not out.any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2), (3, 3), (2, 7), (4, 3)])
def test_slopes_of_few_pixels(shape: tuple[int, int]) -> None:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    points = np.stack([1.5 * x + 0.25 * y, 0.75 * y - 0.5 * x]).astype(np.float32)
    alone = [shape[1] == 1, shape[0] == 1]  # nothing is known of such a direction: it is as if nothing moved
    d = Deformation((8, 8)).space
    beyond, edges = np.empty((2, 2, shape[1]), np.float32), np.array([0, shape[1]])
    rows_beyond(d.table, d.axes, 0.0, np.array([1.0, 1, 0, 0]), 0, shape[0], points, ALONE, edges, 1e-3, beyond)
    found = np.empty((2, shape[1]), np.float32)
    for k in range(shape[0]):
        for c, wanted in ((0, (1.5, 0.25)), (1, (-0.5, 0.75))):
            slopes(points, beyond, ALONE, 0, c, k, 0, shape[1], found[0], found[1])
            for axis in range(2):
                np.testing.assert_allclose(found[axis], (1.0 if c == axis else 0.0) if alone[axis] else wanted[axis])


@pytest.mark.parametrize("mode", [AUTO, ANTIALIAS, EWA])
def test_footprints_are_those_of_the_jacobian(mode: int) -> None:
    rng = np.random.default_rng(mode)
    for _ in range(50):
        m = rng.normal(0, 1.2, (2, 2))
        y, x = np.mgrid[:5, :6].astype(float)
        points = np.einsum("ij,jyx->iyx", m, np.stack([x, y])).astype(np.float32)
        parts = np.empty(PARTS, np.float32)
        footprints(points, points[:, :2].copy(), ALONE, 0, 2, 0, 6, mode, parts)
        u, s, _ = np.linalg.svd(m)
        if mode == EWA:
            s = np.maximum(s, 1)
        else:
            low, high = (1.0, 1.21) if mode == AUTO else (0.97**2, 1.0)
            s = s * np.sqrt(np.clip((s[0] ** 2 - low) / (high - low), 0, 1))
        c = (u * s**2) @ u.T
        for place, wanted in ((MAJOR, s[0] ** 2), (MINOR, s[1] ** 2), (XX, c[0, 0]), (XY, c[0, 1]), (YY, c[1, 1])):
            np.testing.assert_allclose(parts[place : place + 6], wanted, atol=1e-4 * (1 + s[0] ** 2))


@pytest.mark.parametrize("mode", [AUTO, ANTIALIAS])
def test_no_footprint_is_larger_than_a_band_s_largest(mode: int) -> None:
    # Under smaller brushes some are, and are cut.
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:96, :200].astype(float)
    for radius in (6.0, 15.0, 40.0, 200.0):
        cx, cy = rng.uniform(0, 200), rng.uniform(0, 96)
        bell = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * radius**2))
        a, b = rng.normal(0, 1.5 * radius, 2)
        points = np.stack([x + a * bell, y + b * bell]).astype(np.float32)
        parts = np.empty(PARTS, np.float32)
        beyond = np.stack([points[:, 0], points[:, -1]])
        largest, second = extremes(points, beyond, ALONE, 0, 0, 200, mode, parts)
        for k in range(96):
            footprints(points, beyond, ALONE, 0, k, 0, 200, mode, parts)
            assert parts[MAJOR : MAJOR + 200].max() <= largest
            assert parts[MINOR : MINOR + 200].max() <= second
