"""Colours in linear light and in sRGB, rendered images of a volume, and the voxel under a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.space.checks import number, point, refuse
from supple.space.geometry import Floats

_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of BT.709


def linear_light(values: npt.ArrayLike) -> Floats:
    """Return sRGB values, from 0 to 1, in linear light."""
    u = np.asarray(values, np.float64)
    return np.asarray(np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))


def srgb_of(linear: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """Return linear light as sRGB; it is clipped to 0 to 1."""
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
    """Return the luminance (Z, H, W) of sRGB colours, from which rays get their opacity, and RGBA (Z, H, W, 4).

    Colours (Z, H, W, 3 or 4) are uint8, uint16, or floats from 0 to 1, which become uint16. The luminance is that of
    the sRGB values by the weights of BT.709; transparent voxels are dark. SuppleError if values are of another type or
    range.
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


def colour_of(name: str, value: object) -> tuple[float, float, float]:
    """Return an sRGB colour; SuppleError unless it is three numbers from 0 to 1."""
    red, green, blue = (number(name, v, "three numbers from 0 to 1", 0.0, 1.0) for v in point(name, value, (3,)))
    return red, green, blue


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
