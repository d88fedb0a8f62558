"""Volumes from file to file: values, places in space, labels, series, and what is refused."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

import supple
from supple.cli import command
from supple.engine.sampling import Sampling
from supple.errors import SuppleError, VolumeWarning
from supple.fields import Placed
from supple.files import Job, volumes, warp_file
from supple.files.freezing import read_freeze
from supple.files.options import VolumeOptions
from supple.files.volumes import deformation_of
from supple.media import volume as media
from supple.space.affine import Affine
from supple.space.geometry import Geometry
from tests import reference
from tests.files.clip_files import Run
from tests.refusals import refused

SHAPE = (20, 26, 24)
DIRECTION = np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]) @ np.diag([1.0, -1.0, 1.0])
OBLIQUE = Geometry((0.9, 1.1, 2.0), (10.0, -20.0, 30.0), DIRECTION, "LPS")
OFF = 0.9  # what 0.01 voxels are worth, where values rise by 90 from voxel to voxel
RECIPE = supple.Recipe(strokes=[supple.Stroke.grab((11, 13, 9), by=(3, -2, 1.5), radius=9)], border=8.0)
GRAB = ["--grab", "11,13,9:14,11,10.5", "--radius", "9", "--border", "8"]


def made(shape: tuple[int, ...] = SHAPE, dtype: Any = np.int16, seed: int = 0) -> npt.NDArray[Any]:
    rng = np.random.default_rng(seed)
    values = ndimage.gaussian_filter(rng.normal(size=shape), [2 if n > 5 else 0 for n in shape])
    values = (values - values.min()) / (values.max() - values.min())
    return (values * 1000 - (200 if np.dtype(dtype).kind != "u" else 0)).astype(dtype)


def stored(
    path: str, samples: npt.NDArray[Any], geometry: Geometry = OBLIQUE, *, series: bool = False
) -> npt.NDArray[Any]:
    media.write(path, samples, media.Volume(samples, geometry, series=series))
    return samples


def truth(samples: npt.NDArray[Any], recipe: supple.Recipe = RECIPE, order: int = 1) -> npt.NDArray[np.float64]:
    """The same by SciPy, from source points that are solved for one by one."""
    d = supple.Deformation.from_recipe(recipe, samples.shape[:3], spacing=OBLIQUE.spacing)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in samples.shape[:3]), indexing="ij")[::-1], axis=-1)
    places = np.moveaxis(d.inverse(grid).points, -1, 0)[::-1]
    planes = samples[..., None] if samples.ndim == 3 else samples
    seen = [
        ndimage.map_coordinates(planes[..., c].astype(np.float64), places, order=order, mode="nearest")
        for c in range(planes.shape[3])
    ]
    return np.stack(seen, axis=-1).reshape(samples.shape)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_a_volume_is_deformed_in_millimetres(here: Path, suffix: str, dtype: Any) -> None:
    samples = stored(f"in{suffix}", made(dtype=np.float32).clip(0, 255).astype(dtype))
    done = warp_file(f"in{suffix}", f"out{suffix}", RECIPE, filter="linear")
    out = media.read(f"out{suffix}")
    assert out.samples.dtype == dtype
    off = np.abs(out.samples - truth(samples))
    assert off.max() <= (OFF if dtype == np.float32 else OFF + 0.5)
    assert off.mean() < 0.3
    np.testing.assert_allclose(out.geometry.matrix, OBLIQUE.matrix, atol=1e-5)
    assert out.geometry.convention == ("RAS" if suffix.startswith(".nii") else "LPS")
    assert 0 < done.error <= 0.01
    assert done.report().within
    assert done.deformation.domain.spacing == pytest.approx(OBLIQUE.spacing)


@pytest.mark.parametrize("name", ["cubic", "auto"])
def test_cubic_filters_of_volumes_are_those_of_the_reference(name: str) -> None:
    """In the plane Keys' kernel with a = -0.75, between slices that of Catmull and Rom."""
    samples = made((18, 22, 20), np.float32)
    strokes = [supple.Stroke.grab((9, 12, 10), by=(4, -3, 2), radius=7)]
    d = supple.Deformation.from_recipe(supple.Recipe(strokes=strokes, border=None), samples.shape)
    how = Sampling(name, 1e-4).along_all_axes()
    assert (how.between, how.time_filter) == ("cubic", name == "auto")
    options: dict[str, Any] = {"filter": how.filter, "between": how.between, "time_filter": how.time_filter}
    wanted = reference.warp_frames(samples, strokes, d.domain, **options)
    np.testing.assert_allclose(d.warp(samples, **options, tolerance=1e-4), wanted, atol=0.1)
    assert np.abs(wanted - samples).max() > 100


