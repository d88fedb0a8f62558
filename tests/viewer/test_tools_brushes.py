"""The brushes that do not pull: what drags of them make of pictures, clips and volumes, and how it is edited."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from supple.strokes import Stroke
from supple.viewer.tools.gestures import Tools
from supple.viewer.tools.planes import RENDERED
from tests.viewer.test_tools_slices import bench, middle
from tests.viewer.tools import clip, down, drag, image, move, press, solid, state, up, wheel

E = math.e


def drawn(tools: Tools[Any], key: str, *way: tuple[float, float], radius: float = 20) -> Stroke:
    """The stroke of one drag, which is one step, and comes back bit for bit."""
    tools.radius = radius
    press(tools, key)
    before, count = state(tools), len(tools.document.strokes)
    drag(tools, *way)
    after, selected = state(tools), tools.document.selected
    assert len(tools.document.strokes) == count + 1
    assert selected == count
    press(tools, "z", "Control")
    assert state(tools) == before
    press(tools, "y", "Control")
    assert state(tools) == after
    return tools.document.strokes[-1]


class TestPictures:
    def test_a_twist_follows_the_pointer_sideways(self) -> None:
        # A radius of 20 is 40 logical pixels.
        stroke = drawn(image(), "t", (201, 101), (221, 110), (241, 90))
        assert stroke == Stroke(brush="twist", at=(100, 50), angle=90, radius=20)
        assert drawn(image(), "t", (201, 101), (191, 101)).angle == pytest.approx(-22.5)

    def test_to_the_right_is_clockwise(self) -> None:
        tools = image()
        drawn(tools, "t", (201, 101), (241, 101))
        right = tools.document.deformation.forward([(101, 50)])[0] - (100, 50)
        assert right[1] > 0.5  # down

    @pytest.mark.parametrize(("key", "power"), [("w", 1), ("p", -1)])
    def test_bloat_and_pucker_grow_with_the_distance(self, key: str, power: int) -> None:
        for end in ((281, 101), (201, 181), (121, 101)):
            stroke = drawn(image(), key, (201, 101), end)
            assert (stroke.brush, stroke.at) == ("scale", (100, 50))
            assert stroke.factor == pytest.approx(E**power)
        # Not beyond what a stroke may be.
        tools = image()
        stroke = drawn(tools, key, (201, 101), (9000, 101))
        assert stroke.factor == pytest.approx(100.0**power)

    def test_a_pinch_squeezes_along_the_drag_and_stretches_with_shift(self) -> None:
        stroke = drawn(image(), "n", (201, 101), (233, 77))
        assert (stroke.brush, stroke.at, stroke.axis) == ("pinch", (100, 50), (16, -12))
        assert stroke.factor == pytest.approx(E**-0.5)
        tools = image()
        tools.radius = 20
        press(tools, "n")
        drag(tools, (201, 101), (233, 77), modifiers=("Shift",))
        assert tools.document.strokes[0].factor == pytest.approx(E**0.5)

    def test_a_click_makes_nothing_and_settings_of_pulls_are_not_theirs(self) -> None:
        tools = image()
        tools.scales, tools.poisson, tools.reach = 3, 0.2, 6.0
        for key in "twpn":
            press(tools, key)
            drag(tools, (201, 101), (202, 101))
            assert tools.document.strokes == ()
        for key, poisson in (("t", None), ("w", None), ("p", None), ("n", 0.2), ("g", 0.2)):
            stroke = drawn(tools, key, (301, 201), (321, 201))
            assert (stroke.poisson, stroke.reach, stroke.scales) == (poisson, 6.0, 3 if key == "g" else 1)
            tools.document.undo()

    @pytest.mark.parametrize(
        ("brush", "more"), [("twist", {"angle": 40}), ("scale", {"factor": 2}), ("pinch", {"factor": 2})]
    )
    def test_one_that_is_selected_is_moved_by_its_point(self, brush: Any, more: dict[str, Any]) -> None:
        tools = image(Stroke(brush=brush, at=(100, 50), radius=20, **more))
        tools.document.select(0)
        assert [handle.part for handle in tools.handles()] == ["pivot"]
        drag(tools, (201, 101), (221, 111), (261, 121))
        (stroke,) = tools.document.strokes
        assert stroke == Stroke(brush=brush, at=(130, 60), radius=20, **more)
        wheel(tools, -100)
        down(tools, 261, 121)
        wheel(tools, -100)
        up(tools, 261, 121)
        assert tools.document.strokes[0].radius == pytest.approx(22)


class TestPaths:
    WAY = ((201, 101), (221, 101), (222, 102), (241, 121), (241, 141), (221, 161), (221, 162))

    def test_a_drag_is_one_stroke_along_it(self) -> None:
        stroke = drawn(image(on_fold="flow"), "f", *self.WAY)
        assert stroke.brush == "grab"
        assert stroke.at == (100, 50)
        assert stroke.by == (10, 30.5)
        assert stroke.path == (
            (110, 50),
            (120, 60),
            (120, 70),
            (110, 80),
        )  # points closer than a few pixels are left out

    def test_it_arrives_by_its_way_and_may_come_back(self) -> None:
        tools = image(on_fold="flow")
        tools.radius = 15
        press(tools, "f")
        drag(tools, (201, 101), (241, 101), (241, 141), (201, 141), (201, 102))
        (stroke,) = tools.document.strokes
        assert stroke.by == (0, 0.5)
        assert len(stroke.path) == 3
        forward = tools.document.deformation.forward([(100, 50), (112, 62)])
        assert forward[0] == pytest.approx((100, 50.5), abs=1e-6)
        assert math.dist(forward[1], (112, 62)) > 0.5

    def test_a_selected_one_is_moved_whole_and_its_end_alone(self) -> None:
        tools = image(on_fold="flow")
        drawn(tools, "f", *self.WAY)
        drag(tools, (201, 101), (211, 101), (221, 111))
        stroke = tools.document.strokes[0]
        assert (stroke.at, stroke.by) == ((110, 55), (10, 30.5))
        assert stroke.path == ((120, 55), (130, 65), (130, 75), (120, 85))
        end = tools.view.to_canvas(*tools.document.tracks()[0][1].handles[0][1])
        drag(tools, end, (end[0] + 20, end[1]))
        assert tools.document.strokes[0].path == stroke.path
        assert tools.document.strokes[0].by == pytest.approx((20, 30.5))

    def test_in_a_plane_it_stays_there(self) -> None:
        tools = bench()
        x, y = middle(tools, 1)
        stroke = drawn(tools, "f", (x, y), (x + 20, y), (x + 30, y + 10), (x + 30, y + 25), radius=9)
        assert len(stroke.path) == 2
        assert {p[1] for p in (stroke.at, *stroke.path)} == {tools.pane(1).index[1]}
        assert stroke.by[1] == 0


BENT = Stroke(at=(150, 100), by=(20, 0), radius=30)


def displaced(tools: Tools[Any], *points: tuple[float, ...]) -> float:
    """How far points on screen have come, on average."""
    found = tools.document.deformation.inverse(points).points
    return float(np.linalg.norm(np.array(points) - found, axis=1).mean())


class TestPaintings:
    AROUND = tuple((x, y) for x in (160.0, 170.0, 180.0) for y in (90.0, 100.0, 110.0))

    @pytest.mark.parametrize(("key", "name", "rest"), [("r", "restore", 0.2), ("s", "smooth", 0.8)])
    def test_a_drag_is_one_stroke_and_one_step(self, key: str, name: str, rest: float) -> None:
        tools = image(BENT)
        tools.radius = 30
        tools.document.select(0)
        press(tools, key)
        before, was = state(tools), displaced(tools, *self.AROUND)
        # From the handle on, which is not dragged by these; 30 logical pixels are half of the radius.
        drag(tools, (341, 201), (380, 201), (341, 161), (341, 241))
        strokes = list(tools.document.strokes)
        assert strokes[0] == BENT
        assert [stroke.name for stroke in strokes[1:]] == [name]
        assert displaced(tools, *self.AROUND) < rest * was
        assert tools.document.selected == 1
        after = state(tools)
        press(tools, "z", "Control")
        assert state(tools) == before
        press(tools, "y", "Control")
        assert state(tools) == after

    def test_a_click_is_a_dab_and_nothing_is_done_where_nothing_is_bent(self) -> None:
        tools = image(BENT, on_fold="flow")
        tools.radius = 20
        press(tools, "r")
        drag(tools, (341, 201), (341, 201))
        assert len(tools.document.strokes) == 2
        assert tools.document.deformation.forward([BENT.at])[0] == pytest.approx(BENT.at, abs=0.01)
        drag(tools, (21, 21), (61, 21))
        assert len(tools.document.strokes) == 2

    def test_escape_takes_all_of_it_back(self) -> None:
        tools = image(BENT)
        before = state(tools)
        press(tools, "r")
        down(tools, 341, 201)
        move(tools, 441, 201)
        assert len(tools.document.strokes) == 2
        press(tools, "Escape")
        up(tools, 441, 201)
        assert state(tools) == before
        assert not tools.document.can_undo

    def test_their_many_points_are_no_handles(self) -> None:
        tools = image(BENT)
        tools.radius = 25
        press(tools, "r")
        drag(tools, (341, 201), (381, 201))
        assert tools.document.selected == 1
        assert {handle.item for handle in tools.handles()} == {0}

    @pytest.mark.parametrize("key", ["r", "s"])
    def test_a_dab_goes_as_far_as_its_strength(self, key: str) -> None:
        gone = []
        for strength in (1.0, 0.25):
            tools = image(BENT)
            tools.radius, tools.strength = 20, strength
            press(tools, key)
            drag(tools, (221, 101), (221, 101))
            gone.append(np.array([by for _, by in tools.document.strokes[-1].handles]))
        np.testing.assert_allclose(gone[1], 0.25 * gone[0], atol=1e-9)
        assert np.abs(gone[0]).max() > 0.1

    def test_a_dab_of_a_clip_and_of_a_plane_is_where_it_is_seen(self) -> None:
        film = clip(Stroke(at=(150, 100, 5), by=(20, 0, 0), radius=30))
        film.playback.seek(5)
        press(film, "r")
        drag(film, (341, 201), (341, 201))
        assert film.document.strokes[1].at == (170, 100, 5)
        solid = bench(np.eye(3), "LPS", Stroke(at=(30, 25, 20), by=(6, 0, 0), radius=12))
        solid.radius *= 1.5
        x, y = solid.pane(0).to_canvas((36, 25, 20))
        move(solid, x, y, buttons=())
        press(solid, "r")
        was = displaced(solid, (36, 25, 20))
        drag(solid, (x, y), (x, y))
        assert solid.document.strokes[1].at == pytest.approx((36, 25, 20))
        assert displaced(solid, (36, 25, 20)) < 0.2 * was


class TestPush:
    @pytest.mark.parametrize(("shift", "away"), [(False, -10), (True, 10)])
    def test_a_drag_is_one_stroke_across_its_way(self, shift: bool, away: float) -> None:
        tools = image()
        tools.radius = 20
        press(tools, "a")
        before = state(tools)
        drag(tools, (201, 101), (221, 101), (301, 101), modifiers=("Shift",) * shift)
        (stroke,) = tools.document.strokes
        assert stroke.name == "push"
        x, y = tools.document.deformation.forward((125, 50))
        assert (x, y) == pytest.approx((125, 50 + away), abs=0.1)  # to the right on screen: left is up
        assert tools.handles() == []
        press(tools, "z", "Control")
        assert state(tools) == before

    def test_with_symmetry_both_sides_are_one_stroke_and_others_have_no_such_tool(self) -> None:
        tools = image()
        tools.radius = 20
        for key in "ma":
            press(tools, key)
        drag(tools, (121, 101), (121, 161))
        assert len(tools.document.strokes) == 1
        one, other = tools.document.deformation.forward([(60, 65), (239, 65)])
        assert one[0] + other[0] == pytest.approx(299)
        film = clip()
        press(film, "a")
        drag(film, (201, 101), (301, 101))
        assert "same in every frame" in (film.status or "")
        assert film.document.strokes == ()
        block = solid()
        for key in "ay":
            press(block, key)
        assert block.brush == "grab"


class TestPins:
    def test_a_click_holds_a_point_of_the_selected_grab(self) -> None:
        tools = image(on_fold="flow")
        tools.radius = 20
        drag(tools, (201, 101), (231, 101))
        press(tools, "d")
        before = state(tools)
        drag(tools, (281, 101), (281, 101))
        (stroke,) = tools.document.strokes
        assert stroke.handles == (((100, 50), (15, 0)), ((140, 50), (0, 0)))
        ends = tools.document.deformation.forward([(100, 50), (140, 50)])
        np.testing.assert_allclose(ends, [(115, 50), (140, 50)], atol=1e-6)
        press(tools, "z", "Control")
        assert state(tools) == before
        press(tools, "y", "Control")
        # Another, and all are handles; a click on one removes it.
        drag(tools, (201, 181), (202, 181))
        assert [handle.nth for handle in tools.handles()] == [0, 0, 1, 1, 2, 2]
        drag(tools, (281, 101), (281, 101))
        (stroke,) = tools.document.strokes
        assert stroke.handles == (((100, 50), (15, 0)), ((100, 90), (0, 0)))
        drag(tools, (201, 101), (201, 101))
        assert tools.document.strokes[0].handles == (((100, 90), (0, 0)),)
        drag(tools, (201, 181), (201, 181))
        assert tools.document.strokes == ()

    def test_a_drag_pulls_what_is_seen_there_and_the_others_stay_where_they_are(self) -> None:
        tools = image(on_fold="flow")
        tools.radius = 20
        drag(tools, (201, 101), (221, 101))
        press(tools, "d")
        was = tools.document.deformation
        below = was.inverse([(130.0, 60.0)]).points[0]
        before = state(tools)
        drag(tools, (261, 121), (271, 125), (281, 131))
        (stroke,) = tools.document.strokes
        assert len(stroke.handles) == 2
        (at, by) = stroke.handles[1]
        assert at == pytest.approx(tuple(below), abs=1e-6)
        assert np.add(at, by) == pytest.approx((140, 65))
        ends = tools.document.deformation.forward([(100, 50), at])
        np.testing.assert_allclose(ends, [(110, 50), (140, 65)], atol=1e-6)
        drag(tools, (281, 131), (291, 131))  # its end is edited
        (stroke,) = tools.document.strokes
        assert np.add(*stroke.handles[1]) == pytest.approx((145, 65))
        for _ in range(2):
            press(tools, "z", "Control")
        assert state(tools) == before

    def test_without_a_grab_it_begins_one(self) -> None:
        for tools in (image(), image(Stroke(brush="twist", at=(50, 50), angle=30, radius=20)), image(BENT)):
            tools.document.select(0 if tools.document.strokes else None)
            if tools.document.strokes and tools.document.strokes[0] is BENT:
                tools.document.hide(0)
            press(tools, "d")
            drag(tools, (201, 101), (201, 101))
            stroke = tools.document.strokes[-1]
            assert (stroke.at, stroke.by, stroke.also) == ((100, 50), (0, 0), ())
            drag(tools, (281, 101), (291, 101))
            assert len(tools.document.strokes[-1].also) == 1

    def test_one_that_cannot_be_is_refused_and_said(self) -> None:
        tools = image(on_fold="flow")
        tools.radius = 40
        drag(tools, (201, 101), (261, 101))
        press(tools, "d")
        before = state(tools)
        drag(tools, (221, 101), (221, 101))
        assert state(tools) == before
        assert "meet on their straight ways" in (tools.status or "")
        assert not tools.document.dragging


class TestSymmetry:
    """The middle of 300 pixels is at 149.5."""

    def test_a_grab_is_one_stroke_of_two_points(self) -> None:
        tools = image()
        press(tools, "m")
        assert tools.symmetric
        stroke = drawn(tools, "g", (201, 101), (221, 111))
        assert (stroke.at, stroke.by) == ((100, 50), (10, 5))
        assert stroke.also == (((199, 50), (-10, 5)),)
        points = [(120.0, 70.0), (179.0, 70.0)]
        left, right = tools.document.deformation.forward(points)
        assert (left[0] + right[0], left[1]) == pytest.approx((299, right[1]))
        press(tools, "m")
        assert drawn(tools, "g", (301, 301), (321, 301)).also == ()

    def test_on_the_line_it_stays_there(self) -> None:
        tools = image()
        press(tools, "m")
        x, y = tools.view.to_canvas(149.5, 50)
        stroke = drawn(tools, "g", (x, y), (x + 20, y + 20))
        assert stroke.by == pytest.approx((0, 10))
        assert stroke.also == ()

    @pytest.mark.parametrize("key", list("twpnf"))
    def test_others_are_two_strokes_and_one_step(self, key: str) -> None:
        tools = image(on_fold="flow")
        press(tools, "m")
        press(tools, key)
        before = state(tools)
        drag(tools, (201, 101), (211, 111), (241, 121))
        one, other = tools.document.strokes
        assert other.at == (199, 50)
        assert other == one.mirrored((149.5, 0), (1, 0))
        assert tools.document.selected == 0
        press(tools, "z", "Control")
        assert state(tools) == before

    def test_a_path_cannot_begin_on_the_line_which_is_said(self) -> None:
        tools = image(on_fold="flow")
        for key in "mf":
            press(tools, key)
        x, y = tools.view.to_canvas(149.5, 50)
        drag(tools, (x, y), (x + 20, y), (x + 40, y + 40))
        assert tools.document.strokes == ()
        assert "line of symmetry" in (tools.status or "")
        assert tools.held is None

    def test_dabs_have_images(self) -> None:
        tools = image(BENT, Stroke(at=(60, 50), by=(8, 0), radius=20), Stroke(at=(239, 50), by=(-8, 0), radius=20))
        tools.radius = 20
        for key in "mr":
            press(tools, key)
        drag(tools, (137, 101), (137, 101))
        (both,) = tools.document.strokes[3:]
        points = [at for at, _ in both.handles]
        assert (points[0], points[7]) == ((68, 50), (231, 50))

    def test_an_edit_of_one_that_is_alone_is_not_mirrored(self) -> None:
        tools = image(Stroke(at=(100, 50), by=(10, 5), radius=20))
        press(tools, "m")
        tools.document.select(0)
        drag(tools, (221, 111), (241, 111))
        (stroke,) = tools.document.strokes
        assert stroke == Stroke(at=(100, 50), by=(20, 5), radius=20)

    def test_an_edit_of_a_point_moves_its_image_too(self) -> None:
        tools = image()
        press(tools, "m")
        drawn(tools, "g", (201, 101), (221, 111))
        place = tools.view.to_canvas
        drag(tools, place(189, 55), place(185, 65))  # the end of the image
        drag(tools, place(100, 50), place(90, 52))  # the point itself
        (stroke,) = tools.document.strokes
        (at, by), (image_at, image_by) = stroke.handles
        assert at == pytest.approx((90, 52))
        assert by == pytest.approx((14, 15))
        assert image_at == pytest.approx((209, 52))
        assert image_by == pytest.approx((-14, 15))
        # Numbers that are typed are edits, too.
        typed = tools.paired(stroke, replace(stroke, by=(3.0, 1.0)))
        assert typed.also[0][1] == (-3, 1)
        # One step each: undo takes both back.
        press(tools, "z", "Control")
        assert tools.document.strokes[0].also[0][0] == pytest.approx((199, 50))

    def test_an_edit_of_a_point_on_the_line_stays_there(self) -> None:
        tools = image()
        press(tools, "m")
        x, y = tools.view.to_canvas(149.5, 50)
        drawn(tools, "g", (x, y), (x, y + 20))
        drag(tools, (x, y + 20), (x + 16, y + 40))
        (stroke,) = tools.document.strokes
        assert stroke.by == pytest.approx((0, 20))

    def test_pins_come_and_go_in_pairs(self) -> None:
        tools = image()
        press(tools, "m")
        drawn(tools, "g", (201, 101), (221, 111))
        press(tools, "d")
        place = tools.view.to_canvas(70, 80)
        drag(tools, place, place)
        assert len(tools.document.strokes[0].handles) == 4
        drag(tools, place, place)
        assert len(tools.document.strokes[0].handles) == 2

    def test_its_knob_moves_the_line_which_finds_the_middle(self) -> None:
        tools = image()
        assert tools.grip is None
        press(tools, "m")
        grip = tools.grip
        assert grip is not None
        drag(tools, grip, (grip[0] - 60, grip[1] + 30))
        assert tools.middle == pytest.approx(119.5)
        assert tools.document.strokes == ()
        stroke = drawn(tools, "g", (201, 101), (221, 111))
        assert stroke.also == (((139, 50), (-10, 5)),)
        drag(tools, tools.grip, (9000, 0))
        assert tools.middle == 299.5
        drag(tools, tools.grip, (grip[0] + 2, 0))
        assert tools.middle == 149.5
        press(tools, "m")
        down(tools, *grip)  # which is not there any more
        assert tools.held is not None

    def test_its_upper_knob_tilts_the_line_about_the_lower_one(self) -> None:
        tools = image()
        assert tools.tilt is None
        press(tools, "m")
        grip, tilt = tools.grip, tools.tilt
        assert grip is not None
        assert tilt is not None
        drag(tools, tilt, (tilt[0] + 60, tilt[1] + 500))  # only to the side
        slope = 60 / (tilt[1] - grip[1])
        assert tools.lean == pytest.approx(slope)
        assert tools.grip == pytest.approx(grip)
        assert tools.tilt == pytest.approx((tilt[0] + 60, tilt[1]))
        stroke = drawn(tools, "g", (201, 101), (221, 111))
        wanted = Stroke.grab(stroke.at, by=stroke.by, radius=stroke.radius)
        one, other = (tools.view.to_image(*at) for at in (grip, tools.tilt))
        (wanted,) = wanted.symmetric(one, (other[1] - one[1], one[0] - other[0]))
        assert np.allclose(stroke.also, wanted.also, atol=1e-9)
        # An edit of one point moves its image, and the lower knob moves the line as it is.
        end = tools.view.to_canvas(*np.add(stroke.at, stroke.by))
        press(tools, "g")
        drag(tools, end, (end[0] + 10, end[1] + 6))
        edited = tools.document.strokes[0]
        assert np.allclose(edited.also, edited.mirrored(*tools.mirror(2)).handles[:1], atol=1e-9)
        drag(tools, tools.grip, (grip[0] + 30, grip[1]))
        assert tools.lean == pytest.approx(slope)
        assert tools.grip == pytest.approx((grip[0] + 30, grip[1]))
        drag(tools, tools.tilt, (tools.grip[0] + 1, 0))
        assert tools.lean == 0

    def test_what_has_no_room_for_an_image_has_none(self) -> None:
        tools = image()
        press(tools, "m")
        tools.middle = 80.0
        assert drawn(tools, "g", (401, 101), (421, 111)).also == ()
        assert len(drawn(tools, "g", (101, 101), (121, 111)).handles) == 2

    def test_the_knob_of_a_volume_is_in_two_planes(self) -> None:
        tools = bench()
        press(tools, "m")
        assert [tools.grip_of(k) is not None for k in range(4)] == [True, True, False, False]
        x, y = tools.grip_of(1)
        scale = tools.pane(1).scale * tools.geometry.spacing[0]
        drag(tools, (x, y), (x - 10 * scale, y))
        assert abs(tools.middle - 29.5) == pytest.approx(10)
        assert tools.grip_of(0)[0] == pytest.approx(tools.grip_of(1)[0])
        assert tools.document.strokes == ()

    def test_a_volume_has_a_plane_between_left_and_right(self) -> None:
        tools = bench()  # 60 voxels from left to right
        press(tools, "m")
        x, y = middle(tools, 0)
        stroke = drawn(tools, "g", (x + 60, y), (x + 70, y - 20), radius=6)
        ((at, by),) = stroke.also
        assert (stroke.at[0] + at[0], *stroke.at[1:]) == pytest.approx((59, *at[1:]))
        assert (-stroke.by[0], *stroke.by[1:]) == pytest.approx(by)


class TestClips:
    @pytest.mark.parametrize("key", list("twpn"))
    def test_they_stay_in_their_frame(self, key: str) -> None:
        tools = clip()
        tools.playback.seek(7)
        tools.radius = 20
        press(tools, key)
        down(tools, 201, 101)
        move(tools, 241, 101)
        wheel(tools, -100)  # is the radius
        press(tools, "ArrowRight")
        assert tools.playback.frame == 7
        up(tools, 241, 101)
        (stroke,) = tools.document.strokes
        assert stroke.at == (100, 50, 7)
        assert stroke.axis == ((20, 0, 0) if key == "n" else None)
        assert stroke.radius == pytest.approx(22)


class TestVolumes:
    @pytest.mark.parametrize("k", [0, 1, 2])
    @pytest.mark.parametrize("flips", [(1, 1, 1), (-1, -1, 1), (-1, 1, -1)])
    def test_a_twist_turns_in_its_plane_to_the_right(self, k: int, flips: tuple[int, ...]) -> None:
        tools = bench(np.diag(flips).astype(float), "LPS")
        x, y = middle(tools, k)
        pane = tools.pane(k)
        stroke = drawn(tools, "t", (x, y), (x + 20, y + 5), radius=12)
        assert stroke.axis is not None
        assert np.flatnonzero(stroke.axis).tolist() == [pane.plane.axis]
        assert stroke.angle == pytest.approx(90 * 20 / (12 * pane.scale))
        beside = pane.to_point(x + 4, y)
        moved = tuple(tools.document.deformation.forward([beside])[0])
        assert moved[pane.plane.axis] == pytest.approx(beside[pane.plane.axis])
        assert pane.to_canvas(moved)[1] > y + 0.5  # clockwise

    @pytest.mark.parametrize("k", [0, 1, 2])
    def test_a_pinch_is_along_the_drag(self, k: int) -> None:
        tools = bench()
        x, y = middle(tools, k)
        pane = tools.pane(k)
        stroke = drawn(tools, "n", (x, y), (x + 12, y - 16), radius=12)
        assert stroke.axis == pytest.approx(np.subtract(pane.to_point(x + 12, y - 16), pane.to_point(x, y)))
        assert stroke.factor == pytest.approx(math.exp(-20 / (24 * pane.scale)))

    def test_a_twist_of_the_rendering_is_about_the_line_of_sight(self) -> None:
        tools = solid()
        assert tools.active == RENDERED
        stroke = drawn(tools, "t", (200, 150), (220, 150), radius=5)
        assert stroke.axis is not None
        view = tools.stage.view(tools.view)
        along = np.array(stroke.axis) * view.spacing
        assert abs(along @ view.ahead) / np.linalg.norm(along) == pytest.approx(1)
        near = np.array(stroke.at) + view.packed[3] / np.linalg.norm(view.packed[3])  # to the right
        _, y = tools.projected(tuple(tools.document.deformation.forward([near])[0])) or (0, 0)
        assert y > (tools.projected(tuple(near)) or (0, 0))[1] + 0.5
        for key in "wpn":
            assert drawn(solid(), key, (200, 150), (220, 150), radius=5).at == pytest.approx((20, 20, 15))


def test_a_brush_is_chosen_by_its_key() -> None:
    from supple.viewer.tools.keys import BRUSHES

    tools = image()
    for name, (key, _) in BRUSHES.items():
        press(tools, key.lower())
        assert str(tools.brush) == name
    assert len({key for key, _ in BRUSHES.values()}) == len(BRUSHES)
