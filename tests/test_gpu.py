"""The GPU engine against the CPU's, on whatever adapter there is: shaders, whole warps, and where there is none."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.cpu import bricks, lattice, raymarch
from supple.domain import Domain
from supple.engines import gpu_of
from supple.errors import DeviceWarning, FoldWarning, SuppleError
from supple.gpu import device as devices
from supple.gpu import field, kernel
from supple.gpu import raymarch as shading
from supple.gpu.device import Gpu
from supple.gpu.fill import BLOCK
from supple.gpu.samples import STEP, format_of
from supple.media import image


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    return image.read(Path(supple.__file__).parent / "data" / "coffee.jpg").pixels[:240, :330]


def bent(
    shape: tuple[int, ...], seed: int, count: int = 3, spacing: Any = 1.0, border: float | None = 20.0
) -> supple.Deformation:
    """Some strokes of all kinds."""
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1]) - 1.0
    d = supple.Deformation(shape, border=border, spacing=spacing)
    for _ in range(count):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FoldWarning)
            d = d.grab(
                rng.uniform(0.2, 0.8, len(shape)) * size,
                by=rng.normal(0, 0.06, len(shape)) * size,
                radius=float(rng.uniform(0.1, 0.3) * size.min()),
                scales=int(rng.integers(1, 4)),
                poisson=float(rng.uniform(0, 0.5)),
            )
    return d


def columns(d: supple.Deformation, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points as anchors, which are whole pixels, and what is left of them, in physical units."""
    out = np.zeros((2, len(points), 3))
    whole = np.rint(points)
    for k, part in enumerate((whole, points - whole)):
        out[k, :, : d.ndim] = part * d.domain.spacing
    return out[0], out[1]


@pytest.mark.parametrize("border", [None, 20.0])
@pytest.mark.parametrize(("shape", "spacing"), [((200, 300), 1.0), ((40, 60, 80), (1.0, 0.7, 2.1))])
def test_points_move_as_on_the_cpu(gpu: Gpu, shape: tuple[int, ...], spacing: Any, border: float | None) -> None:
    d = bent(shape, 1, 4, spacing, border)
    points = np.random.default_rng(2).uniform(-0.1, 1.1, (2000, d.ndim)) * np.array(shape[::-1])
    anchors, offsets = columns(d, points)
    moved, jacobian = field.forward(gpu, d.space.table, d.space.axes, anchors, offsets)
    steps = np.array(d.domain.spacing)
    n = d.ndim
    np.testing.assert_allclose((anchors + moved)[:, :n] / steps, d.forward(points), atol=1e-3)
    scaled = jacobian[:, :n, :n] * (steps[None, :] / steps[:, None])
    np.testing.assert_allclose(scaled, d.jacobian(points), atol=2e-4)
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


@pytest.mark.parametrize("border", [None, 20.0])
@pytest.mark.parametrize("seed", range(4))
def test_points_are_sent_back(gpu: Gpu, seed: int, border: float | None) -> None:
    shape, spacing = [((200, 300), 1.0), ((40, 60, 80), (1.0, 0.7, 2.1))][seed % 2]
    d = bent(shape, 10 + seed, 5, spacing, border)
    targets = np.rint(np.random.default_rng(seed).uniform(-0.1, 1.1, (2000, d.ndim)) * np.array(shape[::-1]))
    anchors, _ = columns(d, targets)
    shift, residual, steps = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    found = (anchors + shift)[:, : d.ndim] / d.domain.spacing
    np.testing.assert_allclose(d.forward(found), targets, atol=2e-3)
    np.testing.assert_allclose(found, d.inverse(targets).points, atol=5e-3)
    assert residual.max() < 5e-3
    assert steps.max() < 200


