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
from tests.engine.frames import BETWEEN, FILTERS, RULES, SHAPE, Array, Floats, exact, hurried, noise, top_of

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")
DTYPES = ["bool", "u1", "u2", "i2", "f2", "f4", "f8"]
CHANNELS = [1, 2, 3, 4, 5]
PRINTED = [("linear", "linear"), ("linear", "cubic"), ("linear", "nearest"), ("cubic", "linear"), ("cubic", "cubic")]
DIRECT = ["linear", "cubic", "auto"]  # these have a path of their own
FINE = 1e-5


@functools.cache
def bent() -> Deformation:
    """It shrinks and magnifies, and reaches beyond the clip along every axis, and at both of its ends."""
    d = Deformation(SHAPE, border=None, on_fold="damp").grab((20, 18, 3), by=(10, -7, 3), radius=14, reach=None)
    return d.grab((45, 30, 5), by=(-5, 6, -2.5), radius=9, scales=2, reach=None)


@functools.cache
def held() -> Deformation:
    """As strong, but no point comes from outside."""
    return Deformation(SHAPE, border=64, on_fold="damp").grab((20, 18, 3), by=(9, -6, 1.5), radius=14, reach=None)


def same(out: Array, values: Floats, span: float, leeway: float = 3e-4) -> None:
    """Whether ``out`` holds ``values``, bounded and rounded as its type does, up to a part of their span."""
    off = leeway * span
    if out.dtype == np.bool_:
        clear = np.abs(values - 0.5) > leeway
        assert (out == (values >= 0.5))[clear].all()
        return
    if out.dtype.kind in "iu":
        limits = np.iinfo(out.dtype)
        values, off = np.clip(values, float(limits.min), float(limits.max)), off + 0.5
    elif out.dtype == np.float16:
        off += 2**-11 * np.abs(values).max()
    assert np.abs(out.astype(np.float64) - values).max() <= off


def test_the_deformations_are_what_they_should_be() -> None:
    size = np.array(SHAPE[::-1])
    points = exact(bent())
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


@pytest.mark.parametrize("dtype", [">u2", ">i2", ">f2", ">f4", ">f8"])
def test_the_order_of_bytes_makes_no_difference(dtype: str) -> None:
    source = noise(dtype, 3)
    native = source.astype(np.dtype(dtype).newbyteorder("="))
    for name in FILTERS:
        out = bent().warp(source, filter=name)
        assert out.dtype == source.dtype
        np.testing.assert_array_equal(out, bent().warp(native, filter=name))


@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8"])
def test_nearest_knows_neither_light_nor_opacity(dtype: str) -> None:
    source = np.abs(noise("f8", 4)) % 1 * top_of(dtype)
    source = source.astype(dtype)
    plain = bent().warp(source, filter="nearest", alpha=False)
    np.testing.assert_array_equal(bent().warp(source, filter="nearest", alpha=True), plain)
    np.testing.assert_array_equal(bent().warp(source, filter="nearest", linear_light=True), plain)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_averages_are_those_of_float64(dtype: str, rule: str) -> None:
    source = noise(dtype, 5)
    fill = [1.0] * 5 if dtype == "bool" else [3.0 + 9 * c for c in range(5)]
    numbers = source.astype(np.float64)
    span = 2 * float(np.abs(numbers).max())
    for name in ("auto",):
        for averaged in (False, True):
            how: dict[str, Any] = {"filter": name, "outside": rule, "alpha": False, "time_filter": averaged}
            values = bent().warp(numbers, fill=fill, **how)
            for channels in CHANNELS[:4]:
                part = np.ascontiguousarray(source[..., :channels])
                found = bent().warp(part, fill=fill[:channels], **how)
                same(found, values[..., :channels], span, 3e-3)  # five channels go another way, row by row


def test_a_plane_through_the_pivot_is_a_picture() -> None:
    """Where a stroke does not act along time, a frame is deformed as a picture is, by every filter."""
    source = noise("f8", 4)
    for border in (None, 50.0):
        d = Deformation(SHAPE, border=border, on_fold="damp").grab((20, 18, 3), by=(10, -7, 0), radius=14, reach=None)
        flat = Deformation(SHAPE[1:], border=border, on_fold="damp").grab((20, 18), by=(10, -7), radius=14, reach=None)
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
        source = (np.random.default_rng(1).uniform(0, top_of(dtype), (*SHAPE, 5))).astype(dtype)
        for d in (bent(), held()):
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
        opaque = np.concatenate([source[..., :3], np.full((*SHAPE, 1), top_of(dtype), dtype)], axis=-1)
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
    for d in (bent(), strong):
        for dtype, values in (("u1", (0, 77, 255)), ("i2", (-32768, 32767)), ("f4", (0.3,)), ("f8", (1e6 / 3,))):
            for value in values:
                for channels in (1, 3, 5):
                    source = np.full((*d.shape, channels), value, dtype)
                    for alpha in {False, channels > 1 and dtype == "u1"}:
                        for rule in ("edge", "reflect"):
                            out = d.warp(source, outside=rule, alpha=alpha, **how)
                            if dtype in ("f4", "f8"):
                                np.testing.assert_allclose(out, source, rtol=3e-6 if dtype == "f4" else 1e-6)
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
                    same(out, expected.astype(np.float64), 255)
                given = np.full_like(source, 77)
                d.warp(source, alpha=False, tolerance=FINE, out=given, **how)
                np.testing.assert_array_equal(given, out)


