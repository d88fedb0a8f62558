"""Sampled fields in the core: values, derivatives, inverses and folds, against scipy's values and exact solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

from supple import _core
from supple.fields import FOLDED, OK, OUTSIDE, UNCONVERGED, Field
from supple.space.domain import FREE
from supple.space.geometry import Grid, overlap
from tests.effort import ALL, examples, pairs
from tests.fields import OPTIONS, along_x, checked, drawn, drawn_grid, moved, on_grid, positions_of, settled, solutions

Floats = npt.NDArray[np.float64]
SHAPES = [(19, 30), (7, 12, 9), (4, 4), (5, 4, 6)]
STEEP = [(0.3, 3.0), (0.9, 3.0), (0.55, 0.0)]


def through(field: Field, positions: Floats, *, inverse: bool = False) -> tuple[Floats, Floats, npt.NDArray[np.uint8]]:
    """Return the core's x + u(x), or its inverse; the derivatives; and the status of each point."""
    n = field.ndim
    part: Any = ("field", field.packed(np.eye(n + 1)), inverse)
    points, status = np.zeros((len(positions), 3)), np.zeros(len(positions), np.uint8)
    points[:, :n] = positions
    found, slopes, _ = _core.Composite(n, np.array([FREE] * 3), [part]).through(points, False, True, status)
    assert slopes is not None
    return found[:, :n], slopes[:, :n, :n], status


def around(rng: np.random.Generator, grid: Grid, count: int = 400) -> Floats:
    sizes = np.array(grid.sizes)
    return grid.positions(rng.uniform(-2.5, sizes + 1.5, (count, grid.ndim)))


@pytest.mark.parametrize(("interpolation", "beyond", "dtype"), OPTIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_values_are_those_of_scipy(shape: tuple[int, ...], interpolation: str, beyond: str, dtype: str) -> None:
    rng = np.random.default_rng(len(shape))
    grid = drawn_grid(rng, shape)
    field = drawn(rng, grid, 3.0, width=0.6, interpolation=interpolation, beyond=beyond, dtype=dtype)
    places = np.concatenate([around(rng, grid), positions_of(grid)])
    if interpolation == "bspline":  # whose outermost samples are at the very end of the field
        places = places[on_grid(field, places, 1e-6) == on_grid(field, places, -1e-6)]
    found, _, _ = through(field, places)
    scale = 1 + np.abs(field.values).max()
    np.testing.assert_allclose(found, moved(field, places), atol=(2e-6 if dtype == "f4" else 1e-11) * scale)


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 9), (9, 1), (2, 3), (1, 1, 1), (1, 1, 8), (1, 8, 1), (8, 1, 1), (2, 3, 1)]
)
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_values_of_axes_of_few_samples(shape: tuple[int, ...], interpolation: str) -> None:
    rng = np.random.default_rng(3)
    grid = drawn_grid(rng, shape)
    field = drawn(rng, grid, 0.5, interpolation=interpolation, beyond="edge")
    places = around(rng, grid, 100)
    np.testing.assert_allclose(through(field, places)[0], moved(field, places), atol=1e-11)
    back, _, status = through(field, places, inverse=True)
    assert not (status & 5).any()
    np.testing.assert_allclose(moved(field, back), places, atol=1e-8)


@pytest.mark.parametrize(("interpolation", "beyond", "dtype"), [o for o in OPTIONS if o[2] == "f8"])
@pytest.mark.parametrize("shape", SHAPES[:2])
def test_derivatives_are_central_differences(
    shape: tuple[int, ...], interpolation: str, beyond: str, dtype: str
) -> None:
    rng = np.random.default_rng(5)
    grid = drawn_grid(rng, shape)
    field = drawn(rng, grid, 0.8, interpolation=interpolation, beyond=beyond, dtype=dtype)
    places, h, n = around(rng, grid), 1e-5, len(shape)
    away = np.abs(2 * grid.indices(places) - np.round(2 * grid.indices(places))).min(axis=1) > 1e-3  # from kinks
    places = places[away]
    _, slopes, _ = through(field, places)
    for j, e in enumerate(np.eye(n)):
        numeric = (moved(field, places + h * e) - moved(field, places - h * e)) / (2 * h)
        np.testing.assert_allclose(slopes[:, :, j], numeric, atol=1e-7)


