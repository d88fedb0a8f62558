"""Conventions of transforms: round trips, what tells them apart, and what is refused, in one line that says why."""

from __future__ import annotations

import gzip
import itertools
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import SuppleError, errors
from supple.media.stores.image import open_image
from supple.media.transforms import CONVENTIONS, Content, Displacements, read, write
from supple.space.geometry import Grid
from tests.media.transforms.mapping import DATA, GRIDS, field_on, mapped, points_in, rotation
from tests.refusals import refused

PLUMB = ("plain", "turned")
SOURCE, REFERENCE = GRIDS["flipped"], GRIDS["oblique"]
AFFINE = np.eye(4)
AFFINE[:3] = np.hstack([rotation(0.1, 0.2, -0.3) * (1.1, 0.9, 1.2), [[3], [-4], [5]]])
FIELDS = {
    "itk": [".nii", ".nii.gz", ".nrrd", ".mha", ".h5"],
    "fsl-relative": [".nii", ".nii.gz"],
    "fsl-absolute": [".nii.gz"],
    "afni": [".nii", ".nii.gz"],
    "mrtrix": [".nii", ".nii.gz"],
    "mrtrix-displacement": [".nii.gz"],
}
MATRICES = {
    "itk": [".h5", ".tfm", ".txt", ".mat"],
    "fsl-affine": [".mat"],
    "afni": [".aff12.1D"],
    "freesurfer": [".lta"],
}


def cases(table: dict[str, list[str]]) -> list[tuple[str, str]]:
    return [(name, suffix) for name, suffixes in table.items() for suffix in suffixes]


@pytest.mark.parametrize(("convention", "suffix"), cases(FIELDS))
@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_field_comes_back(convention: str, suffix: str, name: str, dtype: Any, tmp_path: Path) -> None:
    if convention == "afni" and name not in PLUMB:
        return
    made, file = field_on(GRIDS[name], dtype=dtype), tmp_path / f"a{suffix}"
    write(file, [made], convention, source=None if convention == "afni" else SOURCE)
    (found,) = read(file, convention, source=None if convention == "afni" else SOURCE)
    assert isinstance(found, Displacements)
    assert found.values.dtype == (np.float64 if suffix == ".h5" else dtype)
    assert found.grid.is_same_space(made.grid)
    np.testing.assert_allclose(found.values, made.values, atol=5e-5 if dtype == np.float32 else 2e-5)
    points = points_in(made.grid)
    np.testing.assert_allclose(mapped([found], points), mapped([made], points), atol=1e-4)


