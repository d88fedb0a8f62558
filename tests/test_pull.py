"""Pulls: grabs of many handles at once."""

from __future__ import annotations

import itertools
import json
import warnings
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple import Deformation, Recipe, _core
from supple._core.rows import numbers
from supple.errors import FoldError, FoldWarning, SuppleError
from supple.folding import limits, strain
from supple.strokes import MOST_HANDLES, Stroke, pack
from tests import reference
from tests.strokes import refusal

Floats = npt.NDArray[np.float64]
SHAPES = {2: (120, 160), 3: (40, 50, 60)}


def scattered(ndim: int, count: int, apart: float, seed: int) -> Floats:
    """Points well within a shape, no two nearer than a distance."""
    rng = np.random.default_rng(seed)
    size = np.array(SHAPES[ndim][::-1])
    found: list[Floats] = []
    for _ in range(10_000):
        point = rng.uniform(0.2 * size, 0.8 * size)
        if len(found) < count and all(np.linalg.norm(point - q) >= apart for q in found):
            found.append(point)
    return np.array(found)


@pytest.mark.parametrize("ndim", [2, 3])
@pytest.mark.parametrize("border", [None, "auto"])
@pytest.mark.parametrize("reach", [None, 4.0, 2.0])
@pytest.mark.parametrize("drag", [1.0, 6.0])
def test_every_handle_arrives_and_nothing_folds(
    ndim: int, border: str | None, reach: float | None, drag: float
) -> None:
    points = scattered(ndim, 12, 9.0, seed=ndim)
    by = np.random.default_rng(7).normal(size=points.shape) * drag
    by[3:5] = 0
    d = Deformation(SHAPES[ndim], border=border).pull(points[3:], by=by[3:], pins=points[:3], radius=9, reach=reach)
    np.testing.assert_allclose(d.forward(points[3:]), points[3:] + by[3:], atol=1e-6)
    np.testing.assert_allclose(d.forward(points[:3]), points[:3], atol=1e-6)
    assert d.resolution()["margin"] >= 0.29
    places = np.random.default_rng(1).uniform(0, np.array(SHAPES[ndim][::-1]) - 1, (4000, ndim))
    determinants = np.linalg.det(d.jacobian(places))
    assert determinants.min() > 0
    back = d.inverse(d.forward(places))
    assert back.converged.all()
    np.testing.assert_allclose(back.points, places, atol=1e-5)


def test_the_displacement_is_the_sum_of_that_of_grabs() -> None:
    d = Deformation((90, 120), border=None).pull([(40, 40), (60, 50)], by=[(2, 1), (-1, 2)], radius=15)
    table = d.space.table
    assert len(table) == 2
    assert table["joined"].tolist() == [0, 1]
    domain, places = d.domain, np.random.default_rng(2).uniform(0, 89, (300, 2))
    total, slope = np.zeros((300, 2)), np.zeros((300, 2, 2))
    for row in table:
        alone = Stroke(at=tuple(row["pivot"][:2]), by=tuple(row["force"][:2]), radius=15)
        k, j = reference.displacement(alone, domain, places)
        total, slope = total + k, slope + j
    np.testing.assert_allclose(d.forward(places) - places, total, atol=1e-12)
    np.testing.assert_allclose(d.jacobian(places), np.eye(2) + slope, atol=1e-12)


@pytest.mark.parametrize("border", [None, 20.0])
@pytest.mark.parametrize("count", [3, 12])
def test_bounds_of_a_sum_hold_at_dense_points(border: float | None, count: int) -> None:
    d = Deformation((120, 160), border=border, on_fold="damp")
    points = scattered(2, count, 14.0, seed=5)
    d = d.pull(points, by=np.random.default_rng(3).normal(size=points.shape) * 1.2, radius=14)
    table, axes = d.space.table, d.domain.packed()
    lower, upper = strain.weakest(table, axes, target=0.0)
    assert lower <= upper <= lower * 0.99 < 0
    grid = reference.grid((120, 160)).reshape(-1, 2)
    jacobians = d.jacobian(grid) - np.eye(2)
    least = np.linalg.eigvalsh(0.5 * (jacobians + np.swapaxes(jacobians, 1, 2)))[:, 0].min()
    assert least >= lower
    assert least <= 0.9 * upper
    moved = np.linalg.norm(d.forward(grid) - grid, axis=1).max()
    assert moved <= strain.largest(table, axes) <= 3.1 * moved


