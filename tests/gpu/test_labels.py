"""Labels and volumes of colours, rendered by the GPU as by the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from supple.errors import DeviceWarning
from supple.gpu.device import Gpu
from supple.render.labels import LabelColours
from supple.render.scene import Scene
from tests.gpu.scenes import apart, pair

pytest.importorskip("SimpleITK")  # by which these are tested on the CPU
from tests.render.test_labels import CAMERA, GEOMETRY, OPAQUE, bent, colours_of, cube, regions, table_colours, two

SIZE = (30, 30)
MIXED = LabelColours({1: (1, 0, 0, 1), 2: (0, 1, 0, 0.1), 3: (0, 0, 1, 0.4)})


@pytest.mark.parametrize("mode", ["hybrid", "buffered"])
def test_labels_are_as_the_cpu_renders_them(gpu: Gpu, mode: str) -> None:
    for samples, transfer in ((two(), "labels"), (regions(), MIXED)):
        scenes = pair(samples, GEOMETRY, transfer=transfer, deformation=bent(), mode=mode)
        assert scenes[1].gpu is not None
        assert apart(*(scene.render(CAMERA, SIZE) for scene in scenes)) > 30
    flat = Scene(two(), GEOMETRY, transfer="labels", device="gpu", shaded=False, deformation=bent(), mode=mode)
    assert colours_of(flat.render(CAMERA, SIZE)) == table_colours(LabelColours(), [1, 3])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colours_are_as_the_cpu_renders_them(gpu: Gpu, dtype: Any) -> None:
    samples, _ = cube(dtype, 4)
    options: dict[str, Any] = {"transfer": "grey", "deformation": bent(), "mode": "hybrid"}
    scenes = pair(samples, GEOMETRY, **options)
    assert scenes[1].gpu is not None
    assert scenes[1].fill() == 1.0
    assert apart(*(scene.render(CAMERA, SIZE) for scene in scenes)) > 40


def test_a_buffer_of_colours_is_left_to_the_cpu(gpu: Gpu) -> None:
    options: dict[str, Any] = {"transfer": OPAQUE, "deformation": bent(), "mode": "buffered"}
    with pytest.warns(DeviceWarning, match="no room for a buffer of colours"):
        scene = Scene(cube(np.uint8)[0], GEOMETRY, device="gpu", **options)
    wanted = Scene(cube(np.uint8)[0], GEOMETRY, **options)
    np.testing.assert_array_equal(scene.render(CAMERA, SIZE).light, wanted.render(CAMERA, SIZE).light)


def test_more_labels_than_a_row_of_a_texture_have_their_colours(gpu: Gpu) -> None:
    labels = np.zeros((24, 20, 24), np.int32)
    labels[2:22, 2:18, 2:22] = np.arange(1, 20 * 16 * 20 + 1).reshape(20, 16, 20)[::-1]  # 6400, and those above
    labels[2:22, 2:18, 12:22] += 9000
    scenes = [Scene(labels, transfer="labels", device=d, shaded=False) for d in ("gpu", "cpu")]
    assert scenes[0].labels is not None
    assert len(scenes[0].labels) > 6000
    assert apart(*(scene.render(CAMERA, SIZE) for scene in scenes)) > 25
