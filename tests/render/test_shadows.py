"""Shadows of the lamp and of the sky, against slow sums along rays, and where they fall."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

import supple
from supple import _core
from supple.render import shadows
from supple.render.appearance import lamp
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.space.geometry import Geometry
from tests.render.scenes import HARD

Floats = npt.NDArray[np.float64]

SIZE = (60, 60)
SPACING = (1.0, 1.2, 1.5)
ABOVE = Camera(0, 90)
WAYS = [(0, 0, 1), (0, -1, 0), (0.3, 0.5, -0.9), (-0.8, 0.2, 0.5), (1, 1, 1), (0.5, -0.5, 0)]


def place(shape: tuple[int, ...], spacing: tuple[float, ...] = (1, 1, 1)) -> tuple[Floats, Floats, Floats]:
    """x, y and z of voxels in millimetres, from the middle of a volume."""
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    return x * spacing[0], y * spacing[1], z * spacing[2]


def left(volume: npt.NDArray[Any], camera: Camera = ABOVE, geometry: Geometry | None = None, **options: Any) -> Floats:
    """The part of the light of a picture's opaque pixels that shadows leave; NaN elsewhere."""
    options = {"transfer": HARD} | options
    plain, dark = (Scene(volume, geometry, shadows=s, **options).render(camera, SIZE) for s in (0.0, 1.0))
    np.testing.assert_array_equal(plain.depth, dark.depth)
    np.testing.assert_array_equal(plain.light[..., 3], dark.light[..., 3])
    seen = plain.light[..., 3] > 0.99
    return np.where(seen, dark.light[..., 0] / np.where(seen, plain.light[..., 0], 1), np.nan).astype(float)


@pytest.mark.parametrize("way", WAYS)
def test_light_is_the_slow_sum_along_rays(way: tuple[float, ...]) -> None:
    rng, along = np.random.default_rng(1), np.array(way) / np.linalg.norm(way)
    nodes = ndimage.gaussian_filter(rng.normal(size=(30, 34, 38)), 3.5)
    nodes = np.clip(nodes / nodes.max(), 0, 1) * 0.25
    nodes[[0, -1]] = nodes[:, [0, -1]] = nodes[:, :, [0, -1]] = 0
    light = shadows.light_from(along, nodes.astype(np.float32), 1.0, SPACING)
    points = rng.uniform(5, 25, (200, 3))
    ts = np.arange(0.25, 60, 0.5)
    ray = points[:, None] + ts[:, None] * along / SPACING
    met = ndimage.map_coordinates(nodes, ray[..., ::-1].reshape(-1, 3).T, order=1, mode="constant").reshape(200, -1)
    wanted = np.prod((1 - met) ** 0.5, axis=1)
    found = ndimage.map_coordinates(light, points[:, ::-1].T, order=1)
    assert np.ptp(wanted) > 0.4
    assert np.abs(found - wanted).mean() < 0.045  # it spreads on its way
    assert np.corrcoef(found, wanted)[0, 1] > 0.97


def test_nodes_are_as_opaque_as_their_voxels() -> None:
    rng = np.random.default_rng(2)
    for dtype in (np.uint8, np.int16, np.float32):
        volume, table = rng.integers(0, 100, (7, 9, 11)).astype(dtype), rng.random(50).astype(np.float32)
        found = np.empty((3, 9, 3), np.float32)
        _core.block_means(volume, (4, 1, 3), table, 10.0, 0.5, found)
        entries = table[np.floor(np.clip((volume - 10.0) * 0.5, 0, 49) + 0.5).astype(int)]
        for c, b, a in np.ndindex(found.shape):
            block = entries[3 * c : 3 * c + 3, b, 4 * a : 4 * a + 4]
            np.testing.assert_allclose(found[c, b, a], block.mean(), rtol=1e-5)


def test_a_slab_casts_a_soft_shadow_on_the_floor_below() -> None:
    x, y, z = place((40, 60, 60))
    floor, slab = z < -12, (abs(z - 10) < 2) & (abs(x) < 8) & (abs(y) < 8)
    lit = left((floor | slab).astype(np.float32))
    view = Scene(floor.astype(np.float32)).view(ABOVE, SIZE)
    towards = lamp(view)
    fall = -22 / towards[2] * towards[:2]  # from the slab's middle to the floor
    # Pixels of the floor, by where their rays meet it.
    rows, columns = np.indices(SIZE)
    eye = view.eye - np.array([29.5, 29.5, 19.5])
    along = view.packed[2] + (columns - 29.5)[..., None] * view.packed[3] + (rows - 29.5)[..., None] * view.packed[4]
    met = eye + along * ((-12 - eye[2]) / along[..., 2])[..., None]
    top = eye + along * ((12 - eye[2]) / along[..., 2])[..., None]
    hidden = (np.abs(top[..., :2]) < 10).all(axis=-1)
    off = np.abs(met[..., :2] - fall)
    floor_seen = np.isfinite(lit) & ~hidden & (np.abs(met[..., :2]) < 22).all(axis=-1)
    inside, outside = floor_seen & (off < 5).all(axis=-1), floor_seen & (off > 16).any(axis=-1)
    assert inside.sum() > 10
    assert outside.sum() > 200
    assert np.nanmax(lit[inside]) < 0.6
    assert np.nanmin(lit[outside]) > 0.75  # the slab takes some of the sky
    assert np.nanmean(lit[outside]) > 0.9
    between = lit[floor_seen & ~inside & ~outside]
    assert ((between > 0.55) & (between < 0.8)).sum() > 20  # soft
    alone = left(floor.astype(np.float32))
    assert np.nanmin(alone) > 0.97  # a plane is in no shadow


