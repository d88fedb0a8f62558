"""Files that other programs wrote lead where those programs say, within a thousandth of a millimetre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from supple.media.transforms import Displacements, read, write
from supple.space.geometry import Grid
from tests.media.transforms.mapping import DATA, Floats, centres, grid_of, mapped, warped

CLOSE = 1e-3  # millimetres
GREY = 1e-3  # of images of some hundred grey values


def off(one: Floats, other: Floats) -> float:
    return float(np.abs(np.asarray(one) - other).max())


def test_ants_warp_affine_and_composite() -> None:
    known = np.load(DATA / "ants.npz")
    warp, affine = read(DATA / "ants_1Warp.nii.gz"), read(DATA / "ants_0GenericAffine.mat")
    points = known["points"]
    assert off(mapped(warp, points), known["warp"]) < CLOSE
    assert off(mapped(affine, points), known["affine"]) < CLOSE
    assert off(mapped(warp + affine, points), known["both"]) < CLOSE
    composite = read(DATA / "ants_Composite.h5")
    assert [type(content) for content in composite] == [Displacements, np.ndarray]
    assert off(mapped(composite, points), known["composite"]) < CLOSE
    assert off(points, known["both"]) > 1
    moving = Grid(known["moving"].shape, known["spacing"].tolist(), known["origin"], known["direction"])
    fixed = Grid(
        known["warped"].shape, known["fixed_spacing"].tolist(), known["fixed_origin"], known["fixed_direction"]
    )
    image, inside = warped(known["moving"], moving, warp + affine, fixed)
    assert inside.mean() > 0.5
    assert off(image[inside], known["warped"][inside]) < GREY


STORED = ("points", "mapped", "affine", "source", "reference", "moving", "warped")


@pytest.mark.parametrize("file", sorted(path.name for path in DATA.glob("fsl_*.nii.gz")))
def test_fsl_warps(file: str, tmp_path: Path) -> None:
    _, case, kind = file.removesuffix(".nii.gz").split("_")
    known = {name: np.load(DATA / "fsl.npz")[f"{name}_{case}"] for name in STORED}
    source = grid_of(known["source"], known["moving"].shape)
    reference = grid_of(known["reference"], known["warped"].shape)
    found = read(DATA / file, f"fsl-{kind}", source=source)
    assert isinstance(found[0], Displacements)
    assert found[0].grid.is_same_space(reference)
    assert off(mapped(found, known["points"]), known["mapped"]) < CLOSE
    image, inside = warped(known["moving"], source, found, reference)
    assert inside.mean() > 0.3
    assert off(image[inside], known["warped"][inside]) < GREY
    write(tmp_path / "again.nii.gz", found, f"fsl-{kind}", source=source)
    again = read(tmp_path / "again.nii.gz", f"fsl-{kind}", source=source)
    assert off(mapped(again, known["points"]), known["mapped"]) < CLOSE


@pytest.mark.parametrize("case", range(4))
def test_flirt_matrices(case: int, tmp_path: Path) -> None:
    known = {name: np.load(DATA / "fsl.npz")[f"{name}_{case}"] for name in STORED}
    source = grid_of(known["source"], known["moving"].shape)
    reference = grid_of(known["reference"], known["warped"].shape)
    found = read(DATA / f"fsl_{case}.mat", source=source, reference=reference)
    assert off(mapped(found, known["points"]), known["affine"]) < CLOSE
    write(tmp_path / "again.mat", found, "fsl-affine", source=source, reference=reference)
    again = read(tmp_path / "again.mat", source=source, reference=reference)
    assert off(mapped(again, known["points"]), known["affine"]) < CLOSE


@pytest.mark.parametrize("case", range(3))
@pytest.mark.parametrize(
    ("ending", "convention"),
    [(".nii.gz", "mrtrix"), (".mif", "mrtrix"), ("_displacement.nii.gz", "mrtrix-displacement")],
)
def test_mrtrix_warps(case: int, ending: str, convention: str) -> None:
    known = np.load(DATA / "mrtrix.npz")
    there = known[f"mapped_{case}"]
    points = centres(grid_of(known[f"reference_{case}"], there.shape[:3]))
    found = read(DATA / f"mrtrix_{case}{ending}", convention)
    assert off(mapped(found, points), there) < CLOSE
    assert off(points, there) > 1


@pytest.mark.parametrize("file", sorted(path.name for path in DATA.glob("freesurfer_?_*.mgz")))
def test_freesurfer_warps(file: str) -> None:
    case = file.split("_")[1]
    stored = np.load(DATA / "freesurfer.npz")
    known = {name: stored[f"{name}_{case}"] for name in ("mapped", "moving", "warped", "source", "reference")}
    source = grid_of(known["source"], known["moving"].shape)
    reference = grid_of(known["reference"], known["warped"].shape)
    found = read(DATA / file)
    assert off(mapped(found, centres(reference)), known["mapped"]) < CLOSE
    image, inside = warped(known["moving"], source, found, reference)
    assert inside.mean() > 0.3
    assert off(image[inside], known["warped"][inside]) < GREY


@pytest.mark.parametrize("file", ["freesurfer_voxels.lta", "freesurfer_ras.lta"])
def test_freesurfer_affine_maps_are_those_that_lta_convert_wrote_for_itk(file: str) -> None:
    box = np.array(list(np.ndindex(2, 2, 2))) * 200.0 - 100
    assert off(mapped(read(DATA / file), box), mapped(read(DATA / "freesurfer.tfm"), box)) < CLOSE


def test_afni_affine_maps_and_warps() -> None:
    box = np.array(list(np.ndindex(2, 2, 2))) * 200.0 - 100
    assert off(mapped(read(DATA / "afni.aff12.1D"), box), mapped(read(DATA / "afni.tfm"), box)) < CLOSE
    known = np.load(DATA / "afni.npz")
    assert off(mapped(read(DATA / "afni_warp.nii.gz", "afni"), known["points"]), known["mapped"]) < CLOSE


HEAD = """
type = string-attribute
name = BYTEORDER_STRING
count = 10
'LSB_FIRST~

