"""Dialogs of the system for files, where a desktop has them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from typing import Any

from supple.viewer.document.files import Question

_PROGRAMS = ("zenity", "kdialog", "matedialog", "qarma")  # programs that show the dialogs on X or Wayland


def chooser() -> Callable[[Question], Any] | None:
    """Return a function that opens a dialog for a question; None on a desktop without such dialogs.

    The dialog is one of `portable_file_dialogs`, which is open in a process or a thread of its own.
    """
    if sys.platform.startswith("linux"):
        screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if not screen or not any(map(shutil.which, _PROGRAMS)):
            return None
    try:
        from imgui_bundle import portable_file_dialogs as dialogs
    except ImportError:
        return None

    def choose(question: Question) -> Any:
        path = question.path or ""
        recipes, every = ["Recipes", "*.json"], ["All files", "*"]
        if question.name in ("open", "load mask"):
            folder = os.path.join(os.path.dirname(path), "")
            kinds = every + recipes if question.name == "open" else every
            return dialogs.open_file(question.title, folder, kinds)
        kinds = recipes + every if question.name == "save" else every
        return dialogs.save_file(question.title, path, kinds)

    return choose
