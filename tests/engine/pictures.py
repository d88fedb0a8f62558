"""A deformation, numbers of all types, and where pixels come from."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import Deformation
from tests import reference

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
SHAPE = (45, 70)
FILTERS = ["nearest", "linear", "cubic", "auto"]


@functools.cache
def bent() -> Deformation:
    """It shrinks and magnifies, and reaches beyond the image on two sides."""
    d = Deformation(SHAPE, border=None, on_fold="damp").grab((30, 20), by=(14, -9), radius=16, reach=None)
    return d.grab((8, 30), by=(-6, 5), radius=9, scales=2, reach=None)


@functools.cache
def exact(d: Deformation) -> Floats:
    found = d.inverse(reference.grid(d.shape))
    assert found.converged.all()
    return found.points


def noise(dtype: npt.DTypeLike, channels: int, shape: tuple[int, int] = SHAPE, seed: int = 0) -> Array:
    """All of a type's range, and its very ends side by side."""
    rng, kind = np.random.default_rng(seed), np.dtype(dtype)
    size = (*shape, channels)
    if kind == np.bool_:
        return rng.uniform(size=size) < 0.5
    if kind.kind == "f":
        return (100 * rng.normal(size=size)).astype(kind)
    limits = np.iinfo(kind)
    values = rng.integers(limits.min, limits.max, size, kind, endpoint=True)
    values[::7], values[3::7] = limits.max, limits.min
    return values
