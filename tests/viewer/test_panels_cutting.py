"""What is cut away from a rendering: the panel's controls, the picture, what a pointer hits, and the planes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.render.camera import Camera
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.tools.planes import RENDERED
from tests.viewer.windows import Boxes, Hand, opened

PULL = Stroke.grab((22, 40, 24), by=(2, -5, 3), radius=12)


@pytest.fixture
def window(gpu: Gpu, volume: Any, boxes: Boxes) -> tuple[Any, Hand]:
    view, hand = opened(volume, Recipe(border=None, strokes=(PULL,)), size=(760, 1000))
    hand.canvas.draw()
    left, top, _, bottom = boxes["Cut away"]
    hand.click((left + 8, 0.5 * (top + bottom)))
    view.document.mark_saved()
    return view, hand


def rendering(view: Any, hand: Hand) -> np.ndarray[Any, Any]:
    hand.move(1, 1)
    for _ in range(2):
        view._changed_at = 0.0
        seen = hand.canvas.draw()
    left, top, width, height = (int(v) for v in view.tools.places[RENDERED])
    return seen[top + 30 : top + height - 90, left + 2 : left + width - 30, :3].astype(int)


def test_sliders_cut_and_show_all(window: tuple[Any, Hand], boxes: Boxes) -> None:
    view, hand = window
    sizes = view.tools.sizes
    whole = rendering(view, hand)
    hand.drag(boxes.at("##to1", 0.98), boxes.at("##to1", 0.6), steps=3)
    (x, (first, last), z) = view.stage.scene.clip
    assert (x, z, first) == ((0, sizes[0] - 1), (0, sizes[2] - 1), 0)
    assert last == round(last) == pytest.approx(0.6 * sizes[1], abs=4)
    assert view.stage.clip == view.stage._plain.clip == view.stage.scene.clip
    cut = rendering(view, hand)
    assert (np.abs(cut - whole).max(axis=-1) > 20).mean() > 0.05
    # The other end stops a voxel before.
    hand.drag(boxes.at("##from1", 0.02), boxes.at("##from1", 0.98), steps=3)
    assert view.stage.scene.clip[1] == (last - 1, last)
    hand.click(boxes.at("Show all"))
    assert (view.stage.clip, view.stage.scene.clip[1]) == (None, (0, sizes[1] - 1))
    np.testing.assert_array_equal(rendering(view, hand), whole)
    assert not view.document.can_undo  # what is seen is no step of the document


def test_a_half_is_cut_away_up_to_the_crosshair(window: tuple[Any, Hand], boxes: Boxes) -> None:
    view, hand = window
    tools = view.tools
    tools.sight = tools.sight.at((18, 30, 20), tools.sizes)
    whole = view.stage.scene.clip
    geometry = tools.geometry
    for letter, way in {"A": (0, -1, 0), "P": (0, 1, 0), "L": (1, 0, 0), "R": (-1, 0, 0), "S": (0, 0, 1)}.items():
        hand.click(boxes.at(f"{letter}##cut"))
        box = view.stage.scene.clip
        cross = geometry.to_lps((18, 30, 20))
        gone, left = (geometry.from_lps(cross + sign * 8 * np.array(way)) for sign in (1, -1))
        assert any(not low <= p <= high for p, (low, high) in zip(gone, box, strict=True)), letter
        assert all(low - 1e-9 <= p <= high + 1e-9 for p, (low, high) in zip(left, box, strict=True)), letter
        assert sum(a != b for a, b in zip(box, whole, strict=True)) == 1
        hand.click(boxes.at(f"{letter}##cut"))
        assert view.stage.scene.clip == whole
    hand.click(boxes.at("A##cut"))
    hand.click(boxes.at("P##cut"))  # the other half instead
    hand.click(boxes.at("S##cut"))  # and of this one the lower part
    assert sum(a != b for a, b in zip(view.stage.scene.clip, whole, strict=True)) == 2


def test_a_pointer_hits_the_cut_face(window: tuple[Any, Hand], boxes: Boxes) -> None:
    view, hand = window
    tools = view.tools
    tools.sight = tools.sight.at((22, 30, 22), tools.sizes)
    tools.view = Camera(0, 0)
    left, top, width, height = tools.places[RENDERED]
    place = (left + width / 2, top + 0.45 * height)
    for _ in range(2):  # off the panel, which has the pointer until the next frame
        hand.move(*place)
        hand.canvas.draw()
    before = tools.hover
    hand.click(boxes.at("A##cut"))
    for _ in range(2):  # off the panel, which has the pointer until the next frame
        hand.move(*place)
        hand.canvas.draw()
    assert before is not None
    assert tools.hover is not None
    assert tools.hover[1] == pytest.approx(30, abs=1.5)  # of a tissue that is not quite opaque
    assert before[1] > 40
    tools.radius = 6.0
    hand.drag(place, (place[0] + 20, place[1]))
    start = view.document.strokes[-1].at
    assert len(view.document.strokes) == 2
    assert start[1] == pytest.approx(30, abs=1.5)


def test_strokes_tables_and_colours_keep_the_box(window: tuple[Any, Hand], boxes: Boxes) -> None:
    view, hand = window
    hand.click(boxes.at("A##cut"))
    box, stage = view.stage.scene.clip, view.stage
    view.document.add(Stroke.grab((20, 20, 20), by=(2, 1, 0), radius=9))
    assert stage.deform(view.document.deformation).clip == box
    stage.look("grey", None)
    assert stage.scene.clip == box
    stage.set_table(True)
    assert stage.deform(view.document.deformation).clip == box
    half = np.zeros(view.document.shape, np.bool_)
    half[:, :, 30:] = True
    view.document.set_freeze(Freeze.of(half))
    frozen = stage.deform(view.document.deformation)
    assert frozen.clip == box
    stage.cut(None)
    assert stage.deform(view.document.deformation).clip == stage._plain.clip != box


def test_planes_show_the_box(window: tuple[Any, Hand], boxes: Boxes) -> None:
    view, hand = window
    tools = view.tools
    pane = tools.pane(0)
    hand.move(1, 1)
    before = hand.canvas.draw().astype(int)
    stage = view.stage
    stage.cut((*stage.scene.clip[:1], (12.0, 40.0), stage.scene.clip[2]))
    view.refresh()
    after = hand.canvas.draw().astype(int)
    for place in (12.0, 40.0):
        x, y = pane.to_canvas((30.0, place, 0.0))
        strip = np.abs(after - before)[int(y) - 2 : int(y) + 3, int(x) - 10 : int(x) + 10, :3]
        assert strip.max(axis=(0, 2)).min() > 30
    x, y = pane.to_canvas((30.0, 20.0, 0.0))
    assert np.abs(after - before)[int(y) - 3 : int(y) + 4, int(x) - 10 : int(x) + 10].max() < 8
