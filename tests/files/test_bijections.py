"""The maps of Zarr stores as OME-Zarr scenes: both directions, in the image's own units, block by block."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

zarr = pytest.importorskip("zarr")
pytest.importorskip("dask")

from supple import Affine, Field, FoldWarning, OutsideWarning, Recipe, Stroke, SuppleError, ToleranceWarning  # noqa: E402
from supple.engine.sampling import Certificate  # noqa: E402
from supple.fields import Placed  # noqa: E402
from supple.files import Warped, stores, transforms, warp_file  # noqa: E402
from supple.files.options import GridOptions, Running  # noqa: E402
from supple.files.transforms import SavedField  # noqa: E402
from supple.media.stores.image import open_image  # noqa: E402
from supple.media.stores.target import Target  # noqa: E402
from supple.media.transforms import ngff  # noqa: E402
from tests.effort import soak  # noqa: E402
from tests.refusals import refused  # noqa: E402

pytestmark = pytest.mark.usefixtures("here")

Array = npt.NDArray[Any]

RNG = np.random.default_rng(3)
KINDS = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
SCALE = {"t": 2.0, "c": 1.0, "z": 3.0, "y": 0.5, "x": 0.8}
FIRST = {"t": 0.0, "c": 0.0, "z": -20.0, "y": 100.0, "x": 7.0}
LPS = {"z": "superior-to-inferior", "y": "posterior-to-anterior", "x": "left-to-right"}
SHAPES = {"t": 2, "c": 2, "z": 12, "y": 28, "x": 26}
MAP = "map.zarr"
FLAT = Recipe(strokes=[Stroke.grab((14, 12), to=(17, 14), radius=3)])


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """Small tasks and chunks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stores, "TASK", 1 << 12)
        patch.setattr(ngff, "_SIDES", {2: 16, 3: 8})
        yield


def image(name: str, axes: str, version: str = "0.5", unit: str | None = "micrometer", turned: bool = False) -> None:
    """Write an image of one level, with noise."""
    told = []
    for n in axes:
        space = KINDS[n] == "space"
        more = {"unit": unit} if unit and space else {}
        more |= {"orientation": {"type": "anatomical", "value": LPS[n]}} if turned and space else {}
        told.append({"name": n, "type": KINDS[n], **more})
    steps = [
        {"type": "scale", "scale": [SCALE[n] for n in axes]},
        {"type": "translation", "translation": [FIRST[n] for n in axes]},
    ]
    levels = {"axes": told, "datasets": [{"path": "0", "coordinateTransformations": steps}]}
    group = zarr.create_group(name, attributes={"ome": {"version": version, "multiscales": [levels]}})
    shape = tuple(SHAPES[n] for n in axes)
    made = group.create_array("0", shape=shape, dtype="uint8", chunks=[min(8, size) for size in shape])
    made[...] = RNG.integers(0, 250, shape)


def strokes(factor: float, **more: Any) -> Recipe:
    """Return two strokes that end within a volume, whose radii are in the units of which one is ``factor`` mm."""
    some = [
        Stroke.grab((14, 12, 4), to=(16, 13, 5), radius=2 * factor, reach=3),
        Stroke.grab((16, 14, 5), to=(15, 16, 5), radius=2 * factor, reach=3),
    ]
    return Recipe(strokes=some, border=None, **more)


DEEP = strokes(1e-3)


def fields(name: str, n: int, scale: tuple[float, ...]) -> tuple[Array, Array]:
    """Return both fields of a scene in samples, x first, as Zarr reads them."""
    root = zarr.open_group(name, mode="r")
    made = []
    for k in range(2):
        array = root[f"coordinateTransformations/{k}/s0"]
        assert array.dtype == np.float32
        assert array.shape[0] == array.chunks[0] == n
        made.append(np.moveaxis(np.asarray(array[...], np.float64), 0, -1)[..., ::-1] / scale[::-1])
    return made[0], made[1]


def placed(name: str, which: int) -> tuple[list[float], list[float], list[dict[str, Any]]]:
    """Return the scale, the translation and the axes of a field, as they are stored."""
    told = zarr.open_group(f"{name}/coordinateTransformations/{which}", mode="r").attrs["ome"]["multiscales"][0]
    (one,) = told["datasets"][0]["coordinateTransformations"]
    scale, translation = (step[step["type"]] for step in one["transformations"])
    assert (scale[0], translation[0]) == (1, 0)
    return scale[1:], translation[1:], told["coordinateSystems"][0]["axes"]