@pytest.mark.parametrize(("ndim", "reach"), [(2, 4.0), (2, None), (3, 4.0), (3, 1.5)])
@pytest.mark.parametrize("poisson", [-np.inf, 0.2, 0.5])
def test_the_bound_of_many_is_near_what_is_found_at_points(ndim: int, reach: float | None, poisson: float) -> None:
    rng = np.random.default_rng(11)
    points = scattered(ndim, 14, 9.0, seed=3)
    handles = [Stroke(at=tuple(p), by=tuple(rng.normal(size=ndim) * 3), radius=9, reach=reach, poisson=poisson)
               for p in points]  # fmt: skip
    domain = Deformation(SHAPES[ndim]).domain
    table, axes = pack(handles, domain.spacing), domain.packed()
    table["joined"][1:] = 1
    found = strain.sampled(table, axes)
    lower, upper = strain.weakest(table, axes, target=0.0, gap=0.02)
    early, _ = strain.weakest(table, axes, target=1.5 * found, gap=0.02)
    assert 1.501 * found <= early <= lower * (1 - 1e-9)
    assert lower <= found <= 0.97 * upper
    places = rng.uniform(0, np.array(SHAPES[ndim][::-1]) - 1, (40_000, ndim))
    places = np.pad(np.concatenate([places, points + rng.normal(size=points.shape) * 3]), ((0, 0), (0, 3 - ndim)))
    _, jacobians = _core.forward(numbers(table), axes, places, True)
    strains = jacobians[:, :ndim, :ndim] - np.eye(ndim)
    assert np.linalg.eigvalsh(0.5 * (strains + np.swapaxes(strains, 1, 2)))[:, 0].min() >= lower


def test_what_cannot_arrive_is_refused_before_anything_is_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(*given: object) -> NoReturn:
        raise AssertionError("a bound was asked for")

    monkeypatch.setattr(limits, "weakest", late)
    points = np.random.default_rng(0).uniform((60, 40), (540, 360), (200, 2))
    by = np.random.default_rng(1).normal(size=points.shape) * 20
    message = refusal(lambda: Deformation((400, 600)).pull(points, by=by, radius=30))
    assert "a pull of 200 handles" in message
    assert "cannot arrive without a fold" in message


def test_two_that_meet_on_their_way_are_named() -> None:
    d = Deformation((120, 240))
    points, by = [(20, 60), (60, 60), (160, 60), (200, 90)], [(0, 9), (100, 0), (-100, 0), (0, 5)]
    message = refusal(lambda: d.pull(points, by=by, radius=20))
    assert message == (
        "a pull of 4 handles with radius 20 cannot arrive without a fold: handle 2, at (60, 60), dragged by (100, 0), "
        "and handle 3, at (160, 60), dragged by (-100, 0), meet on their straight ways; use other targets, or one "
        "stroke after the other"
    )


@pytest.mark.parametrize("on_fold", ["damp", "error"])
def test_a_pull_that_folds_is_damped_or_refused(on_fold: str) -> None:
    d = Deformation((120, 160), on_fold=on_fold)  # type: ignore[arg-type]
    given = {"points": [(60, 60), (80, 60)], "by": [(30, 0), (-30, 5)], "radius": 12.0}
    if on_fold == "error":
        with pytest.raises(FoldError, match=r"^a pull of 2 handles with radius 12 folds: at most 0\.\d"):
            d.pull(**given)  # type: ignore[arg-type]
        return
    with pytest.warns(FoldWarning, match="damped to 0"):
        d = d.pull(**given)  # type: ignore[arg-type]
    grid = reference.grid((120, 160)).reshape(-1, 2)
    assert np.linalg.det(d.jacobian(grid)).min() > 0


