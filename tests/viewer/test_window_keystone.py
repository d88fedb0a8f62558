"""The perspective of a picture is shown in the window, and taken away by a frame of four corners."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from supple import Deformation, Straighten
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe
from tests.viewer.windows import opened, wait_for

HEIGHT, WIDTH = 300, 420
DOOR = ((130.0, 70.0), (300.0, 95.0), (310.0, 220.0), (110.0, 245.0))


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    """A white door in a dark wall, seen from the side."""
    y, x = np.indices((HEIGHT, WIDTH)).astype(float)
    inside = np.ones((HEIGHT, WIDTH))
    for (a, b), (c, d) in zip(DOOR, (*DOOR[1:], DOOR[0]), strict=True):
        away = ((c - a) * (y - b) - (d - b) * (x - a)) / np.hypot(c - a, d - b)
        inside = np.minimum(inside, np.clip(away + 0.5, 0, 1))
    made = 40 + inside[..., None] * [190, 180, 170]
    image.write(tmp_path / "wall.png", np.rint(made).astype(np.uint8))
    return tmp_path / "wall.png"


def rows_of(pixels: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """The first and the last bright row of each column of the door but for its sides."""
    bright = pixels[..., 0] > 135
    columns = np.flatnonzero(bright.any(axis=0))
    found = [np.flatnonzero(bright[:, k])[[0, -1]] for k in columns[4:-4]]
    return np.array(found)


def test_the_perspective_of_a_recipe_is_shown(gpu: Gpu, wall: Path, tmp_path: Path) -> None:
    view, hand = opened(wall, Recipe(straighten=Straighten(keystone=DOOR, fit="keep")), size=(860, 520))
    hand.canvas.draw()
    seen = rows_of(view.pixels())
    assert len(seen) > 60
    assert np.ptp(seen, axis=0).max() <= 1  # level above and below
    corners = np.array([view.tools.view.to_canvas(*p) for p in DOOR])
    assert np.ptp(corners[[0, 3], 0]) < 1e-6
    assert np.ptp(corners[[0, 1], 1]) < 1e-6
    # What is under the pointer is what a stroke is drawn at.
    view.tools.radius = 20
    x, y = corners.mean(axis=0)
    hand.drag((x, y), (x + 30, y))
    (stroke,) = view.document.strokes
    assert stroke.at == pytest.approx(view.tools.view.to_image(round(x), round(y)), abs=1.0)
    assert view.tools.view.to_canvas(*np.add(stroke.at, stroke.by)) == pytest.approx((x + 30, y), abs=2.0)
    # As in an export, at the places that both have.
    view.commands.begin_export(tmp_path / "out.png")
    wait_for(lambda: view.commands.export is not None and view.commands.export.done)
    exported = image.read(tmp_path / "out.png").pixels
    pull, _ = Straighten(keystone=DOOR, fit="keep").on((WIDTH, HEIGHT))
    shown, top = view.pixels(), view.tools.view.top
    points = np.stack(np.meshgrid(np.arange(90, 330, 7), np.arange(60, 250, 7)), -1).reshape(-1, 2)
    back = np.column_stack([points, np.ones(len(points))]) @ pull.matrix.T
    places = np.array([view.tools.view.to_canvas(*(p[:2] / p[2])) for p in back])
    columns, rows = np.rint(places - (0.5, top + 0.5)).astype(int).T
    off = np.abs(shown[rows, columns].astype(int) - exported[points[:, 1], points[:, 0], :3]).max(axis=1)
    assert np.median(off) <= 2
    assert (off < 30).mean() > 0.9  # but for the edges of the door, a part of a pixel away


def test_four_corners_are_dragged_onto_a_door(gpu: Gpu, wall: Path) -> None:
    view, hand = opened(wall, size=(860, 520))
    hand.canvas.draw()
    hand.key("k")
    hand.canvas.draw()
    assert len(view.tools.corners) == 4
    for start, end in zip(view.tools.corners, DOOR, strict=True):
        hand.drag(view.tools.view.to_canvas(*start), view.tools.view.to_canvas(*end))
    straighten = view.document.state.rest.straighten
    assert straighten is not None
    np.testing.assert_allclose(straighten.keystone, DOOR, atol=1.0)
    assert len(view.document.steps) == 5  # each corner is one
    assert view.tools.view.vanishing == (0.0, 0.0)  # as it is, while the frame is drawn
    hand.key("g")
    hand.canvas.draw()
    assert view.tools.view.vanishing != (0.0, 0.0)
    assert np.ptp(rows_of(view.pixels()), axis=0).max() <= 2
    # A frame with notches is refused, and what there was stays.
    hand.key("k")
    hand.canvas.draw()
    first, _, third, _ = view.tools.corners
    hand.drag(view.tools.view.to_canvas(*first), view.tools.view.to_canvas(third[0] + 40, third[1] + 20))
    now = view.document.state.rest.straighten
    assert now is not None
    assert "notches" in (view.tools.status or "") or now.keystone != straighten.keystone
    # Escape takes a drag back.
    known = view.document.state.rest.straighten
    x, y = view.tools.view.to_canvas(*view.tools.corners[0])
    hand.press(x, y)
    hand.move(x - 12, y - 9, 1)
    assert view.document.state.rest.straighten != known
    hand.key("Escape")
    assert view.document.state.rest.straighten == known
    # What Python makes of the recipe has the door upright.
    view.commands.attempt(view.document.undo)
    picture = image.read(wall).pixels
    made = Deformation((HEIGHT, WIDTH)).straighten(straighten).warp(picture)
    assert np.ptp(rows_of(made), axis=0).max() <= 2
