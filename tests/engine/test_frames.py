"""Frames of a clip as warps take and give them: both ways to a sample, layouts, sizes, refusals."""

from __future__ import annotations

import functools
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, SuppleError
from tests import effort, reference
from tests.engine.arrays import BETWEEN, CLIP, FILTERS, RULES, bent, exact, noise, same, top_of

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")
PRINTED = [("linear", "linear"), ("linear", "cubic"), ("linear", "nearest"), ("cubic", "linear"), ("cubic", "cubic")]
DIRECT = ["linear", "cubic", "auto"]  # these have a path of their own
FINE = 1e-5


@functools.cache
def held() -> Deformation:
    """As strong, but no point comes from outside."""
    return Deformation(CLIP, border=64, on_fold="damp").grab((20, 18, 3), by=(9, -6, 1.5), radius=14, reach=None)


def test_the_deformations_are_what_they_should_be() -> None:
    size = np.array(CLIP[::-1])
    points = exact(bent(CLIP))
    low, high = points.min(axis=(0, 1, 2)), points.max(axis=(0, 1, 2)) - size + 1
    assert (np.maximum(-low, high) > 1).all()
    assert low[2] < -1 < 1 < high[2]
    points = exact(held())
    assert points.min() > -0.5 - 1e-9
    assert (points <= size - 0.5 + 1e-9).all()


@pytest.mark.parametrize(("dtype", "channels"), [("u1", 1), ("u1", 2), ("u2", 1), ("f4", 1), ("i2", 1)])
def test_samples_that_lie_side_by_side_are_those_that_are_read_alone(dtype: str, channels: int) -> None:
    # Of four channels, all are read alone.
    rng = np.random.default_rng(6)
    source = rng.integers(0, 256, (12, 90, 300, 4)).astype(dtype)
    d = Deformation(source.shape[:3], border=None, on_fold="damp").grab(
        (70, 40, 5), by=(9, 6, 2), radius=20, reach=None
    )
    options: dict[str, Any] = {"filter": "linear", "alpha": False}
    wanted = d.warp(source, **options)[..., :channels]
    assert (wanted != source[..., :channels]).mean() > 0.3
    found = d.warp(source[..., :channels].copy(), **options)
    if np.dtype(dtype).kind == "f":  # beside the edges, sums are in another order
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    else:
        off = np.abs(found.astype(int) - wanted.astype(int))  # a half is rounded this way or that
        assert off.max() <= 1
        assert (off > 0).mean() < 1e-4


@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8"])
def test_nearest_knows_neither_light_nor_opacity(dtype: str) -> None:
    source = np.abs(noise("f8", 4, CLIP)) % 1 * top_of(dtype)
    source = source.astype(dtype)
    plain = bent(CLIP).warp(source, filter="nearest", alpha=False)
    np.testing.assert_array_equal(bent(CLIP).warp(source, filter="nearest", alpha=True), plain)
    np.testing.assert_array_equal(bent(CLIP).warp(source, filter="nearest", linear_light=True), plain)


def test_a_plane_through_the_pivot_is_a_picture() -> None:
    """Where a stroke does not act along time, a frame is deformed as a picture is, by every filter."""
    source = noise("f8", 4, CLIP)
    for border in (None, 50.0):
        d = Deformation(CLIP, border=border, on_fold="damp").grab((20, 18, 3), by=(10, -7, 0), radius=14, reach=None)
        flat = Deformation(CLIP[1:], border=border, on_fold="damp").grab((20, 18), by=(10, -7), radius=14, reach=None)
        for name in FILTERS:
            for rule in RULES:
                for channels in (1, 3):
                    part = np.ascontiguousarray(source[..., :channels])
                    how: dict[str, Any] = {"filter": name, "outside": rule, "fill": 30.0, "tolerance": 1e-6}
                    picture = flat.warp(part[3], **how)
                    off = np.abs(d.warp(part, **how)[3] - picture)
                    assert off.max() <= 0.01


@pytest.mark.parametrize(("filter", "between", "averaged"), effort.pairs(DIRECT, BETWEEN, [False, True]))
def test_both_ways_to_a_sample_agree(filter: str, between: str, averaged: bool) -> None:
    """Up to four plain channels whose edges go on are sampled straight from the frames, all others by tiles."""
    how: dict[str, Any] = {"filter": filter, "between": between, "time_filter": averaged}
    for dtype, off in (("f8", 2e-4), ("f4", 2e-4), ("u1", 1), ("u2", 20)):
        source = (np.random.default_rng(1).uniform(0, top_of(dtype), (*CLIP, 5))).astype(dtype)
        for d in (bent(CLIP), held()):
            general = d.warp(source, alpha=False, **how).astype(np.float64)
            for channels in (1, 2, 3, 4):
                part = np.ascontiguousarray(source[..., :channels])
                direct = d.warp(part, alpha=False, **how).astype(np.float64)
                assert np.abs(direct - general[..., :channels]).max() <= max(off, 4e-3 * top_of(dtype))
        for rule in ("reflect", "constant"):
            for channels in (1, 2, 3, 4):
                part = np.ascontiguousarray(source[..., :channels])
                direct, other = (held().warp(part, outside=r, alpha=False, **how) for r in ("edge", rule))
                # A tap may lie outside although its point does not.
                inner = (slice(None), slice(6, -6), slice(6, -6)) if between == "nearest" else (slice(3, 4),) * 1
                inner = (*inner, slice(8, -8), slice(8, -8)) if len(inner) == 1 else inner
                away = np.abs(direct[inner].astype(np.float64) - other[inner])
                assert away.max() <= max(off, 4e-3 * top_of(dtype))
        opaque = np.concatenate([source[..., :3], np.full((*CLIP, 1), top_of(dtype), dtype)], axis=-1)
        plain = held().warp(np.ascontiguousarray(source[..., :3]), **how).astype(np.float64)
        weighed = held().warp(opaque, alpha=True, **how).astype(np.float64)
        assert np.abs(weighed[..., :3] - plain).max() <= max(off, 4e-3 * top_of(dtype))
        assert np.abs(weighed[..., 3] - top_of(dtype)).max() <= 1e-5 * top_of(dtype)