@pytest.mark.parametrize(
    ("shape", "interpolation", "beyond", "dtype", "steep"),
    pairs(SHAPES[:2], ("linear", "cubic", "bspline"), ("zero", "edge"), ("f4", "f8"), STEEP),
)
def test_inverses_are_within_their_error(
    shape: tuple[int, ...], interpolation: str, beyond: str, dtype: str, steep: tuple[float, float]
) -> None:
    rng = np.random.default_rng(7)
    steepness, width = steep
    grid = drawn_grid(rng, shape)
    if interpolation != "linear":
        steepness *= 0.4 if width == 0 else 0.7  # splines overshoot
    field = drawn(rng, grid, steepness, width=width, interpolation=interpolation, beyond=beyond, dtype=dtype)
    corner = grid.positions([-1.3] * len(shape))
    finer = Grid([2 * n + 3 for n in shape], [s / 2 for s in grid.spacing], corner.tolist(), grid.direction)
    turned = Grid(shape, grid.spacing, grid.origin)
    for tolerance in (1e-4, 0.01, 0.5):
        for onto in (None, finer, turned):
            found = field.invert(onto, tolerance=tolerance)
            checked(field, found, tolerance)
            assert not (found.status == FOLDED).any()
            if beyond == "edge":  # beyond the grid, there is the inverse of the continued field
                assert ((found.status == OK) | (found.status == OUTSIDE)).all()
                assert np.isfinite(found.error).all()


@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1),
    tolerance=st.sampled_from([1e-6, 1e-3, 0.05, 0.5]),
    turning=st.sampled_from([0.0, 0.0, 0.05, 0.3]),
    beyond=st.sampled_from(["zero", "edge"]),
)
def test_one_axis_is_solved_exactly(seed: int, tolerance: float, turning: float, beyond: str) -> None:
    """Slopes of all sizes, some below 0: whatever is called ok is near a solution, and no fold is mapped there."""
    rng = np.random.default_rng(seed)
    slopes = np.exp(rng.uniform(np.log(1e-3), np.log(4), 40)) * np.where(rng.random(40) < turning, -1, 1)
    places = np.cumsum(slopes)
    places += 20 - places[20]
    field = along_x(places, beyond=beyond)
    sizes = int(rng.integers(1, 200)), 17
    step, start = float(rng.uniform(0.02, 1.0)), float(rng.uniform(-4, 20))
    grid = Grid(sizes[::-1], (step, 0.1), (start, 0.7))
    if not overlap(field.grid.box, grid.box):
        return
    found = field.invert(grid, tolerance=tolerance)
    ends = (-0.5, 39.5) if beyond == "zero" else (-np.inf, np.inf)
    exact = [solutions(places, start + step * i) for i in range(sizes[0])]
    for j, i in zip(*np.nonzero(found.status == OK), strict=True):
        y = start + step * i
        u, error = found.field.values[j, i, 0], found.error[j, i] + 1e-9
        within = [(x, s) for x, s in zip(*exact[i], strict=True) if ends[0] - 1e-6 <= x <= ends[1] + 1e-6]
        assert not any(s < 0 and 1e-4 < x % 1 < 1 - 1e-4 for x, s in within), f"{y} is folded"
        if beyond == "zero" and not -0.5 <= y <= 39.5 and u == 0:
            continue
        assert any(abs(y + u - x) <= error for x, _ in within), f"{y}: {y + u} ± {error}, and not {within}"
        assert any(abs(y + u - x) <= tolerance + 1e-9 for x, _ in within)


def test_a_crest_is_no_solution() -> None:
    places = np.interp(np.arange(41.0), [0, 16, 17, 18, 40], [0, 16, 16.5, 16, 41])
    field = Field(along_x(places).values.swapaxes(0, 1)[..., ::-1].copy(), Grid((41, 4)), beyond="edge")
    found = field.invert(Grid((16, 1), (1.0, 0.05), (1.0, 16.074576271186437)), tolerance=0.5)
    for i in np.flatnonzero(found.status[:, 0] == OK):
        y = 16.074576271186437 + 0.05 * i
        near = min(abs(x - y - found.field.values[i, 0, 1]) for x in solutions(places, y)[0])
        assert near <= found.error[i, 0] + 1e-9


