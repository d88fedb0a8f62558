"""Tasks and certified errors, computed in background threads, and the warnings of those threads."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from supple.deformation import Deformation, Report
from supple.errors import SuppleError, spelling
from supple.files.options import PathLike
from supple.viewer.document.words import WINDOW

Ear = Callable[[str, type[Warning]], None]

_lock = threading.RLock()
_ears: list[tuple[int, Ear]] = []  # threads and their listeners
_outside = contextlib.ExitStack()  # restores the handlers after the last listener


@contextlib.contextmanager
def heard(tell: Ear = lambda text, kind: None) -> Iterator[None]:
    """Pass the warnings of this thread, and of threads that work for it, to a function instead of printing them.

    `warnings.catch_warnings` is not safe with several threads. A warning of a thread without a listener goes to the
    newest listener of a background thread, as that may have started it; warnings of the main thread are handled as
    usual. The function is called, in the thread of the warning, with its message and its category.
    """
    mine = (threading.get_ident(), tell)
    with _lock:
        if not _ears:
            _outside.enter_context(warnings.catch_warnings(action="always"))
            warnings.showwarning = partial(_show, warnings.showwarning)
        _ears.append(mine)
    try:
        yield
    finally:
        with _lock:
            _ears.remove(mine)
            if not _ears:
                _outside.close()


def _show(
    before: Callable[..., None], message: Warning | str, category: type[Warning], *place: Any, **more: Any
) -> None:
    thread, main = threading.get_ident(), threading.main_thread().ident
    with _lock:
        own = [ear for ident, ear in _ears if ident == thread]
        others = [ear for ident, ear in _ears if ident != main] if thread != main else []
    if own or others:
        (own or others)[-1](str(message), category)
    else:
        before(message, category, *place, **more)


class Certifier:
    """The last report of a deformation, measured in a thread, which then calls ``on_report``, to ask for it again."""

    def __init__(self, on_report: Callable[[], None]) -> None:
        self._on_report = on_report
        self._asked: tuple[Deformation, int | None] | None = None
        self._report: Report | None = None
        self._busy = False
        self.thread: threading.Thread | None = None

    def report(self, deformation: Deformation, plane: int | None = None) -> Report | None:
        """Return the certified error of a deformation, or of one plane of it; None until it is measured."""
        asked = deformation, plane
        if asked != self._asked and not self._busy:
            self._asked, self._report, self._busy = asked, None, True
            self.thread = threading.Thread(target=self._measure, args=asked, name="supple-certify", daemon=True)
            self.thread.start()
        return self._report if asked == self._asked else None

    def _measure(self, deformation: Deformation, plane: int | None) -> None:
        with contextlib.suppress(SuppleError), heard():
            self._report = deformation.report(plane=plane)
        self._busy = False
        self._on_report()


# The start and the share of each stage. For a clip, writing begins first, and ends with the last frame.
_PARTS = {"read": (0.0, 0.05), "plan": (0.05, 0.1), "warp": (0.15, 0.75), "write": (0.9, 0.1), "track": (0.0, 1.0)}
_TEXTS = {"read": "reading", "plan": "planning", "warp": "warping", "write": "writing", "track": "tracking"}
_BEGUN = "starting"


class _Cancelled(Exception):  # noqa: N818, it is no error
    """The work was cancelled."""


class Task:
    """Work in a thread, which starts at once: a function that is given ``tell``, for its progress.

    Call `join` before the program ends, or running work fails.
    """

    def __init__(self, work: Callable[..., Any], target: PathLike = "") -> None:
        self.target = target  # the file that it writes, if there is one
        self.progress = 0.0  # the finished part, from 0 to 1; it never decreases
        self.text = _BEGUN  # the text of the progress, or of the result
        self.error: str | None = None  # the error, in one line
        self.result: Any = None  # the result of the work
        self.cancelled = False  # whether it was cancelled before a file was written
        self.warnings: dict[str, None] = {}  # the warnings, each only once
        self._stop = threading.Event()
        self._work = partial(work, tell=self._tell)
        self._thread = threading.Thread(target=self._run, name="supple-export")
        self._thread.start()

    @property
    def done(self) -> bool:
        """True if it has ended, in any way."""
        return not self._thread.is_alive()

    def cancel(self) -> None:
        """Ask it to stop, which it does between two frames, slices or stages; it may finish first."""
        self._stop.set()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end, for at most ``timeout`` seconds; return whether it has ended."""
        self._thread.join(timeout)
        return self.done

    def _tell(self, part: str, count: int, total: int) -> None:
        if self._stop.is_set():
            raise _Cancelled
        counted = part in ("plan", "warp", "track") and total > 3
        if part == "write" and self.text == _BEGUN:
            return  # the opening of a clip's file
        begin, size = _PARTS[part]
        self.progress = max(self.progress, begin + (size * count / total if counted else 0.0))
        self.text = f"{_TEXTS[part]} {count} of {total}" if counted else _TEXTS[part]

    def _run(self) -> None:
        try:
            with spelling(WINDOW), heard(lambda text, kind: self.warnings.setdefault(_line(text))):
                self.result = self._work()
        except _Cancelled:
            self.cancelled, self.text = True, "cancelled"
        except Exception as error:
            kind = "" if isinstance(error, SuppleError) else f"{type(error).__name__}: "
            self.error = self.text = _line(f"{kind}{error}")
        else:
            self.progress, self.text = 1.0, "done"


def _line(text: str) -> str:
    return " ".join(text.split())
