"""Volumes in a window without a hardware GPU: previews while strokes change, and the whole rendering after."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.gpu.plate import BACK
from supple.gpu.screen import pixels_of
from supple.strokes import Stroke
from supple.viewer.panels import stages
from supple.viewer.tools.planes import RENDERED
from tests.viewer.windows import opened


@pytest.fixture
def rough(gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A window on a volume of which every second voxel is warped at once."""
    monkeypatch.setattr(gpu, "software", True)
    monkeypatch.setattr(stages, "_EASY", 1 << 14)
    monkeypatch.setattr(stages, "NIMBLE", 10.0)
    view, hand = opened(volume, size=(700, 480))
    assert view.stage.previews
    assert view.stage._apart == 2
    yield view, hand
    view.document.mark_saved()
    view.close()


def shown(view: Any) -> np.ndarray:
    return pixels_of(view.gpu, view._textures[0])[..., :3]


def whole(view: Any) -> np.ndarray:
    """What the window should show of the result, once all is there."""
    stage, tools = view.stage, view.tools
    _, _, width, height = tools.places[RENDERED]
    scene = stage._plain.deformed(view.document.deformation)
    assert scene.coarse == 1
    return scene.render(tools.stage.placed(tools.view), (round(height), round(width))).pixels(BACK)


def test_a_drag_has_a_preview_and_the_whole_comes_by_itself(rough: Any) -> None:
    view, hand = rough
    left, top, width, height = view.tools.places[RENDERED]
    x, y = left + width / 2, top + height / 2
    hand.move(x, y)
    hand.canvas.draw()
    hand.press(x, y)
    for k in range(1, 6):
        hand.move(x + 4 * k, y, 1)
        hand.canvas.draw()
    view.stage._apart = 2  # whatever it learned
    hand.move(x + 24, y, 1)
    hand.canvas.draw()
    assert view.document.dragging
    seen, before = view.stage.preview(view.document.deformation), view.stage.scene
    assert seen.coarse == 2
    assert before.deformation is not view.document.deformation  # the whole was never computed
    hand.release(x + 24, y)
    end = time.monotonic() + 60
    while view.filled < 1 or view._drawn_key is None or view._drawn_key[1]:
        hand.canvas.draw()
        assert time.monotonic() < end
    assert view.stage.scene.coarse == 1
    assert view.stage.scene.deformation is view.document.deformation
    np.testing.assert_array_equal(shown(view), whole(view))


def test_a_preview_is_as_fine_as_there_is_time_for(rough: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    view, _ = rough
    stage = view.stage
    for nimble, apart in ((0.0, 4), (0.0, 8), (0.0, 8), (1e3, 4), (1e3, 2), (1e3, 1), (1e3, 1)):
        monkeypatch.setattr(stages, "NIMBLE", nimble)
        view.document.add(Stroke.grab((20, 20, 20), by=(0.5, 0, 0), radius=9))
        seen = stage.preview(view.document.deformation)
        assert stage._apart == apart
        assert stage.preview(view.document.deformation) is seen  # computed once


def test_other_colours_and_boxes_leave_no_old_preview(rough: Any) -> None:
    view, _ = rough
    stage = view.stage
    view.document.add(Stroke.grab((20, 20, 20), by=(2, 1, 0), radius=9))
    d = view.document.deformation
    assert stage.fill(d, 0.0) in (0.0, 1.0)
    stage.look("grey", None)
    box = ((0.0, 30.0), (3.0, 40.0), (0.0, 40.0))
    stage.cut(box)
    assert stage.preview(d).clip == box
    while stage.fill(d, 1.0) < 1:
        pass
    assert stage.scene.clip == box
    assert stage.scene.transfer == stage._plain.transfer
