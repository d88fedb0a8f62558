"""Brushes of clips: a radius in time, what is not dragged stays, plateaus; on every engine, against the equations."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import supple
from supple import Deformation, Recipe, Stroke, SuppleError, _core
from supple._core.rows import numbers
from supple.engine.core import plan_of
from supple.folding.strain import limit
from supple.strokes import pack, time_radius_of
from tests import reference
from tests.core.drawn import timed
from tests.effort import examples

Floats = npt.NDArray[np.float64]

SHAPE = (40, 54, 72)
SIZE = np.array(SHAPE[::-1]) - 1.0
AT = (33.3, 25.2, 17.4)
DRAGS = {"plane": (5.0, -3.0, 0.0), "time": (0.0, 0.0, 4.0), "both": (4.0, 2.0, -3.0)}


def clip(**domain: Any) -> Deformation:
    return Deformation(SHAPE, time=True, **domain)


def points(count: int = 600, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform(-0.05, 1.05, (count, 3)) * SIZE


def strokes_of(seed: int, count: int = 3) -> list[Stroke]:
    """Return strokes of a clip of all kinds."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        at, radius, reach = rng.uniform(0.1, 0.9, 3) * SIZE, rng.uniform(5, 25), float(rng.uniform(1, 4))
        known: dict[str, Any] = {"radius": radius, "reach": reach}
        by = DRAGS[("plane", "time", "both")[rng.integers(3)]]
        flat = float(rng.choice([0.0, 0.3, 0.9]))
        kind = rng.choice(4, p=[0.55, 0.15, 0.15, 0.15])
        if kind == 0:
            stroke = Stroke.grab(at, by=by, flat=flat, scales=int(rng.integers(1, 4)), **known)
        else:
            brush, own = [
                ("twist", {"angle": 70.0, "axis": (0.2, 0, 1)}),
                ("pinch", {"factor": 0.7, "axis": (1, 2, 0)}),
                ("scale", {"factor": 1.4}),
            ][kind - 1]
            stroke = Stroke(brush=brush, at=at, **own, **known)  # type: ignore[arg-type]
        made.append(timed(rng, stroke, 1.0))
    return made


@pytest.mark.parametrize("border", [None, "auto"])
@pytest.mark.parametrize("drag", DRAGS)
@pytest.mark.parametrize("flat", [0.0, 0.5])
@pytest.mark.parametrize("frames", [None, 3.0, 30.0])
def test_what_is_not_dragged_stays_bit_for_bit(drag: str, flat: float, frames: float | None, border: Any) -> None:
    by = DRAGS[drag]
    d = clip(border=border).grab(AT, by=by, radius=20, time_radius=frames, flat=flat)
    there = points()
    moved = d.forward(there)
    for axes, stays in (([0, 1], drag == "time"), ([2], drag == "plane")):
        assert (moved[:, axes] == there[:, axes]).all() == stays
        assert (d.inverse(there).points[:, axes] == there[:, axes]).all() == stays
    assert d.arrivals[0].miss < 1e-9
    np.testing.assert_allclose(reference.differences(d.forward, there, 1e-3), d.jacobian(there), atol=1e-6)
    found = d.inverse(moved)
    assert found.converged.all()
    np.testing.assert_allclose(found.points, there, atol=1e-7)
    np.testing.assert_allclose(moved, reference.forward(reference.carried_out(d), d.domain, there), atol=1e-10)


@pytest.mark.parametrize("stroke", [Stroke.scale(AT, factor=1.5, radius=9), Stroke.pinch(AT, factor=0.6, radius=9),
                                    Stroke.twist(AT, angle=50, radius=9)])  # fmt: skip
def test_other_brushes_move_nothing_in_time(stroke: Stroke) -> None:
    there = points()
    moved = clip().add(stroke).forward(there)
    assert (moved[:, 2] == there[:, 2]).all()
    assert (moved != there).any()