def check(made: Warped, pull: Array, push: Array, tolerance: float = 0.01) -> None:
    """Check fields in samples: T(q + u(q)) = q, to the tolerance, and u(p) = T(p) - p."""
    d = made.deformation
    indices = np.moveaxis(np.indices(d.shape, np.float64), 0, -1)[..., ::-1]
    assert push.shape == indices.shape
    exact = d.forward(indices) - indices
    assert np.abs(push - exact).max() <= 1e-6 * np.abs(exact).max()
    assert np.abs(exact).max() > 1
    where = indices
    if made.grid is not None:
        out = np.moveaxis(np.indices(made.grid.shape, np.float64), 0, -1)[..., ::-1]
        where = d.grid.indices(made.grid.positions(out))
    assert pull.shape == where.shape
    found = d.inverse(where)
    assert np.abs(pull - (found.points - where)).max() <= 1.01 * tolerance
    back = d.forward(where + pull) - where
    assert np.abs(back[found.converged]).max() <= 2 * tolerance  # T stretches a little


CASES = {
    "volume": ("zyx", "micrometer", "0.5"),
    "carried": ("tczyx", "micrometer", "0.4"),
    "turned": ("zyx", "millimeter", "0.5"),
    "no unit": ("zyx", None, "0.5"),
    "picture": ("yx", "micrometer", "0.5"),
    "pictures": ("cyx", "pixel", "0.5"),
    "newest": ("zyx", "micrometer", "0.6"),
}


@pytest.mark.parametrize("case", CASES)
def test_both_directions_are_in_the_units_of_the_image(case: str) -> None:
    axes, unit, version = CASES[case]
    space = axes.strip("tc")
    n = len(space)
    image("in.zarr", axes, version if version != "0.4" else "0.5", unit, turned=case == "turned")
    recipe = FLAT if n == 2 else strokes({"micrometer": 1e-3, "millimeter": 1}.get(unit or "", 1))
    made = warp_file("in.zarr", "out.zarr", recipe, save_field=MAP)
    scale = tuple(SCALE[name] for name in space)
    pull, push = fields("map.zarr", n, scale)
    check(made, pull, push)
    for which in range(2):
        found, translation, told = placed("map.zarr", which)
        assert found == list(scale)
        assert translation == [FIRST[name] for name in space]
        assert told[0]["type"] == "displacement"
        assert [one["name"] for one in told[1:]] == list(space)
        assert {one.get("unit") for one in told[1:]} == {unit if unit != "pixel" else None}
        assert [one.get("orientation", {}).get("value") for one in told[1:]] == [
            LPS[name] if case == "turned" else None for name in space
        ]
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr", "out.zarr"]
    assert made.field is not None
    assert made.field.forward <= 0.0104
    assert made.field.inverse == 0


def test_what_the_scene_says() -> None:
    image("in.zarr", "zyx")
    made = warp_file("in.zarr", "out.zarr", DEEP, save_field=MAP)
    assert made.field is not None
    told = json.loads(Path("map.zarr/zarr.json").read_text())["attributes"]
    scene = told["ome"]["scene"]
    assert told["ome"]["version"] == "0.6"
    assert [one["name"] for one in scene["coordinateSystems"]] == ["output", "input"]
    (one,) = scene["coordinateTransformations"]
    assert (one["type"], one["input"], one["output"]) == ("bijection", {"name": "output"}, {"name": "input"})
    assert one["name"]
    for k, way in enumerate(("forward", "inverse")):
        assert one[way] == {
            "type": "displacements",
            "path": f"coordinateTransformations/{k}",
            "interpolation": "linear",
        }
    assert told["supple"] == {
        "forward": {"tolerance": 0.01, "error": made.field.forward},
        "inverse": {"tolerance": 0.01, "error": 0.0},
        "chunks": made.field.stored,
    }


