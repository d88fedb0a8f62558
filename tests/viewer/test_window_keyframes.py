"""Keys in the window: the lane below the timeline, the panel, the path over the picture; and what an export makes."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple import Key, Recipe, Stroke
from supple.files import warp_file
from supple.gpu.device import Gpu
from supple.media import image
from supple.viewer.panels.overlay import status
from tests.clips import decoded, make, rows
from tests.viewer.windows import Boxes, in_pixels, opened, settled, wait_for

KEYS = (Key(3, at=(300, 150), strength=0), Key(6, strength=1), Key(12, at=(380, 190), strength=0.5))
MOVING = Stroke(at=(300, 150), by=(30, -20), radius=50, keys=KEYS)


def marks(boxes: Boxes, frame: float, strength: float | None, count: int = 16) -> tuple[float, float]:
    """Where the mark of a key is on the lane: of its strength, or of its position."""
    x0, y0, x1, y1 = boxes["##lane"]
    inset = 7.0
    x = x0 + inset + frame / (count - 1) * (x1 - x0 - 2 * inset)
    return x, y0 + 8 if strength is None else y1 - 5 - strength * (y1 - y0 - 25)


def keys(view: Any) -> list[tuple[int, Any, float | None]]:
    return [
        (k.frame, k.at, None if k.strength is None else round(k.strength, 2)) for k in view.document.strokes[0].keys
    ]


def test_keys_are_dragged_in_the_lane_and_each_drag_is_a_step(gpu: Gpu, clip: Path, boxes: Boxes) -> None:
    view, hand = opened(clip, Recipe(strokes=(MOVING,)))
    view.document.select(0)
    hand.canvas.draw()
    hand.drag(marks(boxes, 6, 1), marks(boxes, 9, 1))  # through time
    hand.canvas.draw()
    assert keys(view) == [(3, (300, 150), 0), (9, None, 1), (12, (380, 190), 0.5)]
    hand.drag(marks(boxes, 9, 1), marks(boxes, 9, 0.4))  # down
    hand.canvas.draw()
    assert [k.frame for k in view.document.strokes[0].keys] == [3, 9, 12]
    assert view.document.strokes[0].keys[1].strength == pytest.approx(0.4, abs=0.02)
    assert len(view.document.steps) == 3
    hand.key("z", "Control")
    hand.key("z", "Control")
    assert view.document.strokes == (MOVING,)
    hand.key("y", "Control")
    assert keys(view)[1] == (9, None, 1)
    for _ in range(12):  # Dear ImGui takes one event of a key for each frame
        hand.pass_frame()
    # A click goes there, and changes nothing; beside keys, it is the timeline.
    hand.click(marks(boxes, 12, None))
    assert view.tools.playback.frame == 12
    hand.click((marks(boxes, 5, 0)[0], marks(boxes, 5, 0.6)[1]))
    assert view.tools.playback.frame == 5
    assert len(view.document.steps) == 3
    assert not view.document.dragging
    # What is dropped on another key takes its place, where it has something.
    hand.drag(marks(boxes, 9, 1), marks(boxes, 12, 1))
    hand.canvas.draw()
    assert keys(view) == [(3, (300, 150), 0), (12, (380, 190), 1)]
    # Of a key with both, one is dragged.
    hand.drag(marks(boxes, 12, None), marks(boxes, 14, None))
    hand.canvas.draw()
    assert keys(view) == [(3, (300, 150), 0), (12, None, 1), (14, (380, 190), None)]
    # A drag that is abandoned.
    hand.move(*marks(boxes, 12, 1))
    hand.pass_frame()
    hand.press(*marks(boxes, 12, 1))
    hand.pass_frame()
    hand.move(*marks(boxes, 7, 1), 1)
    hand.pass_frame()
    assert keys(view)[1][0] == 7
    hand.key("Escape")
    for _ in range(4):
        hand.pass_frame()
    assert keys(view)[1][0] == 12
    hand.release(*marks(boxes, 7, 1))
    hand.pass_frame()
    assert keys(view)[1][0] == 12
    assert view.document.selected == 0
    assert view._gui.trouble == ""


def test_a_right_click_removes_a_key(gpu: Gpu, clip: Path, boxes: Boxes) -> None:
    view, hand = opened(clip, Recipe(strokes=(MOVING,)))
    view.document.select(0)
    hand.canvas.draw()

    def click(at: tuple[float, float]) -> None:
        hand.move(*at)
        hand.pass_frame()
        hand.press(*at, 2)
        hand.pass_frame()
        hand.release(*at, 2)
        hand.pass_frame()

    click(marks(boxes, 12, 0.5))
    assert keys(view) == [(3, (300, 150), 0), (6, None, 1), (12, (380, 190), None)]
    click(marks(boxes, 3, None))
    assert keys(view) == [(3, None, 0), (6, None, 1), (12, (380, 190), None)]
    click(marks(boxes, 9, None))  # where there is none
    click(marks(boxes, 12, None))
    assert keys(view) == [(3, None, 0), (6, None, 1)]
    assert view.document.strokes[0].at == (380, 190)
    assert len(view.document.steps) == 4
    view.document.go(0)
    assert view.document.strokes == (MOVING,)


def test_the_panel_animates_a_stroke(gpu: Gpu, clip: Path, boxes: Boxes) -> None:
    view, hand = opened(clip, size=(1000, 1000))
    hand.canvas.draw()
    assert "##lane" not in boxes
    view.document.timed = False  # as the choice in the panel does
    hand.canvas.draw()
    x, y = view.tools.view.to_canvas(300, 150)
    hand.drag((x, y), (x + 40, y))
    view.own = True
    stroke = view.document.strokes[0]
    assert len(stroke.at) == 2
    assert "##lane" in boxes
    hand.canvas.draw()
    view.tools.playback.seek(3)
    hand.canvas.draw()
    hand.click(boxes.place("position"))
    assert keys(view) == [(3, stroke.at, None)]
    view.tools.playback.seek(10)
    hand.canvas.draw()
    hand.drag((x, y), (x + 30, y + 20))
    assert [k.frame for k in view.document.strokes[0].keys] == [3, 10]
    assert view.document.strokes[0].keys[1].at == pytest.approx((stroke.at[0] + 30, stroke.at[1] + 20), abs=30)
    hand.click(boxes.place("strength"))
    x0, y0, x1, y1 = boxes["##strength"]
    hand.drag((x1 - 5, (y0 + y1) / 2), (x0 + 0.25 * (x1 - x0), (y0 + y1) / 2))
    hand.canvas.draw()
    assert keys(view)[1][2] == pytest.approx(0.25, abs=0.06)
    view.tools.playback.seek(12)
    hand.canvas.draw()
    before = len(view.document.steps)
    hand.click(boxes.place("key here"))
    assert [k.frame for k in view.document.strokes[0].keys] == [3, 10, 12]
    hand.click(boxes.place("key before"))
    assert view.tools.playback.frame == 10
    hand.canvas.draw()
    hand.click(boxes.place("key here"))  # removes that one
    assert [k.frame for k in view.document.strokes[0].keys] == [3, 12]
    assert len(view.document.steps) == before + 2
    at = view.document.strokes[0].at_frame(10).at
    hand.click(boxes.place("position"))
    assert view.document.strokes[0].at_frame(0).at == at  # it stays where it is in this frame
    assert view._gui.trouble == ""


def test_what_is_seen_is_what_an_export_makes(gpu: Gpu, clip: Path, tmp_path: Path) -> None:
    twist = Stroke(
        brush="twist",
        at=(200, 250),
        angle=60,
        radius=60,
        strength=0.8,
        keys=(Key(0, at=(200, 250)), Key(15, at=(260, 200))),
    )
    recipe = Recipe(strokes=(MOVING, twist))
    view, hand = opened(clip, recipe, size=(640 + 348, 360 + 154))
    made = warp_file(clip, tmp_path / "out" / "%03d.png", recipe, hold=1)
    assert made.frames == 16
    hand.key("1")
    for frame in (0, 5, 9, 15):
        view.tools.playback.seek(frame)
        settled(view, hand)
        seen = view.pixels().astype(int)
        there = image.read(sorted((tmp_path / "out").iterdir())[frame]).pixels.astype(int)
        view.tools.original = True
        flat = view.pixels().astype(int)
        view.tools.original = False
        x, y = in_pixels(view, 0, 0)
        rows, columns = seen.shape[:2]
        part = slice(max(-y, 0) + 8, min(360, rows - y) - 8), slice(max(-x, 0) + 8, min(640, columns - x) - 8)
        moved = tuple(slice(s.start + d, s.stop + d) for s, d in zip(part, (y, x), strict=True))
        apart = np.abs(seen[moved] - there[part]).max(axis=-1)
        assert np.percentile(apart, 99) <= 12, frame
        still = np.abs(flat[moved] - there[part]).max(axis=-1).mean()
        assert still < 1 if frame in (0, 15) else apart.mean() < 0.5 * still, frame


def test_a_frame_at_each_end_is_kept_until_that_is_changed(gpu: Gpu, clip: Path, tmp_path: Path) -> None:
    view, hand = opened(clip, Recipe(strokes=(Stroke(at=(300, 150), by=(30, 20), radius=50),)))
    assert view.document.hold == 1
    kept = "this frame is kept, as those at the ends are"
    x, y = view.tools.view.to_canvas(200, 200)
    for frame, said in ((0, True), (8, False), (15, True)):
        view.tools.playback.seek(frame)
        settled(view, hand)
        assert view.document.deformation.is_identity == said
        hand.press(x, y)
        assert (kept in status(view)) == said
        hand.release(x, y)
    for hold in (1, 0):
        view.document.set_hold(hold)
        view.commands.begin_export(tmp_path / f"{hold}.mkv")
        wait_for(lambda: view.commands.export.done)
        view.commands.end_export()
        wanted = warp_file(clip, tmp_path / f"wanted{hold}.mkv", view.document.recipe, hold=hold)
        assert wanted.still == 2 * hold
        seen, other = ([rows(f) for f in decoded(tmp_path / f"{name}{hold}.mkv")] for name in ("", "wanted"))
        assert seen == other
    make(tmp_path / "short.mkv", "ffv1", count=4)
    view, _ = opened(tmp_path / "short.mkv")
    assert view.document.hold == 0


def test_the_path_of_the_selected_stroke_lies_over_the_picture(gpu: Gpu, clip: Path) -> None:
    view, hand = opened(clip, Recipe(strokes=(MOVING,)))
    view.tools.playback.seek(3)
    before = settled(view, hand)
    view.document.select(0)
    after = settled(view, hand)
    x, y = (round(v) for v in view.tools.view.to_canvas(380, 190))
    assert np.abs(after[y - 3 : y + 4, x - 3 : x + 4] - before[y - 3 : y + 4, x - 3 : x + 4]).max() > 60
    x, y = (round(v) for v in view.tools.view.to_canvas(340, 170))  # midway between the two
    assert np.abs(after[y - 4 : y + 5, x - 4 : x + 5] - before[y - 4 : y + 5, x - 4 : x + 5]).max() > 60


def test_a_frame_that_is_drawn_again_solves_and_samples_nothing_anew(
    gpu: Gpu, clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from supple.deformation import Deformation
    from supple.viewer.panels import keyframes

    view, hand = opened(clip, Recipe(strokes=(MOVING,)))
    view.document.select(0)
    settled(view, hand)
    count: list[str] = []
    add, curve = Deformation.add, keyframes.curve
    monkeypatch.setattr(Deformation, "add", lambda *a, **o: count.append("add") or add(*a, **o))
    monkeypatch.setattr(keyframes, "curve", lambda *a: count.append("curve") or curve(*a))
    for _ in range(3):
        hand.canvas.draw()
    assert count == []
    view.tools.playback.seek(9)
    hand.canvas.draw()
    hand.canvas.draw()
    assert count == ["add"]


def test_a_stroke_follows_its_point_in_the_background(
    gpu: Gpu, clip: Path, boxes: Boxes, monkeypatch: pytest.MonkeyPatch
) -> None:
    import supple
    from supple.viewer.document import files

    stroke = Stroke(at=(345, 58), by=(20, 10), radius=40, keys=(Key(2, strength=0.5), Key(9, strength=1)))
    view, hand = opened(clip, Recipe(strokes=(stroke,)), size=(1000, 1000))
    view.document.select(0)
    view.own = True
    view.tools.playback.seek(10)
    hand.canvas.draw()
    (found,) = supple.track(clip, [(345, 58, 10)])
    hand.click(boxes.place("Track its point"))
    assert view.commands.following is not None
    wait_for(lambda: hand.pass_frame() or view.commands.following is None, 60.0)
    made = view.document.strokes[0]
    assert [(k.frame, k.at) for k in made.keys if k.at is not None] == [
        (k, pytest.approx(at, abs=1e-9)) for k, at in found.keys
    ]
    assert made.at_frame(10).at == (345, 58)
    assert [(k.frame, k.strength) for k in made.keys if k.strength is not None] == [(2, 0.5), (9, 1)]
    assert view.commands.message == "the stroke follows its point from frame 0 to 15"
    view.document.undo()  # one step
    assert view.document.strokes == (stroke,)
    # It is cancelled, and a stroke that was edited meanwhile does not follow what it no longer shows.
    waits = [True]

    def slow(path: Path, points: Any, tell: Any) -> Any:
        for k in range(10000):
            tell("track", k, 10000)
            if not waits[0]:
                return supple.track(path, points, tell=tell)
            time.sleep(0.01)
        raise AssertionError("it was not cancelled")

    monkeypatch.setattr(files, "track", slow)
    hand.canvas.draw()
    hand.click(boxes.place("Track its point"))
    hand.canvas.draw()
    with pytest.raises(supple.SuppleError, match="a point is tracked already"):
        view.commands.follow(0)
    hand.click(boxes.place("Cancel"))
    wait_for(lambda: hand.pass_frame() or view.commands.following is None, 60.0)
    assert view.commands.message == "cancelled"
    assert view.document.strokes == (stroke,)
    view.commands.follow(0)
    view.document.replace(0, replace(stroke, radius=41))
    waits[0] = False
    wait_for(lambda: hand.pass_frame() or view.commands.following is None, 60.0)
    assert view.commands.message.startswith("the stroke was edited while its point was tracked")
    assert view.document.strokes[0].keys == stroke.keys
    # Where nothing is seen of it, it says so.
    flat = replace(stroke, at=(5, 5))
    view.document.replace(0, flat)
    monkeypatch.setattr(files, "track", lambda *a, **o: (_ for _ in ()).throw(supple.SuppleError("lost at once")))
    view.commands.follow(0)
    wait_for(lambda: hand.pass_frame() or view.commands.following is None, 60.0)
    assert view.commands.message == "lost at once"
    assert view.document.strokes == (flat,)
    assert view._gui.trouble == ""


def test_a_plateau_and_a_radius_in_time_are_set_in_the_panel(gpu: Gpu, clip: Path, boxes: Boxes) -> None:
    stroke = Stroke(at=(300, 150, 8), by=(20, 10, 2), radius=40)
    view, hand = opened(clip, Recipe(strokes=(stroke,)), size=(1000, 1000))
    view.document.select(0)
    view.own = True
    hand.canvas.draw()
    hand.click(boxes.place("##limited radius in time"))
    assert view.document.strokes[0].time_radius == 2.0  # of a drag of 2 frames, and 16 frames
    hand.canvas.draw()
    x0, y0, x1, y1 = boxes["##radius in time"]
    hand.click(((x0 + x1) / 2, (y0 + y1) / 2))
    assert view.document.strokes[0].time_radius == pytest.approx(4.25, abs=0.5)
    assert len(view.document.steps) == 3
    x0, y0, x1, y1 = boxes["##plateau"]
    hand.click(((x0 + x1) / 2, (y0 + y1) / 2))
    assert view.document.strokes[0].flat == pytest.approx(0.45, abs=0.05)
    hand.click(boxes.place("##limited radius in time"))
    assert view.document.strokes[0].time_radius is None
    view.own = False
    hand.canvas.draw()
    hand.click(boxes.place("##limited radius in time"))
    view.tools.flat = 0.5
    view.document.select(None)
    x, y = view.tools.view.to_canvas(200, 200)
    hand.drag((x, y), (x + 30, y))
    made = view.document.strokes[1]
    assert (made.flat, made.time_radius) == (0.5, 2.0)
    assert view._gui.trouble == ""


def test_the_status_says_where_an_export_samples_otherwise(gpu: Gpu, clip: Path) -> None:
    from supple.files.options import ClipOptions
    from supple.viewer.panels import overlay

    said = "frames are mixed here, and an export follows their motion"
    view, _ = opened(clip, Recipe(strokes=(Stroke(at=(300, 150, 8), by=(20, 10, 2), radius=40),)))

    for between, shown in (("flow", True), ("linear", False), ("nearest", False)):
        view.commands.options = {**view.commands.options, "clip": ClipOptions(between=between)}
        view.painter.ready = True
        assert (said in overlay.status(view)) is shown
    view.commands.options = {**view.commands.options, "clip": ClipOptions(between="flow")}
    view.document.load(Recipe(strokes=(MOVING,)))  # of which each frame is one
    assert said not in overlay.status(view)


def test_a_long_message_is_below_the_timeline(gpu: Gpu, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.panels import overlay

    bars: dict[str, tuple[float, float]] = {}
    pinned = overlay.pinned

    def watched(name: str, place: Any, size: Any, padding: tuple[float, float]) -> Any:
        bars[name] = place[1], size[1]
        return pinned(name, place, size, padding)

    monkeypatch.setattr(overlay, "pinned", watched)
    view, hand = opened(clip)
    view.commands.message = "what is said here takes several lines of the window, " * 6
    for _ in range(2):
        hand.canvas.draw()
    (top, high), (below, rest) = bars["timeline"], bars["status"]
    assert rest > 30
    assert (top + high, below + rest) == pytest.approx((below, view.logical[1]))