def test_places_in_space(here: Path) -> None:
    """The same stroke by index, in LPS and in RAS; and in the file's own numbers as nibabel has them."""
    samples = stored("in.nii", made())
    media.write("in.nrrd", samples, media.Volume(samples, OBLIQUE))
    start, end = np.array([11.0, 13.0, 9.0]), np.array([14.0, 11.0, 10.5])
    affine = nibabel.load("in.nii").affine
    for name, places in (
        ("in.nii", [affine[:3, :3] @ p + affine[:3, 3] for p in (start, end)]),
        ("in.nrrd", [OBLIQUE.to_lps(p) for p in (start, end)]),
    ):
        given = supple.Recipe(strokes=[supple.Stroke.grab(places[0], to=places[1], radius=9)], border=8.0)
        warp_file(name, "world" + name[2:], given, volume=VolumeOptions(world=True))
        warp_file(name, "index" + name[2:], RECIPE)
        a, b = (media.read(kind + name[2:]).samples for kind in ("world", "index"))
        assert np.abs(a.astype(int) - b).max() <= 1
        assert np.abs(a.astype(int) - samples).max() > 50


@pytest.mark.parametrize("name", ["in.nii", "in.nrrd"])
@pytest.mark.parametrize("space", ["LPS", "RAS"])
def test_a_recipe_that_says_its_space_needs_no_world(here: Path, name: str, space: Any) -> None:
    samples = stored("in.nii", made())
    media.write("in.nrrd", samples, media.Volume(samples, OBLIQUE))
    start, end = (OBLIQUE.to_world(p, space) for p in ((11.0, 13.0, 9.0), (14.0, 11.0, 10.5)))
    recipe = supple.Recipe(strokes=[supple.Stroke.grab(start, to=end, radius=9)], border=8.0, space=space)
    Path("r.json").write_text(recipe.to_json())
    assert command(["warp", name, "out" + name[2:], "--recipe", "r.json"]) == 0
    warp_file(name, "index" + name[2:], RECIPE)
    a, b = (media.read(kind + name[2:]).samples for kind in ("out", "index"))
    assert np.abs(a.astype(int) - b).max() <= 1
    assert np.abs(a.astype(int) - samples).max() > 50


