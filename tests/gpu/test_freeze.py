"""What is frozen, drawn by the GPU: renderings, voxels, and the window."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import Freeze
from supple.errors import DeviceWarning
from supple.gpu import field, solid
from supple.gpu.device import Gpu
from supple.gpu.plate import Plate, Sight
from supple.gpu.screen import canvas_texture, pixels_of
from supple.render.camera import Camera
from supple.render.scene import MODES, Scene
from tests.gpu.scenes import GEOMETRY, SHAPE, SOFT, apart, ball, frozen, pair, size_of, texels_of

pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning", "ignore::supple.FoldWarning")


def bent_cloud(radius: float) -> supple.Deformation:
    mask = Freeze.of(ball(SHAPE, (0.5, 0.35, 0.4), radius), width=14.0, spacing=GEOMETRY.spacing)
    d = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, freeze=mask)
    return d.grab((16, 16, 11), by=(-1.6, -1.2, 0.5), radius=12, reach=None)


def test_a_mask_that_does_not_fit_is_the_cpu_s(gpu: Gpu, cloud: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    d = bent_cloud(5)
    monkeypatch.setattr(gpu, "binding", 600)
    with pytest.raises(MemoryError, match="MB of a freeze mask are more than a shader takes"):
        field.packed_mask(gpu, d.space.freeze)
    with pytest.warns(DeviceWarning, match="of a freeze mask"):
        scene = Scene(cloud, GEOMETRY, deformation=d, transfer=SOFT, mode="exact", device="gpu")
    assert scene.gpu is None


@pytest.mark.parametrize("mode", MODES)
def test_a_rendering_is_the_cpu_s(gpu: Gpu, cloud: np.ndarray, mode: str) -> None:
    options: dict[str, Any] = {"transfer": SOFT, "mode": mode, "tolerance": 0.1}
    d, free, camera = bent_cloud(5), bent_cloud(0), Camera(azimuth=25, elevation=20)
    ours, theirs = pair(cloud, GEOMETRY, deformation=d, **options)
    one, other, third = (scene.render(camera, size_of(mode)) for scene in (ours, theirs, theirs.deformed(free)))
    assert apart(one, other) > 50
    assert apart(other, third) < 45


def test_frozen_voxels_are_those_of_the_volume(gpu: Gpu, cloud: np.ndarray) -> None:
    d = bent_cloud(5)
    space, held_ = d.space, solid.hold(gpu, cloud)
    assert solid.beside(held_)
    strokes = solid.hold_strokes(gpu, space.table, space.axes, space.freeze)
    assert solid.Filling(held_, strokes, 0.01).advance(60.0) == 1.0
    found = texels_of(gpu, held_.warped)
    still = ball(SHAPE, (0.5, 0.35, 0.4), 5)
    np.testing.assert_array_equal(found[still], cloud[still])
    away = np.abs(found - d.warp(cloud, filter="linear", tolerance=1e-3))
    assert away.max() < 0.02
    assert np.abs(found - cloud).max() > 0.1


@pytest.mark.parametrize("solved", [True, False])
def test_a_window_shows_what_is_frozen_as_it_is(gpu: Gpu, solved: bool) -> None:
    shape = (90, 120)
    y, x = np.mgrid[: shape[0], : shape[1]]
    waves = [127 + 100 * np.sin(x / a) * np.cos(y / b) for a, b in ((9, 14), (15, 8), (20, 20))]
    photo = np.dstack([*waves, np.full(shape, 255.0)]).astype(np.uint8)
    d, plate = frozen(shape), Plate(gpu, shape[::-1])
    plate.put(0, photo)
    texture, space = canvas_texture(gpu, shape[::-1]), d.space
    sight = Sight((0.0, 0.0), 1.0, shape[::-1], solved=solved)

    def seen(freeze: Any) -> npt.NDArray[np.int64]:
        plate.draw(sight, space.table, space.axes, texture, freeze=freeze)
        return pixels_of(gpu, texture).astype(int)[..., :3]

    for _ in range(2):  # the mask is told apart from none
        made, mask = seen(space.freeze), ball(shape, 0.35, 0.2 * min(shape))
        assert np.abs(made - photo[..., :3])[mask].max() <= 1
        # Also while it is dragged, what is beside it is solved.
        away = np.abs(made - d.warp(photo[..., :3], filter="linear"))[~mask]
        assert np.quantile(away, 0.98) <= 5
        assert np.abs(seen(None) - photo[..., :3])[mask].max() > 20
