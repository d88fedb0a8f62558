"""Strokes with tensors in place of some numbers: checked, as deformations, and applied to points differentiably.

In physical units, with r = p - pivot, s = |r|² and p clamped to the domain along fixed axes, a stroke moves by

    K(p) = diag(β) m [A(s) v + B(s) (r·v) r]

where A and B are those of its row of the table (`supple.strokes.pack`), scaled with the radius; m is the reach's factor
times the freeze mask's; and v is the force of a grab, or M r. A twist has R r - r in place of [...], where R is the
rotation by the angle A(s). Strokes that act at once are evaluated at the same point, and their displacements added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from supple.deformation import Deformation, reduced
from supple.engine.work import Mask, refuse_mattes, shown_mask
from supple.errors import FoldWarning, MissWarning, SuppleError, warn
from supple.space.checks import refuse
from supple.space.domain import PROFILE_CODES
from supple.strokes import pack
from supple.torch.taps import around

Given = dict[str, torch.Tensor]  # at, by and radius, which replace numbers of a deformation's strokes


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """A table of n strokes, some of whose numbers are tensors; composed in order, they make T.

    ``numbers`` (n, 3 D + 2) has, for each stroke, its pivot and force, in physical units; the factors of its
    displacement along each axis; its radius, in physical units; and its stretch of time. ``axes`` (D, 5) are those of
    the packed domain; ``mask``, the freeze mask and its coefficients, from 0 to 1.
    """

    numbers: torch.Tensor
    table: npt.NDArray[np.void]
    axes: npt.NDArray[np.float64]
    mask: tuple[Mask, torch.Tensor] | None

    def at(self, points: torch.Tensor) -> torch.Tensor:
        """Return T of points (D, P) in pixels, differentiable any number of times in the points and the numbers."""
        n, steps = len(points), _tensor(self.axes[:, 3:4], points)
        points = start = points * steps
        for row, own in zip(self.table, self.numbers, strict=True):
            pivot, force, gain = own[:-2].reshape(3, n, 1)
            stretch = torch.cat([torch.ones_like(own[:2]), own[-1:]])[:n, None]
            apart = _tensor([1.0, 1.0, row["coupled"]], points)[:n, None]
            start = start if row["joined"] else points
            near, beta = _edges(start, self.axes)
            r = stretch * (near - pivot)
            if row["flat"] > 0:  # the root has no derivative at 0, where r is 0
                plateau, rho = own[-2] * _flat(row), (r * r).sum(0).clamp(min=1e-30).sqrt()
                r = r * _eased(rho, plateau) / rho
            a, b = _profiles((r * r).sum(0), own[-2], row)
            v = stretch * force
            if row["power"] == 3:
                matrix = _tensor(row["matrix"][:n, :n], points)
                v = matrix @ r
                if row["turn"].any():
                    v = torch.sin(a) * v + 2 * torch.sin(a / 2) ** 2 * (matrix @ v)
                    v, a = v * _tensor(row["turn"][:n, None], points), torch.ones_like(a)  # and b is 0
            v = v * gain
            if self.mask is not None:
                beta = beta * _freedom(near, *self.mask)
            c = apart * r
            points = points + beta * (a * v + b * (c * v).sum(0) * c) / stretch
        return points / steps

    def gradient(self, points: torch.Tensor, adjoint: torch.Tensor) -> torch.Tensor:
        """Return -Σ λᵀ ∂T/∂numbers from points p = T⁻¹(q) and λ there, both (D, P), in pixels."""
        with torch.enable_grad():
            leaf = self.numbers.detach().requires_grad_()
            positions = replace(self, numbers=leaf).at(points)
        return torch.autograd.grad(positions, leaf, -adjoint, materialize_grads=True)[0]


def strokes_of(d: Deformation, given: Given, like: torch.Tensor, dtype: torch.dtype) -> Strokes:
    """Return the strokes of a deformation, of type ``dtype``, on the device of ``like``.

    They are differentiable with respect to the given tensors, if any; SuppleError for strokes without gradients.
    """
    n, table, axes = d.ndim, d.space.table, d.space.axes[: d.ndim]
    damping = d.resolution()["damping"]
    if given:
        if any(stroke.brush == "freeze" for stroke in d.strokes):
            raise SuppleError("gradients need one freeze mask for all strokes: give it to the deformation (freeze=)")
        if len(table) > sum(not stroke.is_still for stroke in d.strokes):
            pulls = any(stroke.also for stroke in d.strokes)
            several = "flows in several; use on_fold='damp', a larger radius or less of it"
            several = "pulls several points; use grabs" if pulls else several
            raise SuppleError(f"gradients need strokes that are carried out in one go, found one that {several}")
        frames = d.shape[0] if d.domain.time else 0
        parts = [reduced(stroke, part, d, d) for part, stroke in zip(damping, d.strokes, strict=True)]
        table = pack(parts, d.domain.spacing, time=d.domain.time, frames=frames)
    like = torch.empty(0, dtype=dtype, device=like.device)
    given = {name: x.to(like) for name, x in given.items()}
    pivot, force = (_tensor(table[name][:, :n], like).reshape(-1, n) for name in ("pivot", "force"))
    radius = given.get("radius", _tensor(np.sqrt(table["radius2"][:, 0]), like))
    steps, gain = _tensor(axes[:, 3], like), torch.ones_like(pivot)
    if "at" in given:
        pivot = given["at"] * steps
    if "by" in given:
        force = given["by"] * steps * _tensor(damping, like)[:, None]
    if given and d.on_fold == "flow":  # a flow compensates the border's factor for pivots in the domain
        near, beta = _edges(pivot.T, axes)
        correction = (beta > 0) / torch.where(beta > 0, beta, 1)
        gain = torch.where((near == pivot.T).all(0), correction, 1).T.expand_as(pivot)
    numbers = torch.cat([pivot, force, gain, radius[:, None], _stretches(d, table, given, radius)[:, None]], 1)
    refuse_mattes(d.space, "PyTorch")
    freeze = shown_mask(d.space.freeze)
    mask = None if freeze is None else (freeze, _tensor(freeze.coefficients / 255, like).flatten())
    return Strokes(numbers, table, axes, mask)


def _stretches(d: Deformation, table: npt.NDArray[np.void], given: Given, radius: torch.Tensor) -> torch.Tensor:
    """Return the stretch of time of each stroke by its radius and drag, as `supple.strokes.time_radius_of` has it."""
    if not (given and d.domain.time):
        return _tensor(table["stretch"], radius)
    whole = radius / d.domain.spacing[2]
    drag = given["by"][:, 2] if "by" in given else _tensor([stroke.by[2] for stroke in d.strokes], radius)
    own = torch.minimum(drag.abs().clamp(min=d.shape[0] / 8), whole)
    known = [math.nan if stroke.time_radius is None else stroke.time_radius for stroke in d.strokes]
    own = torch.where(_tensor(np.isnan(known), radius) > 0, own, _tensor(np.nan_to_num(known), radius))
    return torch.where(_tensor([stroke.isotropic for stroke in d.strokes], radius) > 0, 1.0, whole / own)


def _edges(points: torch.Tensor, axes: npt.NDArray[np.float64]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the nearest points (D, P) in the domain, and β there."""
    first, last, sigma = _tensor(axes.T[:3, :, None], points)
    if (axes[:, 2] < 0).all():
        return points, torch.ones_like(first)
    near = torch.where(sigma >= 0, points.clamp(first, last), points)
    t = (torch.minimum(near - first, last - near) / torch.where(sigma > 0, sigma, 1)).clamp(0, 1)
    sine = axes[0, 4] == PROFILE_CODES["sine"]
    beta = torch.sin(t * (math.pi / 2)) if sine else t * (2 - t * t * (2 - t))
    return near, torch.where(sigma > 0, beta, (sigma < 0).to(beta))


