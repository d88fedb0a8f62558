"""Volumes, TIFFs and pictures warped to Zarr stores: equal to the whole, read in parts, and where they were."""

from __future__ import annotations

import itertools
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

zarr = pytest.importorskip("zarr")
pytest.importorskip("dask")
tifffile = pytest.importorskip("tifffile")
nibabel = pytest.importorskip("nibabel")

from PIL import Image  # noqa: E402

from supple import Deformation, Recipe, Stroke, SuppleError  # noqa: E402
from supple.errors import VolumeWarning  # noqa: E402
from supple.files import stores, warp_file  # noqa: E402
from supple.files.jobs import Job  # noqa: E402
from supple.files.options import GridOptions, VolumeOptions  # noqa: E402
from supple.files.stores import plan_file  # noqa: E402
from supple.media.stores import inputs, target  # noqa: E402
from supple.media.stores.image import open_image  # noqa: E402
from supple.media.stores.inputs import Samples  # noqa: E402
from supple.space.geometry import Geometry  # noqa: E402
from tests.media.volume.test_dicom import slices  # noqa: E402
from tests.refusals import refused  # noqa: E402

Array = npt.NDArray[Any]

RNG = np.random.default_rng(8)
FLAT = Recipe(strokes=[Stroke.grab((30, 22), to=(34, 25), radius=6)])
DEEP = Recipe(strokes=[Stroke.grab((20, 16, 5), to=(23, 17, 6), radius=4)])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Chunks and tasks of a few samples, in an empty folder."""
    monkeypatch.setattr(stores, "TASK", 1 << 12)
    monkeypatch.setattr(inputs, "_CHUNK", {2: 16, 3: 16})
    monkeypatch.setattr(inputs, "_COARSEST", 24)
    monkeypatch.chdir(tmp_path)


def noise(shape: tuple[int, ...], dtype: str) -> Array:
    return (RNG.random(shape) * 200).astype(dtype)


def nifti(name: str, stored: Array, affine: Array | None = None, scaling: tuple[float, float] | None = None) -> None:
    """Write samples in nibabel's order, x first."""
    made = nibabel.Nifti1Image(stored, np.diag([1.0, 1, 1, 1]) if affine is None else affine)
    if scaling is not None:
        made.header.set_slope_inter(*scaling)
    nibabel.save(made, name)


def of_nifti() -> tuple[str, Array]:
    values = noise((40, 32, 11), "float32")
    nifti("in.nii", values)
    return "in.nii", values.T


def of_packed_nifti() -> tuple[str, Array]:
    values = noise((40, 32, 11), "int16")
    nifti("in.nii.gz", values)
    return "in.nii.gz", values.T


def of_scaled_nifti() -> tuple[str, Array]:
    values = noise((40, 32, 11), "int16")
    nifti("in.nii", values, scaling=(0.5, -3.0))
    return "in.nii", (0.5 * values.T - 3).astype("float32")


def of_series() -> tuple[str, Array]:
    values = noise((40, 32, 11, 3), "uint8")
    nifti("in.nii", values)
    return "in.nii", values.T


def of_colours() -> tuple[str, Array]:
    values = noise((11, 32, 40, 3), "uint8")
    rgb = np.dtype([(name, np.uint8) for name in "RGB"])
    nifti("in.nii", np.ascontiguousarray(values).view(rgb)[..., 0].T.copy())
    return "in.nii", np.moveaxis(values, -1, 0)


def tiff(shape: tuple[int, ...], dtype: str = "uint16", **options: Any) -> Callable[[], tuple[str, Array]]:
    """Return what writes a TIFF, and returns it in the order of a store."""

    def made() -> tuple[str, Array]:
        values = noise(shape, dtype)
        tifffile.imwrite("in.tif", values, **options)
        last = options.get("photometric") == "rgb" and options.get("planarconfig") != "separate"
        return "in.tif", np.moveaxis(values, -1, -3) if last else values

    return made


def of_pyramid() -> tuple[str, Array]:
    values = noise((64, 80, 3), "uint8")
    with tifffile.TiffWriter("in.tif", bigtiff=True) as file:
        file.write(values, photometric="rgb", tile=(16, 32), subifds=1)
        file.write(values[::2, ::2], photometric="rgb", tile=(16, 32), subfiletype=1)
    return "in.tif", np.moveaxis(values, -1, 0)


