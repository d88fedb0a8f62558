"""Clips on the GPU: a ring of source frames, and planes that are begun ahead."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.engines.base import Space
from supple.engines.wgpu.device import LIMITS, Gpu
from supple.engines.wgpu.kernel import Array, owned, room, unsolved
from supple.engines.wgpu.lattice import NODE, SETTINGS, Lattice, Part, Strokes, lattice_on, pitch_of, strokes_on
from supple.engines.wgpu.planes import Held, colour, target_size, unpacked
from supple.engines.wgpu.pyramid import Pyramid, pyramid, size_of
from supple.engines.wgpu.samples import GpuGroup
from supple.engines.wgpu.texels import MOST_LAYERS, SIDE, Layers, blocks_of, layers, texels_of
from supple.engines.wgpu.warp import AT_FIRST, SECONDS


@dataclass(slots=True, eq=False)
class Ring:
    """The frames of one group of samples, in the slots of the window."""

    gpu: Gpu
    picture: GpuGroup
    window: Array
    samples: Layers
    pyramid: Pyramid
    there: list[int]

    def take(self, frame: int) -> None:
        """Upload a frame if it is missing."""
        slot = frame % len(self.there)
        if self.there[slot] == frame:
            return
        self.samples.put(self.gpu, slot, self.picture.format.packed(self.window[slot]))
        self.pyramid.build(self.samples, slot)
        self.there[slot] = frame


@dataclass(slots=True, eq=False)
class _Set:
    """The working set of one plane: its lattice, and buffers for its samples on the device and the host."""

    lattice: Lattice
    told: tuple[Any, ...]
    targets: tuple[Any, ...]
    copy: Any
    sizes: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Begun:
    """A plane in progress."""

    room: _Set
    mapped: Any
    since: float


@dataclass(slots=True, eq=False)
class Clip:
    """A maker of the planes of a clip, with up to one plane in progress for each set."""

    strokes: Strokes
    rings: tuple[Ring, ...]
    sets: tuple[_Set, ...]
    frames: int
    timed: bool
    parts: int
    turn: int = 0

    def begin(self, z: int, low: int, high: int) -> _Begun:
        """Begin a plane that samples frames ``low`` to ``high`` of the clip, which are in the window."""
        gpu, use = self.strokes.gpu, self.sets[self.turn % len(self.sets)]
        self.turn += 1
        with gpu.lock:
            for ring in self.rings:
                for frame in range(low, high + 1):
                    ring.take(frame)
            at = z if self.timed else 0  # without time, one lattice for all planes
            part = Part((at, at + 1), (0, self.strokes.cells[1]))
            if use.lattice.solved != part:
                use.lattice.solve(part, self.rings[0].picture.wanted.tolerance)
            for ring, told, target in zip(self.rings, use.told, use.targets, strict=True):
                slots = len(ring.there)
                seen, shift = ((low, high + 1), low % slots) if self.timed else ((0, 1), z % slots)
                rows = (0, ring.picture.shape[0])
                held = Held(ring.samples, ring.pyramid, seen, rows, slots, shift)
                colour(use.lattice, ring.picture, self.frames if self.timed else 1, held, told, target, self.parts)
            encoder = gpu.device.create_command_encoder()
            at = 0
            for buffer, size in zip((*use.targets, use.lattice.stats), use.sizes, strict=True):
                encoder.copy_buffer_to_buffer(buffer, 0, use.copy, at, size)
                at += size
            gpu.device.queue.submit([encoder.finish()])
            # Mapped now, the buffer does not wait for work that is submitted later.
            return _Begun(use, use.copy.map_async("READ"), time.perf_counter())

    def finish(self, begun: _Begun, outs: Sequence[Array]) -> tuple[float, str]:
        """Write a plane's samples into one array for each group; return its error and a message on failures."""
        use = begun.room
        asked = time.perf_counter()
        begun.mapped.sync_wait()
        done = time.perf_counter()
        if done - asked > 1e-2:  # else it was done before, at an unknown time
            # The plane may have waited for the one before it.
            self.parts = min(max(self.parts, round(0.5 * (done - begun.since) / SECONDS)), self.strokes.cells[1])
        try:
            words = use.copy.read_mapped(copy=False)
            starts = [0, *np.cumsum(use.sizes).tolist()]
            said = np.frombuffer(words[starts[-2] : starts[-1]], np.uint32).copy()
            if not said[1] and not said[3]:
                for ring, start, size, out in zip(self.rings, starts, use.sizes, outs, strict=False):
                    rows = ring.picture.shape[0]
                    ring.picture.store(unpacked(ring.picture, words[start : start + size], 1, rows)[0], out)
        finally:
            use.copy.unmap()
        return float(said[:1].view(np.float32)[0]), unsolved(int(said[1])) or (
            "a point lies far outside what was foreseen" if said[3] else ""
        )


