"""The lattice of a plane, beyond its pixels: grids of chroma samples, and bounds of where its source points lie."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from supple import Deformation
from supple.cpu.warp import Band, Certificate, Grid, Plane, bounds_of, each_band

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]


@pytest.fixture(autouse=True)
def _nothing_is_left_unwritten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays that nobody has written to hold no numbers."""

    class Poisoned:
        def __getattr__(self, name: str) -> Any:
            return getattr(np, name)

        def empty(self, *args: Any) -> npt.NDArray[Any]:
            made: npt.NDArray[Any] = np.empty(*args)
            made.view(np.uint8).fill(255)  # NaN
            return made

    monkeypatch.setattr("supple.cpu.warp.np", Poisoned())


# Steps and offsets of 4:2:0 (MPEG-2's siting, JPEG's, and top left), 4:2:2, 4:1:1, 4:4:0 and 4:1:0.
SITINGS = [
    ((2, 2), (0.0, 0.5)),
    ((2, 2), (0.5, 0.5)),
    ((2, 2), (0.0, 0.0)),
    ((2, 1), (0.0, 0.0)),
    ((2, 1), (0.5, 0.0)),
    ((4, 1), (0.0, 0.0)),
    ((4, 1), (1.5, 0.0)),
    ((1, 2), (0.0, 0.5)),
    ((4, 4), (1.5, 1.5)),
    ((4, 4), (0.0, 0.0)),
]


