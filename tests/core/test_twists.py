"""Twists as the core has them: points keep their distance from the pivot, and no angle folds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Freeze
from tests import reference
from tests.core.drawn import places

Floats = npt.NDArray[np.float64]
ANGLES = (10.0, -90.0, 180.0, 360.0, 720.0, -1080.0, 3600.0)


def twisted(n: int, angle: float, reach: float | None = 4.0, **domain: Any) -> tuple[Deformation, Floats]:
    """Return a twist of an image or a volume, and its pivot."""
    at = np.array([42.3, 37.7, 20.2][:n])
    kind: dict[str, Any] = {} if n == 2 else {"axis": (1, -2, 0.5)}
    d = Deformation((40, 80, 90)[3 - n :], **domain).twist(at, angle=angle, radius=8.0, reach=reach, **kind)
    return d, at


@pytest.mark.parametrize("on_fold", ["flow", "damp", "error"])
@pytest.mark.parametrize("reach", [None, 1.5, 4.0])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("n", [2, 3])
def test_points_keep_their_distance_from_the_pivot(n: int, angle: float, reach: float | None, on_fold: Any) -> None:
    d, at = twisted(n, angle, reach, border=None, spacing=(0.7, 1.5, 2.2)[:n], on_fold=on_fold)
    assert len(d.space.table) == 1
    assert d.resolution()["damping"] == (1.0,)
    assert 0 < d.resolution()["margin"] < 1
    points, steps = places(d, 400), np.array(d.domain.spacing)
    moved, jacobian = d.forward(points), d.jacobian(points)
    there, here = (np.linalg.norm((p - at) * steps, axis=1) for p in (moved, points))
    np.testing.assert_allclose(there, here, rtol=1e-14, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(jacobian), 1, atol=1e-12)
    np.testing.assert_allclose(reference.differences(d.forward, points, 1e-3), jacobian, atol=1e-6)
    found = d.inverse(moved)
    assert found.converged.all()
    np.testing.assert_allclose(found.points, points, atol=1e-10)
    back, _ = twisted(n, -angle, reach, border=None, spacing=d.domain.spacing)
    np.testing.assert_allclose(back.forward(moved), points, atol=1e-11)


@pytest.mark.parametrize("angle", ANGLES)
def test_sines_are_as_accurate_as_those_of_the_library(angle: float) -> None:
    d, at = twisted(2, angle, None, border=None)
    r = at[0] + np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 4000)]) - at[0]  # as the core sees it
    w = ((r**2 + 64) ** -1.5 + 1.5 * 64 * (r**2 + 64) ** -2.5) * 8**3 / 2.5
    phi = math.radians(angle) * w
    turned = d.forward(at + r[:, None] * (1.0, 0.0)) - at
    rounding = 4e-16 * ((1 + abs(math.radians(angle))) * r + 100)
    assert (np.abs(turned[:, 0] - r * np.cos(phi)) <= rounding).all()
    assert (np.abs(turned[:, 1] - r * np.sin(phi)) <= rounding).all()


@pytest.mark.parametrize("tolerance", [0.1, 0.01])
@pytest.mark.parametrize("border", [None, 12.0])
@pytest.mark.parametrize("angle", [90.0, 360.0, -720.0, 1080.0])
def test_the_lattice_follows_any_angle(angle: float, border: float | None, tolerance: float) -> None:
    d, _ = twisted(2, angle, border=border)
    exact = d.inverse(reference.grid((80, 90))).points
    off = np.linalg.norm(d.inverse_map(tolerance=tolerance) - exact, axis=-1)
    report = d.report(tolerance=tolerance)
    assert report.within
    assert report.folds == 0
    assert off.max() <= min(report.error + 3e-5, tolerance)


def test_several_turns_one_after_the_other() -> None:
    d = Deformation((80, 90), border=None)
    for at, angle in (((30, 40), 720), ((55, 35), -400), ((45, 60), 200)):
        d = d.twist(at, angle=angle, radius=9).grab(at, by=(6, -4), radius=12)
    points = places(d, 400)
    found = d.inverse(d.forward(points))
    assert found.converged.all()
    np.testing.assert_allclose(found.points, points, atol=1e-6)
    report = d.report()
    assert report.within
    assert report.folds == 0
    off = np.linalg.norm(d.inverse_map() - d.inverse(reference.grid((80, 90))).points, axis=-1)
    assert off.max() <= report.error + 3e-5


@pytest.mark.parametrize("held", ["border", "mask"])
@pytest.mark.parametrize("n", [2, 3])
def test_what_holds_a_part_back_changes_nothing_elsewhere(n: int, held: str) -> None:
    shape = (40, 80, 90)[3 - n :]
    mask = np.zeros(shape)
    mask[..., :9, :] = 1
    domain: dict[str, Any] = {"border": 10.0} if held == "border" else {"border": None, "freeze": Freeze.of(mask)}
    d, at = twisted(n, 200, **domain)
    assert len(d.space.table) > 1
    free, _ = twisted(n, 200, border=None)
    points = np.concatenate([places(d, 1000), at + np.random.default_rng(0).uniform(-8, 8, (500, n))])
    near = np.linalg.norm(points - at, axis=1) < 8  # whose circles touch neither
    np.testing.assert_allclose(d.forward(points[near]), free.forward(points[near]), atol=1e-10)
    moved, jacobian = d.forward(points), d.jacobian(points)
    assert (np.linalg.det(jacobian) > 0).all()
    found = d.inverse(moved)
    assert found.converged.all()
    np.testing.assert_allclose(d.forward(found.points), moved, atol=1e-6)
