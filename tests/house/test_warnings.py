"""Warnings name the line outside Supple that led to them."""

from __future__ import annotations

import contextlib
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.files.freezing import read_freeze
from supple.files.landmarks import move_points
from supple.media import image, volume
from supple.space.geometry import Geometry

GRAB = supple.Stroke.grab((20, 20), by=(4, 0), radius=8)


def scaled(place: Path) -> None:
    recipe = supple.Recipe(strokes=(GRAB,), size=(80, 80))
    supple.warp_file(place / "in.png", place / "out.png", recipe)


def with_gaps(place: Path) -> None:
    stroke = supple.Stroke.grab((5, 5, 5), by=(1, 0, 0), radius=3)
    supple.warp_file(place / "in.nii", place / "out.nii", supple.Recipe(strokes=(stroke,)))


def outside(place: Path) -> None:
    (place / "points.csv").write_text("x,y\n70,20\n", encoding="utf-8")
    move_points(place / "points.csv", place / "moved.csv", supple.Deformation((40, 40)).add(GRAB))


def opaque(place: Path) -> None:
    image.write(place / "f1.png", np.full((40, 40, 4), 128, np.uint8))
    supple.warp_file(place / "f%d.png", place / "out.mp4", supple.Recipe(strokes=(GRAB,)))  # encoded in a thread


@pytest.mark.parametrize("made", [scaled, with_gaps, outside, opaque, lambda place: read_freeze(place / "black.png")])
def test_a_warning_of_files_names_the_caller(tmp_path: Path, made: Callable[[Path], object]) -> None:
    image.write(tmp_path / "in.png", np.zeros((40, 40), np.uint8))
    image.write(tmp_path / "black.png", np.zeros((40, 40), np.uint8))
    samples = np.zeros((12, 12, 12), np.float32)
    samples[5, 5, 5] = np.nan
    volume.write(tmp_path / "in.nii", samples, volume.Volume(samples, Geometry()))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        made(tmp_path)
    assert {each.filename for each in found} == {__file__}


def test_what_the_standard_library_calls_in_between_is_passed_over() -> None:
    names: dict[str, Any] = {"__name__": "supple.somewhere", "warn": supple.errors.warn, "functools": functools}
    exec(
        "class A:\n    @functools.cached_property\n    def b(self):\n        warn('x', UserWarning)\n"
        "def held():\n    A().b\n    yield\n",
        names,
    )
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        with contextlib.contextmanager(names["held"])():
            pass
    assert [each.filename for each in found] == [__file__]
