"""The window in other hands: in a window of Qt, and as a widget of a notebook."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvips

import supple
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")

DATA = Path(supple.__file__).parent / "examples" / "data"
QT = next((name for name in ("PySide6", "PyQt6") if find_spec(name) is not None), None)

# A drag, a wheel, and a close that asks; what is asked is answered by the key that Qt calls Return.
IN_QT = """
import sys
from imgui_bundle import imgui
from {qt} import QtCore, QtGui, QtTest, QtWidgets
from supple.viewer.window import launch
from supple.viewer.window import qt

watched = []
attend = qt.attend

def attending(canvas, view):
    attend(canvas, view)
    watched.extend((canvas, view, canvas._subwidget))
    QtCore.QTimer.singleShot(0, steps)

qt.attend = attending
place, test = QtCore.QPoint, QtTest.QTest
left = QtCore.Qt.MouseButton.LeftButton
none = QtCore.Qt.KeyboardModifier.NoModifier

def until(what, milliseconds=60000):
    for _ in range(milliseconds // 50):
        if what():
            return
        test.qWait(50)
    raise AssertionError("it took too long")

def steps():
    try:
        drive()
    except BaseException:
        import traceback
        traceback.print_exc()
        QtWidgets.QApplication.exit(1)

def drive():
    canvas, view, inner = watched
    until(lambda: view._textures is not None, 200000)
    radius = view.tools.radius
    for x in (350, 360):
        test.mouseMove(inner, place(x, 300))
    test.mousePress(inner, left, none, place(360, 300))
    for x in (370, 390, 410):
        move = QtGui.QMouseEvent(QtCore.QEvent.Type.MouseMove, QtCore.QPointF(x, 280), QtCore.QPointF(x, 280),
                                 QtCore.Qt.MouseButton.NoButton, left, none)
        QtWidgets.QApplication.sendEvent(inner, move)
        test.qWait(30)
    test.mouseRelease(inner, left, none, place(410, 280))
    until(lambda: len(view.recipe.strokes) == 1 and not view.tools.dragging)
    pen = QtGui.QPointingDevice.primaryPointingDevice()
    for kind, x, force in (("TabletPress", 300, 0.5), ("TabletMove", 320, 0.4), ("TabletRelease", 320, 0.0)):
        at = QtCore.QPointF(x, 200)
        button = QtCore.Qt.MouseButton.NoButton if kind == "TabletMove" else left
        held = QtCore.Qt.MouseButton.NoButton if kind == "TabletRelease" else left
        QtWidgets.QApplication.sendEvent(inner, QtGui.QTabletEvent(
            getattr(QtCore.QEvent.Type, kind), pen, at, at, force, 0, 0, 0.0, 0.0, 0, none, button, held))
        mouse = {"TabletPress": "MouseButtonPress", "TabletMove": "MouseMove",
                 "TabletRelease": "MouseButtonRelease"}[kind]
        QtWidgets.QApplication.sendEvent(inner, QtGui.QMouseEvent(
            getattr(QtCore.QEvent.Type, mouse), at, at, button, held, none))
        test.qWait(60)
    until(lambda: len(view.recipe.strokes) == 2 and not view.tools.dragging)
    print("pen", round(view.recipe.strokes[1].by[0] * view.tools.viewport.zoom / 20, 3))
    turn = QtGui.QWheelEvent(QtCore.QPointF(410, 280), QtCore.QPointF(410, 280), place(0, 0), place(0, 120),
                             QtCore.Qt.MouseButton.NoButton, none, QtCore.Qt.ScrollPhase.NoScrollPhase, False)
    QtWidgets.QApplication.sendEvent(inner, turn)
    until(lambda: view.tools.radius > radius)
    print("grown", round(view.tools.radius / radius, 3))
    shift = QtCore.Qt.KeyboardModifier.ShiftModifier
    test.keyClick(inner, QtCore.Qt.Key.Key_Question, shift)
    until(lambda: view.tools.listing)
    test.keyClick(inner, QtCore.Qt.Key.Key_Question, shift)
    until(lambda: not view.tools.listing)
    hints, begin = [], imgui.begin_tooltip
    imgui.begin_tooltip = lambda: hints.append("one") or begin()
    test.mouseMove(inner, place(1000 - 328, 60))
    until(lambda: len(hints) > 1)
    assert not QtWidgets.QWidget.close(canvas)
    until(lambda: view.commands.asked is not None and not view.commands.asked.fresh)
    print("asked", view.commands.asked.name)
    test.qWait(200)
    test.keyClick(inner, QtCore.Qt.Key.Key_Return)

made = launch.show(sys.argv[1], toolkit="qt", size=(1000, 640))
print("closed", watched[0].get_closed(), len(made.recipe.strokes))
"""


@pytest.mark.skipif(QT is None, reason="no Qt is installed")
def test_a_window_of_qt_is_dragged_on_and_asks_before_it_closes(gpu: Gpu, tmp_path: Path) -> None:
    pytest.importorskip(f"{QT}.QtWidgets", exc_type=ImportError)
    image.write(tmp_path / "photo.png", image.read(DATA / "coffee.jpg").pixels[:380, :560])
    env = os.environ | {"QT_QPA_PLATFORM": "offscreen", "XDG_STATE_HOME": str(tmp_path / "state")}
    ran = subprocess.run(
        [sys.executable, "-c", IN_QT.replace("{qt}", str(QT)), str(tmp_path / "photo.png")],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "rror" not in ran.stderr, ran.stderr
    assert ran.stdout.split("\n")[:4] == ["pen 0.75", "grown 1.1", "asked close", "closed True 2"], (
        ran.stdout + ran.stderr
    )
    stroke, _ = Recipe.from_json((tmp_path / "photo.recipe.json").read_text(encoding="utf-8")).strokes
    assert stroke.by[0] > 10
    assert stroke.by[1] < -5


# Each event of a tablet is followed by the one of a mouse that Qt makes of it; they wait until the loop has its turn.
PENS = """
from types import SimpleNamespace
from {qt} import QtCore, QtGui, QtWidgets
from rendercanvas.qt import RenderCanvas
from supple.viewer.window import qt

canvas = RenderCanvas(size=(300, 200))
qt.attend(canvas, SimpleNamespace())
inner, found = canvas._subwidget, []
canvas.add_event_handler(
    lambda event: found.append((event["event_type"][8:], event.get("pressure"), event.get("peak"))),
    "pointer_down", "pointer_move", "pointer_up")
left, none = QtCore.Qt.MouseButton.LeftButton, QtCore.Qt.MouseButton.NoButton
plain, device = QtCore.Qt.KeyboardModifier.NoModifier, QtGui.QPointingDevice.primaryPointingDevice()
at = QtCore.QPointF(50, 50)
kinds = {"Press": ("MouseButtonPress", left, left), "Move": ("MouseMove", none, left),
         "Release": ("MouseButtonRelease", left, none)}

def mouse(kind):
    name, button, held = kinds[kind]
    QtWidgets.QApplication.sendEvent(
        inner, QtGui.QMouseEvent(getattr(QtCore.QEvent.Type, name), at, at, button, held, plain))

def pen(kind, force):
    _, button, held = kinds[kind]
    QtWidgets.QApplication.sendEvent(inner, QtGui.QTabletEvent(
        getattr(QtCore.QEvent.Type, "Tablet" + kind), device, at, at, force, 0, 0, 0.0, 0.0, 0, plain, button, held))
    mouse(kind)

def said(what):
    inner._events.flush()
    print(what, *(":".join(map(str, event)) for event in found))
    found.clear()

for force in (0.3, 0.4):
    pen("Press", force)
    pen("Release", 0.0)
said("taps")
pen("Press", 0.2)
for force in (0.8, 0.5):
    pen("Move", force)
pen("Release", 0.0)
said("drag")
pen("Press", 0.2)  # its release is lost
mouse("Press")
mouse("Move")
mouse("Release")
said("mouse")
"""


@pytest.mark.skipif(QT is None, reason="no Qt is installed")
def test_each_event_of_qt_has_the_pressure_that_its_pen_had() -> None:
    pytest.importorskip(f"{QT}.QtWidgets", exc_type=ImportError)
    ran = subprocess.run(
        [sys.executable, "-c", PENS.replace("{qt}", str(QT))],
        env=os.environ | {"QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout.splitlines() == [
        "taps down:0.3:0.3 up:0.3:0.3 down:0.4:0.4 up:0.4:0.4",
        "drag down:0.2:0.2 move:0.5:0.8 up:0.5:0.8",
        "mouse down:0.2:0.2 down:None:None move:None:None up:None:None",
    ], ran.stderr


def test_what_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.window import launch, qt

    def none() -> Gpu:
        raise supple.SuppleError("no GPU was found: install one; device='cpu' needs none")

    with monkeypatch.context() as patch:
        patch.setattr(launch, "open_gpu", none)
        with pytest.raises(supple.SuppleError, match=r"install one$"):
            launch.opened(np.zeros((4, 4)), None, None, None)
    monkeypatch.setattr(qt, "BINDINGS", ("no_such_binding",))
    with pytest.raises(supple.SuppleError, match=r"needs PySide6.*pip install"):
        launch.on_screen_of("qt")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    assert not qt.has_screen()
    monkeypatch.setattr(qt, "toolkit", lambda: (None, None))
    with pytest.raises(supple.SuppleError, match="no screen"):
        launch.on_screen_of("qt")


class Notebook:
    """A kernel, and the front end of one widget in it."""

    def __init__(self, client: Any) -> None:
        self.client, self.comm, self.said = client, "", ""
        self.frames: list[bytes] = []

    def run(self, code: str) -> str:
        """What a cell prints; if it shows a widget, that is the one that is talked to."""
        self.said = ""
        asked = self.client.execute(code)
        answer = self.client.get_shell_msg(timeout=120)
        while answer["parent_header"].get("msg_id") != asked:
            answer = self.client.get_shell_msg(timeout=120)
        assert answer["content"]["status"] == "ok", answer["content"].get("traceback")
        self.hear(lambda message: message["msg_type"] == "status" and message["parent_header"]["msg_id"] == asked)
        return self.said.strip()

    def hear(self, enough: Callable[[Any], bool], seconds: float = 120.0) -> None:
        """Take in what the kernel tells, until that is enough."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            message = self.client.get_iopub_msg(timeout=seconds)
            content, kind = message["content"], message["msg_type"]
            if kind == "stream":
                self.said += content["text"]
            elif kind in ("execute_result", "display_data"):
                self.comm = content["data"]["application/vnd.jupyter.widget-view+json"]["model_id"]
            elif kind == "comm_msg" and content["data"].get("content", {}).get("type") == "framebufferdata":
                self.frames.append(bytes(message["buffers"][0]))
                shown = {
                    "index": content["data"]["content"]["index"],
                    "timestamp": time.time(),
                    "localtime": time.time(),
                }
                self.tell({"method": "update", "state": {"_frame_feedback": shown}, "buffer_paths": []})
            if enough(message) and (kind != "status" or content["execution_state"] == "idle"):
                return
        raise AssertionError("it took too long")

    def tell(self, data: Any) -> None:
        """Tell the widget something, as its front end does."""
        message = self.client.session.msg("comm_msg", {"comm_id": self.comm, "data": data})
        self.client.shell_channel.send(message)

    def event(self, kind: str, **event: Any) -> None:
        common = {"type": kind, "modifiers": [], "timestamp": time.time()}
        self.tell({"method": "custom", "content": common | event})


def test_a_notebook_shows_a_widget_that_is_dragged_on(gpu: Gpu, tmp_path: Path) -> None:
    pytest.importorskip("ipykernel")
    pytest.importorskip("anywidget")
    from jupyter_client.manager import start_new_kernel

    env = os.environ | {"IPYTHONDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    manager, client = start_new_kernel(kernel_name="python3", env=env, cwd=str(tmp_path))
    try:
        notebook = Notebook(client)
        notebook.run(
            f"import supple\nfrom supple.media import image\nphoto = image.read({str(DATA / 'coffee.jpg')!r}).pixels\n"
            "view = supple.view(photo)\ntold = []\nview.on_change(told.append)\nview"
        )
        assert notebook.comm
        size = {"width": 800, "height": 500, "pwidth": 800, "pheight": 500, "ratio": 1.0}
        notebook.event("resize", **size)
        notebook.tell({"method": "update", "state": {"_has_visible_views": True}, "buffer_paths": []})
        notebook.hear(lambda _: bool(notebook.frames))
        shown = np.asarray(pyvips.Image.new_from_buffer(notebook.frames[-1], "").numpy())
        assert shown.shape[:2] == (500, 800)
        assert np.ptp(shown[100:400, 50:450].astype(int)) > 200
        touch = {"ntouches": 0, "touches": {}}
        notebook.event("pointer_down", x=250, y=250, button=1, buttons=[1], **touch)
        for x in (260, 280, 300):
            notebook.event("pointer_move", x=x, y=230, button=0, buttons=[1], **touch)
        notebook.event("pointer_up", x=300, y=230, button=1, buttons=[], **touch)
        count = len(notebook.frames)
        notebook.hear(lambda _: len(notebook.frames) > count + 1)
        for _ in range(100):  # frames may come before what they show is told
            if "0" not in notebook.run("print(len(view.recipe.strokes), len(told))").split():
                break
            time.sleep(0.1)
        said = notebook.run("print(len(view.recipe.strokes), view.recipe.strokes[0].by, told[-1] == view.recipe)")
        number, by, same = said.split(" ", 1)[0], said[said.index("(") : said.index(")") + 1], said.split()[-1]
        assert (number, same) == ("1", "True")
        x, y = (float(v) for v in by.strip("()").split(","))
        assert x > 20
        assert y < -8
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
