"""Rendered volumes on the GPU: a scene on a device, and rays through it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.gpu.memory import download, owned, room, upload, uploaded
from supple.gpu.shader import FAR, LATTICE, MOST_GROUPS, PLAIN, ROW, Pace, shader, source
from supple.gpu.solid import Filling, Lattice, Volume

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]

RAYS = 1 << 16  # initial number of rays, before their time is known
LONGEST = 8  # the most samples that share one read of the lattice
_LARGEST = float(np.finfo(np.float32).max)
_LOST = "points along rays could not be solved in its numbers"


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The part of a scene on a device."""

    volume: Volume
    lattice: Lattice
    mode: int  # PLAIN, LATTICE or EXACT; a scene with a buffer becomes plain when that is filled
    cells: int = 1  # the number of cells of the lattice that a ray may cross with one cubic
    filling: Filling | None = None  # the buffer, of a hybrid scene
    whole: bool = False  # whether the volume is drawn only when its buffer is filled
    pace: Pace = field(default_factory=lambda: Pace(RAYS))  # the number of rays in one part


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The appearance of a volume before a camera, in the layout of ``_core/raymarch.hpp``."""

    camera: Floats
    skips: npt.NDArray[np.uint8]
    table: Singles
    sums: Floats
    low: float
    scale: float
    threshold: float
    top: float
    step: float
    light: tuple[float, float, float]
    shaded: bool
    box: Floats
    plane: tuple[float, float, float, float]
    silhouettes: float
    projection: int
    arrives: Singles
    placed: Singles
    labelled: bool

    @property
    def core(self) -> _core.Look:
        """The settings in the core's form."""
        return _core.Look(*(getattr(self, each.name) for each in fields(self)))


def march(
    held: Held, look: Look, size: tuple[int, int], fine: int, ends: Singles | None = None
) -> tuple[Singles, Floats, npt.NDArray[np.int64]]:
    """Render rows and columns of rays, ``fine`` of them along the side of a pixel.

    Rays end at meshes, if there are ``ends``, (H, W, 4): linear light, and millimetres from the eye or infinity.
    Returns light and opacity (H, W, 4), the depths of the first surface and of opacity 0.9 (H, W, 2), and samples and
    evaluations of T (H, W, 2).
    """
    height, width = size
    light, depth = np.empty((height, width, 4), np.float32), np.empty((height, width, 2))
    work = np.empty((height, width, 2), np.int64)
    for first, count, seen in _rays(held, look, size, fine, ends):
        found = download(held.volume.gpu, seen, np.float32, count * width * 8).reshape(count, width, 8)
        if (found[..., 7] < 0).any():
            raise ArithmeticError(_LOST)
        part = slice(first, first + count)
        light[part], work[part] = found[..., :4], found[..., 6:]
        where = found[..., 4:6].astype(np.float64)
        depth[part] = np.where(where > 1e38, np.inf, where)
    return light, depth, work


