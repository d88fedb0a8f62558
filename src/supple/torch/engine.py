"""The values of a tensor, and the source points of its pixels, by the engine of its device."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from supple.cuda_arrays import points_on_card
from supple.deformation import Deformation
from supple.errors import ToleranceWarning
from supple.torch.field import Columns, Strokes
from supple.torch.sample import Filter
from supple.warping import warn_of

_SOLVED = 1 << 18  # points that are solved at once
_NEAR = 1 << 12  # pixels along an axis of which a coordinate in float32 is off by 0.0001 at most


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """The work on a tensor of K channels; the strokes are there if they need gradients."""

    deformation: Deformation
    filter: str
    between: str
    outside: str
    fill: npt.NDArray[np.float64]
    tolerance: float
    strokes: Strokes | None = None

    def how(self, dtype: torch.dtype, device: torch.device) -> Filter:
        """The filter that has gradients."""
        between = "catmull-rom" if self.between == "cubic" else self.between
        kinds = [self.filter, self.filter, between][: self.deformation.ndim]
        fill = torch.tensor(self.fill, dtype=dtype, device=device)
        return Filter(self.deformation.shape[::-1], kinds, self.outside, fill[:, None])


def values(tensor: torch.Tensor, job: Job) -> torch.Tensor:
    """The values of a tensor (K, *shape), by the engine of its device."""
    view = (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).detach().movedim(0, -1)
    options: dict[str, Any] = {
        "filter": job.filter,
        "between": job.between if job.deformation.ndim == 3 else None,
        "outside": job.outside,
        "fill": job.fill,
        "tolerance": job.tolerance,
        "alpha": False,
    }
    source: Any = view if view.is_cuda else view.numpy(force=True)
    made = torch.as_tensor(job.deformation.warp(source, **options))
    return made.movedim(-1, 0).to(tensor.device, tensor.dtype).contiguous()


def offsets_of(like: torch.Tensor, job: Job) -> torch.Tensor:
    """T⁻¹(q) - q of all output pixels q, in pixels: (M, D), where ``like`` is, and in the type that it is worked in.

    As offsets, they are small: float32 holds them as exactly as they are known, however large the picture is.
    """
    deformation, dtype = job.deformation, working(like)
    sizes = deformation.shape[::-1]
    where = like.device if like.is_cuda else torch.device("cpu")
    made = torch.zeros(math.prod(sizes), len(sizes), dtype=dtype, device=where)
    if deformation.is_identity:
        return made.to(like.device)
    if dtype == torch.float32 and like.is_cuda:
        detached = like.detach()
        found, certificate = points_on_card().inverse_map(deformation.space, detached, job.tolerance, offsets=True)
        warn_of(certificate, job.tolerance, 3)
        return torch.as_tensor(found).reshape(made.shape)
    if dtype == torch.float32 and max(sizes) <= _NEAR:
        sources = torch.from_numpy(deformation.inverse_map(tolerance=job.tolerance)).reshape(made.shape)
        return (sources - torch.stack(grid(torch.arange(len(made)), sizes), -1)).to(like.device)
    lost = 0
    for start in range(0, len(made), _SOLVED):
        index = torch.arange(start, min(start + _SOLVED, len(made)), device=where)
        points: Any = torch.stack(grid(index, sizes), -1).double()
        solved = deformation.inverse(points if like.is_cuda else points.numpy())
        made[start : start + len(index)] = torch.as_tensor(solved.points) - points
        lost += len(index) - int(torch.as_tensor(solved.converged).sum())
    if lost:
        text = f"{lost} of {len(made)} source points did not converge: what is shown there is a guess"
        warnings.warn(text, ToleranceWarning, stacklevel=2)
    return made.to(like.device)


def grid(index: torch.Tensor, sizes: Sequence[int]) -> Columns:
    """The coordinates, x first, of pixels that are counted row by row."""
    columns = []
    for size in sizes:
        columns.append(index % size)
        index = index // size
    return columns


def working(tensor: torch.Tensor) -> torch.dtype:
    """The type in which a tensor is worked with where engines do not do it."""
    return torch.float64 if tensor.dtype == torch.float64 else torch.float32
