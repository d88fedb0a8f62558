"""The window as people have it: by a real pointer on a real screen."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.cli import command
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe
from supple.viewer.panels.view import BAR, LINE, WIDE
from supple.viewer.window.launch import SIZE
from tests import effort
from tests.clips import decoded
from tests.viewer.sessions import near, on_canvas, recipe_in, warped
from tests.viewer.windows import Mouse, Pixels, a_screen, as_in_a_window, viewing, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")
pytest.importorskip("glfw")
AREA = (SIZE[0] - WIDE, SIZE[1] - LINE)


def edited(
    source: Path, stem: str, target: str, first: Callable[[Mouse], None], pause: float = 0.6
) -> tuple[Pixels, Recipe]:
    """Drag, undo, redo, save, export and open, by hand; what is seen of two strokes, and the recipe that was saved."""
    folder = source.parent
    saved, made = folder / f"{stem}.recipe.json", folder / target
    on_it = np.s_[: AREA[1] - BAR, : AREA[0]]
    with a_screen(folder / "screen") as mouse, viewing(str(source), folder=folder, display=mouse.display):
        mouse.settled()
        first(mouse)
        mouse.do("mousemove", 1100, 780)
        plain = mouse.settled()
        mouse.drag((400, 380), (440, 350))
        time.sleep(pause)
        mouse.drag((520, 300), (500, 340))
        time.sleep(pause)
        mouse.do("key", "ctrl+z")
        time.sleep(pause)
        mouse.filed("ctrl+s", saved)
        assert len(recipe_in(saved).strokes) == 1
        # What is pressed while a question is still seen is not for the picture.
        wait_for(lambda: mouse.do("key", "ctrl+shift+z", "ctrl+s") or len(recipe_in(saved).strokes) == 2, every=0.5)
        mouse.filed("ctrl+e", made)
        mouse.do("key", "Escape")
        mouse.do("mousemove", 1100, 780)
        # A volume that is refined by software may look the same for a while.
        seen = mouse.settled(looks=12 if pause > 1 else 3)
        assert near(plain, seen, on_it) > 5
        # What was saved is opened again, and looks as it did.
        wait_for(lambda: mouse.do("key", "ctrl+z") or near(mouse.shown(), plain, on_it) < 0.5, every=0.5)
        mouse.do("key", "ctrl+o")
        wait_for(lambda: mouse.enter() or near(mouse.shown(), seen, on_it) < 0.5, every=0.5)
    return seen, recipe_in(saved)


def test_a_photograph_by_a_real_pointer(gpu: Gpu, photo: Path, state: Path) -> None:
    seen, recipe = edited(photo, "photo", "photo-bent.png", lambda mouse: mouse.do("key", "1") and None)
    assert recipe.strokes[0].by == pytest.approx((40, -30), abs=0.01)
    wanted = warped(photo, "wanted.png", state / "photo.recipe.json")
    made = image.read(state / "photo-bent.png").pixels
    np.testing.assert_array_equal(made, image.read(wanted).pixels)
    # Without a hardware GPU, exports' own pixels are seen; a device has its own filter.
    linear = warped(photo, "linear.png", state / "photo.recipe.json", "--filter", "linear")
    drawn = made if gpu.software else image.read(linear).pixels
    assert on_canvas(drawn, seen, AREA, recipe.strokes) < 1.0
    assert on_canvas(image.read(photo).pixels, seen, AREA, recipe.strokes) > 8


@effort.soak("a clip on a screen, which others have without one, and photographs and planes have by a pointer")
def test_a_clip_by_a_real_pointer(gpu: Gpu, clip: Path, state: Path) -> None:
    def first(mouse: Mouse) -> None:
        """Go to a frame, and to 100 %."""
        mouse.do("key", "1", "Home", *["Right"] * 8)
        time.sleep(0.5)

    seen, recipe = edited(clip, "clip", "clip-bent.mp4", first)
    assert [stroke.at[2] for stroke in recipe.strokes] == [8, 8]
    assert recipe.strokes[0].by == pytest.approx((40, -30, 0), abs=0.01)
    made, wanted = (
        decoded(path) for path in (state / "clip-bent.mp4", warped(clip, "wanted.mp4", state / "clip.recipe.json"))
    )
    assert len(made) == 16
    for one, other in zip(made, wanted, strict=True):
        np.testing.assert_array_equal(one.to_ndarray(), other.to_ndarray())
    area = AREA[0], AREA[1] - BAR
    assert on_canvas(made[8].to_ndarray(format="rgb24"), seen, area, recipe.strokes) < 6
    assert on_canvas(decoded(clip)[8].to_ndarray(format="rgb24"), seen, area, recipe.strokes) > 10


def rendering(mouse: Mouse) -> None:
    """Give it the whole canvas."""
    four = mouse.shown()
    mouse.do("key", "4")
    wait_for(lambda: near(mouse.shown(), four, np.s_[: AREA[1], : AREA[0]]) > 10)
    mouse.settled()


@effort.soak("the rendering of a volume on a screen, which others have in planes, and without a screen")
def test_a_volume_by_a_real_pointer(gpu: Gpu, volume: Path, state: Path) -> None:
    seen, recipe = edited(volume, "head", "head-bent.nii.gz", rendering, 1.5)
    assert all(np.linalg.norm(stroke.by) > 2 for stroke in recipe.strokes)
    saved = state / "head.recipe.json"
    made, wanted = (
        sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
        for path in (state / "head-bent.nii.gz", warped(volume, "wanted.nii.gz", saved))
    )
    np.testing.assert_array_equal(made, wanted)
    # The same camera sees the same: of what was exported, of the volume through its recipe, and on the canvas.
    look = as_in_a_window(volume, *AREA)
    pictures = {}
    for name, what in {
        "bent": [str(state / "head-bent.nii.gz")],
        "seen": [str(volume), "--recipe", str(saved)],
        "plain": [str(volume)],
    }.items():
        assert command(["render", what[0], str(state / f"{name}.png"), *what[1:], *look]) == 0
        pictures[name] = image.read(state / f"{name}.png").pixels[..., :3]
    canvas, free = seen[: AREA[1], : AREA[0]], np.s_[30 : AREA[1] - 110]  # of the button, the axes and the scale bar
    assert near(canvas, pictures["seen"], free) < 4
    assert near(canvas, pictures["bent"], free) < 4
    assert near(canvas, pictures["plain"], free) > 3
