"""Small warps of all ways, in memory of exactly their size: what `make test-cuda` has compute-sanitizer watch."""

from __future__ import annotations

import numpy as np
import pytest

import supple
import supple.cuda
from tests.cuda.at_size import apart, bent, host, waves
from tests.cuda.driver import sent

pytestmark = pytest.mark.usefixtures("gpu")

# Sides that no block of threads divides.
SHAPES = [(37, 71), (5, 19, 33)]


@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "auto"])
@pytest.mark.parametrize("shape", SHAPES)
def test_warps(shape: tuple[int, ...], filter: str, outside: str) -> None:
    d = bent(shape, 1)
    source = waves(shape, 3)
    out = sent(np.full_like(source, np.nan))
    d.warp(sent(source), filter=filter, outside=outside, out=out, time_filter=len(shape) == 3)
    made = host(out)
    assert np.isfinite(made).all()  # each is written
    wanted = d.warp(source, filter=filter, outside=outside, time_filter=len(shape) == 3)
    assert np.quantile(apart(made, wanted, source), 0.9) <= 5e-3


def test_rough_cells_batches_and_slabs() -> None:
    shape = SHAPES[0]
    ds = [bent(shape, k, count=k, border=(None, 5.0, 9.0)[k]) for k in range(3)]
    source = np.stack([waves(shape, 3)] * 3)
    made = host(supple.warp_batch(sent(source), ds, filter="linear", tolerance=1e-3))
    wanted = supple.warp_batch(source, ds, filter="linear", tolerance=1e-3)
    assert apart(made, wanted, source).max() <= 1e-3
    stack = waves(SHAPES[1])
    d = bent(SHAPES[1], 2, border=3.0)
    warping = supple.cuda.start(sent(stack), d, filter="linear", tolerance=1e-3, slab=2)
    wanted = d.warp(stack, filter="linear", tolerance=1e-3)
    assert apart(host(warping.wait()), wanted, stack).max() <= 1e-3


@pytest.mark.parametrize("shape", SHAPES)
def test_reach(shape: tuple[int, ...]) -> None:
    d = supple.Deformation(shape, border=64, on_fold="damp").grab(
        [4.0, 5.0, 2.0][: len(shape)], by=[1.0] * len(shape), radius=2, reach=3
    )
    source = waves(shape, 3)
    out = sent(np.full_like(source, np.nan))
    d.warp(sent(source), out=out)
    made = host(out)
    assert np.isfinite(made).all()
    np.testing.assert_array_equal(made[..., 12:, :], source[..., 12:, :])


@pytest.mark.parametrize("shape", SHAPES)
def test_points_and_maps(shape: tuple[int, ...]) -> None:
    d = bent(shape, 3, border=4.0)
    points = np.random.default_rng(0).uniform(0, min(shape), (131, len(shape)))
    there = sent(points)
    assert np.isfinite(host(d.jacobian(there))).all()
    np.testing.assert_allclose(host(d.forward(d.inverse(there).points)), points, atol=1e-6)
    assert np.isfinite(host(d.inverse_map(like=there))).all()
