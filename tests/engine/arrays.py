"""Deformations of an image and of a clip, numbers of all types, and where pixels come from."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import Deformation
from tests import reference

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
IMAGE, CLIP = (45, 70), (7, 37, 50)
FILTERS = ["nearest", "linear", "cubic", "auto"]
BETWEEN = ["nearest", "linear", "cubic"]
RULES = ["edge", "constant", "reflect"]


@functools.cache
def bent(shape: tuple[int, ...] = IMAGE) -> Deformation:
    """It shrinks and magnifies, and reaches beyond the image on two sides, or beyond the clip on all."""
    d = Deformation(shape, border=None, on_fold="damp")
    if shape == IMAGE:
        d = d.grab((30, 20), by=(14, -9), radius=16, reach=None)
        return d.grab((8, 30), by=(-6, 5), radius=9, scales=2, reach=None)
    d = d.grab((20, 18, 3), by=(10, -7, 3), radius=14, reach=None)
    return d.grab((45, 30, 5), by=(-5, 6, -2.5), radius=9, scales=2, reach=None)


@functools.cache
def hurried() -> Deformation:
    """Time runs several times as fast behind a drag."""
    return Deformation((60, 40, 70), on_fold="flow", border=64).grab((35, 20, 15), by=(4, 2, 28), radius=25, reach=None)


@functools.cache
def exact(d: Deformation) -> Floats:
    found = d.inverse(reference.grid(d.shape))
    assert found.converged.all()
    return found.points


def top_of(dtype: npt.DTypeLike) -> float:
    kind = np.dtype(dtype)
    return float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0


def noise(dtype: npt.DTypeLike, channels: int, shape: tuple[int, ...] = IMAGE, seed: int = 0) -> Array:
    """All of a type's range; in an image, its very ends side by side."""
    rng, kind = np.random.default_rng(seed), np.dtype(dtype)
    size = (*shape, channels)
    if kind == np.bool_:
        return rng.uniform(size=size) < 0.5
    if kind.kind == "f":
        return (100 * rng.normal(size=size)).astype(kind)
    limits = np.iinfo(kind)
    values = rng.integers(limits.min, limits.max, size, kind.newbyteorder("="), endpoint=True).astype(kind)
    if len(shape) == 2:
        values[::7], values[3::7] = limits.max, limits.min
    return values


def same(out: Array, values: Floats, span: float, leeway: float) -> None:
    """Whether ``out`` holds ``values``, bounded and rounded as its type does, up to a part of their span."""
    off = leeway * span
    if out.dtype == np.bool_:
        clear = np.abs(values - 0.5) > leeway
        assert (out == (values >= 0.5))[clear].all()
        return
    if out.dtype.kind in "iu":
        limits = np.iinfo(out.dtype)
        values, off = np.clip(values, float(limits.min), float(limits.max)), off + 0.5
    elif out.dtype == np.float16:
        off += 2**-11 * np.abs(values).max()
    assert np.abs(out.astype(np.float64) - values).max() <= off
