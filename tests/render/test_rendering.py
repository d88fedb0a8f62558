"""Rendering against a slow reference, known bodies, and itself from other sides."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

import supple
from supple import _core
from supple.render.camera import Camera
from supple.render.picture import Rendering
from supple.render.scene import MODES, Scene
from supple.render.transfer import ENTRIES, TransferFunction
from supple.space.geometry import Geometry
from tests import effort
from tests.refusals import refused
from tests.render.scenes import HARD, SOFT, cloud

Floats = npt.NDArray[np.float64]

SIZE = (30, 36)
AMBIENT, DIFFUSE, SPECULAR = 0.15, 0.8, 0.2  # of light; the highlight is the cosine to the power of 16
LAYER = 4  # voxels behind a cut face over which the light of gradients takes over
TRANSFERS = {"soft": SOFT, "hard": HARD}


def spline_slopes(volume: Floats, points: Floats) -> Floats:
    """The slopes of the cubic B-spline whose coefficients are the voxels, by central differences."""
    beyond = np.pad(volume, 4, mode="edge")

    def at(places: Floats) -> Floats:
        made: Floats = ndimage.map_coordinates(beyond, places[:, ::-1].T + 4, order=3, prefilter=False)
        return made

    return np.stack([(at(points + e) - at(points - e)) / 2e-4 for e in 1e-4 * np.eye(3)], axis=-1)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_slopes_are_those_of_a_cubic_spline(dtype: Any) -> None:
    rng = np.random.default_rng(3)
    volume = (200 * cloud((9, 12, 11))).astype(dtype)
    points = np.concatenate([rng.uniform(0, np.array([10, 11, 8]), (300, 3)), [[0, 0, 0], [10, 11, 8], [5, 0, 8]]])
    found = np.empty((len(points), 4), np.float32)
    _core.look_up(volume, points.astype(np.float32), found)
    wanted = spline_slopes(volume.astype(np.float64), points.astype(np.float32).astype(np.float64))
    np.testing.assert_allclose(found[:, 1:], wanted, atol=2e-3)
    _core.look_up(np.full((5, 5, 5), 77, dtype), points.astype(np.float32), found)
    assert not found[:, 1:].any()  # exactly


def ball(shape: tuple[int, int, int], geometry: Geometry, centre: Floats, radius: float) -> npt.NDArray[np.float32]:
    """A ball in millimetres, 1 within and 0 outside, with a soft edge of some millimetres."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")[::-1], axis=-1)
    away = np.linalg.norm(geometry.to_lps(index) - centre, axis=-1)
    return np.clip(0.5 + (radius - away) / 4, 0, 1).astype(np.float32)


def bent(shape: tuple[int, ...], geometry: Geometry = Geometry()) -> supple.Deformation:  # noqa: B008
    middle = [(n - 1) / 2 for n in reversed(shape)]
    d = supple.Deformation(shape, spacing=geometry.spacing, border=None, on_fold="damp")
    return d.grab(middle, by=(4, -2, 3), radius=9, reach=None).grab(
        [0.3 * m for m in middle], by=(-1, 2, 2), radius=7, reach=None
    )


