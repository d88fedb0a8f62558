"""What events do to clips."""

from __future__ import annotations

import pytest

from supple.strokes import Stroke
from tests.viewer.tools import arrived, click, clip, down, move, press, up, wheel


class TestVideos:
    def test_a_pixel_is_carried_through_time(self) -> None:
        tools = clip()
        tools.radius = 40
        tools.playback.seek(5)
        tools.playback.play()
        down(tools, 201, 101)
        assert not tools.playback.playing
        wheel(tools, -300)
        assert (tools.playback.frame, tools.document.strokes[0].by) == (8, (0, 0, 3))
        move(tools, 221, 101)
        up(tools, 221, 111)
        assert tools.document.strokes[0] == Stroke(at=(100, 50, 5), by=(10, 5, 3), radius=40)
        assert (tools.playback.frame, tools.radius) == (8, 40)
        tools.document.undo()
        assert tools.document.strokes == ()

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
        assert tools.document.strokes[0].by == (0, 0, 13)  # the way back begins at the last frame

    def test_the_wheel_alone_is_the_radius(self) -> None:
        tools = clip()
        tools.radius = 40
        wheel(tools, -100)
        assert tools.radius == pytest.approx(44)
        assert tools.playback.frame == 0
        down(tools, 201, 101)
        wheel(tools, -100, "Shift")
        move(tools, 221, 101)
        assert tools.document.strokes[0].radius == pytest.approx(48.4)
        assert tools.playback.frame == 0

    def test_stays_within_the_clip(self) -> None:
        tools = clip()
        tools.playback.seek(15)
        down(tools, 201, 101)
        wheel(tools, -1e5)
        assert (tools.playback.frame, tools.document.strokes[0].by[2]) == (19, 4)
        wheel(tools, 1e5)
        assert (tools.playback.frame, tools.document.strokes[0].by[2]) == (0, -15)

    def test_arrows_carry_what_is_held(self) -> None:
        tools = clip()
        tools.playback.seek(5)
        down(tools, 201, 101)
        press(tools, "ArrowRight")
        press(tools, "ArrowRight")
        press(tools, " ")
        assert not tools.playback.playing
        up(tools, 201, 101)
        assert tools.document.strokes[0].by == (0, 0, 2)

    def test_handles_are_where_they_are_in_time(self) -> None:
        tools = clip(Stroke(at=(50, 50, 3), by=(20, 0, 4), radius=60))
        tools.document.set_rest(border=None)
        assert arrived(tools, 0) == (70, 50, 7)
        for frame, x, chosen in [(3, 50, 0), (3, 70, None), (7, 70, 0), (7, 50, None), (5, 60, None)]:
            tools.playback.seek(frame)
            click(tools, *tools.view.to_canvas(x, 50))
            assert tools.document.selected == chosen
        assert [handle.part for handle in tools.handles()] == []
        tools.playback.seek(7)
        assert [handle.part for handle in tools.handles()] == ["end"]
        tools.document.select(0)
        down(tools, 141, 101)
        wheel(tools, -200)
        up(tools, 151, 101)
        assert tools.document.strokes[0].by == pytest.approx((25, 0, 6))
        assert tools.playback.frame == 9
        tools.playback.seek(3)
        down(tools, 101, 101)
        wheel(tools, 100)
        up(tools, 101, 101)
        assert tools.document.strokes[0].at == (50, 50, 2)
        assert tools.document.strokes[0].by == pytest.approx((25, 0, 6))

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
        assert tools.view.percent == 100

    def test_hover_knows_the_time(self) -> None:
        tools = clip()
        tools.playback.seek(4)
        move(tools, 201, 101, buttons=())
        assert tools.hover == (100, 50, 4)

    def test_frames_of_strokes(self) -> None:
        tools = clip(
            Stroke(at=(100, 50, 5), by=(10, 5, 3), radius=40),
            Stroke(at=(50, 50, 8), brush="twist", angle=20, radius=20),
            Stroke(at=(50, 50, 2), by=(1, 0, 0), radius=20, hidden=True),
            Stroke(at=(50, 50, 18), by=(1, 0, 4), radius=20),
        )
        assert tools.stroke_frames == {5: False, 8: False, 18: False}
        tools.document.select(0)
        assert tools.stroke_frames == {5: True, 8: True, 18: False}
