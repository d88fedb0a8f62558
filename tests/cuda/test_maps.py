"""Fields, affine maps, output grids and freeze masks on a GPU, against the native engine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import supple
import supple.cuda
from supple import Deformation, Field, Freeze, Grid, Stroke, SuppleError
from supple.cuda.points import inverse_map
from tests.cuda.driver import on_host, sent
from tests.effort import pairs

pytestmark = pytest.mark.usefixtures("gpu")
TIGHT = 1e-3


def waves(shape: tuple[int, ...]) -> np.ndarray:
    """Displacements that do not fold, x first."""
    places = np.indices(shape)[::-1].astype(float)
    along = sum((0.11 + 0.04 * k) * p for k, p in enumerate(places))
    return np.stack([1.6 * np.sin(np.asarray(along) + k) for k in range(len(shape))], axis=-1)


def frozen(shape: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(shape, np.bool_)
    mask[tuple(slice(n // 4, n // 2) for n in shape)] = True
    return mask


def maps(shape: tuple[int, ...]) -> dict[str, Deformation]:
    """One of each element of the chain, and mixtures."""
    n = len(shape)
    middle, spacing = (np.array(shape[::-1]) - 1) / 2, (1.0, 0.8, 1.4)[:n]
    plain = Deformation(shape, border=None, on_fold="damp")
    scaled = Deformation(shape, border=None, spacing=spacing, on_fold="damp")
    matrix = np.eye(n, n + 1) + 0.06 * np.arange(n * (n + 1)).reshape(n, n + 1) % 0.2
    few = tuple(-(-k // 6) + 3 for k in shape)
    field, smooth = Field(waves(shape), Grid(shape)), Field(waves(few), Grid(few, 6.0), "cubic")
    grab: dict[str, Any] = {"by": [2.0, 1.5, 1.0][:n], "radius": 6.0, "reach": None}
    return {
        "affine": plain.affine(matrix),
        "a field": plain.field(field),
        "a smooth field": plain.field(smooth),
        "a field inverted": plain.field(field, inverse=True),
        "all of it": scaled.affine(matrix).grab(middle, **grab).field(smooth, inverse=True),
        "frozen": Deformation(shape, freeze=Freeze.of(frozen(shape))).grab(middle, by=grab["by"], radius=5.0),
        "frozen, with a field": Deformation(shape, freeze=Freeze.of(frozen(shape)), border=None)
        .field(smooth)
        .grab(middle, by=grab["by"], radius=5.0),
    }


SHAPES = [(31, 44), (10, 18, 21)]
NAMES = list(maps(SHAPES[0]))


def test_a_keystone() -> None:
    d = Deformation((31, 44), border=None).grab((20, 15), by=(3, 2), radius=6)
    d = d.straighten(keystone=[(6, 4), (38, 7), (40, 28), (2, 26)], rotate=-4, fit="keep", scale_to=(40,))
    source = np.random.default_rng(0).random((31, 44)).astype(np.float32)
    wanted = d.warp(source, filter="linear", tolerance=TIGHT)
    for made in (on_host(d.warp(sent(source), filter="linear", tolerance=TIGHT)),
                 d.warp(source, filter="linear", tolerance=TIGHT, device="cuda")):  # fmt: skip
        assert made.shape == wanted.shape
        assert np.abs(made - wanted).max() < 4 * TIGHT


@pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.OutsideWarning")
@pytest.mark.parametrize(("name", "shape", "filter"), pairs(NAMES, SHAPES, ["nearest", "linear", "auto"]))
def test_arrays(name: str, shape: tuple[int, ...], filter: str) -> None:
    d = maps(shape)[name]
    source = np.random.default_rng(0).random(shape).astype(np.float32)
    options: dict[str, Any] = {"filter": filter, "tolerance": TIGHT}
    wanted = d.warp(source, **options)
    # Where another sample is as near.
    between = (np.abs(d.inverse_map(tolerance=TIGHT) % 1 - 0.5) < 2 * TIGHT).any(axis=-1)
    assert between.mean() < 0.1
    for made in (on_host(d.warp(sent(source), **options)), d.warp(source, device="cuda", **options)):
        off = np.abs(made - wanted)
        if filter == "nearest":
            assert not off[~between].any()
        else:
            assert off.max() < 4 * TIGHT
    if name == "frozen":
        np.testing.assert_array_equal(made[frozen(shape)], source[frozen(shape)])


@pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.OutsideWarning")
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", NAMES)
def test_points(name: str, shape: tuple[int, ...]) -> None:
    d = maps(shape)[name]
    places = np.random.default_rng(1).uniform(0.1, 0.9, (40, len(shape))) * np.array(shape[::-1])
    there = sent(places)
    np.testing.assert_allclose(on_host(d.forward(there)), d.forward(places), atol=1e-9)
    np.testing.assert_allclose(on_host(d.jacobian(there)), d.jacobian(places), atol=1e-9)
    found, wanted = d.inverse(there), d.inverse(places)
    np.testing.assert_allclose(on_host(found.points), wanted.points, atol=1e-6)
    np.testing.assert_array_equal(on_host(found.converged), wanted.converged)
    made = on_host(d.inverse_map(like=there, tolerance=TIGHT))
    assert np.linalg.norm(made - d.inverse_map(tolerance=TIGHT), axis=-1).max() < 2.5 * TIGHT
    offsets, _ = inverse_map(d.space, TIGHT, there, offsets=True)  # what gradients of tensors are computed from
    np.testing.assert_allclose(on_host(offsets), made - np.moveaxis(np.indices(d.shape)[::-1], 0, -1), atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_output_grids(shape: tuple[int, ...]) -> None:
    d = maps(shape)["all of it"]
    grid = Grid(tuple(n + 3 for n in shape), spacing=(0.9, 0.7, 1.2)[: len(shape)])
    source = np.random.default_rng(2).random((*shape, 2)).astype(np.float32)
    wanted = d.warp(source, grid=grid, filter="linear", tolerance=TIGHT)
    made = on_host(d.warp(sent(source), grid=grid, filter="linear", tolerance=TIGHT))
    assert made.shape == wanted.shape
    assert np.abs(made - wanted).max() < 4 * TIGHT
    by_host = d.warp(source, grid=grid, filter="linear", tolerance=TIGHT, device="cuda")
    assert np.abs(by_host - wanted).max() < 4 * TIGHT


def test_a_batch_of_all_kinds() -> None:
    shape = SHAPES[0]
    several = [maps(shape)[name] for name in ("affine", "frozen", "a smooth field")] + [Deformation(shape)]
    images = np.random.default_rng(3).random((4, *shape)).astype(np.float32)
    options: dict[str, Any] = {"filter": "linear", "tolerance": TIGHT}
    made = on_host(supple.warp_batch(sent(images), several, **options))
    np.testing.assert_allclose(made, supple.warp_batch(images, several, **options), atol=4 * TIGHT)


def test_what_folds_is_said() -> None:
    shape = (40, 40)
    steep = Field(np.stack([4 * np.sin(np.indices(shape)[1] * 0.9), np.zeros(shape)], axis=-1), Grid(shape))
    d = Deformation(shape, border=None).field(steep)
    with pytest.warns(supple.FoldWarning):
        d.warp(sent(np.zeros(shape, np.float32)), filter="linear")


def test_mattes_are_refused() -> None:
    white = np.uint8(255) * frozen(SHAPES[0])
    stroke = Stroke.grab([4.0] * len(SHAPES[0]), by=[1.0] * len(SHAPES[0]), radius=5.0)
    d = Deformation(SHAPES[0]).add(replace(stroke, matte=Freeze.of(white, matte=True)), warn=False)
    for call in (lambda: d.warp(sent(np.zeros(SHAPES[0], np.float32))), lambda: d.forward(sent(np.zeros((1, d.ndim))))):
        with pytest.raises(SuppleError, match="strokes have mattes, which CUDA does not take: leave them out"):
            call()
