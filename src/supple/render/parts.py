"""The parts of a scene that depend on its strokes: maps by which rays find sources, ranges, and where it is empty."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple import _core
from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.gpu import raymarch as shading
from supple.gpu.device import gpu_of
from supple.gpu.volume import Volume
from supple.render.appearance import FINE, ranged, skipped, warped
from supple.render.device import held_scene, tried, unseen_blocks
from supple.render.labels import LabelColours
from supple.render.meshes import place
from supple.render.picture import Array
from supple.render.shadows import shade_of
from supple.render.solid import Solid, along_rays, cells_along_rays, warn_of_coarse
from supple.space.domain import refuse


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
    if deformation is not None and mode != "exact":
        error = tolerance
        if held is None:
            ready = warped(ready, deformation, labelled, tolerance)
            colours = colours if colours is None else warped(colours, deformation, labelled, tolerance)
    if solid is not None and mode == "hybrid":
        error = along_rays(solid, cells_along_rays(solid, tolerance), tolerance)
        if error > tolerance:
            warn_of_coarse(error, tolerance, 4)
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
        "_lows": lows,
        "_highs": highs,
        "gpu": held.volume.gpu if held is not None else None,
        "_held": held,
    }
    return values | skipping(known | values)


def checked(given: Deformation | None, shape: tuple[int, ...], spacing: tuple[float, ...]) -> Deformation | None:
    """Return the deformation of a scene's volume; None for one that moves nothing.

    SuppleError if it is of another shape or spacing, or not of strokes alone.
    """
    deformation: object = given
    if deformation is None:
        return None
    if not isinstance(deformation, Deformation):
        refuse("deformation", "a Deformation", deformation)
    if deformation.shape != shape:
        refuse("the deformation", f"one of shape {shape}, as the volume", told=f"shape {deformation.shape}")
    if deformation.maps:
        raise SuppleError("a scene is bent by strokes alone, found fields or affine maps: warp the volume first")
    if not np.allclose(deformation.domain.spacing, spacing):
        refuse("the deformation", f"one of spacing {spacing}", deformation.domain.spacing)
    return None if deformation.is_identity else deformation


def skipping(known: dict[str, Any]) -> dict[str, Any]:
    """Return the maps of empty space, for rays and for the buffer, and the shade."""
    skips = skipped(known)
    return {"_skips": skips, "_unseen": unseen_blocks(known["samples"].shape, skips), "_shade": shade_of(known)}
