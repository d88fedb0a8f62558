"""Pictures from file to file, from the library."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import tifffile

import supple
from supple import Field
from supple.fields import Placed
from supple.files import pictures, warp_file
from supple.files.grids import GridOptions
from supple.files.recipes import read_recipe, write_recipe
from supple.media import image, transforms
from supple.space.checks import refuse
from supple.space.geometry import Grid
from tests.cli.commands import Run
from tests.refusals import refused

DATA = Path(supple.__file__).parent / "examples" / "data"
RECIPE = supple.Recipe(border=10, strokes=(supple.Stroke.grab((30, 20), to=(36, 24), radius=15),))


def noise(*shape: int, dtype: type = np.uint8) -> npt.NDArray[np.generic]:
    return np.random.default_rng(5).integers(0, np.iinfo(dtype).max + 1, shape, dtype=dtype)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("shape", [(50, 60), (50, 60, 2), (50, 60, 3), (50, 60, 4)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_file_is_what_warp_makes(tmp_path: Path, suffix: str, shape: tuple[int, ...], dtype: type) -> None:
    pixels = noise(*shape, dtype=dtype)
    source, target = tmp_path / f"in{suffix}", tmp_path / "out.png"
    image.write(source, pixels)
    made = warp_file(source, target, RECIPE)
    assert (made.source, made.target) == (source, target)
    alpha = shape[2:] in ((2,), (4,))
    expected = supple.Deformation.from_recipe(RECIPE, shape[:2]).warp(pixels, alpha=alpha)
    np.testing.assert_array_equal(image.read(target).pixels, expected)
    report = made.report()
    assert report == made.deformation.report(tolerance=0.01)
    assert report.within


def test_options_reach_the_sampler(tmp_path: Path) -> None:
    pixels = noise(50, 60, 3)
    image.write(tmp_path / "in.png", pixels)
    options = {"filter": "linear", "outside": "constant", "fill": (1, 2, 3), "tolerance": 0.1, "linear_light": True}
    free = supple.Recipe(border=None, strokes=RECIPE.strokes)
    warp_file(tmp_path / "in.png", tmp_path / "out.png", free, **options)  # type: ignore[arg-type]
    expected = supple.Deformation.from_recipe(free, (50, 60)).warp(pixels, **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(image.read(tmp_path / "out.png").pixels, expected)


def test_progress_names_the_steps_and_may_end_the_work(tmp_path: Path) -> None:
    image.write(tmp_path / "in.png", noise(50, 60, 3))
    steps: list[str] = []
    warp_file(tmp_path / "in.png", tmp_path / "out.png", RECIPE, progress=steps.append)
    assert steps == ["read", "warp", "write"]

    def stop(step: str) -> None:
        if step == "write":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warp_file(tmp_path / "in.png", tmp_path / "b.png", RECIPE, progress=stop)
    assert sorted(os.listdir(tmp_path)) == ["in.png", "out.png"]


def test_progress_on_no_terminal_is_silent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image.write(tmp_path / "in.png", noise(50, 60, 3))
    warp_file(tmp_path / "in.png", tmp_path / "out.png", RECIPE, progress=True)
    assert capsys.readouterr() == ("", "")


def test_recipes_on_disk(tmp_path: Path) -> None:
    write_recipe(tmp_path / "r.json", RECIPE)
    assert read_recipe(tmp_path / "r.json") == RECIPE
    refused(write_recipe, tmp_path / "r.json", RECIPE, match="force")
    for name in ("r.png", "r.MP4", "r.nii.gz"):
        refused(write_recipe, tmp_path / name, RECIPE, match=r"a recipe is JSON, .*: use .*r\.json$")
    assert os.listdir(tmp_path) == ["r.json"]
    (tmp_path / "marked.json").write_text("\ufeff" + RECIPE.to_json(), encoding="utf-8")
    assert read_recipe(tmp_path / "marked.json") == RECIPE
    refused(read_recipe, tmp_path, match="JSON")
    refused(read_recipe, "a\0b", match="name")


def test_the_photographs_are_small_and_their_licences_named() -> None:
    text = (DATA / "LICENSES.md").read_text(encoding="utf-8")
    pictures = sorted(DATA.glob("*.jpg"))
    assert len(pictures) == 3
    assert all(f"`{picture.name}`" in text for picture in pictures)
    assert sum(picture.stat().st_size for picture in pictures) < 400_000


def test_a_recipe_comes_from_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_text, args=[RECIPE.to_json()])
    writer.start()
    assert read_recipe(tmp_path / "pipe") == RECIPE
    writer.join()


@pytest.mark.parametrize("name", ["map.exr", "map.tif", "map.npy", "map.npz", "map.yml"])
def test_a_saved_map_bends_as_the_strokes_do(tmp_path: Path, name: str) -> None:
    if name.endswith(".yml"):
        pytest.importorskip("cv2")
    image.write(tmp_path / "in.png", noise(50, 60, 3))
    maps = []
    for k, grid in enumerate((None, GridOptions(crop=(7, 5, 40, 30)))):
        options = {"grid": grid, "save_field": tmp_path / name, "force": bool(k)}
        warp_file(tmp_path / "in.png", tmp_path / "out.png", RECIPE, **options)  # type: ignore[arg-type]
        form = "stmap" if name.endswith((".exr", ".tif")) else "opencv"
        (found,) = transforms.read(tmp_path / name, form, source=Grid((50, 60)))
        assert isinstance(found, transforms.Displacements)
        maps.append(found.values + np.moveaxis(np.indices(found.grid.shape), 0, -1)[..., ::-1])
    expected = supple.Deformation.from_recipe(RECIPE, (50, 60)).inverse_map()
    np.testing.assert_allclose(maps[0], expected, atol=2e-3 if name == "map.tif" else 1e-4)
    np.testing.assert_allclose(maps[1], expected[5:35, 7:47], atol=2e-3 if name == "map.tif" else 1e-4)


@pytest.mark.parametrize("how", ["straightened", "pages", "into a folder"])
def test_a_saved_map_takes_the_picture_to_its_result(tmp_path: Path, run: Run, how: str) -> None:
    """The map alone, by the sampler of fields, gives the picture that was written with it."""
    recipe, source, target = RECIPE, tmp_path / "in.tif", tmp_path / "out.tif"
    page, y, x = np.ogrid[: 2 if how == "pages" else 1, :50, :60]
    tifffile.imwrite(source, (120 + 100 * np.sin(x / 7 + y / 9 + page)).astype(np.uint8), photometric="minisblack")
    if how == "into a folder":
        (tmp_path / "out").mkdir()
        drag = ["--grab", "30,20:36,24", "--radius", "15", "--border", "10", "--save-field", str(tmp_path / "m.npy")]
        assert run("warp", str(source), str(tmp_path / "out"), *drag)[0] == 0
        target = tmp_path / "out" / "in.tif"
    else:
        if how == "straightened":
            recipe = replace(RECIPE, straighten=supple.Straighten(rotate=7, fit="crop"))
        warp_file(source, target, recipe, save_field=tmp_path / "m.npy")
    maps = [Placed(Field.read(tmp_path / "m.npy", "opencv"))]
    grid = GridOptions(reference=target) if how == "straightened" else None
    warp_file(source, tmp_path / "again.tif", supple.Recipe(), maps=maps, grid=grid, outside="edge")
    made, again = (tifffile.imread(path).astype(int) for path in (target, tmp_path / "again.tif"))
    assert made.shape == again.shape
    assert np.abs(made - again).max() <= 1


def test_a_map_that_cannot_be_written_leaves_no_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image.write(tmp_path / "in.png", noise(50, 60, 3))
    source, target = tmp_path / "in.png", tmp_path / "out.png"
    refused(warp_file, source, target, RECIPE, save_field=tmp_path / "m.nii", match=r"name an STMap \(\.exr, ")
    refused(
        warp_file, source, tmp_path / "o.tif", RECIPE, save_field=tmp_path / "o.tif", match="the field and a picture"
    )
    os.symlink("loop.npy", tmp_path / "loop.npy")
    refused(warp_file, source, target, RECIPE, save_field=tmp_path / "loop.npy", force=True, match=r"loop\.npy")
    os.unlink(tmp_path / "loop.npy")
    steep, place = supple.Recipe(strokes=(supple.Stroke.grab((2, 20), to=(30, 20), radius=30),), border=None), "m.tif"
    refused(warp_file, source, target, steep, save_field=tmp_path / place, match=rf"cannot write .*/{place}: .* a TIFF")
    monkeypatch.setattr(pictures, "write", lambda *_, **__: refuse("the disk", "one with room", None))
    refused(warp_file, source, target, RECIPE, save_field=tmp_path / "m.npy", match="one with room")
    assert os.listdir(tmp_path) == ["in.png"]
