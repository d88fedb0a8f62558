"""What a card makes of arrays is what the CPU makes of them."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import supple
from supple.cuda import warp
from supple.errors import FoldWarning, SuppleError, ToleranceWarning

TIGHT = 1e-4  # pixels: so that what differs is not where points are
IMAGE, STACK = (21, 26), (7, 13, 17)


def bent(shape: tuple[int, ...], seed: int = 0, count: int = 2, **options: Any) -> supple.Deformation:
    """Some strokes of all kinds."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    options = {"border": 4.0, **options}
    d = supple.Deformation(shape, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        for k in range(count):
            d = d.grab(
                rng.uniform(0.3, 0.7, len(shape)) * size,
                by=rng.normal(0, 0.08, len(shape)) * size,
                radius=float(0.8 * size.max() / (k + 1)),
                scales=1 + k % 3,
                poisson=(0.4, 0.5, 0.1)[k % 3],
            )
    return d


def waves(shape: tuple[int, ...], channels: int = 0) -> np.ndarray:
    """Smooth values from 0 to 1."""
    places = np.indices(shape).astype(float)
    phases = np.arange(max(channels, 1))
    slopes = (0.37, 0.29, 0.41)[: len(shape)]
    along = sum(s * p for s, p in zip(slopes, places, strict=True))
    out = 0.5 + 0.5 * np.sin(np.asarray(along)[..., None] + phases)
    return out if channels else out[..., 0]


def typed(values: np.ndarray, dtype: Any) -> np.ndarray:
    """Values from 0 to 1 in the numbers of a type."""
    kind = np.dtype(dtype)
    if kind == np.bool_:
        return values > 0.5
    if kind.kind == "f":
        return values.astype(kind)
    top = min(np.iinfo(kind).max, 1 << 50)
    low = 0 if kind.kind == "u" else -top / 3
    return np.rint(low + values * (top - low)).astype(kind)


def range_of(source: np.ndarray) -> float:
    return float(source.max()) - float(source.min())


def close(made: np.ndarray, wanted: np.ndarray, source: np.ndarray) -> None:
    """Within a thousandth of the range; what is whole, within a rounding."""
    assert made.dtype == wanted.dtype
    assert made.shape == wanted.shape
    apart = np.abs(made.astype(np.float64) - wanted.astype(np.float64)).max()
    assert apart <= 1e-3 * range_of(source) + (1.0 if source.dtype.kind in "iu" else 0.0)


def on_card(cuda: Any, array: np.ndarray) -> Any:
    return cuda.to_device(array)


@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "auto", "antialias"])
def test_filters_and_what_lies_outside(numba_cuda: Any, filter: str, outside: str) -> None:
    d = bent(IMAGE, border=None)
    source = waves(IMAGE, 3).astype(np.float32)
    options: dict[str, Any] = {"filter": filter, "outside": outside, "fill": (0.1, 0.9, 0.5), "tolerance": TIGHT}
    made = d.warp(on_card(numba_cuda, source), **options).copy_to_host()
    apart = np.abs(made - d.warp(source, **options)).max(axis=-1)
    if filter == "nearest":  # but where a point lies on the line between two samples
        assert (apart > 0).mean() < 0.01
    else:
        assert apart.max() < 1e-3


@pytest.mark.parametrize("filter", ["auto", "antialias"])
def test_averages_of_noise(numba_cuda: Any, filter: str) -> None:
    # Nothing hides what differs here: neither rough cells nor the picture's edges.
    shape = (40, 48)
    source = np.random.default_rng(1).random(shape).astype(np.float32)
    d = bent(shape, seed=5, border=None)
    made = d.warp(on_card(numba_cuda, source), filter=filter, tolerance=TIGHT).copy_to_host()
    apart = np.abs(made - d.warp(source, filter=filter, tolerance=TIGHT))
    assert np.abs(made - d.warp(source, filter="cubic", tolerance=TIGHT)).max() > 0.05
    assert apart.max() < 1e-3


@pytest.mark.parametrize("shape", [(1, 20), (20, 1), (2, 20), (20, 3), (6, 258), (34, 9), (100, 9)])
def test_averages_of_thin_pictures(numba_cuda: Any, shape: tuple[int, int]) -> None:
    source = np.random.default_rng(2).random(shape).astype(np.float32)
    d = supple.Deformation(shape, border=None)
    if max(shape) == 20:  # squeezed from both sides
        along = np.array([1.0, 0.0] if shape[1] == 20 else [0.0, 1.0])
        across = along[::-1]
        for _ in range(2):
            for side in (1, -1):
                d = d.grab(9.5 * along + 80 * side * across, by=60 * side * along, radius=80)
    elif shape[1] == 258:  # at column 256, where the CPU's points have another anchor; two columns from the edge
        d = d.grab((257.3, 3), by=(2.5, 1), radius=3)
    else:  # at row 64, or 32, where it begins another band
        d = d.grab((4.2, 63.4 if shape[0] == 100 else 31.4), by=(1, 2.5), radius=3)
    for kind in ("auto", "antialias"):
        made = d.warp(on_card(numba_cuda, source), filter=kind, tolerance=TIGHT).copy_to_host()
        assert np.abs(made - d.warp(source, filter=kind, tolerance=TIGHT)).max() < 1e-3


