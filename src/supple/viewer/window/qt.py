"""Windows of Qt: opening, closing, and dropped files."""

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


def attend(canvas: Any, view: Window) -> None:
    """Ask before strokes are lost, and open files dropped on the window."""
    from rendercanvas.qt import QtCore, QtGui

    kinds = QtCore.QEvent.Type

    class Watch(QtCore.QObject):  # type: ignore[misc]
        def eventFilter(self, watched: Any, event: Any) -> bool:  # noqa: N802, as Qt calls it
            kind = event.type()
            if kind == kinds.Close:
                if not view.commands.may_close():
                    event.ignore()
                    view.refresh()
                    return True
                # Images in progress are waited for, while their window exists.
                device = view.gpu.device
                device.queue.read_buffer(device.create_buffer(size=4, usage="COPY_SRC"))
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

    view.copy_text = QtGui.QGuiApplication.clipboard().setText
    canvas.setAcceptDrops(True)
    canvas.installEventFilter(Watch(canvas))
    canvas.add_event_handler(counted, "wheel", order=-100)
