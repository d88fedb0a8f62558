"""Warps of GPU arrays: the lattice of a deformation, and the kernels for each array.

Planes are computed a few at a time, so that their scratch memory stays small: their lattice is solved, its cells are
checked, the good ones are filled, and the pixels of the others are solved. The host waits only after all launches.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.domain import FREE
from supple.engines.base import OUTSIDE, Certificate, Space, Work, times_seen
from supple.engines.cuda.arrays import DeviceArray, made_like
from supple.engines.cuda.colour import BETWEEN, FILTERS, NOTHING
from supple.engines.cuda.device import CudaDevice, simulated
from supple.engines.cuda.field import packed
from supple.engines.cuda.fill import PIXELS, kernels
from supple.engines.cuda.kernel import THREADS, blocks, launched
from supple.engines.cuda.lattice import LIST, LOST, NODE, WORST, check, positions, solve, twist
from supple.engines.cuda.numbers import numbers_of
from supple.engines.cuda.sample import FIRST, FRAME, FRAMES, LAST, START, Way

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

SCRATCH = 256 << 20  # bytes of scratch memory, at most
_LONG = (1 << 31) - (1 << 24)  # samples, with room for sums
_KEPT = 64  # small arrays cached on the GPUs
_KEPT_LATTICES = 16
_KEPT_PIECES = 32 << 20  # bytes, at most, cached by a thread


_held: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
_uploads: dict[int, Any] = {}
_lock = threading.Lock()


def held(gpu: CudaDevice, array: Array) -> Any:
    """Return a small array on a GPU, from the cache if its values are there."""
    from numba import cuda

    key = (gpu.number, array.dtype.str, array.shape, array.tobytes())
    with _lock:
        if key not in _held:
            with gpu.current():
                # A stream of its own does not wait for other work of the GPU.
                stream = _uploads.get(gpu.number) or _uploads.setdefault(gpu.number, gpu.stream())
                _held[key] = cuda.to_device(array, stream=stream)
                stream.synchronize()
            while len(_held) > _KEPT:
                _held.popitem(last=False)
        _held.move_to_end(key)
        return _held[key]


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """The strokes and domains of deformations of one shape, on a GPU.

    Parameters
    ----------
    known, spans : device arrays
        See `supple.engines.cuda.field.packed`.
    xs, ys : device arrays of int32
        The positions of nodes, in pixels.
    cells : device array of int32
        The cell of each column.
    size : (int, int)
        The nodes: rows, and in a row.
    deformations : int
    limited : bool
        Whether some pixels may be unchanged.
    """

    known: Any
    spans: Any
    xs: Any
    ys: Any
    cells: Any
    size: tuple[int, int]
    deformations: int
    limited: bool

    @property
    def nodes(self) -> int:
        """The number of nodes of a plane."""
        return self.size[0] * self.size[1]

    @property
    def cell_count(self) -> int:
        """The number of cells of a plane."""
        return (self.size[0] - 1) * (self.size[1] - 1)


_lattices: OrderedDict[tuple[Any, ...], tuple[Lattice, tuple[Space, ...]]] = OrderedDict()


def lattice_of(gpu: CudaDevice, spaces: Sequence[Space]) -> Lattice:
    """Upload deformations, all of one shape; the last ones are cached."""
    # Their arrays are immutable, and kept alive with the cache, so that their ids stay unique.
    key = (gpu.number, spaces[0].shape, *((id(space.table), id(space.axes)) for space in spaces))
    with _lock:
        found = _lattices.get(key)
    if found is None:
        found = _new_lattice(gpu, spaces), tuple(spaces)
        with _lock:
            _lattices[key] = found
            while len(_lattices) > _KEPT_LATTICES:
                _lattices.popitem(last=False)
    return found[0]


def _new_lattice(gpu: CudaDevice, spaces: Sequence[Space]) -> Lattice:
    domains = [space.axes for space in spaces]
    axes = domains[0]
    if any(not np.array_equal(axes, other) for other in domains[1:]):
        axes = np.array([FREE] * 3)  # no nodes at the ends of several borders: their cells are rough
    height, width = spaces[0].shape
    xs, ys = (positions(n, axes[k]) for k, n in enumerate((width, height)))
    cells = np.clip(np.searchsorted(xs, np.arange(width), "right") - 1, 0, xs.size - 2).astype(np.int32)
    known, spans = packed([space.table for space in spaces], domains)
    there = [held(gpu, array) for array in (known, spans, xs, ys, cells)]
    limited = any(np.isfinite(space.table["reach"]).all() for space in spaces)
    return Lattice(there[0], there[1], there[2], there[3], there[4], (ys.size, xs.size), len(spaces), limited)


@dataclass(frozen=True, slots=True, eq=False)
class Colours:
    """The kernels of a sampling, and their arguments."""

    way: Way
    fills: Any
    how: tuple[int, ...]
    limits: tuple[float, ...]


def colours_of(gpu: CudaDevice, dtype: np.dtype[Any], work: Work, count: int) -> Colours:
    """Return the kernels and arguments for samples of a type, of ``count`` frames."""
    sampling, alpha, stack = work.sampling, work.layout.groups[0].alpha, work.space.ndim == 3
    (fill,) = work.fills
    kind = np.dtype(np.uint8) if dtype == np.bool_ else dtype
    nearest = sampling.filter == "nearest"
    light, opaque = sampling.light and not nearest, alpha and not nearest
    numbers = numbers_of(kind, fill, alpha=opaque, light=light, white=1.0 if dtype == np.bool_ else None)
    early, late = times_seen(sampling.outside, count, sampling.time_filter)
    number = np.float64 if numbers.dtype == np.float64 else np.float32
    way = Way(
        FILTERS[sampling.filter],
        BETWEEN[sampling.between] if stack else NOTHING,
        OUTSIDE[sampling.outside],
        stack and sampling.time_filter and sampling.between in ("linear", "cubic") and not nearest,
        number,
        whole=numbers.whole,
        alpha=opaque,
        light=light,
    )
    return Colours(
        way,
        held(gpu, fill.astype(kind) if nearest else numbers.fills),
        (numbers.alpha, int(early), int(late)),
        (numbers.low, numbers.high, numbers.white),
    )


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames on a GPU: flat memory, and its layout; see `supple.engines.cuda.sample.SOURCE`.

    Of a ``ring``, frames may be missing; the flag stays set when all are there, so that one kernel serves all planes.
    """

    samples: Any
    places: tuple[int, ...]
    ring: bool = False

    @property
    def long(self) -> bool:
        """True if the count of its samples takes more than 32 bits."""
        return bool(self.samples.size > _LONG)