@pytest.mark.parametrize(("unit", "turned"), [("micrometer", False), ("millimeter", True)])
def test_it_is_read_as_the_map_that_was_applied(unit: str, turned: bool) -> None:
    """Also as a file of ITK, which another writer makes of the volume's geometry in millimetres."""
    image("in.zarr", "czyx", unit=unit, turned=turned)
    recipe = strokes({"micrometer": 1e-3}.get(unit, 1))
    made = warp_file("in.zarr", "out.zarr", recipe, save_field=MAP)
    field, own = Field.read("map.zarr"), open_image("in.zarr").grid
    indices = np.moveaxis(np.indices(own.shape, np.float64), 0, -1)[..., ::-1]
    assert np.allclose(field.grid.positions(indices), own.positions(indices), rtol=1e-12, atol=0)
    source = own.positions(made.deformation.inverse(indices).points)
    off = field.grid.positions(indices) + field.values - source
    assert np.abs(off / own.spacing @ np.array(own.direction)).max() < 0.0101
    saved = warp_file("in.zarr", "more.zarr", recipe, save_field="map.nrrd").field
    assert saved is not None
    assert saved.inverse is None
    theirs = Field.read("map.nrrd", "itk")
    assert np.allclose(theirs.grid.matrix, field.grid.matrix)
    assert np.abs(theirs.values - field.values).max() <= 1e-6 * np.abs(field.values).max()


def test_plain_arrays_are_in_indices() -> None:
    zarr.create_array("in.zarr", data=RNG.random((12, 28, 26)), chunks=(8, 8, 8))
    made = warp_file("in.zarr", "out.zarr", strokes(1), save_field=MAP, grid=GridOptions(crop=(5, 6, 2, 20, 22, 7)))
    check(made, *fields("map.zarr", 3, (1, 1, 1)))
    assert placed("map.zarr", 0)[1] == [2, 6, 5]
    assert placed("map.zarr", 1)[1] == [0, 0, 0]
    assert [sorted(one) for one in placed("map.zarr", 0)[2][1:]] == [["discrete", "name", "type"]] * 3
    field = Field.read("map.zarr")
    assert made.grid is not None
    assert field.grid.is_same_space(made.grid.crop((0, 0, 0), made.grid.sizes))
    assert field.grid.origin == (5, 6, 2)


@pytest.mark.parametrize(
    "grid",
    [GridOptions(crop=(8, 3, 1, 17, 22, 7)), GridOptions(resample=(1.1e-3, 0.9e-3, 2e-3))],
    ids=["crop", "finer"],
)
def test_on_another_grid(grid: GridOptions) -> None:
    image("in.zarr", "zyx")
    made = warp_file("in.zarr", "out.zarr", DEEP, save_field=MAP, grid=grid)
    scale = (3.0, 0.5, 0.8)
    check(made, *fields("map.zarr", 3, scale))
    written = open_image("out.zarr")
    assert np.allclose(placed("map.zarr", 0)[0], written.levels[0].scale)
    assert np.allclose(placed("map.zarr", 0)[1], written.levels[0].translation)
    assert np.allclose(Field.read("map.zarr").grid.matrix, written.grid.matrix)
    assert (placed("map.zarr", 1)[0], placed("map.zarr", 1)[1]) == ([*scale], [-20, 100, 7])
    assert made.field is not None
    assert made.field.stored < made.field.blocks  # also where what does not move is solved


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning")  # at the edges of the wave
def test_affine_maps_and_fields() -> None:
    image("in.zarr", "zyx")
    turn = Affine([[1, 0.05, 0, -1e-3], [-0.05, 1, 0, 1.5e-3], [0, 0, 1, 0.3e-3]])
    grid = open_image("in.zarr").grid
    wave = 1.5e-3 * np.sin(np.moveaxis(np.indices((12, 28, 26)), 0, -1) / 6)
    maps = [Placed(Field(wave, grid, beyond="edge")), Placed(turn, after=1), Placed(turn, inverse=True, after=2)]
    made = warp_file("in.zarr", "out.zarr", DEEP, save_field=MAP, maps=maps)
    check(made, *fields("map.zarr", 3, (3, 0.5, 0.8)))
    assert made.field is not None
    assert made.field.inverse == 0