@pytest.mark.parametrize(("convention", "suffix"), cases(MATRICES))
def test_an_affine_map_comes_back(convention: str, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"a{suffix}"
    grids = {} if convention == "afni" else {"source": SOURCE, "reference": REFERENCE}
    write(file, [AFFINE], convention, **grids)
    (found,) = read(file, None, **grids)
    np.testing.assert_allclose(found, AFFINE, atol=1e-9)


def image(path: Path, values: Any, code: int = 0, *, placed: bool = True, dtype: Any = np.float32) -> Path:
    made = nibabel.Nifti1Image(np.asarray(values, dtype), np.diag([2.0, 2, 2, 1]) if placed else None)
    made.header["intent_code"] = code
    if not placed:
        made.header["sform_code"] = made.header["qform_code"] = 0
    nibabel.save(made, path)
    return path


NOISE = np.random.default_rng(0).normal(size=(4, 5, 6, 3))
GAPPED = np.where(np.indices(NOISE.shape)[0] == 0, np.nan, NOISE)
FIVE = NOISE[:, :, :, None]
# the name of a file, its maker, the convention that is given, and what the line says
REFUSED: list[tuple[str, Callable[[Path], object], str | None, list[str]]] = [
    ("a.nii", lambda p: image(p, NOISE), None, ["fsl-relative", "fsl-absolute", "mrtrix", "afni", "convention"]),
    ("a.nii", lambda p: image(p, NOISE, 2006), None, ["2006", "fsl-relative, fsl-absolute"]),
    ("a.nii", lambda p: image(p, FIVE), None, ["afni, spm-deformation"]),
    ("a.nii", lambda p: image(p, FIVE, 1006), None, ["1006", "LPS", "RAS", "1007"]),
    ("a.nii", lambda p: image(p, NOISE, 2007), None, ["2007", "coefficients", "fnirtfileutils"]),
    ("a.nii", lambda p: image(p, NOISE, 2009), "fsl-relative", ["2009", "fnirtfileutils"]),
    ("a.nii", lambda p: image(p, NOISE), "itk", ["4 axes", "the code 1007"]),
    ("a.nii", lambda p: image(p, FIVE, 1007), "fsl-relative", ["1007", "2006"]),
    ("a.nii", lambda p: image(p, FIVE, 1007), "mrtrix", ["1007"]),
    ("a.nii", lambda p: image(p, NOISE[..., 0] > 0, dtype=np.uint8), None, ["one value for each voxel", "mask"]),
    ("a.nii", lambda p: image(p, NOISE[..., 0]), "mrtrix", ["one value for each voxel"]),
    ("a.nii", lambda p: image(p, NOISE[:, :, :, None, :2], 1007), "itk", ["two", "picture"]),
    ("a.nii", lambda p: image(p, np.repeat(NOISE, 2, 3)[..., :4]), "fsl-absolute", ["4 values"]),
    ("a.nii", lambda p: image(p, FIVE * 9, 1007, dtype=np.int16), "itk", ["int16", "float32"]),
    ("a.nii", lambda p: image(p, FIVE, 1007, placed=False), "itk", ["sform and qform have the code 0"]),
    ("a.nii", lambda p: image(p, NOISE, placed=False), "mrtrix", ["sform and qform have the code 0"]),
    ("a.nii", lambda p: image(p, NOISE, dtype=np.complex64), "mrtrix", ["complex64"]),
    ("a.nii", lambda p: image(p, GAPPED), "mrtrix", ["30 voxels of 120", "NaN"]),
    ("a.nii", lambda p: image(p, GAPPED[:, :, :, None], 1007), "itk", ["30 voxels of 120", "NaN"]),
    ("a.nii", lambda p: image(p, NOISE), "fsl-relative", ["the input (moving) image", "as source"]),
    ("a.nii", lambda p: image(p, NOISE), "elastix", ["convention must be one of", "mrtrix-displacement"]),
    ("a.mat", lambda p: np.savetxt(p, np.eye(4)), None, ["the input (moving) image", "as source"]),
    ("a.txt", lambda p: p.write_text("1 0 0 0\n" * 4), None, ["itk, fsl-affine"]),
    ("a.mat", lambda p: p.write_text("1 0 0 0\n" * 3), "fsl-affine", ["size 12", "(4,4)"]),
    ("a.mat", lambda p: p.write_text("one\n"), "fsl-affine", ["no file of the convention fsl-affine"]),
    ("a.1D", lambda p: p.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2), None, ["size 24", "(3,4)"]),
    ("a.1D", lambda p: p.write_text("1 0 0 0 0 1 0 0 0 0 0 0\n"), None, ["singular"]),
    ("a.1D", lambda p: p.write_text("nan 0 0 0 0 1 0 0 0 0 1 0\n"), None, ["finite"]),
    ("a.1D", lambda p: p.write_bytes(b"\xff\x00"), None, ["no file of the convention afni"]),
    ("a.lta", lambda p: p.write_text("type = 14\nnxforms = 1\n1 4 4\n"), None, ["type 14", "lta_convert"]),
    ("a.lta", lambda p: p.write_text("type = 1\nnxforms = 2\n"), None, ["2 maps"]),
    ("a.m3z", lambda p: p.write_bytes(b"x"), None, ["mri_warp_convert"]),
    ("a.mgz", lambda p: nibabel.save(nibabel.MGHImage(NOISE.astype("f4"), np.eye(4)), p), None, ["is no warp"]),
    ("a.mgz", lambda p: p.write_bytes(b"x"), None, ["no .mgz"]),
    ("a.mif", lambda p: p.write_bytes(b"mrtrix image\nEND\n"), "mrtrix", ["convention mrtrix"]),
    ("a.mif", lambda p: p.write_bytes((DATA / "mrtrix_0.mif").read_bytes()), None, ["mrtrix, mrtrix-displacement"]),
    ("a.h5", lambda p: p.write_bytes(b"x" * 99), None, ["no ITK transform file"]),
    ("a.mha", lambda p: sitk.WriteImage(sitk.Image([4] * 3, sitk.sitkUInt8), str(p)), None, ["one value"]),
    ("a.nrrd", lambda p: sitk.WriteImage(sitk.Image([4] * 3, sitk.sitkVectorUInt8, 3), str(p)), None, ["uint8"]),
    ("a.mha", lambda p: sitk.WriteImage(sitk.Image([4] * 3, sitk.sitkVectorFloat32, 2), str(p)), None, ["picture"]),
    ("a.foo", lambda p: p.write_bytes(b"x"), None, ["the suffix .foo", "give convention"]),
    ("a.foo", lambda p: p.write_bytes(b"x"), "itk", ["the suffix .foo"]),
    ("a", lambda p: p.write_bytes(b"x"), None, ["without suffix"]),
    ("a.npy", lambda p: np.save(p, NOISE[0, ..., :2]), None, ["positions", "give convention='opencv'"]),
    ("a.npz", lambda p: np.savez(p, NOISE[0, ..., :2]), None, ["give convention='opencv'"]),
    ("a.png", lambda p: p.write_bytes(b"x"), None, ["give convention='stmap'"]),
    ("a.tif", lambda p: p.write_bytes(b"x"), None, ["give convention='stmap'"]),
    ("a.jpg", lambda p: p.write_bytes(b"x"), None, ["of a picture, and of no field"]),
    ("a.mp4", lambda p: p.write_bytes(b"x"), None, ["of a clip, and of no field"]),
    ("a.tif", lambda p: None, None, ["No such file"]),
    ("a.foo", lambda p: None, None, ["No such file"]),
]