def test_far_from_the_origin_the_residual_is_still_small(gpu: Gpu) -> None:
    # A picture of 16k pixels a side, where float32 holds coordinates to a thousandth of a pixel only.
    d = supple.Deformation((16384, 16384)).grab((15900.3, 16001.7), by=(60.5, -40.25), radius=120)
    rng = np.random.default_rng(0)
    targets = np.rint(rng.uniform(15500, 16383, (4000, 2)))
    anchors, _ = columns(d, targets)
    shift, _, _ = field.inverse(gpu, d.space.table, d.space.axes, anchors, 1e-3)
    off = d.forward((anchors + shift.astype(np.float64))[:, :2]) - targets
    assert np.linalg.norm(off, axis=1).max() < 0.01


TYPES = [np.uint8, np.uint16, np.int8, np.int16, np.float16, np.float32]


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", TYPES)
def test_colours_are_the_cpu_s(gpu: Gpu, photo: np.ndarray, dtype: Any, channels: int) -> None:
    scale = {"u": 1.0, "i": 0.5, "f": 1 / 255}[np.dtype(dtype).kind]
    deep = np.concatenate([photo, photo[..., :1]], axis=2)[..., :channels].astype(np.float64) * scale
    source = (deep * (257 if np.dtype(dtype).itemsize == 2 and scale >= 0.5 else 1)).astype(dtype)
    source = source[..., 0] if channels == 1 else source
    d = bent(photo.shape[:2], 3)
    ours = d.warp(source, filter="linear", alpha=False)
    theirs = d.warp(source, filter="linear", alpha=False, device="gpu")
    assert (theirs.dtype, theirs.shape) == (ours.dtype, ours.shape)
    apart = np.abs(theirs.astype(np.float64) - ours.astype(np.float64)) / max(1e-9, float(np.ptp(source)))
    # A hundredth of a pixel is what a source point may be off, on either of them.
    assert apart.max() < 0.02
    assert apart.mean() < 1e-3


@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "auto", "antialias"])
def test_filters_and_what_lies_outside(gpu: Gpu, photo: np.ndarray, filter: str, outside: str) -> None:
    d = supple.Deformation(photo.shape[:2], border=None).grab((60, 60), by=(70, 50), radius=90)
    options: dict[str, Any] = {"filter": filter, "outside": outside, "fill": (10, 200, 30)}
    apart = np.abs(d.warp(photo, device="gpu", **options).astype(int) - d.warp(photo, **options))
    # Labels may change where a source point lies within its tolerance of the line between two.
    assert (apart > 1).mean() < (4e-3 if filter == "nearest" else 5e-4)


@pytest.mark.parametrize("filter", ["auto", "antialias"])
def test_averages_of_noise(gpu: Gpu, filter: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (120, 130)).astype(np.uint8)
    for radius, by in ((9, (5, 4)), (40, (20, 15))):
        d = supple.Deformation(noise.shape).grab((65, 60), by=by, radius=radius)
        apart = np.abs(d.warp(noise, filter=filter, device="gpu").astype(int) - d.warp(noise, filter=filter))
        assert (apart > 1).mean() < 1e-3


def test_nearest_keeps_values(gpu: Gpu) -> None:
    rng = np.random.default_rng(0)
    labels = rng.choice([3, 40, 200], (90, 110)).astype(np.uint8)
    d = bent(labels.shape, 4)
    made = d.warp(labels, filter="nearest", device="gpu")
    assert set(np.unique(made)) == {3, 40, 200}
    # Whatever the opacity says, and light.
    colours = rng.choice([0, 9, 250], (90, 110, 4)).astype(np.uint8)
    for options in ({}, {"linear_light": True}):
        ours, theirs = (d.warp(colours, filter="nearest", device=k, **options) for k in ("cpu", "gpu"))
        assert (ours != theirs).mean() < 4e-3


