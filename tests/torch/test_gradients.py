"""Tensors through a map: the engine's values in PyTorch's layouts, and gradients by the implicit function theorem."""

from __future__ import annotations

import itertools
import os
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import FoldWarning, SuppleError

if os.environ.get("SUPPLE_TEST_TORCH") == "1":
    import torch
else:
    torch = pytest.importorskip("torch")

import supple.torch as bending
from supple.torch import warping
from supple.torch.warping import offsets_of

DOUBLE = torch.float64


def bent(shape: tuple[int, ...] = (9, 11), reach: float | None = None, **options: Any) -> supple.Deformation:
    """Three strokes of one to three scales, none of which lies on a pixel."""
    options = {"border": 4.0, **options}
    d = supple.Deformation(shape, **{"on_fold": "damp", **options})
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


def pixels(d: supple.Deformation) -> Any:
    """Return the points of all pixels."""
    return np.stack(np.meshgrid(*[np.arange(n) for n in d.shape], indexing="ij")[::-1], -1).astype(float)


def no_kinks(d: supple.Deformation) -> None:
    """No source point is where linear interpolation has a kink, but for those that a fixed border holds there."""
    grid = pixels(d)
    found = d.inverse(grid).points
    near = abs(found - np.round(found)) < 1e-5
    assert not (near & (abs(found - grid) > 1e-12)).any()


def check(function: Callable[..., torch.Tensor], *inputs: torch.Tensor) -> None:
    """Each input's gradient of a random sum of what comes out, against differences."""
    weights = torch.randn(function(*inputs).shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(9))
    # Of a picture's many numbers, the gradient is checked along a random direction.
    fast = max(x.numel() for x in inputs) > 50
    assert torch.autograd.gradcheck(
        lambda *given: (function(*given) * weights).sum(), inputs, atol=1e-6, fast_mode=fast
    )


@pytest.mark.parametrize("filter", ["linear", "cubic", "nearest"])
@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
def test_gradients_of_a_picture_and_of_strokes(filter: str, outside: str) -> None:
    d = bent(border=None)
    no_kinks(d)
    given = numbers(d)
    image = picture(2, 9, 11).requires_grad_()
    options: Any = {"filter": filter, "outside": outside, "fill": (0.3, -2.0)}
    check(
        lambda image, at, by, radius: bending.warp(image, d, at=at, by=by, radius=radius, **options),
        image,
        *given.values(),
    )
    if filter == "nearest":
        bending.warp(image, d, **given, **options).sum().backward()
        assert all(not x.grad.any() for x in given.values())


@pytest.mark.parametrize("border", [None, 3.0, 50.0])
@pytest.mark.parametrize(("filter", "spacing"), [("linear", (1.0, 1.7)), ("cubic", 1.0), ("cubic", (1.0, 1.7))])
def test_gradients_on_any_domain(border: float | None, filter: str, spacing: Any) -> None:
    d = bent(border=border, spacing=spacing)
    no_kinks(d)
    image = picture(9, 11)
    check(
        lambda at, by, radius: bending.warp(image, d, at=at, by=by, radius=radius, filter=filter),
        *numbers(d).values(),
    )


@pytest.mark.parametrize("profile", ["quartic", "sine"])
@pytest.mark.parametrize("reach", [1.2, 2.0])
def test_gradients_with_reach_and_either_profile(reach: float, profile: Any) -> None:
    d = bent((14, 16), reach=reach, border=5.0, border_profile=profile)
    image = picture(14, 16)
    still = torch.tensor(~np.any(d.inverse(pixels(d)).points != pixels(d), axis=-1))
    assert 10 < still.sum() < 200
    made = bending.warp(image.clone().requires_grad_(), d, filter="cubic")
    assert torch.equal(made[still], image[still])
    spoiled = torch.where(still, torch.full_like(image, torch.nan), image)
    spoiled[0, 0] = -0.0
    made = bending.warp(spoiled.clone().requires_grad_(), d, filter="cubic").detach()
    assert made[still].numpy().tobytes() == spoiled[still].numpy().tobytes()
    check(
        lambda at, by, radius: bending.warp(image, d, at=at, by=by, radius=radius, filter="cubic"),
        *numbers(d).values(),
    )
    points = picture(40, 2) * 15
    assert np.allclose(bending.forward(points, d).numpy(), d.forward(points.numpy()), rtol=0, atol=1e-12)
    assert np.allclose(bending.forward(points, d, **numbers(d)).detach().numpy(), d.forward(points.numpy()), atol=1e-12)
    pivots = numbers(d)
    at_rest = pivots["at"].detach().clone()
    check(lambda at, by, radius: bending.forward(at_rest, d, at=at, by=by, radius=radius), *pivots.values())