def test_a_short_step_across_a_kink_is_not_the_distance() -> None:
    places = np.interp(np.arange(41.0), [0, 19, 20, 40], [0, 19.9, 20 + 2e-4, 80])
    found = along_x(places, beyond="edge").invert(tolerance=0.002)
    assert found.status[0, 20] == OK
    off = abs(20 + float(found.field.values[0, 20, 0]) - solutions(places, 20.0)[0][0])
    assert off <= min(float(found.error[0, 20]) + 1e-9, 0.002)


@pytest.mark.parametrize("rows", [1, 2, 5])
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_what_folds_at_an_edge_folds_beyond_it(rows: int, interpolation: str) -> None:
    places = np.interp(np.arange(41.0), [0, 16, 17, 18, 40], [0, 17, 18.5, 15, 41])
    field = along_x(places, rows, interpolation=interpolation, beyond="edge")
    status = field.invert(Grid((30, 41), 1.0, (0, -12))).status
    assert (status[:, 16:18] == FOLDED).all()
    assert ((status == FOLDED) == (status[0] == FOLDED)).all()
    assert (status[[0, -1]] != OK).all()


def test_what_comes_from_two_points_is_folded() -> None:
    """A strip that is wound into a circle, and beyond it, turns nothing over; but its ends lie on each other."""
    i, j = np.meshgrid(np.arange(160.0), np.arange(12.0))
    radius, angle = 31 - j, 7.0 / 159 * i
    u = np.stack([40 + radius * np.sin(angle) - i, 40 - radius * np.cos(angle) - j], -1)
    field = Field.from_array(u)
    assert not field.folded_cells().any()
    found = field.invert(Grid((80, 80)))
    y, x = np.indices(found.status.shape)
    around = np.arctan2(x - 40, 40 - y) % (2 * np.pi)
    twice = (np.abs(np.hypot(x - 40, y - 40) - 25.5) < 4) & (around > 0.1) & (around < 7 - 2 * np.pi - 0.1)
    assert twice.sum() > 50
    assert (found.status[twice] == FOLDED).all()


def test_a_solution_beyond_the_grid_is_outside() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20 if ALL else 4):
        field = drawn(rng, Grid((9, 9)), 0.8, width=1.0)
        finer = Grid((181, 181), 1 / 15, (-2, -2))
        found = field.invert(finer, tolerance=0.3)
        checked(field, found, 0.3)
        targets, ok = positions_of(finer), found.status.ravel() == OUTSIDE
        assert ok.any()
        assert not on_grid(field, settled(field, targets, targets)[ok], -0.3).any()


@pytest.mark.parametrize("spacing", [1.0, 0.7, 0.1, 1.1, 3.3])
def test_the_border_of_coefficients_is_on_their_grid(spacing: float) -> None:
    values = np.zeros((9, 11, 2))
    values[..., 0] = 0.2 * spacing * np.cos(np.arange(11))  # along x alone; y stays
    field = Field.from_array(values, spacing=spacing, origin=(3.7, -0.3), interpolation="bspline")
    found = field.invert()
    inner = found.status[:, 2:-2]
    assert (inner == inner[0]).all(), "the first and last rows are samples of the field, too"
    assert (inner == OK).all()
    assert (np.abs(found.field.values[:, 2:-2] - found.field.values[:1, 2:-2]) < 1e-2 * spacing).all()
    assert not through(field, positions_of(found.field.grid))[2].any()


