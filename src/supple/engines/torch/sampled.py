"""Sampled displacement fields in differentiable operations: values, slopes, and what the inverse's gradient is.

With i the index of a position, the map is i → i + w(i), where w is interpolated as in the core (`sampled.hpp`).

For a loss L of the points i(w) that are solutions of i + w(i) = q,

    dL/dw = -Sᵀ λ,    (I+J)ᵀ λ = ∂L/∂i,

where S interpolates at the points i, and J = ∂w/∂i there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import torch

from supple.engines.torch.field import Columns, solved
from supple.engines.torch.sample import Tap
from supple.splines import HORIZON, POLE


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Displacement fields of one shape.

    Parameters
    ----------
    values : float64 tensor, shape (D, N * M)
        The M samples of each of N fields, x first, in samples; or the coefficients of cubic B-splines.
    sizes : sequence of int
        The number of samples along each axis, x first.
    cubic : bool
        Whether the values are coefficients.
    edge : int
        The number of coefficients at each end of an axis that are beyond the field: 1, or 0.
    zero : bool
        Whether there is no displacement beyond the grid, instead of that of its edge.
    """

    values: torch.Tensor
    sizes: Sequence[int]
    cubic: bool = False
    edge: int = 0
    zero: bool = False

    @property
    def count(self) -> int:
        """The number of samples M of one field."""
        return prod(self.sizes)

    @property
    def fields(self) -> int:
        """The number of fields N."""
        return int(self.values.shape[1]) // self.count

    @property
    def ends(self) -> list[tuple[int, int]]:
        """For each axis, the first and the last index between which it is interpolated."""
        return [(self.edge, size - 1 - self.edge) for size in self.sizes]


def displaced(samples: Samples, points: Columns, base: torch.Tensor) -> tuple[Columns, list[Columns]]:
    """Return w at points, and the rows of I + J.

    Parameters
    ----------
    samples : Samples
    points : D float64 tensors of shape (P,)
        Indices, x first.
    base : int64 tensor, shape (P,)
        The number of the first sample of each point's field.
    """
    n = len(points)
    w = [torch.zeros_like(x) for x in points]
    rows = [[torch.full_like(points[0], float(a == b)) for b in range(n)] for a in range(n)]
    for tap in _taps(samples, points, base):
        values, weight = samples.values.index_select(1, tap.index), tap.weight()
        slopes = [tap.slope(axis) for axis in range(n)]
        for a in range(n):
            w[a] = w[a] + weight * values[a]
            rows[a] = [total + slope * values[a] for total, slope in zip(rows[a], slopes, strict=True)]
    return w, rows


def add_gradient(samples: Samples, points: Columns, base: torch.Tensor, slopes: Columns, into: torch.Tensor) -> None:
    """Add ∂L/∂values, for ∂L/∂points; it is differentiable in all that is given.

    Parameters
    ----------
    samples, points, base
        As in `displaced`; the points are solutions of i + w(i) = q, where I + J is not singular.
    slopes : D tensors of shape (P,)
        ∂L/∂points.
    into : tensor of the shape of the samples' values
    """
    _, rows = displaced(samples, points, base)
    weights = -torch.stack(solved(rows, slopes))
    for tap in _taps(samples, points, base):
        into.index_add_(1, tap.index, tap.weight() * weights)


def _taps(samples: Samples, points: Columns, base: torch.Tensor) -> Iterator[Tap]:
    axes, stride = [], 1
    for i, size, (first, last) in zip(points, samples.sizes, samples.ends, strict=True):
        c = i.clamp(first, last)
        inside = (c == i).to(i.dtype)
        whole = c.detach().long()
        if samples.cubic:
            left, weigh = 1, _cubic
        else:
            left, weigh = 0, _linear
            whole = whole.clamp(max=max(size - 2, 0))
        weights, slopes = weigh(c - whole)
        places = [mirrored(whole - left + k, size) * stride for k in range(len(weights))]
        axes.append(list(zip(places, weights, [s * inside for s in slopes], strict=True)))
        stride *= size
    for parts in itertools.product(*axes):
        index = base
        for place, _, _ in parts:
            index = index + place
        yield Tap(index, None, [part[1] for part in parts], [part[2] for part in parts])


def mirrored(k: torch.Tensor, size: int) -> torch.Tensor:
    """Return the samples that replace those beyond the ends of an axis: mirrored about the last one."""
    if size == 1:
        return torch.zeros_like(k)
    k = k.abs() % (2 * size - 2)
    return torch.minimum(k, 2 * size - 2 - k)


def _linear(f: torch.Tensor) -> tuple[Columns, Columns]:
    one = torch.ones_like(f)
    return [1 - f, f], [-one, one]


def _cubic(f: torch.Tensor) -> tuple[Columns, Columns]:
    g = 1 - f
    f2, g2 = f * f, g * g
    return [
        g2 * g / 6,
        (4 - f2 * (6 - 3 * f)) / 6,
        (4 - g2 * (6 - 3 * g)) / 6,
        f2 * f / 6,
    ], [-0.5 * g2, f * (1.5 * f - 2), g * (2 - 1.5 * g), 0.5 * f2]


def coefficients(values: torch.Tensor, axes: int) -> torch.Tensor:
    """Return the coefficients of the cubic B-splines through values, along the last axes.

    Values are mirrored about the ends, as in `supple.Field`. It is differentiable any number of times.
    """
    return _Prefilter.apply(values, axes)


def coefficients_gradient(gradient: torch.Tensor, axes: int) -> torch.Tensor:
    """Return ∂L/∂values for ∂L/∂coefficients, which is as differentiable."""
    ends = torch.ones(gradient.shape[-axes:], dtype=gradient.dtype, device=gradient.device)
    for axis, n in enumerate(ends.shape):
        if n > 1:
            for end in (0, -1):
                ends.select(axis, end).mul_(0.5)
    return ends * coefficients(gradient / ends, axes)


class _Prefilter(torch.autograd.Function):
    """The recursive filter of Unser, Aldroubi and Eden (1991), along one axis after the other.

    It is B⁻¹, where W B is symmetric, W = diag(1/2, 1, …, 1, 1/2): its transpose is W B⁻¹ W⁻¹.
    """

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, axes: int) -> torch.Tensor:
        ctx.axes = axes
        made = values.clone(memory_format=torch.contiguous_format)
        for axis in range(1, axes + 1):
            c = made.movedim(-axis, 0)
            n = len(c)
            if n == 1:
                continue
            steps = torch.arange(HORIZON, device=c.device)
            powers = POLE ** steps.to(c.dtype)
            c[0] = torch.tensordot(powers, c[mirrored(steps, n)], 1)
            for k in range(1, n):
                c[k] += POLE * c[k - 1]
            c[-1] = POLE / (POLE * POLE - 1) * (c[-1] + POLE * c[-2])
            for k in range(n - 2, -1, -1):
                c[k] = POLE * (c[k + 1] - c[k])
            c *= 6
        return made

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        return coefficients_gradient(gradient, ctx.axes), None