@pytest.mark.parametrize(
    ("filter", "between", "outside", "border", "spacing"),
    [
        ("linear", None, "edge", 3.0, 1.0),
        ("cubic", None, "reflect", None, (1.0, 1.2, 1.7)),
        ("cubic", "cubic", "constant", None, 1.0),
        ("linear", "nearest", "edge", 3.0, (0.8, 1.0, 1.3)),
    ],
)
def test_gradients_of_volumes(
    filter: str, between: str | None, outside: str, border: float | None, spacing: Any
) -> None:
    d = bent((4, 5, 6), border=border, spacing=spacing)
    no_kinks(d)
    options: Any = {"filter": filter, "between": between, "outside": outside, "fill": 0.5}
    volume = picture(4, 5, 6)
    check(lambda at, by, radius: bending.warp(volume, d, at=at, by=by, radius=radius, **options), *numbers(d).values())
    check(lambda volume: bending.warp(volume, d, **options), picture(4, 5, 6).requires_grad_())


def test_a_batch_has_strokes_of_its_own() -> None:
    d = bent()
    given = numbers(d)
    at = torch.stack([given["at"], given["at"] + 0.13]).detach().requires_grad_()
    radius = torch.stack([given["radius"], given["radius"] * 1.1]).detach().requires_grad_()
    image = picture(2, 2, 9, 11).requires_grad_()
    check(
        lambda image, at, by, radius: bending.warp(image, d, at=at, by=by, radius=radius),
        image,
        at,
        given["by"],
        radius,
    )
    made = bending.warp(image, d, at=at, by=given["by"], radius=radius)
    each = [bending.warp(image[i], d, at=at[i], by=given["by"], radius=radius[i]) for i in range(2)]
    assert torch.equal(made, torch.stack(each))
    two = [d, bent(border=2.0)]
    made = bending.warp(image, two)
    assert torch.equal(made, torch.stack([bending.warp(image[i], two[i]) for i in range(2)]))
    points = picture(2, 5, 2) * 8
    seen = bending.forward(points, two)
    assert torch.equal(seen, torch.stack([bending.forward(points[i], two[i]) for i in range(2)]))


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning")
@pytest.mark.parametrize("shape", [(9, 11), (5, 6, 7), (1, 9), (1, 5, 6)])
@pytest.mark.parametrize("border", [None, 4.0])
def test_forward_is_the_engines(shape: tuple[int, ...], border: float | None) -> None:
    d = bent(shape, border=border, spacing=(1.0, 1.3, 0.7)[: len(shape)])
    points = picture(4, 6, len(shape)) * 16 - 4
    expected = d.forward(points.numpy())
    assert np.allclose(bending.forward(points, d).numpy(), expected, rtol=0, atol=1e-10)
    given = numbers(d)
    made = bending.forward(points, d, **given)
    assert np.allclose(made.detach().numpy(), expected, rtol=0, atol=1e-10)
    assert np.allclose(bending.forward(points.float(), d, **given).detach().numpy(), expected, rtol=0, atol=1e-5)


def test_forward_is_differentiable_twice() -> None:
    d = bent(border=None)
    points = (picture(3, 2) * 8).requires_grad_()
    given = numbers(d)
    check(
        lambda points, at, by, radius: bending.forward(points, d, at=at, by=by, radius=radius), points, *given.values()
    )
    only = {"at": given["at"]}
    assert torch.autograd.gradgradcheck(lambda p, at: bending.forward(p, d, at=at).sum(), (points, *only.values()))


