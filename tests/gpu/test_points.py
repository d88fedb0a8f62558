"""T and T⁻¹ of points by the shaders that draw, against the slow reference: borders, reaches, brushes, masks."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import Freeze
from supple.errors import FoldWarning
from supple.gpu import field
from supple.gpu.device import Gpu
from supple.strokes import pack
from tests import reference
from tests.gpu import points as shaders
from tests.gpu.scenes import ball, frozen, turned
from tests.test_clip_brushes import SHAPE, strokes_of
from tests.turns import at_once

pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning", "ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]


def grabs(
    shape: tuple[int, ...], seed: int, count: int = 3, spacing: Any = 1.0, border: float | None = 20.0, **rest: Any
) -> supple.Deformation:
    """Return some grabs of all kinds; ``rest`` are the border's profile, and the least reach of a stroke."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    reach = rest.pop("reach", None)
    d = supple.Deformation(shape, border=border, spacing=spacing, **{"on_fold": "damp", **rest})
    for _ in range(count):
        with warnings.catch_warnings(action="ignore", category=FoldWarning):
            d = d.grab(
                rng.uniform(0.2, 0.8, len(shape)) * size,
                by=rng.normal(0, 0.06, len(shape)) * size,
                radius=float(rng.uniform(0.1, 0.3) * size.min()),
                scales=int(rng.integers(1, 4)),
                poisson=float(rng.uniform(0, 0.5)),
                reach=None if reach is None else reach + float(rng.uniform(0, 2)),
            )
    return d


def columns(d: supple.Deformation, points: Floats) -> tuple[Floats, Floats]:
    """Return points as anchors, which are whole pixels, and what is left of them, in physical units."""
    out = np.zeros((2, len(points), 3))
    whole = np.rint(points)
    for k, part in enumerate((whole, points - whole)):
        out[k, :, : d.ndim] = part * d.domain.spacing
    return out[0], out[1]


SIZES = [((80, 120), 1.0), ((30, 40, 50), (1.0, 0.7, 2.1))]
CLIP = (9, 60, 80)  # in time
WAYS: list[dict[str, Any]] = [
    {"border": None},
    {"border": 12.0},
    {"border": 12.0, "border_profile": "sine"},
    {"border": None, "reach": 1.0},
    {"border": 12.0, "reach": 1.5},
]


def of_clip(seed: int, border: float | None) -> supple.Deformation:
    """Return brushes of all kinds in a clip."""
    d = supple.Deformation(SHAPE, time=True, border=border, on_fold="damp")
    for stroke in strokes_of(seed):
        d = d.add(stroke, warn=False)
    return d


def twisted(shape: tuple[int, ...], angle: float) -> supple.Deformation:
    """Return a twist of several turns."""
    kind: dict[str, Any] = {} if len(shape) == 2 else {"axis": (1, -2, 0.5)}
    return supple.Deformation(shape, border=None).twist(0.5 * np.array(shape[::-1]), angle=angle, radius=8, **kind)


MADE = [
    *(partial(grabs, shape, 1, 4, spacing, **way) for shape, spacing in [*SIZES, (CLIP, 1.0)] for way in WAYS),
    *(partial(turned, shape, spacing=spacing, border=border) for shape, spacing in SIZES for border in (None, 9.0)),
    *(partial(of_clip, seed, border) for seed in range(6) for border in (None, 9.0)),
    *(partial(twisted, shape, angle) for shape in ((60, 80), (20, 30, 40)) for angle in (180, -720)),
]


