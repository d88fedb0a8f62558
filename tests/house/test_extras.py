"""What an installation without extras does, and how it says what is missing."""

from __future__ import annotations

import json
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
    "flow": ["cv2"],
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


def without(modules: list[str], program: str, *arguments: str, here: Path) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT + program, ",".join(modules), *arguments],
        cwd=here,
        env={**os.environ, "PYTHONPATH": str(Path(supple.__file__).parent.parent)},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


# Command lines of one process: the status of each, and what it said.
COMMANDS = """
import contextlib, io, json
from supple.cli import command

for line in json.loads(sys.argv[1]):
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
        status = command(line)
    print(json.dumps((status, said.getvalue())))
"""
ALL = [module for modules in EXTRAS.values() for module in modules]


def commands(missing: list[str], lines: list[tuple[str, ...]], here: Path) -> list[tuple[int, str]]:
    status, out, err = without(missing, COMMANDS, json.dumps(lines), here=here)
    assert (status, err) == (0, "")
    return [tuple(json.loads(line)) for line in out.splitlines()]


@pytest.fixture
def here(tmp_path: Path) -> Path:
    image.write(tmp_path / "in.png", np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8))
    return tmp_path


def test_pictures_need_no_extra(here: Path) -> None:
    lines = [
        ("warp", "in.png", "out.jpg", *GRAB),
        ("info", "out.jpg"),
        ("warp", "in.png", "o.tif", *GRAB, "--json"),
    ]
    assert commands(ALL, lines, here) == [(0, "")] * 3


CLIP, HEAD = str(DATA / "bunny.mp4"), str(DATA / "head.nii.gz")
LATER = ("--grab", "320,180,9:320,180,11", "--radius", "60")
NEEDED: dict[str, dict[tuple[str, ...], str]] = {
    "video": {
        ("warp", CLIP, "out.mp4", *GRAB): "videos and image sequences need av",
        ("info", CLIP): "videos and image sequences need av",
        ("warp", "in.png", "out.bmp", *GRAB): "BMP, TGA and PNM pictures need av",
        ("render", HEAD, "out.mp4", "--turntable", "2"): "videos need av",
    },
    "flow": {
        ("track", CLIP, "t.csv", "--at", "345,58,10"): "tracked points need cv2",
        (
            "warp",
            CLIP,
            "out.mp4",
            *LATER,
            "--between",
            "flow",
        ): "follow the motion between frames need cv2",
    },
    "volume": {
        ("render", HEAD, "out.png"): "NIfTI files need nibabel",
        ("warp", HEAD, "out.nii", *GRAB): "NIfTI files need nibabel",
    },
    "plot": {
        ("plot", "in.png", "out.png", *GRAB): "plots need matplotlib",
        ("render", HEAD, "out.png", "--annotate"): "marks on pictures need matplotlib",
    },
    "gpu": {("demo", "gallery", "--device", "gpu"): "the GPU needs wgpu"},
    "view": {("view", "in.png", "--serve"): "window needs"},
}


@pytest.mark.parametrize("extra", NEEDED)
def test_what_is_missing_is_one_sentence_with_the_command_that_brings_it(here: Path, extra: str) -> None:
    told = commands(EXTRAS[extra], list(NEEDED[extra]), here)
    for (status, said), what in zip(told, NEEDED[extra].values(), strict=True):
        assert status == 2
        assert said.count("\n") == 1
        assert what in said
        assert f"pip install 'supple[{extra}]'" in said
    assert [path.name for path in here.iterdir()] == ["in.png"]


def test_without_opencv_frames_are_mixed_and_nothing_is_said(here: Path) -> None:
    program = """
import supple
from supple.files import warp_file
grab = supple.Stroke.grab((320, 180, 9), by=(0, 0, 2), radius=60)
made = warp_file(sys.argv[1], "out.mkv", supple.Recipe(strokes=[grab]))
assert made.between == "linear"
"""
    assert without(["cv2"], program, CLIP, here=here) == (0, "", "")


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
    assert without([*ALL, "pyvips", "cyclopts", "rich"], program, here=here) == (0, "", "")


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
    assert without(["dask"], program, here=here) == (1, "", told)
    assert without(["xarray", "distributed", "zarr"], program, here=here) == (0, "", "")


def test_transforms_say_which_library_they_need(here: Path) -> None:
    libraries = {
        "albumentations": "Albumentations",
        "monai": "MONAI",
        "torchio": "TorchIO",
        "torchvision": "torchvision",
    }
    program = """
import importlib
import supple.augment
for module in sys.argv[1:]:
    assert not {"torch", module} & set(sys.modules)
    try:
        importlib.import_module(f"supple.augment.{module}")
    except supple.SuppleError as error:
        print(error)
"""
    told = "".join(
        f"supple.augment.{module} needs {library}, which is not installed: pip install {module}\n"
        for module, library in libraries.items()
    )
    assert without(list(libraries), program, *libraries, here=here) == (0, told, "")
