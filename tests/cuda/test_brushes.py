"""Brushes that twist, scale and pinch, and strokes that act at once, on a GPU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import supple
from supple._core.rows import numbers
from supple.cuda import points
from supple.engine.work import Space
from tests import reference
from tests.cuda.driver import on_host, sent
from tests.test_clip_brushes import strokes_of
from tests.turns import AFFINE, at_once

pytestmark = [pytest.mark.filterwarnings("ignore::supple.FoldWarning"), pytest.mark.usefixtures("gpu")]


@pytest.mark.parametrize("border", [None, 3.0])
@pytest.mark.parametrize("shape", [(13, 16), (5, 9, 10)])
def test_points(shape: tuple[int, ...], border: float | None) -> None:
    d = supple.Deformation(shape, border=border, spacing=(1.0, 0.8, 1.3)[: len(shape)], on_fold="damp")
    for stroke in AFFINE[len(shape)]:
        d = d.add(replace(stroke, at=0.45 * (np.array(shape[::-1]) - 1), radius=4.0))
    _agrees(d.space, reference.carried_out(d), d)


@pytest.mark.parametrize("shape", [(13, 16), (5, 9, 10)])
def test_strokes_that_act_at_once(shape: tuple[int, ...]) -> None:
    d = supple.Deformation(shape, border=3.0)
    table, steps = at_once(d.domain)
    _agrees(replace(d.space, rows=numbers(table)), steps, d)


@pytest.mark.parametrize("seed", range(4))
def test_brushes_of_clips(seed: int) -> None:
    shape = (12, 18, 24)
    d = supple.Deformation(shape, time=True, on_fold="damp")
    for stroke in strokes_of(seed):
        own = None if stroke.time_radius is None else stroke.time_radius / 3
        small = stroke.mapped(lambda p: tuple(x / 3 for x in p), lambda v: tuple(x / 3 for x in v))
        d = d.add(replace(small, radius=stroke.radius / 3, time_radius=own), warn=False)
    _agrees(d.space, reference.carried_out(d), d)
    frames = np.random.default_rng(0).uniform(0, 1, shape).astype(np.float32)
    made = on_host(d.warp(sent(frames), filter="cubic", outside="edge"))
    np.testing.assert_allclose(made, d.warp(frames, filter="cubic", outside="edge"), atol=0.02)
    still = ~reference.reached(reference.carried_out(d), d.domain, reference.grid(shape))
    np.testing.assert_array_equal(made[still], frames[still])


def test_points_beyond_the_reach_keep_every_bit() -> None:
    d = supple.Deformation((40, 60), border=None, spacing=(0.7, 1.9)).grab((10, 20), by=(9, 0), radius=3, reach=2)
    places = np.random.default_rng(1).uniform((30, 0), (60, 40), (50, 2))
    given = sent(places)
    np.testing.assert_array_equal(on_host(points.forward(d.space, given)[0]), places)
    np.testing.assert_array_equal(on_host(points.inverse(d.space, given)[0][0]), places)


def _agrees(space: Space, steps: list[reference.Step], d: supple.Deformation) -> None:
    places = np.random.default_rng(0).uniform(-0.1, 1.1, (12, d.ndim)) * d.shape[::-1]
    given = sent(places)
    expected, slopes = reference.moved(steps, d.domain, places)
    np.testing.assert_allclose(on_host(points.forward(space, given)[0]), expected, atol=1e-10)
    np.testing.assert_allclose(on_host(points.forward(space, given, matrices=True)[0]), slopes, atol=1e-10)
    found, _, _, converged = map(on_host, points.inverse(space, given)[0])
    assert converged.all()
    np.testing.assert_allclose(found, reference.inverse(steps, d.domain, places), atol=1e-7)
