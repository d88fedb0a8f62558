"""Brushes on a volume in a window: what is exported is what the command line makes of the recipe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from supple.cli import command
from supple.gpu.device import Gpu
from supple.media import image
from tests.viewer.sessions import near, recipe_in, warped
from tests.viewer.windows import as_in_a_window, opened, wait_for


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