def of_png() -> tuple[str, Array]:
    values = noise((50, 60, 3), "uint8")
    Image.fromarray(values).save("in.png")
    return "in.png", np.moveaxis(values, -1, 0)


INPUTS: dict[str, tuple[Callable[[], tuple[str, Array]], str]] = {
    "nifti": (of_nifti, "zyx"),
    "nifti-gz": (of_packed_nifti, "zyx"),
    "nifti-scaled": (of_scaled_nifti, "zyx"),
    "nifti-series": (of_series, "tzyx"),
    "nifti-rgb": (of_colours, "czyx"),
    "tiff-strips": (tiff((50, 60), rowsperstrip=7), "yx"),
    "tiff-big-endian": (tiff((50, 60), byteorder=">", tile=(16, 32)), "yx"),
    "tiff-tiles": (tiff((64, 80), "float32", tile=(16, 32), compression="zlib", predictor=True), "yx"),
    "tiff-rgb": (tiff((64, 80, 3), "uint8", photometric="rgb", tile=(16, 16), compression="lzw"), "cyx"),
    "tiff-planar": (tiff((3, 64, 80), "uint8", photometric="rgb", planarconfig="separate", tile=(16, 16)), "cyx"),
    "tiff-pyramid": (of_pyramid, "cyx"),
    "tiff-stack": (tiff((11, 32, 40), photometric="minisblack"), "zyx"),
    "tiff-stack-tiles": (tiff((11, 32, 40), photometric="minisblack", tile=(16, 16)), "zyx"),
    "imagej": (tiff((2, 9, 2, 28, 34), imagej=True, metadata={"axes": "TZCYX"}), "tczyx"),
    "ome": (tiff((2, 2, 9, 28, 34), ome=True, metadata={"axes": "CTZYX"}, tile=(16, 16)), "tczyx"),
    "png": (of_png, "cyx"),
}


def stored_order(name: str, values: Array) -> Array:
    return (
        {"imagej": values.swapaxes(1, 2), "ome": values.swapaxes(0, 1)}.get(name, values)
        if values.ndim == 5
        else values
    )


@pytest.mark.parametrize("name", INPUTS)
def test_files_are_warped_as_arrays_are(name: str) -> None:
    make, axes = INPUTS[name]
    file, values = make()
    values = stored_order(name, values)
    n = 3 if "z" in axes else 2
    made = warp_file(file, "out.zarr", DEEP if n == 3 else FLAT)
    image = open_image("out.zarr")
    assert "".join(axis.name for axis in image.axes) == axes
    assert image.shape == values.shape
    assert image.dtype == values.dtype.newbyteorder("=")
    items = values.astype(values.dtype.newbyteorder("=")).reshape(-1, *values.shape[-n:])
    sampling: dict[str, Any] = {"between": "cubic", "time_filter": True} if n == 3 else {}
    expected = np.array([made.deformation.warp(one, **sampling) for one in items]).reshape(values.shape)
    found = np.asarray(image.levels[0].array[...])
    assert np.array_equal(found, expected)
    assert (found != values).any()
    assert made.copied == 0


@pytest.mark.parametrize("order", list(itertools.permutations(range(3)))[::2])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, -1), (-1, -1, 1)])
def test_straight_volumes_stay_where_they_are(order: tuple[int, ...], signs: tuple[int, ...]) -> None:
    affine = np.eye(4)
    affine[:3, :3] = np.eye(3)[:, list(order)] * signs * [0.5, 0.75, 2]
    affine[:3, 3] = -11, 5, 40
    nifti("in.nii", noise((40, 32, 11), "uint8"), affine)
    warp_file("in.nii", "out.zarr", DEEP)
    corners = np.array(list(np.ndindex(2, 2, 2))) * [39, 31, 10]
    expected = nibabel.affines.apply_affine(affine, corners) * [-1, -1, 1]  # to LPS
    assert np.allclose(open_image("out.zarr").grid.positions(corners), expected, atol=1e-5)