def test_a_poisson_ratio_couples_all_axes_as_in_the_paper() -> None:
    there = points()
    for by in DRAGS.values():
        d = clip(border=None).grab(AT, by=by, radius=12, poisson=0.4, time_radius=12)
        volume = Deformation(SHAPE, border=None).grab(AT, by=by, radius=12)
        np.testing.assert_allclose(d.forward(there), volume.forward(there), atol=1e-12)
    alone = clip(border=None).grab(AT, by=DRAGS["plane"], radius=12, time_radius=12)
    assert not (alone.forward(there)[:, 2] != there[:, 2]).any()
    # Within the plane, the material is that of a picture.
    picture = Deformation(SHAPE[1:], border=None).grab(AT[:2], by=DRAGS["plane"][:2], radius=12)
    plane = np.concatenate([there[:, :2], np.full((len(there), 1), AT[2])], axis=1)
    np.testing.assert_allclose(alone.forward(plane)[:, :2], picture.forward(there[:, :2]), atol=1e-12)


@pytest.mark.parametrize(
    ("by", "radius", "spacing", "frames"),
    [
        ((5, 0, 0), 200, 1, 5),  # an eighth of the clip
        ((5, 0, 10), 200, 1, 10),  # the drag
        ((5, 0, -10), 200, 1, 10),
        ((5, 0, 10), 6, 1, 6),  # the radius
        ((5, 0, 10), 10, 2.5, 4),  # which is shorter in frames that are longer
        ((5, 0, 0), 20, 2.5, 5),
    ],
)
def test_the_default_is_the_drag_or_an_eighth_but_no_more_than_the_radius(
    by: Any, radius: float, spacing: float, frames: float
) -> None:
    stroke = Stroke.grab((30, 20, 15), by=by, radius=radius)
    assert time_radius_of(stroke, 40, spacing) == frames
    made = Deformation((40, 90, 120), time=True, spacing=(1, 1, spacing), border=None).add(stroke)
    other = made.without_strokes().add(replace(stroke, time_radius=frames))
    np.testing.assert_array_equal(made.space.rows, other.space.rows)
    np.testing.assert_allclose(made.space.table["stretch"], radius / (frames * spacing), rtol=1e-15)
    assert made.strokes[0].time_radius is None  # not what it is in this clip alone


def test_a_part_of_a_stroke_keeps_its_radius_in_time() -> None:
    whole = Stroke.grab(AT, by=(0, 0, 8), radius=30)
    d = Deformation.from_recipe(Recipe(strokes=[whole], amount=0.25, border=None), SHAPE, time=True)
    assert d.strokes[0].time_radius == 8
    assert d.strokes[0].by == (0, 0, 2)
    damped = Deformation(SHAPE, time=True, on_fold="damp", border=None)
    with pytest.warns(supple.FoldWarning, match="damped"):
        damped = damped.grab(AT, by=(0, 0, 30), radius=40, time_radius=5)
    np.testing.assert_allclose(damped.space.table["stretch"], 8, rtol=1e-15)


@examples(20)
@given(st.integers(0, 2**32), st.sampled_from([None, "auto", 3.0]), st.sampled_from(["damp", "flow"]))
@pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.MissWarning")
def test_any_strokes_are_one_to_one_and_their_plans_hold_every_point(seed: int, border: Any, on_fold: Any) -> None:
    d = clip(border=border, on_fold=on_fold)
    for stroke in strokes_of(seed):
        try:
            d = d.add(stroke, warn=False)
        except SuppleError:  # a pivot that is too near to the border to flow
            continue
    there = points(300, seed)
    assert (np.linalg.det(d.jacobian(there)) > 0).all()
    assert d.resolution()["margin"] > 0
    rng, z = np.random.default_rng(seed), int(np.random.default_rng(seed).integers(SHAPE[0]))
    plan = plan_of(d.space, z, 0.01)
    assert plan.checks[2] == 0
    q = np.column_stack([rng.uniform(0, 1, (400, 2)) * SIZE[:2], np.full(400, float(z))]).round()
    exact = d.inverse(q).points
    low, high = (np.array(ends) for ends in plan.extent()[:2])
    slack = plan.checks[0] + 1e-6
    assert (exact >= low - slack).all()
    assert (exact <= high + slack).all()
    # What no stroke reaches keeps every bit.
    away = ~reference.reached(reference.carried_out(d), d.domain, q)
    np.testing.assert_array_equal(exact[away], q[away])
    plan.points(whole := np.empty((*SHAPE[1:], 3)))
    shown = whole[q[:, 1].astype(int), q[:, 0].astype(int)]
    np.testing.assert_array_equal(shown[away], q[away])
    assert np.linalg.norm(shown - exact, axis=1).max() <= max(plan.checks[0], 0.01) + 1e-4


