"""The playback of a clip: the displayed frame at a time."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

_EARLY = 1e-6  # of a frame: the tolerance for times slightly too early, which would show the frame before


class Playback:
    """A clip that plays or is paused.

    It is real-time: late frames are dropped. The caller passes the time. Without a constant rate, frames
    have start times in seconds.
    """

    def __init__(self, count: int, rate: float, starts: Sequence[float] = ()) -> None:
        self.count, self.rate = count, rate
        self._starts = list(starts) or [k / rate for k in range(count)]
        # The last one has the duration of the one before.
        self._starts.append(2 * self._starts[-1] - self._starts[-2] if self.count > 1 else 1 / self.rate)
        self.playing = False
        self.loop = False
        self.first, self.last = 0, self.count - 1
        """The in point and the out point of the played part, both included."""
        self.frame = 0  # the displayed frame
        self._since = 0.0, 0  # the start time and the start frame of playback
        self._advanced = 0  # frames since then
        self._last: object = None  # as it was after the last advance: if it has changed since, playback starts again

    @property
    def seconds(self) -> float:
        """The time of the displayed frame."""
        return self._starts[self.frame]

    def play(self) -> None:
        """Play; at the end, start again from the in point."""
        if not self.first <= self.frame <= self.last or (self.frame == self.last and not self.loop):
            self.frame = self.first
        self.playing, self._last = True, None

    def pause(self) -> None:
        """Pause."""
        self.playing = False

    def toggle(self) -> None:
        """Play or pause."""
        (self.pause if self.playing else self.play)()

    def seek(self, frame: float) -> None:
        """Display the nearest frame; playback continues from there."""
        self.frame, self._last = min(max(math.floor(frame + 0.5), 0), self.count - 1), None

    def step(self, frames: int) -> None:
        """Pause, and advance by some frames."""
        self.pause()
        self.seek(self.frame + frames)

    def home(self) -> None:
        """Display the in point; from there, the first frame."""
        self.seek(0 if self.frame <= self.first else self.first)

    def end(self) -> None:
        """Display the out point; from there, the last frame."""
        self.seek(self.count - 1 if self.frame >= self.last else self.last)

    def mark_in(self) -> None:
        """Set the in point to the displayed frame."""
        self.first = self.frame
        if self.last < self.first:
            self.last = self.count - 1

    def mark_out(self) -> None:
        """Set the out point to the displayed frame."""
        self.last = self.frame
        if self.first > self.last:
            self.first = 0

    def unmark(self) -> None:
        """Reset the in and out points."""
        self.first, self.last = 0, self.count - 1

    def _passed(self, seconds: float, start: int) -> int:
        """Return the number of frames passed since a start frame, after some seconds."""
        first, end = self._starts[self.first], self._starts[self.last + 1]
        place, turns = self._starts[start] + seconds, 0.0
        if self.loop and end > first:  # some files have frames without a duration
            turns, rest = divmod(place - first, end - first)
            place = first + rest
        shown = bisect.bisect_right(self._starts, place + _EARLY / self.rate, self.first, self.last + 1) - 1
        return int(turns) * (self.last - self.first + 1) + shown - start

    def frame_at(self, now: float) -> int:
        """Return the frame at a time, in seconds of any monotonic clock."""
        if not self.playing:
            return self.frame
        if self._last != (self.first, self.last, self.loop):
            if not self.first <= self.frame <= self.last:
                self.frame = self.first
            self._since, self._advanced = (now, self.frame), 0
        begun, start = self._since
        advanced = max(self._passed(now - begun, start), self._advanced)
        if not self.loop:
            advanced = min(advanced, self.last - start)
        self._advanced, self._last = advanced, (self.first, self.last, self.loop)
        self.frame = self.first + (start - self.first + advanced) % (self.last - self.first + 1)
        if not self.loop and self.frame == self.last:
            self.pause()
        return self.frame
