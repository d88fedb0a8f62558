"""Rendered volumes on the GPU: a scene on a device, and rays through it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.gpu.memory import download, owned, room, upload, uploaded
from supple.gpu.shader import FAR, MOST_GROUPS, PLAIN, ROW, Pace, shader, source
from supple.gpu.solid import Filling, Strokes, Volume

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]

RAYS = 1 << 16  # initial number of rays, before their time is known
_LARGEST = float(np.finfo(np.float32).max)
_LOST = "points along rays could not be solved in its numbers"


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The part of a scene on a device."""

    volume: Volume
    strokes: Strokes
    mode: int  # PLAIN or EXACT
    filling: Filling | None = None  # the buffer, if there is one: once it is filled, rays sample it
    whole: bool = False  # whether the volume is drawn only when its buffer is filled

    def filled(self) -> Filling | None:
        """Return the buffer, if rays sample it."""
        if self.filling is not None and self.whole and self.filling.part < 1.0:
            self.filling.advance()  # another scene of the volume has replaced it
        return self.filling if self.filling is not None and self.filling.part == 1.0 else None


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
    gpu, (height, width) = held.volume.gpu, size
    eye, _, ahead, right, below = look.camera
    settings = {
        "picture": (width, height),
        "fine": fine,
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
    mode = PLAIN if held.filled() else held.mode
    kept = held.volume.paces.setdefault((mode, held.strokes.count), Pace(RAYS))
    pace = Pace(max(1, kept.count // rays), most)
    wide = min(len(look.table) + 1, ROW)
    colours = np.stack([np.pad(look.table, ((0, 1), (0, 0))), look.sums]).astype(np.float32)
    colours = np.pad(colours, ((0, 0), (0, -colours.shape[1] % wide), (0, 0))).reshape(2, -1, wide, 4)
    skips = look.skips if mode == PLAIN else look.skips[:1, :1, :1]  # exact rays skip nothing
    settings["bricks"] = skips.shape[::-1]
    textures = [uploaded(gpu, skips), uploaded(gpu, np.moveaxis(colours, 1, 0))]
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
    kept.count = pace.count * rays


def _march(held: Held, mode: int, groups: tuple[int, ...], settings: dict[str, Any], given: dict[str, Any]) -> None:
    """Run the shader of rays in a mode; settings and resources are given in addition to those of the scene."""
    volume, strokes = held.volume, held.strokes
    chosen = {
        "MODE": mode,
        "WARPED": mode == PLAIN and held.filling is not None,
        "LABELLED": volume.labelled,
        "COLOURED": volume.colours is not None,
    }
    work = shader(volume.gpu, source("raymarch", volume.voxel), "march", strokes.constants | chosen)
    own = {
        "voxels": volume.samples,
        "warped": volume.warped and volume.warped.create_view(),
        "paint": volume.colours,
    }
    work.run(groups, {"strokes": strokes.count, "size": volume.size, **settings}, {**strokes.resources, **own, **given})
