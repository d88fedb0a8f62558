"""Rendered volumes on the GPU: the resources of a scene, and rays through it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.field import FIELD
from supple.gpu.fill import BLOCK, Filling
from supple.gpu.kernel import (
    MOST_GROUPS,
    READ,
    SOLID,
    TEXTURE,
    TURNS,
    UNIFORM,
    WHOLE_SOLID,
    WRITE,
    Pace,
    download,
    owned,
    pipeline,
    room,
    run,
    upload,
)
from supple.gpu.solid import Lattice
from supple.gpu.texels import put_solid, solid, table
from supple.gpu.volume import Volume

Floats = npt.NDArray[np.float64]

PLAIN, LATTICE, EXACT, HYBRID = 0, 1, 2, 3
RAYS = 1 << 16  # initial number of rays, before their time is known
LONGEST = 8  # samples
# A stretch of samples is read from the buffer if it begins in a brick with filled neighbours: it ends in one of these.
FARTHEST = BLOCK - 4  # voxels
_NAMES = ("raymarch", "volume", "solid", "blend", *FIELD, "turns")

SETTINGS = np.dtype(
    [
        ("size", "u4", 3),
        ("strokes", "u4"),
        ("nodes", "u4", 3),
        ("spread", "f4"),
        ("bricks", "u4", 3),
        ("first", "u4"),
        ("picture", "u4", 2),
        ("threshold", "f4"),
        ("top", "f4"),
        ("eye", "f4", 4),
        ("ahead", "f4", 4),
        ("right", "f4", 4),
        ("below", "f4", 4),
        ("light", "f4", 4),
        ("box_first", "f4", 4),
        ("box_last", "f4", 4),
        ("plane", "f4", 4),
        ("first_node", "f4", 4),
        ("per_node", "f4", 4),
        ("step", "f4"),
        ("low", "f4"),
        ("scale", "f4"),
        ("entries", "u4"),
        ("shaded", "u4"),
        ("fine", "u4"),
        ("rows", "u4"),
        ("stretch", "u4"),
        ("turns", "u4"),
        ("projection", "u4"),
        ("silhouettes", "f4"),
        ("shadows", "u4"),
        ("ends", "u4"),
        ("unused", "u4", 3),
    ]
)
_PAINT = np.dtype(
    [("background", "f4", 3), ("fine", "u4"), ("width", "u4"), ("first", "u4"), ("rows", "u4"), ("worked", "u4")]
)
_FAR = np.float32(3e38)  # of raymarch.wgsl
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The part of a scene on a device.

    Parameters
    ----------
    volume : Volume
    lattice : Lattice
    mode : int
        PLAIN, LATTICE, EXACT or HYBRID. A hybrid scene becomes plain when its buffer is filled.
    filling : Filling or None
        The buffer, of a hybrid scene.
    pace : Pace
        The number of rays in one part.
    whole : bool
        Whether the volume is drawn only when its buffer is filled.
    """

    volume: Volume
    lattice: Lattice
    mode: int
    filling: Filling | None
    pace: Pace
    whole: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The appearance of a volume, in the layout of ``_core/raymarch.hpp``."""

    skips: npt.NDArray[np.uint8]
    table: npt.NDArray[np.float32]
    low: float
    scale: float
    sums: Floats
    threshold: float
    top: float
    step: float
    light: npt.NDArray[np.float32]
    shaded: bool
    box: Floats
    plane: tuple[float, float, float, float]
    silhouettes: float
    projection: int
    arrives: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
    labelled: bool


def march(
    held: Held,
    look: Look,
    view: Floats,
    size: tuple[int, int],
    fine: int,
    tell: Callable[[int], None] = lambda rows: None,
    ends: npt.NDArray[np.float32] | None = None,
) -> tuple[npt.NDArray[np.float32], Floats, npt.NDArray[np.int64]]:
    """Render an image.

    Parameters
    ----------
    held : Held
    look : Look
    view : float64 array (5, 3)
        A packed camera (`supple.render.camera.Projection`).
    size : (int, int)
        Rows and columns of rays.
    fine : int
        Rays along the side of a pixel.
    tell : function
        Called with the number of finished rows of rays.
    ends : float32 array (H, W, 4), optional
        The meshes that rays end at: linear light, and millimetres from the eye or infinity.

    Returns
    -------
    arrays (H, W, 4), (H, W, 2) and (H, W, 2)
        Light and opacity; depths of the first surface and of opacity 0.9; samples and evaluations of T.
    """
    gpu = held.volume.gpu
    height, width = size
    light, depth = np.empty((height, width, 4), np.float32), np.empty((height, width, 2))
    work = np.empty((height, width, 2), np.int64)
    for first, count, seen in _rays(held, look, view, size, fine, ends):
        found = download(gpu, seen, np.float32, count * width * 8).reshape(count, width, 8)
        if (found[..., 7] < 0).any():
            raise ArithmeticError("points along rays could not be solved in its numbers")
        light[first : first + count] = found[..., :4]
        where = found[..., 4:6].astype(np.float64)
        depth[first : first + count] = np.where(where > 1e38, np.inf, where)
        work[first : first + count] = found[..., 6:]
        tell(first + count)
    return light, depth, work


def paint(
    held: Held,
    look: Look,
    view: Floats,
    size: tuple[int, int],
    fine: int,
    background: npt.NDArray[np.float32],
    target: Any,
    worked: bool = False,
    ends: npt.NDArray[np.float32] | None = None,
) -> None:
    """Render an image into a writable texture of format rgba8unorm, as sRGB.

    Parameters
    ----------
    held, look, view, size, fine
        As `march` takes them.
    background : float32 array (3)
        The background, in linear light.
    target : wgpu.GPUTexture
        A texture of ``size`` over ``fine``, or larger.
    worked : bool
        Whether to tint it by the inversions along each ray or, without any, by the samples.
    ends
        As `march` takes it.
    """
    gpu = held.volume.gpu
    work = pipeline(gpu, ("paint", "warm"), "paint", (UNIFORM, READ, WRITE, TEXTURE))
    settings = np.zeros(1, _PAINT)
    settings["width"], settings["fine"], settings["background"] = size[1] // fine, fine, background
    settings["worked"] = worked
    with contextlib.ExitStack() as stack:
        (lost,) = owned(stack, room(gpu, 4))
        for first, count, seen in _rays(held, look, view, size, fine, ends):
            settings["first"], settings["rows"] = first // fine, count // fine
            with contextlib.ExitStack() as own:
                (told,) = owned(own, upload(gpu, settings, UNIFORM))
                groups = (-(-size[1] // (8 * fine)), -(-count // (8 * fine)), 1)
                run(gpu, [(work, [told, seen, lost, target.create_view()], groups)])
                if download(gpu, lost, np.uint32, 1)[0]:  # waits
                    raise ArithmeticError("points along rays could not be solved in its numbers")


def _rays(
    held: Held,
    look: Look,
    view: Floats,
    size: tuple[int, int],
    fine: int,
    ends: npt.NDArray[np.float32] | None,
) -> Iterator[tuple[int, int, Any]]:
    """March rays some rows at a time: yield the first row, the number of rows, and their results."""
    volume, lattice, filling = held.volume, held.lattice, held.filling
    gpu, finest = volume.gpu, float(view[1].min())
    if held.whole and filling is not None and filling.part < 1.0:
        filling.advance()  # another scene of the volume has replaced it
    mode = _mode(held, look.step / finest)
    made = _marching(held, mode, filling is not None)
    height, width = size
    settings = np.zeros(1, SETTINGS)
    for name, value in {
        "size": volume.size,
        "strokes": lattice.count,
        "nodes": lattice.shape,
        "spread": lattice.spread,
        "bricks": look.skips.shape[::-1],
        "picture": (width, height),
        "top": np.clip(look.top, -_LARGEST, _LARGEST),
        "step": look.step,
        "low": look.low,
        "scale": look.scale,
        "threshold": np.clip(look.threshold, -_LARGEST, _LARGEST),
        "entries": len(look.table),
        "shaded": look.shaded,
        "fine": fine,
        "stretch": _stretch(mode, lattice.cells * lattice.spread, look.step / finest),
        "turns": TURNS,
        "plane": look.plane,
        "silhouettes": look.silhouettes,
        "projection": look.projection,
        "shadows": look.arrives[0].size > 0,
        "ends": ends is not None,
    }.items():
        settings[name] = value
    for name, row in {
        "eye": view[0],
        "ahead": view[2],
        "right": view[3],
        "below": view[4],
        "light": look.light,
        "box_first": look.box[0],
        "box_last": look.box[1],
        "first_node": look.arrives[1][0],
        "per_node": look.arrives[1][1],
    }.items():
        settings[name][0, :3] = row
    # Whole rows of pixels, as many as there is room for.
    row_ = width * fine
    most = min(height // fine, gpu.binding // (32 * row_))
    if most < 1 or width > 8 * MOST_GROUPS:
        raise MemoryError("a row of pixels of so many rays is more than a shader takes")
    pace = Pace(max(1, held.pace.count // row_), most)
    with contextlib.ExitStack() as stack:
        skips = solid(gpu, look.skips.shape, np.uint8)
        colours = table(gpu, np.stack([np.pad(look.table, ((0, 1), (0, 0))), look.sums]))
        owned(stack, skips, colours)
        put_solid(gpu, skips, look.skips)
        shadows, lit = look.arrives[0], lattice.nodes  # any texture, without shadows
        if shadows.size:
            (held_light,) = owned(stack, solid(gpu, shadows.shape, np.float32))
            put_solid(gpu, held_light, shadows)
            lit = held_light.create_view()
        (seen,) = owned(stack, room(gpu, 32 * row_ * most))
        for first, count in pace.parts(height // fine):
            settings["first"], settings["rows"] = first * fine, count * fine
            with contextlib.ExitStack() as own:
                part = np.zeros(4, np.float32) if ends is None else ends[first * fine :][: count * fine]
                told, ended = owned(own, upload(gpu, settings, UNIFORM), upload(gpu, np.minimum(part, _FAR), READ))
                finished = filling.finished if filling is not None else lattice.strokes
                read = _read(held, skips.create_view(), colours.create_view())
                buffers = [told, *read, seen, finished, lattice.mask, lit, ended, _painted(held)]
                run(gpu, [(made, buffers, (-(-width // 8), -(-count * fine // 8), 1))])
            yield first * fine, count * fine, seen
            pace.count = min(pace.count, most)
    held.pace.count = pace.count * row_


def _read(held: Held, skips: Any, colours: Any) -> list[Any]:
    """Return the bindings that rays read, from the second on; any texture replaces a missing buffer."""
    volume, lattice = held.volume, held.lattice
    warped = volume.warped.create_view() if volume.warped is not None else lattice.nodes
    return [lattice.domain, lattice.strokes, lattice.nodes, volume.view, warped, skips, colours]


def _painted(held: Held) -> Any:
    """Return the colours of voxels; any texture replaces missing ones."""
    colours = held.volume.colours
    return held.lattice.nodes if colours is None else colours.create_view()


def _marching(held: Held, mode: int, buffer: bool) -> Any:
    volume = held.volume
    kinds = (
        UNIFORM,
        UNIFORM,
        READ,
        SOLID,
        volume.kind,
        SOLID,
        WHOLE_SOLID,
        SOLID,
        WRITE,
        READ,
        READ,
        SOLID,
        READ,
        SOLID,
    )
    sampled = {PLAIN: 1, HYBRID: 2}.get(mode, 0) if buffer else 0
    chosen = held.lattice.constants | volume.constants | {"MODE": mode, "SAMPLED": sampled}
    return pipeline(volume.gpu, (*_NAMES, volume.reader), "march", kinds, chosen)


def prepare(held: Held, filling: Filling) -> None:
    """Compile later stages of a hybrid scene, so that no frame waits; some drivers compile at the first run."""
    volume = held.volume
    with contextlib.ExitStack() as stack:
        told, seen = owned(stack, upload(volume.gpu, np.zeros(1, SETTINGS), UNIFORM), room(volume.gpu, 32))
        (ended,) = owned(stack, room(volume.gpu, 16))
        skips, colours = solid(volume.gpu, (1, 1, 1), np.uint8), table(volume.gpu, np.zeros((2, 1, 4)))
        owned(stack, skips, colours)
        buffers = [told, *_read(held, skips.create_view(), colours.create_view()), seen, filling.finished]
        buffers += [held.lattice.mask, held.lattice.nodes, ended, _painted(held)]
        run(volume.gpu, [(_marching(held, mode, True), buffers, (1, 1, 1)) for mode in (LATTICE, HYBRID, PLAIN)])
        filling.prepare()
        download(volume.gpu, seen, np.float32, 8)  # waits


def _mode(held: Held, step: float) -> int:
    """Return the current mode of marching, for samples ``step`` voxels apart."""
    filling = held.filling
    if filling is None:
        return held.mode
    if filling.part == 1.0:
        return PLAIN
    # Software adapters run both sides of a branch, and would read both sources for each ray.
    mixed = filling.part > 0.0 and step <= FARTHEST and not held.volume.gpu.software
    return HYBRID if mixed else LATTICE


def _stretch(mode: int, cells: float, step: float) -> int:
    """Return the number of samples that share one read of the lattice: those within its cells, in voxels."""
    if mode not in (LATTICE, HYBRID):
        return LONGEST
    return max(1, min(int((min(cells, FARTHEST) if mode == HYBRID else cells) / step), LONGEST))