class Pieces:
    """Work arrays on a GPU, in a library's own memory, so that its streams track them."""

    def __init__(self, like: DeviceArray, lattices: Sequence[Lattice], planes: int) -> None:
        nodes, cells = max(known.nodes for known in lattices), max(known.cell_count for known in lattices)
        self.together = max(1, min(planes, SCRATCH // (nodes * NODE * 4 + cells * 8), 65535))
        sizes = {
            "nodes": (self.together * nodes * NODE, np.float32),
            "errors": (self.together * cells, np.float32),
            "told": (1, np.float32),
            "counts": (LIST + self.together * cells, np.int32),
        }
        self.kept = {name: made_like(like, (n,), dtype) for name, (n, dtype) in sizes.items()}
        self.nodes, self.errors, self.told, self.counts = (self.kept[name].flat() for name in sizes)
        self.counted = self.counts[:LIST]
        self.size = sum(n * np.dtype(dtype).itemsize for n, dtype in sizes.values())


def make_planes(
    gpu: CudaDevice,
    stream: Any,
    lattice: Lattice,
    pieces: Pieces,
    colours: Colours,
    shape: tuple[int, int],
    planes: tuple[int, int],
    source: Frames,
    out: Frames,
    *,
    tolerance: float,
    shared: int = 0,
    fresh: bool = True,
    slab: int | None = None,
) -> None:
    """Launch the kernels for some planes, slab by slab.

    Parameters
    ----------
    gpu, stream, lattice, pieces, colours
        The device, and the resources of the warp.
    shape : (int, int)
        Rows and columns of a plane.
    planes : (int, int)
        From, to. ``out`` begins with the first of them.
    source, out : Frames
    tolerance : float
        The tolerance of source points, in pixels.
    shared : int
        The number of images that share one lattice; 0 if each plane has its own.
    fresh : bool
        Whether to reset the results of the warp.
    slab : int, optional
        The number of planes in one launch.
    """
    height, width = shape
    rows, _ = lattice.size
    ring = source.ring or source.places[FIRST : LAST + 1] != (0, source.places[FRAMES])
    index = np.int64 if source.long or out.long else np.int32
    fill, rough = kernels(replace(colours.way, index=index, ring=ring, limited=lattice.limited))
    limits = tuple(map(colours.way.number, colours.limits))
    places, how = (tuple(map(index, numbers)) for numbers in (source.places, colours.how))
    read = (source.samples, colours.fills, places, how, limits)
    threads = min(THREADS, -(-width // 32) * 32)
    together = min(slab or pieces.together, pieces.together)
    if shared:
        together = min(planes[1] - planes[0], 65535)
    grid = 4 if simulated() else 8 * gpu.processors
    for first in range(*planes, together):
        count = min(together, planes[1] - first)
        solved = 1 if shared else count
        described = (height, width, count, first, lattice.deformations, int(shared > 0))
        target = (*out.places[FRAME:START], out.places[START] + (first - planes[0]) * out.places[FRAME])
        nodes, cells = solved * lattice.nodes, solved * lattice.cell_count
        launched(solve, blocks(nodes), THREADS, stream)(
            lattice.known, lattice.spans, lattice.deformations, lattice.xs, lattice.ys, solved, first, int(fresh),
            pieces.nodes, pieces.told, pieces.counts,
        )  # fmt: skip
        launched(twist, blocks(nodes), THREADS, stream)(lattice.xs, lattice.ys, solved, pieces.nodes)
        launched(check, blocks(cells), THREADS, stream)(
            lattice.known, lattice.spans, lattice.deformations, lattice.xs, lattice.ys, solved, first, tolerance,
            pieces.nodes, pieces.errors, pieces.told, pieces.counts,
        )  # fmt: skip
        common = (*read, out.samples, tuple(map(index, target)))
        launched(fill, (-(-width // threads), rows - 1, count), threads, stream)(
            lattice.known, lattice.spans, lattice.xs, lattice.ys, lattice.cells, pieces.nodes, pieces.errors, described,
            *common, pieces.counts,
        )  # fmt: skip
        launched(rough, min(grid, cells), PIXELS, stream)(
            lattice.known, lattice.spans, lattice.xs, lattice.ys, pieces.nodes, described, tolerance, *common,
            pieces.told, pieces.counts,
        )  # fmt: skip
        fresh = False


_kept_pieces = threading.local()


def pieces_of(like: DeviceArray, lattices: Sequence[Lattice], planes: int) -> Pieces:
    """Return the work arrays for a library's current stream, which is waited for: small ones are cached.

    Work of a thread on a stream runs in order, so that no data in use are overwritten.
    """
    sizes = tuple((known.nodes, known.cell_count) for known in lattices)
    key = (like.kind, like.gpu.number, int(getattr(like.stream, "handle", 0) or 0), planes, *sizes)
    kept = getattr(_kept_pieces, "one", None)
    if kept is None or kept[0] != key:
        made = Pieces(like, lattices, planes)
        kept = key, made
        _kept_pieces.one = kept if made.size <= _KEPT_PIECES else None
    return kept[1]


def told_of(pieces: Pieces, stream: Any) -> Certificate:
    """Return the certificate of the map, after waiting for the stream."""
    told = pieces.told.copy_to_host(stream=stream)
    counts = pieces.counted.copy_to_host(stream=stream)
    if stream:
        stream.synchronize()
    return certificate_of(told, counts)


def certificate_of(told: Array, counts: Array) -> Certificate:
    """Return the certificate of a map from the results of its kernels."""
    return Certificate(np.inf if counts[LOST] else float(told[WORST]), 0.0)
