"""Shaders and whole warps of images and frames against the slow reference, on whatever adapter there is, or none."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import supple
from supple import _core
from supple.cli import command
from supple.domain import Domain
from supple.engines.choice import gpu_of
from supple.engines.wgpu import device as devices
from supple.engines.wgpu import field, kernel, pyramid
from supple.engines.wgpu import raymarch as shading
from supple.engines.wgpu import warp as warping
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.fill import BLOCK
from supple.engines.wgpu.samples import STEP, GpuGroup, Wanted, format_of
from supple.engines.wgpu.texels import layers
from supple.errors import DeviceWarning, FoldWarning, SuppleError
from supple.media import image
from tests import reference


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    return image.read(Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg").pixels[:120, :165]


def bent(
    shape: tuple[int, ...], seed: int, count: int = 3, spacing: Any = 1.0, border: float | None = 20.0, **rest: Any
) -> supple.Deformation:
    """Return some strokes of all kinds; ``rest`` are the border's profile, and the least reach of a stroke."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    reach = rest.pop("reach", None)
    d = supple.Deformation(shape, border=border, spacing=spacing, **{"on_fold": "damp", **rest})
    for _ in range(count):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FoldWarning)
            d = d.grab(
                rng.uniform(0.2, 0.8, len(shape)) * size,
                by=rng.normal(0, 0.06, len(shape)) * size,
                radius=float(rng.uniform(0.1, 0.3) * size.min()),
                scales=int(rng.integers(1, 4)),
                poisson=float(rng.uniform(0, 0.5)),
                reach=None if reach is None else reach + float(rng.uniform(0, 2)),
            )
    return d


def truth(d: supple.Deformation, source: np.ndarray, **options: Any) -> np.ndarray:
    """Return what the reference makes of an array."""
    make = reference.warp if d.ndim == 2 else reference.warp_frames
    return make(source, reference.carried_out(d), d.domain, **options)


def away(made: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return by how much two arrays differ."""
    assert (made.dtype, made.shape) == (wanted.dtype, wanted.shape)
    return np.abs(made.astype(np.float64) - wanted.astype(np.float64))


def columns(d: supple.Deformation, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points as anchors, which are whole pixels, and what is left of them, in physical units."""
    out = np.zeros((2, len(points), 3))
    whole = np.rint(points)
    for k, part in enumerate((whole, points - whole)):
        out[k, :, : d.ndim] = part * d.domain.spacing
    return out[0], out[1]


WAYS: list[dict[str, Any]] = [
    {"border": None},
    {"border": 20.0},
    {"border": 20.0, "border_profile": "sine"},
    {"border": None, "reach": 1.0},
    {"border": 20.0, "reach": 1.5},
]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("shape", "spacing"), [((200, 300), 1.0), ((40, 60, 80), (1.0, 0.7, 2.1))])
def test_points_move_as_they_should(gpu: Gpu, shape: tuple[int, ...], spacing: Any, way: dict[str, Any]) -> None:
    d = bent(shape, 1, 4, spacing, **way)
    strokes = reference.carried_out(d)
    points = np.random.default_rng(2).uniform(-0.1, 1.1, (2000, d.ndim)) * np.array(shape[::-1])
    anchors, offsets = columns(d, points)
    moved, jacobian = field.forward(gpu, d.space.table, d.space.axes, anchors, offsets)
    steps = np.array(d.domain.spacing)
    n = d.ndim
    np.testing.assert_allclose(
        (anchors + moved)[:, :n] / steps, reference.forward(strokes, d.domain, points), atol=1e-3
    )
    scaled = jacobian[:, :n, :n] * (steps[None, :] / steps[:, None])
    np.testing.assert_allclose(scaled, reference.jacobian(strokes, d.domain, points), atol=3e-4)
    # And the Jacobian is that of the shader's own T: central differences, but for kinks of the border.
    h = 0.05
    apart = []
    for axis in range(n):
        more, less = offsets.copy(), offsets.copy()
        more[:, axis] += h * steps[axis]
        less[:, axis] -= h * steps[axis]
        ends = [field.forward(gpu, d.space.table, d.space.axes, anchors, o)[0] for o in (more, less)]
        slope = (ends[0] - ends[1])[:, :n] / (2 * h * steps[axis])
        apart.append(np.abs(slope - jacobian[:, :n, axis]).max(axis=1))
    assert np.quantile(np.max(apart, axis=0), 0.97) < 2e-3
    outside = ~reference.reached(strokes, d.domain, points)
    assert ("reach" in way) == bool(outside.any())
    np.testing.assert_array_equal(moved[outside], offsets[outside].astype(np.float32))
    np.testing.assert_array_equal(jacobian[outside, :n, :n], np.broadcast_to(np.eye(n), (int(outside.sum()), n, n)))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("flat", [True, False])
