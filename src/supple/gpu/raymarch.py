"""Pictures of volumes by the GPU: what is held there of a volume, and rays through it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu
from supple.gpu.field import domain, packed
from supple.gpu.kernel import READ, UNIFORM, WRITE, Array, download, owned, pipeline, room, run, upload

Floats = npt.NDArray[np.float64]

PLAIN, LATTICE, EXACT = 0, 1, 2
RAYS = 1 << 18  # at once: systems end work that takes seconds
LONGEST = 8  # samples
_FORMATS = {"u1": 0, "i1": 1, "u2": 2, "i2": 3, "f4": 4}
_NAMES = ("raymarch", "volume", "solid", "blend", "field", "newton")
_KINDS = (UNIFORM, UNIFORM, READ, READ, READ, READ, READ, WRITE)

SETTINGS = np.dtype(
    [
        ("size", "u4", 3),
        ("strokes", "u4"),
        ("nodes", "u4", 3),
        ("spread", "f4"),
        ("bricks", "u4", 3),
        ("first", "u4"),
        ("picture", "u4", 2),
        ("window", "f4", 2),
        ("eye", "f4", 4),
        ("ahead", "f4", 4),
        ("right", "f4", 4),
        ("below", "f4", 4),
        ("light", "f4", 4),
        ("step", "f4"),
        ("low", "f4"),
        ("scale", "f4"),
        ("threshold", "f4"),
        ("entries", "u4"),
        ("shaded", "u4"),
        ("always", "u4"),
        ("fine", "u4"),
        ("rows", "u4"),
        ("stretch", "u4"),
        ("unused", "u4", 6),
    ]
)
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A volume on the device, and the lattice of T⁻¹.

    Parameters
    ----------
    gpu : Gpu
    samples, nodes, strokes, domain
        Buffers.
    size, lattice : tuple of int
        Voxels, and nodes, x first.
    spread : float
        Voxels from node to node.
    mode : int
        PLAIN, LATTICE or EXACT.
    format : int
        Of the samples, as the shader counts them.
    count : int
        How many strokes.
    """

    gpu: Gpu
    samples: Any
    nodes: Any
    strokes: Any
    domain: Any
    size: tuple[int, ...]
    lattice: tuple[int, ...]
    spread: float
    mode: int
    format: int
    count: int


def hold(
    gpu: Gpu,
    samples: Array,
    nodes: npt.NDArray[np.float32],
    per_voxel: float,
    mode: int,
    table: npt.NDArray[np.void],
    axes: Floats,
) -> Held:
    """Put a volume on the device.

    Parameters
    ----------
    gpu : Gpu
    samples : array (Z, H, W), two along each axis at least
        Of 8 or 16 bits, or float32.
    nodes, per_voxel
        The lattice, as `supple.cpu.solid` solves it.
    mode : int
        PLAIN, LATTICE or EXACT.
    table, axes
        The strokes and the domain, as the CPU's kernels take them.

    Raises
    ------
    MemoryError
        If the volume is more than a shader takes.
    """
    if max(samples.nbytes, nodes.nbytes) > gpu.binding:
        raise MemoryError(f"a volume of {samples.nbytes >> 20} MB is more than a shader takes, {gpu.binding >> 20} MB")
    return Held(
        gpu,
        upload(gpu, samples),
        upload(gpu, nodes),
        upload(gpu, packed(table)),
        upload(gpu, domain(axes), UNIFORM),
        samples.shape[::-1],
        nodes.shape[2::-1],
        1.0 / per_voxel if per_voxel > 0 else 1.0,
        mode,
        _FORMATS[samples.dtype.str[1:]],
        table.size,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """How a volume is seen: the arguments of `supple.cpu.raymarch.march` of the same names."""

    skips: npt.NDArray[np.uint8]
    table: npt.NDArray[np.float32]
    low: float
    scale: float
    threshold: float
    window: tuple[float, float]
    step: float
    light: npt.NDArray[np.float32]
    shaded: bool


def march(
    held: Held,
    look: Look,
    view: Floats,
    size: tuple[int, int],
    fine: int,
    tell: Callable[[int], None] = lambda rows: None,
) -> tuple[npt.NDArray[np.float32], Floats, npt.NDArray[np.int64]]:
    """Take a picture.

    Parameters
    ----------
    held : Held
    look : Look
    view : float64 array (5, 3)
        A packed camera (`supple.camera.View`).
    size : (int, int)
        Rows and columns of rays.
    fine : int
        Rays along a pixel's side.
    tell : function
        Called with the number of rows of rays that are done.

    Returns
    -------
    arrays (H, W, 4), (H, W, 2) and (H, W, 2)
        Light and opacity; where the first surface is and where opacity passes 0.9; samples and evaluations of T.
    """
    gpu = held.gpu
    made = pipeline(gpu, _NAMES, "march", _KINDS, {"FORMAT": held.format, "MODE": held.mode})
    height, width = size
    settings = np.zeros(1, SETTINGS)
    window = np.clip(look.window, -_LARGEST, _LARGEST)
    for name, value in {
        "size": held.size,
        "strokes": held.count,
        "nodes": held.lattice,
        "spread": held.spread,
        "bricks": look.skips.shape[::-1],
        "picture": (width, height),
        "window": window,
        "step": look.step,
        "low": look.low,
        "scale": look.scale,
        "threshold": np.clip(look.threshold, -_LARGEST, _LARGEST),
        "entries": len(look.table),
        "shaded": look.shaded,
        "always": look.threshold == -np.inf,
        "fine": fine,
        "stretch": _stretch(held, look.step, float(view[1].min())),
    }.items():
        settings[name] = value
    for name, row in {
        "eye": view[0],
        "ahead": view[2],
        "right": view[3],
        "below": view[4],
        "light": look.light,
    }.items():
        settings[name][0, :3] = row
    light, depth = np.empty((height, width, 4), np.float32), np.empty((height, width, 2))
    work = np.empty((height, width, 2), np.int64)
    rows = max(1, min(height, RAYS // width))
    with contextlib.ExitStack() as stack:
        skips, colours = owned(stack, upload(gpu, look.skips), upload(gpu, look.table))
        (seen,) = owned(stack, room(gpu, rows * width * 32))
        for first in range(0, height, rows):
            count = min(rows, height - first)
            settings["first"], settings["rows"] = first, count
            with contextlib.ExitStack() as own:
                (told,) = owned(own, upload(gpu, settings, UNIFORM))
                buffers = [told, held.domain, held.strokes, held.nodes, skips, held.samples, colours, seen]
                run(gpu, [(made, buffers, (-(-width // 8), -(-count // 8), 1))])
                found = download(gpu, seen, np.float32, count * width * 8).reshape(count, width, 8)
            if (found[..., 7] < 0).any():
                raise ArithmeticError("points along rays could not be solved in its numbers")
            light[first : first + count] = found[..., :4]
            where = found[..., 4:6].astype(np.float64)
            depth[first : first + count] = np.where(where > 1e38, np.inf, where)
            work[first : first + count] = found[..., 6:]
            tell(first + count)
    return light, depth, work


def _stretch(held: Held, step: float, finest: float) -> int:
    """How many samples lie within the width of a cell of the lattice."""
    if held.mode != LATTICE:
        return LONGEST
    return max(1, min(int(held.spread * finest / step), LONGEST))
