"""Rotated and mirrored clips are shown upright, and pixels as wide as they are; points stay those of stored frames."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.strokes import Recipe
from supple.viewer.panels.stages import FrameCache
from supple.viewer.panels.view import TOP
from tests.viewer.windows import Hand, in_pixels, opened, settled

# Where a pixel one to the right, and one below, is shown, as display matrices have it: x and y of each.
DISPLAYS = {
    "clockwise": (0, 1, -1, 0),
    "counterclockwise": (0, -1, 1, 0),
    "half": (-1, 0, 0, -1),
    "mirrored": (-1, 0, 0, 1),
    "transposed": (0, 1, 1, 0),
}
Pixels = np.ndarray[Any, np.dtype[np.uint8]]


def upright(stored: Pixels, display: tuple[int, ...]) -> Pixels:
    """A frame as players show it, pixel by pixel."""
    y, x = np.indices(stored.shape[:2])
    a, b, c, d = display
    across, down = a * x + c * y, b * x + d * y
    across, down = across - across.min(), down - down.min()
    made = np.empty((down.max() + 1, across.max() + 1, 3), np.uint8)
    made[down, across] = stored
    return made


def picture(width: int = 240, height: int = 160) -> Pixels:
    """A picture without any symmetry, bright, and darker to its stored right."""
    y, x = np.indices((height, width))
    made = np.stack([230 - x // 2, 130 + y // 2, 120 + 60 * ((x // 20 + y // 20) % 2)], axis=-1)
    made[20:60, 30:50] = 255, 255, 80
    return made.astype(np.uint8)


def clip(path: Path, frame: Pixels, display: tuple[int, ...] = (1, 0, 0, 1), aspect: Fraction | None = None) -> Path:
    """A lossless clip of three equal frames, displayed as its header says."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264rgb", rate=25, options={"qp": "0", "preset": "ultrafast"})
        stream.height, stream.width = frame.shape[:2]
        stream.pix_fmt = "rgb24"
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for _ in range(3):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(frame, "rgb24")))
        out.mux(stream.encode(None))
    data = bytearray(path.read_bytes())
    at, (a, b, c, d) = data.index(b"tkhd") + 44, (n << 16 for n in display)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    return path


def area(view: Any, hand: Hand) -> np.ndarray:
    """What is drawn of picture and strokes, once nothing is still to come."""
    width, height = (round(n) for n in view.area)
    return settled(view, hand)[TOP : TOP + height, :width]


def extent(view: Any, hand: Hand) -> tuple[int, int]:
    """The columns and rows of a bright picture on the dark canvas."""
    bright = area(view, hand).max(axis=-1) > 90
    return int(bright.any(axis=0).sum()), int(bright.any(axis=1).sum())


def bend(view: Any, hand: Hand) -> None:
    """Pull, and twist, something in the window."""
    view.tools.radius = 30
    width, height = view.area
    x, y = width / 2, TOP + height / 2
    hand.drag((x - 30, y - 20), (x + 25, y - 45), steps=1)
    hand.key("t")
    hand.drag((x + 20, y + 30), (x + 40, y + 35), steps=1)


def frozen(view: Any, hand: Hand) -> np.ndarray:
    """Freeze something in the window; what is drawn with the pointer at rest on the picture."""
    x, y = (n / 2 for n in view.area)
    y += TOP
    hand.key("c")
    hand.drag((x - 60, y + 40), (x - 20, y + 50), steps=1)
    hand.key("Escape")
    hand.key("g")
    hand.move(x + 50, y - 20)
    return area(view, hand)


@pytest.mark.parametrize(("name", "ratio"), [("clockwise", 2.0), ("mirrored", 1.0)])
def test_a_turned_clip_is_shown_and_bent_as_its_upright_frames_are(
    gpu: Gpu, tmp_path: Path, name: str, ratio: float
) -> None:
    display, frame = DISPLAYS[name], picture()
    given: Any = {"recipe": Recipe(border=None), "ratio": ratio, "size": (640, 400)}
    turned = opened(clip(tmp_path / "turned.mp4", frame, display), **given)
    plain = opened(clip(tmp_path / "plain.mp4", upright(frame, display)), **given)
    assert np.abs(area(*turned) - area(*plain)).max() <= 1  # a weight that is rounded in another order
    for view, hand in (turned, plain):
        hand.key("1")
        area(view, hand)
    np.testing.assert_array_equal(area(*turned), area(*plain))
    bend(*turned), bend(*plain)
    assert np.abs(turned[0].pixels().astype(int) - plain[0].pixels()).max() <= 2
    one, other = frozen(*turned), frozen(*plain)
    assert np.abs(one - other).mean() < 0.1  # edges of lines, and samples of the mask, lie otherwise
    assert (np.abs(one - other).max(axis=-1) > 12).mean() < 0.005
    columns = np.array(display, float).reshape(2, 2)
    for mine, known in zip(turned[0].recipe.strokes, plain[0].recipe.strokes, strict=True):
        np.testing.assert_allclose(np.array(mine.by[:2]) @ columns, known.by[:2], atol=1e-6)
        assert (mine.angle or 0) == pytest.approx((known.angle or 0) * round(np.linalg.det(columns)))


