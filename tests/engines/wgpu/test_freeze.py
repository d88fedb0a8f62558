"""What is frozen on the GPU: points, pixels bit for bit, the tolerance at every pixel, renderings, and the window."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

import supple
from supple import Freeze, SuppleError
from supple.engines.wgpu import field, fill, kernel, solid, volume
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.plate import Plate, Sight
from supple.engines.wgpu.screen import canvas_texture, pixels_of
from supple.errors import DeviceWarning
from supple.render.camera import Camera
from supple.render.scene import MODES, Scene
from tests import reference
from tests.engines.wgpu.scenes import GEOMETRY, SHAPE, SIZE, SOFT, apart

pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning", "ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]


def ball(shape: tuple[int, ...], at: Any, radius: float) -> npt.NDArray[np.bool_]:
    places = np.stack(np.indices(shape), -1)
    return np.asarray(np.linalg.norm(places - np.array(at) * (np.array(shape) - 1), axis=-1) < radius)


def held(shape: tuple[int, ...], spacing: Any = 1.0, **options: Any) -> supple.Deformation:
    """Return two strokes across what is frozen."""
    mask = Freeze.of(ball(shape, 0.35, 0.2 * min(shape)), width=7.0, spacing=spacing)
    d = supple.Deformation(shape, spacing=spacing, freeze=mask, **options)
    size = np.array(shape[::-1]) - 1.0
    turned = {"axis": (1, 2, 3)} if len(shape) == 3 else {}
    d = d.grab(0.55 * size, by=-0.06 * size, radius=0.3 * float(size.min()) * min(d.domain.spacing))
    return d.twist(0.6 * size, angle=40, radius=0.4 * float(size.min()) * min(d.domain.spacing), reach=None, **turned)


def columns(d: supple.Deformation, points: Floats) -> Floats:
    made = np.zeros((len(points), 3))
    made[:, : d.ndim] = points * d.domain.spacing
    return made


@pytest.mark.parametrize("border", [None, 6.0])
@pytest.mark.parametrize(
    ("shape", "spacing"), [((80, 120), 1.0), ((1, 90), 1.0), ((30, 40, 50), (1.0, 0.7, 2.1)), ((20, 1, 40), 1.0)]
)
def test_points_there_and_back(gpu: Gpu, shape: tuple[int, ...], spacing: Any, border: float | None) -> None:
    if 1 in shape:
        size = np.array(shape[::-1]) - 1.0
        mask = Freeze.of(ball(shape, 0.35, 6), width=7.0)
        d = supple.Deformation(shape, border=border, freeze=mask)
        d = d.grab(0.55 * size, by=-0.06 * size, radius=12)
    else:
        d = held(shape, spacing, border=border)
    space, steps = d.space, np.array(d.domain.spacing)
    points = np.random.default_rng(1).uniform(-0.1, 1.1, (900, d.ndim)) * shape[::-1]
    # Except on a face, where the slope jumps.
    points = points[(np.abs(points - np.array(shape[::-1]) + 0.5) > 1e-3).all(axis=1)]
    anchors = columns(d, points)
    moved, jacobian = field.forward(gpu, space.table, space.axes, anchors, np.zeros_like(anchors), space.freeze)
    np.testing.assert_allclose((anchors + moved)[:, : d.ndim] / steps, d.forward(points), atol=1e-4)
    slopes = jacobian[:, : d.ndim, : d.ndim] * (steps[None, :] / steps[:, None])
    strokes = reference.carried_out(d)
    np.testing.assert_allclose(slopes, reference.jacobian(strokes, d.domain, points), atol=1e-3)
    inside = ((points > 0.1) & (points < np.array(shape[::-1]) - 1.1)).all(axis=1)
    step = 1e-2 * float(steps.min())
    for axis in range(d.ndim):  # by central differences of the device's own T
        off = np.zeros_like(anchors)
        off[:, axis] = step
        ends = [field.forward(gpu, space.table, space.axes, anchors, o, space.freeze)[0] for o in (off, -off)]
        np.testing.assert_allclose(((ends[0] - ends[1]) / (2 * step))[inside], jacobian[inside, :, axis], atol=2e-2)
    shift, residual, _ = field.inverse(gpu, space.table, space.axes, anchors, 1e-4, space.freeze)
    np.testing.assert_allclose((anchors + shift)[:, : d.ndim] / steps, d.inverse(points).points, atol=2e-3)
    assert residual.max() < 2e-3


def test_far_from_the_origin_it_is_as_exact(gpu: Gpu) -> None:
    shape = (60, 16000)
    mask = np.zeros(shape, bool)
    mask[10:50, 15000:15400] = True
    d = supple.Deformation(shape, freeze=Freeze.of(mask, width=4.4)).grab((15415, 30), by=(-0.5, 0.2), radius=60)
    points = np.random.default_rng(0).uniform((15390, 5), (15410, 55), (500, 2))
    anchors = np.floor(columns(d, points))
    offsets = columns(d, points) - anchors
    moved, _ = field.forward(gpu, d.space.table, d.space.axes, anchors, offsets, d.space.freeze)
    np.testing.assert_allclose((anchors + moved)[:, :2], d.forward(points), atol=2e-5)
    assert np.abs(d.forward(points) - points).max() > 0.2


@pytest.mark.parametrize("shape", [(40, 70), (3, 40, 30), (9, 1, 33)])
def test_calm_is_the_distance_to_where_m_varies(gpu: Gpu, shape: tuple[int, ...]) -> None:
    d = supple.Deformation(shape, freeze=ball(shape, 0.4, 6))
    mask = d.space.freeze
    assert mask is not None
    given = mask.coefficients
    packed = field.packed_mask(gpu, mask)[: given.size].reshape(given.shape)
    np.testing.assert_array_equal(packed & 255, given)
    spans = [range(1, n - 2) if n > 1 else range(1) for n in given.shape]
    cells = np.stack(np.meshgrid(*spans, indexing="ij"), -1).reshape(-1, 3)
    wide = [4 if n > 1 else 1 for n in given.shape]
    before = np.array([1 if n > 1 else 0 for n in given.shape])
    varies = []
    for cell in cells:
        around = given[tuple(slice(i, i + n) for i, n in zip(cell - before, wide, strict=True))]
        varies.append(np.ptp(around) > 0)
    rough = cells[np.array(varies)]
    assert len(rough)
    for cell in cells:
        away = int(np.abs(rough - cell).max(axis=1).min())
        assert packed[tuple(cell)] >> 8 == (0 if away == 0 else 1 << min(away.bit_length() - 1, 7))


def drawn(seed: int, kind: str) -> tuple[supple.Deformation, npt.NDArray[np.bool_]]:
    """Return random strokes and a random mask, and what is frozen."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(60, 160, 2).tolist())
    if kind != "image":
        shape = (int(rng.integers(3, 7)), *shape)
    lies = shape[-2:] if kind == "clip" else shape
    mask = np.zeros(lies, bool)
    for _ in range(2):
        mask |= ball(lies, rng.uniform(0.1, 0.9, len(lies)), rng.uniform(0.05, 0.25) * min(shape[-2:]))
    spacing = (1.0,) * 3 if kind == "clip" else tuple(np.exp(rng.uniform(-0.3, 0.3, len(shape))).tolist())
    width = float(np.exp(rng.uniform(np.log(4), np.log(100))))
    freeze = Freeze.of(mask, width=width, spacing=spacing[: len(lies)])
    border = ("auto", None, 5.0)[rng.integers(3)]
    d = supple.Deformation(shape, spacing=spacing[: len(shape)], border=border, freeze=freeze, time=kind == "clip")
    for _ in range(rng.integers(1, 4)):
        at = rng.uniform(0.2, 0.8, len(shape)) * shape[::-1]
        radius, reach = float(rng.uniform(10, 60)), (None, 1.5, 4.0)[rng.integers(3)]
        try:
            if rng.integers(3):
                by = rng.normal(size=len(shape)) * radius / 4 * np.array([1, 1, 0.05])[: len(shape)]
                d = d.grab(at, by=by, radius=radius, reach=reach)
            else:
                axis = {} if len(shape) == 2 else {"axis": (0, 0, 1)}
                d = d.twist(at, angle=float(rng.uniform(-60, 60)), radius=radius, reach=reach, **axis)
        except SuppleError as error:
            if "squeezes" not in str(error) and "cannot arrive" not in str(error):
                raise
            reject()
    return d, np.broadcast_to(mask, shape)


