"""Arrays of the host on a GPU: in slabs, through a ring of frames, against the oracles."""

from __future__ import annotations

import functools
import itertools
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.arrays import work_of
from supple.cli import command
from supple.engines.base import Certificate, Sampling
from supple.engines.cuda import large
from supple.engines.cuda.device import CudaDevice, failures
from supple.engines.cuda.large import Plan, planned, warp_host
from supple.engines.cuda.needs import Needs
from supple.engines.cuda.ring import Ring
from supple.engines.cuda.sample import FIRST, LAST, SHIFT, SLOTS
from supple.engines.cuda.staging import Lane, copied, pieces
from supple.engines.native import NATIVE
from supple.engines.workers import workers
from supple.errors import DeviceWarning, SuppleError
from supple.media import volume as media
from tests.engines.cuda.kernels.expected import expected, surely_nearest

TIGHT = 1e-4
STACK = (12, 6, 7)


@pytest.fixture(autouse=True)
def _there(gpu: CudaDevice) -> None:
    """All of these need one."""


def bent(shape: tuple[int, ...] = STACK, by: float = 1.6, border: float | None = None) -> supple.Deformation:
    """A grab that moves things along the last axis of points most, and in space so evenly that cells are exact."""
    middle = (np.array(shape[::-1]) - 1) / 2
    drag = np.array([0.8, -0.6, by])[: len(shape)]
    return supple.Deformation(shape, border=border, on_fold="damp").grab(
        middle, by=drag, radius=30.0 if border is None else 8.0, reach=None
    )


def local(shape: tuple[int, ...] = STACK) -> supple.Deformation:
    """Two grabs, each of which reaches a few planes."""
    d = supple.Deformation(shape, border=None, on_fold="damp")
    return d.grab((3, 3, 2), by=(0.4, 0.2, 0.3), radius=1, reach=2.5).grab(
        (3, 2, 9), by=(0.3, 0.1, 0), radius=1, reach=1.5
    )


def waves(shape: tuple[int, ...] = STACK, dtype: Any = np.float32, channels: int = 0) -> np.ndarray:
    """Smooth values that fill the range of a type."""
    places = np.indices(shape).astype(float)
    along = sum(s * p for s, p in zip((0.3, 0.4, 0.25), places, strict=False))
    values = 0.5 + 0.5 * np.sin(np.asarray(along)[..., None] + np.arange(max(channels, 1)))
    values = values if channels else values[..., 0]
    kind = np.dtype(dtype)
    if kind.kind == "b":
        return values > 0.5
    if kind.kind == "f":
        return values.astype(kind)
    return np.rint(values * np.iinfo(kind).max).astype(kind)


def by_device(gpu: CudaDevice, d: supple.Deformation, source: Any, **options: Any) -> tuple[np.ndarray, Certificate]:
    known = {"tolerance": TIGHT, "filter": "linear", "outside": "edge", "fill": 0.0, "linear_light": False}
    known |= {"between": None, "time_filter": False, "alpha": None, "out": None, "room": None}
    known |= {"tell": lambda done: None, **options}
    alpha, out, room, tell = (known.pop(name) for name in ("alpha", "out", "room", "tell"))
    work = work_of(source, d.space, Sampling.checked(d.ndim, **known), alpha)
    made = NATIVE.result(out, source)
    axes, certificate = len(d.shape), Certificate(0.0, 0.0)
    frames = [a if a.ndim > axes else a[..., None] for a in (source, made)]
    for done, part in warp_host(gpu, *(a if axes == 3 else a[None] for a in frames), work, room=room):
        tell(done)
        certificate |= part
    return made, certificate


