"""Brushes that twist, scale and pinch, and strokes that act at once, in PyTorch: values and gradients."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import SuppleError
from tests import reference
from tests.turns import AFFINE, at_once

if os.environ.get("SUPPLE_TEST_TORCH") == "1":
    import torch
else:
    torch = pytest.importorskip("torch")

import supple.torch as bending
from supple.torch import engine
from supple.torch.field import Strokes, moved

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

DOUBLE = torch.float64
WAYS: list[dict[str, Any]] = [
    {"border": None, "on_fold": "damp"},
    {"border": 4.0, "on_fold": "damp"},
    {"border": 4.0, "on_fold": "flow"},
    {"border": 4.0, "on_fold": "flow", "border_profile": "sine"},
]


def turned(shape: tuple[int, ...], **options: Any) -> supple.Deformation:
    """Return one stroke of each brush, none of which is at a pixel, and so weak that each flows in one go."""
    d = supple.Deformation(shape, **options)
    size = np.array(shape[::-1]) - 1.0
    for k, stroke in enumerate(AFFINE[len(shape)]):
        made = replace(stroke, at=(0.33 + 0.13 * k) * size, radius=0.4 * float(size.max()))
        d = d.add(made.weakened(0.2))
    return d.grab(0.47 * size, by=0.03 * size, radius=0.4 * float(size.max()), scales=2)


def numbers(d: supple.Deformation) -> dict[str, torch.Tensor]:
    return {
        name: torch.tensor([getattr(s, name) for s in d.strokes], dtype=DOUBLE, requires_grad=True)
        for name in ("at", "by", "radius")
    }


def check(function: Callable[..., torch.Tensor], *inputs: torch.Tensor) -> None:
    weights = torch.randn(function(*inputs).shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(9))
    # Of a picture's many numbers, the gradient is checked along a random direction.
    fast = max(x.numel() for x in inputs) > 50
    assert torch.autograd.gradcheck(
        lambda *given: (function(*given) * weights).sum(), inputs, atol=1e-6, fast_mode=fast
    )


def places(d: supple.Deformation, count: int = 40) -> torch.Tensor:
    return torch.from_numpy(
        np.random.default_rng(3).uniform(0.05, 0.95, (count, d.ndim)) * (np.array(d.shape[::-1]) - 1)
    )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("shape", "spacing"), [((17, 23), (1.0, 1.3)), ((9, 11, 13), (1.0, 0.8, 1.2))])
def test_points_and_their_gradients(shape: tuple[int, ...], spacing: tuple[float, ...], way: dict[str, Any]) -> None:
    d = turned(shape, spacing=spacing, **way)
    assert len(d.space.table) == len(d.strokes)
    points, given = places(d), numbers(d)
    expected = d.forward(points.numpy())
    assert np.abs(expected - points.numpy()).max() > 0.1
    np.testing.assert_allclose(bending.forward(points, d).numpy(), expected, atol=1e-11)
    np.testing.assert_allclose(bending.forward(points, d, **given).detach().numpy(), expected, atol=1e-11)
    slopes = torch.func.vmap(torch.func.jacrev(lambda p: bending.forward(p, d)))(points)
    np.testing.assert_allclose(slopes.numpy(), d.jacobian(points.numpy()), atol=1e-11)
    # How a damped stroke's part changes with its numbers is no part of its gradients.
    free = points[:6].clone().requires_grad_()
    if way["border"] is None or way["on_fold"] == "flow":
        check(lambda p, at, radius: bending.forward(p, d, at=at, radius=radius), free, given["at"], given["radius"])


@pytest.mark.parametrize("way", WAYS[::2])
def test_gradients_of_pictures(way: dict[str, Any]) -> None:
    d = turned((17, 23), **way)
    image = torch.rand(17, 23, dtype=DOUBLE, generator=torch.Generator().manual_seed(1)).requires_grad_()
    given = numbers(d)
    check(
        lambda image, at, radius: bending.warp(image, d, at=at, radius=radius, filter="cubic"),
        image, given["at"], given["radius"],
    )  # fmt: skip
    bending.warp(image, d, **given, filter="cubic").square().sum().backward()
    assert given["at"].grad.abs().min() > 0
    assert not given["by"].grad[:-1].any()
    assert given["by"].grad[-1].all()


def test_gradients_of_volumes() -> None:
    d = turned((5, 6, 7), border=None)
    volume, given = torch.rand(5, 6, 7, dtype=DOUBLE, generator=torch.Generator().manual_seed(2)), numbers(d)
    how: Any = {"filter": "cubic", "between": "cubic"}
    check(lambda at, radius: bending.warp(volume, d, at=at, radius=radius, **how), given["at"], given["radius"])


def test_pivots_of_turning_brushes_are_not_moved() -> None:
    d = turned((17, 23))
    with pytest.raises(SuppleError, match=r"stroke 1 of 5: by must be left out for a twist, which does not move"):
        bending.forward(places(d), d, by=torch.ones(5, 2, dtype=DOUBLE))


def test_gradients_need_brushes_that_flow_in_one_go() -> None:
    d = supple.Deformation((40, 50)).twist((20, 20), angle=180, radius=9)
    with pytest.raises(SuppleError, match="carried out in one go"):
        bending.forward(places(d), d, at=torch.tensor([[20.0, 20.0]], requires_grad=True))


@pytest.mark.parametrize("border", [None, 4.0])
@pytest.mark.parametrize("shape", [(17, 23), (9, 11, 13)])
def test_strokes_that_act_at_once(shape: tuple[int, ...], border: float | None) -> None:
    d = supple.Deformation(shape, border=border)
    table, steps = at_once(d.domain)
    space, points = replace(d.space, table=table), places(d)
    expected, slopes = reference.moved(steps, d.domain, points.numpy())
    strokes = Strokes.of(space, DOUBLE, torch.device("cpu"))

    def seen(p: torch.Tensor) -> torch.Tensor:
        return torch.stack(moved(list(p.unbind(-1)), strokes), -1)

    np.testing.assert_allclose(seen(points).numpy(), expected, atol=1e-11)
    np.testing.assert_allclose(torch.func.vmap(torch.func.jacrev(seen))(points).numpy(), slopes, atol=1e-11)
    found, _, _, converged = engine.inverse(space, points)
    assert converged.all()
    np.testing.assert_allclose(found.numpy(), reference.inverse(steps, d.domain, points.numpy()), atol=1e-7)
