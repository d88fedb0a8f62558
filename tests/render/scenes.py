"""Bodies, strokes and looks that tests of rendering share."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

import supple
from supple.render.camera import Camera
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry

SHAPE = (24, 30, 28)
OBLIQUE = Geometry(
    (1.0, 1.2, 1.5), (10.0, -20.0, 5.0), np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]) * [1, -1, 1]
)
CAMERA = Camera(35, 20, roll=10)
SOFT = TransferFunction(((0.2, 1.0, 0.2, 0.1, 0.0), (0.5, 0.9, 0.5, 0.3, 0.2), (1.0, 1.0, 1.0, 1.0, 0.6)))
HARD = TransferFunction(((0.49, 1.0, 0.8, 0.6, 0.0), (0.5, 1.0, 0.8, 0.6, 1.0), (1.0, 1.0, 0.8, 0.6, 1.0)))


def cloud(shape: tuple[int, ...] = SHAPE, seed: int = 0, width: float = 3) -> npt.NDArray[np.float32]:
    made = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), width, mode="constant")
    made -= made.min()
    return np.asarray(made / made.max(), np.float32)


def ball(radius: float, centre: tuple[float, float, float] = (13.5, 14.5, 11.5)) -> npt.NDArray[np.float32]:
    """A ball in the millimetres of OBLIQUE; half of its greatest value at its surface."""
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")[::-1], axis=-1)
    away = np.linalg.norm((grid - centre) * OBLIQUE.spacing, axis=-1)
    return np.asarray(np.clip(0.5 + (radius - away) / 6, 0, 1), np.float32)


def bent(spacing: tuple[float, ...] = OBLIQUE.spacing) -> supple.Deformation:
    d = supple.Deformation(SHAPE, spacing=spacing, border=None, on_fold="damp")
    return d.grab((14, 15, 12), by=(4, -2, 3), radius=9)
