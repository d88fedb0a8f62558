"""A saved deformation, applied by ITK-SNAP's greedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.files import warp_file
from supple.files.options import VolumeOptions
from supple.files.volumes import open_volume

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The head, turned and with voxels that are no cubes, and bent, with a field of each kind."""
    made = tmp_path_factory.mktemp("fields")
    image, turn = sitk.ReadImage(str(HEAD)), sitk.Euler3DTransform()
    turn.SetRotation(0.2, -0.3, 0.4)
    image.SetDirection(turn.GetMatrix())
    image.SetSpacing((1.7, 2.0, 2.3))
    sitk.WriteImage(image, str(made / "in.nii.gz"))
    to_world = open_volume(made / "in.nii.gz").geometry.to_world
    (start, end) = (tuple(to_world(point).tolist()) for point in ((45, 88, 62), (45, 76, 58)))
    recipe = supple.Recipe(strokes=[supple.Stroke.grab(start, to=end, radius=40)], border=30)
    for suffix in (".nii.gz", ".nrrd", ".mha"):
        more = {"volume": VolumeOptions(world=True), "save_field": made / f"field{suffix}", "force": True}
        warp_file(made / "in.nii.gz", made / "ours.nii.gz", recipe, filter="linear", **more)
    return made


def voxels(path: Path) -> npt.NDArray[np.float64]:
    return np.asarray(open_volume(path).samples, np.float64)


def check(folder: Path, theirs: npt.NDArray[np.float64]) -> None:
    """All voxels but those at the outer faces, whose boundary modes differ, are within one grey value of 255."""
    inner = (slice(2, -2),) * 3
    ours, before = voxels(folder / "ours.nii.gz")[inner], voxels(folder / "in.nii.gz")[inner]
    assert np.abs(theirs[inner] - ours).max() <= 1
    assert (np.abs(ours - before) > 10).mean() > 0.05


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_greedy_gets_the_same_volume(folder: Path, suffix: str) -> None:
    greedy = pytest.importorskip("picsl_greedy").Greedy3D()
    source, field, target = (folder / name for name in ("in.nii.gz", f"field{suffix}", "theirs.nii.gz"))
    greedy.execute(f"-d 3 -rf {source} -ri LINEAR -rm {source} {target} -r {field}")
    check(folder, voxels(target))
