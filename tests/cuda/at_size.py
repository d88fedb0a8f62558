"""What the tests at size share: large smooth arrays, strokes, and how far results may be apart.

``SUPPLE_TEST_CUDA_SCALE`` divides all sides: by 1 on a real GPU, by 12 on one that is played in memory.
"""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import FoldWarning, ToleranceWarning
from tests.cuda.driver import REAL, on_host

SCALE = int(os.environ.get("SUPPLE_TEST_CUDA_SCALE", "1" if REAL else "12"))
TIGHT = 1e-4  # pixels: so that what differs is not where points are
CLOSE = 1e-3  # of the range

only_on_a_card = pytest.mark.skipif(not REAL, reason="needs an NVIDIA GPU: make test-cuda")


def sized(*shape: int) -> tuple[int, ...]:
    """A shape at the size that is asked for."""
    return tuple(max(6, n // SCALE) for n in shape)


def bent(shape: tuple[int, ...], seed: int = 0, count: int = 3, **options: Any) -> supple.Deformation:
    """Some strokes of all kinds, strong enough to carry what lies outside into view."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    d = supple.Deformation(shape, **{"border": None, **options})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        for k in range(count):
            d = d.grab(
                rng.uniform(0.25, 0.75, len(shape)) * size,
                by=rng.normal(0, 0.07, len(shape)) * size,
                radius=float(rng.uniform(0.2, 0.5) * size.max()),
                scales=1 + k % 3,
                poisson=(0.4, 0.5, 0.1)[k % 3],
                reach=None,
            )
    return d


def waves(shape: tuple[int, ...], channels: int = 0) -> np.ndarray:
    """Smooth values from 0 to 1: waves of 40 to 70 pixels."""
    whole = (*shape, max(channels, 1))
    total = np.zeros(whole, np.float32)
    for axis, n in enumerate(shape):
        places = np.arange(n, dtype=np.float64).reshape([-1 if k == axis else 1 for k in range(len(whole))])
        total += np.sin((0.09 + 0.03 * axis) * places + np.arange(whole[-1]) + axis).astype(np.float32)
    out = np.asarray(0.5 + total / (2 * len(shape)))
    return out if channels else out[..., 0]


def typed(values: np.ndarray, dtype: Any) -> np.ndarray:
    """Values from 0 to 1 in the numbers of a type, over nearly all of its range."""
    kind = np.dtype(dtype)
    if kind == np.bool_:
        return values > 0.5
    if kind.kind == "f":
        return values.astype(kind)
    low, top = (0.96 * min(max(float(x), -(2.0**62)), 2.0**62) for x in (np.iinfo(kind).min, np.iinfo(kind).max))
    return np.rint(low + values.astype(np.float64) * (top - low)).astype(kind)


def labels(shape: tuple[int, ...], channels: int, dtype: Any, seed: int = 0) -> np.ndarray:
    """Values between which there is nothing, in no order."""
    drawn = np.random.default_rng(seed).integers(
        0, 2 if np.dtype(dtype) == np.bool_ else 100, (*shape, max(channels, 1))
    )
    return (drawn if channels else drawn[..., 0]).astype(dtype)


def host(array: Any) -> np.ndarray:
    """An array of any of the libraries."""
    if isinstance(array, np.ndarray):
        return array
    if hasattr(array, "detach"):  # PyTorch's
        return np.asarray(array.detach().cpu())
    if hasattr(array, "copy_to_host"):  # Numba's
        return np.asarray(array.copy_to_host())
    return np.asarray(array.get()) if hasattr(array, "get") else on_host(array)


def both(there: Any, source: np.ndarray, d: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """What the GPU and the CPU make of an array, or of a batch with a deformation each, as exactly as they can."""
    options = {"tolerance": TIGHT, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)  # finer than float32 holds points, on either of them
        if isinstance(d, supple.Deformation):
            return host(d.warp(there, **options)), d.warp(source, **options)
        return host(supple.warp_batch(there, d, **options)), supple.warp_batch(source, d, **options)


def apart(made: np.ndarray, wanted: np.ndarray, source: np.ndarray) -> np.ndarray:
    """How far each value is beyond a rounding from what is wanted, in parts of the range."""
    assert (made.dtype, made.shape) == (wanted.dtype, wanted.shape)
    kind = source.dtype
    extent = float(source.max()) - float(source.min())
    rounding = 1.0 if kind.kind in "iu" else extent * 2.0**-11 if kind == np.float16 else 0.0
    off = np.abs(made.astype(np.float64) - wanted.astype(np.float64)) - rounding
    return np.asarray(np.maximum(off, 0) / max(extent, 1e-30))


def near_a_boundary(d: supple.Deformation) -> np.ndarray:
    """Of each pixel, whether its source point lies within 1e-3 of where another sample is the nearest."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        points = d.inverse_map(tolerance=TIGHT).astype(np.float64)
    return np.asarray((np.abs(points % 1 - 0.5) < 1e-3).any(axis=-1))
