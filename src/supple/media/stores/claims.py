"""The place of an output, while it is written: taken, held, given back to the same job, and left when finished."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal

from supple.errors import SuppleError, argument, shown
from supple.media.files import ROOTS, PathLike, check_store, is_store, locked, replaced
from supple.media.stores.places import MARKER, Place, mend, put, read, run

NOTES = "supple"
"""The attribute that says what is known of an output."""
ROOT = "zarr.json"
LOCK = "supple.lock"
"""The file by which a process holds a folder that it writes."""
_LEFT_OVER = re.compile(r"\.[0-9a-f]{32}\.partial$")  # of zarr's local store, where a writer was killed
_HOLDS: ContextVar[contextlib.ExitStack | None] = ContextVar("holds", default=None)


@contextlib.contextmanager
def holding() -> Iterator[None]:
    """Keep other processes from the folders of outputs that are taken within, until it ends.

    Where the process ends before, it lets go too. Nothing is held at addresses, on Windows, and on disks without locks.
    """
    with contextlib.ExitStack() as stack:
        token = _HOLDS.set(stack)
        try:
            yield
        finally:
            _HOLDS.reset(token)


def told_of(job: str, state: str) -> bytes:
    """Return what a marker holds."""
    return json.dumps({"program": "supple", "state": state, "job": job}).encode()


def _agrees(store: Any, files: dict[str, bytes]) -> bool:
    """Return whether what a store has of the metadata is what would be written, but for what is noted at the end."""
    for key, data in files.items():
        found = read(store, key)
        with contextlib.suppress(ValueError):
            if found is not None and _plain(json.loads(found)) != _plain(json.loads(data)):
                return False
    return True


def note(store: Any, told: dict[str, Any]) -> None:
    """Add what is known of an output of Zarr format 3, now that it is written, to the attributes of its root."""
    found = json.loads(read(store, ROOT) or b"{}")
    found["attributes"] = {**found.get("attributes", {}), NOTES: told}
    put(store, ROOT, json.dumps(found, indent=2).encode())


def _plain(value: Any) -> str:
    if isinstance(value, dict) and isinstance(value.get("attributes"), dict):
        kept = {key: one for key, one in value["attributes"].items() if key != NOTES}
        value = {**value, "attributes": kept}
    return json.dumps(value, sort_keys=True)  # NaN is not equal to itself, but its text is


def site_of(place: Place, force: bool) -> Place:
    """Return where an output is written until it is finished; SuppleError if its name is taken."""
    if place.folder is None:
        return place
    mend(place.folder)
    target = check_store(place.folder if "://" in place.address else place.address, force=force)
    return Place(target.with_name(f"{target.name}.partial"))


def is_complete(place: Place, job: str) -> bool:
    """Return whether an output is there that the same job has finished, and waits for another one of it."""
    found = place.marker()
    return found is not None and found["job"] == job and found.get("state") == "complete"


def check_free(address: PathLike, job: str, force: bool) -> None:
    """Raise SuppleError, before any work, for an output whose place cannot be taken."""
    place = Place(address)
    with place.writing():
        if not is_complete(place, job):
            _found(place, site_of(place, force), {}, job, force)


def claim(place: Place, files: dict[str, bytes], job: str, force: bool) -> tuple[Place, bool]:
    """Take the place of an output; return where it is written, and whether the same job has begun it already."""
    site = site_of(place, force)
    found = _found(place, site, files, job, force)
    if site.folder is not None:
        _hold(place, site.folder)
        try:  # once more, since another process may have had it until now
            site_of(place, force)
            found = _found(place, site, files, job, force)
        except SuppleError:
            for remove, path in ((os.unlink, site.folder / LOCK), (os.rmdir, site.folder)):
                with contextlib.suppress(OSError):  # it is not empty
                    remove(path)
            raise
    store = site.store(read_only=False)
    if found == "another":
        # the marker comes first, and stays: if clearing is interrupted, it begins again
        put(store, MARKER, told_of(job, "clearing"))
        _clear(site)
    if found != "begun":
        put(store, MARKER, told_of(job, "unfinished"))
    return site, found == "begun"


def _found(
    place: Place, site: Place, files: dict[str, bytes], job: str, force: bool
) -> Literal["nothing", "begun", "another"]:
    """Return what is there: nothing, what the same job has begun, or another output, which may be replaced."""
    marker = site.marker()
    if marker is None:
        return _unmarked(place, site, force)
    if marker["job"] != job or not _agrees(site.store(read_only=True), files):
        if not force:
            name = "it" if site.folder is None else shown(site.folder.name)
            what = f"{name} is the unfinished output of another job"
            raise place.unwritable(what, "choose another name, or --force starts anew")
        return "another"
    if not site.atomic:
        if not force:
            what = "it is unfinished, and objects there may be incomplete"
            raise place.unwritable(what, "choose another name, or --force starts anew")
        return "another"
    return "another" if marker["state"] == "clearing" else "begun"


def _unmarked(place: Place, site: Place, force: bool) -> Literal["nothing", "another"]:
    """Return what is there without a marker."""
    if site.folder is not None:
        # killed before the marker was there, a process left nothing else
        there = os.path.lexists(site.folder)
        if there and not (site.folder.is_dir() and all(map(_is_spare, os.listdir(site.folder)))):
            what = f"{shown(site.folder.name)} beside it is in the way, and no unfinished output of Supple"
            raise place.unwritable(what, "rename it, or choose another name")
        return "nothing"
    store = site.store(read_only=True)
    zarr = any(read(store, name) is not None for name in ROOTS)
    if not zarr and run(store.is_empty("")):  # which may list all that is there
        return "nothing"
    if not force:
        raise SuppleError(f"{shown(place.address)} exists already: choose another name, or {argument('force', True)}")
    if not zarr:
        raise place.unwritable("what is there is no Zarr store", "give another name")
    return "another"


def _is_spare(name: str) -> bool:
    return name == LOCK or _LEFT_OVER.search(name) is not None


def _hold(place: Place, folder: Path) -> None:
    """Make a folder, and hold it if something wants that; SuppleError if another process does."""
    folder.mkdir(exist_ok=True)
    stack = _HOLDS.get()
    while stack is not None and sys.platform != "win32":  # where a folder with an open file cannot be renamed
        with contextlib.suppress(FileNotFoundError):  # another process has just finished: that folder has its name
            if (file := locked(folder / LOCK)) is None:
                what = "it is being written by another process"
                raise place.unwritable(what, "wait until that has ended, or choose another name")
            stack.enter_context(file)
            if os.path.samestat(os.fstat(file.fileno()), os.stat(folder / LOCK)):
                return
        folder.mkdir(exist_ok=True)


def overlap(address: PathLike, other: PathLike) -> Literal["", "same", "inside", "around"]:
    """Return how an output lies to something else, a store or a file; empty if they have nothing in common.

    A folder that is no store, such as that of a series of slices, may hold outputs.
    """
    here, there = Place(address).parts, Place(other).parts
    if here == there:
        return "same"
    if there[: len(here)] == here:
        return "around"
    return "inside" if here[: len(there)] == there and is_store(other) else ""


def check_apart(place: Place, source: PathLike) -> None:
    """Raise SuppleError for an output that would overwrite its input, or a part of it.

    A folder may be its own input: it is replaced when the output is finished.
    """
    found = overlap(place.address, source)
    if found and (found != "same" or place.folder is None):
        what = {"same": "it is the input too", "inside": "it lies in the input", "around": "the input lies in it"}
        raise place.unwritable(what[found], "choose another place")


def check_written(place: Place, site: Place, paths: Iterable[str], job: str) -> None:
    """Raise SuppleError if what was written is there no more: the marker of the job, and all metadata."""
    marker = site.marker()
    there = marker is not None and marker["job"] == job
    if there:
        store = site.store(read_only=True)
        keys = [[f"{path}/{name}".lstrip("/") for name in ROOTS] for path in ("", *paths)]
        there = all(any(read(store, key) is not None for key in each) for each in keys)
    if not there:
        what = "what was written is there no more, since another process has finished or replaced it"
        raise place.unwritable(what, "look at what is there, or choose another name")


def publish(place: Place, folder: Path, job: str, force: bool, keep: bool) -> None:
    """Rename a finished folder; if it cannot be renamed, all is as it was. ``keep`` keeps a marker of that."""
    for root, _, names in os.walk(folder):
        for name in names:
            if _LEFT_OVER.search(name):
                os.unlink(os.path.join(root, name))
    spare = folder / f"{MARKER}.{os.urandom(16).hex()}.partial"
    spare.write_bytes(told_of(job, "complete"))  # zarr's own would make a folder that is there no more
    os.replace(spare, folder / MARKER)
    assert place.folder is not None
    mend(place.folder)
    target = check_store(place.folder, force=force)
    if os.path.lexists(target):
        _discard(target)
        os.rename(target, replaced(target))
        try:
            os.rename(folder, target)
        except OSError:
            mend(target)
            raise
    else:
        os.rename(folder, target)
    for name in (LOCK,) if keep else (LOCK, MARKER):
        with contextlib.suppress(OSError):  # the marker says that the output is complete
            os.unlink(target / name)
    _discard(target)


def _discard(target: Path) -> None:
    """Remove what a folder has replaced, under a name by which it is not put back."""
    spare = target.with_name(f".{os.urandom(6).hex()}-old")
    with contextlib.suppress(OSError):
        os.rename(replaced(target), spare)
    shutil.rmtree(spare, ignore_errors=True)


def _clear(site: Place) -> None:
    """Remove all but the marker, and the file by which it is held."""
    if site.folder is None:
        run(_cleared(site.store(read_only=False)))
        return
    for entry in list(os.scandir(site.folder)):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry)
        elif entry.name not in (MARKER, LOCK):
            os.unlink(entry)


async def _cleared(store: Any) -> None:
    """Remove all but the marker; a client removes many objects of a folder at a time."""
    for name in [name.strip("/") async for name in store.list_dir("")]:
        if name not in ("", MARKER):
            await store.delete_dir(name)
