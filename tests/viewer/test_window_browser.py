"""The window as people have it: in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Stroke
from supple.viewer.panels.view import LINE, TOP, WIDE
from tests.viewer.sessions import near, on_canvas, recipe_in, warped
from tests.viewer.windows import Browser, Pixels, needs, small_photo, viewing, wait_for

pytest.importorskip("glfw")
Page = tuple[Browser, Path, list[str]]


@contextmanager
def browsing(source: Path, addresses: list[str] | None = None) -> Iterator[Browser]:
    """A browser that shows a medium, after it was refused without the token; its address is told."""
    needs("chromium")
    folder = source.parent
    with viewing(str(source), "--serve", folder=folder) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("open http://127.0.0.1:")
        address = line.removeprefix("open ").strip()
        if addresses is not None:
            addresses.append(address)
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


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A browser that shows a photograph, for several tests that leave it as it was; the file, and the address."""
    photo = small_photo(tmp_path_factory.mktemp("page"))
    addresses: list[str] = []
    with browsing(photo, addresses) as browser:
        yield browser, photo, addresses


def edited_there(browser: Browser, saved: Path, made: Path) -> tuple[Stroke, ...]:
    """Drag, undo, redo, save and export in a browser; the strokes that were saved."""
    browser.drag((350, 300), (410, 270))
    time.sleep(1)
    browser.drag((420, 250), (400, 300))
    time.sleep(1)
    browser.key("z", 90, 2)
    browser.key("s", 83, 2)
    wait_for(lambda: browser.key("Enter", 13) or saved.exists(), every=0.5)
    (stroke,) = recipe_in(saved).strokes
    assert np.linalg.norm(stroke.by) > 2
    again = ("y", 89, 2), ("s", 83, 2)
    wait_for(lambda: [browser.key(*key) for key in again] and len(recipe_in(saved).strokes) == 2, every=0.5)
    browser.key("e", 69, 2)
    wait_for(lambda: browser.key("Enter", 13) or made.exists(), every=0.5)
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
    wait_for(lambda: browser.key("Enter", 13) or bent(), every=0.5)


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
            return on_canvas(picture, seen, (seen.shape[1] - WIDE, seen.shape[0] - TOP - LINE), strokes)

        undone_and_opened(browser, lambda: away(wanted) < 5, lambda: away(before) < 5)
        assert away(before) > 8


def test_hints_and_the_list_of_keys_in_a_browser(gpu: Gpu, page: Page) -> None:
    browser, *_ = page
    x = browser.shown().shape[1] - WIDE + 20

    def there(before: Pixels, left: int, right: int) -> bool:
        box = np.s_[60:110, left:right]
        return bool((np.abs(browser.shown()[box].astype(int) - before[box]) > 50).any())

    browser.mouse("mouseMoved", x, 300)
    before = browser.settled()
    browser.mouse("mouseMoved", x, 60)
    wait_for(lambda: there(before, x + 30, x + 200), 10)
    browser.mouse("mouseMoved", 300, 580)
    wait_for(lambda: not there(before, x + 30, x + 200), 10)
    before = browser.shown()
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="?", text="?", windowsVirtualKeyCode=191, modifiers=8)
    wait_for(lambda: there(before, 100, 500), 10)
    browser.key("F1", 112)
    wait_for(lambda: not there(before, 100, 500), 10)


def test_another_page_takes_over_and_gives_back(gpu: Gpu, page: Page) -> None:
    first, photo, addresses = page
    area = slice(100, 500), slice(100, 600)
    plain = first.shown()
    first.drag((350, 300), (430, 260))
    first.mouse("mouseMoved", 900, 600)
    wait_for(lambda: near(first.shown()[area], plain[area]) > 6)
    drawn_there = first.settled()
    second = Browser(photo.with_name("second"))
    try:
        second.go(addresses[0])
        wait_for(lambda: "Another page has taken this window over." in first.text())
        assert "reconnect" not in first.text()
        wait_for(lambda: np.ptp(second.shown()[100:300, 100:400].astype(int)) > 100)
        # The same session: the stroke of the first page is there, and is undone in the second.
        wait_for(lambda: near(second.shown()[area], drawn_there[area]) < 6)
        second.key("z", 90, 2)
        wait_for(lambda: near(second.shown()[area], plain[area]) < 6)
        first.call("Runtime.evaluate", expression="document.querySelector('#taken button').click()")
        wait_for(lambda: "Another page has taken this window over." in second.text())
        wait_for(lambda: "taken this window" not in first.text())
        wait_for(lambda: near(first.shown()[area], plain[area]) < 6)
        first.key("y", 89, 2)
        wait_for(lambda: near(first.shown()[area], drawn_there[area]) < 6)
        first.key("z", 90, 2)
    finally:
        second.close()


