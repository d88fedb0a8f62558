"""Pictures of volumes by the GPU, in every mode, against the CPU's."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.errors import DeviceWarning, SuppleError
from supple.gpu import device as devices
from supple.gpu import shader
from supple.gpu.device import Gpu
from supple.gpu.screen import canvas_texture, pixels_of
from supple.media import image
from supple.render.camera import Camera
from supple.render.scene import MODES, Scene
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry
from tests.gpu.scenes import GEOMETRY, SHAPE, SIZE, SOFT, apart, pair, size_of


@pytest.mark.parametrize("mode", MODES)
def test_a_picture_is_the_cpu_s(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, mode: str) -> None:
    options: dict[str, Any] = {"deformation": bent, "transfer": SOFT, "mode": mode, "tolerance": 0.05}
    options["step"] = min(GEOMETRY.spacing)
    ours, theirs = pair(cloud, GEOMETRY, **options)
    for camera in (Camera(azimuth=25, elevation=20), Camera(azimuth=140, elevation=-50, roll=30, field_of_view=50)):
        one, other = (scene.render(camera, size_of(mode)) for scene in (ours, theirs))
        assert np.ptp(one.pixels((0.1, 0.2, 0.3))) > 100
        assert apart(one, other) > 50
        both = np.isfinite(one.depth) & np.isfinite(other.depth)
        assert np.quantile(abs(one.depth[both] - other.depth[both]), 0.98) < 0.01
        assert (np.isfinite(one.depth) != np.isfinite(other.depth)).mean() < 2e-3
        # The CPU looks once more where a ray begins within what is seen.
        assert abs(int(one.samples.sum()) - int(other.samples.sum())) < 0.08 * one.samples.sum()
        for scene, picture in ((ours, one), (theirs, other)):
            assert (picture.evaluations.sum() > 0) == (scene.mode != "buffered")


@pytest.mark.parametrize("mode", ["plain", *MODES])
def test_projections_planes_silhouettes_and_shadows_are_the_cpu_s(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, mode: str
) -> None:
    given: dict[str, Any] = {"transfer": SOFT, "tolerance": 0.05}
    if mode != "plain":
        given |= {"deformation": bent, "mode": mode}
    camera = Camera(azimuth=25, elevation=20)
    plain = Scene(cloud, GEOMETRY, **given).render(camera, size_of(mode))
    for options in (
        {"projection": "maximum", "density": (0.2, 0.9)},
        {"projection": "minimum", "plane": ((13, 14, 11), (0.3, -1, 0.5))},
        {"projection": "average", "clip": ((3, 20), (None, None), (None, 15))},
        {"plane": ((13, 14, 11), (0.3, -1, 0.5)), "silhouettes": 0.4},
        {"plane": ((13, 14, 11), (-0.3, 1, 0.5)), "silhouettes": 1.0},
        {"shadows": 1.0, "clip": ((3, 20), (None, None), (None, 15))},
        {"clip": ((5, 21), (None, 22.25), (4, 15))},
    ):
        one, other = (scene.render(camera, size_of(mode)) for scene in pair(cloud, GEOMETRY, **given, **options))
        assert np.ptp(one.pixels((0.1, 0.2, 0.3))) > 60
        assert apart(one, plain) < 35
        assert apart(one, other) > 48
        both = np.isfinite(one.depth) & np.isfinite(other.depth)
        assert np.quantile(abs(one.depth[both] - other.depth[both]), 0.95) < 0.01
        assert (np.isfinite(one.depth) != np.isfinite(other.depth)).mean() < 4e-3


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


@pytest.mark.parametrize("mode", MODES)
def test_one_slice_of_any_thickness_with_a_fixed_border(gpu: Gpu, cloud: np.ndarray, mode: str) -> None:
    for spacing in ((1.0, 1.0, 5.0), (1.0, 0.9, 0.3)):
        d = supple.Deformation((1, *SHAPE[1:]), spacing=spacing, border=64, on_fold="damp").grab(
            (13, 15, 0), by=(3, -2, 0), radius=8, reach=None
        )
        options: dict[str, Any] = {"deformation": d, "transfer": SOFT, "mode": mode}
        one, other = (
            scene.render(Camera(azimuth=25, elevation=20), size_of(mode))
            for scene in pair(cloud[10:11], Geometry(spacing=spacing), **options)
        )
        assert np.ptp(one.pixels((0.1, 0.2, 0.3))) > 100
        assert apart(one, other) > 50


def test_large_pictures_come_in_parts(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")
    whole = scene.render(size=SIZE)
    monkeypatch.setattr(shader.Pace, "parts", lambda pace, total: ((k, min(7, total - k)) for k in range(0, total, 7)))
    parts = scene.render(size=SIZE)
    np.testing.assert_array_equal(parts.light, whole.light)
    np.testing.assert_array_equal(parts.depth, whole.depth)


def test_what_does_not_fit_is_done_by_the_cpu(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = Scene(cloud, GEOMETRY, transfer=SOFT).render(size=SIZE)
    held = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")

    def lost(*rest: object) -> None:
        raise RuntimeError("Parent device is lost")

    monkeypatch.setattr("supple.gpu.raymarch._march", lost)
    with pytest.warns(DeviceWarning, match="device is lost"):
        np.testing.assert_array_equal(held.render(size=SIZE).light, wanted.light)
    monkeypatch.undo()
    monkeypatch.setattr("supple.gpu.memory.DEEP", 29)
    with pytest.warns(DeviceWarning, match="30 samples along a side are more than a texture holds"):
        scene = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")
    np.testing.assert_array_equal(scene.render(size=SIZE).light, wanted.light)


def test_the_command_line(gpu: Gpu, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = str(Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz")
    options = ["--grab", "40,86,65:44,63,53", "--radius", "36", "--border", "30", "--size", "24x20"]
    for device in ("cpu", "gpu"):
        assert command(["render", head, str(tmp_path / f"{device}.png"), *options, "--device", device]) == 0
    assert ("is a program that runs on the CPU" in capsys.readouterr().err) == gpu.software
    one, other = (image.read(tmp_path / f"{device}.png").pixels.astype(int) for device in ("cpu", "gpu"))
    assert np.sqrt(np.mean((one - other) ** 2)) < 2
    assert command(["render", head, str(tmp_path / "x.png"), "--device", "cuda"]) == 2
    assert not (tmp_path / "x.png").exists()


def test_the_cpu_has_the_same_verbs(cloud: np.ndarray, bent: supple.Deformation) -> None:
    scene = Scene(cloud, GEOMETRY, transfer=SOFT, mode="hybrid")
    other = scene.deformed(bent)
    wanted = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT).render(size=SIZE)
    np.testing.assert_array_equal(other.render(size=SIZE).light, wanted.light)
    assert other.fill() == 1.0
    with pytest.raises(SuppleError, match="this scene has none: use render"):
        other.draw(None)


@pytest.mark.parametrize("mode", MODES)
def test_a_texture_receives_the_picture(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, mode: str) -> None:
    scene = Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode=mode, device="gpu")
    height, width = 41, 53
    texture = canvas_texture(gpu, (width, height))
    scene.draw(texture, Camera(azimuth=25), background=(0.1, 0.2, 0.3))
    found = pixels_of(gpu, texture)
    wanted = scene.render(Camera(azimuth=25), (height, width)).pixels((0.1, 0.2, 0.3))
    assert np.abs(found[..., :3].astype(int) - wanted).max() <= 1
    assert (found[..., 3] == 255).all()
    with pytest.raises(SuppleError, match="of usage STORAGE_BINDING and 80 x 60 pixels or more"):
        scene.draw(texture, size=(60, 80))


def test_textures_that_do_not_fit_are_refused(gpu: Gpu, cloud: np.ndarray) -> None:
    scene = Scene(cloud, GEOMETRY, transfer=SOFT, device="gpu")
    bare = gpu.device.create_texture(size=(8, 8, 1), format="rgba8unorm", usage="COPY_SRC")
    with pytest.raises(SuppleError, match="texture must be rgba8unorm, of usage STORAGE_BINDING and 8 x 8 pixels"):
        scene.draw(bare)
    texture = gpu.device.create_texture(size=(8, 8, 1), format="rgba8unorm", usage="STORAGE_BINDING")
    for background in ((1, 1), "red", (np.nan, 0, 0), (2, -1, 0)):
        with pytest.raises(SuppleError, match="background"):
            scene.draw(texture, background=background)  # type: ignore[arg-type]
    with pytest.raises(SuppleError, match="size must be two numbers of pixels"):
        scene.draw(texture, size=(64,))  # type: ignore[arg-type]
    with pytest.raises(SuppleError, match="camera must be a Camera, found 'x'"):
        scene.draw(texture, "x")  # type: ignore[arg-type]
    texture.destroy()
    with pytest.raises(SuppleError, match=r"could not draw: .*destroyed"):
        scene.draw(texture)
    other = devices.adapters()[0].request_device_sync()
    foreign = other.create_texture(size=(8, 8, 1), format="rgba8unorm", usage="STORAGE_BINDING")
    with pytest.raises(SuppleError, match=r"texture must be made by scene\.gpu\.device"):
        scene.draw(foreign)
    assert devices.open_gpu() is gpu
    assert not gpu.lost
    other.destroy()
    with pytest.raises(Exception, match="lost") as lost:
        other.create_texture(size=(8, 8, 1), format="rgba8unorm", usage="STORAGE_BINDING")
    stricken = dataclasses.replace(gpu, device=other)
    devices.trouble(stricken, lost.value)
    assert stricken.lost


@pytest.mark.parametrize("mode", ["hybrid", "buffered"])
def test_strokes_that_it_cannot_solve_are_the_cpu_s(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    tiny = 1e-11  # the inverse squares of such lengths are beyond float32
    d = supple.Deformation(SHAPE, spacing=tiny, border=None, on_fold="damp").grab(
        (13, 14, 11), by=(3, -2, 2), radius=9 * tiny, reach=None
    )
    options: dict[str, Any] = {"deformation": d, "transfer": SOFT, "mode": mode}
    wanted = Scene(cloud, Geometry(spacing=(tiny,) * 3), **options)
    with pytest.warns(DeviceWarning, match="strokes of such sizes are beyond its numbers"):
        made = Scene(cloud, Geometry(spacing=(tiny,) * 3), device="gpu", **options)
    assert made.gpu is None
    assert made.error == wanted.error
    np.testing.assert_array_equal(made.render(size=SIZE).light, wanted.render(size=SIZE).light)
    if gpu.software:  # a GPU carries out all of them
        monkeypatch.setattr(shader, "TURNS", 1 << 20)
        with pytest.warns(DeviceWarning, match="could not be solved in its numbers"):
            Scene(cloud, GEOMETRY, deformation=bent, transfer=SOFT, mode=mode, device="gpu").render(size=SIZE)
    assert devices.open_gpu() is gpu


def test_rays_of_very_many_samples(gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation) -> None:
    """Drivers in software end loops of too many turns, and say nothing."""
    fog = TransferFunction(((0, 1, 1, 1, 0.01), (1, 1, 1, 1, 0.02)), unit=1.0)
    ours, theirs = (
        Scene(cloud, GEOMETRY, deformation=bent, transfer=fog, mode="exact", step=0.004, device=device)
        for device in ("cpu", "gpu")
    )
    with warnings.catch_warnings(action="ignore", category=DeviceWarning):  # whoever does it, it is right
        made = theirs.render(size=(3, 4))
    np.testing.assert_allclose(made.light, ours.render(size=(3, 4)).light, atol=0.01)
