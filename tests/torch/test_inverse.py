"""Inverses of sampled fields: the core's values, and gradients by the implicit function theorem."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import FoldWarning, OutsideWarning, SuppleError
from supple.fields import FOLDED, OK, OUTSIDE, Affine, Field
from tests.effort import pairs
from tests.refusals import refused
from tests.torch.shared import DOUBLE, bending, picture, torch

STEPS = (1.0, 1.7, 0.6)
KINDS = ["linear", "cubic", "bspline"]


def field(*shape: int, size: float = 0.25, seed: int = 0, dtype: Any = DOUBLE) -> torch.Tensor:
    """Random displacements of up to `size` samples of the spacing `STEPS`."""
    axes = 2 if len(shape) == 3 or shape[1] == 2 else 3
    steps = torch.tensor(STEPS[:axes], dtype=DOUBLE).reshape(-1, *[1] * axes)
    return ((2 * picture(*shape, seed=seed) - 1) * size * steps).to(dtype)


def swirl(*shape: int, dtype: Any = torch.float32) -> torch.Tensor:
    """A smooth field of a few pixels that does not fold."""
    at = torch.meshgrid(*[torch.linspace(0, 6, n, dtype=DOUBLE) for n in shape], indexing="ij")[::-1]
    steps = [torch.sin(x + 0.7 * k) * torch.cos(at[k - 1]) for k, x in enumerate(at)]
    return 0.08 * min(shape) * torch.stack(steps).to(dtype)


@pytest.mark.parametrize(
    ("shape", "dtype", "beyond", "interpolation"),
    pairs([(2, 11, 14), (3, 2, 9, 8), (3, 6, 7, 8), (2, 3, 5, 6, 5)], [torch.float32, DOUBLE], ["edge", "zero"], KINDS),
)
def test_values_are_those_of_fields(shape: tuple[int, ...], dtype: Any, beyond: Any, interpolation: Any) -> None:
    given = field(*shape, size=0.5, dtype=dtype)
    batch = len(shape) == 5 or shape[1] == 2
    steps = STEPS[: shape[batch]]
    options: Any = {"spacing": steps, "interpolation": interpolation, "beyond": beyond}
    made = bending.invert(given, tolerance=0.02, **options)
    assert (made.values.dtype, made.error.dtype, made.status.dtype) == (dtype, torch.float32, torch.uint8)
    held = (made.values, made.error, made.status)
    found = [held] if not batch else zip(*held, strict=True)
    total = 0
    for each, (values, error, status) in zip(given if batch else [given], found, strict=True):
        wanted = Field.from_array(np.moveaxis(each.numpy(), 0, -1), **options).invert(tolerance=0.02)
        assert np.array_equal(np.moveaxis(values.numpy(), 0, -1), wanted.field.values)
        assert np.array_equal(error.numpy(), wanted.error)
        assert np.array_equal(status.numpy(), wanted.status)
        total += wanted.counts["ok"]
    assert made.counts["ok"] == total > 0
    assert not made.values.requires_grad


@pytest.mark.parametrize(
    ("shape", "beyond", "interpolation"),
    pairs(
        [(2, 5, 6), (3, 2, 4, 5), (3, 4, 5, 4), (2, 3, 2, 3, 4)],
        ["edge", "zero"],
        KINDS,
        where=lambda shape, _, kind: (kind == "bspline") == (min(shape[-3:]) >= 4),  # four samples, which are slow
    ),
)
def test_gradients_of_a_field(shape: tuple[int, ...], beyond: Any, interpolation: Any) -> None:
    given = field(*shape).requires_grad_()
    batch = len(shape) == 5 or shape[1] == 2
    options: Any = {"spacing": STEPS[: shape[batch]], "interpolation": interpolation, "beyond": beyond}
    with warnings.catch_warnings(action="ignore", category=OutsideWarning):
        status = bending.invert(given, tolerance=1e-9, **options).status
        well = (status == OK) | ((status == OUTSIDE) & (beyond == "edge"))
        well = well.unsqueeze(-len(STEPS[: shape[batch]]) - 1)
        if interpolation != "bspline" or beyond == "edge":
            assert well.all()

        def inverted(values: torch.Tensor) -> torch.Tensor:
            return bending.invert(values, tolerance=1e-9, **options).values * well

        assert torch.autograd.gradcheck(inverted, given, atol=1e-6, fast_mode=True)
        if len(shape) == 3:
            assert torch.autograd.gradgradcheck(inverted, given, atol=1e-5, fast_mode=True)


def test_the_field_after_its_inverse_is_the_identity() -> None:
    """PyTorch's own sampling at the points of the inverse finds the opposite displacements, and so do gradients."""
    given = swirl(24, 24, dtype=DOUBLE).requires_grad_()
    made = bending.invert(given, tolerance=1e-9)
    ramp = torch.stack(torch.meshgrid(torch.arange(24.0), torch.arange(24.0), indexing="ij")[::-1]).double()
    places = (ramp + made.values).movedim(0, -1)[None] * (2 / 23) - 1
    seen = torch.nn.functional.grid_sample(given[None], places, padding_mode="border", align_corners=True)[0]
    off = (seen + made.values) * (made.status == OK)
    assert off.abs().max() < 1e-9
    assert torch.autograd.grad(off.square().sum(), given)[0].abs().max() < 1e-7


