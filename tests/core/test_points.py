"""T, its Jacobian and its inverse at points, as the core has them, against the printed equations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given

from supple import Deformation, _core
from supple._core.rows import numbers
from supple.folding.strain import limit
from supple.space.domain import Domain
from supple.strokes import Stroke, pack
from tests import reference
from tests.core.drawn import POISSONS, deformation, deformations, lifted, places
from tests.effort import examples

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]
Table = npt.NDArray[np.void]
SHAPES = [(40, 55), (13, 30, 41)]


def packed(domain: Domain) -> Floats:
    axes = domain.packed()
    if domain.ndim == 2:
        axes[2, 2] = 0
    return axes


def forward(table: Table, domain: Domain, points: Floats) -> tuple[Floats, Floats]:
    """Return the core's T and ∂T/∂p, in samples; rows are taken as they are."""
    n, steps = domain.ndim, np.array(domain.spacing)
    given = np.zeros((len(points), 3))
    given[:, :n] = points * steps
    moved, matrices = _core.forward(numbers(table), packed(domain), given, True)
    assert not moved[:, n:].any()
    return moved[:, :n] / steps, matrices[:, :n, :n] * (steps / steps[:, None])


def agrees(table: Table, steps: Sequence[reference.Step], domain: Domain, points: Floats) -> None:
    moved, matrices = forward(table, domain, points)
    expected, slopes = reference.moved(steps, domain, points)
    np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(matrices, slopes, rtol=1e-9, atol=1e-9)


@examples(30)
@given(deformations())
def test_forward_is_the_printed_equation(d: Deformation) -> None:
    agrees(d.space.table, reference.carried_out(d), d.domain, places(d, 80))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("profile", ["quartic", "sine"])
@pytest.mark.parametrize("border", [None, 1.0, 9.0, 400.0])
@pytest.mark.parametrize("reach", [None, 1.0, 3.0])
def test_every_option_of_a_stroke(shape: tuple[int, ...], profile: Any, border: float | None, reach: float) -> None:
    n = len(shape)
    domain = Domain(shape, (0.8, 1.5, 2.5)[:n], border, profile)
    at, by = np.array([20.3, 17.7, 6.2])[:n], np.array([1.1, -0.7, 0.4])[:n]
    points = places(Deformation(shape, border=64, on_fold="damp"), 100)
    for scales in (1, 2, 3):
        for poisson in POISSONS:
            stroke = Stroke.grab(at, by=by, radius=7, scales=scales, poisson=poisson, reach=reach)
            agrees(pack([stroke], domain.spacing), [stroke], domain, points)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(4))
