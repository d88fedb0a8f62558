"""What events do to volumes."""

from __future__ import annotations

from typing import Any

import pytest

from supple.render.camera import Camera
from supple.render.picture import Pick
from supple.strokes import Stroke
from tests.viewer.tools import LEFT, MIDDLE, RIGHT, click, down, drag, move, press, solid, wheel


class TestVolumes:
    def test_what_is_picked_is_pulled(self) -> None:
        tools = solid()
        tools.radius = 9
        asked: list[Any] = []
        tools.drag = lambda pick, to: asked.append((pick.index, to)) or (1.0, 2.0, 3.0)  # type: ignore[func-returns-value]
        camera = tools.view
        drag(tools, (200, 150), (220, 140))
        assert tools.document.strokes[0] == Stroke(at=(20, 20, 15), by=(1, 2, 3), radius=9)
        assert asked[-1] == ((20, 20, 15), (220, 140))
        assert tools.view is camera

    def test_what_is_picked_lies_in_the_volume(self) -> None:
        tools = solid()
        tools.pick = lambda x, y: Pick((-0.6, 20, 39.7), (0, 0, 0), 5)
        drag(tools, (200, 150), (205, 150))
        assert tools.document.strokes[0].at == (-0.5, 20, 39.5)

    def test_the_ring_is_as_large_as_the_brush_where_it_is(self) -> None:
        tools = solid()
        tools.radius = 4
        move(tools, 200, 150, buttons=())
        assert tools.hover == (20, 20, 15)
        at = tools.stage.project(tools.view, (20, 20, 15))
        # It is seen along y: a brush that is across lies in x and z.
        beside = tools.stage.project(tools.view, (24, 20, 15))
        assert at is not None
        assert beside is not None
        assert tools.ring == pytest.approx(abs(beside[0] - at[0]), rel=1e-6)
        first = tools.ring
        wheel(tools, -100, "Shift", x=200, y=150)
        assert tools.ring == pytest.approx(1.1 * first)
        move(tools, 10, 10, buttons=())
        assert tools.ring is None

    def test_a_ray_is_sent_once_for_what_is_the_same(self) -> None:
        tools = solid()
        sent: list[tuple[float, float]] = []
        pick = tools.pick
        tools.pick = lambda x, y: sent.append((x, y)) or pick(x, y)  # type: ignore[func-returns-value]
        move(tools, 200, 150, buttons=())
        for _ in range(3):
            assert tools.under is not None
            assert tools.hover is not None
        assert len(sent) == 1
        wheel(tools, -100, x=200, y=150)  # nearer
        assert tools.hover is not None
        assert len(sent) == 2

    @pytest.mark.parametrize(("x", "button"), [(10, LEFT), (200, RIGHT)])
    def test_beside_it_or_to_the_right_the_camera_turns(self, x: float, button: int) -> None:
        tools = solid()
        drag(tools, (x, 150), (x + 30, 150), (x + 50, 180), button=button)
        assert tools.document.strokes == ()
        assert (tools.view.azimuth, tools.view.elevation) == (-30, 18)
        press(tools, "0")
        assert tools.view == Camera()

    def test_pans_and_dollies(self) -> None:
        tools = solid()
        middle = tools.stage.target(tools.view)
        drag(tools, (200, 150), (230, 140), button=MIDDLE)
        found = tools.stage.project(tools.view, middle)
        assert found is not None
        assert found[:2] == pytest.approx((230, 140), abs=0.5)
        away = tools.stage.view(tools.view).distance
        wheel(tools, -100)
        assert tools.view.distance == pytest.approx(away / 1.1)
        tools.radius = 8
        camera = tools.view
        wheel(tools, -100, "Shift")
        assert tools.radius == pytest.approx(8.8)
        wheel(tools, 0, "Shift", dx=100)
        assert tools.radius == pytest.approx(8)
        assert tools.view is camera

    def test_the_camera_stays_while_something_is_held(self) -> None:
        tools = solid()
        tools.radius = 8
        down(tools, 200, 150)
        move(tools, 220, 150)
        camera = tools.view
        wheel(tools, -100)
        press(tools, "0")
        assert tools.view is camera
        assert tools.document.strokes[0].radius == pytest.approx(8.8)

    def test_clicks_select_and_handles_are_dragged(self) -> None:
        tools = solid(Stroke(at=(30, 10, 20), by=(4, 0, 0), radius=10))
        (pivot, end) = tools.handles()
        assert (pivot.part, end.part) == ("pivot", "end")
        click(tools, *end.seen)
        assert tools.document.selected == 0
        x, y = end.seen
        drag(tools, (x + 2, y), (x + 2, y - 30))
        stroke = tools.document.strokes[0]
        assert stroke.by[0] == pytest.approx(4)
        assert stroke.by[1] == pytest.approx(0, abs=1e-9)
        assert stroke.by[2] > 2
        assert tools.handles()[1].seen == pytest.approx((x, y - 30))
        x, y = pivot.seen
        drag(tools, (x, y), (x + 20, y))
        moved = tools.document.strokes[0]
        assert moved.by == stroke.by
        assert moved.at[0] > 31
        click(tools, 10, 10)
        assert tools.document.selected is None

    def test_a_click_on_the_object_makes_nothing(self) -> None:
        tools = solid()
        click(tools, 200, 150)
        assert (tools.document.strokes, tools.document.can_undo) == ((), False)

    def test_resizes(self) -> None:
        tools = solid()
        tools.handle({"event_type": "resize", "width": 640.4, "height": 0, "pixel_ratio": 1})
        assert tools.stage.size == (1, 640)