def test_refusals() -> None:
    d = Deformation((120, 160))
    assert "takes one of to and by, found neither" in refusal(lambda: d.pull([(1, 2)], radius=3))
    assert "takes one of to and by, found both" in refusal(lambda: d.pull([(1, 2)], by=[(1, 1)], to=[(2, 2)], radius=3))
    assert refusal(lambda: d.pull([(9, 9), (9, 8)], by=[(1, 1)], radius=3)).startswith(
        "by must be an array of shape (2, 2)"
    )
    assert refusal(lambda: d.pull([], by=[], radius=3)).startswith("points must be one point at least")
    assert refusal(lambda: d.pull([1, 2], by=[1, 2], radius=3)).startswith("points must be points of 2 or 3 numbers")
    crowd = [(x, 1) for x in range(MOST_HANDLES)]
    assert refusal(lambda: Stroke.pull(crowd, by=crowd, pins=[(9, 9)], radius=3)) == (
        "points must be at most 1000 points, pins among them, found 1001"
    )
    assert refusal(lambda: d.pull([(9, 9), (9, 9)], by=[(1, 1), (2, 1)], radius=3)) == (
        "a pull of 2 handles with radius 3 has two handles at (9, 9), 1 and 2: leave one out"
    )
    assert refusal(lambda: d.pull([(9, 9)], to=[(9, 8, 3)], radius=3)) == (
        "to must be an array of shape (1, 2), as the points are, found shape (1, 3)"
    )
    assert "also[0] point must be 2 numbers" in refusal(
        lambda: d.pull([(9, 9)], to=[(9, 8)], pins=[(1, 2, 3)], radius=3)
    )
    assert "starts or ends on the edge" in refusal(lambda: d.pull([(9, 9), (30, 9)], by=[(-20, 0), (0, 0)], radius=3))
    assert "also must be left out for a twist" in refusal(
        lambda: Stroke(brush="twist", at=(1, 2), angle=3, radius=4, also=[((1, 2), (3, 4))])  # type: ignore[arg-type]
    )
    assert refusal(lambda: Stroke(at=(1, 2), by=(1, 1), radius=4, also=[(1, 2)])).startswith("also[0]")  # type: ignore[arg-type]
    many = list(itertools.repeat(((1, 2), (3, 4)), MOST_HANDLES))
    assert "fewer than" in refusal(lambda: Stroke(at=(1, 2), by=(1, 1), radius=4, also=many))  # type: ignore[arg-type]


def test_a_recipe_keeps_them() -> None:
    d = Deformation((120, 160)).pull([(60, 60), (90, 60)], by=[(5, 0), (0, 5)], pins=[(75, 60)], radius=15)
    text = d.recipe.to_json()
    assert json.loads(text)["strokes"][0]["also"] == [[[90, 60], [0, 5]], [[75, 60], [0, 0]]]
    again = Deformation.from_recipe(Recipe.from_json(text), (120, 160))
    assert again == d
    twice = Recipe.from_json(text).fitted((320, 240))
    assert twice.strokes[0].also[0][1] == (0, 10)
    half = Deformation.from_recipe(Recipe(strokes=d.strokes, size=(160, 120), amount=0.5), (120, 160))
    np.testing.assert_allclose(
        half.forward([(60, 60), (90, 60), (75, 60)]), [(62.5, 60), (90, 62.5), (75, 60)], atol=1e-6
    )


def test_in_millimetres() -> None:
    d = Deformation(SHAPES[3], spacing=(1.0, 0.5, 3.0))
    points = np.array([(20.0, 20, 12), (40.0, 30, 20)])
    d = d.pull(points, by=[(3, 0, 1), (0, -4, 0)], radius=12)
    np.testing.assert_allclose(d.forward(points), points + np.array([(3, 0, 1), (0, -4, 0)]), atol=1e-6)