def test_where_it_folds_gradients_are_zero_and_one_warning_counts() -> None:
    given = field(2, 2, 12, 13, size=1.2).requires_grad_()
    with pytest.warns(
        FoldWarning, match=r"gradients are zero at \d+ of 312 samples of the inverse: \d+ folded"
    ) as told:
        made = bending.invert(given)
    assert len(told) == 1
    lost = (made.status != OK) & (made.status != OUTSIDE)
    assert (made.status == FOLDED).any()
    assert not lost.all()
    huge = torch.where(lost[:, None], torch.nan, made.values.detach())
    (slope,) = torch.autograd.grad(made.values, given, huge, retain_graph=True)
    assert slope.isfinite().all()
    assert slope.any()
    (slope,) = torch.autograd.grad(made.values, given, lost[:, None].expand_as(given).double())
    assert not slope.any()
    with torch.no_grad():
        assert bending.invert(given).counts == made.counts  # and no warning
    bending.invert(given.detach())


def test_outside_is_another_warning() -> None:
    given = torch.full((2, 8, 8), 1.6, requires_grad=True)
    with pytest.warns(OutsideWarning, match="gradients are zero at 28 of 64 samples of the inverse: 28 outside"):
        made = bending.invert(given, beyond="zero")
    assert made.counts == {"ok": 36, "folded": 0, "outside": 28, "unconverged": 0}
    made.values.sum().backward()
    assert given.grad.sum() == pytest.approx(-72)


def test_layouts() -> None:
    whole = field(3, 2, 6, 5)
    each = torch.stack([bending.invert(x).values for x in whole])
    assert torch.equal(bending.invert(whole).values, each)  # three fields in the plane, and no volume
    assert bending.invert(whole[None, :, :, :, :4]).values.shape == (1, 3, 2, 6, 4)
    assert bending.invert(whole[:0]).values.shape == (0, 2, 6, 5)
    assert torch.equal(bending.invert(whole.movedim(-1, -2).contiguous().movedim(-1, -2)).values, each)
    assert bending.invert(whole.requires_grad_()[0]).values.requires_grad


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no NVIDIA gpu")
@pytest.mark.parametrize("interpolation", KINDS)
@pytest.mark.parametrize("shape", [(3, 2, 40, 50), (2, 3, 14, 16, 18)])
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_a_card_does_the_same(shape: tuple[int, ...], interpolation: Any, dtype: Any) -> None:
    found = []
    for where in ("cpu", "cuda"):
        given = field(*shape, dtype=dtype).to(where).requires_grad_()
        made = bending.invert(given, spacing=STEPS[: shape[1]], interpolation=interpolation, tolerance=1e-6)
        assert {x.device.type for x in (made.values, made.error, made.status)} == {where}
        made.values.square().sum().backward()
        found.append([x.detach().cpu().double() for x in (made.values, given.grad, made.status)])
    for here, there in zip(*found, strict=True):
        assert (here - there).abs().max() < 1e-4 * max(1.0, here.abs().max())