def test_strokes_without_force_have_gradients() -> None:
    d = bent(border=4.0)
    given = numbers(d)
    given["by"] = given["by"].detach().clone()
    given["by"][1] = 0
    given["by"].requires_grad_()
    image = smooth(9, 11)
    check(lambda by: bending.warp(image, d, at=given["at"], by=by, filter="cubic"), given["by"])
    bending.warp(image, d, by=given["by"], filter="cubic").square().sum().backward()
    assert given["by"].grad.all()
    none = torch.zeros(3, 2, dtype=DOUBLE, requires_grad=True)
    made = bending.warp(image, d, by=none, filter="cubic")
    assert torch.equal(made, image)
    check(lambda by: bending.warp(image, d, by=by, filter="cubic"), none)


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [(kind, (9, 11)) for kind in (torch.float16, torch.float32, DOUBLE, torch.uint8, torch.bool)]
    + [(torch.float32, (4, 5, 6)), (torch.bool, (4, 5, 6))],
)
def test_values_are_the_engines_in_every_layout(dtype: Any, shape: tuple[int, ...]) -> None:
    d = bent(shape)
    whole = (picture(3, 4, *shape) * 200).to(dtype)
    near = {torch.float16: 0.2, torch.bool: 0.0}.get(dtype, 1e-3 if dtype.is_floating_point else 1.0)
    for tensor, how in itertools.product((whole[0, 0], whole[0], whole), ("linear", "nearest")):
        made = bending.warp(tensor, d, filter=how, outside="reflect")
        assert (made.dtype, made.shape, made.device) == (tensor.dtype, tensor.shape, tensor.device)
        assert made.is_contiguous()
        flat = tensor.reshape(-1, *shape).numpy()
        expected = np.array([d.warp(part, filter=how, outside="reflect") for part in flat], float)
        # One channel and several may be rounded otherwise.
        assert abs(made.reshape(-1, *shape).numpy() - expected).max() <= near
    turned = whole.transpose(-1, -2).contiguous().transpose(-1, -2)
    assert torch.equal(bending.warp(turned, d), bending.warp(whole, d))


@pytest.mark.parametrize("filter", ["linear", "cubic", "nearest"])
@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
@pytest.mark.parametrize("shape", [(16, 19), (5, 8, 9)])
def test_what_has_gradients_is_what_the_engine_makes(filter: str, outside: str, shape: tuple[int, ...]) -> None:
    d = bent(shape, border=None)
    d = d.grab(np.array(shape[::-1]) - 1.5, by=(2.3, 1.9, 1.2)[: len(shape)], radius=6.0, reach=None)
    tensor = smooth(2, *shape)
    options: Any = {"filter": filter, "outside": outside, "fill": (0.5, 2.0)}
    if len(shape) == 3 and filter == "cubic":
        options["between"] = "cubic"
    made = bending.warp(tensor.clone().requires_grad_(), d, **options)
    expected = d.warp(np.moveaxis(tensor.numpy(), 0, -1), alpha=False, tolerance=1e-3, **options)
    off = abs(made.detach().numpy() - np.moveaxis(expected, -1, 0))
    assert off.max() < 3e-3 if filter != "nearest" else (off > 0).mean() < 0.01
    rough = bending.warp(tensor.float().requires_grad_(), d, **options)
    assert (rough - made).abs().max() < 0.02 if filter != "nearest" else (rough != made.float()).float().mean() < 0.02


@pytest.mark.parametrize(("dtype", "near"), [(torch.float32, 0.02), (torch.float16, 0.03), (torch.bfloat16, 0.05)])
def test_gradients_in_shorter_types(dtype: Any, near: float) -> None:
    d = bent((40, 50), border=6.0).grab((23.2, 19.1), by=(4.0, -3.0), radius=8.0, reach=None)
    tensor = smooth(2, 3, 40, 50)
    weights = smooth(2, 3, 50, 40).transpose(-1, -2)
    found = {}
    for kind in (DOUBLE, dtype):
        image = tensor.clone().to(kind).requires_grad_()
        given = numbers(d, torch.float32 if kind != DOUBLE else kind)
        made = bending.warp(image, d, **given, filter="cubic", tolerance=1e-3)
        assert made.dtype == kind
        (made.to(DOUBLE) * weights).sum().backward()
        assert image.grad.dtype == kind
        found[kind] = [image.grad, *(x.grad for x in given.values())]
    for exact, rough in zip(found[DOUBLE], found[dtype], strict=True):
        assert (exact - rough.to(DOUBLE)).abs().max() < near * exact.abs().max()


