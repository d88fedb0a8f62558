"""The window as people have it: by a real pointer on a real screen, and in a browser."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.cli import command
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe, Stroke
from supple.viewer.launch import SIZE
from supple.viewer.panels import BAR, LINE, WIDE
from supple.viewer.viewport import Viewport
from tests.clips import decoded
from tests.viewer.windows import Browser, Mouse, Pixels, a_screen, needs, small_photo, viewing, wait_for

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")
pytest.importorskip("glfw")

DATA = Path(supple.__file__).parent / "examples" / "data"
AREA = (SIZE[0] - WIDE, SIZE[1] - LINE)


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own for all."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path


@pytest.fixture
def photo(state: Path) -> Path:
    return small_photo(state)


@pytest.fixture
def clip(state: Path) -> Path:
    target, count = state / "clip.mp4", 16
    with av.open(str(DATA / "bunny.mp4")) as source, av.open(str(target), "w") as out:
        stream = out.add_stream("libx264", rate=25, options={"crf": "12", "preset": "fast"})
        stream.width, stream.height, stream.pix_fmt = 640, 360, "yuv420p"
        for frame in itertools.islice(source.decode(video=0), count):
            out.mux(stream.encode(frame.reformat(640, 360)))
        out.mux(stream.encode(None))
    return target


@pytest.fixture
def volume(state: Path) -> Path:
    """The head, of voxels of 4 mm."""
    sitk.WriteImage(sitk.BinShrink(sitk.ReadImage(str(DATA / "head.nii.gz")), (2, 2, 2)), str(state / "head.nii.gz"))
    return state / "head.nii.gz"


def recipe_in(path: Path) -> Recipe:
    return Recipe.from_json(path.read_text(encoding="utf-8"))


def near(one: Pixels, other: Pixels, where: Any = ...) -> float:
    """How far pictures are apart: the root of the mean square, in levels."""
    return float(np.sqrt(np.mean((one.astype(float) - other.astype(float))[where] ** 2)))


def beside(shape: tuple[int, ...], handles: list[tuple[tuple[float, float], tuple[float, float]]]) -> Any:
    """Where the lines and handles of strokes are not drawn."""
    y, x = np.indices(shape[:2])
    free = np.ones(shape[:2], bool)
    for start, end in handles:
        for part in np.linspace(0, 1, 50):
            at = [a + part * (b - a) for a, b in zip(start, end, strict=True)]
            free &= (x - at[0]) ** 2 + (y - at[1]) ** 2 > 12**2
    return free


def edited(
    source: Path, mouse: Mouse, stem: str, target: str, first: Callable[[Mouse], None], pause: float = 0.6
) -> tuple[Pixels, Recipe]:
    """Drag, undo, redo, save and export, by hand; what is seen in the end, and the recipe that was saved."""
    folder = source.parent
    saved, made = folder / f"{stem}.recipe.json", folder / target
    with viewing(str(source), folder=folder, display=mouse.display):
        wait_for(mouse.window)
        mouse.settled()
        first(mouse)
        mouse.drag((400, 380), (440, 350))
        time.sleep(pause)
        mouse.drag((520, 300), (500, 340))
        time.sleep(pause)
        mouse.do("key", "ctrl+z")
        time.sleep(pause)
        mouse.do("key", "ctrl+s")
        wait_for(lambda: mouse.enter() or saved.exists(), every=1.0)
        assert len(recipe_in(saved).strokes) == 1
        # What is pressed while a question is still seen is not for the picture.
        wait_for(lambda: mouse.do("key", "ctrl+shift+z", "ctrl+s") or len(recipe_in(saved).strokes) == 2, every=1.5)
        mouse.do("key", "ctrl+e")
        wait_for(lambda: mouse.enter() or made.exists(), every=1.0)
        mouse.do("key", "Escape")
        mouse.do("mousemove", 1100, 780)
        seen = mouse.settled()
    # What was saved is opened again, and looks as it did.
    with viewing(str(source), folder=folder, display=mouse.display):
        wait_for(mouse.window)
        plain = mouse.settled()
        first(mouse)
        mouse.do("key", "ctrl+o")
        mouse.do("mousemove", 1100, 780)
        wait_for(lambda: mouse.enter() or near(mouse.shown(), seen, np.s_[: AREA[1] - BAR, : AREA[0]]) < 0.5, every=1.0)
        assert near(plain, seen, np.s_[: AREA[1] - BAR, : AREA[0]]) > 5
    return seen, recipe_in(saved)


def warped(source: Path, name: str, recipe: Path, *options: str) -> Path:
    """What the command line makes of a recipe."""
    target = source.with_name(name)
    assert command(["warp", str(source), str(target), "--recipe", str(recipe), *options]) == 0
    return target


def on_canvas(picture: Pixels, seen: Pixels, area: tuple[int, int], strokes: tuple[Stroke, ...]) -> float:
    """How far a picture is from what a window shows of it at 100 %, beside its handles."""
    height, width = picture.shape[:2]
    viewport = Viewport((width, height), area).actual()
    left, top = (round(v) for v in viewport.to_canvas(0, 0))
    assert left >= 0
    assert top >= 0
    seen = seen[top : top + height, left : left + width]
    ends = [(s.at[:2], tuple(a + b for a, b in zip(s.at[:2], s.by[:2], strict=True))) for s in strokes]
    return near(seen, picture, beside(picture.shape, ends))


def test_a_photograph_by_a_real_pointer(gpu: Gpu, photo: Path, state: Path) -> None:
    with a_screen(state) as mouse:
        seen, recipe = edited(photo, mouse, "photo", "photo-bent.png", lambda mouse: mouse.do("key", "1") and None)
    assert recipe.strokes[0].by == pytest.approx((40, -30), abs=0.01)
    wanted = warped(photo, "wanted.png", state / "photo.recipe.json")
    made = image.read(state / "photo-bent.png").pixels
    np.testing.assert_array_equal(made, image.read(wanted).pixels)
    linear = warped(photo, "linear.png", state / "photo.recipe.json", "--filter", "linear")  # as the device does it
    assert on_canvas(image.read(linear).pixels, seen, AREA, recipe.strokes) < 1.0
    assert on_canvas(image.read(photo).pixels, seen, AREA, recipe.strokes) > 8


def test_a_clip_by_a_real_pointer(gpu: Gpu, clip: Path, state: Path) -> None:
    def first(mouse: Mouse) -> None:
        """Go to a frame, and to 100 %."""
        mouse.do("key", "1", "Home", *["Right"] * 8)
        time.sleep(0.5)

    with a_screen(state) as mouse:
        seen, recipe = edited(clip, mouse, "clip", "clip-bent.mp4", first)
    assert [stroke.at[2] for stroke in recipe.strokes] == [8, 8]
    assert recipe.strokes[0].by == pytest.approx((40, -30, 0), abs=0.01)
    made, wanted = (
        decoded(path) for path in (state / "clip-bent.mp4", warped(clip, "wanted.mp4", state / "clip.recipe.json"))
    )
    assert len(made) == 16
    for one, other in zip(made, wanted, strict=True):
        np.testing.assert_array_equal(one.to_ndarray(), other.to_ndarray())
    area = AREA[0], AREA[1] - BAR
    assert on_canvas(made[8].to_ndarray(format="rgb24"), seen, area, recipe.strokes) < 6
    assert on_canvas(decoded(clip)[8].to_ndarray(format="rgb24"), seen, area, recipe.strokes) > 10


def test_a_volume_by_a_real_pointer(gpu: Gpu, volume: Path, state: Path) -> None:
    with a_screen(state) as mouse:
        seen, recipe = edited(volume, mouse, "head", "head-bent.nii.gz", lambda mouse: None, 1.5)
    assert all(np.linalg.norm(stroke.by) > 2 for stroke in recipe.strokes)
    saved = state / "head.recipe.json"
    made, wanted = (
        sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
        for path in (state / "head-bent.nii.gz", warped(volume, "wanted.nii.gz", saved))
    )
    np.testing.assert_array_equal(made, wanted)
    # The same camera sees the same: of what was exported, of the volume through its recipe, and on the canvas.
    look = ["--size", f"{AREA[0]}x{AREA[1]}", "--background", "#1f1f21"]
    pictures = {}
    for name, what in {
        "bent": [str(state / "head-bent.nii.gz")],
        "seen": [str(volume), "--recipe", str(saved)],
        "plain": [str(volume)],
    }.items():
        assert command(["render", what[0], str(state / f"{name}.png"), *what[1:], *look]) == 0
        pictures[name] = image.read(state / f"{name}.png").pixels[..., :3]
    canvas = seen[: AREA[1], : AREA[0]]
    assert near(canvas, pictures["seen"]) < 4
    assert near(canvas, pictures["bent"]) < 4
    assert near(canvas, pictures["plain"]) > 3


@contextmanager
def browsing(source: Path) -> Iterator[Browser]:
    """A browser that shows a medium, after it was refused without the token."""
    needs("chromium")
    folder = source.parent
    with viewing(str(source), "--serve", folder=folder) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("open http://127.0.0.1:")
        address = line.removeprefix("open ").strip()
        browser = Browser(folder / "browser")
        try:
            browser.go(address.partition("?")[0])
            wait_for(lambda: "those who have its whole address" in browser.text())
            browser.go(address)
            wait_for(lambda: np.ptp(browser.shown()[100:300, 100:400].astype(int)) > 100)
            yield browser
            assert "token" not in str(browser.call("Runtime.evaluate", expression="location.href"))
        finally:
            browser.close()


def edited_there(browser: Browser, saved: Path, made: Path) -> tuple[Stroke, ...]:
    """Drag, undo, redo, save and export in a browser; the strokes that were saved."""
    browser.drag((350, 300), (410, 270))
    time.sleep(1)
    browser.drag((420, 250), (400, 300))
    time.sleep(1)
    browser.key("z", 90, 2)
    browser.key("s", 83, 2)
    wait_for(lambda: browser.key("Enter", 13) or saved.exists(), every=2.0)
    (stroke,) = recipe_in(saved).strokes
    assert np.linalg.norm(stroke.by) > 2
    again = ("y", 89, 2), ("s", 83, 2)
    wait_for(lambda: [browser.key(*key) for key in again] and len(recipe_in(saved).strokes) == 2, every=1.5)
    browser.key("e", 69, 2)
    wait_for(lambda: browser.key("Enter", 13) or made.exists(), every=2.0)
    browser.key("Escape", 27)
    browser.mouse("mouseMoved", 900, 600)
    return recipe_in(saved).strokes


def undone_and_opened(browser: Browser, bent: Callable[[], bool], plain: Callable[[], bool]) -> None:
    """See what was done, undo it, and open what was saved."""
    wait_for(bent)
    for _ in range(2):
        browser.key("z", 90, 2)
    wait_for(plain)
    browser.key("o", 79, 2)
    wait_for(lambda: browser.key("Enter", 13) or bent(), every=2.0)


def test_a_photograph_in_a_browser(gpu: Gpu, photo: Path, state: Path) -> None:
    saved, made = state / "photo.recipe.json", state / "photo-bent.png"
    with browsing(photo) as browser:
        strokes = edited_there(browser, saved, made)
        wanted, before = image.read(warped(photo, "wanted.png", saved)).pixels, image.read(photo).pixels
        np.testing.assert_array_equal(image.read(made).pixels, wanted)
        # At 100 %, the page shows what was exported, but for what its compression does.
        browser.key("1", 49)

        def away(picture: Pixels) -> float:
            seen = browser.shown()
            return on_canvas(picture, seen, (seen.shape[1] - WIDE, seen.shape[0] - LINE), strokes)

        undone_and_opened(browser, lambda: away(wanted) < 5, lambda: away(before) < 5)
        assert away(before) > 8


def test_a_clip_in_a_browser(gpu: Gpu, clip: Path, state: Path) -> None:
    saved, made = state / "clip.recipe.json", state / "clip-bent.mp4"
    with browsing(clip) as browser:
        browser.key("1", 49)  # nothing was clicked on yet
        for _ in range(8):
            browser.key("ArrowRight", 39)
            time.sleep(0.2)
        strokes = edited_there(browser, saved, made)
        assert {stroke.at[2] for stroke in strokes} == {8}
        frames = decoded(made)
        for one, other in zip(frames, decoded(warped(clip, "wanted.mp4", saved)), strict=True):
            np.testing.assert_array_equal(one.to_ndarray(), other.to_ndarray())
        wanted, before = (some[8].to_ndarray(format="rgb24") for some in (frames, decoded(clip)))

        def away(picture: Pixels) -> float:
            seen = browser.shown()
            return on_canvas(picture, seen, (seen.shape[1] - WIDE, seen.shape[0] - LINE - BAR), strokes)

        undone_and_opened(browser, lambda: away(wanted) < 8, lambda: away(before) < 8)
        assert away(before) > 10


def test_a_volume_in_a_browser(gpu: Gpu, volume: Path, state: Path) -> None:
    saved, made = state / "head.recipe.json", state / "head-bent.nii.gz"
    with browsing(volume) as browser:
        edited_there(browser, saved, made)
        found, wanted = (
            sitk.GetArrayFromImage(sitk.ReadImage(str(path))) for path in (made, warped(volume, "wanted.nii.gz", saved))
        )
        np.testing.assert_array_equal(found, wanted)
        seen = browser.shown()
        area = seen.shape[1] - WIDE, seen.shape[0] - LINE
        pictures = []
        for name, recipe in (("bent.png", ["--recipe", str(saved)]), ("plain.png", [])):
            look = ["--size", f"{area[0]}x{area[1]}", "--background", "#1f1f21"]
            assert command(["render", str(volume), str(state / name), *recipe, *look]) == 0
            pictures.append(image.read(state / name).pixels[..., :3])

        def away(picture: Pixels) -> float:
            return near(browser.shown()[: area[1], : area[0]], picture)

        undone_and_opened(browser, lambda: away(pictures[0]) < 6, lambda: away(pictures[1]) < 6)
        assert away(pictures[1]) > 6
