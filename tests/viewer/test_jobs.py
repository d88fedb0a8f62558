"""Five jobs that people have, done by a hand at a window, each within a minute of its time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from supple.deformation import Deformation
from supple.gpu.device import Gpu
from supple.media import image
from supple.media import volume as volumes
from supple.strokes import Recipe
from supple.viewer.document.editing import Document
from supple.viewer.panels.slices import first_window
from supple.viewer.panels.view import LINE, WIDE
from supple.viewer.tools.brushes import GRIP, ZOOM
from supple.viewer.tools.drawing import GROWTH
from supple.viewer.tools.viewport import Viewport
from supple.viewer.tools.volumes import VolumeTools
from supple.viewer.window.launch import SIZE
from tests.viewer.sessions import DATA, recipe_in, warped
from tests.viewer.windows import Hand, opened, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")
AREA = (SIZE[0] - WIDE, SIZE[1] - LINE)
CLICK, DRAG = 1.0, 2.0  # seconds of a hand: a click, a key or a turn of the wheel; a drag
Pair = tuple[float, float]

EYES = (204.0, 101.0), (247.0, 103.0)
NOSE, MOUTH, CHIN = (226.0, 129.0), ((206.0, 141.0), (244.0, 141.0)), (226.0, 176.0)
CHEEKS = (184.0, 145.0), (264.0, 145.0)
FACE = (
    ((205.0, 95.0), (245.0, 95.0)),
    ((192.0, 120.0), (258.0, 120.0)),
    ((192.0, 145.0), (256.0, 145.0)),
    ((212.0, 166.0), (238.0, 166.0)),
)
"""Drags of a brush that goes over a face."""


class Job:
    """A hand at a window, what it does, and how long that takes."""

    def __init__(self, view: Any, hand: Hand, place: Callable[..., Pair]) -> None:
        self.view, self.hand, self.place = view, hand, place
        self.events, self.seconds = 0, 0.0

    def _did(self, seconds: float) -> None:
        self.events += 1
        self.seconds += seconds
        self.hand.canvas.draw()

    def _at(self, *point: float) -> tuple[int, int]:
        x, y = self.place(*point)
        return round(x), round(y)

    def key(self, *keys: str) -> None:
        for key in keys:
            self.hand.key(key)
            self._did(CLICK)

    def click(self, *point: float) -> None:
        self.hand.click(self._at(*point))
        self._did(CLICK)

    def drag(self, start: tuple[float, ...], end: tuple[float, ...]) -> None:
        self.drag_on_canvas(self._at(*start), self._at(*end))

    def drag_on_canvas(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        self.hand.drag(start, end)
        self._did(DRAG)

    def wheel(self, notches: int, at: tuple[float, ...], *held: str) -> None:
        """Turn the wheel by some notches, up above 0, at a point."""
        x, y = self._at(*at)
        self.hand.move(x, y)
        self.hand.modifiers = held
        for _ in range(abs(notches)):
            self.hand.wheel(x, y, -100.0 if notches > 0 else 100.0)
        self.hand.modifiers = ()
        self._did(CLICK)

    def seen(self) -> np.ndarray:
        """What is on the canvas, drawn in full."""
        wait_for(lambda: self.hand.canvas.draw() is not None and self.view.painter.ready, every=0.02)
        self.view._changed_at = -10.0
        return np.asarray(self.hand.canvas.draw())


def pinned(job: Job, *points: tuple[float, ...]) -> None:
    """Hold what must stay: by pins of the stroke that is selected."""
    job.key("d")
    for point in points:
        job.click(*point)


def done(source: Path, target: str, place: Callable[..., Pair], work: Callable[[Job], None]) -> tuple[Recipe, Path]:
    """Do a job, save and export: the recipe, and what was exported, which is what the command line makes of it."""
    saved, made = source.with_name("job.recipe.json"), source.with_name(target)
    view, hand = opened(source, size=SIZE)
    job = Job(view, hand, place)
    work(job)
    view.commands.save(saved)
    view.commands.begin_export(made)
    assert view.commands.export.join(120)
    view.close()
    print(f"{job.events} events, {job.seconds:.0f} s of a hand")
    assert job.seconds + 4 * CLICK < 60  # two commands, and a question each
    wanted = warped(source, "wanted" + "".join(source.suffixes), saved)
    if source.suffixes[-1] == ".gz":
        np.testing.assert_array_equal(volumes.read(made).samples, volumes.read(wanted).samples)
    else:
        np.testing.assert_array_equal(image.read(made).pixels, image.read(wanted).pixels)
    return recipe_in(saved), made


@pytest.fixture
def portrait(state: Path) -> Path:
    image.write(state / "portrait.png", image.read(DATA / "astronaut.jpg").pixels)
    return state / "portrait.png"


def fitted(width: int, height: int) -> Viewport:
    """Where a picture of a size is at first."""
    return Viewport((width, height), AREA)


def moves(recipe: Recipe, *points: Pair, shape: tuple[int, int] = (512, 512)) -> np.ndarray:
    """How far points of a picture move, of the portrait if it is not told."""
    found: np.ndarray = Deformation.from_recipe(recipe, shape).forward(np.array(points)) - points
    return found


def notches(now: float, wanted: float) -> int:
    """Notches of the wheel from a radius to another."""
    return round(math.log(wanted / now) / math.log(GROWTH))


def test_both_cheeks_are_slimmed_alike(gpu: Gpu, portrait: Path) -> None:
    view = fitted(512, 512)

    def work(job: Job) -> None:
        middle, wanted = (view.to_canvas(x, 0)[0] for x in (255.5, 224.0))
        height = round(AREA[1] - GRIP)
        job.key("m")
        job.drag_on_canvas((round(middle), height), (round(wanted), height))  # to the middle of the face
        job.wheel(notches(64, 24), CHEEKS[0])
        job.drag(CHEEKS[0], (CHEEKS[0][0] + 6, CHEEKS[0][1]))

    recipe, _ = done(portrait, "portrait-bent.png", view.to_canvas, work)
    (stroke,) = recipe.strokes
    (at, by), (other, back) = stroke.handles
    middle = (at[0] + other[0]) / 2
    assert middle == pytest.approx(224, abs=0.5)
    assert back == pytest.approx((-by[0], by[1]))
    left, right = moves(recipe, at, other)
    assert left == pytest.approx((6, 0), abs=0.7)
    assert right == pytest.approx((-left[0], left[1]), abs=1e-3)
    # All of it is symmetric; what is in the middle stays, and so do the eyes, to a pixel and a half.
    some = [(x, y) for x in (195.0, 205.0, 215.0) for y in (90.0, 120.0, 150.0)]
    one, image_ = moves(recipe, *some), moves(recipe, *[(2 * middle - x, y) for x, y in some])
    np.testing.assert_allclose(image_, one * (-1, 1), atol=1e-3)
    assert np.abs(moves(recipe, NOSE, CHIN)[:, 0]).max() < 0.4
    assert np.linalg.norm(moves(recipe, *EYES), axis=-1).max() < 1.5


def test_both_eyes_are_opened(gpu: Gpu, portrait: Path) -> None:
    before = fitted(512, 512)
    x, y = (round(v) for v in before.to_canvas(*NOSE))
    near = before.zoom_about(x, y, ZOOM**5)

    def work(job: Job) -> None:
        job.place = before.to_canvas
        job.wheel(5, NOSE, "Control")
        job.place = near.to_canvas
        job.key("w")
        job.wheel(notches(64, 11), NOSE)
        for eye in EYES:
            job.drag(eye, (eye[0] + 5, eye[1]))

    recipe, _ = done(portrait, "portrait-bent.png", near.to_canvas, work)
    assert [stroke.brush for stroke in recipe.strokes] == ["scale", "scale"]
    for x, y in EYES:
        stays, above, below = moves(recipe, (x, y), (x, y - 3.5), (x, y + 3.5))
        assert np.linalg.norm(stays) < 0.6  # a hand does not hit the pupil by less
        assert 1.12 < (7 + below[1] - above[1]) / 7 < 1.35
    assert np.linalg.norm(moves(recipe, NOSE, *MOUTH), axis=-1).max() < 0.8


SAG, BOW = 10.0, 7.0
HORIZON, JAMB = 150.0, 380.0
LINTEL = (JAMB, 190.0), (JAMB + 70, 190.0)
COLUMNS, ROWS = np.arange(70, 490, 10), np.arange(205, 340, 5)


def crooked(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A house before the sky: its horizon sags, and its door is bowed."""
    low = HORIZON + SAG * (1 - ((x - 280) / 280) ** 2)
    left = JAMB + BOW * np.sin(np.pi * np.clip((y - 190) / 160, 0, 1))
    sky, ground, door = (np.array(c, float) for c in ((150, 190, 235), (120, 130, 90), (70, 40, 30)))
    grass = 10 * (np.sin(x / 9) * np.sin(y / 7))[..., None] * (1, 1, 0)
    seen = np.where((y < low)[..., None], sky, ground + grass)
    return np.where(((x > left) & (x < left + 70) & (y > 190) & (y < 350))[..., None], door, seen)