@pytest.mark.parametrize("inverse", [True, False])
def test_a_field_that_folds_is_told_of_both_ways(inverse: bool) -> None:
    image("in.zarr", "zyx")
    grid = open_image("in.zarr").grid
    wave = np.zeros((12, 28, 26, 3))
    wave[..., 0] = 6e-3 * np.sin(np.arange(26) / 2)
    with pytest.warns((FoldWarning, OutsideWarning)) as seen:
        made = warp_file("in.zarr", "out.zarr", Recipe(), save_field=MAP, maps=[Placed(Field(wave, grid), inverse)])
    texts = [str(one.message) for one in seen if one.category is FoldWarning]
    assert len(texts) == 2
    assert ["the inverse is one of several points" in text for text in texts] == [inverse, not inverse]
    assert inverse == ("as it is solved for map.zarr" not in texts[1])
    told = zarr.open("map.zarr").attrs["supple"]
    assert told["forward" if inverse else "inverse"]["error"] in (None, pytest.approx(0.0, abs=0.0104))
    assert told["inverse" if inverse else "forward"]["folded"] > 0
    assert made.field is not None
    assert made.field.inverse == 0 if inverse else made.field.forward < 1e-6  # of a field that is used as it is


def test_a_missed_tolerance_is_one_warning_and_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    image("in.zarr", "yx", unit=None)
    monkeypatch.setattr(transforms, "certificate_of", lambda plan, space: Certificate(0.5, 1.0))
    with pytest.warns(ToleranceWarning, match=r"off by 0\.5 px") as seen:
        made = warp_file("in.zarr", "out.zarr", FLAT, save_field=MAP)
    assert len(seen) == 1
    assert made.field is not None
    assert zarr.open("map.zarr").attrs["supple"]["forward"] == {"tolerance": 0.01, "error": 0.5}


def chunks(name: str) -> dict[str, bytes]:
    return {
        os.path.relpath(os.path.join(root, one), name): Path(root, one).read_bytes()
        for root, _, names in os.walk(name)
        for one in names
    }


def test_chunks_that_no_stroke_reaches_are_not_stored() -> None:
    image("in.zarr", "zyx")
    made = warp_file("in.zarr", "out.zarr", DEEP, save_field=MAP)
    assert made.field is not None
    assert made.field.blocks == 2 * 2 * 4 * 4
    stored = [name for name in chunks("map.zarr") if "/c/" in name]
    assert made.field.stored == len(stored) < made.field.blocks // 2
    dense = zarr.open_group("map.zarr", mode="r")
    for k in range(2):
        array = dense[f"coordinateTransformations/{k}/s0"]
        for name in [name for name in stored if name.startswith(f"coordinateTransformations/{k}/")]:
            z, y, x = (8 * int(part) for part in name.split("/")[-3:])
            assert np.any(array[:, z : z + 8, y : y + 8, x : x + 8])
    check(made, *fields("map.zarr", 3, (3, 0.5, 0.8)))


