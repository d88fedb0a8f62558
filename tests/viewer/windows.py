"""Hands for windows: events for one without a screen, xdotool for one on a screen, and a browser."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvips

import supple
from supple.files.renders import default_transfer
from supple.media import image
from supple.media import volume as volumes
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.viewer.panels.view import TOP
from tests.children import HEARING, SOURCE

pytest.importorskip("rendercanvas")
imgui = pytest.importorskip("imgui_bundle").imgui

DATA = Path(supple.__file__).parent / "examples" / "data"
MUST = os.environ.get("SUPPLE_TEST_WINDOW") == "1"
SIZE = (1000, 640)
Pixels = np.ndarray[Any, np.dtype[np.uint8]]


def needs(*programs: str) -> None:
    """Skip a test where a program is missing; where SUPPLE_TEST_WINDOW is set, none may be."""
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        assert not MUST, f"{missing} must be installed"
        pytest.skip(f"{', '.join(missing)} is not installed")


def wait_for(what: Any, seconds: float = 240.0, every: float = 0.1) -> Any:
    """What a function gives, once that is something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = what()
        if found:
            return found
        time.sleep(every)
    raise AssertionError("it took too long")


def as_in_a_window(volume: Path, width: int, height: int) -> list[str]:
    """The options of a rendering that stays where a window's camera is at first, whatever the strokes move."""
    found = volumes.read(volume)
    scene = Scene(found.samples, found.geometry, transfer=default_transfer(found))
    camera = scene.framed(Camera(), (height, width))
    assert camera.target is not None
    place = ",".join(repr(x) for x in camera.target)
    size = ["--size", f"{width}x{height}", "--background", "#1f1f21"]
    return [*size, "--target", place, "--distance", repr(camera.distance)]


class Hand:
    """A pointer and a keyboard for a canvas without a screen."""

    def __init__(self, canvas: Any, view: Any) -> None:
        self.canvas, self._view, self.stamp = canvas, view, 0.0
        self.modifiers: tuple[str, ...] = ()

    def pass_frame(self) -> None:
        """Draw a frame that nobody looks at, without composing it on the canvas, where software takes longest."""
        queue = self._view.gpu.device.queue
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self._view, "_present", lambda shot, encoder: queue.submit([encoder.finish()]))
            self._view.draw()

    def send(self, kind: str, **event: Any) -> None:
        self.stamp += 0.01
        common = {"event_type": kind, "modifiers": self.modifiers, "time_stamp": self.stamp}
        self.canvas.submit_event(common | event)
        self.canvas._process_events()

    def move(self, x: float, y: float, *buttons: int) -> None:
        self.send("pointer_move", x=x, y=y, button=0, buttons=buttons, ntouches=0, touches={})

    def press(self, x: float, y: float, button: int = 1) -> None:
        self.send("pointer_down", x=x, y=y, button=button, buttons=(button,), ntouches=0, touches={})

    def release(self, x: float, y: float, button: int = 1) -> None:
        self.send("pointer_up", x=x, y=y, button=button, buttons=(), ntouches=0, touches={})

    def click(self, place: tuple[float, float]) -> None:
        self.move(*place)
        self.pass_frame()
        self.press(*place)
        self.pass_frame()
        self.release(*place)
        self.pass_frame()
        self.pass_frame()

    def drag(self, start: tuple[float, float], end: tuple[float, float], button: int = 1, steps: int = 4) -> None:
        self.move(*start)
        self.press(*start, button)
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            self.move(x, y, button)
            self.pass_frame()
        self.release(*end, button)
        self.pass_frame()

    def draw(self, *way: tuple[float, float]) -> None:
        self.move(*way[0])
        self.press(*way[0])
        for x, y in way[1:]:
            self.move(x, y, 1)
            self.pass_frame()
        self.release(*way[-1])
        self.pass_frame()

    def wheel(self, x: float, y: float, dy: float) -> None:
        self.send("wheel", x=x, y=y, dx=0.0, dy=dy, buttons=())

    def key(self, key: str, *modifiers: str) -> None:
        self.modifiers = modifiers
        self.send("key_down", key=key)
        self.send("key_up", key=key)
        self.modifiers = ()


