"""The lattice of T⁻¹ in a volume: T of its source points, by slow NumPy, and the certified error."""

from __future__ import annotations

import numpy as np
import pytest

import supple
from supple import _core
from supple.render.appearance import FINE, brick_counts
from supple.render.solid import COARSEST, FINEST, Solid, solve_solid, strokes_of
from supple.space.domain import BorderProfile
from tests import reference

SHAPE = (37, 50, 43)
SIZE = np.array(SHAPE[::-1])
SPACING = np.array((1.0, 0.8, 1.6))


def forward(d: supple.Deformation, points: np.ndarray) -> np.ndarray:
    """T at points in voxels, by the reference."""
    return reference.forward(reference.carried_out(d), d.domain, points)


def sources(solid: Solid, points: np.ndarray) -> np.ndarray:
    return points + solid.at(points)[0]


def bent(
    border: float | None, strength: float = 1.0, *, profile: BorderProfile = "quartic", reach: float | None = None
) -> supple.Deformation:
    d = supple.Deformation(SHAPE, border=border, border_profile=profile, spacing=SPACING, on_fold="flow")
    d = d.grab((20, 24, 18), by=(6 * strength, -4 * strength, 3 * strength), radius=12, reach=reach)
    return d.grab((30, 15, 9), by=(-2, 3, 2), radius=9, reach=reach)


def drawn(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return (rng.uniform(0, 1, (count, 3)) * (SIZE - 1)).astype(np.float32).astype(np.float64)


def off(d: supple.Deformation, points: np.ndarray, found: np.ndarray) -> np.ndarray:
    """How far sources are from T⁻¹ of the points, to first order: |M (T(p) - q)|, M by central differences of T."""
    columns = [(forward(d, found + e) - forward(d, found - e)) / 2e-4 for e in 1e-4 * np.eye(3)]
    residual = forward(d, found) - points
    return np.linalg.norm(np.linalg.solve(np.stack(columns, axis=-1), residual[..., None])[..., 0], axis=-1)


CASES = {
    "free": bent(None),
    "quartic": bent(12.0),
    "sine": bent(12.0, profile="sine"),
    "reach": bent(None, 0.5, reach=2.0),
    "reach and border": bent(12.0, reach=2.0),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("tolerance", [0.5, 0.05, 0.01])
def test_source_points_are_within_the_error(name: str, tolerance: float) -> None:
    d = CASES[name]
    solid = solve_solid(d.space, SHAPE, tolerance)
    assert solid.error <= tolerance or solid.step == FINEST
    assert solid.nodes.shape[3] == _core.NODE
    points = drawn()
    away = off(d, points, sources(solid, points))
    assert away.max() <= solid.error + 1e-4
    # The checks are no wild guess either.
    assert solid.error < 40 * away.max() + 1e-3


@pytest.mark.parametrize("name", CASES)
def test_nodes_are_solved(name: str) -> None:
    """T of a node's source is the node, and its slopes are the inverse of T's Jacobian there."""
    d = CASES[name]
    solid = solve_solid(d.space, SHAPE, 0.05)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in solid.nodes.shape[:3]), indexing="ij")[::-1], axis=-1)
    points = index.reshape(-1, 3) * float(solid.step)
    inside = (points <= SIZE - 1).all(axis=-1)
    points, nodes = points[inside], solid.nodes.reshape(-1, 4, 4)[inside].astype(np.float64)
    assert not nodes[..., 3].any()
    found = points + nodes[:, 0, :3]
    np.testing.assert_allclose(forward(d, found), points, atol=2e-5)
    within = ((found > 0.01) & (found < SIZE - 1.01)).all(axis=-1)  # at a face, T' has two sides
    for axis, e in enumerate(1e-4 * np.eye(3)):
        slope = (forward(d, found + e) - forward(d, found - e)) / 2e-4
        whole = np.einsum("nji,nj->ni", nodes[:, 1:, :3], slope)  # M T' along an axis
        np.testing.assert_allclose(whole[within], np.broadcast_to(np.eye(3)[axis], whole.shape)[within], atol=3e-3)


