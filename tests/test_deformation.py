"""Deformations as values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from supple import Deformation, Recipe, Stroke, SuppleError

FIRST, SECOND = (Stroke(at=at, by=(3.0, 1.0), radius=9.0) for at in ((20.0, 16.0), (25.0, 20.0)))
SOLID = Stroke(at=(20.0, 16.0, 5.0), by=(0.0, 0.0, 1.0), radius=9.0)


def made() -> Deformation:
    return Deformation((40, 48), border=5, spacing=(1.0, 2.0), on_fold="damp").add(FIRST).add(SECOND)


def test_deformations_with_the_same_parts_are_equal() -> None:
    one, other = made(), made()
    assert one == other
    assert one is not other
    assert hash(one) == hash(other)
    assert len({one, other}) == 1
    recipe = Recipe(border=5, on_fold="damp", strokes=(FIRST, SECOND))
    assert one == Deformation.from_recipe(recipe, (40, 48), spacing=(1.0, 2.0))
    grabbed = one.without_strokes()
    for stroke in (FIRST, SECOND):
        grabbed = grabbed.grab(stroke.at, by=np.array(stroke.by), radius=stroke.radius)
    assert one == grabbed


@pytest.mark.parametrize(
    "other",
    [
        lambda: made().add(FIRST),
        lambda: made().without_strokes(),
        lambda: made().without_strokes().add(SECOND).add(FIRST),
        lambda: made().without_strokes().add(FIRST).grab((25, 20), by=(3, 1), radius=9, reach=None),
        lambda: Deformation((40, 49), border=5, spacing=(1.0, 2.0), on_fold="damp").add(FIRST).add(SECOND),
        lambda: Deformation((40, 48), border=6, spacing=(1.0, 2.0), on_fold="damp").add(FIRST).add(SECOND),
        lambda: Deformation((40, 48), border=None, spacing=(1.0, 2.0), on_fold="damp").add(FIRST).add(SECOND),
        lambda: Deformation((40, 48), border=5, spacing=(2.0, 1.0), on_fold="damp").add(FIRST).add(SECOND),
        lambda: Deformation((40, 48), border=5, spacing=(1.0, 2.0), on_fold="flow").add(FIRST).add(SECOND),
        lambda: (
            Deformation((40, 48), border=5, spacing=(1.0, 2.0), on_fold="damp", border_profile="sine")
            .add(FIRST)
            .add(SECOND)
        ),
    ],
)
def test_deformations_that_differ_in_a_part_are_not(other: Callable[[], Deformation]) -> None:
    assert made() != other()
    assert len({made(), other()}) == 2


def test_time_is_a_part() -> None:
    clip, solid = (Deformation((12, 40, 48), time=time).add(SOLID) for time in (True, False))
    assert clip != solid
    assert clip == Deformation((12, 40, 48), time=True).add(SOLID)


def test_others_are_never_equal() -> None:
    assert made() != made().recipe
    assert made() != (40, 48)
    assert made().__eq__(1) is NotImplemented


def test_one_arrival_is_that_of_all() -> None:
    d = Deformation((90, 120), border=None)
    assert d.arrivals == ()
    d = d.grab((40, 40), by=(20, 5), radius=12).grab((55, 45), by=(0, 18), radius=15)
    d = d.affine(np.array([[1.0, 0.1, 2.0], [0.0, 1.0, -3.0]])).twist((60, 60), angle=50, radius=20)
    assert [d.arrival(i) for i in range(3)] == list(d.arrivals)
    for arrival, stroke in zip(d.arrivals[:2], d.strokes, strict=False):
        assert arrival.miss < 1e-9
        assert arrival.moved > 1
        k = d.strokes.index(stroke)
        source = Deformation((90, 120), border=None)
        for earlier in d.strokes[: k + 1]:
            source = source.add(earlier)
        np.testing.assert_allclose(d.forward(source.inverse(arrival.arrived).points), arrival.final, atol=1e-6)
    with pytest.raises(SuppleError, match="a stroke's number must be one of 3, from 0, found 3"):
        d.arrival(3)