def reference(scene: Scene, camera: Camera, size: tuple[int, int]) -> tuple[Floats, Floats, Floats]:
    """The same, a ray at a time, in float64, composited from back to front as the paper does.

    Returns premultiplied colour and opacity, and the depth of the surface and of opacity 0.9.
    """
    view = scene.view(camera, size)
    volume = scene.samples.astype(np.float64)
    low, high = scene.range
    table = scene.transfer.table(low, high, scene.step).astype(np.float64)
    entries = np.linspace(low, high, ENTRIES)
    shown = (table[:, 3] > 0) & (entries >= scene.density[0]) & (entries <= scene.density[1])
    first = entries[np.argmax(shown)] - 0.5 * (entries[1] - entries[0])
    threshold = -math.inf if shown[0] and scene.density[0] <= low else max(first, scene.density[0])
    light = -view.ahead - 0.35 * view.packed[3] / np.linalg.norm(view.packed[3])
    light -= 0.45 * view.packed[4] / np.linalg.norm(view.packed[4])
    light /= np.linalg.norm(light)

    def sampled(field: Floats, points: Floats) -> Floats:
        made: Floats = ndimage.map_coordinates(field, points[:, ::-1].T, order=1, mode="nearest")
        return made

    d = scene.deformation if scene.mode == "exact" else None

    def source(points: Floats) -> Floats:
        return points if d is None else d.inverse(points).points

    def visible(values: Floats) -> npt.NDArray[np.bool_]:
        return (values >= threshold) & (values <= scene.density[1])

    out, depth = np.zeros((*size, 4)), np.full((*size, 2), math.inf)
    first, last = np.array(scene.clip).T
    rays, bounds = [], []
    for y, x in np.ndindex(size):
        direction = view.direction(x, y)
        along = direction / view.spacing
        with np.errstate(divide="ignore"):
            faces = np.stack([(first - view.eye) / along, (last - view.eye) / along])
        near, far = max(faces.min(axis=0).max(), 0), faces.max(axis=0).min()
        entered = int(faces.min(axis=0).argmax())
        if near > far:
            continue
        ts = np.append(np.arange(near, far, scene.step), far)
        hit = visible(sampled(volume, source(view.eye + ts[:, None] * along)))
        if threshold == -math.inf:
            bounds.append((near, near))
        elif hit.any():
            k = int(np.argmax(hit))
            bounds.append((max(near, ts[k] - scene.step), ts[k]))
        else:
            continue
        rays.append((y, x, direction, along, near, far, entered))
    ways = np.array([ray[3] for ray in rays])
    before, starts = np.array(bounds).T
    for _ in range(40):
        middle = (before + starts) / 2
        hit = visible(sampled(volume, source(view.eye + middle[:, None] * ways)))
        before, starts = np.where(hit, before, middle), np.where(hit, middle, starts)
    for (y, x, direction, along, near, far, entered), start in zip(rays, starts, strict=True):
        # Between the ends of a step, values are taken as linear; it is lit in the middle of what is visible of it.
        ends = np.append(np.arange(start, far, scene.step), far)
        values = sampled(volume, source(view.eye + ends[:, None] * along))
        values[0] = max(values[0], threshold)
        within = (np.arange(200) + 0.5) / 200
        fine = values[:-1, None] + np.diff(values)[:, None] * within
        seen = visible(fine)
        colours = table[np.rint((fine - low) / (high - low) * (ENTRIES - 1)).astype(int)]
        parts = -np.log1p(-np.minimum(colours[..., 3], 1 - 1e-9)) * seen / 200
        parts *= np.diff(ends)[:, None] / scene.step
        thick = parts.sum(axis=1)
        mixed = (parts[..., None] * colours[..., :3]).sum(axis=1) / np.maximum(thick, 1e-12)[:, None]
        colours = np.column_stack([mixed, -np.expm1(-thick)])
        middle = (seen * within).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        ts = ends[:-1]
        places = source(view.eye + (ts + middle * np.diff(ends))[:, None] * along)
        lit, shine = np.ones(len(ts)), np.zeros(len(ts))
        if scene.shaded:
            slopes = spline_slopes(volume, np.clip(places, 0, np.array(volume.shape[::-1]) - 1))
            if d is not None:
                slopes = np.einsum("nji,nj->ni", np.linalg.inv(d.jacobian(places)), slopes)
            slopes = slopes / view.spacing
            size_ = np.linalg.norm(slopes, axis=1)
            normals = slopes / np.maximum(size_, 1e-12)[:, None]
            half = light - direction
            half /= np.linalg.norm(half)
            lit = AMBIENT + DIFFUSE * np.where(size_ > 0, abs(normals @ light), 1)
            shine = SPECULAR * np.where(size_ > 0, abs(normals @ half), 0) ** 16
            if start == near > 0:
                layer = np.clip(1 - (ts - near) / (LAYER * min(view.spacing)), 0, 1)
                flat = layer * np.logical_and.accumulate(colours[:, 3] > 0)
                lit += flat * (AMBIENT + DIFFUSE * abs(light[entered]) - lit)
                shine *= 1 - flat
        total = np.zeros(3)
        for k in range(len(ts) - 1, -1, -1):
            alpha = colours[k, 3]
            total = alpha * (colours[k, :3] * lit[k] + shine[k]) + (1 - alpha) * total
        gathered = 1 - np.cumprod(1 - colours[:, 3])
        out[y, x] = *total, gathered[-1]
        depth[y, x, 0] = start
        if (gathered >= 0.9).any():
            depth[y, x, 1] = ts[np.argmax(gathered >= 0.9)]
    return out[..., :3], out[..., 3], depth


