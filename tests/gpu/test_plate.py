"""What a window draws, against the CPU: pictures through strokes, enlarged, reduced, and in a ring of frames."""

from __future__ import annotations

import numpy as np
import pytest

import supple
from supple.gpu.device import Gpu
from supple.gpu.plate import OVERLAYS, Plate, Sight
from supple.gpu.screen import canvas_texture, pixels_of
from tests.gpu.scenes import ball

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning", "ignore::supple.MissWarning")

SHAPE = (90, 120)


@pytest.fixture
def photo() -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    waves = [127 + 100 * np.sin(x / a) * np.cos(y / b) for a, b in ((9, 14), (15, 8), (20, 20))]
    return np.dstack([*waves, np.full(SHAPE, 255.0)]).astype(np.uint8)


def drawn(gpu: Gpu, photo: np.ndarray, d: supple.Deformation, sight: Sight) -> np.ndarray:
    plate = Plate(gpu, photo.shape[1::-1])
    plate.put(0, photo)
    texture = canvas_texture(gpu, sight.size)
    plate.draw(sight, d.space.table, d.space.axes, texture)
    return pixels_of(gpu, texture).astype(int)


@pytest.mark.parametrize("border", [None, 20.0])
@pytest.mark.parametrize("solved", [True, False])
def test_pixel_for_pixel_it_is_the_warp(gpu: Gpu, photo: np.ndarray, border: float | None, solved: bool) -> None:
    d = (
        supple.Deformation(SHAPE, border=border, on_fold="damp")
        .grab((60, 45), by=(9, -6), radius=20, reach=None)
        .grab((40, 30), by=(-4, 3), radius=15, reach=None)
    )
    seen = drawn(gpu, photo, d, Sight((0.0, 0.0), 1.0, SHAPE[::-1], solved=solved))
    wanted = d.warp(photo[..., :3], filter="linear").astype(int)
    apart = np.abs(seen[..., :3] - wanted)
    assert np.quantile(apart, 0.98) <= (5 if solved else 12)
    assert np.abs(wanted - photo[..., :3]).max() > 60


@pytest.mark.parametrize("held", [False, True])
def test_frames_are_bent_in_time(gpu: Gpu, photo: np.ndarray, held: bool) -> None:
    """Strokes with a time, on axes of which two are space: pixels are those of other frames, too."""
    frames = np.stack([np.roll(photo, 4 * k, axis=1) for k in range(5)])
    freeze = supple.Freeze.of(ball(SHAPE, 0.35, 18), width=7.0) if held else None
    d = supple.Deformation(frames.shape[:3], border=None, time=True, freeze=freeze)
    d = d.grab((66, 45, 2), by=(7, -5, 0.9), radius=22, reach=None)
    d = d.twist((50, 60, 2), angle=30, radius=12, axis=(0, 0, 1))
    plate, texture = Plate(gpu, SHAPE[::-1], 5, 5), canvas_texture(gpu, SHAPE[::-1])
    for k, frame in enumerate(frames):
        plate.put(k, frame)
    wanted = d.warp(frames[..., :3], filter="linear", between="linear").astype(int)
    for k in (1, 3):
        plate.draw(Sight((0.0, 0.0), 1.0, SHAPE[::-1], k), d.space.table, d.space.axes, texture, freeze=d.space.freeze)
        seen = pixels_of(gpu, texture).astype(int)[..., :3]
        assert np.quantile(np.abs(seen - wanted[k]), 0.98) <= 5
        assert np.abs(wanted[k] - frames[k, ..., :3]).max() > 60
    assert np.abs(d.inverse((66, 45, 2)).points - (66, 45, 2))[2] > 0.3