@pytest.mark.filterwarnings("ignore::supple.ToleranceWarning")  # float32 does not count so far
@pytest.mark.parametrize("size", [1e9, 1e20, 1e30])
def test_as_far_outside_as_numbers_go(size: float) -> None:
    source = noise("f4", 1, (3, 5, 50))
    d = Deformation(source.shape[:3], border=None, on_fold="damp").grab(
        (20, 2, 1), by=(size, size / 3, -size / 5), radius=size / 2, reach=None
    )
    for name in ("nearest", "linear", "auto"):
        how: dict[str, Any] = {"filter": name, "time_filter": name == "auto"}
        made = d.warp(source, outside="edge", **how)
        np.testing.assert_allclose(made, np.broadcast_to(source[-1, 0, 0], made.shape), rtol=1e-5, atol=1e-4)
        made = d.warp(source, outside="reflect", **how)
        assert np.isfinite(made).all()
        assert np.abs(made).max() <= 1.6 * np.abs(source).max()


@pytest.mark.parametrize("filter", ["nearest", "linear", "auto"])
def test_arrays_of_any_layout(filter: str, tmp_path: Path) -> None:
    wide = np.random.default_rng(6).uniform(size=(14, 74, 100, 6)).astype(np.float32)
    base = np.ascontiguousarray(wide[::2, ::2, ::2, ::2])
    expected = bent().warp(base, filter=filter)
    frozen = base.copy()
    frozen.flags.writeable = False
    mapped = np.memmap(tmp_path / "source", np.float32, "w+", shape=base.shape)
    mapped[:] = base
    mapped.flush()
    layouts = {
        "strided": wide[::2, ::2, ::2, ::2],
        "reversed": np.ascontiguousarray(base[::-1, ::-1])[::-1, ::-1],
        "Fortran": np.asfortranarray(base),
        "transposed": np.ascontiguousarray(base.transpose(3, 2, 0, 1)).transpose(2, 3, 1, 0),
        "big-endian": base.astype(">f4"),
        "frozen": frozen,
        "mapped": np.memmap(tmp_path / "source", np.float32, "r", shape=base.shape),
    }
    for name, source in layouts.items():
        before = source.tobytes()
        out = bent().warp(source, filter=filter)
        assert out.dtype == source.dtype, name
        assert out.flags.c_contiguous, name
        np.testing.assert_array_equal(out, expected, err_msg=name)
        assert source.tobytes() == before, name
        for order in ("C", "F"):
            given = np.full(source.shape, 7, source.dtype, order=order)
            assert bent().warp(source, filter=filter, out=given) is given
            np.testing.assert_array_equal(given, expected, err_msg=name)
    whole = np.full((14, 74, 100, 6), 7, np.float32)
    bent().warp(base, filter=filter, out=whole[::2, ::2, ::2, ::2])
    np.testing.assert_array_equal(whole[::2, ::2, ::2, ::2], expected)
    assert (whole[1::2] == 7).all()
    written = np.memmap(tmp_path / "out", np.float32, "w+", shape=base.shape)
    assert bent().warp(mapped, filter=filter, out=written) is written
    written.flush()
    np.testing.assert_array_equal(np.fromfile(tmp_path / "out", np.float32).reshape(base.shape), expected)
    grey = bent().warp(base[..., 0], filter=filter)
    assert grey.shape == SHAPE
    np.testing.assert_array_equal(grey, bent().warp(base[..., :1], filter=filter)[..., 0])


def test_two_maps_of_one_file_overlap(tmp_path: Path) -> None:
    """Though not in memory."""
    size = math.prod(SHAPE)
    np.zeros(2 * size + 8, np.uint8).tofile(tmp_path / "a")
    os.symlink(tmp_path / "a", tmp_path / "link")

    def mapped(name: str, offset: int, mode: Any = "r+") -> npt.NDArray[np.uint8]:
        return np.memmap(tmp_path / name, np.uint8, mode, offset, shape=SHAPE)

    for source, out in (
        (mapped("a", 0, "r"), mapped("a", 0)),
        (mapped("a", 0, "r"), mapped("link", size - 1)),
        (np.asarray(mapped("a", 8, "r")), mapped("a", 0)[:]),
    ):
        with pytest.raises(SuppleError, match="out must not overlap source"):
            bent().warp(source, out=out)
    bent().warp(mapped("a", 0, "r"), out=mapped("a", size))
    (tmp_path / "b").write_bytes((tmp_path / "a").read_bytes())
    bent().warp(mapped("a", 0, "r"), out=mapped("b", 0))