@given(st.integers(0, 10_000), st.sampled_from([None, "auto"]))
def test_any_pull_arrives_or_is_refused(seed: int, border: str | None) -> None:
    rng = np.random.default_rng(seed)
    count, radius = int(rng.integers(2, 9)), float(rng.uniform(4, 40))
    points = rng.uniform((10, 10), (149, 109), (count, 2))
    by = rng.normal(size=(count, 2)) * rng.uniform(0, 12)
    made = Deformation((120, 160), border=border)  # type: ignore[arg-type]
    with warnings.catch_warnings(action="error"):
        try:
            d = made.pull(points, by=by, radius=radius)
        except SuppleError:  # the targets of some cannot be reached
            return
    np.testing.assert_allclose(d.forward(points), points + by, atol=1e-6)
    assert np.linalg.det(d.jacobian(reference.grid((120, 160)).reshape(-1, 2))).min() > 0


def test_a_pull_of_one_is_a_grab() -> None:
    d = Deformation((120, 160))
    assert d.pull([(60, 60)], by=[(5, 0)], radius=15) == d.grab((60, 60), by=(5, 0), radius=15)
    assert pack(d.pull([(60, 60)], by=[(5, 0)], radius=15).strokes, (1, 1))["joined"].tolist() == [0]


@pytest.mark.parametrize("apart", [30, 40])
def test_handles_that_move_material_across_each_others_reach_are_in_the_map(apart: float) -> None:
    """A point outside one handle's ball in the output may come from inside it, moved there by the other."""
    pair = [(40, 40), (40 + apart, 40)]
    d = Deformation((128, 160), border=None).pull(pair, by=[(20, 10), (20, -10)], radius=20, reach=2)
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(128.0)), axis=-1)
    away = np.linalg.norm(d.inverse_map(tolerance=1e-3) - d.inverse(pixels).points, axis=-1)
    assert away.max() < 1.1e-3
    assert d.report(tolerance=1e-3).within
    picture = np.random.default_rng(1).random((128, 160))
    whole = d.warp(picture)
    for x, y, width, height in ((33, 5, 70, 90), (63, 31, 40, 60), (1, 53, 111, 60)):
        part = d.warp(picture, grid=d.grid.crop((x, y), (width, height)))
        np.testing.assert_array_equal(part, whole[y : y + height, x : x + width])


@pytest.mark.parametrize("on_fold", ["flow", "damp", "error"])
@pytest.mark.parametrize("gap", [1e-12, 1e-9, 1e-6])
def test_handles_too_close_to_tell_apart_are_refused(on_fold: Any, gap: float) -> None:
    d = Deformation((100, 100), on_fold=on_fold)
    with pytest.raises(SuppleError, match=r"cannot arrive.*handle 1, at \(50, 50\).*handle 2, at \(50, 50\)|folds"):
        d.pull([(50, 50), (50 + gap, 50)], by=[(0.01, 0), (0, 0.01)], radius=20)


def test_what_is_frozen_in_the_way_is_named() -> None:
    across = np.zeros((100, 100), np.bool_)
    across[:, 47:53] = True
    with pytest.raises(SuppleError, match="cannot arrive without a fold: what is frozen is in the way; use a larger"):
        Deformation((100, 100), freeze=across).pull([(30, 30), (50, 60)], to=[(70, 30), (52, 60)], radius=9)
    left = np.zeros((80, 80), np.bool_)
    left[:, :20] = True
    damped = Deformation((80, 80), freeze=left, on_fold="damp")
    with pytest.warns(FoldWarning, match=r"\(10, 30\), is let go, .*; a pull of 2 handles .* folds: damped to 0\.33"):
        damped.pull([(10, 30), (50, 40), (56, 40)], to=[(30, 30), (60, 40), (50, 40)], radius=9)


def test_two_handles_with_one_target_are_refused_at_once() -> None:
    grab = Stroke.grab((200, 100), to=(256, 150), radius=13).symmetric((256, 0), (1, 0))[0]
    with pytest.raises(SuppleError, match=r"has one target for two: handle 1, at .*, and handle 2, at"):
        Deformation((512, 512)).add(grab)
