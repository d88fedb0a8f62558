"""Averages over time: where it is compressed, and where it is not; and the paper's Figure 6.4."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from supple import Deformation, Stroke
from tests import effort, reference
from tests.engine.arrays import BETWEEN, FILTERS, RULES, Floats, exact, hurried, noise, top_of

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


@functools.cache
def shrinking() -> Deformation:
    return Deformation((8, 90, 120), border=None, on_fold="flow").grab(
        (45, 45, 4), by=(40, 8, 2), radius=20, reach=None
    )


def test_where_a_frame_shrinks_it_is_averaged() -> None:
    """Against 6 × 6 samples of the cubic interpolant in each pixel, at the exact inverse."""
    d = shrinking()
    source = np.random.default_rng(3).integers(0, 255, (*d.shape, 1)).astype(np.float64)
    matrices = np.linalg.inv(d.jacobian(exact(d)))
    sizes = np.linalg.svd(matrices[..., :2, :2], compute_uv=False)[..., 0]
    inside = ((exact(d) > 4) & (exact(d) < np.array(d.shape[::-1]) - 5))[..., :2].all(axis=-1)
    hard = (sizes > 2) & inside
    assert hard.sum() > 500
    within = (np.arange(6) + 0.5) / 6 - 0.5
    q = reference.grid(d.shape)[hard]
    expected = np.zeros(len(q))
    for v in within:
        for u in within:
            points = d.inverse(q + np.array([u, v, 0])).points
            expected += reference.sample_frames(source, points, "cubic", "linear")[:, 0] / 36
    found = {name: reference.psnr(d.warp(source, filter=name)[hard][:, 0], expected) for name in FILTERS[1:]}
    # Boxes of equal covariance stand for parallelograms: of noise, the hardest of pictures, some is left.
    for name in ("auto",):
        assert found[name] > found["linear"] + 6
        assert found[name] > found["cubic"] + 8
    tiles = d.warp(np.repeat(source, 5, axis=-1), filter="auto")[hard][:, 0]
    assert reference.psnr(tiles, expected) > found["linear"] + 6


@functools.cache
def durations() -> Floats:
    return reference.durations(hurried(), exact(hurried()))


@pytest.mark.parametrize(
    ("filter", "between", "dtype", "channels"),
    effort.pairs(["linear", "cubic", "auto"], ["linear", "cubic"], ["u1", "u2", "f4"], [1, 3, 5]),
)
def test_what_flickers_becomes_grey_where_time_is_compressed(
    filter: str, between: str, dtype: str, channels: int
) -> None:
    d, top = hurried(), top_of(dtype)
    source = np.zeros((*d.shape, channels), dtype)
    source[::2] = top
    how: dict[str, Any] = {"filter": filter, "between": between}
    sharp, soft = (d.warp(source, time_filter=f, **how).astype(np.float64) / top for f in (False, True))
    fast = durations() > 3
    fast &= (exact(d)[..., 2] > durations()) & (exact(d)[..., 2] < d.shape[0] - 1 - durations())
    assert fast.sum() > 200
    # What is left of a flicker of one frame, of an average over that many.
    assert (np.abs(soft[fast] - 0.5) < 0.5 / durations()[fast][:, None]).mean() > 0.99
    assert np.abs(soft[fast] - 0.5).mean() < 0.05
    assert np.abs(sharp[fast] - 0.5).mean() > 0.2


@pytest.mark.parametrize(("filter", "between", "channels"), effort.pairs(["linear", "cubic", "auto"], BETWEEN, [1, 5]))
def test_time_is_left_alone_where_it_is_not_compressed(filter: str, between: str, channels: int) -> None:
    d = hurried()
    # Rates come from the lattice's nodes.
    slow = ndimage.maximum_filter(durations(), (1, 67, 67), mode="nearest") < 0.999
    assert slow.mean() > 0.1
    source = noise("f8", channels, d.shape)
    how: dict[str, Any] = {"filter": filter, "between": between}
    sharp, soft = (d.warp(source, time_filter=f, **how) for f in (False, True))
    np.testing.assert_allclose(soft[slow], sharp[slow], rtol=0, atol=5e-3)
    if between == "nearest":
        np.testing.assert_allclose(soft, sharp, rtol=0, atol=5e-3)
    else:
        assert np.abs(soft - sharp)[durations() > 2].mean() > 10


def test_no_column_is_averaged_for_its_place() -> None:
    # Source points of columns 255 and 256 are kept relative to two frames, which is no difference in time.
    source = np.random.default_rng(0).random((12, 24, 520)).astype(np.float32)
    d = Deformation(source.shape, border=None, spacing=(60.0, 1, 1), on_fold="damp").grab(
        (256, 12, 6), by=(0, 0, 2.2), radius=300, reach=None
    )
    apart = np.abs(d.warp(source, filter="linear", time_filter=True) - d.warp(source, filter="linear"))
    assert apart[..., 240:272].max() < 0.03


@pytest.mark.parametrize("between", ["linear", "cubic"])
@pytest.mark.parametrize("filter", ["linear", "cubic"])
def test_the_average_over_time_is_the_integral(filter: str, between: str) -> None:
    d, points = hurried(), exact(hurried())
    some = (slice(0, 60, 4), slice(0, 40, 3), slice(0, 70, 4))
    widths = reference.faded(durations())[some]
    assert widths.max() > 4
    source = noise("f8", 5, d.shape)
    expected = reference.sample_frames(source, points[some], filter, between, widths=widths)
    sharp = reference.sample_frames(source, points[some], filter, between)
    for channels in (1, 3, 5):
        how: dict[str, Any] = {"filter": filter, "between": between, "tolerance": 1e-4, "time_filter": True}
        out = d.warp(np.ascontiguousarray(source[..., :channels]), **how)[some]
        off = np.abs(out - expected[..., :channels])
        blurred = np.abs(sharp - expected)[..., :channels]
        # Lengths are interpolated between nodes, and differ by some per cent.
        assert off[widths > 1.2].mean() < 0.04 * blurred[widths > 1.2].mean()
        assert off[widths == 0].mean() < 0.3


def test_averages_over_time_beyond_the_clip() -> None:
    """A box around a time outside is as long as one inside."""
    before = Stroke.grab((25, 20, -10), by=(0, 0, 25), radius=12, reach=None)
    d = Deformation((30, 40, 50), border=None, on_fold="flow").add(before, warn=False)
    points = exact(d)
    widths = reference.faded(reference.durations(d, points))
    seen = (widths > 1.5) & ((points[..., 2] < -0.5) | (points[..., 2] > 29.5))
    assert seen.sum() > 100
    source = noise("f8", 5, d.shape)
    for rule in RULES:
        expected = reference.sample_frames(source, points, "linear", "linear", rule, 0.0, widths)
        for channels in (1, 5):
            part = np.ascontiguousarray(source[..., :channels])
            out = d.warp(part, filter="linear", outside=rule, time_filter=True)
            assert np.abs(out - expected[..., :channels])[seen].mean() < 3


# The paper's Figure 6.4: 50 × 50 × 100, black, and red from frame 52 on, which is index 51.
FIRST_RED = 51


@functools.cache
def figure_6_4() -> Deformation:
    return Deformation((100, 50, 50), border=None, on_fold="damp").grab(
        (49, 49, 49), by=(0, 0, -30), radius=50, reach=None
    )


def test_figure_6_4() -> None:
    """Red is brought forward in time: at the pivot it is seen 30 frames early, and later the farther from there."""
    d = figure_6_4()
    clip = np.zeros((100, 50, 50, 3), np.uint8)
    clip[FIRST_RED:, :, :, 0] = 255
    out = d.warp(clip, filter="linear")
    assert not out[..., 1:].any()
    red = out[..., 0].astype(np.float64) / 255
    # Between the last black frame and the first red one, as much as the source's time is beyond the former.
    expected = np.clip(exact(d)[..., 2] - (FIRST_RED - 1), 0, 1)
    assert np.abs(red - expected).max() < 0.5 / 255 + 0.01
    # Every pixel turns once, and does not turn back.
    assert (np.diff(red, axis=0) >= 0).all()
    assert (red[0] == 0).all()
    assert (red[-1] == 1).all()
    # At the pivot, the first red is 30 frames early: frame 22, which is index 21.
    assert int(np.argmax(red[:, 49, 49] > 0)) == FIRST_RED - 30 == 21
    assert red[21, 49, 49] > 0.9
    # It is smooth: when half of red is reached changes by less than a frame from a pixel to its neighbour.
    points = np.stack([*np.meshgrid(np.arange(50.0), np.arange(50.0)), np.full((50, 50), FIRST_RED - 0.5)], axis=-1)
    for _ in range(60):  # the pixel of the input that is half red, and is seen at (x, y)
        points[..., :2] += reference.grid((50, 50)) - d.forward(points)[..., :2]
    when = d.forward(points)[..., 2]
    before = np.floor(when).astype(int)
    y, x = np.mgrid[:50, :50]
    assert (red[before, y, x] <= 0.5 + 0.02).all()
    assert (red[before + 1, y, x] >= 0.5 - 0.02).all()
    assert np.abs(np.diff(when, axis=0)).max() < 1
    assert np.abs(np.diff(when, axis=1)).max() < 1
    assert np.abs(np.diff(when, n=2, axis=0)).max() < 0.05
    assert np.unravel_index(when.argmin(), when.shape) == (49, 49)
    assert np.unravel_index(when.argmax(), when.shape) == (0, 0)
    assert when[49, 49] == pytest.approx(FIRST_RED - 0.5 - 30, abs=0.1)
    assert when[0, 0] > when[49, 49] + 15