FLAT = torch.zeros(2, 6, 7)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda: bending.invert(FLAT.numpy()),
            "values must be a tensor of shape (2, H, W), (N, 2, H, W), (3, Z, H, W)",
        ),
        (lambda: bending.invert(FLAT.long()), "values must be a dense tensor of float32 or float64, found"),
        (lambda: bending.invert(FLAT.half()), "values must be a dense tensor of float32 or float64, found"),
        (
            lambda: bending.invert(FLAT.to(torch.complex64)),
            "values must be a dense tensor of float32 or float64, found",
        ),
        (lambda: bending.invert(FLAT.to_sparse()), "values must be a dense tensor of float32 or float64, found"),
        (lambda: bending.invert(FLAT.movedim(0, -1)), "or (N, 3, Z, H, W), x first, found shape (6, 7, 2)"),
        (lambda: bending.invert(FLAT[0]), "or (N, 3, Z, H, W), x first"),
        (lambda: bending.invert(torch.zeros(1, 2, 4, 4, 4)), "or (N, 3, Z, H, W), x first"),
        (lambda: bending.invert(torch.zeros(2, 0, 4)), "or (N, 3, Z, H, W), x first"),
        (lambda: bending.invert(FLAT / 0), "the field holds NaN or infinity"),
        (lambda: bending.invert(FLAT, spacing=(1, 1, 1)), "spacing must be one number, or 2 of them"),
        (
            lambda: bending.invert(FLAT, interpolation="lanczos"),
            'interpolation must be "linear" or "cubic" or "bspline"',
        ),
        (lambda: bending.invert(FLAT, beyond="reflect"), 'beyond must be "zero" or "edge"'),
        (lambda: bending.invert(FLAT, tolerance=0), "tolerance must be a number of voxels from 1e-9"),
        (lambda: bending.invert(FLAT[:, :3], interpolation="bspline"), "a cubic B-spline needs 4 coefficients"),
    ],
)
def test_what_cannot_be_inverted_is_said(call: Callable[[], object], text: str) -> None:
    refused(call, match=re.escape(text))


# ---- deformations with fields and affine maps -----------------------------------------------------------------------

BASE = supple.Deformation((20, 24), border=None)
BENT = BASE.grab((10, 9), by=(3, 2), radius=5)
SWIRL = Field.from_array(np.moveaxis(swirl(20, 24).numpy(), 0, -1))
MAPPED = {
    "field": BASE.field(SWIRL),
    "inverse": BASE.field(SWIRL, inverse=True),
    "affine": BASE.affine(Affine([[1, 0.1, 2], [-0.05, 1.1, -1]])),
    "stroke and field": BENT.field(SWIRL),
}


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning", "ignore:.*did not converge:supple.ToleranceWarning")
@pytest.mark.parametrize("d", MAPPED.values(), ids=MAPPED.keys())
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, DOUBLE])
def test_warps_by_maps(d: supple.Deformation, dtype: Any) -> None:
    image = picture(20, 24) * 200
    given = image.to(dtype)
    wanted = d.warp(given.numpy(), filter="linear")
    assert np.array_equal(bending.warp(given, d).numpy(), wanted)
    if dtype == torch.uint8:
        return
    made = bending.warp(given.requires_grad_(), d)
    assert np.allclose(made.detach().numpy(), wanted, rtol=0, atol=1e-2)
    weights, other = picture(20, 24, seed=1).to(dtype), picture(20, 24, seed=2).to(dtype)
    (slope,) = torch.autograd.grad(made, given, weights)
    forwards = (bending.warp(other.clone().requires_grad_(), d).detach() * weights).sum().item()
    assert forwards == pytest.approx((other * slope).sum().item(), rel=1e-4)


@pytest.mark.parametrize("name", ["at", "by", "radius"])
def test_strokes_among_maps_have_no_gradients(name: str) -> None:
    d = MAPPED["stroke and field"]
    given = torch.tensor([getattr(stroke, name) for stroke in d.strokes], dtype=torch.float32)
    for call in (bending.warp, bending.forward):
        with pytest.raises(SuppleError, match=f"^{name} is for deformations of strokes alone, found one with fields"):
            call(torch.zeros(20, 24) if call is bending.warp else torch.zeros(4, 2), d, **{name: given})
    with pytest.raises(
        SuppleError, match=r"^supple.torch.forward is for strokes alone, found a deformation with fields"
    ):
        bending.forward(torch.zeros(4, 2), d)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_second_gradients_are_alike_at_both_edges(interpolation: str) -> None:
    def mirrored(v: torch.Tensor) -> torch.Tensor:
        return v.flip(-1) * torch.tensor([-1.0, 1.0], dtype=v.dtype)[:, None, None]

    def second(v: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        v = v.clone().requires_grad_(True)
        inverted = bending.invert(v, interpolation=interpolation, tolerance=1e-9).values
        (first,) = torch.autograd.grad((weights * inverted).sum(), v, create_graph=True)
        return torch.autograd.grad(first.square().sum(), v)[0]

    values, weights = field(2, 6, 7), field(2, 6, 7, seed=1)
    values[..., [0, -1]] = 0  # points on the edges themselves
    found = second(mirrored(values), mirrored(weights))
    torch.testing.assert_close(found, mirrored(second(values, weights)), rtol=1e-6, atol=1e-9)