def test_oblique_volumes_are_bent_in_space_and_written_along_their_axes() -> None:
    turned = np.eye(4)
    c, s = np.cos(0.3), np.sin(0.3)
    turned[:2, :2] = [[c, -s], [s, c]]
    turned[:3, 3] = -20, 10, 5
    values = noise((40, 32, 11), "float32")
    nifti("in.nii", values, turned)
    start, end = (nibabel.affines.apply_affine(turned, p) for p in ((20, 16, 5), (23, 17, 6)))
    recipe = Recipe(strokes=[Stroke.grab(tuple(start), to=tuple(end), radius=4)])
    with pytest.warns(VolumeWarning, match=r"turned by 17\.2 degrees .* along its own axes, from 0"):
        warp_file("in.nii", "out.zarr", recipe, volume=VolumeOptions(world=True), tolerance=1e-4)
    image = open_image("out.zarr")
    expected = Deformation.from_recipe(DEEP, Geometry((1.0, 1.0, 1.0)).grid((11, 32, 40)))
    found = np.asarray(image.levels[0].array[...])
    warped = expected.warp(values.T.copy(), between="cubic", time_filter=True, tolerance=1e-4)
    assert np.allclose(found, warped, atol=1e-2)
    assert image.grid.origin == (0, 0, 0)
    assert all(axis.orientation is None for axis in image.axes)


def test_units_times_and_levels() -> None:
    values = noise((2, 20, 44, 50), "uint8")
    told = {"axes": "TZYX", "spacing": 2.0, "unit": "um", "finterval": 0.25}
    tifffile.imwrite("in.tif", values, imagej=True, metadata=told, resolution=(2, 2))
    recipe = Recipe(strokes=[Stroke.grab((30, 30, 5), to=(33, 30, 5), radius=0.004)])
    made = warp_file("in.tif", "out.zarr", recipe)
    image = open_image("out.zarr")
    assert [axis.unit for axis in image.axes] == ["second", *["micrometer"] * 3]
    assert np.allclose(made.deformation.grid.spacing, (5e-4, 5e-4, 2e-3))
    # what is dense is halved, until all are alike
    assert [tuple(level.array.shape) for level in image.levels] == [(2, 20, 44, 50), (2, 20, 22, 25), (2, 20, 11, 13)]
    for level, steps in zip(image.levels, ((2, 0.5, 0.5), (2, 1, 1), (2, 2, 2)), strict=True):
        assert np.allclose(level.scale, (0.25, *steps))
        assert np.allclose(level.translation, (0, *((np.array(steps) - (2, 0.5, 0.5)) / 2)))


@pytest.mark.filterwarnings("ignore:the axes of ct are turned")
def test_a_series_of_slices() -> None:
    values = noise((11, 32, 40), "int16")
    slices(Path("ct"), values)
    made = warp_file("ct", "out.zarr", DEEP)
    assert plan_file(Job("ct", "", DEEP)).shape == (11, 32, 40)
    expected = made.deformation.warp(values, between="cubic", time_filter=True)
    assert np.array_equal(open_image("out.zarr").levels[0].array[...], expected)


def test_only_needed_tiles_are_read() -> None:
    values = noise((64, 96), "uint16")
    tifffile.imwrite("in.tif", values, tile=(16, 16), compression="zlib")
    with tifffile.TiffFile("in.tif") as file:
        places = file.pages[0].dataoffsets[-1], file.pages[0].databytecounts[-1]  # of the last tile
    with open("in.tif", "r+b") as file:
        file.seek(places[0])
        file.write(b"\xff" * places[1])
    made = warp_file("in.tif", "part.zarr", FLAT, grid=GridOptions(crop=(10, 8, 60, 36)))
    part = made.deformation.warp(values, grid=made.grid)
    assert np.array_equal(open_image("part.zarr").levels[0].array[...], part)
    with pytest.raises(SuppleError, match=r"cannot read in\.tif: samples of it cannot be decoded, at \d+:64, \d+:96 "):
        warp_file("in.tif", "whole.zarr", FLAT)
    assert not os.path.exists("whole.zarr")


def test_shards_cover_pages() -> None:
    tifffile.imwrite("in.tif", noise((40, 64, 80), "uint16"), photometric="minisblack", compression="zlib")
    warp_file("in.tif", "out.zarr", DEEP)
    array = open_image("out.zarr").levels[0].array
    assert array.shards[1:] == (64, 80)
    assert array.chunks == (16, 16, 16)


