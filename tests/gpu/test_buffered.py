"""Lattices and buffers of warped volumes on the GPU: what they hold, and when they are filled."""

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
from supple.render import device as drawing
from supple.render.camera import Camera
from supple.render.scene import Scene
from tests import reference
from tests.gpu.scenes import GEOMETRY, SHAPE, SIZE, SOFT, apart, texels_of


def displaced(nodes: np.ndarray, step: float, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u and ∂p/∂q between the nodes of a lattice, as solid.wgsl has them."""
    v = np.clip(np.asarray(point, np.float64) / step, 0, np.array(nodes.shape[2::-1]) - 1)
    i = np.minimum(v.astype(int), np.array(nodes.shape[2::-1]) - 2)
    s = v - i
    cell = nodes[i[2] : i[2] + 2, i[1] : i[1] + 2, i[0] : i[0] + 2].reshape(2, 2, 2, 4, 4)[..., :3].astype(np.float64)
    u, slopes = cell[..., 0, :], cell[..., 1:, :]
    for axis, k in ((2, 0), (1, 1), (0, 2)):  # x, y and z
        ends = [np.take(u, n, axis=axis) for n in (0, 1)]
        tilts = [np.take(slopes, n, axis=axis) for n in (0, 1)]
        bow = 0.5 * step * s[k] * (1 - s[k]) * (tilts[0][..., k, :] - tilts[1][..., k, :])
        u = (1 - s[k]) * ends[0] + s[k] * ends[1] + bow
        slopes = (1 - s[k]) * tilts[0] + s[k] * tilts[1]
    return u, slopes.T


def test_nodes_are_the_inverse_and_its_derivatives(gpu: Gpu, bent: supple.Deformation) -> None:
    space, strokes = bent.space, reference.carried_out(bent)
    errors, lengths = [], []
    for step in (2, 4):
        lattice = solid.solve(gpu, space.table, space.axes, SHAPE, step)
        nodes, error, smooth = lattice.nodes, lattice.error, lattice.smooth
        assert nodes is not None
        q = step * reference.grid(nodes.shape[:3])
        p = reference.inverse(strokes, bent.domain, q)
        np.testing.assert_allclose(nodes[..., :3], p - q, atol=2e-4)
        columns = np.moveaxis(reference.matrices(strokes, bent.domain, p), -1, -2)
        np.testing.assert_allclose(nodes[..., 4:].reshape(*q.shape[:3], 3, 4)[..., :3], columns, atol=2e-4)
        # The error that is seen, with its reserve, is more than that at any voxel.
        far = reference.grid(SHAPE)
        found = np.array([displaced(nodes, step, point)[0] for point in far.reshape(-1, 3)[::7]])
        off = found + far.reshape(-1, 3)[::7] - reference.inverse(strokes, bent.domain, far).reshape(-1, 3)[::7]
        assert np.linalg.norm(off, axis=1).max() < error
        errors.append(error)
        lengths.append(smooth)
    assert 3 < errors[1] / errors[0] < 30
    assert lengths[0] == pytest.approx(lengths[1], rel=0.3)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int16, np.float32])
@pytest.mark.parametrize("polished", [False, True])
def test_the_buffer_is_the_warped_volume(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, dtype: Any, polished: bool
) -> None:
    given = (cloud * 200 - (100 if np.dtype(dtype).kind == "i" else 0)).astype(dtype)
    held = solid.hold(gpu, given)
    assert solid.beside(held)
    space = bent.space
    # What is solved for each voxel does not need a fine lattice.
    lattice = solid.solve(gpu, space.table, space.axes, SHAPE, 8 if polished else 2)
    filling = solid.Filling(held, lattice, polished=polished, tolerance=0.01)
    assert filling.part == 0.0
    assert filling.advance(60.0) == filling.part == 1.0
    wanted = bent.warp(given.astype(np.float32), filter="linear", tolerance=1e-3)
    away = np.abs(texels_of(gpu, held.warped) - wanted)
    assert away.max() < 0.3
    assert np.mean(away) < 0.01


def test_hybrid_fills_its_buffer_bit_by_bit(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact, hybrid = (
        Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode=mode, device="gpu") for mode in ("exact", "hybrid")
    )
    wanted, lattice = exact.render(size=SIZE), hybrid.render(size=SIZE)
    assert apart(lattice, wanted) > 40
    parts_of = shader.Pace.parts

    def one_at_a_time(self: shader.Pace, total: int, seconds: float = 1.0, limit: float = np.inf) -> Any:
        return parts_of(self, total, seconds) if limit == np.inf else iter([(0, 1)])

    monkeypatch.setattr(shader.Pace, "parts", one_at_a_time)
    parts = [0.0]
    while parts[-1] < 1:
        np.testing.assert_array_equal(hybrid.render(size=SIZE).light, lattice.light)  # it is read once it is complete
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
    """A stroke that is too small for any lattice."""
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
    assert theirs._lattice is not None
    assert theirs._lattice.error > theirs.tolerance  # or this proves nothing
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


def test_a_fill_that_fails_leaves_the_lattice(
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


def test_what_does_not_fit_twice_is_a_lattice(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    gentle = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, on_fold="damp").grab(
        (13, 14, 11), by=(2, 1, 0), radius=40, reach=None
    )
    asked: list[Any] = []
    texture = solid.solid

    def full(gpu: Gpu, shape: Any, *rest: Any, **options: Any) -> Any:
        if shape != SHAPE:  # of a lattice
            return texture(gpu, shape, *rest, **options)
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
    # Nor is there a finer lattice than there is room for.
    monkeypatch.setattr("supple.gpu.memory.DEEP", 30)
    with pytest.warns(supple.ToleranceWarning, match="the lattice may be off"):
        coarse = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode="hybrid", device="gpu")
    assert coarse.gpu is gpu
    assert coarse.error > coarse.tolerance


def test_a_lattice_is_as_fine_as_there_is_room_for(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    d = supple.Deformation((40, 40, 40), border=None, on_fold="damp").grab(
        (20, 20, 20), by=(4, -3, 2), radius=9, reach=None
    )
    solve, asked = solid.solve, []

    def no_finer(gpu: Gpu, table: Any, axes: Any, shape: Any, step: int, freeze: Any) -> Any:
        asked.append(step)
        if step < 4:
            raise MemoryError
        return solve(gpu, table, axes, shape, step, freeze)

    monkeypatch.setattr(drawing, "solve", no_finer)
    found = drawing.lattice_of(gpu, d.space, 0.02)
    assert asked == [8, 2, 4, 2]
    assert found.step == found.settings["spread"] == 4
    assert 0.02 < found.error < 0.5


def _of(scene: Scene, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a scene's lattice says of a point: u and ∂p/∂q."""
    assert scene._lattice is not None
    return displaced(scene._lattice.nodes, scene._lattice.step, point)


@pytest.mark.parametrize(("radius", "by", "cells"), [(12, (4, -3, 2), 2), (10, (4, -3, 2), 1), (18, (6, -4, 3), 2)])
def test_the_error_is_that_along_rays(gpu: Gpu, radius: float, by: tuple[float, ...], cells: int) -> None:
    n = 48
    d = supple.Deformation((n, n, n), border=None, on_fold="damp").grab((22, 24, 25), by=by, radius=radius, reach=None)
    scene = Scene(np.zeros((n, n, n), np.float32), deformation=d, mode="hybrid", device="gpu")
    assert scene._held is not None
    assert scene._lattice is not None
    assert scene._held.cells == cells
    assert scene._lattice is not None
    rng = np.random.default_rng(0)
    starts = rng.uniform(0, n - 1, (2000, 3)).astype(np.float32)
    ways = rng.normal(size=(2000, 3)).astype(np.float32)
    ways *= min(cells * scene._lattice.step, 8.0) / np.linalg.norm(ways, axis=1)[:, None]
    points, sources = [], []
    for start, way in zip(starts, ways, strict=True):
        if not ((start + way >= 0) & (start + way <= n - 1)).all():
            continue
        # As raymarch.wgsl goes along a ray from one end of a stretch to the other.
        (first, slopes), (last, others) = _of(scene, start), _of(scene, start + way)
        rise = last - first
        a, b = slopes @ way - way - rise, rise - others @ way + way
        for s in (0.25, 0.5, 0.75):
            points.append(start + s * way)
            sources.append(points[-1] + first + s * (rise + (1 - s) * ((1 - s) * a + s * b)))
    seen = np.linalg.norm(d.inverse(np.array(points)).points - np.array(sources), axis=1).max()
    assert 0.2 * scene.error < seen <= scene.error <= scene.tolerance