def paint(
    held: Held,
    look: Look,
    size: tuple[int, int],
    background: Singles,
    target: Any,
    ends: Singles | None = None,
) -> None:
    """Render into a writable texture of format rgba8unorm, as sRGB, over a background in linear light.

    The texture has ``size`` or more.
    """
    gpu, width = held.volume.gpu, size[1]
    work = shader(gpu, source("paint"), "paint")
    settings = {"width": width, "background": background}
    with owned(room(gpu, 4)) as (lost,):
        for first, rows, seen in _rays(held, look, size, 1, ends):
            given = {"seen": seen, "lost": lost, "target_": target.create_view()}
            work.run((-(-width // 8), -(-rows // 8), 1), settings | {"first": first, "rows": rows}, given)
            if download(gpu, lost, np.uint32, 1)[0]:  # waits
                raise ArithmeticError(_LOST)


def _rays(
    held: Held, look: Look, size: tuple[int, int], fine: int, ends: Singles | None
) -> Iterator[tuple[int, int, Any]]:
    """March rays some rows at a time: yield the first row, the number of rows, and their results."""
    volume, filling = held.volume, held.filling
    gpu, finest, (height, width) = volume.gpu, float(look.camera[1].min()), size
    if held.whole and filling is not None and filling.part < 1.0:
        filling.advance()  # another scene of the volume has replaced it
    mode = PLAIN if filling is not None and filling.part == 1.0 else held.mode
    # The samples that share one read of the lattice: those within its cells.
    cells = held.cells * held.lattice.step * finest / look.step
    eye, _, ahead, right, below = look.camera
    settings = {
        "bricks": look.skips.shape[::-1],
        "picture": (width, height),
        "fine": fine,
        "stretch": max(1, min(int(cells), LONGEST)) if mode == LATTICE else LONGEST,
        "entries": len(look.table),
        "top": np.clip(look.top, -_LARGEST, _LARGEST),
        "threshold": np.clip(look.threshold, -_LARGEST, _LARGEST),
        "eye": eye,
        "ahead": ahead,
        "right": right,
        "below": below,
        "box_first": look.box[0],
        "box_last": look.box[1],
        "first_node": look.placed[0],
        "per_node": look.placed[1],
        "shadows": look.arrives.size > 0,
        "ends": ends is not None,
        **{name: getattr(look, name) for name in ("step", "low", "scale", "shaded", "light", "plane")},
        **{name: getattr(look, name) for name in ("silhouettes", "projection")},
    }
    # Whole rows of pixels, as many as there is room for.
    rays = width * fine
    most = min(height // fine, gpu.binding // (32 * rays))
    if most < 1 or width > 8 * MOST_GROUPS:
        raise MemoryError("a row of pixels of so many rays is more than a shader takes")
    pace = Pace(max(1, held.pace.count // rays), most)
    wide = min(len(look.table) + 1, ROW)
    colours = np.stack([np.pad(look.table, ((0, 1), (0, 0))), look.sums]).astype(np.float32)
    colours = np.pad(colours, ((0, 0), (0, -colours.shape[1] % wide), (0, 0))).reshape(2, -1, wide, 4)
    textures = [uploaded(gpu, look.skips), uploaded(gpu, np.moveaxis(colours, 1, 0))]
    if look.arrives.size:
        textures.append(uploaded(gpu, look.arrives))
    with owned(*textures, room(gpu, 32 * rays * most)) as (*_, seen):
        views = [texture.create_view() for texture in textures]
        given = {"skips": views[0], "colours": views[1], "arrives": views[2] if look.arrives.size else None}
        for first, count in pace.parts(height // fine):
            part = {"first": first * fine, "rows": count * fine}
            meshes = np.zeros(4, np.float32) if ends is None else ends[part["first"] :][: part["rows"]]
            with owned(upload(gpu, np.minimum(meshes, np.float32(FAR)))) as (ended,):
                groups = (-(-width // 8), -(-count * fine // 8), 1)
                _march(held, mode, groups, settings | part, {**given, "seen": seen, "ends": ended})
            yield first * fine, count * fine, seen
            pace.count = min(pace.count, most)
    held.pace.count = pace.count * rays


def _march(held: Held, mode: int, groups: tuple[int, ...], settings: dict[str, Any], given: dict[str, Any]) -> None:
    """Run the shader of rays in a mode; settings and resources are given in addition to those of the scene."""
    volume, lattice, filling = held.volume, held.lattice, held.filling
    copied, coloured = mode == PLAIN and filling is not None, volume.colours is not None
    chosen = {"MODE": mode, "WARPED": copied, "LABELLED": volume.labelled, "COLOURED": coloured}
    work = shader(volume.gpu, source("raymarch", volume.voxel), "march", lattice.constants | chosen)
    own = {
        "voxels": volume.samples,
        "warped": volume.warped and volume.warped.create_view(),
        "paint": volume.colours,
    }
    work.run(groups, {**lattice.settings, "size": volume.size, **settings}, {**lattice.resources, **own, **given})


def prepare(held: Held, filling: Filling) -> None:
    """Compile later stages of a hybrid scene, so that no frame waits; some drivers compile at the first run."""
    gpu = held.volume.gpu
    with owned(uploaded(gpu, np.zeros((1, 1, 1), np.uint8)), room(gpu, 32)) as (skips, seen):
        given = {"skips": skips.create_view(), "seen": seen, **dict.fromkeys(("colours", "arrives", "ends"))}
        for mode in (LATTICE, PLAIN):
            _march(held, mode, (1, 1, 1), {}, given)
        filling.prepare()
        download(gpu, seen, np.float32, 8)  # waits
