"""A stroke moves nothing beyond its reach, however far and in however many steps it drags: each bit is kept there."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from supple import Deformation, Stroke, SuppleError

Floats = np.ndarray[Any, np.dtype[np.float64]]


def distance(points: Floats, way: Floats) -> Floats:
    """Return the distance of points (N, D) from a line through some points."""
    least = np.full(len(points), np.inf)
    for start, end in pairwise(way):
        drag = end - start
        along = np.clip((points - start) @ drag / max(drag @ drag, 1e-300), 0, 1)
        least = np.minimum(least, np.linalg.norm(points - start - along[:, None] * drag, axis=1))
    return least


def check(d: Deformation, ways: list[Floats], reach: float) -> None:
    """Check that what is farther than the reach, in physical units, from all ways, in samples, keeps every bit."""
    spacing = np.array(d.domain.spacing)
    points = np.argwhere(np.ones(d.shape))[:, ::-1].astype(float)
    away = np.min([distance(points * spacing, way * spacing) for way in ways], axis=0)
    far, source = away > reach, np.random.default_rng(0).integers(0, 256, d.shape).astype(np.uint8)
    assert 0.02 < far.mean() < 1
    between = points[far] + np.random.default_rng(1).uniform(-0.3, 0.3, (far.sum(), d.ndim))
    for given in (points[far], between[:2000]):
        kept = np.min([distance(given * spacing, way * spacing) for way in ways], axis=0) > reach
        np.testing.assert_array_equal(d.forward(given)[kept], given[kept])
        np.testing.assert_array_equal(d.inverse(given).points[kept], given[kept])
    flat = far.reshape(d.shape)
    np.testing.assert_array_equal(d.inverse_map()[flat], points[far].astype(np.float32))
    np.testing.assert_array_equal(d.warp(source)[flat], source[flat])
    inside = points[away < 0.5 * reach]
    assert (d.forward(inside) != inside).any()


@pytest.mark.filterwarnings("ignore::supple.ToleranceWarning")  # whatever the strength
@pytest.mark.parametrize("seed", range(16))
def test_a_strong_drag_moves_nothing_beyond_its_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ndim = 2 + seed % 2
    shape = rng.integers(60, 160, 2) if ndim == 2 else rng.integers(20, 48, 3)
    size = shape[::-1]
    spacing = np.ones(ndim) if seed % 3 == 0 else rng.uniform(0.5, 3, ndim)
    radius, reach = float(0.08 * (size * spacing).min()), (1.0, 2.0, 4.0)[seed % 3]
    line = rng.uniform(0.12, 0.88, (2 + rng.integers(0, 3), ndim)) * size
    line[0] = np.where(rng.random(ndim) < 0.3, 1.5, line[0])  # near a border
    d = Deformation(
        shape.tolist(), spacing=tuple(spacing), border=(None, "auto")[seed // 4 % 2], time=ndim == 3 and seed % 4 == 1
    )
    d = d.grab(line[0], path=line[1:], radius=radius, reach=reach, scales=1 + seed % 3)
    assert d.report(plane=0 if ndim == 3 else None).applied > len(line) - 1  # it flows
    check(d, [line], reach * radius)


def test_a_long_drag_through_a_volume_and_through_time() -> None:
    for time in (False, True):
        d = Deformation((60, 40, 44), spacing=(1, 1, 2.0), border=None, time=time)
        d = d.grab((22, 20, 14), to=(22, 20, 44), radius=6, reach=2)
        start, end = np.array([22.0, 20, 14]), np.array([22.0, 20, 44])
        assert len(d.space.table) > 3
        check(d, [np.array([start, end])], 12)
        assert (d.forward((22.5, 20, 45)) != (22.5, 20, 45)).any()  # beyond the reach of the start, not of the way


def test_points_of_a_path_are_left_out_by_their_distance_in_physical_units() -> None:
    line = np.array([(20.0, 20, 6), (30, 20, 7), (40, 20, 6)])
    rows = [len(set(d.space.table["pivot"][:, 2])) for d in (
        Deformation((13, 40, 60), spacing=(1, 1, thick), border=None).grab(line[0], path=line[1:], radius=12, reach=2)
        for thick in (0.5, 4)
    )]  # fmt: skip
    assert rows[0] == 1  # half a unit off the line, and a twentieth of the radius is 0.6
    assert rows[1] > 1


@pytest.mark.parametrize("kind", ["plane", "volume", "clip"])
def test_a_pull_moves_nothing_beyond_the_ways_of_its_points(kind: str) -> None:
    rng = np.random.default_rng(len(kind))
    shape, spacing = ((90, 120), (1.3, 0.7)) if kind == "plane" else ((24, 30, 36), (1.0, 1.5, 2.0))
    size = np.array(shape[::-1])
    start = size * rng.uniform(0.3, 0.7, (4, len(size)))
    end = start + size * np.array([0.15] + [-0.1] * (len(size) - 1))
    d = Deformation(shape, spacing=spacing, time=kind == "clip").pull(start, to=end, radius=4, reach=1.5)
    assert len(d.space.table) > len(start)  # several steps
    check(d, [*np.stack([start, end], axis=1)], 6)


@pytest.mark.parametrize(
    "stroke",
    [
        Stroke.twist((40, 45), angle=400, radius=9, reach=2),
        Stroke.scale((40, 45), factor=9, radius=9, reach=2),
        Stroke.pinch((40, 45), factor=0.05, radius=9, reach=2),
    ],
    ids=lambda s: s.brush,
)
def test_other_brushes_move_nothing_beyond_their_point(stroke: Stroke) -> None:
    d = Deformation((90, 80), spacing=(0.9, 1.1)).add(stroke)
    assert (len(d.space.table) > 1) == (stroke.brush != "twist")  # which is one step at any angle
    check(d, [np.array([stroke.at, stroke.at])], 18)


def test_damped_and_frozen_drags_stay_within_the_reach_too() -> None:
    frozen = np.zeros((80, 90), bool)
    frozen[:, 60:] = True
    way = np.array([(20.0, 40), (70, 40)])
    for options in ({"on_fold": "damp"}, {"freeze": frozen}):
        with pytest.warns(UserWarning, match="damped|frozen"):
            d = Deformation((80, 90), **options).grab(way[0], to=way[1], radius=8, reach=2)  # type: ignore[arg-type]
        check(d, [way], 16)


def test_a_stroke_is_refused_if_all_of_its_way_is_beyond_the_picture() -> None:
    d = Deformation((50, 60), border=None)
    with pytest.warns(UserWarning, match="starts outside"):
        through = d.grab((-90, 25), to=(150, 25), radius=8, reach=2)
    assert not through.is_identity
    with pytest.raises(SuppleError, match="reaches nothing of it"):
        d.grab((-90, 25), to=(-60, 25), radius=8, reach=2)
