"""The GPU resources of a scene: its volume, its strokes, and the buffer of the deformed volume."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from supple._core.rows import STROKE_DTYPE
from supple.engine.devices import CPU, note
from supple.engine.work import Array, Mattes, Space, shown_mask
from supple.errors import DeviceWarning, warn
from supple.gpu.device import Gpu, failures, trouble
from supple.gpu.field import fits
from supple.gpu.raymarch import Held
from supple.gpu.shader import EXACT, PLAIN
from supple.gpu.solid import Filling, Volume, beside, hold, hold_strokes

T = TypeVar("T")


def tried(gpu: Gpu, work: Callable[[], T], says: str = "the CPU does what {} cannot") -> T | None:
    """Return the result of some work on a GPU; on failure, warn with a DeviceWarning and return None."""
    try:
        with gpu.lock:
            done = work()
        note(gpu.name)
        return done
    except failures() as error:
        failed = trouble(gpu, error)
    note(CPU)
    warn(f"{says.format(gpu.name)}: {failed}", DeviceWarning)
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
        twice = False  # rays go on without a buffer
    if space is None:
        still = np.zeros((3, 5))  # a domain without displacement
        still[:, 1], still[:, 3] = 1.0, spacing
        return Held(volume, hold_strokes(gpu, np.zeros(0, STROKE_DTYPE), still), PLAIN)
    strokes = hold_strokes(gpu, space.table, space.axes, shown_mask(space.freeze))
    filling = Filling(volume, strokes, tolerance) if twice else None
    held = Held(volume, strokes, EXACT, filling, whole=mode == "buffered")
    held.filled()
    return held