def test_points_are_sent_back(gpu: Gpu, flat: bool, way: dict[str, Any]) -> None:
    shape, spacing = ((200, 300), 1.0) if flat else ((40, 60, 80), (1.0, 0.7, 2.1))
    d = bent(shape, 11, 5, spacing, **way)
    strokes = reference.carried_out(d)
    targets = np.rint(np.random.default_rng(3).uniform(-0.1, 1.1, (400, d.ndim)) * np.array(shape[::-1]))
    anchors, _ = columns(d, targets)
    shift, residual, steps = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    found = (anchors + shift)[:, : d.ndim] / d.domain.spacing
    np.testing.assert_allclose(reference.forward(strokes, d.domain, found), targets, atol=2e-3)
    np.testing.assert_allclose(found, reference.inverse(strokes, d.domain, targets), atol=5e-3)
    assert residual.max() < 5e-3
    assert steps.max() < 200


def test_far_from_the_origin_the_residual_is_still_small(gpu: Gpu) -> None:
    # A picture of 16k pixels a side, where float32 holds coordinates to a thousandth of a pixel only.
    d = supple.Deformation((16384, 16384), border=64, on_fold="damp").grab(
        (15900.3, 16001.7), by=(60.5, -40.25), radius=120, reach=None
    )
    rng = np.random.default_rng(0)
    targets = np.rint(rng.uniform(15500, 16383, (4000, 2)))
    anchors, _ = columns(d, targets)
    shift, _, _ = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    off = reference.forward(d.strokes, d.domain, (anchors + shift.astype(np.float64))[:, :2]) - targets
    assert np.linalg.norm(off, axis=1).max() < 0.01