def test_parts_at_a_time_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    d = bent((20, 30))
    results = []
    for room in (1 << 23, 1 << 12):
        monkeypatch.setattr(warping, "_ROOM", room)
        image, given = smooth(2, 20, 30).requires_grad_(), numbers(d)
        made = bending.warp(image, d, **given)
        made.square().sum().backward()
        results.append([made, image.grad, *(x.grad for x in given.values())])
    assert all(torch.allclose(a, b, rtol=1e-12, atol=1e-12) for a, b in zip(*results, strict=True))


def test_far_pixels_of_a_wide_picture_lose_nothing() -> None:
    d = supple.Deformation((3, 200_000), border=None, on_fold="damp").grab(
        (199_950.0, 1.0), by=(3.3, 0.1), radius=40, reach=None
    )
    found = offsets_of(torch.zeros(3, 200_000), d, 1e-4)
    columns = np.arange(199_900, 200_000)
    grid = np.stack([columns, np.ones(100)], -1)
    exact = d.inverse(grid).points - grid
    assert abs(found.T.reshape(3, 200_000, 2)[1, 199_900:].numpy() - exact).max() < 3e-4


def test_damping_is_constant_in_the_gradient() -> None:
    d = supple.Deformation((30, 30), border=None, on_fold="damp")
    with pytest.warns(FoldWarning):
        strong = d.grab((14.2, 15.1), by=(40.0, 3.0), radius=5.0, reach=None)
    (alpha,) = strong.resolution()["damping"]
    given = numbers(strong)
    image = smooth(30, 30)
    with pytest.warns(FoldWarning) as caught:
        made = bending.warp(image, strong, **given, filter="cubic")
    assert [w.filename for w in caught] == [__file__]
    made.square().sum().backward()
    weak = d.grab((14.2, 15.1), by=np.multiply(alpha, (40.0, 3.0)), radius=5.0, reach=None)
    plain = numbers(weak)
    same = bending.warp(image, weak, **plain, filter="cubic")
    same.square().sum().backward()
    assert torch.allclose(made, same, atol=1e-9)
    assert torch.allclose(given["at"].grad, plain["at"].grad)
    assert torch.allclose(given["by"].grad, alpha * plain["by"].grad)
    assert torch.allclose(given["radius"].grad, plain["radius"].grad)


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning")
def test_strokes_that_flow() -> None:
    d = supple.Deformation((20, 24), border=8.0, on_fold="flow").grab(
        (3.3, 5.2), by=(0.8, -0.6), radius=6.0, reach=None
    )
    assert d.resolution()["applied"] == 1
    given = numbers(d)
    points = (picture(5, 2) * 15).requires_grad_()
    exact = d.forward(points.detach().numpy())
    assert np.allclose(bending.forward(points, d, **given).detach().numpy(), exact, atol=1e-10)
    check(lambda points, at, by: bending.forward(points, d, at=at, by=by), points, given["at"], given["by"])
    image = smooth(20, 24)
    check(lambda at, by, radius: bending.warp(image, d, at=at, by=by, radius=radius, filter="cubic"), *given.values())
    outside = supple.Deformation((20, 24), border=8.0, on_fold="flow").grab(
        (-2.0, 5.2), by=(0.8, -0.6), radius=6.0, reach=None
    )
    made = bending.forward(points, outside, **numbers(outside))
    assert np.allclose(made.detach().numpy(), outside.forward(points.detach().numpy()), atol=1e-10)
    several = supple.Deformation((20, 24), border=None, on_fold="flow").grab(
        (12, 9), by=(9.0, 3.0), radius=4.0, reach=None
    )
    assert np.allclose(bending.forward(points, several).detach().numpy(), several.forward(points.detach().numpy()))
    warped = bending.warp(image.clone().requires_grad_(), several, by=torch.tensor([[9.0, 3.0]]))
    assert warped.requires_grad
    with pytest.raises(SuppleError, match="found one that flows in several; use on_fold='damp'"):
        bending.warp(image, several, at=numbers(several)["at"])


def test_a_stroke_is_found_from_pictures() -> None:
    true = supple.Deformation((40, 44), border=8.0, on_fold="damp").grab(
        (20.0, 18.0), by=(3.2, -2.4), radius=9.0, reach=None
    )
    image = smooth(40, 44).float()
    target = bending.warp(image, true)
    at, by, radius = torch.tensor([[22.0, 17.0]]), torch.zeros(1, 2), torch.tensor([8.0])
    given = [x.requires_grad_() for x in (at, by, radius)]
    search = torch.optim.LBFGS(given, line_search_fn="strong_wolfe", max_iter=40)

    def loss() -> torch.Tensor:
        search.zero_grad()
        off = (bending.warp(image, true, at=at, by=by, radius=radius, filter="cubic") - target).square().mean()
        off.backward()
        return off

    search.step(loss)
    assert torch.allclose(at, torch.tensor([[20.0, 18.0]]), atol=0.2)
    assert torch.allclose(by, torch.tensor([[3.2, -2.4]]), atol=0.05)
    assert torch.allclose(radius, torch.tensor([9.0]), atol=0.2)


