"""m(p), what a freeze mask lets through of every stroke's displacement, in differentiable operations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch

from supple.strain import Mask


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """A freeze mask as tensors: a cubic B-spline, differentiable any number of times in the points.

    Parameters
    ----------
    values : tensor of floats, shape (nz, ny, nx)
        The coefficients, from 0 to 1; of one slice for images and clips.
    first, step : sequence of float
        The position of the first one, and the distance from one to the next, in physical units, x first.
    """

    values: torch.Tensor
    first: Sequence[float]
    step: Sequence[float]

    @classmethod
    def of(cls, mask: Mask | None, dtype: torch.dtype, device: torch.device) -> Self | None:
        """Return a mask in a type, on a device; None for none."""
        if mask is None:
            return None
        values = torch.tensor(mask.coefficients / 255, dtype=dtype, device=device)
        return cls(values, mask.first.tolist(), mask.step.tolist())

    def at(self, points: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return m of points in physical units: D tensors of one shape."""
        index, weights, beside = torch.zeros_like(points[0], dtype=torch.long), [], 0
        for k in reversed(range(len(points))):
            x, n = points[k], self.values.shape[2 - k]
            index = index * n
            if n > 1:
                place = ((x - self.first[k]) / self.step[k]).clamp(1, n - 2)
                cell = torch.floor(place).clamp(max=n - 3)
                around = cell.long()[..., None] + torch.arange(-1, 3, device=x.device)
                index = index[..., None] + around.reshape(*x.shape, *[1] * beside, 4)
                weights.append(_weights(place - cell))
                beside += 1
        found = self.values.reshape(-1)[index]  # around each point: along z, y and x, where m varies
        for weight in reversed(weights):
            beside -= 1
            found = (found * weight.reshape(*points[0].shape, *[1] * beside, 4)).sum(-1)
        return found


def _weights(t: torch.Tensor) -> torch.Tensor:
    """Return the weights of the four coefficients around a part of the way from the second to the third."""
    s = 1 - t
    each = (s**3, 4 - 3 * t**2 * (2 - t), 4 - 3 * s**2 * (2 - s), t**3)
    return torch.stack(each, -1) / 6