def apart(made: np.ndarray, wanted: np.ndarray) -> float:
    """How far off, at most, as a part of the range."""
    assert (made.dtype, made.shape) == (wanted.dtype, wanted.shape)
    a, b = made.astype(np.float64), wanted.astype(np.float64)
    return float(np.abs(a - b).max() / max(b.max() - b.min(), 1e-9))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slabs of two planes, a ring that starts anew, and buffers of a few rows."""
    monkeypatch.setattr(large, "planned", lambda count, frame, scratch, room: Plan(2, min(count, 9), 2))
    monkeypatch.setattr(large, "Lane", functools.partial(Lane, piece=150))


STACKS: list[dict[str, Any]] = [
    {"filter": "linear"},
    {"filter": "linear", "outside": "reflect", "between": "nearest"},
    {"filter": "cubic", "between": "cubic", "outside": "constant", "fill": 0.3},
    {"filter": "linear", "time_filter": True, "outside": "reflect"},
]


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("options", STACKS)
def test_slabs(gpu: CudaDevice, options: dict[str, Any]) -> None:
    d, source = bent(border=None if "outside" in options else 3.0), waves()
    told: list[int] = []
    made, certificate = by_device(gpu, d, source, tell=told.append, **options)
    assert apart(made, expected(d, source, **options)) < 1e-3
    assert told == sorted(told)
    assert told[-1] == len(source)
    assert certificate.error <= TIGHT
    assert certificate.unknown == 0


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("dtype", [">i2", "?", "f2", ">f8", "u1"])
def test_types(gpu: CudaDevice, dtype: str) -> None:
    d, source = bent(), waves(dtype=dtype)
    made, _ = by_device(gpu, d, source)
    wanted = expected(d, source, filter="linear").astype(source.dtype)
    if dtype == "?":
        assert (made != wanted).mean() < 0.01
    else:
        assert apart(made, wanted) < (1 / 200 if dtype == "u1" else 1e-3)
    # `np.empty_like` keeps the order of bytes
    assert made.dtype.str == wanted.dtype.str


@pytest.mark.usefixtures("small")
def test_labels_keep_their_values(gpu: CudaDevice) -> None:
    d = bent()
    source = np.random.default_rng(0).integers(-900, 900, STACK).astype(np.int16)
    made, _ = by_device(gpu, d, source, filter="nearest")
    sure = surely_nearest(d)
    np.testing.assert_array_equal(made[sure], expected(d, source, filter="nearest")[sure])


def test_a_small_stack_goes_over_whole(gpu: CudaDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    upload = Lane.up
    monkeypatch.setattr(Lane, "up", lambda lane, source, to: (sent.append(len(source)), upload(lane, source, to)))
    d, source = bent(border=3.0), waves(channels=2)
    made, _ = by_device(gpu, d, source)
    assert apart(made, expected(d, source, filter="linear")) < 1e-3
    assert sum(sent) == len(source)
    assert len(sent) > 1  # the first planes are begun before the last frames are there


@pytest.mark.usefixtures("small")
def test_a_frame_is_sent_once(gpu: CudaDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    upload = Lane.up
    monkeypatch.setattr(Lane, "up", lambda lane, source, to: (sent.append(source.size), upload(lane, source, to)))
    by_device(gpu, bent(by=0.3), waves())
    assert sum(sent) == waves().size


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("dtype", ["f4", ">i2"])
def test_planes_that_no_stroke_reaches_stay_here(gpu: CudaDevice, monkeypatch: pytest.MonkeyPatch, dtype: str) -> None:
    sent: list[int] = []
    upload = Lane.up
    monkeypatch.setattr(Lane, "up", lambda lane, source, to: (sent.append(source.size), upload(lane, source, to)))
    d, source = local(), waves(dtype=dtype, channels=2)
    told: list[int] = []
    made, _ = by_device(gpu, d, source, filter="auto", tell=told.append)
    assert apart(made, expected(d, source, filter="auto").astype(dtype)) < 1e-3
    np.testing.assert_array_equal(made[5:8], source[5:8])
    assert sum(sent) <= source[:6].size + source[7:].size
    assert told == [4, 6, 8, 9, 11, 12]
    sent.clear()
    beyond = supple.Deformation(STACK, border=None, on_fold="damp").grab((3, 3, 20), by=(1, 1, 1), radius=2, reach=2)
    np.testing.assert_array_equal(by_device(gpu, beyond, source)[0], source)
    assert not sent


@pytest.mark.usefixtures("small")
def test_what_was_missing_is_made_again(gpu: CudaDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    made_of: list[Needs] = []

    def too_few(stream: Any, lattice: Any, pieces: Any, count: int, sampling: Any, how: Any) -> Needs:
        planes = np.arange(count, dtype=float)
        made_of.append(Needs(count, sampling, planes, planes))
        return made_of[-1]

    monkeypatch.setattr(large, "needs_of", too_few)
    d, source = bent(by=1.2, border=3.0), waves()
    told: list[int] = []
    made, certificate = by_device(gpu, d, source, tell=told.append)
    assert made_of[0].more > 0
    assert apart(made, expected(d, source, filter="linear")) < 1e-3
    assert told[-1] == len(source)
    assert certificate.unknown == 0


def test_arrays_of_any_kind_and_where_they_go(gpu: CudaDevice, tmp_path: Path) -> None:
    d, values = bent(), waves(dtype=np.int16, channels=2)
    wanted = expected(d, values, filter="linear")
    mapped = np.memmap(tmp_path / "in.raw", ">i2", "w+", 0, values.shape)
    mapped[...] = values
    out = np.memmap(tmp_path / "out.raw", ">i2", "w+", 0, values.shape)
    made, _ = by_device(gpu, d, mapped, out=out)
    assert made is out
    assert apart(np.asarray(out, np.int16), wanted) < 1e-3
    strided = np.asfortranarray(values)[:, ::-1]
    back = np.zeros((*values.shape[:3], 4), np.int16)[..., ::2]
    made, _ = by_device(gpu, d, strided, out=back)
    assert made is back
    assert apart(back, expected(d, strided, filter="linear")) < 1e-3
    with pytest.raises(SuppleError, match="must not overlap"):
        by_device(gpu, d, values, out=values)


@pytest.mark.parametrize("options", [{"alpha": True}, {"alpha": False, "linear_light": True}])
def test_images(gpu: CudaDevice, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]) -> None:
    monkeypatch.setattr(large, "Lane", functools.partial(Lane, piece=300))
    d, source = bent((11, 12)), waves((11, 12), np.uint8, 4)
    made, _ = by_device(gpu, d, source, **options)
    wanted = expected(d, source, filter="linear", **options)
    assert np.abs(made.astype(int) - wanted).max() <= 1
    plain, _ = by_device(gpu, d, source[..., 0])
    assert apart(plain, expected(d, source[..., 0], filter="linear")) <= 1 / 250


def test_memory_is_shared_out() -> None:
    for count, frame, scratch in itertools.product((1, 7, 3000), (100, 1 << 20, 1 << 28), (1000, 1 << 22)):
        for room in (4 * frame + 2 * scratch, 40 * frame + 9 * scratch, 10**13):
            plan = planned(count, frame, scratch, room)
            assert plan.slots * frame + plan.planes * (plan.turns * frame + scratch) <= room
            assert 1 <= plan.planes <= count
            assert plan.slots <= count
        assert planned(count, frame, scratch, 10**13).slots == count
    with pytest.raises(MemoryError, match="a frame of 1 GB is more than fits into 2 GB"):
        planned(1, 10**9, 10**6, 2 * 10**9)


@pytest.mark.parametrize("slots", [5, 8, 40])
def test_a_ring_holds_what_was_asked_for(gpu: CudaDevice, slots: int) -> None:
    from numba import cuda

    with gpu.current():
        source = np.random.default_rng(0).random((40, 3, 4, 1)).astype(np.float32)
        there = cuda.to_device(np.zeros(slots * 12, np.float32))
        lane = Lane(source.dtype, (3, 4), 80)
        ring = Ring(source, there, slots, lane)
        rng = np.random.default_rng(1)
        stretches = [(0, 3), (2, 5), (4, 9), (3, 8), (0, 5), (20, 24), (19, 20), (36, 40)]
        stretches += [(a, a + int(n)) for a, n in zip(rng.integers(0, 36, 30), rng.integers(1, 5, 30), strict=True)]
        for number, (low, high) in enumerate(stretches):
            frames = ring.send(low, high, lane.stream)
            lane.stream.synchronize()
            held = there.copy_to_host().reshape(slots, 3, 4, 1)
            first, last, shift, size = (frames.places[k] for k in (FIRST, LAST, SHIFT, SLOTS))
            assert first <= low < high <= last
            assert size == slots
            for k in range(first, last):
                slot = shift + k - first
                np.testing.assert_array_equal(held[slot if slot < slots else slot - slots], source[k])
            event = cuda.event()
            event.record(lane.stream)
            ring.read_by(number, (first, last), event)
            if number % 3 == 0:
                ring.forget(number - 1)


def test_copies_go_in_pieces() -> None:
    for frames, shape, most in (((3, 9), (4, 5), 45), ((0, 5), (4, 5), 12), ((2, 3), (7, 6), 1), ((1, 1), (2, 2), 9)):
        seen = np.zeros((10, *shape), int)
        for part in pieces(frames, shape, most):
            seen[part] += 1
            assert seen[part].size <= max(most, shape[1])
        assert (seen[slice(*frames)] == 1).all()
        assert seen.sum() == (frames[1] - frames[0]) * shape[0] * shape[1]
    source = np.arange(2 * 900 * 700).reshape(2, 900, 700)[..., ::-1]
    target = np.zeros(source.shape, ">i8")
    copied(source, target)
    np.testing.assert_array_equal(source, target)


def test_what_does_not_fit_is_done_by_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    d, source = bent(border=3.0), waves()
    monkeypatch.setattr(large, "planned", lambda count, frame, scratch, room: Plan(2, 2, 2))
    with pytest.warns(DeviceWarning, match=r"the CPU did what .* could not: a plane is made of \d+ frames, and there"):
        made = d.warp(source, filter="linear", between="cubic", device="cuda")
    np.testing.assert_array_equal(made, d.warp(source, filter="linear", between="cubic"))


def test_a_card_that_fails_ends_in_the_cpu_s_result(monkeypatch: pytest.MonkeyPatch) -> None:
    fails = next(kind for kind in failures() if kind is RuntimeError)
    uploads = itertools.count()
    upload = Lane.up

    def fail(lane: Lane, source: Any, to: Any) -> None:
        if next(uploads) == 3:
            raise fails("an illegal address was met")
        upload(lane, source, to)

    monkeypatch.setattr(Lane, "up", fail)
    d, source = bent(), waves()
    out = np.empty_like(source)
    with pytest.warns(DeviceWarning, match="an illegal address was met"), workers() as who:
        assert d.warp(source, filter="linear", device="cuda", out=out) is out
    assert str(who) == "cpu"
    np.testing.assert_array_equal(out, d.warp(source, filter="linear"))


def test_an_end_on_the_way_is_the_caller_s(gpu: CudaDevice) -> None:
    d, source = bent(), waves()

    def stop(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        by_device(gpu, d, source, tell=stop)
    assert apart(by_device(gpu, d, source)[0], expected(d, source, filter="linear")) < 1e-3


def test_deformations_send_arrays(gpu: CudaDevice) -> None:
    d, source = bent(), waves()
    with workers() as who:
        made = d.warp(source, filter="linear", tolerance=TIGHT, device="cuda")
    assert apart(made, expected(d, source, filter="linear")) < 1e-3
    assert str(who) == gpu.name
    still = supple.Deformation(STACK, border=64, on_fold="damp")
    np.testing.assert_array_equal(still.warp(source, device="cuda"), source)
    with pytest.raises(SuppleError, match="filter must be"):
        d.warp(source, filter="lanczos", device="cuda")
    with pytest.raises(SuppleError, match='device must be "cpu" for a function of points'):
        bent((9, 9)).warp(lambda points: points[:, 0], device="cuda")
    with pytest.raises(SuppleError, match="source must be of shape"):
        d.warp(source[1:], device="cuda")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeviceWarning)
        yield tmp_path


def test_volumes_and_pictures_from_file_to_file(
    gpu: CudaDevice, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from supple.geometry import Geometry

    source = waves(dtype=np.int16)
    media.write("in.nrrd", source, media.Volume(source, Geometry()))
    common = ["--grab", "3,2,6:3.8,1.4,7.4", "--radius", "30", "--border", "none", "--filter", "linear", "--quiet"]
    assert command(["warp", "in.nrrd", "cuda.nrrd", *common, "--device", "cuda", "--json"]) == 0
    made = np.asarray(media.read("cuda.nrrd").samples)
    wanted = supple.Deformation(STACK, border=None, on_fold="damp").grab(
        (3, 2, 6), to=(3.8, 1.4, 7.4), radius=30, reach=None
    )
    assert apart(made, expected(wanted, source, filter="linear")) < 3e-3  # it is within 0.01 voxels
    told = json.loads(capfd.readouterr().out)
    assert told["device"] == gpu.name
    assert told["error"] <= 0.01
    assert command(["warp", "in.nrrd", "not.nrrd", *common[:6], "--device", "cuda", "--filter", "none"]) == 2
    assert not Path("not.nrrd").exists()