def _profiles(distance2: torch.Tensor, radius: torch.Tensor, row: np.void) -> tuple[torch.Tensor, torch.Tensor]:
    """Return A and B of a row for another radius, multiplied by the reach's factor m."""
    n, own = int(row["power"]), math.sqrt(row["radius2"][0])
    a, b, radius2 = torch.zeros_like(distance2), torch.zeros_like(distance2), radius * radius
    columns = row["radius2"] / own**2, row["p"] / own**n, row["q"] / own ** (n + 2), row["r"] / own**n
    for e, p, q, r in np.transpose(columns)[: row["terms"]].tolist():
        near = 1 / (distance2 + radius2 * e)
        share = radius2 * near
        v = torch.sqrt(share) if n == 1 else torch.sqrt(share) * share
        a, b = a + v * (p + q * share), b + v * near * r
    if row["reach"] < math.inf:
        # The root has no derivative at 0, but the derivative of m is 0 there.
        end = radius * (float(row["reach"]) / own)
        if row["flat"] > 0:
            end = _eased(end, radius * _flat(row))
        t = (distance2 / end**2).clamp(1e-30, 1).sqrt()
        m = (1 - t) ** 3 * (1 + (3 + 6 * t) * t)
        a, b = m * a, m * b
    return a, b


def _flat(row: np.void) -> float:
    """Return the radius of a row's plateau, as a fraction of the row's radius."""
    return float(row["flat"] / math.sqrt(row["radius2"][0]))


def _eased(rho: torch.Tensor, flat: torch.Tensor) -> torch.Tensor:
    """Return g of a plateau at a distance ρ."""
    x = (rho - flat).clamp(min=0)
    return x * x / (x + flat / 2)


