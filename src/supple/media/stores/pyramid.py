"""Levels of a multiscale image: the whole factors between them, their shapes on another grid, and their samples."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Mode = Literal["mean", "nearest"]


class Step(NamedTuple):
    """How an axis of a level comes from that of the level before."""

    factor: int
    down: bool  # whether an incomplete group of samples at the end is left out

    def size(self, before: int) -> int:
        """Return the number of samples that come from ``before`` of them."""
        return max(1, before // self.factor if self.down else -(-before // self.factor))


def step_of(before: int, after: int, ratio: float) -> Step | None:
    """Return the step between two sizes whose scales have a ratio; None if no whole factor explains it.

    The scale is asked first, since the sizes of short axes allow several factors. Some programs write the ratio of the
    sizes there (2.002), and some the same scale for all levels: then the sizes decide.
    """
    for factor in (max(1, round(ratio)), max(1, round(before / after))):
        for down in (False, True):
            step = Step(factor, down)
            if step.size(before) == after:
                return step
    return None


def reduced(values: Array, factors: Sequence[int], mode: Mode) -> Array:
    """Return an array made smaller by whole factors.

    Parameters
    ----------
    values : ndarray
        Samples. Where a factor does not divide the size, the last group has fewer samples.
    factors : sequence of int
        One for each axis.
    mode : {"mean", "nearest"}
        The mean of each group, rounded half to even for integers; or its first sample, for labels.

    Returns
    -------
    ndarray
        Of the same dtype.
    """
    if mode == "nearest":
        return np.ascontiguousarray(values[tuple(slice(None, None, factor) for factor in factors)])
    result = np.empty([-(-size // factor) for size, factor in zip(values.shape, factors, strict=True)], values.dtype)
    # parts in which all groups have the same number of samples: the whole groups, and the incomplete ones of each axis
    parts: list[list[tuple[slice, slice, int]]] = []
    for size, factor in zip(values.shape, factors, strict=True):
        whole, rest = divmod(size, factor)
        axis = [(slice(0, whole * factor), slice(0, whole), factor)] if whole else []
        axis += [(slice(whole * factor, size), slice(whole, whole + 1), rest)] if rest else []
        parts.append(axis)
    for chosen in product(*parts):
        read, written, counts = zip(*chosen, strict=True)
        result[written] = _mean(values[read], counts)
    return result


def _mean(values: Array, counts: tuple[int, ...]) -> Array:
    """Return the means of groups of ``counts`` samples, which divide the shape."""
    # an accumulator of the result's size, and strided views, need no more memory than the result
    groups = [values[tuple(map(slice, first, [None] * len(first), counts))] for first in np.ndindex(*counts)]
    n, dtype = len(groups), values.dtype
    if dtype.kind == "f":
        total = np.zeros(groups[0].shape, np.float64)
        for one in groups:
            total += one
        return np.asarray((total / n).astype(dtype))
    if dtype.kind == "b":
        return _mean(values.astype(np.uint8), counts).astype(dtype)
    if dtype.itemsize < 8:
        whole = np.zeros(groups[0].shape, np.int64)
        for one in groups:
            whole += one
        whole, rest = np.divmod(whole, n)
    else:  # sums of 64 bits would overflow: quotients and remainders do not
        wide = np.uint64 if dtype.kind == "u" else np.int64
        whole, rest = np.zeros(groups[0].shape, wide), np.zeros(groups[0].shape, wide)
        for one in groups:
            quotient, remainder = np.divmod(one.astype(wide), wide(n))
            whole += quotient
            rest += remainder
        more, rest = np.divmod(rest, wide(n))
        whole += more
    up = (rest > n // 2) if n % 2 else (rest > n // 2) | ((rest == n // 2) & (whole % 2 == 1))
    return np.asarray((whole + up.astype(whole.dtype)).astype(dtype))
