"""The GPU resources of a scene: its volume, the lattice of T⁻¹, and the buffer of the deformed volume."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.devices import CPU, note
from supple.engine.work import Space
from supple.errors import DeviceWarning
from supple.gpu.device import Gpu
from supple.gpu.field import fits
from supple.gpu.fill import BLOCK, Filling
from supple.gpu.kernel import Pace, failures, trouble
from supple.gpu.raymarch import EXACT, HYBRID, LATTICE, PLAIN, RAYS, Held, prepare
from supple.gpu.solid import Lattice, hold_strokes, solve
from supple.gpu.volume import Volume, beside, hold
from supple.render.camera import Projection
from supple.render.solid import FINEST, RESOLVED, Solid, cells_along_rays, solve_solid
from supple.strokes import STROKE_DTYPE

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
T = TypeVar("T")


def tried(gpu: Gpu, work: Callable[[], T], stacklevel: int, says: str = "the CPU does what {} cannot") -> T | None:
    """Return the result of some work on a GPU; None, and a DeviceWarning, on failure."""
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
) -> tuple[Held, Solid | None]:
    """Upload a scene to a GPU.

    Parameters
    ----------
    gpu : Gpu
    samples : array (Z, H, W)
        Samples from `supple.render.appearance.prepared`.
    spacing : tuple of float
        Millimetres from voxel to voxel, x first.
    space : Space or None
        The strokes, if there are any.
    mode : str
        One of `supple.render.scene.MODES`.
    tolerance : float
        The tolerance of source points, in voxels.
    labelled : bool
        Whether samples are numbers of labels.
    colours : array (Z, H, W, 4), optional
        The voxels' own colours.
    volume : Volume, optional
        The same samples and colours, if they are already on the GPU.

    Returns
    -------
    Held
    Solid or None
        The lattice, if one was solved.

    Raises
    ------
    Exception
        One of `supple.gpu.kernel.failures`.
    """
    if space is not None and not fits(space.table):
        raise ArithmeticError("strokes of such sizes are beyond its numbers")
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
        return Held(
            volume, hold_strokes(gpu, np.zeros(0, STROKE_DTYPE), _still(spacing)), PLAIN, None, Pace(RAYS)
        ), None
    if mode == "exact":
        return Held(volume, hold_strokes(gpu, space.table, space.axes, space.freeze), EXACT, None, Pace(RAYS)), None
    solid, lattice = lattice_of(gpu, space, tolerance)
    if not twice:
        return Held(volume, lattice, LATTICE, None, Pace(RAYS)), solid
    filling = Filling(volume, lattice, polished=solid.error > tolerance, tolerance=tolerance)
    held = Held(volume, lattice, HYBRID, filling, Pace(RAYS), whole=mode == "buffered")
    if mode == "buffered":
        filling.advance()
    else:
        prepare(held, filling)
    return held, solid


def lattice_of(gpu: Gpu, space: Space, tolerance: float) -> tuple[Solid, Lattice]:
    """Return the lattice, as fine as the tolerance needs or the memory allows."""
    made: list[Lattice] = []
    tries: list[tuple[Solid, float]] = []
    shape = (space.count, *space.shape)

    def attempt(step: int) -> tuple[Solid, float]:
        lattice, nodes, error, smooth = solve(gpu, space.table, space.axes, shape, step, space.freeze)
        made[:] = [lattice]
        tries[:] = [(Solid(nodes, step, error), smooth)]
        return tries[0]

    try:
        solid = solve_solid(attempt, tolerance)
    except MemoryError:
        if not tries:
            raise
        with contextlib.suppress(MemoryError):  # some may have been skipped
            while tries[0][0].step > FINEST:
                attempt(tries[0][0].step // 2)
        solid, smooth = tries[0]  # the finest that fits
        if solid.step > RESOLVED * smooth:
            solid = replace(solid, error=math.inf)
    return solid, replace(made[0], cells=cells_along_rays(solid, tolerance))


def unseen_blocks(shape: tuple[int, ...], skips: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Return the mask of invisible bricks of a buffer (z, y, x)."""
    blocks, wide = tuple(-(-n // BLOCK) for n in shape), BLOCK // _core.BRICK
    whole = [(0, wide * n - m) for n, m in zip(blocks, skips.shape, strict=True)]
    deep, high, across = blocks
    fine = np.pad(skips > 0, whole, constant_values=True).reshape(deep, wide, high, wide, across, wide)
    return np.asarray(fine.all(axis=(1, 3, 5)), np.bool_)


def order_of(view: Projection, unseen: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Return the order in which bricks of the buffer are filled: visible ones in view first, the nearest first."""
    away = [
        ((np.arange(n) + 0.5) * BLOCK - eye) * spacing
        for n, eye, spacing in zip(reversed(unseen.shape), view.eye, view.spacing, strict=True)
    ]

    def along(axis: Floats) -> npt.NDArray[np.float32]:
        x, y, z = ((a * c).astype(np.float32) for a, c in zip(away, axis, strict=True))
        return np.asarray(z[:, None, None] + y[:, None] + x)

    depth = along(view.ahead)
    radius = 0.5 * BLOCK * float(np.linalg.norm(view.spacing))
    hidden = depth < -radius
    for axis, size in ((view.packed[3], view.size[1]), (view.packed[4], view.size[0])):
        scale = float(np.linalg.norm(axis))  # millimetres of a pixel, at a distance of a millimetre
        hidden |= np.abs(along(axis)) / scale > 0.5 * size * scale * (np.maximum(depth, 0.0) + radius) + radius
    far = float(np.abs(depth).max()) + 1.0
    return np.argsort((depth + far * (2.0 * hidden + 4.0 * unseen)).reshape(-1))


def _still(spacing: tuple[float, ...]) -> Floats:
    """Return a domain without displacement."""
    axes = np.zeros((3, 5))
    axes[:, 1], axes[:, 3] = 1.0, spacing
    return axes
