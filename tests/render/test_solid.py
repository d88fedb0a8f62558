"""The lattice of T⁻¹ in a volume, as the core reads it."""

from __future__ import annotations

import numpy as np
import pytest

import supple
from supple import _core
from supple.render.appearance import FINE, brick_counts
from tests import reference

SHAPE = (37, 50, 43)
SIZE = np.array(SHAPE[::-1])


def test_moved_bricks_miss_nothing() -> None:
    """Every brick that shows a voxel that is seen is marked, wherever the map takes it from."""
    d = supple.Deformation(SHAPE, border=None, spacing=(1.0, 0.8, 1.6), on_fold="flow")
    d = d.grab((20, 24, 18), by=(6, -4, 3), radius=12).grab((30, 15, 9), by=(-2, 3, 2), radius=9)
    step, strokes = 4, reference.carried_out(d)
    places = step * reference.grid([-(-(n - 1) // step) + 1 for n in SHAPE])
    nodes = np.zeros((*places.shape[:3], 4, 4), np.float32)
    found = reference.inverse(strokes, d.domain, places)
    nodes[..., 0, :3] = found - places
    nodes[..., 1:, :3] = np.moveaxis(reference.matrices(strokes, d.domain, found), -1, -2)
    fine, counts = (brick_counts(SHAPE, brick) for brick in (FINE, _core.BRICK))
    rng = np.random.default_rng(2)
    seen, moved = rng.random(fine) > 0.997, np.empty(counts, np.bool_)
    _core.brick_moved(nodes.reshape(*places.shape[:3], 16), step, seen, FINE, 0.05, moved)
    points = rng.uniform(0, 1, (200_000, 3)) * (SIZE - 1)
    sources = np.clip(d.inverse(points).points, 0, SIZE - 1)
    at = tuple(np.minimum(sources // FINE, np.array(fine[::-1]) - 1).astype(int).T[::-1])
    to = tuple(np.minimum(points // _core.BRICK, np.array(counts[::-1]) - 1).astype(int).T[::-1])
    assert moved[to][seen[at]].all()
    assert moved.mean() < 0.5


def test_tables_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="39 columns"):
        _core.Strokes(np.zeros((2, 19)), np.zeros((3, 5)))
    empty = np.zeros((1, 1, 1), np.bool_)
    with pytest.raises(ValueError, match="two nodes of 16 numbers"):
        _core.brick_moved(np.zeros((1, 2, 2, 16), np.float32), 2, empty, 2, 0.1, empty)
