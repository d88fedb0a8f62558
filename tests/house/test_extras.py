"""What an installation without extras does, and how it says what is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import supple
from supple.media import image

DATA = Path(supple.__file__).parent / "examples" / "data"
GRAB = ("--grab", "20,20:23,20", "--radius", "6")
EXTRAS = {
    "video": ["av"],
    "volume": ["SimpleITK", "nibabel", "pydicom"],
    "plot": ["matplotlib"],
    "gpu": ["wgpu"],
    "view": ["imgui_bundle", "rendercanvas", "platformdirs", "glfw"],
}
WITHOUT = """
import sys
from importlib.machinery import PathFinder

found = PathFinder.find_spec
missing = set(sys.argv.pop(1).split(","))
PathFinder.find_spec = lambda name, *more: None if name.partition(".")[0] in missing else found(name, *more)
"""


def without(modules: list[str], program: str, *arguments: str, here: Path) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT + program, ",".join(modules), *arguments],
        cwd=here,
        env={**os.environ, "PYTHONPATH": str(Path(supple.__file__).parent.parent)},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    return done.returncode, done.stderr


COMMAND = "from supple.cli import command; sys.exit(command(sys.argv[1:]))"
ALL = [module for modules in EXTRAS.values() for module in modules]


@pytest.fixture
def here(tmp_path: Path) -> Path:
    image.write(tmp_path / "in.png", np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8))
    return tmp_path


def test_pictures_need_no_extra(here: Path) -> None:
    for line in (
        ("warp", "in.png", "out.jpg", *GRAB),
        ("info", "out.jpg"),
        ("warp", "in.png", "o.tif", *GRAB, "--json"),
    ):
        assert without(ALL, COMMAND, *line, here=here) == (0, "")


@pytest.mark.parametrize(
    ("extra", "line", "what"),
    [
        ("video", ("warp", str(DATA / "bunny.mp4"), "out.mp4", *GRAB), "videos and image sequences need av"),
        ("video", ("info", str(DATA / "bunny.mp4")), "videos and image sequences need av"),
        ("video", ("warp", "in.png", "out.bmp", *GRAB), "BMP, TGA and PNM pictures need av"),
        ("video", ("render", str(DATA / "head.nii.gz"), "out.mp4", "--turntable", "2"), "videos need av"),
        ("volume", ("render", str(DATA / "head.nii.gz"), "out.png"), "NIfTI files need nibabel"),
        ("volume", ("warp", str(DATA / "head.nii.gz"), "out.nii", *GRAB), "NIfTI files need nibabel"),
        ("plot", ("plot", "in.png", "out.png", *GRAB), "plots need matplotlib"),
        ("plot", ("render", str(DATA / "head.nii.gz"), "out.png", "--annotate"), "plots need matplotlib"),
        ("gpu", ("demo", "gallery", "--device", "gpu"), "the GPU needs wgpu"),
        ("view", ("view", "in.png", "--serve"), "window needs"),
    ],
)
def test_what_is_missing_is_one_sentence_with_the_command_that_brings_it(
    here: Path, extra: str, line: tuple[str, ...], what: str
) -> None:
    status, told = without(EXTRAS[extra], COMMAND, *line, here=here)
    assert status == 2
    assert told.count("\n") == 1
    assert what in told
    assert f"pip install 'supple[{extra}]'" in told
    assert [path.name for path in here.iterdir()] == ["in.png"]


def test_arrays_alone_need_numpy_and_the_core(here: Path) -> None:
    program = """
import numpy, supple
before = set(sys.modules)
d = supple.Deformation((30, 40)).grab((10, 10), to=(14, 12), radius=6)
d.warp(numpy.zeros((30, 40, 3), "u1"))
d.inverse_map()
d.recipe.to_json()
brought = {name.partition(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)
assert brought <= {"supple", "numpy"}, brought
"""
    assert without([*ALL, "pyvips", "cyclopts", "rich"], program, here=here) == (0, "")


def test_dask_is_asked_for_by_name_alone(here: Path) -> None:
    program = """
import supple
supple.Deformation((3, 3)).grab((1, 1), by=(0.1, 0), radius=2).warp
assert "dask" not in sys.modules
try:
    import supple.dask
except supple.SuppleError as error:
    sys.exit(str(error))
"""
    told = "warps by Dask need dask, which is not installed: pip install 'supple[zarr]'\n"
    assert without(["dask"], program, here=here) == (1, told)
    assert without(["xarray", "distributed", "zarr"], program, here=here) == (0, "")


@pytest.mark.parametrize(
    ("module", "library"),
    [("albumentations", "Albumentations"), ("monai", "MONAI"), ("torchio", "TorchIO"), ("torchvision", "torchvision")],
)
def test_transforms_say_which_library_they_need(here: Path, module: str, library: str) -> None:
    program = f"""
import supple.augment
assert not {{"torch", "{module}"}} & set(sys.modules)
try:
    import supple.augment.{module}
except supple.SuppleError as error:
    sys.exit(str(error))
"""
    told = f"supple.augment.{module} needs {library}, which is not installed: pip install {module}\n"
    assert without([module], program, here=here) == (1, told)
