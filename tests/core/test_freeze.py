"""Freeze masks in the core: what they let through, its slopes and bounds, and what stays."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from supple import Deformation, Freeze, Stroke, SuppleError, _core
from supple._core.rows import numbers
from supple.engine.core import plan_of
from supple.engine.work import mask_of
from supple.errors import FoldError, MissWarning
from supple.folding.limits import MARGIN
from supple.folding.strain import weakest
from tests import reference
from tests.core.drawn import turning
from tests.effort import examples

Floats = npt.NDArray[np.float64]
pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning", "ignore::supple.FoldWarning")


def mask_in(shape: tuple[int, ...], rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Return a ball or two that are frozen."""
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    mask = np.zeros(shape, bool)
    for _ in range(2):
        centre, radius = rng.uniform(0.2, 0.8, len(shape)) * shape, rng.uniform(0.05, 0.25) * min(shape)
        mask |= np.linalg.norm(places - centre, axis=-1) < radius
    return mask


@pytest.mark.parametrize("shape", [(40, 55), (12, 30, 41), (1, 30), (5, 1, 40)])
def test_m_is_the_spline(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    spacing = (1.0, 1.5, 0.7)[: len(shape)]
    freeze = Freeze.of(rng.uniform(size=shape) ** 4, width=9.0, spacing=spacing)
    d = Deformation(shape, spacing=spacing, freeze=freeze)
    core = mask_of(d.domain)
    assert core is not None
    points = rng.uniform(-0.2, 1.2, (500, len(shape))) * shape[::-1]
    padded = np.zeros((500, 3))
    padded[:, : len(shape)] = points * spacing
    m, slope = core.freedom(padded)
    np.testing.assert_allclose(m, reference.freedom(freeze, points), atol=1e-6)  # coefficients in float32
    for k in range(len(shape)):
        np.testing.assert_allclose(slope[:, k] * spacing[k], reference.freedom(freeze, points, k), atol=1e-6)
    samples = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)[..., ::-1].reshape(-1, len(shape))
    np.testing.assert_allclose(freeze.shown(shape).ravel(), reference.freedom(freeze, samples.astype(float)), atol=1e-5)


@pytest.mark.parametrize("shape", [(40, 55), (14, 30, 41)])
@pytest.mark.parametrize("width", [None, 4.0, 30.0])
def test_all_that_is_frozen_is_0_and_rises_within_the_width(shape: tuple[int, ...], width: float | None) -> None:
    mask = mask_in(shape, np.random.default_rng(1))
    freeze = Freeze.of(mask, width=width)
    shown = freeze.shown(shape)
    assert (shown[mask] == 0).all()
    assert freeze.share > mask.mean()
    places = np.argwhere(mask)
    wide = freeze.step[0] * 4
    for at in np.argwhere(~mask)[::97]:
        if np.abs(places - at).max(axis=1).min() > wide + 2 * freeze.step[0]:
            assert shown[tuple(at)] == pytest.approx(1)


