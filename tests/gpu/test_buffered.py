"""Buffers of warped volumes on the GPU: what they hold, and when they are filled."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import DeviceWarning, SuppleError
from supple.gpu import device as devices
from supple.gpu import shader, solid
from supple.gpu.device import Gpu
from supple.gpu.memory import put
from supple.render.appearance import ranged
from supple.render.camera import Camera
from supple.render.scene import Scene
from tests.gpu.scenes import GEOMETRY, SHAPE, SIZE, SOFT, apart, texels_of


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int16, np.float32])
def test_the_buffer_is_the_warped_volume(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, dtype: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = (cloud * 200 - (100 if np.dtype(dtype).kind == "i" else 0)).astype(dtype)
    held = solid.hold(gpu, given)
    assert solid.beside(held)
    space = bent.space
    filling = solid.Filling(held, solid.hold_strokes(gpu, space.table, space.axes), 0.01)
    assert filling.part == 0.0
    assert filling.advance(60.0) == filling.part == 1.0
    wanted = bent.warp(given.astype(np.float32), filter="linear", tolerance=1e-3)
    made = texels_of(gpu, held.warped)
    away = np.abs(made - wanted)
    assert away.max() < 0.3
    assert np.mean(away) < 0.01
    for most in (1 << 30, 300):  # bytes of the ranges that are found at a time
        monkeypatch.setattr(gpu, "binding", most)
        for ours, theirs in zip(filling.ranges(), ranged(made), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        filling._ranges = None


def test_hybrid_fills_its_buffer_bit_by_bit(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact, hybrid = (
        Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode=mode, device="gpu") for mode in ("exact", "hybrid")
    )
    wanted = exact.render(size=SIZE)
    parts_of = shader.Pace.parts

    def one_at_a_time(self: shader.Pace, total: int, seconds: float = 1.0, limit: float = np.inf) -> Any:
        return parts_of(self, total, seconds) if limit == np.inf else iter([(0, 1)])

    monkeypatch.setattr(shader.Pace, "parts", one_at_a_time)
    parts = [0.0]
    while parts[-1] < 1:
        np.testing.assert_array_equal(hybrid.render(size=SIZE).light, wanted.light)  # it is read once it is complete
        parts.append(hybrid.fill(seconds=1e-9))
    assert len(parts) == np.prod([-(-n // 16) for n in SHAPE]) + 1
    assert np.diff(parts).min() > 0
    assert hybrid.fill() == 1.0
    assert apart(hybrid.render(size=SIZE), wanted) > 40
    held = hybrid._held
    assert held is not None
    put(gpu, held.volume.warped, np.full_like(cloud, 0.9))
    assert apart(hybrid.render(size=SIZE), wanted) < 25


def test_scenes_of_one_volume_take_turns_with_its_buffer(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation) -> None:
    one = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode="hybrid", device="gpu")
    more = bent.grab((10, 10, 10), by=(0, 3, 0), radius=7, reach=None)
    other = one.deformed(more)
    assert other._held is not None
    assert one._held is not None
    assert other._held.volume is one._held.volume  # nothing went to the GPU again
    for scene, d in ((one, bent), (other, more), (one, bent)):
        assert scene._held is not None
        assert scene._held.filling is not None
        assert scene._held.filling.part == 0.0
        wanted = Scene(cloud, GEOMETRY, deformation=d, transfer=SOFT, mode="exact").render(size=SIZE)
        assert apart(scene.render(size=SIZE), wanted) > 40
        assert scene.fill(seconds=60.0) == 1.0
        assert apart(scene.render(size=SIZE), wanted) > 40
    plain = one.deformed(None)
    assert apart(plain.render(size=SIZE), Scene(cloud, GEOMETRY, transfer=SOFT).render(size=SIZE)) > 50
    with pytest.raises(SuppleError, match="the deformation must be one of shape"):
        one.deformed(supple.Deformation((5, 6, 7), border=64, on_fold="damp"))


def test_what_scenes_hold_is_freed(gpu: Gpu) -> None:
    import wgpu

    given = np.zeros((80, 80, 80), np.float32)  # 4 MB, with its buffer
    given[25:56, 25:56, 25:56] = 1.0
    scene = Scene(given, mode="hybrid", device="gpu")
    d = supple.Deformation(given.shape, border=None, on_fold="damp")

    def work(k: int) -> None:
        other = Scene(
            given,
            deformation=d.grab((40, 40, 40), by=(k % 3, 1, 2), radius=25, reach=None),
            mode="hybrid",
            device="gpu",
        )
        other.fill(seconds=0.0)
        other.render(size=SIZE)
        scene.deformed(other.deformation).render(size=SIZE)

    def held() -> tuple[int, int]:
        """Bytes on the device, and of arrays here. Not the process's own: drivers keep some for each of our calls."""
        counts = wgpu.diagnostics.object_counts.get_dict()
        return sum(counts[kind]["resource_mem"] for kind in ("Buffer", "Texture")), tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        for k in range(3):
            work(k)
        before = held()
        for k in range(6):
            work(k)
        after = held()
    finally:
        tracemalloc.stop()
    assert after[0] <= before[0]
    assert after[1] < before[1] + given.nbytes