def psnr(a: Rendering, b: Rendering) -> float:
    first, second = (p.pixels((0.1, 0.1, 0.1)).astype(np.float64) for p in (a, b))
    return float(10 * np.log10(255**2 / max(np.mean((first - second) ** 2), 1e-9)))


GEOMETRIES = {
    "cubic": Geometry(),
    "thick slices": Geometry((0.8, 1.0, 2.5)),
    "oblique and flipped": Geometry(
        (1.0, 1.2, 1.5),
        (10.0, -20.0, 5.0),
        np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]) @ np.diag([1.0, -1.0, 1.0]),
    ),
}


CLIPS = {"whole": None, "box": ((6, 20.25), (4, 22), (5, 20)), "corner": ((None, None), (11.5, None), (None, 16))}


@pytest.mark.parametrize(
    ("where", "transfer", "mode", "clip"),
    effort.pairs(list(GEOMETRIES), ["soft", "hard"], ["plain", *MODES], list(CLIPS)),
)
def test_a_picture_is_the_slow_one(where: str, transfer: str, mode: str, clip: str) -> None:
    geometry = GEOMETRIES[where]
    volume = cloud()
    d = None if mode == "plain" else bent(volume.shape, geometry)
    scene = Scene(
        volume,
        geometry,
        deformation=d,
        transfer=TRANSFERS[transfer],
        mode="buffered" if mode == "plain" else mode,
        clip=CLIPS[clip],
    )
    camera = Camera(35, 20, roll=10)
    picture = scene.render(camera, SIZE)
    colours, alpha, depth = reference(scene, camera, SIZE)
    assert (alpha > 0).sum() > 80
    off = np.abs(picture.light[..., :3] - colours).max(axis=-1)
    veiled = np.abs(picture.light[..., 3] - alpha)
    # Rays that graze a surface may just miss it, or hit it; and what ends early is opaque to 0.995.
    assert np.quantile(off, 0.97) < 0.01
    assert np.quantile(veiled, 0.97) < 0.006
    assert off.mean() < 0.003
    both = np.isfinite(depth[..., 0]) & np.isfinite(picture.depth)
    assert (both == np.isfinite(depth[..., 0])).mean() > 0.98
    # The surface is found to a quarter of a step, and mostly far better by the line between two values.
    away = np.abs(picture.depth[both] - depth[..., 0][both])
    assert away.max() < scene.step / 4 + 1e-6
    assert np.quantile(away, 0.9) < scene.step / 50


