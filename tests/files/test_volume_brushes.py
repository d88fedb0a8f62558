"""Twists and pinches in millimetres: about and along directions of space, whatever the axes of the volume are."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from supple import Deformation, Recipe, Stroke
from supple.files.volumes import indexed, placed
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
