"""Landmarks of faces from files: real ones of dlib and MediaPipe, and all kinds of the same points."""

from __future__ import annotations

import json
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import pyvips

import supple
from supple.media import image
from supple.media.faces import Face, named, read_faces
from tests.refusals import refused

MESH = Path(__file__).parent.parent / "files" / "astronaut.json"
MARKS = Path(supple.__file__).parent / "examples" / "data" / "astronaut.pts"
SIZE = (512, 512)  # of the astronaut
POINTS = np.random.default_rng(7).uniform(20, 80, (68, 2)).round(3)


def pts(points: np.ndarray) -> str:
    rows = "\n".join(f"{x:.6f} {y:.6f}" for x, y in points + 1)
    return f"version: 1\nn_points: {len(points)}\n{{\n{rows}\n}}\n"


def xml(*faces: np.ndarray, file: str = "a.png", size: str = "") -> str:
    def parts(points: np.ndarray) -> str:  # imglab sorts by name, as text
        order = sorted(range(len(points)), key=str)
        return "".join(f'<part name="{k:02}" x="{points[k, 0]}" y="{points[k, 1]}"/>' for k in order)

    boxes = "".join(f"<box top='1' left='1' width='9' height='9'>{parts(points)}</box>" for points in faces)
    return f"<dataset><images><image file={quoteattr(file)}{size}>{boxes}</image></images></dataset>"


def mediapipe(points: np.ndarray, size: tuple[int, int], key: str = "face_landmarks") -> str:
    parts = (points + 0.5) / size
    return json.dumps({key: [[{"x": x, "y": y, "z": 0.0} for x, y in parts.tolist()]]})


def close(face: Face, expected: Face) -> None:
    assert {*face} >= {*expected}
    for name, at in expected.items():
        assert face[name] == pytest.approx(at, abs=1e-5), name


def test_all_kinds_of_files_hold_the_same_points(tmp_path: Path) -> None:
    expected = named(POINTS)
    assert expected["chin"] == pytest.approx(POINTS[8])
    assert expected["left_eye"] == pytest.approx(POINTS[42:48].mean(axis=0))
    rows = "\n".join(f"{x},{y}" for x, y in POINTS)
    files = {
        "a.pts": pts(POINTS), "a.xml": xml(POINTS), "a.json": mediapipe(POINTS, (100, 90)), "a.csv": f"x,y\n{rows}\n",
        "b.json": mediapipe(POINTS, (100, 90), "faceLandmarks"),
        "c.json": mediapipe(POINTS, (100, 90), "multi_face_landmarks"),
    }  # fmt: skip
    files["c.json"] = files["c.json"].replace("[[", '[{"landmark": [').replace("]]", "]}]")
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        (face,) = read_faces(tmp_path / name, (100, 90), picture="dir/a.png")
        close(face, expected)


def test_dlib_and_mediapipe_agree_on_a_portrait() -> None:
    (one,) = read_faces(MARKS, SIZE)
    (other,) = read_faces(MESH, SIZE)
    unit = np.subtract(one["left_eye"], one["right_eye"]) @ (1, 0)
    assert unit > 0  # her left eye is on the right
    assert "forehead" in other
    assert "point_477" in other
    for name in one:
        if not name.startswith("point_"):
            far = np.hypot(*np.subtract(one[name], other[name])) / unit
            assert far < (0.35 if name.startswith(("jaw", "ear", "chin")) else 0.16), name


def test_names_of_tables(tmp_path: Path) -> None:
    for text in ("name,x,y\nLeft eye,30,40\nnose-tip,25,50\n", "Left eye,30,40\nnose-tip,25,50\n"):
        (tmp_path / "a.csv").write_text(text)
        (face,) = read_faces(tmp_path / "a.csv", SIZE)
        assert face["left_eye"] == (30, 40)
        assert face["nose_tip"] == (25, 50)


def test_the_largest_face_is_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(xml(POINTS / 2, POINTS, POINTS / 4))
    faces = read_faces(tmp_path / "a.xml", SIZE, picture="a.png")
    assert [face["chin"] for face in faces] == [pytest.approx(POINTS[8] / k) for k in (1, 2, 4)]
    many = xml(POINTS, file="b.png").replace("<images>", f"<images>{xml(POINTS / 2, file='x/a.jpg')[17:-19]}")
    (tmp_path / "a.xml").write_text(many)
    (face,) = read_faces(tmp_path / "a.xml", SIZE, picture="a.jpg")
    assert face["chin"] == pytest.approx(POINTS[8] / 2)


@pytest.mark.parametrize("turn", range(1, 9))
def test_landmarks_on_stored_pixels_are_turned_with_the_picture(tmp_path: Path, turn: int) -> None:
    stored = np.zeros((40, 60, 3), np.uint8)
    stored[9, 21] = 255
    whole = pyvips.Image.new_from_array(stored).copy(interpretation="srgb").copy()
    whole.set_type(pyvips.GValue.gint_type, "orientation", turn)
    whole.write_to_file(str(tmp_path / "a.tif"))
    pixels = image.read(tmp_path / "a.tif").pixels
    (y, x) = np.unravel_index(pixels[..., 0].argmax(), pixels.shape[:2])
    size = pixels.shape[1], pixels.shape[0]
    points = np.array([[21.0, 9.0]] if turn >= 5 else [[float(x), float(y)]])
    (tmp_path / "a.xml").write_text(xml(points, file="a.tif", size=' width="60" height="40"'))
    (face,) = read_faces(tmp_path / "a.xml", size, picture="a.tif", turn=turn)
    assert face["point_0"] == (x, y)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.pts", "version: 1\nn_points: 3\n{\n1 2\n3 4\n}", "no list of n_points points"),
        ("a.pts", "n_points: 1\n{\n1 x\n}", "no list of n_points points"),
        ("a.xml", "<dataset>", "it is no dataset of dlib"),
        ("a.xml", xml(POINTS, file="b.png"), "has no image a: add it"),
        ("a.xml", xml(), "has no face"),
        ("a.json", "{", "no result of MediaPipe"),
        ("a.json", '{"supple": 3, "strokes": []}', "no result of MediaPipe"),
        ("a.json", '{"face_landmarks": [[{"x": 0.1, "y": null}]]}', "no result of MediaPipe"),
        ("a.json", '{"face_landmarks": [[{"x": 0.1, "y": NaN}]]}', "has point_0 at (9.5, nan), outside"),
        ("a.json", '{"face_landmarks": []}', "has no face"),
        ("a.csv", "x,y\n3,4\n5,6\n", "has 2 points without names"),
        ("a.csv", "name,x,y\nchin,4,5\nChin,5,6\n", "a landmark without a name, or two of one"),
        ("a.csv", "name,x,y\nchin,400,5\n", "has chin at (400, 5), outside of the picture of 100 x 90 pixels"),
        ("a.pts", pts(POINTS + 90), "outside of the picture"),
        ("a.md", "chin", "is of no landmarks"),
    ],
)
def test_refusals(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    told = refused(read_faces, tmp_path / name, (100, 90), picture="a.png")
    assert says in told
    assert name in told
