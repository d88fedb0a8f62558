"""What is sampled: every type, filter, boundary mode and kind of colour, against slow float64; regions; bits kept."""

from __future__ import annotations

import contextlib
import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple import Deformation, SuppleError, _core
from supple.engine.core import plan_of, samplings_of
from supple.engine.sampling import Sampling
from supple.engine.work import Group, Layout, Work
from tests import reference
from tests.core.drawn import deformations, plan, sampling
from tests.effort import EVERY, examples

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Array = npt.NDArray[Any]

SHAPE, CLIP = (36, 45), (6, 24, 30)
DTYPES = ["bool", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"]
FILTERS = ["nearest", "linear", "cubic", "auto"]
RULES = ["edge", "constant", "reflect"]


@functools.cache
def bent(kind: str) -> Deformation:
    """Shrinks and enlarges; what "strong" does asks for the pyramid, "local" leaves a part alone."""
    d = Deformation(SHAPE, border=None if kind != "local" else 10, on_fold="damp")
    if kind == "gentle":
        return d.grab((22, 18), by=(5, 6), radius=12, reach=None).grab(
            (8, 30), by=(-4, 3), radius=7, scales=2, reach=None
        )
    if kind == "strong":
        return Deformation(SHAPE, border=None, on_fold="flow").grab((15, 18), by=(22, 3), radius=4, reach=None)
    return d.grab((24, 17), by=(2.5, 3), radius=4, reach=2.5)


@functools.cache
def clip(kind: str) -> Deformation:
    if kind == "hurried":
        return Deformation(CLIP, border=None, on_fold="flow").grab((14, 12, 1), by=(4, -3, 4), radius=8, reach=None)
    if kind == "bent":
        return Deformation(CLIP, border=None, on_fold="damp").grab((14, 12, 3), by=(5, -4, 1.5), radius=9, reach=None)
    return Deformation(CLIP, border=6.0, on_fold="damp").grab((15, 12, 3), by=(2, -1, 0.6), radius=3, reach=2.0)


def noise(dtype: str, shape: tuple[int, ...], seed: int = 0) -> Array:
    rng, kind = np.random.default_rng(seed), np.dtype(dtype)
    if kind == np.bool_:
        return rng.random(shape) < 0.5
    if kind.kind == "f":
        return rng.random(shape).astype(kind)
    limits = np.iinfo(kind)
    return rng.integers(limits.min, limits.max, shape, kind.newbyteorder("="), endpoint=True).astype(kind)


def close(found: Array, expected: Array, *, most: float = 3e-3, mean: float = 5e-5, odd: float = 0.0) -> None:
    """Compare in parts of a type's range; a part may be odd, such as what is nearest where two are as near."""
    assert found.dtype == expected.dtype
    assert found.shape == expected.shape
    kind = found.dtype
    top = float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0
    off = np.abs(found.astype(np.float64) - expected.astype(np.float64)) / top
    rounding = 1.001 / top if kind.kind in "iu" and top < 1e6 else 2e-3 if kind == np.float16 else 0.0
    if kind == np.bool_:
        assert off.mean() <= 2e-3
        return
    off = np.maximum(off - rounding, 0)
    assert (off > most).mean() <= odd, f"{(off > most).sum()} of {off.size} are off, by up to {off.max()}"
    assert np.mean(np.minimum(off, most)) <= mean


@pytest.mark.filterwarnings("ignore::supple.errors.ToleranceWarning")  # float32 may not hold as much near a fold
@examples(30)
@given(
    deformations(2, 36, 2),
    st.sampled_from(["u1", "u2", "f4", "f8"]),
    st.integers(1, 5),
    st.sampled_from(FILTERS),
    st.sampled_from(RULES),
)
def test_any_strokes_and_shapes(d: Deformation, dtype: str, channels: int, filter: str, outside: str) -> None:
    """Of smooth pictures: what is near fold limits is too steep for noise to be told apart."""
    y, x = np.indices(d.shape)
    wave = 0.5 + 0.4 * np.sin(x / 5 + 1)[..., None] * np.cos(y / 4 + np.arange(channels)[:, None, None]).transpose(
        1, 2, 0
    )
    source = (wave * reference.opaque(dtype)).astype(dtype)
    found = d.warp(source, filter=filter, outside=outside, alpha=False, tolerance=1e-4)
    expected = reference.warp(source, reference.carried_out(d), d.domain, filter=filter, outside=outside, alpha=False)
    # At an edge, or halfway between two samples, a pixel may be either; of a small picture, one is a large part.
    doubtful = filter == "nearest" or outside == "constant"
    odd = max(0.02, 1 / (d.shape[0] * d.shape[1])) if doubtful else 0.005
    close(found, expected, most=5e-3, mean=1e-3 + 5e-3 * odd, odd=odd)


def test_types_of_what_a_sampling_is_given_are_checked() -> None:
    source, out = np.zeros((1, 9, 9, 3), np.uint8), np.zeros((9, 9, 3), np.uint8)
    with pytest.raises(TypeError):
        sampling(source.astype(np.float16), out.astype(np.float16))
    frozen = out.copy()
    frozen.flags.writeable = False
    with pytest.raises((TypeError, ValueError)):
        sampling(source, frozen)


# ---------------------------------------------------------------- regions


def boxes(shape: tuple[int, int], seed: int, count: int = 6) -> list[tuple[int, int, int, int]]:
    rng, (height, width) = np.random.default_rng(seed), shape
    made = [
        (0, width, 0, height),
        (0, 1, 0, 1),
        (width - 1, width, height - 1, height),
        (0, width, height // 2, height // 2 + 1),
    ]
    for _ in range(count):
        x, y = sorted(rng.integers(0, width + 1, 2).tolist()), sorted(rng.integers(0, height + 1, 2).tolist())
        made.append((x[0], x[1], y[0], y[1]))
    return made


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize(("dtype", "channels", "how"), [
    ("u1", 3, {}), ("u1", 4, {"alpha": True}), ("f4", 1, {}), ("f8", 3, {}), ("u2", 3, {"light": True}), ("f4", 6, {}),
])  # fmt: skip
def test_a_box_is_a_crop(filter: str, dtype: str, channels: int, how: dict[str, Any]) -> None:
    """Bit for bit, of images and of frames; the rest stays as it was."""
    d = Deformation((70, 90), border=None, on_fold="flow").grab((30, 35), by=(35, 4), radius=8, reach=None)
    d = d.grab((70, 50), by=(4, -3), radius=6, reach=2.0)
    deep = Deformation((5, 50, 70), border=None, on_fold="damp").grab((30, 25, 2), by=(9, -4, 1), radius=11, reach=None)
    for p, source in (
        (plan(d), noise(dtype, (1, 70, 90, channels))),
        (plan(deep, z=2.0), noise(dtype, (5, 50, 70, channels))),
    ):
        whole = np.empty(source.shape[1:], source.dtype)
        p.sample(sampling(source, whole, filter=filter, **how))
        for x0, x1, y0, y1 in boxes(source.shape[1:3], len(source)):
            before = noise(dtype, source.shape[1:], 9)
            part = before.copy()
            p.sample(sampling(source, part, filter=filter, **how), (x0, x1, y0, y1))
            expected = before.copy()
            expected[y0:y1, x0:x1] = whole[y0:y1, x0:x1]
            assert part.tobytes() == expected.tobytes()


@pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.OutsideWarning")
@pytest.mark.parametrize("pulls", [False, True])
def test_parts_of_long_drags_are_parts(pulls: bool) -> None:
    """Strokes of many steps, which the neighbours of a part's pixels may need, and the part not."""
    for seed in range(-(-12 // EVERY)):
        rng, d = np.random.default_rng(seed), Deformation((160, 160), border=None)
        for _ in range(1 if pulls else 3):
            n, radius, reach = 4 if pulls else 1, float(rng.uniform(8, 30)), float(rng.choice([1, 2, 4]))
            points, drags = rng.uniform(20, 140, (n, 2)), rng.normal(size=(n, 2)) * (8 if pulls else 40)
            with contextlib.suppress(SuppleError):
                d = d.pull(points, by=drags, radius=radius, reach=reach)
        source = rng.random(d.shape).astype(np.float32)
        whole = d.warp(source)
        for x, y, w, h in rng.integers((0, 0, 20, 20), (100, 100, 60, 60), (6, 4)).tolist():
            np.testing.assert_array_equal(d.warp(source, grid=d.grid.crop((x, y), (w, h))), whole[y : y + h, x : x + w])


def test_boxes_of_chroma_are_crops() -> None:
    d = Deformation((71, 93), border=None, on_fold="damp").grab((40, 30), by=(12, -7), radius=14, reach=None)
    p = plan_of(d.space, 0, 0.01, (2, 2))
    source = noise("u1", (1, 36, 47, 2))
    how: dict[str, Any] = {"step": (2, 2), "offset": (0.0, 0.5)}
    whole = np.empty((36, 47, 2), np.uint8)
    p.sample(sampling(source, whole, **how))
    for x0, x1, y0, y1 in boxes((36, 47), 3, 20):
        part = np.zeros_like(whole)
        p.sample(sampling(source, part, **how), (x0, x1, y0, y1))
        np.testing.assert_array_equal(part[y0:y1, x0:x1], whole[y0:y1, x0:x1])


@pytest.mark.parametrize("filter", FILTERS)
def test_threads_leave_no_trace(filter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    d = Deformation((150, 200), border=20, on_fold="damp").grab((100, 70), by=(40, 30), radius=30, reach=None)
    d = d.grab((40, 40), by=(9, 3), radius=9, reach=2.0)
    source, deep = noise("u1", (150, 200, 3)), noise("f4", (*CLIP, 2))
    made = []
    for n in ("2", "7", "1", "3"):  # more and fewer than before
        monkeypatch.setenv("SUPPLE_THREADS", n)
        assert _core.threads() == int(n)
        how: dict[str, Any] = {"filter": filter}
        made.append(
            (
                d.warp(source, **how).tobytes(),
                d.warp(source.astype(np.float64), **how).tobytes(),
                clip("hurried").warp(deep, time_filter=True, **how).tobytes(),
            )
        )
    assert all(one == made[0] for one in made)


@pytest.mark.parametrize("filter", FILTERS)
def test_planes_one_at_a_time_are_the_stack(filter: str) -> None:
    for kind in ("bent", "hurried", "local"):
        d = clip(kind)
        source = noise("u2", (*CLIP, 3))
        between = "nearest" if filter == "nearest" else "cubic"
        stack = np.empty_like(source)
        how: dict[str, Any] = {"filter": filter, "between": between, "average": between == "cubic"}
        job = sampling(source, stack, **how)
        error, evaluations, *bad = _core.warp_stack(d.space.map, *CLIP[1:], list(range(CLIP[0])), 0.01, [job])
        plans = [plan(d, z=float(z)) for z in range(CLIP[0])]
        for z, p in enumerate(plans):
            alone = np.empty(source.shape[1:], np.uint16)
            p.sample(sampling(source, alone, **how))
            assert alone.tobytes() == stack[z].tobytes()
        assert error == max(p.checks[0] for p in plans)
        assert evaluations == sum(p.checks[1] for p in plans)
        assert not any(bad)
        some = np.empty_like(source[:2])
        job = sampling(source, some, **how)
        _core.warp_stack(d.space.map, *CLIP[1:], [4, 1], 0.01, [job])
        np.testing.assert_array_equal(some, stack[[4, 1]])


# ---------------------------------------------------------------- bits


def strange(dtype: str, shape: tuple[int, ...]) -> Array:
    """Return any bits at all: NaNs of every payload, infinities, zeros of both signs."""
    kind = np.dtype(dtype)
    raw = np.random.default_rng(2).integers(0, 256, int(np.prod(shape)) * kind.itemsize, np.uint8)
    made = (raw & 1 if kind == np.bool_ else raw).view(kind).reshape(shape)
    if kind.kind == "f":
        made[..., ::5] = np.array(["nan", "-inf", "inf", "-0.0"], kind)[
            np.random.default_rng(3).integers(0, 4, made[..., ::5].shape)
        ]
    return made


@functools.cache
def beyond_reach() -> list[tuple[Deformation, npt.NDArray[np.bool_]]]:
    """Return strokes that end, and which samples none of them reaches."""
    small = Deformation(SHAPE, border=None, on_fold="damp").grab((3, 33), by=(1, 1), radius=2, reach=3.0)
    local = (bent("local"), clip("local"), small)
    return [(d, ~reference.reached(d.strokes, d.domain, reference.grid(d.shape))) for d in local]


@pytest.mark.parametrize("dtype", [*DTYPES, ">u2", ">f4"])
@pytest.mark.parametrize("filter", FILTERS)
def test_what_no_stroke_reaches_keeps_every_bit(dtype: str, filter: str) -> None:
    for d, away in beyond_reach():
        assert 0.1 < away.mean() < 0.99
        for channels, alpha in ((1, False), (3, False), (4, True), (6, False)):
            source = strange(dtype, (*d.shape, channels))
            lights = [False, True] if dtype in ("u1", "u2", "f4", "f8") else [False]
            for light in lights:
                with np.errstate(all="ignore"):
                    out = d.warp(source, filter=filter, alpha=alpha, linear_light=light)
                assert out[away].tobytes() == source[away].tobytes()
                inside = out[~away].tobytes() != source[~away].tobytes()
                assert inside


def test_reach_keeps_bits_of_chroma() -> None:
    d = Deformation((61, 83), border=64, on_fold="damp").grab((40, 30), by=(3, -2), radius=5, reach=3.0)
    source = strange("f4", (1, 31, 42, 2))
    out = np.empty(source.shape[1:], np.float32)
    plan_of(d.space, 0, 0.01, (2, 2)).sample(sampling(source, out, step=(2, 2), offset=(0.0, 0.5)))
    q = reference.grid((31, 42)) * 2 + (0.0, 0.5)
    away = np.linalg.norm(q - (40, 30), axis=-1) >= 15
    assert out[away].tobytes() == source[0][away].tobytes()
    assert out[~away].tobytes() != source[0][~away].tobytes()


@pytest.mark.parametrize(("channels", "side", "name"), [(1, 46400, "auto"), (2, 32900, "auto"), (3, 26800, "cubic")])
def test_frames_of_more_samples_than_32_bits_count(channels: int, side: int, name: str) -> None:
    """A corner is as that of a small frame; memory is taken for the corner alone."""
    small, seen = 200, 120
    corner = np.random.default_rng(1).integers(0, 256, (small, small, channels), np.uint8)

    def warped(side: int) -> npt.NDArray[np.int_]:
        free = Deformation((side, side), border=None)
        space = free.grab((side - 40,) * 2, by=(5.3, 4.2), radius=8, reach=3).space
        frames, out = np.zeros((1, side, side, channels), np.uint8), np.zeros((side, side, channels), np.uint8)
        frames[0, -small:, -small:] = corner
        layout = Layout((Group((side, side), channels),), np.dtype("u1"), 255.0)
        (job,) = samplings_of(Work(space, layout, Sampling(filter=name)), [frames], [out], 1)
        plan_of(space, 0, 1e-3).sample(job, (side - seen, side, side - seen, side))
        return out[-seen:, -seen:].astype(int)

    great, found = warped(small), warped(side)
    assert (great != corner[-seen:, -seen:]).mean() > 0.05
    assert abs(found - great).max() <= 1
