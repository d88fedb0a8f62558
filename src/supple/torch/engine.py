"""Tensors through the core, or CUDA where they lie there, and T as differentiable operations of PyTorch."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from supple.cuda import job
from supple.cuda import points as on_device
from supple.engine import core
from supple.engine.devices import is_on_device
from supple.engine.sampling import Certificate, Sampling, warn_of
from supple.engine.work import Space, work_of
from supple.errors import ToleranceWarning
from supple.torch.field import Strokes, moved, solved
from supple.torch.taps import Columns

_SOLVED = 1 << 18  # points solved in one call
_NEAR = 1 << 12  # pixels of an axis up to which float32 coordinates are accurate to 0.0001


def sample(tensor: torch.Tensor, space: Space, sampling: Sampling) -> tuple[torch.Tensor, Certificate]:
    """Return a warped tensor (K, *shape), without gradients, and the certificate; its device does the work."""
    native = _is_native(space, tensor)
    # NumPy has no bfloat16, and the core processes half precision in single precision.
    halves = (torch.bfloat16, torch.float16) if native else (torch.bfloat16,)
    held: Any = (tensor.float() if tensor.dtype in halves else tensor).detach().movedim(0, -1)
    if native:
        array = np.ascontiguousarray(held.numpy(force=True))
        work = work_of(array.shape, array.dtype, space, sampling, alpha=False)
        array = array if space.ndim == 3 else array[None]
        made = np.empty_like(array)
        kind = core.working_dtype(array.dtype)
        certificate = core.sample(work, [array.view(kind)], [made.view(kind)])
        given = torch.from_numpy(made.reshape(held.shape))
    else:
        given, certificate = job.sample(held, (space,), sampling, False, None)
    out = torch.empty_like(tensor, memory_format=torch.contiguous_format)
    return out.copy_(given.movedim(-1, 0)), certificate


def inverse(space: Space, points: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return T⁻¹ of points, and what else `supple.Inverse` holds, on their device."""
    held: Any = points.detach()
    if _is_native(space, held):
        values, certificate = core.inverse(space, held.cpu().double().numpy())
    else:
        values, certificate = on_device.inverse(space, held.double())
    warn_of(certificate, 1.0, 4)
    return tuple(torch.as_tensor(x).to(points.device) for x in values)


def _is_native(space: Space, tensor: Any) -> bool:
    """Return whether the core does the work: for tensors of the host, and for freeze masks."""
    return space.freeze is not None or not is_on_device(tensor)


def seen_at(points: torch.Tensor, strokes: Strokes) -> torch.Tensor:
    """Return T of points (..., D) in pixels, in their type, differentiable with respect to points and strokes."""
    axes = strokes.axes
    columns = [x.to(strokes.at.dtype) * axis[3] for x, axis in zip(points.unbind(-1), axes, strict=True)]
    seen = [x / axis[3] for x, axis in zip(moved(columns, strokes), axes, strict=True)]
    return torch.stack(seen, -1).to(points.dtype)


def offsets_of(like: torch.Tensor, space: Space, tolerance: float) -> torch.Tensor:
    """Return T⁻¹(q) - q of all output pixels q, in pixels: (M, D), on the device of ``like``, in its working type.

    Offsets are small: float32 holds them to their accuracy, for images of any size. Where T moves nothing, they are 0.
    """
    dtype, sizes = working(like), space.whole[::-1]
    where = like.device if like.is_cuda else torch.device("cpu")
    made = torch.zeros(math.prod(sizes), len(sizes), dtype=dtype, device=where)
    if space.is_identity:
        return made.to(like.device)
    if dtype == torch.float32 and like.is_cuda and space.freeze is None:
        found, certificate = on_device.inverse_map(space, tolerance, like.detach(), offsets=True)
        warn_of(certificate, tolerance, 3)
        return torch.as_tensor(found).reshape(made.shape)
    if dtype == torch.float32 and max(sizes) <= _NEAR:
        sources, certificate = core.inverse_map(space, tolerance)
        warn_of(certificate, tolerance, 3)
        pixels = torch.stack(grid(torch.arange(len(made)), sizes), -1)
        return (torch.from_numpy(sources).reshape(made.shape) - pixels).to(like.device)
    lost, steps = 0, torch.tensor(space.axes[: space.ndim, 3], device=where)
    for start in range(0, len(made), _SOLVED):
        points = torch.stack(grid(torch.arange(start, min(start + _SOLVED, len(made)), device=where), sizes), -1)
        solved, _, _, converged = inverse(space, points)
        # Engines solve in physical units: of a point that stays, they return the pixel there and back.
        stays = solved == points * steps / steps
        made[start : start + len(points)] = torch.where(stays, 0.0, solved - points)
        lost += len(points) - int(converged.sum())
    if lost:
        text = f"{lost} of {len(made)} source points did not converge: what is shown there is a guess"
        warnings.warn(text, ToleranceWarning, stacklevel=2)
    return made.to(like.device)


def adjoint_of(space: Space, points: Columns, slopes: Columns) -> Columns:
    """Return λ of (I+J)ᵀ λ = ∂L/∂p at points, in pixels; the engine of their device knows J."""
    held: Any = torch.stack(points, -1).detach()
    if _is_native(space, held):
        made, _ = core.forward(space, held.cpu().double().numpy(), matrices=True)
    else:
        made, _ = on_device.forward(space, held.double(), matrices=True)
    matrices = torch.as_tensor(made).to(held.dtype).to(held.device)  # not every device has float64
    return solved([row.unbind(-1) for row in matrices.unbind(-2)], slopes)


def grid(index: torch.Tensor, sizes: Sequence[int]) -> Columns:
    """Return the coordinates, x first, of pixels with flat indices."""
    columns = []
    for size in sizes:
        columns.append(index % size)
        index = index // size
    return columns


def working(tensor: torch.Tensor) -> torch.dtype:
    """Return the type for work on a tensor outside of the engines."""
    return torch.float64 if tensor.dtype == torch.float64 else torch.float32
