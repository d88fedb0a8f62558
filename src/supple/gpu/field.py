"""The strokes and their domain in the layout of the shaders."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Mask
from supple.gpu.device import Gpu
from supple.gpu.memory import upload
from supple.gpu.shader import source, structure

Floats = npt.NDArray[np.float64]

STROKE = structure(source("field"), "Stroke")
DOMAIN = structure(source("field"), "Domain")

_EXACT = 9  # bits of a rounded step: its multiples up to 2¹⁵ are exact in float32


def packed(table: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return a table of strokes (`supple.strokes.pack`) in float32: each pivot as the sum of two numbers, and 1/R.

    The weights are those of powers of ε/ρ, so that no power of ρ overflows.
    """
    out = np.zeros(table.size, STROKE)
    power, radius = table["power"][:, None], np.sqrt(table["radius2"])
    with np.errstate(over="ignore"):  # checked by `fits`
        out["pivot"] = table["pivot"]
        out["rest"][:, :3] = table["pivot"] - out["pivot"].astype(np.float64)
        flat = table["flat"]
        beyond = np.where(flat > 0, table["reach"] - flat, 1.0)
        out["rest"][:, 3] = np.where(flat > 0, (beyond + flat / 2) / beyond**2, 1.0 / table["reach"])
        rim = np.cbrt(0.25 * flat * table["radius2"][:, 0])
        out["metric"] = np.stack([table["stretch"], table["coupled"], flat, rim], axis=1)
        out["force"], out["terms"], out["power"] = table["force"], table["terms"], table["power"]
        out["force"][:, 2] *= table["stretch"]
        out["matrix"][..., :3] = np.swapaxes(table["matrix"], 1, 2)  # columns
        out["joined"], out["turn"] = table["joined"], table["turn"]
        out["radius2"][:, :3] = table["radius2"]
        for name, n in (("p", power), ("q", power + 2), ("r", power + 2)):
            out[name][:, :3] = table[name] / radius**n
    return out


def constants(table: npt.NDArray[np.void], freeze: Mask | None) -> dict[str, int]:
    """Return the shader constants of a map: not settings, since software adapters run both sides of a branch."""
    grabs = bool((table["power"] == 1).all() and not table["joined"].any())
    return {"GRABS": int(grabs), "FROZEN": int(freeze is not None)}


def fits(table: npt.NDArray[np.void]) -> bool:
    """Return whether float32 holds all numbers of a table and their products."""
    found = packed(table)
    names = ("pivot", "force", "matrix", "radius2", "p", "q", "r", "turn")
    return all(bool((np.abs(found[name]) < 1e18).all()) for name in names)


def domain(axes: Floats, freeze: Mask | None = None) -> npt.NDArray[np.void]:
    """Return a packed domain (`Domain.packed`), and where the coefficients of its freeze mask lie, for the shaders.

    The unit of errors is the least spacing of the axes along which points move. An image has no displacement along its
    third axis.
    """
    out = np.zeros((), DOMAIN)
    for name, values in zip(("first", "last", "sigma", "spacing", "profile"), axes.T, strict=True):
        out[name][:3] = values
    moving = (axes[:, 1] != axes[:, 0]) | (axes[:, 2] != 0.0)
    out["spacing"][3] = axes[moving if moving.any() else ..., 3].min()
    if freeze is not None:
        size = np.array(freeze.coefficients.shape[::-1])
        several = size > 1
        parts, powers = np.frexp(freeze.step)
        step = np.ldexp(np.round(parts * 2**_EXACT), powers - _EXACT)
        out["mask_size"][:3] = size
        out["mask_first"][:3], out["mask_step"][:3] = freeze.first, step
        out["mask_first_rest"][:3] = freeze.first - out["mask_first"][:3].astype(np.float64)
        out["mask_step_rest"][:3], out["mask_per_step"][:3] = freeze.step - step, several / freeze.step
    return out


def packed_mask(gpu: Gpu, freeze: Mask | None) -> npt.NDArray[np.uint16]:
    """Return the coefficients of a freeze mask, if there is one, in the layout of the shaders (freeze.wgsl).

    MemoryError if they exceed the largest binding.
    """
    if freeze is None:
        return np.zeros(0, np.uint16)
    size = 2 * freeze.coefficients.size
    if size > gpu.binding:
        raise MemoryError(f"{size >> 20} MB of a freeze mask are more than a shader takes")
    return _flagged(freeze)


@lru_cache(maxsize=4)
def _flagged(freeze: Mask) -> npt.NDArray[np.uint16]:
    low = high = freeze.coefficients
    for axis in range(3):
        if low.shape[axis] > 1:  # over the four coefficients around each cell
            low = np.minimum.reduce([_shifted(low, axis, k) for k in range(-1, 3)])
            high = np.maximum.reduce([_shifted(high, axis, k) for k in range(-1, 3)])
    made = np.asarray((low == high) * 256 | freeze.coefficients, np.uint16).reshape(-1)
    return np.pad(made, (0, made.size % 2))  # to whole words


def _shifted(values: npt.NDArray[Any], axis: int, by: int) -> npt.NDArray[Any]:
    """Return the values ``by`` places farther along an axis; beyond the ends, the values at the ends."""
    n = values.shape[axis]
    return np.take(values, np.clip(np.arange(n) + by, 0, n - 1), axis)


def stroke_buffers(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None) -> dict[str, Any]:
    """Return the buffers of field.wgsl: a domain, its strokes, and their freeze mask, if any."""
    mask = packed_mask(gpu, freeze)
    return {
        "domain": upload(gpu, domain(axes, freeze)),
        "strokes": upload(gpu, packed(table)),
        "mask": upload(gpu, mask),
    }
