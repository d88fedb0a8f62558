"""What lies over the picture, as it is seen: rings, marks, and the line of status."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.media import volume as volumes
from supple.strokes import Recipe, Stroke
from tests.viewer.windows import DATA, SIZE, opened


def red(pixels: np.ndarray) -> int:
    """How many pixels have the colour of what was wanted and is not reached."""
    return int((np.abs(pixels[..., :3].astype(int) - (255, 96, 80)).max(axis=-1) < 40).sum())


def test_a_volume_tells_millimetres_and_values_and_shows_the_brush(gpu: Gpu) -> None:
    from supple.viewer.panels.overlay import status

    view, hand = opened(DATA / "head.nii.gz", Recipe(border=None))
    hand.key("4")  # the rendering, on the whole canvas
    hand.move(350, 300)
    before = hand.canvas.draw()
    said = status(view)
    found = re.search(r"x (\S+)  y (\S+)  z (\S+)   \|   (\S+)   \|   \((\S+), (\S+), (\S+)\) mm (RAS|LPS)", said)
    assert found is not None, said
    index = [float(v) for v in found.groups()[:3]]
    volume = volumes.read(DATA / "head.nii.gz")
    place = volume.geometry.to_world(index)
    np.testing.assert_allclose([float(v) for v in found.groups()[4:7]], place, atol=0.3)
    x, y, z = (round(v) for v in index)
    assert float(volume.rescaled()[z, y, x]) == pytest.approx(float(found[4]), abs=60)
    assert found[8] == volume.geometry.convention
    view.tools.radius *= 0.7
    view.refresh()
    after = hand.canvas.draw()
    ring = view.tools.ring
    column = round(350 + ring * view.tools.extent[0])
    assert (
        np.abs(after[295:306, column - 2 : column + 3].astype(int) - before[295:306, column - 2 : column + 3]).max()
        > 60
    )


def missed(view: Any) -> float:
    arrival = view.document.arrival(0)
    assert arrival is not None
    return float(arrival.miss)


def test_a_damped_stroke_of_a_volume_shows_how_far_it_was_to_go(
    gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu, "software", False)
    stroke = Stroke.grab((18, 27, 30), by=(0, 0, -15), radius=12)
    view, hand = opened(volume, Recipe(border=None, on_fold="damp", strokes=(stroke,)), size=(560, 300))
    hand.key("4")  # the rendering, on the whole canvas
    assert missed(view) > 1.5
    damped = red(hand.canvas.draw())
    assert damped > 20
    view.document.set_rest(on_fold="flow")
    assert missed(view) == 0
    assert red(hand.canvas.draw()) < damped / 4


def test_what_is_played_is_marked(gpu: Gpu) -> None:
    view, hand = opened(DATA / "bunny.mp4")
    hand.canvas.draw()
    low = SIZE[1] - 24 - 44

    def marked() -> np.ndarray:
        """The columns of the timeline in which there is the mark's blue."""
        hand.canvas.draw()
        bar = hand.canvas.draw()[low : low + 44, :700, :3].astype(int)
        return np.flatnonzero((np.abs(bar - (64, 160, 255)).max(axis=-1) < 12).sum(axis=0) > 8)

    assert marked().size == 0
    view.tools.playback.seek(16)
    hand.key("i")
    view.tools.playback.seek(48)
    hand.key("o")
    columns = marked()
    assert columns.size
    assert 150 < np.ptp(columns) < 300
    hand.key("u")
    assert marked().size == 0


def test_strokes_are_marked_on_the_timeline(gpu: Gpu) -> None:
    view, hand = opened(DATA / "bunny.mp4")

    def bar() -> np.ndarray:
        for _ in range(3):
            hand.canvas.draw()
        return np.array(hand.canvas.draw()[SIZE[1] - 68 : SIZE[1] - 24, :700, :3]).astype(int)

    before = bar()
    view.document.add(Stroke(at=(120, 80, 32), by=(14, 6, 16), radius=40))
    columns = np.flatnonzero((np.abs(bar() - before).max(axis=-1) > 40)[20:].any(axis=0))
    groups = np.split(columns, np.flatnonzero(np.diff(columns) > 3) + 1)
    assert len(groups) == 2  # where it begins, and where it ends
    view.document.undo()
    assert np.abs(bar() - before).max() < 8


