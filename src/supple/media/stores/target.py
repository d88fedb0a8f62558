"""Zarr outputs that many processes write block by block, and that can be resumed after an interruption.

A folder ``NAME`` is written as ``NAME.partial``, and renamed when it is finished. At a URL, objects are written in
place. Until then, a file ``supple.json`` in it identifies the job.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument, shown
from supple.media.files import ROOTS, PathLike, check_store, locked, publish_all
from supple.media.stores.image import LABELS, StoredImage
from supple.media.stores.levels import Mode, group_files, planned, reduced
from supple.media.stores.places import MARKER, Place, overlap, put, quiet, read, refresh, run

Box = Sequence[tuple[int, int]]
"""A box of samples: the first index and the one after the last, along each axis."""
Item = TypeVar("Item")

LOCK = "supple.lock"
"""The file by which a process locks an output folder."""
_AT_ONCE = 16  # concurrent requests
_LEFT_OVER = f"*.{'[0-9a-f]' * 32}.partial"  # files of zarr's local store, where a writer was killed
_HOLDS: ContextVar[contextlib.ExitStack | None] = ContextVar("holds", default=None)


@contextlib.contextmanager
def holding() -> Iterator[None]:
    """Keep the folders of outputs that are created in this block locked for other processes until it ends.

    URLs, Windows and file systems without locks are not supported: nothing is locked there.
    """
    with contextlib.ExitStack() as stack:
        token = _HOLDS.set(stack)
        try:
            yield
        finally:
            _HOLDS.reset(token)


def create(
    address: PathLike,
    like: StoredImage,
    *,
    shape: Sequence[int] | None = None,
    scale: Sequence[float] | None = None,
    translation: Sequence[float] | None = None,
    force: bool = False,
    job: str,
) -> Target:
    """Create an output like a stored image, or resume one that was interrupted.

    It has the same Zarr format, axes, units, chunks, shards, codecs, fill value, attributes and levels as ``like``. For
    the finest level, ``shape`` (along the axes of space), ``scale`` and ``translation`` (along all axes) may differ;
    coarser levels have the same factors, as long as they become smaller, and the same convention of translations (of
    the means, or that of the finest level). ``job`` identifies the work: an unfinished output of the same job is always
    resumed. ``force`` replaces an existing Zarr store, and an unfinished output of another job; an old folder stays
    until the new one is finished.
    """
    place = Place(address)
    relation = overlap(address, like.address)
    if relation and (relation != "same" or place.folder is None):  # folders are replaced at the end
        what = {"same": "it is the input too", "inside": "it lies in the input", "around": "the input lies in it"}
        raise place.unwritable(what[relation], "choose another place")
    files, paths, steps = planned(like, shape, scale, translation)
    return create_arrays(address, files, paths, steps, len(like.axes) - len(like.spatial), force=force, job=job)


def create_arrays(
    address: PathLike, files: dict[str, bytes], paths: Sequence[str], steps: Sequence[tuple[int, ...]] = (),
    carried: int = 1, *, force: bool = False, job: str,
) -> Target:  # fmt: skip
    """Create an output from prepared metadata, or resume one that was interrupted, as `create` does.

    ``files`` are all metadata, by their keys; ``paths`` are those of the arrays, which become the levels; ``steps`` are
    the factors along each axis by which a level is smaller than the one before, without the first level; ``carried`` is
    the number of axes before those of space.
    """
    import zarr

    place, job = Place(address), _named(job, files)
    with place.writing():
        site, begun = _claim(place, job, force)
        store = site.store(read_only=False)
        for key, data in files.items():
            if read(store, key) is None:
                put(store, key, data)
    with place.reading("what was written cannot be read"), quiet():
        root: Any = zarr.open(store, mode="r+")
        config: Any = {"order": "C", "write_empty_chunks": True}
        nodes = [root[path] if path else root for path in paths]
        arrays = tuple(zarr.Array(zarr.AsyncArray(one.metadata, one.store_path, config)) for one in nodes)
    return Target(place, site, arrays, steps, carried, job, force, begun)


def check_free(address: PathLike, files: dict[str, bytes], job: str, force: bool) -> None:
    """Raise SuppleError, before any work, if an output with these metadata cannot be created at an address."""
    place = Place(address)
    with place.writing():
        _look(place, _named(job, files), force)


def _named(job: str, files: dict[str, bytes]) -> str:
    digest = hashlib.sha256(repr(sorted(files.items())).encode()).hexdigest()
    return f"{job}, {digest}"


def _mark(store: Any, job: str, state: str = "unfinished") -> None:
    put(store, MARKER, json.dumps({"program": "supple", "state": state, "job": job}).encode())


def _claim(place: Place, job: str, force: bool) -> tuple[Place, bool]:
    """Claim the location of an output; return where it is written, and whether it resumes the same job."""
    site, begun = _look(place, job, force)
    folder = site.folder
    if folder is not None:
        _hold(place, folder)
        try:  # checked again, as another process may have held the folder until now
            site, begun = _look(place, job, force)
        except SuppleError:
            with contextlib.suppress(OSError):  # the folder is not empty
                os.unlink(folder / LOCK)
                os.rmdir(folder)
            raise
    if not begun:
        store = site.store(read_only=False)
        _mark(store, "")  # no job, so that an interrupted clearing is never resumed
        _clear(site, store)
        _mark(store, job)
    return site, begun


def _look(place: Place, job: str, force: bool) -> tuple[Place, bool]:
    """Return where an output is written, and whether the same job has begun it, so that it can be resumed.

    SuppleError if something else is there that may not be replaced.
    """
    site = place
    if place.folder is not None:
        target = check_store(place.folder if "://" in place.address else place.address, force=force)
        site = Place(target.with_name(f"{target.name}.partial"))
    if marker := site.marker():
        if marker["job"] == job:
            return site, site.atomic  # starts anew where objects may be incomplete
        if not force:
            name = "it" if site.folder is None else shown(site.folder.name)
            what = f"{name} is the unfinished output of another job"
            raise place.unwritable(what, f"choose another name, or {argument('force', True)}, which starts anew")
    elif site.folder is not None:
        # a process that was killed before it wrote the marker has left nothing but "supple." files
        there = os.path.lexists(site.folder)
        if there and not (site.folder.is_dir() and all(name.startswith("supple.") for name in os.listdir(site.folder))):
            what = f"{shown(site.folder.name)} beside it is in the way, and no unfinished output of Supple"
            raise place.unwritable(what, "rename it, or choose another name")
    else:
        store = site.store(read_only=True)
        zarr = any(read(store, name) is not None for name in ROOTS)
        if zarr or not run(store.is_empty("")):  # is_empty may list all keys
            if not force:
                text = f"{shown(place.address)} exists already: choose another name, or {argument('force', True)}"
                raise SuppleError(text)
            if not zarr:
                raise place.unwritable("what is there is no Zarr store", "give another name")
    return site, False


def _hold(place: Place, folder: Path) -> None:
    """Make a folder, and lock it within `holding`; SuppleError if another process has locked it."""
    folder.mkdir(exist_ok=True)
    stack = _HOLDS.get()
    while stack is not None and sys.platform != "win32":  # Windows cannot rename a folder with an open file
        with contextlib.suppress(FileNotFoundError):  # another process has just finished and renamed the folder
            if (file := locked(folder / LOCK)) is None:
                what = "it is being written by another process"
                raise place.unwritable(what, "wait until that has ended, or choose another name")
            stack.enter_context(file)
            if os.path.samestat(os.fstat(file.fileno()), os.stat(folder / LOCK)):
                return
        folder.mkdir(exist_ok=True)


def _clear(site: Place, store: Any) -> None:
    async def clear() -> None:  # clients remove the objects of a folder in batches
        for name in [name.strip("/") async for name in store.list_dir("")]:
            if name not in ("", MARKER):
                await store.delete_dir(name)

    if site.folder is None:
        run(clear())
        return
    for entry in list(os.scandir(site.folder)):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry)
        elif entry.name not in (MARKER, LOCK):
            os.unlink(entry)


class Target:
    """An output that is being written; each process writes different blocks.

    Attributes
    ----------
    address : str
        The address as given.
    site : Place
        The location where it is written until it is finished.
    arrays : tuple of zarr.Array
        The levels, the finest first. Each written chunk is stored, even if all its samples are the fill value.
    blocks, factors : tuple of tuple of int
        For each level, the shape of the blocks that processes may write independently, shards or else chunks; and the
        factor along each axis by which it is smaller than the level before.
    begun : bool
        Whether blocks may exist already; if not, `is_done` need not be called.
    """

    def __init__(
        self, place: Place, site: Place, arrays: tuple[Any, ...], steps: Sequence[tuple[int, ...]], carried: int,
        job: str, force: bool, begun: bool,
    ) -> None:  # fmt: skip
        self.address, self.site, self.arrays, self.begun = place.address, site, arrays, begun
        self.blocks = tuple(tuple(array.metadata.chunk_grid.chunk_shape) for array in arrays)
        self.factors = ((1,) * arrays[0].ndim, *steps)
        self._place, self._carried, self._job, self._force = place, carried, job, force

    def is_done(self, level: int, box: Box) -> bool:
        """Return whether all blocks of an aligned box are stored; none is decoded."""
        array = self.arrays[level]
        keys = self._keys(level, box, array)
        folder = self.site.folder
        if folder is not None:
            # some file systems leave empty files after a power failure
            try:
                return all(os.stat(folder / key).st_size > 0 for key in keys)
            except OSError:
                return False
        with self._place.reading("its chunks cannot be found"):
            refresh(array.store)
            return all(run(_each(array.store.exists, keys)))

    def write(self, level: int, box: Box, values: npt.ArrayLike) -> None:
        """Write the samples of an aligned box; SuppleError if they cannot be stored."""
        with self._place.writing():
            self.arrays[level][tuple(slice(a, b) for a, b in box)] = values

    def copy(self, level: int, box: Box, source: Any, address: PathLike) -> int:
        """Copy the compressed blocks of an aligned box from a level of the input image; return their bytes.

        ``source`` is the array of that level, at ``address``. Blocks that it does not store are skipped, as they hold
        the fill value.
        """
        from zarr.core.buffer import default_buffer_prototype

        array = self.arrays[level]
        # all blocks are read first, to tell errors of reading from those of writing; a box is small, one task's
        with Place(address).reading("its chunks cannot be read"):
            get = functools.partial(source.store.get, prototype=default_buffer_prototype())
            found = run(_each(get, self._keys(level, box, source)))
        named = zip(self._keys(level, box, array), found, strict=True)
        pairs = [(name, data) for name, data in named if data is not None]
        with self._place.writing():
            run(_each(lambda pair: array.store.set(*pair), pairs))
        return sum(len(data) for _, data in pairs)

    def reduce(self, level: int, box: Box, mode: Mode = "mean") -> None:
        """Compute an aligned box of a level, from 1 on, from the level before, as `reduced` does, and write it."""
        source, factors = self.arrays[level - 1], self.factors[level]
        ends = zip(box, factors, source.shape, strict=True)
        region = [(a * factor, min(b * factor, size)) for (a, b), factor, size in ends]
        values = np.empty([b - a for a, b in box], source.dtype)
        # slab by slab, since many shards are read for one
        k = self._carried
        step, (first, end) = self.arrays[level].chunks[k], region[k]
        for at in range(0, values.shape[k], step):
            region[k] = first + at * factors[k], min(first + (at + step) * factors[k], end)
            with self._place.reading(f"its level {level - 1} cannot be read"):
                slab = np.asarray(source[tuple(slice(*span) for span in region)])
            values[(slice(None),) * k + (slice(at, at + step),)] = reduced(slab, factors, mode)
        self.write(level, box, values)

    def put_labels(self, names: Sequence[str], version: str) -> None:
        """Write the metadata of an OME-Zarr image's group of label images."""
        listed = {LABELS: list(names)}
        attributes = listed if version == "0.4" else {"ome": {"version": version, **listed}}
        with self._place.writing():
            for key, data in group_files(LABELS, self.arrays[0].metadata.zarr_format, attributes).items():
                put(self.site.store(read_only=False), key, data)

    def note(self, facts: dict[str, Any]) -> None:
        """Add facts to the attributes of the root, as ``supple``; the output must be in Zarr format 3."""
        with self._place.writing():
            store = self.site.store(read_only=False)
            root = json.loads(read(store, "zarr.json") or b"{}")
            root["attributes"] = {**root.get("attributes", {}), "supple": facts}
            put(store, "zarr.json", json.dumps(root, indent=2).encode())

    def finish(self, *others: Target) -> None:
        """Finish the output, and others with it: folders get their final names. Call it once, when all is written.

        SuppleError if another process has finished or replaced one of them. If a folder cannot be renamed, none is.
        """
        moves: list[tuple[Path, Path, PathLike, Path]] = []
        for each in (self, *others):
            with each._place.writing():
                if each.site.marker().get("job") != each._job:
                    what = "what was written is there no more, since another process has finished or replaced it"
                    raise each._place.unwritable(what, "look at what is there, or choose another name")
                if (folder := each.site.folder) is not None:
                    for spare in folder.rglob(_LEFT_OVER) if each.begun else ():
                        spare.unlink()
                    _mark(each.site.store(read_only=False), each._job, "complete")  # in case removing the marker fails
                    target = check_store(folder.with_name(folder.name.removesuffix(".partial")), force=each._force)
                    moves.append((folder, target, each.address, target.with_name(f".{os.urandom(6).hex()}-old")))
        with self._place.writing():
            publish_all(moves, self._force)
        for _, target, _, aside in moves:
            for name in (LOCK, MARKER):
                with contextlib.suppress(OSError):
                    os.unlink(target / name)
            shutil.rmtree(aside, ignore_errors=True)
        for each in (self, *others):
            if each.site.folder is None:
                with each._place.writing():
                    run(each.site.store(read_only=False).delete(MARKER))

    def _keys(self, level: int, box: Box, array: Any) -> Iterator[str]:
        prefix = f"{array.path}/" if array.path else ""
        ranges = [range(a // n, -(-b // n)) for (a, b), n in zip(box, self.blocks[level], strict=True)]
        return (prefix + array.metadata.encode_chunk_key(place) for place in product(*ranges))


async def _each(act: Callable[[Item], Awaitable[Any]], items: Iterable[Item]) -> list[Any]:
    """Return the results of requests for several items, of which at most `_AT_ONCE` run at a time."""
    places = asyncio.Semaphore(_AT_ONCE)

    async def one(item: Item) -> Any:
        async with places:
            return await act(item)

    return list(await asyncio.gather(*map(one, items)))
