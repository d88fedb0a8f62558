"""Blocks of an output: equal to the whole, bit for bit, and made of the part of the source that they say they read."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple.blocks import Block, Box, Warp, boxes_of
from supple.deformation import Deformation
from supple.engine.sampling import Certificate, Sampling
from supple.errors import SuppleError
from supple.space.geometry import Grid
from tests.effort import examples
from tests.fields import drawn

Array = npt.NDArray[Any]
TYPES = ["?", "u1", "u2", "i2", "i4", "f2", "f4", "f8", ">f4"]
SEEDS = st.integers(0, 2**32 - 1)


def slices(box: Box) -> tuple[slice, ...]:
    return tuple(slice(*each) for each in box)


def divided(size: int, step: int) -> tuple[int, ...]:
    """The sizes of blocks along an axis, the last of which is what is left."""
    return tuple(min(step, size - start) for start in range(0, size, step))


def strokes_on(shape: tuple[int, ...], rng: np.random.Generator, reach: float | None, border: Any) -> Deformation:
    """One to three strokes; some flow, so that they are more."""
    made = Deformation(shape, border=border)
    for _ in range(rng.integers(1, 4)):
        at = rng.uniform(0.15, 0.85, len(shape)) * shape[::-1]
        by = rng.normal(size=len(shape)) * rng.choice([0.02, 0.3, 4.0, 12.0])
        try:
            made = made.grab(tuple(at), by=tuple(by), radius=rng.uniform(6, 25), reach=reach)
        except SuppleError:  # the border holds it back
            continue
    return made


def samples(shape: tuple[int, ...], dtype: str, rng: np.random.Generator) -> Array:
    made = rng.random(shape) * 200
    return made > 100 if dtype == "?" else made.astype(dtype)


def in_blocks(warp: Warp, source: Array, steps: list[int]) -> tuple[Array, list[Block], Certificate]:
    """Warp an array block by block."""
    tail = source.shape[warp.deformation.ndim :]
    made = np.empty((*warp.shape, *tail), source.dtype)
    boxes = list(boxes_of([divided(size, step) for size, step in zip(warp.shape, steps, strict=True)]))
    blocks, certificate = warp.plan(boxes)
    for block in blocks:
        made[slices(block.box)] = warp.block(source[slices(block.part)][None], block)[0]
    return made, blocks, certificate


def whole(warp: Warp, source: Array, grid: Grid | None = None) -> Array:
    """What `Deformation.warp` makes of it, on the warp's own grid or another."""
    with warnings.catch_warnings(action="ignore"):
        return warp.deformation.warp(
            source, sampling=warp.sampling, alpha=warp.alpha, grid=warp.grid if grid is None else grid
        )


def assert_equal(made: Array, expected: Array) -> None:
    assert (made.shape, made.dtype) == (expected.shape, expected.dtype)
    assert made.tobytes() == expected.tobytes()


@st.composite
def samplings(draw: st.DrawFn, ndim: int) -> Sampling:
    way = draw(st.sampled_from(["auto", "auto", "cubic", "linear", "nearest"]))
    outside = draw(st.sampled_from(["edge", "constant", "reflect"]))
    more: dict[str, Any] = {"filter": way, "outside": outside, "fill": 7.0 if outside == "constant" else 0.0}
    if ndim == 3 and way != "nearest":
        more |= {"between": draw(st.sampled_from(["nearest", "linear", "cubic"])), "time_filter": draw(st.booleans())}
    return Sampling(**more)


