"""How far things are that go on at the same time."""

from __future__ import annotations

import shutil
import sys
import threading
import time

SECONDS = 10.0  # between two lines, where a line cannot be written anew


class Progress:
    """What is going on, by name: on a terminal one line that is written anew, elsewhere a line now and then."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._said = -SECONDS
        self._states: dict[str, str] = {}
        self._lock = threading.Lock()
        self._anew = sys.stdout.isatty()

    def tell(self, what: str, state: str) -> None:
        """Say how far something is."""
        with self._lock:
            self._states[what] = state
            self._show()

    def end(self, what: str, state: str) -> None:
        """Say that something has ended, in a line of its own, if it was begun."""
        with self._lock:
            if self._states.pop(what, None) is not None:
                self._print(f"{what}: {state}", "\n")
                self._show()

    def _show(self) -> None:
        if self._states and (self._anew or time.monotonic() > self._said + SECONDS):
            self._said = time.monotonic()
            self._print("; ".join(f"{name}: {state}" for name, state in self._states.items()))

    def _print(self, text: str, end: str = "") -> None:
        line = f"[{time.monotonic() - self._begun:3.0f} s] {text}"
        if self._anew:
            print(f"\r\033[K{line[: shutil.get_terminal_size().columns - 1]}", end=end, flush=True)
        else:
            print(line, flush=True)
