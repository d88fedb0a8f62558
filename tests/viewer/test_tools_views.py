"""How pictures lie on the canvas, how cameras are led, and how clips play."""

from __future__ import annotations

import random
from fractions import Fraction

import numpy as np
import pytest

from supple.render.camera import Camera
from supple.space.geometry import Geometry
from supple.viewer.tools import orbit
from supple.viewer.tools.orbit import Stage
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.viewport import Turn, Viewport, turn_of

TURNS = [
    turn_of(rotation, aspect, mirrored=mirrored)
    for rotation in (0, 90, 180, -90)
    for mirrored in (False, True)
    for aspect in (None, Fraction(4, 3), Fraction(8, 9))
]


class TestViewport:
    @pytest.mark.parametrize("mirrored", [False, True])
    @pytest.mark.parametrize("rotation", [0, 90, 180, 270, -90, -180])
    @pytest.mark.parametrize("aspect", [None, Fraction(4, 3), Fraction(8, 9)])
    def test_pixels_are_shown_where_the_upright_picture_has_them(
        self, rotation: int, mirrored: bool, aspect: Fraction | None
    ) -> None:
        width, height = 30, 20
        stored = np.arange(width * height).reshape(height, width)
        upright = np.rot90(stored[:, ::-1] if mirrored else stored, rotation // 90)
        view = Viewport((width, height), (900, 700), 2, turn_of(rotation, aspect, mirrored=mirrored)).actual()
        sides = (1.0, float(aspect or 1)) if rotation % 180 else (float(aspect or 1), 1.0)
        assert view.stretch == sides
        corner = np.array(view.to_canvas(*(int(k) for k in np.argwhere(stored == upright[0, 0])[0][::-1])))
        for x, y in [(0, 0), (29, 0), (7, 19), (12, 3)]:
            row, column = np.argwhere(upright == stored[y, x])[0]
            seen = view.to_canvas(x, y)
            np.testing.assert_allclose(seen - corner, np.array([column, row]) * sides * view.zoom)
            assert view.to_image(*seen) == pytest.approx((x, y), abs=1e-9)
        shown = np.array(upright.shape[::-1]) * sides
        assert view.fit().zoom == pytest.approx(min(900 / shown[0], 700 / shown[1]))

    @pytest.mark.parametrize("vanishing", [(0.0, 0.0), (4e-4, -9e-4)])
    @pytest.mark.parametrize("turn", TURNS)
    def test_what_is_drawn_covers_the_canvas_to_the_pixel(self, turn: Turn, vanishing: tuple[float, float]) -> None:
        size, ratio = (1203, 901), 1.5
        sides = size[0] / ratio, size[1] / ratio
        fitting = Viewport((641, 480), sides, ratio, turn, vanishing=vanishing)
        for view in (fitting, fitting.actual(), fitting.zoom_about(10, 20, 5).pan(3, 4)):
            origin, scale, count, part = view.drawn(size, ratio)
            corner, across, down, depths = np.split(np.array(part), (2, 4, 6))
            for place in [(0.5, 0.5), (1202.5, 900.5), (17.5, 400.5), (600.5, 450.5)]:
                within = corner + across * place[0] / size[0] + down * place[1] / size[1]
                depth = depths @ (1.0, place[0] / size[0], place[1] / size[1])
                within = within / depth
                if any(vanishing) and not (depth > 2e-3 and view.holds(*view.to_image(*np.divide(place, ratio)))):
                    continue
                assert ((within * count > 0.499) & (within * count < np.array(count) - 0.499)).all()
                point = np.array(origin) + (within * count - 0.5) * scale
                np.testing.assert_allclose(point, view.to_image(place[0] / ratio, place[1] / ratio), atol=1e-6)
            if any(vanishing):
                continue
            assert scale <= 1 / (view.zoom * ratio * max(view.stretch)) * (1 + 1e-9)
            if view.stretch == (1, 1):
                assert count == (size if turn[0] else size[::-1])

    @pytest.mark.parametrize("aspect", [Fraction(1, 1000), Fraction(1000)])
    def test_what_is_drawn_fits_any_device(self, aspect: Fraction) -> None:
        view = Viewport((640, 480), (1000, 700), turn=turn_of(0, aspect))
        assert max(view.drawn((1000, 700), 1.0)[2]) <= 8192

    @pytest.mark.parametrize("vanishing", [(0.0, 0.0), (4e-4, -9e-4)])
    @pytest.mark.parametrize("turn", TURNS)
    def test_turned_images_zoom_and_pan_with_the_pointer(self, turn: Turn, vanishing: tuple[float, float]) -> None:
        view = Viewport((640, 480), (1000, 700), 1.0, turn, vanishing=vanishing)
        point = view.to_image(480, 330)
        view = view.zoom_about(480, 330, 2.5)
        assert view.to_image(480, 330) == pytest.approx(point)
        assert view.pan(30, -7).to_canvas(*point) == pytest.approx((510, 323))
        x, y, w = np.array(view.matrix) @ (*point, 1.0)
        assert (x / w, y / w) == pytest.approx((480, 330))
        assert view.fit().to_canvas(319.5, 239.5) == pytest.approx((500, 350))
        ends = [view.fit().to_canvas(x, y) for x in (-0.5, 639.5) for y in (-0.5, 479.5)]
        assert (np.ptp(ends, axis=0) <= np.array((1000, 700)) + 1e-6).all()

    def test_fits(self) -> None:
        view = Viewport((200, 100), (800, 600))
        assert (view.zoom, view.centre, view.percent) == (4, (99.5, 49.5), 400)
        assert view.to_image(0, 100) == (-0.5, -0.5)  # the corner of the first pixel, half a pixel from its middle
        assert view.to_image(800, 500) == (199.5, 99.5)
        assert view.to_canvas(0, 0) == (2, 102)
        assert Viewport((100, 200), (800, 600)).zoom == 3

    def test_limits_of_zoom(self) -> None:
        view = Viewport((4000, 3000), (800, 600), 2)
        for factor, zoom in [(1e9, 32), (1e-9, 0.05)]:
            view = view.zoom_about(10, 10, factor)
            assert view.zoom == zoom
            assert view.zoom_about(10, 10, factor) is view
        small = Viewport((4, 3), (800, 600))
        assert small.zoom == 200
        assert small.zoom_about(0, 0, 1e9) is small

    def test_is_never_out_of_sight(self) -> None:
        rng = random.Random(3)
        view = Viewport((640, 480), (900, 700), 1.5)
        for _ in range(500):
            x, y = rng.uniform(-2000, 2000), rng.uniform(-2000, 2000)
            match rng.choice(["pan", "zoom", "resize", "actual"]):
                case "pan":
                    view = view.pan(x, y)
                case "zoom":
                    view = view.zoom_about(x, y, 10 ** rng.uniform(-2, 2))
                case "resize":
                    view = view.resize((rng.choice([0, 1, 300, 5000]), rng.uniform(0, 900)))
                case _:
                    view = view.actual() if rng.random() < 0.2 else view
            (left, top), (right, bottom) = view.to_canvas(-0.5, -0.5), view.to_canvas(639.5, 479.5)
            width, height = view.canvas_size
            assert left - 1e-6 <= width / 2 <= right + 1e-6
            assert top - 1e-6 <= height / 2 <= bottom + 1e-6
            assert view.limits[0] <= view.zoom <= view.limits[1]

    @pytest.mark.parametrize("ratio", [1.0, 2.0, 1.5])
    def test_actual_size_is_sharp(self, ratio: float) -> None:
        view = Viewport((641, 480), (803, 700), ratio).zoom_about(100, 90, 1.23).pan(3.3, 7.7)
        sharp = view.actual()
        assert sharp.percent == pytest.approx(100)
        assert max(abs(a - b) for a, b in zip(sharp.centre, view.centre, strict=True)) <= 0.5
        edges = np.array(sharp.to_canvas(-0.5, -0.5)) * ratio
        np.testing.assert_allclose(edges, np.rint(edges), atol=1e-9)

    def test_resizes(self) -> None:
        view = Viewport((200, 100), (800, 600))
        assert view.resize((400, 300)).zoom == 2
        assert view.resize((400, 300), 2).percent == 400
        led = view.zoom_about(10, 20, 2)
        assert (led.resize((300, 500)).zoom, led.resize((300, 500)).centre) == (led.zoom, led.centre)
        assert led.fit() == view
        assert view.resize((0, 0)).canvas_size == (1, 1)

    def test_what_lies_within(self) -> None:
        view = Viewport((200, 100), (800, 600))
        assert view.holds(-0.5, 99.5)
        assert not view.holds(-0.6, 50)
        assert not view.holds(50, 99.6)


STAGE = Stage((40, 60, 50), Geometry(spacing=(1, 1, 2)), (300, 400))
CAMERAS = [Camera(), Camera(130, 40, roll=30, target=(10, 20, 30)), Camera(distance=100, roll=-60, elevation=-20)]


class TestOrbit:
    @pytest.mark.parametrize("camera", CAMERAS)
    def test_places_on_the_canvas_are_those_of_rays(self, camera: Camera) -> None:
        view = STAGE.view(camera)
        at = view.eye + 70 * view.direction(100, 30) / view.spacing
        found = STAGE.project(camera, tuple(at))
        assert found == pytest.approx((100.5, 30.5, 70))
        assert STAGE.project(camera, tuple(view.eye - view.ahead)) is None

    @pytest.mark.parametrize("camera", CAMERAS)
    def test_the_front_goes_along_with_the_pointer(self, camera: Camera) -> None:
        view, target = STAGE.view(camera), np.array(STAGE.target(camera))
        front = tuple(target + 0.3 * (view.eye - target))
        x, y, _ = STAGE.project(camera, front) or (0, 0, 0)
        for dx, dy in [(4, 0), (0, 4), (-3, 2)]:
            a, b, _ = STAGE.project(orbit.orbit(camera, dx, dy, STAGE), front) or (0, 0, 0)
            went = np.array((a - x, b - y))
            assert went @ (dx, dy) > 0.9 * np.hypot(*went) * np.hypot(dx, dy)
            assert np.hypot(*went) > 4

    def test_turns_by_pixels_and_not_beyond_the_poles(self) -> None:
        camera = orbit.orbit(Camera(), -300, 0, STAGE)
        assert abs(camera.azimuth) == 180
        assert orbit.orbit(Camera(), 0, 75, STAGE).elevation == 45
        assert orbit.orbit(Camera(), 0, 1e9, STAGE).elevation == 90
        assert orbit.orbit(Camera(), 0, -1e9, STAGE).elevation == -90
        assert -180 <= orbit.orbit(Camera(), 1e7, 0, STAGE).azimuth <= 180

    @pytest.mark.parametrize("camera", CAMERAS)
    def test_pans_what_is_looked_at(self, camera: Camera) -> None:
        target = STAGE.target(camera)
        x, y, away = STAGE.project(camera, target) or (0, 0, 0)
        moved = orbit.pan(camera, 5, -3, STAGE)
        assert STAGE.project(moved, target) == pytest.approx((x + 5, y - 3, away), abs=0.1)
        assert STAGE.view(moved).distance == pytest.approx(STAGE.view(camera).distance)

    def test_never_looks_past_the_volume(self) -> None:
        camera = orbit.pan(Camera(), 1e6, 1e6, STAGE)
        assert camera.target is not None
        assert all(0 <= t <= n - 1 for t, n in zip(camera.target, (50, 60, 40), strict=True))

    def test_goes_nearer_and_away(self) -> None:
        fitted = STAGE.view(Camera()).distance
        assert STAGE.view(orbit.dolly(Camera(), 100, STAGE)).distance == pytest.approx(fitted * 1.1)
        two = orbit.dolly(orbit.dolly(Camera(), -100, STAGE), -150, STAGE)
        assert STAGE.view(two).distance == pytest.approx(STAGE.view(orbit.dolly(Camera(), -250, STAGE)).distance)
        assert STAGE.view(orbit.dolly(Camera(), -1e5, STAGE)).distance == 1
        assert STAGE.view(orbit.dolly(Camera(), 1e4, STAGE)).distance == pytest.approx(10 * fitted)


class TestPlayback:
    def test_keeps_time(self) -> None:
        clip = Playback(100, 25)
        assert clip.frame_at(7.0) == 0
        clip.play()
        assert [clip.frame_at(10 + k / 25) for k in range(50)] == list(range(50))

    def test_keeps_the_times_of_frames_that_are_not_even(self) -> None:
        starts = (0.0, 0.1, 0.6, 0.7, 1.7)
        clip = Playback(5, 1000, starts)
        clip.play()
        seen = [clip.frame_at(5 + t) for t in (0, 0.05, 0.1, 0.5, 0.61, 0.75, 1.69, 1.7, 3)]
        assert seen == [0, 0, 1, 1, 2, 3, 3, 4, 4]
        assert not clip.playing
        assert clip.seconds == 1.7
        # Over and over, the last one lasts as long as the one before; and in a part of it.
        clip.loop = True
        clip.play()
        clip.seek(3)
        assert [clip.frame_at(9 + t) for t in (0, 0.9, 1.0, 1.9, 2.0, 2.1, 2.6)] == [3, 3, 4, 4, 0, 1, 2]
        clip.seek(1)
        clip.mark_in()
        clip.seek(2)
        clip.mark_out()
        clip.seek(1)
        assert [clip.frame_at(20 + t) for t in (0, 0.4, 0.55, 0.61, 1.0, 1.15)] == [1, 1, 2, 1, 1, 2]
        # Frames that last for nothing are no reason to stop.
        clip = Playback(3, 10, (0.0, 0.5, 0.5))
        clip.loop = True
        clip.seek(2)
        clip.mark_in()
        clip.play()
        assert [clip.frame_at(t) for t in (1, 2, 3)] == [2, 2, 2]

    def test_drops_what_comes_too_late(self) -> None:
        clip = Playback(100, 25)
        clip.play()
        assert [clip.frame_at(t) for t in (3.0, 3.01, 3.04, 3.2, 3.2, 3.21, 3.25)] == [0, 0, 1, 5, 5, 5, 6]
        clip.frame_at(3.1)
        assert clip.frame == 6  # a clock that goes back does not take frames back

    def test_stops_at_the_end_and_begins_again(self) -> None:
        clip = Playback(5, 10)
        clip.play()
        clip.frame_at(0)
        assert (clip.frame_at(9), clip.playing) == (4, False)
        assert clip.frame_at(20) == 4
        clip.toggle()
        assert clip.frame_at(30) == 0
        clip.toggle()
        assert (clip.frame_at(40), clip.playing) == (0, False)

    def test_loops(self) -> None:
        clip = Playback(5, 10)
        clip.loop = True
        clip.play()
        assert [clip.frame_at(k / 10) for k in range(12)] == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1]
        assert clip.frame_at(100.3) == 3

    def test_plays_from_where_it_is(self) -> None:
        clip = Playback(50, 10)
        clip.play()
        clip.frame_at(0)
        clip.frame_at(1)
        clip.pause()
        assert clip.frame_at(99) == 10
        clip.play()
        assert (clip.frame_at(200), clip.frame_at(200.1)) == (10, 11)
        clip.seek(30)
        assert (clip.frame_at(300), clip.frame_at(300.2)) == (30, 32)
        clip.loop = True
        assert (clip.frame_at(300.3), clip.frame_at(300.4)) == (32, 33)

    def test_seeks_within_the_clip(self) -> None:
        clip = Playback(10, 10)
        for to, frame in [(3.4, 3), (3.5, 4), (-7, 0), (99, 9)]:
            clip.seek(to)
            assert clip.frame == frame
        clip.seek(5)
        clip.play()
        clip.step(-2)
        assert (clip.frame, clip.playing) == (3, False)

    def test_in_and_out_points(self) -> None:
        clip = Playback(10, 10)
        clip.seek(3)
        clip.mark_in()
        clip.seek(6)
        clip.mark_out()
        clip.seek(9)
        clip.loop = True
        clip.play()
        assert [clip.frame_at(k / 10) for k in range(6)] == [3, 4, 5, 6, 3, 4]
        clip.pause()
        clip.home()
        assert clip.frame == 3
        clip.home()
        assert clip.frame == 0
        clip.end()
        assert clip.frame == 6
        clip.end()
        assert clip.frame == 9
        clip.mark_in()
        assert (clip.first, clip.last) == (9, 9)
        clip.seek(2)
        clip.mark_out()
        assert (clip.first, clip.last) == (0, 2)
        clip.unmark()
        assert (clip.first, clip.last) == (0, 9)

    def test_one_frame(self) -> None:
        clip = Playback(1, 24)
        for loop in (False, True):
            clip.loop = loop
            clip.play()
            assert (clip.frame_at(0), clip.frame_at(5)) == (0, 0)