def test_nothing_is_kept_that_needs_no_gradient() -> None:
    d = bent()
    given = numbers(d)
    image = picture(9, 11, dtype=torch.float32)
    assert not bending.warp(image, d).requires_grad
    with torch.no_grad():
        made = bending.warp(image.requires_grad_(), d, **given, filter="auto")
        assert not made.requires_grad
        assert bending.warp((image > 0.5), d, **given, filter="nearest").dtype == torch.bool
    still = supple.Deformation((9, 11), border=64, on_fold="damp")
    image = torch.tensor([[np.nan, 1.0, np.inf]]).expand(9, 3).repeat(1, 4)[:, :11].contiguous()
    for tensor in (image, image.double(), image.double().requires_grad_()):
        assert np.array_equal(bending.warp(tensor, still).detach().numpy(), tensor.detach().numpy(), equal_nan=True)
    assert bending.warp(torch.zeros(0, 3, 9, 11), d).shape == (0, 3, 9, 11)


def test_gradients_of_gradients_are_refused() -> None:
    d = bent()
    image = picture(9, 11).requires_grad_()
    (slope,) = torch.autograd.grad(bending.warp(image, d).square().sum(), image, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no NVIDIA gpu")
@pytest.mark.parametrize("shape", [(40, 50), (8, 20, 24)])
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, DOUBLE])
def test_a_card_does_the_same(shape: tuple[int, ...], dtype: Any) -> None:
    d = bent(shape)
    found = []
    for where in ("cpu", "cuda"):
        image = smooth(2, 3, *shape).to(where, dtype).requires_grad_()
        given = {name: x.detach().to(where).requires_grad_() for name, x in numbers(d).items()}
        made = bending.warp(image, d, **given, filter="cubic")
        assert (made.device, made.dtype) == (image.device, dtype)
        made.double().square().sum().backward()
        found.append([x.detach().cpu().double() for x in (made, image.grad, *(x.grad for x in given.values()))])
    for here, there in zip(*found, strict=True):
        assert (here - there).abs().max() < 0.02 * here.abs().max()


