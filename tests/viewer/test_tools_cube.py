"""The orientation cube: where its faces are, and what a click on one does."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from supple.render.camera import Camera
from supple.space.geometry import Geometry
from supple.viewer.tools.orbit import Stage, faces_of
from supple.viewer.tools.planes import RENDERED
from supple.viewer.tools.volumes import VolumeTools
from tests.viewer.tools import MIDDLE, RIGHT, click, down, drag, move, press, send, solid, up

TURNED = np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]) @ np.diag([1.0, -1.0, 1.0])
GEOMETRIES = (
    Geometry(convention="RAS"),
    Geometry((1.0, 1.2, 1.5), (10.0, -20.0, 5.0), TURNED, "LPS"),
)
CAMERAS = [
    Camera(*angles, roll=roll) for *angles, roll in itertools.product((-130, -40, 35, 145), (-50, -15, 20, 60), (0, 25))
]
WAYS = dict(zip("LRPASI", np.repeat(np.eye(3), 2, axis=0) * np.tile([[1.0], [-1.0]], (3, 1)), strict=True))
UP = dict(zip("LRPASI", "SSSSAA", strict=True))  # the side that is above in the standard view of each


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_faces_are_where_the_patient_has_them(geometry: Geometry) -> None:
    """The direction from the middle of the cube to that of a face is that in which the side lies in the rendering."""
    stage = Stage((60, 60, 60), geometry, (300, 400))
    centre = geometry.to_lps((29.5, 29.5, 29.5))
    for camera in CAMERAS:
        faces = faces_of(stage, camera, (50.0, 20.0))
        assert len(faces) == 3
        here = stage.project(camera, (29.5, 29.5, 29.5))
        assert here is not None
        for face in faces:
            there = stage.project(camera, tuple(geometry.from_lps(centre + 0.01 * WAYS[face.name]).tolist()))
            assert there is not None
            assert there[2] < here[2]  # nearer
            way = np.subtract(there[:2], here[:2])
            shown = np.subtract(face.middle, (50.0 + 400.0 - 46.0, 20.0 + 300.0 - 46.0))
            assert way @ shown > 0.999 * np.linalg.norm(way) * np.linalg.norm(shown)
            np.testing.assert_allclose(np.mean(face.corners, axis=0), face.middle, atol=1e-9)
            assert [each for each in faces if each.holds(*face.middle)] == [face]


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_a_click_on_a_face_looks_from_that_side_upright(geometry: Geometry) -> None:
    document = solid().document
    seen = set()
    for camera in CAMERAS:
        tools = VolumeTools(document, geometry, (400, 300), lambda x, y: None, lambda pick, to: (0, 0, 0), (0.0, 1.0))
        tools.enlarge(RENDERED)
        before = replace(camera, target=(20.0, 30.0, 10.0), distance=150.0)
        for name in [face.name for face in faces_of(tools.stage, before, tools.corner)]:
            tools.view = before
            face = next(face for face in tools.cube if face.name == name)
            click(tools, *face.middle)
            seen.add(name)
            after = tools.view
            assert (after.target, after.distance, after.roll) == (before.target, before.distance, 0.0)
            assert after.azimuth == face.azimuth
            view = tools.stage.view(after)
            axes = geometry.direction.T
            np.testing.assert_allclose(view.ahead, -axes @ WAYS[name], atol=1e-12)
            above = -view.packed[4] / np.linalg.norm(view.packed[4])
            np.testing.assert_allclose(above, axes @ WAYS[UP[name]], atol=1e-12)
            assert [(f.name, pytest.approx(1.0)) for f in tools.cube] == [(name, tools.cube[0].towards)]
    assert seen == set("LRPASI")
    assert document.strokes == ()


def test_a_volume_without_a_place_in_space_has_the_axes_of_its_voxels() -> None:
    tools = solid()
    tools.view = Camera(30, 30)
    assert {face.name for face in tools.cube} == {"+x", "-y", "+z"}


def test_a_drag_of_the_cube_turns_the_view_as_one_beside_the_object() -> None:
    tools, other = solid(), solid()
    tools.view = other.view = Camera(30, 30)
    x, y = tools.cube[0].middle
    drag(tools, (x, y), (x - 30, y + 20))
    drag(other, (10, 10), (-20, 30))
    assert tools.view == other.view != Camera(30, 30)
    before = tools.view
    down(tools, *tools.cube[0].middle)
    move(tools, x - 60, y)
    assert tools.view != before
    press(tools, "Escape")
    assert tools.view == before
    for button in (RIGHT, MIDDLE):  # which turn and pan on the cube as elsewhere
        x, y = tools.cube[0].middle
        send(tools, "pointer_down", x, y, button=button, buttons=(button,))
        up(tools, x, y, button=button)
        assert tools.view == before


def test_a_press_that_ends_beside_the_cube_turns() -> None:
    tools = solid()
    tools.view = Camera(30, 30)
    x, y = tools.cube[0].middle
    down(tools, x, y)
    move(tools, x + 200, y)
    assert tools.side is None
    up(tools, x + 200, y)
    assert tools.view != Camera(30, 30)


def test_nothing_behind_the_cube_is_picked() -> None:
    tools = solid()
    sent: list[tuple[float, float]] = []
    tools.pick = lambda x, y: sent.append((x, y))  # type: ignore[func-returns-value]
    x, y = tools.cube[0].middle
    move(tools, x, y, buttons=())
    assert tools.side == tools.cube[0]
    assert (tools.hover, tools.ring, sent) == (None, None, [])
    move(tools, x - 60, y, buttons=())
    assert tools.side is None
    assert tools.hover is None
    assert sent == [(x - 60, y)]


def test_a_small_rendering_has_no_cube() -> None:
    tools = solid(large=None)
    assert tools.cube == ()
    tools.handle({"event_type": "resize", "width": 800, "height": 600, "pixel_ratio": 1})
    assert len(tools.cube) == 1
    left, top, width, height = tools.places[RENDERED]
    x, y = tools.cube[0].middle
    assert left + width - 80 < x < left + width
    assert top + height - 80 < y < top + height
    tools.enlarge(0)  # a plane has none where the rendering's was
    click(tools, x, y)
    assert tools.view == Camera()
