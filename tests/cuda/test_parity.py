"""Warps of arrays on a GPU against the oracles."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import supple
import supple.cuda
from supple.cuda import arrays, warp
from supple.errors import FoldWarning, OutsideWarning, SuppleError, ToleranceWarning
from tests import reference
from tests.cuda.at_size import typed
from tests.cuda.driver import on_host, sent
from tests.cuda.expected import expected, sources, untouched
from tests.engine.table import Limits, Row, rows

pytestmark = [
    pytest.mark.usefixtures("gpu"),
    pytest.mark.filterwarnings("ignore::supple.OutsideWarning"),
]
TIGHT = 1e-4  # pixels: so that what differs is not where points are
IMAGE, STACK = (13, 16), (5, 9, 10)


def bent(shape: tuple[int, ...], seed: int = 0, count: int = 2, **options: Any) -> supple.Deformation:
    """Some strokes of all kinds."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    options = {"border": 4.0, "on_fold": "damp", **options}
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
                reach=None,
            )
    return d


def gentle(shape: tuple[int, ...]) -> supple.Deformation:
    """A grab so wide that the cells of its lattice are exact."""
    by = np.array([2.3, 1.6, 1.3])[: len(shape)]
    middle = (np.array(shape[::-1]) - 1.0) / 3
    return supple.Deformation(shape, border=None, on_fold="damp").grab(middle, by=by, radius=60.0, reach=None)


