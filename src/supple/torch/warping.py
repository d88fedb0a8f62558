"""Warps of tensors, and T of points, with gradients.

Values are computed by the engine of the tensor's device. The backward pass samples again at p(θ) = T⁻¹(q; θ), whatever
the solver was: for a loss L of these points, T(p; θ) = q gives, at fixed p,

    dL/dθ = -Σ_q λᵀ ∂T(p; θ)/∂θ,    (I+J)ᵀ λ = ∂L/∂p.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from supple.arrays import warp_array
from supple.deformation import Deformation, place_of
from supple.engine import core
from supple.engine.sampling import Certificate, Sampling, SamplingFields, warn_of
from supple.engine.work import Space
from supple.errors import SuppleError, ToleranceWarning, warn
from supple.space.checks import refuse
from supple.torch.strokes import Given, Strokes, items, strokes_of
from supple.torch.taps import Taps, adjoint, around, count

_LINEAR = Sampling("linear")
_SMOOTH = ("nearest", "linear", "cubic")
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
_ROOM = 1 << 23  # the numbers in memory for points processed at once, mostly for gradients of T
_SOLVED = 1 << 18  # points that are solved at a time
_OF_MASKS = 8  # a freeze mask needs as much memory as this many other terms of a stroke


def warp(
    tensor: torch.Tensor,
    deformation: Deformation | Sequence[Deformation],
    *,
    at: torch.Tensor | None = None,
    by: torch.Tensor | None = None,
    radius: torch.Tensor | None = None,
    inverse: bool = False,
    sampling: Sampling = _LINEAR,
    **options: Unpack[SamplingFields],
) -> torch.Tensor:
    """Warp a tensor, differentiably with respect to the tensor and the strokes.

    Parameters
    ----------
    tensor : tensor of shape (H, W), (C, H, W) or (N, C, H, W); of a volume or frames (Z, H, W) to (N, C, Z, H, W)
        Of bool, integers or floats, on any device. Only floats have gradients.
    deformation : Deformation, or sequence of N of them
        A deformation of the shape of the last axes; or one for each item of the batch.
    at, by : tensor of shape (n, D), or (N, n, D), optional
        Replacements of the positions and the drags of the deformation's n strokes: in pixels, x first. The drags of
        brushes other than grabs are 0, and have no gradients.
    radius : tensor of shape (n,), or (N, n), optional
        Replacements of their radii, in physical units.
    inverse : bool
        Whether to apply T⁻¹ in place of T, as in `supple.Deformation.warp`; without gradients of strokes.
    sampling : Sampling, optional
        How the tensor is sampled: without ``linear_light`` and ``time_filter``, and by ``filter="linear"`` by default.
            There are gradients for all filters but ``"auto"``. For float64 tensors with gradients, points are solved.
    **options
        Fields of the sampling to replace: ``filter="cubic"``.

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
    """
    given, shape, batch = items(deformation, {"at": at, "by": by, "radius": radius})
    _check(tensor, shape, len(given) if batch else None)
    axes = len(shape)
    if tensor.is_meta:
        refuse("tensor", "one with values", told="a tensor of the device meta, which has none")
    sampling = Sampling.of(sampling, options, axes)
    for name in ("linear_light", "time_filter"):
        if getattr(sampling, name):
            refuse(name, "left out for tensors", True)
    if sampling.filter == "labels":
        refuse("filter", '"auto", "cubic", "linear" or "nearest" for tensors', sampling.filter)
    wanted = torch.is_grad_enabled() and tensor.requires_grad
    strokes_wanted = any(own for _, own in given)
    if (wanted or strokes_wanted) and sampling.filter not in _SMOOTH:
        refuse("filter", '"linear", "cubic" or "nearest" where gradients are needed', sampling.filter)
    if strokes_wanted and inverse:
        refuse("inverse", "False where strokes need gradients", inverse)
    if strokes_wanted and not tensor.is_floating_point():
        refuse("tensor", "of floats where strokes need gradients", told=str(tensor.dtype))
    channels = tensor.shape[-axes - 1] if tensor.ndim > axes else 1
    colours = sampling.fills(channels, np.dtype(np.float64))
    if tensor.numel() == 0:
        return tensor.clone()
    parts = tensor.reshape(len(given), -1, *shape)
    sampling = replace(sampling, fill=tuple(np.resize(colours, parts.shape[1]).tolist()))
    spaces = [d.space_on(None, check=False, inverse=inverse) for d, _ in given]
    results = [_warped(*each, sampling) for each in zip(parts, spaces, given, strict=True)]
    return (torch.stack(results) if batch else results[0]).reshape(tensor.shape)


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

    Warns
    -----
    FoldWarning
        As in `warp`.
    """
    given, shape, batch = items(deformation, {"at": at, "by": by, "radius": radius})
    n = len(shape)
    if not isinstance(points, torch.Tensor):
        refuse("points", f"a tensor of shape (..., {n})", points)
    if not points.is_floating_point() or points.ndim == 0 or points.shape[-1] != n:
        refuse("points", f"floats of shape (..., {n}), x first", told=f"{points.dtype} of shape {tuple(points.shape)}")
    if batch and (points.ndim < 2 or len(points) != len(given)):
        refuse("points", f"of shape ({len(given)}, ..., {n}), as the batch is", told=f"shape {tuple(points.shape)}")
    results = []
    for part, (d, own) in zip(points if batch else [points], given, strict=True):
        if not d.space.is_plain:
            text = "supple.torch.forward is for strokes alone, found a deformation with fields or affine maps"
            raise SuppleError(f"{text}: Deformation.forward takes it, without gradients")
        strokes = strokes_of(d, own, points, _working(points))
        positions = strokes.at(part.to(_working(points)).reshape(-1, n).T)
        results.append(positions.T.reshape(part.shape).to(points.dtype))
    if not results:
        return points.clone()
    return torch.stack(results) if batch else results[0]


