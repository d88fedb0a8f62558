"""Filters against many samples in each pixel: of what shrinks, averages are better."""

from __future__ import annotations

import numpy as np
import pytest

from supple import Deformation
from tests import reference
from tests.engine.arrays import FILTERS, Array, Floats, bent, exact

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


def supersampled(image: Array, d: Deformation, n: int) -> Floats:
    """The mean of n × n samples in each pixel, as pictures hold it."""
    return np.clip(reference.supersampled(image[..., None].astype(np.float64), d, n)[..., 0], 0, 255)


def scores(image: Array, d: Deformation, expected: Floats, *filters: str) -> dict[str, float]:
    return {f: reference.psnr(d.warp(image, filter=f), expected) for f in filters}


def test_the_zone_plate() -> None:
    y, x = np.mgrid[:112, :112] - 55.5
    image = np.rint(127.5 + 127.5 * np.cos(np.pi * (x * x + y * y) / 130)).astype(np.uint8)
    d = Deformation((112, 112), border=14, on_fold="damp").grab((55.5, 55.5), by=(0, 20), radius=22, reach=None)
    found = scores(image, d, supersampled(image, d, 8), *FILTERS[1:])
    assert found["auto"] >= found["linear"]
    assert found["cubic"] < found["linear"]


def test_lines_of_one_pixel() -> None:
    image = np.zeros((96, 96), np.uint8)
    image[::8] = image[:, ::8] = 255
    d = Deformation((96, 96), border=24, on_fold="damp").grab((47.5, 47.5), by=(0, 26), radius=11, reach=None)
    found = scores(image, d, supersampled(image, d, 8), *FILTERS[1:])
    assert found["auto"] >= found["linear"]


def test_averages_are_paid_only_where_the_map_shrinks() -> None:
    """Where it only translates or magnifies, ``auto`` is ``cubic``, up to float32's rounding of points."""
    source = np.random.default_rng(10).uniform(size=(90, 120, 3)).astype(np.float32)
    still = Deformation((90, 120), border=None, on_fold="damp").grab((60, 40), by=(3.3, 2.7), radius=1e7, reach=None)
    rough = Deformation((90, 120), on_fold="flow", border=64).grab((60, 45), to=(75, 50), radius=20, reach=None)
    for d in (still, rough, bent()):
        image = source[: d.shape[0], : d.shape[1]]
        auto, cubic = (d.warp(image, filter=f) for f in ("auto", "cubic"))
        sizes = np.linalg.svd(np.linalg.inv(d.jacobian(exact(d))), compute_uv=False)[..., 0]
        # Footprints are those of four rows together, from differences over three.
        around = np.pad(sizes, 4, mode="edge")
        most = np.lib.stride_tricks.sliding_window_view(around, (9, 9)).max(axis=(2, 3))
        large = most < (1.001 if d is still else 0.999)
        if d is still:
            large = np.ones_like(large)
        assert large.any() or d is bent()
        np.testing.assert_allclose(auto[large], cubic[large], rtol=0, atol=1e-5)
        shrunk = np.lib.stride_tricks.sliding_window_view(around, (9, 9)).min(axis=(2, 3)) > 1.3
        if d is rough:
            assert shrunk.any()
            assert np.abs(auto - cubic)[shrunk].max() > 0.05


def test_what_is_much_smaller_has_no_holes() -> None:
    d = Deformation((100, 130), border=None, on_fold="flow").grab((30, 50), by=(75, 5), radius=7.5, reach=None)
    sizes = np.linalg.svd(np.linalg.inv(d.jacobian(exact(d))), compute_uv=False)[..., 0]
    assert sizes.max() > 8
    rng = np.random.default_rng(11)
    fine = rng.integers(0, 2, (100, 130)).astype(np.float64)
    hard, expected = sizes > 6, supersampled(255 * fine, d, 8)
    linear = d.warp(fine, filter="linear")
    for name in ("auto",):
        out = d.warp(fine, filter=name)
        assert np.isfinite(out).all()
        assert out[hard].std() < 0.6 * linear[hard].std()
        assert out[hard].std() == pytest.approx(expected[hard].std() / 255, rel=0.1)
        given = np.full((100, 130), np.nan)
        d.warp(np.full((100, 130), 0.25), filter=name, out=given)
        np.testing.assert_allclose(given, 0.25, rtol=1e-6)  # weights are of float32
        found = {
            f: reference.psnr(255 * d.warp(fine, filter=f)[hard], expected[hard]) for f in (name, "linear", "cubic")
        }
        assert found[name] > max(found["linear"], found["cubic"]) + 5
