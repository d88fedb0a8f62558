"""The samples around points, and their weights: in pictures, in displacement fields, and in freeze masks.

A point is a whole sample and a fraction, so that large coordinates do not reduce the accuracy of weights.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from supple.space.splines import HORIZON, POLE

Columns = list[torch.Tensor]  # one for each coordinate, x first
Kernel = tuple[int, list[list[float]]]


def _keys(a: float) -> Kernel:
    """Return Keys' kernel, of the slope ``a`` at 1."""
    return -1, [[0, a, -2 * a, a], [1, 0, -a - 3, a + 2], [0, -a, 2 * a + 3, -a - 2], [0, 0, a, -a]]


# The first of the samples around a point, from the whole one, and the weights of all: polynomials of the fraction.
_KERNELS: dict[str, Kernel] = {
    "nearest": (0, [[1]]),
    "linear": (0, [[1, -1], [0, 1]]),
    "cubic": _keys(-0.75),
    "catmull-rom": _keys(-0.5),  # which is used between frames
    "bspline": (-1, [[x / 6 for x in row] for row in ([1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1])]),
}


def count(kinds: Sequence[str]) -> int:
    """Return the number of samples around a point."""
    return math.prod(len(_KERNELS[kind][1]) for kind in kinds)


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """The T samples around each of P points.

    Parameters
    ----------
    index : int64 tensor, shape (T, P)
    inside : bool tensor, shape (T, P), or None
        Which are in the array; None if all are taken from it.
    rest : D tensors of shape (P,)
        The fractions.
    kinds : D names of kernels
    """

    index: torch.Tensor
    inside: torch.Tensor | None
    rest: Columns
    kinds: Sequence[str]

    def weights(self, along: int | None = None) -> torch.Tensor:
        """Return the weights (T, P), or their derivatives along an axis; differentiable in the fractions."""
        made = []
        for k, (t, kind) in enumerate(zip(self.rest, self.kinds, strict=True)):
            rows = _KERNELS[kind][1]
            if k == along:
                rows = [[n * c for n, c in enumerate(row)][1:] or [0] for row in rows]
            made.append(torch.stack([_polynomial(t, row) for row in rows]))
        return functools.reduce(lambda before, own: (own[:, None] * before).flatten(0, 1), made)

    def values(self, source: torch.Tensor, fill: torch.Tensor | None = None) -> torch.Tensor:
        """Return the samples (K, T, P) of a source (K, M); those outside are ``fill``, of shape (K, 1, 1)."""
        made = source.index_select(-1, self.index.flatten()).unflatten(-1, self.index.shape)
        return made if self.inside is None else torch.where(self.inside, made, fill)


def around(whole: Columns, rest: Columns, sizes: Sequence[int], kinds: Sequence[str], outside: str) -> Taps:
    """Return the samples around points.

    Parameters
    ----------
    whole, rest : D tensors of shape (P,), x first
        The points, in samples, as integers and fractions from 0 to 1.
    sizes : sequence of int
        Those of the array's axes, x first.
    kinds : sequence of str
        A kernel for each axis.
    outside : str
        What is beyond the array: its ``"edge"``, a ``"constant"``, or its mirror image, about the edge of the last
        sample (``"reflect"``) or its centre (``"mirror"``).
    """
    index, inside, stride = None, None, 1
    for i, t, size, kind in zip(whole, rest, sizes, kinds, strict=True):
        first, rows = _KERNELS[kind]
        i = i + (t >= 0.5) if kind == "nearest" else i
        i = torch.stack([i + first + k for k in range(len(rows))])
        if outside == "constant":
            within = (i >= 0) & (i < size)
            inside = within if inside is None else (within[:, None] & inside).flatten(0, 1)
        i = _place(i, size, outside) * stride
        index = i if index is None else (i[:, None] + index).flatten(0, 1)
        stride *= size
    assert index is not None
    return Taps(index, inside, rest, kinds)


def _place(i: torch.Tensor, n: int, outside: str) -> torch.Tensor:
    if outside not in ("reflect", "mirror"):
        return i.clamp(0, n - 1)
    twice = outside == "reflect"  # the last sample
    period = max(2 * n - 2 + 2 * twice, 1)
    k = i % period
    return torch.minimum(k, period - twice - k)


def _polynomial(t: torch.Tensor, row: Sequence[float]) -> torch.Tensor:
    made = torch.full_like(t, row[-1])
    for c in row[-2::-1]:
        made = made * t + c
    return made


def coefficients(values: torch.Tensor, axes: int) -> torch.Tensor:
    """Return the coefficients of the cubic B-splines through values, along the last axes.

    By the filter of `supple.space.splines`; it is differentiable any number of times.
    """
    steps = torch.arange(HORIZON, device=values.device)
    for axis in range(1, axes + 1):
        v = values.movedim(-axis, 0)
        if len(v) > 1:
            there = [torch.tensordot(POLE ** steps.to(v.dtype), v[_place(steps, len(v), "mirror")], 1)]
            for x in v[1:]:
                there.append(torch.add(x, there[-1], alpha=POLE))
            back = [POLE / (POLE * POLE - 1) * torch.add(there[-1], there[-2], alpha=POLE)]
            for x in there[-2::-1]:
                back.append(POLE * (back[-1] - x))
            values = 6 * torch.stack(back[::-1]).movedim(0, -axis)
    return values