@pytest.mark.parametrize("kind", ["image", "clip", "volume"])
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), tolerance=st.sampled_from([0.005, 0.01, 0.1]))
def test_every_pixel_is_within_the_tolerance_and_what_is_frozen_stays(
    gpu: Gpu, kind: str, seed: int, tolerance: float
) -> None:
    d, mask = drawn(seed, kind)
    if d.is_identity:
        reject()
    q = reference.grid(d.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeviceWarning)  # what float32 cannot solve is the CPU's
        # What is warped is where each sample lies.
        found = d.warp(q.astype(np.float32), device="gpu", filter="linear", alpha=False, tolerance=tolerance)
        noise = np.random.default_rng(seed).integers(0, 65536, d.shape, np.uint16)
        made = d.warp(noise, device="gpu", filter="auto", tolerance=tolerance)
    np.testing.assert_array_equal(made[mask], noise[mask])
    np.testing.assert_array_equal(found[mask], q[mask])
    # By T itself, in float64; samples beyond an edge are as on it.
    points = found.astype(np.float64)
    within = ((points > 1e-3) & (points < np.array(d.shape[::-1]) - 1.001)).all(axis=-1)
    gap = d.forward(points[within]) - q[within]
    off = np.linalg.norm(np.linalg.solve(d.jacobian(points[within]), gap[..., None])[..., 0], axis=-1)
    assert off.max(initial=0) < 1.05 * tolerance + 1e-4


