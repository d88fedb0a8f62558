"""What is frozen in tensors: values and points as the native engine has them, and gradients by differences."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
import pytest

import supple
from supple import Freeze

if os.environ.get("SUPPLE_TEST_TORCH") == "1":
    import torch
else:
    torch = pytest.importorskip("torch")

import supple.torch as bending
from supple.torch import engine
from supple.torch.field import Freedom
from tests import reference

pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning", "ignore::supple.FoldWarning")

DOUBLE = torch.float64


def held(shape: tuple[int, ...], **options: Any) -> tuple[supple.Deformation, np.ndarray]:
    """Return a drag across what is frozen, and what that is: a corner, and a part in part."""
    mask = np.zeros(shape)
    mask[tuple(slice(1, n // 2) for n in shape)] = 1
    mask[..., : shape[-2] // 3, 3 * shape[-1] // 4 :] = 0.4
    size = np.array(shape[::-1]) - 1.0
    d = supple.Deformation(shape, freeze=Freeze.of(mask, width=6.0), on_fold="damp", **options)
    return d.grab(0.6 * size, by=-0.03 * size, radius=5), mask == 1


def numbers(d: supple.Deformation) -> tuple[torch.Tensor, ...]:
    columns = [s.at for s in d.strokes], [s.by for s in d.strokes], [s.radius for s in d.strokes]
    return tuple(torch.tensor(x, dtype=DOUBLE, requires_grad=True) for x in columns)


SHAPES = pytest.mark.parametrize("shape", [(15, 18), (7, 10, 9)])


@pytest.mark.parametrize("shape", [(15, 18), (7, 10, 9), (1, 30), (5, 1, 20)])
def test_m_is_the_spline(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    spacing = (1.0, 1.4, 0.8)[: len(shape)]
    freeze = Freeze.of(rng.uniform(size=shape) ** 3, width=7.0, spacing=spacing)
    d = supple.Deformation(shape, spacing=spacing, freeze=freeze)
    points = rng.uniform(-0.2, 1.2, (40, 5, len(shape))) * shape[::-1]
    freedom = Freedom.of(d.space.freeze, DOUBLE, torch.device("cpu"))
    assert freedom is not None
    found = freedom.at(list(torch.from_numpy(points * spacing).unbind(-1)))
    np.testing.assert_allclose(found.numpy(), reference.freedom(freeze, points), atol=1e-12)


@SHAPES
@pytest.mark.parametrize("border", [None, 4.0])
def test_points_are_those_of_the_native_engine(shape: tuple[int, ...], border: float | None) -> None:
    d, _ = held(shape, border=border)
    d = d.twist(0.7 * np.array(shape[::-1]), angle=20, radius=6, **({"axis": (1, 2, 3)} if len(shape) == 3 else {}))
    points = np.random.default_rng(4).uniform(0, 1, (6, 5, len(shape))) * (np.array(shape[::-1]) - 1)
    given = torch.from_numpy(points)
    np.testing.assert_allclose(bending.forward(given, d).numpy(), d.forward(points), atol=1e-6)
    slopes = torch.func.vmap(torch.func.jacrev(lambda p: bending.forward(p, d)))(given.flatten(0, 1))
    np.testing.assert_allclose(slopes.unflatten(0, (6, 5)).numpy(), d.jacobian(points), atol=1e-6)
    np.testing.assert_array_equal(engine.inverse(d.space, given)[0].numpy(), d.inverse(points).points)


@SHAPES
def test_forward_is_differentiable_twice(shape: tuple[int, ...]) -> None:
    d, _ = held(shape, border=4.0)
    at, by, radius = numbers(d)
    points = torch.from_numpy(np.random.default_rng(1).uniform(0.1, 0.9, (5, len(shape))) * (np.array(shape[::-1]) - 1))

    def seen(p: torch.Tensor, a: torch.Tensor, b: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
        return bending.forward(p, d, at=a, by=b, radius=r)

    points.requires_grad_()
    assert torch.autograd.gradcheck(seen, (points, at, by, radius))
    assert torch.autograd.gradgradcheck(seen, (points, at, by, radius))


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((15, 18), {"filter": "linear"}),
        ((15, 18), {"filter": "cubic"}),
        ((7, 10, 9), {"filter": "cubic", "between": "cubic"}),  # as linear interpolation has kinks
    ],
)
def test_gradients_of_a_picture_and_of_strokes(shape: tuple[int, ...], options: dict[str, Any]) -> None:
    d, _ = held(shape, border=None)
    at, by, radius = numbers(d)
    picture = torch.from_numpy(np.random.default_rng(2).normal(size=shape)).requires_grad_()

    def bent(x: torch.Tensor, a: torch.Tensor, b: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
        return bending.warp(x, d, at=a, by=b, radius=r, tolerance=1e-9, **options)

    assert d.resolution()["damping"][0] == 1  # what is damped is constant in gradients
    assert torch.autograd.gradcheck(bent, (picture, at, by, radius), fast_mode=True)


@SHAPES
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, DOUBLE])
def test_what_is_frozen_keeps_every_bit(shape: tuple[int, ...], dtype: torch.dtype) -> None:
    d, mask = held(shape)
    picture = (100 * torch.rand(2, *shape, generator=torch.Generator().manual_seed(0))).to(dtype)
    for wanted in (False, dtype.is_floating_point):
        made = bending.warp(picture.clone().requires_grad_(wanted), d, filter="cubic").detach()
        assert torch.equal(made[:, mask], picture[:, mask])
        assert not torch.equal(made, picture)
    values = d.warp(np.moveaxis(picture.float().numpy(), 0, -1), filter="cubic", alpha=False)
    ends = (0, 255) if dtype == torch.uint8 else (-np.inf, np.inf)
    near = 0.6 if dtype == torch.uint8 else 0.1 if dtype == torch.float16 else 0.3
    np.testing.assert_allclose(np.moveaxis(made.float().numpy(), 0, -1), np.clip(values, *ends), atol=near)


@SHAPES
@pytest.mark.parametrize("filter", ["linear", "cubic"])
@pytest.mark.parametrize("wanted", [False, True])
@pytest.mark.parametrize("frozen", [False, True])
def test_what_stays_is_copied_at_any_spacing(shape: tuple[int, ...], filter: str, wanted: bool, frozen: bool) -> None:
    """No NaN reaches it from beside it, though coordinates are rounded on their way to physical units and back."""
    spacing = (0.7, 1.3, 1.1)[: len(shape)]
    d, stays = held(shape, spacing=spacing)
    at = d.strokes[0].at
    if not frozen:
        d = supple.Deformation(shape, spacing=spacing).grab(at, by=(0.5,) * len(shape), radius=1.5, reach=2)
        pixels = np.moveaxis(np.indices(shape)[::-1], 0, -1)
        stays = np.linalg.norm((pixels - at) * spacing, axis=-1) > 3 + math.hypot(*(0.5 * np.array(spacing)))
    assert stays.any()
    picture = np.random.default_rng(0).uniform(size=shape)
    picture[np.indices(shape).sum(axis=0) % 2 == 0] = np.nan
    made = bending.warp(torch.tensor(picture, requires_grad=wanted), d, filter=filter).detach().numpy()
    assert made[stays].tobytes() == picture[stays].tobytes()
    assert not np.array_equal(made, picture, equal_nan=True)


def test_parts_at_a_time_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.torch import warping

    d, _ = held((15, 18))
    picture = torch.rand(15, 18, generator=torch.Generator().manual_seed(0))

    def found() -> list[torch.Tensor]:
        given = [x.detach().float().requires_grad_() for x in numbers(d)]
        bending.warp(picture, d, at=given[0], by=given[1], radius=given[2]).square().sum().backward()
        return [x.grad for x in given]

    whole = found()
    monkeypatch.setattr(warping, "_ROOM", 2000)
    for one, other in zip(whole, found(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)


def test_tensors_elsewhere_are_served_by_the_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """No device is asked where there is a mask."""
    monkeypatch.setattr(engine, "is_on_device", lambda value: pytest.fail("a device is asked"))
    d, mask = held((15, 18))
    picture = torch.rand(15, 18, generator=torch.Generator().manual_seed(0))
    made = bending.warp(picture, d)
    assert torch.equal(made[torch.from_numpy(mask)], picture[torch.from_numpy(mask)])
    engine.inverse(d.space, torch.rand(4, 2))
