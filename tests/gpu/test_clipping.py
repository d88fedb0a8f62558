"""Boxes of a volume by the GPU, in every mode, against the CPU's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import supple
from supple.gpu.device import Gpu
from supple.render.camera import Camera
from supple.render.scene import MODES
from supple.render.transfer import TransferFunction
from tests.gpu.scenes import GEOMETRY, SIZE, SOFT, apart, pair

SOLID = TransferFunction(((0.0, 1.0, 0.9, 0.8, 0.6),))
CLIPS = (((None, None), (13.5, None), (None, None)), ((5, 21), (None, 22.25), (4, 15)))
CAMERAS = (Camera(azimuth=25, elevation=20), Camera(azimuth=140, elevation=-50, roll=30, field_of_view=50))


@pytest.mark.parametrize("mode", ["plain", *MODES])
@pytest.mark.parametrize("transfer", [SOFT, SOLID], ids=["soft", "solid"])
def test_a_picture_is_the_cpu_s(
    gpu: Gpu, cloud: np.ndarray, bent: supple.Deformation, mode: str, transfer: TransferFunction
) -> None:
    options: dict[str, Any] = {"transfer": transfer, "tolerance": 0.05}
    if mode != "plain":
        options |= {"deformation": bent, "mode": mode}
    ours, theirs = pair(cloud, GEOMETRY, **options)
    for clip, camera in zip(CLIPS, CAMERAS, strict=True):
        one, other = (scene.clipped(clip).render(camera, SIZE) for scene in (ours, theirs))
        assert np.ptp(one.pixels((0.1, 0.2, 0.3))) > 100
        assert apart(one, ours.render(camera, SIZE)) < 30
        assert apart(one, other) > 50
        both = np.isfinite(one.depth) & np.isfinite(other.depth)
        assert np.quantile(abs(one.depth[both] - other.depth[both]), 0.98) < 0.01
        assert (np.isfinite(one.depth) != np.isfinite(other.depth)).mean() < 4e-3
    whole = theirs.render(CAMERAS[0], SIZE)
    for same in (((None, None),) * 3, tuple((0, n - 1) for n in cloud.shape[::-1])):
        np.testing.assert_array_equal(theirs.clipped(same).render(CAMERAS[0], SIZE).light, whole.light)
