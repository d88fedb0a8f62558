"""Every control of the panel, clicked: the window lives, and what is kept is kept."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.gpu.device import Gpu
from supple.media import video
from supple.strokes import Recipe, Stroke
from supple.strokes.keys import Key
from supple.viewer.document.editing import Document
from supple.viewer.document.files import FileCommands
from supple.viewer.panels.view import WIDE
from tests.viewer.windows import DATA, SIZE, Boxes, Hand, imgui, opened, watch

FLAT = (Stroke(at=(200, 120), by=(20, 10), radius=40), Stroke(at=(100, 90), by=(-10, 10), radius=30))
DEEP = (Stroke(at=(20, 60, 60), by=(3, 0, 1), radius=20),)
CLICKED: set[tuple[bool, str]] = set()  # controls that a medium before has as well


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Boxes:
    """The controls, by their functions and labels."""
    return watch(monkeypatch, lambda function, label: f"{function} {label}")


SECTIONS = (
    "Brush",
    "Strokes",
    "Volume",
    "View",
    "Folds and border",
    "Accuracy",
    "History",
)


@pytest.fixture
def all_open(tmp_path: Path) -> None:
    """No section is folded."""
    (tmp_path / "config" / "supple").mkdir(parents=True)
    data = {"sections": dict.fromkeys(SECTIONS, True)}
    (tmp_path / "config" / "supple" / "window.json").write_text(json.dumps(data))


@pytest.mark.usefixtures("all_open")
@pytest.mark.parametrize("kind", ["photo", "clip", "moving", "head"])
def test_every_control_can_be_clicked(gpu: Gpu, seen: Boxes, kind: str, clip: Path, volume: Path) -> None:
    if kind == "photo":
        source, strokes = DATA / "coffee.jpg", FLAT
    elif kind == "moving":
        source, strokes = clip, (replace(FLAT[0], keys=(Key(0, at=(200, 120)), Key(9, strength=0.5))),)
    elif kind == "clip":
        source, strokes = clip, (Stroke(at=(200, 120, 9), by=(20, 10, 3), radius=40),)
    else:
        source, strokes = volume, (Stroke(at=(20, 30, 25), by=(3, 0, 1), radius=20),)
    # All of the panel, and little beside it: a program takes its time for each pixel.
    view, hand = opened(source, Recipe(border=None, strokes=strokes), size=(WIDE + 120, 1400))
    view.document.select(0)
    pairs = []
    for own in (False, True):  # the numbers of the brush, and of the stroke
        seen.clear()
        view.own = own
        hand.canvas.draw()
        pairs += [(own, label) for label in seen]
    labels = [label for _, label in pairs]
    wanted = {"invisible_button undo", "button Delete", "button Export \u2026", "begin_menu File"}
    wanted |= {"combo ##overlay"} if view.stage.kind != "volume" else set()
    assert wanted <= set(labels)
    assert {label.rpartition("#")[2] for label in labels if "header" in label} >= set(SECTIONS) - {"Volume"}
    assert len(labels) > 40
    for own, label in pairs:
        if (own, label) in CLICKED:
            continue
        CLICKED.add((own, label))
        view.commands.asked = None
        view.document.load(Recipe(border=None, strokes=strokes))
        view.document.select(0)
        view.own = own
        view.sections |= dict.fromkeys(SECTIONS, True)  # what was folded is opened again
        hand.pass_frame()
        before = view.document.state
        hand.click(seen.place(label))
        assert view._gui.trouble == "", label
        hand.key("Escape")
        if imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
            hand.click((10, 1390))  # closes a menu
        if label == "button Delete":
            assert len(view.document.strokes) == len(strokes) - 1
        elif label == "invisible_button undo":
            assert view.document.state != before


def test_what_goes_wrong_does_not_kill_the_window(gpu: Gpu, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    whole = hand.canvas.draw()

    def broken(view: Any, i: int) -> None:
        imgui.begin_child("half", (0, 50))
        raise ValueError("of its own")

    monkeypatch.setattr("supple.viewer.panels.strokes._selected", broken)
    view.own = True
    for k in range(3):
        hand.drag((200 + 20 * k, 300), (220 + 20 * k, 310))
    assert view.commands.message == "ValueError: of its own"
    assert len(view.document.strokes) == 3
    view.commands.autosave.keep()
    assert len(json.loads(view.commands.autosave.place.read_text())["recipe"]["strokes"]) == 3
    monkeypatch.undo()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    view.document.undo()
    view.document.undo()
    view.document.undo()
    view.commands.message = ""
    for _ in range(3):
        again = hand.canvas.draw()
    assert np.abs(again[:, 660:, :3].astype(int) - whole[:, 660:, :3]).mean() < 4


def test_files_are_replaced_only_when_that_is_said(gpu: Gpu, tmp_path: Path) -> None:
    source = tmp_path / "photo.jpg"
    source.write_bytes((DATA / "coffee.jpg").read_bytes())
    kept = source.read_bytes()
    view, hand = opened(source, Recipe(border=None))
    hand.drag((200, 300), (220, 310))
    mine, other = tmp_path / "a.json", tmp_path / "b.json"
    view.commands.save(mine)
    hand.drag((240, 300), (220, 310))
    other.write_text("PRECIOUS")
    assert not view.commands.may_close()
    assert view.commands.asked.offered == ("Save and close", "Replace and close", "Close without saving", "Cancel")
    view.commands.asked.path = str(tmp_path / "none.json")
    assert view.commands.asked.offered == ("Save and close", "Close without saving", "Cancel")
    view.commands.asked.path = str(other)
    assert not view.commands.answer("Save and close")
    assert other.read_text() == "PRECIOUS"
    for name in ("save", "copy", "export"):
        view.commands.recipe_path = None
        view.commands.ask(name)
        view.commands.asked.path = os.fspath(source)
        assert not view.commands.answer("Replace")
        assert "is what is bent here" in view.commands.asked.problem
        assert source.read_bytes() == kept
    view.commands.recipe_path = mine
    view.commands.ask("close")
    assert view.commands.answer("Save and close")
    assert len(json.loads(mine.read_text())["strokes"]) == 2


@pytest.mark.parametrize(
    ("source", "bad", "text", "usual"),
    [
        ("coffee.jpg", "b.xyz", "the suffix .xyz is no image format: use .png", "a-bent.jpg"),
        ("coffee.jpg", "b", "a name without suffix is no image format", "a-bent.jpg"),
        ("coffee.jpg", "b.mp4", "is a picture, and has no time", "a-bent.jpg"),
        ("bunny.mp4", "b.xyz", "the suffix .xyz is no video format: use .mp4", "a-bent.mp4"),
        ("bunny.mp4", "b%03d.xyz", "the suffix .xyz is no image format", "a-bent.mp4"),
        ("bunny.mp4", "b.png", "is one picture, and a clip is many", "a-bent.mp4"),
        ("head.nii.gz", "b.xyz", "the suffix .xyz is no format that volumes are written in", "a-bent.nii.gz"),
        ("head.nii.gz", "none/b.nii", "there is no folder", "a-bent.nii.gz"),
    ],
)
def test_what_nothing_can_write_is_refused_in_the_question(
    tmp_path: Path, source: str, bad: str, text: str, usual: str
) -> None:
    place = tmp_path / source.replace(source.partition(".")[0], "a")
    place.write_bytes((DATA / source).read_bytes())
    begun: list[Any] = []
    document = Document((9, 20, 30), kind={"c": "image", "b": "video", "h": "volume"}[source[0]])  # type: ignore[arg-type]
    commands = FileCommands(document, place, lambda path, force: begun.append(path), lambda: None)
    commands.ask("export")
    assert commands.asked is not None
    assert commands.asked.path == str(tmp_path / usual)
    commands.asked.path = str(tmp_path / bad)
    assert not commands.answer("Export")
    assert text in commands.asked.problem
    assert commands.export is None
    for name, wrong in (("copy", "b.xyz"), ("copy", "b.mp4"), ("save", "b.png"), ("save", "b.nii.gz")):
        commands.ask(name)
        commands.asked.path = str(tmp_path / wrong)
        assert not commands.answer("Save")
        assert "use " in commands.asked.problem
        assert "\n" not in commands.asked.problem
    assert not begun
    assert sorted(path.name for path in tmp_path.iterdir()) == [place.name]
    commands.end()


def test_formats_that_are_only_read_are_exported_as_others(tmp_path: Path) -> None:
    for name, kind, usual in (
        ("a.bmp", "image", "a-bent.bmp"),
        ("a.mpg", "video", "a-bent.mp4"),
        ("frames-%05d.bmp", "video", "frames-%05d-bent.bmp"),
        ("a.raw", "volume", "a-bent.nii.gz"),
        ("1.2.840", "volume", "1.2.840-bent.nii.gz"),
        ("v1.2", "video", "v1.2-bent"),
    ):
        if name in ("1.2.840", "v1.2"):
            (tmp_path / name).mkdir()
        commands = FileCommands(
            Document((9, 20, 30), kind=kind), tmp_path / name, lambda path, force: None, lambda: None
        )  # type: ignore[arg-type]
        commands.ask("export")
        assert commands.asked is not None
        assert commands.asked.path == str(tmp_path / usual)
        commands.end()


def test_a_folder_that_is_here_can_be_closed(gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    for k in range(3):
        Image.fromarray(np.full((40, 50, 3), 80 * k, np.uint8)).save(tmp_path / f"{k:03d}.png")
    monkeypatch.chdir(tmp_path)
    view, hand = opened(".", Recipe(border=None))
    hand.drag((300, 300), (330, 310))
    for name in ("save", "open", "export", "copy", "close"):
        view.commands.recipe_path = None
        view.commands.ask(name)
        assert str(tmp_path) in view.commands.asked.path
    view.commands.asked = None


def test_keys_during_a_drag_wait_for_it(gpu: Gpu) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.move(200, 300)
    hand.press(200, 300)
    hand.move(230, 310, 1)
    for key in ("s", "e", "o"):
        hand.key(key, "Control")
        assert view.commands.asked is None
        assert "let go of the stroke first" in view.commands.message
    hand.release(230, 310)
    assert len(view.recipe.strokes) == 1
    # A question that comes up meanwhile does not keep the pointer from letting go.
    hand.press(300, 300)
    hand.move(330, 310, 1)
    view.commands.ask("save")
    hand.release(330, 310)
    assert not view.document.dragging
    view.commands.asked = None


def test_a_press_beside_the_panel_is_not_swallowed(gpu: Gpu) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.move(SIZE[0] - 100, 300)
    hand.canvas.draw()
    hand.move(300, 300)
    hand.press(300, 300)  # and nothing is drawn in between
    hand.move(330, 310, 1)
    hand.release(330, 310)
    assert len(view.recipe.strokes) == 1
    for button in (0, 6, 9):  # mice have many
        hand.press(300, 300, button)
        hand.release(300, 300, button)
    hand.key("\\")
    hand.send("key_down", key="\\")
    assert view.tools.original
    hand.send("key_up", key="|")
    assert not view.tools.original


def test_callbacks_hear_of_other_recipes_only(gpu: Gpu) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    heard: list[int] = []

    @view.on_change
    def changed(recipe: Recipe) -> None:
        heard.append(len(recipe.strokes))
        if len(heard) == 1:
            raise RuntimeError("theirs")

    hand.drag((200, 300), (220, 310))
    assert "on_change: RuntimeError: theirs" in view.commands.message
    count = len(heard)
    view.document.select(None)
    view.document.select(0)
    view.document.mark_saved()
    assert len(heard) == count


def test_a_recipe_of_another_medium_is_refused_in_a_sentence(gpu: Gpu, tmp_path: Path) -> None:
    place = tmp_path / "head.json"
    place.write_text(Recipe(border=None, strokes=DEEP).to_json())
    view, _ = opened(DATA / "coffee.jpg", Recipe(border=None))
    view.commands.ask("open")
    view.commands.asked.path = str(place)
    assert not view.commands.answer("Open")
    assert "stroke 1 has points of 3 numbers, and this is a picture, with points x, y" in (view.commands.asked.problem)
    view.commands.asked = None
    view.close()
    with pytest.raises(supple.SuppleError, match="and this is a volume, with points x, y, z"):
        opened(DATA / "head.nii.gz", Recipe(border=None, strokes=FLAT))
    view, _ = opened(DATA / "bunny.mp4", Recipe(border=None, strokes=FLAT))  # in every frame
    view.close()
    moving = replace(FLAT[0], keys=(Key(3, strength=0),))
    with pytest.raises(
        supple.SuppleError, match="stroke 1 of the recipe moves from frame to frame, and this is no clip"
    ):
        opened(DATA / "coffee.jpg", Recipe(border=None, strokes=(moving,)))


def test_what_is_not_kept_yet_may_wait(gpu: Gpu) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.drag((200, 300), (220, 310))
    view.close()
    again, _ = opened(DATA / "coffee.jpg")
    assert again.commands.asked.choices == ("Restore", "Keep for later")
    assert again.commands.answer("Keep for later")
    assert not again.recipe.strokes
    (place,) = again.commands.autosave.place.parent.glob("*.kept")
    assert place.name in again.commands.message
    assert len(json.loads(place.read_text())["recipe"]["strokes"]) == 1


def test_what_an_export_said_is_gone_with_an_undo(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.drag((200, 300), (220, 310))
    view.commands.begin_export(tmp_path / "out.png")
    assert view.commands.export.join(120)
    hand.canvas.draw()
    assert "out.png" in view.commands.message
    hand.key("z", "Control")
    assert view.commands.message == ""


def type_(hand: Hand, text: str) -> None:
    """Type a text in the place of what is there."""
    hand.modifiers = ("Control",)
    hand.send("key_down", key="a")
    hand.canvas.draw()
    hand.send("key_up", key="a")
    hand.modifiers = ()
    hand.canvas.draw()
    for letter in text:
        hand.send("key_down", key=letter)
        hand.send("char", data=letter, is_composing=False, input_type="insertText", repeat=False)
        hand.send("key_up", key=letter)
        hand.pass_frame()


@pytest.mark.parametrize("leaving", ["Tab", "Enter", "elsewhere"])
def test_a_number_that_is_typed_counts_when_it_is_left(gpu: Gpu, seen: Boxes, leaving: str) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None, strokes=FLAT), size=(SIZE[0], 1400))
    view.document.select(0)
    view.own = True
    hand.canvas.draw()
    place, before = seen.place("input_float ##at0"), FLAT[0].at[0]
    hand.click(place)
    type_(hand, "61")
    assert view.document.strokes[0].at[0] == before  # not yet
    if leaving == "elsewhere":
        hand.click((SIZE[0] - 5, 1300))
    else:
        hand.key(leaving)
    for _ in range(3):
        hand.canvas.draw()
    assert view.document.strokes[0].at[0] == 61
    assert view.typed == {}
    view.document.undo()
    assert view.document.strokes[0].at[0] == before  # it is one step


def test_options_of_an_export(gpu: Gpu, seen: Boxes, tmp_path: Path, clip: Path) -> None:
    stroke = Stroke(at=(120, 80, 4), by=(14, 6, 0), radius=40)
    view, hand = opened(clip, Recipe(border=None, strokes=(stroke,)), size=(SIZE[0], 1600))
    view.commands.ask("export")
    for _ in range(3):
        hand.canvas.draw()
    for field, text in (("input_text ##codec", "ffv1"), ("input_float ##time scale", "3")):
        hand.click(seen.place(field))
        type_(hand, text)
        hand.key("Enter")
        hand.canvas.draw()
    hand.click(seen.place("checkbox ##time filter"))
    assert view.commands.export is None  # Enter in a field of options is for that
    assert view.commands.asked.name == "export"
    clip = view.commands.options["clip"]
    assert (clip.codec, clip.crf, clip.time_scale, clip.time_filter) == ("ffv1", None, 3.0, True)
    view.commands.begin_export(tmp_path / "out.mkv")
    assert view.commands.export.join(120)
    assert view.commands.export.error is None
    assert video.info(tmp_path / "out.mkv")["codec"] == "ffv1"
    assert view.commands.export.result.deformation.domain.spacing[2] == 3.0


def test_what_is_typed_before_a_question_is_not_its_answer(gpu: Gpu) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.drag((300, 250), (340, 230))
    for kind, more in (("key_down", {}), ("char", {"data": "b"}), ("key_up", {})):
        hand.send(kind, key="b", **more)
    hand.key("s", "Control")
    for _ in range(4):
        hand.canvas.draw()
    asked = view.commands.asked
    assert asked is not None
    assert asked.path == str(DATA / "coffee.recipe.json")


def test_opening_over_strokes_that_were_not_saved_asks(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    other = tmp_path / "other.json"
    other.write_text(Recipe(border=None, strokes=FLAT).to_json(), encoding="utf-8")
    hand.drag((300, 250), (340, 230))
    mine = view.recipe
    for way in ("drop", "ask"):
        if way == "drop":
            view.drop([str(other)])
        else:
            view.commands.ask("open")
            view.commands.asked.path = str(other)
            assert view.commands.answer("Open")
        assert view.commands.asked.name == "over"
        assert view.recipe == mine
        assert not view.commands.may_close() or view.commands.asked is not None
        view.commands.ask("open")
        view.commands.asked = None
        assert view.document.dirty
    view.drop([str(other)])
    assert view.commands.answer("Open it")
    assert view.commands.asked is None
    assert view.recipe.strokes == FLAT
    assert not view.document.dirty
    view.document.undo()
    assert view.recipe == mine
    # What does not fit is refused without a question.
    deep = tmp_path / "deep.json"
    deep.write_text(Recipe(border=None, strokes=DEEP).to_json(), encoding="utf-8")
    view.drop([str(deep)])
    assert view.commands.asked is None
    assert "x, y, z" in view.commands.message or "3 numbers" in view.commands.message


def test_a_recipe_is_saved_under_another_name(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = opened(DATA / "coffee.jpg", Recipe(border=None))
    hand.drag((300, 250), (340, 230))
    view.commands.save(tmp_path / "one.json")
    hand.drag((200, 250), (240, 230))
    hand.key("s", "Control", "Shift")
    asked = view.commands.asked
    assert asked.name == "save"
    asked.path = str(tmp_path / "two.json")
    assert view.commands.answer("Save")
    count = [len(Recipe.from_json((tmp_path / name).read_text()).strokes) for name in ("one.json", "two.json")]
    assert count == [1, 2]
    assert view.commands.recipe_path == tmp_path / "two.json"
