"""Autosave files, which keep unsaved strokes after a crash."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from supple.errors import SuppleError
from supple.files.options import PathLike
from supple.media.files import locked, replacing
from supple.strokes import Recipe
from supple.viewer.document.editing import Document

EVERY = 1.0  # seconds between two saves, at least
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Found:
    """The autosave file of a window that crashed."""

    recipe: Recipe
    place: Path
    saved: float  # in seconds since 1970
    same: bool  # the source is unchanged, by its size and time
    medium: object = None  # the shape and the spacing of the source, if known

    def read_alike(self, document: Document) -> bool:
        """Return whether a document has the same shape and spacing, as far as they are known."""
        return self.medium is None or self.medium == _medium(document)

    def set_aside(self) -> Path:
        """Rename the file, so that it is not offered again; return the new name."""
        return _set_aside(self.place, "kept")


@dataclass(eq=False)
class Autosave:
    """The autosave of a document's recipe, until the window is closed properly.

    Each window has a file, with a lock that the system releases if the window dies: two windows of one source never
    share a file. Writing is done in a thread. The default folder is the system's folder for the user's state; the clock
    returns seconds.
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
        self._pool = ThreadPoolExecutor(1, "supple-autosave")
        self._writing: Future[None] | None = None
        self._next = -float("inf")
        self._kept: object = self._now()
        self._ended = False

    @property
    def due(self) -> bool:
        """Whether there are changes that are not saved yet."""
        writing = self._writing is not None and not self._writing.done()
        return not self._ended and (writing or self._now() != self._kept)

    def tick(self) -> None:
        """Save changes if it is time to; may be called at any rate."""
        now = self._now()
        if self._ended or self.document.dragging or now == self._kept or self.clock() < self._next:
            return
        if self._writing is not None and not self._writing.done():
            return
        self._next, self._kept = self.clock() + EVERY, now
        # A saved document needs no autosave.
        self._writing = self._pool.submit(self._write, self.document.recipe if self.document.dirty else None)

    def _now(self) -> object:
        return self.document.state.content, self.document.dirty

    def keep(self) -> bool:
        """Save the current state, and wait for it; return whether it was written."""
        self.flush()
        self._kept = self._now()
        self._write(self.document.recipe if self.document.dirty else None)
        return self.trouble is None

    def flush(self) -> None:
        """Wait for the current write."""
        if self._writing is not None:
            self._writing.result()

    def clear(self, *, keep: bool = False) -> None:
        """End, and delete the file; or leave it to the next window."""
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
                    self._lock = locked(self.place.with_suffix(".lock"))
                data: dict[str, object] = {"supple_autosave": _VERSION, "source": _described(self.source)}
                data |= {"saved": time.time(), "medium": _medium(self.document)}
                data["recipe"] = json.loads(recipe.to_json())
                text = json.dumps(data, indent=1, allow_nan=False)
                with replacing(self.place, force=True) as place:
                    place.write_text(text, encoding="utf-8")
            self.trouble = None
        except (OSError, SuppleError) as error:
            self.trouble = " ".join(str(error).split())
            self._kept = None  # retry later

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
    """Return a unique name for a source, within the length of file names."""
    return hashlib.sha256(os.fsencode(os.path.realpath(source))).hexdigest()[:20]


def _described(source: PathLike) -> dict[str, object]:
    path = os.path.realpath(source)
    made: dict[str, object] = {"path": os.fsencode(path).decode("utf-8", "backslashreplace")}
    with contextlib.suppress(OSError):
        stat = os.stat(path)
        made |= {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    return made


def _medium(document: Document) -> list[list[float]]:
    """Return the JSON form of the spacing that a source is read with; a time scale is a spacing."""
    return [[float(n) for n in np.ravel(values)] for values in (document.shape, document.spacing)]
