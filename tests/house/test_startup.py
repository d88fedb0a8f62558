"""What starts is small: heavy libraries are imported by what needs them, and by nothing else."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from supple.media import image
from tests.children import SOURCE

ENGINES = (
    "cuda.bindings",
    "cuda.core",
    "scipy",
    "torch",
    "wgpu",
    "supple.gpu.raymarch",
    "supple.cuda",
)
LIBRARIES = ("matplotlib", "av", "SimpleITK", "nibabel", "rich", "supple.viewer", "supple.plot")


def imported(program: str, here: Path) -> set[str]:
    """Return the modules that a fresh process holds after a program."""
    told = "import json, sys\nprint(json.dumps(sorted(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-c", f"{program}\n{told}"],
        cwd=here,
        env={**os.environ, "PYTHONPATH": SOURCE},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return set(json.loads(result.stdout.splitlines()[-1]))


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Modules after the package is imported and its main names are looked up."""
    program = "import supple; supple.Deformation; supple.Recipe; supple.Stroke; supple.SuppleError"
    return imported(program, tmp_path_factory.mktemp("named"))


@pytest.fixture(scope="module")
def warped(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Modules after a picture is warped by the command line."""
    here = tmp_path_factory.mktemp("warped")
    image.write(here / "in.png", np.random.default_rng(0).integers(0, 256, (40, 48, 3), np.uint8))
    line = ["warp", "in.png", "out.png", "--grab", "20,16:23,18", "--radius", "12"]
    found = imported(f"from supple.cli import command; assert command({line}) == 0", here)
    assert (here / "out.png").exists()
    return found


@pytest.mark.parametrize("module", [*ENGINES, *LIBRARIES, "cyclopts", "pyvips", "supple.media", "supple.streaming"])
def test_importing_supple_imports_nothing_heavy(named: set[str], module: str) -> None:
    assert "supple.deformation" in named
    assert module not in named


@pytest.mark.parametrize("module", [*ENGINES, *LIBRARIES])
def test_warping_a_picture_imports_no_more_than_it_needs(warped: set[str], module: str) -> None:
    assert {"cyclopts", "pyvips", "supple.cli.warp"} <= warped
    assert module not in warped


COMMANDS = {f"supple.cli.{name}" for name in ("warp", "plot", "volume", "info", "view", "fields")}


def test_a_command_imports_its_own_module_alone(tmp_path: Path) -> None:
    image.write(tmp_path / "in.png", np.zeros((4, 5), np.uint8))
    program = "from supple.cli import command; assert command(['info', 'in.png', '--json']) == 0"
    commands = {name for name in imported(program, tmp_path) if name in COMMANDS}
    assert commands == {"supple.cli.info"}


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_help_says_what_every_command_does(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    from supple.cli import command

    assert command(arguments) == 0
    said = capsys.readouterr().out
    for line in (
        "warp",
        "Bend pictures, videos",
        "Plot the deformation",
        "Render a picture of a volume",
        "Move landmarks",
    ):
        assert line in said
    for line in (
        "Describe pictures",
        "Open a window",
        "Write a gallery",
        "Invert a displacement field",
        "Check a displ",
    ):
        assert line in said


def test_only_public_names_are_listed() -> None:
    import supple

    assert {name for name in dir(supple) if not name.startswith("__")} == set(supple.__all__)
