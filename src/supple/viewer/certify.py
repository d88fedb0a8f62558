"""The certified error of what is seen, worked out beside it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from supple.deformation import Deformation, Report
from supple.errors import SuppleError
from supple.viewer.heard import heard


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
        self._wanted: Deformation | None = None
        self._begun: Deformation | None = None
        self._known: tuple[Deformation, Report] | None = None
        self._closed = False
        self._thread: threading.Thread | None = None

    def report(self, deformation: Deformation) -> Report | None:
        """What is known of a deformation; None while it is being measured."""
        with self._news:
            if self._known is not None and self._known[0] is deformation:
                return self._known[1]
            if self._wanted is not deformation:
                self._wanted = deformation
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
                    report = done.report()
            except SuppleError:
                continue
            with self._news:
                self._known = done, report
            self._on_report()