def in_pixels(view: Any, *point: float) -> tuple[int, int]:
    """The column and the row of ``view.pixels()`` at which a point of a picture is seen."""
    x, y = view.tools.view.to_canvas(*point)
    return math.floor(x), math.floor(y) - TOP


_opened: list[Any] = []


def beside(view: Any, picture: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """What a window shows of a picture at 100 %, and the part of the picture that is there, in whole numbers."""
    (x, y), seen, part = in_pixels(view, 0, 0), view.pixels().astype(int), picture[..., :3].astype(int)
    seen, part = seen[max(y, 0) :, max(x, 0) :], part[max(-y, 0) :, max(-x, 0) :]
    height, width = (min(a, b) for a, b in zip(seen.shape[:2], part.shape[:2], strict=True))
    return seen[:height, :width], part[:height, :width]


def opened(
    source: Any, recipe: Any = None, *, ratio: float = 1.0, size: tuple[int, int] = SIZE, **options: Any
) -> tuple[Any, Hand]:
    """A window without a screen, and the hand that is in it; options are those of `supple.view`."""
    from rendercanvas.offscreen import RenderCanvas

    from supple.viewer.window.launch import opened as opened_on
    from supple.viewer.window.options import ViewOptions

    canvas = RenderCanvas(size=size, pixel_ratio=ratio)
    # What comes later does not: there is no loop, and frames are drawn by who tests.
    loop = SimpleNamespace(call_later=lambda seconds, work: None)
    view = opened_on(source, recipe, canvas, loop, options=ViewOptions(**options))
    view.hinted = True  # the first hints lie over pictures
    _opened.append(view)
    canvas.draw()
    return view, Hand(canvas, view)


def close_all() -> None:
    """Close what was opened, and wait for what goes on there."""
    while _opened:
        view = _opened.pop()
        view.close()
        if view.certifier.thread is not None:
            view.certifier.thread.join(120)


CONTROLS = "button small_button invisible_button checkbox combo slider_float slider_int input_float input_text"
CONTROLS += " selectable tree_node collapsing_header begin_menu menu_item"
LIKE_OTHERS = {"menu_item": "menu ", "collapsing_header": "section "}


class Boxes(dict[str, tuple[float, float, float, float]]):
    """The controls of the last frame, by their names: their left, upper, right and lower sides."""

    def at(self, name: str, across: float = 0.5) -> tuple[float, float]:
        left, top, right, bottom = self[name]
        return left + across * (right - left), 0.5 * (top + bottom)

    def place(self, name: str) -> tuple[float, float]:
        """A place on a control near its left end."""
        left, top, right, bottom = self[name]
        return left + min(right - left, 24) / 2, 0.5 * (top + bottom)


def short(function: str, label: str) -> str:
    return LIKE_OTHERS.get(function, "") + label.rpartition("###")[2]


def watch(patch: pytest.MonkeyPatch, named: Callable[[str, str], str] = short) -> Boxes:
    """Keep where the controls of each frame are, by what their functions and labels are named."""
    found = Boxes()
    for name in CONTROLS.split():
        draw = getattr(imgui, name)

        def drawn(label: str, *rest: Any, name: str = name, draw: Any = draw, **options: Any) -> Any:
            made = draw(label, *rest, **options)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            found[named(name, label)] = low.x, low.y, high.x, high.y
            return made

        patch.setattr(imgui, name, drawn)
    return found


def written(patch: pytest.MonkeyPatch) -> list[tuple[str, float, float, float, float]]:
    """Keep what is written over the views, and the box of each."""
    from supple.viewer.panels import overlay

    boxes: list[tuple[str, float, float, float, float]] = []
    write: Callable[..., None] = overlay._text

    def watched(lines: Any, at: Any, said: str, colour: int = 0, align: Any = (0.0, 0.0)) -> None:
        wide, high = imgui.calc_text_size(said)
        left, top = at[0] - align[0] * wide, at[1] - align[1] * high
        boxes.append((said, left, top, left + wide, top + high))
        write(lines, at, said, colour or overlay._LETTERS, align)

    patch.setattr(overlay, "_text", watched)
    return boxes


def settled(view: Any, hand: Hand) -> np.ndarray:
    """What is drawn once nothing is still to come, in full."""
    wait_for(lambda: hand.canvas.draw() is not None and view.painter.ready, 60.0, every=0.02)
    view._changed_at = -10.0
    return np.asarray(hand.canvas.draw())[..., :3].astype(int)


def small_photo(folder: Path) -> Path:
    """A photograph whose pixels are those of the canvas, at 100 %."""
    pixels = image.read(Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg").pixels[:380, :560]
    image.write(folder / "photo.png", pixels)
    return folder / "photo.png"


@contextmanager
def viewing(*arguments: str, folder: Path, display: str = "") -> Iterator[subprocess.Popen[str]]:
    """A process of ``supple view``."""
    # Without programs for dialogs, files are typed.
    env = os.environ | {"PYTHONPATH": SOURCE, "PYTHONUNBUFFERED": "1", "PATH": str(folder / "none")}
    env |= {"XDG_STATE_HOME": str(folder / "state"), "XDG_CONFIG_HOME": str(folder / "config")}
    (folder / "config" / "supple").mkdir(parents=True, exist_ok=True)
    (folder / "config" / "supple" / "window.json").write_text('{"hinted": true}')  # the first hints lie over pictures
    if display:
        env["DISPLAY"] = display
    process = subprocess.Popen(
        [sys.executable, "-m", "supple", "view", *arguments],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        start_new_session=True,
        preexec_fn=HEARING,
    )
    deaf = False
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                deaf = True
                process.kill()
                process.wait()
        said = ""
        if process.stdout is not None:
            said = process.stdout.read()
            process.stdout.close()
        print(said)
    assert "Traceback" not in said
    assert not deaf, "Ctrl+C did not end it"


@contextmanager
def a_screen(folder: Path) -> Iterator[Mouse]:
    """A screen of its own, by Xvfb, with a pointer; what is on it lies in a new folder."""
    needs("Xvfb", "xdotool")
    folder.mkdir()
    read, write = os.pipe()
    told = ["-displayfd", str(write), "-fbdir", str(folder)]
    server = subprocess.Popen(
        # Each program that was alone on it would reset it, and a window that comes just then would not survive.
        ["Xvfb", "-noreset", "-screen", "0", "1280x800x24", "-nolisten", "tcp", *told],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as said:
            yield Mouse(f":{said.readline().strip()}", folder / "Xvfb_screen0")
    finally:
        server.terminate()
        server.wait()


class Mouse:
    """A pointer and a keyboard on a screen, and an eye."""

    def __init__(self, display: str, memory: Path) -> None:
        self.display, self._memory = display, memory
        self.env = os.environ | {"DISPLAY": display}

    def do(self, *words: object) -> str:
        made = subprocess.run(
            ["xdotool", *map(str, words)], env=self.env, check=True, capture_output=True, text=True, timeout=30
        )
        return made.stdout

    def shown(self) -> Pixels:
        """What is on the screen: a header, colours that are not used, and words of blue, green, red and nothing."""
        data = self._memory.read_bytes()
        head = np.frombuffer(data, ">u4", 25)
        columns, rows, line, colours = head[4], head[5], head[12], head[19]
        pixels = np.frombuffer(data, np.uint8, int(line * rows), int(head[0] + 12 * colours))
        return np.ascontiguousarray(pixels.reshape(rows, line // 4, 4)[:, :columns, 2::-1])

    def settled(self, seconds: float = 240.0, looks: int = 3) -> Pixels:
        """What is on the screen, once there is something and it stays as it is, at some looks."""
        last, times = self.shown(), 0

        def still() -> bool:
            nonlocal last, times
            before, last = last, self.shown()
            drawn = np.ptp(last[100:600, 100:800].astype(int)) > 100
            times = times + 1 if drawn and np.array_equal(before, last) else 0
            return times == looks

        wait_for(still, seconds, every=0.4)
        return last

    def enter(self) -> None:
        """Press Enter, which is what a question waits for once it is there."""
        self.do("key", "Return")

    def filed(self, keys: str, path: Path) -> None:
        """Press the keys of a command that writes a file, and Enter until there is the file.

        What is pressed while the question before is still on the screen would be lost.
        """
        for _ in range(3):  # a window that is slow to draw may lose the keys all the same
            self.settled()
            self.do("key", keys)
            with contextlib.suppress(AssertionError):
                wait_for(lambda: self.enter() or path.exists(), 60.0, every=0.5)
                return
        raise AssertionError(f"{path.name} was not written")

    def drag(self, start: tuple[int, int], end: tuple[int, int], button: int = 1, steps: int = 6) -> None:
        self.do("mousemove", *start)
        time.sleep(0.2)
        self.do("mousedown", button)
        for k in range(1, steps + 1):
            self.do("mousemove", *(round(a + (b - a) * k / steps) for a, b in zip(start, end, strict=True)))
            time.sleep(0.1)
        self.do("mouseup", button)


class Browser:
    """Chromium without a screen, by its own protocol."""

    def __init__(self, folder: Path) -> None:
        needs("chromium")
        from websockets.sync.client import connect

        self._process = subprocess.Popen(
            [
                "chromium",
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                f"--window-size={SIZE[0]},{SIZE[1] + 150}",
                "--remote-debugging-port=0",
                f"--user-data-dir={folder}",
                "about:blank",
            ],
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stderr is not None
        port = ""
        for line in self._process.stderr:
            found = re.search(r"ws://127\.0\.0\.1:(\d+)/", line)
            if found:
                port = found[1]
                break
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30) as answer:
            page = next(tab for tab in json.load(answer) if tab["type"] == "page")
        self._stack = connect(page["webSocketDebuggerUrl"], max_size=None)
        self._socket = self._stack.__enter__()
        self._count = 0
        self.call("Page.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == self._count:
                return answer.get("result")

    def go(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def text(self) -> str:
        found = self.call("Runtime.evaluate", expression="document.body ? document.body.innerText : ''")
        return str(found["result"]["value"])

    def shown(self) -> Pixels:
        """What is on the page."""
        taken = self.call("Page.captureScreenshot", format="png")
        if not taken:  # on the way from page to page
            return np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        data = base64.b64decode(taken["data"])
        return np.asarray(pyvips.Image.new_from_buffer(data, "").numpy())[..., :3]

    def settled(self) -> Pixels:
        """What is on the page, once it stays as it is."""
        last = self.shown()

        def still() -> bool:
            nonlocal last
            before, last = last, self.shown()
            return np.array_equal(before, last)

        wait_for(still, every=0.5)
        return last

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 6, **pen: Any) -> None:
        """Drag a mouse; or a pen, by what is said of it."""
        self.mouse("mouseMoved", *start, **pen)
        time.sleep(0.2)
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1, **pen)
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, button="left", buttons=1, **pen)
            time.sleep(0.1)
        self.mouse("mouseReleased", *end, button="left", clickCount=1, **pen)

    def key(self, key: str, code: int, modifiers: int = 0) -> None:
        """Press a key; of modifiers, 2 is Control."""
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, modifiers=modifiers)

    def close(self) -> None:
        self._stack.__exit__(None, None, None)
        self._process.terminate()
        self._process.wait()
        if self._process.stderr is not None:
            self._process.stderr.close()