def _freedom(points: torch.Tensor, mask: Mask, coefficients: torch.Tensor) -> torch.Tensor:
    """Return m of a freeze mask at points (D, P) in physical units: a cubic B-spline."""
    n = len(points)
    sizes: npt.NDArray[np.int64] = np.array(mask.coefficients.shape[::-1][:n])
    columns = mask.first[:n], mask.step[:n], sizes > 1, np.maximum(sizes - 2, 0), np.maximum(sizes - 3, 0)
    first, step, low, high, last = _tensor(np.array(columns, float)[:, :, None], points)
    places = ((points - first) / step).clamp(low, high)
    whole = torch.minimum(places.detach().floor(), last)
    kinds = ["bspline" if size > 1 else "nearest" for size in sizes]
    taps = around(whole.long(), places - whole, sizes.tolist(), kinds, "edge")
    return taps.between(taps.samples(coefficients))


def _tensor(values: npt.ArrayLike, like: torch.Tensor) -> torch.Tensor:
    return torch.tensor(np.asarray(values).tolist(), dtype=like.dtype, device=like.device)


def items(
    deformation: Deformation | Sequence[Deformation], tensors: dict[str, torch.Tensor | None]
) -> tuple[list[tuple[Deformation, Given]], tuple[int, ...], bool]:
    """Return the deformation of each item, with its tensors, the shape, and whether there is a batch.

    Without a batch, the one deformation is for the whole tensor. The tensors (at, by, radius) are included only if
    their gradients are wanted. SuppleError if the arguments do not fit each other.
    """
    many: Any = [deformation] if isinstance(deformation, Deformation) else deformation
    if not isinstance(many, Sequence) or not many or not all(isinstance(d, Deformation) for d in many):
        refuse("deformation", "a Deformation, or a sequence of them, one for each item of the batch", deformation)
    if len({d.shape for d in many}) > 1:
        shapes = ", ".join(map(str, dict.fromkeys(d.shape for d in many)))
        raise SuppleError(f"the deformations of a batch must be of one shape, found {shapes}")
    axes, counts = {"at": 2, "by": 2, "radius": 1}, {} if many is not deformation else {"deformation": len(many)}
    given = {name: x for name, x in tensors.items() if x is not None}
    for name, x in given.items():
        _check(name, x, axes[name], many)
        if x.ndim > axes[name]:
            counts[name] = len(x)
    if len(set(counts.values())) > 1:
        each = ", ".join(f"{count} of {name}" for name, count in counts.items())
        raise SuppleError(f"a batch takes as many of each, one for each item, found {each}")
    result = []
    for i in range(next(iter(counts.values()), 1)):
        own = {name: x[i] if x.ndim > axes[name] else x for name, x in given.items()}
        wanted = torch.is_grad_enabled() and any(x.requires_grad and x.numel() for x in own.values())
        result.append((_rebuilt(many[i % len(many)], own), own if wanted else {}))
    return result, many[0].shape, bool(counts)


def _check(name: str, tensor: object, axes: int, many: Sequence[Deformation]) -> None:
    counts = dict.fromkeys(len(d.strokes) for d in many)
    if len(counts) > 1:
        raise SuppleError(f"{name} needs deformations of as many strokes each, found {', '.join(map(str, counts))}")
    sizes = (next(iter(counts)), many[0].ndim)[:axes]
    text, each = ", ".join(map(str, sizes)), "row" if axes == 2 else "number"
    wanted = f"a tensor of shape {sizes}, one {each} for each stroke, or (N, {text}) for a batch"
    if not isinstance(tensor, torch.Tensor):
        refuse(name, wanted, tensor)
    if tensor.ndim not in (axes, axes + 1) or tensor.shape[-axes:] != sizes or tensor.is_complex():
        refuse(name, wanted, told=f"{tensor.dtype} of shape {tuple(tensor.shape)}")
    if any(d.maps for d in many):
        raise SuppleError(f"{name} is for deformations of strokes alone, found one with fields or affine maps")


def _rebuilt(d: Deformation, given: Given) -> Deformation:
    """Return a deformation whose strokes have the values of tensors."""
    if not given:
        return d
    columns = {name: x.detach().to("cpu", torch.float64).tolist() for name, x in given.items()}
    result = d.without_strokes()
    for i, stroke in enumerate(d.strokes):
        values: Any = {name: tuple(rows[i]) if name == "by" else rows[i] for name, rows in columns.items()}
        try:
            result = result.add(replace(stroke, **values), warn=False)
        except SuppleError as error:
            raise type(error)(f"stroke {i + 1} of {len(d.strokes)}: {error}") from None
    for text, part in zip(result.warnings, result.resolution()["damping"], strict=True):
        if text:
            warn(text, FoldWarning if part < 1 else MissWarning)
    return result