def test_a_picture_that_is_frozen_as_a_whole_is_copied(gpu: Gpu) -> None:
    d = supple.Deformation((60, 70), freeze=np.ones((60, 70), bool)).grab((30, 30), by=(9, 4), radius=20, reach=None)
    noise = np.random.default_rng(0).normal(size=(60, 70)).astype(np.float32)
    np.testing.assert_array_equal(d.warp(noise, device="gpu"), noise)


def test_a_mask_that_does_not_fit_is_the_cpu_s(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    d = held((80, 120))
    monkeypatch.setattr(gpu, "binding", 600)
    with pytest.raises(MemoryError, match="MB of a freeze mask are more than a shader takes"):
        field.packed_mask(gpu, d.space.freeze)
    noise = np.random.default_rng(0).integers(0, 255, (80, 120), np.uint8)
    with pytest.warns(DeviceWarning, match="of a freeze mask"):
        made = d.warp(noise, device="gpu")
    np.testing.assert_array_equal(made, d.warp(noise))


def test_maps_beside_a_mask_are_refused(gpu: Gpu) -> None:
    moved = held((80, 120)).affine([[1, 0, 3.0], [0, 1, -2.0]])
    with pytest.raises(SuppleError, match="for fields, affine maps, output grids and sheared"):
        moved.warp(np.zeros((80, 120), np.uint8), device="gpu")


# ---- renderings -----------------------------------------------------------------------------------------------------


def bent_cloud(radius: float) -> supple.Deformation:
    mask = Freeze.of(ball(SHAPE, (0.5, 0.35, 0.4), radius), width=14.0, spacing=GEOMETRY.spacing)
    d = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, freeze=mask)
    return d.grab((16, 16, 11), by=(-1.6, -1.2, 0.5), radius=12, reach=None)


