"""Samples and fill values that are NaN or infinite."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple.engine.stream import SUPPORT
from supple.errors import SuppleError

Array = npt.NDArray[Any]
SIZE = (60, 80)
TURNED = supple.Deformation(SIZE, border=None).affine([[0.9, 0.2, -7.3], [-0.2, 0.9, 5.1]])
FILTERS = ("nearest", "linear", "cubic", "auto")


def noise(*shape: int, dtype: str = "f4") -> Array:
    return np.random.default_rng(0).normal(size=shape).astype(dtype)


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("fill", [np.nan, np.inf, -np.inf, (np.nan, 0.0, np.inf)])
@pytest.mark.parametrize("clamp", [False, True])
def test_an_endless_fill_is_beyond_the_edge_alone(filter: str, fill: Any, clamp: bool) -> None:
    for dtype in ("f4", "f8"):
        source = noise(*SIZE, 3, dtype=dtype)
        made = TURNED.warp(source, filter=filter, outside="constant", fill=fill, clamp=clamp)
        edge = TURNED.warp(source, filter=filter, clamp=clamp)
        x, y = np.moveaxis(TURNED.inverse_map(), -1, 0)
        inside = (x >= 0) & (x <= 79) & (y >= 0) & (y <= 59)
        away = (x < -1) | (x > 80) | (y < -1) | (y > 60)
        assert away.sum() > 100
        np.testing.assert_array_equal(made[inside], edge[inside])
        np.testing.assert_array_equal(made[away], np.broadcast_to(fill, made[away].shape))


def test_a_border_that_does_not_move_stays_whole() -> None:
    d = supple.Deformation(SIZE).grab((40, 30), by=(6, 2), radius=8)
    for name in FILTERS:
        assert np.isfinite(d.warp(noise(*SIZE), filter=name, outside="constant", fill=np.nan)).all()


def test_of_a_volume() -> None:
    source = noise(8, 30, 40)
    d = supple.Deformation(source.shape, border=None).affine([[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0.25]])
    made = d.warp(source, outside="constant", fill=np.nan)
    assert np.isnan(made[:, :, 37:]).all()
    assert np.isfinite(made[:, :, :37]).all()


@pytest.mark.parametrize("dtype", ["u1", "i2", "u2"])
def test_integers_have_no_such_fill(dtype: str) -> None:
    for fill in (np.nan, np.inf):
        with pytest.raises(SuppleError, match=rf"fill must be finite for samples of {np.dtype(dtype)}, found"):
            TURNED.warp(np.zeros(SIZE, dtype), outside="constant", fill=fill)
    with pytest.raises(SuppleError, match="or 3 of them"):
        TURNED.warp(noise(*SIZE, 3), outside="constant", fill=(np.nan, 0))


@pytest.mark.parametrize("filter", ["linear", "cubic", "auto"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_samples_without_a_value_reach_no_further_than_their_weight(filter: str, value: float, dtype: str) -> None:
    source = noise(*SIZE, 2, dtype=dtype)
    source[30, 40, 0] = value
    made, again = (TURNED.warp(each, filter=filter) for each in (source, np.nan_to_num(source, posinf=0, neginf=0)))
    lost = ~np.isfinite(made[..., 0])
    x, y = np.moveaxis(TURNED.inverse_map(), -1, 0)
    distance = np.maximum(np.abs(x - 40), np.abs(y - 30))
    assert lost[distance < 0.5].all()
    assert not lost[distance > SUPPORT.get(filter, 2) + 0.05].any()
    np.testing.assert_array_equal(made[lost, 0], np.full(lost.sum(), value, dtype))  # no sign but its own
    np.testing.assert_array_equal(made[~lost], again[~lost])
    np.testing.assert_array_equal(made[..., 1], again[..., 1])  # nor other channels


@pytest.mark.parametrize("filter", ["linear", "cubic", "auto"])
def test_where_nothing_moves_they_stay_alone(filter: str) -> None:
    source = noise(*SIZE)
    source[5, 5], source[9, 9], source[13, 13] = np.nan, np.inf, -np.inf
    made = supple.Deformation(SIZE).affine([[1, 0, 0], [0, 1, 0]]).warp(source, filter=filter)
    np.testing.assert_array_equal(np.isfinite(made), np.isfinite(source))


def test_both_infinities_have_no_average() -> None:
    source = noise(*SIZE)
    source[30, 40], source[30, 41] = np.inf, -np.inf
    made = supple.Deformation(SIZE).affine([[1, 0, 0.5], [0, 1, 0]]).warp(source, filter="linear")
    assert [made[30, 39], made[30, 41]] == [np.inf, -np.inf]
    assert np.isnan(made[30, 40])


def test_what_overflows_is_clamped() -> None:
    source = np.zeros((40, 50), np.float16)
    source[:, ::7] = source[::5] = 65504
    made = supple.Deformation((40, 50), border=None).grab((25, 20), by=(12, 7), radius=12).warp(source, clamp=True)
    assert made.max() == 65504
