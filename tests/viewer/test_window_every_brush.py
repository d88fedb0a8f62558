"""Every brush in every medium, without a screen, by a pointer and in a browser: exports are what recipes make."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe
from tests import effort
from tests.clips import decoded
from tests.viewer.sessions import recipe_in, warped
from tests.viewer.test_window_browser import browsing
from tests.viewer.windows import Browser, Hand, Mouse, a_screen, opened, small_photo, viewing, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")
pytest.importorskip("glfw")
Pair = tuple[int, int]
Box = tuple[int, int, int, int]


class OfHand:
    """A hand at a window without a screen."""

    def __init__(self, view: Any, hand: Hand) -> None:
        self._view, self._hand = view, hand

    def rest(self) -> None:
        self._hand.move(5, 5)
        wait_for(lambda: self._hand.canvas.draw() is not None and self._view.painter.ready, every=0.02)

    def key(self, key: str, *, control: bool = False) -> None:
        self._hand.key(key, *["Control"][:control])
        for _ in range(3 * (control or key == "Enter")):  # a question takes some frames
            self._hand.canvas.draw()

    def drag(self, start: Pair, end: Pair) -> None:
        self._hand.move(*start)
        self._hand.press(*start)
        for k in range(1, 4):
            self._hand.move(*(a + (b - a) * k / 3 for a, b in zip(start, end, strict=True)), 1)
        self._hand.release(*end)
        self._hand.canvas.draw()


class OfMouse:
    """A hand at a window on a screen."""

    def __init__(self, mouse: Mouse) -> None:
        self._mouse = mouse

    def rest(self) -> None:
        self._mouse.do("mousemove", 5, 5)
        self._mouse.settled()

    def key(self, key: str, *, control: bool = False) -> None:
        self._mouse.do("key", f"ctrl+{key}" if control else {"Enter": "Return"}.get(key, key))

    def drag(self, start: Pair, end: Pair) -> None:
        self._mouse.drag(start, end, steps=3)


class OfBrowser:
    """A hand at a page."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser

    def rest(self) -> None:
        self._browser.mouse("mouseMoved", 5, 5)
        self._browser.settled()

    def key(self, key: str, *, control: bool = False) -> None:
        self._browser.key(key, {"Enter": 13}.get(key, ord(key[0].upper())), 2 * control)

    def drag(self, start: Pair, end: Pair) -> None:
        self._browser.drag(start, end, steps=3)


@pytest.fixture
def clip(state: Path) -> Path:
    """A small one, of which all frames are drawn soon.

    Its width is one of which x264 reads no memory that was never written (of 280, its ``mbtree`` does, and two files
    of the same frames differ).
    """
    with av.open(str(state / "clip.mp4"), "w") as out:
        stream = out.add_stream("libx264", rate=25, options={"crf": "12", "preset": "fast"})
        stream.width, stream.height, stream.pix_fmt = 256, 190, "yuv420p"
        pixels = image.read(small_photo(state)).pixels[::2, :512:2]
        for k in range(6):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(np.roll(pixels, k, axis=1)))))
        out.mux(stream.encode(None))
    return state / "clip.mp4"


@contextmanager
def without_screen(source: Path) -> Iterator[OfHand]:
    view, hand = opened(source)
    yield OfHand(view, hand)
    view.close()


@contextmanager
def by_pointer(source: Path) -> Iterator[OfMouse]:
    folder = source.parent
    with a_screen(folder / "screen") as mouse, viewing(str(source), folder=folder, display=mouse.display):
        mouse.settled()
        yield OfMouse(mouse)


@contextmanager
def by_page(source: Path) -> Iterator[OfBrowser]:
    with browsing(source) as browser:
        yield OfBrowser(browser)


def drawn(hand: OfHand | OfMouse | OfBrowser, box: Box) -> None:
    """Drag with each brush, at places of a grid in a box; in the end, some of it is restored, evened out and frozen."""
    left, top, right, bottom = box
    wide = (right - left) // 20

    def at(column: int, row: int) -> Pair:
        return left + (right - left) * column // 4, top + (bottom - top) * row // 3

    def drag(key: str, place: Pair, by: Pair = (wide, wide // 2)) -> None:
        pause = not isinstance(hand, OfHand)
        hand.key(key)
        time.sleep(0.1 * pause)
        hand.drag(place, (place[0] + by[0], place[1] + by[1]))
        time.sleep(0.3 * pause)

    for column, key in enumerate("twpn"):
        drag(key, at(column, 0))
    drag("f", at(0, 1))
    hand.key("m")
    drag("g", at(3, 2), (wide, wide))
    hand.key("m")
    drag("g", at(1, 1), (2 * wide, 0))
    drag("d", at(2, 3))
    drag("r", at(1, 1), (3 * wide, 0))
    drag("s", at(3, 1), (2 * wide, 0))
    drag("c", at(0, 3), (8 * wide, 0))
    drag("v", at(0, 3), (0, 0))


def checked(recipe: Recipe) -> None:
    """All brushes are in a recipe."""
    strokes = recipe.strokes
    assert [stroke.brush for stroke in strokes[:4]] == ["twist", "scale", "scale", "pinch"]
    assert [float(stroke.factor) > 1 for stroke in strokes[1:3]] == [True, False]
    assert strokes[4].path
    assert len(strokes[5].also) == 1  # its mirror image
    assert len(strokes[6].also) == 1  # a point that was added
    assert {stroke.name for stroke in strokes[7:]} == {"restore", "smooth"}
    assert recipe.freeze is not None
    assert 0.001 < recipe.freeze.share < 0.3


def pixels_in(path: Path) -> Any:
    """All samples of a file."""
    if path.suffix == ".png":
        return image.read(path).pixels
    if path.suffix == ".mp4":
        return np.stack([frame.to_ndarray() for frame in decoded(path)])
    return sitk.GetArrayFromImage(sitk.ReadImage(str(path)))


BOXES = {"photo": (200, 220, 680, 460), "clip": (200, 220, 680, 460), "volume": (170, 130, 290, 250)}
USUAL = [("photo", without_screen)]  # pointers, clips and volumes have tests of their own


@pytest.mark.parametrize(
    ("medium", "way"),
    [
        pytest.param(*row, marks=() if row in USUAL else effort.soak("every brush in all media in all ways"))
        for row in itertools.product(BOXES, (without_screen, by_pointer, by_page))
    ],
)
def test_every_brush(gpu: Gpu, medium: str, way: Any, request: Any) -> None:
    source: Path = request.getfixturevalue(medium)
    stem, _, suffix = source.name.partition(".")
    saved, made = source.with_name(f"{stem}.recipe.json"), source.with_name(f"{stem}-bent.{suffix}")
    with way(source) as hand:
        drawn(hand, BOXES[medium])
        hand.rest()  # until all is carried out
        for key, path in (("s", saved), ("e", made)):
            # What is pressed while the question before is still seen would be lost.
            wait_for(
                lambda key=key, path=path: hand.key(key, control=True) or hand.key("Enter") or path.exists(), every=0.5
            )
    checked(recipe_in(saved))
    bent, before = pixels_in(made), pixels_in(source)
    np.testing.assert_array_equal(bent, pixels_in(warped(source, f"wanted.{suffix}", saved)))
    assert (bent != before).mean() > 0.05
