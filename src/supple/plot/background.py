"""Backgrounds of plots: any image, deformed and converted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.plot.measure import spacing_of

if TYPE_CHECKING:
    from supple.media.image import Picture

_MOST_PIXELS = 1 << 21  # the largest resolution of a plot


def background(deformation: Deformation, image: npt.NDArray[Any] | Picture) -> npt.NDArray[np.float32]:
    """Return the deformed image as RGB from 0 to 1.

    Parameters
    ----------
    deformation : Deformation
    image : array of shape (H, W), (H, W, 1), or with alpha, RGB or RGBA (H, W, 2 to 4), or Picture
        Of any type of `Deformation.warp`; a picture of any colours is converted. For a video, a frame of the output,
        which is deformed already.

    Returns
    -------
    float32 array, shape (h, w, 3)
        Reduced if the image is large.
    """
    if not isinstance(image, np.ndarray) and hasattr(image, "warped"):
        from supple.media.image.display import in_srgb

        image = in_srgb(image).pixels
    array = np.asarray(image)
    if deformation.ndim == 3 and (array.shape[:2] != deformation.shape[1:] or array.ndim > 3):
        height, width = deformation.shape[1:]
        raise SuppleError(f"a frame to plot on must be of shape ({height}, {width}[, C]), found {array.shape}")
    if array.ndim == 3 and array.shape[2] > 4:
        raise SuppleError(f"an image to plot on must be grey, RGB or RGBA, found shape {array.shape}")
    bent = array
    if deformation.ndim == 2:
        bent = deformation.warp(array, alpha=array.ndim == 3 and array.shape[2] in (2, 4))
    low, high = _range(array)
    every = spacing_of(deformation.shape[-2:], _MOST_PIXELS)
    small = _smaller(bent if bent.ndim == 3 else bent[..., None], every)
    with np.errstate(invalid="ignore", over="ignore"):
        small = np.clip(np.nan_to_num((small - low) / (high - low)), 0, 1)
    if small.shape[2] in (2, 4):
        opacity = small[..., -1:]
        small = small[..., :-1] * opacity + (1 - opacity)
    return np.ascontiguousarray(np.broadcast_to(small, (*small.shape[:2], 3)), np.float32)


def _range(array: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the values of black and white."""
    if array.dtype == np.bool_:
        return 0.0, 1.0
    if array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        return 0.0, float(np.iinfo(array.dtype).max)
    finite = array[np.isfinite(array)] if array.dtype.kind == "f" else array
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if array.dtype.kind == "f" and low >= 0 and high <= 1:
        return 0.0, 1.0
    return low, high if high > low else low + 1.0


def _smaller(array: npt.NDArray[Any], every: int) -> npt.NDArray[np.float64]:
    height, width = (n // every * every for n in array.shape[:2])
    blocks = array[:height, :width].reshape(height // every, every, width // every, every, -1)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))