def _check(tensor: object, shape: tuple[int, ...], count: int | None) -> None:
    if not isinstance(tensor, torch.Tensor):
        refuse("tensor", "a PyTorch tensor (Deformation.warp takes arrays)", tensor)
    odd = tensor.is_floating_point() and tensor.dtype not in _FLOATS
    if tensor.is_complex() or tensor.is_quantized or tensor.layout != torch.strided or odd:
        wanted = "dense, of bool, integers or floats of 16 to 64 bits"
        refuse("tensor", wanted, told=f"{tensor.dtype}, {tensor.layout}")
    sizes, axes = ", ".join(map(str, shape)), len(shape)
    if tuple(tensor.shape[-axes:]) != shape or tensor.ndim > axes + 2:
        wanted = f"of shape ({sizes}), (C, {sizes}) or (N, C, {sizes}), as the deformation is"
        refuse("tensor", wanted, told=f"shape {tuple(tensor.shape)}")
    if count is not None and (tensor.ndim != axes + 2 or len(tensor) != count):
        wanted = f"of shape ({count}, C, {sizes}), as there are {count} deformations or sets of strokes"
        refuse("tensor", wanted, told=f"shape {tuple(tensor.shape)}")


def _warped(
    tensor: torch.Tensor, space: Space, deformed: tuple[Deformation, Given], sampling: Sampling
) -> torch.Tensor:
    """Return one warped item, of shape (K, *shape)."""
    d, given = deformed
    if not given and space.is_identity:
        return tensor.clone()
    if not given and not (torch.is_grad_enabled() and tensor.requires_grad):
        return _values(tensor, space, sampling)
    if not given:
        return _Warp.apply(tensor, None, space, sampling, None)
    strokes = strokes_of(d, given, tensor, _working(tensor))
    return _Warp.apply(tensor, strokes.numbers, space, sampling, replace(strokes, numbers=strokes.numbers.detach()))


def _working(tensor: torch.Tensor) -> torch.dtype:
    """Return the type of computations in PyTorch for a tensor."""
    return torch.float64 if tensor.dtype == torch.float64 else torch.float32


def _values(tensor: torch.Tensor, space: Space, sampling: Sampling) -> torch.Tensor:
    """Return a warped tensor (K, *shape), by the engine of its device, without gradients."""
    source: Any = tensor.detach()
    # NumPy has no bfloat16, and the core processes half precision in single precision.
    if tensor.dtype == torch.bfloat16 or (tensor.dtype == torch.float16 and not tensor.is_cuda):
        source = source.float()
    source = source.movedim(0, -1)
    if not tensor.is_cuda:
        source = np.ascontiguousarray(source.numpy(force=True))
    result, certificate = warp_array(source, space, sampling, alpha=False)
    warn_of(certificate, sampling.tolerance)
    return torch.as_tensor(result).movedim(-1, 0).contiguous().to(tensor)


def _pixels(index: torch.Tensor, space: Space) -> torch.Tensor:
    """Return the coordinates (D, P), x first, of pixels given by flat indices (P,)."""
    return torch.stack(torch.unravel_index(index, space.whole)[::-1])