TYPES = ["f2", "f4", "f8", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "?"]


@pytest.mark.parametrize("dtype", TYPES)
def test_types(numba_cuda: Any, dtype: str) -> None:
    d = bent(IMAGE)
    source = typed(waves(IMAGE), dtype)
    made = d.warp(on_card(numba_cuda, source), filter="linear", tolerance=TIGHT).copy_to_host()
    wanted = d.warp(source, filter="linear", tolerance=TIGHT)
    if dtype == "?":
        assert (made != wanted).mean() < 0.01
        assert made.dtype == np.bool_
    else:
        close(made, wanted, source)
    labels = d.warp(on_card(numba_cuda, source), filter="nearest", tolerance=TIGHT).copy_to_host()
    points = d.inverse_map(tolerance=TIGHT)
    sure = (np.abs(points % 1 - 0.5) > 1e-3).all(axis=-1)
    np.testing.assert_array_equal(labels[sure], d.warp(source, filter="nearest", tolerance=TIGHT)[sure])
    assert sure.mean() > 0.9


@pytest.mark.parametrize("light", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "f4"])
@pytest.mark.parametrize("channels", [2, 4])
def test_opacity_and_light(numba_cuda: Any, channels: int, dtype: str, light: bool) -> None:
    d = bent(IMAGE)
    source = typed(waves(IMAGE, channels), dtype)
    options: dict[str, Any] = {"filter": "cubic", "alpha": True, "linear_light": light, "tolerance": TIGHT}
    made = d.warp(on_card(numba_cuda, source), **options).copy_to_host().astype(float)
    wanted = d.warp(source, **options).astype(float)
    # Where hardly anything is there, its colour is hardly known.
    weight = wanted[..., -1:] / (255 if dtype == "u1" else 1)
    apart = np.abs(made - wanted) * np.concatenate([np.repeat(weight, channels - 1, -1), weight * 0 + 1], -1)
    assert apart.max() <= (1.01 if dtype == "u1" else 1e-3)


STACKS = [
    ("linear", "linear", False),
    ("nearest", "nearest", False),
    ("cubic", "cubic", False),
    ("linear", "nearest", False),
    ("linear", "linear", True),
    ("auto", "cubic", True),
]


@pytest.mark.parametrize(("filter", "between", "average"), STACKS)
def test_stacks(numba_cuda: Any, filter: str, between: str, average: bool) -> None:
    d = bent(STACK, spacing=(1.0, 0.8, 1.7), border=3.0)
    source = waves(STACK).astype(np.float32)
    options: dict[str, Any] = {"filter": filter, "between": between, "time_filter": average, "tolerance": TIGHT}
    made = d.warp(on_card(numba_cuda, source), **options).copy_to_host()
    apart = np.abs(made - d.warp(source, **options))
    if "nearest" in (filter, between):
        assert (apart > 1e-3).mean() < 0.01
    else:
        assert apart.max() < 1e-3


@pytest.mark.parametrize("outside", ["constant", "reflect"])
def test_what_lies_beyond_a_stack(numba_cuda: Any, outside: str) -> None:
    d = supple.Deformation(STACK, border=None).grab((8, 6, 3), by=(5, 2, 2.5), radius=14)
    source = typed(waves(STACK, 2), "u2")
    options: dict[str, Any] = {"filter": "linear", "outside": outside, "fill": (100, 60000), "tolerance": TIGHT}
    close(d.warp(on_card(numba_cuda, source), **options).copy_to_host(), d.warp(source, **options), source)


@pytest.mark.parametrize("count", [0, 1, 5])
@pytest.mark.parametrize("border", [None, 6.0])
def test_strokes_and_borders(numba_cuda: Any, border: float | None, count: int) -> None:
    d = bent(IMAGE, seed=3, count=count, border=border)
    source = waves(IMAGE).astype(np.float32)
    made = d.warp(on_card(numba_cuda, source), filter="cubic", tolerance=TIGHT).copy_to_host()
    close(made, d.warp(source, filter="cubic", tolerance=TIGHT), source)
    if d.is_identity:
        np.testing.assert_array_equal(made, source)