@pytest.mark.parametrize("spacing", [1.0, 0.7, 0.3, 0.1, 3.3, 0.45])
@pytest.mark.parametrize("origin", [0.0, 3.7, -11.3, 100.1])
def test_rounding_does_not_take_the_border_off_its_grid(spacing: float, origin: float) -> None:
    values = np.zeros((9, 11, 2))
    values[..., 1] = 0.3 * spacing  # nothing of the field is mapped to its first row, and none stays there
    for sign, row in ((1, 0), (-1, -1)):
        field = Field.from_array(sign * values, spacing=spacing, origin=(origin, origin), interpolation="bspline")
        assert (field.invert().status[row] == OUTSIDE).all()


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "bspline"])
@pytest.mark.parametrize("shape", [(24, 31), (7, 9, 8)])
def test_folded_cells_hold_all_that_folds(shape: tuple[int, ...], interpolation: str) -> None:
    rng = np.random.default_rng(13)
    for steepness in (0.2, 1.5, 4.0):
        field = drawn(rng, Grid(shape), steepness, interpolation=interpolation, beyond="edge")
        own = interpolation == "bspline"
        cells = np.zeros([n - (3 if own else 1) for n in shape], np.uint8)
        field.packed(np.eye(len(shape) + 1)).folded_cells(cells)
        inside = rng.uniform(own, np.array(shape[::-1]) - (2 if own else 1), (20000, len(shape)))
        _, slopes, status = through(field, inside)
        turned = np.linalg.det(slopes) <= 0
        np.testing.assert_array_equal(turned, status == 1)
        at = np.floor(inside[turned]).astype(int) - own
        assert cells[tuple(at[:, ::-1].T)].all()
        if steepness < 1 / len(shape):
            assert not cells.any()
            assert not turned.any()


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "bspline"])
@pytest.mark.parametrize("beyond", ["zero", "edge"])
@pytest.mark.parametrize("shape", [(20, 24), (7, 8, 9)])
def test_what_folds_is_not_called_ok(shape: tuple[int, ...], beyond: str, interpolation: str) -> None:
    """Points where the field turns over are mapped beside samples that are not called ok."""
    rng = np.random.default_rng(17)
    field = drawn(rng, Grid(shape), 4.0, interpolation=interpolation, beyond=beyond)
    own = interpolation == "bspline"
    inside = rng.uniform(own, np.array(shape[::-1]) - (2 if own else 1), (300, len(shape)))
    found, slopes, _ = through(field, inside)
    turned = np.linalg.det(slopes) < -1e-3
    assert turned.any()
    for y in found[turned][:60]:
        sample = Grid((1,) * len(shape), 1.0, y.tolist())
        if on_grid(field, y[None])[0]:
            assert field.invert(sample).status.ravel()[0] != OK


@pytest.mark.parametrize("shape", [(12, 15), (6, 7, 8)])
def test_cells_of_a_linear_field_are_decided_by_their_determinant(shape: tuple[int, ...]) -> None:
    """A cell is marked where the determinant, sampled densely, comes near 0, and hardly elsewhere."""
    rng = np.random.default_rng(5)
    n = len(shape)
    field = drawn(rng, Grid(shape), 4.0, beyond="edge")
    cells = np.zeros([k - 1 for k in shape], np.uint8)
    field.packed(np.eye(n + 1)).folded_cells(cells)
    steps = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * n, indexing="ij"), -1).reshape(-1, n) * (1 - 1e-9)
    lowest = np.empty(cells.shape)
    for at in np.ndindex(*cells.shape):
        _, slopes, _ = through(field, np.array(at[::-1]) + steps)
        lowest[at] = np.linalg.det(slopes).min()
    assert 0.1 < (lowest < 0).mean() < 0.9
    assert cells[lowest < 0].all()
    assert not cells[lowest > 0.05].any()


@pytest.mark.parametrize("roughness", [1.0, 3.0])
def test_points_of_a_field_that_folds_are_found(roughness: float) -> None:
    """A fifth of the field is turned over, and yet nearly every sample of its inverse is solved."""
    rng = np.random.default_rng(2)
    shape = (40, 44, 48)
    values = np.stack([gaussian_filter(rng.normal(size=shape), roughness) for _ in range(3)], -1)

    def turned(strength: float) -> float:
        slopes = np.stack([np.gradient(strength * values[..., k])[::-1] for k in range(3)], 0)
        return float((np.linalg.det(np.moveaxis(slopes, (0, 1), (-2, -1)) + np.eye(3)) <= 0).mean())

    strength = brentq(lambda s: turned(s) - 0.2, 0, 1e4, xtol=1e-3)
    field = Field.from_array(strength * values, beyond="edge")
    inverse = field.invert()
    assert (inverse.status == UNCONVERGED).mean() < 5e-4
    solved = inverse.status != UNCONVERGED
    q = np.stack(np.meshgrid(*(np.arange(k, dtype=float) for k in shape), indexing="ij")[::-1], -1)
    back, _, _ = through(field, (q + inverse.field.values)[solved])
    assert np.abs(back - q[solved]).max() < 0.05