@pytest.mark.parametrize("mode", ["exact", "buffered"])
def test_strokes_of_a_reach(mode: str) -> None:
    """What rays outside their balls see is what they see without strokes, bit for bit, and costs no inversion."""
    volume, geometry, camera = cloud(), Geometry((1.0, 0.9, 1.1)), Camera(35, 20)
    d = supple.Deformation(volume.shape, spacing=geometry.spacing, border=None, on_fold="damp")
    d = d.grab((12, 14, 9), by=(2, -1.5, 1), radius=7, reach=1.5)
    scene = Scene(volume, geometry, deformation=d, transfer=HARD, mode=mode)
    picture, plain = scene.render(camera, SIZE), Scene(volume, geometry, transfer=HARD).render(camera, SIZE)
    colours, alpha, _ = reference(scene, camera, SIZE)
    off = np.abs(picture.light[..., :3] - colours).max(axis=-1)
    assert np.quantile(off, 0.97) < 0.01
    assert np.abs(plain.light[..., :3] - colours).max() > 0.05
    view = scene.view(camera, SIZE)
    outside = np.ones(SIZE, np.bool_)
    for stroke in d.space.table:
        for y, x in np.ndindex(SIZE):
            way = stroke["pivot"] - view.eye * view.spacing
            direction = view.direction(x, y)
            outside[y, x] &= np.linalg.norm(way - (way @ direction) * direction) > stroke["reach"] * 1.001
    assert 0.1 < (outside & (alpha > 0)).sum() / (alpha > 0).sum() < 0.9
    if mode == "exact":
        np.testing.assert_array_equal(picture.light[outside], plain.light[outside])
        np.testing.assert_array_equal(picture.samples[outside], plain.samples[outside])
        assert not picture.evaluations[outside].any()
        assert picture.evaluations[~outside].any()
    else:
        np.testing.assert_allclose(picture.light[outside], plain.light[outside], atol=0.02)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float32, np.float64, np.int32, np.bool_])
def test_the_type_of_samples_does_not_matter(dtype: Any) -> None:
    volume = cloud() > 0.5
    whole = (volume * 200).astype(np.float32)
    given = volume if dtype == np.bool_ else (whole - (100 if np.dtype(dtype).kind != "u" else 0)).astype(dtype)
    relative = TransferFunction(((0.3, 1, 1, 1, 0), (0.6, 1, 0.5, 0.2, 0.9)), relative=True)
    one = Scene(whole, transfer=relative).render(size=SIZE)
    other = Scene(given, transfer=relative).render(size=SIZE)
    np.testing.assert_allclose(other.light, one.light, atol=2e-3)


def test_skipping_empty_bricks_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = cloud((33, 37, 41), 3) ** 3
    d = bent(volume.shape)
    for transfer in (HARD, SOFT):
        for deformation in (None, d):
            quick = Scene(volume, deformation=deformation, transfer=transfer)
            assert quick._skips.max() > 0
            slow = Scene(volume, deformation=deformation, transfer=transfer)
            slow._skips = np.zeros_like(slow._skips)
            a, b = quick.render(Camera(20, 30), SIZE), slow.render(Camera(20, 30), SIZE)
            np.testing.assert_array_equal(a.light, b.light)
            np.testing.assert_array_equal(a.depth, b.depth)
            assert a.samples.sum() < (0.7 if transfer is HARD else 1.0) * b.samples.sum()


@pytest.mark.parametrize(
    ("spacing", "azimuth", "elevation", "side"),
    [
        ((1.2195738529852205, 1.7830271790112067, 1.261963078586175), 137.3374557503712, 0.45635402334055345, 342),
        ((1.435688806641806, 1.1230393461856043, 2.2493664663422064), 72.66251447334237, 36.51394253052837, 321),
    ],
)
def test_rays_end_where_rounding_has_their_last_step_before_their_end(
    spacing: Any, azimuth: float, elevation: float, side: int
) -> None:
    z, y, x = np.mgrid[:48, :64, :80]
    ball = ((x - 40) / 20) ** 2 + ((y - 32) / 18) ** 2 + ((z - 24) / 12) ** 2 < 1
    scene = Scene((100 * ball).astype(np.int16), Geometry(spacing=spacing), shaded=False)
    camera = scene.framed(Camera(azimuth, elevation), (side, side))
    assert scene.render(camera, (side, side)).light[..., 3].max() > 0.5


def test_exact_scenes_share_their_bricks() -> None:
    samples, geometry = cloud(), Geometry()
    first = Scene(samples, geometry, mode="exact")
    other = first.deformed(bent(samples.shape))
    assert other._skips is first._skips
    fresh = Scene(samples, geometry, deformation=bent(samples.shape), mode="exact")
    np.testing.assert_array_equal(other.render(size=(20, 24)).light, fresh.render(size=(20, 24)).light)
    narrow = other.seen_through(other.transfer, (0.6, 0.7))
    again = Scene(samples, geometry, deformation=bent(samples.shape), mode="exact", density=(0.6, 0.7))
    np.testing.assert_array_equal(narrow.render(size=(20, 24)).light, again.render(size=(20, 24)).light)
    assert narrow._skips is not first._skips


