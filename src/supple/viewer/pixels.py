"""Pictures as a screen shows them: sRGB and opacity of 8 bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips

from supple.media.image import Picture

Array = npt.NDArray[Any]
Pixels = npt.NDArray[np.uint8]


def on_screen(picture: Picture) -> Pixels:
    """A picture's pixels as (rows, columns, 4), through its colour profile, if it has one."""
    pixels = picture.pixels
    if picture.icc and pixels.ndim == 3 and pixels.dtype in (np.uint8, np.uint16):
        image = pyvips.Image.new_from_array(pixels)
        kind = {3: "srgb", 4: "srgb"}.get(pixels.shape[2], "srgb")
        if picture.interpretation == "cmyk":
            kind = "cmyk"
        elif pixels.dtype == np.uint16:
            kind = "rgb16"
        image = image.copy(interpretation=kind).mutate(lambda m: m.set_type(pyvips.GValue.blob_type, _ICC, picture.icc))
        try:
            return shown(np.asarray(image.icc_transform("srgb", embedded=True).numpy()), alpha=picture.alpha)
        except pyvips.Error:  # a profile that is none, or one for other colours
            pass
    return shown(pixels, alpha=picture.alpha)


_ICC = "icc-profile-data"


def shown(array: Array, *, alpha: bool | None = None) -> Pixels:
    """Any array of a picture as (rows, columns, 4): grey or RGB; of floats, 0 is black and 1 is white.

    Parameters
    ----------
    array : array, shape (H, W) or (H, W, C)
    alpha : bool, optional
        Whether the last channel is opacity; of two or four channels, by default.
    """
    deep = array if array.ndim == 3 else array[..., None]
    channels = deep.shape[2]
    opaque = not (channels in (2, 4) if alpha is None else alpha)
    eight = _eight(deep)
    colours = eight if opaque else eight[..., :-1]
    out = np.full((*deep.shape[:2], 4), 255, np.uint8)
    out[..., :3] = colours[..., :3] if colours.shape[2] >= 3 else colours[..., :1]
    if not opaque:
        out[..., 3] = eight[..., -1]
    return out


def _eight(array: Array) -> Pixels:
    kind = array.dtype
    if kind == np.uint8:
        return np.asarray(array)
    if kind == np.bool_:
        return np.asarray(array, np.uint8) * np.uint8(255)
    if kind == np.uint16:
        return np.asarray((array + np.uint32(128)) // np.uint32(257), np.uint8)
    values = array.astype(np.float32)
    if kind.kind in "iu":  # of which nobody knows what is white
        finite = values
        low, high = float(finite.min()), float(finite.max())
        values = (values - low) / (high - low) if high > low else np.zeros_like(values)
    return np.asarray(np.rint(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255), np.uint8)
