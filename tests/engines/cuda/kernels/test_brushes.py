"""Brushes that twist, scale and pinch, and strokes that act at once, on a GPU."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import supple
from supple.engines.base import Space
from supple.engines.cuda import points
from tests import reference
from tests.turns import AFFINE, at_once

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


@pytest.mark.parametrize("border", [None, 3.0])
@pytest.mark.parametrize("shape", [(13, 16), (5, 9, 10)])
def test_points(numba_cuda: Any, shape: tuple[int, ...], border: float | None) -> None:
    d = supple.Deformation(shape, border=border, spacing=(1.0, 0.8, 1.3)[: len(shape)], on_fold="damp")
    for stroke in AFFINE[len(shape)]:
        d = d.add(replace(stroke, at=0.45 * (np.array(shape[::-1]) - 1), radius=4.0))
    _agrees(numba_cuda, d.space, reference.carried_out(d), d)


@pytest.mark.parametrize("shape", [(13, 16), (5, 9, 10)])
def test_strokes_that_act_at_once(numba_cuda: Any, shape: tuple[int, ...]) -> None:
    d = supple.Deformation(shape, border=3.0)
    table, steps = at_once(d.domain)
    _agrees(numba_cuda, replace(d.space, table=table), steps, d)


def _agrees(cuda: Any, space: Space, steps: list[reference.Step], d: supple.Deformation) -> None:
    places = np.random.default_rng(0).uniform(-0.1, 1.1, (12, d.ndim)) * d.shape[::-1]
    given = cuda.to_device(places)
    expected, slopes = reference.moved(steps, d.domain, places)
    np.testing.assert_allclose(points.forward(space, given, matrices=False).copy_to_host(), expected, atol=1e-10)
    np.testing.assert_allclose(points.forward(space, given, matrices=True).copy_to_host(), slopes, atol=1e-10)
    found, _, _, converged = (part.copy_to_host() for part in points.inverse(space, given))
    assert converged.all()
    np.testing.assert_allclose(found, reference.inverse(steps, d.domain, places), atol=1e-7)
