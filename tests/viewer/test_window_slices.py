"""The four views of a volume, by a real pointer on a real screen."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.media import volume as volumes
from supple.viewer.panels.slices import first_window, turned
from supple.viewer.panels.view import LINE, WIDE
from supple.viewer.tools.volumes import VolumeTools
from supple.viewer.window.launch import SIZE
from tests.effort import soak
from tests.viewer.sessions import near, recipe_in, warped
from tests.viewer.windows import Pixels, a_screen, viewing, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")
pytest.importorskip("glfw")
AREA = (SIZE[0] - WIDE, SIZE[1] - LINE)


def expected(volume: volumes.Volume) -> VolumeTools:
    """The tools of such a window."""
    from supple.viewer.document.editing import Document

    shape = volume.samples.shape
    document = Document(shape, volume.geometry.spacing, kind="volume", geometry=volume.geometry)
    window = first_window(volume, "")
    return VolumeTools(document, volume.geometry, AREA, lambda x, y: None, lambda pick, to: (0.0, 0.0, 0.0), window)


def greys(seen: Pixels, tools: VolumeTools, samples: np.ndarray, k: int) -> float:
    """How far the greys of a plane on the screen are from its voxels, at their centres, beside what lies over them."""
    pane, (low, high), plane = tools.pane(k), tools.sight.window, tools.planes[k]
    values = turned(np.take(samples, tools.index[plane.axis], axis=2 - plane.axis), plane)
    wanted = np.clip(255 * (values.astype(float) - low) / (high - low), 0, 255)
    left, top, wide, high_ = pane.box
    rows = np.floor(top + (np.arange(values.shape[0]) + 0.5) * high_ / values.shape[0]).astype(int)
    columns = np.floor(left + (np.arange(values.shape[1]) + 0.5) * wide / values.shape[1]).astype(int)
    found = seen[rows][:, columns].astype(float)
    apart = np.abs(found.mean(axis=-1) - wanted)[np.ptp(found, axis=-1) < 6]  # lines have colours
    return float(np.median(apart)) + float(np.percentile(apart, 80))


@soak("planes on a screen, which others have without one, and photographs have by a pointer")
def test_drags_and_the_crosshair_in_all_planes_by_a_real_pointer(gpu: Gpu, volume: Path, state: Path) -> None:
    head = volumes.read(volume)
    tools = expected(head)
    saved, made = state / "head.recipe.json", state / "head-bent.nii.gz"
    wanted = []
    with a_screen(state / "screen") as mouse, viewing(str(volume), folder=state, display=mouse.display):
        plain = mouse.settled()
        for k in range(3):
            left, top, width, height = tools.places[k]
            start = round(left + 0.5 * width) + 12, round(top + 0.5 * height) - 10
            end = start[0] + 26, start[1] - 17
            mouse.drag(start, end)
            mouse.settled()
            pane = tools.pane(k)
            tools.sight = tools.sight.at(pane.to_point(*start), tools.sizes)
            wanted.append((pane.to_point(*start), np.subtract(pane.to_point(*end), pane.to_point(*start))))
        mouse.filed("ctrl+s", saved)
        mouse.filed("ctrl+e", made)
        mouse.do("key", "Escape")
        mouse.do("key", "Escape")
        mouse.do("mousemove", 1100, 780)
        seen, sight = mouse.settled(), tools.sight
        # A click moves the crosshair, the wheel goes to another slice, and a key shows a plane alone.
        left, top, width, height = tools.places[0]
        place = round(left + 0.4 * width), round(top + 0.35 * height)
        point = tools.pane(0).to_point(*place)
        mouse.do("mousemove", *place)
        time.sleep(0.3)
        mouse.do("click", 1)
        mouse.do("click", 4)  # the wheel, forward
        mouse.do("mousemove", 1100, 780)
        crossed = mouse.settled()
        mouse.do("mousemove", *place)
        mouse.do("key", "2")
        mouse.do("mousemove", 1100, 780)
        wait_for(lambda: near(mouse.shown(), crossed) > 10)
        alone = mouse.settled()
    recipe = recipe_in(saved)
    assert len(recipe.strokes) == 3
    for k, (stroke, (at, by)) in enumerate(zip(recipe.strokes, wanted, strict=True)):
        assert stroke.at == pytest.approx(at, abs=1e-6)
        assert stroke.by == pytest.approx(by, abs=1e-6)
        assert stroke.by[tools.planes[k].axis] == 0
    bent = volumes.read(made).samples
    np.testing.assert_array_equal(bent, volumes.read(warped(volume, "wanted.nii.gz", saved)).samples)
    for k in range(3):
        assert greys(plain, expected(head), head.samples, k) < 6
        assert greys(seen, tools, bent, k) < 6
        assert greys(seen, tools, head.samples, k) > 8
    tools.sight = sight.at(point, tools.sizes)
    tools.step(0, 1)
    for k in range(3):
        assert greys(crossed, tools, bent, k) < 6
    tools.enlarge(1)
    assert greys(alone, tools, bent, 1) < 8
