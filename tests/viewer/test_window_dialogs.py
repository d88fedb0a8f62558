"""Dialogs of the system for files: what they answer is done, and where there are none, names are typed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from supple.strokes import Recipe, Stroke
from supple.viewer.document.editing import Document
from supple.viewer.document.files import FAILED, FileCommands, Question

STROKE = Stroke(at=(20, 20), by=(4, 2), radius=9)


class Dialog:
    """A dialog that is answered by a test."""

    def __init__(self) -> None:
        self.says: str | None = None
        self.closed = False

    def ready(self, timeout: int) -> bool:
        return self.says is not None

    def result(self) -> str | None:
        return self.says

    def kill(self) -> None:
        self.closed = True


@pytest.fixture
def desk(tmp_path: Path) -> tuple[FileCommands, list[tuple[Question, Dialog]]]:
    commands = FileCommands(Document((40, 60)), tmp_path / "a.png", lambda path, force: None, lambda: None)
    opened: list[tuple[Question, Dialog]] = []

    def choose(question: Question) -> Dialog:
        opened.append((question, Dialog()))
        return opened[-1][1]

    commands.choose = choose
    return commands, opened


def test_what_a_dialog_answers_is_done(desk: Any, tmp_path: Path) -> None:
    commands, opened = desk
    commands.document.add(STROKE)
    commands.ask("save")
    commands.tick()
    assert commands.asked is None  # nothing waits for it
    commands.document.add(STROKE)
    commands.ask("open")
    assert "a dialog for a file is open" in commands.message
    ((question, dialog),) = opened
    assert question.path == str(tmp_path / "a.recipe.json")
    place = tmp_path / "mine.json"
    place.write_text("old")  # whether to replace it, the dialog has asked
    dialog.says = str(place)
    commands.tick()
    assert commands.choosing is None
    assert commands.asked is None
    assert len(Recipe.from_json(place.read_text()).strokes) == 2
    assert commands.message == f"saved to {place}"
    commands.document.load(Recipe())
    commands.document.mark_saved()
    commands.ask("open")
    opened[-1][1].says = str(place)
    commands.tick()
    assert len(commands.document.strokes) == 2
    commands.end()


def test_a_name_that_cannot_be_is_typed_again(desk: Any, tmp_path: Path) -> None:
    commands, opened = desk
    commands.ask("export")
    assert not opened  # the window has its options
    commands.browse()
    assert len(opened) == 1
    opened[-1][1].says = str(tmp_path / "a.xyz")
    commands.tick()
    assert commands.asked.name == "export"
    assert commands.asked.path == str(tmp_path / "a.xyz")
    assert not commands.answer("Export")
    assert "the suffix .xyz is no image format" in commands.asked.problem
    commands.end()


def test_nothing_is_an_answer_but_not_at_once(desk: Any) -> None:
    commands, opened = desk
    commands.ask("open")
    question, dialog, begun = commands.choosing
    commands.choosing = question, dialog, begun - 2 * FAILED
    dialog.says = ""
    commands.tick()
    assert (commands.asked, commands.choosing) == (None, None)
    assert commands.choose is not None
    # A program that ends at once has shown nothing: names are typed from then on.
    commands.ask("save")
    opened[-1][1].says = ""
    commands.tick()
    assert commands.asked.name == "save"
    assert commands.choose is None
    commands.end()


def test_a_question_comes_first_and_the_end_closes_it(desk: Any) -> None:
    commands, opened = desk
    commands.document.add(STROKE)
    commands.ask("open")
    assert not commands.may_close()
    assert commands.asked.name == "close"  # in the window itself
    opened[-1][1].says = "/nowhere.json"
    commands.tick()
    assert commands.asked.name == "close"
    commands.document.mark_saved()
    commands.end()
    assert opened[-1][1].closed


def test_without_a_desktop_names_are_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imgui_bundle")
    from supple.viewer.window.dialogs import chooser

    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":0")
    assert chooser() is None
    (tmp_path / "zenity").write_text("#!/bin/sh\n")
    (tmp_path / "zenity").chmod(0o755)
    assert chooser() is not None
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert chooser() is None


PROGRAM = """#!/bin/sh
echo "$@" >> "$ASKED"
sleep 0.4
echo "$ANSWER"
"""
ASKING = """
import time
from supple.viewer.document.files import Question
from supple.viewer.window.dialogs import chooser
for name in ("save", "open"):
    begun = time.monotonic()
    dialog = chooser()(Question(name, "A title", "", ("Save", "Cancel"), path="/tmp/some/a.json"))
    found, looks, longest = None, 0, 0.0
    while found is None:
        began = time.monotonic()
        found = dialog.result() if dialog.ready(0) else None
        longest, looks = max(longest, time.monotonic() - began), looks + 1
        time.sleep(0.01)
    print(name, *([found] if isinstance(found, str) else found), looks > 5, longest < 0.1)
dialog = chooser()(Question("open", "A title", "", ("Open", "Cancel"), path="/tmp/some/a.json"))
dialog.kill()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it is asked by a program on Linux only")
def test_a_program_of_the_desktop_is_asked_and_not_waited_for(tmp_path: Path) -> None:
    pytest.importorskip("imgui_bundle")
    (tmp_path / "zenity").write_text(PROGRAM)
    (tmp_path / "zenity").chmod(0o755)
    env = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "DISPLAY": ":0", "XDG_CURRENT_DESKTOP": "GNOME"}
    env |= {"ASKED": str(tmp_path / "asked"), "ANSWER": "/some where/b.json"}
    ran = subprocess.run(
        [sys.executable, "-c", ASKING], env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.stderr == ""
    assert ran.stdout.splitlines() == ["save /some where/b.json True True", "open /some where/b.json True True"]
    save, open_ = (tmp_path / "asked").read_text().split("--file-selection")[1:3]
    assert "--confirm-overwrite" in save
    assert "--save" in save
    assert "/tmp/some/a.json" in save
    assert "--save" not in open_
