"""The lattice of T⁻¹ in a volume, against Newton's method at points."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

import supple
from supple.cpu import bricks
from supple.cpu.solid import COARSEST, FIELDS, FINEST, Solid, displacement, solve_solid, transposed

SHAPE = (37, 50, 43)


@njit
def displacements(nodes, per_voxel, points, out):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        x, y, z = points[i]
        out[i, 0], out[i, 1], out[i, 2] = displacement(nodes, per_voxel, x, y, z)


@njit
def turned(nodes, per_voxel, points, forces, out):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        x, y, z = points[i]
        a, b, c = forces[i]
        out[i, 0], out[i, 1], out[i, 2] = transposed(nodes, per_voxel, x, y, z, a, b, c)


def sources(solid: Solid, points: np.ndarray) -> np.ndarray:
    given = points.astype(np.float32)
    out = np.empty_like(given)
    displacements(solid.nodes, np.float32(1 / solid.step), given, out)
    return points + out


def bent(border: float | None, strength: float = 1.0) -> supple.Deformation:
    d = supple.Deformation(SHAPE, border=border, spacing=(1.0, 0.8, 1.6), on_fold="flow")
    d = d.grab((20, 24, 18), by=(6 * strength, -4 * strength, 3 * strength), radius=12)
    return d.grab((30, 15, 9), by=(-2, 3, 2), radius=9)


def drawn(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(0, 1, (count, 3)) * (np.array(SHAPE[::-1]) - 1)


@pytest.mark.parametrize("border", [None, 12.0])
@pytest.mark.parametrize("tolerance", [0.5, 0.05, 0.01])
def test_source_points_are_within_the_error(border: float | None, tolerance: float) -> None:
    d = bent(border)
    solid = solve_solid(d.space.table, d.space.axes, SHAPE, tolerance)
    assert solid.error <= tolerance or solid.step == FINEST
    assert solid.nodes.shape[3] == FIELDS
    points = drawn()
    off = np.linalg.norm(sources(solid, points) - d.inverse(points).points, axis=1)
    assert off.max() <= solid.error + 1e-4
    # The checks are no wild guess either.
    assert solid.error < 40 * off.max() + 1e-3


def test_a_finer_lattice_is_more_exact_with_the_cube() -> None:
    d = bent(None)
    errors = []
    points = drawn()
    truth = d.inverse(points).points
    for tolerance in (1e9, 0.2, 1e-9):
        solid = solve_solid(d.space.table, d.space.axes, SHAPE, tolerance)
        errors.append((solid.step, np.abs(sources(solid, points) - truth).max()))
    assert errors[0][0] > FINEST
    assert errors[-1][0] == FINEST
    (a, coarse), (b, fine) = errors[0], errors[-1]
    assert np.log(coarse / fine) / np.log(a / b) > 2.5


def test_nothing_moves_without_strokes() -> None:
    d = supple.Deformation(SHAPE)
    solid = solve_solid(d.space.table, d.space.axes, SHAPE, 0.01)
    assert solid.step == COARSEST
    assert np.abs(sources(solid, drawn()) - drawn()).max() == 0


def test_gradients_are_turned_as_the_jacobian_says() -> None:
    d = bent(None, 0.5)
    solid = solve_solid(d.space.table, d.space.axes, SHAPE, 1e-9)
    points = drawn(500)
    forces = np.random.default_rng(1).normal(size=(500, 3))
    out = np.empty((500, 3), np.float32)
    turned(solid.nodes, np.float32(1 / solid.step), points.astype(np.float32), forces.astype(np.float32), out)
    inverse = np.linalg.inv(d.jacobian(d.inverse(points).points))
    np.testing.assert_allclose(out, np.einsum("nji,nj->ni", inverse, forces), atol=0.03)


def test_moved_bricks_miss_nothing() -> None:
    """Every brick that shows a voxel that is seen is marked, wherever the map takes it from."""
    d = bent(None)
    solid = solve_solid(d.space.table, d.space.axes, SHAPE, 0.05)
    fine, counts = (tuple(-(-(n - 1) // brick) for n in SHAPE) for brick in (bricks.FINE, bricks.BRICK))
    seen = np.random.default_rng(2).random(fine) > 0.997
    found = np.empty(counts, np.bool_)
    bricks.moved(seen, bricks.FINE, solid.nodes, 1 / solid.step, np.array(SHAPE[::-1]), found)
    points = drawn(200_000)
    inside = np.clip(sources(solid, points), 0, np.array(SHAPE[::-1]) - 1)
    at = tuple(np.minimum(inside // bricks.FINE, np.array(fine[::-1]) - 1).astype(int).T[::-1])
    to = tuple(np.minimum(points // bricks.BRICK, np.array(counts[::-1]) - 1).astype(int).T[::-1])
    assert found[to][seen[at]].all()
    assert found.mean() < 0.5
