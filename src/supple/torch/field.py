"""T in differentiable operations, and the gradients of T⁻¹ by the implicit function theorem.

Of one stroke, in physical units, with r = p - pivot, s = |r|² and p taken into the domain where its border is fixed,

    K(p) = diag(β) m(√s/R) [A(s) v + B(s) (r·v) r],    m(t) = (1-t)³ (1 + 3t + 6t²) for t < 1, 0 beyond,

times the m of a freeze mask (`freedom`), where v is the force f of a grab, or M r. A twist has R r - r in place of what
is after diag(β), with the rotation R by the angle m(√s/R) A(s). Strokes that act at once move one point, and their
displacements are added.

An image is the plane z = 0 of a volume, without displacement along z.

For a loss L of the points p(θ) = T⁻¹(q; θ), T(p; θ) = q gives

    dL/dθ = -Σ_q λᵀ ∂T(p; θ)/∂θ,    (I+J)ᵀ λ = ∂L/∂p,

at fixed p, independently of the solver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch

from supple.engine.work import Space
from supple.errors import SuppleError
from supple.folding.strain import Mask
from supple.space.domain import PROFILE_CODES
from supple.torch.taps import Columns, around

# For one, two and three scales: the weights of a stroke's terms, and their radii over ε.
_WEIGHTS = {1: (1.0,), 2: (11.0, -11.0), 3: (14641 / 331, -26741 / 331, 12100 / 331)}
_RADII = (1.0, 1.1, 1.21)

_SINE = PROFILE_CODES["sine"]

Axis = tuple[float, float, float, float, float]  # first, last, sigma and spacing in physical units, and the profile


@dataclass(frozen=True, slots=True)
class Kind:
    """What of a stroke has no gradients.

    Parameters
    ----------
    ratio : float
        b/a of its material.
    scales : int
    reach : float
        In radii, infinite without a limit.
    part : float
        The applied fraction of its force.
    matrix : sequence of D rows, or None
        ∂K/∂p at the pivot of a brush that is affine there, in physical units; of a twist, that of the cross
        product with its axis.
    angle : float
        Of a twist, in radians.
    turn : sequence of D numbers, or None
        Of a twist, the factors of its displacement.
    joined : bool
        Whether it acts at once with the stroke before it.
    """

    ratio: float
    scales: int
    reach: float
    part: float = 1.0
    matrix: Sequence[Sequence[float]] | None = None
    angle: float = 0.0
    turn: Sequence[float] | None = None
    joined: bool = False

    @classmethod
    def of(cls, row: np.void, ndim: int, part: float = 1.0) -> Kind:
        """Return what a row of a table says."""
        e, p, q, r = (float(row[name][0]) for name in ("radius2", "p", "q", "r"))
        return cls(
            r * e / (2 * q) if r else 0.0,
            int(row["terms"]),
            float(row["reach"]) / math.sqrt(e),
            part,
            matrix=row["matrix"][:ndim, :ndim].tolist() if row["power"] == 3 else None,
            angle=2.5 * p / e**1.5,
            turn=row["turn"][:ndim].tolist() if row["turn"].any() else None,
            joined=bool(row["joined"]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """m(p), what a freeze mask lets through: a cubic B-spline, differentiable any number of times in the points.

    Parameters
    ----------
    values : tensor of floats, shape (nx * ny * nz,)
        The coefficients, from 0 to 1.
    sizes : sequence of int
        Their number along each axis; 1 where m does not vary.
    first, step : sequence of float
        The position of the first one, and the distance from one to the next, in physical units.
    """

    values: torch.Tensor
    sizes: Sequence[int]
    first: Sequence[float]
    step: Sequence[float]

    @classmethod
    def of(cls, mask: Mask | None, dtype: torch.dtype, device: torch.device) -> Self | None:
        """Return a mask in a type, on a device; None for none."""
        if mask is None:
            return None
        values = torch.tensor(mask.coefficients / 255, dtype=dtype, device=device)
        return cls(values.flatten(), values.shape[::-1], mask.first.tolist(), mask.step.tolist())

    def at(self, points: Columns) -> torch.Tensor:
        """Return m of points in physical units: D tensors of one shape."""
        whole, rest, sizes = [], [], self.sizes[: len(points)]
        for x, n, first, step in zip(points, sizes, self.first, self.step, strict=False):
            place = ((x - first) / step).clamp(1, n - 2) if n > 1 else torch.zeros_like(x)
            whole.append(place.detach().long().clamp(max=max(n - 3, 0)))
            rest.append(place - whole[-1])
        taps = around(whole, rest, sizes, ["bspline" if n > 1 else "nearest" for n in sizes], "edge")
        return (taps.values(self.values) * taps.weights()).sum(0)


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Strokes as tensors: composed in order, they make T.

    Parameters
    ----------
    at, by : tensors of floats, shape (n, D)
        In pixels, x first.
    radius : tensor of floats, shape (n,)
        In physical units.
    kinds : sequence of Kind
        The rest of each stroke.
    axes : sequence of (float, float, float, float)
        Extent, width of the fixed border (-1 where it is free), spacing and the border's profile along each axis, as
        in `Domain.packed`.
    flows : bool
        Whether strokes are corrected for a fixed border, so that they reach their targets.
    freedom : Freedom, optional
        The freeze mask, which has no gradients.
    """

    at: torch.Tensor
    by: torch.Tensor
    radius: torch.Tensor
    kinds: Sequence[Kind]
    axes: Sequence[Axis]
    flows: bool = False
    freedom: Freedom | None = None

    @classmethod
    def of(cls, space: Space, dtype: torch.dtype, device: torch.device) -> Strokes:
        """Return the strokes of a space as engines apply them, row by row; SuppleError if it has other maps."""
        if not space.is_plain:
            raise SuppleError(
                "supple.torch.forward is for strokes alone, found a deformation with fields or affine maps: "
                "Deformation.forward takes it, without gradients"
            )
        table, n = space.table, space.ndim
        columns = [table[name][:, :n] / space.axes[:n, 3] for name in ("pivot", "force")]
        at, by, radius = (
            torch.tensor(x, dtype=dtype, device=device) for x in (*columns, table["radius2"][:, 0] ** 0.5)
        )
        kinds = [Kind.of(row, n) for row in table]
        freedom = Freedom.of(space.freeze, dtype, device)
        return cls(at, by, radius, kinds, axes_of(space), freedom=freedom)


