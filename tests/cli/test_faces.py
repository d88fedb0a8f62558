"""Strokes at landmarks and in percent, recipes of them, and supple face: on one picture, and on many."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

import supple
from supple.files import faces
from supple.files.faces import face_stroke, faces_of
from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import GRAB, Run, noise, one_line

PORTRAIT = Path(supple.__file__).parent / "examples" / "data" / "astronaut.jpg"
MARKS = {"left_eye": (30.0, 14.0), "right_eye": (18.0, 14.0), "nose_tip": (24.0, 20.0), "mouth_left": (28.0, 27.0)}
MARKS |= {"mouth_right": (20.0, 27.0), "chin": (24.0, 34.0), "nose_bridge": (24.0, 14.0)}


@pytest.fixture(autouse=True)
def _none_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faces, "can_find", lambda: False)


def write_marks(path: str, scale: float = 1.0) -> None:
    rows = [f"{name},{(x + 0.5) * scale - 0.5},{(y + 0.5) * scale - 0.5}" for name, (x, y) in MARKS.items()]
    Path(path).write_text("\n".join(["name,x,y", *rows, ""]))


@pytest.fixture
def portraits(here: Path) -> Path:
    """Three pictures of different sizes, of which the third has no landmarks."""
    os.makedirs("in")
    os.makedirs("marks")
    for name, scale in {"a": 1, "b": 2, "c": 1}.items():
        image.write(f"in/{name}.png", np.kron(noise(40, 48), np.ones((scale, scale, 1), np.uint8)))
        if name != "c":
            write_marks(f"marks/{name}.csv", scale)
    return here


def warped(name: str, *strokes: supple.Stroke) -> np.ndarray:
    pixels = image.read(name).pixels
    return supple.Deformation.from_recipe(supple.Recipe(strokes=strokes), pixels.shape[:2]).warp(pixels)


def same(name: str, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(image.read(name).pixels, expected)


def test_radii_in_percent_are_of_the_shorter_side(run: Run) -> None:
    assert run("warp", "in.png", "a.png", "--grab", "20,16:23,18", "--radius", "30%")[0] == 0
    same("a.png", warped("in.png", supple.Stroke.grab((20, 16), to=(23, 18), radius=12)))
    assert run("plot", "in.png", "p.png", "--grab", "20,16:23,18", "--radius", "30%", "--json")[0] == 0
    # Of a frame of a clip, and of the sides of a volume in millimetres; in the window, the plot and the renderer, too.
    for k in range(4):
        image.write(f"f{k}.png", noise(40, 48))
    assert run("warp", "f%d.png", "g%d.png", "--grab", "20,16:23,18", "--radius", "30%")[0] == 0
    same("g3.png", image.read("a.png").pixels)
    samples = np.random.default_rng(3).uniform(0, 9, (20, 24, 28)).astype(np.float32)
    volume.write("v.nii.gz", samples, volume.Volume(samples, Geometry((1.5, 1.0, 2.0))))
    for name, radius in {"p": "30%", "n": "7.2"}.items():  # of 42, 24 and 40 mm
        assert run("warp", "v.nii.gz", f"{name}.nii.gz", "--grab", "14,12,10:16,12,10", "--radius", radius)[0] == 0
    np.testing.assert_array_equal(*(volume.read(f"{name}.nii.gz").samples for name in "pn"))


def test_a_batch_by_landmarks_of_one_file_each(run: Run, portraits: Path) -> None:
    status, _, err = run(
        "warp", "in", "out", "--landmarks", "marks", "--scale", "nose_tip:0.8", "--grab",
        "mouth_left:mouth_left+10%,-20%", "--percent-of", "left_eye:right_eye", "--radius", "80%",
        "--mirror", "nose_bridge:chin",
    )  # fmt: skip
    assert status == 2
    assert err.splitlines() == [
        "supple: marks has no landmarks of in/c.png: add c.pts or .csv",
        "supple: 2 of 3 files written into out, 1 failed: in/c.png",
    ]
    for name, s in {"a": 1, "b": 2}.items():
        unit = 12.0 * s
        at = {mark: np.array([(x + 0.5) * s - 0.5, (y + 0.5) * s - 0.5]) for mark, (x, y) in MARKS.items()}
        grab = supple.Stroke.grab(at["mouth_left"], to=at["mouth_left"] + (0.1 * unit, -0.2 * unit), radius=0.8 * unit)
        line = at["nose_bridge"], at["chin"] - at["nose_bridge"]
        normal = (-line[1][1], line[1][0])
        strokes = supple.Stroke.scale(at["nose_tip"], factor=0.8, radius=0.8 * unit), *grab.symmetric(line[0], normal)
        expected = warped(f"in/{name}.png", *strokes).astype(int)
        assert np.abs(image.read(f"out/{name}.png").pixels - expected).max() <= 1  # text has all digits; sums may not


def test_one_recipe_fits_every_portrait(run: Run, portraits: Path) -> None:
    strokes = [
        {"brush": "grab", "at": "mouth_left", "by": ["10%", "-20%"], "radius": "80%"},
        {"brush": "grab", "at": "chin", "to": "chin+0,5%", "radius": "100%"},
        {"brush": "grab", "at": "nose_tip", "path": ["nose_tip+5%,0"], "by": ["10%", 0], "radius": 9},
        {"brush": "grab", "at": "mouth_left", "by": [1, 0], "also": [["mouth_right", ["-10%", 0]]], "radius": "50%"},
    ]
    recipe = {"supple": 3, "percent_of": "left_eye:right_eye", "strokes": strokes}
    Path("r.json").write_text(json.dumps(recipe))
    assert run("warp", "in/a.png", "in/b.png", "out/", "--recipe", "r.json", "--landmarks", "marks/*.csv")[0] == 0
    for name, s in {"a": 1, "b": 2}.items():
        u = 12.0 * s
        at = {mark: np.array([(x + 0.5) * s - 0.5, (y + 0.5) * s - 0.5]) for mark, (x, y) in MARKS.items()}
        made = (
            supple.Stroke.grab(at["mouth_left"], by=(0.1 * u, -0.2 * u), radius=0.8 * u),
            supple.Stroke.grab(at["chin"], by=(0, 0.05 * u), radius=u),
            supple.Stroke.grab(at["nose_tip"], path=[at["nose_tip"] + (0.05 * u, 0)], by=(0.1 * u, 0), radius=9),
            supple.Stroke.pull([at["mouth_left"], at["mouth_right"]], by=[(1, 0), (-0.1 * u, 0)], radius=u / 2),
        )
        expected = warped(f"in/{name}.png", *made).astype(int)
        assert np.abs(image.read(f"out/{name}.png").pixels - expected).max() <= 1
    # What is saved of one picture is in numbers, and makes the same.
    assert (
        run("warp", "in/b.png", "b.png", "--recipe", "r.json", "--landmarks", "marks", "--save-recipe", "n.json")[0]
        == 0
    )
    assert run("warp", "in/b.png", "again.png", "--recipe", "n.json")[0] == 0
    same("again.png", image.read("out/b.png").pixels)
    more = ("--grab", "chin:chin+2,0", "--radius", "9", "--landmarks", "marks")
    assert run("warp", "in/b.png", "more.png", "--recipe", "n.json", *more)[0] == 0
    said = one_line(run("warp", "in/a.png", "x.png", "--recipe", "n.json", *more)[2])
    assert "n.json was made for another size than in/a.png" in said
    Path("r.json").write_text(json.dumps({**recipe, "size": [48, 40]}))
    said = one_line(run("warp", "in/a.png", "x.png", "--recipe", "r.json", "--landmarks", "marks")[2])
    assert 'leave "size" out' in said


def test_a_pull_from_landmarks_to_others(run: Run, portraits: Path) -> None:
    os.makedirs("to")
    for name in "ab":
        text = Path(f"marks/{name}.csv").read_text().replace("mouth_left,28.0,27.0", "mouth_left,29.0,26.0")
        Path(f"to/{name}.csv").write_text(text.replace("mouth_left,56.5,54.5", "mouth_left,58.5,52.5"))
    assert run("warp", "in/a.png", "in/b.png", "out/", "--pull", "marks:to", "--radius", "25%")[0] == 0
    for name, s in {"a": 1, "b": 2}.items():
        at = [((x + 0.5) * s - 0.5, (y + 0.5) * s - 0.5) for x, y in MARKS.values()]
        by = [(s, -s) if mark == "mouth_left" else (0, 0) for mark in MARKS]
        same(f"out/{name}.png", warped(f"in/{name}.png", supple.Stroke.pull(at, by=by, radius=10 * s)))


def test_faces_of_many_pictures(run: Run, here: Path) -> None:
    os.makedirs("in")
    portrait = image.read(PORTRAIT).pixels
    for name, top in {"a": 0, "b": 20}.items():
        image.write(f"in/{name}.png", portrait[top : top + 300])
        text = PORTRAIT.with_suffix(".pts").read_text().splitlines()
        rows = [f"{x} {float(y) - top}" for x, y in map(str.split, text[3:-1])]
        Path(f"in/{name}.pts").write_text("\n".join([*text[:3], *rows, "}"]))
    image.write("in/c.png", portrait[300:])
    status, out, err = run(
        "face", "in", "out", "--slim", "20", "--eyes", "15%", "--smile", "10", "--nose", "-10", "--json"
    )
    assert status == 2
    assert err.splitlines() == [
        "supple: in/c.png has no landmarks: put c.pts, .csv, .xml or .json beside it, or pip install 'supple[face]', "
        "by which faces are found",
        "supple: 2 of 3 files written into out, 1 failed: in/c.png",
    ]
    assert [json.loads(line).get("strokes") for line in out.splitlines()].count(1) == 2
    for name in "ab":
        (face,) = faces_of(f"in/{name}.png")
        same(f"out/{name}.png", warped(f"in/{name}.png", face_stroke(face, slim=20, eyes=15, smile=10, nose=-10)))
    assert run("face", "in/a.png", "a.png", "--slim", "20", "--save-recipe", "r.json")[0] == 0
    assert run("warp", "in/a.png", "again.png", "--recipe", "r.json")[0] == 0
    same("again.png", image.read("a.png").pixels)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("warp", "in/a.png", "x.png", "--grab", "nose:3,4", "--radius", "9", "--landmarks", "marks"),
         "in/a.png has no landmark nose, which --grab asks for; it has left_eye, right_eye, nose_tip"),
        (("warp", "in/a.png", "x.png", "--grab", "nose_tip@2:3,4", "--radius", "9", "--landmarks", "marks"),
         "in/a.png has one face, and no face 2: give another number"),
        (("warp", "in/a.png", "x.png", "--grab", "nose_tip+3:3,4", "--radius", "9", "--landmarks", "marks"),
         "--grab must be a landmark, with or without +DX,DY"),
        (("warp", "in/a.png", "x.png", "--grab", "nose_tip+3,q:3,4", "--radius", "9", "--landmarks", "marks"),
         "--grab must be a landmark and +DX,DY"),
        (("warp", "in/a.png", "x.png", "--grab", "10%,10%:3,4", "--radius", "9"), "--grab must be X,Y:X,Y"),
        (("warp", "in/a.png", "x.png", *GRAB[:2], "--radius", "q%"), "--radius must be a number of pixels"),
        (("warp", "in/a.png", "x.png", *GRAB[:2], "--radius", "-3%"), "or a percentage, found '-3%'"),
        (("warp", "in/a.png", "x.png", *GRAB, "--landmarks", "marks"), "--landmarks is for landmarks of strokes"),
        (("warp", "in/a.png", "x.png", *GRAB, "--percent-of", "a:b"), "--percent-of is for percentages of strokes"),
        (("warp", "in/a.png", "x.png", "--grab", "left_eye:chin", "--radius", "9", "--percent-of", "a:b", "--landmarks",
          "marks"), "--percent-of is for percentages of strokes"),
        (("warp", "in/a.png", "x.png", *GRAB[:2], "--radius", "9%", "--percent-of", "chin", "--landmarks", "marks"),
         "--percent-of must be two landmarks, A:B"),
        (("warp", "in/a.png", "x.png", *GRAB[:2], "--radius", "9%", "--percent-of", "chin:chin", "--landmarks",
          "marks"),
         "--percent-of chin:chin are two landmarks at one place"),
        (("warp", "in", "out", *GRAB[:2], "--radius", "9%", "--save-recipe", "r.json"),
         "--save-recipe is for one file"),
        (("warp", "in", "out", "--grab", "chin:3,4", "--radius", "9", "--landmarks", "marks/a.csv"),
         "--landmarks marks/a.csv is of one picture, and there are several"),
        (("face", "in/a.png", "x.png"), "nothing to do: give --slim"),
        (("face", "in/a.png"), "give a picture to read and a name to write to"),
        (("face", "in/a.png", "x.png", "--slim", "101"), "--slim must be percent from -100 to 100, found '101'"),
        (("face", "in/a.png", "x.png", "--slim", "9", "--face", "0"), "--face must be the number of a face"),
        (("face", "in/a.png", "x.png", "--slim", "9", "--face", "2", "--landmarks", "marks"), "and no face 2"),
        (("face", "in/a.png", "x.png", "--slim", "9", "--landmarks", "marks"),
         "--slim needs jaw_left, jaw_right, of which there is no landmark: add it"),
        (("face", "head.nii.gz", "x.nii.gz", "--slim", "9"), "landmarks are of pictures, and head.nii.gz is a volume"),
    ],
)  # fmt: skip
def test_refusals(run: Run, portraits: Path, arguments: tuple[str, ...], says: str) -> None:
    if "head.nii.gz" in arguments:
        (portraits / "head.nii.gz").symlink_to(PORTRAIT.parent / "head.nii.gz")
    status, _, err = run(*arguments)
    assert status == 2
    assert says in one_line(err)
    assert not Path("x.png").exists()
    assert not Path("r.json").exists()
