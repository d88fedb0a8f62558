"""What lies over the picture, as it is seen: rings, marks, and the line of status."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from windows import SIZE, Hand

import supple
from supple.gpu.device import Gpu
from supple.media import volume as volumes
from supple.strokes import Recipe, Stroke

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")

DATA = Path(supple.__file__).parent / "data"


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def opened(source: Path, recipe: Recipe | None = None) -> tuple[Any, Hand]:
    from rendercanvas.offscreen import RenderCanvas, loop

    from supple.viewer.launch import opened as opened_on

    canvas = RenderCanvas(size=SIZE, pixel_ratio=1.0)
    view = opened_on(source, recipe, canvas, loop)
    canvas.draw()
    return view, Hand(canvas)


def red(pixels: np.ndarray) -> int:
    """How many pixels have the colour of what was wanted and is not reached."""
    return int((np.abs(pixels[..., :3].astype(int) - (255, 96, 80)).max(axis=-1) < 40).sum())


def test_a_volume_tells_millimetres_and_values_and_shows_the_brush(gpu: Gpu) -> None:
    from supple.viewer.overlay import status

    view, hand = opened(DATA / "head.nii.gz", Recipe(border=None))
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
    view.tools.radius *= 1.5
    view.refresh()
    after = hand.canvas.draw()
    ring = view.tools.ring
    column = round(350 + ring)
    assert (
        np.abs(after[295:306, column - 2 : column + 3].astype(int) - before[295:306, column - 2 : column + 3]).max()
        > 60
    )
    view.close()


def test_a_damped_stroke_of_a_volume_shows_how_far_it_was_to_go(gpu: Gpu) -> None:
    from supple.viewer.overlay import status

    stroke = Stroke.grab((36, 54, 60), by=(0, 0, -30), radius=12)
    view, hand = opened(DATA / "head.nii.gz", Recipe(border=None, strokes=(stroke,)))
    assert view.document.damping(0) < 0.9
    assert "off by more than a voxel: mode exact is not" in status(view)  # and nobody is warned elsewhere
    damped = red(hand.canvas.draw())
    assert damped > 20
    view.document.set_on_fold("flow")
    assert view.document.damping(0) == 1
    assert red(hand.canvas.draw()) < damped / 4
    view.document.mark_saved()
    view.close()


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
    view.close()
