"""Boxes of a volume: rendered as the volume that is left would be, picked, and lit."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.files.jobs import Job
from supple.files.renders import RenderOptions, render_file
from supple.render.appearance import cropped, lamp
from supple.render.box import box_of
from supple.render.camera import Camera
from supple.render.scene import MODES, Scene
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry
from tests.children import ROOT
from tests.refusals import refused
from tests.render import scenes
from tests.render.scenes import SHAPE, SOFT, cloud
from tests.render.test_files import stored

SIZE = (48, 60)
GEOMETRY = Geometry((0.9, 1.0, 1.3))
SOLID = TransferFunction(((0.0, 1.0, 1.0, 1.0, 1.0),))
CLIP = ((6, 20), (8, None), (None, 17))
CAMERAS = (Camera(35, 20, distance=90), Camera(-150, -40, distance=90, roll=30))


CLOUD = cloud(seed=5, width=2)


@pytest.fixture
def bent() -> supple.Deformation:
    return scenes.bent(GEOMETRY.spacing)


@pytest.mark.parametrize("mode", MODES)
def test_the_box_of_the_whole_volume_changes_no_bit(bent: supple.Deformation, mode: str) -> None:
    scene = Scene(CLOUD, GEOMETRY, deformation=bent, transfer=SOFT, mode=mode)
    assert scene.clip == ((0, 27), (0, 29), (0, 23))
    for clip in (((None, None),) * 3, ((0, 27), (0, 29), (0, 23))):
        other = scene.clipped(clip)
        for camera in CAMERAS:
            one, two = scene.render(camera, SIZE), other.render(camera, SIZE)
            np.testing.assert_array_equal(one.light, two.light)
            np.testing.assert_array_equal(one.depth, two.depth)
            np.testing.assert_array_equal(one.samples, two.samples)


def test_a_clipped_scene_is_the_scene_that_is_made_so(bent: supple.Deformation) -> None:
    options: dict[str, Any] = {"deformation": bent, "transfer": SOFT, "mode": "buffered"}
    scene = Scene(CLOUD, GEOMETRY, **options)
    made = Scene(CLOUD, GEOMETRY, clip=CLIP, **options)
    cut = scene.clipped(CLIP)
    assert (cut.samples is scene.samples, cut.clip, scene.clip[0]) == (True, made.clip, (0, 27))
    whole, other = scene.render(CAMERAS[0], SIZE), made.render(CAMERAS[0], SIZE)
    for again in (cut, scene.clipped(((1, 2),) * 3).clipped(CLIP), cut.seen_through(SOFT), cut.deformed(bent)):
        np.testing.assert_array_equal(again.render(CAMERAS[0], SIZE).light, other.light)
    np.testing.assert_array_equal(cut.clipped(None).render(CAMERAS[0], SIZE).light, whole.light)
    assert (whole.light != other.light).any()


def test_what_is_picked_is_the_cut_face(bent: supple.Deformation) -> None:
    for mode in ("buffered", "exact"):
        scene = Scene(np.ones(SHAPE, np.uint8), GEOMETRY, deformation=bent, transfer=SOLID, mode=mode)
        camera, size = Camera(0, 0, distance=90), (40, 50)
        whole = scene.pick(camera, size, (25, 20))
        pick = scene.clipped(((None, None), (12.5, None), (None, None))).pick(camera, size, (25, 20))
        assert whole is not None
        assert pick is not None
        assert (whole.index[1], pick.index[1]) == (pytest.approx(0, abs=1e-9), pytest.approx(12.5))  # from the front
        assert pick.depth > whole.depth + 12
        np.testing.assert_allclose(bent.forward(pick.source), pick.index, atol=1e-6)
        beside = scene.clipped(((None, None), (None, None), (None, 8)))
        assert scene.pick(camera, size, (25, 14)) is not None  # above the middle, where nothing is left
        assert beside.pick(camera, size, (25, 14)) is None


@pytest.mark.parametrize("mode", ["buffered", "exact"])
def test_a_cut_face_is_lit_as_a_plane(bent: supple.Deformation, mode: str) -> None:
    """Its light does not depend on the gradients within, which point anywhere."""
    noise = np.random.default_rng(3).random(SHAPE).astype(np.float32) + 1
    camera = Camera(20, 15, distance=90)
    scene = Scene(
        noise, GEOMETRY, deformation=bent, transfer=SOLID, mode=mode, clip=((None, None), (9, None), (None, 15))
    )
    picture = scene.render(camera, (80, 80))
    light, view = picture.light[..., 0], scene.view(camera, (80, 80))
    found = {1: 0, 2: 0}
    for y, x in np.argwhere(picture.light[..., 3] > 0.999):  # not along edges, which are thin
        at = view.eye + picture.depth[y, x] * view.direction(x, y) / view.spacing
        on = [axis for axis, place in ((1, 9), (2, 15)) if abs(at[axis] - place) < 1e-9]
        for axis in on[:1]:
            found[axis] += 1
            assert light[y, x] == pytest.approx(0.15 + 0.8 * abs(float(lamp(view)[axis])), abs=1e-3)
    assert min(found[1], found[2]) > 200


@pytest.mark.parametrize(
    "clip",
    [
        np.array([[1.5, 4], [0, 3], [2, 8]]),
        np.array([[1.5, 4], [None, 3], [2, None]]),
        [[1.5, 4], [0, 3], [2, 8]],
        (np.array([1.5, 4]), [None, np.int16(3)], (np.float32(2), 8)),
    ],
)
def test_a_box_is_an_array_or_nested_sequences(clip: Any) -> None:
    assert box_of(clip, (9, 8, 7)) == ((1.5, 4), (0, 3), (2, 8))
    assert Scene(np.zeros((9, 8, 7)), clip=clip).clip == ((1.5, 4), (0, 3), (2, 8))


@pytest.mark.parametrize(
    ("clip", "found"),
    [
        (np.zeros((3, 3)), "a range of voxels for each axis, (from, to), x first, found [0.0, 0.0, 0.0]"),
        (np.zeros((30, 40, 50)), "a range of voxels for each axis, (from, to), x first, found [[["),
        (np.array(5.0), "a range of voxels for each axis, (from, to), x first, found 5.0"),
        (np.full((3, 2), np.nan), "numbers of voxels, found nan"),
        (np.array([["a\nb", "c"]] * 3), "numbers of voxels, found 'a\\nb'"),
        ((np.zeros((2, 2)),) * 3, "a range of voxels for each axis, (from, to), x first, found array([[0., 0.], [0."),
        (np.array([[0, 20], [0, 1], [0, 1]]), "within the voxels of the volume, 0:6, 0:7, 0:8, found 0:20 along x"),
    ],
)
def test_other_arrays_are_refused_on_one_line(clip: Any, found: str) -> None:
    assert refused(box_of, clip, (9, 8, 7)).startswith(f"clip must be {found}")


def test_the_gpu_lights_as_the_core_does() -> None:
    """What both name has the same value."""
    folder = ROOT / "src" / "supple"
    core = (folder / "_core" / "raymarch.hpp").read_text(encoding="utf-8")
    shader = (folder / "gpu" / "shaders" / "raymarch.wgsl").read_text(encoding="utf-8")
    for name in ("OPAQUE", "LAYER", "AMBIENT", "DIFFUSE", "SPECULAR"):
        one, other = (re.findall(rf"\b{name} = ([\d.]+)", text) for text in (core, shader))
        assert len(one) == len(other) == 1, name
        assert float(one[0]) == float(other[0]), name


def test_a_single_slice_is_all_there_is() -> None:
    assert box_of(None, (1, 5, 6)) == box_of(((0, 5), (None, 4), (None, None)), (1, 5, 6)) == ((0, 5), (0, 4), (0, 1))
    scene = Scene(np.ones((1, 9, 9), np.uint8), transfer=SOLID, clip=((4, None), (None, None), (None, None)))
    whole = scene.clipped(None).render(size=(32, 32)).light[..., 3]
    assert 0.3 < scene.render(size=(32, 32)).light[..., 3].sum() / whole.sum() < 0.7


def test_the_camera_frames_what_is_left() -> None:
    scene = Scene(np.ones(SHAPE, np.uint8), GEOMETRY, transfer=SOLID, clip=CLIP)
    camera = scene.framed(Camera(35, 20), SIZE)
    assert camera.target == (13, 18.5, 8.5)
    corners = np.array(np.meshgrid(*scene.clip)).reshape(3, -1).T
    view = scene.view(camera, SIZE)
    away = (corners - view.eye) * view.spacing
    x, y = (away @ axis / (axis @ axis) / (away @ view.ahead) for axis in view.packed[3:])
    assert np.abs(x).max() <= SIZE[1] / 2
    assert 0.7 * SIZE[0] / 2 < np.abs(y).max() <= SIZE[0] / 2
    assert scene.framed(Camera(distance=90, target=(3, 4, 5)), SIZE) == Camera(distance=90.0, target=(3, 4, 5))
    whole = Scene(np.ones(SHAPE, np.uint8), GEOMETRY, transfer=SOLID)
    np.testing.assert_allclose(whole.view(whole.framed(), SIZE).packed, whole.view(None, SIZE).packed, atol=1e-9)


def test_a_cropped_volume_ends_half_a_voxel_beyond_its_outermost_voxels() -> None:
    """Before it is deformed, and after that where the strokes move its faces."""
    block = np.zeros((24, 24, 24), np.uint8)
    block[2:22, 2:22, 2:22] = np.random.default_rng(3).integers(150, 250, (20, 20, 20))
    sharp = TransferFunction(((0.0, 1, 1, 1, 0.0), (99.9, 1, 1, 1, 0.0), (100.0, 1, 1, 1, 1.0)))
    made = cropped(block, ((6, 15), (None, 12), (8, None)), sharp)
    np.testing.assert_array_equal(made[8:, :13, 6:16], block[8:, :13, 6:16])
    outside = np.ones(made.shape, np.bool_)
    outside[8:, :13, 6:16] = False
    assert made[outside].max() < 100
    camera = Camera(90, 0, distance=400, field_of_view=2, target=(12.0, 8.0, 12.0))  # towards the patient's left, +x
    scene = Scene(made, transfer=sharp, step=0.25, shaded=False)
    view = scene.view(camera, (9, 9))
    faces = [view.eye[0] - scene.render(camera, (9, 9)).depth[4, 4]]
    assert faces[0] == pytest.approx(15.5, abs=0.05)
    d = supple.Deformation(made.shape, border=None).grab((15, 8, 12), by=(3, 0, 0), radius=8)
    shown = Scene(made, deformation=d, transfer=sharp, step=0.25, shaded=False, mode="exact")
    expected = d.forward(np.array([[15.5, 8.0, 12.0]]))[0, 0]
    assert view.eye[0] - shown.render(camera, (9, 9)).depth[4, 4] == pytest.approx(expected, abs=0.05)


def test_a_box_without_voxels_or_beyond_the_volume_is_refused() -> None:
    for crop, told in (
        (((4.2, 4.8), (None, None), (None, None)), "crop must hold a voxel along each axis"),
        (((4, 40), (None, None), (None, None)), "crop must be within the voxels of the volume"),
        (((9, 4), (None, None), (None, None)), "crop must be from a lower to a higher voxel"),
    ):
        with pytest.raises(supple.SuppleError, match=told):
            cropped(CLOUD, crop, SOFT)
    with pytest.raises(supple.SuppleError, match="all is visible"):
        cropped(CLOUD, ((4, 9), (None, None), (None, None)), SOLID)


def test_what_is_left_before_the_end_of_a_ray_is_seen() -> None:
    """Of a step that begins in an empty brick; where the box ends between samples."""
    volume = np.zeros((20, 20, 40), np.uint8)
    volume[:, :, 16:] = 200
    soft = TransferFunction(((0.0, 1, 1, 1, 0.0), (50.0, 1, 1, 1, 0.0), (100.0, 1, 1, 1, 0.8)))
    camera = Camera(-90, 0, distance=400, field_of_view=2, target=(20.0, 10.0, 10.0))  # along +x
    for start in np.arange(0.2, 1.2, 0.1):
        for end in (16.39, 16.41, 16.6):
            clip = ((float(start), end), (None, None), (None, None))
            scene = Scene(volume, transfer=soft, clip=clip, shaded=False)
            whole = scene.render(camera, (9, 9)).light[4, 4, 3]
            fine = (
                Scene(volume, transfer=soft, clip=clip, shaded=False, step=0.05).render(camera, (9, 9)).light[4, 4, 3]
            )
            assert whole == pytest.approx(fine, abs=0.03)


def test_a_cropped_volume_is_seen_through_what_the_whole_is(here: Path) -> None:
    """Fractions of the range are those of the whole volume's; one slice is a box, and a single one has one."""
    volume = np.full((20, 20, 20), 5, np.int16)
    volume[5:15, 5:15, 5:15], volume[2, 2, 2] = 95, 1000  # the threshold is at 104
    stored("in.nii", volume)

    def made(name: str, crop: Any) -> Scene:
        return render_file(Job(name, "out.png", force=True), options=RenderOptions("mr-head", size=(40, 40), crop=crop))

    with pytest.raises(supple.SuppleError, match="density and crop leave all of them out"):
        made("in.nii", ((4, 15),) * 3)
    assert made("in.nii", ((2, 2),) * 3).range[1] == 1000
    stored("one.nii", (5 + 100 * np.eye(20, dtype=np.int16))[None])
    assert not made("one.nii", ((4, 15), (4, 15), (None, None))).is_empty