@pytest.mark.parametrize("make", MADE)
def test_points_move_and_are_sent_back(gpu: Gpu, make: Callable[[], supple.Deformation]) -> None:
    d = make()
    strokes, n, steps = reference.carried_out(d), d.ndim, np.array(d.domain.spacing)
    points = np.random.default_rng(2).uniform(-0.1, 1.1, (600, n)) * np.array(d.shape[::-1])
    anchors, offsets = columns(d, points)
    moved, jacobian = shaders.forward(gpu, d.space.table, d.space.axes, anchors, offsets)
    np.testing.assert_allclose(
        (anchors + moved)[:, :n] / steps, reference.forward(strokes, d.domain, points), atol=1e-3
    )
    scaled = jacobian[:, :n, :n] * (steps[None, :] / steps[:, None])
    np.testing.assert_allclose(scaled, reference.jacobian(strokes, d.domain, points), atol=1e-3)
    outside = ~reference.reached(strokes, d.domain, points)
    np.testing.assert_array_equal(moved[outside], offsets[outside].astype(np.float32))
    np.testing.assert_array_equal(jacobian[outside, :n, :n], np.broadcast_to(np.eye(n), (int(outside.sum()), n, n)))
    targets = np.rint(points[:300])
    anchors, _ = columns(d, targets)
    shift, residual, evaluations = shaders.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    found = (anchors + shift)[:, :n] / steps
    np.testing.assert_allclose(reference.forward(strokes, d.domain, found), targets, atol=2e-3)
    np.testing.assert_allclose(found, d.inverse(targets).points, atol=5e-3)
    assert residual.max() < 5e-3
    assert evaluations.max() < 200


@pytest.mark.parametrize("border", [None, 9.0])
@pytest.mark.parametrize("shape", [(60, 80), (20, 30, 40)])
def test_strokes_that_act_at_once(gpu: Gpu, shape: tuple[int, ...], border: float | None) -> None:
    d = supple.Deformation(shape, border=border)
    table, steps = at_once(d.domain)
    n, points = len(shape), np.random.default_rng(2).uniform(-0.1, 1.1, (500, len(shape))) * shape[::-1]
    anchors = np.pad(points, ((0, 0), (0, 3 - n)))
    expected, slopes = reference.moved(steps, d.domain, points)
    moved, jacobian = shaders.forward(gpu, table, d.space.axes, anchors, np.zeros_like(anchors))
    np.testing.assert_allclose((anchors + moved)[:, :n], expected, atol=1e-4)
    np.testing.assert_allclose(jacobian[:, :n, :n], slopes, atol=1e-4)
    shift, residual, _ = shaders.inverse(gpu, table, d.space.axes, anchors, 1e-4)
    np.testing.assert_allclose((anchors + shift)[:, :n], reference.inverse(steps, d.domain, points), atol=1e-3)
    assert residual.max() < 1e-3


@pytest.mark.parametrize("border", [None, 6.0])
@pytest.mark.parametrize(("shape", "spacing"), [*SIZES, ((1, 90), 1.0), ((20, 1, 40), 1.0)])
def test_what_is_frozen(gpu: Gpu, shape: tuple[int, ...], spacing: Any, border: float | None) -> None:
    if 1 in shape:
        size = np.array(shape[::-1]) - 1.0
        mask = Freeze.of(ball(shape, 0.35, 6), width=7.0)
        d = supple.Deformation(shape, border=border, freeze=mask)
        d = d.grab(0.55 * size, by=-0.06 * size, radius=12)
    else:
        d = frozen(shape, spacing, border=border)
    space, steps = d.space, np.array(d.domain.spacing)
    points = np.random.default_rng(1).uniform(-0.1, 1.1, (900, d.ndim)) * shape[::-1]
    # Except on a face, where the slope jumps.
    points = points[(np.abs(points - np.array(shape[::-1]) + 0.5) > 1e-3).all(axis=1)]
    anchors = sum(columns(d, points))
    moved, jacobian = shaders.forward(gpu, space.table, space.axes, anchors, np.zeros_like(anchors), space.freeze)
    np.testing.assert_allclose((anchors + moved)[:, : d.ndim] / steps, d.forward(points), atol=1e-4)
    slopes = jacobian[:, : d.ndim, : d.ndim] * (steps[None, :] / steps[:, None])
    np.testing.assert_allclose(slopes, reference.jacobian(reference.carried_out(d), d.domain, points), atol=1e-3)
    shift, residual, _ = shaders.inverse(gpu, space.table, space.axes, anchors, 1e-4, space.freeze)
    np.testing.assert_allclose((anchors + shift)[:, : d.ndim] / steps, d.inverse(points).points, atol=2e-3)
    assert residual.max() < 2e-3


