"""The parts of a scene that depend on its strokes: maps by which rays find sources, ranges, and where it is empty."""

from __future__ import annotations

from typing import Any

from supple import _core
from supple.deformation import Deformation
from supple.gpu import raymarch as shading
from supple.gpu.device import gpu_of
from supple.gpu.volume import Volume
from supple.render.appearance import FINE, prepared, ranged, skipped, widened
from supple.render.device import held_scene, tried, unseen_blocks
from supple.render.labels import LabelColours
from supple.render.meshes import place
from supple.render.picture import Array
from supple.render.shadows import shade_of
from supple.render.solid import Solid, along_rays, cells_along_rays, checked, solve_solid, warn_of_coarse


def deformed_parts(known: dict[str, Any], deformation: Deformation | None, volume: Volume | None) -> dict[str, Any]:
    """Return the parts of a scene that depend on strokes; ``known`` are the others."""
    shape, ready, mode, tolerance = (known[name] for name in ("shape", "_original", "mode", "tolerance"))
    gpu = gpu_of(known["device"])
    if volume is not None and volume.gpu is not gpu:
        volume = None  # its device was lost
    deformation = checked(deformation, shape, known["geometry"].spacing)
    labelled, colours = isinstance(known["transfer"], LabelColours), known["_paint"]
    space = deformation.space if deformation is not None else None
    error = 0.0
    held: shading.Held | None = None
    solid: Solid | None = None
    if gpu is not None:
        spacing = known["geometry"].spacing
        looks = labelled, colours, volume
        done = tried(gpu, lambda: held_scene(gpu, ready, spacing, space, mode, tolerance, *looks), 4)
        held, solid = done or (None, None)
    if deformation is not None and mode == "buffered" and held is None:
        part, mixed = tuple(map(slice, shape)), "nearest" if labelled else "linear"
        ready = prepared(deformation.warp(ready[part], filter=mixed, tolerance=tolerance))
        if colours is not None:
            colours = widened(deformation.warp(colours[part], filter=mixed, tolerance=tolerance))
    elif space is not None and mode != "exact":
        solid = solid or solve_solid(space, shape, tolerance)
        error = along_rays(solid, cells_along_rays(solid, tolerance), tolerance)
        if mode != "buffered" and error > tolerance:
            warn_of_coarse(error, tolerance, 4)
    if deformation is not None and mode == "buffered":
        error = tolerance
    brick = _core.BRICK if solid is None else FINE
    ranges: dict[int, tuple[Array, Array]] = known["_ranges"] if ready is known["_original"] else {}
    lows, highs = ranged(ready, brick, ranges)
    values = {
        "deformation": deformation,
        "samples": ready,
        "_colours": colours,
        "error": error,
        "_placed": tuple(place(mesh, deformation, known["geometry"]) for mesh in known["meshes"]),
        "_solid": solid,
        "_coarse": mode == "buffered" and solid is not None and solid.error > tolerance,
        "_lows": lows,
        "_highs": highs,
        "gpu": held.volume.gpu if held is not None else None,
        "_held": held,
    }
    return values | skipping(known | values)


def skipping(known: dict[str, Any]) -> dict[str, Any]:
    """Return the maps of empty space, for rays and for the buffer, and the shade."""
    skips = skipped(known)
    return {"_skips": skips, "_unseen": unseen_blocks(known["samples"].shape, skips), "_shade": shade_of(known)}
