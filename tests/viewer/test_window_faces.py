"""The sliders of a face: one stroke in the list, undone step by step."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.files.faces import adjusted, face_stroke, faces_of
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe, Stroke
from supple.viewer.document.words import listed
from tests.viewer.windows import Boxes, Hand, opened

PORTRAIT = Path(supple.__file__).parent / "examples" / "data" / "astronaut.jpg"
MARKS = PORTRAIT.with_suffix(".pts")


def window(source: Path, *strokes: Stroke) -> tuple[Any, Hand]:
    view, hand = opened(source, Recipe(strokes=strokes), size=(900, 1000))
    view.sections = dict.fromkeys(("Brush", "Strokes", "View"), False) | {"Face": True}
    for _ in range(2):
        hand.canvas.draw()
    return view, hand


def slide(hand: Hand, box: tuple[float, ...], start: float, end: float) -> None:
    left, top, right, bottom = box
    places = [(left + (x + 50) / 100 * (right - left), 0.5 * (top + bottom)) for x in (start, end)]
    hand.drag(places[0], places[1])
    hand.canvas.draw()


def test_sliders_edit_one_stroke(gpu: Gpu, tmp_path: Path, boxes: Boxes) -> None:
    source = tmp_path / "portrait.jpg"
    shutil.copy(PORTRAIT, source)
    shutil.copy(MARKS, tmp_path / "portrait.pts")
    grab = Stroke.grab((400, 200), by=(12, 0), radius=40)
    view, hand = window(source, grab)
    assert {"##slim", "##eyes", "##smile", "##nose", "##jaw"} <= set(boxes)
    slide(hand, boxes["##slim"], 0, 20)
    assert len(view.document.strokes) == 2
    assert len(view.document.steps) == 2
    place, percents = adjusted(view.document.strokes[1]) or (0, {})
    assert place == 1
    assert percents == {"slim": pytest.approx(20, abs=3)}
    slide(hand, boxes["##eyes"], 0, 15)
    _, both = adjusted(view.document.strokes[1]) or (0, {})
    assert both == {**percents, "eyes": pytest.approx(15, abs=3)}
    assert len(view.document.strokes) == 2
    assert len(view.document.steps) == 3
    assert listed(view.document.strokes[1]).startswith("Face 1: slim ")
    # Landmarks are those of the picture after the strokes before: here, as far as they moved nothing.
    (face,) = faces_of(source)
    d = supple.Deformation.from_recipe(Recipe(strokes=(grab,)), (512, 512))
    there = dict(zip(face, map(tuple, d.forward(np.array([*face.values()])).tolist()), strict=True))
    np.testing.assert_allclose(view.document.strokes[1].by, face_stroke(there, **both).by, atol=1e-6)
    assert not [i for i, _ in view.document.tracks() if i == 1]  # no flower of handles
    view.document.undo()
    assert adjusted(view.document.strokes[1]) == (1, percents)
    view.document.undo()
    assert view.document.strokes == (grab,)


def test_a_face_of_several_is_chosen(gpu: Gpu, tmp_path: Path, boxes: Boxes) -> None:
    pixels = image.read(PORTRAIT).pixels
    image.write(tmp_path / "two.png", np.hstack([pixels, pixels]))
    rows = [tuple(map(float, row.split())) for row in MARKS.read_text().splitlines()[3:-1]]
    parts = [
        "".join(f'<part name="{k}" x="{x - 1 + shift}" y="{y - 1}"/>' for k, (x, y) in enumerate(rows))
        for shift in (0, 512)
    ]
    faces_text = "".join(f"<box>{part}</box>" for part in parts)
    (tmp_path / "two.xml").write_text(f'<dataset><images><image file="two.png">{faces_text}</image></images></dataset>')
    view, hand = window(tmp_path / "two.png")
    assert "##face" in boxes
    view.face = 1
    hand.canvas.draw()
    slide(hand, boxes["##smile"], 0, 30)
    (stroke,) = view.document.strokes
    assert (adjusted(stroke) or (0,))[0] == 2
    assert min(at[0] for at, by in stroke.handles if any(by)) > 512


def test_without_landmarks_the_section_says_so(gpu: Gpu, tmp_path: Path, boxes: Boxes) -> None:
    shutil.copy(PORTRAIT, tmp_path / "portrait.jpg")
    view, _ = window(tmp_path / "portrait.jpg")
    assert "##slim" not in boxes
    assert "portrait.jpg has no landmarks: put portrait.pts" in view.faces
    assert "supple[face]" in view.faces


def test_a_recipe_of_landmarks_is_opened(gpu: Gpu, tmp_path: Path) -> None:
    shutil.copy(PORTRAIT, tmp_path / "portrait.jpg")
    shutil.copy(MARKS, tmp_path / "portrait.pts")
    text = '{"supple": 3, "strokes": [{"brush": "grab", "at": "chin", "by": ["1%", 0], "radius": "10%"}]}'
    (tmp_path / "r.json").write_text(text)
    view, _ = window(tmp_path / "portrait.jpg")
    view.commands.open(tmp_path / "r.json")
    (face,) = faces_of(tmp_path / "portrait.jpg")
    assert view.document.strokes == (Stroke.grab(face["chin"], by=(5.12, 0), radius=51.2),)
