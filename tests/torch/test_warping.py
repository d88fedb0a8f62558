"""Warps of tensors: values as the slow reference and the engines have them, in all layouts, and their gradients."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import FoldWarning, SuppleError
from tests.engine.table import Limits, Row, rows
from tests.refusals import refused
from tests.torch.shared import DOUBLE, bending, bent, check, no_kinks, numbers, picture, smooth, torch

ROWS = [
    *rows(["image", "image, local", "image, turned"], ("bool", "u1", "i2", "f4", "f8"), few=True),
    *(row for row in rows(["clip", "volume", "volume, turned"], ("u1", "f4"), few=True) if not row.average),
]


def by_torch(d: supple.Deformation, source: np.ndarray, **options: Any) -> np.ndarray:
    for what in ("alpha", "time_filter"):
        options.pop(what, None)
    bare = source.ndim == d.ndim
    tensor = torch.from_numpy(source if bare else np.ascontiguousarray(np.moveaxis(source, -1, 0)))
    made = bending.warp(tensor, d, tolerance=1e-5, **options).detach().numpy()
    return made if bare else np.moveaxis(made, 0, -1)


@pytest.mark.filterwarnings("ignore::supple.FoldWarning")
@pytest.mark.parametrize("row", ROWS, ids=str)
def test_rows(row: Row) -> None:
    row.check(by_torch, Limits(3e-4), (0, 1, 3))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16])
def test_a_constant_is_one_of_the_type(dtype: torch.dtype) -> None:
    d = supple.Deformation((23, 31), border=None).grab((10, 9), by=(7, 5), radius=12)
    flat = torch.full((23, 31), 100, dtype=dtype)
    most, least = torch.iinfo(dtype).max, torch.iinfo(dtype).min
    for beyond, within in ((1e30, most), (-1e30, least)):
        found = [bending.warp(flat, d, outside="constant", fill=fill) for fill in (beyond, within)]
        assert torch.equal(*found)


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
        monkeypatch.setattr(bending.warping, "_ROOM", room)
        image, given = smooth(2, 20, 30).requires_grad_(), numbers(d)
        made = bending.warp(image, d, **given)
        made.square().sum().backward()
        results.append([made, image.grad, *(x.grad for x in given.values())])
    assert all(torch.allclose(a, b, rtol=1e-12, atol=1e-12) for a, b in zip(*results, strict=True))


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
def test_strokes_that_flow_in_several() -> None:
    points, image = picture(5, 2) * 15, smooth(20, 24)
    outside = supple.Deformation((20, 24), border=8.0).grab((-2.0, 5.2), by=(0.8, -0.6), radius=6.0, reach=None)
    made = bending.forward(points, outside, **numbers(outside))
    assert np.allclose(made.detach().numpy(), outside.forward(points.numpy()), atol=1e-10)
    several = supple.Deformation((20, 24), border=None).grab((12, 9), by=(9.0, 3.0), radius=4.0, reach=None)
    assert np.allclose(bending.forward(points, several).numpy(), several.forward(points.numpy()))
    assert bending.warp(image.clone().requires_grad_(), several, by=torch.tensor([[9.0, 3.0]])).requires_grad
    with pytest.raises(SuppleError, match="found one that flows in several; use on_fold='damp'"):
        bending.warp(image, several, at=numbers(several)["at"])


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
        (lambda: bending.warp(IMAGE, PLAIN, tolerance=0), "tolerance must be a number of pixels from 1e-9"),
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
    refused(call, match=re.escape(text))


def test_damped_numbers_warn_once_and_as_deformations_do() -> None:
    d = supple.Deformation((30, 30), on_fold="error", border=64).grab((15, 15), by=(1, 1), radius=5, reach=None)
    far = torch.tensor([[25.0, 0.0]])
    with pytest.raises(supple.FoldError, match="stroke 1 of 1: a drag by"):
        bending.warp(torch.zeros(30, 30), d, by=far)
    with warnings.catch_warnings(record=True, action="always") as caught:
        bending.warp(
            torch.zeros(30, 30),
            supple.Deformation((30, 30), border=64, on_fold="damp").grab((15, 15), by=(1, 1), radius=5, reach=None),
            by=far,
        )
    assert [w.category for w in caught] == [FoldWarning]


def test_the_inverse_is_that_of_arrays_and_has_gradients_of_tensors() -> None:
    d = supple.Deformation((24, 30)).grab((12, 10), by=(4, 2), radius=8)
    tensor = torch.rand(2, 24, 30, dtype=torch.float64, requires_grad=True)
    made = bending.warp(tensor, d, inverse=True, tolerance=1e-4)
    for one, given in zip(made.detach(), tensor.detach(), strict=True):
        expected = d.warp(given.numpy(), filter="linear", inverse=True, tolerance=1e-4)
        np.testing.assert_allclose(one.numpy(), expected, atol=1e-3)
    assert torch.autograd.gradcheck(lambda t: bending.warp(t, d, inverse=True), tensor, fast_mode=True)
    by = torch.tensor([[4.0, 2.0]], requires_grad=True)
    with pytest.raises(supple.SuppleError, match="inverse must be False where strokes need gradients"):
        bending.warp(tensor, d, by=by, inverse=True)
