"""Frames that stream: each read once and in order, and every plane in its own coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Stroke
from supple.engine.core import sample
from supple.engine.sampling import Sampling
from supple.engine.stream import make_plan
from supple.engine.work import Group, Layout, Work
from tests import effort, reference
from tests.engine.streams import COUNT, LAYOUTS, PLAIN, SHAPE, Array, bent, layout_of, noise, streamed

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")
Floats = npt.NDArray[np.float64]
RULES = ["edge", "constant", "reflect"]
FINE = 1e-4


def source_points(d: Deformation, group: Group, planes: Sequence[int]) -> Floats:
    """Where the samples of some planes come from, in the numbers of their own grid."""
    q = reference.grid((len(planes), *group.shape))
    q[..., :2] = q[..., :2] * group.step + np.array(group.offset)
    q[..., 2] = np.asarray(planes)[:, None, None]
    found = d.inverse(q)
    assert found.converged.all()
    points = found.points.copy()
    points[..., :2] = (points[..., :2] - np.array(group.offset)) / np.array(group.step)
    return points


def same(found: Array, values: Floats, white: float, leeway: float = 2e-3) -> None:
    whole = found.dtype.kind in "iu"
    values = np.clip(values, 0, white) if whole else values
    off = np.abs(found.astype(np.float64) - values)
    assert off.max() <= leeway * white + (0.5 if whole else 0)


@pytest.mark.parametrize(
    ("kind", "rule", "name", "between", "border"),
    effort.pairs(list(LAYOUTS), RULES, ["linear", "cubic"], ["linear", "cubic"], [None, 50.0]),
)
def test_every_plane_is_bent_in_its_own_coordinates(
    kind: str, rule: str, name: str, between: str, border: float | None
) -> None:
    layout = LAYOUTS[kind]
    arrays = noise(layout)
    fill = tuple(
        (layout.white * x // 1 if layout.white > 1 else x)
        for x in (0.2, 0.5, 0.7)[: sum(g.channels for g in layout.groups)]
    )
    d = bent(border=border)
    sampling = Sampling(name, between=between, outside=rule, fill=fill, tolerance=FINE)
    found, plan, _ = streamed(d.space, layout, arrays, sampling)
    at = 0
    for group, source, out in zip(layout.groups, arrays, found, strict=True):
        colours = fill[at : at + group.channels]
        at += group.channels
        points = source_points(d, group, range(COUNT))[:, ::2, ::2]
        expected = reference.sample_frames(source, points, name, between, rule, colours)
        same(out[:, ::2, ::2], expected.astype(np.float64), layout.white)
        # What is still is passed on: for a plan's purposes, within the tolerance.
        for z in np.flatnonzero(plan.still):
            np.testing.assert_array_equal(out[z], source[z])


def test_opacity_is_a_group_s_own() -> None:
    layout = layout_of(alpha=True)
    arrays = noise(layout)
    arrays[0][..., 1] = np.maximum(arrays[0][..., 1], 30)
    d = bent()
    found, _, _ = streamed(d.space, layout, arrays, Sampling("linear", tolerance=FINE))
    points = source_points(d, layout.groups[0], range(COUNT))
    numbers = arrays[0].astype(np.float64)
    opacity = reference.sample_frames(numbers[..., 1:], points, "linear", "linear")
    weighed = reference.sample_frames(numbers[..., :1] * numbers[..., 1:], points, "linear", "linear")
    same(found[0][..., :1], weighed / opacity, 255, 1e-2)
    same(found[0][..., 1:], opacity, 255)
    plain = Layout((replace(layout.groups[0], channels=1, alpha=False), layout.groups[1]), layout.dtype, 255)
    without, _, _ = streamed(
        d.space, plain, [np.ascontiguousarray(arrays[0][..., :1]), arrays[1]], Sampling("linear", tolerance=FINE)
    )
    np.testing.assert_array_equal(found[1], without[1])


@pytest.mark.parametrize("rule", RULES)
def test_streams_and_arrays_are_one(rule: str) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    d = bent()
    for name in ("nearest", "linear", "auto"):
        for averaged in (False, True):
            between = "nearest" if name == "nearest" else "linear"
            sampling = Sampling(name, outside=rule, fill=50.0, between=between, time_filter=averaged)
            found, _, _ = streamed(d.space, layout, arrays, sampling)
            outs = [np.empty_like(a) for a in arrays]
            certificate = sample(Work(d.space, layout, sampling), arrays, outs)
            assert 0 < certificate.error <= 0.01
            for out, part in zip(outs, found, strict=True):
                np.testing.assert_array_equal(out, part)
            grey = Layout(layout.groups[:1], layout.dtype, 255)
            alone, _, _ = streamed(d.space, grey, arrays[:1], sampling)
            np.testing.assert_array_equal(
                alone[0],
                d.warp(arrays[0], filter=name, between=between, time_filter=averaged, outside=rule, fill=50.0),
            )


def exact_times(d: Deformation, layout: Layout, planes: Sequence[int]) -> tuple[Floats, Floats]:
    """The earliest and the latest time that any sample of each plane shows."""
    times = [source_points(d, group, planes)[..., 2].reshape(len(planes), -1) for group in layout.groups]
    together = np.concatenate(times, axis=1)
    return together.min(axis=1), together.max(axis=1)


def drawn(seed: int) -> Deformation:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 30)), int(rng.integers(2, 50)), int(rng.integers(2, 80)))
    d = Deformation(shape, border=[None, 50.0][seed % 2], on_fold="damp")
    size = np.array(shape[::-1]) - 1.0
    for _ in range(int(rng.integers(1, 4))):
        radius = float(np.exp(rng.uniform(math.log(2), math.log(30))))
        by = rng.normal(size=3) * radius * rng.uniform(0.1, 1.0)
        at = rng.uniform(-0.05, 1.05, 3) * size
        stroke = Stroke.grab(at, by=by, radius=radius, scales=int(rng.integers(1, 4)), reach=None)
        d = d.add(stroke, warn=False)
    return d


@pytest.mark.parametrize("seed", range(30))
def test_a_plan_holds_all_that_is_needed_and_little_more(seed: int) -> None:
    d = drawn(seed)
    count = d.shape[0]
    layout = layout_of(shape=(d.shape[1], d.shape[2]))
    rng = np.random.default_rng(seed)
    planes = sorted(set(rng.integers(0, count, count).tolist())) if seed % 3 == 0 else list(range(count))
    early, late = exact_times(d, layout, planes)
    rule = RULES[seed % 3]
    for between, support in (("linear", 1), ("cubic", 2)):
        sampling = Sampling("linear", between=between, outside=rule)
        plan = make_plan(Work(d.space, layout, sampling), planes)
        assert plan.planes == tuple(planes)
        for k, z in enumerate(planes):
            # Beyond a clip that goes on as its edge does, nothing else is seen.
            a, b = (float(t) if rule == "reflect" else min(max(t, -2.0), count + 1.0) for t in (early[k], late[k]))
            if plan.still[k]:
                assert abs(a - z) <= 0.02
                assert abs(b - z) <= 0.02
                assert (plan.first[k], plan.last[k]) == (z, z)
            else:
                assert plan.first[k] <= math.floor(a + 0.01) - support + 1
                assert plan.last[k] >= math.floor(b - 0.01) + support
                # Bounds are hulls of patches, which a steep map leaves wide.
                assert plan.first[k] >= math.floor(a - 0.5) - support - 4
                assert plan.last[k] <= math.floor(b + 0.5) + support + 5
            frames = np.arange(plan.first[k], plan.last[k] + 1)
            if rule == "reflect":
                frames = frames % (2 * count)
                frames = np.where(frames < count, frames, 2 * count - 1 - frames)
            frames = np.clip(frames, 0, count - 1)
            assert plan.keep[k] <= frames.min()
            assert plan.read[k] >= frames.max()
        assert (np.diff(plan.keep) >= 0).all()
        assert (np.diff(plan.read) >= 0).all()
        assert plan.keep.min() >= 0
        assert plan.read.max() < count
        assert plan.capacity == (plan.read - plan.keep).max() + 1


def test_lattices_are_solved_once_if_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    d, layout = bent(), layout_of()
    arrays = noise(layout)
    plan = make_plan(Work(d.space, layout, PLAIN), range(COUNT))
    assert sorted(plan.solved) == np.flatnonzero(~plan.still).tolist()
    sizes = [each.nbytes for each in plan.solved.values()]
    made, used, _ = streamed(d.space, layout, arrays)
    assert not used.solved
    monkeypatch.setattr("supple.engine.stream._KEPT", sum(sizes[:2]))
    assert list(make_plan(Work(d.space, layout, PLAIN), range(COUNT)).solved) == sorted(plan.solved)[:2]
    for one, other in zip(streamed(d.space, layout, arrays)[0], made, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_time_filter_needs_more_frames() -> None:
    """All that any sample of chroma or brightness is averaged over."""
    d = Deformation((60, 40, 70), border=None, on_fold="flow").grab((35, 20, 15), by=(4, 2, 28), radius=12, reach=None)
    layout = layout_of(shape=(40, 70))
    plain = make_plan(Work(d.space, layout, Sampling("linear")), range(60))
    plan = make_plan(Work(d.space, layout, Sampling("linear", time_filter=True)), range(60))
    assert (plan.first <= plain.first).all()
    assert (plan.last >= plain.last).all()
    for group in layout.groups:
        q = reference.grid((60, *group.shape))
        q[..., :2] = q[..., :2] * group.step + np.array(group.offset)
        points = d.inverse(q).points
        rows = np.linalg.inv(d.jacobian(points))[..., 2, :] * (*group.step, 1)
        widths = np.minimum(reference.faded(np.linalg.norm(rows, axis=-1)), 64)
        assert widths.max() > 3
        first = np.floor(points[..., 2] - widths / 2).reshape(60, -1).min(axis=1)
        last = np.floor(points[..., 2] + widths / 2).reshape(60, -1).max(axis=1) + 1
        assert (plan.first <= np.maximum(first, -35)).all()
        assert (plan.last >= np.minimum(last, 95)).all()


@pytest.mark.parametrize("between", ["linear", "cubic"])
def test_what_flickers_becomes_grey_in_every_plane(between: str) -> None:
    layout = layout_of(shape=(40, 70))
    d = Deformation((60, 40, 70), on_fold="flow", border=64).grab((35, 20, 15), by=(4, 2, 28), radius=25, reach=None)
    arrays = [np.zeros((60, *g.shape, g.channels), np.uint8) for g in layout.groups]
    for array in arrays:
        array[::2] = 255
    for name in ("linear", "auto"):
        sharp, soft = (
            streamed(d.space, layout, arrays, Sampling(name, between=between, time_filter=f))[0] for f in (False, True)
        )
        for group, a, b in zip(layout.groups, sharp, soft, strict=True):
            points = source_points(d, group, range(60))
            durations = reference.durations(d, source_points(d, replace(group, step=(1, 1), offset=(0, 0)), range(60)))
            if group.step == (1, 1):
                fast = (durations > 3) & (points[..., 2] > durations) & (points[..., 2] < 59 - durations)
                assert fast.sum() > 200
                assert np.abs(b[fast] - 127.5).mean() < 13
                assert np.abs(a[fast] - 127.5).mean() > 50
            assert np.abs(b.astype(float) - 127.5).mean() < np.abs(a.astype(float) - 127.5).mean()
    for value in (0, 77, 255):
        flat = [np.full_like(array, value) for array in arrays]
        for part in streamed(d.space, layout, flat, Sampling("auto", between=between, time_filter=True))[0]:
            assert (part == value).all()


def test_only_what_is_wanted_is_made_and_held() -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout, 60)
    d = Deformation((60, *SHAPE), border=None, on_fold="damp").grab(
        (30, 20, 30), by=(8, 5, 4), radius=6, scales=3, reach=None
    )
    everything, plan, clip = streamed(d.space, layout, arrays, Sampling("linear"))
    assert plan.capacity < 15
    assert clip.copied == list(range(60))
    for planes in ([31], [5, 29, 33], [0, 59], [28, 29, 30], list(range(40, 60))):
        found, plan, clip = streamed(d.space, layout, arrays, Sampling("linear"), planes)
        for part, whole in zip(found, everything, strict=True):
            np.testing.assert_array_equal(part, whole[planes])
        assert clip.copied[0] == plan.keep[0]
        assert clip.copied[-1] == plan.read[-1]
        assert clip.given == plan.read[-1] + 1
    # Far from the stroke, a frame is passed on.
    found, plan, _ = streamed(d.space, layout, arrays, Sampling("auto"), [0, 1, 59])
    assert plan.still.all()
    assert plan.capacity <= 60
    for part, source in zip(found, arrays, strict=True):
        np.testing.assert_array_equal(part, source[[0, 1, 59]])


@pytest.mark.filterwarnings("ignore::supple.errors.GapWarning")
@pytest.mark.parametrize("layout", [LAYOUTS["4:2:2 of 10 bits"], LAYOUTS["grey of floats"]])
def test_still_planes_are_passed_on_bit_for_bit(layout: Layout) -> None:
    arrays = noise(layout, 30)
    for array in arrays:  # any bits, even those that no video has
        raw = np.random.default_rng(1).integers(0, 256, array.nbytes, np.uint8)
        array.reshape(-1).view(np.uint8)[:] = raw
        array[14:26] = 0 if array.dtype.kind == "f" else 500
    d = Deformation((30, *SHAPE), border=None, on_fold="damp").grab(
        (30, 20, 20), by=(5, 3, 2), radius=4, scales=3, reach=None
    )
    none = [
        Deformation((30, *SHAPE), border=64, on_fold="damp"),
        Deformation((30, *SHAPE), border=64, on_fold="damp").grab((3, 3, 3), by=(0, 0, 0), radius=9, reach=None),
    ]
    for light in (False, layout.dtype.kind == "u"):
        for averaged in (False, True):
            sampling = Sampling("auto", time_filter=averaged, linear_light=light)
            found, plan, _ = streamed(d.space, layout, arrays, sampling)
            assert plan.still[:5].all()
            assert not plan.still[18:23].any()
            for part, source in zip(found, arrays, strict=True):
                assert part[:5].tobytes() == source[:5].tobytes()
            for still in none:
                found, plan, _ = streamed(still.space, layout, arrays, sampling)
                assert plan.still.all()
                assert plan.capacity == 1
                for part, source in zip(found, arrays, strict=True):
                    assert part.tobytes() == source.tobytes()


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("shift", [-40, -13, -12, -5, 5, 12, 29, 36, 41])
def test_all_of_a_clip_outside_itself(shift: int, rule: str) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    d = Deformation((COUNT, *SHAPE), border=None, on_fold="damp").grab(
        (30, 20, 5), by=(0, 0, shift), radius=1e7, reach=None
    )
    t = np.arange(COUNT) - shift
    mirrored = t % (2 * COUNT)
    shown = {
        "edge": np.clip(t, 0, COUNT - 1),
        "reflect": np.where(mirrored < COUNT, mirrored, 2 * COUNT - 1 - mirrored),
        "constant": np.where((t >= 0) & (t < COUNT), t, -1),
    }[rule]
    for name in ("nearest", "linear", "cubic", "auto"):
        for averaged in (False, True):
            between = "nearest" if name == "nearest" else "linear"
            sampling = Sampling(name, outside=rule, fill=(16.0, 128.0, 90.0), between=between, time_filter=averaged)
            found, plan, _ = streamed(d.space, layout, arrays, sampling)
            assert plan.capacity <= COUNT
            for part, source, fill in zip(found, arrays, ([16], [128, 90]), strict=True):
                around = np.concatenate([source, np.broadcast_to(np.uint8(fill), (1, *source.shape[1:]))])
                np.testing.assert_array_equal(part, around[shown])


@pytest.mark.parametrize("kind", ["4:2:0", "4:2:2 of 10 bits", "4:4:4 of 12 bits"])
def test_the_same_bend_in_every_frame(kind: str) -> None:
    """A deformation of a picture, for a clip: each frame is warped as it would be alone."""
    layout = LAYOUTS[kind]
    arrays = noise(layout, 5)
    for border in (None, 50.0):
        d = Deformation(SHAPE, border=border, on_fold="damp").grab((25, 20), by=(9, -6), radius=16, reach=None)
        space = replace(d.space, count=5)
        for name in ("nearest", "linear", "cubic", "auto"):
            for rule in RULES:
                sampling = Sampling(name, outside=rule, fill=(40.0,), tolerance=FINE)
                found, plan, _ = streamed(space, layout, arrays, sampling)
                assert plan.capacity == 1
                assert not plan.still.any()
                if layout.white == 255 and border:
                    alone = [d.warp(a, filter=name, outside=rule, fill=40, tolerance=FINE) for a in arrays[0]]
                    np.testing.assert_array_equal(found[0], alone)
                if name in ("linear", "cubic"):
                    for group, source, out in zip(layout.groups, arrays, found, strict=True):
                        q = reference.grid(group.shape) * np.array(group.step) + np.array(group.offset)
                        points = (d.inverse(q).points - np.array(group.offset)) / np.array(group.step)
                        for frame, made in zip(source, out, strict=True):
                            expected = reference.sample(frame, points, filter=name, outside=rule, fill=40)
                            same(made, expected.astype(np.float64), layout.white)