def squeezed(n: int, turns: int, radius: float) -> supple.Deformation:
    """Return strokes from all sides towards the middle, which shrink what lies there along both axes."""
    d = supple.Deformation((n, n), border=None, on_fold="damp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        for _ in range(turns):
            for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                at = n / 2 - 0.8 * radius * np.array(way)
                d = d.grab(at, by=0.6 * radius * np.array(way), radius=radius, reach=None)
    return d


@pytest.mark.parametrize("outside", ["edge", "reflect", "constant"])
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_residual_footprints_of_noise(gpu: Gpu, turns: int, outside: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (90, 90)).astype(np.float32)
    d = squeezed(90, turns, 16)
    strokes = reference.carried_out(d)
    sources = reference.inverse(strokes, d.domain, reference.grid((90, 90)))
    large, small = np.moveaxis(np.linalg.svd(reference.matrices(strokes, d.domain, sources), compute_uv=False), -1, 0)
    assert (large.max() ** 2 > 2.62) if turns == 1 else (small.max() ** 2 > (3.2 if turns == 2 else 4.0))
    made = d.warp(noise, device="gpu", outside=outside, fill=99)
    assert away(made, truth(d, noise, outside=outside, fill=99.0)).max() < 4
    # It matters: a cubic sees single samples.
    assert away(made, d.warp(noise, device="gpu", outside=outside, fill=99, filter="cubic")).max() > 20


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("rows", [(0, 37), (8, 28)])
def test_levels_average_two_by_two(gpu: Gpu, channels: int, rows: tuple[int, int]) -> None:
    source = np.random.default_rng(1).random((37, 22, channels)).astype(np.float32)
    wanted = Wanted("auto", "nothing", "edge", False, (0.0,) * channels, False, False, 1.0, 0.01, (0, 0))
    picture = GpuGroup((37, 22), channels, np.dtype(np.float32), wanted)
    form = picture.format
    held = layers(gpu, (rows[1] - rows[0], 22), 2, form.dtype, form.channels)
    held.put(gpu, 1, form.packed(source[slice(*rows)]))
    levels = pyramid.pyramid(gpu, picture, rows, 2)
    levels.build(held, 1)
    made = kernel.download(gpu, levels.buffer, np.float32, 2 * levels.stride * channels)
    made = made.reshape(2, levels.stride, channels)[1]
    truth_ = reference.pyramid(source.astype(np.float64))
    assert levels.count == len(truth_) - 1
    start = 0
    for k, level in enumerate(truth_[1:], 1):
        top, end = rows[0] >> k, -(-rows[1] >> k)
        found = made[start : start + (end - top) * level.shape[1]].reshape(end - top, -1, channels)
        start += (end - top) * level.shape[1]
        whole = slice(-(-rows[0] >> k), level.shape[0] if rows[1] == 37 else rows[1] >> k)  # all of their rows are here
        np.testing.assert_allclose(found[whole.start - top : whole.stop - top], level[whole], atol=1e-6)
    assert start == levels.stride


@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "auto"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32])
def test_pixels_outside_every_ball_are_copied(gpu: Gpu, dtype: Any, filter: str) -> None:
    rng = np.random.default_rng(4)
    source = (rng.normal(size=(75, 110, 4)) * 2e4).astype(dtype)
    d = supple.Deformation((75, 110), border=30, on_fold="damp").grab((80.3, 40), by=(4, -3), radius=7, reach=2.5)
    d = d.grab((70, 44), by=(-3, 5), radius=9, reach=2)
    made = d.warp(source, filter=filter, alpha=True, linear_light=np.dtype(dtype).kind == "u", device="gpu")
    inside = reference.reached(reference.carried_out(d), d.domain, reference.grid((75, 110)))
    assert 0.1 < inside.mean() < 0.4
    np.testing.assert_array_equal(made[~inside], source[~inside])
    assert (made[inside] != source[inside]).any(axis=-1).mean() > (0.2 if filter == "nearest" else 0.5)
    # One stroke without a limit reaches all of them.
    moved = d.grab((20, 20), by=(1, 1), radius=9, reach=None).warp(source, filter="cubic", device="gpu")
    assert (moved != source).any(axis=-1).mean() > 0.9


