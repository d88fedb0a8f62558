"""What is drawn, and compared."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

import supple
from supple.gpu.device import Gpu
from supple.render.picture import Rendering
from supple.render.scene import Scene
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry
from tests.turns import AFFINE

SHAPE, SIZE = (22, 30, 26), (30, 39)
GEOMETRY = Geometry(spacing=(0.9, 1.1, 1.8))
SOFT = TransferFunction(((0.3, 1, 0.2, 0.1, 0), (0.5, 0.9, 0.5, 0.3, 0.3), (1, 1, 1, 1, 0.8)), relative=True)


def size_of(mode: str) -> tuple[int, int]:
    """Return the rows and columns of a picture: few where software solves for every sample along a ray."""
    return (20, 26) if mode == "exact" else SIZE


def pair(samples: npt.NDArray[Any], geometry: Geometry, **options: Any) -> tuple[Scene, Scene]:
    """Return scenes on the CPU and the GPU. Until its buffer is filled, a hybrid one samples once, as an exact one."""
    exact = {"mode": "exact"} if options.get("mode") == "hybrid" else {}
    return Scene(samples, geometry, **options | exact), Scene(samples, geometry, **options, device="gpu")


def apart(one: Rendering, other: Rendering) -> float:
    """How far two pictures are from one another, in decibels."""
    a, b = (p.pixels((0.1, 0.2, 0.3)).astype(float) for p in (one, other))
    return float(20 * np.log10(255 / max(1e-3, np.sqrt(np.mean((a - b) ** 2)))))


def ball(shape: tuple[int, ...], at: Any, radius: float) -> npt.NDArray[np.bool_]:
    """Return the mask of a ball about a place, in parts of the shape."""
    places = np.stack(np.indices(shape), -1)
    return np.asarray(np.linalg.norm(places - np.array(at) * (np.array(shape) - 1), axis=-1) < radius)


def frozen(shape: tuple[int, ...], spacing: Any = 1.0, **options: Any) -> supple.Deformation:
    """Return two strokes across what is frozen."""
    mask = supple.Freeze.of(ball(shape, 0.35, 0.2 * min(shape)), width=7.0, spacing=spacing)
    d = supple.Deformation(shape, spacing=spacing, freeze=mask, **options)
    size = np.array(shape[::-1]) - 1.0
    turned = {"axis": (1, 2, 3)} if len(shape) == 3 else {}
    d = d.grab(0.55 * size, by=-0.06 * size, radius=0.3 * float(size.min()) * min(d.domain.spacing))
    return d.twist(0.6 * size, angle=40, radius=0.4 * float(size.min()) * min(d.domain.spacing), reach=None, **turned)


def turned(shape: tuple[int, ...], **options: Any) -> supple.Deformation:
    """Return one stroke of each brush."""
    d = supple.Deformation(shape, on_fold="damp", **options)
    size, n = np.array(shape[::-1]) - 1.0, len(shape)
    for k, stroke in enumerate(AFFINE[n]):
        at = (0.3 + 0.2 * k) * size
        d = d.add(replace(stroke, at=at, radius=0.2 * float(size.min()) * min(d.domain.spacing)))
    return d.grab(0.5 * size, by=0.05 * size, radius=0.2 * float(size.max()))


def texels_of(gpu: Gpu, texture: Any) -> npt.NDArray[np.float32]:
    """Return what is in a solid of float32 (z, y, x)."""
    width, height, depth = texture.size
    layout = {"bytes_per_row": 4 * width, "rows_per_image": height}
    data = gpu.device.queue.read_texture({"texture": texture}, layout, texture.size)
    return np.frombuffer(data, np.float32).reshape(depth, height, width)
