"""Warps on a GPU: the map of a deformation in its memory, and the kernels for planes.

The lattice of each plane is solved, its cells are checked, the good ones are filled, and the pixels of the others are
solved one by one. Planes are computed a few at a time, so that scratch memory stays small. The host does not wait.
"""

from __future__ import annotations

import itertools
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engines.base import BETWEEN, FILTERS, OUTSIDE, Certificate, Space, Work
from supple.engines.cuda.device import CudaDevice, Memory, Pinned, Stream
from supple.engines.cuda.layout import JOB, TOLD
from supple.engines.cuda.programs import Program, blocks, launch, prepare
from supple.strokes import numbers

Array = npt.NDArray[Any]

SIZE = 8  # pixels from node to node
MAP = 4  # no filter: source points are written as float32, x first, or their displacements
SCRATCH = 256 << 20  # bytes of scratch memory, at most
_BLOCKS = 2048  # that share the rough cells
_KEPT = 16  # maps on the GPUs
_NODE, _LEAF = {2: 80, 3: 136}, {2: 168, 3: 236}  # bytes of a Node and of a Leaf, by dimensions: as in job.hpp
_TYPES = {
    "u1": ("uint8_t", "float"), "u2": ("uint16_t", "float"), "u4": ("uint32_t", "double"), "u8": ("uint64_t", "double"),
    "i1": ("int8_t", "float"), "i2": ("int16_t", "float"), "i4": ("int32_t", "double"), "i8": ("int64_t", "double"),
    "f2": ("Half", "float"), "f4": ("float", "float"), "f8": ("double", "double"), "b1": ("uint8_t", "float"),
}  # fmt: skip