def test_frames_that_no_stroke_reaches_are_passed_on(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = np.random.default_rng(4).integers(0, 255, (30, 32, 40)).astype(np.uint8)
    d = supple.Deformation(clip.shape, border=8, on_fold="damp").grab((20, 16, 9), by=(2, 1, 1), radius=4, reach=1.5)
    solved: list[Any] = []
    solve = warping._Work.solve
    monkeypatch.setattr(warping._Work, "solve", lambda self, part: solved.append(part.planes) or solve(self, part))
    made = d.warp(clip, device="gpu")
    assert {k for first, last in solved for k in range(first, last)} == set(range(4, 15))
    assert away(made, truth(d, clip)).max() <= 1
    same = (made == clip).all(axis=(1, 2))
    assert same[[*range(4), *range(15, 30)]].all()
    assert not same[6:12].any()


def test_nearest_keeps_values(gpu: Gpu) -> None:
    rng = np.random.default_rng(0)
    labels = rng.choice([3, 40, 200], (90, 110)).astype(np.uint8)
    d = bent(labels.shape, 4)
    made = d.warp(labels, filter="nearest", device="gpu")
    assert set(np.unique(made)) == {3, 40, 200}
    # Whatever the opacity says, and light.
    colours = rng.choice([0, 9, 250], (90, 110, 4)).astype(np.uint8)
    for options in ({}, {"linear_light": True}):
        made = d.warp(colours, filter="nearest", device="gpu", **options)
        assert (made != truth(d, colours, filter="nearest", **options)).mean() < 4e-3


def test_long_stacks_go_through_a_window(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = np.random.default_rng(7).integers(0, 255, (40, 32, 48)).astype(np.uint8)
    d = supple.Deformation(clip.shape, border=None, on_fold="damp").grab(
        (24, 16, 20), by=(3, 2, 3), radius=6, scales=3, reach=None
    )
    ways: list[dict[str, Any]] = [
        {"filter": "linear"},
        {"filter": "cubic", "between": "cubic", "outside": "reflect"},
        {"filter": "auto", "outside": "constant"},
    ]
    whole = [d.warp(clip, device="gpu", **way) for way in ways]
    monkeypatch.setattr(gpu, "binding", 16 * 32 * 48)
    monkeypatch.setattr(gpu, "texture", 16 * 32 * 48)
    for way, made in zip(ways, whole, strict=True):
        np.testing.assert_array_equal(d.warp(clip, device="gpu", **way), made)
    # A window that is too small for what a plane is made of ends in the CPU's result.
    monkeypatch.setattr(gpu, "texture", 2 * 32 * 48)
    with pytest.warns(DeviceWarning, match="the CPU did what"):
        made = d.warp(clip, filter="linear", device="gpu")
    np.testing.assert_array_equal(made, d.warp(clip, filter="linear"))


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((24, 33000), np.uint8), ((8210, 33), np.float32), ((132000, 8), np.uint8), ((300, 24, 32), np.uint8)],
)
def test_more_than_a_layer_and_more_layers_than_a_texture_has(gpu: Gpu, shape: tuple[int, ...], dtype: Any) -> None:
    source = np.random.default_rng(9).integers(0, 255, shape).astype(dtype)
    d = supple.Deformation(shape, border=None, on_fold="damp")
    for corner in (
        ([8190.0, 20.0], [32990.0, 9.0], [16.0, 8190.0], [4.0, 8190.0], [4.0, 131990.0])
        if len(shape) == 2
        else ([16.0, 12.0, 150.0],)
    ):
        if all(c < n for c, n in zip(corner, shape[::-1], strict=True)):
            d = d.grab(corner, by=[5.3, 4.2, 90.0][: len(shape)], radius=9 if len(shape) == 2 else 90, reach=None)
    options: dict[str, Any] = {"filter": "linear", "outside": "reflect"}
    ours, theirs = d.warp(source, **options), d.warp(source, device="gpu", **options)
    assert (ours != source).any()
    assert np.abs(theirs.astype(np.float32) - ours.astype(np.float32)).max() <= 4


@pytest.mark.parametrize("outside", ["edge", "constant"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (33, 1), (17, 16), (16, 17), (2, 3, 2), (1, 20, 30)])
def test_odd_sizes(gpu: Gpu, shape: tuple[int, ...], outside: str) -> None:
    source = np.random.default_rng(8).integers(0, 255, shape).astype(np.uint8)
    centre = [(n - 1) / 2 for n in shape[::-1]]
    d = supple.Deformation(shape, border=None, on_fold="damp").grab(centre, by=[0.4] * len(shape), radius=5, reach=None)
    options: dict[str, Any] = {"filter": "linear", "outside": outside, "fill": 99}
    assert away(d.warp(source, device="gpu", **options), truth(d, source, **options)).max() <= 4


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_small_strokes_are_not_lost_between_nodes(gpu: Gpu, seed: int, limited: bool) -> None:
    rng = np.random.default_rng(seed)
    radius = float(0.6 * 2.2**seed)
    d = supple.Deformation((64, 64), border=None, on_fold="damp")
    by = rng.normal(size=2)
    by *= 0.6 * radius / np.linalg.norm(by)
    d = d.grab(rng.uniform(16, 48, 2), by=by, radius=radius, scales=1 + seed % 3, reach=2.0 if limited else None)
    ramps = np.stack(np.meshgrid(*[np.arange(64.0)] * 2), axis=-1).astype(np.float32)
    ours, theirs = truth(d, ramps, filter="linear"), d.warp(ramps, filter="linear", device="gpu")
    assert np.abs(ours - ramps).max() > 0.1 * radius
    assert np.abs(theirs - ours).max() < 0.011


