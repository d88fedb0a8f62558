"""The appearance of a volume: its prepared samples, transfer functions, light, and empty-space skipping."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.domain import choice, point, refuse
from supple.errors import SuppleError
from supple.render.camera import Projection
from supple.render.colour import linear_light
from supple.render.transfer import ENTRIES, PRESETS, TransferFunction

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

FINE = 2  # voxels of a brick of visible voxels, if a lattice displaces them into bricks of `_core.BRICK` voxels
MOST = 1e18  # of samples: float32 holds the squares of their gradients
_TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32)
PROJECTIONS = ("none", "maximum", "minimum", "average")


def skipped(known: dict[str, Any]) -> npt.NDArray[np.uint8]:
    """Return the distance in bricks to the next visible one."""
    if known["projection"] != "none":  # of all that is along a ray
        return np.zeros(brick_counts(known["samples"].shape, _core.BRICK), np.uint8)
    seen = visible(known, known["_lows"], known["_highs"])
    if known["_solid"] is not None:
        moved = np.empty(brick_counts(known["samples"].shape, _core.BRICK), np.bool_)
        # Along rays, points are off the lattice by less than its error, which includes a reserve.
        slack = 0.01 + 0.5 * min(known["error"], 1.0)
        _core.brick_moved(known["_solid"].lattice, seen, FINE, slack, moved)
        seen = moved
    skips = np.empty(seen.shape, np.uint8)
    _core.brick_distances(seen, skips)
    return skips


def ranged(samples: Array, brick: int, known: dict[int, tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the smallest and the largest sample of each brick, unless they are known."""
    if brick not in known:
        lows, highs = (np.empty(brick_counts(samples.shape, brick), np.float32) for _ in range(2))
        _core.brick_ranges(samples, brick, lows, highs)
        known[brick] = lows, highs
    return known[brick]


def visible(known: dict[str, Any], lows: Array, highs: Array) -> npt.NDArray[np.bool_]:
    """Return which bricks are visible, of values between two for each."""
    if known["projection"] != "none":
        return np.ones(lows.shape, np.bool_)
    table, (low, high), (bottom, top) = known["_table"], known["range"], known["density"]
    before = np.concatenate([[0], np.cumsum(table[:, 3] > 0)])  # visible entries before each
    lows, highs = np.maximum(lows, np.float32(bottom)), np.minimum(highs, np.float32(top))

    def entry(values: Array) -> npt.NDArray[np.intp]:
        places = np.rint((values - np.float32(low)) * np.float32(entries(low, high)))
        return np.asarray(np.clip(places, 0, ENTRIES - 1), np.intp)

    return np.asarray((lows <= highs) & (before[entry(highs) + 1] > before[entry(lows)]), np.bool_)


def transfer_function(given: TransferFunction | str) -> TransferFunction:
    """Return a transfer function, or the preset of a name."""
    if isinstance(given, TransferFunction):
        return given
    choice("transfer", given, tuple(PRESETS))
    return PRESETS[given]


def seen_through(
    transfer: TransferFunction,
    density: tuple[float, float] | None,
    values: tuple[float, float],
    step: float,
    projection: str = "none",
) -> dict[str, Any]:
    """Return the colours and opacities of a transfer function and a window of values, for samples of some range.

    Of a projection, they are grey and opaque, from black at the window's lower end to white at its upper one.
    """
    low, high = values
    if density is None:
        window = (-math.inf, math.inf)
    else:
        bounds = point("density", density, (2,))
        if bounds[0] >= bounds[1]:
            refuse("density", "two values LO,HI, the lower one first", density)
        window = (bounds[0], bounds[1])
    if projection != "none":
        black, white = window if density is not None else values
        shades = np.clip((np.linspace(low, high, ENTRIES) - black) / ((white - black) or 1.0), 0.0, 1.0)
        grey = linear_light(np.stack([shades] * 3, axis=1), 1.0)
        table = np.concatenate([grey, np.ones((ENTRIES, 1))], axis=1).astype(np.float32)
        return {"density": window, "_table": table, "_threshold": -math.inf}
    table = transfer.table(low, high, step)
    # An entry is that of all values which are rounded to it, up to halfway to the next.
    values_, half = np.linspace(low, high, ENTRIES), 0.5 * (high - low) / (ENTRIES - 1)
    seen = (table[:, 3] > 0) & (values_ + half >= window[0]) & (values_ - half <= window[1])
    first = int(np.argmax(seen)) if seen.any() else 0
    if not seen.any():
        threshold = math.inf
    elif first == 0:
        threshold = -math.inf if window[0] <= low else window[0]
    else:
        threshold = max(window[0], float(values_[first]) - half)
    return {"density": window, "_table": table, "_threshold": threshold}