def test_spaces_that_do_not_fit_are_refused(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    samples = stored("in.nii", made())
    stored("in.tif", made())
    media.write("in.nrrd", samples, media.Volume(samples, OBLIQUE))
    place = ",".join(f"{x:.3f}" for x in OBLIQUE.to_world((11.0, 13.0, 9.0), "RAS"))
    grab = ["--grab", f"{place}:{place}", "--radius", "9"]
    assert command(["warp", "in.nii", "a.nii", *grab, "--world", "--save-recipe", "ras.json"]) == 0
    kept = supple.Recipe.from_json(Path("ras.json").read_text())
    assert (kept.space, kept.size) == ("RAS", SHAPE[::-1])
    assert command(["warp", "in.nii", "b.nii", *GRAB, "--save-recipe", "px.json"]) == 0
    assert supple.Recipe.from_json(Path("px.json").read_text()).space == "pixels"
    assert command(["warp", "in.nrrd", "c.nrrd", "--recipe", "ras.json"]) == 0  # the same place, in its own numbers
    capfd.readouterr()
    for given, wanted in (
        (["in.nii", "out.nii", "--recipe", "px.json", "--world"], "px.json is in pixels: leave it out"),
        (["in.nii", "out.nii", "--recipe", "px.json", *grab, "--world"], "px.json is in pixels: leave it out"),
        (["in.nii", "out.nii", "--recipe", "ras.json", *GRAB], "ras.json is in millimetres, and --grab"),
        (["in.nrrd", "out.nrrd", "--recipe", "ras.json", "--world"], "--world means LPS, as in.nrrd has them"),
        (["in.tif", "out.tif", "--recipe", "ras.json"], "in.tif does not know where it lies in space"),
        (["in.nii", "out.nii", "--recipe", "ras.json", "--fit", "pixels"], "--fit is for recipes in pixels"),
    ):
        assert command(["warp", *given]) == 2
        err = capfd.readouterr().err
        assert err.count("\n") == 1
        assert wanted in err
    assert not Path("out.nii").exists()


def test_a_border_that_is_elsewhere_is_told(here: Path) -> None:
    stored("in.nii", made())
    recipe = replace(RECIPE, space="RAS", border="auto", size=(9, 9, 9), strokes=())
    volume = media.read("in.nii")
    at = volume.geometry.to_world((10.0, 10.0, 8.0), "RAS").tolist()
    recipe = replace(recipe, strokes=(supple.Stroke.grab(at, by=(0.1, 0, 0), radius=3),))
    with pytest.warns(VolumeWarning, match="its border, a tenth of each axis, is elsewhere"):
        deformation_of(Job("", "", recipe), volume)
    for same in (replace(recipe, size=volume.sizes), replace(recipe, size=None), replace(recipe, border=2.0)):
        with warnings.catch_warnings(action="error", category=VolumeWarning):
            deformation_of(Job("", "", same), volume)


def test_voxels_of_another_size_are_not_scaled(here: Path) -> None:
    stored("in.nii", made())
    recipe = replace(RECIPE, size=(48, 52, 40))
    refused(warp_file, "in.nii", "out.nii", recipe, match=r"in\.nii is 24 x 26 x 20: voxels are not scaled")
    assert warp_file("in.nii", "out.nii", recipe, fit="pixels").deformation.strokes == RECIPE.strokes


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.int32, np.uint16, np.int64])
def test_labels_keep_their_values(here: Path, dtype: Any) -> None:
    samples = (made(dtype=np.float32) > 300).astype(dtype) * np.array(np.iinfo(dtype).max - 3, dtype)
    samples[5:9, 4:12, 3:8] = 7
    stored("in.nii.gz", samples)
    warp_file("in.nii.gz", "out.nii.gz", RECIPE, volume=VolumeOptions(labels=True))
    out = media.read("out.nii.gz").samples
    assert out.dtype == dtype
    assert set(np.unique(out)) == set(np.unique(samples))
    # The values of the nearest voxels, but where two are as near.
    assert (out == truth(samples.astype(np.float64), order=0)).mean() > 0.998
    for name in ("linear", "cubic"):
        with pytest.raises(supple.SuppleError, match="labels"):
            warp_file("in.nii.gz", "x.nii.gz", RECIPE, filter=name, volume=VolumeOptions(labels=True))


