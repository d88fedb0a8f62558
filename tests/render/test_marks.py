"""Scale bars and letters of rendered volumes, against bodies of known size and place in their pictures."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple.cli import command
from supple.files.jobs import Job
from supple.files.renders import RenderOptions, render_file
from supple.gpu.device import Gpu
from supple.media import image
from supple.render.annotate import annotated
from supple.render.camera import Bar, Camera, bar_of, sides_of
from supple.render.scene import Scene
from supple.space.geometry import Geometry
from tests.render.scenes import HARD

Array = npt.NDArray[Any]

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
TILT = np.radians(20)
TILTED = np.array([[np.cos(TILT), -np.sin(TILT), 0], [np.sin(TILT), np.cos(TILT), 0], [0, 0, 1]])
GEOMETRIES = {
    "straight": Geometry((1.0, 1.0, 1.0), convention="LPS"),
    "sagittal": Geometry((1.0, 1.0, 1.5), direction=np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0.0]]), convention="RAS"),
    "tilted": Geometry((1.5, 1.0, 1.0), direction=TILTED, convention="LPS"),
}
WAYS = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "S": (0, 0, 1), "I": (0, 0, -1)}


@pytest.fixture
def here(here: Path) -> Path:
    shutil.copy(HEAD, "head.nii.gz")
    return here


def bodies(geometry: Geometry, shape: tuple[int, int, int], inside: Callable[[Array], Array]) -> Scene:
    """The scene of what a function of positions in LPS, relative to the middle, says."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")[::-1], axis=-1)
    middle = geometry.to_lps((np.array(shape[::-1]) - 1) / 2)
    return Scene(inside(geometry.to_lps(index) - middle).astype(np.float32), geometry, transfer=HARD)


def ball(middle: Array, at: Array) -> Array:
    return np.asarray(np.linalg.norm(at - middle, axis=-1) < 4)


@pytest.mark.parametrize("camera", [Camera(), Camera(field_of_view=60, distance=90), Camera(azimuth=90, roll=90)])
def test_a_bar_is_as_long_as_a_rod_of_its_length(camera: Camera) -> None:
    size = (240, 320)
    # A thin sheet across the line of sight through the target, 30 mm wide: what is seen of it is at that distance.
    axis, across = (1, 0) if camera.azimuth == 0 else (0, 2)
    scene = bodies(
        Geometry((1.0, 0.5, 2.0), convention="LPS"),
        (31, 61, 61),
        lambda at: (abs(at[..., axis]) < 0.6) & (abs(at[..., across]) < 15.25),
    )
    _, columns = np.nonzero(scene.render(camera, size).light[..., 3] > 0.5)
    wide = float(np.ptp(columns) + 1)
    bar = bar_of(scene.view(camera, size))
    assert bar.length * wide / 30.5 == pytest.approx(bar.pixels, rel=0.05)
    assert 0.1 * size[1] < bar.pixels <= 0.25 * size[1] + 1e-6


@pytest.mark.parametrize("spacing", [1e-6, 3e-4, 0.02, 0.7, 1.0, 4.0, 90.0])
def test_lengths_are_round_and_have_a_unit(spacing: float) -> None:
    scene = Scene(np.arange(8.0).reshape(2, 2, 2), Geometry((spacing,) * 3))
    for columns in (100, 333, 1000):
        bar = bar_of(scene.view(Camera(), (120, columns)))
        value, unit = bar.label.split()
        assert float(value) * {"m": 1000, "mm": 1, "µm": 1e-3, "nm": 1e-6}[unit] == pytest.approx(bar.length)
        assert f"{bar.length:.6e}"[0] in "125"
        assert 0.09 * columns < bar.pixels < 0.2501 * columns
    assert [Bar(n, 1).label for n in (1000.0, 500.0, 1.0, 0.5, 2e-6)] == ["1 m", "500 mm", "1 mm", "500 µm", "2 nm"]


@pytest.mark.parametrize("name", GEOMETRIES)
def test_each_letter_is_where_a_ball_at_that_side_of_the_patient_is_seen(name: str) -> None:
    geometry, size = GEOMETRIES[name], (60, 60)
    balls = {
        letter: bodies(geometry, (40, 40, 40), partial(ball, np.multiply(way, 12))) for letter, way in WAYS.items()
    }
    views = [(0, 0), (90, 0), (180, 0), (0, 90), (0, -90), (38, 12), (-130, -50)]
    for (azimuth, elevation), roll in itertools.product(views, (0, 33)):
        camera = Camera(azimuth, elevation, roll=roll)
        named = sides_of(balls["L"].view(camera, size), geometry)
        assert all(named)
        for letter, scene in balls.items():
            light = scene.render(camera, size).light[..., 3]
            y, x = (float((light * at).sum() / light.sum()) - 29.5 for at in np.mgrid[:60, :60])
            reach = {0: -x, 1: x, 2: -y, 3: y}
            # 12 mm are 7 pixels or so: those that go there by a third of that are named, and none that goes elsewhere.
            for k, pixels in reach.items():
                assert letter in named[k] or pixels < 3, (letter, named, reach)
                assert letter not in named[k] or pixels > 1, (letter, named, reach)