def largest(samples: Array, transfer: TransferFunction | str, density: tuple[float, float] | None = None) -> Array:
    """Return a volume in which only the largest part of what is visible is left, of voxels that touch by their faces.

    Other visible voxels get the highest value that is not visible, below those that are.

    Parameters
    ----------
    samples : array (Z, H, W)
    transfer, density
        What is visible, as in `supple.render.scene.Scene`.

    Raises
    ------
    SuppleError
        If the smallest value is visible, so that no value hides a voxel.
    """
    ready = prepared(np.asarray(samples))[tuple(map(slice, samples.shape))]
    low, high = float(ready.min()), float(ready.max())
    known = seen_through(transfer_function(transfer), density, (low, high), 1.0)
    threshold = known["_threshold"]
    if threshold == -math.inf:
        raise SuppleError("all is visible, down to the smallest value, and nothing detached: choose a higher density")
    known |= {"range": (low, high), "projection": "none"}
    seen = np.stack([visible(known, slab, slab) for slab in ready])
    kept = np.empty(seen.shape, np.bool_)
    _core.largest_part(seen, kept)
    hidden = ready[ready < threshold].max(initial=low)
    return np.where(seen & ~kept, np.asarray(hidden, ready.dtype), ready)


def entries(low: float, high: float) -> float:
    """Return the number of table entries for each unit of value."""
    return (ENTRIES - 1) / (high - low) if high > low else 0.0


def lamp(view: Projection) -> npt.NDArray[np.float32]:
    """Return a lamp beside the camera, above and to the left."""
    right, down = (axis / np.linalg.norm(axis) for axis in view.packed[3:])
    towards = -view.ahead - 0.35 * right - 0.45 * down
    return np.asarray(towards / np.linalg.norm(towards), np.float32)


def brick_counts(shape: tuple[int, ...], brick: int) -> tuple[int, ...]:
    """Return the number of bricks along each axis."""
    return tuple(-(-max(n - 1, 1) // brick) for n in shape)


def triple(values: npt.NDArray[np.floating]) -> tuple[float, float, float]:
    """Return three floats of Python."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def prepared(given: Array) -> Array:
    """Return samples for the kernels: of a supported type, at least two along each axis, without NaN.

    SuppleError if the squares of their gradients overflow float32.
    """
    if given.dtype.itemsize > 2:
        ends = np.array([given.min(), given.max()], np.float64)
        if not np.isfinite(ends).all():
            finite = np.isfinite(given)
            ends = np.array([given.min(where=finite, initial=np.inf), given.max(where=finite, initial=-np.inf)])
            ends = np.where(np.isfinite(ends), ends, 0.0).astype(np.float64)
        most = float(ends[np.abs(ends).argmax()])
        if abs(most) > MOST:
            refuse("samples", f"values from {-MOST:g} to {MOST:g} to be seen (divide larger ones)", float(f"{most:g}"))
    if given.dtype.newbyteorder("=") not in _TYPES:
        with np.errstate(over="ignore"):
            given = given.astype(np.float32)
    ready = np.require(given, given.dtype.newbyteorder("="), ["C", "ALIGNED"])
    if ready.dtype.kind == "f" and not np.isfinite(ready).all():
        finite = ready[np.isfinite(ready)]
        bottom, top = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
        ready = np.nan_to_num(ready, nan=bottom, neginf=bottom, posinf=top)
    if min(ready.shape) < 2:
        ready = np.pad(ready, [(0, 1 if n < 2 else 0) for n in ready.shape], mode="edge")
    return ready
