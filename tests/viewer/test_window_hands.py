"""What a window does beside strokes: screens of small pixels, files that are dropped, and answers without an event."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.view import LINE, TOP, WIDE
from tests.viewer.windows import DATA, SIZE, Hand, Pixels, opened


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    image.write(tmp_path / "photo.png", np.full((300, 400, 3), 128, np.uint8))
    return tmp_path / "photo.png"


@pytest.fixture
def view(gpu: Gpu, photo: Path) -> Iterator[tuple[Any, Hand]]:
    view, hand = opened(photo)
    yield view, hand
    view.close()


def seen(hand: Hand) -> Pixels:
    return np.asarray(hand.canvas.draw())[..., :3].copy()


def test_a_screen_of_small_pixels_shows_the_same_twice_as_sharp(gpu: Gpu, photo: Path) -> None:
    pictures, recipes = [], []
    for ratio in (1.0, 2.0):
        view, hand = opened(photo, ratio=ratio)
        hand.drag((300, 250), (360, 220))
        hand.move(350, 400)
        view._changed_at = -10.0
        hand.canvas.draw()
        pictures.append(seen(hand))
        recipes.append(view.recipe)
        assert view.tools.view.pixel_ratio == ratio
        assert view._textures[0].size[:2] == tuple(round(ratio * v) for v in view.area)
        hand.key("1")
        assert view.tools.view.zoom == pytest.approx(1 / ratio)
        view.document.mark_saved()  # else the next one asks whether to restore it
        view.close()
    # The pointer is where it is, in logical pixels: the stroke is the same.
    (one,), (other,) = (recipe.strokes for recipe in recipes)
    np.testing.assert_allclose(other.at, one.at, atol=1e-9)
    np.testing.assert_allclose(other.by, one.by, atol=1e-9)
    small, large = pictures
    assert large.shape == (2 * SIZE[1], 2 * SIZE[0], 3)
    halved = large.reshape(SIZE[1], 2, SIZE[0], 2, 3).mean((1, 3))
    # Ring, handles and letters have the same size and place, so that they fall on one another: sharper, but no farther.
    for name, box in {"picture": np.s_[:600, :640], "panel": np.s_[:, 660:]}.items():
        a, b = small[box].astype(float).mean(-1), halved[box].mean(-1)
        assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.75, name
    # The ring is as large as the brush, about the pointer: white, at its radius.
    bright = large.min(-1) > 200
    y, x = np.nonzero(bright[:1200, :1280])
    away = np.hypot(x / 2 - 350, y / 2 - 400)
    radius = one.radius * min((SIZE[0] - WIDE) / 400, (SIZE[1] - TOP - LINE) / 300) * view.tools.extent[0]
    ring = np.abs(away - radius) < 2
    assert ring.sum() > 2 * np.pi * radius
    # Letters are drawn anew for such a screen, not enlarged: their edges are as steep.
    line = [np.abs(np.diff(p[-48 // (3 - k) :, : 640 * k].mean(-1), axis=1)).max() for k, p in enumerate(pictures, 1)]
    assert line[1] > 0.8 * line[0]


def test_a_recipe_that_is_dropped_is_opened_in_place(view: tuple[Any, Hand], tmp_path: Path) -> None:
    window, hand = view
    recipe = Recipe(strokes=(Stroke.grab((200, 150), by=(20, 5), radius=40),))
    (tmp_path / "strokes.JSON").write_text(recipe.to_json(), encoding="utf-8")
    window.drop([str(tmp_path / "strokes.JSON")])
    assert window.recipe.strokes == recipe.strokes
    assert "opened" in window.commands.message
    # It is that file's: nothing is lost if the window is closed, and saved to it.
    assert not window.document.dirty
    assert window.commands.may_close()
    hand.key("z", "Control")
    assert window.recipe.strokes == ()
    (tmp_path / "bad.json").write_text("{", encoding="utf-8")
    window.drop([str(tmp_path / "bad.json")])
    assert window.commands.message
    assert window.recipe.strokes == ()
    window.drop([])


def test_another_file_that_is_dropped_has_a_window_of_its_own(
    view: tuple[Any, Hand], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window, _ = view
    begun: list[list[str]] = []
    running = SimpleNamespace(poll=lambda: None)
    monkeypatch.setattr(
        "supple.viewer.document.files.subprocess.Popen", lambda words, **options: begun.append(words) or running
    )
    window.drop([str(DATA / "head.nii.gz")])
    assert begun[0][1:] == ["-m", "supple", "view", str(DATA / "head.nii.gz")]
    assert "window of its own" in window.commands.message
    window.drop([str(tmp_path / "none.png")])
    assert len(begun) == 1
    assert "no such file" in window.commands.message


def test_what_the_system_says_is_dropped_comes_to_the_window(
    view: tuple[Any, Hand], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    glfw = pytest.importorskip("glfw")
    from supple.viewer.window.launch import _ask_before_closing

    window, _ = view
    set_by: dict[str, Any] = {}
    monkeypatch.setattr(glfw, "set_drop_callback", lambda handle, call: set_by.update(drop=call))
    monkeypatch.setattr(glfw, "set_window_close_callback", lambda handle, call: set_by.update(close=call))
    monkeypatch.setattr(glfw, "set_window_should_close", lambda handle, value: set_by.update(stays=value == 0))
    window.canvas._window = None
    _ask_before_closing(window.canvas, window)
    recipe = Recipe(strokes=(Stroke.grab((200, 150), by=(20, 5), radius=40),))
    (tmp_path / "a.json").write_text(recipe.to_json(), encoding="utf-8")
    set_by["drop"](None, [str(tmp_path / "a.json"), "another"])
    assert window.recipe.strokes == recipe.strokes
    window.document.undo()
    set_by["close"](None)
    assert set_by["stays"]
    assert window.commands.asked.name == "close"


def test_the_panel_answers_though_it_keeps_events_to_itself(view: tuple[Any, Hand], monkeypatch: Any) -> None:
    window, hand = view
    hand.move(300, 300)
    hand.canvas.draw()
    assert window.tools.pointer is not None
    asked: list[str] = []
    monkeypatch.setattr(hand.canvas, "request_draw", lambda *draw: asked.append("draw"))
    for x in (800, 810, 820):
        asked.clear()
        hand.move(x, 45)
        assert asked
        hand.canvas.draw()
        assert len(asked) > 1  # one frame more, at least: that in which it is seen
    # The ring is gone, though the panel did not hand the move on.
    assert window.tools.pointer is None
    # A question is seen though nothing else happens.
    window.commands.ask("export")
    waking = window._waking
    waking._stirred, waking._due = -10.0, float("inf")
    later: list[float] = []
    monkeypatch.setattr(waking, "_call_later", lambda seconds, work: later.append(seconds))
    hand.canvas.draw()
    assert later
    assert min(later) < 0.5


@pytest.mark.parametrize("keys", ["/", "?", "-"])
def test_the_list_of_keys_opens_by_the_character_on_any_layout(view: tuple[Any, Hand], keys: str) -> None:
    # glfw knows keys by their place, on a US keyboard; browsers by what is on them.
    window, hand = view

    def typed(*characters: str) -> None:
        hand.send("key_down", key="Shift")
        hand.send("key_down", key=keys)
        for character in characters:
            hand.send("char", data=character)
        hand.send("key_up", key=keys)

    typed("?")
    assert window.tools.listing
    typed("?", "?", "?")  # a key that is held
    assert not window.tools.listing
    typed("_")
    assert not window.tools.listing


def test_a_hint_is_shown_soon_and_without_drawing_on(view: tuple[Any, Hand], monkeypatch: pytest.MonkeyPatch) -> None:
    window, hand = view
    asked: list[bool] = [True]
    later: list[tuple[float, Callable[[], None]]] = []
    drawn: list[Pixels] = []
    monkeypatch.setattr(hand.canvas, "request_draw", lambda *draw: asked.append(True))
    monkeypatch.setattr(
        window._waking, "_call_later", lambda seconds, work: later.append((time.perf_counter() + seconds, work))
    )

    def live(seconds: float) -> None:
        """Draw when a frame is asked for, as a loop does."""
        end = time.perf_counter() + seconds
        while (now := time.perf_counter()) < end:
            for due in [due for due in later if due[0] <= now]:
                later.remove(due)
                due[1]()
            if asked:
                asked.clear()
                drawn.append(np.asarray(hand.canvas.draw())[..., :3].copy())
            time.sleep(1 / 60)

    hand.drag((300, 250), (330, 260))  # a stroke that is in no file of the user's
    live(1.0)
    hand.move(SIZE[0] - WIDE + 20, 60)
    # Half a second, and what a loaded machine takes for frames. The hint is beside the tool, over the panel.
    live(0.05)
    before = drawn[-1]
    live(0.9)
    assert np.abs(before[60:110, 680:].astype(int) - drawn[-1][60:110, 680:]).max() > 50
    drawn.clear()
    live(0.5)
    assert not drawn  # nothing is drawn while nothing happens
