"""Brushes that twist, scale and pinch, and strokes that act at once, on the GPU."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple.engines.wgpu import field, fill, solid, volume
from supple.engines.wgpu.device import Gpu
from supple.strokes import pack
from tests import reference
from tests.engines.wgpu.scenes import SHAPE
from tests.turns import AFFINE, at_once

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]


def turned(shape: tuple[int, ...], **options: Any) -> supple.Deformation:
    """Return one stroke of each brush."""
    d = supple.Deformation(shape, on_fold="damp", **options)
    size, n = np.array(shape[::-1]) - 1.0, len(shape)
    for k, stroke in enumerate(AFFINE[n]):
        at = (0.3 + 0.2 * k) * size
        d = d.add(replace(stroke, at=at, radius=0.2 * float(size.min()) * min(d.domain.spacing)))
    return d.grab(0.5 * size, by=0.05 * size, radius=0.2 * float(size.max()))


@pytest.mark.parametrize("border", [None, 9.0])
@pytest.mark.parametrize(("shape", "spacing"), [((80, 120), 1.0), ((30, 40, 50), (1.0, 0.7, 2.1))])
def test_points_there_and_back(gpu: Gpu, shape: tuple[int, ...], spacing: Any, border: float | None) -> None:
    d = turned(shape, spacing=spacing, border=border)
    n, steps, strokes = len(shape), np.array(d.domain.spacing), reference.carried_out(d)
    rng = np.random.default_rng(1)
    anchors = np.zeros((600, 3))
    anchors[:, :n] = rng.uniform(-0.1, 1.1, (600, n)) * shape[::-1] * steps
    points = anchors[:, :n] / steps
    moved, jacobian = field.forward(gpu, d.space.table, d.space.axes, anchors, np.zeros_like(anchors))
    np.testing.assert_allclose((anchors + moved)[:, :n] / steps, d.forward(points), atol=1e-3)
    scaled = jacobian[:, :n, :n] * (steps[None, :] / steps[:, None])
    np.testing.assert_allclose(scaled, reference.jacobian(strokes, d.domain, points), atol=1e-3)
    shift, residual, _ = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-4)
    np.testing.assert_allclose((anchors + shift)[:, :n] / steps, d.inverse(points).points, atol=5e-3)
    assert residual.max() < 5e-3


@pytest.mark.parametrize("angle", [180, -720])
@pytest.mark.parametrize("shape", [(60, 80), (20, 30, 40)])
def test_twists_of_several_turns(gpu: Gpu, shape: tuple[int, ...], angle: float) -> None:
    n, at = len(shape), 0.5 * np.array(shape[::-1])
    kind: dict[str, Any] = {} if n == 2 else {"axis": (1, -2, 0.5)}
    d = supple.Deformation(shape, border=None).twist(at, angle=angle, radius=8, **kind)
    points = np.random.default_rng(2).uniform(0, 1, (500, n)) * shape[::-1]
    anchors = np.pad(points, ((0, 0), (0, 3 - n)))
    moved, _ = field.forward(gpu, d.space.table, d.space.axes, anchors, np.zeros_like(anchors))
    seen = (anchors + moved)[:, :n]
    np.testing.assert_allclose(seen, d.forward(points), atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(seen - at, axis=1), np.linalg.norm(points - at, axis=1), atol=1e-4)
    shift, _, _ = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-4)
    np.testing.assert_allclose((anchors + shift)[:, :n], d.inverse(points).points, atol=1e-3)


@pytest.mark.parametrize("border", [None, 9.0])
@pytest.mark.parametrize("shape", [(60, 80), (20, 30, 40)])
def test_strokes_that_act_at_once(gpu: Gpu, shape: tuple[int, ...], border: float | None) -> None:
    d = supple.Deformation(shape, border=border)
    table, steps = at_once(d.domain)
    n, points = len(shape), np.random.default_rng(2).uniform(-0.1, 1.1, (500, len(shape))) * shape[::-1]
    anchors = np.pad(points, ((0, 0), (0, 3 - n)))
    expected, slopes = reference.moved(steps, d.domain, points)
    moved, jacobian = field.forward(gpu, table, d.space.axes, anchors, np.zeros_like(anchors))
    np.testing.assert_allclose((anchors + moved)[:, :n], expected, atol=1e-4)
    np.testing.assert_allclose(jacobian[:, :n, :n], slopes, atol=1e-4)
    shift, residual, _ = field.inverse(gpu, table, d.space.axes, anchors, 1e-4)
    np.testing.assert_allclose((anchors + shift)[:, :n], reference.inverse(steps, d.domain, points), atol=1e-3)
    assert residual.max() < 1e-3


def test_pictures_are_those_of_the_native_engine(gpu: Gpu) -> None:
    d = turned((90, 130), border=12.0)
    picture = np.random.default_rng(0).integers(0, 256, (90, 130, 3), np.uint8)
    for way in ("linear", "auto"):
        away = np.abs(d.warp(picture, device="gpu", filter=way).astype(int) - d.warp(picture, filter=way))
        assert away.max() <= 4
        assert away.mean() < 0.1


def test_volumes_are_those_of_the_native_engine(gpu: Gpu, cloud: np.ndarray) -> None:
    d = turned(SHAPE, border=None)
    held = volume.hold(gpu, cloud)
    assert volume.beside(held)
    lattice, nodes, error, _ = solid.solve(gpu, d.space.table, d.space.axes, SHAPE, 2)
    q = 2 * reference.grid(nodes.shape[:3])
    np.testing.assert_allclose(nodes[..., :3], d.inverse(q).points - q, atol=1e-3)
    assert error < 0.5
    filling = fill.Filling(held, lattice, polished=True, tolerance=0.01)
    assert filling.advance(60.0) == 1.0


def test_what_is_compiled_for_grabs_is_for_them_alone() -> None:
    d = supple.Deformation((40, 50)).grab((20, 20), by=(1, 0), radius=9)
    assert field.constants(d.space.table, None) == {"GRABS": 1, "FROZEN": 0}
    assert field.constants(d.twist((20, 20), angle=9, radius=9).space.table, None)["GRABS"] == 0
    both = pack(d.strokes * 2, (1.0, 1.0))
    both["joined"][1] = 1
    assert field.constants(both, None)["GRABS"] == 0


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e6])
def test_float32_holds_brushes_of_any_size(gpu: Gpu, radius: float) -> None:
    d = supple.Deformation((40, 50), spacing=radius / 10, border=None).twist((25, 20), angle=40, radius=radius)
    assert field.fits(d.space.table)
    points = np.random.default_rng(3).uniform(0, 40, (200, 2))
    anchors = np.pad(points * radius / 10, ((0, 0), (0, 1)))
    moved, _ = field.forward(gpu, d.space.table, d.space.axes, anchors, np.zeros_like(anchors))
    np.testing.assert_allclose((anchors + moved)[:, :2] / (radius / 10), d.forward(points), atol=1e-4)