def edges(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The height of the horizon in columns, and both edges of the door in rows, to a part of a pixel."""
    grey = pixels[..., -1].astype(float)
    horizon = [100 + np.clip((grey[100:180, x] - 90) / 145, 0, 1).sum() - 0.5 for x in COLUMNS]
    left = [350 + np.clip((grey[y, 350:415] - 30) / 60, 0, 1).sum() - 0.5 for y in ROWS]
    right = [415 + np.clip((90 - grey[y, 415:490]) / 60, 0, 1).sum() - 0.5 for y in ROWS]
    return np.array(horizon), np.array(left), np.array(right)


def test_a_horizon_and_a_door_are_straightened(gpu: Gpu, state: Path) -> None:
    y, x = np.indices((380, 560)).astype(float)
    fine = np.mean([crooked(x + a, y + b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)], axis=0)
    source = state / "house.png"
    image.write(source, np.round(fine).astype(np.uint8))
    view = fitted(560, 380)

    def found(job: Job, part: int) -> Callable[[int], float]:
        """What an eye sees, which no thin lines of the window confuse: where the horizon, or the door, is now."""
        job.hand.move(1100, 780)
        places, seen = (COLUMNS, ROWS, ROWS)[part], job.seen()
        across, down = (np.array([round(view.to_canvas(k, k)[n]) for k in range(m)]) for n, m in enumerate((560, 380)))
        blue = ndimage.median_filter(seen[down][:, across, 2:3], (5, 5, 1))
        return lambda at: float(np.interp(at, places, edges(blue)[part]))

    def straight(job: Job, *places: int, at: float, part: int) -> None:
        """Drag points of a line to where it should be."""
        for place in places:
            now = found(job, part)(place)
            job.drag(*(((place, now), (place, at)) if part == 0 else ((now, place), (at, place))))

    def work(job: Job) -> None:
        job.wheel(notches(380 / 8, 80), (280, 100))
        straight(job, 280, at=HORIZON, part=0)
        pinned(job, *LINTEL)
        straight(job, 170, 380, 450, 80, at=HORIZON, part=0)  # more points of it, which all arrive at once
        job.key("Escape", "g")
        job.wheel(notches(80, 50), (280, 100))
        straight(job, 270, at=JAMB, part=1)
        job.key("d")
        straight(job, 270, at=JAMB + 70, part=2)
        pinned(job, *LINTEL, (JAMB, 350), (JAMB + 70, 350))

    recipe, made = done(source, "house-bent.png", view.to_canvas, work)
    for was, now in zip(edges(image.read(source).pixels), edges(image.read(made).pixels), strict=True):
        assert np.ptp(was) > 4.9
        assert np.ptp(now) < 0.5 * np.ptp(was)
    # The lintel, which was straight, stays so, and where it was.
    assert np.abs(moves(recipe, *LINTEL, (JAMB + 35, 190.0), shape=(380, 560))[:, 1]).max() < 1.2
    assert len(recipe.strokes) == 2


def test_a_face_stays_while_the_background_moves(gpu: Gpu, portrait: Path) -> None:
    wall = 305.0, 110.0

    def work(job: Job) -> None:
        job.key("c")
        job.wheel(notches(64, 24), NOSE)
        for start, end in FACE:
            job.drag(start, end)
        job.key("g")
        job.wheel(notches(24, 64), NOSE)
        job.drag(wall, (wall[0] + 24, wall[1]))

    recipe, made = done(portrait, "portrait-bent.png", fitted(512, 512).to_canvas, work)
    (stroke,) = recipe.strokes
    assert moves(recipe, stroke.at)[0] == pytest.approx((24, 0), abs=0.7)
    face = (*EYES, NOSE, *MOUTH, CHIN, *CHEEKS)
    np.testing.assert_array_equal(moves(recipe, *face), 0)
    assert np.linalg.norm(moves(replace(recipe, freeze=None), *face), axis=-1).max() > 5
    # Every pixel of it keeps every bit.
    frozen = recipe.freeze.shown((512, 512)) == 0
    assert 0.02 < frozen.mean() < 0.12
    np.testing.assert_array_equal(image.read(made).pixels[frozen], image.read(portrait).pixels[frozen])


TUMOUR, RADIUS = (62, 60, 50), 8.0  # voxels of 2 mm


def across(samples: np.ndarray) -> tuple[float, float]:
    """Where the tumour begins and ends along x, in its middle, to a part of a voxel."""
    _, y, z = TUMOUR
    row = samples[z, y].astype(float)
    bright = 190.0
    places = np.flatnonzero(np.diff((row > bright).astype(int)))
    found = [k + (bright - row[k]) / (row[k + 1] - row[k]) for k in places]
    return found[0], found[-1]


def test_the_edge_of_a_tumour_is_pushed_in_a_slice(gpu: Gpu, state: Path) -> None:
    head = volumes.read(DATA / "head.nii.gz")
    samples = head.samples.astype(float)
    z, y, x = np.indices(samples.shape)
    away = np.sqrt((x - TUMOUR[0]) ** 2 + (y - TUMOUR[1]) ** 2 + (z - TUMOUR[2]) ** 2)
    inside = np.clip(RADIUS - away + 0.5, 0, 1)
    samples = ndimage.gaussian_filter(samples, 0.5) * (1 - inside) + 250 * inside
    source = state / "head.nii.gz"
    volumes.write(source, samples.astype(head.samples.dtype), head)
    volume = volumes.read(source)
    shape, geometry = volume.samples.shape, volume.geometry
    document = Document(shape, geometry.spacing, kind="volume", geometry=geometry)
    window = first_window(volume, "")
    tools = VolumeTools(document, geometry, AREA, lambda x, y: None, lambda pick, to: (0.0, 0.0, 0.0), window)
    tools.step(0, TUMOUR[2] - tools.index[2])
    tools.enlarge(0)
    axial = tools.pane(0)

    def edge(x: float) -> tuple[float, ...]:
        return TUMOUR[0] + x, TUMOUR[1], TUMOUR[2]

    def work(job: Job) -> None:
        job.key("1")  # the axial plane alone
        job.wheel(5, edge(0))  # to its slice
        job.wheel(notches(22.75, 12), edge(0), "Shift")
        job.drag(edge(RADIUS), edge(RADIUS + 4))
        pinned(job, edge(-RADIUS), edge(RADIUS + 12))

    recipe, made = done(source, "head-bent.nii.gz", lambda *point: axial.to_canvas(point), work)
    (stroke,) = recipe.strokes
    assert stroke.by == pytest.approx((4, 0, 0), abs=0.3)
    was, now = across(volume.samples), across(volumes.read(made).samples)
    # Its edge is 8 mm farther, and the opposite one where it was.
    assert now[1] - was[1] == pytest.approx(4, abs=0.3)
    assert now[0] == pytest.approx(was[0], abs=0.2)
    bent = Deformation.from_recipe(recipe, shape, spacing=geometry.spacing)
    away = bent.forward([(45.0, 54.0, 20.0), (20.0, 60.0, 50.0), (45.0, 90.0, 45.0)])
    assert np.abs(away - [(45, 54, 20), (20, 60, 50), (45, 90, 45)]).max() < 0.3
