"""Samples at source points, and the gradients with respect to samples and points.

A source point is a whole pixel and a fraction, so that large coordinates do not reduce the accuracy of weights.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod

import torch

from supple.engines.torch.field import Columns

_SUPPORT = {"nearest": (0, 1), "linear": (0, 2), "cubic": (-1, 3), "catmull-rom": (-1, 3)}
_KEYS = {"cubic": -0.75, "catmull-rom": -0.5}  # the slope of the kernel at 1


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """The filter of an array.

    Parameters
    ----------
    sizes : sequence of int
        The sizes of the array's axes, x first.
    kinds : sequence of str
        For each axis, ``"nearest"``, ``"linear"``, ``"cubic"`` or ``"catmull-rom"``: Keys' kernel with a = -0.75, and
        with -0.5, which is used between frames.
    outside : str
        Boundary mode: ``"edge"``, ``"constant"`` or ``"reflect"``.
    fill : tensor of floats, shape (K, 1)
        The fill value, for each channel.
    """

    sizes: Sequence[int]
    kinds: Sequence[str]
    outside: str
    fill: torch.Tensor

    @property
    def smooth(self) -> bool:
        """True if values depend on the fraction of a point."""
        return any(kind != "nearest" for kind in self.kinds)


@dataclass(frozen=True, slots=True, eq=False)
class Tap:
    """A sample of each value: its index, a mask of those inside, its weights and their derivatives by axis."""

    index: torch.Tensor
    inside: torch.Tensor | None
    weights: Columns
    slopes: Columns

    def weight(self) -> torch.Tensor:
        """Return the product of the weights along the axes."""
        return prod(self.weights[1:], start=self.weights[0])

    def slope(self, axis: int) -> torch.Tensor:
        """Return the derivative of `weight` along an axis."""
        return prod((w for k, w in enumerate(self.weights) if k != axis), start=self.slopes[axis])


def read(source: torch.Tensor, whole: Columns, rest: Columns, how: Filter) -> torch.Tensor:
    """Return the filtered values at points.

    Parameters
    ----------
    source : tensor, shape (K, M)
        K channels of all samples.
    whole, rest : D tensors of shape (P,), x first
        The points, in pixels, as integers and fractions from 0 to 1. The type of the floats is the working type.
    how : Filter

    Returns
    -------
    tensor, shape (K, P)
    """
    total = torch.zeros(len(source), len(whole[0]), dtype=rest[0].dtype, device=source.device)
    for tap in _taps(whole, rest, how):
        total += tap.weight() * _values(source, tap, how, total.dtype)
    return total


def spread(
    gradient: torch.Tensor,
    source: torch.Tensor | None,
    whole: Columns,
    rest: Columns,
    how: Filter,
    into: torch.Tensor | None,
) -> Columns:
    """Compute the gradients of `read`: add ∂L/∂source to ``into`` (K, M), if given, and return ∂L/∂points.

    Parameters
    ----------
    gradient : tensor, shape (K, P)
        ∂L/∂values, for the values from `read`.
    source : tensor, shape (K, M), or None
        If None, an empty list is returned for the points.
    whole, rest, how
        As in `read`.
    """
    found = [torch.zeros_like(x) for x in rest] if source is not None else []
    for tap in _taps(whole, rest, how):
        if into is not None:
            weight = tap.weight()
            into.index_add_(1, tap.index, gradient * (weight if tap.inside is None else weight * tap.inside))
        if source is not None:
            seen = (gradient * _values(source, tap, how, gradient.dtype)).sum(0)
            for axis, total in enumerate(found):
                total += seen * tap.slope(axis)
    return found


def _values(source: torch.Tensor, tap: Tap, how: Filter, dtype: torch.dtype) -> torch.Tensor:
    values = source.index_select(1, tap.index).to(dtype)
    return values if tap.inside is None else torch.where(tap.inside, values, how.fill)


def _taps(whole: Columns, rest: Columns, how: Filter) -> Iterator[Tap]:
    strides = itertools.accumulate((1, *how.sizes[:-1]), lambda a, b: a * b)
    axes = []
    for i, t, size, stride, kind in zip(whole, rest, how.sizes, strides, how.kinds, strict=True):
        if kind == "nearest":
            i = i + (t >= 0.5)
        first, last = _SUPPORT[kind]
        placed = [_place(i + k, size, how.outside) for k in range(first, last)]
        axes.append([(j * stride, inside, w, s) for (j, inside), w, s in zip(placed, *_weights(t, kind), strict=True)])
    for parts in itertools.product(*axes):
        inside = [part[1] for part in parts if part[1] is not None]
        yield Tap(
            sum(part[0] for part in parts[1:]) + parts[0][0],
            prod(inside[1:], start=inside[0]) if inside else None,
            [part[2] for part in parts],
            [part[3] for part in parts],
        )


def _place(i: torch.Tensor, n: int, outside: str) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Return the indices that replace ``i``, and the mask of those inside, for a constant."""
    if outside == "reflect":
        k = i % (2 * n)
        return torch.minimum(k, 2 * n - 1 - k), None
    return i.clamp(0, n - 1), (i >= 0) & (i < n) if outside == "constant" else None


def _weights(t: torch.Tensor, kind: str) -> tuple[Columns, Columns]:
    """Return the weights of an axis' samples at ``t`` between two of them, and their derivatives."""
    one = torch.ones_like(t)
    if kind == "nearest":
        return [one], [torch.zeros_like(t)]
    if kind == "linear":
        return [1 - t, t], [-one, one]
    a, u = _KEYS[kind], 1 - t
    return [
        a * t * u * u,
        ((a + 2) * t - (a + 3)) * t * t + 1,
        ((a + 2) * u - (a + 3)) * u * u + 1,
        a * u * t * t,
    ], [
        a * u * (1 - 3 * t),
        (3 * (a + 2) * t - 2 * (a + 3)) * t,
        (2 * (a + 3) - 3 * (a + 2) * u) * u,
        a * t * (2 - 3 * t),
    ]
