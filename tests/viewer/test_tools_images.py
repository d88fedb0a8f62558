"""What events do to pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from supple.strokes import Stroke
from supple.viewer.tools.gestures import Tools
from tests.viewer.tools import (
    LEFT,
    MIDDLE,
    RIGHT,
    arrived,
    click,
    down,
    drag,
    image,
    move,
    press,
    solid,
    up,
    wheel,
)


class TestTheCut:
    @pytest.mark.parametrize("make", [lambda: image(), lambda: solid()])
    def test_its_knob_is_dragged_and_nothing_is_bent(self, make: Callable[[], Tools[Any]]) -> None:
        tools = make()
        assert tools.knob_in(tools.place) is None
        press(tools, "b")
        assert tools.split == 0.5
        width, height = tools.place[2:]
        assert tools.knob_in(tools.place) == (width / 2, height / 2)
        before = tools.view
        drag(tools, tools.knob_in(tools.place), (0.3 * width, height / 2), (0.25 * width, 0.9 * height))
        assert tools.split == pytest.approx(0.25)
        assert tools.document.strokes == ()
        assert tools.view == before
        drag(tools, tools.knob_in(tools.place), (-50, 0))
        assert tools.split == 0.0
        drag(tools, tools.knob_in(tools.place), (2 * width, 0))
        assert tools.split == 1.0
        press(tools, "b")
        assert tools.split is None

    def test_beside_the_knob_the_picture_is_bent(self) -> None:
        tools = image()
        press(tools, "b")
        drag(tools, (300, 240), (330, 240))
        assert tools.split == 0.5
        assert len(tools.document.strokes) == 1


class TestImages:
    def test_a_drag_is_a_stroke(self) -> None:
        tools = image()
        tools.radius, tools.poisson, tools.scales = 40, 0.3, 2
        assert down(tools, 201, 101)
        assert not tools.dragging
        move(tools, 211, 105)
        assert tools.dragging
        assert tools.document.strokes[0].by == (5, 2)
        up(tools, 221, 111)
        assert not tools.dragging
        (stroke,) = tools.document.strokes
        assert stroke == Stroke(at=(100, 50), by=(10, 5), radius=40, poisson=0.3, scales=2)
        assert tools.document.selected == 0
        press(tools, "z", "Control")
        assert tools.document.strokes == ()
        assert not tools.document.can_undo

    def test_beside_the_picture_there_is_nothing_to_pull(self) -> None:
        tools = image()
        tools.view = tools.view.zoom_about(300, 200, 0.5)
        view = tools.view
        drag(tools, (10, 10), (200, 200))
        assert tools.document.strokes == ()
        assert tools.view == view

    def test_the_wheel_is_the_radius(self) -> None:
        tools = image()
        tools.radius = 40
        wheel(tools, -100)
        assert tools.radius == pytest.approx(44)
        wheel(tools, 250)
        assert tools.radius == pytest.approx(44 * 1.1**-2.5)
        tools.radius = 40
        press(tools, "]")
        assert tools.radius == pytest.approx(44)
        press(tools, "[")
        assert tools.radius == pytest.approx(40)
        wheel(tools, -1e6)
        assert tools.radius == tools.radius_limits[1]
        wheel(tools, 1e6)
        assert tools.radius == tools.radius_limits[0] == 1

    def test_the_wheel_is_the_radius_of_the_running_drag(self) -> None:
        tools = image()
        tools.radius = 40
        down(tools, 201, 101)
        wheel(tools, -100)
        assert tools.document.strokes == ()
        move(tools, 221, 101)
        wheel(tools, -100)
        assert tools.document.strokes[0].radius == pytest.approx(48.4)
        up(tools, 221, 101)
        assert (tools.document.strokes[0].radius, tools.document.strokes[0].by) == (tools.radius, (10, 0))
        press(tools, "z", "Control")
        assert tools.document.strokes == ()

    def test_zooms_and_pans(self) -> None:
        tools = image()
        point = tools.view.to_image(150, 60)
        wheel(tools, -300, "Control", x=150, y=60)
        assert tools.view.zoom == pytest.approx(2 * 1.2**3)
        assert tools.view.to_image(150, 60) == pytest.approx(point)
        for button, modifiers in [(MIDDLE, ()), (LEFT, ("Alt",))]:
            point = tools.view.to_image(300, 200)
            drag(tools, (300, 200), (310, 190), (280, 230), button=button, modifiers=modifiers)
            assert tools.view.to_canvas(*point) == pytest.approx((280, 230))
        assert tools.document.strokes == ()
        press(tools, "1")
        assert tools.view.percent == 100
        press(tools, "0")
        assert tools.view == image().view

    def test_zooming_while_panning(self) -> None:
        tools = image()
        tools.view = tools.view.zoom_about(300, 200, 4)
        down(tools, 300, 200, button=MIDDLE)
        move(tools, 320, 200, buttons=(MIDDLE,))
        point = tools.view.to_image(320, 200)
        wheel(tools, -100, "Control", x=320, y=200)
        move(tools, 330, 210, buttons=(MIDDLE,))
        assert tools.view.to_canvas(*point) == pytest.approx((330, 210))

    def test_escape_takes_back_zooming_too(self) -> None:
        tools = image()
        view = tools.view
        down(tools, 300, 200, button=MIDDLE)
        wheel(tools, -100, "Control")
        move(tools, 320, 200, buttons=(MIDDLE,))
        press(tools, "Escape")
        assert tools.view is view

    def test_clicks_select(self) -> None:
        strong = Stroke(at=(200, 100), by=(300, 0), radius=30)
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30), strong)
        tools.document.set_rest(on_fold="damp")
        end = arrived(tools, 1)
        assert end[0] < 350
        for point, chosen in [
            ((50, 50), 0), ((70, 50), 0), ((90, 90), None), ((200, 100), 1), (end, 1),
            ((20, 20), None),
        ]:  # fmt: skip
            x, y = tools.view.to_canvas(*point)
            click(tools, x + 5, y - 5)
            assert tools.document.selected == chosen
        assert not tools.document.can_undo
        tools.document.hide(0)
        click(tools, *tools.view.to_canvas(50, 50))
        assert tools.document.selected is None

    def test_of_several_handles_the_nearest_is_taken(self) -> None:
        tools = image(*(Stroke(at=(50 + k, 50), by=(9, 90), radius=30) for k in (0, 2, 2)))
        click(tools, 99, 101)
        assert tools.document.selected == 0
        click(tools, 106, 101)
        assert tools.document.selected == 2

    def test_an_end_is_dragged(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30), Stroke(at=(200, 100), by=(300, 0), radius=30))
        tools.document.select(0)
        drag(tools, (144, 104), (164, 114))  # taken three pixels from its handle, which does not jump
        assert tools.document.strokes[0].by == pytest.approx((30, 5))
        assert len(tools.document.strokes) == 2
        tools.document.select(1)
        tools.document.set_rest(on_fold="damp")
        end = arrived(tools, 1)
        x, y = tools.view.to_canvas(*end)
        drag(tools, (x, y), (x - 4, y))
        assert tools.document.strokes[1].by == pytest.approx((end[0] - 202, 0))
        assert arrived(tools, 1) == pytest.approx((end[0] - 2, 100))
        tools.document.undo()
        assert tools.document.strokes[1].by == (300, 0)

    def test_a_pivot_is_dragged(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        tools.document.select(0)
        drag(tools, (101, 101), (121, 141))
        assert tools.document.strokes[0] == Stroke(at=(60, 70), by=(20, 0), radius=30)

    def test_the_radius_of_a_stroke_that_is_held(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        brush = tools.radius
        tools.document.select(0)
        down(tools, 101, 101)
        wheel(tools, -100)
        up(tools, 101, 101)
        assert tools.document.strokes[0] == Stroke(at=(50, 50), by=(20, 0), radius=30 * 1.1)
        assert tools.radius == brush
        tools.document.undo()
        assert tools.document.strokes[0].radius == 30

    def test_a_handle_that_is_only_clicked_changes_nothing(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        tools.document.select(0)
        before = tools.document.state
        drag(tools, (102, 101), (150, 150), (103, 101))
        assert tools.document.state is before
        assert not tools.document.can_undo

    def test_keys(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        document = tools.document
        assert press(tools, "Delete")
        assert len(document.strokes) == 1  # nothing is selected
        document.select(0)
        press(tools, "h")
        assert document.strokes[0].hidden
        press(tools, "h")
        assert not document.strokes[0].hidden
        press(tools, "Delete")
        assert document.strokes == ()
        for key, modifiers, count in [
            ("z", ("Control",), 1), ("Z", ("Control", "Shift"), 0), ("z", ("Meta",), 1), ("y", ("Control",), 0),
            ("z", ("Control",), 1),
        ]:  # fmt: skip
            press(tools, key, *modifiers)
            assert len(document.strokes) == count
        document.select(0)
        press(tools, "Escape")
        assert document.selected is None
        for key in "soe":
            press(tools, key, "Control")
        assert tools.requests == ["save", "open", "export"]
        assert not press(tools, "q")
        assert not press(tools, "q", "Control")
        press(tools, "\\")
        assert tools.original
        tools.handle({"event_type": "key_up", "key": "a", "modifiers": ()})
        assert tools.original
        tools.handle({"event_type": "key_up", "key": "\\", "modifiers": ()})
        assert not tools.original

    def test_what_is_under_the_pointer(self) -> None:
        tools = image()
        assert tools.hover is None
        assert not move(tools, 201, 101, buttons=())
        assert tools.hover == (100, 50)
        tools.handle({"event_type": "pointer_leave"})
        assert tools.hover is None

    def test_other_events_are_not_for_it(self) -> None:
        tools = image()
        assert not tools.handle({"event_type": "char", "data": "a"})
        assert not tools.handle({"event_type": "double_click", "x": 1, "y": 1})
        assert not down(tools, 10, 10, button=5)
        assert not up(tools, 10, 10)
        assert not press(tools, "F7")

    def test_a_right_drag_sets_the_size_of_the_brush(self) -> None:
        tools = image()
        tools.radius = 20
        ring = tools.extent[0] * 20 * 2  # logical pixels
        down(tools, 201, 101, button=RIGHT)
        assert tools.sizing == (201, 101)
        move(tools, 201 + ring, 130, buttons=(RIGHT,))  # its edge follows the pointer
        assert tools.radius == pytest.approx(40)
        up(tools, 201 + ring, 130, button=RIGHT)
        assert tools.sizing is None
        down(tools, 201, 101, button=RIGHT)
        move(tools, 0, 101, buttons=(RIGHT,))
        assert tools.radius < 40
        press(tools, "Escape")
        assert tools.radius == pytest.approx(40)
        assert tools.document.strokes == ()

    def test_handles_can_be_hidden(self) -> None:
        tools = image(Stroke(at=(100, 50), by=(20, 0), radius=20))
        tools.document.select(0)
        assert len(tools.handles()) == 2
        press(tools, "h", "Control")
        assert tools.handles() == []
        drag(tools, (241, 101), (251, 101))  # where one was: another stroke
        assert len(tools.document.strokes) == 2
        press(tools, "h", "Control")
        assert tools.handles()

    def test_one_button_at_a_time(self) -> None:
        tools = image()
        down(tools, 201, 101)
        down(tools, 211, 101, button=MIDDLE)
        move(tools, 221, 101, buttons=(LEFT, MIDDLE))
        up(tools, 221, 101, button=MIDDLE)
        up(tools, 231, 101)
        assert [stroke.by for stroke in tools.document.strokes] == [(15, 0)]
        assert tools.view == image().view

    def test_a_button_that_went_up_unseen(self) -> None:
        tools = image()
        down(tools, 201, 101)
        move(tools, 221, 101)
        move(tools, 400, 300, buttons=())
        assert [stroke.by for stroke in tools.document.strokes] == [(10, 0)]
        assert not tools.dragging

    def test_what_is_refused_is_told(self) -> None:
        tools = image(on_fold="error")
        tools.radius = 20
        down(tools, 201, 101)
        move(tools, 211, 101)
        move(tools, 591, 101)
        assert tools.document.strokes[0].by == (5, 0)
        assert "folds" in (tools.status or "")
        up(tools, 591, 101)
        assert tools.document.strokes[0].by == (5, 0)
        drag(tools, (201, 301), (591, 301))
        assert len(tools.document.strokes) == 1
        assert "folds" in (tools.status or "")
        press(tools, "a")
        assert tools.status is None
        tools.document.hide(0)
        tools.document.replace(0, Stroke(at=(9, 9), by=(290, 0), radius=2))
        tools.document.select(0)
        assert press(tools, "h")
        assert "folds" in (tools.status or "")
        assert tools.document.strokes[0].hidden
