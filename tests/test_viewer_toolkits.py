"""The window in other hands: in a window of Qt, and as a widget of a notebook."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import supple
from supple.gpu.device import Gpu
from supple.media import image
from supple.strokes import Recipe

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")

DATA = Path(supple.__file__).parent / "data"
QT = next((name for name in ("PySide6", "PyQt6") if find_spec(name) is not None), None)

# A drag, a wheel, and a close that asks; what is asked is answered by the key that Qt calls Return.
IN_QT = """
import sys
from {qt} import QtCore, QtGui, QtTest, QtWidgets
from supple.viewer import launch, qt

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
    turn = QtGui.QWheelEvent(QtCore.QPointF(410, 280), QtCore.QPointF(410, 280), place(0, 0), place(0, 120),
                             QtCore.Qt.MouseButton.NoButton, none, QtCore.Qt.ScrollPhase.NoScrollPhase, False)
    QtWidgets.QApplication.sendEvent(inner, turn)
    until(lambda: view.tools.radius > radius)
    print("grown", round(view.tools.radius / radius, 3))
    assert not QtWidgets.QWidget.close(canvas)
    until(lambda: view.desk.asked is not None and not view.desk.asked.fresh)
    print("asked", view.desk.asked.name)
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
    assert ran.stdout.split("\n")[:3] == ["grown 1.1", "asked close", "closed True 1"], ran.stdout + ran.stderr
    (stroke,) = Recipe.from_json((tmp_path / "photo.recipe.json").read_text(encoding="utf-8")).strokes
    assert stroke.by[0] > 10
    assert stroke.by[1] < -5


def test_what_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer import launch, qt

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
