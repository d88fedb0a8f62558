"""The place of an output, while it is written: taken, given back to the same job, and left when it is finished."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any, Literal

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, check_store
from supple.media.stores.places import MARKER, ROOTS, Place, is_store, put, read, run

NOTES = "supple"
"""The attribute that says what is known of an output."""
ROOT = "zarr.json"
_LEFT_OVER = re.compile(r"\.[0-9a-f]{32}\.partial$")  # of zarr's local store, where a writer was killed


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


def unfinished(folder: Path) -> Path:
    """Return the folder that an output is written to, until it is finished."""
    return folder.with_name(f"{folder.name}.partial")


def is_begun(address: PathLike) -> bool:
    """Return whether some blocks of an output may be there."""
    place = Place(address)
    if place.folder is None:
        return place.job() is not None
    return os.path.lexists(unfinished(Path(os.path.realpath(place.folder))))


def is_complete(place: Place, job: str) -> bool:
    """Return whether an output is there that the same job has finished, and waits for another one of it."""
    found = place.marker()
    return found is not None and found["job"] == job and found.get("state") == "complete"


def check_free(address: PathLike, job: str, force: bool) -> None:
    """Raise SuppleError, before any work, for an output in a folder that cannot be written."""
    place = Place(address)
    if place.folder is not None and not is_complete(place, job):
        check_store(place.folder if "://" in place.address else address, force=force)


def claim_folder(place: Place, site: Place, files: dict[str, bytes], job: str, force: bool) -> None:
    """Prepare the folder that is written; one of the same job is left as it is."""
    folder = site.folder
    assert folder is not None
    store = site.store(read_only=False)
    if os.path.lexists(folder):
        found = site.marker()
        # killed before the marker was there, it left nothing else
        empty = folder.is_dir() and all(_LEFT_OVER.search(name) for name in os.listdir(folder))
        if found is None and not empty:
            what = f"{shown(folder.name)} beside it is in the way, and no unfinished output of Supple"
            raise place.unwritable(what, "rename it, or choose another name")
        if found is not None and (found["job"] != job or not _agrees(store, files)):
            if not force:
                raise place.unwritable(*_of_another(shown(folder.name)))
            shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    if site.marker() is None:
        put(store, MARKER, told_of(job, "unfinished"))


def _of_another(name: str) -> tuple[str, str]:
    return f"{name} is the unfinished output of another job", "choose another name, or --force starts anew"


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


def claim_address(place: Place, files: dict[str, bytes], job: str, force: bool) -> None:
    """Prepare the address that is written in place; one of the same job is left as it is."""
    store = place.store(read_only=False)
    found = place.marker()
    zarr = found is None and any(read(store, name) is not None for name in ROOTS)
    if zarr or (found is None and not run(store.is_empty(""))):  # which may list all that is there
        if not force:
            raise SuppleError(f"{shown(place.address)} exists already: pass --force (force=True) to replace it")
        if not zarr:
            raise place.unwritable("what is there is no Zarr store", "give another name")
    elif found is None:
        put(store, MARKER, told_of(job, "unfinished"))
        return
    elif found["job"] != job or not _agrees(store, files):
        if not force:
            raise place.unwritable(*_of_another("it"))
    elif not place.atomic:
        if not force:
            what = "it is unfinished, and objects there may be incomplete"
            raise place.unwritable(what, "choose another name, or --force starts anew")
    elif found["state"] == "unfinished":
        return
    # the marker comes first, and stays: if clearing is interrupted, it begins again
    put(store, MARKER, told_of(job, "clearing"))
    run(_cleared(store))
    put(store, MARKER, told_of(job, "unfinished"))


def publish(place: Place, folder: Path, job: str, force: bool, keep: bool) -> None:
    """Rename a finished folder; if it cannot be renamed, all is as it was. ``keep`` keeps a marker of that."""
    for root, _, names in os.walk(folder):
        for name in names:
            if _LEFT_OVER.search(name):
                os.unlink(os.path.join(root, name))
    put(Place(folder).store(read_only=False), MARKER, told_of(job, "complete"))
    assert place.folder is not None
    target = check_store(place.folder, force=force)
    old = target.with_name(f".{os.urandom(6).hex()}-old")
    if os.path.lexists(target):
        os.rename(target, old)
        try:
            os.rename(folder, target)
        except OSError:
            os.rename(old, target)
            raise
    else:
        os.rename(folder, target)
    if not keep:
        with contextlib.suppress(OSError):  # it says that the output is complete
            os.unlink(target / MARKER)
    shutil.rmtree(old, ignore_errors=True)


async def _cleared(store: Any) -> None:
    """Remove all but the marker; a client removes many objects of a folder at a time."""
    for name in [name.strip("/") async for name in store.list_dir("")]:
        if name not in ("", MARKER):
            await store.delete_dir(name)
