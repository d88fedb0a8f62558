"""When a window is drawn next, where nothing else asks for it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

ANSWERED = 0.1  # seconds after an event in which a panel has answered it
HINTED = 0.6  # and after which it says what something is that the pointer stays on


class Waking:
    """Draws a canvas again, at once or later.

    Parameters
    ----------
    canvas : rendercanvas canvas
    call_later : function
        Of seconds and a function, which runs then in the canvas's loop.
    """

    def __init__(self, canvas: Any, call_later: Callable[[float, Callable[[], None]], Any]) -> None:
        self._canvas, self._call_later = canvas, call_later
        self._stirred, self._due = -math.inf, math.inf

    def now(self) -> None:
        """Draw as soon as possible."""
        self._canvas.request_draw()

    def later(self, seconds: float) -> None:
        """Draw then, if not before: one that is due earlier looks again what there is to do."""
        due = time.perf_counter() + seconds
        if due < self._due:
            self._due = due
            self._call_later(seconds, self._woken)

    def stir(self) -> None:
        """Draw some frames for an event: a panel answers in the second or the third."""
        self._stirred = time.perf_counter()
        self.now()

    def answer(self) -> None:
        """Go on with what an event began, after a frame."""
        since = time.perf_counter() - self._stirred
        if since < ANSWERED:
            self.now()
        elif since < HINTED:
            self.later(HINTED - since)

    def _woken(self) -> None:
        self._due = math.inf
        self.now()
