"""Plots of planes of volumes, and of fields on them, on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import supple
from supple.media import image
from supple.space.geometry import Grid
from tests.cli.commands import Run, done

DATA = Path(supple.__file__).parent / "examples" / "data"
HEAD = str(DATA / "head.nii.gz")


def test_the_commands(run: Run, here: Path) -> None:
    stroke = ("--grab", "0,71,53:0,59,49", "--radius", "40", "--world")
    done(run("plot", HEAD, "grid.png", *stroke, "--plane", "sagittal:0"))
    assert image.read("grid.png").pixels.std() > 5
    done(run("plot", HEAD, "stretch.svg", *stroke, "--what", "stretch", "--reference", str(DATA / "brain.nii.gz")))
    status, _, err = run("plot", HEAD, "no.png", *stroke, "--what", "iterations")
    assert (status, err.splitlines()[-1]) == (
        2, f"supple: iterations is for pictures and videos, and {HEAD} is a volume: draw grid or stretch"
    )  # fmt: skip
    assert run("plot", HEAD, "no.png", *stroke, "--plane", "axial:900")[0] == 2
    status, _, err = run("plot", "in.png", "no.png", "--grab", "9,9:12,9", "--radius", "8", "--plane", "axial")
    assert (status, err) == (2, "supple: --plane is for volumes, and in.png is none: leave it out\n")
    grid = Grid((12, 20, 16))
    supple.Field(np.zeros((*grid.shape, 3), np.float32), grid).write("zero.nii.gz", "itk")
    assert run("check", "zero.nii.gz", "--picture", "check.png", "--plane", "coronal:10")[0] == 0
    status, _, err = run("check", "zero.nii.gz", "--plane", "coronal:10")
    assert (status, err) == (2, "supple: --plane is that of the picture, and there is none: give --picture\n")
    assert not Path("no.png").exists()
