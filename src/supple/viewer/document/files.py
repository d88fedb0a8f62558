"""The file commands of a window, questions before changes are lost, and autosave files for after a crash."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from supple.errors import SuppleError, facing, shown
from supple.files import Job
from supple.files.clips import is_picture_target
from supple.files.freezing import read_freeze, write_freeze
from supple.files.maps import convention_out, write_map
from supple.files.options import ClipOptions, PathLike, VolumeOptions
from supple.files.places import Places
from supple.files.recipes import read_recipe, write_recipe
from supple.files.tracking import track
from supple.media.files import check_output, locked, replacing, same_file
from supple.media.image import check_target
from supple.media.medium import VIDEOS_OUT, opened
from supple.media.pictures import COMPRESSIONS, OUT
from supple.media.suffixes import ANIMATED
from supple.media.volume import SUFFIXES_OUT as VOLUMES_OUT
from supple.media.volume import read, suffix_of
from supple.strokes import Recipe, Stroke, spoken
from supple.viewer.document.background import Task
from supple.viewer.document.editing import Document, Kind
from supple.viewer.document.keyframes import without
from supple.viewer.document.words import WINDOW

EVERY = 1.0  # seconds between two saves, at least
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Found:
    """The autosave file of a window that crashed."""

    recipe: Recipe
    place: Path
    saved: float  # in seconds since 1970
    same: bool  # the source is unchanged, by its size and time


@dataclass(eq=False)
class Autosave:
    """The autosave of a document's recipe, until the window is closed properly.

    Each window has a file, with a lock that the system releases if the window dies: two windows of one source never
    share a file. The default folder is the system's folder for the user's state; the clock returns seconds.
    """

    source: PathLike
    document: Document
    folder: PathLike | None = None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.trouble: str | None = None  # the last error of saving, in a line
        self._folder = _home(self.folder)
        self.place = self._folder / f"{_stem(self.source)}-{os.getpid()}-{secrets.token_hex(4)}.json"
        """The autosave file, which exists only while there are unsaved strokes."""
        self._lock: IO[bytes] | None = None
        self._next = -float("inf")
        self._kept: object = self._now()
        self._ended = False

    @property
    def due(self) -> bool:
        """True if there are changes that are not saved yet."""
        return not self._ended and self._now() != self._kept

    def tick(self) -> None:
        """Save changes if it is time to; may be called at any rate."""
        if self.due and not self.document.dragging and self.clock() >= self._next:
            self.keep()

    def _now(self) -> object:
        return self.document.state.content, self.document.dirty

    def clear(self, *, keep: bool = False) -> None:
        """End autosaving, and delete the file or, with ``keep``, leave it to the next window."""
        self._ended = True
        if not keep:
            self._remove()
        elif self._now() != self._kept:
            self.keep()
        if self._lock is not None:
            self._lock.close()
            with contextlib.suppress(OSError):
                self.place.with_suffix(".lock").unlink()
            self._lock = None

    def keep(self) -> bool:
        """Save the current state; return whether it was written."""
        self._next, self._kept, self.trouble = self.clock() + EVERY, self._now(), None
        try:
            if not self.document.dirty:
                self._remove()
            else:
                self._folder.mkdir(parents=True, exist_ok=True)
                if self._lock is None:
                    self._lock = locked(self.place.with_suffix(".lock"))
                data: dict[str, object] = {"supple_autosave": _VERSION, "source": _described(self.source)}
                data |= {"saved": time.time(), "recipe": json.loads(self.document.recipe.to_json())}
                text = json.dumps(data, indent=1, allow_nan=False)
                with replacing(self.place, force=True) as place:
                    place.write_text(text, encoding="utf-8")
        except (OSError, SuppleError) as error:
            self.trouble = " ".join(str(error).split())
            self._kept = None  # retry later
        return self.trouble is None

    def _remove(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self.place.unlink()


def found(source: PathLike, folder: PathLike | None = None) -> Found | None:
    """Return the latest unsaved edits of a source from an autosave file; None if there are none.

    Files of running windows are skipped. An unreadable file is renamed. The folder is that of `Autosave`.
    """
    best: Found | None = None
    for place in sorted(_home(folder).glob(f"{_stem(source)}-*.json")):
        with contextlib.suppress(OSError):  # it may be deleted, or not readable
            lock = locked(place.with_suffix(".lock"))
            if lock is None:
                continue
            with lock:
                try:
                    data: Any = json.loads(place.read_bytes().decode("utf-8"))
                    if data["supple_autosave"] != _VERSION:
                        continue  # for another release
                    recipe, saved = Recipe.from_json(json.dumps(data["recipe"])), float(data["saved"])
                    one = Found(recipe, place, saved, data["source"] == _described(source))
                except (ValueError, TypeError, KeyError, RecursionError):
                    set_aside(place, "bad")
                    continue
                if best is None or one.saved > best.saved:
                    best = one
    return best


def set_aside(place: Path, why: str) -> Path:
    """Rename an autosave file, so that it is not offered again; return the new name."""
    aside = place.with_suffix(f".{secrets.token_hex(2)}.{why}")
    try:
        os.replace(place, aside)
    except OSError:
        return place
    with contextlib.suppress(OSError):
        place.with_suffix(".lock").unlink()
    return aside


def _home(folder: PathLike | None) -> Path:
    if folder is not None:
        return Path(folder)
    try:
        from platformdirs import user_state_path
    except ImportError:
        raise SuppleError('to keep what was done, platformdirs is needed: pip install "supple[view]"') from None
    return user_state_path("supple", appauthor=False) / "autosave"


def _stem(source: PathLike) -> str:
    """Return a unique name for a source, within the length of file names."""
    return hashlib.sha256(os.fsencode(os.path.realpath(source))).hexdigest()[:20]


def _described(source: PathLike) -> dict[str, object]:
    path = os.path.realpath(source)
    made: dict[str, object] = {"path": os.fsencode(path).decode("utf-8", "backslashreplace")}
    with contextlib.suppress(OSError):
        stat = os.stat(path)
        made |= {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    return made


FAILED = 0.5  # seconds: nobody answers a dialog so fast, so one that ends earlier could not be shown


@dataclass(slots=True)
class Question:
    """A question of the window."""

    name: str  # the command it belongs to
    title: str
    text: str
    choices: tuple[str, ...]  # the first is the default for Enter; "Cancel" does nothing
    path: str | None = None  # a file name that can be edited
    then: Callable[[str], object] | None = None  # what is done with a choice, for questions without a file name
    problem: str = ""
    fresh: bool = True  # not drawn yet
    agreed: str | None = None  # a file name that may be replaced, since a dialog of the system has asked

    @property
    def offered(self) -> tuple[str, ...]:
        """The choices, without those that replace a file where there is none."""
        path = self.path or ""
        there = "%" in path or os.path.exists(path)  # a pattern of frames may name some that are there
        return tuple(choice for choice in self.choices if there or not choice.startswith("Replace"))


@dataclass(eq=False)
class FileCommands:
    """The file commands of a document."""

    document: Document
    source: Path | None  # the source file; None for an array
    write_view: Callable[[str, bool], None]  # writes the view to a file; the flag allows replacing one
    leave: Callable[[], None]  # closes the window
    options: Mapping[str, Any] = field(default_factory=dict)  # of exports, for the same image as on screen

    def __post_init__(self) -> None:
        self.message = ""  # the text of the status line
        self.asked: Question | None = None
        self.choose: Callable[[Question], Any] | None = None  # opens a dialog of `portable_file_dialogs`, where it can
        self.choosing: tuple[Question, Any, float] | None = None  # the open dialog of a question, and since when
        self.windows = True  # whether another window can be opened
        self.beside: list[subprocess.Popen[bytes]] = []  # other windows that were opened here
        self.export: Task | None = None
        self.field: str | None = None  # the convention of the field that is exported; None for the medium itself
        self.following: tuple[Stroke, int, Task] | None = None  # what is tracked: a stroke, and from which frame
        self.recipe_path: Path | None = None  # the last saved or opened recipe
        self.write_marks: Callable[[PathLike, bool], None] | None = None  # writes the landmarks
        self._marks = self.document.state.marks  # as they were written last
        self._told: Task | None = None
        self.autosave = None if self.source is None else Autosave(self.source, self.document)
        left = None if self.source is None else found(self.source)
        if left is not None:
            text = f"Changes to this file were not saved the last time (strokes: {len(left.recipe.strokes)})."
            if not left.same:
                text += "\nThe file has changed since then."
            text += "\nRestore brings them back; Keep for later opens the file without them, and says where they are."
            choices = ("Restore", "Keep for later")
            self.asked = Question("restore", "Restore?", text, choices, then=partial(self._restore, left))

    def tick(self) -> None:
        """Save the autosave if it is time to; and report the end of an export, of a track, or of a dialog."""
        self._chosen()
        self._followed()
        if self.autosave is not None:
            self.autosave.tick()
        export = self.export
        if export is not None and export.done and self._told is not export:
            self._told = export
            said = export.text if export.error or export.cancelled else f"saved to {shown(export.target)}"
            self.message = "; ".join([said, *export.warnings])

    def _chosen(self) -> None:
        if self.choosing is None or self.asked not in (None, self.choosing[0]):
            return
        question, dialog, begun = self.choosing
        if not dialog.ready(0):
            return
        self.choosing, answer = None, dialog.result()
        path = answer if isinstance(answer, str) else next(iter(answer), "")
        if path and self.asked is question:  # the question asks for more than a name
            question.path = question.agreed = path
        elif path:
            self.asked, question.path = question, path
            self.answer("Replace" if "Replace" in question.choices else question.choices[0])  # the dialog has asked
        elif time.monotonic() - begun < FAILED:
            self.asked, self.choose = question, None

    def follow(self, i: int) -> None:
        """Start to track the feature at a stroke's point in this frame, in the background; the keys will follow it."""
        if self.source is None or self.following is not None:
            raise SuppleError("a point is tracked already: cancel that, or wait for it")
        stroke, frame = self.document.strokes[i], self.document.frame
        point = (*stroke.at_frame(frame).at, frame)
        self.message, self.following = "", (stroke, frame, Task(partial(track, self.source, [point])))

    def _followed(self) -> None:
        if self.following is None or not self.following[2].done or self.document.dragging:
            return
        (stroke, frame, task), self.following = self.following, None
        self.message = task.error or task.text
        if task.result is None:
            return
        (found,), strokes = task.result, self.document.strokes
        if stroke not in strokes:
            self.message = "the stroke was edited while its point was tracked: follow it again"
            return
        free = without(stroke, "place", [key.frame for key in stroke.keys], frame)
        made = free.following(found.keys, frame, outside="fade" if found.lost else "hold")
        self.attempt(lambda: self.document.replace(strokes.index(stroke), made))
        ends = f"the stroke follows its point from frame {found.frames[0]} to {found.frames[-1]}"
        self.message = self.message or "; ".join([ends, *task.warnings])

    def attempt(self, work: Callable[[], object]) -> None:
        """Call a function, and show its error in the status line."""
        try:
            self.message = ""
            with facing(WINDOW):
                work()
        except SuppleError as error:
            self.message = str(error)

    def browse(self) -> None:
        """Open a dialog of the system for the name of the present question."""
        if self.choose is not None and self.choosing is None and self.asked is not None:
            self.choosing = self.asked, self.choose(self.asked), time.monotonic()

    def ask(self, name: str) -> None:
        """Start a command: ``"save as"``, or one of `_ASKED`."""
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
        mask = f"{stem}-frozen{'.nii.gz' if self.document.kind == 'volume' else '.png'}"
        paths = {"export": bent, "copy": f"{stem}-view.png", "load mask": mask, "save mask": mask}
        path = (paths | {"save landmarks": f"{stem}-landmarks.csv"}).get(name, recipe)
        question = Question(name, *_ASKED[name], path)
        if self.choose is None or name in ("close", "export"):
            self.asked = question
        elif self.choosing is None:
            self.choosing = question, self.choose(question), time.monotonic()
        else:
            self.message = "a dialog for a file is open"

    def may_close(self) -> bool:
        """Return whether nothing would be lost; otherwise, ask."""
        if self.document.dirty:
            self.ask("close")
            return False
        if self.document.state.marks is not self._marks:
            text, choice = "There are landmarks that were not saved.", "Close without saving"
        elif self.export is not None and not self.export.done:
            text, choice = "An export is under way.", "Stop it and close"
        else:
            return True
        self.asked = Question("stop", "Close?", text, (choice, "Cancel"), then=self._stop)
        return False

    def answer(self, choice: str) -> bool:
        """Continue the command with an answer; return whether the question is closed."""
        asked = self.asked
        if asked is None:
            return True
        try:
            if choice != "Cancel":
                with facing(WINDOW):
                    self._do(asked, choice)
            if self.asked is asked:
                self.asked = None
        except SuppleError as error:
            asked.problem = str(error)
            return False
        return True

    def _do(self, asked: Question, choice: str) -> None:
        path = asked.path or ""
        force = choice == "Replace" or path == asked.agreed
        if asked.then is not None:
            asked.then(choice)
        elif asked.name == "open":
            self.take(path)
        elif asked.name == "load mask":
            self.document.set_freeze(read_freeze(path))
            self.message = f"frozen as in {shown(path)}"
        elif asked.name == "export":
            self.begin_export(path, force=force)
        elif asked.name != "close":
            self.save(path, force=force, what=asked.name)
        else:
            if choice in ("Save and close", "Replace and close"):
                known = self.recipe_path is not None and same_file(path, self.recipe_path)
                self.save(path, force=known or choice == "Replace and close")
            else:
                self.document.mark_saved()  # discarded by the user
            if self.may_close():  # an export may be running
                self.leave()

    def _restore(self, left: Found, choice: str) -> None:
        if choice == "Restore":
            self.document.load(left.recipe)
            if self.autosave is not None and not self.autosave.keep():
                raise SuppleError(f"it is restored, but cannot be kept again: {self.autosave.trouble}: save it")
        place = set_aside(left.place, "kept")
        if choice == "Keep for later":
            self.message = f"the strokes are in {shown(place)}"

    def _stop(self, choice: str) -> None:
        self.end_export()
        self.leave()

    def save(self, path: PathLike, *, force: bool = False, what: str = "save") -> None:
        """Write the recipe, or ``what`` a question asks for; SuppleError if it exists and must not be replaced."""
        if what == "save" and not os.fspath(path):
            raise SuppleError("the recipe needs a name: such as strokes.json")
        self._spare(path)
        if what == "save mask":
            write_freeze(path, self.document.freeze, self.document.shape, self.document.geometry, force=force)
        elif what == "save landmarks":
            assert self.write_marks is not None
            self.write_marks(path, force)
            self._marks = self.document.state.marks
        elif what == "copy":
            check_target(path)
            check_output(path, force=force)  # before rendering, which may take seconds
            self.write_view(os.fspath(path), force)
        else:
            write_recipe(path, self.document.recipe, force=force)
            self.recipe_path = Path(path)
            self.document.mark_saved()
        self.message = f"saved to {shown(path)}"

    def _spare(self, path: PathLike) -> None:
        """Raise SuppleError if a target is the source."""
        if self.source is not None and same_file(path, self.source):
            raise SuppleError(f"{shown(path)} is what is bent here: choose another name")

    def take(self, path: PathLike) -> None:
        """Open a recipe here, or another file in a window of its own; SuppleError if it cannot be read."""
        if os.fspath(path).lower().endswith(".json"):
            self.open(path)
        else:
            self.open_beside(path)

    def open(self, path: PathLike, *, sure: bool = False) -> None:
        """Replace the strokes by those of a recipe, as one step; SuppleError if it cannot be read, or does not fit.

        Unsaved strokes cause a question first, unless ``sure``.
        """
        source = (
            None
            if self.source is None
            else Job(self.source, "", Recipe(), volume=self.options.get("volume", VolumeOptions())).medium
        )
        recipe = read_recipe(path, resolve=Places(source).resolve if source else None)
        if self.document.dirty and not sure:
            self.document.fitted(recipe)
            choices = ("Open it", "Cancel")
            self.asked = Question("over", "Open it?", _OVER, choices, then=lambda _: self.open(path, sure=True))
            return
        self.document.load(recipe)
        self.recipe_path = Path(path)
        self.document.mark_saved()
        size = self.document.size
        scaled = recipe.size not in (None, size) and recipe.strokes and not recipe.is_world
        self.message = f"opened {shown(path)}" + (f", scaled to {spoken(size)}" if scaled else "")

    def open_beside(self, path: PathLike) -> None:
        """Open another medium in a window of its own; SuppleError if it cannot be read, or no window be opened."""
        if not os.path.exists(path):
            raise SuppleError(f"cannot read {shown(path)}: there is no such file")
        medium = opened(path)
        _ = medium.grid if medium.kind != "store" else read(path)  # raises SuppleError; a clip is not opened here
        if not self.windows:
            raise SuppleError(f"{shown(path)} needs a window of its own: supple view opens one, on a screen or --serve")
        words = [sys.executable, "-m", "supple", "view", os.fspath(path)]
        self.beside.append(subprocess.Popen(words, start_new_session=True))
        self.message = f"{shown(path)} opens in a window of its own"

    def begin_export(self, path: PathLike, *, force: bool = False) -> None:
        """Start to write the whole medium, warped, in the background.

        SuppleError if there is nothing to export, an export is running, or the name cannot be written.
        """
        if self.source is None:
            raise SuppleError("an array is no file: Deformation.warp makes an array of it")
        if self.export is not None and not self.export.done:
            raise SuppleError("an export is under way: cancel it, or wait for it")
        if not os.fspath(path):
            raise SuppleError("the export needs a name, whose suffix says the format")
        self._spare(path)
        options = dict(self.options)
        if self.field is None:
            if self.document.kind == "video":
                options["clip"] = replace(options.get("clip", ClipOptions()), hold=self.document.hold)
            lossy, ways = saved(path)
            options["quality"] = options.get("quality") if lossy else None
            options["compression"] = how if (how := options.get("compression")) in ways else None
        job = Job(self.source, path, self.document.recipe, force=force, **options)
        if self.field is None:
            job.check()
        else:
            convention_out(path, self.field, None)
            check_output(path, force=force)
        self.message = ""
        self.export = Task(job.warp if self.field is None else partial(write_map, job, self.field), path)

    def end_export(self) -> None:
        """Cancel a running export, or dismiss a finished one."""
        if self.export is not None and not self.export.done:
            self.export.cancel()
        else:
            self.export = None

    def end(self) -> None:
        """End properly: the autosave of discarded strokes is deleted."""
        if self.choosing is not None:
            self.choosing[1].kill()
        for task in (self.export, self.following and self.following[2]):
            if task is not None:
                task.cancel()
                task.join(10.0)
        if self.autosave is not None:
            # A window closed without a question leaves its autosave for the next time.
            self.autosave.clear(keep=self.document.dirty)


