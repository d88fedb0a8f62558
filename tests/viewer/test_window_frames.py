"""Pictures of a window are of the frames, the places and the strokes that they are said to be of."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvips

from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe, Stroke
from supple.viewer.panels import stages
from supple.viewer.panels import view as views
from supple.viewer.panels.view import LINE, TOP
from supple.viewer.window import window
from tests.clips import make
from tests.viewer.windows import in_pixels, opened, settled, small_photo

LATER = Stroke.grab((160, 120, 260), by=(0, 0, 30), radius=100)


def closed(view: Any) -> None:
    view.document.mark_saved()
    view.close()


def bent_half(view: Any) -> np.ndarray:
    from supple.gpu.screen import pixels_of

    return pixels_of(view.gpu, view._textures[0])[..., :3].astype(int)


@pytest.fixture(scope="module")
def encoded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("frames") / "long.mp4"
    return Path(make(target, count=300, size=(320, 240), smooth=True, options={"g": "50", "bf": "2"}))


@pytest.fixture
def long(encoded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(encoded, tmp_path / "long.mp4"))


def test_both_halves_of_a_split_clip_are_whole(gpu: Gpu, long: Path) -> None:
    view, hand = opened(long, Recipe(border=None, strokes=(LATER,)))
    view.tools.playback.seek(280)
    view.tools.split = 0.0
    view.refresh()
    settled(view, hand)
    split = bent_half(view)
    first, last = view.stage.needed(view.document.deformation, 280.0)
    *bent, after = list(view.stage.film._wanted)[: last - first + 2]
    assert bent == [*range(first, last + 1)]
    assert after == 280
    view.tools.split = None
    view.refresh()
    settled(view, hand)
    assert np.abs(split - bent_half(view)).max() <= 1


def test_what_is_saved_is_the_frame_that_is_shown_and_both_halves(gpu: Gpu, long: Path, tmp_path: Path) -> None:
    view, hand = opened(long, Recipe(border=None, strokes=(Stroke.grab((160, 120, 299), by=(60, 0, 0), radius=80),)))
    hand.key("End")
    at_once = view.pixels()
    assert view.stage.film.want(299, 299) or view.stage.film.arrived(30.0)
    assert np.abs(view.pixels().astype(int) - at_once).max() <= 1
    view.tools.split = 0.5
    view.refresh()
    seen = settled(view, hand)
    view.write(str(tmp_path / "saved.png"), False)
    saved = image.read(tmp_path / "saved.png").pixels[..., :3].astype(int)
    lower = saved.shape[0] - 40  # the ring and the handles lie over the canvas alone
    apart = np.abs(saved[:lower] - seen[TOP : TOP + lower, : saved.shape[1]]).max(axis=-1)
    assert np.percentile(apart, 97) <= 3
    middle = saved.shape[1] // 2
    assert (saved[:, middle] == 255).all()


def test_a_view_whose_frames_do_not_come_is_not_saved(
    gpu: Gpu, long: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from supple.viewer.panels import view as views

    monkeypatch.setattr(views, "PATIENCE", 0.2)
    view, hand = opened(long)
    monkeypatch.setattr(type(view.stage.film), "get", lambda film, frame: None)
    monkeypatch.setattr(type(view.stage.film), "_there", lambda film: False)
    hand.key("End")
    with pytest.raises(SuppleError, match="not decoded yet"):
        view.write(str(tmp_path / "saved.png"), False)
    assert not (tmp_path / "saved.png").exists()


def test_a_clip_that_stops_says_so_and_goes_on_elsewhere(gpu: Gpu, long: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.media.video import Clip
    from supple.viewer.panels.overlay import status

    sought, begun = Clip._sought, []

    def torn(self: Any, start: int) -> Any:
        begun.append(start)
        if broken:
            raise SuppleError("long.mp4 is torn")
        return sought(self, start)

    view, hand = opened(long)
    view.stage.film.most = 100  # so that the last frames are not decoded ahead
    settled(view, hand)
    monkeypatch.setattr(Clip, "_sought", torn)
    broken = True
    hand.key("End")
    for _ in range(100):  # the thread that reads takes its time on a busy machine
        settled(view, hand)
        if "long.mp4 is torn" in status(view):
            break
        time.sleep(0.1)
    assert "long.mp4 is torn" in status(view)
    tries = len(begun)
    for _ in range(10):
        hand.canvas.draw()
        assert view.painter.ready  # nothing is waited for, so that nothing is drawn without pause
    assert len(begun) == tries
    with pytest.raises(SuppleError, match="torn"):
        view.pixels()
    broken = False
    hand.key("ArrowLeft")
    settled(view, hand)
    assert view.stage.film.get(298) is not None
    assert "torn" not in status(view)


def test_a_clip_that_ends_too_soon_says_so(gpu: Gpu, long: Path) -> None:
    from supple.viewer.panels.stages import FrameCache

    film = FrameCache(long)
    try:
        film.count = 350
        assert film.want(320, 321) or film.arrived(30.0)
        assert "ends before frame 320" in film.error
        assert film.want(298, 299) or film.arrived(30.0)
        assert film.get(299) is not None
    finally:
        film.close()


def test_a_stroke_of_more_frames_than_are_kept_says_so(gpu: Gpu, long: Path) -> None:
    from supple.viewer.panels.overlay import status

    view, hand = opened(long, Recipe(border=None, strokes=(LATER,)))
    view.stage._plate.slots = 6
    view.tools.playback.seek(280)
    first, last = view.stage.needed(view.document.deformation, 280.0)
    assert view.stage.film.want(first, last) or view.stage.film.arrived(30.0)
    hand.canvas.draw()
    assert not view.painter.ready  # the line of status was laid out before, and is drawn once more
    settled(view, hand)
    said = f"needs {last - first + 1} frames at once, and 6 are kept: export shows it whole"
    assert said in status(view)
    with pytest.raises(SuppleError, match="export shows it whole"):
        view.pixels()
    view.tools.playback.seek(100)
    settled(view, hand)
    assert "needs" not in status(view)


def test_the_value_under_the_pointer_is_what_is_seen_there(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.deformation import Deformation
    from supple.viewer.panels.overlay import status

    ys, xs = np.mgrid[:380, :560]
    ramp = np.stack([xs * 255 // 559, ys * 255 // 379, 0 * xs], -1).astype(np.uint8)
    stroke = Stroke.grab((300, 200), by=(120, 40), radius=90)
    view, hand = opened(ramp, Recipe(border=None, strokes=(stroke,)))
    hand.key("1")
    hand.move(*view.tools.view.to_canvas(420, 240))
    x, y = in_pixels(view, 420, 240)
    seen = [int(v) for v in view.pixels()[y, x]]

    def said() -> list[int]:
        return [int(v) for v in status(view).split("   |   ")[1].split()]

    asked: list[Any] = []
    inverse = Deformation.inverse
    monkeypatch.setattr(Deformation, "inverse", lambda self, points: asked.append(points) or inverse(self, points))
    for _ in range(3):
        np.testing.assert_allclose(said(), seen, atol=2)
    assert len(asked) == 1  # of one point, once
    assert asked[0].shape == (1, 2)
    plain = ramp[240, 420]
    assert np.abs(plain.astype(int) - seen).max() > 20
    view.tools.split = 1.0
    np.testing.assert_allclose(said(), plain, atol=1)
    view.tools.split = 0.0
    np.testing.assert_allclose(said(), seen, atol=2)


def test_the_value_of_a_clip_is_that_of_the_frame_it_comes_from(gpu: Gpu, long: Path) -> None:
    view, hand = opened(long, Recipe(border=None, strokes=(LATER,)))
    view.document.set_hold(0)
    deformation = view.document.deformation
    view.tools.playback.seek(290)
    settled(view, hand)
    x, y, t = deformation.inverse(np.array([[160.0, 120.0, 290.0]])).points[0]
    assert t < 280
    there = view.stage.value((float(x), float(y)), float(round(t)))
    assert there
    assert view.stage.value((160.0, 120.0), 290.0, deformation) == there
    assert view.stage.value((160.0, 120.0), 290.0) != there


@pytest.mark.parametrize("coarse", [7, 8])
def test_coarse_pixels_lie_where_fine_ones_do(gpu: Gpu, coarse: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.deformation import Deformation
    from supple.gpu.plate import Sight
    from supple.gpu.screen import Screen, pixels_of
    from supple.viewer.panels.stages import ImageStage
    from supple.viewer.panels.view import Painter, Shot

    monkeypatch.setattr(gpu, "software", False)
    size = width, height = 705, 401  # no multiple of any
    ys, xs = np.mgrid[:height, :width]
    # Its slope tells a pixel's place to a fraction.
    wave = np.stack([abs(xs % 160 - 80) * 3, abs(ys % 160 - 80) * 3, 0 * xs, 255 + 0 * xs], -1).astype(np.uint8)
    painter, d = Painter(gpu, ImageStage(gpu, "wave", wave)), Deformation((height, width))
    painter.coarse = coarse

    def on_screen(moving: bool) -> np.ndarray:
        first, _ = painter.paint(Shot(d, d.without_strokes(), Sight((0.0, 0.0), 1.0, size, solved=not moving)))
        onto = gpu.device.create_texture(size=(*size, 1), format="rgba8unorm", usage="RENDER_ATTACHMENT|COPY_SRC")
        colours = {"view": onto.create_view(), "load_op": "clear", "store_op": "store"}
        encoder = gpu.device.create_command_encoder()
        drawing = encoder.begin_render_pass(color_attachments=[colours])
        Screen(gpu, "rgba8unorm").draw(drawing, first, part=painter.part)
        drawing.end()
        gpu.device.queue.submit([encoder.finish()])
        return pixels_of(gpu, onto).astype(int)

    apart = np.abs(on_screen(True) - on_screen(False))
    for edge in (apart[:, -60:-coarse, 0], apart[-60:-coarse, :, 1]):
        assert np.median(edge) <= 1, np.median(edge)


@pytest.mark.parametrize("software", [True, False])
def test_a_compared_step_of_a_volume_is_solved_once(
    gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch, software: bool
) -> None:
    from supple.render.scene import Scene
    from supple.viewer.window import window

    solved: list[Any] = []
    deformed = Scene.deformed
    monkeypatch.setattr(Scene, "deformed", lambda scene, made: solved.append(made) or deformed(scene, made))
    monkeypatch.setattr(gpu, "software", software)
    monkeypatch.setattr(stages, "time", SimpleNamespace(perf_counter=lambda: 0.0))  # however busy the machine is
    monkeypatch.setattr(window, "FILLING", 60.0)
    one, two = (Stroke.grab((22, 40, z), by=(2, -3, 2), radius=40) for z in (22, 30))
    view, hand = opened(volume, Recipe(border=None, strokes=(one,)), size=(600, 420))

    def rest() -> np.ndarray:
        """What is seen once nothing is filled, solved or drawn any more."""
        for _ in range(200):
            view._changed_at, drawn = -10.0, view._drawn_key
            hand.canvas.draw()
            done = view.filled == 1.0 or view.tools.original
            if done and drawn is not None and view._drawn_key is drawn:
                break
        count = len(solved)
        for _ in range(4):
            hand.canvas.draw()
            assert done
            assert view._drawn_key is drawn
        assert len(solved) == count
        return bent_half(view)

    before = rest()
    view.document.add(two)
    after = rest()
    scene, error = view.stage.scene, view.stage.scene.error
    view.document.compare(0)
    rest()
    solved.clear()
    view.tools.original = True
    shown = rest()
    assert [made is view.document.base for made in solved] == [True]
    assert np.abs(shown - before).mean() < 0.6 * np.abs(shown - after).mean()
    assert view.stage.scene is scene  # the panel speaks of the result
    assert view.stage.scene.error == error
    view.stage._seconds[False] = 9.0
    assert not view.stage.is_slow(view.document.base)
    view.tools.original = False
    np.testing.assert_array_equal(rest(), after)
    view.tools.split = 0.5
    rest()
    assert len(solved) == 1
    # What is compared with itself is solved once, too.
    view.document.compare(1)
    view.tools.original = True
    rest()
    assert len(solved) == 1


def test_a_gif_that_moves_is_a_clip_at_its_own_times(gpu: Gpu, tmp_path: Path) -> None:
    frames = [np.full((40, 60, 3), 20 * k, np.uint8) for k in range(5)]
    made = pyvips.Image.arrayjoin([pyvips.Image.new_from_array(frame) for frame in frames], across=1)
    made = made.copy()
    made.set_type(pyvips.GValue.gint_type, "page-height", 40)
    made.set_type(pyvips.GValue.array_int_type, "delay", [100, 500, 100, 100, 300])
    made.write_to_file(str(tmp_path / "moves.gif"))
    made.crop(0, 0, 60, 40).write_to_file(str(tmp_path / "still.gif"))
    view, _ = opened(tmp_path / "moves.gif")
    assert view.stage.kind == "video"
    assert view.stage.film.count == 5
    playback = view.tools.playback
    playback.play()
    assert [playback.frame_at(3 + t) for t in (0, 0.3, 0.65, 0.75)] == [0, 1, 2, 3]
    view.commands.ask("export")
    assert view.commands.asked.path.endswith("moves-bent.gif")
    view.commands.asked = None
    still, _ = opened(tmp_path / "still.gif")
    assert still.stage.kind == "image"


def test_controls_follow_a_drag_a_few_times_a_second_and_marks_at_once(
    gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(views, "SETTLED", 1e9)  # the pointer never rests
    monkeypatch.setattr(window, "FOLLOWED", 1e9)
    view, hand = opened(small_photo(tmp_path))
    laid: list[str] = []
    for name in ("_controls", "_marks"):
        layer = getattr(view._gui, name)
        work = layer._work
        layer._work = lambda name=name, work=work: (laid.append(name), work())
    hand.move(200, 200)
    hand.press(200, 200)
    hand.move(205, 200, 1)
    before = hand.canvas.draw()
    laid.clear()
    for k in range(3):
        hand.move(210 + 5 * k, 200, 1)
        after = hand.canvas.draw()
    assert laid == ["_marks"] * 3
    width = int(view.area[0])
    np.testing.assert_array_equal(after[:, width:], before[:, width:])  # the panel is still there
    for rows in (slice(TOP), slice(-LINE, None)):  # and so are the menu and the status line
        np.testing.assert_array_equal(after[rows], before[rows])
        assert len(np.unique(after[rows, :300])) > 20
    assert (after[:, :width] != before[:, :width]).any()
    for module, name, seconds in ((window, "FOLLOWED", 0.0), (views, "SETTLED", -1.0)):
        with monkeypatch.context() as now:
            now.setattr(module, name, seconds)
            laid.clear()
            hand.canvas.draw()
            assert sorted(laid) == ["_controls", "_marks"]
    hand.release(220, 200)
    laid.clear()
    hand.canvas.draw()
    assert sorted(laid) == ["_controls", "_marks"]
