"""Rendered images of a volume, and the voxel under a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.render.colour import linear_light, srgb_of

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rendering:
    """A rendered volume.

    Parameters
    ----------
    light : float32 array, shape (H, W, 4)
        Linear red, green and blue, premultiplied, and the opacity.
    depth : float64 array, shape (H, W)
        Millimetres from the eye to the first surface; infinity if there is none.
    samples, evaluations : int64 arrays, shape (H, W)
        The samples of each pixel, and the evaluations of T with its Jacobian (in the mode ``"exact"``).
    """

    light: npt.NDArray[np.float32]
    depth: Floats
    samples: npt.NDArray[np.int64]
    evaluations: npt.NDArray[np.int64]

    def __repr__(self) -> str:
        rows, columns = self.depth.shape
        return f"<Rendering of {columns} x {rows}>"

    def pixels(self, background: tuple[float, float, float] | None = None) -> npt.NDArray[np.uint8]:
        """Return the image as sRGB of 8 bits.

        Parameters
        ----------
        background : (float, float, float), optional
            sRGB from 0 to 1, for an opaque image; by default, opacity is kept.

        Returns
        -------
        uint8 array, shape (H, W, 3 or 4)
        """
        alpha = np.clip(self.light[..., 3:], 0, 1)
        if background is None:
            colours = self.light[..., :3] / np.maximum(alpha, 1e-6)
            seen = np.concatenate([srgb_of(colours), alpha], axis=-1)
        else:
            seen = srgb_of(self.light[..., :3] + (1 - alpha) * linear_light(background))
        return np.asarray(np.rint(seen * 255), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Pick:
    """The voxel under a pixel.

    Parameters
    ----------
    index : (float, float, float)
        The point of the deformed volume, in voxels, x first.
    source : (float, float, float)
        Its source point in the original volume.
    depth : float
        Millimetres from the eye.
    """

    index: tuple[float, float, float]
    source: tuple[float, float, float]
    depth: float
