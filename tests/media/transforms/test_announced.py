"""Files that say by themselves what they hold are read as that, or refused by name; never taken for ITK's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

from supple import Field, Grid
from supple.media.transforms import convention_in
from tests.refusals import refused

Array = npt.NDArray[Any]
TURN = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
GRID = Grid((7, 8, 9), (2.0, 1.5, 1.25), (-10.0, 20.0, 30.0), TURN)
KIND = 1007


def announcing(path: Path, *, name: str = "", kind: int = 0, note: str = "", code: int = KIND) -> Array:
    """Write a field in RAS as NiftyReg and SPM do: positions, or displacements for kind 1; return it in LPS."""
    moves = np.random.default_rng(5).normal(scale=0.3, size=(*GRID.shape, 3)).astype(np.float32)
    z, y, x = np.indices(GRID.shape)
    places = GRID.positions(np.stack([x, y, z], axis=-1))
    held = (moves if kind == 1 else places + moves) * [-1.0, -1.0, 1.0]
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ GRID.matrix
    image = nibabel.Nifti1Image(held.transpose(2, 1, 0, 3)[:, :, :, None].astype(np.float32), affine)
    image.header.set_intent(code, name=name)
    image.header["intent_p1"], image.header["descrip"] = kind, note.encode()
    nibabel.save(image, path)
    return moves


@pytest.mark.parametrize(
    ("name", "kind", "note", "convention"),
    [
        ("NREG_TRANS", 0, "", "niftyreg"),
        ("NREG_TRANS", 1, "", "niftyreg"),
        ("Mapping", 0, "Deformation field", "spm-deformation"),
        ("Mapping", 0, "", "spm-deformation"),
        ("", 0, "Deformation field", "spm-deformation"),
        ("", 0, "Forward Deformation", "spm-deformation"),
    ],
)
def test_fields_that_name_their_program(tmp_path: Path, name: str, kind: int, note: str, convention: str) -> None:
    path = tmp_path / "f.nii.gz"
    moves = announcing(path, name=name, kind=kind, note=note)
    for given in (None, convention):
        np.testing.assert_allclose(Field.read(path, given).values, moves, atol=5e-6)
    for other in ("itk", "afni", "mrtrix", "mrtrix-displacement"):
        refused(Field.read, path, other, match=f"it is a field of .*: give the convention {convention}")
    Field.read(path).write(tmp_path / "again.nii", convention)
    assert convention_in(tmp_path / "again.nii") == convention
    np.testing.assert_allclose(Field.read(tmp_path / "again.nii").values, moves, atol=1e-5)


@pytest.mark.parametrize("note", ["Deformation", "Inverse Deformation"])
def test_fields_of_spm_without_an_intent(tmp_path: Path, note: str) -> None:
    moves = announcing(tmp_path / "iy_head.nii", note=note, code=0)  # as Segment writes them
    for given in (None, "spm-deformation"):
        np.testing.assert_allclose(Field.read(tmp_path / "iy_head.nii", given).values, moves, atol=5e-6)
    for other in ("itk", "afni"):
        refused(Field.read, tmp_path / "iy_head.nii", other, match="give the convention")


def test_fields_of_spm_whose_header_other_programs_left_out(tmp_path: Path) -> None:
    for code in (0, KIND):
        moves = announcing(tmp_path / "y.nii", code=code)
        np.testing.assert_allclose(Field.read(tmp_path / "y.nii", "spm-deformation").values, moves, atol=5e-6)
    announcing(tmp_path / "y.nii", code=0)
    refused(Field.read, tmp_path / "y.nii", match="give convention=.NAME.: afni, spm-deformation")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": "NREG_TRANS", "kind": 2}, "control points or velocities of NiftyReg"),
        ({"name": "NREG_TRANS", "kind": 3}, "control points or velocities of NiftyReg"),
        ({"name": "NREG_TRANS", "kind": 4}, "control points or velocities of NiftyReg"),
        ({"name": "NREG_TRANS", "kind": 5}, "control points or velocities of NiftyReg"),
        ({"name": "NREG_TRANS", "kind": 6}, "control points or velocities of NiftyReg"),
        ({"note": "Flow Field", "code": 0}, "its header says 'Flow Field'"),
        ({"note": "Velocity"}, "its header says Velocity"),
        ({"name": "Velocity"}, "its header says Velocity"),
    ],
)
def test_what_is_no_field_by_its_header_is_refused(tmp_path: Path, given: dict[str, Any], said: str) -> None:
    announcing(tmp_path / "f.nii", **given)
    for convention in (None, "itk", "afni", "mrtrix", "niftyreg", "spm-deformation"):
        refused(Field.read, tmp_path / "f.nii", convention, match=said.replace("'", "'?"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('(Transform "BSplineTransform")\n(NumberOfParameters 3)\n', "parameters of elastix: run transformix -def all"),
        ("// a comment\n" * 300 + '(Transform "EulerTransform")\n', "parameters of elastix: run transformix -def all"),
        ("MGH_GPUIT_BSP <experimental>\nimg_origin = 0 0 0\n", "a B-spline of plastimatch: run plastimatch"),
    ],
)
def test_texts_of_other_programs_are_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "TransformParameters.0.txt").write_text(text)
    for convention in (None, "itk", "fsl-affine"):
        refused(Field.read, tmp_path / "TransformParameters.0.txt", convention, match=said)


def test_velocities_of_itk_are_refused_by_name(tmp_path: Path) -> None:
    field = sitk.DisplacementFieldTransform(sitk.GetImageFromArray(np.zeros((4, 5, 6, 3)), isVector=True))
    sitk.WriteTransform(field, str(tmp_path / "f.tfm"))
    text = (tmp_path / "f.tfm").read_text()
    for name in ("ConstantVelocityField", "TimeVaryingVelocityField", "GaussianExponentialDiffeomorphic"):
        (tmp_path / "v.tfm").write_text(text.replace("DisplacementField", name))
        refused(Field.read, tmp_path / "v.tfm", match="it holds a velocity field, which has to be integrated")
    image = nibabel.Nifti1Image(np.zeros((5, 6, 7, 4, 3), np.float32), np.eye(4))
    image.header.set_intent(KIND)
    nibabel.save(image, tmp_path / "times.nii")
    refused(Field.read, tmp_path / "times.nii", match=r"vectors at 4 times .* as a velocity field of ANTs does")