@pytest.mark.parametrize("mode", MODES)
def test_a_rendering_is_the_cpu_s(gpu: Gpu, cloud: np.ndarray, mode: str) -> None:
    options: dict[str, Any] = {"transfer": SOFT, "mode": mode, "tolerance": 0.1}
    d, free, camera = bent_cloud(5), bent_cloud(0), Camera(azimuth=25, elevation=20)
    one, other, third = (
        Scene(cloud, GEOMETRY, deformation=bent, device=device, **options).render(camera, SIZE)
        for bent, device in ((d, "cpu"), (d, "gpu"), (free, "gpu"))
    )
    assert apart(one, other) > 50
    assert apart(other, third) < 45


@pytest.mark.parametrize("polished", [False, True])
def test_frozen_voxels_are_those_of_the_volume(gpu: Gpu, cloud: np.ndarray, polished: bool) -> None:
    d = bent_cloud(5)
    space, held_ = d.space, volume.hold(gpu, cloud)
    assert volume.beside(held_)
    lattice, *_ = solid.solve(gpu, space.table, space.axes, SHAPE, 4 if polished else 2, space.freeze)
    assert fill.Filling(held_, lattice, polished=polished, tolerance=0.01).advance(60.0) == 1.0
    pitch = -(-4 * SHAPE[2] // 256) * 256
    made = kernel.room(gpu, pitch * SHAPE[1] * SHAPE[0])
    encoder = gpu.device.create_command_encoder()
    layout = {"buffer": made, "bytes_per_row": pitch, "rows_per_image": SHAPE[1]}
    encoder.copy_texture_to_buffer({"texture": held_.warped}, layout, held_.warped.size)
    gpu.device.queue.submit([encoder.finish()])
    found = kernel.download(gpu, made, np.float32, pitch * SHAPE[1] * SHAPE[0] // 4)
    found = found.reshape(SHAPE[0], SHAPE[1], pitch // 4)[..., : SHAPE[2]]
    still = ball(SHAPE, (0.5, 0.35, 0.4), 5)
    np.testing.assert_array_equal(found[still], cloud[still])
    away = np.abs(found - d.warp(cloud, filter="linear", tolerance=1e-3))
    assert away.max() < (0.02 if polished else 0.1)
    assert np.abs(found - cloud).max() > 0.1


# ---- the window -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solved", [True, False])
def test_a_window_shows_what_is_frozen_as_it_is(gpu: Gpu, solved: bool) -> None:
    shape = (90, 120)
    y, x = np.mgrid[: shape[0], : shape[1]]
    waves = [127 + 100 * np.sin(x / a) * np.cos(y / b) for a, b in ((9, 14), (15, 8), (20, 20))]
    photo = np.dstack([*waves, np.full(shape, 255.0)]).astype(np.uint8)
    d, plate = held(shape), Plate(gpu, shape[::-1])
    plate.put(0, photo)
    texture, space = canvas_texture(gpu, shape[::-1]), d.space
    sight = Sight((0.0, 0.0), 1.0, shape[::-1], solved=solved)

    def seen(freeze: Any) -> npt.NDArray[np.int64]:
        plate.draw(sight, space.table, space.axes, texture, freeze=freeze)
        return pixels_of(gpu, texture).astype(int)[..., :3]

    for _ in range(2):  # the mask is told apart from none
        made, mask = seen(space.freeze), ball(shape, 0.35, 0.2 * min(shape))
        assert np.abs(made - photo[..., :3])[mask].max() <= 1
        # Also while it is dragged, what is beside it is solved.
        away = np.abs(made - d.warp(photo[..., :3], filter="linear"))[~mask]
        assert np.quantile(away, 0.98) <= 5
        assert np.abs(seen(None) - photo[..., :3])[mask].max() > 20
