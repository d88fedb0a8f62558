"""Inverses of sampled displacement fields, with gradients."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import torch

from supple.errors import FoldWarning, OutsideWarning, SuppleError, ToleranceWarning
from supple.fields import FOLDED, OK, OUTSIDE, STATUS, UNCONVERGED, Beyond, Field, Interpolation
from supple.space.domain import checked_spacing, choice, number, refuse
from supple.torch.engine import grid
from supple.torch.field import solved
from supple.torch.taps import around, coefficients, count

_ROOM = 1 << 18  # the samples around points that are processed at once


@dataclass(frozen=True, slots=True, eq=False)
class Inverted:
    """The inverses of displacement fields, with their accuracy, as tensors on the device of the fields.

    Parameters
    ----------
    values : tensor, shape (D, *shape) or (N, D, *shape)
        The inverse displacements, x first, in physical units, of the type of the fields. At a sample that is not OK, it
        is the nearest that was found.
    error : float32 tensor, shape (*shape) or (N, *shape)
        A bound on the distance from the true inverse of the interpolant, in physical units; inf where it is not known.
    status : uint8 tensor, of the shape of ``error``
        For each sample, the number of its name in `supple.fields.STATUS`: ``"ok"``, ``"folded"``, ``"outside"`` or
        ``"unconverged"``, as in `supple.fields.Inverted`.
    """

    values: torch.Tensor
    error: torch.Tensor
    status: torch.Tensor

    @property
    def counts(self) -> dict[str, int]:
        """The number of samples of each status."""
        found = torch.bincount(self.status.flatten().int(), minlength=len(STATUS)).tolist()
        return dict(zip(STATUS, found, strict=True))


@dataclass(frozen=True, slots=True)
class _Job:
    spacing: tuple[float, ...]
    interpolation: Interpolation
    beyond: Beyond
    tolerance: float

    @property
    def edge(self) -> int:
        """The number of coefficients at each end of an axis that are beyond the field."""
        return 1 if self.interpolation == "bspline" else 0

    @property
    def solved(self) -> tuple[int, ...]:
        """The statuses that have gradients: beyond its grid, too, a field goes on by its edge, but not by zero."""
        return (OK, OUTSIDE) if self.beyond == "edge" else (OK,)


def invert(
    values: torch.Tensor,
    *,
    spacing: float | Sequence[float] = 1.0,
    interpolation: Interpolation = "linear",
    beyond: Beyond = "edge",
    tolerance: float = 1e-3,
) -> Inverted:
    """Return the inverses of displacement fields, differentiably with respect to the fields.

    The field u is the map x → x + u(x). Each sample y of its grid is solved for x with x + u(x) = y, and the inverse
    displacement there is v(y) = x - y.

    Parameters
    ----------
    values : float32 or float64 tensor, shape (2, H, W), (N, 2, H, W), (3, Z, H, W) or (N, 3, Z, H, W)
        The displacements, x first, in physical units, along the axes of the tensor. A tensor of shape (3, 2, H, W) is
        three fields in the plane; one volume of two slices takes an axis for the batch.
    spacing : float or sequence of float
        Physical units from a sample to the next; one for all axes, or one for each, x first.
    interpolation : str
        ``"linear"``; ``"cubic"``, a cubic B-spline through the values; ``"bspline"``, values are its coefficients, and
        the result is without the first and the last along each axis, as they are beyond the field.
    beyond : str
        The displacement outside the grid: that of the nearest point of the ``"edge"``, or ``"zero"``.
    tolerance : float
        The largest distance of x from the true inverse of the interpolant, in samples.

    Returns
    -------
    Inverted

    Raises
    ------
    SuppleError
        If an argument does not fit, or the values hold NaN or infinity.

    Warns
    -----
    FoldWarning, OutsideWarning, ToleranceWarning
        If gradients are wanted, and are zero at samples whose status is folded, unconverged, or, of a field that is
        zero beyond its grid, outside.

    Notes
    -----
    With J = ∂u/∂x, the derivative of the solution is dx = -(I+J)⁻¹ du(x), whichever way it was found. Gradients are
    differentiable, too.
    """
    many, single = _checked(values)
    choice("interpolation", interpolation, get_args(Interpolation))
    choice("beyond", beyond, get_args(Beyond))
    steps = checked_spacing(spacing, many.shape[1])
    tolerance = number("tolerance", tolerance, "a number of samples above 0", 1e-9, 1e9)
    if interpolation == "bspline" and min(many.shape[2:]) < 4:
        raise SuppleError(f"a cubic B-spline needs 4 coefficients along each axis, found {tuple(many.shape[2:])}")
    job = _Job(steps, interpolation, beyond, tolerance)
    found, error, status = _Inverse.apply(many, job)
    made = Inverted(found[0], error[0], status[0]) if single else Inverted(found, error, status)
    if found.requires_grad:
        _warn(made, job)
    return made


def _checked(values: object) -> tuple[torch.Tensor, bool]:
    """Return fields as a batch, and whether one was given without it."""
    wanted = "a tensor of shape (2, H, W), (N, 2, H, W), (3, Z, H, W) or (N, 3, Z, H, W)"
    if not isinstance(values, torch.Tensor):
        refuse("values", f"{wanted} (Field.invert takes arrays)", values)
    if values.dtype not in (torch.float32, torch.float64) or values.layout != torch.strided:
        refuse("values", "a dense tensor of float32 or float64", told=f"{values.dtype}, {values.layout}")
    shape = tuple(values.shape)
    batch = len(shape) == 5 or (len(shape) == 4 and shape[1] == 2)
    axes = len(shape) - 1 - batch
    if axes not in (2, 3) or shape[batch] != axes or 0 in shape[batch:]:
        refuse("values", f"{wanted}, x first", told=f"shape {shape}")
    if not torch.isfinite(values.detach()).all():
        raise SuppleError("the field holds NaN or infinity")
    return (values if batch else values[None]), not batch


def _warn(made: Inverted, job: _Job) -> None:
    counts, solved = made.counts, [STATUS[code] for code in job.solved]
    lost = {name: count for name, count in counts.items() if count and name not in solved}
    if not lost:
        return
    kinds = {STATUS[FOLDED]: FoldWarning, STATUS[OUTSIDE]: OutsideWarning, STATUS[UNCONVERGED]: ToleranceWarning}
    each = ", ".join(f"{count} {name}" for name, count in lost.items())
    text = f"gradients are zero at {sum(lost.values())} of {made.status.numel()} samples of the inverse: {each}"
    warnings.warn(text, kinds[next(iter(lost))], stacklevel=3)


class _Inverse(torch.autograd.Function):
    """The inverses of fields (N, D, *shape), their errors and status, by the core."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, job: _Job) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        shape = [size - 2 * job.edge for size in values.shape[2:]]
        found = values.new_empty((*values.shape[:2], *shape))
        error = values.new_empty((len(values), *shape), dtype=torch.float32)
        status = torch.empty_like(error, dtype=torch.uint8)
        for k, each in enumerate(values.detach()):
            array = each.movedim(0, -1).numpy(force=True)
            field = Field.from_array(array, spacing=job.spacing, interpolation=job.interpolation, beyond=job.beyond)
            made = field.invert(tolerance=job.tolerance)
            found[k] = torch.from_numpy(made.field.values).movedim(-1, 0)
            error[k] = torch.from_numpy(made.error)
            status[k] = torch.from_numpy(made.status)
        ctx.job = job
        ctx.mark_non_differentiable(error, status)
        ctx.save_for_backward(values, found, status)
        return found, error, status

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor, *_: Any) -> tuple[torch.Tensor, None]:
        values, found, status = ctx.saved_tensors
        where = values.device if values.is_cuda else "cpu"  # other devices may have no float64
        values, found, status, slopes = (x.to(where) for x in (values, found, status, gradient))
        return _gradient(values, found, status, slopes, ctx.job).to(gradient), None


