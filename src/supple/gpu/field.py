"""The strokes and their domain in the layout of the shaders."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.folding.strain import Mask
from supple.gpu.device import Gpu
from supple.gpu.kernel import UNIFORM, upload

Floats = npt.NDArray[np.float64]

STROKE = np.dtype(
    [
        ("pivot", np.float32, 3),
        ("terms", np.float32),
        ("rest", np.float32, 4),
        ("force", np.float32, 3),
        ("power", np.float32),
        ("matrix", np.float32, (3, 4)),
        ("radius2", np.float32, 4),
        ("p", np.float32, 4),
        ("q", np.float32, 4),
        ("r", np.float32, 4),
        ("turn", np.float32, 3),
        ("joined", np.uint32),
    ]
)
FIELD = ("field", "freeze", "newton")
"""The shaders of T and T⁻¹."""

_EXACT = 9  # bits of a step: a multiple of it by up to 2¹⁵ is exact in float32
_CALM = 8  # powers of 2


def packed(table: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return a table of strokes (`supple.strokes.pack`) in float32: each pivot as the sum of two numbers, and 1/R.

    The weights are those of powers of ε/ρ, so that no power of ρ overflows.
    """
    out = np.zeros(table.size, STROKE)
    power, radius = table["power"][:, None], np.sqrt(table["radius2"])
    with np.errstate(over="ignore"):  # checked by `fits`
        out["pivot"] = table["pivot"]
        out["rest"][:, :3] = table["pivot"] - out["pivot"].astype(np.float64)
        out["rest"][:, 3] = 1.0 / table["reach"]
        out["force"], out["terms"], out["power"] = table["force"], table["terms"], table["power"]
        out["matrix"][..., :3] = np.swapaxes(table["matrix"], 1, 2)  # columns
        out["joined"], out["turn"] = table["joined"], table["turn"]
        out["radius2"][:, :3] = table["radius2"]
        for name, n in (("p", power), ("q", power + 2), ("r", power + 2)):
            out[name][:, :3] = table[name] / radius**n
    return out


def constants(table: npt.NDArray[np.void], freeze: Mask | None) -> dict[str, int]:
    """Return the constants of shaders for a map: software adapters run both sides of a branch."""
    grabs = bool((table["power"] == 1).all() and not table["joined"].any())
    return {"GRABS": int(grabs), "FROZEN": int(freeze is not None)}


def fits(table: npt.NDArray[np.void]) -> bool:
    """Return whether float32 holds all numbers of a table and their products."""
    made = packed(table)
    names = ("pivot", "force", "matrix", "radius2", "p", "q", "r", "turn")
    return all(bool((np.abs(made[name]) < 1e18).all()) for name in names)


def domain(axes: Floats, freeze: Mask | None = None) -> npt.NDArray[np.float32]:
    """Return a packed domain (`Domain.packed`) in the layout of the shaders.

    Its rows are the first and last faces of the three axes, the widths of the border, the spacing and the profiles,
    and where the coefficients of the freeze mask lie, if there is one.
    The fourth spacing is the unit of errors: the least spacing of the axes along which points move. An image has no
    displacement along its third axis.
    """
    out = np.zeros((11, 4), np.float32)
    out[:5, :3] = axes.T
    moving = (axes[:, 1] != axes[:, 0]) | (axes[:, 2] != 0.0)
    out[3, 3] = axes[moving if moving.any() else ..., 3].min()
    if freeze is not None:
        size = np.array(freeze.coefficients.shape[::-1])
        several = size > 1
        parts, powers = np.frexp(freeze.step)
        step = np.ldexp(np.round(parts * 2**_EXACT), powers - _EXACT)
        out[5, :3], out[5, 3] = size, freeze.step[several].min(initial=np.inf)
        out[6, :3], out[7, :3] = freeze.first, step
        out[8, :3], out[9, :3] = freeze.first - out[6, :3].astype(np.float64), freeze.step - step
        out[10, :3] = several / freeze.step
    return out


def packed_mask(gpu: Gpu, freeze: Mask | None) -> npt.NDArray[np.uint16]:
    """Return the coefficients of a freeze mask, if there is one, in the layout of the shaders (freeze.wgsl).

    Raises
    ------
    MemoryError
        If they exceed the largest binding.
    """
    if freeze is None:
        return np.zeros(0, np.uint16)
    size = 2 * freeze.coefficients.size
    if size > gpu.binding:
        raise MemoryError(f"{size >> 20} MB of a freeze mask are more than a shader takes")
    return _calmed(freeze)


@lru_cache(maxsize=4)
def _calmed(freeze: Mask) -> npt.NDArray[np.uint16]:
    low = high = freeze.coefficients
    for axis in range(3):
        if low.shape[axis] > 1:  # over the four coefficients around each cell
            low = np.minimum.reduce([_shifted(low, axis, k) for k in range(-1, 3)])
            high = np.maximum.reduce([_shifted(high, axis, k) for k in range(-1, 3)])
    near, calm = low != high, np.zeros(low.shape, np.uint16)
    for power in range(_CALM):  # what is farther than 2ⁿ - 1 cells from any in which m varies
        calm[~near] = 1 << power
        if not near.any():
            calm[...] = 1 << (_CALM - 1)
            break
        for axis in range(3):
            near = near | _shifted(near, axis, 1 << power) | _shifted(near, axis, -1 << power)
    made = np.asarray(calm << 8 | freeze.coefficients, np.uint16).reshape(-1)
    return np.pad(made, (0, made.size % 2))  # to whole words


def _shifted(values: npt.NDArray[Any], axis: int, by: int) -> npt.NDArray[Any]:
    """Return the values of the places farther on along an axis by some; beyond the end, those of the last."""
    n = values.shape[axis]
    return np.take(values, np.clip(np.arange(n) + by, 0, n - 1), axis)


def uploaded(gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None) -> tuple[Any, Any, Any]:
    """Return buffers of a domain, of strokes, and of the freeze mask that they are subject to, if any.

    Raises
    ------
    MemoryError
        If the mask exceeds the largest binding.
    """
    mask = packed_mask(gpu, freeze)
    return upload(gpu, domain(axes, freeze), UNIFORM), upload(gpu, packed(table)), upload(gpu, mask)