def squeezed(shape: tuple[int, int], times: int) -> supple.Deformation:
    """Strokes from all sides that shrink what lies between them, by more in one direction than in the other."""
    x, y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    d = supple.Deformation(shape, border=None, on_fold="damp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideWarning)
        for _ in range(times):
            for side in (1, -1):
                d = d.grab((x + side * 40, y), by=(-side * 35, 0), radius=40, reach=None)
                d = d.grab((x, y + side * 40), by=(0, -side * 30), radius=40, reach=None)
    return d


def waves(shape: tuple[int, ...], channels: int = 0) -> np.ndarray:
    """Smooth values from 0 to 1."""
    places = np.indices(shape).astype(float)
    phases = np.arange(max(channels, 1))
    slopes = (0.37, 0.29, 0.41)[: len(shape)]
    along = sum(s * p for s, p in zip(slopes, places, strict=True))
    out = 0.5 + 0.5 * np.sin(np.asarray(along)[..., None] + phases)
    return out if channels else out[..., 0]


def range_of(source: np.ndarray) -> float:
    return float(source.max()) - float(source.min())


def close(made: np.ndarray, wanted: np.ndarray, source: np.ndarray) -> None:
    """Within a thousandth of the range; what is whole, within a rounding."""
    assert made.dtype == wanted.dtype
    assert made.shape == wanted.shape
    apart = np.abs(made.astype(np.float64) - wanted.astype(np.float64)).max()
    assert apart <= 1e-3 * range_of(source) + (1.0 if source.dtype.kind in "iu" else 0.0)


# Each of these has one number of channels, or two.
ROWS = [
    *rows(["small image"], few=True),
    *(row for row in rows(["small image, turned"], ("f4",)) if row.outside == "edge"),
    *rows(["small clip", "small volume"], few=True),
    *rows(["small image"], ("u1", "f4"), ["opacity", "light", "opacity and light"], few=True),
]


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_rows(row: Row) -> None:
    def engine(d: supple.Deformation, source: np.ndarray, **options: Any) -> Any:
        return on_host(d.warp(sent(source), tolerance=TIGHT, **options))

    limits = Limits(most=1e-3, mean=2e-4, margin=1e-3)
    row.check(engine, limits, (0,) if row.kind == "plain" and row.dtype != "f4" else (2, 3, 4))


FOOTPRINTS: dict[str, tuple[supple.Deformation, float]] = {
    "narrow and wide, solved": (
        supple.Deformation((18, 22), border=None, on_fold="damp").grab((11, 9), by=(4, 2.5), radius=7, reach=None),
        1.5,
    ),
    "narrow and wide, in cells": (
        supple.Deformation((40, 48), border=64, on_fold="damp").grab((22, 18), by=(14, 9), radius=30, reach=None),
        1.2,
    ),
    "along any axis": (squeezed((12, 13), 1), 3.0),
    "from a pyramid": (squeezed((13, 12), 3), 15.0),
}


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_averages_of_noise(name: str) -> None:
    d, most = FOOTPRINTS[name]
    source = np.random.default_rng(1).random(d.shape).astype(np.float32)
    made = on_host(d.warp(sent(source), tolerance=TIGHT))
    strokes = reference.carried_out(d)
    shrunk = np.linalg.svd(reference.matrices(strokes, d.domain, sources(d)))[1] ** 2
    assert shrunk.max() > most
    assert np.abs(made - expected(d, source)).max() < 1e-3
    assert np.abs(made - expected(d, source, filter="cubic")).max() > 0.05


@pytest.mark.parametrize("outside", ["constant", "reflect"])
def test_averages_beyond_the_edges(outside: str) -> None:
    d = squeezed((9, 7), 3)
    source = np.random.default_rng(1).integers(0, 255, (9, 7, 4)).astype(np.uint8)
    options: dict[str, Any] = {"outside": outside, "fill": (0, 90, 200, 100), "alpha": True, "tolerance": TIGHT}
    made = on_host(d.warp(sent(source), **options))
    wanted = expected(d, source, **options).astype(int)
    assert np.abs(made[..., 3] - wanted[..., 3]).max() <= 1
    assert np.abs((made.astype(int) - wanted)[..., :3] * wanted[..., 3:]).max() <= 255


@pytest.mark.parametrize("shape", [(1, 20), (20, 1), (2, 20), (20, 3)])
def test_averages_of_thin_pictures(shape: tuple[int, int]) -> None:
    source = np.random.default_rng(2).random(shape).astype(np.float32)
    d = supple.Deformation(shape, border=None, on_fold="damp")
    along = np.array([1.0, 0.0] if shape[1] == 20 else [0.0, 1.0])
    across = along[::-1]
    for side in (1, -1, 1, -1):  # squeezed from both sides
        d = d.grab(9.5 * along + 80 * side * across, by=60 * side * along, radius=80, reach=None)
    made = on_host(d.warp(sent(source), tolerance=TIGHT))
    assert np.abs(made - expected(d, source)).max() < 1e-3


@pytest.mark.parametrize("count", [0, 1, 4])
@pytest.mark.parametrize(("border", "profile"), [(None, "quartic"), (6.0, "quartic"), (5.0, "sine")])
def test_strokes_and_borders(border: float | None, profile: str, count: int) -> None:
    d = bent(IMAGE, seed=3, count=count, border=border, border_profile=profile)
    source = waves(IMAGE).astype(np.float32)
    made = on_host(d.warp(sent(source), filter="cubic", tolerance=TIGHT))
    close(made, expected(d, source, filter="cubic"), source)
    if d.is_identity:
        np.testing.assert_array_equal(made, source)


REACHES: dict[str, supple.Deformation] = {
    "small": supple.Deformation((20, 23), border=5, on_fold="damp").grab((12, 9), by=(1.2, 0.8), radius=3, reach=2),
    "across the border": supple.Deformation((20, 23), border=5, on_fold="damp").grab(
        (3, 16), by=(0.6, -0.5), radius=3, reach=2.5
    ),
    "in cells": supple.Deformation((30, 64), border=None, on_fold="damp").grab((3, 12), by=(9, 4), radius=14, reach=3),
    "two": supple.Deformation((20, 40), border=None, border_profile="sine", on_fold="damp")
    .grab((10, 9), by=(1, 0.5), radius=3, reach=2)
    .grab((30, 9), by=(1, 0.5), radius=2, reach=3),
    "one without a limit": supple.Deformation((12, 20), border=None, on_fold="damp")
    .grab((6, 6), by=(1, 0.5), radius=3, reach=2)
    .grab((14, 5), by=(1, 0.5), radius=30, reach=None),
}


@pytest.mark.parametrize("times", [2, 12])
def test_constants_of_wide_numbers_stay_constant(times: int) -> None:
    d = squeezed((30, 24), times)
    for dtype, value in (("i4", 2**31 - 1), ("i8", 2**50 + 1), ("f8", 1e6 / 3)):
        source = np.full((*d.shape, 3), value, dtype)
        np.testing.assert_allclose(on_host(d.warp(sent(source))), source, rtol=0 if dtype == "i4" else 1e-14)


@pytest.mark.parametrize("name", REACHES)
def test_reach(name: str) -> None:
    d = REACHES[name]
    source = np.random.default_rng(5).random((*d.shape, 2)).astype(np.float32)
    made = on_host(d.warp(sent(source), tolerance=TIGHT))
    assert np.abs(made - expected(d, source)).max() < 1e-3
    kept = untouched(d)
    np.testing.assert_array_equal(made[kept], source[kept])
    assert (made[~kept] != source[~kept]).any(axis=-1).mean() > 0.9
    assert (kept.mean() > 0.3) == (name != "one without a limit")
    exact = on_host(d.inverse_map(like=sent(source), tolerance=TIGHT))
    assert np.linalg.norm(exact - sources(d), axis=-1).max() < TIGHT + 1e-5
    np.testing.assert_array_equal(exact[kept], reference.grid(d.shape)[kept])


@pytest.mark.parametrize("dtype", ["f2", "i8"])
def test_reach_in_a_stack(dtype: str) -> None:
    d = supple.Deformation((9, 9, 10), border=None, spacing=(1, 1, 2), on_fold="damp").grab(
        (4, 4, 3), by=(0.8, 1, 1), radius=3, reach=2
    )
    source = typed(waves(d.shape), dtype)
    options: dict[str, Any] = {"between": "cubic", "time_filter": True, "tolerance": TIGHT}
    made = on_host(d.warp(sent(source), **options))
    close(made, expected(d, source, **options), source)
    kept = untouched(d)
    assert kept.all(axis=(1, 2)).sum() == 4
    assert 0.5 < kept.mean() < 1
    np.testing.assert_array_equal(made[kept], source[kept])


@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("shape", [(7, 9), (3, 4, 5)])
def test_batches(shape: tuple[int, ...], each: bool) -> None:
    several = [bent(shape, seed=k, count=k, border=(None, 3.0, 2.0)[k]) for k in range(3)]
    given: Any = several if each else several[2]
    images = np.stack([(k + 1) * waves(shape, 2) for k in range(3)]).astype(np.float32)
    options: dict[str, Any] = {"filter": "linear", "tolerance": TIGHT}
    made = on_host(supple.warp_batch(sent(images), given, **options))
    for k in range(3):
        close(made[k], expected(several[k if each else 2], images[k], **options), images)
    if each:  # the first has no strokes
        coloured = np.random.default_rng(0).integers(0, 2, (3, *shape, 4)).astype(np.uint8) * 200
        again = on_host(supple.warp_batch(sent(coloured), given, filter="linear"))
        np.testing.assert_array_equal(again[0], coloured[0])  # colours where nothing is to be seen, too
    nothing = supple.warp_batch(sent(images[:0]), several[2])
    assert nothing.shape == images[:0].shape


def test_views_of_any_strides() -> None:
    d = gentle((9, 12))
    whole = waves((18, 14, 3)).astype(np.float32)
    there = sent(whole)
    for view in (np.s_[::2, 2:, 1], np.s_[::-2, -3::-1, 0], np.s_[4:13, 1:13]):
        source = np.ascontiguousarray(whole[view])
        made = on_host(d.warp(there[view], filter="linear", tolerance=TIGHT))
        close(made, expected(d, source, filter="linear"), source)
    # What comes is written where it belongs, and nowhere else.
    out = sent(np.full((20, 13), -7.0, np.float32))
    source = np.ascontiguousarray(whole[:9, :12, 0])
    returned = d.warp(sent(source), filter="linear", tolerance=TIGHT, out=out[1:19:2, 1:])
    host = on_host(out)
    close(host[1:19:2, 1:], expected(d, source, filter="linear"), source)
    np.testing.assert_array_equal(host[0::2], -7)
    np.testing.assert_array_equal(host[:, 0], -7)
    np.testing.assert_array_equal(on_host(returned), host[1:19:2, 1:])


@pytest.mark.parametrize("shape", [IMAGE, STACK])
def test_points_and_the_map(shape: tuple[int, ...]) -> None:
    reaches = supple.Stroke.grab(np.full(len(shape), 4.0), by=[0.6] * len(shape), radius=2, reach=2)
    d = bent(shape, seed=5, spacing=0.5 if len(shape) == 2 else (0.5, 0.7, 1.3)).add(reaches)
    strokes = reference.carried_out(d)
    points = np.random.default_rng(1).uniform(-0.2, 1.2, (4, 5, len(shape))) * np.array(shape[::-1])
    there = sent(points)
    np.testing.assert_allclose(on_host(d.forward(there)), reference.forward(strokes, d.domain, points), atol=1e-9)
    slopes = reference.jacobian(strokes, d.domain, points)
    np.testing.assert_allclose(on_host(d.jacobian(there)), slopes, atol=1e-9)
    found = d.inverse(there)
    wanted = reference.inverse(strokes, d.domain, points)
    np.testing.assert_allclose(on_host(found.points), wanted, atol=1e-7)
    assert on_host(found.residual).max() < 1e-8
    assert on_host(found.converged).all()
    assert found.converged.shape == points.shape[:-1]
    assert (on_host(found.steps) > 0).all()
    single = points[0, 0].astype(np.float32)
    moved = reference.forward(strokes, d.domain, single)
    np.testing.assert_allclose(on_host(d.forward(sent(single))), moved, atol=1e-9)
    made = on_host(d.inverse_map(like=there, tolerance=1e-3))
    assert made.shape == (*shape, len(shape))
    assert made.dtype == np.float32
    assert np.linalg.norm(made - sources(d), axis=-1).max() < 1e-3


def test_the_certificate_holds() -> None:
    """Good cells and solved ones, and the error of both is what is told of them."""
    d = (
        supple.Deformation((22, 40), border=9, on_fold="damp")
        .grab((12, 11), by=(4, 3), radius=14, reach=None)
        .grab((33, 14), by=(2, 1), radius=6, reach=None)
    )
    exact = sources(d)
    for tolerance in (0.1, 1e-2):
        warping = supple.cuda.start(sent(np.zeros(d.shape, np.float32)), d, filter="linear", tolerance=tolerance)
        assert warping.error <= tolerance
        made = on_host(d.inverse_map(like=warping.array, tolerance=tolerance))
        assert np.linalg.norm(made - exact, axis=-1).max() <= warping.error + 2e-5
    far = supple.Deformation((9, 9), border=None, on_fold="damp").grab((4, 4), by=(1e9, 0), radius=1e9, reach=None)
    with pytest.warns(ToleranceWarning, match="more than the tolerance 1e-09"):
        far.warp(sent(np.zeros((9, 9), np.float32)), tolerance=1e-9)


def test_what_cannot_be_done_is_said() -> None:
    d = bent((9, 12))
    source = sent(np.zeros((9, 12), np.float32))
    for given, options, words in (
        (
            sent(np.zeros((9, 11), np.float32)),
            {},
            r"source must be .* \(9, 12\).*found shape \(9, 11\)",
        ),
        (sent(np.zeros((9, 12), np.complex64)), {}, "found dtype complex64"),
        (source, {"filter": "lanczos"}, "filter must be .*cubic.* found 'lanczos'"),
        (source, {"device": "gpu"}, 'device must be "cpu", "cuda" .* or "auto", found'),
        (source, {"out": np.zeros((9, 12), np.float32)}, "out must be an array on the source's GPU"),
        (source, {"out": sent(np.zeros((9, 12)))}, "out must be .*found float64"),
        (source, {"out": source}, "out must not overlap source"),
        (source, {"fill": (1, 2)}, "fill must be"),
        (source, {"alpha": True}, "alpha=True needs a last channel"),
    ):
        with pytest.raises(SuppleError, match=words):
            d.warp(given, **options)
    with pytest.raises(SuppleError, match=r"points must be .*x first"):
        d.forward(sent(np.zeros((4, 3))))
    with pytest.raises(SuppleError, match="float32 or float64"):
        d.inverse(sent(np.zeros((4, 2), np.int32)))
    with pytest.raises(SuppleError, match="like must be an array on a "):
        d.inverse_map(like=np.zeros(3))
    with pytest.raises(SuppleError, match="one for each of the 3 items"):
        supple.warp_batch(sent(np.zeros((3, 9, 12), np.float32)), [d, d])
    with pytest.raises(SuppleError, match="slab must be"):
        supple.cuda.start(source, d, slab=0)
    with pytest.raises(SuppleError, match="stream must be a stream of PyTorch, CuPy or Numba"):
        supple.cuda.start(source, d, stream="x")
    with pytest.raises(SuppleError, match="source must be an array on a GPU"):
        supple.cuda.start(np.zeros((9, 12), np.float32), d)
    assert (on_host(source) == 0).all()


@pytest.mark.parametrize(("radius", "size"), [(40.0, 8), (130.0, 16), (300.0, 32)])
@pytest.mark.parametrize("shape", [(70, 99), (11, 40, 45)])
def test_cells_are_as_large_as_strokes_allow(shape: tuple[int, ...], radius: float, size: int) -> None:
    d = supple.Deformation(shape, border=None, on_fold="damp")
    d = d.grab(np.array(shape[::-1]) / 3, by=[0.1 * radius] * len(shape), radius=radius, reach=None)
    assert warp.sizes_of((d.space,), d.space.axes[None], 0.01)[:2] == (size, size)
    assert warp.sizes_of((d.space,), d.space.axes[None], 1e-5)[:2] == (8, 8)
    warp._lattices.clear()  # of other tests
    warping = supple.cuda.start(sent(np.zeros(shape, np.float32)), d, filter="linear")
    assert 0 < warping.error <= 0.01
    (lattice,) = warp._lattices.values()
    assert lattice.nodes == tuple(-(-(n - 1) // size) + 1 for n in shape[:-3:-1])
    made = on_host(d.inverse_map(like=warping.array))
    apart = np.linalg.norm(made - d.inverse_map(tolerance=TIGHT), axis=-1)
    assert apart.max() <= warping.error + TIGHT + 3e-5
    for source in (waves(shape, 2).astype(np.float32), typed(waves(shape), "u1")):
        for name in ("linear", "auto"):
            made = on_host(d.warp(sent(source), filter=name))
            wanted = d.warp(source, filter=name, tolerance=TIGHT)
            off = np.abs(made.astype(np.float64) - wanted).max()
            assert off <= 0.01 * range_of(source) + (source.dtype.kind == "u")


def test_negative_strides_may_come_as_unsigned_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    given = sent(np.arange(60, dtype=np.float32).reshape(6, 10))
    viewed = arrays._viewed

    def unsigned(*given: Any) -> Any:
        view = viewed(*given)
        strides = tuple(s * view.dtype.itemsize % 2**64 // view.dtype.itemsize for s in view.strides)
        return SimpleNamespace(shape=view.shape, strides=strides, dtype=view.dtype, ptr=view.ptr, readonly=False,
                               device_id=view.device_id)  # fmt: skip

    monkeypatch.setattr(arrays, "_viewed", unsigned)
    turned = arrays.taken(given[::-1, ::-2], "source")
    assert turned.strides == (-10, -2)
    first, end = turned._bounds()
    assert end - first == 4 * (50 + 8 + 1)


def test_cells_are_smaller_beside_a_border() -> None:
    """In the border and as far beyond as a stroke moves its end; a batch with several borders has small ones only."""
    one, other = (
        supple.Deformation((400, 400), border=float(b)).grab((200, 200), by=(40, 20), radius=110) for b in (40, 50)
    )
    axes = np.stack([one.space.axes, other.space.axes])
    assert warp.sizes_of((one.space,), axes[:1], 0.01)[:2] == (8, 16)
    assert warp.sizes_of((one.space, other.space), axes, 0.01)[:2] == (8, 8)
    xs = warp.positions(0, 400, axes[0, 0], 8, 16, 20)
    assert {0, 40, 60, 340, 360, 399} <= set(xs.tolist())
    apart = np.diff(xs)
    assert (apart[(xs[:-1] < 60) | (xs[:-1] >= 340)].max(), apart.max()) == (8, 16)
    assert (np.diff(warp.positions(0, 400, axes[0, 0], 8, 16, np.inf)) <= 8).all()


@pytest.mark.parametrize("slab", [1, 2, 5])
def test_no_bit_depends_on_slabs(slab: int) -> None:
    d = bent((21, 12, 14), seed=2)
    source = np.random.default_rng(3).random((21, 12, 14)).astype(np.float32)
    whole = on_host(d.warp(sent(source), filter="linear"))
    warping = supple.cuda.start(sent(source), d, filter="linear", slab=slab)
    np.testing.assert_array_equal(on_host(warping.wait()), whole)


def test_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """What large arrays take, on small ones."""
    monkeypatch.setattr(warp, "SCRATCH", 1)
    d = gentle(STACK)
    source = waves(STACK, 2).astype(np.float32)
    made = on_host(d.warp(sent(source), filter="linear", tolerance=TIGHT))
    close(made, expected(d, source, filter="linear"), source)
    several = [bent((7, 9), seed=k, count=k) for k in range(3)]
    images = np.stack([waves((7, 9))] * 3).astype(np.float32)
    made = on_host(supple.warp_batch(sent(images), several, filter="cubic", tolerance=TIGHT))
    for one, image, found in zip(several, images, made, strict=True):
        close(found, expected(one, image, filter="cubic"), images)
