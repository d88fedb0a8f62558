"""Cubic B-splines through the samples of a grid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

POLE = math.sqrt(3.0) - 2.0  # of the filter that inverts the cubic B-spline's samples (1, 4, 1) / 6
HORIZON = 40  # samples after which the filter's response is below 1e-22


def coefficients(values: Array) -> Array:
    """Return the coefficients of the cubic B-spline through values that are mirrored about the ends of each axis.

    By the recursive filter of Unser, Aldroubi and Eden (1991), along one axis after the other.
    """
    made = np.empty_like(values)
    for component in range(values.shape[-1]):  # one by one, in float64 and little memory
        made[..., component] = _filtered(values[..., component].astype(np.float64))
    return made


def _filtered(made: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    for axis in range(made.ndim):
        c = np.moveaxis(made, axis, 0)
        n = len(c)
        if n == 1:
            continue
        mirrored = np.abs((np.arange(HORIZON) + n - 1) % (2 * n - 2) - n + 1)
        c[0] = np.tensordot(POLE ** np.arange(HORIZON), c[mirrored], 1)
        for k in range(1, n):
            c[k] += POLE * c[k - 1]
        c[-1] = POLE / (POLE * POLE - 1.0) * (c[-1] + POLE * c[-2])
        for k in range(n - 2, -1, -1):
            c[k] = POLE * (c[k + 1] - c[k])
        c *= 6.0
    return made