def fits_whole(gpu: Gpu, strokes: Strokes, pictures: Sequence[GpuGroup], slots: int) -> bool:
    """Return whether a window, the lattice of a plane and its samples each fit the largest binding."""
    nodes = NODE * pitch_of(strokes.cells[0] + 1) * (strokes.cells[1] + 1)
    made = [target_size(picture, picture.shape[0]) for picture in pictures]
    # All groups are copied back as one array.
    if max(nodes, *made) > gpu.binding or sum(made) + 16 > max(gpu.binding, LIMITS["max-buffer-size"]):
        return False
    if max(strokes.cells) >= SIDE:
        return False
    return all(
        slots * math.prod(blocks_of(picture.shape)) <= MOST_LAYERS
        and slots * texels_of(picture.shape) * picture.format.size <= gpu.texture
        and slots * size_of(picture, (0, picture.shape[0])) <= gpu.binding
        for picture in pictures
    )


@contextlib.contextmanager
def clip_on(
    gpu: Gpu,
    space: Space,
    step: tuple[int, int],
    pictures: Sequence[GpuGroup],
    windows: Sequence[Array],
    sets: int,
) -> Iterator[Clip | None]:
    """Open a maker of the planes of a clip; None if its window does not fit.

    Parameters
    ----------
    gpu : Gpu
    space : Space
    step : (int, int)
        The step of the coarsest samples of a frame, in pixels.
    pictures : sequence of GpuGroup
        The groups of samples of a frame.
    windows : sequence of arrays
        Frame k is in slot k modulo the number of slots: (slots, rows, samples, channels) for each group.
    sets : int
        The number of planes in progress.
    """
    with contextlib.ExitStack() as stack:
        strokes = strokes_on(stack, gpu, space.table, space.axes, space.freeze, space.shape, step)
        slots = len(windows[0])
        if not fits_whole(gpu, strokes, pictures, slots):
            yield None
            return
        part = Part((0, 1), (0, strokes.cells[1]))
        rings, rooms = [], []
        for picture, window in zip(pictures, windows, strict=True):
            form = picture.format
            samples, levels = owned(
                stack,
                layers(gpu, picture.shape, slots, form.dtype, form.channels),
                pyramid(gpu, picture, (0, picture.shape[0]), slots),
            )
            rings.append(Ring(gpu, picture, window, samples, levels, [-1] * slots))
        sizes = (*(target_size(picture, picture.shape[0]) for picture in pictures), 16)
        for _ in range(sets):
            told = owned(
                stack, *(gpu.device.create_buffer(size=SETTINGS.itemsize, usage="UNIFORM|COPY_DST") for _ in pictures)
            )
            targets = owned(stack, *(room(gpu, size) for size in sizes[:-1]))
            (copy,) = owned(stack, gpu.device.create_buffer(size=sum(sizes), usage="MAP_READ|COPY_DST"))
            rooms.append(_Set(lattice_on(stack, strokes, part), told, targets, copy, sizes))
        yield Clip(strokes, tuple(rings), tuple(rooms), space.count, space.ndim == 3, _parts(pictures))


def _parts(pictures: Sequence[GpuGroup]) -> int:
    """Return the initial number of parts of a plane, before its time is known."""
    texels = 0.0
    for picture in pictures:
        wanted = picture.wanted
        each = {"nearest": 1.0, "linear": 4.0, "cubic": 16.0}.get(wanted.filter, 64.0)
        each *= {"linear": 2.0, "cubic": 4.0}.get(wanted.between, 1.0) * (4.0 if wanted.average else 1.0)
        texels += each * math.prod(picture.shape)
    return max(1, round(texels / AT_FIRST))
