"""Registrations that strokes correct: strokes on the grid of the fixed image, and one field of all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.errors import SuppleError
from supple.fields import Field, Placed
from supple.files import Job, warp_file
from supple.files.maps import write_map
from supple.media import volume as volumes
from supple.space.affine import Affine
from supple.strokes import Recipe, Stroke

SHAPE = (22, 26, 30)  # of the fixed volume
TURN = np.array([[0.98, -0.17, 0.10], [0.18, 0.98, -0.06], [-0.09, 0.07, 0.99]])


@pytest.fixture
def heads(tmp_path: Path) -> tuple[Path, Path, tuple[Placed, ...]]:
    """A moving volume, a fixed one on an oblique grid elsewhere, and what a registration of both made."""
    rng = np.random.default_rng(3)
    moving = sitk.GetImageFromArray(rng.normal(size=(28, 30, 32)).astype(np.float32))
    moving = sitk.SmoothingRecursiveGaussian(moving, 2.0) * 1000.0
    moving.SetSpacing((1.5, 1.4, 1.6))
    moving.SetOrigin((100.0, -60.0, 30.0))
    sitk.WriteImage(moving, str(tmp_path / "moving.nii.gz"))
    turned = np.linalg.qr(TURN)[0]
    fixed = sitk.GetImageFromArray(rng.normal(size=SHAPE).astype(np.float32))
    fixed.SetSpacing((1.3, 1.5, 1.4))
    fixed.SetDirection((turned * np.sign(np.diag(turned))).ravel().tolist())
    fixed.SetOrigin((-18.0, -16.0, -15.0))
    sitk.WriteImage(fixed, str(tmp_path / "fixed.nii.gz"))
    place = np.hstack([np.array([[0.99, 0.08, 0], [-0.08, 0.99, 0.05], [0, -0.05, 1.0]]), [[122.0], [-38.0], [51.0]]])
    grid = volumes.outline_of(tmp_path / "fixed.nii.gz").grid
    x = np.stack(np.meshgrid(*[np.linspace(0, 3, n) for n in SHAPE], indexing="ij"), -1)
    field = Field((0.8 * np.sin(x)).astype(np.float32), grid)
    return tmp_path / "moving.nii.gz", tmp_path / "fixed.nii.gz", (Placed(Affine(place)), Placed(field))


STROKES = (Stroke.grab((14, 13, 11), by=(2.0, -1.5, 1.0), radius=6), Stroke.grab((20, 8, 9), by=(0, 2, 0), radius=5))


def onto(fixed: Path) -> supple.GridOptions:
    return supple.GridOptions(fixed, strokes=True)


def test_strokes_are_on_the_grid_of_the_fixed_volume_and_the_field_is_that_of_all(heads: Any, tmp_path: Path) -> None:
    moving, fixed, maps = heads
    recipe = Recipe(strokes=STROKES)
    made = warp_file(
        moving, tmp_path / "out.nii.gz", recipe, maps=maps, grid=onto(fixed), filter="linear", outside="constant"
    )
    assert made.deformation.shape == SHAPE
    assert np.allclose(made.arrivals[1].arrived, (20, 10, 9), atol=1e-6)
    write_map(Job(moving, tmp_path / "field.nii.gz", recipe, maps=maps, grid=onto(fixed)), "itk")
    field = sitk.ReadImage(str(tmp_path / "field.nii.gz"), sitk.sitkVectorFloat64)
    # The chain by itself: back through the strokes, which are of the fixed grid, and forward through both maps.
    grid = volumes.outline_of(fixed).grid
    alone = supple.Deformation.from_recipe(recipe, grid)
    rng = np.random.default_rng(1)
    indices = rng.integers(0, SHAPE[::-1], (200, 3))
    places = grid.positions(alone.inverse(indices.astype(float)).points)
    led = supple.Deformation(grid, border=None).field(maps[1].map)
    places = grid.positions(led.inverse(grid.indices(places)).points) @ maps[0].map.matrix[:3, :3].T
    places += maps[0].map.matrix[:3, 3]
    led_to = sitk.GetArrayFromImage(field)
    values = led_to[tuple(indices[:, ::-1].T)]
    assert np.abs(grid.positions(indices) + values - places).max() < 0.02
    theirs = sitk.Resample(
        sitk.ReadImage(str(moving)), sitk.ReadImage(str(fixed)), sitk.DisplacementFieldTransform(field), sitk.sitkLinear
    )
    ours, bent = volumes.read(tmp_path / "out.nii.gz").samples, sitk.GetArrayFromImage(theirs)
    every = np.indices(SHAPE).reshape(3, -1)[::-1].T
    read = volumes.outline_of(moving).grid
    found = read.indices(grid.positions(every) + led_to.reshape(-1, 3))
    inside = ((found >= 0) & (found <= np.array(read.sizes) - 1)).all(1).reshape(SHAPE)
    assert inside.mean() > 0.5
    assert np.abs(ours - bent)[inside].max() < 1e-2 * np.ptp(bent)


@pytest.mark.parametrize("convention", ["fsl-relative", "mrtrix", "niftyreg"])
def test_the_field_is_written_in_the_conventions_of_others(heads: Any, tmp_path: Path, convention: str) -> None:
    moving, fixed, maps = heads
    recipe = Recipe(strokes=STROKES)
    write_map(Job(moving, tmp_path / "itk.nii.gz", recipe, maps=maps, grid=onto(fixed)), "itk")
    path = tmp_path / "field.nii.gz"
    write_map(Job(moving, path, recipe, maps=maps, grid=onto(fixed)), convention)
    source, reference = (volumes.outline_of(each).grid for each in (moving, fixed))
    read = Field.read(path, convention, source=source, reference=reference)
    wanted = Field.read(tmp_path / "itk.nii.gz", "itk")
    assert np.abs(read.values - wanted.values).max() < 1e-3


def test_the_command_applies_what_a_window_with_a_fixed_volume_saved(heads: Any, tmp_path: Path, run: Any) -> None:
    moving, fixed, maps = heads
    recipe = Recipe(strokes=STROKES, size=SHAPE[::-1])
    (tmp_path / "strokes.json").write_text(recipe.to_json())
    maps[1].map.write(tmp_path / "1Warp.nii.gz", "itk")
    numbers = ",".join(f"{x:.17g}" for x in maps[0].map.matrix[:3].ravel())
    words = ["warp", moving, tmp_path / "a.nii.gz", "--affine", numbers, "--field", tmp_path / "1Warp.nii.gz"]
    words += ["--recipe", tmp_path / "strokes.json"]
    assert run(*map(str, words), "--fixed", str(fixed))[0] == 0
    warp_file(moving, tmp_path / "b.nii.gz", recipe, maps=maps, grid=onto(fixed))
    one, other = (volumes.read(tmp_path / f"{name}.nii.gz") for name in "ab")
    assert one.grid.is_same_space(volumes.outline_of(fixed).grid)
    assert np.abs(one.samples - other.samples).max() < 0.05
    code, _, said = run(*map(str, words), "--fixed", str(fixed), "--reference", str(fixed))
    assert code == 2
    assert "--fixed and --reference name the same grid" in said


def test_a_fixed_image_is_for_volumes(tmp_path: Path) -> None:
    with pytest.raises(SuppleError, match="there is none: name one"):
        supple.GridOptions(strokes=True)
    pixels = np.zeros((8, 9), np.uint8)
    from supple.media import image

    image.write(tmp_path / "a.png", pixels)
    with pytest.raises(SuppleError, match=r"fixed is for volumes, and .*a.png is a picture"):
        warp_file(tmp_path / "a.png", tmp_path / "b.png", Recipe(), grid=supple.GridOptions("a.png", strokes=True))