@pytest.mark.parametrize("dtype", [*DTYPES, ">u2", ">f4", ">f2"])
def test_without_a_stroke_or_force_no_bit_changes(dtype: str) -> None:
    """Any bits at all, and so numbers that are none."""
    kind = np.dtype(dtype)
    raw = np.random.default_rng(7).integers(0, 256, math.prod(SHAPE) * 4 * kind.itemsize, np.uint8)
    source = (raw & 1 if kind == np.bool_ else raw).view(kind).reshape(*SHAPE, 4)
    still = [
        Deformation(SHAPE, border=64, on_fold="damp"),
        Deformation(SHAPE, border=None, on_fold="damp").grab((3, 3, 3), by=(0, 0, 0), radius=5, reach=None),
    ]
    for d in still:
        for name in FILTERS:
            for averaged in (False, True):
                out = d.warp(source, filter=name, time_filter=averaged, alpha=False)
                assert out.dtype == source.dtype
                assert out.tobytes() == source.tobytes()
                assert not np.may_share_memory(out, source)


@pytest.mark.parametrize("dtype", ["bool", "u1", "i2", "f2", "f4", ">u2", ">f4"])
def test_planes_where_nothing_moves_are_left_as_they_are(dtype: str) -> None:
    d = Deformation((40, 37, 50), border=None, on_fold="damp").grab(
        (25, 18, 6), by=(3, 2, 2), radius=4, scales=3, reach=None
    )
    source = noise(dtype, 3, d.shape)
    if np.dtype(dtype).kind == "f":
        source[30, 5, 5], source[30, 6, 6] = np.inf, -0.0
    for light_too in (False, True):
        if light_too and dtype in ("bool", "i2"):
            continue
        for name in ("nearest", "linear", "auto"):
            with np.errstate(invalid="ignore"):
                out = d.warp(source, filter=name, linear_light=light_too)
            for z in (25, 30, 39):
                assert out[z].tobytes() == source[z].tobytes()
            assert (out[6] != source[6]).any()


def test_threads_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    source = np.random.default_rng(8).integers(0, 255, (*hurried().shape, 3), np.uint8)
    for name in FILTERS:
        results = []
        for threads in ("1", "3"):
            monkeypatch.setenv("SUPPLE_THREADS", threads)
            results.append(hurried().warp(source, filter=name, time_filter=True))
        np.testing.assert_array_equal(*results)


GOOD = np.zeros((*SHAPE, 3), np.uint8)
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"source": np.zeros((7, 37, 51, 3), np.uint8)}, "source"),
    ({"source": np.zeros((8, 37, 50), np.uint8)}, "source"),
    ({"source": np.zeros(SHAPE[1:], np.uint8)}, "source"),
    ({"source": np.zeros((*SHAPE, 3, 1), np.uint8)}, "source"),
    ({"source": np.zeros((*SHAPE, 0), np.uint8)}, "source"),
    ({"source": np.zeros(SHAPE, complex)}, "dtype complex128"),
    ({"source": np.zeros(SHAPE, object)}, "dtype object"),
    ({"source": None}, "dtype object"),
    ({"source": lambda p: p[:, 0]}, "three axes"),
    ({"filter": "lanczos"}, "filter must be"),
    ({"outside": "wrap"}, "outside must be"),
    ({"between": "quintic"}, "between must be"),
    ({"between": 1}, "between must be"),
    ({"filter": "nearest", "between": "linear"}, "between must be"),
    ({"tolerance": 0}, "tolerance"),
    ({"tolerance": math.nan}, "tolerance"),
    ({"fill": (1, 2)}, "fill"),
    ({"fill": math.inf}, "fill"),
    ({"source": np.zeros(SHAPE, np.uint8), "alpha": True}, "alpha"),
    ({"source": np.zeros((*SHAPE, 1), np.uint8), "alpha": True}, "alpha"),
    ({"source": np.zeros(SHAPE, bool), "linear_light": True}, "linear_light"),
    ({"source": np.zeros(SHAPE, np.int16), "linear_light": True}, "linear_light"),
    ({"out": np.zeros(SHAPE, np.uint8)}, "out must be"),
    ({"out": np.zeros((*SHAPE, 3), np.uint16)}, "out must be"),
    ({"out": [[0]]}, "out must be"),
    ({"out": GOOD}, "overlap"),
    ({"out": GOOD[::-1]}, "overlap"),
]


@pytest.mark.parametrize(("how", "message"), REFUSED)
def test_refusals(how: dict[str, Any], message: str) -> None:
    for d in (bent(), Deformation(SHAPE, border=64, on_fold="damp")):
        with pytest.raises(SuppleError, match=message):
            d.warp(**{"source": GOOD, **how})
    assert not GOOD.any()


def test_more_refusals() -> None:
    frozen = np.zeros_like(GOOD)
    frozen.flags.writeable = False
    with pytest.raises(SuppleError, match="read-only"):
        bent().warp(GOOD, out=frozen)
    with pytest.raises(SuppleError, match="between"):
        Deformation((5, 5), border=64, on_fold="damp").warp(np.zeros((5, 5)), between="linear")
    np.testing.assert_array_equal(bent().warp(GOOD.tolist()), 0)


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
