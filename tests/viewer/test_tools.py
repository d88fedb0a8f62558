"""What events do to pictures, to clips and to volumes."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from supple.geometry import Geometry
from supple.render.camera import Camera
from supple.render.picture import Pick
from supple.strokes import Recipe, Stroke
from supple.viewer.document import Document
from supple.viewer.playback import Playback
from supple.viewer.tools import ImageTools, Tools, VideoTools, VolumeTools

LEFT, RIGHT, MIDDLE = 1, 2, 3


def send(tools: Tools[Any], kind: str, x: float = 0, y: float = 0, *modifiers: str, **rest: Any) -> bool:
    event: dict[str, Any] = {"event_type": kind, "x": float(x), "y": float(y), "modifiers": modifiers}
    if kind == "wheel":
        event |= {"dx": 0.0, "dy": 0.0, "buttons": ()}
    return tools.handle(event | rest)


def down(tools: Tools[Any], x: float, y: float, *modifiers: str, button: int = LEFT) -> bool:
    return send(tools, "pointer_down", x, y, *modifiers, button=button, buttons=(button,))


def move(tools: Tools[Any], x: float, y: float, *modifiers: str, buttons: tuple[int, ...] = (LEFT,)) -> bool:
    return send(tools, "pointer_move", x, y, *modifiers, button=0, buttons=buttons)


def up(tools: Tools[Any], x: float, y: float, *modifiers: str, button: int = LEFT) -> bool:
    return send(tools, "pointer_up", x, y, *modifiers, button=button, buttons=())


def wheel(tools: Tools[Any], dy: float, *modifiers: str, x: float = 300, y: float = 200, dx: float = 0) -> bool:
    return send(tools, "wheel", x, y, *modifiers, dy=dy, dx=dx)


def press(tools: Tools[Any], key: str, *modifiers: str) -> bool:
    return tools.handle({"event_type": "key_down", "key": key, "modifiers": modifiers})


def drag(tools: Tools[Any], *path: tuple[float, float], button: int = LEFT, modifiers: tuple[str, ...] = ()) -> None:
    down(tools, *path[0], *modifiers, button=button)
    for x, y in path[1:]:
        move(tools, x, y, *modifiers, buttons=(button,))
    up(tools, *path[-1], *modifiers, button=button)


def click(tools: Tools[Any], x: float, y: float) -> None:
    drag(tools, (x, y), (x + 1, y))


def image(*strokes: Stroke, on_fold: Any = "damp") -> ImageTools:
    """A picture of 300 x 200 pixels, each two logical ones wide."""
    return ImageTools(Document((200, 300), recipe=Recipe(strokes=strokes, on_fold=on_fold)), (600, 400))


class TestTheCut:
    @pytest.mark.parametrize("make", [lambda: image(), lambda: solid()])
    def test_its_knob_is_dragged_and_nothing_is_bent(self, make: Callable[[], Tools[Any]]) -> None:
        tools = make()
        assert tools.knob is None
        press(tools, "b")
        assert tools.split == 0.5
        width, height = tools.canvas_size
        assert tools.knob == (width / 2, height / 2)
        before = tools.view
        drag(tools, tools.knob, (0.3 * width, height / 2), (0.25 * width, 0.9 * height))
        assert tools.split == pytest.approx(0.25)
        assert tools.document.items == ()
        assert tools.view == before
        drag(tools, tools.knob, (-50, 0))
        assert tools.split == 0.0
        drag(tools, tools.knob, (2 * width, 0))
        assert tools.split == 1.0
        press(tools, "b")
        assert tools.split is None

    def test_beside_the_knob_the_picture_is_bent(self) -> None:
        tools = image()
        press(tools, "b")
        drag(tools, (300, 240), (330, 240))
        assert tools.split == 0.5
        assert len(tools.document.items) == 1


class TestImages:
    def test_a_drag_is_a_stroke(self) -> None:
        tools = image()
        tools.radius, tools.poisson, tools.scales = 40, 0.3, 2
        assert down(tools, 201, 101)
        assert not tools.dragging
        move(tools, 211, 105)
        assert tools.dragging
        assert tools.document.items[0].stroke.by == (5, 2)
        up(tools, 221, 111)
        assert not tools.dragging
        (item,) = tools.document.items
        assert item.stroke == Stroke(at=(100, 50), by=(10, 5), radius=40, poisson=0.3, scales=2)
        assert tools.document.selected == 0
        press(tools, "z", "Control")
        assert tools.document.items == ()
        assert not tools.document.can_undo

    def test_beside_the_picture_there_is_nothing_to_pull(self) -> None:
        tools = image()
        tools.viewport = tools.viewport.zoom_about(300, 200, 0.5)
        view = tools.viewport
        drag(tools, (10, 10), (200, 200))
        assert tools.document.items == ()
        assert tools.viewport == view

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
        assert tools.document.items == ()
        move(tools, 221, 101)
        wheel(tools, -100)
        assert tools.document.items[0].stroke.radius == pytest.approx(48.4)
        up(tools, 221, 101)
        assert (tools.document.items[0].stroke.radius, tools.document.items[0].stroke.by) == (tools.radius, (10, 0))
        press(tools, "z", "Control")
        assert tools.document.items == ()

    def test_zooms_and_pans(self) -> None:
        tools = image()
        point = tools.viewport.to_image(150, 60)
        wheel(tools, -300, "Control", x=150, y=60)
        assert tools.viewport.zoom == pytest.approx(2 * 1.2**3)
        assert tools.viewport.to_image(150, 60) == pytest.approx(point)
        for button, modifiers in [(MIDDLE, ()), (LEFT, ("Alt",))]:
            point = tools.viewport.to_image(300, 200)
            drag(tools, (300, 200), (310, 190), (280, 230), button=button, modifiers=modifiers)
            assert tools.viewport.to_canvas(*point) == pytest.approx((280, 230))
        assert tools.document.items == ()
        press(tools, "1")
        assert tools.viewport.percent == 100
        press(tools, "0")
        assert tools.viewport == image().viewport

    def test_zooming_while_panning(self) -> None:
        tools = image()
        tools.viewport = tools.viewport.zoom_about(300, 200, 4)
        down(tools, 300, 200, button=MIDDLE)
        move(tools, 320, 200, buttons=(MIDDLE,))
        point = tools.viewport.to_image(320, 200)
        wheel(tools, -100, "Control", x=320, y=200)
        move(tools, 330, 210, buttons=(MIDDLE,))
        assert tools.viewport.to_canvas(*point) == pytest.approx((330, 210))

    def test_escape_takes_back_zooming_too(self) -> None:
        tools = image()
        view = tools.viewport
        down(tools, 300, 200, button=MIDDLE)
        wheel(tools, -100, "Control")
        move(tools, 320, 200, buttons=(MIDDLE,))
        press(tools, "Escape")
        assert tools.viewport is view

    def test_clicks_select(self) -> None:
        strong = Stroke(at=(200, 100), by=(300, 0), radius=30)
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30), strong)
        tools.document.set_on_fold("damp")
        end = arrived(tools, 1)
        assert end[0] < 350
        for point, chosen in [
            ((50, 50), 0), ((70, 50), 0), ((90, 90), None), ((200, 100), 1), (end, 1),
            ((20, 20), None),
        ]:  # fmt: skip
            x, y = tools.viewport.to_canvas(*point)
            click(tools, x + 5, y - 5)
            assert tools.document.selected == chosen
        assert not tools.document.can_undo
        tools.document.hide(0)
        click(tools, *tools.viewport.to_canvas(50, 50))
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
        assert tools.document.items[0].stroke.by == pytest.approx((30, 5))
        assert len(tools.document.items) == 2
        tools.document.select(1)
        tools.document.set_on_fold("damp")
        end = arrived(tools, 1)
        x, y = tools.viewport.to_canvas(*end)
        drag(tools, (x, y), (x - 4, y))
        assert tools.document.items[1].stroke.by == pytest.approx((end[0] - 202, 0))
        assert arrived(tools, 1) == pytest.approx((end[0] - 2, 100))
        tools.document.undo()
        assert tools.document.items[1].stroke.by == (300, 0)

    def test_a_pivot_is_dragged(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        tools.document.select(0)
        drag(tools, (101, 101), (121, 141))
        assert tools.document.items[0].stroke == Stroke(at=(60, 70), by=(20, 0), radius=30)

    def test_the_radius_of_a_stroke_that_is_held(self) -> None:
        tools = image(Stroke(at=(50, 50), by=(20, 0), radius=30))
        brush = tools.radius
        tools.document.select(0)
        down(tools, 101, 101)
        wheel(tools, -100)
        up(tools, 101, 101)
        assert tools.document.items[0].stroke == Stroke(at=(50, 50), by=(20, 0), radius=30 * 1.1)
        assert tools.radius == brush
        tools.document.undo()
        assert tools.document.items[0].stroke.radius == 30

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
        assert len(document.items) == 1  # nothing is selected
        document.select(0)
        press(tools, "h")
        assert document.items[0].hidden
        press(tools, "h")
        assert not document.items[0].hidden
        press(tools, "Delete")
        assert document.items == ()
        for key, modifiers, count in [
            ("z", ("Control",), 1), ("Z", ("Control", "Shift"), 0), ("z", ("Meta",), 1), ("y", ("Control",), 0),
            ("\x1a", ("Control",), 1),
        ]:  # fmt: skip
            press(tools, key, *modifiers)
            assert len(document.items) == count
        document.select(0)
        press(tools, "Escape")
        assert document.selected is None
        for key in "soe":
            press(tools, key, "Control")
        assert tools.requests == ["save", "open", "export"]
        assert not press(tools, "s")
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

    def test_resizes(self) -> None:
        tools = image()
        tools.handle({"event_type": "resize", "width": 300.0, "height": 500.0, "pixel_ratio": 2.0})
        assert (tools.viewport.zoom, tools.viewport.percent) == (1, 200)

    def test_other_events_are_not_for_it(self) -> None:
        tools = image()
        assert not tools.handle({"event_type": "char", "data": "a"})
        assert not tools.handle({"event_type": "double_click", "x": 1, "y": 1})
        assert not down(tools, 10, 10, button=RIGHT)
        assert not up(tools, 10, 10)
        assert not press(tools, "F7")

    def test_one_button_at_a_time(self) -> None:
        tools = image()
        down(tools, 201, 101)
        down(tools, 211, 101, button=MIDDLE)
        move(tools, 221, 101, buttons=(LEFT, MIDDLE))
        up(tools, 221, 101, button=MIDDLE)
        up(tools, 231, 101)
        assert [item.stroke.by for item in tools.document.items] == [(15, 0)]
        assert tools.viewport == image().viewport

    def test_a_button_that_went_up_unseen(self) -> None:
        tools = image()
        down(tools, 201, 101)
        move(tools, 221, 101)
        move(tools, 400, 300, buttons=())
        assert [item.stroke.by for item in tools.document.items] == [(10, 0)]
        assert not tools.dragging

    def test_what_is_refused_is_told(self) -> None:
        tools = image(on_fold="error")
        tools.radius = 20
        down(tools, 201, 101)
        move(tools, 211, 101)
        move(tools, 591, 101)
        assert tools.document.items[0].stroke.by == (5, 0)
        assert "folds" in (tools.status or "")
        up(tools, 591, 101)
        assert tools.document.items[0].stroke.by == (5, 0)
        drag(tools, (201, 301), (591, 301))
        assert len(tools.document.items) == 1
        assert "folds" in (tools.status or "")
        press(tools, "a")
        assert tools.status is None
        tools.document.hide(0)
        tools.document.replace(0, Stroke(at=(9, 9), by=(290, 0), radius=2))
        tools.document.select(0)
        assert press(tools, "h")
        assert "folds" in (tools.status or "")
        assert tools.document.items[0].hidden


def arrived(tools: Tools[Any], i: int) -> tuple[float, ...]:
    arrival = tools.document.arrival(i)
    assert arrival is not None
    return arrival.arrived


def clip(*strokes: Stroke, count: int = 20) -> VideoTools:
    document = Document((count, 200, 300), recipe=Recipe(border=None, strokes=strokes), kind="video")
    return VideoTools(document, Playback(count, 10), (600, 400))


class TestVideos:
    def test_a_pixel_is_carried_through_time(self) -> None:
        tools = clip()
        tools.radius = 40
        tools.playback.seek(5)
        tools.playback.play()
        down(tools, 201, 101)
        assert not tools.playback.playing
        wheel(tools, -300)
        assert (tools.playback.frame, tools.document.items[0].stroke.by) == (8, (0, 0, 3))
        move(tools, 221, 101)
        up(tools, 221, 111)
        assert tools.document.items[0].stroke == Stroke(at=(100, 50, 5), by=(10, 5, 3), radius=40)
        assert (tools.playback.frame, tools.radius) == (8, 40)
        tools.document.undo()
        assert tools.document.items == ()

    def test_parts_of_a_notch_add_up_to_whole_frames(self) -> None:
        tools = clip()
        tools.playback.seek(5)
        down(tools, 201, 101)
        seen = []
        for _ in range(6):
            wheel(tools, -40)
            seen.append((tools.playback.frame, tools.held.time if tools.held else None))
        assert seen == [(5, 0), (6, 1), (6, 1), (7, 2), (7, 2), (7, 2)]
        for _ in range(100):
            wheel(tools, -120)
        wheel(tools, 100)
        up(tools, 201, 101)
        assert tools.document.items[0].stroke.by == (0, 0, 13)  # the way back begins at the last frame

    def test_the_wheel_alone_is_the_radius(self) -> None:
        tools = clip()
        tools.radius = 40
        wheel(tools, -100)
        assert tools.radius == pytest.approx(44)
        assert tools.playback.frame == 0
        down(tools, 201, 101)
        wheel(tools, -100, "Shift")
        move(tools, 221, 101)
        assert tools.document.items[0].stroke.radius == pytest.approx(48.4)
        assert tools.playback.frame == 0

    def test_stays_within_the_clip(self) -> None:
        tools = clip()
        tools.playback.seek(15)
        down(tools, 201, 101)
        wheel(tools, -1e5)
        assert (tools.playback.frame, tools.document.items[0].stroke.by[2]) == (19, 4)
        wheel(tools, 1e5)
        assert (tools.playback.frame, tools.document.items[0].stroke.by[2]) == (0, -15)

    def test_arrows_carry_what_is_held(self) -> None:
        tools = clip()
        tools.playback.seek(5)
        down(tools, 201, 101)
        press(tools, "ArrowRight")
        press(tools, "ArrowRight")
        press(tools, " ")
        assert not tools.playback.playing
        up(tools, 201, 101)
        assert tools.document.items[0].stroke.by == (0, 0, 2)

    @pytest.mark.parametrize("end", ["escape", "undo", "back"])
    def test_is_put_back(self, end: str) -> None:
        tools = clip()
        tools.playback.seek(5)
        before, deformation = tools.document.state, tools.document.deformation
        down(tools, 201, 101)
        wheel(tools, -300)
        move(tools, 301, 101)
        if end == "escape":
            press(tools, "Escape")
        elif end == "undo":
            press(tools, "z", "Control")
        else:
            wheel(tools, 300)
            move(tools, 201, 101)
        up(tools, 201, 101)
        assert tools.playback.frame == 5
        assert tools.document.state is before
        assert tools.document.deformation is deformation

    def test_handles_are_where_they_are_in_time(self) -> None:
        tools = clip(Stroke(at=(50, 50, 3), by=(20, 0, 4), radius=60))
        tools.document.set_border(None)
        assert arrived(tools, 0) == (70, 50, 7)
        for frame, x, chosen in [(3, 50, 0), (3, 70, None), (7, 70, 0), (7, 50, None), (5, 60, None)]:
            tools.playback.seek(frame)
            click(tools, *tools.viewport.to_canvas(x, 50))
            assert tools.document.selected == chosen
        assert [handle.part for handle in tools.handles()] == []
        tools.playback.seek(7)
        assert [handle.part for handle in tools.handles()] == ["end"]
        tools.document.select(0)
        down(tools, 141, 101)
        wheel(tools, -200)
        up(tools, 151, 101)
        assert tools.document.items[0].stroke.by == pytest.approx((25, 0, 6))
        assert tools.playback.frame == 9
        tools.playback.seek(3)
        down(tools, 101, 101)
        wheel(tools, 100)
        up(tools, 101, 101)
        assert tools.document.items[0].stroke.at == (50, 50, 2)
        assert tools.document.items[0].stroke.by == pytest.approx((25, 0, 6))

    def test_between_two_frames(self) -> None:
        tools = clip(Stroke(at=(50, 50, 3), by=(20, 0, 0.5), radius=60))
        tools.document.set_border(None)
        tools.document.select(0)
        tools.playback.seek(3)
        down(tools, 141, 101)
        wheel(tools, -100)
        wheel(tools, 100)
        up(tools, 141, 101)
        assert tools.playback.frame == 3

    def test_plays(self) -> None:
        tools = clip()
        playback = tools.playback
        press(tools, " ")
        assert playback.playing
        playback.frame_at(0)
        playback.frame_at(0.35)
        press(tools, " ")
        press(tools, "ArrowRight")
        assert (playback.playing, playback.frame) == (False, 4)
        press(tools, "i")
        press(tools, "ArrowRight")
        press(tools, "o")
        assert (playback.first, playback.last) == (4, 5)
        press(tools, "u")
        assert (playback.first, playback.last) == (0, 19)
        press(tools, "i")
        press(tools, "o")
        assert (playback.first, playback.last) == (5, 5)
        press(tools, "u")
        playback.seek(4)
        press(tools, "i")
        playback.seek(5)
        press(tools, "o")
        press(tools, "l")
        assert playback.loop
        press(tools, "Home")
        press(tools, "Home")
        assert playback.frame == 0
        press(tools, "ArrowLeft")
        assert playback.frame == 0
        press(tools, "End")
        press(tools, "End")
        assert playback.frame == 19
        press(tools, "1")
        assert tools.viewport.percent == 100

    def test_hover_knows_the_time(self) -> None:
        tools = clip()
        tools.playback.seek(4)
        move(tools, 201, 101, buttons=())
        assert tools.hover == (100, 50, 4)


def solid(*strokes: Stroke) -> VolumeTools:
    """A volume whose object is a disc in the middle of the canvas."""
    document = Document((40, 50, 60), (1, 1, 1), Recipe(border=None, strokes=strokes), kind="volume")

    def pick(x: float, y: float) -> Pick | None:
        return Pick((x / 10, 20.0, y / 10), (0, 0, 0), 50.0) if np.hypot(x - 200, y - 150) < 100 else None

    def pull(pick: Pick, to: tuple[float, float]) -> tuple[float, ...]:
        # By the true camera, which the tools lead: it stands in front, and +z is up.
        assert tools is not None
        view = tools.stage.view(tools.camera)
        start = (np.array(pick.index) - view.eye) * view.spacing
        ray = view.direction(to[0] - 0.5, to[1] - 0.5)
        return tuple(ray * (start @ view.ahead) / (ray @ view.ahead) - start)

    tools = VolumeTools(document, Geometry(), (400, 300), pick, pull)
    return tools


class TestVolumes:
    def test_what_is_picked_is_pulled(self) -> None:
        tools = solid()
        tools.radius = 9
        asked: list[Any] = []
        tools.drag = lambda pick, to: asked.append((pick.index, to)) or (1.0, 2.0, 3.0)  # type: ignore[func-returns-value]
        camera = tools.camera
        drag(tools, (200, 150), (220, 140))
        assert tools.document.items[0].stroke == Stroke(at=(20, 20, 15), by=(1, 2, 3), radius=9)
        assert asked[-1] == ((20, 20, 15), (220, 140))
        assert tools.camera is camera

    def test_what_is_picked_lies_in_the_volume(self) -> None:
        tools = solid()
        tools.pick = lambda x, y: Pick((-0.6, 20, 39.7), (0, 0, 0), 5)
        drag(tools, (200, 150), (205, 150))
        assert tools.document.items[0].stroke.at == (-0.5, 20, 39.5)

    def test_the_ring_is_as_large_as_the_brush_where_it_is(self) -> None:
        tools = solid()
        tools.radius = 4
        move(tools, 200, 150, buttons=())
        assert tools.hover == (20, 20, 15)
        at = tools.stage.project(tools.camera, (20, 20, 15))
        # It is seen along y: a brush that is across lies in x and z.
        beside = tools.stage.project(tools.camera, (24, 20, 15))
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
        assert tools.document.items == ()
        assert (tools.camera.azimuth, tools.camera.elevation) == (-30, 18)
        press(tools, "0")
        assert tools.camera == Camera()

    def test_pans_and_dollies(self) -> None:
        tools = solid()
        middle = tools.stage.target(tools.camera)
        drag(tools, (200, 150), (230, 140), button=MIDDLE)
        found = tools.stage.project(tools.camera, middle)
        assert found is not None
        assert found[:2] == pytest.approx((230, 140), abs=0.5)
        away = tools.stage.distance(tools.camera)
        wheel(tools, -100)
        assert tools.camera.distance == pytest.approx(away / 1.1)
        tools.radius = 8
        camera = tools.camera
        wheel(tools, -100, "Shift")
        assert tools.radius == pytest.approx(8.8)
        wheel(tools, 0, "Shift", dx=100)
        assert tools.radius == pytest.approx(8)
        assert tools.camera is camera

    def test_the_camera_stays_while_something_is_held(self) -> None:
        tools = solid()
        tools.radius = 8
        down(tools, 200, 150)
        move(tools, 220, 150)
        camera = tools.camera
        wheel(tools, -100)
        press(tools, "0")
        assert tools.camera is camera
        assert tools.document.items[0].stroke.radius == pytest.approx(8.8)

    def test_clicks_select_and_handles_are_dragged(self) -> None:
        tools = solid(Stroke(at=(30, 10, 20), by=(4, 0, 0), radius=10))
        (pivot, end) = tools.handles()
        assert (pivot.part, end.part) == ("pivot", "end")
        click(tools, *end.seen)
        assert tools.document.selected == 0
        x, y = end.seen
        drag(tools, (x + 2, y), (x + 2, y - 30))
        stroke = tools.document.items[0].stroke
        assert stroke.by[0] == pytest.approx(4)
        assert stroke.by[1] == pytest.approx(0, abs=1e-9)
        assert stroke.by[2] > 2
        assert tools.handles()[1].seen == pytest.approx((x, y - 30))
        x, y = pivot.seen
        drag(tools, (x, y), (x + 20, y))
        moved = tools.document.items[0].stroke
        assert moved.by == stroke.by
        assert moved.at[0] > 31
        click(tools, 10, 10)
        assert tools.document.selected is None

    def test_a_click_on_the_object_makes_nothing(self) -> None:
        tools = solid()
        click(tools, 200, 150)
        assert (tools.document.items, tools.document.can_undo) == ((), False)

    def test_hover_is_what_is_seen(self) -> None:
        tools = solid()
        move(tools, 200, 150, buttons=())
        assert tools.hover == (20, 20, 15)
        move(tools, 1, 1, buttons=())
        assert tools.hover is None

    def test_resizes(self) -> None:
        tools = solid()
        tools.handle({"event_type": "resize", "width": 640.4, "height": 0, "pixel_ratio": 1})
        assert tools.stage.size == (1, 640)


ALL = pytest.mark.parametrize("make", [image, clip, solid])
Make = Callable[..., Tools[Any]]


def look(tools: Tools[Any]) -> tuple[Any, ...]:
    playback = tools.playback.frame if isinstance(tools, VideoTools) else None
    return tools.document.state, tools.view, playback


@ALL
def test_escape_at_any_point_restores(make: Make) -> None:
    n = 2 if make is image else 3
    some = Stroke(at=(30, 20, 10)[:n], by=(4, 0, 0)[:n], radius=9)
    path = [(200 + 3 * k, 150 + k) for k in range(12)]
    starts: list[tuple[tuple[float, float], int]] = [((200, 150), LEFT), ((5, 5), LEFT), ((200, 150), MIDDLE)]
    starts += [((200, 150), RIGHT), (make(some).handles()[0].seen if make is not clip else (61, 41), LEFT)]
    for (x, y), button in starts:
        for stop in range(len(path)):
            tools = make(some)
            tools.document.add(some)
            tools.document.undo()
            tools.document.select(0)
            if isinstance(tools, VideoTools):
                tools.playback.seek(10)
            before, deformation = look(tools), tools.document.deformation
            down(tools, x, y, button=button)
            for k, (a, b) in enumerate(path[:stop]):
                move(tools, a, b, buttons=(button,))
                if k % 3 == 1 and tools.held is not None:
                    wheel(tools, -100)
            pressed = tools._gesture is not None
            press(tools, "Escape")
            if pressed:
                assert look(tools) == before
                assert tools.document.deformation is deformation
                assert (tools.document.can_undo, tools.document.can_redo, tools.dragging) == (False, True, False)
            state = tools.document.state
            move(tools, 250, 200, buttons=(button,))
            up(tools, 260, 210, button=button)  # which is still to come
            assert tools.document.state is state


def merged(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """As the window may merge them: moves to the last one, wheels to their sum."""
    made: list[dict[str, Any]] = []
    for event in events:
        last = made[-1] if made else {}
        kind = event["event_type"]
        alike = all(last.get(name) == event.get(name) for name in ("event_type", "modifiers", "buttons"))
        if kind in ("pointer_move", "wheel") and alike:
            made.pop()
            if kind == "wheel":
                event = event | {name: event[name] + last[name] for name in ("dx", "dy")}
        made.append(event)
    return made


@ALL
@pytest.mark.parametrize("seed", range(12))
def test_merged_events_equal_single_ones(make: Make, seed: int) -> None:
    rng = random.Random(seed)
    x, y = 200.0, 150.0
    events: list[dict[str, Any]] = []
    for _ in range(12):
        button = rng.choice([LEFT, LEFT, LEFT, MIDDLE, RIGHT])
        pointer = {"button": button, "buttons": (button,)}
        events.append({"event_type": "pointer_down", "x": x, "y": y, "modifiers": (), **pointer})
        for _ in range(rng.randrange(6)):
            modifiers = rng.choice([(), (), ("Control",), ("Shift",)])
            for _ in range(rng.randrange(1, 5)):
                x, y = x + rng.uniform(-12, 12), y + rng.uniform(-9, 9)
                moved = {"event_type": "pointer_move", "button": 0, "buttons": (button,)}
                events.append({**moved, "x": x, "y": y, "modifiers": modifiers})
            turn = rng.choice([-20.0, 30.0])
            turned = {"event_type": "wheel", "x": x, "y": y, "dx": 0.0, "dy": turn, "modifiers": modifiers}
            events += [turned] * rng.randrange(4)
        events.append({"event_type": "pointer_up", "x": x, "y": y, "modifiers": (), **pointer, "buttons": ()})
        x, y = rng.uniform(120, 260), rng.uniform(100, 200)
    one, other = make(), make()
    for event in events:
        one.handle(event)
    few = merged(events)
    assert len(few) < 0.8 * len(events)
    for event in few:
        other.handle(event)
    assert len(one.document.items) == len(other.document.items) > 0
    assert one.document.selected == other.document.selected
    for a, b in zip(one.document.items, other.document.items, strict=True):
        assert b.stroke.at == pytest.approx(a.stroke.at)
        assert b.stroke.by == pytest.approx(a.stroke.by, abs=1e-9)
        assert b.stroke.radius == pytest.approx(a.stroke.radius)
    assert other.radius == pytest.approx(one.radius)
    if isinstance(one, ImageTools) and isinstance(other, ImageTools):
        assert other.viewport.zoom == pytest.approx(one.viewport.zoom)
        assert other.viewport.centre == pytest.approx(one.viewport.centre)
    if isinstance(one, VolumeTools) and isinstance(other, VolumeTools):
        assert one.stage.project(one.camera, (3, 4, 5)) == pytest.approx(other.stage.project(other.camera, (3, 4, 5)))
