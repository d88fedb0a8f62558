"""Host arrays, warped on a GPU in slabs, through a ring of frames: they need not fit its memory.

A slab is a range of planes of the result. The frames that it may need, by the nodes of its lattice, are sent into the
ring, in place of frames that are no longer needed; while its kernels run, the slab before is copied back, and the
frames of the next one follow. A slab that lacked frames is computed again, with more of them.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.base import Certificate, Sampling, Space, Steps, Work
from supple.engines.cuda.arrays import taken
from supple.engines.cuda.device import CudaDevice, failures
from supple.engines.cuda.lattice import LIST, MISSING, NODE
from supple.engines.cuda.needs import Needs, needs_of
from supple.engines.cuda.ring import Ring, recorded
from supple.engines.cuda.sample import FIRST, LAST
from supple.engines.cuda.staging import Lane, pieces
from supple.engines.cuda.warp import (
    SCRATCH,
    Colours,
    Frames,
    Lattice,
    Pieces,
    certificate_of,
    colours_of,
    lattice_of,
    make_planes,
)

Array = npt.NDArray[Any]
Range = tuple[int, int]

SLAB = 64 << 20  # bytes of a slab's planes, about
SLABS = 8  # the least number for a small array: while one is copied, another is computed
ROOM = 0.8  # the fraction of free memory to use

_working = threading.RLock()  # one thread at a time measures and takes free memory


def warp_host(gpu: CudaDevice, source: Array, target: Array, work: Work, *, room: int | None = None) -> Steps:
    """Warp an image, or a stack of frames, in host memory or mapped to it.

    Parameters
    ----------
    gpu : CudaDevice
        The GPU.
    source, target : array, shape (frames, H, W, C)
        Of bool, integers or floats of 16 to 64 bits, in any byte order, with any strides; not overlapping.
    work : Work
        The deformation and the sampling options.
    room : int, optional
        The bytes of GPU memory to use; by default, most of the free memory.

    Yields
    ------
    int, Certificate
        The number of finished planes, and the accuracy of the map of those finished since the last step.

    Raises
    ------
    MemoryError
        If a plane, and the frames that it needs, exceed the memory.
    """
    moved = reached(work.space)
    for z in np.flatnonzero(~moved):
        target[z] = source[z]
    if not moved.all():
        yield int((~moved).sum()), Certificate(0.0, 0.0)
    if not moved.any():
        return
    with _working, gpu.current():
        most = int(ROOM * gpu.free) if room is None else room
        with _opened(gpu, source, target, work, most) as job:
            yield from job.run(moved)


def reached(space: Space) -> npt.NDArray[np.bool_]:
    """Return the mask of the planes that intersect the ball of a stroke: the others are unchanged."""
    z = np.arange(space.count) * space.axes[2, 3]
    apart = np.abs(z[:, None] - space.table["pivot"][:, 2])
    return np.asarray((apart < space.table["reach"]).any(axis=1))


def slabs_of(planes: npt.NDArray[np.bool_], most: int) -> Iterator[Range]:
    """Yield the ranges of marked planes, from and to, no longer than ``most``."""
    edges = np.flatnonzero(np.diff(planes, prepend=False, append=False))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield from itertools.pairwise([*range(first, last, most), last])


@dataclass(frozen=True, slots=True)
class Plan:
    """The division of a GPU's memory.

    Parameters
    ----------
    planes : int
        The planes of a slab.
    slots : int
        The number of frames in the ring.
    turns : int
        The number of slabs in memory: while one is copied back, the next is computed.
    """

    planes: int
    slots: int
    turns: int


def planned(count: int, frame: int, scratch: int, room: int) -> Plan:
    """Divide the memory.

    Parameters
    ----------
    count : int
        The number of frames.
    frame, scratch : int
        The bytes of a frame, and of the other data of a plane.
    room : int
        The bytes available.

    Raises
    ------
    MemoryError
        If there is no room for a single slab.
    """
    turns = 1 if count == 1 else 2
    each = turns * frame + scratch
    planes = max(1, min(SLAB // frame, -(-count // SLABS), SCRATCH // scratch, room // 4 // each))
    slots = min(count, (room - planes * each) // frame)
    if slots < 1:
        raise MemoryError(f"a frame of {_said(frame)} is more than fits into {_said(room)} of its memory")
    return Plan(planes, slots, turns)


def _said(size: int) -> str:
    return f"{size / 1e9:.2g} GB" if size >= 1e8 else f"{size / 1e6:.2g} MB"


@dataclass(frozen=True, slots=True, eq=False)
class _Slab:
    """Planes in progress: their range, their number as work, and their event."""

    planes: Range
    number: int
    made: Any


@dataclass(slots=True, eq=False)
class _Job:
    """A warp, and its resources on the GPU."""

    gpu: CudaDevice
    target: Array
    sampling: Sampling
    plan: Plan
    lattice: Lattice
    colours: Colours
    pieces: Pieces
    ring: Ring
    slabs: list[Any]
    down: Lane
    stream: Any
    told: list[tuple[Array, Array]]
    needs: Needs | None = None
    begun: int = 0

    def run(self, planes: npt.NDArray[np.bool_]) -> Iterator[tuple[int, Certificate]]:
        """Compute the marked planes; yield the number of finished ones, and the accuracy of the last."""
        count = len(self.target)
        if count > 1:
            self.needs = needs_of(self.stream, self.lattice, self.pieces, count, self.sampling, self.colours.how)
        todo = deque(slabs_of(planes, self.plan.planes))
        before: _Slab | None = None
        done = int((~planes).sum())
        while todo or before:
            slab = self._begin(todo) if todo else None
            known = self._finished(before) if before else None
            if before and known:
                done += before.planes[1] - before.planes[0]
                yield done, known
            elif before and self.needs:
                self.needs.more = 2 * self.needs.more + 1
                todo.appendleft(before.planes)
            before = slab

    def _begin(self, todo: deque[Range]) -> _Slab:
        """Launch the next planes, as many as the ring has frames for."""
        first, last = todo.popleft()
        low, high = self._needed((first, last))
        while high - low > self.plan.slots:
            if last - first == 1:
                raise MemoryError(f"a plane is made of {high - low} frames, and there is room for {self.plan.slots}")
            middle = (first + last) // 2
            todo.appendleft((middle, last))
            last = middle
            low, high = self._needed((first, last))
        source = self.ring.send(low, high, self.stream)
        turn = self.begun % self.plan.turns
        _, height, width, _ = self.target.shape
        out = Frames(self.slabs[turn], (*source.places[:FIRST], 0, self.plan.planes, 0, self.plan.planes))
        make_planes(
            self.gpu, self.stream, self.lattice, self.pieces, self.colours, (height, width), (first, last), source,
            out, tolerance=self.sampling.tolerance,
        )  # fmt: skip
        told, counts = self.told[turn]
        self.pieces.told.copy_to_host(told, stream=self.stream)
        self.pieces.counted.copy_to_host(counts, stream=self.stream)
        slab = _Slab((first, last), self.begun, recorded(self.stream))
        self.ring.read_by(slab.number, (source.places[FIRST], source.places[LAST]), slab.made)
        self.begun += 1
        return slab

    def _needed(self, planes: Range) -> Range:
        return self.needs.of(planes) if self.needs else (0, 1)

    def _finished(self, slab: _Slab) -> Certificate | None:
        """Copy planes back, and return their accuracy; None if frames were missing."""
        slab.made.synchronize()
        self.ring.forget(slab.number)
        turn = slab.number % self.plan.turns
        told, counts = self.told[turn]
        if counts[MISSING]:
            return None
        self.down.down(self._parts(slab.planes, self.slabs[turn]))
        return certificate_of(told, counts)

    def _parts(self, planes: Range, made: Any) -> Iterator[tuple[Any, Array]]:
        rows, width = self.down.shape
        for frames, part in pieces(planes, (rows, width), self.down.most):
            target = self.target[frames, part]
            start = ((frames.start - planes[0]) * rows + part.start) * width
            yield made[start : start + target.size], target


@contextlib.contextmanager
def _opened(gpu: CudaDevice, source: Array, target: Array, work: Work, room: int) -> Iterator[_Job]:
    """Open the resources of a warp on the GPU; all work has ended on exit."""
    from numba import cuda

    count, height, width, channels = source.shape
    dtype = source.dtype.newbyteorder("=")
    kind = np.dtype(np.uint8) if dtype == np.bool_ else dtype
    size = height * width * channels
    lattice = lattice_of(gpu, (work.space,))
    plan = planned(count, size * kind.itemsize, lattice.nodes * NODE * 4 + lattice.cell_count * 8, room)
    colours = colours_of(gpu, dtype, work, count)
    streams: list[Any] = []
    try:
        frames = cuda.device_array(plan.slots * size, kind)
        slabs = [cuda.device_array(plan.planes * size, kind) for _ in range(plan.turns)]
        pieces_ = Pieces(taken(frames, "the frames"), [lattice], plan.planes)
        up, down = (Lane(dtype, (height, width * channels)) for _ in range(2))
        streams += [up.stream, down.stream, cuda.stream()]
        told = [(cuda.pinned_array(1, np.float32), cuda.pinned_array(LIST, np.int32)) for _ in range(plan.turns)]
        ring = Ring(source, frames, plan.slots, up)
        yield _Job(gpu, target, work.sampling, plan, lattice, colours, pieces_, ring, slabs, down, streams[-1], told)
    finally:
        for stream in streams:  # until then, copies write to memory that is about to be freed
            with contextlib.suppress(*failures()):
                stream.synchronize()