@pytest.mark.parametrize("options", [{"linear_light": True}, {"alpha": True}, {"alpha": True, "linear_light": True}])
def test_light_and_opacity(gpu: Gpu, photo: np.ndarray, options: dict[str, Any]) -> None:
    y, x = np.mgrid[: photo.shape[0], : photo.shape[1]]
    opacity = np.clip(255 - np.hypot(x - 160, y - 120), 20, 255).astype(np.uint8)
    source = np.dstack([photo, opacity])
    d = bent(photo.shape[:2], 5)
    apart = np.abs(
        d.warp(source, filter="cubic", device="gpu", **options).astype(int)
        - d.warp(source, filter="cubic", **options).astype(int)
    )
    assert (apart > 2).mean() < 1e-3
    assert np.quantile(apart, 0.99) <= 1


@pytest.mark.parametrize("filter", ["antialias", "auto"])
def test_averages_are_near_those_of_many_samples(gpu: Gpu, filter: str) -> None:
    # A zone plate, squeezed: what lies between pixels would alias.
    n = 192
    y, x = np.mgrid[:n, :n]
    plate = 0.5 + 0.5 * np.cos(((x - n / 2) ** 2 + (y - n / 2) ** 2) * (np.pi / (2.5 * n)))
    d = supple.Deformation((n, n), border=16, on_fold="flow").grab((96, 60), by=(0, 70), radius=40)

    def drawn(points: np.ndarray) -> np.ndarray:
        px, py = points[:, 0], points[:, 1]
        return np.asarray(0.5 + 0.5 * np.cos(((px - n / 2) ** 2 + (py - n / 2) ** 2) * (np.pi / (2.5 * n))))

    truth = d.warp(drawn, samples=8)

    def quality(made: np.ndarray) -> float:
        return float(-10 * np.log10(np.mean((made - truth) ** 2)))

    plate = plate.astype(np.float32)
    ours, plain = (quality(d.warp(plate, filter=f, device="gpu")) for f in (filter, "linear"))
    assert ours > plain + 8
    assert ours > quality(d.warp(plate, filter=filter)) - 3


@pytest.mark.parametrize("outside", ["edge", "reflect", "constant"])
@pytest.mark.parametrize("between", ["linear", "cubic", "nearest"])
def test_frames_are_bent_in_time(gpu: Gpu, between: str, outside: str) -> None:
    rng = np.random.default_rng(6)
    clip = np.cumsum(rng.integers(0, 9, (14, 50, 70, 3)), axis=0).astype(np.uint8)
    d = supple.Deformation(clip.shape[:3], border=None).grab((35, 25, 7), by=(6, 3, 4), radius=20)
    options: dict[str, Any] = {"filter": "linear", "between": between, "outside": outside, "fill": 77}
    apart = np.abs(d.warp(clip, device="gpu", **options).astype(int) - d.warp(clip, **options))
    assert (apart > 1).mean() < 2e-3