IMAGE = torch.zeros(9, 11)
PLAIN = bent()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: bending.warp(IMAGE.numpy(), PLAIN), "tensor must be a PyTorch tensor"),
        (lambda: bending.warp(IMAGE.T, PLAIN), "tensor must be of shape (9, 11), (C, 9, 11) or (N, C, 9, 11)"),
        (lambda: bending.warp(IMAGE[None, None, None], PLAIN), "tensor must be of shape (9, 11)"),
        (lambda: bending.warp(IMAGE[0], PLAIN), "tensor must be of shape (9, 11)"),
        (lambda: bending.warp(IMAGE.to(torch.complex64), PLAIN), "tensor must be dense, of bool, integers or floats"),
        (lambda: bending.warp(IMAGE.to(torch.float8_e5m2), PLAIN), "tensor must be dense"),
        (lambda: bending.warp(IMAGE.to_sparse(), PLAIN), "tensor must be dense"),
        (lambda: bending.warp(IMAGE, "grab"), "deformation must be a Deformation, or a sequence of them"),
        (lambda: bending.warp(IMAGE, []), "deformation must be a Deformation, or a sequence of them"),
        (lambda: bending.warp(IMAGE, [PLAIN, bent((8, 9))]), "must be of one shape, found (9, 11), (8, 9)"),
        (lambda: bending.warp(IMAGE, [PLAIN]), "tensor must be of shape (1, C, 9, 11), as there are 1 deformations"),
        (lambda: bending.warp(IMAGE.expand(3, 1, 9, 11), [PLAIN] * 2), "tensor must be of shape (2, C, 9, 11)"),
        (lambda: bending.warp(IMAGE, PLAIN, at=[[1, 2]]), "at must be a tensor of shape (3, 2), one row for each"),
        (lambda: bending.warp(IMAGE, PLAIN, by=torch.zeros(2, 2)), "by must be a tensor of shape (3, 2), one row for"),
        (lambda: bending.warp(IMAGE, PLAIN, radius=torch.ones(3, 1, 1)), "radius must be a tensor of shape (3,), one"),
        (lambda: bending.warp(IMAGE, PLAIN, radius=torch.zeros(3)), "stroke 1 of 3: radius must be a number above 0"),
        (lambda: bending.warp(IMAGE, PLAIN, at=torch.full((3, 2), np.nan)), "stroke 1 of 3: at[0] must be a number"),
        (
            lambda: bending.warp(IMAGE, PLAIN, at=torch.zeros(2, 3, 2), by=torch.zeros(4, 3, 2)),
            "a batch takes as many of each, one for each item, found 2 of at, 4 of by",
        ),
        (
            lambda: bending.warp(
                IMAGE, [PLAIN, supple.Deformation((9, 11), border=64, on_fold="damp")], at=torch.zeros(3, 2)
            ),
            "at needs deformations of as many strokes each, found 3, 0",
        ),
        (lambda: bending.warp(IMAGE, PLAIN, filter="lanczos"), 'filter must be "'),
        (
            lambda: bending.warp(IMAGE, PLAIN, at=numbers(PLAIN)["at"], filter="auto"),
            'filter must be "linear", "cubic" or "nearest" where gradients are needed, found \'auto\'',
        ),
        (
            lambda: bending.warp(IMAGE.byte(), PLAIN, at=numbers(PLAIN)["at"]),
            "tensor must be of floats where strokes need gradients, found torch.uint8",
        ),
        (lambda: bending.warp(IMAGE, PLAIN, outside="wrap"), 'outside must be "edge" or "constant" or "reflect"'),
        (lambda: bending.warp(IMAGE, PLAIN, fill=(1, 2)), "fill must be a number, or 1 of them"),
        (lambda: bending.warp(IMAGE, PLAIN, between="linear"), "between must be left out for an image"),
        (lambda: bending.warp(IMAGE, PLAIN, tolerance=0), "tolerance must be a number of pixels above 0"),
        (lambda: bending.forward([[1.0, 2.0]], PLAIN), "points must be a tensor of shape (..., 2)"),
        (lambda: bending.forward(torch.zeros(3), PLAIN), "points must be floats of shape (..., 2), x first"),
        (lambda: bending.forward(torch.zeros(3, 2).long(), PLAIN), "points must be floats of shape (..., 2), x first"),
        (
            lambda: bending.forward(torch.zeros(3, 2), [PLAIN] * 2),
            "points must be of shape (2, ..., 2), as the batch is",
        ),
    ],
)
def test_what_cannot_be_done_is_said(call: Callable[[], object], text: str) -> None:
    with pytest.raises(SuppleError, match=re.escape(text)) as error:
        call()
    assert "\n" not in str(error.value)


def test_damped_numbers_warn_once_and_as_deformations_do() -> None:
    d = supple.Deformation((30, 30), on_fold="error", border=64).grab((15, 15), by=(1, 1), radius=5, reach=None)
    far = torch.tensor([[25.0, 0.0]])
    with pytest.raises(supple.FoldError, match="stroke 1 of 1: a drag by"):
        bending.warp(torch.zeros(30, 30), d, by=far)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        bending.warp(
            torch.zeros(30, 30),
            supple.Deformation((30, 30), border=64, on_fold="damp").grab((15, 15), by=(1, 1), radius=5, reach=None),
            by=far,
        )
    assert [w.category for w in caught] == [FoldWarning]


def test_implicit_gradients_are_those_of_t() -> None:
    """Points that travel by T⁻¹ and back by T stay, whatever the strokes do: the chain rule through both is zero."""
    d = bent(border=None)
    given = numbers(d)
    ramp = torch.stack(torch.meshgrid(torch.arange(9.0), torch.arange(11.0), indexing="ij")[::-1]).double()
    found = bending.warp(ramp, d, **given, filter="linear")[:, 3:6, 4:7]  # which keeps ramps
    back = bending.forward(found.movedim(0, -1), d, **given)
    for slope in torch.autograd.grad(back.square().sum(), list(given.values())):
        assert slope.abs().max() < 1e-7
