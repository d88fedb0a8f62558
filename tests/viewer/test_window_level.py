"""A picture is straightened in the window by a line along its horizon, strokes are drawn on it, and exports agree."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from supple import Deformation, Straighten
from supple.files.recipes import read_recipe
from supple.gpu.device import Gpu
from supple.media import image
from tests.viewer.windows import opened, wait_for

TILT = 4.0  # degrees, clockwise
HEIGHT, WIDTH = 300, 420


@pytest.fixture
def tilted(tmp_path: Path) -> Path:
    """A sea below a sky, tilted about the middle."""
    y, x = np.indices((HEIGHT, WIDTH))
    below = (y - 149.5) - math.tan(math.radians(TILT)) * (x - 209.5)
    share = np.clip(below + 0.5, 0, 1)[..., None]
    made = (1 - share) * [150, 190, 230] + share * [40, 80, 110]
    image.write(tmp_path / "sea.png", np.rint(made).astype(np.uint8))
    return tmp_path / "sea.png"


def along(x: float) -> tuple[float, float]:
    return x, 149.5 + math.tan(math.radians(TILT)) * (x - 209.5)


def test_a_line_along_the_horizon_levels_it(gpu: Gpu, tilted: Path, tmp_path: Path) -> None:
    view, hand = opened(tilted, size=(760, 480))
    hand.canvas.draw()
    hand.key("y")
    hand.drag(view.tools.view.to_canvas(*along(60)), view.tools.view.to_canvas(*along(360)))
    straighten = view.document.state.rest.straighten
    assert straighten is not None
    assert straighten.rotate == pytest.approx(-TILT, abs=0.15)  # of whole pixels
    assert [view.tools.view.to_canvas(*along(x))[1] for x in (60, 360)] == pytest.approx(
        [view.tools.view.to_canvas(*along(209.5))[1]] * 2, abs=1.0
    )
    # A stroke that is drawn on what is seen goes along the screen.
    hand.key("g")
    view.tools.radius = 25
    x, y = view.tools.view.to_canvas(*along(200))
    hand.drag((x, y), (x + 40, y))
    (stroke,) = view.document.strokes
    turned = straighten.linear @ np.array(stroke.by)
    assert turned[1] == pytest.approx(0, abs=1e-6)
    assert turned[0] > 10
    shown = view.pixels()
    image.write(tmp_path / "seen.png", np.ascontiguousarray(shown[..., :3]))
    # The export is what Python makes of the recipe, and its horizon is level.
    view.commands.save(tmp_path / "r.json")
    recipe = read_recipe(tmp_path / "r.json")
    assert recipe.straighten == straighten
    view.commands.begin_export(tmp_path / "level.png")
    wait_for(lambda: view.commands.export.done)
    assert view.commands.export.error is None
    made = image.read(tmp_path / "level.png").pixels
    expected = Deformation.from_recipe(recipe, (HEIGHT, WIDTH)).warp(image.read(tilted).pixels)
    np.testing.assert_array_equal(made, expected)
    horizon = (made[..., 2] > 170).sum(axis=0)
    assert np.ptp(horizon) <= 2
    # It is one step, and undone and redone as any other.
    hand.key("z", "Control"), hand.key("z", "Control")
    assert view.document.state.rest.straighten is None
    assert view.tools.view.turn == (1.0, 0.0, 0.0, 1.0)
    hand.key("y", "Control")
    assert view.document.state.rest.straighten == straighten


def test_a_short_line_and_escape_change_nothing_and_a_line_upwards_makes_it_upright(gpu: Gpu, tilted: Path) -> None:
    view, hand = opened(tilted, size=(760, 480))
    hand.key("y")
    x, y = view.tools.view.to_canvas(200, 150)
    hand.drag((x, y), (x + 8, y + 3))
    hand.press(x, y)
    hand.move(x + 100, y + 30, 1)
    assert view.tools.line is not None
    hand.key("Escape")
    hand.release(x + 100, y + 30)
    assert view.document.steps == (view.document.state,)
    hand.drag((x, y), (x + 10, y - 100))
    assert view.document.state.rest.straighten.rotate == pytest.approx(-math.degrees(math.atan2(10, 100)), abs=0.01)
    view.document.set_rest(straighten=Straighten())
    assert view.document.state.rest.straighten is None


def test_levelling_goes_through_the_keystone() -> None:
    quad = ((40.0, 20.0), (380.0, 50.0), (400.0, 280.0), (30.0, 260.0))
    known = Straighten(keystone=quad, shear=3).levelled((60, 100), (300, 130))
    flat = Deformation((HEIGHT, WIDTH)).straighten(keystone=quad, rotate=known.rotate, fit="keep")
    one, other = flat.forward([(60, 100), (300, 130)])
    assert math.atan2(other[1] - one[1], other[0] - one[0]) == pytest.approx(0, abs=1e-4)
    assert known.shear == (3, 0)