@pytest.mark.parametrize(("origin", "scale"), [((10.5, 7.25), 0.25), ((-20.0, -8.0), 1.7), ((0.5, 0.5), 2.0)])
def test_parts_enlarged_and_reduced(gpu: Gpu, photo: np.ndarray, origin: tuple[float, float], scale: float) -> None:
    d = supple.Deformation(SHAPE, border=None, on_fold="damp").grab((60, 45), by=(9, -6), radius=20, reach=None)
    seen = drawn(gpu, photo, d, Sight(origin, scale, (48, 40)))
    # The mean of the warp over what each pixel of the window covers.
    fine = 8
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    x = origin[0] + scale * (np.arange(48)[:, None] + offsets).ravel()
    y = origin[1] + scale * (np.arange(40)[:, None] + offsets).ravel()
    grid = np.stack(np.meshgrid(x, y), -1)
    sources = d.inverse(grid).points.reshape(-1, 2)
    from scipy import ndimage

    wanted = np.stack(
        [
            ndimage.map_coordinates(photo[..., c].astype(float), sources.T[::-1], order=1, mode="nearest")
            for c in range(3)
        ],
        -1,
    ).reshape(40, fine, 48, fine, 3)
    inside = ((grid >= -0.5) & (grid <= np.array(SHAPE[::-1]) - 0.5)).all(-1).reshape(40, fine, 48, fine)
    whole = inside.all(axis=(1, 3))
    apart = np.abs(seen[..., :3] - wanted.mean(axis=(1, 3)))[whole]
    assert whole.sum() > 300
    assert np.quantile(apart, 0.95) < 8
    back = np.round(255 * np.array([0.12, 0.12, 0.13]))
    nothing = ~inside.any(axis=(1, 3))
    if nothing.any():
        assert np.abs(seen[..., :3] - back)[nothing].max() <= 3


def test_what_is_transparent_lies_on_a_ground(gpu: Gpu, photo: np.ndarray) -> None:
    clear = photo.copy()
    clear[:, 60:, 3] = 0
    clear[:, 60:, :3] = 255  # which is not seen
    seen = drawn(gpu, clear, supple.Deformation(SHAPE, border=64, on_fold="damp"), Sight((0.0, 0.0), 1.0, SHAPE[::-1]))
    assert set(np.unique(seen[8:80, 64:110, :3])) <= {107, 148}
    assert (seen[..., 3] == 255).all()


@pytest.mark.parametrize("overlay", [name for name in OVERLAYS if name])
def test_overlays_show_what_the_map_does(gpu: Gpu, photo: np.ndarray, overlay: str) -> None:
    d = supple.Deformation(SHAPE, border=None, on_fold="damp").grab((60, 45), by=(14, 0), radius=20, reach=None)
    plain, over = (
        drawn(gpu, photo, d, Sight((0.0, 0.0), 1.0, SHAPE[::-1], overlay=name))[..., :3] for name in ("", overlay)
    )
    assert np.abs(plain - over).max() > 40


def test_a_ring_of_frames(gpu: Gpu, photo: np.ndarray) -> None:
    frames = [np.roll(photo, 5 * k, axis=1) for k in range(9)]
    plate = Plate(gpu, SHAPE[::-1], 9, 3)
    texture = canvas_texture(gpu, SHAPE[::-1])
    d = supple.Deformation((9, *SHAPE), border=64, on_fold="damp")

    def seen(time: float) -> np.ndarray:
        plate.draw(Sight((0.0, 0.0), 1.0, SHAPE[::-1], time), d.space.table, d.space.axes, texture)
        return pixels_of(gpu, texture).astype(int)

    for k in (0, 1, 2, 3, 4):
        plate.put(k, frames[k])
    assert (plate.earliest, plate.held) == (2, 3)
    for k in (2, 3, 4):
        assert np.abs(seen(k) - frames[k]).max() <= 1
    between = (frames[2].astype(int) + frames[3]) / 2
    assert np.abs(seen(2.5) - between).max() <= 1
    plate.put(7, frames[7])  # elsewhere: it begins anew
    assert (plate.earliest, plate.held) == (7, 1)
    assert np.abs(seen(7) - frames[7]).max() <= 1
    with pytest.raises(MemoryError, match="more than a shader takes"):
        Plate(gpu, (1 << 15, 1 << 14))