def axes_of(space: Space) -> list[Axis]:
    """Return the rows of a packed domain, one for each coordinate."""
    return [(row[0], row[1], row[2], row[3], row[4]) for row in space.axes[: space.ndim].tolist()]


def moved(points: Columns, strokes: Strokes) -> Columns:
    """Return T of points, both in physical units: D tensors of one shape."""
    start = points
    for k, kind in enumerate(strokes.kinds):
        start = start if kind.joined else points
        pivot = [x * axis[3] for x, axis in zip(strokes.at[k], strokes.axes, strict=True)]
        near, beta = _edges(start, strokes.axes)
        r = [x - p for x, p in zip(near, pivot, strict=True)]
        s = _dot(r, r)
        a, b = _profiles(s, strokes.radius[k], kind)
        if kind.reach < math.inf:
            m = _support(s / (strokes.radius[k] * kind.reach) ** 2)
            a, b = m * a, m * b
        if kind.matrix is None:
            v: Columns = [x * (axis[3] * kind.part) for x, axis in zip(strokes.by[k], strokes.axes, strict=True)]
        else:
            v = _product(kind.matrix, r)
            if kind.turn is not None:
                angle = kind.angle * a
                once, twice = torch.sin(angle), 2 * torch.sin(angle / 2) ** 2
                v = [f * (once * x + twice * y) for f, x, y in zip(kind.turn, v, _product(kind.matrix, v), strict=True)]
                a = torch.ones_like(a)  # and b is 0
        if strokes.flows:
            v = _arriving(pivot, v, strokes.axes)
        if strokes.freedom is not None:
            m = strokes.freedom.at(near)
            a, b = m * a, m * b
        b = b * _dot(r, v)
        points = [x + weight * (a * w + b * d) for x, weight, w, d in zip(points, beta, v, r, strict=True)]
    return points


