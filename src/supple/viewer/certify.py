"""The certified error of what is seen, worked out beside it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from supple.deformation import Deformation, Report
from supple.errors import SuppleError
from supple.viewer.warning_log import heard

_Asked = tuple[Deformation, int | None] | None


def _same(one: _Asked, other: _Asked) -> bool:
    return one is other or (one is not None and other is not None and one[0] is other[0] and one[1] == other[1])


class Certifier:
    """Measures the map of the last deformation that it was given, in a thread of its own.

    Parameters
    ----------
    on_report : function
        Called, in that thread, when a report is there.
    """

    def __init__(self, on_report: Callable[[], None] = lambda: None) -> None:
        self._on_report = on_report
        self._news = threading.Condition()
        self._wanted: _Asked = None
        self._begun: _Asked = None
        self._known: tuple[_Asked, Report] | None = None
        self._closed = False
        self._thread: threading.Thread | None = None

    def report(self, deformation: Deformation, plane: int | None = None) -> Report | None:
        """Return the certified error of a deformation, or of one plane of it; None while it is being measured."""
        asked = deformation, plane
        with self._news:
            if self._known is not None and _same(self._known[0], asked):
                return self._known[1]
            if not _same(self._wanted, asked):
                self._wanted = asked
                self._news.notify_all()
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="supple-certify", daemon=True)
                self._thread.start()
            return None

    def close(self) -> None:
        """Stop when the report at hand is done."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def _work(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closed or self._wanted is not self._begun)
                if self._closed:
                    return
                done = self._begun = self._wanted
            if done is None:
                continue
            try:
                with heard(lambda text, kind: None):
                    report = done[0].report(plane=done[1])
            except SuppleError:
                continue
            with self._news:
                self._known = done, report
            self._on_report()