def test_the_jacobian_is_the_slope(shape: tuple[int, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    d = deformation(rng, shape, 3, border=(None, 8.0)[seed % 2], border_profile=("quartic", "sine")[seed // 2])
    strokes = reference.carried_out(d)
    points = rng.uniform(0, 1, (200, d.ndim)) * (np.array(shape[::-1]) - 1.0)
    if d.domain.border is not None:
        # The slope has a kink where a border begins and ends, seen by any of the strokes.
        size, clear = np.array(d.shape[::-1]) - 1.0, np.ones(len(points), bool)
        sigma, at = np.minimum(8.0, size / 2), points
        for stroke in [*strokes, None]:
            for kink in (0 * size, sigma, size - sigma, size):
                clear &= (np.abs(at - kink) > 0.01).all(axis=-1)
            if stroke is not None:
                at = reference.forward([stroke], d.domain, at)
        points = points[clear]
    assert len(points) > 80
    found = reference.differences(lambda p: forward(d.space.table, d.domain, p)[0], points, 1e-3)
    np.testing.assert_allclose(forward(d.space.table, d.domain, points)[1], found, rtol=1e-6, atol=1e-7)


def test_only_what_is_asked_for_is_made() -> None:
    d = Deformation((20, 30), border=64, on_fold="damp").grab((9, 9), by=(2, 1), radius=5, reach=None)
    points = lifted(d, places(d, 7))
    moved, none = _core.forward(numbers(d.space.table), d.space.axes, points, False)
    assert none is None
    np.testing.assert_array_equal(moved, _core.forward(numbers(d.space.table), d.space.axes, points, True)[0])


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 1023, 1024, 1025, 2050])
def test_any_number_of_points(count: int) -> None:
    """Batches and vectors leave no trace."""
    d = Deformation((20, 30), border=64, on_fold="damp").grab((9, 9), by=(2, 1), radius=5, reach=None)
    rows, points = numbers(d.space.table), lifted(d, places(d, 2050))
    moved, slopes = _core.forward(rows, d.space.axes, points[:count], True)
    whole = _core.forward(rows, d.space.axes, points, True)
    np.testing.assert_array_equal(moved, whole[0][:count])
    np.testing.assert_array_equal(slopes, whole[1][:count])
    found = _core.inverse(d.space.map, points[:count], 1e-9)
    assert [len(a) for a in found] == [count] * 3
    for part, all_of_it in zip(found[:2], _core.inverse(d.space.map, points, 1e-9)[:2], strict=True):
        np.testing.assert_allclose(part, all_of_it[:count], rtol=0, atol=1e-9)


@examples(30)
@given(deformations())
def test_the_inverse_undoes_the_map(d: Deformation) -> None:
    finest = min(d.domain.spacing)
    p = places(d, 80)
    q = reference.forward(reference.carried_out(d), d.domain, p)
    found, residual, steps = _core.inverse(d.space.map, lifted(d, q), 1e-9 * finest)
    assert (residual <= 1e-8 * finest).all()
    assert (steps >= 1).all()
    assert (steps == np.rint(steps)).all()
    # The residual is that of the points that come back.
    moved = reference.forward(reference.carried_out(d), d.domain, found[:, : d.ndim] / d.domain.spacing)
    off = np.linalg.norm((moved - q) * d.domain.spacing, axis=-1)
    np.testing.assert_allclose(off, residual, rtol=0, atol=1e-11 * (finest + np.abs(lifted(d, q)).max()))
    weakest = np.linalg.svd(reference.jacobian(reference.carried_out(d), d.domain, p), compute_uv=False)[:, -1]
    away = np.linalg.norm(found[:, : d.ndim] / d.domain.spacing - p, axis=-1)
    assert (away <= 1e-6 * (1 + 1 / weakest)).all()


@pytest.mark.parametrize("seed", range(6))
def test_an_independent_solver_finds_the_same(seed: int) -> None:
    d = deformation(np.random.default_rng(50 + seed), SHAPES[seed % 2], 4)
    q = places(d, 120)
    found = d.inverse(q)
    assert found.converged.all()
    expected = reference.inverse(reference.carried_out(d), d.domain, q)
    # Where the map is steep, points that are apart may have nearly one image.
    weakest = np.linalg.svd(reference.jacobian(reference.carried_out(d), d.domain, expected), compute_uv=False)[:, -1]
    assert (np.linalg.norm(found.points - expected, axis=-1) <= 1e-8 * (1 + 1 / weakest)).all()


ALONE = 40 + 8 + 2  # evaluations of Newton's method from where one looks, and of its polish


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("below", [0.01, 1e-6, 1e-9, 1e-12])
def test_the_continuation_takes_over_just_below_the_fold_limit(scales: int, below: float) -> None:
    """Where the map all but stands still, Newton's method creeps, and gives up; along a path it gets there."""
    domain = Domain((90, 120), 1.0, None)
    stroke = Stroke.grab((50, 40), by=((1 - below) * 20 * limit(0.4, scales), 0), radius=20, scales=scales, reach=None)
    rows, axes = numbers(pack([stroke], domain.spacing)), packed(domain)

    def on_the_line(x: Floats) -> tuple[Floats, Floats]:
        p = np.column_stack([x, np.full(len(x), 40.0), np.zeros(len(x))])
        return p, _core.forward(rows, axes, p, True)[1]

    low, high = 30.0, 110.0
    for _ in range(12):  # where the slope along the stroke is least
        x = np.linspace(low, high, 2001)
        k = int(on_the_line(x)[1][:, 0, 0].argmin())
        low, high = x[max(k - 2, 0)], x[min(k + 2, 2000)]
    away = np.concatenate([[0.0], 10 ** np.linspace(-9, 0.5, 200), -(10 ** np.linspace(-9, 0.5, 200))])
    p, slopes = on_the_line(x[k] + away)
    assert slopes[:, 0, 0].min() == pytest.approx(below, rel=0.01, abs=2e-12)
    q, _ = _core.forward(rows, axes, p, False)
    found, residual, steps = _core.inverse(_core.Map(rows, axes, 2), q, 1e-9)
    assert residual.max() < 1e-11
    assert (np.linalg.det(on_the_line(found[:, 0])[1]) > 0).all()
    assert np.abs(found - p).max() < (1e-9 if below == 0.01 else 2e-3)
    assert (steps > ALONE).any() == (below < 0.01)


def test_beyond_a_fixed_face_the_map_goes_on_as_on_the_face() -> None:
    d = Deformation((90, 120), border=20, on_fold="damp").grab((50, 30), by=(9, -17), radius=30, reach=None)
    on = np.array([[40.0, -0.5], [119.5, 44.0], [-0.5, 89.5]])
    beyond = on + np.array([[0.0, -35.0], [1e4, 0.0], [-3.0, 8.0]])
    np.testing.assert_allclose(d.forward(beyond) - beyond, d.forward(on) - on, atol=1e-8)
    assert d.forward(on[0])[1] == -0.5
    assert d.forward(on[1])[0] == 119.5
    np.testing.assert_allclose(d.jacobian(beyond[0])[:, 1], (0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(d.inverse(d.forward(beyond)).points, beyond, atol=1e-7)


@pytest.mark.parametrize("shape", [(65, 1), (1, 65), (1, 20, 30), (9, 1, 30)])
@pytest.mark.parametrize("reach", [None, 1.0, 4.0])
def test_off_the_only_plane_of_an_axis_the_map_is_as_on_it(shape: tuple[int, ...], reach: float | None) -> None:
    """Even for strokes that no border's width touches."""
    n = len(shape)
    alone = np.array(shape[::-1]) == 1
    at = np.where(alone, 0.0, (np.array(shape[::-1]) - 1) / 2.0)
    d = Deformation(shape, border=1.0, on_fold="damp").grab(
        at, by=np.where(alone, 0.0, 0.9), radius=2.5, scales=2, reach=reach
    )
    p = at + np.random.default_rng(1).uniform(-3, 3, (300, n))
    flat = np.where(alone, 0.0, p)
    strokes = reference.carried_out(d)
    np.testing.assert_allclose(d.forward(p), reference.forward(strokes, d.domain, p), atol=1e-12)
    np.testing.assert_allclose(d.forward(p) - p, d.forward(flat) - flat, atol=1e-12)
    found = d.inverse(p)
    assert found.converged.all()
    np.testing.assert_allclose(found.points, reference.inverse(strokes, d.domain, p), atol=1e-7)


def test_what_the_core_is_given_is_checked() -> None:
    d = Deformation((20, 30), border=64, on_fold="damp").grab((9, 9), by=(2, 1), radius=5, reach=None)
    rows, points = numbers(d.space.table), np.zeros((4, 3))
    with pytest.raises(TypeError):
        _core.forward(rows, d.space.axes, np.zeros((4, 2)), False)
    with pytest.raises(TypeError):
        _core.forward(rows, d.space.axes[:2], points, False)
    with pytest.raises(TypeError):
        _core.forward(np.ascontiguousarray(rows[:, 1:]), d.space.axes, points, False)
    np.testing.assert_array_equal(_core.forward(rows[:0], d.space.axes, points + 3, False)[0], points + 3)


def test_tiny_and_vast_units() -> None:
    for unit in (1e-25, 1e25):
        d = Deformation((40, 50), spacing=unit, border=9 * unit, on_fold="damp").grab(
            (20, 15), by=(4, -3), radius=9 * unit, reach=None
        )
        same = Deformation((40, 50), border=9, on_fold="damp").grab((20, 15), by=(4, -3), radius=9, reach=None)
        p = places(d, 200)
        np.testing.assert_allclose(d.forward(p), same.forward(p), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(d.inverse(p).points, same.inverse(p).points, rtol=0, atol=1e-9)
        assert d.inverse(p).converged.all()
    assert math.isfinite(d.inverse((1e6, 1e6)).residual)