@pytest.mark.parametrize("name", ["clockwise", "mirrored"])
def test_a_drag_begins_and_ends_where_the_pointer_is(gpu: Gpu, tmp_path: Path, name: str) -> None:
    frame, aspect = picture(), Fraction(4, 3)
    view, hand = opened(clip(tmp_path / "a.mp4", frame, DISPLAYS[name], aspect), Recipe(border=None))
    view.tools.radius = 15
    area(view, hand)
    start = view.tools.view.to_canvas(40, 25)  # within the yellow patch
    end = view.tools.view.to_canvas(95, 70)
    before = view.pixels()
    hand.drag(start, end)
    (stroke,) = view.recipe.strokes
    assert stroke.at == pytest.approx((40, 25, 0))
    assert view.document.deformation.forward((40.0, 25.0, 0.0))[:2] == pytest.approx((95, 70), abs=0.1)
    (u, v), (x, y) = (in_pixels(view, *point) for point in ((40, 25), (95, 70)))
    assert np.abs(view.pixels()[y, x].astype(int) - before[v, u]).max() <= 10
    assert np.abs(before[y, x].astype(int) - before[v, u]).max() > 50


@pytest.mark.parametrize(
    ("name", "aspect", "shown"),
    [
        ("half", Fraction(4, 3), (320, 160)),
        ("clockwise", Fraction(2), (160, 480)),
        ("mirrored", Fraction(1, 2), (120, 160)),
    ],
)
def test_pixels_are_as_wide_as_the_clip_says(
    gpu: Gpu, tmp_path: Path, name: str, aspect: Fraction, shown: tuple[int, int]
) -> None:
    frame = picture()
    view, hand = opened(clip(tmp_path / "a.mp4", frame, DISPLAYS[name], aspect))
    view.tools.press("1")
    assert extent(view, hand) == shown
    seen = area(view, hand).astype(int)
    for point in [(40, 40), (200, 100), (100, 150)]:
        x, y = in_pixels(view, *point)
        assert np.abs(seen[y, x] - frame[point[1], point[0]]).max() <= 70  # of a pixel beside it at most
    made = upright(frame, DISPLAYS[name])
    corner = [(a - b) // 2 for a, b in zip(seen.shape[:2], shown[::-1], strict=True)]
    rows, columns = (np.arange(n) * m // n for n, m in zip(shown[::-1], made.shape[:2], strict=True))
    part = seen[corner[0] : corner[0] + shown[1], corner[1] : corner[1] + shown[0]]
    assert np.abs(part - made[rows][:, columns]).mean() < 4


def test_a_circle_of_the_brush_is_an_ellipse_where_pixels_are_wide(gpu: Gpu, tmp_path: Path) -> None:
    frame = np.full((160, 240, 3), 128, np.uint8)
    view, hand = opened(clip(tmp_path / "a.mp4", frame, DISPLAYS["clockwise"], Fraction(2)))
    view.tools.press("1")
    view.tools.radius = 30
    view.tools.press("c")  # whose ring is the radius
    x, y = (round(n / 2) for n in view.area)
    hand.move(x, TOP + y)
    seen = area(view, hand).min(axis=-1)
    across, down = (int(np.argmax(line[1:])) + 1 for line in (seen[y, x : x + 75], seen[y : y + 150, x]))
    assert (across, down) == (pytest.approx(30, abs=1), pytest.approx(60, abs=1))


def test_strokes_are_symmetric_about_the_vertical_middle_that_is_shown(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = opened(clip(tmp_path / "a.mp4", picture(), DISPLAYS["clockwise"]), Recipe(border=None))
    hand.key("m")
    middle, height = view.area[0] / 2, TOP + view.area[1] / 2
    assert view.tools.grip[0] == pytest.approx(middle)
    hand.drag((middle - 60, height), (middle - 90, height + 10))
    (stroke,) = view.recipe.strokes
    one, other = (view.tools.view.to_canvas(*at[:2]) for at, _ in stroke.handles)
    assert (one[0] + other[0], one[1]) == (pytest.approx(2 * middle), pytest.approx(other[1]))
    hand.drag(view.tools.grip, (middle + 30, height))
    assert view.tools.grip[0] == pytest.approx(middle + 30)


def exr(path: Path, aspect: float) -> Path:
    OpenEXR = pytest.importorskip("OpenEXR")
    planes = {k: np.full((60, 100), 0.6, np.float32) for k in "RGB"}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "pixelAspectRatio": aspect}
    OpenEXR.File(header, planes).write(str(path))
    return path


def test_pixels_are_as_wide_as_an_exr_says(gpu: Gpu, tmp_path: Path) -> None:
    view, hand = opened(exr(tmp_path / "a.exr", 2.0))
    view.tools.press("1")
    assert extent(view, hand) == (200, 60)
    folder = tmp_path / "shot"
    folder.mkdir()
    for k in range(2):
        exr(folder / f"{k:04}.exr", 1.5)
    film = FrameCache(folder)
    film.close()
    assert film.turn == (1.5, 0, 0, 1)