def test_labels_may_be_stored_as_floats(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    samples = np.round(made(dtype=np.float32) / 200).astype(np.float32) * 7
    stored("in.nii.gz", samples)
    warp_file("in.nii.gz", "out.nii.gz", RECIPE, volume=VolumeOptions(labels=True))
    out = media.read("out.nii.gz").samples
    assert out.dtype == np.float32
    assert set(np.unique(out)) == set(np.unique(samples))
    assert (out != samples).mean() > 0.01
    samples[3, 4, 5] = 1.5
    stored("f.nii.gz", samples)
    for more, told in (
        (["f.nii.gz", "x.nii.gz", "--labels"], "--labels is for whole numbers, and f.nii.gz holds 1.5: leave it out"),
        (["in.nii.gz", "x.nii.gz", "--labels", "--filter", "cubic"], '--labels needs filter "nearest"'),
    ):
        assert command(["warp", *more, *GRAB]) == 2
        assert told in capfd.readouterr().err
    assert not Path("x.nii.gz").exists()


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_what_looks_like_labels_is_said(here: Path, dtype: Any) -> None:
    """Few whole numbers in large areas; neither noise, nor smooth pictures of few values, nor a head on black."""
    grid = np.indices((40, 40, 40))
    regions = (((grid // 10).sum(axis=0) * 37) % 200).astype(dtype)
    mask = (np.square(grid - 20).sum(axis=0) < 200).astype(dtype)
    noise = np.random.default_rng(0).integers(0, 4, (40, 40, 40)).astype(dtype)
    smooth = np.round(100 + 60 * np.sin(grid / 25).sum(axis=0)).astype(dtype)
    recipe = supple.Recipe(strokes=[supple.Stroke.grab((20, 20, 20), by=(2, 0, 1), radius=6)])
    for samples, said in ((regions, True), (mask, True), (noise, False), (smooth, False), (mask * noise * 9, False)):
        media.write("in.nii", samples, media.Volume(samples, OBLIQUE), force=True)
        with warnings.catch_warnings(record=True, action="always") as told:
            warp_file("in.nii", "out.nii", recipe, force=True, filter="linear")
        count = len(np.unique(samples))
        wanted = f"in.nii looks like a label map, of {count} values, and its labels are mixed where they meet: "
        wanted += "labels=True keeps them"
        assert [str(one.message) for one in told] == [wanted] * said
        warp_file("in.nii", "out.nii", recipe, force=True, volume=VolumeOptions(labels=True))


def blocks_of(dtype: Any) -> npt.NDArray[Any]:
    """Blocks with sharp edges, beside which cubics overshoot."""
    return np.where(np.indices(SHAPE).sum(axis=0) // 4 % 2, -1024, 1500).astype(dtype)


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_values_stay_within_their_range(here: Path, dtype: Any) -> None:
    stored("in.nii", blocks_of(dtype))
    options: dict[str, Any] = {"filter": "cubic", "force": True}
    warp_file("in.nii", "out.nii", RECIPE, clamp=False, **options)
    free = np.array(media.read("out.nii").samples)
    assert free.min() < -1100
    assert free.max() > 1600
    supple.warp_file("in.nii", "out.nii", RECIPE, **options)
    kept = media.read("out.nii").samples
    np.testing.assert_array_equal(kept, free.clip(-1024, 1500))


@pytest.mark.parametrize(
    ("dtype", "scaling", "fill"),
    [
        ("i2", (1, -1024), -1024),
        ("u1", (4, -1024), -24),
        ("i2", (-0.5, 3), 1000.5),
        ("f4", (2, -10), -3000),
        ("u2", (0.1, 0), 0.3),
        ("i2", (1, 0), -2000),
    ],
)
@pytest.mark.parametrize("target", ["out.nii.gz", "out.nrrd", "out.mha"])
def test_a_fill_is_a_true_value(here: Path, dtype: str, scaling: Any, fill: float, target: str) -> None:
    image = nibabel.Nifti1Image(np.full((8, 7, 6), 20, dtype).T, np.eye(4))
    image.header["scl_slope"], image.header["scl_inter"] = scaling
    nibabel.save(image, "in.nii")
    with open("in.nii", "r+b") as file:  # nibabel computes a scaling of its own
        file.seek(112)
        file.write(np.array(scaling, "<f4").tobytes())
    away = Placed(Affine(np.c_[np.eye(3), (3, 0, 0)]))
    supple.warp_file("in.nii", target, supple.Recipe(strokes=[]), maps=[away], outside="constant", fill=fill)
    seen = media.read(target).rescaled()
    found = {round(float(value), 4) for value in np.unique(seen)}
    assert found == {fill, round(20 * scaling[0] + scaling[1], 4)}


def test_the_scaling_of_a_metaimage(here: Path) -> None:
    head = "NDims = 3\nDimSize = 6 5 4\nElementType = MET_SHORT\nElementToIntensityFunctionSlope = 2\n"
    head += "ElementToIntensityFunctionOffset = -10\nElementMin = 0\nElementDataFile = LOCAL\n"
    Path("in.mha").write_bytes(head.encode() + bytes(240))
    assert media.read("in.mha").scaling == (2, -10)
    away = Placed(Affine(np.c_[np.eye(3), (3, 0, 0)]))
    supple.warp_file("in.mha", "out.mha", supple.Recipe(strokes=[]), maps=[away], outside="constant", fill=-7)
    assert set(np.unique(media.read("out.mha").samples)) == {-10, -7}  # between two steps of the input
    assert b"ElementM" not in Path("out.mha").read_bytes()
    Path("bad.mha").write_bytes(head.replace("Slope = 2", "Slope = 0").encode() + bytes(240))
    refused(media.read, "bad.mha", match="scaled by 0, plus -10")


def test_a_fill_that_is_not_held(run: Run) -> None:
    stored("in.nii", np.zeros((8, 8, 8), np.uint8), Geometry())
    command = ("warp", "in.nii", "out.nrrd", "--affine", "1,0,0,8,0,1,0,0,0,0,1,0", "--outside", "constant", "--fill")
    status, _, err = run(*command, "-1")
    assert status == 2
    assert "--fill must be from 0 to 255, which in.nii can hold (uint8, unscaled), found '-1'" in err.splitlines()[-1]
    assert not Path("out.nrrd").exists()
    assert run(*command, "7.6")[0] == 0  # rounded, as all values are
    assert 8 in media.read("out.nrrd").samples


@pytest.mark.parametrize("target", ["out.nii", "out.mha", "out.nrrd"])
def test_the_background_of_scaled_labels(here: Path, target: str) -> None:
    mask = np.zeros((9, 9, 9), np.uint8)
    mask[3:6, 3:6, 3:6] = 3
    media.write("mask.nii", mask, media.Volume(mask, Geometry(), scaling=(2.0, -1.0)))
    away = Placed(Affine(np.c_[np.eye(3), (4, 0, 0)]))
    on = supple.GridOptions(reference="mask.nii")
    labels = VolumeOptions(labels=True)
    made = supple.warp_file("mask.nii", target, supple.Recipe(strokes=[]), maps=[away], volume=labels, grid=on)
    assert getattr(made, "background") == -1  # noqa: B009
    assert set(np.unique(media.read(target).rescaled())) == {-1, 5}  # no label that the source lacks


@pytest.mark.parametrize("target", ["out.nrrd", "out.zarr"])
def test_the_background_of_components(here: Path, target: str) -> None:
    vectors = np.stack([np.full((9, 9, 9), x, np.float32) for x in (20, -50)], axis=-1)
    stored("in.nrrd", vectors, Geometry())
    away = Placed(Affine(np.c_[np.eye(3), (4, 0, 0)]))
    on = supple.GridOptions(reference="in.nrrd")
    assert warp_file("in.nrrd", target, supple.Recipe(strokes=[]), maps=[away], grid=on).background == 0


def test_labels_of_scaled_masks_are_true_values(here: Path) -> None:
    mask = np.full((9, 9, 9), 10, np.uint8)
    mask[3:6, 3:6, 3:6] = 30
    media.write("mask.nii", mask, media.Volume(mask, Geometry(), scaling=(0.1, -1.0)))
    assert read_freeze("mask.nii") == read_freeze("mask.nii", label=2)
    refused(read_freeze, "mask.nii", label=30, match="no label 30: found 0, 2")


def test_values_that_are_not_finite_are_not_clamped() -> None:
    samples = blocks_of(np.float32)
    samples[1, 1, 1:4] = np.nan, np.inf, -np.inf
    samples[-2, -2, -2] = -0.0
    d = supple.Deformation(SHAPE, border=None).grab((11, 13, 9), by=(3, -2, 1.5), radius=3, reach=2)
    kept = d.warp(samples, filter="cubic", clamp=True)
    finite = kept[np.isfinite(kept)]
    assert (finite.min(), finite.max()) == (-1024, 1500)
    free = d.warp(samples, filter="cubic")
    inside = (free >= -1024) & (free <= 1500) | ~np.isfinite(free)
    np.testing.assert_array_equal(kept.view(np.uint32)[inside], free.view(np.uint32)[inside])
    assert not inside.all()
    assert np.isinf(kept[1, 1, 2:4]).all()
    image = supple.Deformation((9, 9)).grab((4, 4), by=(1, 0), radius=3)
    empty = np.full((9, 9), np.nan)
    assert np.isnan(image.warp(empty, clamp=True)).all()
    refused(image.warp, empty, clamp="yes", match="clamp must be True or False")


def test_pictures_of_floats_stay_within_their_range(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from supple.media import image

    pixels = (np.indices((40, 50)).sum(axis=0) // 4 % 2).astype(np.float32)
    image.write("in.tif", pixels)
    image.write("in8.png", (pixels * 99 + 100).astype(np.uint8))
    grab = ["--grab", "20,20:24,18", "--radius", "8"]
    low = {}
    for name, more in (("a.tif", []), ("b.tif", ["--no-clamp"]), ("c.png", []), ("d.png", ["--clamp"])):
        assert command(["warp", "in8.png" if name.endswith("png") else "in.tif", name, *grab, *more]) == 0
        low[name] = float(image.read(name).pixels.min())
    assert low["a.tif"] == 0
    assert low["b.tif"] < -0.05
    assert low["c.png"] < 95
    assert low["d.png"] == 100
    capfd.readouterr()
    Path("frames").mkdir()
    image.write("frames/001.png", np.zeros((9, 9), np.uint8))
    image.write("frames/002.png", np.zeros((9, 9), np.uint8))
    assert command(["warp", "frames/%03d.png", "o/%03d.png", "--grab", "3,3:4,4", "--radius", "3", "--clamp"]) == 2
    assert "--clamp is for pictures and volumes" in capfd.readouterr().err


def test_vectors_and_series(here: Path) -> None:
    vectors = np.stack([made(seed=k, dtype=np.float32) for k in range(3)], axis=-1)
    stored("v.nrrd", vectors)
    warp_file("v.nrrd", "v2.nrrd", RECIPE, filter="linear")
    np.testing.assert_allclose(media.read("v2.nrrd").samples, truth(vectors), atol=OFF)
    times = np.stack([made(seed=k) for k in range(4)])
    stored("t.nii.gz", times, series=True)
    done = warp_file("t.nii.gz", "t2.nii.gz", RECIPE, filter="linear")
    out = media.read("t2.nii.gz")
    assert out.series
    assert done.frames == 4
    for k in range(4):
        assert np.abs(out.samples[k] - truth(times[k])).max() <= OFF + 0.5


def test_what_is_not_a_number_stays_where_it_is(here: Path) -> None:
    samples = made(dtype=np.float32)
    samples[3, 4:6, 5] = np.nan
    stored("in.nii", samples)
    with pytest.warns(supple.errors.GapWarning, match="2 voxels of in.nii are NaN or infinite"):
        warp_file("in.nii", "out.nii", RECIPE, filter="linear")
    with warnings.catch_warnings(action="error"):
        warp_file("in.nii", "near.nii", RECIPE, filter="nearest")
    assert 1 <= np.isnan(media.read("near.nii").samples).sum() < 10
    out = media.read("out.nii").samples
    assert 1 <= np.isnan(out).sum() < 60
    known = ~np.isnan(out)
    expected = truth(np.nan_to_num(samples))
    far = ndimage.binary_dilation(~known, iterations=2)
    np.testing.assert_allclose(out[~far], expected[~far], atol=OFF)


def test_the_sidecar_of_bids_comes_along(here: Path) -> None:
    stored("head.nii.gz", made())
    sidecar = '{"RepetitionTime": 2.3, "Manufacturer": "Siemens"}'
    (here / "head.json").write_text(sidecar)
    for _ in range(2):
        warp_file("head.nii.gz", "bent.nii.gz", RECIPE, force=True)
        assert (here / "bent.json").read_text() == sidecar
    (here / "bent.json").write_text(mine := '{"mine": 1}')
    with pytest.warns(VolumeWarning, match=r"bent\.json is there already, and stays as it is"):
        warp_file("head.nii.gz", "bent.nii.gz", RECIPE, force=True)
    assert (here / "bent.json").read_text() == mine
    for text in (RECIPE.to_json(), "[1]", "{"):  # which are no sidecars
        (here / "head.json").write_text(text)
        warp_file("head.nii.gz", "other.nii.gz", RECIPE, force=True)
        assert not (here / "other.json").exists()


@pytest.mark.filterwarnings("ignore:.* moves nothing")
def test_nothing_to_do_is_a_copy(here: Path) -> None:
    stored("in.nii.gz", made())
    still = supple.Recipe(strokes=[supple.Stroke.grab((5, 5, 5), by=(0, 0, 0), radius=5)])
    warp_file("in.nii.gz", "out.nii.gz", still)
    assert Path("in.nii.gz").read_bytes() == Path("out.nii.gz").read_bytes()
    warp_file("in.nii.gz", "out.nrrd", still)
    np.testing.assert_array_equal(media.read("out.nrrd").samples, media.read("in.nii.gz").samples)


def test_results_too_large_for_memory_go_through_a_file(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = stored("in.nii", made())
    warp_file("in.nii", "a.nii", RECIPE, filter="cubic")
    monkeypatch.setattr(volumes, "machine_memory", lambda: samples.nbytes * 2.0)
    warp_file("in.nii", "b.nii", RECIPE, filter="cubic")
    assert Path("a.nii").read_bytes() == Path("b.nii").read_bytes()
    monkeypatch.setattr("supple.engine.memory.reserve", _full)
    for name in ("c.nii", "{}{size}.nii"):
        with pytest.raises(
            supple.SuppleError, match=rf"no room for it beside {re.escape(name)} \(No space left on device\)"
        ):
            warp_file("in.nii", name, RECIPE, filter="cubic")
    assert sorted(p.name for p in here.iterdir()) == ["a.nii", "b.nii", "in.nii"]


def _full(*_: Any, **__: Any) -> None:
    raise OSError(28, "No space left on device")


def test_raw_files(here: Path) -> None:
    samples = made(dtype=np.uint16)
    Path("x.bin").write_bytes(samples.tobytes())
    sizes = np.array(SHAPE[::-1], "<u2").tobytes()
    Path("x.dat").write_bytes(sizes + samples.astype("<u2").tobytes())
    spacing = ",".join(str(s) for s in OBLIQUE.spacing)
    shape = ",".join(str(n) for n in SHAPE[::-1])
    given = ["--shape", shape, "--dtype", "<u2", "--spacing", spacing, "--filter", "linear"]
    assert command(["warp", "x.bin", "bin.nii", *GRAB, *given]) == 0
    out = media.read("bin.nii")
    assert np.abs(out.samples - truth(samples)).max() <= OFF + 0.5
    assert out.geometry.spacing == pytest.approx(OBLIQUE.spacing)
    assert command(["warp", "x.dat", "dat.nii", *GRAB]) == 0
    assert media.read("dat.nii").geometry.spacing == (1, 1, 1)


def test_what_is_oblique_is_said(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    stored("in.nii.gz", made())
    stored("straight.nrrd", made(), Geometry(OBLIQUE.spacing, (10, 0, 0), np.eye(3)[[1, 2, 0]], "LPS"))
    assert command(["info", "in.nii.gz", "straight.nrrd"]) == 0
    oblique, straight = capfd.readouterr().out.split("straight.nrrd")
    assert ", oblique by up to 36.9°\n" in oblique
    assert "oblique" not in straight


def test_a_field_is_left_only_with_its_volume(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored("in.nii", made())
    monkeypatch.setattr(volumes, "write", _full)
    with pytest.raises(supple.SuppleError, match="No space left"):
        warp_file("in.nii", "out.nii", RECIPE, save_field="f.nii")
    assert [p.name for p in here.iterdir()] == ["in.nii"]
    monkeypatch.undo()
    monkeypatch.chdir(here)
    warp_file("in.nii", "out.nii", RECIPE, save_field="f.nii")
    assert sorted(p.name for p in here.iterdir()) == ["f.nii", "in.nii", "out.nii"]


def test_an_interrupt_leaves_nothing(here: Path) -> None:
    stored("in.nii", made())
    seen = []

    def stop(step: str, done: int, total: int) -> None:
        seen.append((step, done, total))
        if step == "warp":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warp_file("in.nii", "out.nii", RECIPE, tell=stop)
    assert seen[0][0] == "read"
    assert seen[-1][2] == SHAPE[0]
    assert [p.name for p in here.iterdir()] == ["in.nii"]


@pytest.mark.parametrize("name", ["linear", "nearest"])
def test_slabs_that_flow_into_a_file_are_those_of_the_whole(
    here: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    voxels = np.random.default_rng(4).integers(-900, 900, (37, 12, 11)).astype(np.int16)
    nibabel.save(nibabel.Nifti1Image(voxels.T, np.diag([1.0, 1.0, 2.0, 1.0])), here / "in.nii")
    stroke = supple.Stroke.grab((5, 6, 18), by=(1, 1.5, 2), radius=8)
    warp_file(here / "in.nii", here / "out.nii.gz", supple.Recipe(strokes=[stroke]), filter=name)
    wanted = supple.Deformation(voxels.shape, spacing=(1, 1, 2)).add(stroke).warp(voxels, filter=name)
    np.testing.assert_array_equal(np.asarray(nibabel.load(here / "out.nii.gz").dataobj).T, wanted)
    counted, plain = iter(range(2)), volumes.warp_array

    def failing(*given: Any, **options: Any) -> Any:
        if next(counted, None) is None:
            raise SuppleError("a later slab fails")
        return plain(*given, **options)

    monkeypatch.setattr(volumes, "warp_array", failing)
    with pytest.raises(SuppleError, match="later slab"):
        warp_file(here / "in.nii", here / "bad.nii", supple.Recipe(strokes=[stroke]), filter=name)
    assert sorted(path.name for path in here.iterdir()) == ["in.nii", "out.nii.gz"]