@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("shape", [(9, 12), (4, 6, 7)])
def test_batches(numba_cuda: Any, shape: tuple[int, ...], each: bool) -> None:
    several = [bent(shape, seed=k, count=k, border=(None, 3.0, 2.0)[k]) for k in range(3)]
    given: Any = several if each else several[2]
    sources = np.stack([(k + 1) * waves(shape, 2) for k in range(3)]).astype(np.float32)
    options: dict[str, Any] = {"filter": "linear", "tolerance": TIGHT}
    made = supple.warp_batch(on_card(numba_cuda, sources), given, **options).copy_to_host()
    close(made, supple.warp_batch(sources, given, **options), sources)
    close(made[1], several[1 if each else 2].warp(sources[1], **options), sources)
    if each:  # the first has no strokes
        coloured = np.random.default_rng(0).integers(0, 2, (3, *shape, 4)).astype(np.uint8) * 200
        again = supple.warp_batch(on_card(numba_cuda, coloured), given, filter="linear").copy_to_host()
        np.testing.assert_array_equal(again[0], coloured[0])  # colours where nothing is to be seen, too
    nothing = supple.warp_batch(on_card(numba_cuda, sources[:0]), several[2])
    assert nothing.shape == sources[:0].shape == supple.warp_batch(sources[:0], several[2]).shape


def test_views_of_any_strides(numba_cuda: Any) -> None:
    d = bent((9, 12))
    whole = waves((18, 14, 3)).astype(np.float32)
    there = on_card(numba_cuda, whole)
    for view in (np.s_[::2, 2:, 1], np.s_[::-2, -3::-1, 0], np.s_[4:13, 1:13]):
        source = np.ascontiguousarray(whole[view])
        made = d.warp(there[view], filter="linear", tolerance=TIGHT).copy_to_host()
        close(made, d.warp(source, filter="linear", tolerance=TIGHT), source)
    # What comes is written where it belongs, and nowhere else.
    out = on_card(numba_cuda, np.full((20, 13), -7.0, np.float32))
    source = np.ascontiguousarray(whole[:9, :12, 0])
    returned = d.warp(on_card(numba_cuda, source), filter="linear", tolerance=TIGHT, out=out[1:19:2, 1:])
    host = out.copy_to_host()
    close(host[1:19:2, 1:], d.warp(source, filter="linear", tolerance=TIGHT), source)
    np.testing.assert_array_equal(host[0::2], -7)
    np.testing.assert_array_equal(host[:, 0], -7)
    np.testing.assert_array_equal(returned.copy_to_host(), host[1:19:2, 1:])


@pytest.mark.parametrize("shape", [IMAGE, STACK])
def test_points_and_the_map(numba_cuda: Any, shape: tuple[int, ...]) -> None:
    d = bent(shape, seed=5, count=3, spacing=0.5 if len(shape) == 2 else (0.5, 0.7, 1.3))
    points = np.random.default_rng(1).uniform(-0.2, 1.2, (4, 5, len(shape))) * np.array(shape[::-1])
    there = on_card(numba_cuda, points)
    np.testing.assert_allclose(d.forward(there).copy_to_host(), d.forward(points), atol=1e-9)
    np.testing.assert_allclose(d.jacobian(there).copy_to_host(), d.jacobian(points), atol=1e-9)
    found, known = d.inverse(there), d.inverse(points)
    np.testing.assert_allclose(found.points.copy_to_host(), known.points, atol=1e-7)
    np.testing.assert_allclose(d.forward(found.points).copy_to_host(), points, atol=1e-8)
    assert found.residual.copy_to_host().max() < 1e-8
    assert found.converged.copy_to_host().all()
    assert found.converged.shape == points.shape[:-1]
    assert (found.steps.copy_to_host() > 0).all()
    single = d.forward(on_card(numba_cuda, points[0, 0].astype(np.float32)))
    np.testing.assert_allclose(single.copy_to_host(), d.forward(points[0, 0].astype(np.float32)), atol=1e-9)
    exact = d.inverse(np.moveaxis(np.indices(shape)[::-1], 0, -1)).points
    made = d.inverse_map(like=there, tolerance=1e-3).copy_to_host()
    assert made.shape == (*shape, len(shape))
    assert made.dtype == np.float32
    assert np.linalg.norm(made - exact, axis=-1).max() < 1e-3