def test_numbers_that_float32_does_not_hold_are_left_to_the_cpu(gpu: Gpu) -> None:
    source = np.random.default_rng(1).integers(0, 255, (40, 50)).astype(np.uint8)
    d = supple.Deformation(source.shape, spacing=1e13, border=None, on_fold="damp").grab(
        (25, 20), by=(4, 2), radius=12e13, reach=None
    )
    with pytest.raises(SuppleError, match="strokes of such sizes"):
        d.warp(source, device="gpu")
    # But large spacings do no harm by themselves.
    d = supple.Deformation(source.shape, spacing=1e4, border=None, on_fold="damp").grab(
        (25, 20), by=(4, 2), radius=12e4, reach=None
    )
    assert away(d.warp(source, filter="linear", device="gpu"), truth(d, source, filter="linear")).max() <= 3


def test_many_strokes_and_strong_ones(gpu: Gpu, photo: np.ndarray) -> None:
    d = supple.Deformation(photo.shape[:2], border=None, on_fold="damp")
    rng = np.random.default_rng(9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        for _ in range(12):
            d = d.grab(rng.uniform(30, 90, 2), by=rng.normal(0, 15, 2), radius=18, reach=None)
    apart = away(d.warp(photo, filter="linear", device="gpu"), truth(d, photo, filter="linear"))
    assert (apart > 4).mean() < 2e-3


def test_no_force_is_a_copy_and_out_is_filled(gpu: Gpu, photo: np.ndarray) -> None:
    still = supple.Deformation(photo.shape[:2], border=64, on_fold="damp")
    np.testing.assert_array_equal(still.warp(photo, device="gpu"), photo)
    d = bent(photo.shape[:2], 3)
    out = np.empty((165, 120, 3), np.uint8).transpose(1, 0, 2)
    assert d.warp(photo, device="gpu", out=out) is out
    np.testing.assert_array_equal(out, d.warp(photo, device="gpu"))


def test_what_the_gpu_does_not_do_is_refused_or_left_to_the_cpu(
    gpu: Gpu, photo: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    d = bent(photo.shape[:2], 3)
    monkeypatch.setattr("supple.engines.choice.open_gpu", lambda software=True: gpu)
    for source, options, named in (
        (photo.astype(np.float64), {}, "samples of float64 in 3 channels"),
        (np.dstack([photo, photo]), {}, "samples of uint8 in 6 channels"),
    ):
        with pytest.raises(SuppleError, match=named):
            d.warp(source, device="gpu", **options)
        np.testing.assert_array_equal(d.warp(source, device="auto", **options), d.warp(source, **options))
    with pytest.raises(SuppleError, match='device must be "auto" or "cpu" or "gpu" or "cuda"'):
        d.warp(photo, device="tpu")


def test_a_lost_device_ends_in_the_cpu_s_result(gpu: Gpu, photo: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*rest: object) -> None:
        raise RuntimeError("Parent device is lost")

    monkeypatch.setattr("supple.engines.wgpu.lattice.run", lost)
    d = bent(photo.shape[:2], 3)
    for warp in (d.warp, lambda image, device: supple.warp_batch(image[None], d, device=device)[0]):
        with pytest.warns(DeviceWarning, match="device is lost") as told:
            made = warp(photo, device="gpu")
        np.testing.assert_array_equal(made, d.warp(photo))
        assert told[0].filename == __file__


def test_a_device_that_is_lost_is_opened_anew(gpu: Gpu, photo: np.ndarray) -> None:
    d = bent(photo.shape[:2], 3)
    before = devices.open_gpu()
    before.device.destroy()
    with pytest.warns(DeviceWarning, match="the CPU did what"):
        d.warp(photo, device="gpu")
    assert devices.open_gpu() is not before
    assert away(d.warp(photo, filter="linear", device="gpu"), truth(d, photo, filter="linear")).max() <= 1


def test_drivers_that_fail_are_said_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    class Adapter:
        info: ClassVar = {"device": "Card", "adapter_type": "DiscreteGPU", "backend_type": "Vulkan"}
        limits: ClassVar[dict[str, int]] = {}
        features: ClassVar[set[str]] = set()

        def request_device_sync(self, **rest: object) -> None:
            raise RuntimeError("no\nqueue")

    monkeypatch.setattr(devices, "adapters", lambda: (Adapter(),))
    monkeypatch.setattr(devices, "_opened", {})
    with pytest.raises(SuppleError, match=r"Card cannot be opened \(no queue\)"):
        gpu_of("gpu")
    assert gpu_of("auto") is None


def test_functions_are_refused_and_bytes_stay_in_their_order(gpu: Gpu, photo: np.ndarray) -> None:
    d = bent(photo.shape[:2], 3)
    with pytest.raises(SuppleError, match="a function of points"):
        d.warp(lambda points: points[:, 0], device="gpu")
    swapped = photo.astype(">u2")
    made = d.warp(swapped, filter="linear", device="gpu", out=np.empty_like(swapped))
    assert made.dtype == swapped.dtype
    assert np.abs(made.astype(int) - truth(d, photo.astype(np.uint16), filter="linear")).max() <= 1


def shaders() -> list[str]:
    folder = Path(kernel.__file__).with_name("shaders")
    return [path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.wgsl"))]


def test_shaders_have_the_numbers_of_the_host() -> None:
    marching = kernel.source("raymarch")

    def said(text: str, name: str) -> float:
        found = re.search(rf"const {name} = ([-\w.]+?)u?;", text)
        assert found, name
        return float(found[1])

    assert said(kernel.source("warp"), "STEP") == STEP
    for name in ("PLAIN", "LATTICE", "EXACT", "HYBRID"):
        assert said(marching, name) == getattr(shading, name)
    assert said(marching, "BLOCK") == said(kernel.source("fill"), "BLOCK") == BLOCK
    for name, value in _core.constants.items():  # written into every shader, and not by hand
        assert said(marching, name) == pytest.approx(value, rel=1e-6)
        for text in shaders():
            assert not re.search(rf"^const {name}\b", text, re.M)


def test_without_an_adapter_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "adapters", lambda: ())
    with pytest.raises(SuppleError, match=r"no GPU was found: .* is needed.*; device='cpu' needs none"):
        gpu_of("gpu")
    assert gpu_of("auto") is None
    assert gpu_of("cpu") is None


def test_auto_never_takes_a_program(gpu: Gpu) -> None:
    found = gpu_of("auto")
    assert found is None if gpu.software else found is gpu


def test_the_command_line(gpu: Gpu, photo: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image.write(tmp_path / "in.png", photo)
    stroke = ["--grab", "80,60:95,65", "--radius", "20", "--border", "none", "--filter", "linear"]
    for device in ("cpu", "gpu"):
        target = str(tmp_path / f"{device}.png")
        assert command(["warp", str(tmp_path / "in.png"), target, *stroke, "--device", device]) == 0
    said = capsys.readouterr().err
    assert ("is a program that runs on the CPU" in said) == gpu.software
    one, other = (image.read(tmp_path / f"{device}.png").pixels.astype(int) for device in ("cpu", "gpu"))
    assert np.quantile(np.abs(one - other), 0.99) <= 1
    assert command(["info", "--gpu"]) == 0
    assert gpu.name in capsys.readouterr().out
    assert command(["info"]) == 2


def test_shaders_see_what_the_cpu_packs() -> None:
    d = bent((40, 60, 80), 2, 3)
    table = field.packed(d.space.table)
    assert table.dtype.itemsize == 11 * 16
    whole = table["pivot"].astype(np.float64) + table["rest"][:, :3]
    np.testing.assert_allclose(whole, d.space.table["pivot"], atol=1e-12 * 80)
    axes = Domain((40, 60, 80), (1, 2, 3), 20.0, "sine").packed()
    np.testing.assert_array_equal(field.domain(axes)[:5, :3], axes.T.astype(np.float32))
    assert (field.domain(axes)[4, :3] == 1.0).all()
    near = d.grab((9, 9, 9), by=(1, 1, 1), radius=5, reach=4)
    np.testing.assert_array_equal(field.packed(near.space.table)["rest"][:, 3], [0, 0, 0, np.float32(0.05)])
    assert (field.local(near.space.table), field.local(near.space.table[3:])) == (False, True)
    assert format_of(np.float64, 3) is None
    assert "fn newton" in kernel.source("newton")
