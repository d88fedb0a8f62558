"""T and its Jacobian: against the printed equations, central differences, and the kernels' own Python."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import reference

from supple import Deformation
from supple.cpu import field, newton, point
from supple.cpu.kernel import BATCH
from supple.strokes import pack

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

POISSONS = [-math.inf, -5.0, 0.0, 0.3, 0.5]
SHAPE = (90, 120)
VOLUME = (40, 50, 60)


def around(d: Deformation, rng: np.random.Generator, many: int = 300) -> np.ndarray:
    """Points within the domain, outside of it, on its faces and corners, and at the pivots."""
    size = np.array(d.shape[::-1]) - 1.0
    inside = rng.uniform(0, 1, (many, d.ndim)) * size
    outside = rng.uniform(-1, 2, (many, d.ndim)) * size
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=d.ndim))) * size
    faces = np.where(rng.uniform(size=(many, d.ndim)) < 0.3, rng.integers(0, 2, (many, d.ndim)) * size, inside)
    return np.concatenate([inside, outside, corners, faces, *[[s.at] for s in d.strokes]])


def close(a: np.ndarray, b: np.ndarray, scale: float = 1.0) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("poisson", POISSONS)
@pytest.mark.parametrize("border", [None, 1.0, 50.0, 500.0])
def test_forward_is_the_printed_equation(scales: int, poisson: float, border: float | None) -> None:
    d = Deformation(SHAPE, border=border)
    d = d.grab((50.5, 30), by=(8, -5), radius=25, poisson=poisson, scales=scales)
    d = d.grab((70, 61), by=(-3, 6), radius=18, poisson=poisson, scales=scales)
    points = around(d, np.random.default_rng(1))
    close(d.forward(points), reference.forward(reference.carried_out(d), d.domain, points), 200)


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("border", [None, 4.0])
def test_forward_in_a_volume_with_thick_slices(scales: int, border: float | None) -> None:
    d = Deformation(VOLUME, border=border, spacing=(0.5, 0.7, 3.0))
    d = d.grab((30, 20, 11.5), by=(4, -3, 1), radius=9, poisson=0.3, scales=scales)
    d = d.grab((33, 28, 20), by=(-2, 4, -0.5), radius=7, poisson=-5, scales=scales)
    points = around(d, np.random.default_rng(2))
    close(d.forward(points), reference.forward(reference.carried_out(d), d.domain, points), 200)


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (0.3, 4.0)])
def test_forward_of_a_sequence(spacing: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    d = Deformation(SHAPE, border=11, spacing=spacing)
    for _ in range(12):
        radius = rng.uniform(10, 60)
        d = d.grab(
            rng.uniform(0, 1, 2) * (119, 89),
            by=rng.uniform(-0.3, 0.3, 2) * radius / spacing,
            radius=radius,
            poisson=float(rng.choice(POISSONS)),
            scales=int(rng.integers(1, 4)),
        )
    points = around(d, rng)
    close(d.forward(points), reference.forward(reference.carried_out(d), d.domain, points), 1000)


def test_the_third_coordinate_of_an_image_is_zero() -> None:
    """An image moves as the middle plane of a volume whose force lies in it."""
    flat = Deformation(SHAPE, border=None).grab((50, 30), by=(9, -7), radius=30, scales=3)
    deep = Deformation((5, *SHAPE), border=None).grab((50, 30, 2), by=(9, -7, 0), radius=30, scales=3)
    p = reference.grid(SHAPE).reshape(-1, 2)
    moved = deep.forward(np.column_stack([p, np.full(len(p), 2.0)]))
    close(moved[:, :2], flat.forward(p), 100)
    close(moved[:, 2], np.full(len(p), 2.0))


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("poisson", POISSONS)
def test_at_the_pivot_it_moves_as_asked_and_nothing_turns(scales: int, poisson: float) -> None:
    d = Deformation(SHAPE, border=None).grab((50.5, 30), by=(8, -5), radius=25, poisson=poisson, scales=scales)
    close(d.forward((50.5, 30)), np.array([58.5, 25]), 100)
    close(d.jacobian((50.5, 30)), np.eye(2))


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("border", [None, 2.0, 30.0])
@pytest.mark.parametrize("ndim", [2, 3])
def test_jacobian_is_the_derivative(scales: int, border: float | None, ndim: int) -> None:
    rng = np.random.default_rng(4)
    spacing = (0.8, 1.5, 2.5)[:ndim]
    d = Deformation((SHAPE, VOLUME)[ndim - 2], border=border, spacing=spacing)
    size = np.array(d.shape[::-1]) - 1.0
    for poisson in (0.5, -3.0):
        at = rng.uniform(0.2, 0.8, ndim) * size
        d = d.grab(at, by=rng.uniform(-3, 3, ndim), radius=14, poisson=poisson, scales=scales)
    points = np.concatenate([rng.uniform(0, 1, (400, ndim)), rng.uniform(-1, 2, (400, ndim))]) * size
    points[200:400] *= rng.choice([0.01, 1.0], (200, ndim))  # near the border
    step = 1e-3
    # Differences mean nothing across the edges at which β bends.
    sigma = np.minimum(border or 1.0, np.array(d.domain.extent) / 2) / spacing
    kinks = np.stack([0 * size, sigma, size - sigma, size], axis=0)
    if border is not None:
        # The second stroke sees what the first one moved.
        first = reference.forward(reference.carried_out(d)[:1], d.domain, points)
        near = [np.abs(p[:, None] - kinks).min(axis=(1, 2)) for p in (points, first)]
        points = points[np.minimum(*near) > 4 * step]
    assert len(points) > 500
    expected = reference.differences(d.forward, points, step)
    np.testing.assert_allclose(d.jacobian(points), expected, rtol=0, atol=1e-8)


def test_beyond_a_fixed_face_the_map_goes_on_as_on_the_face() -> None:
    d = Deformation(SHAPE, border=20).grab((50, 30), by=(9, -17), radius=30)
    on = np.array([[40.0, 0.0], [119.0, 44.0], [0.0, 89.0]])
    beyond = on + np.array([[0.0, -35.0], [1e4, 0.0], [-3.0, 8.0]])
    close(d.forward(beyond) - beyond, d.forward(on) - on, 1e4)
    close(d.forward(on[2]), on[2])
    # On a face, points slide along it only.
    assert d.forward(on[0])[1] == 0
    assert d.forward(on[1])[0] == 119
    # Across the face nothing depends on how far out a point is.
    close(d.jacobian(beyond[0])[:, 1], np.array([0.0, 1.0]))


def test_an_axis_of_one_sample_does_not_move() -> None:
    d = Deformation((1, 80)).grab((30, 0), by=(10, 5), radius=20)
    points = np.array([[30.0, 0.0], [12.0, 0.0], [12.0, 3.0]])
    assert (d.forward(points)[:, 1] == points[:, 1]).all()


def test_the_compiled_kernel_does_what_its_python_does() -> None:
    """Compilers go wrong too: the same source, without one."""
    d = Deformation(VOLUME, border=6, spacing=(0.5, 0.7, 3.0))
    for scales in (1, 2, 3):
        d = d.grab((30, 20, 11.5), by=(2, -3, 0.4), radius=9, poisson=0.3, scales=scales)
    table = pack(reference.carried_out(d), d.domain.spacing)
    axes = d.domain.packed()
    rng = np.random.default_rng(5)
    start = np.ascontiguousarray((around(d, rng, 4)[:20] * d.domain.spacing).T)
    n = start.shape[1]
    fast, slow = np.zeros(field.FREE_ROWS * BATCH), np.zeros(field.FREE_ROWS * BATCH)
    for w in (fast, slow):
        field.load.py_func(w, field.X, n, start, 0)
        field.identity.py_func(w, n)
    for row in table:
        field.step(fast, n, row, axes, True)
    interpreted = ("_edge", "_profiles", "_move_with_jacobian", "faded", "profile", "displacement", "gradient")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(point, "sine", point.sine.py_func)
        for name in interpreted:
            patched.setattr(field, name, getattr(field, name).py_func)
        for row in table:
            field.step.py_func(slow, n, row, axes, True)
    used = [first + i for first in range(0, field.BETA, BATCH) for i in range(n)]
    np.testing.assert_allclose(fast[used], slow[used], rtol=1e-12, atol=1e-12)


def test_the_compiled_inverse_does_what_its_python_does() -> None:
    d = Deformation(SHAPE).grab((50, 30), by=(9, -17), radius=30)
    table, axes = pack(reference.carried_out(d), d.domain.spacing), d.domain.packed()
    targets = np.zeros((3, 5))
    targets[:2] = np.random.default_rng(6).uniform(0, 89, (2, 5))
    results = []
    for solve in (newton.inverse, newton.inverse.py_func):
        found, residual, steps = np.empty_like(targets), np.empty(5), np.zeros(5, np.int64)
        solve(table, axes, targets, found, residual, steps, 1e-9)
        results.append((found, residual, steps))
    (fast, _, fast_steps), (slow, _, slow_steps) = results
    np.testing.assert_allclose(fast, slow, rtol=1e-12)
    np.testing.assert_array_equal(fast_steps, slow_steps)


@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 4, 2), (1, 0, 2)])
def test_shapes_are_kept(shape: tuple[int, ...]) -> None:
    d = Deformation(SHAPE).grab((50, 30), by=(9, -7), radius=30)
    points = np.full(shape, 12.0)
    assert d.forward(points).shape == shape
    assert d.jacobian(points).shape == (*shape, 2)
    assert (points == 12).all()
