"""Warps of tensors, and T of points, with gradients.

Values are computed by the engines. The backward pass reads the same samples again at T⁻¹.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from supple.deformation import Deformation
from supple.engine.sampling import Sampling, warn_of
from supple.engine.work import Group, Layout, Space, Work
from supple.space.domain import refuse
from supple.torch.engine import adjoint_of, grid, offsets_of, sample, seen_at, working
from supple.torch.field import Strokes, strokes_gradients
from supple.torch.strokes import Item, items
from supple.torch.taps import Columns, Taps, around, count

SMOOTH = ("nearest", "linear", "cubic")


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """The work on a tensor of K channels; ``strokes`` is set if they need gradients."""

    work: Work
    strokes: Strokes | None = None

    @property
    def kinds(self) -> list[str]:
        """The kernels of the differentiable filter."""
        sampling = self.work.sampling
        between = "catmull-rom" if sampling.between == "cubic" else sampling.between
        return [sampling.filter, sampling.filter, str(between)][: self.work.space.ndim]

    def fill(self, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Return the fill values, of shape (K, 1, 1)."""
        return torch.tensor(self.work.sampling.fill, dtype=dtype, device=device)[:, None, None]


_ROOM = 1 << 23  # the numbers in memory for points processed at once, mostly for gradients of T
_OF_MASKS = 8  # as many terms of a stroke need as much room as the freeze mask's