def test_the_modes_show_the_same() -> None:
    shape = (48, 52, 50)
    geometry = Geometry((1.0, 1.0, 1.2))
    volume = ball(shape, geometry, np.array([25.0, 25.0, 28.0]), 16)
    d = supple.Deformation(shape, spacing=geometry.spacing, border=None, on_fold="damp").grab(
        (25, 12, 24), by=(8, -9, 5), radius=14, reach=None
    )
    pictures = {
        mode: Scene(volume, geometry, deformation=d, transfer=HARD, mode=mode).render(Camera(30, 15), (96, 96))
        for mode in MODES
    }
    assert psnr(pictures["buffered"], pictures["exact"]) > 32
    assert pictures["exact"].evaluations.sum() > 2 * pictures["exact"].samples.sum()
    assert pictures["buffered"].evaluations.sum() == 0
    np.testing.assert_array_equal(pictures["hybrid"].light, pictures["buffered"].light)
    undone = Scene(volume, geometry, transfer=HARD).render(Camera(30, 15), (96, 96))
    assert psnr(undone, pictures["exact"]) < 28


def test_opacity_is_that_of_the_way_and_not_of_the_steps() -> None:
    shape = (40, 40, 40)
    fog = np.full(shape, 0.5, np.float32)
    fog[0, 0, 0] = 1.0
    thin = TransferFunction(((0.0, 1.0, 1.0, 1.0, 0.02),), unit=1.0)
    found = [
        Scene(fog, transfer=thin, step=step, shaded=False).render(Camera(distance=5000, field_of_view=1), (9, 9)).light
        for step in (1.0, 0.5, 0.25)
    ]
    for light in found:
        assert light[4, 4, 3] == pytest.approx(1 - 0.98**39, abs=0.012)


def test_density_shows_what_is_inside() -> None:
    shape = (40, 40, 40)
    middle = np.full(3, 19.5)
    volume = 0.5 * ball(shape, Geometry(), middle, 15) + 0.5 * ball(shape, Geometry(), middle, 6)
    outer = Scene(volume, transfer=TransferFunction(((0.3, 1, 0, 0, 0), (0.35, 1, 0, 0, 1))))
    inner = Scene(volume, transfer=outer.transfer, density=(0.8, 1.0))
    a, b = outer.render(size=(64, 64)), inner.render(size=(64, 64))
    assert (b.light[..., 3] > 0.5).sum() < 0.3 * (a.light[..., 3] > 0.5).sum()
    again = outer.seen_through(outer.transfer, (0.8, 1.0)).render(size=(64, 64))
    np.testing.assert_array_equal(again.light, b.light)
    assert Scene(volume, density=(2.0, 3.0)).render(size=(8, 8)).light.max() == 0


