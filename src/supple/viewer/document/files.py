"""The file commands of a window: it saves and opens recipes, exports, and asks before anything is lost."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from supple.errors import SuppleError, shown
from supple.files import PathLike, check_job, write_recipe
from supple.files.clips import SUFFIXES_OUT as CLIPS_OUT
from supple.files.clips import is_picture_target
from supple.media.files import check_output, same_file
from supple.media.image import SUFFIXES_OUT as PICTURES_OUT
from supple.media.image import check_target
from supple.media.volume import SUFFIXES_OUT as VOLUMES_OUT
from supple.media.volume import suffix_of
from supple.strokes import Recipe, spoken
from supple.viewer.document import autosave
from supple.viewer.document.autosave import Autosave
from supple.viewer.document.background import Export
from supple.viewer.document.editing import Document
from supple.viewer.document.state import Kind


@dataclass(slots=True)
class Question:
    """Something that the window asks."""

    name: str  # what it is about
    title: str
    text: str
    choices: tuple[str, ...]  # the first is what Enter means; "Cancel" does nothing
    path: str | None = None  # the name of a file, which can be edited
    opens: PathLike = ""  # one that cannot
    problem: str = ""
    fresh: bool = True  # it was not drawn yet


@dataclass(eq=False)
class FileCommands:
    """The files around a document."""

    document: Document
    source: Path | None  # the file that is bent; an array has none
    write_view: Callable[[str, bool], None]  # to a file, and whether one that exists may be replaced
    leave: Callable[[], None]  # closes the window
    device: str = "cpu"  # who exports, as `supple.warp_file` takes it
    options: Mapping[str, Any] = field(default_factory=dict)  # what else it takes, to make what is seen

    def __post_init__(self) -> None:
        self.message = ""  # the text of the status line, until something else happens
        self.asked: Question | None = None
        self.export: Export | None = None
        self.recipe_path: Path | None = None  # where the recipe was saved to or opened from
        self._told: Export | None = None
        self.autosave = None if self.source is None else Autosave(self.source, self.document)
        self._left = None if self.source is None else autosave.found(self.source)
        if self._left is not None:
            count = len(self._left.recipe.strokes)
            what = "1 stroke on this file was" if count == 1 else f"{count} strokes on this file were"
            text = f"{what} not saved the last time."
            if not self._left.same:
                text += "\nThe file has changed since then."
            if not self._left.read_alike(self.document):
                text += "\nIt was read otherwise then: by another --time-scale, --series, --shape or --spacing."
            self.asked = Question("restore", "Restore?", text, ("Restore", "Leave"))

    def tick(self) -> None:
        """Keep what has changed, if it is time to; and say what came of an export."""
        if self.autosave is not None:
            self.autosave.tick()
        export = self.export
        if export is not None and export.done and self._told is not export:
            self._told = export
            self.message = "; ".join(filter(None, [export.error or export.text, *export.warnings]))

    def attempt(self, work: Callable[[], object]) -> None:
        """Do what may be refused, and say so then."""
        try:
            self.message = ""
            work()
        except SuppleError as error:
            self.message = _in_a_window(error)

    def ask(self, name: str) -> None:
        """Begin what is asked for: ``"save"``, ``"save as"``, ``"open"``, ``"export"``, ``"copy"`` or ``"close"``."""
        source = Path(os.path.abspath(self.source or "picture.png"))
        suffix = "" if os.path.isdir(source) else suffix_of(source)
        stem = os.fspath(source)[: len(os.fspath(source)) - len(suffix)]
        written, usual = _WRITTEN.get(self.document.kind, ((suffix,), suffix))
        several = self.document.kind == "video" and is_picture_target(source)
        bent = f"{stem}-bent{suffix if several or suffix in written else usual}"
        recipe = os.fspath(self.recipe_path or f"{stem}.recipe.json")
        if name == "save" and self.recipe_path is not None:
            known = self.recipe_path
            self.attempt(lambda: self.save(known, force=True))
            return
        name = "save" if name == "save as" else name
        path = {"export": bent, "copy": f"{stem}-view.png"}.get(name, recipe)
        self.asked = Question(name, *_ASKED[name], path)

    def may_close(self) -> bool:
        """Return whether nothing would be lost; otherwise, the question is asked."""
        if self.document.dirty:
            self.ask("close")
            return False
        if self.export is not None and not self.export.done:
            self.asked = Question("stop", "Close?", "An export is under way.", ("Stop it and close", "Cancel"))
            return False
        return True

    def answer(self, choice: str) -> bool:
        """Go on with what was asked; return whether that is done with."""
        asked = self.asked
        if asked is None:
            return True
        try:
            if choice != "Cancel":
                self._do(asked, choice)
            if self.asked is asked:
                self.asked = None
        except SuppleError as error:
            asked.problem = _in_a_window(error)
            return False
        return True

    def _do(self, asked: Question, choice: str) -> None:
        path, force = asked.path or "", choice == "Replace"
        if asked.name == "restore" and self._left is not None:
            if choice == "Restore":
                self.document.load(self._left.recipe)
                if self.autosave is not None and not self.autosave.keep():
                    raise SuppleError(f"it is restored, but cannot be kept again: {self.autosave.trouble}: save it")
            place = self._left.set_aside()
            if choice == "Leave":
                self.message = f"they are kept in {shown(place)}"
            self._left = None
        elif asked.name == "save":
            self.save(path, force=force)
        elif asked.name == "open":
            self.open(path)
        elif asked.name == "over":
            self.open(asked.opens, sure=True)
        elif asked.name == "copy":
            self._spare(path)
            check_target(path)
            check_output(path, force=force)  # what is seen may take seconds to draw
            self.write_view(path, force)
            self.message = f"saved {path}"
        elif asked.name == "export":
            self.begin_export(path, force=force)
        elif asked.name == "close":
            if choice in ("Save and close", "Replace and close"):
                known = self.recipe_path is not None and same_file(path, self.recipe_path)
                self.save(path, force=known or choice == "Replace and close")
            else:
                self.document.mark_saved()  # it is not wanted
            if self.may_close():  # an export may be under way
                self.leave()
        elif asked.name == "stop":
            self.end_export()
            self.leave()

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write the recipe.

        Raises
        ------
        SuppleError
            If it cannot be written, or is there already and must not be replaced.
        """
        if not os.fspath(path):
            raise SuppleError("the recipe needs a name: such as strokes.json")
        self._spare(path)
        write_recipe(path, self.document.recipe, force=force)
        self.recipe_path = Path(path)
        self.document.mark_saved()
        self.message = f"saved {shown(path)}"

    def _spare(self, path: PathLike) -> None:
        """Refuse to write over what is bent here."""
        if self.source is not None and same_file(path, self.source):
            raise SuppleError(f"{shown(path)} is what is bent here: choose another name")

    def open(self, path: PathLike, *, sure: bool = False) -> None:
        """Put a recipe in the place of the strokes that there are, as one step.

        Where these were not saved, it is asked first, unless somebody is sure.

        Raises
        ------
        SuppleError
            If it cannot be read, or does not fit.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError, ValueError) as error:
            why = getattr(error, "strerror", None) or "it is no text"
            raise SuppleError(f"cannot read {shown(path)}: {why}: check the name") from None
        recipe = Recipe.from_json(text)
        if self.document.dirty and not sure:
            self.document.fitted(recipe)
            self.asked = Question("over", "Open it?", _OVER, ("Open it", "Cancel"), opens=path)
            return
        self.document.load(recipe)
        self.recipe_path = Path(path)
        self.document.mark_saved()
        size = self.document.shape[::-1]
        scaled = recipe.size not in (None, size) and recipe.strokes and not recipe.is_world
        self.message = f"opened {shown(path)}" + (f", scaled to {spoken(size)}" if scaled else "")

    def open_beside(self, path: PathLike) -> None:
        """Open another medium in a window of its own; nothing is lost here.

        Raises
        ------
        SuppleError
            If there is no such file.
        """
        if not os.path.exists(path):
            raise SuppleError(f"cannot read {shown(path)}: there is no such file")
        subprocess.Popen([sys.executable, "-m", "supple", "view", os.fspath(path)], start_new_session=True)
        self.message = f"{shown(path)} opens in a window of its own"

    def begin_export(self, path: PathLike, *, force: bool = False) -> None:
        """Begin to write the whole medium, bent, beside what goes on here.

        Raises
        ------
        SuppleError
            If there is nothing to export, an export is under way, or nothing can be written by that name.
        """
        if self.source is None:
            raise SuppleError("an array is no file: Deformation.warp makes an array of it")
        if self.export is not None and not self.export.done:
            raise SuppleError("an export is under way: cancel it, or wait for it")
        if not os.fspath(path):
            raise SuppleError("the export needs a name, whose suffix says the format")
        self._spare(path)
        recipe, options = self.document.recipe, self.options
        check_job(self.source, path, recipe, force=force, **options)
        self.message = ""
        self.export = Export(self.source, path, recipe, force=force, device=self.device, **options)

    def end_export(self) -> None:
        """Cancel it; or, when it is done, put it aside."""
        if self.export is not None and not self.export.done:
            self.export.cancel()
        else:
            self.export = None

    def end(self) -> None:
        """End well: what was not wanted is not kept."""
        if self.export is not None:
            self.export.cancel()
            self.export.join(10.0)
        if self.autosave is not None:
            # Whoever closes this without asking keeps it for the next time.
            self.autosave.clear(keep=self.document.dirty)


def _in_a_window(error: SuppleError) -> str:
    """Return the text of an error without the command line's advice."""
    return str(error).replace("pass --force (force=True) to replace it", "choose another name, or Replace")


# What each kind is written as, and what is proposed for formats that are only read.
_WRITTEN: dict[Kind | None, tuple[Collection[str], str]] = {
    "image": (PICTURES_OUT, ".png"),
    "video": ({*CLIPS_OUT, ".gif", ".m4v"}, ".mp4"),
    "volume": (VOLUMES_OUT, ".nii.gz"),
}
_OVER = "There are strokes that were not saved. Undo brings them back, but only as long as the window is open."
_OPEN = "In the place of the strokes that there are; undo brings these back."
_WAYS_OUT = ("Save and close", "Replace and close", "Close without saving", "Cancel")
_KEEP = ("Save", "Replace", "Cancel")
_ASKED = {
    "save": ("Save the recipe", "What supple warp --recipe takes.", _KEEP),
    "open": ("Open a recipe", _OPEN, ("Open", "Cancel")),
    "export": ("Export", "At full quality, to any format of supple warp.", ("Export", "Replace", "Cancel")),
    "copy": ("Save what is seen", "The picture as it is on the canvas.", _KEEP),
    "close": ("Close?", "There are strokes that were not saved.", _WAYS_OUT),
}
