"""Samples between voxels and their slopes, against SciPy and NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from supple import _core

SHAPE = (7, 9, 8)


def looked_at(volume: np.ndarray, points: np.ndarray) -> np.ndarray:
    out = np.empty((len(points), 4), np.float32)
    _core.look_up(volume, points.astype(np.float32), out)
    return out


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int16, np.float32])
def test_samples_are_linear_and_slopes_those_of_the_cubic_spline_whose_coefficients_are_the_voxels(dtype: Any) -> None:
    rng = np.random.default_rng(3)
    low, high = (-1e3, 1e3) if dtype is np.float32 else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    volume = rng.uniform(low, high, SHAPE).astype(dtype)
    # In the middle, at the faces and on voxels: the last of them included.
    points = rng.uniform(-0.5, 1.0, (4000, 3)) * np.array(SHAPE[::-1])
    points = np.clip(points, 0, np.array(SHAPE[::-1]) - 1)
    points[::7] = np.rint(points[::7])
    points = points.astype(np.float32).astype(np.float64)
    exact = volume.astype(np.float64)
    found = looked_at(volume, points)
    wanted = map_coordinates(exact, points.T[::-1], order=1, mode="nearest")
    scale = np.abs(exact).max()
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-5 * scale)
    padded, step = np.pad(exact, 3, mode="edge"), 1e-4
    for axis in range(3):
        after, before = points + 3, points + 3
        after[:, axis] += step
        before[:, axis] -= step
        values = [map_coordinates(padded, p.T[::-1], order=3, prefilter=False) for p in (after, before)]
        np.testing.assert_allclose(found[:, 1 + axis], (values[0] - values[1]) / (2 * step), atol=1e-5 * scale)


def test_outside_a_volume_the_nearest_sample_of_it_counts() -> None:
    volume = np.random.default_rng(4).normal(size=SHAPE).astype(np.float32)
    points = np.random.default_rng(5).uniform(-3, 12, (2000, 3))
    inside = np.clip(points, 0, np.array(SHAPE[::-1]) - 1)
    np.testing.assert_array_equal(looked_at(volume, points)[:, 0], looked_at(volume, inside)[:, 0])


def test_where_all_voxels_are_the_same_there_is_no_slope_at_all() -> None:
    # Else shading would show the direction of rounding.
    points = np.random.default_rng(5).uniform(0, 1, (2000, 3)) * (np.array(SHAPE[::-1]) - 1)
    found = looked_at(np.full(SHAPE, 0.7, np.float32), points)
    assert not found[:, 1:].any()
    assert np.ptp(found[:, 0]) == 0


def test_what_is_no_volume_of_such_numbers_is_refused() -> None:
    points, out = np.zeros((1, 3), np.float32), np.empty((1, 4), np.float32)
    with pytest.raises(TypeError, match="samples must be uint8, int8, uint16, int16 or float32"):
        _core.look_up(np.zeros(SHAPE), points, out)
