"""Brushes that twist, scale and pinch, and strokes that act at once, as the core has them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from supple import Deformation, Stroke, SuppleError, _core
from supple._core.rows import numbers
from supple.engine import core
from supple.folding.limits import resolve
from supple.folding.strain import MARGIN
from supple.space.domain import Domain
from supple.strokes import matrix_of
from tests import reference
from tests.core.drawn import lifted, places, turning
from tests.effort import examples, pairs
from tests.turns import AFFINE, at_once

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]
SHAPES = [(40, 55), (13, 30, 41)]
EACH = [(stroke, time) for n in (2, 3) for stroke in AFFINE[n] for time in ((False, True) if n == 3 else (False,))]
IDS = [f"{stroke.brush}, {'time' if time else stroke.ndim}" for stroke, time in EACH]


def flat(stroke: Stroke, time: bool) -> Stroke:
    """Return a stroke with an axis that it may have in a clip."""
    in_plane = time and stroke.brush == "pinch"
    return replace(stroke, axis=(1, 2, 0)) if in_plane else stroke


@pytest.mark.parametrize(
    ("each", "reach", "border", "profile"),
    pairs(range(len(EACH)), (None, 1.0, 3.0), (None, 1.0, 9.0), ("quartic", "sine")),
)
def test_every_option_is_the_printed_equation(
    each: int, reach: float | None, border: float | None, profile: Any
) -> None:
    stroke, time = EACH[each]
    n = stroke.ndim
    d = Deformation(
        SHAPES[n - 2], spacing=(0.8, 1.5, 2.5)[:n], border=border, border_profile=profile, time=time, on_fold="damp"
    ).add(replace(flat(stroke, time), reach=reach))
    points, strokes = places(d, 200), reference.carried_out(d)
    expected, slopes = reference.moved(strokes, d.domain, points)
    np.testing.assert_allclose(d.forward(points), expected, rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(d.jacobian(points), slopes, rtol=1e-10, atol=1e-10)
    found = d.inverse(expected)
    assert found.converged.all()
    np.testing.assert_allclose(d.forward(found.points), expected, atol=1e-6)


@pytest.mark.parametrize("on_fold", ["damp", "flow"])
@pytest.mark.parametrize("border", [None, "auto"])
@pytest.mark.parametrize(("stroke", "time"), EACH, ids=IDS)
def test_the_pivot_is_turned_exactly(stroke: Stroke, time: bool, border: Any, on_fold: Any) -> None:
    n, stroke = stroke.ndim, flat(stroke, time)
    # Near the edge, where the border holds all but a part back.
    near = replace(stroke, at=(3.0, 2.5, 1.3)[:n], radius=4.0) if on_fold == "flow" else stroke
    d = Deformation(SHAPES[n - 2], border=border, spacing=(0.8, 1.5, 2.5)[:n], time=time, on_fold=on_fold).add(near)
    assert (border is None or on_fold == "flow") or d.report().damping == (1.0,)
    steps = np.array(d.domain.spacing)
    steps[2:] *= reference.stretch(near, d.domain)  # in the stroke's own metric, in a clip
    turned = d.jacobian(near.at) * steps[:, None] / steps
    np.testing.assert_allclose(turned, np.eye(n) + matrix_of(near, steps, time=time)[:n, :n], atol=1e-9)
    np.testing.assert_allclose(d.forward(near.at), near.at, rtol=0, atol=1e-12)


def test_a_flow_turns_any_number_of_times() -> None:
    for angle in (180.0, 360.0, -1000.0):
        d = Deformation((80, 90), border=30).twist((40, 40), angle=angle, radius=12)
        assert len(d.space.table) > 2
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        np.testing.assert_allclose(d.jacobian((40, 40)), [[c, -s], [s, c]], atol=1e-9)
        points = places(d, 300)
        assert (np.linalg.det(d.jacobian(points)) > 0).all()
        np.testing.assert_allclose(d.inverse(d.forward(points)).points, points, atol=1e-5)
    d = Deformation((80, 90), border=None).scale((40, 40), factor=20, radius=12)
    np.testing.assert_allclose(d.jacobian((40, 40)), 20 * np.eye(2), atol=1e-8)


GRAB = Stroke.grab((40, 30), by=(1.5, -2.5), radius=7)


@pytest.mark.parametrize("stroke", [GRAB, *AFFINE[2], *AFFINE[3]], ids=lambda s: f"{s.brush}, {s.ndim}")
@pytest.mark.parametrize("reach", [1.0, 2.5, 4.0])
def test_outside_the_ball_points_keep_every_bit(stroke: Stroke, reach: float) -> None:
    n = stroke.ndim
    d = Deformation((60, 60, 60)[:n], border=None, on_fold="damp").add(replace(stroke, reach=reach))
    q = np.random.default_rng(3).uniform(0, 60, (4000, n))
    outside = np.linalg.norm(q - stroke.at, axis=1) >= 7 * reach
    assert 0.2 < outside.mean() < 1
    np.testing.assert_array_equal(d.forward(q)[outside], q[outside])
    np.testing.assert_array_equal(d.inverse(q).points[outside], q[outside])
    np.testing.assert_array_equal(d.jacobian(q)[outside], np.broadcast_to(np.eye(n), (int(outside.sum()), n, n)))
    assert (d.forward(q)[~outside] != q[~outside]).any(axis=1).mean() > 0.99


@pytest.mark.parametrize("stroke", AFFINE[2], ids=lambda s: s.brush)
@pytest.mark.parametrize("border", [None, 20.0])
def test_lattices_know_the_second_derivatives(stroke: Stroke, border: float | None) -> None:
    """Or else few cells would be interpolated within the tolerance."""
    d = Deformation((240, 300), border=border).add(replace(stroke, at=(150, 120), radius=50.0, reach=3.0))
    exact = d.inverse(reference.grid((240, 300))).points
    for tolerance, most in ((0.1, 0.06), (0.01, 0.1), (1e-3, 0.2)):
        report = d.report(tolerance=tolerance)
        assert report.within
        assert report.evaluations < most * max(1, len(d.space.table))
        off = np.linalg.norm(d.inverse_map(tolerance=tolerance) - exact, axis=-1)
        assert off.max() <= report.error + 3e-5


def lowest(table: npt.NDArray[np.void], domain: Domain, points: Floats) -> float:
    """Return the least λ_min(sym(∂T/∂p)) of points in physical units, over the axes along which there are points."""
    axes = domain.packed()
    _, jacobian = _core.forward(numbers(table), axes, points, True)
    used = [i for i in range(3) if axes[i, 1] > axes[i, 0]]
    matrices = jacobian[:, used][:, :, used]
    return float(np.linalg.eigvalsh((matrices + np.swapaxes(matrices, 1, 2)) / 2)[:, 0].min())


@examples(30)
@given(st.integers(0, 2**32), st.sampled_from(["damp", "flow"]), st.booleans())
def test_nothing_is_below_the_margin(seed: int, on_fold: Any, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(8, 200, 2).tolist()) if flat else tuple(rng.integers(6, 60, 3).tolist())
    n, radius = len(shape), float(np.exp(rng.uniform(1, 4)))
    domain = Domain(shape, np.exp(rng.uniform(-0.7, 0.7, n)), (None, 3.0, 20.0)[rng.integers(3)])
    at = rng.uniform(0.1, 0.9, n) * (np.array(shape[::-1]) - 1)
    brush = ("twist", "scale", "pinch")[rng.integers(3)]
    stroke = turning(rng, brush, at=at, radius=radius, reach=(None, 1.5, 4.0)[rng.integers(3)])
    try:
        resolved = resolve(stroke, domain, on_fold)
    except SuppleError as error:
        if domain.border is None or "squeezes what lies around it" not in str(error):
            raise
        reject()  # all but undoable beside a fixed border, and said
    axes = domain.packed()
    spread = np.exp(rng.uniform(-2, 1.5, (6000, 1))) * radius * rng.normal(size=(6000, 3))
    points = np.concatenate([rng.uniform(*axes[:, :2].T, (4000, 3)), resolved.rows[0]["pivot"] + spread])
    points = np.where(axes[:, 2] < 0, np.where(axes[:, 1] > axes[:, 0], points, 0.0), np.clip(points, *axes[:, :2].T))
    if _core.is_whole(numbers(resolved.rows[:1]), axes):  # a rotation of a shear
        _, jacobian = _core.forward(numbers(resolved.rows), axes, points, True)
        narrowest = float(np.linalg.svd(jacobian[:, :n, :n], compute_uv=False).min())
        assert 0 < resolved.margin <= narrowest + 1e-9
        assert resolved.alpha == len(resolved.rows) == 1
        return
    found = lowest(resolved.rows[:1], domain, points)
    assert found >= resolved.margin - 1e-9
    assert resolved.margin >= MARGIN - 1e-9
    if resolved.alpha < 1:  # as strong as can be
        assert found < 0.2


def test_damped_brushes_are_as_strong_as_can_be() -> None:
    domain = Domain((200, 200), 1.0, 60.0)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(40, 160, 481), np.linspace(40, 160, 481)))
    for stroke in (
        Stroke(brush="twist", at=(100, 100), angle=170, radius=20),
        Stroke(brush="scale", at=(100, 100), factor=9, radius=20),
        Stroke(brush="pinch", at=(100, 100), factor=0.02, radius=20),
    ):
        resolved = resolve(stroke, domain, "damp")
        assert resolved.alpha < 1
        assert resolved.margin <= lowest(resolved.rows, domain, np.stack([x, y, 0 * x], -1)) < resolved.margin + 0.02


@pytest.mark.parametrize("border", [None, 8.0])
@pytest.mark.parametrize("shape", [(60, 80), (16, 30, 40), (1, 40)])
def test_strokes_that_act_at_once(shape: tuple[int, ...], border: float | None) -> None:
    n = len(shape)
    d = Deformation(shape, border=border, spacing=(1.0, 1.2, 0.8)[:n])
    table, steps = at_once(d.domain)
    space, points = replace(d.space, rows=numbers(table)), places(d, 300)
    expected, slopes = reference.moved(steps, d.domain, points)
    one_by_one, _ = reference.moved(
        [s for step in steps for s in (step if isinstance(step, tuple) else [step])], d.domain, points
    )
    assert np.abs(one_by_one - expected).max() > 0.05
    np.testing.assert_allclose(core.forward(space, points)[0], expected, atol=1e-11)
    np.testing.assert_allclose(core.forward(space, points, matrices=True)[0], slopes, atol=1e-11)
    (found, residual, _, converged), _ = core.inverse(space, points)
    assert converged.all()
    assert residual.max() < 1e-6
    np.testing.assert_allclose(found, reference.inverse(steps, d.domain, points), atol=1e-6)
    sources, certificate = core.inverse_map(space, 0.01)
    off = sources - reference.inverse(steps, d.domain, reference.grid(shape))
    assert np.linalg.norm(off, axis=-1).max() <= certificate.error + 1e-4
    assert certificate.error <= 0.01


def test_a_group_acts_alike_in_any_order() -> None:
    d = Deformation((60, 80), border=8.0)
    table, _ = at_once(d.domain)
    other = table.copy()
    other[1:6] = table[[3, 5, 1, 4, 2]]
    other["joined"] = table["joined"]
    points = lifted(d, places(d, 200))
    ours, theirs = (_core.forward(numbers(t), d.space.axes, points, True) for t in (table, other))
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