@pytest.mark.parametrize(
    ("filter", "between", "averaged"), effort.pairs(["linear", "cubic", "auto"], BETWEEN, [False, True])
)
def test_constants_stay_constant(filter: str, between: str, averaged: bool) -> None:
    """All weights sum to one: a clip of one colour is left as it is."""
    how: dict[str, Any] = {"filter": filter, "between": between, "time_filter": averaged}
    strong = Deformation((10, 20, 26), border=None, on_fold="flow").grab(
        (10, 9, 2), by=(0, 0, 15), radius=9, reach=None
    )
    for d in (bent(CLIP), strong):
        for dtype, values in (
            ("u1", (0, 77, 255)),
            ("i2", (-32768, 32767)),
            ("i4", (2**31 - 1,)),
            ("f4", (0.3,)),
            ("f8", (1e6 / 3,)),
        ):
            for value in values:
                for channels, rule in ((1, "edge"), (3, "reflect"), (5, "edge")):
                    source = np.full((*d.shape, channels), value, dtype)
                    for alpha in {False, channels > 1 and dtype == "u1"}:
                        out = d.warp(source, outside=rule, alpha=alpha, **how)
                        if dtype in ("f4", "f8"):
                            np.testing.assert_allclose(out, source, rtol=3e-6 if dtype == "f4" else 1e-12)
                        elif not (alpha and value < 255):
                            np.testing.assert_array_equal(out, source)
                        elif value:
                            np.testing.assert_array_equal(out[..., :-1], source[..., :-1])


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 37, 50), (2, 2, 2), (5, 1, 40), (5, 40, 1), (3, 33, 33), (2, 3, 300)])
@pytest.mark.parametrize("rule", RULES)
def test_sizes(shape: tuple[int, int, int], rule: str) -> None:
    d = Deformation(shape, border=None, on_fold="damp").grab(
        np.array(shape[::-1]) * 0.4, by=(2.3, -1.2, 0.8), radius=9, reach=None
    )
    for channels in (1, 3, 5):
        source = noise("u1", channels, shape)
        for name in FILTERS:
            for between in ("linear", "cubic") if name != "nearest" else ("nearest",):
                how: dict[str, Any] = {"filter": name, "between": between, "outside": rule, "fill": 70}
                out = d.warp(source, alpha=False, tolerance=FINE, **how)
                assert out.shape == source.shape
                if (name, between) in PRINTED:
                    expected = reference.sample_frames(source, exact(d), name, between, rule, 70)
                    same(out, expected.astype(np.float64), 255, 3e-4)
                if channels == 5 or (name, between) not in PRINTED:
                    given = np.full_like(source, 77)
                    d.warp(source, alpha=False, tolerance=FINE, out=given, **how)
                    np.testing.assert_array_equal(given, out)


def test_two_maps_of_one_file_overlap(tmp_path: Path) -> None:
    """Though not in memory."""
    size = math.prod(CLIP)
    np.zeros(2 * size + 8, np.uint8).tofile(tmp_path / "a")
    os.symlink(tmp_path / "a", tmp_path / "link")

    def mapped(name: str, offset: int, mode: Any = "r+") -> npt.NDArray[np.uint8]:
        return np.memmap(tmp_path / name, np.uint8, mode, offset, shape=CLIP)

    for source, out in (
        (mapped("a", 0, "r"), mapped("a", 0)),
        (mapped("a", 0, "r"), mapped("link", size - 1)),
        (np.asarray(mapped("a", 8, "r")), mapped("a", 0)[:]),
    ):
        with pytest.raises(SuppleError, match="out must not overlap source"):
            bent(CLIP).warp(source, out=out)
    (tmp_path / "b").write_bytes((tmp_path / "a").read_bytes())
    bent(CLIP).warp(mapped("a", 0, "r"), out=mapped("b", 0))


def test_one_frame_is_reported_by_itself():
    d = Deformation((5, 30, 40), border=None, on_fold="damp").grab((20, 15, 2), by=(4, 2, 1), radius=8, reach=None)
    each = [d.report(plane=k) for k in range(5)]
    whole = d.report()
    assert max(report.error for report in each) == whole.error
    assert min(report.error for report in each) < whole.error
    assert sum(report.evaluations for report in each) / 5 == pytest.approx(whole.evaluations)
    for wrong in (5, -1, 0.5):
        with pytest.raises(SuppleError, match="plane must be one of the 5 there are"):
            d.report(plane=wrong)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_bool_is_0_or_1(channels: int) -> None:
    """Cubic samples overshoot, along three axes by enough for 2."""
    ends = np.array([1, -1, -1, 1])
    block = np.multiply.outer(np.multiply.outer(ends, ends), ends) < 0
    source = np.zeros((8, 16, 16, channels), bool)
    source[2:6, 6:10, 6:10] = block[..., None]
    d = Deformation(source.shape[:3], border=None, on_fold="damp").grab(
        (8, 8, 4), by=(0.5, 0.5, 0.5), radius=1e4, reach=None
    )
    for name in ("auto", "cubic"):
        assert set(np.unique(d.warp(source, filter=name, between="cubic").view(np.uint8))) == {0, 1}
