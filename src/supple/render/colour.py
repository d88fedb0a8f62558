"""Conversion of sRGB values to linear light, and volumes of colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from supple.space.domain import refuse

_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of BT.709


def linear_light(values: npt.ArrayLike, white: float = 1.0) -> npt.NDArray[np.floating]:
    """Return sRGB values in linear light; ``white`` is unchanged."""
    u = np.asarray(values) / white
    with np.errstate(invalid="ignore"):
        return np.asarray(white * np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))


def srgb_of(linear: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """Return linear light, from 0 to 1, as sRGB; beyond that, it is cut off."""
    u = np.clip(linear, 0, 1)
    return np.asarray(np.where(u <= 0.0031308, 12.92 * u, 1.055 * np.power(u, 1 / 2.4) - 0.055))


def are_colours(samples: npt.NDArray[Any]) -> bool:
    """Return whether samples are colours to render: three or four of uint8, uint16, or floats from 0 to 1."""
    if samples.ndim != 4 or samples.shape[3] not in (3, 4):
        return False
    if samples.dtype.kind == "f":
        return all(slab.min() >= 0 and slab.max() <= 1 for slab in samples)
    return samples.dtype.newbyteorder("=") in (np.uint8, np.uint16)


def luminance_and_colours(given: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the luminance of colours, by which they are seen, and the colours with an opacity.

    Parameters
    ----------
    given : array (Z, H, W, 3 or 4)
        sRGB, with or without an opacity: uint8, uint16, or floats from 0 to 1.

    Returns
    -------
    uint8 or uint16 arrays (Z, H, W) and (Z, H, W, 4)
        The luminance is that of the sRGB values by the weights of BT.709; transparent voxels are dark.

    Raises
    ------
    SuppleError
        If values are of another type, or floats beyond 0 and 1.
    """
    if not are_colours(given):
        told = f"{given.dtype} from {given.min():g} to {given.max():g}"
        refuse("colours", "red, green and blue of uint8, uint16, or floats from 0 to 1", told=told)
    deep, white = (np.uint8, 255) if given.dtype.itemsize == 1 else (np.uint16, 65535)
    made = np.full((*given.shape[:3], 4), white, deep)
    luminance = np.empty(given.shape[:3], deep)
    for slab, out, grey in zip(given, made, luminance, strict=True):
        out[..., : slab.shape[-1]] = np.rint(slab * np.float32(white)) if slab.dtype.kind == "f" else slab
        grey[...] = np.rint((out[..., :3] @ _WEIGHTS) * (out[..., 3] / white))
    return luminance, made