def test_long_stacks_go_through_a_window(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = np.random.default_rng(7).integers(0, 255, (40, 32, 48)).astype(np.uint8)
    d = supple.Deformation(clip.shape, border=None).grab((24, 16, 20), by=(3, 2, 3), radius=6, scales=3)
    ways: list[dict[str, Any]] = [
        {"filter": "linear"},
        {"filter": "cubic", "between": "cubic", "outside": "reflect"},
        {"filter": "antialias", "outside": "constant"},
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
    d = supple.Deformation(shape, border=None)
    for corner in (
        ([8190.0, 20.0], [32990.0, 9.0], [16.0, 8190.0], [4.0, 8190.0], [4.0, 131990.0])
        if len(shape) == 2
        else ([16.0, 12.0, 150.0],)
    ):
        if all(c < n for c, n in zip(corner, shape[::-1], strict=True)):
            d = d.grab(corner, by=[5.3, 4.2, 90.0][: len(shape)], radius=9 if len(shape) == 2 else 90)
    options: dict[str, Any] = {"filter": "linear", "outside": "reflect"}
    ours, theirs = d.warp(source, **options), d.warp(source, device="gpu", **options)
    assert (ours != source).any()
    assert np.abs(theirs.astype(np.float32) - ours.astype(np.float32)).max() <= 4


@pytest.mark.parametrize("outside", ["edge", "constant"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (33, 1), (17, 16), (16, 17), (2, 3, 2), (1, 20, 30)])
def test_odd_sizes(gpu: Gpu, shape: tuple[int, ...], outside: str) -> None:
    source = np.random.default_rng(8).integers(0, 255, shape).astype(np.uint8)
    centre = [(n - 1) / 2 for n in shape[::-1]]
    d = supple.Deformation(shape, border=None).grab(centre, by=[0.4] * len(shape), radius=5)
    options: dict[str, Any] = {"filter": "linear", "outside": outside, "fill": 99}
    apart = np.abs(d.warp(source, device="gpu", **options).astype(int) - d.warp(source, **options))
    assert apart.max() <= 4


@pytest.mark.parametrize("seed", range(6))
def test_small_strokes_are_not_lost_between_nodes(gpu: Gpu, seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius = float(0.6 * 1.7**seed)
    d = supple.Deformation((96, 96), border=None, on_fold="flow")
    at = rng.uniform(32, 64, 2)
    d = d.grab(at, by=rng.normal(0, 0.7 * radius, 2), radius=radius, scales=1 + seed % 3)
    ramps = np.stack(np.meshgrid(*[np.arange(96.0)] * 2), axis=-1).astype(np.float32)
    ours, theirs = (d.warp(ramps, filter="linear", device=device) for device in ("cpu", "gpu"))
    assert np.abs(ours - ramps).max() > 0.2 * radius
    assert np.abs(theirs - ours).max() < 0.021


def test_numbers_that_float32_does_not_hold_are_left_to_the_cpu(gpu: Gpu) -> None:
    source = np.random.default_rng(1).integers(0, 255, (40, 50)).astype(np.uint8)
    d = supple.Deformation(source.shape, spacing=1e13, border=None).grab((25, 20), by=(4, 2), radius=12e13)
    with pytest.raises(SuppleError, match="strokes of such sizes"):
        d.warp(source, device="gpu")
    # But large spacings do no harm by themselves.
    d = supple.Deformation(source.shape, spacing=1e4, border=None).grab((25, 20), by=(4, 2), radius=12e4)
    apart = np.abs(d.warp(source, filter="linear", device="gpu").astype(int) - d.warp(source, filter="linear"))
    assert apart.max() <= 3


def test_many_strokes_and_strong_ones(gpu: Gpu, photo: np.ndarray) -> None:
    d = supple.Deformation(photo.shape[:2], border=None, on_fold="flow")
    rng = np.random.default_rng(9)
    for _ in range(12):
        d = d.grab(rng.uniform(60, 180, 2), by=rng.normal(0, 40, 2), radius=35)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", supple.ToleranceWarning)
        apart = np.abs(
            d.warp(photo, filter="linear", device="gpu").astype(int) - d.warp(photo, filter="linear").astype(int)
        )
    assert (apart > 4).mean() < 2e-3


def test_no_force_is_a_copy_and_out_is_filled(gpu: Gpu, photo: np.ndarray) -> None:
    still = supple.Deformation(photo.shape[:2])
    np.testing.assert_array_equal(still.warp(photo, device="gpu"), photo)
    d = bent(photo.shape[:2], 3)
    out = np.empty((330, 240, 3), np.uint8).transpose(1, 0, 2)
    assert d.warp(photo, device="gpu", out=out) is out
    np.testing.assert_array_equal(out, d.warp(photo, device="gpu"))


def test_what_the_gpu_does_not_do_is_refused_or_left_to_the_cpu(
    gpu: Gpu, photo: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    d = bent(photo.shape[:2], 3)
    monkeypatch.setattr("supple.engines.open_gpu", lambda software=True: gpu)
    for source, options, named in (
        (photo.astype(np.float64), {}, "samples of float64 in 3 channels"),
        (np.dstack([photo, photo]), {}, "samples of uint8 in 6 channels"),
        (photo, {"filter": "ewa"}, 'filter="ewa"'),
    ):
        with pytest.raises(SuppleError, match=named):
            d.warp(source, device="gpu", **options)
        np.testing.assert_array_equal(d.warp(source, device="auto", **options), d.warp(source, **options))
    with pytest.raises(SuppleError, match='device must be "auto" or "cpu" or "gpu" or "cuda"'):
        d.warp(photo, device="tpu")


def test_a_lost_device_ends_in_the_cpu_s_result(gpu: Gpu, photo: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*rest: object) -> None:
        raise RuntimeError("Parent device is lost")

    monkeypatch.setattr("supple.gpu.lattice.run", lost)
    d = bent(photo.shape[:2], 3)
    with pytest.warns(DeviceWarning, match="device is lost"):
        made = d.warp(photo, device="gpu")
    np.testing.assert_array_equal(made, d.warp(photo))


def test_averages_are_of_one_time(gpu: Gpu) -> None:
    # Frames of one colour each: whatever is averaged over a frame is that colour.
    clip = np.broadcast_to(np.random.default_rng(2).integers(0, 255, (12, 1, 1)), (12, 40, 50)).astype(np.uint8)
    d = supple.Deformation(clip.shape, border=None).grab((25, 20, 6), by=(9, 0, 3), radius=9)
    apart = np.abs(d.warp(clip, filter="antialias", device="gpu").astype(int) - d.warp(clip, filter="antialias"))
    assert apart.max() <= 3


def test_a_device_that_is_lost_is_opened_anew(gpu: Gpu, photo: np.ndarray) -> None:
    d = bent(photo.shape[:2], 3)
    before = devices.open_gpu()
    before.device.destroy()
    with pytest.warns(DeviceWarning, match="the CPU did what"):
        d.warp(photo, device="gpu")
    assert devices.open_gpu() is not before
    assert np.abs(d.warp(photo, filter="linear", device="gpu").astype(int) - d.warp(photo, filter="linear")).max() < 8


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
    assert np.abs(made.astype(int) - d.warp(swapped, filter="linear")).max() <= 8


def test_shaders_have_the_numbers_of_the_cpu() -> None:
    marching, lattice_ = kernel.source("raymarch"), kernel.source("smooth")

    def said(text: str, name: str) -> float:
        found = re.search(rf"const {name} = ([-\w.]+?)u?;", text)
        assert found, name
        return float(found[1])

    assert said(marching, "BRICK") == bricks.BRICK
    for name in ("BISECTIONS", "OPAQUE", "FAINT"):
        assert said(marching, name) == getattr(raymarch, name)
    for name in ("RESERVE", "RESOLVED"):
        assert said(lattice_, name) == getattr(lattice, name)
    assert said(kernel.source("warp"), "STEP") == STEP
    for name in ("PLAIN", "LATTICE", "EXACT", "HYBRID"):
        assert said(marching, name) == getattr(shading, name)
    assert said(marching, "BLOCK") == said(kernel.source("fill"), "BLOCK") == BLOCK


def test_without_an_adapter_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "adapters", lambda: ())
    with pytest.raises(SuppleError, match=r"no GPU was found: .* is needed.*; device cpu needs none"):
        gpu_of("gpu")
    assert gpu_of("auto") is None
    assert gpu_of("cpu") is None


def test_auto_never_takes_a_program(gpu: Gpu) -> None:
    found = gpu_of("auto")
    assert found is None if gpu.software else found is gpu


def test_the_command_line(gpu: Gpu, photo: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image.write(tmp_path / "in.png", photo)
    stroke = ["--grab", "100,100:130,110", "--radius", "40"]
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
    assert table.dtype.itemsize == 7 * 16
    whole = table["pivot"].astype(np.float64) + table["rest"][:, :3]
    np.testing.assert_allclose(whole, d.space.table["pivot"], atol=1e-12 * 80)
    axes = Domain((40, 60, 80), (1, 2, 3), 20.0).packed()
    np.testing.assert_array_equal(field.domain(axes)[:, :3], axes.T.astype(np.float32))
    assert format_of(np.float64, 3) is None
    assert "fn newton" in kernel.source("newton")