def offsets_of(like: torch.Tensor, space: Space, tolerance: float) -> torch.Tensor:
    """Return T⁻¹(q) - q for all M pixels q, (D, M): in float32 as accurate as the points, for images of any size.

    They are on the device of ``like``, in its working type, and 0 at unchanged pixels.
    """
    dtype, total = _working(like), math.prod(space.whole)
    if space.is_identity:
        return torch.zeros(space.ndim, total, dtype=dtype, device=like.device)
    if like.is_cuda and dtype == torch.float32:
        from supple.cuda.points import inverse_map

        offsets, certificate = inverse_map(space, tolerance, like.detach(), offsets=True)
        warn_of(certificate, tolerance)
        return torch.as_tensor(offsets).reshape(total, space.ndim).T
    pixels = _pixels(torch.arange(total, device=like.device if like.is_cuda else "cpu"), space)
    if dtype == torch.float32:
        points, certificate = core.inverse_map(space, tolerance, dtype=np.float64)
        warn_of(certificate, tolerance)
        solved = [torch.as_tensor(points).reshape(total, space.ndim)]
    else:
        certificate, lost, solved = Certificate(0.0, 0.0), total, []
        for some in pixels.split(_SOLVED, 1):
            (points, _, _, converged), own = place_of(pixels).inverse(space, some.double().T)
            certificate |= own
            lost -= int(converged.sum())
            solved.append(torch.as_tensor(points))
        warn_of(certificate, 1.0)
        if lost:
            text = f"{lost} of {total} source points did not converge: what is shown there is a guess"
            warn(text, ToleranceWarning)
    offsets = torch.cat(solved).T - pixels
    return offsets.to(dtype).to(like.device)  # not every device has float64


def _parts(
    offsets: torch.Tensor, space: Space, sampling: Sampling, strokes: Strokes | None
) -> Iterator[tuple[slice, torch.Tensor, Taps]]:
    """Yield slices of the pixels, with their source points (D, P), and the samples around these."""
    between = "catmull-rom" if sampling.between == "cubic" else sampling.between_frames
    kinds, terms = [sampling.filter, sampling.filter, between][: space.ndim], 0
    if strokes is not None:
        table = strokes.table
        terms = int(table["terms"].sum()) + (0 if strokes.mask is None else _OF_MASKS * len(table))
    size = max(1, _ROOM // (np.size(sampling.fill) * count(kinds) + 16 * (terms + 1)))
    for start in range(0, offsets.shape[1], size):
        some = slice(start, min(start + size, offsets.shape[1]))
        pixels = _pixels(torch.arange(some.start, some.stop, device=offsets.device), space)
        own = offsets[:, some]
        lower = own.floor()
        taps = around(pixels + lower.long(), own - lower, space.whole[::-1], kinds, sampling.outside)
        yield some, pixels + own, taps


class _Warp(torch.autograd.Function):
    """The warp of a tensor (K, *shape); ``numbers`` are those of the strokes, or None if they need no gradients."""

    @staticmethod
    def forward(ctx: Any, tensor: torch.Tensor, numbers: torch.Tensor | None, *job: Any) -> torch.Tensor:
        space, sampling, strokes = ctx.job = job
        offsets = None
        if tensor.dtype != torch.float64:
            result = _values(tensor, space, sampling)
        else:  # the same points as for gradients
            offsets, flat = offsets_of(tensor, space, sampling.tolerance), tensor.reshape(len(tensor), -1)
            parts = [taps.between(taps.samples(flat, sampling.fill)) for _, _, taps in _parts(offsets, *ctx.job)]
            # Unchanged pixels are copied, so that NaN do not spread to them.
            result = torch.where(offsets.any(0), torch.cat(parts, 1), flat).reshape(tensor.shape)
        ctx.save_for_backward(None if strokes is None else tensor, offsets)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        tensor, offsets = ctx.saved_tensors
        space, sampling, strokes = ctx.job
        if offsets is None:
            offsets = offsets_of(gradient, space, sampling.tolerance)
        flat = gradient.reshape(len(gradient), -1)
        image = torch.zeros_like(flat, dtype=offsets.dtype) if ctx.needs_input_grad[0] else None
        numbers = None if strokes is None else torch.zeros_like(strokes.numbers)
        for some, points, taps in _parts(offsets, *ctx.job):
            own = flat[:, some].to(offsets.dtype)
            if image is not None:
                taps.scatter(own, image)
            if strokes is not None:
                samples = taps.samples(tensor.reshape(len(tensor), -1), sampling.fill)
                slopes = taps.slopes((own[:, None] * samples).sum(0))
                where = points.T if points.is_cuda else points.T.cpu()
                matrices = torch.as_tensor(place_of(where).forward(space, where, matrices=True)[0])
                matrices = matrices.to(points.dtype).to(points.device)  # not every device has float64
                numbers += strokes.gradient(points, adjoint(matrices.movedim(0, -1), slopes))
        image = None if image is None else image.to(gradient.dtype).reshape(gradient.shape)
        return image, numbers, None, None, None