@pytest.fixture
def rough() -> supple.Deformation:
    """A stroke smaller than a block of the buffer."""
    return supple.Deformation((30, 30, 30), border=8, on_fold="damp").grab(
        (15, 15, 15), by=(4, 0, 0), radius=2.5, reach=None
    )


@pytest.fixture
def ball() -> np.ndarray:
    z, y, x = np.indices((30, 30, 30))
    return np.clip(220 - 18 * np.sqrt((x - 15) ** 2 + (y - 14) ** 2 + (z - 15) ** 2), 0, 255).astype(np.uint8)


def test_a_buffered_scene_keeps_its_word_beside_others(gpu: Gpu, ball: np.ndarray, rough: supple.Deformation) -> None:
    options: dict[str, Any] = {"transfer": SOFT, "mode": "buffered", "tolerance": 0.02}
    ours = Scene(ball, deformation=rough, **options)
    theirs = Scene(ball, deformation=rough, device="gpu", **options)
    wanted = ours.render(size=SIZE)
    assert apart(theirs.render(size=SIZE), wanted) > 45
    other = theirs.deformed(rough.grab((15, 8, 15), by=(-6, 3, 5), radius=7, reach=None))
    assert apart(other.render(size=SIZE), wanted) < 40
    assert apart(theirs.render(size=SIZE), wanted) > 45


