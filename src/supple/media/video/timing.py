"""Times of frames: real ones kept, missing ones mended, carried from reader to writer."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from fractions import Fraction


@dataclass(slots=True)
class Times:
    """When each frame is shown, in ticks of the stream, strictly increasing.

    Parameters
    ----------
    base : Fraction
        Seconds a tick.
    step : int
        Ticks from frame to frame where the file does not say.
    """

    base: Fraction
    step: int
    kept: deque[tuple[int, int]] | None = None
    _first: int | None = field(default=None, repr=False)
    _last: int | None = field(default=None, repr=False)
    _due: int = field(default=0, repr=False)

    def add(self, pts: int | None, duration: int | None) -> None:
        """Take the time of the next frame, mended where it is missing or not later than the one before."""
        start = self._due if pts is None else pts
        if self._last is not None and start <= self._last:
            start = self._last + 1
        if self._first is None:
            self._first = start
        length = duration if duration and duration > 0 else self.step
        self._last, self._due = start, max(start + 1, start + length)
        if self.kept is not None:
            self.kept.append((start, length))

    def left(self, pts: int | None, span: int) -> int | None:
        """Return how long the last frame is shown, where all last `span` ticks; None where that makes no sense."""
        if pts is None or self._first is None or span <= pts - self._first:
            return None
        return span - (pts - self._first)


def usual_step(rate: Fraction, base: Fraction) -> int:
    """Return the ticks of one frame at a rate."""
    return max(1, round(1 / (rate * base)))
