"""Functions of points in place of images: evaluated at the exact inverse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from supple import Deformation, Field, FoldWarning, OutsideWarning, SuppleError, ToleranceWarning
from tests import reference
from tests.engine.arrays import IMAGE, Floats, bent, exact

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


def ripples(points: Floats) -> Floats:
    return np.asarray(np.sin(points[:, 0] / 3) * np.cos(points[:, 1] / 5))


def test_functions_are_evaluated_at_the_exact_inverse() -> None:
    d = bent()
    expected = ripples(exact(d).reshape(-1, 2)).reshape(IMAGE)
    out = d.warp(ripples)
    assert out.dtype == np.float64
    np.testing.assert_allclose(out, expected, atol=1e-6)
    colours = d.warp(lambda p: np.stack([ripples(p), p[:, 0], p[:, 1]], axis=-1).astype(np.float32))
    assert colours.shape == (*IMAGE, 3)
    assert colours.dtype == np.float32
    np.testing.assert_allclose(colours[..., 0], expected, atol=1e-6)
    assert (d.warp(lambda p: p[:, 0] > 20) == (exact(d)[..., 0] > 20)).mean() > 0.999
    still = Deformation(IMAGE, border=64, on_fold="damp")
    np.testing.assert_array_equal(still.warp(lambda p: p), reference.grid(IMAGE))


@pytest.mark.parametrize("samples", [1, 2, 3, 8])
def test_functions_are_averaged_over_each_pixel(samples: int) -> None:
    d = Deformation((30, 40), border=64, on_fold="damp").grab((20, 15), by=(3, 4), radius=10, reach=None)
    within = (np.arange(samples) + 0.5) / samples - 0.5
    expected = np.zeros((30, 40))
    for v in within:
        for u in within:
            points = d.inverse(reference.grid((30, 40)) + np.array([u, v])).points
            expected += ripples(points.reshape(-1, 2)).reshape(30, 40) / samples**2
    np.testing.assert_allclose(d.warp(ripples, samples=samples), expected, atol=1e-9)
    given = np.full((30, 40), np.nan)
    assert d.warp(ripples, samples=samples, out=given) is given
    np.testing.assert_allclose(given, expected, atol=1e-9)


def test_functions_are_asked_for_some_points_at_once() -> None:
    asked: list[int] = []

    def count(points: Floats) -> Floats:
        asked.append(len(points))
        return points[:, 0]

    d = Deformation((100, 300), border=64, on_fold="damp").grab((150, 50), by=(9, 5), radius=40, reach=None)
    d.warp(count, samples=5)
    assert sum(asked) == 100 * 300 * 25
    assert max(asked) <= 1 << 18


WRONG: list[tuple[Callable[[Floats], Any], str]] = [
    (lambda p: p[:5, 0], "function's values"),
    (lambda p: 3.0, "function's values"),
    (lambda p: np.zeros((len(p), 2, 2)), "function's values"),
    (lambda p: p[:, 0] + 1j, "function's values"),
    (lambda p: ["a"] * len(p), "function's values"),
    (lambda p: None, "function's values"),
]


@pytest.mark.parametrize(("function", "message"), WRONG)
def test_functions_that_give_something_else(function: Callable[[Floats], Any], message: str) -> None:
    with pytest.raises(SuppleError, match=message):
        bent().warp(function)


@pytest.mark.parametrize("samples", [0, -1, 65, 1.5, True, "2", None])
def test_bad_numbers_of_samples(samples: Any) -> None:
    with pytest.raises(SuppleError, match="samples"):
        bent().warp(ripples, samples=samples)


def test_what_an_inverted_field_cannot_answer_is_warned_of() -> None:
    values = 3 * np.random.default_rng(2).normal(size=(20, 24, 2)).astype(np.float32)
    d = Deformation((20, 24))
    d = d.field(Field(values, d.grid), inverse=True)
    with pytest.warns(FoldWarning), pytest.warns(OutsideWarning), pytest.warns(ToleranceWarning):
        d.warp(lambda points: points[:, 0])
