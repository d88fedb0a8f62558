"""The parts of the panel: tools, menu, history, sections that stay folded, legends, and what is remembered."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.deformation import Deformation
from supple.gpu import plate
from supple.gpu.device import Gpu
from supple.media import volume as volumes
from supple.space.geometry import Geometry
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.view import WIDE
from supple.viewer.tools.keys import BRUSHES, KEYS
from tests.viewer.windows import SIZE, Boxes, Hand, imgui, opened

FLAT = (Stroke(at=(200, 120), by=(20, 10), radius=40), Stroke(at=(100, 90), by=(-10, 10), radius=30))
GREY = np.full((300, 400, 3), 128, np.uint8)


def grey(*strokes: Stroke, size: tuple[int, int] = SIZE) -> tuple[Any, Hand]:
    return opened(GREY, Recipe(border=None, strokes=strokes), size=size)


def test_each_tool_and_action_has_an_icon_and_a_key_that_is_listed() -> None:
    from supple.viewer.panels.actions import ACTIONS, GROUPS, MENUS
    from supple.viewer.panels.theme import ICONS

    assert set(BRUSHES) <= set(ICONS)
    assert all(ACTIONS[name].icon for group in GROUPS for name in group)
    assert {name for items in MENUS.values() for name in items} - {"", "recent"} == set(ACTIONS)
    listed = {word for rows in KEYS.values() for keys in rows for word in re.split("[ ,]+", keys)}
    assert {action.keys for action in ACTIONS.values()} - {""} <= listed
    assert {key for key, _ in BRUSHES.values()} <= listed


def test_icons_are_seen_and_differ(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.panels import actions, theme

    _, hand = grey()
    seen: dict[str, np.ndarray] = {}
    acts = {name: action.icon for name, action in actions.ACTIONS.items() if action.icon}
    for name, icon in {**theme.ICONS, **acts, "eye": theme.SEEN, "no eye": theme.HIDDEN}.items():

        def draw(view: Any, icon: str = icon) -> None:
            theme.draw_icon(imgui.get_background_draw_list(), icon, (30, 60), 18, 0xFFFFFFFF)

        monkeypatch.setattr("supple.viewer.panels.overlay.draw", draw)
        picture = hand.canvas.draw()[40:80, 10:50, :3].astype(int)
        seen[name] = picture > 200
        assert 25 < seen[name].sum() / 3 < 400, name
        edge = seen[name].copy()
        edge[4:-4, 4:-4] = False
        assert not edge.any(), name
    pairs = [(a, b) for a in seen for b in seen if a < b]
    assert min((seen[a] != seen[b]).sum() / 3 for a, b in pairs) > 25


def test_the_strip_does_what_its_keys_do(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(*FLAT)
    hand.canvas.draw()
    view.document.remove(0)
    hand.click(boxes.place("undo"))
    assert len(view.document.strokes) == 2
    hand.click(boxes.place("redo"))
    assert len(view.document.strokes) == 1
    hand.click(boxes.place("split"))
    assert view.tools.split == 0.5
    hand.click(boxes.place("split"))
    assert view.tools.split is None
    hand.key("1")
    hand.click(boxes.place("fit"))
    assert view.tools.view.held is None
    for name in ("open", "save", "copy"):
        view.commands.asked = None
        hand.canvas.draw()
        if name != "copy":
            hand.click(boxes.place(name))
            assert view.commands.asked.name == name
    view.commands.asked = None
    view.tools.brush = "other"
    hand.canvas.draw()
    hand.click(boxes.place("brush grab"))
    assert view.tools.brush == "grab"
    view.tools.brush = "other"
    hand.key("g")
    assert view.tools.brush == "grab"
    # An array is no file: nothing is exported.
    hand.click(boxes.place("export"))
    assert view.commands.asked is None
    assert not view.commands.message


def test_the_original_is_seen_while_its_button_is_held(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(*FLAT)
    hand.canvas.draw()
    place = boxes.place("original")
    hand.move(*place)
    hand.canvas.draw()
    hand.press(*place)
    hand.canvas.draw()
    assert view.tools.original
    hand.canvas.draw()
    assert view.tools.original
    hand.release(*place)
    hand.canvas.draw()
    assert not view.tools.original


@pytest.mark.parametrize("kind", ["photo", "clip", "volume"])
def test_a_step_is_compared_with_the_present(gpu: Gpu, kind: str, request: Any, boxes: Boxes) -> None:
    """Left of the line is the step that is marked, right of it what is there now, pixel by pixel."""
    at, by = ((22.0, 40.0, 22.0), (2.0, -3.0, 2.0)) if kind == "volume" else ((280.0, 180.0, 2.0), (20.0, 9.0, 0.0))
    n = 2 if kind == "photo" else 3
    strokes = [
        Stroke(at=at[:n], by=tuple(f * v for v in by[:n]), radius=20 * (1 + (kind == "volume"))) for f in (1, -1)
    ]
    view, hand = opened(request.getfixturevalue(kind), Recipe(border=None, strokes=strokes[:1]), size=(660, 640))
    if kind == "clip":
        view.document.set_hold(0)
    view.sections |= dict.fromkeys(("Brush", "Strokes", "Volume", "View"), False) | {"History": True}
    one = view.pixels().astype(int)
    view.document.add(replace(strokes[1], radius=30))
    hand.canvas.draw()
    two = view.pixels().astype(int)
    hand.canvas.draw()
    hand.click(boxes.place("mark 0"))
    assert view.tools.split == 0.5
    assert view.document.compared.strokes == view.document.steps[0].strokes
    both = view.pixels().astype(int)
    views = view.tools.places.values() if kind == "volume" else [(0, 0, *view.area)]
    for left, top, width, height in views:
        rows, middle = slice(int(top) + 2, int(top + height) - 2), left + 0.5 * width
        for start, end, wanted, other in (
            (left + 2, middle - 2, one, two),
            (middle + 2, left + width - 2, two, one),
        ):
            part = rows, slice(int(start), int(end))
            np.testing.assert_array_equal(both[part], wanted[part])
            assert (both[part] != other[part]).any()
    view.tools.split, view.tools.original = None, True
    np.testing.assert_array_equal(view.pixels(), one)
    hand.canvas.draw()
    hand.click(boxes.place("mark 0"))
    assert view.document.compared is None
    assert view.document.base.is_identity


def test_a_step_that_has_left_the_history_is_unmarked_by_a_click(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(*FLAT[:1])
    view.sections |= dict.fromkeys(("Brush", "Strokes", "View"), False) | {"History": True}
    view.document.add(FLAT[1])
    hand.canvas.draw()
    assert "Compare with the original" not in boxes
    view.document.compare(1)
    view.document.undo()
    view.document.add(replace(FLAT[1], radius=40))
    view.refresh()
    for _ in range(2):
        hand.canvas.draw()
    assert view.document.compared is not None
    assert view.document.compared_step is None
    hand.click(boxes.place("Compare with the original"))
    assert view.document.compared is None
    assert view.document.base.is_identity
    boxes.clear()
    hand.canvas.draw()
    assert "Compare with the original" not in boxes


def test_all_of_the_strip_is_seen_in_a_low_window(gpu: Gpu, boxes: Boxes) -> None:
    _, hand = opened(GREY, Recipe(border=None), size=(900, 330))
    hand.canvas.draw()
    assert boxes.place("keys")[1] < 324


def test_the_menu_undoes_by_name(gpu: Gpu, boxes: Boxes, monkeypatch: pytest.MonkeyPatch) -> None:
    view, hand = grey(*FLAT)
    said: list[str] = []
    item = imgui.menu_item
    monkeypatch.setattr(imgui, "menu_item", lambda text, *rest: said.append(text) or item(text, *rest))
    view.document.remove(0)
    hand.canvas.draw()
    hand.click(boxes.place("Edit"))
    assert "Undo: Remove stroke 1###undo" in said
    assert "Redo###redo" in said
    hand.click(boxes.place("menu undo"))
    assert len(view.document.strokes) == 2
    said.clear()
    hand.click(boxes.place("Edit"))
    assert "Redo: Remove stroke 1###redo" in said


def test_a_click_in_the_history_goes_there(gpu: Gpu, boxes: Boxes) -> None:
    view, hand = grey(size=(SIZE[0], 1200))
    for stroke in FLAT:
        view.document.add(stroke)
    view.sections = {"History": True}
    view.document.select(None)
    for _ in range(2):
        hand.canvas.draw()
    assert {"step 0", "step 1", "step 2"} <= set(boxes)
    hand.click(boxes.place("step 0"))
    assert view.document.strokes == ()
    hand.click(boxes.place("step 2"))
    assert len(view.document.strokes) == 2


def test_the_recipe_is_copied_where_there_is_a_clipboard(gpu: Gpu, boxes: Boxes) -> None:
    from supple.viewer.panels.actions import ACTIONS

    view, hand = grey(*FLAT)
    assert not ACTIONS["copy recipe"].able(view)
    copied: list[str] = []
    view.copy_text = copied.append
    hand.canvas.draw()
    hand.click(boxes.place("File"))
    hand.click(boxes.place("menu copy recipe"))
    assert Recipe.from_json(copied[0]).strokes == FLAT


def test_what_is_folded_stays_folded(gpu: Gpu, boxes: Boxes, tmp_path: Path) -> None:
    view, hand = grey()
    for _ in range(2):
        hand.canvas.draw()
    assert "step 0" not in boxes
    hand.click(boxes.place("section Brush"))
    view.close()
    place = tmp_path / "config" / "supple" / "window.json"
    assert json.loads(place.read_text())["sections"] == {"Brush": False}
    again, hand = grey()
    assert again.sections == {"Brush": False}
    hand.click(boxes.place("section Brush"))
    assert json.loads(place.read_text())["sections"] == {"Brush": True}
    # What is broken, or cannot be written, is ignored.
    for broken in ("{", "[1]", '{"sections": 3}', "\x00", "[" * 100000):
        place.write_text(broken)
        other, _ = grey()
        assert other.sections == {}
    place.write_bytes(b"\xff\xfe")
    other, _ = grey()
    assert other.sections == {}
    place.unlink()
    place.parent.rmdir()
    place.parent.write_text("a file, and no folder")
    hand.click(boxes.place("section Brush"))
    assert again._gui.trouble == ""
    assert again.sections == {"Brush": False}


def test_each_overlay_has_a_legend_in_its_own_colours() -> None:
    from supple.viewer.panels import strokes

    assert set(strokes.NAMES) == set(plate.OVERLAYS)
    shader = (Path(plate.__file__).parent / "shaders" / "plate.wgsl").read_text().partition("fn warm(")[2]
    found = [tuple(map(float, v.split(","))) for v in re.findall(r"vec3f\(([\d., ]+)\)", shader.partition("}")[0])]
    assert found == [strokes.COLD[:3], strokes.HOT[:3]]


def test_the_inner_ring_is_how_far_a_drag_is_felt_and_the_outer_one_the_reach(gpu: Gpu) -> None:
    view, hand = grey()
    view.tools.radius = 20
    x, y = 320, 300

    def rings() -> list[int]:
        """The distances to the right at which there is something bright."""
        hand.move(x, y)
        row = hand.canvas.draw()[y, x : x + 300, :3].astype(int).min(axis=-1)
        return [k for k in range(1, 299) if row[k] > 160 and row[k] >= row[k - 1] and row[k] > row[k + 1]]

    zoom = view.tools.view.zoom
    inner, outer = rings()
    assert outer == pytest.approx(80 * zoom, abs=2)
    middle = np.array(view.tools.view.to_image(x, y))
    bent = Deformation((400, 400), border=None).grab(middle, by=(2, 0), radius=20)
    ring = middle + np.array([inner / zoom, 0])
    assert np.linalg.norm(bent.forward(ring) - ring) == pytest.approx(0.05 * 2, abs=0.02)  # a twentieth of the drag
    view.tools.reach = 2.0
    assert rings()[0] < 0.7 * inner
    view.tools.reach = 4.0
    hand.key("c")  # what is frozen has an edge
    (edge,) = rings()
    assert edge == pytest.approx(20 * zoom, abs=2)


@pytest.mark.parametrize(("low", "high", "said"), [(-1000, 400, r"-?\d+ HU"), (0, 3, r"label \d"), (0, 7.5, r"[\d.]+")])
def test_a_value_is_said_in_its_unit(gpu: Gpu, low: float, high: float, said: str) -> None:
    from supple.render.picture import Pick

    z, y, x = np.mgrid[:20, :24, :28]
    ball = ((x - 14) ** 2 + (y - 12) ** 2 + 4 * (z - 10) ** 2) < 90
    noise = np.random.default_rng(0).uniform(0, 1, ball.shape) if isinstance(high, float) else 0
    samples = np.where(ball, high, low) + noise
    view, _ = opened(samples.astype(np.float32))
    value = view.stage.value(Pick((14, 12, 10), (14, 12, 10), 1.0))
    assert re.fullmatch(said, view.slices.told(value))
    assert volumes.Volume(samples, Geometry()).components == 1


def test_a_long_path_is_shortened_in_the_middle(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.panels.widgets import elided

    said: list[tuple[str, float]] = []

    def draw(view: Any) -> None:
        for wide in (400.0, 150.0, 3.0):
            text = elided("Saved to /home/someone/pictures/of/cups/coffee-bent.png", wide)
            said.append((text, imgui.calc_text_size(text).x))

    _, hand = grey()
    monkeypatch.setattr("supple.viewer.panels.overlay.draw", draw)
    hand.canvas.draw()
    (whole, _), (short, wide), _ = said
    assert whole == "Saved to /home/someone/pictures/of/cups/coffee-bent.png"
    assert re.fullmatch(r"Saved to /\w*\u2026.*bent.png", short)
    assert 120 < wide <= 150


def test_a_pointer_on_the_strip_is_not_on_the_picture(gpu: Gpu) -> None:
    view, hand = grey()
    hand.move(300, 300)
    hand.canvas.draw()
    hand.move(SIZE[0] - WIDE + 5, 60)  # in one leap
    assert view.tools.pointer is None
    hand.move(300, 300)
    hand.press(300, 300)
    hand.move(SIZE[0] - WIDE + 5, 300, 1)  # but a stroke is drawn on
    assert view.tools.pointer is not None
    hand.key("Escape")
    hand.release(SIZE[0] - WIDE + 5, 300)