def test_a_pen_in_a_browser(gpu: Gpu, page: Page) -> None:
    browser, photo, _ = page
    saved, made = photo.with_name("photo.recipe.json"), photo.with_name("photo-bent.png")
    browser.drag((350, 300), (410, 270), pointerType="pen", force=0.5)
    time.sleep(1)
    # The greatest pressure is that of a move which is not sent, as the next one follows at once.
    pen = {"pointerType": "pen", "force": 0.2}
    browser.mouse("mousePressed", 350, 220, button="left", buttons=1, clickCount=1, **pen)
    browser.mouse("mouseMoved", 380, 200, button="left", buttons=1, **pen)
    time.sleep(0.2)
    browser.call(
        "Runtime.evaluate",
        expression='dispatchEvent(new PointerEvent("pointermove", { pointerType: "pen", pressure: 0.5 }))',
    )
    browser.mouse("mouseMoved", 410, 190, button="left", buttons=1, **pen)
    browser.mouse("mouseReleased", 410, 190, button="left", clickCount=1, **pen)
    time.sleep(1)
    browser.drag((350, 150), (410, 120))
    time.sleep(1)
    browser.key("s", 83, 2)
    wait_for(lambda: browser.key("Enter", 13) or saved.exists(), every=0.5)
    time.sleep(1)  # the dialog of saving closes, which would take the next key
    browser.key("e", 69, 2)
    wait_for(lambda: browser.key("Enter", 13) or made.exists(), every=0.5)
    even, peak, mouse = recipe_in(saved).strokes
    for stroke in (even, peak):
        np.testing.assert_allclose(stroke.by, 0.75 * np.array(mouse.by), rtol=0.01)
    np.testing.assert_array_equal(image.read(made).pixels, image.read(warped(photo, "wanted.png", saved)).pixels)


def test_a_finger_in_a_browser(gpu: Gpu, page: Page) -> None:
    browser, photo, _ = page
    saved = photo.with_name("photo.recipe.json")
    saved.unlink(missing_ok=True)  # of another test of this page
    places = [(350 + 10 * k, 300 - 5 * k) for k in range(7)]
    for kind, at in (("touchStart", places[0]), *(("touchMove", at) for at in places[1:])):
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": at[0], "y": at[1]}])
        time.sleep(0.1)
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    time.sleep(1)
    browser.key("s", 83, 2)
    wait_for(lambda: browser.key("Enter", 13) or saved.exists(), every=0.5)
    *_, stroke = recipe_in(saved).strokes
    assert stroke.by[0] == pytest.approx(-2 * stroke.by[1], rel=0.02)
    assert stroke.strength == 1  # a finger has no pressure of its own


# What the browser would do with a key, or a click, is asked of the event once all have heard it.
LOGGED = """
window.heard = [];
for (const kind of ["keydown", "contextmenu", "wheel"])
  document.addEventListener(kind, (event) => setTimeout(
    () => heard.push([kind, event.key ?? "", event.ctrlKey, event.defaultPrevented])), { capture: true });
"""


def test_the_keys_of_the_window_are_kept_from_the_browser_and_no_others(gpu: Gpu, page: Page) -> None:
    browser, *_ = page
    browser.call("Runtime.evaluate", expression=LOGGED)
    ours = {("s", 83, 2), ("o", 79, 2), ("e", 69, 2), ("z", 90, 2), ("y", 89, 2), ("Z", 90, 10), ("S", 83, 10)}
    theirs = {("r", 82, 2), ("t", 84, 2), ("c", 67, 2), ("v", 86, 2), ("F5", 116, 0), ("s", 83, 0), (" ", 32, 0)}
    for key, code, modifiers in (*ours, ("F1", 112, 0), *theirs):
        browser.call(
            "Input.dispatchKeyEvent", type="rawKeyDown", key=key, windowsVirtualKeyCode=code, modifiers=modifiers
        )
        browser.call("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=code, modifiers=modifiers)
    browser.mouse("mouseMoved", 300, 300)
    for kind in ("mousePressed", "mouseReleased"):
        browser.mouse(kind, 300, 300, button="right", clickCount=1)
    browser.mouse("mouseWheel", 300, 300, deltaX=0, deltaY=-100, modifiers=2)

    def heard() -> list[list[object]]:
        found = browser.call("Runtime.evaluate", expression="heard", returnByValue=True)["result"]["value"]
        return found if {kind for kind, *_ in found} == {"keydown", "contextmenu", "wheel"} else []

    kept = {(kind, key, control): prevented for kind, key, control, prevented in wait_for(heard)}
    for key, _, modifiers in ours:
        assert kept["keydown", key, bool(modifiers & 2)] is True, key
    assert kept["keydown", "F1", False] is True
    for key, _, modifiers in theirs:
        assert kept["keydown", key, bool(modifiers & 2)] is False, key
    assert kept["contextmenu", "", False] is True
    assert kept["wheel", "", True] is True
    place = browser.call("Runtime.evaluate", expression="scrollX + scrollY + innerWidth - outerWidth")
    assert place["result"]["value"] == 0  # neither moved nor zoomed
