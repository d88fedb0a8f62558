"""Strokes of all kinds, on all domains, with tensors for numbers: T of points, what stays, and gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import supple
from supple import Freeze
from supple.errors import SuppleError
from tests.torch.shared import DOUBLE, bending, bent, check, numbers, picture, torch
from tests.turns import AFFINE

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.MissWarning")

Shape = tuple[int, ...]


def turned(shape: Shape, **options: Any) -> supple.Deformation:
    """Return one stroke of each brush, none of which is at a pixel, and so weak that each flows in one go."""
    d = supple.Deformation(shape, **options)
    size = np.array(shape[::-1]) - 1.0
    for k, stroke in enumerate(AFFINE[len(shape)]):
        made = replace(stroke, at=(0.33 + 0.13 * k) * size, radius=0.4 * float(size.max()))
        d = d.add(made.weakened(0.2))
    return d.grab(0.47 * size, by=0.03 * size, radius=0.4 * float(size.max()), scales=2)


def frozen(shape: Shape, **options: Any) -> tuple[supple.Deformation, np.ndarray]:
    """Return a drag across what is frozen, and where that is: in a corner; another part is frozen in part."""
    mask = np.zeros(shape)
    mask[tuple(slice(1, n // 2) for n in shape)] = 1
    mask[..., : shape[-2] // 3, 3 * shape[-1] // 4 :] = 0.4
    size = np.array(shape[::-1]) - 1.0
    d = supple.Deformation(shape, freeze=Freeze.of(mask, width=6.0), on_fold="damp", **options)
    return d.grab(0.6 * size, by=-0.03 * size, radius=5), mask == 1


def in_time(shape: Shape) -> supple.Deformation:
    """Return drags with plateaus; of three axes, of a clip: with radii in time by the drag, and of their own."""
    size, clip = np.array(shape[::-1]) - 1.0, len(shape) == 3
    d = supple.Deformation(shape, border=4.0, time=clip, on_fold="damp")
    d = d.grab(0.45 * size, by=(0.5, -0.4, 1.1)[: len(shape)], radius=0.4 * float(size.max()), flat=0.3)
    d = d.grab(0.62 * size, by=(0.4, 0.3, 0.0)[: len(shape)], radius=4.5, **({"time_radius": 2.5} if clip else {}))
    return d.grab(0.6 * size, by=(0.4, 0.3, 0.3)[: len(shape)], radius=4.0, poisson=0.3, reach=3, flat=0.5)


MAPS: dict[str, Callable[[Shape], supple.Deformation]] = {
    "free": lambda shape: bent(shape, border=None, spacing=(1.0, 1.7, 0.7)[: len(shape)]),
    "border": lambda shape: bent(shape, border=3.0),
    "wide border": lambda shape: bent(shape, border=50.0),
    "reach": lambda shape: bent(shape, reach=1.2, border=5.0),
    "reach, sine": lambda shape: bent(shape, reach=2.0, border=5.0, border_profile="sine"),
    "turned": lambda shape: turned(shape, border=None, on_fold="damp", spacing=(1.0, 0.8, 1.2)[: len(shape)]),
    "turned, flow": lambda shape: turned(shape, border=4.0),
    "turned, flow, sine": lambda shape: turned(shape, border=4.0, border_profile="sine"),
    "frozen": lambda shape: frozen(shape, border=4.0)[0],
    "in time": in_time,
    "pulled": lambda shape: supple.Deformation(shape, border=4.0).pull(
        np.multiply([[0.4], [0.6]], np.array(shape[::-1]) - 1), by=[(0.4, -0.3, 0.2)[: len(shape)]] * 2, radius=5
    ),
}
GRADIENTS = [name for name in MAPS if name != "pulled"]
each = pytest.mark.parametrize


def points_in(shape: Shape, count: int = 30) -> torch.Tensor:
    return (0.05 + 0.9 * picture(count, len(shape), seed=3)) * (torch.tensor(shape[::-1]) - 1)


@each("name", MAPS)
@each("shape", [(17, 23), (9, 11, 13)])
def test_points_and_their_gradients_are_the_engines(name: str, shape: Shape) -> None:
    d, points = MAPS[name](shape), points_in(shape)
    expected = d.forward(points.numpy())
    assert np.abs(expected - points.numpy()).max() > 0.03
    near = 1e-6 if name == "frozen" else 1e-11  # engines hold masks in float32
    np.testing.assert_allclose(bending.forward(points, d).numpy(), expected, atol=near)
    slopes = torch.func.vmap(torch.func.jacrev(lambda p: bending.forward(p, d)))(points)
    np.testing.assert_allclose(slopes.numpy(), d.jacobian(points.numpy()), atol=near)
    if name == "pulled":
        with pytest.raises(SuppleError, match="found one that pulls several points; use grabs"):
            bending.forward(points, d, radius=torch.tensor([5.0], requires_grad=True))
        return
    seen = bending.forward(points, d, **numbers(d)).detach()
    np.testing.assert_allclose(seen.numpy(), expected, atol=near)
    seen = bending.forward(points.float(), d, **numbers(d)).detach()
    np.testing.assert_allclose(seen.numpy(), expected, atol=1e-4)


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning")
@each("shape", [(1, 9), (1, 5, 6)])
@each("border", [None, 4.0])
def test_points_outside_and_axes_of_one_sample(shape: Shape, border: float | None) -> None:
    d, points = bent(shape, border=border), picture(4, 6, len(shape)) * 16 - 4
    np.testing.assert_allclose(bending.forward(points, d).numpy(), d.forward(points.numpy()), atol=1e-10)


@each("name", GRADIENTS)
def test_points_are_differentiable_twice_in_all_numbers(name: str) -> None:
    d = MAPS[name]((17, 23))
    points, given = points_in((17, 23), 5).requires_grad_(), numbers(d)
    if any(s.brush != "grab" for s in d.strokes):
        del given["by"]

    def seen(p: torch.Tensor, *values: torch.Tensor) -> torch.Tensor:
        return bending.forward(p, d, **dict(zip(given, values, strict=True)))

    check(seen, points, *given.values())
    if name in ("free", "frozen"):
        assert torch.autograd.gradgradcheck(lambda *x: seen(*x).sum(), (points, *given.values()), fast_mode=True)


@each("shape", [(17, 23), (5, 6, 7)])
@each("name", GRADIENTS)
def test_warps_are_differentiable_in_the_picture_and_all_numbers(name: str, shape: Shape) -> None:
    d, how = MAPS[name](shape), {"filter": "cubic"} if len(shape) == 2 else {"filter": "cubic", "between": "cubic"}
    image, given = picture(*shape, seed=1).requires_grad_(), numbers(d)
    bending.warp(image, d, **given, **how).square().sum().backward()
    assert all(given[name].grad.any() for name in ("at", "radius"))
    for drag, stroke in zip(given["by"].grad, d.strokes, strict=True):
        assert drag.any() == (stroke.brush == "grab")
    if any(s.brush != "grab" for s in d.strokes):
        del given["by"]
    check(lambda x, *y: bending.warp(x, d, **dict(zip(given, y, strict=True)), **how), image, *given.values())


def test_pivots_of_turning_brushes_are_not_moved() -> None:
    d = turned((17, 23))
    with pytest.raises(SuppleError, match=r"stroke 1 of 5: by must be left out for a twist, which does not move"):
        bending.forward(points_in((17, 23)), d, by=torch.ones(5, 2, dtype=DOUBLE))


def local(shape: Shape, **options: Any) -> tuple[supple.Deformation, np.ndarray]:
    """Return a drag of short reach, and where that ends."""
    d = supple.Deformation(shape, **options)
    at, steps = 0.6 * (np.array(shape[::-1]) - 1), np.array(d.domain.spacing)
    pixels = np.moveaxis(np.indices(shape)[::-1], 0, -1)
    stays = np.linalg.norm((pixels - at) * steps, axis=-1) > 3 + np.linalg.norm(0.5 * steps)
    return d.grab(at, by=(0.5,) * len(shape), radius=1.5, reach=2), stays


@each("shape", [(15, 18), (7, 10, 9)])
@each("filter", ["linear", "cubic"])
@each("dtype", [torch.uint8, torch.float16, torch.float32, DOUBLE])
@each("by", [frozen, local])
def test_what_stays_keeps_every_bit(by: Any, dtype: torch.dtype, filter: str, shape: Shape) -> None:
    """No NaN reaches it from beside it, though coordinates are rounded on their way to physical units and back."""
    d, stays = by(shape, spacing=(0.7, 1.3, 1.1)[: len(shape)])
    assert stays.any()
    image = (100 * picture(*shape)).to(dtype)
    if dtype in (torch.float32, DOUBLE):  # half precision is converted, which changes the bits of NaN
        image[torch.from_numpy(np.indices(shape).sum(axis=0) % 2 == 0)] = torch.nan
        image[0] = -0.0
    for wanted in {False, dtype.is_floating_point}:
        made = bending.warp(image.clone().requires_grad_(wanted), d, filter=filter).detach()
        assert made.numpy()[stays].tobytes() == image.numpy()[stays].tobytes()
        assert not torch.equal(made.nan_to_num(), image.nan_to_num())