def warp(
    tensor: torch.Tensor,
    deformation: Deformation | Sequence[Deformation],
    *,
    at: torch.Tensor | None = None,
    by: torch.Tensor | None = None,
    radius: torch.Tensor | None = None,
    filter: str = "linear",
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    between: str | None = None,
    tolerance: float = 0.01,
) -> torch.Tensor:
    """Warp a tensor, differentiably with respect to the tensor and the strokes.

    Parameters
    ----------
    tensor : tensor of shape (H, W), (C, H, W) or (N, C, H, W); of a volume or frames (Z, H, W) to (N, C, Z, H, W)
        Of bool, integers or floats, on any device. Only floats have gradients.
    deformation : Deformation, or sequence of N of them
        A deformation of the shape of the last axes; or one for each item of the batch. With fields or affine maps, the
        tensor must be in host memory.
    at, by : tensor of shape (n, D), or (N, n, D), optional
        Replacements of the positions and the drags of the deformation's n strokes: in pixels, x first. The drags of
        brushes other than grabs are 0, and have no gradients.
    radius : tensor of shape (n,), or (N, n), optional
        Replacements of their radii, in physical units.
    filter : str
        ``"linear"``, ``"cubic"`` (Keys' with a = -0.75) or ``"nearest"``; without gradients, also ``"auto"``, as in
        `Deformation.warp`.
    outside : str
        Boundary mode: the ``"edge"`` of the tensor, a ``"constant"``, or its mirror image (``"reflect"``).
    fill : float or sequence of float
        The fill value; one for all channels, or one for each.
    between : str, optional
        The interpolation between slices or frames: ``"linear"``, ``"cubic"`` or ``"nearest"``; linear by default, and
        nearest under ``filter="nearest"``.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels. For float64 tensors that require gradients, each
        point is solved.

    Returns
    -------
    tensor
        The result, of the same shape, type and device. Channels are independent: none is opacity.

    Raises
    ------
    SuppleError
        If an argument does not fit, or requires gradients where there are none.

    Warns
    -----
    FoldWarning
        If a stroke with new numbers was damped. Gradients take the damping factor as constant.
    ToleranceWarning
        If the checks of the map's cells do not promise the tolerance everywhere.

    Notes
    -----
    With p = T⁻¹(q) and θ any number of a stroke, ∂p/∂θ = -(I+J)⁻¹ ∂K/∂θ.
    """
    given, batch = items(deformation, at, by, radius)
    if not given:
        return _nothing(tensor, "tensor")
    shape = given[0].deformation.shape
    _check(tensor, shape, len(given) if batch else None)
    axes = len(shape)
    sampling = Sampling.checked(
        axes, filter=filter, tolerance=tolerance, outside=outside, fill=fill, linear_light=False, between=between,
        time_filter=False,
    )  # fmt: skip
    wanted = torch.is_grad_enabled() and tensor.requires_grad
    strokes_wanted = any(item.differentiable for item in given)
    if (wanted or strokes_wanted) and filter not in SMOOTH:
        refuse("filter", '"linear", "cubic" or "nearest" where gradients are needed', filter)
    if strokes_wanted and not tensor.is_floating_point():
        refuse("tensor", "of floats where strokes need gradients", told=str(tensor.dtype))
    channels = tensor.shape[-axes - 1] if tensor.ndim > axes else 1
    colours = np.asarray(sampling.filled(channels, np.dtype(np.float64)).fill)
    if tensor.numel() == 0:
        return tensor.clone()
    parts = tensor.reshape(len(given), -1, *shape)
    sampling = replace(sampling, fill=tuple(np.tile(colours, parts.shape[1] // channels).tolist()))
    layout = Layout(
        (Group((shape[-2], shape[-1]), parts.shape[1]),), np.dtype(np.float32), 1.0
    )  # its engine knows the type
    made = [
        _warped(part, item, Job(Work(item.deformation.space, layout, sampling)))
        for part, item in zip(parts, given, strict=True)
    ]
    return (torch.stack(made) if batch else made[0]).reshape(tensor.shape)


def _nothing(tensor: torch.Tensor, name: str) -> torch.Tensor:
    """Return the result of a batch without items."""
    if not isinstance(tensor, torch.Tensor) or tensor.ndim == 0 or len(tensor):
        refuse(name, "a tensor of no items, as the strokes are", tensor)
    return tensor.clone()


def forward(
    points: torch.Tensor,
    deformation: Deformation | Sequence[Deformation],
    *,
    at: torch.Tensor | None = None,
    by: torch.Tensor | None = None,
    radius: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return T of points: their positions in the output, differentiable any number of times.

    Parameters
    ----------
    points : tensor of floats, shape (..., D)
        In pixels, x first; (N, ..., D) if the deformations or their strokes are those of a batch.
    deformation, at, by, radius
        As in `warp`.

    Returns
    -------
    tensor of shape (..., D)
        The positions, of the same type and device.

    Raises
    ------
    SuppleError
        If an argument does not fit.

    Warns
    -----
    FoldWarning
        As in `warp`.
    """
    given, batch = items(deformation, at, by, radius)
    if not given:
        return _nothing(points, "points")
    n = given[0].deformation.ndim
    if not isinstance(points, torch.Tensor):
        refuse("points", f"a tensor of shape (..., {n})", points)
    if not points.is_floating_point() or points.ndim == 0 or points.shape[-1] != n:
        refuse("points", f"floats of shape (..., {n}), x first", told=f"{points.dtype} of shape {tuple(points.shape)}")
    if batch and (points.ndim < 2 or len(points) != len(given)):
        refuse("points", f"of shape ({len(given)}, ..., {n}), as the batch is", told=f"shape {tuple(points.shape)}")
    made = []
    for part, item in zip(points if batch else [points], given, strict=True):
        strokes = item.strokes(working(points), points.device)
        made.append(seen_at(part, strokes))
    return torch.stack(made) if batch else made[0]


def _check(tensor: object, shape: tuple[int, ...], count: int | None) -> None:
    if not isinstance(tensor, torch.Tensor):
        refuse("tensor", "a PyTorch tensor (Deformation.warp takes arrays)", tensor)
    if tensor.is_complex() or tensor.is_quantized or tensor.layout != torch.strided or _odd(tensor.dtype):
        wanted = "dense, of bool, integers or floats of 16 to 64 bits"
        refuse("tensor", wanted, told=f"{tensor.dtype}, {tensor.layout}")
    sizes, axes = ", ".join(map(str, shape)), len(shape)
    if tuple(tensor.shape[-axes:]) != shape or tensor.ndim > axes + 2:
        wanted = f"of shape ({sizes}), (C, {sizes}) or (N, C, {sizes}), as the deformation is"
        refuse("tensor", wanted, told=f"shape {tuple(tensor.shape)}")
    if count is not None and (tensor.ndim != axes + 2 or len(tensor) != count):
        wanted = f"of shape ({count}, C, {sizes}), as there are {count} deformations or sets of strokes"
        refuse("tensor", wanted, told=f"shape {tuple(tensor.shape)}")


def _odd(dtype: torch.dtype) -> bool:
    return dtype.is_floating_point and dtype not in (torch.float16, torch.bfloat16, torch.float32, torch.float64)


def _warped(tensor: torch.Tensor, item: Item, job: Job) -> torch.Tensor:
    """Return one warped item, of shape (K, *shape)."""
    if item.differentiable:
        strokes = item.strokes(working(tensor), tensor.device)
        held = replace(strokes, at=strokes.at.detach(), by=strokes.by.detach(), radius=strokes.radius.detach())
        job = replace(job, strokes=held)
        return _Warp.apply(tensor, strokes.at, strokes.by, strokes.radius, job)
    if job.work.space.is_identity:
        return tensor.clone()
    if torch.is_grad_enabled() and tensor.requires_grad:
        return _Warp.apply(tensor, None, None, None, job)
    return _values(tensor, job.work)


def _values(tensor: torch.Tensor, work: Work) -> torch.Tensor:
    made, certificate = sample(tensor, work.space, work.sampling)
    warn_of(certificate, work.sampling.tolerance, 5)
    return made


class _Warp(torch.autograd.Function):
    """The warp of a tensor (K, *shape) by a job; at, by and radius are those of the job's strokes, or None."""

    @staticmethod
    def forward(
        ctx: Any,
        tensor: torch.Tensor,
        at: torch.Tensor | None,
        by: torch.Tensor | None,
        radius: torch.Tensor | None,
        job: Job,
    ) -> torch.Tensor:
        offsets = None
        if job.work.space.is_identity:
            made = tensor.clone()
        elif tensor.dtype != torch.float64:
            made = _values(tensor, job.work)
        else:
            offsets = offsets_of(tensor, job.work.space, job.work.sampling.tolerance)
            source, fill = tensor.reshape(len(tensor), -1), job.fill(tensor.dtype, tensor.device)
            near = (_taps(offsets, *ends, job) for ends in _chunks(offsets, job))
            parts = [(taps.values(source, fill) * taps.weights()).sum(1) for taps in near]
            # Unchanged pixels are copied, so that no NaN of a neighbour reaches them.
            made = torch.where(offsets.any(1), torch.cat(parts, 1), source).reshape(tensor.shape)
        ctx.job = job
        ctx.save_for_backward(tensor if at is not None else None, at, by, radius, offsets)
        return made

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[Any, ...]:
        tensor, at, by, radius, offsets = ctx.saved_tensors
        job, space, dtype = ctx.job, ctx.job.work.space, working(gradient)
        offsets = offsets_of(gradient, space, job.work.sampling.tolerance) if offsets is None else offsets
        flat, fill = gradient.reshape(len(gradient), -1), job.fill(dtype, gradient.device)
        into = torch.zeros_like(flat, dtype=dtype) if ctx.needs_input_grad[0] else None
        found, strokes, source = None, None, None
        if at is not None:
            found = [torch.zeros_like(x) for x in (at, by, radius)]
            if any(kind != "nearest" for kind in job.kinds):
                strokes = replace(job.strokes, at=at, by=by, radius=radius)
                source = tensor.reshape(len(tensor), -1)
        for start, stop in _chunks(offsets, job) if into is not None or strokes is not None else ():
            taps, own = _taps(offsets, start, stop, job), flat[:, None, start:stop].to(dtype)
            if into is not None:
                weights = taps.weights() if taps.inside is None else taps.weights() * taps.inside
                into.index_add_(1, taps.index.flatten(), (own * weights).flatten(1))
            if strokes is not None and found is not None:
                seen = (own * taps.values(source, fill)).sum(0)
                slopes = [(seen * taps.weights(axis)).sum(0) for axis in range(space.ndim)]
                pixels = _points(offsets, start, stop, space)
                points = [i + x for i, x in zip(*pixels, strict=True)]
                slopes = adjoint_of(space, points, slopes)
                for total, more in zip(found, strokes_gradients(points, slopes, strokes), strict=True):
                    total += more
        image = None if into is None else into.to(gradient.dtype).reshape(gradient.shape)
        return image, *(found or (None, None, None)), None


def _points(offsets: torch.Tensor, start: int, stop: int, space: Space) -> tuple[Columns, Columns]:
    """Return the source points of some pixels, as pixels and offsets from them."""
    pixels = grid(torch.arange(start, stop, device=offsets.device), space.whole[::-1])
    return pixels, list(offsets[start:stop].unbind(-1))


def _taps(offsets: torch.Tensor, start: int, stop: int, job: Job) -> Taps:
    """Return the samples around the source points of some pixels."""
    space = job.work.space
    pixels, columns = _points(offsets, start, stop, space)
    lower = [torch.floor(x) for x in columns]
    whole = [i + x.long() for i, x in zip(pixels, lower, strict=True)]
    rest = [x - low for x, low in zip(columns, lower, strict=True)]
    return around(whole, rest, space.whole[::-1], job.kinds, job.work.sampling.outside)


def _chunks(offsets: torch.Tensor, job: Job) -> list[tuple[int, int]]:
    terms = 0
    if job.strokes is not None:
        frozen = _OF_MASKS if job.strokes.freedom is not None else 0
        terms = sum(kind.scales + frozen for kind in job.strokes.kinds)
    channels, total = job.work.layout.groups[0].channels, len(offsets)
    size = max(1, _ROOM // (channels * count(job.kinds) + 16 * (terms + 1)))
    return [(start, min(start + size, total)) for start in range(0, total, size)]
