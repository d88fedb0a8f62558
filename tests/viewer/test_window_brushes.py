"""All brushes in a window: what is exported is what the command line makes of the recipe."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.cli import command
from supple.gpu.device import Gpu
from supple.media import image
from supple.viewer.panels.overlay import status
from tests.viewer.sessions import near, recipe_in, warped
from tests.viewer.windows import Hand, as_in_a_window, opened, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")


def both(view: Any, source: Path, name: str) -> tuple[Path, Path]:
    """What the window exports, and what the command line makes of its recipe."""
    folder, target = source.parent, source.with_name("bent" + "".join(source.suffixes))
    view.commands.save(folder / "strokes.json")
    view.commands.begin_export(target)
    wait_for(lambda: view.commands.export.done)
    view.commands.tick()
    assert "saved" in view.commands.message
    assert recipe_in(folder / "strokes.json") == view.recipe
    return target, warped(source, name, folder / "strokes.json")


def while_dragging(view: Any, hand: Hand, way: tuple[tuple[float, float], tuple[float, float]]) -> str:
    """The status line before the button is released."""
    start, end = way
    hand.move(*start)
    hand.press(*start)
    hand.move(*end, 1)
    said = status(view)
    hand.release(*end)
    hand.canvas.draw()
    return said


def test_a_picture_bent_by_all_brushes(gpu: Gpu, photo: Path) -> None:
    view, hand = opened(photo)
    hand.key("1")
    said = {}
    for key, x in {"t": 120, "w": 220, "p": 320, "n": 420}.items():
        view.tools.radius = 40
        hand.key(key)
        said[key] = while_dragging(view, hand, ((x, 250), (x + 30, 260)))
    hand.key("f")
    hand.draw((200, 400), (230, 400), (250, 380), (250, 350))
    strokes = view.recipe.strokes
    assert [stroke.brush for stroke in strokes] == ["twist", "scale", "scale", "pinch", "grab"]
    assert len(strokes[-1].path) == 2
    for key in "rs":
        hand.key(key)
        said[key] = while_dragging(view, hand, ((130, 250), (180, 260)))
    assert re.search(r"restore: \d places", said["r"])
    names = [stroke.name for stroke in view.recipe.strokes]
    assert (names.count("restore"), names.count("smooth")) == (1, 1)
    assert "Twist by 67.5\u00b0" in said["t"]
    assert "Bloat by a factor of 1.4" in said["w"]
    assert "Pucker by a factor of 0.6" in said["p"]
    assert "Pinch by a factor of 0.6" in said["n"]
    hand.key("m")
    hand.key("g")
    hand.drag((200, 480), (220, 470))
    hand.key("m")
    hand.key("d")
    hand.drag((300, 440), (310, 450))
    hand.move(260, 470)
    hand.press(260, 470)
    hand.release(260, 470)
    assert len(view.recipe.strokes[-1].also) == 3
    assert sum(not any(by) for _, by in view.recipe.strokes[-1].handles) == 1
    for i in range(len(view.document.strokes)):
        view.document.select(i)
        hand.canvas.draw()  # the panel shows each by its numbers
    bent, wanted = both(view, photo, "wanted.png")
    np.testing.assert_array_equal(image.read(bent).pixels, image.read(wanted).pixels)
    assert np.abs(image.read(bent).pixels.astype(int) - image.read(photo).pixels).mean() > 2


def test_a_volume_is_twisted_in_a_plane_and_on_the_object(gpu: Gpu, volume: Path) -> None:
    import SimpleITK as sitk  # noqa: N813

    view, hand = opened(volume)
    hand.key("t")
    hand.drag((160, 150), (180, 150))
    left, top, width, height = view.tools.places[3]
    x, y = left + width / 2 + 30, top + height / 2 + 30  # not on the first one's handle
    hand.drag((x, y), (x + 15, y))
    one, other = view.recipe.strokes
    assert np.flatnonzero(one.axis).tolist() == [2]
    assert np.argmax(np.abs(other.axis)) == 1  # seen from the front
    assert float(one.angle) > 5 < float(other.angle)
    paths = both(view, volume, "wanted.nii.gz")
    made, wanted = (sitk.GetArrayFromImage(sitk.ReadImage(str(path))) for path in paths)
    np.testing.assert_array_equal(made, wanted)


def test_the_rendering_is_what_the_command_line_makes(gpu: Gpu, volume: Path) -> None:
    view, hand = opened(volume, size=(660, 424))
    view.tools.radius *= 1.5
    hand.key("4")
    width, height = (round(n) for n in view.area)
    hand.drag((width / 2 - 20, height / 2), (width / 2 + 20, height / 2 - 30))
    both(view, volume, "wanted.nii.gz")
    seen, look = view.pixels(), as_in_a_window(volume, width, height)
    for name, options, near_it in (
        ("bent", ["--recipe", str(volume.with_name("strokes.json"))], True),
        ("plain", [], False),
    ):
        target = volume.with_name(f"{name}.png")
        assert command(["render", str(volume), str(target), *options, *look]) == 0
        assert (near(seen, image.read(target).pixels[..., :3]) < 4) == near_it
