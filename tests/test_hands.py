"""Grabs along paths, mirror images, and strokes that restore and smooth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Recipe
from supple.space.freezing import Freeze
from supple.strokes import Stroke, legs
from tests import reference
from tests.strokes import refusal

Floats = npt.NDArray[np.float64]
SHAPE = (200, 240)


def curve(count: int = 100) -> Floats:
    t = np.linspace(0, 1, count)
    return np.stack([60 + 100 * t, 100 + 30 * np.sin(3 * t)], axis=-1)


class TestPaths:
    def test_the_point_follows_and_arrives(self) -> None:
        line = curve()
        d = Deformation(SHAPE).grab(line[0], path=line[1:], radius=30)
        np.testing.assert_allclose(d.forward(line[0]), line[-1], atol=1e-6)
        np.testing.assert_array_equal(d.strokes[0].at, line[0])
        straight = Deformation(SHAPE).grab(line[0], to=line[-1], radius=30)
        assert len(straight.space.table) < len(d.space.table) <= 4 * len(straight.space.table)
        # The pivots of all steps lie near the curve.
        pivots = d.space.table["pivot"][:, :2]
        assert np.linalg.norm(pivots[:, None] - line, axis=2).min(axis=1).max() < 0.06 * 30

    @pytest.mark.parametrize("count", [2, 3, 10, 300])
    def test_a_straight_path_is_a_straight_grab(self, count: int) -> None:
        line = np.linspace((60, 60), (150, 120), count)
        d = Deformation(SHAPE).grab(line[0], path=line[1:], radius=30)
        assert len(legs(d.strokes[0], (1, 1))) == 1
        straight = Deformation(SHAPE).grab((60, 60), to=(150, 120), radius=30)
        np.testing.assert_array_equal(d.space.table, straight.space.table)

    def test_scribbles_cost_no_more_than_four_legs_a_radius(self) -> None:
        line = np.random.default_rng(3).uniform((60, 60), (180, 140), (60, 2))
        stroke = Stroke.grab(line[0], path=line[1:], radius=40)
        length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
        assert 1 < len(legs(stroke, (1, 1))) <= 4 * length / 40

    def test_a_closed_path_stirs_and_returns(self) -> None:
        angle = np.linspace(0, 2 * math.pi, 50)
        line = np.stack([120 + 20 * np.sin(angle), 100 + 20 * np.cos(angle)], axis=-1)
        d = Deformation(SHAPE).grab(line[0], path=line[1:], radius=25)
        assert not d.is_identity
        np.testing.assert_allclose(d.forward(line[0]), line[0], atol=1e-6)
        assert np.abs(d.forward((120, 100)) - (120, 100)).max() > 1

    def test_recipes_and_parts(self) -> None:
        line = curve(12)
        d = Deformation(SHAPE).grab(line[0], path=line[1:], radius=30)
        again = Recipe.from_json(d.recipe.to_json())
        assert again == d.recipe
        half = Deformation.from_recipe(Recipe(strokes=d.strokes, size=SHAPE[::-1], amount=0.5), SHAPE)
        np.testing.assert_allclose(half.forward(line[0]), (line[0] + line[-1]) / 2, atol=1e-6)
        wide = again.fitted((480, 400)).strokes[0]
        np.testing.assert_allclose(wide.path[3], np.multiply(line[4] + 0.5, 2) - 0.5)

    def test_refusals(self) -> None:
        assert "follows a path, which takes on_fold='flow'" in refusal(
            lambda: Deformation(SHAPE, on_fold="damp").grab((60, 60), path=[(80, 60), (90, 70)], radius=20)
        )
        assert refusal(lambda: Stroke.grab((1, 2), path=[(1, 2, 3), (2, 2)], radius=3)).startswith("path[0]")
        assert "path must be left out for a scale" in refusal(
            lambda: Stroke(brush="scale", at=(1, 2), factor=2, radius=3, path=[(1, 2)])  # type: ignore[arg-type]
        )


class TestSymmetry:
    @pytest.mark.parametrize("x", [80.0, 100.0, 119.0, 119.5])
    def test_grabs_are_symmetric(self, x: float) -> None:
        one = Stroke.grab((x, 90), by=(-7, 5), radius=25)
        d = Deformation(SHAPE)
        for stroke in one.symmetric((119.5, 0), (1, 0)):
            d = d.add(stroke)
        points = np.random.default_rng(0).uniform((10, 10), (229, 189), (200, 2))
        flip = np.array([-1.0, 1.0])
        seen, image = d.forward(points), d.forward(points * flip + (239, 0))
        np.testing.assert_allclose(image, seen * flip + (239, 0), atol=1e-9)
        goal = (x - 7, 95) if x < 119.4 else (x, 95)
        np.testing.assert_allclose(d.forward((x, 90)), goal, atol=1e-6)

    def test_in_space_and_about_a_slanted_plane(self) -> None:
        normal = np.array([1.0, 2.0, -1.0])
        stroke = Stroke.pull([(20, 20, 12), (28, 26, 18)], by=[(2, 1, 0), (0, 2, 2)], radius=9)
        image = stroke.mirrored((24, 24, 15), normal)
        again = image.mirrored((24, 24, 15), normal)
        for (p, v), (q, w) in zip(stroke.handles, again.handles, strict=True):
            np.testing.assert_allclose(p, q, atol=1e-9)
            np.testing.assert_allclose(v, w, atol=1e-9)
        middle = (np.array(stroke.at) + image.at) / 2
        assert (middle - (24, 24, 15)) @ normal == pytest.approx(0, abs=1e-9)

    @pytest.mark.parametrize(
        "stroke",
        [
            Stroke(brush="twist", at=(60, 90), angle=50, radius=15),
            Stroke(brush="scale", at=(60, 90), factor=1.6, radius=15),
            Stroke(brush="pinch", at=(60, 90), factor=0.6, axis=(1, 0.5), radius=15),
        ],
    )
    def test_other_brushes_are_mirrored(self, stroke: Stroke) -> None:
        d = Deformation(SHAPE, border=None).add(stroke)
        image = Deformation(SHAPE, border=None).add(stroke.mirrored((119.5, 0), (1, 0)))
        points = np.random.default_rng(0).uniform((10, 10), (229, 189), (200, 2))
        flip = np.array([-1.0, 1.0])
        expected = d.forward(points) * flip + (239, 0)
        np.testing.assert_allclose(image.forward(points * flip + (239, 0)), expected, atol=1e-9)
        assert len(stroke.symmetric((119.5, 0), (1, 0))) == 2

    def test_refusals(self) -> None:
        stroke = Stroke.grab((60, 90), by=(1, 2), radius=9)
        assert refusal(lambda: stroke.mirrored((1, 1), (0, 0))).startswith("normal must be a direction")
        assert refusal(lambda: stroke.mirrored((1, 1, 1), (0, 1))).startswith("at must be 2 numbers")
        line = Stroke.grab((60, 90), path=[(70, 95), (80, 90)], radius=9)
        assert "two images" in refusal(lambda: line.symmetric((60, 0), (1, 0)))


def displaced(d: Deformation, points: Floats) -> float:
    return float(np.linalg.norm(points - d.inverse(points).points, axis=1).mean())


class TestRestore:
    @pytest.mark.parametrize("shape", [SHAPE, (60, 70, 80)])
    def test_it_brings_back(self, shape: tuple[int, ...]) -> None:
        centre = np.array(shape[::-1]) / 2
        made = Deformation(shape)
        points = centre + np.random.default_rng(0).uniform(-5, 5, (50, len(shape)))
        for d in (
            made.grab(centre, by=(8, 5, 0)[: len(shape)], radius=20),
            made.twist(centre, angle=40, radius=20),
            made.scale(centre, factor=1.7, radius=20),
        ):
            before, restored = displaced(d, points), d
            for _ in range(2):
                restored = restored.restore(centre, radius=20)
            assert displaced(restored, points) < 0.4 * before
            half = d.restore(centre, radius=20, strength=0.5)
            assert 0.3 * before < displaced(half, points) < 0.8 * before
            assert restored.resolution()["margin"] > 0
            assert restored.strokes[-1].name == "restore"

    def test_beyond_two_radii_nothing_changes(self) -> None:
        d = Deformation(SHAPE, border=None).grab((100, 100), by=(20, 5), radius=30)
        restored = d.restore((110, 100), radius=12)
        points = reference.grid(SHAPE).reshape(-1, 2)
        # The points there go back by 20 pixels at most.
        far = np.linalg.norm(points - (110, 100), axis=1) > 24 + 21
        np.testing.assert_array_equal(restored.inverse(points[far]).points, d.inverse(points[far]).points)

    @pytest.mark.parametrize("shape", [(200, 200), (60, 60, 60)])
    def test_several_points_are_one_stroke_each_with_its_part(self, shape: tuple[int, ...]) -> None:
        n, middle = len(shape), shape[0] / 2
        at = np.full(n, middle)
        d = Deformation(shape).grab(at, by=np.eye(n)[1] * middle / 10, radius=middle / 4)
        way = np.repeat(at[None], 5, axis=0)
        way[:, 0] += np.linspace(-0.3, 0.3, 5) * middle
        one = d.restore(way, radius=0.3 * middle)
        (stroke,) = one.strokes[1:]
        assert stroke.name == "restore"
        assert len(stroke.handles) < 5 * (7 if n == 2 else 13)
        ends = np.array([p for p, _ in stroke.handles])
        apart = np.linalg.norm(ends[:, None] - ends, axis=2) + np.eye(len(ends)) * 1e9
        assert apart.min() > 0.29 * 0.3 * middle
        np.testing.assert_allclose(one.inverse(np.add(ends, [v for _, v in stroke.handles])).points,
                                   d.inverse(ends).points, atol=1e-5)  # fmt: skip
        assert (
            np.linalg.norm(one.inverse(way).points - way, axis=1).mean()
            < 0.35 * np.linalg.norm(d.inverse(way).points - way, axis=1).mean()
        )
        parts = d.restore(way, radius=0.3 * middle, strength=[1.0, 1.0, 0.0, 0.0, 0.0]).strokes[-1]
        drags = np.linalg.norm([v for _, v in parts.handles], axis=1)
        assert drags[0] > 0
        assert drags[-1] == 0
        wanted = "strength must be a number from 0 to 1, or one for each point"
        assert refusal(lambda: d.restore(way, radius=10, strength=[1.0, 0.5])).startswith(wanted)
        assert refusal(lambda: d.restore([[1.0, 2.0], [3.0]], radius=10)).startswith("at")  # type: ignore[list-item]

    def test_smoothing_relaxes(self) -> None:
        d = Deformation(SHAPE)
        for x in range(60, 180, 10):
            d = d.grab((x, 100), by=(0, 3 if x % 20 else -3), radius=8)
        line = np.stack([np.arange(60, 180.0), np.full(120, 100.0)], axis=-1)

        def rough(d: Deformation) -> float:
            return float(np.diff((line - d.inverse(line).points)[:, 1], 2).std())

        smooth = d
        for x in range(60, 180, 10):
            smooth = smooth.smooth((x, 100), radius=20)
        assert rough(smooth) < 0.5 * rough(d)

    def test_of_the_identity_it_does_nothing(self) -> None:
        d = Deformation(SHAPE)
        assert d.restore((100, 100), radius=20).is_identity
        assert d.smooth((100, 100), radius=20).is_identity

    def test_near_edges_and_refusals(self) -> None:
        d = Deformation(SHAPE).grab((12, 100), by=(5, 5), radius=20)
        assert displaced(d.restore((14, 104), radius=20), np.array([(14.0, 104)])) < 3
        assert refusal(lambda: d.restore((300, 100), radius=10)).startswith("at must be a point within the domain")
        assert refusal(lambda: d.restore((30, 100), radius=10, strength=2)).startswith("strength must be")
        assert refusal(lambda: d.smooth((30, 100), radius=-1)).startswith("radius must be")


@pytest.mark.parametrize("border", ["auto", None, 3.0])
@pytest.mark.parametrize("t", [0, 1, 11])
def test_the_first_and_the_last_frame_are_restored_and_smoothed(border: Any, t: int) -> None:
    """There, points stay in their frame, as whatever is dragged does."""
    bent = Deformation((12, 90, 120), time=True, border=border).grab((60, 40, t), by=(14, 5, 0), radius=18)
    before = np.linalg.norm(bent.inverse((70, 44, t)).points - (70, 44, t))
    assert before > 5
    for back in (bent.restore((70, 44, t), radius=18), bent.smooth((70, 44, t), radius=18)):
        left = back.inverse((70, 44, t)).points - (70, 44, t)
        assert np.linalg.norm(left) < 0.7 * before
        assert abs(left[2]) < 1e-9
    late = Deformation((12, 90, 120), time=True, border=border).grab((60, 40, 4), by=(0, 0, 3), radius=18)
    if border is not None and t != 1:
        assert {by[2] for _, by in late.restore((62, 41, t), radius=18).strokes[-1].handles} == {0}


@pytest.mark.parametrize(
    ("stroke", "near", "far"),
    [
        (Stroke.twist((0, 256), angle=30, radius=60), 2.1, 0.1),
        (Stroke.scale((0, 256), factor=1.4, radius=60), 1.3, 0.1),
        (Stroke.pinch((0, 256), factor=0.7, radius=60), 0.9, 0.12),
        (Stroke.grab((0, 256), path=[(-14, 250)], to=(-24, 240), radius=60), 7.0, 1.2),
    ],
)
def test_two_strokes_are_nearly_symmetric(stroke: Stroke, near: float, far: float) -> None:
    """The figures of docs/brushes.md."""
    points = np.stack(np.meshgrid(np.arange(0.0, 512, 4), np.arange(0.0, 512, 4)), axis=-1)
    for away, most in ((56, near), (120, far)):
        moved = stroke.mapped(lambda p, x=255.5 - away: (p[0] + x, p[1]), lambda v: v)
        d = Deformation((512, 512))
        for one in moved.symmetric(at=(255.5, 0), normal=(1, 0)):
            d = d.add(one)
        found, image = d.forward(points), d.forward(np.stack([511 - points[..., 0], points[..., 1]], axis=-1))
        image[..., 0] = 511 - image[..., 0]
        off = np.linalg.norm(found - image, axis=-1).max()
        assert 0.7 * most < off <= most or (away == 120 and off <= most)


class TestPush:
    @pytest.mark.parametrize("by", [9.0, -9.0])
    def test_points_of_the_way_arrive_at_its_side(self, by: float) -> None:
        t = np.linspace(0, math.pi, 40)
        way = np.stack([100 + 50 * np.cos(t), 100 + 50 * np.sin(t)], axis=1)  # clockwise on a screen: left is outside
        d = Deformation((200, 200)).push(way.tolist(), by=by, radius=20)
        (stroke,) = d.strokes
        assert stroke.name == "push"
        assert Recipe.from_json(d.recipe.to_json()).strokes == (stroke,)
        at = np.array([p for p, _ in stroke.handles])
        np.testing.assert_allclose(np.linalg.norm(np.diff(at, axis=0), axis=1), 10, rtol=0.1)
        away = np.linalg.norm(d.forward(at) - 100, axis=1)
        np.testing.assert_allclose(away[1:-1], 50 + by, atol=0.1)
        assert d.resolution()["margin"] > 0

    def test_half_of_it_is_half_as_far_and_its_image_is_mirrored(self) -> None:
        stroke = Stroke.push([(40, 30), (40, 90)], by=8, radius=12)
        d = Deformation((120, 200)).add(stroke.weakened(0.5))
        np.testing.assert_allclose(d.forward((40, 60)), (44, 60), atol=1e-6)
        (both,) = stroke.symmetric((100, 0), (1, 0))
        ends = Deformation((120, 200)).add(both).forward([(40, 60), (160, 60)])
        np.testing.assert_allclose(ends, [(48, 60), (152, 60)], atol=1e-6)

    @pytest.mark.parametrize("begin", [20, 25, 28])
    def test_across_the_edge_of_what_is_frozen_it_leaves_no_notch(self, begin: int) -> None:
        held = Freeze.of(np.tile(np.arange(200) > 120, (200, 1)), width=40)
        stroke = Stroke.push([(begin, 100), (begin + 160, 100)], by=10, radius=20)
        d = Deformation((200, 200), freeze=held).add(stroke, warn=False)
        x = np.arange(60.0, 160.0)
        moved = 100 - d.forward(np.stack([x, np.full_like(x, 100.0)], axis=1))[:, 1]
        assert 9.9 < moved.max() < 10.3
        assert (np.diff(moved[25:]) < 0.01).all()  # it only falls, into the frozen part
        assert d.arrivals[0].also[-1].cause == "freeze"

    def test_what_is_no_way_is_refused(self) -> None:
        def push(path: Any, by: Any = 5) -> str:
            return refusal(lambda: Stroke.push(path, by=by, radius=10))

        assert push([(1, 2)]).startswith("path must be two points or more, which are apart")
        assert push([(1, 2), (1, 2)]).startswith("path must be two points or more, which are apart")
        assert push([(1, 2, 3), (4, 5, 6)]).startswith("path[0] must be 2 numbers")
        assert push([(1, 2), (5, 6)], by=math.nan).startswith("by must be a number of samples")
        assert push([(0, 0), (90_000, 0)]).startswith("points must be at most 1000 points")
