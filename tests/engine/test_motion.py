"""Samples between frames that follow what moves: against truth, the reference, and the plain mixture."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import Deformation, SuppleError
from supple.engine import core
from supple.engine.motion import CUT, Motion, Moving, motion_between
from supple.engine.sampling import Sampling
from supple.engine.work import Group, Layout, Work
from tests import effort, reference
from tests.engine.arrays import RULES
from tests.engine.streams import layout_of, streamed
from tests.reference.between import sample_between

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
SIZE, COUNT = (120, 200), 5


def later(count: int, shape: tuple[int, int], by: float = 0.5) -> Deformation:
    """Each frame k shows what was seen at the time k - by."""
    d = Deformation((count, *shape), border=None, time=True)
    return d.grab((shape[1] / 2, shape[0] / 2, count / 2), by=(0, 0, by), radius=1e6, time_radius=1e6, reach=None)


@functools.cache
def texture(seed: int, shape: tuple[int, int], fine: float = 3.0) -> Floats:
    rough = np.random.default_rng(seed).normal(size=shape)
    return np.asarray(cv2.GaussianBlur(rough, (0, 0), fine) * 200 * fine / 3 + 120)


def scene(time: float, speed: tuple[float, float] = (9.0, 4.0), seed: int = 0) -> Floats:
    """A textured square that moves over a textured wall, at any time, in levels of 255."""
    height, width = SIZE
    y, x = np.mgrid[:height, :width].astype(np.float64)
    left, top = 40 + speed[0] * time, 30 + speed[1] * time
    inside = [
        np.clip(at - first + 0.5, 0, 1) * np.clip(first + 60 - at + 0.5, 0, 1) for at, first in ((x, left), (y, top))
    ]
    moved = cv2.remap(
        texture(seed + 1, SIZE), (x - left + 10).astype("f4"), (y - top + 10).astype("f4"), cv2.INTER_CUBIC
    )
    cover = inside[0] * inside[1]
    return np.clip(cover * moved + (1 - cover) * texture(seed, SIZE), 0, 255)


def clip_of(times: list[float], dtype: str = "u1", white: float = 255.0, channels: int = 1) -> Array:
    frames = np.stack([scene(t) for t in times])[..., None] * (white / 255)
    made = np.repeat(frames, channels, axis=3)
    return (made if np.dtype(dtype).kind == "f" else np.rint(made)).astype(dtype)


@pytest.mark.parametrize("by", [0.5, 0.25, 0.7])
@pytest.mark.parametrize("filter", ["auto", "linear"])
def test_what_moves_is_seen_once(filter: str, by: float) -> None:
    source = clip_of([*range(COUNT)])
    found = {
        between: later(COUNT, SIZE, by).warp(source, between=between, filter=filter) for between in ("linear", "flow")
    }
    for k in range(1, COUNT):
        truth = scene(k - by)[..., None]
        mixed, followed = (reference.psnr(found[between][k], truth, 255) for between in ("linear", "flow"))
        assert followed > mixed + 4


@pytest.mark.parametrize(
    ("dtype", "channels", "alpha"),
    [
        ("u1", 3, None),
        ("u1", 4, True),
        ("u2", 1, None),
        ("i2", 1, None),
        ("f4", 3, None),
        ("f8", 5, None),
        ("f2", 1, None),
    ],
)
def test_every_kind_of_samples_follows(dtype: str, channels: int, alpha: bool | None) -> None:
    white = {"u1": 255.0, "u2": 65535.0, "i2": 3000.0}.get(dtype, 40.0)
    source = clip_of([0, 1, 2], dtype, white, channels)
    if alpha:
        source[..., 3] = 255
    truth = clip_of([0.5, 1.5], "f8", white, channels)
    if alpha:
        truth[..., 3] = 255
    scores = []
    for between in ("linear", "flow"):
        made = later(3, SIZE).warp(source, between=between, alpha=alpha)
        assert made.dtype == source.dtype
        scores.append(reference.psnr(made[1:], truth, white))
    assert scores[1] > scores[0] + 4


@pytest.mark.parametrize("name", ["4:2:0", "4:2:2 of 10 bits"])
def test_planes_follow_as_they_are_stored(name: str) -> None:
    step, dtype, white = ((2, 2), "u1", 255.0) if name == "4:2:0" else ((2, 1), "u2", 1023.0)
    layout = layout_of(step, (0.0, 0.5) if step[1] == 2 else (0.0, 0.0), dtype, white, SIZE)
    x, y = np.meshgrid(
        *(np.arange(n // s) * s + o for n, s, o in zip(SIZE[::-1], step, layout.groups[1].offset, strict=True))
    )

    def planes(time: float) -> list[Floats]:
        luma = scene(time) * white / 255
        small = cv2.remap(luma, x.astype("f4"), y.astype("f4"), cv2.INTER_LINEAR)
        return [luma[..., None], np.stack([small, white - small], axis=-1)]

    clip = [np.stack(parts).round().astype(dtype) for parts in zip(*map(planes, range(3)), strict=True)]
    found = {
        between: streamed(later(3, SIZE).space, layout, clip, Sampling(between=between, fill=(0.0, 0.0, 0.0)))[0]
        for between in ("linear", "flow")
    }
    for number, truth in enumerate(planes(0.5)):
        mixed, followed = (reference.psnr(found[between][number][1], truth, white) for between in ("linear", "flow"))
        assert followed > mixed + 4


# ---- the core, against the reference

FRAMES = 4
LAID = {
    "grey": Layout((Group((48, 64), 1),), np.dtype("u1"), 255.0),
    "colours": Layout((Group((48, 64), 3),), np.dtype("u2"), 65535.0),
    "opacity": Layout((Group((48, 64), 4, alpha=True),), np.dtype("f4"), 1.0),
    "many": Layout((Group((48, 64), 6),), np.dtype("f8"), 1.0),
    "4:2:0": layout_of((2, 2), (0.0, 0.5), shape=(48, 64)),
}


def given(kind: str) -> Moving:
    """Displacements that vary slowly, and a weight; the second pair is a cut, or the plain mixture."""
    y, x = np.mgrid[:12, :16]
    fields = np.zeros((FRAMES, 12, 16, 4), np.float32)
    for k in range(FRAMES):
        fields[k, ..., 0] = 5 + 0.06 * x - 0.04 * y - 3 * k
        fields[k, ..., 1] = -3 + 0.05 * y + 0.03 * x
        fields[k, ..., 2] = np.clip(0.2 + 0.07 * x, 0, 1)
    longest = [12.0] * FRAMES
    longest[1] = {"cut": CUT, "mixture": 0.0, "all": 12.0}[kind]
    return Moving(fields, longest, 1.5, 1.5, 4.0)


@pytest.mark.parametrize(
    ("laid", "filter", "rule", "kind"),
    effort.pairs(list(LAID), ["linear", "cubic", "auto"], RULES, ["all", "cut", "mixture"]),
)
def test_the_core_follows_as_the_reference(laid: str, filter: str, rule: str, kind: str) -> None:
    layout = LAID[laid]
    d = Deformation((FRAMES, 48, 64), border=None, time=True).grab(
        (30, 20, 1.5), by=(6, -4, 1.4), radius=14, reach=None
    )
    rng, floats = np.random.default_rng(0), layout.dtype.kind == "f"
    clip = []
    for group in layout.groups:
        rough = rng.uniform(size=(FRAMES, *group.shape, group.channels))
        smooth = np.stack([cv2.GaussianBlur(f, (0, 0), 1.5).reshape(f.shape) for f in rough])
        smooth = (smooth - smooth.min()) / (smooth.max() - smooth.min()) * layout.white
        if group.alpha:
            smooth[..., -1] = layout.white
        clip.append(np.ascontiguousarray(smooth if floats else smooth.round()).astype(layout.dtype))
    fill = tuple(0.3 * layout.white for group in layout.groups for _ in range(group.channels))
    work = Work(d.space, layout, Sampling(filter, 1e-4, rule, fill, between="flow"))
    moving = given(kind)
    for z in range(FRAMES):
        outs = [np.empty((*g.shape, g.channels), layout.dtype) for g in layout.groups]
        plan = core.plan_of(d.space, z, 1e-4, layout.step)
        for each in core.samplings_of(work, clip, outs, FRAMES, moving=moving):
            plan.sample(each)
        for group, frames, out in zip(layout.groups, clip, outs, strict=True):
            x, y = (np.arange(n) * s + o for n, s, o in zip(group.shape[::-1], group.step, group.offset, strict=True))
            q = np.stack([*np.meshgrid(x, y), np.full(group.shape, float(z))], axis=-1).reshape(-1, 3)
            points = d.inverse(q).points
            slopes = np.linalg.inv(d.jacobian(points))[:, :2, :2]
            colours = group.channels - group.alpha
            truth = sample_between(
                frames, points, moving.fields, moving.longest, (1.5, 1.5), 4.0, filter, rule,
                fill[:group.channels], group.step, group.offset, slopes,
            )  # fmt: skip
            if rule == "constant" and group.alpha:
                continue  # its fill value has an opacity of its own
            off = np.abs(out.reshape(-1, group.channels).astype(np.float64) - np.clip(truth, 0, layout.white))
            assert np.quantile(off[:, :colours], 0.999) <= 0.02 * layout.white
            assert off[:, :colours].mean() <= 0.002 * layout.white + (0 if floats else 0.3)


def test_whole_frames_keep_every_bit() -> None:
    source = np.random.default_rng(0).integers(0, 255, (FRAMES, 48, 64, 3), np.uint8)
    d = Deformation((FRAMES, 48, 64), border=None, time=True)
    shift = np.eye(3, 4)
    shift[:, 3] = 0.25, 0.5, 1
    d = d.affine(shift)
    found = []
    for moving in (None, given("all")):
        out = np.empty((48, 64, 3), np.uint8)
        work = Work(d.space, Layout((Group((48, 64), 3),), source.dtype, 255.0), Sampling())
        (job,) = core.samplings_of(work, [source], [out], FRAMES, moving=moving)
        core.plan_of(d.space, 1, 0.01).sample(job)
        found.append(out)
    np.testing.assert_array_equal(*found)


# ---- what decides


def test_noise_does_not_move() -> None:
    rng = np.random.default_rng(0)
    still = np.repeat(texture(0, SIZE)[None, ..., None], 3, axis=0)
    source = np.clip(still + rng.normal(0, 6, still.shape), 0, 255).round().astype(np.uint8)
    made = [later(3, SIZE).warp(source, between=between)[1:] for between in ("linear", "flow")]
    mixed, followed = (reference.psnr(each, still[1:], 255) for each in made)
    assert followed > mixed - 0.1


@pytest.mark.parametrize("grain", [1.0, 0.0])
def test_small_movements_are_followed_unless_most_samples_repeat(grain: float) -> None:
    """As those of codecs do that compress hard, whose own mixtures move by as little."""
    rng = np.random.default_rng(0)
    frames = [np.rint(scene(t, (2, 0)) + rng.normal(0, grain, SIZE)).clip(0, 255).astype(np.uint8) for t in (0, 1)]
    one, other = (cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for frame in frames)
    _, longest = motion_between(one, other)
    assert longest == pytest.approx(2 if grain else 0, abs=0.2)


def test_at_a_cut_the_nearer_frame_is_shown() -> None:
    data = Path(supple.__file__).parent / "examples" / "data"
    shots = [cv2.resize(cv2.imread(str(data / f"{name}.jpg"), 0), SIZE[::-1]) for name in ("coffee", "chelsea")]
    source = np.stack([np.roll(shot, 2 * k, axis=1) for shot in shots for k in range(3)])[..., None]
    for by, k in ((0.7, 2), (0.3, 3)):
        made = later(6, SIZE, by).warp(source, between="flow")
        np.testing.assert_array_equal(made[3], source[k])
    half = [later(6, SIZE).warp(source, between=between)[3].astype(int) for between in ("linear", "flow")]
    assert np.abs(half[0] - half[1]).max() <= 1  # neither is nearer


@pytest.mark.parametrize("dtype", ["u1", "i4"])  # sampled in place, and as numbers
def test_an_average_over_time_ends_at_a_cut(dtype: str) -> None:
    shots = [np.clip(clip_of([*range(6)]) / 2.6 + low, low, low + 98).astype(dtype) for low in (0, 157)]
    source = np.concatenate([shots[0], shots[1][:, ::-1, ::-1]])
    d = Deformation((12, *SIZE), border=None, time=True)
    d = d.grab((100, 60, 4), by=(0, 0, 4), radius=60, time_radius=6)
    across = [
        (np.abs(d.warp(source, between=between, time_filter=True).astype(int) - 127) < 28).mean()
        for between in ("linear", "flow")
    ]
    assert across[0] > 0.01
    assert across[1] < 0.001  # halfway, one frame becomes the other


def test_a_mirrored_clip_plays_backwards() -> None:
    source = clip_of([0, 1, 2])
    d = later(3, SIZE, 3.5)  # frame 2 shows the time -1.5: between 0 and 1, mirrored
    made = d.warp(source, between="flow", outside="reflect")
    forth = later(3, SIZE, 1.5).warp(source, between="flow")
    inside = (slice(4, -4), slice(4, -4))
    assert np.abs(made[2].astype(int) - forth[2])[inside].max() <= 1


def test_only_where_it_may_move_is_motion_computed() -> None:
    source = clip_of([*range(COUNT)])
    d = Deformation((COUNT, *SIZE), border=None, time=True).grab((60, 50, 2), by=(0, 0, 1.2), radius=10, reach=2)
    made = d.warp(source, between="flow")
    untouched = np.abs(d.inverse(reference.grid(d.shape)).points - reference.grid(d.shape)).max(axis=-1) == 0
    assert untouched.mean() > 0.5
    np.testing.assert_array_equal(made[untouched], source[untouched])


def test_frames_that_are_not_mixed_have_no_motion() -> None:
    source = clip_of([*range(COUNT)])
    d = Deformation((COUNT, *SIZE), border=None, time=True).grab((60, 50, 2), by=(9, 5, 0), radius=30)
    work = Work(d.space, Layout((Group(SIZE, 1),), source.dtype, 255.0), Sampling())
    motion = Motion(work, [source], np.empty(Motion.shape_of(work, COUNT), np.float32))
    assert motion.between(range(2, 2)) is None
    assert motion.between(range(2, 3)) is not None
    np.testing.assert_array_equal(*(d.warp(source, between=between) for between in ("linear", "flow")))


def test_what_stays_in_place_is_the_plain_mixture() -> None:
    source = clip_of([*range(3)])
    source[:, :, 150:] = texture(3, SIZE)[:, 150:, None]  # away from the square
    source[:, :, 150:] ^= np.random.default_rng(0).integers(0, 2, source[:, :, 150:].shape, np.uint8)
    mixed, followed = (later(3, SIZE, 0.3).warp(source, between=between) for between in ("linear", "flow"))
    np.testing.assert_array_equal(followed[:, :, 176:], mixed[:, :, 176:])
    assert (followed[1:, :, :150] != mixed[1:, :, :150]).mean() > 0.1


def test_results_do_not_depend_on_threads_or_on_the_planes_asked_for() -> None:
    source = clip_of([*range(COUNT)])
    layout = Layout((Group(SIZE, 1),), source.dtype, 255.0)
    space, sampling = later(COUNT, SIZE, 0.3).space, Sampling(between="flow", fill=(0.0,))
    (whole,), _, _ = streamed(space, layout, [source], sampling)
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        (one,), _, _ = streamed(space, layout, [source], sampling, [3])
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(threads)
    np.testing.assert_array_equal(one[0], whole[3])


@pytest.mark.parametrize("deviation", [4, 8, 12, 16])
@pytest.mark.parametrize("ground", ["flat", "ramp", "coffee"])
def test_an_average_over_time_keeps_grain(ground: str, deviation: float) -> None:
    """Where time runs slowly, of noise over a still picture; the plain mixture loses up to 29 %."""
    rng = np.random.default_rng(0)
    picture = np.broadcast_to(np.linspace(60, 200, SIZE[1]) if ground == "ramp" else 128.0, SIZE)
    if ground == "coffee":
        data = Path(supple.__file__).parent / "examples" / "data"
        picture = cv2.resize(cv2.imread(str(data / "coffee.jpg"), 0), SIZE[::-1], interpolation=cv2.INTER_AREA)
    still = np.repeat(np.rint(picture.astype(float))[None, ..., None], 4, axis=0)
    source = np.clip(still + rng.normal(0, deviation, still.shape), 0, 255).round().astype(np.uint8)
    own = (source - still)[1:-1].std()
    for by in (0.25, 0.5):
        made = later(4, SIZE, by).warp(source, between="flow", time_filter=True)
        assert abs((made - still)[1:-1].std() / own - 1) < 0.03
    assert (later(4, SIZE).warp(source, between="linear") - still)[1:-1].std() < 0.8 * own


# ---- what is refused


@pytest.mark.parametrize(
    "way",
    ["volume", "grid", "map", "nearest", "batch"],
)
def test_what_cannot_follow_is_refused(way: str) -> None:
    clip, d = (
        np.zeros((3, 20, 24), np.uint8),
        Deformation((3, 20, 24), time=True).grab((12, 10, 1), by=(0, 0, 1), radius=5),
    )
    volume = Deformation((3, 20, 24)).grab((12, 10, 1), by=(0, 0, 1), radius=5)
    asked = {
        "volume": lambda: volume.warp(clip, between="flow"),
        "grid": lambda: d.warp(clip, between="flow", grid=d.grid.crop((0, 0, 0), (10, 10, 2))),
        "map": lambda: d.affine(np.eye(3, 4)).warp(clip, between="flow"),
        "nearest": lambda: d.warp(clip, between="flow", filter="nearest"),
        "batch": lambda: supple.warp_batch(clip[None], d, between="flow"),
    }
    with pytest.raises(SuppleError, match="between") as error:
        asked[way]()
    assert "flow" in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_small_frames_are_mixed() -> None:
    source = np.random.default_rng(0).integers(0, 255, (3, 12, 30), np.uint8)
    d = Deformation(source.shape, border=None, time=True).grab((15, 6, 1), by=(0, 0, 0.6), radius=9, reach=None)
    np.testing.assert_array_equal(*(d.warp(source, between=between) for between in ("linear", "flow")))


def test_a_frame_alone_is_that_of_the_clip_in_floats() -> None:
    """Also where times are whole up to rounding, so that a pixel's pair may be one that the plan does not name."""
    source = np.stack([scene(t, (5, 3)) for t in range(12)])[..., None].astype("f4")
    d = Deformation(source.shape[:3], border=None, time=True)
    d = d.grab((60, 50, 6), by=(0, 0, 1), radius=60, time_radius=9, flat=0.5)
    layout, sampling = Layout((Group(SIZE, 1),), np.dtype("f4"), 255.0), Sampling(between="flow")
    (whole,), _, _ = streamed(d.space, layout, [source], sampling)
    for k in range(12):
        (one,), _, _ = streamed(d.space, layout, [source], sampling, [k])
        np.testing.assert_array_equal(one[0], whole[k])
