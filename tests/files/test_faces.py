"""Strokes that adjust faces: where landmarks go, what stays, and where landmarks of a picture come from."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import supple
from supple import Deformation, SuppleError
from supple.files import faces
from supple.files.faces import adjusted, face_stroke, faces_of
from supple.media import image
from supple.media.faces import Face, read_faces
from tests.refusals import refused

HERE = Path(__file__).parent
PORTRAIT = Path(supple.__file__).parent / "examples" / "data" / "astronaut.jpg"
SIZE = (512, 512)
FACE = read_faces(PORTRAIT.with_suffix(".pts"), SIZE)[0]
UNIT = math.dist(FACE["left_eye"], FACE["right_eye"])


def bent(**percents: float) -> Deformation:
    return Deformation.from_recipe(supple.Recipe(strokes=(face_stroke(FACE, **percents),)), SIZE)


def moved(names: list[str], **percents: float) -> np.ndarray:
    return bent(**percents).forward(np.array([FACE[name] for name in names]))


@pytest.mark.parametrize("file", [PORTRAIT.with_suffix(".pts"), HERE / "astronaut.json"])
def test_eyes_get_larger_about_their_middle(file: Path) -> None:
    (face,) = read_faces(file, SIZE)
    d = Deformation.from_recipe(supple.Recipe(strokes=(face_stroke(face, eyes=15),)), SIZE)
    for side, end in itertools.product(("left", "right"), ("inner", "outer", "top", "bottom")):
        middle, at = (np.array(face[name]) for name in (f"{side}_eye", f"{side}_eye_{end}"))
        np.testing.assert_allclose(d.forward(at), middle + 1.15 * (at - middle), atol=1e-6)
    np.testing.assert_allclose(d.forward(face["chin"]), face["chin"], atol=0.05 * UNIT)


def test_slim_narrows_the_face_and_leaves_the_eyes_and_the_background() -> None:
    names = [f"jaw_{k}" for k in range(1, 18)]
    before, after = np.array([FACE[name] for name in names]), moved(names, slim=20)
    widths = [np.linalg.norm(points[::-1] - points, axis=1)[:8] for points in (before, after)]
    narrower = 1 - widths[1] / widths[0]
    assert narrower[4] == pytest.approx(0.1, abs=0.015)  # half from each side
    assert narrower[0] < 0.02  # at the ears
    assert (np.diff(narrower[:5]) > -1e-3).all()
    still = [name for name in FACE if "eye_" in name]
    np.testing.assert_allclose(moved(still, slim=20), [FACE[name] for name in still], atol=1e-6)
    # A line beside the face, a whole distance of the eyes away from its outline, is as straight as before.
    d, (left, right) = bent(slim=20), (before[:, 0].min(), before[:, 0].max())
    rows = np.arange(before[:, 1].min(), before[:, 1].max())
    for x in (left - UNIT, right + UNIT):
        line = np.stack([np.full_like(rows, x), rows], axis=1)
        assert np.abs(d.forward(line) - line).max() < 0.02 * UNIT
    # And farther than the reach, no bit changes.
    picture = image.read(PORTRAIT).pixels
    changed = np.argwhere((d.warp(picture) != picture).any(axis=2))
    assert changed[:, 0].max() < before[:, 1].max() + 2 * UNIT


def test_smile_nose_and_jaw() -> None:
    half = math.dist(FACE["mouth_left"], FACE["mouth_right"]) / 2
    ends = np.array([FACE["mouth_left"], FACE["mouth_right"]])
    move = moved(["mouth_left", "mouth_right"], smile=20) - ends
    np.testing.assert_allclose(move[:, 1], -0.2 * half, rtol=0.1)  # the face is a little tilted
    assert move[0, 0] > 0 > move[1, 0]
    nose = np.array([FACE["nose_left"], FACE["nose_right"]])
    narrow = moved(["nose_left", "nose_right"], nose=-10)
    assert math.dist(*narrow) / math.dist(*nose) == pytest.approx(0.9, abs=1e-3)
    jaw = np.array([FACE["jaw_left"], FACE["jaw_right"]])
    assert math.dist(*moved(["jaw_left", "jaw_right"], jaw=10)) / math.dist(*jaw) == pytest.approx(1.05, abs=0.006)


@given(st.floats(-math.pi, math.pi), st.floats(0.3, 4), st.booleans(), st.floats(-300, 300))
def test_a_face_is_adjusted_alike_however_it_lies(angle: float, scale: float, mirrored: bool, shift: float) -> None:
    turn = scale * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    if mirrored:
        turn = turn @ np.diag([-1.0, 1.0])
    there: Face = {name: tuple(turn @ at + shift) for name, at in FACE.items()}
    percents = {"slim": 20, "eyes": 15, "smile": 10, "nose": -10, "jaw": 5}
    one, other = face_stroke(FACE, **percents), face_stroke(there, **percents)
    assert other.radius == pytest.approx(scale * one.radius)
    assert len(one.handles) == len(other.handles)
    for (at, by), (to, move) in zip(one.handles, other.handles, strict=True):
        np.testing.assert_allclose(to, turn @ at + shift, atol=1e-6)
        np.testing.assert_allclose(move, turn @ by, atol=1e-6)


def test_the_name_says_what_was_asked() -> None:
    stroke = face_stroke(FACE, place=2, slim=20, nose=-12.5)
    assert stroke.name == "face 2: slim 20, nose -12.5"
    assert adjusted(stroke) == (2, {"slim": 20.0, "nose": -12.5})
    assert adjusted(supple.Stroke.grab((1, 2), by=(3, 4), radius=5)) is None


def test_few_landmarks_do_for_what_needs_them() -> None:
    few: Face = {name: FACE[name] for name in ("left_eye", "right_eye", "mouth_left", "mouth_right", "chin")}
    assert face_stroke(few, smile=10).handles
    assert face_stroke({name: at for name, at in few.items() if name != "mouth_left"}, smile=0).is_still
    refused(face_stroke, few, nose=10, match="nose needs nose_left, nose_right, of which there is no landmark: add it")
    del few["left_eye"]
    refused(face_stroke, few, smile=10, match="the size of a face needs left_eye, of which there is no landmark")
    with pytest.raises(SuppleError, match="left_eye and right_eye are at one place"):
        face_stroke({**few, "left_eye": few["right_eye"]}, smile=10)
    refused(face_stroke, FACE, slim=101, match="slim must be percent from -100 to 100, found 101")
    refused(face_stroke, FACE, ears=10, match=r"an adjustment must be .*, found 'ears'")


def test_where_landmarks_are_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faces, "can_find", lambda: False)
    picture, marks = tmp_path / "one.png", tmp_path / "marks"
    image.write(picture, np.zeros((512, 512, 3), np.uint8))
    marks.mkdir()
    with pytest.raises(
        SuppleError, match=r"one.png has no landmarks: put one.pts, .csv, .xml or .json beside it, or pip install"
    ):
        faces_of(picture)
    refused(faces_of, picture, marks, match=r"marks has no landmarks of .*one.png: add one.pts or .csv")
    text = (PORTRAIT.with_suffix(".pts")).read_text()
    (marks / "one.pts").write_text(text)
    (marks / "one_68.pts").write_text(text)
    for given_as in (marks, marks / "one.pts", marks / "*_68.pts"):
        assert faces_of(picture, given_as) == (FACE,)
    refused(faces_of, picture, marks / "*_5.pts", match=r"cannot read .*one_5.pts")
    (tmp_path / "one.pts").write_text(text)
    assert faces_of(picture) == (FACE,)


def test_faces_are_found(tmp_path: Path) -> None:
    pytest.importorskip("dlib", reason="supple[face] is not installed")
    if not faces.can_find():
        pytest.skip("supple[face] is not installed")
    (face,) = faces_of(PORTRAIT)
    for name, at in FACE.items():
        assert math.dist(face[name], at) < 0.12 * UNIT, name
    portrait = image.read(PORTRAIT).pixels
    two = np.hstack([portrait[:300], np.kron(portrait[:150, 100:356], np.ones((2, 2, 1), np.uint8))])
    image.write(tmp_path / "two.png", two)
    larger, smaller = faces_of(tmp_path / "two.png")
    assert larger["chin"][0] > 512 > smaller["chin"][0]
    image.write(tmp_path / "none.png", portrait[400:])
    refused(faces_of, tmp_path / "none.png", match=r"no face is found in .*none.png: put a file of its")


def test_what_lies_on_the_edge_of_a_picture_or_beyond_is_left_out() -> None:
    size = (240, 300)  # cuts a part of the face, and of the pins around it
    stroke = face_stroke(FACE, slim=15, size=size)
    assert 8 < len(stroke.handles) < len(face_stroke(FACE, slim=15).handles)
    Deformation(size[::-1]).add(stroke)
    refused(face_stroke, FACE, slim=15, size=(9, 9), match="the face lies on the edge of the picture or beyond it")