@pytest.mark.parametrize("kind", ["flat", "border", "frozen", "volume"])
def test_the_jacobian_is_that_of_the_shader_s_own_map(gpu: Gpu, kind: str) -> None:
    """By central differences, but for kinks of the border."""
    d = {
        "flat": lambda: grabs((80, 120), 1, 4, border=None),
        "border": lambda: turned((80, 120), border=12.0, border_profile="sine"),
        "frozen": lambda: frozen((80, 120)),
        "volume": lambda: turned((30, 40, 50), spacing=(1.0, 0.7, 2.1)),
    }[kind]()
    steps, n, space = np.array(d.domain.spacing), d.ndim, d.space
    points = np.random.default_rng(2).uniform(0.02, 0.98, (800, n)) * (np.array(d.shape[::-1]) - 1)
    anchors, offsets = columns(d, points)
    _, jacobian = shaders.forward(gpu, space.table, space.axes, anchors, offsets, space.freeze)
    h, apart = 0.05, []
    for axis in range(n):
        off = np.zeros_like(offsets)
        off[:, axis] = h * steps[axis]
        ends = [
            shaders.forward(gpu, space.table, space.axes, anchors, o, space.freeze)[0]
            for o in (offsets + off, offsets - off)
        ]
        slope = (ends[0] - ends[1])[:, :n] / (2 * h * steps[axis])
        apart.append(np.abs(slope - jacobian[:, :n, axis]).max(axis=1))
    assert np.quantile(np.max(apart, axis=0), 0.97) < 2e-3
    assert np.abs(jacobian - np.eye(3)).max() > 0.1


def test_far_from_the_origin_it_is_as_exact(gpu: Gpu) -> None:
    # A picture of 16k pixels a side, where float32 holds coordinates to a thousandth of a pixel only.
    d = supple.Deformation((16384, 16384), border=64, on_fold="damp").grab(
        (15900.3, 16001.7), by=(60.5, -40.25), radius=120, reach=None
    )
    targets = np.rint(np.random.default_rng(0).uniform(15500, 16383, (4000, 2)))
    anchors, _ = columns(d, targets)
    shift, _, _ = shaders.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    off = reference.forward(d.strokes, d.domain, (anchors + shift.astype(np.float64))[:, :2]) - targets
    assert np.linalg.norm(off, axis=1).max() < 0.01
    shape = (60, 16000)
    mask = np.zeros(shape, bool)
    mask[10:50, 15000:15400] = True
    d = supple.Deformation(shape, freeze=Freeze.of(mask, width=4.4)).grab((15415, 30), by=(-0.5, 0.2), radius=60)
    points = np.random.default_rng(0).uniform((15390, 5), (15410, 55), (500, 2))
    anchors, offsets = columns(d, points)
    moved, _ = shaders.forward(gpu, d.space.table, d.space.axes, anchors, offsets, d.space.freeze)
    np.testing.assert_allclose((anchors + moved)[:, :2], d.forward(points), atol=2e-5)
    assert np.abs(d.forward(points) - points).max() > 0.2


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e6])
def test_float32_holds_brushes_of_any_size(gpu: Gpu, radius: float) -> None:
    d = supple.Deformation((40, 50), spacing=radius / 10, border=None).twist((25, 20), angle=40, radius=radius)
    assert field.fits(d.space.table)
    points = np.random.default_rng(3).uniform(0, 40, (200, 2))
    anchors = np.pad(points * radius / 10, ((0, 0), (0, 1)))
    moved, _ = shaders.forward(gpu, d.space.table, d.space.axes, anchors, np.zeros_like(anchors))
    np.testing.assert_allclose((anchors + moved)[:, :2] / (radius / 10), d.forward(points), atol=1e-4)


def test_loops_that_are_ended_are_noticed(gpu: Gpu) -> None:
    """Drivers in software end loops of too many turns, and say nothing."""
    if not gpu.software:
        pytest.skip("a GPU carries out all of them")
    d = grabs((40, 50), 1)
    _, residual, _ = shaders.inverse(gpu, d.space.table, d.space.axes, np.zeros((9, 3)), 1e-3, turns=1 << 20)
    assert residual.min() > 1e29


def test_what_is_compiled_for_grabs_is_for_them_alone() -> None:
    d = supple.Deformation((40, 50)).grab((20, 20), by=(1, 0), radius=9)
    assert field.constants(d.space.table, None) == {"GRABS": 1, "FROZEN": 0}
    assert field.constants(d.twist((20, 20), angle=9, radius=9).space.table, None)["GRABS"] == 0
    both = pack(d.strokes * 2, (1.0, 1.0))
    both["joined"][1] = 1
    assert field.constants(both, None)["GRABS"] == 0
