"""Windows of Qt: opening, closing, dropped files, and the pressure of pens."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.viewer.window.window import Window

BINDINGS = ("PySide6", "PyQt6")
_NOTCH = 100 / 120  # of the wheel: in other toolkits, and in Qt


def has_screen() -> bool:
    """Return whether Qt finds a screen; without one, Qt would end the process."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in names)


def toolkit() -> tuple[Any, Any]:
    """Return the canvas and the loop of Qt.

    Raises
    ------
    SuppleError
        If no binding of Qt is installed, or usable.
    """
    found = next((name for name in BINDINGS if find_spec(name) is not None), None)
    if found is None:
        raise SuppleError("a window of Qt needs PySide6, which is not installed: pip install PySide6-Essentials")
    try:
        import_module(f"{found}.QtWidgets")  # rendercanvas uses the imported binding
    except ImportError as error:  # missing system libraries
        raise SuppleError(f"{found} cannot be used here: {error}") from None
    from rendercanvas import qt

    qt.KEY_MAP[int(qt.QtCore.Qt.Key.Key_Return)] = "Enter"  # Qt's map only has the key of the number pad
    return qt.RenderCanvas, qt.loop


def settle(view: Window) -> None:
    """Wait for images in progress."""
    device = view.gpu.device
    device.queue.read_buffer(device.create_buffer(size=4, usage="COPY_SRC"))


class Pen:
    """The pressure of a pen, for the mouse events that Qt makes of those of a tablet, each right after its own."""

    def __init__(self) -> None:
        self._pressure = self._peak = 0.0
        self._begun = self._down = False

    def begin(self, pressure: float) -> None:
        """Press the pen: the next press of a mouse is made of it."""
        self._pressure = self._peak = pressure
        self._begun = True

    def move(self, pressure: float) -> None:
        """Move the pen."""
        self._pressure, self._peak = pressure, max(self._peak, pressure)

    def tie(self, event: dict[str, Any]) -> None:
        """Add the pressure to an event of the canvas, if it is the pen's; a release may never come."""
        kind = event["event_type"]
        if kind == "pointer_down":
            self._down, self._begun = self._begun, False
        if self._down and kind in ("pointer_down", "pointer_move", "pointer_up"):
            event |= {"pressure": self._pressure, "peak": self._peak}
        self._down &= kind != "pointer_up"


def attend(canvas: Any, view: Window) -> None:
    """Ask before strokes are lost, and open files dropped on the window."""
    from rendercanvas.qt import QtCore, QtGui

    kinds = QtCore.QEvent.Type
    pen, inner = Pen(), canvas._subwidget  # which makes events of the canvas of those of Qt
    submit = inner.submit_event

    class Watch(QtCore.QObject):  # type: ignore[misc]
        def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802, as Qt calls it
            kind = event.type()
            if kind == kinds.TabletPress:
                pen.begin(event.pressure())
            if kind == kinds.TabletMove:
                pen.move(event.pressure())
            if kind == kinds.Close:
                if not view.commands.may_close():
                    event.ignore()
                    view.refresh()
                    return True
                settle(view)  # while their window exists
            if kind == kinds.DragEnter and event.mimeData().hasUrls():
                event.acceptProposedAction()
                return True
            if kind == kinds.Drop:
                event.acceptProposedAction()
                view.drop([url.toLocalFile() for url in event.mimeData().urls() if url.isLocalFile()])
                return True
            return False

    def counted(event: dict[str, Any]) -> None:
        event["dx"], event["dy"] = _NOTCH * event["dx"], _NOTCH * event["dy"]

    def tied(event: dict[str, Any]) -> None:
        pen.tie(event)
        submit(event)

    view.copy_text = QtGui.QGuiApplication.clipboard().setText
    canvas.setAcceptDrops(True)
    canvas.installEventFilter(Watch(canvas))
    inner.submit_event = tied
    canvas.add_event_handler(counted, "wheel", order=-100)