_SIZES = {sample: int(name[1]) for name, (sample, _) in _TYPES.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Maps of one shape on a GPU, and the nodes at which they are solved.

    Parameters
    ----------
    spaces : tuple of Space
        The maps: one, or one for each plane.
    memory : Memory
        The maps (`_core.flatten`).
    places : Memory
        The positions of nodes along x, and then along y, int32, in pixels.
    nodes : (int, int)
        Their numbers along x and y.
    """

    spaces: tuple[Space, ...]
    memory: Memory
    places: Memory
    nodes: tuple[int, int]

    @property
    def cells(self) -> int:
        """The number of cells of a plane."""
        return (self.nodes[0] - 1) * (self.nodes[1] - 1)

    @property
    def scratch(self) -> int:
        """The bytes of scratch memory that a plane takes."""
        n = self.spaces[0].ndim
        return self.nodes[0] * self.nodes[1] * _NODE[n] + self.cells * (_LEAF[n] + 8)


_lattices: OrderedDict[tuple[Any, ...], Lattice] = OrderedDict()
_uploads: dict[int, Stream] = {}
_lock = threading.Lock()


def positions(first: int, n: int, axis: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """Return the positions of nodes along an axis of ``n`` samples from the ``first`` on, at most SIZE apart.

    ``axis`` is the row of the packed domain: the border's factor has a kink at its end, and a node there keeps cells
    from crossing it.
    """
    if n == 1:  # a single sample gets a cell, too, which extends beyond the plane
        return np.array([first, first + 1], np.int32)
    low, high, sigma, spacing = axis[:4]
    kinks = [round(k / spacing) for k in (low + sigma, high - sigma)] if sigma > 0 else []
    end = first + n - 1
    ends = sorted({first, *(k for k in kinks if first < k < end), end})
    return np.concatenate([*(np.arange(a, b, SIZE) for a, b in itertools.pairwise(ends)), [end]]).astype(np.int32)


def lattice_of(gpu: CudaDevice, spaces: Sequence[Space]) -> Lattice:
    """Return the maps of deformations of one shape on a GPU, the current device; the last ones are kept there."""
    # Their arrays are immutable, and kept alive with the lattice, so that their ids stay unique.
    parts = [(s.shape, id(s.table), id(s.axes), id(s.composite), id(s.freeze), s.grid) for s in spaces]
    key = (gpu.number, *parts)
    with _lock:
        found = _lattices.get(key)
        if found is None:
            found = _lattices[key] = _uploaded(gpu, tuple(spaces))
            while len(_lattices) > _KEPT:
                _lattices.popitem(last=False)
        _lattices.move_to_end(key)
    return found


def _uploaded(gpu: CudaDevice, spaces: tuple[Space, ...]) -> Lattice:
    # A stream of its own does not wait for other work of the GPU.
    stream = _uploads.get(gpu.number) or _uploads.setdefault(gpu.number, gpu.stream())
    maps = [(numbers(s.table), s.axes, s.composite, s.freeze) for s in spaces]
    memory = Memory(len(_core.flatten(maps, 0)), stream)
    memory.upload(np.frombuffer(_core.flatten(maps, memory.pointer), np.uint8))
    one, axes = spaces[0], spaces[0].axes
    if any(not np.array_equal(axes, other.axes) for other in spaces[1:]):
        axes = np.full_like(axes, -1.0)  # no nodes at the ends of several borders: their cells are rough
    first = (0, 0) if one.grid is None else one.grid.first[:2]
    xs, ys = (positions(first[k], n, axes[k]) for k, n in enumerate(one.planes[:0:-1]))
    places = Memory(4 * (xs.size + ys.size), stream)
    places.upload(np.concatenate([xs, ys]))
    stream.synchronize()  # from here on, any stream may read them
    return Lattice(spaces, memory, places, (xs.size, ys.size))


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """Planes in the memory of a GPU.

    Parameters
    ----------
    pointer : int
        The address of the first sample of the first plane.
    strides : (int, int, int, int)
        From a plane, a row, a column and a channel to the next, in samples.
    first : int
        The number of the first plane that is there.
    """

    pointer: int
    strides: tuple[int, int, int, int]
    first: int = 0


@dataclass(slots=True, eq=False)
class Told:
    """What kernels say of a map: on the GPU, and, when their stream gets there, on the host."""

    there: Memory
    here: Pinned = field(default_factory=lambda: Pinned(TOLD.itemsize))

    @classmethod
    def on(cls, stream: Stream) -> Told:
        """Return a new one on a stream, in which nothing is said."""
        made = cls(Memory(TOLD.itemsize, stream))
        made.there.clear(0, TOLD.itemsize)
        return made

    def forget_rough(self) -> None:
        """Begin to count rough cells anew."""
        self.there.clear(int(TOLD.fields["rough"][1]), 4)  # type: ignore[index]

    def send(self) -> None:
        """Copy it to the host, when the stream gets there."""
        self.there.download(self.here.bytes)

    def certificate(self, space: Space) -> Certificate:
        """Return the certificate; the stream has got there."""
        said = self.here.bytes.view(TOLD)[0]
        unsolved = int(said["unsolved"])
        error = np.inf if unsolved else float(said["worst"])
        if space.composite is None:
            return Certificate(error, 0.0)
        return Certificate(error, 0.0, unsolved, int(said["folded"]), int(said["outside"]))


@dataclass(frozen=True, slots=True, eq=False)
class Painter:
    """The kernels for samples of a type, and what they are told of the samples.

    Parameters
    ----------
    gpu : CudaDevice
    lattice : Lattice
    programs : dict of Program
        By the names of kernels.
    job : array of one JOB record
        All that is the same for all planes.
    fill : Memory, optional
        The fill value of each channel; None for a map itself.
    """

    gpu: CudaDevice
    lattice: Lattice
    programs: dict[str, Program]
    job: Array
    fill: Memory | None


def _programs(spaces: Sequence[Space], sample: str, number: str, together: int, filter: int) -> dict[str, Program]:
    kinds = {space.composite is not None for space in spaces}
    n, composed = spaces[0].ndim, kinds.pop() if len(kinds) == 1 else None
    made = {unit: Program(unit, n, composed) for unit in ("nodes", "cells")}
    for unit in ("fill", "rough"):
        made[unit] = Program(unit, n, composed, sample, number, together, filter)
    return made


def mapper(gpu: CudaDevice, space: Space, tolerance: float, *, offsets: bool) -> Painter:
    """Return the painter of a map itself: source points, or displacements."""
    job = _common(space, tolerance)
    job["average"] = offsets
    return _prepared(gpu, (space,), _programs((space,), "float", "float", 1, MAP), job, None)


def painter(gpu: CudaDevice, work: Work, dtype: np.dtype[Any], stream: Stream) -> Painter:
    """Return the painter of work on samples of a type, in the order of a stream."""
    space, sampling, group = work.space, work.sampling, work.layout.groups[0]
    sample, number = _TYPES[dtype.str[1:]]
    nearest = sampling.filter == "nearest"
    (fill,) = work.fills
    white = 1.0 if dtype == np.bool_ else work.layout.white
    top = min(white, int(np.iinfo(dtype).max)) if dtype.kind in "iu" else white
    job = _common(space, sampling.tolerance)
    for name, value in {
        "white": white,
        "high": top,
        "top": int(top),
        "w": space.shape[1],
        "h": space.shape[0],
        "count": space.count if space.ndim == 3 else 1,
        "channels": group.channels,
        "between": BETWEEN[sampling.between],
        "rule": OUTSIDE[sampling.outside],
        "average": sampling.time_filter and sampling.between != "nearest",
        "alpha": group.channels - 1 if group.alpha and not nearest else -1,
        "light": sampling.light and not nearest,
    }.items():
        job[name] = value
    held = Memory(fill.nbytes, stream)
    held.upload(np.ascontiguousarray(fill))
    programs = _programs(work.spaces, sample, number, 1 if group.channels == 1 else 4, FILTERS[sampling.filter])
    return _prepared(gpu, work.spaces, programs, job, held)


def _common(space: Space, tolerance: float) -> Array:
    job = np.zeros(1, JOB)
    job["tolerance"] = tolerance
    job["height"], job["width"] = space.planes[1:]
    if space.grid is not None:
        job["from_x"], job["from_y"] = space.grid.first[:2]
    return job


def _prepared(
    gpu: CudaDevice, spaces: Sequence[Space], programs: dict[str, Program], job: Array, fill: Memory | None
) -> Painter:
    prepare(gpu, programs.values())
    return Painter(gpu, lattice_of(gpu, spaces), programs, job, fill)


def paint(
    painter: Painter,
    stream: Stream,
    source: Planes | None,
    out: Planes,
    planes: tuple[int, int],
    told: Told,
    *,
    shared: int = 0,
    slab: int | None = None,
) -> None:
    """Launch the kernels for some planes on a stream of the current device, slab by slab.

    Parameters
    ----------
    painter : Painter
    stream : Stream
    source, out : Planes
        The source may be None for a map itself.
    planes : (int, int)
        From, to.
    told : Told
    shared : int
        The number of images that share one map and its nodes; 0 if each plane has its own.
    slab : int, optional
        The number of planes in one launch, at most; by default, as many as scratch memory has room for.
    """
    gpu, lattice, programs, job = painter.gpu, painter.lattice, painter.programs, painter.job.copy()
    space = lattice.spaces[0]
    (nx, ny), cells, n = lattice.nodes, lattice.cells, space.ndim
    room = max(1, min(SCRATCH // lattice.scratch, 65535))
    solved = 1 if shared else min(planes[1] - planes[0], room, slab or room)
    together = min(planes[1] - planes[0], 65535) if shared else solved
    sizes = {
        "nodes": solved * nx * ny * _NODE[n],
        "leaves": solved * cells * _LEAF[n],
        "states": solved * cells * 4,
        "rough": solved * cells * 4,
    }
    pieces = {name: Memory(size, stream) for name, size in sizes.items()}
    for name, memory in pieces.items():
        job[name] = memory.pointer
    first = 0 if space.grid is None or n == 2 else space.grid.first[2]
    for name, value in {
        "maps": lattice.memory.pointer,
        "xs": lattice.places.pointer,
        "ys": lattice.places.pointer + 4 * nx,
        "told": told.there.pointer,
        "fill": painter.fill.pointer if painter.fill else 0,
        "map_count": len(lattice.spaces),
        "nx": nx,
        "ny": ny,
    }.items():
        job[name] = value
    if source is not None:
        job["source"], job["held_from"] = (source.pointer, *source.strides), source.first
    size = 4 if painter.fill is None else _SIZES[programs["fill"].sample]
    for start in range(*planes, together):
        count = min(together, planes[1] - start)
        many = 1 if shared else count
        job["planes"], job["first"], job["shared"] = many, first + start, count if shared else 0
        job["out"] = (out.pointer + (start - out.first) * out.strides[0] * size, *out.strides)
        told.forget_rough()
        launch(gpu, programs["nodes"], blocks(many * nx * ny), job, stream)
        launch(gpu, programs["cells"], blocks(many * cells), job, stream)
        launch(gpu, programs["fill"], (blocks(int(job["width"][0])), ny - 1, count), job, stream)
        launch(gpu, programs["rough"], min(many * cells, _BLOCKS), job, stream)
