"""Images and stacks of frames, warped by the GPU in parts that fit its memory and its time limit."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from supple.engines.base import LONGEST, Space
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.field import reached
from supple.engines.wgpu.kernel import Array, download, owned, room
from supple.engines.wgpu.lattice import NODE, SETTINGS, Lattice, Part, Range, Strokes, lattice_on, pitch_of, strokes_on
from supple.engines.wgpu.planes import Held, colour, target_size, unpacked
from supple.engines.wgpu.pyramid import pyramid, size_of
from supple.engines.wgpu.reach import Reach, box_of, reach_of
from supple.engines.wgpu.samples import GpuGroup
from supple.engines.wgpu.texels import MOST_LAYERS, SIDE, blocks_of, layers, texels_of

TOGETHER = 16  # planes
AT_FIRST = float(1 << 28)  # samples read at once in the first part
EVALUATED = 40.0  # samples that could be read in the time of one stroke of a solved point
SECONDS = 0.5  # the intended time of one part


@dataclass(slots=True, eq=False)
class _Work:
    """The buffers on the device during a warp."""

    strokes: Strokes
    picture: GpuGroup
    frames: int
    first: int  # the first plane
    there: Range
    source: Array
    target: Array
    box: tuple[Range, Range] | None = None
    held: Held | None = None
    lattice: Lattice | None = None
    limit: float = AT_FIRST
    solving: float = 0.0  # evaluations of a stroke for each sample, on average, in cells that are too coarse
    more: float = 0.0  # rows and frames beyond the bounds of the nodes: between them, the map may reach farther
    worst: float = 0.0
    lost: int = 0
    of_source: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    of_lattice: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    @property
    def gpu(self) -> Gpu:
        return self.strokes.gpu

    def close(self) -> None:
        self.of_source.close()
        self.of_lattice.close()

    def solve(self, part: Part) -> Lattice:
        """Return the lattice of a part, solved unless it is already there."""
        lattice = self.lattice
        if lattice is None or (lattice.part.count, lattice.part.tall) != (part.count, part.tall):
            self.of_lattice.close()
            lattice = self.lattice = lattice_on(self.of_lattice, self.strokes, part)
        if lattice.solved != part:
            lattice.solve(part, self.picture.wanted.tolerance)
        return lattice

    def hold(self, frames: Range, rows: Range) -> Held:
        """Return some rows of some frames, on the device."""
        if self.held is None or self.box != (frames, rows):
            self.of_source.close()
            self.box, self.held = None, None
            form, count = self.picture.format, frames[1] - frames[0]
            size = rows[1] - rows[0], self.picture.shape[1]
            samples, levels = owned(
                self.of_source,
                layers(self.gpu, size, count, form.dtype, form.channels),
                pyramid(self.gpu, self.picture, rows, count),
            )
            for k, frame in enumerate(range(*frames)):
                samples.put(self.gpu, k, form.packed(self.source[frame % len(self.source), slice(*rows)]), wait=True)
                levels.build(samples, k)
            self.box, self.held = (frames, rows), Held(samples, levels, frames, rows, count, 0)
        return self.held

    def fits(self, frames: Range, rows: Range) -> bool:
        """Return whether some rows of some frames fit the device at once."""
        count, shape = frames[1] - frames[0], (rows[1] - rows[0], self.picture.shape[1])
        size = count * texels_of(shape) * self.picture.format.size
        if count * size_of(self.picture, rows) > self.gpu.binding:
            return False
        return size <= self.gpu.texture and count * math.prod(blocks_of(shape)) <= MOST_LAYERS

    def samples_read(self, part: Part, reach: Reach, at: tuple[slice, slice]) -> float:
        """Return an estimate of the source samples read for a part; evaluations of strokes count as samples."""
        wanted = self.picture.wanted
        each = {"nearest": 1.0, "linear": 4.0, "cubic": 16.0}.get(wanted.filter, 16.0 * float(reach.work[at].mean()))
        if wanted.between in ("linear", "cubic"):
            each *= {"linear": 2.0, "cubic": 4.0}[wanted.between]
            each *= 1.0 + (min(float(reach.long[at].mean()), LONGEST) if wanted.average else 0.0)
        return (each + self.solving) * part.count * part.tall * self.picture.rows * self.picture.shape[1]

    def copy(self, z: int) -> None:
        """Copy an unchanged frame."""
        self.target[z - self.first] = self.source[z % len(self.source)]

    def make_planes(self, part: Part) -> None:
        """Solve the lattice of a part and compute its planes; unchanged frames are copied."""
        wanted, (first, last) = self.picture.wanted, part.planes
        lattice = self.solve(part)
        reach = reach_of(lattice.nodes(), first, part.cells[0], self.picture.step)
        rough = lattice.rough()
        self.solving = EVALUATED * float(rough.mean()) * self.strokes.count
        # Nodes do not bound the map within a cell that is too coarse.
        moves = (reach.moved.max(axis=1) * 3**0.5 > wanted.tolerance) | rough.any(axis=(1, 2))
        still = np.flatnonzero(~moves) + first
        if wanted.between == "nothing" or part.tall < self.strokes.cells[1]:
            still = still[:0]
        for z in still:
            self.copy(int(z))
        for planes in _stretches(first, last, still):
            self.make(Part(planes, part.cells), reach, part)

    def make(self, part: Part, reach: Reach, known: Part) -> None:
        """Compute a part with known bounds."""
        whole = self.there, (0, self.picture.shape[0])
        at = (
            slice(part.planes[0] - known.planes[0], part.planes[1] - known.planes[0]),
            slice(part.cells[0] - known.cells[0], part.cells[1] - known.cells[0]),
        )
        box = whole
        if not self.fits(*whole):
            (low, high), box_rows = box_of(reach, *at, self.picture, self.frames, self.more)
            low = min(max(low, self.there[0]), self.there[1] - 1)
            box = (low, max(min(high, self.there[1]), low + 1)), box_rows
        rows = part.tall * self.picture.rows + 1
        fits = self.fits(*box) and part.count * target_size(self.picture, rows) <= self.gpu.binding
        work = self.samples_read(part, reach, at)
        if not fits or work > self.limit:
            halves = _halves(part)
            for half in halves:
                self.make(half, reach, known)
            if halves:
                return
            if not fits:
                raise MemoryError("what a few rows are made of is more than a shader takes")
        held = self.hold(*box)
        lattice = self.solve(part)
        with contextlib.ExitStack() as stack:
            told, target = owned(
                stack,
                self.gpu.device.create_buffer(size=SETTINGS.itemsize, usage="UNIFORM|COPY_DST"),
                room(self.gpu, part.count * target_size(self.picture, rows)),
            )
            begun = time.perf_counter()
            top, end = colour(lattice, self.picture, self.frames, held, told, target)
            words = download(self.gpu, target, np.uint32, part.count * target_size(self.picture, end - top) // 4)
            self._paced(work, time.perf_counter() - begun)
            said = download(self.gpu, lattice.stats, np.uint32, 4)
        if said[3]:
            if box == whole:
                raise ArithmeticError("a point lies far outside what was foreseen")
            self.more, lattice.solved = 2 * self.more + 1, None  # counted once only
            self.make(part, reach, known)
            return
        self.worst, self.lost = max(self.worst, float(said[:1].view(np.float32)[0])), self.lost + int(said[1])
        planes = slice(part.planes[0] - self.first, part.planes[1] - self.first)
        self.picture.store(unpacked(self.picture, words, part.count, end - top), self.target[planes, top:end])

    def _paced(self, work: float, seconds: float) -> None:
        """Adapt the size of the next part to the time of this one; the first may include compilation."""
        wanted = work * SECONDS / max(seconds, 1e-4)
        self.limit = min(max(wanted, self.limit / 4), self.limit * 4, 64 * AT_FIRST)


def _halves(part: Part) -> Sequence[Part]:
    (z0, z1), (y0, y1) = part.planes, part.cells
    if z1 - z0 > 1:
        return Part((z0, (z0 + z1) // 2), part.cells), Part(((z0 + z1) // 2, z1), part.cells)
    if y1 - y0 > 1:
        return Part(part.planes, (y0, (y0 + y1) // 2)), Part(part.planes, ((y0 + y1) // 2, y1))
    return ()


def warp(
    gpu: Gpu,
    space: Space,
    picture: GpuGroup,
    source: Array,
    target: Array,
    planes: Range,
    *,
    there: Range | None = None,
    step: tuple[int, int] = (1, 1),
) -> Generator[tuple[int, float, int], None, None]:
    """Warp some planes of a stack of frames; an image is a stack of one frame.

    Parameters
    ----------
    gpu : Gpu
    space : Space
    picture : GpuGroup
        The group of samples to compute; each plane's are a part of ``space.shape``.
    source : array, shape (slots, rows, samples, channels)
        Frame k is in slot k modulo the number of slots.
    target : array, shape (planes, rows, samples, channels)
        The destination of the planes.
    planes : (int, int)
        The range of planes: from, to.
    there : (int, int), optional
        The range of frames that can be read, if not all: from, to.
    step : (int, int)
        The step of the coarsest samples of a frame, in pixels.

    Yields
    ------
    int, float, int
        The number of finished planes, the largest error of their source points, in pixels, and the number of points
        that may not meet the tolerance.

    Raises
    ------
    MemoryError
        If the data of a few rows exceed the largest binding.
    ArithmeticError
        If points could not be solved, or lie in frames that cannot be read.
    """
    frames = space.count if space.ndim == 3 else 1
    with contextlib.ExitStack() as stack:
        strokes = strokes_on(stack, gpu, space.table, space.axes, space.freeze, space.shape, step)
        work = _Work(strokes, picture, frames, planes[0], there or (0, frames), source, target)
        stack.callback(work.close)
        across, down = strokes.cells
        # Solving a node takes about 25 evaluations of every stroke.
        most = int(min(gpu.binding // NODE, 8 * AT_FIRST / (25 * max(strokes.count, 1)))) // pitch_of(across + 1)
        if most < 2:
            raise MemoryError("a picture of this width is more than a shader takes")
        tall = min(down, most - 1, SIDE - 1)
        together = max(1, min(TOGETHER, most // (tall + 1)))
        done = planes[0]
        passed = np.flatnonzero(~reached(space.table, space.axes, planes)) + planes[0]
        if picture.wanted.between == "nothing":
            passed = passed[:0]
        for run in [*_stretches(*planes, passed), (planes[1], planes[1])]:
            for z in range(done, run[0]):  # unchanged frames
                work.copy(z)
            yield run[0] - planes[0], work.worst, work.lost
            for first in range(*run, together):
                last = min(first + together, run[1])
                for top in range(0, down, tall):
                    work.make_planes(Part((first, last), (top, min(top + tall, down))))
                yield last - planes[0], work.worst, work.lost
            done = run[1]


def _stretches(first: int, last: int, without: npt.NDArray[np.intp]) -> list[Range]:
    """Return the ranges between some planes."""
    edges = [first - 1, *(int(z) for z in without), last]
    return [(a + 1, b) for a, b in itertools.pairwise(edges) if b > a + 1]
