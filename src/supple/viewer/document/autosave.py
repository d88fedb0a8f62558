"""Autosave files, in which unsaved strokes survive a crash."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from supple.errors import SuppleError
from supple.files import PathLike
from supple.media.files import replacing
from supple.strokes import Recipe
from supple.viewer.document.editing import Document

EVERY = 1.0  # seconds between two saves, at least
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Found:
    """The autosave file of a window that did not end well."""

    recipe: Recipe
    place: Path
    saved: float  # in seconds since 1970
    same: bool  # the source is as it was then, by its size and time
    medium: object = None  # the shape and the spacing that it was read with, if that is known

    def read_alike(self, document: Document) -> bool:
        """Return whether a document is of the same shape and spacing, as far as that is known."""
        return self.medium is None or self.medium == _medium(document)

    def set_aside(self) -> Path:
        """Do not offer it again; the file stays, under another name, which is returned."""
        return _set_aside(self.place, "kept")


@dataclass(eq=False)
class Autosave:
    """Keeps the recipe of a document in a file of its own, until a clean end.

    Each window has a file, and a lock on it that the system takes away if the window dies: two of the same source
    never meet. Writing is done in a thread. Without a folder for them, the files are where the system keeps such
    things for the user; the clock tells the time in seconds.
    """

    source: PathLike
    document: Document
    folder: PathLike | None = None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.trouble: str | None = None  # why it could not be saved the last time, in a line
        self._folder = _home(self.folder)
        self.place = self._folder / f"{_stem(self.source)}-{os.getpid()}-{secrets.token_hex(4)}.json"
        """The file, if there is one: only what is not saved otherwise is in it."""
        self._lock: IO[bytes] | None = None
        self._pool = ThreadPoolExecutor(1, "supple-autosave")
        self._writing: Future[None] | None = None
        self._next = -float("inf")
        self._kept: object = self._now()
        self._ended = False

    def tick(self) -> None:
        """Save what has changed, if it is time to; called as often as one likes."""
        now = self._now()
        if self._ended or self.document.dragging or now == self._kept or self.clock() < self._next:
            return
        if self._writing is not None and not self._writing.done():
            return
        self._next, self._kept = self.clock() + EVERY, now
        # What was saved needs no keeping.
        self._writing = self._pool.submit(self._write, self.document.recipe if self.document.dirty else None)

    def _now(self) -> object:
        return self.document.state.content, self.document.dirty

    def keep(self) -> bool:
        """Save what there is now, and wait until that is written; whether it could be."""
        self.flush()
        self._kept = self._now()
        self._write(self.document.recipe if self.document.dirty else None)
        return self.trouble is None

    def flush(self) -> None:
        """Wait until what was begun is written."""
        if self._writing is not None:
            self._writing.result()

    def clear(self, *, keep: bool = False) -> None:
        """End, and keep nothing; or leave what is kept to the next window."""
        self._ended = True
        self.flush()
        self._pool.shutdown()
        if not keep:
            self._remove()
        elif self._now() != self._kept:
            self.keep()
        if self._lock is not None:
            self._lock.close()
            with contextlib.suppress(OSError):
                self.place.with_suffix(".lock").unlink()
            self._lock = None

    def _write(self, recipe: Recipe | None) -> None:
        try:
            if recipe is None:
                self._remove()
            else:
                self._folder.mkdir(parents=True, exist_ok=True)
                if self._lock is None:
                    self._lock = _locked(self.place.with_suffix(".lock"))
                data: dict[str, object] = {"supple_autosave": _VERSION, "source": _described(self.source)}
                data |= {"saved": time.time(), "medium": _medium(self.document)}
                data["recipe"] = json.loads(recipe.to_json())
                text = json.dumps(data, indent=1, allow_nan=False)
                with replacing(self.place, force=True) as place:
                    place.write_text(text, encoding="utf-8")
            self.trouble = None
        except (OSError, SuppleError) as error:
            self.trouble = " ".join(str(error).split())
            self._kept = None  # to be tried again

    def _remove(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self.place.unlink()


def found(source: PathLike, folder: PathLike | None = None) -> Found | None:
    """Return the latest unsaved edits of a source from an autosave file; None if there are none.

    Files of windows that still live are left alone. One that can't be read is set aside, under another name. The
    folder is that of `Autosave`.
    """
    best: Found | None = None
    for place in sorted(_home(folder).glob(f"{_stem(source)}-*.json")):
        with contextlib.suppress(OSError):  # it may be gone, or not be ours to read
            lock = _locked(place.with_suffix(".lock"))
            if lock is None:
                continue
            with lock:
                try:
                    data: Any = json.loads(place.read_bytes().decode("utf-8"))
                    if data["supple_autosave"] != _VERSION:
                        continue  # of another release, which will find it
                    recipe, saved = Recipe.from_json(json.dumps(data["recipe"])), float(data["saved"])
                    one = Found(recipe, place, saved, data["source"] == _described(source), data.get("medium"))
                except (ValueError, TypeError, KeyError, RecursionError):
                    _set_aside(place, "bad")
                    continue
                if best is None or one.saved > best.saved:
                    best = one
    return best


def _set_aside(place: Path, why: str) -> Path:
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
    """A name that a source has for itself, as short as a file's name must be."""
    return hashlib.sha256(os.fsencode(os.path.realpath(source))).hexdigest()[:20]


def _described(source: PathLike) -> dict[str, object]:
    path = os.path.realpath(source)
    made: dict[str, object] = {"path": os.fsencode(path).decode("utf-8", "backslashreplace")}
    with contextlib.suppress(OSError):
        stat = os.stat(path)
        made |= {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    return made


def _medium(document: Document) -> list[list[float]]:
    """Return the JSON form of the options by which a source is read; a time scale is a spacing."""
    return [[float(n) for n in np.ravel(values)] for values in (document.shape, document.spacing)]


def _locked(path: Path) -> IO[bytes] | None:
    """A file that is locked as long as it is open; None if another one has it."""
    file = open(path, "ab")  # noqa: SIM115, closing it is what unlocks it
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.close()
        return None
    except OSError:
        pass  # a disk without locks: better found than lost
    return file