def saved(path: PathLike) -> tuple[bool, Sequence[str]]:
    """Return whether pictures of a name have a quality; and if not, how they may be compressed."""
    form = OUT.get(suffix_of(path).lower())
    lossy = form is not None and form.quality > 0
    return lossy, () if form is None or lossy else COMPRESSIONS.get(form.name, ())


# The suffixes of each kind, and those proposed for formats that are only read.
_WRITTEN: dict[Kind | None, tuple[Collection[str], str]] = {
    "image": (OUT, ".png"),
    "video": ({*VIDEOS_OUT, *ANIMATED, ".gif", ".m4v"}, ".mp4"),
    "volume": (VOLUMES_OUT, ".nii.gz"),
}
_OVER = "There are strokes that were not saved. Undo brings them back, but only as long as the window is open."
_OPEN = "A recipe takes the place of the strokes here; a picture, clip or volume opens in a window of its own."
_LOAD = "A grey picture, in which white is frozen; for a volume a label map, in which all but 0 is."
_WAYS_OUT = ("Save and close", "Replace and close", "Close without saving", "Cancel")
_KEEP = ("Save", "Replace", "Cancel")
_ASKED = {
    "save": ("Save the recipe", "The strokes, which supple warp --recipe applies to files.", _KEEP),
    "open": ("Open", _OPEN, ("Open", "Cancel")),
    "load mask": ("Load the freeze mask", _LOAD, ("Load", "Cancel")),
    "save mask": ("Save the freeze mask", "What is frozen, in white; in a volume, as 1.", _KEEP),
    "save landmarks": ("Save the landmarks", "Those of the bent volume; of the fixed one, as NAME-fixed.csv.", _KEEP),
    "export": ("Export", "At full quality. The suffix of the name says the format.", ("Export", "Replace", "Cancel")),
    "copy": ("Save what is seen", "The picture as it is on the canvas.", _KEEP),
    "close": ("Close?", "There are strokes that were not saved.", _WAYS_OUT),
}
