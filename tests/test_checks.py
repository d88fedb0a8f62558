"""Checks of fields: determinants, folds, and how well another undoes one; against NumPy, SciPy and formulas."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Affine, Field, Grid
from supple.fields import checks
from tests.sampled_fields import GRID, moved, positions, sine, smooth

Floats = npt.NDArray[np.float64]
FLAT = Grid((19, 23), (0.5, 2.0), (3.0, -7.0), [[0.8, -0.6], [0.6, 0.8]])


def affine_field(matrix: Floats, grid: Grid, **how: Any) -> Field:
    points = positions(grid)
    return Field(Affine(matrix)(points) - points, grid, **how)


@pytest.mark.parametrize("grid", [GRID, FLAT], ids=["volume", "picture"])
def test_log_jacobians_are_those_of_central_differences(grid: Grid) -> None:
    field = smooth(grid, 0.8)
    slopes = np.stack([np.gradient(field.values, axis=grid.ndim - 1 - a) for a in range(grid.ndim)], axis=-1)
    jacobian = np.eye(grid.ndim) + slopes @ np.linalg.inv(grid.matrix[:-1, :-1])
    determinants = np.linalg.det(jacobian)
    assert (determinants > 0).all()
    found = field.log_jacobian()
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, np.log(determinants), atol=1e-6)


@pytest.mark.parametrize("grid", [GRID, FLAT], ids=["volume", "picture"])
@pytest.mark.parametrize("interpolation", ["linear", "bspline"])
def test_of_an_affine_map_all_is_its_determinant(grid: Grid, interpolation: str) -> None:
    n = grid.ndim
    matrix = np.eye(n + 1)
    matrix[:n, :n] += 0.2 * np.random.default_rng(1).normal(size=(n, n))
    matrix[:n, n] = 0.3
    # the coefficients of a B-spline of a linear function are its samples
    field = affine_field(matrix, grid, interpolation=interpolation)
    expected = np.linalg.det(matrix)
    assert expected > 0.2
    report = field.check()
    np.testing.assert_allclose(field.log_jacobian(), np.log(expected), atol=1e-4)
    assert report.determinant == pytest.approx(expected, rel=1e-6)
    assert report.samples == field.log_jacobian().size == np.prod(report.grid.shape)
    assert (report.folded, report.negative, report.folds) == (0, 0, False)
    lengths = np.linalg.norm(Affine(matrix)(positions(report.grid)) - positions(report.grid), axis=-1)
    assert (report.largest, report.mean) == pytest.approx((lengths.max(), lengths.mean()), rel=1e-6)
    wide = Grid(
        [3 * size for size in grid.shape],
        grid.spacing,
        grid.positions([-size for size in grid.sizes]).tolist(),
        grid.direction,
    )
    inverse = field.check(affine_field(np.linalg.inv(matrix), wide)).consistency
    assert inverse is not None
    assert inverse.outside == 0
    assert inverse.largest < 1e-4


def test_a_sine_folds_where_its_slope_is_above_one() -> None:
    strength = 1.4
    field = sine(strength)
    x = field.values[0, 0, :, 0]
    slopes = np.diff(x) / 0.1
    expected = slopes <= -1
    found = field.folded_cells()
    assert found.shape == (2, 3, 125)
    np.testing.assert_array_equal(found, np.broadcast_to(expected, found.shape))
    # Analytically: where cos x > 1/a, to a sample.
    places = (np.arange(125) + 0.5) * 0.1
    off = np.cos(places) > 1 / strength
    assert np.count_nonzero(expected != off) <= 3
    report = field.check()
    assert report.folds
    assert report.folded == found.sum()
    assert report.cells == found.size
    assert report.determinant == pytest.approx(1 + slopes.min())
    assert report.determinant == pytest.approx(1 - strength, abs=2e-3)
    assert min(abs(report.at[0] - k * 2 * np.pi) for k in range(3)) <= 0.1
    assert report.negative == np.isnan(field.log_jacobian()).sum()
    centred = 1 - strength * np.cos(np.arange(126) * 0.1) * np.sin(0.1) / 0.1
    np.testing.assert_array_equal(np.isnan(field.log_jacobian())[1, 2, 1:-1], centred[1:-1] <= 0)


@pytest.mark.parametrize("strength", [0.5, 0.97])
@pytest.mark.parametrize("shape", [(3, 4, 126), (4, 126), (1, 1, 126), (1, 126), (1, 3, 126)])
def test_a_sine_of_less_does_not(strength: float, shape: tuple[int, ...]) -> None:
    report = sine(strength, shape).check()
    assert (report.folded, report.negative) == (0, 0)
    assert report.determinant == pytest.approx(1 - strength, abs=2e-3)
    assert report.cells == np.prod([max(n - 1, 1) for n in shape])


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1), (2, 1, 1), (3, 1)])
def test_fields_of_hardly_any_samples(shape: tuple[int, ...]) -> None:
    report = Field.from_array(np.full((*shape, len(shape)), 0.5)).check()
    assert report.determinant == 1
    assert report.folded == 0
    assert report.mean == pytest.approx(0.5 * len(shape) ** 0.5)


@pytest.mark.parametrize("grid", [Grid((4, 3, 5), (1.1, 0.9, 1.6), (1, 2, 3), GRID.direction), Grid((6, 5), (0.5, 2))])
def test_the_least_determinant_is_that_of_the_interpolant_at_the_corners(grid: Grid) -> None:
    """From inside each cell, along whose sides the interpolant is linear: differences are exact."""
    field = smooth(grid, 3.0, seed=4)
    n, least, where = grid.ndim, np.inf, ()
    for cell in itertools.product(*(range(size - 1) for size in grid.sizes)):
        for corner in itertools.product((0, 1), repeat=n):
            index = np.array(cell) + corner
            ends = [index + np.where(np.arange(n) == axis, 0.5 - np.array(corner), 0.0) for axis in range(n)]
            points = grid.positions(np.array([index, *ends]))
            there = moved(field, points)
            determinant = np.linalg.det((there[1:] - there[0]).T) / np.linalg.det((points[1:] - points[0]).T)
            if determinant < least:
                least, where = determinant, tuple(points[0])
    report = field.check()
    assert report.determinant == pytest.approx(least, rel=1e-9)
    assert report.at == pytest.approx(where)


@pytest.mark.parametrize("interpolation", ["cubic", "bspline"])
def test_of_splines_the_derivatives_are_exact(interpolation: Any) -> None:
    grid = Grid((8, 9, 10), (0.5, 0.6, 0.7))
    field = Field(smooth(grid, 0.4, seed=2).values, grid, interpolation)
    report, known = field.check(), field.check().grid
    points = positions(known)[1:-1, 1:-1, 1:-1].reshape(-1, 3)
    off = 1e-4 * np.eye(3)
    steps = [(through(field, points + one) - through(field, points - one)) / 2e-4 for one in off]
    determinants = np.linalg.det(np.stack(steps, axis=-1))
    assert report.determinant <= determinants.min() + 1e-6
    assert abs(np.exp(field.log_jacobian()[1:-1, 1:-1, 1:-1].ravel()) - determinants).max() < 0.2


def through(field: Field, points: Floats) -> Floats:
    """Return points as the interpolant maps them."""
    return checks.through([("field", field.packed(np.eye(4)), False)], points)[0]


@pytest.mark.parametrize("grid", [GRID, FLAT], ids=["volume", "picture"])
def test_the_outermost_samples_of_a_spline_are_within_it(grid: Grid) -> None:
    field = affine_field(np.diag([1.2] * grid.ndim + [1.0]), grid, interpolation="bspline")
    made = field.compose()
    np.testing.assert_allclose(made.values, 0.2 * positions(made.grid), atol=1e-4)


@pytest.mark.parametrize("grid", [GRID, FLAT], ids=["volume", "picture"])
def test_inverse_consistency_is_that_of_points(grid: Grid) -> None:
    first, second = smooth(grid, 0.7, seed=1), smooth(grid, 0.7, seed=2)
    points = positions(grid)
    there = moved(first, points)
    index = grid.indices(there)
    inside = ((index >= -0.5) & (index <= np.array(grid.sizes) - 0.5)).all(axis=-1)
    expected = np.linalg.norm(moved(second, there) - points, axis=-1)
    found = first.distances(second)
    np.testing.assert_array_equal(np.isnan(found), ~inside)
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-5)
    figures = first.check(second).consistency
    assert figures is not None
    assert (figures.count, figures.outside) == (inside.sum(), (~inside).sum())
    assert 0 < figures.outside < 0.5 * inside.size
    assert figures.largest == pytest.approx(expected[inside].max(), abs=1e-5)
    assert figures.percentile == pytest.approx(np.percentile(expected[inside], 99), abs=1e-5)
    assert figures.mean == pytest.approx(expected[inside].mean(), abs=1e-5)


def test_the_inverse_of_a_field_undoes_it_to_the_interpolation_of_the_inverse() -> None:
    """In the middle of a fine grid, second differences of the inverse bound the distance."""
    field = smooth(Grid((40, 40)), 0.5)
    inverse = field.invert(tolerance=1e-6).field
    found = field.distances(inverse)[5:-5, 5:-5]
    bends = [np.abs(np.diff(inverse.values, 2, axis=axis)).max() for axis in (0, 1)]
    assert found.max() < 2 * sum(bends)
    assert found.max() > 1e-4  # or zeros would pass


def test_nothing_is_measured_where_all_is_outside() -> None:
    field = Field.from_array(np.full((3, 4, 2), 100.0))
    found = field.check(field).consistency
    assert found is not None
    assert (found.count, found.outside) == (0, 12)
    assert np.isnan([found.largest, found.percentile, found.mean]).all()
