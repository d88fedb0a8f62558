"""What a retoucher expects of a window: menus, files that are opened, masks, messages, the first hints."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from supple.files.freezing import read_freeze
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.actions import ACTIONS
from supple.viewer.panels.overlay import grid_step, status
from supple.viewer.panels.view import LINE, TOP
from tests.viewer.windows import SIZE, Boxes, Hand, imgui, opened

PULL = Stroke(at=(200, 120), by=(20, 10), radius=40)
GREY = np.full((300, 400, 3), 128, np.uint8)


def grey(*strokes: Stroke, **options: Any) -> tuple[Any, Hand]:
    return opened(GREY, Recipe(border=None, strokes=strokes), **options)


def is_open(view: Any) -> bool:
    imgui.set_current_context(view._gui._renderer.imgui_context)
    return bool(imgui.is_popup_open("", imgui.PopupFlags_.any_popup))


def test_the_menu_is_on_top_and_escape_closes_it_first(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(PULL)
    view.document.select(0)
    hand.canvas.draw()
    assert all(boxes.place(name)[1] < TOP for name in ("File", "Edit", "Freeze", "View", "Help"))
    assert boxes.place("File")[0] < 60  # at the left of the window
    hand.click(boxes.place("Freeze"))
    assert is_open(view)
    hand.key("Escape")
    hand.canvas.draw()
    assert not is_open(view)
    assert view.document.selected == 0  # the next one is for the picture
    hand.key("Escape")
    assert view.document.selected is None
    # A drag goes on while nothing is open, and is abandoned.
    hand.press(300, 300)
    hand.move(340, 300, 1)
    hand.key("Escape")
    assert view.document.strokes == (PULL,)


def test_restore_all_is_one_step(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(PULL, Stroke(at=(100, 90), by=(-10, 10), radius=30))
    hand.canvas.draw()
    hand.click(boxes.place("Edit"))
    hand.click(boxes.place("menu restore"))
    assert view.document.strokes == ()
    assert not ACTIONS["restore"].able(view)
    assert ACTIONS["undo"].says(view) == "Undo: Restore all"
    hand.key("z", "Control")
    assert len(view.document.strokes) == 2


def test_numbers_appear_once_and_a_slider_is_one_step(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(PULL)
    view.document.select(0)
    hand.canvas.draw()
    for own in (False, True):
        view.own = own
        hand.canvas.draw()
        for name in ("##radius", "##fall-off", "##bulge sideways", "##reach"):
            assert name in boxes
    x, y = boxes.place("##radius")
    radius = view.tools.radius
    hand.drag((x, y), (x + 60, y))
    hand.canvas.draw()
    assert len(view.document.steps) == 2
    assert view.document.strokes[0].radius not in (40, radius)
    assert view.tools.radius == radius  # the brush has its own
    view.document.undo()
    assert view.document.strokes == (PULL,)
    # Another brush shows its own numbers again.
    hand.key("t")
    hand.canvas.draw()
    assert not view.own
    hand.drag((x, boxes.place("##radius")[1]), (x + 60, boxes.place("##radius")[1]))
    assert view.tools.radius != radius
    assert len(view.document.steps) == 2


def test_accuracy_is_folded_and_not_in_the_status_line(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(PULL)
    hand.move(300, 300)
    for _ in range(3):
        hand.canvas.draw()
    assert view.certifier.thread is None  # nor is it computed
    assert "px of the map" not in status(view)


def test_what_was_opened_is_offered_again(
    gpu: Gpu, photo: Path, tmp_path: Path, boxes: Boxes, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other.png"
    image.write(other, GREY)
    for source in (other, photo):
        view, hand = opened(source)
    kept = json.loads((tmp_path / "config" / "supple" / "window.json").read_text())
    assert kept["recent"] == [str(photo), str(other)]
    assert view.recent == (str(other),)  # but what is here
    begun: list[list[str]] = []
    running = SimpleNamespace(poll=lambda: None)
    monkeypatch.setattr(
        "supple.viewer.document.files.subprocess.Popen", lambda words, **options: begun.append(words) or running
    )
    hand.canvas.draw()
    for name in ("File", "Open recent", f"menu {other}"):
        hand.click(boxes.place(name))
        hand.canvas.draw()
    assert [words[-1] for words in begun] == [str(other)]
    # The command opens recipes here, and files beside; where there is no other window, that is said.
    recipe = tmp_path / "strokes.json"
    recipe.write_text(Recipe(strokes=(PULL,)).to_json())
    view.commands.ask("open")
    view.commands.asked.path = str(recipe)
    assert view.commands.answer("Open")
    assert view.document.strokes == (PULL,)
    view.commands.windows = False
    view.commands.ask("open")
    view.commands.asked.path = str(other)
    assert not view.commands.answer("Open")
    assert "needs a window of its own" in view.commands.asked.problem
    view.commands.windows = True
    monkeypatch.undo()
    view.commands.asked.path = str(tmp_path / "notes.txt")
    (tmp_path / "notes.txt").write_text("no picture")
    assert not view.commands.answer("Open")
    assert "notes.txt" in view.commands.asked.problem


def test_a_freeze_mask_is_saved_and_loaded(gpu: Gpu, photo: Path, tmp_path: Path) -> None:
    view, hand = opened(photo)
    assert not ACTIONS["save mask"].able(view)
    hand.key("c")
    hand.drag((250, 250), (330, 260))
    made = view.document.freeze.shown((380, 560)) == 0
    assert made.sum() > 500
    ACTIONS["save mask"].do(view)
    assert view.commands.asked.path == str(tmp_path / "photo-frozen.png")
    assert view.commands.answer("Save")
    pixels = image.read(tmp_path / "photo-frozen.png").pixels
    assert ((pixels == 255) <= made).all()
    assert (pixels == 255).sum() > 0.8 * made.sum()
    ACTIONS["thaw all"].do(view)
    ACTIONS["load mask"].do(view)
    view.commands.asked.path = str(tmp_path / "photo-frozen.png")
    assert view.commands.answer("Load")
    np.testing.assert_array_equal(view.document.freeze.shown((380, 560)) == 0, made)
    assert read_freeze(tmp_path / "photo-frozen.png") == view.document.freeze
    ACTIONS["save mask"].do(view)
    assert view.commands.answer("Replace")
    assert read_freeze(tmp_path / "photo-frozen.png") == view.document.freeze  # once
    # What it would replace is asked about, and what is no mask is refused.
    ACTIONS["save mask"].do(view)
    assert not view.commands.answer("Save")
    assert "or Replace" in view.commands.asked.problem
    assert view.commands.answer("Replace")
    ACTIONS["load mask"].do(view)
    view.commands.asked.path = str(photo)
    assert not view.commands.answer("Load")
    assert "it has colours" in view.commands.asked.problem


def test_the_mask_of_a_volume_is_a_label(gpu: Gpu, volume: Path, tmp_path: Path) -> None:
    from supple.media import volume as volumes

    view, hand = opened(volume)
    hand.key("c")
    view.tools.radius = 12
    hand.drag((160, 150), (175, 150))
    made = view.document.freeze.shown(view.document.shape) == 0
    view.commands.ask("save mask")
    assert view.commands.answer("Save")
    saved = volumes.read(tmp_path / "head-frozen.nii.gz")
    assert ((np.asarray(saved.samples) == 1) <= made).all()
    np.testing.assert_allclose(saved.geometry.matrix, view.document.geometry.matrix, atol=1e-4)
    view.commands.ask("load mask")
    assert view.commands.answer("Load")
    loaded = view.document.freeze.shown(view.document.shape) == 0
    assert (loaded <= made).all()
    assert loaded.sum() > 0.9 * made.sum()


def test_messages_are_in_the_words_of_the_window(gpu: Gpu) -> None:
    view, hand = opened(GREY, Recipe(on_fold="error"))
    hand.key("w")
    hand.press(300, 300)
    hand.move(310, 300, 1)
    assert "Bloat by a factor of 1." in status(view)
    hand.move(900, 300, 1)
    said = status(view)
    assert said.startswith("Bloat at (")
    assert "scale" not in said
    assert "\u201cGo in small steps\u201d" in said
    assert "on_fold" not in said
    hand.key("Escape")
    hand.release(900, 300)


def test_the_first_hints_go_away_with_the_first_stroke(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = grey()
    view.hinted = False
    low = np.s_[SIZE[1] - LINE - 100 : SIZE[1] - LINE - 40, 200:450]
    hinted = hand.canvas.draw()[low].copy()
    assert hinted[..., :3].max() > 200  # letters
    hand.drag((300, 250), (320, 250))
    hand.move(20, 100)
    hand.canvas.draw()
    assert hand.canvas.draw()[low][..., :3].max() < 200
    assert view.hinted
    assert json.loads((tmp_path / "config" / "supple" / "window.json").read_text())["hinted"] is True


@pytest.mark.parametrize("turned", [False, True])
def test_the_grid_is_the_original_s_bent_and_drawn_fast(gpu: Gpu, turned: bool) -> None:
    view, hand = grey(PULL)
    hand.key("1")
    hand.move(20, 100)
    plain = hand.canvas.draw()[..., :3].astype(int)
    view.overlay = "grid"
    view.tools.original = turned
    view.refresh()
    seen = hand.canvas.draw()[..., :3].astype(int)
    assert view._shot(moving=False).sight.overlay == ""  # the device solves nothing
    bent = view.document.base if turned else view.document.deformation
    for x, y in ((192.0, 100.0), (192.0, 130.0), (210.0, 128.0), (64.0, 70.0)):
        column, row = (round(v) for v in view.tools.view.to_canvas(*bent.forward((x, y))))
        near = np.s_[row - 2 : row + 3, column - 2 : column + 3]
        assert (seen[near] - plain[near]).max() > 40
    x, y = (round(v) for v in view.tools.view.to_canvas(*bent.forward((208.0, 112.0))))  # within a square
    assert np.abs(seen[y, x] - plain[y, x]).max() < 10
    assert [grid_step(zoom) for zoom in (2.0, 1.0, 0.3, 0.05)] == [32, 32, 64, 512]


def test_an_export_has_its_options_beside_its_name(gpu: Gpu, photo: Path, tmp_path: Path, boxes: Boxes) -> None:
    view, hand = opened(photo)
    hand.drag((300, 250), (340, 230))
    hand.key("e", "Control")
    for _ in range(3):
        hand.canvas.draw()
    assert "##quality" not in boxes  # a PNG has none, and is compressed without loss
    assert "##compression" in boxes
    hand.click(boxes.place("##format"))
    hand.canvas.draw()
    view.commands.asked.path = str(tmp_path / "photo-bent.jpg")
    hand.key("Escape")  # closes the list, and not the question
    for _ in range(3):
        hand.canvas.draw()
    assert view.commands.asked is not None
    x, y = boxes.place("##quality")
    hand.click((x + 60, y))
    quality = view.commands.options["quality"]
    assert 1 <= quality < 40
    assert view.commands.answer("Export")
    assert view.commands.export.join(60)
    assert view.commands.export.error is None
    small = (tmp_path / "photo-bent.jpg").stat().st_size
    view.commands.options = {**view.commands.options, "quality": 95}
    view.commands.begin_export(tmp_path / "fine.jpg")
    assert view.commands.export.join(60)
    assert (tmp_path / "fine.jpg").stat().st_size > 1.5 * small
    # A quality, or a compression, that a format does not have is no reason to fail.
    sizes = []
    for how, name in (("none", "plain.png"), ("9", "small.png"), ("lzw", "other.png"), ("lzw", "picture.tif")):
        view.commands.options = {**view.commands.options, "compression": how}
        view.commands.begin_export(tmp_path / name)
        assert view.commands.export.join(60)
        assert view.commands.export.error is None
        sizes.append((tmp_path / name).stat().st_size)
    assert sizes[0] > 1.2 * sizes[2] >= 1.2 * sizes[1]