def test_a_buffered_scene_that_cannot_be_filled_again_is_the_cpu_s(
    gpu: Gpu, ball: np.ndarray, rough: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    options: dict[str, Any] = {"transfer": SOFT, "tolerance": 0.02}
    theirs = Scene(ball, deformation=rough, mode="buffered", device="gpu", **options)
    other = theirs.deformed(rough.grab((15, 8, 15), by=(-6, 3, 5), radius=7, reach=None))  # takes the buffer

    def failing(self: solid.Filling, seconds: float = 0.0) -> float:
        raise MemoryError

    monkeypatch.setattr(solid.Filling, "advance", failing)
    with pytest.warns(DeviceWarning, match="the CPU does what .* cannot"):
        assert theirs.fill() == 1.0
    assert theirs.gpu is None
    assert other.gpu is gpu
    assert theirs.error == theirs.tolerance
    exact = Scene(ball, deformation=rough, mode="exact", **options).render(size=SIZE)
    np.testing.assert_array_equal(theirs.render(size=SIZE).light, exact.light)


def test_the_cpu_sees_what_a_buffer_shows(
    gpu: Gpu, ball: np.ndarray, rough: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    options: dict[str, Any] = {"deformation": rough, "transfer": SOFT, "tolerance": 0.02}
    exact = Scene(ball, mode="exact", **options)
    theirs = Scene(ball, mode="buffered", device="gpu", **options)
    one, other = (scene.pick(Camera(), SIZE, (20, 15)) for scene in (exact, theirs))
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.index, other.index, atol=0.05)

    def lost(*rest: object) -> None:
        raise RuntimeError("Parent device is lost")

    monkeypatch.setattr("supple.gpu.raymarch._march", lost)
    with pytest.warns(DeviceWarning, match="device is lost"):
        made = theirs.render(size=SIZE)
    assert apart(made, exact.render(size=SIZE)) > 45
    monkeypatch.undo()
    # Other strokes are another scene, on the device that is opened anew.
    again = theirs.deformed(rough)
    assert again.gpu is devices.open_gpu()
    assert again.gpu is not theirs._held.volume.gpu  # type: ignore[union-attr]


def test_a_fill_that_is_interrupted_leaves_no_wrong_map(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode="hybrid", device="gpu")
    wanted = one.render(size=SIZE)
    assert one.fill(seconds=60.0) == 1.0
    other = one.deformed(bent.grab((13, 15, 11), by=(0, -6, 3), radius=8, reach=None))
    assert other.fill(seconds=60.0) == 1.0
    made = solid.Filling._make
    calls = []

    def interrupted(self: solid.Filling, first: int, count: int, lost: Any) -> None:
        calls.append(count)
        if len(calls) > 1:
            raise KeyboardInterrupt
        made(self, first, count, lost)

    monkeypatch.setattr(solid.Filling, "_make", interrupted)
    held = one._held
    assert held is not None
    assert held.filling is not None
    held.filling._pace = shader.Pace(1)
    with pytest.raises(KeyboardInterrupt):
        one.fill(seconds=60.0)
    monkeypatch.undo()
    assert 0.0 < held.filling.part < 1.0
    assert apart(one.render(size=SIZE), wanted) > 40


def test_a_fill_takes_no_longer_than_it_may(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("supple.gpu.shader.time.perf_counter", lambda: clock[0])
    pace = shader.Pace(1)

    def spent(limit: float) -> float:
        start = clock[0]
        for _, count in pace.parts(10_000, min(limit, 0.25), limit):
            clock[0] += count / 1024
        return clock[0] - start

    assert spent(0.004) <= 0.004
    assert 0.05 < spent(0.1) <= 0.1
    assert spent(0.004) <= 0.004
    assert spent(0.0) == 1 / 1024  # one, at least


def test_a_scene_whose_fill_fails_stays_exact(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode="hybrid", device="gpu")
    wanted = scene.render(size=SIZE)

    def failing(self: solid.Filling, seconds: float) -> float:
        raise MemoryError

    monkeypatch.setattr(solid.Filling, "advance", failing)
    with pytest.warns(DeviceWarning, match="does not go on with the buffer"):
        assert scene.fill() == 1.0
    assert scene.fill() == 1.0  # and says so once
    np.testing.assert_array_equal(scene.render(size=SIZE).light, wanted.light)
    for seconds in (float("nan"), -1.0, "a"):
        with pytest.raises(SuppleError, match="seconds must be a number of seconds from 0"):
            scene.fill(seconds=seconds)  # type: ignore[arg-type]


def test_what_does_not_fit_twice_stays_exact(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    gentle = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, on_fold="damp").grab(
        (13, 14, 11), by=(2, 1, 0), radius=40, reach=None
    )
    asked: list[Any] = []

    def full(gpu: Gpu, shape: Any, *rest: Any, **options: Any) -> Any:
        asked.append(shape)
        raise MemoryError

    monkeypatch.setattr(solid, "solid", full)
    scene = Scene(cloud, GEOMETRY, deformation=gentle, transfer=SOFT, mode="hybrid", device="gpu")
    assert scene.gpu is gpu
    assert scene.fill() == 1.0
    wanted = Scene(cloud, GEOMETRY, deformation=gentle, transfer=SOFT).render(size=SIZE)
    assert apart(scene.render(size=SIZE), wanted) > 45
    # With other strokes, nothing goes there again, nor is there asked for more.
    assert scene.deformed(gentle).gpu is gpu
    assert asked == [SHAPE]
    with pytest.warns(DeviceWarning, match="no memory left for a deformed volume"):
        assert Scene(cloud, GEOMETRY, deformation=gentle, transfer=SOFT, mode="buffered", device="gpu").gpu is None
