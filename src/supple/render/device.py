"""The GPU resources of a scene: its volume, the lattice of T⁻¹, and the buffer of the deformed volume."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from supple._core.rows import STROKE_DTYPE
from supple.engine.devices import CPU, note
from supple.engine.work import Array, Mattes, Space, shown_mask
from supple.errors import DeviceWarning
from supple.gpu.device import Gpu, failures, trouble
from supple.gpu.field import fits
from supple.gpu.raymarch import Held, prepare
from supple.gpu.shader import EXACT, LATTICE, PLAIN
from supple.gpu.solid import Filling, Lattice, Volume, beside, hold, hold_strokes, solve

T = TypeVar("T")

COARSEST, FINEST = 8, 2  # voxels from node to node: a finer lattice would be larger than the volume
# The largest size of a cell, as a fraction of the length scale of the map: in larger cells, the checked points do not
# represent the points between them.
RESOLVED = 0.5
_TWICE, _ONCE = 3.0, 1.25  # measured errors of cubics over two cells and over one, relative to the lattice's


def tried(gpu: Gpu, work: Callable[[], T], stacklevel: int, says: str = "the CPU does what {} cannot") -> T | None:
    """Return the result of some work on a GPU; on failure, warn with a DeviceWarning and return None."""
    try:
        with gpu.lock:
            done = work()
        note(gpu.name)
        return done
    except failures() as error:
        failed = trouble(gpu, error)
    note(CPU)
    warnings.warn(f"{says.format(gpu.name)}: {failed}", DeviceWarning, stacklevel=stacklevel + 1)
    return None


def held_scene(
    gpu: Gpu,
    samples: Array,
    spacing: tuple[float, ...],
    space: Space | None,
    mode: str,
    tolerance: float,
    labelled: bool = False,
    colours: Array | None = None,
    volume: Volume | None = None,
) -> Held:
    """Upload a scene to a GPU, unless the same samples and colours are there as ``volume``.

    Samples are those of `supple.render.appearance.prepared`, and colours (Z, H, W, 4); the spacing and the tolerance
    are in millimetres and voxels. Raises one of `supple.gpu.device.failures`.
    """
    if space is not None and not fits(space.table):
        raise ArithmeticError("strokes of such sizes are beyond its numbers")
    if space is not None and isinstance(space.freeze, Mattes):
        raise ArithmeticError("its shaders take one mask for all strokes, and these have mattes")
    if colours is not None and mode == "buffered" and space is not None:
        raise MemoryError("it has no room for a buffer of colours")
    twice = (mode == "hybrid" and colours is None) or (mode == "buffered" and space is not None)
    if volume is None:
        volume = hold(gpu, samples, labelled, colours)
    if twice and not beside(volume):
        if mode == "buffered":
            raise MemoryError("it has no memory left for a deformed volume")
        twice = False  # a lattice without a buffer
    if space is None:
        still = np.zeros((3, 5))  # a domain without displacement
        still[:, 1], still[:, 3] = 1.0, spacing
        return Held(volume, hold_strokes(gpu, np.zeros(0, STROKE_DTYPE), still), PLAIN)
    if mode == "exact":
        return Held(volume, hold_strokes(gpu, space.table, space.axes, shown_mask(space.freeze)), EXACT)
    lattice = lattice_of(gpu, space, tolerance)
    cells = 2 if _TWICE * lattice.error <= tolerance else 1  # that a cubic along a ray may span
    if not twice:
        return Held(volume, lattice, LATTICE, cells)
    filling = Filling(volume, lattice, polished=lattice.error > tolerance, tolerance=tolerance)
    held = Held(volume, lattice, LATTICE, cells, filling, whole=mode == "buffered")
    if mode == "buffered":
        filling.advance()
    else:
        prepare(held, filling)
    return held


def lattice_of(gpu: Gpu, space: Space, tolerance: float) -> Lattice:
    """Return a lattice as fine as the tolerance, in voxels, requires, or memory allows, with its ``error``."""
    found: Lattice | None = None
    shape, step = (space.count, *space.shape), COARSEST
    try:
        while True:
            found = solve(gpu, space.table, space.axes, shape, step, shown_mask(space.freeze))
            resolved = step <= RESOLVED * found.smooth
            if (found.error <= tolerance and resolved) or step == FINEST:
                break
            # The error falls with the cube of the step.
            finer = step * (tolerance / max(found.error, tolerance)) ** (1 / 3)
            finer = min(finer, max(RESOLVED * found.smooth, FINEST))
            step = max(FINEST, min(step // 2, 2 ** math.floor(math.log2(max(finer, 1.0)))))
    except MemoryError:
        if found is None:
            raise
        with contextlib.suppress(MemoryError):  # try the steps that were skipped
            while found.step > FINEST:
                found = solve(gpu, space.table, space.axes, shape, found.step // 2, shown_mask(space.freeze))
    return found if found.step <= RESOLVED * found.smooth else replace(found, error=math.inf)


def along_rays(lattice: Lattice, cells: int, tolerance: float) -> float:
    """Return the error, in voxels, of source points on cubics along rays, each over ``cells`` cells of a lattice."""
    if cells == 2:
        return _TWICE * lattice.error
    # If the lattice is accurate enough, its reserve covers the additional error.
    return min(_ONCE * lattice.error, tolerance if lattice.error <= tolerance else math.inf)
