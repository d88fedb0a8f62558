"""The window as people have it: by a real pointer on a real screen."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe
from supple.viewer.panels.view import BAR, LINE, TOP, WIDE
from supple.viewer.window.launch import SIZE
from tests.viewer.sessions import near, on_canvas, recipe_in, warped
from tests.viewer.windows import Pixels, a_screen, viewing, wait_for

pytest.importorskip("glfw")
AREA = (SIZE[0] - WIDE, SIZE[1] - TOP - LINE)


def edited(source: Path, stem: str, target: str) -> tuple[Pixels, Recipe]:
    """Drag, undo, redo, save, export and open, by hand; what is seen of two strokes, and the recipe that was saved."""
    folder = source.parent
    saved, made = folder / f"{stem}.recipe.json", folder / target
    on_it = np.s_[TOP : AREA[1] - BAR, : AREA[0]]
    with a_screen(folder / "screen") as mouse, viewing(str(source), folder=folder, display=mouse.display):
        mouse.settled()
        mouse.do("key", "1")
        mouse.do("mousemove", 1100, 780)
        plain = mouse.settled()
        mouse.drag((400, 380), (440, 350))
        time.sleep(0.6)
        mouse.drag((520, 300), (500, 340))
        time.sleep(0.6)
        mouse.do("key", "ctrl+z")
        time.sleep(0.6)
        mouse.filed("ctrl+s", saved)
        assert len(recipe_in(saved).strokes) == 1
        # What is pressed while a question is still seen is not for the picture.
        wait_for(lambda: mouse.do("key", "ctrl+shift+z", "ctrl+s") or len(recipe_in(saved).strokes) == 2, every=0.5)
        mouse.filed("ctrl+e", made)
        mouse.do("key", "Escape")
        mouse.do("mousemove", 1100, 780)
        seen = mouse.settled()
        assert near(plain, seen, on_it) > 5
        # What was saved is opened again, and looks as it did.
        wait_for(lambda: mouse.do("key", "ctrl+z") or near(mouse.shown(), plain, on_it) < 0.5, every=0.5)
        mouse.do("key", "ctrl+o")
        wait_for(lambda: mouse.enter() or near(mouse.shown(), seen, on_it) < 0.5, every=0.5)
    return seen, recipe_in(saved)


def test_a_photograph_by_a_real_pointer(gpu: Gpu, photo: Path, state: Path) -> None:
    seen, recipe = edited(photo, "photo", "photo-bent.png")
    assert recipe.strokes[0].by == pytest.approx((40, -30), abs=0.01)
    wanted = warped(photo, "wanted.png", state / "photo.recipe.json")
    made = image.read(state / "photo-bent.png").pixels
    np.testing.assert_array_equal(made, image.read(wanted).pixels)
    # Without a hardware GPU, exports' own pixels are seen; a device has its own filter.
    linear = warped(photo, "linear.png", state / "photo.recipe.json", "--filter", "linear")
    drawn = made if gpu.software else image.read(linear).pixels
    assert on_canvas(drawn, seen, AREA, recipe.strokes) < 1.0
    assert on_canvas(image.read(photo).pixels, seen, AREA, recipe.strokes) > 8