def test_pits_are_dark_and_bumps_are_not() -> None:
    x, y, z = place((40, 50, 50))
    dent = 9 * np.exp(-(x**2 + y**2) / 30)
    for sign in (-1, 1):
        lit = left(np.clip(0.5 - (z + 4 - sign * dent) / 2, 0, 1).astype(np.float32))
        middle = lit[27:33, 27:33].mean()
        if sign < 0:
            assert middle < 0.7
            assert lit[27:33, 27:33].max() < 0.85
        else:
            assert middle > 0.97
        assert np.nanmedian(lit) > 0.97


@pytest.mark.parametrize("voxels", [30, 72])
def test_a_ball_is_in_no_shadow_of_its_own(voxels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With one voxel to a node, and with several; no rim is darker."""
    monkeypatch.setattr(shadows, "LONGEST", 36)
    x, y, z = place((voxels,) * 3)
    across = 30 / voxels
    volume = np.clip(0.5 + (0.4 * voxels - np.sqrt(x * x + y * y + z * z)) / 2, 0, 1).astype(np.float32)
    for camera in (Camera(35, 20), Camera(120, -40)):
        lit = left(volume, camera, Geometry((across,) * 3))
        assert np.nanmean(lit) > 0.98
        assert np.nanquantile(lit, 0.02) > 0.9


@pytest.mark.parametrize("mode", ["exact", "buffered"])
def test_shadows_move_with_the_deformation(mode: str) -> None:
    x, y, z = place((32, 40, 40), SPACING)
    slab = (abs(z - 8) < 3) & (abs(x) < 6) & (abs(y) < 8)
    volume = np.maximum(ndimage.gaussian_filter(slab.astype(np.float32), 0.8), np.clip(0.5 - (z + 14) / 3, 0, 1))
    volume = volume.astype(np.float32)
    geometry = Geometry(SPACING)
    d = supple.Deformation(volume.shape, spacing=SPACING, border=None, on_fold="damp").grab(
        (19.5, 19.5, 20.8), by=(7, 0, 0), radius=9
    )
    scene = Scene(volume, geometry, deformation=d, transfer=HARD, shadows=1.0, mode=mode)
    warped = Scene(d.warp(volume, filter="linear"), geometry, transfer=HARD, shadows=1.0)
    before = Scene(volume, geometry, transfer=HARD, shadows=1.0)
    assert scene._shade is not None
    assert warped._shade is not None
    assert before._shade is not None
    off, moved = (
        float(np.abs(s._shade.nodes - warped._shade.nodes).mean())  # type: ignore[union-attr]
        for s in (scene, before)
    )
    assert off < 0.3 * moved  # a mean of opacities is not the opacity of a mean
    one, other = scene.render(ABOVE, SIZE).light, warped.render(ABOVE, SIZE).light
    bright = scene.deformed(d).render(ABOVE, SIZE).light
    np.testing.assert_array_equal(bright, one)
    unlit = Scene(volume, geometry, deformation=d, transfer=HARD, mode=mode).render(ABOVE, SIZE).light
    assert np.abs(one - other).mean() < 0.35 * np.abs(one - unlit).mean()


def test_what_is_cut_away_or_not_seen_casts_no_shadow() -> None:
    x, y, z = place((40, 50, 50))
    floor, slab = z < -12, (abs(z - 4) < 2) & (abs(x) < 8) & (abs(y) < 8)
    both, alone = (floor + 0.8 * slab).astype(np.float32), floor.astype(np.float32)
    wanted = Scene(alone, transfer=HARD, shadows=1.0).render(ABOVE, SIZE).light
    scene = Scene(both, transfer=HARD, shadows=1.0)
    assert np.abs(scene.render(ABOVE, SIZE).light - wanted).max() > 0.2
    for cut in ((((None, None), (None, None), (None, 15)), None), (None, ((24.5, 24.5, 15), (0, 0, 1)))):
        np.testing.assert_allclose(scene.clipped(*cut).render(ABOVE, SIZE).light, wanted, atol=1e-5)
    one, other = (Scene(v, transfer=HARD, density=(0.9, 1.0), shadows=1.0) for v in (both, alone))
    np.testing.assert_allclose(one.render(ABOVE, SIZE).light, other.render(ABOVE, SIZE).light, atol=1e-5)


def test_without_shadows_no_grid_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(shadows, "_opacities", never)
    volume = np.random.default_rng(0).random((6, 7, 8))
    for options in ({}, {"shadows": 0}, {"shadows": 1, "shaded": False}, {"shadows": 1, "projection": "maximum"}):
        Scene(volume, **options).render(size=(9, 9))
    with pytest.raises(AssertionError):
        Scene(volume, shadows=0.1)