@st.composite
def cases(draw: st.DrawFn) -> tuple[Warp, Array, list[int]]:
    rng = np.random.default_rng(draw(SEEDS))
    ndim = draw(st.sampled_from([2, 3]))
    # Patches of the lattice are in planes alone: few of these will do.
    shape = tuple(rng.integers((14, 24, 24), (40, 75, 75)).tolist() if ndim == 3 else rng.integers(60, 280, 2).tolist())
    d = strokes_on(shape, rng, draw(st.sampled_from([None, 2.5, 4.0])), draw(st.sampled_from([None, "auto"])))
    for kind in draw(st.lists(st.sampled_from(["field", "inverse", "affine"]), max_size=2, unique=True)):
        if kind == "affine":
            matrix = np.eye(ndim, ndim + 1) + rng.normal(size=(ndim, ndim + 1)) * 0.03
            d = d.affine(matrix)
        else:
            coarse = Grid([size // 8 + 4 for size in shape], 8.0, (-8.0,) * ndim)
            d = d.field(drawn(rng, coarse, 0.4, interpolation="cubic", beyond="edge"), inverse=kind == "inverse")
    scale = draw(st.sampled_from([None, None, 0.7, 1.6, 3.0]))
    grid = None if scale is None else d.grid.resampled(scale)
    if draw(st.integers(0, 3)) == 0:  # a part of the one or the other
        grid = (grid or d.grid).crop((3,) * ndim, [size - 5 for size in (grid or d.grid).sizes])
    channels = draw(st.sampled_from([0, 0, 1, 3, 4]))
    source = samples((*shape, *([channels] if channels else [])), draw(st.sampled_from(TYPES)), rng)
    steps = rng.integers((6, 11, 11)[-ndim:], (40, 70, 70)[-ndim:]).tolist()
    return Warp(d, draw(samplings(ndim)), grid), source, steps


@given(cases())
@examples(20)
def test_blocks_are_the_whole_bit_for_bit(case: tuple[Warp, Array, list[int]]) -> None:
    warp, source, steps = case
    made, blocks, _ = in_blocks(warp, source, steps)
    expected = whole(warp, source)
    assert_equal(made, expected)
    # And so is any part of the grid, as `Deformation.warp` makes it.
    block = blocks[len(blocks) // 2]
    first, sizes = [a for a, _ in block.box[::-1]], list(block.shape[::-1])
    part = (warp.deformation.grid if warp.grid is None else warp.grid).crop(first, sizes)
    assert_equal(whole(warp, source, part), expected[slices(block.box)])


@given(cases())
@examples(10)
def test_nothing_but_the_part_is_read(case: tuple[Warp, Array, list[int]]) -> None:
    """As `Deformation.warp` makes a block from a whole source whose samples beyond the part are all wrong."""
    warp, source, steps = case
    wrong = np.nan if source.dtype.kind == "f" else True if source.dtype.kind == "b" else np.iinfo(source.dtype).max
    made, blocks, _ = in_blocks(warp, source, steps)
    grid = warp.deformation.grid if warp.grid is None else warp.grid
    for block in blocks[:: 1 + len(blocks) // 4]:
        assert all(0 <= a < b <= n for (a, b), n in zip(block.part, source.shape, strict=False))
        poisoned = np.full_like(source, wrong)
        poisoned[slices(block.part)] = source[slices(block.part)]
        part = grid.crop([a for a, _ in block.box[::-1]], list(block.shape[::-1]))
        assert_equal(whole(warp, poisoned, part), made[slices(block.box)])


@pytest.mark.parametrize("first", [64, 66])
def test_a_part_without_the_first_patch_is_that_of_the_whole(first: int) -> None:
    """Two strokes with a reach, of which one does not reach the last patch, of columns 64 to 69."""
    d = Deformation((47, 52, 70), border=None).grab(
        (20.14, 26.19, 13.64), by=(0.32, 0.42, 0.06), radius=24.8, reach=2.5
    )
    d = d.grab((34.74, 25.56, 13.02), by=(-0.585, -0.0757, -0.018), radius=7.48, reach=2.5)
    source = np.broadcast_to(np.arange(70.0), d.shape).copy()
    expected = d.warp(source, filter="linear")
    part = d.grid.crop((first, 0, 0), (70 - first, 52, 47))
    assert_equal(d.warp(source, filter="linear", grid=part), expected[..., first:])


@pytest.mark.parametrize("options", [{"alpha": True}, {"linear_light": True}, {"fill": (1, 2, 3, 255)}])
def test_colours_and_opacity(options: dict[str, Any]) -> None:
    rng = np.random.default_rng(3)
    d = strokes_on((90, 120), rng, None, None).affine([[1, 0.1, -9], [0, 1, 4]])
    source = rng.integers(0, 256, (90, 120, 4), np.uint8)
    alpha = options.pop("alpha", None)
    warp = Warp(d, Sampling(outside="constant", **options), alpha=alpha)
    assert_equal(in_blocks(warp, source, [33, 50])[0], whole(warp, source))


def test_blocks_beyond_the_reach_are_copies_of_themselves() -> None:
    d = Deformation((64, 128, 192)).grab((30, 30, 30), by=(4, 0, 2), radius=8, reach=2.5)
    warp = Warp(d, Sampling())
    blocks, _ = warp.plan(list(boxes_of([(32, 32), (64, 64), (64, 64, 64)])))
    reached = [block for block in blocks if not block.identity]
    assert [block.box for block in reached] == [((a, a + 32), (0, 64), (0, 64)) for a in (0, 32)]
    for block in blocks:
        if block.identity:
            assert block.part == block.box
            part = np.random.default_rng(0).integers(0, 9, (1, *block.shape))
            assert_equal(warp.block(part, block), part)
    # Of a part of the grid, they are copies of the same part of the source.
    (far,), _ = Warp(d, Sampling(), d.grid.crop((100, 70, 10), (20, 30, 40))).plan([((0, 40), (5, 30), (3, 20))])
    assert far.identity
    assert far.part == ((10, 50), (75, 100), (103, 120))


@pytest.mark.parametrize("by", [0.01, 0.02, 0.03, 0.05, 0.2])
def test_planes_of_a_part_of_the_grid_are_copied_where_the_whole_planes_are(by: float) -> None:
    """Far from a small stroke without a reach, all moves by less than the tolerance: what is near it decides."""
    d = Deformation((40, 64, 200), border=None).grab((20, 32, 20), by=(by, 0, 0), radius=8, reach=None)
    source = np.random.default_rng(8).random(d.shape, np.float32)
    expected = d.warp(source)
    assert_equal(in_blocks(Warp(d, Sampling()), source, [40, 64, 128])[0], expected)
    part = d.grid.crop((128, 10, 3), (72, 50, 30))
    made, blocks, _ = in_blocks(Warp(d, Sampling(), part), source, [30, 50, 40])
    assert_equal(made, expected[3:33, 10:60, 128:])
    assert any(blocks[0].copied) == (by <= 0.02)


@pytest.mark.parametrize("filter", ["auto", "linear"])
@pytest.mark.parametrize("n", [2, 3])
def test_a_part_is_hardly_larger_than_the_block(n: int, filter: str) -> None:
    """Of blocks at multiples of 64, at which patches of the lattice begin; those of others read the rest of a patch."""
    shift, shape = 3.0, (256,) * n
    d = Deformation(shape, border=None).affine(np.c_[np.eye(n), np.full(n, shift)])
    warp = Warp(d, Sampling(filter=filter, tolerance=0.01))
    box = ((64, 128),) * n
    part, moved, certificate = warp.reads(box)
    assert certificate.error <= 0.01
    assert max(moved) == pytest.approx(shift, rel=1e-3)  # along the axis that moves most
    margin = 6 if filter == "linear" else 8
    for axis, (start, stop) in enumerate(part):
        least, most = (64 + shift, 128 + shift)
        assert least - margin <= start <= least
        assert most <= stop <= most + margin
        if n == 3 and axis == 0:  # slices are counted one by one
            assert 65 <= start <= 67
            assert 131 <= stop <= 133


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["first", "last"])
def test_the_core_refuses_a_part_that_is_too_small(axis: int, side: str) -> None:
    d = Deformation((64, 64, 64), border=None).grab((32, 32, 32), by=(5, 3, 2), radius=14)
    warp = Warp(d, Sampling())
    (block,), _ = warp.plan([((20, 44), (20, 44), (20, 44))])
    source = np.random.default_rng(5).random((64, 64, 64), np.float32)
    expected = warp.block(source[slices(block.part)][None], block)
    part = list(block.part)
    # In the plane, patches are read in steps; a slice less is a slice too few.
    start, stop = part[axis]
    part[axis] = (start + 1, stop) if side == "first" else (start, stop - 1)
    less = Block(block.box, tuple(part), block.copied, block.identity)
    with pytest.raises(ValueError, match="lie beyond the part of the frames that is held"):
        warp.block(source[slices(less.part)][None], less)
    # More than is read changes nothing.
    part[axis] = (max(0, start - 3), min(64, stop + 3))
    more = Block(block.box, tuple(part), block.copied, block.identity)
    assert_equal(warp.block(source[slices(more.part)][None], more), expected)


def test_where_nothing_is_seen_but_the_fill_value() -> None:
    d = Deformation((40, 50), border=None).affine([[1, 0, 500], [0, 1, 0]])
    warp = Warp(d, Sampling(outside="constant", fill=3))
    source = np.ones((40, 50), np.int16)
    made, blocks, _ = in_blocks(warp, source, [16, 16])
    assert_equal(made, np.full((40, 50), 3, np.int16))
    assert max(np.prod([b - a for a, b in block.part]) for block in blocks) <= 40 * 50


def test_the_certificate_is_that_of_all_blocks() -> None:
    rng = np.random.default_rng(6)
    d = Deformation((120, 90), border=None).field(drawn(rng, Grid((15, 12), 8.0), 0.4), inverse=True)
    warp = Warp(d, Sampling())
    boxes = list(boxes_of([(50, 50, 20), (64, 26)]))
    _, together = warp.plan(boxes)
    assert together.error == max(warp.reads(box)[2].error for box in boxes) <= 0.01
    assert together.outside == sum(warp.reads(box)[2].outside for box in boxes) > 0


def test_a_warp_and_its_blocks_can_be_sent() -> None:
    d = Deformation((30, 40)).grab((20, 15), by=(4, 1), radius=8)
    warp = Warp(d, Sampling(), d.grid.resampled(2.0))
    (block,), _ = warp.plan([((3, 12), (4, 18))])
    sent, taken = pickle.loads(pickle.dumps((warp, block)))
    assert taken == block
    source = np.random.default_rng(7).random((30, 40))
    part = source[slices(block.part)][None]
    assert_equal(sent.block(part, taken), warp.block(part, block))
    assert len(pickle.dumps(warp)) < 5000
    assert len(pickle.dumps(block)) < 1000


def test_a_field_is_prepared_once_for_all_blocks_and_is_not_sent_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[object] = []
    prepared = Deformation.space_on
    monkeypatch.setattr(
        Deformation,
        "space_on",
        lambda self, grid, *rest, **more: calls.append(grid) or prepared(self, grid, *rest, **more),
    )
    rng = np.random.default_rng(9)
    field = drawn(rng, Grid((12, 16), 8.0), 0.3, interpolation="cubic", beyond="edge")
    warp = Warp(Deformation((80, 100), border=None).field(field), Sampling())
    small = len(pickle.dumps(warp))
    source = rng.random((80, 100))
    made, _, _ = in_blocks(warp, source, [30, 40])
    assert len(calls) == 1
    assert len(pickle.dumps(warp)) == small
    assert_equal(made, whole(warp, source))
