"""Inverses of sampled displacement fields, with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from supple.errors import FoldWarning, OutsideWarning, ToleranceWarning, warn
from supple.fields import FOLDED, OK, OUTSIDE, STATUS, UNCONVERGED, Beyond, Field, Interpolation
from supple.space.checks import checked_spacing, refuse
from supple.space.splines import coefficients
from supple.torch.taps import adjoint, around, count

_ROOM = 1 << 18  # samples around points that are read at once
# The statuses with gradients: outside its grid, a field continues by its edge; one that is zero there has none.
_SOLVED = {"edge": [OK, OUTSIDE], "zero": [OK]}


@dataclass(frozen=True, slots=True, eq=False)
class Inverted:
    """The inverses of displacement fields, with their accuracy, as tensors on the device of the fields.

    Parameters
    ----------
    values : tensor, shape (D, *shape) or (N, D, *shape)
        The inverse displacements, x first, in physical units, of the type of the fields. At a sample that is not
        OK, it is the best that was computed.
    error : float32 tensor, shape (*shape) or (N, *shape)
        A bound on the distance from the true inverse of the interpolant, in physical units; inf where unknown.
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
        counts = torch.bincount(self.status.flatten().int(), minlength=len(STATUS)).tolist()
        return dict(zip(STATUS, counts, strict=True))


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
        The displacements, x first, in physical units, along the axes of the tensor. A shape of (3, 2, H, W) is read
        as three fields in the plane: one volume of two slices needs a batch axis.
    spacing : float or sequence of float
        Physical units from a sample to the next; one for all axes, or one for each, x first.
    interpolation : str
        ``"linear"``; ``"cubic"``, a cubic B-spline through the values; ``"bspline"``, the values are coefficients,
        and the result lacks the first and the last along each axis, as these lie beyond the field.
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
        If gradients are wanted, and are zero at samples whose status is folded, unconverged, or, for fields that
        are zero beyond their grid, outside.

    Notes
    -----
    With J = ∂u/∂x, the derivative of the solution is dx = -(I+J)⁻¹ du(x). Gradients are differentiable, too.
    """
    many, single = _checked(values)
    steps = checked_spacing(spacing, many.shape[1])
    options = {"spacing": steps, "interpolation": interpolation, "beyond": beyond}
    inverse, error, status = _Inverse.apply(many, options, tolerance)
    inverted = Inverted(inverse[0], error[0], status[0]) if single else Inverted(inverse, error, status)
    if inverse.requires_grad:
        _warn(inverted, beyond)
    return inverted


def _checked(values: object) -> tuple[torch.Tensor, bool]:
    """Return fields as a batch, and whether ``values`` had no batch axis."""
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
    return (values if batch else values[None]), not batch


def _warn(inverted: Inverted, beyond: Beyond) -> None:
    kinds = {FOLDED: FoldWarning, OUTSIDE: OutsideWarning, UNCONVERGED: ToleranceWarning}
    lost = {code: inverted.counts[STATUS[code]] for code in kinds if code not in _SOLVED[beyond]}
    each = ", ".join(f"{count} {STATUS[code]}" for code, count in lost.items() if count)
    if each:
        text = f"gradients are zero at {sum(lost.values())} of {inverted.status.numel()} samples of the inverse: {each}"
        warn(text, next(kinds[code] for code, count in lost.items() if count))


class _Inverse(torch.autograd.Function):
    """The inverses of fields (N, D, *shape), their errors and status, by the core."""

    @staticmethod
    def forward(
        ctx: Any, values: torch.Tensor, options: dict[str, Any], tolerance: float
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        shape = [size - 2 * (options["interpolation"] == "bspline") for size in values.shape[2:]]
        inverse = values.new_empty((*values.shape[:2], *shape))
        error = values.new_empty((len(values), *shape), dtype=torch.float32)
        status = torch.empty_like(error, dtype=torch.uint8)
        for k, each in enumerate(values.detach()):
            field = Field.from_array(each.movedim(0, -1).numpy(force=True), **options)
            inverted = field.invert(tolerance=tolerance)
            inverse[k] = torch.from_numpy(inverted.field.values).movedim(-1, 0)
            error[k] = torch.from_numpy(inverted.error)
            status[k] = torch.from_numpy(inverted.status)
        ctx.options = options
        ctx.mark_non_differentiable(error, status)
        ctx.save_for_backward(values, inverse, status)
        return inverse, error, status

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor, *_: Any) -> tuple[torch.Tensor | None, ...]:
        """Return ∂L/∂values, differentiable with respect to the values and the gradient.

        With i the index of a position, i → i + w(i). For a loss L of the points i(w) that are solutions of
        i + w(i) = q,

            dL/dw = -Sᵀ λ,    (I+J)ᵀ λ = ∂L/∂i,

        where S interpolates at the points i, and J = ∂w/∂i there.
        """
        spacing, interpolation, beyond = ctx.options.values()
        # Only NVIDIA's devices are sure to have float64.
        where = gradient.device if gradient.is_cuda else "cpu"
        values, inverse, status, slopes = (x.to(where) for x in (*ctx.saved_tensors, gradient))
        n, sizes, edge = values.shape[1], values.shape[:1:-1], int(interpolation == "bspline")
        kinds, reach = (["linear"] * n, 2) if interpolation == "linear" else (["bspline"] * n, 1)
        steps, last, eye = (
            torch.tensor(x, dtype=torch.float64, device=where)[..., None]
            for x in (spacing, [size - 1 - edge for size in sizes], np.eye(n).tolist())
        )
        with torch.enable_grad():
            coefs = _Coefficients.apply(values) if interpolation == "cubic" else values
            samples = (coefs.double().flatten(2) / steps).movedim(1, 0).reshape(n, -1)
        into = torch.zeros_like(samples)
        offsets, slopes = (x.double().movedim(1, 0).reshape(n, -1) for x in (inverse, slopes))
        solved = torch.isin(status.flatten(), torch.tensor(_SOLVED[beyond], device=where)).nonzero()[:, 0]
        for part in solved.split(_ROOM // count(kinds)):
            item, *places = torch.unravel_index(part, status.shape)
            i = torch.stack(places[::-1]) + edge + offsets[:, part] / steps
            c = torch.where(i <= last, i, last).clamp(min=edge)  # a minimum would halve second derivatives at ties
            whole = torch.minimum(c.detach().floor(), (last + 1 + edge - reach).clamp(min=0))
            taps = around(whole.long(), c - whole, sizes, kinds, "mirror")
            taps = replace(taps, index=taps.index + item * sizes.numel())
            jacobian = taps.slopes(taps.samples(samples)).transpose(0, 1) * (c == i)
            taps.scatter(adjoint(eye + jacobian, -slopes[:, part] * steps), into)
        (result,) = torch.autograd.grad(samples, values, into, create_graph=torch.is_grad_enabled())
        return result.to(gradient), None, None


class _Coefficients(torch.autograd.Function):
    """The coefficients of the cubic B-splines through values (N, D, *shape), as fields use them.

    B maps coefficients to values. W B is symmetric, where W is diagonal, with 1/2 at the ends of each axis and 1
    elsewhere; so the adjoint of B⁻¹ is W B⁻¹ W⁻¹.
    """

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor) -> torch.Tensor:
        flat = values.detach().flatten(0, 1).movedim(0, -1).numpy(force=True)
        return torch.from_numpy(coefficients(flat)).movedim(-1, 0).reshape(values.shape).to(values)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> torch.Tensor:
        w = torch.ones_like(gradient)
        for axis in range(2, gradient.ndim):
            if gradient.shape[axis] > 1:
                w.movedim(axis, 0)[[0, -1]] *= 0.5
        result: torch.Tensor = _Coefficients.apply(gradient / w)
        return result * w