def test_a_finer_lattice_is_more_exact_with_the_cube() -> None:
    d = CASES["free"]
    errors = []
    points = drawn()
    for tolerance in (1e9, 0.2, 1e-9):
        solid = solve_solid(d.space, SHAPE, tolerance)
        errors.append((solid.step, off(d, points, sources(solid, points)).max()))
    assert errors[0][0] > FINEST
    assert errors[-1][0] == FINEST
    (a, coarse), (b, fine) = errors[0], errors[-1]
    assert np.log(coarse / fine) / np.log(a / b) > 2.5


def test_nothing_moves_without_strokes() -> None:
    d = supple.Deformation(SHAPE, border=64, on_fold="damp")
    solid = solve_solid(d.space, SHAPE, 0.01)
    assert solid.step == COARSEST
    assert np.abs(sources(solid, drawn()) - drawn()).max() == 0


def test_nothing_is_solved_where_no_stroke_reaches() -> None:
    d = supple.Deformation(SHAPE, border=None, on_fold="damp").grab((10, 12, 9), by=(2, 1, 0), radius=4, reach=2)
    nodes = np.empty((20, 26, 23, _core.NODE), np.float32)
    evaluations, smooth = _core.Lattice(nodes, 2).solve(strokes_of(d.space))
    index = np.stack(np.meshgrid(*(np.arange(n) for n in nodes.shape[:3]), indexing="ij")[::-1], axis=-1)
    away = np.linalg.norm(2.0 * index - (10, 12, 9), axis=-1)
    assert not nodes[away >= 8][:, :3].any()
    assert (nodes[away < 6][:, :3] != 0).any(axis=-1).all()
    # Nodes are solved some at a time.
    assert 0 < evaluations < 24 * (away < 8).sum()
    assert 2 < smooth < 4


def test_gradients_are_turned_as_the_jacobian_says() -> None:
    """∂p/∂q between nodes is the slope of the sources."""
    d = bent(None, 0.5)
    solid = solve_solid(d.space, SHAPE, 1e-9)
    points = np.clip(drawn(500), 1, SIZE - 2)
    found = sources(solid, points)
    turned = solid.at(points)[1]
    for axis, e in enumerate(1e-4 * np.eye(3)):
        slope = (forward(d, found + e) - forward(d, found - e)) / 2e-4
        whole = np.einsum("nij,nj->ni", turned, slope)
        np.testing.assert_allclose(whole, np.broadcast_to(np.eye(3)[axis], whole.shape), atol=0.03)


def test_moved_bricks_miss_nothing() -> None:
    """Every brick that shows a voxel that is seen is marked, wherever the map takes it from."""
    d = CASES["free"]
    solid = solve_solid(d.space, SHAPE, 0.05)
    fine, counts = (brick_counts(SHAPE, brick) for brick in (FINE, _core.BRICK))
    seen = np.random.default_rng(2).random(fine) > 0.997
    found = np.empty(counts, np.bool_)
    _core.brick_moved(solid.lattice, seen, FINE, 0.01, found)
    points = drawn(200_000)
    inside = np.clip(sources(solid, points), 0, SIZE - 1)
    at = tuple(np.minimum(inside // FINE, np.array(fine[::-1]) - 1).astype(int).T[::-1])
    to = tuple(np.minimum(points // _core.BRICK, np.array(counts[::-1]) - 1).astype(int).T[::-1])
    assert found[to][seen[at]].all()
    assert found.mean() < 0.5


def test_tables_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="35 columns"):
        _core.Strokes(np.zeros((2, 19)), np.zeros((3, 5)))
    with pytest.raises(ValueError, match="two nodes of 16 numbers"):
        _core.Lattice(np.zeros((1, 2, 2, 16), np.float32), 2)
