"""Deformations as values."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from inspect import signature
from typing import Any

import numpy as np
import pytest

from supple import (
    Arrival,
    Deformation,
    FoldError,
    MissWarning,
    OutsideWarning,
    Recipe,
    Stroke,
    SuppleError,
)

FIRST, SECOND = (Stroke(at=at, by=(3.0, 1.0), radius=9.0) for at in ((20.0, 16.0), (25.0, 20.0)))
SOLID = Stroke(at=(20.0, 16.0, 5.0), by=(0.0, 0.0, 1.0), radius=9.0)


def made(shape: tuple[int, int] = (40, 48), **how: Any) -> Deformation:
    known: dict[str, Any] = {"border": 5, "spacing": (1.0, 2.0), "on_fold": "damp", **how}
    return Deformation(shape, **known).add(FIRST).add(SECOND)


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
        lambda: made((40, 49)),
        lambda: made(border=6),
        lambda: made(border=None),
        lambda: made(spacing=(2.0, 1.0)),
        lambda: made(on_fold="flow"),
        lambda: made(border_profile="sine"),
    ],
)
def test_deformations_that_differ_in_a_part_are_not(other: Callable[[], Deformation]) -> None:
    assert made() != other()
    assert len({made(), other()}) == 2


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


def test_each_handle_of_a_pull_has_an_arrival() -> None:
    mask = np.zeros((80, 100), bool)
    mask[:, :20] = True
    d = Deformation((80, 100), freeze=mask)
    points, to = [(70, 50), (10, 30), (50, 20)], [(71, 52), (40, 31), (50, 20)]
    with pytest.warns(MissWarning, match=r"handle 2, at \(10, 30\), is let go"):
        d = d.pull(points, to=to, radius=9)
    (first,) = d.arrivals
    each = (first, *first.also)
    assert [arrival.target for arrival in each] == to
    assert [arrival.cause for arrival in each] == [None, "freeze", None]
    assert each[1].arrived == (10, 30)
    assert each[1].miss == pytest.approx(math.hypot(30, 1))
    assert max(each[0].miss, each[2].miss) < 1e-6
    later = d.grab((60, 45), by=(4, 2), radius=9).affine([[1, 0, 3.0], [0, 1, -2.0]])
    for arrival, end in zip((later.arrivals[0], *later.arrivals[0].also), later.forward(points), strict=True):
        np.testing.assert_allclose(arrival.final, end, atol=1e-9)
        assert arrival.moved == pytest.approx(math.dist(arrival.arrived, arrival.final))


def test_causes_of_a_miss_are_those_of_the_docstring() -> None:
    mask = np.zeros((100, 100), bool)
    mask[:, :40] = True
    pull = Stroke.pull([(20, 50), (70, 50), (75, 50)], by=[(5, 0), (12, 0), (-10, 0)], radius=15)
    drag = Stroke.grab((20, 50), by=(5, 0), radius=10)
    for stroke, cause in ((pull, "fold and freeze"), (drag, "freeze")):
        held = Deformation((100, 100), freeze=mask, on_fold="damp").add(stroke, warn=False)
        assert held.arrivals[0].cause == cause
        assert f'"{cause}"' in " ".join((Arrival.__doc__ or "").split())
        with pytest.raises(FoldError, match=r"let go|holds it back"):
            Deformation((100, 100), freeze=mask, on_fold="error").add(stroke)


def test_a_stroke_that_reaches_nothing_is_refused() -> None:
    d = Deformation((512, 512))
    for make in (
        lambda: d.grab((600, 600), to=(300, 300), radius=20),
        lambda: d.twist((600, 600), angle=20, radius=20),
        lambda: d.add(Stroke.scale((600, 600), factor=2, radius=20)),
        lambda: Deformation.from_recipe(Recipe(strokes=(Stroke.scale((600, 600), factor=2, radius=20),)), (512, 512)),
    ):
        with pytest.raises(SuppleError, match=r"starts outside the picture, .* and reaches nothing of it"):
            make()
    with pytest.warns(OutsideWarning, match="starts outside the picture, which has 512 x 512 pixels$"):
        d.scale((530, 530), factor=2, radius=20)
    d.add(Stroke.scale((530, 530), factor=2, radius=20), warn=False)


def test_points_of_another_number_are_named() -> None:
    d = Deformation((512, 512))
    with pytest.raises(SuppleError, match=r"^a drag by .* has a point of 3 numbers, and a point of a picture has 2"):
        d.grab((1, 2, 3), to=(1, 2, 4), radius=20)
    with pytest.raises(
        SuppleError,
        match=r"^a twist by 30° at \(1, 2, 3\) with radius 9 has a point of 3 numbers, and a point of a picture has 2",
    ):
        d.twist((1, 2, 3), angle=30, radius=9)
    with pytest.raises(SuppleError, match=r"3 numbers, x, y and z \(if the last axis of \(512, 512, 3\) is colours"):
        Deformation((512, 512, 3)).twist((1, 2), angle=30, radius=9)


def test_strength_is_a_part_of_every_brush() -> None:
    d = Deformation((200, 200), border=None)
    brush: dict[str, Any] = {"radius": 20, "strength": 0.5}
    np.testing.assert_allclose(d.grab((90, 90), by=(8, 4), **brush).forward((90, 90)), (94, 92))
    np.testing.assert_allclose(d.pull([(90, 90)], by=[(8, 4)], **brush).forward((90, 90)), (94, 92))
    for part, whole in (
        (d.twist((90, 90), angle=40, **brush), d.twist((90, 90), angle=20, radius=20)),
        (d.scale((90, 90), factor=4, **brush), d.scale((90, 90), factor=2, radius=20)),
        (d.pinch((90, 90), factor=0.25, axis=(1, 1), **brush), d.pinch((90, 90), factor=0.5, axis=(1, 1), radius=20)),
    ):
        np.testing.assert_allclose(part.forward((95, 99)), whole.forward((95, 99)))
    assert d.add(Stroke.pinch((90, 90), factor=0.25, axis=(1, 1), **brush)) == part
    assert Stroke.twist((1, 2, 3), angle=5, axis=(1, 0, 0), **brush).brush == "twist"


def test_warnings_name_the_line_of_the_caller() -> None:
    outside = Stroke.scale((530, 530), factor=2, radius=20)
    damped = Stroke.grab((90, 90), by=(80, 0), radius=20)
    for warned in (
        lambda: Deformation.from_recipe(Recipe(strokes=(outside,)), (512, 512)),
        lambda: Deformation.from_recipe(Recipe(strokes=(damped,), on_fold="damp"), (512, 512)),
        lambda: Deformation((512, 512)).add(outside),
        lambda: Deformation((512, 512)).scale((530, 530), factor=2, radius=20),
        lambda: Deformation((512, 512), on_fold="damp").grab((90, 90), by=(80, 0), radius=20),
    ):
        with pytest.warns(UserWarning, match="outside|damped") as found:
            warned()
        assert [warning.filename for warning in found] == [__file__]


@pytest.mark.parametrize(
    ("domain", "by", "said"),
    [
        ({"shape": (80, 100)}, (8, 6), "ends 10 pixels short"),
        ({"shape": (60, 80, 100)}, (8, 0, 6), "ends 10 voxels short"),
        ({"shape": (60, 80, 100), "spacing": (0.8, 0.8, 2.5)}, (0, 0, 2), "ends 5 mm short"),
        ({"shape": (60, 80, 100), "time": True, "spacing": (1, 1, 3)}, (0, 0, 2), "ends 2 frames short"),
        ({"shape": (60, 80, 100), "time": True}, (3, 4, 2), "ends 5 pixels and 2 frames short"),
    ],
)
def test_how_far_a_stroke_falls_short(domain: dict[str, Any], by: tuple[float, ...], said: str) -> None:
    mask = np.ones(domain["shape"], bool)
    at = (50, 40, 30)[: len(by)]
    with pytest.warns(MissWarning, match=f"{said}: what is frozen holds it back"):
        Deformation(**domain, freeze=mask).grab(at, by=by, radius=20)


def test_a_copy_from_another_process_is_equal() -> None:
    mask = np.zeros((40, 50), bool)
    mask[:, :20] = True
    d = Deformation((40, 50), freeze=mask).grab((30, 20), by=(3, 2), radius=9)
    image = np.random.default_rng(0).integers(0, 256, (40, 50), np.uint8)
    for same in (pickle.loads(pickle.dumps(d)), copy.deepcopy(d)):
        assert same == d
        np.testing.assert_array_equal(same.warp(image), d.warp(image))


@pytest.mark.parametrize("name", ["grab", "pull", "push", "twist", "scale", "pinch"])
def test_brushes_have_the_parameters_and_the_documentation_of_their_strokes(name: str) -> None:
    own, of_stroke = getattr(Deformation((9, 9)), name), getattr(Stroke, name)
    assert list(signature(own).parameters) == list(signature(of_stroke).parameters)
    assert (own.__doc__ or "").startswith("Return the deformation with one more stroke, which ")
    assert (own.__doc__ or "").split("\n")[1:] == (of_stroke.__doc__ or "").split("\n")[1:]
