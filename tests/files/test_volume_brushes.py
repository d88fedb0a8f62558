"""Twists and pinches in millimetres: about and along directions of space, whatever the axes of the volume are."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from supple import Deformation, Recipe, Stroke
from supple.cli import command
from supple.files.volumes import indexed, placed
from supple.media import volume
from supple.space.geometry import Floats, Geometry
from supple.strokes import matrix_of

TURNED = Rotation.from_euler("xyz", (20, -35, 50), degrees=True).as_matrix()
OBLIQUE = Geometry((1.5, 1.0, 2.5), (-20.0, 31.0, 7.0), TURNED, "RAS")
FLIPPED = Geometry((1.5, 1.0, 2.5), (-20.0, 31.0, 7.0), TURNED @ np.diag([1.0, -1.0, 1.0]), "RAS")
SHAPE = (24, 60, 40)
PIVOT = (20.0, 30.0, 12.0)


def world_jacobian(recipe: Recipe, geometry: Geometry, space: Any) -> Floats:
    """Return the Jacobian at the pivot of the map of positions, by central differences."""
    d = Deformation.from_recipe(indexed(recipe, geometry, "it"), geometry.grid(SHAPE))
    at, step = geometry.to_world(PIVOT, space), 1e-4
    ends = [geometry.from_world(at + sign * step * np.eye(3), space) for sign in (1, -1)]
    after, before = (geometry.to_world(d.forward(points), space) for points in ends)
    return np.asarray((after - before).T / (2 * step))


def twisted(axis: Any) -> Floats:
    about = np.array(axis or (0, 0, 1.0))
    return np.asarray(Rotation.from_rotvec(math.radians(40) * about / np.linalg.norm(about)).as_matrix())


def pinched(axis: Any) -> Floats:
    along = np.array(axis or (1.0, 0, 0)) / np.linalg.norm(axis or 1.0)
    return 1.25 * np.eye(3) + (0.64 - 1.25) * np.outer(along, along)


@pytest.mark.parametrize(
    ("brush", "axis", "wanted"),
    [
        *(("twist", axis, twisted) for axis in (None, (1.0, -2.0, 0.5), (0.0, 0.0, -1e-14))),
        *(("pinch", axis, pinched) for axis in (None, (1.0, -2.0, 0.5))),
    ],
)
@pytest.mark.parametrize("space", ["LPS", "RAS"])
@pytest.mark.parametrize("geometry", [OBLIQUE, FLIPPED])
def test_brushes_have_an_axis_of_space(geometry: Geometry, space: Any, brush: Any, axis: Any, wanted: Any) -> None:
    at = tuple(geometry.to_world(PIVOT, space).tolist())
    how: dict[str, Any] = {"twist": {"angle": 40}, "pinch": {"factor": 0.64}}[brush]
    stroke = Stroke(brush=brush, at=at, axis=axis, radius=9, **how)
    found = world_jacobian(Recipe(strokes=(stroke,), border=None, space=space), geometry, space)
    np.testing.assert_allclose(found, wanted(axis), atol=1e-6)


@pytest.mark.parametrize("geometry", [OBLIQUE, FLIPPED])
def test_strokes_go_to_millimetres_and_back(geometry: Geometry) -> None:
    strokes = (
        Stroke(brush="twist", at=PIVOT, angle=25, radius=9),
        Stroke(brush="twist", at=PIVOT, angle=25, axis=(1, 2, 3), radius=9),
        Stroke(brush="pinch", at=PIVOT, factor=0.8, radius=9),
        Stroke(brush="scale", at=PIVOT, factor=1.3, radius=9),
        Stroke.grab(PIVOT, by=(1, 2, 0), radius=9),
        Stroke(at=PIVOT, by=(1, 2, 0), also=(((25, 30, 10), (0, -2, 1)), ((9, 9, 9), (0, 0, 0))), radius=9),
        Stroke(at=PIVOT, by=(1, 2, 0), path=((22, 31, 12), (24, 30, 13)), radius=9),
    )
    recipe = Recipe(strokes=strokes, border=None, space="pixels")
    for space in ("LPS", "RAS"):
        back = indexed(placed(recipe, geometry, space), geometry, "it")  # type: ignore[arg-type]
        for before, after in zip(strokes, back.strokes, strict=True):
            assert (
                replace(after, at=before.at, by=before.by, also=before.also, path=before.path, axis=before.axis)
                == before
            )
            np.testing.assert_allclose(after.handles, before.handles, atol=1e-9)
            np.testing.assert_allclose(after.path, before.path, atol=1e-9)
            np.testing.assert_allclose(
                matrix_of(after, geometry.spacing), matrix_of(before, geometry.spacing), atol=1e-12
            )


def test_the_same_twist_of_two_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A volume, and the same with its rows in the other order, give the same picture of space."""
    monkeypatch.chdir(tmp_path)
    samples = np.random.default_rng(3).uniform(0, 200, SHAPE).astype(np.float32)
    volume.write("one.nii", samples, volume.Volume(samples, OBLIQUE))
    origin = tuple(OBLIQUE.to_lps((0, SHAPE[1] - 1, 0)).tolist())
    turned = np.ascontiguousarray(samples[:, ::-1])
    volume.write("two.nii", turned, volume.Volume(turned, replace(FLIPPED, origin=origin)))
    at = ",".join(f"{x:.6f}" for x in OBLIQUE.to_world(PIVOT, "RAS"))
    for name, options in itertools.product(("one", "two"), ([], ["--border", "none"])):
        strokes = ["--twist", f"{at}:30:1,1,0", "--pinch", f"{at}:0.8:0,1,0", "--scale", f"{at}:1.2", "--radius", "8"]
        assert command(["warp", f"{name}.nii", f"{name}-out.nii", *strokes, "--world", "--force", *options]) == 0
        if name == "two":
            one, two = (volume.read(f"{n}-out.nii").samples for n in ("one", "two"))
            assert np.abs(one - samples).max() > 20
            np.testing.assert_allclose(two[:, ::-1], one, atol=2)  # 0.01 voxels of noise