def test_the_certificate_holds(numba_cuda: Any) -> None:
    """Good cells and solved ones, and the error of both is what is told of them."""
    d = supple.Deformation((33, 70), border=12).grab((20, 15), by=(6, 4), radius=18).grab((60, 20), by=(2, 1), radius=7)
    exact = d.inverse(np.moveaxis(np.indices(d.shape)[::-1], 0, -1)).points
    for tolerance in (0.1, 3e-3):
        warping = supple.cuda.start(
            on_card(numba_cuda, np.zeros(d.shape, np.float32)), d, filter="linear", tolerance=tolerance
        )
        assert warping.error <= tolerance
        made = d.inverse_map(like=warping.array, tolerance=tolerance).copy_to_host()
        assert np.linalg.norm(made - exact, axis=-1).max() <= warping.error + 2e-5
    far = supple.Deformation((9, 9), border=None).grab((4, 4), by=(1e9, 0), radius=1e9)
    with pytest.warns(ToleranceWarning, match="more than the tolerance 1e-09"):
        far.warp(on_card(numba_cuda, np.zeros((9, 9), np.float32)), tolerance=1e-9)


def test_warps_that_are_not_waited_for(numba_cuda: Any) -> None:
    d = bent(STACK)
    source = waves(STACK).astype(np.float32)
    wanted = d.warp(source, filter="linear", tolerance=TIGHT)
    out = on_card(numba_cuda, np.zeros_like(source))
    warping = supple.cuda.start(on_card(numba_cuda, source), d, filter="linear", tolerance=TIGHT, slab=2, out=out)
    warping.join()
    assert warping.wait() is out
    assert warping.done()
    close(out.copy_to_host(), wanted, source)
    assert 0 < warping.error <= TIGHT


def test_what_cannot_be_done_is_said(numba_cuda: Any) -> None:
    d = bent((9, 12))
    source = on_card(numba_cuda, np.zeros((9, 12), np.float32))
    for given, options, words in (
        (
            on_card(numba_cuda, np.zeros((9, 11), np.float32)),
            {},
            r"source must be .* \(9, 12\).*found .shape \(9, 11\)",
        ),
        (on_card(numba_cuda, np.zeros((9, 12), np.complex64)), {}, "found .dtype complex64"),
        (source, {"filter": "ewa"}, "filter must be .*antialias.* found 'ewa'|filter must be .* found \"ewa\""),
        (source, {"device": "gpu"}, "device must be left out for an array on a card"),
        (source, {"out": np.zeros((9, 12), np.float32)}, "out must be an array on the source's card"),
        (source, {"out": on_card(numba_cuda, np.zeros((9, 12)))}, "out must be .*found .float64"),
        (source, {"out": source}, "out must not overlap source"),
        (source, {"fill": (1, 2)}, "fill must be"),
        (source, {"alpha": True}, "alpha=True needs a last channel"),
    ):
        with pytest.raises(SuppleError, match=words):
            d.warp(given, **options)
    with pytest.raises(SuppleError, match=r"points must be .*x first"):
        d.forward(on_card(numba_cuda, np.zeros((4, 3))))
    with pytest.raises(SuppleError, match="float32 or float64"):
        d.inverse(on_card(numba_cuda, np.zeros((4, 2), np.int32)))
    with pytest.raises(SuppleError, match="like must be an array on a card"):
        d.inverse_map(like=np.zeros(3))
    with pytest.raises(SuppleError, match="one for each of the 3 items"):
        supple.warp_batch(on_card(numba_cuda, np.zeros((3, 9, 12), np.float32)), [d, d])
    with pytest.raises(SuppleError, match="slab must be"):
        supple.cuda.start(source, d, slab=0)
    with pytest.raises(SuppleError, match="stream must be a stream of PyTorch, CuPy or Numba"):
        supple.cuda.start(source, d, stream="x")
    with pytest.raises(SuppleError, match="source must be an array on a card"):
        supple.cuda.start(np.zeros((9, 12), np.float32), d)
    assert (source.copy_to_host() == 0).all()


def test_in_pieces_and_with_long_indices(numba_cuda: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What large arrays take, on small ones."""
    monkeypatch.setattr(warp, "SCRATCH", 1)
    monkeypatch.setattr(warp, "_LONG", 0)
    monkeypatch.setattr(warp, "_KEPT_PIECES", 0)
    d = bent(STACK, seed=2)
    source = waves(STACK, 2).astype(np.float32)
    made = d.warp(on_card(numba_cuda, source), filter="linear", tolerance=TIGHT).copy_to_host()
    close(made, d.warp(source, filter="linear", tolerance=TIGHT), source)
    several = [bent((9, 12), seed=k, count=k) for k in range(3)]
    sources = np.stack([waves((9, 12))] * 3).astype(np.float32)
    made = supple.warp_batch(on_card(numba_cuda, sources), several, filter="cubic", tolerance=TIGHT).copy_to_host()
    close(made, supple.warp_batch(sources, several, filter="cubic", tolerance=TIGHT), sources)