def test_pick_and_drag() -> None:
    shape, geometry = (50, 50, 50), GEOMETRIES["oblique and flipped"]
    middle = geometry.to_lps(np.full(3, 24.5))
    volume = ball(shape, geometry, middle, 14)
    camera, size = Camera(30, 20), (120, 160)
    d = supple.Deformation(shape, spacing=geometry.spacing, border=64, on_fold="damp").grab(
        (24, 20, 24), by=(2, -2, 1), radius=12, reach=None
    )
    for mode, deformation in (("buffered", None), ("buffered", d), ("exact", d)):
        scene = Scene(volume, geometry, deformation=deformation, transfer=HARD, mode=mode)
        assert scene.pick(camera, size, (0, 0)) is None
        pick = scene.pick(camera, size, (80, 61))
        assert pick is not None
        # It lies on its ray, at its depth, on the surface of the ball.
        view = scene.view(camera, size)
        at = view.eye + pick.depth * view.direction(80, 61) / view.spacing
        np.testing.assert_allclose(pick.index, at, atol=1e-9)
        away = np.linalg.norm(geometry.to_lps(np.array(pick.source)) - middle)
        assert away == pytest.approx(14, abs=1.2)
        if deformation is not None:
            np.testing.assert_allclose(deformation.forward(pick.source), pick.index, atol=1e-6)
        by = scene.drag(camera, size, pick, (100, 40))
        end = (np.array(pick.index) + by - view.eye) * view.spacing
        np.testing.assert_allclose(end / np.linalg.norm(end), view.direction(100, 40), atol=1e-9)
        # In the camera's plane: neither nearer nor farther.
        assert np.array(by) * view.spacing @ view.ahead == pytest.approx(0, abs=1e-9)
        assert scene.drag(camera, size, pick, (80, 61)) == pytest.approx((0, 0, 0), abs=1e-9)


def test_source_points_are_within_the_error() -> None:
    shape = (30, 30, 30)
    d = supple.Deformation(shape, border=3.0, on_fold="flow").grab((14, 14, 14), by=(6, 5, -6), radius=6, reach=None)
    assert Scene(cloud(shape), deformation=d, transfer=HARD, tolerance=1e-3).error == 1e-3
    assert Scene(cloud(shape), deformation=d, transfer=HARD, mode="exact").error == 0


def test_supersampling_smooths_outlines() -> None:
    volume = ball((40, 40, 40), Geometry(), np.full(3, 19.5), 14)
    scene = Scene(volume, transfer=HARD)
    edge, smooth = (scene.render(size=(48, 48), supersampling=n).light[..., 3] for n in (1, 4))
    assert set(np.unique(edge.round(3))) <= {0.0, 1.0}
    assert ((smooth > 0.1) & (smooth < 0.9)).sum() > 40
    assert smooth.sum() == pytest.approx(edge.sum(), rel=0.02)


def test_pixels() -> None:
    light = np.zeros((1, 3, 4), np.float32)
    light[0, 1] = 0.5, 0.25, 0.0, 0.5
    light[0, 2] = 1.2, 1.0, 1.0, 1.0
    picture = Rendering(light, np.zeros((1, 3)), np.zeros((1, 3), np.int64), np.zeros((1, 3), np.int64))
    np.testing.assert_array_equal(picture.pixels()[0], [[0, 0, 0, 0], [255, 188, 0, 128], [255, 255, 255, 255]])
    np.testing.assert_array_equal(picture.pixels((1.0, 1.0, 1.0))[0, 0], [255, 255, 255])
    # Half of a background of 0.5 in linear light, which is 188 in sRGB.
    np.testing.assert_array_equal(picture.pixels((188 / 255, 0.0, 0.0))[0, 1], [225, 137, 0])


@pytest.mark.parametrize("shape", [(1, 20, 20), (20, 1, 20), (2, 2, 2), (1, 1, 1), (5, 3, 30)])
def test_thin_volumes(shape: tuple[int, int, int]) -> None:
    volume = np.ones(shape, np.float32)
    volume.flat[0] = 0
    picture = Scene(volume, transfer=HARD).render(Camera(20, 30), (32, 32))
    assert np.isfinite(picture.light).all()
    if max(shape) > 1:
        assert picture.light[..., 3].max() > 0.9


def test_what_is_not_a_number_is_nothing() -> None:
    volume = ball((30, 30, 30), Geometry(), np.full(3, 14.5), 9)
    holes = volume.copy()
    holes[:4] = np.nan
    holes[-3:, :2] = -np.inf
    np.testing.assert_allclose(
        Scene(holes, transfer=HARD).render(size=SIZE).light,
        Scene(volume, transfer=HARD).render(size=SIZE).light,
        atol=1e-6,
    )
    assert Scene(np.full((5, 5, 5), np.nan)).render(size=(8, 8)).light.max() == 0


