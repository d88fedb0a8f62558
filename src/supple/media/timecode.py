"""Frame numbers that start at any number, and timecodes (SMPTE ST 12-1)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from supple.errors import SuppleError

PATTERN = r"\d+:\d\d:\d\d[:;.]\d\d\d?"
"""The regular expression of a timecode: hours, minutes, seconds, frames; ``;`` or ``.`` marks drop-frame timecode."""


@dataclass(frozen=True, slots=True)
class Numbering:
    """The numbers and the timecodes of the frames of a clip; everywhere else, frames are counted from 0."""

    name: str  # the clip, for messages
    count: int  # of frames
    rate: Fraction  # frames a second; timecodes count the nearest whole number of them as one second
    first: int = 0  # the number of the first frame
    start: str = ""  # the timecode of the first frame; if it is empty, they begin at 0, with or without drops
    varies: bool = False  # whether the rate varies, so that timecodes would not be times

    def read(self, what: str, text: str) -> int:
        """Return the index of the frame with a number or a timecode; SuppleError for one that the clip does not have.

        ``what`` is the argument, for messages.
        """
        if re.fullmatch(PATTERN, text):
            ends = [self.timecode(0), self.timecode(self.count - 1)]
            day = 24 * (3600 * self._base - 54 * self._drops(text))
            found = (self._counted(what, text) - self._begin) % day  # a clip may go on past midnight
        else:
            ends = [str(self.first), str(self.first + self.count - 1)]
            try:
                found = int(text) - self.first
            except ValueError:
                wanted = f"the number of a frame ({ends[0]}, say) or a timecode ({self.timecode(0)})"
                raise SuppleError(f"{what} must be {wanted}, found {text!r}") from None
        if not 0 <= found < self.count:
            raise SuppleError(f"{what} must be from {ends[0]} to {ends[1]}, the frames of {self.name}, found {text}")
        return found

    def timecode(self, k: int) -> str:
        """Return the timecode of frame ``k``, counted from 0."""
        base, drops = self._base, self._drops(self.start)
        n = self._begin + k
        ten = 600 * base - 9 * drops  # frames in ten minutes
        n += 9 * drops * (n // ten) + drops * max(0, (n % ten - drops) // (60 * base - drops))
        (seconds, frames), wide = divmod(n, base), max(2, len(str(base - 1)))
        time = f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        return f"{time}{';' if drops else ':'}{frames:0{wide}d}"

    @property
    def _base(self) -> int:
        return max(1, round(self.rate))

    @property
    def _begin(self) -> int:
        """The frames from 00:00:00:00 to the first one."""
        return self._counted("the timecode", self.start) if re.fullmatch(PATTERN, self.start) else 0

    def _drops(self, text: str) -> int:
        """Return how many numbers drop-frame timecode skips each minute, except every tenth; 0 for other timecodes."""
        return 2 * (self._base // 30) if re.search(r"[;.]", text) and self._base % 30 == 0 else 0

    def _counted(self, what: str, text: str) -> int:
        """Return the frames from 00:00:00:00 to a timecode."""
        hours, minutes, seconds, frames = map(int, re.split("[:;.]", text))
        base, drops = self._base, self._drops(text)
        if self.varies:
            raise SuppleError(f"{what} {text}: the frame rate of {self.name} varies: give the number of a frame")
        otherwise = (self.start and drops != self._drops(self.start)) or (
            not drops and text != self.start and re.search("[;.]", text)
        )
        dropped = frames < drops and seconds == 0 and minutes % 10
        if otherwise or dropped or max(minutes, seconds) > 59 or frames >= base:
            written = f"of {base} frames a second, written as {self.start or '00:00:00:00'}"
            raise SuppleError(f"{what} {text} is no timecode of {self.name}, which is {written}")
        minutes += 60 * hours
        return (60 * minutes + seconds) * base + frames - drops * (minutes - minutes // 10)
