"""Pictures of volumes by the GPU, in every mode, against the CPU's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import supple
from supple.camera import Camera
from supple.cli import command
from supple.errors import DeviceWarning
from supple.geometry import Geometry
from supple.gpu import device as devices
from supple.gpu.device import Gpu
from supple.media import image
from supple.rendering import MODES, Picture, Scene
from supple.transfer import TransferFunction

SHAPE, SIZE = (22, 30, 26), (40, 52)
GEOMETRY = Geometry(spacing=(0.9, 1.1, 1.8))
SOFT = TransferFunction(((0.3, 1, 0.2, 0.1, 0), (0.5, 0.9, 0.5, 0.3, 0.3), (1, 1, 1, 1, 0.8)), relative=True)


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    made = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=SHAPE), 2.5, mode="constant")
    made -= made.min()
    return (made / made.max()).astype(np.float32)


@pytest.fixture(scope="module")
def bent() -> supple.Deformation:
    d = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None)
    return d.grab((13, 14, 11), by=(3, -2, 2), radius=9).grab((6, 20, 8), by=(-1, 2, 1), radius=8)


def apart(one: Picture, other: Picture) -> float:
    """How far two pictures are from one another, in decibels."""
    a, b = (p.pixels((0.1, 0.2, 0.3)).astype(float) for p in (one, other))
    return float(20 * np.log10(255 / max(1e-3, np.sqrt(np.mean((a - b) ** 2)))))


@pytest.mark.parametrize("mode", MODES)
def test_a_picture_is_the_cpu_s(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, mode: str) -> None:
    options: dict[str, Any] = {"deformation": bent, "transfer": SOFT, "mode": mode, "tolerance": 0.05}
    ours, theirs = (Scene(cloud, GEOMETRY, device=device, **options) for device in ("cpu", "gpu"))
    for camera in (Camera(azimuth=25, elevation=20), Camera(azimuth=140, elevation=-50, roll=30, field_of_view=50)):
        one, other = ours.render(camera, SIZE), theirs.render(camera, SIZE)
        assert np.ptp(one.pixels((0.1, 0.2, 0.3))) > 100
        assert apart(one, other) > 50
        both = np.isfinite(one.depth) & np.isfinite(other.depth)
        assert np.quantile(abs(one.depth[both] - other.depth[both]), 0.98) < 0.01
        assert (np.isfinite(one.depth) != np.isfinite(other.depth)).mean() < 2e-3
        # The CPU looks once more where a ray begins within what is seen.
        assert abs(int(one.samples.sum()) - int(other.samples.sum())) < 0.08 * one.samples.sum()
        assert (one.evaluations.sum() > 0) == (other.evaluations.sum() > 0) == (mode == "exact")


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int16, np.float32, np.float64, np.bool_])
def test_any_type_of_samples(gpu: Gpu, cloud: np.ndarray, dtype: Any) -> None:
    given = (
        cloud > 0.5 if dtype is np.bool_ else (cloud * 200 - (100 if np.dtype(dtype).kind == "i" else 0)).astype(dtype)
    )
    one, other = (Scene(given, GEOMETRY, transfer=SOFT, device=d).render(size=SIZE) for d in ("cpu", "gpu"))
    assert apart(one, other) > 45


def test_windows_flat_light_and_several_rays(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation) -> None:
    ours, theirs = (
        Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, shaded=False, step=0.7, device=d)
        for d in ("cpu", "gpu")
    )
    rows: list[int] = []
    one, other = ours.render(size=SIZE, supersampling=2), theirs.render(size=SIZE, supersampling=2, tell=rows.append)
    assert apart(one, other) > 50
    assert rows[-1] == SIZE[0]
    for density in ((0.5, 0.8), (2.0, 3.0)):
        seen = [scene.seen_through(SOFT, density).render(size=SIZE) for scene in (ours, theirs)]
        assert apart(*seen) > 45
    # All is seen, from where a ray enters on.
    fog = TransferFunction(((0, 0.5, 0.5, 1, 0.05), (1, 1, 1, 1, 0.2)))
    seen = [scene.seen_through(fog).render(size=SIZE) for scene in (ours, theirs)]
    assert apart(*seen) > 50
    np.testing.assert_allclose(seen[0].depth, seen[1].depth, atol=1e-3)


def test_without_strokes_and_thin(gpu: Gpu, cloud: np.ndarray) -> None:
    for part in (cloud, cloud[:1], cloud[:, :2, :1]):
        one, other = (Scene(part, GEOMETRY, transfer=SOFT, device=d).render(size=SIZE) for d in ("cpu", "gpu"))
        assert apart(one, other) > 50


def test_large_pictures_come_in_parts(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")
    whole = scene.render(size=SIZE)
    monkeypatch.setattr("supple.gpu.raymarch.RAYS", 7 * SIZE[1])
    parts = scene.render(size=SIZE)
    np.testing.assert_array_equal(parts.light, whole.light)
    np.testing.assert_array_equal(parts.depth, whole.depth)


def test_what_does_not_fit_is_done_by_the_cpu(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = Scene(cloud, GEOMETRY, transfer=SOFT).render(size=SIZE)
    held = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")

    def lost(*rest: object) -> None:
        raise RuntimeError("Parent device is lost")

    monkeypatch.setattr("supple.gpu.raymarch.run", lost)
    with pytest.warns(DeviceWarning, match="device is lost"):
        np.testing.assert_array_equal(held.render(size=SIZE).light, wanted.light)
    monkeypatch.setattr(devices.open_gpu(), "binding", 1000)  # the other one is gone
    with pytest.warns(DeviceWarning, match="is more than a shader takes"):
        scene = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")
    np.testing.assert_array_equal(scene.render(size=SIZE).light, wanted.light)


def test_the_command_line(gpu: Gpu, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = str(Path(supple.__file__).parent / "data" / "head.nii.gz")
    options = ["--grab", "40,86,65:44,63,53", "--radius", "36", "--border", "30", "--size", "48x40"]
    for device in ("cpu", "gpu"):
        assert command(["render", head, str(tmp_path / f"{device}.png"), *options, "--device", device]) == 0
    assert ("is a program that runs on the CPU" in capsys.readouterr().err) == gpu.software
    one, other = (image.read(tmp_path / f"{device}.png").pixels.astype(int) for device in ("cpu", "gpu"))
    assert np.sqrt(np.mean((one - other) ** 2)) < 2
    assert command(["render", head, str(tmp_path / "x.png"), "--device", "cuda"]) == 2
    assert not (tmp_path / "x.png").exists()
