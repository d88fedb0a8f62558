"""Warps of arrays that are larger than memory, by Dask: each task reads the part of the source that its block needs."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from supple.blocks import Block, Box, Read, Warp, boxes_of
from supple.deformation import Deformation
from supple.engine.sampling import DEFAULT, Sampling, SamplingFields, warn_of
from supple.engine.work import work_of
from supple.errors import SuppleError, need
from supple.fields import check_path
from supple.space.checks import refuse
from supple.space.geometry import Grid

need("zarr", "warps by Dask", "dask")
import dask  # noqa: E402
import dask.array as da  # noqa: E402
from dask.base import tokenize  # noqa: E402
from dask.highlevelgraph import HighLevelGraph  # noqa: E402

__all__ = ["warp"]

_DEFAULT = 1 << 26  # bytes of a block of an array without chunks
_TOGETHER = 16  # blocks whose parts of the source one task determines


def warp(
    array: Any,
    deformation: Deformation,
    grid: Grid | None = None,
    chunks: Any = None,
    *,
    axes: Sequence[int] | None = None,
    sampling: Sampling = DEFAULT,
    alpha: bool | None = None,
    **options: Unpack[SamplingFields],
) -> Any:
    """Warp an array lazily: block by block, on threads, processes or a cluster.

    Each task reads only the part of the source that its block of the output needs, which the map's certificate gives
    exactly. Where strokes have a reach, blocks beyond it are copies.

    Parameters
    ----------
    array : dask.array.Array, xarray.DataArray, or array
        The source. From an array that is sliced when it is read (Zarr's, HDF5's, a memory map), each task reads
        only its part, so memory does not grow with the array. Chunks of a Dask array are computed once, and shared
        by the tasks that need them.
    deformation : Deformation
    grid : Grid, optional
        The grid of the output; by default, that of the input.
    chunks : int, tuple or dict, optional
        The chunks of the output, as in Dask; by default, those of the source. For a DataArray, a dict names axes.
        Of axes that it omits, bent ones have one chunk, and others chunks of one position.
    axes : sequence of int, optional
        The axes that are bent: adjacent, in ascending order. By default the last ones, if they have the shape of
        the deformation, and the first ones otherwise, as of images with channels. Axes before them are carried along:
        times, channels, positions. An axis after them holds channels, the last of which may be opacity.
    sampling : Sampling, optional
        How the arrays are sampled; further keywords replace its fields: ``filter="linear"``.
    alpha
        As in `Deformation.warp`.

    Returns
    -------
    dask.array.Array or xarray.DataArray
        Of the source's type, and equal to what `Deformation.warp` returns, bit for bit. A DataArray keeps its name,
        attributes and coordinates. Another grid sets the coordinates of bent axes, if it is parallel to the axes of
        space; a part of the deformation's own grid keeps the source's.

    Warns
    -----
    ToleranceWarning, FoldWarning, OutsideWarning
        As in `Deformation.warp`, at once.
    """
    if not isinstance(deformation, Deformation):
        refuse("deformation", "a Deformation", deformation)
    if getattr(grid, "ndim", deformation.ndim) != deformation.ndim or not isinstance(grid, Grid | None):
        refuse("grid", f"a Grid of {deformation.ndim} axes", grid)
    if grid is None and deformation.straightened is not None:
        grid, options = deformation.output, deformation.filling(sampling, options)
    sampling = Sampling.of(sampling, options, deformation.ndim)
    job = Warp(deformation, sampling, grid, alpha)
    if type(array).__module__.partition(".")[0] == "xarray":
        return _of_xarray(array, job, chunks, axes)
    for name in ("shape", "dtype", "__getitem__"):
        if not hasattr(array, name):
            refuse("array", "an array with a shape, a dtype and slices", array)
    if 0 in array.shape:
        refuse("array", "an array with samples", told=f"shape {array.shape}")
    return _warped(array, job, chunks, _first_axis(array.shape, deformation.shape, axes))


def _first_axis(shape: tuple[int, ...], bent: tuple[int, ...], axes: Sequence[int] | None) -> int:
    """Return the first of the axes that are bent."""
    n, dims = len(bent), len(shape)
    if axes is not None:
        try:
            given = [operator.index(axis) for axis in axes]
        except TypeError:
            given = []
        wanted = tuple(axis % dims if -dims <= axis < dims else dims for axis in given)
        if not wanted or wanted != tuple(range(wanted[0], wanted[0] + n)) or not dims - 2 <= wanted[-1] < dims:
            refuse("axes", f"{n} axes side by side in ascending order, after which there is at most one", axes)
        first = wanted[0]
        if shape[first : first + n] != bent:
            sizes = shape[first : first + n]
            raise SuppleError(f"the deformation has shape {bent}, and axes {wanted} of the array have {sizes}")
        return first
    for first in (dims - n, 0, dims - n - 1):
        if first >= 0 and shape[first : first + n] == bent and dims - first - n <= 1:
            return first
    text = f"the deformation has shape {bent}, and the array {shape}: the last axes must be those, or those before "
    raise SuppleError(f"{text}channels")


def _warped(array: Any, job: Warp, chunks: Any, first: int) -> da.Array:
    """Return the warped array."""
    n, dims = job.deformation.ndim, len(array.shape)
    last = first + n  # the axis after the bent ones
    dtype = np.dtype(array.dtype)
    # Checks the maps, the type and the channels.
    check_path(reversed(job.deformation.maps), job.grid or job.deformation.grid)
    work_of((*job.deformation.shape, *array.shape[last:]), dtype, job.packed(), job.sampling, job.alpha)
    shape = (*array.shape[:first], *job.shape, *array.shape[last:])
    blocks = _chunks(array, chunks, shape, dtype, first, n)
    if isinstance(array, da.Array):
        array = array.rechunk(dict.fromkeys(range(last, dims), -1))  # type: ignore[no-untyped-call]
    boxes = list(boxes_of(blocks[first:last]))
    planned, certificate = job.plan(boxes, _everywhere)
    warn_of(certificate, job.sampling.tolerance)

    name = f"warp-{tokenize(array, job.deformation, job.sampling, job.grid, job.alpha, blocks)}"
    graph: dict[Any, Any] = {(name, "job"): job}
    own = isinstance(array, da.Array)
    if not own:
        graph[name, "source"] = array
    leads = list(itertools.product(*[range(len(sizes)) for sizes in blocks[:first]]))
    spans = [list(boxes_of([sizes])) for sizes in blocks]
    numbers = itertools.product(*[range(len(sizes)) for sizes in blocks[first:last]])
    tail: Box = tuple((0, size) for size in shape[last:])
    for number, block in zip(numbers, planned, strict=True):
        for lead in leads:
            before: Box = tuple(spans[axis][k][0] for axis, k in enumerate(lead))
            box = (*before, *block.part, *tail)
            key = (name, *lead, *number, *[0] * len(tail))
            if own:
                graph[key] = (_warp_pieces, (name, "job"), block, first, *_pieces(array, box, graph, key))
            else:
                graph[key] = (_warp_read, (name, "job"), block, first, (name, "source"), box)
    dependencies = [array] if own else []
    meta: npt.NDArray[Any] = np.empty((0,) * dims, dtype)
    layers = HighLevelGraph.from_collections(name, graph, dependencies)
    return da.Array(layers, name, blocks, meta=meta)  # type: ignore[no-untyped-call]


def _everywhere(job: Warp, boxes: Sequence[Box]) -> list[Read]:
    """Return the parts that blocks read, computed by Dask: on local threads, or on the connected cluster."""
    if len(boxes) <= _TOGETHER:
        return job.all_reads(boxes)
    # The map, which may hold a large field, is sent once, and not with each task.
    held, all_reads = dask.delayed(job, traverse=False), dask.delayed(Warp.all_reads)  # type: ignore[attr-defined]
    parts = [boxes[k : k + _TOGETHER] for k in range(0, len(boxes), _TOGETHER)]
    return list(itertools.chain(*dask.compute(*[all_reads(held, part) for part in parts])))  # type: ignore[attr-defined, no-untyped-call]


def _chunks(
    array: Any, chunks: Any, shape: tuple[int, ...], dtype: np.dtype[Any], first: int, n: int
) -> tuple[tuple[int, ...], ...]:
    """Return the chunks of the output; an axis of channels has one."""
    given, tail = chunks, shape[first + n :]
    if chunks is None and (own := getattr(array, "shards", None) or getattr(array, "chunks", None)):
        # On another grid, blocks have the size of the source's.
        chunks = tuple(
            sizes if isinstance(sizes, int) or sum(sizes) == size else max(sizes)
            for sizes, size in zip(own, shape, strict=True)
        )
    elif chunks is None or isinstance(chunks, int | np.integer):
        chunks = (*[1] * first, *["auto" if chunks is None else int(chunks)] * n, *tail)
    elif isinstance(chunks, tuple | list) and len(chunks) == n:
        chunks = (*[1] * first, *chunks, *tail)
    try:
        made = da.core.normalize_chunks(chunks, shape, None if given is not None else _DEFAULT, dtype)  # type: ignore[no-untyped-call]
        if any(size < 1 for sizes in made for size in sizes):
            raise ValueError("a chunk has at least one sample along each axis")
    except (ValueError, TypeError, IndexError, KeyError, ArithmeticError, AttributeError) as error:
        told = " ".join(str(error).split()) or type(error).__name__
        refuse("chunks", f"sizes that fit the output's shape {shape}, as in Dask ({told})", given)
    return (*made[: first + n], *[(size,) for size in tail])


def _pieces(array: da.Array, box: Box, graph: dict[Any, Any], key: Any) -> tuple[Any, ...]:
    """Return the shape of a part of an array, and the places and keys of its pieces, which are copied by tasks."""
    ranges = []
    for (start, stop), sizes in zip(box, array.chunks, strict=True):
        ends = np.cumsum(sizes)
        met = range(int(np.searchsorted(ends, start, "right")), int(np.searchsorted(ends, stop, "left")) + 1)
        ranges.append([(k, int(ends[k]) - sizes[k], int(ends[k])) for k in met])
    shape, places, pieces = tuple(b - a for a, b in box), [], []
    for number, chosen in enumerate(itertools.product(*ranges)):
        cut = [(max(a, start), min(b, stop)) for (_, start, stop), (a, b) in zip(chosen, box, strict=True)]
        places.append(tuple((p - a, q - a) for (p, q), (a, _) in zip(cut, box, strict=True)))
        within = tuple((p - start, q - start) for (p, q), (_, start, _) in zip(cut, chosen, strict=True))
        source = (array.name, *[k for k, _, _ in chosen])
        piece = (f"{key[0]}-cut", *key[1:], number)
        graph[piece] = (_cut, source, within)
        pieces.append(piece)
    return shape, places, pieces


def _cut(chunk: npt.NDArray[Any], within: Box) -> npt.NDArray[Any]:
    """Return a copy of a part, so that the chunk can be freed; a chunk that is needed whole is returned itself."""
    if all(b - a == size for (a, b), size in zip(within, chunk.shape, strict=True)):
        return chunk
    return np.array(chunk[tuple(slice(*each) for each in within)])


def _warp_pieces(
    job: Warp, block: Block, first: int, shape: tuple[int, ...], places: Sequence[Box], pieces: Sequence[Any]
) -> npt.NDArray[Any]:
    part = np.empty(shape, pieces[0].dtype)
    for place, piece in zip(places, pieces, strict=True):
        part[tuple(slice(*each) for each in place)] = piece
    return job.block(part, block, first)


def _warp_read(job: Warp, block: Block, first: int, source: Any, box: Box) -> npt.NDArray[Any]:
    return job.block(np.asarray(source[tuple(slice(*each) for each in box)]), block, first)


def _of_xarray(array: Any, job: Warp, chunks: Any, axes: Sequence[int] | None) -> Any:
    import xarray

    if not isinstance(array, xarray.DataArray):
        refuse("array", "a DataArray (choose a variable of the Dataset)", array)
    first = _first_axis(array.shape, job.deformation.shape, axes)
    if isinstance(chunks, Mapping):
        if not set(chunks) <= set(array.dims):
            refuse("chunks", f"sizes by the names of the axes, {', '.join(map(str, array.dims))}", chunks)
        chunks = tuple(chunks.get(name, 1 if axis < first else -1) for axis, name in enumerate(array.dims))
    made = _warped(array.data, job, chunks, first)
    bent = array.dims[first : first + job.deformation.ndim]
    coords = dict(array.coords)
    grid, own = job.grid, job.deformation.grid
    if grid is not None and grid.uncropped().is_same_space(own):  # a part of the source's grid
        kept = dict(zip(bent[::-1], map(slice, grid.first, np.add(grid.first, grid.sizes)), strict=True))
        coords = {name: value.isel(kept, missing_dims="ignore") for name, value in coords.items()}
    elif grid is not None:
        coords = {name: value for name, value in coords.items() if not set(value.dims) & set(bent)}
        if np.array_equal(grid.direction, np.eye(grid.ndim)):
            for dim, size, step, start in zip(bent[::-1], grid.sizes, grid.spacing, grid.origin, strict=True):
                coords[dim] = (dim, start + step * np.arange(size))
    result = xarray.DataArray(made, coords, array.dims, attrs=array.attrs)
    result.name = array.name  # otherwise it is the name of Dask's array
    return result