def test_values_beyond_what_light_is_made_of_are_refused() -> None:
    volume = ball((20, 20, 20), Geometry(), np.full(3, 9.5), 6)
    large = TransferFunction(((0.49, 1, 0.8, 0.6, 0), (0.5, 1, 0.8, 0.6, 1), (1, 1, 0.8, 0.6, 1)), relative=True)
    wanted = Scene(volume, transfer=large).render(size=SIZE)
    np.testing.assert_allclose(Scene(volume * 1e18, transfer=large).render(size=SIZE).light, wanted.light, atol=1e-3)
    gap = volume * 1e20
    gap[0, 0, 0] = np.nan
    for given in (volume * np.float32(1e19), -1e200 * volume.astype(np.float64), gap):
        refused(Scene, given, match=r"samples must be values from -1e\+18 to 1e\+18 .*divide")


def test_a_camera_inside() -> None:
    volume = np.full((30, 30, 30), 0.6, np.float32)
    volume[0, 0, 0] = 0
    picture = Scene(volume, transfer=HARD).render(Camera(distance=1.0), (16, 16))
    assert (picture.light[..., 3] > 0.99).all()
    assert picture.depth.max() < 2


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"samples": np.zeros((3, 3))}, "a volume of numbers"),
        ({"samples": np.zeros((3, 3, 3), complex)}, "a volume of numbers"),
        ({"samples": np.zeros((0, 3, 3))}, "a volume of numbers"),
        ({"mode": "fast"}, '"buffered" or "exact" or "hybrid"'),
        ({"transfer": "bone"}, '"ct-bone"'),
        ({"density": (3, 1)}, "the lower one first"),
        ({"density": (1,)}, "2 numbers"),
        ({"clip": "x"}, "clip must be a range of voxels for each axis"),
        ({"clip": ((1, 2), (math.nan, 2), (1, 2))}, "clip must be numbers of voxels, found nan"),
        ({"clip": ((1, 2), (5, 3), (1, 2))}, "clip must be from a lower to a higher voxel .*, found 5:3 along y"),
        ({"clip": ((1, 2), (7, None), (1, 2))}, "found 7:7 along y"),
        ({"clip": ((-1, 2), (1, 2), (1, 2))}, "within the voxels of the volume, 0:7, 0:7, 0:7, found -1:2 along x"),
        ({"step": 0}, "step must be millimetres from 0.001 to 1e9"),
        ({"tolerance": -1}, "tolerance"),
        ({"geometry": 3}, "geometry must be a Geometry, found 3"),
        ({"deformation": "x"}, "deformation must be a Deformation, found 'x'"),
        ({"deformation": supple.Deformation((4, 4, 4), border=64, on_fold="damp")}, "as the volume"),
        ({"deformation": supple.Deformation((8, 8, 8), spacing=2.0, border=64, on_fold="damp")}, "of spacing"),
    ],
)
def test_bad_scenes(given: dict[str, Any], text: str) -> None:
    known: dict[str, Any] = {"samples": np.zeros((8, 8, 8)), **given}
    refused(Scene, **known, match=text)


def test_other_things_than_cameras_and_deformations() -> None:
    scene: Any = Scene(cloud((8, 8, 8)))
    refused(scene.deformed, "x", match="deformation must be a Deformation, found 'x'")
    for given in ("x", "", 0):
        for call in (
            lambda c: scene.render(c, SIZE),
            lambda c: scene.pick(c, SIZE, (3, 3)),
            lambda c: scene.view(c, SIZE),
            lambda c: scene.turned(c, 1, 8),
        ):
            refused(call, given, match="camera must be a Camera, found")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"elevation": 100}, "from -90 to 90"),
        ({"distance": 0}, "from 1e-6"),
        ({"field_of_view": 180}, "from 1 to 150"),
        ({"up": (0, 0, 0)}, "a direction"),
        ({"target": (1, 2)}, "3 numbers"),
        ({"azimuth": math.nan}, "a number of degrees"),
    ],
)
def test_bad_cameras(given: dict[str, Any], text: str) -> None:
    refused(Camera, **given, match=text)
