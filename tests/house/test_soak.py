"""The short form of the soak; and that it would find what it looks for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from supple import Deformation
from supple.deformation import Inverse
from tests import soak

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


def test_no_violations() -> None:
    tally = soak.soak(400_000)
    assert tally.violations == []
    assert tally.points >= 400_000
    assert tally.recipes > 15
    assert tally.flowing > 5
    assert tally.images > 5
    assert tally.worst_residual < 1e-6
    assert tally.worst_error <= 1


def test_a_recipe_is_known_by_its_seed() -> None:
    first, again = (soak.drawn(np.random.default_rng(42))[0] for _ in range(2))
    assert first.recipe == again.recipe
    assert first.shape == again.shape


def passed_off(found: Inverse) -> Inverse:
    return replace(found, points=found.points + 1e-3)


def given_up(found: Inverse) -> Inverse:
    return replace(found, converged=np.zeros_like(found.converged))


def elsewhere(found: Inverse) -> Inverse:
    return replace(found, points=np.roll(found.points, 1, axis=0))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [(passed_off, "passed off"), (given_up, "did not converge"), (elsewhere, "is not p")],
)
def test_wrong_points_are_found(wrong: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solve = Deformation.inverse
    monkeypatch.setattr(Deformation, "inverse", lambda d, points: wrong(solve(d, points)))
    tally = soak.soak(1)
    assert any(message in line for line in tally.violations)
    assert all(line.startswith("seed 1: ") for line in tally.violations)


def test_folds_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    jacobian = Deformation.jacobian
    monkeypatch.setattr(Deformation, "jacobian", lambda d, points: jacobian(d, points)[..., ::-1, :])
    assert any("det" in line for line in soak.soak(1).violations)


def test_wrong_maps_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    d = Deformation((40, 50)).grab((20, 20), by=(3, 4), radius=10)
    fine = soak.look_at_map(d, np.random.default_rng(1), soak.Tally())
    assert fine == []
    mapped = Deformation.inverse_map
    monkeypatch.setattr(Deformation, "inverse_map", lambda d, tolerance: mapped(d, tolerance=tolerance) + np.float32(2))
    wrong = soak.look_at_map(d, np.random.default_rng(1), soak.Tally())
    assert any("was said" in line for line in wrong)
