"""The torch engine: tensors by the engine of their device, and T as differentiable operations of PyTorch."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from supple.engines.base import Certificate, Engine, Layout, Space, Steps, Work, warn_of
from supple.engines.choice import engine_at
from supple.engines.native import NATIVE
from supple.errors import ToleranceWarning
from supple.space.domain import refuse
from supple.torch.field import Strokes, moved, solved
from supple.torch.taps import Columns

_SOLVED = 1 << 18  # points solved in one call
_NEAR = 1 << 12  # pixels of an axis up to which float32 coordinates are accurate to 0.0001


@dataclass(frozen=True, slots=True)
class Torch:
    """The engine of tensors (`supple.engines.base.Engine`), whose channels come first: (K, *shape)."""

    name: str = "torch"

    def taken(self, value: Any, name: str) -> torch.Tensor:
        """Return a tensor, detached from its gradients; SuppleError for other values."""
        if not isinstance(value, torch.Tensor):
            refuse(name, "a PyTorch tensor (Deformation.warp takes arrays)", value)
        return value.detach()

    def result(
        self, out: torch.Tensor | None, held: torch.Tensor, shape: tuple[int, ...] | None = None
    ) -> torch.Tensor:
        """See `Engine.result`; it has the shape of the source."""
        return torch.empty_like(held, memory_format=torch.contiguous_format) if out is None else out

    def warp(self, work: Work, frames: Sequence[torch.Tensor], outs: Sequence[torch.Tensor]) -> Steps:
        """See `Engine.warp`; a tensor (K, *shape) is all frames. The values are those of the engine of its device."""
        (tensor,), (out,) = frames, outs
        engine = _engine_of(work.space, tensor)
        # NumPy has no bfloat16, and the core processes half precision in single precision.
        halves = (torch.bfloat16, torch.float16) if engine is NATIVE else (torch.bfloat16,)
        held: Any = (tensor.float() if tensor.dtype in halves else tensor).movedim(0, -1)
        if engine is NATIVE:
            array = np.ascontiguousarray(held.numpy(force=True))
            work = _on(work, array)
            array = array if work.space.ndim == 3 else array[None]
            made = np.empty_like(array)
            kind = NATIVE.working_dtype(array.dtype)
            yield from engine.warp(work, [array.view(kind)], [made.view(kind)])
            given = torch.from_numpy(made.reshape(held.shape))
        else:
            source = engine.taken(held, "tensor")
            result = engine.result(None, source)
            yield from engine.warp(_on(work, source), [source], [result])
            given = result.given
        out.copy_(given.movedim(-1, 0))

    def forward(self, space: Space, points: torch.Tensor, *, matrices: bool = False) -> torch.Tensor:
        """See `Engine.forward`; the engine of the points' device moves them, without gradients."""
        engine, held = _held(space, points)
        found = torch.as_tensor(engine.forward(space, held, matrices=matrices))
        return found.to(points.dtype).to(points.device)  # not every device has float64

    def inverse(self, space: Space, points: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """See `Engine.inverse`; the engine of the points' device solves for them."""
        engine, held = _held(space, points)
        return tuple(torch.as_tensor(x).to(points.device) for x in engine.inverse(space, held))

    def inverse_map(self, space: Space, tolerance: float, like: Any = None) -> tuple[torch.Tensor, Certificate]:
        """See `Engine.inverse_map`; it is a tensor on the device of ``like``."""
        engine = _engine_of(space, like)
        if engine is not NATIVE:
            found, certificate = engine.inverse_map(space, tolerance, like)
            return torch.as_tensor(found), certificate
        found, certificate = NATIVE.inverse_map(space, tolerance)
        return torch.from_numpy(found).to(like.device), certificate


TORCH = Torch()


def _engine_of(space: Space, tensor: Any) -> Engine:
    """Return the engine of a tensor's device, or the native one for freeze masks."""
    return engine_at(tensor) if space.freeze is None else NATIVE


def _held(space: Space, points: torch.Tensor) -> tuple[Engine, Any]:
    """Return the engine for points, and them as it takes them."""
    held: Any = points.detach()
    engine = _engine_of(space, held)
    return engine, held.cpu().double().numpy() if engine is NATIVE else held.double()


def _on(work: Work, held: Any) -> Work:
    """Return the work with the layout of an array (*shape, K), and the fill values in its type."""
    layout = Layout.of_array(held.shape, held.dtype, work.space.whole, alpha=False, light=False)
    return replace(work, layout=layout, sampling=work.sampling.filled(layout.groups[0].channels, held.dtype))


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
        from supple.engines.cuda.points import inverse_map

        found, certificate = inverse_map(space, like.detach(), tolerance, offsets=True)
        warn_of(certificate, tolerance, 3)
        return torch.as_tensor(found).reshape(made.shape)
    if dtype == torch.float32 and max(sizes) <= _NEAR:
        sources, certificate = NATIVE.inverse_map(space, tolerance)
        warn_of(certificate, tolerance, 3)
        pixels = torch.stack(grid(torch.arange(len(made)), sizes), -1)
        return (torch.from_numpy(sources).reshape(made.shape) - pixels).to(like.device)
    lost, steps = 0, torch.tensor(space.axes[: space.ndim, 3], device=where)
    for start in range(0, len(made), _SOLVED):
        points = torch.stack(grid(torch.arange(start, min(start + _SOLVED, len(made)), device=where), sizes), -1)
        solved, _, _, converged = TORCH.inverse(space, points)
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
    matrices = TORCH.forward(space, torch.stack(points, -1), matrices=True)
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
