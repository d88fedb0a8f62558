"""Functions shared by all gradients: the samples around points, their weights, and λ of Mᵀ λ = g."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

Kernel = tuple[int, list[list[float]]]


def _keys(a: float) -> Kernel:
    """Return Keys' kernel, of the slope ``a`` at 1."""
    return -1, [[0, a, -2 * a, a], [1, 0, -a - 3, a + 2], [0, -a, 2 * a + 3, -a - 2], [0, 0, a, -a]]


# The first sample around a point, relative to its whole part, and the weights of all: polynomials of the fraction.
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
    """The T samples around each of P points: their indices, and whether they are in the array (None: all), both (T, P).

    ``rest`` are the fractional parts of the points (D, P), and ``kinds`` the kernels along the axes.
    """

    index: torch.Tensor
    inside: torch.Tensor | None
    rest: torch.Tensor
    kinds: Sequence[str]

    def weights(self, along: int | None = None) -> torch.Tensor:
        """Return the weights (T, P), or their derivatives along an axis; differentiable in the fractions."""
        each = []
        for k, (t, kind) in enumerate(zip(self.rest, self.kinds, strict=True)):
            rows = _KERNELS[kind][1]
            if k == along:
                rows = [[n * c for n, c in enumerate(row)][1:] or [0] for row in rows]
            each.append(torch.stack([_polynomial(t, row) for row in rows]))
        return functools.reduce(lambda before, own: (own[:, None] * before).flatten(0, 1), each)

    def samples(self, source: torch.Tensor, fill: float | Sequence[float] = ()) -> torch.Tensor:
        """Return the samples (K, T, P) of a source (K, M); those outside are the K fill values."""
        samples = source.index_select(-1, self.index.flatten()).unflatten(-1, self.index.shape)
        if self.inside is None:
            return samples
        return torch.where(self.inside, samples, samples.new_tensor(fill)[:, None, None])

    def between(self, samples: torch.Tensor) -> torch.Tensor:
        """Return the interpolant (..., P) of samples (..., T, P)."""
        return (samples * self.weights()).sum(-2)

    def slopes(self, samples: torch.Tensor) -> torch.Tensor:
        """Return the derivatives (D, ..., P) of the interpolant of samples (..., T, P)."""
        return torch.stack([(samples * self.weights(axis)).sum(-2) for axis in range(len(self.kinds))])

    def scatter(self, values: torch.Tensor, into: torch.Tensor) -> None:
        """Add values (K, P) to an array (K, M) by the adjoint of interpolation."""
        weights = self.weights() if self.inside is None else self.weights() * self.inside
        into.index_add_(1, self.index.flatten(), (values[:, None] * weights).flatten(1))


def _polynomial(t: torch.Tensor, row: Sequence[float]) -> torch.Tensor:
    value = torch.full_like(t, row[-1])
    for c in row[-2::-1]:
        value = value * t + c
    return value


def around(whole: torch.Tensor, rest: torch.Tensor, sizes: Sequence[int], kinds: Sequence[str], outside: str) -> Taps:
    """Return the samples around points in an array, whose sizes and kernels are given x first.

    Points are whole samples (int64) and fractions from 0 to 1, both (D, P), so that large coordinates do not reduce the
    accuracy of weights. The boundary mode is ``"edge"``, ``"constant"``, or the mirror image about the edge of the last
    sample (``"reflect"``) or its centre (``"mirror"``).
    """
    index, inside, stride = torch.zeros_like(whole[:1]), None, 1
    for i, t, size, kind in zip(whole, rest, sizes, kinds, strict=True):
        first, rows = _KERNELS[kind]
        i = i + (t >= 0.5) if kind == "nearest" else i
        i = torch.stack([i + first + k for k in range(len(rows))])
        if outside == "constant":
            within = (i >= 0) & (i < size)
            inside = within if inside is None else (within[:, None] & inside).flatten(0, 1)
        if outside in ("reflect", "mirror"):
            twice = outside == "reflect"  # the mirrored last sample is repeated
            period = max(2 * size - 2 + 2 * twice, 1)
            i = torch.minimum(i % period, period - twice - i % period)
        index = ((i.clamp(0, size - 1) * stride)[:, None] + index).flatten(0, 1)
        stride *= size
    return Taps(index, inside, rest, kinds)


def adjoint(rows: torch.Tensor, g: torch.Tensor) -> torch.Tensor:
    """Return λ (D, P) of Mᵀ λ = g, for matrices M (D, D, P), by Cramer's rule."""
    if len(g) == 2:
        (a, b), (c, d) = rows
        return torch.stack([g[0] * d - g[1] * c, a * g[1] - b * g[0]]) / (a * d - b * c)
    crosses = [torch.linalg.cross(rows[k - 2], rows[k - 1], dim=0) for k in range(3)]
    return torch.stack([(g * cross).sum(0) for cross in crosses]) / (rows[0] * crosses[0]).sum(0)