def grid_of(shape: tuple[int, int], step: tuple[int, int], offset: tuple[float, float]) -> Grid:
    return Grid(step, offset, (-(-shape[0] // step[1]), -(-shape[1] // step[0])))


def gathered(plane: Plane, tolerance: float, grid: Grid | None) -> tuple[Floats, Floats | None, Certificate]:
    """All source points of a plane's pixels, and those of a grid, in its own numbers; NaN where none was written."""
    pixels = np.full((*plane.shape, plane.ndim), np.nan)
    samples = np.full((*grid.shape, plane.ndim), np.nan) if grid else None

    def put(band: Band, out: Floats) -> None:
        rows, columns = band.points.shape[1:]
        for run, anchor in enumerate(band.anchors):
            left = band.edges[run]
            right = min(band.edges[run + 1], columns)
            for c in range(plane.ndim):
                values = band.points[c, :, left:right].astype(np.float64) + anchor[c]
                assert np.isnan(out[band.top : band.top + rows, left:right, c]).all()  # each once
                out[band.top : band.top + rows, left:right, c] = values

    def use(band: Band) -> None:
        put(band, pixels)
        assert (band.coarse is None) == (grid is None)
        if band.coarse is not None:
            assert samples is not None
            put(band.coarse, samples)

    certificate = each_band(plane, tolerance, use, grid)
    assert not np.isnan(pixels).any()
    assert samples is None or not np.isnan(samples).any()
    return pixels, samples, certificate


def places(grid: Grid, z: float, ndim: int) -> Floats:
    """Where a grid's samples lie, in pixels."""
    points = reference.grid(grid.shape) * np.array(grid.step, np.float64) + np.array(grid.offset)
    return np.concatenate([points, np.full((*grid.shape, ndim - 2), z)], axis=-1)


def in_pixels(samples: Floats, grid: Grid) -> Floats:
    scale, shift = np.ones(samples.shape[-1]), np.zeros(samples.shape[-1])
    scale[:2], shift[:2] = grid.step, grid.offset
    return samples * scale + shift


def off_by(d: Deformation, grid: Grid, z: int, tolerance: float) -> tuple[float, Certificate]:
    """How far the worst of a grid's points is from T⁻¹, in pixels."""
    plane = d.space.solve(z, grid.step)
    _, samples, certificate = gathered(plane, tolerance, grid)
    assert samples is not None
    true = d.inverse(places(grid, z, d.ndim))
    assert true.converged.all()
    return float(np.linalg.norm(in_pixels(samples, grid) - true.points, axis=-1).max()), certificate


def drawn(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    strokes: int,
    border: float | None,
    least: float = 2,
    most: float = 1.5,
) -> Deformation:
    """Strokes of all sizes, some at the last column and row, where a grid may go on beyond the plane."""
    d = Deformation(shape, border=border)
    size, n = np.array(shape[::-1]) - 1.0, len(shape)
    for _ in range(strokes):
        radius = float(np.exp(rng.uniform(math.log(least), math.log(40))))
        at = rng.uniform(-0.05, 1.05, n) * size
        if rng.uniform() < 0.4:
            at[:2] = size[:2] + rng.uniform(0, 2, 2)
        by = rng.normal(size=n)
        by *= radius * rng.uniform(0.2 * most, most) / np.linalg.norm(by)
        d = d.grab(at, by=by, radius=radius, scales=int(rng.integers(1, 4)))
    return d


@pytest.mark.parametrize("border", [None, 5.0, 50.0])
@pytest.mark.parametrize(("step", "offset"), SITINGS)
def test_chroma_is_no_farther_off_than_said(step: tuple[int, int], offset: tuple[float, float], border: float) -> None:
    """Between the nodes of a cell of one pixel, nothing is refined any more: the certificate says so."""
    rng = np.random.default_rng(int(100 * offset[0] + 10 * step[0] + step[1]))
    for shape in [(64, 96), (33, 65), (41, 70), (67, 35), (40, 273)]:
        d = drawn(rng, (9, *shape), int(rng.integers(1, 4)), border)
        for tolerance in (0.1, 0.01):
            off, certificate = off_by(d, grid_of(shape, step, offset), int(rng.integers(9)), tolerance)
            assert off <= max(tolerance, certificate.error), f"{off} px at a tolerance of {tolerance}: {d}"


@pytest.mark.parametrize("border", [None, 50.0])
@pytest.mark.parametrize(("step", "offset"), SITINGS)
def test_chroma_lies_where_it_should(step: tuple[int, int], offset: tuple[float, float], border: float | None) -> None:
    rng = np.random.default_rng(int(100 * offset[0] + 10 * step[0] + step[1]))
    for shape in [(64, 96), (33, 65), (41, 70), (67, 35), (40, 273)]:
        d = drawn(rng, (9, *shape), int(rng.integers(1, 4)), border, least=8, most=0.5 if border is None else 0.2)
        for tolerance in (0.1, 0.01):
            off, certificate = off_by(d, grid_of(shape, step, offset), int(rng.integers(9)), tolerance)
            assert certificate.error <= tolerance
            assert off <= certificate.error, f"{off} px at a tolerance of {tolerance}: {d}"


def test_a_grid_that_is_the_pixels_is_the_pixels() -> None:
    d = drawn(np.random.default_rng(1), (9, 50, 70), 3, None)
    plane = d.space.solve(4)
    pixels, samples, _ = gathered(plane, 0.01, Grid((1, 1), (0.0, 0.0), (50, 70)))
    assert samples is not None
    # Polynomials of a fraction of a cell, with other anchors, in float32.
    np.testing.assert_allclose(samples, pixels, rtol=0, atol=2e-5)
    half, shifted, _ = gathered(plane, 0.01, Grid((2, 1), (0.0, 0.0), (50, 35)))
    assert shifted is not None
    np.testing.assert_allclose(shifted * [2, 1, 1], half[:, ::2], rtol=0, atol=4e-5)


def test_chroma_of_a_picture() -> None:
    d = drawn(np.random.default_rng(2), (61, 83), 2, 50.0)
    for step, offset in SITINGS:
        off, _ = off_by(d, grid_of((61, 83), step, offset), 0, 0.01)
        assert off <= 0.01


@pytest.mark.parametrize("border", [None, 50.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (1, 40), (40, 1), (2, 40), (40, 2), (2, 2), (33, 34)])
def test_chroma_of_small_planes(shape: tuple[int, int], border: float | None) -> None:
    height, width = shape
    d = Deformation((9, *shape), border=border).grab((0.4 * width, 0.5 * height, 4), by=(0.1, 0.1, 2), radius=30)
    for step, offset in SITINGS:
        off, certificate = off_by(d, grid_of(shape, step, offset), 3, 0.01)
        assert off <= max(0.01, certificate.error)
        assert off <= 0.02, f"{off} px of {shape} at {step}, {offset}"


def test_pixels_that_are_not_square() -> None:
    d = Deformation((9, 45, 71), spacing=(1.0, 2.5, 6.0), border=None).grab((40, 20, 4), by=(9, 3, 1.5), radius=25)
    for step, offset in SITINGS:
        off, _ = off_by(d, grid_of((45, 71), step, offset), 5, 0.01)
        assert off <= 0.01


@st.composite
def bent(draw: st.DrawFn) -> tuple[Deformation, int]:
    """A few strokes, from far smaller than a lattice cell to larger than all, and a plane."""
    shape = draw(st.tuples(st.integers(1, 12), st.integers(1, 80), st.integers(1, 100)))
    border = draw(st.sampled_from([None, 1.0, 5.0, 50.0]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    d = Deformation(shape, border=border)
    size = np.array(shape[::-1]) - 1.0
    for _ in range(draw(st.integers(1, 3))):
        radius = float(np.exp(rng.uniform(math.log(0.7), math.log(60))))
        at = rng.uniform(-0.1, 1.1, 3) * size
        by = rng.normal(size=3) * radius * np.exp(rng.uniform(math.log(0.01), math.log(2)))
        d = d.grab(at, by=by, radius=radius, scales=int(rng.integers(1, 4)))
    return d, draw(st.integers(0, shape[0] - 1))


ROUNDING = 1e-6  # of float32 points, relative to their anchor


def bounded(d: Deformation, z: int, tolerance: float = 0.01) -> tuple[Any, Floats]:
    plane = d.space.solve(z)
    bounds = bounds_of(plane, tolerance)
    pixels, _, _ = gathered(plane, tolerance, None)
    times = pixels[..., 2]
    assert bounds.early <= times.min() + ROUNDING
    assert bounds.late >= times.max() - ROUNDING
    moved = pixels - places(Grid((1, 1), (0.0, 0.0), plane.shape), z, 3)
    assert bounds.moved >= np.abs(moved).max() - 1e-5
    return bounds, pixels


@settings(max_examples=150, deadline=None)
@given(bent())
def test_bounds_hold_every_source_point(case: tuple[Deformation, int]) -> None:
    d, z = case
    bounds, _ = bounded(d, z)
    exact = d.inverse(places(Grid((1, 1), (0.0, 0.0), d.shape[1:]), z, 3))  # type: ignore[arg-type]
    if exact.converged.all():
        certificate = gathered(d.space.solve(z), 0.01, None)[2]
        assert bounds.early - certificate.error <= exact.points[..., 2].min() + ROUNDING
        assert bounds.late + certificate.error >= exact.points[..., 2].max() - ROUNDING


@pytest.mark.parametrize("seed", range(40))
def test_bounds_are_close(seed: int) -> None:
    """A Bézier patch comes near its control points, and the nearer the smaller its cells: no frame too many is read."""
    rng = np.random.default_rng(seed)
    d = drawn(rng, (9, int(rng.integers(2, 80)), int(rng.integers(2, 120))), int(rng.integers(1, 4)), None)
    z = int(rng.integers(9))
    bounds, pixels = bounded(d, z)
    times = pixels[..., 2]
    loose = 0.1 + 0.05 * float(np.abs(times - z).max())
    assert times.min() - bounds.early <= loose
    assert bounds.late - times.max() <= loose
    moved = float(np.abs(pixels - places(Grid((1, 1), (0.0, 0.0), d.shape[1:]), z, 3)).max())  # type: ignore[arg-type]
    assert bounds.moved <= 1.05 * moved + 0.1


@pytest.mark.parametrize("at", [(48.0, 48.0, 4.0), (49.3, 46.1, 4.4), (16.5, 80.2, 3.8)])
@pytest.mark.parametrize("radius", [1.0, 2.0, 4.0])
def test_spikes_between_the_nodes_are_bounded(at: tuple[float, float, float], radius: float) -> None:
    """A small tri-scale brush is felt at no node around it, and moves time all the same."""
    d = Deformation((9, 97, 97)).grab(at, by=(0, 0, 0.9 * radius), radius=radius, scales=3)
    bounds, pixels = bounded(d, 4)
    assert np.abs(pixels[..., 2] - 4).max() > 0.2 * radius
    assert bounds.moved > 0.2 * radius
    assert 4 - bounds.early > 0.2 * radius


def test_where_nothing_moves() -> None:
    d = Deformation((40, 40, 60), border=None).grab((30, 20, 4), by=(3, 2, 3), radius=3, scales=3)
    far = bounds_of(d.space.solve(39), 0.01)
    assert far.moved < 0.01
    assert far.early == pytest.approx(39, abs=0.01)
    assert far.late == pytest.approx(39, abs=0.01)
    assert far.rate == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("border", [None, 50.0])
def test_rates_are_how_many_frames_a_pixel_covers(border: float | None) -> None:
    d = Deformation((60, 50, 90), border=border, on_fold="flow").grab((40, 20, 20), by=(5, 3, 30), radius=40)
    for z in (0, 20, 45, 59):
        found = bounds_of(d.space.solve(z), 0.01).rate
        points = d.inverse(places(Grid((1, 1), (0.0, 0.0), (50, 90)), z, 3)).points
        longest = reference.durations(d, points).max()
        assert 0.7 * longest <= found <= 1.01 * longest


# Each shape, stroke and siting: chroma beyond the last pixel is earlier, or later, than any pixel.
BEYOND = [
    ((41, 21), (22.64, 9.73, 3.13), 5.76, ((2, 2), (0.5, 0.5))),
    ((40, 57), (58.3, 20.0, 4.0), 4.0, ((4, 4), (1.5, 1.5))),
]


@pytest.mark.parametrize("case", BEYOND)
def test_bounds_of_padded_planes(case: Any) -> None:
    """What a plan is made of holds for the chroma samples beyond the last pixel as well."""
    shape, at, radius, (step, offset) = case
    d = Deformation((9, *shape), border=None).grab(at, by=(0, 0, radius), radius=radius)
    worst = 0.0
    for z in range(9):
        grid = grid_of(shape, step, offset)
        plane = d.space.solve(z, step)
        bounds = bounds_of(plane, 0.01)
        _, samples, _ = gathered(plane, 0.01, grid)
        assert samples is not None
        assert bounds.early <= samples[..., 2].min() + ROUNDING
        assert bounds.late >= samples[..., 2].max() - ROUNDING
        narrow = bounds_of(d.space.solve(z), 0.01)
        worst = max(worst, narrow.early - samples[..., 2].min())
    assert worst > 0.03  # and it is needed
