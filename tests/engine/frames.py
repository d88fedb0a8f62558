"""Deformations of a clip, numbers of all types, and where pixels come from."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import Deformation
from tests import reference

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
SHAPE = (7, 37, 50)
FILTERS = ["nearest", "linear", "cubic", "auto"]
BETWEEN = ["nearest", "linear", "cubic"]
RULES = ["edge", "constant", "reflect"]


@functools.cache
def exact(d: Deformation) -> Floats:
    found = d.inverse(reference.grid(d.shape))
    assert found.converged.all()
    return found.points


def top_of(dtype: npt.DTypeLike) -> float:
    kind = np.dtype(dtype)
    return float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0


def noise(dtype: npt.DTypeLike, channels: int, shape: tuple[int, ...] = SHAPE, seed: int = 0) -> Array:
    rng, kind = np.random.default_rng(seed), np.dtype(dtype)
    size = (*shape, channels)
    if kind == np.bool_:
        return rng.uniform(size=size) < 0.5
    if kind.kind == "f":
        return (100 * rng.normal(size=size)).astype(kind)
    limits = np.iinfo(kind)
    return rng.integers(limits.min, limits.max, size, kind.newbyteorder("="), endpoint=True).astype(kind)


@functools.cache
def hurried() -> Deformation:
    """Time runs several times as fast behind a drag."""
    return Deformation((60, 40, 70), on_fold="flow", border=64).grab((35, 20, 15), by=(4, 2, 28), radius=25, reach=None)
