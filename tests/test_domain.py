"""Domains: what they hold, how they are packed, and what they refuse."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple.space.checks import value_shown
from supple.space.domain import Domain, border_factor
from tests.strokes import refusal


def test_defaults() -> None:
    domain = Domain((512, 640))
    assert domain.shape == (512, 640)
    assert domain.spacing == (1.0, 1.0)
    assert domain.border == "auto"
    assert domain.border_widths == pytest.approx((64.0, 51.2))
    assert not domain.time
    assert domain.border_profile == "quartic"
    assert domain.ndim == 2
    assert domain.extent == (640.0, 512.0)
    assert domain.faces == ((-0.5, 639.5), (-0.5, 511.5))


def test_is_a_value() -> None:
    domain = Domain([3, 4, 5], np.array([1, 2, 3]), border=None)
    assert domain == Domain((np.int32(3), 4, 5), (1.0, 2.0, 3.0), None)
    assert hash(domain) == hash(Domain((3, 4, 5), (1, 2, 3), None))
    assert domain != Domain((3, 4, 5), (1, 2, 3))
    assert domain != Domain((3, 4, 5), (1, 2, 3), None, "sine")
    assert pickle.loads(pickle.dumps(domain)) == domain
    assert copy.deepcopy(domain) == domain
    assert all(type(n) is int for n in domain.shape)
    assert all(type(step) is float for step in domain.spacing)
    with pytest.raises(FrozenInstanceError):
        domain.border = 1.0  # type: ignore[misc]


def test_packed_image() -> None:
    packed = Domain((101, 401), (1, 2), border=60).packed()
    assert packed.dtype == np.float64
    assert packed.flags.c_contiguous
    expected = [[-0.5, 400.5, 60, 1, 0], [-1, 201, 60, 2, 0], [0, 0, -1, 1, 0]]
    np.testing.assert_array_equal(packed, expected)


def test_an_axis_of_one_sample() -> None:
    packed = Domain((1, 10)).packed()
    np.testing.assert_array_equal(packed, [[-0.5, 9.5, 1, 1, 0], [0, 0, 0, 1, 0], [0, 0, -1, 1, 0]])
    np.testing.assert_array_equal(Domain((1, 1), border=None).packed(), [[0, 0, -1, 1, 0]] * 3)
    np.testing.assert_array_equal(Domain((1, 1, 1)).packed(), [[0, 0, 0, 1, 0]] * 3)


def test_the_papers_border_ends_at_the_centres_of_the_outermost_samples() -> None:
    packed = Domain((101, 401), (1, 2), border=60, border_profile="sine").packed()
    np.testing.assert_array_equal(packed, [[0, 400, 60, 1, 1], [0, 200, 60, 2, 1], [0, 0, -1, 1, 1]])


def test_border_factors() -> None:
    t = np.array([-1, 0, 0.25, 0.5, 1, 7])
    np.testing.assert_allclose(border_factor(t, 0.0), [0, 0, 0.5 - 1 / 32 + 1 / 256, 0.8125, 1, 1], atol=1e-15)
    np.testing.assert_allclose(border_factor(t, 1.0)[1:5], np.sin([0, np.pi / 8, np.pi / 4, np.pi / 2]), atol=1e-15)
    # The quartic has two continuous derivatives where the border ends, the sine only one.
    h = 1e-4
    for profile, curvature in ((0.0, 0.0), (1.0, -((np.pi / 2) ** 2))):
        before, at, after = border_factor(np.array([1 - h, 1, 1 + h]), profile)
        assert (after - before) / h == pytest.approx(0, abs=1e-3)
        inner = border_factor(1 - 2 * h, profile)
        assert (at - 2 * before + inner) / h**2 == pytest.approx(curvature, abs=5e-3)


@given(
    st.lists(st.integers(1, 10**6), min_size=2, max_size=3),
    st.floats(1e-6, 1e6),
    st.none() | st.floats(1e-6, 1e6),
)
def test_packed_agrees_with_the_properties(shape: list[int], step: float, border: float | None) -> None:
    domain = Domain(shape, step, border)
    packed = domain.packed()
    assert tuple(map(tuple, packed[: domain.ndim, :2])) == domain.faces
    assert tuple(packed[: domain.ndim, 3]) == domain.spacing
    sigma = packed[: domain.ndim, 2]
    if border is None:
        assert (sigma == -1).all()
    else:
        assert ((sigma >= 0) & (sigma <= border) & (2 * sigma <= domain.extent)).all()


@pytest.mark.parametrize(
    "shape",
    [
        (5,), (2, 3, 4, 5), (), 5, None, "512x512", b"ab", {1: 2, 3: 4}, {3, 4}, iter((3, 4)), np.eye(2),
        np.array(5),
    ],
)  # fmt: skip
def test_refuses_shapes_of_other_kinds(shape: Any) -> None:
    assert refusal(lambda: Domain(shape)).startswith("shape must be two or three sizes")


@pytest.mark.parametrize("size", [0, -1, 2.0, True, np.True_, "3", None, float("nan"), 2**31, np.array([1, 2]), [3]])
def test_refuses_sizes(size: Any) -> None:
    message = refusal(lambda: Domain((4, size)))
    assert message.startswith("shape[1] must be an integer from 1 to 2147483647, found ")
    assert refusal(lambda: Domain((size, 4, 4))).startswith("shape[0] must be ")


BAD_LENGTHS = [0, -0.0, -1, True, np.False_, "1", float("nan"), float("inf"), -float("inf"), 1e-31, 1e31,
               10**400, Fraction(10**400), 1j, b"1"]  # fmt: skip


@pytest.mark.parametrize("bad", [*BAD_LENGTHS, None])
def test_refuses_spacings(bad: Any) -> None:
    assert refusal(lambda: Domain((4, 4), (1, bad))).startswith("spacing[1] must be a number above 0")
    assert refusal(lambda: Domain((4, 4), bad)).startswith("spacing must be ")


@pytest.mark.parametrize("spacing", [(1,), (1, 1, 1), "12", [[1, 2]], np.eye(2), {1, 2}, None])
def test_refuses_spacings_of_another_length(spacing: Any) -> None:
    assert refusal(lambda: Domain((4, 4), spacing)).startswith("spacing")
    assert refusal(lambda: Domain((4, 4), (1, 1, 1))) == (
        "spacing must be one number, or 2 of them (x first) for a shape of 2 axes, found (1, 1, 1)"
    )


@pytest.mark.parametrize("bad", [*BAD_LENGTHS, "none"])
def test_refuses_borders(bad: Any) -> None:
    message = refusal(lambda: Domain((4, 4), border=bad))
    assert message.startswith('border must be "auto", a number above 0')
    assert "None" in message


@pytest.mark.parametrize("bad", [[50], (50, 0), (50, None), (1, 2, 3, 4), [[1, 2]], (50, "auto"), np.eye(2)])
def test_refuses_borders_of_axes(bad: Any) -> None:
    assert refusal(lambda: Domain((4, 4), border=bad)).startswith("border")


def test_borders_of_axes() -> None:
    domain = Domain((41, 81, 101), (1, 1, 2), border=np.array([30, 50, 4]))
    assert domain.border == (30.0, 50.0, 4.0)
    assert domain.border_widths == (30.0, 40.5, 4.0)  # at most half of an axis
    np.testing.assert_array_equal(domain.packed()[:, 2], [30, 40.5, 4])
    assert hash(domain) == hash(Domain((41, 81, 101), (1, 1, 2), border=(30, 50, 4)))
    assert Domain((41, 81), border=(5, 5)) == Domain((41, 81), border=5)
    assert refusal(lambda: Domain((4, 4), border=(1, 2, 3))) == (
        "border must be one width, or 2 of them (x first) for a shape of 2 axes, found (1, 2, 3)"
    )


def test_time() -> None:
    assert Domain((4, 5, 6), time=True).time
    assert Domain((4, 5, 6), time=True) != Domain((4, 5, 6))
    assert refusal(lambda: Domain((5, 6), time=True)).startswith("time must be False for a shape of two axes")
    assert refusal(lambda: Domain((4, 5, 6), time=1)).startswith("time must be True or False")  # type: ignore[arg-type]


def test_messages_show_what_was_found() -> None:
    assert refusal(lambda: Domain((4, 4), border=-3)).endswith("for a free border, found -3")
    assert refusal(lambda: Domain((4, 0))).endswith("found 0")
    assert refusal(lambda: Domain((4, np.int16(-2)))).endswith("found -2")


def test_shown_is_short_and_on_one_line() -> None:
    class Rude:
        def __repr__(self) -> str:
            raise RuntimeError

    rude = [
        np.arange(10_000.0).reshape(100, 100),
        "x\n" * 1000,
        [10**999] * 99,
        [10**5000, 9],
        Rude(),
        {"a": [[[[[[[[1]]]]]]]]},
    ]
    for value in rude:
        assert len(value_shown(value)) <= 100
        assert value_shown(value).isprintable()
    assert value_shown(np.float32(0.5)) == "0.5"
