"""What the tests of tensors share: strokes, pictures, and a check of gradients by differences."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import supple

if os.environ.get("SUPPLE_TEST_TORCH") == "1":
    import torch
else:
    torch = pytest.importorskip("torch")

import supple.torch as bending

__all__ = ["bending"]
DOUBLE = torch.float64


def bent(shape: tuple[int, ...] = (9, 11), reach: float | None = None, **options: Any) -> supple.Deformation:
    """Three strokes of one to three scales, none of which lies on a pixel."""
    d = supple.Deformation(shape, **{"border": 4.0, "on_fold": "damp", **options})
    middle = (np.array(shape[::-1]) - 1) / 2
    drags = np.array([[1.1, -0.7, 0.4], [-0.5, 0.73, -0.61], [0.37, 0.41, 0.53]])[:, : len(shape)]
    places = np.array([[-0.63, 0.71, 0.29], [1.27, -1.13, 0.37], [-1.31, -0.57, -0.21]])[:, : len(shape)]
    for i, (drag, place) in enumerate(zip(drags, places, strict=True)):
        radius, poisson = 4.3 - 0.4 * i, (0.4, 0.5, -np.inf)[i]
        d = d.grab(middle + place, by=drag, radius=radius, scales=i + 1, poisson=poisson, reach=reach)
    return d


def numbers(d: supple.Deformation, dtype: Any = DOUBLE) -> dict[str, torch.Tensor]:
    """The strokes' numbers as tensors that need gradients."""
    return {
        name: torch.tensor([getattr(stroke, name) for stroke in d.strokes], dtype=dtype, requires_grad=True)
        for name in ("at", "by", "radius")
    }


def picture(*shape: int, seed: int = 0, dtype: Any = DOUBLE) -> torch.Tensor:
    return torch.rand(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


def smooth(*shape: int) -> torch.Tensor:
    """A picture of waves a few pixels long, of values from -1 to 1, in float64."""
    axes = torch.meshgrid(*[torch.arange(n, dtype=DOUBLE) for n in shape[-2:]], indexing="ij")
    wave = torch.sin(0.37 * axes[0] + 0.11 * axes[1]) * torch.cos(0.29 * axes[1] - 0.07 * axes[0])
    return wave.expand(shape).clone()


def no_kinks(d: supple.Deformation) -> None:
    """No source point is where linear interpolation has a kink, but for those that a fixed border holds there."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in d.shape], indexing="ij")[::-1], -1).astype(float)
    points = d.inverse(grid).points
    near = abs(points - np.round(points)) < 1e-5
    assert not (near & (abs(points - grid) > 1e-12)).any()


def check(function: Callable[..., torch.Tensor], *inputs: torch.Tensor) -> None:
    """Each input's gradient of a random sum of what comes out, against differences."""
    weights = torch.randn(function(*inputs).shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(9))
    # Of a picture's many numbers, the gradient is checked along a random direction.
    fast = max(x.numel() for x in inputs) > 50
    assert torch.autograd.gradcheck(
        lambda *given: (function(*given) * weights).sum(), inputs, atol=1e-6, fast_mode=fast
    )