@pytest.mark.parametrize(("name", "make", "convention", "words"), REFUSED)
def test_what_is_refused(name: str, make: Any, convention: str | None, words: list[str], tmp_path: Path) -> None:
    make(tmp_path / name)
    text = refused(read, tmp_path / name, convention)
    for word in words:
        assert word in text, text


def test_a_list_of_transforms_is_not_read_as_its_first(tmp_path: Path) -> None:
    one = "Transform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 4 5 {}\nFixedParameters: 0 0 0\n"
    file = tmp_path / "a.tfm"
    file.write_text("#Insight Transform File V1.0\n" + "".join(one.format(i) for i in range(3)))
    with pytest.raises(SuppleError, match="a list of 3 transforms, of which ITK reads the first"):
        read(file)


def test_places_that_programs_choose_differently(tmp_path: Path) -> None:
    made = nibabel.load(image(tmp_path / "a.nii", NOISE))
    made.set_qform(np.diag([2.0, 2, 3, 1]), code=1)
    nibabel.save(made, tmp_path / "b.nii")
    with pytest.raises(SuppleError, match="its qform and its sform disagree"):
        read(tmp_path / "b.nii", "mrtrix")


CUT = ["ants_1Warp.nii.gz", "ants_Composite.h5", "ants_0GenericAffine.mat", "mrtrix_0.mif", "mrtrix_1.nii.gz"]
CUT += ["freesurfer_0_abs_ras.mgz", "freesurfer_voxels.lta", "afni.aff12.1D", "fsl_0.mat", "fsl_0_relative.nii.gz"]


@pytest.mark.parametrize(("name", "part"), list(itertools.product(CUT, [0.02, 0.5, 0.9])))
def test_a_file_that_is_cut_short(name: str, part: float, tmp_path: Path) -> None:
    whole = (DATA / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(len(whole) * part)])
    convention = {"mrtrix_": "mrtrix", "fsl_0.m": "fsl-affine", "fsl_0_r": "fsl-relative"}.get(name[:7])
    assert name in refused(read, tmp_path / name, convention, source=SOURCE, reference=REFERENCE)


@pytest.mark.parametrize("sizes", [(0, -3, 50, 0, 20), (0, 3, 50, 0, -20), (0, 0, 0, 0, -20)])
def test_a_matlab_file_of_negative_sizes(sizes: tuple[int, ...], tmp_path: Path) -> None:
    data = struct.pack("<5i", *sizes) + b"AffineTransform_double_3_3\0" * 4
    (tmp_path / "a.mat").write_bytes(data)
    assert "a.mat" in refused(read, tmp_path / "a.mat", None, source=SOURCE, reference=REFERENCE)