def _gradient(
    values: torch.Tensor, found: torch.Tensor, status: torch.Tensor, gradient: torch.Tensor, job: _Job
) -> torch.Tensor:
    """Return ∂L/∂values from ∂L/∂found, differentiable in all of them.

    With i the index of a position, i → i + w(i). For a loss L of the points i(w) that are solutions of i + w(i) = q,

        dL/dw = -Sᵀ λ,    (I+J)ᵀ λ = ∂L/∂i,

    where S interpolates at the points i, and J = ∂w/∂i there.
    """
    n, sizes, shape = values.shape[1], values.shape[:1:-1], status.shape[:0:-1]
    kind, reach = ("linear", 2) if job.interpolation == "linear" else ("bspline", 1)
    with torch.enable_grad():
        held = values.double()
        if job.interpolation == "cubic":
            held = coefficients(held, n).to(values.dtype).double()  # as the core holds them
        steps = torch.tensor(job.spacing, dtype=held.dtype, device=held.device)
        samples = (held.flatten(2) / steps[:, None]).movedim(1, 0).reshape(n, -1)
    into = torch.zeros_like(samples)
    offsets, slopes = (x.double().movedim(1, 0).reshape(n, -1) for x in (found, gradient))
    well = torch.isin(status.flatten(), torch.tensor(job.solved, device=status.device)).nonzero()[:, 0]
    for part in well.split(_ROOM // count([kind] * n)):
        whole, rest, free = [], [], []
        for k, i in enumerate(grid(part % shape.numel(), shape)):
            i = i + job.edge + offsets[k, part] / job.spacing[k]
            c = i.clamp(job.edge, sizes[k] - 1 - job.edge)
            whole.append(c.detach().long().clamp(max=max(sizes[k] - reach, 0)))
            rest.append(c - whole[-1])
            free.append((c == i).double())
        taps = around(whole, rest, sizes, [kind] * n, "mirror")
        taps = replace(taps, index=taps.index + part // shape.numel() * sizes.numel())
        w, along = taps.values(samples), [taps.weights(b) for b in range(n)]
        rows = [[free[b] * (along[b] * w[a]).sum(0) + (a == b) for b in range(n)] for a in range(n)]
        adjoint = torch.stack(solved(rows, [-g * s for g, s in zip(slopes[:, part], job.spacing, strict=True)]))
        into.index_add_(1, taps.index.flatten(), (taps.weights() * adjoint[:, None]).flatten(1))
    return torch.autograd.grad(samples, values, into, create_graph=torch.is_grad_enabled())[0]