type = integer-attribute
name = DATASET_RANK
count = 8
 3 {count} 0 0 0 0 0 0

type = integer-attribute
name = DATASET_DIMENSIONS
count = 5
 4 3 2 0 0

type = integer-attribute
name = BRICK_TYPES
count = {count}
 {types}

type = float-attribute
name = BRICK_FLOAT_FACS
count = {count}
 {factors}

type = string-attribute
name = BRICK_LABS
count = {length}
'{labels}~

type = float-attribute
name = DELTA
count = 3
 3 2 2.5

type = float-attribute
name = IJK_TO_DICOM_REAL
count = 12
 {matrix}

type = integer-attribute
name = SCENE_DATA
count = 8
 0 11 1 -999 -999 -999 -999 -999
"""


def dataset(folder: Path, values: Floats, labels: str, matrix: Floats) -> Path:
    """Write a dataset of AFNI, as README.attributes of AFNI describes it."""
    count = len(values)
    head = HEAD.format(
        count=count,
        types=" ".join(["3"] * count),
        factors=" ".join(["0"] * count),
        length=len(labels) + 1,
        labels=labels,
        matrix=" ".join(map(str, matrix[:3].ravel().tolist())),
    )
    (folder / "warp+orig.HEAD").write_text(head)
    (folder / "warp+orig.BRIK").write_bytes(values.astype("<f4").tobytes())
    return folder / "warp+orig.HEAD"


@pytest.mark.parametrize("labels", ["x_delta~y_delta~z_delta", "x_delta~y_delta~z_delta~hexvol~BulkEn~ShearEn"])
def test_datasets_of_afni(labels: str, tmp_path: Path) -> None:
    count = labels.count("~") + 1
    values = np.random.default_rng(0).normal(size=(count, 2, 3, 4)).astype(np.float32)
    matrix = np.array([[0, 0, 3.0, 5], [2.0, 0, 0, -7], [0, 2.5, 0, 11], [0, 0, 0, 1]])
    (found,) = read(dataset(tmp_path, values, labels, matrix))
    assert isinstance(found, Displacements)
    np.testing.assert_array_equal(found.values, np.moveaxis(values[:3], 0, -1))
    np.testing.assert_allclose(found.grid.matrix, matrix, atol=1e-6)
