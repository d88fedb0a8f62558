"""Warps on a GPU: the map of a deformation in its memory, and the kernels for planes.

The lattice of each plane is solved, its cells are checked, the good ones are filled, and the pixels of the others are
solved one by one. Scratch memory bounds the number of planes per launch. The host does not wait.
"""

from __future__ import annotations

import itertools
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import STROKE_DTYPE
from supple.cuda.device import CudaDevice, Memory, Pinned, Stream
from supple.cuda.programs import CHECKS, JOB, THREADS, Program, launch, prepare, record
from supple.engine.sampling import BETWEEN, FILTERS, OUTSIDE, Certificate
from supple.engine.work import Space, Work, refuse_mattes
from supple.space.checks import refuse

Array = npt.NDArray[Any]
Samples = tuple[int, ...]
"""The address of the first sample, and the steps to the next plane, row, column and channel, in samples."""

SIZES = 8, 16, 32  # pixels from node to node
MAP = 4  # in place of a filter: source points, or their displacements, are written as float32, x first
SCRATCH = 96 << 20  # bytes of scratch memory, at most
_BLOCKS = 2048  # blocks that share the rough cells
_MOST = 65535  # planes of one launch
_KEPT = 16  # maps that stay on the GPUs
_NODE, _LEAF = {2: 48, 3: 80}, {2: 136, 3: 220}  # bytes of a NodeRecord and a LeafRecord, by dimensions: as in job.hpp
RUN = {2: 1, 3: 8}  # planes whose nodes are solved by one thread: as in job.hpp
_TYPES = {
    "u1": ("uint8_t", "float"), "u2": ("uint16_t", "float"), "u4": ("uint32_t", "double"), "u8": ("uint64_t", "double"),
    "i1": ("int8_t", "float"), "i2": ("int16_t", "float"), "i4": ("int32_t", "double"), "i8": ("int64_t", "double"),
    "f2": ("Half", "float"), "f4": ("float", "float"), "f8": ("double", "double"), "b1": ("uint8_t", "float"),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Maps of one shape on a GPU (one, or one for each plane), and the nodes at which they are solved.

    ``memory`` has the maps (`_core.flatten`); ``places``, the positions of nodes along x, and then along y, int32, in
    pixels; ``nodes``, the numbers of these. ``composed`` is that of their `Program`.
    """

    memory: Memory
    places: Memory
    nodes: tuple[int, int]
    composed: bool | None


_lattices: OrderedDict[tuple[Any, ...], Lattice] = OrderedDict()
_lock = threading.Lock()
_spare: list[Pinned] = []


def sizes_of(spaces: Sequence[Space], axes: Array, tolerance: float) -> tuple[int, int, float]:
    """Return the distances of nodes, in pixels, beside a border and elsewhere, and how far a border's end is moved.

    ``axes`` are those of all spaces.

    A bicubic patch of size h misses a stroke that moves pixels by its own radius r by about 0.15 h⁴/r³. Maps that vary
    over other lengths than radii (fields, masks) get the smallest size. Borders along other axes than the planes' are
    ignored: within a plane, their factors vary no faster than the map.
    """
    if any(space.composite is not None or space.freeze is not None for space in spaces):
        return SIZES[0], SIZES[0], 0.0
    table = np.concatenate([space.rows for space in spaces]).view(STROKE_DTYPE)
    radius2, flat, sigmas = table["radius2"][..., 0], table["flat"], axes[:, :2, 2] / axes[:, :2, 3]
    rims = np.cbrt(0.25 * radius2 * np.where(flat > 0, flat, np.inf))  # at rims of plateaus, strokes vary over these
    lengths = np.sqrt(radius2), rims, table["reach"] / 3  # over which strokes vary
    width = min(each.min(initial=np.inf) for each in lengths) / axes[:, :2, 3].max()
    widths = min(width, sigmas.min(initial=np.inf, where=sigmas > 0)), width
    near, far = (max([SIZES[0], *(h for h in SIZES if 0.15 * h**4 <= tolerance * each**3)]) for each in widths)
    moved = np.where(table["power"] == 1, np.linalg.norm(table["force"], axis=-1), np.inf)  # by drags: brushes turn
    return near, far if (axes == axes[0]).all() else near, moved.max(initial=0.0)


def positions(
    first: int, n: int, axis: npt.NDArray[np.float64], near: int, far: int, moved: float
) -> npt.NDArray[np.int32]:
    """Return the positions of nodes along an axis of ``n`` samples from the ``first`` on.

    ``axis`` is the row of the packed domain. Nodes are at most ``near`` apart in the border and as far beyond as its
    end may be ``moved``, and ``far`` elsewhere. The border's factor has a kink where it reaches 1; nodes there keep
    cells from crossing it.
    """
    if n == 1:  # a single sample gets a cell, too, which extends beyond the plane
        return np.array([first, first + 1], np.int32)
    low, high, sigma, spacing = axis[:4]
    end = first + n - 1
    ends, inner = {first, end}, (first, end)
    if sigma > 0:
        low, high, moved = ((k + by) / spacing for k, by in ((low, sigma), (high, -sigma), (0.0, moved)))
        inner = round(min(low + moved, high)), round(max(high - moved, low))
        ends |= {k for k in (round(low), round(high), *inner) if first < k < end}
    parts = [np.arange(a, b, far if inner[0] <= a < inner[1] else near) for a, b in itertools.pairwise(sorted(ends))]
    return np.concatenate([*parts, [end]]).astype(np.int32)


def _is_small(samples: Samples, *sizes: int) -> bool:
    """Return whether all samples of so many planes, rows, columns and channels lie within 2³¹ of the first."""
    return sum(abs(step) * (n - 1) for step, n in zip(samples[1:], sizes, strict=True)) < 1 << 31


def lattice_of(gpu: CudaDevice, spaces: tuple[Space, ...], tolerance: float = 0.01) -> Lattice:
    """Return the maps of deformations of one shape on a GPU, the current device; the most recent ones stay there."""
    key = (gpu.number, tolerance, spaces)
    with _lock:
        found = _lattices.get(key)
        if found is None:
            found = _lattices[key] = _uploaded(gpu, spaces, tolerance)
            while len(_lattices) > _KEPT:
                _lattices.popitem(last=False)
        _lattices.move_to_end(key)
    return found


def _uploaded(gpu: CudaDevice, spaces: tuple[Space, ...], tolerance: float) -> Lattice:
    for each in spaces:
        refuse_mattes(each, "CUDA")
    stream = gpu.stream()  # it does not wait for other work of the GPU
    maps = [space.map for space in spaces]
    memory = Memory(len(_core.flatten(maps, 0)), stream)
    packed = np.frombuffer(_core.flatten(maps, memory.pointer), np.uint8)
    memory.upload(packed)
    one, axes = spaces[0], np.concatenate([space.axes for space in spaces]).reshape(len(spaces), 3, -1)
    # Different borders get no nodes at their ends: cells across them are rough.
    borders = axes[0] if (axes == axes[0]).all() else np.full_like(axes[0], -1.0)
    sizes = sizes_of(spaces, axes, tolerance)
    first = (0, 0) if one.grid is None else one.grid.first[:2]
    xs, ys = (positions(first[k], n, borders[k], *sizes) for k, n in enumerate(one.planes[:0:-1]))
    places = Memory(4 * (xs.size + ys.size), stream)
    at = np.concatenate([xs, ys])
    places.upload(at)
    stream.synchronize()  # the arrays have been read; any stream may now read the copies
    kinds = {each.composite is not None for each in spaces}
    return Lattice(memory, places, (xs.size, ys.size), kinds.pop() if len(kinds) == 1 else None)


class Checks:
    """The error and the counts of a map, which kernels write on the GPU, and their copy on the host."""

    def __init__(self, stream: Stream) -> None:
        self.there = Memory(CHECKS.itemsize, stream)
        self.there.clear()
        self.kept: list[Array] = []  # arrays that are being copied to the GPU
        self._here: Pinned | None = None
        self._said: tuple[Any, ...] = ()

    def send(self) -> None:
        """Copy them to the host, asynchronously."""
        try:  # page-locked memory is reused, as allocating it is slow
            self._here = _spare.pop()
        except IndexError:
            self._here = Pinned(CHECKS.itemsize)
        self.there.download(self._here.bytes)

    def certificate(self, space: Space) -> Certificate:
        """Return the certificate; the copy must be complete."""
        with _lock:
            if self._here is not None:
                self._said = self._here.bytes.view(CHECKS)[0].item()
                _spare.append(self._here)
                self._here = None
        worst, _rough, *counts = self._said
        return Certificate(np.inf if counts[0] else worst, 0.0, *(() if space.composite is None else counts))


def paint(
    gpu: CudaDevice,
    spaces: tuple[Space, ...],
    dtype: np.dtype[Any],
    checks: Checks,
    source: Samples,
    out: Samples,
    planes: tuple[int, int],
    *,
    together: int = 1,
    filter: int = MAP,
    slab: int | None = None,
    **values: Any,
) -> Lattice:
    """Launch the kernels for planes from, to on the stream of ``checks``, slab by slab.

    There is one map, or one for each plane; images with one map share its nodes, and slices have nodes of their own.
    ``source`` and ``out`` begin with the first frame in memory, and with the first of the planes. ``together`` and
    ``filter`` are those of `Program`, and ``values`` other fields of the job. A launch has at most ``slab`` planes; by
    default, as many as scratch memory has room for. The returned lattice must be kept alive until the kernels are done.
    """
    stream, lattice, space = checks.there.stream, lattice_of(gpu, spaces, values["tolerance"]), spaces[0]
    n, composed = space.ndim, lattice.composed
    sample, number = _TYPES[dtype.str[1:]]
    way = {name: int(values.get(name, 0)) for name in ("between", "average", "light")}
    wanted = [Program("nodes", n, composed), Program("cells", n, composed)]
    (_, height, width), frames = space.planes, int(values.get("count", 1)) if n == 3 else planes[1]
    channels = int(values.get("channels", n))
    small = _is_small(out, planes[1] - planes[0], height, width, channels) and _is_small(
        source, frames, int(values.get("h", 1)), int(values.get("w", 1)), channels
    )
    way |= {
        "small": small,
        "packed": channels * (filter != MAP and channels <= 4 and source[3:] in ((channels, 1), (1, 0))),
    }
    wanted += [Program(unit, n, composed, sample, number, together, filter, **way) for unit in ("fill", "rough")]
    nodes, cells, fill, rough = [prepare(gpu, program) for program in wanted]  # all, before the first is waited for
    nx, ny = lattice.nodes
    first_x, first_y, *depth = (0, 0) if space.grid is None else space.grid.first
    each, shared = (nx - 1) * (ny - 1), n == 2 and len(spaces) == 1
    records = {"nodes": (nx * ny, _NODE[n]), "leaves": (each, _LEAF[n]), "states": (each, 4), "rough": (each, 4)}
    room = max(1, min(SCRATCH // sum(many * size for many, size in records.values()), _MOST))
    all_planes = planes[1] - planes[0]
    solved = 1 if shared else min(all_planes, room, slab or room)
    most = min(all_planes, _MOST) if shared else solved
    sizes = {name: -(-solved * many // 32) * 32 * size for name, (many, size) in records.items()}
    scratch = Memory(sum(sizes.values()), stream)
    starts = itertools.accumulate(sizes.values(), initial=scratch.pointer)
    values |= dict(zip(sizes, starts, strict=False))
    xs = lattice.places.pointer
    for start in range(*planes, most):
        count = min(most, planes[1] - start)
        many, own = 1 if shared else count, sum(depth) + start
        first = out[0] + (start - planes[0]) * out[1] * dtype.itemsize
        job = record(JOB, **values, source=source, out=(first, *out[1:]), checks=checks.there.pointer, planes=many,
                     first=own, shared=count if shared else 0, maps=lattice.memory.pointer,
                     map_count=len(spaces), xs=xs, ys=xs + 4 * nx, nx=nx, ny=ny, from_x=first_x, from_y=first_y,
                     height=height, width=width)  # fmt: skip
        launch(nodes, job, stream, (-(-(own + many) // RUN[n]) - own // RUN[n]) * nx * ny)
        launch(cells, job, stream, many * each)
        launch(fill, job, stream, width, ny - 1, count)
        launch(rough, job, stream, THREADS * min(many * each, _BLOCKS))
    return lattice


def warp(
    gpu: CudaDevice,
    work: Work,
    dtype: np.dtype[Any],
    checks: Checks,
    source: Samples,
    out: Samples,
    planes: tuple[int, int],
    *,
    slab: int | None = None,
    held_from: int = 0,
) -> Lattice:
    """Launch the kernels for a job, as `paint` does; ``dtype`` is that of samples, ``held_from`` the first frame."""
    space, sampling, group = work.space, work.sampling, work.layout.groups[0]
    if sampling.filter == "labels":
        refuse("filter", '"auto", "cubic", "linear" or "nearest" on a CUDA device', sampling.filter)
    nearest = sampling.filter == "nearest"
    timed = space.ndim == 3 and not nearest  # a plane of nearest samples, or of an image, reads one frame
    pointer = 0
    if sampling.outside == "constant":
        fill = np.full(group.channels, sampling.fill)
        held = Memory(fill.nbytes, checks.there.stream)
        held.upload(fill)
        checks.kept.append(fill)
        pointer = held.pointer
    white = 1.0 if dtype == np.bool_ else work.layout.white
    high = min(white, int(np.iinfo(dtype).max)) if dtype.kind in "iu" else white
    return paint(
        gpu, work.spaces, dtype, checks, source, out, planes, slab=slab,
        together=group.channels if group.channels in (1, 3) and not group.alpha else 4,
        filter=FILTERS[sampling.filter],
        tolerance=sampling.tolerance,
        fill=pointer, white=white, high=high, top=int(high),
        w=space.shape[1], h=space.shape[0], count=space.count if space.ndim == 3 else 1,
        held_from=held_from, channels=group.channels,
        between=BETWEEN[sampling.between_frames] if timed else 0,
        rule=OUTSIDE[sampling.outside],
        average=timed and sampling.averages_frames,
        alpha=group.channels - 1 if group.alpha and not nearest else -1,
        light=sampling.linear_light and not nearest,
    )  # fmt: skip