def test_the_nearest_side_comes_first_and_voxels_have_axes() -> None:
    straight = GEOMETRIES["straight"]
    scene = Scene(np.arange(8.0).reshape(2, 2, 2), straight)

    def seen(camera: Camera, geometry: Geometry = straight) -> tuple[str, ...]:
        return sides_of(scene.view(camera, (100, 100)), geometry)

    assert seen(Camera()) == ("R", "L", "S", "I")
    assert seen(Camera(azimuth=180)) == ("L", "R", "S", "I")
    assert seen(Camera(azimuth=180, elevation=90)) == ("L", "R", "A", "P")
    assert seen(Camera(azimuth=30)) == ("RA", "LP", "S", "I")
    assert seen(Camera(azimuth=60)) == ("AR", "PL", "S", "I")
    assert seen(Camera(azimuth=10)) == ("R", "L", "S", "I")
    assert seen(Camera(azimuth=30), Geometry()) == ("-x-y", "+x+y", "+z", "-z")


@pytest.mark.parametrize("background", [None, (0.2, 0.5, 0.3)])
def test_marks_are_drawn_over_what_is_there(background: tuple[float, float, float] | None) -> None:
    scene, camera, size = Scene(np.zeros((9, 9, 9), np.uint8), GEOMETRIES["straight"]), Camera(), (201, 303)
    view = scene.view(camera, size)
    plain = scene.render(camera, size).pixels(background)
    kept = plain.copy()
    made = annotated(plain, view, scene.geometry)
    np.testing.assert_array_equal(plain, kept)
    assert made.shape == plain.shape
    changed = (made != plain).any(axis=-1)
    assert 0.005 < changed.mean() < 0.08
    assert changed[0].sum() == changed[:, 0].sum() == 0  # nothing touches an edge
    assert changed[-1].sum() == changed[:, -1].sum() == 0
    thirds = [changed[i : i + 67, j : j + 101].any() for i in (0, 67, 134) for j in (0, 101, 202)]
    assert thirds == [False, True, False, True, False, True, True, True, False]
    # The longest white row of the lower left is the bar.
    white = (made[-40:, :150, :3] == 255).all(axis=-1)
    assert abs(white.sum(axis=1).max() - bar_of(view).pixels) <= 1.5
    if background is None:
        assert set(np.unique(made[changed][:, 3])) > {255}
        outline = made[(made[..., 3] > 0) & (made[..., 3] < 128)]
        assert outline[:, :3].max() < 60  # of the outline's colour, as far as it is seen


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_a_file_with_marks(here: Path, gpu: Gpu, device: str) -> None:
    given = ["render", "head.nii.gz", "--size", "150x121", "--azimuth", "38", "--device", device]
    assert command([*given[:2], "plain.png", *given[2:]]) == 0
    assert command([*given[:2], "marked.png", *given[2:], "--annotate"]) == 0
    plain, marked = (image.read(f"{name}.png").pixels for name in ("plain", "marked"))
    camera, size = Camera(azimuth=38), (121, 150)
    known = RenderOptions(camera=camera, size=size, annotate=True, device=device)
    scene = render_file(Job("head.nii.gz", "python.png"), options=known)
    np.testing.assert_array_equal(image.read("python.png").pixels, marked)
    view = scene.view(scene.framed(camera, size), size)
    np.testing.assert_array_equal(marked, annotated(plain, view, scene.geometry))
    assert marked.shape == (121, 150, 4)
    assert (marked != plain).any()


BAD = [
    (["out.png", "--size", "200x95"], "--annotate needs a picture of 96 pixels or more along both sides, found 200x95"),
    (["out.mp4", "--turntable", "3", "--size", "60x60"], "found 60x60"),
    (["out.png", "--what", "inversions"], "leave annotate out"),
]


@pytest.mark.parametrize(("arguments", "told"), BAD)
def test_what_cannot_be_marked(here: Path, arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["render", "head.nii.gz", *arguments, "--annotate"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error
    assert [path.name for path in here.iterdir()] == ["head.nii.gz"]


def test_pixels_that_do_not_fit() -> None:
    scene = Scene(np.zeros((9, 9, 9), np.uint8))
    view = scene.view(Camera(), (100, 120))
    bad: list[Array] = [np.zeros((100, 120), np.uint8), np.zeros((120, 100, 3), np.uint8), np.zeros((100, 120, 3))]
    for pixels in bad:
        with pytest.raises(supple.SuppleError, match=r"pixels must be uint8 of shape \(100, 120, 3 or 4\)"):
            annotated(pixels, view, scene.geometry)