def test_samples_are_sent_as_a_name() -> None:
    tifffile.imwrite("in.tif", (values := noise((11, 32, 40), "uint8")), photometric="minisblack")
    sent = pickle.dumps(Samples("in.tif"))
    assert len(sent) < 2000
    part = pickle.loads(sent)[2:5, 3:9, 1:30]
    assert np.array_equal(part, values[2:5, 3:9, 1:30])


def test_another_content_is_another_job(monkeypatch: pytest.MonkeyPatch) -> None:
    values = noise((64, 80), "uint8")
    tifffile.imwrite("in.tif", values)
    with monkeypatch.context() as patch:
        patch.setattr(target.Target, "finish", interrupted)
        with pytest.raises(KeyboardInterrupt):
            warp_file("in.tif", "out.zarr", FLAT)
    os.utime("in.tif", ns=(0, 0))
    with pytest.raises(SuppleError, match="unfinished output of another job"):
        warp_file("in.tif", "out.zarr", FLAT)


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def cut_tiff() -> None:
    tifffile.imwrite("in.tif", noise((5, 80, 90), "uint8"), photometric="minisblack", compression="zlib")
    os.truncate("in.tif", os.path.getsize("in.tif") // 2)  # tifffile would read the pages that are left


def changed(name: str, before: bytes, after: bytes) -> None:
    held = Path(name).read_bytes()
    assert before in held
    Path(name).write_bytes(held.replace(before, after))


def empty_strip() -> None:
    tifffile.imwrite("in.tif", noise((80, 90), "uint8"), rowsperstrip=8, compression="zlib")
    with tifffile.TiffFile("in.tif", mode="r+") as file:
        tag = file.pages[0].tags["StripByteCounts"]
        tag.overwrite((0, *tag.value[1:]))


def lacking_ome() -> None:
    tifffile.imwrite("in.ome.tif", noise((2, 3, 8, 9), "uint8"), ome=True, metadata={"axes": "CZYX"})
    changed("in.ome.tif", b'SizeZ="3"', b'SizeZ="4"')


def lacking_imagej() -> None:
    tifffile.imwrite("in.tif", noise((6, 8, 9), "uint8"), imagej=True)
    changed("in.tif", b"images=6", b"images=8")


WRONG: dict[str, tuple[Callable[[], object], str, Recipe, str]] = {
    "opacity": (
        lambda: tifffile.imwrite("in.tif", noise((8, 9, 4), "uint8"), photometric="rgb", extrasamples=["unassalpha"]),
        "in.tif", FLAT, "it has opacity",
    ),

    "palette": (
        lambda: tifffile.imwrite("in.tif", noise((8, 9), "uint8"), colormap=np.zeros((3, 256), np.uint16)),
        "in.tif", FLAT, "its samples are colours of a palette",
    ),

    "axes": (
        lambda: tifffile.imwrite("in.tif", noise((2, 3, 8, 9), "uint8"), ome=True, metadata={"axes": "AZYX"}),
        "in.tif", FLAT, "its axes are 2 ",
    ),
    "cut short": (cut_tiff, "in.tif", FLAT, "cut short"),
    "no TIFF": (lambda: Path("in.tif").write_bytes(b"P6 2 2 255 "), "in.tif", FLAT, "it is no TIFF: check its name"),
    "pages of OME-TIFF": (lacking_ome, "in.ome.tif", DEEP, "some of its pages are missing"),
    "pages of ImageJ": (lacking_imagej, "in.tif", DEEP, "said to hold 8 images, and has 6 pages"),
    "empty strips": (empty_strip, "in.tif", FLAT, "some of its tiles or strips are empty"),
    "missing": (lambda: None, "none.tif", FLAT, "No such file"),

    "picture": (
        lambda: tifffile.imwrite("in.tif", noise((80, 90), "uint8")), "in.tif", DEEP, "it|in.tif is a picture, with 2"
    ),
    "clip": (lambda: Path("in.mp4").write_bytes(b"x"), "in.mp4", FLAT, "in.mp4 is a clip"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_a_store_does_not_hold_is_refused(name: str) -> None:
    make, file, recipe, message = WRONG[name]
    make()
    assert file in refused(warp_file, file, "out.zarr", recipe, match=message)
    assert not [each for each in os.listdir() if "zarr" in each]
