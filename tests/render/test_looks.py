"""Projections, planes, silhouettes, what is detached, and cameras that have what is visible in view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import supple
from supple.cli import command
from supple.errors import SuppleError
from supple.files.jobs import Job
from supple.files.renders import RenderOptions, render_file
from supple.files.volumes import open_volume
from supple.media import image
from supple.render.appearance import largest
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry
from tests.render.scenes import CAMERA, HARD, OBLIQUE, SHAPE, ball, bent, cloud
from tests.render.test_files import head, stored

SIZE = (30, 36)
REDUCE: dict[str, Any] = {"maximum": np.max, "minimum": np.min, "average": np.mean}


@pytest.mark.parametrize("mode", ["plain", "exact", "buffered"])
@pytest.mark.parametrize("projection", REDUCE)
def test_a_projection_is_the_slow_one(projection: str, mode: str) -> None:
    d = None if mode == "plain" else bent()
    scene = Scene(
        cloud(),
        OBLIQUE,
        deformation=d,
        projection=projection,
        density=(0.2, 0.9),
        mode="buffered" if d is None else mode,
        clip=((None, 22.5), (3, None), (None, None)),
    )
    picture, view = scene.render(CAMERA, SIZE), scene.view(CAMERA, SIZE)
    first, last = np.array(scene.clip).T
    wanted, where = np.full(SIZE, np.nan), np.full(SIZE, np.nan)
    for y, x in np.ndindex(SIZE):
        along = view.direction(x, y) / view.spacing
        faces = np.stack([(first - view.eye) / along, (last - view.eye) / along])
        near, far = faces.min(axis=0).max(), faces.max(axis=0).min()
        if near > far:
            continue
        ts = np.arange(near, far + 1e-9, scene.step)
        points = view.eye + ts[:, None] * along
        if d is not None and mode == "exact":
            points = d.inverse(points).points
        values = ndimage.map_coordinates(scene.samples.astype(float), points[:, ::-1].T, order=1, mode="nearest")
        wanted[y, x] = REDUCE[projection](values)
        where[y, x] = near if projection == "average" else ts[np.argmax(values == wanted[y, x])]
    hit = np.isfinite(wanted)
    assert 300 < hit.sum() < hit.size
    np.testing.assert_array_equal(picture.light[..., 3], hit)
    shades = np.clip((wanted[hit] - 0.2) / 0.7, 0, 1) * 255
    assert np.ptp(shades) > 90
    off = np.abs(picture.pixels()[hit][:, :3] - shades[:, None])
    assert np.quantile(off, 0.99) < 1.5  # a ray may end a sample earlier
    assert np.quantile(np.abs(picture.depth[hit] - where[hit]), 0.95) < 1e-3 + (mode == "exact")


def test_a_maximum_has_no_box_of_air() -> None:
    volume = np.maximum(ball(9, (13, 14, 11)), 0.03 * np.random.default_rng(1).random(SHAPE).astype(np.float32))
    volume[0, 0, 0], volume[0, 0, 1] = 0, 1  # the window, whatever the noise
    scene = Scene(volume, OBLIQUE, projection="maximum")
    seen = scene.render(CAMERA, (90, 90)).light
    flat = Scene(volume, OBLIQUE, projection="average").render(CAMERA, (90, 90)).light[..., 3] > 0
    assert flat.mean() > 0.3
    assert (seen[flat][:, 3] == 0).mean() > 0.3  # the air of the box
    assert (seen[..., 3] == 1).sum() > 200
    assert (seen[..., :3].max(axis=-1) <= seen[..., 3] + 1e-6).all()  # premultiplied


def test_a_projection_is_picked_where_its_value_is() -> None:
    volume = cloud() * np.float32(0.1)
    volume[12, 14, 15] = 1
    scene = Scene(volume, OBLIQUE, projection="maximum", step=0.1)
    picture = scene.render(CAMERA, (90, 90))
    y, x = np.unravel_index(int(picture.light[..., 0].argmax()), (90, 90))
    pick = scene.pick(CAMERA, (90, 90), (int(x), int(y)))
    assert pick is not None
    np.testing.assert_allclose(pick.index, (15, 14, 12), atol=0.6)
    assert Scene(volume, OBLIQUE, projection="average").pick(CAMERA, (90, 90), (int(x), int(y))) is None


@pytest.mark.parametrize("mode", ["buffered", "exact"])
def test_a_plane_along_the_axes_is_a_box(mode: str) -> None:
    options: dict[str, Any] = {"deformation": bent(), "transfer": HARD, "mode": mode}
    scene = Scene(cloud(), OBLIQUE, **options)
    ways = OBLIQUE.direction.T  # of x, y and z, in LPS
    for axis, sign in ((0, 1), (1, -1), (2, 1)):
        box: list[list[float | None]] = [[None, None] for _ in range(3)]
        box[axis][sign > 0] = 11.5
        cut = scene.clipped(None, plane=((11.5, 11.5, 11.5), tuple(sign * ways[axis])))
        one, other = cut.render(CAMERA, SIZE), scene.clipped(box).render(CAMERA, SIZE)
        assert np.abs(other.light - scene.render(CAMERA, SIZE).light).max() > 0.3
        assert np.quantile(np.abs(one.light - other.light).max(axis=-1), 0.98) < 1e-4
        np.testing.assert_array_equal(cut.clipped(None).render(CAMERA, SIZE).light, scene.render(CAMERA, SIZE).light)


def test_an_oblique_plane_leaves_what_is_before_it() -> None:
    at, way = np.array([13.0, 15.0, 11.0]), np.array([0.5, -0.8, 0.4])
    scene = Scene(ball(12, (13, 15, 11)), OBLIQUE, transfer=HARD, plane=(tuple(at), tuple(way)), step=0.2)
    beyond = 0
    for azimuth in range(0, 360, 45):
        camera = Camera(azimuth, 20)
        picture, view = scene.render(camera, SIZE), scene.view(camera, SIZE)
        for y, x in np.argwhere(np.isfinite(picture.depth)):
            found = view.eye + picture.depth[y, x] * view.direction(x, y) / view.spacing
            millimetres = (OBLIQUE.to_lps(found[None]) - OBLIQUE.to_lps(at[None]))[0] @ way / np.linalg.norm(way)
            assert millimetres < 1e-3
            beyond += bool(abs(millimetres) < 1e-3)
    assert beyond > 200  # on the cut face
    away = Scene(ball(12, (13, 15, 11)), OBLIQUE, transfer=HARD, plane=((-90, 15, 11), tuple(OBLIQUE.direction.T[0])))
    assert not away.render(CAMERA, SIZE).light.any()


def test_silhouettes_darken_by_the_angle() -> None:
    centre = (13.0, 14.0, 11.5)
    plain, dark = (Scene(ball(13, centre), OBLIQUE, transfer=HARD, silhouettes=s, step=0.2) for s in (0.0, 0.8))
    camera = Camera(20, 10)
    one, other, view = plain.render(camera, (60, 60)), dark.render(camera, (60, 60)), plain.view(camera, (60, 60))
    np.testing.assert_array_equal(one.depth, other.depth)
    compared, off = 0, []
    for y, x in np.argwhere(one.light[..., 3] > 0.99):
        way = view.direction(x, y)
        normal = (view.eye - centre) * view.spacing + one.depth[y, x] * way
        aside = 1 - abs(normal @ way) / np.linalg.norm(normal)
        left = other.light[y, x, 0] / one.light[y, x, 0]
        off.append(abs(left - (1 - 0.8 * aside**2)))
        compared += aside > 0.5
    assert compared > 50
    assert np.mean(off) < 0.03  # gradients of trilinear samples are off by some degrees
    assert max(off) < 0.15


def test_the_largest_part_is_what_ndimage_labels() -> None:
    volume = np.random.default_rng(3).normal(size=SHAPE)
    volume = ndimage.gaussian_filter(volume, 1.5).astype(np.float32)
    volume = (volume - volume.min()) / np.ptp(volume)
    density = (0.7, 0.95)
    for value in (0.65, 0.75):
        transfer = TransferFunction(((value, 1, 1, 1, 0), (value + 0.1, 1, 1, 1, 0.5), (1, 1, 1, 1, 0.5)))
        for window in (None, density):
            threshold = Scene(volume, transfer=transfer, density=window)._seen.threshold
            seen = (volume >= threshold) & (volume <= (np.inf if window is None else window[1]))
            labels, count = ndimage.label(seen)
            assert count > 1
            kept = labels == np.bincount(labels.ravel())[1:].argmax() + 1
            made = largest(volume, transfer, window)
            np.testing.assert_array_equal(made[kept | ~seen], volume[kept | ~seen])
            hidden = made[seen & ~kept]
            assert hidden.size
            assert (hidden == volume[volume < threshold].max()).all()
    with pytest.raises(SuppleError, match="all is visible"):
        largest(volume, TransferFunction(((0.0, 1, 1, 1, 0.5),)))


@pytest.mark.parametrize("mode", ["exact", "buffered"])
def test_what_is_visible_is_in_view(mode: str) -> None:
    d = supple.Deformation(SHAPE, spacing=OBLIQUE.spacing, border=None, on_fold="damp").grab(
        (8, 9, 8), by=(7, 6, 3), radius=14
    )
    for deformation in (None, d):
        scene = Scene(ball(7, (8, 9, 8)), OBLIQUE, deformation=deformation, transfer=HARD, mode=mode)
        for azimuth in (0, 70, 200):
            camera = scene.framed(Camera(azimuth, 15), (80, 80))
            alpha = scene.render(camera, (80, 80)).light[..., 3] > 0.5
            rows, columns = np.flatnonzero(alpha.any(axis=1)), np.flatnonzero(alpha.any(axis=0))
            assert min(rows[0], columns[0]) > 0
            assert max(rows[-1], columns[-1]) < 79
            whole = scene.render(Camera(azimuth, 15), (80, 80)).light[..., 3] > 0.5
            assert alpha.sum() > 1.5 * whole.sum()
    assert scene.framed(Camera(distance=90, target=(3, 4, 5)), SIZE) == Camera(distance=90.0, target=(3, 4, 5))
    nothing = Scene(ball(7, (8, 9, 8)), OBLIQUE, transfer=HARD, density=(5, 6))
    np.testing.assert_allclose(
        nothing.view(nothing.framed(None, SIZE), SIZE).packed, nothing.view(None, SIZE).packed, atol=1e-9
    )


def test_the_command_does_what_python_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    stored("in.nii", head())
    given: dict[str, tuple[list[str], dict[str, Any]]] = {
        "maximum": (["--projection", "maximum", "--density", "-10,150"],
                    {"projection": "maximum", "density": (-10.0, 150.0)}),
        "plane": (["--plane", "13,14,12:0.2,-1,0"], {"plane": ((13, 14, 12), (0.2, -1, 0))}),
        "largest": (["--largest"], {"largest": True}),
        "cropped": (["--crop", "4:12,:,:9"], {"crop": ((4, 12), (None, None), (None, 9))}),
        "cut": (["--clip", ":, 12.5:,2:20"], {"clip": ((None, None), (12.5, None), (2, 20))}),
        "dark": (["--silhouettes", "0.7"], {"silhouettes": 0.7}),
        "shadowed": (["--shadows", "0.8"], {"shadows": 0.8}),
        "plain": ([], {}),
    }  # fmt: skip
    for name, (words, options) in given.items():
        assert command(["render", "in.nii", f"{name}.png", "--size", "60x50", *words]) == 0
        render_file(Job("in.nii", f"{name}2.png"), options=RenderOptions(size=(50, 60), **options))
        seen = image.read(f"{name}.png").pixels
        np.testing.assert_array_equal(seen, image.read(f"{name}2.png").pixels)
    plain = image.read("plain.png").pixels
    for name in ("maximum", "plane", "cropped", "cut", "dark", "shadowed"):
        assert (image.read(f"{name}.png").pixels != plain).any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--projection", "maximum", "--transfer", "grey"],
            "is of all values along a ray, in grey: leave --transfer out",
        ),
        (["--projection", "most"], "--projection"),
        (["--crop", "1:2,3:4"], "--crop must be X0:X1,Y0:Y1,Z0:Z1 in voxels"),
        (["--crop", "1:900,:,:"], "crop must be within the voxels of the volume"),
        (["--crop", "4:9,:,:", "--projection", "maximum"], "leave --crop out"),
        (["--what", "inversions", "--shadows", "1"], "of the volume alone: leave shadows out"),
        (["--convention", "LPS"], "--convention of points is of tables of --pull"),
        (["--plane", "1,2,3"], "--plane must be a voxel and a direction, X,Y,Z:DX,DY,DZ, found '1,2,3'"),
        (["--plane", "1,2,3:0,0,0"], "a direction that is not 0,0,0"),
        (["--plane", "1,2:0,0,1"], "--plane must be a voxel and a direction"),
        (["--silhouettes", "2"], "silhouettes must be a number from 0 to 1"),
        (["--silhouettes", "1", "--unshaded"], "silhouettes and shadows are of shaded surfaces"),
        (["--shadows", "2"], "shadows must be a number from 0 to 1"),
        (["--shadows", "1", "--unshaded"], "silhouettes and shadows are of shaded surfaces"),
        (["--shadows", "1", "--projection", "average"], "a projection (average) is of all values along a ray"),
        (["--unshaded", "--projection", "maximum"], "a projection (maximum) is of all values along a ray, in grey"),
        (["--largest", "--density", "-5,300", "--transfer", "all.json"], "all is visible"),
    ],
)
def test_what_does_not_fit_is_refused_on_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    stored("in.nii", head())
    Path("all.json").write_text(TransferFunction(((0.0, 1, 1, 1, 0.5),)).to_json())
    assert command(["render", "in.nii", "out.png", *words]) != 0
    error = capsys.readouterr().err.strip()
    assert said in error
    assert "Traceback" not in error
    assert not Path("out.png").exists()


def test_windows_of_values_are_whole_at_the_default_step() -> None:
    """What lies between two samples is seen, however narrow the window."""
    whole = open_volume(Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz")
    for density, least in ((None, 43.0), ((60.0, 120.0), 36.0), ((90.0, 110.0), 29.0), ((100.0, 104.0), 27.0)):
        made = []
        for step in (None, 0.2):
            scene = Scene(whole.samples, whole.geometry, transfer="mr-head", density=density, step=step)
            camera = scene.framed(Camera(40, 20), (200, 200))
            made.append(scene.render(camera, (200, 200)).pixels((0.0, 0.0, 0.0)).astype(np.float64))
        assert 10 * np.log10(255**2 / np.mean((made[0] - made[1]) ** 2)) > least


def test_slices_that_are_far_apart_are_smoothed_and_nothing_else() -> None:
    samples = np.random.default_rng(1).integers(0, 255, (6, 7, 8), np.uint8)
    coarse = Geometry(spacing=(1.0, 1.0, 2.5))
    wanted = np.rint(ndimage.correlate1d(samples.astype(float), [1, 4, 1], axis=0, mode="nearest") / 6)
    assert np.array_equal(Scene(samples, coarse).samples, wanted)
    ct = samples.astype(np.int16) * 8 - 1000  # in Hounsfield units, which presets are for
    for kept in (samples, ct):
        assert np.array_equal(Scene(kept, Geometry(spacing=(1.0, 1.0, 2.0))).samples, kept)
    assert np.array_equal(Scene(ct, coarse).samples, ct)
    assert np.array_equal(Scene(samples, coarse, projection="maximum").samples, samples)