@pytest.mark.parametrize("flat", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("frames", [1.5, 6.0, 60.0])
@pytest.mark.parametrize("drag", DRAGS)
def test_the_limit_of_a_drag_is_where_it_folds(drag: str, frames: float, flat: float) -> None:
    direction = np.array(DRAGS[drag]) * (1, 1, 20 / frames)
    direction *= 20 / np.linalg.norm(direction) / (1, 1, 20 / frames)
    known: dict[str, Any] = {"radius": 20, "time_radius": frames, "flat": flat}
    d = Deformation(SHAPE, time=True, border=None, on_fold="damp")
    with pytest.warns(supple.FoldWarning):
        made = d.grab(AT, by=5 * direction, **known)
    (part,) = made.resolution()["damping"]
    near = np.random.default_rng(0).normal(0, 1, (60_000, 3)) * (22, 22, 1.1 * frames) + AT
    assert (np.linalg.det(made.jacobian(near)) > 0).all()
    # A drag along one axis folds just beyond; of others, I + sym(J) is not positive before I + J is singular.
    row = made.space.table.copy()
    row["force"] *= 1.35 if drag == "both" else 1.1
    _, jacobian = _core.forward(numbers(row), made.space.axes, near, True)
    folded = np.linalg.det(jacobian).min() < 0
    assert folded or drag == "both"
    if drag != "both":
        poisson = -math.inf if drag == "time" else 0.4
        assert 5 * part == pytest.approx(0.99 * limit(poisson, 1, 4.0, flat), rel=0.01)


def test_plateaus_move_all_within_alike_and_nothing_beyond_the_reach() -> None:
    rng = np.random.default_rng(0)
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    for shape, kind, axes in ((SHAPE[1:], {}, 2), (SHAPE, {}, 3), (SHAPE, {"time": True}, 3)):
        at, by, scale = AT[:axes], np.array((3.0, -2.0, 1.0))[:axes], np.array((1, 1, 1 / 4 if kind else 1))[:axes]
        more = {"time_radius": 2.0} if kind else {}
        d = Deformation(shape, border=None, **kind).grab(at, by=by, radius=8, flat=0.75, reach=3, **more)
        unit = way[:, :axes] / np.linalg.norm(way[:, :axes], axis=1)[:, None]
        inside = at + unit * scale * rng.uniform(0, 5.999, (500, 1))
        np.testing.assert_allclose(d.forward(inside) - inside, np.broadcast_to(by, inside.shape), atol=1e-13)
        outside = at + unit * scale * 24.0001
        np.testing.assert_array_equal(d.forward(outside), outside)
        ring = at + unit * scale * rng.uniform(6.5, 20, (500, 1))
        part = np.linalg.norm((d.forward(ring) - ring) / by, axis=1)
        assert (part > 1e-6).all()
        there = at + unit * scale * rng.uniform(0, 24, (500, 1))
        np.testing.assert_allclose(reference.differences(d.forward, there, 1e-4), d.jacobian(there), atol=1e-5)
        report = d.report() if axes == 2 else d.report(plane=17)
        assert report.within
        assert report.unconverged == 0


OLD = [
    '{"brush": "grab", "at": [30, 20, 15], "by": [6, 3, 4], "radius": 12}',
    '{"brush": "grab", "at": [30, 20, 15], "by": [6, 3, 0], "radius": 12, "scales": 2}',
    '{"brush": "grab", "at": [30, 20, 15], "by": [0, 0, 6], "radius": 12}',
    '{"brush": "pinch", "at": [30, 20, 15], "factor": 0.7, "radius": 12}',
]


@pytest.mark.parametrize("entry", OLD)
@pytest.mark.parametrize("version", [1, 2])
def test_old_recipes_are_as_long_in_time_as_in_space_and_couple_both(entry: str, version: int) -> None:
    if version == 1 and ("pinch" in entry or "scales" in entry):
        return
    recipe = Recipe.from_json(f'{{"supple": {version}, "border": null, "strokes": [{entry}]}}')
    (stroke,) = recipe.strokes
    assert stroke.isotropic
    d = Deformation.from_recipe(recipe, SHAPE, spacing=(1, 1, 2.5), time=True)
    row = d.space.table[:1]
    assert (row["stretch"][0], row["coupled"][0]) == (1, 1)
    # The rows are those of a volume, but for the material of what moves nothing in the plane, and of a pinch.
    ratio = stroke.poisson if any(stroke.by[:2]) or version == 1 else -math.inf
    volume = pack([replace(stroke, poisson=ratio)], (1, 1, 2.5))
    pivots = volume["pivot"][0], volume["p"][0], volume["r"][0]
    for found, expected in zip((row["pivot"][0], row["p"][0], row["r"][0]), pivots, strict=True):
        np.testing.assert_array_equal(found, expected)
    again = Recipe.from_json(recipe.to_json())
    assert again == recipe
    assert '"isotropic": true' in recipe.to_json()


def test_recipes_hold_the_radius_in_time_and_plateaus() -> None:
    strokes = [
        Stroke.grab((30, 20, 15), by=(6, 3, 4), radius=12, time_radius=7.5, flat=0.3),
        Stroke.twist((30, 20, 15), angle=20, radius=12),
    ]
    recipe = Recipe(strokes=strokes, size=(72, 54, 40))
    text = recipe.to_json()
    assert '"time_radius": 7.5, "flat": 0.3' in text
    assert Recipe.from_json(text) == recipe
    fitted = recipe.fitted((144, 108, 60), "stretch", time=True)
    assert fitted.strokes[0].time_radius == 7.5 * 1.5
    assert fitted.strokes[0].radius == 24


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Stroke.grab((1, 2), by=(1, 1), radius=3, time_radius=2), "left out for a stroke without time"),
        (lambda: Stroke.grab((1, 2, 3), by=(1, 1, 1), radius=3, time_radius=0), "time_radius must be a number"),
        (lambda: Deformation(SHAPE).grab(AT, by=(1, 1, 1), radius=3, time_radius=2), "and this is a volume"),
        (lambda: Stroke.grab((1, 2), by=(1, 1), radius=3, flat=0.95), "flat must be a part of the radius"),
        (lambda: Stroke.grab((1, 2), by=(1, 1), radius=3, flat=0.5, reach=None), "left out for a grab without a reach"),
        (lambda: Stroke(brush="twist", at=(1, 2), angle=9, radius=3, flat=0.5), "flat must be left out for a twist"),
        (lambda: Stroke(at=(1, 2), by=(1, 1), also=[((5, 5), (0, 0))], radius=3, flat=0.5), "left out for a pull"),
        (lambda: Stroke(at=(1, 2, 3), by=(1, 1, 1), radius=3, time_radius=3, isotropic=True), "that is isotropic"),
        (lambda: Stroke(at=(1, 2, 3), by=(1, 1, 1), radius=3, isotropic=1), "isotropic must be True or False"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(call: Any, message: str) -> None:
    with pytest.raises(SuppleError, match=message):
        call()