def test_a_long_seek_says_so(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.panels.overlay import status

    view, hand = opened(DATA / "bunny.mp4")
    monkeypatch.setattr(view.stage.film, "get", lambda frame: None)
    view.tools.playback.seek(40)
    hand.canvas.draw()
    view.ready_at = time.perf_counter()  # however long that took
    assert "seeking" not in status(view)
    view.ready_at -= 0.6
    hand.canvas.draw()
    assert status(view) == "seeking frame 40 \u2026"
    monkeypatch.undo()
    assert view.stage.film.want(40, 40) or view.stage.film.arrived(30.0)
    for _ in range(2):
        hand.canvas.draw()
    assert "seeking" not in status(view)


def test_the_frame_that_is_seen_is_certified(gpu: Gpu) -> None:
    from supple.viewer.panels.overlay import certified

    stroke = Stroke(at=(120, 80, 10), by=(14, 6, 4), radius=40)
    view, hand = opened(DATA / "bunny.mp4", Recipe(border=None, strokes=(stroke,)))
    for frame in (8, 12):
        view.tools.playback.seek(frame)
        end = time.monotonic() + 60
        while "px of the map" not in certified(view) and time.monotonic() < end:
            hand.canvas.draw()
            time.sleep(0.05)
        wanted = view.document.deformation.report(plane=frame).error
        assert 0 < wanted < 0.01
        assert f"pixels read within {wanted:.2g} px of the map in this frame" in certified(view)
    hand.key(" ")
    assert "of the map" not in certified(view)  # while it plays


def test_strokes_of_other_frames_are_faint(gpu: Gpu) -> None:
    stroke = Stroke(at=(120, 80, 10), by=(40, 6, 4), radius=40)
    view, hand = opened(DATA / "bunny.mp4", Recipe(border=None, strokes=(stroke,)))
    view.document.select(0)

    def blue(frame: int) -> int:
        view.tools.playback.seek(frame)
        for _ in range(40):
            picture = hand.canvas.draw()[..., :3].astype(int)
            if view.painter.ready:
                break
            time.sleep(0.05)
        return int((np.abs(picture[:600, :600] - (64, 160, 255)).max(axis=-1) < 30).sum())

    counts = [blue(frame) for frame in (2, 10, 14)]
    assert counts[1] > counts[0] + 10  # where it begins
    assert counts[2] > counts[0] + 10  # and where it ends


def test_an_array_of_a_volume(gpu: Gpu) -> None:
    z, y, x = np.mgrid[:20, :24, :28]
    ball = (((x - 14) ** 2 + (y - 12) ** 2 + 4 * (z - 10) ** 2) < 90).astype(np.float32)
    view, hand = opened(ball, spacing=(1, 1, 2))
    hand.key("4")  # the rendering, on the whole canvas
    assert view.stage.kind == "volume"
    assert view.stage.spacing == (1, 1, 2)
    before = hand.canvas.draw()
    assert np.ptp(before[200:600, 300:700, :3]) > 60
    hand.drag((350, 300), (410, 300))
    (made,) = view.recipe.strokes
    assert len(made.at) == 3
    view.close()
    for spacing in ((1, 1), (0, 1, 1), "a"):
        with pytest.raises(SuppleError, match="spacing"):
            opened(ball, spacing=spacing)
    with pytest.raises(SuppleError, match=r"of a clip too: found uint8 \(2, 3, 4, 3\)"):
        opened(np.zeros((2, 3, 4, 3), np.uint8))


def test_a_drag_says_how_far_it_goes(gpu: Gpu) -> None:
    from supple.viewer.panels.overlay import status

    view, hand = opened(np.full((400, 600, 3), 90, np.uint8), Recipe(border=None))
    hand.key("1")
    hand.move(300, 300)
    assert "by " not in status(view)
    assert "90" in status(view)
    hand.press(300, 300)
    for x in (310, 320, 330):
        hand.move(x, 290, 1)
        hand.canvas.draw()
    assert "by +30.0 -10.0" in status(view)
    hand.release(330, 290)


def test_points_that_shaders_cannot_solve_are_drawn_by_the_cpu(
    gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stroke = Stroke.grab((18, 27, 30), by=(0, 0, -5), radius=12)
    wanted = opened(volume, Recipe(strokes=[stroke]), size=(700, 480))[1]
    wanted.key("4")

    def lost(*given: Any) -> None:
        raise ArithmeticError("points along rays could not be solved in its numbers")

    monkeypatch.setattr(gpu, "software", False)
    view, hand = opened(volume, Recipe(strokes=[stroke]), size=(700, 480))
    assert view.stage.scene.gpu is gpu
    hand.key("4")
    monkeypatch.setattr("supple.gpu.raymarch._march", lost)
    apart = np.abs(hand.canvas.draw().astype(int) - wanted.canvas.draw())
    assert np.percentile(apart, 95) < 12
