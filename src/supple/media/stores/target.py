"""Outputs in Zarr stores that many processes write block by block, and that go on where they were interrupted."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import os
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.media.files import PathLike
from supple.media.stores.claims import check_apart, check_written, claim, is_complete, note, publish, told_of
from supple.media.stores.image import LABELS, Level, StoredAxis, StoredImage, described
from supple.media.stores.places import MARKER, Place, put, quiet, read, refresh, run
from supple.media.stores.plans import group_files, planned
from supple.media.stores.pyramid import Mode, Step, reduced

Box = Sequence[tuple[int, int]]
"""The first sample and the one after the last, along each axis."""

Item = TypeVar("Item")

_AT_ONCE = 16  # requests


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
    """Create an output like a stored image, or go on with one that was interrupted.

    It has the same Zarr format, axes, units, chunks, shards, codecs, fill value, attributes and levels. A folder
    ``NAME`` is written as ``NAME.partial`` and appears when it is finished. Elsewhere, objects are written in place,
    with a file ``supple.json`` while it is unfinished.

    Parameters
    ----------
    address : str or os.PathLike
        The folder or address of the output.
    like : StoredImage
        The image that it is made from.
    shape : sequence of int, optional
        The shape of the finest level along the axes of space; by default, that of ``like``. Coarser levels have the
        same factors, as long as they become smaller.
    scale, translation : sequence of float, optional
        Of the finest level, for all axes or the last ones, in array order and in the units of the axes. By default,
        those of ``like``. Coarser levels follow by the convention of ``like``: their translations are those of the
        means, or the same as that of the finest.
    force : bool
        Whether to replace an existing Zarr store, and an unfinished output of another job. Where an output is a folder,
        the old one stays until the new one is finished.
    job : str
        What identifies the work: an unfinished output of the same job is continued, with `force` too.

    Returns
    -------
    Target

    Raises
    ------
    SuppleError
        If there is something else already, an argument does not fit, or nothing can be written there.
    """
    place = Place(address)
    check_apart(place, like.address)
    plan = planned(place, like, shape, scale, translation)
    site, begun = _claimed(place, plan.files, job, force)
    with place.reading("what was written cannot be read"), quiet():
        import zarr

        made = described(site, zarr.open(site.store(read_only=False), mode="r+"), len(like.spatial))
    return Target(place, site, made, plan.steps, job, force, begun=begun)


def create_arrays(
    address: PathLike, files: dict[str, bytes], paths: Sequence[str], *, force: bool = False, job: str
) -> Target:
    """Create an output of prepared metadata, or go on with one that was interrupted, as `create` does.

    Parameters
    ----------
    address, force, job
        As in `create`. If the same job has finished it already (`Target.finish` with ``keep``), it is taken as it is.
    files : dict of bytes
        All metadata, by their keys in the store.
    paths : sequence of str
        The arrays in it, which become the levels of the target: the first axis holds components, the others are those
        of space. None is made from another.
    """
    place = Place(address)
    complete = is_complete(place, job)
    site, begun = (place, True) if complete else _claimed(place, files, job, force)
    with place.reading("what was written cannot be read"), quiet():
        import zarr

        root = zarr.open_group(site.store(read_only=False), mode="r+")
        arrays: list[Any] = [root[path] for path in paths]
    n = arrays[0].ndim
    levels = tuple(Level(path, a, (1.0,) * n, (0.0,) * n) for path, a in zip(paths, arrays, strict=True))
    names = arrays[0].metadata.dimension_names or ("",) * n
    axes = tuple(StoredAxis(name or "", "space" if k else "", None) for k, name in enumerate(names))
    image = StoredImage(place.address, "", axes, levels, tuple(range(1, n)), "", dict(root.attrs))
    return Target(place, site, image, (), job, force, begun=begun, complete=complete)


def _claimed(place: Place, files: dict[str, bytes], job: str, force: bool) -> tuple[Place, bool]:
    """Take the place of an output, write its metadata; return where it is written, and whether it was begun."""
    with place.writing():
        site, begun = claim(place, files, job, force)
        store = site.store(read_only=False)
        for key, data in files.items():
            if read(store, key) is None:
                put(store, key, data)
    return site, begun


class Target:
    """An output that is being written.

    It can be sent to other processes, unless it lies in memory; each writes blocks of its own.

    Attributes
    ----------
    address : str
        As it was given.
    image : StoredImage
        What is written: its axes, its grid, and its levels, whose arrays are those of `arrays`.
    arrays : tuple of zarr.Array
        The levels, the finest first. Each chunk that is written is stored, also if it holds nothing but the fill value.
    blocks : tuple of tuple of int
        For each level, the shape of the smallest region that processes may write independently: of a shard, or of a
        chunk without shards.
    begun : bool
        Whether some of it may have been there: else no block has to be looked for.
    complete : bool
        Whether the same job has finished it already.
    """

    def __init__(
        self,
        place: Place,
        site: Place,
        image: StoredImage,
        steps: tuple[tuple[Step, ...], ...],
        job: str,
        force: bool,
        *,
        begun: bool,
        complete: bool = False,
    ) -> None:
        self.address = place.address
        self.begun, self.complete = begun, complete
        self._place, self._site, self._steps, self._job, self._force = place, site, steps, job, force
        levels = tuple(Level(a.path, _writable(a.array), a.scale, a.translation) for a in image.levels)
        self.image = StoredImage(
            place.address, image.version, image.axes, levels, image.spatial, image.name, image.attributes
        )
        self.arrays = tuple(level.array for level in levels)
        self.blocks = tuple(tuple(array.metadata.chunk_grid.chunk_shape) for array in self.arrays)

    @property
    def block(self) -> tuple[int, ...]:
        """The block of the finest level."""
        return self.blocks[0]

    @property
    def factors(self) -> tuple[tuple[int, ...], ...]:
        """For each level, by how much each axis is smaller than that of the level before; 1 for the finest."""
        ones = (1,) * len(self.image.axes)
        return (ones, *(tuple(axis.factor for axis in step) for step in self._steps))

    @property
    def site(self) -> Place:
        """Where it is written until it is finished."""
        return self._site

    def is_done(self, level: int, box: Box) -> bool:
        """Return whether all blocks of an aligned box are stored; none is decoded."""
        array = self.arrays[level]
        keys = self._keys(level, box, array)
        folder = self._site.folder
        if folder is not None:
            # a file without content is what some file systems leave after a power failure
            return all(_size(folder / key) > 0 for key in keys)
        with self._place.reading("its chunks cannot be found"):
            refresh(array.store)
            return all(run(_each(array.store.exists, keys)))

    def write(self, level: int, box: Box, values: npt.ArrayLike) -> None:
        """Write the samples of an aligned box; SuppleError if they cannot be stored."""
        self._check(level, box)
        with self.writing():
            self.arrays[level][tuple(slice(a, b) for a, b in box)] = values

    def copy(self, level: int, box: Box, source: Level, address: PathLike) -> int | None:
        """Copy an aligned box of a level as it is compressed.

        Parameters
        ----------
        level : int
            The level that is written.
        box : sequence of (int, int)
            Along each axis. It is the same in both.
        source : Level
            Where it is read.
        address : str or os.PathLike
            That of the store in which it lies.

        Returns
        -------
        int or None
            The number of bytes; blocks that the source does not store are left out, as they hold its fill value. None
            if chunks, codecs, types, fill values or formats differ: then the samples must be written.

        Raises
        ------
        SuppleError
            If the source cannot be read, or the output not be written.
        """
        from zarr.core.buffer import default_buffer_prototype

        array = self.arrays[level]
        names = list(self._keys(level, box, array))
        shape = tuple(source.array.shape)
        if len(shape) != array.ndim or _encoding(array) != _encoding(source.array):
            return None
        if any(stop > size for (_, stop), size in zip(box, shape, strict=True)):
            return None
        # all is read before any is written, so that each error is told of its own side: a box is no more than a task's
        with Place(address).reading("its chunks cannot be read"):
            get = functools.partial(source.array.store.get, prototype=default_buffer_prototype())
            found = run(_each(get, self._keys(level, box, source.array)))
        pairs = [(name, data) for name, data in zip(names, found, strict=True) if data is not None]
        with self.writing():
            run(_each(lambda pair: array.store.set(*pair), pairs))
        return sum(len(data) for _, data in pairs)

    def reduce(self, level: int, box: Box, mode: Mode = "mean") -> None:
        """Compute an aligned box of a level from the level before, and write it.

        Parameters
        ----------
        level : int
            From 1 on.
        box : sequence of (int, int)
            Along each axis.
        mode : {"mean", "nearest"}
            Means, rounded half to even for integers, of as many samples as there are at the edges; or the first sample,
            for labels.
        """
        if not 1 <= level < len(self.arrays):
            raise SuppleError(f"level must be from 1 to {len(self.arrays) - 1}, not {level}")
        self._check(level, box)
        source, factors = self.arrays[level - 1], self.factors[level]
        ends = zip(box, factors, source.shape, strict=True)
        region = [(a * factor, min(b * factor, size)) for (a, b), factor, size in ends]
        made = np.empty([b - a for a, b in box], source.dtype)
        # slab by slab, since many shards are read for one; and plane by plane, since sums are wider than samples
        k = len(box) - len(self.image.spatial)
        step, factor = self.arrays[level].chunks[k], factors[k]
        first, end = region[k]
        for at in range(0, made.shape[k], step):
            start, stop = first + at * factor, min(first + (at + step) * factor, end)
            with self._place.reading(f"its level {level - 1} cannot be read"):
                slab = np.asarray(
                    source[tuple(slice(*span) for span in (*region[:k], (start, stop), *region[k + 1 :]))]
                )
            for plane in range(-(-(stop - start) // factor)):
                some = (slice(None),) * k + (slice(plane * factor, (plane + 1) * factor),)
                made[(slice(None),) * k + (slice(at + plane, at + plane + 1),)] = reduced(slab[some], factors, mode)
        self.write(level, box, made)

    def writing(self) -> contextlib.AbstractContextManager[None]:
        """Return a context in which errors of the file system become one sentence that names the output."""
        return self._place.writing()

    def put_labels(self, names: Sequence[str], version: str) -> None:
        """Write the group of label images of an OME-Zarr image: its metadata alone."""
        listed = {LABELS: list(names)}
        attributes = listed if version == "0.4" else {"ome": {"version": version, **listed}}
        with self.writing():
            for key, data in group_files(LABELS, self.arrays[0].metadata.zarr_format, attributes).items():
                put(self._site.store(read_only=False), key, data)

    def note(self, told: dict[str, Any]) -> None:
        """Add what is known of the output to the attributes of its root, as ``supple``."""
        with self.writing():
            note(self._site.store(read_only=False), told)

    def finish(self, *, keep: bool = False) -> str:
        """Make the output appear under its name, and return its address. Call it once, when all is written.

        ``keep`` keeps the marker, by which the same job knows that it is complete, until `forget` removes it.
        """
        if self.complete:
            return self.address
        with self.writing():
            check_written(self._place, self._site, (level.path for level in self.image.levels), self._job)
            if self._site.folder is not None:
                publish(self._place, self._site.folder, self._job, self._force, keep)
            elif keep:
                put(self._site.store(read_only=False), MARKER, told_of(self._job, "complete"))
            else:
                run(self._site.store(read_only=False).delete(MARKER))
        return self.address

    def forget(self) -> None:
        """Remove the marker that `finish` has kept; where it stays, it does no harm."""
        with contextlib.suppress(Exception):
            run(self._place.store(read_only=False).delete(MARKER))

    def _check(self, level: int, box: Box) -> None:
        array, block = self.arrays[level], self.blocks[level]
        spans = list(zip(box, array.shape, block, strict=False))
        good = all(0 <= a < b <= size and a % n == 0 and (b % n == 0 or b == size) for (a, b), size, n in spans)
        if len(box) != array.ndim or not good:
            told, shape = ", ".join(f"{a} to {b}" for a, b in box), tuple(array.shape)
            raise SuppleError(f"the box {told} of level {level}, of shape {shape}, is not aligned to blocks of {block}")

    def _keys(self, level: int, box: Box, array: Any) -> Iterator[str]:
        """Return the keys of the blocks of a box, in the store of an array."""
        self._check(level, box)
        prefix = f"{array.path}/" if array.path else ""
        ranges = [range(a // n, -(-b // n)) for (a, b), n in zip(box, self.blocks[level], strict=True)]
        return (prefix + array.metadata.encode_chunk_key(place) for place in product(*ranges))


def _writable(array: Any) -> Any:
    """Return an array that stores each chunk that is written."""
    import zarr

    settings: Any = {"order": "C", "write_empty_chunks": True}
    return zarr.Array(zarr.AsyncArray(metadata=array.metadata, store_path=array.store_path, config=settings))


def _encoding(array: Any) -> str:
    """Return all that determines how a chunk is stored; as text, in which NaN equals NaN."""
    told = dict(array.metadata.to_dict())
    for name in ("shape", "attributes", "chunk_key_encoding", "dimension_separator", "dimension_names"):
        told.pop(name, None)
    return json.dumps(told, sort_keys=True, default=repr)


def _size(path: Path) -> int:
    try:
        return os.stat(path).st_size
    except OSError:
        return 0


async def _each(act: Callable[[Item], Awaitable[Any]], items: Iterable[Item]) -> list[Any]:
    """Return what requests for several items return, of which some are made at a time."""
    places = asyncio.Semaphore(_AT_ONCE)

    async def one(item: Item) -> Any:
        async with places:
            return await act(item)

    return list(await asyncio.gather(*map(one, items)))