def test_a_tag_of_an_mgz_that_is_too_short(tmp_path: Path) -> None:
    whole = gzip.decompress((DATA / "freesurfer_0_abs_ras.mgz").read_bytes())
    tag = struct.pack(">iq", 13, 12)  # the format of the warp
    assert whole.count(tag) == 1
    at = whole.index(tag)
    (tmp_path / "a.mgz").write_bytes(gzip.compress(whole[:at] + struct.pack(">iq", 13, 0) + whole[at + 24 :]))
    assert "a.mgz" in refused(read, tmp_path / "a.mgz", match="it is damaged")


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_file_that_is_not_there(convention: str, tmp_path: Path) -> None:
    suffix = {
        "fsl-affine": ".mat",
        "freesurfer": ".lta",
        "opencv": ".npy",
        "stmap": ".exr",
        "ngff": ".zarr",
    }.get(convention, ".nii")
    with pytest.raises(SuppleError, match=r"(?i)no such f"):
        read(tmp_path / f"a{suffix}", convention, source=GRIDS["plain"], reference=GRIDS["plain"])


def test_oblique_grids_mean_nothing_in_afni(tmp_path: Path) -> None:
    for given_grids, grid in (({}, "oblique"), ({"source": GRIDS["oblique"]}, "plain")):
        with pytest.raises(SuppleError, match=r"oblique by [\d.]+ degrees.*3dWarp -deoblique"):
            write(tmp_path / "a.nii", [field_on(GRIDS[grid])], "afni", **given_grids)
    write(tmp_path / "b.nii", [field_on(GRIDS["oblique"])], "mrtrix-displacement")
    with pytest.raises(SuppleError, match="oblique"):
        read(tmp_path / "b.nii", "afni")


FLAT = Displacements(np.zeros((4, 5, 2), np.float32), Grid((4, 5)))
SMOOTH = field_on(GRIDS["plain"])
UNWRITABLE: list[tuple[str, list[Content], str | None, str]] = [
    ("a.nii", [SMOOTH], None, "does not say in which convention"),
    ("a.nii", [SMOOTH, SMOOTH], "mrtrix", "one field for each file, found 2 fields"),
    ("a.nii", [AFFINE, SMOOTH], "itk", "use .h5, .tfm"),
    ("a.nii", [AFFINE], "fsl-relative", "found 1 affine map"),
    ("a.nii", [SMOOTH], "fsl-relative", "give its grid as source"),
    ("a.nii", [SMOOTH._replace(interpolation="bspline")], "mrtrix", "interpolation bspline"),
    ("a.nii", [SMOOTH._replace(interpolation="bspline")], "itk", "use .h5, .tfm"),
    ("a.h5", [SMOOTH._replace(interpolation="cubic")], "itk", "no transform of a cubic B-spline"),
    ("a.h5", [], "itk", "nothing to write"),
    ("a.mat", [SMOOTH], "itk", "holds one affine map"),
    ("a.lta", [SMOOTH], None, "holds one affine map"),
    ("a.mgz", [SMOOTH], None, "only .lta is written"),
    ("a.1D", [SMOOTH], None, "holds one affine map"),
    ("a.HEAD", [SMOOTH], None, "only read"),
    ("a.mif", [SMOOTH], "mrtrix", "use .nii.gz"),
    ("a.nii", [FLAT], "mrtrix", "maps of volumes, found one of 2"),
    ("a.tfm", [np.eye(3)], None, "maps of volumes, found one of 2"),
    ("a.nii", [SMOOTH._replace(values=SMOOTH.values * np.nan)], "afni", "NaN"),
    ("a.nii", [SMOOTH._replace(values=SMOOTH.values[1:])], "afni", "shape"),
    ("a.foo", [SMOOTH], None, "the suffix .foo"),
]


@pytest.mark.parametrize(("name", "contents", "convention", "word"), UNWRITABLE)
def test_what_is_not_written(
    name: str, contents: list[Content], convention: str | None, word: str, tmp_path: Path
) -> None:
    assert word in refused(write, tmp_path / name, contents, convention)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda folder: open_image(folder), r"Zarr stores need zarr, which .*'supple\[zarr\]'"),
        (lambda _: read(DATA / "scene-2d.zarr"), r"Zarr stores need zarr, .*'supple\[zarr\]'"),
        (lambda folder: write(folder / "a.zarr", [np.eye(3)]), r"supple\[zarr\]"),
        (lambda _: read(DATA / "stmap-float.exr"), r"OpenEXR pictures and maps need OpenEXR, .*'supple\[exr\]'"),
        (lambda folder: write(folder / "a.exr", [FLAT]), r"supple\[exr\]"),
    ],
)
def test_a_library_that_is_missing_is_named(
    act: Callable[[Path], object], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(SuppleError, match=said):
        act(tmp_path)
    assert not list(tmp_path.iterdir())