def strokes_gradients(points: Columns, adjoint: Columns, strokes: Strokes) -> list[torch.Tensor]:
    """Return the parts of ∂L/∂at, ∂L/∂by and ∂L/∂radius from points p = T⁻¹(q) and λ there, both in pixels."""
    with torch.enable_grad():
        leaves = [x.detach().requires_grad_() for x in (strokes.at, strokes.by, strokes.radius)]
        given = replace(strokes, at=leaves[0], by=leaves[1], radius=leaves[2])
        seen = moved([x * axis[3] for x, axis in zip(points, strokes.axes, strict=True)], given)
    weights = [-x / axis[3] for x, axis in zip(adjoint, strokes.axes, strict=True)]
    return list(torch.autograd.grad(seen, leaves, weights, materialize_grads=True))


def solved(rows: Sequence[Sequence[torch.Tensor]], g: Columns) -> Columns:
    """Return λ of Mᵀ λ = g, M given by its rows, by Cramer's rule, for all points at once."""
    if len(g) == 2:
        (a, b), (c, d) = rows
        scale = 1 / (a * d - b * c)
        return [scale * (g[0] * d - g[1] * c), scale * (a * g[1] - b * g[0])]
    crosses = [_cross(rows[1], rows[2]), _cross(rows[2], rows[0]), _cross(rows[0], rows[1])]
    scale = 1 / _dot(rows[0], crosses[0])
    return [scale * _dot(g, cross) for cross in crosses]


def _dot(a: Sequence[torch.Tensor], b: Sequence[torch.Tensor]) -> torch.Tensor:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _product(matrix: Sequence[Sequence[float]], x: Columns) -> Columns:
    return [sum((m * c for m, c in zip(row, x, strict=True)), torch.zeros_like(x[0])) for row in matrix]


def _cross(a: Sequence[torch.Tensor], b: Sequence[torch.Tensor]) -> Columns:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _profiles(distance2: torch.Tensor, radius: torch.Tensor, kind: Kind) -> tuple[torch.Tensor, torch.Tensor]:
    """Return A and B, summed over the stroke's terms."""
    a, b, ratio = torch.zeros_like(distance2), torch.zeros_like(distance2), kind.ratio
    if kind.matrix is not None:
        e = radius**2
        w2 = e / (distance2 + e)
        w3 = w2 * torch.sqrt(w2) / (2.5 - 2 * ratio)
        return w3 * ((1 - 2 * ratio) + 1.5 * w2), 3 * ratio * w3 * w2 / e
    size = radius * (2 / (3 - 2 * ratio))
    for weight, wider in zip(_WEIGHTS[kind.scales], _RADII, strict=False):
        e = (radius * wider) ** 2
        v2 = 1 / (distance2 + e)
        v = torch.sqrt(v2) * (size * weight)
        a = a + v * ((1 - ratio) + 0.5 * e * v2)
        b = b + ratio * v * v2
    return a, b


def _support(share2: torch.Tensor) -> torch.Tensor:
    """Return m(t) of t²."""
    # The root has no derivative at 0, where that of m is 0.
    t = share2.clamp(1e-30, 1).sqrt()
    return (1 - t) ** 3 * (1 + (3 + 6 * t) * t)


def _edges(points: Columns, axes: Sequence[Axis]) -> tuple[Columns, Columns]:
    """Return the nearest coordinates in the domain, and β there."""
    near, beta = [], []
    for x, (first, last, sigma, _, profile) in zip(points, axes, strict=True):
        if sigma < 0:
            near.append(x)
            beta.append(torch.ones_like(x))
        elif sigma == 0:
            near.append(torch.zeros_like(x))
            beta.append(torch.zeros_like(x))
        else:
            v = x.clamp(first, last)
            near.append(v)
            t = torch.minimum(v - first, last - v).clamp(max=sigma) / sigma
            beta.append(torch.sin(t * (math.pi / 2)) if profile == _SINE else t * (2 - t * t * (2 - t)))
    return near, beta


def _arriving(pivot: Columns, force: Columns, axes: Sequence[Axis]) -> Columns:
    """Return the force, or M r, corrected for β at its pivot, unless that is outside of a fixed border."""
    places = [float(x.detach()) for x in pivot]
    outside = (sigma >= 0 and not a <= x <= b for x, (a, b, sigma, _, _) in zip(places, axes, strict=True))
    if any(outside):
        return force
    _, beta = _edges(pivot, axes)
    return [f / b if b > 0 else f * 0 for f, b in zip(force, beta, strict=True)]