def failing(monkeypatch: pytest.MonkeyPatch, name: str, count: int) -> None:
    """Let a method of Target fail when it has been called so many times."""
    real, calls = getattr(Target, name), []

    def method(self: Target, *given: Any, **more: Any) -> Any:
        calls.append(given)
        if len(calls) > count:
            raise SuppleError("the end of the world")
        return real(self, *given, **more)

    monkeypatch.setattr(Target, name, method)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory, small: None) -> tuple[Path, SavedField]:
    """An image, and the map of a job that nothing interrupts."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        image("in.zarr", "zyx")
        field = warp_file("in.zarr", "out.zarr", DEEP, save_field="expected.zarr").field
    assert field is not None
    return folder, field


@pytest.mark.parametrize(
    ("where", "name", "count"),
    [
        ("folder", "write", 20),
        ("folder", "note", 0),
        ("folder", "finish", 0),
        ("memory", "write", 20),
        ("memory", "finish", 0),
    ],
)
def test_a_job_that_is_interrupted_goes_on(
    where: str,
    name: str,
    count: int,
    memory: str,
    uninterrupted: tuple[Path, SavedField],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, first = uninterrupted
    for store in ("in.zarr", "expected.zarr"):
        shutil.copytree(folder / store, store)
    base = "" if where == "folder" else f"{memory}/"
    own = {"save_field": f"{base}map.zarr"}
    with monkeypatch.context() as patch:
        failing(patch, name, count)
        refused(warp_file, "in.zarr", f"{base}out.zarr", DEEP, **own, match="end of the world")
    if where == "folder":
        assert not os.path.exists("out.zarr")
        assert not os.path.exists("map.zarr")
    else:
        refused(open_image, f"{base}map.zarr", match="unfinished")
    with pytest.raises(SuppleError, match=r"another job|exists already"):
        warp_file("in.zarr", f"{base}out.zarr", strokes(1.1e-3), **own)
    again = warp_file("in.zarr", f"{base}out.zarr", DEEP, **own)
    assert again.field is not None
    assert again.field.done > 0
    assert (again.field.forward, again.field.stored) == (first.forward, first.stored)
    for path in ("coordinateTransformations/0/s0", "coordinateTransformations/1/s0"):
        expected = zarr.open_group("expected.zarr", mode="r")[path]
        assert np.array_equal(zarr.open_group(f"{base}map.zarr", mode="r")[path][...], expected[...])
    assert dict(zarr.open_group(f"{base}map.zarr", mode="r").attrs) == dict(zarr.open("expected.zarr").attrs)
    if where == "folder":
        assert sorted(os.listdir()) == ["expected.zarr", "in.zarr", "map.zarr", "out.zarr"]
        assert chunks("map.zarr") == chunks("expected.zarr")
    refused(warp_file, "in.zarr", f"{base}out.zarr", DEEP, **own, match="exists already")


def test_force_replaces_and_others_are_refused() -> None:
    image("in.zarr", "zyx")
    zarr.create_group("map.zarr")
    refused(
        warp_file, "in.zarr", "out.zarr", DEEP, save_field=MAP, match=r"map\.zarr exists already: choose another name"
    )
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr"]
    warp_file("in.zarr", "out.zarr", DEEP, save_field=MAP, force=True)
    assert Field.read("map.zarr").values.any()
    Path("plain").mkdir()
    for name, told in (
        ("out.zarr", "cannot be the field and an image"),
        ("in.zarr", "cannot be the field and an image"),
        ("out.zarr/map.zarr", "cannot be the field and an image"),
        ("map.txt", "is of no transform"),
        ("none/map.zarr", "no folder"),
    ):
        with pytest.raises(SuppleError, match=told):
            warp_file("in.zarr", "out.zarr", DEEP, save_field=name, force=True)
    shutil.rmtree("map.zarr")
    Path("map.zarr").mkdir()
    refused(warp_file, "in.zarr", "out.zarr", DEEP, save_field=MAP, force=True, match="no Zarr store")


def test_the_map_of_a_file_that_becomes_a_store() -> None:
    nibabel = pytest.importorskip("nibabel")
    affine = np.diag([-0.8, 0.5, 3.0, 1.0])
    affine[:3, 3] = [10, -20, 30]
    nibabel.save(nibabel.Nifti1Image(RNG.integers(0, 9, (26, 28, 12)).astype(np.uint8), affine), "in.nii")
    made = warp_file("in.nii", "out.zarr", strokes(1), save_field=MAP)
    check(made, *fields("map.zarr", 3, (3, 0.5, 0.8)))
    field, own = Field.read("map.zarr"), open_image("out.zarr").grid
    assert np.allclose(field.grid.matrix, own.matrix)
    index = np.array([14, 12, 4])
    there = nibabel.affines.apply_affine(affine, made.deformation.inverse(index).points) * [-1, -1, 1]
    here = nibabel.affines.apply_affine(affine, index) * [-1, -1, 1]
    assert np.abs(field.values[4, 12, 14] - (there - here)).max() < 0.02


@soak("processes that write fields, as others write stores")
def test_processes_make_the_same() -> None:
    pytest.importorskip("distributed")
    image("in.zarr", "zyx")
    turn = Affine([[1, 0.05, 0, -1e-3], [-0.05, 1, 0, 1.5e-3], [0, 0, 1, 0.3e-3]])
    made = warp_file("in.zarr", "out.zarr", DEEP, maps=[Placed(turn)], save_field=MAP, running=Running(workers=2))
    check(made, *fields("map.zarr", 3, (3, 0.5, 0.8)))