def drawn(seed: int, *, flat: bool, on_fold: Any = "flow") -> tuple[Deformation, npt.NDArray[np.bool_]]:
    """Return a random deformation of one to three strokes with a freeze mask, and what is frozen."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(30, 90, 2).tolist()) if flat else tuple(rng.integers(12, 30, 3).tolist())
    mask = mask_in(shape, rng)
    spacing = np.exp(rng.uniform(-0.3, 0.3, len(shape)))
    freeze = Freeze.of(mask, width=float(rng.uniform(6, 25)), spacing=spacing.tolist())
    border = ("auto", None, 5.0)[rng.integers(3)]
    d = Deformation(shape, spacing=spacing.tolist(), border=border, freeze=freeze, on_fold=on_fold)
    for _ in range(rng.integers(1, 4)):
        at = rng.uniform(0.25, 0.75, len(shape)) * shape[::-1]
        radius = float(rng.uniform(4, 20))
        reach = (None, 1.5, 4.0)[rng.integers(3)]
        brush = ("grab", "grab", "twist", "scale", "pinch")[rng.integers(5)]
        if brush == "grab":
            by = rng.normal(size=len(shape)) * radius / 4
            stroke = Stroke(at=tuple(at), by=tuple(by), radius=radius, reach=reach)
        else:
            stroke = turning(rng, brush, at=at, radius=radius, reach=reach)
            stroke = stroke.weakened(0.3)
        try:
            d = d.add(stroke)
        except SuppleError as error:
            if "squeezes" not in str(error) and "cannot arrive" not in str(error):
                raise
            reject()
    return d, mask


@examples(15)
@given(st.integers(0, 2**32), st.booleans())
def test_one_stroke_is_m_times_as_much(seed: int, flat: bool) -> None:
    d, _ = drawn(seed, flat=flat)
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (60, d.ndim)) * d.shape[::-1]
    padded = np.zeros((60, 3))
    padded[:, : d.ndim] = points * d.domain.spacing
    at = padded
    for row in numbers(d.space.table):
        moved, _ = _core.forward(row[None], d.space.axes, at, False)
        inside = at[:, : d.ndim] / d.domain.spacing
        if d.domain.border is not None:
            inside = np.clip(inside, -0.5, np.array(d.shape[::-1]) - 0.5)
        assert d.domain.freeze is not None
        at = at + reference.freedom(d.domain.freeze, inside)[:, None] * (moved - at)
    np.testing.assert_allclose(d.forward(points), at[:, : d.ndim] / d.domain.spacing, atol=1e-4)


@examples(15)
@given(st.integers(0, 2**32), st.booleans())
def test_slopes_and_inverse(seed: int, flat: bool) -> None:
    d, _ = drawn(seed, flat=flat)
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.05, 0.95, (200, d.ndim)) * (np.array(d.shape[::-1]) - 1)
    step = 1e-5
    ends = [(d.forward(points + step * e) - d.forward(points - step * e)) / (2 * step) for e in np.eye(d.ndim)]
    slopes = d.jacobian(points)
    np.testing.assert_allclose(slopes, np.stack(ends, -1), atol=1e-5 * max(1.0, np.abs(slopes).max()))
    assert (np.linalg.det(slopes) > 0).all()
    found = d.inverse(points)
    assert found.converged.all()
    np.testing.assert_allclose(d.forward(found.points), points, atol=1e-8)


@examples(15)
@given(st.integers(0, 2**32), st.booleans(), st.sampled_from(["flow", "damp"]))
def test_no_row_is_below_its_margin(seed: int, flat: bool, on_fold: str) -> None:
    with warnings.catch_warnings(action="ignore"):
        d, _ = drawn(seed, flat=flat, on_fold=on_fold)
    rng = np.random.default_rng(seed)
    axes, n = d.domain.packed(), d.ndim
    for resolved in d._resolved:
        for row in resolved.rows[:2]:
            radius = float(row["radius2"][0]) ** 0.5
            near = row["pivot"] + np.exp(rng.uniform(-2, 1.5, (4000, 1))) * radius * rng.normal(size=(4000, 3))
            near = near[np.all((near >= axes[:, 0]) & (near <= axes[:, 1]) | (np.arange(3) >= n), axis=1)]
            near[:, n:] = 0
            points = np.concatenate([near, rng.uniform(*axes[:, :2].T, (4000, 3))])
            _, slopes = _core.forward(numbers(np.array([row])), axes, points, True, mask_of(d.domain))
            slopes = slopes[:, :n, :n]
            lowest = np.linalg.eigvalsh((slopes + np.swapaxes(slopes, 1, 2)) / 2)[:, 0].min()
            assert lowest >= resolved.margin - 1e-9
            assert resolved.margin >= MARGIN - 1e-9


def test_the_bound_is_close() -> None:
    """Or else strokes beside what is frozen would take many more steps than they need."""
    mask = np.zeros((80, 100), bool)
    mask[:, :30] = True
    d = Deformation((80, 100), freeze=mask, border=None).grab((60, 40), by=(3, 0), radius=20)
    axes, x = d.domain.packed(), np.linspace(0, 99, 397)
    points = np.stack([a.ravel() for a in np.meshgrid(x, np.linspace(0, 79, 159))] + [np.zeros(397 * 159)], -1)
    row = d.space.table[:1]
    _, slopes = _core.forward(numbers(row), axes, points, True, mask_of(d.domain))
    slopes = slopes[:, :2, :2]
    found = np.linalg.eigvalsh((slopes + np.swapaxes(slopes, 1, 2)) / 2)[:, 0].min() - 1
    lower, upper = weakest(row, axes, 0.0, mask=mask_of(d.domain))
    assert lower <= found <= 0.99 * lower
    assert lower <= upper <= 0.99 * lower


@examples(15)
@given(st.integers(0, 2**32), st.booleans(), st.sampled_from(["auto", "linear"]))
def test_frozen_samples_keep_every_bit(seed: int, flat: bool, filter: str) -> None:
    d, mask = drawn(seed, flat=flat)
    source = np.random.default_rng(seed).integers(0, 2**16, d.shape, np.uint16)
    out = d.warp(source, filter=filter)
    assert (out[mask] == source[mask]).all()
    here = np.argwhere(mask)[:, ::-1]
    assert (d.inverse_map()[mask] == here).all()
    report = d.report(plane=None if flat else d.shape[0] // 2)
    assert report.within


@examples(15)
@given(st.integers(0, 2**32))
def test_a_part_of_the_output_is_that_part(seed: int) -> None:
    d, _ = drawn(seed, flat=True)
    rng = np.random.default_rng(seed)
    source = rng.integers(0, 255, (*d.shape, 3), np.uint8)
    (y, x), whole = rng.integers(0, 15, 2), d.warp(source)
    grid = d.grid.crop((int(x), int(y)), (d.shape[1] - 20, d.shape[0] - 20))
    part = d.warp(source, grid=grid)
    np.testing.assert_array_equal(part, whole[y : y + part.shape[0], x : x + part.shape[1]])


def test_what_is_free_is_as_without_a_mask() -> None:
    """Bit for bit, where no stroke reaches what is frozen."""
    source = np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)
    mask = np.zeros((120, 160), bool)
    mask[:, 150:] = True
    stroke = Stroke.grab((40, 60), by=(9, 4), radius=10)
    plain = Deformation((120, 160), border=None).add(stroke)
    assert (Deformation((120, 160), border=None, freeze=mask).add(stroke).warp(source) == plain.warp(source)).all()
    free = Deformation((120, 160), border=None, freeze=np.zeros((120, 160), bool)).add(stroke)
    assert free.space.freeze is None
    assert free.space.is_plain


def test_fields_follow_what_is_frozen() -> None:
    """Through a composite map, too, strokes have the mask."""
    d, _ = drawn(5, flat=True)
    moved = d.affine([[1, 0, 3.0], [0, 1, -2.0]])
    points = np.random.default_rng(0).uniform(10, 25, (50, 2))
    spacing = np.array(d.domain.spacing)
    np.testing.assert_allclose(moved.forward(points), d.forward(points) - [3, -2] / spacing, atol=1e-9)
    found = moved.inverse(points)
    np.testing.assert_allclose(moved.forward(found.points), points, atol=1e-8)


def test_clips_have_the_mask_of_a_frame() -> None:
    mask = np.zeros((40, 50), bool)
    mask[10:20, 10:25] = True
    d = Deformation((9, 40, 50), time=True, freeze=mask).grab((22, 22, 4), by=(-6, -3, 0), radius=9)
    source = np.random.default_rng(0).integers(0, 255, (9, 40, 50), np.uint8)
    out = d.warp(source)
    assert (out[:, mask] == source[:, mask]).all()
    assert (out != source).any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.zeros((4, 5), bool), r"freeze must be an array of shape \(20, 30\), or a Freeze, found shape \(4, 5\)$"),
        (np.full((20, 30), 1.5), "freeze must be an array of values from 0 to 1"),
        (np.full((20, 30), -1), "freeze must be an array of values from 0 to"),
        (np.full((20, 30), "a"), "freeze must be an array of bool, integers or floats"),
        (Freeze.of(np.zeros((8, 9), bool)), "the freeze mask is of 9 x 8 samples, and what is deformed of 30 x 20"),
        (
            Freeze.of(np.zeros((8, 9, 9), bool), name="m.nii"),
            "^the freeze mask m.nii is a volume, and what is deformed is none: give a picture of its size$",
        ),
    ],
)
def test_bad_masks(given: Any, message: str) -> None:
    with pytest.raises(SuppleError, match=message):
        Deformation((20, 30), freeze=given)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint32, np.int64, np.uint64])
def test_whole_numbers_of_any_size(dtype: type[np.integer[Any]]) -> None:
    mask = np.zeros((40, 50), dtype)
    assert Freeze.of(mask).is_free
    mask[10:20, 10:20] = np.iinfo(dtype).max
    assert Freeze.of(mask) == Freeze.of(mask > 0)


def test_a_mask_that_does_not_vary_along_an_axis_costs_nothing_along_it() -> None:
    shape, held = (60, 240, 320), np.zeros((60, 1, 1), bool)
    held[[0, -1]] = True
    fade = replace(Freeze.of(held, width=4), samples=shape[::-1])
    for by in ((20, 10, 0), (0, 0, 6)):
        costs = []
        for freeze in (None, fade):
            d = Deformation(shape, time=True, freeze=freeze).grab((150, 120, 30), by=by, radius=40)
            assert len(d.space.rows) == 1
            costs.append(plan_of(d.space, 27, 0.01).checks[1])
            assert d.report(plane=27).within
        assert costs[1] <= 1.5 * costs[0]


def test_bad_coefficients() -> None:
    good = Freeze.of(np.zeros((20, 30), bool))
    for wrong in ({"values": b"1"}, {"size": (3, 4)}, {"step": (0, 1)}, {"first": (0,)}, {"samples": (0, 2)}):
        with pytest.raises(SuppleError, match="freeze"):
            replace(good, **wrong)


def test_painted() -> None:
    free = Freeze.of(np.zeros((90, 120), bool), width=16)
    disc = np.hypot(*np.ogrid[-40:50, -70:50][::-1]) <= 20
    frozen = free.painted((70, 40), 20, (1, 1))
    assert (frozen.shown((90, 120))[disc] == 0).all()
    assert frozen.shown((90, 120))[0, 0] == pytest.approx(1)
    assert frozen.painted((70, 40), 60, (1, 1), frozen=False) == free
    edge = free.painted((0, 0), 8, (1, 1))  # the outermost coefficients are equal
    assert (edge.shown((90, 120))[:5, :5] == 0).all()


def test_handles_arrive_beside_what_is_frozen() -> None:
    mask = np.zeros((80, 100), bool)
    mask[:, :20] = True
    d = Deformation((80, 100), freeze=mask)
    points, to, pins = [(40, 30), (70, 55)], [(34, 36), (62, 50)], [(10, 40), (50, 60)]
    pulled = d.pull(points, to=to, pins=pins, radius=12)
    np.testing.assert_allclose(pulled.forward([*points, *pins]), [*to, *pins], atol=1e-6)


@pytest.mark.parametrize("on_fold", ["flow", "damp"])
def test_handles_that_are_frozen_are_let_go(on_fold: Any) -> None:
    mask = np.zeros((80, 100), bool)
    mask[:, :20] = True
    d = Deformation((80, 100), freeze=mask, on_fold=on_fold)
    for start, end in (((10, 30), (40, 31)), ((60, 30), (12, 31))):  # one starts where it is frozen, one ends there
        said = rf"handle 1, at \({start[0]}, {start[1]}\), is let go, since nothing moves where it is frozen"
        with pytest.warns(MissWarning, match=said):
            pulled = d.pull([start, (70, 50)], to=[end, (71, 52)], radius=9)
        np.testing.assert_allclose(pulled.forward((70, 50)), (71, 52), atol=1e-6)
        arrival = pulled.arrival(0)
        assert arrival.cause == "freeze"
        np.testing.assert_allclose(arrival.arrived, pulled.forward(start), atol=1e-9)
        assert arrival.miss == pytest.approx(np.linalg.norm(pulled.forward(start) - end))
        assert (pulled.inverse_map()[mask] == np.argwhere(mask)[:, ::-1]).all()
    with pytest.warns(MissWarning, match="2 handles, handle 1, at .10, 30., for one, are let go"):
        still = d.pull([(10, 30), (10, 50)], to=[(40, 31), (30, 50)], radius=9)
    assert (still.inverse_map() == Deformation((80, 100)).inverse_map()).all()
    with pytest.raises(FoldError, match="let go"):
        Deformation((80, 100), freeze=mask, on_fold="error").pull(
            [(10, 30), (70, 50)], to=[(40, 31), (71, 52)], radius=9
        )


def test_restoring_leaves_what_is_frozen() -> None:
    mask = np.zeros((80, 100), bool)
    mask[:, :20] = True
    bent = Deformation((80, 100), freeze=mask).grab((45, 40), by=(14, 6), radius=15)
    back = bent
    for x in (35, 45, 55, 65):
        for y in (30, 40, 50):
            back = back.restore((x, y), radius=20)
    at = np.array([(50.0, 40.0), (55.0, 42.0)])
    assert np.linalg.norm(back.inverse(at).points - at, axis=1).max() < 0.6
    assert np.linalg.norm(bent.inverse(at).points - at, axis=1).min() > 5
    assert (back.inverse_map()[mask] == np.argwhere(mask)[:, ::-1]).all()
    with pytest.raises(SuppleError, match="at must be a point within the domain that is not frozen"):
        back.restore((10, 40), radius=4)
